"""Result folder with `solution.npz`, `solution.json` and pictures.

A folder is written as a draft beside its place (see `comove.io.drafts`), so it appears as a whole or not
at all.
"""

from __future__ import annotations

import errno
import hashlib
import json
import math
import os
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any, get_args

import numpy as np
from numpy.typing import NDArray

from comove._version import __version__
from comove.coordination.coordinates import COORDINATES, coordinates_for
from comove.coordination.motion import CoordinatedMotion
from comove.errors import DemonstrationError, OptionError, ResultError, shortened
from comove.io import drafts, files
from comove.io.arrays import read_arrays
from comove.io.entries import (
    COUNT,
    MAPPING,
    NUMBER,
    TEXT,
    TEXTS,
    TRUTH,
    agrees,
    number,
    require_types,
    require_unedited,
)
from comove.io.files import refusal, require_room, telling
from comove.planning.objective import Objective
from comove.planning.objectives import OBJECTIVES, OwnFunctions, PaperCost
from comove.planning.objectives.own import name_of
from comove.planning.solution import Solution
from comove.primitives.basis import Metric, MotionBasis, motion_basis
from comove.primitives.phase import ExponentialPhase, LinearPhase, Phase
from comove.scenes.scene import Scene
from comove.ties import first_largest
from comove.trajectory import Trajectory
from comove.verification.smoothness import smoothness
from comove.verification.verify import Report, Verdict, verify

Array = NDArray[np.float64]

ARRAYS, SUMMARY, SCENE = "solution.npz", "solution.json", "scene.json"
FILES = {ARRAYS, SUMMARY, "motion.png", "progress.png"}
RUN_ARRAYS, RUN_SUMMARY = "run.npz", "run.json"
FILES |= {RUN_ARRAYS, RUN_SUMMARY, "run.png", "run.gif"}  # of an execution
FILES |= {f"comparison.{suffix}" for suffix in ("json", "png", "gif")}
FILES |= {"joints.npz", "robot.json", SCENE, "joints.png"}  # of a robot
FILES |= {f"simulation.{suffix}" for suffix in ("json", "npz", "png", "mp4", "gif")}
FILES |= {f"{part}.csv{more}" for part in ("baxter", "approach", "release") for more in ("", ".json")}
FILES |= {
    f"motion{part}{suffix}"
    for part in ("", "_approach", "_release")
    for suffix in ("", ".csv", ".csv.json", ".npz", ".bag", ".mcap")
}
ROOM = 2_000_000  # bytes that a result may take, pictures and all
TERMS = ("goal", "velocity", "obstacle", "resemblance")
RECOMPUTED = TERMS[:3]  # the last one is measured against a movement that is not in the folder
USUAL = PaperCost()
NAMES = {kind: name for name, kind in OBJECTIVES.items()}
UNSUMMED = {"summary_sha256", "time_to_first_verified_s", "wall_time_s"}
SAMPLES = ("time", "position", "velocity", "manipulators")
CURVE = ("coordinates", "weights", "start", "goal", "basis_functions", "basis_metric", "basis_phase")
REBUILT = 1e-11  # m and m/s, by which samples may differ from the curve rebuilt on another machine
SAME = 1e-6  # relative, by which measures may differ from those of the summary
JERK = ("jerk_max", "jerk_squared")  # that a summary says of the motion whatever the scene asks
SMOOTH = 1e-5  # relative, of measures that take differences of accelerations


@dataclass(frozen=True, eq=False)
class StoredResult:
    """Contents of a result folder.

    Attributes
    ----------
    folder : path of the folder
    summary : the contents of solution.json
    arrays : the contents of solution.npz
    """

    folder: Path
    summary: dict[str, Any]
    arrays: dict[str, NDArray]

    @property
    def trajectory(self) -> Trajectory:
        """Return the samples of the motion."""
        names = tuple(str(name) for name in self.arrays["manipulators"])
        return Trajectory(self.arrays["time"], self.arrays["position"], self.arrays["velocity"], names)


@dataclass(frozen=True)
class Contents:
    """Description of the files in a kind of folder.

    Attributes
    ----------
    what : name of the kind in messages
    marks : files by which it is recognised: at least one of them is present
    names : all files that may be in such a folder, relative to it
    """

    what: str
    marks: frozenset[str]
    names: frozenset[str]


