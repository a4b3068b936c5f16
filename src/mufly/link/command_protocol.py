"""The command protocol: COMMAND_LONG and COMMAND_INT, their execution and their acknowledgement.

Every command gets one COMMAND_ACK; a refused command also gets a line with the reason. :data:`COMMAND_HANDLERS` is the
table of commands. https://mavlink.io/en/messages/common.html#mav_commands defines the parameters. Deviations:

* NAV_TAKEOFF: parameter 7 is the height above the floor (m); NaN or 0: parameter MIS_TAKEOFF_ALT. With a global
  origin a number that is plausible only as an altitude above the sea is taken as such. NAV_TAKEOFF_LOCAL: z, down.
* NAV_LAND lands at the present position, NAV_RETURN_TO_LAUNCH above the take-off position.
* DO_REPOSITION accepts LOCAL_NED (frame 1) and, with an origin, the global frames. Without a position it stops, and
  turns if a heading is given: QGroundControl's "pause" and "change heading".
* DO_LAND_START, MAVProxy's "land", lands at once: there is no landing sequence.
* DO_SET_MODE to take-off or mission, on the floor and disarmed, takes effect on arming within
  :data:`MODE_CHOICE_TIMEOUT_S`, unless another mode is chosen. QGroundControl's "start mission" relies on this: it
  sets PX4's mode AUTO MISSION, waits for the heartbeat to show it, and arms.
* DO_FLIGHTTERMINATION, and disarming with the magic number 21196, stop the motors at once.
* INJECT_FAILURE makes a sensor of a simulated flight fail at once (:data:`FAILURE_NAMES`); OK of any unit clears all.
  Parameters 5 and 6, free in the specification, are magnitude and duration (s); 0 or NaN: default magnitude, until
  cleared.
* PREFLIGHT_REBOOT_SHUTDOWN (1) resets the simulated helicopter to its start.

Programs repeat a command until they receive its acknowledgement. A repetition has the same parameters and station and
comes within :data:`REPEAT_WINDOW_S`, or within :data:`CONFIRMATION_WINDOW_S` if its ``confirmation`` marks it. A
repetition of an accepted command is acknowledged again and not executed. If the station has sent other commands since,
a copy is a repetition only if its ``confirmation`` has grown by one in each :data:`MAX_CONFIRMATION_INTERVAL_S`: it
must not undo later commands. A refused command is judged anew, because its obstacle may be gone. An emergency stop is
always executed.
"""

from __future__ import annotations

import math
import struct
from collections import OrderedDict
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Literal

from mufly.errors import InputError
from mufly.flight import Flight
from mufly.link.clients import Clients, CommandAuthority, StreamSchedule
from mufly.link.codec import (
    COORDINATE_NOT_GIVEN,
    FRAMES_ABOVE_ORIGIN,
    FRAMES_ABOVE_SEA,
    MODE_LOITER,
    GlobalOrigin,
    MavMessage,
    MessageSource,
    Px4Mode,
    action_for_mode,
    clip_to_integer,
    decode_coordinate,
    mavlink,
    to_float32,
    unpack_custom_mode,
)
from mufly.link.mission_protocol import MissionProtocol
from mufly.link.steering_input import StickInputHandler
from mufly.link.telemetry_streams import ORIGIN_DEPENDENT_MESSAGE_IDS
from mufly.mission import (
    MAX_HEIGHT_M,
    MIN_WAYPOINT_HEIGHT_M,
    REQUEST_ACCEPTED,
    RequestAnswer,
    deny_request,
    reject_temporarily,
)
from mufly.quantities.sensor_table import READINGS
from mufly.sensors import Fault

FORCE_DISARM_MAGIC = 21196.0
"""The magic number of COMPONENT_ARM_DISARM that stops the motors in flight."""
LOCAL_FRAMES = (1, 4, 7, 8, 9, 12)
"""Values of MAV_FRAME with coordinates in metres."""
REPEAT_WINDOW_S = 0.8
"""Longest time between repetitions without a mark (s): programs repeat after 0.5 s (MAVSDK) or more, and presses of a
key are further apart."""
CONFIRMATION_WINDOW_S = 10.0
MAX_CONFIRMATION_INTERVAL_S = 1.5
"""Longest time between two counted repetitions of a program (s)."""
MODE_CHOICE_TIMEOUT_S = 10.0
"""Validity of a mode chosen before arming (s)."""

