"""Robots on several bases, of meshes: what it takes from distances that the bases may stand elsewhere."""

from functools import lru_cache

import numpy as np
import pinocchio as pin
import pytest

from comove.dmp.basis import motion_basis
from comove.model import CoordinatedDMP, Scene
from comove.model.coordinates import load_coordinates
from comove.robots import JointMotion, Robot, verify_joints
from comove.robots.description import Uncertainty
from comove.robots.verification.bodies import COAL_ERROR, LOAD, SCENE, SELF, bodies_of
from comove.robots.verification.carried import Carried, placements
from comove.robots.verification.kinematics import Bases
from tests.robots.known_carry import followed, grasp_frames

LENGTH = 0.4  # m, of the bar
OFF = 0.01  # m, that a base may stand elsewhere


@lru_cache(maxsize=1)
def two_pandas():
    """Two Pandas carry a bar a little way; robot, hands and joints."""
    robot = Robot.load("two_pandas")
    ends = {"left": ([0.5, 0.2, 0.4], [0.5, 0.1, 0.5]), "right": ([0.5, -0.2, 0.4], [0.5, -0.3, 0.5])}
    scene = Scene.from_dict(
        {
            "name": "two arms",
            "duration": 5.0,
            "workspace": {"lower": [-2, -2, 0], "upper": [2, 2, 2]},
            "obstacles": [{"shape": "box", "center": [0.5, 0, 0.1], "size": [0.5, 1.0, 0.1]}],
            "load": {"shape": "bar", "length": LENGTH, "radius": 0.01},
            "manipulators": [{"name": name, "start": a, "goal": b} for name, (a, b) in ends.items()],
            "grasp": {"orientation": "down"},
        }
    )
    s = np.linspace(0.0, 1.0, 51)
    pace = (s**3 * (10 - 15 * s + 6 * s**2))[:, None, None]
    hands = scene.start + pace * (scene.goal - scene.start)
    coordinates = load_coordinates(scene)
    plain = CoordinatedDMP(scene, coordinates, motion_basis(20), coordinates.boundary(), np.zeros(0))
    motion = plain.fitted(s, coordinates.from_hands(hands)).rollout()
    time = np.linspace(0.0, 5.0, 501)
    frames = grasp_frames(motion, time)
    tools = np.array([arm.tool for arm in robot.arms])
    position = followed(robot, frames @ np.linalg.inv(tools), robot.home)
    return robot, motion, JointMotion(time, robot.joint_names, position)


def put_together(uncertainty):
    robot, motion, _ = two_pandas()
    carried = Carried(motion)
    hands = carried.hands(carried.time).positions
    return bodies_of(Bases(robot, uncertainty), robot.arms, carried, hands, 0.0)


def test_robots_of_meshes_on_several_bases_are_verified():
    robot, motion, joints = two_pandas()
    verdict = verify_joints(robot, motion, joints)
    assert verdict.reasons == ()
    assert verdict.report.clearance_self > 0.05


def test_only_bodies_on_different_bases_lose_clearance_to_each_other():
    bodies = put_together(Uncertainty(position=OFF))
    taken = bodies.taken - COAL_ERROR
    for pair, kind, off in zip(bodies.geometry.collisionPairs, bodies.kind, taken, strict=True):
        first, second = (bodies.names[item].split("_")[0] for item in (pair.first, pair.second))
        if kind == SCENE:
            assert off == pytest.approx(OFF)
        elif kind == LOAD:  # it is held between two bases, and on neither
            assert off == pytest.approx(2 * OFF)
        else:
            assert kind == SELF
            assert off == pytest.approx(0.0 if first == second else 2 * OFF)


def test_a_turned_base_moves_nothing_further_than_is_taken():
    """The distance to the base times the angle, for every link, wherever the joints are."""
    robot, _, _ = two_pandas()
    angle = 1.0  # deg
    bodies = put_together(Uncertainty(rotation_deg=angle))
    rng, data, placed = np.random.default_rng(0), robot.model.createData(), bodies.geometry.createData()
    origins = [np.array(source.base.position) for source in robot.sources]
    scene_pairs = np.flatnonzero(bodies.kind == SCENE)
    for q in rng.uniform(robot.lower, robot.upper, (20, len(robot.lower))):
        pin.updateGeometryPlacements(robot.model, data, bodies.geometry, placed, q)
        for pair in scene_pairs:
            link = bodies.geometry.collisionPairs[int(pair)].first
            origin = origins[bodies.names[link].startswith("right_")]
            item = bodies.geometry.geometryObjects[link]
            center = placed.oMg[link].act(np.array(item.geometry.aabb_center))
            moved = 2 * np.sin(np.deg2rad(angle) / 2) * np.linalg.norm(center - origin)
            assert moved <= bodies.taken[pair] - COAL_ERROR + 1e-12


def test_a_box_of_a_load_is_where_its_corners_are():
    rng = np.random.default_rng(0)
    size, turn, middle = np.array([0.1, 0.2, 0.3]), pin.exp3(rng.normal(size=3)), rng.normal(size=3)
    corners = (np.arange(8)[:, None] >> np.arange(3) & 1) - 0.5
    nodes = np.concatenate([np.zeros((2, 3)), middle + (corners * size) @ turn.T])
    rotation, center = placements(nodes[None], tuple(range(2, 10)))
    np.testing.assert_allclose(rotation[0], turn, atol=1e-12)
    np.testing.assert_allclose(center[0], middle, atol=1e-12)


@pytest.mark.parametrize("along", [[1.0, 0, 0], [0, 1.0, 0], [0, 0, -1.0], [0.5, -0.5, 0.7]])
def test_a_rod_of_a_load_lies_along_its_ends(along):
    nodes = np.array([[[0.3, 0.2, 0.1], np.array([0.3, 0.2, 0.1]) + along]])
    rotation, center = placements(nodes, (0, 1))
    np.testing.assert_allclose(rotation[0].T @ rotation[0], np.eye(3), atol=1e-12)
    np.testing.assert_allclose(rotation[0][:, 2], along / np.linalg.norm(along), atol=1e-12)
    assert np.linalg.det(rotation[0]) == pytest.approx(1.0)
    np.testing.assert_allclose(center[0], nodes[0].mean(axis=0))
