"""How near a motion is to what was taught, against demonstrations whose distance and direction are known."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from comove.dmp.basis import motion_basis
from comove.model import CoordinatedMotion, Scene, load_coordinates
from comove.planning.resemblance import followed

S = np.linspace(0.0, 1.0, 201)


def straight(way=0.6):
    scene = Scene.from_dict(
        {
            "name": "straight",
            "duration": 2.0,
            "workspace": {"lower": [-9, -9], "upper": [9, 9]},
            "manipulators": [{"name": "a", "start": [0, 0], "goal": [way, 0]}],
        }
    )
    coordinates = load_coordinates(scene)
    return CoordinatedMotion(
        scene, coordinates, motion_basis(10, "jerk"), coordinates.boundary(), np.zeros((2, 10))
    )


def of(motion):
    """Its own hands, as a demonstration."""
    taught = np.zeros((len(S), 1, 3))
    taught[..., :2] = motion.hands(S)[0]
    return taught


@given(st.floats(0.05, 2.0), st.floats(-0.5, 0.5), st.floats(-0.5, 0.5))
def test_a_shift_is_a_distance_without_a_direction(way, x, y):
    motion = straight(way)
    near = followed(motion, of(motion) + np.array([x, y, 0.0]))
    assert near.distance == pytest.approx(np.hypot(x, y), abs=1e-12)
    assert near.share == pytest.approx(np.hypot(x, y) / way, abs=1e-12)
    assert near.direction < 2e-3  # of differences between samples


@given(st.floats(0.0, np.pi))
def test_a_turn_is_a_direction(angle):
    motion = straight()
    taught, c, s = of(motion), np.cos(angle), np.sin(angle)
    near = followed(motion, taught @ np.array([[c, s, 0], [-s, c, 0], [0, 0, 1]]))
    assert near.direction == pytest.approx(angle, abs=2e-3)
    assert near.distance == pytest.approx(2 * np.sin(angle / 2) * taught[:, 0, 0].mean(), rel=1e-6, abs=1e-9)
