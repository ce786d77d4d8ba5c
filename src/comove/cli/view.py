"""`comove view`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from comove.cli import options as o
from comove.cli.app import NOT_VERIFIED, VERIFIED, verb
from comove.cli.texts import say
from comove.errors import OptionError

if TYPE_CHECKING:
    from comove.view.workbench.shelf import Shelf


@verb
def view(
    things: Annotated[
        list[Path] | None,
        typer.Argument(
            metavar="[SCENE|DIR]...",
            help="Scene file, or result folder; a second one stands beside it. Without, the examples to choose from.",
        ),
    ] = None,
    host: Annotated[
        str,
        typer.Option(help="Address to listen at; one that others reach needs the token that is printed."),
    ] = "127.0.0.1",
    port: Annotated[
        int | None, typer.Option(min=1, max=65535, help="Port; the next free one unless given.")
    ] = None,
    open_page: Annotated[bool, typer.Option("--open", help="Open the page in the browser.")] = False,
    html: Annotated[
        Path | None, typer.Option(help="Write one page that needs no server to this file, and end.")
    ] = None,
    seed: o.Seed = 0,
    budget: o.Budget = 30.0,
) -> int:
    """Show a scene and its motion in the browser, and edit it. Obstacles, starts and goals can be dragged."""
    from comove.view.workbench.shelf import shelf_of

    o.check_budget(budget)
    shelf = shelf_of(things or (), Path.cwd())
    if html is not None:
        if not things or len(things) > 2:
            raise OptionError(
                "a page shows one thing, or two side by side",
                key="--html",
                way_out="name a scene or a result folder, or two",
            )
        return _write(shelf, html, seed, budget)
    return _serve(shelf, host, port, open_page)


def _serve(shelf: Shelf, host: str, port: int | None, open_page: bool) -> int:
    """Serve pages until Ctrl-C."""
    import threading

    from comove.view.workbench.server import serve

    guarded = serve(shelf, host, port)
    try:
        print(f"the workbench is at {guarded.address} (Ctrl-C ends it)", flush=True)
        if open_page:
            typer.launch(guarded.address)
        threading.Event().wait()
    except KeyboardInterrupt:
        return VERIFIED
    finally:
        guarded.stop()
    return VERIFIED


def _write(shelf: Shelf, path: Path, seed: int, budget: float) -> int:
    """Write results, or scenes solved now, as one page."""
    from comove.cli.progress import progress_bar
    from comove.io.files import require_target
    from comove.view.workbench.recorded import page_of, played, write_page
    from comove.view.workbench.server import viewer

    viewer()
    require_target(path, OptionError)
    names = [shelf.first] if shelf.beside is None else [shelf.first, shelf.beside]
    with progress_bar(budget) as progress:
        shown = [played(shelf.items[name], seed=seed, budget=budget, progress=progress) for name in names]
    page = page_of(*shown)
    write_page(path, page)
    for playback in shown:
        say(f"{playback.scene.name}: {playback.told}, {path} ({len(page) / 1e6:.1f} MB)")
    return VERIFIED if all(playback.holds for playback in shown) else NOT_VERIFIED
