"""Readable summaries of results, from their files."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, TextIO

from comove.errors import printable

if TYPE_CHECKING:
    from comove.dmp import Primitive
    from comove.model import Scene
    from comove.sim.robot_record import RobotReport

HANDS_ALONE = "verified, the hands alone: no joint of the robot was looked at"
DRAWN = (".png", ".gif", ".mp4")
RAN_OUT = "ran out while the motion was improved: a larger --budget may find a better one"


def number(value: object, factor: float = 1.0) -> str:
    """Return a number to four digits in another unit; else "-"."""
    return f"{value * factor:.4g}" if isinstance(value, (int, float)) else "-"


def say(*lines: str, file: TextIO | None = None) -> None:
    """Print lines with control characters escaped, one line each."""
    print(*map(printable, lines), sep="\n", file=file)


def in_rows(rows: Iterable[Sequence[str]]) -> list[str]:
    """Return lines of a name and its text, without further cells."""
    return [f"  {printable(name):30s}{printable(words)}" for name, words, *_ in rows]


def as_table(rows: Sequence[Sequence[str]]) -> str:
    """Return rows as text, with columns as wide as needed."""
    rows = [[printable(cell) for cell in row] for row in rows]
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    lines = ("  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)) for row in rows)
    return "\n".join(line.rstrip() for line in lines)


def listed(reasons: Iterable[str]) -> list[str]:
    """Return a line for each reason."""
    return [f"  - {printable(reason)}" for reason in reasons]


def events_of(summary: Mapping[str, Any]) -> list[str]:
    """Return a line for each event of a run."""
    return [f"  {event['time']:6.2f} s  {printable(str(event['what']))}" for event in summary["events"]]


def pictures_in(folder: Path) -> list[Path]:
    """Return the pictures and films in a folder."""
    return sorted(path for path in folder.glob("*") if path.suffix in DRAWN)


def pictures_row(folder: Path, *names: str) -> list[tuple[str, str]]:
    """Return a row of the existing pictures with these names, if any."""
    found = ", ".join(str(path) for path in pictures_in(folder) if path.stem in names)
    return [("pictures", found)] if found else []


def summary_text(
    summary: Mapping[str, Any], folder: Path, verdict: str = "", scene: Scene | None = None
) -> str:
    """Return a readable summary of a result's solution.json.

    Parameters
    ----------
    verdict : verification result; that of the summary unless given
    scene : the solved scene, whose resting contacts are named
    """
    from comove.stored import motion_rows

    verdict = verdict or ("verified" if summary.get("verified") is True else "NOT VERIFIED")
    terms = summary.get("cost_terms") or {}
    parts = ", ".join(
        f"{name} {number(value)}{_weighted(summary, name)}" for name, value in terms.items() if value
    )
    rows: list[Sequence[str]] = [
        ("cost J", f"{number(summary.get('cost'))}  ({parts})"),
        *motion_rows(summary, scene),
    ]
    if smoothness := summary.get("smoothness"):
        if isinstance(ratio := smoothness.get("jerk_ratio"), (int, float)):
            words = f"{number(math.sqrt(ratio))} times that of a straight minimum-jerk motion"
            rows.append(("root mean square jerk", words))
        half, nearly = number(smoothness.get("halfway"), 100), number(smoothness.get("nearly_there"), 100)
        rows.append(("half, 95 % of the way", f"after {half} and {nearly} % of the time"))
    if near := summary.get("demonstration"):
        away, share = number(near.get("distance"), 100), number(near.get("share"), 100)
        off = number(near.get("direction"), 180 / math.pi)
        words = f"{away} cm away in the mean ({share} % of the way), its direction {off} deg off"
        if near.get("weighted") is not None:
            words += f"; {number(near['weighted'], 100)} cm weighted by precision"
        rows.append(("demonstration", words))
    first, wall = number(summary.get("time_to_first_verified_s"), 1e3), number(summary.get("wall_time_s"))
    rows += [
        (
            "search",
            f"by {summary.get('method')}, seed {summary.get('seed')}, first verified motion after {first} ms, "
            f"{wall} s in total",
        ),
        *([("time budget", RAN_OUT)] if summary.get("timed_out") and summary.get("verified") is True else []),
        *pictures_row(folder, "motion", "progress"),
    ]
    head = printable(f"{summary.get('scene')}: {verdict}")
    return "\n".join([head, *listed(summary.get("reasons") or []), *in_rows(rows)])


def _weighted(summary: Mapping[str, Any], name: str) -> str:
    from comove.verification.measures import WEIGHTS

    usual = WEIGHTS.get(name)
    weight = (summary.get("cost_weights") or {}).get(name, usual)
    return "" if weight == usual else f" (weight {number(weight)})"


def joints_text(robot: str, measures: Mapping[str, Any]) -> str:
    """Return a readable summary of a joint motion's measures."""
    from comove.stored import joint_rows

    return "\n".join([printable(f"{robot}:"), *in_rows(joint_rows(measures))])


def simulation_text(summary: Mapping[str, Any], folder: Path, verdict: str = "") -> str:
    """Return a readable summary of a simulation.json."""
    from comove.stored import simulation_rows

    verdict = verdict or ("delivered" if summary["delivered"] else "NOT DELIVERED")
    head = f"{summary['scene']}, {summary['robot']}, {summary['grasp']['kind']}: {verdict}"
    rows: list[Sequence[str]] = [
        *simulation_rows(summary),
        ("series", f"{folder / 'simulation.npz'}, {folder / 'simulation.json'}"),
        *pictures_row(folder, "simulation"),
    ]
    return "\n".join([printable(head), *listed(summary["reasons"]), *in_rows(rows)])


