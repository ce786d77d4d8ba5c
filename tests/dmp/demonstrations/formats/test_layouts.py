"""Tables of many programs: one movement, written in each layout, is read as it is, or with printed options."""

import random
import warnings
from contextlib import suppress

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from comove.dmp.demonstrations import Demonstration
from comove.errors import ComoveError, ComoveWarning, DemonstrationError
from tests.cases import examples
from tests.dmp.demonstrations.formats.advice import followed

N = 201
TIME = np.arange(N) / 100.0
SHARE = TIME / TIME[-1]
POSITION = np.column_stack(
    (0.3 * SHARE**3 * (10 - 15 * SHARE + 6 * SHARE**2), 0.1 * np.sin(np.pi * SHARE), 0.2 + 0.05 * TIME)
)
TURN = Rotation.from_rotvec(np.outer(0.4 * TIME, [0.2, 0.3, 0.9]))
XYZW = TURN.as_quat()
WXYZ = XYZW[:, [3, 0, 1, 2]]
FRAME = np.arange(N)
STAMPS = [1_700_000_000_000_000_000 + 10_000_000 * i for i in range(N)]
MM = 1e3 * POSITION


def rows(*columns, separator=",", comma=False):
    """Return rows of columns: arrays of numbers, or lists of anything."""
    cells = []
    for column in columns:
        if isinstance(column, np.ndarray):
            cells += [[f"{x:.12g}" for x in values] for values in np.atleast_2d(column.T)]
        else:
            cells.append([str(value) for value in column])
    text = "".join(separator.join(row) + "\n" for row in zip(*cells, strict=True))
    return text.replace(".", ",") if comma else text


def named(*parts):
    return ",".join(parts) + "\n"


