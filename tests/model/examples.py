"""Scenes with every kind of block, and random movements on them."""

import numpy as np

from comove.dmp import motion_basis
from comove.model import (
    CoordinatedMotion,
    arms_coordinates,
    load_coordinates,
    projected_coordinates,
)
from comove.model.coordinates import DIRECTION
from comove.model.scene import Scene

TRIANGLE = np.array([[0.0, 0.0, 0.0], [0.2, 0.0, 0.0], [0.1, 0.15, 0.0]])
QUARTER = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
FRAME = {"shape": "frame", "edges": [["a", "b"], ["b", "c"], ["c", "a"]]}
BAR = {"shape": "bar", "length": 0.2}
PLATE = {
    "shape": "polygon",
    "vertices": [[0, 0], [0.3, 0], [0, 0.2]],
    "grasps": {"a": [0.02, 0.01], "b": [0.25, 0.01]},
}


def scene_of(start, goal, **more):
    """A scene without obstacles, of hands a, b, c .. from `start` to `goal`."""
    start, goal = np.asarray(start, dtype=float), np.asarray(goal, dtype=float)
    n_dims = start.shape[1]
    return Scene.from_dict(
        {
            "name": "test",
            "duration": 5.0,
            "workspace": {"lower": [-5.0] * n_dims, "upper": [5.0] * n_dims},
            "manipulators": [
                {"name": name, "start": s.tolist(), "goal": g.tolist()}
                for name, s, g in zip("abcdef"[: len(start)], start, goal, strict=True)
            ],
            **more,
        }
    )


PLANAR_BAR = scene_of([[0.1, 0.4], [0.1, 0.6]], [[0.9, 0.45], [1.1, 0.45]], load=BAR)
SPATIAL_BAR = scene_of(
    [[0.1, 0.4, 0.0], [0.1, 0.6, 0.0]], [[0.9, 0.4, 0.1], [0.9, 0.4, 0.3]], load={**BAR, "overhang": 0.05}
)
POLYGON = scene_of([[0.02, 0.01], [0.25, 0.01]], [[0.9, 0.5], [0.9, 0.73]], load=PLATE)
SPATIAL_TRIANGLE = scene_of(TRIANGLE, TRIANGLE @ QUARTER.T + [1.0, 0.5, 0.2], load=FRAME)
MIXED = scene_of(
    [[0.0, 0.0], [0.0, 1.0], [0.2, 0.0], [0.3, 1.0], [1.0, 0.5]],
    [[0.5, 0.0], [0.5, 1.0], [0.5, 0.2], [0.8, 1.0], [1.5, 0.0]],
    load={**BAR, "held_by": ["c", "a"]},
    constraints=[{"type": "distance", "between": ["b", "d"], "distance": 0.3}],
)
TRAY = scene_of(
    TRIANGLE + [0.0, 0.0, 0.3],
    TRIANGLE @ QUARTER.T + [1.0, 0.5, 0.8],
    load=FRAME,
    constraints=[{"type": "upright"}],
)
LEANING_BAR = scene_of(
    [[0.1, 0.4, 0.0], [0.1, 0.52, 0.16]],
    [[0.9, 0.4, 0.1], [0.78, 0.4, 0.26]],
    load={**BAR, "overhang": 0.05},
    constraints=[{"type": "upright"}],
)
PLANAR_TRAY = scene_of(
    [[0.1, 0.4], [0.26, 0.52]], [[0.9, 0.1], [1.06, 0.22]], load=BAR, constraints=[{"type": "upright"}]
)
POSE = scene_of(
    [[0.1, 0.4, 0.0], [0.1, 0.6, 0.0]],
    [[0.9, 0.4, 0.1], [0.9, 0.4, 0.3]],
    constraints=[{"type": "relative_pose", "between": ["a", "b"]}],
)
LEVEL = scene_of(
    [[0.0, 0.3, 0.2], [0.5, 0.0, 0.7], [0.0, 1.0, 0.2], [0.4, 0.4, 0.2]],
    [[1.0, 0.3, 0.9], [0.5, 1.0, 0.7], [1.0, 1.0, 0.9], [0.8, 0.1, 0.9]],
    constraints=[
        {"type": "same_height", "between": ["a", "c"]},
        {"type": "same_height", "between": ["d", "c"]},
    ],
)
PLANAR_LEVEL = scene_of(
    [[0.0, 0.3], [0.5, 0.0], [0.9, 0.3]],
    [[1.0, 0.7], [0.5, 1.0], [0.2, 0.7]],
    constraints=[{"type": "same_height", "between": ["c", "a"]}],
)
HANDS = scene_of([[0.0, 0.0, 0.0], [0.0, 1.0, 0.0]], [[1.0, 0.0, 0.0], [1.0, 1.0, 0.5]])

SCENES = {
    "angle": (PLANAR_BAR, load_coordinates),
    "angle off its middle": (POLYGON, load_coordinates),
    "planar direction": (PLANAR_BAR, projected_coordinates),
    "spatial direction": (SPATIAL_BAR, load_coordinates),
    "projected spatial": (SPATIAL_BAR, projected_coordinates),
    "quaternion": (SPATIAL_TRIANGLE, load_coordinates),
    "point": (HANDS, load_coordinates),
    "mixed": (MIXED, load_coordinates),
    "mixed projected": (MIXED, projected_coordinates),
    "upright": (TRAY, load_coordinates),
    "upright bar": (LEANING_BAR, load_coordinates),
    "planar upright": (PLANAR_TRAY, load_coordinates),
    "planar upright projected": (PLANAR_TRAY, projected_coordinates),
    "relative pose": (POSE, load_coordinates),
    "level": (LEVEL, load_coordinates),
    "level projected": (LEVEL, projected_coordinates),
    "planar level": (PLANAR_LEVEL, load_coordinates),
    "level arms": (PLANAR_LEVEL, arms_coordinates),
}


def configurations(coordinates, rng, n, spread=1.0):
    """Random q, array of shape (n, n_columns), with directions of any length but none near zero."""
    q = spread * rng.standard_normal((n, coordinates.n_columns))
    for kind, columns, *_ in coordinates.parts:
        if kind >= DIRECTION:  # or a quaternion
            turn = q[:, columns][:, coordinates.n_dims :]
            short = np.linalg.norm(turn, axis=1) < 0.2 * spread
            turn[short] += np.eye(turn.shape[1])[0] * spread
            q[:, columns.start + coordinates.n_dims : columns.stop] = turn
    return q


def random_motion(name, seed, size, n_basis=12, metric="velocity"):
    """A movement on one of `SCENES` with random shape weights."""
    scene, make = SCENES[name]
    coordinates, rng = make(scene), np.random.default_rng(seed)
    weights = size * rng.standard_normal((coordinates.n_columns, n_basis))
    boundary = coordinates.boundary(int(rng.integers(-1, 2)))
    return CoordinatedMotion(scene, coordinates, motion_basis(n_basis, metric), boundary, weights)
