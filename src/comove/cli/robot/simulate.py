"""`comove robot simulate`."""

from __future__ import annotations

import sys
from typing import Annotated

import typer

from comove.cli.app import NOT_VERIFIED, VERIFIED, verb_of
from comove.cli.robot.app import Folder, robot_app

GRASPS = ("weld", "connect", "friction")


@verb_of(robot_app)
def simulate(
    folder: Folder,
    grasp: Annotated[str, typer.Option(help=f"How the hands hold the load: {', '.join(GRASPS)}.")] = "weld",
    seed: Annotated[
        int | None,
        typer.Option(
            min=0,
            help="Draw friction, mass, gains, the load's place in the hands and a push from this seed; "
            "as planned unless given.",
        ),
    ] = None,
    pictures: Annotated[bool, typer.Option(help="Draw a sheet of pictures.")] = True,
    film: Annotated[bool, typer.Option("--film", help="Draw a film as well (MP4, or GIF).")] = False,
) -> int:
    """Play the motion in DIR with MuJoCo: servos, contacts, slip, forces on the load."""
    import numpy as np

    from comove.cli.robot.report import simulation_text, stored_motion
    from comove.errors import ComoveError, OptionError, ResultError, near_name
    from comove.io.files import require_target
    from comove.simulators import (
        Connect,
        Friction,
        Perturbation,
        Weld,
        draw_film,
        draw_sheet,
        simulate,
        write_simulation,
    )

    grasps = dict(zip(GRASPS, (Weld, Connect, Friction), strict=True))
    if grasp not in grasps:
        raise OptionError(f"unknown grasp '{grasp}'", key="--grasp", way_out=near_name(grasp, grasps))
    motion = stored_motion(folder)
    require_target(folder / "simulation.npz", ResultError)
    robot = motion.robot
    drawn = None if seed is None else Perturbation.drawn(np.random.default_rng(seed), len(robot.joint_names))
    execution = simulate(motion.joints, motion.scene, robot, grasps[grasp](), drawn)
    summary = write_simulation(execution, folder, seed=seed)
    print(simulation_text(summary, folder))
    if pictures or film:
        try:
            if pictures:
                draw_sheet(execution, folder / "simulation.png")
                print(f"  {'pictures':24s}{folder / 'simulation.png'}")
            if film:
                print(f"  {'film':24s}{draw_film(execution, folder / 'simulation.mp4')}")
        except ComoveError as error:  # what was simulated counts without them
            print(f"warning: no pictures: {error}", file=sys.stderr)
    return VERIFIED if summary["delivered"] else NOT_VERIFIED
