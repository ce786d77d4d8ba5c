"""Recordings as text: exact round trips, and bad files told by row and column."""

import os
import time
import warnings

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

from comove.dmp.demonstrations import Demonstration, read_csv, write_csv
from comove.errors import ComoveWarning, DemonstrationError

GOOD = "time,x,y\n0,0,0\n0.1,0.5,1\n0.2,1,2\n"
TURNED = "time,x,qw,qx,qy,qz\n0,0,1,0,0,0\n1,1,0.6,0,0,0.8\n"
SHARED_FOLDER = settings(suppress_health_check=[HealthCheck.function_scoped_fixture])
numbers = st.floats(-2.0, 2.0, allow_subnormal=True)


def write(folder, content, name="carry.csv"):
    path = folder / name
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    return path


@SHARED_FOLDER
@given(st.integers(1, 3), st.lists(st.floats(1e-3, 1.0), min_size=1, max_size=20), st.data())
def test_what_is_written_is_read_bit_by_bit(tmp_path, n_dims, steps, data):
    time = np.concatenate(([0.0], np.cumsum(steps)))
    positions = arrays.arrays(float, (len(time), n_dims), elements=numbers)
    demos = {name: Demonstration(time, data.draw(positions)) for name in ("left", "right arm")}
    write_csv(tmp_path / "pair.csv", demos)
    again = read_csv(tmp_path / "pair.csv")
    assert list(again) == list(demos)
    for name, demo in demos.items():
        assert again[name].time.tobytes() == demo.time.tobytes()
        assert again[name].position.tobytes() == demo.position.tobytes()


def test_one_movement_has_the_plain_header(tmp_path):
    path = tmp_path / "carry.csv"
    write_csv(path, Demonstration([0.0, 0.1], [[1.0, 2.0], [0.1, 1 / 3]]))
    assert path.read_text() == "time,x,y\n0.0,1.0,2.0\n0.1,0.1,0.3333333333333333\n"
    assert list(read_csv(path)) == [""]
    assert read_csv(path)[""].name == "carry"


def test_columns_are_found_by_name(tmp_path):
    path = write(tmp_path, "time,right.y,left.x,right.x,left.y\n0,1,2,3,4\n1,5,6,7,8\n")
    demos = read_csv(path)
    assert list(demos) == ["right", "left"]
    np.testing.assert_array_equal(demos["right"].position, [[3, 1], [7, 5]])
    np.testing.assert_array_equal(demos["left"].position, [[2, 4], [6, 8]])


@pytest.mark.parametrize(
    "content",
    [
        GOOD.replace("\n", "\r\n"),
        GOOD.replace("\n", "\r"),
        GOOD.rstrip("\n"),
        "\ufeff" + GOOD,
        GOOD + "\n  \n",
        "# a note\n\n" + GOOD.replace("0.2", "# another, note\n0.2"),
        GOOD.replace(",", " ,\t").replace("time ,\tx ,\ty", ' "time" , "x", y '),
        GOOD.replace("0.1,", "1e-1,").replace("0.2,1", "+.2,1."),
        GOOD.replace("0.5", '"0.5"'),
        GOOD.encode("utf-16"),
        GOOD.encode("utf-16-le"),
        GOOD.encode("utf-16-be"),
        GOOD.replace("\n", ",größe\n").replace("0,größe", "0,ü").encode("latin-1"),
        GOOD.replace(",", ";").replace(".", ","),
        GOOD.replace(",", "\t"),
        GOOD.replace(",", " "),
        GOOD.replace(",", "   "),
        GOOD.replace(",", "|"),
        GOOD.replace(",", ";").replace(".", ",").replace("time;x;y", "time,x,y"),
        "% " + GOOD,
        "#" + GOOD,
        "recorded today\n\n" + GOOD,
        GOOD.replace("\n", ",\n"),
        ",".join(["y,time,x"]) + "\n0,0,0\n1,0.1,0.5\n2,0.2,1\n",
        "," + GOOD.replace("\n0", "\n7,0"),
    ],
)
def test_harmless_habits_are_accepted(tmp_path, content):
    demo = read_csv(write(tmp_path, content))[""]
    np.testing.assert_array_equal(demo.time, [0.0, 0.1, 0.2])
    np.testing.assert_array_equal(demo.position, [[0, 0], [0.5, 1], [1, 2]])


