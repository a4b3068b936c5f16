"""Estimator of a vehicle with sensors: the interface between the filter and the flight software."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mufly.compiled.numba_cache import cached_njit
from mufly.dynamics import model_parameters
from mufly.estimate.estimator import Estimate, Estimator
from mufly.estimate.filter.filter_records import (
    AID_HEADING,
    AID_NOISE_FIELDS,
    AID_POSITION,
    ERROR_ACCEL_BIAS,
    ERROR_FIX_BIAS,
    ERROR_FIX_HEADING,
    ERROR_GYRO_BIAS,
    INPUT_BLOCK_S,
    NOMINAL_ACCEL_BIAS,
    NOMINAL_ATTITUDE,
    NOMINAL_FIX_BIAS,
    NOMINAL_GYRO_BIAS,
    NOMINAL_POSITION,
    NOMINAL_TERRAIN,
    NOMINAL_THRUST_SCALE,
    NOMINAL_VELOCITY,
    NOMINAL_WIND,
    READING_ACCELERATION,
    READING_BATTERY,
    READING_POSITION_FIX,
    READING_RANGE_RING,
    READING_SONAR,
    READING_STARTS,
    READING_WIDTHS,
    SENSOR_COUNT,
    SUBTRACTED_READING_OFFSETS,
    fused_beam_indices,
    make_filter_settings,
    make_memory_dtype,
)
from mufly.estimate.filter.measurements.sensor_checks import ACTUATOR_START, CLIPPING_START, INPUT_VALUE_COUNT
from mufly.estimate.filter.output_predictor import COVARIANCE_INTERVAL_TICKS
from mufly.estimate.filter_backend import BackendName, make_backend
from mufly.estimate.sensor_status import AuxiliaryStates, LazySensorStatuses, SensorStatus
from mufly.quantities.quantity_table import READINGS_WITH_FUSION_STATUS
from mufly.sensors import Reading, Readings
from mufly.vehicle import Vehicle
from mufly.world import World

_Array = NDArray[np.float64]
_VOLTAGE_START = READING_STARTS[READING_BATTERY]
_ACCELERATION_SLICE = slice(READING_STARTS[READING_ACCELERATION], READING_STARTS[READING_ACCELERATION] + 3)
MAX_MISSED_PERIODS_PER_UPDATE = 10
"""Lost periods that the filter makes up at once; a board's watchdog allows no more (50 ms at 200 Hz)."""
PUBLISHED_FIELDS = (
    "covariance_output", "sigma_output", "status", "reason", "reason_number", "innovation", "innovation_sigma",
    "last_fused_tick", "last_new_tick", "fix_fault_component", "tick",
)  # fmt: skip
"""Memory fields published every :data:`mufly.estimate.filter.output_predictor.COVARIANCE_INTERVAL_TICKS` periods."""


@cached_njit(error_model="numpy")
def median_filter_ring_scan(scan: _Array, max_range_m: float, scans: _Array, ranges: _Array) -> None:
    """Process a scan of the ring (n,): compute the median of each beam's last three readings.

    The median removes single false detections, which would cause detours, and delays true ones by one reading.

    Parameters
    ----------
    scan : (n,) array
        Distances (m); a distance that is not finite counts as ``max_range_m``.
    max_range_m : float
        Maximum range of the ring (m).
    scans : (3, n) array
        The last three scans, overwritten.
    ranges : (n,) array
        Output: the medians (m).
    """
    for j in range(ranges.size):
        c = scan[j] if math.isfinite(scan[j]) else max_range_m
        a, b = scans[1, j], scans[2, j]
        scans[0, j], scans[1, j], scans[2, j] = a, b, c
        ranges[j] = max(min(a, b), min(max(a, b), c))


