"""Small robot problems, which need all kernels of searches and executions."""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import Any

from comove.geometry.surfaces import holds
from comove.model.scene import Scene
from comove.planning.kernels import TETRAHEDRON, SceneKind
from comove.planning.warming import require
from comove.robots.carrying import RobotCarrier
from comove.robots.model import Robot

TWO_ARMS = Path(__file__).parent / "stand_in" / "two_arms.yaml"
STAND_IN: dict[str, Any] = {
    "name": "kernels",
    "duration": 1.0,
    "grasp": {"orientation": "down", "yaw": "load"},
    "workspace": {"lower": [0.25, -0.75, -0.1], "upper": [0.95, 0.75, 0.12]},
    "obstacles": [{"shape": "sphere", "center": [0.44, 0.0, 0.0], "radius": 0.03}],
    "manipulators": [
        {"name": "left", "start": [0.6, 0.4, 0.05], "goal": [0.6, 0.4, -0.03]},
        {"name": "right", "start": [0.6, 0.1, 0.05], "goal": [0.6, 0.1, -0.03]},
    ],
}


def load_robot_kernels(kind: SceneKind, *more: str) -> None:
    """Wait until the kernels for robots are compiled, as `load_kernels`.

    Parameters
    ----------
    more : names of further jobs
    """
    require(*more, *kind.robot_jobs)


def follow() -> None:
    """Follow a motion by a small robot, among spheres and meshes."""
    stand_in = _stand_in(meshes=True)
    stand_in.try_following()
    holds(stand_in.scene.surfaces, 0, 0.0, 0.0, 0.0)  # which the verification of links asks by itself


def plan(moving: bool = False) -> None:
    """Plan the joints of a small robot."""
    _stand_in(moving=moving).try_planning()


def execute(steps: int = 3) -> None:
    """Execute a motion of a small robot step by step."""
    from comove.robots.online.executor import JointExecutor

    stand_in = _stand_in()
    executor = JointExecutor(stand_in.scene, stand_in.robot)
    for _ in range(steps):
        executor.step(executor.joints)


def _stand_in(moving: bool = False, meshes: bool = False) -> RobotCarrier:
    """Return the smallest robot that needs all kernels, in a small scene."""
    load = {"shape": "box", "size": [0.3, 0.02, 0.02]} if meshes else {"shape": "bar", "length": 0.3}
    scene: dict[str, Any] = {**STAND_IN, "load": load}
    if moving:
        (post,) = STAND_IN["obstacles"]
        scene["obstacles"] = [post | {"motion": {"velocity": [0.0, 0.0, 0.01]}}]
    with tempfile.TemporaryDirectory() as folder:
        if meshes:
            Path(folder, "mesh.obj").write_text(TETRAHEDRON)
            mesh = {"shape": "mesh", "file": "mesh.obj", "center": [0.9, -0.6, -0.05], "scale": 0.1}
            scene["obstacles"] = [*scene["obstacles"], mesh]
        return RobotCarrier(Robot.load(TWO_ARMS), Scene.from_dict(scene, folder=folder))