@pytest.mark.parametrize(
    ("content", "key", "says", "way_out"),
    [
        # the header
        ("", None, "empty", "name a recording"),
        ("\n\n", None, "empty", "name a recording"),
        ("0,0,0\n0.1,1,1\n", "columns", "no column is named", "--columns 2,3"),
        ("# carry\n0,0\n0.1,1\n", "columns", "no column is named", "--columns 2"),
        (
            "tmie,x,y\n0,0,0\n0.1,1,1\n",
            "time",
            "no column of time",
            "did you mean 'tmie'.*; run: .*--time tmie",
        ),
        ("time\n0\n1\n", None, "a single column", "a row a sample"),
        ("time,x,X\n0,0,0\n", "columns", r"x \(column 2\), X \(column 3\)", "--columns 2"),
        ("time,left.x,left.u\n", None, "no rows below the header", "two rows at least"),
        ("time,x,x\n0,0,0\n", "columns", r"x \(column 2\), x \(column 3\)", "--columns 2"),
        (
            "time,x,y,b.x,b.y\n0,0,0,0,0\n",
            "columns",
            "x, y belong to no body",
            "--columns b; run: .*--columns x,y ",
        ),
        # the rows
        ("time,x,y\n", None, "no rows below the header", "two rows at least"),
        ("time,x,y\n0,0,0\n", "time", "this one has 1", "record more"),
        (GOOD.replace("0.5", "half"), "row 3, column x", "'half' is not a number", "numbers"),
        (GOOD.replace("0.5", "1_0"), "row 3, column x", "'1_0' is not a number", "numbers"),
        (GOOD.replace("0.5", "1٣"), "row 3, column x", "is not a number", "numbers"),
        (GOOD.replace("0.5,1", "0.5,1 # why"), "row 3, column y", "'1 # why' is not a number", "numbers"),
        (GOOD.replace("0.5", "0x10"), "row 3, column x", "'0x10' is not a number", "numbers"),
        (GOOD.replace("0.5", "1" * 50 + "a"), "row 3, column x", "'1{37}...' is not a number", "numbers"),
        (GOOD.replace("0.5", ""), "row 3, column x", "cell is empty", "fill in.*--drop-missing"),
        (GOOD.replace("0.5", "nan"), "row 3, column x", "nan is not a finite number", "--drop-missing"),
        (GOOD.replace("0.5", "-inf"), "row 3, column x", "-inf is not a finite number", "fill in"),
        (GOOD.replace("0.5", "1e999"), "row 3, column x", "1e999 is too large", "remove the row"),
        (GOOD.replace("0.5", "1e99"), "row 3, column x", r"1e\+99 is not a number below", "remove the row"),
        (GOOD.replace("0.5,1", "0.5"), "row 3", "2 cells and the header has 3", "fill in or remove"),
        (GOOD.replace("0.5,1", "0.5,1,7"), "row 3", "4 cells and the header has 3", "fill in or remove"),
        (GOOD + "0.3,1\n", "row 5", "2 cells", "fill in or remove"),
        (GOOD + "0.3,1", "row 5", "2 cells", "fill in or remove"),
        # orientations and named coordinates
        ("time,qw,qx,qy,qz\n0,1,0,0,0\n1,1,0,0,0\n", "header", "no positions beside time", "record them"),
        (TURNED.replace("0.6", "0.7"), "row 3, columns qw to qz", "norm 1.063, not 1", "w x y z"),
        (
            "time,elbow [rad],elbow  [rad]\n0,0,0\n1,1,1\n",
            "columns",
            r"elbow  \[rad\] \(column 3\)",
            "--columns 2",
        ),
        ("time,x\n0,1,2\n0,3,4\n", "row 2", "3 cells and the header has 2", "fill in or remove"),
        ("time,x,y\n0,0,1,5,2,5\n0,1,1,6,2,6\n", "row 2", "6 cells", "decimal commas"),
        ("time,x,y\n0,1;0,2\n", "row 2", "2 cells and the header has 3", "fill in or remove"),
        ("time,x,y\n\n# c\n0,0,0\n1,a,0\n", "row 5, column x", "'a'", "numbers"),
        ("time,x,y\n0,0,0\n1,1,1\nx,y,time\n1,1,2\n", "row 4", "names .* again, in another order", "cut"),
        ("time,x,y\n0,0,0\n1,1,1\ntime,x,y\n1,1,2\n", "row 4", "stand there again$", "cut"),
        # time
        (GOOD.replace("0.2", "0.05"), "row 4, column time", "goes back from 0.1 s to 0.05 s", "sort"),
        ("time,x\n# c\n\n3,0\n3,1\n", "row 5, column time", "stands still at 3.0 s", "in seconds"),
        # the file
        (GOOD.encode() + b"0.3,\xff,1\n", "row 5, column x", "'ÿ' is not a number", "numbers"),
        (b"\x00\x01\x02\x03" * 100, None, "it is no text", "suffix"),
        ("<!DOCTYPE html>\n<html>\n", None, "page of a web site", "download the raw file"),
        ("only words\nin some\nlines\n", None, "no table of numbers.*'only words'", "--delimiter"),
    ],
)
def test_bad_files_are_told_by_row_and_column(tmp_path, refused, content, key, says, way_out):
    refused(Demonstration.load, write(tmp_path, content), key=key, says=says, way_out=way_out)


