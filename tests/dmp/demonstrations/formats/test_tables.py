"""Tables of other programs: what is written is read, in metres and seconds, and what cannot be is told in words."""

import shlex
import warnings
from pathlib import Path

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from comove.cli import learn  # noqa: F401  registers the verb
from comove.cli.library import add  # noqa: F401  this one too
from comove.dmp.demonstrations import Demonstration, resampling
from comove.dmp.demonstrations.units import LENGTHS
from comove.errors import ComoveError, ComoveWarning, DemonstrationError, OptionError
from tests.cases import examples
from tests.cli.test_cli import assert_refused
from tests.commands import invoke
from tests.dmp.demonstrations.formats.advice import follow

TIME = np.arange(0.0, 8.0, 0.01)
SHARE = np.clip((TIME - 2.0) / 3.0, 0.0, 1.0)
POSITION = np.column_stack(  # stands still, moves from 2 s to 5 s, stands still [mm]
    [
        700 * SHARE**3 * (10 - 15 * SHARE + 6 * SHARE**2),
        300 + 150 * np.sin(np.pi * SHARE) ** 3,
        50 + 0 * TIME,
    ]
)


def write(path, header, *columns, separator=";", comma=False, preamble=""):
    rows = "".join(separator.join(f"{x:.9g}" for x in row) + "\n" for row in np.column_stack(columns))
    path.write_text(preamble + header + "\n" + (rows.replace(".", ",") if comma else rows))
    return path


@pytest.mark.parametrize("separator", [";", "\t", ",", " "])
@pytest.mark.parametrize("unit", ["m", "cm", "mm", "in"])
def test_positions_come_back_in_metres(tmp_path, separator, unit):
    header = separator.join(["t", "X", "Y", "Z"])
    path = write(tmp_path / "r.txt", header, TIME, POSITION * 1e-3 / LENGTHS[unit], separator=separator)
    read = Demonstration.load(path, columns=["X", "Y", "Z"], unit=unit)
    np.testing.assert_allclose(read.position, POSITION * 1e-3, atol=1e-8)
    np.testing.assert_allclose(read.time, TIME, atol=1e-9)


def test_what_a_program_writes_is_found(tmp_path):
    """A preamble, decimal commas, units in the header, columns by names in another case."""
    header = "Frame;Zeit (ms);X [mm];Y [mm];Z [mm]"
    columns = np.arange(len(TIME)), 1e3 * TIME, POSITION
    path = write(tmp_path / "r.csv", header, *columns, comma=True, preamble="Tracker v2\n\nid;7\n")
    for chosen in (None, ["x", "y", "z"], ["X [mm]", "Y", "5"]):
        read = Demonstration.load(path, columns=chosen)
        np.testing.assert_allclose(read.position, POSITION * 1e-3, atol=1e-8)
        np.testing.assert_allclose(read.time, TIME, atol=1e-9)


def test_columns_have_numbers_where_they_have_no_names(tmp_path):
    path = tmp_path / "r.dat"
    np.savetxt(path, np.column_stack([POSITION, TIME]))
    read = Demonstration.load(path, columns=["1", "2"], time="4", unit="mm")
    np.testing.assert_allclose(read.position, POSITION[:, :2] * 1e-3, atol=1e-9)
    at_rate = Demonstration.load(path, columns=["1", "2"], rate=100, unit="mm")
    np.testing.assert_allclose(at_rate.time, TIME, atol=1e-9)


@examples(30)
@given(
    st.lists(st.floats(-1e3, 1e3, width=32), min_size=4, max_size=20), st.sampled_from(";,\t "), st.booleans()
)
@example([0.0, 1.5, 0.0, 0.0], " ", True)
def test_any_numbers_are_read_as_they_stand(tmp_path_factory, values, separator, comma):
    path = tmp_path_factory.mktemp("any") / "r.csv"
    comma = comma and separator != ","
    write(
        path,
        separator.join(["time", "x"]),
        np.arange(len(values)) / 10,
        values,
        separator=separator,
        comma=comma,
    )
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ComoveWarning)
        read = Demonstration.load(path, columns=["x"])
    np.testing.assert_allclose(read.position[:, 0], values, rtol=1e-7, atol=1e-7)


