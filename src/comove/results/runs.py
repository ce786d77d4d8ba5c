"""The store of runs: one SQLite file, one row a run, written as the run ends and never changed.

Several processes may write at once. The key of a row is the hash of what was run, so that nothing is run twice, and
whatever is killed loses no row that was written.
"""

from __future__ import annotations

import hashlib
import json
import sqlite3
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import asdict, astuple, dataclass, fields
from pathlib import Path
from typing import Any

from comove.errors import ExtraError, ResultError

APPLICATION = 0x636F6D76  # "comv", in the header of the file
WAIT = 60.0  # s, for others that write
STATUSES = ("verified", "not verified", "nothing", "refused", "error", "killed", "late")


@dataclass(frozen=True)
class Configuration:
    """What is run.

    Attributes
    ----------
    set, scene : names
    scene_sha256 : of the scene's file
    system : its name
    seed : of all random numbers
    budget : [s]
    version : of comove
    tool : version of the tool behind the system; empty where it is comove itself
    """

    set: str
    scene: str
    scene_sha256: str
    system: str
    seed: int
    budget: float
    version: str
    tool: str = ""

    @property
    def key(self) -> str:
        """SHA-256 of all of it."""
        return hashlib.sha256(json.dumps(asdict(self), sort_keys=True).encode()).hexdigest()


@dataclass(frozen=True)
class Machine:
    """Where it is run: model of the processor, number of its cores, version of Python."""

    cpu: str
    cores: int
    python: str


@dataclass(frozen=True)
class Figures:
    """What was measured, as `comove.experiments.systems.Outcome` says; None where there is nothing to measure."""

    seconds: float | None = None
    first_verified: float | None = None
    cost: float | None = None
    path_length: float | None = None
    acceleration_max: float | None = None
    jerk_max: float | None = None
    distance_error_max: float | None = None
    clearance_min: float | None = None


@dataclass(frozen=True)
class Run:
    """One run.

    Attributes
    ----------
    configuration : what was run
    status : one of `STATUSES`
    message : why, in one line, where it is not "verified"
    started : when, in UTC (ISO 8601)
    machine : where
    figures : what was measured
    history : (seconds, cost) of the verified offers that were better than those before
    """

    configuration: Configuration
    status: str
    message: str
    started: str
    machine: Machine
    figures: Figures = Figures()
    history: tuple[tuple[float, float], ...] = ()


_WHAT, _WHERE, _MEASURED = ([f.name for f in fields(c)] for c in (Configuration, Machine, Figures))
COLUMNS = ("key", *_WHAT, "status", "message", "started", *_WHERE, *_MEASURED, "history")
_REALS = {"budget", *_MEASURED}
_WHOLE = {"seed", "cores"}


def _declared(columns: Iterable[str]) -> str:
    kinds = {"key": "TEXT PRIMARY KEY"} | {c: "REAL" for c in _REALS} | {c: "INTEGER" for c in _WHOLE}
    return ", ".join(f'"{column}" {kinds.get(column, "TEXT")}' for column in columns)


_TABLES = (
    f"CREATE TABLE IF NOT EXISTS runs ({_declared(COLUMNS)})",
    f"CREATE TABLE IF NOT EXISTS planned ({_declared(('key', *_WHAT))})",
    "CREATE TABLE IF NOT EXISTS begun (key TEXT, driver TEXT, pid INTEGER, since REAL, PRIMARY KEY (key, driver))",
    "CREATE TABLE IF NOT EXISTS kills (key TEXT PRIMARY KEY, times INTEGER)",
)


