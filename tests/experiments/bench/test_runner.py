"""What is killed loses nothing that had ended; what goes on is as if it had never been interrupted."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from comove.errors import OptionError
from comove.experiments.bench.runner import jobs_of, run_all
from comove.experiments.bench.sets import scenes_of
from comove.experiments.bench.store import RunStore
from comove.experiments.systems import SystemProblem, measured
from tests.experiments.bench.systems import Witnessed

ROOT = Path(__file__).parents[3]
ONE_THREAD = {**os.environ, "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}


def start(store, *arguments):
    command = [sys.executable, "-m", "tests.experiments.bench.driver", str(store), *map(str, arguments)]
    return subprocess.Popen(
        command, env=ONE_THREAD, cwd=ROOT, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )


def drive(store, *arguments):
    process = start(store, *arguments)
    out, err = process.communicate(timeout=120)
    assert process.returncode == 0, err
    return out.splitlines()


def told(store):
    """What a store holds but for times, in an order that does not matter."""
    return sorted(
        (r.configuration.system, r.configuration.scene, r.status, r.message, r.figures.cost)
        for r in RunStore.open(store).runs()
    )


def wait_for(condition, seconds=60.0):
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end, "it did not come to pass"
        time.sleep(0.02)


def children(pid):
    """The processes that a process has started."""
    try:
        return [int(child) for child in Path(f"/proc/{pid}/task/{pid}/children").read_text().split()]
    except OSError:
        return []


def alive(pid):
    try:
        return Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()[0] != "Z"
    except OSError:
        return False


@pytest.fixture(scope="module")
def uninterrupted():
    """The same in this process, one after the other."""
    rows = []
    for frozen in scenes_of("easy", 4):
        outcome = measured(Witnessed("slow"), SystemProblem(frozen.load()))
        rows.append(("slow", frozen.name, "verified", "", outcome.cost))
    return sorted(rows)


@pytest.mark.slow
def test_a_driver_that_is_killed(tmp_path, uninterrupted):
    store = tmp_path / "runs.sqlite"
    process = start(store, 2, "slow")
    for line in process.stdout:
        if int(line) >= 1:
            break
    workers = children(process.pid)
    process.send_signal(signal.SIGKILL)
    process.communicate()
    wait_for(lambda: not any(alive(pid) for pid in workers))
    ended = told(store)
    assert 1 <= len(ended) < 4
    assert set(ended) <= set(uninterrupted)
    lines = drive(store, 2, "slow")
    assert int(lines[0]) >= len(ended)  # it says what was there
    assert told(store) == uninterrupted


@pytest.mark.slow
def test_a_worker_that_is_killed(tmp_path, uninterrupted):
    store = tmp_path / "runs.sqlite"
    process = start(store, 2, "slow")
    wait_for(lambda: children(process.pid))
    os.kill(children(process.pid)[0], signal.SIGKILL)
    _, err = process.communicate(timeout=120)
    assert process.returncode == 0, err
    assert told(store) == uninterrupted


@pytest.mark.slow
def test_three_kills_mark_a_run_and_the_rest_goes_on(tmp_path):
    store = tmp_path / "runs.sqlite"
    drive(store, 2, "witnessed", "killer")
    rows = told(store)
    assert len(rows) == 8
    assert [row[:4] for row in rows if row[2] != "verified"] == [
        ("killer", "planar-01", "killed", "its process was killed 3 times")
    ]
    again = drive(store, 2, "witnessed", "killer")
    assert again[0] == "8"
    assert told(store) == rows


@pytest.mark.slow
@pytest.mark.parametrize("name", ["sleeper", "deaf"])
def test_what_does_not_end_is_stopped(tmp_path, name):
    store = tmp_path / "runs.sqlite"
    drive(store, 2, name, "witnessed")
    rows = told(store)
    stopped = [row[2:4] for row in rows if row[0] == name]
    assert len(stopped) == 4
    assert all(status == "late" and message.startswith("stopped after") for status, message in stopped)
    assert [row[2] for row in rows if row[0] == "witnessed"] == ["verified"] * 4


@pytest.mark.slow
def test_what_throws_refuses_or_offers_nothing_is_a_row(tmp_path):
    store = tmp_path / "runs.sqlite"
    drive(store, 1, "thrower")
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


@pytest.mark.slow
def test_a_second_driver_is_refused_and_nothing_is_done_twice(tmp_path, monkeypatch):
    monkeypatch.setitem(ONE_THREAD, "RUNS_LOG", str(tmp_path / "log"))
    store = tmp_path / "runs.sqlite"
    first = start(store, 1, "logged")
    wait_for(lambda: (tmp_path / "log").exists())
    _, err = start(store, 1, "logged").communicate(timeout=120)
    (tmp_path / "go").touch()
    assert "another process works on it at present" in err.splitlines()[-1]
    first.communicate(timeout=120)
    assert len(told(store)) == 4
    assert sorted((tmp_path / "log").read_text().split()) == sorted(s.name for s in scenes_of("easy", 4))


@pytest.mark.skipif(not hasattr(signal, "SIGXFSZ"), reason="files have no limit here")
@pytest.mark.slow
def test_a_full_disk_is_told_and_no_run_is_blamed_for_it(tmp_path):
    """The disk is full; what had ended before is there, and the same call goes on."""
    store = tmp_path / "runs.sqlite"
    drive(store, 1, "witnessed")
    before = told(store)
    _, err = start(store, 1, "filler").communicate(timeout=120)
    assert "comove.errors.ResultError: " in err.splitlines()[-1]
    assert "the store cannot be used" in err.splitlines()[-1] and "make room" in err.splitlines()[-1]
    assert told(store) == before
    drive(store, 1, "witnessed", "slow")
    assert len(told(store)) == 8
