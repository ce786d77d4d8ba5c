"""Task-priority control over the joints of a robot: what holds, in which order, and whose joints are judged."""

import numpy as np
import pytest

import comove
from comove.lab.compared import TaskPriority
from comove.planning import PaperCost
from comove.robots import Robot
from comove.robots.carrying import RobotCarrier
from tests.solved import example

ROBOT = Robot.load("baxter")


def controlled(name, **settings):
    method = TaskPriority(**settings)
    return comove.solve(example(name), robot=ROBOT, method=method, objective=PaperCost(), budget=120.0)


@pytest.fixture(scope="module")
def wide():
    return controlled("baxter_wide")


@pytest.mark.slow
def test_straight_lines_between_far_posts_are_verified_with_the_robot_s_joints(wide):
    assert wide.verified, wide.reasons
    log = wide.log
    assert log["relative_beyond_bound"] == log["absolute_beyond_bound"] == log["slack_max_m_per_s"] == 0.0
    assert log["turn_error_max_rad"] < 1e-3


@pytest.mark.slow
def test_the_last_level_keeps_joints_near_to_where_they_began(wide):
    """Seven joints an arm are more than a hand needs: without a posture they drift with what is left."""
    free = controlled("baxter_wide", posture=0.0)
    assert free.verified
    ends = [found.joints.attempt.position[[0, -1]] for found in (wide, free)]
    drift = [np.linalg.norm(last - first) for first, last in ends]
    assert drift[0] < drift[1]


@pytest.mark.slow
def test_relative_motion_comes_before_the_goal_in_front_of_near_posts():
    found = controlled("baxter_narrow")
    assert not found.verified
    assert found.report.end_error > 0.1
    assert found.log["relative_beyond_bound"] == 0.0
    assert found.log["turn_error_max_rad"] < 0.05


@pytest.mark.slow
def test_joints_that_are_kept_are_those_of_the_motion(wide):
    """Of all joints that hold the load exactly, those are judged that are nearest to the given ones."""
    motion, carrier = wide.attempt, RobotCarrier(ROBOT, wide.scene)
    columns = np.concatenate([arm.columns for arm in carrier.holders])
    tracked = carrier.track(motion)[0].position[:, columns]
    elsewhere = tracked.copy()
    elsewhere[:, 2] += 0.2  # an elbow aside, and the hands with it
    carrier.keep(motion, elsewhere)
    joints, verdict = carrier.carried_out(motion)
    kept = joints.position[:, columns]
    assert verdict.report.hand_error_sampled < 1e-6
    assert np.linalg.norm(kept - elsewhere) < np.linalg.norm(tracked - elsewhere)
    assert carrier.reasons(motion) == verdict.reasons
