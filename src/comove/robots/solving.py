"""`carry`, which finds and verifies a joint motion for a scene and a robot."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

import comove
from comove.dmp.dmp import DMP
from comove.errors import OptionError, RobotError, SceneError
from comove.planning.clock import Budget, now
from comove.planning.compiling import compiling
from comove.planning.displays import displayed
from comove.planning.kernels import SceneKind
from comove.planning.method import Method
from comove.planning.methods import Comove
from comove.planning.objectives import LeastJerk, LeastTime, PaperCost, objective_of_scene
from comove.planning.pace import NONE, least_possible, too_short, with_limits, would_do
from comove.planning.search import Schedule
from comove.planning.solution import ProgressCallback, Solution
from comove.planning.solver import solve
from comove.processes import one_blas_thread
from comove.robots.carrying import RobotCarrier
from comove.robots.kernels import load_robot_kernels
from comove.robots.model import Robot
from comove.robots.motion import JointMotion
from comove.robots.present import Joints, present_joints
from comove.robots.transfers import Retreat, Transfers, possible_transfers
from comove.robots.verification.bodies import warn_of_buried_links
from comove.robots.verification.verify import JointReport, JointVerdict, VerifiedJointMotion
from comove.scenes.scene import Scene
from comove.verification.verify import verify

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class RobotSolution:
    """The outcome of `carry`: a motion of the hands, a joint motion and the verdict on it.

    Attributes
    ----------
    robot : the robot that carries
    solution : the motion of the hands; its reasons include those of the robot
    joints : the verified joint motion, or the one that comes nearest to a verified one
    verdict : result of the verification of `joints`
    transfers : approach and release, where they were asked for and found
    without : reasons why one that was asked for was not found
    present : array, shape (n_joints,), joints at which an approach begins; None for home
    """

    robot: Robot
    solution: Solution
    joints: JointMotion
    verdict: JointVerdict
    transfers: Transfers | None = None
    without: tuple[str, ...] = ()
    present: Array | None = None

    @property
    def motion(self) -> VerifiedJointMotion | None:
        """Return the verified joint motion; None where none was found."""
        return self.verdict.verified

    @property
    def report(self) -> JointReport:
        """Return the measures of the joint motion."""
        return self.verdict.report

    @property
    def verified(self) -> bool:
        """Return whether `motion` holds a verified motion."""
        return self.motion is not None

    def show(self) -> None:
        """Show the robot's motion in a notebook, or else in a browser; see `comove.show`."""
        comove.show(self)

    def _repr_html_(self) -> str:
        """Return verdict, picture and measures for a notebook."""
        return comove.as_html(self)


@one_blas_thread()
def carry(
    scene: Scene,
    robot: Robot,
    *,
    demonstration: DMP | tuple[DMP, ...] | None = None,
    seed: int = 0,
    method: Method | None = None,
    budget: float | Budget = 30.0,
    objective: LeastJerk | LeastTime | PaperCost | None = None,
    progress: ProgressCallback | bool | None = None,
    begin: Joints | None = None,
    present: Joints | None = None,
    approach: bool = False,
    release: bool = False,
    stop: Callable[[], bool] | None = None,
    found: Callable[[VerifiedJointMotion], None] | None = None,
) -> RobotSolution:
    """Find a motion for a scene that a robot can carry out, and verify its joints.

    Parameters
    ----------
    scene
        A scene with a grasp, whose manipulators are arms of the robot. If it has no duration, or `LeastTime()` is
        asked for, the motion is as fast as the limits of hands and joints allow at its own law of motion.
    robot
        `Robot.load("baxter")`, for example.
    method
        Comove's own for robots unless given. Another one, such as `Paper()`, moves free hands under equation (4), and
        so serves loads that end at the hands.
    demonstration, seed, objective, progress, stop
        As for `comove.planning.solve`.
    found
        Function that is called with every joint motion that is verified on the way.
    budget
        As for `comove.planning.solve`; threads that follow the arms count as well.
    begin
        The robot's joints at the start, where it holds the load already: the motion begins there. Some that suit are
        found unless given, and wherever the scene leaves the grasp open. As `present`, by name or an array.
    present
        The robot's joints now, from which it will approach the load: by name, or an array, shape (n_joints,)
        [rad, m]; home unless given. Of the joints that hold the load at the start, those nearer to them come first.
    approach, release
        Whether there must be an approach from the present joints to the joints at the start, and a release from those
        at the goal home. Joints that leave no room for it are not used, and `RobotSolution.transfers` holds both.

    Raises
    ------
    SceneError, RobotError
        If the robot cannot hold the load at its start or goal, leaves no room there for an approach or a release that
        is asked for, or has no such arms; or if present joints are not the robot's, or touch something.
    OptionError
        If the robot holds the load already (`begin`), and shall approach it.
    """
    if begin is not None and (approach or present is not None):
        raise OptionError(
            "the robot holds the load already, and would approach it",
            key="begin",
            way_out="give either begin, or present and approach",
        )
    carriers: dict[str, Any] = {
        "begin": None if begin is None else present_joints(begin, robot, "begin"),
        "present": None if present is None else present_joints(present, robot),
        "approach": approach,
        "release": release,
        "found": found,
    }
    warn_of_buried_links(robot, scene)
    with displayed(progress, budget) as tell:
        load_robot_kernels(SceneKind.of(scene))
        wanted: dict[str, Any] = {
            "demonstration": demonstration,
            "seed": seed,
            "objective": objective,
            "progress": tell,
            "stop": stop,
        }
        return _carried(scene, robot, Budget.of(budget), wanted, method, carriers)


