"""Recordings as archives: exact round trips; bombs, lies and damage refused before they are read."""

import io
import os
import zipfile

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from comove.dmp.demonstrations import Demonstration, read_npz, write_npz
from comove.errors import DemonstrationError, OptionError
from tests.cases import examples

TIME = np.array([0.0, 0.1, 0.3])
PAIR = np.arange(12.0).reshape(3, 2, 2) / 7.0
TURNS = np.array([[1.0, 0, 0, 0], [0.6, 0, 0.8, 0], [0, 0, 1, 0]])
TURNED = {"time": TIME, "position": PAIR[:, 0], "orientation": TURNS}
TURNED_PAIR = np.stack((TURNS, TURNS), axis=1)
NAMES = np.array(["left", "right"])
SHARED_FOLDER = settings(suppress_health_check=[HealthCheck.function_scoped_fixture])


@pytest.fixture
def path(tmp_path):
    return tmp_path / "carry.npz"


def header(shape, descr="<f8", version=1):
    """Bytes of an array file that claims a shape and brings no data."""
    text = f"{{'descr': '{descr}', 'fortran_order': False, 'shape': {shape}, }}".encode()
    return b"\x93NUMPY" + bytes([version, 0]) + len(text).to_bytes(2, "little") + text


def archive(path, members, compression=zipfile.ZIP_STORED):
    with zipfile.ZipFile(path, "w", compression) as file:
        for name, content in members.items():
            if isinstance(content, np.ndarray):
                buffer = io.BytesIO()
                np.lib.format.write_array(buffer, content)
                content = buffer.getvalue()
            file.writestr(f"{name}.npy", content)


@SHARED_FOLDER
@given(st.integers(1, 7), st.integers(1, 3), st.integers(0, 2**32 - 1))
def test_what_is_written_is_read_bit_by_bit(path, n_dims, n_manipulators, seed):
    rng = np.random.default_rng(seed)
    demos = {
        f"arm {index}": Demonstration(TIME, rng.uniform(-2, 2, (3, n_dims)))
        for index in range(n_manipulators)
    }
    write_npz(path, demos)
    again = read_npz(path)
    assert list(again) == list(demos)
    for name, demo in demos.items():
        assert again[name].time.tobytes() == demo.time.tobytes()
        assert again[name].position.tobytes() == demo.position.tobytes()


def test_one_movement_is_stored_plain(path):
    demo = Demonstration(TIME, PAIR[:, 0])
    write_npz(path, demo)
    with np.load(path, allow_pickle=False) as stored:
        assert sorted(stored) == ["position", "time"]
    again = read_npz(path)
    assert list(again) == [""]
    np.testing.assert_array_equal(again[""].position, demo.position)
    assert again[""].name == "carry"


def test_a_solution_is_read_and_its_other_arrays_are_left_alone(path):
    other = {"velocity": np.zeros((3, 2, 2)), "weights": np.array([None], dtype=object)}
    np.savez_compressed(path, time=TIME, position=PAIR, manipulators=NAMES, **other)
    demos = read_npz(path)
    assert list(demos) == ["left", "right"]
    np.testing.assert_array_equal(demos["right"].position, PAIR[:, 1])
    assert demos["right"].name == "carry.right"


