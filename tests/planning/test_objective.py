"""The objective is equation (4), and its penalty speaks whenever something is touched, between samples too."""

import time
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from benchmarks.random_scenes import moving_scene
from comove.dmp.basis import motion_basis, rollouts
from comove.model import CoordinatedMotion, Scene, load_coordinates
from comove.planning import PaperCost
from comove.planning.objective import N_STEPS, ContactPenalty, Objective
from tests import brute_force
from tests.cases import examples
from tests.solved import solved
from tests.verification.random_motions import near_contact, on_scene, perturbed, scene_data

TOLERANCE = 2e-4  # m, of the search's distances along an edge
seeds = st.integers(0, 2**32 - 1)
S = np.linspace(0.0, 1.0, N_STEPS)


def evaluated(motion, penalty=None, weights=None, demonstration=None, size=1.0):
    """The evaluation of one motion."""
    objective = Objective(
        motion.scene, motion.coordinates, weights or PaperCost(), penalty or ContactPenalty(), demonstration
    )
    return objective.evaluate(rollouts(motion.basis, motion.boundary, motion.weights[None], N_STEPS), size)


def sampled_distances(motion):
    """Distances [m] of the body from every obstacle at the samples; array, shape (n_obstacles, N_STEPS)."""
    a, b, radii = brute_force.body_of(motion.scene, brute_force.hands_at(motion, S))
    shares = np.linspace(0.0, 1.0, 401)[:, None]
    points = a[:, :, None] + shares * (b - a)[:, :, None]
    return np.array(
        [
            (brute_force.obstacle_distance(obstacle, points) - radii[:, None]).min(axis=(1, 2))
            for obstacle in motion.scene.file.obstacles
        ]
    ).reshape(-1, N_STEPS)


def crossing(n_dims, wall, *, speed=1.0, at=0.5):
    """A hand that goes straight through a box of the sizes `wall`, its centre `at` x on the way."""
    rest = [0.5] * (n_dims - 1)
    scene = Scene.from_dict(
        {
            "name": "crossing",
            "duration": 1.0,
            "workspace": {"lower": [-10.0] * n_dims, "upper": [10.0] * n_dims},
            "obstacles": [{"shape": "box", "center": [at, *rest], "size": wall}],
            "manipulators": [
                {"name": "a", "start": [0.5 - speed / 2, *rest], "goal": [0.5 + speed / 2, *rest]}
            ],
        }
    )
    basis, coordinates = motion_basis(30), load_coordinates(scene)
    weights = np.zeros((coordinates.n_columns, basis.n_basis))
    return CoordinatedMotion(scene, coordinates, basis, coordinates.boundary(), weights)


# --- Equation (4) ---


@examples(40)
@given(seeds, st.floats(0, 3), st.floats(0, 3), st.floats(0.01, 3))
def test_the_terms_are_those_of_equation_4(seed, c_goal, c_vel, c_res):
    rng = np.random.default_rng(seed)
    motion = near_contact(rng)
    y = motion.hands(S)[0]
    taught = np.zeros((N_STEPS, y.shape[1], 3))
    taught[..., : y.shape[2]] = rng.uniform(0, 1, y.shape)
    weights = PaperCost(goal=c_goal, velocity=c_vel, obstacle=7.0, resemblance=c_res)
    cost = Objective(motion.scene, motion.coordinates, weights, ContactPenalty(), taught).cost(motion)
    n = N_STEPS
    assert cost.goal == pytest.approx(c_goal * ((y - y[-1]) ** 2).sum() / n, rel=1e-9)
    assert cost.velocity == pytest.approx(
        c_vel * (n - 1) ** 2 / n * (np.diff(y, axis=0) ** 2).sum(), rel=1e-9
    )
    away = ((y - taught[..., : y.shape[2]]) ** 2).sum()
    assert cost.resemblance == pytest.approx(c_res * away / n, rel=1e-9)
    assert cost.total == cost.goal + cost.velocity + cost.obstacle + cost.resemblance


