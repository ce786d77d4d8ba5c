"""The curve of a joint motion, its extremes and its pace, against dense samples and Hermite's formula."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from comove.arrays import first_largest
from comove.robots import JointMotion
from comove.robots.motion import Extreme, places
from tests.cases import examples

NAMES = ("one", "two", "three")
STEPS = st.integers(2, 12)


@st.composite
def motions(draw):
    """Joints through any samples at uneven times; often still, straight or back where they were."""
    n_steps = draw(STEPS)
    gaps = draw(arrays(float, n_steps - 1, elements=st.floats(0.01, 2.0)))
    elements = st.one_of(st.integers(-3, 3).map(float), st.floats(-4, 4))
    position = draw(arrays(float, (n_steps, 3), elements=elements))
    return JointMotion(np.concatenate([[0.0], np.cumsum(gaps)]), NAMES, position)


@given(motions())
def test_the_curve_goes_through_the_samples_and_rests_at_both_ends(motion):
    position, velocity, _ = motion.at(motion.time)
    np.testing.assert_allclose(position, motion.position, atol=1e-12)
    np.testing.assert_allclose(velocity[[0, -1]], 0.0, atol=1e-9)
    assert motion.duration == motion.time[-1]


@given(motions())
def test_the_curve_is_hermites_through_positions_and_velocities(motion):
    """What trajectory controllers of ROS interpolate."""
    h = np.diff(motion.time)[:, None]
    for u in (0.0, 0.25, 0.6, 1.0):
        p, q = motion.position[:-1], motion.position[1:]
        v, w = h * motion.velocity[:-1], h * motion.velocity[1:]
        wanted = (2 * u**3 - 3 * u**2 + 1) * p + (u**3 - 2 * u**2 + u) * v
        wanted += (3 * u**2 - 2 * u**3) * q + (u**3 - u**2) * w
        np.testing.assert_allclose(motion.at(motion.time[:-1] + u * h[:, 0])[0], wanted, atol=1e-9)


@given(motions())
def test_velocity_and_acceleration_have_no_jumps_at_samples(motion):
    scale = 1e-9 * (1.0 + np.abs(motion.acceleration).max())
    for order, bound in ((1, scale), (2, 1e3 * scale)):
        inner = motion.time[1:-1]
        before = motion.curve(np.nextafter(inner, -1.0), order)
        np.testing.assert_allclose(before, motion.curve(inner, order), atol=bound)


def extremes(motion):
    """Least and largest position of each joint at any instant."""
    _, position = places(motion.curve)
    return position.min(axis=0), position.max(axis=0)


@examples(60)
@given(motions())
@pytest.mark.filterwarnings("error")
def test_extremes_are_those_of_dense_samples_and_no_wider(motion):
    dense = np.unique(np.concatenate([motion.time, np.linspace(0.0, motion.duration, 20_001)]))
    position, velocity, acceleration = motion.at(dense)
    low, high = extremes(motion)
    fastest, hardest = motion.largest()
    step = motion.duration / 20_000
    bulge = 0.125 * step**2 * hardest + 1e-12  # between two samples, by the curvature
    for exact, sampled, slack in (
        (-low, -position.min(axis=0), bulge),
        (high, position.max(axis=0), bulge),
        (fastest, np.abs(velocity).max(axis=0), step * hardest + 1e-9),
        (hardest, np.abs(acceleration).max(axis=0), 1e-9 * (1 + hardest)),
    ):
        assert (exact >= sampled - 1e-12 * (1 + np.abs(sampled))).all()
        assert (exact <= sampled + slack).all()


def test_a_joint_that_stays_has_no_extremes_of_its_own():
    still = JointMotion(np.linspace(0, 1, 5), NAMES, np.full((5, 3), 0.7))
    low, high = extremes(still)
    np.testing.assert_array_equal(low, high)
    np.testing.assert_allclose(still.largest(), 0.0, atol=1e-15)


def test_from_rest_to_rest_in_two_samples_is_the_cubic_of_the_books():
    motion = JointMotion(np.array([0.0, 2.0]), ("one",), np.array([[0.0], [1.0]]))
    s = np.linspace(0, 1, 11)
    np.testing.assert_allclose(motion.at(2 * s)[0][:, 0], 3 * s**2 - 2 * s**3, atol=1e-15)
    speed, acceleration = motion.largest()
    assert speed[0] == pytest.approx(1.5 * 1.0 / 2.0)
    assert acceleration[0] == pytest.approx(6.0 * 1.0 / 2.0**2)


@given(motions(), st.floats(0.1, 10.0))
def test_a_stretched_motion_takes_the_same_path_at_another_pace(motion, factor):
    slower = motion.stretched(factor * motion.duration)
    s = np.linspace(0, 1, 37)
    for order, power in ((0, 0), (1, 1), (2, 2)):
        wanted = motion.at(s * motion.duration)[order] / factor**power
        np.testing.assert_allclose(
            slower.at(s * slower.duration)[order], wanted, atol=1e-9 * (1 + np.abs(wanted).max()), rtol=1e-6
        )
    np.testing.assert_allclose(slower.largest()[0], motion.largest()[0] / factor, rtol=1e-6, atol=1e-9)


@given(arrays(float, (5, 3), elements=st.one_of(st.integers(-2, 2).map(float), st.floats(allow_nan=True))))
def test_the_largest_value_is_the_first_up_to_rounding_and_nan_counts_as_largest(values):
    time = np.arange(5.0)
    found = Extreme.largest(values, time)
    row, column = np.unravel_index(first_largest(values), values.shape)
    assert (found.joint, found.time) == (column, time[row])
    np.testing.assert_equal(found.value, values.max())
