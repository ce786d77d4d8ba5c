"""`solve`: from a scene to a verified motion, or the best attempt labelled so."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from comove.coordination.motion import CoordinatedMotion, carried_to_hands
from comove.coordination.poses import hands_of_poses
from comove.demonstrations import Demonstration
from comove.errors import OptionError, near_name
from comove.planning.compiling import compiling
from comove.planning.convex.limits import Limits
from comove.planning.followed import Followed, followed
from comove.planning.kernels import load_kernels
from comove.planning.method import Method
from comove.planning.methods import Comove, Quick
from comove.planning.objective import N_STEPS, Objective, Penalty
from comove.planning.objectives import LeastJerk, LeastTime, PaperCost, Samples, objective_of_scene
from comove.planning.objectives.own import Own, own
from comove.planning.pace import NONE, least_possible, too_short, with_limits
from comove.planning.search import Carrier, OutOfTime, Search
from comove.planning.shortest import alone, shortest
from comove.planning.solution import ProgressCallback, Solution
from comove.primitives.dmp import DMP
from comove.primitives.operations import scale
from comove.primitives.poses import PoseDMP
from comove.scenes.scene import Scene
from comove.verification.verify import Check, verify

Array = NDArray[np.float64]

OBSTACLES = ("constraint", "cost")
TRY, SHORT = 0.2, 0.1  # share of the budget that a try of a duration may take, and the least that it has [s]
COMMON = (0.3, 5.0)  # m, sides of workspaces that are searched as they are


def solve(
    scene: Scene,
    *,
    demonstration: DMP | PoseDMP | Demonstration | Mapping[str, DMP | Demonstration] | None = None,
    seed: int = 0,
    method: Method | None = None,
    planner: bool = True,
    budget: float = 30.0,
    objective: LeastJerk | LeastTime | PaperCost | Callable[[Samples], float] | None = None,
    constraints: Sequence[Callable[[Samples], object]] = (),
    obstacles: Literal["constraint", "cost"] = "constraint",
    checks: Sequence[Check] = (),
    carrier: Carrier | None = None,
    progress: ProgressCallback | None = None,
) -> Solution:
    """Find a verified coordinated motion for a scene.

    Parameters
    ----------
    scene
        What to solve.
    demonstration
        A movement of a single manipulator, of the scene's dimension, or one for each by its name: a start for the
        search, and what the result shall resemble where `LeastJerk` or `objective.resemblance` asks for it. Poses
        are those of the load, where all hands hold one that turns.
    seed
        Of all random numbers: the same inputs, seed and version give the same motion unless time runs
        short, which makes the planner modest before it ends the search.
    method
        `Comove()` unless given. Some solve a part of the scene: the solution's own scene says which.
    planner
        Start from a path planned in the load's own configuration space.
    budget
        Seconds after which the best so far is returned.
    objective
        What the motion shall be best in; what the scene says unless given. Where that says nothing, `LeastJerk()`,
        smooth and near to the demonstration; `LeastTime()` for a scene without duration and demonstration;
        `PaperCost()`, equation (4), where the method is not comove's own, the planner off or obstacles a cost. The
        motion of a scene that leaves its duration out is as fast as its limits allow; the solution's own scene says
        how long it takes.
        Or a function of `Samples` that is to be least: constrained CMA-ES minimises it, from a smooth motion.
    constraints
        Functions of `Samples` that must be at most 0, or `Equality`; judged at samples, beside what the scene asks.
    obstacles
        Hard constraints, or only the term c_obst of the objective (paper, III-B): then the motion of the least
        cost is handed out, verified or not.
    checks
        Further checks that a motion must pass to be verified.
    carrier
        What moves the hands, such as `comove.robots.Carrying`, and so limits what they can do; give its check
        along with it.
    progress
        Called once a generation, and for every motion that is the best so far.

    Raises
    ------
    OptionError
        If an argument is out of range.
    """
    functions = own(objective, _listed(constraints))
    if functions is not None:
        checks = (*checks, functions.reasons) if functions.constraints else checks
        objective = None if functions.function is not None else objective
    _check_options(scene, demonstration, seed, method, budget, objective, obstacles, checks)
    method = method or Comove()
    scene = method.scene_of(scene)
    demonstration = movements_of(demonstration, scene)
    load_kernels(scene.n_dims, bool(scene.moving.any()))
    started = time.perf_counter()
    smooth = isinstance(method, Comove) and method.smooths and planner and obstacles == "constraint"
    said = objective_of_scene(scene.file.objective)
    if objective is None and (smooth or isinstance(said, PaperCost)):
        objective = said
    if objective is None:
        hasty = not scene.is_timed and demonstration is None
        objective = (LeastTime() if hasty else LeastJerk()) if smooth else PaperCost()
    if (not isinstance(objective, PaperCost) or functions is not None) and not smooth:
        what = type(objective).__name__ if functions is None else "a function of one's own"
        raise OptionError(
            f"{what} needs comove's own method, a planner, and obstacles that are constraints",
            key="objective",
            way_out="give PaperCost(), equation (4), for what is asked for besides",
        )
    asked = scene
    patient = smooth and not isinstance(method, Quick)  # others take what is a little too fast
    plain = patient and carrier is None and functions is None and not scene.moving.any()
    timed = scene.is_timed and not isinstance(objective, LeastTime)
    if plain and timed and least_possible(scene) > scene.duration:
        slow = solve(
            with_limits(scene, NONE).timed(None),
            seed=seed,
            method=method,
            budget=budget,
            objective=LeastTime(),
            checks=checks,
            progress=progress,
        )
        return replace(_too_fast(slow, scene, checks), objective=objective)
    if not scene.is_timed or isinstance(objective, LeastTime):
        if scene.moving.any():
            return _among_moving(
                scene,
                functions,
                method,
                budget,
                demonstration=demonstration,
                objective=objective,
                seed=seed,
                planner=planner,
                obstacles=obstacles,
                checks=checks,
                progress=progress,
            )
        asked, scene = _open(scene, carrier)
    weights = objective if isinstance(objective, PaperCost) else PaperCost()
    if carrier is None:  # arms are as long as they are
        scene, demonstration = of_common_size(scene, demonstration)
    limits = Limits.of(scene, scene.duration)
    if not asked.is_timed:
        scene = scene.limited(speed=None, acceleration=None, jerk=None)
    taught = None if demonstration is None else carried_demonstration(demonstration, scene)
    penalty = Penalty() if obstacles == "constraint" else Penalty(margin=0.0, step=weights.obstacle)
    search = Search(
        objective=Objective(scene, method.coordinates(scene), weights, penalty, taught),
        taught=demonstration,
        hard=obstacles == "constraint",
        rng=np.random.default_rng(seed),
        started=started,
        deadline=started + budget,
        asked=None if scene is asked else asked,
        checks=checks,
        carrier=carrier,
        progress=progress,
        aim=objective,
        limits=limits,
        own=functions,
    )
    at_goal, _ = scene.clearance_at(scene.nodes_at("goal"), scene.duration)
    if (
        at_goal >= scene.clearance or not search.hard
    ):  # else something that moves stands at the goal when the load comes
        with suppress(OutOfTime), search.interruption.noticed(), compiling(compiled=search.compiled):
            method.run(search, planner=planner)
    if search.best is not None:
        motion, verdict = search.best_motion, search.best
    else:
        motion = search.attempt or CoordinatedMotion.straight(scene, search.objective.coordinates)
        verdict = (
            None if checks else search.attempt_verdict
        )  # checks are not asked about what the scene rejects
    motion, evaluated, log = search.handed(motion), search.objective, search.log
    asked = motion.scene
    if verdict is None or search.asked is not None:
        verdict = verify(motion, checks)
    if search.asked is not None:
        ratio, taught = _side(asked) / _side(scene), evaluated.demonstration
        taught = None if taught is None else ratio * taught
        evaluated = replace(evaluated, scene=asked, coordinates=motion.coordinates, demonstration=taught)
        log = {key: _times(value, ratio) if key.endswith("_m") else value for key, value in log.items()}
    return Solution(
        scene=asked,
        motion=verdict.verified,
        attempt=motion,
        report=verdict.report,
        reasons=verdict.reasons
        if search.needed == np.inf or verdict.verified is not None
        else (*verdict.reasons, too_short(asked, search.needed)),
        cost=evaluated.cost(motion),
        method=method.name,
        seed=seed,
        evaluations=search.evaluations,
        generations=search.generations,
        time_to_first_verified_s=search.first_verified,
        solve_time_s=search.elapsed(),
        interrupted=search.interruption.wished,
        log=log,
        objective=search.aim if functions is None else functions,
        followed=_followed(motion, search.aim, evaluated.demonstration),
    )


def _too_fast(slow: Solution, scene: Scene, checks: Sequence[Check]) -> Solution:
    """Answer a duration that is out of the question by a motion that was found for a longer one."""
    motion = slow.attempt.on(scene)
    verdict = verify(motion, checks)
    reasons = (*verdict.reasons, too_short(scene, slow.scene.duration)) if slow.verified else verdict.reasons
    return replace(
        slow,
        scene=scene,
        motion=None,
        attempt=motion,
        report=verdict.report,
        reasons=reasons,
        time_to_first_verified_s=None,
    )


def _among_moving(
    scene: Scene,
    functions: Own | None,
    method: Method,
    budget: float,
    *,
    demonstration: tuple[DMP, ...] | None,
    objective: LeastJerk | LeastTime | PaperCost,
    **others: Any,
) -> Solution:
    """Do as `solve` for a scene of open duration whose obstacles move: duration by duration."""
    if functions is not None:
        raise OptionError(
            "functions of one's own need a duration where obstacles move",
            file=scene.path,
            key="duration",
            way_out="give one",
        )
    asked, hasty, done = with_limits(scene), isinstance(objective, LeastTime), []
    if hasty:
        demonstration = None
    started = time.perf_counter()

    def left() -> float:
        return budget - (time.perf_counter() - started)

    def attempt(duration: float, method: Method, most: float) -> Solution:
        done.append(
            solve(
                asked.timed(duration),
                method=method,
                budget=max(min(most, left()), SHORT),
                demonstration=demonstration,
                objective=LeastJerk() if hasty else objective,
                **others,
            )
        )
        return done[-1]

    quick = Quick() if isinstance(method, Comove) and method.smooths else method
    found = shortest(
        lambda duration: attempt(duration, quick, TRY * budget),
        alone(asked, demonstration),
        lambda: left() < 0 or (bool(done) and done[-1].interrupted),
        closely=hasty,
    )[-1]
    if found.verified and not done[-1].interrupted and left() > 0:
        better = attempt(found.scene.duration, method, left())
        found = better if better.verified else found
    first = next((i for i, solution in enumerate(done) if solution.verified), None)
    return replace(
        found,
        objective=objective,
        evaluations=sum(solution.evaluations for solution in done),
        generations=sum(solution.generations for solution in done),
        time_to_first_verified_s=None
        if first is None
        else sum(solution.solve_time_s for solution in done[:first]) + done[first].time_to_first_verified_s,
        solve_time_s=sum(solution.solve_time_s for solution in done),
        interrupted=done[-1].interrupted,
    )


def _followed(
    motion: CoordinatedMotion, objective: LeastJerk | LeastTime | PaperCost, demonstration: Array | None
) -> Followed | None:
    """How near the hands are to the demonstration, None where it is not followed."""
    if isinstance(objective, LeastTime):
        return None
    strength = objective.pull(True) if isinstance(objective, LeastJerk) else objective.resemblance
    if demonstration is None or strength == 0:
        return None
    return followed(motion, demonstration)


def _listed(constraints: object) -> tuple:
    if not isinstance(constraints, (list, tuple)):
        raise OptionError(
            f"constraints = {constraints!r}", key="constraints", way_out="give a list of functions of Samples"
        )
    return tuple(constraints)


def _open(scene: Scene, carrier: Carrier | None) -> tuple[Scene, Scene]:
    """A scene whose duration is to be found, with limits, and the same for the search."""
    asked = with_limits(scene).timed(None)
    return asked, asked.timed(1.0 if carrier is None else carrier.scene.duration)


def of_common_size(
    scene: Scene, demonstration: tuple[DMP, ...] | None
) -> tuple[Scene, tuple[DMP, ...] | None]:
    """The scene a metre wide, if it is much smaller or larger, and a demonstration that is made so along with it.

    Margins, steps and tolerances of the search are made for scenes of some decimetres to a few metres.
    """
    side = _side(scene)
    begun = scene.begins > 0 or any(group.start_twist.any() for group in scene.groups)
    if COMMON[0] <= side <= COMMON[1] or begun:
        return scene, demonstration
    if demonstration is not None:
        demonstration = tuple(scale(own, 1.0 / side) for own in demonstration)
    return scene.scaled(1.0 / side), demonstration


def _times(value: float | list[float], ratio: float) -> float | list[float]:
    return [ratio * x for x in value] if isinstance(value, list) else ratio * value


def _side(scene: Scene) -> float:
    """Longest side of the workspace [m]."""
    return float((scene.upper - scene.lower).max())


def _check_options(
    scene: object,
    demonstration: object,
    seed: object,
    method: object,
    budget: object,
    objective: object,
    obstacles: str,
    checks: object,
) -> None:
    if not isinstance(scene, Scene):
        raise OptionError(
            f"scene = {scene!r}", way_out="give a Scene: Scene.load(path) or Scene.from_dict(data)"
        )
    if not isinstance(checks, (list, tuple)) or not all(map(callable, checks)):
        raise OptionError(f"checks = {checks!r}", way_out="give a list of functions of the motion")
    if isinstance(seed, bool) or not isinstance(seed, (int, np.integer)) or seed < 0:
        raise OptionError(f"seed = {seed!r}", way_out="give a whole number, 0 or more")
    if method is not None and not isinstance(method, Method):
        raise OptionError(f"method = {method!r}", way_out="give a method object, such as Projection()")
    if isinstance(budget, bool) or not isinstance(budget, (int, float)) or not 0 < budget < np.inf:
        raise OptionError(f"budget = {budget!r}", way_out="give a positive number of seconds")
    if objective is not None and not isinstance(objective, (LeastJerk, LeastTime, PaperCost)):
        raise OptionError(
            f"objective = {objective!r}", way_out="give LeastJerk(), LeastTime(), PaperCost() or a function"
        )
    if isinstance(objective, LeastJerk) and objective.resemblance and demonstration is None:
        raise OptionError(
            f"a resemblance of {objective.resemblance:g} without a demonstration",
            key="objective",
            way_out="give a demonstration, or LeastJerk() without a resemblance",
        )
    if obstacles not in OBSTACLES:
        raise OptionError(f"obstacles = {obstacles!r}", way_out=near_name(obstacles, OBSTACLES))


def carried_demonstration(dmp: DMP | Sequence[DMP], scene: Scene) -> Array:
    """The demonstration carried to every manipulator's ends; array, shape (N_STEPS, n_manipulators, 3), [m]."""
    for one in [dmp] if isinstance(dmp, DMP) else dmp:
        if one.n_dims != scene.n_dims:
            raise OptionError(
                f"the demonstration has {one.n_dims} dimensions, the scene {scene.n_dims}",
                key="demonstration",
                way_out="give one of the scene's dimension",
            )
    hands = np.zeros((N_STEPS, len(scene.manipulators), 3))
    hands[..., : scene.n_dims] = carried_to_hands(dmp, scene, np.linspace(0.0, 1.0, N_STEPS))
    return hands


