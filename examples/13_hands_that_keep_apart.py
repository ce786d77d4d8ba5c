"""
Free hands that keep apart
==========================

Two hands carry nothing and change places. They must never come nearer to each other than 25 cm.
"""

import numpy as np

import comove
from comove.view.figures import draw_motion, save

scene = comove.Scene.from_dict(
    {
        "name": "changing-places",
        "duration": 5.0,  # s
        "workspace": {"lower": [0, 0], "upper": [1, 1]},  # m
        "obstacles": [],
        "constraints": [{"type": "separation", "between": ["left", "right"], "distance": 0.25}],
        "manipulators": [
            {"name": "left", "start": [0.2, 0.5], "goal": [0.8, 0.52]},
            {"name": "right", "start": [0.8, 0.48], "goal": [0.2, 0.5]},
        ],
    }
)
solution = comove.solve(scene, seed=0)
left, right = np.moveaxis(solution.trajectory.position, 1, 0)
print(
    "verified:",
    solution.verified,
    f"- nearest at the samples: {np.linalg.norm(left - right, axis=1).min():.3f} m",
)
save(draw_motion(solution.attempt), "changing_places.png")
