"""The arms' rows in the safety filter: grasps, joint limits and clearances.

With them the filter of `comove.control.safety.cbf_qp` has the rates of all joints as variables too, and requires that

    each end effector moves and turns as the payload and its grasp do (equations, never relaxed),
    joints keep their ranges, speeds and accelerations, so that they can always brake in time,
    links keep clear of obstacles, of the payload and of each other (`link_rows`).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from comove.arrays import Array, Integers
from comove.control.safety.cbf_qp import JointState
from comove.control.safety.qp_workspace import LIMIT, QP, Sighting
from comove.control.safety.twists import nodes_of
from comove.errors import SceneError
from comove.model.coordinates import HandPoses
from comove.model.grasp import Grasp
from comove.model.scene import Scene
from comove.robots.online.link_rows import (
    LinkNeeds,
    clearances_along,
    empty_rows,
    hand_jacobians,
    link_rows,
    most_rows,
)
from comove.robots.search.following import Arms


@dataclass(frozen=True)
class JointSettings:
    """Settings of the rows of arms.

    Attributes
    ----------
    weight : cost of joint rates other than the desired ones, beside velocities of end effectors [m^2]
    near : clearance below which links are checked [m]
    gain : approach of a joint to its limit per remaining range [1/s]
    share : of the joints' accelerations that is used, and of these again when braking before a limit
    speed : share of the joints' speeds that is used
    passing : factor of the assumed braking towards obstacles that are predicted to pass by
    bend : assumed share of a change of rates in a step that curved joint paths cause by themselves
    """

    weight: float = 0.02
    near: float = 0.3
    gain: float = 5.0
    share: float = 0.9
    speed: float = 0.98
    passing: float = 6.0
    bend: float = 0.85


class ArmRows:
    """The rows of arms that hold a payload; see `comove.control.safety.cbf_qp.JointRows`.

    Parameters
    ----------
    scene : the scene, whose end effectors hold one rigid body
    arms : the arms, in the order of the end effectors
    grasp : grasps of the end effectors
    period : length of a control step [s]

    Attributes
    ----------
    needs : required clearances of links

    Raises
    ------
    SceneError
        If the end effectors do not hold one rigid body.
    """

    def __init__(
        self,
        scene: Scene,
        arms: Arms,
        grasp: Grasp,
        period: float,
        settings: JointSettings = JointSettings(),
    ):
        if len(scene.groups) != 1:
            raise SceneError(
                "arms are run with one rigid load in all hands, and here are several",
                file=scene.path,
                key=scene.words.key("load"),
                way_out="let all hands hold it, or run the scene without a robot",
            )
        self.scene, self.arms, self.grasp, self.period, self.settings = scene, arms, grasp, period, settings
        self.n_joints, self.weight = len(arms.chains.lower), settings.weight
        self.n_equal = 6 * len(scene.manipulators)
        self.n_fixed = self.n_equal + 2 * self.n_joints
        full = arms.around.clearance
        self.needs = LinkNeeds(np.full(len(scene.obstacles), full), full, full, settings.near)
        self._links, self._room = empty_rows(arms, 0, 0), -1

    def follow(self, joints: Array, nodes: Array) -> None:
        """Require no more static clearance than a verified motion has by capsules.

        The verification uses the exact bodies, which are slimmer.

        Parameters
        ----------
        joints, nodes : arrays, shape (n_steps, n_joints) and (n_steps, n_nodes, 3), along the motion [rad, m]
        """
        full = self.arms.around.clearance
        keep, other, still = clearances_along(self.arms, joints, nodes, self.scene.obstacles, full)
        keep[self.scene.moving[self.scene.owners]] = full
        self.needs = LinkNeeds(keep, other, still, self.settings.near)

    def max_rows(self, n_obstacles: int) -> int:
        """Return the largest number of rows of links."""
        return most_rows(self.arms, n_obstacles)

    def write(
        self,
        qp: QP,
        m: int,
        poses: HandPoses,
        joints: JointState,
        sighting: Sighting,
        same: Integers,
    ) -> int:
        """Write the fixed rows first, then, from row `m`, links'; return the number of rows."""
        work, basis, n_obstacles = qp.work, qp.freedom.basis[0], len(same)
        n, fixed, holds = basis.shape[1], slice(self.n_equal, self.n_fixed), work.rows[: self.n_equal]
        bounds = least, largest = self.joint_bounds(joints)
        jacobians, _ = hand_jacobians(self.arms, joints.position)
        holds[:, n:] = jacobians.reshape(self.n_equal, -1)
        holds = holds.reshape(-1, 6, holds.shape[1])
        holds[:, :3, :n], holds[:, 3:, :n] = -work.hands, 0.0
        holds[self.grasp.turning, 3:, :n] = -basis[3:]
        one, ones = np.eye(self.n_joints), work.rows[fixed]
        ones[:, :n], ones[: self.n_joints, n:], ones[self.n_joints :, n:] = 0.0, one, -one
        work.low[: self.n_equal], work.low[fixed] = 0.0, np.concatenate([least, -largest])
        work.owner[: self.n_fixed], work.body[: self.n_fixed] = LIMIT, 0
        if n_obstacles > self._room:
            self._links, self._room = empty_rows(self.arms, n_obstacles, n), n_obstacles
        keep = np.full(n_obstacles, self.arms.around.clearance)  # of what the scene does not name, all
        keep[: len(self.needs.obstacle)] = self.needs.obstacle
        count = link_rows(
            self.arms,
            joints.position,
            bounds,
            nodes_of(self.scene, poses),
            (basis, poses.center[0]),
            sighting,
            (self.needs._replace(obstacle=keep[same]), qp.rates),
            self._links,
        )
        to = slice(m, m + count)
        work.rows[to], work.low[to] = self._links.rows[:count], self._links.low[:count]
        work.owner[to], work.body[to] = self._links.owner[:count], 0
        return m + count

    def joint_bounds(self, joints: JointState) -> tuple[Array, Array]:
        """Return the least and the largest rates; arrays, shape (n_joints,) [rad/s]."""
        chains, how = self.arms.chains, self.settings
        most = how.share * chains.acceleration
        change, brake = most * self.period, how.share * most
        up, down = chains.upper - joints.position, joints.position - chains.lower
        gain = np.minimum(how.gain, how.speed / np.maximum(chains.approach, 1e-12))
        fastest = [
            np.minimum(gain * left, np.sqrt(2.0 * brake * left))
            for left in (np.maximum(up, 0.0), np.maximum(down, 0.0))
        ]
        speed = how.speed * chains.velocity
        high, low = np.minimum(speed, fastest[0]), -np.minimum(speed, fastest[1])
        high = np.maximum(high, joints.before - change)
        low = np.minimum(low, joints.before + change)
        low, high = np.maximum(low, joints.before - change), np.minimum(high, joints.before + change)
        bend = np.clip(joints.bend, -how.bend * change, how.bend * change)
        return low - bend, high - bend
