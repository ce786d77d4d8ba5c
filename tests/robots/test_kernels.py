"""The robot that stands in for all others while kernels are loaded."""

import subprocess
import sys
from pathlib import Path

import pytest

LOADED = """
import comove
from comove.compiled.counting import compiling
from comove.planning.kernels import SceneKind
from comove.robots import Robot
from comove.robots.kernels import load_robot_kernels
from comove.model import Scene

scene = Scene.load("examples/%s.yaml")
load_robot_kernels(SceneKind.of(scene))
with compiling(print):
    assert comove.solve(scene, robot=Robot.load(scene.file.robot)).verified
"""


@pytest.mark.slow
@pytest.mark.parametrize(
    "scene", ["baxter/gap_30", "robots/two_xarm7", "robots/ur5_and_panda", "robots/over_a_sill"]
)
def test_no_kernel_of_robots_is_missing_when_a_search_begins(scene):
    """Not where joints follow in no closed form, nor among meshes: to compile takes seconds that no budget counts."""
    command, root = [sys.executable, "-c", LOADED % scene], Path(__file__).parents[2]
    done = subprocess.run(command, cwd=root, capture_output=True, text=True, timeout=600)
    assert done.returncode == 0, done.stderr
    assert not done.stdout.split()
