"""Convex bodies come no nearer than along the line between their nearest points."""

from functools import lru_cache

import coal
import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given
from hypothesis import strategies as st

from comove.model import Scene
from comove.robots import JointMotion
from comove.robots.description import Uncertainty
from comove.robots.verification.bodies import COAL_ERROR, bodies_of
from comove.robots.verification.carried import Carried
from comove.robots.verification.certificate import (
    CONVEX,
    CarryCourse,
    Distances,
    Instants,
    Nearing,
    PairCells,
    support_function,
)
from comove.robots.verification.kinematics import Bases
from tests.cases import examples
from tests.robots.known_carry import TABLE, baxter, known_carry, on_scene, posts, scene_data

BALL = {"shape": "ellipsoid", "center": [0.7, 0.6, 0.7], "radii": [0.1, 0.2, 0.05]}
ROUND = {"shape": "capsule", "center": [0.7, -0.6, 0.7], "radius": 0.05, "length": 0.3}


@lru_cache(maxsize=1)
def bodies():
    """Baxter among obstacles of every shape."""
    scene = Scene.from_dict(scene_data(obstacles=(TABLE, *posts(0.3), BALL, ROUND)))
    carried = Carried(on_scene(known_carry()[0], scene))
    hands, _ = carried.hands(carried.time)
    return bodies_of(Bases(baxter(), Uncertainty()), baxter().arms, carried, hands, 0.0)


def random_motion(seed):
    """Joints anywhere within their limits, on their way elsewhere."""
    robot, rng = baxter(), np.random.default_rng(seed)
    ends = rng.uniform(robot.lower, robot.upper, (4, 14))
    return JointMotion(np.linspace(0.0, 3.0, 4), robot.joint_names, ends), rng


SHAPES = [
    coal.Sphere(0.3),
    coal.Box(0.1, 0.2, 0.6),
    coal.Capsule(0.1, 0.5),
    coal.Cylinder(0.2, 0.5),
    coal.Ellipsoid(0.1, 0.2, 0.3),
]


@pytest.mark.parametrize("shape", SHAPES, ids=lambda shape: type(shape).__name__)
def test_support_functions_are_where_the_shapes_end(shape):
    """A small ball beyond the support plane, on the side where it is reached, touches; no ball beyond it does."""
    rng, support = np.random.default_rng(0), support_function(shape)
    for n in rng.normal(size=(30, 3)):
        n /= np.linalg.norm(n)
        far = coal.Halfspace(-n, -10.0 - support(n))  # begins 10 m beyond the shape
        found = coal.DistanceResult()
        there = coal.Transform3s.Identity()
        coal.distance(shape, there, far, there, coal.DistanceRequest(), found)
        assert found.min_distance == pytest.approx(10.0, abs=1e-9)


def test_the_hull_of_a_mesh_ends_where_its_outermost_point_is():
    mesh = next(x.geometry for x in baxter().collision.geometryObjects if x.name == "torso_0")
    assert not isinstance(mesh, CONVEX)
    mesh.buildConvexHull(True, "Qt")
    points = np.array([mesh.convex.point(k) for k in range(mesh.convex.num_points)])
    n = np.array([0.6, 0.0, 0.8])
    assert support_function(mesh.convex)(n) == pytest.approx((points @ n).max())


def cells_of(world, curve, pairs, time, half=0.1):
    """PairCells of pairs about one instant; the load has no part in it."""
    at = Instants(CarryCourse(world, Carried(known_carry()[0]), curve), np.array([time]), half)
    return PairCells(at, np.zeros(len(pairs), dtype=np.int64), pairs)


@examples(15)
@given(st.integers(0, 2**32 - 1))
def test_slabs_are_nearly_as_wide_as_distances(seed):
    """Coal's normals and distances, and support functions written down by hand, fit together."""
    world, (motion, _) = bodies(), random_motion(seed)
    nearing = Nearing(Distances(world))
    pairs = np.flatnonzero(nearing.applies)
    lost, _ = nearing.first_order(cells_of(world, motion.curve, pairs, 1.0))
    data, placed = world.robot.model.createData(), world.geometry.createData()
    pin.updateGeometryPlacements(world.robot.model, data, world.geometry, placed, motion.position[1])
    apart = np.array([pin.computeDistance(world.geometry, placed, int(p)).min_distance for p in pairs])
    assert (np.abs(lost[apart > 1e-3]) < 2 * COAL_ERROR).all()
    assert (np.abs(lost[(apart > 1e-3) & (apart < 0.05)]) < 0.2 * COAL_ERROR).all()


@examples(10)
@given(st.integers(0, 2**32 - 1))
def test_no_pair_comes_nearer_than_bound(seed):
    """Distances at many instants about another one, for stretches that are short and long."""
    world, (motion, rng) = bodies(), random_motion(seed)
    nearing, curve = Nearing(Distances(world)), motion.curve
    pairs = rng.choice(np.flatnonzero(nearing.applies), 40, replace=False)
    middle, half = float(rng.uniform(0.3, 2.7)), float(10 ** rng.uniform(-3, -0.6))
    cells = cells_of(world, curve, pairs, middle, half)
    bulge = 0.5 * half**2 * nearing.second_order(cells)
    lost, speed = nearing.first_order(cells)
    change = lost + half * speed + bulge
    data, placed = world.robot.model.createData(), world.geometry.createData()

    def distances(time):
        pin.updateGeometryPlacements(world.robot.model, data, world.geometry, placed, curve(time))
        return np.array([pin.computeDistance(world.geometry, placed, int(p)).min_distance for p in pairs])

    apart = distances(middle)
    for time in np.linspace(middle - half, middle + half, 41):
        nearer = (apart - distances(time))[apart > 1e-3]
        assert (nearer <= change[apart > 1e-3] + COAL_ERROR).all()


def test_the_bound_is_tight_where_bodies_glide_past_each_other():
    """A hand over a table: the distance hardly changes, and the bound says so."""
    motion, joints = known_carry()
    scene = Scene.from_dict(scene_data(obstacles=(TABLE,)))
    carried = Carried(on_scene(motion, scene))
    world = bodies_of(
        Bases(baxter(), Uncertainty()), baxter().arms, carried, carried.hands(carried.time)[0], 0.0
    )
    nearing = Nearing(Distances(world))
    pair = next(
        k
        for k in range(len(world.kind))
        if world.name(k) == "l_gripper_l_finger and obstacles[0] (box)" and nearing.applies[k]
    )
    time = np.linspace(0.5, 9.5, 50)
    at = Instants(CarryCourse(world, carried, joints.curve), time, 0.1)
    _, speed = nearing.first_order(PairCells(at, np.arange(50), np.full(50, pair)))
    assert speed.max() < 1e-3  # m/s, of a hand that moves at 0.15 m/s
    knots = np.searchsorted(joints.time, time)
    assert (np.abs(joints.velocity[knots]) @ world.reach[pair, :-1]).max() > 0.2


def test_loads_and_meshes_are_left_to_the_other_bound():
    world = bodies()
    nearing = Nearing(Distances(world))
    for pair, applies in zip(world.geometry.collisionPairs, nearing.applies, strict=True):
        names = [world.geometry.geometryObjects[x].name for x in (pair.first, pair.second)]
        assert applies == (not {"load 0", "torso_0", "pedestal_0"} & set(names))
