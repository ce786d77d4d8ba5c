"""Rhythmic movements: the limit cycle of the transformed system under a periodic forcing term.

With ``f(s) = psi(s) w`` of period 1 the system of equation (1a) has exactly one periodic solution, and every other
solution converges to it: the difference is a free critically damped motion, which decays like
``exp(-alpha_y s / 2)``. Both are known in closed form. The goal is the centre of the cycle: the free weights do not
change its mean.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike

from comove.arrays import Array
from comove.dmp.basis import released
from comove.dmp.system import N_INTERVALS, from_rest, values_at, von_mises
from comove.trajectory import interpolated


@dataclass(frozen=True, eq=False)
class RhythmicBasis:
    """Matrices from boundary values and shape weights to unit-period motions.

    Attributes
    ----------
    cycle : array, shape (3, n_knots, n_basis): position, velocity and acceleration on the limit cycle caused by a
        unit shape weight; the last knot is the first one, a period later
    shape_force : array, shape (n_knots, n_basis), the forcing term of this cycle
    """

    cycle: Array
    shape_force: Array

    @property
    def n_basis(self) -> int:
        """Return the number of free shape weights per dimension."""
        return self.cycle.shape[2]

    def sampled(self, n_steps: int) -> Array:
        """Return the first period's even samples; array, shape (n_basis + 4, n_steps)."""
        boundary, shape = self.at(np.linspace(0.0, 1.0, n_steps))
        return np.concatenate([shape[0], boundary[0]], axis=1).T

    def at(self, s: ArrayLike) -> tuple[Array, Array]:
        """Return the boundary and shape matrices at times in periods. They are exact between the knots as well.

        The boundary values are start, start velocity, centre, and a fourth one that has no effect here.

        Returns
        -------
        boundary : array, shape (3, n_steps, 4)
        shape : array, shape (3, n_steps, n_basis)
        """
        times = np.maximum(np.asarray(s, dtype=float), 0.0)
        free = released(times)
        boundary = np.zeros((3, len(times), 4))
        boundary[:, :, :2] = free
        boundary[:, :, 2] = -free[:, :, 0]
        boundary[0, :, 2] += 1.0
        return boundary, self.on_cycle(times) - free @ self.cycle[:2, 0]

    def on_cycle(self, s: Array) -> Array:
        """Return unit weights' limit cycle at times; shape (3, n_steps, n_basis). Times are in periods."""
        return values_at(self.cycle, self.shape_force, np.zeros(self.n_basis), s - np.floor(s))


@lru_cache(maxsize=32)
def rhythmic_basis(n_basis: int) -> RhythmicBasis:
    """Build the basis with `n_basis` free shape weights per dimension; results are cached.

    The shape weights are those of harmonics, each scaled to unit velocity. The forcing functions are shifted copies
    of one another, so the harmonics of their weights are orthogonal in every metric.
    """
    psi = von_mises(n_basis + 1)
    weights = from_rest(psi)
    free = released(np.linspace(0.0, 1.0, N_INTERVALS + 1))
    onset = np.linalg.solve(np.eye(2) - free[:2, -1], weights[:2, -1])  # which returns after a period
    cycle = weights + free @ onset
    index, harmonic = np.arange(n_basis + 1), np.arange(n_basis) // 2 + 1
    angle = 2 * np.pi * np.outer(index, harmonic) / (n_basis + 1)
    of_shape = np.where(np.arange(n_basis) % 2 == 0, np.cos(angle), np.sin(angle))
    mean = 0.5 * (cycle[0, 1:] + cycle[0, :-1]).mean(axis=0)
    of_shape -= (mean @ of_shape) / mean.sum()
    of_shape /= np.sqrt((((cycle[1] @ of_shape)[:-1]) ** 2).mean(axis=0))
    arrays = cycle @ of_shape, psi @ of_shape
    for array in arrays:
        array.setflags(write=False)
    return RhythmicBasis(*arrays)


def estimated_period(time: Array, position: Array) -> float:
    """Estimate the period of a recorded movement from its autocorrelation.

    The first high peak of the autocorrelation is refined: the period is the one after which the movement repeats
    best.

    Parameters
    ----------
    time : array, shape (n_steps,), [s], from 0
    position : array, shape (n_steps, n_dims)

    Returns
    -------
    float
        Period [s]; the whole duration if nothing repeats.
    """
    least = 0.5  # autocorrelation that is taken for a period
    longest_share = 0.55  # of a recording, that a period may last to be seen in it
    even = np.linspace(0.0, time[-1], min(4096, 8 * len(time)))
    x = interpolated(even, time, position)
    x = x - x.mean(axis=0)
    n = len(even)
    spectrum = np.abs(np.fft.rfft(x, 2 * n, axis=0)) ** 2
    products = np.fft.irfft(spectrum.sum(axis=1))[:n]
    energy = np.concatenate([[0.0], np.cumsum((x**2).sum(axis=1))])
    both = np.sqrt(energy[:0:-1] * (energy[n] - energy[:n]))
    correlation = (products / np.maximum(both, 1e-300))[
        1 : int(longest_share * n)
    ]  # by lags of 1, 2, ... samples
    fallen = np.flatnonzero(correlation < least)
    rest = correlation[fallen[0] :] if fallen.size else np.zeros(0)
    high = np.flatnonzero(rest >= max(least, 0.9 * rest.max(initial=0.0)))
    if not high.size:
        return float(time[-1])
    first = fallen[0] + high[0]
    peak = first + np.argmax(correlation[first : first + max(2, first // 2)])
    guess = float(even[1 + peak])

    def misfit(period: float) -> float:
        later = even[even <= even[-1] - period]
        now = interpolated(later, even, x)
        then = interpolated(later + period, even, x)
        return float(((then - now) ** 2).mean())

    from scipy.optimize import minimize_scalar  # slow to import, and only rhythms need it

    shortest, longest = 0.95 * guess, min(1.05 * guess, 0.98 * time[-1])
    if shortest >= longest:
        return guess
    options = {"xatol": 1e-9 * guess}
    return float(minimize_scalar(misfit, bounds=(shortest, longest), method="bounded", options=options).x)
