"""The matrices are exact solutions of the transformed system, and every weight vector meets both ends."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

from comove.dmp.basis import motion_basis
from comove.dmp.system import ALPHA_Y, N_INTERVALS, ExponentialPhase, LinearPhase
from tests.cases import examples

KNOTS = np.linspace(0.0, 1.0, N_INTERVALS + 1)
PHASES = [LinearPhase(), ExponentialPhase(), ExponentialPhase(alpha=4.0)]
METRICS = ["velocity", "acceleration"]
seeds = st.integers(0, 2**32 - 1)


@pytest.fixture(params=PHASES, ids=["linear", "exponential", "fast"])
def phase(request):
    return request.param


@pytest.fixture(params=METRICS)
def metric(request):
    return request.param


def transformed_system(goal, y, v, force):
    """y'' of equation (1a), in unit duration."""
    return ALPHA_Y * (ALPHA_Y / 4 * (goal - y) - v) + force


def flow(start, goal, force, slope, duration):
    """Oracle: (y, y') `duration` after `start` by an adaptive integrator, for many intervals at once.

    Solves y'' = a (a/4 (g - y) - y') + force + slope t; all arrays of shape (..., n_columns), start (2, ...).
    """

    def derivative(t, state):
        y, v = state.reshape(2, *force.shape)
        return np.stack([v, transformed_system(goal, y, v, force + slope * t)]).ravel()

    solved = solve_ivp(derivative, (0, duration), start.ravel(), "DOP853", rtol=1e-12, atol=1e-13)
    return solved.y[:, -1].reshape(start.shape)


def motion_of(basis, values, weights, s):
    """y, y', y'' at `s` of boundary values (4, n_columns) and weights (n_basis, n_columns)."""
    boundary, shape = basis.at(s)
    return boundary @ values + shape @ weights


def test_every_column_solves_the_transformed_system(phase, metric):
    """From each knot to the next and to points between them, and after the end without forcing."""
    basis = motion_basis(20, metric, phase)
    knots = np.concatenate([basis.boundary, basis.shape], axis=2)
    goal = np.zeros(24)
    goal[2] = 1.0
    force = np.concatenate([basis.boundary_force, basis.shape_force], axis=1)
    assert np.array_equal(knots[:2, 0], np.eye(2, 24))
    assert np.allclose(knots[2], transformed_system(goal, *knots[:2], force), rtol=0, atol=1e-9)

    slope = np.diff(force, axis=0) * N_INTERVALS
    for share in (0.3, 0.7, 1.0):
        expected = flow(knots[:2, :-1], goal, force[:-1], slope, share / N_INTERVALS)
        at = np.concatenate(basis.at(KNOTS[:-1] + share / N_INTERVALS), axis=2)
        assert np.abs(at[:2] - expected).max() < 1e-10
        acceleration = transformed_system(goal, *at[:2], force[:-1] + slope * share / N_INTERVALS)
        assert np.abs(at[2] - acceleration)[:-1].max() < 1e-8
    assert np.abs(knots[:2, 1:] - expected).max() < 1e-10

    after = np.concatenate(basis.at([1.25]), axis=2)[:2, 0]
    assert np.abs(after - flow(knots[:2, -1], goal, 0 * force[-1], 0 * force[-1], 0.25)).max() < 1e-10


@examples(40)
@given(
    seeds,
    st.integers(1, 60),
    st.sampled_from(PHASES),
    st.sampled_from(METRICS),
    st.floats(0, 1e3),
)
def test_both_ends_are_exact_for_every_weight_vector(seed, n_basis, phase, metric, size):
    rng = np.random.default_rng(seed)
    basis = motion_basis(n_basis, metric, phase)
    values = rng.standard_normal(4)
    weights = size * rng.uniform(-1, 1, n_basis)
    ends = motion_of(basis, values, weights, [0.0, 1.0])[:2]
    expected = values.reshape(2, 2).T  # position and velocity at the start and at the end
    assert np.abs(ends[:, 0] - expected[:, 0]).max() == 0.0
    assert np.abs(ends[:, 1] - expected[:, 1]).max() <= 1e-12 * max(1.0, size)


@examples(30)
@given(seeds, st.sampled_from(PHASES), st.floats(1.0, 50.0, exclude_min=True))
def test_at_rest_ever_after(seed, phase, s):
    rng = np.random.default_rng(seed)
    basis, values = motion_basis(20, "velocity", phase), rng.standard_normal(4)
    values[3] = 0.0
    y, v, a = motion_of(basis, values, rng.standard_normal(20), [s])[:, 0]
    assert abs(y - values[2]) < 1e-12
    assert abs(v) < 1e-11
    assert abs(a) < 1e-9


def test_before_the_start_the_start_is_held():
    basis = motion_basis(5)
    assert all(np.array_equal(a, b) for a, b in zip(basis.at([-3.0]), basis.at([0.0]), strict=True))


def test_the_linear_phase_ends_without_acceleration(metric):
    basis = motion_basis(20, metric)
    resting = basis.boundary[2, -1] @ [0.7, -2.0, 0.3, 0.0]
    assert abs(resting) < 1e-9
    assert np.abs(basis.shape[2, -1]).max() < 1e-8


def test_at_agrees_with_the_knots(phase, metric):
    basis = motion_basis(20, metric, phase)
    boundary, shape = basis.at(KNOTS[:-1])
    assert np.abs(boundary - basis.boundary[:, :-1]).max() < 1e-10
    assert np.abs(shape - basis.shape[:, :-1]).max() < 1e-10


def test_samples_are_the_positions_of_at():
    basis = motion_basis(7)
    boundary, shape = basis.at(np.linspace(0, 1, 33))
    assert np.array_equal(basis.sampled(33), np.concatenate([shape[0], boundary[0]], axis=1).T)


@pytest.mark.parametrize("n_basis", [1, 5, 20, 50, 100])
def test_whitened(phase, metric, n_basis):
    """Unit weights change the velocity (or acceleration) equally much, and the middle by a unit in all."""
    basis = motion_basis(n_basis, metric, phase)
    columns = basis.shape[METRICS.index(metric) + 1]
    gram = columns.T @ columns
    assert np.abs(gram / gram[0, 0] - np.eye(n_basis)).max() < 1e-9
    assert np.linalg.norm(basis.shape[0, N_INTERVALS // 2]) == pytest.approx(1.0, abs=1e-12)


@pytest.mark.parametrize("n_basis", [5, 20, 50])
def test_well_conditioned(phase, metric, n_basis):
    """Positions, velocities and accelerations as functions of the weights."""
    basis = motion_basis(n_basis, metric, phase)
    assert max(np.linalg.cond(matrix) for matrix in basis.shape) < 1e4


def test_without_shape_weights_the_acceleration_is_least(phase, metric):
    """The least of a sum of squares: no shape weight can take anything from it."""
    basis = motion_basis(20, metric, phase)
    overlap = basis.shape[2].T @ basis.boundary[2]
    sizes = np.outer(np.linalg.norm(basis.shape[2], axis=0), np.linalg.norm(basis.boundary[2], axis=0))
    assert np.abs(overlap / sizes).max() < 1e-9


@pytest.mark.parametrize("n_basis", [0, -1, 201])
def test_numbers_of_weights_out_of_range(n_basis):
    with pytest.raises(ValueError, match="1 to 200"):
        motion_basis(n_basis)


def test_shared_matrices_cannot_be_changed():
    basis = motion_basis(5)
    assert basis is motion_basis(5)
    for name in ("boundary", "shape", "boundary_force", "shape_force"):
        with pytest.raises(ValueError, match="read-only"):
            getattr(basis, name)[0, 0] = 1.0


@pytest.mark.parametrize("n_basis", [1, 20, 50, 200])
def test_signs_do_not_hang_on_the_machine(phase, metric, n_basis):
    """Singular vectors have no signs of their own; weights in files need ones that every machine agrees on."""
    early = np.exp(-3 * KNOTS) @ motion_basis(n_basis, metric, phase).shape[0]
    assert (early > 1e-9).all()
