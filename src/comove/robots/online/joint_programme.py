"""The joint programme: rates of the joints nearest to the wanted ones that keep hold of the load and touch nothing.

It is the twist programme of `comove.control.safety` with the rates of all joints as further variables. In every step

    minimise    sum over the hands of |velocity - wanted|^2 + weight |joint rates - wanted rates|^2
    such that   each hand moves and turns as the load and its grasp do (equations, never relaxed),
                joints keep their ranges, speeds and accelerations, so that they can always brake in time,
                links keep clear of obstacles, of the load and of each other (`link_rows`),
                and all that the twist programme asks of the load.

Where nothing is admissible, rows are relaxed in the twist programme's order.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from comove.control.safety.qp_workspace import LIMIT, Sighting
from comove.control.safety.twist_qp import (
    ENDLESS,
    EQUAL,
    Allowed,
    Assembled,
    ProgrammeSettings,
    TwistProgramme,
)
from comove.control.safety.twists import nodes_of
from comove.errors import SceneError
from comove.model.coordinates import HandPoses
from comove.model.grasp import Grasp
from comove.model.scene import Scene
from comove.robots.online.link_rows import LinkNeeds, clearances_along, empty_rows, hand_jacobians, link_rows
from comove.robots.search.following import Arms

Array = NDArray[np.float64]


@dataclass(frozen=True)
class JointSettings:
    """Settings of the joint programme.

    Attributes
    ----------
    weight : of joint rates that differ from the wanted ones, beside velocities of hands [m^2]
    near : clearance from which on links are looked at [m]
    gain : approach of a joint to its limit per range that is left [1/s]
    share : of the joints' accelerations that is used, and of these again when braking before a limit
    speed : share of the joints' speeds that is used
    passing : how many times harder braking is assumed towards what moves while it is foreseen to pass by
    bend : share of a change of rates in a step that may be expected to come of itself, as joints go round
    load : settings of the twist programme
    """

    weight: float = 0.02
    near: float = 0.3
    gain: float = 5.0
    share: float = 0.9
    speed: float = 0.98
    passing: float = 6.0
    bend: float = 0.85
    load: ProgrammeSettings = field(default_factory=lambda: ProgrammeSettings(spare=5e-4))


@dataclass(frozen=True, eq=False)
class JointState:
    """The state of the joints at the beginning of a step.

    Attributes
    ----------
    position, before : arrays, shape (n_joints,), joints and their rates in the last step [rad, rad/s]
    wanted : array, shape (n_joints,), rates that are wanted [rad/s]
    bend : array, shape (n_joints,), what joints moved in the last step beyond the rates that were allowed, as hands
        go straight and joints round; the next step is taken to do the same [rad/s]
    """

    position: Array
    before: Array
    wanted: Array
    bend: Array


class JointProgramme(TwistProgramme):
    """A solver that computes the allowed rates of the joints of arms that carry a load, step by step.

    Parameters
    ----------
    scene : the scene whose load, hands, limits and clearance are kept; its hands hold one rigid body
    arms : the arms, in the order of the hands
    grasp : how the hands turn with the load
    period : length of a control step [s]

    Attributes
    ----------
    rates : array, shape (n_joints,), the joint rates that the last call allowed [rad/s]
    needs : clearances that links keep

    Raises
    ------
    SceneError
        If the hands do not hold one rigid body.
    """

    def __init__(
        self,
        scene: Scene,
        arms: Arms,
        grasp: Grasp,
        period: float,
        settings: JointSettings = JointSettings(),
    ):
        super().__init__(scene, period, settings.load)
        if len(scene.groups) != 1:
            raise SceneError(
                "arms are run with one rigid load in all hands, and here are several",
                file=scene.path,
                key=scene.words.key("load"),
                way_out="let all hands hold it, or run the scene without a robot",
            )
        self.arms, self.grasp, self.joint_settings = arms, grasp, settings
        everything = np.full(len(scene.obstacles), arms.around.clearance)
        self.needs = LinkNeeds(
            everything, arms.around.clearance, arms.around.clearance, self.joint_settings.near
        )
        self.rates, self._room = np.zeros(len(arms.chains.lower)), (-1, -1)

    def expect(self, passes: bool) -> None:
        """Say whether what moves is foreseen to pass by: then it may come near faster than arms could stop for it."""
        harder = self.joint_settings.passing if passes else 1.0
        self._rates = self._rates._replace(passing=harder * self._rates.braking)

    def follow(self, joints: Array, nodes: Array) -> None:
        """Ask for no more clearance among what stands than a verified motion has by the capsules of its links.

        The verification knows the exact bodies, which are slimmer.

        Parameters
        ----------
        joints, nodes : arrays, shape (n_steps, n_joints) and (n_steps, n_nodes, 3), along the motion [rad, m]
        """
        full = self.arms.around.clearance
        keep, other, still = clearances_along(self.arms, joints, nodes, self.scene.obstacles, full)
        keep[self.scene.moving[self.scene.owners]] = full
        self.needs = LinkNeeds(keep, other, still, self.joint_settings.near)

    def allowed_rates(
        self, poses: HandPoses, joints: JointState, before: Array, wanted: Array, sighting: Sighting
    ) -> Allowed:
        """Return the allowed twist of one control step; the rates of the joints are then in `rates`.

        Parameters
        ----------
        poses, before, wanted, sighting : as in `TwistProgramme.allowed`
        joints : the joints, at which the hands are at the load
        """
        self._asking, self._looked = (poses, joints, sighting), False
        return self.allowed(poses, before, wanted, sighting)

    def _look(self) -> None:
        """Write what the arms ask for, once a step: the load's freedom is that of its present pose by now.

        Their rows come first, and leave room for those of the load.
        """
        (poses, joints, sighting), arms, work = self._asking, self.arms, self._work
        n, n_joints, n_hands = len(work.linear), len(joints.position), self._hands[0]
        jacobians, _ = hand_jacobians(arms, joints.position)
        if (len(sighting.margin), len(work.low)) != self._room:
            self._make_room(len(sighting.margin))
        links, whole, weight = self._links, self._whole, self.joint_settings.weight
        nodes, (least, largest) = nodes_of(self.scene, poses), self._joint_bounds(joints)
        count = link_rows(
            arms,
            joints.position,
            (least, largest),
            nodes,
            (self._freedom.basis[0], poses.center[0]),
            sighting,
            (self.needs, self._rates),
            links,
        )
        whole.quadratic[:n, :n], whole.linear[:n] = work.quadratic, work.linear
        whole.linear[n:] = -weight * joints.wanted
        whole.high[:], whole.sense[:], whole.owner[:], whole.body[:] = ENDLESS, 0, LIMIT, 0
        whole.rows[:count], whole.low[:count] = links.rows[:count], links.low[:count]
        whole.owner[:count] = links.owner[:count]
        last = count + 2 * n_joints
        whole.rows[count:last] = self._own_limits
        whole.low[count : count + n_joints], whole.low[count + n_joints : last] = least, -largest
        self._n_own = last + 6 * n_hands
        hold = slice(last, self._n_own)
        whole.rows[hold] = self._hold(jacobians)
        whole.low[hold], whole.high[hold], whole.sense[hold] = 0.0, 0.0, EQUAL
        self._looked = True

    def _make_room(self, n_obstacles: int) -> None:
        """Allocate the arrays for that many obstacles."""
        n, n_joints = len(self._work.linear), len(self.rates)
        self._room, self._links = (n_obstacles, len(self._work.low)), empty_rows(self.arms, n_obstacles, n)
        ones = np.hstack([np.zeros((n_joints, n)), np.eye(n_joints)])
        self._own_limits = np.concatenate([ones, -ones])
        size = len(self._links.low) + 2 * n_joints + 6 * self._hands[0] + len(self._work.low)
        self._whole = Assembled(
            np.diag(np.full(n + n_joints, self.joint_settings.weight)),
            np.zeros(n + n_joints),
            np.zeros((size, n + n_joints)),
            np.zeros(size),
            np.zeros(size),
            np.zeros(size, dtype=np.int32),
            np.zeros(size, dtype=np.int64),
            np.zeros(size, dtype=np.int64),
        )

    def _joint_bounds(self, joints: JointState) -> tuple[Array, Array]:
        """Return the least and the largest rates; arrays, shape (n_joints,) [rad/s]."""
        chains, how = self.arms.chains, self.joint_settings
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

    def _assembled(self, m: int) -> Assembled:
        """Return the programme with the rows of the arms, and the first m of the load."""
        if not self._looked:
            self._look()
        work, whole, first, last = self._work, self._whole, self._n_own, self._n_own + m
        n = len(work.linear)
        whole.rows[first:last, :n], whole.rows[first:last, n:] = work.rows[:m], 0.0
        whole.low[first:last] = work.low[:m]
        whole.owner[first:last], whole.body[first:last] = work.owner[:m], work.body[:m]
        return Assembled(
            whole.quadratic,
            whole.linear,
            whole.rows[:last],
            whole.low[:last],
            whole.high[:last],
            whole.sense[:last],
            whole.owner[:last],
            whole.body[:last],
        )

    def _hold(self, jacobians: Array) -> Array:
        """Return the equations by which hands move and turn with the load; array, shape (6 n_hands, n + n_joints)."""
        velocities = self._work.hands
        n_hands, _, n = velocities.shape
        rows = np.zeros((n_hands, 6, n + jacobians.shape[2]))
        rows[:, :, n:] = jacobians
        rows[:, :3, :n] = -velocities
        rows[self.grasp.turning, 3:, :n] = -self._freedom.basis[0, 3:]
        return rows.reshape(6 * n_hands, -1)

    def _taken(self, z: Array) -> Array:
        """Keep the rates of the joints, and return the variables of the twist."""
        n = len(self._work.linear)
        self.rates = z[n:].copy()
        return np.ascontiguousarray(z[:n])
