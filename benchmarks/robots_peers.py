"""Robots with a bar among obstacles: comove, RoboPlan, OMPL and Drake.

    pip install 'comove[bench]'
    python benchmarks/robots_peers.py robots-easy --count 5        # the first of a frozen set, each robot in turn
    comove bench draw robots-hard --count 25 --seed 600 --out drawn
    python benchmarks/robots_peers.py drawn                        # or a folder of scenes
    python benchmarks/robots_peers.py drawn --systems comove OMPL

Every system gets the pairs of joints at start and goal that comove works with, the likeliest first, two seconds for
each pair, and ten for a scene. The payload is fixed to the first end effector, the second is constrained to it, both
stay level and in the workspace: `robots_peers_roboplan.py`, `robots_peers_ompl.py` and `robots_peers_drake.py` define
each problem.

Results are verified alike, by Pinocchio and coal at 1000 samples: no contact of exact bodies, limits of joints, the
payload in its workspace within 5 mm, and end effectors within 1 mm and 5 mrad of the payload, RoboPlan's own
tolerance. comove solves every scene twice, once on these terms, where bodies may nearly touch, and once with the
scene's clearance; both are verified besides, for every instant and in the scene's duration.

The second table (`--alone`) is what RoboPlan was made for: one arm moves from one end to the other, without a payload
or a constraint. Times and budgets are of the processor, in seconds, but for RoboPlan's two seconds; acceleration and
jerk are root mean squares over all joints for a motion of unit duration, so that pace does not count.
"""

from __future__ import annotations

import argparse
import time
import warnings
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from robots_peers_terms import BUDGET, N_SAMPLES, Outcome, Terms, flaws
from timing import peer, print_head, print_row

from comove import solve
from comove.lab.bench.sets import own_scenes, scenes_of
from comove.model import Scene
from comove.planning import SceneKind
from comove.planning.solution import Progress
from comove.robots import Robot, RobotCarrier
from comove.robots.free_space import Room, way
from comove.robots.kernels import load_robot_kernels
from comove.robots.verification.bodies import LOAD

Array = NDArray[np.float64]
System = Callable[[Terms, int], Outcome]


def by_comove(terms: Terms, seed: int) -> Outcome:
    """Solve a scene with comove, almost without clearance."""
    return carried(terms.scene.limited(clearance=0.0), terms.robot, seed)


def with_clearance(terms: Terms, seed: int) -> Outcome:
    """Solve a scene with comove, with its clearance."""
    return carried(terms.scene, terms.robot, seed)


def carried(scene: Scene, robot: Robot, seed: int) -> Outcome:
    """Solve a scene with comove."""
    begun, first = time.process_time(), [np.nan]

    def told(progress: Progress) -> None:
        if np.isnan(first[0]) and progress.best is not None:
            first[0] = time.process_time() - begun

    found = solve(scene, robot=robot, seed=seed, budget=BUDGET, progress=told)
    whole = time.process_time() - begun
    if not found.verified:
        return Outcome(None, np.nan, whole)
    joints = found.joints.attempt
    times = np.linspace(0.0, joints.time[-1], N_SAMPLES)
    return Outcome(joints.curve(times), first[0], whole, True)


SYSTEMS: dict[str, System] = {
    "comove": by_comove,
    "comove, clearance kept": with_clearance,
    "RoboPlan": lambda terms, seed: peer("robots_peers_roboplan").by_roboplan(terms, seed),
    "OMPL": lambda terms, seed: peer("robots_peers_ompl").by_ompl(terms, seed),
    "Drake": lambda terms, seed: peer("robots_peers_drake").by_drake(terms, seed),
}


def sizes(joints: Array) -> tuple[float, float]:
    """Return RMS acceleration and jerk of all joints in unit duration."""
    step = 1.0 / (len(joints) - 1)
    second, third = (np.diff(joints, order, axis=0) / step**order for order in (2, 3))
    return float(np.sqrt((second**2).mean())), float(np.sqrt((third**2).mean()))


