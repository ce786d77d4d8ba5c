"""Covers of meshes: they hold the whole solid, and reach beyond it by no more than they say."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from comove.scenes.cover import SHARE, cover_of

from ..meshes import are_inside, box, distances, hull, l_profile, on_surface, ring, star

seeds = st.integers(0, 2**32 - 1)


def held(cover, points):
    """How far each point is from being in one of the polytopes; 0 or less where it is."""
    beyond = [(points @ p.planes[:, :3].T - p.planes[:, 3]).max(axis=1) for p in cover.polytopes]
    return np.min(beyond, axis=0)


def some_points(vertices, faces, rng):
    """Points on the surface and inside."""
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    inner = rng.uniform(low, high, (400, 3))
    inner = inner[are_inside(vertices, faces, inner)]
    return np.concatenate([vertices, on_surface(vertices, faces, 400, rng), inner])


def of_polytopes(cover, rng, count=60):
    """Random points of the polytopes, many at their corners and edges."""
    points = []
    for p in cover.polytopes:
        share = rng.dirichlet(np.full(len(p.vertices), 0.15), count)
        points += [share @ p.vertices, p.vertices]
    return np.concatenate(points)


def check(vertices, faces, rng, resolution=None):
    cover = cover_of(vertices, faces, resolution)
    size = np.ptp(vertices, axis=0).max()
    assert held(cover, some_points(vertices, faces, rng)).max() < 1e-8 * size
    coal = pytest.importorskip("coal")
    beyond = distances(vertices, faces, of_polytopes(cover, rng), coal).max()
    assert beyond <= cover.overhang + 1e-6
    return cover


@settings(max_examples=15, deadline=None)
@given(seeds)
def test_a_convex_mesh_is_one_polytope_without_overhang(seed):
    rng = np.random.default_rng(seed)
    vertices, faces = hull(rng.standard_normal((rng.integers(4, 20), 3)) * rng.uniform(0.03, 0.2, 3))
    cover = check(vertices, faces, rng)
    assert len(cover.polytopes) == 1
    assert cover.overhang == 0.0


@settings(max_examples=12, deadline=None)
@given(seeds)
def test_a_mesh_that_is_not_convex_is_held(seed):
    rng = np.random.default_rng(seed)
    vertices, faces = star(rng)
    vertices = Rotation.random(random_state=seed).apply(vertices) + rng.uniform(-1, 1, 3)
    cover = check(vertices, faces, rng)
    assert cover.overhang < 2 * SHARE * np.ptp(vertices, axis=0).max()


def test_what_boxes_make_up_is_held_exactly():
    vertices, faces = l_profile()
    cover = check(vertices, faces, np.random.default_rng(0))
    assert len(cover.polytopes) == 2
    assert cover.overhang == 0.0


@pytest.mark.parametrize("seed", range(4))
def test_a_cover_does_not_depend_on_how_the_mesh_is_turned(seed):
    vertices, faces = l_profile()
    turn, shift = Rotation.random(random_state=seed), np.random.default_rng(seed).uniform(-1, 1, 3)
    cover = check(turn.apply(vertices) + shift, faces, np.random.default_rng(seed))
    assert len(cover.polytopes) == 2
    assert cover.overhang == 0.0


def test_a_hole_stays_open():
    vertices, faces = ring()
    cover = check(vertices, faces, np.random.default_rng(1))
    through = np.column_stack([np.zeros((9, 2)), np.linspace(-0.1, 0.1, 9)])
    assert held(cover, through).min() > 0.05


def test_finer_is_nearer():
    vertices, faces = ring()
    rough, fine = (check(vertices, faces, np.random.default_rng(1), r) for r in (0.01, 0.003))
    assert fine.overhang < rough.overhang
    assert fine.overhang < 0.006


def test_many_corners_become_few():
    rng = np.random.default_rng(0)
    ball = rng.standard_normal((800, 3))
    vertices, faces = hull(0.1 * ball / np.linalg.norm(ball, axis=1, keepdims=True))
    cover = check(vertices, faces, rng)
    (only,) = cover.polytopes
    assert len(only.planes) <= 96
    assert 0.0 < cover.overhang < 0.007


def test_parts_are_covered_one_by_one_and_a_cavity_is_part_of_what_is_around_it():
    (first, faces), (second, more) = box([0.1, 0.1, 0.1]), box([0.05, 0.2, 0.1])
    both = np.concatenate([first, second + [0.3, 0, 0]]), np.concatenate([faces, more + len(first)])
    assert len(check(*both, np.random.default_rng(0)).polytopes) == 2
    hollow = np.concatenate([first, 0.5 * first]), np.concatenate([faces, faces[:, ::-1] + len(first)])
    cover = check(*hollow, np.random.default_rng(0))
    assert held(cover, np.zeros((1, 3)))[0] > 0.02  # nothing is in the middle


def test_what_lies_in_a_plane_has_no_cover():
    assert cover_of(np.eye(3), np.array([[0, 1, 2], [0, 2, 1]])) is None
