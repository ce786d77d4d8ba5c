"""Shortest durations use their limits up and keep them."""

from dataclasses import replace

import numpy as np
import pytest

from comove.errors import OptionError, RobotError
from comove.robots import JointMotion, verify_joints
from comove.robots.timing import fastest_timing, shortest_duration
from comove.scenes import Scene
from tests.robots.known_carry import baxter, hands_motion, known_carry, scene_data

CARRIED = {"left": 0.125, "right": 0.125}  # kg


def report_at(joints, robot=None):
    """What the judge says of a known motion at another duration."""
    motion = hands_motion(Scene.from_dict(scene_data(joints.duration)))
    return verify_joints(robot or baxter(), motion, joints).report


def test_an_even_stretch_uses_a_limit_up_and_keeps_the_motion_of_the_hands():
    _, joints = known_carry()
    timing = shortest_duration(baxter(), joints, carried=CARRIED)
    assert timing.duration == pytest.approx(3.97, abs=0.05)
    assert timing.limit == "velocity of left_e1 at 3.09 s"
    motion = hands_motion(Scene.from_dict(scene_data(timing.duration)))
    fine = JointMotion(
        np.linspace(0, timing.duration, 2001),
        joints.joint_names,
        timing.joints.curve(np.linspace(0, timing.duration, 2001)),
    )
    verdict = verify_joints(baxter(), motion, fine)
    assert verdict.reasons == ()
    assert verdict.report.velocity_ratio_max == pytest.approx(1.0, abs=1e-6)


def test_a_share_of_the_limits_takes_its_time():
    _, joints = known_carry()
    whole, part = (shortest_duration(baxter(), joints, share=share).duration for share in (1.0, 0.8))
    assert part == pytest.approx(whole / 0.8)


@pytest.mark.parametrize(("weaker", "power"), [("velocity", 1.0), ("acceleration", 0.5)])
def test_each_kind_of_limit_counts(weaker, power):
    robot, (_, joints) = baxter(), known_carry()
    one, two = (
        shortest_duration(replace(robot, **{weaker: scale * getattr(robot, weaker)}), joints, carried=CARRIED)
        for scale in (0.1, 0.05)
    )
    assert two.duration == pytest.approx(2.0**power * one.duration)
    assert one.limit.startswith(f"{weaker} of")


def test_motors_that_can_just_hold_the_robot_still_move_it_slowly():
    robot, (_, joints) = baxter(), known_carry()
    weak = replace(robot, effort=0.68 * robot.effort)
    timing = shortest_duration(weak, joints, carried=CARRIED)
    assert timing.limit.startswith("torque of left_s1")
    assert timing.duration > shortest_duration(robot, joints, carried=CARRIED).duration
    assert report_at(timing.joints, weak).torque_ratio_max == pytest.approx(1.0, abs=1e-3)
    assert report_at(timing.joints, weak).torque_ratio_max <= 1.0


def test_motors_that_cannot_hold_the_robot_still_are_told_where():
    robot, (_, joints) = baxter(), known_carry()
    with pytest.raises(
        RobotError, match=r"left_s1 needs .* N m only to hold still what is .* s along the path"
    ):
        shortest_duration(robot, joints, carried={"left": 20.0})
    with pytest.raises(RobotError, match="N m only to hold still"):
        fastest_timing(robot, joints, carried={"left": 20.0})


def test_a_free_pace_is_faster_and_keeps_the_limits_and_the_path():
    robot, (_, joints) = baxter(), known_carry()
    even = shortest_duration(robot, joints, carried=CARRIED)
    free = fastest_timing(robot, joints, carried=CARRIED)
    assert 2.89 <= free.duration <= 1.05 * 2.895 < 0.8 * even.duration  # s, of TOPP-RA on 2000 points
    curve = free.joints.curve
    time = np.linspace(0.0, free.duration, 20_001)
    assert (np.abs(curve(time, 1)) <= robot.velocity * (1 + 1e-9)).all()
    assert (np.abs(curve(time, 2)) <= robot.acceleration * (1 + 1e-9)).all()
    places = np.array([[robot.tool_pose(q, arm)[:3, 3] for arm in robot.arms] for q in curve(time[::10])])
    apart = np.linalg.norm(places[:, 0] - places[:, 1], axis=1)
    np.testing.assert_allclose(apart, 0.6, atol=1e-6)
    np.testing.assert_allclose(curve(time[[0, -1]]), joints.position[[0, -1]], atol=1e-9)
    np.testing.assert_allclose(curve(time[[0, -1]], 1), 0.0, atol=1e-9)


def test_one_joint_alone_goes_as_the_textbook_says():
    """A joint that turns by d within v and a takes d/v + v/a."""
    robot = baxter()
    time = np.linspace(0.0, 5.0, 101)
    position = np.repeat(robot.home[None], 101, axis=0)
    phase = time / 5.0
    position[:, 0] += phase**3 * (10 - 15 * phase + 6 * phase**2)
    timing = fastest_timing(robot, JointMotion(time, robot.joint_names, position))
    textbook = 1.0 / robot.velocity[0] + robot.velocity[0] / robot.acceleration[0]
    assert textbook <= timing.duration <= 1.05 * textbook


def test_a_path_that_turns_back_is_never_slower_than_stretched():
    robot, time = baxter(), np.linspace(0.0, 5.0, 201)
    position = np.repeat(robot.home[None], 201, axis=0)
    position[:, 0] += np.sin(np.pi * time / 5.0) ** 2
    joints = JointMotion(time, robot.joint_names, position)
    assert fastest_timing(robot, joints).duration <= shortest_duration(robot, joints).duration


@pytest.mark.parametrize(
    ("options", "told"),
    [
        ({"grid_points": 499}, "500 or more"),
        ({"share": 0.0}, "more than 0"),
        ({"share": 1.1}, "at most 1"),
        ({"carried": {"left": -1.0}}, "masses of 0 or more"),
    ],
)
def test_options_outside_their_range_are_refused(options, told):
    with pytest.raises(OptionError, match=told):
        fastest_timing(baxter(), known_carry()[1], **options)
    with pytest.raises(RobotError, match="did you mean 'left'"):
        shortest_duration(baxter(), known_carry()[1], carried={"lefty": 1.0})
