"""A primitive's file gives back every bit, and whatever is wrong with one is said in one sentence."""

import hashlib
import json
import os
from dataclasses import fields, is_dataclass, replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from comove.dmp import DMP, ExponentialPhase, Library, LinearPhase, Variant, average
from comove.dmp.cooperative import CooperativeDMP
from comove.dmp.demonstrations import Demonstration
from comove.dmp.files import (
    MAX_BYTES,
    Primitive,
    dumps,
    learn,
    learn_distribution,
    loads,
    read_primitive,
    require_name,
    write_primitive,
)
from comove.dmp.poses import Pose, PoseDMP
from comove.errors import LibraryError, OptionError
from tests.cases import examples

seeds = st.integers(0, 2**32 - 1)
finite = st.floats(-1e6, 1e6)


def lasa(shape="Angle", **options):
    return learn(Demonstration.from_lasa(shape), name=shape, source=f"lasa:{shape}:0", **options)


def turning(n_dims=3, shift=0.0):
    """A recording with orientations."""
    time = np.linspace(0, 2, 101)
    position = np.stack([time, np.sin(time), shift * time], axis=1)[:, :n_dims]
    half = (0.4 - shift / 10) * time**2
    orientation = np.stack([np.cos(half), 0 * half, 0 * half, np.sin(half)], axis=1)
    return Demonstration(time, position, "turn", orientation=orientation)


@pytest.fixture(scope="module")
def text():
    return dumps(lasa(n_basis=5)).decode()


@pytest.fixture(scope="module")
def every_kind():
    recordings = [Demonstration.from_lasa("Angle", k) for k in range(3)]
    made = {
        "position": lasa(n_basis=3),
        "pose": learn(turning(), poses=True, n_basis=3),
        "distribution": learn_distribution(recordings, name="several", n_basis=3),
        "poses": learn_distribution(
            [turning(), turning(shift=0.1), turning(shift=0.3)], name="s", n_basis=3, poses=True
        ),
        **{name: Primitive(name, dmp) for name, dmp in several().items()},
    }
    return {name: dumps(primitive) for name, primitive in made.items()}


def resealed(content):
    """Contents with a checksum that fits, so that the checks behind it are reached."""
    content = {key: value for key, value in content.items() if key != "sha256"}
    canonical = json.dumps(content, sort_keys=True, separators=(",", ":"))
    content["sha256"] = hashlib.sha256(canonical.encode()).hexdigest()
    return json.dumps(content).replace("Infinity", "1e999").encode()


def refusal(data, file="some.json"):
    with pytest.raises(LibraryError) as caught:
        loads(data if isinstance(data, bytes) else data.encode(), file)
    message = str(caught.value)
    assert message.startswith(f"{file}: ")
    assert "\n" not in message and len(message) < 400
    assert caught.value.way_out
    return caught.value


def same_bits(a, b):
    for name in ("weights", "start", "goal", "start_velocity", "goal_velocity", "learned"):
        assert getattr(a, name).tobytes() == getattr(b, name).tobytes()
    assert (a.duration, a.phase, a.variant) == (b.duration, b.phase, b.variant)


# --- What is written is read ---


@examples(60)
@given(
    seeds,
    st.sampled_from(list(Variant)),
    st.sampled_from([LinearPhase(), ExponentialPhase(), ExponentialPhase(0.1 + 0.2)]),
    st.integers(1, 5),
    st.integers(1, 30),
    st.floats(1e-3, 1e3),
    st.text(max_size=20),
)
def test_every_bit_returns(seed, variant, phase, n_dims, n_basis, duration, note):
    rng = np.random.default_rng(seed)
    vectors = rng.standard_normal((5, n_dims)) * 10.0 ** rng.integers(-12, 3, (5, n_dims))
    vectors[0, 0] = -0.0
    dmp = DMP(rng.standard_normal((n_dims, n_basis)), *vectors[:4], duration, phase, variant, vectors[4])
    data = dumps(Primitive("it", dmp, "cm", notes=(note,)))
    back = loads(data)
    same_bits(back.dmp, dmp)
    assert (back.name, back.unit, back.provenance, back.notes) == ("it", "cm", None, (note,))
    assert dumps(back) == data


@pytest.mark.parametrize("n_dims", [2, 3])
def test_poses_return_as_well(n_dims):
    primitive = learn(turning(n_dims), poses=True, n_basis=8)
    back = loads(dumps(primitive))
    assert isinstance(back.dmp, PoseDMP)
    assert back.kind == "pose"
    same_bits(back.dmp.translation, primitive.dmp.translation)
    same_bits(back.dmp.turning, primitive.dmp.turning)
    assert np.array_equal(back.dmp.reference, primitive.dmp.reference)
    assert (back.dmp.axis is None) == (n_dims == 3)
    assert back.provenance == primitive.provenance
    assert 0 < back.provenance.turn_rms <= back.provenance.turn_max < 0.2


