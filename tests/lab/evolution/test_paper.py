"""The paper's method: bands, windows, schedules, and motions that the judge accepts."""

import numpy as np
import pytest

import comove
from comove.errors import OptionError
from comove.lab.evolution import Paper
from comove.lab.evolution.paper import window_errors
from comove.model import Scene, arms_coordinates, recording_of
from comove.planning.objective import N_STEPS
from comove.planning.search import OutOfTime, Search
from tests import brute_force
from tests.solved import example
from tests.verification.random_motions import scene_data


@pytest.fixture(scope="module")
def wide():
    """The wide example by the paper's method."""
    return comove.solve(example("wide"), method=Paper(), seed=1)


def test_a_verified_motion_within_the_band(wide):
    assert wide.verified
    scene = example("wide")
    tolerance = scene.constraints[0].tolerance
    assert 1e-12 < wide.report.distance_error_max <= tolerance
    hands = wide.motion.motion.hands(np.linspace(0.0, 1.0, 20_001))[0]
    error = np.abs(np.linalg.norm(hands[:, 0] - hands[:, 1], axis=1) - scene.constraints[0].distance)
    assert error.max() <= wide.report.distance_error_max


def test_the_same_seed_is_the_same_motion(wide):
    again = comove.solve(example("wide"), method=Paper(), seed=1)
    assert np.array_equal(again.attempt.weights, wide.attempt.weights)


def test_the_planner_is_never_asked(monkeypatch):
    def planned(*_, **__):
        raise AssertionError("planned")

    monkeypatch.setattr("comove.planning.kinematics.plan", planned)
    monkeypatch.setattr(Search, "over", lambda search: search.journal.generations >= 10)
    comove.solve(example("wide"), method=Paper(), seed=0)


def test_every_window_holds_the_largest_error_of_either_sign():
    """Against a loop over windows and samples."""
    scene = example("narrow")
    rng = np.random.default_rng(0)
    q = rng.standard_normal((5, 2 * scene.n_dims, N_STEPS))
    errors = window_errors(scene, q, 7)
    assert errors.shape == (5, 2 * 7)
    starts = [*(int(k * N_STEPS / 7) for k in range(7)), N_STEPS]
    for k in range(5):
        for w in range(7):
            span = range(starts[w], starts[w + 1])
            apart = [np.hypot(*(q[k, :2, t] - q[k, 2:, t])) - scene.constraints[0].distance for t in span]
            assert errors[k, w] == pytest.approx(max(apart))
            assert errors[k, 7 + w] == pytest.approx(-min(apart))


@pytest.mark.parametrize("least", [0.0, 0.1])
def test_bands_narrow_to_less_than_the_tolerance(least):
    scene, method = example("narrow"), Paper()
    widths = [method._bands(scene, progress, least)[0] for progress in np.linspace(0.0, 1.0, 11)]
    assert (np.diff(widths) <= 0).all()
    assert widths[0] >= least
    assert 0 < widths[-1] < scene.constraints[0].tolerance


def test_what_there_is_when_time_runs_out_is_judged_and_labelled(monkeypatch):
    monkeypatch.setattr(Search, "over", lambda search: search.journal.generations >= 30)
    solution = comove.solve(example("complex"), method=Paper())
    assert not solution.verified
    assert solution.attempt.coordinates.kind == "arms"
    assert solution.effort.generations == 30
    assert solution.attempt.weights.any()
    assert any("distance between" in reason or "reaches" in reason for reason in solution.reasons)


def test_loads_beyond_the_hands_are_refused():
    bar = {"shape": "bar", "length": 0.2, "overhang": 0.05}
    scene = Scene.from_dict(scene_data(example("wide")) | {"load": bar, "demonstration": None})
    with pytest.raises(OptionError, match="free hands"):
        comove.solve(scene, method=Paper(), budget=1.0)


def test_hands_that_nothing_ties_are_refused():
    scene = Scene.from_dict(scene_data(example("wide")) | {"load": None, "demonstration": None})
    with pytest.raises(OptionError, match="no distance ties"):
        comove.solve(scene, method=Paper(), budget=1.0)


def test_growing_draws_the_hands_together():
    """About the middle, by the size, without changing what q says."""
    coordinates = arms_coordinates(example("narrow"))
    q = np.random.default_rng(0).standard_normal((3, coordinates.n_columns, 4))
    full, small = coordinates.nodes(q), coordinates.nodes(q, 0.25)
    assert np.array_equal(full[0, :, 0, :2], q[0, :2].T)
    assert np.array_equal(full[0, :, 1, :2], q[0, 2:].T)
    middle = full.mean(axis=2)
    assert small.mean(axis=2) == pytest.approx(middle)
    assert small - middle[:, :, None] == pytest.approx(0.25 * (full - middle[:, :, None]))


def test_the_judge_sees_what_brute_force_sees(wide):
    scene, trajectory = example("wide"), wide.motion.trajectory(4001)
    assert (
        brute_force.configuration_clearance(scene, trajectory.position).min()
        >= wide.report.clearance_min - 1e-9
    )


@pytest.mark.parametrize(("taught", "starts"), [(True, [0, 0, 0, 0]), (False, [0, 1, 2, 3])])
def test_every_attempt_begins_with_the_demonstration(monkeypatch, taught, starts):
    """Where there is one: a run that fails is repeated with other random numbers, not with another movement."""
    seen = []

    def guessed(search, coordinates, basis, restart):
        seen.append(restart)
        if len(seen) == len(starts):
            raise OutOfTime

    monkeypatch.setattr("comove.lab.evolution.paper.first_guess", guessed)
    monkeypatch.setattr("comove.lab.evolution.paper.threaded", lambda *_: None)
    scene = example("complex")
    comove.solve(scene, demonstration=comove.DMP.fit(recording_of(scene)) if taught else None, method=Paper())
    assert seen == starts


@pytest.mark.slow
@pytest.mark.parametrize("name", ["wide", "narrow", "complex"])
@pytest.mark.parametrize("seed", range(3))
def test_from_a_demonstration_within_a_hundred_thousand_rollouts(name, seed):
    scene = example(name)
    taught = comove.DMP.fit(recording_of(scene)) if recording_of(scene) else None
    solution = comove.solve(scene, demonstration=taught, method=Paper(), seed=seed, budget=120.0)
    assert solution.verified
    assert solution.effort.evaluations <= 100_000
    assert solution.report.distance_error_max <= 1e-3 * scene.constraints[0].distance
