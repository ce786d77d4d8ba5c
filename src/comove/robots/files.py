"""Joint motions in a result folder: `joints.npz`, `robot.json` and `scene.json`.

`joints.npz` holds `time` (n_steps,) [s], `joint_names` (n_joints,) and `position`, `velocity` and `acceleration`
(n_steps, n_joints) [rad, s; m for prismatic joints], and nothing else. The curve is rebuilt from position and time.
`robot.json` holds the verification result, its measures, and the checksums of scene, robot and motions; `scene.json`
is the scene itself, so that the folder can be verified and played without other files but its meshes.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from comove._version import __version__
from comove.arrays import Array, Integers
from comove.errors import InputError, ResultError, RobotError, shortened
from comove.io.drafts import steadily
from comove.io.folders import listed_inputs, scene_folder
from comove.model.files.keys import canonical
from comove.model.motion import CoordinatedMotion
from comove.model.scene import Scene
from comove.results.reference import SCENE, Reference, own_scene, reference_of
from comove.results.sealed import (
    AGAIN,
    NUMBER,
    TEXT,
    TEXTS,
    TRUTH,
    Arrays,
    ResultKind,
    Stored,
    Summary,
    checksum,
    finite,
    near,
    read_json,
    require_types,
)
from comove.results.solution import StoredResult, motion_arrays, read_result, rebuild, verify_result
from comove.robots.description import bundled_robots, find_description, is_file
from comove.robots.model import Robot
from comove.robots.motion import JointMotion
from comove.robots.verification.checks import unfit_joints, without_gripper
from comove.robots.verification.verify import (
    DEVIATING,
    JointReport,
    JointVerdict,
    VerifiedJointMotion,
    verify_joints,
)

SAMPLES = ("time", "joint_names", "position", "velocity", "acceleration")
FITS = 1e-10  # rad and rad/s, to which samples agree with each other
SAME_CLEARANCE = 2e-3  # m, of bounds that are only so tight
_TYPES = {
    **{"verified": TRUTH, "robot": TEXT, "reasons": TEXTS, "version": TEXT},
    **dict.fromkeys((*JointReport().asdict(), *DEVIATING), NUMBER.or_nothing),
    "without_gripper": TEXTS.or_nothing,
}

JOINTS = ResultKind(
    summary="robot.json",
    arrays="joints.npz",
    checksum="joints_sha256",
    made_by="comove solve SCENE --out DIR",
    hint=AGAIN,
    required=SAMPLES,
    require_entries=lambda summary, file: require_types(summary, _TYPES, file),
)


@dataclass(frozen=True, eq=False, repr=False)
class StoredJoints(Stored):
    """Contents of `robot.json` and `joints.npz`, and the folder's own scene."""

    scene: Scene

    @property
    def joints(self) -> JointMotion:
        """Return the joint motion."""
        names = tuple(str(name) for name in self.arrays["joint_names"].ravel())
        return JointMotion(self.arrays["time"], names, self.arrays["position"])


def write_joints(
    folder: str | Path,
    joints: JointMotion,
    verdict: JointVerdict,
    robot: Robot,
    motion: CoordinatedMotion,
    *,
    source: str | Path | None = None,
    present: Array | None = None,
) -> Summary:
    """Write `joints.npz`, `robot.json` and `scene.json` into the folder of a result.

    Parameters
    ----------
    joints, verdict
        The motion, and its verification result.
    motion
        Motion of the end effectors, as in `solution.npz`.
    source
        The robot's description: the name of a bundled one or a path; found by the robot's name or from the scene
        unless given.
    present
        Array, shape (n_joints,), joints at which an approach begins; home unless given [rad, m].

    Returns
    -------
    dict, the contents of robot.json
    """
    folder = Path(folder)
    (folder / SCENE).write_bytes(canonical(motion.scene.file) + b"\n")
    report = verdict.report
    summary = {
        "verified": verdict.verified is not None,
        "reasons": list(verdict.reasons),
        "robot": robot.name,
        "robot_file": source_of(robot, motion.scene, source),
        "version": __version__,
        "present": None if present is None else dict(zip(robot.joint_names, present.tolist(), strict=True)),
        **{name: finite(value) for name, value in report.asdict().items()},
        "where": {name: list(place) for name, place in report.where.items()},
        "uncertainty": report.uncertainty.model_dump(),
        "without_gripper": list(report.without_gripper),
        "robot_sha256": robot.sha256,
        "scene_sha256": motion.scene.sha256,
        "motion_sha256": checksum(motion_arrays(motion)),
    }
    return JOINTS.write(folder, summary, joint_arrays(joints))


