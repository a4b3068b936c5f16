"""The state of a flight at one instant: the one record that autopilot, link, page and displays read."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from mufly.estimate import Estimate
from mufly.flight.controllers import Actuators
from mufly.mission import Mission, RequestAnswer, VehicleRequest, check_request
from mufly.sensors import Fault, Readings, Truth

_Position = tuple[float, float, float]


def _unknown_vector() -> NDArray[np.float64]:
    return np.full(3, math.nan)


@dataclass(frozen=True, slots=True)
class FlightState:
    """How a flight is at one instant; SI units, N-E-D. What is not known is NaN, None or empty.

    Attributes
    ----------
    time_s : float
        The vehicle's clock.
    armed : bool
        Whether its motors may run.
    flying : bool
        Whether it is off the floor.
    landed : bool
        On the floor with the motors off or running down.
    state : str
        State of the mission machine ("take-off", "hover", ...; `mufly.mission.State`).
    motors : str
        "off", "spin_up", "fly", "ramp_down" or "blind" (:mod:`mufly.flight.flight_software`).
    mission_running : bool
        Whether the waypoints of the mission are being flown, and nothing has interrupted that.
    mission_begun : bool
        The mission has been started since take-off.
    manual : bool
        The user has taken over from the mission, which waits.
    returning_home : bool
        It is on its way home.
    waypoint_index : int
        The one that is flown to or comes next (from 0); the number of waypoints when all are reached.
    reached_count : int
        How many were reached since take-off.
    offboard_active, sticks_active : bool
        Whether a program's set-points, or the pilot's sticks, are in command.
    outcome, reason : str
        Of the flight: "" while it is open, "succeeded" or "failed", and why.
    oscillation : str
        Which actuator oscillates, how far and how fast (:mod:`mufly.flight.oscillation_detector`); "" if none.
    crash_cause : str
        What it hit; "" if nothing.
    fence_breach_text : str
        How far it is outside its fence, in words; "" inside, or without one.
    fence_breach_count : int
        How often it has left its fence in this flight.
    fence_breach_time_s : float
        When it left it last (s).
    mission : Mission or None
        As loaded, with the limits as tuned.
    home_position : (3,) tuple or None
        Where it took off (N, E, D; m); None before it has.
    goal : (3,) tuple or None
        Where it is going or holds (N, E, D; m); None on the floor and by hand.
    estimate : Estimate
        Where it believes to be, and how it believes to move.
    readings : Readings or None
        What that is made from.
    reference_position, reference_velocity, reference_attitude : (3,) arrays
        What is being followed: N-E-D; roll, pitch, yaw.
    actuators : Actuators
        What acts at this instant; on board, what was sent last.
    battery_current, battery_charge : float
        A, 0..1.
    battery_left_s : float
        How long it will last until it lands for low voltage (s), with the current of late; on the floor, of hover.
    truth : Truth or None
        What only a simulation knows.
    faults : tuple of Fault
        What is or will be wrong with simulated sensors.
    """

    time_s: float = math.nan
    armed: bool = False
    flying: bool = False
    landed: bool = False
    state: str = ""
    motors: str = ""
    mission_running: bool = False
    mission_begun: bool = False
    manual: bool = False
    returning_home: bool = False
    waypoint_index: int = 0
    reached_count: int = 0
    offboard_active: bool = False
    sticks_active: bool = False
    outcome: str = ""
    reason: str = ""
    oscillation: str = ""
    crash_cause: str = ""
    fence_breach_text: str = ""
    fence_breach_count: int = 0
    fence_breach_time_s: float = math.nan
    mission: Mission | None = None
    home_position: _Position | None = None
    goal: _Position | None = None
    estimate: Estimate = field(default_factory=Estimate)
    readings: Readings | None = None
    reference_position: NDArray[np.float64] = field(default_factory=_unknown_vector)
    reference_velocity: NDArray[np.float64] = field(default_factory=_unknown_vector)
    reference_attitude: NDArray[np.float64] = field(default_factory=_unknown_vector)
    actuators: Actuators = field(default_factory=Actuators.idle)
    battery_current: float = math.nan
    battery_charge: float = math.nan
    battery_left_s: float = math.nan
    truth: Truth | None = None
    faults: tuple[Fault, ...] = ()

    @property
    def height_m(self) -> float:
        """Above where it took off (m)."""
        return math.nan if self.home_position is None else self.home_position[2] - float(self.estimate.position[2])

    def check_request(self, ask: VehicleRequest) -> RequestAnswer:
        """Whether this state lets it do something (:mod:`mufly.mission.mission_state`)."""
        return check_request(ask, self, height_m=self.height_m, armed=self.armed, flying=self.flying)
