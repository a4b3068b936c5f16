"""Define the estimate used by the flight software, and an ideal estimator, which returns the truth.

An estimator converts the :class:`mufly.sensors.Readings` of every instant into an :class:`Estimate`. The flight
software checks every estimate: an implausible one is replaced for a short time (:func:`check_estimate`), then reported
as lost.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mufly.compiled.portable_math import portable_atan2, sine_cosine, vector_length
from mufly.estimate.sensor_status import AuxiliaryStates
from mufly.sensors import Reading, Readings

_Array = NDArray[np.float64]

ZERO_COVARIANCE = np.zeros((12, 12))
"""Covariance of an estimate without error."""
ZERO_COVARIANCE.flags.writeable = False


def _nan_vector() -> _Array:
    return np.full(3, math.nan)


@dataclass(frozen=True, slots=True)
class Estimate:
    """The estimate at one instant; unknown values are NaN.

    Attributes
    ----------
    time_s : float
        Time since the start of the recording.
    position : (3,) array
        N, E, D (m), of the centre of gravity.
    velocity : (3,) array
        N, E, D (m/s).
    attitude : (3,) array
        Roll, pitch, yaw (rad); yaw is continuous (it does not jump at +-pi).
    rates : (3,) array
        p, q, r (rad/s), body axes.
    ranges : (n,) array
        Distance to the nearest obstacle along each beam of the range ring (m); the ring's maximum range
        without an obstacle.
    battery_voltage : float
        Terminal voltage (V).
    covariance : (12, 12) array
        Covariance of the errors of position, velocity, attitude and rates, in SI units.
    valid : bool
        Whether the estimator declares the estimate valid.
    auxiliary_states : AuxiliaryStates or None
        Further states of a filter; None for an ideal estimator.
    """

    time_s: float = math.nan
    position: _Array = field(default_factory=_nan_vector)
    velocity: _Array = field(default_factory=_nan_vector)
    attitude: _Array = field(default_factory=_nan_vector)
    rates: _Array = field(default_factory=_nan_vector)
    ranges: _Array = field(default_factory=lambda: np.zeros(0))
    battery_voltage: float = math.nan
    covariance: _Array = field(default_factory=lambda: ZERO_COVARIANCE)
    valid: bool = True
    auxiliary_states: AuxiliaryStates | None = None


class Estimator:
    """Base class: converts readings to an estimate, once a period of the flight software."""

    def update(self, readings: Readings, acting: _Array | None = None) -> Estimate:
        """Process the present readings and return the estimate.

        Parameters
        ----------
        readings : Readings
        acting : (4,) array, optional
            Motor upper, lower (0..1), servo 1, 2 (-1..1) that acted over the period that has just ended.
        """
        raise NotImplementedError

    def reset(self) -> None:
        """Return the estimator to its state before the first update."""


_MISSING_READING = Reading(_nan_vector(), math.nan)
_MISSING_RANGES_READING, _MISSING_VOLTAGE_READING = Reading(np.full(1, math.inf), math.nan), Reading(math.nan, math.nan)
_REQUIRED_ESTIMATES = ("position", "velocity", "attitude", "rates")


class IdealEstimator(Estimator):
    """Estimator that returns the readings of ideal sensors."""

    def update(self, readings: Readings, acting: _Array | None = None) -> Estimate:
        latest = readings.latest
        x, v, angles, rates = motion = [latest.get(name, _MISSING_READING) for name in _REQUIRED_ESTIMATES]
        return Estimate(
            readings.time_s,
            x.value,
            v.value,
            angles.value,
            rates.value,
            latest.get("ranges", _MISSING_RANGES_READING).value,
            latest.get("battery_voltage", _MISSING_VOLTAGE_READING).value,
            ZERO_COVARIANCE,
            all(reading.valid for reading in motion),
        )


def compute_standing_tilt(m: Estimate) -> float:
    """Return the tilt of a standing vehicle (rad): the greater of the estimated tilt and the tilt by its accelerometers
    alone.

    An estimator may attribute a lean to a bias of the accelerometers, or reject their reading. The accelerometers are
    therefore also evaluated alone.

    Parameters
    ----------
    m : Estimate
        Of a vehicle at rest; its attitude finite.
    """
    sine_roll, cosine_roll = sine_cosine(float(m.attitude[0]))
    sine_pitch, cosine_pitch = sine_cosine(float(m.attitude[1]))
    tilt = portable_atan2(vector_length(sine_pitch, sine_roll * cosine_pitch), cosine_roll * cosine_pitch)
    if m.auxiliary_states is not None:
        x, y, z = m.auxiliary_states.specific_force.tolist()
        tilt = max(tilt, portable_atan2(vector_length(x, y), -z))
    return float(tilt)


# Implausible estimates are bridged for a moment, then reported as lost.
#
# Faults are: a value that is not finite; position, velocity, attitude and rates all repeated bit for bit (a frozen
# sensor or link, since in flight the battery's decay alone causes motion); an estimate marked invalid. The last good
# values replace a faulty estimate, and the flight software gets the duration of the fault.
#
# Ranges that are not finite count as free. A voltage that is not positive is replaced by the last good one for any
# time: the battery changes slowly, and the control law limits the voltage.


MAX_ESTIMATE_VALUE = 1e6
"""Size from which a position, velocity, attitude or rate is implausible (m, m/s, rad, rad/s).

