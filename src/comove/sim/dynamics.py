"""Execution of joint motions in MuJoCo."""

from __future__ import annotations

from time import perf_counter
from typing import Any

import numpy as np
from numpy.typing import NDArray

from comove.arrays import Array, Integers
from comove.model.scene import Scene
from comove.robots.model import Robot
from comove.robots.motion import JointMotion
from comove.sim.building import TIMESTEP, build_world
from comove.sim.engine import engine, without_log
from comove.sim.execution import Conditions, Contact, Execution, obstacle_time
from comove.sim.grasps import GraspModel, Weld
from comove.sim.loads import SETTLED, hand_poses, load_of, require_fit, supports_under
from comove.sim.servos import PayloadTorques, carry_payload, limit_servos, motor_weight
from comove.sim.settings import PLAN, USUAL, Perturbation, Settings
from comove.sim.world import (
    THE_LOAD,
    Holder,
    SimulatedWorld,
    lower_floor,
    move_obstacles,
    moving_poses,
)


def simulate(
    motion: JointMotion,
    scene: Scene,
    robot: Robot,
    grasp: GraspModel | None = None,
    perturbation: Perturbation | None = None,
    *,
    settings: Settings = USUAL,
) -> Execution:
    """Simulate servos that track a joint motion with the payload grasped.

    The servos get positions and velocities at every time step, as controllers that interpolate a trajectory do. They
    compensate the payload by the mass of the scene; the perturbation's `mass` is the error of that. Moving obstacles
    move from the motion's beginning to its end, and then stay.

    Parameters
    ----------
    grasp : model of the grasp of the payload; `Weld()` unless given
    perturbation : deviations from the plan; none unless given

    Raises
    ------
    ExtraError
        If MuJoCo is not installed.
    OptionError
        If the perturbation is for a robot with another number of joints.
    RobotError, SceneError
        If robot, scene and motion do not match, or the robot cannot hold the payload by this grasp.
    """
    grasp, perturbation = grasp or Weld(), perturbation or PLAN
    require_fit(motion, robot, scene)
    load = load_of(scene, hand_poses(robot, scene, motion.position[:1])[0], grasp.section)
    with without_log():
        world = build_world(robot, scene, load, grasp, perturbation)
        payload = PayloadTorques(robot, scene)
        data = at_start(world, motion, payload, perturbation)
        if load is not None:
            grasp.close(world, data)
        move_obstacles(data, scene, 0.0)
        engine().mj_step(world.model, data, round(settings.settle / TIMESTEP))
        log = _run(world, data, scene, motion, payload, perturbation, settings)
    return Execution(
        robot=robot,
        scene=scene,
        motion=motion,
        conditions=Conditions("mujoco", grasp, settings, perturbation),
        load=load,
        **log,
    )


def at_start(
    world: SimulatedWorld, motion: JointMotion, payload: PayloadTorques, perturbation: Perturbation
) -> Any:
    """Return MuJoCo's data with the end effectors at the payload. The grasps on the payload are moved to the end
    effectors."""
    mj, model = engine(), world.model
    data = mj.MjData(model)
    data.qpos[world.qpos] = motion.position[0]
    data.ctrl[world.servos] = motion.position[0]
    if world.load is not None:
        carry_payload(world, data, payload.at_rest(motion.position[0]))
        pose = world.load.pose.copy()
        pose[:3, 3] += pose[:3, :3] @ perturbation.start_error
        world.put_load(data, pose)
    mj.mj_forward(model, data)
    _move_grasps(world, data)
    lower_floor(world, data, motion.position)
    limit_servos(world, data)
    mj.mj_forward(model, data)
    return data


def _move_grasps(world: SimulatedWorld, data: Any) -> None:
    """Move the payload's sites to the end effectors."""
    if world.load is None:
        return
    for holder in world.holders:
        move_grasp(world, data, holder)


def move_grasp(world: SimulatedWorld, data: Any, holder: Holder) -> None:
    """Move a grasp on the payload to its end effector."""
    model, load, (_, hand, held, _) = world.model, world.load_body, holder
    turned = data.xmat[load].reshape(3, 3)
    model.site_pos[held] = turned.T @ (data.site_xpos[hand] - data.xpos[load])
    engine().mju_mat2Quat(model.site_quat[held], (turned.T @ data.site_xmat[hand].reshape(3, 3)).ravel())
    model.site_sameframe[held] = 0


