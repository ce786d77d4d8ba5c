"""Runs on a Dask scheduler give the rows that processes give; a scheduler that is not there is one sentence."""

import os
import socket
import subprocess
import sys
from contextlib import ExitStack
from pathlib import Path

import pytest

from comove.data import on_processes, run_study
from comove.data.on_dask import on_dask
from comove.errors import ExtraError, OptionError
from tests.data.test_runner import rows
from tests.data.works import FakeStudy


def test_without_dask_the_way_out_is_told(monkeypatch):
    monkeypatch.setitem(__import__("sys").modules, "distributed", None)
    with pytest.raises(ExtraError, match=r"pip install 'comove\[dask\]'"):
        on_dask("local", 2)


def test_a_scheduler_that_is_not_there(tmp_path):
    pytest.importorskip("distributed")
    with pytest.raises(OptionError, match=r"--dask: no scheduler answers at 'tcp://127.0.0.1:9'"):
        run_study(FakeStudy(2), tmp_path, on_dask("tcp://127.0.0.1:9", 1, timeout=1.0))
    with pytest.raises(OptionError, match="no scheduler answers at 'nonsense://x'"):
        run_study(FakeStudy(2), tmp_path, on_dask("nonsense://x", 1, timeout=1.0))
    run_study(FakeStudy(2), tmp_path, on_processes(1))  # nothing is in the way of going on
    assert len(rows(tmp_path)[0]) == 2


class Dark(FakeStudy):
    """A study whose runs need what no worker has."""

    def require(self):
        raise ExtraError("video of cameras", "video")


@pytest.mark.slow
def test_what_workers_lack_is_told_before_the_first_run(tmp_path):
    pytest.importorskip("distributed")
    told = r"the worker tcp://\S+ cannot do the runs: video of cameras needs more .*comove\[video\]"
    with pytest.raises(OptionError, match=told):
        run_study(Dark(2), tmp_path, on_dask("local", 1))
    assert rows(tmp_path) == ([], [])


@pytest.mark.slow
def test_the_rows_are_those_of_processes(tmp_path):
    pytest.importorskip("distributed")
    run_study(FakeStudy(30), tmp_path / "dask", on_dask("local", 2))
    run_study(FakeStudy(30), tmp_path / "processes", on_processes(1))
    assert rows(tmp_path / "dask") == rows(tmp_path / "processes")


@pytest.mark.slow
def test_what_kills_its_worker_is_marked(tmp_path):
    pytest.importorskip("distributed")
    run_study(FakeStudy(8, killers=(3,), raisers=(5,)), tmp_path, on_dask("local", 2))
    found = {run.number: (run.status, run.reason) for run in rows(tmp_path)[0]}
    assert found.pop(3) == ("killed", "its process was killed 3 times")
    assert found.pop(5) == ("refused", "not 5; another")
    assert set(found.values()) == {("verified", "")} and len(found) == 6


@pytest.mark.slow
def test_a_scheduler_that_is_killed_is_one_sentence_and_the_rest_is_run_later(tmp_path):
    pytest.importorskip("distributed")
    root = Path(__file__).parents[2]
    environment = os.environ | {"PYTHONPATH": os.pathsep.join([str(root), str(root / "src")])}
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    with ExitStack() as running:

        def start(kind, *arguments):
            command = [sys.executable, "-m", f"distributed.cli.dask_{kind}", *arguments, "--no-dashboard"]
            quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
            process = running.enter_context(subprocess.Popen(command, env=environment, **quiet))
            running.callback(process.kill)
            return process

        scheduler = start("scheduler", "--host", "127.0.0.1", "--port", str(port))
        start("worker", f"tcp://127.0.0.1:{port}", "--nthreads", "1", "--no-nanny")

        def kill(progress):
            if progress.done == 10:
                scheduler.kill()

        with pytest.raises(OptionError, match="the scheduler was lost; start it again; the same command"):
            study = FakeStudy(200, pause=0.02)
            run_study(study, tmp_path / "out", on_dask(f"tcp://127.0.0.1:{port}", 1), tell=kill)
    assert 10 <= len(rows(tmp_path / "out")[0]) < 200
    run_study(FakeStudy(200), tmp_path / "out", on_processes(1))
    run_study(FakeStudy(200), tmp_path / "whole", on_processes(1))
    assert rows(tmp_path / "out") == rows(tmp_path / "whole")
