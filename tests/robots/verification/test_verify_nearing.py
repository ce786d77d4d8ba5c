"""Convex bodies come no nearer to each other than along whatever direction their slabs are measured."""

import re
from functools import lru_cache

import coal
import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given
from hypothesis import strategies as st

from comove.errors import ComoveWarning
from comove.model import Scene
from comove.robots import JointMotion
from comove.robots.description import Uncertainty
from comove.robots.verification.bodies import LOAD, bodies_of, distance_of, links_of, solid_of
from comove.robots.verification.carried import Carried
from comove.robots.verification.certificate import CarryCourse, Level, PairCells, between
from comove.robots.verification.kinematics import Bases
from comove.robots.verification.slabs import (
    CORE,
    FINE,
    ROUGH,
    BoundTargets,
    Solids,
    _bulge,
    _reach,
    apart,
)
from tests.cases import examples
from tests.robots.known_carry import TABLE, baxter, known_carry, on_scene, posts, scene_data
from tests.robots.test_model import load, two_joints

BALL = {"shape": "ellipsoid", "center": [0.7, 0.6, 0.7], "radii": [0.1, 0.2, 0.05]}
ROUND = {"shape": "capsule", "center": [0.7, -0.6, 0.7], "radius": 0.05, "length": 0.3}
PASSING = {
    "shape": "sphere",
    "center": [0.4, 0.9, 0.9],
    "radius": 0.1,
    "motion": {"circle": {"radius": 0.2, "period_s": 5.0}},
}


@lru_cache(maxsize=1)
def bodies():
    """Baxter among obstacles of every shape, one of which moves; and the load's motion."""
    scene = Scene.from_dict(scene_data(obstacles=(TABLE, *posts(0.3), BALL, ROUND, PASSING)))
    carried = Carried(on_scene(known_carry()[0], scene))
    hands = carried.hands(carried.time).positions
    return bodies_of(Bases(baxter(), Uncertainty()), baxter().arms, carried, hands, 0.0), carried


def random_motion(seed):
    """Joints anywhere within their limits, on their way elsewhere or at rest, as long as the load's motion."""
    robot, rng = baxter(), np.random.default_rng(seed)
    ends = rng.uniform(robot.lower, robot.upper, (9, 14))
    if seed % 2 == 0:
        ends[:] = robot.home
    return JointMotion(np.linspace(0.0, 10.0, 9), robot.joint_names, ends), rng


def mesh():
    shape = next(x.geometry for x in baxter().collision.geometryObjects if x.name == "torso_0")
    shape.buildConvexHull(True, "Qt")
    return shape.convex


SHAPES = [
    coal.Sphere(0.3),
    coal.Box(0.1, 0.2, 0.6),
    coal.Capsule(0.1, 0.5),
    coal.Cylinder(0.2, 0.5),
    coal.Ellipsoid(0.1, 0.2, 0.3),
    mesh(),
]


def solids(*shapes):
    """Shapes anywhere, each in a frame of its own that is anywhere, and where they are in the scene."""
    own = [pin.SE3.Random() for _ in shapes]
    frames = [pin.SE3.Random() for _ in shapes]
    parts = [solid_of(pin.GeometryObject("", 0, at, shape)) for shape, at in zip(shapes, own, strict=True)]
    made = Solids.of(np.arange(len(parts)), parts)
    turns, places = np.array([x.rotation for x in frames]), np.array([x.translation for x in frames])
    return made, turns, places, [frame * at for frame, at in zip(frames, own, strict=True)]


