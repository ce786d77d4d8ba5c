"""The safety filter: the velocities nearest to the desired ones that lead to no collision, a quadratic programme.

In every control step, of all twists of the rigid groups, and rates of the joints of arms that carry them, those are
taken that

    minimise    sum over the end effectors of |velocity - desired velocity|^2 + weight |rates - desired rates|^2
    such that   no point of a payload or end effector approaches an obstacle, the border or an end effector of another
                body faster than the clearance that is left allows (a control barrier function, Ames et al., 2017; see
                `cbf_constraints`),
                |velocity of an end effector| <= speed limit,
                |velocity of an end effector - velocity before| <= acceleration limit x period,
                and of arms, if there are any: what their `JointRows` ask.

The variables are the free velocities alone: rigid constraints, payloads that stay upright and end effectors at one
height hold by construction. Distances are convex in the position, so that the linear rows are conservative. The balls
of the limits are approximated by tangents, written where a solution leaves a ball, 0.1 % inside it for speeds and 2 %
for accelerations: solutions inside are not changed, and one or two rows replace the dozens of fixed facets that a
spatial problem would need. After every solution the exact step is computed, and every distance that it violates
becomes a row.

Where no twist is admissible, rows are relaxed in a strict order of priority. Limits of the hands come before
clearances, these before margins for uncertainty, and obstacles towards which the load itself moves before those that
move towards it. First only those rows are relaxed that ask for a retreat; then margins, for which an uncertain
obstacle is entered a second time without its margin; then, where the load cannot brake in time, all clearances; the
tangents of the limits only where they contradict each other. Rows are relaxed by one slack for every body and
obstacle, and the sum of the squares of the slacks is minimised. A solution with relaxed tangents is moved towards
going on, or braking, until its exact step keeps the limits: commands beyond them could not be executed.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple, Protocol

import daqp
import numpy as np

from comove.arrays import Array, Integers, first_largest
from comove.control.safety.cbf_constraints import RESERVE, SPARE, first_rows, missing_rows, rate
from comove.control.safety.control_points import load_points
from comove.control.safety.qp_workspace import (
    BORDER,
    HANDS,
    LIMIT,
    QP,
    Freedom,
    QPWorkspace,
    Rates,
    Sighting,
    empty_workspace,
)
from comove.control.safety.twists import advanced, group_nodes, nodes_of
from comove.geometry.rotations import matrices
from comove.model.coordinates import HandPoses
from comove.model.scene import Scene
from comove.planning.convex.quadratic import FREE

NOTHING = -2
"""In place of the number of what blocks (an obstacle, or -1 for the border): nothing does."""
MAX_PERIOD = 1.0  # s, far beyond where steps are small
TOLERANCE = 1e-9  # m/s, of rows in the solver
UPRIGHT = 1e-6  # sine of the angle below which a body does not lean
ANGLE_ROUNDING = 1e-12  # rad, by which an angle may grow
DIFFERENCE = 1e-6  # m, over which slopes of errors are taken
N_SHARES = 33  # points that are tried on a line, where limits contradict each other
TOLD = 1e-8  # m/s, relaxing by less is rounding
HARD, RETREATS, MARGINS, CLEARANCES, LIMITS = range(5)  # relaxed rows, by stage
EQUAL = 5  # the solver's word for an equation


class Allowed(NamedTuple):
    """The admissible velocities of a control step.

    Attributes
    ----------
    twists : array, shape (n_groups, 6): velocity of the centre [m/s], angular velocity [rad/s], in the world's frame
    rates : array, shape (n_joints,), rates of the joints [rad/s]
    relaxed : by how much rows had to be relaxed [m/s]; 0 where all could be kept
    blocking : the row of the table with the largest multiplier; -1 for the border, -2 where neither hinders the
        motion
    """

    twists: Array
    rates: Array
    relaxed: float
    blocking: int


class JointState(NamedTuple):
    """Joints of arms at the beginning of a control step.

    Attributes
    ----------
    position, before : arrays, shape (n_joints,), joints and their rates in the last step [rad, rad/s]
    wanted : array, shape (n_joints,), desired rates [rad/s]
    bend : array, shape (n_joints,), motion of joints in the last step beyond the allowed rates, as end effectors go
        straight and joints round; the next step is assumed to do the same [rad/s]
    """

    position: Array
    before: Array
    wanted: Array
    bend: Array


NO_JOINTS = JointState(*np.zeros((4, 0)))


class JointRows(Protocol):
    """The rows that arms add to the filter.

    Attributes
    ----------
    n_joints : number of joints
    n_fixed : number of rows of every step, of which the first `n_equal` are equations
    weight : cost of rates other than the desired ones [m^2]
    """

    n_joints: int
    n_fixed: int
    n_equal: int
    weight: float

    def max_rows(self, n_obstacles: int) -> int:
        """Return the largest number of rows beside the fixed ones."""
        ...

    def write(
        self,
        qp: QP,
        m: int,
        poses: HandPoses,
        joints: JointState,
        sighting: Sighting,
        same: Integers,
    ) -> int:
        """Write the fixed rows first, and others from row `m` on; return the number of rows.

        Obstacle rows are those of the scene, and once more, without their margins, those of uncertain obstacles:
        `same` has the scene's row of each.
        """
        ...


@dataclass(frozen=True)
class FilterSettings:
    """Settings of the safety filter.

    Attributes
    ----------
    gain : approach speed per clearance left [1/s]; at most half a clearance is used up in a period
    braking_share : fraction of the acceleration limit that is assumed for the braking of approaching bodies; the rest
        is for rotations and for several obstacles at once
    retreat_speed : largest speed with which a lost clearance is restored [m/s]
    n_points : points sampled on a body's longest edge, and equally dense ones on the others
    turning_weight : weight of rotation that moves no end effector, as a fraction of the payload's extent squared
    spare : distance kept on top of the scene's clearance [m]
    max_rounds : most rounds of solving and adding missing rows
    as_good : share of a slack by which further rounds may change it; tangents lie as far inside their balls
    margins_weight, clearances_weight, limits_weight : weights of the squared slack of margins for uncertainty, of
        clearances and of limits of the end effectors, against the objective's squared velocities
    """

    gain: float = 10.0
    braking_share: float = 0.5
    retreat_speed: float = 0.25
    n_points: int = 15
    turning_weight: float = 1e-4
    spare: float = 0.0
    max_rounds: int = 20
    as_good: float = 0.02
    margins_weight: float = 1e4
    clearances_weight: float = 1e6
    limits_weight: float = 1e8


class SafetyFilter:
    """The filter of a scene's velocities, step by step.

    Parameters
    ----------
    scene : the scene that defines payload, limits, clearance and constraints; obstacles are passed with every call
    period : length of a control step [s]
    settings : see `FilterSettings`
    joints : rows of the arms that hold the payload; none for free end effectors
    """

    def __init__(
        self,
        scene: Scene,
        period: float = 0.01,
        settings: FilterSettings = FilterSettings(),
        joints: JointRows | None = None,
    ):
        self.scene, self.period, self.settings, self.joints = scene, float(period), settings, joints
        self._points = load_points(scene, settings.n_points)
        self._freedom = _freedom(scene, settings.turning_weight)
        self._leaning = [
            (g, own.mask.up, own.mask.tilt) for g, own in enumerate(scene.groups) if own.mask.up is not None
        ]
        braking = settings.braking_share * scene.acceleration_limit
        self._rates = Rates(
            self.period,
            min(settings.gain, 0.5 / self.period),
            braking,
            braking,
            settings.retreat_speed,
            scene.speed_limit,
            scene.acceleration_limit,
            scene.clearance + settings.spare + RESERVE,
        )
        self._hands = (len(scene.manipulators), 3)
        self._start = scene.nodes_at("start")[: self._hands[0]]
        self._prepare(len(scene.obstacles))

    def _prepare(self, n_obstacles: int) -> None:
        """Allocate the arrays for that many obstacles."""
        joints = self.joints
        self._work: QPWorkspace = empty_workspace(
            self._points,
            self._freedom,
            self._hands[0],
            (n_obstacles, self.scene.obstacles.shape[1]),
            self.settings.max_rounds + 1,
            len(self.scene.sampled)
            + len(self._leaning) * (self.settings.max_rounds + 1)
            + (joints.n_fixed + joints.max_rows(n_obstacles) if joints else 0),
            joints.n_joints if joints else 0,
        )
        n_rows, n = len(self._work.low), self.n_variables
        self._high, self._sense = np.full(n_rows, FREE), np.zeros(n_rows, dtype=np.int32)
        if joints:
            self._work.quadratic[range(n, n + joints.n_joints), range(n, n + joints.n_joints)] = joints.weight
            self._high[: joints.n_equal], self._sense[: joints.n_equal] = 0.0, EQUAL

    @property
    def n_variables(self) -> int:
        """Return the number of variables of the twists; the joints' rates follow them."""
        return int(self._freedom.basis.shape[2])

    def passing(self, factor: float) -> None:
        """Assume braking `factor` times harder towards moving obstacles. They are predicted to pass by."""
        self._rates = self._rates._replace(passing=factor * self._rates.braking)

    def allowed(
        self,
        poses: HandPoses,
        before: Array,
        wanted: Array,
        sighting: Sighting,
        joints: JointState = NO_JOINTS,
    ) -> Allowed:
        """Return the admissible velocities of one control step.

        Parameters
        ----------
        poses : present poses of the groups
        before : array, shape (n_hands, 3), average velocities of the end effectors in the last step [m/s]
        wanted : array, shape (n_hands, 3), desired velocities of the end effectors [m/s]
        sighting : the obstacles
        joints : the joints of the arms, at which these hold the payload
        """
        # As the kernels are compiled for.
        poses = HandPoses(*(np.ascontiguousarray(a, dtype=np.float64) for a in poses))
        before, wanted = (np.ascontiguousarray(a, dtype=np.float64) for a in (before, wanted))
        sighting = Sighting(*(np.ascontiguousarray(a, dtype=np.float64) for a in sighting))
        n_obstacles, unsure = len(sighting.margin), np.flatnonzero(sighting.margin > 0.0)
        if len(unsure):
            sighting = Sighting(*(np.concatenate([array, array[unsure]]) for array in sighting))
            sighting.margin[n_obstacles:] = 0.0
        if len(sighting.margin) != self._work.left.shape[1]:
            self._prepare(len(sighting.margin))
        qp, n = QP(self._points, self._freedom, self._rates, self._work), self.n_variables
        m = first_rows(qp, self.joints.n_fixed if self.joints else 0, poses, before, wanted, sighting)
        if self.joints:
            qp.work.linear[n:] = -self.joints.weight * joints.wanted
            same = np.append(np.arange(n_obstacles), unsure)
            m = self.joints.write(qp, m, poses, joints, sighting, same)
        m = self._leaning_rows(self._sampled_rows(m), poses)
        twists, gives_way, settled = np.empty((len(poses.center), 6)), HARD, False
        self._limits_slack = 0.0
        for _ in range(self.settings.max_rounds):
            z, multipliers, gives_way = self._solved(m, gives_way, before, joints.before, sighting.margin)
            x = np.ascontiguousarray(z[:n])
            n_rows, missed = missing_rows(qp, poses, sighting, x, m, twists)
            if n_rows == m:
                n_rows = self._missing_leaning_rows(m, poses, x)
            settled = n_rows == m
            if settled or (gives_way == LIMITS and self._are_granted(m, n_rows, z)):
                break
            m = n_rows
        if not settled or gives_way == LIMITS:
            z = self._within(z, poses, before, joints.before)
            _, missed = missing_rows(qp, poses, sighting, np.ascontiguousarray(z[:n]), m, twists)
        relaxed = float(qp.work.slack.max(initial=0.0)) if gives_way else 0.0
        relaxed = max(relaxed, missed)
        blocking = self._blocking(multipliers)
        if blocking >= n_obstacles:
            blocking = int(unsure[blocking - n_obstacles])
        return Allowed(twists, z[n:], relaxed if relaxed > TOLD else 0.0, blocking)

    def _leaning_rows(self, m: int, poses: HandPoses) -> int:
        """Write a row for every upright body; return the number of rows."""
        for g, own, tilt in self._leaning:
            lean, slope = self._lean(g, matrices(poses.quaternion[g]) @ own)
            left = self._freedom.scale[g] * (tilt - lean) - RESERVE
            m = self._lean_row(m, g, slope, -rate(left, self._work.gain[g], self._rates))
        return m

    def _missing_leaning_rows(self, m: int, poses: HandPoses, x: Array) -> int:
        """Write a row for every body leaning too far after the step; return the number of rows.

        The admissible set is a cone, and the row its tangent at the orientation after the step.
        """
        for g, own, tilt in self._leaning:
            then, slope = self._lean(g, self._work.after.rotation[g] @ own)
            most = max(tilt, self._lean(g, matrices(poses.quaternion[g]) @ own)[0])
            if then > most + ANGLE_ROUNDING:
                beyond = self._freedom.scale[g] * (then - most) / self.period
                m = self._lean_row(m, g, slope, float(slope @ x) + beyond + SPARE)
        return m

    def _lean(self, g: int, up: Array) -> tuple[float, Array]:
        """Return a direction's angle [rad] from the vertical and its decreases.

        The direction is one of body g. The decreases by the variables, array of shape (n_variables,), are multiplied
        by the lever of the body's rotation.
        """
        about = np.array([-up[1], up[0], 0.0])  # it leans further as it turns about this
        sine = float(np.linalg.norm(about))
        slope = -self._freedom.scale[g] / max(sine, UPRIGHT) * about @ self._freedom.basis[g, 3:]
        return float(np.arctan2(sine, up[2])), slope

    def _lean_row(self, m: int, g: int, slope: Array, low: float) -> int:
        work = self._work
        work.rows[m] = 0.0
        work.rows[m, : len(slope)], work.low[m] = slope, low
        work.owner[m], work.body[m] = HANDS, g
        return m + 1

    def _sampled_rows(self, m: int) -> int:
        """Write a row for every sampled constraint; return the number of rows.

        Its error, whose slope is computed by differences, may not grow faster than the rest of its tolerance allows.
        """
        work, n_dims = self._work, self.scene.n_dims
        now = work.nodes[: self._hands[0]]
        for c in self.scene.sampled:
            moves = [(hand, axis) for hand in c.hands for axis in range(n_dims)]
            samples = np.repeat(now[None], 2 * len(moves), axis=0)
            for k, (hand, axis) in enumerate(moves):
                samples[2 * k : 2 * k + 2, hand, axis] += (DIFFERENCE, -DIFFERENCE)
            error = c.error(np.concatenate([self._start[None], now[None], samples]), n_dims)[1:]
            slopes = (error[1::2] - error[2::2]) / (2 * DIFFERENCE)
            hands = np.array([work.hands[hand, axis] for hand, axis in moves])
            groups = [int(self._points.node_group[hand]) for hand in c.hands]
            work.rows[m] = 0.0
            work.rows[m, : hands.shape[1]] = -slopes @ hands
            work.low[m] = -rate(c.tolerance - float(error[0]) - RESERVE, work.gain[groups].min(), self._rates)
            work.owner[m], work.body[m] = HANDS, groups[0]
            m += 1
        return m

    def _solved(
        self, m: int, gives_way: int, before: Array, rates: Array, margin: Array
    ) -> tuple[Array, Array, int]:
        """Return the solution with m rows, its multipliers, and the relaxation stage."""
        work = self._work
        if gives_way == HARD:
            z, _, flag, info = daqp.solve(
                work.quadratic,
                work.linear,
                work.rows[:m],
                self._high[:m],
                work.low[:m],
                self._sense[:m],
                primal_tol=TOLERANCE,
            )
            if flag > 0:
                return z, info["lam"], HARD
            gives_way = RETREATS
        for stage in range(gives_way, LIMITS + 1):
            found = self._relaxed(m, stage, margin)
            if found is not None:
                return *found, stage
        # The solver has failed in numbers: slow down on the spot.
        fast = np.linalg.norm(before, axis=1).max()
        slower = max(0.0, fast - self.scene.acceleration_limit * self.period) / max(fast, TOLERANCE)
        return slower * np.concatenate([self._going_on(before), rates]), np.zeros(m), LIMITS

    def _going_on(self, before: Array) -> Array:
        """Return the variables that keep the end effectors' velocities `before` best."""
        n = self.n_variables
        flat, quadratic = self._work.hands.reshape(-1, n), self._work.quadratic[:n, :n]
        return np.asarray(np.linalg.solve(quadratic, flat.T @ before.ravel()), dtype=np.float64)

    def _within(self, z: Array, poses: HandPoses, before: Array, rates: Array) -> Array:
        """Return the variables nearest to z whose exact step keeps the limits.

        They lie between z and those that keep the present velocities or, where these are too fast as well, brake.
        """
        balls, hands = self._work.balls[: 2 * len(before)], nodes_of(self.scene, poses)[: len(before)]
        kept = np.concatenate([self._going_on(before), rates])
        share = np.linspace(0.0, 1.0, N_SHARES)[:, None]
        candidates = np.concatenate([z + share * (kept - z), (1.0 - share) * kept])
        for found in candidates:
            after = advanced(poses, self._freedom.basis @ found[: self.n_variables], self.period)
            velocity = (nodes_of(self.scene, after)[: len(before)] - hands) / self.period
            if (np.linalg.norm(np.tile(velocity, (2, 1)) - balls[:, :3], axis=1) <= balls[:, 3]).all():
                return found
        return kept

    def _relaxed(self, m: int, stage: int, margin: Array) -> tuple[Array, Array] | None:
        """Return the solution and multipliers with relaxed rows, None without a solution.

        The slacks are written on the work.
        """
        work, n = self._work, len(self._work.linear)
        owner, body, low = work.owner[:m], work.body[:m], work.low[:m]
        unsure = np.append(margin, np.zeros(3))[owner] > 0.0  # the others count from the end
        gives = (low > 0.0) | (unsure & (stage >= MARGINS)) | (stage >= CLEARANCES)
        soft = (owner != LIMIT) & gives
        key = body * (work.slack.shape[1]) + owner % work.slack.shape[1]
        if stage == LIMITS:
            key[owner == LIMIT] = work.slack.size
            soft = self._sense[:m] != EQUAL
        kinds, which = np.unique(key[soft], return_inverse=True)
        size = n + len(kinds)
        quadratic, linear, rows = np.zeros((size, size)), np.zeros(size), np.zeros((m, size))
        quadratic[:n, :n], linear[:n], rows[:, :n] = work.quadratic, work.linear, work.rows[:m]
        weigh = self.settings
        weights = np.where(kinds == work.slack.size, weigh.limits_weight, weigh.clearances_weight)
        weights[which[unsure[soft]]] = weigh.margins_weight
        quadratic[range(n, size), range(n, size)] = 1.0
        rows[np.flatnonzero(soft), n + which] = 1.0 / np.sqrt(weights)[which]
        z, _, flag, info = daqp.solve(
            quadratic, linear, rows, self._high[:m], low, self._sense[:m], primal_tol=TOLERANCE
        )
        if flag <= 0:
            return None
        work.slack[:] = 0.0
        slack = np.maximum(z[n:] / np.sqrt(weights), 0.0)
        own = kinds < work.slack.size
        work.slack.ravel()[kinds[own]] = slack[own]
        self._limits_slack = float(slack[~own].max(initial=0.0))
        return z[:n], info["lam"]

    def _are_granted(self, first: int, last: int, z: Array) -> bool:
        """Return whether a solution's slacks cover further rows too. It relaxes all and would be found again."""
        work, new = self._work, slice(first, last)
        owner, lacking = work.owner[new], work.low[new] - work.rows[new] @ z
        slack = work.slack[work.body[new], owner % work.slack.shape[1]]
        granted = np.where(owner == LIMIT, self._limits_slack, slack)
        return bool((lacking <= (1.0 + self.settings.as_good) * granted + TOLERANCE).all())

    def _blocking(self, multipliers: Array) -> int:
        """Return the owner of the row with the largest multiplier.

        It is `NOTHING` where no obstacle and no border hinders.
        """
        owner = self._work.owner[: len(multipliers)]
        size = np.where(owner >= BORDER, np.abs(multipliers), 0.0)
        if not len(size) or size.max() <= TOLERANCE:
            return NOTHING
        return int(owner[first_largest(size)])


