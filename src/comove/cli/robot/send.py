"""`comove robot send`."""

from __future__ import annotations

import sys
from typing import Annotated

import typer

from comove.cli.app import NOT_VERIFIED, VERIFIED, verb_of
from comove.cli.robot.app import Folder, robot_app

PARTS = ("carry", "approach", "release")


@verb_of(robot_app)
def send(
    folder: Folder,
    part: Annotated[str, typer.Option(help=f"One of: {', '.join(PARTS)}.")] = "carry",
    start_tolerance: Annotated[
        float, typer.Option(help="How far a joint may be from the motion's start [rad].")
    ] = 0.01,
    path_tolerance: Annotated[
        float, typer.Option(help="How far a joint may be from the motion while it runs [rad].")
    ] = 0.2,
    timeout: Annotated[float, typer.Option(help="How long to wait for the robot [s].")] = 5.0,
) -> int:
    """Judge the motion in DIR anew and let a robot play it over ROS 1, both arms in step."""
    from comove.cli.robot.report import stored_motion
    from comove.errors import OptionError, near_name
    from comove.export import Ros1Client, SendError, Tolerances, send
    from comove.robots import plan_transfers

    if part not in PARTS:
        raise OptionError(f"unknown part '{part}'", key="--part", way_out=near_name(part, PARTS))
    given = {"--start-tolerance": start_tolerance, "--path-tolerance": path_tolerance, "--timeout": timeout}
    for option, value in given.items():
        if not 0 < value < float("inf"):
            raise OptionError(f"{value} is not possible", key=option, way_out="give a positive number")
    tolerances = Tolerances(start=start_tolerance, path=path_tolerance, connect=timeout)
    motion = stored_motion(folder)
    transfers = None if part == "carry" else plan_transfers(motion)
    try:
        with Ros1Client() as client:
            outcome = send(client, motion, part=part, transfers=transfers, tolerances=tolerances)
    except SendError as error:
        if error.outcome is None:  # nothing has moved
            raise
        print(f"stopped: {error}", file=sys.stderr)
        return NOT_VERIFIED
    print(
        f"{motion.scene.name}: {part} done, arms {1e3 * outcome.apart:.0f} ms apart at the end, "
        f"{outcome.deviation:.3g} rad from the motion at most"
    )
    return VERIFIED
