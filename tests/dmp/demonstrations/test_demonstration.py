"""What a demonstration promises to those who use it."""

import warnings

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from comove.dmp.demonstrations import Demonstration, write_csv, write_npz
from comove.errors import ComoveWarning, DemonstrationError, OptionError

TIME = np.linspace(0.0, 2.0, 101)
REACH = np.column_stack((0.3 * (1.0 - np.cos(0.5 * np.pi * TIME)), 0.1 * TIME**2))


def reach(**changes):
    return Demonstration(**{"time": TIME, "position": REACH, "name": "reach", **changes})


def test_a_clean_recording_is_taken_as_it_is():
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        demo = reach()
    np.testing.assert_array_equal(demo.time, TIME)
    np.testing.assert_array_equal(demo.position, REACH)
    assert demo.notes == ()
    assert (demo.n_steps, demo.n_dims, demo.duration) == (101, 2, 2.0)
    np.testing.assert_array_equal(demo.start, REACH[0])
    np.testing.assert_array_equal(demo.goal, REACH[-1])


def test_arrays_are_read_only_copies():
    time = TIME.copy()
    demo = Demonstration(time, REACH.astype(np.float32))
    time[0] = -1.0
    assert demo.time[0] == 0.0
    assert demo.position.dtype == np.float64
    for array in (demo.time, demo.position, demo.start):
        with pytest.raises(ValueError, match="read-only"):
            array[...] = 0.0


def test_uneven_time_is_kept():
    time = TIME**2
    np.testing.assert_array_equal(reach(time=time).time, time)


def test_a_late_start_is_only_noted():
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        demo = reach(time=TIME + 1.7e9)
    assert demo.time[0] == 0.0
    assert demo.notes == ("time shifted by -1.7e+09 s to start at 0",)


def test_merging_is_noted_and_warned_of_once():
    time = np.round(TIME, 1)
    with pytest.warns(ComoveWarning, match="reach: repeated time stamps") as caught:
        demo = reach(time=time)
    assert len(caught) == 1
    assert caught[0].filename == __file__
    assert (np.diff(demo.time) > 0.0).all()
    assert demo.n_steps == 21
    assert "101 rows became 21" in demo.notes[0]


def test_millimetres_are_hinted_at_once_and_not_again_by_what_is_derived():
    with pytest.warns(ComoveWarning, match="looks like millimetres; give the unit") as caught:
        demo = reach(position=1000.0 * REACH)
    assert len(caught) == 1
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        demo.resampled(50)
        reach(position=1000.0 * REACH, unit="mm")


def test_bad_arrays_are_refused():
    with pytest.raises(DemonstrationError, match=r"time\[1\]: time stands still"):
        reach(time=np.ones(101))


@given(st.integers(0, 2**32 - 1), st.integers(3, 200))
def test_end_velocities_are_exact_for_parabolas_at_uneven_steps(seed, n_steps):
    rng = np.random.default_rng(seed)
    time = np.concatenate(([0.0], np.cumsum(rng.uniform(0.005, 0.02, n_steps - 1))))
    start, velocity, half = rng.uniform(-1.0, 1.0, size=(3, 4))
    demo = Demonstration(time, start + np.outer(time, velocity) + np.outer(time**2, half), unit="any")
    np.testing.assert_allclose(demo.start_velocity, velocity, atol=1e-8)
    np.testing.assert_allclose(demo.goal_velocity, velocity + 2.0 * half * time[-1], atol=1e-8)


def test_end_velocities_of_two_samples_are_their_slope():
    demo = Demonstration([0.0, 0.5], [[0.0], [1.0]])
    np.testing.assert_allclose([demo.start_velocity, demo.goal_velocity], [[2.0], [2.0]])


def test_noise_and_a_pair_of_close_stamps_do_not_decide_the_start_velocity():
    rng = np.random.default_rng(3)
    time = np.linspace(0.0, 2.0, 2001)
    time[1] = 1e-9
    noisy = np.outer(time, [0.5, 0.2]) + rng.normal(scale=1e-5, size=(2001, 2))
    np.testing.assert_allclose(Demonstration(time, noisy).start_velocity, [0.5, 0.2], atol=0.01)