def _carried(
    scene: Scene,
    robot: Robot,
    budget: Budget,
    wanted: dict[str, Any],
    method: Method | None,
    carriers: dict[str, Any],
) -> RobotSolution:
    """Carry; `wanted` are further arguments of `solve`, `carriers` those of `RobotCarrier`."""
    at_leisure = 30.0  # s, in which arms can follow any path, where the duration is open
    if len(scene.alternatives) > 1:
        return _by_some_grasp(scene, robot, budget, wanted, method, carriers | {"begin": None})
    (scene,) = scene.alternatives
    begun = now()
    wanted["objective"] = wanted["objective"] or objective_of_scene(scene.file.objective)
    if (present := carriers["present"]) is not None:
        Retreat.on(scene.timed(at_leisure), robot, "start", present).require_apart()
    with compiling() as compiled:
        carrier = RobotCarrier(robot, scene.timed(at_leisure), **carriers)
        carrier.require_reach()
    budget = budget.after(now() - begun - compiled.seconds, 0.0)
    search = partial(_in_time, scene, method, wanted)
    solution = _with_transfers(search, carrier, budget) if carrier.transfers else search(carrier, budget)
    return replace(solution, present=present)


def _with_transfers(
    search: Callable[[RobotCarrier, Budget], RobotSolution], carrier: RobotCarrier, budget: Budget
) -> RobotSolution:
    """Carry, and plan approach and release as the carrier says.

    Where there is none, other joints at that end are tried as long as the budget lasts. Of carries without one the
    first is returned.
    """
    best: RobotSolution | None = None
    before: Solution | None = None
    while True:
        found = search(carrier, budget)
        budget = budget.after(found.solution.solve_time_s, found.solution.work)
        if before is not None:
            found = replace(found, solution=found.solution.after(before))
        before = found.solution
        if found.motion is None:
            return best or found
        transfers, errors = possible_transfers(
            found.motion, approach=carrier.approach, release=carrier.release, present=carrier.present
        )
        found = replace(found, transfers=transfers, without=tuple(map(str, errors.values())))
        if not errors:
            return found
        best = best or found
        ends = {"start": found.joints.position[0], "goal": found.joints.position[-1]}
        carrier = carrier.without({end: ends[end] for end in errors})
        try:
            carrier.require_reach()
        except RobotError:  # no other joints are left
            return best
        if budget.is_spent or found.solution.interrupted:
            return best


