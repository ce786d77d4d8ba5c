"""The verified motion of a payload, and error bounds of its grasps.

All of it follows from the verified curve and its bounds. A rod of the payload is a capsule of coal, a solid a box or
the hull of its corners, placed by the keypoints that they span.

Let e be the difference between a grasp frame's position and its position in the motion of the end effectors. At
instants t_i of a grid, e and e' are computed. Between two of them, h apart, e' stays within h^2/8 max|e'''| of its
chord, so that

    |e(t)| <= max |e(t_i)| + h/2 (max |e'(t_i)| + h^2/8 max|e'''|),

and the angle between the orientations grows no faster than the difference of the angular velocities, to which the
same applies. The third derivatives are bounded by those of the end effectors' motion plus those of the arm: every
derivative of m-th order of a serial chain's position by its joints is a product z1 x (z2 x ... (zm x r)) of unit axes
and a vector to the end effector no longer than its reach L (1 where joints slide); with S1, S2, S3 the sums of the
joints' |q'|, |q''|, |q'''|,

    |p'''| <= L (S3 + 3 S1 S2 + S1^3),     |omega''| <= S3 + 3 S1 S2 + S1^3.

The grid is that of the samples, made finer where this is not tight enough.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, lru_cache
from itertools import combinations
from typing import Any, NamedTuple, Protocol

import coal
import numpy as np
from numpy.typing import NDArray

from comove.arrays import Array, Integers
from comove.compiled import kernel
from comove.dmp.system import N_INTERVALS
from comove.geometry.solids import N_CORNERS
from comove.model.coordinates import load_coordinates
from comove.model.grasp import keypoints_of
from comove.model.motion import CoordinatedMotion
from comove.model.scene import Scene
from comove.robots.model import Arm, Robot
from comove.robots.motion import JointCurve, Ranges, subdivided
from comove.robots.verification.kinematics import joint_motions, on_joints, reaches_of
from comove.verification.bounds import NodeBounds, node_bounds, turn_jerk


class LoadMotion(Protocol):
    """A payload in motion, for the clearance certificate: `Carried`, or one at rest."""

    @property
    def bounds(self) -> Ranges:
        """Return bounds of keypoints' speed and acceleration [m/s, m/s^2], of width 2."""

    def nodes(self, time: Array) -> Array:
        """Compute the positions of the keypoints; array, shape (n_steps, n_nodes, 3) [m]."""


class HeldPlaces(NamedTuple):
    """The places where end effectors hold a payload. Rotations and spins are None without a grasp.

    Attributes
    ----------
    positions, velocities : arrays, shape (n_steps, n_manipulators, 3) [m, m/s]
    rotations : array, shape (n_steps, n_manipulators, 3, 3), of the grasp frames
    spins : array, shape (n_steps, n_manipulators, 3), their angular velocities [rad/s]
    """

    positions: Array
    velocities: Array
    rotations: Array | None
    spins: Array | None


