"""
Carry a bar through a narrow passage
====================================

Two hands carry a bar through a passage half as wide as the bar is long.
"""

import comove
from comove.view.figures import draw_motion, save

scene = comove.Scene.from_dict(
    {
        "name": "narrow",
        "duration": 10.0,
        "workspace": {"lower": [0, 0], "upper": [1, 1]},
        "obstacles": [
            {"shape": "box", "center": [0.5, 0.225], "size": [0.1, 0.45]},
            {"shape": "box", "center": [0.5, 0.775], "size": [0.1, 0.45]},
        ],
        "load": {"shape": "bar", "length": 0.2},
        "manipulators": [
            {"name": "left", "start": [0.15, 0.4], "goal": [0.85, 0.4]},
            {"name": "right", "start": [0.15, 0.6], "goal": [0.85, 0.6]},
        ],
        "limits": {"speed": 1.0, "acceleration": 2.0},
    }
)
solution = comove.solve(scene, seed=0)
print("verified:", solution.verified)
print(f"clearance at every instant: {1e3 * solution.motion.clearance_min:.1f} mm or more")
print(f"first verified motion after {1e3 * solution.effort.first_verified:.1f} ms")
save(draw_motion(solution.attempt), "narrow.png")
