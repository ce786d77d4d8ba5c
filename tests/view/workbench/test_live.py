"""A run whose obstacles are led by hand: what is led moves as a body can, the load dodges, the record is judged."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import comove
from comove.control import Pace
from comove.errors import OptionError
from comove.io.folders import whole_folder
from comove.results import RESULT
from comove.verification.record import verify_execution
from comove.view.workbench import live
from comove.view.workbench.edits import contents_of
from comove.view.workbench.live import Led, LedObstacles, LiveSettings, run_live, save_run
from comove.view.workbench.playback import playback_of
from tests.cases import examples
from tests.solved import example

places = st.lists(
    st.tuples(st.floats(0.0, 1.0), st.floats(0.0, 1.0), st.integers(1, 40)), min_size=1, max_size=8
)


@examples(30)
@given(places, st.integers(0, 50))
def test_what_is_led_goes_no_faster_than_it_may_and_ends_where_it_is_led(targets, since):
    led = Led(np.array([0.5, 0.5, 0.0]), 0.01 * since, 0.4)
    clock, seen = since, []
    for x, y, steps in targets:
        led.target = np.array([x, y, 0.0])
        for _ in range(steps):
            clock += 1
            led.go_on(0.01 * clock)
            seen.append((0.01 * clock, led.places[-1]))
    for time, place in seen:
        np.testing.assert_allclose(led.at(time), place, atol=1e-9)
    times, way = np.array(led.times), np.array(led.places)
    assert (np.diff(times) > 0).all()
    speed = np.linalg.norm(np.diff(way, axis=0), axis=1) / np.diff(times)
    assert speed.max(initial=0.0) <= 0.4 * (1 + 1e-6) + LiveSettings().near / 0.01
    for _ in range(500):
        clock += 1
        led.go_on(0.01 * clock)
    np.testing.assert_allclose(led.places[-1], led.target, atol=1e-12)


def test_the_scene_of_a_run_moves_as_was_led():
    scene = example("narrow")
    observer = LedObstacles(scene)
    observer.lead(1, [0.7, 0.8, 0.3], 0.2)
    for step in range(21, 300):
        observer.go_on(0.01 * step)
    executed = comove.Scene.from_dict(observer.contents(contents_of(scene)))
    time = np.linspace(0.0, 2.9, 173)
    np.testing.assert_allclose(
        executed.centers + executed.offsets(time), observer.ground_truth(time), atol=1e-9
    )
    np.testing.assert_allclose(observer.ground_truth(time)[-1, 1], [0.7, 0.8, 0.0], atol=1e-9)


@pytest.mark.parametrize(
    ("obstacle", "place"),
    [(7, [0, 0, 0]), (-1, [0, 0, 0]), ("0", [0, 0, 0]), (0, [0, 0]), (0, [0, np.nan, 0])],
)
def test_what_cannot_be_led_is_told(obstacle, place):
    with pytest.raises(OptionError, match="cannot be led"):
        LedObstacles(example("narrow")).lead(obstacle, place, 0.0)


OPEN = {
    "name": "open",
    "duration": 3.0,
    "workspace": {"lower": [0, 0], "upper": [1, 1]},
    "obstacles": [{"shape": "circle", "center": [0.5, 0.9], "radius": 0.05}],
    "load": {"shape": "bar", "length": 0.2},
    "manipulators": [
        {"name": "left", "start": [0.15, 0.4], "goal": [0.85, 0.4]},
        {"name": "right", "start": [0.15, 0.6], "goal": [0.85, 0.6]},
    ],
    "limits": {"speed": 0.8, "acceleration": 4.0, "clearance": 0.005},
}


def led_run(lead, monkeypatch, plan=None):
    """A run on a clock of its own, so that nothing hangs on the machine's; `lead` by the number of states."""
    monkeypatch.setattr(live.clock, "sleep", lambda seconds: None)
    patient = LiveSettings(pace=Pace(leisure=60.0, haste=60.0))
    scene, states = comove.Scene.from_dict(OPEN), []
    run = run_live(
        scene,
        contents_of(scene),
        demonstration=None,
        seed=0,
        plan=plan,
        leads=lambda: lead(len(states)),
        tell=states.append,
        stop=lambda: len(states) > 500,
        settings=patient,
    )
    return run, states


def test_the_motion_that_is_shown_is_followed(monkeypatch):
    motion = comove.solve(comove.Scene.from_dict(OPEN), seed=0, budget=2.0).motion
    run, _ = led_run(lambda n: {}, monkeypatch, motion)
    planned = motion.motion.hands(np.minimum(run.record.time / 3.0, 1.0))[0][..., :2]
    assert np.abs(run.record.position - planned).max() < 0.02, (
        "as limits between steps are kept, not to the letter"
    )
    other = comove.Scene.from_dict(OPEN | {"duration": 4.0})
    with pytest.raises(OptionError, match="another scene"):
        live.Executor(other, plan=motion)


def test_the_load_dodges_what_is_led_into_its_way(monkeypatch, tmp_path):
    free, _ = led_run(lambda n: {}, monkeypatch)
    run, states = led_run(lambda n: {0: [0.5, 0.5, 0.0]} if n > 8 else {}, monkeypatch)
    report = verify_execution(run.record)
    assert not report.reasons
    assert report.clearance_min >= 0.005
    disc = run.record.obstacles[:, 0, :2]
    assert np.linalg.norm(disc[-1] - [0.5, 0.5]) < 0.02, "it was led into the way"
    middle = run.record.position.mean(axis=1)
    assert (
        np.abs(middle[:, 1] - 0.5).max() > np.abs(free.record.position.mean(axis=1)[:, 1] - 0.5).max() + 0.03
    )
    for state in states:
        step = np.searchsorted(run.record.time, state.time - 1e-9)
        np.testing.assert_allclose(state.nodes, run.record.nodes[step], atol=1e-12)
        np.testing.assert_allclose(
            state.offsets, (run.record.obstacles - run.record.scene.centers)[step], atol=1e-9
        )
    with whole_folder(tmp_path / "run", RESULT) as draft:
        save_run(run, draft, seed=0)
    again = playback_of(tmp_path / "run")
    assert again.holds and again.verdict.startswith("executed")
