"""Benchmarks import names that exist, and those that are commands print their options."""

import ast
import runpy
import sys
from importlib import import_module
from pathlib import Path

import numpy as np
import pytest

from comove.control.safety.twists import poses_of
from comove.model import Scene
from comove.verification.record import Record, verify_execution

BENCHMARKS = Path(__file__).parents[1] / "benchmarks"
SCRIPTS = sorted(BENCHMARKS.glob("*.py"))
COMMANDS = [path for path in SCRIPTS if '__name__ == "__main__"' in path.read_text(encoding="utf-8")]
OWN = ("comove", "tests", "benchmarks")
THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS")


def imports_of(path):
    """Modules of the repository that a file imports, wherever in it, and the names from them."""
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.ImportFrom) and node.module and node.module.split(".")[0] in OWN:
            yield from ((node.module, name.name) for name in node.names)
        elif isinstance(node, ast.Import):
            yield from ((name.name, None) for name in node.names if name.name.split(".")[0] in OWN)


def exists(module, name):
    """Whether a module has a name, or a module of that name."""
    try:
        found = import_module(module)
        return name is None or hasattr(found, name) or bool(import_module(f"{module}.{name}"))
    except ModuleNotFoundError as error:
        return error.name is not None and error.name.split(".")[0] not in OWN  # an optional dependency


def test_imported_names_exist():
    wanted = {(path.name, *named) for path in SCRIPTS for named in imports_of(path)}
    assert not [(file, module, name) for file, module, name in wanted if not exists(module, name)]


@pytest.mark.parametrize("path", COMMANDS, ids=lambda path: path.stem)
def test_commands_print_their_options(path, monkeypatch, capsys):
    monkeypatch.setattr(sys, "argv", [str(path), "--help"])
    monkeypatch.setattr(sys, "path", [str(BENCHMARKS), *sys.path])
    for name in THREADS:
        monkeypatch.setenv(name, "1")  # else some start again with it
    with pytest.raises(SystemExit) as left:
        runpy.run_path(str(path), run_name="__main__")
    assert left.value.code == 0
    assert "--help" in capsys.readouterr().out


def stood(speed, away, n_dims):
    """The record of a bar that stands for a second, at which a ball comes from so far away [m/s, m]."""
    hands = {"a": [0.15, 0.4, 0.5][:n_dims], "b": [0.15, 0.6, 0.5][:n_dims]}
    ball = {"shape": "circle", "center": [0.21 + away, 0.5, 0.5][:n_dims], "radius": 0.06}
    data = {
        "name": "stood",
        "duration": 4.0,
        "workspace": {"lower": [0.0] * n_dims, "upper": [1.0] * n_dims},
        "obstacles": [ball | {"motion": {"velocity": [-speed, 0.0, 0.0][:n_dims]}}],
        "load": {"shape": "bar", "length": 0.2},
        "manipulators": [{"name": name, "start": p, "goal": [0.85, *p[1:]]} for name, p in hands.items()],
        "limits": {"speed": 0.5, "acceleration": 2.0},
    }
    scene, time = Scene.from_dict(data), np.arange(101) * 0.01
    stands = [np.repeat(array[None], len(time), axis=0) for array in poses_of(scene, "start")]
    return Record(scene, time, *stands, scene.centers + scene.offsets(time), scene.obstacle_sagittas(time))


@pytest.mark.parametrize(
    ("speed", "away", "n_dims", "can"),
    [(0.4, 0.3, 2, True), (0.4, 0.1, 2, True), (0.4, 0.3, 3, True), (2.0, 0.1, 2, False)],
)
def test_who_can_dodge_is_found(speed, away, n_dims, can, monkeypatch):
    """A bar can turn aside from what is slow; in 50 ms it gets nowhere."""
    monkeypatch.syspath_prepend(str(BENCHMARKS))
    went = import_module("dodging").dodge(stood(speed, away, n_dims), 0.0)
    assert (went is not None) == can
    if went is not None:
        report, scene = verify_execution(went), went.scene
        assert report.clearance_min >= 0.0
        assert report.speed_max <= scene.speed_limit * (1 + 1e-9)
        assert report.acceleration_max <= scene.acceleration_limit * (1 + 1e-9)
