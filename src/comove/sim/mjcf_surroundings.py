"""Obstacles and payloads around the robot in a compiled MuJoCo model.

A tree of bodies belongs to the robot if an actuator drives it, or, in a model without actuators, if it has joints.
All others are obstacles at their initial poses, except free bodies, which are payloads.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import yaml

from comove.arrays import Array
from comove.geometry.rotations import quaternion_of_rotation
from comove.sim.mjcf_actuators import Drive

FLOOR, THICK = 10.0, 0.1  # m, half the width of a plane without an end, and its thickness as a box
POINT = 1e-6  # m, length of the bar that a sphere is


@dataclass(frozen=True)
class Roles:
    """Roles of the trees of bodies, by root body.

    Attributes
    ----------
    robot, standing, loose : trees of the robot, of static bodies, and of free bodies
    """

    robot: frozenset[int]
    standing: frozenset[int]
    loose: frozenset[int]

    @classmethod
    def of(cls, mj: Any, model: Any, drives: list[Drive]) -> Roles:
        """Return the roles of all trees of a model."""
        roots = {int(root) for root in model.body_rootid[1:]}
        driven, jointed, free = set[int](), set[int](), set[int]()
        for joint, drive in enumerate(drives):
            root = int(model.body_rootid[model.jnt_bodyid[joint]])
            if model.jnt_type[joint] == mj.mjtJoint.mjJNT_FREE:
                free.add(root)
                continue
            jointed.add(root)
            if drive.is_driven:
                driven.add(root)
        robot = driven or jointed - free or jointed
        loose = free - robot
        return cls(frozenset(robot), frozenset(roots - robot - loose), frozenset(loose))


class MeshFile(NamedTuple):
    """File of a mesh. `scale` converts its lengths to metres; the pose is that of its frame in the mesh [m]."""

    file: Path | str
    scale: float = 1.0
    position: Array = np.zeros(3)
    rotation: Array = np.eye(3)


class ModelSurroundings:
    """Converter of all bodies outside the robot.

    Parameters
    ----------
    mj, model : MuJoCo, and the compiled model
    roles : roles of its trees
    mesh : function that returns the file of a mesh by its number
    data : state in which the bodies are; the initial one unless given
    """

    def __init__(
        self, mj: Any, model: Any, roles: Roles, mesh: Callable[[int], MeshFile], data: Any | None = None
    ):
        self.mj, self.model, self.roles, self.mesh = mj, model, roles, mesh
        self.data = mj.MjData(model) if data is None else data
        if data is None:
            mj.mj_forward(model, self.data)
        self.notes: list[str] = []

    def obstacles(self) -> list[dict[str, Any]]:
        """Return the static bodies as obstacles, in the model's frame."""
        return [*self.standing().values()]

    def standing(self) -> dict[int, dict[str, Any]]:
        """Return the static bodies as obstacles, by their geoms."""
        found, names = dict[int, dict[str, Any]](), dict[str, int]()
        for body in self._bodies(self.roles.standing, world=True):
            for geom in self._geoms(body):
                entry = self._obstacle(geom)
                if entry is None:
                    self.notes.append(
                        f"'{self._name(geom)}' stands in the model, and no obstacle has its shape: it is left out"
                    )
                    continue
                stem = re.sub(r"[^\w+-]+", "_", self._name(geom)).strip("_") or "obstacle"
                names[stem] = names.get(stem, 0) + 1
                name = stem if names[stem] == 1 else f"{stem}_{names[stem]}"
                found[geom] = {"name": name, **entry}
        for joint in range(self.model.njnt):
            if int(self.model.body_rootid[self.model.jnt_bodyid[joint]]) in self.roles.standing:
                name = str(self.model.joint(joint).name or joint)
                self.notes.append(f"no actuator drives '{name}', which stands around the robot and stays")
        return found

    def parts(self, root: int) -> list[dict[str, Any]]:
        """Return a free tree as a payload's parts, in its root's frame.

        Capsules and spheres become bars, and an ellipsoid the box around it.
        """
        kinds, found = self.mj.mjtGeom, list[dict[str, Any]]()
        place, turn = self.data.xpos[root], self.data.xmat[root].reshape(3, 3)
        for geom in (geom for body in self._bodies(frozenset((root,))) for geom in self._geoms(body)):
            size, kind = self.model.geom_size[geom].tolist(), kinds(int(self.model.geom_type[geom]))
            center, rotation = self.data.geom_xpos[geom], self.data.geom_xmat[geom].reshape(3, 3)
            if kind == kinds.mjGEOM_BOX or kind == kinds.mjGEOM_ELLIPSOID:
                shape: dict[str, Any] = {"shape": "box", "size": [2 * value for value in size]}
            elif kind == kinds.mjGEOM_CYLINDER:
                shape = {"shape": "cylinder", "radius": size[0], "height": 2 * size[1]}
            elif kind == kinds.mjGEOM_CAPSULE or kind == kinds.mjGEOM_SPHERE:
                long = 2 * size[1] if kind == kinds.mjGEOM_CAPSULE else POINT
                shape = {"shape": "bar", "radius": size[0], "length": long}
                rotation = rotation[:, [2, 0, 1]]  # x along z
            elif kind == kinds.mjGEOM_MESH:
                mesh = self.mesh(int(self.model.geom_dataid[geom]))
                shape = {"shape": "mesh", "file": str(mesh.file), "scale": mesh.scale}
                center, rotation = center + rotation @ mesh.position, rotation @ mesh.rotation
            else:
                self.notes.append(f"'{self._name(geom)}' has a shape that no payload has: it is left out")
                continue
            pose = {
                "position": _rounded(turn.T @ (center - place)),
                "quaternion_wxyz": _unit(turn.T @ rotation),
            }
            found.append(shape | pose)
        return found

    def payloads(self) -> Iterator[str]:
        """Yield notes on free bodies, with a scene's payload where possible."""
        for root in sorted(self.roles.loose):
            told = f"'{self.model.body(root).name or root}' moves freely, and is no part of the robot"
            load = self._payload(root)
            yield (
                f"{told}: as a payload, load: {load}" if load else f"{told}, nor a bar or a box for a payload"
            )

    def _bodies(self, roots: frozenset[int], *, world: bool = False) -> Iterator[int]:
        for body in range(self.model.nbody):
            if int(self.model.body_rootid[body]) in roots if body else world:
                yield body

    def _geoms(self, body: int) -> Iterator[int]:
        model, first = self.model, int(self.model.body_geomadr[body])
        for geom in range(first, first + int(model.body_geomnum[body])):
            if model.geom_contype[geom] or model.geom_conaffinity[geom]:
                yield geom

    def _name(self, geom: int) -> str:
        model = self.model
        body = int(model.geom_bodyid[geom])
        return str(model.geom(geom).name or (model.body(body).name if body else "") or f"geom {geom}")

    def _obstacle(self, geom: int) -> dict[str, Any] | None:
        """Return a geom as an obstacle; None for unsupported shapes."""
        kinds, size = self.mj.mjtGeom, self.model.geom_size[geom].tolist()
        kind = kinds(int(self.model.geom_type[geom]))
        center, turn = self.data.geom_xpos[geom], self.data.geom_xmat[geom].reshape(3, 3)
        shape: dict[str, Any]
        if kind == kinds.mjGEOM_PLANE:
            wide, long = (size[k] or FLOOR for k in (0, 1))
            shape = {"shape": "box", "size": [2 * wide, 2 * long, THICK]}
            center = center - 0.5 * THICK * turn[:, 2]
        elif kind == kinds.mjGEOM_BOX:
            shape = {"shape": "box", "size": [2 * value for value in size]}
        elif kind == kinds.mjGEOM_SPHERE:
            shape = {"shape": "sphere", "radius": size[0]}
        elif kind == kinds.mjGEOM_CAPSULE:
            shape = {"shape": "capsule", "radius": size[0], "length": 2 * size[1]}
        elif kind == kinds.mjGEOM_CYLINDER:
            shape = {"shape": "cylinder", "radius": size[0], "height": 2 * size[1]}
        elif kind == kinds.mjGEOM_ELLIPSOID:
            shape = {"shape": "ellipsoid", "radii": size}
        elif kind == kinds.mjGEOM_MESH:
            mesh = self.mesh(int(self.model.geom_dataid[geom]))
            shape = {"shape": "mesh", "file": str(mesh.file)} | (
                {} if mesh.scale == 1.0 else {"scale": mesh.scale}
            )
            center, turn = center + turn @ mesh.position, turn @ mesh.rotation
        else:
            return None
        entry = shape | {"center": _rounded(center)}
        if kind != kinds.mjGEOM_SPHERE and np.abs(turn - np.eye(3)).max() > 1e-9:
            entry["quaternion_wxyz"] = _unit(turn)
        return entry

    def _payload(self, root: int) -> str | None:
        """Return a free tree as payload of a scene, or None. It must be one box, capsule or cylinder."""
        geoms = [geom for body in self._bodies(frozenset((root,))) for geom in self._geoms(body)]
        if len(geoms) != 1:
            return None
        kinds, size = self.mj.mjtGeom, self.model.geom_size[geoms[0]].tolist()
        kind, mass = int(self.model.geom_type[geoms[0]]), float(self.model.body_subtreemass[root])
        if kind == int(kinds.mjGEOM_BOX):
            load = {"shape": "box", "size": _rounded(2 * self.model.geom_size[geoms[0]])}
        elif kind in (int(kinds.mjGEOM_CAPSULE), int(kinds.mjGEOM_CYLINDER)):
            load = {"shape": "bar", "length": round(2 * size[1], 6), "radius": round(size[0], 6)}
        else:
            return None
        text = yaml.safe_dump(
            load | {"mass": round(mass, 6)}, sort_keys=False, default_flow_style=True, width=999
        )
        return text.strip()


def fragment(obstacles: list[dict[str, Any]], file: Path) -> str:
    """Return obstacles as text for scenes and `comove robot scene`."""
    head = (
        f"# What stands around the robot in {file.name}, in its frame [m]: obstacles of a scene.\n"
        "# comove robot scene ROBOT --obstacles FILE, or copy the list into a scene.\n"
    )
    return head + yaml.safe_dump(
        {"obstacles": obstacles}, sort_keys=False, default_flow_style=None, width=110
    )


def _rounded(values: Array) -> list[float]:
    return (np.asarray(values, dtype=np.float64).round(9) + 0.0).tolist()


def _unit(turn: Array) -> list[float]:
    """Return a rotation's quaternion with norm 1 in all digits."""
    quaternion = quaternion_of_rotation(turn)
    return (quaternion / np.linalg.norm(quaternion)).tolist()
