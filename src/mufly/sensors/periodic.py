"""A sensor that measures every so often and says it some time later, and errors that wander.

All that such a sensor remembers stands in arrays, and what it does in compiled functions, so that a loop over many
periods (:mod:`mufly.sensors.sampling`) can ask it as :meth:`PeriodicSensor.read` does, with the same random numbers.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from mufly.numba_cache import cached_njit
from mufly.sensors.readings import Reading, Sensor, Truth
from mufly.sensors.rng import draw_normals, make_source

_Array = NDArray[np.float64]

# Of a clock: when it measures next, until when it surely says nothing new, its period (s)
NEXT_MEASUREMENT, NEXT_SAMPLE, CLOCK_PERIOD = range(3)
# Of counts: measurements that are on their way, and how often something has been said
PENDING, PUBLISHED_COUNT = range(2)
# Of a row: when it is said, when it was measured (s), whether the sensor stands by it; the values follow
PUBLISH_TIME, MEASURED_TIME, IS_VALID, FIRST_VALUE = range(4)
NO_MEASUREMENT = -1.0
"""What a measurement returns, instead of how long it takes (s), of which nothing will come."""
_TIME_TOLERANCE_S = 1e-9
_SPARE_ROWS = 8  # measurements on their way beyond those that are expected


@cached_njit(error_model="numpy")
def advance_if_due(t: float, clock: _Array) -> bool:
    """Whether it measures at a time (s); its clock is set to the next.

    Measurements keep to their own clock, however coarse the periods of the flight software are.
    """
    if t < clock[NEXT_MEASUREMENT] - _TIME_TOLERANCE_S:
        return False
    late = t - clock[NEXT_MEASUREMENT] > clock[CLOCK_PERIOD]
    clock[NEXT_MEASUREMENT] = (t if late else clock[NEXT_MEASUREMENT]) + clock[CLOCK_PERIOD]
    return True


@cached_njit(error_model="numpy")
def publish_if_due(t: float, wait: float, clock: _Array, counts: NDArray[np.int64], rows: _Array) -> bool:
    """Whether something is said at a time (s), which then stands in the first of ``pending_rows``.

    A measurement that takes ``wait`` (s) stands in the row after those on their way; of all that come at once the last
    counts.
    """
    n = counts[PENDING]
    if wait >= 0.0 and n < rows.shape[0] - 2:  # the last row is there to be written to
        n += 1
        rows[n, PUBLISH_TIME], rows[n, MEASURED_TIME] = t + wait, t
    latest, kept, quiet = 0, 0, clock[NEXT_MEASUREMENT]
    for k in range(1, n + 1):
        when = rows[k, PUBLISH_TIME]
        if when <= t + _TIME_TOLERANCE_S and (latest == 0 or when >= rows[0, PUBLISH_TIME]):
            latest = k
            for j in range(rows.shape[1]):
                rows[0, j] = rows[k, j]
    for k in range(1, n + 1):
        if rows[k, PUBLISH_TIME] > t + _TIME_TOLERANCE_S:
            kept += 1
            quiet = min(quiet, rows[k, PUBLISH_TIME])
            for j in range(rows.shape[1]):
                rows[kept, j] = rows[k, j]
    counts[PENDING] = kept
    clock[NEXT_SAMPLE] = quiet - 2.0 * _TIME_TOLERANCE_S  # surely nothing happens before that, by more than a rounding
    if latest == 0:
        return False
    counts[PUBLISHED_COUNT] += 1
    return True


class PeriodicSensor(Sensor):
    """A sensor that measures every so often.

    Parameters
    ----------
    period_s : float
        Between measurements (s).
    rng : numpy.random.Generator
        What it draws from.
    sample_arguments : tuple of arrays
        What ``sample_function`` takes: what this sensor is like, and what it remembers.
    longest_s : float
        How long what it measures is on its way, in all likelihood (s).

    Attributes
    ----------
    published_readings : mapping
        Name of a reading to where it stands in the values: an index, or a slice of them.
    sample_function : compiled function
        Measures: ``sample_function(t, x, attitude, supply, source, parts, row)`` with time (s), true state (21,), true
        attitude (3,), voltage and current of the battery (2,), what to draw from, and the row to be written to from
        :data:`IS_VALID` on; returns how long it takes until that is known (s), or :data:`NO_MEASUREMENT`.
    argument_dimensions : tuple of int
        Dimensions of each array of ``parts``: those of a sensor that is not there, so that all vehicles share one code.
    """

    published_readings: Mapping[str, int | slice]
    sample_function: ClassVar[Callable[..., float]]
    argument_dimensions: ClassVar[tuple[int, ...]]

    def __init__(
        self, period_s: float, rng: np.random.Generator, parts: tuple[Any, ...], longest_s: float = 0.0
    ) -> None:
        self._rng, self.sample_arguments = rng, parts
        wide = max(k + 1 if isinstance(k, int) else int(k.stop) for k in self.published_readings.values())
        room = math.ceil(longest_s / period_s) + _SPARE_ROWS
        self.clock, self.counts = np.array([0.0, 0.0, period_s]), np.zeros(2, dtype=np.int64)
        self.pending_rows = np.zeros((2 + room, FIRST_VALUE + wide))
        self.source = make_source(rng)
        self._supply = np.zeros(2)
        self.reset()

    def reset(self) -> None:
        self.clock[[NEXT_MEASUREMENT, NEXT_SAMPLE]] = -math.inf
        self.counts[:] = 0
        self._latest_readings: dict[str, Reading] = {}

    @property
    def next_sample_s(self) -> float:
        """Until when it surely says nothing new (s)."""
        return float(self.clock[NEXT_SAMPLE])

    @property
    def sampling_arguments(self) -> tuple[Any, ...]:
        """What :func:`mufly.sensors.sampling.sample_all` takes of it."""
        return (self.clock, self.counts, self.pending_rows, self.source, self.sample_arguments)

    def read(self, truth: Truth) -> Mapping[str, Reading]:
        t = truth.time_s
        if t < self.clock[NEXT_SAMPLE]:
            return self._latest_readings
        wait = NO_MEASUREMENT
        if advance_if_due(t, self.clock):
            row = self.pending_rows[1 + self.counts[PENDING]]
            self._supply[:] = truth.voltage, truth.current
            wait = type(self).sample_function(
                t, truth.state, truth.attitude, self._supply, self.source, self.sample_arguments, row
            )
        if publish_if_due(t, wait, self.clock, self.counts, self.pending_rows):
            self.make_readings()
        return self._latest_readings

    def make_readings(self) -> Mapping[str, Reading]:
        """Make readings of what was said last."""
        row = self.pending_rows[0]
        taken, stands, values = float(row[MEASURED_TIME]), bool(row[IS_VALID]), row[FIRST_VALUE:]
        self._latest_readings = {
            name: Reading(float(values[k]) if isinstance(k, int) else values[k].copy(), taken, stands)
            for name, k in self.published_readings.items()
        }
        return self._latest_readings


# Wandering: of ``memory`` the first is the time of the last error (s), or none; the errors follow.


@cached_njit(error_model="numpy")
def gauss_markov_step(t: float, sigma: _Array, time_s: float, memory: _Array, source: NDArray[np.uint64]) -> None:
    """Let errors wander to a time (s)."""
    elapsed = 0.0 if math.isnan(memory[0]) else max(0.0, t - memory[0])
    memory[0] = t
    if elapsed > 0.0:
        phi = math.exp(-elapsed / time_s)
        n = np.empty(sigma.size)
        draw_normals(source, n)
        for k in range(sigma.size):
            memory[1 + k] = memory[1 + k] * phi + sigma[k] * math.sqrt(1.0 - phi * phi) * n[k]


def gauss_markov_reset(rng: np.random.Generator, sigma: _Array, memory: _Array) -> None:
    """Draw errors anew; the next time is the first."""
    memory[0], memory[1:] = math.nan, sigma * rng.standard_normal(sigma.size)


class GaussMarkov:
    """Errors that wander, each for itself: d x = -x dt / tau + sigma sqrt(2 dt / tau) n (first-order Gauss-Markov).

    Sampled exactly: x' = x phi + sigma sqrt(1 - phi^2) n with phi = exp(-dt / tau).
    """

    def __init__(self, rng: np.random.Generator, sigma: float | _Array, time_s: float, size: int = 1) -> None:
        self._source, self._rng, self._time_s = make_source(rng), rng, time_s
        self._sigma, self._memory = (
            np.array(np.broadcast_to(sigma, size), dtype=np.float64),
            np.empty(1 + size),
        )
        gauss_markov_reset(rng, self._sigma, self._memory)

    def step_to(self, time_s: float) -> _Array:
        """The errors at a time; times rise."""
        gauss_markov_step(time_s, self._sigma, self._time_s, self._memory, self._source)
        return self.current_errors.copy()

    @property
    def current_errors(self) -> _Array:
        """The errors at the time that was asked for last."""
        return self._memory[1:]
