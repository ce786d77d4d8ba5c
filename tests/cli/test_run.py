"""`comove run`: exit codes and files."""

import json

import numpy as np
import pytest
import yaml

from tests import commands

SCENE = {
    "name": "crossing",
    "duration": 3.0,
    "workspace": {"lower": [0, 0], "upper": [1, 1]},
    "obstacles": [
        {"shape": "circle", "center": [0.5, 0.9], "radius": 0.06, "motion": {"velocity": [0, -0.25]}},
        {"shape": "box", "center": [0.5, 0.1], "size": [0.1, 0.1]},
    ],
    "load": {"shape": "bar", "length": 0.2},
    "manipulators": [
        {"name": "left", "start": [0.15, 0.4], "goal": [0.85, 0.4]},
        {"name": "right", "start": [0.15, 0.6], "goal": [0.85, 0.6]},
    ],
    "limits": {"speed": 0.6, "acceleration": 3.0},
}


@pytest.fixture
def invoke(tmp_path):
    def call(scene=SCENE, *options, pictures=False):
        path = tmp_path / "scene.yaml"
        path.write_text(yaml.safe_dump(scene), encoding="utf-8")
        return commands.invoke("run", path, "--out", tmp_path / "out", *options, pictures=pictures)

    return call


@pytest.mark.slow
def test_a_run_that_arrives(invoke, tmp_path):
    result = invoke()
    assert result.exit_code == 0, result.output
    assert "arrived, verified" in result.output
    arrays = dict(np.load(tmp_path / "out" / "run.npz"))
    time, hands, obstacles = (arrays[k] for k in ("time", "position", "obstacle_center"))
    assert hands.shape == (len(time), 2, 2)
    assert obstacles.shape == (len(time), 2, 2)
    np.testing.assert_allclose(np.diff(time), 0.01)
    np.testing.assert_allclose(
        obstacles[:, 0], np.stack([np.full(len(time), 0.5), 0.9 - 0.25 * time], axis=1)
    )
    np.testing.assert_allclose(np.linalg.norm(hands[:, 0] - hands[:, 1], axis=1), 0.2, atol=1e-9)
    assert np.abs(hands[-1] - [[0.85, 0.4], [0.85, 0.6]]).max() < 1e-3
    away = np.linalg.norm(hands - obstacles[:, :1], axis=2).min() - 0.06
    summary = json.loads((tmp_path / "out" / "run.json").read_text())
    assert summary["verified"] is True
    assert away >= summary["clearance_min"] >= 0
    assert {"cost", "cost_terms", "seed", "version", "scene_sha256", "motion_sha256"} <= set(summary)
    names = {p.name for p in (tmp_path / "out").iterdir()}
    assert names == {"run.npz", "run.json", "scene.json", "run.png", "run.gif", "inputs", "inputs.json"}


@pytest.mark.slow
def test_all_methods_side_by_side(invoke, tmp_path):
    result = invoke(SCENE, "--compare", pictures=True)
    assert result.exit_code == 0, result.output
    table = json.loads((tmp_path / "out" / "comparison.json").read_text())
    methods = [row["method"] for row in table["methods"]]
    assert methods == [
        "no modulation",
        "own matrix each",
        "nearest hand's matrix",
        "same matrix on all",
        "obstacles seen only",
        "motions known",
    ]
    for row in table["methods"]:
        assert row["method"] in result.output
        assert row["contact"] == (row["clearance_min"] < 0)
    own = json.loads((tmp_path / "out" / "run.json").read_text())
    assert table["methods"][-1]["clearance_min"] == own["clearance_min"]
    for suffix in ("png", "gif"):
        assert (tmp_path / "out" / f"comparison.{suffix}").stat().st_size > 1000
    assert invoke().exit_code == 0, "such a folder may be replaced"
    assert not (tmp_path / "out" / "comparison.json").exists()


@pytest.mark.slow
def test_json_is_printed_alone_and_the_period_is_kept(invoke, tmp_path):
    result = invoke(SCENE, "--json", "--period", "0.02")
    assert json.loads(result.stdout)["verified"] is True
    np.testing.assert_allclose(np.diff(np.load(tmp_path / "out" / "run.npz")["time"]), 0.02)


@pytest.mark.slow
def test_a_run_that_is_blocked(invoke, tmp_path):
    stays = {"shape": "circle", "center": [0.85, 0.1], "radius": 0.06}
    stays["motion"] = {"waypoints": [[0.85, 0.1], [0.85, 0.5]], "times": [0, 2]}
    result = invoke({**SCENE, "obstacles": [stays]}, "--budget", "4")
    assert result.exit_code == 1
    assert "obstacles[0] (sphere) is where the load has to go" in result.output
    summary = json.loads((tmp_path / "out" / "run.json").read_text())
    assert summary["verified"] is False
    assert summary["clearance_min"] >= 0


@pytest.mark.parametrize(
    ("change", "options", "words"),
    [
        ({}, ["--period", "0"], "period = 0.0"),
        ({}, ["--period", "1e-9"], "--period: 1e-09 s is too short; give 0.0001 s or more"),
        ({}, ["--period", "9e-5"], "is too short"),
        ({}, ["--period", "nan"], "period = nan"),
        ({}, ["--period", "-1e-9"], "period = -1e-09"),
        ({}, ["--budget", "1e9"], "1e+09 s in steps of 0.01 s are more than 2,000,000 steps"),
        ({}, ["--period", "1e-4", "--budget", "201"], "201 s in steps of 0.0001 s are more than"),
        ({"duration": 3600.0}, ["--period", "1e-4"], "10800 s in steps of 0.0001 s are more than"),
        ({}, ["--budget", "-1"], "--budget"),
        (
            {"obstacles": [{"shape": "circle", "center": [0.15, 0.5], "radius": 0.1}]},
            [],
            "at the start the load",
        ),
        (
            {
                "obstacles": [
                    {**SCENE["obstacles"][0], "motion": {"waypoints": [[0.5, 0.9], [0, 0]], "times": [1, 1]}}
                ]
            },
            [],
            "times[1] = 1.0 does not come after times[0] = 1.0",
        ),
    ],
)
def test_bad_input(invoke, tmp_path, change, options, words):
    result = invoke({**SCENE, **change}, *options)
    assert result.exit_code == 2
    assert words in result.output
    assert "Traceback" not in result.output
    assert not (tmp_path / "out").exists()


def test_only_what_was_drawn_is_named_and_opened(invoke, tmp_path, monkeypatch):
    folder, opened = tmp_path / "out", []
    monkeypatch.setattr("typer.launch", opened.append)
    done = invoke(SCENE, "--no-film")
    assert done.exit_code == 0, done.stderr
    assert str(folder / "run.png") in done.stdout and "run.gif" not in done.stdout
    shown = commands.invoke("show", folder, "--open")
    assert "run.gif" not in shown.stdout and opened == [str(folder / "run.png")]
