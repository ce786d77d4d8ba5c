"""Forcing functions: weighted means gated by the phase, each with its time, and periodic ones."""

import numpy as np
import pytest

from comove.dmp import ExponentialPhase, LinearPhase
from comove.dmp.system import N_INTERVALS, gaussians, mollifiers, von_mises

KNOTS = np.linspace(0, 1, N_INTERVALS + 1)


@pytest.mark.parametrize("kernels", [gaussians, mollifiers])
@pytest.mark.parametrize("phase", [LinearPhase(), ExponentialPhase(), ExponentialPhase(alpha=4.6)])
@pytest.mark.parametrize("n_functions", [3, 22, 200])
def test_they_share_the_phase(kernels, phase, n_functions):
    """Equation (2): a weighted mean, gated by the phase."""
    psi = kernels(n_functions, phase)
    assert psi.shape == (N_INTERVALS + 1, n_functions)
    assert psi.min() >= 0.0
    assert np.abs(psi.sum(axis=1) - phase(KNOTS)).max() < 1e-14
    assert (np.diff((psi / phase(KNOTS)[:, None].clip(1e-300)).argmax(axis=0)) >= 0).all()


def test_a_mollifier_is_silent_away_from_its_centre():
    """Ginesi et al. (2021): compact support, so that weights act on their own part only; Gaussians have tails."""
    spans = (mollifiers(22, LinearPhase()) > 0).sum(axis=0)
    assert spans.max() < 0.2 * N_INTERVALS
    assert (gaussians(22, LinearPhase())[:-1] > 0).sum(axis=0).min() > 2 * spans.max()


def test_von_mises_functions_are_periodic_and_alike():
    psi = von_mises(16)
    assert np.abs(psi[-1] - psi[0]).max() < 1e-15
    assert np.abs(psi.sum(axis=1) - 1.0).max() < 1e-14
    shift = N_INTERVALS // 16
    assert np.abs(np.roll(psi[:-1, 3], shift) - psi[:-1, 4]).max() < 1e-12
