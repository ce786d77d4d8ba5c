"""`comove learn`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from comove.cli import recordings as r
from comove.cli.app import verb


@verb
def learn(
    demo: Annotated[
        str, typer.Argument(metavar="DEMO", help="Recording: a file, or lasa:SHAPE or lasa:SHAPE:DEMO.")
    ],
    out: Annotated[Path, typer.Option(help="File for the primitive (JSON).")],
    n_basis: r.NBasis = 20,
    variant: r.VariantName = "closed-form",
    phase: r.PhaseOption = None,
    period: r.Period = None,
    poses: r.Poses = False,
    manipulator: r.Manipulator = None,
    episode: r.Episode = None,
    topic: r.Topic = None,
    unit: r.Unit = None,
    columns: r.Columns = None,
    delimiter: r.Delimiter = None,
    time: r.Time = None,
    rate: r.Rate = None,
    clean: r.Clean = False,
) -> int:
    """Fit a movement primitive to DEMO and save it."""
    from comove.cli.texts import learned_text
    from comove.primitives import learn, write_primitive
    from comove.primitives.recordings import read_recording, require_metres

    r.check_target(out)
    reading = r.reading_options(columns, clean, unit=unit, delimiter=delimiter, time=time, rate=rate)
    recording = read_recording(demo, manipulator, episode, topic, **reading)
    if unit is None:
        require_metres(recording.demonstration, demo)
    options = r.learning_options(phase, n_basis=n_basis, variant=variant, period=period, poses=poses)
    primitive = learn(recording.demonstration, name=r.name_of_file(out), source=recording.source, **options)
    write_primitive(out, primitive)
    print(learned_text(primitive))
    print(f"  saved as       {out}")
    return 0
