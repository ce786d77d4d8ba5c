"""Every part of a result folder is verified against a trusted scene and robot, or what it is against is said."""

import json
import shutil

import numpy as np
import pytest

from comove.errors import ResultError
from comove.sim import SIMULATION, play, write_simulation
from comove.sim.robot_runs import ROBOT_RUN
from comove.stored import ResultPart, parts_of, verify_folder, verify_part
from tests.commands import invoke
from tests.robots.known_carry import baxter, known_carry
from tests.robots.known_folder import write, write_forged
from tests.robots.known_run import write_known_run


@pytest.fixture(scope="module")
def simulated(tmp_path_factory):
    """The known movement of Baxter with a playback of it."""
    folder = write(tmp_path_factory.mktemp("simulated") / "result")
    motion, joints = known_carry()
    write_simulation(play(joints, baxter(), motion.scene), folder)
    return folder


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """An online run of Baxter in which everything goes as planned."""
    return write_known_run(tmp_path_factory.mktemp("run") / "result")


def reasons_of(folder, part):
    return verify_part(folder, part).reasons


def forge(kind, folder, change, **said):
    """Change arrays of a folder, and bring its checksums along."""
    summary, arrays = kind.read(folder)
    arrays = {name: array.copy() for name, array in arrays.items()}
    change(arrays)
    kind.write(folder, summary | said, arrays)


def test_the_parts_of_a_folder_are_those_of_its_files(simulated, tmp_path):
    assert parts_of(simulated) == (ResultPart.MOTION, ResultPart.JOINTS, ResultPart.SIMULATION)
    hidden = shutil.copytree(simulated, tmp_path / "hidden")
    (hidden / "robot.json").unlink()  # joints that no summary tells of are not passed over
    assert ResultPart.JOINTS in parts_of(hidden)
    with pytest.raises(ResultError, match="no such folder"):
        parts_of(tmp_path / "nowhere")


def test_all_parts_of_an_honest_folder_are_verified(simulated):
    motion, joints, simulation = verify_folder(simulated)
    assert motion.verified and joints.verified and simulation.verified
    assert motion.against[0].startswith("the folder's own scene")
    assert "baxter" in joints.against[-1]
    (trusted, *_) = verify_folder(simulated, known_carry()[0].scene)
    assert not trusted.against[0].startswith("the folder's own scene")


def test_a_simulation_of_another_motion_is_not_this_ones(simulated, tmp_path):
    other = shutil.copytree(simulated, tmp_path / "other")
    motion, joints = known_carry()
    write_simulation(play(joints.stretched(1.5), baxter(), motion.scene), other)
    assert any("of another motion" in reason for reason in reasons_of(other, ResultPart.SIMULATION))


@pytest.mark.parametrize(
    ("change", "said", "why"),
    [
        (lambda a: a["joints"].__iadd__(0.02), {}, "'hands' in simulation.npz"),
        (lambda a: a["commanded"].__iadd__(0.02), {}, "'commanded' in simulation.npz"),
        (lambda a: a["load_pose"][:, 2, 3].__iadd__(0.1), {}, "simulation.json says"),
        (lambda a: a["load_pose"][:, :3, :3].__imul__(2.0), {}, "is no pose"),
        (lambda a: a["time"].__imul__(0.5), {}, "ends before the motion does"),
        (lambda a: a["lag"].__iadd__(0.01), {}, "'lag' in simulation.npz"),
        (lambda a: None, {"end_error": 1e-6, "lag_max": 0.5}, "simulation.json says"),
        (lambda a: None, {"scene_sha256": "f"}, "of another scene"),
    ],
)
def test_a_simulation_that_contradicts_itself_is_told(change, said, why, simulated, tmp_path):
    copy = shutil.copytree(simulated, tmp_path / "copy")
    forge(SIMULATION, copy, change, **said)
    assert any(why in reason for reason in reasons_of(copy, ResultPart.SIMULATION))


def test_an_honest_run_of_a_robot_is_as_it_should_be(run):
    (checked,) = verify_folder(run)
    assert checked.part is ResultPart.ROBOT_RUN and checked.reasons == ()
    done = invoke("verify", run)
    assert (
        done.exit_code == 0 and "at samples" in done.stdout and "verified" not in done.stdout.split("\n")[0]
    )


