"""Pictures without a screen show the load, and their absence hinders nothing."""

import os
import subprocess
import sys
from functools import lru_cache

import numpy as np
import pytest

from comove.errors import OptionError
from comove.sim import draw_film, draw_sheet, play
from comove.sim.engine import NO_PICTURES, drawing_backend
from comove.sim.pictures import camera
from tests.robots.known_path import known_motion
from tests.sim.benchmark import posts, standing

Image = pytest.importorskip("PIL.Image")

pytestmark = pytest.mark.skipif(drawing_backend() == NO_PICTURES, reason="neither EGL nor OSMesa")


@lru_cache(maxsize=1)
def execution():
    robot, motion = known_motion()
    return play(motion.stretched(1.0), robot, posts())


@lru_cache(maxsize=1)
def still():
    robot, motion = standing(0.2)
    return play(motion, robot, posts())


def share(picture, colour):
    """How much of a picture is nearly of a colour's hue."""
    rgb = np.asarray(picture.convert("RGB"), dtype=float)
    bright = rgb.max(axis=2) > 60
    hue = rgb / np.maximum(rgb.max(axis=2, keepdims=True), 1)
    return float((bright & (np.abs(hue - np.array(colour)).max(axis=2) < 0.12)).mean())


def test_a_picture_shows_load_posts_and_table():
    with camera(execution(), 320, 240, shadows=False) as shot:
        picture, last = (shot(step) for step in (len(execution().time) // 2, len(execution().time) - 1))
    assert picture.size == (320, 240)
    load, post, table = (1.0, 0.75, 0.1), (1.0, 0.28, 0.2), (1.0, 0.86, 0.69)
    assert 0.0005 < share(picture, load) < 0.05
    assert 0.005 < share(picture, post) < 0.3
    assert 0.1 < share(picture, table) < 0.6
    assert np.abs(np.asarray(picture, dtype=float) - np.asarray(last)).mean() > 1.0


@pytest.mark.slow
def test_a_sheet_has_a_picture_for_every_instant(tmp_path):
    draw_sheet(still(), tmp_path / "sheet.png", count=3, columns=2, width=160)
    with Image.open(tmp_path / "sheet.png") as sheet:
        assert sheet.size == (2 * 160 + 6, 2 * 120 + 6)
    assert [path.name for path in tmp_path.iterdir()] == ["sheet.png"]


@pytest.mark.slow
def test_a_film_lasts_as_long_as_the_motion(tmp_path):
    av = pytest.importorskip("av")
    path = draw_film(still(), tmp_path / "film", rate=20.0, width=160)
    assert path == tmp_path / "film.mp4"
    with av.open(str(path)) as film:
        assert [frame.time for frame in film.decode(video=0)] == [0.0, 0.05, 0.1, 0.15]


def test_a_film_without_an_encoder_is_a_gif(tmp_path, monkeypatch):
    monkeypatch.setattr("comove.sim.pictures.encodes", lambda: False)
    path = draw_film(still(), tmp_path / "film.mp4", rate=10.0, width=80)
    with Image.open(path) as picture:
        assert path.suffix == ".gif" and picture.n_frames == 2


def test_too_large_a_picture_is_refused(tmp_path):
    with pytest.raises(OptionError, match="4000 x 3000 pixels"):
        draw_sheet(still(), tmp_path / "sheet.png", width=4000)


def test_without_a_driver_it_is_told_what_to_install(tmp_path, monkeypatch):
    monkeypatch.setenv("MUJOCO_GL", "disabled")
    with pytest.raises(OptionError, match=r"neither EGL nor OSMesa.*apt-get install libegl1 libosmesa6"):
        draw_sheet(still(), tmp_path / "sheet.png")
    assert not list(tmp_path.iterdir())


@pytest.mark.slow
def test_without_a_driver_one_can_simulate_and_is_told_why_there_are_no_pictures(tmp_path):
    code = """
from comove.sim import simulate, draw_sheet
from comove.errors import OptionError
from tests.sim.benchmark import posts, standing
robot, motion = standing()
execution = simulate(motion, posts(), robot)
assert execution.delivered
try:
    draw_sheet(execution, "sheet.png")
except OptionError as error:
    print(error)
"""
    environment = {**os.environ, "MUJOCO_GL": "disabled", "PYTHONPATH": os.getcwd()}
    done = subprocess.run(
        [sys.executable, "-c", code], env=environment, capture_output=True, text=True, cwd=tmp_path
    )
    assert done.returncode == 0, done.stderr
    assert "apt-get install libegl1 libosmesa6" in done.stdout
    assert not list(tmp_path.iterdir())


@pytest.mark.slow
def test_who_imports_mujoco_first_is_told_what_to_set(tmp_path):
    code = """
import mujoco
from comove.errors import OptionError
from comove.sim import draw_sheet
from tests.sim.test_pictures import still
try:
    draw_sheet(still(), "sheet.png")
except OptionError as error:
    print(error.way_out)
"""
    environment = {k: v for k, v in os.environ.items() if k not in ("MUJOCO_GL", "DISPLAY")}
    environment["PYTHONPATH"] = os.getcwd()
    for advised in ({}, {"MUJOCO_GL": drawing_backend()}):
        done = subprocess.run(
            [sys.executable, "-c", code],
            env=environment | advised,
            capture_output=True,
            text=True,
            cwd=tmp_path,
        )
        assert done.returncode == 0, done.stderr
        told = "" if advised else f"set MUJOCO_GL={drawing_backend()} before Python starts"
        assert done.stdout.strip() == told
    assert (tmp_path / "sheet.png").exists()
