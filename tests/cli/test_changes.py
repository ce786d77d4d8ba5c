"""Options and keys that say how long a movement may take, what limits it keeps, and what it shall be best in."""

import json
import re

import pytest

from tests.cli.test_cli import SCENE, assert_refused, run
from tests.commands import invoke

OPEN = SCENE.replace("duration: 10.0\n", "")
LIMITS = ("--acceleration", 1, "--jerk", 5)


@pytest.fixture
def folder(tmp_path):
    (tmp_path / "test.yaml").write_text(SCENE)
    (tmp_path / "open.yaml").write_text(OPEN)
    return tmp_path


def summary(folder):
    return json.loads((folder / "solution.json").read_text())


def test_a_scene_without_a_duration_is_solved_in_the_shortest(folder):
    outcome = invoke("solve", folder / "open.yaml", "--out", folder / "out")
    assert outcome.exit_code == 0, outcome.stderr
    told = summary(folder / "out")
    assert told["objective"] == {"type": "least_time"}
    assert 1.5 < told["duration"] < 3
    assert told["jerk_max"] <= 5
    assert re.search(rf"duration +{told['duration']:.4g} s\n", outcome.stdout)
    judged = invoke("verify", folder / "open.yaml", folder / "out")
    assert judged.exit_code == 0, judged.stderr


@pytest.mark.slow
def test_a_duration_edited_into_the_result_is_noticed(folder):
    assert invoke("solve", folder / "open.yaml", "--out", folder / "out").exit_code == 0
    path = folder / "out" / "scene.json"
    data = json.loads(path.read_text())
    path.write_text(json.dumps(data | {"duration": 2 * data["duration"]}))
    assert invoke("verify", folder / "open.yaml", folder / "out").exit_code == 1
    path.write_text(json.dumps(data | {"duration": "soon"}))
    assert_refused(invoke("verify", folder / "open.yaml", folder / "out"), "scene.json", "'soon'", "solve")
    path.unlink()
    assert_refused(invoke("verify", folder / "open.yaml", folder / "out"), "leaves its duration open")


def test_options_stand_for_what_the_scene_says(folder):
    options = ("--duration", 4, "--speed", 0.9, *LIMITS, "--clearance", 0.004)
    outcome = invoke("solve", folder / "test.yaml", "--out", folder / "out", *options)
    assert outcome.exit_code == 0, outcome.stderr
    told = summary(folder / "out")
    assert told["duration"] == 4
    assert told["clearance_min"] >= 0.004
    assert told["jerk_max"] <= 5
    assert invoke("verify", folder / "test.yaml", folder / "out", *options).exit_code == 0
    without = invoke("verify", folder / "test.yaml", folder / "out")
    assert without.exit_code == 1
    assert "must be given again" in without.stderr
    told = without.stderr.splitlines()[-1]
    assert "--duration 4.0 --speed 0.9 --acceleration 1.0 --jerk 5.0 --clearance 0.004: give that" in told
    (folder / "out" / "scene.json").write_text('{"duration": [], "limits": 7}')  # the folder is not trusted
    again = invoke("verify", folder / "test.yaml", folder / "out")
    assert again.exit_code == 1
    assert "give that" not in again.stderr


@pytest.mark.slow
def test_too_short_a_duration_is_answered_by_one_that_does(folder):
    outcome = invoke("solve", folder / "test.yaml", "--out", folder / "out", "--duration", 1, *LIMITS)
    assert outcome.exit_code == 1
    (told,) = (line for line in outcome.stdout.splitlines() if "would do" in line)
    needed = told.split(": ")[1].split(" s")[0]
    again = invoke("solve", folder / "test.yaml", "--out", folder / "again", "--duration", needed, *LIMITS)
    assert again.exit_code == 0, again.stdout


