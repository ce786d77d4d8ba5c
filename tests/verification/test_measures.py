"""Measures of smoothness against what is known of minimum jerk, and their invariances."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import comove
from comove import LeastJerk, PaperCost
from comove.dmp.basis import motion_basis
from comove.model import CoordinatedMotion, Scene, load_coordinates
from comove.verification.measures import smoothness, spectral_arc_length
from tests.solved import example

S = np.linspace(0.0, 1.0, 801)
BELL = 30 * S**2 * (1 - S) ** 2  # the speed of minimum jerk


def straight(duration=2.0, way=0.6):
    scene = Scene.from_dict(
        {
            "name": "straight",
            "duration": duration,
            "workspace": {"lower": [-9, -9], "upper": [9, 9]},
            "manipulators": [{"name": "a", "start": [0, 0], "goal": [way, 0]}],
        }
    )
    coordinates, basis = load_coordinates(scene), motion_basis(10, "jerk")
    return CoordinatedMotion(scene, coordinates, basis, coordinates.boundary(), np.zeros((2, 10)))


@given(st.floats(0.1, 100.0), st.floats(0.01, 5.0))
def test_minimum_jerk(duration, way):
    """Its jerk is 60 L/T^3 at the ends, its integrated square 720 L^2/T^5; it is half done after half the time."""
    found = smoothness(straight(duration, way))
    assert 1.0 - 1e-9 <= found.jerk_max / (60 * way / duration**3) < 1.02  # a bound
    assert found.jerk_squared == pytest.approx(720 * way**2, rel=2e-3)
    assert found.jerk_ratio == pytest.approx(1.0, rel=2e-3)
    assert found.halfway == pytest.approx(0.5, abs=1e-4)
    assert 0.7 < found.nearly_there < 0.85


def test_spectral_arc_length_of_known_speeds():
    """Less smooth, farther from 0: one bell, two, four; the size of a movement does not matter."""
    one, two, four = (spectral_arc_length(np.interp((n * S) % 1.0, S, BELL)) for n in (1, 2, 4))
    assert -1.6 < one < -1.3
    assert one > two > four
    assert spectral_arc_length(7.0 * BELL) == pytest.approx(one)
    assert spectral_arc_length(0.0 * BELL) == 0.0


def test_objectives_are_told_apart():
    smooth, paper = (
        smoothness(comove.solve(example("narrow"), objective=objective).attempt)
        for objective in (LeastJerk(), PaperCost())
    )
    assert smooth.jerk_ratio < 1e-3 * paper.jerk_ratio
    assert smooth.jerk_max < 1e-2 * paper.jerk_max
    assert smooth.halfway > paper.halfway + 0.1
    assert smooth.nearly_there > paper.nearly_there + 0.3
