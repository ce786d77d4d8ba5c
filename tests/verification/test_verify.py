"""The judge: only it makes a verified motion, and for every way to fail it has a reason."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import comove
from comove.dmp import motion_basis
from comove.errors import OptionError, SceneError
from comove.lab.evolution import Paper, Projection
from comove.model import CoordinatedMotion, Scene, load_coordinates
from comove.verification import VerifiedMotion, verify
from comove.verification.bounds import node_bounds
from comove.verification.verify import CheckOfVerified
from tests import brute_force
from tests.cases import examples
from tests.solved import solved
from tests.verification.random_motions import on_scene, random_motion, scene_data

seeds = st.integers(0, 2**32 - 1)
SOLVED = ["narrow", "wide", "planar 0", "bar 0", "triangle 0"]


@pytest.fixture
def motion():
    """A verified motion without limits; its speed is below 1 m/s."""
    motion = solved("wide").attempt
    return on_scene(motion, scene_data(motion.scene) | {"limits": {}})


def limited(motion, **limits):
    """The same motion in its scene with these limits."""
    return on_scene(motion, scene_data(motion.scene) | {"limits": limits})


def the_reason(motion, *words):
    """Judge a motion that fails for one reason, which holds all of `words`."""
    verdict = verify(motion)
    assert verdict.verified is None
    assert len(verdict.reasons) == 1, verdict.reasons
    for word in words:
        assert word in verdict.reasons[0]
    return verdict.reasons[0]


def dense(motion, n_steps=20_001):
    """Largest speed [m/s] and acceleration [m/s^2] of a hand at dense samples, the last just before the end."""
    s = np.linspace(0.0, 1.0, n_steps)
    s[-1] = np.nextafter(1.0, 0.0)
    _, velocity, acceleration = motion.hands(s)
    duration = motion.scene.duration
    speed, change = (np.linalg.norm(x, axis=-1).max() for x in (velocity, acceleration))
    return speed / duration, change / duration**2


# --- before the start and after the end ---


def in_basis(motion, metric, size=0.02):
    """A motion with the same ends in another basis, whose weights are a little of everything."""
    basis = motion_basis(20, metric)
    coordinates = motion.coordinates
    weights = size * np.resize([1.0, -1.0, 0.5], (coordinates.n_columns, basis.n_basis))
    return CoordinatedMotion(motion.scene, coordinates, basis, coordinates.boundary(), weights)


@pytest.mark.parametrize("metric", ["velocity", "acceleration"])
def test_a_step_of_the_acceleration_at_the_start_is_an_infinite_jerk(metric, motion):
    """Differences across the start, where the hands rest, grow without bound; the judge says so."""
    stepped = in_basis(limited(motion, jerk=1e6), metric)
    s = 1e-6
    jump = np.linalg.norm(stepped.hands([s])[2][0], axis=1).max() / stepped.scene.duration**2
    assert jump / (s * stepped.scene.duration) > 1e3, "the acceleration is there at once"
    verdict = verify(stepped)
    assert verdict.report.jerk_max == np.inf
    assert any("acceleration jumps" in reason for reason in verdict.reasons)
    assert any("jerk has no bound (limit 1e+06 m/s^3)" in reason for reason in verdict.reasons)
    free = verify(in_basis(motion, metric))
    assert free.report.jerk_max is None and not any("jump" in reason for reason in free.reasons)


def test_motions_of_least_jerk_begin_and_end_without_a_step(motion):
    smooth = in_basis(limited(motion, jerk=1e6), "jerk")
    verdict = verify(smooth)
    assert verdict.report.jerk_max < 1e6
    assert not any("jump" in reason for reason in verdict.reasons)


def test_hands_that_move_at_the_start_already_are_refused(motion):
    boundary = motion.boundary.copy()
    boundary[1, 0] = 0.01 * motion.scene.duration
    moving = CoordinatedMotion(motion.scene, motion.coordinates, motion.basis, boundary, motion.weights)
    verdict = verify(moving)
    assert any("a hand moves at 0.01 m/s at the start already" in reason for reason in verdict.reasons)


@pytest.mark.parametrize("method", [Projection(), Paper()], ids=["projection", "paper"])
def test_methods_whose_motions_begin_with_a_step_avoid_it_where_the_jerk_is_limited(method):
    scene = Scene.from_dict(scene_data(solved("wide").scene) | {"limits": {"jerk": 5.0}})
    solution = comove.solve(scene, seed=0, method=method)
    assert solution.verified and solution.report.jerk_max <= 5.0
    step = np.linalg.norm(solution.attempt.hands([0.0, 1.0])[2], axis=2).max()
    assert step < 1e-9


# --- VerifiedMotion ---


def test_a_verified_motion_cannot_be_made_by_hand():
    verified = solved("wide").motion
    for seal in ({}, {"seal": None}, {"seal": object()}, {"seal": True}):
        with pytest.raises(TypeError, match="verify"):
            VerifiedMotion(verified.motion, verified.report, **seal)


def test_a_verified_motion_cannot_be_changed():
    verified = solved("wide").motion
    for name in ("motion", "report", "clearance_min", "anything"):
        with pytest.raises(AttributeError):
            setattr(verified, name, None)
    with pytest.raises(AttributeError):
        verified.report.clearance_min = 1.0
    with pytest.raises(AttributeError):
        verified.motion.weights = None


def test_nothing_of_a_verified_motion_can_be_deleted(motion):
    verified = verify(motion).verified
    with pytest.raises(AttributeError):
        del verified.report


@pytest.mark.parametrize("name", ["weights", "boundary", "knots"])
def test_the_arrays_of_a_verified_motion_cannot_be_changed(motion, name):
    verified = verify(
        replace(motion, weights=motion.weights.copy(), boundary=motion.boundary.copy())
    ).verified
    with pytest.raises(ValueError, match="read-only"):
        getattr(verified.motion, name)[0] = 0.0


def test_a_verified_motion_says_what_was_measured(motion):
    verdict = verify(motion)
    assert verdict.reasons == ()
    assert verdict.verified.motion is motion
    assert verdict.verified.report is verdict.report
    assert verdict.verified.clearance_min == verdict.report.clearance_min > 0
    trajectory = verdict.verified.trajectory()
    assert np.diff(trajectory.time).max() <= 0.01 + 1e-12
    assert trajectory.time[-1] == motion.scene.duration
    assert np.array_equal(verdict.verified.trajectory(50).position, motion.hands(np.linspace(0, 1, 50))[0])


# --- Reasons ---


@pytest.mark.parametrize("row", [0, 2])
@pytest.mark.parametrize("miss", [2e-9, 1e-6, 1e-2])
def test_a_missed_end(motion, row, miss):
    boundary = motion.boundary.copy()
    boundary[row, 0] += miss
    reason = the_reason(replace(motion, boundary=boundary), "end is missed by")
    assert float(reason.split()[-2]) == pytest.approx(miss, rel=0.01)
    boundary[row, 0] -= miss - 5e-10
    assert verify(replace(motion, boundary=boundary)).verified


@pytest.mark.parametrize("speed", [1e-7, 1e-3])
def test_a_speed_at_the_end(motion, speed):
    boundary = motion.boundary.copy()
    boundary[3, 0] = speed * motion.scene.duration
    reason = the_reason(replace(motion, boundary=boundary), "still moves")
    assert float(reason.split()[5]) == pytest.approx(speed, rel=0.01)


def test_a_whole_turn_more_is_the_same_goal(motion):
    boundary = motion.boundary.copy()
    boundary[2, 2] += 2 * np.pi
    verdict = verify(replace(motion, boundary=boundary))
    assert verdict.report.end_error < 1e-12


def test_limits_of_speed_and_acceleration(motion):
    speed, acceleration = dense(motion)
    assert verify(limited(motion, speed=1.003 * speed)).verified
    the_reason(limited(motion, speed=0.999 * speed), "m/s (limit")
    assert verify(limited(motion, acceleration=1.03 * acceleration)).verified
    the_reason(limited(motion, acceleration=0.999 * acceleration), "m/s^2 (limit")


def test_half_the_duration_is_twice_the_speed(motion):
    data = scene_data(motion.scene)
    fast = on_scene(motion, data | {"duration": motion.scene.duration / 2})
    slow, quick = verify(motion).report, verify(fast).report
    assert quick.speed_max == pytest.approx(2 * slow.speed_max, rel=1e-9)
    assert quick.acceleration_max == pytest.approx(4 * slow.acceleration_max, rel=1e-9)
    assert quick.clearance_min == slow.clearance_min


def test_contact(motion):
    data = scene_data(motion.scene)
    obstacles = [*data["obstacles"], {"shape": "circle", "center": [0.5, 0.5], "radius": 0.01}]
    touching = on_scene(motion, data | {"obstacles": obstacles})
    reason = the_reason(touching, "reaches", "m or more into obstacles[2] (sphere) at ", " s")
    when = float(reason.split()[-2]) / touching.scene.duration
    hands = touching.hands([when])[0][0]
    middle = hands.mean(axis=0)
    assert np.linalg.norm(middle - 0.5) < 0.12  # the bar is there at that time


def test_the_border(motion):
    middle = motion.hands(np.linspace(0, 1, 4001))[0]
    low = middle[..., 1].min()
    data = scene_data(motion.scene)
    inside = data | {"workspace": {"lower": [0.0, low - 1e-3], "upper": [1.0, 1.0]}}
    assert verify(on_scene(motion, inside)).verified
    outside = data | {"workspace": {"lower": [0.0, low + 1e-3], "upper": [1.0, 1.0]}}
    if low + 1e-3 < min(motion.scene.start[:, 1].min(), motion.scene.goal[:, 1].min()):
        the_reason(on_scene(motion, outside), "into the border of the workspace")


def test_a_clearance_that_is_asked_for(motion):
    clearance = verify(motion).report.clearance_min
    assert verify(limited(motion, clearance=0.5 * clearance)).verified
    the_reason(limited(motion, clearance=clearance + 1e-3), "only ", "asked for")


def test_a_distance(motion):
    """Coordinates with grasps that are off by half a millimetre, more than the tolerance, or by a tenth of it."""
    for stretch, within in ((1.0025, False), (1.0004, True)):
        blocks = motion.coordinates.blocks
        stretched = blocks._replace(point=blocks.point * stretch)
        off = replace(motion, coordinates=replace(motion.coordinates, blocks=stretched))
        told = [reason for reason in verify(off).reasons if "distance" in reason]
        if within:
            assert told == []
        else:
            assert told == [
                "the distance between 'left' and 'right' is off by up to 0.0005 m (tolerance 0.0002 m)"
            ]
        assert verify(off).verified is None  # such coordinates are not those of the scene


def test_coordinates_that_are_changed_where_they_lie_are_not_those_of_the_scene(motion):
    """They may be what a search keeps for the scene; the ends of its bar, beyond the hands, shrink here."""
    data = scene_data(motion.scene)
    scene = Scene.from_dict(data | {"load": data["load"] | {"overhang": 0.05}})
    own = replace(motion, scene=scene, coordinates=load_coordinates(scene))
    assert not any("coordinates" in reason for reason in verify(own).reasons)
    own.coordinates.blocks.point[len(scene.manipulators) :] *= 0.9
    assert verify(own).verified is None
    assert any("coordinates" in reason for reason in verify(own).reasons)


def test_the_load_is_that_of_the_scene(motion):
    """A motion made for a bar says nothing of a longer one, whatever coordinates it carries."""
    data = scene_data(motion.scene)
    longer = Scene.from_dict(data | {"load": data["load"] | {"overhang": 0.05}})
    shorter = Scene.from_dict(data | {"load": data["load"] | {"overhang": 0.001}})
    verdict = verify(replace(motion, scene=longer, coordinates=load_coordinates(shorter)))
    honest = verify(replace(motion, scene=longer, coordinates=load_coordinates(longer)))
    assert verdict.verified is None or verdict.report.clearance_min <= honest.report.clearance_min + 1e-4


def test_free_hands_do_not_hold_a_distance(motion):
    data = scene_data(motion.scene) | {"load": None}
    free = Scene.from_dict(data)
    tied = Scene.from_dict(
        data | {"constraints": [{"type": "distance", "between": ["left", "right"], "distance": 0.2}]}
    )
    coordinates = load_coordinates(free)
    weights = np.zeros((coordinates.n_columns, motion.basis.n_basis))
    weights[0, 0] = 0.3
    hands = replace(
        motion, scene=tied, coordinates=coordinates, boundary=coordinates.boundary(), weights=weights
    )
    assert any("the distance between" in reason for reason in verify(hands).reasons)


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_what_is_not_finite_is_rejected(motion, bad):
    weights = motion.weights.copy()
    weights[1, 2] = bad
    with np.errstate(all="ignore"):
        verdict = verify(replace(motion, weights=weights))
    assert verdict.verified is None
    assert "the motion is not finite" in verdict.reasons


# --- Further checks ---


def test_further_checks_are_asked(motion):
    asked = []

    def passes(candidate):
        asked.append(candidate)
        return []

    assert verify(motion, [passes, passes]).verified
    assert asked == [motion, motion]
    verdict = verify(motion, [passes, lambda _: ["the elbow hits the table", "too hot"], passes])
    assert verdict.verified is None
    assert verdict.reasons == ("the elbow hits the table", "too hot")
    assert len(asked) == 4


def test_checks_of_verified_motions_take_them_so_where_they_keep_what_the_scene_asks(motion):
    """And only there: else the motion itself, which is not verified."""
    given, slow = [], limited(motion, speed=0.01)
    for moved in (motion, slow):
        verify(moved, checks=[CheckOfVerified(lambda taken: given.append(taken) or [])])
    assert isinstance(given[0], VerifiedMotion) and given[0].motion is motion
    assert given[1] is slow
    assert verify(motion, checks=[CheckOfVerified(lambda taken: "too blue")]).reasons == ("too blue",)


def test_reasons_of_checks_come_on_top(motion):
    slow = limited(motion, speed=0.1)
    assert len(verify(slow, [lambda _: ["no"]]).reasons) == 2


# --- Bounds ---


@pytest.mark.parametrize("name", SOLVED)
def test_bounds_of_solutions_are_true_and_tight(name):
    solution = solved(name)
    speed, acceleration = dense(solution.attempt)
    assert speed <= solution.report.speed_max <= 1.05 * speed
    assert acceleration <= solution.report.acceleration_max


@examples(30)
@given(seeds)
def test_bounds_are_true_and_tight_where_a_limit_asks(seed):
    motion = random_motion(np.random.default_rng(seed))
    speed, acceleration = dense(motion, 4001)
    loose = verify(motion).report
    assert speed <= loose.speed_max * (1 + 1e-12)
    assert acceleration <= loose.acceleration_max * (1 + 1e-12)
    tight = verify(limited(motion, acceleration=1.001 * acceleration)).report
    assert acceleration <= tight.acceleration_max * (1 + 1e-12)
    assert tight.acceleration_max <= 1.05 * acceleration


@examples(40)
@given(seeds)
def test_the_jerk_is_bounded(seed):
    """Third derivatives of all nodes, from differences of exact accelerations within every interval."""
    motion = random_motion(np.random.default_rng(seed))
    s = (np.arange(800)[:, None] + np.array([0.25, 0.75])).ravel() / 800
    acceleration = motion.coordinates.motion(motion.at(s))[2].reshape(800, 2, -1, 3)
    change = np.linalg.norm(acceleration[:, 1] - acceleration[:, 0], axis=-1) / (0.5 / 800)
    bound = node_bounds(motion).jerk
    assert (change <= bound * (1 + 1e-6) + 1e-6).all()


@examples(30)
@given(seeds)
def test_distances_and_ends_are_exact(seed):
    """Whatever the weights: constraints hold to rounding at knots and between, ends to 1e-9 m."""
    motion = random_motion(np.random.default_rng(seed))
    report = verify(motion).report
    assert report.end_error < 1e-9
    assert report.end_speed < 1e-9
    assert report.distance_error_max < 1e-12
    hands = motion.hands(np.random.default_rng(seed).random(200))[0]
    for c in motion.scene.distances:
        apart = np.linalg.norm(hands[:, c.first] - hands[:, c.second], axis=1)
        assert np.abs(apart - c.distance).max() < 1e-12


# --- Free hands ---


@examples(60)
@given(seeds, st.sampled_from([2, 3]))
def test_the_distance_of_free_hands_is_bounded_at_every_instant(seed, n_dims):
    """Above what dense samples show, by next to nothing unless the hands nearly meet."""
    rng = np.random.default_rng(seed)
    motion = random_motion(rng, n_dims=n_dims, load="pairs", sigma=0.01, arms=True)
    hands = motion.hands(np.linspace(0.0, 1.0, 30_001))[0]
    apart = [np.linalg.norm(hands[:, c.first] - hands[:, c.second], axis=1) for c in motion.scene.distances]
    seen = max(np.abs(d - c.distance).max() for d, c in zip(apart, motion.scene.distances, strict=True))
    verdict = verify(motion)
    assert seen <= verdict.report.distance_error_max
    if min(d.min() for d in apart) > 0.01:
        assert verdict.report.distance_error_max <= seen + 1e-3 * max(seen, 0.01)
    rejected = any("distance between" in reason for reason in verdict.reasons)
    assert rejected == (verdict.report.distance_error_max > min(c.tolerance for c in motion.scene.distances))


@examples(6)
@given(seeds, st.sampled_from([2, 3]))
def test_the_clearance_of_free_hands_is_certified_below_what_is_there(seed, n_dims):
    rng = np.random.default_rng(seed)
    motion = random_motion(rng, n_dims=n_dims, load="frame", sigma=0.01, arms=True)
    ball = {"shape": "sphere", "center": [float(x) for x in rng.uniform(-1, 1, n_dims)], "radius": 0.1}
    try:
        motion = on_scene(motion, scene_data(motion.scene) | {"obstacles": [ball]})
    except SceneError:  # an end is in contact
        return
    report = verify(motion).report
    actual = brute_force.configuration_clearance(
        motion.scene, motion.hands(np.linspace(0.0, 1.0, 3001))[0]
    ).min()
    assert report.clearance_min <= actual + 1e-9


def test_only_motions_are_judged_and_a_check_may_say_one_sentence():
    for wrong in (None, solved("narrow").motion, solved("narrow").trajectory):
        with pytest.raises(OptionError, match="CoordinatedMotion"):
            verify(wrong)
    verdict = verify(solved("narrow").attempt, checks=[lambda motion: "too blue"])
    assert verdict.reasons == ("too blue",)
