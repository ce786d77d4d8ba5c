"""
Three hands in space
====================

Three hands carry a triangular frame over a post, and keep two centimetres away from it.
"""

import numpy as np

import comove
from comove.view.figures import draw_motion, save

corners = 0.1 * np.array([[np.cos(a), np.sin(a), 0.0] for a in np.pi / 2 + 2 * np.pi / 3 * np.arange(3)])
names = ["front", "left", "right"]
scene = comove.Scene.from_dict(
    {
        "name": "over-a-post",
        "duration": 6.0,
        "workspace": {"lower": [0, 0, 0], "upper": [1, 1, 1]},
        "obstacles": [{"shape": "cylinder", "center": [0.5, 0.5, 0.25], "radius": 0.05, "height": 0.5}],
        "load": {"shape": "frame", "edges": [["front", "left"], ["left", "right"], ["right", "front"]]},
        "manipulators": [
            {
                "name": name,
                "start": (corner + [0.2, 0.5, 0.3]).tolist(),
                "goal": (corner + [0.8, 0.5, 0.3]).tolist(),
            }
            for name, corner in zip(names, corners, strict=True)
        ],
        "limits": {"speed": 1.0, "clearance": 0.02},
    }
)
solution = comove.solve(scene, seed=1)
trajectory = solution.trajectory
apart = np.linalg.norm(trajectory.position[:, 0] - trajectory.position[:, 1], axis=1)
print("verified:", solution.verified, f"- clearance {1e3 * solution.motion.clearance_min:.1f} mm or more")
print(f"front and left stay {apart.mean():.6f} m apart, to {np.ptp(apart):.1e} m")
save(draw_motion(solution.attempt), "over_a_post.png")
