"""Run the filter on a log of any vehicle: a strapdown filter on inertial unit and position aids, without rotor model.

Initial state and noise are estimated from the log itself:

- *Initial rest.* The vehicle is at rest until the motors run or, without motor signals, until the inertial readings
  scatter or rotate. This part gives the level and the bias of the gyroscopes.
- *Noise at rest.* Overlapping Allan deviation (IEEE Std 952-1997, annex C) of the initial rest: N = sigma(tau)
  sqrt(tau), the largest over tau of 0.1 to 1 s.
- *Noise in flight.* Vibration, lost rows, clock errors and bandwidth do not appear in the scatter of the rows:
  interpolated rows are smoother than the truth. They appear in the innovations of the aids. With the innovation nu
  *at the time* of an aid, before its fusion, and the predicted covariance S, the log-likelihood

      log L = -1/2 sum (nu^T S^-1 nu + log det S)

  is maximised over the noise densities (Bar-Shalom, Li and Kirubarajan, ch. 5.5; with errors shared by aids, this is
  a composite likelihood with the same maximum). The unknowns are two densities, of gyroscopes and accelerometers, not
  below those at rest and not above :data:`MAX_GYRO_NOISE_DENSITY` and :data:`MAX_ACCEL_NOISE_DENSITY`. The search uses
  at most a minute of flight and no truth.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize

from mufly.errors import InputError
from mufly.estimate.estimator import Estimate
from mufly.estimate.filter.filter_records import (
    ERROR_ACCEL_BIAS,
    ERROR_ATTITUDE,
    ERROR_FIX_HEADING,
    ERROR_GYRO_BIAS,
    ERROR_POSITION,
    ERROR_TERRAIN,
    ERROR_VELOCITY,
    INPUT_BLOCK_S,
    MAX_DELAY_BLOCKS,
    NOMINAL_ACCEL_BIAS,
    NOMINAL_ATTITUDE,
    NOMINAL_GYRO_BIAS,
    NOMINAL_POSITION,
    NOMINAL_THRUST_SCALE,
    NOMINAL_VELOCITY,
    READING_POSITION_FIX,
    STATE_COUNT,
)
from mufly.estimate.kalman_estimator import KalmanEstimator
from mufly.estimate.nees import Consistency, compute_normalised_squared_errors
from mufly.quantities.units import GRAVITY
from mufly.results import ResultColumn, ShownBlock, make_lines_block, result, tabulate_fields, tabulate_results
from mufly.rotations import quaternion_from_euler
from mufly.sensors import Reading, Readings
from mufly.vehicle import load_vehicle, replace_parameters
from mufly.world import World

_Array = NDArray[np.float64]
_ASSUMED_FLYING_INPUTS, _ASSUMED_RESTING_INPUTS = np.array([1.0, 1.0, 0.0, 0.0]), np.zeros(4)
_REST_BLOCK_S, _MIN_REST_S = 0.5, 1.0
_REST_STD_LIMITS = 0.3, 0.05
"""Standard deviations of specific force (m/s^2) and rates (rad/s) over half a second below which it counts as rest."""
_MIN_GYRO_NOISE_DENSITY, _MIN_ACCEL_NOISE_DENSITY = 2e-4, 2e-3
"""Least densities (rad/s/sqrt(Hz), m/s^2/sqrt(Hz)): those of a good MEMS unit."""
MAX_GYRO_NOISE_DENSITY, MAX_ACCEL_NOISE_DENSITY = 0.3, 3.0
"""Largest densities: ten and fifty times those of any quadrotor log tried; beyond, the aids contradict the unit."""
_INVALID_NOISE_COST = 1e6  # of a run without a valid estimate
ACCEL_BIAS_SIGMA = 0.3
"""One sigma (m/s^2): 30 mg, the bias of small MEMS units over temperature."""
_GYRO_BIAS_SIGMAS = 0.03, 0.01
"""One sigma (rad/s) without and after calibration at rest; vibration and temperature change the bias."""
_REST_TILT_SIGMA_RAD, _FLIGHT_TILT_SIGMA_RAD = math.radians(2.0), math.radians(15.0)
_INITIAL_SPEED_SIGMA = 1.0  # m/s, for a log that begins in flight


@dataclass(frozen=True)
class InertialLog:
    """Readings of an inertial unit at a constant rate.

    Attributes
    ----------
    time_s : (n,) array
    rates, acceleration : (n, 3) arrays
        Rates (rad/s) and specific force (m/s^2), forward, right, down; NaN in gaps of the log.
    is_flying : (n,) array of bool
        False during the initial rest, True afterwards.
    """

    time_s: _Array
    rates: _Array
    acceleration: _Array
    is_flying: NDArray[np.bool_]

    @property
    def step_s(self) -> float:
        """Return the time between two rows (s)."""
        return float(np.median(np.diff(self.time_s)))

    @property
    def rest_rows(self) -> slice:
        """Return the slice of the log's first rows, before the vehicle moves; empty if they last less than a second."""
        n = int(np.argmax(self.is_flying)) if self.is_flying.any() else len(self.is_flying)
        return slice(0, n if n * self.step_s >= _MIN_REST_S else 0)


