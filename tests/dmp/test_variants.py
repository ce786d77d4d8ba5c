"""Every variant does what its documentation says, and none of them breaks where ends coincide."""

import warnings
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

from comove.dmp import DMP, ExponentialPhase, Variant
from comove.dmp.demonstrations import Demonstration
from comove.dmp.system import ALPHA_Y, N_INTERVALS
from comove.errors import ComoveWarning, OptionError
from comove.geometry.rotations import similarity
from tests.cases import examples

seeds = st.integers(0, 2**32 - 1)
ENDING = [variant for variant in Variant if variant is not Variant.RHYTHMIC]
each_ending = pytest.mark.parametrize("variant", ENDING)


def fitted(variant, n_dims=2, n_basis=15, seed=0, phase=None):
    """A primitive of a wavy movement that starts and ends at rest."""
    rng = np.random.default_rng(seed)
    s = np.linspace(0, 1, 401)
    way = s**3 * (10 - 15 * s + 6 * s**2)
    bends = np.stack([np.sin(np.pi * k * way) for k in (1, 2, 3)])
    position = np.outer(way, rng.uniform(0.5, 1.5, n_dims)) + bends.T @ rng.uniform(-0.3, 0.3, (3, n_dims))
    recorded = SimpleNamespace(time=2.0 * s, position=position, start_velocity=np.zeros(n_dims))
    return DMP.fit(recorded, n_basis=n_basis, variant=variant, phase=phase)


@each_ending
@examples(20)
@given(seeds)
def test_both_ends_are_exact_and_held(variant, seed):
    rng = np.random.default_rng(seed)
    start, goal = rng.uniform(-2, 2, (2, 2))
    dmp = fitted(variant).towards(start=start, goal=goal, duration=rng.uniform(0.1, 50))
    size = 1 + np.abs(dmp.shape_weights).max()
    path = dmp.at(dmp.duration * np.array([0.0, 1.0, 1.0 + 1e-9, 1.3, 5.0]))
    assert np.abs(path.position[0] - start).max() < 1e-12
    assert np.abs(path.position[1:] - goal).max() < 1e-12 * size
    assert np.abs(path.velocity[1:]).max() * dmp.duration < 1e-10 * size


@each_ending
@pytest.mark.few(2)
def test_the_equation_of_the_table(variant):
    """Integrated from its forcing term by an independent method, at ends other than those learned."""
    dmp = fitted(variant, phase=ExponentialPhase(alpha=2.0)).towards(start=[0.3, -0.2], goal=[-0.4, 1.0])
    knots = np.linspace(0, 1, N_INTERVALS + 1)

    def system(s, state):
        y, v = state[:2], state[2:]
        f = np.array([np.interp(s, knots, column) for column in dmp.curve.force.T])
        return np.concatenate([v, ALPHA_Y * (ALPHA_Y / 4 * (dmp.goal - y) - v) + f])

    solved = solve_ivp(
        system, (0, 1), np.concatenate(dmp.boundary_values()[:2]), t_eval=[0.25, 0.5, 0.9], rtol=1e-10, atol=1e-12,
        max_step=1 / N_INTERVALS,
    )  # fmt: skip
    played = dmp.at(dmp.duration * np.array([0.25, 0.5, 0.9])).position
    assert np.abs(solved.y[:2].T - played).max() < 1e-7  # what is left by the steps of the integration


@each_ending
def test_they_fit_what_they_are_shown(variant):
    demonstration = Demonstration.from_lasa("Sine")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ComoveWarning)
        dmp = DMP.fit(demonstration, n_basis=30, variant=variant)
    error = dmp.at(demonstration.time).position - demonstration.position
    assert np.sqrt((error**2).sum(axis=1).mean()) < 0.01 * np.ptp(demonstration.position)


