"""The page's server as a process of its own: what it answers to whom. Without a browser."""

import http.client
import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
from free_ports import free_port

TOKEN = "a-token-for-tests"


def served(port: int) -> bool:
    """Whether the station's page is served; before it, there is one that tells how far the start is."""
    try:
        return status(port, f"/starting?token={TOKEN}") != 200
    except OSError:
        return False


@pytest.fixture(scope="module", params=["open", "with token"])
def station(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[int, bool]]:
    """A running `mufly station` on the loopback address; its port, and whether it wants a token."""
    folder, port = tmp_path_factory.mktemp("server"), free_port(socket.SOCK_STREAM)
    closed = request.param == "with token"
    link = f"udpin:127.0.0.1:{free_port()}"
    words = [
        "station",
        "--no-browser",
        "--port",
        str(port),
        "--connect",
        link,
        "--out",
        str(folder / "flights"),
    ]
    words += ["--token", TOKEN] if closed else []
    with (folder / "log.txt").open("w") as log:
        process = subprocess.Popen(
            [sys.executable, "-c", "from mufly.cli import main; main()", *words],
            stdout=log, stderr=subprocess.STDOUT, env=os.environ,
        )  # fmt: skip
    try:
        for _ in range(1800):
            if served(port):
                break
            assert process.poll() is None, (folder / "log.txt").read_text()
            time.sleep(0.1)
        yield port, closed
        process.send_signal(signal.SIGINT)
        assert process.wait(60) == 0
        said = (folder / "log.txt").read_text()
        assert "Traceback" not in said
        assert "Recorded to" in said
        assert list(Path(folder / "flights").glob("*/station.tlog"))
    finally:
        process.kill()


def status(port: int, path: str, **headers: str) -> int:
    connection = http.client.HTTPConnection("127.0.0.1", port, timeout=10)
    connection.request("GET", path, headers={k.replace("_", "-"): v for k, v in headers.items()})
    answer = connection.getresponse()
    answer.read()
    connection.close()
    return answer.status


UPGRADE = {
    "Connection": "Upgrade",
    "Upgrade": "websocket",
    "Sec_WebSocket_Version": "13",
    "Sec_WebSocket_Key": "dGhlIHNhbXBsZSBub25jZQ==",
}
SOCKETS = ("/live/nobody", "/_nicegui_ws/socket.io/?EIO=4&transport=websocket")


def static(port: int, cookie: str) -> str:
    connection = http.client.HTTPConnection("127.0.0.1", port, timeout=10)
    connection.request("GET", "/", headers={"Cookie": cookie})
    text = connection.getresponse().read().decode()
    connection.close()
    return "/mufly/" + text.split("/mufly/")[1].split('"')[0]


def cookie_of(port: int) -> str:
    connection = http.client.HTTPConnection("127.0.0.1", port, timeout=10)
    connection.request("GET", f"/?token={TOKEN}")
    answer = connection.getresponse()
    answer.read()
    return (answer.getheader("set-cookie") or "").split(";")[0]


def test_pages_files_and_sockets_answer_whom_they_should(station: tuple[int, bool]) -> None:
    port, closed = station
    cookie = cookie_of(port) if closed else "none=1"
    style = static(port, cookie)
    assert style.endswith("station.css")
    for path in ("/", style):
        assert status(port, path, Cookie=cookie) == 200
        assert status(port, path) == (401 if closed else 200)
    assert status(port, SOCKETS[1], **UPGRADE, Cookie=cookie, Origin=f"http://127.0.0.1:{port}") == 101
    assert status(port, SOCKETS[0], **UPGRADE, Cookie=cookie) == 403  # let in, but no window of that name
    if closed:
        for path in SOCKETS:
            assert status(port, path, **UPGRADE) == 401
            assert status(port, path, **UPGRADE, Cookie="mufly_station=guess") == 401
        assert status(port, "/?token=wrong") == 401


def test_foreign_pages_and_rebound_names_are_refused(station: tuple[int, bool]) -> None:
    port, closed = station
    cookie = cookie_of(port) if closed else "none=1"
    for path in SOCKETS:
        assert status(port, path, **UPGRADE, Cookie=cookie, Origin="http://evil.example") == 403
    assert status(port, "/", Cookie=cookie, Origin="http://evil.example") == 403
    if not closed:
        assert status(port, "/", Host=f"evil.example:{port}") == 403


def test_nobody_learns_of_interfaces_that_are_not_meant_for_people(station: tuple[int, bool]) -> None:
    port, closed = station
    cookie = cookie_of(port) if closed else "none=1"
    for path in ("/docs", "/openapi.json", "/mufly/../../../pyproject.toml", "/nowhere"):
        assert status(port, path, Cookie=cookie) == 404
