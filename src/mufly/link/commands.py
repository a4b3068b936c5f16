"""Commands: COMMAND_LONG and COMMAND_INT, what they ask of the autopilot, and what is answered.

:data:`COMMANDS` is the table. Every command gets one COMMAND_ACK; one that is refused also a line that says why. What
the parameters mean is said at https://mavlink.io/en/messages/common.html#mav_commands; what differs here:

* NAV_TAKEOFF: parameter 7 is the height above the floor (m); not a number, or 0: parameter MIS_TAKEOFF_ALT. With a
  global origin a number that only makes sense as an altitude above the sea is one. NAV_TAKEOFF_LOCAL: z, down.
* NAV_LAND lands where it is, NAV_RETURN_TO_LAUNCH above where it took off.
* DO_REPOSITION takes LOCAL_NED (frame 1) as well as, with an origin, the global frames. Without a place it stops, and
  turns if it gives a heading: QGroundControl's "pause" and "change heading".
* DO_LAND_START lands at once: there is no landing sequence to jump to. MAVProxy's "land" says this.
* DO_SET_MODE to take-off or mission, on the floor and not armed, is done when it is armed
  (:mod:`mufly.link.on_arming`).
* DO_FLIGHTTERMINATION, and disarming with the magic number 21196, stop the motors at once.
* PREFLIGHT_REBOOT_SHUTDOWN (1) puts the simulated helicopter back to its start.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

from mufly.link.call import FORCE, LOCAL_FRAMES, Call, Verdict
from mufly.link.dialect import mavlink
from mufly.link.geodesy import Origin
from mufly.link.modes import Mode, asked, mode_of_custom
from mufly.link.on_arming import OnArming
from mufly.link.sticks import Sticks
from mufly.mission import HIGHEST_M, LOWEST_M

if TYPE_CHECKING:
    from mufly.flight import Answer, Autopilot
    from mufly.link.mission_desk import MissionDesk

__all__ = ["COMMANDS", "Controls", "carry_out", "set_mode_or_start", "start_at"]

_ABOVE_SEA, _ABOVE_ORIGIN = (0, 5), (3, 6)
_CUSTOM_MODE = mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED


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


ACCEPTED = Verdict(mavlink.MAV_RESULT_ACCEPTED)


def carry_out(call: Call, c: Controls) -> Verdict:
    """Do what a command says; returns the verdict."""
    action = COMMANDS.get(call.number)
    if action is None:
        entry = mavlink.enums["MAV_CMD"].get(call.number)
        name = f"command {call.number}" if entry is None else entry.name.removeprefix("MAV_CMD_")
        return Verdict(mavlink.MAV_RESULT_UNSUPPORTED, f"{name} is not known here")
    return action(call, c)


def _set_other_mode(main: int, sub: int, c: Controls) -> Verdict:
    wanted = asked(Mode(main, sub))
    if wanted == "rc":
        answer = c.sticks.by_hand(c.now_s)
        if isinstance(answer, str):
            return _refused(answer) if answer else ACCEPTED
        return _verdict(answer)
    autopilot = c.autopilot
    todo: dict[str, Callable[[], Answer]] = {
        "take-off": autopilot.take_off,
        "hover": autopilot.pause,
        "mission": autopilot.start_mission,
        "return": autopilot.return_home,
        "land": autopilot.land,
        "offboard": lambda: autopilot.offboard(True),
    }
    action = todo.get(wanted)
    if action is None:
        return _denied(f"mode {main}, {sub} is not known here")
    status = autopilot.status
    if wanted == "hover" and (
        status.state == "init" or (status.state == "hover" and not status.mission_running)
    ):
        return ACCEPTED  # programs ask for it before take-off; on the floor it holds anyway
    return _verdict(action())


def _verdict(answer: Answer) -> Verdict:
    if answer:
        return ACCEPTED
    return _refused(answer.reason) if answer.temporary else _denied(answer.reason)


def _refused(why: str) -> Verdict:
    return Verdict(mavlink.MAV_RESULT_TEMPORARILY_REJECTED, why)


def _denied(why: str) -> Verdict:
    return Verdict(mavlink.MAV_RESULT_DENIED, why)


def _arm(call: Call, c: Controls) -> Verdict:
    on, magic = call.p[0], call.p[1]
    if on == 1.0:
        chosen = c.on_arming.chosen(c.now_s)
        verdict = _verdict(c.autopilot.arm())
        c.on_arming.choose(c.now_s, "")
        if verdict != ACCEPTED or not chosen:
            return verdict
        begun = start_mission(c) if chosen == "mission" else _verdict(c.autopilot.take_off())
        return Verdict(verdict.result, begun.reason)
    if on == 0.0:
        return _verdict(c.autopilot.disarm(force=magic == FORCE))
    return _denied(f"COMPONENT_ARM_DISARM with {on:g}: give 1 or 0")


def _terminate(call: Call, c: Controls) -> Verdict:
    return _verdict(c.autopilot.emergency_stop()) if call.p[0] > 0.5 else ACCEPTED


def _take_off(call: Call, c: Controls) -> Verdict:
    z = call.p[6]
    if math.isnan(z) or z == 0.0:
        return _verdict(c.autopilot.take_off())
    above_sea = c.origin is not None and (
        call.frame in _ABOVE_SEA
        or (call.frame is None and z > HIGHEST_M and LOWEST_M <= z - c.origin.alt_m <= HIGHEST_M)
    )
    if above_sea and c.origin is not None:
        z -= c.origin.alt_m
    return _verdict(c.autopilot.take_off(-z if call.frame == 1 else z))


def _take_off_local(call: Call, c: Controls) -> Verdict:
    z = call.p[6]
    return _verdict(c.autopilot.take_off(None if math.isnan(z) or z == 0.0 else -z))


def _reposition(call: Call, c: Controls) -> Verdict:
    here = c.autopilot.status.goal
    n, e, d = call.p[4], call.p[5], call.p[6]
    if all(map(math.isnan, (n, e, d))):  # QGroundControl's "pause" and "change heading"
        return (
            set_mode_or_start(4, 3, c) if math.isnan(call.p[3]) else _verdict(c.autopilot.turn_to(call.p[3]))
        )
    if call.frame in LOCAL_FRAMES:
        if call.frame != 1:
            return _denied(f"frame {call.frame} is not known here; use LOCAL_NED (1)")
    elif c.origin is None:
        return _denied(
            "a place on the globe needs a global origin; use LOCAL_NED (1), or start with --origin"
        )
    elif call.frame in (None, *_ABOVE_SEA, *_ABOVE_ORIGIN):
        height = d
        n, e, d = c.origin.to_local(n, e, d)
        if call.frame in _ABOVE_ORIGIN:
            d = -height
    else:
        return _denied(f"frame {call.frame} is not known here")
    if here is not None:  # what is not given stays as it is
        n, e, d = (old if math.isnan(new) else new for old, new in zip(here, (n, e, d), strict=True))
    before = c.autopilot.parameters["LIM_SPEED"].value
    if call.p[0] > 0.0:
        answer = c.autopilot.set_speed(float(f"{call.p[0]:.7g}"))
        if not answer:
            return _verdict(answer)
    heading = None if math.isnan(call.p[3]) else call.p[3]
    answer = c.autopilot.go_to((n, e, d), heading)
    if not answer and call.p[0] > 0.0:
        c.autopilot.set_speed(before)  # refused is refused whole
    return _verdict(answer)


def _pause_continue(call: Call, c: Controls) -> Verdict:
    return start_mission(c) if call.p[0] == 1.0 else set_mode_or_start(4, 3, c)


def _yaw(call: Call, c: Controls) -> Verdict:
    angle = math.radians(call.p[0])
    if call.p[3] == 1.0:
        now = c.autopilot.software.reference[2][2]
        angle = float(now) + math.copysign(angle, call.p[2] if call.p[2] else 1.0)
    return _verdict(c.autopilot.turn_to(angle))


def _speed(call: Call, c: Controls) -> Verdict:
    kind, speed = call.p[0], call.p[1]
    if kind not in (0.0, 1.0):
        return _denied(
            "only the horizontal speed (0, 1) can be changed; LIM_CLIMB and LIM_DESCENT are parameters"
        )
    if speed in (-1.0, -2.0):
        return ACCEPTED
    return _verdict(c.autopilot.set_speed(float(f"{speed:.7g}")))


def _current_item(call: Call, c: Controls) -> Verdict:
    return start_at(call.p[0], c)


def start_at(item: float, c: Controls) -> Verdict:
    """Go on with item ``item`` of the mission; on the floor, begin with it once the mission is started."""
    first = c.desk.jump(int(item)) if item >= 0.0 and item < 65535.0 else None
    if first is None:
        return _denied(f"the mission has no waypoint from item {item:g} on")
    if c.autopilot.status.state == "init":
        c.desk.first = int(item)
        return ACCEPTED
    verdict = _verdict(c.autopilot.start_mission(first))
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
        return _verdict(answer)
    if c.autopilot.status.mission_running:
        return ACCEPTED
    return _verdict(c.autopilot.start_mission())


def _mission_start(call: Call, c: Controls) -> Verdict:
    if call.p[0] > 0.0:
        c.desk.first = int(min(call.p[0], 65535.0))
        if c.desk.jump(c.desk.first) is None:
            c.desk.first = 0
            return _denied(f"the mission has no waypoint from item {call.p[0]:g} on")
    return start_mission(c)


def _set_mode(call: Call, c: Controls) -> Verdict:
    base, main, sub = call.p[:3]
    if not (math.isfinite(base) and int(base) & _CUSTOM_MODE):
        return _denied("only custom modes are known here (base mode 1)")
    if not all(0.0 <= v < 256.0 for v in (main, sub)):
        # pymavlink's set_mode packs all of a custom mode into one number.
        if not 0.0 <= main < 2**32:
            return _denied(f"mode {main:g}, {sub:g} is not known here")
        main, sub = mode_of_custom(int(main))
    return set_mode_or_start(int(main), int(sub), c)


def set_mode_or_start(main: int, sub: int, c: Controls) -> Verdict:
    """Do what a flight mode of PX4 stands for; the mission begins with the item that was asked for before."""
    wanted, status = asked(Mode(main, sub)), c.autopilot.status
    c.on_arming.choose(c.now_s, "")
    if not status.armed and not status.flying and (wanted == "take-off" or wanted == "mission"):
        if wanted == "mission" and not status.mission.waypoint:
            return _denied("no mission loaded; upload one first")
        c.on_arming.choose(c.now_s, wanted)
        return Verdict(mavlink.MAV_RESULT_ACCEPTED, f"{wanted} once it is armed")
    return start_mission(c) if asked(Mode(main, sub)) == "mission" else _set_other_mode(main, sub, c)


def _home(call: Call, c: Controls) -> Verdict:
    return _denied("home is where it took off; it cannot be moved")


def _reboot(call: Call, c: Controls) -> Verdict:
    if call.p[0] != 1.0:
        return _denied("only 1 (the autopilot anew) is known here")
    status = c.autopilot.status
    if status.flying and not status.crashed:
        return _refused("it flies; land first")
    c.reset()
    return ACCEPTED


COMMANDS: dict[int, Callable[[Call, Controls], Verdict]] = {
    mavlink.MAV_CMD_COMPONENT_ARM_DISARM: _arm,
    mavlink.MAV_CMD_DO_FLIGHTTERMINATION: _terminate,
    mavlink.MAV_CMD_NAV_TAKEOFF: _take_off,
    mavlink.MAV_CMD_NAV_TAKEOFF_LOCAL: _take_off_local,
    mavlink.MAV_CMD_NAV_LAND: lambda call, c: _verdict(c.autopilot.land()),
    mavlink.MAV_CMD_DO_LAND_START: lambda call, c: _verdict(c.autopilot.land()),
    mavlink.MAV_CMD_NAV_LAND_LOCAL: lambda call, c: _verdict(c.autopilot.land()),
    mavlink.MAV_CMD_NAV_RETURN_TO_LAUNCH: lambda call, c: _verdict(c.autopilot.return_home()),
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
