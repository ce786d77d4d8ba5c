"""What the verbs of robots say."""

from __future__ import annotations

import math
from pathlib import Path

from comove.errors import RobotError


def robot_named(name: str | None, scene, file: Path):
    """The robot that the command line names, or else the scene."""
    from comove.robots import Robot, bundled_robots

    named = name if name is not None else scene.file.robot
    if named is None:
        raise RobotError(
            "neither the scene nor the command names a robot",
            file=file,
            key="robot",
            way_out=f"add robot: NAME to the scene or give --robot; bundled: {', '.join(bundled_robots())}",
        )
    return Robot.load(named, None if name is not None else file.parent)


def joints_text(robot, report, folder: Path) -> str:
    """A joint motion's measures for people."""
    rows = [
        ("joints", f"{_number(report.joint_margin_min)} rad from their limits at least"),
        (
            "shares of the limits",
            f"speed {_number(report.velocity_ratio_max)}, acceleration {_number(report.acceleration_ratio_max)}, "
            f"torque {_number(report.torque_ratio_max)}",
        ),
        (
            "hands on the load",
            f"within {_number(report.hand_error_max)} m, {_number(report.hand_turn_max)} rad",
        ),
        (
            "links keep away from",
            f"obstacles {_millimetres(report.clearance_scene)}, load {_millimetres(report.clearance_load)}, "
            f"each other {_millimetres(report.clearance_self)}",
        ),
        ("joint motion", f"{folder / 'joints.npz'}, drawn in {folder / 'joints.png'}"),
    ]
    return "\n".join([f"{robot.name}:", *(f"  {words:24s}{value}" for words, value in rows)])


def _number(value: float) -> str:
    return "-" if math.isnan(value) else f"{value:.3g}"


def _millimetres(value: float) -> str:
    if math.isnan(value):
        return "-"
    return "nothing near" if math.isinf(value) else f"{1e3 * value:.1f} mm"


def duration_offer(robot, scene, joints) -> str | None:
    """How long the same path would have to take, where that is all that is wrong."""
    from comove.robots import shortest_duration

    return None
