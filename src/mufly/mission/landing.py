"""Down to the floor: a landing, and the way down when measurements are lost."""

from __future__ import annotations

import math
from dataclasses import replace

from mufly.mission.avoidance import BRAKE_M_S2
from mufly.mission.plan import SLOW_FROM_M
from mufly.mission.reference import onward, point
from mufly.mission.signals import State
from mufly.mission.state import MissionPlan, MissionState, enter, fail, log
from mufly.mission.trajectory import stop
from mufly.sensors import Measurement

__all__ = ["RAMP_DOWN_S", "blind", "down_blind", "land", "sink"]

RAMP_DOWN_S = 1.0
"""Time that the rotors take to stop after touchdown (s)."""

_SINK_LAG_S = 0.15


def land(s: MissionState, why: str, *, level: str = "info") -> MissionState:
    """Begin to sink, above where it comes to rest."""
    if s.motors == "spin_up":
        s = fail(s, why) if s.begun else s
        return enter(s, State.INIT, why, level=level, motors="ramp_down", motion=None, tracker=None)
    now = point(s)
    brake = stop(onward(s).position, (*now.velocity[:2], 0.0), now.heading, BRAKE_M_S2)
    foot = brake.at(math.inf).position
    return enter(
        s,
        State.LANDING,
        why,
        level=level,
        motion=brake,
        tracker=None,
        hold=(foot[0], foot[1], now.position[2]),
        goal=(foot[0], foot[1], s.standing[2]),
        heading=now.heading,
        sink=now.velocity[2],
        sink_rate=now.acceleration[2],
        motors="fly",
        still_s=0.0,
    )


def sink(plan: MissionPlan, s: MissionState, m: Measurement, dt: float) -> MissionState:
    """Sink, slower before the floor, and go on below it until the legs carry the weight; then stop the rotors."""
    if s.motors == "ramp_down":
        if s.clock_s < RAMP_DOWN_S:
            return s
        return enter(_judged(s), State.INIT, "landed", motors="off", motion=None, finished=True)
    q = plan.mission.limits
    a = q.climb_acceleration_m_s2
    above = s.standing[2] - s.hold[2]
    # v^2 = v1^2 + 2 (a/2) h: half the acceleration brings it from descent to touchdown speed where that begins.
    wanted = min(q.descent_m_s, math.sqrt(q.touchdown_m_s**2 + max(0.0, above - SLOW_FROM_M) * a))
    if above < -0.3:
        wanted = 0.0
    ask = min(max((wanted - s.sink) / _SINK_LAG_S, -a), a)
    rate = s.sink_rate + (ask - s.sink_rate) * min(1.0, dt / 0.1)
    speed = s.sink + rate * dt
    depth = s.hold[2] + speed * dt
    lying = m.position[2] > s.standing[2] - 0.03 and abs(m.velocity[2]) < 0.05
    still = s.still_s + dt if lying and depth > s.standing[2] + 0.1 else 0.0
    s = replace(s, hold=(s.hold[0], s.hold[1], depth), sink=speed, sink_rate=rate, still_s=still)
    if still > 0.3:
        return replace(log(s, "touchdown"), motors="ramp_down", clock_s=0.0)
    return s


def _judged(s: MissionState) -> MissionState:
    """How the flight went, now that it is down."""
    if s.outcome != "":
        return s
    if s.quit:
        return fail(s, s.quit)
    return replace(s, outcome="succeeded", reason="mission complete" if s.begun else "landed")


def blind(s: MissionState, time_s: float, why: str) -> MissionState:
    """Measurements are lost in flight: the flight software brings it down by itself."""
    s = fail(replace(s, time_s=time_s), why)
    return enter(s, State.LANDING, why, level="error", motors="blind", motion=None, detour=None, tracker=None)


def down_blind(s: MissionState, time_s: float) -> MissionState:
    """By now it has come down."""
    s = replace(s, time_s=time_s)
    return enter(s, State.INIT, "motors off, where it came down", motors="off", finished=True)
