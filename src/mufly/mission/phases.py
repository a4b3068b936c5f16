"""What each state of the mission does by itself, how it is entered (Fig. 6.15), and the reference that comes of it.

Every function takes a state and returns the next one; nothing is kept anywhere else. What the user's signals do is in
:mod:`mufly.mission.machine`.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from mufly.estimate import Estimate
from mufly.mission.avoidance import blocked
from mufly.mission.detour import BRAKE_M_S2, begin_detour, go_round
from mufly.mission.schema import LOWEST_M, SPIN_UP_S, leg_trajectory
from mufly.mission.state import (
    Command,
    MissionPlan,
    MissionState,
    Reference,
    State,
    enter,
    fail,
    log,
    rest,
)
from mufly.mission.timing import RAMP_DOWN_S, SINK_LAG_S, landing_rate
from mufly.mission.trajectory import Point, Stop, Trajectory, Triple, stop, straight
from mufly.mission.words import Words
from mufly.trigonometry import length, sine_cosine

SWEEP_PERIOD_S = 4.0
"""Period of the nose's swing while scanning; every direction is looked at once in half of it (s)."""

_ZERO = (0.0, 0.0, 0.0)


def point(s: MissionState) -> Point:
    """Where the reference is now, without the swing of the nose."""
    if s.state is State.OBSTACLE and s.detour is not None:
        return Point(s.detour.position, s.detour.velocity, s.detour.acceleration, s.heading, 0.0)
    if s.state is State.OFFBOARD and s.tracker is not None:
        return s.tracker
    if s.motion is None or s.motors == "spin_up":
        return Point(s.hold, _ZERO, _ZERO, s.heading, 0.0)
    at = s.motion.at(s.clock_s)
    if s.state is State.LANDING:
        (n, e, _), (u, v, _), (a, b, _) = at.position, at.velocity, at.acceleration
        return Point((n, e, s.hold[2]), (u, v, s.sink), (a, b, s.sink_rate), at.heading, at.heading_rate)
    return at


def onward(s: MissionState) -> Point:
    """Where the reference is once this step is over, as it moves now: what another motion has to go on from.

    A motion's clock has been moved on already; what a state integrates by itself (a detour, a landing's height, the
    tracker of set-points) has not.
    """
    at = point(s)
    if s.state not in (State.OBSTACLE, State.LANDING, State.OFFBOARD):
        return at
    (n, e, d), (u, v, w), dt = at.position, at.velocity, s.step_s
    place = (n, e, d + dt * w) if s.state is State.LANDING else (n + dt * u, e + dt * v, d + dt * w)
    return at._replace(position=place, heading=at.heading + dt * at.heading_rate)


def at_gate(s: MissionState) -> bool:
    """Whether height and heading are done and the way begins, on a trajectory."""
    return isinstance(s.motion, Trajectory) and s.clock_s >= s.motion.gate_s


def scanning(plan: MissionPlan, s: MissionState) -> bool:
    """Whether the nose is to swing: around an obstacle, and on a level way where the mission scans."""
    return s.state is State.OBSTACLE or (plan.scan and s.state is State.WAYPOINT and at_gate(s))


def swing(plan: MissionPlan, s: MissionState) -> tuple[float, float]:
    """Angle and rate of the nose's swing (rad, rad/s): half the gap between two beams to either side.

    It grows to that, and ends, within a second.
    """
    if s.swing <= 0.0:
        return 0.0, 0.0
    x, most, omega = min(s.swing, 1.0), 0.5 * plan.ring.spacing, math.tau / SWEEP_PERIOD_S
    size = most * x * x * (3.0 - 2.0 * x)
    growth = most * 6.0 * x * (1.0 - x) * (1.0 if scanning(plan, s) else -1.0)
    sine, cosine = sine_cosine(omega * (s.time_s - SWEEP_PERIOD_S * int(s.time_s / SWEEP_PERIOD_S)))
    return size * sine, growth * sine + size * omega * cosine