def test_rows_are_counted_as_in_an_editor(tmp_path, refused):
    path = write(tmp_path, GOOD + "# note\n0.3,2,3\n0.4,,4\n")
    refused(read_csv, path, key="row 7, column x", says="cell is empty", way_out="fill in")
    path = write(tmp_path, GOOD + "0.3,2,3\n0.4,1\n0.5,1\n")
    refused(read_csv, path, key="row 6", says="2 cells", way_out="fill in")


def test_a_bad_number_names_the_manipulators_column(tmp_path, refused):
    path = write(tmp_path, "time,left.x,right.x\n0,0,0\n1,1,1e50\n")
    refused(read_csv, path, key="row 3, column right.x", says="1e.50", way_out="remove the row")


@SHARED_FOLDER
@given(st.integers(0, len(GOOD) - 1), st.binary(max_size=3))
def test_any_damage_is_read_or_told(tmp_path, place, damage):
    content = GOOD.encode()
    path = write(tmp_path, content[:place] + damage + content[place + 1 :])
    try:
        demo = read_csv(path)[""]
    except DemonstrationError as error:
        assert error.way_out
        assert str(path) in str(error)
    else:
        assert np.isfinite(demo.position).all()


def test_paths_that_are_no_file_are_told(tmp_path, refused):
    refused(read_csv, tmp_path / "none.csv", key=None, says="no such file", way_out="check the path")
    refused(read_csv, tmp_path, key=None, says="a folder", way_out="name the file")
    os.mkfifo(tmp_path / "pipe.csv")
    refused(read_csv, tmp_path / "pipe.csv", key=None, says="not a regular file", way_out="name the file")


def test_a_file_that_may_not_be_opened_is_told(tmp_path, refused, monkeypatch):
    path = write(tmp_path, GOOD)

    def denied(*arguments, **options):
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr("builtins.open", denied)
    refused(read_csv, path, key=None, says="Permission denied", way_out="check the path")


def test_ten_million_rows_are_refused_before_they_are_parsed(tmp_path, refused, monkeypatch):
    path = tmp_path / "long.csv"
    with open(path, "wb") as file:
        file.write(b"time,x\n")
        for _ in range(100):
            file.write(b"0,0\n" * 100_000)
    monkeypatch.setattr(np, "loadtxt", lambda *_, **__: pytest.fail("parsed"))
    refused(read_csv, path, key=None, says="more than 2,000,000 rows", way_out="every n-th row")


