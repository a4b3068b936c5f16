"""One command and its verdict: what COMMAND_LONG and COMMAND_INT have in common."""

from __future__ import annotations

import math
import struct
from collections import OrderedDict
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

from mufly.link.authority import Bridge
from mufly.link.clients import Sender, Voice, Wishes
from mufly.link.codec import MavMessage, mavlink
from mufly.link.conventions import LOITER, Mode, OnArming, Origin, asked, mode_of_custom
from mufly.link.set_points import Sticks
from mufly.mission import HIGHEST_M, LOWEST_M

if TYPE_CHECKING:
    from mufly.flight import Answer, Autopilot
    from mufly.link.missions import MissionDesk

FORCE = 21196.0
"""The magic number of COMPONENT_ARM_DISARM that stops the motors in flight."""

LOCAL_FRAMES = (1, 4, 7, 8, 9, 12)
"""Values of MAV_FRAME in metres."""
_NOT_GIVEN = 2**31 - 1


@dataclass(frozen=True, slots=True)
class Call:
    """One command.

    Attributes
    ----------
    number : int
        MAV_CMD.
    p : tuple of 7 floats
        Its parameters; 5 and 6 in degrees or metres; NaN where not given.
    frame : int or None
        MAV_FRAME of a COMMAND_INT.
    confirmation : int
        Above 0: a repetition.
    """

    number: int
    p: tuple[float, ...]
    frame: int | None
    confirmation: int = 0


@dataclass(frozen=True, slots=True)
class Verdict:
    """What to acknowledge (MAV_RESULT), and why, in words."""

    result: int
    reason: str = ""


ACCEPTED = Verdict(mavlink.MAV_RESULT_ACCEPTED)


def verdict_of(answer: Answer) -> Verdict:
    """The autopilot's answer as a verdict."""
    if answer:
        return ACCEPTED
    return refused(answer.reason) if answer.temporary else denied(answer.reason)


def refused(why: str) -> Verdict:
    """Not now."""
    return Verdict(mavlink.MAV_RESULT_TEMPORARILY_REJECTED, why)


def denied(why: str) -> Verdict:
    """Not at all."""
    return Verdict(mavlink.MAV_RESULT_DENIED, why)


def call_of(message: MavMessage) -> Call:
    """Return the command of a COMMAND_LONG or COMMAND_INT."""
    m = message
    first = (m.param1, m.param2, m.param3, m.param4)
    if m.get_type() == "COMMAND_LONG":
        return Call(m.command, (*first, m.param5, m.param6, m.param7), None, m.confirmation)
    scale = 1e-4 if m.frame in LOCAL_FRAMES else 1e-7
    x, y = (math.nan if v == _NOT_GIVEN else v * scale for v in (m.x, m.y))
    return Call(m.command, (*first, x, y, m.z), m.frame)


def from_anyone(call: Call) -> bool:
    """Whether a command is an emergency stop, which anyone may give."""
    if call.number == mavlink.MAV_CMD_DO_FLIGHTTERMINATION:
        return call.p[0] > 0.5
    return call.number == mavlink.MAV_CMD_COMPONENT_ARM_DISARM and call.p[0] == 0.0 and call.p[1] == FORCE


# ----------------------------------------------------------------------------
# What commands act on.


@dataclass(frozen=True)
class Controls:
    """What commands act on.

    Attributes
    ----------
    autopilot : Autopilot
    desk : MissionDesk
    sticks : Sticks
    on_arming : OnArming
    origin : Origin or None
    reset : callable
        Puts a simulation back to its start.
    now_s : float
    """

    autopilot: Autopilot
    desk: MissionDesk
    sticks: Sticks
    on_arming: OnArming
    origin: Origin | None
    reset: Callable[[], None]
    now_s: float


# ----------------------------------------------------------------------------
# Commands that only ask: a message once, a message at a rate, the rate of a message. Anyone may.
#
# ======================================  =======================================
# REQUEST_MESSAGE (512)                   the message with id parameter 1, once
# SET_MESSAGE_INTERVAL (511)              parameter 1: id, parameter 2: us
# GET_MESSAGE_INTERVAL (510)              MESSAGE_INTERVAL of id parameter 1
# GET_HOME_POSITION (410)                 HOME_POSITION
# REQUEST_AUTOPILOT_CAPABILITIES (520)    AUTOPILOT_VERSION
# ======================================  =======================================


