"""Times of a safety-filter step, and of QP solvers on its programmes.

A payload rotates and moves among 4 obstacles that move, spin and approach; the desired velocities change every
second. A step is `SafetyFilter.allowed` and `advanced`: rows, all rounds of solving, the check of the exact step.
Quantiles are over all steps, also those in which nothing is admissible because obstacles have closed in, which take
longer.

For the solvers the first quadratic programme (CBF-QP) of every step is recorded and solved alone, from arrays to
solution. quadprog, proxsuite, piqp and osqp are measured where they are installed.

To repeat: ``python benchmarks/reaction.py [--steps 20000]``.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable

import numpy as np
from timing import number, on_one_thread, print_table, quantile

from comove.control.safety.cbf_qp import HARD, SafetyFilter, Sighting
from comove.control.safety.control_points import moved_obstacles
from comove.control.safety.twists import advanced, nodes_of, poses_of
from comove.model import Scene

PERIOD = 0.01  # s
SIDE = 2.0  # m, of the workspace
N_RECORDED = 400  # quadratic programmes for the solvers


def scene_of(load: str, n_dims: int, acceleration: float | None) -> Scene:
    """Return a payload in the middle of a workspace with 4 obstacles."""
    z = [1.0] * (n_dims - 2)
    hands = {"left": [1.0, 0.85, *z], "right": [1.0, 1.15, *z]}
    carried = {"shape": "bar", "length": 0.3, "radius": 0.01, "held_by": ["left", "right"]}
    constraints = []
    if load == "frame":
        hands["third"] = [1.25, 1.0, *z]
        rods = [["left", "right"], ["right", "third"], ["third", "left"]]
        carried = {"shape": "frame", "edges": rods, "radius": 0.005}
    elif load == "bar and hand":
        hands["third"] = [1.25, 1.0, *z]
    elif load == "box":
        grasps = {"left": [-0.15, 0, 0], "right": [0.15, 0, 0]}
        carried = {"shape": "box", "size": [0.4, 0.2, 0.1], "grasps": grasps}
        constraints = [{"type": "upright"}]
    shapes = [
        {"shape": "box", "center": [0.4, 0.4, *z], "size": [0.3, 0.2, 0.3][:n_dims]},
        {"shape": "circle", "center": [1.6, 0.4, *z], "radius": 0.12},
        {"shape": "capsule", "center": [0.4, 1.6, *z], "radius": 0.05, "length": 0.25},
        {"shape": "ellipsoid", "center": [1.6, 1.6, *z], "radii": [0.1, 0.2, 0.1][:n_dims]},
    ]
    return Scene.from_dict(
        {
            "name": "reaction",
            "duration": 10.0,
            "workspace": {"lower": [0.0] * n_dims, "upper": [SIDE] * n_dims},
            "obstacles": shapes,
            "load": carried,
            "manipulators": [{"name": name, "start": p, "goal": p} for name, p in hands.items()],
            "limits": {"speed": 1.0, "acceleration": acceleration},
            "constraints": constraints,
        }
    )


def drive(scene: Scene, n_steps: int) -> tuple[list[float], float]:
    """Return the times of all steps [s], and the inadmissible share."""
    rng, n, n_hands = np.random.default_rng(0), len(scene.obstacles), len(scene.manipulators)
    safety, poses = SafetyFilter(scene, PERIOD), poses_of(scene, "start")
    before, table, after = np.zeros((n_hands, 3)), scene.obstacles.copy(), scene.obstacles.copy()
    velocity, spin = np.zeros((n, 3)), np.zeros((n, 3))
    velocity[:, : scene.n_dims] = rng.uniform(-0.2, 0.2, (n, scene.n_dims))
    spin[:, 2] = rng.uniform(-1.0, 1.0, n)
    times, relaxed = [], 0
    for i in range(n_steps):
        if i % 100 == 0:
            wanted = rng.standard_normal((1, 3)) + 0.5 * rng.standard_normal((n_hands, 3))
            wanted[:, scene.n_dims :] = 0.0
        outward = (table[:, 1:4] - 0.5 * SIDE) * velocity > 0.0
        velocity = np.where(outward & (np.abs(table[:, 1:4] - 0.5 * SIDE) > 0.5 * SIDE), -velocity, velocity)
        sighting = Sighting(table, velocity, spin, np.full(n, 0.005))
        started = time.perf_counter()
        allowed = safety.allowed(poses, before, wanted, sighting)
        later = advanced(poses, allowed.twists, PERIOD)
        times.append(time.perf_counter() - started)
        relaxed += allowed.relaxed > 0.0
        before = (nodes_of(scene, later) - nodes_of(scene, poses))[:n_hands] / PERIOD
        poses = later
        moved_obstacles(table, velocity, spin, PERIOD, after)
        table = after.copy()
    return times[10:], relaxed / n_steps


def recorded(scene: Scene) -> list[tuple[np.ndarray, ...]]:
    """Return feasible quadratic programmes with rows, recorded on a drive."""
    found: list[tuple[np.ndarray, ...]] = []
    solve = SafetyFilter._solved

    def record(self: SafetyFilter, m: int, *others):
        result = solve(self, m, *others)
        work = self._work
        if result[2] == HARD and m > 4:
            found.append(
                (work.quadratic.copy(), work.linear.copy(), work.rows[:m].copy(), work.low[:m].copy())
            )
        return result

    SafetyFilter._solved = record
    try:
        drive(scene, 4000)
    finally:
        SafetyFilter._solved = solve
    return found[:: max(1, len(found) // N_RECORDED)]


def solvers() -> dict[str, Callable[..., np.ndarray]]:
    """Return all installed solvers of a quadratic programme. It is min x'Hx/2 + f x with rows x >= low."""
    import daqp

    found = {
        "daqp": lambda h, f, a, low: daqp.solve(
            h, f, a, np.full(len(low), 1e30), low, np.zeros(len(low), dtype=np.int32), primal_tol=1e-9
        )[0]
    }
    try:
        import quadprog

        found["quadprog"] = lambda h, f, a, low: quadprog.solve_qp(h, -f, a.T, low)[0]
    except ImportError:
        pass
    try:
        import proxsuite

        found["proxsuite"] = lambda h, f, a, low: (
            proxsuite.proxqp.dense.solve(h, f, None, None, a, low, np.full(len(low), 1e20), eps_abs=1e-8).x
        )
    except ImportError:
        pass
    try:
        import piqp

        def by_piqp(h, f, a, low):
            solver = piqp.DenseSolver()
            solver.setup(h, f, None, None, a, low, np.full(len(low), 1e30))
            solver.solve()
            return solver.result.x

        found["piqp"] = by_piqp
    except ImportError:
        pass
    try:
        import osqp
        from scipy import sparse

        def by_osqp(h, f, a, low):
            solver, upper = osqp.OSQP(), np.full(len(low), np.inf)
            args = sparse.csc_matrix(np.triu(h)), f, sparse.csc_matrix(a), low, upper
            solver.setup(*args, verbose=False, eps_abs=1e-6, eps_rel=1e-6)
            return solver.solve().x

        found["osqp"] = by_osqp
    except ImportError:
        pass
    return found


