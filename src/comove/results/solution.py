"""A solution in a result folder: `solution.npz`, `solution.json` and pictures."""

from __future__ import annotations

import math
from dataclasses import fields
from pathlib import Path
from typing import Any, get_args

import numpy as np

import comove
from comove.arrays import Array, first_largest
from comove.dmp.basis import Metric, MotionBasis, motion_basis
from comove.dmp.system import ExponentialPhase, LinearPhase, Phase
from comove.errors import OptionError, ResultError, shortened
from comove.io.folders import Contents
from comove.model.coordinates import COORDINATES, coordinates_for, poses_at
from comove.model.motion import CoordinatedMotion
from comove.model.scene import Scene
from comove.results.reference import SCENE
from comove.results.sealed import (
    AGAIN,
    COUNT,
    MAPPING,
    NUMBER,
    TEXT,
    TEXTS,
    TRUTH,
    Arrays,
    ResultKind,
    Stored,
    Summary,
    agrees,
    finite,
    near,
    number,
    require_types,
)
from comove.trajectory import Trajectory
from comove.verification.measures import WEIGHTS, smoothness, unit_terms
from comove.verification.verify import Report, Verdict, verify

RESULT = Contents(
    what="result",
    marks=frozenset({"solution.json", "run.json", "robot_run.json"}),
    names=frozenset(
        ["solution.npz", "solution.json", "motion.png", "progress.png", SCENE]
        + ["run.npz", "run.json", "run.png", "run.gif"]  # of an execution
        + [f"robot_run.{suffix}" for suffix in ("npz", "json", "png", "mp4", "gif")]  # of a robot's
        + [f"comparison.{suffix}" for suffix in ("json", "png", "gif")]
        + ["joints.npz", "robot.json", "joints.png"]  # of a robot
        + [f"simulation.{suffix}" for suffix in ("json", "npz", "png", "mp4", "gif")]
        + [f"{part}.csv{more}" for part in ("baxter", "approach", "release") for more in ("", ".json")]
        + [
            f"motion{part}{suffix}"
            for part in ("", "_approach", "_release")
            for suffix in ("", ".csv", ".csv.json", ".npz", ".bag", ".mcap")
        ]
    ),
)
SAMPLES = ("time", "position", "velocity", "manipulators")
MORE_SAMPLES = ("acceleration", "center", "quaternion")  # results of earlier versions lack them
CURVE = ("coordinates", "weights", "start", "goal", "basis_functions", "basis_metric", "basis_phase")
REBUILT = 1e-11  # m and m/s, by which samples may differ from the curve rebuilt on another machine
REBUILT_RATE = 1e-10  # likewise accelerations [m/s^2], relative to the largest where that is above 1 m/s^2
JERK = ("jerk_max", "jerk_squared")  # that a summary says of the motion whatever the scene asks
SMOOTH = 1e-5  # relative, of measures that take differences of accelerations


def _require_entries(summary: Summary, file: Path) -> None:
    require_types(summary, _TYPES, file)
    require_types(summary["cost_terms"], dict.fromkeys(WEIGHTS, NUMBER), file, "cost_terms.")
    require_types(summary.get("cost_weights") or {}, {}, file, "cost_weights.", others=NUMBER)
    for key in ("smoothness", "demonstration"):
        require_types(summary.get(key) or {}, {}, file, f"{key}.", others=NUMBER.or_nothing)


_TYPES = (
    dict.fromkeys(("scene", "method", "version", "scene_sha256"), TEXT)
    | dict.fromkeys(("seed", "evaluations", "generations"), COUNT)
    | {"verified": TRUTH, "interrupted": TRUTH, "reasons": TEXTS, "cost": NUMBER, "cost_terms": MAPPING}
    | {"timed_out": TRUTH.or_nothing}
    | dict.fromkeys(("objective", "smoothness", "demonstration", "cost_weights"), MAPPING.or_nothing)
    | dict.fromkeys(("jerk_squared", "time_to_first_verified_s", "wall_time_s"), NUMBER.or_nothing)
    | {field.name: NUMBER.or_nothing for field in fields(Report)}
)

SOLUTION = ResultKind(
    summary="solution.json",
    arrays="solution.npz",
    checksum="motion_sha256",
    made_by="comove solve SCENE --out DIR",
    hint=AGAIN,
    required=(*SAMPLES, *CURVE),
    optional=MORE_SAMPLES,
    unsealed=("time_to_first_verified_s", "wall_time_s"),
    require_entries=_require_entries,
)


