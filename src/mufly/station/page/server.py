"""The web server of the page: NiceGUI inside an application of our own, guarded, with the stream of frames beside it.

:func:`serve` runs until it is told to stop. The vehicle is none of its business: closing windows, or this server, stops
nothing in the air.
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

from mufly.link.ports import elapsed_s
from mufly.station.page.address import Address, Guard, open_in_browser
from mufly.station.page.contact import FrameTimes, LateFiles, drop_late_events
from mufly.station.page.feed import Feed
from mufly.station.page.layout import build
from mufly.station.page.panels import STATIC, static_url
from mufly.station.page.session import Session

RATE_HZ = 20.0
KEPT_S = 600.0
"""For so long a window that is out of reach is kept, so that it comes back without being loaded anew (s)."""


def application(session: Session, *, host: str = "127.0.0.1", token: str = "") -> Any:
    """Return the whole page as one guarded ASGI application."""
    app = FastAPI(docs_url=None, redoc_url=None, openapi_url=None)
    app.mount(static_url(), StaticFiles(directory=STATIC), name="mufly")

    @app.websocket("/live/{client_id}")
    async def live(socket: WebSocket, client_id: str) -> None:
        view = session.views.get(client_id)
        if view is None:
            await socket.close(1008)
            return
        await socket.accept()
        stream = view.connected()
        try:
            await _stream(socket, Feed(view), lambda: view.newest_stream == stream)
        finally:
            view.disconnected()

    @app.get("/starting")
    def started() -> Response:
        """Tell a page that watches the start (:mod:`mufly.station.page.starting`) that this one is served now."""
        return Response("started", 404, media_type="text/plain")

    @ui.page("/", title=session.title, reconnect_timeout=KEPT_S)
    def page(vehicle: str = "") -> None:
        client = context.client
        view = session.open(client.id, vehicle)
        client.on_delete(lambda: session.close(client.id))
        drop_late_events(client, view.frames, view.refuse_late)
        build(view)

    ui.run_with(
        app, title=session.title, favicon=STATIC / "favicon.svg", dark=None, tailwind=False, reconnect_timeout=5.0,
        message_history_length=1000, binding_refresh_interval=None, show_welcome_message=False,
        cache_control_directives="public, max-age=31536000, immutable", gzip_middleware_factory=None,
    )  # fmt: skip

    def frames_of(client_id: str) -> FrameTimes | None:
        view = session.views.get(client_id)
        return None if view is None else view.frames

    return Guard(LateFiles(app, frames_of), host=host, token=token)


async def _stream(web: WebSocket, feed: Feed, is_newest: Callable[[], bool]) -> None:
    """Send frames at the page's rate, as long as the window draws them and has opened no newer stream."""

    async def listen() -> None:
        while True:
            message = await web.receive()
            if message["type"] == "websocket.disconnect":
                return
            feed.hear(message.get("text") or message.get("bytes") or "")

    listener = asyncio.create_task(listen())
    due = elapsed_s()
    try:
        while not listener.done() and is_newest():
            now = elapsed_s()
            if feed.ready:
                await web.send_text(feed.frame(now).decode())
            due = max(due + 1.0 / RATE_HZ, now)
            await asyncio.sleep(due - now)
    except (WebSocketDisconnect, RuntimeError, OSError):
        pass  # the window is gone
    finally:
        listener.cancel()
        with contextlib.suppress(asyncio.CancelledError, WebSocketDisconnect, RuntimeError):
            await listener


async def _replays(session: Session) -> None:
    """Let time pass in the recordings that are played."""
    last = time.monotonic()
    while True:
        await asyncio.sleep(0.5 / RATE_HZ)
        now = time.monotonic()
        for view in list(session.views.values()):
            if view.replay is not None:
                view.replay.advance(now - last)
        last = now


class _Server(uvicorn.Server):
    """Signals are heard by whoever calls :func:`serve`, and closes everything in order."""

    @contextlib.contextmanager
    def capture_signals(self) -> Iterator[None]:
        """Capture none."""
        yield


async def serve(
    session: Session,
    address: Address,
    *,
    open_browser: bool = True,
    beside: Callable[[], Awaitable[None]] | None = None,
    stop: Callable[[], bool] = lambda: False,
) -> bool:
    """Serve the page until ``beside`` returns, or it is told to stop.

    Parameters
    ----------
    session : Session
    address : Address
        From :func:`mufly.station.page.address.choose_address`.
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
    guarded = application(session, host=address.host, token=address.token)
    config = uvicorn.Config(
        guarded, log_level="warning", access_log=False, ws_per_message_deflate=False, lifespan="on",
        timeout_graceful_shutdown=1,
    )  # fmt: skip
    server = _Server(config)
    replays = asyncio.create_task(_replays(session))
    serving = asyncio.create_task(server.serve(sockets=[address.socket]))
    tasks: set[asyncio.Future[Any]] = {serving}
    if beside is not None:
        tasks.add(asyncio.ensure_future(beside()))

    async def told_to_stop() -> None:
        while not stop():
            await asyncio.sleep(0.1)

    tasks.add(asyncio.ensure_future(told_to_stop()))
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
