"""MuJoCo is imported when it is needed, and its absence is told."""

import subprocess
import sys

import pytest

from comove.errors import ExtraError
from comove.sim import play, simulate
from comove.sim.engine import drawing_backend, engine
from tests.sim.benchmark import posts, standing


@pytest.fixture
def without_mujoco(monkeypatch):
    monkeypatch.setitem(sys.modules, "mujoco", None)
    engine.cache_clear()
    yield
    engine.cache_clear()


def test_physics_says_what_to_install(without_mujoco):
    robot, motion = standing()
    with pytest.raises(ExtraError, match=r"simulation needs more than the core: .*'comove\[sim\]'"):
        simulate(motion, posts(), robot)


def test_geometry_needs_no_mujoco(without_mujoco):
    robot, motion = standing()
    assert play(motion, robot, posts()).delivered


def test_the_backend_is_one_that_mujoco_knows():
    assert drawing_backend() in ("egl", "osmesa", "disabled")


@pytest.mark.slow
def test_the_room_is_entered_without_mujoco():
    code = "import sys, comove.sim; assert 'mujoco' not in sys.modules and 'trimesh' not in sys.modules"
    subprocess.run([sys.executable, "-c", code], check=True)
