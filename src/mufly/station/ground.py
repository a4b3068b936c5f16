"""The station's ends of its links, and the station at work around them.

:class:`GroundLink` thinks and is pure: bytes and the clock are passed in, bytes to be sent come out. :class:`Station`
has the ports, links, vehicles and the recorder in one asyncio loop and carries bytes between sockets and links. It
sleeps until a port has something to say, and wakes by itself fifty times a second to see to what is due.
"""

from __future__ import annotations

import asyncio
import contextlib
import logging
import math
import os
import time
from collections import deque
from collections.abc import Callable, Hashable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from itertools import count
from pathlib import Path

from mufly.errors import ArgumentError, InputError
from mufly.link.codec import Codec, Encoder, MavMessage, Outgoing, mavlink
from mufly.link.ports import LATE_S, Endpoint, Port, elapsed_s, open_port, parse_endpoint
from mufly.station.recorder import StationRecorder
from mufly.station.remote import LOST_S, RemoteVehicle
from mufly.vehicle_types import is_vehicle, type_words, vehicle_rank

HEARTBEAT_S = 1.0
MOST_VEHICLES = 32
_WINDOW_S = 1.0
_LOG = logging.getLogger(__name__)


@dataclass(slots=True)
class _Heard:
    """A vehicle, the peer that it is heard from, how surely it is one, and what was counted of it when."""

    vehicle: RemoteVehicle
    peer: Hashable
    heard_s: float
    rank: int
    messages: int = 0
    counted: tuple[float, int, int, int] = (0.0, 0, 0, 0)
    faults: set[str] = field(default_factory=set)


