"""Obstacles, floor and load as shapes of a MuJoCo world, with their colours and contacts.

The links of a robot (contype 1, conaffinity 2) meet obstacles and load (2, 3), not each other: a robot's models
overlap where they are joined, and self-collision is judged elsewhere. Obstacles and load meet each other.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from comove.geometry.rotations import quaternion_of_rotation
from comove.robots.model import Arm
from comove.scenes.scene import Scene
from comove.simulators.engine import engine
from comove.simulators.loads import Load

ROBOT, OTHER = (1, 2), (2, 3)  # contype, conaffinity
GROUP = 2  # of obstacles, floor and load; shapes that links collide with are in 0, those that are drawn in 1
STIFF = (0.004, 1.0)  # s, time constant and damping ratio of contacts and grasps: two time steps
FLAT = 0.3  # a box that is lower than this share of its width is a table
THE_LOAD = "the load"  # with a blank, as no link of a URDF is called
POST, TABLE, LOAD, FLOOR = (0.72, 0.20, 0.14, 1), (0.70, 0.60, 0.48, 1), (0.95, 0.70, 0.10, 1), (1, 1, 1, 1)


def add_obstacles(spec: Any, scene: Scene) -> None:
    """Add the scene's obstacles and a floor to a world."""
    kinds = engine().mjtGeom
    shapes = {
        "box": (kinds.mjGEOM_BOX, lambda o: [edge / 2 for edge in o.size]),
        "sphere": (kinds.mjGEOM_SPHERE, lambda o: [o.radius, 0, 0]),
        "capsule": (kinds.mjGEOM_CAPSULE, lambda o: [o.radius, o.length / 2, 0]),
        "cylinder": (kinds.mjGEOM_CYLINDER, lambda o: [o.radius, o.height / 2, 0]),
        "ellipsoid": (kinds.mjGEOM_ELLIPSOID, lambda o: list(o.radii)),
    }
    for i, obstacle in enumerate(scene.file.obstacles):
        kind, size = shapes[obstacle.shape]
        geom = spec.worldbody.add_geom(type=kind, size=size(obstacle), pos=obstacle.center)
        geom.quat = getattr(obstacle, "quaternion_wxyz", (1.0, 0.0, 0.0, 0.0))
        flat = obstacle.shape == "box" and obstacle.size[2] < FLAT * min(obstacle.size[:2])
        _finish(geom, f"obstacles[{i}] ({obstacle.shape})", TABLE if flat else POST)
    _finish(spec.worldbody.add_geom(type=kinds.mjGEOM_PLANE, size=(0, 0, 0.05)), "the floor", FLOOR)


def add_load(spec: Any, load: Load, mass: float, holding: Sequence[Arm]) -> None:
    """Add the load to a world as a free body, with a site for each hand; `mass` in kg."""
    mj = engine()
    kinds = {"box": mj.mjtGeom.mjGEOM_BOX, "capsule": mj.mjtGeom.mjGEOM_CAPSULE}
    body = spec.worldbody.add_body(name=THE_LOAD, pos=load.pose[:3, 3])
    body.quat = quaternion_of_rotation(load.pose[:3, :3])
    body.add_freejoint(name=THE_LOAD)
    volume = sum(part.volume for part in load.parts)
    for i, part in enumerate(load.parts):
        turn = quaternion_of_rotation(part.rotation)
        geom = body.add_geom(type=kinds[part.kind], pos=part.position, quat=turn)
        geom.size[: len(part.size)] = part.size
        geom.mass = mass * part.volume / volume
        _finish(geom, THE_LOAD if len(load.parts) == 1 else f"{THE_LOAD}'s part {i}", LOAD)
    for arm, point in zip(holding, load.grasps, strict=True):
        body.add_site(name=f"held {arm.name}", pos=point, group=4)


def _finish(geom: Any, name: str, colour: tuple[float, ...]) -> None:
    geom.name, geom.rgba, geom.group = name, colour, GROUP
    geom.contype, geom.conaffinity = OTHER
    geom.solref = STIFF


def lower_floor(model: Any, data: Any) -> None:
    """Move the floor below everything in the world, at the present state."""
    floor = model.geom("the floor").id
    lowest = min(_lowest(model, data, geom) for geom in range(model.ngeom) if geom != floor)
    model.geom_pos[floor, 2] = lowest - 1e-3  # what stands on it does not touch it
    model.geom_sameframe[floor] = 0


def _lowest(model: Any, data: Any, geom: int) -> float:
    """Compute the height of the lowest point of a shape, by a mesh's vertices or a box around any other shape [m]."""
    down, mesh = data.geom_xmat[geom, 6:], model.geom_dataid[geom]
    if mesh >= 0:
        first = model.mesh_vertadr[mesh]
        depth = (model.mesh_vert[first : first + model.mesh_vertnum[mesh]] @ down).min()
    else:
        middle, half = model.geom_aabb[geom].reshape(2, 3)
        depth = down @ middle - np.abs(down) @ half
    return float(data.geom_xpos[geom, 2] + depth)
