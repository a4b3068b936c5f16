"""The mission state machine (Fig. 6.15) as a pure function of time steps.

    init --start--> take-off --altitude reached--> hover --waypoint--> waypoint --goal reached--> hover ...
    take-off, hover, waypoint --obstacle detected--> obstacle --obstacle avoided--> back to where it came from
    take-off --failed--> init (never lifted off) or landing
    any flying state --land signal, battery low--> landing --touchdown--> init
    any state --RC--> RC --RC off--> hover, or init when it stands on the floor

After the start signal the machine gives itself the waypoint signals of the mission file, and the land signal after
the last one; signals of the user override it. Each change of state is kept with its reason in `MissionState.events`.

One step takes what was measured and commanded and returns the next state and the `Reference` for the controllers. It
runs at 50 Hz or so. Trajectories are made at transitions; a step in between only evaluates one. What each state does
by itself is in `mufly.mission.phases`.
"""

from __future__ import annotations

import math
from dataclasses import replace

from mufly.mission import phases
from mufly.mission.obstacles import observe
from mufly.mission.reference import at_gate, reference, swing
from mufly.mission.signals import Command, MissionPlan, MissionState, Reference, State, enter, fail, log
from mufly.mission.trajectory import Trajectory
from mufly.sensors import Measurement

__all__ = ["step"]

_FLYING = frozenset({State.TAKE_OFF, State.HOVER, State.WAYPOINT, State.OBSTACLE})
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
    State.LANDING: phases.sink,
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
    if c.rc:
        return phases.by_hand(s if s.state is State.RC else phases.to_hand(s, m), m, c, dt)
    if s.state is State.RC:
        return phases.from_hand(s, m)
    if s.state is State.INIT:
        return phases.start(plan, s, m) if c.start and s.motors == "off" else s
    low = m.position[2] > s.standing[2] - 0.3
    if low and s.motors != "off" and max(abs(m.attitude[0]), abs(m.attitude[1])) > _TIPPED:
        s = fail(s, "tipped over")
        return enter(s, State.INIT, "tipped over, motors off", motors="off", finished=True, motion=None)
    if s.state not in _FLYING:
        return s
    if s.low_s > _LOW_FOR_S:
        why = f"battery low: {s.battery_V:.2f} V, below {plan.low_V:.2f} V"
        return phases.land(fail(s, why), why)
    if c.land:
        rest = len(plan.mission.waypoint) - s.index
        if rest > 0:
            s = fail(s, f"land signal with {rest} waypoint{'s' if rest > 1 else ''} to go")
        return phases.land(s, "land signal")
    if c.waypoint is not None and s.state is not State.TAKE_OFF:
        return phases.to_users_waypoint(plan, s, c.waypoint)
    if c.start and s.state is State.HOVER and s.manual and s.outcome == "":
        return replace(s, manual=False, ready_s=s.time_s, events=log(s, "the mission goes on"))
    return s
