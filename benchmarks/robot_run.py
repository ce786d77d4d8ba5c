"""Robots in MuJoCo among flying balls or a walking person.

    python benchmarks/robot_run.py                          # 20 scenes with balls for each robot
    python benchmarks/robot_run.py --people                 # 20 with a person
    python benchmarks/robot_run.py --scenes 5 --seed 1200 --robots gap_30

Balls of 16 cm fly straight, at 0.2 to 0.5 m/s, through a random point near the middle of the workspace during the
transfer motion. A person, trunk, head and one arm, walks at that speed along the side of the workspace that is
opposite to the robot, and reaches up to 35 cm over it. Much of this cannot be evaded, as it crosses a shoulder: a
scene counts as *witnessed* where a planner that knows the future finds a path; the others have no known one.
"""

from __future__ import annotations

import argparse
import warnings
from dataclasses import replace
from pathlib import Path

import numba
import numpy as np
import yaml
from numpy.typing import NDArray
from timing import print_head, print_row

from comove.control.safety.qp_workspace import Sighting
from comove.geometry.distances import CENTER, segment_distance
from comove.model import Scene
from comove.planning import SceneKind
from comove.robots import Robot
from comove.robots.kernels import load_robot_kernels
from comove.robots.online.course_finder import CourseFinder
from comove.robots.online.courses import Places
from comove.robots.online.executor import JointExecutor
from comove.robots.online.pilot import Pilot
from comove.robots.online.reference import MotionReference
from comove.robots.online.roadmap import Way
from comove.sim.live import run_live
from comove.sim.live_record import judge_run

Array = NDArray[np.float64]
EXAMPLES = Path(__file__).parents[1] / "examples"
ROBOTS = ("gap_30", "two_ur10", "two_xarm7")
RADIUS = 0.08  # m
LONGEST = 40.0  # s
KEPT = 0.005  # m, that a witness keeps from what moves, by capsules of links


def drawn(name: str, seed: int, people: bool) -> Scene:
    """Sample an example with flying balls, or a walking person. There are one to three balls."""
    data = yaml.safe_load(next(EXAMPLES.rglob(f"{name}.yaml")).read_text(encoding="utf-8"))
    rng = np.random.default_rng(seed)
    workspace = np.array([data["workspace"][key] for key in ("lower", "upper")])
    movers = [person(workspace, rng)] if people else [ball(workspace, rng) for _ in range(rng.integers(1, 4))]
    data["obstacles"] = [*data.get("obstacles", []), *(part for parts in movers for part in parts)]
    return Scene.from_dict({**data, "name": f"{name} {seed}", "demonstration": None})


def ball(workspace: Array, rng: np.random.Generator) -> list[dict]:
    """Sample a ball that flies through the workspace's middle half."""
    lower, upper = workspace
    middle = 0.5 * (lower + upper) + rng.uniform(-0.25, 0.25, 3) * (upper - lower) + [0.0, 0.0, 0.1]
    angle, speed, when = rng.uniform(0.0, 2 * np.pi), rng.uniform(0.2, 0.5), rng.uniform(3.0, 6.0)
    velocity = speed * np.array([np.cos(angle), np.sin(angle), 0.0])
    return [{"shape": "sphere", "radius": RADIUS, **moving(middle, velocity, when)}]


def person(workspace: Array, rng: np.random.Generator) -> list[dict]:
    """Sample a person who walks along and reaches over the workspace."""
    lower, upper = workspace
    reached, height = rng.uniform(0.0, 0.35), rng.uniform(lower[2] + 0.1, upper[2] + 0.1)
    speed, when, side = rng.uniform(0.2, 0.5), rng.uniform(3.0, 6.0), rng.choice([-1.0, 1.0])
    velocity, far = np.array([0.0, side * speed, 0.0]), upper[0] + 0.35
    arm = 0.35 + reached - 2 * 0.05  # m, of its axis
    across = [0.7071067811865476, 0.0, 0.7071067811865476, 0.0]
    parts = [
        ({"shape": "capsule", "radius": 0.16, "length": 0.7}, [far, 0.0, height - 0.1]),
        ({"shape": "sphere", "radius": 0.13}, [far, 0.0, height + 0.55]),
        (
            {"shape": "capsule", "radius": 0.05, "length": arm, "quaternion_wxyz": across},
            [far - 0.05 - 0.5 * arm, 0.0, height],
        ),
    ]
    return [{**part, **moving(np.array(middle), velocity, when)} for part, middle in parts]


def moving(middle: Array, velocity: Array, when: float) -> dict:
    """Return the keys of an obstacle in straight motion. It is at a point `when` [s] after the beginning."""
    way = [(middle + shift * velocity).round(4).tolist() for shift in (-when, LONGEST)]
    return {"center": way[0], "motion": {"waypoints": way, "times": [0.0, LONGEST + when]}}


