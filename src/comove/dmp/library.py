"""A folder of primitives, searched by distance from given properties.

The folder holds one file `NAME.dmp.json` per primitive; the file's name is the primitive's. Other files are ignored.

The distance between a movement and the wanted properties is the root of the sum of the squares of

- the shape distance to a given movement: both movements are sampled at 101 even shares of the duration, centred
  at the origin and scaled to unit root mean square; the distance is the root mean square after the best rotation
  (partial Procrustes distance: a metric on shapes, zero for similar movements, not for mirrored ones; at most sqrt(2)
  from two dimensions on);
- the distances of start and goal from the wanted ones, divided by the distance between the wanted start and goal;
  where only one is given (or both coincide), divided by the median distance between start and goal of the movements
  compared;
- ln(duration / wanted duration).
"""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from comove.arrays import Array
from comove.dmp.arguments import numbers, require_count, require_positive
from comove.dmp.demonstrations import Demonstration
from comove.dmp.demonstrations.units import in_base_unit, is_of_joints
from comove.dmp.dmp import DMP
from comove.dmp.files import Primitive, read_primitive, renamed, require_name, write_primitive
from comove.dmp.poses import PoseDMP
from comove.dmp.probabilistic import ProMP
from comove.dmp.variants import APART
from comove.errors import LibraryError, OptionError, near_name
from comove.io.files import require_room, telling
from comove.trajectory import interpolated

SUFFIX = ".dmp.json"

Movement = Primitive | DMP | PoseDMP | ProMP | Demonstration


@dataclass(frozen=True)
class Match:
    """A movement of a library, with its distance from the wanted properties.

    Attributes
    ----------
    name : name of the primitive
    distance : distance with all terms
    shape : Procrustes distance to the wanted shape; this and the following terms are None if not requested
    start, goal : distances from the wanted start and goal, in the movement's unit
    duration : ratio of the duration to the wanted one
    """

    name: str
    distance: float
    shape: float | None = None
    start: float | None = None
    goal: float | None = None
    duration: float | None = None


