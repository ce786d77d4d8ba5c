"""The checks and repairs that every demonstration passes."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from comove.dmp.demonstrations import cleaning
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
        (STEPS, np.zeros((5, 65)), "position", "65 columns", "1 to 64"),
        (STEPS, np.zeros((5, 0)), "position", "0 columns", "1 to 64"),
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


def quaternions(seed, n_steps):
    turned = np.random.default_rng(seed).normal(size=(n_steps, 4))
    return turned / np.linalg.norm(turned, axis=1, keepdims=True)


@pytest.mark.parametrize(
    ("orientation", "key", "says", "way_out"),
    [
        (quaternions(0, 4), "orientation", r"shape \(4, 4\) and position has 5 rows", "shape (n_steps, 4)"),
        (quaternions(0, 5)[:, :3], "orientation", r"shape \(5, 3\)", "one quaternion w x y z"),
        (quaternions(0, 5).astype(str), "orientation", "str", "real numbers"),
        (changed(quaternions(0, 5), 3, [1.0, 0.1, 0, 0]), "orientation[3]", "norm 1.005, not 1", "w x y z"),
        (changed(quaternions(0, 5), 2, 0.0), "orientation[2]", "norm 0, not 1", "w x y z"),
        (changed(quaternions(0, 5), (1, 2), np.nan), "orientation[1]", "norm nan", "w x y z"),
        (changed(quaternions(0, 5), (1, 2), np.inf), "orientation[1]", "inf", "w x y z"),
        (changed(quaternions(0, 5), (4, 0), -1e300), "orientation[4]", "norm 1e.12", "w x y z"),
    ],
)
def test_what_is_no_orientation_is_refused(orientation, key, says, way_out):
    with pytest.raises(DemonstrationError, match=says) as caught:
        cleaning.check_orientation(orientation, 5)
    assert caught.value.key == key
    assert way_out in caught.value.way_out


@given(st.integers(0, 2**32 - 1), st.floats(-9e-4, 9e-4))
def test_small_misses_of_the_norm_are_mended_once_and_for_all(seed, miss):
    exact = quaternions(seed, 20)
    once = cleaning.check_orientation(exact * (1.0 + miss), 20)
    np.testing.assert_allclose(once, exact, atol=1e-15)
    assert cleaning.check_orientation(once, 20).tobytes() == once.tobytes()


@given(st.integers(0, 2**32 - 1))
def test_signs_follow_the_neighbour_and_turns_stay_the_same(seed):
    rng = np.random.default_rng(seed)
    smooth = np.cumsum(rng.normal(scale=0.05, size=(30, 4)), axis=0) + [1.0, 0.0, 0.0, 0.0]
    smooth /= np.linalg.norm(smooth, axis=1, keepdims=True)
    signs = rng.choice([-1.0, 1.0], size=(30, 1))
    found, note = cleaning.without_sign_changes(smooth * signs)
    np.testing.assert_array_equal(found, smooth * signs[0])
    n_flips = int((np.diff(signs[:, 0]) != 0.0).sum())
    assert note == (f"{n_flips} changes of sign between quaternions undone" if n_flips else "")


def test_rows_of_one_instant_get_the_mean_turn_whatever_their_signs():
    half = np.array([[np.cos(a / 2), np.sin(a / 2), 0, 0] for a in (0.0, 0.2, 0.4, 0.9)])
    half[1] *= -1.0
    merged = cleaning.merge_repeated_orientations(np.array([0.0, 0.1, 0.1, 0.2]), half)
    assert merged[[0, 2]].tobytes() == half[[0, 3]].tobytes()
    np.testing.assert_allclose(merged[1], [-np.cos(0.15), -np.sin(0.15), 0, 0], atol=1e-15)


def test_axes_are_names_of_their_own():
    assert cleaning.check_axes(["waist", "elbow"], 2) == ("waist", "elbow")
    assert cleaning.check_axes((), 2) == cleaning.check_axes(("x", "y"), 2) == ()
    for axes, says in [
        (("waist",), "1 names stand for 2"),
        ("waist", "1 names stand for 2"),
        (("waist", ""), "not all names"),
        (("waist", 3), "not all names"),
        (("waist", "waist"), "'waist' stands twice"),
    ]:
        with pytest.raises(DemonstrationError, match=f"axes: .*{says}.*a name of its own"):
            cleaning.check_axes(axes, 2)
