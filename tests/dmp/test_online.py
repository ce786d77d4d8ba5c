"""Execution step by step equals the rollout whatever the steps, and keeps its promises when it is disturbed."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

from comove.dmp import LinearPhase, Variant, rate_for_lag
from comove.dmp.system import ALPHA_Y, N_INTERVALS
from comove.errors import OptionError
from tests.cases import examples

from .movements import random_dmp

seeds = st.integers(0, 2**32 - 1)
variants = st.sampled_from([variant for variant in Variant if variant is not Variant.RHYTHMIC])


def run(dmp, state, times, **options):
    """States at the given times, by one step between each two."""
    states = []
    for dt in np.diff(times, prepend=state.time):
        state = dmp.step(state, dt, **options) if dt > 0 else state
        states.append(state)
    return states


@examples(40)
@given(seeds, variants, st.integers(1, 60))
def test_steps_of_any_length_are_exact(seed, variant, n_steps):
    """No order of convergence: a single step from start to end is as exact as thousands."""
    dmp = random_dmp(seed, variant)
    times = np.sort(np.random.default_rng(seed).uniform(0, 1.5 * dmp.duration, n_steps))
    expected = dmp.at(times)
    size = 1 + np.abs(dmp.curve.knots).max(axis=(1, 2))
    for k, state in enumerate(run(dmp, dmp.initial_state(), times)):
        assert np.abs(state.position - expected.position[k]).max() < 1e-13 * size[0]
        assert np.abs(state.velocity - expected.velocity[k]).max() * dmp.duration < 1e-12 * size[1]
        assert state.progress == pytest.approx(times[k] / dmp.duration)


@examples(20)
@given(seeds, variants, st.floats(0.01, 3))
def test_the_goal_is_held_ever_after(seed, variant, after):
    dmp = random_dmp(seed, variant)
    state = run(dmp, dmp.initial_state(), np.linspace(0, dmp.duration * (1 + after), 77))[-1]
    assert np.abs(state.position - dmp.goal).max() < 1e-11
    assert np.abs(state.velocity).max() * dmp.duration < 1e-10


@examples(30)
@given(seeds, st.lists(st.floats(-3, 3), min_size=5, max_size=40))
def test_pace_changes_the_time_and_not_the_path(seed, rates):
    """Slower, faster, paused, backwards: the position is that of the phase."""
    dmp, state = random_dmp(seed), None
    state = dmp.initial_state()
    for rate in rates:
        state = dmp.step(state, dmp.duration / 20, rate=rate)
        there = dmp.at([state.progress * dmp.duration])
        assert state.progress >= 0.0
        assert np.abs(state.position - there.position[0]).max() < 1e-11
        assert np.abs(state.velocity - rate * there.velocity[0]).max() * dmp.duration < 1e-9
    assert state.time == pytest.approx(len(rates) * dmp.duration / 20)


def test_paused_is_at_rest_and_goes_on():
    dmp = random_dmp(1)
    moving = dmp.step(dmp.initial_state(), 0.3 * dmp.duration)
    paused = dmp.step(moving, 5.0, rate=0.0)
    assert np.array_equal(paused.position, moving.position) and not paused.velocity.any()
    after = dmp.step(paused, 0.1 * dmp.duration)
    assert np.abs(after.position - dmp.at([0.4 * dmp.duration]).position[0]).max() < 1e-12


def test_backwards_returns_to_the_start_and_stays_there():
    dmp = random_dmp(2)
    state = run(dmp, dmp.initial_state(), np.linspace(0, 3 * dmp.duration, 30))[-1]
    for _ in range(15):
        state = dmp.step(state, 0.1 * dmp.duration, rate=-1.0)
    assert state.progress == 0.0
    assert np.abs(state.position - dmp.start).max() < 1e-11


@examples(20)
@given(seeds, st.floats(0.05, 0.9))
def test_a_push_dies_out_as_the_system_says(seed, when):
    """Against the transformed system integrated from the pushed state by an independent method."""
    dmp, push = random_dmp(seed), np.array([0.3, -0.2])
    state = dmp.step(dmp.initial_state(), when * dmp.duration)
    state = replace(state, position=state.position + push)
    knots = np.linspace(0, 1, N_INTERVALS + 1)

    def system(s, y):
        f = np.array([np.interp(s, knots, column) for column in dmp.curve.force.T])
        return np.concatenate([y[2:], ALPHA_Y * (ALPHA_Y / 4 * (dmp.goal - y[:2]) - y[2:]) + f])

    end = min(when + 0.1, 1.0)
    solved = solve_ivp(
        system,
        (when, end),
        np.concatenate([state.position, state.slope]),
        rtol=1e-9,
        atol=1e-10,
        max_step=1e-3,
    )
    stepped = dmp.step(state, (end - when) * dmp.duration)
    assert np.abs(stepped.position - solved.y[:2, -1]).max() < 1e-6 * (1 + np.abs(dmp.weights).max())
    later = dmp.step(stepped, 3 * dmp.duration)
    assert np.abs(later.position - dmp.goal).max() < 1e-11


@examples(30)
@given(seeds, variants, st.floats(0.0, 0.8), st.integers(5, 200))
def test_a_goal_that_moves_is_reached_in_time(seed, variant, when, n_steps):
    """Exactly at the end, without a jump in position or velocity."""
    dmp, goal = random_dmp(seed, variant), np.array([2.0, -1.5])
    before = dmp.step(dmp.initial_state(), max(when, 1e-9) * dmp.duration)
    state = replace(before, goal=goal)
    nudged = dmp.step(state, 1e-9 * dmp.duration)
    size = 1 + np.abs(before.slope).max() + np.abs(dmp.weights).max()
    assert np.abs(nudged.position - before.position).max() < 1e-7 * size
    assert np.abs(nudged.slope - before.slope).max() < 1e-4 * size
    for _ in range(n_steps):
        state = dmp.step(state, (1 - when) * dmp.duration / n_steps)
    state = dmp.step(state, 1e-6 * dmp.duration)
    assert np.abs(state.position - goal).max() < 1e-9 * size
    assert np.abs(state.velocity).max() * dmp.duration < 1e-4 * size


def test_a_goal_that_moves_early_is_not_rushed_to():
    """The bridge lasts as long as the movement: half-way over it, the former curve still counts."""
    dmp = random_dmp(3)
    new = dmp.towards(goal=dmp.goal + 1.0)
    state = dmp.step(dmp.initial_state(), 0.2 * dmp.duration)
    state = dmp.step(replace(state, goal=new.goal), 0.4 * dmp.duration)
    left = np.abs(state.position - new.at([0.6 * dmp.duration]).position[0])
    gap = np.abs(new.at([0.2 * dmp.duration]).position[0] - dmp.at([0.2 * dmp.duration]).position[0])
    assert (left > 0.05 * gap).all()


def test_a_push_while_running_backwards():
    """A deviation of the slope is one by the phase: backwards it leads the other way, and dies out all the same."""
    dmp = random_dmp(4)
    state = dmp.step(dmp.initial_state(), 0.8 * dmp.duration)
    state = replace(state, slope=state.slope + [1.0, 0.0])
    back = dmp.step(state, 0.01 * dmp.duration, rate=-1.0)
    assert back.position[0] - dmp.at([0.79 * dmp.duration]).position[0, 0] == pytest.approx(-0.01, rel=0.15)
    back = dmp.step(back, 0.7 * dmp.duration, rate=-1.0)
    assert np.abs(back.position - dmp.at([0.09 * dmp.duration]).position[0]).max() < 1e-3


def test_a_goal_that_moves_late_is_reached_a_fifth_of_a_duration_later():
    dmp = random_dmp(3)
    state = dmp.step(dmp.initial_state(), 0.95 * dmp.duration)
    state = dmp.step(replace(state, goal=dmp.goal + 0.1), 0.2001 * dmp.duration)
    assert np.abs(state.position - dmp.goal - 0.1).max() < 1e-9
    assert np.abs(dmp.step(state, dmp.duration).position - dmp.goal - 0.1).max() < 1e-12


def test_a_goal_that_moves_all_the_time():
    dmp = random_dmp(4)
    state = dmp.initial_state()
    for k in range(200):
        state = replace(state, goal=dmp.goal + 0.2 * np.sin(0.02 * min(k, 140)))
        before, state = state, dmp.step(state, dmp.duration / 200)
        assert np.linalg.norm(state.position - before.position) < 0.2
    assert np.abs(state.position - state.goal).max() < 1e-9


@examples(20)
@given(seeds, st.integers(1, 40))
def test_a_coupling_acts_by_time_and_not_by_step(seed, n_steps):
    """An acceleration held over the same time moves as far, however many steps that time is cut into."""
    dmp, push = random_dmp(seed), np.array([0.4, -1.0])
    once = dmp.step(dmp.initial_state(), 0.2 * dmp.duration, coupling=push)
    state = dmp.initial_state()
    for _ in range(n_steps):
        state = dmp.step(state, 0.2 * dmp.duration / n_steps, coupling=push)
    free = dmp.step(dmp.initial_state(), 0.2 * dmp.duration)
    assert np.abs(state.position - once.position).max() < 1e-10 * (1 + dmp.duration**2)
    assert ((once.position - free.position) * push > 0).all()


def test_a_held_coupling_shifts_by_its_acceleration_over_the_stiffness():
    dmp = random_dmp(5, phase=LinearPhase())
    state, push = dmp.initial_state(), np.array([0.1, 0.0])
    state = dmp.step(state, 10 * dmp.duration, coupling=push)
    stiffness = ALPHA_Y**2 / 4 / dmp.duration**2
    assert np.abs(state.position - dmp.goal - push / stiffness).max() < 1e-10


def test_another_duration_on_the_way():
    dmp = random_dmp(6)
    state = dmp.step(dmp.initial_state(), 0.5 * dmp.duration)
    state = replace(state, duration=2 * dmp.duration)
    state = dmp.step(state, dmp.duration)
    assert np.abs(state.position - dmp.goal).max() < 1e-12
    assert state.time == pytest.approx(1.5 * dmp.duration)


def test_the_pace_falls_with_the_lag():
    assert rate_for_lag(0.0, 0.01) == 1.0
    assert rate_for_lag(0.01, 0.01) == 0.5
    assert rate_for_lag(1.0, 0.01) < 1e-3
    for lag, tolerance in [(0.1, 0.0), (np.nan, 0.1), (0.1, -1.0), (np.inf, 1.0)]:
        with pytest.raises(OptionError):
            rate_for_lag(lag, tolerance)


def test_phase_stopping_waits_for_a_robot_that_is_held():
    """The robot is a lagging follower that somebody holds for two seconds; it arrives all the same, and late."""
    dmp = random_dmp(7).towards(duration=4.0)
    state, robot, dt = dmp.initial_state(), dmp.start.copy(), 0.01
    for k in range(3000):
        state = dmp.step(state, dt, rate=rate_for_lag(np.linalg.norm(state.position - robot), 0.02))
        if not 100 <= k < 300:
            robot = robot + 20 * dt * (state.position - robot)
    assert state.progress > 1.0
    assert np.abs(robot - dmp.goal).max() < 1e-9


@pytest.mark.parametrize("dt", [0.0, -0.1, np.nan, np.inf])
def test_steps_of_no_time(dt):
    dmp = random_dmp(8)
    with pytest.raises(OptionError, match="dt"):
        dmp.step(dmp.initial_state(), dt)


def test_states_that_are_none():
    dmp = random_dmp(9)
    state = dmp.initial_state()
    for change in (
        {"goal": [0.0]},
        {"position": [np.nan, 0]},
        {"duration": -1.0},
        {"slope": np.zeros((2, 2))},
    ):
        with pytest.raises(OptionError, match=next(iter(change))):
            replace(state, **change)
    with pytest.raises(OptionError, match="rate"):
        dmp.step(state, 0.1, rate=np.nan)
    with pytest.raises(OptionError, match="coupling"):
        dmp.step(state, 0.1, coupling=[1.0])


@pytest.mark.parametrize("variant", [Variant.CLOSED_FORM, Variant.DMP_PLUS_PLUS])
def test_moved_goals_while_running_backwards(variant):
    """No jump in position or velocity, neither when it moves nor when the phase passes that instant again."""
    dmp = random_dmp(10, variant)
    state = dmp.step(dmp.initial_state(), 0.6 * dmp.duration)
    back = dmp.step(state, 0.05 * dmp.duration, rate=-1.0)
    moved = dmp.step(replace(back, goal=dmp.goal + 2.0), 1e-9 * dmp.duration, rate=-1.0)
    assert np.abs(moved.velocity - back.velocity).max() * dmp.duration < 1e-4
    state = dmp.step(replace(state, goal=dmp.goal + 2.0), 0.1 * dmp.duration)
    for _ in range(2000):
        before, state = state, dmp.step(state, 1e-4 * dmp.duration, rate=-1.0)
        assert np.abs(state.slope - before.slope).max() < 0.5  # a jump here is one of several units
    for _ in range(20):
        state = dmp.step(state, 0.05 * dmp.duration, rate=-1.0)
    assert np.abs(state.position - dmp.start).max() < 1e-9


@pytest.mark.parametrize("rate", [1.0, 0.5, 0.1, 2.0, -1.0])
def test_a_coupling_is_an_acceleration_at_any_pace(rate):
    dmp, h, push = random_dmp(11), 1e-5, np.array([1.0, -2.0])
    state = dmp.step(dmp.initial_state(), 0.5 * dmp.duration)
    pushed, free = (dmp.step(state, h, rate=rate, coupling=c).velocity for c in (push, None))
    assert np.allclose((pushed - free) / h, push, rtol=1e-2)
    paused = dmp.step(state, 1.0, rate=0.0, coupling=push)
    assert np.array_equal(paused.position, state.position)


@pytest.mark.parametrize("long", [1e7, 1e18, 1e300])
def test_any_time_after_the_end(long):
    dmp = random_dmp(12)
    assert np.abs(dmp.at([long]).position - dmp.goal).max() < 1e-11
    assert np.abs(dmp.step(dmp.initial_state(), long).position - dmp.goal).max() < 1e-11
    assert not dmp.at([-1.0]).velocity.any() and np.array_equal(dmp.at([-1.0]).position[0], dmp.start)


def test_states_of_other_movements():
    with pytest.raises(OptionError, match="none of this movement"):
        random_dmp(13).step(random_dmp(13, n_dims=3).initial_state(), 0.1)
    with pytest.raises(OptionError, match="none of this movement"):
        random_dmp(13).step(None, 0.1)
    for options in ({"dt": "0.1"}, {"dt": None}, {"dt": 0.1, "rate": "fast"}, {"dt": 0.1, "rate": None}):
        with pytest.raises(OptionError):
            random_dmp(13).step(random_dmp(13).initial_state(), **options)


@examples(20)
@given(seeds, st.floats(0.05, 0.8), st.floats(0.3, 3.0), st.booleans())
def test_couplings_act_as_the_equations_say(seed, when, rate, backwards):
    """``y' = z + u, z' = alpha (beta (g - y) - z) + f + c``, integrated by an independent method at any pace."""
    dmp, rng = random_dmp(seed), np.random.default_rng(seed)
    rate = -rate if backwards else rate
    velocity, push = rng.uniform(-0.2, 0.2, (2, 2))
    state = dmp.step(dmp.initial_state(), when * dmp.duration)
    dt = 0.08 * dmp.duration / abs(rate)
    if backwards:
        dt = min(dt, 0.9 * when * dmp.duration / abs(rate))
    stepped = dmp.step(state, dt, rate=rate, coupling=push, velocity_coupling=velocity)
    span, scale = dt * abs(rate) / dmp.duration, dmp.duration / abs(rate)

    def system(s, e):
        """Of the deviation from the undisturbed movement, which both have in common."""
        return np.concatenate(
            [e[2:] + scale * velocity, -ALPHA_Y * (ALPHA_Y / 4 * e[:2] + e[2:]) + scale**2 * push]
        )

    solved = solve_ivp(system, (0, span), np.zeros(4), rtol=1e-10, atol=1e-12)
    there = dmp.at([stepped.progress * dmp.duration])
    size = 1 + np.abs(solved.y).max()
    assert np.abs(stepped.position - there.position[0] - solved.y[:2, -1]).max() < 1e-8 * size
    own = np.sign(rate) * (stepped.slope - there.velocity[0] * dmp.duration)
    assert np.abs(own - solved.y[2:, -1]).max() < 1e-7 * size


def test_couplings_in_parts_are_couplings_at_once_and_end_with_their_step():
    dmp, u = random_dmp(5), np.array([0.1, -0.3])
    whole = dmp.step(dmp.initial_state(), 0.4 * dmp.duration, velocity_coupling=u, coupling=-u)
    parts = dmp.initial_state()
    for _ in range(100):
        parts = dmp.step(parts, 0.004 * dmp.duration, velocity_coupling=u, coupling=-u)
    assert np.abs(parts.position - whole.position).max() < 1e-11
    assert np.abs(parts.slope - whole.slope).max() < 1e-9
    assert np.abs(whole.position - dmp.at([0.4 * dmp.duration]).position[0]).max() > 0.01
    later = dmp.step(whole, 4 * dmp.duration)
    assert np.abs(later.position - dmp.goal).max() < 1e-11
    paused = dmp.step(whole, 1.0, rate=0.0, velocity_coupling=u)
    assert np.array_equal(paused.position, whole.position)
    with pytest.raises(OptionError, match="velocity_coupling"):
        dmp.step(whole, 0.1, velocity_coupling=[0.0, np.nan])
