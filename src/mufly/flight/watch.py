"""Measurements that cannot be right: bridged for a moment, then reported as lost.

A value that is not finite, or all of position, velocity, attitude and rates repeated to the last bit (a sensor or link
that hangs; in flight the battery alone sees to it that something moves), is a fault. The last good values stand in for
it. That is good for as long as they are nearly true; how long it has lasted is told to the flight software.

Ranges that are not finite count as nothing seen. A voltage that is not positive is replaced by the last good one, for
as long as it takes: the battery changes slowly, and the control law bounds what it believes.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from mufly.sensors import Measurement

__all__ = ["Watch", "watch"]

_VITAL = ("position", "velocity", "attitude", "rates")


@dataclass(frozen=True, slots=True)
class Watch:
    """What is remembered from one measurement to the next.

    Attributes
    ----------
    values : list of 12 floats
        Position, velocity, attitude and rates as they came last.
    good : Measurement
        The last good value of each quantity.
    lost_s : float
        For how long position, velocity, attitude or rates have been missing or frozen (s).
    what : str
        Which, in words.
    """

    values: list[float]
    good: Measurement
    lost_s: float = 0.0
    what: str = ""


def watch(before: Watch | None, m: Measurement, period_s: float, max_range_m: float) -> Watch:
    """Judge a measurement.

    Parameters
    ----------
    before : Watch or None
        From the measurement before; None at the first.
    m : Measurement
        As received.
    period_s : float
        Time since the one before (s), by the clock of the flight software.
    max_range_m : float
        What a beam that sees nothing returns (m).

    Returns
    -------
    Watch
        Its ``good`` is the measurement to work with: finite, and on a clock that moves on.
    """
    values = [*m.position.tolist(), *m.velocity.tolist(), *m.attitude.tolist(), *m.rates.tolist()]
    frozen = before is not None and values == before.values
    later = before is None or m.time_s > before.good.time_s
    # The sum of finite numbers of any sensible size is finite: one question for all, since this runs in every period.
    whole = math.isfinite(sum(values)) and math.isfinite(m.time_s) and later
    seen = (before is not None and m.ranges is before.good.ranges) or math.isfinite(sum(m.ranges.tolist()))
    if whole and seen and 0.0 < m.battery_voltage < math.inf and not frozen:
        return Watch(values, m)
    bad = [name for name in _VITAL if not np.all(np.isfinite(getattr(m, name)))]
    good = _mended(before, m, bad, period_s, max_range_m)
    if not bad and not frozen:
        return Watch(values, good)
    lost_s = 0.0 if before is None else before.lost_s
    return Watch(values, good, lost_s + period_s, " and ".join(bad) or "all, which is frozen")


def _mended(
    before: Watch | None, m: Measurement, bad: list[str], period_s: float, max_range_m: float
) -> Measurement:
    """The measurement with the last good values in place of bad ones; zero where there are none yet."""
    replaced: dict[str, Any] = {
        name: np.zeros(3) if before is None else getattr(before.good, name) for name in bad
    }
    last_s = 0.0 if before is None else before.good.time_s
    if not math.isfinite(m.time_s) or (before is not None and m.time_s <= last_s):
        replaced["time_s"] = last_s + period_s
    if not np.all(np.isfinite(m.ranges)):
        replaced["ranges"] = np.where(np.isfinite(m.ranges), m.ranges, max_range_m)
    if not 0.0 < m.battery_voltage < math.inf:
        replaced["battery_voltage"] = 1.0 if before is None else before.good.battery_voltage
    return replace(m, **replaced)
