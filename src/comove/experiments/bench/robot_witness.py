"""Witnesses of robots: joint motions that show that a scene can be solved, made before its obstacles."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from comove.coordination.coordinates import load_coordinates
from comove.coordination.motion import CoordinatedMotion
from comove.primitives.basis import motion_basis
from comove.robots import JointMotion, JointVerdict, verify_joints
from comove.scenes.scene import Scene
from comove.studies.carried import robot_of

Array = NDArray[np.float64]

N_BASIS = 20


@dataclass(frozen=True, eq=False)
class JointWitness:
    """A motion of the load, and of a robot's joints that carry it.

    Attributes
    ----------
    weights : array, shape (n_columns, N_BASIS), of the load's motion in load coordinates
    position : array, shape (n_steps, n_joints), joints at even times [rad, m for prismatic joints]
    """

    weights: Array
    position: Array

    def motion(self, scene: Scene) -> CoordinatedMotion:
        """Return the motion of the load in a scene with the ends that it was made for."""
        coordinates = load_coordinates(scene)
        boundary, basis = coordinates.boundary(), motion_basis(N_BASIS, "jerk")
        return CoordinatedMotion(scene, coordinates, basis, boundary, self.weights)

    def judged(self, scene: Scene, *, slack: float = 0.0) -> JointVerdict:
        """Return the judge's verdict on the witness, at every instant; `slack` as in `verify_joints`."""
        robot = robot_of(scene)
        time = np.linspace(0.0, scene.duration, len(self.position))
        joints = JointMotion(time, robot.joint_names, self.position)
        return verify_joints(robot, self.motion(scene), joints, slack=slack)
