"""A load turns as it was taught."""

import numpy as np
import pytest

import comove
from comove.coordination.adaptation import carried_to_hands, hands_of_poses
from comove.demonstrations import Demonstration
from comove.errors import OptionError
from comove.geometry.rotations import exponential
from comove.primitives import DMP, PoseDMP

T = np.linspace(0.0, 1.0, 201)
REST = T**3 * (10 - 15 * T + 6 * T**2)
SWING = 0.7  # rad, in the middle of the way


def recording(axis, n_dims=3):
    """Straight on, swinging about an axis and back."""
    position = np.zeros((len(T), n_dims))
    position[:, 0] = 0.8 * REST
    turn = SWING * np.sin(np.pi * REST) ** 2
    return Demonstration(
        10 * T, position, "swing", orientation=exponential(turn[:, None] * np.asarray(axis, float))
    )


def scene(n_dims=3, constraints=(), load=None, turned=0.0):
    """Two hands that carry something straight on, and turn it about the vertical."""
    c, s = 0.15 * np.cos(turned), 0.15 * np.sin(turned)
    ends = {
        "left": ([0.2, 0.15, 0.0], [1.0 - s, c, 0.0]),
        "right": ([0.2, -0.15, 0.0], [1.0 + s, -c, 0.0]),
    }
    return comove.Scene.from_dict(
        {
            "name": "open",
            "duration": 10.0,
            "workspace": {"lower": [-0.5, -1, -1][:n_dims], "upper": [2, 1, 1][:n_dims]},
            "load": load or {"shape": "bar", "length": 0.3},
            "constraints": list(constraints),
            "manipulators": [
                {"name": name, "start": start[:n_dims], "goal": goal[:n_dims]}
                for name, (start, goal) in ends.items()
            ],
        }
    )


def heading(hands):
    """Of the second hand to the first, seen from above [rad], from that at the start."""
    across = hands[:, 0, :2] - hands[:, 1, :2]
    angle = np.unwrap(np.arctan2(across[:, 1], across[:, 0]))
    return angle - angle[0]


@pytest.mark.parametrize("n_dims", [2, 3])
@pytest.mark.parametrize("turned", [0.0, 0.5])
def test_hands_turn_with_the_load_and_end_where_they_must(n_dims, turned):
    place = scene(n_dims, turned=turned)
    hands = carried_to_hands(hands_of_poses(PoseDMP.fit(recording([0, 0, 1], n_dims)), place), place, T)
    assert np.allclose(hands[0], place.start, atol=1e-9)
    assert np.allclose(hands[-1], place.goal, atol=1e-9)
    assert np.linalg.norm(hands[:, 0] - hands[:, 1], axis=1) == pytest.approx(0.3, abs=2e-3)
    led = turned * REST  # to the load's own end, about as evenly as the way is gone
    assert heading(hands) == pytest.approx(SWING * np.sin(np.pi * REST) ** 2 + led, abs=0.05)


@pytest.mark.parametrize("n_dims", [2, 3])
def test_a_motion_swings_as_it_was_taught(n_dims):
    place, taught = scene(n_dims), recording([0, 0, 1], n_dims)
    solution = comove.solve(place, demonstration=taught, objective=comove.LeastJerk(1.0))
    assert solution.verified
    assert heading(solution.attempt.hands(T)[0]).max() == pytest.approx(SWING, rel=0.05)
    assert solution.followed.distance < 5e-3
    straight = comove.solve(place, demonstration=DMP.fit(taught), objective=comove.LeastJerk(1.0))
    assert np.abs(heading(straight.attempt.hands(T)[0])).max() < 1e-3


def test_what_an_upright_load_cannot_do_is_left_out():
    tray = {
        "shape": "box",
        "size": [0.2, 0.2, 0.02],
        "grasps": {"left": [0, 0.15, 0], "right": [0, -0.15, 0]},
    }
    place = scene(constraints=[{"type": "upright"}], load=tray)
    both = np.array([1.0, 0.0, 1.0])  # a roll about the way, and a turn about the vertical
    hands = carried_to_hands(hands_of_poses(PoseDMP.fit(recording(both)), place), place, T)
    assert hands[..., 2] == pytest.approx(0.0, abs=1e-9)
    assert heading(hands).max() == pytest.approx(SWING, rel=0.1)


def test_the_axis_of_turning_goes_with_the_way():
    """Taught along x with a nose that rises; carried out along y, the nose still rises."""
    up = hands_of_poses(PoseDMP.fit(recording([0, -1, 0])), scene())
    assert (
        np.ptp(carried_to_hands(up, scene(), T)[..., 2]) < 1e-6
    )  # the bar lies across: it rolls, and nothing shows
    data = {
        "name": "along y",
        "duration": 10.0,
        "workspace": {"lower": [-1, -1, -1], "upper": [1, 2, 1]},
        "load": {"shape": "bar", "length": 0.3},
        "manipulators": [
            {"name": "back", "start": [0, 0, 0], "goal": [0, 0.8, 0]},
            {"name": "front", "start": [0, 0.3, 0], "goal": [0, 1.1, 0]},
        ],
    }
    place = comove.Scene.from_dict(data)
    hands = carried_to_hands(hands_of_poses(PoseDMP.fit(recording([0, -1, 0])), place), place, T)
    rise = np.arcsin((hands[:, 1, 2] - hands[:, 0, 2]) / 0.3)
    assert rise.max() == pytest.approx(SWING, rel=0.05)
    assert np.abs(hands[..., 0]).max() < 1e-6


def test_poses_for_hands_that_are_free_are_refused():
    data = {
        "name": "free",
        "duration": 5.0,
        "workspace": {"lower": [-1, -1], "upper": [2, 2]},
        "manipulators": [
            {"name": "a", "start": [0, 0], "goal": [1, 0]},
            {"name": "b", "start": [0, 1], "goal": [1, 1]},
        ],
    }
    free = comove.Scene.from_dict(data)
    with pytest.raises(OptionError, match="held by all hands"):
        comove.solve(free, demonstration=PoseDMP.fit(recording([0, 0, 1], 2)))
    with pytest.raises(OptionError, match="3 dimensions, the scene 2"):
        comove.solve(scene(2), demonstration=PoseDMP.fit(recording([0, 0, 1])))
    assert comove.solve(free, demonstration=recording([0, 0, 1], 2)).verified  # of a recording, its positions
