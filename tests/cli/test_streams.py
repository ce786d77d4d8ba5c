"""Standard streams that are closed or full: exit codes of their own, and never 1."""

import os
import subprocess
import sys

import pytest

from comove.compiled.counting import ONCE
from tests.cli.test_cli import SCENE
from tests.commands import invoke

VERBS = [
    (),
    ("solve",),
    ("verify",),
    ("show",),
    ("library", "list"),
    ("robot",),
    ("bench",),
]
FULL = "/dev/full"
needs_full = pytest.mark.skipif(not os.path.exists(FULL), reason="needs a device that is full")


def started(*arguments, **options):
    command = [sys.executable, "-m", "comove", *map(str, arguments)]
    return subprocess.run(command, stderr=subprocess.PIPE, text=True, timeout=600, **options)


def into_a_closed_pipe(*arguments, **options):
    reading, writing = os.pipe()
    os.close(reading)
    try:
        return started(*arguments, stdout=writing, **options)
    finally:
        os.close(writing)


def into_a_full_disk(*arguments, **options):
    with open(FULL, "wb") as full:
        return started(*arguments, stdout=full, **options)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A folder with a scene, its result, and one that is not verified."""
    folder = tmp_path_factory.mktemp("streams")
    (folder / "good.yaml").write_text(SCENE)
    (folder / "other.yaml").write_text(SCENE.replace("name: test", "name: other"))
    assert invoke("solve", folder / "good.yaml", "--out", folder / "good").exit_code == 0
    return folder


@pytest.mark.parametrize("verb", VERBS, ids=" ".join)
@pytest.mark.few(2)
def test_help_into_a_closed_pipe_ends_quietly(verb):
    outcome = into_a_closed_pipe(*verb, "--help")
    assert (outcome.returncode, outcome.stderr) == (141, "")


@needs_full
@pytest.mark.parametrize("verb", VERBS, ids=" ".join)
@pytest.mark.few(2)
def test_help_onto_a_full_disk_says_so(verb):
    outcome = into_a_full_disk(*verb, "--help")
    assert outcome.returncode == 74
    assert outcome.stderr.startswith("error: standard output cannot be written: No space left")
    assert outcome.stderr.count("\n") == 1


SAYING = [
    ("verify", "good.yaml", "good"),
    pytest.param(("show", "good"), marks=pytest.mark.slow),
    pytest.param(("solve", "good.yaml", "--out", "again", "--json"), marks=pytest.mark.slow),
    pytest.param(("solve", "good.yaml", "--out", "again"), marks=pytest.mark.slow),
    pytest.param(("run", "good.yaml", "--out", "ran"), marks=pytest.mark.slow),
    ("library", "list", "--json"),
    ("--version",),
]


@pytest.mark.parametrize("command", SAYING, ids=" ".join)
@pytest.mark.few(1)
def test_what_is_told_into_a_closed_pipe(folder, command):
    outcome = into_a_closed_pipe(*command, cwd=folder)
    said = [line for line in outcome.stderr.splitlines() if not line.startswith(ONCE)]
    assert (outcome.returncode, said) == (141, [])


@needs_full
@pytest.mark.parametrize("command", SAYING, ids=" ".join)
@pytest.mark.few(1)
def test_what_is_told_onto_a_full_disk(folder, command):
    outcome = into_a_full_disk(*command, cwd=folder)
    assert outcome.returncode == 74
    assert "No space left" in outcome.stderr
    assert "Traceback" not in outcome.stderr


@pytest.mark.slow
def test_a_result_is_there_before_the_pipe_is_found_closed(folder):
    into_a_closed_pipe("solve", "good.yaml", "--out", "piped", cwd=folder)
    assert started("verify", "good.yaml", "piped", cwd=folder, stdout=subprocess.PIPE).returncode == 0


@pytest.mark.parametrize(
    ("command", "code"),
    [
        (("verify", "good.yaml", "good"), 0),
        (("verify", "other.yaml", "good"), 1),
        (("verify", "none.yaml", "good"), 2),
    ],
    ids=lambda x: "_".join(x) if isinstance(x, tuple) else str(x),
)
@pytest.mark.parametrize("closing", ["<&- >&- 2>&-", ">&-", "2>/dev/full"])
@pytest.mark.few(1)
def test_streams_that_are_closed_do_not_change_the_verdict(folder, command, code, closing):
    shell = f'"$0" -m comove "$@" {closing}'
    outcome = subprocess.run(
        ["sh", "-c", shell, sys.executable, *command], cwd=folder, timeout=600, capture_output=True, text=True
    )
    assert outcome.returncode == code, outcome.stderr
    assert "Traceback" not in outcome.stderr


def test_a_pipe_that_does_not_wait_gets_everything(folder):
    reading, writing = os.pipe()
    os.set_blocking(writing, False)
    with os.fdopen(reading, "rb") as output:
        outcome = subprocess.Popen(
            [sys.executable, "-m", "comove", "show", "good"], stdout=writing, cwd=folder
        )
        os.close(writing)
        assert output.read().startswith(b"test: ")
        assert outcome.wait(timeout=600) == 0


ENVIRONMENTS = {
    "ascii": {"PYTHONUTF8": "0", "LC_ALL": "C", "PYTHONCOERCECLOCALE": "0"},
    "ascii output": {"PYTHONIOENCODING": "ascii"},
    "latin output": {"PYTHONIOENCODING": "latin-1"},
    "narrow": {"COLUMNS": "1"},
    "odd": {"COLUMNS": "x", "LINES": "-1", "TERM": "", "PYTHONUNBUFFERED": "1", "HOME": "/nowhere"},
}


@pytest.mark.parametrize(
    "environment",
    [
        pytest.param(environment, marks=() if name == "ascii" else pytest.mark.slow, id=name)
        for name, environment in ENVIRONMENTS.items()
    ],
)
@pytest.mark.slow
def test_any_environment_will_do(folder, environment):
    environment = {key: value for key, value in os.environ.items() if key != "TERM"} | environment
    options = {"cwd": folder, "env": environment, "stdout": subprocess.PIPE, "errors": "replace"}
    commands = [("show", "good"), ("verify", "good.yaml", "good"), ("--help",)]
    if environment.get("PYTHONUTF8") == "0":
        (folder / "s.yaml").write_text(SCENE.replace("name: test", "name: näme"), encoding="utf-8")
        commands = [("solve", "s.yaml", "--out", "aüs"), ("show", "aüs"), ("verify", "s.yaml", "aüs")]
    for command in commands:
        outcome = started(*command, **options)
        assert (outcome.returncode, outcome.stderr) == (0, "")
        assert outcome.stdout