def reference(plan: MissionPlan, s: MissionState, m: Estimate, c: Command) -> Reference:
    """What the controllers have to follow now."""
    if s.state is State.RC:
        position = np.array((m.position[0], m.position[1], s.hold[2]))
        velocity = np.array((m.velocity[0], m.velocity[1], s.sink))
        turning = c.yaw_rate if s.motors == "fly" else 0.0
        return Reference(
            position, velocity, np.zeros(3), s.heading, turning, s.motors, rc=True, roll=c.roll, pitch=c.pitch
        )
    if s.state is State.INIT:
        return Reference(m.position.copy(), np.zeros(3), np.zeros(3), float(m.attitude[2]), 0.0, s.motors)
    at = point(s)
    angle, rate = swing(plan, s)
    return Reference(
        np.array(at.position),
        np.array(at.velocity),
        np.array(at.acceleration),
        at.heading + angle,
        at.heading_rate + rate,
        s.motors,
    )


# Down to the floor: a landing, and the way down when the estimate is lost


_STILL_S = 0.3
_NEAR_FLOOR_M = 0.1
_DRIFTS_BELOW_M, _DRIFTS_M_S, _DRIFTING_M_S = 0.6, 0.3, 0.05  # it does not touch down while it drifts
_STAYS_M = 0.25  # how far it may be above where it is to be while it sinks
_STANDS_M, _PRESSED_M, _PRESSED_S = 0.02, 0.03, 0.05  # on an estimate: lower than, told to be lower by, for
_KNOWN_M = 0.05  # ... whose height is this certain (standard deviation)

HARD_TOUCHDOWN_M_S = 0.3
"""Speed above which a touchdown is called hard (m/s): a fifth above the greatest that a mission may ask for."""


def land(s: MissionState, why: str, *, level: str = "info") -> MissionState:
    """Begin to sink, above where it comes to rest."""
    if s.motors == "spin_up":
        s = fail(s, why) if s.begun else s
        return enter(s, State.INIT, why, level=level, motors="ramp_down")
    now = point(s)
    brake = stop(onward(s).position, (*now.velocity[:2], 0.0), now.heading, BRAKE_M_S2)
    foot = brake.at(math.inf).position
    return enter(
        s,
        State.LANDING,
        why,
        level=level,
        motion=brake,
        hold=(foot[0], foot[1], now.position[2]),
        goal=(foot[0], foot[1], s.standing[2]),
        heading=now.heading,
        sink=now.velocity[2],
        sink_rate=now.acceleration[2],
        motors="fly",
        still_s=0.0,
        impact=0.0,
    )


def sink(plan: MissionPlan, s: MissionState, m: Estimate, dt: float) -> MissionState:
    """Sink, slower before the floor, and go on below it until the legs carry the weight; then stop the rotors.

    On an estimate whose height is certain they stop as soon as it stands 3 cm higher than it is told to, within 2 cm
    of the floor: it may drift, unknown to itself, and a controller that steers on after a place that is not there
    lifts it over the leg that rubs. With friction mu, a centre of mass h above the floor and legs l aside a slide does
    not tip it while mu h < l, but for what the rotors add: so they are not to lift while it slides.
    """
    if s.motors == "ramp_down":
        if s.clock_s < RAMP_DOWN_S:
            return s
        return enter(_judged(s), State.INIT, Words.LANDED(), motors="off", finished=True)
    q = plan.mission.limits
    a = q.climb_acceleration_m_s2
    above = s.standing[2] - s.hold[2]
    wanted = landing_rate(above, q.descent_m_s, q.touchdown_m_s, a)
    if above < -0.3:
        wanted = 0.0
    elif 0.0 < above < _DRIFTS_BELOW_M and m.velocity[0] ** 2 + m.velocity[1] ** 2 > _DRIFTS_M_S**2:
        wanted = min(wanted, _DRIFTING_M_S)
    ask = min(max((wanted - s.sink) / SINK_LAG_S, -a), a)
    rate = s.sink_rate + (ask - s.sink_rate) * min(1.0, dt / 0.1)
    speed = s.sink + rate * dt
    depth = s.hold[2] + speed * dt
    lying = m.position[2] > s.standing[2] - 0.03 and depth > s.standing[2] + 0.1
    # What does not follow lies on something, or lower than it believes.
    lying = lying or depth > m.position[2] + _STAYS_M
    # Who does not know how fast it drifts must not steer with a leg on the floor.
    stands = m.beliefs is not None and m.position[2] > s.standing[2] - _STANDS_M
    stands = stands and depth > m.position[2] + _PRESSED_M and bool(m.covariance[2, 2] < _KNOWN_M * _KNOWN_M)
    still = s.still_s + dt if stands or (lying and abs(m.velocity[2]) < 0.05) else 0.0
    near = m.position[2] > s.standing[2] - _NEAR_FLOOR_M
    if m.beliefs is not None:  # a filter that does not know of the floor yet goes on falling for a moment
        near = near and m.position[2] < s.standing[2] - LIFT_OFF_M
    impact = max(s.impact, float(m.velocity[2])) if near else s.impact
    s = replace(
        s, hold=(s.hold[0], s.hold[1], depth), sink=speed, sink_rate=rate, still_s=still, impact=impact
    )
    lasts = _PRESSED_S if stands else _STILL_S
    return replace(_touched_down(s), motors="ramp_down", clock_s=0.0) if still > lasts else s


