"""A robot in MuJoCo that follows commands: what it carries, grips and lets fall."""

import numpy as np
import pytest

from comove.model import Scene
from comove.sim import Friction, Weld, simulate
from comove.sim.robot import SimulatedRobot
from comove.sim.robot_record import CARRIED
from tests.robots.known_path import known_motion
from tests.sim.benchmark import load_straight, posts

STEP = SimulatedRobot.timestep
GRASPS = [Weld(), Friction()]


def follow(robot, motion, seconds=None, *, start=0.0):
    """Command a motion from a time in it on, which rests when it is over."""
    seconds = motion.duration + 0.5 if seconds is None else seconds
    time = start + np.arange(round(seconds / STEP)) * STEP
    rows = motion.at(np.minimum(time, motion.duration))
    for i, at in enumerate(time):
        position, velocity, acceleration = (row[i] for row in rows)
        moves = at < motion.duration
        robot.step(position, velocity * moves, acceleration * moves)


def wait(robot, seconds):
    """Command the present positions."""
    still = np.zeros_like(robot.command)
    for _ in range(round(seconds / STEP)):
        robot.step(robot.command, still, still)


def grip(robot, share, **effort):
    for arm in ("left", "right"):
        robot.grip(arm, share, **effort)
    wait(robot, 1.0)


@pytest.fixture(scope="module")
def known():
    return known_motion()


@pytest.mark.parametrize("grasp", GRASPS, ids=["weld", "friction"])
def test_a_followed_motion_is_measured_as_its_simulation(known, grasp):
    arms, motion = known
    robot = SimulatedRobot(motion, posts(), arms, grasp)
    follow(robot, motion, motion.duration + 0.502)
    report, execution = robot.report(), simulate(motion, posts(), arms, grasp)
    assert report.delivered == execution.delivered and report.delivered
    for name in (*CARRIED, "tracking_error_max", "torque_share_max"):
        assert report.measures[name] == pytest.approx(execution.measures[name], rel=1e-6), name
    assert report.measures["end_error"] == pytest.approx(execution.goal_error, abs=1e-5)


def test_what_is_touched_is_told(known):
    """A straight way leads through a post."""
    motion = load_straight()
    robot = SimulatedRobot(motion, posts(), known[0])
    follow(robot, motion)
    report = robot.report()
    assert not report.delivered and report.contacts
    assert any("touched" in reason for reason in report.reasons)
    assert {pair for contact in report.contacts for pair in contact.between} & {"the load"}


def test_a_payload_that_is_released_at_its_goal_stays_there(known):
    arms, motion = known
    robot = SimulatedRobot(motion, posts(), arms)
    follow(robot, motion)
    grip(robot, 0.0)
    told = " ".join(robot.news())
    assert "released at its goal" in told and not robot.holds("left") and not robot.holds("right")
    report = robot.report()
    assert report.delivered and report.measures["end_error"] < 1e-3


def test_a_payload_that_is_released_on_the_way_falls(known):
    arms, motion = known
    robot = SimulatedRobot(motion, posts(), arms)
    follow(robot, motion, 4.0)
    assert not robot.report().contacts
    grip(robot, 0.0)
    report = robot.report()
    assert "the payload was released by 'left'" in report.reasons[0]
    assert report.reasons[0] in " ".join(robot.news())
    assert any(contact.between[0] == "the load" for contact in report.contacts)  # with the table


def test_one_open_gripper_is_not_enough(known):
    """The other one may hold the stick up, but not both did."""
    arms, motion = known
    robot = SimulatedRobot(motion, posts(), arms)
    follow(robot, motion, 3.0)
    robot.grip("left", 0.0)
    follow(robot, motion, start=3.0)
    assert robot.holds("right") and not robot.holds("left")
    (reason,) = robot.report().reasons
    assert "the payload was released by 'left'" in reason and "at 3.00 s" in reason


