"""Who may see the page: this machine, or whoever has the token."""

from __future__ import annotations

import ipaddress
import secrets
from http.cookies import SimpleCookie
from typing import Any
from urllib.parse import parse_qs

_COOKIE = "eyespot"


_ASK = """<!doctype html><title>eyespot</title><meta name=viewport content="width=device-width">
<style>body{font:20px sans-serif;display:grid;place-content:center;height:90vh;gap:1em}
input,button{font:inherit;padding:.4em}</style>
<form method=post action=/token><label>Token, as the console printed it:
<input name=token type=password autofocus></label> <button>Open</button></form>"""


_MOST_BYTES = 4096


def is_loopback(host: str) -> bool:
    """Whether an address can be reached from this machine only."""
    if host == "localhost":
        return True
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False


class Gate:
    """ASGI middleware before all pages, pictures and sockets.

    A page of another site that is open in the same browser is refused (by the header Origin), and
    so is a name that only pretends to be this machine (by the header Host).

    Args:
        token: that is asked for; None on loopback.
    """

    def __init__(self, app: Any, *, token: str | None) -> None:
        self._app, self._token = app, token

    async def __call__(self, scope: Any, receive: Any, send: Any) -> None:
        """Let a request through, or answer it."""
        if scope["type"] not in ("http", "websocket"):
            await self._app(scope, receive, send)
            return
        headers = {name.decode(): value.decode("latin-1") for name, value in scope["headers"]}
        host = headers.get("host", "")
        name = host.rpartition(":")[0].strip("[]") or host
        own = headers.get("origin", f"http://{host}").partition("://")[2] == host
        if not own or (self._token is None and not is_loopback(name)):
            await _refuse(scope, send, 403, b"Forbidden")
        elif self._token is None or self._knows(headers):
            await self._app(scope, receive, send)
        elif scope["type"] == "http" and scope["path"] == "/token" and scope["method"] == "POST":
            await self._enter(receive, send)
        else:
            await _refuse(scope, send, 401, _ASK.encode())

    def _knows(self, headers: dict[str, str]) -> bool:
        cookie = SimpleCookie(headers.get("cookie", "")).get(_COOKIE)
        return cookie is not None and secrets.compare_digest(cookie.value, self._token or "")

    async def _enter(self, receive: Any, send: Any) -> None:
        body, more = b"", True
        while more and len(body) < _MOST_BYTES:
            message = await receive()
            body, more = body + message.get("body", b""), message.get("more_body", False)
        given = parse_qs(body.decode("latin-1")).get("token", [""])[0]
        cookie = f"{_COOKIE}={given}; HttpOnly; SameSite=Strict; Path=/"
        right = secrets.compare_digest(given.encode(), (self._token or "").encode())
        kept = [(b"set-cookie", cookie.encode("latin-1"))] if right else []
        await send(
            {
                "type": "http.response.start",
                "status": 303,
                "headers": [(b"location", b"/"), *kept],
            }
        )
        await send({"type": "http.response.body", "body": b""})


async def _refuse(scope: Any, send: Any, status: int, body: bytes) -> None:
    if scope["type"] == "websocket":
        await send({"type": "websocket.close", "code": 1008})
        return
    headers = [(b"content-type", b"text/html; charset=utf-8")]
    await send({"type": "http.response.start", "status": status, "headers": headers})
    await send({"type": "http.response.body", "body": body})
