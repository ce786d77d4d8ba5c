"""`comove bench`: what it writes, what it says, and one sentence for bad input."""

import os
import signal
import sqlite3
import subprocess
import sys
import time

import pytest

from comove.cli.bench import ALL_SETS
from comove.lab.bench.sets import SETS, own_scenes, scenes_of
from comove.lab.bench.store import RunStore
from comove.lab.examples import example_path
from tests.commands import invoke


def bench(*arguments):
    return invoke("bench", *arguments)


def command(*arguments):
    return [sys.executable, "-m", "comove", "bench", *map(str, arguments)]


def refused(outcome, *words):
    """One sentence on stderr, nothing else."""
    assert outcome.exit_code == 2, outcome.output
    assert outcome.stdout == ""
    assert outcome.stderr.startswith("error: ")
    assert outcome.stderr.count("\n") == 1
    for word in words:
        assert word in outcome.stderr


@pytest.fixture
def others(tmp_path):
    """A text and a database of somebody else."""
    text, other = tmp_path / "text.sqlite", tmp_path / "other.sqlite"
    text.write_text("these are no runs, but a text that is long enough for a header\n" * 9)
    with sqlite3.connect(other) as connection:
        connection.execute("CREATE TABLE things (a)")
    connection.close()
    return text, other


def test_drawing(tmp_path):
    outcome = bench("draw", "easy", "--out", tmp_path / "mine", "--count", 2)
    assert outcome.exit_code == 0, outcome.output
    frozen = scenes_of("easy", 2)
    for scene in frozen:
        assert (tmp_path / "mine" / scene.path.name).read_bytes() == scene.path.read_bytes()
    refused(bench("draw", "easy", "--out", tmp_path / "mine"), "the folder is not empty", "name another")
    refused(bench("draw", "hrad", "--out", tmp_path / "new"), "did you mean 'hard'?")
    refused(bench("draw", "hard", "--out", tmp_path / "new", "--count", 0), "--count")
    assert not (tmp_path / "new").exists()


def test_the_help_names_all_sets():
    assert ALL_SETS.split(", ") == list(SETS)


def test_bad_runs(tmp_path, others):
    store = tmp_path / "runs.sqlite"
    refused(bench("run", "--out", store, "--sets", "esay"), "did you mean 'easy'?")
    refused(bench("run", "--out", store, "--sets", "easy,nothing"), "nothing")
    refused(bench("run", "--out", store, "--scenes", 0), "--scenes", "1 to 50")
    refused(bench("run", "--out", store, "--systems", "comvoe"), "did you mean 'comove'?")
    refused(bench("run", "--out", store, "--systems", ","), "nothing to run")
    refused(bench("run", "--out", store, "--seeds", 0), "--seeds")
    refused(bench("run", "--out", store, "--budget", -1), "--budget")
    refused(bench("run", "--out", store, "--workers", 0), "--workers")
    assert not store.exists()
    refused(bench("run", "--out", tmp_path / "none" / "runs.sqlite"), "its folder is not there")
    refused(bench("run", "--out", others[0]), "it is no SQLite file")
    refused(bench("run", "--out", others[1]), "no store of runs")


def test_scenes_of_ones_own(tmp_path):
    """Files and folders of scenes; what is wrong is said before anything is run."""
    store = tmp_path / "runs.sqlite"
    bench("draw", "easy", "--out", tmp_path / "mine", "--count", 2)
    found = own_scenes([tmp_path / "mine", example_path("wide")])
    assert [scene.name for scene in found] == ["planar-00", "spatial-00", "wide"]
    assert {scene.set for scene in found} == {"own"}
    (tmp_path / "empty").mkdir()
    for given, words in (
        ([tmp_path / "none.yaml"], "there is no such file"),
        ([tmp_path / "empty"], "the folder holds no scene"),
        ([tmp_path / "mine", tmp_path / "mine"], "two scenes are called 'planar-00'"),
    ):
        refused(bench("run", *given, "--out", store), words)
    assert not store.exists()