def test_the_row_limit_is_exact(tmp_path, refused, monkeypatch):
    monkeypatch.setattr("comove.dmp.demonstrations.formats.table_rows.MAX_ROWS", 3)
    assert read_csv(write(tmp_path, GOOD))[""].n_steps == 3
    path = write(tmp_path, GOOD + "0.3,0,0\n")
    refused(read_csv, path, key=None, says="more than 3 rows", way_out="every n-th row")


def test_huge_files_are_refused_by_their_size(tmp_path, refused):
    path = tmp_path / "huge.csv"
    with open(path, "wb") as file:
        file.truncate(2**30)
    refused(read_csv, path, key=None, says="1024 MB, more than the 512 MB", way_out="every n-th row")


def test_millimetres_are_hinted_at(tmp_path):
    path = write(tmp_path, "time,x\n0,0\n1,350\n")
    with pytest.warns(ComoveWarning, match="carry: the movement spans 350 m: looks like millimetres"):
        read_csv(path)


def test_writing_leaves_the_old_file_until_the_new_one_is_whole(tmp_path, monkeypatch):
    path = write(tmp_path, GOOD)

    def fail(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "replace", fail)
    with pytest.raises(DemonstrationError, match=r"carry\.csv: it cannot be written: the disk is full"):
        write_csv(path, Demonstration([0.0, 1.0], [[0.0], [1.0]]))
    assert path.read_text() == GOOD
    assert os.listdir(tmp_path) == ["carry.csv"]


def test_what_cannot_be_written_is_told(tmp_path, refused):
    demo = Demonstration([0.0, 1.0], [[0.0], [1.0]])
    later = Demonstration([0.0, 2.0], [[0.0], [1.0]])
    wide = Demonstration([0.0, 1.0], np.eye(2, 4))
    turned = Demonstration([0.0, 1.0], [[0.0], [1.0]], orientation=np.eye(2, 4))
    time, line = demo.time, demo.position
    path = tmp_path / "pair.csv"
    for demos, says, way_out in [
        ({}, "no movement", "give one"),
        ({"": demo, "b": demo}, "no name", "name all"),
        ({"a": demo, "b": later}, "'b' differs from 'a'", "resampled"),
        ({"a": demo, "b": wide}, "'b' differs from 'a'", "resampled"),
        ({"a,b": demo}, "'a,b' cannot stand in a header", "letters"),
        (wide, "4 dimensions without names", "name its axes, or use write_npz"),
        (Demonstration(time, line, unit="a,b"), "the unit 'a,b' cannot", "letters"),
        (Demonstration(time, line, unit=""), "the unit '' cannot", "letters"),
        (Demonstration(time, line, axes=("a.b",)), "the axis 'a.b' cannot", "letters"),
        ({"a": demo, "b": turned}, "only one of 'b' and 'a' has orientations", "to all or to none"),
    ]:
        refused(lambda p, d=demos: write_csv(p, d), path, key=None, says=says, way_out=way_out)
    missing = tmp_path / "no" / "carry.csv"
    refused(lambda p: write_csv(p, demo), missing, key=None, says="cannot be written", way_out="check")
    refused(lambda p: write_csv(p, demo), tmp_path, key=None, says="is no file", way_out="another name")
    zero = tmp_path / "a\0b.csv"
    refused(lambda p: write_csv(p, demo), zero, key=None, says="cannot name a file", way_out="another name")
    assert os.listdir(tmp_path) == []


@SHARED_FOLDER
@given(st.integers(2, 20), st.integers(0, 2**32 - 1))
def test_orientations_are_read_bit_by_bit(tmp_path, n_steps, seed):
    rng = np.random.default_rng(seed)
    time = np.cumsum(rng.uniform(0.01, 1.0, n_steps)) - 0.01
    demos = {
        name: Demonstration(
            time, rng.normal(size=(n_steps, 3)), orientation=directions(rng, n_steps), unit="mm"
        )
        for name in ("left", "right")
    }
    write_csv(tmp_path / "pair.csv", demos)
    again = read_csv(tmp_path / "pair.csv")
    for name, demo in demos.items():
        assert again[name].orientation.tobytes() == demo.orientation.tobytes()
        assert again[name].position.tobytes() == demo.position.tobytes()
        assert (again[name].unit, again[name].axes) == ("mm", ())


