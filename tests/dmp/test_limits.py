"""Via-points and limits: kept at every instant, by the least change of the movement."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.optimize import minimize

from comove.dmp import DMP, Variant
from comove.dmp.demonstrations import Demonstration
from comove.dmp.limits import ViaPoint, constrained, largest
from comove.errors import OptionError
from tests.cases import examples

from .movements import resting_dmp

seeds = st.integers(0, 2**32 - 1)


@examples(30)
@given(seeds)
def test_the_largest_values_are_those_of_dense_samples(seed):
    """Never below a sample, and not above the densest by more than its step allows."""
    dmp = resting_dmp(seed)
    path = dmp.at(np.linspace(0, dmp.duration, 64 * 800 + 1))
    acceleration = np.stack([dmp.curve.at(s)[2] for s in np.linspace(0, 1 - 1e-12, 4001)]) / dmp.duration**2
    velocity, hardest = largest(dmp)
    assert (velocity >= np.abs(path.velocity).max(axis=0) * (1 - 1e-12)).all()
    assert np.allclose(velocity, np.abs(path.velocity).max(axis=0), rtol=1e-6)
    assert (hardest >= np.abs(acceleration).max(axis=0) * (1 - 1e-9)).all()
    assert np.allclose(hardest, np.abs(acceleration).max(axis=0), rtol=1e-2)


@examples(20)
@given(seeds, st.floats(0.5, 0.95), st.floats(0.6, 0.95))
def test_limits_hold_at_every_instant_and_ends_stay(seed, slower, gentler):
    dmp = resting_dmp(seed, n_basis=25)
    velocity, acceleration = largest(dmp)
    try:
        kept = constrained(dmp, velocity=slower * velocity, acceleration=gentler * acceleration)
    except OptionError as error:
        assert "no movement of 25 weights" in str(error)
        return
    now = largest(kept)
    assert (now[0] <= slower * velocity).all() and (now[1] <= gentler * acceleration).all()
    ends = kept.at([0.0, kept.duration])
    assert np.abs(ends.position - [dmp.start, dmp.goal]).max() < 1e-10
    assert np.abs(ends.velocity).max() < 1e-9


@pytest.mark.parametrize("variant", [variant for variant in Variant if variant is not Variant.RHYTHMIC])
def test_via_points_are_passed(variant):
    dmp = DMP.fit(Demonstration.from_lasa("Angle"), n_basis=25, variant=variant).towards(goal=[5.0, 3.0])
    near = dmp.at([1.0, 2.0]).position + [[1.0, -2.0], [0.5, 1.0]]
    kept = constrained(dmp, via=[ViaPoint(1.0, near[0]), ViaPoint(2.0, near[1], velocity=[0.0, 0.0])])
    assert np.abs(kept.at([1.0, 2.0]).position - near).max() < 1e-9
    assert np.abs(kept.at([2.0]).velocity).max() < 1e-9
    assert np.abs(kept.rollout().position[-1] - [5.0, 3.0]).max() < 1e-9
    assert np.abs(kept.at([0.1]).position - dmp.at([0.1]).position).max() < 1.0


def test_via_points_and_limits_together():
    dmp = resting_dmp(3, n_basis=30)
    velocity, _ = largest(dmp)
    when = 0.4 * dmp.duration
    point = dmp.at([when]).position[0] + 0.02
    kept = constrained(dmp, via=[ViaPoint(when, point)], velocity=0.9 * velocity)
    assert np.abs(kept.at([when]).position[0] - point).max() < 1e-9
    assert (largest(kept)[0] <= 0.9 * velocity).all()


def test_what_holds_already_is_left_alone():
    dmp = resting_dmp(4)
    velocity, acceleration = largest(dmp)
    same = constrained(dmp, velocity=1.01 * velocity, acceleration=1.01 * acceleration)
    assert np.allclose(same.weights, dmp.weights, rtol=1e-12)


def test_an_infinite_limit_is_none():
    dmp = resting_dmp(6)
    limit = 0.9 * largest(dmp)[0] * [1.0, np.inf]
    kept = constrained(dmp, velocity=limit, acceleration=np.inf)
    assert np.array_equal(kept.weights[0], constrained(dmp, velocity=limit[0]).weights[0])
    assert np.allclose(kept.weights[1], dmp.weights[1], rtol=1e-12)


def test_the_change_is_the_least():
    """Against a general optimiser on the same programme."""
    dmp = resting_dmp(5, n_basis=8)
    limit = 0.85 * largest(dmp)[0]
    kept = constrained(dmp, velocity=limit)
    for d in range(2):
        own = ((kept.weights[d] - dmp.weights[d]) ** 2).sum()
        assert own <= 1.01 * least_change(dmp, d, limit[d])


def least_change(dmp, d, limit):
    """The squared change of one coordinate's weights that keeps a limit of velocity, by SLSQP."""
    coast, shape = dmp.basis.boundary[1] @ dmp.boundary_values()[:, d], dmp.basis.shape[1]
    rows, bounds = np.concatenate([shape, -shape]), limit * dmp.duration - np.concatenate([coast, -coast])
    kept = {"type": "ineq", "fun": lambda z: bounds - rows @ z, "jac": lambda z: -rows}
    found = minimize(
        lambda z: ((z - dmp.weights[d]) ** 2).sum(),
        0.9 * dmp.weights[d],
        jac=lambda z: 2 * (z - dmp.weights[d]),
        constraints=kept,
        method="SLSQP",
        options={"maxiter": 500, "ftol": 1e-14},
    )
    assert found.success
    return found.fun


def test_what_cannot_be_is_said():
    dmp = resting_dmp(7)
    with pytest.raises(
        OptionError, match="no movement of 12 weights keeps velocity in dimension 0; give it more time"
    ):
        constrained(dmp, velocity=1e-3)
    with pytest.raises(OptionError, match="via-points"):
        times = np.linspace(0.1, 0.9, 40) * dmp.duration
        constrained(dmp, via=[ViaPoint(t, np.random.default_rng(0).standard_normal(2)) for t in times])
    for via in (
        ViaPoint(0.0, [0, 0]),
        ViaPoint(99.0, [0, 0]),
        ViaPoint(0.1, [0.0]),
        ViaPoint(0.1, [np.nan, 0]),
    ):
        with pytest.raises(OptionError, match="via-point"):
            constrained(dmp, via=[via])
    for limit in (0.0, -1.0, [1.0], np.nan, np.ones((2, 2))):
        with pytest.raises(OptionError, match="velocity"):
            constrained(dmp, velocity=limit)
    cycle = replace(dmp, variant="rhythmic")
    with pytest.raises(OptionError, match="rhythmic"):
        constrained(cycle, velocity=1.0)
    still = replace(dmp, variant="classic").towards(goal=dmp.start)
    with pytest.raises(OptionError, match="learns nothing where the goal is the start"):
        constrained(still, via=[ViaPoint(0.2, dmp.start + 0.1)])


def test_slips_are_told():
    dmp = resting_dmp(8)
    for via in (ViaPoint(0.1, [0, 0]), [(0.1, [0, 0])], [ViaPoint("1", [0, 0])], [ViaPoint(0.1, "a")]):
        with pytest.raises(OptionError, match="via"):
            constrained(dmp, via=via)
    for function in (largest, constrained):
        with pytest.raises(OptionError, match="is no DMP of positions"):
            function(None)