def joint_arrays(joints: JointMotion) -> Arrays:
    """Return the arrays of `joints.npz`."""
    return {
        "time": joints.time,
        "joint_names": np.array(joints.joint_names),
        "position": joints.position,
        "velocity": joints.velocity,
        "acceleration": joints.acceleration,
    }


def source_of(robot: Robot, scene: Scene, source: str | Path | None) -> str | None:
    """Return the name of a bundled description, or its absolute path. None where it is unknown."""
    named = source if source is not None else robot.name
    if str(named) in bundled_robots():
        return str(named)
    if source is None:
        source = None if scene.file.robot is None else scene.folder / scene.file.robot
    return None if source is None else str(Path(source).resolve())


def read_joints(folder: str | Path) -> StoredJoints:
    """Read the files of a robot's joint motion in a result folder.

    Raises
    ------
    ResultError
        If a file is missing, incomplete or unreadable.
    """
    folder = Path(folder)
    return steadily(folder, lambda: StoredJoints(folder, *JOINTS.read(folder), own_scene(folder)))


@dataclass(frozen=True)
class RobotSource:
    """The description of the robot of a stored motion, and its origin.

    Attributes
    ----------
    robot : the robot
    file : name of the bundled description, or path
    named_by : its origin, in words
    is_own : whether only the folder names it, and it is not bundled, so that it could allow anything
    """

    robot: Robot
    file: str
    named_by: str
    is_own: bool

    def __str__(self) -> str:
        return f"the robot '{self.robot.name}' that {self.named_by} names ({self.file})"


def robot_of(
    folder: Path,
    reference: Reference,
    named: str | Path | Robot | None = None,
    kind: ResultKind = JOINTS,
) -> RobotSource:
    """Return the robot for which a folder's joint motion is verified.

    It is that of the caller, else that of the scene, last that of `robot.json`: beside a trusted scene without a
    robot it may name a bundled one alone, as a description of its own choice could allow anything.

    Parameters
    ----------
    reference : the scene that the motion is verified against
    named : a trusted robot, or name or path of its description
    kind : the kind of the folder's result, whose summary may name a robot

    Raises
    ------
    RobotError
        If there is no such robot, or no trusted one is named.
    """
    if isinstance(named, Robot):
        return RobotSource(named, f"sha256 {named.sha256[:12]}", "you", False)
    if named is not None:
        return _loaded(named, "you", None)
    wanted, own = reference.scene.file.robot, reference.is_own
    where = scene_folder(reference.file) if own else reference.scene.folder
    if wanted is not None and (not own or wanted in bundled_robots() or is_file(where / wanted)):
        return _loaded(wanted, "the folder's own scene" if own else "the scene", where, own)
    source = read_json(folder / kind.summary, kind.hint).get("robot_file")
    if not isinstance(source, str) or not source:
        raise ResultError(
            "it does not say where the robot's description is",
            file=folder / kind.summary,
            key="robot_file",
            way_out="name the robot: comove verify DIR --robot NAME",
        )
    if not own and source not in bundled_robots():
        raise RobotError(
            "neither the scene nor the command names a robot, and the folder's is no bundled one",
            file=reference.file,
            key="robot",
            way_out="give its description by --robot FILE, once you have read it",
        )
    try:
        return _loaded(_kept(folder, source) or source, "the folder", None, own)
    except RobotError as error:
        raise ResultError(
            f"the robot that it names cannot be read ({error.message})",
            file=folder / kind.summary,
            key="robot_file",
            way_out=f"put '{source}' back, or name the robot: comove verify DIR --robot FILE",
        ) from error


def _kept(folder: Path, source: str) -> Path | None:
    """Return a result folder's copy of a description; None if there is none."""
    files = listed_inputs(folder).get("files")
    for place, told in files.items() if isinstance(files, dict) else ():
        if isinstance(told, dict) and told.get("from") == source and is_file(folder / place):
            return folder / place
    return None