@examples(40)
@given(seeds)
def test_the_indicator_counts_obstacles_that_are_touched(seed):
    motion = near_contact(np.random.default_rng(seed))
    distance = sampled_distances(motion)
    weights = PaperCost(obstacle=7.0)
    value = Objective(motion.scene, motion.coordinates, weights).cost(motion).obstacle / 7.0 * N_STEPS
    assert value == pytest.approx(round(value), abs=1e-9)
    assert (distance < -TOLERANCE).sum() <= round(value) <= (distance < TOLERANCE).sum()


def test_the_goal_term_of_a_verified_motion_is_that_of_its_scene():
    """Also where the goal is given by another turn of the load."""
    motion = solved("narrow").attempt
    y = motion.hands(S)[0]
    expected = ((y - motion.scene.goal) ** 2).sum() / N_STEPS
    assert solved("narrow").cost.goal == pytest.approx(expected, rel=1e-9)
    assert solved("narrow").cost.obstacle == 0.0


def test_no_demonstration_no_resemblance():
    motion = solved("narrow").attempt
    assert (
        Objective(motion.scene, motion.coordinates, PaperCost(resemblance=5.0)).cost(motion).resemblance
        == 0.0
    )
    taught = np.zeros((N_STEPS, 2, 3))
    assert Objective(motion.scene, motion.coordinates, demonstration=taught).cost(motion).resemblance == 0.0


def test_a_motion_like_the_demonstration_has_no_resemblance_cost():
    motion = solved("narrow").attempt
    taught = np.zeros((N_STEPS, 2, 3))
    taught[..., :2] = motion.hands(S)[0]
    weights = PaperCost(resemblance=5.0)
    cost = Objective(motion.scene, motion.coordinates, weights, ContactPenalty(), taught).cost(motion)
    assert cost.resemblance == pytest.approx(0.0, abs=1e-20)


def test_a_population_is_evaluated_one_by_one():
    """No rollout knows of the others."""
    rng = np.random.default_rng(0)
    motions = [perturbed(solved("complex").attempt, rng) for _ in range(7)]
    weights = np.stack([motion.weights for motion in motions])
    weights[3] = np.nan
    objective = Objective(motions[0].scene, motions[0].coordinates)
    with np.errstate(all="ignore"):
        together = objective.evaluate(rollouts(motions[0].basis, motions[0].boundary, weights, N_STEPS))
    for i, motion in enumerate(motions):
        alone = evaluated(motion)
        if i != 3:
            assert together.cost[i] == pytest.approx(alone.cost[0], rel=1e-12)  # sums are ordered otherwise
            assert together.penalty[i] == pytest.approx(alone.penalty[0], abs=1e-12)
            assert together.clearance[i] == pytest.approx(alone.clearance[0], abs=1e-12)


@pytest.mark.parametrize("seed", range(4))
def test_among_moving_obstacles_too(seed):
    """Where obstacles have gone to in one rollout says nothing about the next."""
    scene, basis, rng = moving_scene(seed), motion_basis(20), np.random.default_rng(seed)
    coordinates = load_coordinates(scene)
    weights = 0.05 * rng.standard_normal((6, coordinates.n_columns, basis.n_basis))
    objective, q = Objective(scene, coordinates), rollouts(basis, coordinates.boundary(), weights, N_STEPS)
    together = objective.evaluate(q)
    alone = [objective.evaluate(each[None]) for each in q]
    for name in ("cost", "penalty", "clearance"):
        found = np.concatenate([getattr(each, name) for each in alone])
        np.testing.assert_allclose(getattr(together, name), found, rtol=1e-12, atol=1e-12)


# --- Penalty ---


