"""A robot's part of a result folder gives back what was written, stands alone, and betrays every edit."""

import json
import shutil
import zipfile
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from comove.errors import ResultError, RobotError
from comove.io import arrays as archives
from comove.model import Scene
from comove.results.sealed import checksum, finite
from comove.results.solution import SOLUTION
from comove.robots import JointMotion, verify_joints
from comove.robots.files import JOINTS, read_joints, verified_against, verify_stored
from comove.stored import ResultPart, verify_folder
from tests.cases import examples
from tests.robots.known_carry import (
    baxter,
    hands_motion,
    known_carry,
    on_scene,
    scene_data,
    uncertain_baxter,
)
from tests.robots.known_folder import write, write_forged

KEYS = {"time", "joint_names", "position", "velocity", "acceleration"}


@pytest.fixture(scope="module")
def written(tmp_path_factory):
    return write(tmp_path_factory.mktemp("robot") / "result")


@pytest.fixture
def folder(written, tmp_path):
    """A copy that may be edited."""
    return shutil.copytree(written, tmp_path / "result")


def arrays_of(folder, name="joints.npz"):
    with np.load(folder / name, allow_pickle=False) as archive:
        return dict(archive)


def edit_arrays(folder, **changes):
    np.savez(folder / "joints.npz", **(arrays_of(folder) | changes))


def edit_sample(folder, name, at, value):
    array = arrays_of(folder)[name]
    array[at] += value
    edit_arrays(folder, **{name: array})


def summary_of(folder):
    return json.loads((folder / "robot.json").read_text())


def edit_summary(folder, **changes):
    (folder / "robot.json").write_text(json.dumps(summary_of(folder) | changes))


def sign(folder):
    """Bring all checksums along, as a forger would."""
    edit_summary(folder, joints_sha256=checksum(arrays_of(folder)))
    edit_summary(folder, summary_sha256=JOINTS.seal(summary_of(folder)))


def test_what_was_written_is_read_back_and_verified_alone(folder, tmp_path):
    stored = read_joints(folder)
    joints = known_carry()[1]
    np.testing.assert_array_equal(stored.joints.position, joints.position)
    np.testing.assert_array_equal(stored.arrays["acceleration"], joints.acceleration)
    assert stored.joints.joint_names == joints.joint_names
    verdict = verify_stored(folder)
    assert verdict.reasons == ()
    assert verdict.verified.scene.sha256 == known_carry()[0].scene.sha256
    assert verdict.report.asdict() == verify_joints(baxter(), *known_carry()).report.asdict()


def test_the_archive_holds_the_contracts_arrays_and_nothing_else(folder):
    arrays = arrays_of(folder)
    assert arrays.keys() == KEYS
    assert arrays["time"].shape == (1001,)
    assert arrays["joint_names"].tolist() == list(baxter().joint_names)
    for name in ("position", "velocity", "acceleration"):
        assert arrays[name].shape == (1001, 14)
        assert arrays[name].dtype == float
    np.testing.assert_allclose(np.diff(arrays["time"]), 0.01)


def test_the_summary_names_robot_checksums_and_measures(folder):
    summary, report = summary_of(folder), verify_joints(baxter(), *known_carry()).report
    assert summary["verified"] is True
    assert summary["reasons"] == []
    assert summary["robot"] == summary["robot_file"] == "baxter"
    assert summary["robot_sha256"] == baxter().sha256
    assert summary["scene_sha256"] == known_carry()[0].scene.sha256
    solution = json.loads((folder / "solution.json").read_text())
    assert summary["motion_sha256"] == solution["motion_sha256"]
    measures = {name: finite(value) for name, value in report.asdict().items()}
    assert {name: summary[name] for name in measures} == measures
    assert summary["where"]["velocity_ratio_max"][0] == "left_e1"


def test_a_robots_files_may_stand_in_a_result_folder(folder):
    """The folder can be replaced by another result."""
    write(folder)
    assert verify_stored(folder).verified is not None


def test_a_scene_with_a_demonstration_keeps_its_checksum_without_it(tmp_path):
    (tmp_path / "demo.csv").write_text("time,x,y,z\n0,0,0,0\n1,1,0,0\n2,2,1,0\n")
    scene = Scene.from_dict(scene_data(demonstration={"file": "demo.csv"}), folder=tmp_path)
    write(tmp_path / "result", motion=hands_motion(scene))
    shutil.move(tmp_path / "result", tmp_path / "elsewhere")
    (tmp_path / "demo.csv").unlink()
    assert read_joints(tmp_path / "elsewhere").scene.sha256 == scene.sha256
    assert verify_stored(tmp_path / "elsewhere").verified is not None