def _touched_down(s: MissionState) -> MissionState:
    if s.impact <= HARD_TOUCHDOWN_M_S:
        return log(s, Words.TOUCHDOWN())
    return log(s, Words.HARD_TOUCHDOWN(s.impact, HARD_TOUCHDOWN_M_S), level="warning")


def _judged(s: MissionState) -> MissionState:
    """How the flight went, now that it is down."""
    if s.outcome != "":
        return s
    if s.quit:
        return fail(s, s.quit)
    return replace(s, outcome="succeeded", reason=(Words.COMPLETE if s.begun else Words.LANDED)())


def blind(s: MissionState, time_s: float, why: str) -> MissionState:
    """Measurements are lost in flight: the flight software brings it down by itself."""
    s = fail(replace(s, time_s=time_s), why)
    return enter(s, State.LANDING, why, level="error", motors="blind", detour=None)


def come_down(s: MissionState, why: str) -> MissionState:
    """It cannot go on: the mission has failed, and it comes down. A pilot is told, and decides."""
    if s.state in (State.INIT, State.RC):
        return log(s, why, level="error")
    s = fail(s, why)
    return log(s, why, level="error") if s.state is State.LANDING else land(s, why, level="error")


def down_blind(s: MissionState, time_s: float) -> MissionState:
    """By now it has come down."""
    s = replace(s, time_s=time_s)
    return enter(s, State.INIT, Words.CAME_DOWN(), motors="off", finished=True)


# The other states


_SETTLE_BEFORE_LANDING_S = 2.0


def measured_at(m: Estimate) -> Triple:
    """Position as three numbers (N, E, D; m)."""
    n, e, d = m.position.tolist()
    return n, e, d


# init and take-off


LIFT_OFF_M, TIPS_RAD_S = 0.02, 0.15
"""Height above where it stood from which it counts as off the floor (m); rate in roll or pitch at which it leaves it on
one side (rad/s): the wind's drag on the rotors tips it over its legs once these carry little."""


def lifted_off(s: MissionState, m: Estimate) -> bool:
    """Whether it is off the floor."""
    return bool(m.position[2] < s.standing[2] - LIFT_OFF_M)


def tips(m: Estimate) -> bool:
    """Whether it turns on its legs, light as it is by now: what does not steer against that tips over."""
    return bool(max(abs(m.rates[0]), abs(m.rates[1])) > TIPS_RAD_S)


def spun_up(s: MissionState, m: Estimate) -> bool:
    """Whether the rotors are up to speed, or lift it already: one lighter than its controllers were designed for."""
    return s.clock_s >= SPIN_UP_S or lifted_off(s, m)


def stand(plan: MissionPlan, s: MissionState, m: Estimate, dt: float) -> MissionState:
    """On the floor; the motors run down after a flight."""
    if s.motors == "ramp_down" and s.clock_s > RAMP_DOWN_S:
        return replace(s, motors="off", finished=s.outcome != "")
    return s


def anew(s: MissionState, m: Estimate, **changes: Any) -> MissionState:
    """A fresh flight from where it stands."""
    x = measured_at(m)
    return MissionState(
        time_s=s.time_s,
        started=True,
        hold=x,
        standing=x,
        heading=float(m.attitude[2]),
        battery_V=s.battery_V,
        events=s.events,
        logged=s.logged,
        **changes,
    )


def start(
    plan: MissionPlan,
    s: MissionState,
    m: Estimate,
    *,
    height: float | None = None,
    first: int | None = None,
) -> MissionState:
    """Start signal: a fresh flight from where it stands, of the mission or, with a ``height`` (m), only up to there."""
    fresh = anew(s, m, begun=height is None, manual=height is not None, index=first or 0)
    x = fresh.standing
    up = plan.mission.take_off.height_m if height is None else height
    goal = (x[0], x[1], -up)
    motion = straight(x, goal, fresh.heading, plan.limits)
    why = Words.START_SIGNAL() if height is None else Words.TAKE_OFF_SIGNAL(up)
    return enter(fresh, State.TAKE_OFF, why, motors="spin_up", goal=goal, motion=motion)


