"""Method of reference [5] with a robot's joints.

The programmes of `task_priority` are solved for joint rates. In every control step the rates u of all joints solve,
in this order, with the end effectors' velocities v = J u,

    L0   limits of joints, their speeds and accelerations; those of L0 on v; links keep clear (see `link_rows`)
    L1   relative motion: L1 on v; every end effector rotates with the payload,   w_i = w_load + prescribed(e_i)
    L2   absolute motion: L2 on v
    L3   L3 on v: the rotation of the payload
    L4   posture:   u = k (q_first - q),   towards the joints at the start

where e_i is the rotation vector from end effector i's orientation to the one of its grasp. The positions of the end
effectors are those of the joints, so that errors do not accumulate.
"""

from __future__ import annotations

import numpy as np

from comove.arrays import Array
from comove.control.safety.qp_workspace import Rates, Sighting
from comove.lab.compared.hierarchy import PriorityTask
from comove.lab.compared.task_priority import Controller, Performance, TaskPriority
from comove.model.motion import CoordinatedMotion
from comove.planning.search import Search
from comove.robots.carrying import RobotCarrier
from comove.robots.online.link_rows import LinkNeeds, empty_rows, hand_jacobians, link_rows
from comove.robots.search.chains import place_arm, pose_error
from comove.robots.search.tracking import N_COARSE

TURNING = Performance(first=0.05, last=2e-3, decay=2.0, gain=100.0)
"""Prescribed performance of a hand's orientation on the load, in radians for metres."""


class JointController(Controller):
    """Controller of a robot's joints, step by step.

    Parameters
    ----------
    method : method that holds the controller's parameters
    search : search whose kinematics is a `RobotCarrier`
    period : control period [s]
    taught : demonstrated movement of the end effectors, along which the joints at the start are chosen
    """

    def __init__(self, method: TaskPriority, search: Search, period: float, taught: CoordinatedMotion):
        super().__init__(method, search.scene, period)
        carrier = search.kinematics
        if not isinstance(carrier, RobotCarrier):
            raise TypeError(f"joints are those of a RobotCarrier, not of {type(carrier).__name__}")
        self.carrier = carrier
        self.first = carrier.best_course(taught.nodes(N_COARSE))[0]
        self.joints, self.path = self.first, [self.first]
        self.rates, self.turned = np.zeros_like(self.first), 0.0
        least = self.scene.clearance + method.margin
        self.needs = LinkNeeds(np.full(len(self.scene.obstacles), least), least, least, near=0.3)
        gain, braking, retreat = self.approach.gain, self.approach.braking, self.approach.retreat
        self.links = Rates(period, gain, braking, braking, retreat, np.inf, np.inf, self.scene.clearance)

    def carried_out(self, motion: CoordinatedMotion) -> dict[str, float]:
        """Verify the joints on the curve nearest to the controller's."""
        last = [self.joints] * (round(self.scene.duration / self.period) + 1 - len(self.path))
        self.carrier.keep(motion, np.array([*self.path, *last]))
        return {"turn_error_max_rad": self.turned}

    def _limited(
        self, tasks: list[PriorityTask], rows: Array, low: Array, before: Array
    ) -> tuple[Array, float]:
        """Solve for joint rates, move the joints; return velocities and slack."""
        n_hands, n_joints = len(before), len(self.joints)
        jacobians, hands = hand_jacobians(self.carrier.arms, self.joints)
        moving = jacobians[:, :3].reshape(3 * n_hands, n_joints)
        relative, *others = [PriorityTask(task.matrix @ moving, task.target) for task in tasks]
        held = self._held(jacobians, hands, moving)
        relative = PriorityTask(*(np.concatenate(parts) for parts in zip(relative, held, strict=True)))
        posture = min(self.method.posture, 0.5 / self.period) * (self.first - self.joints)
        limits = [(rows @ moving, low), self._clear_links(hands, moving), self._joint_limits()]
        rows, low = (np.concatenate(parts) for parts in zip(*limits, strict=True))
        tasks = [relative, *others, PriorityTask(np.eye(n_joints), posture)]
        x, slack = self._inside_balls(tasks, rows, low, before, moving)
        self.rates, self.joints = x, self.joints + self.period * x
        self.path.append(self.joints)
        _, there = hand_jacobians(self.carrier.arms, self.joints)
        return (there - hands) / self.period, slack

    def _held(self, jacobians: Array, hands: Array, moving: Array) -> PriorityTask:
        """Return the task of rotating with the payload. `moving`, shape (3 n_hands, n_joints), is J."""
        chains, grasp = self.carrier.arms.chains, self.carrier.grasp
        wanted, error = grasp.hand_rotations(hands), np.empty((len(hands), 6))
        for i in range(len(hands)):
            n = chains.first[i + 1] - chains.first[i]
            turns, places = np.empty((n + 1, 3, 3)), np.empty((n + 1, 3))
            place_arm(chains, i, self.joints, turns, places)
            pose_error(turns[n], places[n], wanted[i], hands[i], error[i])
        off = error[:, 3:]
        self.turned = max(self.turned, float(np.linalg.norm(off, axis=1).max()))
        turn = jacobians[:, 3:].copy()
        turn[grasp.turning] -= grasp.spins(hands, moving.reshape(*hands.shape, -1))
        pull = -TURNING.wanted(off, len(self.path) * self.period, self.period)
        return PriorityTask(turn.reshape(-1, turn.shape[2]), pull.ravel())

    def _joint_limits(self) -> tuple[Array, Array]:
        """Return the inequalities of joint speeds, accelerations and braking."""
        chains = self.carrier.arms.chains
        inside = self.method.inside
        most = inside * chains.acceleration
        change = most * self.period

        def fastest(left: Array) -> Array:
            left = np.maximum(left, 0.0)
            slow = np.minimum(0.5 / self.period * left, np.sqrt(most * left))  # half of the brakes is kept
            return np.minimum(inside * chains.velocity, slow)

        high = np.clip(fastest(chains.upper - self.joints), self.rates - change, self.rates + change)
        low = np.clip(-fastest(self.joints - chains.lower), self.rates - change, self.rates + change)
        ones = np.eye(len(most))
        return np.concatenate([ones, -ones]), np.concatenate([low, -high])

    def _clear_links(self, hands: Array, moving: Array) -> tuple[Array, Array]:
        """Return the inequalities for clearances of links. They cover obstacles, the payload and other links."""
        scene, size = self.scene, hands.size
        center = hands.mean(axis=0)
        basis = np.zeros((6, size))
        basis[:3] = np.tile(np.eye(3), len(hands)) / len(hands)
        r = hands[0] - hands[-1]
        for axis in range(3):  # w = r x (v_first - v_last) / |r|^2
            turn = np.cross(r, np.eye(3)[axis]) / (r @ r)
            basis[3:, axis], basis[3:, size - 3 + axis] = turn, -turn
        work = empty_rows(self.carrier.arms, len(scene.obstacles), size)
        count = link_rows(
            self.carrier.arms,
            self.joints,
            (-self.carrier.arms.chains.velocity, self.carrier.arms.chains.velocity),
            hands,
            (basis, center),
            Sighting.still(scene),
            (self.needs, self.links),
            work,
        )
        rows = work.rows[:count]
        return rows[:, :size] @ moving + rows[:, size:], work.low[:count].copy()
