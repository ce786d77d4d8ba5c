"""Baxter carries a stick between two posts that are nearer to each other than the stick is long."""

from functools import lru_cache

import numpy as np

from comove.robots import JointMotion
from comove.scenes import Scene
from tests.robots.known_path import DISTANCE, DURATION, hands, known_motion

GAP = 0.30  # m between the posts
OVERHANG = 0.03  # m
RADIUS = 0.012  # m


@lru_cache(maxsize=4)
def posts(gap: float = GAP, mass: float | None = None) -> Scene:
    """Two posts on a table, the stick to be carried between them."""
    start, goal = hands([0.0])[0, :, :3, 3], hands([DURATION])[0, :, :3, 3]
    load = {"shape": "bar", "length": DISTANCE, "radius": RADIUS, "overhang": OVERHANG}
    return Scene.from_dict(
        {
            "name": "posts",
            "duration": DURATION,
            "workspace": {"lower": [0.0, -1.0, -0.15], "upper": [1.2, 1.0, 0.8]},
            "obstacles": [
                {"shape": "box", "center": [0.68, 0.0, -0.17], "size": [0.7, 1.6, 0.04]},
                *(
                    {
                        "shape": "cylinder",
                        "center": [0.58 + side * (gap / 2 + 0.03), 0.0, 0.0],
                        "radius": 0.03,
                        "height": 0.3,
                    }
                    for side in (-1, 1)
                ),
            ],
            "load": load if mass is None else {**load, "mass": mass},
            "manipulators": [
                {"name": name, "start": start[i].tolist(), "goal": goal[i].tolist()}
                for i, name in enumerate(("left", "right"))
            ],
            "constraints": [{"type": "same_height", "between": ["left", "right"]}],
            "grasp": {"orientation": "down", "yaw": "load"},
            "robot": "baxter",
        }
    )


def standing(duration: float = 0.5):
    """Baxter holding still at the start."""
    robot, motion = known_motion()
    time = np.linspace(0.0, duration, 11)
    return robot, JointMotion(time, motion.joint_names, np.repeat(motion.position[:1], 11, axis=0))
