"""What differs from the plan is drawn within its bounds, and the same from the same seed."""

import numpy as np

from comove.sim import Perturbation


def test_drawn_within_bounds():
    for seed in range(200):
        drawn = Perturbation.drawn(np.random.default_rng(seed), 14)
        assert 0.7 <= drawn.friction <= 1.3 and 0.7 <= drawn.mass <= 1.3
        assert len(drawn.gains) == 14 and all(0.8 <= gain <= 1.2 for gain in drawn.gains)
        assert np.isclose(np.linalg.norm(drawn.start_error), 0.005)
        assert np.linalg.norm(drawn.push.force) <= 5.0 and 0.3 <= drawn.push.at <= 0.7


def test_the_same_from_the_same_seed():
    first, second, third = (Perturbation.drawn(np.random.default_rng(seed), 14) for seed in (1, 1, 2))
    assert first == second != third
