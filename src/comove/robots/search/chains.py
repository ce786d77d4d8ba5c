"""Kinematics, inverse kinematics and dynamics of serial chains, as arrays and kernels.

A search evaluates thousands of candidate motions a second, too many for one call to Pinocchio per configuration. The
verification uses Pinocchio; the tests compare the two.

Notation: q joint positions, J the geometric Jacobian (linear above angular, in the scene's frame), R and p
orientation and position in the scene's frame.
"""

from __future__ import annotations

from math import acos, cos, sin, sqrt
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from comove.arrays import Array, Integers
from comove.compiled import kernel
from comove.robots.model import Arm, Robot
from comove.robots.search.triples import Triple, cross, dot, plus, rotated, rotated_back

TURN = 0.2  # m, that one radian of a hand counts for in a residual
GRAVITY = 9.81  # m/s^2


class Masses(NamedTuple):
    """The bodies that the joints of chains move, in the joints' frames.

    Attributes
    ----------
    mass : array, shape (n_joints,) [kg]
    center : array, shape (n_joints, 3), centres of mass [m]
    inertia : array, shape (n_joints, 3, 3), about the centres of mass [kg m^2]
    """

    mass: Array
    center: Array
    inertia: Array


class JointMoves(NamedTuple):
    """Additions of joints to the rotations and offsets of their frames.

    Attributes
    ----------
    sine, versine : arrays, shape (n_joints, 3, 3), additions of the sine, and one less the cosine, of a joint to the
        rotation; zeros where joints slide
    slide : array, shape (n_joints, 3), addition of a joint's position to the offset; zeros where joints turn
    """

    sine: Array
    versine: Array
    slide: Array


class Tools(NamedTuple):
    """The frames of grasps in others; arrays, shape (n_arms, 3, 3) and (n_arms, 3) [m]."""

    rotation: Array
    offset: Array


class Chains(NamedTuple):
    """The arms of a scene's end effectors, with joints in one row.

    Attributes
    ----------
    first : array, shape (n_arms + 1,), index of each arm's first joint, and at last n_joints
    rotation, offset : arrays, shape (n_joints, 3, 3) and (n_joints, 3): each joint's frame in the one before it
        (for the first joint of an arm: in the scene) [m]
    moves : additions of the joints' positions to these
    axis : array, shape (n_joints, 3), axis in the joint's own frame
    slides : array, shape (n_joints,), whether the joint is prismatic
    tools : the grasps in the last joints' frames
    lower, upper, velocity, acceleration, effort : limits, arrays, shape (n_joints,) [rad, s, N m]
    approach : array, shape (n_joints,), time constants with which joints approach their limits, see `Robot` [s]
    relief : array, shape (n_joints,), share of the torque due to the own weight that springs hold
    masses : bodies that the joints move
    """

    first: Integers
    rotation: Array
    offset: Array
    moves: JointMoves
    axis: Array
    slides: NDArray[np.bool_]
    tools: Tools
    lower: Array
    upper: Array
    velocity: Array
    acceleration: Array
    effort: Array
    approach: Array
    relief: Array
    masses: Masses


class Iteration(NamedTuple):
    """Settings of the iteration that solves joints for a pose.

    Attributes
    ----------
    gain : share of the difference from the desired posture that redundant joints cover in a step
    keep : least distance of the joints from their limits [rad, m for prismatic joints]
    tolerance : largest residual accepted [m]
    steady : largest last step accepted [rad]
    most : largest number of steps
    stalled : share of the residual four steps before, above which a large residual is given up from the eighth step
        on, as joints that are stuck at their limits hardly ever get away
    """

    gain: float
    keep: float
    tolerance: float
    steady: float
    most: int
    stalled: float = np.inf