def _freedom(scene: Scene, turning_weight: float) -> Freedom:
    """Return the degrees of freedom of the groups of a scene."""
    n_dims, n_groups, up = scene.n_dims, len(scene.groups), scene.n_dims - 1
    node_group, node_point = group_nodes(scene)
    level, (pairs, apart) = scene.level_with(scene.groups), scene.kept_apart
    shared: dict[int, int] = {}
    basis = np.zeros((n_groups, 6, 6 * n_groups))
    axis, scale = np.full(n_groups, -1, dtype=np.int64), np.ones(n_groups)
    idle, spread, lever = np.zeros((n_groups, 3, 3)), np.zeros(n_groups), np.ones(n_groups)
    n = 0
    for g, group in enumerate(scene.groups):
        normal, ways = group.mask.normal, np.eye(3)[:n_dims]
        for k, way in enumerate(ways if normal is None else np.linalg.svd(normal[None])[2][1:]):
            if normal is None and k == up and level[g] in shared:
                basis[g, k, shared[level[g]]] = 1.0
                continue
            if normal is None and k == up:
                shared[level[g]] = n
            basis[g, :3, n] = way
            n += 1
        if group.orientation in ("none", "fixed"):
            continue
        held = group.grasps - group.grasps.mean(axis=0)
        own = node_point[node_group == g]
        scale[g] = max(np.linalg.norm(own - group.grasps.mean(axis=0), axis=1).max(), 1e-6)
        about = group.aligned(held)[:, :2] if group.orientation == "vertical" else held
        spread[g] = np.linalg.norm(about, axis=1).max()
        lever[g] = max(1.0, scale[g] / max(spread[g], 1e-3 * scale[g]))
        if group.orientation == "axis":
            axis[g] = n
            n += 2
            continue
        turns = np.eye(3)[2:] if group.orientation in ("plane", "vertical") else np.eye(3)
        for turn in turns if group.mask.axis is None else group.mask.axis[None]:
            basis[g, 3:, n] = turn / scale[g]
            n += 1
        # Turning that hands hardly feel is made to cost a little.
        inertia = (held**2).sum() * np.eye(3) - held.T @ held
        values, vectors = np.linalg.eigh(inertia)
        least = turning_weight * scale[g] ** 2
        idle[g] = (vectors * np.maximum(least - values, 0.0)) @ vectors.T
    return Freedom(
        np.ascontiguousarray(basis[:, :, :n]),
        axis,
        scale,
        idle,
        spread,
        lever,
        pairs,
        apart + RESERVE,
        *scene.workspace,
    )
