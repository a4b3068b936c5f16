"""The mission state machine (Fig. 6.15) as a pure function of time steps.

    init --start--> take-off --altitude reached--> hover --waypoint--> waypoint --goal reached--> hover ...
    take-off, hover, waypoint --obstacle detected--> obstacle --obstacle avoided--> back to where it came from
    take-off --failed--> init (never lifted off) or landing
    any flying state --land signal, battery low--> landing --touchdown--> init
    any state --RC--> RC --RC off--> hover, or init when it stands on the floor

and what a user of today expects beside it (`mufly.mission.user`):

    init --take-off signal--> take-off --> hover, where the mission waits
    take-off, waypoint, obstacle, landing --pause--> hover --start--> waypoint
    take-off, hover, waypoint, obstacle --return--> waypoint (home) --goal reached--> landing
    init, take-off, hover, waypoint, obstacle --set-points--> offboard --no more--> hover, or init on the floor
    any state --stop--> init, motors off

After the start signal the machine gives itself the waypoint signals of the mission file, and the land signal after
the last one; signals of the user override it. Each change of state is kept with its reason in `MissionState.events`.

One step takes what was measured and commanded and returns the next state and the `Reference` for the controllers. It
runs at 50 Hz or so. Trajectories are made at transitions; a step in between only evaluates one. What each state does
by itself is in `mufly.mission.phases` and `mufly.mission.landing`, what the user's signals do in `mufly.mission.user`,
what happens while a pilot or a program flies in `mufly.mission.takeover`.
"""

from __future__ import annotations

import math
from dataclasses import replace

from mufly.mission import landing, phases, takeover, user
from mufly.mission.obstacles import observe
from mufly.mission.reference import at_gate, reference, swing
from mufly.mission.signals import Command, Reference, State
from mufly.mission.state import MissionPlan, MissionState, fail, log
from mufly.mission.trajectory import Trajectory
from mufly.sensors import Measurement

__all__ = ["step"]

_FLYING = frozenset({State.TAKE_OFF, State.HOVER, State.WAYPOINT, State.OBSTACLE, State.OFFBOARD})
_TIPPED = math.radians(60.0)
_LOW_FOR_S = 1.0
_VOLTAGE_LAG_S = 0.5
_GATE_HEIGHT_M, _GATE_HEADING = 0.1, math.radians(8.0)
_LOOK_AROUND_S = 3.0

_PHASES = {
    State.INIT: phases.stand,
    State.TAKE_OFF: phases.take_off,
    State.HOVER: phases.hover,
    State.WAYPOINT: phases.fly_leg,
    State.OBSTACLE: phases.avoid,
    State.LANDING: landing.sink,
}


def step(
    plan: MissionPlan, state: MissionState, measured: Measurement, command: Command
) -> tuple[MissionState, Reference]:
    """Advance the mission by one step.

    Parameters
    ----------
    plan : MissionPlan
        From `prepare`: the mission and the vehicle's numbers.
    state : MissionState
        From `begin` or the step before.
    measured : Measurement
        Measured now; the time step is the difference of its time and the state's (half a second at most).
    command : Command
        The user's signals.

    Returns
    -------
    state : MissionState
        The new state.
    reference : Reference
        What the controllers have to follow now.
    """
    dt = min(max(measured.time_s - state.time_s, 0.0), 0.5)
    s = _sense(plan, state, measured, dt)
    s = _signals(plan, s, measured, command, dt)
    if s.state is State.OFFBOARD:
        s = takeover.track(plan, s, measured, command, dt)
    phase = _PHASES.get(s.state)
    if phase is not None:
        s = phase(plan, s, measured, dt)
    return s, reference(plan, s, measured, command)


def _sense(plan: MissionPlan, s: MissionState, m: Measurement, dt: float) -> MissionState:
    """Move the clocks, watch the battery, remember what the beams see."""
    clock = s.clock_s + dt
    if s.state is State.WAYPOINT and isinstance(s.motion, Trajectory):
        gate = s.motion.gate_s
        if s.clock_s <= gate < clock and not _gate_open(plan, s, m, s.motion):
            clock = gate
    volts = s.battery_V + (m.battery_voltage - s.battery_V) * min(1.0, dt / _VOLTAGE_LAG_S)
    memory, swinging = s.memory, s.swing
    if plan.avoid and s.state in _FLYING and (memory.used or float(m.ranges.min()) < plan.ring.max_range):
        memory = observe(memory, plan.ring, m.time_s, m.position, m.attitude, m.ranges)
    # Around an obstacle the nose always swings, to see its outline.
    on = s.state is State.OBSTACLE or (plan.scan and s.state is State.WAYPOINT and at_gate(s))
    swinging = min(_LOOK_AROUND_S, swinging + dt) if on else max(0.0, min(1.0, swinging) - dt)
    return replace(
        s,
        time_s=m.time_s,
        clock_s=clock,
        step_s=dt,
        battery_V=volts,
        low_s=s.low_s + dt if volts < plan.low_V else 0.0,
        memory=memory,
        swing=swinging,
    )


