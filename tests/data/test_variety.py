"""Measures of variety are 0 for episodes that are alike, and right where one can work them out."""

import numpy as np
import pytest

import comove
from comove.data.variety import N_PATH, passing_class, variety
from comove.lab.examples import example_path
from comove.model import CoordinatedMotion


def straight(*ends):
    """Straight paths with these starts and goals."""
    return np.array([np.linspace(a, b, N_PATH) for a, b in ends], dtype=float)


def test_equal_episodes_have_no_variety():
    found = variety(straight(*[((0, 0), (1, 0))] * 4), {"0+": 4})
    assert (found.starts, found.goals, found.paths, found.shapes, found.entropy) == (0, 0, 0, 0, 0)


def test_shifted_episodes_differ_by_their_shift():
    found = variety(straight(((0, 0), (1, 0)), ((0, 0.3), (1, 0.3))), {"": 1, "0+": 1})
    assert found.starts == found.goals == found.paths == pytest.approx(0.3)
    assert found.shapes == pytest.approx(0.0, abs=1e-12)
    assert found.entropy == 1.0
    assert variety(straight(((0, 0), (1, 0)), ((0, 0), (1, 0))), {"": 3, "0+": 1}).entropy == pytest.approx(
        0.8112781
    )


def test_many_episodes_are_compared_by_some_pairs(monkeypatch):
    rng = np.random.default_rng(1)
    paths = straight(*[((0, y), (1, y)) for y in rng.random(600)])
    some = variety(paths, {"": 600}).paths
    monkeypatch.setattr("comove.data.variety.PAIRS", 10**9)
    every = variety(paths, {"": 600}).paths
    assert some == pytest.approx(every, rel=0.02)
    assert every == pytest.approx(1 / 3, rel=0.1)  # of two uniform numbers


@pytest.mark.parametrize(("name", "views"), [("wide", 1), ("window", 2)])
def test_a_motion_has_a_class_for_every_view(name, views):
    motion = CoordinatedMotion.straight(comove.Scene.load(example_path(name)))
    assert len(passing_class(motion).split(" | ")) == views


def test_the_class_is_that_of_the_hands_centre():
    """Between the two boxes of the wide scene, the upward ray of the lower one alone is crossed."""
    motion = CoordinatedMotion.straight(comove.Scene.load(example_path("wide")))
    assert passing_class(motion) == "0+"
