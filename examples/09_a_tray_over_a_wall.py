"""
A tray that stays level
=======================

Two hands carry a tray over a wall. It may turn about the vertical only: the search has no coordinate in which it
could tilt.
"""

import comove
from comove.view.figures import draw_motion, save

scene = comove.Scene.from_dict(
    {
        "name": "tray",
        "duration": 6.0,  # s
        "workspace": {"lower": [0, 0, 0], "upper": [1.2, 1, 1]},  # m
        "load": {
            "shape": "box",
            "size": [0.3, 0.4, 0.02],
            "grasps": {"left": [0, 0.2, 0], "right": [0, -0.2, 0]},
        },
        "constraints": [{"type": "upright"}],
        "obstacles": [{"shape": "box", "center": [0.6, 0.5, 0.2], "size": [0.05, 1.0, 0.4]}],
        "manipulators": [
            {"name": "left", "start": [0.2, 0.7, 0.2], "goal": [1.0, 0.7, 0.2]},
            {"name": "right", "start": [0.2, 0.3, 0.2], "goal": [1.0, 0.3, 0.2]},
        ],
        "limits": {"speed": 1.0, "clearance": 0.02},
    }
)
solution = comove.solve(scene, seed=0)
heights = solution.trajectory.position[:, :, 2]
print(
    "verified:",
    solution.verified,
    f"- the hands' heights differ by {abs(heights[:, 0] - heights[:, 1]).max():.1e} m",
)
save(draw_motion(solution.attempt), "tray.png")
