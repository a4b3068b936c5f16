"""Websocket server that shows a running flight in Foxglove, with the topics and schemas of a recording.

The encoder is that of the recording (:class:`mufly.flight.record.recorder.RecordingEncoder`), so a layout of panels
serves the live flight and its file. The server of ``foxglove-sdk`` (MIT) sends from threads of its own and drops the
oldest messages of a slow viewer.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass
from types import ModuleType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mufly.errors import InputError
from mufly.flight.record.live_view import FlightWithRecorder, LiveViewThread
from mufly.flight.record.recorder import FlightRecorder, RecordingEncoder
from mufly.logs.mcap import FlightEvent

DEFAULT_PORT = 8765
"""Port to which Foxglove connects by default."""
_PUBLISH_RATE_HZ = 50.0
_SCENE_PERIOD_S = 2.0  # a viewer that connects later gets the scene within this time


def import_foxglove() -> ModuleType:
    """Import the package foxglove (Foxglove's SDK), and return it.

    Raises
    ------
    InputError
        If it is not installed.
    """
    try:
        import foxglove
    except ImportError as error:
        remedy = "install it: pip install 'mufly[foxglove]'"
        raise InputError("--foxglove", "", "needs foxglove-sdk, which is not installed", remedy) from error
    return foxglove


@dataclass(frozen=True)
class FoxgloveViewConfig:
    """Settings of the live view for Foxglove: address of its WebSocket server.

    Attributes
    ----------
    host : str
    port : int
        0 selects a free one.
    """

    host: str = "127.0.0.1"
    port: int = DEFAULT_PORT

    def open_view(self, flight: FlightWithRecorder) -> LiveViewThread:
        """Start the WebSocket server; return the thread that publishes the flight through it.

        Raises
        ------
        InputError
            If foxglove-sdk is missing or the port is in use.
        """
        publisher = FoxglovePublisher(flight.recorder, self.host, self.port)
        flight.log_event(f"Foxglove can connect to ws://{self.host}:{publisher.port}")
        return LiveViewThread(flight, publisher, rate_Hz=_PUBLISH_RATE_HZ, name="the view of Foxglove")


class FoxglovePublisher:
    """WebSocket server that publishes a running flight to Foxglove.

    Attributes
    ----------
    port : int
        Port of the server.
    """

    def __init__(self, recorder: FlightRecorder, host: str, port: int) -> None:
        self._library = import_foxglove()
        self._context = self._library.Context()
        self._channels: list[Any] = []
        self._encoder = RecordingEncoder(self, recorder.layout, recorder.start_time_ns)
        self._scene = self._encoder.encode_scene(recorder.scene_view)
        self._scene_due_s = 0.0
        try:
            self._server = self._library.start_server(
                name="mufly", host=host, port=port, context=self._context, session_id=str(recorder.start_time_ns)
            )
        except (RuntimeError, OSError) as error:
            raise InputError("--foxglove", str(port), f"cannot be opened ({error})", "give another port") from error
        self.port = int(self._server.port)

    def add_channel(self, topic: str, schema_name: str, schema: bytes) -> int:
        """Add a topic to the server."""
        known = self._library.Schema(name=schema_name, encoding="jsonschema", data=schema)
        channel = self._library.Channel(topic, schema=known, message_encoding="json", context=self._context)
        self._channels.append(channel)
        return len(self._channels) - 1

    def publish_rows_and_events(
        self, rows: NDArray[np.float64], states: Sequence[str], events: Sequence[FlightEvent]
    ) -> None:
        """Send new rows of the recording and new events to the connected viewers."""
        for number, time_ns, content in self._encoder.encode_rows(rows, states, events):
            self._channels[number].log(content, log_time=time_ns)
        if len(rows) and time.monotonic() >= self._scene_due_s:
            self._scene_due_s = time.monotonic() + _SCENE_PERIOD_S
            self._channels[self._scene[0]].log(self._scene[2], log_time=self._encoder.last_time_ns(rows))

    def close(self) -> None:
        """Stop the server."""
        self._server.stop()
