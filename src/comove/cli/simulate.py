"""`comove simulate`."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from comove.cli import options as o
from comove.cli.app import NOT_VERIFIED, VERIFIED, verb
from comove.cli.texts import say
from comove.errors import ComoveError, ResultError

if TYPE_CHECKING:
    from comove.sim.pictures import Filmed


@verb
def simulate(
    folder: o.JointFolder,
    grasp: Annotated[
        str, typer.Option(help="How end effectors hold the payload: weld, connect, friction.")
    ] = "weld",
    perturbed: Annotated[
        int | None,
        typer.Option(
            min=0,
            help="Draw friction, mass, gains, the payload's place in the end effectors and a push from this seed; "
            "as planned unless given.",
        ),
    ] = None,
    seed: Annotated[int | None, typer.Option(min=0, hidden=True)] = None,  # its former name
    pictures: Annotated[bool, typer.Option(help="Draw a sheet of pictures.")] = True,
    film: Annotated[bool, typer.Option("--film", help="Draw a film as well (MP4, or GIF).")] = False,
    *,
    trusted: o.Trusted,
) -> int:
    """Simulate the motion in DIR with MuJoCo. Servos, contacts, slip and forces on the payload are computed."""
    import numpy as np

    from comove.cli.texts import simulation_text
    from comove.io.files import require_target
    from comove.sim import GRASPS, Perturbation, simulate, write_simulation

    o.require_one_of(grasp, tuple(GRASPS), "grasp")
    motion = trusted.verified(folder)
    require_target(folder / "simulation.npz", ResultError)
    robot, seed = motion.robot, seed if perturbed is None else perturbed
    drawn = None if seed is None else Perturbation.drawn(np.random.default_rng(seed), len(robot.joint_names))
    execution = simulate(motion.joints, motion.scene, robot, GRASPS[grasp](), drawn)
    summary = write_simulation(execution, folder, seed=seed)
    draw_robot_pictures(execution, folder, "simulation", pictures, film)
    print(simulation_text(summary, folder))
    return VERIFIED if summary["delivered"] else NOT_VERIFIED


def draw_robot_pictures(filmed: Filmed, folder: Path, name: str, pictures: bool, film: bool) -> None:
    """Draw pictures and a film into a folder; warn on failure."""
    from comove.sim.pictures import draw_film, draw_sheet

    try:
        if pictures:
            draw_sheet(filmed, folder / f"{name}.png")
        if film:
            draw_film(filmed, folder / f"{name}.mp4")
    except ComoveError as error:  # the result counts without them
        say(f"warning: no pictures: {error}", file=sys.stderr)
