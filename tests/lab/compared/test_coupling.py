"""Learned coupling: published figures, exact steps, stability, and who moves for whom."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.linalg import expm

from comove.dmp.system import OMEGA
from comove.errors import OptionError
from comove.lab.compared.leader_follower import Gains, learn, run_epoch, spectral_radius, transition

DISTANCE, DURATION = 0.5, 2.0  # m, s
LEADS, BOTH = np.array([0.0, 1.0]), np.array([1.0, 1.0])


def planar_pair(period, rms=0.182):
    """A straight leader, and one beside it at the distance who leaves by a smooth bump of that root mean square."""
    s = np.linspace(0.0, 1.0, round(DURATION / period) + 1)
    bump = np.sin(np.pi * s) ** 2
    bump *= rms / np.sqrt(np.mean(bump**2))
    way = s**3 * (10 - 15 * s + 6 * s**2)
    return np.stack([np.stack([way, 0 * s], axis=1), np.stack([way, DISTANCE + bump], axis=1)], axis=1)


def epochs(uncoupled, gains, following, count):
    """Root mean square errors of so many epochs."""
    learned, errors = np.zeros((len(uncoupled), uncoupled.shape[2])), []
    for _ in range(count):
        run = run_epoch(uncoupled, DISTANCE, following, learned, gains)
        errors.append(run.error_rms)
        learned = learn(learned, run.force, gains)
    return errors


def test_the_published_table():
    """Errors at epochs 1, 2, 4 and 6, and at 6 with nothing forgotten. The published movement is not known; any slow
    one whose uncoupled error has the root mean square 0.18 m gives the figures, to what its frequencies change."""
    pair = planar_pair(0.002)
    errors = epochs(pair, Gains(coupling=20.0, derivative=1.0, forgetting=0.99), LEADS, 6)
    assert [errors[i] for i in (0, 1, 3, 5)] == pytest.approx([4.5e-2, 1.1e-2, 1.1e-3, 6e-4], rel=0.1)
    kept = epochs(pair, Gains(coupling=20.0, derivative=1.0, forgetting=1.0), LEADS, 6)
    assert kept[5] == pytest.approx(4.4e-5, rel=0.25)


def test_slow_movements_gain_the_same_factor_in_every_epoch():
    """For slow errors the pair is a spring: beta = alpha / 4 against c, so each epoch leaves 1 / (1 + c / beta)."""
    beta = OMEGA / 2
    for c in (5.0, 20.0, 60.0):
        n = 4001
        pair = np.zeros((n, 2, 1))
        pair[:, 1, 0] = DISTANCE + 0.1 * np.sin(np.pi * np.linspace(0.0, 1.0, n)) ** 4
        gains, learned = Gains(coupling=c, forgetting=1.0), np.zeros((n, 1))
        middle = []
        for _ in range(3):
            run = run_epoch(pair, DISTANCE, LEADS, learned, gains)
            middle.append(run.error_rms)
            learned = learn(learned, run.force, gains)
        left = 1 / (1 + c / beta)
        assert middle[1] / middle[0] == pytest.approx(left, rel=0.25)
        assert middle[0] == pytest.approx(left * np.sqrt(np.mean((pair[:, 1, 0] - DISTANCE) ** 2)), rel=0.25)


def test_strong_coupling_of_accelerations_diverges_at_two_milliseconds():
    gains = Gains(coupling=100.0, derivative=30.0)
    assert spectral_radius(gains, 1, 0.002 / DURATION) > 1.0 > spectral_radius(gains, 1, 0.001 / DURATION)
    with np.errstate(all="ignore"):
        assert not epochs(planar_pair(0.002), gains, LEADS, 1)[0] < 1.0
    assert epochs(planar_pair(0.001), gains, LEADS, 1)[0] < 0.01


@pytest.mark.parametrize("period", [0.001, 0.002, 0.005, 0.01])
@pytest.mark.parametrize("derivative", [0.0, 1.0])
@pytest.mark.parametrize("following", [LEADS, BOTH], ids=["leader", "mutual"])
def test_stable_over_control_periods(period, derivative, following):
    gains = Gains(derivative=derivative)
    assert spectral_radius(gains, int(following.sum()), period / DURATION) < 1.0
    errors = epochs(planar_pair(period), gains, following, 30)
    assert np.argmin(errors) > 2
    assert errors[-1] < 1e-3
    assert max(errors[10:]) < 1.05 * min(errors[10:])  # settled on what is forgotten


@pytest.mark.parametrize(("derivative", "n_following"), [(0.0, 1), (2.0, 1), (0.0, 2), (7.0, 2)])
def test_the_spectral_radius_is_the_growth_of_a_run(derivative, n_following):
    """Of a small disturbance along the line of the hands, in one dimension, where all is linear."""
    gains, n = Gains(coupling=150.0, derivative=derivative), 401
    pair = np.zeros((n, 2, 1))
    pair[:, 1, 0] = 1.0
    pair[0, 1, 0] += 1e-7
    following = LEADS if n_following == 1 else BOTH
    error = np.abs(run_epoch(pair, 1.0, following, np.zeros((n, 1)), gains).error)
    radius = spectral_radius(gains, n_following, 1 / (n - 1))
    late = slice(20, 60) if radius < 1 else slice(3, 9)
    growth = np.exp(np.polyfit(np.arange(n)[late], np.log(error[late] + 1e-300), 1)[0])
    assert growth == pytest.approx(radius, rel=0.02)


@pytest.mark.parametrize("h", [1e-4, 1e-3, 0.02, 0.3])
def test_the_step_is_that_of_the_matrix_exponential(h):
    system = np.array([[0.0, 1.0, 1.0], [-(OMEGA**2), -2 * OMEGA, 0.0], [0.0, 0.0, 0.0]])
    whole = expm(h * system)
    of_state, of_coupling = transition(h)
    assert of_state == pytest.approx(whole[:2, :2], abs=1e-12)
    assert of_coupling == pytest.approx(whole[:2, 2], abs=1e-12)


def test_short_periods_come_near_the_continuous_equations():
    """Against scipy's integrator on the equations of the module, velocity level, mutual, in the plane."""
    n, c = 4001, 15.0
    pair = planar_pair(DURATION / (n - 1))
    s = np.linspace(0.0, 1.0, n)

    def rates(t, state):
        e, zeta = state.reshape(2, 2, 2)  # e, zeta; hand; axis
        at = np.array([[np.interp(t, s, pair[:, i, d]) for d in range(2)] for i in range(2)])
        away = at[1] + e[1] - at[0] - e[0]
        length = np.linalg.norm(away)
        force = c * (DISTANCE - length) * away / length
        pull = np.stack([-force, force])
        return np.stack([zeta + pull, -(OMEGA**2) * e - 2 * OMEGA * zeta]).ravel()

    solution = solve_ivp(rates, (0.0, 1.0), np.zeros(8), t_eval=s[::400], rtol=1e-8, atol=1e-10)
    expected = pair[::400] + solution.y[:4].T.reshape(-1, 2, 2)
    found = run_epoch(pair, DISTANCE, BOTH, np.zeros((n, 2)), Gains(coupling=c)).position[::400]
    assert found == pytest.approx(expected, abs=3e-4)


