"""Verbs with a robot as a user runs them: from a scene to files that a robot plays, and what is refused."""

import json
import re
import shutil
from pathlib import Path

import numpy as np
import pytest
import yaml

from comove.cli import export
from comove.errors import RobotError
from comove.lab.examples import example_path
from comove.model import Scene
from comove.robots import Robot, read_joints
from comove.robots import description as descriptions
from comove.robots.kernels import TWO_ARMS
from comove.ros import FORMATS
from tests.commands import invoke
from tests.robots.raw_links import RawLinks
from tests.robots.small_robots import SHELF, lifts, lifts_scene
from tests.sim.test_mjcf import ARM

EXAMPLES = Path(__file__).parents[2] / "examples"
SCENE = EXAMPLES / "baxter" / "gap_30.yaml"


def text_of(result):
    """All that was said; no traceback."""
    assert result.exception is None or isinstance(result.exception, SystemExit), result.exception
    return result.output + (result.stderr if result.stderr_bytes else "")


@pytest.fixture(scope="module")
def solved(tmp_path_factory):
    folder = tmp_path_factory.mktemp("robot") / "result"
    result = invoke("solve", SCENE, "--out", folder)
    assert result.exit_code == 0, text_of(result)
    return folder


@pytest.fixture
def copy(solved, tmp_path):
    return Path(shutil.copytree(solved, tmp_path / "copy"))


def scene_with(tmp_path, **changes):
    """The example with other keys; None takes a key away."""
    data = yaml.safe_load(SCENE.read_text(encoding="utf-8")) | changes
    path = tmp_path / "scene.yaml"
    path.write_text(
        yaml.safe_dump({key: value for key, value in data.items() if value is not None}), encoding="utf-8"
    )
    return path


def test_a_solved_folder_holds_what_the_contract_says(solved):
    names = {path.name for path in solved.iterdir()}
    assert names == {
        "solution.npz", "solution.json", "motion.png", "progress.png",
        "joints.npz", "robot.json", "scene.json", "joints.png", "inputs", "inputs.json",
    }  # fmt: skip
    with np.load(solved / "joints.npz", allow_pickle=False) as joints:
        assert set(joints) == {"time", "joint_names", "position", "velocity", "acceleration"}
        time, position = joints["time"], joints["position"]
        assert np.allclose(np.diff(time), 0.01) and time[0] == 0.0 and time[-1] == 10.0
        assert position.shape == joints["velocity"].shape == joints["acceleration"].shape == (1001, 14)
    summary = json.loads((solved / "solution.json").read_text())
    assert summary["verified"] is True and json.loads((solved / "robot.json").read_text())["verified"] is True


def test_the_hands_carry_the_stick(solved):
    """By Baxter's own URDF, and the stick of the file."""
    with np.load(solved / "joints.npz") as joints, np.load(solved / "solution.npz") as hands:
        names, position = [str(name) for name in joints["joint_names"]], joints["position"]
        at = [np.array([np.interp(t, hands["time"], p) for p in hands["position"].reshape(-1, 6).T])
              for t in joints["time"][::100]]  # fmt: skip
    raw = RawLinks(Robot.load("baxter"))
    assert names == list(Robot.load("baxter").joint_names)
    for row, expected in zip(position[::100], at, strict=True):
        poses = [raw.frame(f"{side}_gripper", row) for side in ("left", "right")]
        found = np.array([pose.translation for pose in poses])
        assert np.abs(found.ravel() - expected).max() < 1e-6
        along = found[0] - found[1]
        assert abs(np.linalg.norm(along) - 0.6) < 1e-6
        yaw = np.arctan2(along[1], along[0])
        down = np.array([[-np.cos(yaw), -np.sin(yaw), 0], [-np.sin(yaw), np.cos(yaw), 0], [0, 0, -1]])
        assert all(np.abs(pose.rotation - down).max() < 1e-6 for pose in poses)


def edited(folder, **changes):
    """Edit robot.json, and bring its checksum along."""
    from comove.robots.files import JOINTS

    summary = json.loads((folder / "robot.json").read_text()) | changes
    summary["summary_sha256"] = JOINTS.seal(summary)
    (folder / "robot.json").write_text(json.dumps(summary))


