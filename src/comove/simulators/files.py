"""Simulations in a result folder: `simulation.json` and `simulation.npz`, and pictures of them.

The summary holds the checksum of the series and appears last, right after them, so that interrupted or edited files
are detected.
"""

from __future__ import annotations

import hashlib
import json
import math
import os
from collections.abc import Mapping
from dataclasses import asdict, is_dataclass
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from comove._version import __version__
from comove.errors import DemonstrationError, ResultError
from comove.io.arrays import read_arrays
from comove.io.entries import require_unedited
from comove.io.files import telling, whole_file
from comove.results.folder import checksum
from comove.simulators.execution import Execution

SUMMARY, SERIES = "simulation.json", "simulation.npz"
SHEET, FILM = "simulation.png", "simulation.mp4"
PICTURES = (SHEET, FILM, "simulation.gif")  # the latter where nothing encodes films
REQUIRED = ("time", "commanded", "joints", "torque", "hands", "hands_planned", "load_pose", "wrench", "lag")
TOOLS = ("mujoco", "pin", "numpy")
MAX_BYTES = 2**20
UNSUMMED = {"summary_sha256", "steps_per_second"}


def write_simulation(execution: Execution, folder: str | Path, *, seed: int | None = None) -> dict[str, Any]:
    """Write an execution into an existing folder, and return the summary.

    Pictures of an earlier simulation are removed, since they show another one.

    Parameters
    ----------
    seed : seed from which the perturbation was drawn

    Raises
    ------
    ResultError
        If the folder cannot be written.
    """
    folder = Path(folder)
    series = execution.series()
    summary = summary_of(execution, series, seed)
    summary["summary_sha256"] = _summary_checksum(summary)
    text = json.dumps(summary, indent=2, allow_nan=False) + "\n"
    with whole_file(folder / SUMMARY, ResultError) as told:
        told.write(text.encode())
        told.flush()
        os.fsync(told.fileno())  # so that nothing is left to do between the two files but to name them
        with whole_file(folder / SERIES, ResultError) as file:
            np.savez_compressed(file, **series)
            for name in PICTURES:
                with telling(folder / name, "replaced", ResultError):
                    (folder / name).unlink(missing_ok=True)
    return summary


def summary_of(execution: Execution, series: Mapping[str, NDArray], seed: int | None) -> dict[str, Any]:
    """Return the contents of simulation.json."""
    motion = execution.motion
    return {
        "delivered": execution.delivered,
        "reasons": list(execution.reasons),
        "simulator": execution.simulator,
        "grasp": _named(execution.grasp),
        **{name: _finite(value) for name, value in execution.measures.items()},
        "contacts": [asdict(contact) for contact in execution.contacts],
        "seed": seed,
        "perturbation": execution.perturbation.asdict(),
        "settings": asdict(execution.settings),
        "scene": execution.scene.name,
        "scene_sha256": execution.scene.sha256,
        "robot": execution.robot.name,
        "robot_sha256": execution.robot.sha256,
        "motion_sha256": checksum({"time": motion.time, "position": motion.position}),
        "series_sha256": checksum(series),
        "version": __version__,
        "versions": {tool: _version(tool) for tool in TOOLS},
        "steps_per_second": round(execution.steps_per_second),
    }


def read_simulation(folder: str | Path) -> tuple[dict[str, Any], dict[str, NDArray]]:
    """Read summary and series of a simulation.

    Raises
    ------
    ResultError
        If the files are missing or unreadable, or do not belong together.
    """
    path = Path(folder) / SUMMARY
    with telling(path, error=ResultError):
        if not path.is_file():
            raise ResultError(f"it holds no {SUMMARY}", file=folder, way_out="simulate the motion first")
    try:
        if path.stat().st_size > MAX_BYTES:
            raise ValueError("it is larger than 1 MB")
        summary = json.loads(path.read_text(encoding="utf-8"))
        if not isinstance(summary, dict):
            raise ValueError("it is no JSON object")
        series = read_arrays(
            Path(folder) / SERIES, REQUIRED, ("fingers", "distance_error", "slip", "internal", "squeeze")
        )
    except (OSError, ValueError, RecursionError) as error:
        raise ResultError(f"it cannot be read: {error}", file=path, way_out="simulate it again") from error
    except DemonstrationError as error:
        raise ResultError(
            error.message, file=error.file, key=error.key, way_out="simulate it again"
        ) from error
    require_unedited(summary, _summary_checksum(summary), path)
    if summary.get("series_sha256") != checksum(series):
        raise ResultError(
            f"{SERIES} is not what {SUMMARY} tells of: its checksum differs",
            file=folder,
            way_out="simulate it again",
        )
    return summary, series


def _summary_checksum(summary: Mapping[str, Any]) -> str:
    """Compute the SHA-256 of all entries but the checksum itself and the speed, which differs between runs."""
    entries = {key: value for key, value in summary.items() if key not in UNSUMMED}
    return hashlib.sha256(json.dumps(entries, sort_keys=True).encode()).hexdigest()


def _named(grasp: object) -> dict[str, Any]:
    """Return the kind of a grasp and its parameters."""
    return {"kind": type(grasp).__name__.lower(), **(asdict(grasp) if is_dataclass(grasp) else {})}


def _version(tool: str) -> str | None:
    try:
        return version(tool)
    except PackageNotFoundError:
        return None


def _finite(value: float | None) -> float | None:
    return value if value is not None and math.isfinite(value) else None