_GLOBAL = (
    mavlink.MAVLINK_MSG_ID_HOME_POSITION,
    mavlink.MAVLINK_MSG_ID_GPS_GLOBAL_ORIGIN,
    mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT,
    mavlink.MAVLINK_MSG_ID_GPS_RAW_INT,
)
ENQUIRIES = (
    mavlink.MAV_CMD_REQUEST_MESSAGE,
    mavlink.MAV_CMD_SET_MESSAGE_INTERVAL,
    mavlink.MAV_CMD_GET_MESSAGE_INTERVAL,
    mavlink.MAV_CMD_GET_HOME_POSITION,
    mavlink.MAV_CMD_REQUEST_AUTOPILOT_CAPABILITIES,
)
"""The commands of this table."""


def enquire(now_s: float, call: Call, wishes: Wishes, has_origin: bool) -> tuple[Verdict, list[MavMessage]]:
    """Answer one.

    Parameters
    ----------
    now_s : float
    call : Call
    wishes : Wishes
        Of the peer that asks.
    has_origin : bool
        Whether there is anything to tell about the globe.

    Returns
    -------
    verdict : Verdict
    messages : list
        To be sent at once, before those that the wishes hold.
    """
    accepted = Verdict(mavlink.MAV_RESULT_ACCEPTED)
    if call.number == mavlink.MAV_CMD_GET_HOME_POSITION:
        number = mavlink.MAVLINK_MSG_ID_HOME_POSITION
    elif call.number == mavlink.MAV_CMD_REQUEST_AUTOPILOT_CAPABILITIES:
        number = mavlink.MAVLINK_MSG_ID_AUTOPILOT_VERSION
    else:
        number = int(call.p[0]) if 0.0 <= call.p[0] < 2**24 else -1
    if call.number == mavlink.MAV_CMD_SET_MESSAGE_INTERVAL:
        known = not math.isnan(call.p[1]) and wishes.set_interval(now_s, number, call.p[1])
        return (accepted if known else Verdict(mavlink.MAV_RESULT_UNSUPPORTED)), []
    if call.number == mavlink.MAV_CMD_GET_MESSAGE_INTERVAL:
        known = wishes.known(number)
        answer = mavlink.MAVLink_message_interval_message(
            number if 0 <= number < 65536 else 0, wishes.interval_us(number)
        )
        return (accepted if known else Verdict(mavlink.MAV_RESULT_UNSUPPORTED)), [answer]
    if number in _GLOBAL and not has_origin:
        return Verdict(mavlink.MAV_RESULT_DENIED), []
    return (accepted if wishes.ask_once(number) else Verdict(mavlink.MAV_RESULT_UNSUPPORTED)), []


# ----------------------------------------------------------------------------
# Commands that come twice: programs repeat a command until they hear its acknowledgement.
#
# The same command with the same parameters from the same station, within :data:`REPEAT_S` of the time before (or
# marked
# as a repetition by its ``confirmation``, within :data:`CONFIRMED_S`), is answered as before and not carried out
# again,
# if it was accepted. One that was refused is judged anew: whoever asks again may have done something about it. An
# emergency stop is always carried out (:mod:`mufly.link.commands`).


REPEAT_S = 0.8
"""Programs repeat after half a second (MAVSDK) or more; two presses of a key are further apart than this (s)."""
CONFIRMED_S = 10.0
_STATIONS = 32
_PARAMETERS = struct.Struct("<7d")


class Repeats:
    """Remembers the last command of each station."""

    def __init__(self) -> None:
        self._last: OrderedDict[Sender, tuple[float, int, bytes, Verdict]] = OrderedDict()

    def before(self, now_s: float, sender: Sender, call: Call) -> Verdict | None:
        """Return how a command was answered, if it is a repetition of one that was accepted."""
        last = self._last.get(sender)
        if last is None:
            return None
        when_s, number, parameters, verdict = last
        within_s = CONFIRMED_S if call.confirmation else REPEAT_S
        same = number == call.number and parameters == _PARAMETERS.pack(*call.p)
        if not same or now_s - when_s > within_s or verdict.result != mavlink.MAV_RESULT_ACCEPTED:
            return None
        self._last[sender] = (now_s, number, parameters, verdict)
        return verdict

    def note(self, now_s: float, sender: Sender, call: Call, verdict: Verdict) -> None:
        """Remember the answer to a command."""
        self._last[sender] = (now_s, call.number, _PARAMETERS.pack(*call.p), verdict)
        self._last.move_to_end(sender)
        while len(self._last) > _STATIONS:
            self._last.popitem(last=False)


