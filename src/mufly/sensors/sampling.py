"""Sampling of all periodic sensors in one compiled call, for loops over many periods.

The compiled functions are those of :meth:`mufly.sensors.periodic.PeriodicSensor.read`.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mufly.compiled.numba_cache import cached_njit
from mufly.compiled.numba_intrinsics import borrow_arrays, refer_to
from mufly.quantities.sensor_table import SENSORS
from mufly.sensors.periodic import (
    CLOCK_NEXT_SAMPLE_INDEX,
    NO_MEASUREMENT_DELAY_S,
    PENDING_COUNT_INDEX,
    PeriodicSensor,
    publish_if_due,
    schedule_next_if_due,
)
from mufly.sensors.readings import Sensor
from mufly.sensors.sensor_suite import SENSOR_CLASSES

_Array = NDArray[np.float64]

_PERIODIC_SENSOR_CLASSES = {name: kind for name, kind in SENSOR_CLASSES.items() if issubclass(kind, PeriodicSensor)}
SAMPLED_SENSORS: tuple[type[PeriodicSensor], ...] = tuple(_PERIODIC_SENSOR_CLASSES.values())
"""Sensors that :func:`sample_all` samples, in its order."""
SAMPLED_READING_INDICES = tuple(
    -1 if (k := SENSORS[name][0].filter_index) is None else k for name in _PERIODIC_SENSOR_CLASSES
)
"""Index of the first reading of each sensor in the tables of the filter; -1 where the filter does not use it."""


def collect_sampling_arguments(
    sensors: Mapping[int, Sensor],
) -> tuple[_Array, NDArray[np.uint8], _Array, tuple[Any, ...]]:
    """Return the arguments of :func:`sample_all` for sensors by their indices in :data:`SAMPLED_SENSORS`.

    Absent sensors get placeholders. No sensor is sampled until the array of times is set.
    """
    none = (np.zeros(3), np.zeros(2, dtype=np.int64), np.zeros((2, 4)), np.zeros(1, dtype=np.uint64))
    absent = [tuple(np.zeros((1,) * n) for n in kind.argument_dimensions) for kind in SAMPLED_SENSORS]
    parts = tuple(
        sensors[k].sampling_arguments if k in sensors else (*none, absent[k])  # type: ignore[attr-defined]
        for k in range(len(absent))
    )
    wide, count = max(rows.shape[1] for _, _, rows, *_ in parts), len(SAMPLED_SENSORS)
    return np.full(count, math.inf), np.zeros(count, np.uint8), np.zeros((count, wide)), parts


@cached_njit(error_model="numpy")
def _publish_to_filter(
    t: float, wait: float, clock: _Array, counts: NDArray[np.int64], rows: _Array, told: _Array
) -> bool:
    """Return whether a sample is published; if so, copy the sample to ``told``, the filter's inputs."""
    if not publish_if_due(t, wait, clock, counts, rows):
        return False
    for j in range(rows.shape[1]):
        told[j] = rows[0, j]
    return True


@cached_njit(inline="always")
def _sample_no_sensor(
    t: float,
    x: _Array,
    attitude: _Array,
    supply: _Array,
    quiet: _Array,
    came: NDArray[np.uint8],
    told: _Array,
    all_parts: tuple[Any, ...],
) -> None:
    """Sample no sensor."""


def _append_sensor_sampling(sample_others: Any, k: int, sample: Any) -> Any:
    """Return a compiled function that calls ``sample_others`` and then samples sensor ``k``.

    Each sensor has arrays of other types and a function of its own, so one compiled loop over the sensors is
    impossible.
    """

    @cached_njit(error_model="numpy", inline="always")
    def sample_in_turn(t, x, attitude, supply, quiet, came, told, all_parts):  # type: ignore[no-untyped-def]
        sample_others(t, x, attitude, supply, quiet, came, told, all_parts)
        if t >= quiet[k]:
            clock, counts, rows, source, parts = all_parts[k]
            wait = NO_MEASUREMENT_DELAY_S
            if schedule_next_if_due(t, clock):
                wait = sample(t, x, attitude, supply, source, parts, rows[1 + counts[PENDING_COUNT_INDEX]])
            came[k], quiet[k] = (
                _publish_to_filter(t, wait, clock, counts, rows, told[k]),
                clock[CLOCK_NEXT_SAMPLE_INDEX],
            )

    return sample_in_turn


_sample_in_turn = _sample_no_sensor
for _k, _kind in enumerate(SAMPLED_SENSORS):
    _sample_in_turn = _append_sensor_sampling(_sample_in_turn, _k, _kind.sample_function)


@cached_njit(error_model="numpy")
def sample_all(
    t: float,
    x: _Array,
    attitude: _Array,
    supply: _Array,
    quiet: _Array,
    came: NDArray[np.uint8],
    told: _Array,
    all_parts: tuple[Any, ...],
) -> float:
    """Sample every sensor that is due at time ``t``; return the earliest time of any sensor's next sample (s).

    Parameters
    ----------
    t, x, attitude, supply
        Time (s), state (21,), attitude (3,), voltage and current (2,).
    quiet : (7,) array
        Earliest time of each sensor's next sample (s); infinite for sensors that are not sampled.
    came : (7,) array of uint8
        Set to 1 for sensors that published a sample.
    told : (7, n) array
        The published samples: the first row of each sensor's pending rows.
    all_parts : tuple
        Last item of the result of :func:`collect_sampling_arguments`.
    """
    # Reference counting of the caller's arrays costs more than sampling.
    x, attitude, supply, quiet = borrow_arrays((x, attitude, supply, quiet))
    came, told = borrow_arrays((came, told))
    for k in range(came.size):
        came[k] = 0
    _sample_in_turn(t, x, attitude, supply, quiet, came, told, refer_to(all_parts))
    wakes = math.inf
    for k in range(quiet.size):
        wakes = min(wakes, quiet[k])
    return wakes