@dataclass(frozen=True)
class PositionAids:
    """External measurements of position, and of heading if available.

    Attributes
    ----------
    measured_s, received_s : (m,) arrays
        Times of measurement and of arrival (s).
    position : (m, 3) array
        N, E, D (m).
    heading : (m,) array or None
        Heading (rad).
    std_m, heading_std_rad : float
        Standard deviations of white noise, per axis.
    """

    measured_s: _Array
    received_s: _Array
    position: _Array
    heading: _Array | None
    std_m: float
    heading_std_rad: float


@result
class InertialNoise:
    """Densities of an inertial unit's noise.

    Attributes
    ----------
    gyro : float
        Density of the gyroscopes (rad/s/sqrt(Hz)).
    accelerometer : float
        Density of the accelerometers (m/s2/sqrt(Hz)).
    """

    gyro: float
    accelerometer: float

    @property
    def densities_at_limit(self) -> tuple[str, ...]:
        """Names of the densities near the upper end of the search."""
        limits = {"gyro": MAX_GYRO_NOISE_DENSITY, "accelerometer": MAX_ACCEL_NOISE_DENSITY}
        return tuple(name for name, limit in limits.items() if getattr(self, name) > 0.9 * limit)


@result
class AidInnovations:
    """Innovations of the external position measurements (aids): measurement less its prediction.

    Attributes
    ----------
    count : int
        Number of aids.
    nis : float
        Mean of nu^T S^-1 nu over its number of components; 1 if the covariance is consistent.
    position_rms_m : float
        Root mean square of the position innovation (m).
    likelihood : float
        Mean log-likelihood, without its constant.
    """

    count: int
    nis: float
    position_rms_m: float
    likelihood: float

    def make_printed_blocks(self) -> list[ShownBlock]:
        """Return the consistency of the aids as printed text; nothing without aids."""
        columns = (
            "count",
            ResultColumn("nis", form=".2f", head="NIS / n (1 if consistent)"),
            ResultColumn("position_rms_m", "cm", ".1f"),
        )
        doubt = "Fixes and inertial unit are inconsistent: check axes, signs, units and --aid-delay."
        return [
            tabulate_results([self] if self.count else [], columns, names=["fixes"]),
            make_lines_block(*[doubt] if self.nis > 5.0 else [], style="yellow"),
        ]


