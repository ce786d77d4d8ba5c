"""`comove learn`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from comove.cli import recordings as r
from comove.cli.app import verb


@verb
def learn(
    demos: Annotated[
        list[str],
        typer.Argument(
            metavar="DEMO...",
            help="Recording: a file, lasa:SHAPE or lasa:SHAPE:DEMO. Of several, or a folder (lasa:SHAPE:all), the "
            "distribution is learned.",
        ),
    ],
    out: Annotated[Path, typer.Option(help="File for the primitive (JSON).")],
    n_basis: r.NBasis = 20,
    variant: r.VariantName = "closed-form",
    phase: r.PhaseOption = None,
    period: r.Period = None,
    poses: r.Poses = False,
    in_motion: r.InMotion = False,
    align: Annotated[
        str,
        typer.Option(
            help="How several recordings are aligned in time: by 'duration', at equal shares, or by 'warping', at "
            "equal places."
        ),
    ] = "duration",
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
    """Fit a movement primitive to DEMO, or a distribution of movements to several, and save it."""
    from comove.cli.texts import learned_text
    from comove.primitives import learn, write_primitive
    from comove.primitives.recordings import is_several, read_recording, require_metres

    r.check_target(out)
    reading = r.reading_options(columns, clean, unit=unit, delimiter=delimiter, time=time, rate=rate)
    if len(demos) > 1 or is_several(demos[0]):
        r.refuse_of_distributions(variant=variant, period=period, in_motion=in_motion)
        chosen = {"manipulator": manipulator, "episode": episode, "topic": topic}
        given = reading | {key: value for key, value in chosen.items() if value is not None}
        return _learn_distribution(
            demos, out, given, n_basis=n_basis, phase=phase, alignment=align, poses=poses
        )
    demo = demos[0]
    recording = read_recording(demo, manipulator, episode, topic, **reading)
    if unit is None:
        require_metres(recording.demonstration, demo)
    options = r.learning_options(
        phase, n_basis=n_basis, variant=variant, period=period, poses=poses, at_rest=not in_motion
    )
    primitive = learn(recording.demonstration, name=r.name_of_file(out), source=recording.source, **options)
    write_primitive(out, primitive)
    print(learned_text(primitive))
    print(f"  saved as       {out}")
    return 0


def _learn_distribution(
    demos: list[str],
    out: Path,
    reading: dict[str, Any],
    *,
    n_basis: int,
    phase: r.PhaseName | None,
    alignment: str,
    poses: bool,
) -> int:
    from comove.cli.texts import learned_text
    from comove.primitives import learn_distribution, write_primitive
    from comove.primitives.recordings import read_several, require_metres

    found, sources = read_several(demos, **reading)
    for recording, source in zip(found, sources, strict=True) if "unit" not in reading else ():
        for one in recording.values() if isinstance(recording, dict) else [recording]:
            require_metres(one, source)
    options = r.learning_options(phase, n_basis=n_basis, alignment=alignment, poses=poses)
    primitive = learn_distribution(found, name=r.name_of_file(out), sources=sources, **options)
    write_primitive(out, primitive)
    print(learned_text(primitive))
    print(f"  saved as       {out}")
    return 0