def _loaded(named: str | Path, named_by: str, folder: Path | None, own: bool = False) -> RobotSource:
    bundled = str(named) in bundled_robots()
    path = find_description(named, folder)
    return RobotSource(Robot.load(path), str(named) if bundled else str(path), named_by, own and not bundled)


def verified_against(
    folder: str | Path, *, scene: Scene | None = None, robot: str | Path | None = None
) -> tuple[VerifiedJointMotion, tuple[str, str]]:
    """Return a folder's joint motion, verified anew, and its scene and robot.

    Parameters
    ----------
    scene
        A trusted scene; the folder's own unless given.
    robot
        Name or path of a trusted description; that of `robot_of` unless given.

    Raises
    ------
    ResultError
        If it is not verified, or was edited, or as `verify_stored`.
    """
    folder = Path(folder)
    reference = reference_of(folder, scene).for_result(folder, read_result(folder).summary)
    source = robot_of(folder, reference, robot)
    verdict = verify_stored(folder, source.robot, scene=reference.scene)
    if verdict.verified is None:
        more = f" (and {len(verdict.reasons) - 1} more)" if len(verdict.reasons) > 1 else ""
        raise ResultError(
            f"its motion is not verified: {verdict.reasons[0].removesuffix(f'; {AGAIN}')}{more}",
            file=folder,
            way_out=f"{AGAIN}: {JOINTS.made_by}",
        )
    return verdict.verified, (str(reference), str(source))


def verify_stored(
    folder: str | Path, robot: Robot | None = None, *, scene: Scene | None = None
) -> JointVerdict:
    """Verify a stored joint motion anew.

    The assumptions come from the scene and the robot's description, never from `robot.json`, which must agree with
    them.

    Parameters
    ----------
    robot
        The robot; the one that `robot_of` finds unless given.
    scene
        Scene on which the motion is verified; the folder's own unless given.

    Raises
    ------
    ResultError
        If the folder is missing, incomplete or unreadable, or there is no such robot.
    """
    stored, solution = steadily(Path(folder), lambda: (read_joints(folder), read_result(folder)))
    reference = reference_of(stored.folder, scene)
    robot = robot_of(stored.folder, reference).robot if robot is None else robot
    scene = reference.scene
    hands = verify_result(solution, scene)
    edits = [*hands.reasons, *_edited_checksums(stored, solution, robot)]
    edits += _other_assumptions(stored.summary, robot)
    if stored.scene.sha256 != scene.sha256:
        edits.append(f"{SCENE} is not the scene that it is judged on: its checksum differs")
    flaws = _misshapen(stored.arrays) or unfit_joints(robot, scene, stored.joints)
    try:
        motion = rebuild(solution.arrays, scene)
        verdict = _NOTHING
        if not flaws:
            verdict = verify_joints(robot, motion, stored.joints)
    except (InputError, ValueError) as error:
        flaws, verdict = [*flaws, " ".join(str(error).split())], _NOTHING
    if not flaws:
        edits += _edited_samples(stored.joints, stored.arrays)
    edits += [reason for reason in verdict.reasons if not any(reason.endswith(told) for told in edits)]
    if stored.summary.get("verified") is not True:
        edits.append(f"{JOINTS.summary} does not claim a verified motion")
    elif verdict.verified is not None:
        measures = dict.fromkeys(DEVIATING) | verdict.report.asdict()
        edited = JOINTS.differences(stored.summary, measures, _near)
        edits += edited or JOINTS.mistyped(stored.summary)
        if stored.summary.get("robot") != robot.name:
            told = shortened(repr(stored.summary.get("robot")))
            edits.append(f"{JOINTS.summary} says robot = {told}, it is judged by {robot.name}")
    reasons = (*flaws, *edits)
    return replace(verdict, verified=None if reasons else verdict.verified, reasons=reasons)


def _near(name: str, value: float) -> float:
    return SAME_CLEARANCE if name.startswith("clearance") else near(name, value)


_NOTHING = JointVerdict(None, JointReport(), ())


