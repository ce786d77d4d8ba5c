"""What hands do to each other through the load is told from what moves it."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from comove.sim.execution import internal_wrenches, squeezes

numbers = st.floats(-100, 100).map(lambda x: round(x, 6))


def hands(count):
    return st.tuples(
        arrays(float, (1, count, 6), elements=numbers), arrays(float, (1, count, 3), elements=numbers)
    )


def total(wrenches, points):
    """Force and torque on the load about its origin."""
    force = wrenches[..., :3].sum(axis=1)
    return force, (wrenches[..., 3:] + np.cross(points, wrenches[..., :3])).sum(axis=1)


@given(st.integers(1, 4).flatmap(hands))
def test_internal_forces_move_nothing(drawn):
    force, torque = total(internal_wrenches(*drawn), drawn[1])
    assert np.allclose(force, 0, atol=1e-7) and np.allclose(torque, 0, atol=1e-5)


@given(st.integers(1, 4).flatmap(hands))
def test_what_is_internal_is_so_wholly(drawn):
    internal = internal_wrenches(*drawn)
    assert np.allclose(internal_wrenches(internal, drawn[1]), internal, atol=1e-5)


@given(hands(2))
def test_two_hands_internal_force_is_half_the_difference(drawn):
    wrenches, points = drawn
    internal = internal_wrenches(wrenches, points)
    half = 0.5 * (wrenches[:, 0, :3] - wrenches[:, 1, :3])
    assert np.allclose(internal[:, 0, :3], half) and np.allclose(internal[:, 1, :3], -half)


def test_hands_that_press_against_each_other():
    points = np.array([[[0.3, 0, 0], [-0.3, 0, 0]]])
    wrenches = np.zeros((1, 2, 6))
    wrenches[0, :, 0] = -7.0, 7.0
    assert np.allclose(squeezes(wrenches, points), 7.0)
    assert np.allclose(internal_wrenches(wrenches, points), wrenches)


def test_hands_that_share_a_weight_do_not_press():
    points = np.array([[[0.3, 0, 0], [-0.3, 0, 0]]])
    wrenches = np.zeros((1, 2, 6))
    wrenches[0, :, 2] = 1.0
    assert np.allclose(squeezes(wrenches, points), 0.0)
    assert np.allclose(internal_wrenches(wrenches, points)[..., :3], 0.0)


def test_one_hand_alone_presses_nothing():
    rng = np.random.default_rng(0)
    assert np.allclose(internal_wrenches(rng.normal(size=(5, 1, 6)), rng.normal(size=(5, 1, 3))), 0.0)


def test_three_hands_have_three_squeezes():
    """Outward forces on a triangle pull every edge."""
    angles = 2 * np.pi * np.arange(3) / 3
    points = np.stack([np.cos(angles), np.sin(angles), 0 * angles], axis=1)[None]
    wrenches = np.concatenate([points, 0 * points], axis=-1)
    assert squeezes(wrenches, points).shape == (1, 3)
    assert (squeezes(wrenches, points) < -0.8).all()
