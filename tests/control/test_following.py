"""Executions follow what was taught, from the start and after every plan that is made anew, and move calmly."""

import numpy as np
import pytest

from comove.control import Executor
from comove.dmp import DMP
from comove.dmp.demonstrations import Demonstration
from comove.model import Scene, demonstration_of
from comove.planning import carried_demonstration
from comove.verification.record import verify_execution
from tests.solved import EXAMPLES, example


def distance(record, scene, dmp):
    """Mean distance of the hands from the demonstration at equal shares of the scene's time [m]."""
    taught = carried_demonstration(dmp, scene)[..., : scene.n_dims]
    hands = record.nodes[:, : len(scene.manipulators), : scene.n_dims]
    share = np.clip(record.time / scene.duration, 0, 1) * (len(taught) - 1)
    there = np.stack([taught[np.round(share).astype(int), i] for i in range(taught.shape[1])], axis=1)
    return np.linalg.norm(hands - there, axis=2).mean()


def test_the_demonstration_is_followed():
    scene = example("narrow")
    found = {}
    for name, dmp in (("taught", demonstration_of(scene)), ("free", None)):
        executor = Executor(scene, demonstration=dmp)
        record = executor.run(15.0)
        report = verify_execution(record, executor.blocker)
        assert not report.reasons
        assert report.acceleration_max < 0.5
        found[name] = distance(record, scene, demonstration_of(scene))
    assert found["taught"] < 0.03 < 0.08 < found["free"]


@pytest.mark.parametrize("share", [0.2, 0.5])
def test_what_is_left_of_it_ends_where_all_of_it_does(share):
    scene = example("narrow")
    executor = Executor(scene, demonstration=demonstration_of(scene))
    left, _ = executor.replanner.remaining(scene, share * scene.duration).values()
    whole = demonstration_of(scene)
    assert left.duration == pytest.approx((1 - share) * whole.duration)
    np.testing.assert_allclose(left.goal, whole.goal, atol=1e-9)
    s = np.linspace(0.05, 1.0, 50)
    rest = whole.at((share + (1 - share) * s) * whole.duration).position
    off = np.linalg.norm(left.at(s * left.duration).position - rest, axis=1)
    assert off.max() < 0.02 * np.ptp(whole.at(np.linspace(0, whole.duration, 50)).position, axis=0).max()


def test_each_hand_keeps_what_is_left_of_its_own():
    scene = example("narrow")
    executor = Executor(scene, demonstration=(demonstration_of(scene), demonstration_of(scene)))
    left = list(executor.replanner.remaining(scene, 0.3 * scene.duration).values())
    assert len(left) == 2
    assert left[0].duration == left[1].duration


def test_nearly_done_nothing_is_left():
    scene = example("narrow")
    assert (
        Executor(scene, demonstration=demonstration_of(scene)).replanner.remaining(
            scene, 0.9 * scene.duration
        )
        is None
    )


def test_plans_among_what_moves_are_calm():
    """With the paper's cost it was 1.5 m/s^2."""
    scene = Scene.load(str(EXAMPLES.joinpath("..", "..", "..", "examples", "moving", "crossing.yaml")))
    executor = Executor(scene)
    report = verify_execution(executor.run(10.0), executor.blocker)
    assert not report.reasons
    assert report.acceleration_max < 0.5


def test_what_is_left_of_a_movement_of_many_weights_is_all_there():
    """A wave twenty times as quick as its way, which the usual number of weights cannot follow."""
    scene, t = example("narrow"), np.linspace(0.0, 1.0, 2001)
    way = t**3 * (10 - 15 * t + 6 * t**2)
    wave = Demonstration(20 * t, np.stack([way, 0.1 * np.sin(40 * np.pi * way)], axis=1))
    whole = DMP.fit(wave, n_basis=120)
    left, _ = Executor(scene, demonstration=whole).replanner.remaining(scene, 0.3 * scene.duration).values()
    s = np.linspace(0.0, 1.0, 200)
    rest = whole.at((0.3 + 0.7 * s) * whole.duration).position
    assert np.linalg.norm(left.at(s * left.duration).position - rest, axis=1).max() < 0.01
