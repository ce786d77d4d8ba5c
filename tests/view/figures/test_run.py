"""Films of executions: they last as long as these, and show where things are, found by their colours."""

import numpy as np
import pytest
from matplotlib.colors import to_rgb
from PIL import Image
from scipy.spatial.transform import Rotation

from comove.control import Executor
from comove.model import Scene
from comove.view.figures.motion import MovingBorders
from comove.view.figures.run import animate_run, moving_scene
from comove.view.figures.style import COLOURS, MOVING, new_figure
from tests.meshes import l_profile, write_obj

DRIFTS = {"shape": "circle", "center": [0.5, 0.8], "radius": 0.08, "motion": {"velocity": [0.0, -0.05]}}


@pytest.fixture(scope="module")
def record():
    data = {
        "name": "drifting",
        "duration": 4.0,
        "workspace": {"lower": [0, 0], "upper": [1, 1]},
        "obstacles": [DRIFTS],
        "load": {"shape": "bar", "length": 0.1},
        "manipulators": [
            {"name": "low", "start": [0.2, 0.2], "goal": [0.7, 0.2]},
            {"name": "high", "start": [0.2, 0.3], "goal": [0.7, 0.3]},
        ],
        "limits": {"speed": 1.0},
    }
    return Executor(Scene.from_dict(data), seed=0).run(10.0)


def frames_of(path):
    """Pictures, (n, height, width, 3), and how long each is shown [ms]."""
    with Image.open(path) as film:
        frames, shown = [], []
        for k in range(film.n_frames):
            film.seek(k)
            frames.append(np.asarray(film.convert("RGB")).astype(int))
            shown.append(film.info["duration"])
    return np.array(frames), np.array(shown)


def pixels_of(frame, colour):
    """Pixels of about a colour, (n, 2): across and down."""
    off = np.abs(frame - 255 * np.array(to_rgb(colour))).max(axis=-1)
    return np.argwhere(off < 25)[:, ::-1]


def test_a_film_lasts_as_long_as_the_execution(record, tmp_path):
    animate_run(record, tmp_path / "run.gif")
    frames, shown = frames_of(tmp_path / "run.gif")
    assert len(frames) == len(shown) <= 240
    assert shown.sum() == pytest.approx(1000 * record.time[-1], abs=10)


def test_obstacles_go_on_once_an_execution_is_over(record):
    move = moving_scene(new_figure(1, 1).add_subplot(), record, (0, 1), trail=1.0)
    end = record.time[-1]
    places = [move(time)[0].get_paths()[0].vertices.mean(axis=0) for time in (end - 0.5, end, end + 1.0)]
    np.testing.assert_allclose(places[1] - places[0], [0.0, -0.025], atol=1e-3)
    np.testing.assert_allclose(places[2] - places[1], [0.0, -0.05], atol=1e-3)


def test_what_moves_is_drawn_where_it_is_in_one_piece_a_state(tmp_path):
    corners, faces = l_profile()
    write_obj(tmp_path / "profile.obj", corners, faces)
    motion = {"velocity": [0.03, -0.04, 0.02], "turn": {"rate_deg_per_s": 45, "axis": [0, 1, 0]}}
    mesh = {"shape": "mesh", "file": "profile.obj", "center": [0.5, 0.6, 0.4], "motion": motion}
    hands = [{"name": n, "start": [0.2, y, 0.4], "goal": [0.8, y, 0.4]} for n, y in (("a", 0.2), ("b", 0.4))]
    scene = Scene.from_dict(
        {
            "name": "profile",
            "duration": 4.0,
            "workspace": {"lower": [0.0] * 3, "upper": [1.0] * 3},
            "obstacles": [mesh],
            "load": {"shape": "bar", "length": 0.2},
            "manipulators": hands,
        },
        folder=tmp_path,
    )
    assert len(scene.obstacles) > 1
    moved, view = np.array([[0.7, 0.3, 0.5]]), (2, 0)
    axes = new_figure(1, 1).add_subplot()
    drawn = MovingBorders(scene, view).draw(axes, scene.obstacles_at(2.0, moved), 0.5)
    assert list(axes.collections) == [drawn]
    reached = np.concatenate([path.vertices for path in drawn.get_paths()])
    turned = Rotation.from_rotvec([0.0, np.pi / 2, 0.0]).apply(corners)
    seen = (turned + moved[0])[:, view]
    # Parts are up to 2 mm thicker than the mesh.
    np.testing.assert_allclose(reached.min(axis=0), seen.min(axis=0), atol=2e-3)
    np.testing.assert_allclose(reached.max(axis=0), seen.max(axis=0), atol=2e-3)


def test_a_film_shows_where_things_are(record, tmp_path):
    """Half a metre in pixels follows from the way of a hand, and the obstacle's way in pixels from that."""
    animate_run(record, tmp_path / "run.gif")
    frames, _ = frames_of(tmp_path / "run.gif")
    first, last = frames[0], frames[-1]
    assert (first[:, :5] == last[:, :5]).all()  # what stands is the same
    half = np.diff([pixels_of(frame, COLOURS[0])[:, 0].max() for frame in (first, last)])[0]
    assert half > 50
    pale = 1.0 - 0.6 * (1.0 - np.array(to_rgb(MOVING)))
    way = pixels_of(last, pale).mean(axis=0) - pixels_of(first, pale).mean(axis=0)
    np.testing.assert_allclose(way, [0.0, 0.05 * record.time[-1] * 2 * half], atol=3.0)
