"""The candidate is an exact curve, its bounds hold at every instant, and demonstrations keep their shape."""

import pickle
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from comove.dmp import DMP, LinearPhase, Variant, motion_basis
from comove.dmp.basis import rollouts
from comove.dmp.demonstrations import Demonstration
from comove.dmp.system import N_INTERVALS
from comove.errors import OptionError
from comove.geometry import rotations
from comove.model import (
    CoordinatedDMP,
    CoordinatedMotion,
    load_coordinates,
    modulate,
    projected_coordinates,
)
from comove.verification.bounds import largest_acceleration, largest_speed, node_bounds
from tests.cases import examples

from .examples import (
    MIXED,
    PLANAR_BAR,
    SCENES,
    SPATIAL_BAR,
    SPATIAL_TRIANGLE,
    random_motion,
    scene_of,
)

seeds = st.integers(0, 2**32 - 1)
names = st.sampled_from(sorted(SCENES))
metrics = st.sampled_from(["velocity", "acceleration"])
sizes = st.floats(-2, 0.3).map(lambda exponent: 10**exponent)
WITHIN = 8  # samples of an interval


def sampled(motion):
    """Accelerations strictly inside all intervals; array, shape (n_intervals, WITHIN + 1, n_nodes, 3)."""
    share = np.linspace(1e-9, 1 - 1e-9, WITHIN + 1)
    s = (np.arange(N_INTERVALS)[:, None] + share) / N_INTERVALS
    acceleration = motion.coordinates.motion(motion.at(s.ravel()))[2]
    return acceleration.reshape(N_INTERVALS, WITHIN + 1, -1, 3)


@examples(30)
@given(names, seeds, sizes)
def test_velocities_and_accelerations_are_those_of_the_curve(name, seed, size):
    motion = random_motion(name, seed, size)
    if not np.isfinite(node_bounds(motion).acceleration).all():
        return  # a direction nearly vanishes: differences tell nothing there
    s = np.random.default_rng(seed).uniform(0.01, 0.99, 20)
    _, velocity, acceleration = motion.coordinates.motion(motion.at(s))
    h = 1e-5

    def at(s):
        return motion.coordinates.motion(motion.at(s))

    before, after = at(s - h), at(s + h)
    scale = 1 + np.abs(before).max(axis=(1, 2, 3))
    assert np.abs((after[0] - before[0]) / (2 * h) - velocity).max() < 1e-4 * scale[1]
    assert np.abs((after[1] - before[1]) / (2 * h) - acceleration).max() < 1e-3 * scale[2]


@examples(20)
@given(names, seeds, sizes, st.integers(2, 90))
def test_nodes_at_even_times_and_at_knots_are_those_of_the_curve(name, seed, size, n_steps):
    motion = random_motion(name, seed, size)
    there = motion.coordinates.motion(motion.at(np.linspace(0.0, 1.0, n_steps)))[0]
    np.testing.assert_allclose(motion.nodes(n_steps), there, atol=1e-9 * (1.0 + np.abs(there).max()))
    np.testing.assert_array_equal(motion.nodes_at_knots, motion.coordinates.motion(motion.knots))
    assert motion.nodes_at_knots is motion.nodes_at_knots
    assert not motion.nodes_at_knots.flags.writeable


@examples(40)
@given(names, seeds, sizes, metrics)
def test_the_acceleration_bound_holds_at_every_instant(name, seed, size, metric):
    motion = random_motion(name, seed, size, metric=metric)
    bound = node_bounds(motion).acceleration
    actual = np.linalg.norm(sampled(motion), axis=3).max(axis=1)
    assert (actual <= bound * (1 + 1e-9) + 1e-9).all()


@examples(40)
@given(names, seeds, sizes, metrics)
def test_the_jerk_bound_holds_at_every_instant(name, seed, size, metric):
    """A difference quotient of the acceleration is the mean of the jerk: never above its bound."""
    motion = random_motion(name, seed, size, metric=metric)
    change = np.linalg.norm(np.diff(sampled(motion), axis=1), axis=3).max(axis=1)
    actual = change * WITHIN * N_INTERVALS / (1 - 2e-9)
    assert (actual <= node_bounds(motion).jerk * (1 + 1e-6) + 1e-5).all()


