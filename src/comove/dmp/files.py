"""JSON files of learned primitives, with origin and checksum.

Numbers are written in full precision: reading returns bit for bit the numbers written, and equal primitives make
equal files. `sha256` covers everything else in the file. `trace` holds points of the movement, so that weights of
another basis are detected, and other programs can draw the movement.
"""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from typing import Any, cast

import numpy as np

from comove._version import __version__
from comove.arrays import Array
from comove.brief import brief
from comove.dmp.averaging import AveragedDMP
from comove.dmp.cooperative import CooperativeDMP
from comove.dmp.demonstrations import Demonstration
from comove.dmp.demonstrations.units import is_of_joints
from comove.dmp.dmp import DMP
from comove.dmp.kinds import KINDS, Movement, kind_of, traced
from comove.dmp.pose_distributions import PoseProMP, PoseRecordings
from comove.dmp.poses import PoseDMP
from comove.dmp.probabilistic import ProMP, Recordings
from comove.dmp.system import Phase
from comove.dmp.variants import Variant
from comove.errors import LibraryError, OptionError, near_name, shortened
from comove.io.files import existing_file, telling, whole_file
from comove.io.keys import MAX_NAME

FORMAT, VERSION = "comove primitive", 1
MAX_BYTES = 8 * 2**20
TRACED = 11  # positions, at even shares of the duration
SAME = 1e-6  # by which the trace may be missed, in the movement's extent
LEARN_AGAIN = "learn it again: comove learn DEMO --out PRIMITIVE"
COPY_ANEW = f"copy it anew, or {LEARN_AGAIN}"


@dataclass(frozen=True)
class Provenance:
    """The origin of a learned primitive, and its fit error.

    Attributes
    ----------
    source : the recording's file name, or `lasa:SHAPE:DEMO`
    recording : name of the recording
    notes : how the recording was processed, in words
    sha256 : checksum of the recording's numbers
    n_samples : number of samples of the recording
    n_basis : number of shape weights per dimension
    error_rms, error_max : root-mean-square and largest distance between primitive and recording, in its unit
    turn_rms, turn_max : root-mean-square and largest angle between the orientations [rad]; None if none were learned
    version : version of comove
    """

    source: str
    recording: str
    notes: tuple[str, ...]
    sha256: str
    n_samples: int
    n_basis: int
    error_rms: float
    error_max: float
    turn_rms: float | None = None
    turn_max: float | None = None
    version: str = __version__


@dataclass(frozen=True, eq=False)
class Primitive:
    """A movement with a name and a history: a file's content.

    Attributes
    ----------
    name : name of the primitive
    dmp : the movement, of one end effector or of several that cooperate; an average or a distribution of movements
    unit : unit of its positions
    provenance : origin of a learned primitive; None if it was made in another way
    notes : how it was made otherwise, in words
    """

    __repr__ = brief

    name: str
    dmp: Movement
    unit: str = "m"
    provenance: Provenance | None = None
    notes: tuple[str, ...] = field(default=())

    @property
    def kind(self) -> str:
        """Return the kind: position, pose, distribution, poses, average or cooperative."""
        return kind_of(self.dmp).name

    @property
    def is_joints(self) -> bool:
        """Return whether it is a joint movement, not an end effector's."""
        return is_of_joints(self.unit)

    @property
    def followed(self) -> DMP | PoseDMP | ProMP:
        """Return the movement that a scene can follow.

        It is the mean of an average, the distribution of positions of one of poses, and of cooperating end effectors
        the payload's movement, or else the first one's.
        """
        if isinstance(self.dmp, PoseProMP):
            return self.dmp.positions
        if isinstance(self.dmp, AveragedDMP):
            return self.dmp.mean
        if isinstance(self.dmp, CooperativeDMP):
            return next(iter(self.dmp.movements.values()))
        return self.dmp

    @property
    def positions(self) -> DMP:
        """Return the followed positions; of a distribution the mean of all coordinates."""
        dmp = self.followed
        if isinstance(dmp, ProMP):
            return dmp.mean
        return dmp.translation if isinstance(dmp, PoseDMP) else dmp


def learn(
    demonstration: Demonstration,
    *,
    name: str = "",
    source: str = "",
    n_basis: int = 20,
    variant: Variant | str = Variant.CLOSED_FORM,
    phase: Phase | None = None,
    period: float | None = None,
    poses: bool = False,
    at_rest: bool = True,
) -> Primitive:
    """Fit a primitive to a recording, with origin and fit error.

    Parameters
    ----------
    demonstration : the recording
    name : name of the primitive; by default the recording's
    source : the recording's file name, which is stored in the provenance
    n_basis, variant, phase, period, at_rest : as for `DMP.fit`
    poses : learn orientations as well

    Raises
    ------
    DemonstrationError, OptionError
        As `DMP.fit` and `PoseDMP.fit`.
    """
    if poses and period is not None:
        raise OptionError(f"period = {period!r} of poses", way_out="leave it out")
    options: dict[str, Any] = {"n_basis": n_basis, "variant": variant, "phase": phase, "at_rest": at_rest}
    dmp = PoseDMP.fit(demonstration, **options) if poses else DMP.fit(demonstration, period=period, **options)
    measures: dict[str, Any] = {}
    errors = dmp.fit_error(demonstration)
    for what, error in zip(
        ("error", "turn"), errors if isinstance(errors, tuple) else (errors,), strict=False
    ):
        measures |= {f"{what}_rms": error.rms, f"{what}_max": error.largest}
    provenance = Provenance(
        source=source,
        recording=demonstration.name,
        notes=demonstration.notes,
        sha256=checksum(demonstration),
        n_samples=demonstration.n_steps,
        n_basis=int(n_basis),
        **measures,
    )
    return Primitive(name or demonstration.name, dmp, demonstration.unit, provenance)


