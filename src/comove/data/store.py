"""Run databases: SQLite files with atomic rows for several processes.

The key of a row is the hash of its configuration, so nothing is run twice, and a killed process loses no row that
was written. A kind of database defines its runs and its further tables. Reading checks every row: a file of another
kind or of another version is refused and left unchanged, an edited row is reported.
"""

from __future__ import annotations

import hashlib
import json
import re
import sqlite3
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, fields
from pathlib import Path
from types import NoneType
from typing import Any, ClassVar, Generic, Self, TypeVar

from comove.errors import ResultError
from comove.io.files import telling
from comove.io.parquet import write_parquet

WAIT = 60.0  # s, for others that write
_KINDS: Mapping[str, tuple[str, str, frozenset[type]]] = {
    "str": ("TEXT", "string", frozenset({str})),
    "int": ("INTEGER", "int64", frozenset({int})),
    "float": ("REAL", "float64", frozenset({float})),
    "float | None": ("REAL", "float64", frozenset({float, NoneType})),
}
"""What a column is in SQLite, in Parquet and in Python, by the type of the field that it holds."""
_READ_ONLY = ("unable to open database file", "attempt to write a readonly database")
AS_IT_WAS = "copy it again, or save what it holds: sqlite3 STORE .recover"


RunT = TypeVar("RunT")


def digest(description: Mapping[str, Any]) -> str:
    """Compute the SHA-256 of plain data."""
    return hashlib.sha256(json.dumps(description, sort_keys=True).encode()).hexdigest()


def kinds_of(*parts: type) -> dict[str, str]:
    """Return the annotated types of dataclass fields, by name."""
    return {field.name: str(field.type) for part in parts for field in fields(part)}


def declared(kinds: Mapping[str, str]) -> str:
    """Return the declaration of a table; `key` is its primary key."""
    keys = {"key": " PRIMARY KEY"}
    return ", ".join(f'"{name}" {_KINDS[kind][0]}{keys.get(name, "")}' for name, kind in kinds.items())


def parquet_kinds(kinds: Mapping[str, str]) -> dict[str, str]:
    """Return the types of columns in a Parquet file."""
    return {name: _KINDS[kind][1] for name, kind in kinds.items()}


def columns_of(declared: str) -> list[str]:
    """Return the names of the columns in a table's declaration."""
    return re.findall(r'(?:^|, )"?(\w+)"? (?:TEXT|REAL|INTEGER|BLOB)', declared)


class Writer(Generic[RunT]):
    """Writer of rows to an open run database, each atomically."""

    def __init__(self, connection: sqlite3.Connection):
        self._connection = connection

    def _insert(self, table: str, *rows: tuple) -> None:
        for row in rows:
            marks = ", ".join("?" * len(row))
            self._connection.execute(f"INSERT INTO {table} VALUES ({marks}) ON CONFLICT DO NOTHING", row)

    def add(self, run: RunT) -> None:
        """Write an ended run, unless one has the same key."""
        self._insert("runs", run.row)  # type: ignore[attr-defined]
        self._connection.commit()

    def note_kill(self, key: str, times: int = 1) -> int:
        """Count processes killed during a run; return the total."""
        self._connection.execute(
            "INSERT INTO kills VALUES (?, ?) ON CONFLICT DO UPDATE SET times = times + excluded.times",
            (key, times),
        )
        self._connection.commit()
        return self._connection.execute("SELECT times FROM kills WHERE key = ?", (key,)).fetchone()[0]


WriterT = TypeVar("WriterT", bound=Writer)


