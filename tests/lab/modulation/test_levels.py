"""Level functions: what they are by definition, that margins are kept, and the obstacles of scenes."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from comove.errors import ComoveWarning, OptionError
from comove.geometry.distances import point_distance
from comove.lab.modulation import (
    Box,
    Capsule,
    Cylinder,
    Ellipsoid,
    MovingObstacle,
    Sphere,
    Superquadric,
    level,
    level_obstacle,
    united,
)
from comove.model.scene import Scene
from tests.cases import examples
from tests.lab.modulation.bodies import bodies, cases, on_surface, rotations, vectors


def test_levels_of_spheres_and_ellipsoids_are_those_of_the_paper():
    points = np.array([[0.3, 0.1], [-2.0, 0.5], [0.0, 0.01]])
    disc = MovingObstacle(Sphere(0.2), (0, 0), margin=0.05)
    np.testing.assert_allclose(level(disc, points)[0], (points**2).sum(1) / 0.25**2)
    ellipse = MovingObstacle(Ellipsoid((0.2, 0.4)), (0, 0))
    np.testing.assert_allclose(level(ellipse, points)[0], ((points / [0.2, 0.4]) ** 2).sum(1))
    quadric = MovingObstacle(Superquadric((0.2, 0.4), (2, 3)), (0, 0))
    np.testing.assert_allclose(level(quadric, points)[0], (np.abs(points / [0.2, 0.4]) ** [4, 6]).sum(1))


@examples(300)
@given(cases())
def test_the_gradient_is_that_of_finite_differences(case):
    (obstacle,), point, _ = case
    at, gradient = level(obstacle, point)
    assume(1.0 < at < 1e6)
    h = 1e-6
    steps = h * np.eye(len(point))
    differences = (level(obstacle, point + steps)[0] - level(obstacle, point - steps)[0]) / (2 * h)
    np.testing.assert_allclose(gradient, differences, rtol=1e-3, atol=1e-3 * np.linalg.norm(gradient))


@examples(200)
@given(cases())
def test_levels_grow_on_rays_from_inside(case):
    (obstacle,), point, direction = case
    assume(np.linalg.norm(direction) > 1e-3)
    edge = on_surface(obstacle, direction)
    values = level(obstacle, obstacle.center + np.linspace(0, 3, 31)[:, None] * (edge - obstacle.center))[0]
    assert values[10] == pytest.approx(1.0, abs=1e-9)
    assert (np.diff(values)[values[1:] > 0] > 0).all()  # deep in a long box it is 0 all along its middle
    outside = level(obstacle, point)
    if outside[0] > 1:  # seen from the centre: what reference directions rest on
        assert outside[1] @ (point - obstacle.center) > 0


@examples(200)
@given(st.sampled_from([2, 3]).flatmap(lambda n: st.tuples(bodies(n), vectors(n))))
def test_the_margin_is_kept(drawn):
    """Where the level is 1, the bare obstacle is at least the margin away; exactly where it is made of distances."""
    obstacle, direction = drawn
    assume(np.linalg.norm(direction) > 1e-3)
    require_margin(obstacle, direction)


@pytest.mark.parametrize(
    "shape", [Ellipsoid((0.1, 1.0)), *(Superquadric((0.1, 1.0), (p, p)) for p in (1, 1.5, 4))]
)
def test_the_margin_is_kept_all_around_long_shapes(shape):
    obstacle = MovingObstacle(shape, (0, 0), margin=0.2)
    for angle in np.linspace(0, np.pi / 2, 40):
        require_margin(obstacle, np.array([np.cos(angle), np.sin(angle)]))


def require_margin(obstacle, direction):
    edge = on_surface(obstacle, direction)
    if isinstance(obstacle.shape, Superquadric):
        away = distance_to_superquadric(obstacle, edge)
    else:
        away = point_distance(obstacle.row[None], 0, *edge, *[0.0] * (3 - len(edge)))
    if isinstance(obstacle.shape, Superquadric | Ellipsoid):
        assert away >= obstacle.margin - 1e-6
    else:
        assert away == pytest.approx(obstacle.margin, abs=1e-9)


def distance_to_superquadric(obstacle, point):
    """A lower bound of the distance: that of the plane across the level's gradient."""
    local = (point - obstacle.center) @ obstacle.rotation
    normal = level(obstacle, point)[1] @ obstacle.rotation
    normal /= np.linalg.norm(normal)
    return normal @ local - extent(np.array(obstacle.shape.radii), np.array(obstacle.shape.exponents), normal)


