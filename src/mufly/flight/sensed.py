"""What is recorded of a flight on sensors beside the truth: what they said, what was made of it; and both read back.

A row for every period of the flight software. A reading stands in the row in which it came, with the time at which it
was measured and whether the sensor stood by it; where nothing new came it is NaN. So a recording holds all that an
estimator was told, and running it again over the recording (:func:`replay`) gives the same estimate to the bit. Of the
covariance that a position fix may come with, variances are kept: an estimator asks for no more.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from mufly.dynamics.state import POSITION, RATES, VELOCITY
from mufly.estimate import Estimate, Estimator, KalmanEstimator
from mufly.flight.controllers import Actuators
from mufly.flight.plant import blank_row, common_writer
from mufly.flight.record.recorder import Recorder
from mufly.quantities import CHECKED, STATUSES
from mufly.sensors import READINGS, Reading, Readings, Truth

_Array = NDArray[np.float64]
FIX_WANDER_S = "fix_wander_s"
"""Attribute of a recording whose filter took fixes for as good as their covariance says: over how long their errors
hang together (s), :attr:`mufly.estimate.KalmanEstimator.wander_s`."""
_CODES = {status: float(k) for k, status in enumerate(STATUSES)}
_UNTIMED = ("clipping", "temperature")  # of the inertial unit: its accelerations tell the time
_FIX, _VARIANCE = "position_fix", "measured_position_fix_variance"
_MOTION = ("position", "velocity", "attitude", "rates")
_BELIEFS = ("gyro_bias", "accelerometer_bias", "floor_height", "fix_bias", "wind", "thrust_scale")


def sensed_row_writer(
    recorder: Recorder,
) -> Callable[[Truth, Readings, Estimate, Actuators, tuple[_Array, _Array, _Array], str], None]:
    """Return the function that appends a row of a flight on sensors.

    ``write(truth, readings, estimate, actuators, reference, state)``, as :func:`mufly.flight.plant.row_writer`.
    """
    row, part = blank_row(recorder)
    fill, put = common_writer(part), estimate_writer(part)
    said = {name: part[f"measured_{name}"] for name in READINGS}
    timed = {
        name: (part[f"measured_{name}_time"], part[f"measured_{name}_valid"])
        for name in READINGS
        if name not in _UNTIMED
    }
    variance = part[_VARIANCE]
    before: dict[str, Reading] = {}
    raw = row[_span(recorder, [*(f"measured_{name}" for name in READINGS), _VARIANCE], timed)]

    def write(
        truth: Truth,
        readings: Readings,
        estimate: Estimate,
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
                if reading.covariance is not None and name == _FIX:
                    variance[:] = reading.covariance.diagonal()
        put(estimate)
        part["range"][:] = estimate.ranges
        recorder.append(row, state)

    return write


def _span(recorder: Recorder, names: list[str], timed: dict[str, Any]) -> slice:
    """The columns of all readings, which stand together."""
    columns = recorder.layout.columns
    found = [columns[n] for n in [*names, *(f"measured_{t}_{x}" for t in timed for x in ("time", "valid"))]]
    return slice(min(c.start for c in found), max(c.stop for c in found))


def estimate_writer(part: dict[str, _Array]) -> Callable[[Estimate], None]:
    """Return what fills the part of a row (or its like) that is believed: ``write(estimate)``."""
    motion = [part[f"estimated_{name}"] for name in _MOTION]
    sigma = [part[f"estimated_{name}_sigma"] for name in _MOTION]
    beliefs = {name: part[f"estimated_{name}"] for name in _BELIEFS}
    checks = {name: (part[f"innovation_{name}"], part[f"status_{name}"]) for name in CHECKED}
    valid = part["estimated_valid"]

    def write(m: Estimate) -> None:
        for target, value in zip(motion, (m.position, m.velocity, m.attitude, m.rates), strict=True):
            target[:] = value
        deviation = np.sqrt(m.covariance.diagonal())
        for k, target in enumerate(sigma):
            target[:] = deviation[3 * k : 3 * k + 3]
        valid[0] = m.valid
        if m.beliefs is not None:
            for name, target in beliefs.items():
                target[:] = getattr(m.beliefs, name)
            for check in m.beliefs.checks:
                if check.name in checks:
                    innovation, status = checks[check.name]
                    innovation[0], status[0] = check.ratio, _CODES[check.status]

    return write


def readings_of(dataset: xr.Dataset) -> Iterator[tuple[Readings, _Array]]:
    """Yield the readings of every row of a flight on sensors, and what acted over the period that ended with it."""
    time = dataset["time"].values
    columns = {
        name: (
            dataset[f"measured_{name}"].values,
            dataset[f"measured_{'acceleration' if name in _UNTIMED else name}_time"].values,
            np.ones(len(time)) if name in _UNTIMED else dataset[f"measured_{name}_valid"].values,
        )
        for name in READINGS
    }
    inputs = np.hstack([dataset["motor_input"].values, dataset["servo_input"].values])
    came = {name: np.isfinite(when) for name, (_, when, _) in columns.items()}
    # Recordings of before have none
    told = dataset[_VARIANCE].values if _VARIANCE in dataset else np.full((len(time), 4), math.nan)
    latest: dict[str, Reading] = {}
    for k, t in enumerate(time.tolist()):
        for name, (value, when, valid) in columns.items():
            if came[name][k]:
                one = value[k].copy() if value.ndim == 2 else float(value[k])
                weighed = name == _FIX and bool(np.isfinite(told[k]).all())
                latest[name] = Reading(
                    one, float(when[k]), bool(valid[k]), np.diag(told[k]) if weighed else None
                )
        yield Readings(t, dict(latest)), inputs[k - 1] if k else np.zeros(4)


def replay(dataset: xr.Dataset, estimator: Estimator) -> list[Estimate]:
    """Return what an estimator makes of the readings of a recording, row by row; it weighs fixes as the one that flew
    did."""
    if isinstance(estimator, KalmanEstimator) and FIX_WANDER_S in dataset.attrs:
        estimator.by_covariance, estimator.wander_s = True, float(dataset.attrs[FIX_WANDER_S])
    estimator.reset()
    return [estimator.update(readings, acting) for readings, acting in readings_of(dataset)]


def is_sensed(dataset: xr.Dataset) -> bool:
    """Whether a recording holds what sensors said, as flights on sensors record it."""
    return all(f"measured_{name}_time" in dataset for name in READINGS if name not in _UNTIMED)


def believed(dataset: xr.Dataset, estimates: Sequence[Estimate]) -> xr.Dataset:
    """Return a recording with other estimates, one for each row, in place of those that were made in flight."""
    blocks = {
        str(name): np.full(dataset[name].shape, math.nan)
        for name in dataset.data_vars
        if str(name).startswith(("estimated_", "innovation_", "status_"))
    }
    for k, m in enumerate(estimates):
        row = {name: block[k : k + 1] if block.ndim == 1 else block[k] for name, block in blocks.items()}
        estimate_writer(row)(m)
    return dataset.assign({name: dataset[name].copy(data=block) for name, block in blocks.items()})


def truths_of(dataset: xr.Dataset) -> list[Truth]:
    """Return what was true at every row, as far as a recording has it."""
    columns = [dataset[f"truth_{name}"].values for name in ("position", "velocity", "attitude", "rates")]
    out = []
    for k, t in enumerate(dataset["time"].values.tolist()):
        x, v, attitude, rates = (c[k] for c in columns)
        state = np.full(21, math.nan)
        state[POSITION], state[VELOCITY], state[RATES] = x, v, rates
        out.append(Truth(t, k, state, attitude, np.full(3, math.nan), math.nan, math.nan))
    return out
