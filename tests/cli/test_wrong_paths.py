"""What is named where something else is wanted is said, and the advice works when it is followed to the letter."""

import shlex
import shutil

import pytest

import comove
from comove.errors import ResultError, RobotError, SceneError
from comove.robots import Robot
from tests.commands import invoke
from tests.robots.small_robots import gantry
from tests.solved import EXAMPLES

OF_RESULTS = (["verify"], ["show"], ["report", "--html", "page.html"])
OF_JOINTS = (["export"], ["simulate"], ["send"])


@pytest.fixture(scope="module")
def solved_folder(tmp_path_factory):
    """A folder with a scene and its result."""
    folder = tmp_path_factory.mktemp("paths")
    shutil.copy(EXAMPLES / "narrow.yaml", folder / "a scene.yaml")
    command = ["solve", "a scene.yaml", "--out", "result", "--effort", "quick", "--no-pictures"]
    assert invoke(*command, folder=folder).exit_code == 0
    return folder


@pytest.fixture
def folder(solved_folder, tmp_path):
    """A copy of it."""
    return shutil.copytree(solved_folder, tmp_path / "copy")


def refused(*arguments, folder):
    """The message of a command that refuses a path, in one line."""
    done = invoke(*arguments, folder=folder)
    assert done.exit_code == 2, done.output
    assert not done.stdout
    return " ".join(done.stderr.split())


def advised(message):
    """The command that a message names."""
    return shlex.split(message.rsplit("comove ", 2)[-2].rsplit(" (", 1)[0])


@pytest.mark.parametrize("verb", OF_RESULTS, ids=lambda verb: verb[0])
@pytest.mark.parametrize("scene", ["a scene.yaml", "scenes"])
def test_a_scene_instead_of_a_result_is_solved_first(verb, scene, folder):
    (folder / "scenes").mkdir()
    shutil.copy(folder / "a scene.yaml", folder / "scenes" / "a scene.yaml")
    name, *options = verb
    told = refused(name, scene, *options, folder=folder)
    assert (
        "it is a scene, not a result folder" if "." in scene else "it holds scenes, and no result"
    ) in told
    solve = advised(told)
    assert invoke(*solve, folder=folder).exit_code == 0
    assert invoke(name, solve[-1], *options, folder=folder).exit_code == 0


def test_the_advice_names_a_folder_that_is_not_there(folder):
    (folder / "a scene").mkdir()
    assert advised(refused("verify", "a scene.yaml", folder=folder))[-1] == "a scene-2"


@pytest.mark.parametrize("verb", OF_JOINTS, ids=lambda verb: verb[0])
def test_for_joints_the_scene_is_solved_with_a_robot(verb, folder):
    """The robot that it names, or one that has to be named."""
    scene = folder / "a scene.yaml"
    assert advised(refused(*verb, scene.name, folder=folder))[2:4] == ["--robot", "NAME"]
    scene.write_text(scene.read_text(encoding="utf-8") + "robot: baxter\n", encoding="utf-8")
    assert "--robot" not in advised(refused(*verb, scene.name, folder=folder))


@pytest.mark.parametrize("verb", (*OF_RESULTS, *OF_JOINTS), ids=lambda verb: verb[0])
@pytest.mark.parametrize("file", ["solution.json", "solution.npz", "scene.json"])
def test_a_file_in_a_result_folder_names_the_folder(verb, file, folder):
    name, *options = verb
    told = refused(name, f"result/{file}", *options, folder=folder)
    assert "it is a file in a result folder, not the folder; name the folder: result " in told


@pytest.mark.parametrize("verb", (*OF_RESULTS, *OF_JOINTS), ids=lambda verb: verb[0])
def test_other_files_and_folders_are_no_results(verb, folder):
    name, *options = verb
    (folder / "notes.txt").write_text("hello\n")
    (folder / "empty").mkdir()
    assert "it is a file, not a result folder" in refused(name, "notes.txt", *options, folder=folder)
    assert "it holds no solution.json" in refused(name, "empty", *options, folder=folder)
    assert "there is no such folder" in refused(name, "missing", *options, folder=folder)


@pytest.mark.parametrize("path", ["result", "result/solution.json", "result/solution.npz"])
def test_a_result_instead_of_a_scene_names_its_scene(path, folder):
    told = refused("solve", path, "--out", "other", folder=folder)
    assert "not a scene; name its scene: result/scene.json " in told
    assert "result/scene.json" in refused("run", path, "--out", "other", folder=folder)
    assert "result/scene.json" in refused("verify", path, "result", folder=folder)
    command = ["solve", "result/scene.json", "--out", "other", "--effort", "quick", "--no-pictures"]
    assert invoke(*command, folder=folder).exit_code == 0


def test_other_files_are_no_scenes(folder):
    (folder / "carry.csv").write_text("time,x,y\n0,0,0\n1,1,1\n")
    told = refused("solve", "carry.csv", "--out", "other", folder=folder)
    assert "it is a file, not a scene; name a scene (YAML); known: a scene.yaml" in told
    (folder / "study.yaml").write_text("name: some\nscene: a scene.yaml\nepisodes: 2\n")
    assert "it is a study, not a scene; name its scene: a scene.yaml " in refused(
        "solve", "study.yaml", "--out", "other", folder=folder
    )
    told = refused("generate", "a scene.yaml", "--out", "episodes", folder=folder)
    assert "it is a scene, not a study; write a study of it" in told


def test_a_mistake_in_a_scene_is_told_as_such_wherever_the_scene_is(folder):
    scene = folder / "result" / "scene.yaml"
    text = (folder / "a scene.yaml").read_text(encoding="utf-8")
    scene.write_text(text.replace("workspace:", "colour: red\nworkspace:"), encoding="utf-8")
    assert "unknown key 'colour'" in refused("solve", "result/scene.yaml", "--out", "other", folder=folder)


def test_a_mistake_in_a_scene_of_any_name_is_told_as_such(folder):
    text = (folder / "a scene.yaml").read_text(encoding="utf-8")
    unnamed = folder / "scene.txt"
    unnamed.write_text(text.replace("workspace:", "workspce:"), encoding="utf-8")
    assert "did you mean 'workspace'?" in refused("solve", "scene.txt", "--out", "other", folder=folder)


def test_scenes_and_robots_are_not_mistaken_for_each_other(folder, tmp_path):
    description = gantry(tmp_path)
    with pytest.raises(
        SceneError, match="it is the description of a robot, not a scene; make a scene for it"
    ):
        comove.Scene.load(description)
    scene = folder / "a scene.yaml"
    with pytest.raises(RobotError, match="it is a scene, not the description of a robot; name a robot"):
        Robot.load(scene)
    scene.write_text(scene.read_text(encoding="utf-8") + "robot: baxter\n", encoding="utf-8")
    with pytest.raises(RobotError, match="name its robot: baxter"):
        Robot.load(scene)


def test_the_library_says_the_same_as_the_command(folder):
    with pytest.raises(ResultError, match=r"it is a scene, not a result folder; solve it.*comove solve"):
        comove.verify(folder / "a scene.yaml")
