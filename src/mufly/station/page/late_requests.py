"""Rejection of requests that reach the station late.

Every request of a window names the newest frame that the window had. The station knows by its own clock when it made
that frame, so no clock of a browser matters. A request is late if its frame, or the press of its button, is older than
:data:`mufly.link.ports.MAX_REQUEST_AGE_S`. Late requests wait in sockets while the station's process is stopped, its
machine suspended or the network cut; none of them is carried out. The window greys itself at the same age
(``static/live.js``).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

from nicegui import Client
from nicegui.element import Element
from starlette.datastructures import Headers
from starlette.types import ASGIApp, Receive, Scope, Send

from mufly.link.ports import MAX_REQUEST_AGE_S, read_boot_clock
from mufly.station.signal_history import OperatorRequest, RequestOutcome

FRAME_NUMBER_HEADER = "x-mufly-frame"
"""HTTP header of an uploaded file: the newest frame that the window had."""
_MAX_REMEMBERED_FRAMES = 128  # frames: more than are made in LATE_S
_NOTICE_PERIOD_S = 1.0
_DISPLAY_STATE_EVENTS = ("change", "place", "hello", "failed", "rejected")


class FrameTimes:
    """Creation times of the frames of one window.

    Parameters
    ----------
    clock : callable
        Monotonic (s); it runs while the machine is suspended.
    """

    def __init__(self, clock: Callable[[], float] = read_boot_clock) -> None:
        self._clock = clock
        self._made: dict[int, float] = {}
        self._newest = 0

    def register_frame(self) -> int:
        """Return the number of a new frame, unique over all streams."""
        self._newest += 1
        self._made[self._newest] = self._clock()
        self._made.pop(self._newest - _MAX_REMEMBERED_FRAMES, None)
        return self._newest

    @property
    def newest_frame_number(self) -> int:
        """Return the number of the newest frame; 0 before the first."""
        return self._newest

    def request_lateness_s(self, frame: object, held_ms: object = 0.0, seen_ms: object = 0.0) -> float:
        """Return the lateness of a request (s): age of the frame that the user saw, or time since the press if longer.

        Parameters
        ----------
        frame : int
            Number of the newest frame that the window had; an unknown number makes the request infinitely late.
        held_ms, seen_ms : float
            Times by the window's clock until the request was sent (ms): since the press, and since the arrival of the
            frame.
        """
        made_s = self._made.get(frame) if isinstance(frame, int) else None
        waits = [max(0.0, 1e-3 * v) for v in (held_ms, seen_ms) if isinstance(v, int | float) and math.isfinite(v)]
        if made_s is None or len(waits) < 2:
            return math.inf
        held_s, seen_s = waits
        age_s = self._clock() - made_s
        return max(age_s, age_s - min(seen_s, age_s) + held_s)


def describe_lateness(late_s: float) -> str:
    """Return a message with the lateness of a rejected request."""
    by = f"{late_s:.1f} s late" if math.isfinite(late_s) else "too late"
    return f"dropped: reached the station {by}; repeat it if still needed"


def drop_late_events(
    client: Client,
    frames: FrameTimes,
    tell: Callable[[OperatorRequest], None],
    clock: Callable[[], float] = read_boot_clock,
) -> None:
    """Pass a window's events to their handlers unless they are late.

    Parameters
    ----------
    client : nicegui.Client
    frames : FrameTimes
    tell : callable
        Called with a refused request for each dropped event, at most once a second for each element.
    clock : callable
        Monotonic (s).
    """
    handle, told = client.handle_event, dict[int, float]()

    def handle_in_time(msg: dict[str, Any]) -> None:
        sender = client.elements.get(msg.get("id", -1))
        late_s = frames.request_lateness_s(msg.get("frame"), msg.get("held_ms", 0.0), msg.get("seen_ms", 0.0))
        if late_s <= MAX_REQUEST_AGE_S or _is_display_event(sender, msg.get("listener_id")):
            handle(msg)
            return
        if sender is None or clock() - told.get(sender.id, -math.inf) < _NOTICE_PERIOD_S:
            return
        told[sender.id] = clock()
        with client:
            sender.update()  # the browser shows again what the station has
            tell(OperatorRequest(_element_label(sender), RequestOutcome.REFUSED, describe_lateness(late_s)))

    # NiceGUI calls this method of the client for every event and has no hook before it.
    client.handle_event = handle_in_time  # type: ignore[method-assign]


def _is_display_event(sender: Element | None, listener: object) -> bool:
    """Return whether an event changes only the window's own display: a field, a tab, or the rejection of a file."""
    # NiceGUI keeps the listeners of an element here alone.
    known = sender._event_listeners.get(listener) if sender and isinstance(listener, str) else None
    return known is not None and (known.type in _DISPLAY_STATE_EVENTS or known.type.startswith("update:"))


def _element_label(element: Element) -> str:
    """Return the visible label of an element."""
    texts = (part._text for part in (element, *element.descendants()))
    named = (element.props.get(key) for key in ("aria-label", "label", "module"))
    return next((str(word) for word in (*texts, *named) if word), element.tag).lower()


class LateUploadFilter:
    """An ASGI layer that refuses files whose upload began too late (status 408).

    Parameters
    ----------
    app : ASGI application
    frames : callable
        Returns the frames of a window by the number of its client; None for an unknown client.
    """

    def __init__(self, app: ASGIApp, frames: Callable[[str], FrameTimes | None]) -> None:
        self._app, self._frames = app, frames

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass a request on, or refuse it."""
        parts = scope.get("path", "").split("/")
        if scope["type"] == "http" and scope["method"] not in ("GET", "HEAD") and "upload" in parts:
            known = next((f for part in parts if (f := self._frames(part)) is not None), None)
            number = Headers(scope=scope).get(FRAME_NUMBER_HEADER, "")
            frame = int(number) if number.isascii() and number.isdigit() else None
            if known is None or known.request_lateness_s(frame) > MAX_REQUEST_AGE_S:
                await send({"type": "http.response.start", "status": 408, "headers": [(b"connection", b"close")]})
                await send({"type": "http.response.body", "body": b"too late"})
                return
        await self._app(scope, receive, send)
