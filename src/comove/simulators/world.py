"""The world of a simulation: robot, obstacles and load as one MuJoCo model, and where in it everything stands.

Contacts: the links of a robot (contype 1, conaffinity 2) meet obstacles and load (2, 3), not each other; a robot's
models overlap where they are joined, and self-collision is judged elsewhere. Obstacles and load meet each other.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from comove.errors import RobotError, SceneError
from comove.robots.model import Arm, Robot
from comove.scenes.groups import quaternion_of_rotation
from comove.scenes.scene import Scene
from comove.simulators.engine import engine, hangs_on
from comove.simulators.grasps import Grasp, add_servo
from comove.simulators.loads import Load
from comove.simulators.perturbation import PLAN, Perturbation
from comove.simulators.urdf import for_mujoco

Array = NDArray[np.float64]
Ints = NDArray[np.int64]

TIMESTEP = 0.002  # s
STIFFNESS = {
    True: 40.0,
    False: 1000.0,
}  # of a servo by effort limit: 1/rad where it turns, 1/m where it slides
INERTIA = {True: 0.3, False: 3.0}  # kg m^2, kg: of what a servo is damped for
ROBOT, OTHER = (1, 2), (2, 3)  # contype, conaffinity
THING_GROUP = 2  # of obstacles and load; a URDF's shapes are in 0, those that are drawn in 1
OBSTACLE_COLOUR, TABLE_COLOUR, LOAD_COLOUR = (
    (0.78, 0.22, 0.16, 1),
    (0.66, 0.56, 0.45, 1),
    (0.93, 0.72, 0.20, 1),
)
FLAT = 0.3  # a box that is lower than this share of its width is a table


@dataclass(frozen=True, eq=False)
class World:
    """A compiled model and the numbers of what is in it.

    Attributes
    ----------
    model : mujoco.MjModel
    robot, load : what was put in; the load may be None
    qpos, dofs, servos : arrays, shape (n_joints,), of the robot's joints in its order
    lead : array, shape (n_joints,), by which a reference velocity enters the servos' reference position [s]
    sites : array, shape (n_manipulators,), grasp frames of the hands
    holder_names, holder_sites, held_sites : of the hands that hold the load, and their grasps on it
    fingers : names of the joints of each holder's fingers, empty where they do not move
    load_body, load_qpos, load_dof : body, first coordinate and first degree of freedom; -1 without a load
    hand_of_geom : array, shape (n_geoms,), which holder a shape belongs to, -1 for none
    watched : array of bool, shape (n_geoms, n_geoms), pairs whose contact is told
    """

    model: Any
    robot: Robot
    load: Load | None
    qpos: Ints
    dofs: Ints
    servos: Ints
    lead: Array
    sites: Ints
    holder_names: tuple[str, ...]
    holder_sites: Ints
    held_sites: Ints
    fingers: tuple[tuple[str, ...], ...]
    load_body: int
    load_qpos: int
    load_dof: int
    hand_of_geom: Ints
    watched: NDArray[np.bool_]

    def name_of(self, geom: int) -> str:
        """Of a shape, as people call it."""
        name = self.model.geom(geom).name
        return name or self.model.body(self.model.geom_bodyid[geom]).name


def build_world(
    robot: Robot,
    scene: Scene,
    load: Load | None,
    grasp: Grasp,
    perturbation: Perturbation = PLAN,
    *,
    weight_on_motors: bool = False,
    drawn: bool = False,
) -> World:
    """Put robot, obstacles and load together.

    Parameters
    ----------
    weight_on_motors : see `Settings`
    drawn : with everything that only pictures need

    Raises
    ------
    SceneError
        If the scene is planar or names a manipulator that the robot has not.
    RobotError
        If the robot cannot hold the load so.
    """
    if scene.n_dims != 3:
        raise SceneError("robots live in space", key="workspace", way_out="write three numbers a point")
    arms = [robot.arm(name) for name in scene.manipulators]
    holding = [] if load is None else [arms[i] for i in load.holders]
    moving = {*robot.joint_names, *grasp.moving(holding)}
    spec = _with_robot(robot, moving, drawn)
    for arm in arms:
        _add_hand(spec, robot, arm)
    _add_obstacles(spec, scene)
    if load is not None:
        _add_load(spec, replace(load, mass=load.mass * perturbation.mass), holding)
    lead = _add_servos(spec, robot, perturbation.gains)
    for name in robot.joint_names:
        spec.joint(name).actgravcomp = weight_on_motors
    if load is not None:
        grasp.furnish(spec, robot, holding, perturbation.friction)
        if not grasp.touching:
            _let_hands_through(spec, robot, holding)
    try:
        model = spec.compile()
    except ValueError as error:
        reason = str(error).strip().splitlines()[0]
        raise RobotError(
            f"MuJoCo cannot build '{robot.name}': {reason}", way_out="correct its URDF"
        ) from error
    return _indexed(model, robot, load, arms, holding, lead, moving)


def _with_robot(robot: Robot, moving: set[str], drawn: bool) -> Any:
    mj = engine()
    spec = mj.MjSpec.from_string(for_mujoco(robot.sources, robot.description.posture, moving, drawn=drawn))
    for body in spec.bodies:
        body.gravcomp = 1.0
        for geom in body.geoms:
            if geom.contype:
                geom.contype, geom.conaffinity = ROBOT
    spec.option.timestep = TIMESTEP
    spec.option.integrator = mj.mjtIntegrator.mjINT_IMPLICITFAST
    spec.option.cone = mj.mjtCone.mjCONE_ELLIPTIC
    spec.option.impratio = 10.0  # friction as hard as contact, so that what is gripped does not creep
    spec.option.jacobian = mj.mjtJacobian.mjJAC_DENSE  # its rows are read for the forces on the load
    spec.option.disableflags |= mj.mjtDisableBit.mjDSBL_AUTORESET  # what breaks down is told, not begun anew
    return spec


def _add_hand(spec: Any, robot: Robot, arm: Arm) -> None:
    """The grasp frame, at the body that the arm's last joint moves: its frame is the joint's in both models."""
    frame = robot.model.frames[robot.model.getFrameId(arm.tip)]
    pose = frame.placement.homogeneous @ arm.tool
    body = spec.joint(robot.model.names[frame.parentJoint]).parent
    body.add_site(
        name=f"hand {arm.name}", pos=pose[:3, 3], quat=quaternion_of_rotation(pose[:3, :3]), group=4
    )


def _add_obstacles(spec: Any, scene: Scene) -> None:
    mj = engine()
    kinds = {
        "box": (mj.mjtGeom.mjGEOM_BOX, lambda o: [edge / 2 for edge in o.size]),
        "sphere": (mj.mjtGeom.mjGEOM_SPHERE, lambda o: [o.radius, 0, 0]),
        "capsule": (mj.mjtGeom.mjGEOM_CAPSULE, lambda o: [o.radius, o.length / 2, 0]),
        "cylinder": (mj.mjtGeom.mjGEOM_CYLINDER, lambda o: [o.radius, o.height / 2, 0]),
        "ellipsoid": (mj.mjtGeom.mjGEOM_ELLIPSOID, lambda o: list(o.radii)),
    }
    for i, obstacle in enumerate(scene.file.obstacles):
        kind, size = kinds[obstacle.shape]
        geom = spec.worldbody.add_geom(type=kind, size=size(obstacle), pos=obstacle.center)
        geom.quat = getattr(obstacle, "quaternion_wxyz", (1.0, 0.0, 0.0, 0.0))
        geom.name, geom.group = f"obstacles[{i}] ({obstacle.shape})", THING_GROUP
        geom.contype, geom.conaffinity = OTHER
        flat = obstacle.shape == "box" and obstacle.size[2] < FLAT * min(obstacle.size[:2])
        geom.rgba = TABLE_COLOUR if flat else OBSTACLE_COLOUR


def _add_load(spec: Any, load: Load, holding: Sequence[Arm]) -> None:
    mj = engine()
    kinds = {"box": mj.mjtGeom.mjGEOM_BOX, "capsule": mj.mjtGeom.mjGEOM_CAPSULE}
    body = spec.worldbody.add_body(name="load", pos=load.pose[:3, 3])
    body.quat = quaternion_of_rotation(load.pose[:3, :3])
    body.add_freejoint(name="load")
    volume = sum(part.volume for part in load.parts)
    for i, part in enumerate(load.parts):
        geom = body.add_geom(
            type=kinds[part.kind], pos=part.position, quat=quaternion_of_rotation(part.rotation)
        )
        geom.size[: len(part.size)] = part.size
        geom.mass = load.mass * part.volume / volume
        geom.name = "load" if len(load.parts) == 1 else f"load[{i}]"
        geom.contype, geom.conaffinity = OTHER
        geom.group, geom.rgba = THING_GROUP, LOAD_COLOUR
    for arm, point in zip(holding, load.grasps, strict=True):
        body.add_site(name=f"held {arm.name}", pos=point, group=4)


def _add_servos(spec: Any, robot: Robot, factors: tuple[float, ...]) -> Array:
    """Position servos of all joints; how far a reference velocity leads, array, shape (n_joints,) [s]."""
    stiffness, damping = servo_gains(robot)
    factors = np.broadcast_to(factors, len(stiffness))
    for i, name in enumerate(robot.joint_names):
        add_servo(spec, name, stiffness[i] * factors[i], damping[i] * factors[i], robot.effort[i])
        spec.joint(name).actfrclimited = True
        spec.joint(name).actfrcrange = (-robot.effort[i], robot.effort[i])
    return damping / stiffness


def servo_gains(robot: Robot) -> tuple[Array, Array]:
    """Stiffness [N m/rad] and damping [N m s/rad] of the joints' servos; arrays, shape (n_joints,).

    Stiffness is what the description says; where it says nothing a servo gives all it can at an error of 25 mrad
    (1 mm where a joint slides). Damping is 2 sqrt(I k) for an inertia of 0.3 kg m^2 (3 kg).
    """
    turning = np.array([_turns(robot, i) for i in range(len(robot.joint_names))])
    stiffness = np.where(turning, STIFFNESS[True], STIFFNESS[False]) * robot.effort
    servo = robot.description.servo
    for arm in robot.arms if servo is not None else ():
        if len(servo.stiffness) != len(arm.columns) or min(servo.stiffness) <= 0:
            raise RobotError(
                f"it has {len(servo.stiffness)} values, the arm '{arm.name}' {len(arm.columns)} joints",
                key="servo.stiffness",
                way_out="give one positive value a joint, from the base to the tip",
            )
        stiffness[arm.columns] = servo.stiffness
    return stiffness, 2 * np.sqrt(np.where(turning, INERTIA[True], INERTIA[False]) * stiffness)


def _turns(robot: Robot, joint: int) -> bool:
    """Whether a joint turns rather than slides: its velocity has an angular part."""
    axis = robot.model.joints[joint + 1].createData()
    model = robot.model.joints[joint + 1]
    model.calc(axis, pin.neutral(robot.model), np.eye(robot.model.nv)[joint])
    return bool(np.abs(axis.v.angular).max() > 0.5)


def _let_hands_through(spec: Any, robot: Robot, holding: Sequence[Arm]) -> None:
    """No contact between the load and the hands that it is fixed to."""
    for arm in holding:
        for body in _hand_bodies(spec, robot, arm):
            if body.geoms:
                spec.add_exclude(name=f"load {body.name}", bodyname1="load", bodyname2=body.name)


def _hand_bodies(spec: Any, robot: Robot, arm: Arm) -> list[Any]:
    """What the arm's last joint moves."""
    body = spec.joint(robot.joint_names[arm.columns[-1]]).parent
    return [body, *body.find_all(engine().mjtObj.mjOBJ_BODY)]


