"""The estimator of a vehicle with sensors."""

from __future__ import annotations

import math
from collections import deque

import numpy as np
from numpy.typing import NDArray

from mufly.dynamics import GRAVITY, euler_from_quaternion, model_parameters, quaternion_from_euler, rotation
from mufly.dynamics import standing_height as stands_at
from mufly.estimate.beliefs import ERROR_STATES, Beliefs, Check
from mufly.estimate.estimate import Estimate, Estimator
from mufly.sensors import FITTED, Readings, nearest_turn
from mufly.vehicle import Vehicle
from mufly.world import World

_Array = NDArray[np.float64]
_READ = {
    "imu": ("acceleration", "rates"), "sonar": ("ground_distance",), "ring_camera": ("ranges",),
    "pressure": ("pressure",), "magnetometer": ("magnetic_field",), "rotor_speed": ("rotor_speed",),
    "battery": ("battery_voltage",), "position_fix": ("position_fix",),
}  # fmt: skip


def fitted_estimator(vehicle: Vehicle, world: World, rate_Hz: float) -> Estimator:
    """Return the estimator for what the vehicle has on board.

    Parameters
    ----------
    vehicle : Vehicle
        With the table ``sensors``.
    world : World
        Its room, which is known beforehand.
    rate_Hz : float
        Of the flight software (Hz).
    """
    return _Observer(vehicle, rate_Hz)


class _Observer(Estimator):
    """Fixed gains: gyroscopes and thrust carry on, fixes and sonar correct."""

    def __init__(self, vehicle: Vehicle, rate_Hz: float) -> None:
        self._p, self._dt = model_parameters(vehicle), 1.0 / rate_Hz
        self._stands = stands_at(vehicle)
        self._names = [n for s in FITTED if getattr(vehicle.sensors, s, None) for n in _READ[s]]
        self._beams = (vehicle.range_ring.count, float(vehicle.range_ring.max_range))
        self.reset()

    def reset(self) -> None:
        self._v, self._turn = np.zeros(3), np.zeros((0, 3))
        self._x = np.array([0.0, 0.0, -self._stands])
        self._q = np.array([1.0, 0.0, 0.0, 0.0])
        self._bias, self._rest = np.zeros(3), 0
        self._past: deque[tuple[float, _Array, float]] = deque(maxlen=200)
        self._seen: dict[str, float] = {}
        self._yaw, self._found = 0.0, False

    def update(self, readings: Readings, acting: _Array | None = None) -> Estimate:
        t, dt, p = readings.time_s, self._dt, self._p
        rates = np.nan_to_num(np.asarray(readings["rates"].value, dtype=float))
        speed = (
            np.nan_to_num(np.asarray(readings["rotor_speed"].value))
            if "rotor_speed" in readings
            else np.zeros(2)
        )
        new = {
            n: readings[n].value
            for n in ("position_fix", "ground_distance")
            if n in readings and readings[n].time_s != self._seen.get(n) and readings[n].valid
            and np.all(np.isfinite(readings[n].value))
        }  # fmt: skip
        self._seen |= {n: readings[n].time_s for n in new}
        if self._rest < 200 or not self._found:
            self._rest += 1
            self._bias += (rates - self._bias) / self._rest
        rates = rates - self._bias
        a = rotation(self._q)
        thrust = p["thrust_up"] * speed[0] ** 2 + p["thrust_dw"] * speed[1] ** 2
        flying = thrust > 0.7 * p["mass"] * GRAVITY or -self._x[2] > self._stands + 0.05
        if self._found and flying:
            force = a @ np.array([0.0, 0.0, (p["downwash"] - thrust) / p["mass"]]) + np.array(
                [0.0, 0.0, GRAVITY]
            )
            if self._x[2] > -self._stands:
                force[2] = min(force[2], 0.0)
            self._x = self._x + dt * self._v
            self._v = self._v + dt * force
            half = 0.5 * dt * rates
            w, x, y, z = self._q
            b, c, d = half
            q = np.array([
                w - x * b - y * c - z * d, x + w * b + y * d - z * c, y + w * c + z * b - x * d,
                z + w * d + x * c - y * b,
            ])  # fmt: skip
            self._q = q / np.linalg.norm(q)
        angles = euler_from_quaternion(self._q)
        if "position_fix" in new:
            fix = np.asarray(new["position_fix"], dtype=float)
            at = readings["position_fix"].time_s
            if not self._found and self._rest >= 200:
                self._found = True
                self._x[:2], self._q = fix[:2], quaternion_from_euler(0.0, 0.0, fix[3])
                self._yaw = fix[3]
                angles = euler_from_quaternion(self._q)
            elif self._found:
                then = min(self._past, key=lambda one: abs(one[0] - at), default=(t, self._x, angles[2]))
                off = fix[:3] - then[1]
                off[2] = 0.0 if "ground_distance" in readings else off[2]
                if np.abs(off).max() < 1.0 and flying:
                    turn = math.remainder(fix[3] - then[2], 2 * math.pi)
                    self._x, self._v = self._x + 0.06 * off, self._v + 0.06 * off
                    n, e = 0.02 * off[:2] / GRAVITY * 1.5
                    yaw = angles[2]
                    roll = angles[0] + (-n * math.sin(yaw) + e * math.cos(yaw))
                    pitch = angles[1] - (n * math.cos(yaw) + e * math.sin(yaw))
                    self._q = quaternion_from_euler(roll, pitch, yaw + 0.05 * turn)
        if "ground_distance" in new and self._found and flying:
            off = -float(new["ground_distance"]) * a[2, 2] - 0.05 - self._x[2]
            if abs(off) < 0.3:
                self._x[2] += 0.2 * off
                self._v[2] += 0.3 * off
        angles = euler_from_quaternion(self._q)
        self._yaw = angles[2] = nearest_turn(float(angles[2]), self._yaw)
        self._past.append((t, self._x.copy(), self._yaw))
        ring = np.asarray(readings["ranges"].value) if "ranges" in readings else np.full(*self._beams)
        volts = float(readings["battery_voltage"].value) if "battery_voltage" in readings else math.nan
        beliefs = Beliefs(
            self._bias.copy(), np.zeros(3), 0.0, np.zeros(4), np.zeros(2), 1.0, np.full(len(ERROR_STATES), 0.1),
            tuple(Check(n, "fused" if n in readings else "missing") for n in self._names),
        )  # fmt: skip
        return Estimate(
            t, self._x.copy(), self._v.copy(), angles, rates, ring, volts, np.eye(12) * 0.01, self._found, beliefs
        )  # fmt: skip
