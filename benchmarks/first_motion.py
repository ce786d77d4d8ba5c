"""Time to the first motion on random planar scenes: comove beside OMPL's RRTConnect.

Measured on `comove.experiments.random_scenes.planar_scene(seed)`, seeds 0 to N - 1:

- comove, with and without its planner: `Solution.time_to_first_verified_s`, that is until the first motion
  that is timed, within the speed limits and certified free of contact in continuous time;
- OMPL RRTConnect in SE(2) with its defaults, alone and with `simplifySolution`: until a path, with no timing.
  Its validity callback asks comove's exact kernel `configuration_distance`, compiled into one call, at poses
  between which no point of the load travels more than 5 mm. What hides between them shows in the last
  column: it looks at every solver's result every 0.1 mm.

Scenes and kernels are in memory when the clock starts, and each solver has solved another scene before.
Everything runs on one thread. What is not solved within the limit counts as longer than the limit.

To repeat: ``pip install 'comove[bench]'``, ``python benchmarks/first_motion.py [--scenes 40] [--limit 5]``.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from math import cos, inf, pi, sin
from statistics import median

import numba
import numpy as np
from timing import number, on_one_thread, peer, print_table, quantile

import comove
from comove.coordination import Coordinates, load_coordinates
from comove.experiments.random_scenes import planar_scene
from comove.scenes.distances import configuration_distance

Array = np.ndarray

CHECKED_EVERY = 0.005  # m, by OMPL along a motion
JUDGED_EVERY = 0.0001  # m, by the last column
WARM_UP_SEED = 10**6
SEED = 1  # of every solver
MOTION, PATH = "certified timed motion", "path only, checked every 5 mm"


@dataclass(frozen=True)
class Outcome:
    """Of one solver on one scene.

    Attributes
    ----------
    seconds : until the first motion or path [s], infinite where there is none
    free : whether it touches nothing when looked at every `JUDGED_EVERY`
    """

    seconds: float
    free: bool = False


@numba.njit(cache=True)
def clearance_at(x, y, angle, points, nodes, edges, radii, table, lower, upper):
    """Clearance [m] of the load at a planar pose; `points` in its frame and scratch `nodes`, shape (n, 3)."""
    c, s = cos(angle), sin(angle)
    for i in range(points.shape[0]):
        nodes[i, 0] = x + c * points[i, 0] - s * points[i, 1]
        nodes[i, 1] = y + s * points[i, 0] + c * points[i, 1]
    return configuration_distance(nodes, edges, radii, table, lower, upper)[0]


class PlanarLoad:
    """A scene whose manipulators hold one load in the plane, as poses (x, y, angle) of that load.

    Parameters
    ----------
    scene
        Its load must be held by all manipulators.
    """

    def __init__(self, scene: comove.Scene):
        coordinates: Coordinates = load_coordinates(scene)
        blocks, body = coordinates.blocks, scene.body
        points = np.zeros((body.n_nodes, 3))
        points[blocks.node] = blocks.point
        self.start, _, self.goal, _ = coordinates.boundary()
        self.lower, self.upper = scene.lower, scene.upper
        self.reach = float(np.linalg.norm(points, axis=1).max())
        self._body = points, np.zeros_like(points), body.edges, body.radii, scene.obstacles, *scene.workspace

    def clearance(self, x: float, y: float, angle: float) -> float:
        """Clearance [m] of a pose."""
        return clearance_at(x, y, angle, *self._body)

    def is_free_along(self, path: Array) -> bool:
        """Is every pose free between those of `path`, array of shape (n, 3), when looked at very closely?"""
        for pose, following in pairwise(path):
            step = following - pose
            step[2] -= 2 * pi * np.round(step[2] / (2 * pi))
            travel = np.linalg.norm(step[:2]) + self.reach * abs(step[2])
            for share in np.linspace(0.0, 1.0, 2 + int(travel / JUDGED_EVERY)):
                if self.clearance(*(pose + share * step)) < 0:
                    return False
        return True


def by_comove(*, planner: bool, limit: float) -> Callable[[comove.Scene], tuple[Outcome]]:
    """A solver: comove's default method."""

    def solve(scene: comove.Scene) -> tuple[Outcome]:
        solution = comove.solve(scene, seed=SEED, planner=planner, budget=limit)
        if not solution.verified or solution.time_to_first_verified_s > limit:
            return (Outcome(inf),)
        motion = solution.motion.motion
        path = motion.at(np.linspace(0.0, 1.0, 5001))[0]
        return (Outcome(solution.time_to_first_verified_s, PlanarLoad(scene).is_free_along(path)),)

    return solve