@each_ending
@pytest.mark.parametrize("near", [0.0, 1e-300, 1e-12, 1e-3])
def test_goals_at_the_start(variant, near):
    """Never a number that is none, and nothing blows up."""
    dmp = fitted(variant)
    path = dmp.rollout(goal=dmp.start + near)
    assert np.isfinite(path.position).all() and np.isfinite(path.velocity).all()
    assert np.abs(path.position - dmp.start).max() < 5.0
    assert np.abs(path.position[-1] - dmp.start - near).max() < 1e-12


def test_where_the_goal_is_the_start_the_scaled_forms_stand_still():
    for variant in (Variant.CLASSIC, Variant.DMP_PLUS_PLUS):
        dmp = fitted(variant)
        assert np.abs(dmp.rollout(goal=dmp.start).position - dmp.start).max() < 1e-12
    for variant in (Variant.CLOSED_FORM, Variant.PASTOR):
        dmp = fitted(variant)
        assert np.ptp(dmp.rollout(goal=dmp.start).position, axis=0).max() > 0.1


def test_the_classic_form_mirrors():
    """Ijspeert et al. (2013): where the displacement changes its sign, the movement is its mirror image."""
    dmp = fitted(Variant.CLASSIC)
    mirrored = dmp.rollout(goal=dmp.start - (dmp.goal - dmp.start))
    assert np.abs((mirrored.position - dmp.start) + (dmp.rollout().position - dmp.start)).max() < 1e-12


def test_the_other_forms_do_not_mirror():
    for variant in (Variant.CLOSED_FORM, Variant.PASTOR):
        dmp = fitted(variant)
        straight = replace(dmp, weights=np.zeros_like(dmp.weights))
        back = dmp.start - (dmp.goal - dmp.start)
        shape = dmp.rollout().position - straight.rollout().position
        assert (
            np.abs(dmp.rollout(goal=back).position - straight.rollout(goal=back).position - shape).max()
            < 1e-12
        )


def test_the_classic_form_learns_nothing_where_the_ends_coincide():
    time = np.linspace(0, 1, 200)
    loop = np.stack([time**2 * (3 - 2 * time), np.sin(np.pi * time) ** 2], axis=1)
    with pytest.warns(ComoveWarning, match="dimension 1: the classic form learns nothing"):
        dmp = DMP.fit(Demonstration(time, loop), variant="classic")
    assert not dmp.weights[1].any()
    assert np.isfinite(dmp.rollout(goal=[2.0, 1.0]).position).all()


@examples(30)
@given(seeds, st.sampled_from([1, 2, 3, 7]))
def test_dmp_plus_plus_is_similar_to_the_taught_movement(seed, n_dims):
    """Ginesi et al. (2021): turn and scale the ends, and the whole movement turns and scales."""
    rng = np.random.default_rng(seed)
    dmp = replace(fitted(Variant.DMP_PLUS_PLUS, n_dims), start_velocity=rng.uniform(-1, 1, n_dims))
    start, goal = rng.uniform(-1, 1, (2, n_dims))
    turn = similarity(dmp.goal - dmp.start, goal - start)
    expected = start + (dmp.rollout().position - dmp.start) @ turn.T
    assert np.abs(dmp.rollout(start=start, goal=goal).position - expected).max() < 1e-11


def test_dmp_plus_plus_of_a_closed_movement_is_shifted():
    time = np.linspace(0, 1, 300)
    loop = np.stack([np.sin(np.pi * time) ** 2, np.sin(2 * np.pi * time) * np.sin(np.pi * time) ** 2], axis=1)
    dmp = DMP.fit(Demonstration(time, loop), variant="dmp++", n_basis=30)
    assert np.abs(dmp.at(time).position - loop).max() < 0.01
    moved = dmp.rollout(start=[1, 2], goal=[1, 2]).position - dmp.rollout().position
    assert np.abs(moved - [1, 2]).max() < 1e-12