def test_a_file_says_where_the_primitive_comes_from(tmp_path):
    recording = Demonstration.from_lasa("Angle")
    primitive = learn(recording, name="Angle", source="lasa:Angle:0", n_basis=12)
    write_primitive(tmp_path / "a.json", primitive)
    p = read_primitive(tmp_path / "a.json").provenance
    assert (p.source, p.recording, p.n_samples, p.n_basis) == ("lasa:Angle:0", "Angle 0", 1000, 12)
    assert p.notes == recording.notes
    error = np.linalg.norm(primitive.dmp.at(recording.time).position - recording.position, axis=1)
    assert p.error_rms == pytest.approx(np.sqrt(np.mean(error**2)), rel=1e-12)
    assert p.error_max == pytest.approx(error.max(), rel=1e-12)
    other = learn(Demonstration(recording.time, recording.position + 1e-9, unit="mm")).provenance
    assert other.sha256 != p.sha256
    assert learn(recording).provenance.sha256 == p.sha256


def test_equal_inputs_make_equal_files(tmp_path):
    for name in ("a", "b"):
        write_primitive(tmp_path / name, lasa())
    assert (tmp_path / "a").read_bytes() == (tmp_path / "b").read_bytes()


def test_texts_of_any_kind_return():
    for text in ("ä → ψ", "\udcff", 'quoted "\n\x00', "\u2028"):
        assert loads(dumps(replace(lasa(n_basis=2), notes=(text,)))).notes == (text,)


def test_a_file_is_written_whole_or_not_at_all(tmp_path, monkeypatch):
    path = tmp_path / "a.json"
    write_primitive(path, lasa())
    before = path.read_bytes()
    with pytest.raises(LibraryError, match="there already"):
        write_primitive(path, lasa("Sine"), replace=False)
    monkeypatch.setattr(os, "fsync", lambda _: (_ for _ in ()).throw(OSError(28, "No space left on device")))
    with pytest.raises(LibraryError, match="the disk is full"):
        write_primitive(path, lasa("Sine"))
    assert path.read_bytes() == before
    assert [entry.name for entry in tmp_path.iterdir()] == ["a.json"]


def test_file_systems_without_links(tmp_path, monkeypatch):
    monkeypatch.setattr(os, "link", lambda *_: (_ for _ in ()).throw(PermissionError(1, "not permitted")))
    write_primitive(tmp_path / "a.json", lasa(), replace=False)
    with pytest.raises(LibraryError, match="there already"):
        write_primitive(tmp_path / "a.json", lasa("Sine"), replace=False)
    assert read_primitive(tmp_path / "a.json").name == "Angle"


@pytest.mark.parametrize("what", ["folder", "no folder", "zero byte"])
def test_where_nothing_can_be_written(tmp_path, what):
    path = {"folder": tmp_path, "no folder": tmp_path / "no" / "a.json", "zero byte": tmp_path / "a\0b"}[what]
    with pytest.raises(LibraryError) as caught:
        write_primitive(path, lasa())
    assert caught.value.way_out


def test_what_is_not_finite_is_not_written(tmp_path):
    primitive = lasa()
    broken = replace(primitive, provenance=replace(primitive.provenance, error_max=np.nan))
    with pytest.raises(LibraryError, match="not finite"):
        write_primitive(tmp_path / "a.json", broken)
    with pytest.raises(LibraryError, match="cannot name"):
        write_primitive(tmp_path / "a.json", Primitive("../a", lasa().dmp))
    assert not list(tmp_path.iterdir())


# --- What is wrong with a file ---


def test_truncated_anywhere(text):
    for cut in range(len(text) - 2):
        refusal(text[:cut])
    assert loads(text[:-1].encode()).name == "Angle"  # without the last line feed


def test_any_edited_digit_is_noticed_or_makes_no_difference(text):
    whole = loads(text.encode())
    noticed = 0
    for i in (i for i, c in enumerate(text) if c.isdigit()):
        data = text[:i] + str((int(text[i]) + 3) % 10) + text[i + 1 :]
        try:
            back = loads(data.encode())
        except LibraryError:
            noticed += 1
        else:
            same_bits(back.dmp, whole.dmp)
            assert back.provenance == whole.provenance
    assert noticed > 0.95 * sum(c.isdigit() for c in text)