def _other_assumptions(summary: Mapping[str, Any], robot: Robot) -> list[str]:
    """List the summary's assumptions that differ from the verifier's, in words."""
    assumed: dict[str, tuple[Any, str]] = {
        "uncertainty": (robot.description.uncertainty.model_dump(), "the robot's description says"),
        "mass_shares": (None, "it is judged by"),  # equal ones; former versions could be told of others
    }
    if "without_gripper" in summary:  # former versions did not say
        assumed["without_gripper"] = list(without_gripper(robot)), "the robot's description says"
    return [
        f"{JOINTS.summary} says {key} = {shortened(repr(summary.get(key)))}, {says} {right}"
        for key, (right, says) in assumed.items()
        if summary.get(key) != right
    ]


def _edited_checksums(stored: StoredJoints, solution: StoredResult, robot: Robot) -> list[str]:
    """List the wrong checksums, in words."""
    summary = stored.summary
    expected = {
        "scene_sha256": (
            stored.scene.sha256,
            f"{SCENE} was edited: its checksum is not the one in {JOINTS.summary}",
        ),
        "motion_sha256": (
            checksum(solution.arrays),
            "solution.npz is not the motion that the joints carry out: its checksum is not the one in "
            f"{JOINTS.summary}",
        ),
        "robot_sha256": (
            robot.sha256,
            f"'{robot.name}' is not the robot that was judged: its description, models or meshes have changed",
        ),
    }
    others = [told for key, (right, told) in expected.items() if summary.get(key) != right]
    return JOINTS.broken_seals(summary, stored.arrays) + others


def _misshapen(arrays: Arrays) -> list[str]:
    """List the arrays of wrong type or shape, in words."""
    shape, flaws = arrays["position"].shape, []
    for name, array in arrays.items():
        kind, right = ("U", shape[1:]) if name == "joint_names" else ("f", shape)
        right = shape[:1] if name == "time" else right
        if array.dtype.kind != kind or array.shape != right or len(shape) != 2:
            flaws.append(
                f"'{name}' in {JOINTS.arrays} was edited: it holds {array.dtype.name} of shape {array.shape}; {AGAIN}"
            )
    return flaws


def _edited_samples(joints: JointMotion, arrays: Arrays) -> list[str]:
    """List each joint's most inconsistent array and its largest deviation, in words.

    On a cubic of duration h, v1 - v0 = h/2 (a0 + a1) and q1 - q0 = h/2 (v0 + v1) + h^2/12 (a0 - a1). Where only the
    latter is broken, a position was changed: the one that two such cubics share.
    """
    h = np.diff(joints.time)[:, None]
    q, v, a = (np.stack([arrays[x][:-1], arrays[x][1:]]) for x in ("position", "velocity", "acceleration"))
    of_rates = np.abs(v[1] - v[0] - h / 2 * (a[0] + a[1])) <= FITS
    of_places = np.abs(q[1] - q[0] - h / 2 * (v[0] + v[1]) - h**2 / 12 * (a[0] - a[1])) <= FITS
    reasons = []
    for j, joint in enumerate(joints.joint_names):
        if of_rates[:, j].all() and of_places[:, j].all():
            continue
        if of_rates[:, j].all():
            name, step = "position", _shared(np.flatnonzero(~of_places[:, j]), len(h))
        else:
            name, step = _furthest(joints, arrays, j)
        reasons.append(
            f"'{name}[{step}, {j}]' in {JOINTS.arrays} was edited: {joint} at {joints.time[step]:.2f} s does not go "
            f"with the other samples; {AGAIN}"
        )
    return reasons


def _shared(broken: Integers, n_intervals: int) -> int:
    if len(broken) > 1:
        return int(broken[0]) + 1
    return n_intervals if broken[0] == n_intervals - 1 else int(broken[0])


def _furthest(joints: JointMotion, arrays: Arrays, joint: int) -> tuple[str, int]:
    """Return the array furthest from the positions' curve, and its sample."""
    off = {}
    for name, right in (("velocity", joints.velocity), ("acceleration", joints.acceleration)):
        difference = np.abs(arrays[name][:, joint] - right[:, joint]) / max(np.abs(right).max(), FITS)
        off[name] = np.where(np.isnan(difference), np.inf, difference)
    name = max(off, key=lambda name: off[name].max())
    return name, int(off[name].argmax())