def _gate_open(plan: MissionPlan, s: MissionState, m: Measurement, way: Trajectory) -> bool:
    """Whether height and heading are adapted in fact, and the beams have had a look around."""
    at = way.at(way.gate_s)
    angle, _ = swing(plan, s)
    return (
        abs(m.position[2] - at.position[2]) < _GATE_HEIGHT_M
        and abs(m.attitude[2] - at.heading - angle) < _GATE_HEADING + abs(angle)
        and (not plan.scan or s.resumed or way.way.way == 0.0 or s.swing >= _LOOK_AROUND_S)
    )


def _signals(plan: MissionPlan, s: MissionState, m: Measurement, c: Command, dt: float) -> MissionState:
    """Transitions that do not depend on what the present state is busy with."""
    if c.stop:
        return user.stop_at_once(s, c.stop)
    if s.state is not State.INIT and _tipped_over(s, m):
        return user.stop_at_once(fail(s, "tipped over"), "tipped over, motors off")
    # Rotors that run down after touchdown stop first: sticks in their middle must not start them again.
    if c.rc and s.motors != "ramp_down":
        s = s if s.state is State.RC else takeover.to_hand(s, m)
        if s.motors == "fly" and s.low_s - dt <= _LOW_FOR_S < s.low_s:
            s = log(s, f"{_low_words(plan, s)}; land", level="warning")  # the pilot's own decision
        return takeover.by_hand(s, m, c, dt)
    if s.state is State.RC:
        return takeover.from_hand(s, m)
    if s.state is State.INIT:
        return _from_the_floor(plan, s, m, c) if s.motors == "off" else s
    if s.state is State.LANDING:
        high = s.standing[2] - m.position[2] > user.GO_AROUND_M
        wanted = c.pause and high and s.motors == "fly" and s.outcome != "failed"
        return user.pause(plan, s, "landing broken off") if wanted else s
    if s.state not in _FLYING or s.outcome == "failed":
        return s if s.low_s <= _LOW_FOR_S or s.state not in _FLYING else _battery_low(plan, s)
    if s.low_s > _LOW_FOR_S:
        return _battery_low(plan, s)
    if c.land:
        return user.land_now(plan, s)
    if s.state is State.TAKE_OFF and c.start and (s.manual or c.first is not None):
        return user.go_on_after_take_off(s, c.first)
    if s.motors == "spin_up":
        return s if s.state is not State.OFFBOARD or c.set_point else takeover.from_set_points(plan, s, m)
    return _in_flight(plan, s, m, c)


def _tipped_over(s: MissionState, m: Measurement) -> bool:
    near = m.position[2] > s.standing[2] - 0.3
    return bool(near and s.motors != "off" and max(abs(m.attitude[0]), abs(m.attitude[1])) > _TIPPED)


def _from_the_floor(plan: MissionPlan, s: MissionState, m: Measurement, c: Command) -> MissionState:
    if c.start:
        return phases.start(plan, s, m, first=c.first)
    if c.take_off is not None:
        return phases.start(plan, s, m, height=c.take_off)
    return s if c.set_point is None else takeover.to_set_points(s, m, c.set_point)


def _battery_low(plan: MissionPlan, s: MissionState) -> MissionState:
    why = _low_words(plan, s)
    # A mission that is complete and holds has not failed when its battery is used up.
    return landing.land(s if s.outcome == "succeeded" else fail(s, why), why, level="warning")


def _low_words(plan: MissionPlan, s: MissionState) -> str:
    return f"battery low: {s.battery_V:.2f} V, below {plan.low_V:.2f} V"


def _in_flight(plan: MissionPlan, s: MissionState, m: Measurement, c: Command) -> MissionState:
    """What the user wants of a helicopter that flies."""
    if s.state is State.OFFBOARD and c.set_point is None:
        s = takeover.from_set_points(plan, s, m)
        if s.state is State.INIT:
            return s
    if s.state is State.TAKE_OFF and s.standing[2] - m.position[2] < user.OFF_FLOOR_M:
        return s
    if c.pause:
        return user.pause(plan, s)
    if c.home:
        return user.return_home(plan, s)
    if c.set_point is not None:
        return s if s.state is State.OFFBOARD else takeover.to_set_points(s, m, c.set_point)
    if c.waypoint is not None or c.heading is not None:
        return user.to_users_waypoint(plan, s, c.waypoint, c.heading)
    if c.start and s.state is not State.TAKE_OFF and (s.manual or c.first is not None):
        return user.go_on(plan, s, c.first)
    return s
