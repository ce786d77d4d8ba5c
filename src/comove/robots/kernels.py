"""The compilation or loading of the kernels of robots, before the time of a search is measured."""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from functools import lru_cache
from pathlib import Path
from typing import Any

from comove.geometry.surfaces import holds
from comove.model.scene import Scene
from comove.planning.compiling import meanwhile
from comove.planning.kernels import TETRAHEDRON, SceneKind, begin_loading, load_smooth_kernels
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


def load_robot_kernels(kind: SceneKind, beside: Callable[[], object] | None = None) -> None:
    """Compile, or load from the cache, all kernels needed to solve scenes of a kind for robots; `beside` as in
    `load_kernels`.
    """
    with meanwhile(load_planning_kernels, solids=kind.solids, meshes=kind.meshes, moving=kind.moving):
        begin_loading(beside)
        _load_once(kind)
    load_planning_kernels(kind.solids, kind.meshes, kind.moving)


@lru_cache(maxsize=2)
def _load_once(kind: SceneKind) -> None:
    load_smooth_kernels(kind)
    stand_in = _stand_in(kind.solids, kind.meshes, kind.moving)
    stand_in.try_following()
    if kind.meshes:
        holds(stand_in.scene.surfaces, 0, 0.0, 0.0, 0.0)  # which the verification of links asks by itself


@lru_cache(maxsize=2)
def load_planning_kernels(solids: bool, meshes: bool, moving: bool) -> None:
    """Load the kernels by which arms plan."""
    _stand_in(solids, meshes, moving).try_planning()


@lru_cache(maxsize=1)
def _stand_in(solids: bool, meshes: bool, moving: bool) -> RobotCarrier:
    """Return the smallest robot that needs all kernels, in a small scene."""
    load = {"shape": "box", "size": [0.3, 0.02, 0.02]} if solids else {"shape": "bar", "length": 0.3}
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