class KalmanEstimator(Estimator):
    """The error-state Kalman filter of :mod:`mufly.estimate.filter.ekf_step`.

    Parameters
    ----------
    vehicle : Vehicle
        Vehicle with the table ``sensors``.
    world : World
        World whose room the filter knows in advance.
    rate_Hz : float
        Rate of the flight software (Hz).
    kind : type
        Type of the filter's numbers; processors on board use ``numpy.float32``.
    code : "", "c" or "numba"
        Implementation (:mod:`mufly.estimate.filter_backend`); by default the one that starts sooner.
    block_s : float
        Time over which inputs are averaged (s).

    Attributes
    ----------
    uses_fix_covariance : bool
        Whether the covariance sent with a position fix is used as its accuracy.
    reading_times : (SENSOR_COUNT,) array
        Sampling time of the last reading of each sensor (s); NaN where there is none.
    ring_scans, ranges : (3, n), (n,) arrays
        The last three scans of the range ring, and their median, which is published (m).
    fix_correlation_s : float
        Correlation time of the errors of fixes with a covariance (s). With 0 the errors are white noise, and the bias
        walks as in the vehicle file. Otherwise the noise is that of the file, and the covariance sets the size of the
        random walk, if larger than in the file, since a map's drift persists. A small bias grows to this size only over
        the correlation time. Until then the remaining variance r is represented by noise of variance
        r (1 + 2 fix_correlation_s / period), which has the same effect over a long time.
    """

    def __init__(
        self,
        vehicle: Vehicle,
        world: World,
        rate_Hz: float,
        kind: Any = np.float64,
        code: BackendName = "",
        block_s: float = INPUT_BLOCK_S,
    ) -> None:
        self._number_type, self._rate_Hz = kind, rate_Hz
        self._settings = make_filter_settings(vehicle, world, rate_Hz, kind, block_s)
        self._parameters = model_parameters(vehicle)
        self._fitted_indices = [k for k in range(SENSOR_COUNT) if self._settings["is_fitted"][k]]
        self._reading_indices = {READINGS_WITH_FUSION_STATUS[k]: k for k in self._fitted_indices}
        ring = vehicle.range_ring
        self._max_range_m = float(ring.max_range)
        self.ranges, self.ring_scans = np.empty(ring.count), np.empty((3, ring.count))
        self.reading_times = np.empty(SENSOR_COUNT)
        self._beam_indices = fused_beam_indices(ring.count)
        # A record of an array is a view: the compiled step writes into the array.
        self._memory_array = np.zeros(1, make_memory_dtype(self._number_type))
        self.memory = m = self._memory_array[0]
        self._output_state, self._output_rates, self._write_output_angles = (
            m["x_output"],
            m["rates_output"],
            m["angles_output"],
        )
        self._input_values = np.zeros(INPUT_VALUE_COUNT, self._number_type)
        self._input_is_new, self._input_age = (
            np.zeros(SENSOR_COUNT, np.int32),
            np.zeros(SENSOR_COUNT, self._number_type),
        )
        self._backend_name: BackendName = code
        self.uses_fix_covariance, self.fix_correlation_s = False, 0.0
        self.replace_settings_and_reset(self._settings)

    def replace_settings_and_reset(self, settings: Any) -> None:
        """Replace the settings (:func:`mufly.estimate.filter.filter_records.make_filter_settings`) and reset."""
        self._settings = settings
        self._copy_vehicle_file_noise()
        self.backend = make_backend(
            settings,
            self._parameters,
            self._input_values,
            self._input_is_new,
            self._input_age,
            self._backend_name,
        )
        self.reset()

    def _copy_vehicle_file_noise(self) -> None:
        """Keep a copy of the vehicle file's sensor noise, because an external fix can replace its own noise in the
        settings.
        """
        names = ("initial_sigma", *(aid[3] for aid in AID_NOISE_FIELDS))
        self._vehicle_noise = {name: np.array(self._settings[name]) for name in names}

    def reset(self) -> None:
        for row in (self._memory_array, self._input_values, self._input_is_new, self._input_age):
            row.view(np.uint8)[:] = 0
        for name, own in self._vehicle_noise.items():
            self.backend.settings[name] = own
        self._fix_bias_variance = self._fix_bias_variance_target = (
            self._vehicle_noise["initial_sigma"][ERROR_FIX_BIAS : ERROR_FIX_HEADING + 1] ** 2
        )
        self.backend.reset_memory(self._memory_array)
        self._period_count = 0
        self.reading_times[:] = math.nan
        self.ring_scans[:] = self.ranges[:] = self._max_range_m
        self._sensor_statuses: Sequence[SensorStatus] = ()
        self._published: tuple[Any, ...] = ()
        self._first_time_s = math.nan

    def update(self, readings: Readings, acting: _Array | None = None, missed: int = 0) -> Estimate:
        """Process the readings of a period, and before them ``missed`` lost periods."""
        self._fill_inputs(readings, acting)
        if missed:
            self.process_missed_periods(missed)
        valid = self.backend.step_filter(self._memory_array)
        return self.read_estimate(readings.time_s, valid)

    def describe_noise(self) -> str:
        """Return the noise of each sensor as the filter estimates it at present, with the vehicle file's value in
        brackets.

        Noise is a standard deviation. The drift of the position fix is a ratio to the file's.
        """
        m, used = self.memory, self.backend.settings
        parts, drifts = [], []
        for aid, name, reading, field, scale, unit in AID_NOISE_FIELDS:
            if not self._settings["is_fitted"][reading]:
                continue
            estimated = scale * math.sqrt(float(used[field]) * float(m["noise_scale"][aid]))
            parts.append(f"{name} {estimated:.2g} {unit} ({scale * math.sqrt(float(self._vehicle_noise[field])):.2g})")
            if aid in (AID_POSITION, AID_HEADING):
                drifts.append(f"{name} {math.sqrt(float(m['bias_walk_scale'][aid])):.2g}")
        return ", ".join(parts) + (f"; drift over the file's: {', '.join(drifts)}" if drifts else "")

    def process_missed_periods(self, count: int) -> None:
        """Advance by lost periods, each with the inertial readings and actuator inputs of the first period after them.

        The input row already holds that period and is not changed. At most :data:`MAX_MISSED_PERIODS_PER_UPDATE` are
        made up, because after a longer gap the watchdog of a board has reset it.
        """
        rows = (self._input_values, self._input_is_new, self._input_age)
        values, is_new, age = (row.copy() for row in rows)
        for _ in range(min(count, MAX_MISSED_PERIODS_PER_UPDATE)):
            self._input_is_new[:] = 0
            self._input_is_new[:READING_SONAR] = is_new[:READING_SONAR]
            self.backend.step_filter(self._memory_array)
            self._period_count += 1
            if self._period_count % COVARIANCE_INTERVAL_TICKS == 0 or not self._published:
                self.publish_covariance_and_statuses(self.memory.copy())
            for row, kept in zip(rows, (values, is_new, age), strict=True):
                row[:] = kept

    def read_estimate(self, time_s: float, valid: bool, periods: int = 1) -> Estimate:
        """Return the estimate after ``periods`` further periods of the filter.

        Every :data:`COVARIANCE_INTERVAL_TICKS` periods covariance and sensor statuses are published, too.
        """
        self._period_count += periods
        if (periods and self._period_count % COVARIANCE_INTERVAL_TICKS == 0) or not self._published:
            self.publish_covariance_and_statuses(self.memory.copy())
        return self.make_estimate(
            time_s,
            valid,
            self._output_state,
            self._output_rates,
            self._write_output_angles,
            float(self._input_values[_VOLTAGE_START]),
            self.ranges.copy(),
            self._input_values[_ACCELERATION_SLICE],
        )

    def publish_covariance_and_statuses(self, m: Mapping[str, Any] | np.void) -> None:
        """Publish the covariance and sensor statuses of a filter memory.

        ``m`` is a copy of the memory, or of its :data:`PUBLISHED_FIELDS`; statuses are computed from it later, so its
        values must not change.
        """
        self._sensor_statuses = LazySensorStatuses(m, self._settings, self._fitted_indices)
        sigma, covariance = m["sigma_output"].astype(np.float64), np.zeros((ERROR_ACCEL_BIAS, ERROR_ACCEL_BIAS))
        bias = range(ERROR_GYRO_BIAS, ERROR_ACCEL_BIAS)
        covariance[:ERROR_GYRO_BIAS, :ERROR_GYRO_BIAS] = m["covariance_output"]
        covariance[bias, bias] = sigma[bias] ** 2 + self._settings["rest_gyro_sigma"] ** 2
        self._published = (covariance, sigma)

    def make_estimate(
        self, time_s: float, valid: bool, out: _Array, rates: _Array, angles: _Array, volts: float, ranges: _Array,
        specific_force: _Array,
    ) -> Estimate:  # fmt: skip
        """Return an estimate: the given state, with the latest published covariance and statuses."""
        x = out.astype(np.float64)
        return Estimate(
            time_s, x[NOMINAL_POSITION:NOMINAL_VELOCITY], x[NOMINAL_VELOCITY:NOMINAL_ATTITUDE],
            angles.astype(np.float64), rates.astype(np.float64), ranges,
            volts or math.nan, self._published[0], valid,
            AuxiliaryStates(
                x[NOMINAL_GYRO_BIAS:NOMINAL_ACCEL_BIAS], x[NOMINAL_ACCEL_BIAS:NOMINAL_TERRAIN],
                float(x[NOMINAL_TERRAIN]),
                x[NOMINAL_FIX_BIAS:NOMINAL_WIND], x[NOMINAL_WIND:NOMINAL_THRUST_SCALE], float(x[NOMINAL_THRUST_SCALE]),
                self._published[1], self._sensor_statuses, specific_force.astype(np.float64),
            ),
        )  # fmt: skip

    def _fill_inputs(self, readings: Readings, acting: _Array | None) -> None:
        """Write the new readings into the input row."""
        self._input_values[ACTUATOR_START : ACTUATOR_START + 4] = 0.0 if acting is None else acting
        self._input_is_new[:] = 0
        self.write_input_readings(readings.latest, readings.time_s)
        if "clipping" not in readings.latest:
            self._input_values[CLIPPING_START:] = 0.0

    def write_input_readings(self, said: Mapping[str, Reading], time_s: float) -> None:
        """Write readings of some sensors into the input row of this period."""
        for name, r in said.items():
            k = self._reading_indices.get(name)
            if k is not None:
                self._fill_reading(k, r, time_s)
            elif name == "clipping":
                self._input_values[CLIPPING_START:] = r.value

    def _fill_reading(self, k: int, r: Reading, t: float) -> None:
        """Write a reading of one sensor into the input row, if it is new."""
        z, before_s = self._input_values, self.reading_times.item(k)
        if r.time_s == before_s:
            return
        self.reading_times[k] = r.time_s
        self._input_age[k] = t - r.time_s
        self._input_is_new[k] = 1 if r.valid else 2
        start = READING_STARTS[k]
        if k == READING_RANGE_RING:
            seen = np.asarray(r.value, dtype=np.float64)
            median_filter_ring_scan(seen, self._max_range_m, self.ring_scans, self.ranges)
            z[start : start + len(self._beam_indices)] = seen[self._beam_indices]
        else:
            if k == READING_POSITION_FIX and self.uses_fix_covariance:
                self._set_fix_noise(r, 0.0 if math.isnan(before_s) else r.time_s - before_s)
            offset = SUBTRACTED_READING_OFFSETS[k]
            z[start : start + READING_WIDTHS[k]] = r.value - offset if offset else r.value

    def _set_fix_noise(self, fix: Reading, since_s: float) -> None:
        """Set the filter's noise and bias variance of a fix from its own covariance, or else from the vehicle file."""
        s, file, four = self.backend.settings, self._vehicle_noise, slice(ERROR_FIX_BIAS, ERROR_FIX_HEADING + 1)
        noise = np.array([file["fix_variance"], file["fix_heading_variance"]])
        own = None if fix.covariance is None else np.diag(fix.covariance)
        wander = file["initial_sigma"][four] ** 2
        if own is not None and self.fix_correlation_s > 0.0:
            # Present variance of the filter's bias
            grown = 1.0 - math.exp(-2.0 * since_s / self.fix_correlation_s)
            self._fix_bias_variance = self._fix_bias_variance + grown * (
                self._fix_bias_variance_target - self._fix_bias_variance
            )
            self._fix_bias_variance_target = wander = np.maximum(wander, own)
            self._fix_bias_variance = np.minimum(self._fix_bias_variance, wander)
            rest = np.maximum(own - self._fix_bias_variance, 0.0) * (
                1.0 + 2.0 * self.fix_correlation_s / float(s["sensor_period"][READING_POSITION_FIX])
            )
            noise += [rest[:-1].max(), rest[-1]]
        elif own is not None:
            noise = np.array([own[:-1].max(), own[-1]])
        s["fix_variance"], s["fix_heading_variance"] = noise
        s["initial_sigma"][four] = np.sqrt(wander)

    # Interface for the compiled loop, which writes the input row, the reading times and the ranges itself

    @property
    def reading_indices(self) -> Mapping[str, int]:
        """Return the name of each reading that the filter uses, with its index in
        :data:`mufly.quantities.quantity_table.READINGS_WITH_FUSION_STATUS`.
        """
        return self._reading_indices

    @property
    def fused_beam_indices(self) -> NDArray[np.intp]:
        """Return the indices of the fused beams of the range ring."""
        return self._beam_indices

    @property
    def period_count(self) -> int:
        """Return the number of processed periods."""
        return self._period_count

    @property
    def covariance(self) -> _Array:
        """Return the latest published covariance (12, 12)."""
        covariance: _Array = self._published[0]
        return covariance

    @property
    def sensor_statuses(self) -> Sequence[SensorStatus]:
        """Return the status (fused, rejected, missing, faulty) of each sensor."""
        return self._sensor_statuses

    @property
    def max_range_m(self) -> float:
        """Return the maximum range of the range ring (m)."""
        return self._max_range_m

    @property
    def input_row(self) -> tuple[_Array, NDArray[np.int32], _Array]:
        """Return the input row of this period: values, flags of new readings, and their ages (s)."""
        return self._input_values, self._input_is_new, self._input_age

    @property
    def memory_array(self) -> NDArray[np.void]:
        """Return the memory as an array (1,)."""
        return self._memory_array