def _in_time(
    scene: Scene,
    method: Method | None,
    wanted: dict[str, Any],
    carrier: RobotCarrier,
    budget: Budget,
) -> RobotSolution:
    """Carry on a scene with one grasp, in its duration or as fast as possible; the carrier's scene is at leisure."""
    timed_share = 0.7  # of the work, after which it is seen how long a way takes that arms go at leisure
    whole, objective = budget.size, wanted["objective"]
    if method is not None:
        return _searched(scene, carrier.on(scene) if scene.is_timed else carrier, method, budget, wanted)
    if not scene.is_timed or isinstance(objective, LeastTime):
        return _searched(scene.timed(None), carrier, robot_method(), budget, wanted)
    timed = least_possible(scene) <= scene.duration
    if timed:
        share = budget.within(timed_share * whole)
        first = _searched(scene, carrier.on(scene), robot_method(), share, wanted)
        budget = budget.after(first.solution.solve_time_s, first.solution.work)
        if first.verified or first.solution.interrupted or budget.is_spent:
            return first
    method = replace(robot_method(), n_ways=1)
    freely = with_limits(scene, NONE).timed(None)
    slow = _searched(freely, carrier, method, budget, wanted)
    needed = slow.solution.scene.duration
    if slow.verified and (needed <= scene.duration or not timed):
        best = _on_time(slow, carrier.on(scene))
    else:
        best = first if timed else slow
    reasons, late = best.solution.reasons, slow.solution.timed_out and not best.verified
    if slow.verified and needed > scene.duration and not late:
        cut = best.solution.timed_out
        reasons = (*reasons, would_do(needed) if cut else too_short(scene, needed))
    if late and budget.ran_out not in reasons:
        reasons = (budget.ran_out, *reasons)
    solution = replace(
        best.solution,
        reasons=reasons,
        interrupted=slow.solution.interrupted,
        timed_out=best.solution.timed_out or late,
    )
    if timed:
        solution = solution.after(slow.solution if best is first else first.solution)
    return replace(best, solution=solution)


def _by_some_grasp(
    scene: Scene,
    robot: Robot,
    budget: Budget,
    wanted: dict[str, Any],
    method: Method | None,
    carriers: dict[str, Any],
) -> RobotSolution:
    """Carry by the first of the scene's grasps by which it can be done, those first that turn the joints least.

    Grasps that are out of reach, or by which bodies are too near at an end, are left out. Each of the others has half
    of the work that is left, the last all of it.
    """
    ranked, first = list[tuple[float, Scene]](), None
    begun, work = now(), 0.0
    for choice in scene.alternatives:
        try:
            carrier = RobotCarrier(robot, choice.timed(1.0), **carriers)
            carrier.require_reach()
            carrier.require_clear_ends()
            ranked.append((round(carrier.turning, 6), choice))
        except (SceneError, RobotError) as error:
            first = first or error
    if not ranked:
        assert first is not None, "scenes that leave the grasp open have alternatives"
        raise first
    ranked.sort(key=lambda pair: pair[0])
    best: RobotSolution | None = None
    for k, (_, choice) in enumerate(ranked):
        left = budget.after(now() - begun, work)
        if best is not None and left.is_spent:
            break
        part = left if k == len(ranked) - 1 else left.within(0.5 * left.size)
        solution = _carried(choice, robot, part, dict(wanted), method, carriers)
        work += solution.solution.work
        if (solution.verified and not solution.without) or solution.solution.interrupted:
            return solution
        if best is None or (solution.verified and not best.verified):
            best = solution
    assert best is not None, "one was tried"
    return best


def robot_method() -> Comove:
    """Return the default method with fewer attempts: with arms to follow, a generation takes forty times as long."""
    return Comove(
        n_plans=2,
        n_failures=36,
        n_nodes=200,
        n_restarts=6,
        n_unfit=8,
        n_polishings=4,
        n_ways=3,
        n_idle=1,
        polishing=Schedule(sigma=0.02, generations=200, patience=20, gain=0.01),
    )


def _searched(
    scene: Scene, carrier: RobotCarrier, method: Method, budget: Budget, wanted: dict[str, Any]
) -> RobotSolution:
    """Search a motion on `scene`, with the robot's constraints at the duration of the carrier's scene."""
    solution = solve(scene, method=method, budget=budget, carrier=carrier, **wanted)
    return RobotSolution(carrier.robot, solution, *carrier.carried_out(solution.attempt))


def _on_time(found: RobotSolution, carrier: RobotCarrier) -> RobotSolution:
    """Return the same motion in the duration of a carrier's scene, verified."""
    scene = carrier.scene
    motion = found.solution.attempt.on(scene)
    verdict = verify(motion, [carrier.reasons])
    solution = replace(
        found.solution,
        scene=scene,
        motion=verdict.verified,
        attempt=motion,
        report=verdict.report,
        reasons=verdict.reasons,
    )
    return RobotSolution(found.robot, solution, *carrier.carried_out(motion))