def take_off(plan: MissionPlan, s: MissionState, m: Estimate, dt: float) -> MissionState:
    """Spin up, climb, and judge whether that works."""
    if s.motors == "spin_up":
        return replace(s, motors="fly", clock_s=0.0, entered_s=s.time_s) if spun_up(s, m) else s
    way = s.motion
    assert isinstance(way, Trajectory)
    late = s.clock_s - way.duration_s
    if late >= 0.0:
        q = plan.mission.limits
        if abs(m.position[2] - s.goal[2]) < q.reach_m and abs(m.velocity[2]) < q.reach_m_s:
            ready = s.time_s + plan.mission.take_off.wait_s
            return _hold_at(s, Words.ALTITUDE(-m.position[2]), s.goal, ready)
        gained = s.standing[2] - m.position[2]
        if late > 3.0 and gained < 0.1:
            s = fail(s, Words.TAKE_OFF_FAILED(gained, s.clock_s))
            return enter(s, State.INIT, s.reason, level="error", motors="ramp_down")
        if late > 8.0 + 0.5 * way.duration_s:
            why = Words.TAKE_OFF_SHORT(-m.position[2], -s.goal[2])
            return land(fail(s, why), why, level="warning")
    # On its legs it cannot slide away from anything.
    return _watch(plan, s) if m.position[2] < s.standing[2] - 0.2 else s


# hover and waypoint


def hover(plan: MissionPlan, s: MissionState, m: Estimate, dt: float) -> MissionState:
    """Wait, and give the next signal when it is time."""
    if s.outcome == "failed":
        return land(s, s.reason, level="warning") if s.time_s >= s.ready_s else s
    s = _watch(plan, s)
    if s.state is not State.HOVER or s.manual or s.time_s < s.ready_s:
        return s
    if s.index >= len(plan.mission.waypoint):
        return _complete(plan, s)

    def leg(at: Triple, heading: float) -> Trajectory:
        offset = nose_offset(plan)
        return leg_trajectory(plan.mission, s.index, np.array(at), heading, nose_offset=offset, made=False)

    return set_out(plan, s, Words.TO_WAYPOINT(s.index + 1), leg)


def nose_offset(plan: MissionPlan) -> float:
    """Angle of the nose from the direction of flight (rad): while scanning a beam, not a gap, looks along it."""
    return math.remainder(-plan.ring.first_angle, plan.ring.spacing) if plan.scan else 0.0


def _complete(plan: MissionPlan, s: MissionState) -> MissionState:
    """After the last wait: what the mission says."""
    if plan.mission.at_end == "hover":
        s = log(s, Words.COMPLETE_HOLDS())
        return replace(s, manual=True, outcome="succeeded", reason=Words.COMPLETE())
    if plan.mission.at_end == "return":
        return go_home(plan, s, Words.COMPLETE_RETURNS())
    return land(s, Words.COMPLETE())


def braking(plan: MissionPlan, s: MissionState) -> Stop:
    """Come to rest from how the reference moves now."""
    now = onward(s)
    return stop(
        now.position,
        now.velocity,
        now.heading,
        BRAKE_M_S2,
        heading_rate=now.heading_rate,
        yaw_acceleration=plan.limits.yaw_acceleration,
    )


def set_out(
    plan: MissionPlan,
    s: MissionState,
    why: str,
    way: Callable[[Triple, float], Trajectory],
    **flags: object,
) -> MissionState:
    """Fly ``way(from where, with which heading)``, after a braking if the reference moves."""
    at = point(s)
    if length(*at.velocity) > 0.01 or abs(at.heading_rate) > 0.01:
        brake = braking(plan, s)
        at = brake.at(math.inf)
        motion = way(at.position, at.heading).after(brake)
    else:
        motion = way(at.position, at.heading)
    fresh: dict[str, Any] = {
        "detour": None,
        "avoided_s": 0.0,
        "resumed": False,
        "manual": False,
        "homing": False,
    }
    fresh |= {"asked_heading": None, "motion": motion, "goal": motion.goal}
    return enter(s, State.WAYPOINT, why, **(fresh | flags))


