"""Performance of primitives, beside ProDMP (mp-pytorch) and movement_primitives.

- handwriting: 30 LASA shapes, all 7 demonstrations, N = 10, 20, 50 free weights a dimension: median of the root mean
  square error over the 210 recordings. The peers fit with their own defaults (ProDMP: alpha 25, alpha_phase 2,
  bandwidth 2, double precision, its goal is fitted as one more weight; movement_primitives: its DMP);
- execution: largest error of a movement executed step by step against its exact rollout, and the remaining distance
  to the goal after the end, for the stepping that either tool offers;
- rollouts: 1000 weight vectors beside the bare matrix product of the same size;
- rigid payload: end effectors on SE(3) at double and half speed, with a stop and a goal that jumps in the middle;
- recording: a CSV file of a million samples, read, segmented and fitted, in a process of its own.

To repeat: ``pip install 'comove[bench]'`` and ``python benchmarks/primitives.py [--only handwriting ...]``.
PyTorch's CPU build is enough.
"""

from __future__ import annotations

import argparse
import logging
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
from timing import medians, number, on_one_thread, peer, print_table

from comove.dmp import DMP, Pose, PoseDMP, Variant
from comove.dmp.cooperative import CooperativeDMP
from comove.dmp.demonstrations import Demonstration, lasa_names
from comove.planning.seeds import minimum_jerk
from comove.trajectory import interpolated

N_BASIS = (10, 20, 50)
ENDING = [variant for variant in Variant if variant is not Variant.RHYTHMIC]


def handwriting() -> None:
    """Print median errors of the fits of all recordings."""
    demos = [Demonstration.from_lasa(name, k) for name in lasa_names() for k in range(7)]
    fits: dict[str, Callable[[list[Demonstration], int], list[np.ndarray]]] = {
        "ProDMP (mp-pytorch)": prodmp,
        "movement_primitives, DMP": movement_primitives,
    }
    rows = []
    for variant in ENDING:
        rows.append([f"comove, {variant}", *(summary(demos, own(demos, n, variant)) for n in N_BASIS)])
    for name, fit in fits.items():
        rows.append([name, *(summary(demos, fit(demos, n)) for n in N_BASIS)])
    print_table([f"{len(demos)} recordings, median error (largest)", *(f"N = {n}" for n in N_BASIS)], rows)


def summary(demos: list[Demonstration], paths: list[np.ndarray]) -> str:
    """Return the median and largest RMS error of paths. Each path has the shape (n_steps, 2)."""
    errors = [
        np.sqrt(((path - demo.position) ** 2).sum(axis=1).mean())
        for demo, path in zip(demos, paths, strict=True)
    ]
    return f"{np.median(errors):.4f} ({np.max(errors):.3g})"


def own(demos: list[Demonstration], n_basis: int, variant: Variant) -> list[np.ndarray]:
    """Return fits of comove, sampled at the recordings' times."""
    return [DMP.fit(demo, n_basis=n_basis, variant=variant).at(demo.time).position for demo in demos]


def prodmp(demos: list[Demonstration], n_basis: int) -> list[np.ndarray]:
    """Return fits of ProDMP, all recordings in one unit-duration batch."""
    torch, factory = peer("torch"), peer("mp_pytorch.mp").MPFactory
    logging.disable(logging.WARNING)
    settings = {
        "num_basis": n_basis, "basis_bandwidth_factor": 2, "num_basis_outside": 0, "alpha": 25, "alpha_phase": 2,
        "dt": 1e-3, "weights_scale": 1.0, "goal_scale": 1.0, "relative_goal": False,
    }  # fmt: skip
    model = factory.init_mp("prodmp", settings, num_dof=2, tau=1.0, dtype=torch.float64)
    paths = []
    for demo in demos:
        times = torch.as_tensor(demo.time / demo.duration)[None]
        positions = torch.as_tensor(demo.position.copy())[None]
        start = {
            "init_time": times[:, 0],
            "init_pos": positions[:, 0],
            "init_vel": torch.as_tensor(demo.start_velocity * demo.duration)[None],
        }
        fitted = model.learn_mp_params_from_trajs(times, positions, reg=1e-9, **start)
        model.update_inputs(times=times, params=fitted["params"], **start)
        paths.append(model.get_traj_pos()[0].numpy())
    return paths


