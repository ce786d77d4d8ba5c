"""The safety filter at one instant: the best of what is allowed, against independent solvers and distances."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.optimize import minimize

from comove.control.safety.cbf_qp import FilterSettings, SafetyFilter, Sighting
from comove.control.safety.twists import hand_velocities, nodes_of, poses_of
from tests.brute_force import obstacle_distance
from tests.cases import examples

from .moving import World, run, scene_of

seeds = st.integers(0, 2**32 - 1)
GAIN = 10.0


def random_obstacles(rng, n_dims, middle, count):
    """Boxes, balls and capsules near the middle, some 5 to 40 cm from the bar."""
    found = []
    while len(found) < count:
        away = rng.standard_normal(n_dims)
        center = (middle + away / np.linalg.norm(away) * rng.uniform(0.3, 0.8)).tolist()
        kind = rng.choice(["box", "circle", "capsule"])
        if kind == "box":
            turn = rng.uniform(0.1, 0.6)  # no face is along the bar, whose nearest point would not be one
            turned = {"rotation_deg": float(np.rad2deg(turn))}
            if n_dims == 3:
                turned = {"quaternion_wxyz": [float(np.cos(turn / 2)), 0.0, 0.0, float(np.sin(turn / 2))]}
            shape = {"size": rng.uniform(0.1, 0.3, n_dims).tolist(), **turned}
        elif kind == "circle":
            shape = {"radius": float(rng.uniform(0.05, 0.2))}
        else:
            shape = {"radius": float(rng.uniform(0.03, 0.1)), "length": float(rng.uniform(0.1, 0.3))}
        found.append({"shape": str(kind), "center": center, **shape})
        try:
            scene_of(found, spatial=n_dims == 3, limits={"speed": None})
        except Exception:
            found.pop()
    return found


def bar_points(scene, world, n_points):
    """Points of the bar that the programme looks at: even ones, and the nearest to every obstacle; (n, 3) [m]."""
    a, b = scene.nodes_at("start")[:2]
    shares = [np.linspace(0.0, 1.0, n_points)]
    fine = np.linspace(0.0, 1.0, 20001)
    for obstacle in scene.file.obstacles:
        distance = obstacle_distance(obstacle, (a + fine[:, None] * (b - a))[:, : scene.n_dims])
        shares.append(fine[[distance.argmin()]])
    return a + np.concatenate(shares)[:, None] * (b - a)


def approach_rows(scene, world, n_points):
    """Rows (matrix, least) of what the bar's twist must keep, from finite differences of plain distances."""
    n, center = scene.n_dims, scene.nodes_at("start")[:2].mean(axis=0)
    rows, least = [], []
    for p in bar_points(scene, world, n_points):
        for j, obstacle in enumerate(scene.file.obstacles):
            step = 1e-6 * np.eye(n)
            ahead, behind = (obstacle_distance(obstacle, p[:n] + s * step) for s in (1, -1))
            normal = np.zeros(3)
            normal[:n] = (ahead - behind) / 2e-6
            h = float(obstacle_distance(obstacle, p[None, :n])[0]) - 0.01
            there = world.velocity[j] + np.cross(world.spin[j], p - world.center[j])
            rows.append(np.concatenate([normal, np.cross(p - center, normal)]))
            least.append(normal @ there - GAIN * h)
    return np.array(rows), np.array(least)


def hands_matrix(scene):
    """Hands' velocities (n_hands, 3, 6) of a twist about the bar's middle."""
    hands = scene.nodes_at("start")[: len(scene.manipulators)]
    center = hands.mean(axis=0)
    matrix = np.zeros((len(hands), 3, 6))
    matrix[:, :, :3] = np.eye(3)
    for axis in range(3):
        matrix[:, :, 3 + axis] = np.cross(np.eye(3)[axis], hands - center)
    return matrix


