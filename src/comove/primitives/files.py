"""Files of learned primitives: JSON that holds the movement, its origin, and a checksum that reveals changes.

Numbers are written in full precision: reading returns bit for bit the numbers written, and equal primitives make
equal files. `sha256` covers everything else in the file. `trace` holds points of the movement, so that weights meant
for another basis are noticed, and other programs can draw the movement without any knowledge of primitives.
"""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, fields, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from comove._version import __version__
from comove.demonstrations import Demonstration
from comove.errors import LibraryError, OptionError, near_name
from comove.geometry.rotations import conjugate, quaternion_product
from comove.io.files import existing_file, telling, whole_file
from comove.primitives.basis import MAX_BASIS
from comove.primitives.dmp import DMP
from comove.primitives.phase import FASTEST, ExponentialPhase, LinearPhase, Phase
from comove.primitives.poses import PoseDMP
from comove.primitives.probabilistic import ProMP, Recordings
from comove.primitives.variants import Variant
from comove.trajectory import PoseTrajectory

Array = NDArray[np.float64]

FORMAT, VERSION = "comove primitive", 1
MAX_BYTES = 8 * 2**20
MAX_NAME = 100
MAX_DIMS = 64
TRACED = 11  # positions, at even shares of the duration
SAME = 1e-6  # by which the trace may be missed, in the movement's extent
LEARN_AGAIN = "learn it again: comove learn DEMO --out PRIMITIVE"
COPY_ANEW = f"copy it anew, or {LEARN_AGAIN}"