@dataclass(frozen=True, eq=False)
class Carried:
    """A verified motion of end effectors and payload, by time [s].

    Attributes
    ----------
    motion : CoordinatedMotion on a spatial scene
    """

    motion: CoordinatedMotion

    @classmethod
    def straight(cls, scene: Scene) -> Carried:
        """Return the straight motion on a scene, with the common ends."""
        return cls(CoordinatedMotion.straight(scene, load_coordinates(scene)))

    @cached_property
    def time(self) -> Array:
        """Return the times of the knots, between which the bounds hold; array, shape (n_knots,) [s]."""
        return np.linspace(0.0, self.motion.scene.duration, N_INTERVALS + 1)

    def nodes(self, time: Array) -> Array:
        """Compute the positions of the keypoints; array, shape (n_steps, n_nodes, 3) [m], end effectors first."""
        q, _, _ = self.motion.at(time / self.motion.scene.duration)
        return self.motion.coordinates.nodes(np.ascontiguousarray(q.T[None]))[0]

    def hands(self, time: Array) -> HeldPlaces:
        """Compute end effectors' places on the payload at instants, shape (n_steps,) [s]."""
        scene, (nodes, velocity, _) = self.motion.scene, self._motion(time)
        n_hands, grasp = len(scene.manipulators), scene.grasp
        found = HeldPlaces(nodes[:, :n_hands], velocity[:, :n_hands], None, None)
        if grasp is None:
            return found
        spin = grasp.spins(nodes, velocity[..., None])[..., 0]
        spins = np.where(grasp.turning[:, None], spin[:, None], 0.0)
        return found._replace(rotations=grasp.hand_rotations(nodes), spins=spins)

    def _motion(self, time: Array) -> Array:
        """Compute positions, velocities and accelerations of all keypoints; array, shape (3, n_steps, n_nodes, 3)."""
        duration = self.motion.scene.duration
        motion = self.motion.coordinates.motion(self.motion.at(time / duration))
        return motion / np.array([1.0, duration, duration**2])[:, None, None, None]

    @cached_property
    def bounds(self) -> Ranges:
        """Return bounds of keypoints' speed and acceleration [m/s, m/s^2], of width 2."""
        duration = self.motion.scene.duration
        bounds = self._speeds / duration, self._bounds.acceleration / duration**2
        return Ranges(self.time, np.column_stack([bound.max(axis=1) for bound in bounds]))

    @cached_property
    def jerk(self) -> Ranges:
        """Return bounds of the third derivative of end effectors' positions [m/s^3]."""
        n_hands = len(self.motion.scene.manipulators)
        return Ranges(self.time, self._bounds.jerk[:, :n_hands] / self.motion.scene.duration**3)

    @cached_property
    def swing(self) -> Ranges:
        """Bound the second derivative of the payload's angular velocity [rad/s^3]; array of width 1.

        Where it turns in any way, that of its coordinates; where it turns about the vertical, of its heading.

        The unit vector u along a planar vector r has ``|u'''| <= a3 + 2 sqrt(3) a1 a2 + 3 a1^3``, a_i the bounds of
        the derivatives of r over the least |r| (see `comove.verification.bounds`), and its angle has
        ``|psi'''| <= |u'''| + |u'|^3``.
        """
        scene, time = self.motion.scene, self.time
        if scene.grasp is not None and scene.grasp.keypoints:
            return Ranges(time, turn_jerk(self.motion, scene.grasp.keypoints[0])[:, None] / scene.duration**3)
        if scene.grasp is None or len(scene.grasp.holders) < 2:
            return Ranges(time, np.zeros((N_INTERVALS, 1)))
        pair = list(scene.grasp.holders[:2])
        hands = self.knots[0][:, pair, :2]
        apart = np.linalg.norm(hands[:, 0] - hands[:, 1], axis=1)
        change = self._speeds[:, pair].sum(axis=1)
        least = np.minimum(apart[1:], apart[:-1]) - 0.5 / N_INTERVALS * change
        sums = change, *(bound[:, pair].sum(axis=1) for bound in self._bounds)
        with np.errstate(divide="ignore", invalid="ignore"):
            first, second, third = (np.where(least > 0, x / least, np.inf) for x in sums)
        bound = third + 2 * np.sqrt(3.0) * first * second + 4 * first**3
        return Ranges(time, bound[:, None] / scene.duration**3)

    @cached_property
    def knots(self) -> Array:
        """Return the nodes at the knots and their derivatives in unit duration; array, shape (3, n_knots, n_nodes,
        3) [m].
        """
        return self.motion.nodes_at_knots

    @cached_property
    def _bounds(self) -> NodeBounds:
        return node_bounds(self.motion)

    @cached_property
    def _speeds(self) -> Array:
        """Bound every keypoint's speed between knots in unit duration; array, shape (n_intervals, n_nodes)."""
        speed = _sizes(self.knots[1])
        return np.maximum(speed[1:], speed[:-1]) + 0.5 / N_INTERVALS * self._bounds.acceleration


class LoadShape(NamedTuple):
    """A shape and the nodes that define its pose.

    Attributes
    ----------
    geometry : coal.Capsule, coal.Box or coal.Convex
    nodes : numbers of both end nodes of a rod; of the eight corners of a box, numbered in binary by the sides they
        are on; of two corners of a hull, the third and the second again
    """

    geometry: Any
    nodes: tuple[int, ...]


def load_shapes(carried: Carried, thin: float = 1e-6) -> list[LoadShape]:
    """Return the payload's shapes in their largest sizes. No rod is thinner than `thin` [m]."""
    body, nodes = carried.motion.scene.body, carried.knots[0]
    shapes = []
    for (a, b), radius in zip(body.edges.tolist(), body.radii.tolist(), strict=True):
        if a != b:
            shapes.append(LoadShape(coal.Capsule(max(radius, thin), _largest(nodes, a, b)), (a, b)))
    boxes = body.solids if body.solids.shape[1] == N_CORNERS else body.solids[:0]
    for corners in body.solids[len(boxes) :]:
        spanned = tuple(corners[k] for k in keypoints_of(nodes[0, corners]))
        shapes.append(_hull(nodes[0, np.unique(corners)], nodes[:1], (*spanned, spanned[1])))
    for corners in boxes.tolist():
        size = [_largest(nodes, corners[0], corners[side]) for side in (1, 2, 4)]
        shapes.append(LoadShape(coal.Box(*size), tuple(corners)))
    return shapes


