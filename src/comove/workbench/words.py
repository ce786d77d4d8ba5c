"""Verdicts and measures in words, for panels and pages."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

from comove.scenes.scene import Scene

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


def verdict_words(kind: str, reasons: Sequence[str] = (), seconds: float | None = None) -> str:
    """Return the verdict on what is shown as Markdown.

    Parameters
    ----------
    kind : "stored", "kept", "found", "solved", "failed", "waiting", "compiling" or "ended"
    reasons : why there is no verified motion
    seconds : time from the change to the first verified motion [s]
    """
    after = "" if seconds is None else f" {1e3 * seconds:.0f} ms after the change"
    if kind == "solved":
        return f"**Verified**{after}. The search is done; this is the best it found."
    if kind == "found":
        return f"**Verified**{after}. Searching for a better one ..."
    if kind == "stored":
        return "**Verified**, anew from the result's files."
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


def measures_words(report: Mapping[str, float], scene: Scene, duration: float) -> str:
    """Return what is proved of a motion at every instant, as a table in Markdown; see `measures_of`."""
    lines = "\n".join(
        f"| {name} | {said} | {asked} |" for name, said, asked in measures_of(report, scene, duration)
    )
    return f"| at every instant | proved | asked for |\n|---|---|---|\n{lines}"


def measures_of(report: Mapping[str, float], scene: Scene, duration: float) -> list[tuple[str, str, str]]:
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


def robot_words(scene: Scene) -> str:
    """Return what must be said where the hands are a robot's; empty where they are not."""
    if not scene.file.on_robot:
        return ""
    return "\n\nThis is the motion of the hands alone: `comove robot solve` finds that of the arms, and proves it."


def _at_least(value: float, factor: float, unit: str) -> str:
    return "nothing near" if math.isinf(value) else f"≥ {factor * value:.4g} {unit}"


def _at_most(value: float, unit: str) -> str:
    return f"≤ {value:.4g} {unit}"


def _asked(value: Any, factor: float, unit: str) -> str:
    return "" if value is None else f"{factor * value:.4g} {unit}"
