"""Who is let in: the host must be ours, the page must be ours, and from elsewhere one must know the token."""

import hmac

import pytest

from comove.view.workbench.gate import COOKIE, Gate, page_headers

OURS, PAGE = ["127.0.0.1:8050"], ["http://127.0.0.1:8050"]


def test_this_machine_needs_no_token():
    gate = Gate.of("127.0.0.1")
    assert gate.token is None
    assert gate.answer("/", OURS, [], "") is None
    assert gate.answer("/", ["localhost:8050"], ["http://localhost:8050"], "") is None
    assert Gate.of("::1").answer("/", ["[::1]:8050"], [], "") is None


@pytest.mark.parametrize(
    "hosts",
    [
        ["evil.example"],
        ["evil.example:8050"],
        ["127.0.0.1.evil.example:8050"],
        ["192.168.0.7:8050"],
        ["user@evil.example"],
        ["[::1"],
        [""],
        [],
        ["127.0.0.1:8050", "evil.example"],
        ["127.0.0.1" + "0" * 5000],
    ],
)
def test_another_name_is_refused(hosts):
    assert Gate.of("127.0.0.1").answer("/", hosts, [], "").status == 403


@pytest.mark.parametrize(
    "origin",
    [
        "http://evil.example",
        "null",
        "https://127.0.0.1:8050",
        "http://127.0.0.1:8051",
        "http://localhost:8050",
        "http://127.0.0.1:8050.evil.example",
        "",
    ],
)
def test_another_site_is_refused(origin):
    assert Gate.of("127.0.0.1").answer("/", OURS, [origin], "").status == 403
    assert Gate.of("127.0.0.1").answer("/", OURS, [*PAGE, origin], "").status == 403


def test_from_elsewhere_one_must_know_the_token():
    gate = Gate.of("0.0.0.0")
    host = ["192.168.0.7:8050"]
    assert gate.answer("/", host, [], "").status == 401
    for wrong in ("", "x", gate.token[:-1], gate.token + "x", "ü"):
        assert gate.answer(f"/?token={wrong}", host, [], "").status == 401
        assert gate.answer("/", host, [], f"{COOKIE}={wrong}").status == 401
    assert gate.answer(f"/?token={gate.token}&token={gate.token}", host, [], "").status == 401
    led_on = gate.answer(f"/?token={gate.token}", host, [], "")
    assert led_on.status == 303
    headers = dict(led_on.headers)
    assert headers["Location"] == "/", "the token leaves the address"
    assert "HttpOnly" in headers["Set-Cookie"]
    cookie = headers["Set-Cookie"].partition(";")[0]
    assert gate.answer("/", host, ["http://192.168.0.7:8050"], f"other=1; {cookie}") is None
    assert gate.answer("/", host, ["http://evil.example"], cookie).status == 403
    assert gate.answer("/", ["evil.example"], [], cookie).status == 403


def test_tokens_are_compared_in_constant_time(monkeypatch):
    """However much of it is right, in the address or in the cookie, the whole is compared by `hmac`."""
    gate, compared = Gate.of("0.0.0.0"), []
    monkeypatch.setattr(hmac, "compare_digest", lambda a, b: compared.append((a, b)) or False)
    for given in ("x", gate.token[:5] + "x" * (len(gate.token) - 5), gate.token):
        assert gate.answer(f"/?token={given}", ["192.168.0.7"], [], f"{COOKIE}={given}").status == 401
        assert compared[-2:] == [(given.encode(), gate.token.encode())] * 2


def test_every_start_has_a_token_of_its_own_that_is_not_printed_by_chance():
    first, second = Gate.of("0.0.0.0"), Gate.of("0.0.0.0")
    assert first.token != second.token
    assert len(first.token) >= 32
    assert first.token not in repr(first)


def test_a_page_talks_to_its_own_server_only():
    policy = dict(page_headers("127.0.0.1:8050"))["Content-Security-Policy"]
    assert "connect-src 'self' ws://127.0.0.1:8050 " in policy
    assert "frame-ancestors 'none'" in policy
