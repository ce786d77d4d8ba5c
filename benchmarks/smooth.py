"""Least-jerk motions on fresh scenes: success, smoothness and time.

    python benchmarks/smooth.py [--planar 100] [--spatial 50] [--seed 71] [--many 20] [--parts | --cores | --seeds 10]

Half of the sampled scenes are easy, half hard; none was used before with this seed. Every scene is solved twice by
``comove.solve(scene, objective=LeastJerk(room=0.0))``, the second run counts; with many more paths, from
other random numbers too, for 20 s each, whose best counts as the best known; with the default soft clearance; and for
the paper's objective. Columns: verified; first verified motion, the first whose objective is within 1 % of the last
one's, and whole search, medians and 95 % [ms]; squared jerk over the best known, median and 95 %; largest
acceleration over that of the same path with minimum jerk along its length, median; clearance, median [mm].

With ``--parts``, a table of the times in searches with the default objective is printed instead: medians of processor
times [ms], and shares of all.

With ``--cores``, every search is run with one core and with two, in turns: medians of the time on the wall and of
processor time [ms], and in how many both found the same motion. Other work on the machine spoils the former.

With ``--seeds N``, every scene is solved with N seeds on one core: verified; value of the default objective over the
best of the N, less 1, mean, 95 % and most [%]; the share of searches that end within 2 % of it; processor time until
then, median of all [ms], and of the whole search, median and mean [ms].
"""

from __future__ import annotations

import argparse
import time
import warnings
from dataclasses import replace
from functools import partial

import daqp
import numpy as np
from scipy.integrate import cumulative_simpson
from scipy.interpolate import CubicSpline
from timing import Parts, Watch, on_one_thread, print_table

import comove
from comove import LeastJerk, PaperCost
from comove.lab.bench.sets import SETS
from comove.model import CoordinatedMotion
from comove.planning import Comove, ahead, kinematics, search, smooth
from comove.planning.convex import optimise, programme
from comove.planning.convex.costs import SumOfSquares, jerk_cost
from comove.planning.seeds import minimum_jerk

WAYS = replace(Comove(), n_ways=40, n_idle=20, n_met=40)
N_PATH, N_TIMES = 4001, 401  # samples of a path by time, and of the same path by its length
BUDGET = 60.0  # s
MANY = 20.0  # s, of the search for the best known, from each of two seeds