def turned_towards(chains: Chains, start: Array, goal: Array, part: slice = slice(None)) -> Array:
    """Shift joints by whole turns towards a start, within their limits.

    Parameters
    ----------
    start, goal : arrays, shape (..., n_joints), joints of the chains, or of `part` of their columns [rad]

    Returns
    -------
    array, shape (..., n_joints)
    """
    turn = np.where(chains.slides[part], np.inf, 2.0 * np.pi)
    fewest = np.ceil((chains.lower[part] - goal) / turn)
    most = np.floor((chains.upper[part] - goal) / turn)
    turns = np.clip(np.round((start - goal) / turn), fewest, most)
    return goal + np.where(turns == 0.0, 0.0, turns * 2.0 * np.pi)


def chains_of(robot: Robot, arms: tuple[Arm, ...]) -> Chains:
    """Build the arrays of a robot's arms in the given order."""
    model = robot.model
    columns = np.concatenate([arm.columns for arm in arms])
    joints = [int(np.flatnonzero(np.array(model.idx_vs) == c)[-1]) for c in columns]
    placements = [model.jointPlacements[j] for j in joints]
    axes, slides = map(np.array, zip(*(_axis(model.joints[j]) for j in joints), strict=True))
    rotation, across = np.array([m.rotation for m in placements]), np.zeros((len(joints), 3, 3))
    across[:, [2, 0, 1], [1, 2, 0]], across[:, [1, 2, 0], [2, 0, 1]] = axes, -axes
    across[slides] = 0.0
    bodies = [model.inertias[j] for j in joints]
    tools = [model.frames[model.getFrameId(arm.tip)].placement.homogeneous @ arm.tool for arm in arms]
    return Chains(
        first=np.cumsum([0] + [len(arm.columns) for arm in arms]),
        rotation=rotation,
        offset=np.array([m.translation for m in placements]),
        moves=JointMoves(
            rotation @ across,
            rotation @ across @ across,
            np.einsum("jab,jb->ja", rotation, axes) * slides[:, None],
        ),
        axis=axes,
        slides=slides,
        tools=Tools(np.array([tool[:3, :3] for tool in tools]), np.array([tool[:3, 3] for tool in tools])),
        lower=robot.lower[columns],
        upper=robot.upper[columns],
        velocity=robot.velocity[columns],
        acceleration=robot.acceleration[columns],
        effort=robot.effort[columns],
        approach=robot.approach[columns],
        relief=robot.relief[columns],
        masses=Masses(
            np.array([body.mass for body in bodies]),
            np.array([body.lever for body in bodies]),
            np.array([body.inertia for body in bodies]),
        ),
    )


def _axis(joint: Any) -> tuple[Array, bool]:
    """Return a joint's axis, and whether it is prismatic. It has one degree of freedom."""
    data = joint.createData()
    joint.calc(data, np.zeros(1))
    subspace = np.array(data.S).reshape(6)
    slides = bool(np.abs(subspace[:3]).max() > 0.5)
    return subspace[:3] if slides else subspace[3:], slides


@kernel
def place_arm(chains: Chains, arm: int, q: Array, rotations: Array, points: Array) -> None:
    """Compute the frames of an arm's joints, and last its grasp's.

    Parameters
    ----------
    q : array, shape (n_joints,), joint positions of all arms
    rotations, points : results, arrays of shape (n_joints of the arm + 1, 3, 3) and (..., 3)
    """
    first, last, moves, tools = chains.first[arm], chains.first[arm + 1], chains.moves, chains.tools
    r00, r01, r02, r10, r11, r12, r20, r21, r22 = 1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0
    px, py, pz = 0.0, 0.0, 0.0
    for j in range(first, last + 1):
        if j < last:
            turn, offset, slide, value = chains.rotation[j], chains.offset[j], moves.slide[j], q[j]
            by_sine, by_versine, sine, versine = (
                moves.sine[j],
                moves.versine[j],
                sin(value),
                1.0 - cos(value),
            )
            x, y, z = offset[0] + value * slide[0], offset[1] + value * slide[1], offset[2] + value * slide[2]
        else:
            turn, offset = tools.rotation[arm], tools.offset[arm]
            by_sine, by_versine, sine, versine = turn, turn, 0.0, 0.0
            x, y, z = offset[0], offset[1], offset[2]
        px += r00 * x + r01 * y + r02 * z
        py += r10 * x + r11 * y + r12 * z
        pz += r20 * x + r21 * y + r22 * z
        frame, point = rotations[j - first], points[j - first]
        point[0], point[1], point[2] = px, py, pz
        for b in range(3):
            x = turn[0, b] + sine * by_sine[0, b] + versine * by_versine[0, b]
            y = turn[1, b] + sine * by_sine[1, b] + versine * by_versine[1, b]
            z = turn[2, b] + sine * by_sine[2, b] + versine * by_versine[2, b]
            frame[0, b] = r00 * x + r01 * y + r02 * z
            frame[1, b] = r10 * x + r11 * y + r12 * z
            frame[2, b] = r20 * x + r21 * y + r22 * z
        r00, r01, r02 = frame[0, 0], frame[0, 1], frame[0, 2]
        r10, r11, r12 = frame[1, 0], frame[1, 1], frame[1, 2]
        r20, r21, r22 = frame[2, 0], frame[2, 1], frame[2, 2]


