"""The autopilot: everything that a pilot, a program or a link may ask of the vehicle, and when it is refused.

It stands between whoever commands and the flight software. Each request answers at once, and what it asks for happens
in the next step; the mission's state machine (:mod:`mufly.mission.machine`) hears it when its logic runs next, within
20 ms. The clock is that of the measurements. Nothing here knows of MAVLink or of the simulator.

Motors run only while it is armed. It disarms by itself once it has landed, and ten seconds after arming if it has not
taken off. Sticks have to be repeated within a second, set-points within half a second; without, it stops and hovers.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

import numpy as np

from mufly.control import FlightController
from mufly.dynamics import hover_performance
from mufly.errors import InputError
from mufly.flight.answers import ACCEPTED, Answer, Status, later, never
from mufly.flight.arming import column_fault, mission_fault, not_ready, place_fault
from mufly.flight.controllers import Actuators
from mufly.flight.parameters import Parameter, Parameters
from mufly.flight.software import FlightSoftware
from mufly.logs.layout import Event
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
from mufly.sensors import Measurement
from mufly.vehicle import Vehicle

__all__ = ["Autopilot"]

UNUSED_S = 10.0
"""After arming without a take-off it disarms (s)."""

SET_POINT_S, STICKS_S = 0.5, 1.0
"""For how long a set-point, and the position of the sticks, hold (s)."""

KEPT_EVENTS = 1000
_IDLE = Actuators.idle()


class Autopilot:
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

    def __init__(self, vehicle: Vehicle, controller: FlightController, mission: Mission) -> None:
        self.software = FlightSoftware(vehicle, controller, mission)
        self.listeners: list[Callable[[Event], None]] = []
        self.hover_A = float(hover_performance(vehicle).current_A)
        self._capacity_Ah = float(vehicle.battery.capacity) / 3600.0
        self._radius_m = float(vehicle.rotors.radius)
        self._period_s = 1.0 / controller.rate_Hz
        self._parameters = Parameters(vehicle, controller, self.software)
        self._outbox: deque[Event] = deque(maxlen=KEPT_EVENTS)
        self._begin()

    def _begin(self) -> None:
        self.crashed = ""
        self._armed, self._armed_s = False, 0.0
        self._ran = False
        self._command = NO_SIGNAL
        self._sticks: Command | None = None
        self._sticks_s = 0.0
        self._set_point: SetPoint | None = None
        self._set_point_s = -math.inf
        self._offboard = False
        self._measured: Measurement | None = None
        self._now, self._heard_s = 0.0, -math.inf
        self._stale_s = 0.0
        self._logged = 0
        self._suits: tuple[Mission | None, tuple[float, ...], str] = (None, (), "")

    def reset(self) -> None:
        """Forget the flight, disarmed; mission and parameters stay."""
        self.software.reset()
        self._begin()

    # one period

    def observe(self, measured: Measurement) -> None:
        """Take notice of a measurement without a step: what arming is judged by before the first one."""
        t = measured.time_s
        if t > self._heard_s:
            self._heard_s, self._stale_s = t, 0.0
            self._now = t if t >= self._now else self._now + self._period_s
        else:
            # Their clock stands still; what expires does so by counting periods.
            self._stale_s += self._period_s
            self._now += self._period_s
        self._measured = measured

    def step(self, measured: Measurement) -> Actuators:
        """Advance by one period.

        Parameters
        ----------
        measured : Measurement

        Returns
        -------
        Actuators
            All zero while it is not armed.
        """
        self.observe(measured)
        software = self.software
        due = software.due
        actuators = software.step(measured, self._wanted() if due or self._command.stop else NO_SIGNAL)
        if due:
            if software.logged != self._logged:
                self._report()
            self._look_after()
        # While the software has its motors off, what it gives is zero too.
        return actuators if self._armed or software.motors == "off" else _IDLE

    def _wanted(self) -> Command:
        """The signals for the mission logic: what was asked once, and what holds for as long as it is repeated."""
        c, self._command = self._command, NO_SIGNAL
        if self._sticks is not None:
            if self._now - self._sticks_s > STICKS_S:
                self._sticks = None
                self.note(f"sticks lost: nothing heard of them for {STICKS_S:g} s", "warning")
            else:
                climb = self._sticks.climb if self._armed else min(self._sticks.climb, 0.0)
                c = replace(self._sticks, climb=climb, stop=c.stop)
        if self._offboard:
            if self._now - self._set_point_s > SET_POINT_S:
                self._offboard = False
                self.note(f"set-points lost: none for {SET_POINT_S:g} s", "warning")
            elif self._armed:
                c = replace(c, set_point=self._set_point)
        return c

    def _look_after(self) -> None:
        """What follows from how the step went: disarming, and leaving offboard."""
        software = self.software
        ran, self._ran = self._ran, software.motors != "off"
        if self._offboard and software.state not in ("offboard", "init"):
            self._offboard = False
        if not self._armed:
            return
        if ran and not self._ran:
            self._disarm()
        elif self._ran:
            self._armed_s = self._now
        elif self._now - self._armed_s > UNUSED_S:
            self._disarm()
            self.note(f"disarmed: no take-off within {UNUSED_S:g} s")

    def _disarm(self) -> None:
        self._armed = self._offboard = False
        self._command = NO_SIGNAL

    # arming

    def not_ready(self) -> list[str]:
        """Why it cannot be armed, each a sentence with its remedy; empty: it can."""
        plan = self.software.plan
        m = self._measured
        why = not_ready(m, self._stale_s, plan.low_V, plan.mission.world, self._radius_m, self.crashed)
        if m is not None and not self.crashed and np.isfinite(m.position).all():
            fault = self._mission_fault(m)
            why += [fault] if fault else []
        return why

    def _mission_fault(self, m: Measurement) -> str:
        """Whether the mission suits the place where it stands; asked again only when either has changed."""
        mission = self.software.plan.mission
        north, east = round(float(m.position[0]), 2), round(float(m.position[1]), 2)
        heading = round(float(m.attitude[2]), 1) if math.isfinite(m.attitude[2]) else 0.0
        where = (north, east, heading)
        if self._suits[0] is not mission or self._suits[1] != where:
            self._suits = (mission, where, self._fault_of(mission, (north, east), heading))
        return self._suits[2]

    def _fault_of(self, mission: Mission, standing: tuple[float, float], heading: float) -> str:
        return mission_fault(
            mission, standing, heading, hover_current_A=self.hover_A, capacity_Ah=self._capacity_Ah
        )

    def arm(self, *, force: bool = False, quiet: bool = False) -> Answer:
        """Let the motors run. ``force`` skips all checks but that of a crash; ``quiet`` leaves no note of it."""
        if self._armed:
            return ACCEPTED
        why = self.not_ready() if not force else [self.crashed] if self.crashed else []
        if why:
            more = f" (and {len(why) - 1} more)" if len(why) > 1 else ""
            return later(why[0] + more)
        self._armed, self._armed_s = True, self._now
        if not quiet:
            self.note("armed, by force" if force else "armed")
        return ACCEPTED

    def disarm(self, force: bool = False) -> Answer:
        """Motors off. Refused in flight, unless by ``force``, which is an emergency stop."""
        if force:
            return self.emergency_stop()
        if not self._armed:
            return ACCEPTED
        if self._in_the_air():
            return later("it flies; land first, or stop it by force")
        self._stop("disarmed")
        return ACCEPTED

    def emergency_stop(self) -> Answer:
        """Motors off at once; it falls. Always accepted."""
        self._stop("emergency stop, motors off")
        return ACCEPTED

    def _stop(self, why: str) -> None:
        idle = self.software.motors == "off" and self.software.state == "init"
        self._disarm()
        self._sticks = None
        self._command = Command(stop=why)
        if idle:
            self.note(why, "error" if "stop" in why else "info")

    def _in_the_air(self) -> bool:
        """Off the floor: by how it is flown, and by height unless that is not known."""
        m, s = self._measured, self.software.mission_state
        if not self.software.flying or m is None or s is None:
            return False
        height = s.standing[2] - float(m.position[2])
        lies = height < 0.05 and float(np.abs(m.velocity).max()) < 0.1
        return not lies

    # flight

    def take_off(self, height_m: float | None = None) -> Answer:
        """Take off to a height above the floor (m; by default parameter MIS_TAKEOFF_ALT) and hover."""
        if height_m is None:
            height_m = self.software.plan.mission.take_off.height_m
        if not (math.isfinite(height_m) and LOWEST_M <= height_m <= HIGHEST_M):
            return never(f"take-off height {height_m:g} m refused: give {LOWEST_M:g} to {HIGHEST_M:g} m")
        answer = self._may_take_off(height_m)
        if answer:
            self._ask(Command(take_off=float(height_m)))
        return answer

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
            answer = self._may_command()
        if answer:
            self._ask(Command(start=True, first=first))
        return answer

    def pause(self) -> Answer:
        """Stop and hover; :meth:`start_mission` goes on. Breaks off a landing that is still above 0.4 m."""
        state = self.software.state
        if state == "landing" and self.software.outcome != "failed" and self.software.motors == "fly":
            if self._height() <= GO_AROUND_M:
                return later(f"landing, and below {GO_AROUND_M:g} m already")
            return self._accept(Command(pause=True))
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

    def _ask(self, command: Command) -> None:
        self._offboard = False
        self._command = command

    def _accept(self, command: Command) -> Answer:
        self._ask(command)
        return ACCEPTED

    def _do(self, command: Command, above_m: float) -> Answer:
        answer = self._may_command(above_m)
        return self._accept(command) if answer else answer

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

    def _height(self) -> float:
        m, s = self._measured, self.software.mission_state
        return 0.0 if m is None or s is None else s.standing[2] - float(m.position[2])

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
        if self.software.state != "init":
            answer = self._may_command()
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

    @property
    def parameters(self) -> Mapping[str, Parameter]:
        """Everything that may be tuned, by name."""
        return self._parameters

    def set_parameter(self, name: str, value: float) -> Answer:
        """Tune one number; it acts at once."""
        fault = self._parameters.set(name, float(value))
        return never(fault) if fault else ACCEPTED

    # what there is to know

    @property
    def status(self) -> Status:
        """How the vehicle is, now."""
        software = self.software
        s = software.mission_state
        state = software.state
        home = None if s is None or not s.started else s.standing
        in_air = state not in ("init", "rc")
        return Status(
            armed=self._armed,
            flying=self._in_the_air(),
            landed=software.motors in ("off", "ramp_down"),
            state=state,
            motors=software.motors,
            mission_running=bool(s is not None and s.begun and not s.manual and in_air and not s.outcome),
            begun=s is not None and s.begun,
            manual=s is not None and s.manual,
            homing=s is not None and s.homing,
            waypoint=0 if s is None else s.index,
            reached=0 if s is None else s.reached,
            offboard=self._offboard,
            sticks=self._sticks is not None,
            outcome=software.outcome,
            reason=software.reason,
            mission=software.asked,
            home=home,
            goal=s.goal if s is not None and in_air else None,
            crashed=self.crashed,
        )

    def note(self, text: str, level: str = "info") -> None:
        """Put a line into the log of events."""
        self._emit(Event(self._now, self.software.state, text, level))

    def events(self) -> list[Event]:
        """What happened since the last call; the latest thousand if nobody asked for long."""
        out = list(self._outbox)
        self._outbox.clear()
        return out

    def _report(self) -> None:
        events, logged = self.software.events, self.software.logged
        fresh = min(logged - self._logged, len(events)) if logged > self._logged else len(events)
        self._logged = logged
        for e in events[len(events) - fresh :]:
            self._emit(Event(e.time_s, str(e.state), e.text, e.level))

    def _emit(self, event: Event) -> None:
        self._outbox.append(event)
        for listener in self.listeners:
            listener(event)