@result(eq=False, json="said noise_at_rest noise from_s mounting_rad aids errors errors_without_mounting")
class InertialLogEstimate:
    """Evaluation of the filter on the log of any vehicle.

    Attributes
    ----------
    said : list of str
        Notes of the log's reader.
    noise_at_rest, noise : InertialNoise
        Noise at rest, and the noise that the filter uses.
    searched : tuple of str
        Densities of ``noise`` that follow from the innovations of the fixes.
    from_s : float
        Start of the evaluation (s).
    mounting_rad : array (roll, pitch) or None
        Difference of true attitude and accelerometers at rest: a mounting angle, or accelerometer bias (rad).
    aids : AidInnovations
    errors, errors_without_mounting : Consistency or None
        Errors to the log's true motion, and to this motion turned by the mounting angle.
    """

    said: list[str]
    noise_at_rest: InertialNoise
    noise: InertialNoise
    searched: tuple[str, ...]
    from_s: float
    mounting_rad: _Array | None
    aids: AidInnovations
    errors: Consistency | None
    errors_without_mounting: Consistency | None

    def make_printed_blocks(self) -> list[ShownBlock]:
        """Return noise, errors and innovations as printed text, with warnings."""
        noise = [ResultColumn(name, form=".2g") for name in ("gyro", "accelerometer")]
        blocks: list[ShownBlock] = [
            tabulate_results([self.noise_at_rest, self.noise], noise, names=("noise at rest", "noise in flight"))
        ]
        if limited := [name for name in self.noise.densities_at_limit if name in self.searched]:
            doubt = (
                f"No noise of the {' and '.join(limited)} reconciles the fixes with the inertial unit: check whether "
                "its readings are cut off at its range, its axes, and --aid-delay."
            )
            blocks.append(make_lines_block(doubt, style="yellow"))
        cases = {"measured": self.errors, "unmounted": self.errors_without_mounting}
        if known := {name: case for name, case in cases.items() if case is not None}:
            blocks += Consistency.tabulate_errors(known)
        columns = [ResultColumn("from_s", form=".1f", head="evaluated from")]
        if self.mounting_rad is not None:
            columns.append(ResultColumn("mounting_rad", "deg", "+.2f", "mounting angle or bias", ("roll", "pitch")))
        blocks.append(tabulate_fields(self, columns))
        return [*blocks, *self.aids.make_printed_blocks()]


def detect_flight(time_s: _Array, rates: _Array, acceleration: _Array) -> NDArray[np.bool_]:
    """Return whether the vehicle has left its initial rest, from the inertial readings: (n,) array of bool."""
    step = float(np.median(np.diff(time_s)))
    n = max(2, round(_REST_BLOCK_S / step))
    for k in range(0, len(time_s) - n, n):
        f, w = acceleration[k : k + n], rates[k : k + n]
        still = (
            np.nanmax(np.nanstd(f, axis=0)) < _REST_STD_LIMITS[0]
            and np.nanmax(np.nanstd(w, axis=0)) < _REST_STD_LIMITS[1]
        )
        if not (still and np.nanmax(np.abs(np.nanmean(w, axis=0))) < 2 * _REST_STD_LIMITS[1]):
            return np.arange(len(time_s)) >= k
    return np.zeros(len(time_s), dtype=bool)


def check_inertial_log(log: InertialLog, where: str) -> None:
    """Check that data are inertial readings in SI units and body axes.

    Raises
    ------
    InputError
        If times do not increase, gravity has another size than in m/s^2, the vertical axis has the wrong sign, or rates
        are in degrees.
    """
    if len(log.time_s) < 10 or not log.step_s > 0.0:
        raise InputError(where, "time", "does not increase", "sort the log by time")
    held = log.rest_rows if log.rest_rows.stop else slice(None)
    felt = np.nanmedian(log.acceleration[held], axis=0)
    size = float(np.nanmedian(np.linalg.norm(log.acceleration[held], axis=1)))
    if not np.isfinite(size):
        raise InputError(where, "measured_acceleration", "contains no numbers", "choose another signal")
    if abs(size - 1.0) < 0.2:
        raise InputError(
            where, "measured_acceleration", f"has a mean of {size:.3g}, so its unit is g", "give its unit: ...(gee)"
        )  # fmt: skip
    if abs(size / GRAVITY - 1.0) > 0.2:
        raise InputError(
            where, "measured_acceleration", f"has a mean of {size:.3g} m/s^2 instead of 9.81 m/s^2 (gravity)",
            "give its unit, or another signal: specific force, from which gravity is not subtracted",
        )  # fmt: skip
    if felt[2] > -0.5 * GRAVITY:
        axis = "xyz"[int(np.argmax(np.abs(felt)))]
        problem = (
            "has its z axis up: at rest z should read -9.81 m/s^2" if felt[2] > 0.5 * size
            else f"has gravity along {axis} ({np.array2string(felt, precision=2)} m/s^2)"
        )  # fmt: skip
        raise InputError(
            where,
            "measured_acceleration",
            problem,
            "change signs or order of the columns: axes are forward, right, down",
        )
    turning = np.abs(np.nanmean(log.rates[held], axis=0)).max() if log.rest_rows.stop else 0.0
    if np.nanquantile(np.abs(log.rates), 0.999) > 70.0 or turning > 0.5:
        raise InputError(
            where, "measured_rates", f"reaches {max(turning, float(np.nanmax(np.abs(log.rates)))):.3g} rad/s"
            + (" at rest" if turning > 0.5 else ""), "give its unit: ...(deg/s)",
        )  # fmt: skip


