"""Authentication: the check of every request before the page's server.

A page on this machine is reached by any site that the user's browser visits, unless it refuses requests of other
sites. So the requested host must be one of ours, since a foreign name could resolve to this machine; and requests
from a page must come from a page of ours. A server that others can reach requires its token; it is given once in the
address, and kept by the browser in a cookie that no other site can send.
"""

from __future__ import annotations

import hmac
import ipaddress
import secrets
import socket
from collections.abc import Sequence
from dataclasses import dataclass, field
from http.cookies import CookieError, SimpleCookie
from urllib.parse import parse_qs, urlsplit

LOOPBACK = frozenset({"127.0.0.1", "localhost", "::1"})
COOKIE = "comove-token"
LONGEST = 4096  # characters of an address or a header that are looked at


@dataclass(frozen=True)
class Answer:
    """Response instead of the page: status, name, sentence and headers."""

    status: int
    reason: str
    text: str
    headers: tuple[tuple[str, str], ...] = ()


@dataclass(frozen=True)
class Gate:
    """Rules of authentication.

    Attributes
    ----------
    hosts : allowed host names of the page
    any_address : whether numeric addresses are allowed as well, to which no foreign name resolves
    token : required token; None where only this machine can connect
    """

    hosts: frozenset[str] = LOOPBACK
    any_address: bool = False
    token: str | None = field(default=None, repr=False)

    @classmethod
    def of(cls, host: str) -> Gate:
        """Return the gate of a server that listens at `host`. It has no token only where that is this machine
        alone."""
        if host in LOOPBACK:
            return cls()
        names = {host, socket.gethostname(), socket.getfqdn()} | LOOPBACK
        return cls(frozenset(name.lower() for name in names), True, secrets.token_urlsafe(24))

    def answer(self, path: str, hosts: Sequence[str], origins: Sequence[str], cookies: str) -> Answer | None:
        """Return a refusal or redirection; None for an allowed request.

        Parameters
        ----------
        path : path and query of the request
        hosts, origins : values of the headers Host and Origin
        cookies : value of the header Cookie
        """
        if max(map(len, (path, cookies, *hosts, *origins)), default=0) > LONGEST:
            return _refused("The request is too long.")
        if len(hosts) != 1 or not self._is_ours(hosts[0]):
            return _refused("This page is not reached under that name.")
        if any(origin != f"http://{hosts[0]}" for origin in origins):
            return _refused("Another site must not open this page.")
        if self.token is None:
            return None
        given = parse_qs(urlsplit(path).query).get("token", [])
        if len(given) == 1 and self._is_token(given[0]):
            cookie = f"{COOKIE}={self.token}; HttpOnly; SameSite=Lax; Path=/"
            return Answer(303, "See Other", "", (("Location", "/"), ("Set-Cookie", cookie)))
        if not self._is_token(_cookie(cookies)):
            return Answer(401, "Unauthorized", "Open the address that comove printed, with its token.")
        return None

    def _is_ours(self, host: str) -> bool:
        try:
            name = urlsplit(f"//{host}").hostname or ""
        except ValueError:
            return False
        if name.lower() in self.hosts:
            return True
        try:
            return self.any_address and bool(ipaddress.ip_address(name))
        except ValueError:
            return False

    def _is_token(self, given: str) -> bool:
        return self.token is not None and hmac.compare_digest(given.encode(), self.token.encode())


def page_headers(host: str) -> tuple[tuple[str, str], ...]:
    """Return headers that restrict a page to its server and forbid framing."""
    policy = (
        "default-src 'self' 'unsafe-inline' 'unsafe-eval' data: blob:; "
        f"connect-src 'self' ws://{host} data: blob:; frame-ancestors 'none'; base-uri 'none'; form-action 'none'"
    )
    return (
        ("Content-Security-Policy", policy),
        ("X-Frame-Options", "DENY"),
        ("X-Content-Type-Options", "nosniff"),
        ("Referrer-Policy", "no-referrer"),
    )


def _refused(text: str) -> Answer:
    return Answer(403, "Forbidden", text)


def _cookie(cookies: str) -> str:
    try:
        morsel = SimpleCookie(cookies).get(COOKIE)
    except CookieError:
        return ""
    return "" if morsel is None else morsel.value
