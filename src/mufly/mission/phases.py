"""What each state of the mission does by itself, and how it is entered (Fig. 6.15).

Every function takes a state and returns the next one; nothing is kept anywhere else.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from mufly.mission.avoidance import BRAKE_M_S2, begin_detour, go_round
from mufly.mission.plan import SLOW_FROM_M, SPIN_UP_S, leg_trajectory
from mufly.mission.reference import at_gate, point
from mufly.mission.schema import LOWEST_M
from mufly.mission.sight import blocked, look
from mufly.mission.signals import Command, MissionPlan, MissionState, State, Triple, enter, fail, log
from mufly.mission.trajectory import Trajectory, stop, straight
from mufly.sensors import Measurement

__all__ = [
    "avoid",
    "blind",
    "by_hand",
    "down_blind",
    "fly_leg",
    "from_hand",
    "hover",
    "land",
    "sink",
    "stand",
    "start",
    "take_off",
    "to_hand",
    "to_users_waypoint",
]

RAMP_DOWN_S = 1.0
"""Time that the rotors take to stop after touchdown (s)."""

_SETTLE_BEFORE_LANDING_S = 2.0
_SINK_LAG_S = 0.15


def _triple(x: tuple[float, ...]) -> Triple:
    return x[0], x[1], x[2]


def _measured(m: Measurement) -> Triple:
    n, e, d = m.position.tolist()
    return n, e, d


# init and take-off


def stand(plan: MissionPlan, s: MissionState, m: Measurement, dt: float) -> MissionState:
    """On the floor; the motors run down after a flight."""
    if s.motors == "ramp_down" and s.clock_s > RAMP_DOWN_S:
        return replace(s, motors="off", finished=s.outcome != "")
    return s


def start(plan: MissionPlan, s: MissionState, m: Measurement) -> MissionState:
    """Start signal: a fresh mission from where it stands."""
    x = _measured(m)
    fresh = MissionState(
        time_s=s.time_s,
        started=True,
        hold=x,
        standing=x,
        heading=float(m.attitude[2]),
        battery_V=s.battery_V,
        events=s.events,
    )
    goal = (x[0], x[1], -plan.mission.take_off.height_m)
    motion = straight(x, goal, fresh.heading, plan.limits)
    return enter(fresh, State.TAKE_OFF, "start signal", motors="spin_up", goal=goal, motion=motion)


def take_off(plan: MissionPlan, s: MissionState, m: Measurement, dt: float) -> MissionState:
    """Spin up, climb, and judge whether that works."""
    if s.motors == "spin_up":
        return s if s.clock_s < SPIN_UP_S else replace(s, motors="fly", clock_s=0.0, entered_s=s.time_s)
    way = s.motion
    assert isinstance(way, Trajectory)
    late = s.clock_s - way.duration_s
    if late >= 0.0:
        q = plan.mission.limits
        if abs(m.position[2] - s.goal[2]) < q.reach_m and abs(m.velocity[2]) < q.reach_m_s:
            ready = s.time_s + plan.mission.take_off.wait_s
            return _hold_at(s, f"altitude reached: {-m.position[2]:.2f} m", s.goal, ready)
        gained = s.standing[2] - m.position[2]
        if late > 3.0 and gained < 0.1:
            s = fail(s, f"take-off failed: {gained:.2f} m gained in {s.clock_s:.1f} s")
            return enter(s, State.INIT, s.reason, motors="ramp_down", motion=None)
        if late > 8.0 + 0.5 * way.duration_s:
            why = f"take-off failed: {-m.position[2]:.2f} m high in place of {-s.goal[2]:.2f} m"
            return land(fail(s, why), why)
    # On its legs it cannot slide away from anything.
    return _watch(plan, s) if m.position[2] < s.standing[2] - 0.2 else s


# hover and waypoint


def hover(plan: MissionPlan, s: MissionState, m: Measurement, dt: float) -> MissionState:
    """Wait, and give the next signal when it is time."""
    if s.outcome == "failed":
        return land(s, s.reason) if s.time_s >= s.ready_s else s
    s = _watch(plan, s)
    if s.state is not State.HOVER or s.manual or s.time_s < s.ready_s:
        return s
    if s.index >= len(plan.mission.waypoint):
        return land(s, "mission complete")
    at = point(s)
    # While scanning a beam looks along the way, not the gap between two.
    offset = math.remainder(-plan.ring.first_angle, plan.ring.spacing) if plan.scan else 0.0
    way = leg_trajectory(plan.mission, s.index, np.array(at.position), at.heading, nose_offset=offset)
    return _set_out(s, f"waypoint {s.index + 1}", way)


def _set_out(s: MissionState, why: str, way: Trajectory, manual: bool = False) -> MissionState:
    return enter(
        s,
        State.WAYPOINT,
        why,
        motion=way,
        goal=way.goal,
        detour=None,
        avoided_s=0.0,
        resumed=False,
        manual=manual,
    )


def to_users_waypoint(plan: MissionPlan, s: MissionState, where: Triple) -> MissionState:
    """Waypoint signal: stop, go there and hold; the mission waits."""
    goal = _triple(tuple(float(v) for v in where))
    if s.manual and goal == s.goal:
        return s
    text = f"[{goal[0]:g}, {goal[1]:g}, {goal[2]:g}]"
    if not all(math.isfinite(v) for v in goal) or goal[2] > -LOWEST_M:
        refused = f"user's waypoint {text} refused: D has to be at most {-LOWEST_M:g} m"
        return s if s.events[-1].text == refused else replace(s, events=log(s, refused))
    at = point(s)
    if math.hypot(*at.velocity) > 0.01:
        # A trajectory starts at rest: stop first, and take the signal again when it comes to a stop.
        at = stop(at.position, at.velocity, at.heading, BRAKE_M_S2).at(math.inf)
    way = straight(at.position, goal, at.heading, plan.limits)
    return _set_out(s, f"user's waypoint {text}", way, manual=True)


def fly_leg(plan: MissionPlan, s: MissionState, m: Measurement, dt: float) -> MissionState:
    """Fly to the goal and judge whether it is reached."""
    way = s.motion
    assert isinstance(way, Trajectory)
    q = plan.mission.limits
    name = "user's waypoint" if s.manual else f"waypoint {s.index + 1}"
    if s.clock_s >= way.duration_s:
        off = math.dist(m.position.tolist(), s.goal)
        if off < q.reach_m and math.hypot(*m.velocity.tolist()) < q.reach_m_s:
            wait = 0.0 if s.manual else plan.mission.waypoint[s.index].wait_s
            index = s.index if s.manual else s.index + 1
            s = _hold_at(s, f"{name} reached, {off * 100:.1f} cm off", s.goal, s.time_s + wait)
            return replace(s, index=index)
    spent = s.time_s - s.entered_s
    if spent > 2.0 * way.duration_s + 20.0:
        off = math.dist(m.position.tolist(), s.goal)
        return _give_up(s, f"{name} not reached within {spent:.0f} s: {off:.2f} m away")
    return _watch(plan, s)


def _hold_at(s: MissionState, why: str, at: Triple, ready_s: float) -> MissionState:
    heading = point(s).heading
    return enter(s, State.HOVER, why, motion=None, hold=at, goal=at, heading=heading, ready_s=ready_s)


def _give_up(s: MissionState, why: str) -> MissionState:
    """Come to rest in a hover, from which it lands."""
    now = point(s)
    brake = stop(now.position, now.velocity, now.heading, BRAKE_M_S2)
    at = _triple(brake.at(math.inf).position)
    ready = s.time_s + brake.duration_s + _SETTLE_BEFORE_LANDING_S
    s = fail(s, why)
    return enter(s, State.HOVER, why, motion=brake, hold=at, goal=at, heading=now.heading, ready_s=ready)


# obstacle


def _watch(plan: MissionPlan, s: MissionState) -> MissionState:
    """Obstacle detected?"""
    if not plan.avoid or not s.memory.used or s.outcome == "failed":
        return s
    at = point(s)
    clear = plan.mission.avoidance.clearance_m
    # Only on its level way does it head for somewhere; elsewhere an obstacle has to come near.
    underway = s.state is State.WAYPOINT and at_gate(s)
    here = _triple(at.position)
    sight = look(s.memory, here, s.goal if underway else here, clear)
    if not (blocked(sight, clear) if underway else sight.nearest < clear):
        return s
    velocity, acceleration = _triple(at.velocity), _triple(at.acceleration)
    detour = begin_detour(here, velocity, acceleration, s.goal, sight, s.detour)
    why = f"obstacle {sight.way:.2f} m from the way" if underway else f"obstacle {sight.nearest:.2f} m away"
    return enter(s, State.OBSTACLE, why, back=s.state, detour=detour, heading=at.heading, motion=None)


def avoid(plan: MissionPlan, s: MissionState, m: Measurement, dt: float) -> MissionState:
    """Go round the obstacle, then back to what it was doing."""
    assert s.detour is not None
    q = plan.mission.avoidance
    detour = go_round(
        s.detour,
        s.memory,
        plan.ring,
        _measured(m),
        float(m.attitude[2]),
        m.ranges.tolist(),
        s.goal,
        clearance=q.clearance_m,
        speed=q.speed_m_s,
        dt=dt,
    )
    s = replace(s, detour=detour, avoided_s=s.avoided_s + dt)
    if s.avoided_s > q.give_up_s:
        n, e = detour.obstacle
        return _give_up(
            s, f"blocked by an obstacle at N {n:.2f} m, E {e:.2f} m: no way around it in {q.give_up_s:.0f} s"
        )
    if not detour.done:
        return s
    way = straight(detour.position, s.goal, s.heading, plan.limits, final_heading=s.heading)
    return enter(s, s.back, "obstacle avoided", motion=way, resumed=True)


# landing


def land(s: MissionState, why: str) -> MissionState:
    """Begin to sink, above where it comes to rest."""
    now = point(s)
    brake = stop(now.position, (*now.velocity[:2], 0.0), now.heading, BRAKE_M_S2)
    foot = brake.at(math.inf).position
    return enter(
        s,
        State.LANDING,
        why,
        motion=brake,
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
        done = s if s.outcome == "failed" else replace(s, outcome="succeeded", reason="mission complete")
        return enter(done, State.INIT, "landed", motors="off", motion=None, finished=True)
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
        return replace(s, motors="ramp_down", clock_s=0.0, events=log(s, "touchdown"))
    return s


def blind(s: MissionState, time_s: float, why: str) -> MissionState:
    """Measurements are lost in flight: the flight software brings it down by itself."""
    s = fail(replace(s, time_s=time_s), why)
    return enter(s, State.LANDING, why, motors="blind", motion=None, detour=None)


def down_blind(s: MissionState, time_s: float) -> MissionState:
    """By now it has come down."""
    s = replace(s, time_s=time_s)
    return enter(s, State.INIT, "motors off, where it came down", motors="off", finished=True)


# RC


def to_hand(s: MissionState, m: Measurement) -> MissionState:
    """RC signal: the pilot takes over, from any state."""
    motors = s.motors if s.motors in ("off", "fly") else "fly"
    x, psi = _measured(m), float(m.attitude[2])
    return enter(s, State.RC, "RC on", hold=x, heading=psi, motion=None, detour=None, motors=motors, sink=0.0)


def by_hand(s: MissionState, m: Measurement, c: Command, dt: float) -> MissionState:
    """The pilot's sticks move the references of height and heading; a climb from the floor starts the rotors."""
    if s.motors == "off":
        x = _measured(m)
        if c.climb <= 0.0:
            return replace(s, hold=x, heading=float(m.attitude[2]), sink=0.0)
        standing = s.standing if s.started else x
        return replace(s, motors="spin_up", clock_s=0.0, hold=x, standing=standing)
    if s.motors == "spin_up":
        return s if s.clock_s < SPIN_UP_S else replace(s, motors="fly")
    # The reference stays near the helicopter, so that the sticks answer at once.
    depth = min(max(s.hold[2] - c.climb * dt, m.position[2] - 0.5), m.position[2] + 0.5)
    n, e, _ = _measured(m)
    return replace(s, hold=(n, e, depth), heading=s.heading + c.yaw_rate * dt, sink=-c.climb)


def from_hand(s: MissionState, m: Measurement) -> MissionState:
    """RC off: hover where it is, or back to init on the floor."""
    x, psi = _measured(m), float(m.attitude[2])
    if s.motors != "fly" or (x[2] > s.standing[2] - 0.1 and abs(m.velocity[2]) < 0.1):
        if s.started and s.outcome == "":
            s = fail(s, "landed by the pilot")
        running = s.motors != "off"
        return enter(
            s,
            State.INIT,
            "RC off on the floor",
            motors="ramp_down" if running else "off",
            motion=None,
            finished=s.outcome != "" and not running,
        )
    brake = stop(x, m.velocity, psi, BRAKE_M_S2)
    at = _triple(brake.at(math.inf).position)
    return enter(s, State.HOVER, "RC off", motion=brake, hold=at, goal=at, heading=psi, manual=True)