# ----------------------------------------------------------------------------
# Commands that start something: arming, flight modes, the mission and its items.


def arm_or_disarm(call: Call, c: Controls) -> Verdict:
    """COMPONENT_ARM_DISARM; what was chosen before arming begins with it."""
    on, magic = call.p[0], call.p[1]
    if on == 1.0:
        chosen = c.on_arming.chosen(c.now_s)
        verdict = verdict_of(c.autopilot.arm())
        c.on_arming.choose(c.now_s, "")
        if verdict != ACCEPTED or not chosen:
            return verdict
        begun = start_mission(c) if chosen == "mission" else verdict_of(c.autopilot.take_off())
        return Verdict(verdict.result, begun.reason)
    if on == 0.0:
        return verdict_of(c.autopilot.disarm(force=magic == FORCE))
    return denied(f"COMPONENT_ARM_DISARM with {on:g}: give 1 or 0")


def set_mode(main: int, sub: int, c: Controls) -> Verdict:
    """Do what a flight mode of PX4 stands for; the mission begins with the item that was asked for before."""
    wanted, status, autopilot = asked(Mode(main, sub)), c.autopilot.status, c.autopilot
    c.on_arming.choose(c.now_s, "")
    if not status.armed and not status.flying and (wanted == "take-off" or wanted == "mission"):
        if wanted == "mission" and not status.mission.waypoint:
            return denied("no mission loaded; upload one first")
        c.on_arming.choose(c.now_s, wanted)
        return Verdict(mavlink.MAV_RESULT_ACCEPTED, f"{wanted} once it is armed")
    if wanted == "mission":
        return start_mission(c)
    if wanted == "rc":
        answer = c.sticks.by_hand(c.now_s)
        if isinstance(answer, str):
            return refused(answer) if answer else ACCEPTED
        return verdict_of(answer)
    if wanted == "hover" and (
        status.state == "init" or (status.state == "hover" and not status.mission_running)
    ):
        return ACCEPTED  # programs ask for it before take-off; on the floor it holds anyway
    actions: dict[str, Callable[[], Answer]] = {
        "take-off": autopilot.take_off,
        "hover": autopilot.pause,
        "return": autopilot.return_home,
        "land": autopilot.land,
        "offboard": lambda: autopilot.offboard(True),
    }
    action = actions.get(wanted)
    return denied(f"mode {main}, {sub} is not known here") if action is None else verdict_of(action())


def start_at(item: float, c: Controls) -> Verdict:
    """Go on with item ``item`` of the mission; on the floor, begin with it once the mission is started."""
    first = c.desk.jump(int(item)) if item >= 0.0 and item < 65535.0 else None
    if first is None:
        return denied(f"the mission has no waypoint from item {item:g} on")
    if c.autopilot.status.state == "init":
        c.desk.first = int(item)
        return ACCEPTED
    verdict = verdict_of(c.autopilot.start_mission(first))
    if verdict == ACCEPTED:
        c.desk.begin_at(int(item))
    return verdict


def start_mission(c: Controls) -> Verdict:
    """Start the mission, or go on with it."""
    item = c.desk.first
    if item:
        answer = c.autopilot.start_mission(c.desk.jump(item))
        if answer:
            c.desk.begin_at(item)
        return verdict_of(answer)
    if c.autopilot.status.mission_running:
        return ACCEPTED
    return verdict_of(c.autopilot.start_mission())


