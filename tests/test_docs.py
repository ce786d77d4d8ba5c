"""Every command and every Python block of the documents runs; so does every example."""

from __future__ import annotations

import importlib.util
import re
import runpy
import shlex
import shutil
import signal
import subprocess
import sys
import webbrowser
from pathlib import Path

import numpy as np
import pytest

from comove import solve
from comove.dmp.demonstrations import formats
from comove.lab.examples import copy_examples
from comove.model import Scene
from comove.robots import Robot, RobotCarrier
from tests.commands import invoke
from tests.lab.paper.test_page import SMALL
from tests.schema import satisfies

ROOT = Path(__file__).parents[1]
DOCS = ROOT / "docs"
PAGES = [
    *(ROOT / name for name in ("README.md", "CONTRIBUTING.md", "paper/paper.md")),
    *(p for p in sorted(DOCS.rglob("*.md")) if not {"_build", "gallery"} & set(p.relative_to(DOCS).parts)),
]
SAVED = re.compile(r"save it as `([\w.-]+)`:\n\n```yaml\n(.*?)^```", re.MULTILINE | re.DOTALL)
SCENES = ROOT / "src" / "comove" / "examples"
LONG = (
    *(
        "comove simulate",
        "comove export",
        "examples/robots/",
        "examples/baxter/",
        "solve baxter_",
        "library combine",
        "comove run",
        "bench run",
        "bench scaling",
    ),
    "comove generate",
    "comove sweep",
    *("--method paper", "--method task-priority", "comove reproduce"),
    "05_a_load_of_any_shape",
    "18_the_papers_method",
    "robot new",
    "robot check",
    "robot scene",
    "view mine.yaml",
    "view window.yaml",
    "04_a_library_of_movements",
    "09_a_tray_over_a_wall",
    "12_your_own_objective",
    "comove learn lasa:Angle:0 lasa",
    "comove solve triangle.yaml",
    "view narrow.yaml",
    *("propose_scene(", "solve_many(", "objective=height", "objective=effort"),
)


LONGEST = "bench ablation"
"""What a command says that takes many minutes however little is asked of it."""
ELSEWHERE = {SMALL}
"""Commands that take many minutes, and that another test runs word by word."""


def blocks(language: str) -> list[tuple[str, str]]:
    """Fenced blocks of one language in all pages, with the page's name."""
    pattern = re.compile(rf"^```{language}\n(.*?)^```", re.MULTILINE | re.DOTALL)
    return [(page.name, code) for page in PAGES for code in pattern.findall(page.read_text(encoding="utf-8"))]


def commands() -> list:
    """The blocks of commands, on each page once; those that take long are slow tests."""
    once = dict.fromkeys(blocks("sh"))
    return [pytest.param(page, code, marks=how_long(code)) for page, code in once]


