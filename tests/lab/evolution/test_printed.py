"""The paper's method as printed: what it counts as violated, what it sees, and how it ends."""

import numpy as np
import pytest

import comove
from comove.errors import OptionError
from comove.lab.evolution import Printed
from comove.lab.evolution.printed import of_hands_alone, violations
from comove.model import Scene, arms_coordinates, demonstration_of
from comove.planning.objective import Objective
from tests.solved import example
from tests.verification.random_motions import scene_data


def test_a_violation_is_a_distance_beyond_the_band_at_a_sample():
    scene, n_steps = example("narrow"), 11
    q = 0.05 * np.random.default_rng(0).standard_normal((4, 4, n_steps))
    q[:, 3] += scene.constraints[0].distance
    q[0, :, 3] = [0.0, 0.0, 0.0, scene.constraints[0].distance]
    found = violations(scene, q)
    assert found.shape == (4, 2 * n_steps)
    for k in range(4):
        for t in range(n_steps):
            off = np.hypot(*(q[k, :2, t] - q[k, 2:, t])) - scene.constraints[0].distance
            assert found[k, t] == (off > scene.constraints[0].tolerance)
            assert found[k, n_steps + t] == (-off > scene.constraints[0].tolerance)
    assert not found[0, [3, n_steps + 3]].any()


def test_equation_4_looks_at_the_hands_alone():
    """A bar across a post that neither hand touches costs nothing; with a hand in it, it does."""
    data = scene_data(example("wide")) | {"demonstration": None}
    data["obstacles"] = [{"shape": "circle", "center": [0.5, 0.5], "radius": 0.05}]
    scene = Scene.from_dict(data)
    across = np.repeat(np.array([0.5, 0.4, 0.5, 0.6])[None, :, None], 5, axis=2)
    within = np.repeat(np.array([0.5, 0.5, 0.5, 0.7])[None, :, None], 5, axis=2)
    whole = Objective(scene, arms_coordinates(scene))
    alone = of_hands_alone(whole)
    assert whole.evaluate(across).hits[0] == 1.0
    assert alone.evaluate(across).hits[0] == 0.0
    assert alone.evaluate(within).hits[0] == 1.0
    assert alone.evaluate(across).penalty[0] == 0.0


@pytest.mark.parametrize("taught", [True, False])
@pytest.mark.few(1)
def test_the_narrow_passage_is_not_passed(taught):
    scene = example("narrow")
    dmp = demonstration_of(scene) if taught else None
    solution = comove.solve(scene, demonstration=dmp, method=Printed(), budget=5.0)
    assert solution.method == "printed"
    assert solution.effort.generations == 0
    assert not solution.verified
    assert solution.reasons


def test_time_that_is_up_ends_it():
    solution = comove.solve(example("narrow"), method=Printed(), budget=0.2)
    assert not solution.verified
    assert "broke_down_after_generations" not in solution.log


def test_hands_that_nothing_ties_are_refused():
    scene = Scene.from_dict(scene_data(example("wide")) | {"load": None, "demonstration": None})
    with pytest.raises(OptionError, match="no distance ties"):
        comove.solve(scene, method=Printed(), budget=1.0)
