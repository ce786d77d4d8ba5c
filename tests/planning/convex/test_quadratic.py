"""Programmes that begin with few rows end where those with all of them do."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.optimize import minimize

from comove.planning.convex.costs import Moves
from comove.planning.convex.limits import Limits
from comove.planning.convex.quadratic import Prices, Rows, Trust, minimum
from tests.cases import examples

N = 5
NO_LIMITS = Limits(2, (np.inf, np.inf, np.inf)).linear(
    np.zeros((3, 2)), Moves(np.zeros((3, 2, N)), np.ones((3, 1)), np.zeros(N, dtype=bool))
)


@examples(40)
@given(seed=st.integers(0, 10_000), n_rows=st.integers(1, 120))
def test_the_solution_is_that_of_all_rows(seed, n_rows):
    """SLSQP, which is told all rows, finds none that is cheaper."""
    rng = np.random.default_rng(seed)
    gradient, whiten = 0.1 * rng.normal(size=N), np.linalg.inv(np.tril(rng.uniform(0.5, 1.5, (N, N))))
    rows = rng.normal(size=(n_rows, N))
    bound = -rng.uniform(0.0, 0.1, n_rows)  # dz = 0 is allowed
    moves, radius = rng.normal(size=(8, N)), np.full(8, 0.2)
    clearances = Rows(rows, bound, np.zeros(n_rows, dtype=np.int64), np.full(n_rows, -np.inf))
    prices = Prices(1e6, 0.0, 1.0, 1.0, 0.0)
    found = minimum(gradient, whiten, clearances, Trust(moves, np.zeros(8), radius), NO_LIMITS, prices)
    dz = found.w @ whiten
    assert (rows @ dz - bound).min() > -1e-5
    assert (np.abs(moves @ dz) - radius).max() < 1e-5
    assert found.slack < 1e-5

    def value(w):
        return 0.5 * w @ w + gradient @ w

    oracle = minimize(
        value,
        np.zeros(N),
        method="SLSQP",
        constraints=[
            {"type": "ineq", "fun": lambda w: rows @ (w @ whiten) - bound},
            {"type": "ineq", "fun": lambda w: radius - np.abs(moves @ (w @ whiten))},
        ],
        options={"maxiter": 500, "ftol": 1e-14},
    )
    assert value(found.w) <= oracle.fun + 1e-6


def test_what_cannot_be_had_is_missed_by_as_little_as_possible():
    """Two walls that face each other, 2 cm too near: each is missed by one."""
    rows = np.array([[1.0, 0, 0, 0, 0], [-1.0, 0, 0, 0, 0]])
    clearances = Rows(rows, np.full(2, 0.01), np.arange(2), np.full(2, -np.inf))
    trust = Trust(np.eye(N), np.zeros(N), np.ones(N))
    found = minimum(np.zeros(N), np.eye(N), clearances, trust, NO_LIMITS, Prices(1e6, 0.0, 1.0, 1.0, 0.0))
    assert found.slack == pytest.approx(0.01, abs=1e-6)
    assert found.w == pytest.approx(np.zeros(N), abs=1e-5)


@pytest.mark.parametrize("seed", range(10))
def test_a_dear_slack_hides_no_progress(seed):
    """Beyond some price, what cannot be had is missed by the same amount; at 1e9 rounding hides the progress."""
    rng, n = np.random.default_rng(seed), 30
    gradient, rows, bound = 0.03 * rng.normal(size=n), rng.normal(size=(200, n)), 1e-3 * rng.normal(size=200)
    clearances = Rows(rows, bound, np.zeros(200, dtype=np.int64), np.full(200, -np.inf))
    trust = Trust(np.eye(n), np.zeros(n), np.full(n, 10.0))
    limits = Limits(2, (np.inf, np.inf, np.inf)).linear(
        np.zeros((3, 2)), Moves(np.zeros((3, 2, n)), np.ones((3, 1)), np.zeros(n, dtype=bool))
    )
    cheap, dear = (
        minimum(gradient, np.eye(n), clearances, trust, limits, Prices(price, 0.0, 1.0, 1.0, 0.0))
        for price in (1e6, 1e9)
    )
    assert dear.slack == pytest.approx(cheap.slack, rel=1e-3)
    assert (rows @ dear.w - bound).min() > -dear.slack - 1e-5


def test_no_programme_is_begun_once_all_is_over():
    """Rows are added round by round, each of which may take a second."""
    rng, asked = np.random.default_rng(0), []
    rows = rng.normal(size=(200, N))
    clearances = Rows(rows, -0.03 * np.ones(200), np.zeros(200, dtype=np.int64), np.full(200, -np.inf))
    trust = Trust(np.eye(N), np.zeros(N), np.ones(N))
    given = np.full(N, 0.5), np.eye(N), clearances, trust, NO_LIMITS, Prices(1e6, 0.0, 1.0, 1.0, 0.0)
    whole = minimum(*given)
    assert whole.programmes > 1
    for rounds in range(whole.programmes + 1):
        asked.clear()
        found = minimum(*given, over=lambda most=rounds: asked.append(1) or len(asked) > most)
        assert (found is None) == (rounds < whole.programmes)
