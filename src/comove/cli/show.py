"""`comove show`."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Annotated, Any

import typer

from comove.cli.app import verb

PICTURES = ("motion.png", "progress.png")
# Measures of scenes that ask for them: what they are, the factor to the unit, and the unit.
FURTHER = {
    "separation_spare_min": ("spare separation", 1e3, "mm or more, at every instant"),
    "tilt_max": ("tilt", 180 / math.pi, "deg at most"),
    "height_error_max": ("height error", 1.0, "m"),
}


@verb
def show(
    folder: Annotated[Path, typer.Argument(metavar="DIR", help="Result folder.")],
    open_pictures: Annotated[bool, typer.Option("--open", help="Open the pictures as well.")] = False,
) -> int:
    """Print the summary of a result and name its pictures."""
    from comove.results import read_result

    stored = read_result(folder)
    print(summary_text(stored.summary, folder))
    if (folder / "robot.json").is_file():
        from comove.cli.robot.report import joints_text
        from comove.robots import read_joints

        robot = read_joints(folder).summary
        print(joints_text(str(robot.get("robot")), robot))
    if open_pictures:
        for name in PICTURES:
            typer.launch(str(folder / name))
    return 0


def summary_text(summary: dict[str, Any], folder: Path) -> str:
    """A result's summary for people."""
    verdict = "verified" if summary.get("verified") is True else "NOT VERIFIED"
    lines = [f"{summary.get('scene')}: {verdict} ({summary.get('method')}, seed {summary.get('seed')})"]
    lines += [f"  - {reason}" for reason in summary.get("reasons") or []]
    terms = summary.get("cost_terms") or {}
    parts = ", ".join(f"{name} {_number(value)}" for name, value in terms.items() if value)
    lines += [
        f"  cost J                  {_number(summary.get('cost'))}  ({parts})",
        f"  certified clearance     {_number(summary.get('clearance_min'), 1e3)} mm or more, at every instant",
        f"  distance error          {_number(summary.get('distance_error_max'))} m",
        *(
            f"  {words:24s}{_number(summary[key], factor)} {unit}"
            for key, (words, factor, unit) in FURTHER.items()
            if summary.get(key) is not None
        ),
        f"  speed, acceleration     {_number(summary.get('speed_max'))} m/s, "
        f"{_number(summary.get('acceleration_max'))} m/s^2 at most",
        f"  first verified motion   after {_number(summary.get('time_to_first_verified_s'), 1e3)} ms, "
        f"all of it {_number(summary.get('wall_time_s'))} s",
        f"  pictures                {', '.join(str(folder / name) for name in PICTURES)}",
    ]
    return "\n".join(lines)


def _number(value: object, factor: float = 1.0) -> str:
    return f"{value * factor:.4g}" if isinstance(value, (int, float)) else "-"
