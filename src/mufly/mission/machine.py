"""The mission state machine (Fig. 6.15) as a pure function of time steps.

    init --start--> take-off --altitude reached--> hover --waypoint--> waypoint --goal reached--> hover ...
    take-off, hover, waypoint --obstacle detected--> obstacle --obstacle avoided--> back to where it came from
    take-off --failed--> init (never lifted off) or landing
    any flying state --land signal, battery low--> landing --touchdown--> init
    any state --RC--> RC --RC off--> hover, or init when it stands on the floor

and what a user of today expects beside it:

    init --take-off signal--> take-off --> hover, where the mission waits
    take-off, waypoint, obstacle, landing --pause--> hover --start--> waypoint
    take-off, hover, waypoint, obstacle --return--> waypoint (home) --goal reached--> landing
    init, take-off, hover, waypoint, obstacle --set-points--> offboard --no more--> hover, or init on the floor
    any state --stop--> init, motors off

After the start signal the machine gives itself the waypoint signals of the mission file, and the land signal after
the last one; signals of the user override it, where the state lets them (:mod:`mufly.mission.state`). Each change of
state is kept with its reason in `MissionState.events`.

One step takes what was measured and commanded and returns the next state and the `Reference` for the controllers. It
runs at 50 Hz or so. Trajectories are made at transitions; a step in between only evaluates one. What each state does
by itself is in `mufly.mission.phases`. Below that every function takes a state and returns the next one: first what
the user's signals do, then what happens while a pilot (the thesis's state RC) or a program (offboard) flies. A
reference that moves comes to rest before it does anything else, so that none of them makes it jump.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

from mufly.estimate import Estimate
from mufly.mission import phases
from mufly.mission.avoidance import LOOK_M, begin_sight, hold_off, look_around, observe
from mufly.mission.detour import BRAKE_M_S2
from mufly.mission.offboard import HIGHEST_M, SetPoint, fault_of, follow, wants_up
from mufly.mission.phases import (
    anew,
    braking,
    go_home,
    land,
    measured_at,
    onward,
    point,
    reference,
    scanning,
    set_out,
    spun_up,
    swing,
)
from mufly.mission.schema import LOWEST_M
from mufly.mission.state import (
    Ask,
    Command,
    MissionPlan,
    MissionState,
    Reference,
    State,
    enter,
    fail,
    log,
    may,
    rest,
)
from mufly.mission.timing import LOOK_AROUND_S
from mufly.mission.trajectory import Trajectory, Triple, shorter_way_round, stop, straight
from mufly.mission.words import Words
from mufly.trigonometry import length

_FLYING = frozenset({State.TAKE_OFF, State.HOVER, State.WAYPOINT, State.OBSTACLE, State.OFFBOARD})
_TIPPED = math.radians(60.0)
_LOW_FOR_S = 1.0
_VOLTAGE_LAG_S = 0.5
_GATE_HEIGHT_M, _GATE_HEADING = 0.1, math.radians(8.0)

_PHASES = {
    State.INIT: phases.stand,
    State.TAKE_OFF: phases.take_off,
    State.HOVER: phases.hover,
    State.WAYPOINT: phases.fly_leg,
    State.OBSTACLE: phases.avoid,
    State.LANDING: phases.sink,
}


def step(
    plan: MissionPlan, state: MissionState, estimate: Estimate, command: Command
) -> tuple[MissionState, Reference]:
    """Advance the mission by one step.

    Parameters
    ----------
    plan : MissionPlan
        From `prepare`: the mission and the vehicle's numbers.
    state : MissionState
        From `begin` or the step before.
    estimate : Estimate
        Measured now; the time step is the difference of its time and the state's (half a second at most).
    command : Command
        The user's signals.

    Returns
    -------
    state : MissionState
        The new state.
    reference : Reference
        What the controllers have to follow now.

    Thesis: Fig. 6.15; Sec. 6.2.1.
    """
    dt = min(max(estimate.time_s - state.time_s, 0.0), 0.5)
    s = _sense(plan, _made(state), estimate, dt)
    s = _signals(plan, s, estimate, command, dt)
    if s.state is State.OFFBOARD:
        s = track(plan, s, estimate, command, dt)
    phase = _PHASES.get(s.state)
    if phase is not None:
        s = phase(plan, s, estimate, dt)
    wanted = reference(plan, s, estimate, command)
    if plan.avoid and s.state in _FLYING:
        here = wanted.position.tolist()
        goal = s.goal if s.state in (State.WAYPOINT, State.OBSTACLE) else here
        ahead = math.inf if s.state is State.OBSTACLE else LOOK_M
        s = replace(s, sight=begin_sight(here, goal, ahead))
    return s, wanted


def watch_out(
    plan: MissionPlan, state: MissionState, estimate: Estimate, part: int = 1, parts: int = 1
) -> MissionState:
    """Between two steps: take an eighth of the beams, and a part of the points that the next step goes by.

    Where it has just set out along a curve, that is made instead; it stands or brakes.

    Parameters
    ----------
    plan, state, estimate
        As in `step`.
    part, parts : int
        Which part this is (from 1), and of how many.
    """
    s, m = state, estimate
    if not plan.avoid or s.state not in _FLYING or _unmade(s):
        return s
    if not s.memory.used and not float(m.ranges.min()) < plan.ring.max_range:
        return s
    beams = len(plan.ring.cos)
    count = (beams + 7) // 8
    memory = observe(s.memory, plan.ring, m.time_s, m.position, m.attitude, m.ranges, s.beam, count)
    after = s.beam + count
    clearance = plan.mission.avoidance.clearance_m
    memory, sight = look_around(memory, s.sight, m.time_s, clearance, part, parts)
    return replace(s, memory=memory, sight=sight, beam=after if after < beams else after - beams)


def _unmade(s: MissionState) -> bool:
    return isinstance(s.motion, Trajectory) and s.motion.unmade is not None


def _made(s: MissionState) -> MissionState:
    """With a curve that has been made by now."""
    return replace(s, motion=s.motion.made()) if _unmade(s) and isinstance(s.motion, Trajectory) else s


def _sense(plan: MissionPlan, s: MissionState, m: Estimate, dt: float) -> MissionState:
    """Move the clocks, watch the battery."""
    clock = s.clock_s + dt
    if s.state is State.WAYPOINT and isinstance(s.motion, Trajectory):
        gate = s.motion.gate_s
        if s.clock_s <= gate < clock and not _gate_open(plan, s, m, s.motion):
            clock = gate
    volts = s.battery_V + (m.battery_voltage - s.battery_V) * min(1.0, dt / _VOLTAGE_LAG_S)
    swinging = s.swing
    swinging = min(LOOK_AROUND_S, swinging + dt) if scanning(plan, s) else max(0.0, min(1.0, swinging) - dt)
    return replace(
        s,
        time_s=m.time_s,
        clock_s=clock,
        step_s=dt,
        battery_V=volts,
        low_s=s.low_s + dt if volts < plan.low_V else 0.0,
        swing=swinging,
    )


def _gate_open(plan: MissionPlan, s: MissionState, m: Estimate, way: Trajectory) -> bool:
    """Whether height and heading are adapted in fact, and the beams have had a look around."""
    at = way.at(way.gate_s)
    angle, _ = swing(plan, s)
    return (
        abs(m.position[2] - at.position[2]) < _GATE_HEIGHT_M
        and abs(m.attitude[2] - at.heading - angle) < _GATE_HEADING + abs(angle)
        and (not plan.scan or s.resumed or way.way.way == 0.0 or s.swing >= LOOK_AROUND_S)
    )


def _signals(plan: MissionPlan, s: MissionState, m: Estimate, c: Command, dt: float) -> MissionState:
    """Transitions that do not depend on what the present state is busy with."""
    if c.stop:
        return stop_at_once(s, c.stop)
    if s.state is not State.INIT and _tipped_over(s, m):
        return stop_at_once(fail(s, Words.TIPPED_OVER()), Words.TIPPED_OFF())
    # Rotors that run down after touchdown stop first: sticks in their middle must not start them again.
    if c.rc and s.motors != "ramp_down":
        s = s if s.state is State.RC else to_hand(s, m)
        if s.motors == "fly" and s.low_s - dt <= _LOW_FOR_S < s.low_s:
            # The pilot's own decision.
            s = log(s, Words.BATTERY_LOW_PILOT(s.battery_V, plan.low_V), level="warning")
        return by_hand(s, m, c, dt)
    if s.state is State.RC:
        return from_hand(s, m)
    if s.state in _FLYING and s.low_s > _LOW_FOR_S:
        return _battery_low(plan, s)
    return s if s.state is State.INIT and s.motors != "off" else _asked(plan, s, m, c)


def _asked(plan: MissionPlan, s: MissionState, m: Estimate, c: Command) -> MissionState:
    """What the user wants, where the state lets it."""

    def granted(ask: Ask) -> bool:
        return bool(may(ask, s, height_m=s.standing[2] - float(m.position[2])))

    if c.land and s.state is not State.LANDING and granted(Ask.LAND):
        return land_now(plan, s)
    if s.state is State.OFFBOARD and c.set_point is None:
        s = from_set_points(plan, s, m)
        if s.state is State.INIT:
            return s
    fresh = s.manual or c.first is not None
    if c.start and s.state is State.INIT and granted(Ask.START):
        return phases.start(plan, s, m, first=c.first)
    if c.start and s.state is State.TAKE_OFF and fresh and granted(Ask.START):
        return go_on_after_take_off(s, c.first)
    if c.take_off is not None and granted(Ask.TAKE_OFF):
        return phases.start(plan, s, m, height=c.take_off)
    if (c.pause or s.halt) and granted(Ask.PAUSE):
        if s.state is State.TAKE_OFF and not granted(Ask.GO_TO):
            return s if s.halt else replace(log(s, Words.WILL_HOVER()), halt=True, manual=True)
        return pause(plan, s, Words.LANDING_BROKEN_OFF() if s.state is State.LANDING else Words.PAUSED())
    if c.home and granted(Ask.RETURN):
        return return_home(plan, s)
    if c.set_point is not None and granted(Ask.OFFBOARD):
        return s if s.state is State.OFFBOARD else to_set_points(s, m, c.set_point)
    if (c.waypoint is not None or c.heading is not None) and granted(Ask.GO_TO):
        return to_users_waypoint(plan, s, c.waypoint, c.heading)
    if c.start and fresh and granted(Ask.START):
        return go_on(plan, s, c.first)
    return s


def _tipped_over(s: MissionState, m: Estimate) -> bool:
    near = m.position[2] > s.standing[2] - 0.3
    return bool(near and s.motors != "off" and max(abs(m.attitude[0]), abs(m.attitude[1])) > _TIPPED)


def _battery_low(plan: MissionPlan, s: MissionState) -> MissionState:
    why = Words.BATTERY_LOW(s.battery_V, plan.low_V)
    # A mission that is complete and holds has not failed when its battery is used up.
    return land(s if s.outcome == "succeeded" else fail(s, why), why, level="warning")


# The user: stop, waypoints, pause, home


def stop_at_once(s: MissionState, why: str) -> MissionState:
    """Motors off, whatever the state."""
    if s.state is State.INIT and s.motors == "off":
        return s
    if s.started or s.begun:
        s = fail(s, why)
    return enter(s, State.INIT, why, level="error", motors="off", detour=None, finished=s.outcome != "")


def waypoint_fault(where: Triple | None, heading: float | None) -> str:
    """Why a user's waypoint is refused; "" if it is not."""
    if heading is not None and not math.isfinite(heading):
        return Words.HEADING_REFUSED(heading)
    if where is None:
        return ""
    if not all(math.isfinite(v) for v in where) or where[2] > -LOWEST_M:
        return Words.TOO_LOW(*where, -LOWEST_M)
    if where[2] < -HIGHEST_M or length(where[0], where[1]) > 1e4:
        return Words.TOO_FAR(*where, -HIGHEST_M)
    return ""


