"""The server refuses what other sites and strangers send, and outlives what is malformed."""

import http.client
import socket
import threading

import pytest

viser = pytest.importorskip("viser", reason="the viewer is not installed: pip install 'comove[view]'")

from viser import _messages as kinds  # noqa: E402
from websockets.exceptions import InvalidStatus  # noqa: E402

from comove.errors import OptionError  # noqa: E402
from comove.view.workbench.gate import COOKIE  # noqa: E402
from comove.view.workbench.server import LARGEST_MESSAGE, start  # noqa: E402
from tests.view.workbench.pages import Page  # noqa: E402


@pytest.fixture(scope="module")
def guarded():
    running = start()
    yield running
    running.stop()


@pytest.fixture
def address(guarded):
    return guarded.address.rstrip("/")


def get(server, path="/", **headers):
    """The status of a request, with its text."""
    connection = http.client.HTTPConnection("127.0.0.1", server.get_port(), timeout=20)
    try:
        connection.request("GET", path, headers=headers)
        response = connection.getresponse()
        return response.status, response.read(), dict(response.getheaders())
    finally:
        connection.close()


def lives(address):
    """Whether a page that is opened is served."""
    page = Page(address).appear()
    page.receive(lambda message: message["type"] == "ReplayDoneMessage", 20.0)
    page.close()
    return True


def test_a_page_of_ours_is_served(guarded, address):
    status, body, headers = get(guarded.server)
    assert status == 200
    assert b"<html" in body
    assert "frame-ancestors 'none'" in headers["Content-Security-Policy"]
    assert lives(address)


@pytest.mark.parametrize(
    "headers", [{"Host": "evil.example"}, {"Origin": "http://evil.example"}, {"Origin": "null"}]
)
def test_other_sites_are_refused(guarded, address, headers):
    assert get(guarded.server, **headers)[0] == 403
    options = (
        {"additional_headers": {"Host": headers["Host"]}}
        if "Host" in headers
        else {"origin": headers["Origin"]}
    )
    if "Origin" in headers:
        with pytest.raises(InvalidStatus, match="403"):
            Page(address, **options)
    assert lives(address)


def test_the_upgrade_of_another_site_is_refused_by_its_host_too(guarded):
    """Byte for byte, as a name that was led to this machine would send it."""
    lines = [
        "GET / HTTP/1.1",
        "Host: evil.example",
        "Origin: http://evil.example",
        "Upgrade: websocket",
        "Connection: Upgrade",
        "Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==",
        "Sec-WebSocket-Version: 13",
        f"Sec-WebSocket-Protocol: viser-v{viser.__version__}",
    ]
    with socket.create_connection(("127.0.0.1", guarded.server.get_port()), 20) as raw:
        raw.sendall("\r\n".join([*lines, "", ""]).encode())
        assert b" 403 " in raw.recv(1000).partition(b"\r\n")[0]


def test_the_tunnel_cannot_be_opened(guarded, address, monkeypatch):
    opened = threading.Event()
    monkeypatch.setattr("viser._viser.ViserTunnel", lambda *_, **__: opened.set())
    page = Page(address).appear()
    page.send(kinds.ShareUrlRequest())
    page.send(kinds.ShareUrlDisconnect())
    page.close()
    assert lives(address)
    assert guarded.server.request_share_url() is None
    assert not opened.is_set()
    assert kinds.ShareUrlRequest not in guarded.server._websock_server._incoming_handlers


@pytest.mark.parametrize(
    "message",
    [
        b"",
        b"\x00",
        b"\xff" * 100,
        b"\x81\xa4type\xa7NoSuch!",
        b"\x81\xa4type\xb0GuiUpdateMessage",
        b"[]" * 1000,
    ],
)
def test_a_malformed_message_ends_its_page_only(address, message, capfd, caplog):
    """No traceback of the viewer's is printed or logged."""
    other = Page(address).appear()
    page = Page(address)
    page.send(message)
    assert lives(address)
    other.receive(lambda found: found["type"] == "ReplayDoneMessage", 20.0)
    other.close()
    page.close()
    assert "Traceback" not in capfd.readouterr().err
    assert not [record for record in caplog.records if record.exc_info]


def test_text_in_place_of_bytes_and_a_message_too_large(address):
    for sent in ("text", b"\x00" * (LARGEST_MESSAGE + 1)):
        page = Page(address)
        page.socket.send(sent)
        assert lives(address)


def test_ten_thousand_messages_at_once(address):
    page = Page(address).appear()
    for _ in range(10_000):
        page.send(kinds.GuiUpdateMessage(uuid="none", updates={"value": 1.0}))
    assert lives(address)
    page.close()


def test_only_values_of_controls_can_be_changed(guarded, address):
    number = guarded.server.gui.add_number("n", 1.0)
    page = Page(address).appear()
    page.send(kinds.GuiUpdateMessage(uuid=number._impl.uuid, updates={"value": 7.0}))
    for updates in (
        {"update_cb": [1]},
        {"value": 3.0, "label": "x"},
        {"value": "x"},
        {"value": float("nan")},
        {"value": {"a": 1}},
        {"value": "1" * 20_000},
    ):
        page.send(kinds.GuiUpdateMessage(uuid=number._impl.uuid, updates=updates))
    page.receive(lambda message: message["type"] == "ReplayDoneMessage", 20.0)
    assert lives(address)
    assert number.value == 7.0
    assert number.label == "n"
    assert not number._impl.update_cb
    number.remove()
    page.close()


def test_from_elsewhere_one_needs_the_token():
    running = start("0.0.0.0")
    try:
        token = running.gate.token
        assert f"?token={token}" in running.address
        assert get(running.server)[0] == 401
        assert get(running.server, "/?token=wrong")[0] == 401
        status, _, headers = get(running.server, f"/?token={token}")
        assert (status, headers["Location"]) == (303, "/")
        assert get(running.server, Cookie=headers["Set-Cookie"].partition(";")[0])[0] == 200
        local = f"http://127.0.0.1:{running.server.get_port()}"
        with pytest.raises(InvalidStatus, match="401"):
            Page(local)
        page = Page(local, additional_headers={"Cookie": f"{COOKIE}={token}"}).appear()
        page.receive(lambda message: message["type"] == "ReplayDoneMessage", 20.0)
        page.close()
    finally:
        running.stop()


def test_a_busy_port_is_told():
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        with pytest.raises(OptionError, match=f"port {port}"):
            start(port=port)
    with pytest.raises(OptionError, match="--host"):
        start("203.0.113.7")  # of nobody's machine


def test_without_a_wish_the_next_port_is_taken(guarded):
    second = start()
    try:
        assert second.server.get_port() != guarded.server.get_port()
    finally:
        second.stop()
