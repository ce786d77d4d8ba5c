"""Grasps and placements of a payload, ranked by the reach of arms.

They are ranked before any search. For every grasp at both ends the joints of its arm are solved by themselves. The
value of an option is the least rotation of joints from home to the start and on to the goal, that of the worst arm,
and more where an arm is nearly singular there. Grasps and ends that options share are solved once.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property, partial

import numpy as np

from comove.arrays import Array
from comove.geometry.rotations import matrices
from comove.model.files.keys import GraspOption, PayloadPose
from comove.model.free_goals import FreeGoal, TurnSettings
from comove.model.grasp import turned_goal
from comove.model.scene import Scene
from comove.robots.ends import of_robot, solved_for
from comove.robots.model import Arm, Robot
from comove.robots.search.chains import jacobian, place_arm, turned_towards
from comove.robots.search.following import MET
from comove.robots.search.ranges import may_reach


@dataclass(frozen=True)
class ReachSettings:
    """Settings of the ranking of grasps and placements.

    Attributes
    ----------
    exact : options that are checked with all bodies, unless fewer are clear at their ends: the best is first
    singular : least singular value of a Jacobian at which an option counts one radian more [m/rad, with `lever`]
    lever : length by which angular velocities are compared with velocities [m]
    turns : of goals that are free, before the best turns are refined
    n_seeds : random joints from which a pose is solved where it has no closed form
    n_kept : solutions of a pose that are compared
    """

    exact: int = 4
    singular: float = 0.02
    lever: float = 0.2
    turns: TurnSettings = field(default_factory=lambda: TurnSettings(step=np.deg2rad(15.0)))
    n_seeds: int = 8
    n_kept: int = 8


SETTINGS = ReachSettings()


@dataclass(frozen=True, eq=False)
class Reach:
    """The reach of a robot's arms, each by itself.

    Attributes
    ----------
    robot, scene : the robot, and a scene that leaves open how the payload is held
    """

    robot: Robot
    scene: Scene

    def ranked(self) -> list[tuple[GraspOption, float]]:
        """Return the options within reach of all arms, best first.

        Each has the turn of its goal. Those by which more grasps hold the payload precede all others.
        """
        found, n_far = list[tuple[int, float, int, GraspOption, float]](), self.scene.n_far.tolist()
        for k, choice in enumerate(self.scene.file.choices or ()):
            turns = [0.0]
            if choice.free is not None and np.isfinite(self._away(choice, choice.goal, False)):
                goal = FreeGoal(self.scene, choice)
                turns = [0.0, *goal.turns(partial(self.value, choice), SETTINGS.turns)]
            values = ((self.value(choice, turn), turn) for turn in dict.fromkeys(turns))
            found += [
                (n_far[k], round(value, 6), k, choice, turn) for value, turn in values if np.isfinite(value)
            ]
        return [(choice, turn) for *_, choice, turn in sorted(found, key=lambda one: one[:3])]

    def nearest(self) -> GraspOption:
        """Return the option nearest to reach, where arms reach none."""
        assert self.scene.file.choices, "a scene that leaves nothing open is not ranked"
        return min(self.scene.file.choices, key=self._missing)

    def value(self, choice: GraspOption, turn: float = 0.0) -> float:
        """Return an option's least joint rotation, infinite out of reach [rad]."""
        return self._away(choice, turned_goal(choice, turn).goal, True)

    def _away(self, choice: GraspOption, goal: PayloadPose, to_goal: bool) -> float:
        load, worst = self.scene.file.load, 0.0
        assert load is not None and load.start is not None, "choices are about payloads with poses"
        for name in choice.grasps:
            first, cost, _ = self._joints(name, choice, load.start)
            if not len(first):
                return np.inf
            home = self.robot.arm(name).home
            away = np.abs(first - home).max(axis=1) + cost
            if to_goal:
                last, cost, _ = self._joints(name, choice, goal)
                if not len(last):
                    return np.inf
                on = np.abs(first[:, None] - last).max(axis=2) + cost
                away = away + on.min(axis=1)
            worst = max(worst, float(away.min()))
        return worst

    def _missing(self, choice: GraspOption) -> float:
        load = self.scene.file.load
        assert load is not None and load.start is not None, "choices are about payloads with poses"
        ends = (load.start, choice.goal)
        return max(self._joints(name, choice, end)[2] for name in choice.grasps for end in ends)

    @cached_property
    def _solved(self) -> dict[tuple[str, bytes], tuple[Array, Array, float]]:
        return {}

    def _joints(self, name: str, choice: GraspOption, end: PayloadPose) -> tuple[Array, Array, float]:
        """Return an arm's joints for a grasp, their singularity cost and residual.

        Arrays, shapes (n, n_joints) and (n,); empty where it does not reach.
        """
        frames = choice.frames or {}
        turn = matrices(np.array(end.quaternion_wxyz))
        rotation = turn @ matrices(np.array(frames[name]))
        point = np.array(end.position) + turn @ np.array(choice.grasps[name])
        key = name, np.append(rotation, point).round(9).tobytes()
        if key not in self._solved:
            self._solved[key] = self._solve(name, rotation, point)
        return self._solved[key]

    @cached_property
    def _holders(self) -> tuple[Arm, ...]:
        return tuple(self.robot.arm(name) for name in self.scene.manipulators)

    def _solve(self, name: str, rotation: Array, point: Array) -> tuple[Array, Array, float]:
        i, posture = self.scene.manipulators.index(name), np.concatenate([arm.home for arm in self._holders])
        chains, _, ranges, _ = of_robot(self.robot, self._holders)
        part = slice(chains.first[i], chains.first[i + 1])
        n = part.stop - part.start
        nothing = np.zeros((0, n)), np.zeros(0)
        if not may_reach(ranges, i, rotation, point):
            away = np.linalg.norm(point - self.robot.tool_pose(self.robot.home, self._holders[i])[:3, 3])
            return *nothing, 1.0 + float(away)
        joints, missing = solved_for(self.robot, self._holders, i, rotation, point, posture, SETTINGS.n_seeds)
        met = missing <= MET
        if not met.any():
            return *nothing, float(missing.min())
        joints = joints[met]
        joints[:, part] = turned_towards(chains, posture[part], joints[:, part], part)
        away = np.abs(joints[:, part] - posture[part]).max(axis=1)
        joints = joints[np.argsort(away.round(6), kind="stable")[: SETTINGS.n_kept]]
        rotations, points, slopes = np.empty((n + 1, 3, 3)), np.empty((n + 1, 3)), np.empty((6, n))
        cost = np.empty(len(joints))
        for k, q in enumerate(joints):
            place_arm(chains, i, q, rotations, points)
            jacobian(chains, i, rotations, points, slopes)
            slopes[3:] *= SETTINGS.lever
            cost[k] = SETTINGS.singular / max(np.linalg.svd(slopes, compute_uv=False)[-1], 1e-6)
        return joints[:, part], cost, 0.0
