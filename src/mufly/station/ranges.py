"""Distances around a vehicle, from the two messages that tell them."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from mufly.link.dialect import MavMessage
from mufly.station.view import unknown

__all__ = ["Ranges", "read_distance", "read_ring"]

_NOTHING_KNOWN = 65535
_BODY_FRAME = 12  # MAV_FRAME_BODY_FRD


@dataclass(frozen=True, slots=True)
class Ranges:
    """Distances along beams.

    Attributes
    ----------
    ranges, angles : (n,) array
        m, NaN where it is not known; rad from the nose to the right.
    most_m : float
        What a beam that sees nothing returns (m).
    """

    ranges: NDArray[np.float64] = field(default_factory=lambda: unknown(0))
    angles: NDArray[np.float64] = field(default_factory=lambda: unknown(0))
    most_m: float = math.nan


def read_ring(m: MavMessage, heading_rad: float) -> Ranges:
    """Read OBSTACLE_DISTANCE: a ring of beams, from the nose or (turned back here) from north.

    Parameters
    ----------
    m : pymavlink message
    heading_rad : float
        For a ring that is told from north.
    """
    told = np.array(m.distances, dtype=np.float64)
    known = np.flatnonzero(told != _NOTHING_KNOWN)
    n = int(known[-1]) + 1 if len(known) else 0
    step = m.increment_f if m.increment_f > 0.0 else float(m.increment)
    if not math.isfinite(step):
        return Ranges()
    if step > 0.0:
        # The ring is whole even if its last beams are not known just now.
        n = max(n, min(len(told), round(360.0 / step)))
    most = m.max_distance / 100.0
    ranges = np.where(told[:n] == _NOTHING_KNOWN, math.nan, np.minimum(told[:n] / 100.0, most))
    first = m.angle_offset if math.isfinite(m.angle_offset) else 0.0
    angles = np.radians(first + step * np.arange(n))
    if m.frame != _BODY_FRAME and math.isfinite(heading_rad):
        angles = angles - heading_rad
    return Ranges(ranges, angles, most)


def read_distance(m: MavMessage, known: Ranges) -> Ranges:
    """Add a DISTANCE_SENSOR that looks to one of eight sides (orientation 0 to 7) to what is known."""
    n = 8
    ranges = known.ranges.copy() if len(known.ranges) == n else unknown(n)
    most = m.max_distance / 100.0
    ranges[m.orientation] = min(m.current_distance / 100.0, most)
    return Ranges(ranges, np.radians(45.0) * np.arange(n), most)