def extent(radii, exponents, n):
    """Greatest n u over the superquadric: u_i from the Lagrangian, its multiplier by bisection."""
    n, power = np.abs(n), 2 * exponents

    def at(log_multiplier):
        with np.errstate(all="ignore"):
            share = np.exp((np.log(n * radii / power) - log_multiplier) / (power - 1))
        return np.where(n > 0, share, 0.0)

    low, high = -200.0, 200.0
    for _ in range(200):
        middle = 0.5 * (low + high)
        if (at(middle) ** power).sum() > 1:
            low = middle
        else:
            high = middle
    return n @ (radii * at(low))


@given(st.data())
def test_the_plane_is_a_slice_of_space(data):
    flat = data.draw(bodies(2, names=("sphere", "box", "ellipsoid", "superquadric")))
    point = data.draw(vectors(2, st.floats(-4, 4)))
    assume(abs(level(flat, point)[0] - 1) > 1e-6)
    turn = np.eye(3)
    turn[:2, :2] = flat.rotation
    shape = flat.shape
    if isinstance(shape, Superquadric):
        shape = Superquadric((*shape.radii, 1e3), (*shape.exponents, 1))
    elif isinstance(shape, Ellipsoid):
        assume(flat.margin == 0)  # with one, semi-axes depend on each other
        shape = Ellipsoid((*shape.radii, 1e3))
    elif isinstance(shape, Box):
        shape = Box((*shape.size, 1e3))
    solid = MovingObstacle(shape, (*flat.center, 0), turn, margin=flat.margin)
    at, gradient = level(solid, (*point, 0))
    assert at == pytest.approx(level(flat, point)[0])
    np.testing.assert_allclose(gradient[:2], level(flat, point)[1], rtol=1e-9, atol=1e-12)
    assert gradient[2] == pytest.approx(0, abs=1e-12)


def test_a_planar_capsule_lies_along_its_own_x():
    capsule = MovingObstacle(Capsule(0.1, 0.6), (1, 1))
    assert level(capsule, [[1.4, 1.0], [0.6, 1.0], [1.2, 1.1], [1.0, 0.9]])[0] == pytest.approx(1)


def test_levels_of_far_points_and_of_the_middle_are_numbers():
    for shape in (Superquadric((0.1, 0.2), (6, 3)), Ellipsoid((0.1, 0.2)), Sphere(0.1), Box((0.1, 0.2))):
        obstacle = MovingObstacle(shape, (0, 0))
        for point in ((1e100, -1e100), (1e30, 1.0), (0, 0), (1e-200, 0)):
            at, gradient = level(obstacle, point)
            assert np.isfinite(at) and np.isfinite(gradient).all()
        assert level(obstacle, (1e30, 1.0))[1][0] > 0


@examples(100)
@given(st.sampled_from([2, 3]).flatmap(lambda n: st.tuples(bodies(n), vectors(n))), st.floats(-1, 1))
def test_a_moved_obstacle_has_moved_as_its_velocities_say(drawn, dt):
    """A point that goes along with the obstacle sees the same level."""
    obstacle, point = drawn
    later = obstacle.moved(dt)
    local = (point - obstacle.center) @ obstacle.rotation
    there = later.center + later.rotation @ local
    np.testing.assert_allclose(level(later, there)[0], level(obstacle, point)[0], rtol=1e-6, atol=1e-9)
    np.testing.assert_allclose(later.center, obstacle.center + dt * obstacle.velocity)
    again = replace(later)  # the short cut of `moved` and the whole way agree
    np.testing.assert_array_equal(later.row, again.row)
    slow = obstacle.moved(1e-6)
    rate = (slow.center + slow.rotation @ local - point) / 1e-6
    arm = point - obstacle.center
    turn = obstacle.angular_velocity
    swept = np.cross(turn, arm) if len(arm) == 3 else turn[0] * np.array([-arm[1], arm[0]])
    np.testing.assert_allclose(rate, obstacle.velocity + swept, atol=1e-4)


