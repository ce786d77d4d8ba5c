"""Where results cannot go is told before any work, in one sentence, and nothing is left behind."""

import os
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

import pytest

from comove.cli import bench, demo, learn, library, reproduce, robot, run, show, solve, verify  # noqa: F401
from comove.errors import ResultError
from comove.io.folders import check_target
from comove.results import RESULT
from tests.cli.test_cli import SCENE, SWING
from tests.cli.test_cli import run as started
from tests.commands import invoke

FOLDERS = {
    "solve": ("solve", "scene.yaml", "--budget", "100"),
    "run": ("run", "scene.yaml"),
    "demo": ("demo",),
    "reproduce": ("reproduce",),
    "solve by a robot": ("solve", "scene.yaml", "--robot", "two_pandas"),
    "bench draw": ("bench", "draw", "easy"),
    "bench scaling": ("bench", "scaling"),
}
FILES = {
    "learn": ("learn", "swing.csv"),
    "combine": ("library", "combine", "scene.yaml", "--budget", "100"),
    "picture": ("library", "list"),
}
LONG = "x" * 300


@pytest.fixture
def place(tmp_path, monkeypatch):
    """A folder to work in, with things that are in the way, where no work is ever begun."""
    (tmp_path / "scene.yaml").write_text(SCENE)
    (tmp_path / "swing.csv").write_text(SWING)
    (tmp_path / "file").write_text("mine")
    (tmp_path / "thesis").mkdir()
    (tmp_path / "thesis" / "chapter1.tex").write_text("mine")
    (tmp_path / "loop").symlink_to("loop")
    os.mkfifo(tmp_path / "pipe")
    monkeypatch.chdir(tmp_path)

    def working(*_, **__):
        pytest.fail("work was begun")

    for name in ("planning.solve", "planning.load_kernels", "lab.evolution.combine", "dmp.learn"):
        monkeypatch.setattr(f"comove.{name}", working)
    for name in ("control.Executor", "solving.solve", "lab.paper.page.reproduce"):
        monkeypatch.setattr(f"comove.{name}", working)
    for name in ("sets.drawn", "scaling.measure"):
        monkeypatch.setattr(f"comove.lab.bench.{name}", working)
    return tmp_path


def refused(place, *arguments):
    before = sorted(place.rglob("*"))
    outcome = invoke(*arguments)
    assert outcome.exit_code == 2, (arguments, outcome.exception)
    assert outcome.stdout == ""
    assert outcome.stderr.startswith("error: ")
    assert outcome.stderr.count("\n") == 1
    assert len(outcome.stderr) < 1500
    assert sorted(place.rglob("*")) == before
    return outcome.stderr


BAD_FOLDERS = {
    "file": "it is a file",
    "file/below": "Not a directory",
    "thesis": "the folder is not empty",
    "pipe": "it is a file",
    "loop": "links in its path lead round in a circle",
    "loop/below": "links in its path lead round in a circle",
    LONG: "the name is too long",
    f"new/{LONG}": "the name is too long",
    f"new/{LONG}/below": "the name is too long",
    "/proc/comove": "cannot be written",
    "/dev/null": "it is a file",
    "/dev/full": "it is a file",
    "": "",
}


@pytest.mark.parametrize("out", BAD_FOLDERS)
@pytest.mark.parametrize("verb", FOLDERS)
@pytest.mark.few(23)
def test_folders_that_results_cannot_go_to(place, verb, out):
    if verb == "demo" and out in ("", "thesis"):
        pytest.skip("its results go into folders of their own there")
    said = refused(place, *FOLDERS[verb], "--out", out)
    assert BAD_FOLDERS[out] in said or (verb == "demo" and "Not a directory" in said)


BAD_FILES = {
    "thesis": "no file",
    "file/below.png": "Not a directory",
    "pipe": "no file",
    "new/below.png": "there is no folder",
    "loop": "links in its path lead round in a circle",
    LONG + ".png": "the name is too long",
    "/proc/comove.png": "cannot be written",
    "/dev/null": "no file",
    "": "",
}


@pytest.mark.parametrize("out", BAD_FILES)
@pytest.mark.parametrize("verb", FILES)
@pytest.mark.few(9)
def test_files_that_results_cannot_go_to(place, verb, out):
    said = refused(place, *FILES[verb], "--out", out)
    assert BAD_FILES[out] in said or "is no picture's name" in said