@pytest.mark.slow
def test_runs_of_ones_own_scenes_are_reported(tmp_path):
    store = tmp_path / "runs.sqlite"
    arguments = ("run", example_path("wide"), "--out", store, "--seeds", "2", "--budget", "2")
    done = subprocess.run(command(*arguments), capture_output=True, text=True, timeout=600)
    assert done.returncode == 0, done.stderr
    assert {(r.configuration.set, r.configuration.scene) for r in RunStore.open(store).runs()} == {
        ("own", "wide")
    }
    assert bench("report", store, "--out", tmp_path / "report").exit_code == 0
    assert "| comove | 2/2 |" in (tmp_path / "report" / "report.md").read_text(encoding="utf-8")


def test_bad_stores(tmp_path, others):
    for verb in ("report", "export"):
        refused(bench(verb, others[0], "--out", tmp_path / "out"), "it is no SQLite file")
        refused(bench(verb, others[1], "--out", tmp_path / "out"), "no store of runs")
        refused(bench(verb, tmp_path / "none", "--out", tmp_path / "out"), "no such file")
    empty = RunStore.create(tmp_path / "empty.sqlite")
    refused(bench("report", empty.path, "--out", tmp_path / "out"), "no run has ended yet")
    assert not (tmp_path / "out").exists()


def test_folders_that_cannot_be_written(tmp_path):
    blocked = tmp_path / "file"
    blocked.write_text("a file, where a folder is wanted")
    refused(bench("draw", "easy", "--out", blocked, "--count", 1), "it is a file")
    refused(bench("draw", "easy", "--out", blocked / "in", "--count", 1), "cannot be written")
    refused(bench("scaling", "--out", blocked), "it is a file")
    refused(bench("scaling", "--out", tmp_path / "new", "--of", "setps"), "did you mean 'steps'?")
    assert not (tmp_path / "new").exists()


def test_what_is_missing_is_said_with_the_way_out(tmp_path, monkeypatch):
    store = RunStore.create(tmp_path / "runs.sqlite")
    monkeypatch.setitem(sys.modules, "pyarrow", None)
    refused(bench("export", store.path, "--out", tmp_path / "runs.parquet"), "pip install 'comove[data]'")


@pytest.mark.slow
def test_from_runs_to_a_report(tmp_path):
    store = tmp_path / "runs.sqlite"
    arguments = ("run", "--out", store, "--sets", "easy", "--scenes", "2", "--budget", "2")
    first = subprocess.run(command(*arguments), capture_output=True, text=True, timeout=600)
    assert first.returncode == 0, first.stderr
    assert "holds all 2 runs" in first.stdout
    again = subprocess.run(command(*arguments), capture_output=True, text=True, timeout=600)
    assert "2 of 2 runs were in" in again.stderr
    assert [run.status for run in RunStore.open(store).runs()] == ["verified"] * 2
    assert bench("report", store, "--out", tmp_path / "report").exit_code == 0
    assert "| comove | 2/2 |" in (tmp_path / "report" / "report.md").read_text(encoding="utf-8")
    assert bench("export", store, "--out", tmp_path / "runs.parquet").exit_code == 0


@pytest.mark.slow
def test_interrupted(tmp_path):
    store = tmp_path / "runs.sqlite"
    process = subprocess.Popen(
        command("run", "--out", store, "--sets", "hard", "--budget", "5"),
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )
    end = time.monotonic() + 600
    while not (store.exists() and _count(store) >= 1):
        assert time.monotonic() < end
        time.sleep(0.1)
    os.killpg(process.pid, signal.SIGINT)  # as a terminal does
    _, err = process.communicate(timeout=600)
    assert process.returncode == 130
    assert "of 50 runs are in" in err
    assert "the same command goes on" in err
    assert "Traceback" not in err


def _count(store):
    try:
        return len(RunStore.open(store).keys())
    except Exception:  # it is just being made
        return 0


@pytest.mark.slow
def test_scaling(tmp_path):
    outcome = bench("scaling", "--out", tmp_path / "curves", "--of", "basis", "--repeats", 2, "--no-solve")
    assert outcome.exit_code == 0, outcome.output
    assert "| basis | generation |" in (tmp_path / "curves" / "scaling.md").read_text(encoding="utf-8")