PLANAR = (
    {"shape": "box", "center": [0.5, 0.2], "size": [0.1, 0.3], "rotation_deg": 30},
    {"shape": "circle", "center": [0.3, 0.8], "radius": 0.05},
    {"shape": "capsule", "center": [0.7, 0.7], "radius": 0.04, "length": 0.2, "rotation_deg": 50},
    {"shape": "ellipse", "center": [0.5, 0.55], "radii": [0.1, 0.04], "rotation_deg": -20},
)
TURNED = [0.5, 0.5, -0.5, 0.5]
SPATIAL = (
    {"shape": "box", "center": [0.5, 0.2, 0.5], "size": [0.1, 0.3, 0.2], "quaternion_wxyz": TURNED},
    {"shape": "sphere", "center": [0.3, 0.8, 0.4], "radius": 0.05},
    {"shape": "capsule", "center": [0.7, 0.7, 0.5], "radius": 0.04, "length": 0.2, "quaternion_wxyz": TURNED},
    {"shape": "ellipsoid", "center": [0.5, 0.5, 0.6], "radii": [0.1, 0.04, 0.07], "quaternion_wxyz": TURNED},
    {"shape": "cylinder", "center": [0.5, 0.7, 0.2], "radius": 0.05, "height": 0.2},
)


@pytest.mark.parametrize("obstacles", [PLANAR, SPATIAL], ids=["plane", "space"])
def test_obstacles_of_a_scene_stand_where_the_scene_says(obstacles):
    n_dims = len(obstacles[0]["center"])
    scene = Scene.from_dict(
        {
            "name": "s",
            "duration": 1.0,
            "workspace": {"lower": [0] * n_dims, "upper": [1] * n_dims},
            "obstacles": list(obstacles),
            "manipulators": [{"name": "a", "start": [0.05] * n_dims, "goal": [0.95] * n_dims}],
        }
    )
    rng = np.random.default_rng(0)
    for j in range(len(obstacles)):
        center = np.array(obstacles[j]["center"])
        points = center + rng.uniform(-0.15, 0.15, size=(1000, n_dims))
        flat = np.zeros((1000, 3))
        flat[:, :n_dims] = points
        distances = np.array([point_distance(scene.obstacles, j, *p) for p in flat])
        bare = level(level_obstacle(scene, j), points)[0]
        np.testing.assert_array_equal(bare > 1, distances > 0)
        assert 10 < (bare < 1).sum() < 990
        wide = level_obstacle(scene, j, margin=0.03)
        assert (distances[level(wide, points)[0] > 1] > 0.03 - 1e-9).all()
    with pytest.raises(OptionError, match="no obstacle 9"):
        level_obstacle(scene, 9)


@examples(60)
@given(st.data())
@pytest.mark.slow
def test_united_obstacles_share_a_point_inside_both(data):
    n_dims = data.draw(st.sampled_from([2, 3]))
    pair = [data.draw(bodies(n_dims)), data.draw(bodies(n_dims))]
    made = united(pair)
    grid = sampled_overlap(pair)
    if made[0].group is None:
        assert not grid, "they overlap and were not united"
        assert all(o.group is None and not o.reference.any() for o in made)
        return
    assert made[0].group == made[1].group
    points = [o.center + o.rotation @ o.reference for o in made]
    np.testing.assert_allclose(*points, atol=1e-9)
    for obstacle in made:
        assert level(obstacle, points[0])[0] < 1


