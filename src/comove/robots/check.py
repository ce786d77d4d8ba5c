"""Check of candidate motions during a search: the arms follow the hands exactly, and the joint motion is judged."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from comove.coordination.coordinates import load_coordinates
from comove.coordination.motion import CoordinatedMotion
from comove.planning.configurations import configuration_space
from comove.robots.motion import JointMotion
from comove.robots.search.carrying import Carrying
from comove.robots.search.tracking import Miss, track
from comove.robots.verification.verify import JointReport, JointVerdict, verify_joints


@dataclass(frozen=True, eq=False)
class RobotMotion:
    """A joint motion that follows a motion of the hands, and the verdict on it.

    Attributes
    ----------
    joints : joint motion that comes nearest to the motion of the hands
    verdict : verdict of the judge on `joints`
    """

    joints: JointMotion
    verdict: JointVerdict


class RobotCheck:
    """A check, as `comove.verification` runs it, that tells whether the robot can carry out a motion of the hands.

    Parameters
    ----------
    task : the robot and the scene
    """

    def __init__(self, task: Carrying):
        self.task = task
        self._last: tuple[CoordinatedMotion, RobotMotion] | None = None

    def prepare(self) -> None:
        """Compile the kernels, or load them from the cache, and solve both ends, before the clock of the search
        starts.

        Raises
        ------
        SceneError
            If an arm cannot reach its start or its goal.
        """
        scene, coordinates = self.task.scene, load_coordinates(self.task.scene)
        straight = CoordinatedMotion.straight(scene, coordinates)
        space, rng = configuration_space(scene, coordinates), np.random.default_rng(0)
        self.task.plan(space, straight.boundary[0], straight.boundary[0], 0.0, rng, max_nodes=8)
        self.task.forget()
        self.task.ask(coordinates.nodes(np.ascontiguousarray(straight.knots[0].T[None])))
        track(self.task, straight)

    def __call__(self, motion: CoordinatedMotion) -> tuple[str, ...]:
        """Return the reasons against `motion`; none if the robot can carry it out."""
        return self.carried_out(motion).verdict.reasons

    def carried_out(self, motion: CoordinatedMotion) -> RobotMotion:
        """Compute and judge the joints that follow a motion; the last result is cached."""
        if self._last is None or self._last[0] is not motion:
            joints, miss = track(self.task, motion)
            if miss is not None:
                verdict = JointVerdict(None, JointReport(), (_out_of_reach(miss),))
            else:
                verdict = verify_joints(self.task.robot, motion, joints)
            self._last = motion, RobotMotion(joints, verdict)
        return self._last[1]


def _out_of_reach(miss: Miss) -> str:
    where = f"the arm '{miss.arm}' does not reach its hand's pose at {miss.time:.2f} s"
    return f"{where}: {miss.distance:.3g} m are missing"
