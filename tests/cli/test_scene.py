"""`comove scene` writes version 2 of a file, and the schema by which editors know its keys."""

import json
import re

import pytest
import yaml

from comove.io.yaml_reader import read_yaml
from comove.lab.examples import example_path
from comove.model import Scene
from tests.commands import invoke


def test_an_upgraded_file_is_the_same_scene_and_replaces_none(tmp_path):
    source, out = example_path("triangle"), tmp_path / "triangle.yaml"
    assert invoke("scene", "upgrade", source, "--out", out).exit_code == 0
    assert read_yaml(out)[0]["version"] == 2
    assert Scene.load(out).nodes_at("goal") == pytest.approx(Scene.load(source).nodes_at("goal"), abs=1e-12)
    text = out.read_text()
    again = invoke("scene", "upgrade", source, "--out", out)
    assert again.exit_code == 2
    assert "there already" in again.output
    assert out.read_text() == text
    assert invoke("scene", "upgrade", source).output == text
    done = invoke("scene", "upgrade", out)
    assert done.exit_code == 2
    assert "of version 2 already" in done.output


def test_files_that_a_scene_names_stay_beside_it(tmp_path):
    """What the advice says works when it is followed."""
    folder = tmp_path / "meshes"
    folder.mkdir()
    gate = example_path("narrow").parents[3] / "examples" / "meshes"
    if not gate.is_dir():
        pytest.skip("no examples beside the package")
    for path in gate.iterdir():
        (folder / path.name).write_bytes(path.read_bytes())
    told = invoke("scene", "upgrade", folder / "gate.yaml", "--out", tmp_path / "new.yaml")
    assert told.exit_code == 2
    assert not (tmp_path / "new.yaml").exists()
    advised = told.output.split("--out ")[1].split()[0].strip()
    assert invoke("scene", "upgrade", folder / "gate.yaml", "--out", advised).exit_code == 0
    assert Scene.load(advised).meshes == Scene.load(folder / "gate.yaml").meshes


def test_the_schema_is_printed(tmp_path):
    schema = json.loads(invoke("scene", "schema").output)
    assert set(schema["required"]) == {"version", "name", "workspace"}
    assert {"payload", "grasps", "end_effectors"} <= set(schema["properties"])
    assert invoke("scene", "schema", "--out", tmp_path / "schema.json").exit_code == 0
    assert json.loads((tmp_path / "schema.json").read_text()) == schema


def test_the_grasps_that_were_taken_are_told(tmp_path):
    """Of those that a scene leaves open, by the names of the arms."""
    data = {
        "version": 2,
        "name": "open",
        "duration": 3.0,
        "workspace": {"lower": [0, 0], "upper": [1, 1]},
        "payload": {
            "shape": "box",
            "size": [0.2, 0.05],
            "start": {"position": [0.3, 0.3]},
            "goal": {"position": [0.7, 0.6], "free": "yaw"},
        },
        "grasps": {
            "left": {"position": [-0.1, 0]},
            "right": [{"position": [0.1, 0]}, {"position": [0.05, 0]}],
        },
    }
    (tmp_path / "open.yaml").write_text(yaml.safe_dump(data))
    found = invoke("solve", "open.yaml", "--out", "found", folder=tmp_path)
    assert found.exit_code == 0, found.output
    assert re.search(r"grasps taken +left at \[-0\.1, 0\], right at \[0\.1, 0\]", found.output)
    again = invoke("verify", "open.yaml", "found", folder=tmp_path)  # the goal's turn is that of the result
    assert again.exit_code == 0, again.output
