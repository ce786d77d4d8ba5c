"""Pictures of a result, drawn in this process or another. Only drawing loads Matplotlib: a process that prepares
pictures for another one does not wait for it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from comove.arrays import Array

if TYPE_CHECKING:  # robots are an extra
    from comove.model.motion import CoordinatedMotion
    from comove.planning import Solution
    from comove.robots import JointSolution, Robot


@dataclass(frozen=True, eq=False)
class Joints:
    """Joint motion of a robot, as input of `draw_joints`.

    Attributes
    ----------
    name : name of the robot
    arms : names of the arms, and the columns of their joints
    joint_names : names of the joints
    lower, upper, velocity_limit, acceleration_limit : arrays, shape (n_joints,) [rad, m, and per second]
    time : array, shape (n_steps,) [s]
    position, velocity, acceleration : arrays, shape (n_steps, n_joints)
    """

    name: str
    arms: tuple[tuple[str, tuple[int, ...]], ...]
    joint_names: tuple[str, ...]
    lower: Array
    upper: Array
    velocity_limit: Array
    acceleration_limit: Array
    time: Array
    position: Array
    velocity: Array
    acceleration: Array

    @classmethod
    def of(cls, robot: Robot, motion: Any) -> Joints:
        """Return a robot's joint motion. It is a `JointMotion` or another object with the same arrays."""
        return cls(
            robot.name,
            tuple((arm.name, tuple(int(column) for column in arm.columns)) for arm in robot.arms),
            tuple(robot.joint_names),
            robot.lower,
            robot.upper,
            robot.velocity,
            robot.acceleration,
            motion.time,
            motion.position,
            motion.velocity,
            motion.acceleration,
        )


@dataclass(frozen=True, eq=False)
class Pictures:
    """Content of a solution's pictures, which can be pickled.

    Attributes
    ----------
    motion : motion of the end effectors
    title : title of the motion
    demonstration, arms : as in `draw_motion`
    joints : joint motion of the robot, and its title; None without a robot
    """

    motion: CoordinatedMotion
    title: str
    demonstration: Array | None = None
    arms: tuple[Array, ...] = ()
    joints: tuple[Joints, str] | None = None

    @classmethod
    def of(cls, solution: Solution, demonstration: Any = None) -> Pictures:
        """Return the pictures of a solution.

        Parameters
        ----------
        demonstration : movement that is drawn beside the motion
        """
        from comove.planning import carried_demonstration

        scene, joints = solution.scene, solution.joints
        said = "" if solution.verified else " (not verified)"
        return cls(
            solution.attempt,
            f"{scene.name}{said}",
            None if demonstration is None else carried_demonstration(demonstration, scene),
            tuple(arms_along(joints)),
            None
            if joints is None
            else (Joints.of(joints.robot, joints.attempt), f"{scene.name}, {joints.robot.name}{said}"),
        )


def drawn(pictures: Pictures | None) -> dict[str, bytes]:
    """Return pictures by file name; none for None. None only loads all modules that drawing needs."""
    from comove.view.figures.motion import draw_motion, draw_progress
    from comove.view.figures.robots import draw_joints
    from comove.view.figures.style import new_figure, png

    if pictures is None:
        nothing = new_figure(1.0, 1.0)
        nothing.add_subplot(1, 1, 1, title="0")
        png(nothing)
        return {}
    found = {
        "motion.png": png(
            draw_motion(
                pictures.motion,
                title=pictures.title,
                demonstration=pictures.demonstration,
                arms=pictures.arms,
            )
        ),
        "progress.png": png(draw_progress(pictures.motion)),
    }
    if pictures.joints is not None:
        joints, title = pictures.joints
        found["joints.png"] = png(draw_joints(joints, title=title))
    return found


def arms_along(joints: JointSolution | None, n_states: int = 4) -> list[Array]:
    """Return a robot's arm lines at equal times; none without robot. They are as in `draw_motion`."""
    if joints is None:
        return []
    motion = joints.attempt
    return arm_lines(joints.robot, motion.at(np.linspace(0.0, motion.duration, n_states))[0])


def arm_lines(robot: Robot, position: Array) -> list[Array]:
    """Compute the positions of all arms' joints and grasp frames.

    Parameters
    ----------
    position : array, shape (n_states, n_joints), joint positions [rad]

    Returns
    -------
    list of arrays, shape (n_states, n_points, 3), one for each arm [m]
    """
    import pinocchio as pin

    data = robot.model.createData()
    lines: list[list[list[Array]]] = [[] for _ in robot.arms]
    for q in position:
        pin.forwardKinematics(robot.model, data, q)
        for line, arm in zip(lines, robot.arms, strict=True):
            joints = [data.oMi[int(column) + 1].translation.copy() for column in arm.columns]
            line.append([*joints, robot.tool_pose(q, arm)[:3, 3]])
    return [np.array(line) for line in lines]