RESULT = Contents("result", frozenset({SUMMARY, RUN_SUMMARY}), frozenset(FILES))


def check_target(folder: str | Path, contents: Contents = RESULT) -> Path:
    """Check that a result, or a folder of the kind `contents`, may be written to `folder`, and return its resolved
    path.

    Raises
    ------
    ResultError
        If `folder` is a file, holds other files, or is not writable.
    """
    folder = _resolved(folder)
    with telling(folder, "written", ResultError):
        if folder.exists() and not folder.is_dir():
            raise ResultError("it is a file", file=folder, way_out="name a folder")
        if folder.is_dir():
            _require_only(folder, contents)
    require_room(folder, ResultError, ROOM)
    return folder


def _resolved(folder: str | Path) -> Path:
    """Return the path to which links lead."""
    try:
        return Path(folder).resolve()
    except (OSError, RuntimeError, ValueError) as error:
        if isinstance(error, RuntimeError):  # how Python 3.11 and 3.12 tell it
            error = OSError(errno.ELOOP, os.strerror(errno.ELOOP))
        why, way_out = (
            refusal(error, Path(folder)) if isinstance(error, OSError) else (str(error), "name a folder")
        )
        raise ResultError(f"it cannot be written: {why}", file=folder, way_out=way_out) from error


def _require_only(folder: Path, contents: Contents) -> None:
    """Refuse a folder that cannot be replaced as a whole without loss."""
    names = {entry.name for entry in folder.iterdir()}
    if names and not names & contents.marks:
        raise ResultError(
            f"the folder is not empty and holds no {contents.what}",
            file=folder,
            way_out="name another or empty it",
        )
    known = contents.names | {str(parent) for name in contents.names for parent in Path(name).parents}
    others = (
        names - known
        or {path.relative_to(folder).as_posix() for name in names for path in (folder / name).rglob("*")}
        - known
    )
    if others:
        raise ResultError(
            f"besides a {contents.what} the folder holds '{min(others)}'",
            file=folder,
            way_out="name another folder or move that away",
        )
    if os.path.ismount(folder):
        raise ResultError(
            "it is a mount point, which cannot be replaced as a whole",
            file=folder,
            way_out=f"name a folder in it, such as {folder / 'result'}",
        )
    if folder == Path.cwd():
        raise ResultError(
            "it is the folder that you are in, and would be replaced as a whole",
            file=folder,
            way_out="name a folder in it",
        )
    if not os.access(folder, os.W_OK | os.X_OK):
        raise ResultError("you may not write it", file=folder, way_out="name a folder that you may write")


@contextmanager
def whole_folder(folder: str | Path, contents: Contents = RESULT) -> Iterator[Path]:
    """Lend a draft folder, which replaces `folder` as a whole when all went well, and is deleted otherwise."""
    folder = check_target(folder, contents)
    made = []
    try:
        with telling(folder, "written", ResultError):
            made = _make(folder.parent)
        with files.whole_folder(
            folder, ResultError, check=lambda path: _require_only(path, contents)
        ) as draft:
            yield draft
    finally:
        for parent in made:
            with suppress(OSError):
                parent.rmdir()


def _make(folder: Path) -> list[Path]:
    """Make a folder and its missing parents; returns the folders that were made, the innermost first."""
    made = [path for path in (folder, *folder.parents) if not path.exists()]
    folder.mkdir(parents=True, exist_ok=True)
    return made


def write_solution(solution: Solution, folder: Path, wall_time_s: float) -> dict[str, Any]:
    """Write `solution.npz` and `solution.json` into an existing folder, and return the summary."""
    arrays = motion_arrays(solution.attempt)
    with open(folder / ARRAYS, "wb") as file:
        np.savez(file, **arrays)
    summary = summary_of(solution, arrays, wall_time_s)
    summary["summary_sha256"] = _summary_checksum(summary)
    text = json.dumps(summary, indent=2, allow_nan=False)
    (folder / SUMMARY).write_text(text + "\n", encoding="utf-8")
    return summary


