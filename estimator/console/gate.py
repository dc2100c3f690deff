"""Who may see the page: this machine, or whoever has the token."""

import ipaddress
import secrets
from typing import Any
from urllib.parse import parse_qs

from starlette.requests import HTTPConnection, Request
from starlette.responses import HTMLResponse, RedirectResponse
from starlette.websockets import WebSocketClose

_COOKIE, _GIVEN = "eyespot", ("POST", "/token")
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
        answer = self._app
        if scope["type"] in ("http", "websocket"):
            asked = HTTPConnection(scope)
            host = asked.headers.get("host", "")
            name = host.rpartition(":")[0].strip("[]") or host
            own = asked.headers.get("origin", f"http://{host}").partition("://")[2] == host
            if not own or (self._token is None and not is_loopback(name)):
                answer = HTMLResponse("Forbidden", 403)
            elif not self._is(asked.cookies.get(_COOKIE)):
                answer = HTMLResponse(_ASK, 401)
                if scope["type"] == "http" and (scope["method"], scope["path"]) == _GIVEN:
                    answer = await self._entered(Request(scope, receive))
            if answer is not self._app and scope["type"] == "websocket":
                answer = WebSocketClose(1008)
        await answer(scope, receive, send)

    def _is(self, given: str | None) -> bool:
        """Whether what was given is the token; anything is where none is asked for."""
        if self._token is None:
            return True
        return secrets.compare_digest((given or "").encode(), self._token.encode())

    async def _entered(self, request: Request) -> RedirectResponse:
        """To the page, which asks again without the right token."""
        body = b""
        async for part in request.stream():
            body += part
            if len(body) >= _MOST_BYTES:
                break
        given = parse_qs(body.decode("latin-1")).get("token", [""])[0]
        page = RedirectResponse("/", 303)
        if self._is(given):
            page.set_cookie(_COOKIE, given, httponly=True, samesite="strict")
        return page
