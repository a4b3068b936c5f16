"""The flight software, armed: motors run only while it is, and whoever asks learns why it cannot be.

It steps the software, turns what was asked into its signals, keeps the clock on what has to be repeated, disarms, and
tells what happened. What may be asked is in :mod:`mufly.flight.autopilot`, which this is one half of.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import replace

import numpy as np

from mufly.control import FlightController
from mufly.dynamics import hover_performance
from mufly.flight.answers import ACCEPTED, Answer, Status, later, never
from mufly.flight.arming import mission_fault, not_ready
from mufly.flight.controllers import Actuators
from mufly.flight.parameter_table import Parameter
from mufly.flight.parameters import Parameters
from mufly.flight.software import FlightSoftware
from mufly.logs.layout import Event
from mufly.mission import NO_SIGNAL, Command, Mission, SetPoint
from mufly.sensors import Measurement
from mufly.vehicle import Vehicle

__all__ = ["SET_POINT_S", "STICKS_S", "UNUSED_S", "ArmedSoftware"]

UNUSED_S = 10.0
"""After arming without a take-off it disarms (s)."""

SET_POINT_S, STICKS_S = 0.5, 1.0
"""For how long a set-point, and the position of the sticks, hold (s)."""

STOPPING = "its motors are being stopped; ask again"
"""Why nothing is taken between a stop and the step that carries it out."""

KEPT_EVENTS = 1000
_IDLE = Actuators.idle()


class ArmedSoftware:
    """A :class:`FlightSoftware` whose motors run only while it is armed.

    Parameters as of :class:`mufly.flight.Autopilot`.
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
        # A clock that was set back goes on; one that stands still has nothing new to say.
        alive = math.isfinite(t) and t != self._heard_s
        self._stale_s = 0.0 if alive else self._stale_s + self._period_s
        # What expires does so by counting periods where the clock of the measurements does not serve.
        self._now = t if alive and t >= self._now else self._now + self._period_s
        if alive:
            self._heard_s = t
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
        if self._stopping or self.software.motors != "off":
            # Armed now, motors that still run would be given back what was taken from them.
            return later(STOPPING)
        why = self.not_ready() if not force else [self.crashed] if self.crashed else []
        if self._sticks is not None and self._sticks.climb > 0.0:
            why.append("the climb stick is up; lower it first")
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

    @property
    def _stopping(self) -> bool:
        """Whether a stop has been asked for that the next step carries out."""
        return bool(self._command.stop)

    def _stop(self, why: str) -> None:
        idle = self.software.motors == "off" and self.software.state == "init"
        self._disarm()
        self._sticks = None
        if idle:
            self.note(why, "error" if "stop" in why else "info")
        else:
            self._command = Command(stop=why)

    def _in_the_air(self) -> bool:
        """Off the floor: by how it is flown, and by height unless that is not known."""
        m, s = self._measured, self.software.mission_state
        if not self.software.flying or m is None or s is None:
            return False
        height = s.standing[2] - float(m.position[2])
        lies = height < 0.05 and float(np.abs(m.velocity).max()) < 0.1
        return not lies

    def _height(self) -> float:
        m, s = self._measured, self.software.mission_state
        return 0.0 if m is None or s is None else s.standing[2] - float(m.position[2])

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
