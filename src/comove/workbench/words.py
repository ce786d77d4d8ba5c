"""Verdicts and measures in words, for panels and pages."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

from comove.scenes.scene import Scene

Row = tuple[str, str, str]
"""A measure: of what, by how much, and what was asked for."""
SPECIAL = {
    "\\": "\\\\",
    "`": "\\`",
    "*": "\\*",
    "_": "\\_",
    "<": "&lt;",
    ">": "&gt;",
    "[": "\\[",
    "{": "&#123;",
}


def plain_text(text: str) -> str:
    """Return text in which nothing is read as markup."""
    return "".join(SPECIAL.get(letter, letter) for letter in text)


def verdict_words(
    kind: str, reasons: Sequence[str] = (), seconds: float | None = None, verdict: str = ""
) -> str:
    """Return the verdict on what is shown as Markdown.

    Parameters
    ----------
    kind : "stored", "kept", "found", "solved", "ran", "failed", "waiting", "running", "compiling" or "ended"
    reasons : why there is no verified motion
    seconds : time from the change to the first verified motion [s]
    verdict : what is known of something stored
    """
    after = "" if seconds is None else f" {1e3 * seconds:.0f} ms after the change"
    if kind == "solved":
        return f"**Verified**{after}. The search is done; this is the best it found."
    if kind == "found":
        return f"**Verified**{after}. Searching for a better one ..."
    if kind == "stored":
        return f"**{verdict[:1].upper()}{verdict[1:]}**, anew from the result's files."
    if kind == "ran":
        listed = "".join(f"\n- {plain_text(reason)}" for reason in reasons)
        return f"**{verdict[:1].upper()}{verdict[1:]}**. This is what happened.{listed}"
    if kind == "running":
        return "**Running.** Drag an obstacle into the way of the load."
    if kind == "kept":
        return f"**Verified**{after}: the motion shown still holds."
    if kind == "waiting":
        return "**Not verified yet** for the scene as it is now; the grey motion belongs to the one before."
    if kind == "compiling":
        return "**Compiling**, once after installation: one to three minutes."
    if kind == "ended":
        return "**The planner has ended.** Load the page again."
    listed = "".join(f"\n- {plain_text(reason)}" for reason in reasons)
    return f"**No verified motion found.**{listed}"


def named_in(scene: Scene, reasons: Sequence[str]) -> tuple[int, ...]:
    """Return the numbers of the obstacles that reasons name, so that just these are coloured."""
    names = [scene.name_of(number) for number in range(len(scene.file.obstacles))]
    return tuple(number for number, name in enumerate(names) if any(name in reason for reason in reasons))


def measures_words(rows: Sequence[Sequence[str]], proved: bool = True) -> str:
    """Return measures, as `measures_of` gives them, as a table in Markdown that says whether they are proved."""
    lines = "\n".join(f"| {name} | {said} | {asked} |" for name, said, asked in rows)
    head = "at every instant | proved" if proved else "in the simulation | measured"
    return f"| {head} | asked for |\n|---|---|---|\n{lines}"


def measures_of(report: Mapping[str, float], scene: Scene, duration: float) -> list[Row]:
    """Return what is proved of a motion at every instant: of what, by how much, and what the scene asks for.

    Parameters
    ----------
    report : measures by their names in `comove.verification.verify.Report`
    """
    limits = scene.file.limits
    rows = [
        (
            "clearance",
            _at_least(report.get("clearance_min", math.inf), 1e3, "mm"),
            _asked(scene.clearance, 1e3, "mm"),
        ),
        ("speed", _at_most(report["speed_max"], "m/s"), _asked(limits.speed, 1.0, "m/s")),
        (
            "acceleration",
            _at_most(report["acceleration_max"], "m/s²"),
            _asked(limits.acceleration, 1.0, "m/s²"),
        ),
    ]
    if "jerk_max" in report:
        rows.append(("jerk", _at_most(report["jerk_max"], "m/s³"), _asked(limits.jerk, 1.0, "m/s³")))
    rows += [
        ("distances between hands", f"off by {report['distance_error_max']:.2g} m at most", ""),
        ("goal and start", f"missed by {report['end_error']:.2g} m at most", ""),
    ]
    if "tilt_max" in report:
        rows.append(("tilt", f"{math.degrees(report['tilt_max']):.3g} deg at most", ""))
    if "separation_spare_min" in report:
        rows.append(("separation", f"{1e3 * report['separation_spare_min']:.3g} mm to spare at least", ""))
    if "height_error_max" in report:
        rows.append(("same height", f"off by {report['height_error_max']:.2g} m at most", ""))
    rows.append(("duration", f"{duration:.4g} s", ""))
    return rows


def joint_rows(report: Mapping[str, float]) -> list[Row]:
    """Return what is proved of a robot's joints at every instant, as `measures_of`.

    Parameters
    ----------
    report : measures by their names in `comove.robots.JointReport`; those that are not numbers are left out
    """
    rows = [
        ("joints from their limits", "joint_margin_min", "≥ {:.3g} rad", 1.0),
        ("share of joint speeds", "velocity_ratio_max", "≤ {:.3g}", 1.0),
        ("share of joint accelerations", "acceleration_ratio_max", "≤ {:.3g}", 1.0),
        ("share of torques", "torque_ratio_max", "≤ {:.3g}", 1.0),
        ("links from obstacles", "clearance_scene", "≥ {:.4g} mm", 1e3),
        ("links from the load", "clearance_load", "≥ {:.4g} mm", 1e3),
        ("links from each other", "clearance_self", "≥ {:.4g} mm", 1e3),
    ]
    return [
        (name, words.format(factor * report[key]), "")
        for name, key, words, factor in rows
        if math.isfinite(report.get(key, math.nan))
    ]


def simulation_rows(summary: Mapping[str, Any]) -> tuple[Row, ...]:
    """Return the measures of a simulation from its summary, as `measures_of`; none of them is a proof."""
    rows = [
        ("simulated by", "simulator", "{}", None),
        ("load from its goal", "end_error", "{:.3g} mm", 1e3),
        ("hands' distances", "distance_error_max", "off by {:.3g} mm at most", 1e3),
        ("load behind its plan", "lag_max", "{:.3g} mm at most", 1e3),
        ("slip in a hand", "slip_max", "{:.3g} mm at most", 1e3),
        ("force inside the load", "internal_force_max", "{:.3g} N at most", 1.0),
        ("share of torque", "torque_share_max", "{:.3g} at most", 1.0),
    ]
    return tuple(
        (name, words.format(summary[key] if factor is None else factor * summary[key]), "")
        for name, key, words, factor in rows
        if summary.get(key) is not None
    )


def _at_least(value: float, factor: float, unit: str) -> str:
    return "nothing near" if math.isinf(value) else f"≥ {factor * value:.4g} {unit}"


def _at_most(value: float, unit: str) -> str:
    return f"≤ {value:.4g} {unit}"


def _asked(value: Any, factor: float, unit: str) -> str:
    return "" if value is None else f"{factor * value:.4g} {unit}"
