"""MJPEG over HTTP: what browsers, OpenCV and other people's cameras say and hear."""

from __future__ import annotations

import io
import threading
import urllib.error
import urllib.request
from collections.abc import Iterator
from http.client import HTTPResponse

import numpy as np
import pytest

from mufly.camera import (
    StreamServer,
    decode_grey_picture,
    encode_jpeg,
    iterate_jpeg_parts,
    parse_address,
    parse_boundary,
)
from mufly.errors import InputError

RNG = np.random.default_rng(3)
PICTURES = [encode_jpeg(RNG.integers(0, 255, (48, 64), dtype=np.uint8), 80) for _ in range(6)]


@pytest.fixture
def server() -> Iterator[StreamServer]:
    with StreamServer() as one:
        yield one


def opened(url: str, **headers: str) -> HTTPResponse:
    answer = urllib.request.urlopen(urllib.request.Request(url, headers=headers), timeout=5)
    assert isinstance(answer, HTTPResponse)
    return answer


def test_what_is_published_is_received_with_its_time(server: StreamServer) -> None:
    server.publish_picture(PICTURES[0], 1.25)
    with opened(server.url) as answer:
        boundary = parse_boundary(answer.headers["Content-Type"], server.url)
        got = iterate_jpeg_parts(answer, boundary)
        assert next(got) == (PICTURES[0], 1.25)
        for k in range(1, 6):
            server.publish_picture(PICTURES[k], 1.25 + k)
            assert next(got) == (PICTURES[k], 1.25 + k)
        assert server.client_count == 1
        server.publish_picture(PICTURES[0], 9.0)
        server.close()
        assert [t for _, t in got] == [9.0]  # what waits is sent before it ends
    with pytest.raises(urllib.error.URLError):
        opened(server.url)


def test_opencv_reads_it(server: StreamServer) -> None:
    cv2 = pytest.importorskip("cv2")
    stop = threading.Event()

    def send() -> None:
        k = 0
        while not stop.wait(0.01):
            server.publish_picture(PICTURES[k % 6], 0.01 * k)
            k += 1

    thread = threading.Thread(target=send)
    thread.start()
    try:
        video = cv2.VideoCapture(server.url)
        there, picture = video.read()
        video.release()
    finally:
        stop.set()
        thread.join()
    assert there
    grey = cv2.cvtColor(picture, cv2.COLOR_BGR2GRAY).astype(float)
    assert min(np.abs(grey - decode_grey_picture(p)).mean() for p in PICTURES) < 3.0


def test_pages_pictures_and_strangers(server: StreamServer) -> None:
    base = server.url.removesuffix("/stream")
    with pytest.raises(urllib.error.HTTPError, match="404"):
        opened(f"{base}/picture.jpg")
    server.publish_picture(PICTURES[2], 0.0)
    with opened(f"{base}/picture.jpg") as answer:
        assert answer.read() == PICTURES[2]
    with opened(f"{base}/") as answer:
        assert b"<img src=/stream" in answer.read()
    for headers in (
        {"Host": "rebound.example"},
        {"Sec-Fetch-Site": "cross-site", "Sec-Fetch-Mode": "no-cors"},
    ):
        with pytest.raises(urllib.error.HTTPError, match="403"):
            opened(f"{base}/picture.jpg", **headers)
    with pytest.raises(InputError, match="cannot listen on"):
        StreamServer("127.0.0.1", int(base.rpartition(":")[2]))


def test_streams_of_other_servers() -> None:
    """With and without lengths, boundaries with hyphens of their own, nothing between picture and boundary."""
    head = b"Content-Type: image/jpeg\r\n\r\n"
    for text in (
        b"".join(b"--b\r\nContent-length: %d\r\n\r\n" % len(p) + p + b"\r\n" for p in PICTURES),
        b"".join(b"--b\n" + head.replace(b"\r", b"") + p + b"\n" for p in PICTURES),
        b"--b\r\n" + b"--b\r\n".join(head + p for p in PICTURES) + b"--b--",
        b"".join(b"\r\n--b\r\n" + head + p for p in PICTURES),
    ):  # fmt: skip
        assert [p for p, _ in iterate_jpeg_parts(io.BytesIO(text), b"--b")] == PICTURES
        cut = [p for p, _ in iterate_jpeg_parts(io.BytesIO(text[: len(text) // 2]), b"--b")]
        assert cut[:2] == PICTURES[:2]
        assert len(cut) < 5
    assert parse_boundary('multipart/x-mixed-replace; boundary="--b"', "") == b"--b"
    assert parse_boundary("multipart/x-mixed-replace;boundary=b", "") == b"--b"
    with pytest.raises(InputError, match="sends text/html, which is not a stream"):
        parse_boundary("text/html; charset=utf-8", "http://x")


def test_addresses() -> None:
    assert parse_address("8090") == ("127.0.0.1", 8090)
    assert parse_address("0.0.0.0:80") == ("0.0.0.0", 80)
    assert parse_address("[::1]:80") == ("::1", 80)
    for text in ("x", "1.2.3.4:", ":99999", "a:-1"):
        with pytest.raises(InputError, match="is not a port"):
            parse_address(text)
