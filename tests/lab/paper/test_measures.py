"""Smoothness and turns of motions whose figures are known."""

from itertools import combinations

import numpy as np
import pytest

from comove.dmp import motion_basis
from comove.lab.examples import example
from comove.lab.paper.jobs import scene_of
from comove.lab.paper.measures import follow, largest_turn, measure_motion, squared_jerk
from comove.lab.paper.runs import ReproductionPlan, taught_at_once
from comove.model.coordinated_dmp import CoordinatedDMP
from comove.model.coordinates import arms_coordinates
from comove.model.motion import CoordinatedMotion
from comove.planning.seeds import minimum_jerk


def fitted(scene, hands_of):
    """Free hands that follow a function of normalised time."""
    coordinates, s = arms_coordinates(scene), np.linspace(0.0, 1.0, 401)
    dmp = CoordinatedDMP(
        scene, coordinates, motion_basis(60, "velocity"), coordinates.boundary(), np.zeros(0)
    )
    return dmp.fitted(s, coordinates.from_hands(hands_of(s))).rollout()


def test_the_jerk_of_minimum_jerk():
    scene = example("wide")
    motion = fitted(
        scene, lambda s: scene.start + minimum_jerk(s)[:, None, None] * (scene.goal - scene.start)
    )
    # Two hands go 0.7 m in 10 s: the integral is 720 L^2 / T^5 for each.
    assert squared_jerk(motion) == pytest.approx(
        2 * 720 * 0.7**2 / 10.0**5, rel=0.06
    )  # the fit is smoother at its ends
    assert largest_turn(motion) == pytest.approx(0.0, abs=1e-6)


def test_what_turns_and_what_is_off():
    scene = scene_of("narrow", tolerance=0.002)

    def hands(s):
        middle = scene.start.mean(axis=0) + minimum_jerk(s)[:, None] * (scene.goal - scene.start).mean(axis=0)
        angle = np.pi / 2 - 0.5 * np.sin(np.pi * s) ** 2
        half = (0.1 + 0.01 * np.sin(np.pi * s) ** 2)[:, None] * np.stack(
            [np.cos(angle), np.sin(angle)], axis=1
        )
        return np.stack([middle - half, middle + half], axis=1)

    motion = fitted(scene, hands)
    measures, along = measure_motion(motion), follow(motion, 0.01)
    assert measures.turn == pytest.approx(0.5, abs=0.01)
    assert measures.distance_error == pytest.approx(0.02, abs=1e-3)
    assert not measures.verified
    assert along.error == pytest.approx(0.02, abs=1e-3)
    assert along.error_near > along.error_far, "in the gap, half-way, the distance is off most"
    assert along.at_start == pytest.approx(2 * 0.7**2) and along.at_end == pytest.approx(0.0, abs=1e-12)


def test_a_scene_is_changed_where_it_is_asked_for_alone():
    changed, plain = scene_of("narrow", tolerance=0.01, acceleration=2.0), scene_of("narrow")
    assert [c.tolerance for c in changed.distances] == [0.01]
    assert (changed.acceleration_limit, plain.acceleration_limit) == (2.0, np.inf)
    assert plain.sha256 == example("narrow").sha256
    assert len(scene_of("open").obstacles) == 0
    assert measure_motion(CoordinatedMotion.straight(plain)).clearance < 0


def test_hands_that_are_recorded_at_once_hold_the_bar():
    """Nothing ties the hands: the recordings keep their distance, within the band, and no two are alike."""
    plan = ReproductionPlan(1)
    taught = [taught_at_once(number, plan.band) for number in range(plan.at_once)]
    assert all(measure_motion(motion).verified for motion in taught)
    assert all(np.rad2deg(measure_motion(motion).turn) > 20.0 for motion in taught)
    middles = [motion.trajectory().position.mean(axis=1) for motion in taught]
    assert min(np.abs(a - b).max() for a, b in combinations(middles, 2)) > 1e-3
