"""Recording of the readings and estimates of a flight with sensors, and its replay.

A recording has a row for every period of the flight software. A new reading is in the row of its arrival, with its
measurement time and its validity; rows without a new reading hold NaN. A recording therefore contains all inputs of the
estimator, and a replay (:func:`replay_estimator`) gives bitwise equal estimates. Only the variances of a position fix
are recorded; the estimator does not use the rest of its covariance.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from mufly.dynamics.model_state import BODY_RATE_SLICE, NED_POSITION_SLICE, NED_VELOCITY_SLICE
from mufly.estimate import Estimate, Estimator, KalmanEstimator
from mufly.flight.controllers import Actuators
from mufly.flight.record.recorder import FlightRecorder
from mufly.flight.simulated_plant import make_blank_row, make_common_writer
from mufly.quantities.quantity_table import FUSION_STATUSES, READINGS_WITH_FUSION_STATUS
from mufly.quantities.sensor_table import READINGS
from mufly.sensors import Reading, Readings, Truth

_Array = NDArray[np.float64]
FIX_CORRELATION_TIME_ATTRIBUTE = "fix_wander_s"
"""Attribute of a recording: correlation time (s) of the fixes' errors, if the filter used the covariance of the fixes
(:attr:`mufly.estimate.KalmanEstimator.fix_correlation_s`)."""
_STATUS_CODES = {status: float(k) for k, status in enumerate(FUSION_STATUSES)}
_READINGS_WITHOUT_TIME = tuple(name for name, row in READINGS.items() if not row.is_timed)
_VARIANCE_SIGNALS = {name: f"measured_{name}_variance" for name, row in READINGS.items() if row.variance is not None}
_MOTION_FIELDS = ("position", "velocity", "attitude", "rates")
_AUXILIARY_STATE_FIELDS = ("gyro_bias", "accelerometer_bias", "floor_height", "fix_bias", "wind", "thrust_scale")


def make_sensed_row_writer(
    recorder: FlightRecorder,
) -> Callable[[Truth, Readings, Estimate | None, Actuators, tuple[_Array, _Array, _Array], str], None]:
    """Return a function that appends one row, with readings and estimate, to the recording of a flight.

    The function is ``write(truth, readings, estimate, actuators, reference, state)``, with arguments as for
    :func:`mufly.flight.simulated_plant.make_row_writer`. If the estimate is None, its columns are NaN.
    """
    row, part = make_blank_row(recorder)
    fill, put = make_common_writer(part), make_estimate_writer(part)
    said = {name: part[f"measured_{name}"] for name in READINGS}
    timed = {
        name: (part[f"measured_{name}_time"], part[f"measured_{name}_valid"])
        for name in READINGS
        if name not in _READINGS_WITHOUT_TIME
    }
    variances = {name: part[signal] for name, signal in _VARIANCE_SIGNALS.items()}
    before: dict[str, Reading] = {}
    raw = row[
        _reading_columns(recorder, [*(f"measured_{name}" for name in READINGS), *_VARIANCE_SIGNALS.values()], timed)
    ]

    def write_row(
        truth: Truth,
        readings: Readings,
        estimate: Estimate | None,
        actuators: Actuators,
        reference: tuple[_Array, _Array, _Array],
        state: str,
    ) -> None:
        row[0] = truth.time_s
        fill(truth, actuators, reference)
        raw[:] = math.nan
        for name, reading in readings.latest.items():
            if before.get(name) is not reading and name in said:
                before[name] = reading
                said[name][:] = reading.value
                if name in timed:
                    when, valid = timed[name]
                    when[0], valid[0] = reading.time_s, reading.valid
                if reading.covariance is not None and name in variances:
                    variances[name][:] = reading.covariance.diagonal()
        if estimate is not None:
            put(estimate)
            part["range"][:] = estimate.ranges
        recorder.append_row(row, state)

    return write_row


def _reading_columns(recorder: FlightRecorder, names: list[str], timed: dict[str, Any]) -> slice:
    """Return the range of columns that holds all readings; these columns are contiguous."""
    columns = recorder.layout.column_slices
    found = [columns[n] for n in [*names, *(f"measured_{t}_{x}" for t in timed for x in ("time", "valid"))]]
    return slice(min(c.start for c in found), max(c.stop for c in found))


def make_estimate_writer(part: dict[str, _Array]) -> Callable[[Estimate], None]:
    """Return the function ``write(estimate)`` that fills a row's columns of the estimate."""
    motion = [part[f"estimated_{name}"] for name in _MOTION_FIELDS]
    sigma = [part[f"estimated_{name}_sigma"] for name in _MOTION_FIELDS]
    beliefs = {name: part[f"estimated_{name}"] for name in _AUXILIARY_STATE_FIELDS}
    checks = {name: (part[f"innovation_{name}"], part[f"status_{name}"]) for name in READINGS_WITH_FUSION_STATUS}
    valid = part["estimated_valid"]

    def write_estimate(m: Estimate) -> None:
        for target, value in zip(motion, (m.position, m.velocity, m.attitude, m.rates), strict=True):
            target[:] = value
        deviation = np.sqrt(m.covariance.diagonal())
        for target, values in zip(sigma, deviation.reshape(-1, 3), strict=True):
            target[:] = values
        valid[0] = m.valid
        if m.auxiliary_states is not None:
            for name, target in beliefs.items():
                target[:] = getattr(m.auxiliary_states, name)
            for check in m.auxiliary_states.checks:
                if check.name in checks:
                    innovation, status = checks[check.name]
                    innovation[0], status[0] = check.ratio, _STATUS_CODES[check.status]

    return write_estimate