def test_pictures_that_cannot_be_drawn_are_told_before_the_search(place):
    for picture in ("new/a.png", "a.txt", LONG + ".png"):
        refused(place, "library", "combine", "scene.yaml", "--out", "a.json", "--picture", picture)


def test_a_library_that_nothing_can_be_added_to(place):
    for folder in ("file", "file/below", "loop", LONG, "/proc/comove"):
        refused(place, "library", "add", "swing.csv", "--folder", folder)


def test_the_folder_that_one_is_in_is_not_replaced(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(ResultError, match="the folder that you are in"):
        check_target(".", RESULT)


def test_a_full_disk_is_told_before_any_work(place, monkeypatch):
    usage = shutil.disk_usage(place)
    monkeypatch.setattr(shutil, "disk_usage", lambda _: usage._replace(free=12_000))
    for verb in FOLDERS.values():
        assert "the disk is full: 12 kB of it are free, about 2000 kB are needed" in refused(
            place, *verb, "--out", "new"
        )
    assert "about 100 kB are needed" in refused(place, *FILES["learn"], "--out", "new.json")


@pytest.fixture
def disk():
    """Mounts a small disk; mount it with what options are given."""
    mounted = []

    def mount(options):
        folder = Path(tempfile.mkdtemp())
        done = subprocess.run(["mount", "-t", "tmpfs", "-o", options, "none", folder], capture_output=True)
        if done.returncode:
            folder.rmdir()
            pytest.skip("nothing can be mounted here")
        mounted.append(folder)
        return folder

    yield mount
    for folder in mounted:
        subprocess.run(["umount", folder], check=True)
        folder.rmdir()


def test_a_disk_that_is_full(place, disk):
    folder = disk("size=200k")
    said = refused(place, *FOLDERS["solve"], "--out", folder / "new")
    assert "the disk is full: 20" in said
    assert not list(folder.iterdir())


def test_a_disk_that_fills_up_while_a_result_is_written(tmp_path, disk, monkeypatch):
    (tmp_path / "scene.yaml").write_text(SCENE)
    folder = disk("size=140k")
    monkeypatch.setattr("comove.io.folders.ROOM", 0)
    outcome = invoke("solve", tmp_path / "scene.yaml", "--out", folder / "new")
    assert outcome.exit_code == 2
    assert "it cannot be written: the disk is full, 0." in outcome.stderr
    assert outcome.stderr.count("\n") == 1
    assert not list(folder.iterdir())


def test_a_disk_that_may_only_be_read(place, disk):
    folder = disk("size=200k,ro")
    for verb in FOLDERS.values():
        assert "the disk may only be read" in refused(place, *verb, "--out", folder / "new")
    for verb in FILES.values():
        assert "the disk may only be read" in refused(place, *verb, "--out", folder / "new.png")


def test_a_mounted_folder_is_not_replaced(place, disk):
    folder = disk("size=20M")
    assert f"name a folder in it, such as {folder}/result" in refused(
        place, *FOLDERS["solve"], "--out", folder
    )


@pytest.mark.slow
def test_a_folder_to_work_in_that_may_only_be_read(tmp_path, disk):
    (tmp_path / "scene.yaml").write_text(SCENE)
    locked = disk("size=200k,ro")
    outcome = started("solve", tmp_path / "scene.yaml", "--out", "out", cwd=locked)
    assert (outcome.returncode, "only be read" in outcome.stderr) == (2, True)
    outcome = started("solve", tmp_path / "scene.yaml", "--out", tmp_path / "out", cwd=locked)
    assert (outcome.returncode, outcome.stderr) == (0, "")


@pytest.mark.parametrize(
    "arguments",
    [("solve", "s.yaml", "--out", "o"), ("show", "o"), ("learn", "a.csv", "--out", "b"), ("demo",)],
)
@pytest.mark.few(1)
def test_a_folder_to_work_in_that_is_gone(tmp_path, arguments):
    shell = 'cd "$1" && rmdir "$1" && shift && exec "$0" -m comove "$@"'
    (tmp_path / "gone").mkdir()
    command = ["sh", "-c", shell, sys.executable, tmp_path / "gone", *arguments]
    outcome = subprocess.run(command, capture_output=True, text=True, timeout=600)
    assert outcome.returncode == 2
    assert outcome.stderr.startswith("error: ")
    assert outcome.stderr.count("\n") == 1
