"""Report of a study's runs: statuses, reasons, figures and variety."""

from __future__ import annotations

import json
import sqlite3
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from comove.data.runs import MEASURES, RUNS, StudyStore
from comove.data.variety import N_PATH, Variety, variety
from comove.errors import ResultError
from comove.io.files import whole_file

REPORT = "report.json"
COMPARED = ("first", "duration", "cost", "jerk_max", "seconds")
"""Columns of which a sweep tells the medians."""


@dataclass(frozen=True)
class Figure:
    """Minimum, median and maximum of a measure over the verified runs."""

    least: float
    median: float
    greatest: float


@dataclass(frozen=True)
class Group:
    """Runs with one scene, method and settings.

    Attributes
    ----------
    runs, verified : numbers of runs, and of those with a verified motion, with a robot of its joints
    delivered : number of runs whose payload arrived in the simulation; None without simulation
    first, duration, cost, jerk, seconds : medians of the runs whose motion was verified; None where there are none
    """

    scene: str
    method: str
    settings: str
    runs: int
    verified: int
    delivered: int | None
    first: float | None
    duration: float | None
    cost: float | None
    jerk: float | None
    seconds: float | None


@dataclass(frozen=True)
class StudyReport:
    """Figures of a study's runs.

    Attributes
    ----------
    total, ended : numbers of planned runs, and of those in the run database
    statuses : number of runs by status
    reasons : the most frequent reasons of runs that were not verified, with their counts
    rejected : number of samples that gave no valid scene
    rejected_share : their share of all samples
    verified_share : share of verified runs among those whose scene is valid
    figures : figures of the verified runs, by measure; those of a robot's joints begin with "joints.", those of their
        simulation with "simulation."
    cut_short : number of runs whose budget ran out: on another machine their results may differ
    seconds : median processor time of a verified run [s]
    seconds_in_all : processor time of all runs [s]
    bytes_each : size of the run database by run [byte]
    variety : variety of the verified episodes; None where there are fewer than two
    """

    total: int
    ended: int
    statuses: Mapping[str, int]
    reasons: Mapping[str, int]
    rejected: int
    rejected_share: float
    verified_share: float
    figures: Mapping[str, Figure]
    cut_short: int
    seconds: float | None
    seconds_in_all: float
    bytes_each: float
    variety: Variety | None

    @property
    def verified(self) -> int:
        """Return the number of verified runs."""
        return self.statuses.get("verified", 0)


def report_of(folder: Path, most_paths: int = 5000, most_reasons: int = 5) -> StudyReport:
    """Return the report on a study's folder.

    Parameters
    ----------
    most_paths : largest number of compared paths; of more episodes, evenly spaced ones are compared
    most_reasons : largest number of reported reasons, the most frequent ones

    Raises
    ------
    ResultError
        If there is no study, or its run database cannot be read.
    """
    store = StudyStore.open(folder / RUNS)
    with store.connected(reading=True) as connection:
        statuses = dict(connection.execute("SELECT status, count(*) FROM runs GROUP BY status ORDER BY 1"))
        frequent = connection.execute(
            "SELECT reason, count(*) FROM runs WHERE status != 'verified' GROUP BY reason ORDER BY 2 DESC, 1 "
            f"LIMIT {most_reasons}"
        )
        reasons = dict(frequent.fetchall())
        rejected, cut_short, seconds = connection.execute(
            "SELECT total(rejected), total(cut_short), total(seconds) FROM runs"
        ).fetchone()
        wanted = ", ".join((*MEASURES, "seconds"))
        rows = connection.execute(f"SELECT {wanted} FROM runs WHERE status = 'verified'").fetchall()
        classes = dict(
            connection.execute(
                "SELECT passing, count(*) FROM runs WHERE status = 'verified' GROUP BY passing"
            )
        )
        carried = _carried_figures(connection)
    values = np.array(rows, dtype=float).reshape(-1, len(MEASURES) + 1)
    ended, invalid = sum(statuses.values()), statuses.get("invalid", 0)
    paths = _paths(store, most_paths)
    return StudyReport(
        total=store.total(),
        ended=ended,
        statuses=statuses,
        reasons=reasons,
        rejected=int(rejected),
        rejected_share=rejected / max(1.0, rejected + ended - invalid),
        verified_share=statuses.get("verified", 0) / max(1, ended - invalid),
        figures={
            name: figure for name, own in zip(MEASURES, values.T, strict=False) if (figure := _figure(own))
        }
        | carried,
        cut_short=int(cut_short),
        seconds=float(np.median(values[:, -1])) if len(values) else None,
        seconds_in_all=seconds,
        bytes_each=store.path.stat().st_size / max(1, ended),
        variety=variety(paths, classes) if len(paths) > 1 else None,
    )


