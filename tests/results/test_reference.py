"""What a stored result is verified against is never taken from the result."""

import json

import pytest

import comove
from comove.errors import ResultError
from comove.io.folders import whole_folder
from comove.model import Scene
from comove.model.files.keys import DEFAULT_LIMITS
from comove.results import RESULT
from comove.results.reference import filled_in, reference_of
from comove.results.solution import read_result
from comove.view.figures import save_result
from tests.commands import invoke

OPEN = {
    "name": "open",
    "workspace": {"lower": [0, 0], "upper": [1, 1]},
    "load": {"shape": "bar", "length": 0.2},
    "manipulators": [
        {"name": "left", "start": [0.15, 0.4], "goal": [0.85, 0.4]},
        {"name": "right", "start": [0.15, 0.6], "goal": [0.85, 0.6]},
    ],
}
HUGE = {"speed": 100.0, "acceleration": 100.0, "jerk": 5000.0}


def written(folder, **changes):
    """The fastest motion on the scene, or on one with changes, with its scene."""
    solution = comove.solve(Scene.from_dict(OPEN | changes), seed=0)
    with whole_folder(folder, RESULT) as draft:
        save_result(solution, draft, wall_time_s=1.0)
    return folder


@pytest.fixture(scope="module")
def hasty(tmp_path_factory):
    """A motion far beyond the documented limits, verified on a scene of the folder's own that allows them."""
    return written(tmp_path_factory.mktemp("hasty") / "result", limits=HUGE)


def test_limits_that_a_scene_leaves_open_are_the_documented_ones_not_the_folders(hasty, tmp_path):
    scene = tmp_path / "open.yaml"
    scene.write_text(json.dumps(OPEN))
    done = invoke("verify", scene, hasty)
    assert done.exit_code == 1
    assert "accelerates by up to" in done.stderr and "(limit 1 m/s^2)" in done.stderr
    assert "limits of 1 m/s, 1 m/s^2, 5 m/s^3" in done.stderr
    filled = filled_in(Scene.from_dict(OPEN), hasty, read_result(hasty).summary)
    limits = filled.file.limits.model_dump(exclude={"clearance"})
    assert limits == DEFAULT_LIMITS and filled.duration == read_result(hasty).summary["duration"]


def test_limits_that_verify_are_printed(tmp_path):
    folder, scene = written(tmp_path / "result"), tmp_path / "open.yaml"
    scene.write_text(json.dumps(OPEN))
    done = invoke("verify", scene, folder)
    assert done.exit_code == 0, done.stderr
    assert "limits of 1 m/s, 1 m/s^2, 5 m/s^3" in done.stdout and f"against {scene}" in done.stdout


def test_the_folders_own_scene_verifies_and_is_named_as_such(hasty):
    done = invoke("verify", hasty)
    assert done.exit_code == 0
    assert f"against the folder's own scene, {hasty / 'scene.json'}" in done.stdout
    assert "limits of 100 m/s, 100 m/s^2, 5000 m/s^3" in done.stdout
    assert reference_of(hasty).is_own


def test_without_any_scene_the_command_says_how_it_can_be_verified(hasty, tmp_path):
    (tmp_path / "result").mkdir()
    for name in ("solution.json", "solution.npz"):
        (tmp_path / "result" / name).write_bytes((hasty / name).read_bytes())
    with pytest.raises(ResultError, match="does not say which scene"):
        reference_of(tmp_path / "result")
    done = invoke("verify", tmp_path / "result")
    assert done.exit_code == 2 and "comove verify SCENE DIR" in done.stderr
