"""The autopilot: everything that a pilot, a program or a link may ask of the vehicle, and when it is refused.

It stands between whoever commands and the flight software. Each request answers at once, and what it asks for happens
in the next step; the mission's state machine (:mod:`mufly.mission.machine`) hears it when its logic runs next, within
20 ms. The clock is that of the measurements. Nothing here knows of MAVLink or of the simulator.

Motors run only while it is armed. It disarms by itself once it has landed, and ten seconds after arming if it has not
taken off. Sticks have to be repeated within a second, set-points within half a second; without, it stops and hovers.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from mufly.errors import InputError
from mufly.flight.answers import ACCEPTED, Answer, later, never
from mufly.flight.armed import SET_POINT_S, STICKS_S, STOPPING, UNUSED_S, ArmedSoftware
from mufly.flight.arming import column_fault, place_fault
from mufly.mission import (
    GO_AROUND_M,
    HIGHEST_M,
    LOWEST_M,
    NO_SIGNAL,
    OFF_FLOOR_M,
    Command,
    Mission,
    SetPoint,
    fault_of,
    waypoint_fault,
)

__all__ = ["SET_POINT_S", "STICKS_S", "UNUSED_S", "Autopilot"]


class Autopilot(ArmedSoftware):
    """The flight software of one vehicle, armed and commanded.

    ``listeners`` are called with every event as it happens; ``crashed`` is set by a simulation that knows.

    Parameters
    ----------
    vehicle : Vehicle
    controller : FlightController
        From :func:`mufly.control.design`.
    mission : Mission
        Checked; one without waypoints is no mission, but has limits and surroundings.

    Raises
    ------
    InputError
        If the mission does not suit the vehicle, or that cannot hover.
    """

    # flight

    def take_off(self, height_m: float | None = None) -> Answer:
        """Take off to a height above the floor (m; by default parameter MIS_TAKEOFF_ALT) and hover."""
        if height_m is None:
            height_m = self.software.plan.mission.take_off.height_m
        if not (math.isfinite(height_m) and LOWEST_M <= height_m <= HIGHEST_M):
            return never(f"take-off height {height_m:g} m refused: give {LOWEST_M:g} to {HIGHEST_M:g} m")
        answer = self._may_take_off(height_m)
        return self._ask(Command(take_off=float(height_m))) if answer else answer

    def _may_take_off(self, height_m: float) -> Answer:
        if self.software.motors != "off" or self.software.state != "init":
            return later(f"it is in state {self.software.state!r} already")
        if not self._armed:
            return later("not armed; arm first")
        m, mission = self._measured, self.software.plan.mission
        if m is not None and np.isfinite(m.position).all():
            place = (float(m.position[0]), float(m.position[1]), float(m.position[2]))
            fault = column_fault(mission.world, place, height_m, mission.avoidance.clearance_m)
            if fault:
                return later(f"no take-off to {height_m:g} m here: {fault}")
        return ACCEPTED

    def start_mission(self, first: int | None = None) -> Answer:
        """On the floor: take off and fly the mission; in the air: go on, or from waypoint ``first`` (from 0)."""
        n = len(self.software.plan.mission.waypoint)
        if n == 0:
            return later("no mission loaded; load one first")
        if first is not None and not 0 <= first < n:
            return never(f"waypoint {first} refused: the mission has 0 to {n - 1}")
        if self.software.state == "init":
            answer = self._may_take_off(self.software.plan.mission.take_off.height_m)
            if answer and self._measured is not None:
                fault = self._mission_fault(self._measured)
                answer = later(fault) if fault else answer
        else:
            # Set-points that have not lifted it off leave nothing to go on from.
            answer = self._may_command(OFF_FLOOR_M if self.software.state == "offboard" else -math.inf)
        return self._ask(Command(start=True, first=first)) if answer else answer

    def pause(self) -> Answer:
        """Stop and hover; :meth:`start_mission` goes on. Breaks off a landing that is still above 0.4 m."""
        state = self.software.state
        if state == "landing" and self.software.outcome != "failed" and self.software.motors == "fly":
            if self._height() <= GO_AROUND_M:
                return later(f"landing, and below {GO_AROUND_M:g} m already")
            return self._ask(Command(pause=True))
        return self._do(Command(pause=True), OFF_FLOOR_M)

    def go_to(self, position_m: Sequence[float], heading_rad: float | None = None) -> Answer:
        """Fly to a place (N, E, D; m) and hold there, with a heading on the way if given; the mission waits."""
        if len(position_m) != 3:
            return never("a place needs three numbers: N, E, D")
        place = (float(position_m[0]), float(position_m[1]), float(position_m[2]))
        heading = None if heading_rad is None or math.isnan(heading_rad) else float(heading_rad)
        fault = waypoint_fault(place, heading)
        if fault:
            return never(fault)
        mission = self.software.plan.mission
        fault = place_fault(mission.world, place, mission.avoidance.clearance_m)
        if fault:
            return never(f"[{place[0]:g}, {place[1]:g}, {place[2]:g}] refused: {fault}")
        return self._do(Command(waypoint=place, heading=heading), OFF_FLOOR_M)

    def turn_to(self, heading_rad: float) -> Answer:
        """Stop, and turn on the spot to a heading (rad, from north to east)."""
        fault = waypoint_fault(None, heading_rad)
        return never(fault) if fault else self._do(Command(heading=float(heading_rad)), OFF_FLOOR_M)

    def set_speed(self, speed_m_s: float) -> Answer:
        """Horizontal speed from the next leg on: parameter LIM_SPEED."""
        answer = self.set_parameter("LIM_SPEED", speed_m_s)
        underway = answer and self.software.state in ("waypoint", "obstacle")
        return Answer(True, "from the next leg on") if underway else answer

    def return_home(self) -> Answer:
        """Fly to above where it took off, no lower than now, and land."""
        return self._do(Command(home=True), OFF_FLOOR_M)

    def land(self) -> Answer:
        """Land where it comes to rest."""
        if self.software.state == "landing":
            return ACCEPTED
        return self._do(Command(land=True), -math.inf)

    def _ask(self, command: Command) -> Answer:
        """Hand a request to the mission logic, unless the motors are about to stop: nothing may take its place."""
        if self._stopping:
            return later(STOPPING)
        self._offboard = False
        self._command = command
        return ACCEPTED

    def _do(self, command: Command, above_m: float) -> Answer:
        answer = self._may_command(above_m)
        return self._ask(command) if answer else answer

    def _may_command(self, above_m: float = -math.inf) -> Answer:
        software = self.software
        state = software.state
        if state == "init":
            return later("it does not fly; take off first")
        if software.motors == "blind":
            return later("measurements are lost; it comes down by itself")
        if state == "rc":
            return later("the pilot flies; let go of the sticks first")
        if software.outcome == "failed":
            return later(f"it lands: {software.reason}")
        if state == "landing":
            return later(f"it lands; pause first (above {GO_AROUND_M:g} m)")
        if self._height() < above_m and state in ("take-off", "offboard"):
            return later(f"taking off; wait until it is {above_m:g} m off the floor")
        return ACCEPTED

    # set-points and sticks

    def set_point(self, s: SetPoint) -> Answer:
        """Take a set-point; it is followed while :meth:`offboard` is on."""
        fault = fault_of(s)
        if fault:
            return never(f"set-point refused: {fault}")
        self._set_point, self._set_point_s = s, self._now
        return ACCEPTED

    def offboard(self, on: bool) -> Answer:
        """Follow set-points from now on, or no more. It needs one that is younger than half a second."""
        if not on:
            if self._offboard:
                self._offboard = False
                if self.software.state == "offboard" and self._command == NO_SIGNAL:
                    self._command = Command(pause=True)
            return ACCEPTED
        if self._now - self._set_point_s > SET_POINT_S or self._set_point is None:
            return later(f"no set-point in the last {SET_POINT_S:g} s; stream them first")
        if self._stopping:
            return later(STOPPING)
        if self.software.state not in ("init", "offboard"):
            answer = self._may_command(OFF_FLOOR_M)
            if not answer:
                return answer
        self._offboard = True
        return ACCEPTED

    def sticks(self, roll_rad: float, pitch_rad: float, yaw_rate_rad_s: float, climb_m_s: float) -> Answer:
        """The pilot's sticks (rad, rad/s, m/s upwards), limited by the STK_ parameters; the state is RC meanwhile."""
        values = (roll_rad, pitch_rad, yaw_rate_rad_s, climb_m_s)
        if not all(math.isfinite(v) for v in values):
            return never("sticks refused: give finite numbers")
        if self.software.motors == "blind":
            return later("measurements are lost; it comes down by itself")
        most = self._parameters.sticks
        roll, pitch, turn, climb = (
            min(max(float(v), -limit), limit)
            for v, limit in zip(values, (most.tilt, most.tilt, most.yaw_rate, most.climb), strict=True)
        )
        self._offboard = False
        self._sticks = Command(rc=True, roll=roll, pitch=pitch, yaw_rate=turn, climb=climb)
        self._sticks_s = self._now
        return ACCEPTED

    def sticks_off(self) -> Answer:
        """The pilot lets go: it hovers, or stays on the floor."""
        self._sticks = None
        return ACCEPTED

    # mission and parameters

    def load_mission(self, mission: Mission) -> Answer:
        """Take another mission, whole or not at all; on the floor, or in a hover in which none is being flown."""
        software = self.software
        s = software.mission_state
        if software.state not in ("init", "hover") or software.motors not in ("off", "fly"):
            return later(f"in state {software.state!r} no mission is taken; pause or land first")
        if s is not None and software.state == "hover" and not s.manual:
            return later("a mission is being flown; pause it first")
        if s is not None and software.state == "hover" and s.outcome == "failed":
            return later(f"it lands: {s.reason}")
        if self._command is not NO_SIGNAL:
            return later("another request is being carried out; ask again")
        m = self._measured
        known = m is not None and bool(np.isfinite(m.position).all())
        n, e = (float(m.position[0]), float(m.position[1])) if m is not None and known else mission.start_m
        fault = self._fault_of(mission, (n, e), float(m.attitude[2]) if m is not None and known else 0.0)
        if fault:
            return never(fault)
        try:
            software.load(mission)
        except InputError as error:
            return never(str(error))
        return ACCEPTED
