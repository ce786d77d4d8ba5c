"""Cycles of a robot and a human: what is fixed, what is learned, and where stiffness stays low."""

from dataclasses import replace

import numpy as np
import pytest

from comove.errors import OptionError
from comove.lab.compared.cooperation import Intention, Laws, Skill, learned, run_cycle

S = np.linspace(0.0, 1.0, 401)
LAWS, DURATION, PERIOD = Laws(), 4.0, 0.002


def arc(n_dims):
    """A path on a circle about the z axis, and its derivatives; array, shape (3, n_samples, 1, n_dims)."""
    angle = np.pi * S**3 * (10 - 15 * S + 6 * S**2)
    rate, change = np.gradient(angle, S), np.gradient(np.gradient(angle, S), S)
    c, s, none = np.cos(angle), np.sin(angle), 0 * S
    path = np.stack([c, s, none], axis=1)
    slope = np.stack([-s * rate, c * rate, none], axis=1)
    bend = np.stack([-s * change - c * rate**2, c * change - s * rate**2, none], axis=1)
    return np.stack([path, slope, bend])[:, :, None, :n_dims]


def human(path, pace=1.0, stiffness=300.0):
    return Intention(path, np.full(len(S), pace), stiffness)


def cycles(skill, intentions, laws=LAWS):
    """Learn from cycles; derivatives of what was measured by differences."""
    done = []
    for intention in intentions:
        done.append(run_cycle(skill, intention, laws, DURATION, PERIOD))
        e = done[-1].wish
        slope = np.gradient(e, S, axis=0)
        skill = learned(skill, done[-1], np.stack([e, slope, np.gradient(slope, S, axis=0)]), laws)
    return skill, done


@pytest.mark.parametrize("n_dims", [2, 3])
def test_a_human_who_wants_what_was_taught_changes_nothing_but_stiffness(n_dims):
    taught = Skill.taught(arc(n_dims), LAWS)
    skill, done = cycles(taught, [human(taught.path[0])] * 15)
    assert skill.path == pytest.approx(taught.path, abs=1e-9)
    assert skill.slowness == pytest.approx(np.ones(len(S)), abs=1e-9)
    assert done[0].effort < 1e-9
    assert done[0].duration == pytest.approx(1.0, abs=2 * PERIOD / DURATION)
    assert (skill.stiffness(LAWS) > 10 * taught.stiffness(LAWS)).all()
    assert (skill.stiffness(LAWS) <= LAWS.stiffest).all()


def test_a_steady_wish_across_the_path_is_learned():
    """What is held for long shows the springs' balance: e = k_h / (k_h + k) of what is wanted."""
    taught = Skill.taught(arc(2), LAWS)
    outward = taught.path[0] * (1.0 + 0.02 * 16 * (S**2 * (1 - S) ** 2)[:, None, None])
    skill, done = cycles(taught, [human(outward)] * 12)
    k = taught.stiffness(LAWS)[200, 0, 1]
    assert np.linalg.norm(done[0].deviation[200, 0]) == pytest.approx(0.02 * 300 / (300 + k), rel=0.05)
    assert np.linalg.norm(skill.path[0, 200, 0]) == pytest.approx(1.02, abs=3e-3)
    assert done[-1].effort < 0.5 * done[0].effort


def test_a_pace_is_learned_and_not_confused_with_the_path():
    taught = Skill.taught(arc(2), LAWS)
    skill, done = cycles(taught, [human(taught.path[0], pace=1.5)] * 12)
    assert skill.slowness[100:300] == pytest.approx(np.full(200, 1 / 1.5), rel=0.05)
    assert skill.path[0] == pytest.approx(taught.path[0], abs=1e-9)
    assert done[-1].duration == pytest.approx(1 / 1.5, rel=0.05)
    assert done[0].duration > done[-1].duration


@pytest.mark.parametrize("n_cycles", [15, 60])
def test_stiffness_stays_low_where_and_along_what_the_human_varies(n_cycles):
    """She varies along the binormal in the second half only; a robot that is stiff elsewhere still sees it."""
    rng, taught = np.random.default_rng(0), Skill.taught(arc(3), LAWS)
    window = np.where(S > 0.5, np.sin(2 * np.pi * (S - 0.5)) ** 2, 0.0)
    wishes = []
    for _ in range(n_cycles):
        path = taught.path[0].copy()
        path[:, 0, 2] += 0.03 * rng.standard_normal() * window
        wishes.append(human(path))
    k = cycles(taught, wishes)[0].stiffness(LAWS)[:, 0]
    varied, calm = S.searchsorted(0.75), S.searchsorted(0.25)
    assert k[varied, 2] < 0.6 * k[calm, 2]
    if n_cycles == 15:  # after many the path itself has left its plane there, and the axes have turned
        assert k[varied, 2] < 0.6 * k[varied, 1]
        assert k[calm, 2] == pytest.approx(k[calm, 1], rel=1e-3)


@pytest.mark.parametrize("stiff", [100.0, 2000.0])
def test_what_the_human_wants_is_known_however_stiff_the_robot_is(stiff):
    """From the deviation and the robot's own force, where both forces balance."""
    laws = replace(LAWS, softest=stiff, stiffest=stiff)
    taught = Skill.taught(arc(2), laws)
    off = 0.02 * 16 * (S**2 * (1 - S) ** 2)[:, None, None]
    cycle = run_cycle(taught, human(taught.path[0] * (1 + off), pace=1.2), laws, DURATION, PERIOD)
    assert np.linalg.norm(cycle.wish[200, 0]) == pytest.approx(0.02, rel=0.1)
    assert np.linalg.norm(cycle.deviation[200, 0]) == pytest.approx(0.02 * 300 / (300 + stiff), rel=0.05)
    assert cycle.slowness_wish[100:300] == pytest.approx(np.full(200, 1 / 1.2), rel=1e-3)


def test_turned_paths_have_the_same_stiffness():
    turn = np.linalg.qr(np.random.default_rng(1).standard_normal((3, 3)))[0]
    turn *= np.sign(np.linalg.det(turn))
    taught = Skill.taught(arc(3), LAWS)
    off = np.stack([np.sin(np.pi * S) ** 2] * 3, axis=1)[:, None] * [0.01, -0.02, 0.03]
    plain, _ = cycles(taught, [human(taught.path[0] + off)] * 3)
    turned, _ = cycles(
        replace(taught, path=taught.path @ turn.T), [human((taught.path[0] + off) @ turn.T)] * 3
    )
    assert turned.path[0] == pytest.approx(plain.path[0] @ turn.T, abs=1e-9)
    assert turned.stiffness(LAWS) == pytest.approx(plain.stiffness(LAWS), rel=1e-6)


@pytest.mark.parametrize("period", [0.001, 0.005, 0.01])
def test_the_period_hardly_matters(period):
    taught = Skill.taught(arc(2), LAWS)
    wanted = human(1.02 * taught.path[0], pace=1.2)
    fine, coarse = (run_cycle(taught, wanted, LAWS, DURATION, dt) for dt in (0.0005, period))
    assert coarse.deviation == pytest.approx(fine.deviation, abs=1e-3)
    assert coarse.effort == pytest.approx(fine.effort, rel=0.05)


@pytest.mark.parametrize("wrong", [{"learning": 1.5}, {"softest": 3000.0}, {"spread": 0.0}])
def test_laws_out_of_range_are_told(wrong):
    with pytest.raises(OptionError, match=next(iter(wrong))):
        Laws(**wrong)
