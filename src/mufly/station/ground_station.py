"""The station's ends of its links, and the station process that serves them.

:class:`GroundLink` is free of I/O: bytes and the clock are passed in, bytes to be sent are returned.
:class:`GroundStation` holds the ports, links, vehicles and the recorder in one asyncio loop and moves bytes between
sockets and links. The loop sleeps until a port is readable, and wakes fifty times a second for periodic work.
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
from mufly.link.codec import FrameDecoder, FrameEncoder, MavMessage, OutgoingFrame, mavlink
from mufly.link.ports import MAX_REQUEST_AGE_S, Endpoint, Port, open_port, parse_endpoint, read_boot_clock
from mufly.station.remote.remote_vehicle import LOST_TIMEOUT_S, RemoteVehicle
from mufly.station.station_recorder import StationRecorder
from mufly.vehicle_types import is_vehicle, vehicle_rank, vehicle_type_name

HEARTBEAT_PERIOD_S = 1.0
MAX_VEHICLES = 32
_LINK_QUALITY_WINDOW_S = 1.0
_LOG = logging.getLogger(__name__)


@dataclass(slots=True)
class _HeardVehicle:
    """A vehicle with its peer address, the confidence of its identification and its packet counters."""

    vehicle: RemoteVehicle
    peer: Hashable
    last_heard_s: float
    identification_rank: int
    message_count: int = 0
    last_counts: tuple[float, int, int, int] = (0.0, 0, 0, 0)
    reported_faults: set[str] = field(default_factory=set)


class GroundLink:
    """The station's end of one link, with all vehicles heard there.

    A vehicle is a component whose heartbeat :func:`mufly.vehicle_types.is_vehicle` accepts. Companion computers,
    cameras and antenna trackers are not vehicles. A vehicle is identified by its system number and its peer address. If
    another component of the system called itself a vehicle first, the autopilot (component 1) replaces it when heard. A
    lost vehicle that is heard again under the same number counts as the same vehicle, from any address.

    Parameters
    ----------
    us : (system, component)
        MAVLink address of the station.
    rate_Hz : float
        Requested rate of the vehicles' motion messages (Hz).
    color : callable, optional
        Returns the colour of the next vehicle.
    on_vehicle : callable, optional
        Called with every new vehicle.
    on_packet : callable, optional
        Called with every packet received or sent, for a log.
    on_fault : callable, optional
        Called with a text when handling one vehicle failed; other vehicles are not affected.
    name : str
        Name of the link, which distinguishes its vehicles from those of other links.
    on_notice : callable, optional
        Called with a text about a system that has equipment but no vehicle.
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
        self.own_ids, self.rate_Hz = us, rate_Hz
        self._color = color or (lambda: len(self._heard))
        self._on_vehicle, self._on_packet, self._on_fault = on_vehicle, on_packet, on_fault
        self._on_notice, self.name = on_notice, name
        self.unread_bytes = 0  # since the last message
        self._equipment: dict[tuple[Hashable, int], tuple[float, str]] = {}
        self._codec = FrameDecoder()
        self._heard: dict[tuple[Hashable, int], _HeardVehicle] = {}
        self._encoders: dict[Hashable, FrameEncoder] = {}
        self._beat_s = self._stepped_s = -math.inf

    @property
    def vehicles(self) -> list[RemoteVehicle]:
        """Return all vehicles heard, in the order of discovery."""
        return [heard.vehicle for heard in self._heard.values()]

    def process_bytes(self, now_s: float, peer: Hashable, data: bytes) -> None:
        """Process bytes received from a peer."""
        self.unread_bytes += len(data)
        for message in self._codec.decode_bytes(now_s, peer, data):
            self.unread_bytes = 0
            if self._on_packet is not None:
                self._on_packet(bytes(message.get_msgbuf()))
            heard = self._find_or_add_sender(now_s, peer, message)
            if heard is None:
                continue
            if message.get_srcComponent() == heard.vehicle.component:
                heard.last_heard_s = now_s
                heard.message_count += 1
            try:
                heard.vehicle.handle_message(now_s, message)
            except Exception as error:  # a fault of one vehicle must not affect the others
                self._report_fault(heard, message.get_type(), error)

    def take_due_frames(self, now_s: float, peers: Iterable[Hashable] = ()) -> list[OutgoingFrame]:
        """Return the frames to send at present: heartbeats, and the messages to all vehicles.

        Parameters
        ----------
        now_s : float
        peers : iterable
            Peers that the port can reach. Each gets our heartbeat, so that a vehicle waiting for a station answers.
        """
        stood_s, self._stepped_s = now_s - self._stepped_s, now_s
        if MAX_REQUEST_AGE_S < stood_s < math.inf:
            for vehicle in self.vehicles:
                vehicle.cancel_actions_after_stall(stood_s)
        out = self._make_heartbeats(now_s, peers)
        self._report_systems_without_autopilot(now_s)
        for heard in self._heard.values():
            self._update_link_quality(now_s, heard)
            try:
                messages = heard.vehicle.take_due_messages(now_s)
            except Exception as error:
                self._report_fault(heard, "step", error)
                continue
            out += [self._pack_message(heard.peer, message) for message in messages]
        return out

    def _make_heartbeats(self, now_s: float, peers: Iterable[Hashable]) -> list[OutgoingFrame]:
        if now_s - self._beat_s < HEARTBEAT_PERIOD_S:
            return []
        self._beat_s = now_s if now_s - self._beat_s > 2 * HEARTBEAT_PERIOD_S else self._beat_s + HEARTBEAT_PERIOD_S
        beat = mavlink.MAVLink_heartbeat_message(
            mavlink.MAV_TYPE_GCS, mavlink.MAV_AUTOPILOT_INVALID, 0, 0, mavlink.MAV_STATE_ACTIVE, 3
        )
        known = dict.fromkeys([*peers, *(heard.peer for heard in self._heard.values())])
        for gone in [peer for peer in self._encoders if peer not in known]:
            del self._encoders[gone]
        return [self._pack_message(peer, beat) for peer in known]

    def _pack_message(self, peer: Hashable, message: MavMessage) -> OutgoingFrame:
        encoder = self._encoders.get(peer)
        if encoder is None:
            encoder = self._encoders[peer] = FrameEncoder(*self.own_ids)
        data = encoder(message)
        if self._on_packet is not None:
            self._on_packet(data)
        return OutgoingFrame(peer, data)

    def _find_or_add_sender(self, now_s: float, peer: Hashable, message: MavMessage) -> _HeardVehicle | None:
        """Return the vehicle of the message's sender; a vehicle's heartbeat adds a new vehicle."""
        system = message.get_srcSystem()
        heard = self._heard.get((peer, system))
        if message.get_type() != "HEARTBEAT" or not system:
            return heard
        component = message.get_srcComponent()
        rank = vehicle_rank(message.type, message.autopilot, component)
        if heard is not None:
            if rank > heard.identification_rank and component != heard.vehicle.component:
                heard.vehicle.switch_to_autopilot_component(component)
            heard.identification_rank = max(rank, heard.identification_rank)
            return heard
        if not is_vehicle(message.type, message.autopilot, component):
            if message.type != mavlink.MAV_TYPE_GCS and len(self._equipment) < MAX_VEHICLES:
                what = f"{vehicle_type_name(message.type) or 'equipment'} (component {component})"
                self._equipment.setdefault((peer, system), (now_s, what))
            return None
        for key, lost in list(self._heard.items()):
            same = key[1] == system and lost.vehicle.component == component
            if same and now_s - lost.last_heard_s >= LOST_TIMEOUT_S:
                del self._heard[key]
                lost.peer = peer
                lost.vehicle.handle_new_address()
                self._heard[peer, system] = lost
                return lost
        if len(self._heard) >= MAX_VEHICLES:
            return None
        vehicle = RemoteVehicle(system, component, us=self.own_ids, color=self._color(), rate_Hz=self.rate_Hz)
        alike = sum(v.system == system for v in self.vehicles)
        vehicle.key = f"{system}@{self.name}" + (f"#{alike + 1}" if alike else "")
        new = self._heard[peer, system] = _HeardVehicle(vehicle, peer, now_s, rank)
        if self._on_vehicle is not None:
            self._on_vehicle(vehicle)
        return new

    def _report_systems_without_autopilot(self, now_s: float) -> None:
        """Report, once and after a waiting time, each MAVLink system from which no autopilot is heard."""
        for (peer, system), (since_s, what) in self._equipment.items():
            if since_s + LOST_TIMEOUT_S < now_s < math.inf and (peer, system) not in self._heard:
                self._equipment[peer, system] = (math.inf, what)
                if self._on_notice is not None:
                    self._on_notice(f"system {system}: only {what} received, no autopilot")

    def _update_link_quality(self, now_s: float, heard: _HeardVehicle) -> None:
        """Store packet loss and message rate of the last second in the vehicle's object."""
        since_s, received, lost, messages = heard.last_counts
        if now_s - since_s < _LINK_QUALITY_WINDOW_S:
            return
        counts = self._codec.packet_counts(heard.peer)
        new, gone = counts.received_count - received, counts.lost_count - lost
        if since_s:
            loss = max(0, gone) / (new + max(0, gone)) if new + gone > 0 else 1.0
            heard.vehicle.store_link_quality(now_s, loss, (heard.message_count - messages) / (now_s - since_s))
        heard.last_counts = (now_s, counts.received_count, counts.lost_count, heard.message_count)

    def _report_fault(self, heard: _HeardVehicle, where: str, error: Exception) -> None:
        text = f"{heard.vehicle.display_name}: {where} not processed ({type(error).__name__}: {error})"
        if where not in heard.reported_faults:  # one report per kind: a fault at 100 Hz would fill the log
            heard.reported_faults.add(where)
            heard.vehicle.add_note("error", text)
            _LOG.error(text, exc_info=error)
            if self._on_fault is not None:
                self._on_fault(text)


