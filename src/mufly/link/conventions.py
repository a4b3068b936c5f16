"""What MAVLink's numbers stand for here: a place on the globe, and a flight mode.

A flight knows only metres: north and east on the plane that touches the globe at an origin. With the radii of curvature
of the ellipsoid WGS 84 at the latitude phi of the origin (height h), meridional M and transverse N::

    M = a (1 - e^2) / (1 - e^2 sin^2 phi)^(3/2),   N = a / (1 - e^2 sin^2 phi)^(1/2)
    north = (M + h) d_phi,     east = (N + h) cos(phi) d_lambda,     down = h - altitude

What the plane leaves out grows with the square of the distance d: about d^2 tan(phi) / (2 R) sideways and d^2 / (2 R)
in height, 8 cm each for a kilometre at 45 degrees, 8 micrometres for ten metres. MAVLink counts latitude and longitude
in 1e-7 degrees, which is 1.1 cm. Source: P. D. Groves, Principles of GNSS, Inertial and Multisensor Integrated
Navigation Systems, 2nd ed., Sec. 2.4.

States of the mission are flight modes of PX4, whose words MAVLink programs know. MAVLink leaves ``custom_mode`` to each
autopilot; PX4 puts a main mode in its third byte and a sub mode in its fourth (PX4-Autopilot,
``src/modules/commander/px4_custom_mode.h``).

============= ==================== =============================================================================
mission state PX4's mode           asked for, it means
============= ==================== =============================================================================
init          AUTO READY (4, 1)    (not a thing to ask for)
take-off      AUTO TAKEOFF (4, 2)  take off
hover         AUTO LOITER (4, 3)   stop and hover
waypoint      AUTO MISSION (4, 4)  fly the mission, or go on with it; AUTO LOITER while a single point is flown to
obstacle      the one it returns to
landing       AUTO LAND (4, 6)     land
(return)      AUTO RTL (4, 5)      above where it took off, then land
rc            ALTCTL (2, 0)        fly by sticks; MANUAL, POSCTL and STABILIZED mean the same here
offboard      OFFBOARD (6, 0)      follow the stream of set-points
============= ==================== =============================================================================
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Literal, NamedTuple

from mufly.errors import ArgumentError
from mufly.mission import State

ABOVE_SEA, ABOVE_ORIGIN = (0, 5), (3, 6)
"""Values of MAV_FRAME on the globe, with altitude above the sea, and above the origin."""
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

    def to_local(
        self, lat_deg: float, lon_deg: float, alt_m: float, frame: int = 0
    ) -> tuple[float, float, float]:
        """Return N, E, D (m) of a place on the globe; its altitude is above the sea unless the MAV_FRAME says not."""
        n, e = self._metres_per_deg
        away = math.remainder(lon_deg - self.lon_deg, 360.0) if math.isfinite(lon_deg) else math.nan
        down = -alt_m if frame in ABOVE_ORIGIN else self.alt_m - alt_m
        return (lat_deg - self.lat_deg) * n, away * e, down


def parse_origin(text: str) -> Origin:
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
        raise ArgumentError("origin", "", f"{text!r} is no place on the globe", example)
    lat, lon, alt = numbers
    if abs(lat) > 85.0 or abs(lon) > 180.0 or not -500.0 <= alt <= 9000.0:
        problem = f"{text!r} is outside of +-85, +-180 degrees and -500 to 9000 m"
        raise ArgumentError("origin", "", problem, example)
    return Origin(lat, lon, alt)


Ask = Literal["take-off", "hover", "mission", "return", "land", "rc", "offboard", ""]


class Mode(NamedTuple):
    """Main and sub mode."""

    main: int
    sub: int


READY, TAKE_OFF, LOITER, MISSION, RETURN, LAND = (Mode(4, sub) for sub in range(1, 7))
ALTITUDE, OFFBOARD = Mode(2, 0), Mode(6, 0)

_ASKED: dict[Mode, Ask] = {
    TAKE_OFF: "take-off",
    LOITER: "hover",
    MISSION: "mission",
    RETURN: "return",
    LAND: "land",
    OFFBOARD: "offboard",
}
_BY_HAND = (1, 2, 3, 7)
_OF_STATE: dict[str, Mode] = {
    State.INIT: READY,
    State.TAKE_OFF: TAKE_OFF,
    State.HOVER: LOITER,
    State.WAYPOINT: MISSION,
    State.OBSTACLE: MISSION,
    State.LANDING: LAND,
    State.RC: ALTITUDE,
    State.OFFBOARD: OFFBOARD,
}


def mode_of(state: str, manual: bool = False, returning: bool = False) -> Mode:
    """Return the mode that shows a state of the mission.

    Parameters
    ----------
    state : str
        A text of :class:`mufly.mission.State`.
    manual : bool
        Whether it flies on a user's signal instead of the mission.
    returning : bool
        Whether it is on its way home.
    """
    if returning and state in (State.WAYPOINT, State.OBSTACLE):
        return RETURN
    if manual and state in (State.WAYPOINT, State.OBSTACLE):
        return LOITER
    return _OF_STATE[state]


def custom_mode(mode: Mode) -> int:
    """Return the number that a heartbeat carries."""
    return mode.main << 16 | mode.sub << 24


def mode_of_custom(number: int) -> Mode:
    """Inverse of :func:`custom_mode`."""
    return Mode(number >> 16 & 0xFF, number >> 24 & 0xFF)


def asked(mode: Mode) -> Ask:
    """Return what to do when a mode is asked for; "" if there is no such thing here."""
    if mode.main in _BY_HAND:
        return "rc"
    return _ASKED.get(Mode(6, 0) if mode.main == 6 else mode, "")
