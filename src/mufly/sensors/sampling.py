"""All sensors that measure every so often, asked in one compiled call, as a loop over many periods does.

Nothing is computed here that :meth:`mufly.sensors.periodic.PeriodicSensor.read` does not do with the same functions.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mufly.numba_cache import cached_njit
from mufly.sensors.electrical import BackEmfSensor, BatterySensor
from mufly.sensors.magnetometer import MagnetometerSensor
from mufly.sensors.periodic import (
    NEXT_SAMPLE,
    NO_MEASUREMENT,
    PENDING,
    PeriodicSensor,
    advance_if_due,
    publish_if_due,
)
from mufly.sensors.position_fix import PositionFixSensor
from mufly.sensors.pressure import PressureSensor
from mufly.sensors.readings import Sensor
from mufly.sensors.ring_camera import RingCamera
from mufly.sensors.sonar import UltrasonicSensor

_Array = NDArray[np.float64]

SAMPLED_SENSORS: tuple[type[PeriodicSensor], ...] = (
    UltrasonicSensor, RingCamera, PressureSensor, MagnetometerSensor, BackEmfSensor, BatterySensor, PositionFixSensor,
)  # fmt: skip
"""Sensors that :func:`sample_all` knows, in its order."""
_SONAR, _RING, _PRESSURE, _MAGNET, _ROTOR, _BATTERY, _FIX = range(len(SAMPLED_SENSORS))
# How many axes the arrays of each have that is not there: one compiled code for all vehicles.
_ARGUMENT_DIMENSIONS = (
    (1, 1, 2, 2, 2, 1),
    (1, 1, 2, 2, 2, 1, 1, 1, 1, 1, 2, 2),
    (1, 1, 1, 1),
    (1, 2, 3),
    (1,),
    (1,),
    (1, 1, 1),
)

(
    _sample_sonar,
    _sample_ring,
    _sample_pressure,
    _sample_magnetic_field,
    _sample_rotor_speeds,
    _sample_battery,
    _sample_position_fix,
) = (kind.sample_function for kind in SAMPLED_SENSORS)


def sampling_table(
    sensors: Mapping[int, Sensor],
) -> tuple[_Array, NDArray[np.uint8], _Array, tuple[Any, ...]]:
    """Return what :func:`sample_all` takes of the sensors, by their places in :data:`SAMPLED_SENSORS`; of others
    stand-ins.

    Until somebody writes when, none is asked.
    """
    none = (np.zeros(3), np.zeros(2, dtype=np.int64), np.zeros((2, 4)), np.zeros(1, dtype=np.uint64))
    parts = tuple(
        sensors[k].sampling_arguments if k in sensors else (*none, tuple(np.zeros((1,) * n) for n in axes))  # type: ignore[attr-defined]
        for k, axes in enumerate(_ARGUMENT_DIMENSIONS)
    )
    wide, count = max(rows.shape[1] for _, _, rows, *_ in parts), len(SAMPLED_SENSORS)
    return np.full(count, math.inf), np.zeros(count, np.uint8), np.zeros((count, wide)), parts


@cached_njit(error_model="numpy")
def _publish_to(t: float, wait: float, clock: _Array, counts: NDArray[np.int64], rows: _Array, told: _Array) -> bool:
    """Whether something is said, which then stands in ``told``, too."""
    if not publish_if_due(t, wait, clock, counts, rows):
        return False
    for j in range(rows.shape[1]):
        told[j] = rows[0, j]
    return True


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
    """Ask those sensors whose time has come (s); return until when none of them surely says anything new.

    Parameters
    ----------
    t, x, attitude, supply
        Time (s), state (21,), attitude (3,), voltage and current (2,).
    quiet : (7,) array
        Until when each surely says nothing new (s); infinite for those that are not to be asked.
    came : (7,) array of uint8
        Which said something, overwritten.
    told : (7, n) array
        What it was: the first of its rows.
    all_parts : tuple
        The last of :func:`sampling_table`.
    """
    # One after the other, though alike: a loop would take every array of every sensor into its hands in every period,
    # and each is counted (counting costs more than asking).
    for k in range(came.size):
        came[k] = 0
    if t >= quiet[_SONAR]:
        clock, counts, rows, source, parts = all_parts[_SONAR]
        wait = NO_MEASUREMENT
        if advance_if_due(t, clock):
            wait = _sample_sonar(t, x, attitude, supply, source, parts, rows[1 + counts[PENDING]])
        came[_SONAR], quiet[_SONAR] = (
            _publish_to(t, wait, clock, counts, rows, told[_SONAR]),
            clock[NEXT_SAMPLE],
        )
    if t >= quiet[_RING]:
        clock, counts, rows, source, parts = all_parts[_RING]
        wait = NO_MEASUREMENT
        if advance_if_due(t, clock):
            wait = _sample_ring(t, x, attitude, supply, source, parts, rows[1 + counts[PENDING]])
        came[_RING], quiet[_RING] = _publish_to(t, wait, clock, counts, rows, told[_RING]), clock[NEXT_SAMPLE]
    if t >= quiet[_PRESSURE]:
        clock, counts, rows, source, parts = all_parts[_PRESSURE]
        wait = NO_MEASUREMENT
        if advance_if_due(t, clock):
            wait = _sample_pressure(t, x, attitude, supply, source, parts, rows[1 + counts[PENDING]])
        came[_PRESSURE], quiet[_PRESSURE] = (
            _publish_to(t, wait, clock, counts, rows, told[_PRESSURE]),
            clock[NEXT_SAMPLE],
        )
    if t >= quiet[_MAGNET]:
        clock, counts, rows, source, parts = all_parts[_MAGNET]
        wait = NO_MEASUREMENT
        if advance_if_due(t, clock):
            wait = _sample_magnetic_field(t, x, attitude, supply, source, parts, rows[1 + counts[PENDING]])
        came[_MAGNET], quiet[_MAGNET] = (
            _publish_to(t, wait, clock, counts, rows, told[_MAGNET]),
            clock[NEXT_SAMPLE],
        )
    if t >= quiet[_ROTOR]:
        clock, counts, rows, source, parts = all_parts[_ROTOR]
        wait = NO_MEASUREMENT
        if advance_if_due(t, clock):
            wait = _sample_rotor_speeds(t, x, attitude, supply, source, parts, rows[1 + counts[PENDING]])
        came[_ROTOR], quiet[_ROTOR] = (
            _publish_to(t, wait, clock, counts, rows, told[_ROTOR]),
            clock[NEXT_SAMPLE],
        )
    if t >= quiet[_BATTERY]:
        clock, counts, rows, source, parts = all_parts[_BATTERY]
        wait = NO_MEASUREMENT
        if advance_if_due(t, clock):
            wait = _sample_battery(t, x, attitude, supply, source, parts, rows[1 + counts[PENDING]])
        came[_BATTERY], quiet[_BATTERY] = (
            _publish_to(t, wait, clock, counts, rows, told[_BATTERY]),
            clock[NEXT_SAMPLE],
        )
    if t >= quiet[_FIX]:
        clock, counts, rows, source, parts = all_parts[_FIX]
        wait = NO_MEASUREMENT
        if advance_if_due(t, clock):
            wait = _sample_position_fix(t, x, attitude, supply, source, parts, rows[1 + counts[PENDING]])
        came[_FIX], quiet[_FIX] = _publish_to(t, wait, clock, counts, rows, told[_FIX]), clock[NEXT_SAMPLE]
    wakes = math.inf
    for k in range(quiet.size):
        wakes = min(wakes, quiet[k])
    return wakes