def reference(scene, wanted, constraints):
    """The best twist by SciPy's SLSQP, and the sum of squares that is left."""
    matrix = hands_matrix(scene)
    free = [0, 1, 5] if scene.n_dims == 2 else range(6)

    def full(x):
        twist = np.zeros(6)
        twist[free] = x
        return twist

    def cost(x):
        return ((matrix @ full(x) - wanted) ** 2).sum() + 1e-9 * (x**2).sum()

    ineq = [{"type": "ineq", "fun": lambda x, c=c: c(full(x))} for c in constraints]
    best = None
    for start in (np.zeros(len(free)), 0.1 * np.ones(len(free))):
        found = minimize(
            cost,
            start,
            constraints=ineq,
            method="SLSQP",
            options={"maxiter": 500, "ftol": 1e-14},
        )
        if found.success and (best is None or found.fun < best.fun):
            best = found
    return None if best is None else (matrix @ full(best.x), best.fun)


@examples(40)
@given(seeds, st.booleans())
def test_the_best_of_what_is_allowed(seed, spatial):
    """With the rows that plain distances give, SLSQP finds the same velocities of the hands.

    The period is so short that no step bends.
    """
    rng, n = np.random.default_rng(seed), 2 + spatial
    scene = scene_of(random_obstacles(rng, n, 2.0, 3), spatial=spatial, limits={"speed": None})
    velocity, spin = np.zeros((2, 3, 3))
    velocity[:, :n] = rng.uniform(-0.3, 0.3, (3, n))
    spin[:, 2] = rng.uniform(-1, 1, 3)
    world = World(scene, velocity, spin)
    wanted = np.zeros((2, 3))
    wanted[:, :n] = rng.uniform(-3, 3, (2, n))
    rows, least = approach_rows(scene, world, 15)
    expected = reference(scene, wanted, [lambda x: rows @ x - least])
    poses = poses_of(scene, "start")
    allowed = SafetyFilter(scene, 1e-5).allowed(poses, np.zeros((2, 3)), wanted, world.sighting())
    if expected is None or allowed.relaxed > 0:
        return
    found = hand_velocities(scene, poses, allowed.twists)
    # Points nearest to an obstacle are known to 2e-5 m here, and nearly parallel rows leave velocities less sure.
    assert (rows @ allowed.twists[0] - least).min() > -1e-4
    assert ((found - wanted) ** 2).sum() == pytest.approx(expected[1], abs=1e-3)
    np.testing.assert_allclose(found, expected[0], atol=5e-3)


@examples(40)
@given(seeds, st.booleans(), st.sampled_from(["bar", "frame"]))
def test_the_best_within_the_limits(seed, spatial, load):
    """Inside the balls, and no further from the best than tangents that lie 2 % inside would be.

    The period is so short that no step bends.
    """
    rng = np.random.default_rng(seed)
    scene = scene_of(load=load, spatial=spatial, limits={"speed": 1.0, "acceleration": 2e4})
    n, n_hands = 2 + spatial, len(scene.manipulators)
    poses = poses_of(scene, "start")
    before, wanted = np.zeros((2, n_hands, 3))
    twist = np.zeros((1, 6))
    twist[0, [0, 1, 5]] = rng.uniform(-0.4, 0.4, 3)
    before = hand_velocities(scene, poses, twist)
    wanted[:, :n] = rng.uniform(-2, 2, (n_hands, n))
    matrix = hands_matrix(scene)

    def balls(share):
        return [
            lambda x: share**2 - ((matrix @ x) ** 2).sum(axis=1),
            lambda x: (share * 0.2) ** 2 - ((matrix @ x - before) ** 2).sum(axis=1),
        ]

    allowed = SafetyFilter(scene, 1e-5).allowed(poses, before, wanted, Sighting.still(scene))
    found = hand_velocities(scene, poses, allowed.twists)
    assert allowed.relaxed == 0.0 and allowed.blocking == -2
    assert np.linalg.norm(found, axis=1).max() <= 1.0 + 1e-8
    assert np.linalg.norm(found - before, axis=1).max() <= 0.2 * (1 + 1e-8)
    cost = ((found - wanted) ** 2).sum()
    inner, outer = (reference(scene, wanted, balls(share)) for share in (0.979, 1.0))
    if inner is not None and outer is not None:
        assert outer[1] - 1e-6 <= cost <= inner[1] + 1e-6