class StoredResult(Stored):
    """Contents of `solution.json` and `solution.npz`."""

    @property
    def trajectory(self) -> Trajectory:
        """Return the samples of the motion."""
        names = tuple(str(name) for name in self.arrays["manipulators"])
        return Trajectory(self.arrays["time"], self.arrays["position"], self.arrays["velocity"], names)

    def show(self) -> None:
        """Show the folder, verified anew, in a notebook or browser. See `comove.show`."""
        comove.show(self)


def motion_arrays(motion: CoordinatedMotion) -> Arrays:
    """Return the samples of a motion and the arrays that define it.

    Samples are `time` (n_steps,) [s]; `position`, `velocity` and `acceleration` of the end effectors, each of shape
    (n_steps, n_manipulators, n_dims); and where the coordinates are the payload's, the poses of the rigid groups:
    `center` (n_steps, n_groups, 3) [m] and `quaternion` (n_steps, n_groups, 4), w x y z. The curve is rebuilt
    exactly.
    """
    trajectory = motion.trajectory()
    shares = trajectory.time / motion.scene.duration
    is_held = motion.coordinates.kind == "load"
    poses = poses_at(motion.coordinates, motion.at(shares)[0])._asdict() if is_held else {}
    return {
        "time": trajectory.time,
        "position": trajectory.position,
        "velocity": trajectory.velocity,
        "acceleration": motion.hands(shares)[2] / motion.scene.duration**2,
        **poses,
        "manipulators": np.array(trajectory.manipulators),
        **curve_arrays(motion),
    }


def curve_arrays(motion: CoordinatedMotion) -> Arrays:
    """Return the arrays that define a motion, by the names `CURVE`."""
    basis = motion.basis
    return {
        "coordinates": np.array(motion.coordinates.kind),
        "weights": motion.weights,
        "start": motion.boundary[:2],
        "goal": motion.boundary[2:],
        "basis_functions": np.array(basis.n_basis),
        "basis_metric": np.array(basis.metric),
        "basis_phase": np.array(_phase_text(basis.phase)),
    }


def smoothness_of(motion: CoordinatedMotion) -> dict[str, Any]:
    """Return the summary's measures of the smoothness of a motion."""
    measures = {name: finite(value) for name, value in vars(smoothness(motion)).items()}
    return {name: measures.pop(name) for name in JERK} | {"smoothness": measures}


def read_result(folder: str | Path) -> StoredResult:
    """Read a result folder.

    Raises
    ------
    ResultError
        If the folder is missing, incomplete or unreadable.
    """
    return StoredResult(Path(folder), *SOLUTION.read(folder))


def rebuild(arrays: Arrays, scene: Scene) -> CoordinatedMotion:
    """Rebuild the motion that a stored result describes, on `scene`.

    Raises
    ------
    ResultError
        If the arrays do not describe a motion on this scene.
    """
    name: Any = str(arrays["coordinates"])
    if name not in COORDINATES:
        raise ResultError(f"unknown coordinates '{name}'", key="coordinates", way_out=AGAIN)
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
    """Verify a stored result from its files and the scene alone.

    The motion is rebuilt from its weights, compared with its samples and verified; checksums and the measures in the
    summary must agree as well.
    """
    try:
        motion = rebuild(stored.arrays, scene)
    except ResultError as error:
        nothing = Report(-math.inf, math.inf, math.inf, math.inf, math.inf, math.inf)
        return Verdict(None, nothing, (f"the motion cannot be rebuilt on this scene: {error}",))
    verdict, summary = verify(motion), stored.summary
    reasons = [*verdict.reasons, *_edited_samples(stored, motion)]
    reasons += SOLUTION.broken_seals(summary, stored.arrays)
    if summary.get("scene_sha256") != scene.sha256:
        reasons.append(
            "the scene is not the one that was solved: its checksum differs (options such as --duration that "
            "changed it must be given again)"
        )
    reasons += SOLUTION.mistyped(summary)
    if verdict.verified is not None and summary.get("verified") is True:
        reasons += SOLUTION.differences(summary, verdict.report.asdict())
        reasons += _edited_cost(summary, motion)
        reasons += _edited_smoothness(summary, motion)
        if summary.get("duration") not in (None, scene.duration):  # older results do not say it
            reasons.append(
                f"{SOLUTION.summary} says a duration of {summary['duration']} s, not {scene.duration} s"
            )
        if summary.get("scene") != scene.name:
            told = shortened(str(summary.get("scene")))
            reasons.append(f"{SOLUTION.summary} names another scene: {told}")
    elif summary.get("verified") is not True:
        reasons.append(f"{SOLUTION.summary} does not claim a verified motion")
    return Verdict(None if reasons else verdict.verified, verdict.report, tuple(reasons))


