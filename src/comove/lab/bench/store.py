"""Store of runs: one SQLite file with one row for each run, written as the run ends and never changed.

The key of a row is the hash of its configuration, so nothing is run twice, and a killed process loses no row that was
written. Reading checks the store: one of another version, or with rows that were edited, is reported.
"""

from __future__ import annotations

import json
from collections.abc import Iterable
from dataclasses import asdict, astuple, dataclass, fields
from pathlib import Path
from types import NoneType
from typing import Any, TypeVar

from comove.data.runs import digest
from comove.data.store import AS_IT_WAS, KILLS_COLUMNS, Store, Writer, declared, kinds_of, parquet_kinds
from comove.errors import ResultError
from comove.io.parquet import write_parquet

Part = TypeVar("Part")

APPLICATION = 0x636F6D76  # "comv", in the header of the file
STATUSES = ("verified", "not verified", "nothing", "refused", "error", "killed", "late")


@dataclass(frozen=True)
class Configuration:
    """Configuration of a run.

    Attributes
    ----------
    set, scene : names of the set and of the scene
    scene_sha256 : checksum of the scene
    system : name of the system that is run
    seed : seed of all random numbers
    budget : processor time that the system may use [s]
    version : version of comove
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
        """Compute the SHA-256 of all entries."""
        return digest(asdict(self))


@dataclass(frozen=True)
class Machine:
    """Machine on which a run takes place: model of the processor, number of its cores, version of Python."""

    cpu: str
    cores: int
    python: str


@dataclass(frozen=True)
class Figures:
    """Figures of a run; None where there is nothing to measure.

    Attributes
    ----------
    seconds : processor time until the system ended [s]
    first_verified : processor time until the first verified offer [s]
    cost : J of equation (4) in unit duration, of the last offer, like all that follows
    path_length : length of the paths of all hands together [m]
    acceleration_max : largest acceleration, from step to step [m/s^2]
    jerk_max : largest jerk, from step to step [m/s^3]
    jerk_ratio : integrated squared jerk of all hands, divided by that of straight motions of minimum jerk
    duration : duration of the motion [s]
    distance_error_max : largest error of a distance [m]
    clearance_min : certified clearance [m]
    """

    seconds: float | None = None
    first_verified: float | None = None
    cost: float | None = None
    path_length: float | None = None
    acceleration_max: float | None = None
    jerk_max: float | None = None
    jerk_ratio: float | None = None
    duration: float | None = None
    distance_error_max: float | None = None
    clearance_min: float | None = None


@dataclass(frozen=True)
class Run:
    """A run that has ended, with its outcome.

    Attributes
    ----------
    configuration : configuration of the run
    status : one of `STATUSES`
    message : reason for the status, in one line, if it is not "verified"
    started : time at which it started, in UTC (ISO 8601)
    machine : machine on which it took place
    figures : measures of the run
    history : (seconds, cost) of every verified offer that was better than those before
    """

    configuration: Configuration
    status: str
    message: str
    started: str
    machine: Machine
    figures: Figures = Figures()
    history: tuple[tuple[float, float], ...] = ()


_KEY, _WHAT = {"key": "str"}, kinds_of(Configuration)
_ENDED = dict.fromkeys(("status", "message", "started"), "str")
_KINDS = _KEY | _WHAT | _ENDED | kinds_of(Machine, Figures) | {"history": "str"}
COLUMNS = tuple(_KINDS)
_TYPES: dict[str, Any] = {
    "str": str,
    "int": int,
    "float": float,
    "float | None": (float, NoneType),
}


class RunWriter(Writer):
    """Writes runs of the benchmark into an open store."""

    def plan(self, configurations: Iterable[Configuration]) -> None:
        """Note the configurations that are to be run, so that a report can list the missing ones."""
        self._insert("planned", *((c.key, *astuple(c)) for c in configurations))
        self._connection.commit()

    def add(self, run: Run) -> None:
        """Write a run that has ended; one with the same key stays as it is."""
        c = run.configuration
        ended = run.status, run.message, run.started
        figures = (*astuple(run.machine), *astuple(run.figures), json.dumps(run.history))
        self._insert("runs", (c.key, *astuple(c), *ended, *figures))
        self._connection.commit()


@dataclass(frozen=True)
class RunStore(Store[RunWriter]):
    """A store of runs of the benchmark."""

    APPLICATION = APPLICATION
    TABLES = {  # noqa: RUF012  a constant of the class
        "runs": declared(_KINDS),
        "planned": declared(_KEY | _WHAT),
        "kills": KILLS_COLUMNS,
    }
    MADE_BY = "comove bench run --out STORE.sqlite"
    WRITER = RunWriter

    def planned(self) -> list[Configuration]:
        """Return the configurations that were to be run."""
        with self.connected(reading=True) as connection:
            rows = connection.execute("SELECT * FROM planned").fetchall()
        return [Configuration(*row[1:]) for row in rows]

    def runs(self) -> list[Run]:
        """Return the runs that have ended, in that order."""
        return [self._run(row) for row in self.rows()]

    def rows(self) -> list[tuple]:
        """Return the rows of the runs that have ended, in that order; `COLUMNS` names their entries."""
        with self.connected(reading=True) as connection:
            return connection.execute("SELECT * FROM runs ORDER BY rowid").fetchall()

    def _run(self, row: tuple) -> Run:
        """Build a run from its row, and check it."""
        values = dict(zip(COLUMNS, row, strict=True))

        def part(kind: type[Part]) -> Part:
            return kind(**{field.name: values[field.name] for field in fields(kind)})  # type: ignore[arg-type]

        try:
            for name, value in values.items():
                if not isinstance(value, _TYPES[_KINDS[name]]):
                    raise ValueError(f"{name} is {value!r}")
            run = Run(
                part(Configuration),
                values["status"],
                values["message"],
                values["started"],
                part(Machine),
                part(Figures),
                tuple((seconds, cost) for seconds, cost in json.loads(values["history"])),
            )
            if run.status not in STATUSES or run.configuration.key != values["key"]:
                raise ValueError("it is not what was run")
            return run
        except (ValueError, TypeError, RecursionError) as error:
            raise ResultError(
                f"the row '{str(values['key'])[:12]}' was changed: {str(error)[:80]}",
                file=self.path,
                way_out=AS_IT_WAS,
            ) from error


def export_parquet(store: RunStore, path: str | Path) -> int:
    """Write all runs to a Parquet file, with the columns of the SQLite file; returns the number of runs.

    Raises
    ------
    ExtraError
        If pyarrow is not installed.
    ResultError
        If the file cannot be written.
    """
    store.runs()  # checks all rows
    rows = store.rows()
    columns = {name: [row[i] for row in rows] for i, name in enumerate(COLUMNS)}
    write_parquet(path, columns, parquet_kinds(_KINDS))
    return len(rows)
