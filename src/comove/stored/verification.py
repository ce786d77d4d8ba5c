"""Verification of the parts of a result folder: the one place that decides what they are verified against.

A part is verified against the scene and the robot that the caller trusts. Without a trusted scene it is verified
against the folder's own, and without a trusted robot for the one that the scene names; `against` says so. Nothing
else in a folder may loosen what it is verified by.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

from comove.brief import brief
from comove.coordination.motion import CoordinatedMotion
from comove.errors import ExtraError, ResultError
from comove.results.reference import Reference, reference_of
from comove.results.sealed import Arrays, Summary
from comove.results.solution import StoredResult, read_result, rebuild, verify_result
from comove.results.words import Row, joint_rows, limits_row, motion_rows, run_rows, simulation_rows
from comove.scenes.scene import Scene
from comove.stored.parts import Part, parts_of
from comove.verification.verify import Report

if TYPE_CHECKING:  # robots are an extra
    from comove.robots.files import RobotSource, StoredJoints
    from comove.robots.model import Robot
    from comove.robots.motion import JointMotion
    from comove.robots.verification.verify import VerifiedJointMotion
    from comove.simulators.live_record import OnlineRecord
    from comove.verification.record import Record


@dataclass(frozen=True, eq=False)
class Verification:
    """The result of the verification of one part of a result folder.

    Attributes
    ----------
    part : what was verified
    scene : the scene that it was verified against
    against : where scene and robot are from, in words, what is not trusted first
    reasons : why it is not verified, in words
    rows : measures: of what, by how much, and what is asked for
    summary : contents of the part's summary, as stored
    report : measures of the hands, where they are a motion or an execution
    motion : motion of the hands; None for runs, and where it cannot be rebuilt
    record : what happened in an execution of hands
    robot, joints : a robot, and its motion
    verified_joints : the joint motion, if it is verified
    series : arrays of a simulation
    online : what happened in an online run of a robot
    """

    __repr__ = brief

    part: Part
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
        return self.part not in (Part.ROBOT_RUN, Part.SIMULATION)

    @property
    def is_hands_alone(self) -> bool:
        """Return whether the scene names a robot, and no joint of it was looked at."""
        return self.scene.file.robot is not None and self.part in (Part.MOTION, Part.RUN)

    @property
    def verified(self) -> bool:
        """Return whether nothing speaks against it."""
        return not self.reasons


def verify_folder(
    folder: str | Path, scene: Scene | None = None, robot: str | Path | None = None
) -> tuple[Verification, ...]:
    """Verify all parts of a result folder anew.

    Parameters
    ----------
    scene
        A trusted scene; the folder's own unless given.
    robot
        Name or path of a trusted robot description; the one of the scene unless given.

    Raises
    ------
    ResultError
        If a part is missing, incomplete or unreadable.
    RobotError
        If no robot may be trusted, or it cannot be loaded.
    ExtraError
        If a part needs what is not installed.
    """
    stored = _Folder(Path(folder), scene, robot)
    return tuple(stored.verify(part) for part in parts_of(Path(folder)))


def verify_part(
    folder: str | Path, part: Part, scene: Scene | None = None, robot: str | Path | None = None
) -> Verification:
    """Verify one part of a result folder anew; as `verify_folder`."""
    return _Folder(Path(folder), scene, robot).verify(part)


class _Folder:
    """A result folder, and what its parts are verified against."""

    def __init__(self, folder: Path, scene: Scene | None, robot: str | Path | None):
        self.folder, self.robot = folder, robot
        self.given = reference_of(folder, scene)

    def verify(self, part: Part) -> Verification:
        """Verify one part."""
        return {
            Part.MOTION: lambda: self.hands,
            Part.JOINTS: lambda: self.carried,
            Part.RUN: self._run,
            Part.ROBOT_RUN: self._robot_run,
            Part.SIMULATION: self._simulation,
        }[part]()

    @cached_property
    def result(self) -> StoredResult:
        """Return the stored motion of the hands."""
        return read_result(self.folder)

    @cached_property
    def reference(self) -> Reference:
        """Return what the hands' motion is verified against, whose open duration and grasp are the result's."""
        return self.given.for_result(self.result)

    @cached_property
    def source(self) -> RobotSource:
        """Return the robot."""
        return _robots().robot_of(self.folder, self.reference, self.robot)

    @cached_property
    def joints(self) -> StoredJoints:
        """Return the stored joints."""
        stored: StoredJoints = _robots().read_joints(self.folder)
        return stored

    @cached_property
    def hands(self) -> Verification:
        """Return the verification of the hands' motion."""
        reference = self.reference
        scene, verdict = reference.scene, verify_result(self.result, reference.scene)
        try:
            motion = rebuild(self.result.arrays, scene)
        except ResultError:
            motion = None
        rows = motion_rows({**verdict.report.asdict(), "duration": scene.duration}, scene)
        return Verification(
            part=Part.MOTION,
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
        return replace(
            hands,
            part=Part.JOINTS,
            against=(*hands.against, str(source)),
            reasons=tuple(dict.fromkeys((*hands.reasons, *verdict.reasons))),
            rows=(*hands.rows, *joint_rows(vars(verdict.report))),
            summary=self.joints.summary,
            robot=source.robot,
            joints=self.joints.joints,
            verified_joints=verdict.verified,
        )

    def _run(self) -> Verification:
        from comove.results.runs import StoredRun, read_run, verify_run

        stored = read_run(self.folder, self.given.scene)
        reference = self.given.for_result(stored)
        stored = StoredRun(stored.folder, stored.summary, stored.arrays, reference.scene)
        report = verify_run(stored)
        rows = motion_rows({**report.asdict(), "duration": float(stored.record.time[-1])}, reference.scene)
        return Verification(
            part=Part.RUN,
            scene=reference.scene,
            against=(str(reference), *limits_row(reference.scene)),
            reasons=report.reasons,
            rows=tuple(rows),
            summary=stored.summary,
            report=report,
            record=stored.record,
        )

    def _robot_run(self) -> Verification:
        from comove.simulators.robot_runs import ROBOT_RUN, read_robot_run, verify_robot_run

        stored = read_robot_run(self.folder)
        reference = self.given.for_result(stored)
        source = _robots().robot_of(self.folder, reference, self.robot, ROBOT_RUN)
        record, report = verify_robot_run(stored, reference.scene, source.robot)
        return Verification(
            part=Part.ROBOT_RUN,
            scene=reference.scene,
            against=(str(reference), str(source)),
            reasons=report.reasons,
            rows=tuple(run_rows(vars(report))),
            summary=stored.summary,
            robot=source.robot,
            online=record,
        )

    def _simulation(self) -> Verification:
        from comove.robots.grippers import without_gripper
        from comove.simulators.files import SIMULATION, verify_simulation

        carried = self.carried
        summary, arrays = SIMULATION.read(self.folder)
        joints = self.joints.joints
        reasons = verify_simulation(summary, arrays, self.source.robot, carried.scene, joints)
        return replace(
            carried,
            part=Part.SIMULATION,
            reasons=tuple(dict.fromkeys((*carried.reasons, *reasons))),
            rows=tuple(simulation_rows({**summary, "without_gripper": without_gripper(self.source.robot)})),
            summary=summary,
            series=arrays,
        )


def _robots() -> Any:
    """Return the files of robots, which are an extra."""
    try:
        from comove.robots import files
    except ExtraError:
        raise ExtraError("to verify a robot's motion", "robot") from None
    return files
