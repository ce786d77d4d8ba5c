"""The checks and repairs that every demonstration passes."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from comove.demonstrations import cleaning
from comove.errors import DemonstrationError

LINE = np.linspace([0.0, 0.0], [0.5, 1.0], 5)
STEPS = np.linspace(0.0, 1.0, 5)


def changed(array, index, value):
    array = array.copy()
    array[index] = value
    return array


@pytest.mark.parametrize(
    ("time", "position", "key", "says", "way_out"),
    [
        (STEPS[:4], LINE, "position", "5 rows and time has 4", "one row a time stamp"),
        (STEPS, LINE.T, "position", "2 rows and time has 5", "transpose"),
        (STEPS, LINE[:, 0], "position", r"shape \(5,\)", "n_steps, n_dims"),
        (STEPS[:, None], LINE, "time", r"shape \(5, 1\)", "n_steps,"),
        (STEPS[:1], LINE[:1], "time", "two rows at least, this one has 1", "record more"),
        (STEPS[:0], LINE[:0], "time", "this one has 0", "record more"),
        (STEPS, np.zeros((5, 8)), "position", "8 columns", "1 to 7"),
        (STEPS, np.zeros((5, 0)), "position", "0 columns", "1 to 7"),
        (STEPS, LINE.astype(str), "position", "str", "real numbers"),
        (STEPS, LINE + 1j, "position", "complex", "real numbers"),
        (STEPS, [[1.0], [1.0, 2.0]], "position", "differ in length", "same columns"),
        (STEPS, changed(LINE, (3, 1), np.nan), "position[3, 1]", "nan", "remove the row"),
        (STEPS, changed(LINE, (2, 0), -np.inf), "position[2, 0]", "-inf", "remove the row"),
        (STEPS, changed(LINE, (2, 0), 1e300), "position[2, 0]", "1e.300", "remove the row"),
        (changed(STEPS, 4, np.nan), LINE, "time[4]", "nan", "remove the row"),
        (changed(STEPS, 3, 0.1), LINE, "time[3]", "goes back from 0.5 s to 0.1 s", "sort the rows"),
        (np.full(5, 0.3), LINE, "time[1]", "stands still at 0.3 s", "in seconds"),
        (STEPS * 1e-9, LINE, "time[1]", "1e-09 s in all", "in seconds"),
    ],
)
def test_what_is_no_movement_is_refused(time, position, key, says, way_out):
    with pytest.raises(DemonstrationError, match=says) as caught:
        cleaning.check(time, position)
    assert caught.value.key == key
    assert way_out in caught.value.way_out


def test_a_later_start_is_shifted_and_said():
    time, note = cleaning.start_at_zero(STEPS + 8.0)
    np.testing.assert_array_equal(time, STEPS)
    assert note == "time shifted by -8 s to start at 0"
    assert cleaning.start_at_zero(time) == (time, "")


@given(st.lists(st.integers(1, 4), min_size=2, max_size=12), st.integers(0, 2**32 - 1))
def test_merging_keeps_the_mean_of_each_instant(counts, seed):
    position = np.random.default_rng(seed).normal(size=(sum(counts), 2))
    stamps = np.arange(len(counts)) / 10.0
    time, merged, note = cleaning.merge_repeated_stamps(np.repeat(stamps, counts), position)
    np.testing.assert_array_equal(time, stamps)
    groups = np.split(position, np.cumsum(counts)[:-1])
    np.testing.assert_allclose(merged, [group.mean(axis=0) for group in groups], atol=1e-15)
    assert bool(note) == (max(counts) > 1)
    single = np.array(counts) == 1
    np.testing.assert_array_equal(merged[single], np.array([group[0] for group in groups])[single])


def test_merging_says_how_many_rows_and_where():
    _, _, note = cleaning.merge_repeated_stamps(np.array([0.0, 0.25, 0.25, 0.5]), np.zeros((4, 2)))
    assert "first at 0.25 s" in note
    assert "4 rows became 3" in note


@pytest.mark.parametrize(("scale", "hinted"), [(1.0, False), (4.9, False), (5.1, True), (1000.0, True)])
def test_movements_beyond_five_metres_look_like_millimetres(scale, hinted):
    hint = cleaning.unit_hint(100.0 + scale * LINE)
    assert hint == (f"the movement spans {scale:.4g} m: {cleaning.UNIT_HINT}" if hinted else "")
