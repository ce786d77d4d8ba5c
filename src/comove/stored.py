"""Verification of result folders against a trusted scene and robot.

Without a trusted scene a part is verified against the folder's own, and without a trusted robot against the one that
the scene names; `against` states it. Nothing else in a folder may loosen its verification. Measures are given in
words, for the command line and for pages.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from enum import Enum
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

from comove.brief import brief
from comove.errors import ExtraError, OptionError, ResultError
from comove.io.folders import require_folder
from comove.model.motion import CoordinatedMotion
from comove.model.scene import Scene
from comove.results.reference import Reference, reference_of
from comove.results.sealed import Arrays, Summary
from comove.results.solution import StoredResult, read_result, rebuild, verify_result
from comove.verification.verify import Check, Report, Verdict, VerifiedMotion
from comove.verification.verify import verify as verify_motion

Row = tuple[str, str, str]
"""A measure: of what, by how much, and what was asked for."""
_Described = tuple[str, str, str, float]  # of what, its name, its words, and the factor to their unit

NO_GRIPPER = "without_gripper"
"""Name of the measure that lists arms whose description has no gripper."""
ROUNDING = 1e-12
"""Deviations below this many metres or radians are rounding, and said to be 0."""

_MOTION: tuple[_Described, ...] = (
    ("clearance", "clearance_min", "{:.4g} mm at least, at every instant", 1e3),
    ("distance from supports", "support_distance_min", "{:.3g} mm at least, near start and goal", 1e3),
    ("supports of the start", "support_left", "full clearance from {:.3g} s on", 1.0),
    ("supports of the goal", "support_met", "full clearance until {:.3g} s", 1.0),
    ("speed", "speed_max", "{:.4g} m/s at most", 1.0),
    ("acceleration", "acceleration_max", "{:.4g} m/s^2 at most", 1.0),
    ("jerk", "jerk_max", "{:.4g} m/s^3 at most", 1.0),
    ("distances between hands", "distance_error_max", "off by {:.2g} m at most", 1.0),
    ("goal and start", "end_error", "missed by {:.2g} m at most", 1.0),
    ("tilt", "tilt_max", "{:.3g} deg at most", 180.0 / math.pi),
    ("separation", "separation_spare_min", "{:.3g} mm to spare at least", 1e3),
    ("same height", "height_error_max", "off by {:.2g} m at most", 1.0),
    ("other constraints", "constraint_excess_max", "exceeded by {:.2g} at most", 1.0),
    ("duration", "duration", "{:.4g} s", 1.0),
)
_JOINTS: tuple[_Described, ...] = (
    ("joints from their limits", "joint_margin_min", "{:.3g} rad at least", 1.0),
    ("share of joint speeds", "velocity_ratio_max", "{:.3g} at most", 1.0),
    ("share of joint accelerations", "acceleration_ratio_max", "{:.3g} at most", 1.0),
    ("share of joint jerks", "jerk_ratio_max", "{:.3g} at most", 1.0),
    ("share of torques", "torque_ratio_max", "{:.3g} at most", 1.0),
    ("share of payloads", "payload_ratio_max", "{:.3g} at most", 1.0),
    ("hands on the load", "hand_error_max", "off by {:.2g} m at most", 1.0),
    ("hands' turn on the load", "hand_turn_max", "off by {:.2g} rad at most", 1.0),
    ("links from obstacles", "clearance_scene", "{:.4g} mm at least", 1e3),
    ("links from the load", "clearance_load", "{:.4g} mm at least", 1e3),
    ("links from each other", "clearance_self", "{:.4g} mm at least", 1e3),
    ("links where joints deviate", "clearance_deviating", "{:.4g} mm from anything at least", 1e3),
    ("load where joints deviate", "load_uncertainty", "off its place by {:.3g} mm at most", 1e3),
)
_ROBOT_RUN: tuple[_Described, ...] = (
    ("links from obstacles", "clearance_scene", "{:.1f} mm at samples", 1e3),
    ("load from obstacles", "clearance_carried", "{:.1f} mm at samples", 1e3),
    ("links from each other", "clearance_self", "{:.1f} mm at samples", 1e3),
    ("hands on the load", "hold_error_max", "{:.2g} m or rad, commanded", 1.0),
    ("hands' distance", "distance_error_max", "{:.2g} mm off in the simulator", 1e3),
    ("end error", "end_error", "{:.2g} mm", 1e3),
    ("share of speed", "velocity_ratio_max", "{:.3g}", 1.0),
    ("share of acceleration", "acceleration_ratio_max", "{:.3g}", 1.0),
    ("servos behind", "lag_max", "{:.2g} rad at most", 1.0),
    ("took", "duration_s", "{:.2f} s", 1.0),
)
_SIMULATED = ("hands' distance", "servos behind", "took")
"""Rows of a robot's run that say nothing of one whose commands were followed exactly."""
_SIMULATION: tuple[_Described, ...] = (
    ("load from its goal", "end_error", "{:.3g} mm", 1e3),
    ("hands' distances", "distance_error_max", "off by {:.3g} mm at most", 1e3),
    ("load behind its plan", "lag_max", "{:.3g} mm at most", 1e3),
    ("slip in a hand", "slip_max", "{:.3g} mm at most", 1e3),
    ("force inside the load", "internal_force_max", "{:.3g} N at most", 1.0),
    ("share of torque", "torque_share_max", "{:.3g} at most", 1.0),
)


