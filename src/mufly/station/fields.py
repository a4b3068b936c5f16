"""Which field of which MAVLink message is which signal: one table.

Messages whose fields mean different things at different times (masks, quaternions, rings of beams) have functions of
their own in :mod:`mufly.station.telemetry`; everything that is a plain number times a factor is here. Source of fields
and units: https://mavlink.io/en/messages/common.html.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

__all__ = ["FIELDS", "Fields"]

_RPM = 2.0 * math.pi / 60.0
_UNKNOWN = 65535


@dataclass(frozen=True, slots=True)
class Fields:
    """The plain fields of a message.

    Attributes
    ----------
    group : str
        What they tell; several messages may tell the same.
    rank : int
        Of several messages that tell the same, the one with the lowest rank is believed while it comes.
    fields : tuple of (field, signal, factor)
        Number times factor is the signal in its unit.
    unknown : float or None
        Number that says "not known".
    """

    group: str
    rank: int
    fields: tuple[tuple[str, str, float], ...]
    unknown: float | None = None


def _same(fields: str, signal: str, labels: str, factor: float = 1.0) -> tuple[tuple[str, str, float], ...]:
    pairs = zip(fields.split(), labels.split(), strict=True)
    return tuple((field, f"{signal}_{label}", factor) for field, label in pairs)


_PILOT = _same(
    " ".join(f"chan{k}_raw" for k in range(1, 9)), "pilot_input", " ".join(str(k) for k in range(1, 9))
)
FIELDS: dict[str, Fields] = {
    "ATTITUDE": Fields(
        "attitude",
        0,
        _same("roll pitch yaw", "estimated_attitude", "roll pitch yaw")
        + _same("rollspeed pitchspeed yawspeed", "estimated_rates", "p q r"),
    ),
    "LOCAL_POSITION_NED": Fields(
        "position",
        0,
        _same("x y z", "estimated_position", "N E D") + _same("vx vy vz", "estimated_velocity", "N E D"),
    ),
    "VISION_POSITION_ESTIMATE": Fields(
        "measured",
        0,
        _same("x y z", "measured_position", "N E D")
        + _same("roll pitch yaw", "measured_attitude", "roll pitch yaw"),
    ),
    "RC_CHANNELS": Fields("pilot", 0, _PILOT, _UNKNOWN),
    "RC_CHANNELS_RAW": Fields("pilot", 1, _PILOT, _UNKNOWN),
}
"""Message -> its plain fields."""

RPM = {
    0: (("frequency", "measured_rotor_speed_upper", _RPM),),
    1: (("frequency", "measured_rotor_speed_lower", _RPM),),
}
"""RAW_RPM: index -> its field."""
