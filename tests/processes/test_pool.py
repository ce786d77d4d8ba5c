"""Tasks on other processes: each ends once, whatever happens to its process."""

import os
import signal
import subprocess
import sys
from collections import deque
from pathlib import Path

import pytest

from comove.errors import OptionError
from comove.processes import Ahead, run_tasks
from tests.killing import alive, soon
from tests.processes import works

ROOT = Path(__file__).parents[2]


def tasks(numbers):
    waiting = deque(numbers)
    return waiting, lambda: waiting.popleft() if waiting else None


@pytest.mark.parametrize("workers", [1, 2])
def test_every_task_ends_once(workers):
    _, next_task = tasks(range(50))
    ended = list(run_tasks(works.square, next_task, workers=workers))
    assert sorted((e.task, e.made) for e in ended) == [(n, n * n) for n in range(50)]
    assert not any(e.error or e.killed or e.late for e in ended)


def test_processes_are_kept_and_have_one_thread_and_end():
    _, next_task = tasks(range(8))
    processes = {e.made for e in run_tasks(works.process_of, next_task, workers=2)}
    assert len(processes) == 2 and os.getpid() not in processes
    assert not any(map(alive, processes))
    _, next_task = tasks([0])
    (ended,) = run_tasks(works.threads, next_task, workers=1)
    assert set(ended.made.values()) == {"1"}


def test_a_process_that_is_started_ahead_works_on_one_task():
    with Ahead(works.process_of) as ahead:
        found = ahead.work_on(7)
        assert alive(found.made) and found.made != os.getpid()
    assert not alive(found.made)
    with Ahead(works.failing) as ahead:
        assert ahead.work_on(1).error == "ValueError: no idea"
    with Ahead(works.kill) as ahead:
        found = ahead.work_on(7)
        assert found.killed and found.made is None


def test_what_is_raised_is_told_and_the_process_goes_on():
    _, next_task = tasks(range(6))
    ended = {e.task: e for e in run_tasks(works.failing, next_task, workers=1)}
    assert ended[1].error == "ValueError: no idea" and not ended[1].refused
    assert ended[2].error == "it is two; give another" and ended[2].refused
    assert ended[3].error == "SystemExit: gone"
    assert "pickle" in ended[4].error
    assert ended[5].made == 5


def test_a_killed_process_costs_its_task_alone(tmp_path):
    (tmp_path / "3").write_text("2")
    waiting, next_task = tasks(range(10))
    made, kills = [], 0
    for ended in run_tasks(works.Killing(tmp_path), next_task, workers=2):
        if ended.killed:
            kills += 1
            assert ended.task == 3
            waiting.append(ended.task)
        else:
            made.append(ended.made)
    assert kills == 2 and sorted(made) == list(range(10))


def test_a_task_that_takes_too_long_is_stopped():
    _, next_task = tasks(range(4))
    ended = {e.task: e for e in run_tasks(works.sleeping, next_task, workers=2, allowed=2.0)}
    assert ended[1].late and not ended[1].killed
    assert [ended[n].made for n in (0, 2, 3)] == [0, 2, 3]


def test_an_iterator_that_is_left_ends_its_processes():
    _, next_task = tasks(range(1000))
    running = run_tasks(works.process_of, next_task, workers=2)
    processes = {next(running).made for _ in range(6)}
    running.close()
    assert not any(map(alive, processes))


@pytest.mark.parametrize(
    ("work", "told"),
    [(lambda number: number, "cannot be sent"), (works.Unloadable(), "cannot be taken over.*never again")],
)
def test_work_that_other_processes_cannot_do(work, told):
    _, next_task = tasks([0])
    with pytest.raises(OptionError, match=told):
        list(run_tasks(work, next_task, workers=1))


def test_no_workers():
    with pytest.raises(OptionError, match="workers = 0"):
        list(run_tasks(works.square, lambda: None, workers=0))


PROGRAM = """
import sys
from collections import deque
from comove.processes import run_tasks
from tests.killing import alive, soon
from tests.processes import works
waiting = deque(range(1000))
for ended in run_tasks(works.process_of, waiting.popleft, workers=2):
    print(ended.made, flush=True)
"""


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGKILL])
def test_processes_end_with_the_program(number, tmp_path):
    """A program without a guard for other processes, that is interrupted or killed."""
    program = tmp_path / "program.py"
    program.write_text(PROGRAM)
    path = os.pathsep.join([str(ROOT), str(ROOT / "src"), *filter(None, [os.environ.get("PYTHONPATH")])])
    running = subprocess.Popen(
        [sys.executable, str(program)],
        env={**os.environ, "PYTHONPATH": path},
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    processes = {int(running.stdout.readline()) for _ in range(8)}
    running.send_signal(number)
    running.communicate(timeout=600)
    assert processes and running.returncode != 0
    soon(lambda: not any(map(alive, processes)))
