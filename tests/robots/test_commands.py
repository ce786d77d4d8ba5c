"""Commands for controllers: what the verified curve says at every cycle."""

import numpy as np
import pytest

from comove.errors import OptionError, RobotError
from comove.robots import JointMotion, verify_joints
from comove.robots.motion import commands
from tests.robots.known_carry import baxter, known_carry


@pytest.fixture(scope="module")
def motion():
    return verify_joints(baxter(), *known_carry()).verified


@pytest.mark.parametrize("rate", [100.0, 61.37, 1000.0])
def test_every_cycle_has_the_command_of_the_curve_and_the_ends_are_at_rest(motion, rate):
    told = list(motion.stream(rate))
    time = np.array([command.time for command in told])
    np.testing.assert_allclose(np.diff(time)[:-1], 1 / rate, atol=1e-12)
    assert time[0] == 0.0
    assert time[-1] == motion.joints.duration
    assert 0 < np.diff(time)[-1] <= 1 / rate + 1e-12
    np.testing.assert_array_equal(told[0].position, motion.joints.position[0])
    np.testing.assert_allclose(told[-1].position, motion.joints.position[-1], atol=1e-12)
    for name in ("velocity", "acceleration"):
        assert len(getattr(told[0], name)) == 14
    assert np.abs([told[0].velocity, told[-1].velocity]).max() < 1e-9


def test_positions_velocities_and_accelerations_belong_together(motion):
    told = list(motion.stream(1000.0))
    position, velocity, acceleration = (np.array([command[k] for command in told]) for k in (1, 2, 3))
    middle = slice(1, -2)  # the last cycle may be shorter
    speed = 500.0 * (position[2:] - position[:-2])[:-1]
    np.testing.assert_allclose(speed, velocity[middle], atol=1e-5)
    change = 500.0 * (velocity[2:] - velocity[:-2])[:-1]
    np.testing.assert_allclose(change, acceleration[middle], atol=0.05)  # bends at the samples
    limits = motion.robot
    assert (np.abs(velocity) <= limits.velocity + 1e-9).all()
    assert (np.abs(np.diff(position, axis=0)) <= limits.velocity / 1000.0 + 1e-12).all()


def test_an_arm_gets_its_own_joints_from_the_base_to_the_tip(motion):
    robot = motion.robot
    for arm in robot.arms:
        whole, own = next(motion.stream()), next(motion.stream(arm=arm.name))
        np.testing.assert_array_equal(own.position, whole.position[arm.columns])
    with pytest.raises(RobotError, match="no arm 'middle'"):
        motion.stream(arm="middle")


def test_long_motions_are_told_without_a_gap():
    time = np.linspace(0.0, 30.0, 301)
    joints = JointMotion(time, ("a",), np.sin(time)[:, None])
    told = np.array([command.time for command in commands(joints, 100.0, np.arange(1))])
    np.testing.assert_allclose(told, np.arange(3001) / 100.0, atol=1e-12)


@pytest.mark.parametrize("rate", [0.0, -1.0, np.nan, np.inf, 5.0, True, "fast"])
def test_rates_that_no_robot_is_driven_at_are_refused_at_once(motion, rate):
    with pytest.raises(OptionError, match="rate"):
        motion.stream(rate)
