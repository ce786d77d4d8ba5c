"""Stored executions, `run.npz` and `run.json`, and their verification.

`run.npz` holds, at every control period, `time` (n_steps,) [s], `position` (n_steps, n_manipulators, n_dims) [m], and
`obstacle_center` (n_steps, n_obstacles, n_dims) [m], the true positions of the scene's obstacles, and where any turns
`obstacle_quaternion` (n_steps, n_obstacles, 4), w x y z, the orientations of their frames; it also holds the poses
from which the whole payload can be reconstructed: `center` (n_steps, n_groups, 3) [m] and `quaternion` (n_steps,
n_groups, 4), w x y z, of the rigid groups. `scene.json` is the executed scene, so that the folder can be verified and
played without other files.

The verification takes poses and times from the run, and everything else from the scene, the obstacles' positions too.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np

from comove.arrays import first_largest
from comove.errors import ResultError, shortened
from comove.model.scene import Scene
from comove.results.reference import SCENE, own_scene
from comove.results.sealed import (
    FITS,
    NUMBER,
    TEXT,
    TEXTS,
    TRUTH,
    Arrays,
    ResultKind,
    Stored,
    Summary,
    require_types,
)
from comove.verification.measures import WEIGHTS, unit_terms_of
from comove.verification.record import ExecutionReport, Record, verify_execution

FEWEST = 3  # steps

_TYPES = (
    dict.fromkeys(("verified", "interrupted"), TRUTH)
    | dict.fromkeys(("scene", "scene_sha256", "method", "version"), TEXT)
    | {"reasons": TEXTS, "duration_s": NUMBER}
)

RUN = ResultKind(
    summary="run.json",
    arrays="run.npz",
    checksum="motion_sha256",
    made_by="comove run SCENE --out DIR",
    hint="run it again",
    required=("time", "position", "obstacle_center", "center", "quaternion"),
    optional=("obstacle_quaternion",),
    unsealed=(
        "time_to_first_verified_s",
        "wall_time_s",
        "planning_s_median",
        "evading_s_median",  # of earlier versions
        "control_s_median",
        "control_s_p999",
    ),
    require_entries=lambda summary, file: require_types(summary, _TYPES, file),
)


@dataclass(frozen=True, eq=False, repr=False)
class StoredRun(Stored):
    """Contents of `run.json` and `run.npz`, and the scene of the execution."""

    scene: Scene

    @cached_property
    def record(self) -> Record:
        """Return the record of the execution, with obstacles as the run states.

        Raises
        ------
        ResultError
            If the arrays are of another shape or type, or not finite.
        """
        scene, arrays, n = self.scene, self.arrays, self.arrays["time"].size
        shapes = {
            "time": (n,),
            "position": (n, len(scene.manipulators), scene.n_dims),
            "obstacle_center": (n, len(scene.motions), scene.n_dims),
            "center": (n, len(scene.groups), 3),
            "quaternion": (n, len(scene.groups), 4),
        }
        if "obstacle_quaternion" in arrays:
            shapes["obstacle_quaternion"] = (n, len(scene.motions), 4)
        loose = ("obstacle_center",)  # nobody may know where one was
        RUN.require_shapes(arrays, shapes, self.folder, fewest=FEWEST, loose=loose)
        if not (np.diff(arrays["time"]) > 0).all():
            raise ResultError(
                "the times do not increase", file=self.folder / RUN.arrays, key="time", way_out=RUN.hint
            )
        obstacles = np.pad(arrays["obstacle_center"], ((0, 0), (0, 0), (0, 3 - scene.n_dims)))
        sagitta = scene.obstacle_sagittas(arrays["time"])
        return Record(scene, arrays["time"], arrays["center"], arrays["quaternion"], obstacles, sagitta)


def read_run(folder: str | Path, scene: Scene | None = None) -> StoredRun:
    """Read the folder of an execution; nothing of it is verified.

    Parameters
    ----------
    scene : the scene that was executed; the folder's own unless given

    Raises
    ------
    ResultError
        If a file is missing, incomplete or unreadable.
    """
    folder = Path(folder)
    summary, arrays = RUN.read(folder)
    return StoredRun(folder, summary, arrays, own_scene(folder) if scene is None else scene)


def verify_run(stored: StoredRun) -> ExecutionReport:
    """Verify a stored execution from its poses, times and scene alone.

    Raises
    ------
    ResultError
        If the arrays do not belong to the scene, or are no numbers.
    """
    scene, recorded = stored.scene, stored.record
    moved = scene.centers_at(recorded.time)
    record = replace(recorded, obstacles=moved)
    report = verify_execution(record)
    reasons = [*report.reasons, *_impossible(record), *_elsewhere(recorded, record)]
    reasons += _turned_otherwise(scene, stored.arrays)
    reasons += RUN.broken_seals(stored.summary, stored.arrays)
    if stored.summary.get("scene_sha256") != scene.sha256:
        reasons.append(
            f"the scene is not the one that was executed: its checksum differs from that in {SCENE}"
        )
    apart = np.abs(stored.arrays["position"] - record.position)
    if not apart.max() <= FITS:
        step, hand, _ = np.unravel_index(first_largest(apart), apart.shape)
        reasons.append(
            f"'position' in {RUN.arrays} was edited: at {record.time[step]:.2f} s '{scene.manipulators[hand]}' is "
            f"{apart.max():.3g} m from where the poses place it"
        )
    reasons += RUN.mistyped(stored.summary)
    if stored.summary.get("verified") is not True:
        reasons.append(f"{RUN.summary} does not claim a verified execution")
    elif not reasons:
        reasons += _misstated(stored.summary, report, record)
    return replace(report, reasons=tuple(reasons))


def _impossible(record: Record) -> list[str]:
    """List records that no execution on the scene can have, in words."""
    scene, time, reasons = record.scene, record.time, []
    even = np.linspace(0.0, time[-1], len(time))
    if not np.abs(time - even).max() <= FITS:
        reasons.append(f"the times in {RUN.arrays} are not evenly spaced from 0 s")
    if not np.abs(np.linalg.norm(record.quaternion, axis=2) - 1.0).max() <= FITS:
        reasons.append(f"a quaternion in {RUN.arrays} is not of unit length")
    if scene.n_dims == 2 and (record.center[..., 2].any() or record.quaternion[..., 1:3].any()):
        reasons.append(f"a pose in {RUN.arrays} leaves the plane of the scene")
    return reasons


def _elsewhere(recorded: Record, record: Record) -> list[str]:
    """List obstacles recorded at other positions than the scene's, in words."""
    n_dims = record.scene.n_dims
    apart = np.linalg.norm((recorded.obstacles - record.obstacles)[..., :n_dims], axis=2)
    reasons = []
    for number in np.flatnonzero(~(apart.max(axis=0, initial=0.0) <= FITS)):
        step = first_largest(apart[:, number])
        far = apart[step, number]
        where = f"{far:.3g} m from" if np.isfinite(far) else "anywhere but"
        reasons.append(
            f"{record.scene.name_of(int(number))} was, by the run's own record alone, {where} where the scene moves "
            f"it at {record.time[step]:.2f} s"
        )
    return reasons


