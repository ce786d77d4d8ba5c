"""Robot in MuJoCo that follows commands step by step. Servos, contacts and grasps are those of `simulate`."""

from __future__ import annotations

from typing import Any

import numpy as np

from comove.arrays import Array
from comove.model.scene import Scene
from comove.robots.model import Robot
from comove.robots.motion import JointMotion
from comove.sim.building import TIMESTEP, build_world
from comove.sim.dynamics import at_start, broken, contacts_of, note_contacts
from comove.sim.engine import engine, without_log
from comove.sim.execution import Conditions, obstacle_time
from comove.sim.grasps import FingerTravel, Friction, GraspModel, Weld, hold_still
from comove.sim.grippers import Grippers
from comove.sim.loads import hand_poses, load_of, require_fit
from comove.sim.robot_record import RobotRecord, RobotReport
from comove.sim.servos import PayloadTorques, carry_payload, limit_servos, motor_weight
from comove.sim.settings import PLAN, USUAL, Perturbation
from comove.sim.world import SimulatedWorld, lower_floor, move_obstacles

SLOW = 5  # time steps between looks at grippers and efforts, and between recorded samples


class SimulatedRobot:
    """Robot in MuJoCo whose servos follow commands.

    Parameters
    ----------
    motion : joint motion with the payload, at whose start the robot is
    scene, robot : as for `simulate`
    grasp : model of the grasp of the payload; `Weld()` unless given
    perturbation : deviations from the plan; none unless given. A push is not applied
    present : array, shape (n_joints,), joints at which the robot is instead, with open grippers [rad]; the payload is
        then in its place

    Attributes
    ----------
    timestep : duration of a step [s]
    command : array, shape (n_joints,), last commanded positions [rad]

    Raises
    ------
    RobotError, SceneError
        As `simulate` does.
    """

    timestep = TIMESTEP

    def __init__(
        self,
        motion: JointMotion,
        scene: Scene,
        robot: Robot,
        grasp: GraspModel | None = None,
        perturbation: Perturbation | None = None,
        *,
        present: Array | None = None,
    ):
        grasp, perturbation = grasp or Weld(), perturbation or PLAN
        require_fit(motion, robot, scene)
        self.robot, self.scene, self.n_steps = robot, scene, 0
        load = load_of(scene, hand_poses(robot, scene, motion.position[:1])[0], grasp.section)
        with without_log():
            self._world = build_world(robot, scene, load, grasp, perturbation)
            self._payload = PayloadTorques(robot, scene)
            self._data = at_start(self._world, motion, self._payload, perturbation)
            move_obstacles(self._data, scene, 0.0)
            travel = _held_or_apart(self._world, self._data, grasp, motion, present)
            engine().mj_step(self._world.model, self._data, round(USUAL.settle / TIMESTEP))
        self.command = (motion.position[0] if present is None else present).copy()
        self._grippers = Grippers(self._world, self._data, scene, grasp, travel, closed=present is None)
        self._record = RobotRecord(self._world, scene, Conditions("mujoco", grasp, USUAL, perturbation))
        self._contacts: dict[tuple[int, int], tuple[float, float]] = {}
        self._obstacles_begin = np.inf

    @property
    def time(self) -> float:
        """Return the simulated time since the start [s]."""
        return self.n_steps * TIMESTEP

    @property
    def position(self) -> Array:
        """Return the measured joint positions; array, shape (n_joints,) [rad]."""
        return np.array(self._data.qpos[self._world.qpos])

    @property
    def velocity(self) -> Array:
        """Return the measured joint velocities; array, shape (n_joints,) [rad/s]."""
        return np.array(self._data.qvel[self._world.dofs])

    @property
    def torque(self) -> Array:
        """Return the motors' torques; array, shape (n_joints,) [N m]."""
        return np.array(self._data.qfrc_actuator[self._world.dofs] + motor_weight(self._world, self._data))

    @property
    def is_broken(self) -> bool:
        """Return whether the simulation is unstable."""
        return broken(self._data)

    @property
    def obstacle_centers(self) -> Array:
        """Return the centres of the moving obstacles; array, shape (n_moving, 3) [m]."""
        since = max(self.time - self._obstacles_begin, 0.0)
        at = obstacle_time(np.array([since]), self.scene.duration)
        return self.scene.centers_at(at)[0, self.scene.moving]

    def begin_obstacles(self) -> None:
        """Let moving obstacles begin now, unless they have begun."""
        self._obstacles_begin = min(self._obstacles_begin, self.time)

    def grip(self, arm: str, share: float, effort: float = 0.0) -> None:
        """Close an arm's gripper by a share from 0 to 1. `effort` is the largest [N]; 0 for its own."""
        self._grippers.move(arm, share, effort)

    def closed_share(self, arm: str) -> float:
        """Return the share by which an arm's gripper is closed; of fingers that move, the measured one."""
        return self._grippers.closed_share(arm)

    def has_gripped(self, arm: str) -> bool:
        """Return whether an arm's gripper is done; it then holds the payload if it can."""
        return self._grippers.is_done(arm, self.time)

    def holds(self, arm: str) -> bool:
        """Return whether an arm's gripper holds the payload."""
        return self._grippers.by_arm[arm].holds

    def news(self) -> list[str]:
        """Return what grippers and payload did since the last call, in words."""
        words, self._grippers.words = self._grippers.words, []
        return words

    def step(self, position: Array, velocity: Array, acceleration: Array) -> None:
        """Simulate one time step with commanded joints; arrays, shape (n_joints,) [rad, s]."""
        world, data, self.command = self._world, self._data, position
        data.ctrl[world.servos] = position + world.lead * velocity
        self._grippers.step(self.time)
        slow = self.n_steps % SLOW == 0
        if slow:
            self._grippers.look(self.time)
            self._record.carries = self._grippers.carries
            torque = self._payload.at(position[None], velocity[None], acceleration[None])[0]
            carry_payload(world, data, torque * self._bearing())
            self._record.write_state(self.time, position, data)
        if self.scene.moving.any():
            since = max(self.time - self._obstacles_begin, 0.0)
            at = obstacle_time(np.array(since), self.scene.duration)
            move_obstacles(data, self.scene, float(at))
        engine().mj_step(world.model, data)
        if data.ncon:
            note_contacts(world, data, self.scene, self.time, self._contacts)
        if slow:
            self._record.write_rest(data)
            limit_servos(world, data)
        self.n_steps += 1

    def report(self) -> RobotReport:
        """Return what was carried so far."""
        found = [f"the simulation broke down at {self.time:.2f} s"] if self.is_broken else []
        return self._record.report(
            contacts_of(self._world, self._contacts),
            self._world.load_pose(self._data),
            self.position,
            (*found, *self._grippers.dropped),
        )

    def _bearing(self) -> Array:
        """Return 1 for joints of arms that hold the payload, else 0; array, shape (n_joints,)."""
        bears = np.zeros(len(self.command))
        for arm, gripper in self._grippers.by_arm.items():
            bears[self.robot.arm(arm).columns] = gripper.holds
        return bears


def _held_or_apart(
    world: SimulatedWorld, data: Any, grasp: GraspModel, motion: JointMotion, present: Array | None
) -> FingerTravel | None:
    """Grasp the payload, or bring the robot to its present joints; return the travel of fingers that move."""
    loaded = world.load is not None
    travel = grasp.open(world, data) if isinstance(grasp, Friction) and loaded else None
    if present is None:
        if isinstance(grasp, Friction) and travel is not None:
            grasp.grip(world, data, travel)
        elif loaded:
            grasp.close(world, data)
        return travel
    if loaded:
        hold_still(world, data)
    if travel is not None:
        data.ctrl[travel.servos] = travel.opened
    data.qpos[world.qpos] = data.ctrl[world.servos] = present
    carry_payload(world, data, np.zeros(len(present)))
    engine().mj_forward(world.model, data)
    lower_floor(world, data, np.vstack([motion.position, present]))
    limit_servos(world, data)
    return travel
