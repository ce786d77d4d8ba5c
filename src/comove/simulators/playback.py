"""Geometric playback of a joint motion: every joint is exactly at its planned position at every instant, by
Pinocchio.

The load moves with the hands. Its holders share its weight and the force of its inertia equally; torques are those of
`comove.robots.effort`, as the verification has them. Nothing lags, slips or gives way.
"""

from __future__ import annotations

from time import perf_counter
from typing import Any

import coal
import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from comove.robots.effort import loaded_model, torques
from comove.robots.model import Robot
from comove.robots.motion import JointMotion
from comove.robots.verification.bodies import beyond_wrists, depth_of, obstacle_object
from comove.scenes.scene import Scene
from comove.simulators.execution import Contact, Execution
from comove.simulators.grasps import Weld
from comove.simulators.loads import (
    SETTLED,
    Load,
    carried,
    hand_poses,
    load_of,
    require_fit,
    supports_under,
)
from comove.simulators.settings import USUAL, Settings

Array = NDArray[np.float64]

GRAVITY = np.array([0.0, 0.0, -9.81])  # m/s^2


def play(motion: JointMotion, robot: Robot, scene: Scene, *, settings: Settings = USUAL) -> Execution:
    """Play a joint motion without physics.

    Raises
    ------
    RobotError, SceneError
        If robot, scene and motion do not belong together.
    """
    require_fit(motion, robot, scene)
    began = perf_counter()
    n_steps = int(np.ceil(motion.duration * settings.log_rate)) + 1
    time = np.linspace(0.0, motion.duration, n_steps)
    joints, velocity, acceleration = motion.at(time)
    hands = hand_poses(robot, scene, joints)
    load = load_of(scene, hands[0])
    poses, wrench = _with_load(load, hands, time)
    return Execution(
        robot=robot,
        scene=scene,
        motion=motion,
        simulator="geometric",
        grasp=Weld(),
        load=load,
        settings=settings,
        time=time,
        commanded=joints,
        joints=joints,
        torque=torques(robot, _loaded(robot, scene, load), joints, velocity, acceleration),
        hands=hands,
        hands_planned=hands,
        load_pose=poses,
        wrench=wrench,
        fingers=np.empty((n_steps, 0)),
        contacts=_contacts(robot, scene, load, time, joints, poses),
        steps_per_second=n_steps / (perf_counter() - began),
    )


def _with_load(load: Load | None, hands: Array, time: Array) -> tuple[Array, Array]:
    """Compute poses of the load, array of shape (n_steps, 4, 4), and the holders' forces on it, (n_steps,
    n_holders, 6).
    """
    if load is None:
        return np.full((len(time), 4, 4), np.nan), np.zeros((len(time), 0, 6))
    held = hands[:, list(load.holders)]
    poses = carried(held, np.linalg.inv(held[0]) @ load.pose)
    speed = np.gradient(poses[:, :3, 3], time, axis=0)
    force = load.mass * (np.gradient(speed, time, axis=0) - GRAVITY)
    wrench = np.zeros((len(time), len(load.holders), 6))
    wrench[..., :3] = force[:, None] / len(load.holders)
    return poses, wrench


def _loaded(robot: Robot, scene: Scene, load: Load | None) -> Any:
    """Return the robot's model with the load shared out among its holders."""
    if load is None:
        return robot.model
    arms = tuple(robot.arm(scene.manipulators[i]) for i in load.holders)
    return loaded_model(robot, arms, np.full(len(arms), load.mass / len(arms)))


def _contacts(
    robot: Robot, scene: Scene, load: Load | None, time: Array, joints: Array, poses: Array
) -> tuple[Contact, ...]:
    """Find the contacts of links and load with obstacles, and of the load with links other than the holding hands.

    A payload that rests on a support touches it, up to `SETTLED` deep.
    """
    geometry, names, moved = work_geometry(robot, scene, load)
    data, state = robot.model.createData(), geometry.createData()
    found: dict[int, tuple[float, float]] = {}
    parts = [] if load is None else [part.placement for part in load.parts]
    for step, q in enumerate(joints):
        pin.updateGeometryPlacements(robot.model, data, geometry, state, q)
        for item, part in zip(moved, parts, strict=True):
            state.oMg[item] = pin.SE3(poses[step]) * part
        if not pin.computeCollisions(geometry, state, False):
            continue
        under = supports_under(scene, load, poses[step])
        for k in range(len(geometry.collisionPairs)):
            if state.collisionResults[k].isCollision():
                ends = geometry.collisionPairs[k].first, geometry.collisionPairs[k].second
                shapes = [geometry.geometryObjects[end].geometry for end in ends]
                depth, _ = depth_of(shapes, [state.oMg[end] for end in ends])
                if ends[0] in moved and names[ends[1]] in under and depth <= SETTLED:
                    continue
                first, deepest = found.get(k, (float(time[step]), 0.0))
                found[k] = first, max(deepest, float(depth))
    pairs = geometry.collisionPairs
    return tuple(Contact((names[pairs[k].first], names[pairs[k].second]), *seen) for k, seen in found.items())


def contacts_at(execution: Execution, stride: int = 1) -> tuple[Contact, ...]:
    """Return the contacts of an execution by geometry alone, at every `stride`-th sample."""
    steps = slice(None, None, stride)
    return _contacts(
        execution.robot,
        execution.scene,
        execution.load,
        execution.time[steps],
        execution.joints[steps],
        execution.load_pose[steps],
    )


def work_geometry(robot: Robot, scene: Scene, load: Load | None) -> tuple[Any, list[str], list[int]]:
    """Build robot, obstacles and load with the pairs to be checked; returns also the names of all, and the numbers
    of the load's parts.
    """
    geometry = robot.collision.copy()
    geometry.removeAllCollisionPairs()
    links = range(geometry.ngeoms)
    names = [robot.model.frames[item.parentFrame].name for item in geometry.geometryObjects]
    obstacles = []
    for i in range(len(scene.file.obstacles)):
        names.append(scene.name_of(i))
        obstacles.append(geometry.addGeometryObject(obstacle_object(scene, i, names[-1])))
    hands = _hand_joints(robot, scene, load)
    parts = []
    for i, part in enumerate(load.parts if load is not None else ()):
        box = part.kind == "box"
        shape = coal.Box(*(2 * x for x in part.size)) if box else coal.Capsule(part.size[0], 2 * part.size[1])
        names.append("the load")
        parts.append(
            geometry.addGeometryObject(pin.GeometryObject(f"load {i}", 0, pin.SE3.Identity(), shape))
        )
    free = [i for i in links if geometry.geometryObjects[i].parentJoint not in hands]
    moving = [i for i in links if geometry.geometryObjects[i].parentJoint > 0]
    pairs = [(i, o) for i in moving for o in obstacles]
    pairs += [(p, other) for p in parts for other in (*obstacles, *free)]
    for first, second in pairs:
        geometry.addCollisionPair(pin.CollisionPair(first, second))
    return geometry, names, parts


def _hand_joints(robot: Robot, scene: Scene, load: Load | None) -> set[int]:
    """Return the joints whose links move with a hand that holds the load."""
    arms = [robot.arm(scene.manipulators[i]) for i in (load.holders if load is not None else ())]
    return beyond_wrists(robot, arms)