ModeChoice = Literal["take-off", "mission", ""]

_MAX_INTEGER_COORDINATE = COORDINATE_NOT_GIVEN - 1
_STICK_RELEASE_TIMEOUT_S = 0.3
_MAX_REMEMBERED_COMMANDS = 8  # commands of a station
_MAX_STATIONS = 32
_RESULT_ACCEPTED, _RESULT_DENIED = mavlink.MAV_RESULT_ACCEPTED, mavlink.MAV_RESULT_DENIED
_RESULT_UNSUPPORTED = mavlink.MAV_RESULT_UNSUPPORTED


@dataclass(frozen=True, slots=True)
class Command:
    """MAVLink command (COMMAND_LONG or COMMAND_INT), as sent or received.

    Attributes
    ----------
    command_id : int
        MAV_CMD.
    params : tuple of 7 floats
        Parameters 1 to 7; 5 and 6 in degrees or metres; NaN where not given.
    frame : int or None
        MAV_FRAME of a COMMAND_INT; None: a COMMAND_LONG.
    confirmation : int
        Above 0: the command is a repetition.
    """

    command_id: int
    params: tuple[float, ...] = (math.nan,) * 7
    frame: int | None = None
    confirmation: int = 0

    @property
    def is_emergency_stop(self) -> bool:
        """Return whether this is an emergency stop, which any station may send and which discards waiting commands."""
        if self.command_id == mavlink.MAV_CMD_DO_FLIGHTTERMINATION:
            return self.params[0] > 0.5
        return self.command_id == mavlink.MAV_CMD_COMPONENT_ARM_DISARM and self.params[:2] == (
            0.0,
            FORCE_DISARM_MAGIC,
        )

    @property
    def identity_bytes(self) -> bytes:
        """Return number, frame and parameters as bytes, to compare two commands (NaN equals NaN)."""
        return struct.pack("<ii7d", self.command_id, -1 if self.frame is None else self.frame, *self.params)

    def to_message(self, system: int, component: int, confirmation: int = 0) -> MavMessage:
        """Return the MAVLink message: x and y of a COMMAND_INT are metres times 1e4 or degrees times 1e7."""
        p = self.params
        if self.frame is None:
            return mavlink.MAVLink_command_long_message(
                system, component, self.command_id, confirmation, *map(to_float32, p)
            )
        scale = 1e4 if self.frame in LOCAL_FRAMES else 1e7
        # A value beyond the field's range is unreachable; the vehicle reports it.
        *four, x, y, z = p
        x, y = (
            clip_to_integer(v * scale, -_MAX_INTEGER_COORDINATE, _MAX_INTEGER_COORDINATE, COORDINATE_NOT_GIVEN)
            for v in (x, y)
        )
        return mavlink.MAVLink_command_int_message(
            system,
            component,
            self.frame,
            self.command_id,
            0,
            0,
            *map(to_float32, four),
            x,
            y,
            to_float32(z),
        )


def parse_command(message: MavMessage) -> Command:
    """Return the command of a COMMAND_LONG or COMMAND_INT."""
    m = message
    first = (m.param1, m.param2, m.param3, m.param4)
    if m.get_type() == "COMMAND_LONG":
        return Command(m.command, (*first, m.param5, m.param6, m.param7), None, m.confirmation)
    scale = 1e-4 if m.frame in LOCAL_FRAMES else 1e-7
    x, y = (decode_coordinate(v, scale) for v in (m.x, m.y))
    return Command(m.command, (*first, x, y, m.z), m.frame)


@dataclass(slots=True)
class _AcceptedCommand:
    """Executed command, kept to recognise repetitions: its answer, time and confirmation count when last received."""

    last_heard_s: float
    confirmation: int
    answer: RequestAnswer


