"""Position from outside: fixes that come by a link, from whoever finds the vehicle's place elsewhere.

:class:`ExternalFixes` takes the place of the statistical ``position_fix`` and goes through the same door, each fix
with its own time and its own covariance. It judges what comes before the filter sees it: numbers that are none, of a
place that is not known well enough, from the future, late, doubled or overtaken are refused, with the reason in words.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mufly.errors import MuflyError
from mufly.flight.fixes.camera_sensor import MAX_FIX_SIGMA_M
from mufly.flight.fixes.onboard_camera import PictureStream
from mufly.sensors import Reading, Sensor, Truth
from mufly.vehicle import Vehicle

_Array = NDArray[np.float64]
MAX_FIX_DELAY_S, MAX_FIX_LEAD_S = 1.0, 0.05
"""A fix that is older is refused, as the filter leads it on by the velocity alone; so is one that is yet to come."""
MAX_FIX_DISTANCE_M = 1000.0
MIN_SIGMA_M, MIN_SIGMA_RAD = 0.002, math.radians(0.05)
"""Nobody knows it better than that."""
MAX_SIGMA_RAD = math.radians(20.0)


class ExternalFixes(Sensor):
    """Reads ``position_fix`` (4,): N, E, D (m) and heading (rad), as it was given from outside.

    Parameters
    ----------
    vehicle : Vehicle
    stream : Stream, optional
        Its camera, for whoever tells it where it is.

    Raises
    ------
    MuflyError
        If the vehicle has no sensors that a filter could fly on, or its file no word about fixes.
    """

    def __init__(self, vehicle: Vehicle, stream: PictureStream | None = None) -> None:
        sensors = vehicle.sensors
        if sensors is None or sensors.imu is None or sensors.position_fix is None:
            raise MuflyError(
                f"{vehicle.name} has no inertial unit, or no table sensors.position_fix: a fix from outside would help "
                "nobody"
            )
        self._stream = stream
        self.reset()

    def reset(self) -> None:
        if self._stream is not None:
            self._stream.reset()
        self._said: dict[str, Reading] = {}
        self._last_s = -math.inf

    def true_readings(self, truth: Truth) -> dict[str, Any]:
        return {"position_fix": np.append(truth.position, truth.attitude[2])}

    def read(self, truth: Truth) -> Mapping[str, Reading]:
        if self._stream is not None:
            self._stream.send_if_due(truth)
        return self._said

    def close(self) -> None:
        """End the stream."""
        if self._stream is not None:
            self._stream.close()

    def submit_fix(self, now_s: float, time_s: float, place: _Array, covariance: _Array | None) -> str:
        """Take a fix.

        Parameters
        ----------
        now_s, time_s : float
            Of the flight: now, and when it was there (s).
        place : (4,) array
            N, E, D (m), heading (rad).
        covariance : (4, 4) array or None
            Of these; None: as the vehicle's file says.

        Returns
        -------
        str
            Why it is refused, in words; "" if it is taken.
        """
        why = _fix_fault(place, covariance)
        age = now_s - time_s
        if why:
            return why
        if not age >= -MAX_FIX_LEAD_S:
            return f"its time is {-age:.3f} s ahead of the vehicle's"
        if age > MAX_FIX_DELAY_S:
            return f"it is {age:.2f} s old, more than {MAX_FIX_DELAY_S:g} s"
        if time_s <= self._last_s:
            return "doubled, or overtaken by a later one"
        self._last_s = time_s
        if covariance is not None:
            least = np.array([MIN_SIGMA_M] * 3 + [MIN_SIGMA_RAD]) ** 2
            covariance = covariance + np.diag(np.maximum(least - np.diag(covariance), 0.0))
        self._said = {"position_fix": Reading(place.copy(), min(time_s, now_s), True, covariance)}
        return ""


def _fix_fault(place: _Array, covariance: _Array | None) -> str:
    if not np.isfinite(place).all():
        return "its numbers are none (NaN or infinite)"
    if np.abs(place[:3]).max() > MAX_FIX_DISTANCE_M:
        return f"its place is {np.abs(place[:3]).max():.0f} m away"
    *_, heading = place
    if abs(heading) > 2.1 * math.pi:
        return f"its heading is {heading:.1f} rad"
    if covariance is None:
        return ""
    own = np.diag(covariance)
    if not np.isfinite(covariance).all() or (own < 0.0).any():
        return "its covariance is none (negative variance, or not finite)"
    if np.linalg.eigvalsh(covariance)[0] < -1e-6 * max(float(own.max()), 1e-12):
        return "its covariance is none (not positive semidefinite)"
    if (sigma := math.sqrt(float(own[:2].max()))) > MAX_FIX_SIGMA_M:
        return f"its place is known to {sigma:.2f} m only, {MAX_FIX_SIGMA_M:g} m are needed"
    if (sigma := math.sqrt(float(own[-1]))) > MAX_SIGMA_RAD:
        return f"its heading is known to {math.degrees(sigma):.0f} degrees only"
    return ""