def _indexed(
    model: Any,
    robot: Robot,
    load: Load | None,
    arms: Sequence[Arm],
    holding: Sequence[Arm],
    lead: Array,
    moving: set[str],
) -> World:
    joints = [model.joint(name) for name in robot.joint_names]
    loaded = load is not None
    body = model.body("load").id if loaded else -1
    hand_of_geom = np.full(model.ngeom, -1)
    for i, arm in enumerate(holding):
        last = model.jnt_bodyid[model.joint(robot.joint_names[arm.columns[-1]]).id]
        hand_of_geom[[g for g in range(model.ngeom) if hangs_on(model, model.geom_bodyid[g], last)]] = i
    of_load = model.geom_bodyid == body
    told = ~(of_load[:, None] & (hand_of_geom >= 0)[None, :])
    return World(
        model=model,
        robot=robot,
        load=load,
        qpos=np.array([joint.qposadr[0] for joint in joints]),
        dofs=np.array([joint.dofadr[0] for joint in joints]),
        servos=np.array([model.actuator(name).id for name in robot.joint_names]),
        lead=lead,
        sites=np.array([model.site(f"hand {arm.name}").id for arm in arms]),
        holder_names=tuple(arm.name for arm in holding),
        holder_sites=np.array([model.site(f"hand {arm.name}").id for arm in holding], dtype=int),
        held_sites=np.array([model.site(f"held {arm.name}").id for arm in holding], dtype=int),
        fingers=tuple(tuple(f for f in arm.fingers if f in moving) for arm in holding),
        load_body=body,
        load_qpos=int(model.joint("load").qposadr[0]) if loaded else -1,
        load_dof=int(model.joint("load").dofadr[0]) if loaded else -1,
        hand_of_geom=hand_of_geom,
        watched=told & told.T,
    )