@pytest.mark.parametrize(
    ("load", "spatial"),
    [("bar", False), ("bar", True), ("frame", True), ("two bodies", False), ("hands", True)],
)
@pytest.mark.parametrize("acceleration", [None, 50.0])
def test_what_is_wanted_far_away_comes_back(load, spatial, acceleration):
    """To 1e-9, if it is a motion of the load, even at the speed limit."""
    scene = scene_of(
        [{"shape": "circle", "center": [0.3] * (2 + spatial), "radius": 0.1}],
        load=load,
        spatial=spatial,
        limits={"acceleration": acceleration},
    )
    rng, poses = np.random.default_rng(1), poses_of(scene, "start")
    programme = SafetyFilter(scene)
    for _ in range(20):
        twists = rng.uniform(-0.3, 0.3, (len(scene.groups), 6))
        if not spatial:
            twists[:, 2:5] = 0.0
        wanted = hand_velocities(scene, poses, twists)
        wanted /= max(1.0, np.linalg.norm(wanted, axis=1).max())
        allowed = programme.allowed(poses, 0.9 * wanted, wanted, Sighting.still(scene))
        np.testing.assert_allclose(hand_velocities(scene, poses, allowed.twists), wanted, atol=1e-9)
        assert allowed.relaxed == 0.0 and allowed.blocking == -2
    wanted = np.zeros((len(scene.manipulators), 3))
    wanted[:, 0] = 1.0
    allowed = programme.allowed(poses, wanted, wanted, Sighting.still(scene))
    np.testing.assert_allclose(hand_velocities(scene, poses, allowed.twists), wanted, atol=1e-9)


def test_turning_that_moves_no_hand_is_left_out():
    """Two hands leave the roll of a body with relative poses open; it does not roll."""
    pose = [{"type": "relative_pose", "between": ["left", "right"]}]
    scene = scene_of(spatial=True, constraints=pose)
    poses = poses_of(scene, "start")
    wanted = np.array([[0.1, 0.2, 0.3], [0.1, 0.2, -0.3]])
    twist = SafetyFilter(scene).allowed(poses, wanted, wanted, Sighting.still(scene)).twists[0]
    assert abs(twist[4]) < 1e-9  # the bar lies along y


def test_upright_loads_turn_about_the_vertical_only():
    scene = scene_of(load="box", spatial=True, constraints=[{"type": "upright"}])
    wanted = np.random.default_rng(0).standard_normal((2, 3))
    poses = poses_of(scene, "start")
    twist = SafetyFilter(scene).allowed(poses, np.zeros((2, 3)), wanted, Sighting.still(scene)).twists[0]
    assert not twist[3:5].any() and twist[5] != 0.0


def test_hands_at_one_height_rise_together():
    same = [{"type": "same_height", "between": ["left", "third"]}]
    scene = scene_of(load="hands", spatial=True, constraints=same)
    wanted = np.array([[0, 0, 0.3], [0, 0, 0.5], [0, 0, 0.1]])
    poses = poses_of(scene, "start")
    twists = SafetyFilter(scene).allowed(poses, wanted, wanted, Sighting.still(scene)).twists
    rising = hand_velocities(scene, poses, twists)[:, 2]
    np.testing.assert_allclose(rising, [0.2, 0.5, 0.2], atol=1e-12)


def test_it_says_what_blocks():
    ball = {"shape": "circle", "center": [2.2, 2.0], "radius": 0.1}
    far = {"shape": "circle", "center": [0.5, 0.5], "radius": 0.1}
    scene = scene_of([far, ball], limits={"clearance": 0.02})
    poses, wanted = poses_of(scene, "start"), np.tile([2.0, 0.0, 0.0], (2, 1))
    world = World(scene)
    allowed = SafetyFilter(scene).allowed(poses, 0 * wanted, wanted, world.sighting())
    assert allowed.blocking == 1
    seen = SafetyFilter(scene).allowed(poses, 0 * wanted, wanted, world.sighting(margin=0.03))
    approach = [a.twists[0, 0] for a in (allowed, seen)]
    np.testing.assert_allclose(np.diff(approach), -0.03 * GAIN, rtol=1e-5)
    away = SafetyFilter(scene).allowed(poses, 0 * wanted, -wanted / 4, world.sighting())
    assert away.blocking == -2
    small = scene_of(side=0.5)
    wanted = np.roll(wanted, 1, axis=1)
    border = SafetyFilter(small).allowed(poses_of(small, "start"), 0 * wanted, wanted, Sighting.still(small))
    assert border.blocking == -1


