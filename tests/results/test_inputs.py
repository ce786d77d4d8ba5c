"""A result folder is whole: it can be moved, looked at, judged, and its command makes the same motion again."""

import json
import shlex
import shutil
from pathlib import Path

import numpy as np
import pytest

import comove
from comove.data import StudyStore
from comove.data.episode import unpacked
from comove.data.runs import RUNS
from comove.io.folders import check_target
from comove.lab.examples import example_path
from comove.results import RESULT
from comove.results.inputs import command_again, write_inputs
from comove.view.figures import save_result
from comove.view.workbench.edits import Draft, contents_of
from comove.view.workbench.protocol import SearchTimes
from comove.view.workbench.teaching import Stroke
from comove.view.workbench.worker import RunMailbox, Worker
from tests.commands import invoke
from tests.robots.small_robots import gantry, gantry_scene
from tests.solved import solved

ROOT = Path(__file__).parents[2]
PLAIN = """\
name: plain
duration: 4
workspace: {lower: [0, 0], upper: [1, 1]}
obstacles: [{shape: circle, center: [0.5, 0.55], radius: 0.1}]
load: {shape: bar, length: 0.2}
manipulators:
  - {name: left,  start: [0.15, 0.3], goal: [0.85, 0.3]}
  - {name: right, start: [0.15, 0.5], goal: [0.85, 0.5]}
"""
TIME = np.linspace(0.0, 1.0, 60)
DEMONSTRATION, ANOTHER = (
    "time,x,y\n" + "".join(f"{t},{t},{size * np.sin(3 * t)}\n" for t in TIME) for size in (0.3, 0.25)
)


def furnished(here):
    """A folder with scenes and recordings, as a user has them."""
    shutil.copytree(ROOT / "examples" / "meshes", here / "meshes")
    (here / "plain.yaml").write_text(PLAIN)
    (here / "open.yaml").write_text(PLAIN.replace("duration: 4\n", ""))
    (here / "follows.yaml").write_text(PLAIN + "demonstration: {file: recordings/a.csv}\n")
    (here / "recordings").mkdir()
    (here / "recordings" / "a.csv").write_text(DEMONSTRATION)
    (here / "recordings" / "b.csv").write_text(ANOTHER)
    return here


@pytest.fixture
def place(tmp_path):
    return furnished(tmp_path / "at work")


@pytest.fixture(scope="module")
def options_given(tmp_path_factory):
    """A folder that a command with several options has made, in the place where it was made."""
    here = furnished(tmp_path_factory.mktemp("once") / "at work")
    made(here, *COMMANDS["options"])
    return here


def moved(place, name="out"):
    """The result folder at another place, and nothing left where it was made."""
    target = place.parent / "elsewhere" / name
    target.parent.mkdir(exist_ok=True)
    shutil.move(place / name, target)
    shutil.rmtree(place)
    return target


def arrays_of(folder):
    """All arrays of a result, or of the motion of a study's first episode and of its samples in a dataset."""
    if (folder / RUNS).is_file():
        (_, motion), *_ = StudyStore.open(folder / RUNS).motions()
        samples = folder / "npz" / "episode_000000.npz"
        return unpacked(motion.curve) | (read(samples) if samples.is_file() else {})
    kinds = "robot_run.npz", "run.npz", "solution.npz", "joints.npz", "simulation.npz"
    found = [read(folder / name) for name in kinds if (folder / name).is_file()]
    return {f"{i} {name}": array for i, arrays in enumerate(found) for name, array in arrays.items()}


def read(path):
    with np.load(path) as found:
        return dict(found)


def made(place, *words):
    done = invoke(*words, "--out", "out", folder=place)
    assert done.exit_code == 0, done.output


def same_again(folder):
    """Give the command that the folder tells, in it, and compare what it made bit for bit."""
    words = shlex.split(command_again(folder))
    assert words[0] == "comove"
    done = invoke(*words[1:], folder=folder)
    assert done.exit_code == 0, done.output
    return same_arrays(folder, folder.parent / "again")


def same_arrays(folder, other):
    first, second = arrays_of(folder), arrays_of(other)
    assert first.keys() == second.keys()
    for key, value in first.items():
        np.testing.assert_array_equal(value, second[key])


COMMANDS = {
    "options": ["solve", "plain.yaml", "--seed", "3", "--duration", "5", "--speed", "0.6"]
    + ["--demonstration", "recordings/a.csv", "--resemblance", "0.9"],
    "a run": ["run", "plain.yaml", "--period", "0.02"],
    "a movement of LASA": ["solve", "plain.yaml", "--demonstration", "lasa:Sine"],
    "least time": ["solve", "open.yaml", "--objective", "least-time", "--acceleration", "2"],
    "demonstration of the scene": ["solve", "follows.yaml", "--resemblance", "0.9"],
    "folder of demonstrations": ["solve", "plain.yaml", "--demonstration", "recordings"],
    "meshes": ["solve", "meshes/gate.yaml", "--budget", "20"],
    "paper": ["solve", "plain.yaml", "--method", "paper", "--seed", "1"],
}
FAST = ("options", "a run", "a movement of LASA")


