"""Loads as bodies."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from comove.model import Scene
from comove.sim.loads import carried, load_of, points_of


def some_poses(shape, seed=0):
    rng = np.random.default_rng(seed)
    poses = np.zeros((*shape, 4, 4))
    poses[..., :3, :3] = Rotation.random(int(np.prod(shape)), rng=rng).as_matrix().reshape(*shape, 3, 3)
    poses[..., :3, 3] = rng.normal(size=(*shape, 3))
    poses[..., 3, 3] = 1.0
    return poses


def scene_with(load, hands, **more):
    return Scene.from_dict(
        {
            "name": "loads",
            "duration": 1.0,
            "workspace": {"lower": [-5, -5, -5], "upper": [5, 5, 5]},
            "load": load,
            "manipulators": [
                {"name": f"hand{i}", "start": hand, "goal": [hand[0], hand[1], hand[2] + 1.0]}
                for i, hand in enumerate(hands)
            ],
            **more,
        }
    )


def at(hands):
    poses = np.repeat(np.eye(4)[None], len(hands), axis=0)
    poses[:, :3, 3] = hands
    return poses


def ends(load, part):
    """Both ends of a capsule's axis in the scene."""
    along = part.rotation[:, 2] * part.size[1]
    return points_of(load.pose, np.array([part.position + along, part.position - along]))


def test_a_bar_reaches_beyond_the_hands():
    hands = [[1.0, 1.0, 0.5], [1.0, 0.4, 0.5]]
    load = load_of(
        scene_with({"shape": "bar", "length": 0.6, "radius": 0.02, "overhang": 0.1}, hands), at(hands)
    )
    (bar,) = load.parts
    assert bar.kind == "capsule" and bar.size == pytest.approx((0.02, 0.4))
    found = ends(load, bar)
    assert np.allclose(sorted(found[:, 1]), [0.3, 1.1]) and np.allclose(found[:, [0, 2]], [1.0, 0.5])
    assert np.allclose(points_of(load.pose, load.grasps), hands)
    assert load.mass == 0.25


def test_fingers_hold_a_bar_by_its_sides():
    hands = [[1.0, 1.0, 0.5], [1.0, 0.4, 0.5]]
    scene = scene_with({"shape": "bar", "length": 0.6, "radius": 0.012, "mass": 1.5}, hands)
    load = load_of(scene, at(hands), lambda radius: (radius, 2 * radius))
    (bar,) = load.parts
    assert bar.kind == "box"
    assert bar.size == pytest.approx((0.312, 0.006, 0.012))  # as far as the round ends of the scene's bar
    assert np.allclose(load.pose[:3, 0], [0, 1, 0]) and np.allclose(load.pose[:3, 2], [0, 0, 1])
    assert load.mass == 1.5


def test_fingers_hold_a_box_by_lugs_where_hands_stand_off_it():
    hands = [[1.0, 0.9, 0.5], [1.0, 0.5, 0.5]]
    box = {"shape": "box", "size": [0.3, 0.14, 0.06], "grasps": {"hand0": [0.2, 0, 0], "hand1": [-0.2, 0, 0]}}
    level = [{"type": "upright"}]
    scene = scene_with(box, hands, constraints=level)
    assert len(load_of(scene, at(hands)).parts) == 1
    _, *lugs = load_of(scene, at(hands), lambda radius: (radius, 2 * radius)).parts
    middles = points_of(load_of(scene, at(hands)).pose, np.array([lug.position for lug in lugs]))
    assert np.allclose(
        middles, [[1.0, 0.8825, 0.5], [1.0, 0.5175, 0.5]]
    )  # from the box to 15 mm past the hand
    assert all(lug.size == pytest.approx((0.0325, 0.006, 0.012)) for lug in lugs)
    box["grasps"] = {"hand0": [0.15, 0, 0], "hand1": [-0.15, 0, 0]}
    hands = [[1.0, 0.85, 0.5], [1.0, 0.55, 0.5]]
    assert (
        len(
            load_of(
                scene_with(box, hands, constraints=level), at(hands), lambda radius: (radius, radius)
            ).parts
        )
        == 1
    )


def test_a_frame_has_a_rod_for_every_edge():
    hands = [[0.0, 0.0, 0.5], [1.0, 0.0, 0.5], [0.5, 1.0, 0.5]]
    edges = [["hand0", "hand1"], ["hand1", "hand2"]]
    load = load_of(scene_with({"shape": "frame", "edges": edges, "radius": 0.03}, hands), at(hands))
    assert len(load.parts) == 2
    for part, (a, b) in zip(load.parts, ((0, 1), (1, 2)), strict=True):
        found = ends(load, part)
        assert any(np.allclose(found, [hands[i], hands[j]]) for i, j in ((a, b), (b, a)))


def test_what_hands_carry_goes_with_them():
    hands, load = some_poses((7, 2)), some_poses((7,), seed=1)
    hands[1:, 1] = hands[1:, 0] @ (np.linalg.inv(hands[0, 0]) @ hands[0, 1])
    held = np.linalg.inv(hands[0]) @ load[0]
    poses = carried(hands, held)
    assert np.allclose(poses[0], load[0])
    assert np.allclose(np.linalg.inv(hands[:, 0]) @ poses, held[0])


def test_hands_that_disagree_carry_the_load_in_the_middle():
    hands = np.repeat(np.eye(4)[None, None], 2, axis=1)
    hands[0, :, 0, 3] = -0.1, 0.1
    hands[0, :, :3, :3] = Rotation.from_rotvec([[0, 0, 0.2], [0, 0, -0.2]]).as_matrix()
    assert np.allclose(carried(hands, np.repeat(np.eye(4)[None], 2, axis=0)), np.eye(4))