def test_a_wall_that_recedes_is_followed():
    """As fast as it goes and a little faster, by what the clearance allows."""
    wall = {"shape": "box", "center": [2.01 + 0.02 + 0.05, 2.0], "size": [0.1, 3.0]}
    scene, wanted = scene_of([wall]), np.tile([0.9, 0.0, 0.0], (2, 1))
    sighting = World(scene, [[0.5, 0.0, 0.0]]).sighting()
    allowed = SafetyFilter(scene).allowed(poses_of(scene, "start"), wanted, wanted, sighting)
    assert allowed.twists[0, 0] == pytest.approx(0.5 + GAIN * 0.02, abs=1e-5)


def test_many_obstacles_may_be_seen_that_the_scene_does_not_know():
    scene = scene_of([{"shape": "circle", "center": [2.3, 2.0], "radius": 0.1}])
    poses, wanted = poses_of(scene, "start"), np.tile([1.0, 0.0, 0.0], (2, 1))
    programme = SafetyFilter(scene)
    one = programme.allowed(poses, 0 * wanted, wanted, Sighting.still(scene))
    for n in (7, 0, 1):
        still = Sighting(np.repeat(scene.obstacles, n, axis=0), *np.zeros((2, n, 3)), np.zeros(n))
        allowed = programme.allowed(poses, 0 * wanted, wanted, still)
        expected = one.twists if n else [[1.0, 0, 0, 0, 0, 0]]
        np.testing.assert_allclose(allowed.twists, expected, atol=1e-9)
    assert one.twists[0, 0] < 1.0 or one.blocking == -2


def test_where_nothing_is_admissible_it_says_so_and_violates_least():
    """Two walls close in at different speeds: the load takes the mean, and never moves faster than it may."""
    walls = [
        {"shape": "box", "center": [x, 2.0], "size": [0.1, 3.0]}
        for x in (2.0 - 0.0601 - 0.001, 2.0601 + 0.001)
    ]
    scene = scene_of(walls)
    velocity = np.array([[0.3, 0, 0], [-0.1, 0, 0]])
    poses = poses_of(scene, "start")
    allowed = SafetyFilter(scene).allowed(
        poses, np.zeros((2, 3)), np.tile([0, 0.5, 0], (2, 1)), World(scene, velocity).sighting()
    )
    assert allowed.relaxed == pytest.approx(0.2 - GAIN * 0.0011, abs=1e-3)
    np.testing.assert_allclose(allowed.twists[0], [0.1, 0.5, 0, 0, 0, 0], atol=2e-3)


def test_what_comes_too_fast_drives_no_load_into_something_else():
    """The retreat gives way, not the wall behind."""
    wall = {"shape": "box", "center": [2.0 + 0.01 + 0.005 + 0.05, 2.0], "size": [0.1, 3.0]}
    ball = {"shape": "circle", "center": [1.7, 2.0], "radius": 0.2}
    scene = scene_of([wall, ball])
    sighting = World(scene, [[0, 0, 0], [1.5, 0, 0]]).sighting()
    allowed = SafetyFilter(scene).allowed(
        poses_of(scene, "start"), np.zeros((2, 3)), np.zeros((2, 3)), sighting
    )
    assert allowed.relaxed > 0.1
    assert 0.0 < allowed.twists[0, 0] <= GAIN * 0.005 + 1e-6


def test_another_body_does_not_pay_for_what_one_cannot_keep():
    """One load is squeezed; the free hand, far away, keeps clear of the wall it is driven at."""
    walls = [{"shape": "box", "center": [x, 2.0], "size": [0.1, 0.6]} for x in (1.93, 2.07)]
    block = {"shape": "box", "center": [2.4, 2.0], "size": [0.1, 0.6]}
    scene = scene_of([*walls, block], load="two bodies")
    sighting = World(scene, [[0.3, 0, 0], [-0.3, 0, 0], [0, 0, 0]]).sighting()
    wanted = np.zeros((3, 3))
    wanted[2, 0] = 1.0
    poses = poses_of(scene, "start")
    allowed = SafetyFilter(scene).allowed(poses, np.zeros((3, 3)), wanted, sighting)
    assert allowed.relaxed > 0.1
    assert allowed.twists[1, 0] <= GAIN * 0.05 + 1e-6


