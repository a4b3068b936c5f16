"""Everything there is to see of a flight at one instant, for links and pictures."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mufly.dynamics import euler_from_quaternion
from mufly.flight.controllers import Actuators
from mufly.sensors import Measurement

__all__ = ["FlightView"]

_Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class FlightView:
    """Everything there is to see of a flight at one instant; SI units, N-E-D.

    Attributes
    ----------
    time_s : float
    measured : Measurement
    actuators : Actuators
        What acts at this instant.
    reference : tuple of three (3,) arrays
        What is being followed: position, velocity, and roll, pitch, yaw.
    state : (21,) array
        The truth: state of the flight model (:mod:`mufly.dynamics.state`).
    rotor_speed : (2,) array
        Of it: upper, lower (rad/s).
    wind : (3,) array
        Velocity of the air (m/s).
    battery_voltage, battery_current, battery_charge : float
        V, A, 0..1.
    battery_left_s : float
        How long it will last until it lands for low voltage (s), with the current of late; on the floor, of hover.
    crashed : str
        What it hit, or "".
    """

    time_s: float
    measured: Measurement
    actuators: Actuators
    reference: tuple[_Array, _Array, _Array]
    state: _Array
    rotor_speed: _Array
    wind: _Array
    battery_voltage: float
    battery_current: float
    battery_charge: float
    battery_left_s: float
    crashed: str

    @property
    def reference_position(self) -> _Array:
        """N, E, D that is followed (m)."""
        return self.reference[0]

    @property
    def reference_velocity(self) -> _Array:
        """N, E, D that is followed (m/s)."""
        return self.reference[1]

    @property
    def reference_attitude(self) -> _Array:
        """Roll, pitch, yaw that is followed (rad)."""
        return self.reference[2]

    @property
    def position(self) -> _Array:
        """True N, E, D (m)."""
        return self.state[0:3]

    @property
    def velocity(self) -> _Array:
        """True N, E, D (m/s)."""
        return self.state[3:6]

    @property
    def attitude(self) -> _Array:
        """True roll, pitch, yaw (rad, yaw in +-pi)."""
        return euler_from_quaternion(self.state[6:10])

    @property
    def rates(self) -> _Array:
        """True p, q, r (rad/s)."""
        return self.state[10:13]