@pytest.mark.parametrize(("rate", "change"), [(5.0, 100.0), (8.0, 60.0), (2.0, 150.0)])
def test_the_jerk_bound_of_a_quaternion_on_a_parabola(rate, change):
    """p = (1, 0, 0, x) with x = rate t + change t^2 / 2: p has no third derivative, the body has."""
    coordinates, basis = load_coordinates(SPATIAL_TRIANGLE), motion_basis(20)
    s = np.linspace(0, 1, 201)
    x = np.stack([rate * (s - 0.5) + change * (s - 0.5) ** 2 / 2, rate + change * (s - 0.5)])
    boundary = np.zeros((4, coordinates.n_columns))
    boundary[[0, 2], 3], boundary[:, 6] = 1.0, x[:, [0, -1]].T.ravel()
    dmp = CoordinatedDMP(SPATIAL_TRIANGLE, coordinates, basis, boundary, np.zeros(0))
    motion = dmp.fitted(s, np.concatenate([np.tile(boundary[:1, :6], (201, 1)), x[:1].T], axis=1)).rollout()
    change = np.linalg.norm(np.diff(sampled(motion), axis=1), axis=3).max(axis=1) * WITHIN * N_INTERVALS
    middle = slice(390, 410)
    assert (change <= node_bounds(motion).jerk * (1 + 1e-6))[middle].all()


@examples(20)
@given(seeds, st.floats(0.05, 0.5))
def test_the_acceleration_bound_is_nearly_tight(seed, size):
    """Within a factor 3 of the faster hand of a planar bar in the middle of its movement."""
    motion = random_motion("angle", seed, size)
    bound = node_bounds(motion).acceleration[200:600].max(axis=1)
    actual = np.linalg.norm(sampled(motion), axis=3).max(axis=(1, 2))[200:600]
    assert np.median(bound / actual) < 1.5
    assert (bound / actual).max() < 3


@examples(20)
@given(names, seeds, sizes)
def test_largest_speed_and_acceleration(name, seed, size):
    """Upper bounds of what dense samples show, in metres and seconds; tight where the limit is near."""
    motion = random_motion(name, seed, size)
    jerk, n_hands = node_bounds(motion).jerk, len(motion.scene.manipulators)
    if not np.isfinite(jerk).all():
        return
    knots = motion.coordinates.motion(motion.knots)[:, :, :n_hands]
    s = np.linspace(0, 1 - 1e-12, 5 * N_INTERVALS + 3)
    dense = np.linalg.norm(motion.coordinates.motion(motion.at(s))[1:, :, :n_hands], axis=3).max(axis=(1, 2))
    speed, acceleration = dense / motion.scene.duration ** np.array([1, 2])
    assert speed * (1 - 1e-12) <= largest_speed(motion, knots[1], jerk) <= 1.05 * speed
    for limit in (0.0, np.inf, 1.02 * acceleration):
        bound = largest_acceleration(motion, knots[2], jerk, limit)
        assert bound >= acceleration * (1 - 1e-12)
    assert bound <= 1.1 * acceleration


def test_a_direction_that_vanishes_has_no_bound():
    """Straight from one direction to its opposite, through nothing."""
    start = np.array([[0.0, 0.0, 0.0], [0.2, 0.0, 0.0]])
    scene = scene_of(start, np.add(start[::-1], [0.5, 0, 0]), load={"shape": "bar", "length": 0.2})
    coordinates = load_coordinates(scene)
    motion = CoordinatedMotion(
        scene, coordinates, motion_basis(5), coordinates.boundary(), np.zeros((coordinates.n_columns, 5))
    )
    assert np.isinf(node_bounds(motion).acceleration).any()
    assert not np.isfinite(node_bounds(motion).jerk).all()


