"""The flight software: what runs on board, as a function of time steps.

``step(measurement, command) -> actuators``, called at the control design's rate. It knows nothing of the simulator.
The mission logic runs in every n-th step, with the position cascade (50 Hz), and says what the motors are to do and
what to follow:

=========== =========================================================================================
off         motors and servos at rest
spin_up     motor inputs rise to 0.9 of hover, too little to lift off; servos at trim
fly         heave-yaw controller; from 2 cm above the floor also roll-pitch and, every n-th step, position
ramp_down   after touchdown motor inputs fall to zero
=========== =========================================================================================

Between two steps of the mission logic its reference is carried on at the reference velocity.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from mufly.control import FlightController
from mufly.flight.controllers import Actuators, Controllers
from mufly.mission import Command, Event, Mission, MissionState, Reference, begin, prepare, step
from mufly.mission.phases import RAMP_DOWN_S
from mufly.mission.plan import SPIN_UP_S
from mufly.sensors import Measurement
from mufly.vehicle import Vehicle

__all__ = ["FlightSoftware"]

SPIN_UP_SHARE = 0.9
LIFT_OFF_M = 0.02


class FlightSoftware:
    """Mission logic and controllers of one vehicle.

    Parameters
    ----------
    vehicle : Vehicle
        For its range ring and battery limit.
    controller : FlightController
        From :func:`mufly.control.design`.
    mission : Mission
        Checked.

    Raises
    ------
    InputError
        If the mission does not suit the vehicle.
    """

    def __init__(self, vehicle: Vehicle, controller: FlightController, mission: Mission) -> None:
        self._plan = prepare(mission, vehicle)
        self._controller = controller
        self._period_s = 1.0 / controller.rate_Hz
        self._every = controller.position_divider
        self._mission: MissionState | None = None
        self._reference = Reference(np.zeros(3), np.zeros(3), np.zeros(3), 0.0, 0.0, "off")
        self._command = Command()
        self._ticks = 0
        self._motors = "off"
        self._since_s = 0.0
        self._motor_input: NDArray[np.floating[Any]] = np.zeros(2)
        self._tilt: NDArray[np.floating[Any]] = np.zeros(2)
        self._controllers = Controllers(controller)
        self._floor, self._lifted = 0.0, False

    @property
    def state(self) -> str:
        """State of the mission (Fig. 6.15)."""
        return "init" if self._mission is None else str(self._mission.state)

    @property
    def finished(self) -> bool:
        """Whether the mission is over and the motors are off."""
        return self._mission is not None and self._mission.finished

    @property
    def outcome(self) -> str:
        """``"succeeded"``, ``"failed"``, or ``""`` while it is open."""
        return "" if self._mission is None else self._mission.outcome

    @property
    def reason(self) -> str:
        """Why it failed."""
        return "" if self._mission is None else self._mission.reason

    @property
    def events(self) -> tuple[Event, ...]:
        """Every change of state so far, with its reason."""
        return () if self._mission is None else self._mission.events

    @property
    def reference(self) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
        """What is being followed: position, velocity (N-E-D), and roll, pitch, yaw."""
        r = self._reference
        return r.position, r.velocity, np.array([self._tilt[0], self._tilt[1], r.heading])

    def step(self, measured: Measurement, command: Command) -> Actuators:
        """Advance by one period.

        Parameters
        ----------
        measured : Measurement
        command : Command
            The user's signals; one given between two steps of the mission logic is kept for the next.

        Returns
        -------
        Actuators
        """
        if self._mission is None:
            self._mission = begin(self._plan, measured)
        if command != _NO_COMMAND:
            self._command = command
        late_s = (self._ticks % self._every) * self._period_s
        if late_s == 0.0:
            self._mission, self._reference = step(self._plan, self._mission, measured, self._command)
            self._command = Command()
        self._ticks += 1
        r = self._reference
        if r.motors != self._motors:
            self._switch(r.motors, measured)
        if r.motors == "fly":
            return self._fly(r, measured, late_s)
        return self._on_the_floor(r.motors, measured)

    def _switch(self, motors: str, m: Measurement) -> None:
        """Engage or release the controllers without a bump."""
        if motors == "fly":
            self._controllers.engage(m, self._motor_input)
            self._floor, self._lifted = float(m.position[2]), False
        self._motors, self._since_s = motors, m.time_s
        self._released = self._motor_input

    def _on_the_floor(self, motors: str, m: Measurement) -> Actuators:
        elapsed = m.time_s - self._since_s
        if motors == "spin_up":
            # Half of the time to rise, half for the slow upper rotor to follow.
            share = SPIN_UP_SHARE * min(1.0, 2.0 * elapsed / SPIN_UP_S)
            self._motor_input = np.minimum(
                share * self._controller.motor_trim * self._controller.voltage_V / m.battery_voltage, 1.0
            )
        elif motors == "ramp_down":
            self._motor_input = self._released * max(0.0, 1.0 - elapsed / RAMP_DOWN_S)
        else:
            self._motor_input = np.zeros(2)
        self._tilt = np.zeros(2)
        return Actuators(self._motor_input, np.zeros(2))

    def _fly(self, r: Reference, m: Measurement, late_s: float) -> Actuators:
        if not self._lifted and m.position[2] < self._floor - LIFT_OFF_M:
            self._lifted = True
            self._controllers.lift_off(m)
        if not self._lifted:
            self._tilt = np.zeros(2)
        elif r.rc:
            self._tilt = np.array([r.roll, r.pitch])
        elif late_s == 0.0:
            self._tilt = self._controllers.tilt_for(m, r.position, r.velocity, r.acceleration)
        down, turn = float(r.velocity[2]), r.heading_rate
        heave_yaw = np.array([r.position[2] + late_s * down, r.heading + late_s * turn, down, turn])
        actuators = self._controllers.step(m, heave_yaw, self._tilt if self._lifted else None)
        self._motor_input = actuators.motor_input
        return actuators


_NO_COMMAND = Command()
