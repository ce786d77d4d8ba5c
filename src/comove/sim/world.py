"""World of a simulation: MuJoCo model, indices, obstacles, floor and payload.

The links of a robot (contype 1, conaffinity 2) collide with obstacles and payload (2, 3), not with each other: a
robot's models overlap where they are joined, and the verification checks self-collision. Obstacles and payload
collide with each other.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from comove.arrays import Array, Integers
from comove.geometry.distances import ROTATION
from comove.geometry.polytopes import vertices_in
from comove.geometry.rotations import exponential, quaternion_of_rotation
from comove.model.scene import Scene
from comove.robots.model import Arm, Robot
from comove.sim.engine import STIFF, THE_LOAD, engine
from comove.sim.loads import Load

ROBOT, OTHER = (1, 2), (2, 3)  # contype, conaffinity
GROUP = 2  # of obstacles, floor and load; shapes that links collide with are in 0, those that are drawn in 1


class Holder(NamedTuple):
    """End effector that holds the payload.

    Attributes
    ----------
    name : name of its arm
    site, held : indices of the sites of its grasp frame, and of its grasp on the payload
    fingers : names of the joints of its fingers, empty where they do not move
    """

    name: str
    site: int
    held: int
    fingers: tuple[str, ...]


@dataclass(frozen=True, eq=False)
class SimulatedWorld:
    """Compiled MuJoCo model with indices of its elements.

    Attributes
    ----------
    model : mujoco.MjModel
    robot, load : the robot and the payload in the world; the payload may be None
    qpos, dofs, servos : arrays, shape (n_joints,), indices of coordinates, degrees of freedom and servos of the
        robot's joints, in its order
    lead : array, shape (n_joints,), factor of a reference velocity in the servos' reference position [s]
    sites : array, shape (n_manipulators,), indices of the end effectors' grasp frames
    holders : the end effectors that hold the payload
    load_body, load_qpos, load_dof : indices of the payload's body, first coordinate and first degree of freedom; -1
        without a payload
    hand_of_geom : array, shape (n_geoms,), number of the holder that a shape belongs to, -1 for none
    watched : array of bool, shape (n_geoms, n_geoms), whether the contact of a pair of shapes is reported
    """

    model: Any
    robot: Robot
    load: Load | None
    qpos: Integers
    dofs: Integers
    servos: Integers
    lead: Array
    sites: Integers
    holders: tuple[Holder, ...]
    load_body: int
    load_qpos: int
    load_dof: int
    hand_of_geom: Integers
    watched: NDArray[np.bool_]

    @property
    def fingers(self) -> list[str]:
        """Return the names of the joints of all fingers that move."""
        return [name for holder in self.holders for name in holder.fingers]

    @property
    def finger_qpos(self) -> list[int]:
        """Return the indices of the coordinates of all fingers that move."""
        return [int(self.model.joint(name).qposadr[0]) for name in self.fingers]

    def load_pose(self, data: Any) -> Array:
        """Return the payload's pose in a state, shape (4, 4); else NaN."""
        if self.load is None:
            return np.full((4, 4), np.nan)
        pose = np.eye(4)
        pose[:3, 3] = data.xpos[self.load_body]
        pose[:3, :3] = data.xmat[self.load_body].reshape(3, 3)
        return pose

    def put_load(self, data: Any, pose: Array) -> None:
        """Write the payload's pose, shape (4, 4), into a state."""
        first = self.load_qpos
        data.qpos[first : first + 3] = pose[:3, 3]
        data.qpos[first + 3 : first + 7] = quaternion_of_rotation(pose[:3, :3])

    def names_of(self, pair: tuple[int, int]) -> tuple[str, str]:
        """Return the names of two shapes' bodies, for messages. The payload precedes links, and links precede
        obstacles."""
        first, second = sorted(pair, key=self._rank)
        return self._name_of(first), self._name_of(second)

    def _rank(self, geom: int) -> int:
        if self.model.geom_bodyid[geom] == self.load_body:
            return 0
        return 1 if self.model.geom_contype[geom] == ROBOT[0] else 2

    def _name_of(self, geom: int) -> str:
        shape, body = self.model.geom(geom), self.model.body(self.model.geom_bodyid[geom])
        return body.name if self._rank(geom) == 1 else shape.name