@examples(30)
@given(names, seeds, sizes)
def test_both_ends_and_all_distances_are_exact(name, seed, size):
    motion = random_motion(name, seed, size)
    position, velocity, _ = motion.hands(np.linspace(0, 1, 101))
    assert np.abs(position[0] - motion.scene.start).max() < 1e-12
    assert np.abs(position[-1] - motion.scene.goal).max() < 1e-11
    assert np.abs(velocity[[0, -1]]).max() < 1e-9
    for c in motion.scene.distances:
        apart = np.linalg.norm(position[:, c.first] - position[:, c.second], axis=1)
        assert np.abs(apart - c.distance).max() < 1e-14


def test_what_is_handed_out_is_sampled_evenly_and_finely():
    """At 100 Hz or finer, in seconds and metres a second."""
    motion = random_motion("mixed", 0, 0.1)
    path = motion.trajectory()
    assert path.time[0] == 0.0
    assert path.time[-1] == motion.scene.duration == 5.0
    assert np.diff(path.time).max() <= 0.01 + 1e-12
    assert path.manipulators == ("a", "b", "c", "d", "e")
    assert path.position.shape == path.velocity.shape == (len(path.time), 5, 2)
    differences = np.gradient(path.position, path.time, axis=0, edge_order=2)
    assert np.abs(differences - path.velocity).max() < 1e-2 * np.abs(path.velocity).max()
    assert len(motion.trajectory(33).time) == 33


def random_dmp(seed, n_dims, n_basis=20):
    """A movement that starts in motion, on the phase that coordinated movements use."""
    rng = np.random.default_rng(seed)
    return DMP(
        weights=0.2 * rng.standard_normal((n_dims, n_basis)),
        start=rng.uniform(-1, 1, n_dims),
        goal=rng.uniform(1.5, 2, n_dims),
        start_velocity=rng.uniform(-1, 1, n_dims),
        goal_velocity=np.zeros(n_dims),
        duration=2.0,
        phase=LinearPhase(),
    )


def similarity(path, image):
    """Scale and rotation of the least-squares similarity (Umeyama, 1991), and its largest miss."""
    about = [p - p.mean(axis=0) for p in (path, image)]
    u, d, vt = np.linalg.svd(about[1].T @ about[0])
    sign = np.ones(len(d))
    sign[-1] = np.sign(np.linalg.det(u @ vt))
    rotation = (u * sign) @ vt
    scale = (d * sign).sum() / (about[0] ** 2).sum()
    return scale, rotation, np.abs(about[1] - scale * about[0] @ rotation.T).max()


@examples(60)
@given(seeds, st.sampled_from([2, 3]))
def test_modulation_is_a_similarity(seed, n_dims):
    """Of a movement that starts at rest: turned and scaled as its ends are, and never mirrored."""
    rng, dmp = np.random.default_rng(seed), random_dmp(seed, n_dims)
    dmp = replace(dmp, start_velocity=np.zeros(n_dims))
    start, goal = rng.uniform(-1, 1, (2, n_dims))
    path, image = dmp.rollout(), modulate(dmp, start, goal).rollout()
    assert np.abs(image.position[[0, -1]] - [start, goal]).max() < 1e-12
    scale, _, miss = similarity(path.position, image.position)
    assert miss < 1e-10
    assert scale == pytest.approx(np.linalg.norm(goal - start) / np.linalg.norm(dmp.goal - dmp.start))


@pytest.mark.parametrize("n_dims", [2, 3])
@pytest.mark.parametrize("off", [0.0, 1e-9, 1e-6, 1e-4, 1e-2])
def test_modulation_to_the_opposite_direction(n_dims, off):
    dmp = replace(random_dmp(1, n_dims), start_velocity=np.zeros(n_dims))
    goal = 2 * dmp.start - dmp.goal + off * np.eye(n_dims)[0]
    image = modulate(dmp, dmp.start, goal).rollout()
    assert similarity(dmp.rollout().position, image.position)[2] < 1e-4
    assert np.abs(image.position[-1] - goal).max() < 1e-12


