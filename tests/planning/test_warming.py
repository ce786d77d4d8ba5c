"""The warm-up: jobs are solved once, by other processes, whatever happens to these."""

import json
import os
import subprocess
import sys
import time
from contextlib import contextmanager

import pytest

from comove.compiled import finished as notes
from comove.compiled.counting import shown_by
from comove.planning import SceneKind, warming
from comove.planning.warming import JOBS, WarmUpJob, require, unfinished
from comove.processes import ALONE
from tests.solved import example

WORKS = "tests.processes.works"


@pytest.fixture
def jobs(tmp_path, monkeypatch):
    """Two jobs that take no time, a third that dies and a fourth that fails, and nothing that is finished."""

    def job(name, *arguments):
        return WarmUpJob(f"{WORKS}:{name}", dict(arguments), 1)

    made = {
        "one": job("note", ("folder", str(tmp_path)), ("name", "one")),
        "other": job("note", ("folder", str(tmp_path)), ("name", "other")),
        "dying": job("kill", ("number", 1)),
        "failing": job("failing", ("number", 1)),
        "impossible": WarmUpJob(f"{WORKS}:note", needs=("no_such_module",)),
    }
    monkeypatch.delenv(ALONE)
    monkeypatch.setattr(warming, "JOBS", made)
    monkeypatch.setattr(warming, "_tried", set())
    monkeypatch.setattr(warming, "_Work", Directly)
    monkeypatch.setattr(notes, "folder", lambda: tmp_path)
    monkeypatch.setattr(warming, "folder", lambda: tmp_path)
    monkeypatch.setattr(warming, "_go_on_in_background", (tmp_path / "rest").touch)
    return tmp_path


class Directly:
    """The jobs of these tests, which another process does not find in `JOBS`."""

    def __init__(self, _):
        self.jobs = {name: (job.home, job.arguments) for name, job in warming.JOBS.items()}

    def __call__(self, name):
        """Solve one as a process of a warm-up does."""
        home, arguments = self.jobs[name]
        WarmUpJob(home, arguments).solve()


def noted(folder):
    return sorted(path.name for path in folder.glob("*.note"))


def test_what_is_required_is_solved_once_by_other_processes(jobs):
    require("one", "other")
    assert noted(jobs) == ["one.note", "other.note"]
    assert notes.finished() == {"one", "other"}
    processes = {int(path.read_text()) for path in jobs.glob("*.note")}
    assert os.getpid() not in processes
    for path in jobs.glob("*.note"):
        path.unlink()
    require("one", "other")
    assert not noted(jobs)
    assert unfinished() == ["dying", "failing"]
    assert not (jobs / "rest").exists(), "nobody who only computes starts processes that go on"


def test_a_job_that_dies_is_tried_again_and_one_that_fails_is_not(jobs):
    require("dying", "failing", "one")
    assert notes.finished() == {"failing", "one"}


def test_a_command_shows_it_and_leaves_the_rest_to_the_background(jobs):
    shown = []

    @contextmanager
    def display(state):
        shown.append((state.kernels, state.share))
        yield

    with shown_by(display):
        require("one")
        require("one")
    assert shown == [(1, 0.0)]
    assert (jobs / "rest").exists()


@pytest.mark.slow
def test_the_background_finishes_what_is_left(tmp_path, monkeypatch):
    (tmp_path / "sitecustomize.py").write_text(
        "from comove.planning import warming\nwarming.JOBS.clear()\n"
        f"warming.JOBS['one'] = warming.WarmUpJob('{WORKS}:note', dict(folder={str(tmp_path)!r}, name='one'))\n"
    )
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join([str(tmp_path), *sys.path]))
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path))
    warming._go_on_in_background()
    deadline = time.monotonic() + 60.0
    while not noted(tmp_path) and time.monotonic() < deadline:
        time.sleep(0.05)
    assert noted(tmp_path) == ["one.note"]


def test_the_background_leaves_no_zombie(monkeypatch):
    started = []

    class Noted(subprocess.Popen):
        def __init__(self, *args, **more):
            super().__init__(*args, **more)
            started.append(self.pid)

    monkeypatch.setattr(subprocess, "Popen", Noted)
    monkeypatch.setattr(sys, "executable", "true")
    warming._go_on_in_background()
    deadline = time.monotonic() + 10.0
    with pytest.raises(ProcessLookupError):
        while time.monotonic() < deadline:
            os.kill(started[0], 0)  # which finds zombies, too
            time.sleep(0.01)


def test_processes_that_cannot_be_started_end_no_search(jobs, monkeypatch):
    def refused(*_, **__):
        raise OSError("no more processes")

    monkeypatch.setattr(warming, "run_tasks", refused)
    require("one")
    assert not notes.finished()


def test_without_helpers_this_process_solves_them(jobs, monkeypatch):
    monkeypatch.setenv(ALONE, "1")
    require("one", "failing")
    assert (jobs / "one.note").read_text() == str(os.getpid())
    assert notes.finished() == {"one", "failing"}


def test_where_nothing_can_be_kept_nothing_is_solved(jobs, monkeypatch):
    monkeypatch.setattr(warming, "folder", lambda: None)
    require("one")
    assert not noted(jobs)


@pytest.mark.parametrize(
    "damaged", ["", "[]", "{}", '{"sources": 1, "finished": ["one"]}', '{"finished": 1}']
)
def test_notes_that_are_damaged_or_of_other_sources_say_nothing(jobs, damaged):
    notes.finish("one")
    (file,) = jobs.glob("comove_kernels.*.json")
    assert json.loads(file.read_text())["finished"] == ["one"]
    file.write_text(damaged)
    assert not notes.finished()
    file.write_text(json.dumps({"sources": notes._sources(), "finished": 1}))
    assert not notes.finished()
    notes.finish("other")
    assert notes.finished() == {"other"}


def test_the_jobs_of_a_scene_are_known():
    for name in ("narrow", "window", "turning"):
        assert {*SceneKind.of(example(name)).jobs} <= {*JOBS}
    assert SceneKind.of(example("narrow")) == SceneKind(2)
    assert SceneKind.of(example("turning")) == SceneKind(2, moving=True)


MISSING = """
import comove
from comove.model import Scene
from comove.planning import SceneKind, load_kernels
from comove.compiled.counting import compiling
from comove.planning.warming import require

scenes = [Scene.load(f"{comove.__path__[0]}/examples/{name}.yaml") for name in %r]
for scene in scenes:
    load_kernels(SceneKind.of(scene))
require("executions")
for scene in scenes:
    with compiling(print):
        assert comove.solve(scene, robot=False, budget=60).verified
        if scene.is_timed:
            comove.Executor(scene, robot=False).run(0.2)
"""


@pytest.mark.slow
def test_no_kernel_is_missing_after_its_jobs(tmp_path):
    """From an empty cache: from that of other tests, whatever they compiled would be loaded."""
    command = [sys.executable, "-c", MISSING % (["narrow", "window", "turning", "triangle", "complex"],)]
    empty = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path)}
    done = subprocess.run(command, capture_output=True, text=True, timeout=1200, env=empty)
    assert (done.returncode, done.stdout.split()) == (0, []), done.stderr