@dataclass(frozen=True)
class Store(Generic[RunT, WriterT]):
    """Run database, made by `open` or `create`.

    Attributes
    ----------
    path : path of the file
    APPLICATION : number in the header of the files of this kind
    RUN : dataclass of runs, with `row` and `of_row`, to and from a row of the table of runs
    KINDS : types of the columns of that table, by name; the first is the key
    TABLES : declarations of the columns of the other tables, by name
    ORDER : columns by which runs are sorted
    MADE_BY : command that makes such a file
    WRITER : class of the writer
    """

    path: Path
    APPLICATION: ClassVar[int]
    RUN: ClassVar[Any]
    KINDS: ClassVar[Mapping[str, str]]
    TABLES: ClassVar[Mapping[str, str]]
    ORDER: ClassVar[str] = "rowid"
    MADE_BY: ClassVar[str]
    WRITER: ClassVar[type]

    @classmethod
    def open(cls, path: str | Path) -> Self:
        """Open an existing run database.

        Raises
        ------
        ResultError
            If there is no such file, or it is no run database.
        """
        store = cls(Path(path))
        with telling(store.path, error=ResultError):
            if not store.path.is_file():
                what = "it is a folder" if store.path.is_dir() else "there is no such file"
                raise ResultError(what, file=path, way_out=f"make it by: {cls.MADE_BY}")
        store._check()
        return store

    @classmethod
    def create(cls, path: str | Path) -> Self:
        """Open an existing run database, or create a new one.

        Raises
        ------
        ResultError
            If the path holds something else, or it cannot be written.
        """
        store = cls(Path(path))
        with telling(store.path, "written", ResultError):
            if store.path.exists() and not store.path.is_file():
                what = "a folder" if store.path.is_dir() else "no regular file"
                raise ResultError(f"it is {what}", file=path, way_out="name a file")
            if store.path.exists() and store.path.stat().st_size:
                store._check(whole=False)
            elif not store.path.parent.is_dir():
                raise ResultError("its folder is not there", file=path, way_out="make the folder first")
        with store.connected() as connection:
            connection.execute("BEGIN IMMEDIATE")  # all of it or nothing, and one after the other
            connection.execute(f"PRAGMA application_id = {cls.APPLICATION}")
            for name, columns in cls._tables().items():
                connection.execute(f"CREATE TABLE IF NOT EXISTS {name} ({columns})")
            connection.execute("COMMIT")
            connection.execute("PRAGMA journal_mode = WAL")
        return store

    @classmethod
    def _tables(cls) -> dict[str, str]:
        return {"runs": declared(cls.KINDS), **cls.TABLES, "kills": "key TEXT PRIMARY KEY, times INTEGER"}

    def _check(self, *, whole: bool = True) -> None:
        """Refuse other files and other versions of the run database. With `whole`, unfinished ones are refused
        too."""
        tables = self._tables()
        with self.connected(reading=True) as connection:
            (application,) = connection.execute("PRAGMA application_id").fetchone()
            columns = {
                name: [row[1] for row in connection.execute(f"PRAGMA table_info({name})")] for name in tables
            }
        if application != self.APPLICATION:
            raise ResultError(
                "it is an SQLite file, but no store of runs", file=self.path, way_out="name another file"
            )
        for name, found in columns.items():
            if found and found != columns_of(tables[name]):
                raise ResultError(
                    f"it is a store of another version of comove: its table '{name}' has other columns",
                    file=self.path,
                    way_out="name another file, or read it with the version that wrote it",
                )
            if not found and whole:
                raise ResultError(
                    f"it has no table '{name}': it was not finished",
                    file=self.path,
                    way_out=f"go on with it: {self.MADE_BY}",
                )

    @contextmanager
    def connected(self, *, reading: bool = False) -> Iterator[sqlite3.Connection]:
        """Yield a connection whose changes are committed together or not at all.

        Parameters
        ----------
        reading : whether the connection only reads; the file may then be on a read-only medium

        Raises
        ------
        ResultError
            If the file is no SQLite file, or cannot be read or written.
        """
        connection = None
        try:
            with telling(self.path, "used", ResultError):
                connection = self._readable() if reading else sqlite3.connect(self.path, timeout=WAIT)
            with connection:
                yield connection
        except sqlite3.DatabaseError as error:
            if "not a database" in str(error):
                raise ResultError(
                    "it is no SQLite file", file=self.path, way_out="name another file"
                ) from error
            damaged = "malformed" in str(error)
            raise ResultError(
                f"the store cannot be used: {error}",
                file=self.path,
                way_out=AS_IT_WAS if damaged else "make room, or name a file that you may write",
            ) from error
        finally:
            if connection is not None:
                connection.close()

    def _readable(self) -> sqlite3.Connection:
        """Return a connection for reading. On a read-only medium, SQLite must be told that the file does not
        change."""
        connection = None
        try:
            connection = sqlite3.connect(self.path, timeout=WAIT)
            connection.execute("SELECT count(*) FROM sqlite_master").fetchone()
            return connection
        except sqlite3.OperationalError as error:
            if connection is not None:
                connection.close()
            if str(error) not in _READ_ONLY:
                raise
            log = self.path.with_name(f"{self.path.name}-wal")
            if log.exists() and log.stat().st_size:
                raise ResultError(
                    f"its last rows lie in {log.name}, and may not be moved into it here",
                    file=self.path,
                    way_out="copy both files to a folder that you may write",
                ) from error
        return sqlite3.connect(f"{self.path.absolute().as_uri()}?mode=ro&immutable=1", uri=True)

    def runs(self) -> Iterator[RunT]:
        """Yield the runs that have ended, in order.

        Raises
        ------
        ResultError
            If a row was changed.
        """
        with self.connected(reading=True) as connection:
            for row in connection.execute(f"SELECT * FROM runs ORDER BY {self.ORDER}"):
                yield self._run(row)

    def _run(self, row: tuple) -> RunT:
        """Build a run from its row, whose types are checked."""
        try:
            for (name, kind), value in zip(self.KINDS.items(), row, strict=True):
                if type(value) not in _KINDS[kind][2]:
                    raise ValueError(f"{name} is {value!r}")
            return self.RUN.of_row(row)
        except (ValueError, TypeError, RecursionError) as error:
            raise ResultError(
                f"the row '{str(row[0])[:12]}' was changed: {str(error)[:80]}",
                file=self.path,
                way_out=AS_IT_WAS,
            ) from error

    def write_parquet(self, path: str | Path) -> int:
        """Write all runs to a Parquet file; return their number.

        Raises
        ------
        ExtraError
            If pyarrow is not installed.
        ResultError
            If a row was changed, or the file cannot be written.
        """
        rows: list[Any] = [run.row for run in self.runs()]  # type: ignore[attr-defined]
        columns = {name: [row[i] for row in rows] for i, name in enumerate(self.KINDS)}
        write_parquet(path, columns, parquet_kinds(self.KINDS))
        return len(rows)

    def keys(self) -> set[str]:
        """Return the keys of the runs that have ended."""
        with self.connected(reading=True) as connection:
            return {key for (key,) in connection.execute("SELECT key FROM runs")}

    @contextmanager
    def writer(self) -> Iterator[WriterT]:
        """Yield a writer; a second one at a time is refused.

        Raises
        ------
        ResultError
            If another process writes to the database, or it cannot be written.
        """
        with _alone(self.path), self.connected() as connection:
            connection.execute("PRAGMA synchronous = NORMAL")  # of a power cut the last runs are run again
            yield self.WRITER(connection)


@contextmanager
def _alone(path: Path) -> Iterator[None]:
    """Hold the lock of a run database, released with this process."""
    import fcntl

    lock = path.with_name(f"{path.name}.lock")
    with open(lock, "w", encoding="utf-8") as file:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as error:
            raise ResultError(
                "another process works on it at present",
                file=path,
                way_out="wait until it has ended, or end it first; other parts of a study go to folders of their own",
            ) from error
        yield