@pytest.mark.parametrize(
    ("arrays", "key", "says", "way_out"),
    [
        ({"t": TIME, "position": PAIR[:, 0]}, "time", "missing", "known: t, position; save it"),
        ({"time": TIME, "positions": PAIR}, "position", "missing", "did you mean 'positions'"),
        ({"time": TIME, "position": PAIR}, "manipulators", "names of 2 manipulators are missing", "one name"),
        ({"time": TIME, "position": PAIR, "manipulators": NAMES[:1]}, "manipulators", "1 names", "each"),
        ({"time": TIME, "position": PAIR, "manipulators": NAMES[[0, 0]]}, "manipulators", "distinct", "one"),
        ({"time": TIME, "position": PAIR, "manipulators": np.arange(2)}, "manipulators", "not names", "text"),
        (
            {"time": TIME, "position": PAIR[:, :0], "manipulators": NAMES[:0]},
            "manipulators",
            "0 names",
            "one",
        ),
        ({"time": TIME[:2], "position": PAIR[:, 0, :1]}, "position", "3 rows and time has 2", "time stamp"),
        ({"time": TIME, "position": PAIR[:, 0].T}, "position", "2 rows and time has 3", "transpose"),
        ({"time": TIME, "position": TIME}, "position", r"shape \(3,\)", "n_steps, n_dims"),
        ({"time": TIME, "position": PAIR[None]}, "position", r"shape \(1, 3, 2, 2\)", "n_steps, n_dims"),
        ({"time": 0.0, "position": PAIR[:, 0]}, "time", r"shape \(\)", "n_steps"),
        ({"time": TIME[:1], "position": PAIR[:1, 0]}, "time", "this one has 1", "record more"),
        ({"time": TIME.astype(str), "position": PAIR[:, 0]}, "time", "not numbers", "real numbers"),
        ({"time": TIME[[0, 2, 1]], "position": PAIR[:, 0]}, "time[2]", "goes back", "sort"),
        ({"time": TIME, "position": PAIR[:, 0] * [1, np.nan]}, "position[0, 1]", "nan", "remove the row"),
        (
            {"time": TIME, "position": PAIR * [[[1, 1], [np.inf, 1]]] + 1, "manipulators": NAMES},
            "position[0, 1, 0]",
            "inf",
            "remove the row",
        ),
        (TURNED | {"orientation": TURNS[:2]}, "orientation", r"shape \(2, 4\)", "one quaternion"),
        (TURNED | {"orientation": 2.0 * TURNS}, "orientation[0]", "norm 2, not 1", "w x y z"),
        (
            {"time": TIME, "position": PAIR, "manipulators": NAMES, "orientation": TURNS},
            "orientation",
            r"shape \(3, 4\) and position \(3, 2, 2\)",
            "row and manipulator",
        ),
        (
            {"time": TIME, "position": PAIR, "manipulators": NAMES, "orientation": 3.0 * TURNED_PAIR},
            "orientation[0, 0]",
            "norm 3",
            "w x y z",
        ),
        (TURNED | {"axes": np.array(["a"])}, "axes", r"of shape \(1,\), not texts", r"shape \(2,\)"),
        (TURNED | {"axes": np.arange(2)}, "axes", "it holds int64", "texts"),
        (TURNED | {"axes": np.array(["a", "a"])}, "axes", "'a' stands twice", "a name of its own"),
        (TURNED | {"unit": np.array(["a", "b"])}, "unit", r"of shape \(2,\)", r"shape \(\)"),
        ({"time": np.array([None]), "position": PAIR[:, 0]}, "time", "pickled objects", "plain numbers"),
    ],
)
def test_wrong_arrays_are_named(path, refused, arrays, key, says, way_out):
    np.savez(path, **arrays)
    refused(read_npz, path, key=key, says=says, way_out=way_out)


@pytest.mark.slow
def test_half_a_megabyte_that_unpacks_to_half_a_gigabyte_is_refused_unread(path, refused, monkeypatch):
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED, compresslevel=9) as file:
        with file.open("position.npy", "w") as member:
            for _ in range(32):
                member.write(bytes(2**24))
        file.writestr("time.npy", b"")
    assert path.stat().st_size < 0.6 * 2**20
    monkeypatch.setattr(zipfile.ZipFile, "open", lambda *_: pytest.fail("unpacked"))
    refused(read_npz, path, key="position", says="512 MB, more than the 256 MB", way_out="every n-th row")


@pytest.mark.parametrize(
    "claim",
    [
        header("(1000000000000,)"),
        header("(-3,)"),
        header("(3,)"),
        header("(2,)", "<U1000000"),
        header("(1000000000000,)", version=3),
    ],
)
def test_a_header_that_claims_more_than_there_is_is_refused(path, refused, claim):
    archive(path, {"time": claim, "position": PAIR[:, 0]})
    key = None if claim[6] == 3 else "time"
    refused(read_npz, path, key=key, says="claims|no whole archive", way_out="save it")


@pytest.mark.parametrize(
    "content",
    [b"", b"time,x\n0,0\n", b"PK\x03\x04", b"\x93NUMPY\x01\x00", header("(0, 99999999999999999999999)")],
)
def test_what_is_no_archive_is_refused(path, refused, content):
    path.write_bytes(content)
    refused(read_npz, path, key=None, says="no whole archive", way_out=r"numpy\.savez")
    archive(path, {"time": content, "position": PAIR[:, 0]})
    refused(read_npz, path, key=None, says="no whole archive", way_out=r"numpy\.savez")


@examples(200, suppress_health_check=SHARED_FOLDER.suppress_health_check)
@given(st.floats(0, 1, exclude_max=True), st.binary(max_size=4), st.booleans())
def test_any_damage_is_read_or_told(path, place, damage, cut):
    archive(path, {"time": TIME, "position": PAIR, "manipulators": NAMES})
    content = path.read_bytes()
    at = int(place * len(content))
    path.write_bytes(content[:at] + damage + (b"" if cut else content[at + len(damage) :]))
    try:
        demos = read_npz(path)
    except DemonstrationError as error:
        assert error.way_out
        assert str(path) in str(error)
    else:
        np.testing.assert_array_equal(demos["left"].position, PAIR[:, 0])


def test_encrypted_archives_are_refused(path, refused):
    archive(path, {"time": TIME, "position": PAIR[:, 0]})
    content = bytearray(path.read_bytes())
    for mark, offset in ((b"PK\x03\x04", 6), (b"PK\x01\x02", 8)):
        content[content.index(mark) + offset] |= 1
    path.write_bytes(content)
    refused(read_npz, path, key=None, says="password|encrypted", way_out="save it")


def test_paths_that_are_no_file_are_told(tmp_path, refused):
    refused(read_npz, tmp_path / "none.npz", key=None, says="no such file", way_out="check the path")
    refused(read_npz, tmp_path, key=None, says="a folder", way_out="name the file")


