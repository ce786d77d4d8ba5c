"""A result folder is whole: it can be moved, looked at, judged, and its command makes the same motion again."""

import json
import shlex
import shutil
from pathlib import Path

import numpy as np
import pytest

import comove
from comove.experiments.examples import example_path
from comove.results.inputs import command_again, write_inputs
from comove.views import save_result
from tests.commands import invoke
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


@pytest.fixture
def place(tmp_path):
    """A folder with scenes and recordings, as a user has them."""
    here = tmp_path / "at work"
    shutil.copytree(ROOT / "examples" / "meshes", here / "meshes")
    (here / "plain.yaml").write_text(PLAIN)
    (here / "open.yaml").write_text(PLAIN.replace("duration: 4\n", ""))
    (here / "follows.yaml").write_text(PLAIN + "demonstration: {file: recordings/a.csv}\n")
    (here / "recordings").mkdir()
    (here / "recordings" / "a.csv").write_text(DEMONSTRATION)
    (here / "recordings" / "b.csv").write_text(ANOTHER)
    return here


def moved(place, name="out"):
    """The result folder at another place, and nothing left where it was made."""
    target = place.parent / "elsewhere" / name
    target.parent.mkdir(exist_ok=True)
    shutil.move(place / name, target)
    shutil.rmtree(place)
    return target


def arrays_of(folder):
    name = next(name for name in ("robot_run.npz", "run.npz", "solution.npz") if (folder / name).is_file())
    with np.load(folder / name) as found:
        return dict(found)


def same_again(folder):
    """Give the command that the folder tells, in it, and compare what it made bit for bit."""
    words = shlex.split(command_again(folder))
    assert words[0] == "comove"
    done = invoke(*words[1:], folder=folder)
    assert done.exit_code == 0, done.output
    first, second = arrays_of(folder), arrays_of(folder.parent / "again")
    assert first.keys() == second.keys()
    for key, value in first.items():
        np.testing.assert_array_equal(value, second[key])


COMMANDS = {
    "options": ["solve", "plain.yaml", "--seed", "3", "--duration", "5", "--speed", "0.6"],
    "no duration": ["solve", "open.yaml"],
    "least time": ["solve", "open.yaml", "--objective", "least-time", "--acceleration", "2"],
    "demonstration of the scene": ["solve", "follows.yaml", "--resemblance", "0.9"],
    "demonstration": ["solve", "plain.yaml", "--demonstration", "recordings/a.csv", "--resemblance", "0.9"],
    "folder of demonstrations": ["solve", "plain.yaml", "--demonstration", "recordings"],
    "library": ["solve", "plain.yaml", "--library", "taught"],
    "meshes": ["solve", "meshes/gate.yaml", "--budget", "20"],
    "paper": ["solve", "plain.yaml", "--method", "paper", "--seed", "1"],
    "run": ["run", "plain.yaml", "--period", "0.02"],
}


@pytest.mark.parametrize("kind", COMMANDS)
@pytest.mark.few(4)
def test_the_command_that_is_told_makes_the_same_motion_elsewhere(place, kind):
    if kind == "library":
        assert invoke("learn", "recordings/a.csv", "--out", "a.json", folder=place).exit_code == 0
        assert invoke("library", "add", "a.json", "--folder", "taught", folder=place).exit_code == 0
    done = invoke(*COMMANDS[kind], "--out", "out", folder=place)
    assert done.exit_code == 0, done.output
    folder = moved(place)
    same_again(folder)
    if kind != "run":
        assert invoke("verify", folder / "scene.json", folder).exit_code == 0
        assert invoke("report", folder, "--html", folder.parent / "r.html").exit_code == 0


def test_where_files_came_from_is_told_with_their_checksums(place):
    assert invoke(*COMMANDS["demonstration"], "--out", "out", folder=place).exit_code == 0
    told = json.loads((place / "out" / "inputs.json").read_text())
    assert set(told["files"]) == {"inputs/plain.yaml", "inputs/recordings/a.csv"}
    assert told["files"]["inputs/recordings/a.csv"]["from"] == str(place / "recordings" / "a.csv")
    assert (place / "out" / "inputs" / "recordings" / "a.csv").read_text() == DEMONSTRATION
    again = invoke(*COMMANDS["demonstration"], "--out", "out", folder=place)
    assert again.exit_code == 0, "what is listed belongs to the result, which may be replaced"
    (place / "out" / "inputs" / "notes.txt").write_text("mine")
    refused = invoke(*COMMANDS["demonstration"], "--out", "out", folder=place)
    assert refused.exit_code == 2 and "inputs/notes.txt" in refused.stderr


def test_a_stored_scene_can_be_solved_again_and_that_result_moved(place):
    assert invoke(*COMMANDS["meshes"], "--out", "out", folder=place).exit_code == 0
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
