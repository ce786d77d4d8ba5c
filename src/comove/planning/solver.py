"""Searches for verified motions of a scene, and procedures that order them.

`comove.solve` performs such a procedure; `solve` here is that of given kinematics.
"""

from __future__ import annotations

from collections.abc import Callable, Generator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import reduce
from typing import Any, Literal, NamedTuple

import numpy as np

from comove.arrays import Array
from comove.dmp.demonstrations import Demonstration
from comove.dmp.dmp import DMP
from comove.dmp.operations import scale
from comove.dmp.poses import PoseDMP
from comove.dmp.probabilistic import ProMP
from comove.errors import OptionError, SceneError
from comove.model.free_goals import FreeGoal
from comove.model.motion import CoordinatedMotion
from comove.model.scene import Scene
from comove.planning.arguments import (
    carried_demonstration,
    check_options,
    listed,
    movements_of,
    warn_of_adaptation,
)
from comove.planning.clock import Budget, now
from comove.planning.compiling import compiling
from comove.planning.convex.limits import Limits
from comove.planning.displays import displayed
from comove.planning.effort import NORMAL, EffortLevel, EffortName
from comove.planning.kernels import SceneKind, load_kernels
from comove.planning.kinematics import FREE, Kinematics
from comove.planning.method import Method
from comove.planning.methods import Comove, Quick
from comove.planning.objective import ContactPenalty, Objective
from comove.planning.objectives import Criterion, LeastJerk, LeastTime, PaperCost, Samples, objective_of_scene
from comove.planning.objectives.own import OwnFunctions, own
from comove.planning.pace import (
    NONE,
    DurationSettings,
    alone,
    least_possible,
    shortest,
    too_short,
    with_limits,
)
from comove.planning.pace import SETTINGS as DURATIONS
from comove.planning.resemblance import Followed, followed, precision_root
from comove.planning.search import Interruption, Journal, OutOfTime, Search, SearchClock
from comove.planning.solution import ProgressCallback, Solution
from comove.processes import one_blas_thread
from comove.verification.verify import Check, Verdict, verify

Demonstrated = DMP | PoseDMP | ProMP | Demonstration | Mapping | tuple[DMP, ...]
"""What is followed: a movement of one end effector, or one for each; of poses; a distribution of movements."""


def solve(
    scene: Scene,
    *,
    demonstration: Demonstrated | None = None,
    seed: int = 0,
    method: Method | None = None,
    planner: bool = True,
    budget: float | Budget = 30.0,
    objective: Criterion | Callable[[Samples], float] | None = None,
    constraints: Sequence[Callable[[Samples], object]] = (),
    obstacles: Literal["constraint", "cost"] = "constraint",
    checks: Sequence[Check] = (),
    kinematics: Kinematics = FREE,
    effort: EffortName | EffortLevel = "normal",
    progress: ProgressCallback | bool | None = None,
    stop: Callable[[], bool] | None = None,
) -> Solution:
    """Find a verified motion of end effectors for a scene. A robot that the scene names is ignored.

    Parameters
    ----------
    kinematics
        Kinematics of the end effectors, such as `comove.robots.RobotCarrier`; motions must also pass their own check.
        Free end effectors unless given.
    demonstration, seed, method, planner, budget, objective, constraints, obstacles, checks, effort, progress, stop
        As for `comove.solve`.

    Raises
    ------
    OptionError
        If an argument is out of range.
    """
    problem = problem_of(
        scene,
        demonstration=demonstration,
        seed=seed,
        method=method,
        planner=planner,
        budget=budget,
        objective=objective,
        constraints=constraints,
        obstacles=obstacles,
        checks=checks,
        kinematics=kinematics,
        effort=effort,
        stop=stop,
    )
    with displayed(progress, budget) as tell:
        load_kernels(SceneKind.of(problem.scene))
        return perform(solved(replace(problem, progress=tell or None)))