@examples(60)
@given(seeds, st.sampled_from([0.002, 0.01, 0.02]))
def test_no_penalty_above_the_margin_and_some_below(seed, margin):
    """At the samples; `clearance` is what is seen, up to the margin."""
    motion = near_contact(np.random.default_rng(seed))
    data = scene_data(motion.scene)
    motion = on_scene(motion, data | {"limits": {"clearance": 0.0}})
    value = evaluated(motion, ContactPenalty(margin=margin))
    truth = brute_force.least_clearance(motion)[0]
    at_samples = brute_force.configuration_clearance(motion.scene, brute_force.hands_at(motion, S)).min()
    peak = (
        np.linalg.norm(np.diff(brute_force.hands_at(motion), 2, axis=0), axis=-1).max()
        * brute_force.COARSE**2
    )
    bulge = 2 * peak / 8 / (N_STEPS - 1) ** 2 + TOLERANCE  # of the curve between samples, for hands and load
    if truth > margin + bulge:
        assert value.penalty[0] == 0.0
    if at_samples < margin - TOLERANCE:
        assert value.penalty[0] > 0.0
        assert value.clearance[0] <= at_samples + TOLERANCE
    if at_samples < -TOLERANCE:
        assert value.penalty[0] >= 10.0 / N_STEPS / 6
    assert truth - bulge <= value.clearance[0] or value.clearance[0] == margin


def test_without_a_margin_only_contact_costs():
    """As in the search with `obstacles="cost"`; the motion passes every obstacle by 9 mm or more."""
    motion = solved("narrow").attempt
    assert brute_force.least_clearance(motion)[0] > 0.005
    assert evaluated(motion, ContactPenalty(margin=0.0)).penalty[0] == 0.0


def test_the_penalty_grows_with_depth():
    """A disc beside the way that swells into it: the deeper, the more."""
    motion = solved("wide").attempt
    data = scene_data(motion.scene)
    swept = motion.hands(S)[0].mean(axis=1)
    center = (swept[int(np.searchsorted(swept[:, 0], 0.5))] + [0, 0.2]).tolist()
    penalties = []
    for radius in np.linspace(0.01, 0.25, 25):
        obstacle = {"shape": "circle", "center": center, "radius": float(radius)}
        penalties.append(evaluated(on_scene(motion, data | {"obstacles": [obstacle]})).penalty[0])
    assert penalties[0] == 0.0
    assert penalties[-1] > 0.1
    growth = np.diff(penalties)
    assert (growth >= 0).all()
    assert (growth[np.array(penalties[:-1]) > 0] > 0).all()


def test_a_wider_margin_is_felt_sooner():
    motion = solved("narrow").attempt
    values = [
        evaluated(motion, ContactPenalty(margin=margin)).penalty[0] for margin in (0.004, 0.01, 0.02, 0.04)
    ]
    assert (np.diff(values) >= 0).all()
    assert values[-1] > 0


def test_the_clearance_that_is_asked_for_is_a_contact():
    """Being nearer than `limits.clearance` costs the step, not only the slope."""
    motion = solved("wide").attempt
    clearance = solved("wide").report.clearance_min
    data = scene_data(motion.scene)
    near = on_scene(motion, data | {"limits": {"clearance": clearance - 5e-4}})
    nearer = on_scene(motion, data | {"limits": {"clearance": min(clearance + 5e-4, 0.09)}})
    objective = Objective(near.scene, near.coordinates)
    assert objective.feasible(evaluated(near))[0]
    assert (
        not objective.feasible(evaluated(nearer))[0]
        or not Objective(nearer.scene, nearer.coordinates).feasible(evaluated(nearer))[0]
    )
    assert evaluated(nearer).penalty[0] >= evaluated(near).penalty[0] + 10.0 / N_STEPS / 6


def test_growing_the_load():
    """A load of no size is its centre: what only the hands touch is not felt."""
    motion = solved("wide").attempt
    data, y = scene_data(motion.scene), motion.hands(S)[0]
    k = int(np.searchsorted(y[:, 0, 0], 0.5))
    hand = {"shape": "circle", "center": y[k, 0].tolist(), "radius": 0.01}
    touched = on_scene(motion, data | {"obstacles": [hand]})
    assert evaluated(touched).penalty[0] > 0
    assert evaluated(touched, size=0.05).penalty[0] == 0
    center = {"shape": "circle", "center": y[k].mean(axis=0).tolist(), "radius": 0.01}
    touched = on_scene(motion, data | {"obstacles": [center]})
    assert evaluated(touched).penalty[0] > 0
    assert evaluated(touched, size=0.05).penalty[0] > 0