def movements_of(demonstration: object, scene: Scene) -> tuple[DMP, ...] | None:
    """Return the movement of every manipulator, in their order; None without a demonstration.

    Raises
    ------
    OptionError
        A manipulator has none, there is one for nobody, or it is no movement.
    """
    if demonstration is None:
        return None
    names, each = scene.manipulators, demonstration
    if isinstance(demonstration, Mapping):
        others = [name for name in demonstration if name not in names]
        missing = [name for name in names if name not in demonstration]
        if others or missing:
            raise OptionError(
                f"a movement is for {others[0]!r}" if others else f"there is no movement for {missing[0]!r}",
                key="demonstration",
                way_out=f"give one for each of {', '.join(names)}",
            )
        each = [demonstration[name] for name in names]
    elif not isinstance(demonstration, (list, tuple)):
        if isinstance(demonstration, Demonstration):
            demonstration = scene.learned(demonstration)
        if isinstance(demonstration, PoseDMP):
            return hands_of_poses(demonstration, scene)
        each = [_movement(demonstration)] * len(names)
    if len(each) != len(names):
        raise OptionError(
            f"there are {len(each)} movements for {len(names)} manipulators",
            key="demonstration",
            way_out=f"give one for each of {', '.join(names)}",
        )
    return tuple(map(_movement, each))


def _movement(demonstration: object) -> DMP:
    if isinstance(demonstration, Demonstration):
        return DMP.fit(demonstration)
    if not isinstance(demonstration, DMP):
        raise OptionError(
            f"the demonstration is {type(demonstration).__name__}",
            key="demonstration",
            way_out="give a primitive, DMP.fit(demonstration), or a Demonstration, or one for each manipulator",
        )
    return demonstration
