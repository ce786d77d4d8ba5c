"""Safe access to datasets of numbers in HDF5 files.

Type, shape and size are checked before reading. Links into other files are refused before they are followed, and so
are links that lead nowhere or in a circle.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from comove.dmp.demonstrations.cleaning import MAX_DIMS
from comove.dmp.demonstrations.columns import Kind, is_derived, read_columns
from comove.dmp.demonstrations.samples import MAX_ROWS, SHOWN, decoding, fault, require_bytes
from comove.errors import DemonstrationError, listed, near_name
from comove.io.files import extra

if TYPE_CHECKING:
    from h5py import Dataset, Group

MAX_ARRAY_BYTES = 256 * 2**20
"""Largest array that is read [bytes]."""
_BROKEN = (OSError, RuntimeError, KeyError, ValueError, TypeError, MemoryError, OverflowError)
"""What h5py makes of damaged bytes."""
LAYOUTS = "give a robomimic file (data/demo_0/obs/...) or an ALOHA episode (observations/qpos)"
_DEEPEST, _MOST_NODES, _MOST_LINKS = 8, 5000, 10


@dataclass(frozen=True)
class DatasetShape:
    """A dataset of numbers: its path in the file and its shape."""

    key: str
    shape: tuple[int, ...]

    def __str__(self) -> str:
        return f"{self.key} {'x'.join(map(str, self.shape))}"


@dataclass(frozen=True)
class HDF5File:
    """An open file."""

    path: Path
    root: Group

    @classmethod
    @contextmanager
    def opened(cls, path: Path, way_out: str) -> Iterator[HDF5File]:
        """Lend an open file; convert h5py's exceptions to a `DemonstrationError`."""
        h5py = extra("h5py", path)
        require_bytes(path)
        with decoding(path, "HDF5 file", _BROKEN, way_out), h5py.File(path, "r") as root:
            yield cls(path, root)

    def fault(self, key: str | None, message: str, way_out: str, **options: Any) -> DemonstrationError:
        """Return the error about a place in the file, see `samples.fault`."""
        return fault(self.path, key, message, way_out, **options)

    def other(self, key: str | None, message: str, below: str = "") -> DemonstrationError:
        """Return the error that advises to name another dataset. Those below a group come first."""
        found = self.datasets(below) or self.datasets()
        wide = [one for one in found if len(one.shape) != 2 or 2 <= one.shape[1] <= MAX_DIMS] or found
        if not wide:
            return self.fault(key, message, f"{LAYOUTS}: here are no numbers with a row an instant")
        best = min(wide, key=_unlikely)
        if _is_no_position(best):
            held = listed([str(one) for one in wide], SHOWN)
            return self.fault(key, message, f"record positions as well: here are {held}")
        chosen = best.key if len(best.shape) > 1 else best.key.rpartition("/")[0] or best.key
        way_out = f"name a dataset, of {listed([str(one) for one in wide], SHOWN)}"
        return self.fault(key, message, way_out, dataset=chosen)

    def node(self, key: str, n_links: int = 0) -> Any:
        """Return the group or dataset at a path; None if there is none.

        Raises
        ------
        DemonstrationError
            If a link in the path leads into another file, nowhere, or in a circle.
        """
        h5py, node, passed = extra("h5py", self.path), self.root, ""
        for part in filter(None, key.split("/")):
            if not isinstance(node, h5py.Group):
                return None
            link, passed = node.get(part, getlink=True), f"{passed}/{part}".lstrip("/")
            if link is None:
                return None
            if isinstance(link, h5py.ExternalLink):
                message = f"it is a link into another file, {link.filename!r}"
                raise self.fault(passed, message, "copy what it links to into this one")
            if isinstance(link, h5py.SoftLink):
                above = passed.rpartition("/")[0]
                target = link.path if link.path.startswith("/") else f"{above}/{link.path}"
                node = self.node(target, n_links + 1) if n_links < _MOST_LINKS else None
                if node is None:
                    message = f"it is a link to {link.path!r}, which is not in the file"
                    raise self.fault(passed, message, "record or copy it again, with what it links to")
            else:
                node = node[part]
        return node

    def is_group(self, key: str) -> bool:
        """Return whether there is a group at a path."""
        return isinstance(self.node(key), extra("h5py", self.path).Group)

    def members(self, key: str) -> list[str]:
        """Return the names in a group, [] without such a group."""
        return list(self.node(key)) if self.is_group(key) else []

    def shape(self, key: str) -> tuple[int, ...] | None:
        """Return the shape of a dataset of numbers, else None. Links out of the file count as none."""
        try:
            node = self.node(key)
        except DemonstrationError:
            return None
        is_numeric = isinstance(node, extra("h5py", self.path).Dataset) and node.dtype.kind in "iuf"
        return None if not is_numeric or node.shape is None else tuple(node.shape)

    def texts(self, key: str) -> list[bytes] | None:
        """Return the texts of a short dataset of one dimension; None if there is none."""
        node, h5py = self.node(key), extra("h5py", self.path)
        if (
            not isinstance(node, h5py.Dataset)
            or node.dtype.kind != "S"
            or node.ndim != 1
            or node.size > MAX_DIMS
        ):
            return None
        return node[()].tolist()

    def attribute(self, key: str, names: tuple[str, ...]) -> tuple[str, object] | None:
        """Return the first attribute among names, with its name."""
        node = self.node(key)
        if node is None:
            return None
        return next(((name, node.attrs[name]) for name in names if name in node.attrs), None)

    def datasets(self, key: str = "") -> list[DatasetShape]:
        """Return the datasets below a group with a row an instant. Pictures are left out."""
        h5py = extra("h5py", self.path)
        found: list[DatasetShape] = []
        queue, n_nodes = [(key.strip("/"), 0)], 0
        while queue and n_nodes < _MOST_NODES:
            at, depth = queue.pop(0)
            group = self.node(at)
            for name in group if isinstance(group, h5py.Group) else ():
                n_nodes += 1
                if not isinstance(group.get(name, getlink=True), h5py.HardLink):
                    continue
                inner, node = f"{at}/{name}".lstrip("/"), group[name]
                if isinstance(node, h5py.Group) and depth < _DEEPEST:
                    queue.append((inner, depth + 1))
                shape = self.shape(inner)
                if shape and shape[0] >= 2 and (len(shape) < 3 or shape[1:] == (4, 4)):
                    found.append(DatasetShape(inner, shape))
        return found

    def require(self, key: str) -> Any:
        """Return the group or dataset at a path.

        Raises
        ------
        DemonstrationError
            If there is none, as well as those of `node`.
        """
        node = self.node(key)
        if node is None:
            known = [dataset.key for dataset in self.datasets()]
            raise self.fault(key, "there is no such dataset", near_name(key, known))
        return node

    def array(self, key: str, shape: tuple[int | None, ...] = (None, None), exact: bool = False) -> NDArray:
        """Read a dataset of numbers.

        Parameters
        ----------
        key : its path
        shape : its shape, with None for any length; the first is the number of instants
        exact : whether to return the numbers as they are stored, instead of as float64

        Raises
        ------
        DemonstrationError
            If it is missing, no dataset of numbers, of another shape, too large, incomplete, or its
            numbers lie in another file.
        """
        h5py, dataset = extra("h5py", self.path), self.require(key)
        if not isinstance(dataset, h5py.Dataset):
            raise self.other(key, "it is a group, not a dataset", key)
        if dataset.is_virtual or dataset.external:
            raise self.fault(key, "its numbers lie in another file", "copy them into this one")
        if dataset.dtype.kind not in "iuf":
            kind = "text" if h5py.check_string_dtype(dataset.dtype) else str(dataset.dtype)
            if dataset.dtype.names:
                kind = f"records of {listed(dataset.dtype.names, SHOWN)}"
            raise self.other(key, f"it holds {kind}, not numbers")
        held = dataset.shape
        fits = held is not None and len(held) == len(shape)
        if not fits or any(wanted not in (None, n) for wanted, n in zip(shape, held, strict=True)):
            names = ("n_steps", "n_columns")
            expected = ", ".join(str(n or name) for n, name in zip(shape, names, strict=False))
            raise self.fault(key, f"it has shape {held}", f"give shape ({expected}{',' * (len(shape) == 1)})")
        claimed = max(math.prod(held), math.prod(dataset.chunks or ())) * max(dataset.dtype.itemsize, 8)
        if held[0] > MAX_ROWS or claimed > MAX_ARRAY_BYTES:
            message = f"it claims {dataset.dtype} of shape {held}"
            raise self.fault(key, message, f"up to {MAX_ROWS:,} rows are read")
        self._require_filled(key, dataset)
        if held[0] < 2:
            message = f"a movement needs two rows at least, this one has {held[0]}"
            raise self.fault(key, message, "record more samples, or remove the episode")
        return np.asarray(dataset[()]) if exact else np.asarray(dataset[()], dtype=np.float64)

    def _require_filled(self, key: str, dataset: Dataset) -> None:
        """Raise if a part of a dataset was never written. HDF5 would read it as zeros."""
        if dataset.chunks is None:
            missing = dataset.id.get_storage_size() < dataset.nbytes
        else:
            per_axis = [-(-n // chunk) for n, chunk in zip(dataset.shape, dataset.chunks, strict=True)]
            missing = dataset.id.get_num_chunks() < math.prod(per_axis)
        if missing:
            raise self.fault(key, "not all of it was written", "record or copy it again")


def _is_no_position(dataset: DatasetShape) -> bool:
    stem = dataset.key.rpartition("/")[2]
    return is_derived(stem) or read_columns([stem])[0].kind in (Kind.TIME, Kind.INDEX)


def _unlikely(dataset: DatasetShape) -> tuple[bool, ...]:
    """Return signs that a dataset is no end effector's movement, gravest first."""
    width = dataset.shape[1] if len(dataset.shape) == 2 else 1
    stem = dataset.key.rpartition("/")[2]
    (column, *_) = read_columns([f"{stem}_{i}" for i in range(3)])
    is_matrix = len(dataset.shape) == 3
    return (
        _is_no_position(dataset),
        column.kind is not Kind.POSITION,
        not is_matrix and width != 7,
        not is_matrix and width != 3,
        width == 1,
    )