@dataclass(frozen=True)
class Provenance:
    """Holds the origin of a learned primitive and how well the primitive fits its recording.

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
    """A movement that has a name and a history: the content of one file.

    Attributes
    ----------
    name : name of the primitive
    dmp : the movement, or a distribution of movements
    unit : unit of its positions
    provenance : origin of a learned primitive; None if it was made in another way
    notes : how it was made otherwise, in words
    """

    name: str
    dmp: DMP | PoseDMP | ProMP
    unit: str = "m"
    provenance: Provenance | None = None
    notes: tuple[str, ...] = field(default=())

    @property
    def kind(self) -> str:
        """Return the kind of the movement: "position", "pose", or "distribution"."""
        kinds = {PoseDMP: "pose", ProMP: "distribution"}
        return kinds.get(type(self.dmp), "position")

    @property
    def positions(self) -> DMP:
        """Return the movement of the position; of a distribution the mean, in all coordinates of its hands."""
        if isinstance(self.dmp, ProMP):
            return self.dmp.mean
        return self.dmp.translation if isinstance(self.dmp, PoseDMP) else self.dmp


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
) -> Primitive:
    """Fit a primitive to a recording, and note its origin and how well it fits.

    Parameters
    ----------
    demonstration : the recording
    name : name of the primitive; by default the recording's
    source : the recording's file name, which is stored in the provenance
    n_basis, variant, phase, period : as for `DMP.fit`
    poses : learn orientations as well

    Raises
    ------
    DemonstrationError, OptionError
        As `DMP.fit` and `PoseDMP.fit`.
    """
    if poses and period is not None:
        raise OptionError(f"period = {period!r} of poses", way_out="leave it out")
    dmp: DMP | PoseDMP
    if poses:
        dmp = PoseDMP.fit(demonstration, n_basis=n_basis, variant=variant, phase=phase)
    else:
        dmp = DMP.fit(demonstration, n_basis=n_basis, variant=variant, phase=phase, period=period)
    measures: dict[str, Any] = {}
    for what, error in _errors(dmp, demonstration).items():
        measures |= {f"{what}_rms": float(np.sqrt((error**2).mean())), f"{what}_max": float(error.max())}
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
) -> Primitive:
    """Fit a distribution of movements to several recordings, and note their origin.

    Parameters
    ----------
    demonstrations : recordings, or mappings of them by the names of manipulators
    name : name of the primitive
    sources : the recordings' names, which are noted
    n_basis, phase, alignment : as for `ProMP.fit`

    Raises
    ------
    DemonstrationError, OptionError
        As `ProMP.fit`.
    """
    promp = ProMP.fit(demonstrations, n_basis=n_basis, phase=phase, alignment=alignment)
    first = demonstrations[0]
    unit = getattr(next(iter(first.values())) if isinstance(first, Mapping) else first, "unit", "m")
    notes = (*promp.notes, f"learned by comove {__version__}", *(f"from {source}" for source in sources))
    return Primitive(name, replace(promp, notes=()), unit, notes=notes)


def _errors(dmp: DMP | PoseDMP, demonstration: Demonstration, block_size: int = 20_000) -> dict[str, Array]:
    """Compute the distances from the recording at its samples, and angles for poses; arrays, shape (n_steps,).

    `block_size` samples are compared at a time, so that long recordings need no more memory.
    """
    error, turn = np.zeros((2, demonstration.n_steps))
    for first in range(0, demonstration.n_steps, block_size):
        block = slice(first, first + block_size)
        played = dmp.at(demonstration.time[block])
        error[block] = np.linalg.norm(played.position - demonstration.position[block], axis=1)
        if isinstance(played, PoseTrajectory) and demonstration.orientation is not None:
            between = quaternion_product(played.orientation, conjugate(demonstration.orientation[block]))
            turn[block] = 2 * np.arctan2(np.linalg.norm(between[:, 1:], axis=1), np.abs(between[:, 0]))
    return {"error": error, "turn": turn} if isinstance(dmp, PoseDMP) else {"error": error}


def checksum(demonstration: Demonstration) -> str:
    """Return the SHA-256 of a recording: shapes and bytes of time, position and, if present, orientation."""
    digest = hashlib.sha256()
    for array in (demonstration.time, demonstration.position, demonstration.orientation):
        if array is not None:
            digest.update(f"{array.shape}\n".encode() + np.ascontiguousarray(array, dtype="<f8").tobytes())
    return digest.hexdigest()


def write_primitive(path: str | os.PathLike[str], primitive: Primitive, *, replace: bool = True) -> None:
    """Write a primitive to a file; if that fails, no partial file is left.

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
        If the file is missing, not a primitive, incomplete or changed; names the key and the way out.
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
    write, _ = _KINDS[primitive.kind]
    content = {
        "format": FORMAT,
        "version": VERSION,
        "kind": primitive.kind,
        "name": primitive.name,
        "unit": primitive.unit,
        "movement": write(primitive.dmp),
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
        content = json.loads(data.decode(), parse_constant=_no_constant, object_pairs_hook=_no_repetition)
    except RecursionError:
        content = None
    except ValueError as error:  # a truncated file, bytes that are no text, NaN, a key given twice
        at = f" in line {error.lineno}" if isinstance(error, json.JSONDecodeError) else ""
        what = "it breaks off or is no JSON" if at or isinstance(error, UnicodeDecodeError) else str(error)
        if what.startswith("Exceeds the limit"):
            what = "it holds a number of thousands of digits"
        raise LibraryError(what + at, file=file, way_out=COPY_ANEW) from error
    if not isinstance(content, dict) or content.get("format") != FORMAT:
        raise LibraryError(
            "it is no primitive of comove", file=file, key="format", way_out=f"{FORMAT!r} belongs there"
        )
    if content.get("version") != VERSION or isinstance(content["version"], bool):
        raise LibraryError(
            f"the version {_shown(content.get('version'))} is not known",
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
            f"{_shown(name)} cannot name a primitive",
            file=file,
            key="name",
            way_out=f"begin with a letter or digit; up to {MAX_NAME} letters, digits, blanks and . _ + -",
        )
    return name


def _read(content: dict[str, Any], file: object) -> Primitive:
    """Check everything except format and version, and return the primitive."""
    known = (
        "format",
        "version",
        "kind",
        "name",
        "unit",
        "movement",
        "trace",
        "provenance",
        "notes",
        "sha256",
    )
    part = _Part(content, "", file).with_keys(known)
    stated = part.text("sha256")
    kind = part.text("kind")
    if kind not in _KINDS:
        raise part.wrong("kind", f"{_shown(kind)} is not known", near_name(kind, _KINDS))
    name = require_name(part.text("name"), file)
    dmp = _KINDS[kind][1](part.part("movement"))
    primitive = Primitive(
        name, dmp, part.text("unit"), _provenance(part.value("provenance"), file), part.texts("notes")
    )
    trace = part.array("trace", (TRACED, _trace(primitive).shape[1]))
    found = _sha256({key: value for key, value in content.items() if key != "sha256"})
    if found != stated:
        raise part.wrong("sha256", "the file was changed: its checksum does not fit", COPY_ANEW)
    extent = max(np.ptp(trace, axis=0).max(), np.abs(trace).max(), 1e-300)
    with np.errstate(over="ignore", invalid="ignore"):
        missed = np.abs(_trace(primitive) - trace).max() / extent
    if not missed <= SAME:
        raise part.wrong(
            "trace", "the weights give another movement: they belong to another basis", LEARN_AGAIN
        )
    return primitive


def _trace(primitive: Primitive) -> Array:
    """Return the coordinates at even shares of the duration, position first; array, shape (TRACED, n_columns).

    Standard deviations follow the mean of a distribution.
    """
    parts = [primitive.positions]
    if isinstance(primitive.dmp, PoseDMP):
        parts.append(primitive.dmp.turning)
    time = np.linspace(0.0, primitive.dmp.duration, TRACED)
    if isinstance(primitive.dmp, ProMP):
        return np.concatenate([primitive.dmp.mean_at(time), primitive.dmp.std_at(time)], axis=1)
    return np.concatenate([part.at(time).position for part in parts], axis=1)


def _write_phase(phase: Phase) -> dict[str, Any]:
    if isinstance(phase, ExponentialPhase):
        return {"name": "exponential", "alpha": float(phase.alpha)}
    return {"name": "linear"}


def _write_position(dmp: DMP) -> dict[str, Any]:
    return {
        "variant": str(dmp.variant),
        "phase": _write_phase(dmp.phase),
        "duration": float(dmp.duration),
        **{name: getattr(dmp, name).tolist() for name in _VECTORS},
        "weights": dmp.weights.tolist(),
    }


def _read_position(part: _Part, n_dims: int | None = None) -> DMP:
    part.with_keys(("variant", "phase", "duration", *_VECTORS, "weights"))
    variant = part.text("variant")
    names = [known.value for known in Variant]
    if variant not in names:
        raise part.wrong("variant", f"{_shown(variant)} is not known", near_name(variant, names))
    duration = part.number("duration")
    if not duration > 0:
        raise part.wrong(
            "duration", f"{duration!r} is no duration", "a positive number of seconds belongs there"
        )
    weights = part.array("weights", (n_dims, None))
    n_dims, n_basis = weights.shape
    if n_dims > MAX_DIMS or n_basis > MAX_BASIS:
        way_out = f"at most {MAX_DIMS} lists of {MAX_BASIS} weights belong there"
        raise part.wrong("weights", f"{n_dims} lists of {n_basis} weights", way_out)
    vectors = {name: part.array(name, (n_dims,)) for name in _VECTORS}
    phase = _phase(part.part("phase"))
    return DMP(weights=weights, duration=duration, phase=phase, variant=Variant(variant), **vectors)


def _phase(part: _Part) -> Phase:
    name = part.text("name")
    if name == "linear":
        part.with_keys(("name",))
        return LinearPhase()
    if name != "exponential":
        raise part.wrong("name", f"{_shown(name)} is not known", near_name(name, ("linear", "exponential")))
    alpha = part.with_keys(("name", "alpha")).number("alpha")
    if not 0 < alpha <= FASTEST:
        way_out = f"a number above 0, at most {FASTEST:g}, belongs there"
        raise part.wrong("alpha", f"{alpha!r} is no decay rate", way_out)
    return ExponentialPhase(alpha)


def _write_pose(dmp: PoseDMP) -> dict[str, Any]:
    return {
        "translation": _write_position(dmp.translation),
        "turning": _write_position(dmp.turning),
        "reference_wxyz": np.asarray(dmp.reference).tolist(),
        "axis": None if dmp.axis is None else np.asarray(dmp.axis).tolist(),
    }


def _read_pose(part: _Part) -> PoseDMP:
    part.with_keys(("translation", "turning", "reference_wxyz", "axis"))
    axis = None if part.value("axis") is None else part.array("axis", (3,))
    translation = _read_position(part.part("translation"))
    if translation.n_dims not in (2, 3):
        message = f"a pose in {translation.n_dims} dimensions"
        raise part.wrong("translation.weights", message, "2 or 3 lists of weights belong there")
    turning = _read_position(part.part("turning"), 3 if axis is None else 1)
    if turning.duration != translation.duration:
        message = f"{turning.duration!r} is not the {translation.duration!r} of the translation"
        raise part.wrong("turning.duration", message, LEARN_AGAIN)
    reference = part.array("reference_wxyz", (4,))
    for key, vector in (("reference_wxyz", reference), ("axis", axis)):
        if vector is not None and not abs(np.linalg.norm(vector) - 1.0) <= 1e-9:
            raise part.wrong(key, f"its norm is {np.linalg.norm(vector):.6g}", "a unit vector belongs there")
    return PoseDMP(translation, turning, reference, axis)


def _write_distribution(promp: ProMP) -> dict[str, Any]:
    context = None
    if len(promp.context_mean):
        context = {name: getattr(promp, name).tolist() for name in _CONTEXT}
    return {
        "phase": _write_phase(promp.phase),
        "duration": float(promp.duration),
        "duration_std": float(promp.duration_std),
        "manipulators": list(promp.manipulators),
        "n_recordings": promp.n_recordings,
        "mean_parameters": promp.mean_parameters.tolist(),
        "noise": promp.noise.tolist(),
        "context": context,
        "covariance": promp.covariance.tolist(),
    }


def _read_distribution(part: _Part) -> ProMP:
    arrays = ("mean_parameters", "noise", "covariance")
    part.with_keys(("phase", "duration", "duration_std", "manipulators", "n_recordings", "context", *arrays))
    mean = part.array("mean_parameters", (None, None))
    context: dict[str, Any] = {}
    if part.value("context") is not None:
        inner = part.part("context").with_keys(_CONTEXT)
        means = inner.array("context_mean", (None,))
        context = {
            "context_mean": means,
            "context_std": inner.array("context_std", (len(means),)),
            "slopes": inner.array("slopes", (len(means), *mean.shape)),
        }
    n_recordings = part.value("n_recordings")
    try:
        return ProMP(
            mean,
            part.array("covariance", (mean.size, mean.size)),
            part.array("noise", (len(mean),)),
            duration=part.number("duration"),
            duration_std=part.number("duration_std"),
            phase=_phase(part.part("phase")),
            manipulators=part.texts("manipulators"),
            n_recordings=part.count("n_recordings") if n_recordings != 0 else 0,
            **context,
        )
    except OptionError as error:
        raise part.wrong("mean_parameters", error.message, LEARN_AGAIN) from error


_CONTEXT = ("context_mean", "context_std", "slopes")
_VECTORS = ("start", "goal", "start_velocity", "goal_velocity", "learned")
_KINDS: dict[str, tuple[Callable[[Any], dict[str, Any]], Callable[[_Part], Any]]]


def _provenance(value: object, file: object) -> Provenance | None:
    if value is None:
        return None
    part = _Part(value, "provenance", file).with_keys([f.name for f in fields(Provenance)])
    turns = {key: None if part.value(key) is None else part.number(key) for key in ("turn_rms", "turn_max")}
    return Provenance(
        source=part.text("source"),
        recording=part.text("recording"),
        notes=part.texts("notes"),
        sha256=part.text("sha256"),
        n_samples=part.count("n_samples"),
        n_basis=part.count("n_basis"),
        error_rms=part.number("error_rms"),
        error_max=part.number("error_max"),
        version=part.text("version"),
        **turns,
    )


@dataclass(frozen=True)
class _Part:
    """A mapping in the file, with methods that check and return its values; errors name file and key."""

    content: Any
    key: str
    file: object

    def __post_init__(self) -> None:
        if not isinstance(self.content, dict):
            raise LibraryError(
                f"{_shown(self.content)} is no mapping",
                file=self.file,
                key=self.key,
                way_out=COPY_ANEW,
            )

    def with_keys(self, known: Sequence[str]) -> _Part:
        """Raise unless the mapping has exactly these keys; return the part itself."""
        for key in self.content:
            if key not in known:
                raise self.wrong(key, "the key is not known", near_name(key, known))
        for key in known:
            self.value(key)
        return self

    def value(self, key: str) -> Any:
        if key not in self.content:
            raise self.wrong(key, "the key is missing", COPY_ANEW)
        return self.content[key]

    def part(self, key: str) -> _Part:
        return _Part(self.value(key), self._path(key), self.file)

    def text(self, key: str) -> str:
        value = self.value(key)
        if not isinstance(value, str) or len(value) > 10_000:
            raise self.wrong(key, f"{_shown(value)} is no text", "a text in quotes belongs there")
        return value

    def texts(self, key: str) -> tuple[str, ...]:
        value = self.value(key)
        if not isinstance(value, list) or not all(isinstance(entry, str) for entry in value):
            raise self.wrong(key, f"{_shown(value)} is no list of texts", "texts in quotes belong there")
        return tuple(value)

    def count(self, key: str) -> int:
        value = self.value(key)
        if isinstance(value, bool) or not isinstance(value, int) or value < 1:
            raise self.wrong(
                key, f"{_shown(value)} is no number of things", "a whole number from 1 on belongs there"
            )
        return value

    def number(self, key: str) -> float:
        return float(self.array(key, ()))

    def array(self, key: str, shape: tuple[int | None, ...]) -> Array:
        """Return finite numbers from nested lists as an array; None in `shape` stands for any length from 1 on."""
        value = self.value(key)
        found: tuple[int, ...] = ()
        level = [value]
        for wanted in shape:
            lengths = {len(entry) if isinstance(entry, list) else -1 for entry in level}
            if len(lengths) != 1 or min(lengths) < 1 or (wanted is not None and lengths != {wanted}):
                raise self._misshaped(key, value, shape)
            found += (lengths.pop(),)
            level = [entry for row in level for entry in row]
        for entry in level:
            if isinstance(entry, bool) or not isinstance(entry, (int, float)):
                raise self._misshaped(key, entry, shape)
            if not abs(entry) <= 1e300:
                raise self.wrong(key, f"{_shown(entry)} is not finite", "finite numbers belong there")
        return np.array(level, dtype=float).reshape(found)

    def wrong(self, key: str, message: str, way_out: str) -> LibraryError:
        return LibraryError(message, file=self.file, key=self._path(key), way_out=way_out)

    def _path(self, key: str) -> str:
        return f"{self.key}.{key}" if self.key else key

    def _misshaped(self, key: str, value: object, shape: tuple[int | None, ...]) -> LibraryError:
        sizes = " lists of ".join("some" if size is None else str(size) for size in shape)
        wanted = f"{sizes} numbers belong" if shape else "a number belongs"
        return self.wrong(key, f"{_shown(value)} has another shape", f"{wanted} there")


_KINDS = {
    "position": (_write_position, _read_position),
    "pose": (_write_pose, _read_pose),
    "distribution": (_write_distribution, _read_distribution),
}


def _sha256(content: Mapping[str, Any]) -> str:
    """Return the checksum of the canonical content: sorted keys, no blanks, numbers as Python's `repr`."""
    text = json.dumps(content, sort_keys=True, separators=(",", ":"), allow_nan=False)
    return hashlib.sha256(text.encode()).hexdigest()


def _laid_out(value: Any, indent: str = "") -> str:
    """Format JSON readably: one line per entry of a mapping or list of lists, one line per list of numbers."""
    inner = indent + "  "
    if isinstance(value, dict) and value:
        lines = [f"{inner}{json.dumps(key)}: {_laid_out(entry, inner)}" for key, entry in value.items()]
        return "{\n" + ",\n".join(lines) + f"\n{indent}}}"
    if isinstance(value, (list, tuple)) and any(isinstance(entry, (list, str)) for entry in value):
        return "[\n" + ",\n".join(inner + _laid_out(entry, inner) for entry in value) + f"\n{indent}]"
    return json.dumps(value, ensure_ascii=False, allow_nan=False)


def _shown(value: object) -> str:
    text = repr(value)
    return text if len(text) <= 60 else f"{text[:57]}..."


def _no_constant(text: str) -> float:
    raise ValueError(f"it holds {text}, which is no number")


def _no_repetition(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    content = dict(pairs)
    if len(content) < len(pairs):
        names = [name for name, _ in pairs]
        twice = next(name for name in names if names.count(name) > 1)
        raise ValueError(f"it holds the key {_shown(twice)} twice")
    return content


def renamed(primitive: Primitive, name: str) -> Primitive:
    """Return the same primitive under another name."""
    return replace(primitive, name=require_name(name))