def problem_of(
    scene: Scene,
    *,
    demonstration: Demonstrated | None = None,
    seed: int = 0,
    method: Method | None = None,
    planner: bool = True,
    budget: float | Budget = 30.0,
    objective: Criterion | Callable[[Samples], float] | None = None,
    constraints: Sequence[Callable[[Samples], object]] = (),
    obstacles: str = "constraint",
    checks: Sequence[Check] = (),
    kinematics: Kinematics = FREE,
    effort: EffortName | EffortLevel = "normal",
    progress: ProgressCallback | None = None,
    stop: Callable[[], bool] | None = None,
) -> Problem:
    """Return the problem stated by arguments of `solve`, with all defaults.

    Raises
    ------
    OptionError
        If an argument is out of range.
    """
    aim = None if callable(objective) else objective
    check_options(scene, demonstration, seed, method, budget, aim, obstacles, checks)
    functions = own(objective, listed(constraints), scene)
    if functions is not None and functions.constraints:
        checks = (*checks, functions.reasons)
    method = method or Comove()
    scene = method.scene_of(scene)
    taught = movements_of(demonstration, scene)
    hard = obstacles == "constraint"
    smooth = check_method(scene, method, aim, functions, planner=planner, hard=hard)
    level = EffortLevel.of(effort)
    if not smooth and level != NORMAL:
        raise OptionError(
            f"effort = {effort!r}",
            key="effort",
            way_out="leave it out: it needs comove's own method, a planner, and obstacles that are constraints",
        )
    if aim is None:
        aim = _default_objective(scene, taught, smooth)
    if taught is not None and aim.begins_taught:
        warn_of_adaptation(taught, scene, stacklevel=3)
    return Problem(
        scene,
        taught,
        seed,
        method,
        planner,
        Budget.of(budget),
        aim,
        functions,
        hard,
        tuple(checks),
        kinematics,
        progress,
        stop,
        precision_root(demonstration, scene) if isinstance(demonstration, ProMP) else None,
        level,
    )


def check_method(
    scene: Scene,
    method: Method,
    objective: Criterion | None,
    functions: OwnFunctions | None = None,
    *,
    planner: bool = True,
    hard: bool = True,
) -> bool:
    """Reject what a method cannot solve; return whether its motions are smooth.

    Parameters
    ----------
    scene : scene that the method solves (`Method.scene_of`)
    functions : functions of the user
    hard : whether obstacles are constraints, not only costs
    """
    method.check(scene)
    smooth = _is_smooth(method, planner, hard)
    plain = objective is None or not objective.is_smooth
    if not smooth and not (plain and functions is None):
        raise OptionError(
            f"{_what_is_asked(objective, functions)} needs comove's own method, a planner, and obstacles that are "
            "constraints",
            key="objective",
            way_out="give PaperCost(), equation (4), for what is asked for besides",
        )
    return smooth


@dataclass(frozen=True, eq=False)
class Problem:
    """The arguments of `solve` after all defaults have been filled in.

    Attributes
    ----------
    taught : demonstrated movement of every manipulator; None without any
    own : objective and constraints of the user; None without any, if none of the scene's are sampled either
    hard : whether obstacles are constraints, not only costs
    given_checks : checks of the caller, besides those of the kinematics
    precision : precision of a demonstrated distribution, as in `Objective`; None for single movements
    effort : effort of improving a verified motion
    """

    scene: Scene
    taught: tuple[DMP, ...] | None
    seed: int
    method: Method
    planner: bool
    budget: Budget
    objective: Criterion
    own: OwnFunctions | None
    hard: bool
    given_checks: tuple[Check, ...]
    kinematics: Kinematics
    progress: ProgressCallback | None
    stop: Callable[[], bool] | None = None
    precision: Array | None = None
    effort: EffortLevel = NORMAL

    @property
    def checks(self) -> tuple[Check, ...]:
        """Return the checks of a motion besides those of the scene."""
        return (*self.given_checks, *self.kinematics.checks)

    @property
    def is_timed(self) -> bool:
        """Return whether the duration is given."""
        return self.scene.is_timed and not self.objective.is_time

    @property
    def is_hopeless(self) -> bool:
        """Return whether the given duration is too short for any motion.

        It is False for other methods and `Quick`, limited kinematics, functions of the user, and moving obstacles.
        """
        smooth = _is_smooth(self.method, self.planner, self.hard)
        patient = smooth and not isinstance(self.method, Quick)  # others take what is a little too fast
        limited = self.kinematics.has_limits or self.own is not None or self.scene.moving.any()
        return patient and not limited and self.is_timed and least_possible(self.scene) > self.scene.duration


