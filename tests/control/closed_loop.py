"""The nonlinear flight model under the control law, with one period of delay: a small harness for the tests."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from mufly.control import (
    FlightController,
    heave_yaw_init,
    heave_yaw_step,
    position_init,
    position_step,
    roll_pitch_init,
    roll_pitch_step,
)
from mufly.dynamics import compute_battery_supply, euler_from_quaternion, find_trim, integrate_state, model_parameters
from mufly.vehicle import Vehicle


@dataclass
class Reference:
    """What is asked for at one time; the defaults hover at 1 m."""

    position: tuple[float, float, float] = (0.0, 0.0, -1.0)
    velocity: tuple[float, float, float] = (0.0, 0.0, 0.0)
    acceleration: tuple[float, float, float] = (0.0, 0.0, 0.0)
    heading: float = 0.0
    heading_rate: float = 0.0
    tilt: tuple[float, float] | None = None  # overrides the position cascade


@dataclass
class Flight:
    time: np.ndarray
    position: np.ndarray
    velocity: np.ndarray
    attitude: np.ndarray
    motor: np.ndarray
    servo: np.ndarray
    voltage: np.ndarray

    def railed(self) -> float:
        """Longest time (s) that any input stood at a limit without a break."""
        period = self.time[1] - self.time[0]
        longest = 0
        for column, low in ((self.motor, 0.0), (self.servo, -1.0)):
            for values in column.T:
                run = 0
                for value in values:
                    run = run + 1 if value >= 1.0 - 1e-9 or value <= low + 1e-9 else 0
                    longest = max(longest, run)
        return longest * period


def fly(
    vehicle: Vehicle,
    controller: FlightController,
    reference: Callable[[float], Reference],
    duration: float,
    *,
    charge: float = 0.7,
    state: np.ndarray | None = None,
    motor_input: tuple[float, float] | None = None,
    wind: tuple[float, float, float] = (0.0, 0.0, 0.0),
) -> Flight:
    """Fly from hover at 1 m, or from a state with the motors at ``motor_input`` (upper, lower)."""
    p = model_parameters(vehicle)
    hover = find_trim(vehicle, charge=charge)
    x = hover.state.copy() if state is None else state.copy()
    if state is None:
        x[2] = -1.0
    u = hover.input.copy() if motor_input is None else np.array([*motor_input, 0.0, 0.0])
    air = np.array(wind)
    period = controller.period_s
    psi = float(euler_from_quaternion(x[6:10])[2])
    volts = compute_battery_supply(x, u[0], u[1], p)[0]
    heave_yaw = heave_yaw_init(controller.heave_yaw_gains, np.array([x[2], psi, x[12]]), u[:2], volts)
    roll_pitch = roll_pitch_init(controller.roll_pitch_gains, np.zeros(4))
    outer = position_init(controller.position_gains)
    tilt = np.zeros(2)
    rows = []
    for k in range(round(duration / period)):
        want = reference(k * period)
        angles = euler_from_quaternion(x[6:10])
        psi += (angles[2] - psi + np.pi) % (2 * np.pi) - np.pi
        volts = compute_battery_supply(x, u[0], u[1], p)[0]
        if want.tilt is not None:
            tilt = np.array(want.tilt)
        elif k % controller.position_divider == 0:
            tilt, outer = position_step(
                controller.position_gains,
                outer,
                np.array(want.position),
                np.array(want.velocity),
                np.array(want.acceleration),
                x[0:3],
                x[3:6],
                psi,
            )
        motor, heave_yaw = heave_yaw_step(
            controller.heave_yaw_gains,
            heave_yaw,
            np.array([want.position[2], want.heading, want.velocity[2], want.heading_rate]),
            np.array([x[2], psi, x[12]]),
            volts,
        )
        servo, roll_pitch = roll_pitch_step(
            controller.roll_pitch_gains, roll_pitch, tilt, np.array([angles[0], angles[1], x[10], x[11]])
        )
        rows.append(np.concatenate([[k * period], x[:6], [angles[0], angles[1], psi], motor, servo, [volts]]))
        integrate_state(x, u, air, p, period / 5, 5)
        u = np.concatenate([motor, servo])
    r = np.array(rows)
    return Flight(r[:, 0], r[:, 1:4], r[:, 4:7], r[:, 7:10], r[:, 10:12], r[:, 12:14], r[:, 14])