def learn_distribution(
    demonstrations: Recordings,
    *,
    name: str,
    sources: Sequence[str] = (),
    n_basis: int = 20,
    phase: Phase | None = None,
    alignment: str = "duration",
    poses: bool = False,
) -> Primitive:
    """Fit a distribution of movements to several recordings, with their origin.

    Parameters
    ----------
    demonstrations : recordings, or mappings of them by the names of manipulators
    name : name of the primitive
    sources : the recordings' names, which are noted
    n_basis, phase, alignment : as for `ProMP.fit`
    poses : learn orientations as well

    Raises
    ------
    DemonstrationError, OptionError
        As `ProMP.fit`.
    """
    options: dict[str, Any] = {"n_basis": n_basis, "phase": phase, "alignment": alignment}
    found: PoseProMP | ProMP
    if poses:
        found = PoseProMP.fit(cast(PoseRecordings, demonstrations), **options)
    else:
        found = ProMP.fit(demonstrations, **options)
    first = demonstrations[0]
    unit = getattr(next(iter(first.values())) if isinstance(first, Mapping) else first, "unit", "m")
    notes = (*found.notes, f"learned by comove {__version__}", *(f"from {source}" for source in sources))
    return Primitive(name, found, unit, notes=notes)


def checksum(demonstration: Demonstration) -> str:
    """Return the SHA-256 of a recording's times, positions and orientations."""
    digest = hashlib.sha256()
    for array in (demonstration.time, demonstration.position, demonstration.orientation):
        if array is not None:
            digest.update(f"{array.shape}\n".encode() + np.ascontiguousarray(array, dtype="<f8").tobytes())
    return digest.hexdigest()


def write_primitive(path: str | os.PathLike[str], primitive: Primitive, *, replace: bool = True) -> None:
    """Write a primitive to a file, completely or not at all.

    Parameters
    ----------
    path : path of the file, usually ending in .json
    replace : whether to replace an existing file; otherwise an existing file is an error, even one made during the
        call by another process

    Raises
    ------
    LibraryError
        If the file cannot be written or exists already, or the primitive holds values that could not be read again.
    """
    data = dumps(primitive, path)
    with whole_file(path, LibraryError, replace=replace) as file:
        file.write(data)


def read_primitive(path: str | os.PathLike[str]) -> Primitive:
    """Read a primitive from a file.

    Raises
    ------
    LibraryError
        If the file is missing, not a primitive, incomplete or changed; names the key and a hint.
    """
    path = existing_file(path, MAX_BYTES, "name the file of a primitive", LibraryError)
    with telling(path, error=LibraryError):
        data = path.read_bytes()
    return loads(data, path)


def is_primitive(path: str | os.PathLike[str]) -> bool:
    """Return whether a file declares itself a primitive, valid or not."""
    try:
        with open(path, "rb") as file:
            return f'"format": "{FORMAT}"'.encode() in file.read(200)
    except (OSError, ValueError):
        return False


def dumps(primitive: Primitive, file: object = None) -> bytes:
    """Return the contents of a primitive's file."""
    content = {
        "format": FORMAT,
        "version": VERSION,
        "kind": primitive.kind,
        "name": primitive.name,
        "unit": primitive.unit,
        "movement": kind_of(primitive.dmp).write(primitive.dmp),
        "trace": _trace(primitive).tolist(),
        "provenance": None if primitive.provenance is None else asdict(primitive.provenance),
        "notes": list(primitive.notes),
    }
    try:
        content["sha256"] = _sha256(content)
    except ValueError as error:
        raise LibraryError(
            "the primitive holds numbers that are not finite", file=file, way_out="learn it again"
        ) from error
    _read(json.loads(json.dumps(content)), file)  # nothing is written that would be refused
    # What is no character is written as JSON does.
    data = (_laid_out(content) + "\n").encode(errors="backslashreplace")
    if len(data) > MAX_BYTES:
        raise LibraryError(
            f"the primitive would take {len(data) / 2**20:.0f} MB",
            file=file,
            way_out=f"learn it with fewer weights, for at most {MAX_BYTES // 2**20} MB",
        )
    return data


