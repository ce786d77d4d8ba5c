"""The curve that is judged is the one that the transformed system moves along, by an integrator of its own."""

import numpy as np
import pytest

from comove.verification import verify
from comove.verification.bounds import node_bounds
from tests.solved import solved

ALPHA, N = 25.0, 800  # of the transformed system, and intervals between its knots
STEPS = 8  # of the integrator in each of them


def integrated(motion):
    """q and its first two derivatives at 4 N + 1 even times, by Runge and Kutta in one go from the start.

    ``q'' = a (a/4 (g - q) - q') + f``, f known at the knots and linear in between; shape (3, 4 N + 1, n_columns).
    """
    q, v, acceleration = motion.knots
    goal = motion.boundary[2]
    force = acceleration - ALPHA * (ALPHA / 4 * (goal - q) - v)

    def rates(state, own):
        return np.stack([state[1], ALPHA * (ALPHA / 4 * (goal - state[0]) - state[1]) + own])

    state, h, found = motion.boundary[:2], 1.0 / (N * STEPS), []
    for k in range(N):
        shares = np.arange(2 * STEPS + 1)[:, None] / (2 * STEPS)
        own = (1 - shares) * force[k] + shares * force[k + 1]
        for step in range(STEPS):
            before, middle, after = own[2 * step : 2 * step + 3]
            first = rates(state, before)
            if step % (STEPS // 4) == 0:
                found.append([*state, first[1]])
            second = rates(state + 0.5 * h * first, middle)
            third = rates(state + 0.5 * h * second, middle)
            fourth = rates(state + h * third, after)
            state = state + h / 6 * (first + 2 * second + 2 * third + fourth)
    found.append([*state, rates(state, force[N])[1]])
    return np.array(found).swapaxes(0, 1)


@pytest.mark.parametrize("name", ["narrow", "triangle 0"])
def test_the_curve_is_what_an_integrator_finds(name):
    motion = solved(name).attempt
    s = np.linspace(0.0, 1.0, 4 * N + 1)
    truth = integrated(motion)
    assert motion.at(s)[0] == pytest.approx(truth[0], abs=1e-8)
    assert motion.at(s)[1] == pytest.approx(truth[1], abs=1e-6)
    assert truth[0][-1] == pytest.approx(motion.boundary[2], abs=1e-8)
    assert truth[1][-1] == pytest.approx(0.0, abs=1e-6)


@pytest.mark.parametrize("name", ["narrow", "triangle 0"])
def test_what_is_said_of_speed_and_bends_holds_of_it(name):
    motion = solved(name).attempt
    report, bounds, duration = verify(motion).report, node_bounds(motion), motion.scene.duration
    nodes = motion.coordinates.motion(integrated(motion))
    hands = nodes[:, :, : len(motion.scene.manipulators)]
    speed = np.linalg.norm(hands[1], axis=2).max() / duration
    acceleration = np.linalg.norm(hands[2], axis=2).max() / duration**2
    assert speed - 1e-8 <= report.speed_max <= 1.01 * speed
    assert acceleration - 1e-6 <= report.acceleration_max <= 1.3 * acceleration
    # Between two knots a node strays from its chord by no more than the chord deviation.
    position = nodes[0].reshape(4 * N + 1, -1, 3)
    ends = position[::4]
    for quarter in (1, 2, 3):
        chord = ends[:-1] + quarter / 4 * (ends[1:] - ends[:-1])
        stray = np.linalg.norm(position[quarter::4] - chord, axis=2)
        assert (stray <= bounds.acceleration / (8 * N**2) + 1e-9).all()
