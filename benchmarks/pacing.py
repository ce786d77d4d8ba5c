"""Least time along a movement's path, beside TOPP-RA (toppra).

The first recording of each of the 30 LASA shapes is learned, 20 weights a dimension, and is to take the least time
within a share of its own largest velocity and acceleration (both limits of every coordinate):

- duration: with one pace all along, as `retime` gives, then that of comove's `slowed` and of toppra on the same path
  (a spline through 4001 samples by their length, ends at rest, grid points of its own), as ratios to the first;
- excess: the largest velocity and acceleration at 20,000 instants, as shares of the limits, less one;
- time: of one call, medians.

    python benchmarks/pacing.py [--shapes 30] [--velocity 0.5] [--acceleration 0.5]

To repeat with the peer: ``pip install 'comove[bench]'``.
"""

from __future__ import annotations

import argparse
from typing import Any

import numpy as np
from timing import by_toppra, elapsed, on_one_thread, print_table

from comove.dmp import DMP, largest, slowed
from comove.dmp.demonstrations import Demonstration, lasa_names

N_PATH = 4001
N_SEEN = 20_001


def main() -> None:
    """Print one row for each system."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--shapes", type=int, default=30)
    parser.add_argument("--velocity", type=float, default=0.5, help="share of the movement's largest")
    parser.add_argument("--acceleration", type=float, default=0.5, help="share of the movement's largest")
    asked = parser.parse_args()
    on_one_thread()
    rows: dict[str, list[tuple[float, float, float, float]]] = {}
    for name in lasa_names()[: asked.shapes]:
        dmp = DMP.fit(Demonstration.from_lasa(name))
        dmp = dmp.towards(start_velocity=np.zeros(dmp.n_dims))
        limits = tuple(
            share * most
            for share, most in zip((asked.velocity, asked.acceleration), largest(dmp), strict=True)
        )
        for system, found in (("comove, slowed", comove(dmp, *limits)), ("toppra", peer(dmp, *limits))):
            if found is not None:
                uniform = dmp.duration * max(1 / asked.velocity, np.sqrt(1 / asked.acceleration))
                rows.setdefault(system, []).append((found[0] / uniform, *found[1:]))
    table = []
    for system, values in rows.items():
        ratio, fast, hard, seconds = np.array(values).T
        table.append(
            [
                system,
                f"{np.median(ratio):.4f} ({ratio.min():.4f} to {ratio.max():.4f})",
                f"{fast.max():.1e}",
                f"{hard.max():.1e}",
                f"{1e3 * np.median(seconds):.1f} ms",
            ]
        )
    print_table(("", "duration over that at one pace", "velocity's excess", "acceleration's", "time"), table)
    if len(rows) > 1:
        ours, theirs = (np.array(values)[:, 0] for values in rows.values())
        print(f"\ncomove over toppra: {np.median(ours / theirs):.4f}, {(ours / theirs).max():.4f} at most")


def comove(dmp: DMP, velocity: np.ndarray, acceleration: np.ndarray) -> tuple[float, float, float, float]:
    """Return duration, velocity and acceleration excess, and seconds of `slowed`."""
    options: dict[str, Any] = {"velocity": velocity, "acceleration": acceleration, "pace": np.inf}
    paced = slowed(dmp, **options)
    seconds = elapsed(lambda: slowed(dmp, **options))
    time = np.linspace(0.0, paced.duration, N_SEEN)
    k = np.clip(np.searchsorted(paced.time, time, side="right") - 1, 0, len(paced.time) - 2)
    push = (np.diff(paced.speed) / np.diff(paced.time))[k]
    progress, speed = paced.progress_at(time), paced.pace_at(time) / dmp.duration
    values = np.stack([dmp.curve.at(s) for s in np.minimum(progress, 1 - 1e-12)])
    accelerations = values[:, 1] * push[:, None] + values[:, 2] * speed[:, None] ** 2
    velocities = values[:, 1] * speed[:, None]
    return (paced.duration, *_excess(velocities, accelerations, velocity, acceleration), seconds)


def peer(
    dmp: DMP, velocity: np.ndarray, acceleration: np.ndarray
) -> tuple[float, float, float, float] | None:
    """Return the same for toppra; None where not installed."""
    position = dmp.at(np.linspace(0.0, dmp.duration, N_PATH)).position
    timed = by_toppra(position, velocity, acceleration)
    found = timed()
    if found is None:
        return None
    time = np.linspace(0.0, found.duration, N_SEEN)
    return (found.duration, *_excess(found(time, 1), found(time, 2), velocity, acceleration), elapsed(timed))


def _excess(
    velocities: np.ndarray, accelerations: np.ndarray, velocity: np.ndarray, acceleration: np.ndarray
) -> tuple[float, float]:
    fast = float((np.abs(velocities) / velocity).max() - 1)
    return fast, float((np.abs(accelerations) / acceleration).max() - 1)


if __name__ == "__main__":
    main()
