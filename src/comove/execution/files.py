"""The files of an execution: `run.npz` and `run.json`.

`run.npz` holds, at every control period, `time` (n_steps,) [s], `position` (n_steps, n_manipulators, n_dims) [m], and
`obstacle_center` (n_steps, n_obstacles, n_dims) [m], the true positions of the scene's obstacles; it also holds the
poses from which the whole load can be reconstructed: `center` (n_steps, n_groups, 3) [m] and `quaternion`
(n_steps, n_groups, 4), w x y z, of the rigid groups. `scene.json` is the scene that was executed, so that the folder
can be judged anew and played without other files.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from comove._version import __version__
from comove.coordination.coordinates import load_coordinates
from comove.errors import ResultError
from comove.execution.executor import ExecutionLog
from comove.planning.objective import Objective
from comove.results.sealed import ResultKind, Summary, finite
from comove.results.solution import SCENE
from comove.scenes.model import canonical
from comove.scenes.scene import Scene
from comove.verification.record import ExecutionReport, Record

RUN = ResultKind(
    summary="run.json",
    arrays="run.npz",
    checksum="motion_sha256",
    made_by="comove run SCENE --out DIR",
    hint="run it again",
    required=("time", "position", "obstacle_center", "center", "quaternion"),
    unsealed=(
        "time_to_first_verified_s",
        "wall_time_s",
        "planning_s_median",
        "evading_s_median",
        "control_s_median",
        "control_s_p999",
    ),
)


def write_run(
    folder: Path,
    record: Record,
    report: ExecutionReport,
    log: ExecutionLog,
    *,
    seed: int,
    interrupted: bool,
    wall_time_s: float,
) -> Summary:
    """Write `run.npz`, `run.json` and `scene.json` into an existing folder, and return the summary."""
    (folder / SCENE).write_bytes(canonical(record.scene.file) + b"\n")
    n = record.scene.n_dims
    arrays: dict[str, Any] = {
        "time": record.time,
        "position": record.position,
        "obstacle_center": record.obstacles[:, :, :n],
        "center": record.center,
        "quaternion": record.quaternion,
    }
    measured = {**vars(report), "clearance_min": finite(report.clearance_min)}
    del measured["reasons"]
    summary = {
        "verified": not report.reasons,
        "interrupted": interrupted,
        "reasons": list(report.reasons),
        "scene": record.scene.name,
        "method": "run",
        "seed": seed,
        "version": __version__,
        **_cost(record),
        **{name: value for name, value in measured.items() if value is not None or name == "clearance_min"},
        "evaluations": log.evaluations,
        "generations": log.generations,
        "time_to_first_verified_s": log.first_plan,
        "wall_time_s": wall_time_s,
        "duration_s": float(record.time[-1]),
        "plans": len(log.planning),
        "planning_s_median": _quantile(log.planning, 0.5),
        "evading_s_median": _quantile(log.evading, 0.5),
        "control_s_median": _quantile(log.control, 0.5),
        "control_s_p999": _quantile(log.control, 0.999),
        "relaxed_max": log.relaxed,
        "events": [{"time": event.time, "what": event.what} for event in log.events],
        "scene_sha256": record.scene.sha256,
    }
    return RUN.write(folder, summary, arrays)


@dataclass(frozen=True, eq=False)
class StoredRun:
    """Contents of the folder of an execution.

    Attributes
    ----------
    folder : path of the folder
    summary : the contents of run.json
    record : what happened
    """

    folder: Path
    summary: Summary
    record: Record


def read_run(folder: str | Path, scene: Scene) -> StoredRun:
    """Read the record of an execution.

    Parameters
    ----------
    scene : the scene that was executed, as `scene.json` in the folder holds it

    Raises
    ------
    ResultError
        If a file is missing, incomplete, unreadable or edited, or the scene is another one.
    """
    folder = Path(folder)
    summary, arrays = RUN.read(folder, whole=True)
    if summary.get("scene_sha256") != scene.sha256:
        raise ResultError("it is not the scene that was executed", file=folder / SCENE, way_out=RUN.hint)
    time, n = arrays["time"], len(arrays["time"])
    shapes = {
        "obstacle_center": (n, len(scene.motions), scene.n_dims),
        "center": (n, len(scene.groups), 3),
        "quaternion": (n, len(scene.groups), 4),
    }
    for name, shape in shapes.items():
        if arrays[name].shape != shape or n < 2:
            raise ResultError(
                f"it has the shape {arrays[name].shape}",
                file=folder / RUN.arrays,
                key=name,
                way_out=RUN.hint,
            )
    obstacles = np.pad(arrays["obstacle_center"], ((0, 0), (0, 0), (0, 3 - scene.n_dims)))
    sagitta = scene.obstacle_sagittas(time)
    record = Record(scene, time, arrays["center"], arrays["quaternion"], obstacles, sagitta)
    return StoredRun(folder, summary, record)


def _cost(record: Record) -> dict[str, Any]:
    """Return the cost J and its terms for the executed motion, in unit duration."""
    scene = record.scene
    objective = Objective(scene, load_coordinates(scene))
    offsets = np.ascontiguousarray(scene.by_row(record.obstacles - scene.centers))
    cost = objective.cost_of(objective.evaluate_nodes(np.ascontiguousarray(record.nodes[None]), offsets))
    terms = {"goal": cost.goal, "velocity": cost.velocity, "obstacle": cost.obstacle, "resemblance": 0.0}
    return {"cost": cost.total, "cost_terms": terms}


def _quantile(values: Sequence[float], q: float) -> float | None:
    return float(np.quantile(values, q)) if values else None
