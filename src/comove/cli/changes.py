"""Options that replace durations and limits of a scene file."""

from __future__ import annotations

from typing import Annotated, Any

import typer

INSTEAD = "instead of what SCENE says"
Duration = Annotated[float | None, typer.Option(help=f"Duration of the movement [s], {INSTEAD}.")]
Speed = Annotated[float | None, typer.Option(help=f"Limit of the hands' speed [m/s], {INSTEAD}.")]
Acceleration = Annotated[
    float | None, typer.Option(help=f"Limit of the hands' acceleration [m/s^2], {INSTEAD}.")
]
Jerk = Annotated[float | None, typer.Option(help=f"Limit of the hands' jerk [m/s^3], {INSTEAD}.")]
Clearance = Annotated[float | None, typer.Option(help=f"Distance to keep from everything [m], {INSTEAD}.")]


def changes_of(
    duration: float | None,
    speed: float | None = None,
    acceleration: float | None = None,
    jerk: float | None = None,
    clearance: float | None = None,
) -> dict[str, Any]:
    """Return the options that were given as the argument `changes` of `Scene.load`."""
    limits = {"speed": speed, "acceleration": acceleration, "jerk": jerk, "clearance": clearance}
    limits = {key: value for key, value in limits.items() if value is not None}
    changes: dict[str, Any] = {} if duration is None else {"duration": duration}
    return changes | ({"limits": limits} if limits else {})