POSE = "field.pose.position.{} field.pose.orientation.{}"
ROSTOPIC = named(
    "%time",
    "field.header.seq",
    "field.header.stamp",
    "field.header.frame_id",
    *(f"field.pose.position.{axis}" for axis in "xyz"),
    *(f"field.pose.orientation.{axis}" for axis in "xyzw"),
)
MOTIVE = (
    "Format Version,1.24,Take Name,x,Capture Frame Rate,100.000000,Export Frame Rate,100.000000,"
    "Rotation Type,Quaternion,Length Units,Millimeters\n\n"
    + named("", "Type", "", *["Rigid Body"] * 8, *["Rigid Body Marker"] * 3)
    + named("", "Name", "", *["Hand"] * 8, *["Hand:M1"] * 3)
    + named("", "ID", "", *["A"] * 8, *["B"] * 3)
    + named("", "Parent", "", *[""] * 8, *["A"] * 3)
    + named("", "", "", *["Rotation"] * 4, *["Position"] * 3, "Mean Marker Error", *["Position"] * 3)
    + named("Frame", "Time (Seconds)", "TimeCode", *"XYZW", *"XYZ", "", *"XYZ")
)
TRC = (
    "PathFileType\t4\t(X/Y/Z)\tf.trc\n"
    "DataRate\tCameraRate\tNumFrames\tNumMarkers\tUnits\tOrigDataRate\tOrigDataStartFrame\tOrigNumFrames\n"
    "100.00\t100.00\t201\t1\tmm\t100.00\t1\t201\nFrame#\tTime\tHand\t\t\n\t\tX1\tY1\tZ1\n\n"
)
VICON = (
    "Objects\n100\n,,Global Angle (Quaternion) Hand:Hand,,,,,,\n"
    "Frame,Sub Frame,RX,RY,RZ,RW,TX,TY,TZ\n,,,,,,mm,mm,mm\n"
)
QTM = "NO_OF_FRAMES\t201\nNO_OF_MARKERS\t1\nFREQUENCY\t100\nTIME_STAMP\t2020-01-01\nMARKER_NAMES\thand\n"
UR = " ".join(
    ["timestamp", *(f"actual_TCP_pose_{i}" for i in range(6)), *(f"actual_q_{i}" for i in range(6))]
)
CLOCK = [f"10:00:{second:09.6f}" for second in TIME]
MIDNIGHT = [f"{'23:59' if s < 1 else '00:00'}:{(s + 59) % 60:05.2f}" for s in TIME]
ECHO = rows(
    [stamp // 10**9 for stamp in STAMPS], [stamp % 10**9 for stamp in STAMPS], ["base"] * N, POSITION, XYZW
)
BY_COLUMNS = np.zeros((N, 4, 4))
BY_COLUMNS[:, :3, :3] = TURN.as_matrix().transpose(0, 2, 1)
BY_COLUMNS[:, 3] = np.column_stack((POSITION, np.ones(N)))


def day(clock):
    return "12/31/2023" if clock.startswith("23") else "1/1/2024"


LAYOUTS = {
    # separators and decimals
    "semicolons.csv": named("t,X,Y,Z").replace(",", ";") + rows(TIME, POSITION, separator=";"),
    "decimal_commas.csv": "Zeit (s);X (mm);Y (mm);Z (mm)\n" + rows(TIME, MM, separator=";", comma=True),
    "tabs.tsv": "time\tx\ty\tz\n" + rows(TIME, POSITION, separator="\t"),
    "blanks.txt": "time x y z\n" + rows(TIME, POSITION, separator="   "),
    "excel.csv": "sep=;\ntime;x;y;z\n" + rows(TIME, POSITION, separator=";", comma=True),
    # headers
    "matlab.txt": "% time [s]  x [cm]  y [cm]  z [cm]\n" + rows(TIME, 100 * POSITION, separator=" "),
    "savetxt.txt": rows(TIME, POSITION, separator=" "),
    "pandas.csv": ",time,x,y,z\n" + rows(FRAME, TIME, POSITION),
    "pandas_levels.csv": ",pos,pos,pos\n,x,y,z\ntime,,,\n" + rows(TIME, POSITION),
    "units_in_a_row.csv": "t,x,y,z\ns,mm,mm,mm\n" + rows(TIME, MM),
    "units_of_each.csv": "t (ms),x [mm],y [m],z [cm]\n"
    + rows(1e3 * TIME, MM[:, 0], POSITION[:, 1], 100 * POSITION[:, 2]),
    "preamble.csv": "recorded by\nrate: 100 Hz\nunits: mm\n\nX,Y,Z\n" + rows(MM),
    # times
    "milliseconds.csv": "time,x,y,z\n" + rows(10 * FRAME, POSITION),
    "microseconds.csv": "time,x,y,z\n" + rows(10_000 * FRAME, POSITION),
    "nanoseconds.csv": "timestamp,x,y,z\n" + rows([10_000_000 * i for i in FRAME], POSITION),
    "epoch_ns.csv": "timestamp,x,y,z\n" + rows(STAMPS, POSITION),
    "epoch_ms.csv": "stamp_ms,x,y,z\n" + rows([stamp // 10**6 for stamp in STAMPS], POSITION),
    "two_parts.csv": "header.stamp.sec,header.stamp.nanosec,pose.position.x,pose.position.y,pose.position.z\n"
    + rows([stamp // 10**9 for stamp in STAMPS], [stamp % 10**9 for stamp in STAMPS], POSITION),
    **{
        f"{whole}-{part}.csv": f"{whole},{part},x,y,z\n"
        + rows([stamp // 10**9 for stamp in STAMPS], [stamp % 10**9 // unit for stamp in STAMPS], POSITION)
        for whole, part, unit in (("stamp_s", "stamp_ns", 1), ("sec", "usec", 1000), ("tv_sec", "tv_nsec", 1))
    },
    "index.csv": ",x,y,z\n" + rows(TIME, POSITION),
    "minutes.csv": "time,x,y,z\n" + rows([clock[3:] for clock in CLOCK], POSITION),
    "full_hour.csv": "time,x,y,z\n" + rows([clock[3:] for clock in MIDNIGHT], POSITION),
    "iso.csv": "time,x,y,z\n" + rows([f"2024-05-01T{clock}Z" for clock in CLOCK], POSITION),
    "clock.csv": "time,x,y,z\n" + rows(CLOCK, POSITION),
    "midnight.csv": "time,x,y,z\n" + rows(MIDNIGHT, POSITION),
    "zone.csv": "time,x,y,z\n" + rows([f"2024-05-01T{clock}+05:30" for clock in CLOCK], POSITION),
    "slashes.csv": "time,x,y,z\n" + rows([f"{day(c)} {c}" for c in MIDNIGHT], POSITION),
    "points.csv": "Zeit;x;y;z\n"
    + rows([f"1.5.2024 {c}" for c in CLOCK], POSITION, separator=";", comma=False),
    # programs
    "rostopic.csv": ROSTOPIC + rows(STAMPS, FRAME, STAMPS, ["base"] * N, POSITION, XYZW),
    "plotjuggler.csv": "__time,/pose/position/x,/pose/position/y,/pose/position/z\n" + rows(TIME, POSITION),
    "tum.txt": "# ground truth\n# timestamp tx ty tz qx qy qz qw\n"
    + rows(TIME, POSITION, XYZW, separator=" "),
    "bare.tum": rows(TIME, POSITION, XYZW, separator=" "),
    "euroc.csv": named(
        "#timestamp [ns]",
        *(f"p_RS_R_{axis} [m]" for axis in "xyz"),
        *(f"q_RS_{axis} []" for axis in "wxyz"),
        *(f"v_RS_R_{axis} [m s^-1]" for axis in "xyz"),
    )
    + rows(STAMPS, POSITION, WXYZ, POSITION),
    "bare_euroc.csv": rows(STAMPS, POSITION, WXYZ),
    "motive.csv": MOTIVE + rows(FRAME, TIME, ["15:26:46:12"] * N, XYZW, MM, 0 * TIME, MM),
    "trc.trc": TRC + rows(FRAME + 1, TIME, MM, separator="\t"),
    "vicon.csv": VICON + rows(FRAME + 1, 0 * FRAME, XYZW, MM),
    "qtm.tsv": QTM + "Frame\tTime\thand X\thand Y\thand Z\n" + rows(FRAME, TIME, MM, separator="\t"),
    "bare_qtm.tsv": QTM + rows(MM, separator="\t"),
    "ur.csv": UR + "\n" + rows(TIME, POSITION, TURN.as_rotvec(), np.zeros((N, 6)), separator=" "),
    "angles.csv": "time,x,y,z,roll,pitch,yaw\n" + rows(TIME, POSITION, TURN.as_euler("xyz")),
    "angles_deg.csv": "time,x,y,z,roll [deg],pitch [deg],yaw [deg]\n"
    + rows(TIME, POSITION, TURN.as_euler("xyz", degrees=True)),
    "echo.csv": ECHO,
    "franka.csv": named("time", *(f"O_T_EE[{k}]" for k in range(16))) + rows(TIME, BY_COLUMNS.reshape(N, 16)),
    "by_rows.txt": rows(TIME, BY_COLUMNS.transpose(0, 2, 1).reshape(N, 16), separator=" "),
    "numbered.csv": MOTIVE.replace(",A,", ",1E05,") + rows(FRAME, TIME, ["0"] * N, XYZW, MM, 0 * TIME, MM),
    "own_in_mm.csv": "# length unit: mm\ntime,x,y,z\n" + rows(TIME, MM),
    "rxryrzrw.csv": "t,x,y,z,rx,ry,rz,rw,gripper\n" + rows(TIME, POSITION, XYZW, 0 * TIME),
    "time_last.csv": "x,y,z,capture_time,detection_time,confidence\n"
    + rows(POSITION, 93684.5 + TIME, 93684.53 + TIME, 0 * TIME + 0.9),
    "hidden.log": "time,x,y,z\n" + rows(TIME, POSITION),
}
TURNED = {
    *(
        "rostopic.csv",
        "tum.txt",
        "bare.tum",
        "euroc.csv",
        "bare_euroc.csv",
        "motive.csv",
        "vicon.csv",
        "ur.csv",
    ),
    *(
        "angles.csv",
        "angles_deg.csv",
        "rxryrzrw.csv",
        "echo.csv",
        "franka.csv",
        "by_rows.txt",
        "numbered.csv",
    ),
}


def assert_read(hand, turned, tolerance=1e-9):
    assert hand.unit == "m"
    np.testing.assert_allclose(hand.position, POSITION, atol=tolerance)
    np.testing.assert_allclose(hand.time, TIME, atol=1e-7)
    assert (hand.orientation is not None) == turned
    if turned:
        found = Rotation.from_quat(hand.orientation[:, [1, 2, 3, 0]])
        assert (found * TURN.inv()).magnitude().max() < 1e-9


@pytest.mark.parametrize(
    ("name", "encoding"),
    [*((name, "utf-8") for name in LAYOUTS), *((name, "utf-16") for name in [*LAYOUTS][::13])],
)
@pytest.mark.filterwarnings("error")
def test_the_movement_is_read_as_it_is(tmp_path, name, encoding):
    path = tmp_path / name
    path.write_text(LAYOUTS[name], encoding=encoding)
    hand = Demonstration.load(path)
    assert_read(hand, name in TURNED)
    assert hand.notes[0].startswith("time ") and "position from" in hand.notes[0]


MATRICES = np.concatenate((TURN.as_matrix(), POSITION[:, :, None]), axis=2).reshape(N, 12)
TWO = named("Frame", "Time (Seconds)", *"XYZWXYZ", *"XYZWXYZ")
ABOVE = named("", "Name", *["Left"] * 7, *["Right"] * 7) + named(
    "", "", *(["Rotation"] * 4 + ["Position"] * 3) * 2
)
PAIR = rows(FRAME, TIME, XYZW, POSITION, XYZW, POSITION + 1)
ARMS = named("time", *(f"{side}_{axis}" for side in ("left", "right") for axis in "xyz"))
POINTS = {
    "kitti.txt": (rows(MATRICES, separator=" "), {"rate": 100.0}, True),
    "nameless.csv": (
        "time,u,v,Height\n" + rows(TIME, POSITION),
        {"columns": ["u", "v", "Height"], "unit": "m"},
        False,
    ),
    "frames.csv": ("time,x,y,z\n" + rows(FRAME, POSITION), {"rate": 100.0}, False),
    "no_time.csv": ("x,y,z\n" + rows(POSITION), {"rate": 100.0}, False),
    "mistyped.csv": ("tmie,x,y,z\n" + rows(TIME, POSITION), {"time": "tmie"}, False),
    "two_bodies.csv": (ABOVE + TWO + PAIR, {"manipulator": "Left"}, True),
    "two_arms.csv": (ARMS + rows(TIME, POSITION, POSITION), {"manipulator": "left"}, False),
    "two_clocks.csv": ("t,stamp,x,y,z\n" + rows(TIME, 2 * TIME, POSITION), {"time": "t"}, False),
    "with_others.csv": (
        "t,x,y,z,tool.x,tool.y,tool.z\n" + rows(TIME, POSITION, POSITION),
        {"columns": ["x", "y", "z"]},
        False,
    ),
    "one_axis.csv": (
        "time,x1,x2,x3\n" + rows(TIME, POSITION),
        {"columns": ["x1", "x2", "x3"], "unit": "m"},
        False,
    ),
    "repeated.csv": ("t,x,y,z,X\n" + rows(TIME, POSITION, TIME), {"columns": ["2", "3", "4"]}, False),
}


@pytest.mark.parametrize("name", POINTS)
def test_what_is_not_said_is_asked_for_by_a_command(tmp_path, name):
    text, options, turned = POINTS[name]
    (tmp_path / name).write_text(text)
    hand, asked = followed(tmp_path / name)
    assert asked == options
    assert_read(hand, turned)


@pytest.mark.parametrize(
    ("text", "says"),
    [
        (
            "Frame,Sub Frame,Fx,Fy,Fz\n,,N,N,N\n" + rows(FRAME, 0 * FRAME, POSITION),
            "no positions beside time",
        ),
        ("time,x,y,z\n" + rows(TIME, POSITION, comma=True), r"row \d: it has .* look like decimal commas"),
        ("time,p\n" + rows(TIME, [f'"{list(one)}"' for one in POSITION.tolist()]), "hold lists of numbers"),
        ("HIERARCHY\nFrame Time: 0.01\n0 1 2\n0 1 3\n0 1 4\n", "'.bvh' is not known"),
    ],
)
def test_no_command_offers_what_is_no_position(tmp_path, text, says):
    path = tmp_path / ("r.bvh" if "bvh" in says else "r.csv")
    path.write_text(text)
    with pytest.raises(DemonstrationError, match=says) as caught:
        Demonstration.load(path)
    assert "run:" not in caught.value.way_out


def test_a_row_that_lacks_a_cell_of_a_matrix_is_told(tmp_path):
    lines = LAYOUTS["franka.csv"].splitlines()
    lines[3] = lines[3].rpartition(",")[0]
    (tmp_path / "r.csv").write_text("\n".join(lines) + "\n")
    with pytest.raises(DemonstrationError, match="row 4: it has 16 cells and the header has 17"):
        Demonstration.load(tmp_path / "r.csv")


@examples(60)
@given(st.sampled_from(sorted(LAYOUTS)), st.integers(0, 2**32 - 1))
def test_tables_that_are_damaged_are_read_or_refused_in_words(tmp_path_factory, name, seed):
    """Cells of a row near the first ones are lost, repeated, exchanged or overwritten."""
    rng, lines = random.Random(seed), LAYOUTS[name].splitlines()
    row = min(int(rng.expovariate(0.2)), len(lines) - 1)
    mark = max(",;\t ", key=lines[row].count)
    cells, at = lines[row].split(mark), rng.randrange(1000)
    at %= len(cells)
    damage = rng.randrange(4)
    if damage == 0:
        cells.pop(at)
    elif damage == 1:
        cells[at:at] = [rng.choice(cells)]
    elif damage == 2:
        cells[at], cells[0] = cells[0], cells[at]
    else:
        cells[at] = rng.choice(
            ["", "nan", "-", "1e400", "24:61:00.0", "2024-13-45T00:00:00Z", "²", "[1,2]", "\0"]
        )
    lines[row] = mark.join(cells)
    path = tmp_path_factory.mktemp("damaged") / name
    path.write_text("\n".join(lines) + "\n")
    with warnings.catch_warnings(), suppress(ComoveError):
        warnings.simplefilter("ignore", ComoveWarning)
        Demonstration.load(path)


def test_only_a_column_that_passes_as_time_does_is_offered_as_time(tmp_path):
    path = tmp_path / "r.csv"
    for header, grown in (("load", SHARE**2), ("Fx", SHARE)):
        path.write_text(f"x,y,z,{header}\n" + rows(POSITION, grown))
        assert followed(path)[1] == {"rate": 100.0}


def test_seconds_that_are_chosen_keep_their_fraction(tmp_path):
    path = tmp_path / "r.csv"
    seconds, fractions = [s // 10**9 for s in STAMPS], [s % 10**9 for s in STAMPS]
    path.write_text("sec,nsec,t,x,y,z\n" + rows(seconds, fractions, 3 * TIME, POSITION))
    for chosen in ("sec", "nsec"):
        assert_read(Demonstration.load(path, time=chosen), False)


def test_repeated_names_are_told_apart_by_body_and_kind(tmp_path):
    """The names below two bodies: never the first of them."""
    path = tmp_path / "take.csv"
    path.write_text(ABOVE + TWO + rows(FRAME, TIME, XYZW, POSITION + 1, XYZW, POSITION))
    for chosen in (
        ["Right"],
        ["right"],
        ["Right.Position.X", "Right.Position.Y", "Right.Position.Z"],
        ["14", "15", "16"],
    ):
        assert_read(Demonstration.load(path, columns=chosen), True)
    assert_read(Demonstration.load(path, "right"), True)
    with pytest.raises(
        DemonstrationError, match=r"4 columns are called 'X': Left\.Orientation\.X.*--columns Left"
    ):
        Demonstration.load(path, columns=["X", "Y", "Z"])
    bare = tmp_path / "bare.csv"
    bare.write_text(TWO[: TWO.index(",X,Y,Z,W", 30)] + "\n" + rows(FRAME, TIME, XYZW, POSITION))
    with pytest.raises(DemonstrationError, match=r"X \(column 3\), X \(column 7\)"):
        Demonstration.load(bare)
    assert_read(Demonstration.load(bare, columns=["7", "8", "9"]), False)


def test_both_hands_of_a_tracker_are_read_at_once(tmp_path):
    path = tmp_path / "take.csv"
    path.write_text(ABOVE + TWO + rows(FRAME, TIME, XYZW, POSITION, XYZW, POSITION + 0.5))
    ((hands),) = Demonstration.load_recordings(path)
    assert list(hands) == ["Left", "Right"]
    np.testing.assert_allclose(hands["Right"].position - hands["Left"].position, 0.5, atol=1e-9)


@pytest.mark.parametrize("mark", ["", "nan", "NA", "null"])
def test_rows_without_a_measurement_are_left_out_only_when_asked(tmp_path, mark):
    lines = ("time,x,y,z\n" + rows(TIME, POSITION)).splitlines()
    for row in range(50, 60):
        time, _, *others = lines[row].split(",")
        lines[row] = ",".join([time, mark, *others])
    path = tmp_path / "lost.csv"
    path.write_text("\n".join(lines) + "\n")
    with pytest.warns(UserWarning, match=r"10 of 201 rows .* left out, rows 51 to 60"):
        hand, asked = followed(path)
    assert asked == {"drop_missing": True}
    kept = np.delete(np.arange(N), np.arange(49, 59))
    np.testing.assert_allclose(hand.position, POSITION[kept], atol=1e-9)
    np.testing.assert_allclose(hand.time, TIME[kept], atol=1e-9)


def test_a_body_that_was_lost_does_not_matter_to_another(tmp_path):
    path = tmp_path / "lost.csv"
    lines = ("time,a.x,a.y,a.z,b.x,b.y,b.z\n" + rows(TIME, POSITION, POSITION)).splitlines()
    lines[70] = lines[70][: lines[70].rindex(",")] + ","
    path.write_text("\n".join(lines) + "\n")
    assert_read(Demonstration.load(path, "a"), False)
    with pytest.raises(DemonstrationError, match=r"row 71, column b\.z: the cell is empty"):
        Demonstration.load(path, "b")


JOINTS = np.column_stack((0.5 * SHARE, -0.8 * SHARE, 1.2 * SHARE**2))


@pytest.mark.parametrize(
    ("header", "factor", "options"),
    [
        ("time,j1 [rad],j2 [rad],j3 [rad]", 1.0, {}),
        ("time,j1 [deg],j2 [deg],j3 [deg]", 180 / np.pi, {}),
        ("time,j1,j2,j3", 180 / np.pi, {"unit": "deg"}),
        ("time,j1,j2,j3", 1.0, {}),
        ("time,q[0],q[1],q[2]", 1.0, {}),
        ("time,shoulder.pos,elbow.pos,wrist.pos,gripper.pos", 1.0, {}),
        ("time,a,b,c", 180 / np.pi, {"columns": ["a", "b", "c"], "unit": "deg"}),
        ("arm\ninDegrees=yes\nendheader\ntime,elbow_flex,arm_rot,pro_sup", 180 / np.pi, {}),
    ],
)
def test_angles_are_movements_of_joints(tmp_path, header, factor, options):
    path = tmp_path / "arm.csv"
    extra = [0 * TIME] if "gripper" in header else []
    path.write_text(header + "\n" + rows(TIME, factor * JOINTS, *extra))
    arm = Demonstration.load(path, **options)
    assert (arm.unit, arm.is_joints, arm.n_dims) == ("rad", True, 3)
    np.testing.assert_allclose(arm.position, JOINTS, atol=1e-9)
    assert any("left out: gripper.pos" in note for note in arm.notes) == bool(extra)


def test_numbers_with_names_of_joints_are_positions_where_a_length_is_stated(tmp_path):
    path = tmp_path / "hand.csv"
    path.write_text("time,q[0],q[1],q[2]\n" + rows(TIME, MM))
    assert_read(Demonstration.load(path, unit="mm"), False)