STEP_PERIOD_S = 0.02
MIN_STEP_INTERVAL_S = 0.004
"""Least interval between steps (s); received bytes otherwise trigger a step at once."""
HOUSEKEEPING_PERIOD_S = 0.5
_SYSTEM_IDS, _COMPONENT_IDS = (
    range(246, 255),
    range(25, 100),
)  # below 255, which others use; MAV_COMP_ID_USER1 to USER75
_FULL_TELEMETRY_BYTES_S = 45_000.0
_TELEMETRY_LINE_FRACTION = 0.6
_MAX_REPORTED_FAULTS = 100


def choose_telemetry_rate(endpoint: Endpoint, rate_Hz: float = 100.0) -> float:
    """Return the requested telemetry rate of vehicles behind an endpoint (Hz).

    All streams at 100 Hz are about 45 kB/s. On a serial line (10 bits a byte) the requested rate uses at most 60 % of
    the capacity.
    """
    if endpoint.kind != "serial":
        return rate_Hz
    share = _TELEMETRY_LINE_FRACTION * endpoint.port / 10.0 / _FULL_TELEMETRY_BYTES_S
    return max(1.0, min(rate_Hz, 100.0 * share))


def _open_endpoint(endpoint: Endpoint) -> Port:
    try:
        return open_port(endpoint)
    except InputError as error:
        raise ArgumentError("endpoints", error.key, error.problem, error.remedy) from error


