"""A joint motion as geometry alone."""

from dataclasses import replace

import numpy as np
import pytest

from comove.model import Scene
from comove.sim import Settings, play
from comove.sim.execution import contacts_at
from tests.robots.known_path import DISTANCE, known_motion
from tests.sim.benchmark import joints_straight, load_straight, posts

G = 9.81  # m/s^2


def test_everything_is_where_it_should_be():
    robot, motion = known_motion()
    execution = play(motion, robot, posts())
    assert execution.delivered, execution.reasons
    assert execution.conditions.simulator == "geometric"
    assert execution.measures["lag_max"] < 1e-9
    assert execution.measures["distance_error_max"] < 1e-9
    ends = execution.hands[[0, -1], :, :3, 3]
    assert np.abs(ends - np.stack([posts().start, posts().goal])).max() < 1e-6


def test_hands_share_the_weight():
    robot, motion = known_motion()
    execution = play(motion, robot, posts(mass=0.5))
    force = execution.wrench[..., :3].sum(axis=1)
    assert np.allclose(force[0], [0, 0, 0.5 * G], atol=1e-2)
    assert np.allclose(force[-1], [0, 0, 0.5 * G], atol=1e-2)
    assert execution.measures["internal_force_max"] < 1e-9


def test_the_straight_way_goes_as_deep_into_a_post_as_geometry_says():
    """The load's axis passes 0.4 mm from the post's: 30 + 12 mm less that."""
    robot, _ = known_motion()
    execution = play(load_straight(), robot, posts())
    depths = {contact.between: contact.depth for contact in execution.contacts}
    assert depths["the load", "obstacles[1] (cylinder)"] == pytest.approx(0.0416, abs=1e-3)
    assert not execution.delivered


def test_obstacles_stay_once_the_motion_is_over():
    """A ball that would come through the stick a second later stays short of it, whatever the scene's duration."""
    robot, motion = known_motion()
    execution = play(motion, robot, posts())
    there, late = execution.load_pose[-1, :3, 3], motion.duration + 1.0
    path = [[*map(float, point)] for point in (there + [0.9, 0, 0], there + [0.9, 0, 0], there)]
    ball = {"name": "ball", "shape": "sphere", "radius": 0.05, "center": path[0]}
    ball["motion"] = {"waypoints": path, "times": [0.0, motion.duration, late]}
    data = posts().file.model_dump(exclude_none=True, mode="json") | {"obstacles": [ball]}
    for duration in (motion.duration, None):
        scene = Scene.from_dict(data | {"duration": duration}, check_ends=False)
        joints, pose = execution.joints[[-1, -1]], execution.load_pose[[-1, -1]]
        time = np.array([motion.duration, late])
        assert not contacts_at(replace(execution, scene=scene, time=time, joints=joints, load_pose=pose))


def test_joints_on_the_shortest_way_would_bend_the_stick():
    robot, _ = known_motion()
    execution = play(joints_straight(), robot, posts())
    assert execution.measures["distance_error_max"] > 0.03
    apart = np.linalg.norm(execution.hands[:, 0, :3, 3] - execution.hands[:, 1, :3, 3], axis=1)
    assert np.allclose(execution.distance_error[:, 0], apart - DISTANCE, atol=1e-6)


def test_the_log_is_as_dense_as_asked_for():
    robot, motion = known_motion()
    execution = play(motion, robot, posts(), settings=Settings(log_rate=20.0))
    assert np.allclose(np.diff(execution.time), 0.05)
    assert {len(series) for series in execution.series().values()} == {201}
