"""Rotations: quaternions, rotation vectors, similarity transforms, and fits to points.

Quaternions are w x y z; rotation vectors point along the axis and are as long as the angle [rad]. A body that turns
with ``R(t) = exp(r(t))`` has the angular velocity ``J(r) r'`` in the world's frame, J the left Jacobian of SO(3).
"""

from __future__ import annotations

import numpy as np

from comove.arrays import Array, first_largest, first_least

TINY = 1e-150
SMALL = 1e-3  # rad, below which the limit replaces what would cancel
ROUNDING = 1e-12  # of the numbers of a unit quaternion
UP = np.array([0.0, 0.0, 1.0])


def cross(a: Array, b: Array) -> Array:
    """Compute cross products; arrays, shape (..., 3), that broadcast."""
    ax, ay, az = a[..., 0], a[..., 1], a[..., 2]
    bx, by, bz = b[..., 0], b[..., 1], b[..., 2]
    out = np.empty((*np.broadcast_shapes(ax.shape, bx.shape), 3))
    out[..., 0], out[..., 1], out[..., 2] = ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx
    return out


def quaternion_product(a: Array, b: Array) -> Array:
    """Compute the Hamilton product of quaternions (w, x, y, z); arrays, shape (..., 4)."""
    w = a[..., 0] * b[..., 0] - (a[..., 1:] * b[..., 1:]).sum(axis=-1)
    v = a[..., :1] * b[..., 1:] + b[..., :1] * a[..., 1:] + cross(a[..., 1:], b[..., 1:])
    return np.concatenate([w[..., None], v], axis=-1)


def conjugate(quaternion: Array) -> Array:
    """Return the inverse of unit quaternions; arrays, shape (..., 4)."""
    return quaternion * np.array([1.0, -1.0, -1.0, -1.0])


def same_hemisphere(quaternions: Array) -> Array:
    """Return the same orientations without sign changes between neighbours; array, shape (n_steps, 4).

    The last one keeps its sign.
    """
    return quaternions * _signs_from_the_end((quaternions[1:] * quaternions[:-1]).sum(axis=1))


def exponential(vectors: Array) -> Array:
    """Compute the quaternions of rotation vectors of any length; (..., 3) -> (..., 4)."""
    angle = np.linalg.norm(vectors, axis=-1, keepdims=True)
    return np.concatenate([np.cos(angle / 2), 0.5 * np.sinc(angle / (2 * np.pi)) * vectors], axis=-1)


def logarithm(quaternion: Array, near: Array | None = None) -> Array:
    """Compute the rotation vector of a quaternion (4,) that is nearest `near`.

    Without `near`, array of shape (3,), it is the shortest one.
    """
    near = np.zeros(3) if near is None else near
    if quaternion[0] < 0.0:
        quaternion = -quaternion
    sine = np.linalg.norm(quaternion[1:])
    angle = 2 * np.arctan2(sine, quaternion[0])
    length = np.linalg.norm(near)
    if sine < 1e-12:  # no turn, or whole turns about any axis
        turns = np.round(length / (2 * np.pi))
        return 2 * quaternion[1:] + (2 * np.pi * turns * near / length if turns else 0.0)
    axis = quaternion[1:] / sine
    turns = np.round((axis @ near - angle) / (2 * np.pi))
    return axis * (angle + 2 * np.pi * turns)


def turn_between(a: Array, b: Array, near: Array | None = None) -> Array:
    """Compute the rotation vector r with ``exp(r) b = a``. It is the nearest to `near`, by default the shortest.

    Parameters
    ----------
    a, b : arrays, shape (4,), unit quaternions
    near : array, shape (3,)

    Returns
    -------
    array, shape (3,), [rad]
    """
    return logarithm(quaternion_product(a, conjugate(b)), near)