def _is_smooth(method: Method, planner: bool, hard: bool) -> bool:
    return isinstance(method, Comove) and method.smooths and planner and hard


def _what_is_asked(objective: Criterion | None, functions: OwnFunctions | None) -> str:
    if functions is None:
        return type(objective).__name__
    return "a function of one's own" if functions.given else "a constraint that is sampled"


def _default_objective(scene: Scene, taught: tuple[DMP, ...] | None, smooth: bool) -> Criterion:
    """Return the objective if the caller gives none."""
    said = objective_of_scene(scene.file.objective)
    if said is not None and (smooth or not said.is_smooth):
        return said
    if not smooth:
        return PaperCost()
    return LeastJerk() if scene.is_timed or taught is not None else LeastTime()


class Searched(NamedTuple):
    """The outcome of a search.

    Attributes
    ----------
    solution : the best motion
    needed : duration in which a motion that is too fast would be verified, inf if none is known [s]
    """

    solution: Solution
    needed: float = np.inf


Procedure = Generator[Problem, Searched, Solution]
"""What yields the problems to be searched one after the other, and returns a solution."""


def perform(procedure: Procedure) -> Solution:
    """Perform the searches that a procedure yields; return its solution."""
    found: Any = None
    with one_blas_thread():
        while True:
            try:
                problem = procedure.send(found)
            except StopIteration as done:
                solution: Solution = done.value
                return solution
            search, can_arrive = _search_for(problem)
            if can_arrive:
                with (
                    suppress(OutOfTime),
                    search.clock.interruption.noticed(),
                    compiling(compiled=search.clock.compiled),
                ):
                    problem.method.run(search, planner=problem.planner)
            found = Searched(_solution(problem, search, search.timed_out), search.found.needed)


def solved(problem: Problem) -> Procedure:
    """Solve a problem. A budget spent without a verified motion is the first reason."""
    solution = yield from _solved(problem)
    if solution.verified or not solution.timed_out or solution.interrupted:
        return solution
    return replace(solution, reasons=(problem.budget.ran_out, *solution.reasons))


def _solved(problem: Problem) -> Procedure:
    """Solve a problem, by the procedure that suits its duration."""
    if problem.scene.file.choices is not None:
        return (yield from _by_some_choice(problem))
    if problem.is_hopeless:
        fastest, _ = yield _in_least_time(problem)
        return _at_pace(fastest, problem)
    if not problem.is_timed and problem.scene.moving.any():
        return (yield from _among_moving(problem))
    solution, needed = yield problem
    if solution.verified or solution.interrupted or solution.timed_out or needed == np.inf:
        return solution
    if problem.own is None:  # limits that are tight are met by the fastest motion, if by any
        left = problem.budget.after(solution.effort.seconds, solution.effort.work)
        slow, _ = yield _in_least_time(replace(problem, budget=left))
        if slow.verified:
            return _at_pace(slow, problem).after(solution)
        solution = replace(solution, interrupted=slow.interrupted, timed_out=slow.timed_out).after(slow)
    if solution.timed_out:
        return solution
    return replace(solution, reasons=(*solution.reasons, too_short(problem.scene, needed)))


def _by_some_choice(problem: Problem) -> Procedure:
    """Solve by the first grasp and placement that lead to a motion.

    Those with contacts at an end are left out. Each of the others has half of the remaining work, the last all of it.
    """
    free, scene = list[Scene](), problem.scene
    for option in scene.choices:
        for turn in [0.0] if option.free is None else FreeGoal(scene, option).turns():
            with suppress(SceneError):
                free.append(scene.put_down(option, turn).require_free_ends())
    free = free or [scene.in_one_way()]  # or an error that says what is touched
    best: Solution | None = None
    budget = problem.budget
    for choice in free:
        part = budget if choice is free[-1] else budget.within(0.5 * budget.size)
        found = yield from _solved(replace(problem, scene=choice, budget=part))
        budget = budget.after(found.effort.seconds, found.effort.work)
        best = found if best is None else found.after(best)
        if best.verified or best.interrupted or budget.is_spent:
            break
    assert best is not None, "there is a way"
    return best


