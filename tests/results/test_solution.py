"""A result folder is there as a whole or not at all, gives back what was written, and betrays every edit."""

import json
import os
import shutil
import zipfile
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

import comove
from comove import PaperCost
from comove.cli.texts import summary_text
from comove.errors import ResultError
from comove.io.folders import check_target, whole_folder
from comove.lab.evolution import Projection
from comove.model import Scene
from comove.results import RESULT, read_result, verify_result, write_solution
from comove.results.sealed import checksum
from comove.results.solution import SOLUTION, rebuild
from tests.cases import examples
from tests.solved import example, solved
from tests.verification.random_motions import scene_data

SAMPLES = ["time", "position", "velocity"]
CURVE = ["weights", "start", "goal"]
MEASURES = [
    "clearance_min",
    "distance_error_max",
    "end_error",
    "end_speed",
    "speed_max",
    "acceleration_max",
]
CONTRACT = [
    *("verified", "method", "seed", "version", "cost", "cost_terms", "distance_error_max", "clearance_min"),
    *("end_error", "speed_max", "acceleration_max", "evaluations", "generations", "time_to_first_verified_s"),
    *("wall_time_s", "scene_sha256", "motion_sha256", "reasons"),
]


def written(folder, solution):
    folder.mkdir()
    write_solution(solution, folder, wall_time_s=1.5)
    return folder


@pytest.fixture
def folder(tmp_path):
    """A verified result of the scene `narrow`."""
    return written(tmp_path / "result", solved("narrow"))


def arrays_of(folder):
    with np.load(folder / "solution.npz", allow_pickle=False) as archive:
        return dict(archive)


def edit_arrays(folder, signed=False, **changes):
    """Put other arrays into the archive; `signed` edits bring all checksums along."""
    arrays = arrays_of(folder) | changes
    np.savez(folder / "solution.npz", **arrays)
    if signed:
        edit_summary(folder, signed=True, motion_sha256=checksum(arrays))


def edit_summary(folder, signed=False, **changes):
    """Change entries of the summary, and with `signed` its own checksum too."""
    path = folder / "solution.json"
    summary = json.loads(path.read_text()) | changes
    if signed:
        summary["summary_sha256"] = SOLUTION.seal(summary)
    path.write_text(json.dumps(summary))


def reasons(folder, scene=None):
    """Why the result is rejected."""
    verdict = verify_result(read_result(folder), scene or example("narrow"))
    assert (verdict.verified is None) == bool(verdict.reasons)
    return verdict.reasons


# --- Round trip ---


@pytest.mark.parametrize(
    ("name", "options"),
    [
        ("narrow", {}),
        ("narrow", {"method": Projection()}),
        ("wide", {"planner": False}),
        ("window", {}),
        ("triangle", {}),
    ],
)
@pytest.mark.few(2)
def test_round_trip(tmp_path, name, options):
    solution = solved(name, **options)
    stored = read_result(written(tmp_path / "result", solution))
    verdict = verify_result(stored, example(name))
    assert verdict.reasons == ()
    assert verdict.verified is not None
    assert verdict.report == solution.report
    motion = rebuild(stored.arrays, example(name))
    s = np.random.default_rng(0).random(100)
    assert np.array_equal(motion.at(s), solution.attempt.at(s))
    assert np.array_equal(stored.trajectory.position, solution.trajectory.position)
    assert stored.trajectory.manipulators == solution.scene.manipulators


def test_what_the_contract_names_is_there(folder):
    solution, summary = solved("narrow"), json.loads((folder / "solution.json").read_text())
    for name in CONTRACT:
        assert name in summary
    assert summary["verified"] is True
    assert summary["reasons"] == []
    assert summary["cost"] == solution.cost.total
    assert sum(summary["cost_terms"].values()) == pytest.approx(summary["cost"], rel=1e-12)
    assert summary["clearance_min"] == solution.report.clearance_min
    assert summary["scene_sha256"] == example("narrow").sha256
    assert summary["wall_time_s"] == 1.5
    arrays = arrays_of(folder)
    n = len(arrays["time"])
    assert arrays["position"].shape == arrays["velocity"].shape == (n, 2, 2)
    assert np.diff(arrays["time"]).max() <= 0.01 + 1e-12
    assert arrays["time"][[0, -1]].tolist() == [0.0, 10.0]
    assert arrays["manipulators"].tolist() == ["left", "right"]
    assert all(array.dtype.kind in "fUi" for array in arrays.values())