def directions(rng, n_steps):
    quaternions = rng.normal(size=(n_steps, 4))
    return quaternions / np.linalg.norm(quaternions, axis=1, keepdims=True)


def test_named_coordinates_are_kept_with_their_unit(tmp_path):
    time = np.arange(5) / 50.0
    joints = np.random.default_rng(0).normal(size=(5, 14))
    axes = tuple(f"joint_{i} of it" for i in range(14))
    path = tmp_path / "arms.csv"
    write_csv(path, {"a": Demonstration(time, joints, unit="rad", axes=axes)})
    assert path.read_text().startswith("time,a.joint_0 of it [rad],a.joint_1")
    again = read_csv(path)["a"]
    assert again.position.tobytes() == joints.tobytes()
    assert (again.unit, again.axes) == ("rad", axes)
    slide = Demonstration(time, joints[:, :2], axes=("lift", "x"))
    write_csv(path, slide)
    assert (read_csv(path)[""].unit, read_csv(path)[""].axes) == ("m", ("lift", "x"))


def test_orientations_stand_in_their_own_columns(tmp_path):
    demo = read_csv(write(tmp_path, TURNED))[""]
    np.testing.assert_allclose(demo.orientation, [[1, 0, 0, 0], [0.6, 0, 0, 0.8]], atol=1e-15)
    assert demo.n_dims == 1
    swapped = read_csv(write(tmp_path, "time,qz,x,qx,qw,qy\n0,0,5,0,1,0\n1,0.8,6,0,0.6,0\n"))[""]
    np.testing.assert_array_equal(swapped.orientation, demo.orientation)
    np.testing.assert_array_equal(swapped.position, [[5], [6]])


@pytest.mark.parametrize(
    ("content", "row"),
    [
        (GOOD.rstrip("\n"), 4),
        (GOOD + "# end\n\n0.3,1,3", 7),
        (GOOD[:-2] + "2", 4),
        (GOOD.replace("\n", "\r")[:-1], 4),
    ],
)
def test_a_last_row_without_an_end_is_warned_of(tmp_path, content, row):
    with pytest.warns(ComoveWarning, match=f"carry.csv: row {row}: the last line has no end") as caught:
        read_csv(write(tmp_path, content))
    assert caught[0].filename == __file__


@pytest.mark.parametrize("content", [GOOD, GOOD + "# cut?", GOOD + "\n ", GOOD.replace("\n", "\r")])
def test_files_that_end_as_they_should_are_read_without_a_word(tmp_path, content):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert read_csv(write(tmp_path, content))[""].n_steps == 3


@SHARED_FOLDER
@given(st.data())
def test_notes_and_blank_lines_do_not_show(tmp_path, data):
    lines = data.draw(st.lists(st.sampled_from(["{},1.5", "# {}", "", "  ", "{} , 2e-3 "]), max_size=30))
    rows = [line.format(index / 50) for index, line in enumerate(["{},0", *lines, "{},0"])]
    kept = [[float(cell) for cell in row.split(",")] for row in rows if "," in row]
    demo = read_csv(write(tmp_path, "time,x\n" + "\n".join(rows) + "\n"))[""]
    np.testing.assert_array_equal(np.column_stack((demo.time, demo.position)), kept)


@pytest.mark.slow
def test_a_million_rows_are_read_exactly(tmp_path):
    table = np.column_stack((np.arange(1e6) / 1e3, np.random.default_rng(0).normal(size=(1_000_000, 3))))
    write_csv(tmp_path / "long.csv", Demonstration(table[:, 0], table[:, 1:], unit="any"))
    demo = read_csv(tmp_path / "long.csv")[""]
    assert demo.position.tobytes() == np.ascontiguousarray(table[:, 1:]).tobytes()
    assert demo.time.tobytes() == np.ascontiguousarray(table[:, 0]).tobytes()


