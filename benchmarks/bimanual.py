"""Compared systems [7] and [8] in the situations of their sources.

    python benchmarks/bimanual.py [--humans 10] [--first 100] [--cycles 100] [--epochs 20]

[7], a coupling learned over epochs: two end effectors on one bar without obstacles, each with another demonstration
(LASA handwriting), so that they begin uncoordinated; the leader is varied. Root mean square error of the distance by
epoch, and mean distance of the end effectors' centre from each own demonstration.

[8], stiffness learned with a human: cycles with simulated humans who vary their path everywhere but in the middle
fifth. Medians over the humans: force, deviation, duration of a cycle, and the stiffness across the path where she is
precise and where she varies.
"""

from __future__ import annotations

import argparse
import warnings

import numpy as np
from timing import on_one_thread, print_table

import comove
from comove.lab.compared import LeaderFollower
from comove.lab.compared.speed_scaled import SpeedScaled
from comove.lab.paper.jobs import scene_of
from comove.model.adaptation import carried_to_hands
from comove.model.coordinates import arms_coordinates
from comove.planning.objective import Objective
from comove.planning.search import Search

PAIRS = (("Sine", "Angle"), ("Sshape", "Sine"), ("Worm", "CShape"))
SHOWN_EPOCHS, SHOWN_CYCLES = (1, 2, 4, 8, 20), (1, 2, 5, 10, 20, 50, 100)


def main() -> None:
    """Run both and print the tables."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--humans", type=int, default=10)
    parser.add_argument("--first", type=int, default=100, help="seed of the first human")
    parser.add_argument("--cycles", type=int, default=100)
    parser.add_argument("--epochs", type=int, default=20)
    asked = parser.parse_args()
    on_one_thread()
    warnings.simplefilter("ignore")
    coupling(asked.epochs)
    print()
    cooperation(range(asked.first, asked.first + asked.humans), asked.cycles)


def coupling(epochs: int) -> None:
    """Print the results of coupling differently demonstrated end effectors."""
    scene, s = scene_of("open"), np.linspace(0.0, 1.0, 201)
    roles = {
        "left leads": LeaderFollower(epochs=epochs),
        "right leads": LeaderFollower(epochs=epochs, leader="right"),
        "both follow": LeaderFollower(epochs=epochs, mutual=True),
    }
    rows = []
    for names in PAIRS:
        taught = [comove.DMP.fit(comove.Demonstration.from_lasa(name)) for name in names]
        by_hand = [carried_to_hands(dmp, scene).mean(axis=1) for dmp in taught]
        for role, method in roles.items():
            found = comove.solve(
                scene, demonstration=dict(zip(scene.manipulators, taught, strict=True)), method=method
            )
            rms = found.log["epoch_error_rms_m"]
            middle = found.attempt.hands(s)[0].mean(axis=1)
            off = [1e3 * np.linalg.norm(middle - own, axis=1).mean() for own in by_hand]
            rows.append(
                [
                    f"{names[0]}, {names[1]}",
                    role,
                    *(f"{1e3 * rms[i - 1]:.3g}" for i in SHOWN_EPOCHS if i <= len(rms)),
                    *(f"{x:.0f}" for x in off),
                    "yes" if found.verified else "no",
                ]
            )
    head = ["taught left, right", "roles", *(f"epoch {i} [mm]" for i in SHOWN_EPOCHS if i <= epochs)]
    print_table([*head, "from left's way [mm]", "from right's way [mm]", "verified"], rows)


def cooperation(humans: range, cycles: int) -> None:
    """Print effort, deviation and stiffness over the cycles."""
    scene, method = scene_of("open"), SpeedScaled(cycles=cycles)
    objective = Objective(scene, arms_coordinates(scene))
    found = []
    for seed in humans:
        search = Search(objective, None, True, np.random.default_rng(seed))
        found.append(list(method.cooperate(search)))
    s = np.linspace(0.0, 1.0, len(found[0][0][0].slowness))
    low, high = method.human.precise
    precise = (s > low + 0.04) & (s < high - 0.04)
    varied = ((s > low - 0.15) & (s < low - 0.04)) | ((s > high + 0.04) & (s < high + 0.15))
    rows = []
    for i in SHOWN_CYCLES:
        if i > cycles:
            continue
        done = [cooperated[i - 1] for cooperated in found]
        stiff = [skill.stiffness(method.laws)[:, :, 1] for skill, _ in done]
        rows.append(
            [
                str(i),
                f"{np.median([cycle.effort for _, cycle in done]):.2f}",
                f"{1e3 * np.median([np.sqrt(np.square(c.deviation).sum(axis=2).mean()) for _, c in done]):.1f}",
                f"{np.median([cycle.duration for _, cycle in done]):.2f}",
                f"{np.median([k[precise].mean() for k in stiff]):.0f}",
                f"{np.median([k[varied].mean() for k in stiff]):.0f}",
            ]
        )
    head = [
        "cycle",
        "her force [N]",
        "deviation [mm]",
        "duration",
        "k where precise [N/m]",
        "k where she varies [N/m]",
    ]
    print_table(head, rows)


if __name__ == "__main__":
    main()
