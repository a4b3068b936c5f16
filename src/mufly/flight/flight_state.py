"""State of a flight at one instant, as autopilot, link, page and displays read it."""

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
    """State of a flight at one instant; SI units, N-E-D. Unknown values are NaN, None or empty.

    Attributes
    ----------
    time_s : float
        Time of the vehicle's clock (s).
    armed : bool
        Whether the motors may run.
    flying : bool
        Whether the vehicle is off the floor.
    landed : bool
        Whether the vehicle is on the floor with its motors off or ramping down.
    state : str
        State of the mission's state machine ("take-off", "hover", ...; `mufly.mission.State`).
    motors : str
        "off", "spin_up", "fly", "ramp_down" or "blind" (:mod:`mufly.flight.flight_software`).
    mission_running : bool
        Whether the vehicle flies the waypoints of the mission without interruption.
    mission_begun : bool
        Whether the mission has been started since take-off.
    user_in_control : bool
        Whether the user has taken over and the mission waits.
    returning_home : bool
        Whether the vehicle is returning home.
    waypoint_index : int
        Index of the present or next waypoint (from 0); the number of waypoints when all are reached.
    reached_waypoint_count : int
        Number of waypoints reached since take-off.
    offboard_active, sticks_active : bool
        Whether a program's set-points, or the pilot's sticks, are in command.
    outcome, reason : str
        Outcome of the flight ("succeeded", "failed", or "" while undecided), and its reason.
    oscillation : str
        Oscillating actuator with swing and frequency (:mod:`mufly.flight.oscillation_detector`); "" if none.
    crash_cause : str
        Cause of a crash; "" without one.
    fence_breach_text : str
        Distance outside the geofence, as text; "" inside, or without a geofence.
    fence_breach_count : int
        Number of geofence breaches in this flight.
    fence_breach_time_s : float
        Time of the last geofence breach (s).
    mission : Mission or None
        Mission as loaded, with tuned limits.
    home_position : (3,) tuple or None
        Take-off position (N, E, D; m); None before take-off.
    goal : (3,) tuple or None
        Position to fly to or to hold (N, E, D; m); None on the floor and in manual flight.
    estimate : Estimate
        Estimated position, velocity, attitude and rates.
    readings : Readings or None
        Sensor readings from which the estimate is computed.
    reference_position, reference_velocity, reference_attitude : (3,) arrays
        References of the controllers: N-E-D (m, m/s); roll, pitch, yaw (rad).
    actuators : Actuators
        Inputs that act at this instant; on board, the last ones sent.
    battery_current, battery_charge : float
        Current (A) and charge (0..1).
    battery_left_s : float
        Time until a landing for low voltage (s), at the recent current; on the floor, at that of hover.
    truth : Truth or None
        True state; known in a simulation only.
    faults : tuple of Fault
        Present and planned faults of simulated sensors.
    """

    time_s: float = math.nan
    armed: bool = False
    flying: bool = False
    landed: bool = False
    state: str = ""
    motors: str = ""
    mission_running: bool = False
    mission_begun: bool = False
    user_in_control: bool = False
    returning_home: bool = False
    waypoint_index: int = 0
    reached_waypoint_count: int = 0
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
    actuators: Actuators = field(default_factory=Actuators.make_zero_inputs)
    battery_current: float = math.nan
    battery_charge: float = math.nan
    battery_left_s: float = math.nan
    truth: Truth | None = None
    faults: tuple[Fault, ...] = ()

    @property
    def height_m(self) -> float:
        """Height above the take-off position (m)."""
        return math.nan if self.home_position is None else self.home_position[2] - float(self.estimate.position[2])

    def check_request(self, ask: VehicleRequest) -> RequestAnswer:
        """Return whether this state permits a request (:mod:`mufly.mission.machine.mission_state`)."""
        return check_request(ask, self, height_m=self.height_m, armed=self.armed, flying=self.flying)