def alone(terms: Terms, seed: int) -> list[tuple[float, bool]]:
    """Move the first arm without a payload by comove and RoboPlan. Return time and success of both."""
    (start, goal), arm, known = terms.ends[0], terms.arms[0], terms.bodies
    goal = np.where(np.isin(np.arange(len(start)), arm.columns), goal, start)
    keep = known.kind != LOAD
    number = np.cumsum(keep) - 1
    free = replace(
        known, ends=known.ends[keep], kind=known.kind[keep], taken=known.taken[keep], reach=known.reach[keep],
        exact=number[known.exact[keep]], rods=(), required=np.zeros(3),
    )  # fmt: skip
    begun = time.process_time()
    room = Room.for_ends(free, terms.scene, np.stack([start, goal]), None)
    path = way(room, start, goal, np.random.default_rng(seed))
    rows = [(time.process_time() - begun, path is not None)]
    planner = peer("robots_peers_roboplan").RoboPlan(terms, loaded=False)
    begun = time.process_time()
    planner.scene.setJointPositions(start)
    found = planner.plan(arm.name, start[arm.columns], goal[arm.columns], seed, [])
    return [*rows, (time.process_time() - begun, found is not None)]


def median(values: list[float]) -> str:
    """Return the median of finite values as text."""
    known = [value for value in values if np.isfinite(value)]
    return f"{np.median(known):.3g}" if known else "-"


def main() -> None:
    """Run the command."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("scenes", nargs="+", help="a frozen set, or a folder of scenes")
    parser.add_argument("--count", type=int, help="of each set, so many; all unless given")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--systems", nargs="+", choices=SYSTEMS, default=[*SYSTEMS])
    parser.add_argument(
        "--alone", action="store_true", help="the second table as well: one arm without a load"
    )
    options = parser.parse_args()
    warnings.simplefilter("ignore")
    rows: dict[tuple[str, str], list[tuple[Outcome, str]]] = {}
    singles: dict[str, list[list[tuple[float, bool]]]] = {}
    for source in options.scenes:
        own = Path(source).is_dir()
        for item in own_scenes([Path(source)]) if own else scenes_of(source, options.count):
            scene = Scene.load(item.path)
            robot = Robot.load(scene.file.robot)
            load_robot_kernels(SceneKind.of(scene))
            carrier = RobotCarrier(robot, scene)
            _ = carrier.arms  # capsules belong to the robot, as RoboPlan's model does, and not to a search
            for system in options.systems:
                terms = Terms(scene, robot, carrier)
                found = SYSTEMS[system](terms, options.seed)
                wrong = "none found" if found.joints is None else flaws(terms, found.joints)
                rows.setdefault((scene.file.robot, system), []).append((found, wrong))
            if options.alone:
                singles.setdefault(scene.file.robot, []).append(
                    alone(Terms(scene, robot, carrier), options.seed)
                )
    print_head(
        ["robot", "system", "carried", "first [s]", "all [s]", "acceleration", "jerk", "what was wrong"]
    )
    robots = sorted({name for name, _ in rows})
    for name, system in [(name, system) for name in [*robots, "all"] for system in options.systems]:
        results = [row for robot in robots for row in rows[robot, system] if name in (robot, "all")]
        good = [found for found, wrong in results if not wrong]
        smooth = [sizes(found.joints) for found in good if found.joints is not None]
        reasons = [wrong.split(" by ")[0] for _, wrong in results if wrong]
        told = "; ".join(f"{reasons.count(reason)} {reason}" for reason in sorted(set(reasons)))
        times = median([f.first for f in good]), median([f.whole for f in good])
        even = (median([s[k] for s in smooth]) for k in (0, 1))
        print_row([name, system, f"{len(good)}/{len(results)}", *times, *even, told])
    if singles:
        print()
        print_head(["robot, one arm alone", "comove found", "[s]", "RoboPlan found", "[s]"])
    for name, runs in singles.items():
        counts = [f"{sum(run[k][1] for run in runs)}/{len(runs)}" for k in (0, 1)]
        times = [median([run[k][0] for run in runs]) for k in (0, 1)]
        print_row([name, counts[0], times[0], counts[1], times[1]])


if __name__ == "__main__":
    main()
