"""Warps of time keep the way and make it cheaper."""

from dataclasses import replace

import numpy as np
import pytest

import comove
from comove.dmp.basis import motion_basis
from comove.model.coordinates import load_coordinates
from comove.planning.convex.costs import squares
from comove.planning.convex.programme import ConvexProgramme, ConvexSettings
from comove.planning.convex.warp import interpolated, warped
from comove.planning.objectives import LeastJerk

SCENE = {
    "name": "open",
    "duration": 5.0,
    "workspace": {"lower": [-1, -1], "upper": [2, 2]},
    "load": {"shape": "bar", "length": 0.2},
    "manipulators": [
        {"name": "a", "start": [0, 0], "goal": [1, 0.4]},
        {"name": "b", "start": [0, 0.2], "goal": [1, 0.6]},
    ],
}


@pytest.fixture(scope="module")
def programme():
    scene = comove.Scene.from_dict(SCENE)
    coordinates = load_coordinates(scene)
    return ConvexProgramme(scene, coordinates, motion_basis(24, "jerk"), coordinates.boundary())


def along(programme, s):
    """Weights of a curved way that is run through as the shares `s` say, array of shape (n_fine,)."""
    base = programme.curves.fine.base
    q = base[0] + s[:, None] * (base[-1] - base[0])
    q[:, 1] += 0.3 * np.sin(np.pi * s) ** 2
    return programme.curves.fit(q, 1e-12)


def cost_of(programme):
    return squares(programme.curves.scene, LeastJerk(), None)


def warp_of(programme, cost, z):
    settings = ConvexSettings()
    return warped(programme, cost, z, *programme.value(cost, z, settings.gauge), settings)


def test_a_late_motion_is_made_even_and_keeps_its_way(programme):
    t = np.linspace(0.0, 1.0, len(programme.curves.fine.base))
    rest = t**3 * (10 - 15 * t + 6 * t**2)
    late = along(programme, rest**1.3)
    cost = cost_of(programme)
    again = warp_of(programme, cost, late)
    before, after = (programme.value(cost, z, 0.0)[0] for z in (late, again))
    assert after < 0.8 * before
    path, moved = programme.curves.fine.q(late), programme.curves.fine.q(again)
    away = np.linalg.norm(moved[:, None, :2] - path[None, :, :2], axis=2).min(axis=1)
    assert away.max() < 8e-3  # samples of the path are up to 10 mm apart
    for _ in range(6):
        again = warp_of(programme, cost, again)
    even = along(programme, rest)
    assert programme.value(cost, again, 0.0)[0] <= 1.01 * programme.value(cost, even, 0.0)[0]


def test_what_cannot_be_better_is_left_alone(programme):
    straight = np.zeros(programme.curves.n)
    assert warp_of(programme, cost_of(programme), straight) is straight


def test_where_time_has_its_price_nothing_is_warped(programme):
    late = along(programme, np.linspace(0.0, 1.0, len(programme.curves.fine.base)) ** 2)
    assert warp_of(programme, replace(cost_of(programme), haste=1.0), late) is late


@pytest.mark.parametrize("degree", range(5))
def test_cubics_between_samples_meet_polynomials_up_to_the_third_degree(degree):
    s, t = np.linspace(0.0, 1.0, 21), np.random.default_rng(degree).uniform(size=200)
    coefficients = np.random.default_rng(10 + degree).normal(size=degree + 1)
    way, rate = np.polyval(coefficients, s), np.polyval(np.polyder(coefficients), s)
    error = interpolated(way[:, None], rate[:, None], t)[:, 0] - np.polyval(coefficients, t)
    fourth = 24.0 * abs(coefficients[0]) if degree == 4 else 0.0
    assert (
        np.abs(error).max() <= fourth / 384 * (1 / 20) ** 4 * (1 + 1e-6) + 1e-13
    )  # the error of Hermite's cubic