def motion_rows(report: Mapping[str, Any], scene: Scene | None = None) -> list[Row]:
    """Return a motion's quantities, bounds over all instants, and requirements in words.

    Parameters
    ----------
    report : measures by their names in `comove.verification.verify.Report`, and `duration` [s]
    """
    supports = [] if scene is None else support_words(scene)
    asked: dict[str, str] = {}
    if scene is not None:
        limits = scene.file.limits
        asked = {
            "clearance": f"{1e3 * scene.clearance:.4g} mm",
            "speed": _limit(limits.speed, "m/s"),
            "acceleration": _limit(limits.acceleration, "m/s^2"),
            "jerk": _limit(limits.jerk, "m/s^3"),
        }
    rows = [(name, said, asked.get(name, "")) for name, said, _ in _rows(_MOTION, report)]
    if (
        report.get("support_distance_min") is not None
    ):  # they recede: the bound is none of the distance from them
        rows = [
            (n, f"{said}, off its supports" if n == "clearance" else said, want) for n, said, want in rows
        ]
    rows += [("rests on", words, "") for words in supports]
    if asked.get("jerk") and not any(name == "jerk" for name, *_ in rows):
        rows.append(("jerk", "not measured: executions are not bound by it", asked["jerk"]))
    return rows


def support_words(scene: Scene) -> list[str]:
    """Return the resting contacts of a scene, and their ends, in words."""
    told = []
    for rest in scene.rests:
        along = ", ".join(f"{x:.3g}" for x in rest.normal[: scene.n_dims] + 0.0)
        told.append(
            f"{scene.name_of(rest.obstacle)} at the {rest.end}, {1e3 * beyond_rounding(rest.distance):.3g} mm apart; "
            f"full clearance beyond {1e3 * rest.reach(scene.clearance):.3g} mm of displacement, along [{along}]"
        )
    return told


def joint_rows(report: Mapping[str, Any]) -> list[Row]:
    """Return the bounds proved for a robot's joints, as `motion_rows`.

    Parameters
    ----------
    report : measures by their names in `comove.robots.JointReport`; those that are not numbers are left out
    """
    return [
        *_rows(_JOINTS, report),
        *deviation_rows(report.get("uncertainty") or {}),
        *gripper_rows(report.get(NO_GRIPPER)),
    ]


def deviation_rows(uncertainty: Any) -> list[Row]:
    """Return the certified deviations of joints in words, if any.

    Parameters
    ----------
    uncertainty : `comove.robots.description.Uncertainty`, or its plain data
    """
    plain = uncertainty if isinstance(uncertainty, Mapping) else vars(uncertainty)
    stated = plain.get("joints")
    each = stated.values() if isinstance(stated, Mapping) else [stated]
    values = [value for value in each if isinstance(value, (int, float))]
    if not values:
        return []
    least, most = (f"{value:g}" for value in (min(values), max(values)))
    by = most if least == most else f"{least} to {most}, by joint,"
    return [("deviations of joints", f"certified up to {by} rad (m where they slide)", "")]