def movement_primitives(demos: list[Demonstration], n_basis: int) -> list[np.ndarray]:
    """Return fits of movement_primitives, played by its own integrator."""
    module = peer("movement_primitives.dmp")
    paths = []
    for demo in demos:
        s = demo.time / demo.duration
        model = module.DMP(
            n_dims=2, execution_time=1.0, dt=1.0 / (demo.n_steps - 1), n_weights_per_dim=n_basis
        )
        model.imitate(s, demo.position.copy())
        model.configure(start_y=demo.position[0].copy(), goal_y=demo.position[-1].copy())
        played_time, played = model.open_loop(run_t=1.0)
        paths.append(interpolated(s, played_time, played))
    return paths


def execution() -> None:
    """Print errors of stepping, and remaining distances after the end."""
    demo = Demonstration.from_lasa("Angle")
    counts = (25, 50, 100, 200, 400, 800)
    rows = []
    for variant in ENDING:
        dmp = DMP.fit(demo, n_basis=20, variant=variant)
        errors = []
        for n_steps in counts:
            expected, state, worst = dmp.rollout(n_steps=n_steps + 1), dmp.initial_state(), 0.0
            for k in range(n_steps):
                state = dmp.step(state, dmp.duration / n_steps)
                worst = max(worst, np.abs(state.position - expected.position[k + 1]).max())
            errors.append(worst)
        off = np.abs(dmp.step(state, dmp.duration).position - dmp.goal).max()
        rows.append([f"comove, {variant}", *(f"{e:.1e}" for e in errors), f"{off:.1e}"])
    module, errors, left = peer("movement_primitives.dmp"), [], 0.0
    paths = {}
    for n_steps in (*counts, 25600):
        model = module.DMP(n_dims=2, execution_time=1.0, dt=1.0 / n_steps, n_weights_per_dim=20)
        reference = module.DMP(n_dims=2, execution_time=1.0, dt=1e-3, n_weights_per_dim=20)
        reference.imitate(demo.time / demo.duration, demo.position.copy())
        model.configure(start_y=demo.position[0].copy(), goal_y=demo.position[-1].copy())
        model.set_weights(reference.get_weights())
        paths[n_steps] = model.open_loop(run_t=1.0)[1]
        left = np.abs(model.open_loop(run_t=2.0)[1][-1] - demo.position[-1]).max()
    for n_steps in counts:
        fine = paths[25600][:: 25600 // n_steps][: n_steps + 1]
        errors.append(np.abs(paths[n_steps][: len(fine)] - fine).max())
    rows.append(
        ["movement_primitives, DMP, against 25600 steps", *(f"{e:.1e}" for e in errors), f"{left:.1e}"]
    )
    print_table(
        ["largest error by number of steps", *map(str, counts), "off the goal after twice the time"], rows
    )


def rollouts() -> None:
    """Print times of 1000 rollouts beside the bare product."""
    rows, rng = [], np.random.default_rng(0)
    for n_dims in (4, 7, 14, 28):
        dmp = DMP(rng.standard_normal((n_dims, 20)), *rng.standard_normal((4, n_dims)), 1.0)
        weights = rng.standard_normal((1000, n_dims, 20))
        for n_steps in (200, 1000, 2000):
            flat, phi = weights.reshape(-1, 20), np.ascontiguousarray(dmp.basis.sampled(n_steps)[:20])
            times = medians(
                {"bare": lambda: flat @ phi, "own": lambda: dmp.rollouts(weights, n_steps)},  # noqa: B023
                9 if n_dims * n_steps > 10_000 else 31,
            )
            rows.append([n_dims, n_steps, *(number(1e3 * times[key]) for key in ("bare", "own")),
                         number(times["own"] / times["bare"])])  # fmt: skip
    print_table(["dimensions", "T", "product [ms]", "rollouts [ms]", "ratio"], rows)


def rigid_load() -> None:
    """Print errors of relative poses under all disturbances."""
    from scipy.spatial.transform import Rotation

    s = np.linspace(0, 1, 401)
    way = minimum_jerk(s)
    position = np.stack([way, 0.2 * np.sin(np.pi * way), 0.3 * way**2], axis=1)
    vectors = np.stack([2 * (1 - way), 1.5 * np.sin(np.pi * way), 1 - way**2], axis=1)
    shown = Demonstration(
        4 * s, position, orientation=Rotation.from_rotvec(vectors).as_quat(scalar_first=True)
    )
    load, rng, rows = PoseDMP.fit(shown), np.random.default_rng(0), []
    goal = Pose.of([2, 1, 0.0], Rotation.from_rotvec([1, 0, 2.0]))
    for n_hands in range(2, 7):
        grasps = {
            f"hand{i}": Pose.of(rng.uniform(-0.3, 0.3, 3), Rotation.random(random_state=i))
            for i in range(n_hands)
        }
        row = [n_hands]
        for pace in (1.0, 2.0, 0.5):
            dmp = CooperativeDMP(load, grasps)
            state, off, turned, k = dmp.initial_state(), 0.0, 0.0, 0
            while state.progress < 1.0:
                stopped = state.progress > 0.4 and k % 7 == 0
                state = dmp.step(state, 0.01, rate=0.0 if stopped else pace)
                if 0.5 <= state.progress < 0.5 + 0.0025 * pace:
                    state = dmp.redirected(state, goal)
                poses, k = dmp.poses(state), k + 1
                first = poses["hand0"].rotation.inv()
                held = grasps["hand0"].rotation.inv()
                for name, grasp in grasps.items():
                    away = first.apply(poses[name].position - poses["hand0"].position)
                    off = max(
                        off, np.linalg.norm(away - held.apply(grasp.position - grasps["hand0"].position))
                    )
                    relative = (first * poses[name].rotation) * (held * grasp.rotation).inv()
                    turned = max(turned, relative.magnitude())
            end = dmp.load.pose(state.parts[""])
            row.append(
                f"{off:.0e} m, {turned:.0e} rad; goal {np.abs(end.position - goal.position).max():.0e} m"
            )
        rows.append(row)
    print_table(["hands", "recorded pace", "double", "half"], rows)


RECORDING = """
import re, sys, time
started = time.perf_counter()
from comove.dmp.demonstrations import Demonstration, segment
from comove.dmp import DMP
recording = Demonstration.load(sys.argv[1])
read = time.perf_counter()
parts = segment(recording)
cut = time.perf_counter()
dmps = [DMP.fit(part, n_basis=20) for part in parts]
done = time.perf_counter()
peak = int(re.search(r"VmHWM:\\s+(\\d+)", open("/proc/self/status").read())[1]) / 1024  # its own, not its parent's
print(len(parts), read - started, cut - read, done - cut, done - started, peak)
"""


def recording() -> None:
    """Measure a long recording of reaches with pauses."""
    n_reaches, n_samples = 250, 4000
    rng, s = np.random.default_rng(0), np.clip(np.linspace(-0.25, 1.25, n_samples), 0, 1)
    way = minimum_jerk(s)[:, None]
    corners = rng.uniform(-0.5, 0.5, (n_reaches + 1, 3))
    position = np.concatenate([a + way * (b - a) for a, b in zip(corners, corners[1:], strict=False)])
    position += 1e-4 * rng.standard_normal(position.shape)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "long.csv"
        table = np.column_stack([np.arange(len(position)) / 1000.0, position])
        np.savetxt(path, table, delimiter=",", header="time,x,y,z", comments="", fmt="%.9f")
        done = subprocess.run(
            [sys.executable, "-c", RECORDING, path], capture_output=True, text=True, check=True
        )
    parts, *rest = done.stdout.split()
    read, cut, fitted, whole, peak = map(float, rest)
    header = [
        "samples",
        "reaches",
        "found",
        "imported and read [s]",
        "segmented [s]",
        "fitted [s]",
        "together [s]",
    ]
    times = [f"{value:.2f}" for value in (read, cut, fitted, whole)]
    print_table([*header, "peak [MiB]"], [[len(position), n_reaches, parts, *times, f"{peak:.0f}"]])


SECTIONS = {f.__name__: f for f in (handwriting, execution, rollouts, rigid_load, recording)}


def main() -> None:
    """Measure and print the tables."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--only", nargs="+", choices=SECTIONS, default=list(SECTIONS))
    for name in parser.parse_args().only:
        print(f"\n## {name.replace('_', ' ')}\n")
        started = time.perf_counter()
        SECTIONS[name]()
        print(f"\n({time.perf_counter() - started:.0f} s)", flush=True)


if __name__ == "__main__":
    on_one_thread()
    main()