def test_velocities_are_the_derivative_of_positions(folder):
    arrays = arrays_of(folder)
    differences = np.gradient(arrays["position"], arrays["time"], axis=0)[1:-1]
    assert np.abs(differences - arrays["velocity"][1:-1]).max() < 0.02


def test_accelerations_are_the_derivative_of_velocities(folder):
    arrays = arrays_of(folder)
    differences = np.gradient(arrays["velocity"], arrays["time"], axis=0)[1:-1]
    assert np.abs(differences - arrays["acceleration"][1:-1]).max() < 0.02


@pytest.mark.parametrize("name", ["narrow", "window", "triangle"])
def test_hands_are_where_the_poses_of_their_group_put_them(tmp_path, name):
    solution = solved(name)
    arrays, n_dims = arrays_of(written(tmp_path / "result", solution)), solution.scene.n_dims
    for g, group in enumerate(solution.scene.groups):
        w, x, y, z = arrays["quaternion"][:, g].T
        turn = Rotation.from_quat(np.stack([x, y, z, w], axis=1)).as_matrix()
        placed = arrays["center"][:, g, None] + np.einsum("tij,kj->tki", turn, group.grasps)
        hands = arrays["position"][:, list(group.members)]
        np.testing.assert_allclose(placed[:, :, :n_dims], hands, atol=1e-12)


def test_an_attempt_is_labelled_so(tmp_path):
    """And the verdict on it is no."""
    data = scene_data(example("narrow"))
    data["obstacles"] = [{"shape": "box", "center": [0.5, 0.5], "size": [0.1, 1.2]}]
    scene = Scene.from_dict(data | {"demonstration": None})
    folder = written(tmp_path / "attempt", comove.solve(scene, budget=0.2))
    summary = json.loads((folder / "solution.json").read_text())
    assert summary["verified"] is False
    assert summary["reasons"]
    assert summary["time_to_first_verified_s"] is None
    assert reasons(folder, scene)
    edit_summary(folder, verified=True, reasons=[])
    assert any("obstacles[0]" in reason for reason in reasons(folder, scene))


# --- Edits ---


@examples(20)
@given(st.data())
def test_an_edited_number_is_rejected_however_small_the_edit(tmp_path_factory, data):
    """The next representable number suffices."""
    folder = written(tmp_path_factory.mktemp("edit") / "result", solved("narrow"))
    name = data.draw(st.sampled_from([*SAMPLES, *CURVE]))
    array = arrays_of(folder)[name].copy()
    at = tuple(data.draw(st.integers(0, n - 1)) for n in array.shape)
    old = array[at]
    array[at] = data.draw(
        st.sampled_from(
            [np.nextafter(old, np.inf), np.nextafter(old, -np.inf), old + 1e-3, -old - 1.0, 0.5 * old + 7.0]
        )
    )
    edit_arrays(folder, **{name: array})
    assert reasons(folder)
    assert any("checksum" in reason for reason in reasons(folder))


@pytest.mark.parametrize("name", [*SAMPLES, "acceleration", "center", "quaternion"])
@pytest.mark.parametrize("change", [1e-9, 1e-3, np.nan, np.inf])
def test_an_edited_sample_is_found_even_with_the_right_checksum(folder, name, change):
    array = arrays_of(folder)[name].copy()
    array[(17,) + (0,) * (array.ndim - 1)] += change
    edit_arrays(folder, signed=True, **{name: array})
    told = reasons(folder)
    assert len(told) == 1
    assert f"'{name}[17" in told[0]


def test_edited_weights_with_the_right_checksum_do_not_fit_the_samples(folder):
    weights = arrays_of(folder)["weights"].copy()
    weights[0, 3] += 1e-6
    edit_arrays(folder, signed=True, weights=weights)
    assert any("position" in reason for reason in reasons(folder))


