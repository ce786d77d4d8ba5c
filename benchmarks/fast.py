"""Shortest durations: least time beside other ways to make a motion fast, under 1 m/s, 1 m/s^2 and 5 m/s^3.

    python benchmarks/fast.py

Rows: least time; least jerk, made as fast as the limits allow; the paper's cost, likewise; TOPP-RA on the path of the
first (limits of speed and acceleration only, by the hands' axes; it knows no jerk); and the jerk-limited straight
motion of the hand that has farthest to go, through whatever stands there: a bound from below. Durations [s] hold at
every instant for all rows but the last two.
"""

from __future__ import annotations

import time

import numpy as np
from timing import on_one_thread, print_table

import comove
from comove import LeastJerk, LeastTime, PaperCost
from comove.experiments.examples import example_path

LIMITS = {"speed": 1.0, "acceleration": 1.0, "jerk": 5.0}
NAMES = ("narrow", "complex", "window", "triangle")
N_PATH = 200  # points of the path that TOPP-RA gets


def main() -> None:
    """Solve and print."""
    on_one_thread()
    rows: dict[str, list[str]] = {}
    for name in NAMES:
        changes = {"duration": None, "demonstration": None, "limits": LIMITS}
        scene = comove.Scene.load(example_path(name), changes)
        for words, objective in (
            ("least time", LeastTime()),
            ("least jerk", LeastJerk(room=0.0)),
            ("the paper's cost", PaperCost()),
        ):
            begun = time.perf_counter()
            solution = comove.solve(scene, objective=objective)
            spent = time.perf_counter() - begun
            told = f"{solution.scene.duration:.3f} ({spent:.1f} s)" if solution.verified else "-"
            rows.setdefault(words, []).append(told)
            if words == "least time":
                path = solution.attempt
        rows.setdefault("TOPP-RA on its path, no limit of jerk", []).append(toppra_duration(path))
        way = float(np.linalg.norm(scene.goal - scene.start, axis=1).max())
        rows.setdefault("straight, through obstacles", []).append(f"{s_curve(way, **LIMITS):.3f}")
    print_table(("s (found within)", *NAMES), [[words, *told] for words, told in rows.items()])


def toppra_duration(motion: comove.CoordinatedMotion) -> str:
    """Shortest duration of a path by TOPP-RA (Pham and Pham, 2018), no hand beyond its limits."""
    try:
        import toppra
        from toppra import algorithm, constraint
    except ImportError:
        return "-"
    toppra.setup_logging("ERROR")
    s = np.linspace(0.0, 1.0, N_PATH)
    hands = motion.hands(s)[0].reshape(N_PATH, -1)
    # At rest at both ends, the path by time has no speed there: by its own length it has.
    length = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(hands, axis=0), axis=1))])
    kept = np.concatenate([[True], np.diff(length) > 1e-6])
    path = toppra.SplineInterpolator(length[kept], hands[kept])
    share = 1.0 / np.sqrt(motion.scene.n_dims)  # of a hand's limit, that each of its axes may use
    n = hands.shape[1]
    speed = constraint.JointVelocityConstraint(np.tile([-share, share], (n, 1)) * LIMITS["speed"])
    acceleration = constraint.JointAccelerationConstraint(
        np.tile([-share, share], (n, 1)) * LIMITS["acceleration"]
    )
    found = algorithm.TOPPRA(
        [speed, acceleration], path, parametrizer="ParametrizeConstAccel"
    ).compute_trajectory()
    return "-" if found is None else f"{found.duration:.3f}"


def s_curve(length: float, speed: float, acceleration: float, jerk: float) -> float:
    """Shortest time for a straight way from rest to rest, by phases of constant jerk [s]."""

    def side(peak: float) -> float:
        if peak >= acceleration**2 / jerk:
            return peak / acceleration + acceleration / jerk
        return 2.0 * float(np.sqrt(peak / jerk))

    if speed * side(speed) <= length:
        return side(speed) + length / speed
    low, high = 0.0, speed
    for _ in range(80):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if middle * side(middle) < length else (low, middle)
    return 2.0 * side(low)


if __name__ == "__main__":
    main()