@pytest.mark.parametrize(
    "axes", [("y", "x"), ("x", "z"), ("z",), ("y", "lift", "x"), ("qx", "qy"), ("x", "y")]
)
@pytest.mark.parametrize("unit", ["m", "rad"])
def test_names_keep_their_order_whatever_they_are(tmp_path, axes, unit):
    demo = Demonstration([0.0, 1.0], np.arange(2.0 * len(axes)).reshape(2, -1), axes=axes, unit=unit)
    write_csv(tmp_path / "a.csv", demo)
    again = read_csv(tmp_path / "a.csv")[""]
    assert (again.axes, again.unit) == (demo.axes, unit)
    np.testing.assert_array_equal(again.position, demo.position)


WIDE = 200_001
LARGE = {
    "columns": (
        "time," + ",".join(f"c{i} [rad]" for i in range(WIDE)) + "\n",
        "more than 1,048,576 characters",
    ),
    "named columns": (
        "time," + ",".join(f"{i}.x" for i in range(20_000)) + "\n" + "0," * 20_000 + "0\n",
        "there are 20001 columns",
    ),
    "commas": ("time" + "," * 5_000_000 + "\n", "row 1: it has more than"),
    "a line without an end": ("x" * 5_000_000, "row 1: it has more than"),
    "a comment": ("time,x\n#" + "#" * 5_000_000, "row 2: it has more than"),
    "a blank line": ("time,x\n0,0\n" + " " * 5_000_000, "row 3: it has more than"),
    "zeros": ("\0" * 5_000_000, "row 1: it has more than"),
    "a cell": ("time,x\n0,0\n1," + "9" * 2_000_000 + "\n", "row 3: it has more than"),
    "a long cell": ("time,x\n0,0\n1," + "9" * 900_000 + "\n", "99... is too large"),
    "a text": ("time,x\n0,0\n1," + "a" * 900_000 + "\n", "aa...' is not a number"),
    "cells": ("time,x\n0,0\n" + "1," * 500_000 + "\n", "it has 500001 cells and the header has 2"),
    "a name": ("time," + "n" * 900_000 + " [rad]\n0,0\n1,1\n", "the name has 900006 characters"),
    "rows without columns": ("time\n" + "0\n" * 1_000_000, "it has a single column"),
    "blank rows": ("time,x\n" + "\n" * 1_900_000, "there are no rows"),
    "returns": ("time,x\r" + "x" * 3_000_000, "row 2: it has more than"),
}


@pytest.mark.parametrize(("content", "words"), LARGE.values(), ids=LARGE)
def test_whatever_is_large_is_told_soon_and_in_short(tmp_path, content, words):
    path = write(tmp_path, content)
    began = time.process_time()
    with pytest.raises(DemonstrationError) as caught:
        read_csv(path)
    assert time.process_time() < began + 60  # about 1 s
    assert words in str(caught.value)
    assert len(str(caught.value)) < 400 + len(str(path))


@pytest.mark.slow
def test_lines_that_fill_blocks_are_no_long_lines(tmp_path):
    """What is read at a time ends within a line, at its end, or before it."""
    for width in (2**15 - 1, 2**15, 2**15 + 1, 2**16 - 1, 2**16):
        rows = "".join(f"{i / 50},{'0' * width}\n" for i in range(40))
        assert read_csv(write(tmp_path, "time,x\n" + rows))[""].n_steps == 40


def test_more_numbers_than_memory_is_meant_for(tmp_path, monkeypatch):
    monkeypatch.setattr("comove.dmp.demonstrations.formats.table_rows.MAX_CELLS", 1000)
    path = write(tmp_path, "time,x\n" + "".join(f"{i},0\n" for i in range(501)))
    with pytest.raises(DemonstrationError, match="more than 1,000 numbers; keep every n-th row"):
        read_csv(path)
