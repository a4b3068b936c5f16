"""The vehicle's end of the link: all messages in and out, without sockets and clocks.

Bytes come in by :meth:`VehicleLink.process_bytes` and go out of :meth:`VehicleLink.take_due_frames`. Each MAVLink
service has its own module: commands, missions, parameters, set-points and manual control, telemetry, operator control.
No received message raises an error.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Hashable

from mufly.flight import Flight, FlightEvent
from mufly.link.clients import Clients, CommandAuthority
from mufly.link.codec import FrameDecoder, GlobalOrigin, MavMessage, MessageSource, OutgoingFrame, mavlink
from mufly.link.command_protocol import CommandProtocol
from mufly.link.mission_protocol import MissionProtocol
from mufly.link.mission_transfer import parse_transfer_message
from mufly.link.parameter_protocol import ParameterProtocol
from mufly.link.steering_input import StickInputHandler, parse_rc_override, parse_set_point
from mufly.link.telemetry_streams import (
    MESSAGE_STREAMS,
    TelemetryState,
    extended_state_message,
    heartbeat_message,
    landed_state,
    mission_current_message,
    mission_state_message,
)
from mufly.link.vision_input import VisionInput

_READY_CHECK_PERIOD_S = 0.5
_MAX_QUEUED_EVENTS = 200
_ACCEPTED_COMPONENTS = (0, 1)  # all, and the autopilot


class VehicleLink:
    """The MAVLink interface of a flight.

    Parameters
    ----------
    flight : Flight
    system, component : int
        MAVLink address of the vehicle, 1..255.
    origin : GlobalOrigin or tuple (lat_deg, lon_deg, alt_m), optional
        Global position of N = E = D = 0, for programs that need one.

    Attributes
    ----------
    authority : CommandAuthority
        State of operator control.
    clients : Clients
        Peers of the vehicle.
    received_count, sent_count : int
        Numbers of messages.
    on_received : callable or None
        Called with the bytes of every received message, for a log.
    real_time_factor, slip_count : float, int
        Real-time performance of the loop (:class:`mufly.link.real_time.real_time_loop.RealTimePacer`), published to
        stations. NaN: not measured.
    """

    def __init__(
        self,
        flight: Flight,
        *,
        system: int = 1,
        component: int = 1,
        origin: GlobalOrigin | tuple[float, float, float] | None = None,
    ) -> None:
        self.flight, self.autopilot = flight, flight.autopilot
        self.system, self.component = system, component
        self.origin = GlobalOrigin(*origin) if isinstance(origin, tuple) else origin
        self.received_count = self.sent_count = 0
        self.real_time_factor, self.slip_count = math.nan, 0
        self.on_received: Callable[[bytes], None] | None = None
        self._codec = FrameDecoder()
        self.clients = Clients(system, component)
        self._stick_input = StickInputHandler(self.autopilot)
        self.authority = CommandAuthority(self.autopilot, self.clients, self._stick_input)
        self._parameters = ParameterProtocol(self.autopilot, self.clients, self.authority)
        self._missions = MissionProtocol(self.autopilot, self.clients, self.authority, self.origin)
        self._commands = CommandProtocol(
            flight, self.clients, self.authority, self._stick_input, self._missions, self.origin
        )
        outside = flight.outside_fixes
        self._positions = VisionInput(None if outside is None else outside.submit_fix, flight.log_event)
        self._events: deque[FlightEvent] = deque(maxlen=_MAX_QUEUED_EVENTS)
        self._shown: tuple[object, ...] = ()
        self._ready, self._ready_s = False, -_READY_CHECK_PERIOD_S
        self.autopilot.listeners.append(self._events.append)
        self._handlers: dict[str, Callable[[float, MessageSource, MavMessage], None]] = {
            "COMMAND_LONG": self._commands.handle_command,
            "COMMAND_INT": self._commands.handle_command,
            "SET_MODE": self._commands.handle_set_mode,
            "MISSION_SET_CURRENT": self._commands.handle_mission_set_current,
            "PARAM_REQUEST_LIST": self._parameters.handle_request_list,
            "PARAM_REQUEST_READ": self._parameters.handle_request_read,
            "PARAM_SET": self._parameters.handle_parameter_set,
            "SET_POSITION_TARGET_LOCAL_NED": self._handle_set_point,
            "SET_POSITION_TARGET_GLOBAL_INT": self._handle_set_point,
            "RC_CHANNELS_OVERRIDE": self._handle_rc_override,
            "MANUAL_CONTROL": self._handle_manual_control,
            "CHANGE_OPERATOR_CONTROL": self.authority.handle_operator_control,
            "REQUEST_DATA_STREAM": self._handle_data_stream,
            "TIMESYNC": self._answer_timesync,
            "VISION_POSITION_ESTIMATE": self._handle_vision,
            "PING": self._answer_ping,
        }

    # input

    def add_peer(self, now_s: float, peer: Hashable) -> None:
        """Add a peer that receives messages, even if it has sent none."""
        if self.clients.find_client(peer) is None:
            self.clients.add_client(now_s, peer, fixed=True)

    def process_bytes(self, now_s: float, peer: Hashable, data: bytes) -> None:
        """Process bytes received from a peer."""
        for message in self._codec.decode_bytes(now_s, peer, data):
            header = message.get_header()
            station = MessageSource(peer, header.srcSystem, header.srcComponent)
            if station[1:] == (self.system, self.component):
                continue  # the vehicle's own message, returned
            self.received_count += 1
            if self.on_received is not None:
                self.on_received(bytes(message.get_msgbuf()))
            self.clients.mark_heard(now_s, peer)
            self.authority.mark_heard(now_s, station)
            if not self._is_addressed_to_us(message):
                continue
            handler = self._handlers.get(message.get_type())
            if handler is not None:
                handler(now_s, station, message)
            elif (note := parse_transfer_message(message)) is not None:
                self._missions.handle_message(now_s, station, note)

    def resume_after_stall(self, now_s: float) -> None:
        """Count all peers as heard now: while the simulation stalled, the vehicle could not hear them."""
        for client in self.clients:
            client.last_heard_s = now_s
        if self.authority.commander is not None:
            self.authority.mark_heard(now_s, self.authority.commander)

    def _is_addressed_to_us(self, message: MavMessage) -> bool:
        system = getattr(message, "target_system", getattr(message, "target", 0))
        component = getattr(message, "target_component", 0)
        return system in (0, self.system) and component in (*_ACCEPTED_COMPONENTS, self.component)

    def _handle_set_point(self, now_s: float, station: MessageSource, m: MavMessage) -> None:
        wanted = parse_set_point(m, self.flight.status.estimate, self.origin)
        if wanted is not None and self.authority.claim_command(now_s, station):
            self.clients.send_refusal(now_s, station, self.autopilot.send_set_point(wanted).reason)

    def _handle_rc_override(self, now_s: float, station: MessageSource, m: MavMessage) -> None:
        # Releasing sticks that are not in use needs no command.
        releases = parse_rc_override(m) is None and self.authority.commander != station
        if not releases and self.authority.claim_command(now_s, station):
            self.clients.send_refusal(now_s, station, self._stick_input.handle_rc_override(m).reason)

    def _handle_manual_control(self, now_s: float, station: MessageSource, m: MavMessage) -> None:
        # A joystick sends all the time: it does not take command, and counts only if its station commands.
        if self.authority.commander in (None, station):
            self.clients.send_refusal(now_s, station, self._stick_input.handle_manual_control(now_s, m).reason)

    def _handle_vision(self, now_s: float, station: MessageSource, m: MavMessage) -> None:
        self._positions.delay_s = 1e-3 * self._parameters["EKF2_EV_DELAY"]
        self._positions.handle_position_message(now_s, self.flight.time_s, station, m)

    def _handle_data_stream(self, now_s: float, station: MessageSource, m: MavMessage) -> None:
        wishes = self.clients.mark_heard(now_s, station.peer).schedule
        wishes.set_group_rate(now_s, m.req_stream_id, m.req_message_rate if m.start_stop else 0.0)

    def _answer_timesync(self, now_s: float, station: MessageSource, m: MavMessage) -> None:
        if m.tc1 == 0:
            self.clients.send_message(
                station.peer, mavlink.MAVLink_timesync_message(round(self.flight.time_s * 1e9), m.ts1)
            )

    def _answer_ping(self, now_s: float, station: MessageSource, m: MavMessage) -> None:
        if m.target_system == 0:
            self.clients.send_message(
                station.peer,
                mavlink.MAVLink_ping_message(m.time_usec, m.seq, station.system, station.component),
            )

    # output

    def take_due_frames(self, now_s: float) -> list[OutgoingFrame]:
        """Return the frames to send; call this after every tick of the flight."""
        for peer in self.clients.drop_silent_clients(now_s):
            for part in (self._codec, self._missions):
                part.forget_peer(peer)
        parameters = self._parameters
        self.authority.step_link_failsafe(now_s, loss_s=parameters["COM_DL_LOSS_T"], land_s=parameters["COM_DL_LAND_T"])
        self._commands.execute_waiting_command(now_s)
        self._missions.repeat_lost_messages(now_s)
        self._parameters.send_next_values(now_s)
        while self._events:
            event = self._events.popleft()
            self.clients.send_text(event.text, event.level)
        self._send_streams(now_s)
        out = self.clients.take_outgoing()
        self.sent_count += len(out)
        return out

    def _send_streams(self, now_s: float) -> None:
        now = self._make_telemetry_state(now_s)
        made: dict[int, list[MavMessage]] = {}
        for client in self.clients:
            for k in client.schedule.take_due_streams(now_s):
                if k not in made:
                    made[k] = MESSAGE_STREAMS[k].build_messages(now)
                for message in made[k]:
                    self.clients.send_message(client.peer, message)
        state = now.flight_state
        shown = (
            state.state,
            now.mode_on_arming,
            state.armed,
            landed_state(now),
            now.mission_progress,
            state.crash_cause,
        )
        if shown != self._shown:
            self._shown = shown
            for make in (
                heartbeat_message,
                extended_state_message,
                mission_current_message,
                mission_state_message,
            ):
                self.clients.send_message(None, make(now))
        # Sent last, since programs report the mission as complete when its last item is reached.
        for item in self._missions.take_reached_items(state):
            self.clients.send_message(None, mavlink.MAVLink_mission_item_reached_message(item))

    def _make_telemetry_state(self, now_s: float) -> TelemetryState:
        state = self.flight.status
        if now_s - self._ready_s >= _READY_CHECK_PERIOD_S:
            self._ready, self._ready_s = not self.autopilot.list_arming_faults(), now_s
        commander = self.authority.commander
        losses = [self._codec.packet_counts(client.peer).loss_ratio for client in self.clients]
        return TelemetryState(
            vehicle=self.flight.vehicle,
            flight_state=state,
            is_ready=self._ready,
            mission_progress=self._missions.mission_progress(state),
            origin=self.origin,
            mode_on_arming="" if state.armed else self._commands.mode_on_arming(now_s),
            commander_id=0 if commander is None else commander.system * 256 + commander.component,
            loss_ratio=max(losses, default=0.0),
            real_time_factor=self.real_time_factor,
            slip_count=self.slip_count,
        )