def test_an_attempt_that_was_not_verified_is_written_with_its_reasons_and_stays_unverified(tmp_path):
    motion, joints = known_carry(3.0)
    folder = write(tmp_path / "result", motion, joints)
    summary = summary_of(folder)
    assert summary["verified"] is False
    assert any("times as long" in reason for reason in summary["reasons"])
    verdict = verify_stored(folder)
    assert verdict.verified is None
    assert any("does not claim a verified motion" in reason for reason in verdict.reasons)
    assert any("left_e1 moves at" in reason for reason in verdict.reasons)


def test_measures_that_are_not_there_are_null(tmp_path):
    motion, joints = known_carry()
    folder = write(tmp_path / "result", motion, joints.stretched(9.0))
    assert summary_of(folder)["clearance_scene"] is None
    assert verify_stored(folder).verified is None


@pytest.mark.parametrize("name", ["position", "velocity", "acceleration"])
@pytest.mark.parametrize("at", [(500, 3), (0, 0), (1, 6), (1000, 13)])
@pytest.mark.few(2)
def test_an_edited_sample_is_named_even_where_checksums_were_brought_along(folder, name, at):
    edit_sample(folder, name, at, 1e-4)
    sign(folder)
    verdict = verify_stored(folder)
    assert verdict.verified is None
    named = [reason for reason in verdict.reasons if f"'{name}[{at[0]}, {at[1]}]'" in reason]
    assert len(named) == 1
    assert baxter().joint_names[at[1]] in named[0]
    assert not any("checksum" in reason for reason in verdict.reasons)


def test_edits_of_velocity_and_acceleration_that_make_up_for_each_other_are_named(folder):
    """They leave the positions of the cubic where they were."""
    h = arrays_of(folder)["time"][1]
    edit_sample(folder, "velocity", (0, 0), 1e-4)
    edit_sample(folder, "acceleration", (0, 0), -6 * 1e-4 / h)
    sign(folder)
    assert any("[0, 0]' in joints.npz was edited" in reason for reason in verify_stored(folder).reasons)


@examples(10)
@given(
    st.sampled_from(["time", "position", "velocity", "acceleration"]),
    st.integers(0, 1000),
    st.integers(0, 13),
)
def test_the_least_edit_of_any_sample_breaks_a_checksum(written, name, step, joint):
    folder = shutil.copytree(written, written.parent / "edited", dirs_exist_ok=True)
    array = arrays_of(written)[name]
    at = (step,) if name == "time" else (step, joint)
    array[at] = np.nextafter(array[at], 1e9)
    np.savez(folder / "joints.npz", **(arrays_of(written) | {name: array}))
    verdict = verify_stored(folder)
    assert verdict.verified is None
    assert any("joints.npz was edited: its checksum" in reason for reason in verdict.reasons)


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("joint_margin_min", 0.4),
        ("velocity_ratio_max", 0.1),
        ("torque_ratio_max", None),
        ("hand_error_max", 0.0),
        ("clearance_scene", 0.04),
        ("clearance_self", "far"),
        ("load_mass", 0.2),
    ],
)
@pytest.mark.few(3)
def test_an_edited_measure_is_named(folder, name, value):
    edit_summary(folder, **{name: value})
    sign(folder)
    (reason,) = verify_stored(folder).reasons
    assert f"robot.json says {name} = {value}" in reason


@pytest.mark.parametrize(
    ("edit", "told"),
    [
        ({"robot_sha256": "0" * 64}, "is not the robot that was judged"),
        ({"scene_sha256": "0" * 64}, "scene.json was edited"),
        ({"motion_sha256": "0" * 64}, "is not the motion that the joints carry out"),
        ({"verified": False}, "does not claim a verified motion"),
        ({"robot": "hal"}, "robot.json says robot = 'hal', it is judged by baxter"),
        ({"reasons": 5}, "robot.json was edited: reasons: 5 is not a list of texts"),
        ({"uncertainty": {"position": "x"}}, "robot.json says uncertainty = {'position': 'x'}"),
        ({"uncertainty": None}, "robot.json says uncertainty = None"),
        (
            {"uncertainty": {"position": 0.0, "rotation_deg": 0.0, "joints": 0.1}},
            "robot.json says uncertainty =",
        ),
        ({"clearance_deviating": 0.01}, "robot.json says clearance_deviating = 0.01, the motion's is None"),
        ({"mass_shares": "all"}, "robot.json says mass_shares = 'all'"),
        ({"mass_shares": [0.5, 0.5]}, "robot.json says mass_shares = [0.5, 0.5], it is judged by None"),
        ({"joint_margin_min": 10**400}, "robot.json says joint_margin_min"),
        ({"joint_margin_min": True}, "robot.json says joint_margin_min"),
    ],
)
@pytest.mark.few(4)
def test_an_edited_field_is_named(folder, edit, told):
    edit_summary(folder, **edit)
    sign(folder)
    verdict = verify_stored(folder)
    assert verdict.verified is None
    assert any(told in reason for reason in verdict.reasons)