def continuous_logarithm(quaternions: Array, last: Array | None = None) -> Array:
    """Compute the rotation vectors of a movement without jumps. The last is the shortest, or nearest to `last`.

    Parameters
    ----------
    quaternions : array, shape (n_steps, 4), with any signs
    last : array, shape (3,)

    Returns
    -------
    array, shape (n_steps, 3)
        Where the angle passes a whole turn, it continues about the same axis; if the axis changes there, no
        continuous continuation exists, and the vectors jump.
    """
    q = same_hemisphere(np.where(quaternions[-1:, :1] < 0.0, -1.0, 1.0) * quaternions)
    sine = np.linalg.norm(q[:, 1:], axis=1, keepdims=True)
    axis = q[:, 1:] / np.where(sine > TINY, sine, np.inf)  # what squares to nothing is no turn
    turned = np.flatnonzero(sine[:, 0] > 1e-12)
    if turned.size:  # where nothing is turned, the axis is that of the next sample that is
        axis = axis[turned[np.minimum(np.searchsorted(turned, np.arange(len(q))), turned.size - 1)]]
    axis *= _signs_from_the_end((axis[1:] * axis[:-1]).sum(axis=1))  # about a fixed axis the angle has a sign
    angle = 2 * np.arctan2((q[:, 1:] * axis).sum(axis=1), q[:, 0])
    angle = np.unwrap(angle[::-1])[::-1]
    if last is not None:
        angle = angle + 2 * np.pi * np.round((axis[-1] @ last - angle[-1]) / (2 * np.pi))
    return axis * angle[:, None]


def _signs_from_the_end(dots: Array) -> Array:
    """Return signs that make neighbours agree; the last is 1; (n_steps - 1,) -> (n_steps, 1)."""
    return np.append(np.cumprod(np.where(dots[::-1] < 0.0, -1.0, 1.0))[::-1], 1.0)[:, None]


def angular_velocity(vectors: Array, rates: Array) -> Array:
    """Compute J(r) r' for rotation vectors r and their derivatives r'; arrays, shape (..., 3)."""
    angle = np.linalg.norm(vectors, axis=-1, keepdims=True)
    first = 0.5 * np.sinc(angle / (2 * np.pi)) ** 2
    second = np.where(angle < SMALL, 1 / 6, (1 - np.sinc(angle / np.pi)) / np.maximum(angle, SMALL) ** 2)
    crossed = np.cross(vectors, rates)
    return rates + first * crossed + second * np.cross(vectors, crossed)


def rates_of(vector: Array, angular: Array) -> Array:
    """Compute r' from a rotation vector and an angular velocity: the inverse of `angular_velocity`."""
    jacobian = np.stack([angular_velocity(vector, unit) for unit in np.eye(3)], axis=1)
    return np.asarray(np.linalg.solve(jacobian, angular), dtype=np.float64)


def matrices(quaternions: Array) -> Array:
    """Return the rotation matrices of unit quaternions; (..., 4) -> (..., 3, 3)."""
    w, x, y, z = (quaternions[..., k] for k in range(4))
    out = np.empty((*w.shape, 3, 3))
    rows = (
        (1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)),
        (2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)),
        (2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)),
    )
    for a, row in enumerate(rows):
        for b, value in enumerate(row):
            out[..., a, b] = value
    return out


def similarity(a: Array, b: Array) -> Array:
    """Return the smallest rotation times scale that maps `a` to `b`. It is an array, shape (n, n).

    In one dimension, where rotation is impossible, it is b/a. For opposite vectors the axis is not determined: a
    fixed one is used.
    """
    if len(a) == 1:
        return (b / a)[:, None]
    length, wanted = np.linalg.norm(a), np.linalg.norm(b)
    if wanted == 0.0:
        return np.zeros((len(a), len(a)))
    a, b = a / length, b / wanted
    aside = b - (b @ a) * a
    if not np.linalg.norm(aside) > 0.0:
        aside[first_least(np.abs(a))] = 1.0
    for _ in range(2):  # once more, for vectors that nearly coincide
        aside = aside - (aside @ a) * a
        aside = aside / np.linalg.norm(aside)
    cosine, sine = b @ a, b @ aside
    turn = sine * (np.outer(aside, a) - np.outer(a, aside))
    turn += (cosine - 1.0) * (np.outer(a, a) + np.outer(aside, aside))
    return wanted / length * (np.eye(len(a)) + turn)


def fit_angle(grasps: Array, hands: Array) -> Array:
    """Return angles [rad] about z that best fit grasps to end effectors; (n, 3), (..., n, 3) -> (...)."""
    held, wanted = _about_middle(grasps), _about_middle(hands)
    cosine = (held[:, 0] * wanted[..., 0] + held[:, 1] * wanted[..., 1]).sum(axis=-1)
    sine = (held[:, 0] * wanted[..., 1] - held[:, 1] * wanted[..., 0]).sum(axis=-1)
    return np.arctan2(sine, cosine)


