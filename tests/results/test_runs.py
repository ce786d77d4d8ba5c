"""The store of runs keeps what is written, once, and says what is wrong with other files."""

import sqlite3
from dataclasses import replace

import pytest

from comove.errors import ResultError
from comove.results.runs import COLUMNS, Configuration, Figures, Machine, Run, RunStore, export_parquet

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


def test_what_is_written_is_read(tmp_path):
    store = RunStore.create(tmp_path / "runs.sqlite")
    missing = Run(replace(WHAT, seed=1), "error", "ValueError: no", RUN.started, RUN.machine)
    store.add(RUN)
    store.add(missing)
    assert RunStore.open(store.path).runs() == [RUN, missing]
    assert store.keys() == {RUN.configuration.key, missing.configuration.key}


def test_the_first_row_of_a_key_stays(tmp_path):
    store = RunStore.create(tmp_path / "runs.sqlite")
    store.add(RUN)
    store.add(replace(RUN, status="error"))
    assert store.runs() == [RUN]


@pytest.mark.parametrize("name", Configuration.__dataclass_fields__)
def test_the_key_is_of_the_whole_configuration(name):
    other = replace(WHAT, **{name: 7 if name in ("seed", "budget") else "other"})
    assert other.key != WHAT.key
    assert replace(WHAT).key == WHAT.key


def test_plans_and_kills(tmp_path):
    store = RunStore.create(tmp_path / "runs.sqlite")
    store.plan([WHAT, WHAT])
    assert store.planned() == [WHAT]
    assert [store.note_kill("k") for _ in range(3)] == [1, 2, 3]
    store.begin("k", "driver", 7, 100.0)
    store.begin("k", "driver", 8, 200.0)
    assert store.begun("driver") == [("k", 8, 200.0)]
    assert store.begun("other") == []
    store.leave("driver")
    assert store.begun("driver") == []


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
    store.add(RUN)
    store.add(Run(replace(WHAT, seed=1), "error", "ValueError: no", RUN.started, RUN.machine))
    assert export_parquet(store, tmp_path / "runs.parquet") == 2
    table = parquet.read_table(tmp_path / "runs.parquet").to_pydict()
    assert tuple(table) == COLUMNS
    assert table["cost"] == [0.25, None]
    assert table["seed"] == [0, 1]
    with pytest.raises(ResultError, match="cannot be written"):
        export_parquet(store, tmp_path / "none" / "runs.parquet")
