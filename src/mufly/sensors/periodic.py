"""A sensor that measures every so often and says it some time later, and errors that wander.

All that such a sensor remembers stands in arrays, and what it does in compiled functions, so that a loop over many
periods (:mod:`mufly.sensors.together`) can ask it as :meth:`Periodic.read` does, with the same random numbers.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from mufly.compiled import compiled
from mufly.sensors.drawing import normals, source_of
from mufly.sensors.readings import Reading, Sensor, Truth

_Array = NDArray[np.float64]

# Of a clock: when it measures next, until when it surely says nothing new, its period (s)
DUE, QUIET, PERIOD = range(3)
# Of counts: measurements that are on their way, and how often something has been said
COMING, SAID = range(2)
# Of a row: when it is said, when it was measured (s), whether the sensor stands by it; the values follow
WHEN, TAKEN, STANDS, VALUES = range(4)
NOTHING = -1.0
"""What a measurement returns, instead of how long it takes (s), of which nothing will come."""
_ROUNDING_S = 1e-9
_ROOM = 8  # measurements on their way beyond those that are expected


@compiled(error_model="numpy")
def is_due(t: float, clock: _Array) -> bool:
    """Whether it measures at a time (s); its clock is set to the next.

    Measurements keep to their own clock, however coarse the periods of the flight software are.
    """
    if t < clock[DUE] - _ROUNDING_S:
        return False
    late = t - clock[DUE] > clock[PERIOD]
    clock[DUE] = (t if late else clock[DUE]) + clock[PERIOD]
    return True


@compiled(error_model="numpy")
def say(t: float, wait: float, clock: _Array, counts: NDArray[np.int64], rows: _Array) -> bool:
    """Whether something is said at a time (s), which then stands in the first of ``rows``.

    A measurement that takes ``wait`` (s) stands in the row after those on their way; of all that come at once the last
    counts.
    """
    n = counts[COMING]
    if wait >= 0.0 and n < rows.shape[0] - 2:  # the last row is there to be written to
        n += 1
        rows[n, WHEN], rows[n, TAKEN] = t + wait, t
    latest, kept, quiet = 0, 0, clock[DUE]
    for k in range(1, n + 1):
        when = rows[k, WHEN]
        if when <= t + _ROUNDING_S and (latest == 0 or when >= rows[0, WHEN]):
            latest = k
            for j in range(rows.shape[1]):
                rows[0, j] = rows[k, j]
    for k in range(1, n + 1):
        if rows[k, WHEN] > t + _ROUNDING_S:
            kept += 1
            quiet = min(quiet, rows[k, WHEN])
            for j in range(rows.shape[1]):
                rows[kept, j] = rows[k, j]
    counts[COMING] = kept
    clock[QUIET] = quiet - 2.0 * _ROUNDING_S  # surely nothing happens before that, by more than a rounding
    if latest == 0:
        return False
    counts[SAID] += 1
    return True


class Periodic(Sensor):
    """A sensor that measures every so often.

    Parameters
    ----------
    period_s : float
        Between measurements (s).
    rng : numpy.random.Generator
        What it draws from.
    parts : tuple of arrays
        What ``compute`` takes: what this sensor is like, and what it remembers.
    longest_s : float
        How long what it measures is on its way, in all likelihood (s).

    Attributes
    ----------
    says : mapping
        Name of a reading to where it stands in the values: an index, or a slice of them.
    compute : compiled function
        Measures: ``compute(t, x, attitude, supply, source, parts, row)`` with time (s), true state (21,), true
        attitude (3,), voltage and current of the battery (2,), what to draw from, and the row to be written to from
        :data:`STANDS` on; returns how long it takes until that is known (s), or :data:`NOTHING`.
    """

    says: Mapping[str, int | slice]
    compute: ClassVar[Callable[..., float]]

    def __init__(
        self, period_s: float, rng: np.random.Generator, parts: tuple[Any, ...], longest_s: float = 0.0
    ) -> None:
        self._rng, self.parts = rng, parts
        wide = max(k + 1 if isinstance(k, int) else int(k.stop) for k in self.says.values())
        room = math.ceil(longest_s / period_s) + _ROOM
        self.clock, self.counts = np.array([0.0, 0.0, period_s]), np.zeros(2, dtype=np.int64)
        self.rows = np.zeros((2 + room, VALUES + wide))
        self.source = source_of(rng)
        self._supply = np.zeros(2)
        self.reset()

    def reset(self) -> None:
        self.clock[[DUE, QUIET]] = -math.inf
        self.counts[:] = 0
        self._latest: dict[str, Reading] = {}

    @property
    def quiet_s(self) -> float:
        """Until when it surely says nothing new (s)."""
        return float(self.clock[QUIET])

    @property
    def all_parts(self) -> tuple[Any, ...]:
        """What :func:`mufly.sensors.together.ask` takes of it."""
        return (self.clock, self.counts, self.rows, self.source, self.parts)

    def read(self, truth: Truth) -> Mapping[str, Reading]:
        t = truth.time_s
        if t < self.clock[QUIET]:
            return self._latest
        wait = NOTHING
        if is_due(t, self.clock):
            row = self.rows[1 + self.counts[COMING]]
            self._supply[:] = truth.voltage, truth.current
            wait = type(self).compute(
                t, truth.state, truth.attitude, self._supply, self.source, self.parts, row
            )
        if say(t, wait, self.clock, self.counts, self.rows):
            self.said()
        return self._latest

    def said(self) -> Mapping[str, Reading]:
        """Make readings of what was said last."""
        row = self.rows[0]
        taken, stands, values = float(row[TAKEN]), bool(row[STANDS]), row[VALUES:]
        self._latest = {
            name: Reading(float(values[k]) if isinstance(k, int) else values[k].copy(), taken, stands)
            for name, k in self.says.items()
        }
        return self._latest


# Wandering: of ``memory`` the first is the time of the last error (s), or none; the errors follow.


@compiled(error_model="numpy")
def wander(t: float, sigma: _Array, time_s: float, memory: _Array, source: NDArray[np.uint64]) -> None:
    """Let errors wander to a time (s)."""
    elapsed = 0.0 if math.isnan(memory[0]) else max(0.0, t - memory[0])
    memory[0] = t
    if elapsed > 0.0:
        phi = math.exp(-elapsed / time_s)
        n = np.empty(sigma.size)
        normals(source, n)
        for k in range(sigma.size):
            memory[1 + k] = memory[1 + k] * phi + sigma[k] * math.sqrt(1.0 - phi * phi) * n[k]


def start_wandering(rng: np.random.Generator, sigma: _Array, memory: _Array) -> None:
    """Draw errors anew; the next time is the first."""
    memory[0], memory[1:] = math.nan, sigma * rng.standard_normal(sigma.size)


class Wander:
    """Errors that wander, each for itself: d x = -x dt / tau + sigma sqrt(2 dt / tau) n (first-order Gauss-Markov).

    Sampled exactly: x' = x phi + sigma sqrt(1 - phi^2) n with phi = exp(-dt / tau).
    """

    def __init__(self, rng: np.random.Generator, sigma: float | _Array, time_s: float, size: int = 1) -> None:
        self._source, self._rng, self._time_s = source_of(rng), rng, time_s
        self._sigma, self._memory = (
            np.array(np.broadcast_to(sigma, size), dtype=np.float64),
            np.empty(1 + size),
        )
        start_wandering(rng, self._sigma, self._memory)

    def at(self, time_s: float) -> _Array:
        """The errors at a time; times rise."""
        wander(time_s, self._sigma, self._time_s, self._memory, self._source)
        return self.value.copy()

    @property
    def value(self) -> _Array:
        """The errors at the time that was asked for last."""
        return self._memory[1:]
