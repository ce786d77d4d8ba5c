"""Prescribed performance: errors stay within their bound."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from comove.errors import OptionError
from comove.lab.compared import Performance

PERFORMANCE = Performance(first=0.05, last=0.01, decay=2.0, gain=4.0)


@pytest.mark.parametrize("error", [0.0499, 0.03, -0.045, 1e-6])
def test_the_mapped_error_dies_out_at_least_exponentially(error):
    """In continuous time: eps = artanh(e / rho), |eps(t)| <= |eps(0)| exp(-k t)."""

    def rate(t, e):
        return PERFORMANCE.wanted(e, t, 1e-9)

    t = np.linspace(0.0, 2.0, 21)
    e = solve_ivp(rate, (0.0, 2.0), [error], t_eval=t, method="Radau", rtol=1e-9, atol=1e-13).y[0]
    eps = np.arctanh(e / PERFORMANCE.bound(t))
    assert (np.abs(eps) <= abs(eps[0]) * np.exp(-PERFORMANCE.gain * t) * (1 + 1e-4) + 1e-9).all()


@pytest.mark.parametrize("period", [0.001, 0.005, 0.01])
def test_errors_stay_inside_under_disturbances_that_a_linear_law_does_not_hold(period):
    """A push of 0.1 m/s: k alone would let the error be 0.1 / 4 m, beyond the bound at the end."""
    rng = np.random.default_rng(0)
    e, linear = 0.04, 0.04
    for k in range(round(4.0 / period)):
        t = k * period
        push = 0.1 if t > 1.0 else 0.1 * rng.uniform(-1, 1)
        e += period * (float(PERFORMANCE.wanted(np.array([e]), t, period)[0]) + push)
        linear += period * (-PERFORMANCE.gain * linear + push)
        assert abs(e) < PERFORMANCE.bound(t + period)
    assert abs(linear) > PERFORMANCE.last


def test_what_was_forced_outside_is_drawn_back():
    error = np.array([0.2])
    assert PERFORMANCE.wanted(error, 1.0, 0.01) * 0.01 == pytest.approx(-0.5 * error, rel=0.1)


def test_an_error_of_nothing_wants_nothing():
    assert PERFORMANCE.wanted(np.zeros(3), 0.3, 0.01) == pytest.approx(np.zeros(3))


def test_bounds_that_grow_are_told():
    with pytest.raises(OptionError, match="last"):
        Performance(first=0.01, last=0.02, decay=1.0, gain=1.0)
    with pytest.raises(OptionError, match="decay"):
        Performance(first=0.01, last=0.01, decay=0.0, gain=1.0)
