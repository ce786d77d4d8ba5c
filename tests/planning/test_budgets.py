"""The same seed gives the same motion however slow the machine is, or the solution says that the budget ran out."""

from functools import partial
from types import SimpleNamespace

import numpy as np
import pytest

from comove.errors import OptionError
from comove.lab.evolution import Paper, Projection, combine
from comove.model import Scene
from comove.planning import Budget, Comove, LeastJerk, LeastTime, PaperCost, solve
from comove.planning.methods import Quick
from comove.processes import one_blas_thread
from comove.results.sealed import checksum
from comove.results.solution import motion_arrays
from tests.planning.two_gaps import bumps, two_gaps
from tests.slow_clock import ticking
from tests.solved import example, scene_of

TICK = 1e-3  # s of a reading of the clock, a search takes some hundreds


def door(**more):
    """A bar between walls, the gap of which is closed at first: durations are tried until it can pass."""
    walls = [{"shape": "box", "center": [0.5, y], "size": [0.05, 0.3]} for y in (0.15, 0.85)]
    moving = {"shape": "box", "center": [0.5, 0.5], "size": [0.06, 0.4], "motion": {"velocity": [0.0, 0.05]}}
    ends = [{"name": n, "start": [0.2, y], "goal": [0.8, y]} for n, y in (("a", 0.4), ("b", 0.6))]
    return Scene.from_dict(
        {
            "name": "door",
            "workspace": {"lower": [0.0, 0.0], "upper": [1.0, 1.0]},
            "limits": {"speed": 1.0, "acceleration": 3.0},
            "obstacles": [*walls, moving],
            "load": {"shape": "bar", "length": 0.2},
            "manipulators": ends,
            **more,
        }
    )


def hurried():
    """A scene whose duration is a little too short for the limits."""
    return example("narrow").timed(1.0).limited(speed=1.0, acceleration=3.0, jerk=20.0)


def peak(samples):
    """The largest height of a hand."""
    return samples.position[..., 1].max()


SEARCHES = {
    "narrow": lambda: solve(example("narrow")),
    "complex": lambda: solve(example("complex")),
    "planar": lambda: solve(scene_of("planar 3"), method=Quick()),
    "bar": lambda: solve(scene_of("bar 1"), method=Comove(n_ways=2)),
    "least time": lambda: solve(example("narrow"), objective=LeastTime(), method=Comove(n_ways=2)),
    "too short": lambda: solve(hurried(), objective=LeastJerk()),
    "equation (4)": lambda: solve(example("narrow"), objective=PaperCost(), method=Comove(n_plans=2)),
    "own function": lambda: solve(example("narrow"), objective=peak, budget=60.0, method=Comove(n_ways=1)),
    "projection": lambda: solve(example("wide"), method=Projection()),
    "paper": lambda: solve(example("wide"), method=Paper()),
    "moving": lambda: solve(door()),
    "combination": lambda: combine(bumps(), two_gaps()),
}


def outcome(search):
    """All of a solution that must not depend on the machine."""
    found = search()
    return SimpleNamespace(
        motion=checksum(motion_arrays(found.attempt)),
        verified=found.verified,
        timed_out=found.timed_out,
        reasons=found.reasons,
        work=found.effort.work,
        evaluations=found.effort.evaluations,
        generations=found.effort.generations,
    )


@pytest.mark.parametrize(
    "name", [pytest.param(n, marks=pytest.mark.slow) if n == "moving" else n for n in SEARCHES]
)
def test_a_slower_machine_comes_to_the_same_motion(name, monkeypatch):
    ticking(monkeypatch, TICK)
    once = outcome(SEARCHES[name])
    assert not once.timed_out
    ticking(monkeypatch, 4.0 * TICK)
    assert outcome(SEARCHES[name]) == once


@pytest.mark.parametrize("name", ["narrow", "too short", "moving", "combination"])
def test_a_budget_that_runs_out_is_told_of(name, monkeypatch):
    ticking(monkeypatch, 40.0)  # the second reading comes too late
    found = SEARCHES[name]()
    assert not found.verified and found.timed_out
    assert found.reasons[0] == (
        "the time budget of 30 s ran out before a motion was verified: --budget 60 lets the search go on"
    )
    assert not any("would do" in reason or "too short" in reason for reason in found.reasons)


@pytest.mark.parametrize("seconds", np.geomspace(3e-3, 3.0, 7))
def test_whatever_time_runs_out_the_motion_is_the_same_or_the_solution_says_so(seconds, monkeypatch):
    ticking(monkeypatch, TICK)
    usual = outcome(SEARCHES["complex"])
    ticking(monkeypatch, seconds)
    found = outcome(SEARCHES["complex"])
    assert found == usual or found.timed_out


def test_a_count_of_work_ends_a_search_with_the_same_motion_on_every_machine(monkeypatch):
    """Where it ends before anything is verified, too, and where it ends while a motion is improved."""
    for work in (1e-3, 0.02, 0.1):
        bounded = partial(solve, example("complex"), budget=Budget(work=work))
        ticking(monkeypatch, TICK)
        once = outcome(bounded)
        ticking(monkeypatch, 1e3)
        assert outcome(bounded) == once
        assert once.work < work + 0.1
        assert once.verified != once.timed_out


def test_the_advice_works(monkeypatch):
    """A budget that was too small, then what is advised instead."""
    ticking(monkeypatch, 0.02)
    found = solve(example("narrow"), budget=0.01)
    assert found.timed_out and "--budget 10 " in found.reasons[0]
    found = solve(example("narrow"), budget=10.0)
    assert found.verified and not found.timed_out


def test_work_is_counted_and_added_up():
    found = solve(example("narrow"), method=Quick())
    assert 0.0 < found.effort.work < 100.0 * found.effort.seconds
    assert found.after(found).effort.work == 2.0 * found.effort.work


@pytest.mark.parametrize("budget", [0, -1.0, float("nan"), float("inf"), "30", True, None])
def test_what_is_no_budget_is_refused(budget):
    with pytest.raises(OptionError, match=r"budget = .*positive number of seconds"):
        solve(example("narrow"), budget=budget)


def test_results_have_the_same_bits_whatever_threads_linear_algebra_has():
    first = outcome(SEARCHES["bar"])
    with one_blas_thread():
        assert outcome(SEARCHES["bar"]) == first