def add_obstacles(spec: Any, scene: Scene) -> None:
    """Add the scene's obstacles and a floor to a world."""
    kinds, post, table = engine().mjtGeom, (0.72, 0.20, 0.14, 1), (0.70, 0.60, 0.48, 1)
    shapes = {
        "box": (kinds.mjGEOM_BOX, lambda o: [edge / 2 for edge in o.size]),
        "sphere": (kinds.mjGEOM_SPHERE, lambda o: [o.radius, 0, 0]),
        "capsule": (kinds.mjGEOM_CAPSULE, lambda o: [o.radius, o.length / 2, 0]),
        "cylinder": (kinds.mjGEOM_CYLINDER, lambda o: [o.radius, o.height / 2, 0]),
        "ellipsoid": (kinds.mjGEOM_ELLIPSOID, lambda o: list(o.radii)),
    }
    for i, obstacle in enumerate(scene.file.obstacles):
        body, place = spec.worldbody, obstacle.center
        if obstacle.motion is not None:  # moved by who runs the simulation
            body, place = body.add_body(name=moving_body(i), pos=place, mocap=True), (0.0, 0.0, 0.0)
        name = scene.name_of(i)
        if obstacle.shape == "mesh":
            parts = _add_mesh(spec, body, scene.obstacles[scene.owners == i], name, place)
            for k, part in enumerate(parts):
                _finish(part, f"{name} part {k}" if k else name, post)
            continue
        kind, size = shapes[obstacle.shape]
        geom = body.add_geom(type=kind, size=size(obstacle), pos=place)
        geom.quat = getattr(obstacle, "quaternion_wxyz", (1.0, 0.0, 0.0, 0.0))
        flat = obstacle.shape == "box" and obstacle.size[2] < 0.3 * min(obstacle.size[:2])  # a table
        _finish(geom, name, table if flat else post)
    _finish(spec.worldbody.add_geom(type=kinds.mjGEOM_PLANE, size=(0, 0, 0.05)), "the floor", (1, 1, 1, 1))


def _add_mesh(spec: Any, body: Any, rows: Array, name: str, place: Any) -> list[Any]:
    """Add convex polytopes that contain a mesh to a body; return them.

    Parameters
    ----------
    rows : array, shape (n_polytopes, n_columns), of the table of obstacles
    """
    geoms = []
    for k, row in enumerate(rows):
        mesh = spec.add_mesh(name=f"{name} {k}", uservert=vertices_in(row).ravel().tolist())
        mesh.inertia = engine().mjtMeshInertia.mjMESH_INERTIA_CONVEX
        geom = body.add_geom(type=engine().mjtGeom.mjGEOM_MESH, meshname=mesh.name, pos=place)
        geom.quat = quaternion_of_rotation(row[ROTATION : ROTATION + 9].reshape(3, 3))
        geoms.append(geom)
    return geoms


def move_obstacles(data: Any, scene: Scene, time: float, centers: Array | None = None) -> None:
    """Move the obstacles to their poses at an instant [s]. `centers`, array of shape (n_obstacles, 3) [m], replaces
    their positions."""
    places, turned = moving_poses(scene, np.array([time]))
    data.mocap_pos[:] = places[0] if centers is None else centers[scene.moving]
    data.mocap_quat[:] = turned[0]


def moving_poses(scene: Scene, time: Array) -> tuple[Array, Array]:
    """Return the poses of moving obstacles at times of shape (n_steps,) [s].

    They are in the order of their mocap bodies, which are the only ones.

    Returns
    -------
    position, quaternion : arrays, shape (n_steps, n_moving, 3) [m] and (n_steps, n_moving, 4), w x y z
    """
    own = np.flatnonzero(scene.moving)
    return scene.centers_at(time)[:, own], exponential(scene.turns(time)[:, own])