def _hull(points: Array, nodes: Array, spanned: tuple[int, ...]) -> LoadShape:
    """Return the hull of points (n, 3) in the spanning keypoints' frame."""
    (turn,), (middle,) = placements(nodes, spanned)
    return LoadShape(hull_shape((points - middle) @ turn), spanned)


def hull_shape(points: Array) -> Any:
    """Return the hull of points (n, 3) [m] as a coal shape."""
    vertices = coal.StdVec_Vec3s()
    vertices.extend(list(points))
    return coal.Convex.convexHull(vertices, True, "Qt")


def _largest(nodes: Array, a: int, b: int) -> float:
    return float(np.linalg.norm(nodes[:, a] - nodes[:, b], axis=1).max())


def placements(nodes: Array, spanned: tuple[int, ...]) -> tuple[Array, Array]:
    """Compute orientations and centres of a shape from its keypoints.

    Parameters
    ----------
    nodes : array, shape (n_steps, n_nodes, 3) [m]
    spanned : keypoints as in `LoadShape`

    Returns
    -------
    array, shape (n_steps, 3, 3), rotations, and array, shape (n_steps, 3), centres [m]
    """
    second, third = spanned[1:3] if len(spanned) > 2 else (-1, -1)
    return _placements(np.ascontiguousarray(nodes), spanned[0], second, third, spanned[-1])


@kernel
def _placements(nodes: Array, first: int, second: int, third: int, last: int) -> tuple[Array, Array]:
    """Return what `placements` does; of a rod, `second` is negative, and its z axis is along it."""
    turns, middles = np.empty((nodes.shape[0], 3, 3)), np.empty((nodes.shape[0], 3))
    x, z, aside = np.empty(3), np.empty(3), np.empty(3)
    for t in range(nodes.shape[0]):
        if second < 0:
            _direction(nodes[t], first, last, z)
            least = 0  # the axis that is least along the rod; rounding does not decide
            for axis in range(1, 3):
                if abs(z[axis]) < abs(z[least]) - 1e-9:
                    least = axis
            for axis in range(3):
                aside[axis] = 1.0 if axis == least else 0.0
            _normal(z, aside, x)
        else:
            _direction(nodes[t], first, second, x)
            _direction(nodes[t], first, third, aside)
            _normal(x, aside, z)
        for axis in range(3):
            i, j = (axis + 1) % 3, (axis + 2) % 3
            turns[t, axis, 0], turns[t, axis, 2] = x[axis], z[axis]
            turns[t, axis, 1] = z[i] * x[j] - z[j] * x[i]
            middles[t, axis] = 0.5 * (nodes[t, first, axis] + nodes[t, last, axis])
    return turns, middles


@kernel
def _direction(points: Array, a: int, b: int, unit: Array) -> None:
    """Write the unit vector from a point to another."""
    for axis in range(3):
        unit[axis] = points[b, axis] - points[a, axis]
    _normalise(unit)


@kernel
def _normal(a: Array, b: Array, unit: Array) -> None:
    """Write the unit vector along a x b."""
    unit[0], unit[1], unit[2] = (
        a[1] * b[2] - a[2] * b[1],
        a[2] * b[0] - a[0] * b[2],
        a[0] * b[1] - a[1] * b[0],
    )
    _normalise(unit)


@kernel
def _normalise(vector: Array) -> None:
    size = np.sqrt(vector[0] ** 2 + vector[1] ** 2 + vector[2] ** 2)
    for axis in range(3):
        vector[axis] /= size


def leverage(carried: Carried) -> float:
    """Return the largest ratio of payload to end-effector errors [m and rad].

    Two end effectors, each with a position error e, turn the payload by up to 2e over their distance; about the line
    between the two, the payload turns with the end effectors themselves.
    """
    scene = carried.motion.scene
    nodes = scene.nodes_at("start")
    hands = nodes[list(scene.file.holder_numbers)]
    corners = nodes[len(scene.manipulators) :]
    if not len(hands) or not len(corners):
        return 1.0
    beyond = np.linalg.norm(corners[:, None] - hands[None], axis=2).min(axis=1).max()
    apart = [np.linalg.norm(hands[i] - hands[j]) for i in range(len(hands)) for j in range(i)]
    return float(1.0 + beyond * (1.0 + (2.0 / min(apart) if apart else 0.0)))