@dataclass(frozen=True)
class RunStore:
    """A store of runs; `open` or `create` it.

    Attributes
    ----------
    path : of the file
    """

    path: Path

    @classmethod
    def open(cls, path: str | Path) -> RunStore:
        """A store that is there.

        Raises
        ------
        ResultError
            If there is no such file, or it is none.
        """
        store = cls(Path(path))
        if not store.path.is_file():
            what = "it is a folder" if store.path.is_dir() else "there is no such file"
            raise ResultError(what, file=path, way_out="make it by: comove bench run --out STORE.sqlite")
        store._check()
        return store

    @classmethod
    def create(cls, path: str | Path) -> RunStore:
        """A store that is there, or a new one.

        Raises
        ------
        ResultError
            If another file is in its place, or it cannot be written.
        """
        store = cls(Path(path))
        if store.path.is_dir():
            raise ResultError("it is a folder", file=path, way_out="name a file")
        if store.path.exists() and store.path.stat().st_size:
            store._check()
        elif not store.path.parent.is_dir():
            raise ResultError("its folder is not there", file=path, way_out="make the folder first")
        with store.connected() as connection:
            connection.execute(f"PRAGMA application_id = {APPLICATION}")
            connection.execute("PRAGMA journal_mode = WAL")
            for table in _TABLES:
                connection.execute(table)
        return store

    def _check(self) -> None:
        with self.connected() as connection:
            (application,) = connection.execute("PRAGMA application_id").fetchone()
        if application != APPLICATION:
            raise ResultError(
                "it is an SQLite file, but no store of runs", file=self.path, way_out="name another file"
            )

    @contextmanager
    def connected(self) -> Iterator[sqlite3.Connection]:
        """A connection whose changes are written as a whole, or not at all.

        Raises
        ------
        ResultError
            If the file is no SQLite file, or cannot be read or written.
        """
        connection = None
        try:
            connection = sqlite3.connect(self.path, timeout=WAIT)
            with connection:
                yield connection
        except sqlite3.DatabaseError as error:
            if "not a database" in str(error):
                raise ResultError(
                    "it is no SQLite file", file=self.path, way_out="name another file"
                ) from error
            raise ResultError(
                f"the store cannot be used: {error}", file=self.path, way_out="name a file that you may write"
            ) from error
        finally:
            if connection is not None:
                connection.close()

    def plan(self, configurations: Iterable[Configuration]) -> None:
        """Note what is to be run, so that a report can say what is missing."""
        rows = [(c.key, *astuple(c)) for c in configurations]
        with self.connected() as connection:
            connection.executemany(
                f"INSERT INTO planned VALUES ({', '.join('?' * (1 + len(_WHAT)))}) ON CONFLICT DO NOTHING",
                rows,
            )

    def planned(self) -> list[Configuration]:
        """What was to be run."""
        with self.connected() as connection:
            return [Configuration(*row[1:]) for row in connection.execute("SELECT * FROM planned")]

    def keys(self) -> set[str]:
        """Of what has ended."""
        with self.connected() as connection:
            return {key for (key,) in connection.execute("SELECT key FROM runs")}

    def runs(self) -> list[Run]:
        """What has ended, in the order in which it did."""
        with self.connected() as connection:
            rows = connection.execute("SELECT * FROM runs ORDER BY rowid").fetchall()
        return [_run(dict(zip(COLUMNS, row, strict=True))) for row in rows]

    def begin(self, key: str, driver: str, pid: int, since: float) -> None:
        """Note that a process is at a run, since when (seconds of the epoch); the last call counts."""
        with self.connected() as connection:
            connection.execute(
                "INSERT INTO begun VALUES (?, ?, ?, ?) ON CONFLICT DO UPDATE SET since = excluded.since, "
                "pid = excluded.pid",
                (key, driver, pid, since),
            )

    def begun(self, driver: str) -> list[tuple[str, int, float]]:
        """Key, process and beginning (seconds of the epoch) of what the processes of a driver are at."""
        with self.connected() as connection:
            return connection.execute(
                "SELECT key, pid, since FROM begun WHERE driver = ?", (driver,)
            ).fetchall()

    def leave(self, driver: str) -> None:
        """Forget what the processes of a driver are at."""
        with self.connected() as connection:
            connection.execute("DELETE FROM begun WHERE driver = ?", (driver,))

    def add(self, run: Run) -> None:
        """Write a run that has ended; where there is one with its key already, that one stays."""
        c = run.configuration
        row = (
            c.key,
            *astuple(c),
            run.status,
            run.message,
            run.started,
            *astuple(run.machine),
            *astuple(run.figures),
            json.dumps(run.history),
        )
        with self.connected() as connection:
            connection.execute(
                f"INSERT INTO runs VALUES ({', '.join('?' * len(COLUMNS))}) ON CONFLICT DO NOTHING", row
            )
            connection.execute("DELETE FROM begun WHERE key = ?", (c.key,))

    def note_kill(self, key: str) -> int:
        """Note that a process was killed while it was at a run; how often that has been so."""
        with self.connected() as connection:
            connection.execute(
                "INSERT INTO kills VALUES (?, 1) ON CONFLICT DO UPDATE SET times = times + 1", (key,)
            )
            return connection.execute("SELECT times FROM kills WHERE key = ?", (key,)).fetchone()[0]


def _run(row: dict[str, Any]) -> Run:
    def part(kind: type) -> Any:
        return kind(**{field.name: row[field.name] for field in fields(kind)})

    return Run(
        part(Configuration),
        row["status"],
        row["message"],
        row["started"],
        part(Machine),
        part(Figures),
        tuple((seconds, cost) for seconds, cost in json.loads(row["history"])),
    )


def export_parquet(store: RunStore, path: str | Path) -> int:
    """Write all runs to a Parquet file, a column each as in SQLite; how many there are.

    Raises
    ------
    ExtraError
        If pyarrow is not installed.
    ResultError
        If the file cannot be written.
    """
    try:
        import pyarrow
        import pyarrow.parquet
    except ImportError as error:
        raise ExtraError("a Parquet file", "data") from error
    with store.connected() as connection:
        rows = connection.execute("SELECT * FROM runs ORDER BY rowid").fetchall()
    kinds = {c: pyarrow.float64() for c in _REALS} | {c: pyarrow.int64() for c in _WHOLE}
    columns = {
        name: pyarrow.array([row[i] for row in rows], type=kinds.get(name, pyarrow.string()))
        for i, name in enumerate(COLUMNS)
    }
    try:
        pyarrow.parquet.write_table(pyarrow.table(columns), path)
    except OSError as error:
        raise ResultError(
            f"it cannot be written: {error.strerror or error}",
            file=path,
            way_out="name a file that you may write",
        ) from error
    return len(rows)
