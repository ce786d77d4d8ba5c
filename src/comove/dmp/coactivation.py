"""Distributions that act at once: the product of their Gaussians at every instant (Paraschos et al., 2018).

Each distribution is raised to its activation, from 0 (no part in it) to 1: where one alone is active the result is
that one, and where several are, it is what all of them allow. The activations may change over the course, so that one
movement passes into another.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from comove.arrays import Array
from comove.dmp.arguments import numbers
from comove.dmp.estimation import USUAL, solver, taper
from comove.dmp.probabilistic import N_SEEN, ProMP
from comove.errors import OptionError

FLOOR = 1e-6  # of the mean variance, added to all: what never varies has a finite precision


def coactivated(
    promps: Sequence[ProMP], activations: ArrayLike, *, length: float = USUAL.usual_length
) -> ProMP:
    """Return the distribution of movements that several distributions allow, by their activations.

    Parameters
    ----------
    promps : distributions of the same manipulators and dimension; the first one's basis and duration are taken
    activations : array, shape (n_promps,), or (n_promps, n_steps) at even shares of the course; from 0 to 1
    length : length over which instants of the result hang together [durations]; a product at each instant tells
        nothing of that

    Raises
    ------
    OptionError
        If the distributions do not fit together, or the activations are out of range.
    """
    if not isinstance(promps, (list, tuple)) or not promps or not all(isinstance(p, ProMP) for p in promps):
        raise OptionError(f"promps = {promps!r}", way_out="give a list of ProMPs")
    first = promps[0]
    if any((p.n_columns, p.manipulators) != (first.n_columns, first.manipulators) for p in promps):
        raise OptionError(
            "the distributions are of other manipulators", way_out="give distributions of one kind"
        )
    given = numbers(activations)
    given = given[:, None] if given.ndim == 1 else given
    if given.ndim != 2 or len(given) != len(promps) or not ((given >= 0) & (given <= 1)).all():
        raise OptionError(
            f"activations of shape {given.shape}", way_out=f"give {len(promps)} rows of numbers from 0 to 1"
        )
    if not given.any(axis=0).all():
        raise OptionError(
            "no distribution is active at some instants", way_out="give one an activation above 0"
        )
    n_steps = N_SEEN * first.mean_parameters.shape[1]
    s = np.linspace(0.0, 1.0, n_steps)
    active = np.stack([np.interp(s, np.linspace(0.0, 1.0, len(row)), row) for row in given])
    mean, covariance = _product(promps, active, s)
    values, vectors = np.linalg.eigh(covariance)
    root = (vectors * np.sqrt(np.maximum(values, 0.0))[:, None, :]) @ np.swapaxes(vectors, 1, 2)
    # C(s, s') = root(s) k(s, s') root(s')': positive, and the product itself at every instant.
    whole = np.einsum("tce,st,sde->ctds", root, taper(n_steps, 1, length), root).reshape(mean.size, mean.size)
    back = np.kron(np.eye(first.n_columns), solver(first.basis, s))
    none = np.zeros(0)
    return replace(
        first,
        mean_parameters=(back @ mean.T.ravel()).reshape(first.mean_parameters.shape),
        covariance=back @ whole @ back.T,
        slopes=none,
        context_mean=none,
        context_std=none,
        n_recordings=0,
        notes=(f"{len(promps)} distributions that act at once",),
    )


def _product(promps: Sequence[ProMP], active: Array, s: Array) -> tuple[Array, Array]:
    """Return mean and covariance of the product of Gaussians at every instant."""
    n_columns = promps[0].n_columns
    information, drawn = np.zeros((len(s), n_columns, n_columns)), np.zeros((len(s), n_columns))
    for promp, activation in zip(promps, active, strict=True):
        time = s * promp.duration
        own = promp.covariance_at(time)
        least = FLOOR * max(float(np.trace(own, axis1=1, axis2=2).mean()) / n_columns, 1e-300)
        precision = activation[:, None, None] * np.linalg.inv(own + least * np.eye(n_columns))
        information += precision
        drawn += (precision @ promp.mean_at(time)[:, :, None])[:, :, 0]
    covariance: Array = np.asarray(np.linalg.inv(information), dtype=np.float64)
    return (covariance @ drawn[:, :, None])[:, :, 0], 0.5 * (covariance + np.swapaxes(covariance, 1, 2))
