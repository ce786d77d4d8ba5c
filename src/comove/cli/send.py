"""`comove send`."""

from __future__ import annotations

import sys
from typing import Annotated

import typer

from comove.cli import options as o
from comove.cli.app import NOT_VERIFIED, VERIFIED, verb
from comove.cli.texts import say
from comove.errors import OptionError

PARTS = (o.CARRY, "approach", "release")


@verb
def send(
    folder: o.JointFolder,
    part: Annotated[str, typer.Option(help=f"One of: {', '.join(PARTS)}.")] = o.CARRY,
    start_tolerance: Annotated[
        float, typer.Option(help="How far a joint may be from the motion's start [rad].")
    ] = 0.01,
    path_tolerance: Annotated[
        float, typer.Option(help="How far a joint may be from the motion while it runs [rad].")
    ] = 0.2,
    timeout: Annotated[float, typer.Option(help="How long to wait for the robot [s].")] = 5.0,
    present: o.PresentFile = None,
    *,
    trusted: o.Trusted,
) -> int:
    """Verify the motion in DIR again and play it over ROS 1. All arms start in step."""
    from comove.robots import plan_transfers
    from comove.ros import IN_STEP, Ros1Client, SendError, Tolerances, send

    o.require_one_of(part, PARTS, "part")
    given = {"--start-tolerance": start_tolerance, "--path-tolerance": path_tolerance, "--timeout": timeout}
    for option, value in given.items():
        if not 0 < value < float("inf"):
            raise OptionError(f"{value} is not possible", key=option, way_out="give a positive number")
    o.require_approach(present, part == "approach")
    tolerances = Tolerances(start=start_tolerance, path=path_tolerance, connect=timeout)
    motion = trusted.verified(folder)
    if motion.scene.moving.any():
        say(f"warning: {IN_STEP}", file=sys.stderr)
    transfers = None
    if part != o.CARRY:
        transfers = plan_transfers(
            motion,
            approach=part == "approach",
            release=part == "release",
            present=o.present_in(folder, motion, present),
        )
    try:
        with Ros1Client() as client:
            outcome = send(client, motion, part=part, transfers=transfers, tolerances=tolerances)
    except SendError as error:
        if error.outcome is None:  # nothing has moved
            raise
        say(f"stopped: {error}", file=sys.stderr)
        return NOT_VERIFIED
    say(
        f"{motion.scene.name}: {part} done, arms {1e3 * outcome.apart:.0f} ms apart at the end, "
        f"{outcome.deviation:.3g} rad from the motion at most"
    )
    return VERIFIED