def test_resampling_gives_even_steps_and_keeps_the_ends():
    demo = reach(time=TIME**2).resampled(321)
    np.testing.assert_allclose(np.diff(demo.time), demo.duration / 320, atol=1e-14)
    np.testing.assert_array_equal(demo.position[[0, -1]], REACH[[0, -1]])
    expected = 0.3 * (1.0 - np.cos(0.5 * np.pi * np.sqrt(demo.time)))
    np.testing.assert_allclose(demo.position[:, 0], expected, atol=1e-4)
    assert demo.notes == ("resampled from 101 to 321 even time steps",)


@pytest.mark.parametrize("n_steps", [1, 0, 2.5, True, "9"])
def test_impossible_numbers_of_steps_are_refused(n_steps):
    with pytest.raises(OptionError, match=r"n_steps: .* give 2 or more"):
        reach().resampled(n_steps)


def test_smoothing_is_said_with_the_largest_displacement():
    rough = REACH + np.random.default_rng(0).normal(scale=1e-3, size=REACH.shape)
    demo = reach(position=rough)
    with pytest.warns(ComoveWarning, match=r"reach: smoothed .* 4 Hz\): samples moved by up to") as caught:
        smoothed = demo.smoothed(4.0)
    assert len(caught) == 1
    assert caught[0].filename == __file__
    moved = np.linalg.norm(smoothed.position - rough, axis=1).max()
    assert f"{moved:.3g} m" in smoothed.notes[-1]
    np.testing.assert_array_equal(smoothed.time, demo.time)
    np.testing.assert_array_equal(smoothed.position[[0, -1]], rough[[0, -1]])
    assert np.abs(smoothed.position - REACH)[10:-10].max() < 1e-3


@pytest.mark.parametrize("cutoff", [0.0, -1.0, 25.0, float("nan"), float("inf")])
def test_a_cutoff_that_the_recording_does_not_hold_is_refused(cutoff):
    with pytest.raises(OptionError, match=r"cutoff_hz: .* between 0 and 25 Hz"):
        reach().smoothed(cutoff)


def test_trimming_cuts_standing_still_at_both_ends():
    position = np.concatenate((np.repeat(REACH[:1], 20, 0), REACH, np.repeat(REACH[-1:], 30, 0)))
    demo = Demonstration(np.arange(151) / 50.0, position)
    trimmed = demo.trimmed(0.001)
    np.testing.assert_array_equal(trimmed.position, REACH)
    np.testing.assert_allclose(trimmed.time, TIME, atol=1e-14)
    assert trimmed.notes == ("standing still cut: 0.4 s at the start, 0.6 s at the end",)
    assert trimmed.trimmed(0.001) is trimmed
    with pytest.raises(OptionError, match=r"never exceeds 9\.0 m/s; its largest speed is 0\.5149 m/s"):
        demo.trimmed(9.0)


def turning(n_steps=101, axis=(0.0, 0.0, 1.0)):
    """Orientations of a hand that turns by one radian."""
    angle = np.linspace(0.0, 1.0, n_steps)[:, None] / 2.0
    return np.concatenate((np.cos(angle), np.sin(angle) * axis), axis=1)


def test_orientations_are_read_only_copies_and_rotations():
    quaternions = turning()
    demo = reach(orientation=quaternions)
    assert demo.orientation.tobytes() == quaternions.tobytes()
    quaternions[:] = 0.0
    with pytest.raises(ValueError, match="read-only"):
        demo.orientation[0] = 0.0
    np.testing.assert_allclose(demo.rotation.as_rotvec()[:, 2], np.linspace(0.0, 1.0, 101), atol=1e-15)
    assert reach().orientation is None
    assert reach().rotation is None


def test_changes_of_sign_are_noted_and_no_fault():
    quaternions = turning()
    quaternions[40:60] *= -1.0
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        demo = reach(orientation=quaternions)
    np.testing.assert_array_equal(demo.orientation, turning())
    assert demo.notes == ("2 changes of sign between quaternions undone",)


