"""The reader takes what people write and refuses, with line and way out, what would mislead."""

import math
import tempfile
from pathlib import Path

import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st

from comove.errors import SceneError, readable
from comove.io.yaml_reader import plain_value, read_yaml
from tests.cases import examples


@pytest.fixture
def write(tmp_path):
    def write_scene(content):
        path = tmp_path / "scene.yaml"
        path.write_bytes(content if isinstance(content, bytes) else content.encode())
        return path

    return write_scene


def refusal(path):
    """The error of reading `path`, which must be one sentence that names the file and a way out."""
    with pytest.raises(SceneError) as caught:
        read_yaml(path)
    error = caught.value
    assert str(error).startswith(f"{readable(str(path))}: ")
    assert error.way_out
    assert "\n" not in str(error)
    assert "yaml." not in error.message
    return error


def test_data_and_lines(write):
    path = write("# a scene\nname: a\nobstacles:\n  - {shape: box,\n     size: [1, 2]}\n  - shape: circle\n")
    data, lines = read_yaml(path)
    assert data == {"name": "a", "obstacles": [{"shape": "box", "size": [1, 2]}, {"shape": "circle"}]}
    assert lines == {
        ("name",): 2,
        ("obstacles",): 3,
        ("obstacles", 0): 4,
        ("obstacles", 0, "shape"): 4,
        ("obstacles", 0, "size"): 5,
        ("obstacles", 0, "size", 0): 5,
        ("obstacles", 0, "size", 1): 5,
        ("obstacles", 1): 6,
        ("obstacles", 1, "shape"): 6,
    }


@pytest.mark.parametrize(
    ("written", "value"),
    [
        ("3", 3),
        ("-3", -3),
        ("010", 10),
        ("1e3", 1000.0),
        ("1E-2", 0.01),
        (".5", 0.5),
        ("+1.5", 1.5),
        ("1.", 1.0),
        (".inf", math.inf),
        ("-.Inf", -math.inf),
        ("true", True),
        ("FALSE", False),
        ("null", None),
        ("~", None),
        ("", None),
        ("no", "no"),
        ("Yes", "Yes"),
        ("on", "on"),
        ("off", "off"),
        ("12:30:00", "12:30:00"),
        ("2024-01-01", "2024-01-01"),
        ("0x10", "0x10"),
        ("0o7", "0o7"),
        ("1_000", "1_000"),
        ("0,5", "0,5"),
        ("nan", "nan"),
        ("1e", "1e"),
        (".", "."),
        ("'3'", "3"),
        ('"1e3"', "1e3"),
        ("'true'", "true"),
        ("=", "="),
        ("<<", "<<"),
    ],
)
def test_plain_values_are_read_as_people_write_them(write, written, value):
    read = read_yaml(write(f"a: {written}"))[0]["a"]
    assert read == value
    assert type(read) is type(value)


def test_not_a_number_and_numbers_beyond_all_floats(write):
    data, _ = read_yaml(write(f"a: .nan\nb: {'9' * 5000}\nc: 1e999\nd: {'9' * 250}"))
    assert math.isnan(data["a"])
    assert data["b"] == data["c"] == math.inf
    assert data["d"] == 10**250 - 1


@given(st.floats(allow_nan=False, allow_infinity=False))
def test_every_float_survives_its_repr(number):
    assert plain_value(repr(number)) == number


@examples(50)
@given(st.text(alphabet="0123456789.+-eEinfaNx_,:~ ", max_size=8))
def test_any_text_is_read_as_something(text):
    assert isinstance(plain_value(text), str | int | float | bool | None)


def test_keys_are_text_as_written(write):
    assert read_yaml(write("1: a\ntrue: b\n~: c\n0x1: d"))[0] == {"1": "a", "true": "b", "~": "c", "0x1": "d"}


def test_a_byte_order_mark_is_skipped(write):
    assert read_yaml(write("\ufeffa: 1"))[0] == {"a": 1}


def test_a_merge_key_in_quotes_is_a_key_like_others(write):
    assert read_yaml(write("'<<': {a: 1}"))[0] == {"<<": {"a": 1}}


DUMPED = st.recursive(
    st.none() | st.booleans() | st.integers(-99, 99) | st.sampled_from(["a", "b c", "left"]),
    lambda parts: st.lists(parts, max_size=3) | st.dictionaries(st.sampled_from("abc"), parts, max_size=3),
    max_leaves=12,
)


