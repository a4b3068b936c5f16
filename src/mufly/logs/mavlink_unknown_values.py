"""Special values of MAVLink fields that mean unknown, and their replacement by NaN.

MAVLink's definitions give them by message and field (attribute ``invalid``; mavlink.io, "MAVLink XML Schema"): a value,
``[value]`` for each element of an array, ``[value:]`` for an array that is unknown as a whole if its first element has
this value. The table is built at first use from the definitions that pymavlink contains, because pymavlink's generated
Python omits the attribute. For some fields only the description states the value; they are listed here, with those of
PX4's topics (docs.px4.io, "uORB Message Reference").
"""

from __future__ import annotations

import re
import xml.etree.ElementTree as ElementTree
from collections.abc import Mapping
from functools import cache
from importlib.resources import files
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray


class _UnknownValue(NamedTuple):
    """Value of a field that means unknown, and whether it makes a whole array unknown as its first element."""

    value: float
    applies_to_array: bool = False


_INTEGER_MAXIMUM_BY_NAME = {
    f"{'U' * u}INT{n}_MAX": float(2 ** (n if u else n - 1) - 1) for u in (0, 1) for n in (8, 16, 32, 64)
}
_DIALECT_FILES = ("minimal.xml", "standard.xml", "common.xml", "ardupilotmega.xml")
# In a clock 0 also means unknown; readers of clocks handle it.
_CLOCK_FIELD_PATTERN = re.compile(r"^time_")
_UNKNOWN_RC_CHANNEL_VALUES = {f"chan{k}_raw": 65535.0 for k in range(1, 19)}
_DOCUMENTED_UNKNOWNS: Mapping[str, Mapping[str, float]] = {
    "RC_CHANNELS": {**_UNKNOWN_RC_CHANNEL_VALUES, "rssi": 255},
    "RC_CHANNELS_RAW": {**_UNKNOWN_RC_CHANNEL_VALUES, "rssi": 255},
    "RC_CHANNELS_SCALED": {f"chan{k}_scaled": 32767 for k in range(1, 9)} | {"rssi": 255},
    "GLOBAL_POSITION_INT": {"hdg": 65535},
    "RAW_IMU": {"temperature": 0},
    "SCALED_IMU": {"temperature": 0},
    "SCALED_IMU2": {"temperature": 0},
    "SCALED_IMU3": {"temperature": 0},
    "BATTERY_STATUS": {"voltages_ext": 0, "time_remaining": 0},
    "OPTICAL_FLOW": {"ground_distance": -1},
    "ALTITUDE": {"altitude_terrain": -1000},
    # Topics of PX4.
    "battery_status": {
        "voltage_v": 0, "voltage_filtered_v": 0, "current_a": -1, "current_filtered_a": -1, "current_average_a": -1,
        "discharged_mah": -1, "remaining": -1,
    },
}  # fmt: skip


@cache
def _load_unknown_values() -> Mapping[tuple[str, str], _UnknownValue]:
    out: dict[tuple[str, str], _UnknownValue] = {}
    folder = files("pymavlink.dialects.v20")
    for name in _DIALECT_FILES:
        try:
            root = ElementTree.fromstring((folder / name).read_bytes())
        except (OSError, ElementTree.ParseError):  # without the definitions only the listed values are known
            continue
        for message in root.iter("message"):
            for field in message.iter("field"):
                found = _parse_unknown_value(field.get("invalid", ""))
                if found is not None and not _CLOCK_FIELD_PATTERN.match(field.get("name", "")):
                    out[message.get("name", ""), field.get("name", "")] = found
    out |= {(m, f): _UnknownValue(float(v)) for m, fields in _DOCUMENTED_UNKNOWNS.items() for f, v in fields.items()}
    return out


def _parse_unknown_value(text: str) -> _UnknownValue | None:
    """Return the value for unknown that a MAVLink definition states; None for other text and for NaN."""
    match = re.fullmatch(r"\[?([^\[\]:,]+)(:?)\]?", text.strip())
    if match is None:
        return None
    word = match[1].strip()
    try:
        value = (
            _INTEGER_MAXIMUM_BY_NAME[word]
            if word in _INTEGER_MAXIMUM_BY_NAME
            else float(int(word, 0))
            if word.startswith("0x")
            else float(word)
        )
    except ValueError:
        return None
    return None if np.isnan(value) else _UnknownValue(value, bool(match[2]))


def replace_unknown_values(message: str, fields: Mapping[str, NDArray[Any]]) -> dict[str, NDArray[Any]]:
    """Return the fields of a message with NaN for values that mean unknown.

    Parameters
    ----------
    message : str
        ``"SYS_STATUS"``, or a topic of PX4 (``"battery_status"``).
    fields : dict of str to (n,) array
        Fields; element k of an array is ``name[k]``. Fields without special values keep their type.
    """
    table = _load_unknown_values()
    out = dict(fields)
    for name, values in fields.items():
        base, bracket, _ = name.partition("[")
        rule = table.get((message, base))
        if rule is None or values.dtype.kind not in "biuf":
            continue
        asked = fields.get(f"{base}[0]", values) if bracket and rule.applies_to_array else values
        nothing = asked == rule.value
        if nothing.any():
            out[name] = np.where(nothing, np.nan, values.astype(np.float64))
    return out
