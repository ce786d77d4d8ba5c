"""`solve` and `Executor` for scenes with and without a robot."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from comove.errors import ExtraError, OptionError
from comove.model.scene import Scene
from comove.planning.arguments import check_budget, check_scene
from comove.planning.clock import Budget
from comove.planning.displays import displayed
from comove.planning.effort import EffortLevel, EffortName
from comove.planning.kernels import SceneKind, load_kernels
from comove.planning.method import Method
from comove.planning.objectives import Criterion, Samples
from comove.planning.solution import ProgressCallback, Solution
from comove.planning.solver import Demonstrated, perform, problem_of, solved
from comove.verification.verify import Check

if TYPE_CHECKING:
    from comove.control import Executor as FreeExecutor
    from comove.control import Observer
    from comove.robots import Robot, VerifiedJointMotion
    from comove.robots.online.executor import JointExecutor
    from comove.robots.present import Joints


def solve(
    scene: Scene,
    *,
    robot: Robot | str | Literal[False] | None = None,
    demonstration: Demonstrated | None = None,
    seed: int = 0,
    method: Method | None = None,
    planner: bool = True,
    budget: float | Budget = 30.0,
    objective: Criterion | Callable[[Samples], float] | None = None,
    constraints: Sequence[Callable[[Samples], object]] = (),
    obstacles: Literal["constraint", "cost"] = "constraint",
    checks: Sequence[Check] = (),
    effort: EffortName | EffortLevel = "normal",
    begin: Joints | None = None,
    end: Joints | None = None,
    present: Joints | None = None,
    approach: bool = False,
    release: bool = False,
    progress: ProgressCallback | bool | None = None,
    stop: Callable[[], bool] | None = None,
    found: Callable[[VerifiedJointMotion], None] | None = None,
) -> Solution:
    """Find a verified motion for a scene, and its robot's joint motion.

    Parameters
    ----------
    scene
        Scene to solve.
    robot
        The robot that executes the motion, or its name; by default, the scene's. False leaves the
        joints out: the motion is of the end effectors alone.
    demonstration
        Movement of a single manipulator, of the scene's dimension, or one for each by its name. It is a start for
        the search, and the result resembles it with `LeastJerk` or `PaperCost.resemblance`. Demonstrated
        poses are those of a payload that turns and that all end effectors hold. A distribution is followed where
        people agree: `LeastJerk` weights deviations from its mean by its precision at every instant; with a robot its
        mean is followed.
    seed
        Seed of all random numbers: the same inputs, seed and version give the same motion unless the budget runs out
        (`Solution.timed_out`).
    method
        `Comove()` unless given, with fewer attempts for a robot. Some methods solve a part of the scene, which is the
        scene of the solution. With a robot, others than Comove's own move under equation (4).
    planner
        Whether to start from a path planned in the payload's own configuration space.
    budget
        Processor time of this process after which the best motion so far is returned [s]; compiling does not count.
        Or a `Budget`, which may bound a count of work instead, the same on every machine.
    objective
        Objective that the motion minimises; that of the scene unless given. If the scene has none, it is
        `LeastJerk()`, smooth and near to the demonstration; `LeastTime()` for a scene without duration and
        demonstration; `PaperCost()`, equation (4), if the method is not comove's own, the planner is off or
        obstacles are a cost. The motion for a scene without duration is as fast as its limits, and those of the
        joints, allow; the scene of the solution has its duration.
        A function of `Samples` is minimised by constrained CMA-ES, from a smooth motion, without a robot.
    constraints
        Functions of `Samples` that must be at most 0, or `Equality`; they are checked at samples, besides the scene's
        own constraints. Without a robot only.
    obstacles
        Whether obstacles are constraints, or only the term c_obst of the objective (paper, III-B); in the latter case
        the motion of least cost is returned, verified or not.
    checks
        Further checks that a motion must pass to be verified.
    effort
        How long the search improves a verified motion: "quick" makes one path smooth, "normal" several,
        "thorough" three times as many; or an `EffortLevel`. For comove's own method.
    begin
        The robot's joints at the start, where it holds the payload already: the motion begins there. Some that suit
        are found unless given, and where the scene leaves the grasp open. As `present`, by name or an array.
    end
        Joints near which the motion ends, where the robot holds the payload at its goal. Some that suit are found
        unless given, and where the scene leaves the grasp open. As `begin`.
    present
        The robot's joints now, from which it will approach the payload: by name, or an array, shape (n_joints,)
        [rad, m]; home unless given. Of the joints that hold the payload at the start, those nearer come first.
    approach, release
        Whether there must be an approach from the present joints to the joints at the start, and a release from those
        at the goal home. Joints that leave no room for it are not used, and `Solution.joints.transfers` holds both.
    progress
        Function that is called once a generation, and for every motion that is the best so far; or whether a line
        with stage, best cost and time left is shown, by default in notebooks only.
    stop
        Function that returns whether the search shall end with the best so far; it is asked often.
    found
        Function that is called with every verified joint motion during the search.

    Raises
    ------
    OptionError
        If an argument is out of range, or is of a robot where there is none.
    SceneError, RobotError
        If the robot cannot hold the payload at its start or goal, leaves no room there for a required approach or
        release, or has no such arms; or if present joints are not the robot's, or touch something.
    ExtraError
        If a robot is named, and robots are not installed.

    Warns
    -----
    ComoveWarning
        If the demonstration, adapted to the scene's start and goal, is magnified by more than 3 or leaves the
        workspace.
    """
    of_robot: dict[str, Any] = {
        "begin": begin,
        "end": end,
        "present": present,
        "approach": approach or None,
        "release": release or None,
        "found": found,
    }
    own = {"constraints": constraints or None, "objective": objective if callable(objective) else None}
    wanted: dict[str, Any] = {
        "demonstration": demonstration,
        "seed": seed,
        "checks": checks,
        "effort": effort,
        "stop": stop,
    }
    check_budget(budget)
    with displayed(progress, budget) as tell:
        wanted |= {"method": method, "budget": budget, "objective": objective, "progress": tell or None}
        if (arms := robot_of(scene, robot)) is None:
            _require_none(
                of_robot, "no robot carries the payload", "leave it out, or name a robot: robot='baxter'"
            )
            wanted |= {"planner": planner, "obstacles": obstacles, "constraints": constraints}
            problem = problem_of(scene, **wanted)
            load_kernels(SceneKind.of(problem.scene))
            return perform(solved(problem))
        from comove.robots.kernels import load_robot_kernels
        from comove.robots.solving import check_robot, solved_by_robot

        _require_none(
            own, "functions of one's own are of end effectors alone", "leave the joints out: robot=False"
        )
        check_robot(scene, arms, method, planner, obstacles)
        load_robot_kernels(SceneKind.of(scene))
        given = {name: value for name, value in of_robot.items() if value is not None}
        return perform(solved_by_robot(scene, arms, **wanted, **given))


def robot_of(scene: Scene, robot: Robot | str | Literal[False] | None = None) -> Robot | None:
    """Return the robot that executes motions of a scene, or None.

    Parameters
    ----------
    robot : a robot, or its name or description's path; by default the scene's. False for none

    Raises
    ------
    RobotError
        If there is no such robot.
    ExtraError
        If one is named, and robots are not installed.
    """
    check_scene(scene)
    if robot is False or (robot is None and scene.file.robot is None):
        return None
    try:
        from comove.robots import Robot
    except ExtraError:
        raise ExtraError("a robot (robot=False leaves its joints out)", "robot") from None
    if robot is None:
        return Robot.load(str(scene.file.robot), scene.folder)
    if not isinstance(robot, (Robot, str, Path)):
        way_out = "give a Robot, its name, or the path of its description; False leaves its joints out"
        raise OptionError(f"robot = {robot!r}", way_out=way_out)
    return robot if isinstance(robot, Robot) else Robot.load(robot)


def _require_none(given: dict[str, Any], message: str, way_out: str) -> None:
    for key, value in given.items():
        if value is not None:
            raise OptionError(message, key=key, way_out=way_out)


def Executor(  # it is called as the classes are whose objects it returns
    scene: Scene,
    observer: Observer | None = None,
    *,
    robot: Robot | str | Literal[False] | None = None,
    seed: int = 0,
    period: float | None = None,
    demonstration: Any = None,
) -> FreeExecutor | JointExecutor:
    """Return the executor of a scene, or of the robot it names. Without a robot it moves free end effectors.

    Parameters
    ----------
    scene : the scene; obstacles may move
    observer : observer of the obstacles; by default the scene's motions, with a robot measured positions and
        velocities
    robot, seed : as of `solve`
    period : control period [s]; 0.01 unless given, of a robot 0.004
    demonstration : a movement of one end effector, or one for each, that plans should resemble; without a robot

    Returns
    -------
    `comove.control.Executor`, or `comove.robots.online.executor.JointExecutor`

    Raises
    ------
    OptionError
        If an argument is out of range, or a demonstration is given with a robot.
    SceneError, RobotError
        If the robot cannot hold the payload at its start or goal, or no motion is found among static obstacles.
    """
    if (arms := robot_of(scene, robot)) is None:
        from comove.control import Executor as FreeExecutor
        from comove.control import Pace

        pace = Pace() if period is None else Pace(period=period)
        return FreeExecutor(scene, observer, seed=seed, pace=pace, demonstration=demonstration)
    from comove.robots.online.executor import JointExecutor, OnlineSettings

    _require_none(
        {"demonstration": demonstration}, "robots follow no demonstration step by step", "leave it out"
    )
    settings = OnlineSettings() if period is None else replace(OnlineSettings(), period=period)
    return JointExecutor(scene, arms, observer, seed=seed, settings=settings)