def main() -> None:
    """Sample, solve and print the tables."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--planar", type=int, default=100)
    parser.add_argument("--spatial", type=int, default=50)
    parser.add_argument("--seed", type=int, default=71)
    parser.add_argument(
        "--many", type=float, default=MANY, help="seconds of each search for the best; 0: none"
    )
    parser.add_argument("--parts", action="store_true", help="where the time goes")
    parser.add_argument("--cores", action="store_true", help="times with one core and with two")
    parser.add_argument("--seeds", type=int, default=0, help="excess over the best of so many seeds")
    asked = parser.parse_args()
    on_one_thread()
    warnings.simplefilter("ignore")
    drawn = {
        f"{kind} {name}": [
            comove.Scene.from_dict(SETS[name].draw(2 * i + (kind == "spatial"), asked.seed)[0])
            for i in range(count // 2)
        ]
        for kind, count in (("planar", asked.planar), ("spatial", asked.spatial))
        if count > 1
        for name in ("easy", "hard")
    }
    if asked.parts or asked.cores:
        (print_parts if asked.parts else print_cores)(drawn)
        return
    if asked.seeds:
        print_seeds(drawn, asked.seeds)
        return
    rows = []
    for scenes, those in drawn.items():
        found: dict[str, list[tuple[float, ...]]] = {}
        for scene in those:
            for name, figures in measured(scene, asked.many).items():
                found.setdefault(name, []).append(figures)
        rows += [row(scenes, name, np.array(figures)) for name, figures in found.items()]
        print_table(HEADER, rows[-len(found) :])
    print("\nall:")
    print_table(HEADER, rows)


def print_cores(drawn: dict[str, list[comove.Scene]]) -> None:
    """Print times with one core and with two, by kind of scenes."""
    rows = []
    for kind, those in drawn.items():
        times, same = list[list[float]](), list[bool]()
        for scene in (those[0], *those):  # a first solve that does not count
            weights, spent = [], list[float]()
            for cores in (1, 2):
                ahead.n_processors = lambda cores=cores: cores
                wall, processor = time.perf_counter(), time.process_time()
                solution = comove.solve(scene, budget=BUDGET)
                spent += [time.perf_counter() - wall, time.process_time() - processor]
                weights.append(solution.attempt.weights)
            times.append(spent)
            same.append(np.array_equal(*weights))
        ms = 1e3 * np.array(times[1:])
        ratio = np.median(ms[:, 2] / ms[:, 0])
        figures = (f"{x:.1f}" for x in np.median(ms, axis=0))
        rows.append([kind, *figures, f"{ratio:.2f}", f"{sum(same[1:])} of {len(ms)}"])
    print_table(["scenes", "one core", "processor", "two cores", "processor", "ratio", "same motion"], rows)


def print_seeds(drawn: dict[str, list[comove.Scene]], n_seeds: int) -> None:
    """Print how far searches end from the best of several seeds, by kind of scenes."""
    ahead.n_processors = lambda: 1
    rows = []
    for kind, those in drawn.items():
        comove.solve(those[0], budget=BUDGET)
        excess, within, spent = list[float](), list[float](), list[float]()
        for scene in those:
            watches = list[Watch]()
            for seed in range(n_seeds):
                watches.append(Watch(time.process_time))
                comove.solve(scene, seed=seed, budget=BUDGET, progress=watches[-1])
                spent.append(1e3 * (time.process_time() - watches[-1].begun))
            best = min(watch.last for watch in watches)
            excess += [100 * (watch.last / best - 1) if watch.last < np.inf else np.inf for watch in watches]
            within += [1e3 * np.nan_to_num(watch.reached(1.02 * best), nan=np.inf) for watch in watches]
        verified = np.isfinite(excess)
        rows.append(
            [
                kind,
                f"{verified.sum()} of {len(excess)}",
                *(
                    f"{f(np.array(excess)[verified]):.2g}"
                    for f in (np.mean, partial(np.quantile, q=0.95), np.max)
                ),
                f"{100 * np.isfinite(within).mean():.0f} %",
                *(f"{x:.0f}" for x in (np.median(within), np.median(spent), np.mean(spent))),
            ]
        )
        print_table(SEEDS_HEADER, rows[-1:])
    print("\nall:")
    print_table(SEEDS_HEADER, rows)


SEEDS_HEADER = (
    "scenes",
    "verified",
    "over the best %",
    "95 %",
    "most",
    "within 2 %",
    "ms until then",
    "all ms",
    "mean",
)


def print_parts(drawn: dict[str, list[comove.Scene]]) -> None:
    """Print the times in searches, by kind of scenes."""
    parts = Parts(
        {
            "plans": [(kinematics, "plan")],
            "first fits": [(Comove, "_certified_fit")],
            "contacts": [(programme, "find_contacts"), (programme, "linearised")],
            "normal equations": [(SumOfSquares, "normal_equations")],
            "Cholesky, inverse": [(np.linalg, "cholesky"), (optimise, "inverse_of_lower")],
            "rest of models": [(optimise, "stand")],
            "DAQP": [(daqp, "solve")],
            "rows of programmes": [(optimise, "minimum")],
            "values": [(programme.ConvexProgramme, "value"), (programme.ConvexProgramme, "missed")],
            "warps": [(optimise, "warped")],
            "rest of steps": [(optimise, "step"), (smooth, "optimise")],
            "verification": [(search, "verify")],
            "rest": [(comove, "solve")],
        }
    )
    columns = []
    for those in drawn.values():
        for scene in those[:1]:
            comove.solve(scene, budget=BUDGET)
        times = [parts.of(lambda scene=scene: comove.solve(scene, budget=BUDGET)) for scene in those]
        spent = 1e3 * np.array([list(one.values()) for one in times])
        spent = np.column_stack([spent, spent.sum(axis=1)])
        share = 100 * spent.sum(axis=0) / spent[:, -1].sum()
        columns.append(
            [f"{ms:.1f} ({part:.0f} %)" for ms, part in zip(np.median(spent, axis=0), share, strict=True)]
        )
    rows = zip([*parts.seconds, "all"], *columns, strict=True)
    print_table(["part", *drawn], rows)


HEADER = (
    "scenes",
    "objective",
    "verified",
    "first ms",
    "95 %",
    "converged ms",
    "95 %",
    "all ms",
    "95 %",
    "jerk / best",
    "95 %",
    "acceleration / along its path",
    "clearance mm",
)


def measured(scene: comove.Scene, budget: float) -> dict[str, tuple[float, ...]]:
    """Return the figures of one scene by objective. They are verified, seconds, squared jerk over the best,
    acceleration, and clearance."""
    tried = {"least jerk": LeastJerk(room=0.0), "with room": LeastJerk(), "paper": PaperCost()}
    solutions, converged = {}, {}
    for name, objective in tried.items():
        for _ in range(1 if name == "paper" else 2):
            watch = Watch()
            solutions[name] = comove.solve(scene, objective=objective, budget=BUDGET, progress=watch)
            converged[name] = watch.converged()
    many = [
        comove.solve(scene, objective=tried["least jerk"], method=WAYS, budget=budget, seed=seed)
        for seed in ((0, 1) if budget > 0 else ())
    ]
    best = min((jerk(s) for s in (*many, *solutions.values()) if s.verified), default=float("nan"))
    return {
        name: (
            s.verified,
            1e3 * (s.effort.first_verified or np.nan),
            1e3 * converged[name],
            1e3 * s.effort.seconds,
            jerk(s) / best if s.verified else np.nan,
            s.report.acceleration_max / acceleration_along(s.attempt),
            1e3 * s.report.clearance_min,
        )
        for name, s in solutions.items()
    }


def acceleration_along(motion: CoordinatedMotion) -> float:
    """Return the largest acceleration with minimum jerk along the path [m/s^2]."""
    s = np.linspace(0.0, 1.0, N_PATH)
    hands, velocity, _ = motion.hands(s)
    speed = np.linalg.norm(velocity, axis=2).sum(axis=1)
    gone = cumulative_simpson(speed, x=s, initial=0.0)
    kept = np.concatenate([[True], np.diff(gone) > 1e-9 * gone[-1]])
    t = np.linspace(0.0, 1.0, N_TIMES)
    path = CubicSpline(gone[kept], hands[kept])(gone[-1] * minimum_jerk(t))
    acceleration = np.diff(path, n=2, axis=0) * (N_TIMES - 1) ** 2
    return float(np.linalg.norm(acceleration, axis=2).max()) / motion.scene.duration**2


def jerk(solution: comove.Solution) -> float:
    """Return the integrated squared jerk over that of straight motions."""
    return jerk_cost(solution.attempt, LeastJerk(), None)


def row(scenes: str, name: str, figures: np.ndarray) -> list[str]:
    """Return a row of the table."""
    verified, first, converged, whole, ratio, acceleration, clearance = figures.T
    middle, high = (lambda x: np.nanmedian(x)), (lambda x: np.nanquantile(x, 0.95))
    return [
        scenes,
        name,
        f"{int(verified.sum())} of {len(verified)}",
        *(f"{f(x):.0f}" for x in (first, converged, whole) for f in (middle, high)),
        *(f"{f(ratio):.4g}" for f in (middle, high)),
        f"{middle(acceleration):.3g}",
        f"{middle(clearance):.1f}",
    ]


if __name__ == "__main__":
    main()
