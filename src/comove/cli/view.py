"""`comove view`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from comove.cli.app import verb


@verb
def view(
    scene: Annotated[
        Path | None,
        typer.Argument(metavar="[SCENE|DIR]", help="Scene file, or result folder; the examples without."),
    ] = None,
    host: Annotated[
        str,
        typer.Option(help="Address to listen at; others than this machine's need the token that is printed."),
    ] = "127.0.0.1",
    port: Annotated[
        int | None, typer.Option(min=1, max=65535, help="Port; the next free one unless given.")
    ] = None,
    open_page: Annotated[bool, typer.Option("--open", help="Open the page in the browser.")] = False,
) -> int:
    """Show a scene and its motion in the browser, and steer it: drag obstacles, starts and goals."""
    import threading

    from comove.workbench.page import serve
    from comove.workbench.shelf import shelf_of

    guarded = serve(shelf_of(scene, Path.cwd()), host, port)
    print(f"the workbench is at {guarded.address} (Ctrl-C ends it)", flush=True)
    if open_page:
        typer.launch(guarded.address)
    try:
        threading.Event().wait()
    except KeyboardInterrupt:
        return 0
    finally:
        guarded.stop()
    return 0
