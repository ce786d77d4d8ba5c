"""The files of an execution: `run.npz` and `run.json`, verified by `comove.results.runs`."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from comove._version import __version__
from comove.control.loop import ExecutionLog
from comove.model.coordinates import load_coordinates
from comove.model.files.keys import canonical
from comove.model.moving import Displacements
from comove.planning.objective import Objective
from comove.results.reference import SCENE
from comove.results.runs import RUN
from comove.results.sealed import Summary, finite
from comove.verification.record import ExecutionReport, Record


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
    """Write `run.npz`, `run.json` and `scene.json` into a folder; return the summary."""
    (folder / SCENE).write_bytes(canonical(record.scene.file) + b"\n")
    n = record.scene.n_dims
    arrays: dict[str, Any] = {
        "time": record.time,
        "position": record.position,
        "obstacle_center": record.obstacles[:, :, :n],
        "center": record.center,
        "quaternion": record.quaternion,
    }
    if record.scene.turning.any():
        arrays["obstacle_quaternion"] = record.scene.orientations(record.time)
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
        "planning_s_median": float(np.median(log.planning)) if log.planning else None,
        **log.summary,
        "scene_sha256": record.scene.sha256,
    }
    return RUN.write(folder, summary, arrays)


def _cost(record: Record) -> dict[str, Any]:
    """Return J and its terms for the executed motion, in unit duration."""
    scene = record.scene
    objective = Objective(scene, load_coordinates(scene))
    planned, offsets = scene.displacements(record.time), scene.by_row(record.obstacles - scene.centers)
    moved = Displacements.of(offsets, planned.centers, planned.angles, planned.axes)
    cost = objective.cost_of(objective.evaluate_nodes(np.ascontiguousarray(record.nodes[None]), moved))
    terms = {"goal": cost.goal, "velocity": cost.velocity, "obstacle": cost.obstacle, "resemblance": 0.0}
    return {"cost": cost.total, "cost_terms": terms}
