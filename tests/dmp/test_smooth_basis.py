"""The basis of smooth motions: at rest without acceleration at both ends, and measured by its jerk."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

from comove.dmp.basis import motion_basis
from comove.dmp.system import ALPHA_Y, ExponentialPhase
from tests.cases import examples

S = np.linspace(0.0, 1.0, 4001)
seeds = st.integers(0, 2**32 - 1)
counts = st.integers(1, 60)


def drawn(seed, n_basis):
    """A random motion of one column: its ends and weights."""
    rng = np.random.default_rng(seed)
    return np.array([*rng.standard_normal(3), 0.0]), 0.01 * rng.standard_normal(n_basis)


def motion_of(basis, ends, weights, s=S):
    boundary, shape = basis.at(s)
    return boundary @ ends + shape @ weights


def squared_jerk(basis, ends, weights):
    """By differences of the exact acceleration; the jerk of these motions is nearly even between knots."""
    acceleration = motion_of(basis, ends, weights)[2]
    return (np.diff(acceleration) ** 2).sum() * (len(S) - 1)


@examples(40)
@given(seeds, counts)
def test_ends_are_met_without_acceleration(seed, n_basis):
    ends, weights = drawn(seed, n_basis)
    y, v, a = motion_of(motion_basis(n_basis, "jerk"), ends, weights, np.array([0.0, 1.0]))
    size = 1.0 + np.abs(ends).max()
    np.testing.assert_allclose(y, ends[[0, 2]], atol=1e-11 * size)
    np.testing.assert_allclose(v, ends[[1, 3]], atol=1e-10 * size)
    np.testing.assert_allclose(a, 0.0, atol=1e-7 * size)


@examples(20)
@given(seeds, counts)
def test_it_is_a_movement_primitive(seed, n_basis):
    """An adaptive integrator of equation (1a), driven by the stored forcing term, arrives at the same curve."""
    ends, weights = drawn(seed, n_basis)
    basis = motion_basis(n_basis, "jerk")
    force = basis.boundary_force @ ends + basis.shape_force @ weights
    knots = np.linspace(0.0, 1.0, len(force))

    def derivative(s, state):
        y, v = state
        return [v, ALPHA_Y * (ALPHA_Y / 4 * (ends[2] - y) - v) + np.interp(s, knots, force)]

    places = np.linspace(0.0, 1.0, 21)
    found = solve_ivp(
        derivative, (0, 1), ends[:2], "DOP853", places, rtol=1e-10, atol=1e-11, max_step=1 / 800
    )
    np.testing.assert_allclose(found.y, motion_of(basis, ends, weights, places)[:2], atol=1e-6)


@examples(30)
@given(seeds, st.integers(1, 40))
def test_jerk_is_that_of_the_ends_and_the_square_of_the_weights(seed, n_basis):
    """Pythagoras: shape weights are orthogonal in jerk to the motion of least jerk, and to each other."""
    ends, weights = drawn(seed, n_basis)
    basis = motion_basis(n_basis, "jerk")
    unit = squared_jerk(basis, 0 * ends, np.eye(n_basis)[0])
    found = squared_jerk(basis, ends, weights)
    expected = squared_jerk(basis, ends, 0 * weights) + unit * weights @ weights
    assert found == pytest.approx(expected, rel=2e-3)


@pytest.mark.parametrize("n_basis", [1, 8, 24, 60])
def test_without_weights_it_is_the_minimum_jerk_motion(n_basis):
    """Flash and Hogan (1985); and what begins with a velocity is its quintic."""
    basis = motion_basis(n_basis, "jerk")
    from_rest = motion_of(basis, np.array([0.0, 0, 1, 0]), np.zeros(n_basis))[0]
    np.testing.assert_allclose(from_rest, S**3 * (10 + S * (6 * S - 15)), atol=2e-5)
    moving = motion_of(basis, np.array([0.0, 1, 0, 0]), np.zeros(n_basis))[0]
    np.testing.assert_allclose(moving, S - 6 * S**3 + 8 * S**4 - 3 * S**5, atol=2e-5)


def test_it_has_no_other_phase():
    with pytest.raises(ValueError, match="linear phase"):
        motion_basis(10, "jerk", ExponentialPhase())