@examples(100)
@given(DUMPED, st.data())
def test_what_safe_dump_writes_of_data_that_share_parts_is_read_as_it_was(part, data):
    """PyYAML writes an anchor where the same list or mapping stands in several places."""
    other = [part, data.draw(DUMPED)]
    whole = {"one": part, "two": {"three": part, "four": other}, "five": [other, part, other]}
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "dumped.yaml"
        path.write_text(yaml.safe_dump(whole), encoding="utf-8")
        read, lines = read_yaml(path)
    assert read == whole
    assert read["one"] is not read["two"]["three"] or not isinstance(part, list | dict)
    assert set(lines) == set(_places(whole))


def _places(part, path=()):
    items = part.items() if isinstance(part, dict) else enumerate(part) if isinstance(part, list) else ()
    for key, value in items:
        yield (*path, key)
        yield from _places(value, (*path, key))


@pytest.mark.parametrize(
    "content",
    [
        "a: &x {b: 1, c: [2, 3]}\nd: *x",
        "a: &x {b: 1, c: &y [2, 3]}\nd: {<<: *x, c: *y}",
        "a: &x {b: 1}\nd:\n  c: [2, 3]\n  <<: *x",
        "a: &x {b: 7, c: [2, 3]}\ny: &y {b: 1}\nd: {<<: [*y, *x]}",
        "a: &x {b: 7}\nd: {<<: *x, <<: {c: [2, 3]}, b: 1}",
    ],
)
def test_aliases_and_merge_keys_are_as_in_pyyaml(write, content):
    data, lines = read_yaml(write(content))
    assert data["d"] == {"b": 1, "c": [2, 3]} == yaml.safe_load(content)["d"]
    assert {("d", "b"), ("d", "c"), ("d", "c", 0)} <= set(lines)


def test_a_mistake_in_what_is_repeated_is_told_where_it_stands(write):
    _, lines = read_yaml(write("a: 1\nx: &x\n  b: 2\ny: *x\nz:\n  <<: *x\n"))
    assert lines[("y",)] == 4
    assert lines[("y", "b")] == lines[("z", "b")] == 3


@pytest.mark.parametrize(
    "content", ["a: 1\nb: 2\na: 3\n", "a: 1\nb: 2\n'a': 3\n", "x: {a: 1,\n  b: {a: 2},\n  a: 3}"]
)
def test_duplicate_keys_name_both_lines(write, content):
    error = refusal(write(content))
    assert error.message == "the key 'a' is given twice, in line 1 and in line 3"
    assert error.key == "line 3"


@pytest.mark.parametrize(
    ("content", "key", "words"),
    [
        ("b: 2\na: *x", "line 2", "alias '*x' repeats no anchor before it"),
        ("a: &x [1, *x]", "line 1", "alias '*x' repeats no anchor before it"),
        ("a: *x\nb: &x 1", "line 1", "alias '*x' repeats no anchor before it"),
        ("a: &y 1\nb: *x", "line 2", "alias '*x' repeats no anchor before it"),
        ("&x a: 1", "line 1", "used as a key"),
        ("a: &x b\n*x : 1", "line 2", "used as a key"),
        ("a: &x 1\nb: {<<: *x}", "line 2", "'<<' merges no mapping"),
        ("a: &x !!float 1", "line 1", "tag '!!float'"),
        ("a:\n  - !!float 1", "line 2", "tag '!!float'"),
        ("a: ! x", "line 1", "tag"),
        ("!!python/object/apply:os.system [ls]", "line 1", "tag"),
        ("!!map {a: 1}", "line 1", "tag"),
        ("a: 1\n---\nb: 2", "line 2", "second document"),
        ("a: 1\n---\n", "line 2", "second document"),
        ("a: 1\n? [1, 2]\n: 3", "line 2", "used as a key"),
        ("- 1", "line 1", "a list, not a mapping"),
        ("just words", "line 1", "a single value, not a mapping"),
        ("~", "line 1", "nothing, not a mapping"),
        ("", None, "the file is empty"),
        ("# only a comment\n", None, "the file is empty"),
        (b"a: 1\nb: \xff", "line 2", "0xff is not UTF-8"),
        ("a: 1".encode("utf-16"), "line 1", "not UTF-8"),
        ("a: 1\nb: \x07", "line 2", "'\\x07' is not allowed"),
        ("a: \x00", "line 1", "'\\x00' is not allowed"),
    ],
)
def test_refused(write, content, key, words):
    error = refusal(write(content))
    assert error.key == key
    assert words in error.message


