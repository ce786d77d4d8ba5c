"""`comove library find`."""

from __future__ import annotations

from typing import Annotated

import typer

from comove.cli.app import verb_of
from comove.cli.library.app import FOLDER, Folder, library_app
from comove.cli.recordings import read_recording
from comove.errors import OptionError


@verb_of(library_app)
def find(
    folder: Folder = FOLDER,
    start: Annotated[str | None, typer.Option(metavar="X,Y", help="Wanted start.")] = None,
    goal: Annotated[str | None, typer.Option(metavar="X,Y", help="Wanted goal.")] = None,
    duration: Annotated[float | None, typer.Option(help="Wanted duration [s].")] = None,
    like: Annotated[
        str | None, typer.Option(help="Wanted shape: a primitive of the library, or a recording.")
    ] = None,
    limit: Annotated[int, typer.Option(help="How many to list.")] = 10,
    json: Annotated[bool, typer.Option("--json", help="Print JSON and nothing else.")] = False,
) -> int:
    """Rank the primitives of the library by their distance from what is wanted."""
    from comove.primitives import Library

    library = Library(folder)
    shape = None
    if like is not None:
        is_recording = like not in library.names and (":" in like or "." in like or "/" in like)
        shape = read_recording(like, None, None, None)[0] if is_recording else library.get(like)
    matches = library.find(
        start=_numbers("--start", start),
        goal=_numbers("--goal", goal),
        duration=duration,
        shape=shape,
        limit=limit,
    )
    if json:
        from dataclasses import asdict
        from json import dumps

        print(dumps([asdict(match) for match in matches], indent=2))
        return 0
    if not matches:
        print(f"{folder} holds no movement of this dimension")
        return 0
    rows = [("name", "distance", "shape", "start off by", "goal off by", "duration")]
    for m in matches:
        cells = (m.distance, m.shape, m.start, m.goal)
        shown = ["-" if cell is None else f"{cell:.3g}" for cell in cells]
        rows.append((m.name, *shown, "-" if m.duration is None else f"x {m.duration:.3g}"))
    kept = [column for column in zip(*rows, strict=True) if set(column[1:]) != {"-"}]
    widths = [max(map(len, column)) for column in kept]
    for row in zip(*kept, strict=True):
        print("  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip())
    return 0


def _numbers(option: str, text: str | None) -> list[float] | None:
    """Return the coordinates in a text with commas between them; None for None."""
    if text is None:
        return None
    try:
        return [float(part) for part in text.split(",")]
    except ValueError:
        raise OptionError(f"{text!r} are no coordinates", key=option, way_out="write X,Y or X,Y,Z") from None
