"""
A plate round a corner
======================

Loads in the plane may be polygons. This one is held at two places and goes round a corner in which it has to turn.
"""

import comove
from comove.view.figures import draw_motion, save

scene = comove.Scene.from_dict(
    {
        "name": "corner",
        "duration": 8.0,  # s
        "workspace": {"lower": [0, 0], "upper": [1, 1]},  # m
        "load": {
            "shape": "polygon",
            "vertices": [[-0.15, -0.05], [0.15, -0.05], [0.15, 0.05], [-0.05, 0.05], [-0.15, 0.12]],
            "grasps": {"left": [-0.12, 0.0], "right": [0.12, 0.0]},
        },
        "obstacles": [
            {"shape": "box", "center": [0.35, 0.35], "size": [0.7, 0.1]},
            {"shape": "circle", "center": [0.8, 0.75], "radius": 0.06},
        ],
        "manipulators": [
            {"name": "left", "start": [0.13, 0.15], "goal": [0.13, 0.7]},
            {"name": "right", "start": [0.37, 0.15], "goal": [0.37, 0.7]},
        ],
        "limits": {"clearance": 0.005},
    }
)
solution = comove.solve(scene, seed=0)
print("verified:", solution.verified, f"- {1e3 * solution.report.clearance_min:.1f} mm from everything")
save(draw_motion(solution.attempt), "corner.png")