def how_long(code: str) -> list:
    """The marks of a block of commands."""
    if LONGEST in code:
        return [pytest.mark.release]
    return [pytest.mark.slow] if any(word in code for word in LONG) else []


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Where the commands run: the scenes lie there as the demo leaves them."""
    folder = tmp_path_factory.mktemp("docs")
    copy_examples(folder)
    shutil.copytree(ROOT / "examples", folder / "examples", ignore=shutil.ignore_patterns("*.py"))
    for page in PAGES:
        for name, text in SAVED.findall(page.read_text(encoding="utf-8")):
            (folder / name).write_text(text, encoding="utf-8")
    return folder


def test_the_documents_hold_commands_and_code():
    assert len(blocks("sh")) >= 3
    assert len(blocks("python")) >= 2


@pytest.mark.parametrize(("page", "code"), commands())
def test_commands(page, code, folder, monkeypatch):
    monkeypatch.chdir(folder)
    for line in code.splitlines():
        words = shlex.split(line, comments=True)
        if not words:
            continue
        assert words[0] in ("make", "comove", "cd", ".", "pip"), f"{page}: {line}"
        if words[0] in ("cd", ".", "pip"):  # only the first day's test begins with nothing
            continue
        if line in ELSEWHERE:
            continue
        if words[0] == "make":  # what make does is run by CI; here only that the chore exists
            assert f"\n{words[1]}:" in (ROOT / "Makefile").read_text(encoding="utf-8")
        elif words[1] in ("view", "report") and importlib.util.find_spec("viser") is None:
            pytest.skip("the viewer is not installed: pip install 'comove[view]'")
        elif words[1] == "view" and "--html" not in words:
            serve(words)
        else:
            done = invoke(*words[1:])
            assert done.exit_code == 0, f"{page}: {line}: {done.stderr}"


def serve(words: list[str]) -> None:
    """Start a command that serves a page until Ctrl-C, and press it once the address is told."""
    with subprocess.Popen(
        [sys.executable, "-m", *words],
        stdout=subprocess.PIPE,
        text=True,
    ) as running:
        try:
            assert "http://127.0.0.1:" in running.stdout.readline()
            running.send_signal(signal.SIGINT)
            assert running.wait(600) == 0
        finally:
            running.kill()


@pytest.mark.parametrize(
    ("page", "code"), [pytest.param(*block, marks=how_long(block[1])) for block in blocks("python")]
)
def test_python(page, code, folder, monkeypatch):
    monkeypatch.chdir(folder)
    if "show" in code and importlib.util.find_spec("viser") is None:
        pytest.skip("the viewer is not installed: pip install 'comove[view]'")
    monkeypatch.setattr(webbrowser, "open", lambda address: True)
    known = list(formats.FORMATS)
    try:
        exec(compile(code, page, "exec"), {"__name__": "__main__"})
    finally:
        formats.FORMATS[:] = known  # to which one page adds its own


@pytest.mark.parametrize(
    "example",
    [
        pytest.param(path, id=path.stem, marks=[pytest.mark.slow] if path.stem in LONG else [])
        for path in sorted((ROOT / "examples").glob("*.py"))
    ],
)
def test_examples(example, folder, monkeypatch, capsys):
    monkeypatch.chdir(folder)
    monkeypatch.setattr(sys, "argv", [str(example)])
    runpy.run_path(str(example), run_name="__main__")
    assert "False" not in capsys.readouterr().out


def whole_scenes() -> list:
    """The blocks of YAML that are a scene by themselves, which arms take long to solve."""
    import yaml

    read = [(page, yaml.safe_load(text)) for page, text in dict.fromkeys(blocks("yaml"))]
    scenes = [(page, data) for page, data in read if {"name", "workspace"} <= set(data or ())]
    return [pytest.param(data, id=f"{page} {data['name']}") for page, data in scenes]


@pytest.mark.parametrize("data", whole_scenes())
def test_whole_scenes_of_pages_satisfy_the_schema_and_can_be_solved(data):
    """Hands are moved; of arms, the joints at both ends are clear, which is where poses that are made up fail."""
    scene = Scene.from_dict(data)
    assert data.get("version", 1) == 1 or satisfies(data)
    if scene.file.robot is None:
        assert solve(scene, effort="quick").verified
        return
    carrier = RobotCarrier(Robot.load(scene.file.robot), scene.alternatives[0].timed(scene.duration))
    carrier.require_reach()
    carrier.require_clear_ends()


@pytest.mark.slow
@pytest.mark.parametrize("data", [one for one in whole_scenes() if "robot" in one.values[0]])
def test_whole_scenes_of_pages_are_carried(data):
    scene = Scene.from_dict(data)
    assert solve(scene, robot=Robot.load(scene.file.robot), effort="quick").verified


def test_the_scene_of_the_readme_is_the_example():
    import yaml

    (_, text), *_ = blocks("yaml")
    shown, example = Scene.from_dict(yaml.safe_load(text)), Scene.load(SCENES / "narrow.yaml")
    for end in ("start", "goal"):
        assert shown.nodes_at(end) == pytest.approx(example.nodes_at(end), abs=1e-12)
    assert np.array_equal(shown.obstacles, example.obstacles)
    assert shown.file.limits == example.file.limits
    assert (shown.name, shown.duration) == (example.name, example.duration)


def test_pictures_exist_and_are_small():
    for page in PAGES:
        for target in re.findall(r"!\[.*?\]\((.*?)\)", page.read_text(encoding="utf-8")):
            assert (page.parent / target).stat().st_size < 300_000
