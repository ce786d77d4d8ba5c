"""Sizes of obstacles and payload in datasets, against the extents of points on their surfaces."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from comove import Scene
from comove.data.datasets.sizes import obstacle_names, obstacle_sizes, payload_size

TURN = [0.5, 0.5, 0.5, 0.5]
SHAPES = {
    "box": ({"shape": "box", "size": [0.1, 0.2, 0.3]}, [0.1, 0.2, 0.3]),
    "sphere": ({"shape": "sphere", "radius": 0.1}, [0.2, 0.2, 0.2]),
    "capsule": ({"shape": "capsule", "radius": 0.1, "length": 0.3}, [0.2, 0.2, 0.5]),
    "cylinder": ({"shape": "cylinder", "radius": 0.1, "height": 0.3}, [0.2, 0.2, 0.3]),
    "ellipsoid": ({"shape": "ellipsoid", "radii": [0.1, 0.2, 0.3]}, [0.2, 0.4, 0.6]),
    "mesh": ({"shape": "mesh", "file": "body.obj"}, [0.1, 0.2, 0.3]),
}


def scene(folder, obstacles, load=None):
    hands = [("left", -0.1), ("right", 0.1)]
    return Scene.from_dict(
        {
            "name": "sizes",
            "workspace": {"lower": [-2, -2, -2], "upper": [2, 2, 2]},
            "load": load or {"shape": "bar", "length": 0.2, "radius": 0.01, "overhang": 0.05},
            "manipulators": [{"name": n, "start": [x, -1, 0], "goal": [x, 1, 0]} for n, x in hands],
            "constraints": [{"type": "upright"}],
            "obstacles": obstacles,
        },
        folder=folder,
    )


@pytest.mark.parametrize("shape", SHAPES)
def test_extents_along_own_axes(shape, tmp_path):
    corners = (np.array(list(np.ndindex(2, 2, 2))) - 0.5) * [0.1, 0.2, 0.3]
    faces = ("1 2 4 3", "5 7 8 6", "1 5 6 2", "3 4 8 7", "1 3 7 5", "2 6 8 4")
    lines = [f"v {x} {y} {z}" for x, y, z in corners] + [f"f {face}" for face in faces]
    (tmp_path / "body.obj").write_text("\n".join(lines) + "\n")
    given, extents = SHAPES[shape]
    placed = given | {"center": [1, 0, 0]}
    if shape != "sphere":
        placed["quaternion_wxyz"] = TURN
    [[own]] = obstacle_sizes(scene(tmp_path, [placed]), np.zeros(1))
    assert np.allclose(own[:3], extents, atol=1e-9)
    assert np.allclose(own[3:], [1, 0, 0, 0] if shape == "sphere" else TURN)


def test_obstacles_that_turn_say_how_they_are_turned(tmp_path):
    turn = {"rate_deg_per_s": 90, "axis": [0, 0, 3]}
    box = {"shape": "box", "size": [0.1, 0.2, 0.3], "center": [1, 0, 0], "quaternion_wxyz": TURN}
    [own] = obstacle_sizes(scene(tmp_path, [box | {"motion": {"turn": turn}}]), np.array([0.0, 1.0]))
    w, *xyz = TURN
    x, y, z, w = (Rotation.from_euler("z", 90, degrees=True) * Rotation.from_quat([*xyz, w])).as_quat()
    assert np.allclose(own, [[0.1, 0.2, 0.3, *TURN], [0.1, 0.2, 0.3, w, x, y, z]])


@pytest.mark.parametrize(
    ("load", "size"),
    [
        (None, [0.32, 0.02, 0.02]),
        ({"shape": "box", "size": [0.2, 0.1, 0.3]}, [0.2, 0.1, 0.3]),
    ],
)
def test_the_payload(load, size, tmp_path):
    assert np.allclose(payload_size(scene(tmp_path, [], load)), size)


def test_names_differ(tmp_path):
    ball = {"shape": "sphere", "radius": 0.05, "center": [1, 0, 0]}
    given = scene(tmp_path, [ball | {"name": "obstacle1"}, ball, ball | {"name": "post"}])
    names = obstacle_names(given)
    assert len(set(names)) == 3 and names[2] == "post"