# ----------------------------------------------------------------------------
# Commands: COMMAND_LONG and COMMAND_INT, what they ask of the autopilot, and what is answered.
#
# :data:`COMMANDS` is the table. Every command gets one COMMAND_ACK; one that is refused also a line that says why.
# What
# the parameters mean is said at https://mavlink.io/en/messages/common.html#mav_commands; what differs here:
#
# * NAV_TAKEOFF: parameter 7 is the height above the floor (m); not a number, or 0: parameter MIS_TAKEOFF_ALT. With a
#   global origin a number that only makes sense as an altitude above the sea is one. NAV_TAKEOFF_LOCAL: z, down.
# * NAV_LAND lands where it is, NAV_RETURN_TO_LAUNCH above where it took off.
# * DO_REPOSITION takes LOCAL_NED (frame 1) as well as, with an origin, the global frames. Without a place it stops,
# and
#   turns if it gives a heading: QGroundControl's "pause" and "change heading".
# * DO_LAND_START lands at once: there is no landing sequence to jump to. MAVProxy's "land" says this.
# * DO_SET_MODE to take-off or mission, on the floor and not armed, is done when it is armed
#   (:mod:`mufly.link.conventions`).
# * DO_FLIGHTTERMINATION, and disarming with the magic number 21196, stop the motors at once.
# * PREFLIGHT_REBOOT_SHUTDOWN (1) puts the simulated helicopter back to its start.


_ABOVE_SEA, _ABOVE_ORIGIN = (0, 5), (3, 6)
_CUSTOM_MODE = mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED


def carry_out(call: Call, c: Controls) -> Verdict:
    """Do what a command says; returns the verdict."""
    action = COMMANDS.get(call.number)
    if action is None:
        entry = mavlink.enums["MAV_CMD"].get(call.number)
        name = f"command {call.number}" if entry is None else entry.name.removeprefix("MAV_CMD_")
        return Verdict(mavlink.MAV_RESULT_UNSUPPORTED, f"{name} is not known here")
    return action(call, c)


def _terminate(call: Call, c: Controls) -> Verdict:
    return verdict_of(c.autopilot.emergency_stop()) if call.p[0] > 0.5 else ACCEPTED


def _take_off(call: Call, c: Controls) -> Verdict:
    z = call.p[6]
    if math.isnan(z) or z == 0.0:
        return verdict_of(c.autopilot.take_off())
    above_sea = c.origin is not None and (
        call.frame in _ABOVE_SEA
        or (call.frame is None and z > HIGHEST_M and LOWEST_M <= z - c.origin.alt_m <= HIGHEST_M)
    )
    if above_sea and c.origin is not None:
        z -= c.origin.alt_m
    return verdict_of(c.autopilot.take_off(-z if call.frame == 1 else z))


def _take_off_local(call: Call, c: Controls) -> Verdict:
    z = call.p[6]
    return verdict_of(c.autopilot.take_off(None if math.isnan(z) or z == 0.0 else -z))


def _reposition(call: Call, c: Controls) -> Verdict:
    here = c.autopilot.status.goal
    n, e, d = call.p[4], call.p[5], call.p[6]
    if all(map(math.isnan, (n, e, d))):  # QGroundControl's "pause" and "change heading"
        return set_mode(*LOITER, c) if math.isnan(call.p[3]) else verdict_of(c.autopilot.turn_to(call.p[3]))
    if call.frame in LOCAL_FRAMES:
        if call.frame != 1:
            return denied(f"frame {call.frame} is not known here; use LOCAL_NED (1)")
    elif c.origin is None:
        return denied("a place on the globe needs a global origin; use LOCAL_NED (1), or start with --origin")
    elif call.frame in (None, *_ABOVE_SEA, *_ABOVE_ORIGIN):
        height = d
        n, e, d = c.origin.to_local(n, e, d)
        if call.frame in _ABOVE_ORIGIN:
            d = -height
    else:
        return denied(f"frame {call.frame} is not known here")
    if here is not None:  # what is not given stays as it is
        n, e, d = (old if math.isnan(new) else new for old, new in zip(here, (n, e, d), strict=True))
    before = c.autopilot.parameters["LIM_SPEED"].value
    if call.p[0] > 0.0:
        answer = c.autopilot.set_speed(float(f"{call.p[0]:.7g}"))
        if not answer:
            return verdict_of(answer)
    heading = None if math.isnan(call.p[3]) else call.p[3]
    answer = c.autopilot.go_to((n, e, d), heading)
    if not answer and call.p[0] > 0.0:
        c.autopilot.set_speed(before)  # refused is refused whole
    return verdict_of(answer)