@pytest.mark.parametrize(
    "kind", [kind if kind in FAST else pytest.param(kind, marks=pytest.mark.slow) for kind in COMMANDS]
)
def test_the_command_that_is_told_makes_the_same_motion_elsewhere(place, options_given, kind):
    if kind == "options":
        shutil.copytree(options_given / "out", place / "out")
    else:
        made(place, *COMMANDS[kind])
    folder = moved(place)
    same_again(folder)
    if kind == "options":
        assert invoke("verify", folder / "scene.json", folder).exit_code == 0
        assert invoke("report", folder, "--html", folder.parent / "r.html").exit_code == 0


def test_what_was_drawn_in_the_page_is_followed_again(place):
    stroke, told = Stroke(2), []
    for t in TIME:
        stroke.add(float(t), np.array([0.15 + 0.7 * t, 0.4 + 0.1 * np.sin(3 * t)]))
    rows = stroke.taught(1.0)
    worker = Worker(RunMailbox(), told.append)
    draft = Draft(contents_of(comove.Scene.load(place / "plain.yaml")), taught=rows, resemblance=0.8, seed=2)
    asked = {"id": 1, "draft": draft, "folder": place, "item": None, "dragging": False}
    worker.answer(asked | {"times": SearchTimes(budget=30.0)})
    worker.save({"id": 2, "of": 1, "target": place / "out", "seed": 2})
    assert [message["kind"] for message in told[-2:]] == ["solved", "saved"]
    same_again(moved(place))


@pytest.mark.slow
def test_an_entry_of_a_library_is_followed_again(place):
    assert invoke("learn", "recordings/a.csv", "--out", "a.json", folder=place).exit_code == 0
    assert invoke("library", "add", "a.json", "--folder", "taught", folder=place).exit_code == 0
    made(place, "solve", "plain.yaml", "--library", "taught")
    same_again(moved(place))


@pytest.mark.slow
def test_a_robot_of_ones_own_carries_and_is_simulated_again(place):
    (place / "robots").mkdir()
    gantry(place / "robots")
    scene = gantry_scene().file.model_dump(mode="json", exclude_none=True)
    (place / "carried.yaml").write_text(json.dumps(scene))
    made(place, "solve", "carried.yaml", "--robot", "robots/robot.yaml", "--seed", "1")
    simulate = ["simulate", "--seed", "4", "--no-pictures"]
    simulate += ["--robot", "inputs/robots/robot.yaml"]
    folder = moved(place)
    same_again(folder)
    for one in (folder, folder.parent / "again"):
        assert invoke(*simulate, ".", folder=one).exit_code == 0
    same_arrays(folder, folder.parent / "again")


@pytest.mark.slow
def test_an_episode_of_a_dataset_is_the_same_again(place):
    study = {
        "name": "few",
        "scene": "follows.yaml",
        "episodes": 1,
        "draws": [
            {"key": "demonstration", "recordings": "recordings"},
            {"key": "duration", "choice": [4, 5]},
        ],
    }
    (place / "study.yaml").write_text(json.dumps(study))
    made(place, "generate", "study.yaml", "--seed", "5", "--format", "npz", "--workers", "1")
    same_again(moved(place))


@pytest.mark.slow
def test_a_comparison_is_made_again(place):
    study = {"name": "two", "scenes": ["follows.yaml"], "settings": {"limits.speed": [0.5, 1]}}
    (place / "study.yaml").write_text(json.dumps(study))
    made(place, "sweep", "study.yaml", "--workers", "1")
    same_again(moved(place))


def test_where_files_came_from_is_told_with_their_checksums(options_given, tmp_path):
    out = shutil.copytree(options_given / "out", tmp_path / "out")
    told = json.loads((out / "inputs.json").read_text())
    assert set(told["files"]) == {"inputs/plain.yaml", "inputs/recordings/a.csv"}
    assert told["files"]["inputs/recordings/a.csv"]["from"] == str(options_given / "recordings" / "a.csv")
    assert (out / "inputs" / "recordings" / "a.csv").read_text() == DEMONSTRATION
    assert check_target(out, RESULT) == out, "what is listed belongs to the result, which may be replaced"
    (out / "inputs" / "notes.txt").write_text("mine")
    with pytest.raises(comove.errors.ResultError, match=r"inputs/notes\.txt"):
        check_target(out, RESULT)


@pytest.mark.slow
def test_a_stored_scene_can_be_solved_again_and_that_result_moved(place):
    made(place, *COMMANDS["meshes"])
    first = moved(place)
    assert invoke("solve", first / "scene.json", "--out", "second", folder=first.parent).exit_code == 0
    shutil.rmtree(first)
    assert invoke("verify", "second/scene.json", "second", folder=first.parent).exit_code == 0


def test_results_made_in_python_hold_their_scene(tmp_path):
    solution = solved("narrow")
    save_result(solution, tmp_path, wall_time_s=1.0)
    assert comove.Scene.load(tmp_path / "scene.json").sha256 == solution.scene.sha256
    assert (tmp_path / "inputs" / "narrow.yaml").read_text() == example_path("narrow").read_text()
    assert command_again(tmp_path) is None


def test_what_is_too_large_is_left_where_it_is_with_a_word(place, monkeypatch):
    monkeypatch.setattr("comove.results.inputs.MOST", 100)
    scene = comove.Scene.load(place / "follows.yaml")
    out = place / "out"
    out.mkdir()
    with pytest.warns(comove.errors.ComoveWarning, match=r"a\.csv: .* not copied"):
        write_inputs(out, scene)
    assert not (out / "inputs" / "recordings").exists()
    assert (
        len(json.loads((out / "inputs.json").read_text())["files"]["inputs/recordings/a.csv"]["sha256"]) == 64
    )