def to_users_waypoint(
    plan: MissionPlan, s: MissionState, where: Triple | None, heading: float | None
) -> MissionState:
    """Waypoint signal: stop, go there and hold; the mission waits. Without ``where`` only turn, on the spot."""
    refused = waypoint_fault(where, heading)
    if refused:
        return s if s.events[-1].text == refused else log(s, refused, level="warning")
    goal = None if where is None else (float(where[0]), float(where[1]), float(where[2]))
    if s.manual and not s.homing and s.asked_heading == heading and goal in (None, s.goal):
        return s
    if goal is None:
        text = Words.TURNING(_compass_deg(0.0 if heading is None else heading))
    elif heading is None:
        text = Words.USERS_WAYPOINT(*goal)
    else:
        text = Words.USERS_WAYPOINT_HEADING(*goal, math.degrees(heading))

    def way(at: Triple, psi: float) -> Trajectory:
        return straight(at, at if goal is None else goal, psi, plan.limits, final_heading=heading)

    return set_out(plan, s, text, way, manual=True, asked_heading=heading)


def _compass_deg(heading: float) -> float:
    deg = math.degrees(shorter_way_round(heading))
    return deg + (360.0 if deg < 0.0 else 0.0)


def pause(plan: MissionPlan, s: MissionState, why: str = Words.PAUSED.value) -> MissionState:
    """Stop and hover; the mission waits."""
    if s.state is State.HOVER:
        return s if s.manual else replace(log(s, why), manual=True, quit="")
    brake = braking(plan, s)
    at = brake.at(math.inf)
    n, e, d = at.position
    place = (n, e, min(d, -LOWEST_M) if s.state is State.LANDING else d)
    flags: dict[str, Any] = {
        "manual": True,
        "homing": False,
        "quit": "",
        "asked_heading": None,
        "motors": "fly",
    }
    return rest(s, why, place, at.heading, motion=brake, ready_s=s.time_s, **flags)


