"""The vehicle's end of the link: everything that it says and hears, as one machine without sockets and clocks.

Bytes come in by :meth:`VehicleLink.receive` and go out of :meth:`VehicleLink.step`. What each service of MAVLink
does is in a file of its own: commands, missions, parameters, set-points and manual control, telemetry, who commands.
Nothing that arrives raises an error.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Hashable

from mufly.flight import Event, Flight
from mufly.link.clients import Authority, Clients, ManualControl, Source, of_channels, set_point_of
from mufly.link.codec import Codec, MavMessage, Origin, Outgoing, mavlink
from mufly.link.commands import CommandProtocol
from mufly.link.mission_transfer import note_of
from mufly.link.missions import MissionProtocol
from mufly.link.parameters import ParameterProtocol
from mufly.link.telemetry import (
    STREAMS,
    Instant,
    extended_sys_state,
    heartbeat,
    landed_state,
    mission_current,
    mission_state,
)
from mufly.link.vision import VisionInput

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
    authority : Authority
        Who commands.
    clients : Clients
        Whom it speaks to.
    received, sent : int
        Messages so far.
    on_received : callable or None
        Called with the bytes of every message that comes in; a log hangs here.
    real_time_factor, slips : float, int
        How well whoever ticks the flight keeps to the clock on the wall (:class:`mufly.link.process.Pace`); it is told
        to stations. NaN: not measured.
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
        self.real_time_factor, self.slips = math.nan, 0
        self.on_received: Callable[[bytes], None] | None = None
        self._codec = Codec()
        self.clients = Clients(system, component)
        self._manual = ManualControl(self.autopilot)
        self.authority = Authority(self.autopilot, self.clients, self._manual)
        self._parameters = ParameterProtocol(self.autopilot, self.clients, self.authority)
        self._missions = MissionProtocol(self.autopilot, self.clients, self.authority, self.origin)
        self._commands = CommandProtocol(
            flight, self.clients, self.authority, self._manual, self._missions, self.origin
        )
        outside = flight.outside_fixes
        self._positions = VisionInput(None if outside is None else outside.give, flight.note)
        self._events: deque[Event] = deque(maxlen=_EVENTS)
        self._shown: tuple[object, ...] = ()
        self._ready, self._ready_s = False, -_READY_S
        self.autopilot.listeners.append(self._events.append)
        self._handlers: dict[str, Callable[[float, Source, MavMessage], None]] = {
            "COMMAND_LONG": self._commands.command,
            "COMMAND_INT": self._commands.command,
            "SET_MODE": self._commands.set_mode,
            "MISSION_SET_CURRENT": self._commands.set_current,
            "PARAM_REQUEST_LIST": self._parameters.request_list,
            "PARAM_REQUEST_READ": self._parameters.request_read,
            "PARAM_SET": self._parameters.set,
            "SET_POSITION_TARGET_LOCAL_NED": self._set_point,
            "SET_POSITION_TARGET_GLOBAL_INT": self._set_point,
            "RC_CHANNELS_OVERRIDE": self._override,
            "MANUAL_CONTROL": self._manual_control,
            "CHANGE_OPERATOR_CONTROL": self.authority.operator_control,
            "REQUEST_DATA_STREAM": self._data_stream,
            "TIMESYNC": self._timesync,
            "VISION_POSITION_ESTIMATE": self._vision,
            "PING": self._ping,
        }

    # in

    def connect(self, now_s: float, peer: Hashable) -> None:
        """Send to a peer from now on, whether or not it has said anything."""
        if self.clients.get(peer) is None:
            self.clients.add(now_s, peer, fixed=True)

    def receive(self, now_s: float, peer: Hashable, data: bytes) -> None:
        """Take bytes that came from a peer."""
        for message in self._codec.receive(now_s, peer, data):
            header = message.get_header()
            station = Source(peer, header.srcSystem, header.srcComponent)
            if station[1:] == (self.system, self.component):
                continue  # our own, sent back
            self.received += 1
            if self.on_received is not None:
                self.on_received(bytes(message.get_msgbuf()))
            self.clients.hear(now_s, peer)
            self.authority.hear(now_s, station)
            if not self._for_us(message):
                continue
            handler = self._handlers.get(message.get_type())
            if handler is not None:
                handler(now_s, station, message)
            elif (note := note_of(message)) is not None:
                self._missions.receive(now_s, station, note)

    def resume(self, now_s: float) -> None:
        """Go on after a time in which nobody could be heard: that was no silence of theirs."""
        for client in self.clients:
            client.heard_s = now_s
        if self.authority.commander is not None:
            self.authority.hear(now_s, self.authority.commander)

    def _for_us(self, message: MavMessage) -> bool:
        system = getattr(message, "target_system", getattr(message, "target", 0))
        component = getattr(message, "target_component", 0)
        return system in (0, self.system) and component in (*_COMPONENTS, self.component)

    def _set_point(self, now_s: float, station: Source, m: MavMessage) -> None:
        wanted = set_point_of(m, self.flight.status.estimate, self.origin)
        if wanted is not None and self.authority.may(now_s, station):
            self.clients.tell(now_s, station, self.autopilot.set_point(wanted).reason)

    def _override(self, now_s: float, station: Source, m: MavMessage) -> None:
        # Releasing what one does not hold takes no command.
        releases = of_channels(m) is None and self.authority.commander != station
        if not releases and self.authority.may(now_s, station):
            self.clients.tell(now_s, station, self._manual.override(m).reason)

    def _manual_control(self, now_s: float, station: Source, m: MavMessage) -> None:
        # A joystick talks all the time: it takes no command, it only counts if its station has it.
        if self.authority.commander in (None, station):
            self.clients.tell(now_s, station, self._manual.manual(now_s, m).reason)

    def _vision(self, now_s: float, station: Source, m: MavMessage) -> None:
        self._positions.delay_s = 1e-3 * self._parameters["EKF2_EV_DELAY"]
        self._positions.handle(now_s, self.flight.time_s, station, m)

    def _data_stream(self, now_s: float, station: Source, m: MavMessage) -> None:
        wishes = self.clients.hear(now_s, station.peer).wishes
        wishes.set_group(now_s, m.req_stream_id, m.req_message_rate if m.start_stop else 0.0)

    def _timesync(self, now_s: float, station: Source, m: MavMessage) -> None:
        if m.tc1 == 0:
            self.clients.send(
                station.peer, mavlink.MAVLink_timesync_message(round(self.flight.time_s * 1e9), m.ts1)
            )

    def _ping(self, now_s: float, station: Source, m: MavMessage) -> None:
        if m.target_system == 0:
            self.clients.send(
                station.peer,
                mavlink.MAVLink_ping_message(m.time_usec, m.seq, station.system, station.component),
            )

    # out

    def step(self, now_s: float) -> list[Outgoing]:
        """Return what is to be sent now; call it after every tick of the flight."""
        for peer in self.clients.drop_silent(now_s):
            for part in (self._codec, self._missions):
                part.forget(peer)
        parameters = self._parameters
        self.authority.watch(now_s, loss_s=parameters["COM_DL_LOSS_T"], land_s=parameters["COM_DL_LAND_T"])
        self._commands.step(now_s)
        self._missions.step(now_s)
        self._parameters.step(now_s)
        while self._events:
            event = self._events.popleft()
            self.clients.say(event.text, event.level)
        self._stream(now_s)
        out = self.clients.taken()
        self.sent += len(out)
        return out

    def _stream(self, now_s: float) -> None:
        now = self._instant(now_s)
        made: dict[int, list[MavMessage]] = {}
        for client in self.clients:
            for k in client.wishes.due(now_s):
                if k not in made:
                    made[k] = STREAMS[k].messages(now)
                for message in made[k]:
                    self.clients.send(client.peer, message)
        state = now.state
        shown = (state.state, now.chosen, state.armed, landed_state(now), now.progress, state.crashed)
        if shown != self._shown:
            self._shown = shown
            for make in (heartbeat, extended_sys_state, mission_current, mission_state):
                self.clients.send(None, make(now))
        # After that the mission is complete: programs tell their users when they hear of the last item.
        for item in self._missions.reached(state):
            self.clients.send(None, mavlink.MAVLink_mission_item_reached_message(item))

    def _instant(self, now_s: float) -> Instant:
        state = self.flight.status
        if now_s - self._ready_s >= _READY_S:
            self._ready, self._ready_s = not self.autopilot.not_ready(), now_s
        commander = self.authority.commander
        losses = [self._codec.counts(client.peer).loss for client in self.clients]
        return Instant(
            vehicle=self.flight.vehicle,
            state=state,
            ready=self._ready,
            progress=self._missions.progress(state),
            origin=self.origin,
            chosen="" if state.armed else self._commands.chosen(now_s),
            commander=0 if commander is None else commander.system * 256 + commander.component,
            loss=max(losses, default=0.0),
            real_time_factor=self.real_time_factor,
            slips=self.slips,
        )
