"""What is proved or measured of motions, in words, for the command line and for pages."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from typing import Any

from comove.scenes.scene import Scene

Row = tuple[str, str, str]
"""A measure: of what, by how much, and what was asked for."""
_Described = tuple[str, str, str, float]  # of what, its name, its words, and the factor to their unit

NO_GRIPPER = "without_gripper"
"""Name of the measure that lists arms whose description has no gripper."""
ROUNDING = 1e-12
"""Deviations below this many metres or radians are rounding, and said to be 0."""

_MOTION: tuple[_Described, ...] = (
    ("clearance", "clearance_min", "{:.4g} mm at least, at every instant", 1e3),
    ("distance from supports", "support_distance_min", "{:.3g} mm at least, near start and goal", 1e3),
    ("supports of the start", "support_left", "full clearance from {:.3g} s on", 1.0),
    ("supports of the goal", "support_met", "full clearance until {:.3g} s", 1.0),
    ("speed", "speed_max", "{:.4g} m/s at most", 1.0),
    ("acceleration", "acceleration_max", "{:.4g} m/s^2 at most", 1.0),
    ("jerk", "jerk_max", "{:.4g} m/s^3 at most", 1.0),
    ("distances between hands", "distance_error_max", "off by {:.2g} m at most", 1.0),
    ("goal and start", "end_error", "missed by {:.2g} m at most", 1.0),
    ("tilt", "tilt_max", "{:.3g} deg at most", 180.0 / math.pi),
    ("separation", "separation_spare_min", "{:.3g} mm to spare at least", 1e3),
    ("same height", "height_error_max", "off by {:.2g} m at most", 1.0),
    ("other constraints", "constraint_excess_max", "exceeded by {:.2g} at most", 1.0),
    ("duration", "duration", "{:.4g} s", 1.0),
)
_JOINTS: tuple[_Described, ...] = (
    ("joints from their limits", "joint_margin_min", "{:.3g} rad at least", 1.0),
    ("share of joint speeds", "velocity_ratio_max", "{:.3g} at most", 1.0),
    ("share of joint accelerations", "acceleration_ratio_max", "{:.3g} at most", 1.0),
    ("share of joint jerks", "jerk_ratio_max", "{:.3g} at most", 1.0),
    ("share of torques", "torque_ratio_max", "{:.3g} at most", 1.0),
    ("share of payloads", "payload_ratio_max", "{:.3g} at most", 1.0),
    ("hands on the load", "hand_error_max", "off by {:.2g} m at most", 1.0),
    ("hands' turn on the load", "hand_turn_max", "off by {:.2g} rad at most", 1.0),
    ("links from obstacles", "clearance_scene", "{:.4g} mm at least", 1e3),
    ("links from the load", "clearance_load", "{:.4g} mm at least", 1e3),
    ("links from each other", "clearance_self", "{:.4g} mm at least", 1e3),
)
_ROBOT_RUN: tuple[_Described, ...] = (
    ("links from obstacles", "clearance_scene", "{:.1f} mm at samples", 1e3),
    ("load from obstacles", "clearance_carried", "{:.1f} mm at samples", 1e3),
    ("links from each other", "clearance_self", "{:.1f} mm at samples", 1e3),
    ("hands on the load", "hold_error_max", "{:.2g} m or rad, commanded", 1.0),
    ("hands' distance", "distance_error_max", "{:.2g} mm off in the simulator", 1e3),
    ("end error", "end_error", "{:.2g} mm", 1e3),
    ("share of speed", "velocity_ratio_max", "{:.3g}", 1.0),
    ("share of acceleration", "acceleration_ratio_max", "{:.3g}", 1.0),
    ("servos behind", "lag_max", "{:.2g} rad at most", 1.0),
    ("took", "duration_s", "{:.2f} s", 1.0),
)
_SIMULATION: tuple[_Described, ...] = (
    ("load from its goal", "end_error", "{:.3g} mm", 1e3),
    ("hands' distances", "distance_error_max", "off by {:.3g} mm at most", 1e3),
    ("load behind its plan", "lag_max", "{:.3g} mm at most", 1e3),
    ("slip in a hand", "slip_max", "{:.3g} mm at most", 1e3),
    ("force inside the load", "internal_force_max", "{:.3g} N at most", 1.0),
    ("share of torque", "torque_share_max", "{:.3g} at most", 1.0),
)


def motion_rows(report: Mapping[str, Any], scene: Scene | None = None) -> list[Row]:
    """Return what is proved of a motion at every instant: of what, by how much, and what the scene asks for.

    Parameters
    ----------
    report : measures by their names in `comove.verification.verify.Report`, and `duration` [s]
    """
    supports = [] if scene is None else support_words(scene)
    asked: dict[str, str] = {}
    if scene is not None:
        limits = scene.file.limits
        asked = {
            "clearance": f"{1e3 * scene.clearance:.4g} mm",
            "speed": _limit(limits.speed, "m/s"),
            "acceleration": _limit(limits.acceleration, "m/s^2"),
            "jerk": _limit(limits.jerk, "m/s^3"),
        }
    rows = [(name, said, asked.get(name, "")) for name, said, _ in _rows(_MOTION, report)]
    if (
        report.get("support_distance_min") is not None
    ):  # they recede: the bound is none of the distance from them
        rows = [
            (n, f"{said}, off its supports" if n == "clearance" else said, want) for n, said, want in rows
        ]
    rows += [("rests on", words, "") for words in supports]
    if asked.get("jerk") and not any(name == "jerk" for name, *_ in rows):
        rows.append(("jerk", "not measured: executions are not bound by it", asked["jerk"]))
    return rows


def support_words(scene: Scene) -> list[str]:
    """Return the resting contacts of a scene, and where they end, in words."""
    told = []
    for rest in scene.rests:
        along = ", ".join(f"{x:.3g}" for x in rest.normal[: scene.n_dims] + 0.0)
        told.append(
            f"{scene.name_of(rest.obstacle)} at the {rest.end}, {1e3 * beyond_rounding(rest.distance):.3g} mm apart; "
            f"full clearance beyond {1e3 * rest.reach(scene.clearance):.3g} mm of displacement, along [{along}]"
        )
    return told


def joint_rows(report: Mapping[str, Any]) -> list[Row]:
    """Return what is proved of a robot's joints at every instant, as `motion_rows`.

    Parameters
    ----------
    report : measures by their names in `comove.robots.JointReport`; those that are not numbers are left out
    """
    return [*_rows(_JOINTS, report), *gripper_rows(report.get(NO_GRIPPER))]


def simulation_rows(summary: Mapping[str, Any]) -> list[Row]:
    """Return the measures of a simulation from its summary, as `motion_rows`; none of them is a proof."""
    rows = _rows(_SIMULATION, summary)
    if simulator := summary.get("simulator"):
        rows.insert(0, ("simulated by", str(simulator), ""))
    return [*rows, *gripper_rows(summary.get(NO_GRIPPER))]


def run_rows(measures: Mapping[str, Any]) -> list[Row]:
    """Return the measures of a robot's online run, as `motion_rows`; distances are sampled."""
    return [*_rows(_ROBOT_RUN, measures), *gripper_rows(measures.get(NO_GRIPPER))]