@kernel
def jacobian(chains: Chains, arm: int, rotations: Array, points: Array, out: Array) -> None:
    """Compute the geometric Jacobian of the grasp; result, array of shape (6, n_joints of the arm)."""
    first, n = chains.first[arm], chains.first[arm + 1] - chains.first[arm]
    for k in range(n):
        axis = chains.axis[first + k]
        x = rotations[k, 0, 0] * axis[0] + rotations[k, 0, 1] * axis[1] + rotations[k, 0, 2] * axis[2]
        y = rotations[k, 1, 0] * axis[0] + rotations[k, 1, 1] * axis[1] + rotations[k, 1, 2] * axis[2]
        z = rotations[k, 2, 0] * axis[0] + rotations[k, 2, 1] * axis[1] + rotations[k, 2, 2] * axis[2]
        if chains.slides[first + k]:
            out[0, k], out[1, k], out[2, k], out[3, k], out[4, k], out[5, k] = x, y, z, 0.0, 0.0, 0.0
            continue
        u, v, w = points[n, 0] - points[k, 0], points[n, 1] - points[k, 1], points[n, 2] - points[k, 2]
        out[0, k], out[1, k], out[2, k] = y * w - z * v, z * u - x * w, x * v - y * u
        out[3, k], out[4, k], out[5, k] = x, y, z


@kernel
def pose_error(rotation: Array, point: Array, target_rotation: Array, target: Array, out: Array) -> float:
    """Compute the twist from a frame to its target: positions [m] above the rotation vector [rad].

    Returns the residual [m], in which one radian counts `TURN`.
    """
    for a in range(3):
        out[a] = target[a] - point[a]
    trace = 0.0
    for a in range(3):
        for b in range(3):
            trace += target_rotation[a, b] * rotation[a, b]
    angle = acos(min(1.0, max(-1.0, 0.5 * (trace - 1.0))))
    # 2 sin(angle) axis is the antisymmetric part of target * rotation^T
    for a in range(3):
        i, j = (a + 2) % 3, (a + 1) % 3
        value = 0.0
        for b in range(3):
            value += target_rotation[i, b] * rotation[j, b] - target_rotation[j, b] * rotation[i, b]
        out[3 + a] = 0.5 * value
    size = sqrt(out[3] ** 2 + out[4] ** 2 + out[5] ** 2)
    if angle > 2.5 and size < 1e-3:  # half a turn: any axis will do to get away from it
        out[3] += 1.0
        size = sqrt(out[3] ** 2 + out[4] ** 2 + out[5] ** 2)
    if size > 1e-8:
        stretch = (angle if angle > 1e-4 else size) / size
        for a in range(3, 6):
            out[a] *= stretch
    turned = out[3] ** 2 + out[4] ** 2 + out[5] ** 2
    return sqrt(out[0] ** 2 + out[1] ** 2 + out[2] ** 2 + TURN * TURN * turned)