def go_home(plan: MissionPlan, s: MissionState, why: str) -> MissionState:
    """Fly to above where it took off, no lower than now, and land there."""

    def way(at: Triple, heading: float) -> Trajectory:
        n, e, _ = s.standing
        goal = (n, e, min(at[2], -LOWEST_M))
        return straight(at, goal, heading, plan.limits, nose_offset=nose_offset(plan))

    return set_out(plan, s, why, way, manual=True, homing=True)


def fly_leg(plan: MissionPlan, s: MissionState, m: Estimate, dt: float) -> MissionState:
    """Fly to the goal and judge whether it is reached."""
    way = s.motion
    assert isinstance(way, Trajectory)
    q = plan.mission.limits
    if s.clock_s >= way.duration_s:
        off = _away(m, s.goal)
        if off < q.reach_m and length(*m.velocity.tolist()) < q.reach_m_s:
            why = _leg_words(s, Words.REACHED, Words.REACHED_USERS, Words.REACHED_HOME, 100.0 * off)
            if s.homing:
                return land(s, why)
            if s.manual:
                return _hold_at(s, why, s.goal, s.time_s)
            wait = plan.mission.waypoint[s.index].wait_s
            s = _hold_at(s, why, s.goal, s.time_s + wait)
            return replace(s, index=s.index + 1, reached=s.reached + 1)
    spent = s.time_s - s.entered_s
    if spent > 2.0 * way.duration_s + 20.0:
        off = _away(m, s.goal)
        why = _leg_words(s, Words.MISSED, Words.MISSED_USERS, Words.MISSED_HOME, spent, off)
        return _give_up(s, why)
    return _watch(plan, s)


def _leg_words(s: MissionState, mission: Words, users: Words, home: Words, *numbers: float) -> str:
    if s.homing or s.manual:
        return (home if s.homing else users)(*numbers)
    return mission(s.index + 1, *numbers)


def _away(m: Estimate, goal: Triple) -> float:
    n, e, d = measured_at(m)
    return float(length(n - goal[0], e - goal[1], d - goal[2]))


def _hold_at(s: MissionState, why: str, at: Triple, ready_s: float) -> MissionState:
    return rest(s, why, at, point(s).heading, ready_s=ready_s)


def _give_up(s: MissionState, why: str) -> MissionState:
    """Come to rest in a hover, from which it lands."""
    now = point(s)
    brake = stop(now.position, now.velocity, now.heading, BRAKE_M_S2)
    at = brake.at(math.inf).position
    ready = s.time_s + brake.duration_s + _SETTLE_BEFORE_LANDING_S
    s = fail(s, why)
    return rest(s, why, at, now.heading, level="warning", motion=brake, ready_s=ready)


# obstacle


def _watch(plan: MissionPlan, s: MissionState) -> MissionState:
    """Obstacle detected?"""
    if not plan.avoid or not s.memory.used:
        return s
    at = point(s)
    clear = plan.mission.avoidance.clearance_m
    # Only on its level way does it head for somewhere; elsewhere an obstacle has to come near.
    underway = s.state is State.WAYPOINT and at_gate(s)
    here, sight = at.position, s.sight
    if underway:  # it looks along the way since the step after it was sent elsewhere
        there = sight.goal_north == s.goal[0] and sight.goal_east == s.goal[1] and blocked(sight, clear)
    else:
        there = sight.nearest(here)[0] < clear
    if not there:
        return s
    velocity, acceleration = at.velocity, at.acceleration
    detour = begin_detour(here, velocity, acceleration, s.goal, sight, s.detour)
    far = math.sqrt(sight.way) if underway else sight.nearest(here)[0]
    why = (Words.OBSTACLE_AHEAD if underway else Words.OBSTACLE_NEAR)(far)
    return enter(s, State.OBSTACLE, why, back=s.state, detour=detour, heading=at.heading)


def avoid(plan: MissionPlan, s: MissionState, m: Estimate, dt: float) -> MissionState:
    """Go round the obstacle, then back to what it was doing."""
    assert s.detour is not None
    q = plan.mission.avoidance
    detour = go_round(
        s.detour,
        s.sight,
        plan.ring,
        measured_at(m),
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
        return _give_up(s, Words.BLOCKED(n, e, q.give_up_s))
    if not detour.done:
        return s
    way = straight(detour.position, s.goal, s.heading, plan.limits, final_heading=s.heading)
    return enter(s, s.back, Words.AVOIDED(), motion=way, resumed=True)