@pytest.mark.parametrize(
    ("content", "key", "words"),
    [
        ("a: [1, 2\nb: 3", "line 2, column 2", "lacks a ',' or its ']' (begun in line 1)"),
        ("a: {b: 1\nc", "line 3, column 1", "lacks a ',' or its '}' (begun in line 1)"),
        ("a: 1\n b: 2", "line 2, column 3", "a ':' stands where no key can stand"),
        ("a: 1\n- b", "line 2, column 1", "does not fit the mapping"),
        ("a:\n  - 1\n  b: 2", "line 3, column 3", "does not fit the list it stands in (begun in line 2)"),
        ("a:\n\tb: 1", "line 2, column 1", "a tab"),
        ("a: @b", "line 1, column 4", "'@' cannot start a value"),
        ("a: 'b\n\n", "line 3, column 1", "never closed (begun in line 1)"),
        ("%YAML 9.9\n---\na: 1", "line 1, column 1", "not YAML"),
    ],
)
def test_syntax_errors_tell_line_and_column(write, content, key, words):
    error = refusal(write(content))
    assert error.key == key
    assert words in error.message


@pytest.mark.parametrize("levels", [65, 3000, 100_000])
@pytest.mark.parametrize("opening", ["[", "{a: ", "- "])
def test_deep_nesting_is_refused_before_the_stack_overflows(write, levels, opening):
    content = f"a:\n  {opening * levels}"
    error = refusal(write(content))
    assert error.message == "the nesting is deeper than 64 levels"
    assert error.key == "line 2"


def test_64_levels_are_read(write):
    data, _ = read_yaml(write(f"a: {'[' * 63}1{']' * 63}"))
    for _ in range(63):
        data = data["a"] if isinstance(data, dict) else data[0]
    assert data == [1]
    refusal(write(f"a: {'[' * 64}1{']' * 64}"))


def test_aliases_do_not_explode(write):
    lines = ["a0: &a0 [x, x]"] + [f"a{i}: &a{i} [*a{i - 1}, *a{i - 1}]" for i in range(1, 60)]
    error = refusal(write("\n".join(lines)))
    assert "repeat more than 20000 values" in error.message
    assert error.key == "line 13"
    merged = ["a0: &a0 {x: [x, x]}"] + [f"a{i}: &a{i} {{x: *a{i - 1}, y: *a{i - 1}}}" for i in range(1, 60)]
    assert "repeat more than 20000 values" in refusal(write("\n".join(merged))).message


def test_aliases_do_not_nest_deeper_than_lists(write):
    lines = ["a0: &a0 [x]"] + [f"a{i}: &a{i} [*a{i - 1}]" for i in range(1, 100)]
    assert refusal(write("\n".join(lines))).message == "the nesting is deeper than 64 levels"


def test_many_anchors_are_read_in_time(write):
    data, _ = read_yaml(write("\n".join(f"a{i}: &a{i} [{i}]" for i in range(40_000))))
    assert len(data) == 40_000


def test_large_files_are_refused(write):
    assert refusal(write("a: " + "1" * 1_000_000)).message == "the file is larger than 1 MB"
    assert len(read_yaml(write("a: " + "x" * 999_000))[0]["a"]) == 999_000


def test_a_missing_file_lists_its_neighbours(tmp_path):
    (tmp_path / "narrow.yaml").touch()
    (tmp_path / "wide.yml").touch()
    (tmp_path / "carry.csv").touch()
    error = refusal(tmp_path / "narow.yaml")
    assert error.message == "there is no such file"
    assert error.way_out == "did you mean 'narrow.yaml'? known: narrow.yaml, wide.yml"


def test_a_missing_file_among_many_or_none(tmp_path):
    assert "no .yaml or .yml file" in refusal(tmp_path / "a.yaml").way_out
    assert "does not exist either" in refusal(tmp_path / "no" / "a.yaml").way_out
    for i in range(30):
        (tmp_path / f"{i}.yaml").touch()
    assert refusal(tmp_path / "zz").way_out == "30 such files are there"


def test_folders_and_devices_are_no_files(tmp_path):
    (tmp_path / "narrow.yaml").touch()
    error = refusal(tmp_path)
    assert error.message == "is a folder, not a file"
    assert "narrow.yaml" in error.way_out
    assert refusal("/dev/zero").message == "is not a regular file"


@pytest.mark.parametrize("name", ["x" * 300, "a\0b"])
def test_impossible_file_names(tmp_path, name):
    refusal(tmp_path / name)


@given(content=st.binary(max_size=60))
def test_any_bytes_are_read_or_refused(tmp_path_factory, content):
    path = tmp_path_factory.getbasetemp() / "any.yaml"
    path.write_bytes(content)
    try:
        data, _ = read_yaml(path)
    except SceneError:
        return
    assert isinstance(data, dict)


@given(content=st.text(alphabet="ab:-[]{},'\"#&*!|>%@`?~ \n\t0.", max_size=40))
def test_any_punctuation_is_read_or_refused(tmp_path_factory, content):
    path = tmp_path_factory.getbasetemp() / "any.yaml"
    path.write_text(content)
    try:
        data, _ = read_yaml(path)
    except SceneError as error:
        assert error.way_out
        return
    assert isinstance(data, dict)