def gripper_rows(arms: Iterable[str] | None) -> list[Row]:
    """Return in words which arms have no gripper in their description; nothing where all have one."""
    named = ", ".join(f"'{arm}'" for arm in arms or ())
    return [("grippers", f"none in the description at {named}: not verified", "")] if named else []


def beyond_rounding(value: float) -> float:
    """Return a deviation [m or rad], 0 where it is nothing but rounding."""
    return 0.0 if abs(value) < ROUNDING else value


def limits_row(scene: Scene) -> list[str]:
    """Return in one line which limits of the hands a scene sets; empty where it sets none."""
    limits = scene.file.limits
    said = [
        _limit(limits.speed, "m/s"),
        _limit(limits.acceleration, "m/s^2"),
        _limit(limits.jerk, "m/s^3"),
        f"{1e3 * scene.clearance:.4g} mm of clearance" if scene.clearance else "",
    ]
    told = ", ".join(limit for limit in said if limit)
    return [f"limits of {told}"] if told else ["no limits of speed, acceleration or jerk"]


def _rows(described: tuple[_Described, ...], measures: Mapping[str, Any]) -> list[Row]:
    rows = []
    for name, key, words, factor in described:
        value = measures.get(key)
        if isinstance(value, (int, float)) and not math.isnan(value):
            said = "nothing near" if math.isinf(value) else words.format(factor * beyond_rounding(value))
            rows.append((name, said, ""))
    return rows


def _limit(value: float | None, unit: str) -> str:
    return "" if value is None else f"{value:.4g} {unit}"