def sampled_overlap(pair):
    """Whether one of many points well inside the first is well inside the second."""
    rng = np.random.default_rng(1)
    points = pair[0].center + rng.uniform(-2, 2, size=(20000, pair[0].n_dims))
    return bool(((level(pair[0], points)[0] < 0.99) & (level(pair[1], points)[0] < 0.99)).any())


def test_a_chain_without_common_point_is_told():
    chain = [MovingObstacle(Sphere(0.2), (x, 0)) for x in (0, 0.3, 0.6)]
    with pytest.warns(ComoveWarning, match="obstacles 1 and 2 overlap"):
        made = united(chain)
    assert [o.group for o in made] == [0, 0, None]
    with pytest.warns(ComoveWarning, match="obstacles 0 and 2 overlap"):
        made = united([chain[1], chain[0], chain[2]])
    assert [o.group for o in made] == [0, 0, None]
    assert united([]) == ()
    assert united(united(chain[:2])[:1])[0].group is None  # nothing is left of a former group


def flat(**wrong):
    return lambda: MovingObstacle(**({"shape": Sphere(0.1), "center": (0, 0)} | wrong))


@pytest.mark.parametrize(
    ("make", "told"),
    [
        (lambda: Sphere(-1), "radius = -1; give a positive number"),
        (lambda: Sphere(float("nan")), "radius"),
        (lambda: Capsule(0.1, 0), "length = 0"),
        (lambda: Cylinder(True, 1), "radius = True"),
        (lambda: Box((0.1, -0.2)), "size"),
        (lambda: Box((0.1,)), "size"),
        (lambda: Ellipsoid("ab"), "radii"),
        (lambda: Superquadric((1, 1), (0.5, 1)), "below 1"),
        (flat(center=(0,)), "center"),
        (flat(center=(0, np.inf)), "center"),
        (flat(shape=Box((1, 1, 1))), "3 size in 2 dimensions"),
        (flat(shape=Cylinder(1, 1)), "cylinder in the plane"),
        (flat(shape="disc"), "shape = 'disc'"),
        (flat(margin=-0.1), "margin"),
        (flat(rotation=[[1, 0], [0, -1]]), "no rotation"),
        (flat(rotation=np.eye(3)), "no rotation"),
        (flat(velocity=(1, 2, 3)), "velocity"),
        (flat(angular_velocity=(1, 2, 3)), "angular_velocity"),
        (flat(reference=(0.2, 0)), "outside of the obstacle"),
        (flat(group=-1), "group = -1"),
        (lambda: level(flat()(), (0, 0, 0)), "points of shape"),
        (lambda: level(flat()(), (0, np.nan)), "points of shape"),
        (lambda: level(flat()(), (0, 1e200)), "points of shape"),
        (lambda: flat()().moved(np.inf), "dt = inf"),
        (lambda: united([flat()(), MovingObstacle(Sphere(1), (0, 0, 0))]), "3 dimensions among points of 2"),
        (lambda: united([flat()(), "disc"]), "MovingObstacle"),
    ],
)
def test_what_is_no_obstacle_is_told_in_one_sentence(make, told):
    with pytest.raises(OptionError, match=told.replace("(", r"\(")) as error:
        make()
    assert "\n" not in str(error.value)


def test_obstacles_cannot_be_changed_behind_the_tables_back():
    center = np.zeros(2)
    obstacle = MovingObstacle(Sphere(0.1), center)
    center[:] = 1
    assert obstacle.center.tolist() == [0, 0]
    for array in (obstacle.center, obstacle.row, obstacle.moved(1.0).row, obstacle.moved(1.0).center):
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 1


@given(rotations(2))
def test_rotations_turn_counter_clockwise(rotation):
    box = MovingObstacle(Box((0.4, 0.1)), (0, 0), rotation)
    assert level(box, rotation @ [0.2, 0])[0] == pytest.approx(1)
