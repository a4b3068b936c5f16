"""Server and reader of MJPEG over HTTP, as browsers, OpenCV and network cameras use it.

    GET /stream       200, multipart/x-mixed-replace; each part a JPEG with Content-Length and X-Timestamp (s)
    GET /picture.jpg  the latest picture
    GET /             a page that shows the stream

``X-Timestamp``, as mjpg-streamer sends it, is the time of the picture by the sender's clock. A slow client misses
pictures: its queue holds a quarter of a second.

:class:`StreamServer` sends a stream. :func:`iterate_jpeg_parts` reads any such stream, with and without Content-Length.
"""

from __future__ import annotations

import ipaddress
import threading
from collections import deque
from collections.abc import Iterator
from contextlib import suppress
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any, BinaryIO
from urllib.parse import urlsplit

from mufly.errors import ArgumentError, InputError

MJPEG_BOUNDARY = "mufly-picture"
MAX_QUEUED_PICTURES = 8  # pictures in the queue of a slow client
MAX_STREAM_CLIENTS = 16
SOCKET_TIMEOUT_S = 5.0
MAX_PICTURE_BYTES = 32_000_000
"""Largest size of a received picture; longer parts are refused."""
_MAX_LINE_BYTES = 8192
_VIEWER_HTML = (
    "<!doctype html><html lang=en><meta charset=utf-8><title>mufly camera</title>"
    "<style>body{margin:0;background:#11161c;display:grid;place-items:center;min-height:100vh}"
    "img{width:min(100vw,133vh);image-rendering:pixelated}</style><img src=/stream alt='camera'>"
)


def parse_address(text: str, where: str = "--stream") -> tuple[str, int]:
    """Return host and port of ``"8090"``, ``":8090"`` or ``"HOST:8090"``; the default host is this machine only.

    Raises
    ------
    ArgumentError
        If the text is no address.
    """
    host, _, port = text.strip().rpartition(":")
    if not (port.isdecimal() and 0 <= int(port) <= 65535):
        raise ArgumentError(where, text, "is not a port", "write PORT or HOST:PORT, as 8090 or 0.0.0.0:8090")
    return host.strip("[]") or "127.0.0.1", int(port)


def is_local_host(host: str) -> bool:
    """Return whether an address means this machine only."""
    try:
        return host == "localhost" or ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False


class StreamServer:
    """HTTP server that sends pictures to all clients from its own threads.

    Parameters
    ----------
    host, port : str, int
        Address to listen at; port 0 takes any free port.

    Attributes
    ----------
    url : str
        Address of the stream.
    client_count : int
        Number of connected clients.

    Raises
    ------
    ArgumentError
        If the address is not available.
    """

    def __init__(self, host: str = "127.0.0.1", port: int = 0) -> None:
        self._change = threading.Condition()
        self._latest: tuple[bytes, float] | None = None
        self._queues: list[deque[tuple[bytes, float]]] = []
        self._open = True
        server = self

        class BoundPictureHandler(_PictureRequestHandler):
            stream_server = server

        try:
            self._http = _PictureHttpServer((host, port), BoundPictureHandler)
        except OSError as error:
            raise ArgumentError(
                "stream",
                "",
                f"cannot listen on {host}:{port} ({error.strerror or error})",
                "give another port",
            ) from None
        self.is_local_only = is_local_host(host)
        name = f"[{host}]" if ":" in host else "127.0.0.1" if host in ("", "0.0.0.0") else host
        self.url = f"http://{name}:{self._http.server_address[1]}/stream"
        threading.Thread(target=self._http.serve_forever, args=(0.1,), name="camera stream", daemon=True).start()

    @property
    def client_count(self) -> int:
        return len(self._queues)

    def publish_picture(self, jpeg: bytes, time_s: float) -> None:
        """Queue a picture for all clients; never blocks."""
        with self._change:
            self._latest = jpeg, time_s
            for queue in self._queues:
                queue.append(self._latest)
            self._change.notify_all()

    def close(self) -> None:
        """Send the queued pictures and stop the server."""
        with self._change:
            self._open = False
            self._change.notify_all()
        self._http.shutdown()
        self._http.server_close()

    def __enter__(self) -> StreamServer:
        return self

    def __exit__(self, *exc: object) -> None:
        self.close()

    # Methods for the request handlers

    def latest_jpeg(self) -> bytes | None:
        with self._change:
            return None if self._latest is None else self._latest[0]

    def iterate_pictures(self) -> Iterator[tuple[bytes, float]]:
        """Yield the latest picture at once and then every new one; yield nothing if there are too many clients."""
        queue: deque[tuple[bytes, float]] = deque(maxlen=MAX_QUEUED_PICTURES)
        with self._change:
            if len(self._queues) >= MAX_STREAM_CLIENTS:
                return
            self._queues.append(queue)
            if self._latest is not None:
                queue.append(self._latest)
        try:
            while True:
                with self._change:
                    while not queue:
                        if not self._open:
                            return
                        self._change.wait(1.0)
                    one = queue.popleft()
                yield one
        finally:
            with self._change:
                self._queues = [q for q in self._queues if q is not queue]


class _PictureHttpServer(ThreadingHTTPServer):
    daemon_threads = True
    block_on_close = False

    def handle_error(self, request: Any, client_address: Any) -> None:
        """Ignore clients that disconnect."""


