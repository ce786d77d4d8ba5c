"""A stroke of the mouse becomes a recording with time, cleaned of pauses, and a primitive in a library."""

import numpy as np
import pytest

import comove
from comove.errors import DemonstrationError, LibraryError
from comove.lab.examples import example
from comove.view.workbench.stage import demonstrated
from comove.view.workbench.teaching import Stroke, at_rest, demonstration_from, keep


def drawn(n=80, noise=0.0, n_dims=2, bursts=False):
    stroke, rng, clock = Stroke(n_dims), np.random.default_rng(0), 10.0
    for i, share in enumerate(np.linspace(0.0, 1.0, n)):
        clock += 0.02 + 0.005 * rng.random() + (0.5 if bursts and i % 10 == 5 else 0.0)
        point = np.array([share, 0.3 * np.sin(np.pi * share), 0.1 * share]) + noise * rng.standard_normal(3)
        stroke.add(clock, point)
    return stroke


@pytest.mark.parametrize("n_dims", [2, 3])
def test_a_stroke_keeps_its_ends_and_its_time(n_dims):
    stroke = drawn(n_dims=n_dims)
    table = np.array(stroke.taught(1.0))
    assert table.shape[1] == 1 + n_dims
    assert table[0, 0] == 0.0
    assert (np.diff(table[:, 0]) > 0).all()
    np.testing.assert_allclose(table[[0, -1], 1], [0.0, 1.0], atol=0.06)
    assert table[-1, 0] == pytest.approx(1.25 * (stroke.rows[-1][0] - stroke.rows[0][0]), rel=0.1)


def test_a_page_that_stumbles_cuts_nothing_off():
    """Points may come in bursts, with rests between them: all of the stroke stays."""
    table = np.array(drawn(bursts=True).taught(1.0))
    np.testing.assert_allclose(table[[0, -1], 1], [0.0, 1.0], atol=0.06)
    assert table[:, 2].max() > 0.28


def test_it_begins_and_ends_at_rest_and_is_as_quick_in_between():
    time = np.linspace(0.0, 2.0, 2001)
    later = at_rest(time, 0.25)
    speed = np.gradient(time, later)
    assert later[0] == 0.0
    assert speed[[0, -1]].max() < 0.1
    np.testing.assert_allclose(speed[400:1600], 1.0, atol=1e-6)
    assert (np.diff(later) > 0).all()


@pytest.mark.parametrize("name", ["narrow", "wide"])
def test_what_every_hand_would_do_of_it_has_the_shape_that_was_drawn(name):
    """Ends of hands lie in the direction of the stroke, so that they would draw the same, shifted."""
    stroke, scene = Stroke(2), example(name)
    for i, share in enumerate(np.linspace(0.0, 1.0, 60)):
        stroke.add(0.025 * i, np.array([0.15 + 0.7 * share, 0.5 - 0.3 * np.sin(2 * np.pi * share)]))
    path = demonstrated(scene, stroke.taught(1.0))
    own = scene.goal[0] - scene.start[0]
    if abs(own[1]) < 1e-9:
        scale = own[0] / 0.7
        low, high = path[:, 0, 1].min() - scene.start[0, 1], path[:, 0, 1].max() - scene.start[0, 1]
        assert (low, high) == pytest.approx((-0.3 * scale, 0.3 * scale), abs=0.02)


def test_noise_is_removed_and_the_shape_stays():
    rough, clean = drawn(noise=0.004), np.array(drawn(noise=0.004).taught(1.0))
    true = 0.3 * np.sin(np.pi * clean[:, 1])
    assert np.abs(clean[:, 2] - true).max() < 0.03
    steps = np.diff(np.array(rough.rows)[:, 2], n=2)
    assert np.abs(np.diff(clean[:, 2], n=2)).max() < np.abs(steps).max()


@pytest.mark.parametrize("stroke", [Stroke(2), drawn(n=4)])
def test_a_slip_is_no_movement(stroke):
    with pytest.raises(DemonstrationError, match="too short"):
        stroke.taught(1.0)
    with pytest.raises(DemonstrationError, match="too short"):
        drawn().taught(1000.0)


def test_what_is_no_point_is_left_out():
    stroke = drawn()
    n = len(stroke.rows)
    stroke.add(1e9, np.array([np.nan, 0.0, 0.0]))
    stroke.add(0.0, np.array([0.5, 0.5, 0.0]))
    assert len(stroke.rows) == n


def test_what_is_kept_is_found_again(tmp_path):
    taught = drawn().taught(1.0)
    keep(taught, "wave", tmp_path)
    primitive = comove.Library(tmp_path / "library")["wave"]
    recording = demonstration_from(taught).resampled(101)
    way = primitive.positions.rollout(n_steps=recording.n_steps).position
    assert np.abs(way.reshape(recording.position.shape) - recording.position).max() < 0.02
    with pytest.raises(LibraryError, match="wave"):
        keep(taught, "wave", tmp_path)
