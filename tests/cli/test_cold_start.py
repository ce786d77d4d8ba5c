"""Bad input is told before anything is compiled: each case in a process whose cache of kernels is empty."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest
import yaml

import comove
from tests.solved import EXAMPLES

pytestmark = pytest.mark.slow
STUDIES = Path(comove.__file__).parents[2] / "examples" / "studies"

RUN = """
import json, sys
from numba.core import event
from typer.testing import CliRunner
from comove.cli.app import whole_application

class Compiles(BaseException):
    pass

class Refusing(event.Listener):
    def on_start(self, event):
        raise Compiles(repr(event.data["dispatcher"]))
    def on_end(self, event):
        pass

application, told = whole_application(), []
with event.install_listener("numba:compile", Refusing()):
    for words in json.loads(sys.stdin.read()):
        try:
            result = CliRunner().invoke(application, words)
            told.append([result.exit_code, repr(result.exception) if isinstance(result.exception, Compiles) else ""])
        except Compiles as error:
            told.append([None, repr(error)])
print(json.dumps(told))
"""


def scene(folder, name, base="narrow", without=(), **changes):
    """Write an example with other entries; its name."""
    data = yaml.safe_load((EXAMPLES / f"{base}.yaml").read_text()) | changes
    path = folder / f"{name}.yaml"
    path.write_text(yaml.safe_dump({key: value for key, value in data.items() if key not in without}))
    return path.name


def cases(folder):
    """Commands whose input is wrong in one place each."""
    (folder / "full").mkdir()
    (folder / "full" / "kept.txt").write_text("kept")
    (folder / "empty").mkdir()
    (folder / "file").write_text("a file")
    (folder / "broken.yaml").write_text("name: [\n")
    (folder / "words.csv").write_text("a,b\n1,2\n")
    (folder / "other.json").write_text("{}")
    plain, robot = scene(folder, "plain"), scene(folder, "robot", "baxter_wide")
    free = scene(folder, "free", without=["load", "constraints"])
    space = scene(folder, "space", "window", without=["demonstration"])
    three = scene(folder, "three", "triangle")
    lost = scene(folder, "lost", demonstration={"file": "none.csv"})
    shape = scene(folder, "shape", demonstration={"lasa": "Nothing"})
    aims = scene(folder, "aims", objective={"type": "nothing"})
    nobody = scene(folder, "nobody", "baxter_wide", robot="nobody")
    loose = scene(folder, "loose", "baxter_wide", without=["grasp"])
    data = yaml.safe_load((folder / robot).read_text())
    data["manipulators"][0]["name"] = "third"
    (folder / "third.yaml").write_text(yaml.safe_dump(data))
    (folder / "study.yaml").write_text(yaml.safe_dump({"version": 1, "name": "s", "scene": "none.yaml"}))
    planar = str(STUDIES / "planar.yaml")
    return [
        *(["solve", name, "--out", "o"] for name in ("none.yaml", "broken.yaml", lost, shape, aims)),
        ["solve", plain, "--out", "full"],
        ["solve", plain, "--out", "file"],
        *(
            ["solve", plain, "--out", "o", *words.split()]
            for words in (
                "--method nothing",
                "--objective nothing",
                "--objective least-time --duration 3",
                "--weights 1,2",
                "--weights -1,2,3",
                "--weights 1,2,3 --objective least-jerk",
                "--resemblance 7",
                "--budget 0",
                "--budget nan",
                "--library none",
                "--library empty",
                "--library empty --method single",
                "--demonstration none.csv",
                "--demonstration words.csv",
                "--demonstration other.json",
                "--demonstration lasa:Angle --library empty",
                "--duration -1",
                "--speed 0",
                "--method paper --objective least-jerk",
                "--no-planner --objective least-time",
            )
        ),
        ["solve", space, "--out", "o", "--resemblance", "0.5"],
        ["solve", space, "--out", "o", "--demonstration", "lasa:Angle"],
        ["solve", space, "--out", "o", "--demonstration", "lasa:Angle:all"],
        *(["solve", free, "--out", "o", "--method", m] for m in ("paper", "printed", "leader-follower")),
        *(["solve", three, "--out", "o", "--method", m] for m in ("projection", "leader-follower")),
        *(["run", name, "--out", "o"] for name in ("none.yaml", "broken.yaml", lost)),
        ["run", plain, "--out", "full"],
        *(
            ["run", plain, "--out", "o", *words.split()]
            for words in ("--period 0", "--period 1e-9", "--budget -1", "--budget 1e9", "--grasp weld")
        ),
        *(["solve", name, "--out", "o"] for name in (nobody, loose, "third.yaml")),
        ["solve", robot, "--out", "full"],
        ["solve", plain, "--out", "o", "--robot", "baxter"],
        *(
            ["solve", robot, "--out", "o", *words.split()]
            for words in (
                "--robot nobody",
                "--method nothing",
                "--budget 0",
                "--objective nothing",
                "--library empty",
                "--resemblance 9",
            )
        ),
        ["run", "third.yaml", "--out", "o"],
        *(["robot", verb, plain, "--out", "o"] for verb in ("solve", "run")),
        *(
            ["run", robot, "--out", "o", *words.split()]
            for words in ("--rate 3", "--rate 333", "--grasp nothing", "--robot two_ur10 --grasp friction")
        ),
        *([verb, "none"] for verb in ("simulate", "export", "send")),
        ["simulate", "full", "--grasp", "nothing"],
        ["generate", "study.yaml", "--out", "o"],
        ["generate", planar, "--out", "full"],
        ["generate", planar, "--out", "o", "--workers", "0"],
        ["generate", planar, "--out", "o", "--format", "nothing"],
        ["sweep", "none.yaml", "--out", "o"],
        ["learn", "none.csv", "--out", "o.json"],
        ["learn", "words.csv", "--out", "o.json"],
        ["view", "none.yaml"],
        ["view", plain, "--html", "o.html", "--budget", "0"],
        ["verify", "none"],
        ["show", "none"],
        ["library", "combine", plain, "--out", "o.json", "--folder", "empty"],
        ["library", "combine", plain, "--out", "o.json", "--budget", "0"],
        ["bench", "run", "--out", "o.sqlite", "--sets", "nothing"],
        ["bench", "run", "--out", "o.sqlite", "--sets", "easy", "--budget", "0"],
    ]


def test_nothing_is_compiled_before_bad_input_is_told(tmp_path):
    commands = cases(tmp_path)
    environment = os.environ | {"NUMBA_CACHE_DIR": str(tmp_path / "cache")}
    command, given = [sys.executable, "-c", RUN], json.dumps(commands)
    ended = subprocess.run(
        command, input=given, cwd=tmp_path, env=environment, capture_output=True, text=True, check=True
    )
    told = json.loads(ended.stdout.splitlines()[-1])
    assert len(told) == len(commands)
    wrong = [(words, *one) for words, one in zip(commands, told, strict=True) if one != [2, ""]]
    assert wrong == []
    assert not [path for path in ("o", "o.json", "o.html", "o.sqlite") if (tmp_path / path).exists()]