@pytest.mark.parametrize(
    ("objective", "kind"),
    [
        pytest.param("{type: least_time}", "least_time", marks=pytest.mark.slow),
        ("{type: paper, goal: 2, velocity: 0.1}", "paper"),
        ("{type: least_jerk, room: 0.0}", "least_jerk"),
    ],
)
@pytest.mark.few(1)
def test_scenes_say_what_counts(folder, objective, kind):
    (folder / "said.yaml").write_text(SCENE + f"objective: {objective}\n")
    assert invoke("solve", folder / "said.yaml", "--out", folder / "out").exit_code == 0
    told = summary(folder / "out")
    assert told["objective"]["type"] == kind
    if kind == "paper":
        assert told["cost_weights"]["goal"] == 2
        assert told["cost_weights"]["velocity"] == pytest.approx(0.1)
    assert invoke("verify", folder / "said.yaml", folder / "out").exit_code == 0
    # The command has the last word.
    assert (
        invoke("solve", folder / "said.yaml", "--out", folder / "out", "--objective", "paper").exit_code == 0
    )
    assert summary(folder / "out")["objective"]["type"] == "paper"


def test_weights_of_the_paper_are_those_given(folder):
    options = ("--objective", "paper", "--weights", "3,0.02,10")
    assert invoke("solve", folder / "test.yaml", "--out", folder / "out", *options).exit_code == 0
    assert summary(folder / "out")["cost_weights"] == {"goal": 3, "velocity": 0.02, "obstacle": 10}


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (("--duration", 0), ["duration", "0", "greater than 0"]),
        (("--duration", "nan"), ["duration", "nan", "finite"]),
        (("--duration", 1e9), ["duration", "3600"]),
        (("--jerk", 0), ["limits.jerk", "greater than 0"]),
        (("--speed", -1), ["limits.speed", "greater than 0"]),
        (("--acceleration", "inf"), ["limits.acceleration", "finite"]),
        (("--clearance", -0.1), ["limits.clearance", "not less than 0"]),
        (("--clearance", 3), ["at the start", "clearance"]),
        (("--duration", 3, "--objective", "least-time"), ["--duration", "give one of"]),
        (("--objective", "least-time", "--resemblance", 0.5), ["--resemblance", "least time"]),
        (("--objective", "least-tim"), ["unknown objective", "did you mean 'least-time'"]),
        (("--objective", "least-time", "--no-planner"), ["LeastTime", "a planner"]),
        (("--weights", "1,2"), ["--weights", "'1,2'", "1,0.01,10"]),
        (("--weights", "1,2,x"), ["--weights", "three numbers"]),
        (("--objective", "paper", "--weights", "1,-1,0"), ["velocity = -1"]),
        (("--objective", "least-jerk", "--weights", "1,1,1"), ["--weights", "equation (4)"]),
    ],
)
def test_bad_options(folder, options, words):
    assert_refused(invoke("solve", folder / "test.yaml", "--out", folder / "out", *options), *words)
    assert not (folder / "out").exists()


@pytest.mark.parametrize(
    ("objective", "words"),
    [
        ("{type: least_jrk}", ["objective", "did you mean 'least_jerk'"]),
        ("{type: least_jerk, resemblance: 2}", ["objective.resemblance", "not greater than 1"]),
        ("{type: least_jerk, resemblance: 0.5}", ["objective.resemblance", "no demonstration"]),
        ("{type: least_time, resemblance: 0.5}", ["objective", "unknown key 'resemblance'"]),
        ("{type: paper, goal: -1}", ["objective.goal", "not less than 0"]),
        ("least_jerk", ["objective", "mapping"]),
        ("{}", ["objective", "type"]),
    ],
)
def test_bad_objectives(folder, objective, words):
    (folder / "bad.yaml").write_text(SCENE + f"objective: {objective}\n")
    assert_refused(invoke("solve", folder / "bad.yaml", "--out", folder / "out"), *words)


@pytest.mark.slow
def test_a_run_without_a_duration_takes_as_long_as_its_plan(folder):
    hasty = run("run", folder / "open.yaml", "--out", folder / "run", "--acceleration", 2, "--json")
    assert hasty.returncode == 0, hasty.stderr
    assert json.loads(hasty.stdout)["duration_s"] < 4.0


def test_compared_systems_do_without_a_duration(folder):
    compared = invoke(
        "solve", folder / "open.yaml", "--out", folder / "out", "--method", "leader-follower", "--budget", 4
    )
    assert compared.exit_code in (0, 1), compared.stderr