class GroundLink:
    """A station's end of one link: it hears all vehicles there, keeps them apart, and speaks to each.

    A vehicle is a component whose heartbeat :func:`mufly.vehicle_types.is_vehicle` takes for one; a companion computer,
    a camera or an antenna tracker is none, however early and often it speaks. A vehicle is known by its system number
    and the address it is heard from. Where another component of the system called itself a vehicle first, the autopilot
    (component 1) takes over when it is heard. When a vehicle that was lost is heard again under the same number, from
    another address too, it is the same one.

    Parameters
    ----------
    us : (system, component)
        Our MAVLink address.
    rate_Hz : float
        How often vehicles are asked to tell their motion.
    color : callable, optional
        Gives the next vehicle its colour.
    on_vehicle : callable, optional
        Told of every new vehicle.
    on_packet : callable, optional
        Given every packet that came in or goes out, for a log.
    on_fault : callable, optional
        Told in words when the handling of one vehicle failed; the others go on.
    name : str
        What the link is called, to tell its vehicles from those of other links.
    on_notice : callable, optional
        Told in words of a system of which only equipment is heard, no vehicle.
    """

    def __init__(
        self,
        us: tuple[int, int] = (255, 190),
        *,
        rate_Hz: float = 100.0,
        color: Callable[[], int] | None = None,
        on_vehicle: Callable[[RemoteVehicle], None] | None = None,
        on_packet: Callable[[bytes], None] | None = None,
        on_fault: Callable[[str], None] | None = None,
        on_notice: Callable[[str], None] | None = None,
        name: str = "link",
    ) -> None:
        self.us, self.rate_Hz = us, rate_Hz
        self._color = color or (lambda: len(self._heard))
        self._on_vehicle, self._on_packet, self._on_fault = on_vehicle, on_packet, on_fault
        self._on_notice, self.name = on_notice, name
        self.unread_bytes = 0  # since the last message
        self._equipment: dict[tuple[Hashable, int], tuple[float, str]] = {}
        self._codec = Codec()
        self._heard: dict[tuple[Hashable, int], _Heard] = {}
        self._encoders: dict[Hashable, Encoder] = {}
        self._beat_s = self._stepped_s = -math.inf

    @property
    def vehicles(self) -> list[RemoteVehicle]:
        """All vehicles heard so far, in the order in which they were found."""
        return [heard.vehicle for heard in self._heard.values()]

    def receive(self, now_s: float, peer: Hashable, data: bytes) -> None:
        """Take bytes that came from a peer."""
        self.unread_bytes += len(data)
        for message in self._codec.receive(now_s, peer, data):
            self.unread_bytes = 0
            if self._on_packet is not None:
                self._on_packet(bytes(message.get_msgbuf()))
            heard = self._sender(now_s, peer, message)
            if heard is None:
                continue
            if message.get_srcComponent() == heard.vehicle.component:
                heard.heard_s = now_s
                heard.messages += 1
            try:
                heard.vehicle.handle(now_s, message)
            except Exception as error:  # one vehicle's fault must not silence the others
                self._fault(heard, message.get_type(), error)

    def step(self, now_s: float, peers: Iterable[Hashable] = ()) -> list[Outgoing]:
        """Return what is to be sent now.

        Parameters
        ----------
        now_s : float
        peers : iterable
            Whom the port can reach: they get our heartbeat, so that a vehicle that waits to be called answers.
        """
        stood_s, self._stepped_s = now_s - self._stepped_s, now_s
        if LATE_S < stood_s < math.inf:
            for vehicle in self.vehicles:
                vehicle.stand_still(stood_s)
        out = self._heartbeats(now_s, peers)
        self._tell_equipment(now_s)
        for heard in self._heard.values():
            self._count(now_s, heard)
            try:
                messages = heard.vehicle.step(now_s)
            except Exception as error:
                self._fault(heard, "step", error)
                continue
            out += [self._packed(heard.peer, message) for message in messages]
        return out

    def _heartbeats(self, now_s: float, peers: Iterable[Hashable]) -> list[Outgoing]:
        if now_s - self._beat_s < HEARTBEAT_S:
            return []
        self._beat_s = now_s if now_s - self._beat_s > 2 * HEARTBEAT_S else self._beat_s + HEARTBEAT_S
        beat = mavlink.MAVLink_heartbeat_message(
            mavlink.MAV_TYPE_GCS, mavlink.MAV_AUTOPILOT_INVALID, 0, 0, mavlink.MAV_STATE_ACTIVE, 3
        )
        known = dict.fromkeys([*peers, *(heard.peer for heard in self._heard.values())])
        for gone in [peer for peer in self._encoders if peer not in known]:
            del self._encoders[gone]
        return [self._packed(peer, beat) for peer in known]

    def _packed(self, peer: Hashable, message: MavMessage) -> Outgoing:
        encoder = self._encoders.get(peer)
        if encoder is None:
            encoder = self._encoders[peer] = Encoder(*self.us)
        data = encoder(message)
        if self._on_packet is not None:
            self._on_packet(data)
        return Outgoing(peer, data)

    def _sender(self, now_s: float, peer: Hashable, message: MavMessage) -> _Heard | None:
        """The vehicle of the system that sent a message; a new one if the message is a vehicle's heartbeat."""
        system = message.get_srcSystem()
        heard = self._heard.get((peer, system))
        if message.get_type() != "HEARTBEAT" or not system:
            return heard
        component = message.get_srcComponent()
        rank = vehicle_rank(message.type, message.autopilot, component)
        if heard is not None:
            if rank > heard.rank and component != heard.vehicle.component:
                heard.vehicle.change_component(component)
            heard.rank = max(rank, heard.rank)
            return heard
        if not is_vehicle(message.type, message.autopilot, component):
            if message.type != mavlink.MAV_TYPE_GCS and len(self._equipment) < MOST_VEHICLES:
                what = f"{type_words(message.type) or 'equipment'} (component {component})"
                self._equipment.setdefault((peer, system), (now_s, what))
            return None
        for key, lost in list(self._heard.items()):
            same = key[1] == system and lost.vehicle.component == component
            if same and now_s - lost.heard_s >= LOST_S:
                del self._heard[key]
                lost.peer = peer
                lost.vehicle.moved()
                self._heard[peer, system] = lost
                return lost
        if len(self._heard) >= MOST_VEHICLES:
            return None
        vehicle = RemoteVehicle(system, component, us=self.us, color=self._color(), rate_Hz=self.rate_Hz)
        alike = sum(v.system == system for v in self.vehicles)
        vehicle.key = f"{system}@{self.name}" + (f"#{alike + 1}" if alike else "")
        new = self._heard[peer, system] = _Heard(vehicle, peer, now_s, rank)
        if self._on_vehicle is not None:
            self._on_vehicle(vehicle)
        return new

    def _tell_equipment(self, now_s: float) -> None:
        """Tell once of each system that speaks for a while without a vehicle in it."""
        for (peer, system), (since_s, what) in self._equipment.items():
            if since_s + LOST_S < now_s < math.inf and (peer, system) not in self._heard:
                self._equipment[peer, system] = (math.inf, what)
                if self._on_notice is not None:
                    self._on_notice(f"system {system}: only its {what} is heard, no autopilot of a vehicle")

    def _count(self, now_s: float, heard: _Heard) -> None:
        """Tell a vehicle how good its link was over the last second."""
        since_s, received, lost, messages = heard.counted
        if now_s - since_s < _WINDOW_S:
            return
        counts = self._codec.counts(heard.peer)
        new, gone = counts.received - received, counts.lost - lost
        if since_s:
            loss = max(0, gone) / (new + max(0, gone)) if new + gone > 0 else 1.0
            heard.vehicle.note_link(now_s, loss, (heard.messages - messages) / (now_s - since_s))
        heard.counted = (now_s, counts.received, counts.lost, heard.messages)

    def _fault(self, heard: _Heard, where: str, error: Exception) -> None:
        text = f"{heard.vehicle.name}: {where} could not be handled ({type(error).__name__}: {error})"
        if where not in heard.faults:  # once of each kind, or a fault at 100 Hz fills the log
            heard.faults.add(where)
            heard.vehicle.note("error", text)
            _LOG.error(text, exc_info=error)
            if self._on_fault is not None:
                self._on_fault(text)


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