The squares of much larger values overflow in the flight software.
"""


@dataclass(frozen=True, slots=True)
class EstimateCheckState:
    """Values that :func:`check_estimate` keeps from one period to the next.

    Attributes
    ----------
    last_values : list of 12 floats
        Last received position, velocity, attitude and rates.
    last_good : Estimate
        The last good value of each quantity.
    lost_s : float
        Time for which position, velocity, attitude or rates have been missing or frozen (s).
    lost_quantities : str
        Names of the lost quantities.
    """

    last_values: list[float]
    last_good: Estimate
    lost_s: float = 0.0
    lost_quantities: str = ""


def _replace_bad_values(
    before: EstimateCheckState | None, m: Estimate, bad: list[str], period_s: float, max_range_m: float
) -> Estimate:
    """Return the estimate with each bad value replaced by its last good value, or by zero before the first good value.

    An estimate with replaced values is not valid: motors do not start with it.
    """
    replaced: dict[str, Any] = {
        name: np.zeros(3) if before is None else getattr(before.last_good, name) for name in bad
    }
    if bad:
        replaced["valid"] = False
    last_s = 0.0 if before is None else before.last_good.time_s
    if not math.isfinite(m.time_s) or (before is not None and m.time_s <= last_s):
        replaced["time_s"] = last_s + period_s
    if not np.all(np.isfinite(m.ranges)):
        replaced["ranges"] = np.where(np.isfinite(m.ranges), m.ranges, max_range_m)
    if not 0.0 < m.battery_voltage < math.inf:
        replaced["battery_voltage"] = 1.0 if before is None else before.last_good.battery_voltage
    return replace(m, **replaced)


def check_estimate(
    before: EstimateCheckState | None, m: Estimate, period_s: float, max_range_m: float
) -> EstimateCheckState:
    """Check an estimate and replace implausible values.

    Parameters
    ----------
    before : EstimateCheckState or None
        Result of the preceding check; None at the first.
    m : Estimate
        Estimate as received.
    period_s : float
        Time since the preceding estimate (s), by the clock of the flight software.
    max_range_m : float
        Range of a beam that detects nothing (m).

    Returns
    -------
    EstimateCheckState
        Its ``last_good`` is the estimate to use: finite, with an advancing clock.
    """
    values = [*m.position.tolist(), *m.velocity.tolist(), *m.attitude.tolist(), *m.rates.tolist()]
    frozen = before is not None and values == before.last_values
    later = before is None or m.time_s > before.last_good.time_s
    # A sum is finite only if all its terms are; the comparisons of min and max miss NaN.
    whole = math.isfinite(sum(values)) and min(values) > -MAX_ESTIMATE_VALUE and max(values) < MAX_ESTIMATE_VALUE
    whole = whole and math.isfinite(m.time_s) and later
    seen = (before is not None and m.ranges is before.last_good.ranges) or math.isfinite(sum(m.ranges.tolist()))
    if whole and seen and 0.0 < m.battery_voltage < math.inf and m.valid and not frozen:
        return EstimateCheckState(values, m)
    bad = [
        name for name in _REQUIRED_ESTIMATES if not (m.valid and np.all(np.abs(getattr(m, name)) < MAX_ESTIMATE_VALUE))
    ]
    good = _replace_bad_values(before, m, bad, period_s, max_range_m)
    if not bad and not frozen:
        return EstimateCheckState(values, good)
    lost_s = 0.0 if before is None else before.lost_s
    return EstimateCheckState(values, good, lost_s + period_s, " and ".join(bad) or "all, which is frozen")