def by_ompl(*, limit: float) -> Callable[[comove.Scene], tuple[Outcome, Outcome]]:
    """A solver: RRTConnect in SE(2), before and after simplification."""
    base, geometric, util = (peer(f"ompl.{name}") for name in ("base", "geometric", "util"))
    util.setLogLevel(util.LOG_NONE)
    util.RNG.setSeed(SEED)

    def poses(path) -> Array:
        return np.array([(state.getX(), state.getY(), state.getYaw()) for state in path.getStates()])

    def solve(scene: comove.Scene) -> tuple[Outcome, Outcome]:
        load = PlanarLoad(scene)
        started = time.perf_counter()
        setup = _simple_setup(base, geometric, load)
        setup.solve(limit)
        planned = time.perf_counter() - started
        if not setup.haveExactSolutionPath():
            return Outcome(inf), Outcome(inf)
        path = poses(setup.getSolutionPath())
        started = time.perf_counter()
        setup.simplifySolution()
        simplified = planned + time.perf_counter() - started
        shorter = poses(setup.getSolutionPath())
        return Outcome(planned, load.is_free_along(path)), Outcome(simplified, load.is_free_along(shorter))

    return solve


def _simple_setup(base, geometric, load: PlanarLoad):
    space = base.SE2StateSpace()
    bounds = base.RealVectorBounds(2)
    for axis in range(2):
        bounds.setLow(axis, float(load.lower[axis]))
        bounds.setHigh(axis, float(load.upper[axis]))
    space.setBounds(bounds)
    setup = geometric.SimpleSetup(space)
    clearance = load.clearance
    setup.setStateValidityChecker(lambda state: clearance(state.getX(), state.getY(), state.getYaw()) >= 0.0)
    for subspace, extent in ((0, np.linalg.norm(load.upper - load.lower)), (1, load.reach * pi)):
        space.getSubspace(subspace).setLongestValidSegmentFraction(CHECKED_EVERY / 2 / float(extent))
    ends = []
    for x, y, angle in (load.start, load.goal):
        state = space.allocState()
        state.setX(x)
        state.setY(y)
        state.setYaw(angle)
        space.enforceBounds(state)
        ends.append(state)
    setup.setStartAndGoalStates(*ends)
    setup.setPlanner(geometric.RRTConnect(setup.getSpaceInformation()))
    return setup


def row(name: str, result: str, outcomes: Sequence[Outcome], reference: float, limit: float) -> list[str]:
    """One row of the table; times in milliseconds."""
    times = [outcome.seconds for outcome in outcomes]
    solved = sum(seconds < inf for seconds in times)
    shown = [median(times), quantile(times, 0.9), max(times)]
    return [
        name,
        result,
        f"{solved}/{len(times)}",
        *(number(1e3 * value) if value < inf else f"> {1e3 * limit:.0f}" for value in shown),
        number(median(times) / reference) if median(times) < inf else "-",
        f"{sum(outcome.free for outcome in outcomes)}/{solved}",
    ]


def main() -> None:
    """Measure and print the table."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--scenes", type=int, default=40)
    parser.add_argument("--first-seed", type=int, default=0)
    parser.add_argument("--limit", type=float, default=5.0, help="seconds a scene")
    options = parser.parse_args()

    solvers = [
        by_comove(planner=True, limit=options.limit),
        by_comove(planner=False, limit=options.limit),
        by_ompl(limit=options.limit),
    ]
    warm_up = planar_scene(WARM_UP_SEED)
    for solve in solvers:
        solve(warm_up)
    scenes = [planar_scene(options.first_seed + i) for i in range(options.scenes)]
    outcomes = [sum((solve(scene) for solve in solvers), ()) for scene in scenes]
    columns = list(zip(*outcomes, strict=True))
    reference = median(outcome.seconds for outcome in columns[0])
    print_table(
        ["solver", "gives", "solved", "median", "p90", "max [ms]", "times comove", "free every 0.1 mm"],
        [
            row("comove", MOTION, columns[0], reference, options.limit),
            row("comove, no planner", MOTION, columns[1], reference, options.limit),
            row("OMPL RRTConnect", PATH, columns[2], reference, options.limit),
            row("OMPL RRTConnect, simplified", PATH, columns[3], reference, options.limit),
        ],
    )


if __name__ == "__main__":
    on_one_thread()
    main()
