"""`comove library add`."""

from __future__ import annotations

from typing import Annotated

import typer

from comove.cli import recordings as r
from comove.cli.app import verb_of
from comove.cli.library.app import FOLDER, Folder, library_app
from comove.errors import LibraryError, OptionError


@verb_of(library_app)
def add(
    demos: Annotated[
        list[str],
        typer.Argument(
            metavar="DEMO...", help="Recordings (files, lasa:SHAPE, lasa:SHAPE:DEMO) or primitives (JSON)."
        ),
    ],
    folder: Folder = FOLDER,
    name: Annotated[
        str | None, typer.Option(help="Name in the library, of one movement; the file's unless given.")
    ] = None,
    replace: Annotated[bool, typer.Option("--replace", help="Replace primitives of the same name.")] = False,
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
    """Learn movements from recordings, or take primitives, and keep them in the library."""
    from comove.primitives import Library, learn, read_primitive
    from comove.primitives.files import renamed

    library, primitives = Library(folder), []
    library.require_room()
    options = r.learning_options(n_basis, variant, phase, period, poses)
    reading = r.reading_options(unit, columns, delimiter, time, rate, clean)
    for demo in demos:
        if demo.endswith(".json"):
            primitive = read_primitive(demo)
            primitives.append(renamed(primitive, name or primitive.name))
            continue
        for recording, source, its_name in r.read_recordings(demo, manipulator, episode, topic, reading):
            if unit is None:
                r.require_metres(recording, demo)
            primitives.append(learn(recording, name=name or its_name, source=source, **options))
    names = [primitive.name for primitive in primitives]
    if name is not None and len(names) > 1:
        raise OptionError(
            f"{len(names)} movements cannot all be called {name!r}", key="--name", way_out="leave it out"
        )
    twice = next((one for one in names if names.count(one) > 1), None)
    if twice is not None:
        raise LibraryError(f"two movements are called {twice!r}", file=folder, way_out="add them one by one")
    for one in names:  # before anything is written
        if one in library and not replace:
            raise LibraryError(
                f"there is a primitive {one!r} already",
                file=folder,
                way_out="add --replace, or choose a --name",
            )
    for primitive in primitives:
        library.add(primitive, replace=replace)
        print(r.learned_text(primitive))
    count = len(library)
    print(f"{folder} holds {count} primitive{'' if count == 1 else 's'}")
    return 0
