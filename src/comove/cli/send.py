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
OPTIONS = {f"tolerances.{name}": f"--{name}-tolerance" for name in ("start", "path")}
OPTIONS["tolerances.end"] = "--goal-tolerance"
CERTIFIED = "as far as the motion is certified for"


@verb
def send(
    folder: o.JointFolder,
    part: Annotated[str, typer.Option(help=f"One of: {', '.join(PARTS)}.")] = o.CARRY,
    start_tolerance: Annotated[
        float | None,
        typer.Option(
            help=f"How far a joint may be from the motion's start [rad]; {CERTIFIED}, 0.01 at most."
        ),
    ] = None,
    path_tolerance: Annotated[
        float | None,
        typer.Option(
            help=f"How far a joint may be from the motion while it runs [rad]; {CERTIFIED}, else 0.2."
        ),
    ] = None,
    goal_tolerance: Annotated[
        float | None,
        typer.Option(
            help=f"How far a joint may be from the goal at the end, for its controller [rad]; {CERTIFIED}, else "
            "the controller's own (0)."
        ),
    ] = None,
    timeout: Annotated[float, typer.Option(help="How long to wait for the robot [s].")] = 10.0,
    present: o.PresentFile = None,
    ros: Annotated[
        int | None,
        typer.Option(metavar="1|2", help="Version of ROS; 2 where it is found, else 1, unless given."),
    ] = None,
    action: Annotated[str | None, typer.Option(**o.ACTION)] = None,
    joint_states: Annotated[str | None, typer.Option(**o.JOINT_STATES)] = None,
    sim_time: Annotated[
        bool, typer.Option("--sim-time", help="Use the time of a simulator, on /clock (ROS 2).")
    ] = False,
    *,
    trusted: o.Trusted,
) -> int:
    """Verify the motion in DIR again and play it over ROS. All arms start in step."""
    from comove.robots import plan_transfers
    from comove.robots.verification.allowed import allowed_deviation
    from comove.ros import IN_STEP, Names, RosClient, SendError, Tolerances, send
    from comove.ros.clients import MIDDLEWARES

    o.require_one_of(part, PARTS, "part")
    if ros is not None and ros not in MIDDLEWARES:
        raise OptionError(f"there is no ROS {ros}", key="--ros", way_out="give 1 or 2")
    if not (goal_tolerance is None or 0 <= goal_tolerance < float("inf")):
        raise OptionError(
            f"{goal_tolerance} is not possible", key="--goal-tolerance", way_out="give 0 or more"
        )
    given = {"--start-tolerance": start_tolerance, "--path-tolerance": path_tolerance, "--timeout": timeout}
    for option, value in given.items():
        if not (value is None or 0 < value < float("inf")):
            raise OptionError(f"{value} is not possible", key=option, way_out="give a positive number")
    o.require_approach(present, part == "approach")
    tolerances = Tolerances(start=start_tolerance, path=path_tolerance, end=goal_tolerance, connect=timeout)
    motion = trusted.verified(folder)
    try:
        tolerances = tolerances.certified(motion)
    except OptionError as error:
        error.key = OPTIONS.get(error.key or "", error.key)
        raise
    if motion.report.uncertainty.joints is None:
        most = allowed_deviation(motion.robot, motion.motion, motion.joints)
        say(f"warning: {unproven(most)}", file=sys.stderr)
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
        versions = (ros,) if ros is not None else tuple(MIDDLEWARES)
        names = Names.of(motion.robot, action, joint_states)
        with RosClient(versions, names, sim_time=sim_time) as client:
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


def unproven(most: float) -> str:
    """Return a warning that deviations of joints are not certified.

    Parameters
    ----------
    most : largest deviation of all joints that the motion allows [rad]
    """
    told = "nothing is proved about joints that deviate from the motion: the robot's description states no deviations"
    if most == 0.0:
        return f"{told}, and the motion allows none"
    return (
        f"{told}; write uncertainty: {{joints: {most:g}}}, which the motion allows, and solve the scene again"
    )