@kernel
def solve_damped(jac: Array, free: NDArray[np.bool_], damping: float, error: Array, out: Array) -> None:
    """Solve (J_f J_f^T + damping I) x = error by Cholesky.

    J_f are the columns in `free`; the result x is an array of shape (6,). The matrix, and its lower factor in place
    of it, live in registers; d are the inverses of the factor's diagonal.
    """
    a00 = a10 = a11 = a20 = a21 = a22 = a30 = a31 = a32 = a33 = 0.0
    a40 = a41 = a42 = a43 = a44 = a50 = a51 = a52 = a53 = a54 = a55 = 0.0
    for k in range(jac.shape[1]):
        if free[k]:
            x0, x1, x2, x3, x4, x5 = jac[0, k], jac[1, k], jac[2, k], jac[3, k], jac[4, k], jac[5, k]
            a00, a10, a20, a30, a40, a50 = (
                *(a00 + x0 * x0, a10 + x1 * x0, a20 + x2 * x0),
                *(a30 + x3 * x0, a40 + x4 * x0, a50 + x5 * x0),
            )
            a11, a21, a31, a41, a51 = (
                a11 + x1 * x1,
                a21 + x2 * x1,
                a31 + x3 * x1,
                a41 + x4 * x1,
                a51 + x5 * x1,
            )
            a22, a32, a42, a52 = a22 + x2 * x2, a32 + x3 * x2, a42 + x4 * x2, a52 + x5 * x2
            a33, a43, a53 = a33 + x3 * x3, a43 + x4 * x3, a53 + x5 * x3
            a44, a54, a55 = a44 + x4 * x4, a54 + x5 * x4, a55 + x5 * x5
    least, more = 1e-30, damping * max(a00, a11, a22, a33, a44, a55) + 1e-300
    d0 = 1.0 / sqrt(max(a00 + more, least))
    a10, a20, a30, a40, a50 = a10 * d0, a20 * d0, a30 * d0, a40 * d0, a50 * d0
    d1 = 1.0 / sqrt(max(a11 + more - a10 * a10, least))
    a21, a31 = (a21 - a20 * a10) * d1, (a31 - a30 * a10) * d1
    a41, a51 = (a41 - a40 * a10) * d1, (a51 - a50 * a10) * d1
    d2 = 1.0 / sqrt(max(a22 + more - a20 * a20 - a21 * a21, least))
    a32 = (a32 - a30 * a20 - a31 * a21) * d2
    a42 = (a42 - a40 * a20 - a41 * a21) * d2
    a52 = (a52 - a50 * a20 - a51 * a21) * d2
    d3 = 1.0 / sqrt(max(a33 + more - a30 * a30 - a31 * a31 - a32 * a32, least))
    a43 = (a43 - a40 * a30 - a41 * a31 - a42 * a32) * d3
    a53 = (a53 - a50 * a30 - a51 * a31 - a52 * a32) * d3
    d4 = 1.0 / sqrt(max(a44 + more - a40 * a40 - a41 * a41 - a42 * a42 - a43 * a43, least))
    a54 = (a54 - a50 * a40 - a51 * a41 - a52 * a42 - a53 * a43) * d4
    d5 = 1.0 / sqrt(max(a55 + more - a50 * a50 - a51 * a51 - a52 * a52 - a53 * a53 - a54 * a54, least))
    y0 = error[0] * d0
    y1 = (error[1] - a10 * y0) * d1
    y2 = (error[2] - a20 * y0 - a21 * y1) * d2
    y3 = (error[3] - a30 * y0 - a31 * y1 - a32 * y2) * d3
    y4 = (error[4] - a40 * y0 - a41 * y1 - a42 * y2 - a43 * y3) * d4
    y5 = (error[5] - a50 * y0 - a51 * y1 - a52 * y2 - a53 * y3 - a54 * y4) * d5
    x5 = y5 * d5
    x4 = (y4 - a54 * x5) * d4
    x3 = (y3 - a43 * x4 - a53 * x5) * d3
    x2 = (y2 - a32 * x3 - a42 * x4 - a52 * x5) * d2
    x1 = (y1 - a21 * x2 - a31 * x3 - a41 * x4 - a51 * x5) * d1
    x0 = (y0 - a10 * x1 - a20 * x2 - a30 * x3 - a40 * x4 - a50 * x5) * d0
    out[0], out[1], out[2], out[3], out[4], out[5] = x0, x1, x2, x3, x4, x5


