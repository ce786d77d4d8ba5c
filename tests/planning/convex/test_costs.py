"""Normal equations say what a sum of squares becomes, exactly, as it is quadratic in the hands."""

from dataclasses import replace

import numpy as np
import pytest

from comove.planning.convex.costs import Anchored, JerkCost, Moves, PaperSquares

N_SAMPLES, N_HANDS, N_COLUMNS, N_BASIS = 11, 4, 5, 3
EVEN = np.array([True, False, True, False, True])  # columns of two bodies: their centres lie apart


def drawn(*shape):
    return np.random.default_rng(shape).standard_normal(shape)


PRECISE = JerkCost(1.0, drawn(N_SAMPLES, N_HANDS), 1e3, drawn(N_SAMPLES, N_HANDS, N_HANDS))
COSTS = {
    "jerk": JerkCost(0.7, weight=2.0),
    "demonstration": replace(PRECISE, precision=None),
    "precision": PRECISE,
    "anchored": Anchored(JerkCost(0.7), drawn(N_SAMPLES, N_HANDS), 1e4),
    "equation 4": PaperSquares((1.0, 0.1, 0.5), drawn(N_HANDS), drawn(N_SAMPLES, N_HANDS)),
}


@pytest.mark.parametrize(
    "even", [EVEN, ~EVEN, EVEN & False, EVEN | True], ids=["some", "others", "none", "all"]
)
@pytest.mark.parametrize("cost", COSTS.values(), ids=COSTS)
def test_normal_equations_are_the_value_after_any_change(cost, even):
    slopes, shape = drawn(N_SAMPLES, N_HANDS, N_COLUMNS), drawn(N_SAMPLES, N_BASIS)
    slopes[:, :, even] = slopes[:1, :, even]
    moves, hands, dz = Moves(slopes, shape, even), drawn(N_SAMPLES, N_HANDS), drawn(N_COLUMNS * N_BASIS)
    square, gradient = cost.normal_equations(hands, moves)
    there = hands + np.einsum("shc,sk,ck->sh", slopes, shape, dz.reshape(N_COLUMNS, N_BASIS))
    change = cost.value(there) - cost.value(hands)
    assert 2 * gradient @ dz + dz @ square @ dz == pytest.approx(change, rel=1e-9)


def test_normal_equations_of_smooth_motions_are_as_exact_as_their_derivatives():
    """Third differences of smooth motions are 1e-7 of the motions: sums of products of motions would cancel."""
    n_samples, n_basis, cost = 201, 24, COSTS["jerk"]
    s, k = np.linspace(0.0, 1.0, n_samples)[:, None], np.pi * np.arange(1.0, n_basis + 1.0)
    shape, slopes, still = np.sin(k * s) / k**3, np.zeros((n_samples, 2, 2)), np.zeros((n_samples, 2))
    slopes[:, 0, 0], slopes[:, 1, 1] = 1.0, 0.01 * (1.0 + s[:, 0])
    square, _ = cost.normal_equations(still, Moves(slopes, shape, np.array([True, False])))
    changes = [shape[:, b, None] * slopes[:, :, c] for c in range(2) for b in range(n_basis)]
    exact = np.zeros_like(square)
    for term in cost.terms(n_samples):
        rows = np.stack(
            [(term.residuals(hands) - term.residuals(still)).ravel() for hands in changes], axis=1
        )
        exact += rows.T @ rows
    scale = np.sqrt(np.outer(np.diag(exact), np.diag(exact)))
    assert (np.abs(square - exact) / scale).max() < 1e-9
