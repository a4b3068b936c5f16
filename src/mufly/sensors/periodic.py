"""Sensors that measure periodically and publish after a delay, and Gauss-Markov errors.

The state of a periodic sensor is held in arrays, and its behaviour is a compiled function. A compiled loop over many
periods (:mod:`mufly.sensors.sampling`) therefore samples the sensor as :meth:`PeriodicSensor.read` does, with the same
random numbers.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from mufly.compiled.numba_cache import cached_njit
from mufly.sensors.readings import Reading, Sensor, Truth
from mufly.sensors.rng import draw_normals, make_random_source

_Array = NDArray[np.float64]

# Indices of a clock: time of the next measurement, earliest time of the next sample, period (s)
CLOCK_NEXT_MEASUREMENT_INDEX, CLOCK_NEXT_SAMPLE_INDEX, CLOCK_PERIOD_INDEX = range(3)
# Indices of the counts: pending measurements, published samples
PENDING_COUNT_INDEX, PUBLISHED_COUNT_INDEX = range(2)
# Columns of a row: time of publishing, time of measurement (s), validity; the values follow
ROW_PUBLISH_TIME_INDEX, ROW_MEASURED_TIME_INDEX, ROW_IS_VALID_INDEX, ROW_FIRST_VALUE_INDEX = range(4)
NO_MEASUREMENT_DELAY_S = -1.0
"""Returned by a sample function in place of the delay (s) if there is no measurement."""
_TIME_TOLERANCE_S = 1e-9
_SPARE_ROW_COUNT = 8  # for pending measurements beyond the expected number


@cached_njit(error_model="numpy")
def schedule_next_if_due(t: float, clock: _Array) -> bool:
    """Return whether the sensor measures at a time (s); if so, schedule the next measurement.

    Measurements keep their own clock, however long the periods of the flight software are.
    """
    if t < clock[CLOCK_NEXT_MEASUREMENT_INDEX] - _TIME_TOLERANCE_S:
        return False
    late = t - clock[CLOCK_NEXT_MEASUREMENT_INDEX] > clock[CLOCK_PERIOD_INDEX]
    clock[CLOCK_NEXT_MEASUREMENT_INDEX] = (t if late else clock[CLOCK_NEXT_MEASUREMENT_INDEX]) + clock[
        CLOCK_PERIOD_INDEX
    ]
    return True


@cached_njit(error_model="numpy")
def publish_if_due(t: float, wait: float, clock: _Array, counts: NDArray[np.int64], rows: _Array) -> bool:
    """Queue a new sample; if one is due, copy it to ``rows[0]`` and return True, else return False.

    A measurement with the delay ``wait`` (s) is appended to the pending rows. Of several samples due at once, the last
    counts.
    """
    n = counts[PENDING_COUNT_INDEX]
    if wait >= 0.0 and n < rows.shape[0] - 2:  # the last row is scratch space
        n += 1
        rows[n, ROW_PUBLISH_TIME_INDEX], rows[n, ROW_MEASURED_TIME_INDEX] = t + wait, t
    latest, kept, quiet = 0, 0, clock[CLOCK_NEXT_MEASUREMENT_INDEX]
    for k in range(1, n + 1):
        when = rows[k, ROW_PUBLISH_TIME_INDEX]
        if when <= t + _TIME_TOLERANCE_S and (latest == 0 or when >= rows[0, ROW_PUBLISH_TIME_INDEX]):
            latest = k
            for j in range(rows.shape[1]):
                rows[0, j] = rows[k, j]
    for k in range(1, n + 1):
        if rows[k, ROW_PUBLISH_TIME_INDEX] > t + _TIME_TOLERANCE_S:
            kept += 1
            quiet = min(quiet, rows[k, ROW_PUBLISH_TIME_INDEX])
            for j in range(rows.shape[1]):
                rows[kept, j] = rows[k, j]
    counts[PENDING_COUNT_INDEX] = kept
    clock[CLOCK_NEXT_SAMPLE_INDEX] = (
        quiet - 2.0 * _TIME_TOLERANCE_S
    )  # nothing happens earlier, by more than a rounding error
    if latest == 0:
        return False
    counts[PUBLISHED_COUNT_INDEX] += 1
    return True


class PeriodicSensor(Sensor):
    """Base class of a sensor that measures periodically.

    Parameters
    ----------
    period_s : float
        Time between measurements (s).
    rng : numpy.random.Generator
        Source of random numbers.
    sample_arguments : tuple of arrays
        Parameters and state of this sensor, passed to ``sample_function``.
    longest_s : float
        Longest likely delay from measuring to publishing (s).

    Attributes
    ----------
    published_readings : mapping
        Name of a reading to its index or slice in the values.
    sample_function : compiled function
        Measures: ``sample_function(t, x, attitude, supply, source, parts, row)``. Arguments are time (s), true state
        (21,), true attitude (3,), voltage and current of the battery (2,), random source, ``sample_arguments``, and the
        row to be filled from :data:`ROW_IS_VALID_INDEX` on. Returns the delay (s), or :data:`NO_MEASUREMENT_DELAY_S`.
    argument_dimensions : tuple of int
        Dimensions of each array of ``parts``, used for an absent sensor, so that all vehicles share one compiled code.
    """

    published_readings: Mapping[str, int | slice]
    sample_function: ClassVar[Callable[..., float]]
    argument_dimensions: ClassVar[tuple[int, ...]]

    def __init__(
        self, period_s: float, rng: np.random.Generator, parts: tuple[Any, ...], longest_s: float = 0.0
    ) -> None:
        self._rng, self.sample_arguments = rng, parts
        wide = max(k + 1 if isinstance(k, int) else int(k.stop) for k in self.published_readings.values())
        room = math.ceil(longest_s / period_s) + _SPARE_ROW_COUNT
        self.clock, self.counts = np.array([0.0, 0.0, period_s]), np.zeros(2, dtype=np.int64)
        self.pending_rows = np.zeros((2 + room, ROW_FIRST_VALUE_INDEX + wide))
        self.source = make_random_source(rng)
        self._supply = np.zeros(2)
        self.reset()

    def reset(self) -> None:
        self.clock[[CLOCK_NEXT_MEASUREMENT_INDEX, CLOCK_NEXT_SAMPLE_INDEX]] = -math.inf
        self.counts[:] = 0
        self._readings: dict[str, Reading] = {}
        self._readings_count = 0

    @property
    def next_sample_s(self) -> float:
        """Earliest time of the next sample (s)."""
        return float(self.clock[CLOCK_NEXT_SAMPLE_INDEX])

    @property
    def sampling_arguments(self) -> tuple[Any, ...]:
        """Arguments of :func:`mufly.sensors.sampling.sample_all` for this sensor."""
        return (self.clock, self.counts, self.pending_rows, self.source, self.sample_arguments)

    def read(self, truth: Truth) -> Mapping[str, Reading]:
        t = truth.time_s
        if t < self.clock.item(CLOCK_NEXT_SAMPLE_INDEX):
            is_current = self.counts.item(PUBLISHED_COUNT_INDEX) == self._readings_count  # no property: half the time
            return self._readings if is_current else self.latest_readings
        wait = NO_MEASUREMENT_DELAY_S
        if schedule_next_if_due(t, self.clock):
            row = self.pending_rows[1 + self.counts[PENDING_COUNT_INDEX]]
            self._supply[:] = truth.battery_voltage_V, truth.battery_current_A
            wait = type(self).sample_function(
                t, truth.state, truth.attitude, self._supply, self.source, self.sample_arguments, row
            )
        publish_if_due(t, wait, self.clock, self.counts, self.pending_rows)
        return self.latest_readings

    @property
    def latest_readings(self) -> Mapping[str, Reading]:
        count = self.counts.item(PUBLISHED_COUNT_INDEX)
        if count != self._readings_count:
            self._readings_count = count
            row = self.pending_rows[0]
            taken, stands, values = (
                float(row[ROW_MEASURED_TIME_INDEX]),
                bool(row[ROW_IS_VALID_INDEX]),
                row[ROW_FIRST_VALUE_INDEX:],
            )
            self._readings = {
                name: Reading(float(values[k]) if isinstance(k, int) else values[k].copy(), taken, stands)
                for name, k in self.published_readings.items()
            }
        return self._readings


# Gauss-Markov errors: the first entry of ``memory`` is the time of the last step (s), or NaN; the errors follow.


@cached_njit(error_model="numpy")
def propagate_gauss_markov(t: float, sigma: _Array, time_s: float, memory: _Array, source: NDArray[np.uint64]) -> None:
    """Propagate errors, d x = -x dt / tau + sigma sqrt(2 dt / tau) n, to a time (s), which must not decrease.

    Sampled exactly: x' = x phi + sigma sqrt(1 - phi^2) n with phi = exp(-dt / tau).
    """
    elapsed = 0.0 if math.isnan(memory[0]) else max(0.0, t - memory[0])
    memory[0] = t
    if elapsed > 0.0:
        phi = math.exp(-elapsed / time_s)
        n = np.empty(sigma.size)
        draw_normals(source, n)
        for k in range(sigma.size):
            memory[1 + k] = memory[1 + k] * phi + sigma[k] * math.sqrt(1.0 - phi * phi) * n[k]


def draw_stationary_gauss_markov(rng: np.random.Generator, sigma: _Array, memory: _Array) -> None:
    """Draw new errors from their stationary distribution; the next :func:`propagate_gauss_markov` sets their time."""
    memory[0], memory[1:] = math.nan, sigma * rng.standard_normal(sigma.size)
