"""One table of units, and the way from each to SI: ``si = factor x + offset``.

The headers of logs and bench files, vehicle files, column maps, the settings of a study and whatever shows a number in
units that people read take their factors from here. Inside the package everything is in SI and radians.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from math import pi

from mufly.errors import InputError

STANDARD_GRAVITY_M_S2 = 9.80665
"""Standard acceleration of free fall (m/s2; 3rd CGPM, 1901)."""
GRAVITY = 9.81
"""Acceleration of free fall where vehicles fly (m/s2): mid-latitude, as the thesis's hover point implies.

The standard one is a definition: it says what a kilogram-force is, not how fast something falls.
"""
RPM = pi / 30.0
"""One revolution a minute in rad/s."""

_G, _TURN, _FT, _INCH = STANDARD_GRAVITY_M_S2, 2 * pi, 0.3048, 0.0254
# SI unit: the units that lead to it, with factor and offset.
_TABLE: dict[str, dict[str, tuple[float, float]]] = {
    "s": {"s": (1, 0), "ms": (1e-3, 0), "us": (1e-6, 0), "ns": (1e-9, 0), "min": (60, 0), "h": (3600, 0)},
    "rad": {"rad": (1, 0), "deg": (pi / 180, 0), "mrad": (1e-3, 0), "cdeg": (pi / 18000, 0), "rev": (_TURN, 0)},
    "rad/s": {
        "rad/s": (1, 0), "rpm": (RPM, 0), "deg/s": (pi / 180, 0), "rps": (_TURN, 0), "Hz": (_TURN, 0),
        "krpm": (_TURN * 1000 / 60, 0), "mrad/s": (1e-3, 0), "cdeg/s": (pi / 18000, 0),
    },
    "rad/s^2": {"rad/s^2": (1, 0), "deg/s^2": (pi / 180, 0)},
    "m": {
        "m": (1, 0), "cm": (1e-2, 0), "mm": (1e-3, 0), "dm": (0.1, 0), "km": (1e3, 0), "ft": (_FT, 0),
        "in": (_INCH, 0),
    },
    "m2": {"m2": (1, 0), "cm2": (1e-4, 0), "mm2": (1e-6, 0)},
    "m/s": {
        "m/s": (1, 0), "dm/s": (0.1, 0), "cm/s": (1e-2, 0), "mm/s": (1e-3, 0), "km/h": (1 / 3.6, 0),
        "ft/s": (_FT, 0), "kn": (1852 / 3600, 0),
    },
    "m/s^2": {"m/s^2": (1, 0), "cm/s^2": (1e-2, 0), "mm/s^2": (1e-3, 0), "gee": (_G, 0), "mgee": (_G / 1000, 0)},
    "V": {"V": (1, 0), "mV": (1e-3, 0), "cV": (1e-2, 0)},
    "A": {"A": (1, 0), "mA": (1e-3, 0), "cA": (1e-2, 0)},
    "A s": {"A s": (1, 0), "A h": (3600, 0), "mA h": (3.6, 0)},
    "ohm": {"ohm": (1, 0), "mohm": (1e-3, 0)},
    "V s": {"V s": (1, 0), "mV s": (1e-3, 0)},
    "W": {"W": (1, 0), "mW": (1e-3, 0), "kW": (1e3, 0)},
    "N": {"N": (1, 0), "mN": (1e-3, 0), "kN": (1e3, 0), "gf": (_G / 1000, 0), "kgf": (_G, 0)},
    "N m": {"N m": (1, 0), "mN m": (1e-3, 0), "uN m": (1e-6, 0), "N mm": (1e-3, 0), "N cm": (1e-2, 0)},
    "N m/A": {"N m/A": (1, 0), "mN m/A": (1e-3, 0)},
    "N m s": {"N m s": (1, 0), "mN m s": (1e-3, 0), "uN m s": (1e-6, 0)},
    "N s/m": {"N s/m": (1, 0)},
    "N/m": {"N/m": (1, 0)},
    "kg": {"kg": (1, 0), "g": (1e-3, 0)},
    "kg m2": {"kg m2": (1, 0), "g cm2": (1e-7, 0)},
    "kg/m3": {"kg/m3": (1, 0)},
    "Pa": {"Pa": (1, 0), "hPa": (100, 0), "mbar": (100, 0), "kPa": (1e3, 0), "bar": (1e5, 0)},
    "Pa s": {"Pa s": (1, 0), "uPa s": (1e-6, 0)},
    "K": {"K": (1, 0), "degC": (1, 273.15), "cdegC": (0.01, 273.15)},
    "T": {"T": (1, 0), "mT": (1e-3, 0), "uT": (1e-6, 0), "gauss": (1e-4, 0), "mgauss": (1e-7, 0)},
    "T/A": {"T/A": (1, 0), "uT/A": (1e-6, 0)},
    "m/s^2/sqrt(Hz)": {"m/s^2/sqrt(Hz)": (1, 0), "ugee/sqrt(Hz)": (_G * 1e-6, 0)},
    "rad/s/sqrt(Hz)": {"rad/s/sqrt(Hz)": (1, 0), "deg/s/sqrt(Hz)": (pi / 180, 0)},
    "rad/s/(m/s^2)": {"rad/s/(m/s^2)": (1, 0), "deg/s/gee": (pi / 180 / _G, 0)},
    "m/s^2/K": {"m/s^2/K": (1, 0), "mgee/K": (_G * 1e-3, 0)},
    "rad/s/K": {"rad/s/K": (1, 0), "deg/s/K": (pi / 180, 0)},
    "1": {"1": (1, 0), "%": (1e-2, 0), "d%": (1e-3, 0), "c%": (1e-4, 0)},
}  # fmt: skip
_BY_UNIT = {u: (si, float(f), float(o)) for si, units in _TABLE.items() for u, (f, o) in units.items()}
_SPELLINGS = {
    "°": "deg", "degree": "deg", "degrees": "deg", "radian": "rad", "radians": "rad", "sec": "s", "second": "s",
    "seconds": "s", "µs": "us", "μs": "us", "usec": "us", "msec": "ms", "micros": "us", "millis": "ms",
    "dps": "deg/s", "°/s": "deg/s", "degps": "deg/s", "deg/sec": "deg/s", "rad/sec": "rad/s", "rads": "rad/s",
    "radps": "rad/s", "rpm": "rpm", "RPM": "rpm", "1/min": "rpm", "1/s": "rad/s", "mps": "m/s", "m/sec": "m/s",
    "m/s/s": "m/s^2", "m/s2": "m/s^2", "m/s²": "m/s^2", "m/s**2": "m/s^2", "mps2": "m/s^2", "mG": "mgee",
    "rad/s/s": "rad/s^2", "rad/s2": "rad/s^2", "rad/s²": "rad/s^2", "deg/s2": "deg/s^2", "Nm": "N m",
    "N*m": "N m", "N.m": "N m", "N·m": "N m", "mNm": "mN m", "mN*m": "mN m", "Nmm": "N mm", "Ncm": "N cm",
    "uNm": "uN m", "µNm": "uN m", "gram": "g", "grams": "g", "°C": "degC", "C": "degC", "percent": "%",
    "volt": "V", "volts": "V", "amp": "A", "amps": "A", "ampere": "A", "metre": "m", "meter": "m",
    "metres": "m", "meters": "m", "-": "1", "none": "1", "norm": "1", "hz": "Hz", "kmh": "km/h", "kph": "km/h",
    "knots": "kn", "kt": "kn",
}  # fmt: skip
# What load cells and accelerometers call by the name of a mass, or of nothing.
_INSTEAD = {("N", "g"): "gf", ("N", "kg"): "kgf", ("m/s^2", "g"): "gee"}
# As suffix of a name, "gyro_x_deg_s". A lone N is no unit behind position or velocity: there it is north.
_SUFFIXES = {
    "rad_s2": "rad/s^2", "deg_s2": "deg/s^2", "rad_s": "rad/s", "deg_s": "deg/s", "m_s2": "m/s^2", "m_s": "m/s",
    "radps": "rad/s", "degps": "deg/s", "dps": "deg/s", "deg": "deg", "rad": "rad", "rpm": "rpm", "mps": "m/s",
    "ms": "ms", "us": "us", "ns": "ns", "s": "s", "mm": "mm", "cm": "cm", "m": "m", "mV": "mV", "V": "V",
    "mA": "mA", "A": "A", "mW": "mW", "W": "W", "mN": "mN", "N": "N", "mNm": "mN m", "Nm": "N m", "Nmm": "N mm",
    "Hz": "Hz", "hz": "Hz", "Pa": "Pa", "hPa": "hPa", "K": "K", "degC": "degC", "kg": "kg", "pct": "%",
}  # fmt: skip
_BRACKETS = re.compile(r"^(?P<name>.*\S)\s*[\[(](?P<unit>[^\[\]()]*)[\])]$")
_INDEX = re.compile(r"\d+")


def known_unit(text: str, wanted: str | None = None) -> str:
    """Return a unit as this package writes it, ``""`` for one that it does not know.

    With the unit ``wanted`` that it must lead to, capitals do not matter, ``_`` may stand for ``/``, and what load
    cells give in grams is a force.
    """
    unit = " ".join(text.split())
    if wanted is None:
        unit = _SPELLINGS.get(unit, unit)
        if unit not in _BY_UNIT:
            low = unit.lower()
            unit = _SPELLINGS.get(low, low)
        return unit if unit in _BY_UNIT else ""
    here = _TABLE[_BY_UNIT[wanted][0]]
    found = {known.lower(): known for known in here}
    found |= {spelling.lower(): known for spelling, known in _SPELLINGS.items() if known in here}
    low = unit.lower()
    return found.get(low) or found.get(low.replace("_", "/")) or _INSTEAD.get((wanted, low), "")


def conversion(unit: str, wanted: str | None = None) -> tuple[str, float, float]:
    """Return how values in a unit become another.

    Parameters
    ----------
    unit : str
        As written (``"deg/s"``, ``"°/s"``, ``"dps"``).
    wanted : str, optional
        The unit to reach; default the SI unit of the same dimension.

    Returns
    -------
    reached : str
    factor, offset : float
        ``reached = factor x + offset``.

    Raises
    ------
    InputError
        If the unit is unknown, or of another dimension than the one wanted. A mass in grams becomes a force, as on
        load cells, when newtons are wanted; a lone ``g`` becomes the gravity of the earth when m/s^2 is.
    """
    here = known_unit(unit)
    here = _INSTEAD.get((wanted or "", here), here)
    if not here:
        raise InputError("unit", unit, "is unknown", f"use one of: {', '.join(_BY_UNIT)}")
    si, factor, offset = _BY_UNIT[here]
    if wanted is None or wanted == si:
        return si, factor, offset
    there = known_unit(wanted)
    if not there or _BY_UNIT[there][0] != si:
        others = ", ".join(next((u for s, u in _TABLE.items() if wanted in u or s == wanted), {wanted: 0}))
        raise InputError("unit", unit, f"cannot become {wanted}", f"use one of: {others}")
    _, scale, shift = _BY_UNIT[there]
    return there, factor / scale, (offset - shift) / scale


def factor_of(unit: str, wanted: str | None = None) -> float:
    """Return what one of a unit is in another (default: in SI), ``factor_of("mm")`` is 1e-3; see :func:`conversion`."""
    return conversion(unit, wanted)[1]


def units_of(si: str) -> Mapping[str, float]:
    """Return the units that lead to an SI unit and what one of them is in it, the SI unit first."""
    return {unit: float(factor) for unit, (factor, _) in _TABLE[si].items()}


def split_header(header: str) -> tuple[str, str]:
    """Split a column's header into name and unit.

    ``"roll (deg)"``, ``"T [N]"``, ``"speed_rpm"`` and ``"gyro_x_deg_s"`` carry a unit; ``"position_N"`` does not
    (that is north), nor does ``"q[0]"`` (that is an index). A unit in brackets that this package does not know is
    returned as it stands.
    """
    text = header.strip().strip('"')
    match = _BRACKETS.match(text)
    if match is not None and not _INDEX.fullmatch(match["unit"].strip()):
        unit = match["unit"].strip()
        return match["name"].strip(), known_unit(unit) or unit
    for suffix, unit in _SUFFIXES.items():
        name, found, rest = text.rpartition(f"_{suffix}")
        if not found or rest or not name:
            continue
        if suffix == "N" and re.search(
            r"(pos|position|vel|velocity|wind|acc|acceleration)$", name, re.IGNORECASE
        ):
            continue
        return name, unit
    return text, ""
