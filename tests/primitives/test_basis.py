"""The matrices are exact solutions of the transformed system, and every weight vector meets both ends."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

from comove.primitives.basis import (
    ALPHA_Y,
    N_INTERVALS,
    forcing_functions,
    hold_step,
    motion_basis,
)
from comove.primitives.phase import ExponentialPhase, LinearPhase

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


def integrated(force, goal, start, velocity, times):
    """Oracle: y'' = a (a/4 (g - y) - y') + f by an adaptive integrator; arrays, shape (3, n_times, n_columns).

    `force`, shape (n_knots, n_columns), is linear between the knots and silent from 1 on.
    """

    def f(t):
        i = min(int(t * N_INTERVALS), N_INTERVALS - 1)
        return force[i] + (t * N_INTERVALS - i) * (force[i + 1] - force[i]) if t < 1 else 0.0

    def derivative(t, state):
        y, v = np.split(state, 2)
        return np.concatenate([v, ALPHA_Y * (ALPHA_Y / 4 * (goal - y) - v) + f(t)])

    state, values = np.concatenate([start, velocity]), []
    for part in (times[times <= 1.0], times[times > 1.0]):
        if not len(part):
            continue
        begin = 0.0 if part[0] <= 1.0 else 1.0
        end = max(part[-1], min(times[-1], 1.0))
        solved = solve_ivp(
            derivative, (begin, end), state, "DOP853", t_eval=np.append(part, end), rtol=1e-11, atol=1e-13,
            max_step=4 / N_INTERVALS,
        )  # fmt: skip
        state = solved.y[:, -1]
        values.append(solved.y[:, : len(part)].T)
    y, v = np.split(np.concatenate(values), 2, axis=1)
    forces = np.array([f(t) + 0 * goal for t in times])
    return np.stack([y, v, ALPHA_Y * (ALPHA_Y / 4 * (goal - y) - v) + forces])


def motion_of(basis, values, weights, s):
    """y, y', y'' at `s` of boundary values (4, n_columns) and weights (n_basis, n_columns)."""
    boundary, shape = basis.at(s)
    return boundary @ values + shape @ weights


@pytest.mark.parametrize("n_basis", [1, 20])
def test_rollouts_solve_the_transformed_system(phase, metric, n_basis):
    """At the knots, between them and after the end, against an independent integrator."""
    rng = np.random.default_rng(n_basis)
    basis = motion_basis(n_basis, metric, phase)
    values, weights = rng.standard_normal((4, 3)), rng.standard_normal((n_basis, 3))
    force = basis.forcing @ (basis.forcing_of_boundary @ values + basis.forcing_of_shape @ weights)
    times = np.sort(np.concatenate([rng.uniform(0, 1, 40), KNOTS[1:-1:50], rng.uniform(1.01, 1.5, 5)]))
    expected = integrated(force, values[2], values[0], values[1], times)
    actual = motion_of(basis, values, weights, times)
    for order, tolerance in enumerate((1e-9, 1e-8, 1e-6)):
        scale = np.abs(expected[order]).max()
        assert np.abs(actual[order] - expected[order]).max() <= tolerance * scale


def test_each_column_is_a_solution():
    """One unit of each boundary value and of each shape weight at a time."""
    basis = motion_basis(8)
    unit = np.eye(4 + 8)
    values, weights = unit[:4], unit[4:]
    force = basis.forcing @ (basis.forcing_of_boundary @ values + basis.forcing_of_shape @ weights)
    expected = integrated(force, values[2], values[0], values[1], KNOTS[40::40])
    actual = np.concatenate([basis.boundary, basis.shape], axis=2)[:, 40::40]
    assert np.abs(actual[:2] - expected[:2]).max() < 1e-9


@settings(deadline=None, max_examples=40)
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


@settings(deadline=None, max_examples=30)
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


def test_forcing_functions_share_the_phase(phase):
    """Equation (2): a weighted mean, gated by the phase; each function has its time."""
    psi = forcing_functions(22, phase)
    assert psi.min() >= 0.0
    assert np.abs(psi.sum(axis=1) - phase(KNOTS)).max() < 1e-14
    assert (np.diff(psi.argmax(axis=0)) >= 0).all()


@settings(deadline=None, max_examples=50)
@given(seeds, st.floats(1e-4, 3.0), st.floats(0.05, 0.95))
def test_two_small_steps_are_one_large(seed, dt, share):
    """The exact flow under a linear force: split anywhere, it ends in the same place."""
    error, velocity, now, then = np.random.default_rng(seed).standard_normal((4, 2))
    between = now + share * (then - now)
    half = hold_step(share * dt, error, velocity, now, between)
    split = hold_step((1 - share) * dt, *half, between, then)
    whole = hold_step(dt, error, velocity, now, then)
    assert np.allclose(split, whole, rtol=1e-9, atol=1e-11)


@pytest.mark.parametrize("n_basis", [0, -1, 201])
def test_numbers_of_weights_out_of_range(n_basis):
    with pytest.raises(ValueError, match="1 to 200"):
        motion_basis(n_basis)


def test_shared_matrices_cannot_be_changed():
    basis = motion_basis(5)
    assert basis is motion_basis(5)
    for array in (basis.boundary, basis.shape, basis.forcing, basis.forcing_of_boundary, basis.forcing_of_shape):
        with pytest.raises(ValueError, match="read-only"):
            array[0, 0] = 1.0
