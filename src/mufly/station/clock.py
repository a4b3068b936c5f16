"""A vehicle's clock, made to run on.

MAVLink's ``time_boot_ms`` counts milliseconds since the vehicle was started, in 32 bits: it wraps after 49.7 days and
begins again when the vehicle is started anew. A station's history wants one clock that only goes forward. After a wrap
it goes on as if nothing had been; after a restart it goes on from where it was, by as much as passed here meanwhile.
"""

from __future__ import annotations

import math

__all__ = ["VehicleClock"]

_WRAP_S = 2**32 / 1e3
_NEAR_S = 60.0
"""It wrapped if it was so near the end and is so near the beginning (s)."""
_BACK_S = 2.0
"""A stamp so far behind the newest is no packet that came late (s)."""
_SURE = 3
"""So many such stamps in a row, and the vehicle was started anew: one alone may be damaged or very late."""


class VehicleClock:
    """Turns stamps into one clock that goes forward.

    Attributes
    ----------
    time_s : float
        The newest stamp on that clock; NaN before the first.
    restarts : int
        How often the vehicle was started anew.
    """

    def __init__(self) -> None:
        self.time_s = math.nan
        self.restarts = 0
        self._offset_s = 0.0
        self._heard_s = math.nan
        self._backward: list[float] = []

    def stamp(self, boot_ms: int, now_s: float) -> float:
        """Place a stamp.

        Parameters
        ----------
        boot_ms : int
            ``time_boot_ms``.
        now_s : float
            Our clock (s).

        Returns
        -------
        float
            s; NaN for a stamp that cannot be placed (yet).
        """
        own_s = boot_ms / 1e3
        if math.isnan(self.time_s):
            return self._forward(own_s, now_s)
        newest_s = self.time_s - self._offset_s
        if newest_s > _WRAP_S - _NEAR_S and own_s < _NEAR_S:
            self._offset_s += _WRAP_S
        elif own_s > _WRAP_S - _NEAR_S and newest_s < _NEAR_S:
            own_s -= _WRAP_S  # from before the wrap, late
        time_s = own_s + self._offset_s
        return self._behind(own_s, now_s) if time_s < self.time_s - _BACK_S else self._forward(time_s, now_s)

    def fits(self, boot_ms: int) -> bool:
        """Whether a stamp of unknown origin is plainly of this clock: within two seconds of the newest."""
        return abs(boot_ms / 1e3 + self._offset_s - self.time_s) < _BACK_S

    def _forward(self, time_s: float, now_s: float) -> float:
        self._backward.clear()
        if not time_s <= self.time_s:
            self.time_s, self._heard_s = time_s, now_s
        return time_s

    def _behind(self, own_s: float, now_s: float) -> float:
        """Judge a stamp far behind the newest: late, or the first ones after a restart, which go forward."""
        if self._backward and own_s < self._backward[-1]:
            self._backward.clear()
        self._backward.append(own_s)
        if len(self._backward) < _SURE or self._backward[-1] == self._backward[0]:
            return math.nan
        self.restarts += 1
        self._offset_s = self.time_s + max(now_s - self._heard_s, 1e-3) - own_s
        return self._forward(own_s + self._offset_s, now_s)