def test_the_robot_is_the_scenes_or_the_commands_whatever_the_folder_says(copy, tmp_path):
    looser = yaml.safe_load((descriptions.BUNDLED / "baxter.yaml").read_text(encoding="utf-8"))
    looser["springs"] = dict.fromkeys(looser.get("springs", {}), 0.9)
    (tmp_path / "looser.yaml").write_text(yaml.safe_dump(looser))
    edited(copy, robot_file=str(tmp_path / "looser.yaml"))
    assert invoke("verify", SCENE, copy).exit_code == 0  # by the scene's own
    edited(copy, robot_sha256=Robot.load(tmp_path / "looser.yaml").sha256)
    rejected = invoke("verify", SCENE, copy)
    assert rejected.exit_code == 1
    assert "is not the robot that was judged" in rejected.stderr


@pytest.mark.slow
def test_a_folder_cannot_bring_a_robot_of_its_own(copy, tmp_path):
    """The scene names none: a bundled one may be named by the folder, another by the command alone."""
    nameless = scene_with(tmp_path, robot=None)
    out = tmp_path / "out"
    assert invoke("solve", nameless, "--out", out, "--robot", "baxter").exit_code == 0
    assert invoke("verify", nameless, out).exit_code == 0
    shutil.copy(descriptions.BUNDLED / "baxter.yaml", tmp_path / "mine.yaml")
    edited(out, robot_file=str(tmp_path / "mine.yaml"))
    refused = invoke("verify", nameless, out)
    assert refused.exit_code == 2
    assert "neither the scene nor the command names a robot" in refused.stderr
    assert invoke("verify", nameless, out, "--robot", "baxter").exit_code == 0


def test_verify_says_where_no_joints_were_judged(copy):
    for name in ("robot.json", "joints.npz", "scene.json", "joints.png"):
        (copy / name).unlink()
    result = invoke("verify", SCENE, copy)
    assert result.exit_code == 0
    assert "the hands alone" in result.stdout


@pytest.mark.parametrize(
    "changes",
    [{"clearance_load": "x"}, {"robot": 5}, {"reasons": 5}, {"verified": "yes"}, {"joint_margin_min": []}],
)
def test_show_refuses_entries_that_are_none(copy, changes):
    edited(copy, **changes)
    shown = invoke("show", copy)
    assert shown.exit_code == 2 and shown.stdout == ""
    assert shown.stderr.startswith(f"error: {copy}/robot.json: {next(iter(changes))}: ")


def test_show_tells_an_edit(copy):
    edited(copy, load_mass=0.3)
    shown = invoke("show", copy)  # well signed, and verified nevertheless
    assert shown.exit_code == 1 and "NOT VERIFIED" in shown.stdout
    assert invoke("verify", SCENE, copy).exit_code == 1
    summary = json.loads((copy / "robot.json").read_text()) | {"load_mass": 0.2}
    (copy / "robot.json").write_text(json.dumps(summary))
    assert "was edited" in invoke("show", copy).stderr


def test_verify_and_show_speak_of_the_robot(solved):
    result = invoke("verify", SCENE, solved)
    assert result.exit_code == 0 and "baxter" in text_of(result)
    assert "share of joint speeds" in text_of(invoke("show", solved))


def test_export_writes_what_it_says_and_nothing_twice(copy):
    result = invoke("export", copy, "--no-transfers")
    assert result.exit_code == 0, text_of(result)
    header, *rows = (copy / "baxter.csv").read_text().splitlines()
    assert header.split(",")[:3] == ["time", "left_s0", "left_s1"] and header.count(",") == 16
    assert len(rows) == 1001
    again = invoke("export", copy, "--no-transfers")
    assert again.exit_code == 2 and "baxter.csv" in text_of(again)
    assert invoke("solve", SCENE, "--out", copy, "--budget", "0").exit_code == 2
    assert (copy / "baxter.csv").is_file()


def test_without_motions_from_home_the_carry_alone_is_exported(copy, monkeypatch):
    none = dict.fromkeys(("start", "goal"), RobotError("home and the load touch", way_out="move home"))
    monkeypatch.setattr("comove.robots.transfers.possible_transfers", lambda *_, **__: (None, none))
    asked = invoke("export", copy, "--transfers")
    assert asked.exit_code == 2 and not (copy / "baxter.csv").exists()
    result = invoke("export", copy)
    assert result.exit_code == 0, text_of(result)
    assert "the carry alone" in result.stderr and "home and the load touch" in result.stderr
    assert (copy / "baxter.csv").is_file() and not (copy / "approach.csv").exists()