def test_a_quaternion_in_another_order_of_magnitude_is_refused_by_its_row():
    quaternions = turning()
    quaternions[7] *= 1.01
    with pytest.raises(DemonstrationError, match=r"orientation\[7\]: .*norm 1\.01, not 1; .*w x y z"):
        reach(orientation=quaternions)


@pytest.mark.filterwarnings("ignore:reach")
def test_what_is_derived_turns_along():
    demo = reach(orientation=turning(), axes=("a", "b"))
    angle = {
        "resampled": demo.resampled(31).rotation.magnitude(),
        "smoothed": demo.smoothed(8.0).rotation.magnitude(),
    }
    np.testing.assert_allclose(angle["resampled"], np.linspace(0.0, 1.0, 31), atol=1e-12)
    np.testing.assert_allclose(angle["smoothed"], np.linspace(0.0, 1.0, 101), atol=1e-3)
    assert demo.smoothed(8.0).axes == demo.resampled(31).axes == ("a", "b")
    assert "turned by up to" in demo.smoothed(8.0).notes[-1]
    halved = reach(time=np.repeat(TIME[::2], 2)[:101], orientation=turning())
    np.testing.assert_allclose(np.diff(halved.rotation.magnitude())[:-1], 0.02, atol=1e-9)
    position = np.concatenate((np.repeat(REACH[:1], 20, 0), REACH))
    rested = Demonstration(np.arange(121) / 50.0, position, orientation=turning(121))
    assert rested.trimmed(1e-4).orientation.tobytes() == turning(121)[20:].tobytes()


@given(st.integers(0, 2**32 - 1), st.floats(1e-6, 1e11))
def test_orientations_belong_to_merged_stamps_whenever_the_clock_began(seed, began):
    rng = np.random.default_rng(seed)
    stamps = began + np.sort(rng.integers(0, 6, size=12)) * rng.choice([1e-16, 1e-9, 1.0], size=1)
    stamps[-1] = began + 8.0 + 1e-3 * began
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        demo = Demonstration(stamps, rng.normal(size=(12, 2)), orientation=turning(12))
    assert demo.orientation.shape == (demo.n_steps, 4)


def test_many_joints_have_names_and_are_not_taken_for_millimetres():
    time = np.linspace(0.0, 1.0, 5)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        demo = Demonstration(
            time, np.outer(time, np.full(64, 6.0)), unit="rad", axes=[f"j{i}" for i in range(64)]
        )
    assert demo.axes[63] == "j63"
    with pytest.warns(ComoveWarning, match="looks like degrees"):
        Demonstration(time, np.outer(time, [90.0]), unit="rad")
    with pytest.raises(DemonstrationError, match="axes: 1 names stand for 2 coordinates"):
        reach(axes=("a",))


@pytest.mark.parametrize(("suffix", "write"), [(".csv", write_csv), (".NPZ", write_npz)])
def test_load_goes_by_suffix_and_asks_which_manipulator(tmp_path, suffix, write):
    path = tmp_path / f"carry{suffix}"
    write(path, {"left": reach(), "right": reach(position=REACH + 1.0)})
    np.testing.assert_array_equal(Demonstration.load(path, "right").start, REACH[0] + 1.0)
    with pytest.raises(DemonstrationError, match="2 manipulators; name one of left, right"):
        Demonstration.load(path)
    with pytest.raises(DemonstrationError, match="no 'rigth'; did you mean 'right'"):
        Demonstration.load(path, "rigth")
    write(path, {"left": reach()})
    assert Demonstration.load(path).name == "carry.left"
    write(path, reach())
    with pytest.raises(DemonstrationError, match="without a name, not 'left'; leave"):
        Demonstration.load(path, "left")


def test_load_refuses_other_kinds():
    with pytest.raises(DemonstrationError, match=r"carry\.cvs: .* did you mean '\.csv'"):
        Demonstration.load("carry.cvs")


def test_from_csv_reads_what_load_reads(tmp_path):
    table = tmp_path / "carry.csv"
    table.write_text("time,x,y\n" + "".join(f"{i / 10},{i / 100},{i * i / 1e4}\n" for i in range(30)))
    named, loaded = Demonstration.from_csv(table), Demonstration.load(table)
    assert np.array_equal(named.position, loaded.position) and np.array_equal(named.time, loaded.time)