def _smooth(name: str, value: float) -> float:
    return SMOOTH * max(1e-3, abs(value))


def _edited_samples(stored: StoredResult, motion: CoordinatedMotion) -> list[str]:
    """List the samples that are not on the rebuilt curve, in words."""
    expected, reasons = motion_arrays(motion), []
    for name in (*SAMPLES, *(name for name in MORE_SAMPLES if name in stored.arrays)):
        found, right = stored.arrays[name], expected.get(name, np.zeros(0))
        if found.shape != right.shape or found.dtype.kind != right.dtype.kind:
            reasons.append(f"'{name}' was edited: its shape is {found.shape}, the motion's is {right.shape}")
        elif right.dtype.kind == "U":
            if list(found) != list(right):
                reasons.append("the manipulators are not those of the scene")
        elif not _apart(name, found, right).max() <= _rebuilt(name, right):
            at = np.unravel_index(first_largest(_apart(name, found, right)), right.shape)
            where = ", ".join(str(int(i)) for i in at)
            reasons.append(
                f"'{name}[{where}]' was edited: it is {float(found[at])!r}, the motion's is {float(right[at])!r}"
            )
    return reasons


def _rebuilt(name: str, right: Array) -> float:
    return REBUILT if name != "acceleration" else REBUILT_RATE * max(1.0, float(np.abs(right).max()))


def _apart(name: str, found: Array, right: Array) -> Array:
    """Return the differences of samples; quaternions may differ in sign."""
    if name == "quaternion":
        right = np.where((found * right).sum(axis=-1, keepdims=True) < 0.0, -right, right)
    return np.abs(found - right)


def _edited_smoothness(summary: Summary, motion: CoordinatedMotion) -> list[str]:
    """List the measures of smoothness that are not the motion's. Results of earlier versions state none."""
    stated, right = summary.get("smoothness"), smoothness_of(motion)
    if stated is None:
        return []
    measures = right.pop("smoothness")
    if not isinstance(stated, dict) or stated.keys() != measures.keys():
        needed = ", ".join(measures)
        return [f"{SOLUTION.summary} does not say how smooth the motion is: smoothness needs {needed}"]
    return [
        *SOLUTION.differences(summary, right, _smooth),
        *SOLUTION.differences(stated, measures, _smooth, "smoothness."),
    ]


def _edited_cost(summary: Summary, motion: CoordinatedMotion) -> list[str]:
    """List the terms of J that are not the motion's, in words. The weights are those in the summary."""
    file, terms, weights = (
        SOLUTION.summary,
        summary.get("cost_terms"),
        summary.get("cost_weights", WEIGHTS),
    )
    if not isinstance(terms, dict) or not isinstance(weights, dict):
        return [f"{file} says nothing of the terms of J, or of their weights"]
    reasons, total, units = [], 0.0, unit_terms(motion)
    for name in WEIGHTS:
        stated, weight = number(terms.get(name)), number(weights.get(name, 0.0))
        if stated is None or weight is None or min(stated, weight) < 0:
            reasons.append(f"{file} says {shortened(str(terms.get(name)))} of the cost's term '{name}'")
            continue
        total += stated
        if name in units:
            reasons += SOLUTION.differences(terms, {name: weight * units[name]}, prefix="cost_terms.")
    if not reasons and not agrees(summary.get("cost"), total, near("cost", total)):
        told = shortened(str(summary.get("cost")))
        reasons.append(f"{file} says cost = {told}, its terms make {total:.9g}")
    return reasons


def _basis(arrays: Arrays) -> MotionBasis:
    try:
        count = int(arrays["basis_functions"])
        metric: Any = str(arrays["basis_metric"])
        if metric not in get_args(Metric):
            raise ValueError(f"unknown metric '{metric}'")
        return motion_basis(count, metric, _phase(str(arrays["basis_phase"])))
    except (TypeError, ValueError) as error:
        raise ResultError(str(error), key="basis", way_out=AGAIN) from error


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