@pytest.mark.parametrize("name", CURVE)
def test_curves_that_are_not_finite_or_misshapen_are_rejected(folder, name):
    array = arrays_of(folder)[name]
    for wrong in (array * np.nan, array[:, :-1], array.astype(int), array.astype(str), array.astype(complex)):
        edit_arrays(folder, signed=True, **{name: wrong})
        assert any(name in reason for reason in reasons(folder))


@pytest.mark.parametrize(
    "changes",
    [
        {"coordinates": np.array("projected")},
        {"coordinates": np.array("arms")},
        {"basis_functions": np.array(29)},
        {"basis_functions": np.array(10**9)},
        {"basis_functions": np.array("thirty")},
        {"basis_functions": np.array([30, 30])},
        {"basis_metric": np.array("acceleration")},
        {"basis_metric": np.array("velocity")},
        {"basis_metric": np.array("snap")},
        {"basis_phase": np.array("exponential 2.0")},
        {"basis_phase": np.array("exponential x")},
        {"basis_phase": np.array("exponential nan")},
        {"manipulators": np.array(["right", "left"])},
        {"manipulators": np.array(["left"])},
        {"position": np.zeros((3, 2, 2))},
        {"time": np.zeros((0,))},
    ],
)
def test_other_curves_and_samples_are_rejected(folder, changes):
    with np.errstate(all="ignore"):
        edit_arrays(folder, signed=True, **changes)
        assert reasons(folder)


@pytest.mark.parametrize("name", MEASURES)
def test_edited_measures_are_rejected(folder, name):
    value = json.loads((folder / "solution.json").read_text())[name]
    for wrong in (value + 1e-3, value * 2 + 1e-6, None, "0.1", True, [value]):
        edit_summary(folder, **{name: wrong})
        assert any(name in reason for reason in reasons(folder)), wrong
    edit_summary(folder, **{name: value})
    assert reasons(folder) == ()


@pytest.mark.parametrize("name", ["verified", "scene_sha256", "motion_sha256", *MEASURES])
def test_missing_entries_are_rejected(folder, name):
    path = folder / "solution.json"
    summary = json.loads(path.read_text())
    del summary[name]
    path.write_text(json.dumps(summary))
    assert reasons(folder)


@pytest.mark.parametrize("value", [False, "true", 1, None])
def test_who_does_not_claim_to_be_verified_is_not(folder, value):
    edit_summary(folder, verified=value)
    assert any("claim" in reason for reason in reasons(folder))


@pytest.mark.parametrize(
    "changes",
    [
        {"cost": 0.01},
        {"cost_terms": {"goal": 0.0, "velocity": 0.0, "obstacle": 0.0, "resemblance": 0.0}},
        {"reasons": ["too fast"]},
        {"seed": 12345},
        {"method": "projection"},
        {"scene": "another"},
        {"evaluations": 1},
    ],
)
def test_every_edited_entry_is_rejected(folder, changes):
    edit_summary(folder, **changes)
    assert reasons(folder)


# --- Another scene ---


@pytest.mark.parametrize("name", ["wide", "complex", "window", "triangle"])
def test_another_scene_is_rejected(folder, name):
    assert reasons(folder, example(name))


@pytest.mark.parametrize("where", ["obstacles", "limits", "name", "duration", "manipulators"])
def test_a_slightly_other_scene_is_rejected(folder, where):
    data = scene_data(example("narrow"))
    if where == "obstacles":
        data["obstacles"][0]["size"] = [0.1, 0.4499999]
    if where == "limits":
        data["limits"] = {"speed": 1.1}
    if where == "name":
        data["name"] = "narrow2"
    if where == "duration":
        data["duration"] = 10.5
    if where == "manipulators":
        for manipulator in data["manipulators"]:
            manipulator["goal"][0] += 1e-6
    assert any("checksum" in reason for reason in reasons(folder, Scene.from_dict(data)))


