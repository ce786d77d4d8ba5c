"""Runs of the benchmark, and their database."""

from __future__ import annotations

import json
from collections.abc import Iterable
from dataclasses import asdict, astuple, dataclass, fields
from itertools import islice
from typing import TypeVar

from comove.data.store import Store, Writer, declared, digest, kinds_of

Field = TypeVar("Field")

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
    """Machine of a run: processor model, core count, and Python version."""

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
    path_length : total length of all end effectors' paths [m]
    acceleration_max : largest acceleration, from step to step [m/s^2]
    jerk_max : largest jerk, from step to step [m/s^3]
    jerk_ratio : integrated squared jerk of all end effectors, divided by that of straight motions of minimum jerk
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
    """Run that has ended, with its result.

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

    @property
    def row(self) -> tuple:
        """Return the row of the table of runs."""
        c, ended = self.configuration, (self.status, self.message, self.started)
        return (
            *(c.key, *astuple(c), *ended, *astuple(self.machine), *astuple(self.figures)),
            json.dumps(self.history),
        )

    @classmethod
    def of_row(cls, row: tuple) -> Run:
        """Build a run from its row, or raise `ValueError` if edited."""
        values = iter(row)

        def part(kind: type[Field]) -> Field:
            return kind(*islice(values, len(fields(kind))))  # type: ignore[arg-type]

        key, configuration = next(values), part(Configuration)
        status, message, started = islice(values, 3)
        machine, figures = part(Machine), part(Figures)
        history = tuple((seconds, cost) for seconds, cost in json.loads(next(values)))
        if status not in STATUSES or configuration.key != key:
            raise ValueError("it is not what was run")
        return cls(configuration, status, message, started, machine, figures, history)


_WHAT = {"key": "str"} | kinds_of(Configuration)


class RunWriter(Writer[Run]):
    """Writer of benchmark runs to an open database."""

    def plan(self, configurations: Iterable[Configuration]) -> None:
        """Store the planned configurations, so that reports list missing ones."""
        self._insert("planned", *((c.key, *astuple(c)) for c in configurations))
        self._connection.commit()


@dataclass(frozen=True)
class RunStore(Store[Run, RunWriter]):
    """Database of benchmark runs."""

    APPLICATION = 0x636F6D76  # "comv", in the header of the file
    RUN = Run
    KINDS = {  # noqa: RUF012  a constant of the class
        **_WHAT,
        **dict.fromkeys(("status", "message", "started"), "str"),
        **kinds_of(Machine, Figures),
        "history": "str",
    }
    TABLES = {"planned": declared(_WHAT)}  # noqa: RUF012  a constant of the class
    MADE_BY = "comove bench run --out STORE.sqlite"
    WRITER = RunWriter

    def planned(self) -> list[Configuration]:
        """Return the planned configurations."""
        with self.connected(reading=True) as connection:
            rows = connection.execute("SELECT * FROM planned").fetchall()
        return [Configuration(*row[1:]) for row in rows]
