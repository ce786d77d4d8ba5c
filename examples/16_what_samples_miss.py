"""
What samples miss
=================

An end effector crosses a thin wall between two samples: at every sample it is clear. The curve
fails the verification.
"""

import numpy as np

import comove
from comove.dmp import motion_basis
from comove.model import CoordinatedMotion, load_coordinates
from comove.view.figures import draw_motion, save

scene = comove.Scene.from_dict(
    {
        "name": "thin-wall",
        "duration": 2.0,  # s
        "workspace": {"lower": [0, 0], "upper": [1, 1]},  # m
        "obstacles": [{"shape": "box", "center": [0.503, 0.5], "size": [0.0005, 0.6]}],
        "manipulators": [{"name": "hand", "start": [0.1, 0.5], "goal": [0.9, 0.5]}],
    }
)
coordinates, basis = load_coordinates(scene), motion_basis(16, "jerk")
weights = np.zeros((coordinates.n_columns, basis.n_basis))
straight = CoordinatedMotion(scene, coordinates, basis, coordinates.boundary(), weights)
samples = straight.trajectory(201).position[:, 0]
print(f"nearest at 201 samples: {1e3 * abs(samples[:, 0] - 0.503).min() - 0.25:.1f} mm from the wall")
verdict = comove.verify(straight)
print("verified:", "yes" if verdict.verified else "no -", *verdict.reasons)
save(draw_motion(straight), "thin_wall.png")
