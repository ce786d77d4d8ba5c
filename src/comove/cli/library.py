"""Verbs of `comove library`."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from comove.cli import options as o
from comove.cli import recordings as r
from comove.cli.app import BAD_INPUT, INTERRUPTED, NOT_VERIFIED, VERIFIED, sub_application, verb_of
from comove.cli.texts import say
from comove.errors import LibraryError, OptionError

if TYPE_CHECKING:
    from comove.dmp import Primitive

group = sub_application("library", "A folder of movement primitives: add, list, show, find, combine, remove.")

Folder = Annotated[Path, typer.Option(help="Folder of the library.")]
FOLDER = Path("library")


@verb_of(group)
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
    *,
    learning: r.Learning,
    reading: r.Reading,
) -> int:
    """Add primitives or learned movements to the library."""
    from comove.cli.texts import learned_text
    from comove.dmp import Library, learn, read_primitive
    from comove.dmp.files import renamed
    from comove.dmp.recordings import read_recordings

    library, primitives = Library(folder), []
    library.require_room()
    for demo in demos:
        if demo.endswith(".json"):
            primitive = read_primitive(demo)
            primitives.append(renamed(primitive, name or primitive.name))
            continue
        for recording in read_recordings(demo, **reading.arguments):
            movement = reading.movement(recording.demonstration, demo)
            called, source = name or recording.name, recording.source
            primitives.append(learn(movement, name=called, source=source, **learning.arguments))
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
        print(learned_text(primitive))
    print(_holding(folder, len(library)))
    return VERIFIED


@verb_of(group, "list")
def list_primitives(
    folder: Folder = FOLDER,
    json: Annotated[bool, typer.Option("--json", help="Print JSON and nothing else.")] = False,
    out: Annotated[Path | None, typer.Option(help="Picture of all of them (PNG, PDF or SVG).")] = None,
) -> int:
    """List the primitives of the library. Damaged files are named, other files ignored."""
    from comove.cli.texts import as_table
    from comove.dmp import Library

    o.check_picture(out)
    library = Library(folder)
    primitives, damaged = library.read_all()
    if json:
        print(_as_json(primitives))
    elif not primitives:
        print(f"{folder} holds no primitives; add some: comove library add DEMO")
    else:
        print(as_table(_rows_of(primitives)))
    for error in damaged.values():
        say(f"error: {error}", file=sys.stderr)
    if library.foreign:
        say(f"left alone, no primitives: {', '.join(library.foreign)}", file=sys.stderr)
    if out is not None:
        from comove.view.figures import draw_library, save_picture

        save_picture(draw_library(primitives, title=str(folder)), out)
    return BAD_INPUT if damaged else VERIFIED


def _rows_of(primitives: Sequence[Primitive]) -> list[tuple[str, ...]]:
    rows: list[tuple[str, ...]] = [
        ("name", "kind", "dims", "duration", "variant", "weights", "fit error (rms)", "learned from")
    ]
    for p in primitives:
        dmp, learned = p.positions, p.provenance
        error = "-" if learned is None else f"{learned.error_rms:.3g} {p.unit}"
        source = "-" if learned is None else learned.source or learned.recording
        size = f"{dmp.n_dims}", f"{dmp.duration:.3g} s", str(dmp.variant), f"{dmp.weights.shape[1]}"
        rows.append((p.name, p.kind, *size, error, source))
    return rows


def _as_json(primitives: Sequence[Primitive]) -> str:
    from dataclasses import asdict
    from json import dumps

    entries = [
        {
            "name": p.name,
            "kind": p.kind,
            "unit": p.unit,
            "variant": str(p.positions.variant),
            "n_dims": p.positions.n_dims,
            "n_basis": p.positions.weights.shape[1],
            "duration": p.dmp.duration,
            "start": p.positions.start.tolist(),
            "goal": p.positions.goal.tolist(),
            "provenance": None if p.provenance is None else asdict(p.provenance),
            "notes": p.notes,
        }
        for p in primitives
    ]
    return dumps(entries, indent=2, allow_nan=False)


@verb_of(group)
def show(
    name: Annotated[str, typer.Argument(metavar="NAME", help="Of the primitive.")],
    folder: Folder = FOLDER,
    out: Annotated[Path | None, typer.Option(help="Picture of it (PNG, PDF or SVG).")] = None,
) -> int:
    """Print the data of a primitive, and draw it."""
    from comove.cli.texts import learned_text
    from comove.dmp import Library
    from comove.dmp.recordings import recording_of

    o.check_picture(out)
    library = Library(folder)
    primitive = library.get(name)
    dmp, unit = primitive.positions, primitive.unit
    print(learned_text(primitive))
    ends = ("centre" if dmp.variant == "rhythmic" else "goal"), dmp.goal
    for what, point in (("start", dmp.start), ends):
        print(f"  {what:13s}  {', '.join(f'{x:.4g}' for x in point)} {unit}")
    say(f"  file           {library.path(name)}")
    if out is not None:
        from comove.view.figures import draw_primitive, save_picture

        save_picture(draw_primitive(primitive, demonstration=recording_of(primitive)), out)
        print(f"  picture        {out}")
    return VERIFIED


@verb_of(group)
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
    """Rank the primitives of the library by a query. The query is any of start, goal, duration and shape."""
    from comove.cli.texts import as_table
    from comove.dmp import Library
    from comove.dmp.recordings import read_recording

    library = Library(folder)
    shape = None
    if like is not None:
        is_recording = like not in library.names and (":" in like or "." in like or "/" in like)
        shape = read_recording(like).demonstration if is_recording else library.get(like)
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
        return VERIFIED
    if not matches:
        print(f"{folder} holds no movement of this dimension")
        return VERIFIED
    rows = [["name", "distance", "shape", "start off by", "goal off by", "duration"]]
    for m in matches:
        cells = (m.distance, m.shape, m.start, m.goal)
        shown = ["-" if cell is None else f"{cell:.3g}" for cell in cells]
        rows.append([m.name, *shown, "-" if m.duration is None else f"x {m.duration:.3g}"])
    kept = [column for column in zip(*rows, strict=True) if set(column[1:]) != {"-"}]
    print(as_table(list(zip(*kept, strict=True))))
    return VERIFIED


def _numbers(option: str, text: str | None) -> list[float] | None:
    """Return the coordinates in a comma-separated text; None for None."""
    if text is None:
        return None
    try:
        return [float(part) for part in text.split(",")]
    except ValueError:
        raise OptionError(f"{text!r} are no coordinates", key=option, way_out="write X,Y or X,Y,Z") from None


@verb_of(group)
def combine(
    scene: o.SceneFile,
    out: Annotated[Path, typer.Option(help="File for the primitive (JSON).")],
    names: Annotated[
        list[str] | None, typer.Argument(metavar="NAME...", help="Of the primitives; all unless given.")
    ] = None,
    folder: Folder = FOLDER,
    seed: o.Seed = 0,
    budget: o.Budget = 30.0,
    picture: Annotated[Path | None, typer.Option(help="Picture of the motion (PNG, PDF or SVG).")] = None,
) -> int:
    """Combine primitives into one that solves SCENE, and save it."""
    from comove._version import __version__
    from comove.cli.progress import progress_bar
    from comove.dmp import Library, Primitive, write_primitive
    from comove.lab.evolution import combine
    from comove.model import Scene
    from comove.planning.choice import suitable

    r.check_target(out)
    o.check_picture(picture)
    o.check_budget(budget)
    library = Library(folder)
    primitives = [library.get(name) for name in names] if names else library
    with progress_bar(budget) as progress:
        loaded = Scene.load(scene, check_ends=False)
        suitable(primitives, loaded)
        loaded.require_free_ends()
        found = combine(primitives, loaded, seed=seed, budget=budget, progress=progress)
    verdict = "verified" if found.verified else "NOT VERIFIED"
    parts = [
        f"{', '.join(f'{c:+.3f}' for c in row)} of {name}"
        for name, row in zip(found.names, found.coefficients, strict=True)
    ]
    notes = (f"combined for the scene {loaded.name}, seed {seed}, by comove {__version__}: {verdict}", *parts)
    name = r.name_of_file(out)
    write_primitive(out, Primitive(name, found.dmp, notes=notes))
    say(
        f"{name}: {verdict} in {loaded.name}, cost J {found.cost:.4g}, {found.effort.evaluations} rollouts",
        *(f"  {part}" for part in parts),
    )
    for reason in found.reasons:
        say(f"  - {reason}", file=sys.stderr)
    say(f"  saved as {out}")
    if picture is not None:
        from comove.view.figures import draw_motion, save_picture

        title = loaded.name if found.verified else f"{loaded.name} (not verified)"
        save_picture(draw_motion(found.attempt, title=title), picture)
        print(f"  picture {picture}")
    if found.interrupted:
        return INTERRUPTED
    return VERIFIED if found.verified else NOT_VERIFIED


@verb_of(group)
def remove(
    names: Annotated[list[str], typer.Argument(metavar="NAME...", help="Of the primitives.")],
    folder: Folder = FOLDER,
) -> int:
    """Delete primitives from the library, damaged ones too."""
    from comove.dmp import Library

    library = Library(folder)
    for name in names:
        if name not in library:
            library.get(name)  # which says what there is
    for name in dict.fromkeys(names):
        library.remove(name)
    print(_holding(folder, len(library)))
    return VERIFIED


def _holding(folder: Path, count: int) -> str:
    return f"{folder} holds {count} primitive{'' if count == 1 else 's'}"
