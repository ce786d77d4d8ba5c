"""The procedure by which a robot solves a scene, and joint solutions."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any
from warnings import warn

from comove.arrays import Array
from comove.brief import brief
from comove.errors import OptionError, RobotError, SceneError
from comove.methods import METHODS, OF_ROBOTS
from comove.model.files.reading import warn_of_no_mass
from comove.model.scene import Scene
from comove.planning.arguments import movements_of
from comove.planning.clock import Budget, now
from comove.planning.compiling import compiling
from comove.planning.kernels import SceneKind
from comove.planning.method import Method
from comove.planning.methods import Comove
from comove.planning.objectives import Criterion, objective_of_scene
from comove.planning.pace import (
    NONE,
    alone,
    least_possible,
    rounded_up,
    too_short,
    with_limits,
    would_do,
)
from comove.planning.search import Schedule
from comove.planning.solution import Solution
from comove.planning.solver import Procedure, perform, problem_of, solved
from comove.robots.carrying import GivenJoints, RobotCarrier
from comove.robots.choosing import SETTINGS as RANKING
from comove.robots.choosing import Reach
from comove.robots.ends import MissedPose
from comove.robots.kernels import load_robot_kernels
from comove.robots.model import Robot
from comove.robots.motion import JointMotion
from comove.robots.present import Joints, present_joints
from comove.robots.transfers import Retreat, Transfers, possible_transfers, require_no_transfers
from comove.robots.verification.bodies import warn_of_buried_links
from comove.robots.verification.verify import JointReport, JointVerdict, VerifiedJointMotion
from comove.verification.verify import Check, verify

AT_LEISURE = 30.0  # s, in which arms can follow any path, where the duration is open


@dataclass(frozen=True, eq=False)
class JointSolution:
    """The joints that execute the motion of a `Solution`.

    Attributes
    ----------
    robot : the robot
    attempt : the verified joint motion, or the one nearest to a verified one
    verdict : result of the verification of `attempt`
    transfers : approach and release, where requested and found
    without : reasons why a requested one was not found
    present : array, shape (n_joints,), joints at which an approach begins; None for home
    """

    __repr__ = brief

    robot: Robot
    attempt: JointMotion
    verdict: JointVerdict
    transfers: Transfers | None = None
    without: tuple[str, ...] = ()
    present: Array | None = None

    @property
    def motion(self) -> VerifiedJointMotion | None:
        """Return the verified joint motion; None if there is none."""
        return self.verdict.verified

    @property
    def report(self) -> JointReport:
        """Return the measures of the joint motion."""
        return self.verdict.report

    @property
    def verified(self) -> bool:
        """Return whether `motion` holds a verified motion."""
        return self.motion is not None


def check_robot(scene: Scene, robot: Robot, method: Method | None, planner: bool, obstacles: str) -> None:
    """Reject scenes without payload and options of free end effectors. Nothing is compiled before.

    Raises
    ------
    OptionError
        If it is an option.
    SceneError, RobotError
        If the robot has no such arms, or the scene no payload.
    """
    way_out = "leave it out, or solve the end effectors alone"
    if method is not None and method.name in METHODS and not METHODS[method.name].serves_robots:
        raise OptionError(
            f"the method '{method.name}' moves end effectors alone, and the robot is '{robot.name}'",
            key="method",
            way_out=f"use {', '.join(OF_ROBOTS)}, or solve the end effectors alone",
        )
    if not planner:
        raise OptionError(f"the joints of '{robot.name}' need a planned path", key="planner", way_out=way_out)
    if obstacles != "constraint":
        raise OptionError(
            f"obstacles are constraints of the robot '{robot.name}'", key="obstacles", way_out=way_out
        )
    require_carried(robot, scene)
    if scene.file.robot is None:  # else its file was warned of
        warn_of_no_mass(scene.file, scene.path, scene.words)


def require_carried(robot: Robot, scene: Scene) -> None:
    """Reject a scene that a robot cannot solve by any grasp.

    Raises
    ------
    SceneError, RobotError
        If the robot has no such arms, or the scene no payload; for the likeliest grasps.
    """
    first: SceneError | RobotError | None = None
    for choice in scene.alternatives:
        try:
            RobotCarrier(robot, choice)
        except (SceneError, RobotError) as error:
            first = first or error
        else:
            return
    raise first or RobotError("nothing is left open", key="grasps")


def solved_by_robot(
    scene: Scene,
    robot: Robot,
    *,
    method: Method | None = None,
    budget: float | Budget = 30.0,
    begin: Joints | None = None,
    end: Joints | None = None,
    present: Joints | None = None,
    approach: bool = False,
    release: bool = False,
    found: Callable[[VerifiedJointMotion], None] | None = None,
    **wanted: Any,
) -> Procedure:
    """Solve a scene by a robot, as `comove.solve`; `wanted` are further arguments of `problem_of`."""
    if begin is not None and (approach or present is not None):
        raise OptionError(
            "the robot holds the load already, and would approach it",
            key="begin",
            way_out="give either begin, or present and approach",
        )
    require_no_transfers(scene, {"approach": approach, "release": release})
    carriers: dict[str, Any] = {
        "given": GivenJoints(
            None if begin is None else present_joints(begin, robot, "begin"),
            None if end is None else present_joints(end, robot, "end"),
        ),
        "present": None if present is None else present_joints(present, robot),
        "approach": approach,
        "release": release,
        "found": found,
    }
    warn_of_buried_links(robot, scene)
    wanted["demonstration"] = movements_of(wanted.get("demonstration"), scene)
    return (yield from _carried(scene, robot, Budget.of(budget), wanted, method, carriers))


def solve_joints(scene: Scene, robot: Robot, **wanted: Any) -> Solution:
    """Solve a scene by a robot, for packages below `comove.solve`."""
    load_robot_kernels(SceneKind.of(scene))
    return perform(solved_by_robot(scene, robot, **wanted))


def carry(scene: Scene, robot: Robot, **wanted: Any) -> Solution:
    """Solve a scene by a robot. It is the former name of `comove.solve(scene, robot=robot)`."""
    warn("comove.robots.carry is now comove.solve(scene, robot=robot)", DeprecationWarning, stacklevel=2)
    return solve_joints(scene, robot, **wanted)


def _carried(
    scene: Scene,
    robot: Robot,
    budget: Budget,
    wanted: dict[str, Any],
    method: Method | None,
    carriers: dict[str, Any],
    tried: RobotCarrier | None = None,
) -> Procedure:
    """Solve; `wanted` are further arguments of `problem_of`, `carriers` those of `RobotCarrier`.

    `tried` is a carrier whose ends are solved and clear, in another duration; None if there is none.
    """
    if scene.file.choices is not None or len(scene.alternatives) > 1:
        return (
            yield from _by_some_grasp(
                scene, robot, budget, wanted, method, carriers | {"given": GivenJoints()}
            )
        )
    (scene,) = scene.alternatives
    begun = now()
    wanted["objective"] = wanted.get("objective") or objective_of_scene(scene.file.objective)
    # Among moving obstacles a motion is only what it is in its own time.
    at_leisure = _first_duration(scene) if scene.moving.any() else AT_LEISURE
    if (present := carriers["present"]) is not None:
        Retreat.on(scene.timed(at_leisure), robot, "start", present).require_apart()
    with compiling() as compiled:
        timed = scene.timed(at_leisure)
        carrier = RobotCarrier(robot, timed, **carriers) if tried is None else tried.on(timed)
        carrier.require_reach()
        if _keeps_duration(scene, wanted["objective"]):
            carrier.require_room_for_obstacles()
        if tried is None and not scene.moving.any() and not carrier.may_be_clear_at_ends:
            carrier.require_clear_ends()
    budget = budget.after(now() - begun - compiled.seconds, 0.0)
    search = partial(_in_time, scene, method, wanted)
    if carrier.transfers:
        solution = yield from _with_transfers(search, carrier, budget)
    else:
        solution = yield from search(carrier, budget)
    return replace(solution, joints=replace(solution.joints, present=present))


def _with_transfers(
    search: Callable[[RobotCarrier, Budget], Procedure], carrier: RobotCarrier, budget: Budget
) -> Procedure:
    """Solve, and plan the carrier's required approach and release.

    Without one, other joints at that end are tried as long as the budget lasts. Of solutions without one the first is
    returned.
    """
    best: Solution | None = None
    before: Solution | None = None
    while True:
        found = yield from search(carrier, budget)
        budget = budget.after(found.effort.seconds, found.effort.work)
        if before is not None:
            found = found.after(before)
        before = found
        if found.joints.motion is None:
            return best or found
        transfers, errors = possible_transfers(
            found.joints.motion, carrier.approach, carrier.release, carrier.present
        )
        without = tuple(map(str, errors.values()))
        found = replace(found, joints=replace(found.joints, transfers=transfers, without=without))
        if not errors:
            return found
        best = best or found
        position = found.joints.attempt.position
        ends = {"start": position[0], "goal": position[-1]}
        carrier = carrier.without({end: ends[end] for end in errors})
        try:
            carrier.require_reach()
        except RobotError:  # no other joints are left
            return best
        if budget.is_spent or found.interrupted:
            return best


def _in_time(
    scene: Scene,
    method: Method | None,
    wanted: dict[str, Any],
    carrier: RobotCarrier,
    budget: Budget,
) -> Procedure:
    """Solve with one grasp, in the scene's duration or the least. The carrier's scene has a long duration."""
    timed_share = 0.7  # of the work, after which it is seen how long a way takes that arms go at leisure
    whole = budget.size
    if scene.moving.any():
        return (yield from _among_moving(scene, carrier, method or robot_method(), budget, wanted))
    if method is not None:
        own = carrier.on(scene) if scene.is_timed else carrier
        return (yield from _searched(scene, own, method, budget, wanted))
    if not _keeps_duration(scene, wanted["objective"]):
        return (yield from _searched(scene.timed(None), carrier, robot_method(), budget, wanted))
    timed = least_possible(scene) <= scene.duration
    if timed:
        share = budget.within(timed_share * whole)
        first = yield from _searched(scene, carrier.on(scene), robot_method(), share, wanted)
        budget = budget.after(first.effort.seconds, first.effort.work)
        if first.joints.verified or first.interrupted or budget.is_spent:
            return first
    method = replace(robot_method(), n_ways=1)
    freely = with_limits(scene, NONE).timed(None)
    slow = yield from _searched(freely, carrier, method, budget, wanted)
    needed = slow.scene.duration
    if slow.joints.verified and (needed <= scene.duration or not timed):
        best = _on_time(slow, carrier.on(scene), wanted.get("checks", ()))
    else:
        best = first if timed else slow
    reasons, late = best.reasons, slow.timed_out and not best.joints.verified
    if slow.joints.verified and needed > scene.duration and not late:
        cut = best.timed_out
        reasons = (*reasons, would_do(needed) if cut else too_short(scene, needed))
    if late and budget.ran_out not in reasons:
        reasons = (budget.ran_out, *reasons)
    solution = replace(best, reasons=reasons, interrupted=slow.interrupted, timed_out=best.timed_out or late)
    return solution.after(slow if best is first else first) if timed else solution


def _among_moving(
    scene: Scene, carrier: RobotCarrier, method: Method, budget: Budget, wanted: dict[str, Any]
) -> Procedure:
    """Solve among moving obstacles, in the given duration or the shortest found. No motion is stretched."""
    kept = _keeps_duration(scene, wanted["objective"])
    if kept and (least := least_possible(scene)) > scene.duration:
        raise SceneError(
            f"it is {scene.duration:g} s, and no motion within the limits takes less than {rounded_up(least, 3):g} s",
            file=scene.path,
            key="duration",
            way_out="leave it out: then the shortest one is looked for in which the payload gets past the obstacles",
        )
    solution = yield from _searched(scene, carrier, method, budget, wanted)
    if solution.joints.verified or not kept or solution.interrupted:
        return solution
    told = "obstacles move, so the motion is not slowed down: leave duration out to have it looked for"
    return replace(solution, reasons=(*solution.reasons, told))


def _keeps_duration(scene: Scene, objective: Criterion | None) -> bool:
    return scene.is_timed and not (objective is not None and objective.is_time)


def _first_duration(scene: Scene) -> float:
    return scene.duration if scene.is_timed else alone(scene.with_limits(), None)


def _by_some_grasp(
    scene: Scene,
    robot: Robot,
    budget: Budget,
    wanted: dict[str, Any],
    method: Method | None,
    carriers: dict[str, Any],
) -> Procedure:
    """Solve by the scene's first feasible grasp, least joint rotations first.

    Grasps out of reach, or with contacts at an end, are left out. Each of the others has half of the remaining work,
    the last all of it.
    """
    begun, work = now(), 0.0
    with compiling() as compiled:
        kept = _keeps_duration(scene, wanted.get("objective") or objective_of_scene(scene.file.objective))
        ways = _clear_ways(scene, robot, carriers, kept)
        choice: tuple[Scene, RobotCarrier] | tuple[()] | None = next(ways)
    begun += compiled.seconds
    best: Solution | None = None
    while choice:
        left, following = budget.after(now() - begun, work), next(ways, ())
        if best is not None and left.is_spent:
            break
        part = left if following == () else left.within(0.5 * left.size)
        solution = yield from _carried(choice[0], robot, part, dict(wanted), method, carriers, choice[1])
        work += solution.effort.work
        if (solution.joints.verified and not solution.joints.without) or solution.interrupted:
            return solution
        if best is None or (solution.joints.verified and not best.joints.verified):
            best = solution
        choice = next(ways, ()) if following is None else following
    assert best is not None, "one was tried"
    return best


def _clear_ways(
    scene: Scene, robot: Robot, carriers: dict[str, Any], kept: bool
) -> Iterator[tuple[Scene, RobotCarrier] | None]:
    """Yield grasps and placements that are clear at the ends, likeliest first.

    Those whose poses are missed from the first seeds come last, after None, as it takes long to find them.

    Each has a carrier, in some duration. Those come first by which more grasps hold the payload. Where a
    scene leaves many open, they are ranked by the reach of each arm, and the first few clear ones by their joint
    rotations.

    Parameters
    ----------
    kept : whether the duration is given; where it is open, moving obstacles' places at the goal are unknown

    Raises
    ------
    SceneError, RobotError
        If there is none.
    """
    reach, n_found, choices = Reach(robot, scene), 0, scene.file.choices or ()
    errors = dict[int, SceneError | RobotError]()
    ways: list[Callable[[], Scene]]
    if len(choices) > RANKING.exact or any(choice.free is not None for choice in choices):
        ways = [partial(scene.put_down, *way) for way in reach.ranked()]
    else:
        ways = [partial(scene.alternatives.__getitem__, k) for k in range(len(scene.alternatives))]
    later = not choices or len(ways) <= RANKING.exact  # the ends of others are not needed where one will do

    def is_clear(k: int, carrier: RobotCarrier) -> bool:
        try:
            known = kept or not carrier.scene.moving.any()
            if known and not carrier.is_clear_at_ends:
                carrier.require_clear_ends()
        except (SceneError, RobotError) as error:
            errors[k] = error
        return k not in errors

    missed, all_seeds = list[tuple[int, Callable[[], Scene]]](), False
    untried = iter([*enumerate(ways)])
    while True:
        tried = list[tuple[int, float, int, Scene, RobotCarrier]]()
        for k, way in untried:
            try:
                choice = way()
                first_try = _first_duration(choice) if choice.moving.any() else 1.0
                carrier = RobotCarrier(robot, choice.timed(first_try), **carriers)
                carrier.require_reach(all_seeds)
                if later or is_clear(k, carrier):
                    tried.append((int(choice.n_far[0]), round(carrier.turning, 6), k, choice, carrier))
            except MissedPose:
                missed.append((k, way))
            except (SceneError, RobotError) as error:
                errors[k] = error
            if choices and len(tried) == RANKING.exact:
                break
        if not tried and not missed:
            break
        if not tried:  # all seeds take ten times as long, and are for scenes that are not solved otherwise
            if n_found:
                yield None
            untried, missed, all_seeds = iter(missed), [], True
        for *_, k, choice, carrier in sorted(tried, key=lambda one: one[:3]):
            if not later or is_clear(k, carrier):
                n_found += 1
                yield choice, carrier
    if not n_found:
        if not errors:  # which say what is missing
            RobotCarrier(robot, scene.put_down(reach.nearest()).timed(1.0), **carriers).require_reach()
        raise errors[min(errors)] if errors else RobotError("no arms reach the grasps", key="grasps")


def robot_method() -> Comove:
    """Return the default method with fewer attempts. With arms, a generation is forty times as long."""
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
) -> Procedure:
    """Search a motion on `scene`, with the robot's constraints. These are for the duration of the carrier's scene."""
    problem = problem_of(scene, method=method, budget=budget, kinematics=carrier, **wanted)
    solution = yield from solved(problem)
    return _with_joints(solution, carrier)


def _with_joints(solution: Solution, carrier: RobotCarrier) -> Solution:
    """Return a solution with the joints that execute it."""
    carrier = carrier.on(solution.scene) if carrier.scene.moving.any() else carrier
    joints = JointSolution(carrier.robot, *carrier.carried_out(solution.attempt))
    return replace(solution, joints=joints)


def _on_time(found: Solution, carrier: RobotCarrier, checks: Sequence[Check]) -> Solution:
    """Return the same motion in the duration of a carrier's scene, verified."""
    scene = carrier.scene
    motion = found.attempt.on(scene)
    verdict = verify(motion, [*checks, *carrier.checks])
    solution = replace(
        found,
        scene=scene,
        motion=verdict.verified,
        attempt=motion,
        report=verdict.report,
        reasons=verdict.reasons,
    )
    return _with_joints(solution, carrier)