class CommandProtocol:
    """Executor of COMMAND_LONG, COMMAND_INT and their older forms SET_MODE and MISSION_SET_CURRENT.

    Parameters
    ----------
    flight : Flight
    clients : Clients
    authority : CommandAuthority
    stick_input : StickInputHandler
    missions : MissionProtocol
    origin : GlobalOrigin or None
    """

    def __init__(
        self,
        flight: Flight,
        clients: Clients,
        authority: CommandAuthority,
        stick_input: StickInputHandler,
        missions: MissionProtocol,
        origin: GlobalOrigin | None,
    ) -> None:
        self._flight, self._autopilot = flight, flight.autopilot
        self._clients, self._authority = clients, authority
        self._stick_input, self._missions, self._origin = stick_input, missions, origin
        self._last: OrderedDict[MessageSource, OrderedDict[bytes, _AcceptedCommand]] = (
            OrderedDict()
        )  # the newest is last
        self._held: tuple[float, MessageSource, Command] | None = None
        self._choice: tuple[float, ModeChoice] = (-math.inf, "")
        authority.on_change.append(self._forget_mode_choice)

    def mode_on_arming(self, now_s: float) -> ModeChoice:
        """Return the mode that was chosen on the floor and takes effect on arming; "" if none."""
        since_s, choice = self._choice
        return choice if now_s - since_s <= MODE_CHOICE_TIMEOUT_S else ""

    def handle_command(self, now_s: float, station: MessageSource, message: MavMessage) -> None:
        """Execute a COMMAND_LONG or COMMAND_INT, and send its acknowledgement."""
        command = parse_command(message)
        if command.command_id in MESSAGE_REQUEST_COMMANDS:
            wishes = self._clients.mark_heard(now_s, station.peer).schedule
            result, answers = answer_message_request(now_s, command, wishes, self._origin is not None)
            self._send_ack(station, command.command_id, result)
            for answer in answers:
                self._clients.send_message(station.peer, answer)
        elif command.is_emergency_stop:
            # Never treated as a repetition: another station may have armed since. Waiting commands are discarded.
            self._held = None
            self._forget_mode_choice()
            self._execute_command(now_s, station, command)
        elif not self._authority.claim_command(now_s, station):
            self._send_ack(station, command.command_id, _RESULT_DENIED)
        elif (before := self._find_repeated_answer(now_s, station, command)) is not None:
            self._send_answer(station, command.command_id, before)
        elif self._stick_input.is_manual_mode and self._autopilot.status.sticks_active:
            # The flight software releases the sticks in its next step; only then it accepts another command.
            self._stick_input.release_sticks()
            self._held = (now_s + _STICK_RELEASE_TIMEOUT_S, station, command)
        else:
            self._execute_command(now_s, station, command)

    def execute_waiting_command(self, now_s: float) -> None:
        """Execute the command that waits for the release of the sticks, once they are released."""
        if self._held is not None:
            until_s, station, command = self._held
            if now_s >= until_s or self._autopilot.status.state != "rc":
                self._held = None
                self._execute_command(now_s, station, command)

    def handle_set_mode(self, now_s: float, station: MessageSource, m: MavMessage) -> None:
        """Process a SET_MODE, the older form of DO_SET_MODE."""
        if m.base_mode & mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED and self._authority.claim_command(now_s, station):
            answer = self._set_mode(now_s, Px4Mode(m.custom_mode >> 16 & 0xFF, m.custom_mode >> 24))
            self._send_answer(station, mavlink.MAV_CMD_DO_SET_MODE, answer)

    def handle_mission_set_current(self, now_s: float, station: MessageSource, m: MavMessage) -> None:
        """Process a MISSION_SET_CURRENT, the older form of DO_SET_MISSION_CURRENT; the answer is MISSION_CURRENT."""
        if self._authority.claim_command(now_s, station):
            self._clients.send_refusal(now_s, station, self._missions.set_current_item(float(m.seq)).reason)
            client = self._clients.find_client(station.peer)
            if client is not None:
                client.schedule.request_once(mavlink.MAVLINK_MSG_ID_MISSION_CURRENT)

    def _find_repeated_answer(self, now_s: float, station: MessageSource, command: Command) -> RequestAnswer | None:
        """Return the earlier answer if the command repeats a recently accepted one of this station; None otherwise."""
        known = self._last.get(station, OrderedDict())
        before, copy = known.get(command.identity_bytes), command.confirmation
        if before is None:
            return None
        waited_s, counted = now_s - before.last_heard_s, copy - before.confirmation
        if next(reversed(known)) == command.identity_bytes:
            repeated = waited_s <= (CONFIRMATION_WINDOW_S if copy else REPEAT_WINDOW_S)
        else:
            repeated = waited_s <= counted * MAX_CONFIRMATION_INTERVAL_S
        if not repeated:
            return None
        before.last_heard_s, before.confirmation = now_s, max(copy, before.confirmation)
        return before.answer

    def _execute_command(self, now_s: float, station: MessageSource, command: Command) -> None:
        action = COMMAND_HANDLERS.get(command.command_id)
        if action is None:
            entry = mavlink.enums["MAV_CMD"].get(command.command_id)
            name = f"command {command.command_id}" if entry is None else entry.name.removeprefix("MAV_CMD_")
            self._send_ack(station, command.command_id, _RESULT_UNSUPPORTED, f"{name} is not supported")
            return
        answer = action(self, now_s, command)
        known = self._last.setdefault(station, OrderedDict())
        known.pop(command.identity_bytes, None)
        if answer:
            known[command.identity_bytes] = _AcceptedCommand(now_s, command.confirmation, answer)
        while len(known) > _MAX_REMEMBERED_COMMANDS:
            known.popitem(last=False)
        self._last.move_to_end(station)
        while len(self._last) > _MAX_STATIONS:
            self._last.popitem(last=False)
        self._send_answer(station, command.command_id, answer)

    def _send_answer(self, station: MessageSource, number: int, answer: RequestAnswer) -> None:
        refused = mavlink.MAV_RESULT_TEMPORARILY_REJECTED if answer.is_temporary else _RESULT_DENIED
        self._send_ack(station, number, _RESULT_ACCEPTED if answer else refused, answer.reason)

    def _send_ack(self, station: MessageSource, number: int, result: int, reason: str = "") -> None:
        if reason:
            self._clients.send_text(reason, "info" if result == _RESULT_ACCEPTED else "warning", station.peer)
        self._clients.send_message(
            station.peer,
            mavlink.MAVLink_command_ack_message(number, result, 0, 0, station.system, station.component),
        )

    def _forget_mode_choice(self) -> None:
        self._choice = (-math.inf, "")

    # handlers of commands

    def _arm_or_disarm(self, now_s: float, command: Command) -> RequestAnswer:
        on = command.params[0]
        if on == 1.0:
            chosen = self.mode_on_arming(now_s)
            answer = self._autopilot.arm(repeated=command.confirmation > 0)
            self._forget_mode_choice()
            if not answer or not chosen:
                return answer
            begun = self._missions.start_mission() if chosen == "mission" else self._autopilot.take_off()
            return replace(answer, reason=begun.reason)
        if on == 0.0:
            return self._autopilot.disarm(force=command.is_emergency_stop)
        return deny_request(f"COMPONENT_ARM_DISARM with {on:g}: give 1 or 0")

    def _terminate_flight(self, now_s: float, command: Command) -> RequestAnswer:
        return self._autopilot.emergency_stop() if command.is_emergency_stop else REQUEST_ACCEPTED

    def _take_off(self, now_s: float, command: Command) -> RequestAnswer:
        z, origin = command.params[-1], self._origin
        if command.frame not in (None, 0, 1, 3, 4, 5, 6):
            return deny_request(f"frame {command.frame} is not supported for heights; use LOCAL_NED (1)")
        if math.isnan(z) or z == 0.0:
            return self._autopilot.take_off()
        if origin is not None and (
            command.frame in FRAMES_ABOVE_SEA
            or (
                command.frame is None and z > MAX_HEIGHT_M and MIN_WAYPOINT_HEIGHT_M <= z - origin.alt_m <= MAX_HEIGHT_M
            )
        ):
            z -= origin.alt_m
        return self._autopilot.take_off(-z if command.frame == 1 else z)

    def _take_off_local(self, now_s: float, command: Command) -> RequestAnswer:
        z = command.params[-1]
        return self._autopilot.take_off(None if math.isnan(z) or z == 0.0 else -z)

    def _do_reposition(self, now_s: float, command: Command) -> RequestAnswer:
        speed, _, _, heading, n, e, d = command.params
        frame, origin = command.frame, self._origin
        if all(map(math.isnan, (n, e, d))):  # QGroundControl's "pause" and "change heading"
            return self._set_mode(now_s, MODE_LOITER) if math.isnan(heading) else self._autopilot.turn_to(heading)
        if frame in LOCAL_FRAMES:
            if frame != 1:
                return deny_request(f"frame {frame} is not supported; use LOCAL_NED (1)")
        elif origin is None:
            return deny_request(
                "a global position needs a global origin; use LOCAL_NED (1), or set the vehicle's origin"
            )
        elif frame in (None, *FRAMES_ABOVE_SEA, *FRAMES_ABOVE_ORIGIN):
            n, e, d = origin.to_local(n, e, d, frame or 0)
        else:
            return deny_request(f"frame {frame} is not supported")
        here = self._autopilot.status.goal
        if here is not None:  # values not given keep the present ones
            n, e, d = (old if math.isnan(new) else new for old, new in zip(here, (n, e, d), strict=True))
        before = self._autopilot.parameters["LIM_SPEED"].value
        if speed > 0.0:
            answer = self._autopilot.set_speed(float(f"{speed:.7g}"))
            if not answer:
                return answer
        answer = self._autopilot.go_to((n, e, d), None if math.isnan(heading) else heading)
        if not answer and speed > 0.0:
            self._autopilot.set_speed(before)  # a refusal leaves nothing changed
        return answer

    def _pause_continue(self, now_s: float, command: Command) -> RequestAnswer:
        on = command.params[0]
        if on not in (0.0, 1.0):
            return deny_request(f"DO_PAUSE_CONTINUE with {on:g}: give 1 to continue or 0 to pause")
        return self._missions.start_mission() if on else self._set_mode(now_s, MODE_LOITER)

    def _start_mission(self, now_s: float, command: Command) -> RequestAnswer:
        first, last = command.params[:2]
        if 0.0 < last < len(self._missions.plan.items) - 1:
            return deny_request(f"a mission that ends with item {last:g} is not supported; give 0 for all items")
        return self._missions.start_mission(first)

    def _condition_yaw(self, now_s: float, command: Command) -> RequestAnswer:
        angle_deg, _, way, relative, *_ = command.params
        angle = math.radians(angle_deg)
        if relative not in (0.0, 1.0) and not math.isnan(relative):
            return deny_request(f"CONDITION_YAW with parameter 4 = {relative:g}: give 0 (absolute) or 1 (relative)")
        if relative == 1.0:
            now = self._autopilot.software.reference[2][2]
            signed = angle if way == 0.0 or math.isnan(way) else math.copysign(abs(angle), way)
            angle = float(now) + signed
        return self._autopilot.turn_to(angle)

    def _change_speed(self, now_s: float, command: Command) -> RequestAnswer:
        kind, speed = command.params[:2]
        if kind not in (0.0, 1.0):
            return deny_request(
                "only the horizontal speed (0, 1) can be changed; LIM_CLIMB and LIM_DESCENT are parameters"
            )
        answer = REQUEST_ACCEPTED if speed in (-1.0, -2.0) else self._autopilot.set_speed(float(f"{speed:.7g}"))
        return REQUEST_ACCEPTED if answer else answer

    def _do_set_mode(self, now_s: float, command: Command) -> RequestAnswer:
        base, main, sub = command.params[:3]
        if not (math.isfinite(base) and int(base) & mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED):
            return deny_request("only custom modes are supported (base mode 1)")
        if all(0.0 <= v < 256.0 for v in (main, sub)):
            return self._set_mode(now_s, Px4Mode(int(main), int(sub)))
        # pymavlink's set_mode packs all of a custom mode into one number.
        if not 0.0 <= main < 2**32:
            return deny_request(f"mode {main:g}, {sub:g} is not supported")
        return self._set_mode(now_s, unpack_custom_mode(int(main)))

    def _set_mode(self, now_s: float, mode: Px4Mode) -> RequestAnswer:
        """Request a PX4 flight mode; mission mode starts at the item set before by DO_SET_MISSION_CURRENT."""
        wanted, status, autopilot = action_for_mode(mode), self._autopilot.status, self._autopilot
        self._forget_mode_choice()
        if not status.armed and not status.flying and (wanted == "take-off" or wanted == "mission"):
            if wanted == "mission" and not autopilot.software.requested_mission.waypoint:
                return deny_request("no mission loaded; upload one first")
            self._choice = (now_s, wanted)
            return RequestAnswer(True, f"{wanted} after arming")
        if wanted == "hover" and (status.state == "init" or (status.state == "hover" and not status.mission_running)):
            return REQUEST_ACCEPTED  # programs request it before take-off; on the floor it holds anyway
        actions: dict[str, Callable[[], RequestAnswer]] = {
            "take-off": autopilot.take_off,
            "hover": autopilot.pause,
            "mission": self._missions.start_mission,
            "return": autopilot.return_home,
            "land": autopilot.land,
            "rc": lambda: self._stick_input.enter_manual_mode(now_s),
            "offboard": lambda: autopilot.set_offboard(True),
        }
        action = actions.get(wanted)
        return deny_request(f"mode {mode.main_mode}, {mode.sub_mode} is not supported") if action is None else action()

    def _inject_failure(self, now_s: float, command: Command) -> RequestAnswer:
        unit, kind, _, _, amount, duration_s, _ = command.params
        if kind == mavlink.FAILURE_TYPE_OK:
            self._flight.clear_faults()
            return REQUEST_ACCEPTED
        name, fault = FAILURE_NAMES[0].get(unit), FAILURE_NAMES[1].get(kind)
        if name is None or fault is None:
            return deny_request("units known here are " + ", ".join(FAILURE_NAMES[0].values()) + "; types 1 to 4, 6, 7")
        try:
            amount, lasts_s = (x if math.isfinite(x) and x != 0.0 else math.nan for x in (amount, duration_s))
            if lasts_s < 0.0:
                return deny_request(f"duration {lasts_s:g} s of a fault is out of range")
            stop_s = math.inf if math.isnan(lasts_s) else lasts_s
            self._flight.inject_fault(Fault(name, fault, stop_s=stop_s, amount=amount))
        except InputError as error:
            return deny_request(f"{error.problem}: {error.remedy}")
        return REQUEST_ACCEPTED

    def _reboot_autopilot(self, now_s: float, command: Command) -> RequestAnswer:
        if command.params[0] != 1.0:
            return deny_request("only parameter 1 = 1 (restart of the autopilot) is supported")
        status = self._autopilot.status
        if status.flying and not status.crash_cause:
            return reject_temporarily("it flies; land first")
        self._flight.reset()
        return REQUEST_ACCEPTED


