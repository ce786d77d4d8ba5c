"""Filters of what moves: they know a motion that lasts, notice when it ends, and know what they do not know."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.stats import chi2

from comove.control.filters import Expectations, informed, later, unknown
from comove.control.observers import Turning

AGILITY, FASTEST, SHARPEST, NOISE, DT = 0.5, 0.5, 1.2, 0.01, 0.01
EXPECTED = Expectations(AGILITY, FASTEST, SHARPEST)
SPREAD = np.repeat([10.0, FASTEST, SHARPEST], 3) ** 2


def followed(way, rng, spread=SPREAD):
    """What is believed after every measurement of a way, array of shape (n_times, n, 3) [m]."""
    belief = unknown(np.zeros(way.shape[1:]), np.tile(spread, (way.shape[1], 1)))
    for k, places in enumerate(way):
        if k:
            belief = later(belief, np.full(len(places), DT), EXPECTED)
        noise = NOISE * rng.standard_normal(places.shape) * (spread[:3] > 0.0)
        belief = informed(belief, places + noise, NOISE**2, EXPECTED)
        yield belief


def helix(_, y, turn):
    return np.concatenate([y[3:], np.cross(turn, y[3:])])


@pytest.mark.parametrize("turn", [[0.0, 0.0, 0.0], [1e-5, 0.0, 2e-5], [0.5, -2.0, 1.0], [0.0, 0.0, 6.0]])
def test_what_turns_steadily_goes_along_a_helix(turn):
    rng = np.random.default_rng(0)
    position, velocity = rng.standard_normal(3), rng.standard_normal(3)
    belief = unknown(position[None], np.zeros((1, 9)))
    belief.state[:, :, 3:] = np.concatenate([velocity, turn])
    there = later(belief, np.array([0.7]), EXPECTED)
    exact = solve_ivp(
        helix, (0, 0.7), np.concatenate([position, velocity]), args=(np.array(turn),), rtol=1e-11, atol=1e-12
    )
    np.testing.assert_allclose(there.state[0, 0, :6], exact.y[:, -1], atol=1e-8)
    assert not there.covariance.any(), "what cannot be does not come about"


def test_covariances_go_along_with_the_motion():
    """In linear order: their square roots are carried by the derivative of the way."""
    rng, dt = np.random.default_rng(1), np.array([0.01])
    state = rng.standard_normal(9)
    belief = unknown(np.zeros((1, 3)), np.full((1, 9), 1e-4))
    belief.state[:] = state
    small, columns = 1e-5, []
    for k in range(9):
        ends = []
        for sign in (-1, 1):
            belief.state[:] = state + sign * small * np.eye(9)[k]
            ends.append(later(belief, dt, Expectations(0.0, FASTEST, 0.0)).state[0, 0])
        columns.append((ends[1] - ends[0]) / (2 * small))
    derivative = np.array(columns).T
    belief.state[:] = state
    carried = later(belief, dt, Expectations(0.0, FASTEST, 0.0)).covariance[0, 0]
    np.testing.assert_allclose(carried, 1e-4 * derivative @ derivative.T, atol=2e-8)


@pytest.mark.parametrize("radius", [0.1, 0.25, np.inf])
def test_a_motion_that_lasts_is_foreseen(radius):
    """Turns about any axis, as seen for two seconds through noise of 1 cm, and 1 s ahead."""
    rng, n, speed = np.random.default_rng(2), 40, 0.4
    frames = np.linalg.qr(rng.standard_normal((n, 3, 3)))[0]
    spin = speed / radius * frames[:, :, 0]
    moves = [Turning(speed * f[:, 1], s, 0.0) for f, s in zip(frames, spin, strict=True)]
    way = np.stack([m.offsets(np.arange(200) * DT) for m in moves], axis=1)
    *_, belief = followed(way, rng)
    assert np.median(np.linalg.norm(belief.spin - spin, axis=1)) < 0.2
    foreseen = later(belief, np.ones(n), EXPECTED).position
    true = np.stack([m.offsets([1.99 + 1.0])[0] for m in moves])
    assert np.median(np.linalg.norm(foreseen - true, axis=1)) < 0.04


def test_a_sudden_change_is_noticed():
    """Back and forth at 0.5 m/s: 0.17 s after the turn most of the new velocity is known."""
    rng, n = np.random.default_rng(3), 60
    time = np.arange(300) * DT
    there = 0.5 * (np.minimum(time, 2.0) - np.maximum(time - 2.0, 0.0))
    direction = np.linalg.qr(rng.standard_normal((n, 3, 3)))[0][:, 0]
    beliefs = list(followed(there[:, None, None] * direction, rng))
    before, after = (
        np.linalg.norm(beliefs[k].velocity - v * direction, axis=1) for k, v in ((199, 0.5), (217, -0.5))
    )
    assert np.median(before) < 0.03
    assert np.median(after) < 0.2
    off = np.linalg.norm([b.position - x * direction for b, x in zip(beliefs, there, strict=True)], axis=2)
    assert np.median(off[200:].max(axis=0)) < 0.035, "of the 20 cm that it has gone back within 0.2 s"


def test_they_know_how_well_they_know():
    """Of motions as the steady filter expects them, errors are as large as it says (NEES; Bar-Shalom, 5.4)."""
    rng, n = np.random.default_rng(4), 200
    state, way = np.zeros((1, n, 9)), []
    state[..., 3:6], state[..., 6:] = (
        0.5 * rng.standard_normal((n, 3)),
        SHARPEST * rng.standard_normal((n, 3)),
    )
    start = unknown(np.zeros((n, 3)), np.zeros((n, 9)))
    for _ in range(150):
        way.append(state[0].copy())
        start.state[:] = state
        state = later(start, np.full(n, DT), EXPECTED).state[:1].copy()
        state[..., 3:6] += np.sqrt(EXPECTED.calm * AGILITY * DT) * rng.standard_normal((n, 3))
        state[..., 6:] += np.sqrt((EXPECTED.drift * SHARPEST) ** 2 * DT) * rng.standard_normal((n, 3))
    way = np.array(way)
    *_, belief = followed(way[:, :, :3], rng)
    off = belief.state[0] - way[-1]
    nees = np.einsum("ni,ni->n", off, np.linalg.solve(belief.covariance[0], off[..., None])[..., 0])
    assert 0.4 * 9 < np.median(nees) < 1.6 * 9
    assert (nees < chi2(9).ppf(0.999)).mean() > 0.93, (
        "few have just begun anew, or bend too much for first order"
    )


def test_what_is_in_the_plane_stays_there():
    rng, spread = np.random.default_rng(5), SPREAD * np.array([1, 1, 0, 1, 1, 0, 0, 0, 1])
    way = np.cumsum(np.full((100, 3, 3), 0.003) * [1, 1, 0], axis=0)
    *_, belief = followed(way, rng, spread)
    assert not belief.state[:, :, [2, 5, 6, 7]].any()
    assert not belief.covariance[:, :, 2].any()
    assert (np.linalg.eigvalsh(belief.covariance) > -1e-12).all()
