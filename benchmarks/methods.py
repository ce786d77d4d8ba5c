"""All methods and peers on `wide`, `narrow` and `complex`.

`wide` begins with a straight line, the others with their demonstration.

- ``comove``, ``projection`` (both with and without the planner), ``paper``: the methods of `comove.solve`.
- ``AugmentedLagrangian``, ``CCMAES``, ``EpsilonLevel``, ``Penalty`` of `comove.optim`, on pycma's problem in
  `comove.lab.peers.shapes`: that of the paper's method, but all at once, with the whole payload from the beginning
  and no planner. They begin with step size 0.05.
- the peers of `comove.lab.peers`.

The last offer is verified in continuous time. Columns: runs whose last offer is verified; seconds to the first
verified offer and until the method ended, medians; largest error of the distance over its tolerance, median; median
cost J of the verified runs.

To repeat: ``pip install 'comove[bench]'``, ``python benchmarks/methods.py [--seeds 20] [--budget 5]``.
"""

from __future__ import annotations

import argparse
import json
import warnings
from concurrent.futures import ProcessPoolExecutor
from contextlib import suppress
from dataclasses import asdict, dataclass
from pathlib import Path
from statistics import median

import numpy as np
from timing import number, on_one_thread, print_table

from comove import optim
from comove.lab.evolution import Paper, Projection
from comove.lab.examples import example
from comove.lab.peers.common import Peer, PeerOutOfTime
from comove.lab.peers.shapes import Shapes
from comove.lab.registry import PEERS
from comove.lab.systems import (
    Offers,
    OwnSystem,
    System,
    SystemOutcome,
    SystemProblem,
    cost_of,
    measured,
)
from comove.model import demonstration_of
from comove.planning import Comove

SCENES = ("wide", "narrow", "complex")
N_BASIS, SIGMA = 16, 0.05


@dataclass(frozen=True)
class Optimised(Peer):
    """One of comove's optimisers, by its name, on shape weights."""

    name: str
    modules = ()

    def run(self, problem: SystemProblem, offers: Offers) -> None:
        """Minimise J."""
        shapes = Shapes(problem, offers, N_BASIS)

        def cost(points: np.ndarray) -> np.ndarray:
            hands = shapes.hands(points)
            costs, asked = cost_of(problem.scene, hands), shapes.demands(hands)
            for k, x in enumerate(np.atleast_2d(points)):
                shapes.note(x, float(costs[k]), asked, k)
            return costs

        with suppress(PeerOutOfTime):
            optim.minimise(
                cost,
                np.zeros(shapes.n),
                SIGMA,
                constraints=lambda points: shapes.windows(shapes.demands(shapes.hands(points))),
                method=getattr(optim, self.name)(),
                seed=problem.seed,
            )
        shapes.close()


SYSTEMS: dict[str, System] = {
    "comove": OwnSystem("comove", Comove()),
    "comove, no planner": OwnSystem("comove, no planner", Comove(), planner=False),
    "projection": OwnSystem("projection", Projection()),
    "projection, no planner": OwnSystem("projection, no planner", Projection(), planner=False),
    "paper": OwnSystem("paper", Paper(), planner=False),
    **{name: Optimised(name) for name in ("AugmentedLagrangian", "CCMAES", "EpsilonLevel", "Penalty")},
    **PEERS,
}


def run(job: tuple[str, str, int, float]) -> tuple[SystemOutcome | None, float]:
    """Run a system on a scene with a seed. Return its result, and the tolerance of the scene's distance [m]."""
    name, system, seed, budget = job
    warnings.simplefilter("ignore")
    scene = example(name)
    problem = SystemProblem(scene, demonstration_of(scene), seed, budget)
    return measured(SYSTEMS[system], problem), scene.distances[0].tolerance


def main() -> None:
    """Measure and print the table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--systems", nargs="+", default=list(SYSTEMS), choices=list(SYSTEMS))
    parser.add_argument("--scenes", nargs="+", default=list(SCENES), choices=SCENES)
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("--budget", type=float, default=5.0, help="seconds for each")
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    on_one_thread()
    rows, found = [], {}
    with ProcessPoolExecutor(options.workers) as pool:
        for scene in options.scenes:
            for system in options.systems:
                jobs = [(scene, system, seed, options.budget) for seed in range(options.seeds)]
                found[f"{scene} {system}"] = outcomes = list(pool.map(run, jobs))
                rows.append(row(scene, system, outcomes))
                print(*rows[-1], sep="  ", flush=True)
    if options.json:
        plain = {name: [o and asdict(o) for o, _ in each] for name, each in found.items()}
        options.json.write_text(json.dumps(plain, indent=1))
    print()
    columns = ["scene", "system", "verified", "first [s]", "time [s]", "distance error / tolerance", "J"]
    print_table(columns, rows)


def row(scene: str, system: str, outcomes: list[tuple[SystemOutcome | None, float]]) -> list[str]:
    """Return the cells of one row."""
    offered = [(outcome, tolerance) for outcome, tolerance in outcomes if outcome is not None]
    good = [outcome for outcome, _ in offered if outcome.verified]
    firsts = [o.first_verified for o in good if o.first_verified is not None]
    return [
        scene,
        system,
        f"{len(good)}/{len(outcomes)}",
        number(median(firsts)) if firsts else "-",
        number(median(o.seconds for o, _ in offered)) if offered else "-",
        f"{median(o.distance_error_max / t for o, t in offered):.1e}" if offered else "-",
        number(median(o.cost for o in good)) if good else "-",
    ]


if __name__ == "__main__":
    main()