def go_on(plan: MissionPlan, s: MissionState, first: int | None) -> MissionState:
    """Start signal in flight: go on with the mission, or with another waypoint of it."""
    n = len(plan.mission.waypoint)
    over = s.outcome == "succeeded" or s.index >= n
    index = first if first is not None else 0 if over else s.index
    if s.state is State.WAYPOINT and not s.manual and index == s.index:
        return s
    why = Words.GOES_ON() if s.begun and not over else Words.BEGINS()
    if first is not None:
        why = Words.ON_TO(first + 1)
    s = replace(log(s, why), ready_s=s.time_s) if s.state is State.HOVER else pause(plan, s, why)
    return replace(s, manual=False, begun=True, index=index, outcome="", reason="", quit="")


def go_on_after_take_off(s: MissionState, first: int | None) -> MissionState:
    """Start signal during a take-off: the mission follows, from waypoint ``first`` (from 0) if given."""
    s = log(s, Words.FOLLOWS_FROM(first + 1) if first else Words.FOLLOWS())
    return replace(s, manual=False, begun=True, index=first or 0, quit="", halt=False)


def return_home(plan: MissionPlan, s: MissionState) -> MissionState:
    """Return signal: to above where it took off, and down."""
    return (
        s
        if s.homing
        else go_home(
            plan, _broken_off(plan, s, Words.RETURN_EARLY_LAST, Words.RETURN_EARLY), Words.RETURN_SIGNAL()
        )
    )


