"""Options for reading recordings and learning from them."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from comove.errors import LibraryError, OptionError
from comove.io.files import telling

if TYPE_CHECKING:
    from comove.dmp.demonstrations import Demonstration

VARIANTS = ("closed-form", "classic", "pastor", "dmp++", "rhythmic")


class PhaseName(StrEnum):
    """Names of the canonical systems."""

    exponential = "exponential"
    linear = "linear"


@dataclass(frozen=True)
class Learning:
    """Options for learning a primitive."""

    n_basis: Annotated[int, typer.Option(help="Free shape weights a dimension, 1 to 200.")] = 20
    variant: Annotated[str, typer.Option(help=f"One of: {', '.join(VARIANTS)}.")] = VARIANTS[0]
    phase: Annotated[
        PhaseName | None, typer.Option(help="Canonical system; the variant's usual one unless given.")
    ] = None
    period: Annotated[
        float | None,
        typer.Option(help="Period of a rhythmic movement [s]; found in the recording unless given."),
    ] = None
    poses: Annotated[bool, typer.Option("--poses", help="Learn orientations as well.")] = False
    in_motion: Annotated[
        bool,
        typer.Option(
            "--in-motion", help="End with the recording's velocity, such as a throw; at rest unless given."
        ),
    ] = False

    @property
    def arguments(self) -> dict[str, Any]:
        """Return the keyword arguments of `learn`."""
        own = {"variant": self.variant, "period": self.period, "at_rest": not self.in_motion}
        return self._shared | own

    def of_distribution(self, alignment: str) -> dict[str, Any]:
        """Return the keyword arguments of `learn_distribution`."""
        given = {
            "--variant": self.variant != VARIANTS[0],
            "--period": self.period is not None,
            "--in-motion": self.in_motion,
        }
        for key, is_given in given.items():
            if is_given:
                raise OptionError(
                    "several recordings make a distribution, in the closed form and with the velocities of its ends",
                    key=key,
                    way_out="leave it out, or give one recording",
                )
        return self._shared | {"alignment": alignment}

    @property
    def _shared(self) -> dict[str, Any]:
        from comove.dmp import ExponentialPhase, LinearPhase

        phases = {None: None, PhaseName.linear: LinearPhase(), PhaseName.exponential: ExponentialPhase()}
        return {"phase": phases[self.phase], "n_basis": self.n_basis, "poses": self.poses}


def _rate(text: str) -> float:
    try:
        return float(text)
    except ValueError:
        raise typer.BadParameter(
            f"{text!r} is no number; give the samples a second, as the recorder or its documentation says"
        ) from None


@dataclass(frozen=True)
class Reading:
    """Options for reading a recording."""

    manipulator: Annotated[str | None, typer.Option(help="Whose movement, where several were recorded.")] = (
        None
    )
    episode: Annotated[str | None, typer.Option(help="Which recording of a file that holds several.")] = None
    topic: Annotated[
        str | None,
        typer.Option(help="Which topic of a bag, or which movement of it: TOPIC:NAME, /tf:CHILD@PARENT."),
    ] = None
    dataset: Annotated[
        str | None, typer.Option(metavar="PATH", help="Which dataset of an HDF5 file, such as obs/ee_pos.")
    ] = None
    feature: Annotated[
        str | None,
        typer.Option(help="Which vector of a LeRobot dataset; observation.state unless given."),
    ] = None
    unit: Annotated[
        str | None,
        typer.Option(
            help="Unit of its lengths: m, cm, mm, in, ...; metres, or what the file says, unless given."
        ),
    ] = None
    columns: Annotated[
        str | None,
        typer.Option(
            metavar="X,Y,Z",
            help="Columns of the positions in a text table, by name or number, or a body's name; found unless given.",
        ),
    ] = None
    delimiter: Annotated[
        str | None,
        typer.Option(help="What separates the columns: ';', ',', 'tab' or 'space'; found unless given."),
    ] = None
    time: Annotated[
        str | None,
        typer.Option(help="Column of time, with its unit where the file does not say it: 'stamp [ms]'."),
    ] = None
    rate: Annotated[
        float | None,
        typer.Option(
            parser=_rate, metavar="HZ", help="Samples a second, where there is no column of time [Hz]."
        ),
    ] = None
    drop_missing: Annotated[
        bool,
        typer.Option("--drop-missing", help="Leave out rows of a table in which something was not measured."),
    ] = False
    robot: Annotated[
        str | None,
        typer.Option(
            metavar="ROBOT",
            help="Robot whose joints were recorded, for the path of its end effector: a bundled one's name, or "
            "a description (YAML).",
        ),
    ] = None
    arm: Annotated[str | None, typer.Option(help="Which arm of ROBOT, where several could be meant.")] = None
    clean: Annotated[
        bool,
        typer.Option(
            "--clean",
            help="Take the movement between the pauses, and its noise away; what was done is told.",
        ),
    ] = False

    @property
    def arguments(self) -> dict[str, Any]:
        """Return the keyword arguments of `read_recording` that were given."""
        names = None if self.columns is None else [name.strip() for name in self.columns.split(",")]
        given = {**vars(self), "columns": names}
        return {
            key: value
            for key, value in given.items()
            if value is not None and value is not False and key not in ("robot", "arm")
        }

    def movement(self, recording: Demonstration, named: str) -> Demonstration:
        """Return a plausible recording, for joints the end effector's path.

        Raises
        ------
        DemonstrationError
            If its units look wrong, or it does not fit the robot.
        """
        from comove.dmp.demonstrations.samples import advising
        from comove.dmp.recordings import require_plausible

        with advising(named, self.arguments):
            require_plausible(recording, named)
        if self.robot is None:
            if self.arm is not None:
                raise OptionError("an arm of which robot?", key="--arm", way_out="name it: --robot ROBOT")
            return recording
        from comove.robots import Robot, end_effector_path

        robot = Robot.load(self.robot)
        sides = [arm.name for arm in robot.arms]
        arm = self.arm or (self.manipulator if self.manipulator in sides else None)
        with advising(named, self.arguments | {"robot": self.robot, "arm": self.arm}):
            return end_effector_path(recording, robot, arm)


def picture_target(out: Path, picture: Path | None) -> Path | None:
    """Return `picture`, else a path beside `out`; None over other pictures."""
    from comove.cli.options import check_picture

    if picture is not None:
        check_picture(picture)
        return picture
    beside = out.with_suffix(".png")
    if beside.exists():
        with telling(beside), open(beside, "rb") as file:
            if b"Matplotlib" not in file.read(1024):
                return None
    return beside


def check_target(path: Path) -> None:
    """Check in advance that a primitive can be written to `path`."""
    from comove.dmp.files import is_primitive
    from comove.io.files import require_target

    require_target(path, LibraryError)
    if path.exists() and not is_primitive(path):
        raise LibraryError(
            "it is there already and is no primitive", file=path, way_out="choose another name"
        )


def name_of_file(path: Path) -> str:
    """Return the primitive's name for the file `path`."""
    from comove.dmp.recordings import name_from

    return name_from(path.name.removesuffix(".json").removesuffix(".dmp"))