def estimate_rest_noise(log: InertialLog) -> InertialNoise:
    """Return the noise densities from the Allan deviation at rest; those of a good unit if the log has no rest."""
    part = log.rest_rows
    gyro = _allan_noise_density(log.rates[part], log.step_s)
    felt = _allan_noise_density(log.acceleration[part], log.step_s)
    return InertialNoise(gyro=max(gyro, _MIN_GYRO_NOISE_DENSITY), accelerometer=max(felt, _MIN_ACCEL_NOISE_DENSITY))


def _allan_noise_density(x: _Array, step: float) -> float:
    """Return the noise density from Allan deviations sigma(tau) of data ``x`` (n, 3): the largest sigma(tau) sqrt(tau).

    tau is 0.1, 0.2, 0.5 and 1 s, as far as the data are at least five tau long; 0 for shorter data.
    """
    x = x[np.isfinite(x).all(axis=1)]
    total = np.concatenate([np.zeros((1, 3)), np.cumsum(x, axis=0)]) * step
    found = 0.0
    for tau in (0.1, 0.2, 0.5, 1.0):
        m = max(1, round(tau / step))
        if len(x) >= 5 * m:
            second = total[2 * m :] - 2 * total[m:-m] + total[: -2 * m]
            variance = np.mean(np.square(second), axis=0) / (2 * (m * step) ** 2)
            found = max(found, float(np.sqrt(variance.max() * m * step)))
    return found


def run_filter_on_log(
    log: InertialLog,
    aids: PositionAids,
    noise: InertialNoise,
    *,
    until_s: float = math.inf,
    on_progress: Callable[[int, int], None] | None = None,
) -> list[Estimate]:
    """Run the filter on a log and return an estimate per row.

    Parameters
    ----------
    log : InertialLog
    aids : PositionAids
    noise : InertialNoise
    until_s : float
        Time after which rows are ignored (s).
    on_progress : callable, optional
        Called with the number of finished rows and the total.

    Raises
    ------
    InputError
        If aids are later than the delay of the filter allows.
    """
    e = _make_log_estimator(log, aids, noise)
    latest: dict[str, Reading] = {}
    coming = np.argsort(aids.received_s, kind="stable").tolist()
    heading = np.zeros(len(aids.measured_s)) if aids.heading is None else aids.heading
    rows = np.column_stack([aids.position, heading])
    known: Any = np.isfinite(np.hstack([log.rates, log.acceleration])).all(axis=1)
    begin, next_ = float(log.time_s[0]), 0
    count = int(np.searchsorted(log.time_s, until_s, side="right"))
    told: list[Estimate] = []
    for k in range(count):
        t = float(log.time_s[k])
        if known[k]:
            latest["rates"] = Reading(log.rates[k], t - begin)
            latest["acceleration"] = Reading(log.acceleration[k], t - begin)
        while next_ < len(coming) and aids.received_s[coming[next_]] <= t + 1e-9:
            i = coming[next_]
            next_ += 1
            if aids.measured_s[i] >= begin and np.isfinite(rows[i]).all():
                latest["position_fix"] = Reading(rows[i], float(aids.measured_s[i]) - begin)
        told.append(
            e.update(
                Readings(t - begin, dict(latest)),
                _ASSUMED_FLYING_INPUTS if log.is_flying[k] else _ASSUMED_RESTING_INPUTS,
            )
        )
        if on_progress is not None and (k % 500 == 0 or k + 1 == count):
            on_progress(k + 1, count)
    return told


