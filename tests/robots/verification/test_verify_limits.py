"""Extremes of joint motions and torques, against dense sampling and statics."""

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.interpolate import CubicSpline

from comove.robots.effort import largest_torque, loaded_model, torques
from comove.robots.motion import (
    JointCurve,
    Ranges,
    largest_acceleration,
    largest_velocity,
    least_margin,
    subdivided,
)
from tests.robots.known_carry import baxter, known_carry


def random_curve(seed):
    """A clamped cubic spline of three joints at uneven samples."""
    rng = np.random.default_rng(seed)
    time = np.concatenate([[0.0], np.cumsum(rng.uniform(0.01, 1.0, rng.integers(1, 8)))])
    return JointCurve.through(time, rng.normal(size=(len(time), 3))), rng


def dense(curve):
    return np.linspace(curve.x[0], curve.x[-1], 20_001)


@given(st.integers(0, 2**32 - 1))
def test_a_joint_curve_is_the_clamped_cubic_spline_of_scipy(seed):
    curve, rng = random_curve(seed)
    position = rng.normal(size=(len(curve.x), 2))
    curve, spline = JointCurve.through(curve.x, position), CubicSpline(curve.x, position, bc_type="clamped")
    time = rng.permuted(np.concatenate([curve.x, rng.uniform(-0.1, 1.1, 50) * curve.x[-1]]))
    for order in range(4):
        scale = 1.0 + np.abs(spline(time, order)).max()
        np.testing.assert_allclose(curve(time, order), spline(time, order), atol=1e-11 * scale)
        np.testing.assert_array_equal(curve(time[3], order), curve(time, order)[3])
    np.testing.assert_allclose(curve.bends, np.abs(spline(curve.x, 2)), atol=1e-9 * (1 + curve.bends.max()))


@given(st.integers(0, 2**32 - 1))
def test_extremes_are_those_of_dense_sampling(seed):
    curve, rng = random_curve(seed)
    time, (lower, upper) = dense(curve), np.sort(rng.normal(size=(2, 3)), axis=0)
    margin = least_margin(curve, lower, upper)
    sampled = np.minimum(curve(time) - lower, upper - curve(time))
    assert margin.value <= sampled.min() + 1e-12
    assert margin.value == pytest.approx(sampled.min(), abs=1e-4)
    at = curve(margin.time)[margin.joint]
    assert margin.value == pytest.approx(min(at - lower[margin.joint], upper[margin.joint] - at), abs=1e-12)
    limit = rng.uniform(0.5, 2.0, 3)
    for extreme, order in ((largest_velocity(curve, limit), 1), (largest_acceleration(curve, limit), 2)):
        share = np.abs(curve(time, order)) / limit
        assert extreme.value >= share.max() - 1e-12
        assert extreme.value == pytest.approx(share.max(), rel=0.01)
        at = np.abs(curve(np.clip(extreme.time, 0.0, curve.x[-1] - 1e-15), order)[extreme.joint])
        assert extreme.value == pytest.approx(at / limit[extreme.joint], rel=1e-9)


def test_a_joint_that_stands_still_has_extremes():
    curve = JointCurve.through(np.arange(3.0), np.ones((3, 2)))
    assert least_margin(curve, np.zeros(2), np.array([3.0, 1.5])).value == 0.5
    assert largest_velocity(curve, np.ones(2)).value == 0.0


@given(st.integers(0, 2**32 - 1))
def test_the_fastest_between_samples_is_faster_than_any_instant_there(seed):
    curve, _ = random_curve(seed)
    speed, when = curve.fastest
    time = dense(curve)
    interval = np.clip(np.searchsorted(curve.x, time, side="right") - 1, 0, len(speed) - 1)
    assert (np.abs(curve(time, 1)) <= speed[interval] + 1e-12).all()
    assert ((curve.x[:-1, None] <= when) & (when <= curve.x[1:, None] + 1e-15)).all()


@given(st.integers(0, 2**32 - 1), st.integers(1, 40))
def test_ranges_hold_the_largest_of_all_that_they_touch(seed, count):
    rng = np.random.default_rng(seed)
    time, bounds = np.sort(rng.uniform(0, 1, count + 1)), rng.normal(size=(count, 2))
    begin, end = np.sort(rng.uniform(time[0], time[-1], (2, 5)), axis=0)
    found = Ranges(time, bounds).over(begin, end)
    for k in range(5):
        touched = (time[1:] > begin[k]) & (time[:-1] < end[k])
        np.testing.assert_array_equal(found[k], bounds[touched].max(axis=0))


def test_time_is_subdivided_between_the_samples():
    time, interval = subdivided(np.array([0.0, 1.0, 4.0]), np.array([2, 3]))
    np.testing.assert_allclose(time, [0, 0.5, 1, 2, 3, 4])
    np.testing.assert_array_equal(interval, [0, 0, 1, 1, 1])


def potential(robot, arms, masses, q):
    """Of all links and the point masses [J], by Pinocchio's kinematics alone."""
    data = robot.model.createData()
    pin.framesForwardKinematics(robot.model, data, q)
    links = zip(data.oMi, robot.model.inertias, strict=True)
    height = sum(body.mass * placed.act(body.lever)[2] for placed, body in list(links)[1:])
    carried = (robot.tool_pose(q, arm)[2, 3] * mass for arm, mass in zip(arms, masses, strict=True))
    return 9.81 * (height + sum(carried))


def test_at_rest_motors_hold_the_weight_of_arms_and_load_less_the_springs():
    """Torques at rest are the gradient of the potential energy."""
    robot, rng = baxter(), np.random.default_rng(0)
    masses = np.array([0.7, 1.3])
    model, step = loaded_model(robot, robot.arms, masses), 1e-6
    for q in rng.uniform(robot.lower, robot.upper, (3, 14)):
        held, own = np.zeros(14), np.zeros(14)
        for j in range(14):
            ahead, behind = (q + sign * step * np.eye(14)[j] for sign in (1, -1))
            for out, carried in ((held, masses), (own, np.zeros(2))):
                energies = (potential(robot, robot.arms, carried, x) for x in (ahead, behind))
                out[j] = np.subtract(*energies) / (2 * step)
        found = torques(robot, model, q[None], np.zeros((1, 14)), np.zeros((1, 14)))[0]
        np.testing.assert_allclose(found, held - robot.relief * own, atol=1e-5)


def test_torques_between_samples_stay_below_the_largest_that_is_told():
    robot, (_, joints) = baxter(), known_carry()
    worst = largest_torque(robot, robot.arms, np.array([0.125, 0.125]), joints.curve)
    time = np.linspace(0.0, joints.duration, 20_001)
    model = loaded_model(robot, robot.arms, np.array([0.125, 0.125]))
    share = np.abs(torques(robot, model, *joints.at(time))) / robot.effort
    assert share.max() <= worst.value <= share.max() + 1e-3
    assert share[:, worst.joint].max() == share.max()


def test_a_heavier_load_asks_for_more_from_who_carries_it():
    robot, (_, joints) = baxter(), known_carry()
    equal, left = (
        largest_torque(robot, robot.arms, np.array(masses), joints.curve).value
        for masses in ([0.125, 0.125], [0.25, 0.0])
    )
    assert left > equal + 0.01