def _pause_continue(call: Call, c: Controls) -> Verdict:
    return start_mission(c) if call.p[0] == 1.0 else set_mode(*LOITER, c)


def _yaw(call: Call, c: Controls) -> Verdict:
    angle = math.radians(call.p[0])
    if call.p[3] == 1.0:
        now = c.autopilot.software.reference[2][2]
        angle = float(now) + math.copysign(angle, call.p[2] if call.p[2] else 1.0)
    return verdict_of(c.autopilot.turn_to(angle))


def _speed(call: Call, c: Controls) -> Verdict:
    kind, speed = call.p[0], call.p[1]
    if kind not in (0.0, 1.0):
        return denied(
            "only the horizontal speed (0, 1) can be changed; LIM_CLIMB and LIM_DESCENT are parameters"
        )
    if speed in (-1.0, -2.0):
        return ACCEPTED
    return verdict_of(c.autopilot.set_speed(float(f"{speed:.7g}")))


def _current_item(call: Call, c: Controls) -> Verdict:
    return start_at(call.p[0], c)


def _mission_start(call: Call, c: Controls) -> Verdict:
    if call.p[0] > 0.0:
        c.desk.first = int(min(call.p[0], 65535.0))
        if c.desk.jump(c.desk.first) is None:
            c.desk.first = 0
            return denied(f"the mission has no waypoint from item {call.p[0]:g} on")
    return start_mission(c)


def _set_mode(call: Call, c: Controls) -> Verdict:
    base, main, sub = call.p[:3]
    if not (math.isfinite(base) and int(base) & _CUSTOM_MODE):
        return denied("only custom modes are known here (base mode 1)")
    if not all(0.0 <= v < 256.0 for v in (main, sub)):
        # pymavlink's set_mode packs all of a custom mode into one number.
        if not 0.0 <= main < 2**32:
            return denied(f"mode {main:g}, {sub:g} is not known here")
        main, sub = mode_of_custom(int(main))
    return set_mode(int(main), int(sub), c)


def _home(call: Call, c: Controls) -> Verdict:
    return denied("home is where it took off; it cannot be moved")


def _reboot(call: Call, c: Controls) -> Verdict:
    if call.p[0] != 1.0:
        return denied("only 1 (the autopilot anew) is known here")
    status = c.autopilot.status
    if status.flying and not status.crashed:
        return refused("it flies; land first")
    c.reset()
    return ACCEPTED


COMMANDS: dict[int, Callable[[Call, Controls], Verdict]] = {
    mavlink.MAV_CMD_COMPONENT_ARM_DISARM: arm_or_disarm,
    mavlink.MAV_CMD_DO_FLIGHTTERMINATION: _terminate,
    mavlink.MAV_CMD_NAV_TAKEOFF: _take_off,
    mavlink.MAV_CMD_NAV_TAKEOFF_LOCAL: _take_off_local,
    mavlink.MAV_CMD_NAV_LAND: lambda call, c: verdict_of(c.autopilot.land()),
    mavlink.MAV_CMD_DO_LAND_START: lambda call, c: verdict_of(c.autopilot.land()),
    mavlink.MAV_CMD_NAV_LAND_LOCAL: lambda call, c: verdict_of(c.autopilot.land()),
    mavlink.MAV_CMD_NAV_RETURN_TO_LAUNCH: lambda call, c: verdict_of(c.autopilot.return_home()),
    mavlink.MAV_CMD_DO_SET_MODE: _set_mode,
    mavlink.MAV_CMD_DO_REPOSITION: _reposition,
    mavlink.MAV_CMD_DO_PAUSE_CONTINUE: _pause_continue,
    mavlink.MAV_CMD_CONDITION_YAW: _yaw,
    mavlink.MAV_CMD_DO_CHANGE_SPEED: _speed,
    mavlink.MAV_CMD_DO_SET_MISSION_CURRENT: _current_item,
    mavlink.MAV_CMD_MISSION_START: _mission_start,
    mavlink.MAV_CMD_DO_SET_HOME: _home,
    mavlink.MAV_CMD_PREFLIGHT_REBOOT_SHUTDOWN: _reboot,
}
"""What each command does; the rest is answered as not supported."""


