"""Distances of solid boxes: bounded from both sides, against coal, and against points of the solid.

What is true of them: no direction shows two bodies further apart than they are, no two points are nearer, and the
distance changes by no more than the way that the solid is moved.
"""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from comove.geometry import distances as sd
from comove.geometry.solids import border_distance, gap, solid_at, solid_distance, solids_clearance, support
from tests.cases import examples

from .test_distances import KINDS, row

ROUNDING = 1e-12  # m
seeds = st.integers(0, 2**32 - 1)
kinds = st.sampled_from(sorted(KINDS))
SIGNS = np.array([[1.0 if corner >> k & 1 else -1.0 for k in range(3)] for corner in range(8)])


def random_turn(rng):
    """A rotation anyhow, or along the axes, where faces and edges are parallel."""
    return (
        np.eye(3)
        if rng.random() < 0.3
        else Rotation.random(random_state=int(rng.integers(2**31))).as_matrix()
    )


def random_pair(rng, kind):
    """An obstacle of a kind about a random point, and a solid about the origin: some are apart and some are not."""
    name, size = KINDS[kind][0], np.exp(rng.uniform(np.log(0.01), np.log(0.6), 3))[: KINDS[kind][1]]
    table = row(name, 0.4 * rng.standard_normal(3), random_turn(rng), size)
    half, turn = np.exp(rng.uniform(np.log(0.005), np.log(0.4), 3)), random_turn(rng)
    return table, np.ascontiguousarray(np.vstack([np.zeros(3), (turn * half).T]))


def both(table, solid, cutoff=np.inf):
    """Lower and upper bound of the distance, and the direction of the lower one."""
    normal = np.array([0.0, 0.0, 1.0])
    lower, upper = solid_distance(table, 0, solid, cutoff, normal)
    return lower, upper, normal


def within(solid, rng, count):
    """Random points of a solid, many of them on its faces and edges."""
    shares = np.clip(rng.uniform(-1.5, 1.5, (count, 3)), -1.0, 1.0)
    return solid[0] + shares @ solid[1:]


@given(seeds, kinds)
def test_bounds_meet_where_the_two_are_apart(seed, kind):
    """And where they are not, no direction parts them and some point of the solid is in the obstacle."""
    table, solid = random_pair(np.random.default_rng(seed), kind)
    lower, upper, normal = both(table, solid)
    assert np.linalg.norm(normal) == pytest.approx(1.0, abs=1e-12)
    assert lower == pytest.approx(gap(table, 0, solid, *normal), abs=ROUNDING)
    assert lower <= upper + ROUNDING
    if upper > 1e-9:
        assert upper - lower < 1e-7
    else:
        assert lower < 1e-9