def _make_log_estimator(log: InertialLog, aids: PositionAids, noise: InertialNoise) -> KalmanEstimator:
    """Return a filter without a rotor model for a log.

    It starts at the first aid's position, with tilt and gyroscope bias from the readings at rest, or with large initial
    uncertainties if the log begins in motion.
    """
    step = log.step_s
    late = float(np.max(aids.received_s - aids.measured_s, initial=0.0))
    # One row per block if the buffer then covers the delay; computing time is not critical here.
    rows = max(1, math.ceil(late / step / MAX_DELAY_BLOCKS - 1e-9))
    if rows > max(1, round(INPUT_BLOCK_S / step)):
        raise InputError(
            "--aid-delay",
            f"{late:.3g} s",
            f"is more than the {MAX_DELAY_BLOCKS * max(INPUT_BLOCK_S, step):.2g} s of inputs that the filter stores",
            "give aids with less delay, or a lower --rate",
        )
    period_s = float(np.clip(np.median(np.diff(aids.measured_s)), 0.001, 100.0)) if len(aids.measured_s) > 1 else 0.1
    v = replace_parameters(
        load_vehicle("mufly-2.0"),
        {
            "sensors.imu.bandwidth": 1e4,
            "sensors.imu.gyro_noise_density": noise.gyro,
            "sensors.imu.accelerometer_noise_density": noise.accelerometer,
            "sensors.imu.accelerometer_bias": ACCEL_BIAS_SIGMA,
            "sensors.imu.accelerometer_range": 200.0,
            "sensors.imu.gyro_range": 70.0,
            "sensors.position_fix.period": period_s,
            "sensors.position_fix.latency": late,
            "sensors.position_fix.latency_jitter": 0.0,
            "sensors.position_fix.noise": aids.std_m,
            "sensors.position_fix.drift": 0.1 * aids.std_m,
            "sensors.position_fix.heading_noise": aids.heading_std_rad,
            "sensors.position_fix.heading_drift": 0.05 * aids.heading_std_rad,
        },
    )
    assert v.sensors is not None
    only = {name: None for name in type(v.sensors).model_fields if name not in ("imu", "position_fix")}
    v = v.model_copy(update={"sensors": v.sensors.model_copy(update=only)})
    e = KalmanEstimator(v, World(), 1.0 / step, block_s=rows * step)
    s: Any = e._settings.copy()
    s["has_rotor_model"] = 0
    s["ground_clearance"] = -1e6  # unknown floor
    s["has_noise"][READING_POSITION_FIX] = 0  # aids may repeat values
    start, sigma = np.zeros(STATE_COUNT), s["initial_sigma"]
    start[NOMINAL_THRUST_SCALE] = 1.0
    start[NOMINAL_POSITION:NOMINAL_VELOCITY] = aids.position[0]
    sigma[ERROR_POSITION:ERROR_VELOCITY] = 3 * aids.std_m + 1e-3
    yaw = 0.0 if aids.heading is None else float(aids.heading[0])
    sigma[ERROR_ATTITUDE + 2] = math.pi if aids.heading is None else 3 * aids.heading_std_rad
    rest = log.rest_rows
    roll = pitch = 0.0
    if rest.stop:
        felt = np.nanmean(log.acceleration[rest], axis=0)
        roll, pitch = math.atan2(-felt[1], -felt[2]), math.atan2(felt[0], math.hypot(felt[1], felt[2]))
        start[NOMINAL_GYRO_BIAS:NOMINAL_ACCEL_BIAS] = np.nanmean(log.rates[rest], axis=0)
        s["rest_tilt_sigma"] = math.hypot(_REST_TILT_SIGMA_RAD, ACCEL_BIAS_SIGMA / GRAVITY)
        s["rest_accel_sigma"] = max(float(np.nanstd(log.acceleration[rest], axis=0).max()), 0.02)
        s["rest_gyro_sigma"] = max(float(np.nanstd(log.rates[rest], axis=0).max()), 1e-4)
        sigma[ERROR_VELOCITY:ERROR_ATTITUDE] = 0.01
    else:
        s["rest_tilt_sigma"], sigma[ERROR_VELOCITY:ERROR_ATTITUDE] = _FLIGHT_TILT_SIGMA_RAD, _INITIAL_SPEED_SIGMA
        sigma[ERROR_POSITION:ERROR_VELOCITY] += _INITIAL_SPEED_SIGMA * (
            float(aids.measured_s[0]) - float(log.time_s[0])
        )
    start[NOMINAL_ATTITUDE:NOMINAL_GYRO_BIAS] = quaternion_from_euler(roll, pitch, yaw)
    sigma[ERROR_ATTITUDE : ERROR_ATTITUDE + 2] = s["rest_tilt_sigma"]
    sigma[ERROR_GYRO_BIAS:ERROR_ACCEL_BIAS] = _GYRO_BIAS_SIGMAS[1 if rest.stop else 0]
    sigma[ERROR_ACCEL_BIAS:ERROR_TERRAIN] = ACCEL_BIAS_SIGMA
    if aids.heading is None:
        s["fix_heading_variance"], sigma[ERROR_FIX_HEADING] = 1e6, 1e-6
    s["initial_state"] = start
    e.replace_settings_and_reset(s)
    return e


