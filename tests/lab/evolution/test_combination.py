"""Movements of which none gets through alone are combined into one that does, verified."""

import numpy as np
import pytest

from comove.dmp import DMP, motion_basis
from comove.dmp.demonstrations import Demonstration
from comove.errors import OptionError
from comove.lab.evolution import combine
from comove.lab.evolution.combination import _Span
from comove.model import CoordinatedDMP, Scene, load_coordinates
from comove.planning import best_movement, solve
from comove.planning.choice import N_BASIS, suitable
from comove.planning.objective import N_STEPS
from comove.verification.verify import verify
from tests.planning.two_gaps import bump, bumps, two_gaps


@pytest.mark.parametrize("seed", range(10))
@pytest.mark.parametrize("bar", [None, 0.1])
@pytest.mark.few(2)
def test_a_combination_passes_where_no_movement_does(seed, bar):
    scene = two_gaps(gap=0.16 if bar is None else 0.2, bar=bar)
    assert not any(c.passes for c in best_movement(bumps(), scene).ranking)
    found = combine(bumps(), scene, seed=seed)
    assert found.verified and not found.reasons
    assert found.motion.clearance_min >= 0
    assert found.cost < (0.27 if bar is None else 0.55)  # the same optimum whatever the seed
    assert found.effort.evaluations < 100_000


@pytest.mark.slow
def test_handwriting_combines_as_well():
    movements = {name: DMP.fit(Demonstration.from_lasa(name)) for name in ("Sine", "Worm", "NShape", "Snake")}
    assert not any(c.passes for c in best_movement(movements, two_gaps()).ranking)
    assert combine(movements, two_gaps(), seed=0).verified


@pytest.mark.parametrize("bar", [None, 0.1])
@pytest.mark.few(1)
def test_the_combination_is_the_sum_that_it_says(bar):
    scene = two_gaps(gap=0.2, bar=bar)
    found = combine(bumps(), scene, seed=1)
    span = _Span.of(suitable(bumps(), scene), scene, load_coordinates(scene))
    weights = sum(c[:, None] * w for c, w in zip(found.coefficients, span.weights, strict=True))
    assert np.allclose(found.dmp.weights, weights, atol=1e-12)
    assert found.names == ("early", "middle", "late")
    assert found.coefficients.shape == (3, 2)
    assert found.dmp.duration == scene.duration


def test_for_one_hand_the_primitive_is_the_motion():
    scene = two_gaps()
    found = combine(bumps(), scene)
    s = np.linspace(0, 1, 301)
    hands = found.attempt.hands(s)
    played = found.dmp.at(s * found.dmp.duration)
    assert np.abs(hands[0, :, 0] - played.position).max() < 1e-12
    assert np.abs(hands[1, :, 0] / scene.duration - played.velocity).max() < 1e-9


def crossing():
    """Two free hands whose ways differ in direction and length."""
    hands = {"a": ([0.1, 0.1], [0.9, 0.8]), "b": ([0.2, 0.8], [0.7, 0.2])}
    return Scene.from_dict(
        {
            "name": "crossing",
            "duration": 5.0,
            "workspace": {"lower": [0, 0], "upper": [1, 1]},
            "manipulators": [{"name": n, "start": s, "goal": g} for n, (s, g) in hands.items()],
        }
    )


@pytest.mark.parametrize("scene", [two_gaps(), two_gaps(bar=0.1), crossing()], ids=["one", "bar", "crossing"])
def test_what_the_search_evaluates_is_what_is_carried(scene):
    """Linear in the coefficients and by `CoordinatedDMP.from_demonstration`, the hands are the same."""
    coordinates = load_coordinates(scene)
    span = _Span.of(suitable(bumps(), scene), scene, coordinates)
    coefficients = np.random.default_rng(0).standard_normal((4, 3, 2))
    q = span.configurations(coefficients)
    basis = motion_basis(N_BASIS, "velocity")
    for one, configurations in zip(coefficients, q, strict=True):
        dmp = CoordinatedDMP.from_demonstration(span.combined(one), scene, coordinates, basis)
        carried = dmp.rollouts(dmp.weights[None], N_STEPS)
        assert np.abs(coordinates.nodes(carried) - coordinates.nodes(configurations[None])).max() < 1e-9


def test_a_movement_that_passes_is_kept_or_improved():
    scene = two_gaps(gap=0.3, upper=0.65, lower=0.65)
    movements = [bump(0.5, 0.25)]
    assert (best := best_movement(movements, scene).best).passes
    found = combine(movements, scene)
    assert found.verified
    assert found.cost <= best.cost + 1e-3


@pytest.mark.slow
def test_the_result_seeds_the_solver():
    scene = two_gaps(gap=0.2, bar=0.1)
    found = combine(bumps(), scene)
    assert solve(scene, demonstration=found.dmp, planner=False, budget=20).verified


@pytest.mark.slow
def test_where_nothing_passes_the_best_attempt_is_labelled_so():
    scene = two_gaps(gap=0.004, bar=0.1)
    found = combine([bump(0.5)], scene, budget=2.0)
    assert not found.verified and found.motion is None
    assert found.reasons
    assert found.timed_out and "--budget 10" in found.reasons[0]
    assert verify(found.attempt).reasons == found.reasons[1:]


@pytest.mark.slow
def test_equal_seeds_give_equal_combinations():
    a, b, c = (combine(bumps(), two_gaps(), seed=seed) for seed in (3, 3, 4))
    assert np.array_equal(a.coefficients, b.coefficients)
    assert a.effort.evaluations == b.effort.evaluations
    assert not np.array_equal(a.coefficients, c.coefficients)


def test_progress_and_interruption():
    told = []

    def progress(state):
        told.append(state)
        if len(told) == 3:
            raise KeyboardInterrupt

    found = combine(bumps(), two_gaps(gap=0.05), progress=progress)
    assert found.interrupted
    assert [state.generation for state in told] == [1, 2, 3]
    assert "3 movements" in told[0].stage


@pytest.mark.slow
def test_further_checks_count():
    found = combine(bumps(), two_gaps(), budget=2.0, checks=[lambda motion: ["never"]])
    assert not found.verified and "never" in found.reasons


@pytest.mark.parametrize(
    "options", [{"seed": -1}, {"seed": True}, {"budget": 0}, {"budget": np.inf}, {"budget": "1 s"}]
)
def test_refused(options):
    with pytest.raises(OptionError, match=next(iter(options))):
        combine(bumps(), two_gaps(), **options)