def motion_arrays(motion: CoordinatedMotion) -> dict[str, NDArray]:
    """Return the samples of a motion, and the arrays from which its curve is rebuilt exactly."""
    trajectory, basis = motion.trajectory(), motion.basis
    return {
        "time": trajectory.time,
        "position": trajectory.position,
        "velocity": trajectory.velocity,
        "manipulators": np.array(trajectory.manipulators),
        "coordinates": np.array(motion.coordinates.kind),
        "weights": motion.weights,
        "start": motion.boundary[:2],
        "goal": motion.boundary[2:],
        "basis_functions": np.array(basis.n_basis),
        "basis_metric": np.array(basis.metric),
        "basis_phase": np.array(_phase_text(basis.phase)),
    }


def summary_of(solution: Solution, arrays: Mapping[str, NDArray], wall_time_s: float) -> dict[str, Any]:
    """Return the contents of solution.json."""
    report, cost = solution.report, solution.cost
    terms = {name: getattr(cost, name) for name in TERMS}
    return {
        "verified": solution.verified,
        "interrupted": solution.interrupted,
        "reasons": list(solution.reasons),
        "scene": solution.scene.name,
        "duration": solution.scene.duration,
        "method": solution.method,
        "seed": solution.seed,
        "version": __version__,
        "cost": cost.total,
        "cost_terms": terms,
        "cost_weights": _weights_of(terms, solution.attempt),
        **{name: _finite(value) for name, value in report.asdict().items()},
        "objective": _said_of(solution.objective),
        "demonstration": None if solution.followed is None else vars(solution.followed),
        **_smoothness_of(solution.attempt),
        "evaluations": solution.evaluations,
        "generations": solution.generations,
        **({"log": dict(solution.log)} if solution.log else {}),
        "time_to_first_verified_s": solution.time_to_first_verified_s,
        "wall_time_s": wall_time_s,
        "scene_sha256": solution.scene.sha256,
        "motion_sha256": checksum(arrays),
    }


def _smoothness_of(motion: CoordinatedMotion) -> dict[str, Any]:
    """Return the summary's measures of the smoothness of a motion."""
    measures = {name: _finite(value) for name, value in vars(smoothness(motion)).items()}
    return {name: measures.pop(name) for name in JERK} | {"smoothness": measures}


def _said_of(objective: object) -> dict[str, Any]:
    """Return the summary's description of the objective."""
    if not isinstance(objective, OwnFunctions):
        return {"type": NAMES[type(objective)], **vars(objective)}
    function = None if objective.function is None else name_of(objective.function)
    return {"type": "own", "function": function, "constraints": [name_of(c) for c in objective.constraints]}


def _weights_of(terms: Mapping[str, float], motion: CoordinatedMotion) -> dict[str, float]:
    """Compute the weights of those terms of J that follow from the motion; the usual weight where a term is 0."""
    weights = {}
    for name, unit in _unit_terms(motion).items():
        usual = getattr(USUAL, name)
        weight = terms[name] / unit if unit > 0 else usual
        weights[name] = usual if abs(weight - usual) <= SAME * usual else float(f"{weight:.12g}")
    return weights


def _unit_terms(motion: CoordinatedMotion) -> dict[str, float]:
    """Compute the terms of J that follow from the motion alone, each with weight 1."""
    cost = Objective(motion.scene, motion.coordinates, PaperCost(1.0, 1.0, 1.0)).cost(motion)
    return {name: getattr(cost, name) for name in RECOMPUTED}


def checksum(arrays: Mapping[str, NDArray]) -> str:
    """Compute the SHA-256 of arrays: their names, types, shapes and bytes."""
    digest = hashlib.sha256()
    for name in sorted(arrays):
        array = np.ascontiguousarray(arrays[name])
        digest.update(f"{name} {array.dtype.str} {array.shape}\n".encode())
        digest.update(array.tobytes())
    return digest.hexdigest()


def read_result(folder: str | Path) -> StoredResult:
    """Read a result folder.

    Raises
    ------
    ResultError
        If the folder is missing, incomplete or unreadable.
    """
    folder = Path(folder)
    return drafts.steadily(folder, lambda: _read(require_folder(folder, "comove solve")))


def require_folder(folder: Path, command: str) -> Path:
    """Return the folder of a result, after completing a replacement of it that was interrupted.

    Raises
    ------
    ResultError
        If there is none; the message names the `command` that makes it.
    """
    with telling(folder, error=ResultError):
        if not folder.is_dir() and not drafts.finish(_resolved(folder)):
            raise ResultError(
                "there is no such folder", file=folder, way_out=f"make it by: {command} SCENE --out DIR"
            )
    return folder


