"""What is compiled is told and counted; it costs nothing of a budget, and what is loaded from a cache is not told."""

import time

import numba
import numpy as np

from comove.model import demonstration_of, load_coordinates
from comove.planning import Comove, SceneKind, load_kernels, solve
from comove.planning.clock import LEFT
from comove.planning.compiling import Compiled, compiling
from comove.planning.method import Method
from comove.planning.methods import Plans
from tests.solved import example


def kernel():
    """A function that has to be compiled, and another that it needs; both ours by name."""

    def inner(x):
        return x + 1.0

    def outer(x):
        return inner(x) * 2.0

    for function in (inner, outer):
        function.__module__ = "comove.planning.some_kernels"
    inner = numba.njit(inner)
    return numba.njit(outer)


def test_kernels_are_told_as_they_are_compiled():
    told = []
    with compiling(told.append) as compiled:
        assert kernel()(1.0) == 4.0
    assert told == ["planning.some_kernels.outer", "planning.some_kernels.inner", ""]
    assert compiled.kernels == 2 and compiled.seconds > 0


def test_what_has_been_compiled_is_not_told_again():
    told, function = [], kernel()
    function(1.0)
    with compiling(told.append) as compiled:
        function(2.0)
    assert told == [] and compiled == Compiled()


def test_it_can_be_added_up():
    total = Compiled()
    for _ in range(2):
        with compiling(compiled=total):
            kernel()(1.0)
    assert total.kernels == 4


def test_nothing_is_compiled_once_kernels_are_loaded():
    """Neither for a scene with a demonstration nor for one without."""
    load_kernels(SceneKind(2))
    scene = example("narrow")
    dmp = demonstration_of(scene)
    with compiling() as compiled:
        found = solve(scene, demonstration=dmp, budget=60, method=Comove(n_plans=1))
    assert found.verified
    assert compiled.kernels == 0


class Slow(Method):
    """Has something compiled that takes long, and then looks at the clock."""

    name, coordinates = "slow", staticmethod(load_coordinates)

    def run(self, search, *, planner):
        """Note what is left of the budget."""
        kernel()(1.0)
        search.journal.log["took"] = search.clock.compiled.seconds
        search.clock.compiled.seconds += 1000.0  # a slower machine's
        search.journal.log["left"] = search.clock.budget.seconds - search.clock.elapsed()


def test_compiling_costs_nothing_of_a_budget():
    found = solve(example("narrow"), method=Slow(), budget=30)
    assert found.log["took"] > 0
    assert found.log["left"] > 900
    assert found.effort.seconds < 0


class Delayed(Comove):
    """Whose time seems to be up while something is compiled in the midst of planning."""

    def run(self, search, *, planner):
        """Plan with a budget that is spent until what was compiled has been counted."""
        plans, found = Plans.of(search, self), []
        search.clock.started -= 1e9
        for seconds in (0.0, 2e9):
            search.clock.compiled.seconds += seconds
            search.clock.array[LEFT] = 0.0  # the next look at the time comes at once
            found.append(plans.targets(0, 1000, search.rng) is not None)
        assert found == [False, True]
        search.journal.log["planned"] = 1.0


def test_compiling_in_the_midst_of_planning_does_not_end_it():
    assert solve(example("narrow"), method=Delayed()).log["planned"]


def test_time_stands_still_while_something_is_compiled():
    compiled = Compiled()
    with compiling(compiled=compiled):
        begun = time.process_time()
        kernel()(np.float32(1.0))
        took = time.process_time() - begun
    assert 0 < compiled.seconds <= took