@pytest.mark.parametrize("grasp", GRASPS, ids=["weld", "friction"])
def test_a_payload_is_gripped_where_it_lies(known, grasp):
    arms, motion = known
    start = motion.position[0]
    robot = SimulatedRobot(motion, posts(), arms, grasp, present=start)
    wait(robot, 0.5)
    assert robot.report().reasons[0] == "the payload was never held by all grippers"
    assert not robot.holds("left") and robot.closed_share("left") == pytest.approx(0.0, abs=0.02)
    grip(robot, 1.0)
    told = " ".join(robot.news())
    assert told.count("has closed on the payload") == 2 and "all grippers hold the payload" in told
    assert robot.has_gripped("left") and robot.holds("left") and robot.holds("right")
    follow(robot, motion)
    report = robot.report()
    assert report.delivered, report.reasons
    assert report.measures["lag_max"] < 1e-3


def test_fingers_stop_at_the_payload(known):
    arms, motion = known
    robot = SimulatedRobot(motion, posts(), arms, Friction(), present=motion.position[0])
    grip(robot, 1.0)
    held = robot.closed_share("left")
    free = SimulatedRobot(motion, posts(), arms, Friction(), present=arms.home)
    grip(free, 1.0)
    assert held < 0.95 < free.closed_share("left")
    assert not free.holds("left")


def test_fingers_without_force_hold_nothing(known):
    """Four fingers with 0.1 N each, at a coefficient of 1, hold less than the stick's 2.5 N."""
    arms, motion = known
    robot = SimulatedRobot(motion, posts(), arms, Friction(), present=motion.position[0])
    grip(robot, 1.0, effort=0.1)
    wait(robot, 1.0)
    assert robot.holds("left") and robot.holds("right")
    grip(robot, 1.0)
    assert np.ptp(robot._world.model.actuator_forcerange[robot._grippers._travel.servos], axis=1).min() > 1.0
    grip(robot, 1.0, effort=0.1)
    follow(robot, motion, 2.0)
    assert any("slid" in reason for reason in robot.report().reasons)


def test_a_gripper_far_from_the_payload_closes_on_nothing(known):
    arms, motion = known
    robot = SimulatedRobot(motion, posts(), arms, present=arms.home)
    assert np.abs(robot.position - arms.home).max() < 1e-3
    grip(robot, 1.0)
    told = " ".join(robot.news())
    assert told.count("has closed on nothing: the payload's grasp is") == 2
    report = robot.report()
    assert not report.contacts and report.measures["end_error"] == pytest.approx(0.66, abs=0.1)


def test_no_joint_lags_while_it_waits_at_home(known):
    arms, motion = known
    robot = SimulatedRobot(motion, posts(), arms, present=arms.home)
    wait(robot, 0.5)
    assert robot.report().measures["tracking_error_max"] < 2e-5


def test_moving_obstacles_wait_until_they_begin(known):
    """A ball at rest for a second rolls into the left hand."""
    arms, motion = known
    hand = arms.tool_pose(motion.position[0], arms.arm("left"))[:3, 3]
    away = [float(hand[0]), 0.8, float(hand[2]) + 0.15]
    near = [*map(float, hand[:2]), float(hand[2]) + 0.15]
    ball = {"shape": "sphere", "center": away, "radius": 0.05}
    ball["motion"] = {"waypoints": [away, near], "times": [0.0, 1.0]}
    scene = Scene.from_dict({**posts().file.model_dump(exclude_unset=True), "obstacles": [ball]})
    robot = SimulatedRobot(motion, scene, arms)
    wait(robot, 1.5)
    assert not robot.report().contacts
    robot.begin_obstacles()
    wait(robot, 1.5)
    (contact, *_) = robot.report().contacts
    assert 1.5 < contact.time < 2.6


def test_a_payload_is_gripped_as_it_lies_and_its_plan_begins_anew(known):
    """A wrist that is turned about the stick by 0.05 rad before it grips again neither bends nor displaces it."""
    arms, motion = known
    robot = SimulatedRobot(motion, posts(), arms)
    wait(robot, 0.2)
    grip(robot, 0.0)
    robot.command = robot.command + 0.05 * (np.array(arms.joint_names) == "left_w2")
    wait(robot, 0.5)
    grip(robot, 1.0)
    assert "all grippers hold the payload" in " ".join(robot.news())
    wait(robot, 0.5)
    assert np.abs(robot.position - robot.command).max() < 1e-3
    measures = robot.report().measures
    assert measures["lag_max"] < 1e-3 and measures["internal_torque_max"] < 2.0
