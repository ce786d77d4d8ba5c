"""A library keeps what it was given, whoever else writes, and finds what comes nearest."""

import threading

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial import procrustes
from scipy.spatial.transform import Rotation

from comove.dmp import operations as op
from comove.dmp.demonstrations import Demonstration
from comove.dmp.files import Primitive, dumps, learn, learn_distribution
from comove.dmp.library import SUFFIX, Library, shape_distances
from comove.errors import DemonstrationError, LibraryError, OptionError
from tests.cases import examples

seeds = st.integers(0, 2**32 - 1)
SHAPES = ("Angle", "Sine", "Line", "GShape", "Worm")


def lasa(shape, **options):
    return learn(Demonstration.from_lasa(shape), name=shape, **options)


ALL = {shape: lasa(shape) for shape in SHAPES}


@pytest.fixture
def library(tmp_path):
    library = Library(tmp_path / "library")
    for primitive in ALL.values():
        library.add(primitive)
    return library


# --- Keeping ---


def test_what_was_added_is_there(library):
    assert library.names == tuple(sorted(SHAPES))
    assert len(library) == 5
    assert [p.name for p in library] == sorted(SHAPES)
    assert "Sine" in library and "sine" not in library
    assert dumps(library["Sine"]) == dumps(ALL["Sine"])
    library.remove("Sine")
    assert "Sine" not in library
    assert Library(library.folder / "none").names == ()


def test_names_are_taken_once(library):
    with pytest.raises(LibraryError, match="'Sine' already; choose another name, or replace it"):
        library.add(ALL["Sine"])
    with pytest.raises(LibraryError, match="'Sine' already"):
        library.add(ALL["Line"], "sine")  # some file systems make no difference
    library.add(ALL["Line"], "Sine", replace=True)
    assert library["Sine"].name == "Sine"
    assert np.array_equal(library["Sine"].dmp.weights, ALL["Line"].dmp.weights)


def test_a_renamed_file_is_a_renamed_primitive(library):
    path = library.path("Sine")
    path.rename(library.path("wave"))
    assert library["wave"].name == "wave"


def test_unknown_names(library):
    for missing in (library.get, library.remove):
        with pytest.raises(LibraryError, match="no primitive 'Sinus'; did you mean 'Sine'"):
            missing("Sinus")
    with pytest.raises(LibraryError, match="the library is empty"):
        Library(library.folder / "none").get("x")


@pytest.mark.parametrize("name", ["../x", "/etc/x", "a/b", "", "..", ".hidden", "a\0b"])
def test_unsafe_names(library, name):
    before = library.names
    for use in (library.get, library.remove, lambda name: library.add(ALL["Sine"], name)):
        with pytest.raises(LibraryError, match="cannot name"):
            use(name)
    assert library.names == before
    assert [path.name for path in library.folder.parent.iterdir()] == ["library"]


def test_damaged_files_hide_nothing_and_are_named(library):
    path = library.path("Sine")
    path.write_bytes(path.read_bytes()[:-100])
    assert [p.name for p in library] == ["Angle", "GShape", "Line", "Worm"]
    assert list(library.damaged) == ["Sine"]
    assert str(path) in str(library.damaged["Sine"])
    assert "Sine" in library.names
    assert "Sine" not in [m.name for m in library.find(duration=1.0)]
    library.remove("Sine")
    assert not library.damaged


def test_foreign_files_are_left_alone_and_named(library):
    for name in ("README.md", "data.json", f"-x{SUFFIX}", ".hidden"):
        (library.folder / name).write_text("mine")
    assert library.foreign == (f"-x{SUFFIX}", "README.md", "data.json")
    assert len(library) == 5
    assert (library.folder / "data.json").read_text() == "mine"


def test_a_file_is_no_library(tmp_path):
    path = tmp_path / "file"
    path.write_text("x")
    for use in (lambda x: x.names, lambda x: x.add(ALL["Sine"])):
        with pytest.raises(LibraryError, match="file: "):
            use(Library(path))


