"""Poses of rigid groups are recovered, never mirrored, and hands move least onto their distances."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from comove.geometry.rotations import (
    fit_angle,
    fit_quaternion,
    matrices,
    quaternion_of_rotation,
    rotation_in_plane,
)
from comove.model.groups import GroupPose, RigidGroup, fit_pose, nearest_distances, orientation_of
from tests.cases import examples

seeds = st.integers(0, 2**32 - 1)
X = np.array([1.0, 0.0, 0.0])


def pose(rng, orientation):
    """A random pose of what `orientation` determines."""
    center = rng.uniform(-1, 1, 3)
    if orientation == "none":
        return GroupPose(center, np.eye(3))
    if orientation == "plane":
        return GroupPose(center * [1, 1, 0], rotation_in_plane(rng.uniform(-np.pi, np.pi)))
    return GroupPose(center, Rotation.random(random_state=rng.integers(2**31)).as_matrix())


def grasps(rng, orientation):
    """Random grasps, not about their middle: 1 hand, or 2 to 4 in a plane, on x, or anywhere."""
    held = 0.2 * rng.standard_normal((1 if orientation == "none" else rng.integers(2, 5), 3))
    if orientation == "none":
        return np.zeros((1, 3))
    if orientation == "space":
        return 0.2 * rng.standard_normal((rng.integers(3, 5), 3))
    return held * ([1, 1, 0] if orientation == "plane" else [1, 0, 0])


@examples(200)
@given(seeds, st.sampled_from(["none", "plane", "axis", "space"]))
def test_random_poses_are_recovered(seed, orientation):
    """Every hand is where it was; the rotation too, but for the roll about an axis."""
    rng = np.random.default_rng(seed)
    held, true = grasps(rng, orientation), pose(rng, orientation)
    found = fit_pose(held, true.place(held), orientation)
    assert np.abs(found.place(held) - true.place(held)).max() < 1e-11
    if orientation != "axis":
        assert np.abs(found.rotation - true.rotation).max() < 1e-8
    assert np.abs(found.rotation @ found.rotation.T - np.eye(3)).max() < 1e-12


@examples(100)
@given(seeds, st.sampled_from(["plane", "space"]))
def test_never_a_mirror_image(seed, orientation):
    """Even where the hands are one: the best proper rotation, as scipy finds it."""
    rng = np.random.default_rng(seed)
    held = grasps(rng, orientation)
    mirrored = held * [1, -1, 1] + 0.02 * rng.standard_normal(held.shape)
    if orientation == "plane":
        mirrored[:, 2] = 0.0
    found = fit_pose(held, mirrored, orientation)
    assert np.linalg.det(found.rotation) == pytest.approx(1.0)
    if orientation == "space":
        about = held - held.mean(axis=0), mirrored - mirrored.mean(axis=0)
        best, _ = Rotation.align_vectors(about[1], about[0])
        misses = [((h - r @ g) ** 2).sum() for r in (found.rotation, best.as_matrix())
                  for g, h in [(about[0].T, about[1].T)]]  # fmt: skip
        assert misses[0] <= misses[1] + 1e-12


@examples(50)
@given(seeds)
def test_the_angle_is_best_in_least_squares(seed):
    rng = np.random.default_rng(seed)
    held, hands = (0.2 * rng.standard_normal((3, 3)) * [1, 1, 0] for _ in range(2))
    held, hands = (points - points.mean(axis=0) for points in (held, hands))
    angle = fit_angle(held, hands)
    misses = [((hands - held @ rotation_in_plane(angle + d).T) ** 2).sum() for d in np.linspace(-3, 3, 61)]
    assert np.argmin(misses) == 30


def test_many_frames_at_once():
    """A leading axis of time changes nothing."""
    rng = np.random.default_rng(0)
    held, hands = 0.2 * rng.standard_normal((3, 3)), rng.standard_normal((5, 3, 3))
    for fit in (fit_angle, fit_quaternion):
        assert np.array_equal(fit(held, hands), [fit(held, frame) for frame in hands])


@pytest.mark.parametrize("off", [0.0, 1e-7, 1e-6, 3e-6, 1e-5, 1e-4, 1e-2])
def test_a_bar_that_points_back(off):
    """Against the x axis, as drawn by hand: the pose brings the grasps to the hands all the same."""
    held, direction = np.array([-0.1, 0.1])[:, None] * X, np.array([-1.0, off, 0.0])
    hands = held[:, :1] * direction / np.linalg.norm(direction) + 0.5
    assert np.abs(fit_pose(held, hands, "axis").place(held) - hands).max() < 1e-12


@examples(100)
@given(seeds, st.integers(0, 3))
def test_quaternions_and_matrices(seed, zeros):
    """There and back, and both agree with scipy; half turns included."""
    q = np.random.default_rng(seed).standard_normal(4)
    q[:zeros] = 0.0
    q /= np.linalg.norm(q) * (np.sign(q[0]) or 1.0)
    rotation = matrices(q)
    assert np.abs(rotation - Rotation.from_quat(q[[1, 2, 3, 0]]).as_matrix()).max() < 1e-14
    back = quaternion_of_rotation(rotation)
    assert back[0] >= 0
    assert min(np.abs(back - q).max(), np.abs(back + q).max()) < 1e-14


@examples(100)
@given(seeds, st.floats(0.05, 2.0))
def test_a_pair_moves_least_onto_its_distance(seed, distance):
    """Along the line between them, both by half: nothing shorter meets the distance."""
    points = np.random.default_rng(seed).uniform(-1, 1, (3, 3))
    moved = nearest_distances(points, [(0, 1)], np.array([distance]))
    apart = points[1] - points[0]
    missing = distance - np.linalg.norm(apart)
    step = 0.5 * missing * apart / np.linalg.norm(apart)
    assert np.abs(moved - points - [-step, step, 0 * step]).max() < 1e-12
    assert np.linalg.norm(moved[1] - moved[0]) == pytest.approx(distance, abs=1e-15)


@examples(50)
@given(seeds)
def test_a_triangle_meets_its_distances_and_hardly_moves(seed):
    rng = np.random.default_rng(seed)
    pairs, angles = [(0, 1), (1, 2), (2, 0)], 2 * np.pi / 3 * np.arange(3) + rng.uniform(-0.3, 0.3, 3)
    held = 0.2 * np.stack([np.cos(angles), np.sin(angles), 0 * angles], axis=1)
    distances = np.array([np.linalg.norm(held[i] - held[j]) for i, j in pairs])
    off = held + 1e-3 * rng.standard_normal((3, 3))
    moved = nearest_distances(off, pairs, distances)
    reached = np.array([np.linalg.norm(moved[i] - moved[j]) for i, j in pairs])
    assert np.abs(reached - distances).max() < 1e-14
    assert np.linalg.norm(moved - off) <= np.linalg.norm(held - off) * (1 + 1e-2)


def test_what_hands_determine():
    line, corner = (
        np.array([[0, 0, 0], [1, 2, 3], [2, 4, 6.0]]),
        np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0.0]]),
    )
    assert orientation_of(corner[:1], 3) == orientation_of(corner[:1], 2) == "none"
    assert orientation_of(line, 2) == orientation_of(corner, 2) == "plane"
    assert orientation_of(line, 3) == orientation_of(corner[:2], 3) == "axis"
    assert orientation_of(corner, 3) == "space"


def test_the_reach_is_that_of_the_farthest_point():
    held, corners = np.array([[-0.1, 0, 0], [0.1, 0, 0]]), np.array([[0.3, 0.4, 0.0]])
    group = RigidGroup((0, 1), held, corners, "plane", GroupPose(X, np.eye(3)), GroupPose(X, np.eye(3)))
    assert group.reach == pytest.approx(0.5)
    assert np.array_equal(group.points, np.concatenate([held, corners]))