FAILURE_NAMES: tuple[dict[float, str], dict[float, str]] = (
    dict(sorted(
        (getattr(mavlink, f"FAILURE_UNIT_{row.mavlink_failure_unit}"), row.fault)
        for row in READINGS.values() if row.mavlink_failure_unit
    )),
    {
        mavlink.FAILURE_TYPE_OFF: "dropout",
        mavlink.FAILURE_TYPE_STUCK: "freeze",
        mavlink.FAILURE_TYPE_GARBAGE: "insane",
        mavlink.FAILURE_TYPE_WRONG: "bias",
        mavlink.FAILURE_TYPE_DELAYED: "late",
        mavlink.FAILURE_TYPE_INTERMITTENT: "outliers",
    },
)  # fmt: skip
"""FAILURE_UNIT and FAILURE_TYPE by the names of :data:`mufly.sensors.FAULT_TARGETS` and
:data:`mufly.sensors.FAULT_KINDS`."""

COMMAND_HANDLERS: dict[int, Callable[[CommandProtocol, float, Command], RequestAnswer]] = {
    mavlink.MAV_CMD_COMPONENT_ARM_DISARM: CommandProtocol._arm_or_disarm,
    mavlink.MAV_CMD_DO_FLIGHTTERMINATION: CommandProtocol._terminate_flight,
    mavlink.MAV_CMD_NAV_TAKEOFF: CommandProtocol._take_off,
    mavlink.MAV_CMD_NAV_TAKEOFF_LOCAL: CommandProtocol._take_off_local,
    mavlink.MAV_CMD_NAV_LAND: lambda self, now_s, command: self._autopilot.land(),
    mavlink.MAV_CMD_DO_LAND_START: lambda self, now_s, command: self._autopilot.land(),
    mavlink.MAV_CMD_NAV_LAND_LOCAL: lambda self, now_s, command: self._autopilot.land(),
    mavlink.MAV_CMD_NAV_RETURN_TO_LAUNCH: lambda self, now_s, command: self._autopilot.return_home(),
    mavlink.MAV_CMD_DO_SET_MODE: CommandProtocol._do_set_mode,
    mavlink.MAV_CMD_DO_REPOSITION: CommandProtocol._do_reposition,
    mavlink.MAV_CMD_DO_PAUSE_CONTINUE: CommandProtocol._pause_continue,
    mavlink.MAV_CMD_CONDITION_YAW: CommandProtocol._condition_yaw,
    mavlink.MAV_CMD_DO_CHANGE_SPEED: CommandProtocol._change_speed,
    mavlink.MAV_CMD_DO_SET_MISSION_CURRENT: lambda self, now_s, command: self._missions.set_current_item(
        command.params[0]
    ),
    mavlink.MAV_CMD_MISSION_START: CommandProtocol._start_mission,
    mavlink.MAV_CMD_DO_SET_HOME: lambda self, now_s, command: deny_request(
        "home is the take-off position and cannot be changed"
    ),
    mavlink.MAV_CMD_INJECT_FAILURE: CommandProtocol._inject_failure,
    mavlink.MAV_CMD_PREFLIGHT_REBOOT_SHUTDOWN: CommandProtocol._reboot_autopilot,
}
"""Handlers of the commands; commands neither here nor in :data:`MESSAGE_REQUEST_COMMANDS` are answered as
unsupported."""

