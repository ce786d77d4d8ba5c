"""Plans that are computed while paths are smoothed."""

import subprocess
import sys
import threading
import time
from pathlib import Path

import numpy as np
import pytest

import comove
from comove.planning import ahead
from comove.planning.ahead import PlansAhead, drawn
from comove.planning.clock import MOST, WORK, Budget, clock_until, worked
from comove.planning.search import SearchClock
from comove.processes import ALONE
from tests.solved import example


@pytest.fixture(autouse=True)
def with_others(monkeypatch):
    """Other cores may help, as outside of tests."""
    monkeypatch.delenv(ALONE, raising=False)


class Asked:
    """What `PlansAhead` asks of a search."""

    def __init__(self, budget=None):
        self.clock, self.rng = SearchClock(budget or Budget()), np.random.default_rng(0)
        self.spent = False

    def over(self):
        return self.spent


def endless(clock):
    """A planner that ends when its clock says so."""

    def targets(failures, max_nodes, rng):
        while not worked(clock, 1):
            time.sleep(1e-4)

    return targets


def draws(clock):
    """A planner whose plans are random numbers, and work."""

    def targets(failures, max_nodes, rng):
        worked(clock, max_nodes)
        return None if failures == 1 else (rng.random(3), np.zeros(failures))

    return targets


@pytest.mark.parametrize("cores", [1, 2])
def test_plans_are_those_of_their_generator_whatever_was_drawn_meanwhile(cores, monkeypatch):
    monkeypatch.setattr(ahead, "n_processors", lambda: cores)
    search, expected = Asked(), np.random.default_rng(0).spawn(1)[0]
    plans = PlansAhead(search, draws, 3)
    assert plans.taken() is None
    plans.begin(0, 50)
    search.rng.random(100)
    found = plans.taken()
    plans.close()
    np.testing.assert_array_equal([targets for targets, _ in found], [expected.random(3) for _ in range(3)])
    assert search.clock.array[WORK] == 150  # the work of all three
    assert plans.taken() is None


def test_plans_end_with_the_first_that_fails():
    plans = list(drawn(draws(clock_until()), 3, 1, 1, np.random.default_rng(0)))
    assert plans == [None]


def test_plans_have_the_work_that_was_left_when_they_were_begun(monkeypatch):
    monkeypatch.setattr(ahead, "n_processors", lambda: 2)
    search = Asked(Budget(work=1e-4))
    search.clock.add_work(1000.0)
    plans = PlansAhead(search, draws, 1)
    plans.begin(0, 1)
    plans.taken()
    plans.close()
    assert plans.clock[MOST] == search.clock.array[MOST] - 1000.0


@pytest.mark.parametrize("end", ["search", "close"])
def test_an_endless_plan_ends_with_its_search(end, monkeypatch):
    monkeypatch.setattr(ahead, "n_processors", lambda: 2)
    search = Asked()
    plans = PlansAhead(search, endless, 2)
    plans.begin(0, 1)
    if end == "search":
        search.spent = True
        assert plans.taken() == [None]
    plans.close()
    assert not [thread for thread in threading.enumerate() if thread.name.startswith("comove-plans")]


ROOT = Path(__file__).parents[2]
OUTLIVING = """
import threading
import comove
from tests.solved import example

def work():
    threading.main_thread().join()
    print(comove.solve(example("complex"), budget=20.0).verified is not None)

threading.Thread(target=work).start()
"""


def test_a_search_may_outlive_the_main_thread():
    done = subprocess.run(
        [sys.executable, "-c", OUTLIVING], capture_output=True, text=True, timeout=600, cwd=ROOT
    )
    assert (done.returncode, done.stdout, done.stderr) == (0, "True\n", "")


@pytest.mark.parametrize("name", ["complex", "window"])
def test_a_search_with_one_core_finds_what_one_with_many_finds(name, monkeypatch):
    found, begun, begin = [], [], PlansAhead.begin
    monkeypatch.setattr(PlansAhead, "begin", lambda *args: begun.append(args) or begin(*args))
    for cores in (1, 2):
        monkeypatch.setattr(ahead, "n_processors", lambda cores=cores: cores)
        found.append(comove.solve(example(name), seed=3, budget=Budget(work=1.0)))
    one, many = found
    assert begun, "no plan was begun ahead"
    assert one.effort.work == many.effort.work
    np.testing.assert_array_equal(one.motion.motion.weights, many.motion.motion.weights)
