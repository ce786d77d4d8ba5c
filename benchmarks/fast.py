"""Shortest durations by least time and other methods.

The limits are 1 m/s, 1 m/s^2 and 5 m/s^3.

    python benchmarks/fast.py

Rows: least time; least jerk, made as fast as the limits allow; the paper's cost, likewise; Drake's
`KinematicTrajectoryOptimization` from the path of the first, for least duration, scaled in time until the largest
sampled speed, acceleration or jerk of an end effector is its limit; TOPP-RA on the path of the first (limits of
speed and acceleration only, by the end effectors' axes; without jerk); RoboPlan's parametrisation, likewise, the
shortest of its splines through 10, 20, 50 and 200 points, and of straight pieces whose corners it blends up to 1 cm
off the path; and Ruckig's straight motion of the end effector with the longest path, ignoring obstacles: a lower
bound. Durations [s] hold at every instant for the first three.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from contextlib import suppress

import numpy as np
from timing import by_toppra, on_one_thread, peer, print_table

import comove
from comove import LeastJerk, LeastTime, PaperCost
from comove.lab.examples import example_path
from comove.lab.peers.common import clearances
from comove.lab.peers.drake import Drake
from comove.lab.systems import Offers, SystemProblem
from comove.model import CoordinatedMotion

LIMITS = {"speed": 1.0, "acceleration": 1.0, "jerk": 5.0}
NAMES = ("narrow", "complex", "window", "triangle")
N_PATH = 200  # points of the path that TOPP-RA gets
N_SAMPLES = 2001  # of Drake's splines
DRAKE_BUDGET = 120.0  # s


def main() -> None:
    """Solve and print."""
    argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    ).parse_args()
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
        for words, blended in (("RoboPlan, splines", False), ("RoboPlan, corners blended", True)):
            rows.setdefault(words, []).append(roboplan_duration(path, blended))
        rows.setdefault("Drake, from its path", []).append(drake_duration(path))
        way = float(np.linalg.norm(scene.goal - scene.start, axis=1).max())
        rows.setdefault("Ruckig, straight through obstacles", []).append(ruckig_duration(way))
    print_table(("s (found within)", *NAMES), [[words, *told] for words, told in rows.items()])


def toppra_duration(motion: CoordinatedMotion) -> str:
    """Return the shortest duration of a path by TOPP-RA, within limits."""
    n_dims, n = motion.scene.n_dims, motion.scene.start.size
    share = np.full(n, 1.0 / np.sqrt(n_dims))  # of a hand's limit, that each of its axes may use
    hands = motion.hands(np.linspace(0.0, 1.0, N_PATH))[0].reshape(N_PATH, n)
    found = by_toppra(hands, share * LIMITS["speed"], share * LIMITS["acceleration"])()
    return "-" if found is None else f"{found.duration:.3f}"


def roboplan_duration(motion: CoordinatedMotion, blended: bool) -> str:
    """Return the shortest duration of a path by RoboPlan. The robot's joints are the end effectors' axes."""
    core, timing = peer("roboplan.core"), peer("roboplan.toppra")
    n, share = motion.scene.start.size, 1.0 / np.sqrt(motion.scene.n_dims)  # as for TOPP-RA
    axes = "".join(
        f'<link name="l{i + 1}"/><joint name="j{i}" type="prismatic"><parent link="l{i}"/><child link="l{i + 1}"/>'
        f'<limit lower="-9" upper="9" effort="1" velocity="{share * LIMITS["speed"]}"/></joint>'
        for i in range(n)
    )
    model = core.loadUrdfSceneDescriptionFromXml(f'<robot name="axes"><link name="l0"/>{axes}</robot>')
    scene = core.Scene("axes", model)
    with tempfile.NamedTemporaryFile("w", suffix=".yaml") as file:
        file.write("joint_limits:\n")
        file.writelines(
            f"  j{i}: {{max_acceleration: [{share * LIMITS['acceleration']}]}}\n" for i in range(n)
        )
        file.flush()
        scene.importJointLimitsFromConfig(core.loadJointLimitsConfig(file.name))
    modes = timing.SplineFittingMode
    found = []
    for n_points in (10, 20, 50, 200):
        for mode in (modes.LinearBlend,) if blended else (modes.Hermite, modes.Cubic, modes.Adaptive):
            path = core.JointPath()
            path.joint_names = [f"j{i}" for i in range(n)]
            path.positions = list(motion.hands(np.linspace(0.0, 1.0, n_points))[0].reshape(n_points, -1))
            with suppress(RuntimeError):
                law = timing.PathParameterizerTOPPRA(scene).generate(path, timing.TOPPRAOptions(mode=mode))
                found.append(law.times[-1])
    return f"{min(found):.3f}" if found else "-"


def drake_duration(motion: CoordinatedMotion) -> str:
    """Return Drake's shortest duration, from the path of a motion. Violations of distance and clearance are added."""
    solvers = peer("pydrake.solvers")
    scene = motion.scene
    problem, offers = SystemProblem(scene, budget=DRAKE_BUDGET), Offers()
    drake = Drake("drake", n_control=30, order=6)
    optimisation = drake.constrained(problem, offers)
    n, (n_hands, n_dims) = scene.start.size, scene.start.shape
    share = 1.0 / np.sqrt(n_dims)  # of a hand's limit, that each of its axes may use
    for bound, limit in (
        (optimisation.AddVelocityBounds, LIMITS["speed"]),
        (optimisation.AddAccelerationBounds, LIMITS["acceleration"]),
        (optimisation.AddJerkBounds, LIMITS["jerk"]),
    ):
        bound(np.full(n, -share * limit), np.full(n, share * limit))
    optimisation.AddPathAccelerationConstraint(np.zeros(n), np.zeros(n), 0.0)
    optimisation.AddDurationConstraint(0.5, 10.0)
    optimisation.AddDurationCost(1.0)
    s = np.linspace(0.0, 1.0, N_SAMPLES)
    programme, values = optimisation.get_mutable_prog(), drake.values(optimisation.basis(), s)
    guess = np.linalg.lstsq(values, motion.hands(s)[0].reshape(N_SAMPLES, -1), rcond=None)[0].T
    programme.SetInitialGuess(optimisation.control_points(), guess)
    programme.SetInitialGuess(optimisation.duration(), scene.duration)
    begun = time.perf_counter()
    try:
        found = solvers.SnoptSolver().Solve(programme)
    except RuntimeError:  # its own, about what is raised when time is up
        return f"- ({DRAKE_BUDGET:.0f} s)"
    spent = time.perf_counter() - begun
    hands = values @ found.GetSolution(optimisation.control_points()).T
    apart = np.abs(np.linalg.norm(np.diff(hands.reshape(-1, n_hands, n_dims), axis=1), axis=2))
    missed = np.ptp(apart, axis=0).max() if n_hands == 2 else 0.0
    least = clearances(scene, hands.reshape(-1, n_hands, n_dims)).min()
    rates = [np.diff(hands, n=k, axis=0) * (N_SAMPLES - 1) ** k for k in (1, 2, 3)]
    sizes = [np.linalg.norm(rate.reshape(len(rate), n_hands, n_dims), axis=2).max() for rate in rates]
    duration = max(
        (size / limit) ** (1 / k)
        for k, (size, limit) in enumerate(zip(sizes, LIMITS.values(), strict=True), 1)
    )
    sound = found.is_success() and least >= 0 and missed < 1e-3
    return f"{duration:.3f} ({spent:.1f} s)" + ("" if sound else f", {-1e3 * min(least, -missed):.1f} mm off")


def ruckig_duration(length: float) -> str:
    """Return the shortest straight time by Ruckig (Berscheid and Kroeger, 2021)."""
    ruckig = peer("ruckig")
    asked, found = ruckig.InputParameter(1), ruckig.Trajectory(1)
    asked.target_position = [length]
    asked.max_velocity, asked.max_acceleration = [LIMITS["speed"]], [LIMITS["acceleration"]]
    asked.max_jerk = [LIMITS["jerk"]]
    ruckig.Ruckig(1).calculate(asked, found)
    return f"{found.duration:.3f}"


if __name__ == "__main__":
    main()
