"""What is expected of obstacles of which nobody knows where they go."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from comove.control import Functions, Known
from comove.control.observers import Turning, going_on
from comove.model import Scene
from comove.model.moving import Circle, Motion
from tests.control.test_executor import crossing, disc

vector = st.tuples(*[st.floats(-1.0, 1.0)] * 3).map(np.array)


def across(velocity, spin):
    """The part of a spin that turns a velocity."""
    return spin - velocity * (spin @ velocity) / max(velocity @ velocity, 1e-12)


@given(velocity=vector, spin=vector, since=st.floats(0.0, 5.0))
def test_velocities_are_derivatives_and_speeds_are_kept(velocity, spin, since):
    motion, time, dt = Turning(velocity, across(velocity, 5 * spin), since), np.linspace(0.0, 8.0, 50), 1e-5
    slopes = (motion.offsets(time + dt) - motion.offsets(time - dt)) / (2 * dt)
    np.testing.assert_allclose(motion.velocities(time), slopes, atol=1e-6)
    np.testing.assert_allclose(
        np.linalg.norm(motion.velocities(time), axis=1), np.linalg.norm(velocity), atol=1e-9
    )
    np.testing.assert_allclose(motion.offsets([since]), np.zeros((1, 3)), atol=1e-12)


@given(velocity=vector, spin=vector)
def test_sags_bound_how_far_chords_are_left(velocity, spin):
    motion, time = Turning(velocity, across(velocity, 5 * spin), 0.0), np.linspace(0.0, 3.0, 20)
    ends, middle = motion.offsets(time), motion.offsets(0.5 * (time[1:] + time[:-1]))
    away = np.linalg.norm(middle - 0.5 * (ends[1:] + ends[:-1]), axis=1)
    assert (away <= motion.sagittas(time) + 1e-12).all()


@pytest.mark.parametrize("now", [0.3, 2.0])
def test_a_circle_is_foreseen(now):
    circle = Motion(circle=Circle(radius=0.2, period_s=3.0))
    scene = crossing(disc([0.5, 0.8], {"circle": {"radius": 0.2, "period_s": 3.0}}))
    expected = Functions.of_motions(scene).predict(now)
    later = np.linspace(now, now + 3.0, 40)
    found = expected.obstacles[0, 1:4] + expected.offsets(later)[:, 0]
    np.testing.assert_allclose(found, [0.5, 0.8, 0.0] + circle.offsets(later), atol=2e-3)


def test_a_corner_is_not_taken_for_a_turn():
    corner = {"waypoints": [[0.9, 0.9], [0.5, 0.9], [0.5, 0.5]], "times": [0.0, 1.0, 2.0]}
    expected = Functions.of_motions(crossing(disc([0.9, 0.9], corner))).predict(1.005)
    np.testing.assert_allclose(expected.motions[0].velocities([3.0]), [[0.0, -0.4, 0.0]], atol=1e-9)


@pytest.mark.parametrize("n_dims", [2, 3])
def test_a_door_is_foreseen(n_dims):
    """A door on a hinge, seen at 1 s: its table two seconds later is that of the scene, and so is what was seen."""
    turn = {"rate_deg_per_s": 40, "hinge": [-0.2, 0.0, 0.0][:n_dims]}
    turn |= {"axis": [0, 0, 1]} if n_dims == 3 else {}
    door = {
        "shape": "box",
        "center": [0.5] * n_dims,
        "size": [0.4, 0.05, 0.3][:n_dims],
        "motion": {"turn": turn},
    }
    scene = Scene.from_dict(
        {
            "name": "door",
            "duration": 5.0,
            "workspace": {"lower": [0] * n_dims, "upper": [1] * n_dims},
            "obstacles": [door],
            "manipulators": [{"name": "a", "start": [0.05] * n_dims, "goal": [0.95] * n_dims}],
        }
    )
    for observer in (Known(scene), Functions.of_motions(scene)):
        seen = observer.observe(1.0)
        np.testing.assert_allclose(seen.table, scene.obstacles_at(1.0), atol=1e-9)
        np.testing.assert_allclose(seen.spin, [[0.0, 0.0, np.deg2rad(40)]])
        expected = going_on(scene, seen, observer.bends(1.0), 1.0)
        later = expected.obstacles_at(3.0)
        straight = isinstance(observer, Known)  # which tells bends of nothing, as it is never asked for them
        np.testing.assert_allclose(later[0, 4:], scene.obstacles_at(3.0)[0, 4:], atol=1e-9)
        assert straight or np.abs(later - scene.obstacles_at(3.0)).max() < 2e-3