def rehearsal_text(report: RobotReport, scene: str, robot: str, grasp: str) -> str:
    """Return a readable summary of what a simulated robot did."""
    from comove.stored import gripper_rows, simulation_rows

    verdict = "delivered" if report.delivered else "NOT DELIVERED"
    contacts = "; ".join(contact.words for contact in report.contacts) or "none"
    rows = [
        *simulation_rows(report.measures),
        ("contacts", contacts, ""),
        *gripper_rows(report.without_gripper),
    ]
    head = f"{scene}, {robot}, {grasp}: {verdict}"
    return "\n".join([printable(head), *listed(report.reasons), *in_rows(rows)])


def robot_run_text(summary: Mapping[str, Any], folder: Path, verdict: str = "") -> str:
    """Return a readable summary of a robot_run.json."""
    from comove.stored import run_rows

    verdict = verdict or ("arrived, as it should" if summary["as_it_should_be"] else "NOT AS IT SHOULD")
    median, slowest = 1e3 * summary["control_s_median"], 1e3 * summary["control_s_p999"]
    rows: list[Sequence[str]] = [
        *run_rows(summary),
        ("control step", f"{median:.2f} ms, 99.9 % within {slowest:.2f} ms"),
        ("plans", str(summary["plans"])),
        ("record", f"{folder / 'robot_run.npz'}, {folder / 'robot_run.json'}"),
        *pictures_row(folder, "robot_run", "joints"),
    ]
    head = f"{summary['scene']}, {summary['robot']}: {verdict}"
    return "\n".join([printable(head), *listed(summary["reasons"]), *events_of(summary), *in_rows(rows)])


def run_text(summary: Mapping[str, Any], folder: Path, verdict: str = "") -> str:
    """Return a readable summary of a run.json."""
    from comove.stored import beyond_rounding

    verdict = verdict or ("arrived, verified" if summary["verified"] else "NOT VERIFIED")
    clearance, median = summary["clearance_min"], 1e3 * summary["control_s_median"]
    near = summary.get("support_distance_min")
    rows = [
        (
            "certified clearance",
            "nothing to hit" if clearance is None else f"{1e3 * clearance:.2f} mm at every instant",
        ),
        *([("distance from supports", f"{1e3 * near:.3g} mm at least")] if near is not None else []),
        ("distance error", f"{beyond_rounding(summary['distance_error_max']):.3g} m"),
        ("goal", f"missed by {1e3 * beyond_rounding(summary['end_error']):.3g} mm"),
        (
            "speed, acceleration",
            f"{summary['speed_max']:.4g} m/s, {summary['acceleration_max']:.4g} m/s^2 at most",
        ),
        ("control step", f"{median:.3g} ms, 99.9 % within {1e3 * summary['control_s_p999']:.3g} ms"),
        ("record", str(folder / "run.npz")),
        *pictures_row(folder, "run"),
    ]
    return "\n".join(
        [
            printable(
                f"{summary['scene']}: {verdict} (seed {summary['seed']}) after {summary['duration_s']:.2f} s"
            ),
            *listed(summary["reasons"]),
            *events_of(summary),
            *in_rows(rows),
        ]
    )


def comparison_text(table: Mapping[str, Any], folder: Path) -> str:
    """Return a readable table of all methods on one scene."""
    lines = ["", "", f"  {'':24s}{'distance off':>14s}{'clearance':>14s}{'goal missed by':>18s}{'time':>10s}"]
    for row in table["methods"]:
        clearance = "-" if row["clearance_min"] is None else f"{1e3 * row['clearance_min']:.2f} mm"
        lines.append(
            f"  {row['method']:24s}{1e3 * row['distance_error_max']:11.3f} mm{clearance:>14s}"
            f"{1e3 * row['end_error']:15.3f} mm{row['duration_s']:8.2f} s"
        )
    return "\n".join([*lines, "", *in_rows(pictures_row(folder, "comparison"))])


def learned_text(primitive: Primitive) -> str:
    """Return a few lines on a learned primitive and its fit."""
    from comove.dmp import ProMP

    dmp, learned, unit = primitive.positions, primitive.provenance, primitive.unit
    what = f"{dmp.variant} of {dmp.weights.shape[1]} weights in {dmp.n_dims} dimensions"
    what += " and orientation" if primitive.kind in ("pose", "poses", "cooperative") else ""
    kind = "distribution" if primitive.kind == "poses" else primitive.kind
    what = what if kind in ("position", "pose") else f"{kind}, {what}"
    lines = [f"{primitive.name}: {what}, {dmp.duration:.4g} s"]
    spreading = primitive.followed
    if isinstance(spreading, ProMP):
        spread = spreading.std_at([0.02 * i * dmp.duration for i in range(51)]).max(axis=1)
        lines.append(
            f"  spread         {spread.min():.3g} to {spread.max():.3g} {unit} (standard deviation, over the course)"
        )
    if learned is not None:
        mean = "(root mean square)"
        lines.append(f"  learned from   {learned.source or learned.recording}, {learned.n_samples} samples")
        lines += [f"                 {note}" for note in learned.notes]
        lines.append(
            f"  fit error      {learned.error_rms:.3g} {unit} {mean}, {learned.error_max:.3g} {unit} at most"
        )
        if learned.turn_rms is not None:
            lines.append(
                f"  turn error     {learned.turn_rms:.3g} rad {mean}, {learned.turn_max:.3g} rad at most"
            )
    return "\n".join(map(printable, [*lines, *(f"  {note}" for note in primitive.notes)]))