class _PictureRequestHandler(BaseHTTPRequestHandler):
    stream_server: StreamServer
    protocol_version = "HTTP/1.0"
    timeout = SOCKET_TIMEOUT_S

    def log_message(self, *_: object) -> None:
        """Log nothing."""

    def do_GET(self) -> None:
        path = urlsplit(self.path).path
        if not self._is_request_allowed():
            self._send_content(403, "text/plain", b"this camera answers its own pages only")
        elif path == "/":
            self._send_content(200, "text/html", _VIEWER_HTML.encode())
        elif path == "/picture.jpg" and (jpeg := self.stream_server.latest_jpeg()) is not None:
            self._send_content(200, "image/jpeg", jpeg)
        elif path == "/stream":
            self._send_stream()
        else:
            self._send_content(404, "text/plain", b"there are /stream and /picture.jpg")

    def _is_request_allowed(self) -> bool:
        """Return whether to serve the request; requests embedded in other web pages and DNS rebinding are refused."""
        headers = self.headers
        try:
            name = urlsplit(f"//{headers.get('Host', '')}").hostname or ""
        except ValueError:
            return False
        known = not self.stream_server.is_local_only or is_local_host(name)
        foreign = headers.get("Sec-Fetch-Site", "none") == "cross-site"
        return known and (not foreign or headers.get("Sec-Fetch-Mode") == "navigate")

    def _send_content(self, status: int, kind: str, content: bytes) -> None:
        self.send_response(status)
        self.send_header("Content-Type", kind)
        self.send_header("Content-Length", str(len(content)))
        self.send_header("Cache-Control", "no-store")
        self.end_headers()
        self.wfile.write(content)

    def _send_stream(self) -> None:
        self.send_response(200)
        self.send_header("Content-Type", f"multipart/x-mixed-replace; boundary={MJPEG_BOUNDARY}")
        self.send_header("Cache-Control", "no-store")
        self.end_headers()
        with suppress(OSError):
            self.wfile.write(f"--{MJPEG_BOUNDARY}\r\n".encode())
            for jpeg, time_s in self.stream_server.iterate_pictures():
                head = f"Content-Type: image/jpeg\r\nContent-Length: {len(jpeg)}\r\nX-Timestamp: {time_s:.6f}\r\n\r\n"
                self.wfile.write(head.encode() + jpeg + f"\r\n--{MJPEG_BOUNDARY}\r\n".encode())


def parse_boundary(content_type: str, where: str) -> bytes:
    """Return the separator between the parts of a stream, from its Content-Type.

    Raises
    ------
    InputError
        If the content is no stream of pictures.
    """
    kind, _, rest = content_type.partition(";")
    words = dict(part.strip().partition("=")[::2] for part in rest.split(";"))
    boundary = words.get("boundary", "").strip('"')
    if not kind.strip().lower().startswith("multipart/") or not boundary:
        raise InputError(
            where, "", f"sends {kind.strip() or 'nothing named'}, which is not a stream of JPEGs",
            "give the address of the stream itself (multipart/x-mixed-replace)",
        )  # fmt: skip
    # Some servers include the two hyphens in the boundary.
    return b"--" + boundary.removeprefix("--").encode()


def iterate_jpeg_parts(stream: BinaryIO, boundary: bytes) -> Iterator[tuple[bytes, float | None]]:
    """Yield JPEG and ``X-Timestamp`` (s; None without a stamp) of each part until the stream ends.

    Raises
    ------
    ValueError
        If a part is too long to be a picture.
    """
    begun = False
    while True:
        if not begun:
            line = stream.readline(_MAX_LINE_BYTES)
            if not line or line.strip() == boundary + b"--":
                return
            if line.strip() != boundary:
                continue  # between two parts, or the rest of a broken one
        begun = False
        headers: dict[str, str] = {}
        while (line := stream.readline(_MAX_LINE_BYTES)).strip():
            name, _, value = line.decode("latin-1").partition(":")
            headers[name.strip().lower()] = value.strip()
        if not line:
            return
        length = headers.get("content-length", "")
        if length.isdecimal() and int(length) <= MAX_PICTURE_BYTES:
            data = stream.read(int(length))
            if len(data) < int(length):
                return
        else:
            data, begun = _read_unsized_part(stream, boundary)
            if not data:
                return
        try:
            when = float(headers["x-timestamp"])
        except (KeyError, ValueError):
            when = None
        yield data, when


def _read_unsized_part(stream: BinaryIO, boundary: bytes) -> tuple[bytes, bool]:
    """Read a part without a length up to its JPEG's end mark; return it, and whether the next boundary was also read.

    The part is b"" if it is cut off.
    """
    data = bytearray()
    while True:
        line = stream.readline(_MAX_LINE_BYTES)
        data += line
        if len(data) > MAX_PICTURE_BYTES:
            raise ValueError("a part is too long to be a picture")
        # The end mark may be split over two lines; after it comes a line end, or directly the boundary.
        end = data.rfind(b"\xff\xd9", max(0, len(data) - len(line) - 2))
        rest = bytes(data[end + 2 :].strip()) if end >= 0 else None
        if rest in (b"", boundary, boundary + b"--"):
            return bytes(data[: end + 2]), rest != b""
        if not line:
            return b"", False  # cut off
