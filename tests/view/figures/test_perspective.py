"""The view in perspective: bodies are where they are, whole, and turned outwards."""

import numpy as np
import pytest

from comove.model import Scene
from comove.view.figures import draw_motion
from comove.view.figures.perspective import _obstacles
from comove.view.figures.shapes import hull_faces
from tests import brute_force
from tests.solved import example, solved

SHAPES = {
    "box": {"shape": "box", "size": [0.2, 0.3, 0.1], "quaternion_wxyz": [0.8, 0.6, 0, 0]},
    "sphere": {"shape": "sphere", "radius": 0.1},
    "capsule": {"shape": "capsule", "radius": 0.05, "length": 0.2, "quaternion_wxyz": [0.8, 0, 0.6, 0]},
    "cylinder": {"shape": "cylinder", "radius": 0.08, "height": 0.2, "quaternion_wxyz": [0.6, 0, 0, 0.8]},
    "ellipsoid": {"shape": "ellipsoid", "radii": [0.05, 0.1, 0.15]},
}


@pytest.mark.parametrize("shape", SHAPES)
def test_faces_lie_on_their_body(shape):
    scene = Scene.from_dict(
        {
            "name": "one",
            "duration": 1.0,
            "workspace": {"lower": [0, 0, 0], "upper": [1, 1, 1]},
            "obstacles": [{**SHAPES[shape], "center": [0.5, 0.5, 0.5]}],
            "manipulators": [{"name": "hand", "start": [0.05, 0.05, 0.05], "goal": [0.95, 0.05, 0.05]}],
        }
    )
    (faces,) = _obstacles(scene)
    corners = faces.reshape(-1, 3)
    distance = brute_force.obstacle_distance(scene.file.obstacles[0], corners)
    assert np.abs(distance).max() < 2e-3
    centre, normal = faces.mean(axis=1), np.cross(faces[:, 1] - faces[:, 0], faces[:, 2] - faces[:, 0])
    assert ((centre - 0.5) * normal).sum(axis=1).min() >= -1e-12


def test_points_in_a_plane_have_no_faces():
    assert len(hull_faces(np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0.0]]))) == 0


def test_spatial_motions_are_seen_in_perspective_and_along_the_axes():
    figure = draw_motion(solved("window").attempt)
    names = [axes.name for axes in figure.axes]
    assert names.count("3d") == 1
    assert len(names) == 6  # with speed and acceleration
    assert all(axes.name != "3d" for axes in draw_motion(solved("wide").attempt).axes)


def test_what_reaches_beyond_the_border_is_cut_off():
    scene = example("window")
    for faces in _obstacles(scene):
        assert (faces >= scene.lower - 1e-12).all() and (faces <= scene.upper + 1e-12).all()