def test_pastor_starts_gently():
    """Hoffmann et al. (2009): far goals do not pull at the start: the first acceleration without shape is smaller."""
    first = {}
    for variant in (Variant.CLOSED_FORM, Variant.PASTOR):
        dmp = replace(fitted(variant), weights=np.zeros((2, 15)))
        first[variant] = np.linalg.norm(dmp.curve.at(0.0)[2] - dmp.curve.force[0])
    pull = ALPHA_Y**2 / 4 * np.linalg.norm(dmp.goal - dmp.start)
    assert first[Variant.CLOSED_FORM] == pytest.approx(pull)
    assert np.linalg.norm(dmp.curve.at(0.0)[2]) < 0.05 * pull


@examples(50)
@given(seeds, st.integers(2, 7))
def test_a_similarity_carries_one_vector_to_the_other(seed, n):
    rng = np.random.default_rng(seed)
    a, b = rng.standard_normal((2, n))
    for goal in (b, a, -a, 1e-9 * b, -a + 1e-9 * b):
        matrix = similarity(a, goal)
        assert np.allclose(matrix @ a, goal, rtol=0, atol=1e-12 * (1 + np.linalg.norm(goal)))
        scale = np.linalg.norm(goal) / np.linalg.norm(a)
        assert np.allclose(matrix.T @ matrix, scale**2 * np.eye(n), atol=1e-12)
        assert np.linalg.det(matrix / scale) == pytest.approx(1.0)
    aside = np.linalg.svd(np.stack([a, b]))[2][2:]  # what lies across both stays: the least rotation
    assert np.allclose(
        similarity(a, b) @ aside.T / (np.linalg.norm(b) / np.linalg.norm(a)), aside.T, atol=1e-9
    )


def test_names():
    assert fitted("DMP++".lower()).variant is Variant.DMP_PLUS_PLUS
    with pytest.raises(
        OptionError, match=r"did you mean 'classic'\? known: closed-form, classic, pastor, dmp\+\+"
    ):
        fitted("clasic")
    with pytest.raises(OptionError, match="known"):
        fitted(3)
    with pytest.raises(OptionError, match="period"):
        DMP.fit(Demonstration([0, 1, 2.0], [[0, 0], [1, 1], [2, 1.0]]), period=1.0)


@pytest.mark.parametrize("variant", Variant)
def test_a_population_is_one_product(variant):
    dmp = fitted(variant).towards(goal=[2.0, -1.0])
    weights = np.random.default_rng(0).standard_normal((5, 2, 15))
    together = dmp.rollouts(weights, n_steps=33)
    for one, path in zip(weights, together, strict=True):
        assert np.abs(replace(dmp, weights=one).rollout(n_steps=33).position.T - path).max() < 1e-11
    with pytest.raises(OptionError, match="n_rollouts, 2, 15"):
        dmp.rollouts(weights[0])


def test_velocities_at_the_ends_of_a_closed_dmp_plus_plus():
    dmp = fitted("dmp++").towards(goal=fitted("dmp++").start, goal_velocity=[3.0, 4.0])
    for path in (dmp.rollout(), dmp.at([0.0, dmp.duration])):
        assert np.abs(path.velocity[-1] - [3.0, 4.0]).max() < 1e-9


def test_what_is_no_recording_and_no_phase():
    shown = Demonstration([0, 1, 2.0], [[0, 0], [1, 1], [2, 1.0]])
    for wrong in (None, np.zeros((5, 2)), "Angle"):
        with pytest.raises(OptionError, match="Demonstration"):
            DMP.fit(wrong)
    for wrong in ("linear", ExponentialPhase):
        with pytest.raises(OptionError, match="phase"):
            DMP.fit(shown, phase=wrong)
    for alpha in (0.0, -4.0, np.nan, 1e6, "1"):
        with pytest.raises(OptionError, match="alpha"):
            ExponentialPhase(alpha=alpha)
    with pytest.raises(OptionError, match="phase"):
        DMP.fit(shown, variant="rhythmic", phase=ExponentialPhase())
    for n_steps in (-3, "a", 10.0, True, 10**9):
        with pytest.raises(OptionError, match="n_steps"):
            fitted("classic").rollouts(np.zeros((1, 2, 15)), n_steps)
        with pytest.raises(OptionError, match="n_steps"):
            fitted("classic").rollout(n_steps=n_steps)
