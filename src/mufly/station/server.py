"""The station at work: ports, links, vehicles and the recorder, in one asyncio loop.

Everything that thinks is pure and elsewhere (:mod:`mufly.station.ground`); here bytes are carried between sockets and
those machines. The loop sleeps until a port has something to say, and wakes by itself fifty times a second to see to
what is due.
"""

from __future__ import annotations

import asyncio
import contextlib
import logging
import os
import time
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from itertools import count
from pathlib import Path

from mufly.link.endpoint import Endpoint, parse_endpoint
from mufly.link.ports import Port, open_port
from mufly.station.ground import GroundLink
from mufly.station.recorder import StationRecorder
from mufly.station.remote import RemoteVehicle

__all__ = ["Station", "rate_for"]

STEP_S = 0.02
REACT_S = 0.004
"""After bytes have come, what is due goes out at once, but no more often than this (s)."""
CARE_S = 0.5
_SYSTEMS, _COMPONENTS = (
    range(246, 255),
    range(25, 100),
)  # below 255, which others use; MAV_COMP_ID_USER1 to USER75
_FULL_RATE_BYTES_S = 45_000.0
_SHARE_OF_LINE = 0.6
_FAULTS = 100
_LOG = logging.getLogger(__name__)


def rate_for(endpoint: Endpoint, rate_Hz: float = 100.0) -> float:
    """Return how often vehicles behind an endpoint are asked to tell their motion (Hz).

    All streams at 100 Hz are about 45 kB/s; over a serial line (10 bits a byte) no more is asked than 60 % of what it
    carries.
    """
    if endpoint.kind != "serial":
        return rate_Hz
    share = _SHARE_OF_LINE * endpoint.port / 10.0 / _FULL_RATE_BYTES_S
    return max(1.0, min(rate_Hz, 100.0 * share))


def _address_of(process: int) -> tuple[int, int]:
    """System and component number of the station in a process."""
    turns, k = divmod(process, len(_SYSTEMS))
    return _SYSTEMS[k], _COMPONENTS[turns % len(_COMPONENTS)]