def compute_aid_innovations(
    log: InertialLog, aids: PositionAids, told: list[Estimate], *, from_s: float, to_s: float
) -> AidInnovations:
    """Return the innovations of the aids in a part of the log, each at its measurement time."""
    row = np.searchsorted(log.time_s, aids.measured_s - 0.5 * log.step_s)
    use = [
        i for i, k in enumerate(row.tolist())
        if k < len(told) and from_s <= aids.measured_s[i] <= to_s and aids.received_s[i] > aids.measured_s[i] - 1e-9
        and told[max(k - 1, 0)].valid and np.isfinite(aids.position[i]).all()
    ]  # fmt: skip
    if not use:
        return AidInnovations(count=0, nis=math.nan, position_rms_m=math.nan, likelihood=-math.inf)
    # An aid without delay is already fused in the estimate of its row, so the previous row is propagated.
    late = aids.received_s[use] - aids.measured_s[use] > 0.5 * log.step_s
    nu, s = np.empty((len(use), 3)), np.empty((len(use), 3, 3))
    for j, i in enumerate(use):
        k = int(row[i]) if late[j] else max(int(row[i]) - 1, 0)
        e = told[k]
        ahead = float(aids.measured_s[i] - log.time_s[k])
        nu[j] = aids.position[i] - e.position - ahead * e.velocity
        s[j] = e.covariance[:ERROR_VELOCITY, :ERROR_VELOCITY] + aids.std_m**2 * np.eye(3)
    square = compute_normalised_squared_errors(nu, s)
    return AidInnovations(
        count=len(use), nis=float(square.mean()) / 3, position_rms_m=float(np.sqrt(np.square(nu).sum(axis=1).mean())),
        likelihood=float(-0.5 * (square + np.linalg.slogdet(s)[1]).mean()),
    )  # fmt: skip


def estimate_flight_noise(
    log: InertialLog,
    aids: PositionAids,
    least: InertialNoise,
    on_progress: Callable[[int, int], None] | None = None,
) -> InertialNoise:
    """Return the noise densities, at least ``least``, that maximise the likelihood of the position fixes in the first
    minute of flight.

    A density at its upper bound shows that noise does not explain the difference of aids and inertial unit. Possible
    causes are readings clipped at the unit's range, wrong axes, and aids later than stated.
    """
    if not log.is_flying.any():
        return least
    begin, end = float(log.time_s[np.argmax(log.is_flying)]), float(log.time_s[-1])
    half = min(end, begin + 60.0)
    lowest, highest = (
        np.log([least.gyro, least.accelerometer]),
        np.log([MAX_GYRO_NOISE_DENSITY, MAX_ACCEL_NOISE_DENSITY]),
    )
    lowest = np.minimum(lowest, highest)
    tried = 0

    def compute_noise_cost(x: _Array) -> float:
        nonlocal tried
        tried += 1
        if on_progress is not None:
            on_progress(min(tried, 29), 30)
        inside = np.clip(x, lowest, highest)
        gyro, felt = np.exp(inside)
        told = run_filter_on_log(log, aids, InertialNoise(gyro=float(gyro), accelerometer=float(felt)), until_s=half)
        found = compute_aid_innovations(log, aids, told, from_s=begin + 1.0, to_s=half)
        return min(-found.likelihood, _INVALID_NOISE_COST) + float(np.square(x - inside).sum())

    start: Any = np.clip(np.log([10 * least.gyro, 5 * least.accelerometer]), lowest, highest)
    corners = start + np.array([[0.0, 0.0], [1.2, 0.0], [0.0, 1.2]])
    options: Any = {"initial_simplex": corners, "xatol": 0.1, "fatol": 0.01, "maxfev": 30}
    found: Any = minimize(compute_noise_cost, start, method="Nelder-Mead", options=options).x
    best = np.exp(np.clip(found, lowest, highest))
    if on_progress is not None:
        on_progress(30, 30)
    return InertialNoise(gyro=float(best[0]), accelerometer=float(best[1]))