def through_the_table(arrays):
    """Bend the right arm's shoulder in the middle of the run."""
    swing = 0.6 * np.sin(np.linspace(0.0, np.pi, len(arrays["time"]))) ** 4
    arrays["commanded"][:, 1] += swing
    arrays["measured"][:, 1] += swing


@pytest.mark.parametrize(
    ("change", "why"),
    [
        (through_the_table, "off the load"),
        (lambda a: a["obstacle_center"].__iadd__(0.5), "by the run's own record alone"),
        (lambda a: a["time"].__imul__(10.0), "duration_s"),
        (lambda a: a["time"].__setitem__(3, a["time"][3] + 1e-3), "not evenly spaced"),
        (lambda a: a["driven_off"].__setitem__(slice(None), True), "was as commanded"),
        (lambda a: a["nodes"][:, 0].__iadd__(0.01), "no rigid body"),
        (lambda a: a["load_pose"][40:, :3, 3].__iadd__(0.1), "from where the measured hands hold it"),
        (lambda a: a["measured"].__iadd__(0.6), "from where it was commanded"),
    ],
)
def test_a_run_that_contradicts_scene_and_robot_is_told(change, why, run, tmp_path):
    copy = shutil.copytree(run, tmp_path / "copy")
    forge(ROBOT_RUN, copy, change)
    assert any(why in reason for reason in reasons_of(copy, ResultPart.ROBOT_RUN))


@pytest.mark.parametrize("verb", ["export", "simulate", "send"])
def test_no_verb_uses_joints_that_only_a_forged_description_allows(verb, tmp_path):
    write_forged(tmp_path / "result")
    done = invoke("robot", verb, tmp_path / "result")
    assert done.exit_code == 2 and "not verified" in done.stderr


@pytest.mark.slow
def test_a_report_of_a_forged_robot_says_that_it_is_not_verified(tmp_path):
    write_forged(tmp_path / "result")
    done = invoke("report", tmp_path / "result", "--html", tmp_path / "page.html")
    assert done.exit_code == 1 and "NOT VERIFIED" in done.stdout


def test_options_that_change_a_scene_need_one(simulated, tmp_path):
    done = invoke("verify", simulated, "--clearance", 0.01)
    assert done.exit_code == 2 and "name the scene before the folder" in done.stderr
    done = invoke("verify", simulated, simulated, simulated)
    assert done.exit_code == 2 and "3 paths" in done.stderr


def test_verbs_that_use_joints_say_what_they_are_verified_against_and_take_what_is_trusted(
    simulated, tmp_path
):
    copy = shutil.copytree(simulated, tmp_path / "copy")
    done = invoke("export", copy, "--format", "npz", "--no-transfers")
    assert done.exit_code == 0, done.stderr
    assert "verified against the folder's own scene" in done.stderr and "'baxter'" in done.stderr
    scene = tmp_path / "other.yaml"
    contents = json.loads((copy / "scene.json").read_text())
    contents["obstacles"].append({"shape": "sphere", "center": [0.58, 0.0, 0.1], "radius": 0.05})
    scene.write_text(json.dumps(contents))
    for options in (("--scene", scene), ("--robot", "pr2")):
        done = invoke("export", copy, "--format", "csv", *options)
        assert done.exit_code == 2, done.output


def test_nothing_of_a_folder_is_played_that_does_not_fit(simulated, tmp_path):
    """Broken contacts, poses or joints are told in reasons, and whoever shows the part draws the plan alone."""
    folder = shutil.copytree(simulated, tmp_path / "result")
    summary, arrays = SIMULATION.read(folder)
    (folder / "simulation.json").write_text(json.dumps(summary | {"contacts": [5], "reasons": None}))
    np.savez(folder / "simulation.npz", **(arrays | {"hands": np.zeros(3)}))
    with np.load(folder / "joints.npz") as found:
        np.savez(folder / "joints.npz", **(dict(found) | {"joint_names": np.array(["a", "b"])}))
    _, joints, simulation = verify_folder(folder)
    assert joints.reasons and joints.joints is None
    assert simulation.reasons and simulation.series is None