def simulation_rows(summary: Mapping[str, Any]) -> list[Row]:
    """Return the measures of a simulation, as `motion_rows`; none is proved."""
    rows = _rows(_SIMULATION, summary)
    if simulator := summary.get("simulator"):
        rows.insert(0, ("simulated by", str(simulator), ""))
    return [*rows, *gripper_rows(summary.get(NO_GRIPPER))]


def run_rows(measures: Mapping[str, Any]) -> list[Row]:
    """Return the measures of a robot's online run, as `motion_rows`; distances are sampled."""
    told = "moving obstacles", "as they were measured, which nothing here can verify", ""
    rows = [told] if measures.get("obstacles") == "measured" else []
    return [*_rows(_ROBOT_RUN, measures), *rows, *gripper_rows(measures.get(NO_GRIPPER))]


def gripper_rows(arms: Iterable[str] | None) -> list[Row]:
    """Return the arms without a gripper in their description, in words."""
    named = ", ".join(f"'{arm}'" for arm in arms or ())
    return [("grippers", f"none in the description at {named}: not verified", "")] if named else []


def beyond_rounding(value: float) -> float:
    """Return a deviation [m or rad], 0 if it is only rounding."""
    return 0.0 if abs(value) < ROUNDING else value


def limits_row(scene: Scene) -> list[str]:
    """Return the end effectors' limits of a scene in one line. It is empty where the scene sets none."""
    limits = scene.file.limits
    said = [
        _limit(limits.speed, "m/s"),
        _limit(limits.acceleration, "m/s^2"),
        _limit(limits.jerk, "m/s^3"),
        f"{1e3 * scene.clearance:.4g} mm of clearance" if scene.clearance else "",
    ]
    told = ", ".join(limit for limit in said if limit)
    return [f"limits of {told}"] if told else ["no limits of speed, acceleration or jerk"]


def _rows(described: tuple[_Described, ...], measures: Mapping[str, Any]) -> list[Row]:
    rows = []
    for name, key, words, factor in described:
        value = measures.get(key)
        if isinstance(value, (int, float)) and not math.isnan(value):
            said = "nothing near" if math.isinf(value) else words.format(factor * beyond_rounding(value))
            rows.append((name, said, ""))
    return rows


def _limit(value: float | None, unit: str) -> str:
    return "" if value is None else f"{value:.4g} {unit}"


class ResultPart(Enum):
    """A part of a result folder: its summary and its label."""

    MOTION = "solution.json", "the hands"
    JOINTS = "robot.json", "the robot"
    RUN = "run.json", "the run"
    ROBOT_RUN = "robot_run.json", "the robot's run"
    SIMULATION = "simulation.json", "the simulation"

    def __init__(self, file: str, words: str):
        self.file, self.words = file, words


ARRAYS = {ResultPart.JOINTS: "joints.npz"}
"""Further files that show that a part is there, so that it is not passed over where its summary was removed."""


def parts_of(folder: Path) -> tuple[ResultPart, ...]:
    """Return the parts of a result folder.

    Raises
    ------
    ResultError
        If it holds none, or there is no such folder.
    """
    require_folder(folder, "comove solve SCENE --out DIR")
    found = tuple(
        part
        for part in ResultPart
        if (folder / part.file).is_file() or (part in ARRAYS and (folder / ARRAYS[part]).is_file())
    )
    if not found:
        from comove.io.kinds import no_result_in

        raise no_result_in(folder, f"{ResultPart.MOTION.file} and no {ResultPart.RUN.file}")
    return found


if TYPE_CHECKING:  # robots are an extra
    from comove.robots.files import RobotSource, StoredJoints
    from comove.robots.model import Robot
    from comove.robots.motion import JointMotion
    from comove.robots.verification.verify import JointVerdict, VerifiedJointMotion
    from comove.sim.live_record import OnlineRecord, OnlineReport
    from comove.verification.record import ExecutionReport, Record