def loads(data: bytes, file: object = None) -> Primitive:
    """Read the primitive in the contents of a file; errors name `file`."""
    try:
        content = json.loads(data.decode())
    except (ValueError, RecursionError) as error:  # truncated, no text, or brackets without end
        at = f" in line {error.lineno}" if isinstance(error, json.JSONDecodeError) else ""
        raise LibraryError(f"it breaks off or is no JSON{at}", file=file, way_out=COPY_ANEW) from error
    if not isinstance(content, dict) or content.get("format") != FORMAT:
        raise LibraryError(
            "it is no primitive of comove", file=file, key="format", way_out=f"{FORMAT!r} belongs there"
        )
    if content.get("version") != VERSION or isinstance(content["version"], bool):
        raise LibraryError(
            f"the version {shortened(repr(content.get('version')))} is not known",
            file=file,
            key="version",
            way_out=f"this comove {__version__} reads version {VERSION}: update it, or {LEARN_AGAIN}",
        )
    return _read(content, file)


def require_name(name: str, file: object = None) -> str:
    """Return `name` if it is a valid file name on every system.

    Raises
    ------
    LibraryError
        If it is empty, too long, hidden, or holds anything but letters, digits, blanks and ``. _ + -``.
    """
    fit = (
        isinstance(name, str) and 0 < len(name) <= MAX_NAME and name[0] not in ". -+" and name[-1] not in ". "
    )
    if (
        not fit
        or ".." in name
        or not all(c.isalnum() or c in " ._+-" for c in name)
        or not name.isprintable()
    ):
        raise LibraryError(
            f"{shortened(repr(name))} cannot name a primitive",
            file=file,
            key="name",
            way_out=f"begin with a letter or digit; up to {MAX_NAME} letters, digits, blanks and . _ + -",
        )
    return name


def _read(content: dict[str, Any], file: object) -> Primitive:
    """Return the primitive of unchanged contents, checked against its trace."""
    try:
        unchanged = content.get("sha256") == _sha256(content)
    except (ValueError, RecursionError):  # what is not finite, or nested without end, was never written
        unchanged = False
    if not unchanged:
        message = "the file was changed: its checksum does not fit"
        raise LibraryError(message, file=file, key="sha256", way_out=COPY_ANEW)
    kind = str(content.get("kind"))
    if kind not in KINDS:
        raise LibraryError(
            f"{shortened(repr(kind))} is not known", file=file, key="kind", way_out=near_name(kind, KINDS)
        )
    with np.errstate(over="ignore", invalid="ignore"):
        try:
            primitive = _built(content, file)
            trace, played = np.array(content["trace"], dtype=float), _trace(primitive)
            extent = max(np.ptp(trace, axis=0).max(), np.abs(trace).max(), 1e-300)
            missed = np.abs(played - trace).max() / extent
        except (KeyError, TypeError, ValueError, AttributeError, OverflowError, OptionError) as error:
            message = "no movement can be made of what it holds"
            raise LibraryError(message, file=file, key="movement", way_out=LEARN_AGAIN) from error
    if not missed <= SAME:
        raise LibraryError(
            "the weights give another movement: they belong to another basis",
            file=file,
            key="trace",
            way_out=LEARN_AGAIN,
        )
    return primitive


def _built(content: dict[str, Any], file: object) -> Primitive:
    """Build the primitive; the movement checks itself."""
    if content["movement"].get("constraints"):
        raise LibraryError(
            "its hands are held by constraints, which primitives do not keep any more",
            file=file,
            key="constraints",
            way_out=f"write them into a scene, whose motions keep them, and {LEARN_AGAIN}",
        )
    provenance = content["provenance"]
    if provenance is not None:
        provenance = Provenance(**{**provenance, "notes": tuple(provenance["notes"])})
    return Primitive(
        require_name(content["name"], file),
        KINDS[content["kind"]].read(content["movement"]),
        str(content["unit"]),
        provenance,
        tuple(map(str, content["notes"])),
    )


def _trace(primitive: Primitive) -> Array:
    return traced(primitive.dmp, np.linspace(0.0, primitive.dmp.duration, TRACED))


def _sha256(content: Mapping[str, Any]) -> str:
    """Return the checksum of all other entries, as JSON with sorted keys."""
    sealed = {key: value for key, value in content.items() if key != "sha256"}
    text = json.dumps(sealed, sort_keys=True, separators=(",", ":"), allow_nan=False)
    return hashlib.sha256(text.encode()).hexdigest()


def _laid_out(value: Any, indent: str = "") -> str:
    """Format JSON with a line per entry, or per list of numbers."""
    inner = indent + "  "
    if isinstance(value, dict) and value:
        lines = [f"{inner}{json.dumps(key)}: {_laid_out(entry, inner)}" for key, entry in value.items()]
        return "{\n" + ",\n".join(lines) + f"\n{indent}}}"
    if isinstance(value, (list, tuple)) and any(isinstance(entry, (list, str)) for entry in value):
        return "[\n" + ",\n".join(inner + _laid_out(entry, inner) for entry in value) + f"\n{indent}]"
    return json.dumps(value, ensure_ascii=False, allow_nan=False)


def renamed(primitive: Primitive, name: str) -> Primitive:
    """Return the same primitive under another name."""
    return replace(primitive, name=require_name(name))
