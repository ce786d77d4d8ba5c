"""Covers of meshes: they hold the whole solid, and reach beyond it by no more than they say."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from comove.geometry.convex_decomposition import SETTINGS, decompose, left_out
from comove.geometry.polytopes import hull_of
from comove.geometry.topology import solids_and_sheets
from tests.cases import examples

from ..meshes import are_inside, box, distances, hull, l_profile, on_surface, ring, spoilt, star

seeds = st.integers(0, 2**32 - 1)


def held(decomposition, points):
    """How far each point is from being in one of the polytopes; 0 or less where it is."""
    beyond = [(points @ p.planes[:, :3].T - p.planes[:, 3]).max(axis=1) for p in decomposition.polytopes]
    return np.min(beyond, axis=0)


def some_points(vertices, faces, rng):
    """Points on the surface and inside."""
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    inner = rng.uniform(low, high, (400, 3))
    inner = inner[are_inside(vertices, faces, inner)]
    return np.concatenate([vertices, on_surface(vertices, faces, 400, rng), inner])


def of_polytopes(decomposition, rng, count=60):
    """Random points of the polytopes, many at their corners and edges."""
    points = []
    for p in decomposition.polytopes:
        share = rng.dirichlet(np.full(len(p.vertices), 0.15), count)
        points += [share @ p.vertices, p.vertices]
    return np.concatenate(points)


def check(vertices, faces, rng, resolution=None):
    decomposition = decompose(solids_and_sheets(vertices, faces), resolution)
    size = np.ptp(vertices, axis=0).max()
    assert held(decomposition, some_points(vertices, faces, rng)).max() < 1e-8 * size
    coal = pytest.importorskip("coal")
    beyond = distances(vertices, faces, of_polytopes(decomposition, rng), coal).max()
    assert beyond <= decomposition.excess + 1e-6
    return decomposition


@examples(15)
@given(seeds)
def test_a_convex_mesh_is_one_polytope_without_overhang(seed):
    rng = np.random.default_rng(seed)
    vertices, faces = hull(rng.standard_normal((rng.integers(4, 20), 3)) * rng.uniform(0.03, 0.2, 3))
    decomposition = check(vertices, faces, rng)
    assert len(decomposition.polytopes) == 1
    assert decomposition.excess == 0.0


@examples(12)
@given(seeds)
def test_a_mesh_that_is_not_convex_is_held(seed):
    rng = np.random.default_rng(seed)
    vertices, faces = star(rng)
    vertices = Rotation.random(random_state=seed).apply(vertices) + rng.uniform(-1, 1, 3)
    decomposition = check(vertices, faces, rng)
    assert decomposition.excess < 2 * SETTINGS.share * np.ptp(vertices, axis=0).max()


def test_what_boxes_make_up_is_held_exactly():
    vertices, faces = l_profile()
    decomposition = check(vertices, faces, np.random.default_rng(0))
    assert len(decomposition.polytopes) == 2
    assert decomposition.excess == 0.0


@pytest.mark.parametrize("seed", range(4))
def test_a_cover_does_not_depend_on_how_the_mesh_is_turned(seed):
    vertices, faces = l_profile()
    turn, shift = Rotation.random(random_state=seed), np.random.default_rng(seed).uniform(-1, 1, 3)
    decomposition = check(turn.apply(vertices) + shift, faces, np.random.default_rng(seed))
    assert len(decomposition.polytopes) == 2
    assert decomposition.excess == 0.0


def test_a_hole_stays_open():
    vertices, faces = ring()
    decomposition = check(vertices, faces, np.random.default_rng(1))
    through = np.column_stack([np.zeros((9, 2)), np.linspace(-0.1, 0.1, 9)])
    assert held(decomposition, through).min() > 0.05


def test_what_is_combined_was_cut_to_the_end():
    """More pieces than are kept singly: all of them are there before they are combined."""
    rng, (vertices, faces) = np.random.default_rng(0), ring()
    found = decompose(solids_and_sheets(vertices, faces), settings=replace(SETTINGS, most_pieces=20))
    assert held(found, some_points(vertices, faces, rng)).max() < 1e-8
    assert len(found.polytopes) < 20


@pytest.mark.slow
def test_finer_is_nearer():
    vertices, faces = ring()
    rough, fine = (check(vertices, faces, np.random.default_rng(1), r) for r in (0.01, 0.003))
    assert fine.excess < rough.excess
    assert fine.excess < 0.006


def test_many_corners_become_few():
    rng = np.random.default_rng(0)
    ball = rng.standard_normal((800, 3))
    vertices, faces = hull(0.1 * ball / np.linalg.norm(ball, axis=1, keepdims=True))
    decomposition = check(vertices, faces, rng)
    (only,) = decomposition.polytopes
    assert len(only.planes) <= 96
    assert 0.0 < decomposition.excess < 0.007


def test_parts_are_covered_one_by_one_and_a_cavity_is_part_of_what_is_around_it():
    (first, faces), (second, more) = box([0.1, 0.1, 0.1]), box([0.05, 0.2, 0.1])
    both = np.concatenate([first, second + [0.3, 0, 0]]), np.concatenate([faces, more + len(first)])
    assert len(check(*both, np.random.default_rng(0)).polytopes) == 2
    hollow = np.concatenate([first, 0.5 * first]), np.concatenate([faces, faces[:, ::-1] + len(first)])
    decomposition = check(*hollow, np.random.default_rng(0))
    assert held(decomposition, np.zeros((1, 3)))[0] > 0.02  # nothing is in the middle


@examples(5)
@given(seeds)
@pytest.mark.slow
def test_a_sheet_is_held_and_what_it_leaves_open_stays_open(seed):
    """A wall with a window, turned in any way: every point of the wall is held, the middle of the window is not."""
    rng = np.random.default_rng(seed)
    outer = np.array([[-0.5, -0.4, 0], [0.5, -0.4, 0], [0.5, 0.4, 0], [-0.5, 0.4, 0]])
    vertices = np.concatenate([outer, 0.4 * outer])
    faces = np.array(
        [[i, (i + 1) % 4, 4 + i] for i in range(4)]
        + [[(i + 1) % 4, 4 + (i + 1) % 4, 4 + i] for i in range(4)]
    )
    turn = Rotation.random(random_state=seed)
    turned, shift = turn.apply(vertices), rng.uniform(-1, 1, 3)
    for few in (True, False):
        decomposition = decompose(solids_and_sheets(turned + shift, faces), few=few)
        assert held(decomposition, on_surface(turned + shift, faces, 400, rng)).max() < 1e-8
        assert held(decomposition, shift[None])[0] > 0.1
        assert held(decomposition, turn.apply([[-0.4, 0.1, 0.05]]) + shift)[0] > 0.05 - 2 * SETTINGS.sheet


@examples(40)
@given(seeds)
def test_what_is_left_of_triangles_is_what_no_polytope_holds(seed):
    """By area: what random boxes hold of random triangles, by many points, and what is left make up all of them."""
    rng = np.random.default_rng(seed)
    triangles = rng.uniform(-1, 1, (6, 3, 3))
    polytopes = [hull_of(rng.uniform(-1, 1, (8, 3)) * 0.7 + rng.uniform(-0.5, 0.5, 3)) for _ in range(4)]
    polygons = left_out(triangles, polytopes, 1e-9)
    left = sum(
        0.5 * np.linalg.norm(np.cross(p[1:-1] - p[0], p[2:] - p[0]).sum(axis=0))
        for p in polygons
        if len(p) > 2
    )
    area = 0.5 * np.linalg.norm(
        np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]), axis=1
    )
    share = rng.random((3000, 2))
    share[share.sum(axis=1) > 1] = 1 - share[share.sum(axis=1) > 1]
    expected = 0.0
    for triangle, own in zip(triangles, area, strict=True):
        points = triangle[0] + share @ (triangle[1:] - triangle[0])
        beyond = np.min(
            [(points @ p.planes[:, :3].T - p.planes[:, 3]).max(axis=1) for p in polytopes], axis=0
        )
        expected += own * (beyond > 0).mean()
    assert left == pytest.approx(expected, abs=0.04 * area.sum())


RUBBISH = st.sampled_from(["flip", "double", "drop", "sliver", "fin", "unwelded", "line", "crossing", "far"])


@examples(6)
@given(seeds, st.lists(RUBBISH, max_size=4), st.booleans())
@pytest.mark.slow
def test_every_triangle_is_held_whatever_is_done_to_a_mesh(seed, done, few):
    rng = np.random.default_rng(seed)
    vertices, faces = spoilt(*star(rng), done, rng)
    decomposition = decompose(solids_and_sheets(vertices, faces), few=few)
    size = np.ptp(vertices[np.unique(faces)], axis=0).max()
    points = np.concatenate([vertices[np.unique(faces)], on_surface(vertices, faces, 400, rng)])
    assert held(decomposition, points).max() < 1e-8 * size


def test_a_plate_with_a_hole_is_four_boxes():
    """The sides of the hole are a small part of the surface, and all that tells where the hole is."""
    trimesh = pytest.importorskip("trimesh")
    profile = np.array(
        [[0, 0], [1, 0], [1, 1], [0, 1], [0.45, 0.45], [0.55, 0.45], [0.55, 0.55], [0.45, 0.55]]
    )
    ring_faces = [[0, 1, 5], [0, 5, 4], [1, 2, 6], [1, 6, 5], [2, 3, 7], [2, 7, 6], [3, 0, 4], [3, 4, 7]]
    vertices = np.concatenate([np.column_stack([profile, np.full(8, z)]) for z in (0.0, 0.01)])
    faces = [[c, b, a] for a, b, c in ring_faces] + [[a + 8, b + 8, c + 8] for a, b, c in ring_faces]
    for i in range(4):
        j = (i + 1) % 4
        faces += [[i, j, j + 8], [i, j + 8, i + 8], [4 + j, 4 + i, 12 + i], [4 + j, 12 + i, 12 + j]]
    vertices, faces = vertices.astype(float), np.array(faces)
    assert trimesh.Trimesh(vertices, faces, process=False).is_watertight
    decomposition = check(vertices, faces, np.random.default_rng(0))
    assert len(decomposition.polytopes) == 4
    assert decomposition.excess < 1e-6