@dataclass(frozen=True, eq=False)
class Verification:
    """The result of the verification of one part of a result folder.

    Attributes
    ----------
    part : verified part
    scene : scene that it was verified against
    against : where scene and robot are from, in words, untrusted ones first
    reasons : reasons against verification, in words
    rows : measures: quantity, value, requirement
    summary : contents of the part's summary, as stored
    report : measures of the end effectors' motion or execution
    motion : motion of the end effectors; None for runs, and where it cannot be rebuilt
    record : record of an execution of end effectors
    robot, joints : a robot, and its motion, if it is one of this robot's joints
    verified_joints : the joint motion, if it is verified
    series : arrays of a simulation, if it is one of this motion
    online : record of an online run of a robot
    """

    __repr__ = brief

    part: ResultPart
    scene: Scene
    against: tuple[str, ...]
    reasons: tuple[str, ...]
    rows: tuple[Row, ...]
    summary: Summary
    report: Report | None = None
    motion: CoordinatedMotion | None = None
    record: Record | None = None
    robot: Robot | None = None
    joints: JointMotion | None = None
    verified_joints: VerifiedJointMotion | None = None
    series: Arrays | None = None
    online: OnlineRecord | None = None

    @property
    def is_proof(self) -> bool:
        """Return whether the measures hold at every instant, and not at samples."""
        return self.part not in (ResultPart.ROBOT_RUN, ResultPart.SIMULATION)

    @property
    def is_hands_alone(self) -> bool:
        """Return whether the scene names a robot, but no joints were verified."""
        return self.scene.file.robot is not None and self.part in (ResultPart.MOTION, ResultPart.RUN)

    @property
    def verified(self) -> bool:
        """Return whether there are no reasons against it."""
        return not self.reasons

    @property
    def allowance(self) -> str:
        """Return the deviation that a motion allows, in words, if known."""
        if (
            self.part is not ResultPart.JOINTS
            or self.robot is None
            or self.joints is None
            or self.motion is None
        ):
            return ""
        from comove.robots.verification.allowed import allowed_deviation

        found, stated = self.verified_joints, self.robot.description.uncertainty.joints
        hands = found.motion if found is not None else verify_motion(self.motion).verified
        if hands is None or (found is None and stated is None):
            return ""
        most = allowed_deviation(self.robot, hands, self.joints)
        if most == 0.0:
            return "the motion allows none"
        if found is not None and stated is not None:
            return f"the motion allows up to {most:g} rad for all joints alike"
        return f"the motion allows up to {most:g} rad: write uncertainty: {{joints: {most:g}}}"


def verify(
    thing: Any,
    *,
    scene: Scene | str | Path | None = None,
    robot: Robot | str | Path | None = None,
    checks: Sequence[Check] = (),
) -> Verdict | JointVerdict | Verification | tuple[Verification, ...]:
    """Verify a motion, a solution, an execution or a result folder anew.

    Parameters
    ----------
    thing
        A `comove.model.CoordinatedMotion`, or a `Solution`: the motion of its end effectors and, with a robot, of its
        joints; or the verified motion of either. Or the record of an execution, as of `comove.Executor(scene).run`.
        Or the path of a result folder.
    scene, robot
        The scene, and the robot, that you trust, or the paths of their files; those that the folder names unless
        given. Of folders only.
    checks
        Further checks of a motion of end effectors, with or without joints.

    Returns
    -------
    `Verdict` of the motion, `JointVerdict` if it has joints, `Verification` of an execution, or one for each
    part of the folder

    Raises
    ------
    OptionError
        If it is none of these, or an argument does not apply to it.
    ResultError
        If a part of the folder is missing, incomplete or unreadable.
    """
    if isinstance(thing, (str, Path)):
        if checks:
            raise OptionError("further checks are of motions", key="checks", way_out="leave them out")
        if isinstance(scene, (str, Path)):
            scene = Scene.load(scene)
        if not (scene is None or isinstance(scene, Scene)):
            raise OptionError(f"scene = {scene!r}", way_out="give a Scene, or the path of its file")
        if not (robot is None or isinstance(robot, (str, Path, _robots().Robot))):
            raise OptionError(
                f"robot = {robot!r}", way_out="give a Robot, its name, or the path of its description"
            )
        return verify_folder(thing, scene, robot)
    if scene is not None or robot is not None:
        key = "robot" if scene is None else "scene"
        raise OptionError("a motion has its own", key=key, way_out="leave it out, or name a result folder")
    motion, carrier = _motion_of(thing)
    if motion is None:
        return _verified_execution(thing, checks)
    if carrier is None:
        return verify_motion(motion, checks)
    from comove.robots import verify_joints

    verdict: JointVerdict = verify_joints(carrier[0], motion, carrier[1], checks=checks)
    return verdict


