"""A station's end of one link: it hears all vehicles there, keeps them apart, and speaks to each.

Pure: bytes and the clock are passed in (:meth:`GroundLink.receive`, :meth:`GroundLink.step`), bytes to be sent come
out. A vehicle is whoever sends a heartbeat of an autopilot; it is known by its system number and the address it is
heard from. When a vehicle that was lost is heard again under the same number, from another address too, it is the
same one.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Hashable, Iterable
from dataclasses import dataclass, field

from mufly.link.codec import Codec, Encoder, Outgoing
from mufly.link.dialect import MavMessage, mavlink
from mufly.station.remote import LOST_S, RemoteVehicle

__all__ = ["GroundLink"]

HEARTBEAT_S = 1.0
MOST_VEHICLES = 32
_NO_AUTOPILOT = 8  # MAV_AUTOPILOT_INVALID
_WINDOW_S = 1.0
_LOG = logging.getLogger(__name__)


@dataclass(slots=True)
class _Heard:
    """A vehicle, the peer that it is heard from, and what was counted of it when."""

    vehicle: RemoteVehicle
    peer: Hashable
    encoder: Encoder
    heard_s: float
    messages: int = 0
    counted: tuple[float, int, int, int] = (0.0, 0, 0, 0)
    faults: set[str] = field(default_factory=set)


class GroundLink:
    """One link of a station.

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
    ) -> None:
        self.us, self.rate_Hz = us, rate_Hz
        self._color = color or (lambda: len(self._heard))
        self._on_vehicle, self._on_packet, self._on_fault = on_vehicle, on_packet, on_fault
        self._codec = Codec()
        self._heard: dict[tuple[Hashable, int], _Heard] = {}
        self._encoders: dict[Hashable, Encoder] = {}
        self._beat_s = float("-inf")

    @property
    def vehicles(self) -> list[RemoteVehicle]:
        """All vehicles heard so far, in the order in which they were found."""
        return [heard.vehicle for heard in self._heard.values()]

    def receive(self, now_s: float, peer: Hashable, data: bytes) -> None:
        """Take bytes that came from a peer."""
        for message in self._codec.receive(now_s, peer, data):
            if self._on_packet is not None:
                self._on_packet(bytes(message.get_msgbuf()))
            heard = self._sender(now_s, peer, message)
            if heard is None:
                continue
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
        out = self._heartbeats(now_s, peers)
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
        """The vehicle that sent a message; one that is new if the message is a heartbeat of an autopilot."""
        system = message.get_srcSystem()
        heard = self._heard.get((peer, system))
        if heard is not None or message.get_type() != "HEARTBEAT":
            return heard
        if message.autopilot == _NO_AUTOPILOT or message.type == mavlink.MAV_TYPE_GCS or not system:
            return None
        component = message.get_srcComponent()
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
        new = self._heard[peer, system] = _Heard(vehicle, peer, Encoder(*self.us), now_s)
        if self._on_vehicle is not None:
            self._on_vehicle(vehicle)
        return new

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
            heard.vehicle.texts.note(heard.vehicle.telemetry.time_s, "error", text)
            _LOG.error(text, exc_info=error)
            if self._on_fault is not None:
                self._on_fault(text)
