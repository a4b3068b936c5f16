"""The vehicle's end of the link: everything that it says and hears, as one machine without sockets and clocks.

Bytes come in by :meth:`VehicleLink.receive` and go out of :meth:`VehicleLink.step`. What each kind of message does is
in a file of its own: commands, enquiries, parameters, missions, set-points, sticks, streams, who commands, what
happens when the commander is lost. Nothing that arrives raises an error.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Hashable
from typing import TYPE_CHECKING

from mufly.link.authority import Bridge
from mufly.link.clients import STREAMS, Authority, Client, Sender, Voice
from mufly.link.codec import Codec, MavMessage, Outgoing, mavlink
from mufly.link.commands import CommandDesk, Controls
from mufly.link.conventions import OnArming, Origin
from mufly.link.mission_transfer import Ack, MissionResult, Note, Notes, note_of, to_mavlink
from mufly.link.missions import MissionDesk, writes
from mufly.link.parameters import ParameterDesk
from mufly.link.set_points import Sticks, of_channels, set_point_of
from mufly.link.telemetry import (
    Airframe,
    Picture,
    extended_sys_state,
    heartbeat,
    landed_state,
    mission_current,
    mission_state,
)

if TYPE_CHECKING:
    from mufly.flight import Event, Flight

_READY_S = 0.5
_EVENTS = 200
_COMPONENTS = (0, 1)  # all, and the autopilot


class VehicleLink:
    """Speaks MAVLink for a flight.

    Parameters
    ----------
    flight : Flight
    system, component : int
        Who it is, 1..255.
    origin : Origin or tuple (lat_deg, lon_deg, alt_m), optional
        Where on the globe N = E = D = 0 is, for programs that insist on such a place.

    Attributes
    ----------
    received, sent : int
        Messages so far.
    on_received : callable or None
        Called with the bytes of every message that comes in; a log hangs here.
    """

    def __init__(
        self,
        flight: Flight,
        *,
        system: int = 1,
        component: int = 1,
        origin: Origin | tuple[float, float, float] | None = None,
    ) -> None:
        self.flight, self.autopilot = flight, flight.autopilot
        self.system, self.component = system, component
        self.origin = Origin(*origin) if isinstance(origin, tuple) else origin
        self.received = self.sent = 0
        self.on_received: Callable[[bytes], None] | None = None
        self._voice = Voice(system, component)
        self._codec = Codec()
        self._parameters = ParameterDesk(self.autopilot)
        self._desk = MissionDesk(self.autopilot, self.origin)
        self._sticks = Sticks(self.autopilot)
        self._on_arming = OnArming()
        self._bridge = Bridge(self.autopilot, self._voice, self._sticks, self._on_arming, self._parameters)
        self._commands = CommandDesk(self._voice, self._bridge, self._controls)
        self._events: deque[Event] = deque(maxlen=_EVENTS)
        self._shown: tuple[object, ...] = ()
        self._ready, self._ready_s = False, -_READY_S
        self._airframe = airframe_of(flight)
        self.autopilot.listeners.append(self._events.append)
        self._handlers = {
            "COMMAND_LONG": self._commands.command,
            "COMMAND_INT": self._commands.command,
            "SET_MODE": self._commands.set_mode,
            "PARAM_REQUEST_LIST": self._parameter_list,
            "PARAM_REQUEST_READ": self._parameter_read,
            "PARAM_SET": self._parameter_set,
            "MISSION_SET_CURRENT": self._commands.set_current,
            "SET_POSITION_TARGET_LOCAL_NED": self._set_point,
            "SET_POSITION_TARGET_GLOBAL_INT": self._set_point,
            "RC_CHANNELS_OVERRIDE": self._override,
            "MANUAL_CONTROL": self._manual,
            "REQUEST_DATA_STREAM": self._data_stream,
            "TIMESYNC": self._timesync,
            "PING": self._ping,
            "CHANGE_OPERATOR_CONTROL": self._bridge.operator_control,
        }

    @property
    def authority(self) -> Authority:
        """Who commands."""
        return self._bridge.authority

    # in

    def connect(self, now_s: float, peer: Hashable) -> None:
        """Send to a peer from now on, whether or not it has said anything."""
        if self._voice.clients.get(peer) is None:
            self._voice.clients.add(now_s, peer, fixed=True)

    def receive(self, now_s: float, peer: Hashable, data: bytes) -> None:
        """Take bytes that came from a peer."""
        for message in self._codec.receive(now_s, peer, data):
            header = message.get_header()
            sender = Sender(peer, header.srcSystem, header.srcComponent)
            if sender[1:] == (self.system, self.component):
                continue  # our own voice, sent back
            self.received += 1
            if self.on_received is not None:
                self.on_received(bytes(message.get_msgbuf()))
            self._voice.clients.hear(now_s, peer)
            self.authority.hear(now_s, sender)
            if self._for_us(message):
                self._hear(now_s, sender, message)

    def _for_us(self, message: MavMessage) -> bool:
        system = getattr(message, "target_system", getattr(message, "target", 0))
        component = getattr(message, "target_component", 0)
        return system in (0, self.system) and component in (*_COMPONENTS, self.component)

    def _hear(self, now_s: float, sender: Sender, message: MavMessage) -> None:
        handler = self._handlers.get(message.get_type())
        if handler is not None:
            handler(now_s, sender, message)
            return
        note = note_of(message)
        if note is not None:
            self._note(now_s, sender, note)

    # out

    def step(self, now_s: float) -> list[Outgoing]:
        """Return what is to be sent now; call it after every tick of the flight."""
        for client in self._voice.clients.leaving(now_s):
            self._voice.clients.drop(client.peer)
            self._codec.forget(client.peer)
            self._desk.forget(client.peer)
            self._parameters.forget(client.peer)
        self._bridge.watch(now_s)
        self._commands.step(now_s)
        self._send_notes(self._desk.only_from(self.authority.commander))
        self._send_notes(self._desk.step(now_s))
        for sender, value in self._parameters.step(now_s):
            self._voice.send(sender.peer, value)
        for value in self._parameters.changed(now_s):
            self._voice.send(None, value)
        while self._events:
            event = self._events.popleft()
            self._voice.say(event.text, event.level)
        self._stream(now_s)
        out = self._voice.taken()
        self.sent += len(out)
        return out

    def _stream(self, now_s: float) -> None:
        picture = self._picture(now_s)
        made: dict[int, list[MavMessage]] = {}
        for client in self._voice.clients:
            for k in client.wishes.due(now_s):
                if k not in made:
                    found = STREAMS[k].make(picture)
                    made[k] = found if isinstance(found, list) else [] if found is None else [found]
                for message in made[k]:
                    self._voice.send(client.peer, message)
        status = picture.status
        shown = (
            status.state, picture.chosen, status.armed, landed_state(picture), picture.progress, picture.view.crashed
        )  # fmt: skip
        if shown != self._shown:
            self._shown = shown
            for make in (heartbeat, extended_sys_state, mission_current, mission_state):
                self._voice.send(None, make(picture))
        # After that the mission is complete: programs tell their users when they hear of the last item.
        for item in self._desk.reached(picture.status):
            self._voice.send(None, mavlink.MAVLink_mission_item_reached_message(item))

    def _picture(self, now_s: float) -> Picture:
        status = self.autopilot.status
        if now_s - self._ready_s >= _READY_S:
            self._ready, self._ready_s = not self.autopilot.not_ready(), now_s
        mission = self.autopilot.software.mission_state
        commander = self.authority.commander
        losses = [self._codec.counts(client.peer).loss for client in self._voice.clients]
        return Picture(
            view=self.flight.view,
            status=status,
            ready=self._ready,
            returning=mission is not None and mission.homing,
            progress=self._desk.progress(status),
            airframe=self._airframe,
            origin=self.origin,
            chosen="" if status.armed else self._on_arming.chosen(now_s),
            commander=0 if commander is None else commander.system * 256 + commander.component,
            loss=max(losses, default=0.0),
        )

    def _send_notes(self, notes: Notes) -> None:
        for station, note in notes:
            if isinstance(station, Sender):
                self._voice.send(station.peer, to_mavlink(note, station.system, station.component))
        if self._desk.refused:
            self._voice.say(self._desk.refused, "warning")
            self._desk.refused = ""

    def _controls(self, now_s: float) -> Controls:
        return Controls(
            self.autopilot, self._desk, self._sticks, self._on_arming, self.origin, self.flight.reset, now_s
        )

    # parameters

    def _parameter_list(self, now_s: float, sender: Sender, m: MavMessage) -> None:
        self._parameters.request_list(sender)

    def _parameter_read(self, now_s: float, sender: Sender, m: MavMessage) -> None:
        value = self._parameters.read(m)
        self._voice.send(sender.peer, self._parameters.no_such(sender, m) if value is None else value)

    def _parameter_set(self, now_s: float, sender: Sender, m: MavMessage) -> None:
        if self._bridge.may(now_s, sender):
            value, why = self._parameters.set(m)
            if why:
                self._voice.say(why, "warning", sender.peer)
            if value is None:
                self._voice.send(sender.peer, self._parameters.no_such(sender, m))
            # Everybody who watches learns of it.
            if value is not None:
                self._voice.send(None, value)
        else:
            request = mavlink.MAVLink_param_request_read_message(0, 0, m.param_id.encode(), -1)
            self._parameter_read(now_s, sender, request)

    # missions

    def _note(self, now_s: float, sender: Sender, note: Note) -> None:
        if writes(note) and not self._bridge.may(now_s, sender):
            self._send_notes([(sender, Ack(MissionResult.DENIED, note.mission_type))])
        else:
            self._send_notes(self._desk.only_from(self.authority.commander))
            self._send_notes(self._desk.receive(now_s, sender, note))

    # set-points and sticks

    def _set_point(self, now_s: float, sender: Sender, m: MavMessage) -> None:
        wanted = set_point_of(m, self.flight.view.measured, self.origin)
        if wanted is not None and self._bridge.may(now_s, sender):
            self._voice.tell(now_s, sender, self.autopilot.set_point(wanted).reason)

    def _override(self, now_s: float, sender: Sender, m: MavMessage) -> None:
        # Releasing what one does not hold takes no command.
        releases = of_channels(m) is None and self.authority.commander != sender
        if not releases and self._bridge.may(now_s, sender):
            answer = self._sticks.override(m)
            self._voice.tell(now_s, sender, answer.reason if answer is not None else "")

    def _manual(self, now_s: float, sender: Sender, m: MavMessage) -> None:
        # A joystick talks all the time: it takes no command, it only counts if its station has it.
        if self.authority.commander in (None, sender):
            answer = self._sticks.manual(now_s, m)
            self._voice.tell(now_s, sender, answer.reason if answer is not None else "")

    # the rest

    def _data_stream(self, now_s: float, sender: Sender, m: MavMessage) -> None:
        client: Client = self._voice.clients.hear(now_s, sender.peer)
        client.wishes.set_group(now_s, m.req_stream_id, m.req_message_rate if m.start_stop else 0.0)

    def _timesync(self, now_s: float, sender: Sender, m: MavMessage) -> None:
        if m.tc1 == 0:
            self._voice.send(
                sender.peer, mavlink.MAVLink_timesync_message(round(self.flight.time_s * 1e9), m.ts1)
            )

    def _ping(self, now_s: float, sender: Sender, m: MavMessage) -> None:
        if m.target_system == 0:
            self._voice.send(
                sender.peer,
                mavlink.MAVLink_ping_message(m.time_usec, m.seq, sender.system, sender.component),
            )


def airframe_of(flight: Flight) -> Airframe:
    """What messages say of the vehicle that never changes."""
    ring, battery = flight.vehicle.range_ring, flight.vehicle.battery
    return Airframe(
        float(ring.first_angle),
        ring.count,
        float(ring.min_range),
        float(ring.max_range),
        float(battery.nominal_voltage),
        float(battery.low_voltage),
    )
