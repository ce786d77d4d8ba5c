"""Texts and checks shared by the verbs of `comove robot`."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

from comove.errors import InputError, RobotError


def robot_named(name: str | None, scene, file: Path):
    """Return the robot named by the command line, or else by the scene, and its description's name or path."""
    from comove.robots import Robot, bundled_robots, find_description

    named = name if name is not None else scene.file.robot
    if named is None:
        raise RobotError(
            "neither the scene nor the command names a robot",
            file=file,
            key="robot",
            way_out=f"add robot: NAME to the scene or give --robot; bundled: {', '.join(bundled_robots())}",
        )
    try:
        path = find_description(named, None if name is not None else file.parent)
    except RobotError as error:
        error.file, error.key = (file, "robot") if name is None else (error.file, "--robot")
        raise
    return Robot.load(path), named if named in bundled_robots() else path


@contextmanager
def of_scene(file: Path) -> Iterator[None]:
    """Add the scene's file to errors that name no file."""
    try:
        yield
    except InputError as error:
        error.file = error.file or file
        raise


def joints_text(robot: str, measures: Mapping[str, float | None]) -> str:
    """Return a readable summary of a joint motion's measures."""
    number, length = (lambda key, write=write: write(measures.get(key)) for write in (_number, _millimetres))
    rows = [
        ("joints", f"{number('joint_margin_min')} rad from their limits at least"),
        (
            "shares of the limits",
            f"speed {number('velocity_ratio_max')}, acceleration {number('acceleration_ratio_max')}, "
            f"torque {number('torque_ratio_max')}",
        ),
        ("hands on the load", f"within {number('hand_error_max')} m, {number('hand_turn_max')} rad"),
        (
            "links keep away from",
            f"obstacles {length('clearance_scene')}, load {length('clearance_load')}, "
            f"each other {length('clearance_self')}",
        ),
    ]
    return "\n".join([f"{robot}:", *(f"  {words:24s}{value}" for words, value in rows)])


def _number(value: float | None) -> str:
    return "-" if value is None or math.isnan(value) else f"{value:.3g}"


def _millimetres(value: float | None) -> str:
    if value is None or math.isnan(value):
        return "-"
    return "nothing near" if math.isinf(value) else f"{1e3 * value:.1f} mm"


def stored_motion(folder: Path):
    """Return the joint motion of a result folder, after verifying it again.

    Raises
    ------
    ResultError
        If it is not verified, or was edited.
    """
    from comove.errors import ResultError
    from comove.robots import verify_stored
    from comove.robots.files import AGAIN

    verdict = verify_stored(folder)
    if verdict.verified is None:
        more = f" (and {len(verdict.reasons) - 1} more)" if len(verdict.reasons) > 1 else ""
        raise ResultError(
            f"its motion is not verified: {verdict.reasons[0].removesuffix(f'; {AGAIN}')}{more}",
            file=folder,
            way_out=f"{AGAIN}: comove robot solve SCENE --out DIR",
        )
    return verdict.verified


def simulation_text(summary: dict, folder: Path) -> str:
    """Return a readable summary of a simulation's measures."""
    verdict = "delivered" if summary["delivered"] else "NOT DELIVERED"
    lines = [f"{summary['scene']}, {summary['robot']}, {summary['grasp']['kind']}: {verdict}"]
    lines += [f"  - {reason}" for reason in summary["reasons"]]
    rows = [
        ("end error", "end_error", 1e3, "mm"),
        ("hands' distance error", "distance_error_max", 1e3, "mm at most"),
        ("load behind its plan", "lag_max", 1e3, "mm at most"),
        ("slip in a hand", "slip_max", 1e3, "mm at most"),
        ("force inside the load", "internal_force_max", 1.0, "N at most"),
        ("share of torque", "torque_share_max", 1.0, "at most"),
    ]
    for words, key, factor, unit in rows:
        if summary.get(key) is not None:
            lines.append(f"  {words:24s}{factor * summary[key]:.3g} {unit}")
    lines.append(f"  {'series':24s}{folder / 'simulation.npz'}, {folder / 'simulation.json'}")
    return "\n".join(lines)
