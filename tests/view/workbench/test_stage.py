"""Where the camera of a page stands."""

import numpy as np
import pytest

pytest.importorskip("viser", reason="the viewer is not installed: pip install 'comove[view]'")

from comove.view.workbench.stage import Stage
from tests.solved import example


@pytest.mark.parametrize("angle", np.linspace(0.0, 2 * np.pi, 7))
def test_no_robot_stands_between_the_camera_and_its_work(angle):
    scene = example("window")
    middle, away = 0.5 * (scene.lower + scene.upper), np.array([np.cos(angle), np.sin(angle), 0.0])
    home = np.zeros((7, 7))
    home[:, :3] = middle + 2.0 * away
    position, _, _ = Stage(None, scene, robot=((), home)).camera()
    way = (scene.goal - scene.start).mean(axis=0)
    across = abs(np.cross(way / np.linalg.norm(way), away)[2])
    if across > 0.6:  # else it stands at an end of the way, aside of both places of the camera
        assert (position - middle) @ away < 0
