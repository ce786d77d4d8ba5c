"""`comove library show`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from comove.cli.app import verb_of
from comove.cli.library.app import FOLDER, Folder, library_app
from comove.cli.recordings import check_picture, learned_text, recording_of, save_picture


@verb_of(library_app)
def show(
    name: Annotated[str, typer.Argument(metavar="NAME", help="Of the primitive.")],
    folder: Folder = FOLDER,
    out: Annotated[Path | None, typer.Option(help="Picture of it (PNG, PDF or SVG).")] = None,
) -> int:
    """Print what is known of a primitive, and draw it."""
    from comove.primitives import Library

    check_picture(out)
    library = Library(folder)
    primitive = library.get(name)
    dmp, unit = primitive.positions, primitive.unit
    print(learned_text(primitive))
    ends = ("centre" if dmp.variant == "rhythmic" else "goal"), dmp.goal
    for what, point in (("start", dmp.start), ends):
        print(f"  {what:13s}  {', '.join(f'{x:.4g}' for x in point)} {unit}")
    print(f"  file           {library.path(name)}")
    if out is not None:
        from comove.views import draw_primitive

        save_picture(draw_primitive(primitive, demonstration=recording_of(primitive)), out)
        print(f"  picture        {out}")
    return 0