LOOSER = [
    {"uncertainty": {"position": 0.0, "rotation_deg": 0.0}},
    {"uncertainty": {}},
    {"mass_shares": [0.0, 1.0]},
    {"verified": True, "reasons": []},
    {"where": {}},
    {"load_mass": 0.0, "hand_uncertainty": 0.0},
    {"robot_file": "/tmp/looser.yaml"},
    {"robot": "two_pandas"},
    {"version": "99"},
]


@pytest.mark.parametrize("edit", LOOSER, ids=str)
@pytest.mark.few(4)
def test_nothing_that_the_folder_says_loosens_the_check(folder, edit):
    """The folder was judged on bases that are known exactly, and says so; the description knows better."""
    unsure = uncertain_baxter(position=0.05)
    assert any("clearance" in reason for reason in verify_joints(unsure, *known_carry()).reasons)
    edit_summary(folder, robot_sha256=unsure.sha256, **edit)
    sign(folder)
    verdict = verify_stored(folder, unsure)
    assert verdict.verified is None
    assert verdict.report.hand_uncertainty == pytest.approx(0.05)


def test_a_looser_scene_in_the_folder_is_told(folder):
    scene = known_carry()[0].scene
    data = json.loads((folder / "scene.json").read_text())
    data["obstacles"] = []
    (folder / "scene.json").write_text(json.dumps(data))
    looser = read_joints(folder).scene
    edit_summary(folder, scene_sha256=looser.sha256)
    sign(folder)
    solution = json.loads((folder / "solution.json").read_text()) | {"scene_sha256": looser.sha256}
    solution["summary_sha256"] = SOLUTION.seal(solution)
    (folder / "solution.json").write_text(json.dumps(solution))
    reasons = verify_stored(folder, scene=scene).reasons
    assert any("scene.json is not the scene that it is judged on" in reason for reason in reasons)


def test_an_edited_summary_or_scene_or_motion_is_told(folder):
    edit_summary(folder, version="9")
    (reason,) = verify_stored(folder).reasons
    assert "robot.json was edited: its own checksum does not fit" in reason
    scene = json.loads((folder / "scene.json").read_text())
    scene["obstacles"][1]["radius"] = 0.029
    (folder / "scene.json").write_text(json.dumps(scene))
    assert any("scene.json was edited" in reason for reason in verify_stored(folder).reasons)


def test_another_motion_of_the_hands_is_told(folder, tmp_path):
    motion, _ = known_carry()
    other = replace(motion, weights=motion.weights * 0.999)
    write(tmp_path / "other", other)
    for name in ("solution.npz", "solution.json"):
        shutil.copy(tmp_path / "other" / name, folder / name)
    reasons = verify_stored(folder).reasons
    assert any("solution.npz is not the motion that the joints carry out" in reason for reason in reasons)
    assert any("off the load" in reason for reason in reasons)


def test_an_edited_motion_of_the_hands_is_told_once(folder):
    arrays = arrays_of(folder, "solution.npz")
    arrays["weights"][0, 0] += 0.5
    np.savez(folder / "solution.npz", **arrays)
    reasons = verify_stored(folder).reasons
    assert any("solution.npz was edited" in reason for reason in reasons)
    assert len(set(reasons)) == len(reasons)


@pytest.mark.parametrize(
    ("changes", "told"),
    [
        ({"position": np.zeros(3)}, "'position' in joints.npz was edited: it holds float64 of shape (3,)"),
        ({"position": np.zeros((1001, 14), dtype=complex)}, "complex128"),
        ({"velocity": np.zeros((1000, 14))}, "'velocity' in joints.npz was edited"),
        ({"time": np.arange(1001)}, "'time' in joints.npz was edited: it holds int64"),
        ({"time": np.zeros(1001)}, "does not come after"),
        ({"joint_names": np.arange(14)}, "'joint_names' in joints.npz was edited"),
        ({"joint_names": np.array(["a"] * 14)}, "in this order"),
        ({"position": np.full((1001, 14), np.nan)}, "position[0, 0] is nan"),
        ({"velocity": np.full((1001, 14), np.nan)}, "'velocity[0, 0]'"),
        ({"position": np.full((1001, 14), 1e200)}, "position[0, 0] is 1e+200"),
    ],
)
@pytest.mark.few(4)
def test_arrays_that_are_no_joint_motion_are_told_in_words(folder, changes, told):
    edit_arrays(folder, **changes)
    verdict = verify_stored(folder)
    assert verdict.verified is None
    assert any(told in reason for reason in verdict.reasons)


