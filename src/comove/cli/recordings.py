"""Recordings on the command line, a file or lasa:SHAPE:DEMO, and the options of learning."""

from __future__ import annotations

import re
from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from comove.errors import DemonstrationError, LibraryError

LASA = "lasa:"
PICTURES = (".png", ".pdf", ".svg")
VARIANTS = ("closed-form", "classic", "pastor", "dmp++", "rhythmic")


class PhaseName(StrEnum):
    """Names of the canonical systems."""

    exponential = "exponential"
    linear = "linear"


DemoArgument = typer.Argument(metavar="DEMO", help="Recording: a file, or lasa:SHAPE or lasa:SHAPE:DEMO.")
NBasis = Annotated[int, typer.Option(help="Free shape weights a dimension, 1 to 200.")]
VariantName = Annotated[str, typer.Option(help=f"One of: {', '.join(VARIANTS)}.")]
PhaseOption = Annotated[
    PhaseName | None, typer.Option(help="Canonical system; the variant's usual one unless given.")
]
Period = Annotated[
    float | None, typer.Option(help="Period of a rhythmic movement [s]; found in the recording unless given.")
]
Poses = Annotated[bool, typer.Option("--poses", help="Learn orientations as well.")]
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


def reading_options(
    unit: str | None,
    columns: str | None,
    delimiter: str | None,
    time: str | None,
    rate: float | None,
    clean: bool,
) -> dict:
    """Return the options for `Demonstration.load`, except the choice of a movement; only those that were given."""
    names = None if columns is None else [name.strip() for name in columns.split(",")]
    said = {"unit": unit, "columns": names, "delimiter": delimiter, "time": time, "rate": rate}
    return {key: value for key, value in said.items() if value is not None} | (
        {"clean": True} if clean else {}
    )


def require_metres(recording, demo: str) -> None:
    """Raise if the numbers of a recording do not look like metres, unless its unit was given."""
    from comove.demonstrations.cleaning import unit_hint

    if hint := unit_hint(recording.position, recording.unit):
        raise DemonstrationError(
            hint.partition(",")[0],
            file=demo,
            key="--unit",
            way_out="give --unit mm, or --unit m if it is right",
        )


def read_recordings(
    demo: str, manipulator: str | None, episode: str | None, topic: str | None, options: dict | None = None
) -> list:
    """Return the movements of a recording, each with its source and a name.

    Parameters
    ----------
    options : result of `reading_options`

    Returns
    -------
    list of (Demonstration, source, name); one entry if a choice was made or only one movement exists
    """
    from comove.demonstrations import Demonstration

    if demo.startswith(LASA):
        shape, _, number = demo.removeprefix(LASA).partition(":")
        if number and not number.isdigit():
            raise DemonstrationError(
                f"{number!r} is no recording", file=demo, way_out="write lasa:SHAPE:0 to :6"
            )
        recording = Demonstration.from_lasa(shape, int(number or 0))
        return [(recording, f"{LASA}{shape}:{int(number or 0)}", f"{shape}-{int(number or 0)}")]
    path, options = Path(demo), options or {}
    source = path.name.encode(errors="replace").decode()
    if (manipulator, episode, topic) == (None, None, None) and not options:
        found = Demonstration.load_all(path)
        if len(found) == 1:
            return [(found[0], source, file_name(path.stem))]
        return [(one, source, file_name(one.name or path.stem)) for one in found]
    one = Demonstration.load(path, manipulator, episode=episode, topic=topic, **options)
    chosen = ".".join(choice for choice in (path.stem, episode, manipulator, topic) if choice)
    return [(one, source, file_name(chosen))]


def read_recording(
    demo: str, manipulator: str | None, episode: str | None, topic: str | None, options: dict | None = None
) -> tuple:
    """Return the only movement of a recording, or the chosen one; (Demonstration, source, name)."""
    from comove.demonstrations import Demonstration

    found = read_recordings(demo, manipulator, episode, topic, options)
    if len(found) > 1:
        Demonstration.load(demo)  # which says what there is to choose from
        raise DemonstrationError(
            f"it holds {len(found)} movements", file=demo, way_out="choose one by --manipulator or --episode"
        )
    return found[0]


def learning_options(
    n_basis: int, variant: str, phase: PhaseName | None, period: float | None, poses: bool
) -> dict:
    """Return the keyword arguments of `learn`."""
    from comove.primitives import ExponentialPhase, LinearPhase

    phases = {PhaseName.linear: LinearPhase(), PhaseName.exponential: ExponentialPhase()}
    return {
        "n_basis": n_basis,
        "variant": variant,
        "phase": phases.get(phase),
        "period": period,
        "poses": poses,
    }


def recording_of(primitive):
    """Return the recording from which a primitive was learned; None if it is missing or has changed."""
    from comove.errors import ComoveError
    from comove.primitives.files import checksum

    if primitive.provenance is None:
        return None
    try:
        for recording, *_ in read_recordings(primitive.provenance.source, None, None, None):
            if checksum(recording) == primitive.provenance.sha256:
                return recording
    except ComoveError:
        pass
    return None


def file_name(text: str) -> str:
    """Return a valid name for a primitive, made from any text."""
    return re.sub(r"[^\w.+-]+", "-", text).strip("-.+")[:100] or "movement"


def check_target(path: Path) -> None:
    """Check, before a long computation, that a primitive can be written to `path`."""
    from comove.io.files import require_target
    from comove.primitives.files import is_primitive

    require_target(path, LibraryError)
    if path.exists() and not is_primitive(path):
        raise LibraryError(
            "it is there already and is no primitive", file=path, way_out="choose another name"
        )


def learned_text(primitive) -> str:
    """Return a few readable lines about a learned primitive and how well it fits."""
    dmp, p = primitive.positions, primitive.provenance
    what = f"{dmp.variant} of {dmp.weights.shape[1]} weights in {dmp.n_dims} dimensions"
    what += " and orientation" if primitive.kind == "pose" else ""
    unit = primitive.unit
    lines = [f"{primitive.name}: {what}, {dmp.duration:.4g} s"]
    if p is not None:
        lines.append(f"  learned from   {p.source or p.recording}, {p.n_samples} samples")
        lines += [f"                 {note}" for note in p.notes]
        lines.append(
            f"  fit error      {p.error_rms:.3g} {unit} (root mean square), {p.error_max:.3g} {unit} at most"
        )
        if p.turn_rms is not None:
            lines.append(
                f"  turn error     {p.turn_rms:.3g} rad (root mean square), {p.turn_max:.3g} rad at most"
            )
    lines += [f"  {note}" for note in primitive.notes]
    return "\n".join(lines)


def check_picture(path: Path | None) -> None:
    """Check, before a long computation, that a picture can be written to `path`, if one is wanted."""
    from comove.errors import OptionError
    from comove.io.files import require_target

    if path is None:
        return
    if path.suffix.lower() not in PICTURES:
        raise OptionError("it is no picture's name", file=path, way_out="end it in .png, .pdf or .svg")
    require_target(path, OptionError)


def save_picture(figure, path: Path) -> None:
    """Write a figure, or raise an error that says in one sentence why that is impossible."""
    from comove.errors import OptionError
    from comove.io.files import whole_path
    from comove.views import save

    check_picture(path)
    with whole_path(path, OptionError) as draft:
        save(figure, draft)