def test_comments_and_layout_do_not_matter(folder, tmp_path):
    path = tmp_path / "again.yaml"
    path.write_text("# the same\n" + json.dumps(scene_data(example("narrow"))))
    assert reasons(folder, Scene.load(path)) == ()


# --- Files that cannot be read ---


def refused(folder, *words):
    with pytest.raises(ResultError) as caught:
        read_result(folder)
    for word in words:
        assert word in str(caught.value)
    assert caught.value.way_out
    assert "Traceback" not in str(caught.value)


COSTS = [
    {"cost": 0.5},
    {"cost": "x"},
    {"cost": 10**400},
    {"cost_terms": {"goal": 0.0}},
    {"cost_terms": 5},
    {"cost_weights": {"goal": 0.5, "velocity": 0.01, "obstacle": 10.0}},
    {"cost_weights": []},
    {"scene": "another"},
    {"clearance_min": 10**400},
    {"clearance_min": True},
]


@pytest.mark.parametrize("changes", COSTS, ids=str)
def test_costs_and_names_are_recomputed(folder, changes):
    edit_summary(folder, signed=True, **changes)
    assert reasons(folder)


@pytest.mark.parametrize("factor", [0.5, 2.0])
@pytest.mark.parametrize("name", ["goal", "velocity"])
def test_every_term_of_the_cost_is_recomputed(folder, name, factor):
    terms = json.loads((folder / "solution.json").read_text())["cost_terms"]
    terms[name] *= factor
    edit_summary(folder, signed=True, cost_terms=terms, cost=sum(terms.values()))
    (reason,) = reasons(folder)
    assert f"cost_terms.{name}" in reason


def test_other_weights_of_the_cost_are_kept_and_shown(tmp_path):
    weights = PaperCost(goal=2.0, velocity=0.0)
    solution = comove.solve(example("wide"), seed=0, objective=weights, budget=5.0)
    folder = written(tmp_path / "result", solution)
    summary = json.loads((folder / "solution.json").read_text())
    assert summary["cost_weights"] == {"goal": pytest.approx(2.0), "velocity": 0.0, "obstacle": 10.0}
    assert not any("cost" in reason for reason in reasons(folder, example("wide")))
    assert "goal" in summary_text(summary, folder)
    assert "(weight 2)" in summary_text(summary, folder)


SHOWN = ["scene", "method", "seed", "verified", "reasons", "cost", "cost_terms", "cost_weights"]
SHOWN += ["clearance_min", "speed_max", "time_to_first_verified_s", "wall_time_s"]


@pytest.mark.parametrize("value", [[], "x" * 1000, {"a": 1}, True, 10**400, 1.5, -1])
@pytest.mark.parametrize("name", SHOWN)
def test_what_is_shown_has_its_type(folder, name, value):
    """Whatever stands there is shown, or refused in a sentence that names it."""
    edit_summary(folder, signed=True, **{name: value})
    try:
        text = summary_text(SOLUTION.read(folder, whole=True)[0], folder)
        assert text
    except ResultError as error:
        assert error.key.startswith(name)
        assert len(str(error)) < 500 + len(str(folder))


def test_what_was_edited_is_not_shown(folder):
    assert SOLUTION.read(folder, whole=True)[0]["seed"] == 0
    text = (folder / "solution.json").read_text()
    (folder / "solution.json").write_text(text.replace('"seed": 0', '"seed": 1'))
    with pytest.raises(ResultError, match="was edited: its own checksum does not fit"):
        SOLUTION.read(folder, whole=True)
    (folder / "solution.json").write_text(text)
    arrays = arrays_of(folder)
    np.savez(folder / "solution.npz", **(arrays | {"position": arrays["position"] + 1e-3}))
    with pytest.raises(ResultError, match=r"solution\.npz: its checksum is not the one"):
        SOLUTION.read(folder, whole=True)


def test_missing_files(folder, tmp_path):
    refused(tmp_path / "nowhere", "nowhere", "no such folder")
    refused(folder / "solution.json", "solution.json")
    (tmp_path / "empty").mkdir()
    refused(tmp_path / "empty", "solution.json")
    os.remove(folder / "solution.npz")
    refused(folder, "solution.npz")
    os.remove(folder / "solution.json")
    refused(folder, "solution.json")


