"""Server of the workbench: the viewer's server with authentication and restrictions.

The viewer's server has neither authentication nor a check of origins, lets any client open a public tunnel, and
takes any property of a control from a client. All of that is closed here; `tests/view/workbench/test_server.py`
tries each.
"""

from __future__ import annotations

import math
import socket
import sys
from collections.abc import Awaitable, Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from importlib import import_module
from typing import Any

from rich import get_console

from comove.errors import ExtraError, OptionError
from comove.io.files import installed
from comove.view.workbench.gate import Gate, page_headers
from comove.view.workbench.session import PageSettings, Session
from comove.view.workbench.shelf import Shelf
from comove.view.workbench.words import plain_text

LARGEST_MESSAGE = 2**20  # bytes, of one message from a page
LONGEST_TEXT = 10_000  # characters, of what is typed into a control


@dataclass(frozen=True, eq=False)
class Guarded:
    """Running server.

    Attributes
    ----------
    server : the viewer's server
    address : address to open in a browser, with the token where one is needed
    gate : authentication
    """

    server: Any
    address: str
    gate: Gate

    def stop(self) -> None:
        """Stop the server."""
        self.server.stop()


def viewer() -> Any:
    """Return the viewer's package."""
    viser = installed("viser", "the workbench in the browser", "view")
    get_console().quiet = True  # the viewer would print its own address, without the token
    return viser


def start(host: str = "127.0.0.1", port: int | None = None) -> Guarded:
    """Start a server with authentication.

    Parameters
    ----------
    host
        Address to listen at; others than those of this machine need the token.
    port
        Port to listen at; the first free one from 8050 on unless given.

    Raises
    ------
    ExtraError
        If the viewer is not installed.
    OptionError
        If the port is taken, or one cannot listen there.
    """
    viser, gate = viewer(), Gate.of(host)
    port = _free_port(host, port)
    with _behind(gate) as came_by:
        server = viser.ViserServer(host=host, port=port, label="comove", verbose=False)
    if not came_by:  # the viewer no longer starts its server in the way that is guarded
        server.stop()
        raise ExtraError(f"the viewer {viser.__version__} cannot be guarded; the workbench", "view")
    _close_doors(server)
    shown = f"[{host}]" if ":" in host else host
    shown = socket.gethostname() if host in ("0.0.0.0", "::") else shown
    query = "" if gate.token is None else f"?token={gate.token}"
    return Guarded(server, f"http://{shown}:{server.get_port()}/{query}", gate)


def serve(
    shelf: Shelf,
    host: str = "127.0.0.1",
    port: int | None = None,
    settings: PageSettings | None = None,
) -> Guarded:
    """Start the workbench, whose pages are sessions of their own. Each page shows the first scene of the shelf at
    first.

    Parameters
    ----------
    shelf, host, port
        Scenes to choose from; address and port as in `start`.
    settings
        Number of pages, and search times of each; the usual ones unless given.
    """
    guarded, settings = start(host, port), settings or PageSettings()
    server, sessions = guarded.server, dict[int, Session]()

    @server.on_client_connect
    async def _(client: Any) -> None:
        if len(sessions) >= settings.most_pages:
            client.gui.add_markdown(
                f"**{settings.most_pages} pages are open**, and more are not served. Close one, load this again."
            )
            return
        try:
            sessions[client.client_id] = Session(client, server.get_event_loop(), shelf, settings)
        except Exception as error:  # a page that cannot be shown must say so, and not end the others
            client.gui.add_markdown(f"**The scene cannot be shown.** {plain_text(str(error))}")
            raise

    @server.on_client_disconnect
    async def _(client: Any) -> None:
        if session := sessions.pop(client.client_id, None):
            session.close()

    return guarded


