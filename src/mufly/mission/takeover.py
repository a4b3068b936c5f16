"""Somebody else flies: the pilot's sticks (the thesis's state RC), or the set-points of a program (offboard).

As in :mod:`mufly.mission.user`, every function takes a state and returns the next one.
"""

from __future__ import annotations

import math
from dataclasses import replace

from mufly.mission.avoidance import BRAKE_M_S2
from mufly.mission.offboard import SetPoint, begin_tracking, fault_of, follow, wants_up
from mufly.mission.phases import measured_at
from mufly.mission.plan import SPIN_UP_S
from mufly.mission.reference import onward, point
from mufly.mission.sight import hold_off
from mufly.mission.signals import Command, State
from mufly.mission.state import MissionPlan, MissionState, enter, fail
from mufly.mission.trajectory import stop
from mufly.mission.user import pause
from mufly.sensors import Measurement

__all__ = ["by_hand", "from_hand", "from_set_points", "to_hand", "to_set_points", "track"]


# RC


def to_hand(s: MissionState, m: Measurement) -> MissionState:
    """RC signal: the pilot takes over, from any state."""
    x, psi = measured_at(m), float(m.attitude[2])
    return enter(
        s,
        State.RC,
        "RC on",
        hold=x,
        heading=psi,
        motion=None,
        detour=None,
        tracker=None,
        homing=False,
        sink=0.0,
    )


def by_hand(s: MissionState, m: Measurement, c: Command, dt: float) -> MissionState:
    """The pilot's sticks move the references of height and heading; a climb from the floor starts the rotors."""
    if s.motors == "off":
        x = measured_at(m)
        if c.climb <= 0.0:
            return replace(s, hold=x, heading=float(m.attitude[2]), sink=0.0)
        s = replace(s, started=True, begun=False, manual=True, index=0, reached=0, standing=x)
        s = replace(s, outcome="", reason="", quit="", finished=False)
        return replace(s, motors="spin_up", clock_s=0.0, hold=x)
    if s.motors == "spin_up":
        return s if s.clock_s < SPIN_UP_S else replace(s, motors="fly")
    # The reference stays near the helicopter, so that the sticks answer at once.
    depth = min(max(s.hold[2] - c.climb * dt, m.position[2] - 0.5), m.position[2] + 0.5)
    n, e, _ = measured_at(m)
    return replace(s, hold=(n, e, depth), heading=s.heading + c.yaw_rate * dt, sink=-c.climb)


def from_hand(s: MissionState, m: Measurement) -> MissionState:
    """RC off: hover where it is, or back to init on the floor."""
    x, psi = measured_at(m), float(m.attitude[2])
    if s.motors != "fly" or _lies(s, m):
        if s.begun and s.outcome == "":
            s = fail(s, "landed by the pilot")
        elif s.started and s.outcome == "":
            s = replace(s, outcome="succeeded", reason="landed by the pilot")
        return _down(s, "RC off on the floor")
    brake = stop(x, m.velocity, psi, BRAKE_M_S2)
    n, e, d = brake.at(math.inf).position
    if d > s.standing[2]:
        # It falls too fast to stop above the floor. The reference must not lead below it: the way of a stop goes with
        # the square of the speed, so this much slower it ends on the floor, and the helicopter brakes all it can.
        share = math.sqrt(max(0.0, s.standing[2] - x[2]) / (d - x[2]))
        brake = stop(x, (m.velocity[0], m.velocity[1], share * m.velocity[2]), psi, BRAKE_M_S2)
        n, e, d = brake.at(math.inf).position
    at = (n, e, d)
    return enter(s, State.HOVER, "RC off", motion=brake, hold=at, goal=at, heading=psi, manual=True)


def _lies(s: MissionState, m: Measurement) -> bool:
    return bool(m.position[2] > s.standing[2] - 0.1 and abs(m.velocity[2]) < 0.1)


def _down(s: MissionState, why: str) -> MissionState:
    running = s.motors != "off"
    return enter(
        s,
        State.INIT,
        why,
        motors="ramp_down" if running else "off",
        motion=None,
        tracker=None,
        finished=s.outcome != "" and not running,
    )


# set-points


def to_set_points(s: MissionState, m: Measurement, wanted: SetPoint) -> MissionState:
    """A program takes over in flight; or on the floor, once it wants to go up."""
    if fault_of(wanted):
        return s
    if s.state is not State.INIT:
        return enter(
            s,
            State.OFFBOARD,
            "offboard: set-points",
            tracker=begin_tracking(onward(s)),
            motion=None,
            detour=None,
            manual=True,
            homing=False,
        )
    x = measured_at(m)
    if not wants_up(wanted, x):
        return s
    fresh = MissionState(
        time_s=s.time_s,
        started=True,
        manual=True,
        hold=x,
        standing=x,
        heading=float(m.attitude[2]),
        battery_V=s.battery_V,
        events=s.events,
        logged=s.logged,
    )
    return enter(fresh, State.OFFBOARD, "offboard: set-points, taking off", motors="spin_up")


def track(plan: MissionPlan, s: MissionState, m: Measurement, c: Command, dt: float) -> MissionState:
    """Follow the set-point, no faster than the mission's limits and into nothing that the beams have seen."""
    if s.motors == "spin_up":
        if s.clock_s < SPIN_UP_S:
            return s
        s = replace(s, motors="fly", tracker=begin_tracking(point(replace(s, motion=None))))
    # It was begun for the end of the step in which it was entered.
    if c.set_point is None or s.tracker is None or s.entered_s == s.time_s or fault_of(c.set_point):
        return s
    here = measured_at(m)

    def clear(vn: float, ve: float) -> tuple[float, float]:
        return hold_off(s.memory, here, (vn, ve), plan.mission.avoidance.clearance_m)

    guard = clear if plan.avoid and s.memory.used else None
    t = follow(s.tracker, c.set_point, plan.limits, here, dt, guard)
    return replace(s, tracker=t, hold=t.position, goal=t.position, heading=t.heading)


def from_set_points(plan: MissionPlan, s: MissionState, m: Measurement) -> MissionState:
    """No more set-points: hover where the reference comes to rest, or stay on the floor."""
    if s.motors != "fly" or _lies(s, m):
        s = replace(s, outcome="succeeded", reason="landed") if s.outcome == "" else s
        return _down(s, "offboard off on the floor")
    return pause(plan, s, "offboard off")