def iterate_readings_and_inputs(dataset: xr.Dataset) -> Iterator[tuple[Readings, _Array]]:
    """Yield the readings of every row, and the inputs (4,) that acted over the period before it."""
    time = dataset["time"].values
    columns = {
        name: (
            dataset[f"measured_{name}"].values,
            dataset[f"measured_{'acceleration' if name in _READINGS_WITHOUT_TIME else name}_time"].values,
            np.ones(len(time)) if name in _READINGS_WITHOUT_TIME else dataset[f"measured_{name}_valid"].values,
        )
        for name in READINGS
    }
    inputs = np.hstack([dataset["motor_input"].values, dataset["servo_input"].values])
    came = {name: np.isfinite(when) for name, (_, when, _) in columns.items()}
    variances = {name: dataset[signal].values for name, signal in _VARIANCE_SIGNALS.items() if signal in dataset}
    latest: dict[str, Reading] = {}
    for k, t in enumerate(time.tolist()):
        for name, (value, when, valid) in columns.items():
            if came[name][k]:
                one = value[k].copy() if value.ndim == 2 else float(value[k])
                variance = variances[name][k] if name in variances else math.nan
                covariance = np.diag(variance) if np.isfinite(variance).all() else None
                latest[name] = Reading(one, float(when[k]), bool(valid[k]), covariance)
        yield Readings(t, dict(latest)), inputs[k - 1] if k else np.zeros(4)


def replay_estimator(dataset: xr.Dataset, estimator: Estimator) -> list[Estimate]:
    """Return an estimator's estimates from the readings of a recording, one for each row.

    Fixes have the same weights as in flight.
    """
    if isinstance(estimator, KalmanEstimator) and FIX_CORRELATION_TIME_ATTRIBUTE in dataset.attrs:
        estimator.uses_fix_covariance, estimator.fix_correlation_s = (
            True,
            float(dataset.attrs[FIX_CORRELATION_TIME_ATTRIBUTE]),
        )
    estimator.reset()
    return [estimator.update(readings, acting) for readings, acting in iterate_readings_and_inputs(dataset)]


def has_sensor_readings(dataset: xr.Dataset) -> bool:
    """Whether a recording holds the readings of all sensors, each with its measurement time."""
    return all(f"measured_{name}_time" in dataset for name in READINGS if name not in _READINGS_WITHOUT_TIME)


def replace_estimates(dataset: xr.Dataset, estimates: Sequence[Estimate]) -> xr.Dataset:
    """Return a recording with other estimates, one for each row, in place of those of the flight."""
    blocks = {
        str(name): np.full(dataset[name].shape, math.nan)
        for name in dataset.data_vars
        if str(name).startswith(("estimated_", "innovation_", "status_"))
    }
    for k, m in enumerate(estimates):
        row = {name: block[k : k + 1] if block.ndim == 1 else block[k] for name, block in blocks.items()}
        make_estimate_writer(row)(m)
    return dataset.assign({name: dataset[name].copy(data=block) for name, block in blocks.items()})


def list_truths(dataset: xr.Dataset) -> list[Truth]:
    """Return the truth of every row; unrecorded values are NaN."""
    columns = [dataset[f"truth_{name}"].values for name in ("position", "velocity", "attitude", "rates")]
    out = []
    for k, t in enumerate(dataset["time"].values.tolist()):
        x, v, attitude, rates = (c[k] for c in columns)
        state = np.full(21, math.nan)
        state[NED_POSITION_SLICE], state[NED_VELOCITY_SLICE], state[BODY_RATE_SLICE] = x, v, rates
        out.append(Truth(t, k, state, attitude, np.full(3, math.nan), math.nan, math.nan))
    return out
