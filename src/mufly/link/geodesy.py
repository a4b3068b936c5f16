"""A place on the globe for a flight that knows only metres: north and east on the plane that touches it at an origin.

With the radii of curvature of the ellipsoid WGS 84 at the latitude phi of the origin (height h), meridional M and
transverse N::

    M = a (1 - e^2) / (1 - e^2 sin^2 phi)^(3/2),   N = a / (1 - e^2 sin^2 phi)^(1/2)
    north = (M + h) d_phi,     east = (N + h) cos(phi) d_lambda,     down = h - altitude

What the plane leaves out grows with the square of the distance d: about d^2 tan(phi) / (2 R) sideways and d^2 / (2 R)
in height, 8 cm each for a kilometre at 45 degrees, 8 micrometres for ten metres. MAVLink counts latitude and longitude
in 1e-7 degrees, which is 1.1 cm. Source: P. D. Groves, Principles of GNSS, Inertial and Multisensor Integrated
Navigation Systems, 2nd ed., Sec. 2.4.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

from mufly.errors import InputError

__all__ = ["Origin", "parse_origin"]

_A = 6_378_137.0
_E2 = 6.694379990141e-3


@dataclass(frozen=True)
class Origin:
    """Where N = E = D = 0 is: latitude and longitude (deg), altitude above the sea (m)."""

    lat_deg: float
    lon_deg: float
    alt_m: float

    @cached_property
    def _metres_per_deg(self) -> tuple[float, float]:
        phi = math.radians(self.lat_deg)
        w = 1.0 - _E2 * math.sin(phi) ** 2
        north = _A * (1.0 - _E2) / w**1.5 + self.alt_m
        east = (_A / math.sqrt(w) + self.alt_m) * math.cos(phi)
        return math.radians(north), math.radians(east)

    def to_global(self, north: float, east: float, down: float) -> tuple[float, float, float]:
        """Return latitude, longitude (deg) and altitude (m) of a place N, E, D (m)."""
        n, e = self._metres_per_deg
        return self.lat_deg + north / n, self.lon_deg + east / e, self.alt_m - down

    def to_local(self, lat_deg: float, lon_deg: float, alt_m: float) -> tuple[float, float, float]:
        """Return N, E, D (m) of a place on the globe."""
        n, e = self._metres_per_deg
        away = math.remainder(lon_deg - self.lon_deg, 360.0) if math.isfinite(lon_deg) else math.nan
        return (lat_deg - self.lat_deg) * n, away * e, self.alt_m - alt_m


def parse_origin(text: str, where: str = "--origin") -> Origin:
    """Read ``LAT,LON,ALT`` in degrees and metres.

    Raises
    ------
    InputError
        If it is no place between the polar circles' far sides (85 degrees), where east is still a direction.
    """
    try:
        numbers = [float(part) for part in text.split(",")]
    except ValueError:
        numbers = []
    example = "give LAT,LON,ALT in degrees and metres, as in 47.3769,8.5417,408"
    if len(numbers) != 3 or not all(math.isfinite(x) for x in numbers):
        raise InputError(where, "", f"{text!r} is no place on the globe", example)
    lat, lon, alt = numbers
    if abs(lat) > 85.0 or abs(lon) > 180.0 or not -500.0 <= alt <= 9000.0:
        raise InputError(where, "", f"{text!r} is outside of +-85, +-180 degrees and -500 to 9000 m", example)
    return Origin(lat, lon, alt)