@pytest.mark.parametrize(
    "name", ["time", "position", "velocity", "manipulators", "weights", "start", "basis_phase"]
)
def test_a_missing_array(folder, name):
    arrays = arrays_of(folder)
    del arrays[name]
    np.savez(folder / "solution.npz", **arrays)
    refused(folder, "solution.npz", name)


@pytest.mark.parametrize("share", [0.0, 0.1, 0.5, 0.9, 0.99])
@pytest.mark.parametrize("name", ["solution.npz", "solution.json"])
def test_truncated_files(folder, name, share):
    content = (folder / name).read_bytes()
    (folder / name).write_bytes(content[: int(share * len(content))])
    refused(folder, name)


@examples(60)
@given(st.data())
def test_flipped_bytes_are_refused_or_rejected(tmp_path_factory, data):
    folder = written(tmp_path_factory.mktemp("flip") / "result", solved("narrow"))
    content = bytearray((folder / "solution.npz").read_bytes())
    at = data.draw(st.integers(0, len(content) - 1))
    content[at] ^= data.draw(st.integers(1, 255))
    (folder / "solution.npz").write_bytes(content)
    try:
        stored = read_result(folder)
    except ResultError:
        return
    verdict = verify_result(stored, example("narrow"))
    before = checksum(arrays_of(written(tmp_path_factory.mktemp("flip") / "result", solved("narrow"))))
    assert verdict.reasons or checksum(stored.arrays) == before  # bytes between the members say nothing


@pytest.mark.parametrize(
    "content", ["", "[]", "3", "{", '{"verified": NaN}', "\x00", '{"a": ' * 5000, "nonsense", "\ufeff{}"]
)
def test_summaries_that_are_no_summaries(folder, content):
    (folder / "solution.json").write_text(content, encoding="utf-8")
    refused(folder, "solution.json")


def test_a_summary_that_is_not_utf8(folder):
    (folder / "solution.json").write_bytes(b'{"scene": "\xff"}')
    refused(folder, "solution.json")


def test_huge_files(folder):
    (folder / "solution.json").write_text('{"a": "' + "x" * 2**21 + '"}')
    refused(folder, "solution.json", "1 MB")


@pytest.mark.slow
def test_an_archive_that_unpacks_to_a_gigabyte(folder, tmp_path):
    """1 MB of zeros, packed."""
    path = folder / "solution.npz"
    with (
        zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive,
        archive.open("time.npy", "w", force_zip64=True) as member,
    ):
        zeros = bytes(2**24)
        for _ in range(64):
            member.write(zeros)
    assert path.stat().st_size < 2**21
    refused(folder, "solution.npz", "MB")


def test_a_header_that_claims_more_than_there_is(folder):
    arrays = arrays_of(folder)
    with zipfile.ZipFile(folder / "solution.npz", "w") as archive:
        for name, array in arrays.items():
            with archive.open(f"{name}.npy", "w") as member:
                if name != "time":
                    np.lib.format.write_array(member, array)
                    continue
                header = {"descr": "<f8", "fortran_order": False, "shape": (10**12,)}
                np.lib.format.write_array_header_1_0(member, header)
                member.write(array.tobytes())
    refused(folder, "solution.npz", "time")


def test_pickles_are_never_loaded(folder):
    arrays = arrays_of(folder) | {"manipulators": np.array([{"a": 1}, None], dtype=object)}
    np.savez(folder / "solution.npz", **arrays)
    refused(folder, "pickled")


# --- Writing ---


def names_in(folder):
    return sorted(path.name for path in folder.iterdir())


def test_a_folder_appears_as_a_whole(tmp_path):
    target = tmp_path / "a" / "b" / "result"
    with whole_folder(target, RESULT) as draft:
        (draft / "solution.json").write_text("{}")
        assert not target.exists()
    assert names_in(target) == ["solution.json"]
    assert names_in(target.parent) == ["result"]
    assert target.stat().st_mode & 0o777 == 0o777 & ~_umask()


