"""Cutting recordings: the truth is known because the recordings are made of it."""

import re

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from comove.dmp.demonstrations import Demonstration, segment
from comove.errors import OptionError
from tests.cases import examples

SEEDS = st.integers(0, 2**32 - 1)
DEFAULTS = {"min_pause": 0.2, "min_duration": 0.2, "cutoff_hz": 6.0}
TOLERANCE = 0.12
"""How far cuts may lie from the truth [s], beyond one sample, where there is little noise."""


def minimum_jerk(share):
    s = np.clip(share, 0.0, 1.0)
    return 10 * s**3 - 15 * s**4 + 6 * s**5


def reaches(seed, rate, noise=0.0, n_reaches=4, n_dims=3):
    """A recording of minimum-jerk reaches with pauses between, and when each began and ended [s]."""
    rng = np.random.default_rng(seed)
    pauses, lengths = rng.uniform(0.4, 1.0, n_reaches + 1), rng.uniform(0.6, 2.0, n_reaches)
    begins = np.cumsum(pauses[:-1]) + np.concatenate(([0.0], np.cumsum(lengths[:-1])))
    time = np.arange(0.0, begins[-1] + lengths[-1] + pauses[-1], 1.0 / rate)
    steps = rng.normal(size=(n_reaches, n_dims))
    steps *= rng.uniform(0.15, 0.6, (n_reaches, 1)) / np.linalg.norm(steps, axis=1, keepdims=True)
    position = minimum_jerk((time[:, None] - begins) / lengths) @ steps
    position += rng.normal(scale=noise, size=position.shape) if noise else 0.0
    return Demonstration(time, position, "day"), np.column_stack((begins, begins + lengths))


def spans(parts):
    """First and last instant of each part in the recording [s], as its last note says."""
    found = [re.search(r"from (\S+) s to (\S+) s of", part.notes[-1]) for part in parts]
    return np.array([[float(match[1]), float(match[2])] for match in found]).reshape(-1, 2)


@pytest.mark.parametrize("rate", [20, 30, 100, 500, 1000])
@pytest.mark.parametrize("noise", [0.0, 1e-4])
def test_reaches_are_found_where_they_are(rate, noise):
    for seed in range(12):
        demo, truth = reaches(seed, rate, noise)
        found = spans(segment(demo))
        assert found.shape == truth.shape
        assert np.abs(found - truth).max() < TOLERANCE + 1.0 / rate


@pytest.mark.parametrize("rate", [20, 30, 100, 500])
def test_a_millimetre_of_noise_blurs_the_cuts_and_makes_none(rate):
    """Where a slow movement fades into noise is not known any better: half a second at 30 Hz."""
    for seed in range(12):
        demo, truth = reaches(seed, rate, 1e-3)
        found = spans(segment(demo))
        assert found.shape == truth.shape
        assert np.abs(found - truth).max() < 0.5


@pytest.mark.parametrize("rate", [20, 100, 1000])
def test_a_single_reach_is_returned_whole(rate):
    time = np.arange(0.0, 1.5, 1.0 / rate)
    demo = Demonstration(time, np.outer(minimum_jerk(time / time[-1]), [0.3, 0.1]))
    (part,) = segment(demo)
    assert part.position.tobytes() == demo.position.tobytes()
    assert part.time.tobytes() == demo.time.tobytes()


def test_standing_still_holds_no_movement():
    time = np.arange(3000) / 100.0
    for noise in (0.0, 1e-3):
        position = np.random.default_rng(0).normal(scale=noise, size=(3000, 3))
        assert segment(Demonstration(time, position)) == ()


@given(SEEDS, st.sampled_from([25, 100]), st.floats(0.0, 5e-3), st.sampled_from([None, 0.7]))
@examples(60)
def test_movements_are_apart_in_order_and_within(seed, rate, noise, corner):
    demo, _ = reaches(seed, rate, noise)
    parts = segment(demo, corner=corner)
    found = spans(parts)
    assert (found[:, 0] < found[:, 1]).all()
    assert (found[1:, 0] > found[:-1, 1]).all()
    assert found.size == 0 or (found[0, 0] >= 0.0 and found[-1, 1] <= demo.duration)
    for part, (start, goal) in zip(parts, found, strict=True):
        kept = (demo.time >= start - 1e-4) & (demo.time <= goal + 1e-4)
        assert part.position.tobytes() == demo.position[kept].tobytes()
        np.testing.assert_allclose(part.time, demo.time[kept] - demo.time[kept][0], atol=1e-12)


