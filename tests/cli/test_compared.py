"""The compared systems on the command line: exit codes, saved attempts, and results that can be judged again."""

import json

import numpy as np
import pytest

from comove.dmp import DMP, Library, Primitive
from comove.dmp.demonstrations import Demonstration
from comove.lab.examples import example_path
from tests.commands import invoke

FILES = {"solution.npz", "solution.json", "motion.png", "progress.png", "scene.json", "inputs", "inputs.json"}
FAILING = ["unconstrained", "leader-follower", "speed-scaled", "task-priority"]


@pytest.fixture(scope="module")
def narrow(tmp_path_factory):
    """The narrow example without a demonstration."""
    lines = example_path("narrow").read_text().splitlines()
    path = tmp_path_factory.mktemp("compared") / "narrow.yaml"
    path.write_text("\n".join(line for line in lines if not line.startswith("demonstration")))
    return path


@pytest.fixture(scope="module")
def outcomes(narrow):
    """Exit code and folder of every method."""
    folder = narrow.parent
    return {
        name: (invoke("solve", narrow, "--out", folder / name, "--method", name), folder / name)
        for name in ["comove", *FAILING, "single"]
    }


def summary_of(folder):
    return json.loads((folder / "solution.json").read_text())


@pytest.mark.parametrize("name", FAILING)
@pytest.mark.few(1)
@pytest.mark.slow
def test_what_cannot_be_held_is_saved_drawn_and_told(outcomes, name):
    outcome, folder = outcomes[name]
    assert outcome.exit_code == 1
    assert {path.name for path in folder.iterdir()} == FILES
    summary = summary_of(folder)
    assert summary["method"] == name and summary["verified"] is False and summary["reasons"]
    with np.load(folder / "solution.npz") as arrays:
        assert arrays["position"].shape[1:] == (2, 2)


@pytest.mark.slow
def test_each_fails_in_its_own_way_and_comove_in_none(outcomes):
    summaries = {name: summary_of(folder) for name, (_, folder) in outcomes.items()}
    assert summaries["unconstrained"]["distance_error_max"] > 0.01
    assert summaries["leader-follower"]["distance_error_max"] < 0.005
    assert summaries["leader-follower"]["clearance_min"] < 0
    assert summaries["speed-scaled"]["clearance_min"] < 0
    assert summaries["task-priority"]["end_error"] > 0.1
    assert outcomes["comove"][0].exit_code == 0
    assert summaries["comove"]["distance_error_max"] < 1e-9
    assert summaries["comove"]["clearance_min"] > 0


@pytest.mark.slow
def test_epochs_are_in_the_summary(outcomes):
    log = summary_of(outcomes["leader-follower"][1])["log"]
    assert len(log["epoch_error_rms_m"]) == 20


@pytest.mark.parametrize("name", FAILING)
@pytest.mark.slow
def test_a_saved_attempt_is_shown_and_judged_like_any_other(outcomes, narrow, name):
    folder = outcomes[name][1]
    assert invoke("show", folder).exit_code == 0
    judged = invoke("verify", narrow, folder)
    assert judged.exit_code == 1
    assert "edited" not in judged.output


def test_one_hand_is_judged_on_the_scene_of_one(outcomes, narrow):
    outcome, folder = outcomes["single"]
    assert outcome.exit_code == 0
    assert {path.name for path in folder.iterdir()} == FILES | {"scene.json"}
    assert invoke("verify", folder / "scene.json", folder).exit_code == 0
    assert invoke("verify", narrow, folder).exit_code == 1


@pytest.mark.slow
def test_a_library_serves_one_hand(tmp_path, narrow):
    library = Library(tmp_path / "lib")
    for shape in ("Angle", "Sine"):
        library.add(Primitive(shape, DMP.fit(Demonstration.from_lasa(shape))))
    outcome = invoke(
        "solve", narrow, "--out", tmp_path / "out", "--method", "single", "--library", tmp_path / "lib"
    )
    assert outcome.exit_code == 0


def test_what_a_method_is_not_made_for_is_bad_input(tmp_path):
    outcome = invoke(
        "solve", example_path("triangle"), "--out", tmp_path / "out", "--method", "leader-follower"
    )
    assert outcome.exit_code == 2
    assert "task-priority" in outcome.stderr and "Traceback" not in outcome.stderr
    assert not (tmp_path / "out").exists()
