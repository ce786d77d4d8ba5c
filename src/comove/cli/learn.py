"""`comove learn`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from comove.cli import recordings as r
from comove.cli.app import verb
from comove.cli.texts import say


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
    *,
    learning: r.Learning,
    align: Annotated[
        str,
        typer.Option(
            help="How several recordings are aligned in time: by 'duration', at equal shares, or by 'warping', at "
            "equal places."
        ),
    ] = "duration",
    picture: Annotated[
        Path | None,
        typer.Option(help="Picture of recording and primitive (PNG, PDF or SVG); beside OUT unless given."),
    ] = None,
    reading: r.Reading,
) -> int:
    """Fit a movement primitive to DEMO; save and draw it. Several recordings give a distribution of movements."""
    from comove.cli.texts import learned_text
    from comove.dmp import learn, learn_distribution, write_primitive
    from comove.dmp.demonstrations import Demonstration
    from comove.dmp.recordings import is_several, read_recording, read_several

    r.check_target(out)
    drawn = r.picture_target(out, picture)
    name = r.name_of_file(out)
    if len(demos) > 1 or is_several(demos[0]):
        arguments = learning.of_distribution(align)
        found, sources = read_several(demos, **reading.arguments)
        movements = [
            {name: reading.movement(one, source) for name, one in recording.items()}
            if isinstance(recording, dict)
            else reading.movement(recording, source)
            for recording, source in zip(found, sources, strict=True)
        ]
        movement = movements[0]
        primitive = learn_distribution(movements, name=name, sources=sources, **arguments)
    else:
        (demo,) = demos
        read = read_recording(demo, **reading.arguments)
        movement = reading.movement(read.demonstration, demo)
        primitive = learn(movement, name=name, source=read.source, **learning.arguments)
    recording = movement if isinstance(movement, Demonstration) else None
    if drawn is not None:
        from comove.view.figures import draw_primitive, save_picture

        save_picture(draw_primitive(primitive, recording), drawn)
    write_primitive(out, primitive)
    print(learned_text(primitive))
    say(f"  saved as       {out}" + (f", drawn as {drawn}" if drawn is not None else ""))
    return 0