class Station:
    """A ground station without a face.

    Parameters
    ----------
    endpoints : sequence of str or Endpoint
        Where vehicles are: ``"udp:127.0.0.1:14550"`` listens there.
    folder : str or Path
        Where recordings go.
    record : bool
        Whether to begin a recording at once.
    record_here : bool
        The first recording goes into ``folder`` itself instead of a dated folder in it.
    us : (system, component), optional
        Our MAVLink address. Default: a system number from 246 to 254 and one of the 75 component numbers for users, by
        process, so that two stations on one vehicle are told apart.
    rate_Hz : float
        How often vehicles are asked to tell their motion.
    on_vehicle : callable, optional
        Told of every new vehicle.

    Attributes
    ----------
    recorder : StationRecorder
    notices : deque of (time, str)
        What happened to ports and recorder: clock of the day (s), text.

    Raises
    ------
    InputError
        If an endpoint is none.
    """

    def __init__(
        self,
        endpoints: Sequence[str | Endpoint],
        *,
        folder: str | Path = "flights",
        record: bool = True,
        record_here: bool = False,
        us: tuple[int, int] | None = None,
        rate_Hz: float = 100.0,
        on_vehicle: Callable[[RemoteVehicle], None] | None = None,
    ) -> None:
        self.endpoints = [
            parse_endpoint(e, "station", "--connect") if isinstance(e, str) else e for e in endpoints
        ]
        self.us = us or _address_of(os.getpid())
        self.notices: deque[tuple[float, str]] = deque(maxlen=200)
        self.recorder = StationRecorder(folder, first_here=record_here, on_end=self._notice)
        self._record, self._rate_Hz, self._on_vehicle = record, rate_Hz, on_vehicle
        self._colors = count()
        self._links: list[tuple[Port, GroundLink]] = []
        self._watched: list[int] = []
        self._task: asyncio.Task[None] | None = None
        self._stepped_s = self._cared_s = float("-inf")
        self._found: list[RemoteVehicle] = []
        self._faults: set[str] = set()

    @property
    def vehicles(self) -> list[RemoteVehicle]:
        """All vehicles heard so far, in the order in which they were found."""
        return list(self._found)

    @property
    def ports(self) -> list[Port]:
        """The open ports."""
        return [port for port, _ in self._links]

    async def start(self) -> None:
        """Open the ports and begin to listen.

        Raises
        ------
        InputError
            If a port cannot be opened, or the recording not be written. Nothing stays open then.
        """
        try:
            for endpoint in self.endpoints:
                self._links.append((open_port(endpoint, "--connect"), self._link(endpoint)))
            if self._record:
                self.recorder.start()
        except Exception:
            await self.stop()
            raise
        loop = asyncio.get_running_loop()
        for port, link in self._links:
            number = port.fileno()
            if number >= 0:
                loop.add_reader(number, self._readable, port, link)
                self._watched.append(number)
        self._task = loop.create_task(self._work())

    async def stop(self) -> None:
        """Finish the recording and close the ports."""
        if self._task is not None:
            self._task.cancel()
            with contextlib.suppress(asyncio.CancelledError):
                await self._task
            self._task = None
        loop = asyncio.get_running_loop()
        for number in self._watched:
            loop.remove_reader(number)
        self._watched.clear()
        for port, _ in self._links:
            port.close()
        self._links.clear()
        self.recorder.stop()

    def mark(self, text: str) -> bool:
        """Put a mark into the recording; returns whether there is one."""
        return self.recorder.mark(text)

    def _link(self, endpoint: Endpoint) -> GroundLink:
        return GroundLink(
            self.us,
            rate_Hz=rate_for(endpoint, self._rate_Hz),
            color=lambda: next(self._colors),
            on_vehicle=self._new_vehicle,
            on_packet=self.recorder.packet,
            on_fault=self._notice,
        )

    def _new_vehicle(self, vehicle: RemoteVehicle) -> None:
        self._found.append(vehicle)
        self.recorder.attach(vehicle)
        if self._on_vehicle is not None:
            self._on_vehicle(vehicle)

    def _notice(self, text: str) -> None:
        self.notices.append((time.time(), text))

    def _readable(self, port: Port, link: GroundLink) -> None:
        now_s = time.monotonic()
        with self._going_on():
            self._take(now_s, port, link)
            if now_s - self._stepped_s >= REACT_S:
                self._step(now_s)

    @contextlib.contextmanager
    def _going_on(self) -> Iterator[None]:
        """Tell of a fault once and go on: none must end the station in the middle of a flight."""
        try:
            yield
        except Exception as error:
            text = f"the station met a fault and goes on ({type(error).__name__}: {error})"
            if text not in self._faults and len(self._faults) < _FAULTS:
                self._faults.add(text)
                _LOG.error(text, exc_info=error)
                self._notice(text)

    def _take(self, now_s: float, port: Port, link: GroundLink) -> None:
        for peer, data in port.receive():
            link.receive(now_s, peer, data)

    def _step(self, now_s: float) -> None:
        self._stepped_s = now_s
        for port, link in self._links:
            for peer, data in link.step(now_s, port.peers):
                port.send(peer, data)  # type: ignore[arg-type]  # the peers are the port's own

    def _care(self, now_s: float) -> None:
        self._cared_s = now_s
        self.recorder.step(now_s)
        for port, _ in self._links:
            for text in port.notices():
                self._notice(text)
        for vehicle in self._found:
            vehicle.surroundings.recording = self.recorder.recording
            vehicle.surroundings.free_bytes = self.recorder.free_bytes

    async def _work(self) -> None:
        """See to what is due, drift-free; after a stall there is no burst."""
        loop = asyncio.get_running_loop()
        due = loop.time()
        while True:
            now_s = time.monotonic()
            with self._going_on():
                for port, link in self._links:
                    self._take(now_s, port, link)  # ports without a descriptor, and calls to be made again
                self._step(now_s)
                if now_s - self._cared_s >= CARE_S:
                    self._care(now_s)
            due = max(due + STEP_S, loop.time())
            await asyncio.sleep(due - loop.time())