def _free_port(host: str, port: int | None, usual: range = range(8050, 8100)) -> int:
    """Return the requested port, or a free usual one."""
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    for candidate in [port] if port is not None else usual:
        try:
            with socket.socket(family, socket.SOCK_STREAM) as trial:
                trial.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
                trial.bind((host, candidate))
                trial.listen(1)  # two sockets may be bound to one port, but only one listens
                return int(trial.getsockname()[1])
        except OSError as failure:
            refused = failure
        except OverflowError:
            raise OptionError(
                f"there is no port {candidate}", key="--port", way_out="give one from 1024 to 65535"
            ) from None
    if port is not None:
        raise OptionError(
            f"one cannot listen at {host}, port {port}: {refused.strerror or refused}",
            key="--port",
            way_out="leave --port out for the next free one",
        )
    raise OptionError(
        f"one cannot listen at {host}: {refused.strerror or refused}",
        key="--host",
        way_out="leave --host out to listen on this machine only",
    )


@contextmanager
def _behind(gate: Gate) -> Iterator[list[int]]:
    """Add a gate to servers started in this context; yield their ports."""
    websockets: Any = import_module("websockets.asyncio.server")
    from websockets.datastructures import Headers
    from websockets.http11 import Response

    plain, ports = websockets.serve, []

    def serve(handler: Any, host: str, port: int, **options: Any) -> Any:
        inner = options["process_request"]

        def process(connection: Any, request: Any) -> Any:
            headers = request.headers
            hosts, origins = headers.get_all("Host"), headers.get_all("Origin")
            answer = gate.answer(request.path, hosts, origins, "; ".join(headers.get_all("Cookie")))
            if answer is not None:
                body = answer.text.encode()
                own = Headers([*answer.headers, ("Content-Length", str(len(body)))])
                own["Content-Type"] = "text/plain; charset=utf-8"
                return Response(answer.status, answer.reason, own, body)
            response = inner(connection, request)
            if response is not None:
                for name, value in page_headers(hosts[0]):
                    response.headers[name] = value
            return response

        async def handled(connection: Any) -> None:
            """Close a page that sends unreadable messages, without the viewer's report."""
            try:
                await handler(connection)
            except Exception as error:
                print(
                    f"a page sent what cannot be read, and was closed ({type(error).__name__})",
                    file=sys.stderr,
                )
                await connection.close(1003, "unreadable")

        ports.append(port)
        return plain(
            handled, host, port, **options | {"process_request": process, "max_size": LARGEST_MESSAGE}
        )

    websockets.serve = serve
    try:
        yield ports
    finally:
        websockets.serve = plain


def _close_doors(server: Any) -> None:
    """Disable unused requests of clients. These are the public tunnel, uploads, shared forms, and other
    properties."""
    from viser import _messages as kinds

    handler = server._websock_server
    for kind in (kinds.ShareUrlRequest, kinds.ShareUrlDisconnect):
        handler.unregister_handler(kind)
    _harden(handler, server.gui)

    def refused(*_: object, **__: object) -> None:
        return None

    server.request_share_url = refused

    @server.on_client_connect
    async def _(client: Any) -> None:
        _harden(client._websock_connection, client.gui)


def _harden(connection: Any, gui: Any) -> None:
    """Restrict a page's updates to finite or short values of controls."""
    from viser import _messages as kinds

    others = (kinds.FileTransferStartUpload, kinds.FileTransferPart, kinds.GuiFormSubmitMessage)
    for kind in (*others, kinds.GuiFormDirtyMessage, kinds.GuiUpdateMessage):
        with suppress(AssertionError, KeyError):
            connection.unregister_handler(kind)
    pass_on: Callable[[int, Any], Awaitable[None]] = gui._handle_gui_updates

    async def updated(client_id: int, message: Any) -> None:
        if set(message.updates) == {"value"} and _is_plain(message.updates["value"]):
            with suppress(TypeError, ValueError, AssertionError):  # of another type than the control's
                await pass_on(client_id, message)

    connection.register_handler(kinds.GuiUpdateMessage, updated)


def _is_plain(value: Any) -> bool:
    """Return whether a value is possible for a page's control."""
    if isinstance(value, str):
        return len(value) <= LONGEST_TEXT
    if isinstance(value, (list, tuple)):
        return len(value) <= 4 and all(_is_plain(part) for part in value)
    if isinstance(value, (int, float)):
        return abs(value) < 1e12 and not math.isnan(value)
    return value is None