_MIN_WARNED_UNREAD_BYTES = 4000


def _describe_unreadable_bytes(port: Port, link: GroundLink) -> str:
    """Return a warning if bytes arrive that hold no message; "" otherwise."""
    if link.unread_bytes < _MIN_WARNED_UNREAD_BYTES:
        return ""
    words = f"{port.endpoint}: {link.unread_bytes} bytes received, no MAVLink message among them"
    return words + (f"; check the baud rate ({port.endpoint.port})" if port.endpoint.kind == "serial" else "")


def _station_ids_from_process(process: int) -> tuple[int, int]:
    """Return the MAVLink system and component number of a station from the number of its process."""
    turns, k = divmod(process, len(_SYSTEM_IDS))
    return _SYSTEM_IDS[k], _COMPONENT_IDS[turns % len(_COMPONENT_IDS)]


class GroundStation:
    """A ground station without a user interface.

    Parameters
    ----------
    endpoints : sequence of str or Endpoint
        Endpoints of vehicles: ``"udp:127.0.0.1:14550"`` listens there.
    folder : str or Path
        Folder of the recordings.
    record : bool
        Whether to start a recording at once.
    record_here : bool
        The first recording goes into ``folder`` itself instead of a dated folder in it.
    us : (system, component), optional
        MAVLink address of the station. Default: a system number from 246 to 254 and one of the 75 user component
        numbers, chosen by process number, so that two stations on one vehicle differ.
    rate_Hz : float
        Requested rate of the vehicles' motion messages (Hz).
    on_vehicle : callable, optional
        Called with every new vehicle.
    name : str
        Name of the links, for endpoints that change at each start.

    Attributes
    ----------
    recorder : StationRecorder
    notices : deque of (time, str)
        Events of ports and recorder: time of day (s), text.

    Raises
    ------
    InputError
        If an endpoint is invalid.
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
        self.own_ids = us or _station_ids_from_process(os.getpid())
        self.notices: deque[tuple[float, str]] = deque(maxlen=200)
        self.recorder = StationRecorder(folder, first_here=record_here, on_end=self._add_notice)
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
        """Return all vehicles heard, in the order of discovery."""
        return list(self._found)

    @property
    def open_ports(self) -> list[Port]:
        """Return the open ports."""
        return [port for port, _ in self._links]

    async def start(self) -> None:
        """Open the ports and begin to listen.

        Raises
        ------
        InputError
            If a port cannot be opened or the recording cannot be written. All ports are closed then.
        """
        try:
            for endpoint in self.endpoints:
                self._links.append((_open_endpoint(endpoint), self._make_link(endpoint)))
            if self._record:
                self.recorder.start_recording()
        except Exception:
            await self.stop()
            raise
        loop = asyncio.get_running_loop()
        for port, link in self._links:
            self._receive_port(read_boot_clock(), port, link)  # connects, so that a missing peer is found at once
            number = port.fileno()
            if number >= 0:
                loop.add_reader(number, self._handle_readable, port, link)
                self._watched.append(number)
        self._task = loop.create_task(self._run_loop())

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
        self.recorder.stop_recording()

    def add_mark(self, text: str) -> bool:
        """Add a mark to the recording; return False if none runs."""
        return self.recorder.add_mark(text)

    def describe_link_problems(self) -> list[str]:
        """Return the present problems of the links, one line each."""
        return [
            words for port, link in self._links if (words := port.problem or _describe_unreadable_bytes(port, link))
        ]

    def _make_link(self, endpoint: Endpoint) -> GroundLink:
        return GroundLink(
            self.own_ids,
            rate_Hz=choose_telemetry_rate(endpoint, self._rate_Hz),
            color=lambda: next(self._colors),
            on_vehicle=self._add_vehicle,
            on_packet=self.recorder.record_packet,
            on_fault=self._add_notice,
            on_notice=self._add_notice,
            name=self._name or str(endpoint),
        )

    def _add_vehicle(self, vehicle: RemoteVehicle) -> None:
        self._found.append(vehicle)
        self.recorder.attach_vehicle(vehicle)
        if self._on_vehicle is not None:
            self._on_vehicle(vehicle)

    def _add_notice(self, text: str) -> None:
        self.notices.append((time.time(), text))

    def _handle_readable(self, port: Port, link: GroundLink) -> None:
        now_s = read_boot_clock()
        with self._contain_faults():
            self._receive_port(now_s, port, link)
            if now_s - self._stepped_s >= MIN_STEP_INTERVAL_S:
                self._step_links(now_s)

    @contextlib.contextmanager
    def _contain_faults(self) -> Iterator[None]:
        """Report a fault once and continue: no fault may end the station during a flight."""
        try:
            yield
        except Exception as error:
            text = f"internal error, the station continues ({type(error).__name__}: {error})"
            if text not in self._faults and len(self._faults) < _MAX_REPORTED_FAULTS:
                self._faults.add(text)
                _LOG.error(text, exc_info=error)
                self._add_notice(text)

    def _receive_port(self, now_s: float, port: Port, link: GroundLink) -> None:
        for peer, data in port.receive_bytes():
            link.process_bytes(now_s, peer, data)

    def _step_links(self, now_s: float) -> None:
        self._stepped_s = now_s
        for port, link in self._links:
            for peer, data in link.take_due_frames(now_s, port.reachable_peers):
                port.send_frame(peer, data)  # type: ignore[arg-type]  # the peers belong to this port

    def _do_housekeeping(self, now_s: float) -> None:
        self._cared_s = now_s
        self.recorder.check_disk_space_if_due(now_s)
        for port, _ in self._links:
            for text in port.take_notices():
                self._add_notice(text)
        for vehicle in self._found:
            vehicle.station_context.is_recording = self.recorder.recording
            vehicle.station_context.free_disk_bytes = self.recorder.free_bytes

    async def _run_loop(self) -> None:
        """Run periodic work without drift; a stall is not followed by a burst."""
        loop = asyncio.get_running_loop()
        due = loop.time()
        while True:
            now_s = read_boot_clock()
            with self._contain_faults():
                for port, link in self._links:
                    self._receive_port(now_s, port, link)  # ports without a descriptor, and connections to be retried
                self._step_links(now_s)
                if now_s - self._cared_s >= HOUSEKEEPING_PERIOD_S:
                    self._do_housekeeping(now_s)
            due = max(due + STEP_PERIOD_S, loop.time())
            await asyncio.sleep(due - loop.time())