@pytest.mark.parametrize("replace", [False, True])
def test_many_who_add_at_once(tmp_path, replace):
    library, outcomes = Library(tmp_path), []
    barrier = threading.Barrier(8)

    def add(i):
        barrier.wait()
        try:
            library.add(ALL[SHAPES[i % 5]], "same", replace=replace)
            outcomes.append(i)
        except LibraryError as error:
            assert "already" in str(error)

    threads = [threading.Thread(target=add, args=(i,)) for i in range(8)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len(outcomes) == (8 if replace else 1)
    kept = library["same"].dmp.weights
    assert any(np.array_equal(kept, ALL[SHAPES[i % 5]].dmp.weights) for i in outcomes)
    assert not library.damaged
    assert [entry.name for entry in tmp_path.iterdir()] == [f"same{SUFFIX}"]


# --- Shapes ---


def curves(seed, count, n_dims=2):
    rng = np.random.default_rng(seed)
    return np.cumsum(rng.standard_normal((count, 40, n_dims)), axis=1)


@examples(50)
@given(seeds, st.integers(2, 4))
def test_a_metric_on_shapes(seed, n_dims):
    d = shape_distances(*[curves(seed, 5, n_dims)] * 2)
    assert np.allclose(d, d.T, atol=1e-12)
    assert np.diag(d).max() <= 1e-12
    assert (d[:, :, None] <= d[:, None, :] + d.T[None] + 1e-12).all()  # never longer than by way of a third
    assert d.max() <= np.sqrt(2) + 1e-12


@examples(50)
@given(seeds, st.sampled_from([2, 3]), st.floats(1e-3, 1e3))
def test_similar_curves_have_one_shape_and_mirrored_ones_another(seed, n_dims, factor):
    rng = np.random.default_rng(seed)
    curve = curves(seed, 1, n_dims)
    turn = Rotation.random(rng=rng).as_matrix() if n_dims == 3 else None
    if n_dims == 2:
        c, s = np.cos(seed), np.sin(seed)
        turn = np.array([[c, -s], [s, c]])
    moved = factor * curve @ turn.T + rng.uniform(-10, 10, n_dims)
    assert shape_distances(curve, moved)[0, 0] <= 1e-10
    assert shape_distances(curve, moved * np.r_[-1.0, np.ones(n_dims - 1)])[0, 0] > 1e-3
    reference = procrustes(curve[0], moved[0])[2]  # which may mirror
    assert shape_distances(curve, moved)[0, 0] ** 2 >= reference - 1e-12


@given(seeds)
def test_the_distance_is_what_brute_force_finds(seed):
    a, b = curves(seed, 2)
    angles = np.linspace(0, 2 * np.pi, 20001)
    a, b = ((x - x.mean(axis=0)) / np.linalg.norm(x - x.mean(axis=0)) for x in (a, b))
    z, w = a @ [1, 1j], b @ [1, 1j]
    least = np.sqrt(2 - 2 * (np.exp(1j * angles) * (z.conj() @ w)).real.max())
    assert shape_distances(a[None], b[None])[0, 0] == pytest.approx(least, abs=1e-6)


def test_a_point_has_no_shape():
    still = np.zeros((1, 40, 2))
    assert shape_distances(still, still)[0, 0] == 0
    assert shape_distances(still, curves(0, 1))[0, 0] == pytest.approx(1.0)


# --- Finding ---


@pytest.mark.parametrize("demo", [1, 3, 6])
def test_handwriting_is_recognised(library, demo):
    for shape in SHAPES:
        matches = library.find(shape=Demonstration.from_lasa(shape, demo))
        assert matches[0].name == shape
        assert [m.distance for m in matches] == sorted(m.distance for m in matches)
        assert matches[0].distance == matches[0].shape


def test_ends_and_durations(library):
    wanted = ALL["Worm"].dmp
    best = library.find(start=wanted.start, goal=wanted.goal, duration=wanted.duration, limit=1)
    assert [(m.name, m.distance, m.start, m.goal, m.duration) for m in best] == [("Worm", 0, 0, 0, 1)]
    match = next(m for m in library.find(duration=2 * wanted.duration) if m.name == "Worm")
    assert match.duration == pytest.approx(0.5)
    assert match.distance == pytest.approx(np.log(2))
    assert match.start is None and match.shape is None


def test_terms_add_up_as_documented(library):
    start, goal = np.array([-40.0, 3.0]), np.array([0.0, 3.0])
    match = library.find(start=start, goal=goal, duration=3.0, shape=ALL["Sine"])[2]
    dmp = library[match.name].dmp
    parts = [
        np.linalg.norm(dmp.start - start) / 40,
        np.linalg.norm(dmp.goal - goal) / 40,
        np.log(dmp.duration / 3),
    ]
    assert match.distance == pytest.approx(np.sqrt(sum(p**2 for p in parts) + match.shape**2))


def test_only_movements_of_the_same_dimension_are_compared(library):
    library.add(Primitive("spatial", op.in_space(ALL["Sine"].dmp, "xz")))
    assert [m.name for m in library.find(start=[0, 0, 0])] == ["spatial"]
    assert "spatial" not in [m.name for m in library.find(start=[0, 0])]
    assert len(library.find(duration=1.0)) == 6
    assert library.find(start=[0.0]) == []


@pytest.mark.parametrize(
    ("wanted", "message"),
    [
        ({}, "nothing is asked for"),
        ({"start": [0, np.nan]}, "start ="),
        ({"start": "here"}, "start = 'here'"),
        ({"goal": [[0, 0]]}, "goal ="),
        ({"duration": 0}, "duration = 0"),
        ({"duration": np.inf}, "duration = inf"),
        ({"start": [0, 0], "goal": [0, 0, 0]}, "dimension"),
        ({"start": [0, 0], "limit": 0}, "limit = 0"),
        ({"shape": 3}, "shape = 3"),
    ],
)
def test_refused(library, wanted, message):
    with pytest.raises(OptionError, match=message):
        library.find(**wanted)


def test_a_large_library_is_ranked_at_once(tmp_path):
    library = Library(tmp_path)
    for i, primitive in enumerate([*ALL.values()] * 20):
        library.add(Primitive(f"{i}", op.rotate(primitive.dmp, i / 7)))
    found = [int(match.name) % 5 for match in library.find(shape=ALL["Sine"])]
    assert len(found) == 100 and set(found[:20]) == {SHAPES.index("Sine")}


def test_positions_are_ranked_in_metres_and_joints_left_out(tmp_path):
    """Whatever units movements were kept in, and however near the numbers of joints lie."""
    library = Library(tmp_path)
    share = np.linspace(0.0, 1.0, 40)
    for name, end, unit in (
        ("near", 500.0, "mm"),
        ("far", 0.9, "m"),
        ("arm", 0.5, "rad"),
        ("far_mm", 2e3, "mm"),
    ):
        line = Demonstration(share, np.outer(share, [end, 0.0]), unit=unit)
        library.add(learn(line, name=name))
    found = library.find(goal=[0.5, 0.0])
    assert [match.name for match in found] == ["near", "far", "far_mm"]
    np.testing.assert_allclose([match.goal for match in found], [0.0, 0.4, 1.5], atol=1e-6)
    assert "arm" not in {match.name for match in library.find(shape=library.get("near"))}
    assert [match.name for match in library.find(shape=library.get("arm"))] == ["arm"]


def test_recordings_in_different_units_make_no_distribution():
    share = np.linspace(0.0, 1.0, 40)
    line = np.outer(share, [0.5, 0.1])
    metres, joints = (Demonstration(share, line, unit=unit) for unit in ("m", "rad"))
    with pytest.raises(DemonstrationError, match="in rad, recording 0 is in m"):
        learn_distribution([metres, joints, metres], name="mixed")
    other = Demonstration(share, 1.1 * line, unit="rad")
    assert learn_distribution([joints, other], name="arm").is_joints
