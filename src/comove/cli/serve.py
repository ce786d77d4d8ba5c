"""`comove serve`."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated

import typer

from comove.cli import options as o
from comove.cli.app import NOT_VERIFIED, VERIFIED, verb
from comove.cli.texts import in_rows, say
from comove.errors import OptionError


@verb
def serve(
    robot: Annotated[
        str, typer.Option(metavar="ROBOT", help="A description (YAML), or a bundled robot's name.")
    ],
    ros: Annotated[int, typer.Option(metavar="2", help="Version of ROS; 2 is the only one.")] = 2,
    name: Annotated[
        str, typer.Option(metavar="NAME", help="Name of the action, of type moveit_msgs/action/MoveGroup.")
    ] = "/comove/move_action",
    topic: Annotated[str, typer.Option(**o.SCENE_TOPIC)] = "/monitored_planning_scene",
    scene: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE",
            help="Planning scene of MoveIt (a bag of ROS 2, or .scene), used until the topic publishes one.",
        ),
    ] = None,
    payload: Annotated[
        str | None,
        typer.Option(metavar="NAME", help="Attached object that is the payload, where there are several."),
    ] = None,
    leave_out: Annotated[
        list[str] | None, typer.Option(metavar="NAME", help="Object that is left out; may be repeated.")
    ] = None,
    srdf: Annotated[
        Path | None,
        typer.Option(help="SRDF with the groups that requests may name; the robot's name is one as well."),
    ] = None,
    budget: Annotated[
        float, typer.Option(help="Processor time for a request that sets no allowed_planning_time [s].")
    ] = 5.0,
    effort: Annotated[
        o.EffortMode, typer.Option(help="How long the search improves a verified motion.")
    ] = o.EffortMode.quick,
    rate: Annotated[float, typer.Option(help="Points of a trajectory a second [Hz].")] = 100.0,
    seed: o.Seed = 0,
) -> int:
    """Plan for MoveIt 2: answer requests for motions of arms that hold one payload, until Ctrl-C.

    The trajectories are verified. Nothing moves: clients execute them.
    """
    from comove.planning.search import Interruption
    from comove.robots import Robot
    from comove.robots.planning_scenes import ImportOptions
    from comove.ros.parts import LARGEST_RATE, LEAST_RATE
    from comove.ros.planning_server import PlanningServer, PlanningSettings

    if ros != 2:
        raise OptionError(f"MoveIt 2 is of ROS 2, not of ROS {ros}", key="--ros", way_out="give 2")
    if not 0.0 < budget < float("inf"):
        raise OptionError(f"{budget} is not possible", key="--budget", way_out="give a positive number")
    if not LEAST_RATE <= rate <= LARGEST_RATE:
        way_out = f"give a number from {LEAST_RATE:g} to {LARGEST_RATE:g}"
        raise OptionError(f"{rate} Hz are not possible", key="--rate", way_out=way_out)
    settings = PlanningSettings(
        action=name,
        topic=topic,
        scene=scene,
        options=ImportOptions(payload=payload, leave_out=tuple(leave_out or ())),
        srdf=srdf,
        budget=budget,
        effort=effort.value,
        seed=seed,
        rate=rate,
    )
    interruption = Interruption()
    with (
        interruption.noticed(),
        PlanningServer(Robot.load(robot), settings, tell=_say_now) as server,
    ):
        _say_now(*in_rows(server.offers()), "ready; Ctrl-C ends it")
        server.run(lambda: interruption.wished)
    if server.ended:
        say(f"error: {server.ended}", file=sys.stderr)
    return NOT_VERIFIED if server.ended else VERIFIED


def _say_now(*lines: str) -> None:
    """Print lines, also into a pipe at once."""
    say(*lines)
    sys.stdout.flush()
