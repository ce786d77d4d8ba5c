"""Polytopes as obstacles and as loads: distances by GJK against coal, planes against true distances."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from comove.geometry import distances as sd
from comove.geometry.polytopes import bevelled, coarser, hull_of, nearest_in_hull, rows_of, vertices_in
from comove.geometry.solids import gap, hull_distance, solids_clearance
from tests.cases import examples

from ..meshes import as_coal, hull

seeds = st.integers(0, 2**32 - 1)
COAL_ERROR = 1e-4


def random_hull(rng, count=14):
    points = rng.standard_normal((count, 3)) * rng.uniform(0.02, 0.15, 3)
    return hull_of(points + rng.uniform(-0.1, 0.1, 3))


def random_obstacle(rng, coal):
    """A row of any kind and the same in coal."""
    turn, center = (
        Rotation.random(random_state=int(rng.integers(2**31))).as_matrix(),
        rng.uniform(-0.3, 0.3, 3),
    )
    size, kind = rng.uniform(0.02, 0.2, 3), rng.choice([*range(5), sd.POLYTOPE])
    place = coal.Transform3s(turn, center)
    if kind == sd.POLYTOPE:
        polytope = random_hull(rng)
        return rows_of([polytope], center, turn), _convex(polytope.vertices, coal), place
    used, shape = {
        sd.BOX: (3, lambda s: coal.Box(*(2 * s))),
        sd.SPHERE: (1, lambda s: coal.Sphere(s[0])),
        sd.CAPSULE: (2, lambda s: coal.Capsule(s[0], 2 * s[1])),
        sd.CYLINDER: (2, lambda s: coal.Cylinder(s[0], 2 * s[1])),
        sd.ELLIPSOID: (3, lambda s: coal.Ellipsoid(*s)),
    }[kind]
    row = np.zeros((1, sd.N_COLUMNS))
    row[0, sd.KIND], row[0, sd.REACH] = kind, size.sum()
    row[0, sd.CENTER : sd.CENTER + 3], row[0, sd.ROTATION : sd.ROTATION + 9] = center, turn.ravel()
    row[0, sd.SIZE : sd.SIZE + used] = size[:used]
    return row, shape(size), place


def _convex(vertices, coal):
    model = as_coal(*hull(vertices), coal)
    model.buildConvexHull(True, "Qt")
    return model.convex


def test_distances_of_hulls_are_those_of_coal():
    coal, apart = pytest.importorskip("coal"), 0
    for seed in range(400):
        rng = np.random.default_rng([seed, 1])
        table, shape, place = random_obstacle(rng, coal)
        points = random_hull(rng).vertices + rng.uniform(-0.4, 0.4, 3)
        solid = np.concatenate([points, points[-1:]]) if len(points) == 4 else points
        near, normal = np.empty(3), np.array([1.0, 0.0, 0.0])
        lower, upper = hull_distance(table, 0, solid, np.inf, normal, near)
        here = coal.Transform3s.Identity()
        true = coal.distance(
            _convex(points, coal), here, shape, place, coal.DistanceRequest(), coal.DistanceResult()
        )
        if true < 1e-6:
            assert lower <= 1e-6 and upper <= 1e-5, seed
            continue
        apart += 1
        assert lower - 1e-12 <= upper <= lower + 1e-6, seed
        assert abs(lower - true) < COAL_ERROR, seed
        assert lower == pytest.approx(gap(table, 0, solid, *normal), abs=1e-12)
        assert np.linalg.norm(near - nearest_in_hull(points, near[None])[0]) < 1e-9
    assert apart > 200


@examples(40)
@given(seeds)
def test_planes_tell_no_more_than_the_distance_and_the_truth_about_inside(seed):
    rng = np.random.default_rng(seed)
    polytope, turn = random_hull(rng), Rotation.random(random_state=seed).as_matrix()
    table = rows_of([polytope], np.array([0.1, 0.2, 0.3]), turn)
    points = rng.uniform(-0.5, 0.5, (60, 3))
    told = np.array([sd.point_distance(table, 0, *p) for p in points])
    local = (points - [0.1, 0.2, 0.3]) @ turn
    true = np.linalg.norm(local - nearest_in_hull(polytope.vertices, local), axis=1)
    assert (told <= true + 1e-12).all()
    inside = (local @ polytope.planes[:, :3].T < polytope.planes[:, 3]).all(axis=1)
    assert ((told < 0) == inside).all()
    assert (told[~inside] > 7 / 8 * true[~inside]).all()


def test_planes_all_around_cut_nothing_off():
    polytope = hull_of(np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], dtype=float))
    planes = bevelled(polytope)
    assert 6 < len(planes) < 100
    assert (polytope.vertices @ planes[:, :3].T).max(axis=0) == pytest.approx(planes[:, 3], abs=1e-12)
    table = rows_of([polytope], np.zeros(3), np.eye(3))
    assert vertices_in(table[0]) == pytest.approx(polytope.vertices)
    assert 7 / 8 * np.sqrt(3.0) < sd.point_distance(table, 0, 2.0, 2.0, 2.0) <= np.sqrt(3.0)


def test_a_coarser_polytope_holds_the_hull_within_its_tolerance():
    rng = np.random.default_rng(0)
    angle = 2 * np.pi * np.arange(90) / 90
    points = np.concatenate([np.column_stack([np.cos(angle), np.sin(angle), np.full(90, z)]) for z in (0, 1)])
    fine = hull_of(0.1 * Rotation.random(random_state=rng).apply(points))
    for tolerance in (0.01, 0.003):
        rough, beyond = coarser(fine, tolerance)
        assert len(rough.vertices) < 0.5 * len(fine.vertices)
        assert (fine.vertices @ rough.planes[:, :3].T <= rough.planes[:, 3]).all()
        away = np.linalg.norm(rough.vertices - nearest_in_hull(fine.vertices, rough.vertices), axis=1)
        assert away.max() <= beyond + 1e-9 <= tolerance + 1e-9


def test_an_inflated_polytope_holds_what_is_near():
    rng = np.random.default_rng(3)
    table = rows_of([random_hull(rng)], np.zeros(3), np.eye(3))
    grown = sd.inflated(table, np.array([0.02]))
    for point in rng.uniform(-0.3, 0.3, (50, 3)):
        told = sd.point_distance(table, 0, *point)
        assert sd.point_distance(grown, 0, *point) == pytest.approx(told - 0.02)
    assert grown[0, sd.REACH] >= table[0, sd.REACH] + 0.02


def test_the_border_counts_for_hulls():
    nodes = np.array([[0.1, 0.5, 0.5], [0.3, 0.5, 0.5], [0.2, 0.6, 0.5], [0.2, 0.5, 0.7], [0.2, 0.5, 0.7]])
    solids, none = np.arange(5)[None], np.zeros((0, sd.N_COLUMNS))
    clearance, nearest = solids_clearance(nodes, solids, none, np.zeros(3), np.ones(3))
    assert (clearance, nearest) == (pytest.approx(0.1), -1)