def main() -> None:
    """Measure and print both tables."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--steps", type=int, default=20000)
    options = parser.parse_args()

    cases = [
        (load, n_dims, acceleration)
        for load, n_dims in (("bar", 2), ("bar and hand", 2), ("bar", 3), ("frame", 3), ("box", 3))
        for acceleration in (None, 4.0)
    ]
    rows = []
    for load, n_dims, acceleration in cases:
        times, relaxed = drive(scene_of(load, n_dims, acceleration), options.steps)
        shares = [number(1e6 * quantile(times, share)) for share in (0.5, 0.99, 0.999, 1.0)]
        rows.append([load, f"{n_dims}-D", acceleration or "none", *shares, f"{100 * relaxed:.2f} %"])
    print_table(
        ["payload", "", "acceleration limit", "median [us]", "99 %", "99.9 %", "most", "not admissible"], rows
    )
    print()

    every, rows = solvers(), []
    for load, n_dims, acceleration in (("bar", 2, 4.0), ("bar", 3, 4.0), ("frame", 3, 4.0)):
        programmes = recorded(scene_of(load, n_dims, acceleration))
        best = [every["daqp"](*programme) for programme in programmes]
        counts = [len(programme[3]) for programme in programmes]
        for name, solve in every.items():
            times, error = [], 0.0
            for programme, x in zip(programmes * 3, best * 3, strict=True):
                started = time.perf_counter()
                found = solve(*programme)
                times.append(time.perf_counter() - started)
                error = max(error, np.abs(found - x).max())
            shares = [number(1e6 * quantile(times, share)) for share in (0.5, 0.999)]
            size = f"{len(best[0])} x {int(np.median(counts))} ({max(counts)})"
            rows.append([f"{load}, {n_dims}-D", size, name, *shares, f"{error:.1e}"])
    print_table(
        [
            "quadratic programmes of",
            "variables x rows (most)",
            "solver",
            "median [us]",
            "99.9 %",
            "differs from daqp",
        ],
        rows,
    )


if __name__ == "__main__":
    on_one_thread()
    main()