@given(seeds, kinds)
def test_no_direction_parts_more_and_no_point_is_nearer(seed, kind):
    rng = np.random.default_rng(seed)
    table, solid = random_pair(rng, kind)
    lower, upper, _ = both(table, solid)
    points = np.array([sd.point_distance(table, 0, *p) for p in within(solid, rng, 300)])
    assert points.min() >= lower - ROUNDING
    directions = rng.standard_normal((300, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    assert max(gap(table, 0, solid, *d) for d in directions) <= min(upper, points.min()) + ROUNDING


@pytest.mark.parametrize("kind", sorted(KINDS))
@pytest.mark.few(2)
def test_against_coal(kind):
    """1500 pairs; coal's own tolerance is set to 1e-9 m."""
    coal = pytest.importorskip("coal")
    shape = {
        "box": lambda s: coal.Box(*(2 * s)),
        "sphere": lambda s: coal.Sphere(s[0]),
        "capsule": lambda s: coal.Capsule(s[0], 2 * s[1]),
        "cylinder": lambda s: coal.Cylinder(s[0], 2 * s[1]),
        "ellipsoid": lambda s: coal.Ellipsoid(*s),
    }[kind]
    rng, request, apart, contact = np.random.default_rng(7), coal.DistanceRequest(), 0, 0
    request.gjk_tolerance = request.epa_tolerance = 1e-9
    for _ in range(1500):
        table, solid = random_pair(rng, kind)
        half = np.linalg.norm(solid[1:], axis=1)
        turn = (solid[1:] / half[:, None]).T
        theirs = coal.distance(
            coal.Box(*(2 * half)),
            coal.Transform3s(turn, solid[0]),
            shape(table[0, sd.SIZE : sd.SIZE + KINDS[kind][1]]),
            coal.Transform3s(
                table[0, sd.ROTATION : sd.ROTATION + 9].reshape(3, 3), table[0, sd.CENTER : sd.CENTER + 3]
            ),
            request,
            coal.DistanceResult(),
        )
        lower, upper, _ = both(table, solid)
        if theirs > 1e-6:
            apart += 1
            assert max(abs(lower - theirs), abs(upper - theirs)) < 1e-6
        elif theirs < -1e-6:
            contact += 1
            assert lower < 0
            assert upper <= 0
    assert min(apart, contact) > 50


@given(seeds, kinds)
def test_the_distance_changes_by_no_more_than_the_way(seed, kind):
    rng = np.random.default_rng(seed)
    table, solid = random_pair(rng, kind)
    step = rng.standard_normal(3) * 10.0 ** rng.uniform(-6, -1)
    moved = solid.copy()
    moved[0] += step
    (lower, upper, _), (other_lower, other_upper, _) = both(table, solid), both(table, moved)
    if min(upper, other_upper) > 0:
        assert abs(other_lower - lower) <= np.linalg.norm(step) + 1e-7


@given(seeds, kinds, st.floats(0.0, 0.3))
def test_below_a_cutoff_nothing_changes(seed, kind, cutoff):
    table, solid = random_pair(np.random.default_rng(seed), kind)
    lower, _, _ = both(table, solid)
    cut_lower, cut_upper, _ = both(table, solid, cutoff)
    if lower > cutoff + 1e-7:
        assert min(cut_lower, cut_upper) >= cutoff
    elif lower < cutoff - 1e-7:
        assert cut_lower == pytest.approx(lower, abs=1e-7)
        assert cut_upper >= lower - ROUNDING


@given(seeds, kinds)
def test_the_support_is_the_farthest_point_of_the_obstacle(seed, kind):
    rng = np.random.default_rng(seed)
    table, _ = random_pair(rng, kind)
    direction = rng.standard_normal(3)
    direction /= np.linalg.norm(direction)
    center, farthest = table[0, sd.CENTER : sd.CENTER + 3], np.array(support(table, 0, *direction))
    assert abs(sd.point_distance(table, 0, *(center + farthest))) < 1e-9
    points = rng.standard_normal((200, 3)) * table[0, sd.REACH]
    inside = [p for p in points if sd.point_distance(table, 0, *(center + p)) <= 0]
    assert all(direction @ p <= direction @ farthest + ROUNDING for p in inside)


ON_A_CORNER = Rotation.from_euler("xy", [np.pi / 4, np.arctan(np.sqrt(0.5))]).as_matrix()
TRAY = np.vstack([np.zeros(3), np.diag([0.2, 0.15, 0.01])])


@pytest.mark.parametrize(
    ("what", "table", "distance"),
    [
        ("a post below a face", row(sd.CYLINDER, (0.05, 0.03, -0.3), size=(0.02, 0.25)), 0.04),
        ("a pin's head above a face", row(sd.CAPSULE, (0.1, 0.0, 0.2), size=(0.003, 0.1)), 0.087),
        ("a sphere above a face", row(sd.SPHERE, (0.0, -0.1, 0.05), size=(0.02,)), 0.02),
        ("a corner above a face", row(sd.BOX, (0, 0, 0.2), ON_A_CORNER, (0.1, 0.1, 0.1)), 0.19 - 0.1 * np.sqrt(3)),
        ("an egg above a face", row(sd.ELLIPSOID, (0.1, 0.1, 0.1), size=(0.02, 0.03, 0.04)), 0.05),
        ("a wall wider than the face", row(sd.BOX, (0, 0, 0.1), size=(2, 2, 0.01)), 0.08),
        ("a wall beside an edge", row(sd.BOX, (0.3, 0, 0.1), size=(0.05, 2, 0.01)), np.hypot(0.05, 0.08)),
    ],
    ids=lambda x: x if isinstance(x, str) else "",
)  # fmt: skip
def test_faces_count(what, table, distance):
    """Not only the edges: what is before the middle of a face is as near as the face."""
    lower, upper, _ = both(table, TRAY)
    assert lower == pytest.approx(distance, abs=1e-7)
    assert upper == pytest.approx(distance, abs=1e-7)


@pytest.mark.parametrize("kind", sorted(KINDS))
def test_what_is_wholly_inside_or_stands_through_is_in_contact(kind):
    """No edge of the solid is touched, and yet no direction parts them."""
    block = np.vstack([np.zeros(3), np.diag([0.2, 0.15, 0.1])])
    small = row(KINDS[kind][0], (0.03, 0.02, 0.01), size=[0.01, 0.02, 0.015][: KINDS[kind][1]])
    lower, upper, _ = both(small, block)
    assert lower < -0.05
    assert upper < 0
    tall = row(KINDS[kind][0], (0.03, 0.02, 0.3), size=[0.02, 0.31, 0.31][: KINDS[kind][1]])
    if kind in ("capsule", "cylinder"):
        lower, upper, _ = both(tall, TRAY)
        assert lower == pytest.approx(-0.04, abs=0.021)  # out by the way of its tip, rounded or not
        assert upper <= 0


def test_corners_number_a_solid():
    rng = np.random.default_rng(0)
    wanted = np.vstack([rng.standard_normal(3), random_turn(rng) * 0.1])
    nodes = np.concatenate([rng.standard_normal((2, 3)), wanted[0] + SIGNS @ wanted[1:]])
    solid = np.empty((4, 3))
    solid_at(nodes, np.arange(2, 10), solid)
    assert np.allclose(solid, wanted, atol=1e-15)
    lower, upper = np.array([-5.0, -4.0, -3.0]), np.array([3.0, 4.0, 5.0])
    border = min((nodes[2:] - lower).min(), (upper - nodes[2:]).min())
    assert border_distance(solid, lower, upper) == pytest.approx(border, abs=1e-14)
    clearance, nearest = solids_clearance(
        nodes, np.arange(2, 10)[None], np.zeros((0, sd.N_COLUMNS)), lower, upper
    )
    assert (clearance, nearest) == (pytest.approx(border, abs=1e-14), -1)


@examples(30)
@given(seeds)
def test_the_nearest_of_many_is_found(seed):
    rng = np.random.default_rng(seed)
    pairs = [random_pair(rng, str(rng.choice(sorted(KINDS)))) for _ in range(6)]
    table, solid = np.concatenate([table for table, _ in pairs]), pairs[0][1]
    nodes, far = solid[0] + SIGNS @ solid[1:], np.full(3, 1e3)
    clearance, nearest = solids_clearance(nodes, np.arange(8)[None], table, -far, far)
    alone = [both(table[j : j + 1], solid)[0] for j in range(6)]
    if clearance > 0:
        assert clearance == pytest.approx(min(alone), abs=1e-7)
        assert alone[nearest] == pytest.approx(clearance, abs=1e-7)
    else:
        assert min(alone) <= 1e-9
