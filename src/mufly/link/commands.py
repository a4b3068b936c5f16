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

from mufly.link.call import ACCEPTED, LOCAL_FRAMES, Call, Verdict, denied, refused, verdict_of
from mufly.link.controls import Controls
from mufly.link.dialect import mavlink
from mufly.link.modes import LOITER, mode_of_custom
from mufly.link.starting import arm_or_disarm, set_mode, start_at, start_mission
from mufly.mission import HIGHEST_M, LOWEST_M

__all__ = ["COMMANDS", "carry_out"]

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
