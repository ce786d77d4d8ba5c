"""Bounds of speed, acceleration and jerk: above what samples show, hardly more, right where formulas are known."""

import numpy as np
import pytest

from comove.model import CoordinatedMotion, Scene
from comove.verification import verify
from comove.verification.bounds import derivative_bounds, largest_jerk, largest_rates, node_bounds
from tests.verification.random_motions import random_motion

PLACES = (np.arange(800)[:, None] + [0.02, 0.25, 0.5, 0.75, 0.98]).ravel() / 800  # within the intervals
STEP = 1e-6


def sampled_jerk(motion):
    """Largest jerk of a hand at many places, by differences of the exact acceleration [m/s^3]."""
    n_hands = len(motion.scene.manipulators)
    ahead, behind = (
        motion.coordinates.motion(motion.at(PLACES + step))[2][:, :n_hands] for step in (STEP, -STEP)
    )
    return np.linalg.norm((ahead - behind) / (2 * STEP), axis=2).max() / motion.scene.duration**3


@pytest.mark.parametrize("seed", range(40))
def test_jerk_is_bounded_closely(seed):
    """In all kinds of coordinates; the plain bound by norms is up to a third too high."""
    rng = np.random.default_rng([seed, 12])
    motion = random_motion(rng, sigma=[0.005, 0.02, 0.06][seed % 3])
    truth, bound = sampled_jerk(motion), largest_jerk(motion, node_bounds(motion).jerk)
    assert truth * (1 - 1e-6) <= bound
    plain = node_bounds(motion).jerk[:, : len(motion.scene.manipulators)].max() / motion.scene.duration**3
    assert bound <= plain
    if plain < 1.2 * truth:  # not where a direction nearly vanishes
        assert bound <= 1.1 * truth


def test_bounds_are_close_in_the_mean():
    ratios = []
    for seed in range(40):
        motion = random_motion(np.random.default_rng([seed, 13]), sigma=0.02)
        ratios.append(largest_jerk(motion, node_bounds(motion).jerk) / sampled_jerk(motion))
    assert np.median(ratios) < 1.005


@pytest.mark.parametrize("wrong", [np.nan, np.inf])
@pytest.mark.parametrize("order", [1, 2])
def test_nothing_finite_bounds_what_is_not(order, wrong):
    """A derivative that is no number at a knot spoils the intervals on both of its sides, and no others."""
    columns = np.random.default_rng(order).normal(size=(3, 801, 2))
    columns[order, 5, 1] = wrong
    finite = np.isfinite(derivative_bounds(columns))
    assert not finite[1 if order == 1 else slice(1, None), 4:6].any()
    assert finite[:, :4].all()
    assert finite[:, 6:].all()


def test_the_straight_motion_of_least_jerk_has_its_known_peaks():
    """15/8 L/T, 10/sqrt 3 L/T^2 and 60 L/T^3 (Flash and Hogan, 1985); the linear forcing adds a percent."""
    scene = Scene.from_dict(lone_hand(duration=2.0))
    speed, acceleration, jerk = largest_rates(CoordinatedMotion.straight(scene))
    assert speed == pytest.approx(15 / 8 / 2, rel=1e-3)
    assert acceleration == pytest.approx(10 / np.sqrt(3) / 4, rel=1e-3)
    assert 60 / 8 < jerk < 1.015 * 60 / 8


@pytest.mark.parametrize(("limit", "passes"), [(7.65, True), (7.4, False)])
def test_a_limit_of_jerk_is_judged(limit, passes):
    scene = Scene.from_dict(lone_hand(duration=2.0, limits={"jerk": limit}))
    verdict = verify(CoordinatedMotion.straight(scene))
    assert (verdict.verified is not None) is passes
    assert verdict.report.jerk_max == pytest.approx(7.5, rel=0.015)
    assert passes or "jerk" in verdict.reasons[0]


def test_without_a_limit_nothing_is_said_of_jerk():
    verdict = verify(CoordinatedMotion.straight(Scene.from_dict(lone_hand(duration=2.0))))
    assert "jerk_max" not in verdict.report.asdict()


def lone_hand(**more):
    """A hand that moves by a metre in an empty plane."""
    return {
        "version": 1,
        "name": "lone",
        "workspace": {"lower": [-1, -1], "upper": [2, 1]},
        "manipulators": [{"name": "hand", "start": [0, 0], "goal": [1, 0]}],
        **more,
    }