class Library:
    """A folder that holds primitives. Every method reads the present content of the folder.

    Parameters
    ----------
    folder : path of the folder; the first `add` makes it if it does not exist
    """

    def __init__(self, folder: str | os.PathLike[str]):
        self.folder = Path(folder)

    def __repr__(self) -> str:
        return f"Library({str(self.folder)!r})"

    @property
    def names(self) -> tuple[str, ...]:
        """Return the primitives' names, sorted, damaged ones included."""
        return tuple(sorted(name.removesuffix(SUFFIX) for name in self._entries() if _is_ours(name)))

    @property
    def foreign(self) -> tuple[str, ...]:
        """Return the other visible files in the folder, sorted."""
        ours = _is_ours
        return tuple(sorted(name for name in self._entries() if not ours(name) and not name.startswith(".")))

    @property
    def damaged(self) -> dict[str, LibraryError]:
        """Return the errors of the primitives that cannot be read, by name."""
        return self.read_all()[1]

    def __len__(self) -> int:
        return len(self.names)

    def __contains__(self, name: object) -> bool:
        return name in self.names

    def __iter__(self) -> Iterator[Primitive]:
        """Iterate over the primitives that can be read, by name; `damaged` has the errors of the others."""
        return iter(self.read_all()[0])

    def __getitem__(self, name: str) -> Primitive:
        return self.get(name)

    def read_all(self) -> tuple[list[Primitive], dict[str, LibraryError]]:
        """Return the readable primitives, and the others' errors by name."""
        primitives, damaged = [], {}
        for name in self.names:
            try:
                primitives.append(self.get(name))
            except LibraryError as error:
                damaged[name] = error
        return primitives, damaged

    def path(self, name: str) -> Path:
        """Return the path of a primitive's file, existing or not."""
        return self.folder / f"{require_name(name, self.folder)}{SUFFIX}"

    def get(self, name: str) -> Primitive:
        """Read a primitive.

        Raises
        ------
        LibraryError
            If there is no such primitive (the error proposes a similar name), or its file is damaged.
        """
        path = self.path(name)
        with telling(path, error=LibraryError):
            if not path.is_file():
                raise self._missing(name)
        return renamed(read_primitive(path), name)

    def add(self, primitive: Primitive, name: str | None = None, *, replace: bool = False) -> Path:
        """Add a primitive to the folder, completely or not at all. Other processes may add it at the same time.

        Parameters
        ----------
        name : its name in the library; by default its own
        replace : whether to replace the primitive of this name

        Returns
        -------
        Path
            Path of its file.

        Raises
        ------
        LibraryError
            If the name exists already, also in other capitals, or the file cannot be written.
        """
        name = primitive.name if name is None else name
        path = self.path(name)
        taken = [other for other in self.names if other.casefold() == name.casefold()]
        if taken and not (replace and taken == [name]):
            raise self._taken(taken[0])
        with telling(self.folder, "made", LibraryError):
            self.folder.mkdir(parents=True, exist_ok=True)
        try:
            write_primitive(path, renamed(primitive, name), replace=replace)
        except LibraryError as error:
            if isinstance(error.__cause__, FileExistsError):
                raise self._taken(name) from error
            raise
        return path

    def require_room(self) -> None:
        """Raise LibraryError if primitives cannot be added, before a long computation.

        Raises
        ------
        LibraryError
            If the folder is a file, not writable, or its disk is full.
        """
        with telling(self.folder, "written", LibraryError):
            if self.folder.exists() and not self.folder.is_dir():
                raise LibraryError("it is a file", file=self.folder, way_out="name a folder")
        require_room(self.folder / SUFFIX, LibraryError)

    def remove(self, name: str) -> None:
        """Delete a primitive, damaged or not.

        Raises
        ------
        LibraryError
            If there is no such primitive, or it cannot be deleted.
        """
        path = self.path(name)
        try:
            path.unlink()
        except FileNotFoundError:
            raise self._missing(name) from None
        except OSError as error:
            raise LibraryError(
                f"it cannot be deleted: {error.strerror}", file=path, way_out="ask for the right to do so"
            ) from error

    def find(
        self,
        *,
        start: ArrayLike | None = None,
        goal: ArrayLike | None = None,
        duration: float | None = None,
        shape: Movement | None = None,
        limit: int | None = None,
    ) -> list[Match]:
        """Rank the primitives by their distance from the wanted properties, nearest first.

        Primitives that have another dimension, and damaged ones, are left out; so are movements of joints, unless the
        wanted shape is one of joints.

        Parameters
        ----------
        start, goal : wanted ends, arrays, shape (n_dims,), [m]; in a movement's own unit if that is no length
        duration : wanted duration [s]
        shape : a movement with the wanted shape
        limit : largest number of matches; by default all

        Raises
        ------
        OptionError
            If nothing is wanted, or something is out of range.
        """
        given = (("start", start), ("goal", goal))
        wanted = {name: _point(name, value) for name, value in given if value is not None}
        if not wanted and duration is None and shape is None:
            raise OptionError("nothing is asked for", way_out="give a start, a goal, a duration or a shape")
        if duration is not None:
            require_positive("duration", duration, of="seconds")
        if limit is not None:
            require_count("limit", limit)
        dims = {len(point) for point in wanted.values()}
        if shape is not None:
            dims.add(_curve(shape).shape[1])
        if len(dims) > 1:
            raise OptionError(
                "start, goal and shape differ in their dimensions", way_out="give them in one dimension"
            )
        of_joints = shape is not None and is_of_joints(getattr(shape, "unit", "m"))
        primitives = [
            p
            for p in self
            if (not dims or p.positions.n_dims in dims) and (not dims or p.is_joints == of_joints)
        ]
        return _ranked(primitives, wanted, duration, shape)[:limit]

    def _entries(self) -> list[str]:
        with telling(self.folder, error=LibraryError):
            try:
                return [entry.name for entry in os.scandir(self.folder)]
            except FileNotFoundError:
                return []

    def _missing(self, name: str) -> LibraryError:
        names = self.names
        way_out = near_name(name, names) if names else "the library is empty: comove library add DEMO"
        return LibraryError(f"there is no primitive {name!r}", file=self.folder, way_out=way_out)

    def _taken(self, name: str) -> LibraryError:
        return LibraryError(
            f"there is a primitive {name!r} already",
            file=self.folder,
            way_out="choose another name, or replace it (--replace)",
        )


