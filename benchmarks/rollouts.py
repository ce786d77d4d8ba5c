"""Time to roll out 1000 weight vectors of a coordinated DMP, beside a bare matrix product and a peer.

Two planar manipulators make 4 columns; T = 200 samples, N = 20 shape weights a column. Measured in one run:

- bare product: weights (4000, 20) @ basis (20, 200), the least that any linear method must do;
- comove: `CoordinatedDMP.rollouts`, positions of all rollouts in one array, both ends exact;
- movement_primitives: `DMP.open_loop` of a DMP with 4 dimensions and its defaults (Runge-Kutta in Cython),
  for a few rollouts, scaled up to 1000: it has no call for many.

Everything runs on one thread. The first two take turns; medians of the repeats are shown.

To repeat: ``pip install 'comove[bench]'`` and ``python benchmarks/rollouts.py [--repeats 101]``.
"""

from __future__ import annotations

import argparse

import numpy as np
from timing import medians, number, on_one_thread, peer, print_table

import comove
from comove.dmp import motion_basis
from comove.model import CoordinatedDMP, load_coordinates

N_ROLLOUTS, N_STEPS, N_BASIS = 1000, 200, 20
N_PEER = 20  # rollouts of the peer that are measured


def coordinated_dmp() -> CoordinatedDMP:
    """Two free manipulators in the plane, 4 columns."""
    scene = comove.Scene.from_dict(
        {
            "name": "two-free-hands",
            "duration": 10.0,
            "workspace": {"lower": [0, 0], "upper": [1, 1]},
            "manipulators": [
                {"name": "left", "start": [0.15, 0.4], "goal": [0.85, 0.4]},
                {"name": "right", "start": [0.15, 0.6], "goal": [0.85, 0.6]},
            ],
        }
    )
    coordinates, basis = load_coordinates(scene), motion_basis(N_BASIS)
    weights = np.zeros((coordinates.n_columns, N_BASIS))
    return CoordinatedDMP(scene, coordinates, basis, coordinates.boundary(), weights)


def peer_rollouts(weights: np.ndarray):
    """Return a function that rolls out each of `weights`, array of shape (n, 4, N_BASIS), with the peer."""
    dmp = peer("movement_primitives.dmp").DMP(
        n_dims=4, execution_time=1.0, dt=1.0 / (N_STEPS - 1), n_weights_per_dim=N_BASIS
    )
    dmp.configure(start_y=np.array([0.15, 0.4, 0.15, 0.6]), goal_y=np.array([0.85, 0.4, 0.85, 0.6]))

    def roll_out() -> np.ndarray:
        result = np.empty((len(weights), 4, N_STEPS))
        for i, weight in enumerate(weights):
            dmp.set_weights(weight)
            result[i] = dmp.open_loop()[1].T
        return result

    return roll_out


def main() -> None:
    """Measure and print the table."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--repeats", type=int, default=101)
    options = parser.parse_args()

    dmp = coordinated_dmp()
    weights = np.random.default_rng(0).standard_normal((N_ROLLOUTS, 4, N_BASIS))
    flat, phi = weights.reshape(-1, N_BASIS), np.ascontiguousarray(dmp.basis.sampled(N_STEPS)[:N_BASIS])
    assert dmp.rollouts(weights, N_STEPS).shape == (N_ROLLOUTS, 4, N_STEPS)
    times = medians(
        {"bare": lambda: flat @ phi, "comove": lambda: dmp.rollouts(weights, N_STEPS)}, options.repeats
    )
    times["peer"] = medians({"peer": peer_rollouts(weights[:N_PEER])}, 5)["peer"] * N_ROLLOUTS / N_PEER
    names = {
        "bare": f"bare matrix product ({4 * N_ROLLOUTS}, {N_BASIS}) @ ({N_BASIS}, {N_STEPS})",
        "comove": "comove, `CoordinatedDMP.rollouts`",
        "peer": f"movement_primitives, `DMP.open_loop` ({N_PEER} measured, scaled)",
    }
    print_table(
        ["1000 rollouts, 4 columns, T = 200, N = 20", "median [ms]", "times the product", "times comove"],
        [
            [
                name,
                number(1e3 * times[key]),
                number(times[key] / times["bare"]),
                number(times[key] / times["comove"]),
            ]
            for key, name in names.items()
        ],
    )


if __name__ == "__main__":
    on_one_thread()
    main()