@pytest.mark.parametrize("n_dims", [2, 3])
def test_a_closed_movement_is_only_shifted(n_dims):
    dmp = random_dmp(2, n_dims)
    dmp = replace(dmp, goal=dmp.start, start_velocity=np.zeros(n_dims))
    start = np.full(n_dims, 0.3)
    image = modulate(dmp, start, start).rollout().position
    assert np.abs(image - start - (dmp.rollout().position - dmp.start)).max() < 1e-12


@pytest.mark.parametrize("make", [load_coordinates, projected_coordinates])
@pytest.mark.parametrize(("scene", "n_dims"), [(PLANAR_BAR, 2), (SPATIAL_BAR, 3), (MIXED, 2)])
def test_a_demonstration_is_carried_to_every_hand(scene, n_dims, make):
    dmp, coordinates = random_dmp(3, n_dims), make(scene)
    motion = CoordinatedDMP.from_demonstration(dmp, scene, coordinates, motion_basis(20)).rollout()
    position, velocity, _ = motion.hands([0.0, 1.0])
    assert np.abs(position - [scene.start, scene.goal]).max() < 1e-12
    assert np.abs(velocity).max() < 1e-10


@pytest.mark.parametrize("n_dims", [2, 3])
@pytest.mark.parametrize("make", [load_coordinates, projected_coordinates])
def test_carried_straight_the_load_moves_as_was_shown(n_dims, make):
    """All ends shifted alike: every hand repeats the demonstration's own curve."""
    start = np.array([[0.1, 0.4, 0.0], [0.1, 0.6, 0.0]])[:, :n_dims]
    goal = start + np.array([0.7, 0.2, 0.1])[:n_dims]
    scene = scene_of(start, goal, load={"shape": "bar", "length": 0.2})
    dmp = random_dmp(4, n_dims)
    motion = CoordinatedDMP.from_demonstration(dmp, scene, make(scene), motion_basis(20)).rollout()
    s = np.linspace(0, 1, 50)
    shown = [modulate(dmp, a, b).at(s * dmp.duration).position for a, b in zip(start, goal, strict=True)]
    assert np.abs(motion.hands(s)[0] - np.stack(shown, axis=1)).max() < 1e-9


@examples(20)
@given(names, seeds)
def test_a_fit_finds_the_weights_that_made_the_movement(name, seed):
    """From its hands alone, at twice a hundred instants."""
    motion = random_motion(name, seed, 0.05)
    s = np.linspace(0, 1, 201)
    dmp = CoordinatedDMP(motion.scene, motion.coordinates, motion.basis, motion.boundary, np.zeros(0))
    again = dmp.fitted(s, motion.at(s)[0]).rollout()
    assert np.abs(again.hands(s)[0] - motion.hands(s)[0]).max() < 1e-9
    if motion.coordinates.kind == "load" and name not in ("spatial direction", "quaternion", "relative pose"):
        from_hands = dmp.fitted(s, motion.coordinates.from_hands(motion.hands(s)[0])).rollout()
        assert np.abs(from_hands.hands(s)[0] - motion.hands(s)[0]).max() < 1e-9


@pytest.mark.parametrize("turns", [-2, -1, 0, 1, 2])
def test_a_fit_keeps_whole_turns(turns):
    """The bar ends where it should, after as many turns as shown."""
    coordinates, s = load_coordinates(PLANAR_BAR), np.linspace(0, 1, 201)
    ends = coordinates.boundary(turns)
    q = ends[0] + (10 * s**3 - 15 * s**4 + 6 * s**5)[:, None] * (ends[2] - ends[0])
    hands = coordinates.nodes(q.T[None])[0][:, :2, :2]
    dmp = CoordinatedDMP(PLANAR_BAR, coordinates, motion_basis(20), coordinates.boundary(), np.zeros(0))
    motion = dmp.fitted(s, coordinates.from_hands(hands)).rollout()
    assert np.abs(motion.hands(s)[0] - hands).max() < 1e-3
    assert np.abs(motion.hands([0.0, 1.0])[0] - [PLANAR_BAR.start, PLANAR_BAR.goal]).max() < 1e-12
    assert np.ptp(motion.knots[0, :, 2]) == pytest.approx(abs(ends[2, 2] - ends[0, 2]), rel=1e-2)