@pytest.mark.parametrize("name", ["joints.npz", "robot.json", "scene.json", "solution.npz", "solution.json"])
@pytest.mark.parametrize("damage", ["missing", "empty", "cut", "garbage", "folder"])
def test_damaged_files_are_told_in_one_sentence_with_a_way_out(folder, name, damage):
    path = folder / name
    whole = path.read_bytes()
    path.unlink()
    if damage == "folder":
        path.mkdir()
    elif damage != "missing":
        path.write_bytes(
            {"empty": b"", "cut": whole[: len(whole) // 2], "garbage": b"\x00\xff{[" * 99}[damage]
        )
    with pytest.raises(ResultError) as told:
        verify_stored(folder)
    assert str(folder) in str(told.value)
    assert "\n" not in str(told.value)
    assert told.value.way_out


@pytest.mark.parametrize(
    ("name", "text", "told"),
    [
        ("robot.json", "[]", "no JSON object"),
        ("robot.json", '{"verified": NaN}', "it holds NaN"),
        ("robot.json", "[" * 100_000, "cannot be read"),
        ("scene.json", "{}", "name"),
        ("scene.json", '{"name": "x", "duration": -1}', "duration"),
    ],
)
def test_texts_that_are_no_summary_or_scene_are_refused(folder, name, text, told):
    (folder / name).write_text(text)
    with pytest.raises(ResultError, match=told):
        verify_stored(folder)


def test_huge_files_are_refused_before_they_are_read(folder, monkeypatch):
    with open(folder / "scene.json", "ab") as file:
        file.truncate(2**25)
    with pytest.raises(ResultError, match="larger than 16 MB"):
        read_joints(folder)
    shutil.copy(folder / "robot.json", folder / "scene.json")
    monkeypatch.setattr(archives, "MAX_BYTES", 1000)
    with pytest.raises(ResultError, match=r"joints\.npz"):
        read_joints(folder)


def test_objects_are_never_unpickled(folder):
    with zipfile.ZipFile(folder / "joints.npz", "a"):
        pass
    edit_arrays(folder, position=np.array([[{}]], dtype=object))
    with pytest.raises(ResultError, match="pickled objects"):
        verify_stored(folder)


def test_a_robot_that_is_not_here_can_be_given(tmp_path):
    scene = Scene.from_dict({key: value for key, value in scene_data().items() if key != "robot"})
    folder = write(tmp_path / "result", on_scene(known_carry()[0], scene))
    assert verify_stored(folder).verified is not None, (
        "its own scene names none, and robot.json a bundled one"
    )
    edit_summary(folder, robot_file="/nowhere/robot.yaml")
    sign(folder)
    with pytest.raises(ResultError, match=r"robot\.json: robot_file: .*there is no robot"):
        verify_stored(folder)
    assert verify_stored(folder, baxter()).verified is not None
    edit_summary(folder, robot_file=None)
    sign(folder)
    with pytest.raises(ResultError, match="does not say where"):
        verify_stored(folder)
    weaker = replace(baxter(), sha256="1" * 64)
    assert any(
        "is not the robot that was judged" in reason for reason in verify_stored(folder, weaker).reasons
    )


def test_what_robot_json_names_does_not_verify_the_joints_of_a_robot_that_the_scene_names(tmp_path):
    """A forger's description with limits far beyond Baxter's would find nothing wrong with the joints."""
    folder = write_forged(tmp_path / "result")
    assert summary_of(folder)["verified"] is True
    verdict = verify_stored(folder)
    assert verdict.verified is None
    assert any("left_e1 moves at" in reason for reason in verdict.reasons)
    with pytest.raises(ResultError, match="its motion is not verified"):
        verified_against(folder)


def test_beside_a_trusted_scene_without_a_robot_only_a_bundled_one_or_a_given_one_verifies(tmp_path):
    scene = Scene.from_dict({key: value for key, value in scene_data(3.0).items() if key != "robot"})
    folder = write_forged(tmp_path / "result", scene)
    with pytest.raises(RobotError, match="neither the scene nor the command names a robot"):
        verify_stored(folder, scene=scene)
    assert verify_stored(folder, baxter(), scene=scene).verified is None
    (own,) = (part for part in verify_folder(folder) if part.part is ResultPart.JOINTS)
    assert own.verified and any("that the folder names" in words for words in own.against)


def test_a_folder_that_is_none_of_a_robot_is_told(tmp_path):
    with pytest.raises(ResultError, match="no such folder"):
        read_joints(tmp_path / "nothing")
    with pytest.raises(ResultError, match=r"holds no robot\.json"):
        read_joints(tmp_path)


def test_samples_of_any_rate_rebuild_the_same_curve(tmp_path):
    motion, _ = known_carry()
    joints = known_carry(rate=50.0)[1]
    folder = write(tmp_path / "result", motion, joints)
    time = np.linspace(0.0, 10.0, 999)
    again = read_joints(folder).joints
    assert isinstance(again, JointMotion)
    np.testing.assert_array_equal(again.curve(time), joints.curve(time))
