"""Who is let in: pages, static files and web sockets."""

import asyncio
import socket
from typing import Any

import pytest

from mufly.errors import InputError
from mufly.station.page.page_address import (
    COOKIE_NAME,
    AccessGuard,
    bind_page_address,
    is_loopback,
    make_secret_token,
)

TOKEN = "correct-horse-battery"


async def inner(scope: Any, receive: Any, send: Any) -> None:
    if scope["type"] == "websocket":
        await receive()
        await send({"type": "websocket.accept"})
        return
    await send({"type": "http.response.start", "status": 200, "headers": []})
    await send({"type": "http.response.body", "body": b"secret"})


def call(
    guard: AccessGuard,
    path: str = "/",
    *,
    kind: str = "http",
    method: str = "GET",
    query: str = "",
    body: bytes = b"",
    **headers: str,
) -> tuple[int, str, dict[str, str]]:
    """Ask for something; return status (101: the socket was accepted), body and headers."""
    sent: list[dict[str, Any]] = []
    headers = {"host": "127.0.0.1:8080"} | {k.replace("_", "-"): v for k, v in headers.items()}
    scope = {
        "type": kind, "path": path, "method": method, "query_string": query.encode(), "extensions": {},
        "headers": [(k.encode(), v.encode()) for k, v in headers.items()],
    }  # fmt: skip

    async def receive() -> dict[str, Any]:
        return {"type": "websocket.connect"} if kind == "websocket" else {"type": "http.request", "body": body}

    async def send(message: Any) -> None:
        sent.append(message)

    asyncio.run(guard(scope, receive, send))
    first = sent[0]
    if kind == "websocket":
        return (101 if first["type"] == "websocket.accept" else 403), "", {}
    answered = {k.decode(): v.decode() for k, v in first["headers"]}
    return first["status"], sent[1]["body"].decode(), answered


OPEN = AccessGuard(inner)
CLOSED = AccessGuard(inner, host="0.0.0.0", token=TOKEN)


@pytest.mark.parametrize("kind", ["http", "websocket"])
def test_on_loopback_our_own_page_is_served(kind: str) -> None:
    good = (200, 101)[kind == "websocket"]
    assert call(OPEN, kind=kind)[0] == good
    assert call(OPEN, kind=kind, host="localhost:8080", origin="http://localhost:8080")[0] == good
    assert call(OPEN, kind=kind, host="[::1]:8080")[0] == good


@pytest.mark.parametrize("kind", ["http", "websocket"])
def test_a_rebound_name_and_a_foreign_page_are_refused(kind: str) -> None:
    assert call(OPEN, kind=kind, host="evil.example:8080")[0] == 403
    assert call(OPEN, kind=kind, host="127.0.0.1.evil.example")[0] == 403
    assert call(OPEN, kind=kind, host="")[0] == 403
    assert call(OPEN, kind=kind, origin="http://evil.example")[0] == 403
    assert call(OPEN, kind=kind, origin="http://127.0.0.1:9999")[0] == 403  # another program on this machine
    assert call(OPEN, kind=kind, origin="null")[0] == 403


@pytest.mark.parametrize("path", ["/", "/mufly/x/station.css", "/_nicegui_ws/socket.io", "/live/abc", "/login"])
def test_without_the_token_nothing_is_served(path: str) -> None:
    assert call(CLOSED, path)[0] == 401
    assert call(CLOSED, path, cookie=f"{COOKIE_NAME}=guess")[0] == 401
    assert call(CLOSED, path, cookie=f"{COOKIE_NAME}={TOKEN}")[0] == 401  # the cookie is not the token itself
    assert call(CLOSED, path, kind="websocket")[0] == 403
    assert "secret" not in call(CLOSED, path)[1]


@pytest.mark.parametrize(
    "answer",
    [call(OPEN), call(OPEN, host="evil.example"), call(CLOSED), call(CLOSED, query=f"token={TOKEN}")],
    ids=["page", "refusal", "login", "entry"],
)
def test_no_answer_may_be_framed_by_another_site(answer: tuple[int, str, dict[str, str]]) -> None:
    headers = answer[2]
    assert headers["content-security-policy"] == "frame-ancestors 'none'"
    assert headers["x-frame-options"] == "DENY"


@pytest.mark.parametrize("wrong", ["", "x", TOKEN + "x", TOKEN[:-1], "%00", "ü"])
def test_a_wrong_token_is_no_token(wrong: str) -> None:
    assert call(CLOSED, query=f"token={wrong}")[0] == 401
    assert call(CLOSED, "/login", method="POST", body=f"token={wrong}".encode())[0] == 401


@pytest.mark.parametrize("way", ["query", "form"])
def test_the_token_becomes_a_cookie_that_scripts_cannot_read(way: str) -> None:
    if way == "query":
        status, text, headers = call(CLOSED, query=f"token={TOKEN}", host="192.168.0.7:8080")
    else:
        status, text, headers = call(CLOSED, "/login", method="POST", body=f"token={TOKEN}".encode())
    assert status == 200
    assert TOKEN not in text
    cookie, *rules = headers["set-cookie"].split("; ")
    assert TOKEN not in cookie
    assert {"HttpOnly", "SameSite=Strict"} <= set(rules)
    assert call(CLOSED, cookie=f"other=1; {cookie}", host="192.168.0.7:8080")[0] == 200
    assert call(CLOSED, "/live/x", kind="websocket", cookie=cookie)[0] == 101
    assert call(CLOSED, cookie=cookie, origin="http://evil.example")[0] == 403


def test_a_login_of_endless_length_is_cut() -> None:
    assert call(CLOSED, "/login", method="POST", body=b"token=" + b"a" * 100_000)[0] == 401


def test_loopback_is_known_by_name_and_number() -> None:
    assert all(map(is_loopback, ("localhost", "127.0.0.1", "127.9.9.9", "::1", "[::1]")))
    assert not any(map(is_loopback, ("0.0.0.0", "192.168.0.7", "example.org", "localhost.evil.example", "")))


def test_tokens_are_long_and_differ() -> None:
    assert len({make_secret_token() for _ in range(50)}) == 50
    assert min(len(make_secret_token()) for _ in range(50)) >= 20


def test_a_port_in_use_is_stepped_over_unless_it_was_asked_for() -> None:
    one = bind_page_address()
    two = bind_page_address()
    try:
        assert one.port != two.port
        assert one.url == f"http://127.0.0.1:{one.port}/"
        with pytest.raises(InputError, match=str(one.port)):
            bind_page_address(port=one.port)
    finally:
        one.socket.close()
        two.socket.close()


def test_another_address_gets_a_token_unasked() -> None:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    address = bind_page_address("0.0.0.0", port)
    address.socket.close()
    assert len(address.token) >= 20
    assert address.token in address.url
    for bad in ({"host": "no.such.host.invalid"}, {"token": "short"}):
        with pytest.raises(InputError):
            bind_page_address(**bad)  # type: ignore[arg-type]
