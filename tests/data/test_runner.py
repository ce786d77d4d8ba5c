"""Whatever is killed, each run of a study is in its store once, and as if nothing had been killed."""

import contextlib
import os
import random
import resource
import signal
import sqlite3
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import pytest

from comove.data import Shard, Study, StudyStore, many, on_processes, run_study, runner
from comove.data.runs import RUNS, UNREPEATED, StudyRun, merge
from comove.errors import OptionError, ResultError
from tests.data.works import FakeStudy

ROOT = Path(__file__).parents[2]


def rows(folder):
    """All that a store says but for times, and the motions."""
    store = StudyStore.open(folder / RUNS)
    runs = [replace(run, **dict.fromkeys(UNREPEATED)) for run in store.runs()]
    return runs, [motion for _, motion in store.motions()]


def start(folder, *, workers=2, total=40, pause=0.02, room=None):
    path = os.pathsep.join([str(ROOT), str(ROOT / "src")])
    log = folder.with_suffix(".log")
    return subprocess.Popen(
        [sys.executable, "-m", "tests.data.driver", *map(str, (folder, workers, total, pause, log))],
        env={**os.environ, "PYTHONPATH": path},
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
        preexec_fn=None if room is None else lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (room, room)),
    )


def children(pid):
    return [int(p) for p in Path(f"/proc/{pid}/task/{pid}/children").read_text().split()]


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """The rows of a study that nothing disturbed, on one process."""
    folder = tmp_path_factory.mktemp("whole")
    run_study(FakeStudy(40), folder, on_processes(1))
    return rows(folder)


@pytest.mark.parametrize(
    ("file", "kind"), [("planar", {"planar plans"}), ("baxter", {"spatial plans", "robot motions"})]
)
def test_kernels_are_compiled_before_processes_that_would_compile_alone(monkeypatch, file, kind):
    done = []
    monkeypatch.setattr(many, "require", lambda *names: done.append({*names}))
    monkeypatch.setattr(runner, "run_tasks", lambda *_, **__: done.append("processes"))
    study = Study.load(ROOT / "examples" / "studies" / f"{file}.yaml")
    on_processes(2)(study, lambda: None, 1.0)
    assert done[0] >= kind and done[1:] == ["processes"]


@pytest.mark.parametrize(
    ("sql", "told"),
    [("cost = 'abc'", "cost is 'abc'"), ("seed = NULL", "seed is None"), ("number = 1.5", "1.5")],
)
def test_a_row_that_was_edited_is_told(tmp_path, sql, told):
    store = StudyStore.create(tmp_path / RUNS)
    with store.writer() as writer:
        writer.add(StudyRun("k", 0, status="verified", cost=1.0))
    assert [run.key for run in store.runs()] == ["k"]
    with store.connected() as connection:
        connection.execute(f"UPDATE runs SET {sql}")
    with pytest.raises(ResultError, match=f"the row 'k' was changed: .*{told}; copy it again"):
        list(store.runs())


@pytest.mark.slow
def test_all_runs_are_there_in_any_number_of_processes_and_parts(tmp_path, whole):
    assert [run.number for run in whole[0]] == list(range(40)) and len(whole[1]) == 40
    run_study(FakeStudy(40), tmp_path / "two", on_processes(2))
    assert rows(tmp_path / "two") == whole
    parts = [tmp_path / f"part-{i}" for i in (1, 2, 3)]
    for i, part in enumerate(parts, 1):
        done = run_study(FakeStudy(40), part, on_processes(1), shard=Shard(i, 3))
        assert done.done == done.total == len(rows(part)[0])
    merged = merge(parts, tmp_path / "merged")
    assert (merged.ended, merged.total, merged.different) == (40, 40, 0)
    assert rows(tmp_path / "merged") == whole
    assert merge(parts, tmp_path / "merged").ended == 40
    assert rows(tmp_path / "merged") == whole


@pytest.mark.slow
def test_what_is_there_is_not_run_again_and_more_can_be_asked_for(tmp_path, whole):
    log = tmp_path / "log"
    run_study(FakeStudy(25, log=log), tmp_path / "study", on_processes(2))
    told = []
    run_study(FakeStudy(40, log=log), tmp_path / "study", on_processes(2), tell=told.append)
    assert (told[0].before, told[0].done, told[-1].done, told[-1].verified) == (25, 25, 40, 15)
    assert rows(tmp_path / "study") == whole
    assert sorted(map(int, log.read_text().split())) == list(range(40))
    assert StudyStore.open(tmp_path / "study" / RUNS).total() == 40
    run_study(FakeStudy(10), tmp_path / "study", on_processes(1))  # fewer: nothing is lost
    assert rows(tmp_path / "study") == whole


@pytest.mark.slow
def test_three_kills_mark_a_run_and_the_rest_goes_on(tmp_path):
    study = FakeStudy(12, killers=(3, 7), raisers=(5,), log=tmp_path / "log")
    run_study(study, tmp_path / "study", on_processes(2))
    begun = (tmp_path / "log").read_text().split()
    assert begun.count("3") == begun.count("7") == 3 and len(begun) == 16
    found = {run.number: (run.status, run.reason) for run in rows(tmp_path / "study")[0]}
    assert found.pop(3) == found.pop(7) == ("killed", "its process was killed 3 times")
    assert found.pop(5) == ("refused", "not 5; another")
    assert set(found.values()) == {("verified", "")} and len(found) == 9


