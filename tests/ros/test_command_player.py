"""The player of commands: what is late makes arms brake along their course, within their limits."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from comove.ros.command_player import CommandPlayer

PERIOD, VELOCITY, ACCELERATION = 0.004, 2.0, 5.0


def player(position) -> CommandPlayer:
    n = len(position)
    return CommandPlayer(list(position), PERIOD, [VELOCITY] * n, [ACCELERATION] * n)


def played(that: CommandPlayer, rows, more: int = 400) -> np.ndarray:
    """Joints that are commanded when these commands come in time, and then none."""
    found = []
    for number, row in enumerate(rows):
        that.put(that.run, number, list(row))
        found.append(that.tick()[0])
    return np.array([*found, *(that.tick()[0] for _ in range(more))])


def speeding_up(direction, speed: float, n_steps: int = 200) -> np.ndarray:
    """Positions from rest to a speed, along a direction."""
    rates = speed * np.minimum(
        np.arange(1, n_steps + 1) * PERIOD * ACCELERATION * 0.9 / max(speed, 1e-9), 1.0
    )
    return np.cumsum(rates * PERIOD)[:, None] * np.asarray(direction)


def test_commands_are_played_in_their_order():
    that = player([0.0, 0.0])
    rows = [[1e-3 * k, 0.0] for k in range(1, 5)]
    for number, row in enumerate(rows):
        that.put(0, number, row)
    assert [that.tick() for _ in rows] == [(row, number) for number, row in enumerate(rows)]


def test_at_rest_nothing_is_late():
    that = player([0.3])
    that.put(0, 0, [0.3])
    assert [that.tick() for _ in range(5)] == [([0.3], 0), *[([0.3], -1)] * 4]
    assert not that.why
    that.put(0, 1, [0.301])
    assert that.tick() == ([0.301], 1)


@given(speed=st.floats(0.02, 1.9), angle=st.floats(0.0, 2.0 * np.pi))
def test_it_brakes_within_the_limits_and_goes_straight_on(speed, angle):
    direction = np.array([np.cos(angle), np.sin(angle)])
    that = player([0.0, 0.0])
    rows = speeding_up(direction, speed)
    path = played(that, rows)
    rates = np.diff(np.vstack([[0.0, 0.0], path]), axis=0) / PERIOD
    assert that.has_braked and "late" in that.why
    assert np.abs(np.diff(rates, axis=0)).max() <= 1.01 * ACCELERATION * PERIOD
    assert np.abs(rates[-1]).max() == 0.0
    assert np.abs(path @ [-direction[1], direction[0]]).max() < 1e-9  # no joint stops before another
    way = np.linalg.norm(path[-1] - rows[-1])
    fastest = speed * np.abs(direction).max()
    assert way <= speed * (0.5 * fastest / (CommandPlayer.SHARE * ACCELERATION) + 2 * PERIOD)


@pytest.mark.parametrize("radius", [0.3, 1.0])
def test_the_way_to_rest_stays_on_a_curved_course(radius):
    """A course on a circle stands for joints that hold something together: leaving it tears at the payload."""
    off, straight = [], []
    for speed in (0.4, 0.2):
        angles = speeding_up([1.0], speed / radius)[:, 0]
        that = player([radius, 0.0])
        path = played(that, radius * np.stack([np.cos(angles), np.sin(angles)], axis=1))
        assert that.has_braked
        off.append(np.abs(np.linalg.norm(path, axis=1) - radius).max())
        way = np.linalg.norm(path[-1] - path[199])
        straight.append(np.hypot(radius, way) - radius)
        assert way > 0.4 * speed**2 / ACCELERATION
    assert off[0] < 0.25 * straight[0] and off[1] < 0.12 * straight[1]
    assert off[1] < off[0] / 20  # of the third order of the way, which goes with the square of the speed


def test_a_command_that_jumps_is_not_played():
    that = player([0.0])
    that.put(0, 0, [2.0 * VELOCITY * PERIOD])
    assert that.why == "a command jumps" and that.tick() == ([0.0], -1)
    for bad in (float("nan"), float("inf")):
        that = player([0.0])
        that.put(0, 0, [bad])
        assert that.why == "a command jumps"


def test_another_run_begins_when_the_arms_are_at_rest():
    that = player([0.0])
    rows = speeding_up([1.0], 0.5)
    played(that, rows, more=1)
    that.put(1, 200, [1.0])  # not yet
    while not that.has_braked:
        that.put(0, 200, list(rows[-1]))  # too late
        assert that.tick()[1] == -1
    rest = that.position[0]
    that.put(0, 201, [rest + 1e-3])
    assert that.tick() == ([rest], -1)
    that.put(1, 202, [rest + 1e-3])
    assert that.tick() == ([rest + 1e-3], 202) and that.run == 1


@given(speed=st.floats(0.02, 1.5), ahead=st.integers(0, 8))
def test_a_horizon_goes_through_what_waits_and_ends_at_rest(speed, ahead):
    that = player([0.0])
    rows = speeding_up([1.0], speed)
    played(that, rows, more=0)
    coming = [rows[-1] + (k + 1) * speed * PERIOD for k in range(ahead)]
    for number, row in enumerate(coming):
        that.put(0, 200 + number, list(row))
    horizon = np.array(that.horizon())
    np.testing.assert_allclose(horizon[:ahead, 0], np.ravel(coming))
    rates = np.diff(np.vstack([rows[-1:], horizon])[:, 0]) / PERIOD
    assert abs(rates[-1]) <= ACCELERATION * PERIOD
    assert np.abs(np.diff(rates)).max(initial=0.0) <= 1.01 * ACCELERATION * PERIOD