def land_now(plan: MissionPlan, s: MissionState) -> MissionState:
    """Land signal."""
    return land(_broken_off(plan, s, Words.LAND_EARLY_LAST, Words.LAND_EARLY), Words.LAND_SIGNAL())


def _broken_off(plan: MissionPlan, s: MissionState, last: Words, early: Words) -> MissionState:
    left = len(plan.mission.waypoint) - s.index
    if not s.begun or left <= 0:
        return s
    return replace(s, quit=(early if left > 1 else last)(left))


# RC


def to_hand(s: MissionState, m: Estimate) -> MissionState:
    """RC signal: the pilot takes over, from any state."""
    x, psi = measured_at(m), float(m.attitude[2])
    return enter(s, State.RC, Words.RC_ON(), hold=x, heading=psi, detour=None, homing=False, sink=0.0)


def by_hand(s: MissionState, m: Estimate, c: Command, dt: float) -> MissionState:
    """The pilot's sticks move the references of height and heading; a climb from the floor starts the rotors."""
    if s.motors == "off":
        x = measured_at(m)
        if c.climb <= 0.0:
            return replace(s, hold=x, heading=float(m.attitude[2]), sink=0.0)
        s = replace(s, started=True, begun=False, manual=True, index=0, reached=0, standing=x)
        s = replace(s, outcome="", reason="", quit="", finished=False)
        return replace(s, motors="spin_up", clock_s=0.0, hold=x)
    if s.motors == "spin_up":
        return replace(s, motors="fly") if spun_up(s, m) else s
    # The reference stays near the helicopter, so that the sticks answer at once.
    depth = min(max(s.hold[2] - c.climb * dt, m.position[2] - 0.5), m.position[2] + 0.5)
    n, e, _ = measured_at(m)
    return replace(s, hold=(n, e, depth), heading=s.heading + c.yaw_rate * dt, sink=-c.climb)


