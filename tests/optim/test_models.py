"""Linear models and the nearest feasible point, against what is known exactly."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.optimize import nnls

from comove.optim.models import LinearModel, bound_rows, nearest_feasible
from tests.cases import examples


def unit_rows(rng, m, n):
    rows = rng.standard_normal((m, n))
    return rows / np.linalg.norm(rows, axis=1, keepdims=True)


@given(st.integers(0, 2**32 - 1), st.integers(1, 6), st.integers(2, 8), st.integers(0, 2))
@examples(150)
def test_the_step_is_the_shortest_to_the_feasible_set(seed, m, n, n_equalities):
    """Karush, Kuhn and Tucker: feasible, multipliers of the right sign, no force from a constraint with slack."""
    rng = np.random.default_rng(seed)
    rows, missed = unit_rows(rng, m, n), rng.uniform(-1, 1, m)
    free = np.arange(m) < min(n_equalities, m)
    if np.linalg.cond(rows @ rows.T + 1e-12 * np.eye(m)) > 1e4:  # dependent rows may contradict each other
        return
    multipliers = nearest_feasible(rows, missed, free)
    left = missed - rows @ rows.T @ multipliers
    assert (left[~free] < 1e-5).all()
    assert np.abs(left[free]).max(initial=0.0) < 1e-5
    assert (multipliers[~free] >= 0).all()
    assert np.abs(multipliers * left).max() < 1e-4


@given(st.integers(0, 2**32 - 1), st.integers(1, 30), st.integers(2, 8))
@examples(100)
def test_multipliers_agree_with_nonnegative_least_squares(seed, m, n):
    """The dual min 1/2 |G^T l|^2 - l c over l >= 0, solved by scipy where c = -G p says that p is feasible."""
    rng = np.random.default_rng(seed)
    rows, inside = unit_rows(rng, m, n), rng.standard_normal(n)
    missed = -rows @ inside - rng.uniform(0, 0.5, m) * (rng.random(m) < 0.5)
    multipliers = nearest_feasible(rows, missed, np.zeros(m, dtype=bool))
    step = -rows.T @ multipliers
    assert (missed + rows @ step < 1e-6).all()
    # min |d|^2 over G d <= -c, as a least-squares problem in multipliers (Lawson and Hanson, chapter 23)
    dual = np.vstack([-rows.T, missed[None]])
    solution, _ = nnls(dual, np.append(np.zeros(n), 1.0))
    residual = dual @ solution - np.append(np.zeros(n), 1.0)
    expected = -residual[:n] / residual[n]
    assert np.linalg.norm(step) == pytest.approx(np.linalg.norm(expected), abs=1e-3, rel=1e-3)


def test_contradicting_constraints_give_a_finite_compromise():
    rows, missed = np.array([[1.0, 0.0], [-1.0, 0.0]]), np.array([1.0, 1.0])  # x <= -1 and x >= 1
    multipliers = nearest_feasible(rows, missed, np.zeros(2, dtype=bool))
    assert np.isfinite(multipliers).all()


def test_constraints_that_are_met_ask_for_nothing():
    rows = unit_rows(np.random.default_rng(0), 5, 3)
    assert not nearest_feasible(rows, -np.ones(5), np.zeros(5, dtype=bool)).any()


def test_bounds_are_rows_of_unit_length():
    """c + G z <= 0 exactly where mean + root z is inside."""
    rng = np.random.default_rng(0)
    root, mean = rng.standard_normal((3, 3)), rng.standard_normal(3)
    lower, upper = np.array([-1.0, -np.inf, 0.2]), np.array([1.0, 0.5, np.inf])
    rows, missed = bound_rows(root, mean, lower, upper)
    assert np.linalg.norm(rows, axis=1) == pytest.approx(np.ones(4))
    z = rng.standard_normal((500, 3))
    x = mean + z @ root.T
    inside = ((x >= lower) & (x <= upper)).all(axis=1)
    assert np.array_equal((missed + z @ rows.T <= 0).all(axis=1), inside)


@given(st.integers(0, 2**32 - 1))
def test_linear_functions_are_learned_exactly(seed):
    rng = np.random.default_rng(seed)
    n, slope, offset = 5, rng.standard_normal((3, 5)), rng.standard_normal(3)
    root, mean = np.diag(rng.uniform(0.5, 2.0, n)), rng.standard_normal(n)
    model = LinearModel(n, 3, capacity=20)
    x = mean + rng.standard_normal((12, n)) @ root
    model.add(x, x @ slope.T + offset)
    whiten = np.linalg.inv(root)
    local = model.around((model.points - mean) @ whiten, root, whiten)
    assert local.value == pytest.approx(slope @ mean + offset, abs=1e-6)
    assert local.slope == pytest.approx(slope @ root, abs=1e-6)
    assert np.abs(local.residual).max() < 1e-8


def test_slopes_survive_in_directions_that_new_points_do_not_show():
    rng = np.random.default_rng(0)
    slope = np.array([[1.0, -2.0, 3.0]])
    model = LinearModel(3, 1, capacity=8)
    x = rng.standard_normal((8, 3))
    model.add(x, x @ slope.T)
    eye = np.eye(3)
    model.around(model.points, eye, eye)
    flat = rng.standard_normal((8, 3)) * [1.0, 1.0, 0.0]  # nothing along the third axis any more
    model.add(flat, flat @ slope.T)
    assert model.around(model.points, eye, eye).slope == pytest.approx(slope, abs=1e-6)


def test_values_that_are_not_finite_teach_nothing():
    model = LinearModel(2, 1, capacity=5)
    model.add(np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]]), np.array([[1.0], [np.nan], [np.inf]]))
    assert len(model) == 1