def _in_least_time(problem: Problem) -> Problem:
    free = with_limits(problem.scene, NONE).timed(None)
    return replace(problem, scene=free, taught=None, objective=LeastTime())


def _at_pace(fastest: Solution, problem: Problem) -> Solution:
    """Return the fastest motion in the given duration. If that is too short, a sufficient one is noted."""
    scene = problem.scene
    motion = fastest.attempt.on(scene)
    verdict = verify(motion, problem.checks)
    reasons, needed = verdict.reasons, fastest.scene.duration
    if verdict.verified is None and fastest.verified and needed > scene.duration and not fastest.timed_out:
        reasons = (*reasons, too_short(scene, needed))
    return replace(
        fastest,
        scene=scene,
        motion=verdict.verified,
        attempt=motion,
        report=verdict.report,
        reasons=reasons,
        objective=problem.objective,
        effort=fastest.effort if verdict.verified else replace(fastest.effort, first_verified=None),
    )


def _search_for(problem: Problem) -> tuple[Search, bool]:
    """Return the search for a problem, and whether to begin it. An open duration is searched in any duration."""
    started = now()
    scene, taught, objective = problem.scene, problem.taught, problem.objective
    asked = scene
    if not problem.is_timed:
        asked, scene = _open(scene, problem.kinematics)
    if not problem.kinematics.has_limits:  # arms cannot be scaled
        scene, taught = of_common_size(scene, taught)
    objective = objective.scaled(_side(scene) / _side(asked))
    limits = Limits.of(scene, scene.duration)
    if not asked.is_timed:
        scene = scene.limited(speed=None, acceleration=None, jerk=None)
    weights = objective.weights
    penalty = ContactPenalty() if problem.hard else ContactPenalty(margin=0.0, step=float(weights.obstacle))
    carried = None if taught is None else carried_demonstration(taught, scene)
    search = Search(
        objective=Objective(
            scene, problem.method.coordinates(scene), weights, penalty, carried, problem.precision
        ),
        taught=taught,
        hard=problem.hard,
        rng=np.random.default_rng(problem.seed),
        asked=None if scene is asked else asked,
        checks=problem.checks,
        kinematics=problem.kinematics,
        level=problem.effort,
        clock=SearchClock(problem.budget, started, interruption=Interruption(problem.stop)),
        journal=Journal(problem.progress),
        aim=objective,
        limits=limits,
        own=problem.own,
    )
    at_goal, _ = scene.clearance_at(scene.nodes_at("goal"), scene.duration)
    return search, at_goal >= scene.clearance or not search.hard  # else an obstacle will be at the goal


def _solution(problem: Problem, search: Search, timed_out: bool) -> Solution:
    """Return the solution of a search that ended or timed out."""
    verdict: Verdict | None
    if search.found.best is not None and search.found.best_motion is not None:
        motion, verdict = search.found.best_motion, search.found.best
    else:
        motion = search.found.attempt or CoordinatedMotion.straight(
            search.scene, search.objective.coordinates
        )
        # Motions that the scene rejects have not been through the checks.
        verdict = None if problem.checks else search.found.attempt_verdict
    motion, evaluated, log, aim = search.handed(motion), search.objective, search.journal.log, search.aim
    asked = motion.scene
    if verdict is None or search.asked is not None:
        verdict = verify(motion, problem.checks)
    if search.asked is not None:
        ratio, taught = _side(asked) / _side(search.scene), evaluated.demonstration
        taught = None if taught is None else ratio * taught
        evaluated = replace(evaluated, scene=asked, coordinates=motion.coordinates, demonstration=taught)
        log = {key: _times(value, ratio) if key.endswith("_m") else value for key, value in log.items()}
        aim = aim.scaled(ratio)
    return Solution(
        scene=asked,
        motion=verdict.verified,
        attempt=motion,
        report=verdict.report,
        reasons=verdict.reasons,
        cost=evaluated.cost(motion),
        method=problem.method.name,
        seed=problem.seed,
        effort=search.effort,
        interrupted=search.clock.interruption.wished,
        timed_out=timed_out,
        log=log,
        objective=problem.own if problem.own is not None and problem.own.given else aim,
        followed=_followed(motion, search.aim, evaluated),
    )