@examples(200)
@given(st.data())
def test_any_edited_byte_is_noticed_or_makes_no_difference(text, data):
    i = data.draw(st.integers(0, len(text) - 1))
    c = data.draw(st.sampled_from(list('0e-+.,:[]{}" xN')))
    try:
        back = loads((text[:i] + c + text[i + 1 :]).encode())
    except LibraryError as error:
        assert error.way_out
    else:
        same_bits(back.dmp, loads(text.encode()).dmp)


@given(st.binary(max_size=200))
def test_noise(noise):
    refusal(noise)


@given(st.recursive(st.none() | st.booleans() | st.floats() | st.text(), st.lists, max_leaves=20))
def test_other_json(value):
    refusal(json.dumps(value).encode())


ONE_WRONG = [
    ("format", "other", "format", "no primitive of comove"),
    ("version", 2, "version", "the version 2 is not known"),
    ("version", True, "version", "not known"),
    ("kind", "dance", "kind", "'dance' is not known"),
    ("kind", ["position"], "kind", "is not known"),
    ("name", "a/b", "name", "cannot name a primitive"),
    ("name", 3, "name", "cannot name a primitive"),
    ("trace", [[0.0, 0.0]], "trace", "another basis"),
    ("sha256", "0" * 64, "sha256", "checksum does not fit"),
    ("sha256", 7, "sha256", "checksum does not fit"),
]


@pytest.mark.parametrize(("place", "value", "key", "message"), ONE_WRONG)
def test_one_thing_wrong(text, place, value, key, message):
    content = json.loads(text) | {place: value}
    error = refusal(json.dumps(content).encode() if place == "sha256" else resealed(content))
    assert error.key == key
    assert message in error.message


def places(value, place=()):
    """Places of all entries, of mappings and of lists."""
    entries = (
        value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    )
    for key, entry in entries:
        yield (*place, key)
        yield from places(entry, (*place, key))


ANYTHING = st.recursive(
    st.sampled_from([None, True, "", "linear", "nan", 0, -1.0, 1.7e308, 10**400, 1e400]),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.sampled_from(["name", "held"]), inner),
    max_leaves=4,
)


@examples(300)
@given(st.data())
def test_noise_behind_a_checksum_that_fits_is_read_or_refused(every_kind, data):
    """Whoever seals a changed file anew gets a movement or a sentence, whatever stands where."""
    content = json.loads(every_kind[data.draw(st.sampled_from(sorted(every_kind)))])
    place = data.draw(st.sampled_from(list(places(content))))
    part = content
    for step in place[:-1]:
        part = part[step]
    if data.draw(st.booleans()):
        del part[place[-1]]
    else:
        part[place[-1]] = data.draw(ANYTHING)
    sealed = resealed(content)
    try:
        loads(sealed, "some.json")
    except LibraryError:
        refusal(sealed)


def test_what_is_no_json_or_not_finite_is_refused(text):
    assert refusal(text.replace('"duration": ', '"duration": NaN, "x": ')).key == "sha256"
    for data in ("[" * 100_000, b"\xff\xfe", "1" * 10_000):
        assert "breaks off or is no JSON" in refusal(data).message


def test_weights_of_another_basis_are_noticed(text):
    """A basis whose functions have other signs would make another movement of the same weights."""
    content = json.loads(text)
    content["movement"]["weights"][0][2] *= -1
    assert refusal(resealed(content)).key == "trace"


def test_poses_are_checked_as_well():
    text = dumps(learn(turning(), poses=True, n_basis=4))
    content = json.loads(text)
    content["movement"]["turning"]["duration"] = 3.0
    assert refusal(resealed(content)).key == "movement"
    content = json.loads(text)
    content["movement"]["reference_wxyz"][0] += 0.1
    assert refusal(resealed(content)).key == "movement"
    content = json.loads(text)
    content["movement"]["turning"]["weights"][2][3] += 1.0
    assert refusal(resealed(content)).key == "trace"


def test_huge_and_missing_files(tmp_path):
    path = tmp_path / "huge.json"
    with open(path, "wb") as file:
        file.truncate(MAX_BYTES + 1)
    for wrong, message in ((path, "MB"), (tmp_path, "folder"), (tmp_path / "no.json", "no such file")):
        with pytest.raises(LibraryError, match=message):
            read_primitive(wrong)


@pytest.mark.parametrize("name", ["a", "Angle 0", "reach-2.1", "ä_1", "7", "x" * 100, "a+b"])
def test_names(name):
    assert require_name(name) == name


