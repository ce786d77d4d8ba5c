"""Forcing functions whose motions are splines: smooth, local, and at rest at both ends."""

from __future__ import annotations

import numpy as np
from numpy.polynomial.polynomial import polyder, polyval
from numpy.typing import NDArray

from comove.primitives.flow import OMEGA
from comove.primitives.forcing import N_INTERVALS

Array = NDArray[np.float64]

DEGREE = 5


def splines(n_inner: int) -> Array:
    """Return the forcing of quintic B-splines that rest at both ends, and of six quintics for the boundary values.

    A motion b(s) of the transformed system is caused by the forcing ``b'' + 2 omega b' + omega^2 b``. Each of the six
    quintics has a unit position, velocity or acceleration at one end (first those of the start) and zero for the
    others.

    Parameters
    ----------
    n_inner : number of B-splines

    Returns
    -------
    array, shape (n_knots, n_inner + 6)
    """
    from scipy.interpolate import BSpline  # a quarter of a second, which only smooth motions need

    s = np.linspace(0.0, 1.0, N_INTERVALS + 1)
    breaks = np.linspace(0.0, 1.0, n_inner + 2)
    places = np.concatenate([np.zeros(DEGREE), breaks, np.ones(DEGREE)])
    inner = BSpline(places, np.eye(n_inner + 6)[:, 3:-3], DEGREE)
    orders = np.arange(6)
    at_start, at_end = np.diag([1.0, 1, 2, 0, 0, 0])[:3], np.stack([orders**0, orders, orders * (orders - 1)])
    ends = np.linalg.inv(np.concatenate([at_start, at_end]))
    motions = [
        np.concatenate([inner(s, order), polyval(s, polyder(ends, order)).T], axis=1) for order in range(3)
    ]
    return motions[2] + 2 * OMEGA * motions[1] + OMEGA**2 * motions[0]
