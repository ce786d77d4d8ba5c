"""`carry`: from a scene and a robot to a judged joint motion."""

from __future__ import annotations

import time
from dataclasses import dataclass

from comove.planning.compiling import compiling
from comove.planning.objectives import LeastJerk, LeastTime, PaperCost
from comove.planning.solution import ProgressCallback, Solution
from comove.planning.solver import solve
from comove.primitives.dmp import DMP
from comove.robots.check import RobotCheck
from comove.robots.judge.verify import JointReport, JointVerdict, VerifiedJointMotion
from comove.robots.model import Robot
from comove.robots.motion import JointMotion
from comove.robots.search.carrying import Carrying, robot_method
from comove.scenes.scene import Scene


AT_LEISURE = 30.0  # s, in which arms go any way, where the duration is open


@dataclass(frozen=True, eq=False)
class RobotSolution:
    """The outcome of `carry`.

    Attributes
    ----------
    robot : who carries
    solution : the motion of the hands; its reasons hold those of the robot
    joints : the joint motion handed out: the verified one, or what comes nearest to it
    verdict : of the judge on `joints`
    """

    robot: Robot
    solution: Solution
    joints: JointMotion
    verdict: JointVerdict

    @property
    def motion(self) -> VerifiedJointMotion | None:
        """The verified joint motion; None where none was found."""
        return self.verdict.verified

    @property
    def report(self) -> JointReport:
        """What the judge measured."""
        return self.verdict.report

    @property
    def verified(self) -> bool:
        """Whether `motion` holds a verified motion."""
        return self.motion is not None


def carry(
    scene: Scene,
    robot: Robot,
    *,
    demonstration: DMP | None = None,
    seed: int = 0,
    budget: float = 30.0,
    objective: LeastJerk | LeastTime | PaperCost | None = None,
    progress: ProgressCallback | None = None,
) -> RobotSolution:
    """Find a motion for a scene that a robot can carry out, and judge its joints.

    Parameters
    ----------
    scene
        With a grasp; its manipulators are arms of the robot. Where it leaves its duration out, or `LeastTime()` is
        asked for, the motion is as fast as the limits of hands and joints allow at its own law of motion.
    robot
        `Robot.load("baxter")`, for example.
    demonstration, seed, objective, progress
        As for `comove.planning.solve`.
    budget
        Seconds after which the best so far is returned; compiling, once after installation, is apart.

    Raises
    ------
    SceneError, RobotError
        If the robot cannot hold the load at its start or goal, or has no such arms.
    """
    begun = time.perf_counter()
    open_ended = not scene.is_timed or isinstance(objective, LeastTime)
    with compiling() as compiled:
        task = Carrying(robot, scene.timed(AT_LEISURE) if open_ended else scene)
        check = RobotCheck(task)
        check.prepare()
    spent = time.perf_counter() - begun - compiled.seconds
    solution = solve(
        scene,
        demonstration=demonstration,
        seed=seed,
        method=robot_method(),
        budget=max(0.5 * budget, budget - spent),
        carrier=task,
        checks=[check],
        objective=objective,
        progress=progress,
    )
    done = check.carried_out(solution.attempt)
    return RobotSolution(robot, solution, done.joints, done.verdict)
