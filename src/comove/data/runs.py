"""Run database of a study: one row for each run.

Its key is a checksum of the run's input. The driver of a study writes a row when its run has ended, with its motion
in one transaction, and none twice. Rows are small, so that millions of them are read in seconds; motions are in a
table of their own.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import astuple, dataclass, fields
from pathlib import Path
from typing import Any

from comove.data.store import Store, Writer, kinds_of
from comove.errors import ResultError, shortened

STATUSES = ("verified", "not delivered", "not verified", "invalid", "refused", "error", "killed", "late")
LONGEST = 500
"""Characters of a reason."""
RUNS = "runs.sqlite"
"""Name of the store in the folder of a study."""


@dataclass(frozen=True)
class StudyRun:
    """Run that has ended.

    Attributes
    ----------
    key : checksum of the run's input
    number : number of the run in its study
    scene, scene_sha256 : name and checksum of the scene; empty where no valid one was sampled
    method, seed, settings : name of the method, seed of all random numbers, changes of the scene (JSON)
    status : one of `STATUSES`; "invalid" if no sample gave a valid scene, "not delivered" if a robot's motion is
        verified and its simulation did not deliver the payload
    reason : reason for the status, in one line, if it is not "verified"
    rejected : number of samples that gave no valid scene
    duration : duration of the motion [s]
    cost : J of equation (4) in unit duration
    clearance_min, distance_error_max, end_error, speed_max, acceleration_max, jerk_max : certified measures of the
        motion [m, m, m, m/s, m/s^2, m/s^3]
    followed : mean distance from the demonstration [m]
    passing : class of the motion among the obstacles
    motion_sha256 : checksum of the motion
    first : processor time from the scene to the first verified motion, with a robot of joints [s]
    cut_short : 1 if the budget ran out, so that the motion depends on the machine's speed, else 0
    seconds : processor time of the run [s]; of a killed one, wall-clock time
    started : its beginning in UTC (ISO 8601)
    """

    key: str
    number: int
    scene: str = ""
    scene_sha256: str = ""
    method: str = ""
    seed: int = 0
    settings: str = ""
    status: str = "error"
    reason: str = ""
    rejected: int = 0
    duration: float | None = None
    cost: float | None = None
    clearance_min: float | None = None
    distance_error_max: float | None = None
    end_error: float | None = None
    speed_max: float | None = None
    acceleration_max: float | None = None
    jerk_max: float | None = None
    followed: float | None = None
    passing: str = ""
    motion_sha256: str = ""
    first: float | None = None
    cut_short: int = 0
    seconds: float | None = None
    started: str = ""

    @property
    def row(self) -> tuple:
        """Return the row of the table of runs."""
        return astuple(self)

    @classmethod
    def of_row(cls, row: tuple) -> StudyRun:
        """Build a run from its row."""
        return cls(*row)


UNREPEATED = ("first", "cut_short", "seconds", "started")
"""Columns that differ from machine to machine."""
MEASURES = tuple(f.name for f in fields(StudyRun) if f.type == "float | None" and f.name not in UNREPEATED)
COLUMNS = tuple(f.name for f in fields(StudyRun))


@dataclass(frozen=True)
class StoredCarry:
    """Joints of a robot's motion in the run database.

    Attributes
    ----------
    key : key of the run
    joints : times, names and positions of the joints, packed
    certificate : measures of the verification, and checksums of robot and joints (JSON)
    simulation : measures of the simulation (JSON); empty without one
    """

    key: str
    joints: bytes
    certificate: str
    simulation: str


@dataclass(frozen=True)
class StoredMotion:
    """Motion of a run in the run database.

    Attributes
    ----------
    key : key of the run
    scene : the solved scene, packed
    curve : parameters of the curve, packed
    path : centre of the end effectors at equal shares of the duration, float32
    carry : joints of a robot; None without one
    videos : names and video files of cameras
    """

    key: str
    scene: bytes
    curve: bytes
    path: bytes
    carry: StoredCarry | None = None
    videos: tuple[tuple[str, bytes], ...] = ()

    @property
    def row(self) -> tuple[str, bytes, bytes, bytes]:
        """Return the row of the table of motions."""
        return self.key, self.scene, self.curve, self.path


class StudyWriter(Writer[StudyRun]):
    """Writer of runs to an open run database, each atomically."""

    def add(self, run: StudyRun, motion: StoredMotion | None = None) -> None:
        """Write an ended run, unless one has the same key."""
        self._insert("runs", run.row)
        if motion is not None:
            self._insert("motions", motion.row)
            if motion.carry is not None:
                self._insert("carries", astuple(motion.carry))
            self._insert("videos", *((motion.key, camera, video) for camera, video in motion.videos))
        self._connection.commit()

    def absorb(self, other: Path) -> int:
        """Copy the missing rows of another run database. Return the number of runs that exist here with another
        motion; they are kept."""
        self._connection.execute("ATTACH DATABASE ? AS other", (str(other),))
        try:
            (different,) = self._connection.execute(
                "SELECT count(*) FROM runs JOIN other.runs AS theirs USING (key) "
                "WHERE runs.status != theirs.status OR runs.motion_sha256 != theirs.motion_sha256"
            ).fetchone()
            for table in ("videos", "carries", "motions", "runs"):
                self._connection.execute(
                    f"INSERT OR IGNORE INTO {table} SELECT * FROM other.{table} "
                    "WHERE key NOT IN (SELECT key FROM runs)"
                )
            self._connection.execute(
                "INSERT INTO kills SELECT * FROM other.kills WHERE true "
                "ON CONFLICT DO UPDATE SET times = max(times, excluded.times)"
            )
            self._connection.commit()
        finally:
            self._connection.rollback()
            self._connection.execute("DETACH DATABASE other")
        return int(different)


@dataclass(frozen=True)
class StudyStore(Store[StudyRun, StudyWriter]):
    """Run database of one study."""

    APPLICATION = 0x636F6D73  # "coms", in the header of the file
    RUN = StudyRun
    KINDS = kinds_of(StudyRun)
    ORDER = "number"
    TABLES = {  # noqa: RUF012  a constant of the class
        "motions": "key TEXT PRIMARY KEY, scene BLOB, curve BLOB, path BLOB",
        "carries": "key TEXT PRIMARY KEY, joints BLOB, certificate TEXT, simulation TEXT",
        "videos": "key TEXT, camera TEXT, video BLOB, PRIMARY KEY (key, camera)",
        "about": "name TEXT PRIMARY KEY, value TEXT",
    }
    MADE_BY = "comove generate STUDY --out DIR, or comove sweep STUDY --out DIR"
    WRITER = StudyWriter

    def describe(self, described: Mapping[str, Any], total: int) -> None:
        """Store the input data and number of runs of the study. The number may grow, as no run depends on it.

        Raises
        ------
        ResultError
            If the database holds another study, or the study was edited; the message lists the changes.
        """
        before = self.description()
        if before is not None:
            changed = differences(before, json.loads(json.dumps(described)))
            if changed:
                more = f", and {len(changed) - 3} more" if len(changed) > 3 else ""
                raise ResultError(
                    f"it holds runs of a study that was edited since: {'; '.join(changed[:3])}{more}",
                    file=self.path,
                    way_out="give the study its former values back, or name another folder",
                )
        rows = {"study": json.dumps(described, sort_keys=True), "total": str(max(total, self.total()))}
        with self.connected() as connection:
            connection.executemany("INSERT OR REPLACE INTO about VALUES (?, ?)", rows.items())

    def description(self) -> dict[str, Any] | None:
        """Return the study's input data; None in a new database."""
        text = self._about("study")
        return None if text is None else self._json(text)

    def total(self) -> int:
        """Return the number of runs in the whole study."""
        return int(self._json(self._about("total") or "0"))

    def _about(self, name: str) -> str | None:
        with self.connected(reading=True) as connection:
            row = connection.execute("SELECT value FROM about WHERE name = ?", (name,)).fetchone()
        return None if row is None else str(row[0])

    def _json(self, text: str) -> Any:
        try:
            return json.loads(text)
        except ValueError as error:
            raise ResultError(
                f"its description was changed: {error}", file=self.path, way_out="copy the store again"
            ) from error

    def numbers(self) -> set[int]:
        """Return the numbers of the runs that have ended."""
        with self.connected(reading=True) as connection:
            return {number for (number,) in connection.execute("SELECT number FROM runs")}

    def motions(self, status: str = "verified") -> Iterator[tuple[StudyRun, StoredMotion]]:
        """Yield the runs of a status with their motions, in order."""
        query = (
            f"SELECT {', '.join(f'runs.{c}' for c in COLUMNS)}, motions.scene, motions.curve, motions.path, "
            "carries.joints, carries.certificate, carries.simulation "
            "FROM runs JOIN motions USING (key) LEFT JOIN carries USING (key) WHERE status = ? ORDER BY number"
        )
        with self.connected(reading=True) as connection:
            for row in connection.execute(query, (status,)):
                run = self._run(row[: len(COLUMNS)])
                scene, curve, path, joints, certificate, simulation = row[len(COLUMNS) :]
                carry = None if joints is None else StoredCarry(run.key, joints, certificate, simulation)
                videos = connection.execute(
                    "SELECT camera, video FROM videos WHERE key = ? ORDER BY camera", (run.key,)
                )
                yield run, StoredMotion(run.key, scene, curve, path, carry, tuple(videos))