# ----------------------------------------------------------------------------
# Who takes commands in: may the station, did it say so before, what comes of it, and the acknowledgement.


_HOLD_S = 0.3


class CommandDesk:
    """Takes COMMAND_LONG, COMMAND_INT and the messages that say the same: SET_MODE, MISSION_SET_CURRENT.

    Parameters
    ----------
    voice : Voice
    bridge : Bridge
    controls : callable
        Time (s) -> what commands act on.
    """

    def __init__(self, voice: Voice, bridge: Bridge, controls: Callable[[float], Controls]) -> None:
        self._voice, self._bridge, self._controls = voice, bridge, controls
        self._repeats = Repeats()
        self._held: tuple[float, Sender, Call] | None = None

    def command(self, now_s: float, sender: Sender, message: MavMessage) -> None:
        """Take a COMMAND_LONG or COMMAND_INT."""
        call, c = call_of(message), self._controls(now_s)
        if call.number in ENQUIRIES:
            client = self._voice.clients.hear(now_s, sender.peer)
            verdict, answers = enquire(now_s, call, client.wishes, c.origin is not None)
            self._acknowledge(sender, call, verdict)
            for answer in answers:
                self._voice.send(sender.peer, answer)
            return
        if from_anyone(call):
            # Never taken for a repetition: somebody may have armed it in between. What waits is not done after it.
            self._held = None
            c.on_arming.choose(now_s, "")
            self._carry_out(sender, call, c)
            return
        if not self._bridge.may(now_s, sender):
            self._acknowledge(sender, call, Verdict(mavlink.MAV_RESULT_DENIED))
            return
        before = self._repeats.before(now_s, sender, call)
        if before is not None:
            self._acknowledge(sender, call, before)
        elif c.sticks.by_mode and c.autopilot.status.sticks:
            # The flight software lets go of the sticks in its next step, and only then hears another command.
            c.sticks.off()
            self._held = (now_s + _HOLD_S, sender, call)
        else:
            self._carry_out(sender, call, c)

    def step(self, now_s: float) -> None:
        """Carry out what had to wait."""
        if self._held is None:
            return
        until_s, sender, call = self._held
        c = self._controls(now_s)
        if now_s >= until_s or c.autopilot.status.state != "rc":
            self._held = None
            self._carry_out(sender, call, c)

    def set_mode(self, now_s: float, sender: Sender, m: MavMessage) -> None:
        """Take a SET_MODE, the older form of DO_SET_MODE."""
        if m.base_mode & mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED and self._bridge.may(now_s, sender):
            main, sub = m.custom_mode >> 16 & 0xFF, m.custom_mode >> 24
            verdict = set_mode(main, sub, self._controls(now_s))
            self._acknowledge(sender, Call(mavlink.MAV_CMD_DO_SET_MODE, (0.0,) * 7, None), verdict)

    def set_current(self, now_s: float, sender: Sender, m: MavMessage) -> None:
        """Take a MISSION_SET_CURRENT, the older form of DO_SET_MISSION_CURRENT; answered by MISSION_CURRENT."""
        if self._bridge.may(now_s, sender):
            verdict = start_at(float(m.seq), self._controls(now_s))
            self._voice.tell(now_s, sender, verdict.reason)
            client = self._voice.clients.get(sender.peer)
            if client is not None:
                client.wishes.ask_once(mavlink.MAVLINK_MSG_ID_MISSION_CURRENT)

    def _carry_out(self, sender: Sender, call: Call, c: Controls) -> None:
        verdict = carry_out(call, c)
        self._repeats.note(c.now_s, sender, call, verdict)
        self._acknowledge(sender, call, verdict)

    def _acknowledge(self, sender: Sender, call: Call, verdict: Verdict) -> None:
        if verdict.reason:
            level = "info" if verdict.result == mavlink.MAV_RESULT_ACCEPTED else "warning"
            self._voice.say(verdict.reason, level, sender.peer)
        self._voice.send(
            sender.peer,
            mavlink.MAVLink_command_ack_message(
                call.number, verdict.result, 0, 0, sender.system, sender.component
            ),
        )
