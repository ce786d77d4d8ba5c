"""Capsules around bodies: they hold them but for what may stick out, and take little more room."""

import coal
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.spatial import ConvexHull

from comove.geometry.polytopes import solid_hull_of, thickened
from comove.robots.search.capsules import (
    FINE,
    MOST_PARTS,
    PROUD,
    PROUDEST,
    SETTINGS,
    around,
    capsules_of,
    convex_parts,
    holding,
    vertices_of,
)
from comove.robots.search.capsules import on_triangles as densely
from comove.robots.search.links import FAT
from tests.cases import examples
from tests.robots.small_robots import BUNDLED, robot

SIZE = st.floats(0.005, 0.6)


def outside(points, capsules):
    """By how much points are outside all capsules, at most [m]; negative if all are inside."""
    apart = []
    for a, b, radius in capsules:
        along = np.clip((points - a) @ (b - a) / max((b - a) @ (b - a), 1e-300), 0.0, 1.0)
        apart.append(np.linalg.norm(points - a - along[:, None] * (b - a), axis=1) - radius)
    return np.min(apart, axis=0).max()


def allowed(capsules):
    """By how much a body may stick out of one of its capsules, at most [m]; a nanometre is of rounding."""
    return max(min(PROUDEST, PROUD / (1 - PROUD) * capsule.radius) for capsule in capsules) + 1e-9


def mesh(points, triangles):
    """A mesh as Pinocchio loads it."""
    model = coal.BVHModelOBBRSS()
    model.beginModel(len(triangles), len(points))
    for triangle in triangles:
        model.addTriangle(*(np.array(points[i], dtype=float) for i in triangle))
    model.endModel()
    return model


def on_triangles(points, triangles, rng, count=4000):
    """Random points of a surface."""
    a, b, c = points[triangles[rng.integers(len(triangles), size=count)]].swapaxes(0, 1)
    u, v = rng.random((2, count, 1))
    flip = (u + v) > 1
    u, v = np.where(flip, 1 - u, u), np.where(flip, 1 - v, v)
    return a + u * (b - a) + v * (c - a)


@given(SIZE, SIZE, SIZE)
def test_boxes_are_but_for_their_corners_inside_their_capsules(x, y, z):
    rng = np.random.default_rng(0)
    inner = rng.uniform(-0.5, 0.5, (1500, 3))
    inner[np.arange(1000), np.arange(1000) % 3] = np.sign(inner[:1000, 0]) / 2  # on faces
    corners = np.array(np.meshgrid(*[(-0.5, 0.5)] * 3)).reshape(3, -1).T
    capsules = capsules_of(coal.Box(x, y, z), True)
    assert outside(np.concatenate([corners, inner]) * (x, y, z), capsules) <= allowed(capsules)


@given(SIZE, SIZE)
def test_cylinders_are_but_for_their_rims_inside_their_capsules(radius, length):
    angle, share = 2 * np.pi * np.random.default_rng(0).random((2, 1000))
    flat = np.column_stack([np.cos(angle), np.sin(angle)]) * radius
    points = np.column_stack([flat, (share / (2 * np.pi) - 0.5) * length])
    ends = np.column_stack([flat, np.sign(share - np.pi) * length / 2])
    inner = ends * np.column_stack([np.sqrt(share / 7)] * 2 + [np.ones(1000)])
    capsules = capsules_of(coal.Cylinder(radius, length), True)
    assert outside(np.concatenate([points, ends, inner]), capsules) <= allowed(capsules)


def test_balls_and_capsules_are_what_they_are():
    assert capsules_of(coal.Sphere(0.3), True)[0].radius == 0.3
    a, b, radius = capsules_of(coal.Capsule(0.1, 0.6), True)[0]
    assert (radius, np.linalg.norm(b - a)) == (0.1, pytest.approx(0.6))