@kernel
def spare(chains: Chains, j: int, keep: float) -> float:
    """Return joint j's margin to its limits, at most `keep` [rad, m]."""
    return min(keep, 0.5 * (chains.upper[j] - chains.lower[j]))


@kernel
def inside(chains: Chains, j: int, value: float, keep: float) -> float:
    """Return joint j's value nearest to `value`, at least `keep` inside limits. Otherwise return their middle."""
    margin = spare(chains, j, keep)
    return min(max(value, chains.lower[j] + margin), chains.upper[j] - margin)


@kernel
def reach_pose(
    chains: Chains, arm: int, target_rotation: Array, target: Array, pull: Array, how: Iteration, q: Array
) -> float:
    """Solve an arm's joints for a pose by damped least squares.

    They are solved in place. Redundant joints are drawn towards `pull`, array of shape (n_joints,). Joints too near
    to their limits are held, and the others compensate.

    Returns
    -------
    The residual [m] that is left.
    """
    largest_step = 0.3  # rad, of a joint in one iteration
    large = 0.02  # m, of a residual that is given up where it hardly gets less
    at_limit = 1e-12  # rad, from a limit, where a joint is held; far below all residuals that are asked for
    first, n = chains.first[arm], chains.first[arm + 1] - chains.first[arm]
    rotations, points, jac = np.empty((n + 1, 3, 3)), np.empty((n + 1, 3)), np.empty((6, n))
    rows, free = np.empty((5, max(6, n))), np.empty(n, dtype=np.bool_)
    error, rest, dual, wish, step = rows[0], rows[1], rows[2], rows[3], rows[4]
    residual, moved = np.inf, np.inf
    last, second, third, fourth = np.inf, np.inf, np.inf, np.inf  # residuals before
    for iteration in range(how.most + 1):
        place_arm(chains, arm, q, rotations, points)
        last, second, third, fourth = residual, last, second, third
        residual = pose_error(rotations[n], points[n], target_rotation, target, error)
        if (residual < how.tolerance and moved < how.steady) or iteration == how.most:
            break
        if iteration >= 8 and residual > max(large, how.stalled * fourth):
            break
        jacobian(chains, arm, rotations, points, jac)
        damping = 1e-4 * min(1.0, 100.0 * residual * residual) + 1e-12
        for k in range(n):
            wish[k], free[k] = how.gain * (pull[first + k] - q[first + k]), True
        for _ in range(3):
            for i in range(6):
                rest[i] = error[i]
                for k in range(n):
                    if free[k]:
                        rest[i] -= jac[i, k] * wish[k]
            solve_damped(jac, free, damping, rest, dual)
            largest, settled = 0.0, True
            for k in range(n):
                step[k] = 0.0
                if not free[k]:
                    continue
                step[k] = wish[k]
                for i in range(6):
                    step[k] += jac[i, k] * dual[i]
                largest = max(largest, abs(step[k]))
                j = first + k
                margin = spare(chains, j, how.keep) + at_limit
                out_low = q[j] <= chains.lower[j] + margin and step[k] < 0.0
                out_high = q[j] >= chains.upper[j] - margin and step[k] > 0.0
                if out_low or out_high:
                    free[k] = False
                    settled = False
            if settled:
                break
        scale, moved = min(1.0, largest_step / max(largest, 1e-12)), largest
        for k in range(n):
            j = first + k
            q[j] = inside(chains, j, q[j] + scale * step[k], how.keep)
    return residual