@pytest.mark.parametrize("shape", SHAPES, ids=lambda shape: type(shape).__name__)
def test_bodies_reach_as_far_as_their_shapes(shape):
    """A half space that begins 10 m beyond is 10 m away; boxes reach further; and a point is that far."""
    pin.seed(0)
    rng, point = np.random.default_rng(0), np.empty(3)
    made, turns, places, (place,) = solids(shape)
    for n in rng.normal(size=(30, 3)):
        n /= np.linalg.norm(n)
        reach = _reach(made, 0, turns, places, *n, FINE, point)
        far = coal.Halfspace(-n, -10.0 - reach)
        assert distance_of((shape, far), (place, pin.SE3.Identity())) == pytest.approx(10.0, abs=1e-9)
        assert _reach(made, 0, turns, places, *n, ROUGH, point) >= reach - 1e-12
        assert _reach(made, 0, turns, places, *n, CORE, point) == reach
        rounding = made.size[0, 0] if made.points.shape[1] else 0.0
        assert point @ n + rounding == pytest.approx(reach, abs=1e-12)


@pytest.mark.parametrize("first", SHAPES, ids=lambda shape: type(shape).__name__)
def test_distances_are_those_of_coal(first):
    pin.seed(1)
    seen = 0
    for other in SHAPES * 8:
        made, turns, places, placed = solids(first, other)
        normal = np.array([1.0, 0.0, 0.0])
        wide, distance = apart(made, 0, 1, turns, places, normal)
        exact = distance_of((first, other), placed)
        if exact > 1e-3:
            seen += 1
            assert distance == pytest.approx(exact, abs=2e-5)
            assert distance - 1e-4 < wide <= distance + 1e-12
            assert np.linalg.norm(normal) == pytest.approx(1.0, abs=1e-12)
        else:
            assert wide <= max(exact, 0.0) + 1e-6
    assert seen > 10


def no_need():
    """Bounds of which none suffices, so that all is computed."""
    none = np.full(3, np.inf)
    return BoundTargets(none, none.copy(), np.full(3, -1), np.zeros(3, dtype=np.int64), 0.0, 0.0, 0.0)


@pytest.mark.slow
@examples(40)
@given(st.integers(0, 2**32 - 1))
def test_no_pair_comes_nearer_than_bound(seed):
    """Distances by coal at many instants, for intervals that are short and long; links, load, and what moves."""
    (world, carried), (motion, rng) = bodies(), random_motion(seed)
    pairs = np.sort(rng.choice(len(world.kind), 150, replace=False))
    pairs = np.union1d(pairs, np.flatnonzero((world.kind == LOAD) | (world.reach[:, 15] > 0)))
    parts = int(2 ** rng.integers(0, 8))
    number = int(rng.integers(parts))
    at, when = CarryCourse(world, carried, motion.curve).intervals(np.array([number]), parts)
    cells = [PairCells(np.array([number]), pairs[[k]], np.zeros((1, 3))) for k in range(len(pairs))]
    bounds = [Level(world, at, cell, np.array([0]), no_need(), when).bounds()[0] for cell in cells]
    bound = np.concatenate(bounds)  # each by itself, as others may spare it
    least = np.full(len(pairs), np.inf)
    for time in np.linspace(number, number + 1, 15) * (motion.duration / parts):
        placed = world.placed_at(carried.nodes(np.array([time]))[0], time)
        data, found = world.robot.model.createData(), placed.geometry.createData()
        pin.updateGeometryPlacements(world.robot.model, data, placed.geometry, found, motion.curve(time))
        exact = world.exact[pairs].tolist()
        least = np.minimum(
            least, [pin.computeDistance(placed.geometry, found, k).min_distance for k in exact]
        )
    apart_ = least > 1e-3
    assert apart_.any()
    assert (bound <= least - world.taken[pairs] + 1e-5)[apart_].all()