@examples(25)
@given(st.integers(0, 10_000), st.integers(4, 40), arrays(float, 3, elements=st.floats(0.01, 1)))
def test_meshes_that_move_are_but_for_corners_inside_their_capsules_however_large_their_triangles(
    seed, count, size
):
    rng = np.random.default_rng(seed)
    points = rng.uniform(-1, 1, (count, 3)) * size + rng.normal(size=3)
    triangles = np.array([(i, (i + 1) % count, (i + 2) % count) for i in range(count)])
    capsules = capsules_of(mesh(points, triangles), True)
    assert outside(on_triangles(points, triangles, rng), capsules) <= allowed(capsules)


@pytest.mark.parametrize("moves", [True, False])
def test_a_convex_body_is_inside_its_capsules_as_a_mesh_is(moves):
    """URDFs may have bodies that are read as such."""
    rng = np.random.default_rng(3)
    points = rng.normal(size=(40, 3)) * (0.1, 0.1, 0.4)
    shape = mesh(points, np.array([(i, (i + 1) % 40, (i + 2) % 40) for i in range(40)]))
    shape.buildConvexHull(True, "Qt")
    capsules = capsules_of(shape.convex, moves)
    hull = ConvexHull(points)
    assert outside(on_triangles(points, hull.simplices, rng), capsules) <= allowed(capsules)


@examples(25)
@given(st.integers(0, 10_000), st.integers(3, 12), st.floats(0.01, 2.0))
def test_meshes_that_do_not_move_are_inside_their_balls_however_large_their_triangles(seed, count, size):
    rng = np.random.default_rng(seed)
    points = rng.uniform(-size, size, (count, 3))
    triangles = np.array([(i, (i + 1) % count, (i + 2) % count) for i in range(count)])
    balls = capsules_of(mesh(points, triangles), False)
    assert outside(on_triangles(points, triangles, rng), balls) <= 1e-12
    spread = max(FINE, 2 * np.sqrt(3) * size / MOST_PARTS)
    assert max(ball.radius for ball in balls) < 0.5 * np.sqrt(3) * SETTINGS.cell + spread


def test_a_tube_with_a_thick_joint_at_each_end_has_three_capsules():
    """Whichever end is cut off first, the rest is as thick as before."""
    tube, joint, half = 0.03, 0.06, 0.2
    angle = np.linspace(0, 2 * np.pi, 48, endpoint=False)
    ring = np.column_stack([np.cos(angle), np.sin(angle), 0 * angle])
    heights = np.linspace(-half, half, 81)
    points = np.concatenate([ring * (joint if abs(z) > half - 0.08 else tube) + [0, 0, z] for z in heights])
    capsules = holding(points, 0.01)
    assert len(capsules) == 3 and outside(points, capsules) <= allowed(capsules)
    beside = np.array([[1.5 * tube, 0.0, 0.0]])
    assert outside(beside, capsules) > 0.3 * tube


def test_a_flat_or_straight_mesh_has_capsules_too():
    flat = np.array([(0, 0, 0), (0.3, 0, 0), (0, 0.2, 0.0)])
    straight = np.array([(0, 0, 0), (0.1, 0, 0), (0.3, 0, 0.0)])
    for points in (flat, straight):
        capsules = capsules_of(mesh(points, np.array([(0, 1, 2)])), True)
        assert outside(points, capsules) <= allowed(capsules)
    assert capsules[0].radius < 1e-6


@given(st.integers(0, 1000), st.floats(0.01, 0.2), st.floats(0.0, 0.5))
def test_a_capsule_around_a_capsule_is_hardly_larger(seed, radius, length):
    rng = np.random.default_rng(seed)
    directions = rng.normal(size=(3000, 3))
    directions *= radius / np.linalg.norm(directions, axis=1)[:, None]
    turned = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    points = (directions + np.outer(rng.integers(2, size=3000), (length, 0, 0))) @ turned
    assert around(points).volume < 1.25 * np.pi * radius**2 * (length + 4 / 3 * radius)


