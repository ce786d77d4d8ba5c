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
    "constraint_excess_max": ("other constraints' excess", 1.0, "at most"),
}


@verb
def show(
    folder: Annotated[Path, typer.Argument(metavar="DIR", help="Result folder.")],
    open_pictures: Annotated[bool, typer.Option("--open", help="Open the pictures as well.")] = False,
) -> int:
    """Print the summary of a result and name its pictures."""
    from comove.results import read_result
    from comove.results.folder import require_whole

    summary = require_whole(read_result(folder)).summary
    if (folder / "robot.json").is_file():
        from comove.cli.robot.report import joints_text
        from comove.robots.files import read_joints, require_whole_joints

        robot = require_whole_joints(read_joints(folder)).summary
        print(summary_text(summary, folder))
        print(joints_text(robot["robot"], robot))
    else:
        print(summary_text(summary, folder))
    if open_pictures:
        for name in PICTURES:
            typer.launch(str(folder / name))
    return 0


def summary_text(summary: dict[str, Any], folder: Path) -> str:
    """Return a readable summary of a result."""
    verdict = "verified" if summary.get("verified") is True else "NOT VERIFIED"
    lines = [f"{summary.get('scene')}: {verdict}"]
    lines += [f"  - {reason}" for reason in summary.get("reasons") or []]
    terms = summary.get("cost_terms") or {}
    parts = ", ".join(
        f"{name} {_number(value)}{_weighted(summary, name)}" for name, value in terms.items() if value
    )
    lines += [
        f"  cost J                  {_number(summary.get('cost'))}  ({parts})",
        f"  certified clearance     {_number(summary.get('clearance_min'), 1e3)} mm or more, at every instant",
        f"  distance error          {_number(summary.get('distance_error_max'))} m",
        *(
            f"  {words:24s}{_number(summary[key], factor)} {unit}"
            for key, (words, factor, unit) in FURTHER.items()
            if summary.get(key) is not None
        ),
        *([f"  duration                {_number(summary['duration'])} s"] if summary.get("duration") else []),
        f"  speed, acceleration     {_number(summary.get('speed_max'))} m/s, "
        f"{_number(summary.get('acceleration_max'))} m/s^2 at most",
        *_smoothness(summary),
        *_followed(summary),
        f"  noted, not proven       by {summary.get('method')}, seed {summary.get('seed')}, first verified motion "
        f"after {_number(summary.get('time_to_first_verified_s'), 1e3)} ms, all of it "
        f"{_number(summary.get('wall_time_s'))} s",
        f"  pictures                {', '.join(str(folder / name) for name in PICTURES)}",
    ]
    return "\n".join(lines)


def _smoothness(summary: dict[str, Any]) -> list[str]:
    """Return lines about the smoothness of the motion; none if the result holds no such measures."""
    measures = summary.get("smoothness")
    if not measures:
        return []
    return [
        f"  jerk                    {_number(summary.get('jerk_max'))} m/s^3 at most; its square "
        f"{_number(measures.get('jerk_ratio'))} times that of straight motions",
        f"  half, 95 % of the way   after {_number(measures.get('halfway'), 100)} and "
        f"{_number(measures.get('nearly_there'), 100)} % of the time",
    ]


def _followed(summary: dict[str, Any]) -> list[str]:
    """Return lines about the distance of the motion from the demonstration; none if there was no demonstration."""
    near = summary.get("demonstration")
    if not near:
        return []
    return [
        f"  what was taught         {_number(near.get('distance'), 100)} cm away in the mean "
        f"({_number(near.get('share'), 100)} % of the way), its direction "
        f"{_number(near.get('direction'), 180 / math.pi)} deg off",
    ]


def _weighted(summary: dict[str, Any], name: str) -> str:
    """Return the weight of a cost term in words, empty if it is the usual weight."""
    from comove.planning import PaperCost

    usual = vars(PaperCost()).get(name)
    weight = (summary.get("cost_weights") or {}).get(name, usual)
    return "" if weight == usual else f" (weight {_number(weight)})"


def _number(value: object, factor: float = 1.0) -> str:
    return f"{value * factor:.4g}" if isinstance(value, (int, float)) else "-"