def _read(folder: Path) -> StoredResult:
    path = folder / SUMMARY
    if not path.is_file():
        raise ResultError(f"it holds no {SUMMARY}", file=folder, way_out="name the folder of a result")
    try:
        if path.stat().st_size > 2**20:
            raise ValueError("it is larger than 1 MB")
        summary = json.loads(path.read_text(encoding="utf-8"), parse_constant=_no_constant)
        if not isinstance(summary, dict):
            raise ValueError("it is no JSON object")
    except (OSError, ValueError, RecursionError) as error:
        raise ResultError(
            f"it cannot be read: {error}", file=path, way_out="solve the scene again"
        ) from error
    try:
        arrays = read_arrays(folder / ARRAYS, (*SAMPLES, *CURVE))
    except DemonstrationError as error:
        raise ResultError(
            error.message, file=folder / ARRAYS, key=error.key, way_out="solve the scene again"
        ) from error
    return StoredResult(folder, summary, arrays)


def rebuild(arrays: Mapping[str, NDArray], scene: Scene) -> CoordinatedMotion:
    """Rebuild the motion that a stored result describes, on `scene`.

    Raises
    ------
    ResultError
        If the arrays do not describe a motion on this scene.
    """
    name = str(arrays["coordinates"])
    if name not in COORDINATES:
        raise ResultError(f"unknown coordinates '{name}'", key="coordinates", way_out="solve the scene again")
    try:
        coordinates = coordinates_for(scene, name)
    except OptionError as error:
        raise ResultError(error.message, key="coordinates", way_out="verify it on its own scene") from error
    basis = _basis(arrays)
    expected = {
        "weights": (coordinates.n_columns, basis.n_basis),
        "start": (2, coordinates.n_columns),
        "goal": (2, coordinates.n_columns),
    }
    for key, shape in expected.items():
        array = arrays[key]
        if array.shape != shape or array.dtype.kind != "f" or not np.isfinite(array).all():
            raise ResultError(
                f"{array.dtype.name} of shape {array.shape} where finite numbers of shape {shape} belong",
                key=key,
                way_out="verify it on its own scene",
            )
    boundary = np.concatenate([arrays["start"], arrays["goal"]])
    return CoordinatedMotion(scene, coordinates, basis, boundary, arrays["weights"])


def verify_result(stored: StoredResult, scene: Scene) -> Verdict:
    """Judge a stored result anew, from its files and the scene alone.

    The motion is rebuilt from its weights, compared with its samples and judged; checksums and the measures
    in the summary must agree as well.
    """
    try:
        motion = rebuild(stored.arrays, scene)
    except ResultError as error:
        nothing = Report(-math.inf, math.inf, math.inf, math.inf, math.inf, math.inf)
        return Verdict(None, nothing, (f"the motion cannot be rebuilt on this scene: {error}",))
    verdict = verify(motion)
    reasons = list(verdict.reasons)
    reasons += _edited_samples(stored, motion)
    if stored.summary.get("motion_sha256") != checksum(stored.arrays):
        reasons.append(f"{ARRAYS} was edited: its checksum is not the one in {SUMMARY}")
    if stored.summary.get("summary_sha256") != _summary_checksum(stored.summary):
        reasons.append(f"{SUMMARY} was edited: its own checksum does not fit")
    if stored.summary.get("scene_sha256") != scene.sha256:
        reasons.append(
            "the scene is not the one that was solved: its checksum differs (options such as --duration that "
            "changed it must be given again)"
        )
    try:
        _require_entries(stored.summary, stored.folder / SUMMARY)
    except ResultError as error:
        reasons.append(f"{SUMMARY} was edited: {error.key}: {error.message}")
    if verdict.verified is not None and stored.summary.get("verified") is True:
        reasons += _edited_summary(stored.summary, verdict.report)
        reasons += _edited_cost(stored.summary, motion)
        reasons += _edited_smoothness(stored.summary, motion)
        if stored.summary.get("duration") not in (None, scene.duration):  # older results do not say it
            reasons.append(
                f"{SUMMARY} says a duration of {stored.summary['duration']} s, not {scene.duration} s"
            )
        if stored.summary.get("scene") != scene.name:
            reasons.append(f"{SUMMARY} names another scene: {shortened(str(stored.summary.get('scene')))}")
    elif stored.summary.get("verified") is not True:
        reasons.append(f"{SUMMARY} does not claim a verified motion")
    return Verdict(None if reasons else verdict.verified, verdict.report, tuple(reasons))