def _motion_of(thing: Any) -> tuple[CoordinatedMotion | None, tuple[Robot, JointMotion] | None]:
    """Return a motion, and its robot and joints; None where missing."""
    motion, joints = getattr(thing, "motion", None), getattr(thing, "joints", None)
    if isinstance(thing, (CoordinatedMotion, VerifiedMotion)):
        return (thing if isinstance(thing, CoordinatedMotion) else thing.motion), None
    if isinstance(attempt := getattr(thing, "attempt", None), CoordinatedMotion):  # a Solution
        return attempt, None if joints is None else (joints.robot, joints.attempt)
    if isinstance(motion, VerifiedMotion):  # a VerifiedJointMotion
        return motion.motion, (thing.robot, thing.joints)
    if isinstance(getattr(motion, "motion", None), VerifiedMotion):  # joints of a Solution
        return _motion_of(motion)
    return None, None


def _verified_execution(record: Any, checks: Sequence[Check]) -> Verification:
    """Verify the record of an execution, or raise if it is none."""
    from comove.verification.record import Record, RecordSamples, verify_execution

    is_online = hasattr(record, "commanded") and hasattr(record, "measured")  # a robot, as a simulator saw it
    if not (is_online or isinstance(record, (Record, RecordSamples))):
        raise OptionError(
            f"a {type(record).__name__} cannot be verified",
            key="thing",
            way_out="give a motion, a solution, the record of an execution, or the path of a result folder",
        )
    if checks:
        raise OptionError("further checks are of motions", key="checks", way_out="leave them out")
    against = ("the record's own scene", *limits_row(record.scene))
    if is_online:
        return _of_robot_run(record, against)
    report = verify_execution(record)
    found = _of_run(record, report, against)
    if not hasattr(record, "joints"):
        return found
    from comove.sim.robot_runs import followed

    carried = _of_robot_run(followed(record), against)
    return replace(
        carried,
        reasons=tuple(dict.fromkeys((*found.reasons, *carried.reasons))),
        rows=(*found.rows, *(row for row in carried.rows if row[0] not in _SIMULATED)),
        report=report,
        record=record,
    )


def _of_run(
    record: Record, report: ExecutionReport, against: tuple[str, ...], summary: Summary | None = None
) -> Verification:
    """Return the verification of an execution of end effectors."""
    rows = motion_rows({**report.asdict(), "duration": float(record.time[-1])}, record.scene)
    return Verification(
        part=ResultPart.RUN,
        scene=record.scene,
        against=against,
        reasons=report.reasons,
        rows=tuple(rows),
        summary=summary or {},
        report=report,
        record=record,
    )


def _of_robot_run(
    record: OnlineRecord,
    against: tuple[str, ...],
    report: OnlineReport | None = None,
    summary: Summary | None = None,
) -> Verification:
    """Return the verification of an execution by a robot."""
    from comove.sim.live_record import judge_run

    report = report or judge_run(record)
    return Verification(
        part=ResultPart.ROBOT_RUN,
        scene=record.scene,
        against=against,
        reasons=report.reasons,
        rows=tuple(run_rows({**(summary or {}), **vars(report)})),
        summary=summary or {},
        robot=record.robot,
        online=record,
    )


def verify_folder(
    folder: str | Path, scene: Scene | None = None, robot: Robot | str | Path | None = None
) -> tuple[Verification, ...]:
    """Verify all parts of a result folder anew.

    Parameters
    ----------
    scene
        A trusted scene; the folder's own unless given.
    robot
        A trusted robot, or name or path of its description; the one of the scene unless given.

    Raises
    ------
    ResultError
        If a part is missing, incomplete or unreadable.
    RobotError
        If no robot may be trusted, or it cannot be loaded.
    ExtraError
        If a part needs a missing package.
    """
    parts = parts_of(Path(folder))
    stored = _Folder(Path(folder), scene, robot)
    return tuple(stored.verify(part) for part in parts)


def verify_part(
    folder: str | Path, part: ResultPart, scene: Scene | None = None, robot: Robot | str | Path | None = None
) -> Verification:
    """Verify one part of a result folder anew; as `verify_folder`."""
    return _Folder(Path(folder), scene, robot).verify(part)


