"""The known traps of movement primitives, one test each."""

from types import SimpleNamespace

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from comove.dmp import DMP, Variant, motion_basis
from comove.dmp.demonstrations import Demonstration, lasa_names
from comove.dmp.poses import PoseDMP
from comove.dmp.system import ALPHA_Y, N_INTERVALS

ENDING = [variant for variant in Variant if variant is not Variant.RHYTHMIC]
each_ending = pytest.mark.parametrize("variant", ENDING)


def shown(n_steps=401, start_velocity=(0.0, 0.0), at=0.0):
    s = np.linspace(0, 1, n_steps)
    way = s**3 * (10 - 15 * s + 6 * s**2)
    position = np.stack([0.7 * way, way + 0.3 * np.sin(np.pi * way)], axis=1)
    return SimpleNamespace(time=2 * s + at, position=position, start_velocity=np.array(start_velocity))


@each_ending
def test_the_forcing_clock_is_not_late(variant):
    """A clock that is one step late makes Runge-Kutta methods of first order; here no step leaves an error at all."""
    dmp = DMP.fit(shown(), variant=variant)
    reference = dmp.at(np.linspace(0, 2, 65))
    for n_steps in (4, 16, 64):
        state, worst = dmp.initial_state(), 0.0
        for k in range(n_steps):
            state = dmp.step(state, 2 / n_steps)
            worst = max(worst, np.abs(state.position - reference.position[(k + 1) * 64 // n_steps]).max())
        assert worst < 1e-12


def test_the_movement_is_that_of_the_equation_and_not_of_a_delayed_one():
    """Runge-Kutta on the written equation converges to the rollout with its full order, down to rounding."""
    dmp = DMP.fit(shown(), n_basis=8)
    knots = np.linspace(0, 1, N_INTERVALS + 1)

    def system(s, y):
        f = np.array([np.interp(s, knots, column) for column in dmp.curve.force.T])
        return np.concatenate([y[2:], ALPHA_Y * (ALPHA_Y / 4 * (dmp.goal - y[:2]) - y[2:]) + f])

    def integrated(n_steps):  # steps that meet the knots, where the forcing has its kinks
        y, h = np.concatenate(dmp.boundary_values()[:2]), 1 / n_steps
        for k in range(n_steps):
            s = k * h
            a = system(s, y)
            b = system(s + h / 2, y + h / 2 * a)
            c = system(s + h / 2, y + h / 2 * b)
            y = y + h / 6 * (a + 2 * b + 2 * c + system(s + h, y + h * c))
        return y[:2]

    middle = [np.abs(integrated(n) - dmp.goal).max() for n in (800, 1600, 3200)]
    order = np.log2(middle[0] / middle[1])
    assert order == pytest.approx(4, abs=0.3)
    assert middle[-1] < 1e-10


@each_ending
@pytest.mark.parametrize("at", [-7.5, 1.0, 1.7e9])
def test_time_need_not_start_at_zero(variant, at):
    early, late = (DMP.fit(shown(at=begin), variant=variant) for begin in (0.0, at))
    assert late.duration == pytest.approx(early.duration, rel=1e-6)
    assert np.abs(late.rollout().position - early.rollout().position).max() < 1e-4


@each_ending
def test_the_start_velocity_is_kept(variant):
    dmp = DMP.fit(shown(start_velocity=(0.4, -0.2)), variant=variant)
    assert np.abs(dmp.rollout().velocity[0] - [0.4, -0.2]).max() < 1e-12
    assert np.abs(dmp.initial_state().velocity - [0.4, -0.2]).max() < 1e-12


def test_the_number_of_samples_is_the_one_asked_for():
    """Counting samples by ``np.arange(0, T, dt)`` is wrong for many T and dt: here a whole number says it."""
    dmp = DMP.fit(shown())
    for n_steps in (2, 3, 100, 259, 2100):
        for duration in (0.1, 0.3, 1 / 3, 2.1, 7.77):
            path = dmp.rollout(duration=duration, n_steps=n_steps)
            assert len(path.time) == n_steps and path.time[-1] == duration


@each_ending
@pytest.mark.parametrize("n_basis", [10, 20, 50])
def test_at_rest_at_the_goal_when_the_time_is_over(variant, n_basis):
    """A plain fit leaves the goal by a large part of the shape after its end; this one stays to rounding."""
    for name in lasa_names()[:10]:
        recorded = Demonstration.from_lasa(name)
        dmp = DMP.fit(recorded, n_basis=n_basis, variant=variant)
        after = dmp.at(dmp.duration * np.linspace(1.0, 3.0, 41))
        assert np.abs(after.position - dmp.goal).max() < 1e-9
        assert np.abs(after.velocity).max() < 1e-8


@each_ending
def test_the_end_of_the_phase_does_not_stop_short(variant):
    """With a phase that ends at a hundredth the plain system stops short of the goal; the ends are exact here."""
    dmp = DMP.fit(shown(), variant=variant)
    assert dmp.variant.usual_phase(1.0) == pytest.approx(0.01, rel=0.01) or variant is Variant.CLOSED_FORM
    for goal in ([3.0, -2.0], [0.01, 0.0], [-1.0, -1.0]):
        assert np.abs(dmp.rollout(goal=goal).position[-1] - goal).max() < 1e-11


@each_ending
def test_goals_that_are_the_start(variant):
    dmp = DMP.fit(shown(), variant=variant)
    for goal in (dmp.start, dmp.start + 1e-15, dmp.start + 1e-9):
        path = dmp.rollout(goal=goal)
        assert np.isfinite(path.position).all() and np.isfinite(path.velocity).all()
        assert np.abs(path.position[-1] - goal).max() < 1e-12


@each_ending
def test_goals_that_jump(variant):
    from dataclasses import replace

    dmp = DMP.fit(shown(), variant=variant)
    state = dmp.step(dmp.initial_state(), 1.0)
    state = replace(state, goal=dmp.start)
    for _ in range(100):
        before, state = state, dmp.step(state, 0.01)
        assert np.isfinite(state.position).all()
        assert np.linalg.norm(state.position - before.position) < 0.1
    assert np.abs(state.position - dmp.start).max() < 1e-9


def test_couplings_are_multiplied_by_the_step():
    """A coupling added a step, without dt, doubles when the step is halved."""
    dmp, moved = DMP.fit(shown()), []
    for n_steps in (10, 1000):
        state = dmp.initial_state()
        for _ in range(n_steps):
            state = dmp.step(state, 1.0 / n_steps, coupling=[0.5, 0.0])
        moved.append(state.position - dmp.at([1.0]).position[0])
    assert np.abs(moved[0] - moved[1]).max() < 1e-12 and moved[0][0] > 0.001


def test_signs_of_quaternions():
    """q and -q are one orientation: flips in a recording leave no trace."""
    s = np.linspace(0, 1, 200)
    angle = 2.9 * s
    orientation = np.stack([np.cos(angle / 2), np.sin(angle / 2), 0 * s, 0 * s], axis=1)
    flipped = orientation * np.where(np.arange(200) % 7 == 3, -1.0, 1.0)[:, None]
    fits = [
        PoseDMP.fit(
            SimpleNamespace(time=s, position=np.zeros((200, 3)), orientation=q, start_velocity=np.zeros(3))
        )
        for q in (orientation, flipped)
    ]
    assert np.abs(fits[0].at(s).orientation - fits[1].at(s).orientation).max() < 1e-12
    assert np.abs(np.diff(fits[1].at(s).orientation, axis=0)).max() < 0.02


@pytest.mark.parametrize("n_basis", [10, 50])
def test_weights_are_well_scaled(n_basis):
    """Raw weights have condition numbers of 1e6 to 1e9; these are orthonormal in velocity."""
    velocity = motion_basis(n_basis).shape[1]
    assert np.linalg.cond(velocity) < 1 + 1e-6


def test_integration_by_a_library_agrees():
    """The same equation by scipy's adaptive integrator, at random times."""
    dmp = DMP.fit(Demonstration.from_lasa("Sine"), n_basis=20)
    knots = np.linspace(0, 1, N_INTERVALS + 1)

    def system(s, y):
        f = np.array([np.interp(s, knots, column) for column in dmp.curve.force.T])
        return np.concatenate([y[2:], ALPHA_Y * (ALPHA_Y / 4 * (dmp.goal - y[:2]) - y[2:]) + f])

    times = np.sort(np.random.default_rng(0).uniform(0, 1, 7))
    solved = solve_ivp(system, (0, 1), np.concatenate(dmp.boundary_values()[:2]), t_eval=times, rtol=1e-9,
                       atol=1e-8, max_step=1 / N_INTERVALS)  # fmt: skip
    # Of 45: the forcing has kinks.
    assert np.abs(solved.y[:2].T - dmp.at(times * dmp.duration).position).max() < 1e-4
