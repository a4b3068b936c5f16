"""All sensors that measure every so often, asked in one compiled call, as a loop over many periods does.

Nothing is computed here that :meth:`mufly.sensors.periodic.Periodic.read` does not do with the same functions.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from mufly.compiled import compiled
from mufly.sensors.electrical import BackEmfSensor, BatterySensor
from mufly.sensors.magnetometer import MagnetometerSensor
from mufly.sensors.periodic import COMING, NOTHING, QUIET, Periodic, is_due, say
from mufly.sensors.position_fix import PositionFixSensor
from mufly.sensors.pressure import PressureSensor
from mufly.sensors.readings import Sensor
from mufly.sensors.ring_camera import RingCamera
from mufly.sensors.sonar import UltrasonicSensor

ASKED: tuple[type[Periodic], ...] = (
    UltrasonicSensor, RingCamera, PressureSensor, MagnetometerSensor, BackEmfSensor, BatterySensor, PositionFixSensor,
)  # fmt: skip
"""Sensors that :func:`ask` knows, in its order."""
# How many axes the arrays of each have that is not there: one compiled code for all vehicles.
_AXES = (
    (1, 1, 2, 2, 2, 1),
    (1, 1, 2, 2, 2, 1, 2, 2, 2, 1, 2, 3),
    (1, 1, 1, 1),
    (1, 2, 2),
    (1,),
    (1,),
    (1, 1, 1),
)

_sonar, _ring, _pressure, _field, _speeds, _battery, _fix = (kind.compute for kind in ASKED)


def parts_of(sensors: Mapping[int, Sensor]) -> tuple[Any, ...]:
    """Return what :func:`ask` takes of the sensors, by their places in :data:`ASKED`; of others stand-ins."""
    none = (np.zeros(3), np.zeros(2, dtype=np.int64), np.zeros((2, 4)), np.zeros(3, dtype=np.int64))
    return tuple(
        sensors[k].all_parts if k in sensors else (*none, tuple(np.zeros((1,) * n) for n in axes))  # type: ignore[attr-defined]
        for k, axes in enumerate(_AXES)
    )


@compiled(error_model="numpy")
def ask(t, x, attitude, supply, asked, came, all_parts):  # type: ignore[no-untyped-def]
    """Ask those sensors that are ``asked``, at a time (s); return until when none of them surely says anything new.

    Parameters
    ----------
    t, x, attitude, supply
        Time (s), state (21,), attitude (3,), voltage and current (2,).
    asked, came : (7,) arrays of uint8
        Which; and which said something, overwritten: it stands in the first of its rows.
    all_parts : tuple
        Of :func:`parts_of`.
    """
    sonar, ring, pressure, field, speeds, battery, fix = all_parts
    clocks = (sonar[0], ring[0], pressure[0], field[0], speeds[0], battery[0], fix[0])
    counts = (sonar[1], ring[1], pressure[1], field[1], speeds[1], battery[1], fix[1])
    rows = (sonar[2], ring[2], pressure[2], field[2], speeds[2], battery[2], fix[2])
    wakes = math.inf
    for k in range(7):
        came[k] = 0
        if asked[k] == 0:
            continue
        clock = clocks[k]
        if t >= clock[QUIET]:
            wait = NOTHING
            if is_due(t, clock):
                row = rows[k][1 + counts[k][COMING]]
                if k == 0:
                    wait = _sonar(t, x, attitude, supply, sonar[3], sonar[4], row)
                elif k == 1:
                    wait = _ring(t, x, attitude, supply, ring[3], ring[4], row)
                elif k == 2:
                    wait = _pressure(t, x, attitude, supply, pressure[3], pressure[4], row)
                elif k == 3:
                    wait = _field(t, x, attitude, supply, field[3], field[4], row)
                elif k == 4:
                    wait = _speeds(t, x, attitude, supply, speeds[3], speeds[4], row)
                elif k == 5:
                    wait = _battery(t, x, attitude, supply, battery[3], battery[4], row)
                else:
                    wait = _fix(t, x, attitude, supply, fix[3], fix[4], row)
            came[k] = say(t, wait, clock, counts[k], rows[k])
        wakes = min(wakes, clock[QUIET])
    return wakes
