"""`comove learn`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from comove.cli import recordings as r
from comove.cli.app import verb


@verb
def learn(
    demo: Annotated[str, r.DemoArgument],
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
    from comove.primitives import learn, write_primitive

    r.check_target(out)
    reading = r.reading_options(unit, columns, delimiter, time, rate, clean)
    recording, source, _ = r.read_recording(demo, manipulator, episode, topic, reading)
    if unit is None:
        r.require_metres(recording, demo)
    options = r.learning_options(n_basis, variant, phase, period, poses)
    name = r.file_name(out.name.removesuffix(".json").removesuffix(".dmp"))
    primitive = learn(recording, name=name, source=source, **options)
    write_primitive(out, primitive)
    print(r.learned_text(primitive))
    print(f"  saved as       {out}")
    return 0
