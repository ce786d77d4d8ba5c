"""Motions of least cost by equation (4): verified, cheaper than fits, and no dearer with more weights."""

from dataclasses import replace

import numpy as np
import pytest

import comove
from comove import PaperCost
from comove.lab.systems import cost_of
from comove.planning.clock import Budget
from comove.planning.methods import SETTINGS, Comove
from tests.planning.test_solver import limited
from tests.solved import example


def cost(solution):
    return float(cost_of(solution.scene, solution.attempt.hands(np.linspace(0.0, 1.0, 201))[0]))


@pytest.mark.parametrize("name", ["narrow", "triangle"])
def test_polished_motions_are_verified_and_cheaper_whatever_the_weights(name):
    """A hundred weights can do all that thirty can."""
    unpolished = Comove(settings=replace(SETTINGS, n_polished=0))
    methods = unpolished, Comove(), Comove(n_basis=100)
    fitted, few, many = (
        comove.solve(example(name), method=method, objective=PaperCost()) for method in methods
    )
    assert few.verified
    assert many.verified
    assert cost(few) < 0.95 * cost(fitted)
    assert cost(many) < 1.02 * cost(few)


def test_equation_4_pays_for_no_clearance():
    """At a minimum the load all but touches the margin."""
    solution = comove.solve(example("narrow"), objective=PaperCost())
    assert 0.0 <= solution.report.clearance_min < 3e-3


@pytest.mark.parametrize(("name", "acceleration"), [("narrow", 0.1), ("complex", 0.2)])
def test_limits_that_no_fit_keeps_are_kept_by_the_least_jerk(name, acceleration):
    """Seldom does any of the time profiles keep them; a second's work suffices all the same."""
    scene = limited(name, acceleration=acceleration)
    solution = comove.solve(scene, objective=PaperCost(), budget=Budget(work=1.0))
    assert solution.verified
    assert solution.report.acceleration_max <= acceleration