@pytest.mark.slow
def test_kills_are_counted_over_resumed_runs(tmp_path):
    study = FakeStudy(3, killers=(1,))
    store = StudyStore.create(tmp_path / RUNS)
    with store.writer() as writer:
        assert [writer.note_kill(study.key(1)) for _ in range(2)] == [1, 2]
    log = tmp_path.with_suffix(".log")
    run_study(replace(study, log=log), tmp_path, on_processes(1))
    assert log.read_text().split().count("1") == 1
    assert rows(tmp_path)[0][1].status == "killed"


@pytest.mark.slow
def test_an_edited_study_is_refused_with_what_changed(tmp_path, whole):
    run_study(FakeStudy(3), tmp_path / "study", on_processes(1))
    with pytest.raises(ResultError, match=r"edited since: salt was 0 and is 1; give the study"):
        run_study(FakeStudy(3, salt=1), tmp_path / "study", on_processes(1))
    run_study(FakeStudy(3, salt=1), tmp_path / "other", on_processes(1))
    with pytest.raises(ResultError, match=r"holds another study than .*: salt was 0 and is 1"):
        merge([tmp_path / "study", tmp_path / "other"], tmp_path / "merged")
    assert not (tmp_path / "merged").exists()


@pytest.mark.slow
def test_two_drivers_at_one_store_are_refused(tmp_path, whole):
    first = start(tmp_path / "study")
    assert first.stdout.readline()
    second = start(tmp_path / "study")
    _, err = second.communicate(timeout=600)
    assert second.returncode == 1
    assert "another process works on it at present" in err.splitlines()[-1]
    first.communicate(timeout=600)
    assert rows(tmp_path / "study") == whole


def test_other_folders_and_files_are_refused(tmp_path):
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "note.txt").write_text("mine")
    (tmp_path / "file").write_text("mine")
    (tmp_path / "db").mkdir()
    with sqlite3.connect(tmp_path / "db" / RUNS) as other:
        other.execute("CREATE TABLE things (a)")
    other.close()
    for name, told in (("full", "holds no study"), ("file", "it is a file"), ("db", "no store of runs")):
        with pytest.raises(ResultError, match=told):
            run_study(FakeStudy(1), tmp_path / name, on_processes(1))
    with pytest.raises(OptionError, match="--workers"):
        on_processes(0)
    with pytest.raises(ResultError, match="no such file"):
        merge([tmp_path / "none"], tmp_path / "out")


def test_a_store_of_another_version_is_refused(tmp_path):
    run_study(FakeStudy(1), tmp_path, on_processes(1))
    with sqlite3.connect(tmp_path / RUNS) as store:
        store.execute("ALTER TABLE runs ADD COLUMN more TEXT")
    store.close()
    with pytest.raises(ResultError, match="another version of comove"):
        run_study(FakeStudy(1), tmp_path, on_processes(1))


@pytest.mark.skipif(not hasattr(signal, "SIGXFSZ"), reason="files have no limit here")
@pytest.mark.slow
def test_a_full_disk_is_told_and_what_had_ended_is_there(tmp_path, whole):
    """The disk is full in the middle: one sentence; with room again, the same call goes on."""
    driver = start(tmp_path / "study", workers=1, pause=0.0, room=60_000)
    _, err = driver.communicate(timeout=600)
    assert driver.returncode == 1
    assert "comove.errors.ResultError: " in err.splitlines()[-1] and "make room" in err.splitlines()[-1]
    before = rows(tmp_path / "study")
    assert 0 < len(before[0]) < 40 and before[0] == whole[0][: len(before[0])]
    run_study(FakeStudy(40), tmp_path / "study", on_processes(1))
    assert rows(tmp_path / "study") == whole


@pytest.mark.parametrize("text", ["1", "0/2", "3/2", "a/b", "1/2/3", "-1/2"])
def test_bad_shards(text):
    with pytest.raises(OptionError, match="--shard"):
        Shard.parse(text)


def test_shards_divide_all_runs():
    for total in (0, 1, 7, 12):
        numbers = [n for i in range(1, 6) for n in Shard.parse(f"{i}/5").numbers(total)]
        assert sorted(numbers) == list(range(total))


@pytest.mark.slow
def test_kills_at_random_moments_lose_nothing(tmp_path):
    """Workers, the driver, and all at once as in a power cut, six times, until the study is done."""
    rng, folder, total = random.Random(0), tmp_path / "study", 400
    for what in rng.choices(["worker", "driver", "all"], k=6):
        driver = start(folder, total=total, pause=0.01)
        if rng.random() < 0.7:  # else while it starts
            driver.stdout.readline()
        time.sleep(rng.uniform(0.0, 1.0))
        victims = [] if what == "driver" else children(driver.pid)
        for pid in victims[:1] if what == "worker" else [*victims, driver.pid]:
            with contextlib.suppress(ProcessLookupError):
                os.kill(pid, signal.SIGKILL)
        time.sleep(rng.uniform(0.0, 0.5))
        driver.kill()
        driver.communicate(timeout=600)
    last = start(folder, total=total, pause=0.0)
    _, err = last.communicate(timeout=600)
    assert last.returncode == 0, err
    run_study(FakeStudy(total), tmp_path / "whole", on_processes(1))
    assert rows(folder) == rows(tmp_path / "whole")