def test_the_movement_between_the_pauses_is_found_and_its_noise_taken_away(tmp_path):
    rng, noise = np.random.default_rng(4), 0.4
    path = write(tmp_path / "r.csv", "t;X;Y;Z", TIME, POSITION + noise * rng.standard_normal(POSITION.shape))
    with pytest.warns(ComoveWarning, match="smoothed"):
        hand = Demonstration.load(path, columns=["X", "Y", "Z"], unit="mm", clean=True)
    assert 2.6 < hand.duration < 3.2
    assert any("from 2" in note for note in hand.notes)
    begin = np.argmin(np.abs(TIME - (5.0 - 0.5 * (3.0 - hand.duration) - hand.duration)))
    inner = slice(20, -20)
    truth = POSITION[begin : begin + hand.n_steps] * 1e-3
    off = np.linalg.norm(hand.position[inner] - truth[inner], axis=1)
    assert np.sqrt((off**2).mean()) < 0.5 * noise * 1e-3 * np.sqrt(3)


@pytest.mark.parametrize("deviation", [1e-4, 1e-3, 5e-3])
def test_noise_is_told_from_movement(deviation):
    """Its size from fourth differences; and what the filter removes is no more than that."""
    rng = np.random.default_rng(5)
    noisy = POSITION * 1e-3 + deviation * rng.standard_normal(POSITION.shape)
    assert resampling.noise(TIME, noisy) == pytest.approx(deviation * np.sqrt(3), rel=0.15)
    smoothed = resampling.smooth(TIME, noisy, resampling.cutoff_of_noise(TIME, noisy))
    off = [np.sqrt(((x - POSITION * 1e-3) ** 2).sum(axis=1).mean()) for x in (noisy, smoothed)]
    assert off[1] < 0.6 * off[0]


def test_without_noise_nothing_is_smoothed():
    assert resampling.cutoff_of_noise(TIME, POSITION) is None


def test_of_several_movements_the_longest_is_taken():
    far = np.concatenate([POSITION, POSITION[-1] + 0.1 * (POSITION[::-1] - POSITION[-1])]) * 1e-3
    hand = Demonstration(np.arange(len(far)) / 100, far, "two").cleaned()
    assert np.linalg.norm(hand.goal - hand.start) > 0.6


def test_what_stands_still_is_refused():
    with pytest.raises(DemonstrationError, match="never moves"):
        Demonstration(TIME, np.zeros((len(TIME), 2))).cleaned()


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"columns": ["X", "W"]}, "no column 'W'.*known: n, t, X, Y, Z"),
        ({"columns": ["X", "X"]}, "stands twice"),
        ({"columns": ["X", "9"]}, "no column '9'"),
        ({"delimiter": "ab"}, "cannot separate"),
        ({"delimiter": "|"}, "no table of numbers"),
        ({"time": "clock"}, "no column 'clock'"),
        ({"time": "t [fortnight]"}, "unit of time 'fortnight'"),
        ({"rate": 0.0}, "no rate"),
        ({"rate": 100.0, "time": "t"}, "both a column of time and a rate"),
        ({"unit": "parsec"}, "'parsec' is not known"),
        ({"time": "n"}, r"steps are 1, .* --rate HZ; run: .* --rate HZ "),
        ({"time": "X"}, "time"),
        ({"unit": "deg", "columns": None}, "X is a position, which deg does not measure"),
        ({"manipulator": "left"}, "one movement without a name"),
        ({"episode": 1}, "it holds one recording"),
        ({"topic": "/x"}, "only bags have topics"),
        ({"dataset": "obs"}, "text table has no such option"),
    ],
)
def test_bad_options_are_told(tmp_path, options, words):
    path = write(tmp_path / "r.csv", "n;t;X;Y;Z", np.arange(len(TIME)), TIME, POSITION)
    with pytest.raises(ComoveError, match=words):
        Demonstration.load(path, **{"columns": ["X", "Y"], **options})


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "empty"),
        ("t;X\n", "no rows below"),
        ("t;X\n0;1\n1;\n", "row 3, column X: the cell is empty"),
        ("t;X\n0;1\n0.1;one\n", "row 3, column X: 'one' is not a number"),
        ("t;X\n0;1\n0.1\n", "row 3: it has 1 cells"),
        ("t;X\n0;1\n0.1;nan\n", "row 3, column X"),
        ("t;X\n0.2;1\n0.1;2\n", "time goes back"),
        ("Y;X\n0.2;1\n0.1;2\n", "no column of time.* --rate HZ; run: .* --rate HZ "),
    ],
)
def test_bad_tables_are_told(tmp_path, text, words):
    path = tmp_path / "bad.csv"
    path.write_text(text)
    with pytest.raises(DemonstrationError, match=words):
        Demonstration.load(path, columns=["X"])


