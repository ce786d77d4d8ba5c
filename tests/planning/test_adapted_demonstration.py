"""A demonstration that is magnified, or leaves the workspace, at the scene's ends is told of once, with advice."""

import re
import warnings
from ast import literal_eval

import numpy as np
import pytest

import comove
from comove import DMP, Demonstration
from comove.control import Executor
from comove.dmp import ProMP
from comove.dmp.operations import scale
from comove.dmp.variants import APART, extent_of
from comove.errors import ComoveWarning
from comove.lab.evolution import combine
from comove.planning import best_movement, carried_demonstration, movements_of
from comove.planning.arguments import warn_of_adaptation
from tests.solved import example

S = np.linspace(0.0, 1.0, 201)
FACTOR = 1.3 / APART  # of the scene's displacement, beyond which no adapted demonstration spans


def loop(gap, size=1.0):
    """The movement out and back, with ends `gap` apart along x."""
    x, y = 0.14 * (1 - np.cos(2 * np.pi * S)) + gap * S, 0.05 * np.sin(2 * np.pi * S)
    return Demonstration(5 * S, size * np.stack([x, y], axis=1), "loop", unit="any")


def told(action):
    """Return what was warned of."""
    with warnings.catch_warnings(record=True) as found:
        warnings.simplefilter("always")
        action()
    return [str(w.message) for w in found if issubclass(w.category, ComoveWarning)]


def said_of(demonstration, scene):
    return told(lambda: warn_of_adaptation(movements_of(demonstration, scene), scene))


@pytest.mark.parametrize("gap", [0.0, 1e-9, 1e-4, 1e-3, 0.01, 0.05, 0.1, 0.3])
def test_the_solver_follows_a_demonstration_of_bounded_size(gap):
    scene, shown = example("narrow"), loop(gap)
    hands = carried_demonstration(movements_of(shown, scene), scene)[..., :2]
    assert np.abs(hands[[0, -1]] - [scene.start, scene.goal]).max() < 1e-12
    for i in range(2):
        way = np.linalg.norm(scene.goal[i] - scene.start[i])
        assert extent_of(hands[:, i]) < FACTOR * max(0.28, way)
        if gap <= 0.01:  # closed, as well as a person closes a movement
            assert extent_of(hands[:, i]) < 1.1 * way


def test_a_folder_of_recordings_that_nearly_close_is_bounded():
    rng, scene = np.random.default_rng(0), example("narrow")
    shown = []
    for gap in 1e-3 * rng.standard_normal((5, 2)):
        bend = 0.01 * rng.standard_normal() * np.sin(np.pi * S) ** 2
        position = loop(0.0).position + np.outer(S, gap) + np.outer(bend, [1.0, 1.0])
        shown.append(Demonstration(5 * S, position, unit="any"))
    hands = carried_demonstration(movements_of(ProMP.fit(shown), scene), scene)[..., :2]
    assert np.ptp(hands, axis=0).max() < 0.8


def test_what_is_magnified_is_told_with_ends_that_are_far_enough():
    scene = example("narrow")
    (said,) = said_of(loop(0.1), scene)
    assert "magnified 7 times for '" in said and "from 0.33 m to 2.3 m" in said
    least = float(re.search(r"ends at least ([\d.]+) m apart, or one that ends where it starts", said)[1])
    for gap in (least, 0.0):
        assert not any("magnified" in other for other in said_of(loop(gap), scene))
    assert any("magnified" in other for other in said_of(loop(0.9 * least), scene))


def test_what_leaves_the_workspace_is_told_with_one_that_holds_it():
    scene = example("narrow")
    (said,) = said_of(loop(0.3), scene)
    hands = carried_demonstration(movements_of(loop(0.3), scene), scene)[..., :2]
    outside = max((scene.lower - hands.min((0, 1))).max(), (hands.max((0, 1)) - scene.upper).max())
    assert f"leaves the workspace by {outside:.2g} m at " in said and "magnified" not in said
    lower, upper = (literal_eval(found) for found in re.findall(r"\[[^]]*\]", said))
    wider = scene.file.model_dump() | {"workspace": {"lower": lower, "upper": upper}}
    assert not said_of(loop(0.3), comove.Scene.from_dict(wider))


def test_a_closed_movement_that_is_too_large_is_told_with_a_scale():
    scene, shown = example("narrow"), loop(0.0, size=100.0)  # such as units of a tablet
    (said,) = said_of(shown, scene)
    factor = float(re.search(r"scale it by ([\d.]+)$", said)[1])
    assert not said_of(scale(DMP.fit(shown), factor), scene)
    assert said_of(scale(DMP.fit(shown), 3 * factor), scene)


def test_a_movement_that_stays_and_keeps_its_size_is_not_told():
    for name in ("narrow", "complex", "window"):
        scene = example(name)
        assert not said_of(comove.model.demonstration_of(scene), scene)
    assert not said_of(loop(0.0), example("narrow"))


def test_the_solver_tells_once_and_searches_in_silence():
    scene, far = example("narrow"), DMP.fit(loop(0.1))
    said = told(lambda: comove.solve(scene, demonstration=far, budget=2.0))
    assert len([text for text in said if "magnified" in text]) == 1
    for objective in (comove.LeastTime(), comove.LeastJerk(0.0)):  # neither follows it
        assert not told(lambda: comove.solve(scene, demonstration=far, objective=objective, budget=2.0))  # noqa: B023
    wide = example("wide")
    assert not told(lambda: best_movement({"far": far, "loop": DMP.fit(loop(0.0))}, wide))
    assert not told(lambda: combine({"far": far, "loop": DMP.fit(loop(0.0))}, wide, budget=0.5))


def test_an_execution_tells_once():
    scene = example("wide").timed(4.0)

    def run():
        executor = Executor(scene, demonstration=DMP.fit(loop(0.1)))
        for _ in range(3):
            executor.step()

    assert len([text for text in told(run) if "magnified" in text]) == 1
