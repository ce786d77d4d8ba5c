"""Robots carry their load in MuJoCo while balls fly through their workspace: drawn scenes, judged by what happened.

    python benchmarks/robot_run.py                          # 20 scenes for each robot
    python benchmarks/robot_run.py --scenes 5 --seed 1200 --robots gap_30

Balls of 16 cm fly straight, at 0.2 to 0.5 m/s, through a random point near the middle of the workspace, while the
carry is under way. Many of them cannot be dodged, as they fly through a shoulder. So a scene counts as *witnessed*
where somebody who knows the future finds a way; the others have no known one.
"""

from __future__ import annotations

import argparse
import warnings
from dataclasses import replace
from pathlib import Path

import numpy as np
import yaml
from numpy.typing import NDArray

from comove.geometry.distances import CENTER
from comove.planning import SceneKind
from comove.reaction.qp_workspace import Sighting
from comove.robots import Robot
from comove.robots.kernels import load_robot_kernels
from comove.robots.online.courses import Places
from comove.robots.online.executor import JointExecutor
from comove.robots.online.pilot import Pilot
from comove.robots.online.reference import Reference
from comove.robots.online.roadmap import Way
from comove.scenes import Scene
from comove.simulators.live import run_live
from comove.simulators.live_record import judge_run

Array = NDArray[np.float64]
EXAMPLES = Path(__file__).parents[1] / "examples"
ROBOTS = ("gap_30", "two_ur10", "two_xarm7")
RADIUS = 0.08  # m
LONGEST = 40.0  # s
KEPT = 0.005  # m, that a witness keeps from balls, by capsules of links


def drawn(name: str, seed: int) -> Scene:
    """An example with one to three balls that fly through its workspace."""
    data = yaml.safe_load(next(EXAMPLES.rglob(f"{name}.yaml")).read_text(encoding="utf-8"))
    rng = np.random.default_rng(seed)
    lower, upper = (np.array(data["workspace"][key]) for key in ("lower", "upper"))
    for _ in range(int(rng.integers(1, 4))):
        middle = 0.5 * (lower + upper) + rng.uniform(-0.25, 0.25, 3) * (upper - lower) + [0.0, 0.0, 0.1]
        angle, speed, when = rng.uniform(0.0, 2 * np.pi), rng.uniform(0.2, 0.5), rng.uniform(3.0, 6.0)
        velocity = speed * np.array([np.cos(angle), np.sin(angle), 0.0])
        way = [(middle + shift * velocity).round(4).tolist() for shift in (-when, LONGEST)]
        motion = {"waypoints": way, "times": [0.0, LONGEST + when]}
        ball = {"shape": "sphere", "center": way[0], "radius": RADIUS, "motion": motion}
        data["obstacles"] = [*data.get("obstacles", []), ball]
    return Scene.from_dict({**data, "name": f"{name} {seed}", "demonstration": None})


def witness(executor: JointExecutor, seed: int) -> Reference | None:
    """Return a motion from the start that keeps clear of all balls, or None if none is found.

    Its planner knows where they will be: it is the best course of a roadmap that is three times as dense as the
    executor's, over all the time in which a ball is near, and looked at anew 50 times in a second.
    """
    pilot, scene = executor.pilot, executor.scene
    settings = replace(
        pilot.settings,
        roadmap=replace(pilot.settings.roadmap, n_nodes=3 * pilot.settings.roadmap.n_nodes),
        courses=replace(pilot.settings.courses, n_slots=250, met=0.01 - scene.clearance),
    )
    plan = Reference.of_plan(executor.plan, executor.columns)
    all_knowing = Pilot(
        pilot.standing, pilot.arms, pilot.coordinates, plan, pilot.ground.needs, seed=seed, settings=settings
    )
    moves = scene.moving[scene.owners]
    balls = Sighting(*(array[moves] for array in executor.observer.observe(0.0)))
    all_knowing.looks_on(0.0, balls, settings.patience)
    begin = Way(*(values[:1] for values in plan.way))
    if not all_knowing.choose(0.0, balls, begin, 0.0, settings.patience):
        return None
    found = all_knowing.reference
    times = np.arange(0.0, LONGEST, 0.02)
    configurations, joints, rates = found.at(times)
    nodes = pilot.coordinates.nodes(configurations.T[None])[0]
    speed = np.linalg.norm(np.diff(nodes[:, : len(scene.manipulators)], axis=0), axis=2).max() / 0.02
    fits = speed <= scene.speed_limit and (np.abs(rates) <= pilot.arms.chains.velocity).all()
    bodies = pilot.foresight.placed(Way(np.ascontiguousarray(configurations), np.ascontiguousarray(joints)))
    return found if fits and nearest_ball(bodies, balls, times) >= KEPT else None


def nearest_ball(bodies: Places, balls: Sighting, times: Array) -> float:
    """Return the least distance of capsules, one sample for each instant, from balls that fly straight on [m]."""
    along, least = bodies.end - bodies.start, np.inf
    for row, velocity in zip(balls.table, balls.velocity, strict=True):
        center = row[CENTER : CENTER + 3] + times[:, None] * velocity
        away = center[:, None] - bodies.start
        share = (away * along).sum(axis=-1) / np.maximum((along**2).sum(axis=-1), 1e-18)
        apart = np.linalg.norm(away - np.clip(share, 0.0, 1.0)[..., None] * along, axis=-1)
        least = min(least, float((apart - bodies.radius).min()) - RADIUS)
    return least


def main() -> None:
    """Run what the command line asks for."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--scenes", type=int, default=20)
    parser.add_argument("--seed", type=int, default=0, help="seed of the first scene")
    parser.add_argument("--robots", nargs="+", default=ROBOTS)
    options = parser.parse_args()
    warnings.simplefilter("ignore")
    print(
        "| scene | witnessed | arrived [s] | contacts | hold, commanded | hands apart [mm] | links [mm] "
        "| load [mm] | choices | each [ms] | relaxed [m/s] | stopped | step [ms], median and 99.9 % |\n"
        "|---|---|---|---|---|---|---|---|---|---|---|---|---|"
    )
    well, control = [], []
    for name in options.robots:
        robot = Robot.load(drawn(name, 0).file.robot)
        load_robot_kernels(SceneKind.of(drawn(name, 0)))
        for seed in range(options.seed, options.seed + options.scenes):
            executor = JointExecutor(drawn(name, seed), robot, seed=seed)
            known = witness(executor, seed) is not None
            record = run_live(executor, LONGEST)
            report, log = judge_run(record, stride=10), executor.log
            steps = 1e3 * np.array(log.control)
            well.append((known, record.arrived, not record.contacts, not report.reasons))
            control.append(steps)
            print(
                f"| {name} {seed} | {'yes' if known else 'no'} "
                f"| {f'{report.duration_s:.1f}' if record.arrived else '-'} "
                f"| {len(record.contacts)} | {report.hold_error_max:.0e} "
                f"| {1e3 * report.distance_error_max:.2f} | {1e3 * report.clearance_scene:.1f} "
                f"| {1e3 * report.clearance_carried:.1f} | {len(log.planning) - 1} "
                f"| {1e3 * np.median(log.planning[1:] or [0.0]):.0f} | {log.relaxed:.3f} "
                f"| {log.stopped} | {np.median(steps):.2f}, {np.quantile(steps, 0.999):.2f} |",
                flush=True,
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