def test_a_unit_contradicts_what_the_file_says(tmp_path):
    path = tmp_path / "r.csv"
    path.write_text("time,elbow [rad]\n0,0\n1,1\n")
    with pytest.raises(OptionError, match="in rad"):
        Demonstration.load(path, unit="mm")


def test_learning_one_s_own_recording(tmp_path):
    path = write(tmp_path / "r.csv", "t;X;Y;Z", TIME, POSITION)
    options = ("--unit", "mm", "--columns", "X,Y,Z", "--delimiter", ";", "--clean")
    outcome = invoke("learn", path, *options, "--out", tmp_path / "p.json")
    assert outcome.exit_code == 0, outcome.stderr
    assert "movement 0 of 1" in outcome.stdout


def test_nothing_is_kept_that_spans_hundreds_of_metres_by_mistake(tmp_path):
    path = write(tmp_path / "r.csv", "time,x,y", TIME, POSITION[:, :2], separator=",")
    assert_refused(invoke("learn", path, "--out", tmp_path / "p.json"), "spans 700 m", "--unit mm")
    library = invoke("library", "add", path, "--folder", tmp_path / "lib")
    assert_refused(library, "spans 700 m", "--unit mm")
    assert not (tmp_path / "p.json").exists()
    assert not (tmp_path / "lib").exists()
    assert invoke("learn", path, "--unit", "mm", "--out", tmp_path / "p.json").exit_code == 0
    assert invoke("learn", path, "--unit", "m", "--out", tmp_path / "q.json").exit_code == 0


def test_forces_of_a_table_of_angles_are_no_joints(tmp_path):
    """Tables of biomechanics say that angles are in radians, also where they hold no angles but moments."""
    path = tmp_path / "loads.sto"
    head = "Loads\nversion=1\ninDegrees=no\nendheader\n"
    write(path, "time\tneck_tilt_moment\tneck_tx_force", TIME, POSITION[:, :2], separator="\t", preamble=head)
    with pytest.raises(DemonstrationError, match="no positions beside time"):
        Demonstration.load(path)
    for title in ("Velocities", "Accelerations", "Body Forces"):
        write(path, "time\thand_X\thand_Y", TIME, POSITION[:, :2], separator="\t", preamble=title + head[5:])
        with pytest.raises(DemonstrationError, match=f"'{title}', which are no positions"):
            Demonstration.load(path)
    write(path, "time\tneck_tilt\tneck_moment", TIME, POSITION[:, :2] / 900, separator="\t", preamble=head)
    read = Demonstration.load(path)
    assert read.axes == ("neck_tilt",)
    assert read.unit == "rad"


def test_speeds_and_counts_without_names_are_not_offered_as_positions(tmp_path):
    """Scripts save time, positions, speeds and accelerations; trackers a number of the frame and of a part of it."""
    path = tmp_path / "r.txt"
    time, plane = TIME[150:400], 1e-3 * POSITION[150:400, :2]
    speed = np.gradient(plane, time, axis=0)
    np.savetxt(path, np.column_stack([time, plane, speed, np.gradient(speed, time, axis=0)]), fmt="%.7f")
    np.testing.assert_allclose(follow(path).position, plane, atol=1e-6)
    kinds = ["%d", "%d", "%.9f", "%.9f", "%.9f"]
    table = np.column_stack([np.arange(len(TIME)) + 1, 0 * TIME, 1e-3 * POSITION])[:400]
    np.savetxt(path, table, fmt=kinds, delimiter=",")
    np.testing.assert_allclose(follow(path).position, 1e-3 * POSITION[:400], atol=1e-8)


