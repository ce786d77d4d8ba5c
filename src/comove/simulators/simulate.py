"""Execution of a joint motion in MuJoCo."""

from __future__ import annotations

from time import perf_counter
from typing import Any

import numpy as np
from numpy.typing import NDArray

from comove.geometry.rotations import quaternion_of_rotation
from comove.robots.model import Robot
from comove.robots.motion import JointMotion
from comove.scenes.scene import Scene
from comove.simulators.bodies import lower_floor
from comove.simulators.building import TIMESTEP, build_world
from comove.simulators.engine import engine, without_log
from comove.simulators.execution import Contact, Execution
from comove.simulators.grasps import GraspModel, Weld
from comove.simulators.loads import hand_poses, load_of, require_fit
from comove.simulators.log import Log
from comove.simulators.perturbation import PLAN, Perturbation
from comove.simulators.servos import limit_servos
from comove.simulators.settings import Settings
from comove.simulators.world import World

Array = NDArray[np.float64]

DEFAULT = Settings()
LIMITING = 5  # time steps after which what the robot's weight leaves of the efforts is found anew


def simulate(
    motion: JointMotion,
    scene: Scene,
    robot: Robot,
    grasp: GraspModel | None = None,
    perturbation: Perturbation | None = None,
    *,
    settings: Settings = DEFAULT,
) -> Execution:
    """Simulate servos that follow a joint motion in MuJoCo, with the load in the hands.

    The servos get positions and velocities at every time step, as controllers that interpolate a trajectory do; they
    do not take the load into account.

    Parameters
    ----------
    grasp : model of how the hands hold the load; `Weld()` unless given
    perturbation : deviations from the plan; none unless given

    Raises
    ------
    ExtraError
        If MuJoCo is not installed.
    OptionError
        If the perturbation is for a robot with another number of joints.
    RobotError, SceneError
        If robot, scene and motion do not belong together, or the robot cannot hold the load by this grasp.
    """
    grasp, perturbation = grasp or Weld(), perturbation or PLAN
    require_fit(motion, robot, scene)
    load = load_of(scene, hand_poses(robot, scene, motion.position[:1])[0], grasp.section)
    with without_log():
        world = build_world(robot, scene, load, grasp, perturbation)
        data = _at_start(world, motion, perturbation)
        if load is not None:
            grasp.close(world, data)
        engine().mj_step(world.model, data, round(settings.settle / TIMESTEP))
        log = _run(world, data, motion, perturbation, settings)
    return Execution(
        robot=robot,
        scene=scene,
        motion=motion,
        simulator="mujoco",
        grasp=grasp,
        load=load,
        settings=settings,
        perturbation=perturbation,
        hands_planned=hand_poses(robot, scene, log["commanded"]),
        **log,
    )


def _at_start(world: World, motion: JointMotion, perturbation: Perturbation) -> Any:
    """Return MuJoCo's data with the hands at the load, and with the load's grasps at the hands."""
    mj, model = engine(), world.model
    data = mj.MjData(model)
    data.qpos[world.qpos] = motion.position[0]
    data.ctrl[world.servos] = motion.position[0]
    if world.load is not None:
        pose = world.load.pose
        data.qpos[world.load_qpos : world.load_qpos + 3] = (
            pose[:3, 3] + pose[:3, :3] @ perturbation.start_error
        )
        data.qpos[world.load_qpos + 3 : world.load_qpos + 7] = quaternion_of_rotation(pose[:3, :3])
    mj.mj_forward(model, data)
    _move_grasps(world, data)
    lower_floor(model, data)
    limit_servos(world, data)
    mj.mj_forward(model, data)
    return data


def _move_grasps(world: World, data: Any) -> None:
    """Move the load's sites to the hands."""
    mj, model = engine(), world.model
    if world.load is None:
        return
    load, turned = world.load_body, data.xmat[world.load_body].reshape(3, 3)
    for hand, held in zip(world.holder_sites, world.held_sites, strict=True):
        model.site_pos[held] = turned.T @ (data.site_xpos[hand] - data.xpos[load])
        mj.mju_mat2Quat(model.site_quat[held], (turned.T @ data.site_xmat[hand].reshape(3, 3)).ravel())
        model.site_sameframe[held] = 0


def _run(
    world: World, data: Any, motion: JointMotion, perturbation: Perturbation, settings: Settings
) -> dict[str, Any]:
    """Run the simulation; returns the logged quantities, by the names of `Execution`."""
    mj, model = engine(), world.model
    every = max(1, round(1 / (settings.log_rate * TIMESTEP)))
    n_steps = every * int(np.ceil((motion.duration + settings.hold) / (every * TIMESTEP)))
    time = np.arange(n_steps + 1) * TIMESTEP
    position, velocity, _ = motion.at(np.minimum(time, motion.duration))
    control = position + world.lead * np.where(time[:, None] < motion.duration, velocity, 0.0)
    push, pushed = _push(world, motion, perturbation, time)
    log, contacts, unstable = Log(world, n_steps // every + 1), {}, None
    began = perf_counter()
    for step in range(n_steps + 1):
        data.ctrl[world.servos] = control[step]
        if step == 0 or pushed[step] != pushed[step - 1]:
            data.xfrc_applied[world.load_body, :3] = push * pushed[step]
        logged = step % every == 0
        if logged:
            log.write_state(data)
        mj.mj_step(model, data)  # what it leaves in data, but for the state, is of the time before the step
        if data.ncon:
            _note_contacts(world, data, time[step], contacts)
        if logged:
            log.write_rest(data)
        if step % LIMITING == 0:
            limit_servos(world, data)
            if _broken(data):
                unstable = float(time[step])
                break
    took = perf_counter() - began
    if unstable is not None:
        log.forget_broken()
    count = log.count
    return {
        "time": time[::every][:count],
        "commanded": position[::every][:count],
        **log.series(),
        "contacts": tuple(Contact(world.names_of(pair), *found) for pair, found in contacts.items()),
        "steps_per_second": (step + 1) / took,
        "unstable": unstable,
    }


def _broken(data: Any) -> bool:
    """Return whether MuJoCo has met numbers that are not finite, or far too large."""
    kinds = engine().mjtWarning
    return any(
        data.warning[kind].number
        for kind in (kinds.mjWARN_BADQPOS, kinds.mjWARN_BADQVEL, kinds.mjWARN_BADQACC)
    )


def _push(world: World, motion: JointMotion, perturbation: Perturbation, time: Array) -> tuple[Array, Array]:
    """Return the force of a push, array of shape (3,) [N], and the steps at which it acts, array of bool."""
    push = perturbation.push
    if push is None or world.load is None:
        return np.zeros(3), np.zeros(len(time), dtype=bool)
    since = time - push.at * motion.duration
    return np.array(push.force), (since >= 0) & (since < push.duration)


def _note_contacts(
    world: World, data: Any, time: float, found: dict[tuple[int, int], tuple[float, float]]
) -> None:
    """Update the time of the first contact and the largest depth of every watched pair that touches."""
    pairs, depths = data.contact.geom, -data.contact.dist
    for i in np.flatnonzero(world.watched[pairs[:, 0], pairs[:, 1]] & (depths > 0)):
        pair = (int(pairs[i].min()), int(pairs[i].max()))
        first, deepest = found.get(pair, (float(time), 0.0))
        found[pair] = first, max(deepest, float(depths[i]))