def filled_in(scene: Scene, stored: StoredResult) -> Scene:
    """Return the scene with its open duration and limits taken from the result's own scene.

    Raises
    ------
    ResultError
        If the result does not state them.
    """
    hasty = scene.file.objective is not None and scene.file.objective.type == "least_time"
    if scene.is_timed and not hasty:
        return scene
    path = stored.folder / SCENE
    try:
        said = json.loads(path.read_text(encoding="utf-8"))
        limits = {key: _positive(said["limits"][key]) for key, value in scene.file.limits if value is None}
        return scene.timed(_positive(said["duration"])).limited(**limits)
    except (OSError, ValueError, TypeError, KeyError, RecursionError) as error:
        raise ResultError(
            f"the scene leaves its duration open, and the result does not say it: {error}",
            file=path,
            way_out="solve the scene again",
        ) from error


def _positive(value: object) -> float:
    if not isinstance(value, (int, float)) or not 0 < value < math.inf:
        raise ValueError(f"{value!r} is not a positive number")
    return float(value)


def _edited_samples(stored: StoredResult, motion: CoordinatedMotion) -> list[str]:
    """List the samples that are not on the rebuilt curve, in words."""
    expected, reasons = motion_arrays(motion), []
    for name in SAMPLES:
        found, right = stored.arrays[name], expected[name]
        if found.shape != right.shape or found.dtype.kind != right.dtype.kind:
            reasons.append(f"'{name}' was edited: its shape is {found.shape}, the motion's is {right.shape}")
        elif right.dtype.kind == "U":
            if list(found) != list(right):
                reasons.append("the manipulators are not those of the scene")
        elif not np.abs(found - right).max() <= REBUILT:
            at = np.unravel_index(first_largest(np.abs(found - right)), right.shape)
            where = ", ".join(str(int(i)) for i in at)
            reasons.append(
                f"'{name}[{where}]' was edited: it is {float(found[at])!r}, the motion's is {float(right[at])!r}"
            )
    return reasons


def _edited_summary(summary: Mapping[str, Any], report: Report) -> list[str]:
    """List the measures of the summary that differ from those of the motion, in words."""
    reasons = []
    for name, right in report.asdict().items():
        stated = summary.get(name)
        if not agrees(stated, right, SAME * max(1e-3, abs(right))):
            reasons.append(f"{SUMMARY} says {name} = {shortened(str(stated))}, the motion's is {right:.9g}")
    return reasons


def _edited_smoothness(summary: Mapping[str, Any], motion: CoordinatedMotion) -> list[str]:
    """List the measures of smoothness that differ from those of the motion; results of earlier versions state
    none.
    """
    stated = summary.get("smoothness")
    if stated is None:
        return []
    right = _smoothness_of(motion)
    if not isinstance(stated, dict) or stated.keys() != right["smoothness"].keys():
        return [
            f"{SUMMARY} does not say how smooth the motion is: smoothness needs {', '.join(right['smoothness'])}"
        ]
    said = {name: (summary.get(name), right[name]) for name in JERK}
    said |= {f"smoothness.{name}": (stated[name], value) for name, value in right["smoothness"].items()}
    return [
        f"{SUMMARY} says {name} = {shortened(str(value))}, the motion's is {own}"
        for name, (value, own) in said.items()
        if not (
            value is own is None or (own is not None and agrees(value, own, SMOOTH * max(1e-3, abs(own))))
        )
    ]