@pytest.mark.parametrize(
    ("header", "asked"),
    [
        ("n,wheel_l,wheel_r,beta", ["UNIT", "HZ"]),  # speeds, or angles, or metres: no name says it
        ("t,u,v,w1", ["UNIT"]),
        ("n,x,y,z", ["HZ"]),
        ("time,x,y,z", ["UNIT"]),  # in steps of 2
    ],
)
def test_a_printed_command_states_nothing_that_nobody_told(tmp_path, monkeypatch, header, asked):
    """Followed to the letter it is refused, and says what to write; with that it is learned."""
    monkeypatch.chdir(tmp_path)
    first = TIME if header[0] == "t" else np.arange(len(TIME))
    first = 2 * np.arange(len(TIME)) if "time" in header else first
    write(tmp_path / "r.csv", header, first, 1e-3 * POSITION, separator=",")
    words, found = ["learn", "r.csv", "--out", "r.json"], []
    for _ in range(5):
        outcome = invoke(*words)
        if outcome.exit_code == 0:
            break
        words = shlex.split(outcome.stderr.partition("; run: comove ")[2].partition(" (comove explain")[0])
        open_ = [word for word in asked if any(word in one.strip("[]").split(" [") for one in words)]
        if open_:
            literal = invoke(*words)
            assert literal.exit_code == 2
            assert open_[0] in literal.stderr or "seconds" in literal.stderr
        found += open_
        words = [{"HZ": "100", "UNIT": "m"}.get(word, word.replace("[UNIT]", "[s]")) for word in words]
    assert found == asked
    assert Path("r.json").exists()


def test_currents_statistics_and_orientations_are_not_offered_as_positions(tmp_path):
    path = tmp_path / "r.csv"
    for header in (
        "time,motor_current_1,V_bat [V],pos_current",
        "time,mean_val,median_val,sum_val",
        "time,Range to 0x6a7b (mm),RSS to 0x6a7b (dB),induction [uT]",
        "t,qx,qy,qz",
    ):
        write(path, header, TIME, 1e-3 * POSITION, separator=",")
        with pytest.raises(DemonstrationError, match="no positions beside time") as caught:
            Demonstration.load(path)
        assert "run:" not in caught.value.way_out
    write(path, "time,current_x,current_y,current_z", TIME, 1e-3 * POSITION, separator=",")
    np.testing.assert_allclose(Demonstration.load(path).position, 1e-3 * POSITION, atol=1e-12)


def test_one_coordinate_with_its_speed_and_acceleration_is_no_point_in_space(tmp_path):
    path = tmp_path / "r.txt"
    noise = np.random.default_rng(3).normal(0.0, [[1e-4, 0.2, 9.0]], (len(TIME), 3))
    speed = np.gradient(1e-3 * POSITION[:, 0], TIME)
    for share in (0.0, 1.0):
        columns = 1e-3 * POSITION[:, 0], speed, np.gradient(speed, TIME)
        np.savetxt(path, np.column_stack([TIME, np.column_stack(columns) + share * noise]))
        with pytest.raises(DemonstrationError, match=r"columns: no column is named") as caught:
            Demonstration.load(path)
        assert caught.value.options["columns"][0] == "2"


def test_numbers_of_steps_are_not_offered_as_time(tmp_path):
    """Every twentieth step of a simulation is logged: how long a step lasts, nobody told."""
    path = write(tmp_path / "r.csv", "step,x,y,z", 20 * np.arange(len(TIME)), 1e-3 * POSITION, separator=",")
    with pytest.raises(DemonstrationError, match="no column of time") as caught:
        Demonstration.load(path)
    assert caught.value.options == {"rate": "HZ"}


def test_a_column_that_states_no_unit_is_not_believed_to_state_one(tmp_path):
    """`x [mm],y,z` may be millimetres in all three: it is doubted as if nothing were stated."""
    path = write(tmp_path / "r.csv", "time,x [mm],y,z", TIME, POSITION, separator=",")
    assert_refused(invoke("learn", path, "--out", tmp_path / "p.json"), "looks like millimetres", "--unit mm")
    np.testing.assert_allclose(Demonstration.load(path, unit="mm").position, 1e-3 * POSITION, atol=1e-12)


def test_angles_of_an_orientation_have_the_unit_that_one_of_them_states(tmp_path):
    path = tmp_path / "r.csv"
    turns = np.column_stack([2.0 * SHARE, 3.0 * SHARE, 4.0 * SHARE])  # deg, as small as radians are
    columns = 1e-3 * POSITION, turns
    read = []
    for angles in ("roll,pitch,yaw [deg]", "roll [deg],pitch [deg],yaw [deg]"):
        write(path, f"time,x,y,z,{angles}", TIME, *columns, separator=",")
        read.append(Demonstration.load(path).orientation)
    np.testing.assert_array_equal(*read)


