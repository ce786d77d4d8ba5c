"""Methods on random scenes with moving obstacles: distances, contacts, arrivals.

    python benchmarks/moving.py                   # 200 scenes, all methods
    python benchmarks/moving.py --scenes 20

Every method gets the same scenes and is verified with the same ground truth: `known` executes with the motions of
the file, `seen` knows present positions and velocities of obstacles; `measured` gets them with 1 cm of noise, 50 ms
late and with 10 % drop-outs; `clouds` gets points on them, 1 cm apart, with 2 mm of noise, 30 ms late, 20 times a
second; the others modulate the end effectors' velocities as in the paper. An arrival of `known` is the witness that
a scene is feasible.

Counted apart: scenes in which something stays at the payload's goal, out of the arrivals; and, out of the contacts,
scenes in which `dodging.dodge`, which knows everything, finds no movement within the limits that touches nothing for
two seconds, from the payload's pose when news of the motion that was touched first can have come: for `seen` when it
changed last (a corner of its path, or its start), for measured or scanned obstacles the sensor's delay after that.
"""

from __future__ import annotations

import argparse
import time
import warnings

import numpy as np
from dodging import dodge, news
from random_scenes import moving_scene
from timing import print_head, print_row

from comove.control import Executor, Functions, Known, Measured, Scanned, Sensor
from comove.lab.modulation import Sharing
from comove.lab.modulation.comparison import MODULATED, loose_run
from comove.model import Scene
from comove.planning import SceneKind, load_kernels
from comove.verification.record import Record, verify_execution

SENSOR = Sensor(noise=0.01, delay=0.05, dropout=0.1)
LATE = {"seen": 0.0, "clouds": 0.03, "measured": SENSOR.delay}  # s, until there can be news
LONGEST = 3.0  # times the duration
HEADER = (
    *("method", "arrived", "contacts", "distance error [m]"),
    *("clearance [mm]", "of the limits", "control [ms]", "replan [s]"),
)


def executed(scene: Scene, observer) -> dict[str, float]:
    """Run one execution; return its measures."""
    executor = Executor(scene, observer)
    record = executor.run(LONGEST * scene.duration)
    log = executor.log
    return {**measures(record), "plans": [*log.planning], "control": [*log.control], "record": record}


def modulated_run(scene: Scene, sharing: Sharing, load: bool) -> dict[str, float]:
    """Run a modulation; return its measures. The payload is straight between the end effectors."""
    record = loose_run(scene, sharing, LONGEST * scene.duration, load=load)
    return {**measures(record), "plans": [], "control": []}


def measures(record: Record) -> dict[str, float]:
    """Return the verification's measures of a record."""
    scene, report = record.scene, verify_execution(record)
    return {
        "contact": report.clearance_min < 0.0,
        "arrived": report.end_error <= 1e-3,
        "distance": report.distance_error_max,
        "clearance": report.clearance_min,
        "limits": max(
            report.speed_max / scene.speed_limit, report.acceleration_max / scene.acceleration_limit
        ),
    }


def is_taken(scene: Scene) -> bool:
    """Return whether an obstacle occupies the goal for the last fifth."""
    last, goal = np.linspace(0.8, 1.0, 100) * LONGEST * scene.duration, scene.nodes_at("goal")
    return all(scene.clearance_at(goal, time)[0] < 0.0 for time in last)


def row(name: str, runs: list[dict]) -> None:
    """Print the row of one method."""
    control = (
        np.concatenate([r["control"] for r in runs]) if runs and runs[0]["control"] else np.array([np.nan])
    )
    again = [t for r in runs for t in r["plans"][1:]] or [np.nan]
    print_row(
        [
            *(name, f"{sum(r['arrived'] for r in runs)}/{len(runs)}", sum(r["contact"] for r in runs)),
            f"{max(r['distance'] for r in runs):.1e}",
            f"{1e3 * min(r['clearance'] for r in runs):.1f}",
            f"{max(r['limits'] for r in runs):.3f}",
            f"{1e3 * np.median(control):.2f}, {1e3 * np.quantile(control, 0.999):.2f}",
            f"{np.median(again):.3f}",
        ]
    )


def main() -> None:
    """Run the command."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--scenes", type=int, default=200)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument(
        "--share", type=float, default=1.0, help="greatest speed of obstacles over the hands'"
    )
    parser.add_argument("--only", nargs="*", default=["known", "seen", "measured", "clouds", *MODULATED])
    options = parser.parse_args()
    warnings.simplefilter("ignore")
    for n_dims in (2, 3):
        load_kernels(SceneKind(n_dims, moving=True))
    seeds = range(options.first, options.first + options.scenes)
    scenes = {seed: moving_scene(seed, options.share) for seed in seeds}
    taken = [seed for seed, scene in scenes.items() if is_taken(scene)]
    print(f"the goal is taken at the end in {len(taken)} of {len(scenes)}: {taken}")
    hit: dict[str, dict[int, Record]] = {}
    print_head(HEADER)
    for name in options.only:
        begun, runs = time.perf_counter(), []
        for seed, scene in scenes.items():
            if name in MODULATED:
                runs.append(modulated_run(scene, *MODULATED[name]))
            else:
                rng = np.random.default_rng(seed)
                observers = {
                    "known": lambda scene=scene: Known(scene),
                    "seen": lambda scene=scene: Functions.of_motions(scene),
                    "clouds": lambda scene=scene, rng=rng: Scanned(
                        Known(scene), scene, None, rng, delay=LATE["clouds"]
                    ),
                    "measured": lambda scene=scene, rng=rng: Measured(Known(scene), scene, SENSOR, rng),
                }
                runs.append(executed(scene, observers[name]()))
        row(name, runs)
        told = {
            what: [seed for seed, r in zip(seeds, runs, strict=True) if wrong(r)]
            for what, wrong in (
                ("not arrived", lambda r: not r["arrived"]),
                ("contact", lambda r: r["contact"]),
            )
        }
        if name not in MODULATED:
            hit[name] = {seed: r["record"] for seed, r in zip(seeds, runs, strict=True) if r["contact"]}
            print(f"  {name}: {told}, {time.perf_counter() - begun:.0f} s", flush=True)
    for name, records in hit.items():
        could_not = []
        for seed, record in records.items():
            since = news(record, LATE[name]) if name in LATE else 0.0  # what is known has no news
            if dodge(record, since) is None:
                could_not.append(seed)
        print(f"of those hit by {name}, nothing is known to dodge since the news in {could_not}", flush=True)


if __name__ == "__main__":
    main()
