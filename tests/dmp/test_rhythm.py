"""Rhythmic movements: an exact limit cycle, into which every start runs."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

from comove.dmp import DMP
from comove.dmp.demonstrations import Demonstration
from comove.dmp.rhythm import estimated_period, rhythmic_basis
from comove.dmp.system import ALPHA_Y, N_INTERVALS
from comove.errors import OptionError
from tests.cases import examples

seeds = st.integers(0, 2**32 - 1)


def waves(time, period, seed=0):
    """Two coordinates with three harmonics about (1, 2)."""
    rng = np.random.default_rng(seed)
    angle = 2 * np.pi * np.outer(time / period, [1, 2, 3])
    amplitude = rng.uniform(-1, 1, (2, 3, 2)) / [[1], [2], [3]]
    return np.sin(angle) @ amplitude[0] + np.cos(angle) @ amplitude[1] + [1, 2]


def random_cycle(seed, n_basis=12):
    rng = np.random.default_rng(seed)
    return DMP(rng.standard_normal((2, n_basis)), *rng.uniform(-1, 1, (2, 2)), np.zeros(2), np.zeros(2),
               rng.uniform(0.5, 5), variant="rhythmic")  # fmt: skip


@examples(20)
@given(seeds, st.integers(1, 40))
def test_the_cycle_is_a_solution_and_periodic(seed, n_basis):
    dmp = random_cycle(seed, n_basis)
    curve = dmp.curve
    assert np.abs(curve.knots[:, -1] - curve.knots[:, 0]).max() < 1e-7 * (1 + np.abs(curve.knots).max())
    system = ALPHA_Y * (ALPHA_Y / 4 * (dmp.goal - curve.knots[0]) - curve.knots[1]) + curve.force
    assert np.abs(system - curve.knots[2]).max() < 1e-9 * np.abs(curve.knots[2]).max()
    for s in (0.3, 3.3, -0.7):
        assert np.abs(curve.at(s) - curve.at(0.3)).max() < 1e-9 * np.abs(curve.knots).max()


@examples(20)
@given(seeds)
def test_the_goal_is_the_centre(seed):
    dmp = random_cycle(seed)
    position = dmp.curve.knots[0]
    assert np.abs(position[:-1].mean(axis=0) - dmp.goal).max() < 1e-12 * (1 + np.abs(position).max())
    moved = dmp.towards(goal=dmp.goal + [1, -2])
    assert np.abs(moved.curve.knots[0] - position - [1, -2]).max() < 1e-12


def test_every_start_runs_into_the_cycle():
    """Against the system integrated by an independent method; the difference is gone after three periods."""
    dmp, knots = random_cycle(0), np.linspace(0, 1, N_INTERVALS + 1)

    def system(s, y):
        f = np.array([np.interp(s % 1, knots, column) for column in dmp.curve.force.T])
        return np.concatenate([y[2:], ALPHA_Y * (ALPHA_Y / 4 * (dmp.goal - y[:2]) - y[2:]) + f])

    solved = solve_ivp(
        system, (0, 1.7), np.concatenate([dmp.start, np.zeros(2)]), t_eval=[0.1, 0.6, 1.7], rtol=1e-9, atol=1e-11,
        max_step=1e-3,
    )  # fmt: skip
    played = dmp.at(dmp.duration * np.array([0.1, 0.6, 1.7]))
    assert np.abs(played.position - solved.y[:2].T).max() < 1e-6
    late = dmp.at(dmp.duration * np.array([4.2, 5.2, 9.2])).position
    assert np.abs(late - late[0]).max() < 1e-12 and np.abs(late[0] - dmp.curve.at(0.2)[0]).max() < 1e-12


def test_online_equals_the_rollout_and_a_push_returns_to_the_cycle():
    dmp = random_cycle(1)
    state = dmp.initial_state()
    for _ in range(40):
        state = dmp.step(state, 0.137 * dmp.duration)
        assert np.abs(state.position - dmp.at([state.time]).position[0]).max() < 1e-11
    pushed = replace(state, position=state.position + 0.5)
    for _ in range(10):
        pushed, state = dmp.step(pushed, 0.4 * dmp.duration), dmp.step(state, 0.4 * dmp.duration)
    assert np.abs(pushed.position - state.position).max() < 1e-12
    back = dmp.step(dmp.step(state, 0.3), 0.3, rate=-1.0)
    assert np.abs(back.position - state.position).max() < 1e-12
    centred = replace(state, goal=dmp.goal + 1.0)
    for _ in range(40):
        before, centred = centred, dmp.step(centred, 0.05 * dmp.duration)
        assert np.linalg.norm(centred.position - before.position) < 1.0
    assert np.abs(centred.position - dmp.curve.at(centred.progress)[0] - 1.0).max() < 1e-11


@examples(15)
@given(seeds, st.floats(0.3, 2.0))
def test_recordings_of_many_periods_are_learned(seed, period):
    time = np.sort(np.append(np.random.default_rng(seed).uniform(0, 7.3, 1500), [0, 7.3]))
    dmp = DMP.fit(
        Demonstration(time, waves(time, period, seed)), n_basis=25, variant="rhythmic", period=period
    )
    assert np.abs(dmp.at(time).position - waves(time, period, seed)).max() < 1e-3
    assert np.abs(dmp.goal - [1, 2]).max() < 1e-3


@pytest.mark.parametrize("seed", range(8))
@pytest.mark.parametrize("period", [0.5, 1.234, 3.3])
def test_the_period_is_found(seed, period):
    time = np.linspace(0, 7.3, 1500)
    noise = 1e-3 * np.random.default_rng(seed).standard_normal((1500, 2))
    found = estimated_period(time, waves(time, period, seed) + noise)
    assert found == pytest.approx(period, rel=2e-3)


def test_a_fit_finds_the_period_by_itself():
    time = np.linspace(0, 9.0, 2000)
    dmp = DMP.fit(Demonstration(time, waves(time, 1.7)), n_basis=25, variant="rhythmic")
    assert dmp.duration == pytest.approx(1.7, rel=1e-3)
    assert np.abs(dmp.at(time).position - waves(time, 1.7)).max() < 1e-2


def test_a_single_period_is_taken_whole():
    time = np.linspace(0, 2.0, 500)
    assert estimated_period(time, waves(time, 2.0, 3)) == 2.0
    dmp = DMP.fit(Demonstration(time, waves(time, 2.0, 3)), n_basis=20, variant="rhythmic")
    assert dmp.duration == 2.0
    assert np.abs(dmp.at(time).position - waves(time, 2.0, 3)).max() < 1e-2


def test_periods_out_of_range():
    time = np.linspace(0, 2.0, 50)
    for period in (0.0, -1.0, 2.1, np.nan, "fast"):
        with pytest.raises(OptionError, match="period"):
            DMP.fit(Demonstration(time, waves(time, 1.0)), variant="rhythmic", period=period)


def test_weights_are_harmonics():
    """Shifted functions: the even weights are cosines from the first function on, the odd ones sines."""
    basis = rhythmic_basis(8)
    velocity = basis.cycle[1, :-1]
    assert np.abs(velocity.T @ velocity / N_INTERVALS - np.eye(8)).max() < 1e-9
    spectrum = np.abs(np.fft.rfft(basis.cycle[0, :-1], axis=0))
    assert (spectrum[:6].argmax(axis=0) == np.arange(8) // 2 + 1).all()
    assert (basis.shape_force[0, ::2] > 0).all()


def test_shared_matrices_cannot_be_changed():
    basis = rhythmic_basis(9)
    assert basis is rhythmic_basis(9) and basis.n_basis == 9
    with pytest.raises(ValueError, match="read-only"):
        basis.cycle[0, 0] = 1.0