def test_places_on_the_earth_and_its_times_are_no_positions(tmp_path):
    header = "app_epoch_ms,lat,lon"
    path = write(tmp_path / "r.csv", header, 1.7e12 + 1e3 * TIME, POSITION[:, :2] / 10, separator=",")
    with pytest.raises(DemonstrationError, match="no positions beside time"):
        Demonstration.load(path)
    with pytest.raises(OptionError, match=r"'app_epoch_ms' is a time.*--time 'app_epoch_ms'"):
        Demonstration.load(path, columns=["app_epoch_ms", "lat"])


def test_the_time_of_an_epoch_is_found(tmp_path):
    header = "robot_epoch_ms,x,y,z"
    rows = "".join(
        f"{1_700_000_000_000 + 10 * i},{x:.9g},{y:.9g},{z:.9g}\n" for i, (x, y, z) in enumerate(POSITION)
    )
    (tmp_path / "r.csv").write_text(header + "\n" + rows)
    np.testing.assert_allclose(Demonstration.load(tmp_path / "r.csv", unit="mm").time, TIME, atol=1e-9)


def test_arrays_without_names_and_printed_messages_come_with_the_way_to_a_table(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    np.save("r.npy", np.column_stack([TIME, 1e-3 * POSITION]))
    with pytest.raises(DemonstrationError, match=r"numpy\.savetxt\('r\.csv', numpy\.load\('r\.npy'\)"):
        Demonstration.load("r.npy")
    np.savetxt("r.csv", np.load("r.npy"), delimiter=",")  # as it says
    np.testing.assert_allclose(Demonstration.load("r.csv").position, 1e-3 * POSITION, atol=1e-12)
    (tmp_path / "odom.csv").write_text("header:\n  stamp:\n    sec: 1\npose:\n  x: 0.1\n---\n")
    with pytest.raises(DemonstrationError, match="ros2 topic echo --csv TOPIC"):
        Demonstration.load("odom.csv")


def test_bones_are_told_from_the_markers_on_them(tmp_path):
    """Trackers write bones as they do rigid bodies, and markers that bear their names."""
    rows = [
        ["Format Version", "1.25", "Length Units", "Millimeters"] + [""] * 8,
        ["", "Type", *["Bone"] * 7, *["Bone Marker"] * 3],
        ["", "Name", *["Ann:Hand"] * 10],
        ["", "ID", *["1"] * 10],
        ["", "", *["Rotation"] * 4, *["Position"] * 6],
        ["Frame", "Time (Seconds)", *"XYZW", *"XYZ", *"XYZ"],
    ]
    still = np.tile([0.0, 0.0, 0.0, 1.0], (len(TIME), 1))
    head = "".join(",".join(row) + "\n" for row in rows)
    columns = np.arange(len(TIME)), TIME, still, POSITION, POSITION + 30.0
    path = write(tmp_path / "r.csv", head.rstrip("\n"), *columns, separator=",")
    read = Demonstration.load(path)
    np.testing.assert_allclose(read.position, 1e-3 * POSITION, atol=1e-8)
    np.testing.assert_allclose(np.abs(read.orientation[:, 0]), 1.0)


def test_what_grows_only_at_first_is_not_offered_as_time(tmp_path):
    path = tmp_path / "r.txt"
    np.savetxt(path, np.column_stack([1e-3 * POSITION, np.minimum(TIME, 0.8)]))
    with pytest.raises(DemonstrationError, match="no time among 4") as caught:
        Demonstration.load(path, columns=["1", "2", "3"])
    assert caught.value.options == {"rate": "HZ"}


def test_several_recordings_in_one_table_are_told(tmp_path):
    steps = np.tile(np.arange(len(TIME) // 2), 2)
    path = write(tmp_path / "r.csv", "step,x,y,z", steps, 1e-3 * POSITION, separator=",")
    with pytest.warns(ComoveWarning, match=rf"column 'step' begins again in the sample {len(TIME) // 2 + 1}"):
        Demonstration.load(path, rate=100)
    path = write(tmp_path / "s.csv", "frame,sub frame,x,y,z", TIME, 0 * TIME, 1e-3 * POSITION, separator=",")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        Demonstration.load(path, rate=100)


def test_joints_beside_a_position_are_told(tmp_path):
    path = write(
        tmp_path / "r.csv",
        "t,x,y,z,joint1,joint2,gripper",
        TIME,
        1e-3 * POSITION,
        POSITION / 900,
        separator=",",
    )
    assert any(note == "left out: joint1, joint2, gripper" for note in Demonstration.load(path).notes)