def _among_moving(problem: Problem, settings: DurationSettings = DURATIONS) -> Procedure:
    """Solve among moving obstacles by trying durations, as none is given."""
    if problem.own is not None:
        raise OptionError(
            "functions of one's own, and constraints that are sampled, need a duration where obstacles move",
            file=problem.scene.path,
            key="duration",
            way_out="give one",
        )
    hasty, done = problem.objective.is_time, list[Solution]()
    started, whole = now(), problem.budget
    asked, method = with_limits(problem.scene), problem.method
    if hasty:
        problem = replace(problem, taught=None, objective=LeastJerk())

    def left() -> Budget:
        return whole.after(now() - started, sum(solution.effort.work for solution in done))

    def attempt(duration: float, method: Method, share: float = 1.0) -> Procedure:
        budget = left().within(share * whole.size)
        scene = asked.timed(duration)
        kinematics = problem.kinematics.on(scene)
        one = replace(problem, scene=scene, method=method, budget=budget, kinematics=kinematics)
        done.append((yield from _solved(one)))
        return done[-1]

    quick = Quick(settings=method.settings) if isinstance(method, Comove) and method.smooths else method
    tries = yield from shortest(
        lambda duration: attempt(duration, quick, settings.share),
        alone(asked, problem.taught),
        lambda: left().is_spent or (bool(done) and done[-1].interrupted),
        closely=hasty,
        settings=settings,
    )
    found = tries[-1]
    if found.verified and not done[-1].interrupted and not left().is_spent:
        better = yield from attempt(found.scene.duration, method)
        found = better if better.verified else found
    return replace(
        found,
        objective=LeastTime() if hasty else problem.objective,
        effort=reduce(lambda earlier, later: later.after(earlier), (solution.effort for solution in done)),
        interrupted=done[-1].interrupted,
        timed_out=left().seconds <= 0.0 or (left().is_spent and not found.verified),
    )


def _followed(motion: CoordinatedMotion, objective: Criterion, evaluated: Objective) -> Followed | None:
    if evaluated.demonstration is None or objective.pull(True) == 0:
        return None
    return followed(motion, evaluated.demonstration, evaluated.precision)


def _open(scene: Scene, kinematics: Kinematics) -> tuple[Scene, Scene]:
    asked = with_limits(scene).timed(None)
    return asked, asked.timed(kinematics.duration)


def of_common_size(
    scene: Scene, demonstration: tuple[DMP, ...] | None, sides: tuple[float, float] = (0.3, 5.0)
) -> tuple[Scene, tuple[DMP, ...] | None]:
    """Scale a scene of extreme size to a metre, with its demonstration.

    Margins, steps and tolerances of the search are made for scenes of some decimetres to a few metres.

    Parameters
    ----------
    sides : longest sides of workspaces that are left as they are, at least and at most [m]
    """
    side = _side(scene)
    begun = scene.begins > 0 or any(group.start_twist.any() for group in scene.groups)
    if sides[0] <= side <= sides[1] or begun:
        return scene, demonstration
    if demonstration is not None:
        demonstration = tuple(scale(own, 1.0 / side) for own in demonstration)
    return scene.scaled(1.0 / side), demonstration


def _times(value: float | list[float], ratio: float) -> float | list[float]:
    return [ratio * x for x in value] if isinstance(value, list) else ratio * value


def _side(scene: Scene) -> float:
    return float((scene.upper - scene.lower).max())