def moving_body(obstacle: int) -> str:
    """Return the body name of a moving obstacle. It has a blank, like that of the payload."""
    return f"moving {obstacle}"


def add_load(spec: Any, load: Load, mass: float, holding: Sequence[Arm]) -> None:
    """Add the payload as a free body with grasp sites. `mass` is in kg."""
    mj, orange = engine(), (0.95, 0.70, 0.10, 1)
    shapes = mj.mjtGeom
    kinds = {"box": shapes.mjGEOM_BOX, "capsule": shapes.mjGEOM_CAPSULE, "hull": shapes.mjGEOM_MESH}
    body = spec.worldbody.add_body(name=THE_LOAD, pos=load.pose[:3, 3])
    body.quat = quaternion_of_rotation(load.pose[:3, :3])
    body.add_freejoint(name=THE_LOAD)
    volume = sum(part.volume for part in load.parts)
    for i, part in enumerate(load.parts):
        turn = quaternion_of_rotation(part.rotation)
        geom = body.add_geom(type=kinds[part.kind], pos=part.position, quat=turn)
        geom.size[: len(part.size)] = part.size
        if part.kind == "hull":
            mesh = spec.add_mesh(name=f"{THE_LOAD}'s hull {i}", uservert=part.points.ravel().tolist())
            mesh.inertia, geom.meshname = mj.mjtMeshInertia.mjMESH_INERTIA_CONVEX, mesh.name
        geom.mass = mass * part.volume / volume
        _finish(geom, THE_LOAD if len(load.parts) == 1 else f"{THE_LOAD}'s part {i}", orange)
    for arm, point in zip(holding, load.grasps, strict=True):
        body.add_site(name=f"held {arm.name}", pos=point, group=4)


def _finish(geom: Any, name: str, colour: tuple[float, ...]) -> None:
    geom.name, geom.rgba, geom.group = name, colour, GROUP
    geom.contype, geom.conaffinity = OTHER
    geom.solref = STIFF


def lower_floor(world: SimulatedWorld, data: Any, planned: Array) -> None:
    """Move the floor below everything, and below the links' motion.

    Parameters
    ----------
    planned : array, shape (n_steps, n_joints), joints of a motion [rad, m for prismatic joints]
    """
    looked_at, below = 50, 0.05  # steps, and m that links keep from the floor
    model, floor = world.model, world.model.geom("the floor").id
    shapes = [geom for geom in range(model.ngeom) if geom != floor]
    lowest = min(_lowest(model, data, geom) for geom in shapes) - 1e-3  # what stands on it does not touch it
    stands = model.body_weldid[model.geom_bodyid] == 0
    links = [geom for geom in shapes if not stands[geom] and model.geom_bodyid[geom] != world.load_body]
    present = data.qpos.copy()
    for q in planned[:: max(1, len(planned) // looked_at)]:
        data.qpos[world.qpos] = q
        engine().mj_kinematics(model, data)
        lowest = min([lowest, *(_lowest(model, data, geom) - below for geom in links)])
    data.qpos[:] = present
    engine().mj_kinematics(model, data)
    model.geom_pos[floor, 2] = lowest
    model.geom_sameframe[floor] = 0


def _lowest(model: Any, data: Any, geom: int) -> float:
    """Compute the height of a shape's (or its box's) lowest point [m]."""
    down, mesh = data.geom_xmat[geom, 6:], model.geom_dataid[geom]
    if mesh >= 0:
        first = model.mesh_vertadr[mesh]
        depth = (model.mesh_vert[first : first + model.mesh_vertnum[mesh]] @ down).min()
    else:
        middle, half = model.geom_aabb[geom].reshape(2, 3)
        depth = down @ middle - np.abs(down) @ half
    return float(data.geom_xpos[geom, 2] + depth)
