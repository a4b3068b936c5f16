"""The web server of the page: NiceGUI in a guarded ASGI application, with the stream of frames.

:func:`serve_page` runs until stopped. Closing windows or this server does not affect the vehicle.
"""

from __future__ import annotations

import asyncio
import contextlib
import logging
import time
from collections.abc import Awaitable, Callable, Iterator
from typing import Any

import uvicorn
from fastapi import FastAPI, WebSocket, WebSocketDisconnect
from fastapi.staticfiles import StaticFiles
from nicegui import context, ui
from starlette.responses import Response

from mufly.link.ports import read_boot_clock
from mufly.station.page.frame_feed import FrameFeed
from mufly.station.page.late_requests import FrameTimes, LateUploadFilter, drop_late_events
from mufly.station.page.page_address import AccessGuard, PageAddress, open_in_browser
from mufly.station.page.page_layout import build_page
from mufly.station.page.page_session import StationSession
from mufly.station.page.panels import STATIC_FOLDER, static_url

FRAME_RATE_HZ = 20.0
RECONNECT_TIMEOUT_S = 600.0
"""Time for which an unreachable window is kept, so that it returns without a reload (s)."""


def build_application(session: StationSession, *, host: str = "127.0.0.1", token: str = "") -> Any:
    """Return the whole page as one guarded ASGI application."""
    app = FastAPI(docs_url=None, redoc_url=None, openapi_url=None)
    app.mount(static_url(), StaticFiles(directory=STATIC_FOLDER), name="mufly")

    @app.websocket("/live/{client_id}")
    async def serve_frames(socket: WebSocket, client_id: str) -> None:
        view = session.view_by_client.get(client_id)
        if view is None:
            await socket.close(1008)
            return
        await socket.accept()
        stream = view.open_stream()
        try:
            await _stream_frames(socket, FrameFeed(view), lambda: view.newest_stream == stream)
        finally:
            view.close_stream()

    @app.get("/starting")
    def report_started() -> Response:
        """Answer a start page (:mod:`mufly.station.page.start_page`), which polls this address: the page is ready."""
        return Response("started", 404, media_type="text/plain")

    @ui.page("/", title=session.title, reconnect_timeout=RECONNECT_TIMEOUT_S)
    def show_page(vehicle: str = "") -> None:
        client = context.client
        view = session.open_view(client.id, vehicle)
        client.on_delete(lambda: session.close_view(client.id))
        drop_late_events(client, view.frames, view.refuse_late_request)
        build_page(view)

    ui.run_with(
        app,
        title=session.title,
        favicon=STATIC_FOLDER / "favicon.svg",
        dark=None,
        tailwind=False,
        reconnect_timeout=5.0,
        message_history_length=1000,
        binding_refresh_interval=None,
        show_welcome_message=False,
        cache_control_directives="public, max-age=31536000, immutable",
        gzip_middleware_factory=None,
    )

    def find_frame_times(client_id: str) -> FrameTimes | None:
        view = session.view_by_client.get(client_id)
        return None if view is None else view.frames

    return AccessGuard(LateUploadFilter(app, find_frame_times), host=host, token=token)


async def _stream_frames(web: WebSocket, feed: FrameFeed, is_newest: Callable[[], bool]) -> None:
    """Send frames at the page's rate, as long as the window draws them and has no newer stream."""

    async def read_messages() -> None:
        while True:
            message = await web.receive()
            if message["type"] == "websocket.disconnect":
                return
            feed.handle_message(message.get("text") or message.get("bytes") or "")

    listener = asyncio.create_task(read_messages())
    due = read_boot_clock()
    try:
        while not listener.done() and is_newest():
            now = read_boot_clock()
            if feed.is_ready:
                await web.send_text(feed.make_frame(now).decode())
            due = max(due + 1.0 / FRAME_RATE_HZ, now)
            await asyncio.sleep(due - now)
    except (WebSocketDisconnect, RuntimeError, OSError):
        pass  # the window is gone
    finally:
        listener.cancel()
        with contextlib.suppress(asyncio.CancelledError, WebSocketDisconnect, RuntimeError):
            await listener


async def _advance_replays(session: StationSession) -> None:
    """Advance the recordings that are played."""
    last = time.monotonic()
    while True:
        await asyncio.sleep(0.5 / FRAME_RATE_HZ)
        now = time.monotonic()
        for view in list(session.view_by_client.values()):
            if view.replay is not None:
                view.replay.advance_playback(now - last)
        last = now


class _PageServer(uvicorn.Server):
    """A server without signal handlers: the caller of :func:`serve_page` handles signals and closes in order."""

    @contextlib.contextmanager
    def capture_signals(self) -> Iterator[None]:
        """Capture none."""
        yield


async def serve_page(
    session: StationSession,
    address: PageAddress,
    *,
    open_browser: bool = True,
    beside: Callable[[], Awaitable[None]] | None = None,
    stop: Callable[[], bool] = lambda: False,
) -> bool:
    """Serve the page until ``beside`` returns, or it is told to stop.

    Parameters
    ----------
    session : StationSession
    address : PageAddress
        From :func:`mufly.station.page.page_address.bind_page_address`.
    open_browser : bool
        Whether to open the page in the default browser.
    beside : coroutine function, optional
        Runs in the same loop; when it returns, the server stops.
    stop : callable, optional
        Asked ten times a second; signals are the caller's.

    Returns
    -------
    bool
        Whether it was told to stop.
    """
    logging.getLogger("nicegui").setLevel(logging.WARNING)
    guarded = build_application(session, host=address.host, token=address.token)
    config = uvicorn.Config(
        guarded, log_level="warning", access_log=False, ws_per_message_deflate=False, lifespan="on",
        timeout_graceful_shutdown=1,
    )  # fmt: skip
    server = _PageServer(config)
    replays = asyncio.create_task(_advance_replays(session))
    serving = asyncio.create_task(server.serve(sockets=[address.socket]))
    tasks: set[asyncio.Future[Any]] = {serving}
    if beside is not None:
        tasks.add(asyncio.ensure_future(beside()))

    async def wait_for_stop() -> None:
        while not stop():
            await asyncio.sleep(0.1)

    tasks.add(asyncio.ensure_future(wait_for_stop()))
    try:
        while not (server.started or serving.done() or stop()):
            await asyncio.sleep(0.02)
        if open_browser and not (serving.done() or stop()):
            await asyncio.to_thread(open_in_browser, address)
        done, _ = await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
        for task in done:
            task.result()
        return stop()
    finally:
        server.should_exit = True
        replays.cancel()
        for task in tasks - {serving}:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)
