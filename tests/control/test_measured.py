"""Obstacles that are measured: filters know what they do not know."""

import numpy as np
import pytest

from benchmarks.random_scenes import moving_scene
from comove.control import Executor, Known, Measured, Observed, Sensor
from comove.errors import OptionError
from comove.verification.record import verify_execution
from tests.control.test_executor import crossing, disc

STEADY = crossing(disc([0.9, 0.9], {"velocity": [-0.2, -0.1]}))
ZIGZAG = crossing(
    disc(
        [0.9, 0.9],
        {
            "waypoints": [[0.9, 0.9], [0.8, 0.9], [0.8, 0.8], [0.7, 0.8], [0.7, 0.7], [0.6, 0.7]],
            "times": [0.0, 0.4, 0.8, 1.2, 1.6, 2.0],
        },
    )
)


def tracked(sensor, seed, scene=STEADY, until=2.0):
    """Errors [m] and margins [m] of what is believed, every 10 ms."""
    observer, truth = Measured(Known(scene), scene, sensor, np.random.default_rng(seed)), Known(scene)
    errors, margins = [], []
    for time in np.arange(0.0, until, 0.01):
        seen = observer.observe(time)
        errors.append(np.linalg.norm(seen.table[0, 1:4] - truth.observe(time).table[0, 1:4]))
        margins.append(seen.margin[0])
    return np.array(errors), np.array(margins)


@pytest.mark.parametrize(
    "sensor", [Sensor(), Sensor(dropout=0.3), Sensor(delay=0.2), Sensor(noise=0.05, delay=0.0)]
)
@pytest.mark.few(1)
def test_margins_cover_what_is_not_known(sensor):
    both = [tracked(sensor, seed) for seed in range(10)]
    errors, margins = (np.concatenate(x) for x in zip(*both, strict=True))
    assert (errors <= margins).mean() > 0.995
    sudden = [tracked(sensor, seed, ZIGZAG) for seed in range(10)]
    errors, margins = (np.concatenate(x) for x in zip(*sudden, strict=True))
    assert (errors <= margins).mean() > 0.99, "turns by a right angle every 0.4 s"
    assert np.median(margins) < 10 * np.median(errors), "and are no excuse"


def test_a_constant_velocity_is_learned():
    errors, _ = tracked(Sensor(noise=1e-4, delay=0.0, agility=1e-6), 0)
    assert errors[-50:].max() < 2e-4


def test_margins_grow_while_nothing_is_seen():
    observer = Observed(STEADY)
    for k in range(20):
        observer.update(0, [0.9 - 0.002 * k, 0.9], 0.01 * k)
    margins = [observer.observe(t).margin[0] for t in (0.2, 0.3, 0.5, 1.0)]
    assert (np.diff(margins) > 0).all()
    assert observer.observe(0.5).table[0, 1] == pytest.approx(0.9 - 0.2 * 0.5, abs=0.01)
    assert np.isnan(observer.ground_truth(np.array([0.0]))[0, 0]).all()


def test_what_stands_needs_less_of_a_margin_until_it_starts():
    way = {"waypoints": [[0.9, 0.9], [0.7, 0.9], [0.7, 0.9], [0.5, 0.9]], "times": [0.0, 1.0, 3.0, 3.5]}
    _, margins = tracked(Sensor(), 0, crossing(disc([0.9, 0.9], way)), until=3.4)
    moving, standing, started = margins[80:100].max(), margins[250:300].max(), margins[320:330].max()
    assert standing < 0.6 * moving
    assert started > 0.9 * moving, "0.2 s after it has started"


def test_what_has_never_been_seen_may_be_anywhere():
    assert Observed(STEADY).observe(0.0).margin[0] == pytest.approx(Sensor().sigmas * Sensor().unseen)


def test_what_stands_needs_no_measurements():
    scene = crossing({"shape": "circle", "center": [0.5, 0.9], "radius": 0.05})
    seen = Observed(scene).observe(1.0)
    assert not seen.margin.any()
    np.testing.assert_array_equal(seen.table, scene.obstacles)


@pytest.mark.parametrize(
    ("observation", "words"),
    [
        ((1, [0.5, 0.5], 1.0), "there is no obstacle 1"),
        ((0, [0.5, float("nan")], 1.0), r"the measurement of .* is \[0.5, nan\]"),
        ((0, [0.5, 0.5, 0.5], 1.0), "give 2 finite numbers"),
        ((0, [0.5, 0.5], 0.2), "does not come after the one at 0.2 s"),
        ((0, [0.5, 0.5], float("nan")), "does not come after"),
    ],
)
def test_measurements_that_are_none(observation, words):
    observer = Observed(STEADY)
    observer.update(0, [0.9, 0.9], 0.2)
    before = observer.observe(0.3)
    with pytest.raises(OptionError, match=words):
        observer.update(*observation)
    np.testing.assert_array_equal(observer.observe(0.3).table, before.table)


@pytest.mark.parametrize(
    "wrong", [{"noise": 0.0}, {"noise": 1e-300}, {"delay": -1}, {"dropout": 1.0}, {"agility": float("inf")}]
)
def test_sensors_that_are_none(wrong):
    with pytest.raises(OptionError, match=f"{next(iter(wrong))} = "):
        Sensor(**wrong)


@pytest.mark.parametrize("seed", [0, 1])
@pytest.mark.few(1)
def test_a_load_is_carried_by_measurements_alone(seed):
    scene = moving_scene(seed)
    observer = Measured(Known(scene), scene, Sensor(dropout=0.1), np.random.default_rng(seed))
    report = verify_execution(Executor(scene, observer).run(3 * scene.duration))
    assert report.clearance_min >= 0
    assert report.distance_error_max <= 1e-9
