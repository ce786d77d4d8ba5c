"""Joints of a robot's episode at an even rate. They are as simulated, without a simulation as planned."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import ValidationError

from comove.arrays import Array, Integers
from comove.data.carried import executed, figures_of, restored_carry
from comove.data.runs import StoredCarry, StudyRun
from comove.data.study_file import SimulationPart
from comove.errors import ResultError
from comove.geometry.rotations import quaternion_of_rotation
from comove.results.sealed import finite
from comove.robots import VerifiedJointMotion
from comove.sim import Execution
from comove.trajectory import interpolated
from comove.verification.verify import VerifiedMotion


@dataclass(frozen=True, eq=False)
class EpisodeJoints:
    """Joints of an episode at given times, and their end-effector poses.

    Attributes
    ----------
    robot : name of the robot
    names : names of the joints
    columns : columns of the joints of each end effector's arm, from the base to the tip
    measured : array, shape (n_steps, n_joints), joints, as measured where the episode was simulated [rad or m]
    wanted : array, shape (n_steps, n_joints), planned joints of the next sample, as commanded to a controller
    hands : array, shape (n_steps, n_manipulators, 3), positions of the end effectors at the measured joints [m]
    orientation : array, shape (n_steps, n_manipulators, 4), their quaternions w x y z
    figures : measures of verification and simulation, by name
    """

    robot: str
    names: tuple[str, ...]
    columns: tuple[Integers, ...]
    measured: Array
    wanted: Array
    hands: Array
    orientation: Array
    figures: Mapping[str, Any]


def joint_samples(
    run: StudyRun, kept: StoredCarry, motion: VerifiedMotion, time: Array, simulate: Any, store: Path
) -> EpisodeJoints:
    """Return an episode's joints, verified and, if required, simulated again.

    Parameters
    ----------
    motion : motion of the end effectors, verified again
    time : array, shape (n_steps,), times of the samples [s]
    simulate : settings of the simulation; None without one
    store : path of the run database, for messages

    Raises
    ------
    ResultError
        If joints or simulation differ from the run database.
    """
    carried = restored_carry(kept, motion, store)
    planned = carried.joints.curve(np.minimum(time, carried.joints.duration))
    figures, measured = figures_of(carried), planned
    if simulate is not None:
        execution = _simulated(run, carried, simulate, store)
        measured = interpolated(time, execution.time, execution.joints)
        figures["simulation"] = {name: finite(value) for name, value in execution.measures.items()}
    robot, arms = carried.robot, [carried.robot.arm(name) for name in carried.scene.manipulators]
    poses = np.array([[robot.tool_pose(q, arm) for arm in arms] for q in measured])
    return EpisodeJoints(
        robot.name,
        robot.joint_names,
        tuple(arm.columns for arm in arms),
        measured,
        np.concatenate([planned[1:], planned[-1:]]),
        poses[..., :3, 3],
        np.array([[quaternion_of_rotation(pose[:3, :3]) for pose in row] for row in poses]),
        figures,
    )


def _simulated(run: StudyRun, carried: VerifiedJointMotion, simulate: Any, store: Path) -> Execution:
    """Simulate an episode again."""
    try:
        part = SimulationPart.model_validate(simulate)
    except ValidationError as error:
        raise ResultError(
            f"its description was changed: {simulate!r} is no simulation",
            file=store,
            way_out="copy the store again",
        ) from error
    execution = executed(carried, part, run.seed)
    if not execution.delivered:
        raise ResultError(
            f"episode {run.number} does not deliver its load any more: {execution.reasons[0]}",
            file=store,
            way_out="use the version of MuJoCo that ran the study, or generate it again in a new folder",
        )
    return execution
