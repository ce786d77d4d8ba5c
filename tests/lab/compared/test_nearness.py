"""Rows of free hands: on the safe side, and there where something is near."""

import numpy as np
import pytest

from comove.lab.compared.nearness import Approach, clearance_rows
from tests.model.examples import scene_of

STEP = 1e-3  # s
SCENE = scene_of(
    [[-1.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 2.0, 0.0]],
    [[-1.0, 0.0, 3.0], [1.0, 0.0, 3.0], [0.0, 2.0, 3.0]],
    load={"shape": "bar", "length": 2.0, "radius": 0.05, "held_by": ["a", "b"]},
    constraints=[{"type": "separation", "between": ["a", "c"], "distance": 0.5}],
    obstacles=[
        {"shape": "box", "center": [0.1, 0.9, 1.5], "size": [0.5, 0.4, 0.6]},
        {"shape": "sphere", "center": [-0.6, -0.7, 1.5], "radius": 0.3},
        {"shape": "cylinder", "center": [0.8, -1.0, 1.5], "radius": 0.2, "height": 1.0},
    ],
)


def clearance(scene, hands):
    nodes = hands.copy()
    return min(scene.clearance_at(nodes)[0], np.linalg.norm(hands[0] - hands[2]) - 0.5)


@pytest.mark.parametrize("seed", range(20))
def test_a_small_step_within_the_rows_uses_up_no_more_than_allowed(seed):
    """The clearance after a step is at least what the approach rate leaves of it, to second order of the step."""
    rng = np.random.default_rng(seed)
    approach = Approach(gain=10.0, braking=np.inf, need=0.0)
    hands = SCENE.start + [0.0, 0.0, 1.5] + 0.1 * rng.standard_normal((3, 3))
    still = np.zeros((len(SCENE.obstacles), 3))
    rows, low = clearance_rows(SCENE, hands, SCENE.obstacles, still, approach, 10.0)
    velocity = rng.standard_normal(9)
    for _ in range(200):  # onto the rows, one by one
        for row, least in zip(rows, low, strict=True):
            velocity += max(0.0, least - row @ velocity) / (row @ row) * row
    assert (rows @ velocity >= low - 1e-6).all()
    before, after = clearance(SCENE, hands), clearance(SCENE, hands + STEP * velocity.reshape(3, 3))
    assert after >= before * (1 - 10.0 * STEP) - 20 * STEP**2 * (1 + velocity @ velocity)


def test_a_velocity_against_a_row_loses_clearance():
    """The row of the nearest point is the slope of the clearance."""
    approach = Approach(gain=10.0, braking=np.inf, need=0.0)
    hands = SCENE.start + [0.0, 0.0, 1.5]
    still = np.zeros((len(SCENE.obstacles), 3))
    rows, low = clearance_rows(SCENE, hands, SCENE.obstacles, still, approach, 10.0)
    tightest = rows[np.argmax(low)]
    before = clearance(SCENE, hands)
    after = clearance(SCENE, hands - STEP * tightest.reshape(3, 3))
    assert (before - after) / STEP == pytest.approx(tightest @ tightest, rel=0.01)
    assert low.max() == pytest.approx(-10.0 * before, rel=1e-6)


def test_an_obstacle_that_comes_asks_for_a_retreat():
    approach = Approach(gain=10.0, braking=np.inf, need=0.0)
    hands, coming = SCENE.start + [0.0, 0.0, 1.5], np.array([[0.0, -8.0, 0.0], [0, 0, 0], [0, 0, 0]])
    rows, low = clearance_rows(SCENE, hands, SCENE.obstacles, coming, approach, 10.0)
    pushed = rows[np.argmax(low)].reshape(3, 3)
    assert low.max() > 0
    assert pushed[0, 1] < 0 > pushed[1, 1]


def test_rates_brake_in_time_and_restore_slowly():
    approach = Approach(gain=10.0, braking=2.0, need=0.01)
    left = np.array([-1.0, 0.0, 1e-4, 0.5])
    assert approach.rate(left) == pytest.approx([-0.25, 0.0, 1e-3, np.sqrt(2 * 2.0 * 0.5)])
