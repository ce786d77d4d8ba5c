"""Poses and twists: the step is exact and keeps every distance, and poses, hands and configurations agree."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.linalg import expm

from comove.control.safety.twists import advanced, hand_velocities, nodes_of, poses_of
from comove.errors import OptionError
from comove.geometry.rotations import matrices
from comove.model.coordinates import HandPoses, load_coordinates, poses_at, projected_coordinates

from .moving import scene_of

seeds = st.integers(0, 2**32 - 1)
LOADS = [
    ("bar", False),
    ("bar", True),
    ("frame", False),
    ("frame", True),
    ("two bodies", True),
    ("box", True),
]
UPRIGHT = {"box": {"constraints": [{"type": "upright"}]}}


def loaded(load, spatial, **more):
    return scene_of(load=load, spatial=spatial, **UPRIGHT.get(load, {}), **more)


def random_poses(rng, n_groups):
    quaternion = rng.standard_normal((n_groups, 4))
    return HandPoses(
        rng.standard_normal((n_groups, 3)), quaternion / np.linalg.norm(quaternion, axis=1)[:, None]
    )


@given(seeds)
def test_the_step_is_the_matrix_exponential(seed):
    """Of the linear equation of motion of a point: c' = v, (R r)' = w x R r."""
    rng = np.random.default_rng(seed)
    poses, twist, dt = random_poses(rng, 1), rng.standard_normal(6) * 3, rng.uniform(0, 1)
    w = twist[3:]
    generator = np.zeros((7, 7))
    generator[:3, 6] = twist[:3]
    generator[3:6, 3:6] = [[0, -w[2], w[1]], [w[2], 0, -w[0]], [-w[1], w[0], 0]]
    point = rng.standard_normal(3)
    state = np.concatenate([poses.center[0], matrices(poses.quaternion[0]) @ point, [1.0]])
    later = expm(dt * generator) @ state
    after = advanced(poses, twist[None], dt)
    np.testing.assert_allclose(after.center[0], later[:3], atol=1e-13)
    np.testing.assert_allclose(matrices(after.quaternion[0]) @ point, later[3:6], atol=1e-13)


@given(seeds)
def test_steps_of_one_twist_add_up(seed):
    rng = np.random.default_rng(seed)
    poses, twist = random_poses(rng, 2), rng.standard_normal((2, 6))
    twice = advanced(advanced(poses, twist, 0.3), twist, 0.4)
    once = advanced(poses, twist, 0.7)
    np.testing.assert_allclose(twice.center, once.center, atol=1e-14)
    np.testing.assert_allclose(matrices(twice.quaternion), matrices(once.quaternion), atol=1e-14)


def test_a_tiny_turn_is_a_turn():
    poses = HandPoses(np.zeros((1, 3)), np.array([[1.0, 0, 0, 0]]))
    after = advanced(poses, np.array([[0, 0, 0, 1e-9, 0, 0]]), 1.0)
    np.testing.assert_allclose(after.quaternion[0], [1.0, 5e-10, 0, 0], atol=1e-24)


@pytest.mark.parametrize(("load", "spatial"), [("bar", False), ("frame", True)])
def test_distances_do_not_drift(load, spatial):
    """Over 100,000 random steps, in every one of them to 1e-12."""
    scene, rng = loaded(load, spatial), np.random.default_rng(0)
    poses = poses_of(scene, "start")
    n = len(scene.manipulators)
    pairs = np.triu_indices(n, 1)
    first = nodes_of(scene, poses)[:n]
    lengths = np.linalg.norm(first[pairs[0]] - first[pairs[1]], axis=1)
    twists = rng.standard_normal((100_000, 1, 6)) * [1, 1, 1, 3, 3, 3]
    if not spatial:
        twists[..., 2:5] = 0.0
    worst = 0.0
    for i, twist in enumerate(twists):
        poses = advanced(poses, twist, 0.01)
        if i % 10 == 0 or i < 100:
            hands = nodes_of(scene, poses)[:n]
            kept = np.linalg.norm(hands[pairs[0]] - hands[pairs[1]], axis=1)
            worst = max(worst, np.abs(kept - lengths).max())
    assert worst < 1e-12
    assert abs(np.linalg.norm(poses.quaternion) - 1) < 1e-15
    if not spatial:
        assert not nodes_of(scene, poses)[:, 2].any()


@pytest.mark.parametrize(("load", "spatial"), LOADS)
@pytest.mark.parametrize("end", ["start", "goal"])
def test_poses_at_the_ends_place_the_nodes(load, spatial, end):
    scene = loaded(load, spatial)
    np.testing.assert_allclose(nodes_of(scene, poses_of(scene, end)), scene.nodes_at(end), atol=1e-14)


@pytest.mark.parametrize(("load", "spatial"), LOADS)
def test_poses_of_hands_and_configurations(load, spatial):
    """Hands of moved poses lead back to poses with the same nodes, by themselves and as a configuration."""
    scene, rng = loaded(load, spatial), np.random.default_rng(3)
    twists = rng.standard_normal((len(scene.groups), 6))
    for twist, group in zip(twists, scene.groups, strict=True):
        if not spatial:
            twist[2:5] = 0.0
        if group.orientation in ("none", "vertical"):
            twist[3:5] = 0.0
    poses = advanced(poses_of(scene, "start"), twists, 0.4)
    nodes = nodes_of(scene, poses)
    hands = nodes[: len(scene.manipulators), : scene.n_dims]
    np.testing.assert_allclose(nodes_of(scene, poses_of(scene, hands)), nodes, atol=1e-12)
    coordinates = load_coordinates(scene)
    q = coordinates.from_hands(hands[None])[0]
    np.testing.assert_allclose(nodes_of(scene, poses_at(coordinates, q)), nodes, atol=1e-12)


@pytest.mark.parametrize(("load", "spatial"), LOADS)
def test_poses_of_many_configurations_place_the_nodes_as_the_coordinates_do(load, spatial):
    scene, rng = loaded(load, spatial), np.random.default_rng(8)
    coordinates = load_coordinates(scene)
    q = rng.standard_normal((40, coordinates.n_columns))
    poses, nodes = poses_at(coordinates, q), coordinates.nodes(np.ascontiguousarray(q.T[None]))[0]
    for k in range(len(q)):
        placed = nodes_of(scene, HandPoses(poses.center[k], poses.quaternion[k]))
        np.testing.assert_allclose(placed, nodes[k], atol=1e-12)


def test_a_bar_that_points_backwards_has_turned_about_the_vertical():
    scene = loaded("bar", True)
    coordinates = load_coordinates(scene)
    center = scene.groups[0].start.center
    poses = poses_at(coordinates, [*center, -1.0, 0.0, 0.0])
    np.testing.assert_allclose(np.abs(poses.quaternion[0]), [0.0, 0.0, 0.0, 1.0], atol=1e-15)


def test_poses_of_projected_coordinates():
    scene = loaded("bar", False)
    coordinates = projected_coordinates(scene)
    q = coordinates.from_hands(scene.start[None])[0]
    np.testing.assert_allclose(nodes_of(scene, poses_at(coordinates, q)), scene.nodes_at("start"), atol=1e-12)


@pytest.mark.parametrize(("load", "spatial"), LOADS)
def test_hand_velocities_are_differences(load, spatial):
    scene, rng = loaded(load, spatial), np.random.default_rng(5)
    poses, twists = poses_of(scene, "start"), rng.standard_normal((len(scene.groups), 6))
    n, dt = len(scene.manipulators), 1e-6
    ahead, behind = (nodes_of(scene, advanced(poses, twists, t))[:n] for t in (dt, -dt))
    np.testing.assert_allclose(hand_velocities(scene, poses, twists), (ahead - behind) / (2 * dt), atol=1e-8)


def test_what_is_no_configuration_is_told():
    for q in (np.zeros(2), np.full(3, np.nan)):
        with pytest.raises(OptionError):
            poses_at(load_coordinates(loaded("bar", False)), q)
