"""The address of the page, and its access control.

The address (host, port, token) is bound before the heavy libraries are loaded, so this module imports no other of
mufly. :class:`AccessGuard` is an ASGI layer around everything, web sockets and static files included.

Two attacks are possible on the loopback address. A foreign web page can open a socket to the station; the browser then
sends that page's address as ``Origin``. A foreign name can resolve to 127.0.0.1; the browser then sends this name as
``Host``. The host must therefore be one under which the page is served, and an origin, if given, must equal the host.
On any other address a token is required too. The browser sends the token once, as ``?token=`` or by the form; it
becomes a cookie that scripts cannot read and other sites cannot send, and does not appear in later addresses. No other
site may show the page in a frame, because it could redirect a user's clicks to the page's buttons.
"""

from __future__ import annotations

import hashlib
import hmac
import ipaddress
import os
import secrets
import socket
import sys
import webbrowser
from urllib.parse import parse_qs, urlsplit

from starlette.datastructures import Headers
from starlette.requests import HTTPConnection
from starlette.responses import Response
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from mufly.errors import ArgumentError

DEFAULT_PORT = 8080
MAX_PORTS_TRIED = 40
COOKIE_NAME = "mufly_station"
MAX_FORM_BYTES = 4096
_NO_FRAME_HEADERS = ((b"content-security-policy", b"frame-ancestors 'none'"), (b"x-frame-options", b"DENY"))

_PAGE_STYLE = (
    "<style>body{font:16px system-ui,sans-serif;display:grid;place-items:center;min-height:90vh;margin:0;"
    "background:#11161c;color:#e7ecf1}form,p{max-width:22rem}input,button{font:inherit;padding:.5rem .7rem;"
    "width:100%;box-sizing:border-box;margin-top:.6rem;border-radius:4px;border:1px solid #44505c}</style>"
)
_LOGIN_PAGE = (
    "<!doctype html><html lang=en><meta charset=utf-8><title>mufly station</title>" + _PAGE_STYLE
    + "<form method=post action=/login>"
    "<h1>mufly station</h1><label for=t>Enter the token that the station printed at start.</label>"
    "<input id=t name=token type=password autocomplete=off autofocus><button>Open</button></form>"
)  # fmt: skip
_REDIRECT_PAGE = (
    "<!doctype html><html lang=en><meta charset=utf-8><title>mufly station</title>"
    '<meta http-equiv=refresh content="0;url=/">' + _PAGE_STYLE
    + "<p><a href=/ style='color:inherit'>Open the station</a></p>"
)  # fmt: skip


def make_secret_token() -> str:
    """Return a token that nobody can guess."""
    return secrets.token_urlsafe(18)


def hash_token_for_cookie(token: str) -> str:
    """Return the cookie of a token; the token cannot be recovered from it."""
    return hashlib.sha256(f"mufly station {token}".encode()).hexdigest() if token else ""


def is_loopback(host: str) -> bool:
    """Whether an address or name means this machine only."""
    if host == "localhost":
        return True
    try:
        return ipaddress.ip_address(host.strip("[]")).is_loopback
    except ValueError:
        return False


class PageAddress:
    """The address of the page: a bound socket, its host, port and token."""

    def __init__(self, bound: socket.socket, host: str, token: str) -> None:
        self.socket, self.host, self.token = bound, host, token
        self.port = int(bound.getsockname()[1])

    @property
    def url(self) -> str:
        """Return the URL of the page, with the token if needed."""
        host = "127.0.0.1" if self.host in ("0.0.0.0", "::", "") else self.host
        host = f"[{host}]" if ":" in host else host
        return f"http://{host}:{self.port}/" + (f"?token={self.token}" if self.token else "")


def bind_page_address(host: str = "127.0.0.1", port: int | None = None, token: str | None = None) -> PageAddress:
    """Bind a socket to the port of the page, or to the next free one; return the address.

    Parameters
    ----------
    host : str
        Address to listen on; any but loopback needs a token, which is generated if not given.
    port : int, optional
        Default: 8080, or the next one that is free.
    token : str, optional

    Raises
    ------
    ArgumentError
        If the address does not belong to this machine, or the requested port is in use.
    """
    if token is not None and len(token) < 8:
        remedy = "give a longer token, or omit it to generate one"
        raise ArgumentError("token", "", "is shorter than 8 characters", remedy)
    secret = token or ("" if is_loopback(host) else make_secret_token())
    tried = [port] if port is not None else [*range(DEFAULT_PORT, DEFAULT_PORT + MAX_PORTS_TRIED), 0]
    try:
        family, _, _, _, _ = socket.getaddrinfo(host, None, type=socket.SOCK_STREAM)[0]
    except OSError as error:
        problem = f"is not an address ({error.strerror})"
        raise ArgumentError("host", host, problem, "give an address of this machine") from None
    for number in tried:
        bound = socket.socket(family, socket.SOCK_STREAM)
        bound.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            bound.bind((host, number))
            bound.listen(128)
        except OSError as error:
            bound.close()
            if number == tried[-1]:
                what = "port" if port is not None else "host"
                problem = f"cannot listen on {host}:{number} ({error.strerror})"
                raise ArgumentError(what, "", problem, "give another one or omit it") from None
            continue
        bound.setblocking(False)
        return PageAddress(bound, host, secret)
    raise AssertionError("unreachable: the last port is bound or refused")