@pytest.fixture
def under_a_shelf(tmp_path):
    """A scene in which the joints with the least turns cannot be approached, and where the robot is."""
    lifts(tmp_path)
    data = lifts_scene((SHELF,), robot="robot.yaml").file.model_dump(mode="json", exclude_none=True)
    (tmp_path / "scene.yaml").write_text(json.dumps(data), encoding="utf-8")
    machine = Robot.load(tmp_path / "robot.yaml")
    present = dict(zip(machine.joint_names, (machine.home + 0.1).tolist(), strict=True))
    (tmp_path / "joints.yaml").write_text(json.dumps(present), encoding="utf-8")
    return tmp_path / "scene.yaml", tmp_path / "joints.yaml", present


@pytest.mark.slow
def test_what_export_advises_leads_to_approach_and_release(under_a_shelf, tmp_path):
    scene, joints, present = under_a_shelf
    assert invoke("solve", scene, "--out", tmp_path / "carry").exit_code == 0
    refused = invoke("export", tmp_path / "carry", "--transfers")
    assert refused.exit_code == 2 and "solve the scene with --approach" in text_of(refused)
    assert not list((tmp_path / "carry").glob("motion*.csv"))
    alone = invoke("export", tmp_path / "carry")
    assert alone.exit_code == 0 and "one of approach and release is missing: " in alone.stderr
    assert (tmp_path / "carry" / "motion_release.csv").is_file()

    found = invoke("solve", scene, "--approach", "--present", joints, "--out", tmp_path / "both")
    assert found.exit_code == 0 and re.search(r"approach +\S+ s, from the present joints", text_of(found))
    assert json.loads((tmp_path / "both" / "robot.json").read_text())["present"] == present
    words = json.loads((tmp_path / "both" / "inputs.json").read_text())["command"]
    kept = tmp_path / "both" / words[words.index("--present") + 1]
    assert json.loads(kept.read_text()) == present and "--approach" in words
    written = invoke("export", tmp_path / "both", "--transfers")
    assert written.exit_code == 0, text_of(written)
    header, first, *_ = (tmp_path / "both" / "motion_approach.csv").read_text().splitlines()
    values = dict(zip(header.split(","), map(float, first.split(",")), strict=True))
    assert all(abs(values[f"{name}.position"] - value) < 1e-9 for name, value in present.items())
    assert invoke("verify", scene, tmp_path / "both").exit_code == 0


@pytest.mark.parametrize(
    ("changes", "told"),
    [
        ({"left_elbow_joint": 45}, r"joints.yaml: present.left_elbow_joint: it is 45 rad, .*degrees, it seems"),
        ({"finger": 0.1}, r"joints.yaml: present: 'small' has no joint 'finger'"),
        ({"left_shoulder_joint": -1.2, "left_elbow_joint": 0, "right_shoulder_joint": 1.2,
          "right_elbow_joint": 0}, r"joints.yaml: present: at the present joints, .* are in each other"),
    ],
)  # fmt: skip
def test_present_joints_that_cannot_be_are_refused_before_anything_is_written(
    under_a_shelf, tmp_path, changes, told
):
    scene, joints, present = under_a_shelf
    joints.write_text(json.dumps(present | changes))
    result = invoke("solve", scene, "--present", joints, "--out", tmp_path / "out")
    assert result.exit_code == 2 and re.search(told, " ".join(text_of(result).split()))
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        (
            ("solve", "{scene}", "--hands-alone", "--approach", "--out", "{out}"),
            "--approach: no robot's joints",
        ),
        (("export", "{out}", "--no-transfers", "--approach"), "--approach: --transfers is both"),
        (
            ("export", "{out}", "--release", "--present", "{scene}"),
            "--present: no approach is asked for",
        ),
        (("send", "{out}", "--present", "{scene}"), "--present: no approach is asked for"),
    ],
)
def test_options_of_approaches_that_contradict_each_other_are_refused(
    under_a_shelf, tmp_path, arguments, told
):
    named = {"scene": under_a_shelf[0], "out": tmp_path / "out"}
    result = invoke(*(word.format(**named) for word in arguments))
    assert result.exit_code == 2 and told in text_of(result)


def test_the_formats_that_the_help_names_are_those_there_are():
    assert tuple(FORMATS) == export.FORMATS