def _turned_otherwise(scene: Scene, arrays: Arrays) -> list[str]:
    """List obstacles recorded with other orientations than the scene's, in words."""
    if "obstacle_quaternion" not in arrays:  # nobody need say: the verification takes turns from the scene
        return []
    apart = np.abs(arrays["obstacle_quaternion"] - scene.orientations(arrays["time"])).max(axis=(0, 2))
    return [
        f"{scene.name_of(int(i))} was, by the run's own record alone, turned otherwise than the scene turns it"
        for i in np.flatnonzero(~(apart <= FITS))
    ]


def _misstated(summary: Summary, report: ExecutionReport, record: Record) -> list[str]:
    """List the summary's measures that are not the run's, in words."""
    right: dict[str, float | None] = {**report.asdict(), "duration_s": float(record.time[-1])}
    right.pop("reasons")
    units = unit_terms_of(record.position)
    terms = {name: weight * units.get(name, 0.0) for name, weight in WEIGHTS.items()}
    right["cost"] = sum(terms.values())
    stated = summary.get("cost_terms")
    reasons = RUN.differences(summary, right)
    reasons += RUN.differences(stated if isinstance(stated, dict) else {}, terms, prefix="cost_terms.")
    if summary.get("scene") != record.scene.name:
        told = shortened(str(summary.get("scene")))
        reasons.append(f"{RUN.summary} names another scene: {told}")
    return reasons
