"""Distances from triangles, by an oracle of plain NumPy and by coal, and what is within closed ones."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from comove.geometry.surfaces import (
    Placed,
    holds,
    nearest,
    point_distances,
    signed_distance,
    surface_distance,
    surfaces_of,
)
from comove.geometry.topology import solids_and_sheets
from tests import brute_force
from tests.cases import examples
from tests.meshes import are_inside, as_coal, hull, l_profile, on_surface, ring, spoilt, star

seeds = st.integers(0, 2**32 - 1)
UNTURNED = np.zeros(3), np.eye(3), 0, 0
BESIDE = ("flip", "double", "drop", "sliver", "fin", "unwelded", "line", "crossing", "far")


def placed(vertices, faces):
    return surfaces_of([Placed(solids_and_sheets(vertices, faces), *UNTURNED)])


@examples(60)
@given(seeds, st.lists(st.sampled_from(BESIDE), max_size=3))
def test_segments_are_as_far_as_brute_force_says(seed, done):
    rng = np.random.default_rng(seed)
    vertices, faces = spoilt(*star(rng), done, rng)
    surfaces = placed(vertices, faces)
    for _ in range(20):
        segment = rng.uniform(-0.5, 0.5, (2, 3)) * rng.choice([0.1, 1.0])
        truth = float(brute_force.segments_from_triangles(*segment, vertices[faces]))
        found = surface_distance(surfaces, 0, segment, np.inf)
        assert found == pytest.approx(truth, abs=1e-8 + 2 * surfaces.slack[0])
        assert surface_distance(surfaces, 0, segment, 0.05) == pytest.approx(min(found, 0.05), abs=1e-12)


@examples(30)
@given(seeds)
def test_hulls_are_as_far_as_coal_says(seed):
    coal = pytest.importorskip("coal")
    rng = np.random.default_rng(seed)
    vertices, faces = star(rng)
    surfaces, model, here = (
        placed(vertices, faces),
        as_coal(vertices, faces, coal),
        coal.Transform3s.Identity(),
    )
    for _ in range(10):
        body, triangles = hull(rng.standard_normal((8, 3)) * 0.05)
        body = body + rng.uniform(-0.4, 0.4, 3)
        other = as_coal(body, triangles, coal)
        truth = coal.distance(model, here, other, here, coal.DistanceRequest(), coal.DistanceResult())
        within = are_inside(body, triangles, vertices).any()  # a mesh within a body touches it
        found = surface_distance(surfaces, 0, body, np.inf)
        assert found == pytest.approx(0.0 if within else max(truth, 0.0), abs=1e-6)


@examples(60)
@given(seeds)
def test_no_gap_is_wider_than_the_distance(seed):
    """Whatever GJK does: the direction that it hands back is a unit vector, and its gap a lower bound."""
    rng = np.random.default_rng(seed)
    triangle = rng.standard_normal((3, 3))
    if seed % 3 == 0:
        triangle[2] = triangle[1] if seed % 2 else 0.5 * (triangle[0] + triangle[1])
    points = rng.standard_normal((2, 3)) + rng.choice([0.0, 0.5, 3.0]) * rng.standard_normal(3)
    normal = rng.standard_normal(3)
    normal /= np.linalg.norm(normal)
    gap, distance = nearest(triangle, points, normal, np.empty((3, 4, 3)))
    truth = float(brute_force.segments_from_triangles(*points, triangle[None]))
    assert gap <= truth + 1e-12
    assert distance == pytest.approx(truth, abs=1e-7)
    assert np.linalg.norm(normal) == pytest.approx(1.0)
    assert (triangle @ normal).min() - (points @ normal).max() == pytest.approx(gap, abs=1e-12)


@examples(60)
@given(seeds, st.lists(st.sampled_from(["flip", "double", "sliver", "unwelded", "line", "far"]), max_size=3))
def test_what_is_within_stays_within_whatever_is_done_to_the_triangles(seed, done):
    """By the solid angle of the sound mesh; what is done leaves its surface closed, but for cracks."""
    rng = np.random.default_rng(seed)
    vertices, faces = ring() if seed % 2 else star(rng)
    spoiled = spoilt(vertices, faces, done, np.random.default_rng(seed + 1))
    surfaces = placed(*spoiled)
    points = np.concatenate([rng.uniform(-0.2, 0.2, (300, 3)), on_surface(vertices, faces, 50, rng) * 0.99])
    points = points[brute_force.segments_from_triangles(points, points, vertices[faces]) > 1e-6]
    if not surfaces.closed[0]:  # cracks: nothing is inside
        return
    inside = are_inside(vertices, faces, points)
    assert [holds(surfaces, 0, *point) for point in points[inside]].count(False) == 0
    outside = points[~inside & (np.abs(points).max(axis=1) < 0.3)]
    if "far" not in done:
        assert [holds(surfaces, 0, *point) for point in outside].count(True) == 0


@pytest.mark.parametrize("done", ["flip", "double", "sliver", "line"])
def test_a_solid_that_is_written_badly_is_still_closed(done):
    rng = np.random.default_rng(3)
    surfaces = placed(*spoilt(*l_profile(), [done], rng))
    assert surfaces.closed[0]
    assert holds(surfaces, 0, 0.025, 0.1, 0.03)
    assert not holds(surfaces, 0, 0.2, 0.1, 0.03)


def test_a_body_within_a_solid_is_as_deep_as_it_is_far_from_outside():
    vertices, faces = hull(
        np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], dtype=float)
    )
    surfaces = placed(vertices, faces)
    assert signed_distance(surfaces, 0, np.array([[0.0, 0.0, 0.4], [0.0, 0.0, 0.5]]), 1.0) == pytest.approx(
        -0.6
    )
    assert signed_distance(surfaces, 0, np.array([[0.0, 0.0, 0.7], [0.0, 0.0, 1.5]]), 1.0) == pytest.approx(
        -0.3
    )
    assert signed_distance(surfaces, 0, np.array([[0.0, 0.0, 1.2], [0.0, 0.0, 1.5]]), 1.0) == pytest.approx(
        0.2
    )


@examples(20)
@given(seeds)
def test_distances_of_points_are_those_that_brute_force_finds(seed):
    rng = np.random.default_rng(seed)
    vertices, faces = ring() if seed % 2 else star(rng)
    points = rng.uniform(-0.3, 0.3, (200, 3))
    truth = brute_force.segments_from_triangles(points, points, vertices[faces])
    depth = np.where(are_inside(vertices, faces, points), -truth, truth)
    surfaces = placed(vertices, faces)
    assert point_distances(surfaces, 0, points, np.inf, True) == pytest.approx(depth, abs=1e-7)
    near = point_distances(surfaces, 0, points, 0.1, False)
    assert near == pytest.approx(np.clip(depth, 0.0, 0.1), abs=1e-7)


def test_many_triangles_are_found_through_their_tree():
    """Against all of them one by one, turned and shifted, with a second mesh behind the first."""
    rng = np.random.default_rng(0)
    turn, center = Rotation.random(random_state=1).as_matrix(), rng.uniform(-1, 1, 3)
    first = rng.uniform(-1, 1, (400, 1, 3)) + 0.05 * rng.standard_normal((400, 3, 3))
    second = first[:50] + 1.0
    parts = [
        solids_and_sheets(x.reshape(-1, 3), np.arange(3 * len(x)).reshape(-1, 3)) for x in (first, second)
    ]
    surfaces = surfaces_of([Placed(parts[0], center, turn, 0, 0), Placed(parts[1], center, turn, 1, 1)])
    for _ in range(50):
        segment = rng.uniform(-2, 2, (2, 3))
        for mesh, triangles in enumerate((first, second)):
            truth = float(brute_force.segments_from_triangles(*segment, triangles @ turn.T + center))
            assert surface_distance(surfaces, mesh, segment, np.inf) == pytest.approx(truth, abs=1e-7)