def rate_for(endpoint: Endpoint, rate_Hz: float = 100.0) -> float:
    """Return how often vehicles behind an endpoint are asked to tell their motion (Hz).

    All streams at 100 Hz are about 45 kB/s; over a serial line (10 bits a byte) no more is asked than 60 % of what it
    carries.
    """
    if endpoint.kind != "serial":
        return rate_Hz
    share = _SHARE_OF_LINE * endpoint.port / 10.0 / _FULL_RATE_BYTES_S
    return max(1.0, min(rate_Hz, 100.0 * share))


def _opened(endpoint: Endpoint) -> Port:
    try:
        return open_port(endpoint)
    except InputError as error:
        raise ArgumentError("endpoints", error.key, error.problem, error.remedy) from error


_UNREAD_BYTES = 4000


def _not_understood(port: Port, link: GroundLink) -> str:
    """Say that bytes come and no message is among them; "" otherwise."""
    if link.unread_bytes < _UNREAD_BYTES:
        return ""
    words = f"{port.endpoint}: {link.unread_bytes} bytes came, and no MAVLink message among them"
    return words + (f"; is {port.endpoint.port} its baud rate?" if port.endpoint.kind == "serial" else "")


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
    name : str
        What the links are called, where their endpoints are others at each start.

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
        name: str = "",
    ) -> None:
        self._name = name
        self.endpoints = [parse_endpoint(e, "station") if isinstance(e, str) else e for e in endpoints]
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
                self._links.append((_opened(endpoint), self._link(endpoint)))
            if self._record:
                self.recorder.start()
        except Exception:
            await self.stop()
            raise
        loop = asyncio.get_running_loop()
        for port, link in self._links:
            self._take(elapsed_s(), port, link)  # calls, so that what is missing is known at once
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

    def trouble(self) -> list[str]:
        """Say what is wrong with the links now, a line each."""
        return [words for port, link in self._links if (words := port.problem or _not_understood(port, link))]

    def _link(self, endpoint: Endpoint) -> GroundLink:
        return GroundLink(
            self.us,
            rate_Hz=rate_for(endpoint, self._rate_Hz),
            color=lambda: next(self._colors),
            on_vehicle=self._new_vehicle,
            on_packet=self.recorder.packet,
            on_fault=self._notice,
            on_notice=self._notice,
            name=self._name or str(endpoint),
        )

    def _new_vehicle(self, vehicle: RemoteVehicle) -> None:
        self._found.append(vehicle)
        self.recorder.attach(vehicle)
        if self._on_vehicle is not None:
            self._on_vehicle(vehicle)

    def _notice(self, text: str) -> None:
        self.notices.append((time.time(), text))

    def _readable(self, port: Port, link: GroundLink) -> None:
        now_s = elapsed_s()
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
            now_s = elapsed_s()
            with self._going_on():
                for port, link in self._links:
                    self._take(now_s, port, link)  # ports without a descriptor, and calls to be made again
                self._step(now_s)
                if now_s - self._cared_s >= CARE_S:
                    self._care(now_s)
            due = max(due + STEP_S, loop.time())
            await asyncio.sleep(due - loop.time())
