"""Simulations in a result folder: `simulation.json` and `simulation.npz`, and pictures of them."""

from __future__ import annotations

from dataclasses import asdict
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

from comove._version import __version__
from comove.io.entries import MAPPING, NUMBER, TEXT, TEXTS, TRUTH, require_types
from comove.results.sealed import ResultKind, Summary, checksum, finite
from comove.simulators.execution import Execution

TOOLS = ("mujoco", "pin", "numpy")


def _require_entries(summary: Summary, file: Path) -> None:
    """Refuse a summary whose entries are not of their types."""
    types = {"delivered": TRUTH, "reasons": TEXTS, "scene": TEXT, "robot": TEXT, "grasp": MAPPING}
    for name in (
        "end_error",
        "distance_error_max",
        "lag_max",
        "slip_max",
        "internal_force_max",
        "torque_share_max",
    ):
        types[name] = NUMBER.or_nothing
    require_types(summary, types, file)
    require_types(summary["grasp"], {"kind": TEXT}, file, "grasp.")


SIMULATION = ResultKind(
    summary="simulation.json",
    arrays="simulation.npz",
    checksum="series_sha256",
    made_by="comove robot simulate DIR",
    hint="simulate it again",
    required=(
        "time",
        "commanded",
        "joints",
        "torque",
        "hands",
        "hands_planned",
        "load_pose",
        "wrench",
        "lag",
    ),
    optional=("fingers", "distance_error", "slip", "internal", "squeeze"),
    unsealed=("steps_per_second",),
    require_entries=_require_entries,
    outdated=("simulation.png", "simulation.mp4", "simulation.gif"),  # the last where nothing encodes films
)


def write_simulation(execution: Execution, folder: str | Path, *, seed: int | None = None) -> Summary:
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
    return SIMULATION.write(Path(folder), _summary_of(execution, seed), execution.series())


def _summary_of(execution: Execution, seed: int | None) -> Summary:
    """Return the contents of simulation.json."""
    motion = execution.motion
    return {
        "delivered": execution.delivered,
        "reasons": list(execution.reasons),
        "simulator": execution.simulator,
        "grasp": {"kind": type(execution.grasp).__name__.lower(), **vars(execution.grasp)},
        **{name: finite(value) for name, value in execution.measures.items()},
        "contacts": [asdict(contact) for contact in execution.contacts],
        "seed": seed,
        "perturbation": asdict(execution.perturbation),
        "settings": asdict(execution.settings),
        "scene": execution.scene.name,
        "scene_sha256": execution.scene.sha256,
        "robot": execution.robot.name,
        "robot_sha256": execution.robot.sha256,
        "motion_sha256": checksum({"time": motion.time, "position": motion.position}),
        "version": __version__,
        "versions": {tool: _version(tool) for tool in TOOLS},
        "steps_per_second": round(execution.steps_per_second),
    }


def _version(tool: str) -> str | None:
    try:
        return version(tool)
    except PackageNotFoundError:
        return None