def from_hand(s: MissionState, m: Estimate) -> MissionState:
    """RC off: hover where it is, or back to init on the floor."""
    x, psi = measured_at(m), float(m.attitude[2])
    if s.motors != "fly" or _lies(s, m):
        if s.begun and s.outcome == "":
            s = fail(s, Words.BY_PILOT())
        elif s.started and s.outcome == "":
            s = replace(s, outcome="succeeded", reason=Words.BY_PILOT())
        return _down(s, Words.RC_OFF_FLOOR())
    brake = stop(x, m.velocity, psi, BRAKE_M_S2)
    n, e, d = brake.at(math.inf).position
    if d > s.standing[2]:
        # It falls too fast to stop above the floor. The reference must not lead below it, and the helicopter brakes all
        # it can. A stop's way down goes with the rate of descent w times the speed: w sqrt(u^2 + w^2) for a level u.
        u, w = length(float(m.velocity[0]), float(m.velocity[1])), float(m.velocity[2])
        most = max(0.0, s.standing[2] - x[2]) / (d - x[2]) * w * length(u, w)
        w = math.sqrt(0.5 * (length(u * u, 2.0 * most) - u * u))
        brake = stop(x, (m.velocity[0], m.velocity[1], w), psi, BRAKE_M_S2)
        n, e, d = brake.at(math.inf).position
    at = (n, e, d)
    return rest(s, Words.RC_OFF(), at, psi, motion=brake, manual=True)


def _lies(s: MissionState, m: Estimate) -> bool:
    return bool(m.position[2] > s.standing[2] - 0.1 and abs(m.velocity[2]) < 0.1)


def _down(s: MissionState, why: str) -> MissionState:
    running = s.motors != "off"
    return enter(
        s, State.INIT, why, motors="ramp_down" if running else "off", finished=s.outcome != "" and not running
    )


# set-points


def to_set_points(s: MissionState, m: Estimate, wanted: SetPoint) -> MissionState:
    """A program takes over in flight; or on the floor, once it wants to go up."""
    if fault_of(wanted):
        return s
    if s.state is not State.INIT:
        return enter(
            s,
            State.OFFBOARD,
            Words.OFFBOARD(),
            tracker=onward(s),
            detour=None,
            manual=True,
            homing=False,
        )
    x = measured_at(m)
    if not wants_up(wanted, x):
        return s
    return enter(anew(s, m, manual=True), State.OFFBOARD, Words.OFFBOARD_UP(), motors="spin_up")


def track(plan: MissionPlan, s: MissionState, m: Estimate, c: Command, dt: float) -> MissionState:
    """Follow the set-point, no faster than the mission's limits and into nothing that the beams have seen."""
    if s.motors == "spin_up":
        if not spun_up(s, m):
            return s
        s = replace(s, motors="fly", tracker=point(replace(s, motion=None)))
    # It was begun for the end of the step in which it was entered.
    if c.set_point is None or s.tracker is None or s.entered_s == s.time_s or fault_of(c.set_point):
        return s
    here = measured_at(m)

    def clear(vn: float, ve: float) -> tuple[float, float]:
        return hold_off(s.sight, here, (vn, ve), plan.mission.avoidance.clearance_m)

    guard = clear if plan.avoid and s.memory.used else None
    t = follow(s.tracker, c.set_point, plan.limits, here, dt, guard)
    return replace(s, tracker=t, hold=t.position, goal=t.position, heading=t.heading)


def from_set_points(plan: MissionPlan, s: MissionState, m: Estimate) -> MissionState:
    """No more set-points: hover where the reference comes to rest, or stay on the floor."""
    if s.motors != "fly" or _lies(s, m):
        s = replace(s, outcome="succeeded", reason=Words.LANDED()) if s.outcome == "" else s
        return _down(s, Words.OFFBOARD_OFF_FLOOR())
    return pause(plan, s, Words.OFFBOARD_OFF())