def fit_direction(grasps: Array, hands: Array) -> Array:
    """Return x axes that best fit grasps to end effectors; (n, 3), (..., n, 3) -> (..., 3)."""
    direction = (_about_middle(grasps)[:, :1] * _about_middle(hands)).sum(axis=-2)
    return direction / np.linalg.norm(direction, axis=-1, keepdims=True)


def fit_quaternion(grasps: Array, hands: Array) -> Array:
    """Return quaternions, w x y z, that best turn `grasps` onto `hands`.

    Shapes are (n, 3) and (..., n, 3) -> (..., 4). The method is Horn's (1987).
    """
    s = np.einsum("ni,...nj->...ij", _about_middle(grasps), _about_middle(hands))
    cross = [s[..., 1, 2] - s[..., 2, 1], s[..., 2, 0] - s[..., 0, 2], s[..., 0, 1] - s[..., 1, 0]]
    trace = np.trace(s, axis1=-2, axis2=-1)
    matrix = np.empty((*s.shape[:-2], 4, 4))
    matrix[..., 0, 0] = trace
    matrix[..., 1:, 1:] = s + np.swapaxes(s, -1, -2) - trace[..., None, None] * np.eye(3)
    for i in range(3):
        matrix[..., 0, i + 1] = matrix[..., i + 1, 0] = cross[i]
    return np.linalg.eigh(matrix)[1][..., -1]


def levelling(along: Array, up: Array) -> Array:
    """Return the smallest rotation that makes vectors perpendicular to `up`.

    `along` has shape (n, 3), the rotation (3, 3); `up` is a unit vector. Where they would have to turn so far that
    `up` lies almost in their span, it is the identity.
    """
    _, spread, axes = np.linalg.svd(along, full_matrices=False)
    axes = axes[spread > 1e-6 * spread[0]]
    across = up - axes.T @ (axes @ up)
    size = np.linalg.norm(across)
    return similarity(across / size, up) if size > 0.1 else np.eye(3)


def standing(x: Array, up: Array = UP) -> Array:
    """Return the rotation (3, 3) whose z axis leans least from `up`.

    Its x axis is `x`. Both are unit vectors, and not parallel.
    """
    z = up - (x @ up) * x
    z /= np.linalg.norm(z)
    return np.stack([x, np.cross(z, x), z], axis=1)


def facing(x: Array) -> Array:
    """Return the rotation with given x axis and z most upright.

    Where the unit vector `x` is nearly vertical, z is as near as possible to the world's x.
    """
    return standing(x, UP if abs(x[2]) < 0.999 else np.array([1.0, 0.0, 0.0]))


def evenly_spread(count: int, n_dims: int = 3) -> Array:
    """Return evenly spread unit vectors; array, shape (count, 3).

    They are in the plane or in space (Fibonacci's lattice).
    """
    k = np.arange(count)
    if n_dims == 2:
        turn = 2 * np.pi * k / count
        return np.stack([np.cos(turn), np.sin(turn), np.zeros(count)], axis=1)
    z, turn = (2 * k + 1) / count - 1, np.pi * (3 - np.sqrt(5.0)) * k
    across = np.sqrt(1 - z**2)
    return np.stack([across * np.cos(turn), across * np.sin(turn), z], axis=1)


def _about_middle(points: Array) -> Array:
    return points - points.mean(axis=-2, keepdims=True)


def rotation_in_plane(angle: Array | float) -> Array:
    """Return the rotation about z by `angle` [rad]; array, shape (3, 3)."""
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


def quaternion_of_rotation(rotation: Array) -> Array:
    """Return the unit quaternion (w, x, y, z) of a rotation matrix. The method is Shepperd's (1978).

    Its first nonzero number is positive.
    """
    m = rotation
    trace = np.trace(m)
    candidates = np.array([trace, m[0, 0], m[1, 1], m[2, 2]])
    i = first_largest(candidates)
    if i == 0:
        q = np.array([1 + trace, m[2, 1] - m[1, 2], m[0, 2] - m[2, 0], m[1, 0] - m[0, 1]])
    else:
        a, b, c = i - 1, i % 3, (i + 1) % 3
        q = np.empty(4)
        q[0] = m[c, b] - m[b, c]
        q[1 + a] = 1 + m[a, a] - m[b, b] - m[c, c]
        q[1 + b] = m[b, a] + m[a, b]
        q[1 + c] = m[c, a] + m[a, c]
    q /= np.linalg.norm(q)
    first = q[np.argmax(np.abs(q) > ROUNDING)]  # of a half turn w is 0 but for rounding
    return q if first > 0 else -q