@given(SEEDS, st.floats(0.1, 10.0), st.floats(0.1, 10.0))
@examples(40)
def test_pace_place_and_size_do_not_matter(seed, pace, size):
    from scipy.spatial.transform import Rotation

    rng = np.random.default_rng(seed)
    demo, _ = reaches(seed, 100, 2e-4)
    turned = size * Rotation.random(rng=rng).apply(demo.position.copy()) + rng.normal(size=3)
    other = Demonstration(pace * demo.time, turned, unit="any")
    slower = {"min_pause": 0.2 * pace, "min_duration": 0.2 * pace, "cutoff_hz": 6.0 / pace}
    for corner in (None, 0.7):
        here, there = segment(demo, **DEFAULTS, corner=corner), segment(other, **slower, corner=corner)
        assert len(here) == len(there)
        tolerance = 1.5 * pace * demo.time[1]  # noise is not turned alike in each dimension: a sample at most
        np.testing.assert_allclose(spans(there), pace * spans(here), atol=tolerance, rtol=1e-5)


def test_uneven_stamps_do_not_matter():
    demo, truth = reaches(3, 100)
    jitter = np.random.default_rng(0).uniform(-0.004, 0.004, demo.n_steps)
    even = demo.time + np.concatenate(([0.0], jitter[1:-1], [0.0]))
    position = np.column_stack([np.interp(even, demo.time, column) for column in demo.position.T])
    parts = segment(Demonstration(even, position))
    assert np.abs(spans(parts) - truth).max() < TOLERANCE


def test_short_stops_do_not_part_and_short_jerks_are_dropped():
    time = np.arange(0.0, 5.0, 0.01)
    twice = minimum_jerk((time - 0.5) / 1.0) + minimum_jerk((time - 1.75) / 1.0)
    demo = Demonstration(time, 0.4 * twice[:, None])
    assert len(segment(demo)) == 2  # still for about a third of a second
    assert len(segment(demo, min_pause=0.5)) == 1
    assert len(segment(demo, min_duration=1.2, min_pause=0.1)) == 0
    jerk = 0.1 * minimum_jerk((time - 3.5) / 0.1) + 0.4 * minimum_jerk((time - 0.5) / 1.0)
    found = segment(Demonstration(time, jerk[:, None]), min_duration=0.6)
    assert len(found) == 1


def test_slow_movements_beside_fast_ones_keep_their_beginning():
    time = np.arange(0.0, 6.0, 0.01)
    position = 0.6 * minimum_jerk((time - 0.5) / 0.6) + 0.15 * minimum_jerk((time - 2.0) / 2.0)
    found = spans(segment(Demonstration(time, position[:, None])))
    assert np.abs(found - [[0.5, 1.1], [2.0, 4.0]]).max() < TOLERANCE


def test_strokes_of_an_ellipse_end_where_it_turns_most():
    """A harmonic ellipse follows the two-thirds power law: it is slowest where it is most curved."""
    time = np.linspace(0.0, 4.0, 401)
    ellipse = np.column_stack((0.2 * np.cos(np.pi * time), 0.1 * np.sin(np.pi * time)))
    assert len(segment(Demonstration(time, ellipse))) == 1
    found = spans(segment(Demonstration(time, ellipse), corner=1.0))
    np.testing.assert_allclose(found, [[k + 0.01 * (k > 0), k + 1.0] for k in range(4)], atol=0.011)
    circle = np.column_stack((np.cos(np.pi * time), np.sin(np.pi * time)))
    assert len(segment(Demonstration(time, circle), corner=1.0)) == 1