def payload_shift(carried: Carried, off: float, turn: float) -> float:
    """Bound the displacement of a payload's points by its end effectors [m].

    Each of its grasps is displaced by at most `off`, whether end effectors that disagree slip or give way. Of two
    grasps, a apart, the line between them turns by a chord of at most 2 off / a, and the payload about it by at most
    `turn`, as far as any end effector. A point b away from the nearer of them and c from that line moves at most

        off + b 2 off / a + c turn.

    This holds for every two holders. About a single one the payload turns with it: off + b turn.

    Parameters
    ----------
    off, turn : largest displacement [m] and rotation [rad] of an end effector that holds it
    """
    if off == 0.0 == turn:
        return 0.0
    scene = carried.motion.scene
    nodes = scene.nodes_at("start")
    hands, corners = nodes[list(scene.file.holder_numbers)], nodes[len(scene.manipulators) :]
    if not len(hands) or not len(corners):
        return off
    away = np.linalg.norm(corners[:, None] - hands, axis=2)
    bounds = [off + away[:, 0] * turn] if len(hands) == 1 else []
    for i, j in combinations(range(len(hands)), 2):
        line = hands[j] - hands[i]
        apart = float(np.linalg.norm(line))
        aside = np.linalg.norm(np.cross(corners - hands[i], line / apart), axis=1)
        bounds.append(off + away[:, [i, j]].min(axis=1) * (2.0 * off / apart) + aside * turn)
    return float(min(bound.max() for bound in bounds))


class Errors(NamedTuple):
    """Errors of the end effectors relative to their places on the payload. Lengths are in m, angles in rad.

    Attributes
    ----------
    time : array, shape (n_steps,), the grid [s]
    is_sample : array, shape (n_steps,), whether an instant is a sample of the joint motion
    position, turn : arrays, shape (n_steps, n_hands), errors on the grid; turn is 0 if no orientation is required
    position_bound, turn_bound : arrays, shape (n_steps - 1, n_hands), bounds between neighbouring instants
    apart_bound : bound of the difference of two end effectors' position errors
    hands : array, shape (n_steps, n_hands, 3), positions of the grasp frames
    """

    time: Array
    is_sample: NDArray[np.bool_]
    position: Array
    turn: Array
    position_bound: Array
    turn_bound: Array
    apart_bound: float
    hands: Array


def holding_errors(
    robot: Robot,
    arms: tuple[Arm, ...],
    carried: Carried,
    curve: JointCurve,
    *,
    tight: float = 3e-6,
    finest: int = 100,
) -> Errors:
    """Compare the arms' grasp frames with the motion of the end effectors.

    Parameters
    ----------
    arms : arms in the order of the end effectors
    curve : joint positions by time [s], cubic between samples
    tight : by which bounds between samples may exceed the errors [m and rad]
    finest : parts, at most, into which the time between two samples is divided for that
    """
    jerk, turn_jerk = _third_derivatives(robot, arms, carried, curve)
    time, pieces = _grid(curve.x, np.maximum(jerk, turn_jerk).max(axis=1), tight, finest)
    jerk, turn_jerk = jerk[pieces], turn_jerk[pieces]
    places, rotations, velocities, spins = _grasp_frames(robot, arms, *curve.orders(time, 1))
    held = carried.hands(time)
    error, drift = places - held.positions, velocities - held.velocities
    turn, turning = np.zeros(error.shape[:2]), np.zeros_like(error)
    if held.rotations is None or held.spins is None:
        turn_jerk = np.zeros_like(turn_jerk)
    else:
        away = (rotations - held.rotations).reshape(*turn.shape, 9)
        chord = _sizes(away) / np.sqrt(8.0)  # sine of half the angle
        turn, turning = 2 * np.arcsin(np.minimum(chord, 1.0)), spins - held.spins
    half = 0.5 * np.diff(time)
    apart = [
        _between(
            _sizes(error[:, i] - error[:, j]),
            _sizes(drift[:, i] - drift[:, j]),
            jerk[:, i] + jerk[:, j],
            half,
        ).max()
        for i, j in combinations(range(len(arms)), 2)
    ]
    return Errors(
        time,
        np.append(np.diff(pieces, prepend=-1) > 0, True),
        _sizes(error),
        turn,
        _between(_sizes(error), _sizes(drift), jerk, half[:, None]),
        _between(turn, _sizes(turning), turn_jerk, half[:, None]),
        float(max(apart, default=0.0)),
        places,
    )


