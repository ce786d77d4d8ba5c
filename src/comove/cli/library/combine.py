"""`comove library combine`."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated

import typer

from comove.cli.app import INTERRUPTED, NOT_VERIFIED, VERIFIED, verb_of
from comove.cli.library.app import FOLDER, Folder, library_app
from comove.cli.progress import progress_bar
from comove.cli.recordings import check_picture, check_target, file_name, save_picture


@verb_of(library_app)
def combine(
    scene: Annotated[Path, typer.Argument(metavar="SCENE", help="Scene file (YAML).")],
    out: Annotated[Path, typer.Option(help="File for the primitive (JSON).")],
    names: Annotated[
        list[str] | None, typer.Argument(metavar="NAME...", help="Of the primitives; all unless given.")
    ] = None,
    folder: Folder = FOLDER,
    seed: Annotated[int, typer.Option(min=0, help="Seed of all random numbers.")] = 0,
    budget: Annotated[float, typer.Option(help="Seconds after which the best so far is taken.")] = 30.0,
    picture: Annotated[Path | None, typer.Option(help="Picture of the motion (PNG, PDF or SVG).")] = None,
) -> int:
    """Combine primitives into one that gets through SCENE, and save it."""
    from comove._version import __version__
    from comove.planning import combine
    from comove.primitives import Library, Primitive, write_primitive
    from comove.scenes import Scene

    check_target(out)
    check_picture(picture)
    library, loaded = Library(folder), Scene.load(scene)
    primitives = [library.get(name) for name in names] if names else library
    with progress_bar(budget) as progress:
        found = combine(primitives, loaded, seed=seed, budget=budget, progress=progress)
    verdict = "verified" if found.verified else "NOT VERIFIED"
    parts = [
        f"{', '.join(f'{c:+.3f}' for c in row)} of {name}"
        for name, row in zip(found.names, found.coefficients, strict=True)
    ]
    notes = (f"combined for the scene {loaded.name}, seed {seed}, by comove {__version__}: {verdict}", *parts)
    name = file_name(out.name.removesuffix(".json").removesuffix(".dmp"))
    write_primitive(out, Primitive(name, found.dmp, notes=notes))
    print(f"{name}: {verdict} in {loaded.name}, cost J {found.cost:.4g}, {found.evaluations} rollouts")
    for part in parts:
        print(f"  {part}")
    for reason in found.reasons:
        print(f"  - {reason}", file=sys.stderr)
    print(f"  saved as {out}")
    if picture is not None:
        from comove.views import draw_motion

        title = loaded.name if found.verified else f"{loaded.name} (not verified)"
        save_picture(draw_motion(found.attempt, title=title), picture)
        print(f"  picture {picture}")
    if found.interrupted:
        return INTERRUPTED
    return VERIFIED if found.verified else NOT_VERIFIED
