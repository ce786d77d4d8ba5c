"""The store of runs keeps what is written, once, and says what is wrong with other files."""

import sqlite3
import subprocess
import sys
from dataclasses import replace

import pytest

from comove.errors import ResultError
from comove.lab.bench.store import (
    Configuration,
    Figures,
    Machine,
    Run,
    RunStore,
)

WHAT = Configuration("easy", "planar-00", "ab12", "comove", 0, 10.0, "0.1.0")
RUN = Run(
    WHAT,
    "verified",
    "",
    "2025-01-01T00:00:00.000+00:00",
    Machine("a processor", 2, "3.11.0"),
    Figures(1.5, 0.01, 0.25, 1.5, 2.0, 3.0, 1e-7, 0.004),
    ((0.01, 0.5), (1.5, 0.25)),
)


def add(store, *runs):
    """Write runs into a store."""
    with store.writer() as writer:
        for run in runs:
            writer.add(run)


def test_what_is_written_is_read(tmp_path):
    store = RunStore.create(tmp_path / "runs.sqlite")
    missing = Run(replace(WHAT, seed=1), "error", "ValueError: no", RUN.started, RUN.machine)
    add(store, RUN, missing)
    assert list(RunStore.open(store.path).runs()) == [RUN, missing]
    assert store.keys() == {RUN.configuration.key, missing.configuration.key}


def test_the_first_row_of_a_key_stays(tmp_path):
    store = RunStore.create(tmp_path / "runs.sqlite")
    add(store, RUN, replace(RUN, status="error"))
    assert list(store.runs()) == [RUN]


@pytest.mark.parametrize("name", Configuration.__dataclass_fields__)
def test_the_key_is_of_the_whole_configuration(name):
    other = replace(WHAT, **{name: 7 if name in ("seed", "budget") else "other"})
    assert other.key != WHAT.key
    assert replace(WHAT).key == WHAT.key


def test_plans_and_kills(tmp_path):
    store = RunStore.create(tmp_path / "runs.sqlite")
    with store.writer() as writer:
        writer.plan([WHAT, WHAT])
        assert store.planned() == [WHAT]
        assert [writer.note_kill("k") for _ in range(3)] == [1, 2, 3]
        with pytest.raises(ResultError, match="another process works on it at present"), store.writer():
            pass


def test_other_files_are_refused_and_left_alone(tmp_path):
    text, other = tmp_path / "text.sqlite", tmp_path / "other.sqlite"
    text.write_text("no database, but long enough to have a header of a hundred bytes " * 9)
    with sqlite3.connect(other) as connection:
        connection.execute("CREATE TABLE runs (a)")
    connection.close()
    before = other.read_bytes()
    for make in (RunStore.open, RunStore.create):
        with pytest.raises(ResultError, match="it is no SQLite file"):
            make(text)
        with pytest.raises(ResultError, match="no store of runs"):
            make(other)
        with pytest.raises(ResultError, match="it is a folder"):
            make(tmp_path)
    with pytest.raises(ResultError, match="no such file"):
        RunStore.open(tmp_path / "none.sqlite")
    with pytest.raises(ResultError, match="its folder is not there"):
        RunStore.create(tmp_path / "none" / "runs.sqlite")
    assert text.read_text().startswith("no database")
    assert other.read_bytes() == before


def test_parquet(tmp_path):
    parquet = pytest.importorskip("pyarrow.parquet")
    store = RunStore.create(tmp_path / "runs.sqlite")
    add(store, RUN)
    add(store, Run(replace(WHAT, seed=1), "error", "ValueError: no", RUN.started, RUN.machine))
    assert store.write_parquet(tmp_path / "runs.parquet") == 2
    table = parquet.read_table(tmp_path / "runs.parquet").to_pydict()
    assert list(table) == list(RunStore.KINDS)
    assert table["cost"] == [0.25, None]
    assert table["seed"] == [0, 1]
    with pytest.raises(ResultError, match="cannot be written"):
        store.write_parquet(tmp_path / "none" / "runs.parquet")


