"""Commands that are ended while they write: the old result or the new one, and nothing half-written left behind."""

import json
import os
import shutil
import signal
import subprocess
import sys
import time

import pytest
import yaml

from tests.cli.test_cli import SCENE
from tests.cli.test_run import SCENE as RUN

pytestmark = pytest.mark.skipif(not hasattr(signal, "SIGHUP"), reason="signals are Unix's")

VERBS = {
    "solve": (SCENE, ("--budget", "1"), "solution.json"),
    "run": (yaml.safe_dump(RUN), (), "run.json"),
}


@pytest.fixture(scope="module", params=["solve", pytest.param("run", marks=pytest.mark.slow)])
def made(request, tmp_path_factory):
    """A folder with a scene and the result of a command."""
    folder = tmp_path_factory.mktemp(request.param)
    (folder / "scene.yaml").write_text(VERBS[request.param][0])
    done = subprocess.run(command(request.param), cwd=folder, capture_output=True)
    assert done.returncode == 0, done.stderr
    return folder, request.param


@pytest.fixture
def folder(made, tmp_path):
    shutil.copytree(made[0], tmp_path / "copy")
    return tmp_path / "copy"


def command(verb):
    return [
        sys.executable,
        "-m",
        "comove",
        verb,
        "scene.yaml",
        *VERBS[verb][1],
        "--out",
        "out",
        "--seed",
        "3",
    ]


def ended_while_writing(folder, verb, number):
    """Start a command and end it by a signal once it writes; its exit code."""
    process = subprocess.Popen(command(verb), cwd=folder, stderr=subprocess.PIPE, stdout=subprocess.PIPE)
    while process.poll() is None and not any(name.startswith(".out.") for name in drafts(folder)):
        time.sleep(0.002)
    assert process.poll() is None
    process.send_signal(number)
    told = process.communicate(timeout=600)[1].decode()
    assert "Traceback" not in told
    return process.returncode


def drafts(folder):
    return [name for name in os.listdir(folder) if name.startswith(".")]


def is_whole(folder, made):
    """Whether a folder holds all files of a result, and its summary can be read."""
    first, verb = made
    json.loads((folder / "out" / VERBS[verb][2]).read_text())
    return set(os.listdir(folder / "out")) == set(os.listdir(first / "out"))


@pytest.mark.parametrize("name", ["SIGTERM", "SIGINT", "SIGHUP"])
@pytest.mark.slow
def test_what_ends_a_command_leaves_nothing_behind(made, folder, name):
    number = getattr(signal, name)
    assert ended_while_writing(folder, made[1], number) in (0, 130 if name == "SIGINT" else 128 + number)
    assert drafts(folder) == []
    assert is_whole(folder, made)


@pytest.mark.slow
def test_what_a_killed_command_leaves_goes_with_the_next(made, folder):
    assert ended_while_writing(folder, made[1], signal.SIGKILL) == -signal.SIGKILL
    assert is_whole(folder, made)
    assert len(drafts(folder)) == 1
    done = subprocess.run(command(made[1]), cwd=folder, capture_output=True)
    assert done.returncode == 0, done.stderr
    assert drafts(folder) == []
    assert is_whole(folder, made)