@pytest.mark.parametrize("sign", [1, -1])
def test_a_fit_keeps_the_way_round_of_a_quaternion(sign):
    """Shown with either sign, and from either sign."""
    coordinates, s = load_coordinates(SPATIAL_TRIANGLE), np.linspace(0, 1, 201)
    for turn in (0, 1):
        ends = coordinates.boundary(turn)
        q = ends[0] + (10 * s**3 - 15 * s**4 + 6 * s**5)[:, None] * (ends[2] - ends[0])
        q[:, 3:] *= sign
        dmp = CoordinatedDMP(
            SPATIAL_TRIANGLE, coordinates, motion_basis(20), coordinates.boundary(), np.zeros(0)
        )
        shown = coordinates.nodes(q.T[None])[0]
        fitted = coordinates.nodes(dmp.fitted(s, q).rollout().at(s)[0].T[None])[0]
        assert np.abs(fitted - shown).max() < 2e-3


@examples(20)
@given(names, seeds, st.integers(2, 60))
def test_a_population_is_a_loop_of_single_rollouts(name, seed, n_steps):
    motion = random_motion(name, seed, 1.0)
    weights = np.random.default_rng(seed).standard_normal((5, *motion.weights.shape))
    dmp = CoordinatedDMP(motion.scene, motion.coordinates, motion.basis, motion.boundary, motion.weights)
    together, s = dmp.rollouts(weights, n_steps), np.linspace(0, 1, n_steps)
    assert together.shape == (5, motion.coordinates.n_columns, n_steps)
    for one, own in zip(together, weights, strict=True):
        assert np.abs(one - dmp.rollout(own).at(s)[0].T).max() < 1e-12
    assert np.array_equal(together, rollouts(motion.basis, motion.boundary, weights, n_steps))


@pytest.mark.parametrize("variant", [variant for variant in Variant if variant is not Variant.RHYTHMIC])
def test_every_variant_is_carried_by_the_similarity(variant):
    """Played by the similarity of the ends it is the movement itself, turned and scaled, whatever its form."""
    dmp = DMP.fit(Demonstration.from_lasa("Angle"), variant=variant).towards(goal=[3.0, -9.0])
    dmp = replace(dmp, start_velocity=np.zeros(2))
    for goal in (np.array([1.0, 0.0]), np.array([-0.2, 0.7])):
        carried = modulate(dmp, np.zeros(2), goal).rollout().position
        turn = rotations.similarity(dmp.goal - dmp.start, goal)
        assert np.abs(carried - (dmp.rollout().position - dmp.start) @ turn.T).max() < 1e-9


def test_rhythmic_movements_lead_nowhere():
    time = np.linspace(0, 1, 100)
    cycle = Demonstration(time, np.stack([np.cos(2 * np.pi * time), np.sin(2 * np.pi * time)], axis=1))
    with pytest.raises(OptionError, match="rhythmic"):
        modulate(DMP.fit(cycle, variant="rhythmic"), np.zeros(2), np.ones(2))


@pytest.mark.parametrize("metric", ["jerk", "velocity"])
def test_a_motion_is_sent_to_another_process_by_what_it_is_made_of(metric):
    """It is the same curve there, cannot be changed either, and takes kilobytes."""
    scene = PLANAR_BAR
    straight = CoordinatedMotion.straight(scene)
    basis = motion_basis(20, metric)
    weights = np.random.default_rng(0).normal(size=(straight.coordinates.n_columns, basis.n_basis))
    motion = CoordinatedMotion(scene, straight.coordinates, basis, straight.boundary, weights)
    content = pickle.dumps(motion)
    same = pickle.loads(content)
    assert len(content) < 20_000
    assert np.array_equal(same.knots, motion.knots)
    assert not same.weights.flags.writeable


def test_a_basis_of_other_kernels_is_sent_whole():
    fading = motion_basis(10, fading_goal=True)
    same = pickle.loads(pickle.dumps(fading))
    assert np.array_equal(same.boundary, fading.boundary)
    assert not np.array_equal(fading.boundary, motion_basis(10).boundary)
