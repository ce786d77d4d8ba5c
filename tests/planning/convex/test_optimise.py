"""Parts of a step of the optimisation."""

import numpy as np
import pytest

from comove.planning.convex.optimise import inverse_of_lower


@pytest.mark.parametrize("n", [1, 2, 65, 301])
def test_triangular_matrices_are_inverted(n):
    rng = np.random.default_rng(n)
    square = rng.normal(size=(n, n + 5))
    lower = np.linalg.cholesky(square @ square.T + np.eye(n))
    inverse = inverse_of_lower(lower)
    np.testing.assert_allclose(inverse @ lower, np.eye(n), atol=1e-9)
    assert not np.triu(inverse, 1).any()
