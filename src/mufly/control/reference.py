"""How fast a reference of height may be, and by how much the loop trails it: numbers of the law's reference filter."""

from __future__ import annotations

import numpy as np

from mufly.control.analysis import sample_plant
from mufly.control.linear import frequency_response
from mufly.control.result import Design
from mufly.control.settings import Settings
from mufly.dynamics import Linearisation, battery_state, model_parameters
from mufly.vehicle import Vehicle

__all__ = ["heave_acceleration", "reference_lags"]


def reference_lags(heave_yaw: Design) -> tuple[float, float]:
    """Time (s) by which height and heading trail a reference of constant rate: phase lag over a low frequency."""
    frequency = np.array([0.05])
    sampled = sample_plant(heave_yaw.plant, heave_yaw.discrete.period_s, 1)
    g = frequency_response(sampled, frequency)[0]
    k = frequency_response(heave_yaw.discrete.system(), frequency)[0]
    response = np.linalg.solve(np.eye(g.shape[0]) + g @ k[:, 2:], g @ k[:, :2])
    z, psi = (max(0.0, float(-np.angle(response[i, i]) / frequency[0])) for i in (0, 1))
    return z, psi


def heave_acceleration(vehicle: Vehicle, linear: Linearisation, settings: Settings) -> float:
    """Acceleration (m/s2) of a heave reference that the motors follow, with the battery run down and sagging.

    A step of ``du`` on both motors ends in ``per_input * du``; ``du`` is what the battery's voltage at full input, with
    ``planning_charge`` left, has above hover. The motors' lag asks for several times the input at the start of a climb
    that its end needs, hence ``heave_share``.
    """
    plant = linear.heave_yaw
    states = list(plant.state_labels)
    motors = [states.index("Omega_dw"), states.index("Omega_up")]
    gain = -np.linalg.solve(plant.A[np.ix_(motors, motors)], plant.B[motors])  # rotor speed per input
    per_input = plant.A[states.index("w"), motors] @ gain
    state = linear.trim.state.copy()
    state[20] = settings.planning_charge
    sagged = float(battery_state(state, 1.0, 1.0, model_parameters(vehicle))[0])
    lower_upper = linear.trim.motor_input[::-1]
    headroom = np.maximum(sagged / linear.trim.voltage_V - lower_upper, 0.0)
    available = abs(float(per_input @ headroom))
    return float(np.clip(settings.heave_share * available, 0.1, settings.heave_acceleration_max))