@examples(8)
@given(st.integers(0, 2**32 - 1))
def test_no_points_stray_from_their_chords_further_than_bound(seed):
    """Any two points of the balls of two bodies, or of the load, along any direction; joints gain speed, or rest."""
    (world, carried), rng, robot = bodies(), np.random.default_rng(seed), baxter()
    away = rng.uniform(-1.0, 1.0, 14) * (rng.random(14) < rng.choice([0.0, 0.2, 1.0]))
    time = np.linspace(0.0, 10.0, 41)
    motion = JointMotion(time, robot.joint_names, robot.home + (time[:, None] / 10.0) ** 2 * away)
    course, parts, solids = CarryCourse(world, carried, motion.curve), 8, world.solids
    at, when = course.intervals(np.array([3]), parts)
    inner = np.linspace(*when[at.knot[0, :2]], 9)
    turns, places = course.frames(inner)
    share = np.linspace(0.0, 1.0, 9)
    passed = rng.choice(np.flatnonzero(world.reach[:, 15] > 0), 5)
    for pair in [*rng.choice(len(world.kind), 50), *np.flatnonzero(world.kind == LOAD), *passed]:
        n, points = rng.normal(size=3), []
        for body in world.ends[pair]:
            own = rng.normal(size=3)
            own = solids.center[body] + own * solids.radius[body] / np.linalg.norm(own)
            if solids.frame[body] == robot.model.njoints:  # an end of the load, a bar
                own = solids.points[:, solids.first[body]]
            frame = solids.frame[body]
            points.append(turns[:, frame] @ own + places[:, frame])
        common = turns[:, world.pairs.common[pair]]
        along = np.einsum("tba,tb,a->t", common, points[1] - points[0], n / np.linalg.norm(n))
        chord = along[0] + share * (along[-1] - along[0])
        assert np.abs(along - chord).max() <= _bulge(world.pairs, at, 0, int(pair)) + 1e-9


@examples(200)
@given(st.integers(0, 2**32 - 1))
def test_no_points_come_nearer_than_their_distances_at_two_instants_bound(seed):
    """Points that pass each other at even speed, or with an acceleration towards or away from each other."""
    rng = np.random.default_rng(seed)
    time, speed, off = np.linspace(-1.0, 1.0, 201), rng.choice([0.0, 1.0]), 10.0 ** rng.uniform(-1.0, 2.0)
    bend = rng.uniform(-1.0, 1.0) * rng.choice([0.0, 1.0]) * off
    distance = np.hypot(
        speed * (time - rng.choice([0.0, rng.uniform(-2.0, 2.0)])), off + 0.5 * bend * time**2
    )
    change, bulge = np.hypot(speed, bend), 0.5 * abs(bend)  # within 1 s, and over 2 s
    bound = between(distance[0], distance[-1], change, bulge)
    assert bound <= distance.min() * (1.0 + 1e-12)
    if bend == 0.0 and off >= 2.0:
        assert bound >= distance.min() - 1.0 / off - 1e-12


def test_the_bound_is_tight_where_bodies_glide_past_each_other():
    """A hand over a table: the distance hardly changes, and the bound says so."""
    motion, joints = known_carry()
    scene = Scene.from_dict(scene_data(obstacles=(TABLE,)))
    carried = Carried(on_scene(motion, scene))
    world = bodies_of(
        Bases(baxter(), Uncertainty()), baxter().arms, carried, carried.hands(carried.time).positions, 0.0
    )
    pair = [world.name(k) for k in range(len(world.kind))].index("l_gripper_l_finger and obstacles[0] (box)")
    numbers = np.arange(50)
    at, when = CarryCourse(world, carried, joints.curve).intervals(numbers, 50)
    cells = PairCells(numbers, np.full(50, pair), np.zeros((50, 3)))
    need = no_need()
    bound, _ = Level(world, at, cells, numbers, need, when).bounds()
    assert bound.min() > need.upper[world.kind[pair]] - 0.02  # m, in 0.2 s of a hand that moves at 0.15 m/s
    knots = np.searchsorted(joints.time, np.linspace(0.5, 9.5, 50))
    assert 0.1 * (np.abs(joints.velocity[knots]) @ world.reach[pair, :14]).max() > 0.02


def test_a_robot_without_collision_bodies_has_none(tmp_path):
    text = re.sub("<collision>.*?</collision>", "", two_joints(), flags=re.DOTALL)
    with pytest.warns(ComoveWarning):
        robot = load(tmp_path, text)
    links = links_of(robot)
    assert not links.bodies
    assert links.solids.points.shape == (3, 0) and links.solids.turn.shape == (0, 3, 3)
