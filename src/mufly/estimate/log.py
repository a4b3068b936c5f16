"""The filter on a log of another vehicle, of which no rotor model is known: inertial unit and position fixes alone."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from mufly.errors import InputError
from mufly.estimate.estimate import Estimate
from mufly.estimate.fitted import KalmanEstimator
from mufly.sensors import Reading, Readings
from mufly.vehicle import load_vehicle, replace
from mufly.world import World

_Array = NDArray[np.float64]
_ON, _OFF = np.array([1.0, 1.0, 0.0, 0.0]), np.zeros(4)


def run_log(
    time_s: _Array,
    rates: _Array,
    acceleration: _Array,
    flying: NDArray[np.bool_],
    fix_taken_s: _Array,
    fix_came_s: _Array,
    fix: _Array,
    *,
    fix_noise_m: float = 0.02,
    heading_noise_rad: float = 0.02,
    wander_m: float = 0.002,
    gyro_noise: float = 5e-3,
    accelerometer_noise: float = 0.3,
) -> list[Estimate]:
    """Return what the filter makes of a log, an estimate a row.

    Parameters
    ----------
    time_s : (n,) array
        Of the inertial unit (s), evenly spaced.
    rates, acceleration : (n, 3) arrays
        Rates (rad/s) and specific force (m/s^2), forward, right, down.
    flying : (n,) array of bool
        Whether the motors run.
    fix_taken_s, fix_came_s : (m,) arrays
        When each fix was measured and when it was known (s).
    fix : (m, 4) array
        N, E, D (m) and heading (rad).
    fix_noise_m, heading_noise_rad, wander_m : float
        Of the fixes, one sigma: white (m, rad), correlated over two seconds (m).
    gyro_noise, accelerometer_noise : float
        Densities of noise, (rad/s/sqrt(Hz), m/s^2/sqrt(Hz)); vibration counts.

    Raises
    ------
    InputError
        If the times do not rise.
    """
    step = float(np.median(np.diff(time_s)))
    if len(time_s) < 2 or not step > 0.0:
        raise InputError("log", "time_s", "does not rise", "give a log in the order of its times")
    late = float(np.max(fix_came_s - fix_taken_s, initial=0.0))
    period = float(np.median(np.diff(fix_taken_s))) if len(fix) > 1 else 0.1
    v = load_vehicle("mufly-2.0")
    v = replace(v, {
        "sensors.imu.bandwidth": 1e4, "sensors.imu.gyro_noise": gyro_noise,
        "sensors.imu.accelerometer_noise": accelerometer_noise, "sensors.imu.accelerometer_bias": 0.3,
        "sensors.imu.accelerometer_range": 150.0, "sensors.imu.gyro_range": 40.0,
        "sensors.position_fix.period": period, "sensors.position_fix.latency": late, "sensors.position_fix.jitter": 0.0,
        "sensors.position_fix.noise": fix_noise_m, "sensors.position_fix.heading_noise": heading_noise_rad,
        "sensors.position_fix.wander": wander_m, "sensors.position_fix.heading_wander": 1e-3,
    })  # fmt: skip
    assert v.sensors is not None
    only = {name: None for name in type(v.sensors).model_fields if name not in ("imu", "position_fix")}
    v = v.model_copy(update={"sensors": v.sensors.model_copy(update=only)})
    e = KalmanEstimator(v, World(), 1.0 / step)
    settings = e._settings.copy()
    settings["model"] = 0
    settings["sigma"][2] = 1.0  # nobody knows how high it stands
    settings["level"] = math.radians(2.0)
    settings["sigma"][6:8] = settings["level"]
    e.use(settings)
    told: list[Estimate] = []
    latest: dict[str, Reading] = {}
    coming = list(np.argsort(fix_came_s, kind="stable"))
    for k, t in enumerate(time_s):
        now = t - time_s[0]
        latest = {**latest, "rates": Reading(rates[k], now), "acceleration": Reading(acceleration[k], now)}
        while coming and fix_came_s[coming[0]] <= t:
            i = coming.pop(0)
            latest["position_fix"] = Reading(fix[i], fix_taken_s[i] - time_s[0])
        told.append(e.update(Readings(now, latest), _ON if flying[k] else _OFF))
    return told