OTHERS = [
    ("ALTER TABLE runs ADD COLUMN more TEXT", "another version of comove: its table 'runs'"),
    ("ALTER TABLE runs DROP COLUMN jerk_max", "another version of comove: its table 'runs'"),
    ("ALTER TABLE runs RENAME COLUMN cost TO costs", "another version of comove: its table 'runs'"),
    ("ALTER TABLE planned ADD COLUMN more TEXT", "another version of comove: its table 'planned'"),
    ("DROP TABLE runs", "no table 'runs': it was not finished"),
    ("UPDATE runs SET history = 'x'", "the row '.{12}' was changed: Expecting value"),
    ("UPDATE runs SET history = '[1, 2]'", "was changed"),
    ("UPDATE runs SET cost = 'abc'", "was changed: cost is 'abc'"),
    ("UPDATE runs SET cost = x'00'", "was changed: cost is b"),
    ("UPDATE runs SET seed = NULL", "was changed: seed is None"),
    ("UPDATE runs SET status = 'great'", "was changed: it is not what was run"),
    ("UPDATE runs SET budget = 11", "was changed: it is not what was run"),
]


@pytest.mark.parametrize(("sql", "told"), OTHERS)
def test_stores_of_other_versions_and_changed_rows_are_told(tmp_path, sql, told):
    pytest.importorskip("pyarrow")
    store = RunStore.create(tmp_path / "runs.sqlite")
    add(store, RUN)
    with sqlite3.connect(store.path) as connection:
        connection.execute(sql)
    connection.close()
    readers = (
        lambda: list(RunStore.open(store.path).runs()),
        lambda: RunStore.open(store.path).write_parquet(tmp_path / "p"),
    )
    for read in readers:
        with pytest.raises(ResultError, match=told) as caught:
            read()
        assert caught.value.way_out and str(store.path) in str(caught.value)
        assert not (tmp_path / "p").exists()


def test_a_store_that_was_not_finished_is_finished(tmp_path):
    path = tmp_path / "runs.sqlite"
    with sqlite3.connect(path) as connection:
        connection.execute(f"PRAGMA application_id = {RunStore.APPLICATION}")
    connection.close()
    add(RunStore.create(path), RUN)
    assert list(RunStore.open(path).runs()) == [RUN]


@pytest.mark.parametrize("length", [16, 50, 100, 4096, 9000])
def test_a_store_that_is_cut_off_is_told(tmp_path, length):
    store = RunStore.create(tmp_path / "runs.sqlite")
    add(store, RUN)
    store.path.write_bytes(store.path.read_bytes()[:length])
    for read in (
        lambda: list(RunStore.open(store.path).runs()),
        lambda: add(RunStore.create(store.path), RUN),
    ):
        with pytest.raises(ResultError, match=r"no SQLite file|malformed; copy it again"):
            read()


@pytest.mark.slow
def test_many_at_once_make_one_store(tmp_path):
    """No matter who is first."""
    code = (
        "import sys\nfrom comove.lab.bench.store import RunStore\n"
        "sys.stdin.read()\nRunStore.create(sys.argv[1])"
    )
    for turn in range(2):
        path = tmp_path / f"{turn}.sqlite"
        makers = [
            subprocess.Popen(
                [sys.executable, "-c", code, path], stdin=subprocess.PIPE, stderr=subprocess.PIPE
            )
            for _ in range(4)
        ]
        for maker in makers:
            maker.stdin.close()
        assert [maker.stderr.read() for maker in makers] == [b""] * 4
        assert [maker.wait() for maker in makers] == [0] * 4
        add(RunStore.open(path), RUN)
        assert list(RunStore.open(path).runs()) == [RUN]


def test_a_store_where_nobody_may_write_is_read(tmp_path, monkeypatch):
    """As SQLite says it on such a medium, where it could not make the files that it works with."""
    store = RunStore.create(tmp_path / "runs.sqlite")
    add(store, RUN)
    connect = sqlite3.connect

    def on_such_a_medium(database, **options):
        if not options.get("uri"):
            raise sqlite3.OperationalError("unable to open database file")
        assert "mode=ro" in database and "immutable=1" in database
        return connect(database, **options)

    monkeypatch.setattr(sqlite3, "connect", on_such_a_medium)
    assert list(RunStore.open(store.path).runs()) == [RUN]
    with pytest.raises(
        ResultError, match="cannot be used: unable to open database file; make room, or name a file"
    ):
        add(store, RUN)
    (tmp_path / "runs.sqlite-wal").write_bytes(b"rows")
    with pytest.raises(ResultError, match=r"its last rows lie in runs.sqlite-wal.*copy both files"):
        RunStore.open(store.path)
