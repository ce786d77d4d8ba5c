"""Normal equations say what a sum of squares becomes, exactly, as it is quadratic in the hands."""

from dataclasses import replace

import numpy as np
import pytest

from comove.planning.convex.costs import Anchored, JerkCost, Moves, PaperSquares

N_SAMPLES, N_HANDS, N_COLUMNS, N_BASIS = 11, 4, 5, 3


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


@pytest.mark.parametrize("has_more", [False, True])
@pytest.mark.parametrize("cost", COSTS.values(), ids=COSTS)
def test_normal_equations_are_the_value_after_any_change(cost, has_more):
    slopes, shape = drawn(N_SAMPLES, N_HANDS, N_COLUMNS), drawn(N_SAMPLES, N_BASIS)
    more = drawn(N_SAMPLES, 2), drawn(N_SAMPLES, 2, N_COLUMNS)
    moves, hands, dz = Moves(slopes, shape), drawn(N_SAMPLES, N_HANDS), drawn(N_COLUMNS * N_BASIS)
    square, gradient = cost.normal_equations(hands, moves, more if has_more else None)
    there, further = (
        at + np.einsum("shc,sk,ck->sh", by, shape, dz.reshape(N_COLUMNS, N_BASIS))
        for at, by in ((hands, slopes), more)
    )
    change = cost.value(there) - cost.value(hands)
    change += ((further**2).sum() - (more[0] ** 2).sum()) if has_more else 0.0
    assert 2 * gradient @ dz + dz @ square @ dz == pytest.approx(change, rel=1e-9)
    np.testing.assert_array_equal(square, square.T)
