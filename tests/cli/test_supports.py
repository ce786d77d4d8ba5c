"""Payloads that rest on something, from the command line: what is said, what is stored, what is refused."""

import json
import re

import numpy as np
import pytest
import yaml

from comove.errors import ComoveWarning
from comove.model import Scene
from comove.model.resting import require_no_rest
from tests import commands
from tests.model.test_resting import tray


def written(folder, data):
    path = folder / "scene.yaml"
    path.write_text(yaml.safe_dump(data), encoding="utf-8")
    return path


def test_step_by_step_motions_refuse_resting_contacts_and_the_advice_works(tmp_path):
    data = tray()
    result = commands.invoke("run", written(tmp_path, data), "--out", tmp_path / "out")
    assert result.exit_code == 2
    assert not (tmp_path / "out").exists()
    told = dict(
        re.findall(r"(start|goal) of every manipulator by \[([^\]]*)\] m", " ".join(result.stderr.split()))
    )
    for hand in data["manipulators"]:
        for end, by in told.items():
            hand[end] = (np.array(hand[end]) + [float(x) for x in by.split(",")]).tolist()
    with pytest.warns(ComoveWarning, match="the key has no effect"):
        require_no_rest(Scene.from_dict(data))


@pytest.mark.slow
def test_verdicts_name_what_was_relieved(tmp_path):
    path, out = written(tmp_path, tray()), tmp_path / "out"
    solved = commands.invoke("solve", path, "--out", out)
    assert solved.exit_code == 0, solved.stderr
    for result in (solved, commands.invoke("verify", path, out)):
        assert result.exit_code == 0, result.stderr
        assert "off its supports" in result.stdout
        assert len(re.findall(r"rests on +table \(box\) at the (start|goal), 0 mm apart", result.stdout)) == 2
    summary = json.loads((out / "solution.json").read_text())
    assert summary["support_distance_min"] == pytest.approx(-1e-4, abs=1e-9)
    assert 0.0 < summary["support_left"] < summary["support_met"] < 4.0
    loose = tray()
    del loose["obstacles"][0]["support"]
    (tmp_path / "loose").mkdir()
    assert commands.invoke("verify", written(tmp_path / "loose", loose), out).exit_code == 2
    (out / "solution.json").write_text(json.dumps(summary | {"support_distance_min": 0.01}))
    assert commands.invoke("verify", path, out).exit_code == 1