@pytest.mark.parametrize(
    ("arguments", "word"),
    [(["--rate", "5"], "20 Hz or more"), (["--format", "npz"], "motion_release.npz: it is there already")],
)
def test_what_cannot_be_exported_is_told_before_ways_are_planned(copy, monkeypatch, arguments, word):
    planned = "comove.robots.transfers.possible_transfers"
    monkeypatch.setattr(planned, lambda *_, **__: pytest.fail("it was planned"))
    (copy / "motion_release.npz").write_text("of somebody else")
    result = invoke("export", copy, *arguments)
    assert result.exit_code == 2 and word in text_of(result)


def test_simulate_delivers(copy):
    result = invoke("simulate", copy, "--no-pictures")
    assert result.exit_code == 0, text_of(result)
    summary = json.loads((copy / "simulation.json").read_text())
    assert summary["delivered"] is True and not summary["contacts"]
    assert result.stdout.strip() in invoke("show", copy).stdout
    summary["lag_max"] = 0.0
    (copy / "simulation.json").write_text(json.dumps(summary))
    assert "its own checksum does not fit" in text_of(invoke("show", copy))


@pytest.mark.parametrize("name", ["joints.npz", "robot.json", "scene.json", "solution.npz"])
@pytest.mark.few(2)
def test_an_edited_folder_is_refused_everywhere(copy, name):
    path = copy / name
    if name.endswith("npz"):
        with np.load(path) as arrays:
            data = dict(arrays)
        data["position"] = data["position"].copy()
        data["position"][500] += 1e-3
        np.savez(path, **data)
    else:
        path.write_text(path.read_text().replace("0.25", "0.26", 1))  # the load's mass
    for verb in (["export", copy], ["simulate", copy], ["send", copy]):
        result = invoke(*verb)
        assert result.exit_code == 2 and "not verified" in text_of(result), (verb, text_of(result))
    assert invoke("verify", SCENE, copy).exit_code == 1


def test_what_to_do_is_told_once(copy):
    with np.load(copy / "joints.npz") as arrays:
        data = dict(arrays)
    np.savez(copy / "joints.npz", **data | {"position": data["position"][:, :13]})
    assert invoke("export", copy).stderr.count("solve the scene again") == 1


@pytest.mark.slow
def test_a_duration_that_is_too_short_is_told_with_one_that_is_not(tmp_path):
    scene = scene_with(tmp_path, duration=1.0, limits={"speed": 5.0})
    result = invoke("solve", scene, "--out", tmp_path / "out", "--budget", 8)
    assert result.exit_code == 1, text_of(result)
    needed = re.search(r"(\S+) s would do", text_of(result))[1]
    again = invoke("solve", scene, "--out", tmp_path / "again", "--budget", 20, "--duration", needed)
    assert again.exit_code == 0, text_of(again)
    assert json.loads((tmp_path / "out" / "solution.json").read_text())["verified"] is False
    exported = invoke("export", tmp_path / "out")
    assert exported.exit_code == 2 and "not verified" in text_of(exported)


@pytest.mark.slow
def test_a_duration_left_out_is_as_short_as_joints_and_hands_allow(tmp_path):
    scene = scene_with(tmp_path, duration=None, limits={"speed": 5.0, "acceleration": 20.0, "jerk": 500.0})
    result = invoke("solve", scene, "--out", tmp_path / "out", "--budget", 10)
    assert result.exit_code == 0, text_of(result)
    report = read_joints(tmp_path / "out").summary
    used = [report[f"{what}_ratio_max"] for what in ("velocity", "acceleration", "torque")]
    assert 0.95 < max(used) <= 1.0  # the joints bind, as the hands may be as fast as they like


FAR = [{"name": "left", "start": [1.6, 0.5, 0.05], "goal": [0.772, -0.108, 0.05]},
       {"name": "right", "start": [1.6, -0.1, 0.05], "goal": [0.348, -0.532, 0.05]}]  # fmt: skip
THIRD = [{"name": "left", "start": [0.772, 0.552, 0.05], "goal": [0.772, -0.108, 0.05]},
         {"name": "third", "start": [0.348, 0.128, 0.05], "goal": [0.348, -0.532, 0.05]}]  # fmt: skip
