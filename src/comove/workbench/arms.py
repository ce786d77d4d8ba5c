"""The arms of a robot scene, as a planner of a page deals with them: what they make of motions of the hands."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from comove.coordination.motion import CoordinatedMotion
from comove.verification.verify import VerifiedMotion
from comove.workbench.playback import Playback, playback_of_joints

if TYPE_CHECKING:
    from comove.robots import JointMotion, Robot, RobotSolution, VerifiedJointMotion


class PlannedArms:
    """The arms of a robot, with the joint motion that is shown.

    Parameters
    ----------
    robot : the robot
    named : name or path of its description, as the scene has it
    """

    def __init__(self, robot: Robot, named: str):
        self.robot, self.named = robot, named
        self.kept: JointMotion | None = None
        self._found: VerifiedJointMotion | None = None

    def still(self, motion: VerifiedMotion) -> Playback | None:
        """Return the joint motion that is shown, if it carries out a motion of the hands on a changed scene too."""
        from comove.robots import verify_joints

        if self.kept is None:
            return None
        duration, joints = motion.motion.scene.duration, self.kept
        if abs(joints.duration - duration) > 1e-9:
            joints = joints.stretched(duration)
        return self._shown(verify_joints(self.robot, motion, joints).verified)

    def carried(self, motion: CoordinatedMotion) -> Playback | None:
        """Return the joint motion that a search has just verified for a motion of the hands; None for another."""
        found = self._found
        return self._shown(found) if found is not None and found.motion.motion is motion else None

    def _shown(self, verified: VerifiedJointMotion | None) -> Playback | None:
        if verified is None:
            return None
        self.kept = verified.joints
        return playback_of_joints(self.robot, verified.motion.motion, verified.joints, verified.report)

    def find(self, found: VerifiedJointMotion) -> None:
        """Note a joint motion that a search has just verified."""
        self._found = found

    def save(self, solution: RobotSolution, folder: Path) -> None:
        """Write the files of a joint motion into a result folder that is being written."""
        from comove.robots import write_joints
        from comove.views import draw_joints, save

        motion = solution.solution.attempt
        write_joints(folder, solution.joints, solution.verdict, self.robot, motion)
        title = f"{motion.scene.name}, {self.robot.name}"
        save(draw_joints(self.robot, solution.joints, title=title), folder / "joints.png")
