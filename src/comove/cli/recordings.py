"""Options of reading recordings and of learning from them."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import Annotated, Any

import typer

from comove.errors import LibraryError, OptionError

VARIANTS = ("closed-form", "classic", "pastor", "dmp++", "rhythmic")


class PhaseName(StrEnum):
    """Names of the canonical systems."""

    exponential = "exponential"
    linear = "linear"


NBasis = Annotated[int, typer.Option(help="Free shape weights a dimension, 1 to 200.")]
VariantName = Annotated[str, typer.Option(help=f"One of: {', '.join(VARIANTS)}.")]
PhaseOption = Annotated[
    PhaseName | None, typer.Option(help="Canonical system; the variant's usual one unless given.")
]
Period = Annotated[
    float | None, typer.Option(help="Period of a rhythmic movement [s]; found in the recording unless given.")
]
Poses = Annotated[bool, typer.Option("--poses", help="Learn orientations as well.")]
InMotion = Annotated[
    bool,
    typer.Option(
        "--in-motion", help="End with the recording's velocity, such as a throw; at rest unless given."
    ),
]
Manipulator = Annotated[str | None, typer.Option(help="Whose movement, where several were recorded.")]
Episode = Annotated[str | None, typer.Option(help="Which recording of a file that holds several.")]
Topic = Annotated[str | None, typer.Option(help="Which topic of a bag.")]
Unit = Annotated[
    str | None,
    typer.Option(
        help="Unit of its lengths: m, cm, mm, in, ...; metres, or what the file says, unless given."
    ),
]
Columns = Annotated[
    str | None,
    typer.Option(
        metavar="X,Y,Z",
        help="Columns of the positions in a text table, by name or number; of any program's making.",
    ),
]
Delimiter = Annotated[
    str | None,
    typer.Option(help="What separates the columns: ';', ',', 'tab' or 'space'; found unless given."),
]
Time = Annotated[
    str | None,
    typer.Option(help="Column of time, with its unit where the file does not say it: 'stamp [ms]'."),
]
Rate = Annotated[float | None, typer.Option(help="Samples a second, where there is no column of time [Hz].")]
Clean = Annotated[
    bool,
    typer.Option(
        "--clean", help="Take the movement between the pauses, and its noise away; what was done is told."
    ),
]


def reading_options(columns: str | None, clean: bool, **others: Any) -> dict[str, Any]:
    """Return the options for `read_recordings`; only those that were given."""
    names = None if columns is None else [name.strip() for name in columns.split(",")]
    given = {"columns": names, "clean": clean or None, **others}
    return {key: value for key, value in given.items() if value is not None}


def learning_options(phase: PhaseName | None, **others: Any) -> dict[str, Any]:
    """Return the keyword arguments of `learn`."""
    from comove.primitives import ExponentialPhase, LinearPhase

    phases = {None: None, PhaseName.linear: LinearPhase(), PhaseName.exponential: ExponentialPhase()}
    return {"phase": phases[phase], **others}


def refuse_of_distributions(*, variant: str, period: float | None, in_motion: bool) -> None:
    """Raise if an option was given that distributions of movements do not have."""
    given = {"--variant": variant != "closed-form", "--period": period is not None, "--in-motion": in_motion}
    for key, is_given in given.items():
        if is_given:
            raise OptionError(
                "several recordings make a distribution, in the closed form and with the velocities of its ends",
                key=key,
                way_out="leave it out, or give one recording",
            )


def check_target(path: Path) -> None:
    """Check, before a long computation, that a primitive can be written to `path`."""
    from comove.io.files import require_target
    from comove.primitives.files import is_primitive

    require_target(path, LibraryError)
    if path.exists() and not is_primitive(path):
        raise LibraryError(
            "it is there already and is no primitive", file=path, way_out="choose another name"
        )


def name_of_file(path: Path) -> str:
    """Return the name of the primitive that is written to `path`."""
    from comove.primitives.recordings import name_from

    return name_from(path.name.removesuffix(".json").removesuffix(".dmp"))