@pytest.mark.parametrize("error", [RuntimeError, KeyboardInterrupt, SystemExit, OSError])
def test_nothing_is_left_behind_by_a_failure(tmp_path, error):
    expected = ResultError if error is OSError else error
    with pytest.raises(expected), whole_folder(tmp_path / "result", RESULT) as draft:
        (draft / "half.txt").write_text("half")
        raise error("no")
    assert names_in(tmp_path) == []


@pytest.mark.parametrize("error", [RuntimeError, KeyboardInterrupt])
def test_a_failure_leaves_the_old_result_alone(folder, error):
    before = {path.name: path.read_bytes() for path in folder.iterdir()}
    with pytest.raises(error), whole_folder(folder, RESULT) as draft:
        (draft / "solution.json").write_text("{}")
        raise error
    assert {path.name: path.read_bytes() for path in folder.iterdir()} == before
    assert names_in(folder.parent) == [folder.name]


def test_a_result_is_replaced_as_a_whole(folder):
    (folder / "motion.png").write_bytes(b"old")
    with whole_folder(folder, RESULT) as draft:
        write_solution(solved("wide"), draft, 1.0)
    assert names_in(folder) == ["solution.json", "solution.npz"]
    assert json.loads((folder / "solution.json").read_text())["scene"] == "wide"
    assert names_in(folder.parent) == [folder.name]


def test_an_empty_folder_is_filled(tmp_path):
    (tmp_path / "empty").mkdir()
    with whole_folder(tmp_path / "empty", RESULT) as draft:
        (draft / "solution.json").write_text("{}")
    assert names_in(tmp_path / "empty") == ["solution.json"]


def test_other_folders_are_refused(tmp_path):
    foreign = tmp_path / "thesis"
    foreign.mkdir()
    (foreign / "chapter1.tex").write_text("x")
    with pytest.raises(ResultError, match="not empty"), whole_folder(foreign, RESULT):
        pytest.fail("the body must not run")
    assert names_in(foreign) == ["chapter1.tex"]
    with pytest.raises(ResultError, match="is a file"):
        check_target(foreign / "chapter1.tex", RESULT)
    with pytest.raises(ResultError, match=r"chapter1\.tex"):
        check_target(foreign / "chapter1.tex" / "result", RESULT)
    assert names_in(tmp_path) == ["thesis"]


def test_a_folder_that_holds_more_than_a_result_is_not_deleted(folder):
    (folder / "thesis.tex").write_text("years of work")
    with pytest.raises(ResultError), whole_folder(folder, RESULT) as draft:
        (draft / "solution.json").write_text("{}")
    assert (folder / "thesis.tex").exists()


@pytest.mark.skipif(os.geteuid() == 0, reason="root may write anywhere")
def test_a_folder_that_is_not_writable(tmp_path):
    (tmp_path / "locked").mkdir(mode=0o500)
    with pytest.raises(ResultError, match="not writable"):
        check_target(tmp_path / "locked" / "result", RESULT)
    with pytest.raises(ResultError, match="not writable"):
        check_target(tmp_path / "locked" / "further" / "result", RESULT)


@pytest.mark.skipif(not os.path.isdir("/proc/self"), reason="needs a file system that refuses folders")
def test_a_file_system_that_takes_no_folders():
    with pytest.raises(ResultError, match="written"), whole_folder("/proc/comove-result", RESULT):
        pytest.fail("the body must not run")


def test_a_link_to_a_result_is_replaced_without_litter(folder, tmp_path):
    link = tmp_path / "link"
    link.symlink_to(folder, target_is_directory=True)
    with whole_folder(link, RESULT) as draft:
        write_solution(solved("wide"), draft, 1.0)
    assert json.loads((link / "solution.json").read_text())["scene"] == "wide"
    assert names_in(tmp_path) == sorted(["link", folder.name])


def test_solutions_do_not_depend_on_where_they_are_written(tmp_path):
    first = written(tmp_path / "one", solved("narrow"))
    second = written(tmp_path / "two", replace(solved("narrow")))
    assert (first / "solution.json").read_text() == (second / "solution.json").read_text()
    shutil.move(first, tmp_path / "three")
    assert reasons(tmp_path / "three") == ()