@pytest.mark.parametrize("n_dims", [2, 3])
@pytest.mark.parametrize("thickness", [1e-2, 1e-3, 1e-6])
@pytest.mark.parametrize("speed", [1.0, 5.0])
def test_a_thin_wall_between_two_samples_is_not_skipped(n_dims, thickness, speed):
    """Nor by a hand that makes 4 cm between two samples."""
    wall = [thickness, *[0.3] * (n_dims - 1)]
    motion = crossing(n_dims, wall, speed=speed)
    x = motion.hands(S)[0][:, 0, 0]
    assert np.diff(x).max() > 0.007 * speed
    k = int(np.argmax(np.diff(x)))
    for share in (0.5, 0.2, 0.35):
        at = float(x[k] + share * (x[k + 1] - x[k]))
        walled = crossing(n_dims, wall, speed=speed, at=at)
        if thickness < 1e-2:
            assert sampled_distances(walled).min() > 0  # no sample touches it
        for along_path in (False, True):
            value = evaluated(walled, ContactPenalty(along_path=along_path))
            assert value.penalty[0] > 0
            assert value.clearance[0] < 0.01


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf, 1e200])
def test_what_is_not_finite_is_never_good_and_never_endless(bad):
    motion = solved("narrow").attempt
    weights = motion.weights.copy()
    weights[0, 5] = bad
    begun = time.process_time()
    with np.errstate(all="ignore"):
        value = evaluated(replace(motion, weights=weights))
        objective = Objective(motion.scene, motion.coordinates)
        assert not objective.feasible(value)[0]
        assert not objective.search_value(value)[0] < 1e6  # NaN ranks last
    assert value.penalty[0] == np.inf
    assert time.process_time() - begun < 60.0  # not one step for each metre


# --- Limits ---


def test_broken_limits_cost_and_are_not_feasible():
    motion = solved("narrow").attempt
    data = scene_data(motion.scene)
    free = on_scene(motion, data | {"limits": {}})
    value = evaluated(free)
    speed, acceleration = value.speed[0], value.acceleration[0]
    base = Objective(free.scene, free.coordinates).search_value(value)[0]
    for limits, feasible in (
        ({"speed": 1.05 * speed}, True),
        ({"speed": 0.95 * speed}, False),
        ({"acceleration": 1.05 * acceleration}, True),
        ({"acceleration": 0.95 * acceleration}, False),
    ):
        limited = on_scene(motion, data | {"limits": limits})
        objective, value = Objective(limited.scene, limited.coordinates), evaluated(limited)
        assert objective.feasible(value)[0] == feasible
        assert (objective.search_value(value)[0] > base) != feasible


def test_speed_and_acceleration_are_those_of_the_samples():
    motion = solved("complex").attempt
    value, y = evaluated(motion), motion.hands(S)[0]
    step = motion.scene.duration / (N_STEPS - 1)
    speed = np.linalg.norm(np.diff(y, axis=0), axis=-1).max() / step
    bend = np.concatenate([2 * (y[1:2] - y[:1]), np.diff(y, 2, axis=0)])  # at rest at the start
    acceleration = np.linalg.norm(bend, axis=-1).max() / step**2
    assert value.speed[0] == pytest.approx(speed, rel=1e-9)
    assert value.acceleration[0] == pytest.approx(acceleration, rel=1e-9)


def test_the_acceleration_at_the_start_is_seen():
    motion = solved("complex").attempt
    start = np.linalg.norm(motion.hands([0.0])[2][0], axis=-1).max() / motion.scene.duration**2
    assert evaluated(motion).acceleration[0] > 0.7 * start