@pytest.mark.parametrize(
    "name",
    [
        "",
        " a",
        "a ",
        ".a",
        "a.",
        "..",
        "a/b",
        "a\\b",
        "a\0b",
        "a\nb",
        "-rf",
        "a..b",
        "x" * 101,
        "a:b",
        "~",
        "*",
        None,
        3,
    ],
)
def test_unsafe_names(name):
    with pytest.raises(LibraryError, match="cannot name"):
        require_name(name)


def test_learning_is_fitting():
    recording = Demonstration.from_lasa("Sine")
    dmp = DMP.fit(recording, n_basis=11, variant="pastor", phase=LinearPhase())
    same_bits(learn(recording, n_basis=11, variant="pastor", phase=LinearPhase()).dmp, dmp)
    assert learn(recording).name == "Sine 0"
    assert learn(recording).unit == "LASA unit"
    with pytest.raises(OptionError, match="period"):
        learn(turning(), poses=True, period=1.0)


def cooperating():
    """Two hands that move for themselves."""
    one = PoseDMP.fit(turning(), n_basis=6)
    moved = Pose(one.start.position + [0.1, 0.6, 0.0], one.start.orientation)
    return CooperativeDMP(None, {"left": one, "right": one.towards(start=moved)})


def several():
    """One of every kind that is no single movement."""
    held = {"left": Pose([0, -0.3, 0.1]), "right": Pose([0, 0.3, 0], [0.0, 1.0, 0.0, 0.0])}
    lid = PoseDMP.fit(turning(), n_basis=4)
    return {
        "load": CooperativeDMP(PoseDMP.fit(turning(), n_basis=5), held),
        "lid": CooperativeDMP(PoseDMP.fit(turning(), n_basis=5), {**held, "lid": lid}),
        "alone": cooperating(),
        "average": average([Demonstration.from_lasa("Angle", k) for k in range(3)], n_basis=7),
    }


def same(one, other):
    """Whether two movements hold the same bits, whatever they are made of."""
    if is_dataclass(one) and not callable(one):
        return type(one) is type(other) and all(
            same(getattr(one, f.name), getattr(other, f.name)) for f in fields(one)
        )
    if is_dataclass(one):
        return type(one) is type(other) and same(vars(one), vars(other))
    if isinstance(one, dict):
        return list(one) == list(other) and all(same(one[key], other[key]) for key in one)
    if isinstance(one, tuple):
        return len(one) == len(other) and all(map(same, one, other))
    if isinstance(one, np.ndarray):
        return np.array_equal(one, other)
    return one == other


@pytest.mark.parametrize("name", ["load", "lid", "alone", "average"])
def test_what_is_made_of_several_movements_is_stored_too(name, tmp_path):
    dmp = several()[name]
    path = tmp_path / "several.json"
    write_primitive(path, Primitive("several", dmp, notes=("made here",)))
    read = read_primitive(path)
    assert read.kind == ("average" if name == "average" else "cooperative")
    assert same(read.dmp, dmp) and not same(read.dmp, several()["load" if name != "load" else "lid"])
    assert dumps(read) == path.read_bytes()
    assert read.positions.n_dims == (2 if name == "average" else 3)
    if name == "average":
        assert np.array_equal(read.dmp.spread(11), dmp.spread(11))
    else:
        time = np.linspace(0, 2, 5)
        assert np.array_equal(dmp.at(time).position, read.dmp.at(time).position)


def test_hands_that_constraints_held_are_refused_and_others_of_that_time_are_read(tmp_path):
    """Files of earlier versions name constraints and mobilities of hands."""
    now = json.loads(dumps(Primitive("hands", cooperating())))
    for constraints in ([], [{"kind": "same height", "first": "left", "second": "right"}]):
        then = {**now, "movement": {**now["movement"], "mobility": {}, "constraints": constraints}}
        del then["sha256"]
        text = json.dumps(then, sort_keys=True, separators=(",", ":"))
        then["sha256"] = hashlib.sha256(text.encode()).hexdigest()
        if not constraints:
            assert same(loads(json.dumps(then).encode()).dmp, cooperating())
            continue
        with pytest.raises(LibraryError, match=r"constraints: its hands are held by constraints.*scene"):
            loads(json.dumps(then).encode())


def test_a_library_holds_them_and_a_scene_follows_them(tmp_path):
    library = Library(tmp_path / "shelf")
    for name, dmp in several().items():
        library.add(Primitive(name, dmp))
    found = {name: library[name] for name in several()}
    assert same(found["average"].followed, several()["average"].mean)
    assert same(found["load"].followed, several()["load"].load)
    assert same(found["alone"].followed, several()["alone"].hands["left"])
