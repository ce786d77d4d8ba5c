"""Every job leaves a row, whatever its system does; what is lost otherwise is tested of studies and pools."""

import os
import signal
import subprocess
import sys
from contextlib import suppress

import pytest

from comove.data import many
from comove.errors import OptionError
from comove.lab.bench import runner
from comove.lab.bench.runner import jobs_of, run_all
from comove.lab.bench.sets import scenes_of
from comove.lab.bench.store import RunStore
from comove.lab.registry import systems_named
from tests.killing import soon
from tests.lab.bench.systems import Killer, Thrower, Witnessed


def drive(store, *systems):
    """Run the first scenes of the easy set; return what is told of the progress."""
    jobs = jobs_of(scenes_of("easy", 4), {system.name: system for system in systems}, budget=0.1)
    told = []
    run_all(store, jobs, 2, told.append)
    return [progress.done for progress in told]


def told(store):
    """What a store holds but for times, in an order that does not matter."""
    return sorted(
        (r.configuration.system, r.configuration.scene, r.status, r.message, r.figures.cost)
        for r in RunStore.open(store).runs()
    )


def test_kernels_are_compiled_before_processes_that_would_compile_alone(tmp_path, monkeypatch):
    done = []
    monkeypatch.setattr(many, "require", lambda *names: done.append({*names}))
    monkeypatch.setattr(runner, "run_tasks", lambda *_, **__: done.append("processes") or ())
    drive(tmp_path / "runs.sqlite", Witnessed())
    assert done[0] >= {"planar plans", "planar motions"} and done[1:] == ["processes"]


@pytest.mark.slow
def test_three_kills_mark_a_run_and_the_rest_goes_on(tmp_path):
    store = tmp_path / "runs.sqlite"
    assert drive(store, Witnessed(), Killer()) == list(range(9))
    rows = told(store)
    assert len(rows) == 8
    assert [row[:4] for row in rows if row[2] != "verified"] == [
        ("killer", "planar-01", "killed", "its process was killed 3 times")
    ]
    assert drive(store, Witnessed(), Killer()) == [8]
    assert told(store) == rows


@pytest.mark.slow
def test_a_command_that_is_killed_leaves_what_had_ended_and_goes_on(tmp_path):
    """`kill -9` of the command alone, and of it with its workers; each run is there once, as if nothing had been."""
    store, total = tmp_path / "runs.sqlite", 36
    words = ["bench", "run", "--sets", "easy", "--scenes", "6", "--seeds", "6", "--budget", "0.3"]
    command = [sys.executable, "-m", "comove", *words, "--workers", "2", "--out", str(store)]

    def ended():
        return [run.configuration.key for run in RunStore.open(store).runs()] if store.exists() else []

    seen = set()
    for n_rows, whole_group in ((1, False), (4, True)):
        with subprocess.Popen(command, stderr=subprocess.DEVNULL, start_new_session=True) as running:
            soon(lambda n_rows=n_rows: len(ended()) >= n_rows)
            (os.killpg if whole_group else os.kill)(running.pid, signal.SIGKILL)
            assert running.wait() == -signal.SIGKILL
        with suppress(ProcessLookupError):
            os.killpg(running.pid, signal.SIGKILL)  # workers that still end their runs
        assert seen <= set(ended())
        seen = set(ended())
        assert len(seen) < total
    last = subprocess.run(command, capture_output=True, text=True, check=False)
    assert last.returncode == 0, last.stderr
    jobs = jobs_of(scenes_of("easy", 6), systems_named(["comove"]), 6, 0.3)
    assert sorted(ended()) == sorted(job.configuration.key for job in jobs)
    assert {run.status for run in RunStore.open(store).runs()} == {"verified"}


@pytest.mark.slow
def test_what_throws_refuses_or_offers_nothing_is_a_row(tmp_path):
    store = tmp_path / "runs.sqlite"
    drive(store, Thrower())
    refused = ("thrower", "refused", "it is in space", None)
    assert [(r[0], *r[2:]) for r in told(store)] == [
        ("thrower", "error", "ValueError: no idea", None),
        ("thrower", "error", "SystemExit: gone", None),
        refused,
        refused,
    ]


@pytest.mark.parametrize(
    ("options", "named"),
    [({"seeds": 0}, "--seeds"), ({"budget": 0.0}, "--budget"), ({"budget": float("nan")}, "--budget")],
)
def test_options_that_make_no_sense(options, named):
    with pytest.raises(OptionError, match=named):
        jobs_of(scenes_of("easy", 2), {}, **options)


def test_nothing_to_run(tmp_path):
    with pytest.raises(OptionError, match="nothing to run"):
        run_all(tmp_path / "runs.sqlite", [])
