"""External position fixes, computed by another program and received over a link.

:class:`ExternalFixes` replaces the statistical ``position_fix``; each fix has its own time and covariance. Invalid
fixes are refused before they reach the filter, with a reason as text: a number is not finite, the standard deviation is
large, or the fix is late, repeated, out of order or from the future. A source that contradicts the inertial unit
(:mod:`mufly.flight.fixes.fix_monitor`) is refused, too; the vehicle then lands on the corrected motion of the source.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mufly.errors import MuflyError
from mufly.estimate import Estimate
from mufly.flight.fixes.camera_sensor import MAX_FIX_SIGMA_M
from mufly.flight.fixes.fix_monitor import FixMonitor
from mufly.flight.fixes.onboard_camera import PictureStreamServer
from mufly.sensors import Reading, Readings, Sensor, Truth
from mufly.vehicle import Vehicle

_Array = NDArray[np.float64]
MAX_FIX_DELAY_S, MAX_FIX_LEAD_S = 1.0, 0.05
"""Largest age of a fix and largest lead of its time over the vehicle's clock (s)."""
MAX_FIX_DISTANCE_M = 1000.0
MIN_FIX_SIGMA_M, MIN_FIX_HEADING_SIGMA_RAD = 0.002, math.radians(0.05)
"""Least standard deviations of a fix; smaller ones are increased."""
MAX_FIX_HEADING_SIGMA_RAD = math.radians(20.0)
_CORRECTED_FIX_COVARIANCE = np.diag([0.1**2] * 3 + [math.radians(1.0) ** 2])
"""Covariance of the corrected fixes of a refused source: large, so that the filter follows their motion only."""


class ExternalFixes(Sensor):
    """Sensor of ``position_fix`` (4,): N, E, D (m) and heading (rad), received from outside.

    Parameters
    ----------
    vehicle : Vehicle
    stream : PictureStreamServer, optional
        Stream of the vehicle's pictures for the program that computes the fixes.

    Raises
    ------
    MuflyError
        If the vehicle lacks an inertial unit or the table ``sensors.position_fix``.
    """

    def __init__(self, vehicle: Vehicle, stream: PictureStreamServer | None = None) -> None:
        sensors = vehicle.sensors
        if sensors is None or sensors.imu is None or sensors.position_fix is None:
            raise MuflyError(
                f"{vehicle.name} has no inertial unit, or no table sensors.position_fix, which external "
                "fixes require; add them to [sensors]"
            )
        self._stream = stream
        self._monitor = FixMonitor(float(sensors.position_fix.drift))
        self.reset()

    def reset(self) -> None:
        if self._stream is not None:
            self._stream.reset()
        self._said: dict[str, Reading] = {}
        self._last_s = -math.inf
        self._monitor.reset()

    def update_fix_monitor(self, readings: Readings, estimate: Estimate, is_resting: bool) -> None:
        """Pass the latest readings to the checks of the source (:class:`FixMonitor`)."""
        self._monitor.propagate_inertial_path(readings, estimate, is_resting)

    @property
    def source_fault(self) -> str:
        """Fault for which the source is refused, or ""."""
        return self._monitor.fault

    def error_free_readings(self, truth: Truth) -> dict[str, Any]:
        return {"position_fix": np.append(truth.position, truth.attitude[2])}

    def read(self, truth: Truth) -> Mapping[str, Reading]:
        if self._stream is not None:
            self._stream.send_if_due(truth)
        return self._said

    def close(self) -> None:
        """Close the stream."""
        if self._stream is not None:
            self._stream.close()

    def submit_fix(self, now_s: float, time_s: float, place: _Array, covariance: _Array | None) -> str:
        """Check a fix and make it the sensor's reading.

        Parameters
        ----------
        now_s, time_s : float
            Present time, and time of the fix (s, the flight's clock).
        place : (4,) array
            N, E, D (m), heading (rad).
        covariance : (4, 4) array or None
            Covariance of ``place``; None: that of the vehicle file.

        Returns
        -------
        str
            Reason of a refusal; "" if the fix is accepted.
        """
        why = _find_fix_fault(place, covariance)
        age = now_s - time_s
        if why:
            return why
        if not age >= -MAX_FIX_LEAD_S:
            return f"its time is {-age:.3f} s ahead of the vehicle's"
        if age > MAX_FIX_DELAY_S:
            return f"it is {age:.2f} s old, more than {MAX_FIX_DELAY_S:g} s"
        if time_s <= self._last_s:
            return "repeated, or older than the last fix"
        self._last_s = time_s
        if why := self._monitor.find_fix_refusal(time_s, place):
            if (corrected := self._monitor.correct_fix(time_s, place)) is not None:
                time_s, place = corrected
                self._said = {"position_fix": Reading(place, min(time_s, now_s), True, _CORRECTED_FIX_COVARIANCE)}
            return why
        if covariance is not None:
            least = np.array([MIN_FIX_SIGMA_M] * 3 + [MIN_FIX_HEADING_SIGMA_RAD]) ** 2
            covariance = covariance + np.diag(np.maximum(least - np.diag(covariance), 0.0))
        self._said = {"position_fix": Reading(place.copy(), min(time_s, now_s), True, covariance)}
        return ""


def _find_fix_fault(place: _Array, covariance: _Array | None) -> str:
    if not np.isfinite(place).all():
        return "its numbers are not finite (NaN or infinite)"
    if np.abs(place[:3]).max() > MAX_FIX_DISTANCE_M:
        return f"its position is {np.abs(place[:3]).max():.0f} m from the origin"
    *_, heading = place
    if abs(heading) > 2.1 * math.pi:
        return f"its heading is {heading:.1f} rad, outside +-2 pi"
    if covariance is None:
        return ""
    own = np.diag(covariance)
    if not np.isfinite(covariance).all() or (own < 0.0).any():
        return "its covariance is invalid (negative variance, or not finite)"
    if np.linalg.eigvalsh(covariance)[0] < -1e-6 * max(float(own.max()), 1e-12):
        return "its covariance is invalid (not positive semidefinite)"
    if (sigma := math.sqrt(float(own[:2].max()))) > MAX_FIX_SIGMA_M:
        return f"its position has a standard deviation of {sigma:.2f} m, more than {MAX_FIX_SIGMA_M:g} m"
    if (sigma := math.sqrt(float(own[-1]))) > MAX_FIX_HEADING_SIGMA_RAD:
        return f"its heading has a standard deviation of {math.degrees(sigma):.0f} degrees, too large"
    return ""
