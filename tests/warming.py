"""Kernels that many tests need, compiled by one worker each: two that began alike would compile the same twice."""

import numpy as np

from comove.planning import SceneKind, load_kernels
from tests.control.safety.moving import World, run, scene_of


def react():
    """Load the kernels of the safety filter."""
    scene = scene_of([{"shape": "circle", "radius": 0.1, "center": [2.6, 2.05]}])
    run(World(scene), np.array([[1.0, 0.0, 0.0]] * 2), 2)


def plan():
    """Load the kernels that solve scenes."""
    load_kernels(SceneKind(3))


def warm_up(worker):
    """Let a worker of pytest-xdist compile its share; whoever has none begins with the tests."""
    {"gw0": react, "gw1": plan}.get(worker, lambda: None)()
