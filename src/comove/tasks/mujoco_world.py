"""Worlds of others as tasks see them: a robot, its grippers, what stands around it, and what it can move.

```python
world = World.from_mujoco(env.sim)      # robosuite; env.physics of dm_control; or model and data
world.robot, world.obstacles            # a `Robot` whose home is where it stands; obstacles of a scene
world.body("pot_root").sites            # poses of sites in a body that moves freely
world.joints_of(data)                   # joints of the robot in a later state
```
"""

from __future__ import annotations

import copy
import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np

from comove.arrays import Array, Integers
from comove.brief import brief
from comove.errors import RobotError, TaskError, near_name
from comove.geometry.triangles import elements_of
from comove.robots.proposal.tree import Tree
from comove.sim.engine import engine, without_log
from comove.sim.mjcf import MESHES, MeshFiles, robot_of
from comove.sim.mjcf_actuators import drives_of
from comove.sim.mjcf_surroundings import MeshFile, ModelSurroundings, Roles
from comove.tasks.grippers import Gripper
from comove.tasks.robot import Rates, arms_of, folder_of, grippers_of, robot_now
from comove.tasks.world import Body, World

RESTS = 2e-3
"""Distance of a body from what it rests on, at most [m]."""
UPWARDS = 0.7
"""Least upward part of the direction from a support to what rests on it."""


@dataclass(frozen=True, eq=False)
class MujocoWorld(World):
    """A world that was read from a MuJoCo model.

    Attributes
    ----------
    grippers : the grippers, by arm
    addresses : array, shape (n_joints,), places of the robot's joints in `qpos` of the model
    model : the MuJoCo model
    notes : guesses and omissions, in words
    """

    __repr__ = brief

    grippers: Mapping[str, Gripper] = field(kw_only=True)
    addresses: Integers = field(kw_only=True)
    model: Any = field(kw_only=True)
    notes: tuple[str, ...] = field(kw_only=True)

    @classmethod
    def read(
        cls,
        model: Any,
        data: Any = None,
        *,
        arms: Mapping[str, str] | None = None,
        rates: Rates | None = None,
    ) -> MujocoWorld:
        """Read a MuJoCo model in its present state.

        Parameters
        ----------
        model, data : MjModel and MjData, or objects that hold them; one object that holds both, such as robosuite's
            `env.sim` and dm_control's `env.physics`, will do
        arms : a joint or body of each arm, by the arm's name; without it they are called robot0, robot1, and so on,
            and left and right where they have one base
        rates : limits of joints for which the model has none

        Raises
        ------
        RobotError
            If no arm is in it, no actuator, or a number that is none, or a joint has no counterpart in a robot.
        ExtraError
            If MuJoCo is not installed.
        """
        mj = engine()
        model, data = _raw(mj, model, data)
        if not model.nu:
            raise RobotError("the model has no actuators", way_out="give the joints of its arms actuators")
        state = _state(mj, model, data)
        drives = drives_of(mj, model)
        roles = Roles.of(mj, model, drives)
        _require_fixed(mj, model, roles)
        name = re.sub(r"[^\w-]+", "_", model.names.split(b"\0", 1)[0].decode(errors="replace")) or "world"
        converted, meshes = robot_of(model, name), MeshFiles(model)
        around = ModelSurroundings(
            mj, model, roles, lambda k: MeshFile(f"{MESHES}/{meshes.name_of(k)}"), state
        )
        standing = around.standing()
        parts = {root: around.parts(root) for root in sorted(roles.loose)}
        folder = folder_of(mj, model, roles.robot, converted, meshes.files)
        tree = Tree.of(elements_of(converted.urdf.encode()))
        joints = {_name(model, "joint", k): k for k in range(model.njnt)}
        driven = frozenset(joint for joint, k in joints.items() if drives[k].is_driven)
        chains = arms_of(tree, driven, arms)
        grippers = grippers_of(mj, model, state.qpos, chains, joints, folder)
        now = {
            joint.name: float(state.qpos[model.jnt_qposadr[joints[joint.name]]])
            for joint in tree.joints
            if joint.name in joints
        }
        rates = rates or Rates()
        robot = robot_now(name, converted, tree, chains, grippers, now, rates, folder)
        for geom in _supports(mj, model, state, set(standing), roles):
            standing[geom]["support"] = True
        bodies = [_body(model, state, root, parts[root], folder) for root in sorted(roles.loose)]
        return cls(
            robot,
            tuple(map(MappingProxyType, standing.values())),
            MappingProxyType({body.name: body for body in bodies}),
            folder=folder,
            grippers=MappingProxyType({arm: gripper for arm, (gripper, _) in grippers.items()}),
            addresses=np.array([int(model.jnt_qposadr[joints[joint]]) for joint in robot.joint_names]),
            model=model,
            notes=(*converted.notes, *around.notes),
        )

    def body(self, name: str) -> Body:
        """Return the body of that name.

        Raises
        ------
        TaskError
            If no body of that name moves freely.
        """
        if name in self.bodies:
            return self.bodies[name]
        named = [_name(self.model, "body", body) for body in range(1, self.model.nbody)]
        if name not in named:
            raise TaskError(
                f"the world has no body '{name}'", key="body", way_out=near_name(name, self.bodies)
            )
        root = _name(self.model, "body", int(self.model.body_rootid[1 + named.index(name)]))
        if root in self.bodies:
            told, way_out = f"'{name}' is a part of the body '{root}'", f"name '{root}'"
        else:
            told = f"'{name}' is fixed, or held by joints: it cannot be carried"
            way_out = (
                f"give it a free joint in the model, or name another one; {near_name(name, self.bodies)}"
            )
        raise TaskError(told, key="body", way_out=way_out)

    def joints_of(self, data: Any) -> Array:
        """Return the robot's joints in a state of the model; array, shape (n_joints,) [rad, m].

        Parameters
        ----------
        data : MjData, or an object that holds it

        Raises
        ------
        RobotError
            If it is of another model, or has a number that is none.
        """
        return np.asarray(_positions(self.model, _held(data, ("_data", "ptr")))[self.addresses])


