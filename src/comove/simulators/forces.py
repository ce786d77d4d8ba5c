"""Forces of the hands on the load, split into a part that moves it and an internal part.

Hand i at p_i (from the load's origin) exerts the force f_i and the torque t_i. Together they give the load

    F = sum f_i,    M = sum (t_i + p_i x f_i).

What moves the load is shared out evenly by the non-squeezing pseudoinverse of the grasp matrix (Walker, Freeman and
Marcus 1991, "Analyzing motion and internal loading of objects grasped by multiple cooperating manipulators"),

    f_i = F / m,    t_i = (M - p_i x F) / m,

and the rest is internal: it cancels out, moves nothing and only strains arms and load. For two hands the internal
force is half the difference of their forces; its part along the line between them, the squeeze, is the force in the
middle member of the virtual linkage (Williams and Khatib 1993).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def internal_wrenches(wrenches: Array, points: Array) -> Array:
    """Compute the part of the hands' wrenches that cancels out.

    Parameters
    ----------
    wrenches : array, shape (n_steps, n_hands, 6), force [N] and torque [N m] at the hand's grasp
    points : array, shape (n_steps, n_hands, 3), positions of the grasps from the load's origin [m], in the same axes

    Returns
    -------
    array, shape (n_steps, n_hands, 6)
    """
    forces, torques = wrenches[..., :3], wrenches[..., 3:]
    force = forces.sum(axis=1, keepdims=True)
    torque = (torques + np.cross(points, forces)).sum(axis=1, keepdims=True)
    share = np.concatenate(np.broadcast_arrays(force, torque - np.cross(points, force)), axis=-1)
    return wrenches - share / max(wrenches.shape[1], 1)


def squeezes(wrenches: Array, points: Array) -> Array:
    """Compute half the difference of two hands' forces along the line between them [N], positive where they press.

    Parameters
    ----------
    wrenches, points : as for `internal_wrenches`

    Returns
    -------
    array, shape (n_steps, n_pairs), for the pairs (0, 1), (0, 2), ... (1, 2), ...
    """
    first, second = np.triu_indices(points.shape[1], 1)
    across = points[:, second] - points[:, first]
    across /= np.maximum(np.linalg.norm(across, axis=-1, keepdims=True), 1e-12)
    return 0.5 * ((wrenches[:, first, :3] - wrenches[:, second, :3]) * across).sum(axis=-1)