def test_writing_leaves_nothing_half_written(path, monkeypatch):
    monkeypatch.setattr(np, "savez", lambda *_, **__: (_ for _ in ()).throw(KeyboardInterrupt))
    with pytest.raises(KeyboardInterrupt):
        write_npz(path, Demonstration(TIME, PAIR[:, 0]))
    assert os.listdir(path.parent) == []


@pytest.mark.parametrize("name", ["orientation", "axes", "unit", "manipulators", "position", "time"])
def test_a_name_damaged_at_either_place_is_told(path, name):
    """An archive has the name of each array before it and in a table at its end; optional ones do not just vanish."""
    demos = {
        m: Demonstration(TIME, PAIR[:, 0], unit="rad", orientation=TURNS, axes=["a", "b"]) for m in NAMES
    }
    write_npz(path, demos)
    content, word = path.read_bytes(), f"{name}.npy".encode()
    places = [content.index(word), content.rindex(word)]
    assert places[0] != places[1]
    for place in places:
        path.write_bytes(content[:place] + b"x" + content[place + 1 :])
        with pytest.raises(DemonstrationError, match=r"File name in directory|missing"):
            read_npz(path)


@SHARED_FOLDER
@given(st.integers(1, 64), st.integers(0, 3), st.integers(0, 2**32 - 1))
def test_orientations_axes_and_units_are_read_bit_by_bit(path, n_dims, n_manipulators, seed):
    rng = np.random.default_rng(seed)

    def demo():
        turns = rng.normal(size=(3, 4))
        turns /= np.linalg.norm(turns, axis=1, keepdims=True)
        axes = [f"j{rng.integers(10)} {i}" for i in range(n_dims)]
        return Demonstration(TIME, rng.uniform(-2, 2, (3, n_dims)), unit="rad", orientation=turns, axes=axes)

    demos = {f"arm {index}": demo() for index in range(n_manipulators)} or {"": demo()}
    write_npz(path, demos)
    again = read_npz(path)
    assert list(again) == list(demos)
    for name, written in demos.items():
        assert again[name].orientation.tobytes() == written.orientation.tobytes()
        assert again[name].position.tobytes() == written.position.tobytes()
        assert (again[name].axes, again[name].unit) == (written.axes, written.unit)


def test_one_name_for_the_axes_and_the_unit_of_all_is_enough(path):
    extra = {"axes": np.array(["lift", "turn"]), "unit": np.array("rad")}
    np.savez(path, time=TIME, position=PAIR, manipulators=NAMES, **extra)
    assert [(demo.axes, demo.unit) for demo in read_npz(path).values()] == [(("lift", "turn"), "rad")] * 2


def test_an_archive_cut_anywhere_is_refused(path):
    write_npz(path, Demonstration(TIME, PAIR[:, 0], orientation=TURNS))
    content = path.read_bytes()
    for length in range(len(content)):
        path.write_bytes(content[:length])
        with pytest.raises(DemonstrationError, match="no whole archive"):
            read_npz(path)


def test_texts_that_numpy_would_change_are_not_written(path, refused):
    demo = Demonstration(TIME, PAIR[:, 0], axes=("a\0", "b"))
    refused(lambda p: write_npz(p, demo), path, key="axes", says="null character", way_out="letters")


STEADY = np.arange(60) / 50.0


@pytest.mark.parametrize("per_second", [1e3, 1e6, 1e9])
@pytest.mark.parametrize("start", [0, 1_700_000_000])
def test_stamps_in_other_units_are_told_by_their_size(path, per_second, start):
    stamps = start * int(per_second) + np.rint(STEADY * per_second).astype(np.int64)
    np.savez(path, time=stamps, position=np.column_stack((STEADY, STEADY**2)))
    demo = Demonstration.load(path)
    np.testing.assert_allclose(demo.time, STEADY, atol=1e-9)
    assert any("after its size" in note for note in demo.notes)


def test_the_unit_or_rate_of_an_archive_can_be_stated(path):
    np.savez(path, time=np.arange(60), position=np.column_stack((STEADY, STEADY**2)))
    with pytest.raises(DemonstrationError, match=r"steps are 1.*; run: comove learn .* --rate HZ"):
        Demonstration.load(path)
    np.testing.assert_array_equal(Demonstration.load(path, rate=50).time, STEADY)
    np.testing.assert_allclose(Demonstration.load(path, time="time [ms]").time, np.arange(60) / 1e3)
    for options, words in [
        ({"rate": 50, "time": "[ms]"}, "both a time and a rate"),
        ({"time": "clock"}, "no time of the archive"),
        ({"time": "time [parsec]"}, "give its unit"),
        ({"rate": -1}, "no rate"),
    ]:
        with pytest.raises(OptionError, match=words):
            Demonstration.load(path, **options)
    with pytest.raises(
        DemonstrationError, match="columns: 'x,y' was asked for, but its columns are not chosen"
    ):
        Demonstration.load(path, columns=["x", "y"])