def _carried_figures(connection: sqlite3.Connection) -> dict[str, Figure]:
    """Return figures of the verified runs' joints and simulations."""
    found: dict[str, list[float]] = {}
    query = "SELECT certificate, simulation FROM carries JOIN runs USING (key) WHERE status = 'verified'"
    for texts in connection.execute(query):
        for kind, text in zip(("joints", "simulation"), texts, strict=True):
            for name, value in json.loads(text or "{}").items():
                if isinstance(value, float):
                    found.setdefault(f"{kind}.{name}", []).append(value)
    return {name: figure for name, values in sorted(found.items()) if (figure := _figure(np.array(values)))}


def _figure(values: np.ndarray) -> Figure | None:
    """Return the figure of a measure; None if no run has it."""
    known = values[np.isfinite(values)]
    return Figure(*map(float, np.quantile(known, (0.0, 0.5, 1.0)))) if len(known) else None


def _paths(store: StudyStore, most: int) -> np.ndarray:
    """Return paths of verified episodes of the most frequent dimension. Array, shape (n_episodes, N_PATH, n_dims)
    [m]."""
    with store.connected(reading=True) as connection:
        (count,) = connection.execute("SELECT count(*) FROM motions").fetchone()
        every = -(-count // most) or 1
        blobs = connection.execute(
            "SELECT path FROM motions JOIN runs USING (key) WHERE number % ? = 0 ORDER BY number", (every,)
        ).fetchall()
    paths = [np.frombuffer(blob, dtype="<f4").reshape(N_PATH, -1).astype(float) for (blob,) in blobs]
    sizes = [path.shape[1] for path in paths]
    usual = max(set(sizes), key=sizes.count, default=2)
    return np.array([path for path in paths if path.shape[1] == usual]).reshape(-1, N_PATH, usual)


def groups_of(folder: Path) -> list[Group]:
    """Return a study's runs by scene, method and settings, in order."""
    store = StudyStore.open(folder / RUNS)
    found: dict[tuple[str, str, str], list[tuple]] = {}
    with store.connected(reading=True) as connection:
        query = (
            f"SELECT scene, method, settings, status, coalesce(simulation != '', 0), {', '.join(COMPARED)} "
            "FROM runs LEFT JOIN carries USING (key) ORDER BY number"
        )
        for scene, method, settings, *row in connection.execute(query):
            found.setdefault((scene, method, settings), []).append(tuple(row))
    groups = []
    for group, rows in found.items():
        good = [row for row in rows if row[0] in ("verified", "not delivered")]
        delivered = sum(row[0] == "verified" for row in good) if any(row[1] for row in good) else None
        groups.append(Group(*group, len(rows), len(good), delivered, *_medians([row[2:] for row in good])))
    return groups


def _medians(rows: list[tuple]) -> list[float | None]:
    columns = [[row[i] for row in rows if row[i] is not None] for i in range(len(COMPARED))]
    return [float(np.median(column)) if column else None for column in columns]


def write_report(report: StudyReport, folder: Path) -> Path:
    """Write a report as JSON into the folder of the study; return its path.

    Raises
    ------
    ResultError
        If it cannot be written.
    """
    path = folder / REPORT
    with whole_file(path, ResultError) as file:
        file.write((json.dumps(asdict(report), indent=2, allow_nan=False) + "\n").encode())
    return path