MESSAGE_REQUEST_COMMANDS: dict[int, int | None] = {
    mavlink.MAV_CMD_REQUEST_MESSAGE: None,
    mavlink.MAV_CMD_SET_MESSAGE_INTERVAL: None,
    mavlink.MAV_CMD_GET_MESSAGE_INTERVAL: None,
    mavlink.MAV_CMD_GET_HOME_POSITION: mavlink.MAVLINK_MSG_ID_HOME_POSITION,
    mavlink.MAV_CMD_REQUEST_AUTOPILOT_CAPABILITIES: mavlink.MAVLINK_MSG_ID_AUTOPILOT_VERSION,
}
"""Commands of every station that request a message or its rate, and the message (None: parameter 1)."""


def answer_message_request(
    now_s: float, command: Command, wishes: StreamSchedule, has_origin: bool
) -> tuple[int, list[MavMessage]]:
    """Execute a request for messages or their rates; return its result and the messages that answer it.

    Parameters
    ----------
    now_s : float
    command : Command
        One of :data:`MESSAGE_REQUEST_COMMANDS`.
    wishes : StreamSchedule
        Schedule of the peer that sent the command.
    has_origin : bool
        Whether there is a global origin.

    Returns
    -------
    result : int
        MAV_RESULT.
    messages : list
        Messages to send at once, before the scheduled ones.
    """
    first, second = command.params[:2]
    number = MESSAGE_REQUEST_COMMANDS[command.command_id]
    if number is None:
        number = int(first) if 0.0 <= first < 2**24 else -1
    messages = []
    if command.command_id == mavlink.MAV_CMD_SET_MESSAGE_INTERVAL:
        known = not math.isnan(second) and wishes.set_message_interval(now_s, number, second)
    elif command.command_id == mavlink.MAV_CMD_GET_MESSAGE_INTERVAL:
        known = wishes.is_streamable(number)
        told = number if 0 <= number < 65536 else 0
        messages = [mavlink.MAVLink_message_interval_message(told, wishes.interval_us(number))]
    elif number in ORIGIN_DEPENDENT_MESSAGE_IDS and not has_origin:
        return _RESULT_DENIED, []
    else:
        known = wishes.request_once(number)
    return _RESULT_ACCEPTED if known else _RESULT_UNSUPPORTED, messages
