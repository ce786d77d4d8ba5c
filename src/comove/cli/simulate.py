"""`comove simulate`."""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from comove.cli import options as o
from comove.cli.app import NOT_VERIFIED, VERIFIED, verb
from comove.cli.texts import say
from comove.errors import ComoveError, OptionError, ResultError

if TYPE_CHECKING:
    from comove.arrays import Array
    from comove.robots import VerifiedJointMotion
    from comove.sim.grasps import GraspModel
    from comove.sim.pictures import Filmed
    from comove.sim.settings import Perturbation

PARTS = (o.CARRY, "approach")
REHEARSAL = "Robots in ROS 2"


@dataclass(frozen=True)
class RehearsalOptions:
    """Options of a simulated robot behind ROS 2."""

    ros: Annotated[
        int | None,
        typer.Option(
            metavar="2",
            rich_help_panel=REHEARSAL,
            help="Serve the simulated robot in ROS 2, for `comove send` and other clients.",
        ),
    ] = None
    part: Annotated[
        str,
        typer.Option(
            rich_help_panel=REHEARSAL,
            help="Part that the robot is to begin with: carry, with the payload held at its start, or approach, with "
            "open grippers at home or the joints of --present.",
        ),
    ] = o.CARRY
    present: Annotated[Path | None, typer.Option(rich_help_panel=REHEARSAL, **o.PRESENT)] = None
    action: Annotated[str | None, typer.Option(rich_help_panel=REHEARSAL, **o.ACTION)] = None
    joint_states: Annotated[str | None, typer.Option(rich_help_panel=REHEARSAL, **o.JOINT_STATES)] = None
    rate: Annotated[float, typer.Option(rich_help_panel=REHEARSAL, help="Joint states a second [Hz].")] = (
        100.0
    )
    sim_time: Annotated[
        bool,
        typer.Option(
            "--sim-time", rich_help_panel=REHEARSAL, help="Tell simulated time on /clock, and use it."
        ),
    ] = False

    def wanted(self) -> bool:
        """Return whether the robot is to be served; refuse options that say nothing without."""
        if self.ros not in (None, 2):
            raise OptionError(
                f"robots are simulated in ROS 2, not in ROS {self.ros}", key="--ros", way_out="give 2"
            )
        if self.ros is None:
            o.require_defaults(self, "no robot is served in ROS", "give --ros 2 as well")
            return False
        o.require_one_of(self.part, PARTS, "part")
        o.require_approach(self.present, self.part == "approach")
        return True

    def joints(self, folder: Path, motion: VerifiedJointMotion) -> Array | None:
        """Return the joints at which the robot waits for an approach; None if it holds the payload."""
        from comove.robots.present import present_joints

        if self.part == o.CARRY:
            return None
        return present_joints(o.present_in(folder, motion, self.present), motion.robot)


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
    rehearsal: RehearsalOptions,
    trusted: o.Trusted,
) -> int:
    """Simulate the motion in DIR with MuJoCo. Servos, contacts, slip and forces on the payload are computed.

    With --ros 2 the robot is simulated in real time behind the interfaces of a real one, and moves as its clients
    say, until Ctrl-C.
    """
    import numpy as np

    from comove.cli.texts import simulation_text
    from comove.io.files import require_target
    from comove.sim import GRASPS, Perturbation, simulate, write_simulation

    o.require_one_of(grasp, tuple(GRASPS), "grasp")
    motion = trusted.verified(folder)
    robot, seed = motion.robot, seed if perturbed is None else perturbed
    drawn = None if seed is None else Perturbation.drawn(np.random.default_rng(seed), len(robot.joint_names))
    if rehearsal.wanted():
        return rehearse(motion, GRASPS[grasp](), drawn, rehearsal, rehearsal.joints(folder, motion))
    require_target(folder / "simulation.npz", ResultError)
    execution = simulate(motion.joints, motion.scene, robot, GRASPS[grasp](), drawn)
    summary = write_simulation(execution, folder, seed=seed)
    draw_robot_pictures(execution, folder, "simulation", pictures, film)
    print(simulation_text(summary, folder))
    return VERIFIED if summary["delivered"] else NOT_VERIFIED


def rehearse(
    motion: VerifiedJointMotion,
    grasp: GraspModel,
    perturbation: Perturbation | None,
    options: RehearsalOptions,
    present: Array | None,
) -> int:
    """Serve the simulated robot in ROS 2 until Ctrl-C; print what it offers, and at the end what it carried."""
    from comove.cli.texts import in_rows, rehearsal_text
    from comove.planning.search import Interruption
    from comove.ros.clients import Names
    from comove.ros.rehearsal import Rehearsal, RehearsalSettings
    from comove.sim.engine import without_log
    from comove.sim.robot import SimulatedRobot

    settings = RehearsalSettings(rate=options.rate, sim_time=options.sim_time)
    names = Names.of(motion.robot, options.action, options.joint_states)
    simulated = SimulatedRobot(
        motion.joints, motion.scene, motion.robot, grasp, perturbation, present=present
    )
    # A second Ctrl-C ends the context below wherever it is.
    interruption, ended, delivered = Interruption(), "", False
    with interruption.noticed(), Rehearsal(simulated, names, settings, tell=_say_now) as rehearsal:
        _say_now(*in_rows(rehearsal.offers()), "ready; Ctrl-C ends it")
        try:
            with without_log():
                ended = rehearsal.run(lambda: interruption.wished)
        finally:
            report = simulated.report()
            names_of = motion.scene.name, motion.robot.name, type(grasp).__name__.lower()
            _say_now(*rehearsal_text(report, *names_of).splitlines())
            delivered = report.delivered
    if ended:
        say(f"error: {ended}", file=sys.stderr)
    return VERIFIED if delivered and not ended else NOT_VERIFIED


def _say_now(*lines: str) -> None:
    """Print lines, also into a pipe at once."""
    say(*lines)
    sys.stdout.flush()


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
