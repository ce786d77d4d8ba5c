"""The workbench: a server whose every page is a session of its own."""

from __future__ import annotations

from typing import Any

from comove.workbench.server import Guarded, start
from comove.workbench.session import Session
from comove.workbench.shelf import Shelf
from comove.workbench.words import plain_text

MOST_PAGES = 6  # at once, as each has a planner


def serve(shelf: Shelf, host: str = "127.0.0.1", port: int | None = None) -> Guarded:
    """Start the workbench; every page that is opened shows the first scene of the shelf.

    Parameters
    ----------
    shelf, host, port
        Scenes to choose from; where to listen, as `comove.workbench.server.start`.
    """
    guarded = start(host, port)
    server, sessions = guarded.server, dict[int, Session]()

    @server.on_client_connect
    async def _(client: Any) -> None:
        if len(sessions) >= MOST_PAGES:
            client.gui.add_markdown(
                f"**{MOST_PAGES} pages are open**, and more are not served. Close one, load this again."
            )
            return
        try:
            sessions[client.client_id] = Session(client, server.get_event_loop(), shelf)
        except Exception as error:  # a page that cannot be shown must say so, and not end the others
            client.gui.add_markdown(f"**The scene cannot be shown.** {plain_text(str(error))}")
            raise

    @server.on_client_disconnect
    async def _(client: Any) -> None:
        if session := sessions.pop(client.client_id, None):
            session.close()

    return guarded