WIDE = {"lower": [0.0, -1.5, -0.1], "upper": [2.0, 1.5, 0.12]}
LONG = [{"name": "left", "start": [0.6, 0.9, 0.05], "goal": [0.6, 0.8, 0.05]},
        {"name": "right", "start": [0.6, -0.9, 0.05], "goal": [0.6, -1.0, 0.05]}]  # fmt: skip


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"robot": "baxxter"}, ["scene.yaml: robot:", "baxxter", "baxter"]),
        ({"manipulators": THIRD}, ["scene.yaml: manipulators:", "no arm 'third'", "known: left, right"]),
        ({"grasp": None}, ["grasp", "orientation: down"]),
        ({"manipulators": FAR, "workspace": WIDE, "obstacles": []}, ["left", "start", "missing"]),
        ({"manipulators": LONG, "workspace": WIDE, "obstacles": [],
          "load": {"shape": "bar", "length": 1.8, "radius": 0.01}}, ["cannot reach", "missing"]),
        ({"robot": "two_pandas", "manipulators": None}, ["manipulators"]),
    ],
)  # fmt: skip
def test_bad_input_is_one_sentence_and_writes_nothing(tmp_path, changes, words):
    result = invoke("solve", scene_with(tmp_path, **changes), "--out", tmp_path / "out")
    assert result.exit_code == 2, text_of(result)
    assert not (tmp_path / "out").exists()
    for word in words:
        assert word in text_of(result)
    assert "Traceback" not in text_of(result)


@pytest.mark.parametrize(
    ("arguments", "word"),
    [
        (["export", "nowhere"], "nowhere"),
        (["simulate", "nowhere"], "nowhere"),
        (["export", ".", "--format", "rosbag"], "rosbag1"),
        (["simulate", ".", "--grasp", "weldd"], "weld"),
        (["send", ".", "--part", "cary"], "carry"),
        (["send", ".", "--timeout", "0"], "--timeout: 0.0 is not possible"),
        (["send", ".", "--start-tolerance", "-1"], "--start-tolerance: -1.0 is not possible"),
        (["send", ".", "--path-tolerance", "nan"], "--path-tolerance: nan is not possible"),
        (
            ["solve", SCENE, "--out", "never", "--method", "printed"],
            "--method: the method 'printed' moves hands",
        ),
        (["solve", SCENE, "--out", "never", "--method", "paper"], "method: free hands"),
        (["solve", SCENE, "--out", "never", "--library", "nowhere"], "none of the 0 movements"),
        (["solve", SCENE, "--out", "never", "--robot", "baxxter"], "--robot: there is no robot 'baxxter'"),
    ],
)
def test_wrong_words_on_the_command_line(arguments, word):
    result = invoke("robot", *arguments)
    assert result.exit_code == 2 and word in text_of(result)


@pytest.mark.slow
@pytest.mark.parametrize("passage", ["wide", "narrow"])
def test_the_papers_pipeline_with_a_robot(passage, tmp_path):
    """Movements of a library combined for one hand, given to both, optimised for arms that follow, simulated."""
    for shape in ("Sine", "CShape", "Line"):
        result = invoke("library", "add", f"lasa:{shape}", "--folder", tmp_path / "library")
        assert result.exit_code == 0, text_of(result)
    result = invoke(
        *("solve", example_path(f"baxter_{passage}"), "--out", tmp_path / "arms", "--budget", 60),
        *("--method", "paper", "--library", tmp_path / "library", "--weights", "1,0.2,10"),
    )
    assert result.exit_code == 0, text_of(result)
    assert "a combination of" in text_of(result)
    summary = json.loads((tmp_path / "arms" / "solution.json").read_text())
    assert summary["verified"] and summary["method"] == "paper"
    assert invoke("verify", tmp_path / "arms" / "scene.json", tmp_path / "arms").exit_code == 0
    assert invoke("simulate", tmp_path / "arms").exit_code == 0


def test_a_robot_that_is_not_there(solved, monkeypatch):
    monkeypatch.setenv("ROS_MASTER_URI", "http://127.0.0.1:1")
    result = invoke("send", solved, "--timeout", "1")
    assert result.exit_code == 2 and "ros" in text_of(result).lower()


XARM = "package://xarm_description/urdf/xarm7.urdf"


@pytest.mark.slow
def test_a_description_from_a_model_is_written_checked_and_drawn(tmp_path):
    file = tmp_path / "xarms.yaml"
    made = invoke("robot", "new", XARM, XARM, "--out", file, pictures=True)
    assert made.exit_code == 0, text_of(made)
    assert "to be checked" in made.output
    assert Robot.load(file).joint_names[0].startswith("left_")
    assert (tmp_path / "xarms.png").stat().st_size > 10_000
    before = file.read_bytes()
    checked = invoke("robot", "check", file, "--out", tmp_path / "other.png")
    assert checked.exit_code == 0
    assert "in reach of the other's" in checked.output
    assert (tmp_path / "other.png").is_file()
    again = invoke("robot", "new", XARM, "--out", file)
    assert again.exit_code == 2
    assert "already" in text_of(again)
    assert file.read_bytes() == before


