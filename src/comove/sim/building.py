"""Builder of a MuJoCo model of robot, obstacles and payload."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any

import numpy as np

from comove.arrays import Array
from comove.errors import RobotError
from comove.geometry.rotations import quaternion_of_rotation
from comove.model.scene import Scene
from comove.robots.model import Arm, Robot
from comove.sim.engine import THE_LOAD, below, engine, hangs_on
from comove.sim.grasps import STILL, GraspModel, add_constraint
from comove.sim.loads import Load
from comove.sim.servos import add_servos
from comove.sim.settings import PLAN, Perturbation
from comove.sim.urdf import for_mujoco
from comove.sim.world import ROBOT, Holder, SimulatedWorld, add_load, add_obstacles

TIMESTEP = 0.002  # s
LIGHTEST = 1e-6  # kg, that a joint moves: what has no mass is given a thousandth of it (`sim.urdf`)


def build_world(
    robot: Robot,
    scene: Scene,
    load: Load | None,
    grasp: GraspModel,
    perturbation: Perturbation = PLAN,
    *,
    finish: Callable[[Any], None] | None = None,
) -> SimulatedWorld:
    """Build the simulated world of robot, obstacles and payload.

    Parameters
    ----------
    finish : function that adds parts for pictures to the world's specification; visual meshes are read if it is given

    Raises
    ------
    RobotError
        If the robot cannot hold the payload by this grasp, a joint moves nothing that has a mass, or MuJoCo cannot
        build the robot.
    """
    arms = [robot.arm(name) for name in scene.manipulators]
    holding = [] if load is None else [arms[i] for i in load.holders]
    moving = {*robot.joint_names, *grasp.moving(holding)}
    spec = _with_robot(robot, moving, drawn=finish is not None)
    for arm in arms:
        _add_hand(spec, robot, arm)
    add_obstacles(spec, scene)
    lead = add_servos(spec, robot, perturbation.gains)
    if load is not None:
        add_load(spec, load, load.mass * perturbation.mass, holding)
        add_constraint(spec, STILL, "WELD", "BODY", "world", THE_LOAD)
        grasp.furnish(spec, holding, perturbation.friction)
        if not grasp.touching:
            _let_hands_through(spec, robot, holding)
    if finish is not None:
        finish(spec)
    with _telling(robot):
        model = spec.compile()
    _require_masses(model, sorted(moving))
    return _indexed(model, robot, load, arms, holding, lead, moving)


@contextmanager
def _telling(robot: Robot) -> Iterator[None]:
    """Convert MuJoCo's errors in building a robot to `RobotError`."""
    try:
        yield
    except ValueError as error:
        reason = " ".join(str(error).split()).removeprefix("Error: ")
        raise RobotError(
            f"MuJoCo cannot build '{robot.name}': {reason}", way_out="correct its URDF"
        ) from error


def _require_masses(model: Any, moving: Iterable[str]) -> None:
    """Refuse joints that move no mass, which any motor would eject."""
    for name in moving:
        if model.body_subtreemass[model.joint(name).bodyid[0]] < LIGHTEST:
            raise RobotError(
                f"nothing that the joint '{name}' moves has a mass or a collision body, so it cannot be simulated",
                way_out='write one into its link in the URDF: <inertial><mass value="0.5"/><inertia ixx="1e-3" '
                'ixy="0" ixz="0" iyy="1e-3" iyz="0" izz="1e-3"/></inertial>',
            )


def _with_robot(robot: Robot, moving: set[str], *, drawn: bool) -> Any:
    mj, text = engine(), for_mujoco(robot.sources, robot.description.posture, moving, drawn=drawn)
    with _telling(robot):
        spec = mj.MjSpec.from_string(text)
    for body in spec.bodies:
        body.gravcomp = 1.0
        for geom in body.geoms:
            geom.density = 0.0  # masses are the URDF's alone
            if geom.contype:
                geom.contype, geom.conaffinity = ROBOT
    for mesh in spec.meshes:
        mesh.inertia = mj.mjtMeshInertia.mjMESH_INERTIA_SHELL  # a flat mesh, a screen, has no volume
    spec.option.timestep = TIMESTEP
    spec.option.integrator = mj.mjtIntegrator.mjINT_IMPLICITFAST
    spec.option.cone = mj.mjtCone.mjCONE_ELLIPTIC
    spec.option.impratio = 100.0  # friction as hard as contact, so that what is gripped does not creep
    spec.option.jacobian = mj.mjtJacobian.mjJAC_DENSE  # its rows are read for the forces on the load
    spec.option.disableflags |= mj.mjtDisableBit.mjDSBL_AUTORESET  # what breaks down is told, not begun anew
    return spec


def _add_hand(spec: Any, robot: Robot, arm: Arm) -> None:
    """Add an arm's grasp frame to the body of its last joint. The body's frame is that of the joint in both
    models."""
    joint, grasp = robot.grasp_frame(arm)
    body = spec.joint(robot.model.names[joint]).parent
    body.add_site(
        name=f"hand {arm.name}", pos=grasp.translation, quat=quaternion_of_rotation(grasp.rotation), group=4
    )


def _let_hands_through(spec: Any, robot: Robot, holding: Sequence[Arm]) -> None:
    """Exclude contact of the payload with the end effectors holding it."""
    for arm in holding:
        for body in below(spec.joint(robot.joint_names[arm.columns[-1]]).parent):
            if body.geoms:
                spec.add_exclude(name=f"load {body.name}", bodyname1=THE_LOAD, bodyname2=body.name)


def _indexed(
    model: Any,
    robot: Robot,
    load: Load | None,
    arms: Sequence[Arm],
    holding: Sequence[Arm],
    lead: Array,
    moving: set[str],
) -> SimulatedWorld:
    joints = [model.joint(name) for name in robot.joint_names]
    loaded = load is not None
    body = model.body(THE_LOAD).id if loaded else -1
    hand_of_geom = np.full(model.ngeom, -1)
    for i, arm in enumerate(holding):
        last = model.jnt_bodyid[model.joint(robot.joint_names[arm.columns[-1]]).id]
        hand_of_geom[[g for g in range(model.ngeom) if hangs_on(model, model.geom_bodyid[g], last)]] = i
    of_load = model.geom_bodyid == body
    told = ~(of_load[:, None] & (hand_of_geom >= 0)[None, :])
    return SimulatedWorld(
        model=model,
        robot=robot,
        load=load,
        qpos=np.array([joint.qposadr[0] for joint in joints]),
        dofs=np.array([joint.dofadr[0] for joint in joints]),
        servos=np.array([model.actuator(name).id for name in robot.joint_names]),
        lead=lead,
        sites=np.array([model.site(f"hand {arm.name}").id for arm in arms]),
        holders=tuple(
            Holder(
                arm.name,
                model.site(f"hand {arm.name}").id,
                model.site(f"held {arm.name}").id,
                tuple(finger for finger in arm.fingers if finger in moving),
            )
            for arm in holding
        ),
        load_body=body,
        load_qpos=int(model.joint(THE_LOAD).qposadr[0]) if loaded else -1,
        load_dof=int(model.joint(THE_LOAD).dofadr[0]) if loaded else -1,
        hand_of_geom=hand_of_geom,
        watched=told & told.T,
    )