def test_curves_at_nearly_even_pace_are_not_cut():
    time = np.linspace(0.0, 4.0, 401)
    round_about = np.column_stack((0.2 * np.cos(np.pi * time), 0.17 * np.sin(np.pi * time)))
    assert len(segment(Demonstration(time, round_about), corner=1.0)) == 1


def test_movements_that_creep_into_each_other_share_no_sample():
    """Too slow to go on, too fast to rest: the slowest sample parts them."""
    time = np.arange(0.0, 5.0, 0.01)
    creep = 0.025 * 1.875 * 0.4  # of the largest speed
    position = 0.4 * (minimum_jerk(time - 0.5) + minimum_jerk(time - 2.5)) + creep * time
    first, second = spans(segment(Demonstration(time, position[:, None])))
    assert 1.5 <= first[1] < second[0] <= 2.5


@pytest.mark.parametrize("rate", [30, 100, 500])
@pytest.mark.parametrize("noise", [0.0, 1e-3])
def test_corners_part_and_slowing_down_on_a_line_does_not(rate, noise):
    time = np.arange(0.0, 2.4, 1.0 / rate)
    first, then = 0.4 * minimum_jerk(time - 0.3), 0.4 * minimum_jerk(time - 1.1)
    rough = np.random.default_rng(1).normal(scale=noise, size=(len(time), 2))
    corner = Demonstration(time, np.column_stack((first, then)) + rough)
    assert len(segment(corner)) == 1
    found = spans(segment(corner, corner=0.8))
    assert len(found) == 2
    assert abs(found[0, 1] - 1.2) < 0.05 + 1.0 / rate  # the middle of the overlap
    line = Demonstration(time, np.column_stack((first + then, 0.0 * time)) + rough)
    assert len(segment(line, corner=0.8)) == 1


def test_turning_on_the_spot_is_a_movement():
    time = np.arange(0.0, 3.0, 0.01)
    half = 0.75 * minimum_jerk((time - 0.8) / 1.2)
    orientation = np.column_stack((np.cos(half), np.zeros((300, 2)), np.sin(half)))
    rough = np.random.default_rng(0).normal(scale=1e-4, size=(300, 3))
    (part,) = segment(Demonstration(time, rough, orientation=orientation))
    assert np.abs(spans([part]) - [0.8, 2.0]).max() < 0.2
    assert part.orientation.shape == (part.n_steps, 4)
    assert segment(Demonstration(time, rough)) == ()


def test_parts_say_where_they_come_from_and_keep_what_is_known():
    demo, _ = reaches(0, 100, n_dims=2)
    demo = Demonstration(demo.time, demo.position, "day", ("by hand",), "rad", axes=("waist", "elbow"))
    parts = segment(demo)
    assert [part.name for part in parts] == ["day 0", "day 1", "day 2", "day 3"]
    assert parts[1].notes[0] == "by hand"
    assert parts[1].notes[1].startswith("movement 1 of 4, from ")
    assert parts[1].notes[1].endswith(" of day")
    assert (parts[2].unit, parts[2].axes) == ("rad", ("waist", "elbow"))


@pytest.mark.parametrize("n_steps", [2, 3, 5, 9])
def test_short_recordings_are_no_trouble(n_steps):
    steps = np.arange(n_steps) / 5.0
    (part,) = segment(Demonstration(steps, steps[:, None]))
    assert part.n_steps == n_steps


@pytest.mark.parametrize(
    ("options", "way_out"),
    [
        ({"speed_share": 0.0}, "between 0 and 1"),
        ({"speed_share": 1.0}, "between 0 and 1"),
        ({"min_pause": -1.0}, "0 or more"),
        ({"min_duration": float("nan")}, "0 or more"),
        ({"cutoff_hz": 0.0}, "positive"),
        ({"cutoff_hz": "6"}, "positive"),
        ({"corner": 4.0}, "up to pi, or None"),
        ({"corner": True}, "up to pi, or None"),
    ],
)
def test_impossible_options_are_refused(options, way_out):
    with pytest.raises(OptionError, match=way_out) as caught:
        segment(reaches(0, 50)[0], **options)
    assert caught.value.key == next(iter(options))