def _edited_cost(summary: Mapping[str, Any], motion: CoordinatedMotion) -> list[str]:
    """List the terms of J that differ from those of the motion under the weights in the summary, in words."""
    terms, weights = summary.get("cost_terms"), summary.get("cost_weights", vars(USUAL))
    if not isinstance(terms, dict) or not isinstance(weights, dict):
        return [f"{SUMMARY} says nothing of the terms of J, or of their weights"]
    reasons, total, units = [], 0.0, _unit_terms(motion)
    for name in TERMS:
        stated, weight = number(terms.get(name)), number(weights.get(name, 0.0))
        if stated is None or weight is None or min(stated, weight) < 0:
            reasons.append(f"{SUMMARY} says {shortened(str(terms.get(name)))} of the cost's term '{name}'")
            continue
        total += stated
        if name in RECOMPUTED:
            right = weight * units[name]
            if not agrees(stated, right, SAME * max(1e-3, right)):
                reasons.append(f"{SUMMARY} says cost_terms.{name} = {stated}, the motion's is {right:.9g}")
    if not reasons and not agrees(summary.get("cost"), total, SAME * max(1e-3, total)):
        reasons.append(
            f"{SUMMARY} says cost = {shortened(str(summary.get('cost')))}, its terms make {total:.9g}"
        )
    return reasons


def require_whole(stored: StoredResult) -> StoredResult:
    """Return `stored` if it may be shown: its checksums fit, and all entries have their types.

    Raises
    ------
    ResultError
        If a checksum does not fit, or an entry is of another type; the message names it.
    """
    summary, file = stored.summary, stored.folder / SUMMARY
    if summary.get("motion_sha256") != checksum(stored.arrays):
        raise ResultError(
            f"its checksum is not the one in {SUMMARY}",
            file=stored.folder / ARRAYS,
            way_out="solve the scene again",
        )
    require_unedited(summary, _summary_checksum(summary), file)
    _require_entries(summary, file)
    return stored


def _require_entries(summary: Mapping[str, Any], file: Path) -> None:
    """Refuse a summary with missing entries, or entries of another type."""
    require_types(summary, _TYPES, file)
    require_types(summary["cost_terms"], dict.fromkeys(TERMS, NUMBER), file, "cost_terms.")
    require_types(summary.get("cost_weights") or {}, {}, file, "cost_weights.", others=NUMBER)
    for key in ("smoothness", "demonstration"):
        require_types(summary.get(key) or {}, {}, file, f"{key}.", others=NUMBER.or_nothing)


_TYPES = (
    dict.fromkeys(("scene", "method", "version", "scene_sha256"), TEXT)
    | dict.fromkeys(("seed", "evaluations", "generations"), COUNT)
    | {"verified": TRUTH, "interrupted": TRUTH, "reasons": TEXTS, "cost": NUMBER}
    | {
        "objective": MAPPING.or_nothing,
        "smoothness": MAPPING.or_nothing,
        "demonstration": MAPPING.or_nothing,
        "jerk_squared": NUMBER.or_nothing,
    }
    | {"cost_terms": MAPPING, "cost_weights": MAPPING.or_nothing}
    | {field.name: NUMBER.or_nothing for field in fields(Report)}
    | dict.fromkeys(("time_to_first_verified_s", "wall_time_s"), NUMBER.or_nothing)
)


def _basis(arrays: Mapping[str, NDArray]) -> MotionBasis:
    try:
        count, metric = int(arrays["basis_functions"]), str(arrays["basis_metric"])
        if metric not in get_args(Metric):
            raise ValueError(f"unknown metric '{metric}'")
        return motion_basis(count, metric, _phase(str(arrays["basis_phase"])))
    except (TypeError, ValueError) as error:
        raise ResultError(str(error), key="basis", way_out="solve the scene again") from error


def _phase_text(phase: Phase) -> str:
    return "linear" if isinstance(phase, LinearPhase) else f"exponential {phase.alpha!r}"


def _phase(text: str) -> Phase:
    name, _, alpha = text.partition(" ")
    if name == "linear":
        return LinearPhase()
    if name == "exponential":
        try:
            return ExponentialPhase(float(alpha))
        except OptionError as error:
            raise ValueError(str(error)) from error
    raise ValueError(f"unknown phase '{text}'")


def _summary_checksum(summary: Mapping[str, Any]) -> str:
    """Compute the SHA-256 of all entries but the checksum itself and the times, which differ between runs."""
    entries = {key: value for key, value in summary.items() if key not in UNSUMMED}
    return hashlib.sha256(json.dumps(entries, sort_keys=True).encode()).hexdigest()


def _finite(value: float) -> float | None:
    return value if math.isfinite(value) else None


def _no_constant(text: str) -> float:
    raise ValueError(f"it holds {text}")