def differences(before: Mapping[str, Any], after: Mapping[str, Any]) -> list[str]:
    """List the differences of two descriptions: key, former and present value."""
    flat = [dict(_leaves((), data)) for data in (before, after)]
    told = []
    for key in [*flat[0], *(key for key in flat[1] if key not in flat[0])]:
        was, now = (json.dumps(one[key]) if key in one else "nothing" for one in flat)
        if was != now:
            told.append(f"{'.'.join(key)} was {shortened(was, 60)} and is {shortened(now, 60)}")
    return told


def _leaves(path: tuple[str, ...], value: Any) -> Iterator[tuple[tuple[str, ...], Any]]:
    """Yield the values in nested data, with their key paths."""
    inner = (
        value.items()
        if isinstance(value, Mapping)
        else enumerate(value)
        if isinstance(value, (list, tuple))
        else ()
    )
    if not value or not isinstance(value, (Mapping, list, tuple)):
        yield path, value
    for key, item in inner:
        yield from _leaves((*path, str(key)), item)


@dataclass(frozen=True)
class Merged:
    """Counts of a merged study's ended, planned and contradictory runs."""

    ended: int
    total: int
    different: int


def merge(parts: Sequence[Path], out: Path) -> Merged:
    """Merge the runs of several shards into a folder.

    Runs that exist there are kept. An interrupted merge is completed by the same call.

    Parameters
    ----------
    parts : folders of shards, or their run databases
    out : folder of the whole study, new or with some of its runs

    Raises
    ------
    ResultError
        If a part is no run database, parts belong to different studies, or the folder cannot be written.
    """
    stores = [StudyStore.open(part / RUNS if part.is_dir() else part) for part in parts]
    described = [_description(store) for store in stores]
    for store, other in zip(stores[1:], described[1:], strict=True):
        changed = differences(described[0], other)
        if changed:
            raise ResultError(
                f"it holds another study than {stores[0].path}: {changed[0]}",
                file=store.path,
                way_out="merge parts of one study",
            )
    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise ResultError(
            f"it cannot be made: {error.strerror}", file=out, way_out="name a folder that you may write"
        ) from error
    whole = StudyStore.create(out / RUNS)
    with whole.writer() as writer:
        whole.describe(described[0], max(store.total() for store in stores))
        different = sum(writer.absorb(store.path) for store in stores if store.path != whole.path)
    return Merged(len(whole.keys()), whole.total(), different)


def _description(store: StudyStore) -> dict:
    found = store.description()
    if found is None:
        raise ResultError("it holds no study yet", file=store.path, way_out="run its part first")
    return found