def witness(executor: JointExecutor, seed: int) -> MotionReference | None:
    """Return a motion from the start clear of all obstacles, or None. Its planner knows their future: it is the best
    candidate of a roadmap that is three times as dense as the executor's, over the whole time with near obstacles,
    replanned 50 times a second."""
    finder, scene = executor.replanner.finder, executor.scene
    roadmap, courses = finder.settings.roadmap, finder.settings.courses
    denser = replace(
        finder.settings,
        roadmap=replace(roadmap, n_nodes=3 * roadmap.n_nodes),
        courses=replace(courses, n_slots=250, costs=courses.costs._replace(met=0.01 - scene.clearance)),
    )
    settings = replace(executor.replanner.settings, finder=denser)
    plan, arms = MotionReference.of_plan(executor.plan, executor.held.columns), finder.ground.arms
    needs = finder.ground.needs
    all_knowing = Pilot(
        CourseFinder(finder.standing, arms, finder.coordinates, plan, needs, seed=seed, settings=denser),
        settings,
    )
    moves = scene.moving[scene.owners]
    seen = Sighting(*(array[moves] for array in executor.observer.observe(0.0)))
    all_knowing.looks_on(0.0, seen, settings.patience)
    begin = Way(*(values[:1] for values in plan.way))
    if not all_knowing.choose(0.0, seen, begin, 0.0, settings.patience):
        return None
    found = all_knowing.reference
    times = np.arange(0.0, LONGEST, 0.02)
    configurations, joints, rates = found.at(times)
    nodes = finder.coordinates.nodes(configurations.T[None])[0]
    speed = np.linalg.norm(np.diff(nodes[:, : len(scene.manipulators)], axis=0), axis=2).max() / 0.02
    fits = speed <= scene.speed_limit and (np.abs(rates) <= arms.chains.velocity).all()
    bodies = finder.foresight.placed(Way(np.ascontiguousarray(configurations), np.ascontiguousarray(joints)))
    return found if fits and nearest(bodies, seen, times) >= KEPT else None


@numba.njit
def nearest(bodies: Places, seen: Sighting, times: Array) -> float:
    """Return sampled capsules' least distance from straight-moving obstacles [m]."""
    least, here = np.inf, seen.table.copy()
    for t in range(times.shape[0]):
        here[:, CENTER : CENTER + 3] = seen.table[:, CENTER : CENTER + 3] + times[t] * seen.velocity
        for row in range(here.shape[0]):
            for i in range(bodies.radius.shape[0]):
                p, q, radius = bodies.start[t, i], bodies.end[t, i], bodies.radius[i]
                apart = segment_distance(here, row, p[0], p[1], p[2], q[0], q[1], q[2], least + radius, 1e-4)
                least = min(least, apart - radius)
    return least


def main() -> None:
    """Run the command."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--scenes", type=int, default=20)
    parser.add_argument("--seed", type=int, default=0, help="seed of the first scene")
    parser.add_argument("--robots", nargs="+", default=ROBOTS)
    parser.add_argument("--people", action="store_true", help="a person who walks by instead of balls")
    options = parser.parse_args()
    warnings.simplefilter("ignore")
    print_head(
        [
            *("scene", "witnessed", "arrived [s]", "contacts", "hold, commanded", "hands apart [mm]"),
            *("links [mm]", "load [mm]", "choices", "each [ms]", "relaxed [m/s]", "stopped"),
            "step [ms], median and 99.9 %",
        ]
    )
    well, control = [], []
    for name in options.robots:
        first = drawn(name, options.seed, options.people)
        robot = Robot.load(first.file.robot)
        load_robot_kernels(SceneKind.of(first))
        for seed in range(options.seed, options.seed + options.scenes):
            executor = JointExecutor(drawn(name, seed, options.people), robot, seed=seed)
            known = witness(executor, seed) is not None
            record = run_live(executor, LONGEST)
            report, log = judge_run(record, stride=10), executor.log
            steps = 1e3 * np.array(log.control)
            well.append((known, record.arrived, not record.contacts, not report.reasons))
            control.append(steps)
            print_row(
                [
                    *(f"{name} {seed}", "yes" if known else "no"),
                    f"{report.duration_s:.1f}" if record.arrived else "-",
                    *(len(record.contacts), f"{report.hold_error_max:.0e}"),
                    *(f"{1e3 * report.distance_error_max:.2f}", f"{1e3 * report.clearance_scene:.1f}"),
                    *(f"{1e3 * report.clearance_carried:.1f}", log.plans - 1),
                    f"{1e3 * np.median([*log.planning][1:] or [0.0]):.0f}",
                    *(f"{log.relaxed:.3f}", log.stopped),
                    f"{np.median(steps):.2f}, {np.quantile(steps, 0.999):.2f}",
                ]
            )
    steps = np.concatenate(control)
    for words, rows in (("witnessed", [row for row in well if row[0]]), ("all", well)):
        arrived, clean, all_well = np.array(rows, dtype=int).reshape(-1, 4)[:, 1:].sum(axis=0)
        print(
            f"\n{words}: of {len(rows)} scenes {arrived} arrived, {clean} without contact, {all_well} as they should"
        )
    print(f"control step {np.median(steps):.2f} ms, 99.9 % within {np.quantile(steps, 0.999):.2f} ms")


if __name__ == "__main__":
    main()
