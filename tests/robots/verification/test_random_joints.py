"""No joint motion is certified to stay farther away than an independent judge meets it, near contact too."""

from collections import Counter

import numpy as np
import pytest

from tests.robots.verification.random_joints import deviating, judged, near_contact, robot_of


def outcomes(draws, strays=False):
    """Outcomes of draws, robot and number each, and the false certificates; joints may deviate."""
    found, false = Counter(), []
    for name, seed in draws:
        rng = np.random.default_rng([seed, 131 if strays else 127])
        draw = deviating(rng, name) if strays else (near_contact(rng, name),)
        clearance, met, word = judged(name, *draw)
        found[word] += 1
        if word == "false certificate":
            false.append((name, seed, clearance, met))
    return found, false


def test_nothing_is_certified_that_comes_nearer():
    found, false = outcomes([("two_pandas", seed) for seed in range(8)])
    assert not false
    assert found["certified"] > 1
    assert found["contact"] > 1


@pytest.mark.slow
def test_nor_by_other_robots():
    found, false = outcomes([(robot_of(seed), seed) for seed in range(100, 160)])
    assert not false
    assert found["certified"] > 15
    assert found["contact"] > 15
    assert found["undecided"] < 6


def test_nothing_comes_nearer_where_joints_deviate():
    found, false = outcomes([("two_ur10", seed) for seed in range(12)], strays=True)
    assert not false
    assert found["certified"] > 3
    assert found["contact"] > 1


@pytest.mark.slow
def test_nor_do_joints_of_other_robots_that_deviate():
    found, false = outcomes([(robot_of(seed), seed) for seed in range(100, 160)], strays=True)
    assert not false
    assert found["certified"] > 15
    assert found["contact"] > 10