@kernel
def torques(
    chains: Chains,
    arm: int,
    q: Array,
    velocity: Array,
    acceleration: Array,
    load: float,
    load_acceleration: Array,
    out: Array,
) -> None:
    """Compute an arm's torques by recursive Newton-Euler, less those of springs. See Luh, Walker and Paul (1980).

    Parameters
    ----------
    q, velocity, acceleration : arrays, shape (n_joints,), of all arms
    load : point mass at the grasp [kg]
    load_acceleration : array, shape (3,), acceleration of the grasp in the scene [m/s^2]
    out : result, array of shape (n_joints,) [N m]; entries of other arms are not changed
    """
    masses, first, n = chains.masses, chains.first[arm], chains.first[arm + 1] - chains.first[arm]
    rotations, points = np.empty((n + 1, 3, 3)), np.empty((n + 1, 3))
    place_arm(chains, arm, q, rotations, points)
    axes, centers, forces, moments = np.empty((n, 3)), np.empty((n, 3)), np.empty((n, 3)), np.empty((n, 3))
    w, dw, a, before = (0.0, 0.0, 0.0), (0.0, 0.0, 0.0), (0.0, 0.0, GRAVITY), (0.0, 0.0, 0.0)
    for k in range(n):
        j = first + k
        z, c = rotated(rotations[k], chains.axis[j]), rotated(rotations[k], masses.center[j])
        at = (points[k, 0], points[k, 1], points[k, 2])
        a = plus(a, _carried_along(w, dw, plus(at, before, -1.0)))
        if chains.slides[j]:
            a = plus(plus(a, cross(w, z), 2.0 * velocity[j]), z, acceleration[j])
        else:
            dw = plus(plus(dw, z, acceleration[j]), cross(w, z), velocity[j])
            w = plus(w, z, velocity[j])
        before = at
        force = plus(a, _carried_along(w, dw, c))
        spin = _inertia_times(rotations[k], masses.inertia[j], w)
        moment = plus(_inertia_times(rotations[k], masses.inertia[j], dw), cross(w, spin))
        for i in range(3):
            axes[k, i], centers[k, i] = z[i], c[i]
            forces[k, i], moments[k, i] = masses.mass[j] * force[i], moment[i]
    carried = (
        load * load_acceleration[0],
        load * load_acceleration[1],
        load * (load_acceleration[2] + GRAVITY),
    )
    about, at = (0.0, 0.0, 0.0), (points[n, 0], points[n, 1], points[n, 2])
    mass, x, y = 0.0, 0.0, 0.0
    for k in range(n - 1, -1, -1):
        j = first + k
        here, z = (points[k, 0], points[k, 1], points[k, 2]), (axes[k, 0], axes[k, 1], axes[k, 2])
        force, c = (forces[k, 0], forces[k, 1], forces[k, 2]), (centers[k, 0], centers[k, 1], centers[k, 2])
        about = plus(plus(about, cross(plus(at, here, -1.0), carried)), cross(c, force))
        about = plus(about, (moments[k, 0], moments[k, 1], moments[k, 2]))
        carried, at = plus(carried, force), here
        mass += masses.mass[j]
        x += masses.mass[j] * (here[0] + c[0])
        y += masses.mass[j] * (here[1] + c[1])
        if chains.slides[j]:
            needed, own = dot(z, carried), z[2] * mass
        else:
            needed, own = dot(z, about), z[0] * (y - mass * here[1]) - z[1] * (x - mass * here[0])
        out[j] = needed - chains.relief[j] * GRAVITY * own


@kernel
def _carried_along(w: Triple, dw: Triple, arm: Triple) -> Triple:
    """Return the relative acceleration of an arm's end on a turning body."""
    return plus(cross(dw, arm), cross(w, cross(w, arm)))


@kernel
def _inertia_times(r: Array, inertia: Array, v: Triple) -> Triple:
    return rotated(r, rotated(inertia, rotated_back(r, v)))
