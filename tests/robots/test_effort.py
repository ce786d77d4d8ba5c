"""Shortest durations use the limits of joints up and keep them."""

from dataclasses import replace

import numpy as np
import pytest

from comove.model import Scene
from comove.robots import JointMotion, verify_joints
from comove.robots.effort import shortest_duration
from tests.robots.known_carry import baxter, hands_motion, known_carry, scene_data


def shortest(robot, joints, masses=(0.125, 0.125)):
    return shortest_duration(robot, joints, robot.arms, np.array(masses))


def verdict_at(joints, robot):
    """The verdict on a known motion at another duration, finely sampled."""
    motion = hands_motion(Scene.from_dict(scene_data(joints.duration)))
    time = np.linspace(0, joints.duration, 2001)
    return verify_joints(robot, motion, JointMotion(time, joints.joint_names, joints.curve(time)))


def test_an_even_stretch_uses_a_limit_up_and_keeps_the_motion_of_the_hands():
    robot, (_, joints) = baxter(), known_carry()
    duration = shortest(robot, joints)
    assert duration == pytest.approx(3.97, abs=0.05)
    verdict = verdict_at(joints.stretched(duration), robot)
    assert verdict.reasons == ()
    assert verdict.report.velocity_ratio_max == pytest.approx(1.0, abs=1e-6)
    name, time = verdict.report.where["velocity_ratio_max"]
    assert (name, time) == ("left_e1", pytest.approx(3.09, abs=0.01))


@pytest.mark.parametrize(("weaker", "power"), [("velocity", 1.0), ("acceleration", 0.5)])
def test_each_kind_of_limit_counts(weaker, power):
    robot, (_, joints) = baxter(), known_carry()
    one, two = (
        shortest(replace(robot, **{weaker: scale * getattr(robot, weaker)}), joints) for scale in (0.1, 0.05)
    )
    assert two == pytest.approx(2.0**power * one)


def test_motors_that_can_just_hold_the_robot_still_move_it_slowly():
    robot, (_, joints) = baxter(), known_carry()
    weak = replace(robot, effort=0.68 * robot.effort)
    duration = shortest(weak, joints)
    assert duration > shortest(robot, joints)
    motion = hands_motion(Scene.from_dict(scene_data(duration)))
    report = verify_joints(weak, motion, joints.stretched(duration)).report
    assert report.torque_ratio_max == pytest.approx(1.0, abs=1e-3)
    assert report.torque_ratio_max <= 1.0


def test_motors_that_cannot_hold_the_robot_still_never_arrive():
    robot, (_, joints) = baxter(), known_carry()
    assert shortest(robot, joints, (20.0, 0.0)) == np.inf


def test_joints_that_do_not_move_need_no_time():
    robot, time = baxter(), np.linspace(0.0, 5.0, 11)
    still = JointMotion(time, robot.joint_names, np.repeat(robot.home[None], 11, axis=0))
    assert shortest(robot, still) == 0.0
