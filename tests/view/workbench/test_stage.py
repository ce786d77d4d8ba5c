"""Where the camera of a page stands, and where obstacles are drawn."""

from types import SimpleNamespace

import numpy as np
import pytest

pytest.importorskip("viser", reason="the viewer is not installed: pip install 'comove[view]'")

from comove.geometry.distances import point_distance
from comove.geometry.rotations import matrices
from comove.model import Scene
from comove.view.workbench.geometry import obstacle_surfaces
from comove.view.workbench.stage import DrawnRobot, Stage
from tests.solved import example


@pytest.mark.parametrize("angle", np.linspace(0.0, 2 * np.pi, 7))
def test_no_robot_stands_between_the_camera_and_its_work(angle):
    scene = example("window")
    middle, away = 0.5 * (scene.lower + scene.upper), np.array([np.cos(angle), np.sin(angle), 0.0])
    home = np.zeros((7, 7))
    home[:, :3] = middle + 2.0 * away
    position, _, _ = Stage(None, scene, robot=DrawnRobot((), home)).camera()
    way = (scene.goal - scene.start).mean(axis=0)
    across = abs(np.cross(way / np.linalg.norm(way), away)[2])
    if across > 0.6:  # else it stands at an end of the way, aside of both places of the camera
        assert (position - middle) @ away < 0


def test_obstacles_that_turn_are_drawn_turned():
    """Points of a door's surface, at its handle's pose in a state, are on the border of the door there."""
    turn = {"rate_deg_per_s": 90, "axis": [0, 0, 1], "hinge": [-0.2, 0, 0]}
    door = {"shape": "box", "center": [0.5, 0.5, 0.9], "size": [0.4, 0.05, 0.1], "motion": {"turn": turn}}
    scene = Scene.from_dict(
        {
            "name": "door",
            "duration": 4.0,
            "workspace": {"lower": [0, 0, 0], "upper": [1, 1, 1]},
            "obstacles": [door],
            "manipulators": [{"name": "a", "start": [0.1, 0.1, 0.1], "goal": [0.9, 0.1, 0.1]}],
        }
    )
    stage, handle = Stage(None, scene), SimpleNamespace(position=None, wxyz=None)
    stage.obstacles = [handle]
    stage._move_obstacles([0], scene.offsets(np.array([1.5]))[0], 1.5)
    (surface,) = obstacle_surfaces(scene)
    points = np.array(handle.position) + surface.vertices @ matrices(np.array(handle.wxyz)).T
    table = scene.obstacles_at(1.5)
    apart = [point_distance(table, 0, *point) for point in points]
    np.testing.assert_allclose(apart, 0.0, atol=1e-6)