def bent():
    """Two bars that meet at a right angle, of 40 cm and 5 cm: vertices and triangles."""
    bars = [
        np.array(np.meshgrid(*size)).reshape(3, -1).T
        for size in (((0, 0.4), (0, 0.05), (0, 0.05)), ((0, 0.05), (0, 0.4), (0, 0.05)))
    ]
    points = np.concatenate(bars)
    faces = [
        (0, 1, 3),
        (0, 3, 2),
        (4, 5, 7),
        (4, 7, 6),
        (0, 1, 5),
        (0, 5, 4),
        (2, 3, 7),
        (2, 7, 6),
        (0, 2, 6),
        (0, 6, 4),
        (1, 3, 7),
        (1, 7, 5),
    ]
    triangles = np.array(faces + [tuple(8 + i for i in face) for face in faces])
    return points, triangles


def test_a_bent_body_is_inside_capsules_that_take_less_room_than_one():
    points, triangles = bent()  # one capsule would fill the angle
    capsules = capsules_of(mesh(points, triangles), True)
    assert outside(on_triangles(points, triangles, np.random.default_rng(1)), capsules) <= allowed(capsules)
    assert len(capsules) > 1
    assert sum(capsule.volume for capsule in capsules) < 0.4 * around(points).volume


@examples(25)
@given(
    st.integers(0, 10_000), st.integers(4, 40), arrays(float, 3, elements=st.floats(0.01, 1)), st.booleans()
)
def test_the_hulls_of_parts_hold_the_surface_and_capsules_hold_the_hulls(seed, count, size, moves):
    rng = np.random.default_rng(seed)
    points = rng.uniform(-1, 1, (count, 3)) * size + rng.normal(size=3)
    triangles = np.array([(i, (i + 1) % count, (i + 2) % count) for i in range(count)])
    parts = convex_parts(points, triangles, moves)
    hulls = [solid_hull_of(thickened(part, 1e-6)) for part in parts]
    on = on_triangles(points, triangles, rng)
    beyond = [(on @ hull.planes[:, :3].T - hull.planes[:, 3]).max(axis=1) for hull in hulls]
    assert np.min(beyond, axis=0).max() <= 1e-9
    if moves:
        capsules = holding(*densely(points, triangles))
        for part, capsule in zip(parts, capsules, strict=True):  # and so is its hull, as capsules are convex
            assert outside(part, [capsule]) <= allowed([capsule])


def test_the_angle_of_a_bent_body_is_in_none_of_its_parts():
    points, triangles = bent()
    for moves in (True, False):
        parts = convex_parts(points, triangles, moves)
        hulls = [solid_hull_of(part) for part in parts]
        inside = [(hull.planes[:, :3] @ (0.15, 0.15, 0.025) - hull.planes[:, 3]).max() < 0 for hull in hulls]
        assert len(parts) > 1
        assert not any(inside)


@pytest.mark.parametrize("name", [name for name in BUNDLED if name != "baxter"])  # of boxes and cylinders
@pytest.mark.few(3)
def test_links_of_meshes_are_wider_as_capsules_by_less_than_what_plans_may_give_away(name):
    """In the mean over all directions, in which a capsule and a body lie between two planes each."""
    directions = np.random.default_rng(0).normal(size=(500, 3))
    directions /= np.linalg.norm(directions, axis=1)[:, None]
    wider, seen = [], set()
    for item in robot(name).collision.geometryObjects:
        shape = item.geometry
        if item.parentJoint and hasattr(shape, "vertices"):
            points = vertices_of(shape)
            if points.tobytes() in seen:  # of the other arm
                continue
            seen.add(points.tobytes())
            ends = [np.maximum(directions @ a, directions @ b) + r for a, b, r in capsules_of(shape, True)]
            wider.append((np.max(ends, axis=0) - (directions @ points.T).max(axis=1)).mean())
    assert np.mean(wider) < FAT
    assert max(wider) < 3 * FAT