class _Folder:
    """A result folder, and the scene and robot for its verification."""

    def __init__(self, folder: Path, scene: Scene | None, robot: Robot | str | Path | None):
        self.folder, self.robot = folder, robot
        self.given = reference_of(folder, scene)

    def verify(self, part: ResultPart) -> Verification:
        return {
            ResultPart.MOTION: lambda: self.hands,
            ResultPart.JOINTS: lambda: self.carried,
            ResultPart.RUN: self._run,
            ResultPart.ROBOT_RUN: self._robot_run,
            ResultPart.SIMULATION: self._simulation,
        }[part]()

    @cached_property
    def result(self) -> StoredResult:
        return read_result(self.folder)

    @cached_property
    def reference(self) -> Reference:
        """Return the reference of the motion. An open duration and an open grasp are those of the result."""
        return self.given.for_result(self.folder, self.result.summary)

    @cached_property
    def source(self) -> RobotSource:
        return _robots().robot_of(self.folder, self.reference, self.robot)

    @cached_property
    def joints(self) -> StoredJoints:
        """Return the stored joints."""
        stored: StoredJoints = _robots().read_joints(self.folder)
        return stored

    @cached_property
    def hands(self) -> Verification:
        """Return the verification of the end effectors' motion."""
        reference = self.reference
        scene, verdict = reference.scene, verify_result(self.result, reference.scene)
        try:
            motion = rebuild(self.result.arrays, scene)
        except ResultError:
            motion = None
        rows = motion_rows({**verdict.report.asdict(), "duration": scene.duration}, scene)
        return Verification(
            part=ResultPart.MOTION,
            scene=scene,
            against=(str(reference), *limits_row(scene)),
            reasons=verdict.reasons,
            rows=tuple(rows),
            summary=self.result.summary,
            report=verdict.report,
            motion=motion,
        )

    @cached_property
    def carried(self) -> Verification:
        """Return the verification of a robot's joints."""
        hands, source = self.hands, self.source
        verdict = _robots().verify_stored(self.folder, source.robot, scene=hands.scene)
        from comove.robots.verification.bodies import warn_of_buried_links  # robots are there by now

        warn_of_buried_links(source.robot, hands.scene)
        joints = self.joints.joints
        fits = not _robots().unfit_joints(source.robot, hands.scene, joints)
        return replace(
            hands,
            part=ResultPart.JOINTS,
            against=(*hands.against, str(source)),
            reasons=tuple(dict.fromkeys((*hands.reasons, *verdict.reasons))),
            rows=(*hands.rows, *joint_rows(vars(verdict.report))),
            summary=self.joints.summary,
            robot=source.robot,
            joints=joints if fits else None,
            verified_joints=verdict.verified,
        )

    def _run(self) -> Verification:
        from comove.results.runs import StoredRun, read_run, verify_run

        stored = read_run(self.folder, self.given.scene)
        reference = self.given.for_result(self.folder, stored.summary)
        stored = StoredRun(stored.folder, stored.summary, stored.arrays, reference.scene)
        against = (str(reference), *limits_row(reference.scene))
        return _of_run(stored.record, verify_run(stored), against, stored.summary)

    def _robot_run(self) -> Verification:
        from comove.sim.robot_runs import ROBOT_RUN, read_robot_run, verify_robot_run

        stored = read_robot_run(self.folder)
        reference = self.given.for_result(self.folder, stored.summary)
        source = _robots().robot_of(self.folder, reference, self.robot, ROBOT_RUN)
        record, report = verify_robot_run(stored, reference.scene, source.robot)
        return _of_robot_run(record, (str(reference), str(source)), report, stored.summary)

    def _simulation(self) -> Verification:
        from comove.robots.verification.checks import without_gripper
        from comove.sim.files import SIMULATION, verify_simulation

        carried = self.carried
        summary, arrays = SIMULATION.read(self.folder)
        joints = self.joints.joints
        reasons = verify_simulation(summary, arrays, self.source.robot, carried.scene, joints)
        return replace(
            carried,
            part=ResultPart.SIMULATION,
            reasons=tuple(dict.fromkeys((*carried.reasons, *reasons))),
            rows=tuple(simulation_rows({**summary, "without_gripper": without_gripper(self.source.robot)})),
            summary=summary,
            series=None if reasons else arrays,
        )


def _robots() -> Any:
    try:
        from comove.robots import files
    except ExtraError:
        raise ExtraError("to verify a robot's motion", "robot") from None
    return files
