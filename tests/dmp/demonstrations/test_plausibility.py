"""What numbers look like: units of time and length, holes, jumps and standing still."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from comove.dmp.demonstrations import Demonstration
from comove.dmp.demonstrations.plausibility import doubts, seconds
from comove.dmp.demonstrations.units import TIMES
from comove.errors import ComoveWarning, DemonstrationError

LINE = np.linspace([0.0, 0.0], [0.5, 1.0], 5)
SHARES = np.linspace(0.0, 1.0, 101)
REACH = np.column_stack((0.3 * SHARES**2, 0.1 * np.sin(3.0 * SHARES)))


@given(
    rate=st.sampled_from([10, 25, 30, 50, 60, 100, 120, 200, 240]),
    unit=st.sampled_from(["s", "ms", "us", "ns"]),
    start=st.sampled_from([0.0, 0.4, 1.7e9]),
    whole=st.booleans(),
)
def test_the_unit_of_any_usual_clock_is_found(rate, unit, start, whole):
    """Counters and clocks of 10 to 250 samples a second, from zero, from anywhere, and from 1970."""
    time = np.arange(2 * rate) / rate
    stamps = (start + time) / TIMES[unit]
    whole = whole and unit != "s"
    if whole:
        since = np.rint(time / TIMES[unit]).astype(np.int64)
        stamps = round(start / TIMES[unit]) + since
    found, notes = seconds(stamps)
    resolution = max(TIMES[unit] if whole else 0.0, 5e-7 if start > 1e9 and not whole else 0.0, 1e-9)
    np.testing.assert_allclose(found - found[0], time, atol=resolution)
    assert any("1970" in note or "UTC" in note for note in notes) == (start > 1e9)
    if unit != "s" and start < 1e9:
        assert any(f"in {unit}" in note for note in notes)


def test_no_nanosecond_of_an_epoch_is_lost():
    since = np.array([0, 1, 10_000_000, 20_000_001], dtype=np.int64)
    found, _ = seconds(1_700_000_000_000_000_000 + since, "ns")
    np.testing.assert_array_equal(found, since * 1e-9)


@pytest.mark.parametrize("step", [1, 2, 1000, 3600, 0.5e6])
def test_steps_that_may_be_anything_are_refused_with_the_options(step):
    with pytest.raises(DemonstrationError, match=r"milliseconds, seconds or frames") as caught:
        seconds(np.arange(50) * step)
    assert "--time" in caught.value.way_out
    assert "--rate" in caught.value.way_out
    np.testing.assert_array_equal(seconds(np.arange(50) * step, "s")[0], np.arange(50) * step)


def test_waypoints_seconds_apart_are_no_milliseconds():
    np.testing.assert_array_equal(seconds(np.arange(5) * 5.0)[0], np.arange(5) * 5.0)
    with pytest.raises(DemonstrationError, match="steps are 1000"):
        seconds(np.arange(5) * 1000)
    np.testing.assert_array_equal(seconds(np.array([0.0, 1.0]))[0], [0.0, 1.0])


def doubt_of_unit(position, unit="m"):
    found = [one.message for one in doubts(np.linspace(0.0, 0.2, 5), position, unit) if one.is_unit]
    return found[0] if found else None


@pytest.mark.parametrize(("scale", "doubted"), [(1.0, False), (4.9, False), (5.1, True), (1000.0, True)])
def test_movements_beyond_five_metres_look_like_millimetres(scale, doubted):
    message = f"the movement spans {scale:.4g} m: looks like millimetres"
    assert doubt_of_unit(100.0 + scale * LINE) == (message if doubted else None)


@pytest.mark.parametrize(("speed", "unit"), [(0.4, "m"), (1.5, "m"), (3.0, "mm"), (300.0, "mm")])
@pytest.mark.parametrize("jumps", [False, True])
def test_what_is_too_large_but_slow_is_offered_as_metres_of_a_vehicle(speed, unit, jumps):
    """Millimetres of the slowest hand change by a few a second; metres of a robot in a room by one or so."""
    away = np.linspace(0.0, 60.0, 201)
    position = np.column_stack((away, np.sin(away / 20.0)))
    position[70:] += 40.0 * jumps
    (doubt,) = (one for one in doubts(away / speed, position) if one.is_unit)
    assert doubt.options == {"unit": unit}
    assert "--unit m " in doubt.way_out.replace(",", " ")
    assert "--unit mm" in doubt.way_out


def test_joints_beyond_two_turns_look_like_degrees_and_other_units_like_nothing():
    degrees = 90.0 * LINE
    assert doubt_of_unit(degrees, "rad") == "the movement spans 90 rad: looks like degrees"
    assert doubt_of_unit(np.radians(degrees), "rad") is None
    assert doubt_of_unit(degrees, "LASA unit") is None


def test_a_hole_is_told_with_its_place_and_length():
    time = SHARES * 2.0
    time[60:] += 100.0
    with pytest.warns(ComoveWarning, match=r"100 s without samples from 1\.18 s on, .* \(time\[60\]\)"):
        Demonstration(time, REACH)


def test_a_jump_is_told_with_its_place_and_length():
    position = REACH.copy()
    position[50:] += [1.0, 0.0]
    with pytest.warns(ComoveWarning, match=r"it jumps by 1\.?\d* m at 1 s \(position\[50, 0\]\)"):
        Demonstration(SHARES * 2.0, position)


@pytest.mark.parametrize("orientation", [None, np.tile([1.0, 0, 0, 0], (101, 1))])
def test_what_stands_still_is_told(orientation):
    with pytest.warns(ComoveWarning, match="nothing moves in it"):
        Demonstration(SHARES, np.full((101, 3), 0.4), orientation=orientation)


@given(seed=st.integers(0, 2**32 - 1), noise=st.floats(0.0, 2e-3), pause=st.booleans())
def test_usual_recordings_are_not_doubted(seed, noise, pause):
    """Reaches with noise, jitter of the clock and pauses."""
    rng = np.random.default_rng(seed)
    time = np.cumsum(rng.uniform(0.005, 0.02, 101))
    position = REACH + noise * rng.standard_normal(REACH.shape)
    if pause:
        position[40:] = position[40:41] + (position[40:] - position[40:41]) * (SHARES[40:, None] > 0.7)
    found = doubts(time - time[0], position)
    assert not [doubt for doubt in found if doubt.is_unit or "without samples" in doubt.message]
    if not pause:
        assert found == ()


def test_what_is_stated_is_not_doubted():
    slow = np.arange(101.0) * 60.0
    assert {doubt.key for doubt in doubts(slow, 1e3 * REACH)} == {"--unit", "--time"}
    assert doubts(slow, 1e3 * REACH, stated={"time", "unit"}) == ()


def test_what_was_told_once_is_not_told_again(recwarn):
    demo = Demonstration(np.arange(101.0) * 60.0, 1e3 * REACH)
    assert len(recwarn) == 1
    demo.resampled(50)
    assert len(recwarn) == 1


def test_steps_are_told_without_stamps_that_are_repeated():
    """A clock of a coarse resolution writes most stamps twice."""
    with pytest.raises(DemonstrationError, match="its steps are 200, and nothing says"):
        seconds(200 * np.repeat(np.arange(30), 3))