def _between(error: Array, rate: Array, jerk: Array, half: Array) -> Array:
    """Bound an error between instants 2 `half` apart. Values and rates are those at the instants."""
    rate = np.maximum(rate[1:], rate[:-1]) + 0.5 * half**2 * jerk
    return np.maximum(error[1:], error[:-1]) + half * rate


def _third_derivatives(
    robot: Robot, arms: tuple[Arm, ...], carried: Carried, curve: JointCurve
) -> tuple[Array, Array]:
    """Bound |e'''| and the third derivative of the angle error between samples; arrays, shape (n_intervals,
    n_hands).
    """
    reaches = reaches_of(robot)
    first = np.cumsum([0, *(len(arm.columns) for arm in arms)])
    columns = np.concatenate([arm.columns for arm in arms])
    sums = _sums(curve.c[0], curve.fastest[0], curve.bends, first, columns, reaches.slides)
    of_all, of_turning = (s3 + 3 * s1 * s2 + s1**3 for s1, s2, s3 in sums)
    lengths = np.array([reaches.of_hand(arm)[0].max() for arm in arms])  # 1 at least where a joint slides
    begin, end = curve.x[:-1], curve.x[1:]
    swing = np.zeros((len(begin), len(arms)))
    if (grasp := carried.motion.scene.grasp) is not None:
        swing[:, grasp.turning] = carried.swing.over(begin, end)
    return lengths * of_all + carried.jerk.over(begin, end), of_turning + swing


@kernel
def _sums(
    cubic: Array, rate: Array, bend: Array, first: Integers, columns: Integers, slides: NDArray[np.bool_]
) -> Array:
    """Sum bounds of arms' joints between samples: of all joints, then of those that turn.

    Parameters
    ----------
    cubic, rate, bend : arrays, shape (n_intervals, n_joints), coefficients of t^3 and largest rates, and
        (n_intervals + 1, n_joints), second derivatives at the samples
    first, columns : arrays, shape (n_arms + 1,) and (n,), columns of each arm's joints, one arm after the other
    slides : array, shape (n_joints,), whether a joint is prismatic

    Returns
    -------
    array, shape (2, 3, n_intervals, n_arms), sums of first to third derivatives
    """
    n_arms = first.shape[0] - 1
    sums = np.zeros((2, 3, rate.shape[0], n_arms))
    for t in range(rate.shape[0]):
        for i in range(n_arms):
            for j in columns[first[i] : first[i + 1]]:
                bent, after, jerk = bend[t, j], bend[t + 1, j], 6.0 * abs(cubic[t, j])
                if bent < after or np.isnan(after):
                    bent = after
                for turning in range(2):
                    if turning == 0 or not slides[j]:
                        sums[turning, 0, t, i] += rate[t, j]
                        sums[turning, 1, t, i] += bent
                        sums[turning, 2, t, i] += jerk
    return sums


def _grid(samples: Array, jerk: Array, tight: float, finest: int) -> tuple[Array, Integers]:
    """Compute instants fine enough for bounds as `tight`; return pieces' sample intervals too."""
    parts = np.ceil(np.diff(samples) * np.cbrt(jerk / (16 * tight)))
    parts = np.clip(np.nan_to_num(parts, nan=finest, posinf=finest), 1, finest)
    return subdivided(samples, parts.astype(int))


def _grasp_frames(
    robot: Robot, arms: tuple[Arm, ...], positions: Array, rates: Array
) -> tuple[Array, Array, Array, Array]:
    """Compute the grasp frames' positions, orientations, velocities and spins in the scene."""
    return on_joints(joint_motions(robot, positions, rates), *_grasps(robot, arms))


@lru_cache(maxsize=8)
def _grasps(robot: Robot, arms: tuple[Arm, ...]) -> tuple[Integers, Array, Array]:
    """Return the joints that carry the grasps, and their placements there [m]."""
    joints, grasps = zip(*map(robot.grasp_frame, arms), strict=True)
    turns, shifts = ([getattr(grasp, name) for grasp in grasps] for name in ("rotation", "translation"))
    return np.array(joints, dtype=np.int64), np.array(turns), np.array(shifts)


def _sizes(vectors: Array) -> Array:
    return np.sqrt(np.einsum("...i,...i", vectors, vectors))