def open_in_browser(address: PageAddress) -> None:
    """Open the page in the default browser if there is a display; a text browser would occupy the terminal."""
    screen = any(os.environ.get(name) for name in ("DISPLAY", "WAYLAND_DISPLAY", "BROWSER"))
    if screen or sys.platform in ("darwin", "win32"):
        webbrowser.open(address.url)


class AccessGuard:
    """ASGI layer that refuses requests without access.

    Parameters
    ----------
    app : ASGI application
    host : str
        Address on which the server listens.
    token : str
        Required token; "" for none, on loopback only.
    """

    def __init__(self, app: ASGIApp, *, host: str = "127.0.0.1", token: str = "") -> None:
        self._app, self._token = app, token
        self._cookie = hash_token_for_cookie(token)

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer one request or refuse it."""
        if scope["type"] not in ("http", "websocket"):
            await self._app(scope, receive, send)
            return
        send = _forbid_framing(send)
        asked = HTTPConnection(scope)
        if not self._is_known_host(asked.headers.get("host", "")):
            await _send_refusal(
                scope, receive, send, 403, "host name not allowed; open the address that the station printed"
            )
        elif not self._is_own_origin(asked.headers, scope["type"]):
            await _send_refusal(scope, receive, send, 403, "requests from other sites are refused")
        elif not self._token:
            await self._app(scope, receive, send)
        elif scope["type"] == "http" and await self._handle_login(scope, receive, send):
            pass
        elif hmac.compare_digest(asked.cookies.get(COOKIE_NAME, "").encode(), self._cookie.encode()):
            await self._app(scope, receive, send)
        else:
            await _send_refusal(scope, receive, send, 401, _LOGIN_PAGE if scope["path"] == "/" else "token required")

    def _is_known_host(self, host: str) -> bool:
        # A rebound name has no cookie of ours, so with a token any name will do.
        return bool(self._token) or is_loopback(parse_host_header(host))

    def _is_own_origin(self, headers: Headers, kind: str) -> bool:
        origin = headers.get("origin")
        if origin is None:
            # Browsers always name the origin of a web socket; for plain pages they tell where the click came from.
            return headers.get("sec-fetch-site", "none") in ("none", "same-origin", "same-site") or (
                kind == "http" and headers.get("sec-fetch-mode") == "navigate"
            )
        return urlsplit(origin).netloc == headers.get("host")

    async def _handle_login(self, scope: Scope, receive: Receive, send: Send) -> bool:
        """Answer an attempt to log in; False if this is none."""
        if scope["path"] == "/login" and scope["method"] == "POST":
            form = await _read_body(receive)
        elif scope["path"] == "/" and b"token=" in scope.get("query_string", b""):
            form = scope["query_string"].decode("latin-1")
        else:
            return False
        given = parse_qs(form).get("token", [""])[0]
        if not hmac.compare_digest(given.encode(), self._token.encode()):
            await _send_refusal(scope, receive, send, 401, _LOGIN_PAGE)
            return True
        answer = _make_response(200, _REDIRECT_PAGE)
        answer.headers["set-cookie"] = f"{COOKIE_NAME}={self._cookie}; HttpOnly; SameSite=Strict; Path=/"
        await answer(scope, receive, send)
        return True


def _forbid_framing(send: Send) -> Send:
    """Return ``send`` with headers that forbid browsers to show the page in a frame."""

    async def send_with_headers(message: Message) -> None:
        if message["type"] == "http.response.start":
            message = {**message, "headers": [*message.get("headers", ()), *_NO_FRAME_HEADERS]}
        await send(message)

    return send_with_headers


def parse_host_header(host: str) -> str:
    """Return the name in a Host header, without its port; "" if the header is invalid."""
    try:
        return urlsplit(f"//{host}").hostname or ""
    except ValueError:
        return ""


async def _read_body(receive: Receive) -> str:
    body, more = b"", True
    while more and len(body) <= MAX_FORM_BYTES:
        message = await receive()
        body, more = body + message.get("body", b""), bool(message.get("more_body"))
    return body[:MAX_FORM_BYTES].decode("latin-1")


def _make_response(status: int, text: str) -> Response:
    headers = {"cache-control": "no-store", "referrer-policy": "no-referrer"}
    kind = "text/html" if text.startswith("<") else "text/plain"
    return Response(text, status, headers, kind)


async def _send_refusal(scope: Scope, receive: Receive, send: Send, status: int, text: str) -> None:
    if scope["type"] == "websocket":
        await receive()  # websocket.connect
        if "websocket.http.response" not in scope.get("extensions", {}):
            await send({"type": "websocket.close", "code": 1008})
            return
    await _make_response(status, text)(scope, receive, send)