def _umask():
    mask = os.umask(0)
    os.umask(mask)
    return mask


# --- Further constraints ---


FURTHER = {
    "separation_spare_min": {
        "starts": [[0.1, 0.5], [0.9, 0.5]],
        "goals": [[0.9, 0.5], [0.1, 0.5]],
        "constraints": [{"type": "separation", "between": ["a", "b"], "distance": 0.3}],
    },
    "tilt_max": {
        "starts": [[0.1, 0.2, 0.3], [0.3, 0.2, 0.3]],
        "goals": [[0.7, 0.2, 0.3], [0.7, 0.4, 0.3]],
        "constraints": [{"type": "upright"}],
        "load": {"shape": "bar", "length": 0.2},
    },
    "height_error_max": {
        "starts": [[0.1, 0.2], [0.3, 0.2]],
        "goals": [[0.7, 0.6], [0.9, 0.6]],
        "constraints": [{"type": "same_height", "between": ["a", "b"]}],
    },
}


@pytest.mark.parametrize("measure", FURTHER)
def test_further_constraints_are_judged_from_the_files_alone(tmp_path, measure):
    case = dict(FURTHER[measure])
    starts, goals = case.pop("starts"), case.pop("goals")
    data = {
        "name": "further",
        "duration": 10.0,
        "workspace": {"lower": [0.0] * len(starts[0]), "upper": [1.0] * len(starts[0])},
        "manipulators": [
            {"name": name, "start": start, "goal": goal}
            for name, start, goal in zip("ab", starts, goals, strict=True)
        ],
        **case,
    }
    scene = Scene.from_dict(data)
    target = written(tmp_path / "result", comove.solve(scene, budget=5.0))
    stored = read_result(target)
    verdict = verify_result(stored, scene)
    assert verdict.reasons == ()
    assert stored.summary[measure] == getattr(verdict.report, measure)
    assert set(stored.summary) & set(FURTHER) == {measure}
    free = Scene.from_dict(data | {"constraints": []})
    assert reasons(target, free)
    edit_summary(target, signed=True, **{measure: stored.summary[measure] + 0.01})
    (told,) = reasons(target, scene)
    assert f"{measure} = " in told


def test_a_motion_without_the_constraint_is_not_taken_for_one_with_it(tmp_path):
    """A bar that turns is stored; its scene is then asked to keep it upright, checksums brought along."""
    starts, goals = [[0.1, 0.2], [0.3, 0.2]], [[0.7, 0.6], [0.9, 0.6]]
    data = {
        "name": "bar",
        "duration": 10.0,
        "workspace": {"lower": [0.0, 0.0], "upper": [1.0, 1.0]},
        "load": {"shape": "bar", "length": 0.2},
        "manipulators": [
            {"name": name, "start": start, "goal": goal}
            for name, start, goal in zip("ab", starts, goals, strict=True)
        ],
    }
    target = written(tmp_path / "result", comove.solve(Scene.from_dict(data), budget=5.0))
    for constraint in ({"type": "upright"}, {"type": "same_height", "between": ["a", "b"]}):
        other = Scene.from_dict(data | {"constraints": [constraint]})
        edit_summary(target, signed=True, scene_sha256=other.sha256)
        assert any("cannot be rebuilt" in reason for reason in reasons(target, other))


def test_edited_measures_of_smoothness_are_rejected(folder):
    stated = json.loads((folder / "solution.json").read_text())["smoothness"]
    for name, value in stated.items():
        for wrong in (value * 1.01 + 1e-3, None, "0.1", True):
            edit_summary(folder, signed=True, smoothness=stated | {name: wrong})
            assert any("smoothness" in reason for reason in reasons(folder)), (name, wrong)
    edit_summary(folder, signed=True, smoothness={})
    assert any("smoothness" in reason for reason in reasons(folder))
    edit_summary(folder, signed=True, smoothness=None)  # as of earlier versions
    assert not reasons(folder)