def test_nor_does_it_wait_for_what_comes_upon_both():
    """One wall comes upon a load that cannot retreat and upon a hand that can: the hand does, as fast as it must."""
    wall = {"shape": "box", "center": [1.93, 2.5], "size": [0.1, 3.0]}
    block = {"shape": "box", "center": [2.065, 2.0], "size": [0.1, 0.6]}
    ends = {"left": [2.0, 1.8], "right": [2.0, 2.2], "third": [2.0, 3.0]}
    hands = [{"name": name, "start": p, "goal": p} for name, p in ends.items()]
    scene = scene_of([wall, block], load="two bodies", manipulators=hands)
    sighting = World(scene, [[0.5, 0, 0], [0, 0, 0]]).sighting()
    still = np.zeros((3, 3))
    allowed = SafetyFilter(scene).allowed(poses_of(scene, "start"), still, still, sighting)
    assert allowed.relaxed > 0.3
    assert allowed.twists[1, 0] == pytest.approx(0.5 - GAIN * 0.02, abs=1e-3)


def test_a_lost_clearance_is_restored():
    """Inside the clearance the load retreats, at most with the speed for it, and ends up outside."""
    ball = {"shape": "circle", "center": [2.2, 2.0], "radius": 0.1}
    scene = scene_of([ball])
    retreat = FilterSettings(retreat_speed=0.05)
    sighting = World(scene).sighting(margin=0.1)
    poses = poses_of(scene, "start")
    allowed = SafetyFilter(scene, settings=retreat).allowed(poses, *np.zeros((2, 2, 3)), sighting)
    assert allowed.relaxed == 0.0
    assert -allowed.twists[0, 0] == pytest.approx(0.05, abs=1e-3)
    found = run(World(scene), np.zeros((2, 3)), 300, margin=0.1)
    assert World(scene).clearance(nodes_of(scene, found.poses)) == pytest.approx(0.1, abs=1e-5)


def test_who_is_too_fast_brakes_within_the_acceleration():
    scene = scene_of(limits={"acceleration": 5.0})
    poses, before = poses_of(scene, "start"), np.tile([2.0, 0, 0], (2, 1))
    allowed = SafetyFilter(scene).allowed(poses, before, before, Sighting.still(scene))
    now = hand_velocities(scene, poses, allowed.twists)
    assert np.linalg.norm(now - before, axis=1).max() <= 0.05 * (1 + 1e-8)
    assert now[0, 0] < 2.0 - 0.04


def test_limits_that_contradict_each_other_still_give_an_answer():
    """Hands that no rigid load could have: the twist nearest to going on."""
    scene = scene_of(limits={"acceleration": 1.0})
    before = np.array([[0.0, 5.0, 0.0], [0.0, -5.0, 0.0]])
    allowed = SafetyFilter(scene).allowed(poses_of(scene, "start"), before, 0 * before, Sighting.still(scene))
    assert np.isfinite(allowed.twists).all()


@pytest.mark.parametrize("seed", range(4))
def test_rounds_that_would_find_the_same_again_are_not_made(seed, monkeypatch):
    """Hands that draw apart, or turn about the bar in a way that it cannot, in space."""
    scene = scene_of(spatial=True, limits={"acceleration": 1.0})
    before = np.random.default_rng(seed).normal(0.0, 2.0, (2, 3))
    before[1, :2] = -before[0, :2]
    poses, rounds = poses_of(scene, "start"), []

    def answer(settings):
        programme = SafetyFilter(scene, settings=settings)
        solved = programme._solved
        monkeypatch.setattr(programme, "_solved", lambda *args: rounds.append(0) or solved(*args))
        rounds.clear()
        return programme.allowed(poses, before, 0 * before, Sighting.still(scene)), len(rounds)

    short, n_short = answer(FilterSettings())
    long, n_long = answer(FilterSettings(as_good=-np.inf))
    assert n_short < n_long == FilterSettings().max_rounds
    hands = [hand_velocities(scene, poses, found.twists) for found in (short, long)]
    slack = np.linalg.norm(hands[1] - before, axis=1).max()  # far more than the acceleration allows
    assert np.abs(hands[0] - hands[1]).max() < 0.03 * slack