def test_a_model_of_mujocos_is_written_as_a_urdf_and_never_over_files(tmp_path):
    model = tmp_path / "arm.xml"
    model.write_text(ARM, encoding="utf-8")
    refused = invoke("robot", "new", model, "--out", tmp_path / "arm.yaml")
    assert refused.exit_code == 2
    assert "comove robot convert" in text_of(refused)
    made = invoke("robot", "convert", model, "--out", tmp_path / "arm")
    assert made.exit_code == 0, text_of(made)
    before = {path.name: path.read_bytes() for path in (tmp_path / "arm").rglob("*") if path.is_file()}
    assert set(before) == {"arm.urdf", "arm.srdf", "wedge.stl", "arm-obstacles.yaml"}
    again = invoke("robot", "convert", model, "--out", tmp_path / "arm")
    assert again.exit_code == 2
    assert {
        path.name: path.read_bytes() for path in (tmp_path / "arm").rglob("*") if path.is_file()
    } == before
    assert invoke("robot", "convert", tmp_path / "none.xml", "--out", tmp_path / "none").exit_code == 2
    assert not (tmp_path / "none").exists()
    file = tmp_path / "description.yaml"
    limits = {name: {"velocity": 1.0, "effort": 20.0} for name in ("turn", "lift", "slide", "l", "r")}
    described = {
        "name": "arm",
        "models": [{"urdf": "arm/arm.urdf", "srdf": "arm/arm.srdf"}],
        "arms": {"only": {"tip": "fore"}},
        "limits": limits,
    }
    file.write_text(yaml.safe_dump(described), encoding="utf-8")
    assert set(Robot.load(file).joint_names) == {"turn", "lift", "slide"}


def test_a_first_scene_is_written_and_can_be_solved(tmp_path):
    """It names a description by its way from the scene, wherever the command is run."""
    file, robot = tmp_path / "first" / "scene.yaml", tmp_path / "two.yaml"
    file.parent.mkdir()
    for source in TWO_ARMS.parent.iterdir():
        (tmp_path / source.name.replace("two_arms", "two")).write_bytes(source.read_bytes())
    made = invoke("robot", "scene", robot, "--out", file)
    assert made.exit_code == 0, text_of(made)
    assert Scene.load(file).file.robot == "../two.yaml"
    assert f"comove solve {file}" in made.output
    solved = invoke("solve", file, "--out", tmp_path / "carried", "--budget", "8")
    assert solved.exit_code == 0, text_of(solved)
    before = file.read_bytes()
    again = invoke("robot", "scene", robot, "--out", file)
    assert again.exit_code == 2 and "already" in text_of(again)
    assert file.read_bytes() == before


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("nobody",), "there is no robot 'nobody'"),
        (("baxter", "--out", "nowhere/scene.yaml"), "nowhere"),
        (("baxter", "--seed", "-1"), "seed"),
    ],
)
def test_what_no_first_scene_is_made_for(tmp_path, monkeypatch, arguments, words):
    monkeypatch.chdir(tmp_path)
    said = invoke("robot", "scene", *arguments)
    assert said.exit_code == 2
    assert words in text_of(said)
    assert not list(tmp_path.iterdir())


@pytest.mark.slow
def test_bases_that_stand_in_each_other_are_no_sound_robot(tmp_path):
    made = invoke("robot", "new", XARM, XARM, "--apart", "0.02", "--out", tmp_path / "robot.yaml")
    assert made.exit_code == 1
    assert "NOT SOUND" in made.output
    assert "touch" in made.output


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ((XARM, "--apart", "-1"), "apart"),
        ((XARM, "--apart", "nan"), "apart"),
        ((XARM,) * 5, "5 models"),
        (("nothing.urdf",), "nothing.urdf"),
        (("package://xarm_description/urdf",), "no file"),
        (("package://../secret.urdf",), "package"),
        ((XARM, "--out", "no/folder/robot.yaml"), "no/folder"),
    ],
)
def test_what_is_no_model(arguments, words, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    refused = invoke("robot", "new", *arguments)
    assert refused.exit_code == 2
    assert words in text_of(refused)
    assert not list(tmp_path.iterdir())
