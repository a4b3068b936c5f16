"""Live views: rows of a recording, sent to other programs during the flight.

The flight appends a copy of a row to a queue of limited length and never waits. A thread of the view removes the rows
and publishes them. If a viewer is slow, the oldest rows are dropped. If a viewer fails, the view ends with an event and
the flight continues. Requests of a viewer wait until the loop of the flight calls
:meth:`LiveViewThread.serve_requests`.
"""

from __future__ import annotations

import contextlib
import threading
from collections import deque
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
from numpy.typing import NDArray

from mufly.logs.mcap import FlightEvent

if TYPE_CHECKING:
    from mufly.flight.record.recorder import FlightRecorder
    from mufly.flight.simulated_flight import Flight

_Rows = NDArray[np.float64]
MAX_QUEUED_ROWS = 1000
"""Largest number of rows that wait for a viewer."""
PUBLISH_PERIOD_S = 0.04
"""Time between two batches of a view (s)."""
ANSWER_TIMEOUT_S = 1.0
"""Time that a viewer's request waits for its answer (s)."""


class Publisher(Protocol):
    """Connection to viewers; only the thread of the live view calls its methods."""

    def publish_rows_and_events(self, rows: _Rows, states: Sequence[str], events: Sequence[FlightEvent]) -> None:
        """Publish new rows (n, columns), n >= 0, with the states of the mission, and new events."""

    def close(self) -> None:
        """Close the connection."""


class FlightWithRecorder(Protocol):
    """Interface of a flight with a recorder: a :class:`~mufly.flight.Flight`, or a simulated vehicle of another
    autopilot.
    """

    recorder: FlightRecorder

    def log_event(self, text: str, level: str = "info") -> None:
        """Append an event to the recording."""


class LiveViewConfig(Protocol):
    """Description of a live view, which can be sent to the process of the vehicle."""

    def open_view(self, flight: Flight) -> LiveViewThread:
        """Open the live view of a flight, and return the thread that publishes its rows."""


class LiveViewThread:
    """Thread that publishes the rows of a flight.

    Parameters
    ----------
    flight : FlightWithRecorder
    publisher : Publisher
    rate_Hz : float
        Highest rate of rows, by the clock of the flight.
    name : str
        For the event of a failure.
    """

    def __init__(self, flight: FlightWithRecorder, publisher: Publisher, *, rate_Hz: float, name: str) -> None:
        self._flight, self._publisher, self._name = flight, publisher, name
        # With a small tolerance, so that rounding of the times drops no row.
        self._least_s, self._last_s = (1.0 - 1e-6) / rate_Hz, -np.inf
        self._rows: deque[tuple[_Rows, str]] = deque(maxlen=MAX_QUEUED_ROWS)
        self._events: deque[FlightEvent] = deque(maxlen=MAX_QUEUED_ROWS)
        self._requests: deque[tuple[Callable[[Any], Any], list[Any], threading.Event]] = deque(maxlen=MAX_QUEUED_ROWS)
        self._ended = threading.Event()
        self._failure = ""
        self._thread = threading.Thread(target=self._run_publisher, name=f"mufly {name}", daemon=True)
        flight.recorder.views.append(self)
        self._thread.start()

    def receive_row(self, row: _Rows, state: str) -> None:
        """Queue the row of one instant; called by the recorder."""
        if row[0] - self._last_s >= self._least_s:
            self._last_s = float(row[0])
            self._rows.append((row.copy(), state))

    def receive_event(self, event: FlightEvent) -> None:
        """Queue an event; called by the recorder."""
        self._events.append(event)

    def request_flight_action(self, act: Callable[[Flight], Any], *, wait: bool = False) -> Any:
        """Request an action from the flight's loop; with ``wait`` return its answer, or None after a second.

        Called from the thread of the view.
        """
        answer, done = list[Any](), threading.Event()
        self._requests.append((act, answer, done))
        if wait:
            done.wait(ANSWER_TIMEOUT_S)
        return answer[0] if answer else None

    def serve_requests(self) -> None:
        """Carry out the viewers' requests; called by the loop of the flight between two periods."""
        if self._failure:
            failure, self._failure = self._failure, ""
            self._flight.log_event(f"{self._name} has ended: {failure}", "warning")
        while self._requests:
            act, answer, done = self._requests.popleft()
            answer.append(act(self._flight))
            done.set()

    def close(self) -> None:
        """Publish what is queued, and close the connection; wait for at most two seconds."""
        with contextlib.suppress(ValueError):
            self._flight.recorder.views.remove(self)
        self._ended.set()
        self._thread.join(2.0)

    def _run_publisher(self) -> None:
        try:
            while not self._ended.wait(PUBLISH_PERIOD_S):
                self._publish_queue()
            self._publish_queue()
        except Exception as error:  # any fault of a viewer's library ends the view and not the flight
            self._failure = f"{type(error).__name__}: {error}"
            with contextlib.suppress(ValueError):
                self._flight.recorder.views.remove(self)
        finally:
            with contextlib.suppress(Exception):
                self._publisher.close()

    def _publish_queue(self) -> None:
        rows = [self._rows.popleft() for _ in range(len(self._rows))]
        events = [self._events.popleft() for _ in range(len(self._events))]
        block = np.array([row for row, _ in rows]) if rows else np.empty((0, self._flight.recorder.layout.column_count))
        self._publisher.publish_rows_and_events(block, [state for _, state in rows], events)