def _raw(mj: Any, model: Any, data: Any) -> tuple[Any, Any]:
    """Return MjModel and MjData of the objects that hold them."""
    if data is None:
        model, data = getattr(model, "model", None), getattr(model, "data", None)
    model, data = _held(model, ("_model", "ptr")), _held(data, ("_data", "ptr"))
    if not (isinstance(model, mj.MjModel) and isinstance(data, mj.MjData)):
        raise RobotError(
            "these are no MjModel and MjData, nor do they hold them",
            way_out="give model and data of MuJoCo, env.sim of robosuite, or env.physics of dm_control",
        )
    return model, data


def _held(thing: Any, places: tuple[str, ...]) -> Any:
    """Return what an object holds at one of some places, or itself."""
    return next((getattr(thing, place) for place in places if hasattr(thing, place)), thing)


def _positions(model: Any, data: Any) -> Array:
    """Return all positions of a state, checked."""
    positions = np.array(data.qpos, dtype=np.float64)
    if positions.shape != (model.nq,):
        raise RobotError(
            f"the data have {len(positions)} positions, and the model {model.nq}",
            way_out="give the data of this model",
        )
    if not np.isfinite(positions).all():
        joint = next(
            _name(model, "joint", k)
            for k in reversed(range(model.njnt))
            if model.jnt_qposadr[k] <= np.flatnonzero(~np.isfinite(positions))[0]
        )
        raise RobotError(
            f"the position of '{joint}' is no finite number: the simulation has diverged",
            way_out="reset the environment",
        )
    return positions


def _state(mj: Any, model: Any, data: Any) -> Any:
    """Return a copy of a state with all poses computed."""
    state = mj.MjData(model)
    state.qpos[:] = _positions(model, data)
    state.mocap_pos[:], state.mocap_quat[:] = data.mocap_pos, data.mocap_quat
    mj.mj_kinematics(model, state)
    return state


def _require_fixed(mj: Any, model: Any, roles: Roles) -> None:
    """Reject a robot on a free base."""
    for joint in range(model.njnt):
        free = int(model.jnt_type[joint]) == int(mj.mjtJoint.mjJNT_FREE)
        if free and int(model.body_rootid[model.jnt_bodyid[joint]]) in roles.robot:
            raise RobotError(
                f"the robot moves freely by '{_name(model, 'joint', joint)}'",
                way_out="fix its base: leave out the free joint",
            )


def _name(model: Any, kind: str, number: int) -> str:
    """Return the name of a joint or body as URDFs have it."""
    return str(getattr(model, kind)(number).name or f"{kind}{number}")


def _pose(position: Array, rotation: Array) -> Array:
    pose = np.eye(4)
    pose[:3, 3], pose[:3, :3] = position, rotation.reshape(3, 3)
    return pose


def _body(model: Any, state: Any, root: int, parts: list[dict[str, Any]], folder: Path) -> Body:
    """Return a free body in a state."""
    pose = _pose(state.xpos[root], state.xmat[root])
    sites = {
        str(model.site(site).name or f"site{site}"): np.linalg.inv(pose)
        @ _pose(state.site_xpos[site], state.site_xmat[site])
        for site in range(model.nsite)
        if int(model.body_rootid[model.site_bodyid[site]]) == root
    }
    return Body(
        _name(model, "body", root),
        tuple(map(MappingProxyType, parts)),
        float(model.body_subtreemass[root]),
        pose,
        MappingProxyType(sites),
        folder,
    )


def _supports(mj: Any, model: Any, state: Any, standing: set[int], roles: Roles) -> set[int]:
    """Return the standing geoms on which a free body rests."""
    wide, data = copy.copy(model), mj.MjData(model)
    for margin in (wide.geom_margin, wide.body_margin):  # the second sorts out bodies that are far apart
        margin[:] = np.maximum(margin, RESTS)
    data.qpos[:] = state.qpos
    with without_log():
        mj.mj_forward(wide, data)
    found = set[int]()
    for contact in data.contact[: data.ncon]:
        first, second = int(contact.geom1), int(contact.geom2)
        for geom, other, up in (
            (first, second, contact.frame[2]),
            (second, first, -contact.frame[2]),
        ):
            rests = int(model.body_rootid[model.geom_bodyid[other]]) in roles.loose
            if geom in standing and rests and up > UPWARDS and contact.dist < RESTS:
                found.add(geom)
    return found
