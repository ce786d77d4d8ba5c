"""The least time along a path: limits hold at every instant, and nobody is faster on the same path."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.optimize import linprog

from comove.dmp import DMP, ExponentialPhase, LinearPhase, PacingSettings, Variant, largest, slowed
from comove.dmp.demonstrations import Demonstration
from comove.errors import OptionError
from tests.cases import examples

from .movements import resting_dmp

seeds = st.integers(0, 2**32 - 1)


def straight(way=1.0, direction=(3.0, 4.0)):
    """A movement from rest to rest along a line."""
    goal = way * np.array(direction) / np.linalg.norm(direction)
    still = np.zeros(len(goal))
    return DMP(np.zeros((len(goal), 5)), still, goal, still, still, 2.0)


@examples(8)
@given(seeds, st.integers(1, 4), st.floats(0.2, 1.5), st.floats(0.05, 1.5), st.sampled_from([1.0, np.inf]))
def test_limits_hold_at_every_instant_on_the_same_path(seed, n_dims, fast, hard, pace):
    """Samples far denser than the knots; accelerations by the exact derivatives of path and progress."""
    dmp = resting_dmp(seed, n_dims=n_dims)
    velocity, acceleration = (share * limit for share, limit in zip((fast, hard), largest(dmp), strict=True))
    paced = slowed(dmp, velocity=velocity, acceleration=acceleration, pace=pace)
    time = np.unique(np.concatenate([paced.time, np.linspace(0, paced.duration, 20_001)]))
    path, s = paced.at(time), paced.progress_at(time)
    assert np.abs(path.position[[0, -1]] - [dmp.start, dmp.goal]).max() < 1e-10
    assert np.abs(path.position - dmp.at(s * dmp.duration).position).max() < 1e-12
    assert (np.diff(s) > 0).all() and s[0] == 0 and s[-1] == pytest.approx(1.0, abs=1e-12)
    assert (np.abs(path.velocity) <= velocity * (1 + 1e-9)).all()
    k = np.clip(np.searchsorted(paced.time, time, side="right") - 1, 0, len(paced.time) - 2)
    push = (np.diff(paced.speed) / np.diff(paced.time))[k]
    values = np.stack([dmp.curve.at(x) for x in np.minimum(s, 1 - 1e-12)])
    speed = paced.pace_at(time) / dmp.duration
    accelerations = values[:, 1] * push[:, None] + values[:, 2] * speed[:, None] ** 2
    assert (np.abs(accelerations) <= acceleration * (1 + 1e-9)).all()
    if pace == 1.0:
        assert paced.pace_at(time).max() <= 1 + 1e-12


@pytest.mark.parametrize("way", [0.1, 0.5, 3.0])
@pytest.mark.parametrize("phase", [LinearPhase(), ExponentialPhase()])
def test_along_a_line_it_is_the_trapezoid(way, phase):
    """From rest to rest with limits v and a on the steepest coordinate: way / v + v / a, or 2 sqrt(way / a)."""
    paced = slowed(replace(straight(way), phase=phase), velocity=0.8, acceleration=1.6, pace=np.inf)
    v, a = 1.0, 2.0  # along the line, whose larger share is 4/5
    least = way / v + v / a if way > v**2 / a else 2 * np.sqrt(way / a)
    assert least * (1 - 1e-9) <= paced.duration <= 1.002 * least


def test_the_margin_is_left_free():
    settings = PacingSettings(margin=0.01)
    exact, slack = (
        slowed(straight(3.0), velocity=0.8, acceleration=1.6, pace=np.inf, settings=used)
        for used in (PacingSettings(), settings)
    )
    assert slack.duration / exact.duration == pytest.approx(np.sqrt(1.01), rel=1e-3)


@examples(6)
@given(seeds)
def test_no_progress_is_faster_by_a_linear_programme(seed):
    """The largest x everywhere, by an independent solver on a coarser grid of the same path, with its own slopes."""
    dmp = resting_dmp(seed, n_basis=6)
    velocity, acceleration = (0.6 * limit for limit in largest(dmp))
    paced = slowed(dmp, velocity=velocity, acceleration=acceleration, pace=np.inf)
    n = 400
    s = np.linspace(0, 1, n + 1)
    values = np.stack([dmp.curve.at(min(x, 1 - 1e-12)) for x in s])
    slope, bend, h = values[:, 1], values[:, 2], 1 / n
    rows, right = [], []
    for i in range(n):
        for j in (i, i + 1):
            for d in range(2):
                row = np.zeros(n + 1)
                row[i + 1], row[i] = slope[j, d] / (2 * h), -slope[j, d] / (2 * h)
                row[j] += bend[j, d]
                rows += [row / acceleration[d], -row / acceleration[d]]
                right += [1.0, 1.0]
    with np.errstate(divide="ignore"):
        cap = np.min((velocity / np.abs(slope)) ** 2, axis=1)
    cap[[0, -1]] = [cap[1], cap[-2]]
    scale = np.median(cap)
    solved = linprog(-np.ones(n + 1), np.array(rows) * scale, right,
                     bounds=[(0, min(c / scale, 1e4)) for c in cap])  # fmt: skip
    assert solved.success
    speed = np.sqrt(solved.x * scale)
    other = float((2 * h / (speed[1:] + speed[:-1])).sum())
    assert paced.duration <= 1.01 * other
    assert paced.duration >= 0.98 * other


@examples(15)
@given(seeds, st.floats(0.1, 1.0), st.floats(0.1, 1.0))
def test_it_is_never_slower_than_one_pace_all_along(seed, fast, hard):
    dmp = resting_dmp(seed)
    velocity, acceleration = (share * limit for share, limit in zip((fast, hard), largest(dmp), strict=True))
    uniform = dmp.duration * max(1 / fast, np.sqrt(1 / hard))
    assert slowed(dmp, velocity=velocity, acceleration=acceleration).duration <= uniform * (1 + 1e-6)
    free = slowed(dmp, velocity=velocity, acceleration=acceleration, pace=np.inf)
    assert free.duration <= slowed(dmp, velocity=velocity, acceleration=acceleration).duration * (1 + 1e-9)


@examples(15)
@given(seeds, st.floats(0.1, 8.0))
def test_units_of_time_and_length_do_not_matter(seed, ratio):
    """The same path shown at another pace, and in another unit, takes the same least time."""
    dmp = resting_dmp(seed)
    velocity, acceleration = (0.5 * limit for limit in largest(dmp))
    one = slowed(dmp, velocity=velocity, acceleration=acceleration, pace=np.inf).duration
    other = dmp.towards(duration=ratio * dmp.duration)
    again = slowed(other, velocity=velocity, acceleration=acceleration, pace=np.inf).duration
    assert again == pytest.approx(one, rel=1e-6)


def test_without_need_nothing_changes():
    dmp = resting_dmp(3)
    velocity, acceleration = largest(dmp)
    for paced in (slowed(dmp), slowed(dmp, velocity=2 * velocity, acceleration=2 * acceleration)):
        time = np.linspace(0, dmp.duration, 33)
        assert paced.duration == pytest.approx(dmp.duration, rel=1e-8)
        assert np.abs(paced.at(time).position - dmp.at(time).position).max() < 1e-7
        assert np.abs(paced.at(time).velocity - dmp.at(time).velocity).max() < 1e-6


def test_what_moves_at_its_ends_enters_and_leaves_at_its_own_pace_at_most():
    dmp = resting_dmp(4).towards(start_velocity=[0.4, 0.1], goal_velocity=[-0.2, 0.3])
    paced = slowed(dmp, acceleration=largest(dmp)[1], pace=np.inf)
    assert (paced.pace_at([0.0, paced.duration]) <= 1 + 1e-9).all()
    assert paced.pace_at(np.linspace(0, paced.duration, 99)).max() > 1.05


def test_online_at_the_same_pace():
    """Steps of `DMP.step` with the mean pace of each step arrive where the paced movement is."""
    dmp = DMP.fit(Demonstration.from_lasa("Angle"), n_basis=25)
    paced = slowed(dmp, velocity=20.0, acceleration=60.0)
    assert paced.duration > 1.2 * dmp.duration
    state, steps = dmp.initial_state(), np.linspace(0, paced.duration, 38)
    for time, dt in zip(steps[:-1], np.diff(steps), strict=True):
        state = dmp.step(state, dt, rate=paced.rate(time, dt))
        there = paced.at([time + dt])
        assert np.abs(state.position - there.position[0]).max() < 1e-9
    path = paced.rollout(n_steps=7)
    assert path.time[-1] == paced.duration and np.abs(path.position[-1] - dmp.goal).max() < 1e-9
    later = paced.at([paced.duration + 3.0])
    assert np.abs(later.position - dmp.goal).max() < 1e-9


def test_a_path_that_turns_back_on_itself():
    """Where a coordinate stands still and turns back, its acceleration alone limits the pace."""
    time = np.linspace(0, 2, 201)
    dmp = DMP.fit(Demonstration(time, np.sin(np.pi * time)[:, None] * np.sin(np.pi * time / 2)[:, None]))
    paced = slowed(dmp, acceleration=0.5 * largest(dmp)[1], pace=np.inf)
    assert np.isfinite(paced.time).all() and 0.5 < paced.duration / dmp.duration < np.sqrt(2)


def test_slips_are_told():
    dmp = resting_dmp(6)
    for limits in (
        {"velocity": -1.0},
        {"acceleration": [1.0]},
        {"pace": 0.0},
        {"pace": "1"},
        {"pace": np.nan},
    ):
        with pytest.raises(OptionError, match=next(iter(limits))):
            slowed(dmp, **limits)
    with pytest.raises(OptionError, match="nothing limits the pace"):
        slowed(dmp, pace=np.inf)
    still = replace(dmp, weights=0 * dmp.weights).towards(goal=dmp.start)
    assert slowed(still, velocity=1.0).duration == pytest.approx(still.duration)
    with pytest.raises(OptionError, match="stands still"):
        slowed(still, velocity=1.0, pace=np.inf)
    with pytest.raises(OptionError, match="rhythmic"):
        slowed(replace(dmp, variant=Variant.RHYTHMIC), velocity=1.0)
    with pytest.raises(OptionError, match="is no DMP of positions"):
        slowed(None, velocity=1.0)
    with pytest.raises(OptionError, match="dt"):
        slowed(dmp).rate(0.0, 0.0)