def _ranked(
    primitives: Sequence[Primitive], wanted: dict[str, Array], duration: float | None, shape: Movement | None
) -> list[Match]:
    """Return the matches of one dimension, nearest first, ties by name."""
    if not primitives:
        return []
    terms: dict[str, Array] = {}
    scaled: dict[str, Array] = {}
    if shape is not None:
        distances = shape_distances([_curve(p) for p in primitives], [_curve(shape)])
        terms["shape"] = scaled["shape"] = distances[:, 0]
    for name, point in wanted.items():
        ends = np.stack([in_base_unit(p.unit) * getattr(p.positions, name) for p in primitives])
        terms[name] = np.linalg.norm(ends - point, axis=1)
        scaled[name] = terms[name] / _way(wanted, primitives)
    if duration is not None:
        terms["duration"] = np.array([p.dmp.duration for p in primitives]) / duration
        scaled["duration"] = np.log(terms["duration"])
    distance = np.sqrt(sum(term**2 for term in scaled.values()))
    matches = [
        Match(p.name, float(distance[i]), **{name: float(term[i]) for name, term in terms.items()})
        for i, p in enumerate(primitives)
    ]
    return sorted(matches, key=lambda match: (round(match.distance, 9), match.name))


def shape_distances(a: ArrayLike, b: ArrayLike) -> Array:
    """Compute the partial Procrustes distances between all curves of two sets.

    Parameters
    ----------
    a : array, shape (n_a, n_samples, n_dims)
    b : array, shape (n_b, n_samples, n_dims)

    Returns
    -------
    array, shape (n_a, n_b)
        Root mean square distance of the curves, each centred and of unit root mean square, after the best rotation.
        A curve that does not move has distance 1 from all that do.
    """
    a, b = _normalised(np.asarray(a, dtype=float)), _normalised(np.asarray(b, dtype=float))
    products = np.einsum("itx,jty->ijxy", a, b)
    left, _, right = np.linalg.svd(products)
    mirrors = np.linalg.det(left @ right) < 0
    left[..., -1] *= np.where(mirrors, -1.0, 1.0)[..., None]
    rotation = left @ right
    # The sum of squares itself: from the singular values alone, half of the digits would be lost near zero.
    apart = a[:, None] - np.einsum("jty,ijxy->ijtx", b, rotation)
    return np.sqrt((apart**2).sum(axis=(2, 3)))


def _normalised(curves: Array) -> Array:
    centred = curves - curves.mean(axis=1, keepdims=True)
    size = np.sqrt((centred**2).sum(axis=(1, 2), keepdims=True))
    reach = np.abs(curves).max(axis=(1, 2), keepdims=True)
    return np.where(size > 1e-12 * reach, centred / np.where(size > 0, size, 1.0), 0.0)


def _curve(movement: Movement, n_samples: int = 101) -> Array:
    """Return the positions at even shares of the duration; array, shape (n_samples, n_dims)."""
    if isinstance(movement, Demonstration):
        even = np.linspace(0.0, movement.duration, n_samples)
        return interpolated(even, movement.time, movement.position)
    dmp = movement.positions if isinstance(movement, Primitive) else movement
    if isinstance(dmp, ProMP):
        dmp = dmp.mean
    dmp = dmp.translation if isinstance(dmp, PoseDMP) else dmp
    if not isinstance(dmp, DMP):
        raise OptionError(f"shape = {movement!r}", way_out="give a primitive, a DMP or a Demonstration")
    return dmp.at(np.linspace(0.0, dmp.duration, n_samples)).position


def _point(name: str, value: ArrayLike) -> Array:
    point = numbers(value)
    if point.ndim != 1 or not len(point) or not np.isfinite(point).all():
        raise OptionError(f"{name} = {value!r}", way_out="give finite numbers, one for each coordinate")
    return point


def _way(wanted: dict[str, Array], primitives: Sequence[Primitive]) -> float:
    """Return the divisor of distances of ends: their displacement, or more if noise."""
    movements = [p.positions for p in primitives]
    if len(wanted) == 2:
        way = float(np.linalg.norm(wanted["goal"] - wanted["start"]))
    else:
        way = float(np.median([np.linalg.norm(dmp.goal - dmp.start) for dmp in movements]))
    return max(way, APART * float(np.median([dmp.extent for dmp in movements]))) or 1.0


def _is_ours(name: str) -> bool:
    if not name.endswith(SUFFIX):
        return False
    try:
        require_name(name.removesuffix(SUFFIX))
    except LibraryError:
        return False
    return True