def test_without_coupling_nothing_happens():
    pair = planar_pair(0.01)
    run = run_epoch(pair, DISTANCE, BOTH, np.zeros((len(pair), 2)), Gains(coupling=0.0))
    assert np.array_equal(run.position, pair)


def test_a_leader_leads_and_equals_share():
    pair = planar_pair(0.01)
    nothing = np.zeros((len(pair), 2))
    led = run_epoch(pair, DISTANCE, LEADS, nothing, Gains()).position
    assert np.array_equal(led[:, 0], pair[:, 0])
    assert np.abs(led[:, 1] - pair[:, 1]).max() > 0.05
    shared = run_epoch(pair, DISTANCE, BOTH, nothing, Gains()).position
    assert shared.mean(axis=1) == pytest.approx(pair.mean(axis=1), abs=1e-12)


def test_turned_movements_give_turned_movements():
    rng = np.random.default_rng(0)
    turn = np.linalg.qr(rng.standard_normal((3, 3)))[0]
    pair = np.concatenate([planar_pair(0.01), np.zeros((201, 2, 1))], axis=2)
    pair[:, 1, 2] += 0.1 * np.sin(np.pi * np.linspace(0, 1, 201)) ** 2
    learned = 0.01 * rng.standard_normal((201, 3))
    plain = run_epoch(pair, DISTANCE, LEADS, learned, Gains(derivative=0.5)).position
    turned = run_epoch(pair @ turn.T, DISTANCE, LEADS, learned @ turn.T, Gains(derivative=0.5)).position
    assert turned == pytest.approx(plain @ turn.T, abs=1e-12)


@pytest.mark.parametrize(("name", "value"), [("coupling", -1.0), ("forgetting", 1.1), ("learning", np.nan)])
def test_gains_out_of_range_are_told(name, value):
    with pytest.raises(OptionError, match=name):
        Gains(**{name: value})
