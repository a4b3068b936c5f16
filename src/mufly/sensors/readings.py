"""What the flight software is told at one instant: a table of measured values on the clock of the vehicle."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mufly.dynamics import euler_from_quaternion, rotation
from mufly.vehicle import Vehicle
from mufly.world import World, ranges


@dataclass(frozen=True, slots=True)
class Measurement:
    """Measured values at one instant.

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
        Distance to the nearest obstacle along each beam of the range ring (m); the ring's greatest range
        where nothing was seen.
    battery_voltage : float
        Terminal voltage (V).
    """

    time_s: float
    position: NDArray[np.float64]
    velocity: NDArray[np.float64]
    attitude: NDArray[np.float64]
    rates: NDArray[np.float64]
    ranges: NDArray[np.float64]
    battery_voltage: float


# ----------------------------------------------------------------------------
# Ideal sensors: the truth, sampled. Real ones with noise, delay and clipping take their place one by one.
#
# The ring of beams (Fig. 6.18) turns and tilts with the fuselage: beam ``i`` of ``n`` points along
# ``alpha_i = alpha_0 + 2 pi i / n`` from x towards y, in the x-y plane of the body.


def beam_angles(vehicle: Vehicle) -> NDArray[np.float64]:
    """Return the direction of each beam of the range ring, from x towards y (rad), shape (n,)."""
    ring = vehicle.range_ring
    return float(ring.first_angle) + 2 * np.pi * np.arange(ring.count) / ring.count


def beam_directions(vehicle: Vehicle) -> NDArray[np.float64]:
    """Return the unit vectors of the beams in body axes, shape (n, 3)."""
    angle = beam_angles(vehicle)
    return np.column_stack([np.cos(angle), np.sin(angle), np.zeros_like(angle)])


def nearest_turn(angle: float, near: float) -> float:
    """Return ``angle`` plus the whole turns that bring it nearest to ``near`` (rad)."""
    return angle + 2 * math.pi * round((near - angle) / (2 * math.pi))


def ideal_ranges(
    state: NDArray[np.float64],
    world: World,
    directions: NDArray[np.float64],
    *,
    min_range_m: float,
    max_range_m: float,
) -> NDArray[np.float64]:
    """Return the distance to the nearest surface along every beam (m), shape (n,).

    Parameters
    ----------
    state : (21,) array
        State of the flight model.
    world : World
    directions : (n, 3) array
        Unit vectors in body axes, see :func:`beam_directions`.
    min_range_m, max_range_m : float
        Readings are held within these.
    """
    seen = ranges(world, state[0:3], directions @ rotation(state[6:10]).T, max_range_m)
    return np.maximum(seen, min_range_m)


def ideal_measurement(
    time_s: float,
    state: NDArray[np.float64],
    *,
    ranges: NDArray[np.float64],
    battery_voltage: float,
    last_yaw: float,
) -> Measurement:
    """Return the true state as a measurement.

    Parameters
    ----------
    time_s : float
    state : (21,) array
    ranges : (n,) array
        Latest readings of the ring (m).
    battery_voltage : float
        (V).
    last_yaw : float
        Yaw of the measurement before (rad), which this one continues.
    """
    attitude = euler_from_quaternion(state[6:10])
    attitude[2] = nearest_turn(float(attitude[2]), last_yaw)
    return Measurement(
        time_s, state[0:3].copy(), state[3:6].copy(), attitude, state[10:13].copy(), ranges, battery_voltage
    )
