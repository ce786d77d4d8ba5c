"""Time profiles, and fits of paths with sharp bends."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from comove.dmp.basis import motion_basis
from comove.model import Scene
from comove.model.coordinates import load_coordinates
from comove.planning import Comove, solve
from comove.planning.configurations import configuration_space
from comove.planning.methods import SETTINGS
from comove.planning.objectives import PaperCost
from comove.planning.planner import along
from comove.planning.seeds import fit, profiles, steady, targets_along

N = 4001


@given(st.floats(0.01, 0.5))
def test_a_steady_profile_is_even_but_for_its_ramps(ramp):
    t = np.linspace(0.0, 1.0, N)
    share = steady(t, ramp)
    speed = np.diff(share) * (N - 1)
    middle = (t[:-1] > ramp) & (t[1:] < 1 - ramp)
    assert share[0] == 0.0 and share[-1] == 1.0 and (speed >= -1e-9).all()
    assert np.abs(share + share[::-1] - 1.0).max() < 1e-12
    assert np.allclose(speed[middle], 1.0 / (1.0 - ramp), rtol=1e-6)
    assert speed.max() <= (1 + 1e-6) / (1.0 - ramp)


@given(st.floats(0.05, 0.5))
def test_a_steady_profile_begins_and_ends_at_rest_without_a_jolt(ramp):
    h = 1e-4
    share = steady(np.array([0.0, h, 1.0 - h, 1.0]), ramp)
    assert share[1] < (h / ramp) ** 2 and 1.0 - share[2] < (h / ramp) ** 2


def test_every_profile_goes_all_the_way_and_never_back():
    share = profiles(201)
    assert np.allclose(share[:, 0], 0.0, atol=1e-12) and np.allclose(share[:, -1], 1.0, atol=1e-12)
    assert (np.diff(share, axis=1) >= -1e-12).all()


def zigzag(n_teeth=6, width=0.1):
    """An empty scene and a path of the load with sharp bends."""
    x = np.linspace(0.2, 1.0, n_teeth + 1)
    y = 0.5 + width * np.where(np.arange(n_teeth + 1) % 2, 1.0, -1.0)
    path = np.stack([x, y, np.zeros(n_teeth + 1)], axis=1)
    hands = [
        {
            "name": name,
            "start": [float(x[0]), float(y[0] + a)],
            "goal": [float(x[-1]), float(y[-1] + a)],
        }
        for name, a in (("a", 0.05), ("b", -0.05))
    ]
    scene = Scene.from_dict(
        {
            "name": "zigzag",
            "duration": 10.0,
            "workspace": {"lower": [0, 0], "upper": [1.2, 1]},
            "load": {"shape": "bar", "length": 0.1},
            "manipulators": hands,
        }
    )
    return scene, path


@pytest.mark.parametrize(("n_basis", "least", "most"), [(30, 0.004, 0.1), (100, 0.0, 0.0025)])
def test_sharp_bends_need_many_weights(n_basis, least, most):
    """How far the best of all fits leaves a path of six bends."""
    scene, path = zigzag()
    coordinates = load_coordinates(scene)
    path[:, 2] = coordinates.boundary()[0, 2]
    space = configuration_space(scene, coordinates)
    basis = motion_basis(n_basis, "velocity")
    dmp, weights = fit(targets_along(space, path, gentle=False), path[-1], coordinates, basis, scene)
    centers = dmp.rollouts(weights, 201)[:, :2]
    way = along(space, path, np.linspace(0.0, 1.0, 4001)[None])[0, :, :2].T
    off = min(
        np.linalg.norm(center[:, :, None] - way[:, None], axis=0).min(axis=1).max() for center in centers
    )
    assert least <= off <= most


def test_a_plan_that_needs_more_weights_gets_them():
    """Around four walls in turn, each nearly as wide as the workspace."""
    walls = [
        {"shape": "box", "center": [0.3 + 0.12 * k, 0.2 if k % 2 else 0.8], "size": [0.05, 0.95]}
        for k in range(4)
    ]
    scene = Scene.from_dict(
        {
            "name": "comb",
            "duration": 10.0,
            "workspace": {"lower": [0, 0], "upper": [1.2, 1]},
            "obstacles": walls,
            "load": {"shape": "bar", "length": 0.04},
            "manipulators": [
                {"name": "a", "start": [0.1, 0.48], "goal": [1.1, 0.48]},
                {"name": "b", "start": [0.1, 0.52], "goal": [1.1, 0.52]},
            ],
            "limits": {"speed": 2.0},
        }
    )
    unpolished = Comove(n_plans=1, settings=replace(SETTINGS, n_polished=0))
    solution = solve(scene, method=unpolished, budget=30.0, objective=PaperCost())
    assert solution.verified and solution.attempt.basis.n_basis == Comove().n_basis_fine