def _run(
    world: SimulatedWorld,
    data: Any,
    scene: Scene,
    motion: JointMotion,
    payload: PayloadTorques,
    perturbation: Perturbation,
    settings: Settings,
) -> dict[str, Any]:
    """Run the simulation; return the series of `Execution` by name."""
    mj, model = engine(), world.model
    limiting = 5  # time steps after which what the robot's weight leaves of the efforts is found anew
    every = max(1, round(1 / (settings.log_rate * TIMESTEP)))
    n_steps = every * int(np.ceil((motion.duration + settings.hold) / (every * TIMESTEP)))
    time = (np.arange(n_steps + 1) * TIMESTEP).astype(np.float64)
    position, velocity, acceleration = motion.at(np.minimum(time, motion.duration))
    moves = time[:, None] < motion.duration
    velocity, acceleration = np.where(moves, velocity, 0.0), np.where(moves, acceleration, 0.0)
    control = position + world.lead * velocity
    carrying = payload.at(position[::limiting], velocity[::limiting], acceleration[::limiting])
    push, pushed = _push(world, motion, perturbation, time)
    places, turns = moving_poses(scene, obstacle_time(time, motion.duration))
    log, unstable = Log(world, n_steps // every + 1), None
    contacts: dict[tuple[int, int], tuple[float, float]] = {}
    began = perf_counter()
    for step in range(n_steps + 1):
        data.ctrl[world.servos] = control[step]
        data.mocap_pos[:], data.mocap_quat[:] = places[step], turns[step]
        if step % limiting == 0:
            carry_payload(world, data, carrying[step // limiting])
        if step == 0 or pushed[step] != pushed[step - 1]:
            data.xfrc_applied[world.load_body, :3] = push * pushed[step]
        logged = step % every == 0
        if logged:
            log.write_state(data)
        mj.mj_step(model, data)  # what it leaves in data, but for the state, is of the time before the step
        if data.ncon:
            note_contacts(world, data, scene, time[step], contacts)
        if logged:
            log.write_rest(data)
        if step % limiting == 0:
            limit_servos(world, data)
            if broken(data):
                unstable = float(time[step])
                break
    took = perf_counter() - began
    if unstable is not None:
        log.forget_broken()
    return {
        "time": time[::every][: log.count],
        **log.series(),
        "contacts": contacts_of(world, contacts),
        "steps_per_second": (step + 1) / took,
        "unstable": unstable,
    }


def broken(data: Any) -> bool:
    """Return whether MuJoCo found non-finite or far too large values."""
    kinds = engine().mjtWarning
    return any(
        data.warning[kind].number
        for kind in (kinds.mjWARN_BADQPOS, kinds.mjWARN_BADQVEL, kinds.mjWARN_BADQACC)
    )


def _push(
    world: SimulatedWorld, motion: JointMotion, perturbation: Perturbation, time: Array
) -> tuple[Array, NDArray[np.bool_]]:
    """Return the force of a push [N], and its mask of samples."""
    push = perturbation.push
    if push is None or world.load is None:
        return np.zeros(3), np.zeros(len(time), dtype=bool)
    since = time - push.at * motion.duration
    return np.array(push.force), (since >= 0) & (since < push.duration)


def note_contacts(
    world: SimulatedWorld,
    data: Any,
    scene: Scene,
    time: float,
    found: dict[tuple[int, int], tuple[float, float]],
) -> None:
    """Update the first time and largest depth of watched contacts. A payload that rests on a support touches it, up
    to `SETTLED` deep."""
    contact = data.contact
    pairs, depths = contact.geom, -contact.dist
    touching = world.watched[pairs[:, 0], pairs[:, 1]] & (depths > 0)
    if not touching.any():
        return
    under = supports_under(scene, world.load, world.load_pose(data))
    for i in np.flatnonzero(touching):
        pair = (int(pairs[i].min()), int(pairs[i].max()))
        if under and depths[i] <= SETTLED:
            body, support = world.names_of(pair)
            if body.startswith(THE_LOAD) and support.split(" part ")[0] in under:
                continue
        first, deepest = found.get(pair, (float(time), 0.0))
        found[pair] = first, max(deepest, float(depths[i]))


def contacts_of(
    world: SimulatedWorld, found: dict[tuple[int, int], tuple[float, float]]
) -> tuple[Contact, ...]:
    """Return the contacts of bodies, each of several shapes."""
    told: dict[tuple[str, str], Contact] = {}
    for pair, (first, deepest) in found.items():
        names = world.names_of(pair)
        known = told.get(names, Contact(names, first, deepest))
        told[names] = Contact(names, min(known.time, first), max(known.depth, deepest))
    return tuple(told.values())


class Log:
    """Log of measured quantities, in arrays allocated in advance."""

    def __init__(self, world: SimulatedWorld, n_steps: int):
        self.world, self.count = world, 0
        model, kinds = world.model, engine().mjtConstraint
        self.kinds = int(kinds.mjCNSTR_EQUALITY), int(kinds.mjCNSTR_CONTACT_FRICTIONLESS)
        self.finger_qpos = world.finger_qpos
        self.hand_of_equality = np.full(model.neq, -1)
        for i, holder in enumerate(world.holders):
            equality = engine().mj_name2id(model, engine().mjtObj.mjOBJ_EQUALITY, f"grasp {holder.name}")
            if equality >= 0:
                self.hand_of_equality[equality] = i
        self.joints = np.empty((n_steps, len(world.qpos)))
        self.torque = np.empty((n_steps, len(world.qpos)))
        self.fingers = np.empty((n_steps, len(self.finger_qpos)))
        self.hands = np.zeros((n_steps, len(world.sites), 4, 4))
        self.load_pose = np.empty((n_steps, 4, 4))
        self.generalised = np.zeros((n_steps, len(world.holders), 6))
        self.hands[..., 3, 3] = 1.0

    def write_state(self, data: Any) -> None:
        """Log the state, which a step overwrites."""
        self.joints[self.count] = data.qpos[self.world.qpos]
        self.fingers[self.count] = data.qpos[self.finger_qpos]

    def write_rest(self, data: Any) -> None:
        """Log the other quantities of the instant, after the step."""
        world, i = self.world, self.count
        self.torque[i] = data.qfrc_actuator[world.dofs] + motor_weight(world, data)
        self.hands[i, :, :3, 3] = data.site_xpos[world.sites]
        self.hands[i, :, :3, :3] = data.site_xmat[world.sites].reshape(-1, 3, 3)
        self.load_pose[i] = world.load_pose(data)
        if world.load is not None:
            self._write_wrenches(data)
        self.count += 1

    def _write_wrenches(self, data: Any) -> None:
        """Log the end effectors' generalised forces on the payload, a free body."""
        world, n_dofs = self.world, self.world.model.nv
        if not data.nefc:
            return
        rows = data.efc_J.reshape(data.nefc, n_dofs)[:, world.load_dof : world.load_dof + 6]
        hand = self._hand_of_rows(data)
        by_hand = (hand[None, :] == np.arange(len(world.holders))[:, None]) * data.efc_force
        self.generalised[self.count] = by_hand @ rows

    def _hand_of_rows(self, data: Any) -> Integers:
        """Return the holder's number of each constraint row, else -1. Array, shape (n_rows,)."""
        (equal, frictionless), kind = self.kinds, data.efc_type
        hand, equality, touching = np.full(data.nefc, -1), kind == equal, kind >= frictionless
        hand[equality] = self.hand_of_equality[data.efc_id[equality]]
        if touching.any():
            pairs = data.contact.geom
            hand[touching] = self.world.hand_of_geom[pairs].max(axis=1)[data.efc_id[touching]]
        return hand

    @property
    def wrench(self) -> Array:
        """Return the wrenches of the end effectors on the payload.

        A free body's generalised force is a force in the world's axes, and a torque about its origin in its own axes.
        """
        sites, hands = list(self.world.sites), self.hands[: self.count]
        pose, found = self.load_pose[: self.count], self.generalised[: self.count].copy()
        held = [sites.index(holder.site) for holder in self.world.holders]
        if self.world.load is None:
            return found
        arms = hands[:, held][..., :3, 3] - pose[:, None, :3, 3]
        found[..., 3:] = found[..., 3:] @ pose[:, :3, :3].swapaxes(1, 2) - np.cross(arms, found[..., :3])
        return found

    def forget_broken(self) -> None:
        """Drop all samples from the first non-finite one; keep at least one."""
        broken = ~np.isfinite(self.hands[: self.count]).all(axis=(1, 2, 3))
        broken |= ~np.isfinite(self.joints[: self.count]).all(axis=1)
        if self.world.load is not None:
            broken |= ~np.isfinite(self.load_pose[: self.count]).all(axis=(1, 2))
        if broken.any():
            self.count = max(1, int(broken.argmax()))

    def series(self) -> dict[str, Array]:
        """Return the logged series, by the names of `Execution`."""
        names = ("joints", "torque", "hands", "load_pose", "wrench", "fingers")
        return {name: getattr(self, name)[: self.count] for name in names}
