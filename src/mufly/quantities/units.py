"""Table of units with their conversion to SI, ``si = factor x + offset``, and parser of units in column headers.

All input files, options and displays take their conversion factors from this table. Inside the package all values are
in SI units and radians.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from functools import cache
from math import pi

from mufly.errors import InputError
from mufly.quantities.sensor_table import READINGS

STANDARD_GRAVITY_M_S2 = 9.80665
"""Standard acceleration of free fall (m/s^2; 3rd CGPM, 1901), the definition of the kilogram-force."""
GRAVITY = 9.81
"""Local acceleration of free fall in the flight model (m/s^2): mid-latitude, as implied by the thesis's hover point.
"""
RPM = pi / 30.0
"""One revolution per minute (rad/s)."""

_GRAVITY, _TWO_PI, _FOOT_M, _INCH_M = STANDARD_GRAVITY_M_S2, 2 * pi, 0.3048, 0.0254
_POUND_KG = 0.45359237  # kg, the international pound (1959)
_OUNCE_KG = _POUND_KG / 16
_MMHG_PA = 133.322387415  # Pa, conventional millimetre of mercury
# SI unit: units that convert to it, with their factors.
_FACTORS_BY_SI: dict[str, dict[str, float]] = {
    "s": {"ms": 1e-3, "us": 1e-6, "ns": 1e-9, "min": 60, "h": 3600, "day": 86_400},
    "rad": {
        "deg": pi / 180,
        "mrad": 1e-3,
        "cdeg": pi / 18000,
        "rev": _TWO_PI,
        "ddeg": pi / 1800,
        "degE7": pi / 180 * 1e-7,
    },
    "rad/s": {
        "rpm": RPM,
        "deg/s": pi / 180,
        "rps": _TWO_PI,
        "Hz": _TWO_PI,
        "krpm": _TWO_PI * 1000 / 60,
        "mrad/s": 1e-3,
        "cdeg/s": pi / 18000,
        "ddeg/s": pi / 1800,
    },
    "1/s": {},
    "rad/s^2": {"deg/s^2": pi / 180},
    "m": {
        "cm": 1e-2,
        "mm": 1e-3,
        "dm": 0.1,
        "km": 1e3,
        "ft": _FOOT_M,
        "in": _INCH_M,
        "um": 1e-6,
        "yd": 3 * _FOOT_M,
        "mi": 5280 * _FOOT_M,
        "nmi": 1852,
    },
    "m2": {"cm2": 1e-4, "mm2": 1e-6, "in2": _INCH_M**2, "ft2": _FOOT_M**2},
    "m3": {"cm3": 1e-6, "mm3": 1e-9, "l": 1e-3, "in3": _INCH_M**3},
    "m/s": {
        "dm/s": 0.1,
        "cm/s": 1e-2,
        "mm/s": 1e-3,
        "km/h": 1 / 3.6,
        "ft/s": _FOOT_M,
        "kn": 1852 / 3600,
        "mph": 5280 * _FOOT_M / 3600,
        "ft/min": _FOOT_M / 60,
        "in/s": _INCH_M,
        "m/min": 1 / 60,
    },
    "m/s^2": {
        "cm/s^2": 1e-2,
        "mm/s^2": 1e-3,
        "gee": _GRAVITY,
        "mgee": _GRAVITY / 1000,
        "ugee": _GRAVITY * 1e-6,
        "ft/s^2": _FOOT_M,
    },
    "V": {"mV": 1e-3, "cV": 1e-2, "uV": 1e-6, "kV": 1e3},
    "A": {"mA": 1e-3, "cA": 1e-2, "uA": 1e-6},
    "rad/s/V": {"rpm/V": RPM},
    "A s": {"A h": 3600, "mA h": 3.6},
    "ohm": {"mohm": 1e-3, "kohm": 1e3, "Mohm": 1e6},
    "H": {"mH": 1e-3, "uH": 1e-6},
    "V s": {"mV s": 1e-3},
    "W": {"mW": 1e-3, "kW": 1e3, "hp": 550 * _FOOT_M * _POUND_KG * _GRAVITY},
    "J": {"mJ": 1e-3, "kJ": 1e3, "W h": 3600, "mW h": 3.6},
    "N": {
        "mN": 1e-3,
        "kN": 1e3,
        "gf": _GRAVITY / 1000,
        "kgf": _GRAVITY,
        "uN": 1e-6,
        "cN": 1e-2,
        "mgf": _GRAVITY * 1e-6,
        "lbf": _POUND_KG * _GRAVITY,
        "ozf": _OUNCE_KG * _GRAVITY,
        "dyn": 1e-5,
    },
    "N m": {
        "mN m": 1e-3,
        "uN m": 1e-6,
        "N mm": 1e-3,
        "N cm": 1e-2,
        "cN m": 1e-2,
        "mN mm": 1e-6,
        "kN m": 1e3,
        "kgf m": _GRAVITY,
        "kgf cm": _GRAVITY * 1e-2,
        "kgf mm": _GRAVITY * 1e-3,
        "gf m": _GRAVITY * 1e-3,
        "gf cm": _GRAVITY * 1e-5,
        "gf mm": _GRAVITY * 1e-6,
        "lbf ft": _POUND_KG * _GRAVITY * _FOOT_M,
        "lbf in": _POUND_KG * _GRAVITY * _INCH_M,
        "ozf in": _OUNCE_KG * _GRAVITY * _INCH_M,
        "ozf ft": _OUNCE_KG * _GRAVITY * _FOOT_M,
        "dyn cm": 1e-7,
    },
    "N m2": {"N cm2": 1e-4, "N mm2": 1e-6},
    "N m/rad": {"mN m/rad": 1e-3, "N m/deg": 180 / pi, "mN m/deg": 0.18 / pi},
    "N m/A": {"mN m/A": 1e-3, "ozf in/A": _OUNCE_KG * _GRAVITY * _INCH_M},
    "N m s": {"mN m s": 1e-3, "uN m s": 1e-6},
    "N s/m": {},
    "N/m": {"N/mm": 1e3},
    "kg": {"g": 1e-3, "mg": 1e-6, "lb": _POUND_KG, "oz": _OUNCE_KG},
    "kg m2": {"g cm2": 1e-7, "g mm2": 1e-9, "kg cm2": 1e-4, "kg mm2": 1e-6},
    "kg/m3": {
        "g/m3": 1e-3,
        "g/cm3": 1e3,
        "g/l": 1,
        "slug/ft3": _POUND_KG * _GRAVITY / _FOOT_M**4,
        "lb/ft3": _POUND_KG / _FOOT_M**3,
    },
    "Pa": {
        "hPa": 100,
        "mbar": 100,
        "kPa": 1e3,
        "bar": 1e5,
        "MPa": 1e6,
        "mPa": 1e-3,
        "psi": _POUND_KG * _GRAVITY / _INCH_M**2,
        "psf": _POUND_KG * _GRAVITY / _FOOT_M**2,
        "inHg": 25.4 * _MMHG_PA,
        "mmHg": _MMHG_PA,
        "torr": 101_325 / 760,
        "atm": 101_325,
        "inH2O": 25.4 * _GRAVITY,
        "mmH2O": _GRAVITY,
    },
    "Pa s": {"uPa s": 1e-6},
    "m2/s": {"mm2/s": 1e-6},
    "K": {"degC": 1, "cdegC": 0.01, "ddegC": 0.1, "degF": 5 / 9, "degR": 5 / 9, "mK": 1e-3},
    "T": {"mT": 1e-3, "uT": 1e-6, "gauss": 1e-4, "mgauss": 1e-7, "nT": 1e-9},
    "T/A": {"uT/A": 1e-6},
    "m/s^2/sqrt(Hz)": {"ugee/sqrt(Hz)": _GRAVITY * 1e-6},
    "rad/s/sqrt(Hz)": {"deg/s/sqrt(Hz)": pi / 180},
    "rad/s/(m/s^2)": {"deg/s/gee": pi / 180 / _GRAVITY},
    "m/s^2/K": {"mgee/K": _GRAVITY * 1e-3},
    "rad/s/K": {"deg/s/K": pi / 180},
    "1": {"%": 1e-2, "d%": 1e-3, "c%": 1e-4, "permille": 1e-3},
}
_OFFSETS_K: dict[str, float] = {"degC": 273.15, "cdegC": 273.15, "ddegC": 273.15, "degF": 273.15 - 32 * 5 / 9}
_UNITS_BY_SI: dict[str, dict[str, tuple[float, float]]] = {
    si: {si: (1, 0)} | {unit: (factor, _OFFSETS_K.get(unit, 0)) for unit, factor in factors.items()}
    for si, factors in _FACTORS_BY_SI.items()
}
_SI_BY_UNIT = {u: (si, float(f), float(o)) for si, units in _UNITS_BY_SI.items() for u, (f, o) in units.items()}
# Spellings of units and their factors; _canonical_unit handles powers, products and "per".
_SPELLINGS_BY_UNIT = {
    "s": "sec secs second seconds", "ms": "msec msecs millis millisec millisecond milliseconds",
    "us": "usec usecs micros microsec microsecond microseconds", "ns": "nsec nsecs nanos nanosecond nanoseconds",
    "min": "mins minute minutes", "h": "hr hrs hour hours", "day": "days",
    "deg": "\u00b0 \u00ba @ degree degrees degs", "rad": "radian radians", "cdeg": "centideg centidegree centidegrees",
    "ddeg": "decideg decidegree decidegrees", "rev": "revs revolution revolutions turn turns",
    "rad/s": "rads radps", "deg/s": "dps degps", "cdeg/s": "cdps",
    "rpm": "RPM Rpm 1/min /min r/min U/min tr/min rot/min rev/min", "rps": "RPS r/s U/s rot/s rev/s",
    "Hz": "hz hertz Hertz",
    "m": "metre meter metres meters", "cm": "centimetre centimeter centimetres centimeters",
    "mm": "millimetre millimeter millimetres millimeters", "km": "kilometre kilometer kilometres kilometers",
    "um": "micron microns", "ft": "foot feet", "in": "inch inches", "yd": "yard yards", "mi": "mile miles",
    "cm3": "cc ccm", "l": "L litre liter litres liters",
    "m/s": "mps", "km/h": "kmh kph", "kn": "knot knots kt kts", "mph": "mi/h", "ft/s": "fps", "ft/min": "fpm",
    "m/s^2": "mps2", "mgee": "mG",
    "V": "volt volts", "mV": "millivolt millivolts", "A": "amp amps ampere amperes", "mA": "milliamp milliamps",
    "A s": "As", "A h": "Ah", "mA h": "mAh", "ohm": "ohms Ohm Ohms \u2126 \u03a9", "mohm": "mOhm m\u2126 m\u03a9",
    "kohm": "kOhm k\u2126 k\u03a9", "V s": "Vs", "W": "watt watts", "kW": "kilowatt kilowatts", "hp": "HP horsepower",
    "J": "joule joules", "W h": "Wh", "mW h": "mWh",
    "N": "newton newtons", "mN": "millinewton millinewtons", "gf": "gramforce pond p", "kgf": "kp kilopond",
    "lbf": "lbsf", "N m": "Nm", "mN m": "mNm", "uN m": "uNm", "N mm": "Nmm", "N cm": "Ncm", "cN m": "cNm",
    "kN m": "kNm", "mN mm": "mNmm", "kgf m": "kgm kgfm", "kgf cm": "kgcm kgfcm", "gf cm": "gcm gfcm", "gf m": "gfm",
    "lbf ft": "ftlb ftlbf ftlbs lbft lbfft", "lbf in": "inlb inlbf inlbs lbin lbfin", "ozf in": "inoz inozf ozin ozfin",
    "ozf ft": "ozft ozfft", "N m s": "Nms", "Pa s": "Pas",
    "kg": "kilogram kilograms kgs", "g": "gram grams gr gm", "mg": "milligram milligrams", "lb": "lbs lbm pound pounds",
    "oz": "ounce ounces", "slug/ft3": "slugs/ft3", "Pa": "pascal pascals", "mbar": "mb millibar millibars",
    "psi": "psia psig lb/in2 lbf/in2", "psf": "lb/ft2 lbf/ft2", "inHg": "inhg", "mmHg": "mmhg", "torr": "Torr",
    "degC": "C \u00b0C \u00baC \u2103 celsius Celsius", "degF": "F \u00b0F \u00baF \u2109 fahrenheit Fahrenheit",
    "degR": "\u00b0R rankine Rankine", "K": "kelvin Kelvin degK \u00b0K", "T": "tesla", "uT": "microtesla",
    "gauss": "Gauss Gs", "mgauss": "mGauss milligauss", "%": "percent pct", "permille": "\u2030",
    "1": "- none norm unitless dimensionless",
}  # fmt: skip
_UNIT_BY_SPELLING = {word: unit for unit, words in _SPELLINGS_BY_UNIT.items() for word in words.split()}
_CHARACTER_REPLACEMENTS = str.maketrans("\u00b5\u03bc\u00b2\u00b3\u00b9\u207b\u00b7\u22c5\u00d7\u2212", "uu231-***-")
_FACTOR_PATTERN = re.compile(r"(?P<name>[^\d^]+?)\^?(?P<power>-?\d+)?")
_PRODUCT_PATTERN = re.compile(r"\s*\*\s*|\.(?=[A-Za-z])|(?<=[A-Za-z])-(?=[A-Za-z])|\s+")
_TEMPERATURE_PATTERN = re.compile(r"^(?:°|deg(?:ree)?s?)[ _-]?([CF]|[Cc]elsius|[Ff]ahrenheit)$")
_FORCE_UNIT_BY_MASS_UNIT = {"kg": "kgf", "g": "gf", "mg": "mgf", "lb": "lbf", "oz": "ozf"}


def _canonical_unit(text: str) -> str:
    """Return a unit of several factors in the notation of the table: ``"m s-2"`` is ``"m/s^2"``."""
    text = _TEMPERATURE_PATTERN.sub(r"\1", text).replace("**", "^").replace(" per ", "/").replace("_per_", "/")
    over: list[str] = []
    under: list[tuple[str, int]] = []
    for k, part in enumerate(text.split("/")):
        for factor in _PRODUCT_PATTERN.split(part.strip(" ()")):
            match = _FACTOR_PATTERN.fullmatch(factor)
            if match is None:
                if factor != "1" or k:
                    return ""
                continue
            name, power = _UNIT_BY_SPELLING.get(match["name"], match["name"]), int(match["power"] or 1)
            power = -power if k else power
            if power < 0:
                same = next((i for i, (n, _) in enumerate(under) if n == name), None)
                if same is None:
                    under.append((name, -power))
                else:
                    under[same] = name, under[same][1] - power
            else:
                over.append(name if power == 1 else f"{name}{power}")
    if len(over) == 2:  # a torque: force first, masses for weights
        over = over if over[1] in _UNITS_BY_SI["m"] else over[::-1]
        over = [_FORCE_UNIT_BY_MASS_UNIT.get(over[0], over[0]), over[1]] if over[1] in _UNITS_BY_SI["m"] else over[::-1]
    below = [n if p == 1 else f"{n}^{p}" if n == "s" else f"{n}{p}" for n, p in under]
    return "/".join([" ".join(over) or "1", *below])


# Units borrowed from other quantities: grams for forces of load cells, g for accelerations, and 1/s for revolutions per
# second.
_BORROWED_UNIT_REPLACEMENTS = {("N", mass): force for mass, force in _FORCE_UNIT_BY_MASS_UNIT.items()} | {
    ("m/s^2", "g"): "gee", ("m/s^2", "mg"): "mgee", ("rad/s", "1/s"): "rps",
}  # fmt: skip


@cache
def normalise_unit(text: str, wanted: str | None = None) -> str:
    """Return a unit in the notation of this package, ``""`` for an unknown unit.

    All usual notations of powers, products and quotients are accepted: ``"m s-2"``, ``"m/s**2"``, ``"in-lbf"``. If the
    target unit ``wanted`` is given, case is ignored, ``_`` may replace ``/``, a mass may mean its weight (load cells),
    and ``1/s`` of a speed means revolutions.
    """
    unit = " ".join(text.translate(_CHARACTER_REPLACEMENTS).split())
    if wanted is None:
        for spelling in (unit, _canonical_unit(unit), unit.lower() if len(unit) > 1 else ""):
            known = _UNIT_BY_SPELLING.get(spelling, spelling)
            if known in _SI_BY_UNIT:
                return known
        return ""
    si = _SI_BY_UNIT[wanted][0]
    for spelling in (unit, unit.lower()):
        for written in (spelling, spelling.replace("_", "/"), spelling.replace("_", " ")):
            known = normalise_unit(written)
            known = _BORROWED_UNIT_REPLACEMENTS.get((si, known), known)
            if known in _UNITS_BY_SI[si]:
                return known
    here = [(spelling.lower(), known) for spelling, known in _UNIT_BY_SPELLING.items() if known in _UNITS_BY_SI[si]]
    here += [(known.lower(), known) for known in _UNITS_BY_SI[si]]
    low = unit.lower()
    spellings = {low, low.replace("_", "/"), _canonical_unit(low), _canonical_unit(low.replace("_", " "))}
    found = {known for spelling, known in here if spelling in spellings}
    return found.pop() if len(found) == 1 else ""


def unit_conversion(unit: str, wanted: str | None = None) -> tuple[str, float, float]:
    """Return the target unit, with the factor and offset of the conversion to it.

    Parameters
    ----------
    unit : str
        Unit as written (``"deg/s"``, ``"°/s"``, ``"dps"``).
    wanted : str, optional
        Target unit; default: the SI unit of the same dimension.

    Returns
    -------
    reached : str
    factor, offset : float
        ``reached = factor x + offset``.

    Raises
    ------
    InputError
        If the unit is unknown, or of another dimension than the target. For the target N a mass in grams converts to
        its weight, as on load cells; for the target m/s^2 ``g`` is the standard gravity.
    """
    there = "" if wanted is None else normalise_unit(wanted)
    goal = _SI_BY_UNIT[there][0] if there else ""
    here = (normalise_unit(unit, goal) if goal else "") or normalise_unit(unit)
    if not here:
        remedy = f"use one of: {', '.join(_UNITS_BY_SI[goal] if goal else _UNITS_BY_SI)}"
        raise InputError("unit", unit, "is unknown", remedy)
    si, factor, offset = _SI_BY_UNIT[here]
    if wanted is None or wanted == si:
        return si, factor, offset
    if goal != si:
        others = ", ".join(_UNITS_BY_SI[goal] if goal else _UNITS_BY_SI)
        raise InputError("unit", unit, f"cannot become {wanted}", f"use one of: {others}")
    _, scale, shift = _SI_BY_UNIT[there]
    return there, factor / scale, (offset - shift) / scale


def find_conversion_factor(unit: str, wanted: str | None = None) -> float:
    """Return the factor from a unit to another (default: SI); ``find_conversion_factor("mm")`` is 1e-3, see
    :func:`unit_conversion`."""
    return unit_conversion(unit, wanted)[1]


def list_compatible_units(si: str) -> Mapping[str, float]:
    """Return the units that convert to an SI unit, with their factors, the SI unit first."""
    return {unit: float(factor) for unit, (factor, _) in _UNITS_BY_SI[si].items()}


# Units in column headers: in brackets, or as a suffix after an underscore.


def _word_set(words: str) -> frozenset[str]:
    return frozenset(words.split())


# Suffixes that are units for every name.
_UNIT_BY_NAME_ENDING = {
    "rad_s2": "rad/s^2", "deg_s2": "deg/s^2", "rad_s": "rad/s", "deg_s": "deg/s", "m_s2": "m/s^2", "m_s": "m/s",
    "cm_s": "cm/s", "mm_s": "mm/s", "km_h": "km/h", "ft_s": "ft/s", "kg_m3": "kg/m3",
}  # fmt: skip
_UNIT_BY_NAME_ENDING |= {end: end for end in _word_set(
    "radps degps dps deg rad mrad rpm RPM rps krpm mps ms us ns usec msec sec secs seconds millis micros mm cm km "
    "ft kmh kph mph knots mV mA mW kW mN gf kgf lbf ozf mNm Nm Nmm Ncm uNm Hz hz Pa hPa kPa mbar psi inHg degC "
    "degF kg pct percent degrees radians meters metres volts amps mAh Ah Wh uT mT gauss mgauss gee mgee ohm mohm"
)}  # fmt: skip
# Suffixes that are units of one quantity only: letter, unit, and words that identify the quantity. For other names the
# letter is an index, an axis or a symbol (RPM_A, gain_K).
_SINGLE_LETTER_UNITS = {
    "s": ("s", "s"), "m": ("m", "m"), "V": ("V", "V"), "A": ("A", "A"), "W": ("W", "W"), "N": ("N", "N"),
    "K": ("K", "K"), "C": ("degC", "K"), "F": ("degF", "K"), "T": ("T", "T"), "J": ("J", "J"), "in": ("in", "span"),
    "G": ("gauss", "T"),
}  # fmt: skip
_QUANTITY_WORDS = {
    "s": _word_set(
        "t time timestamp stamp dt ts duration delay period tau age elapsed latency interval step clock uptime "
        "lag timeout endurance settling rise boot since zeit hold"
    ),
    "m": _word_set(
        "x y z px py pz pos position distance dist range height h alt altitude depth length width radius chord "
        "span arm r d l diameter thickness baro ground agl hgt north east down lidar tof rangefinder "
        "displacement travel offset error err wavelength gap separation spacing clearance terrain gps odom hacc "
        "vacc eph epv accuracy sigma std level elevation track xtrack xte path s ned enu local beam stroke "
        "extension shift relative amsl msl"
    ),
    "V": _word_set(
        "u v voltage volt volts vbat bat batt battery cell cells supply bus esc adc vcc vdd rail signal sensor "
        "raw motor bridge pot strain servo rx main pack source shunt gauge input output ref hall analog torque "
        "thrust force pressure load temp temperature airspeed pitot bt"
    ),
    "A": _word_set(
        "i current curr amp amps draw esc bus bat batt battery motor supply load shunt pack source phase charge"
    ),
    "W": _word_set(
        "p power pow watt watts electrical electric mechanical shaft motor supply battery bat batt esc load input "
        "output heat loss losses"
    ),
    "N": _word_set("t thrust force forces f fx fy fz lift drag load loadcell cell pull push tension weight"),
    "K": _word_set("t temperature temp temps oat ambient air imu"),
    "T": _word_set("b bx by bz field"),
    "J": _word_set("energy work e"),
    "m/s": _word_set(
        "v u w vx vy vz vn ve vd vel velocity speed airspeed groundspeed gspd spd wind climb ias tas gs vs sink"
    ),
    "m/s^2": _word_set(
        "a ax ay az acc accel accels acceleration accx accy accz accelx accely accelz "
        "xacc yacc zacc linacc vibration vibe vib smooth specific axb ayb azb nx ny nz"
    ),
    "kg": _word_set("m mass weight payload auw tow takeoff fuel"),
    "rad": _word_set("roll pitch yaw phi theta psi angle heading hdg attitude tilt course bearing azimuth"),
    "turns": _word_set(
        "rpm rps erpm rotor motor prop propeller fan omega speed spin n w nr rotation revolution revolutions "
        "shaft drehzahl rev revs"
    ),
    "span": _word_set("radius r chord span diameter length width height thickness distance"),
}
for _row in READINGS.values():
    if _row.column_words:
        _QUANTITY_WORDS[_row.unit] |= _word_set(_row.column_words)
# Words of names that are no physical quantity and no revolutions per second.
_DIMENSIONLESS_NAME_WORDS = _word_set(
    "gain kp ki kd kv kt coefficient coeff coef ratio factor count counter number num index idx id flag flags "
    "status mode type c cl cd cm cn ct cq cp k"
)
_NON_ROTATION_WORDS = _word_set(
    "filter cutoff notch sample sampling loop cpu log logging bandwidth update frame video pwm"
)
# Words that determine the dimension, independent of a letter in brackets.
_UNAMBIGUOUS_WORDS = {
    "rpm": "rad/s", "voltage": "V", "current": "A", "temperature": "K", "power": "W", "thrust": "N", "mass": "kg",
    "roll": "rad", "yaw": "rad",
}  # fmt: skip
# Letters of groups of columns: phases A, B, C or U, V, W; north, east, south, west, down.
_SIBLING_COLUMN_LETTERS = ({"A": "B", "C": "B"}, {"V": "U", "W": "U"}, {"N": "ESD", "W": "ES"})
_BRACKETED_UNIT_PATTERN = re.compile(r"^(?P<name>.*\S)\s*[\[(](?P<unit>[^\[\]()]*)[\])]$")
_INDEX_PATTERN = re.compile(r"\d+")
_WORD_PATTERN = re.compile(r"[A-Z]+(?![a-z])|[A-Z]?[a-z]+")


def _split_words(name: str) -> frozenset[str]:
    return frozenset(w.lower() for w in _WORD_PATTERN.findall(name))


def parse_column_unit(name: str, written: str) -> str | None:
    """Return the unit of a column stated in brackets or as metadata.

    The name of the column determines the meaning of a letter: ``g`` differs for an acceleration, a thrust and a mass;
    ``1/s`` and ``Hz`` of a rotational speed are revolutions; ``mG`` of a magnetic field is a milligauss.

    Returns
    -------
    str or None
        Unit in the notation of this package; an unknown unit as written; None if the name leaves the unit ambiguous or
        excludes it.

    Examples
    --------
    >>> [parse_column_unit(name, "g") for name in ("ax", "thrust", "mass", "x")]
    ['gee', 'gf', 'g', None]
    """
    text = " ".join(written.split())
    words = _split_words(name)
    known = "g" if text == "G" else normalise_unit(text)
    force, acceleration = words & _QUANTITY_WORDS["N"], words & _QUANTITY_WORDS["m/s^2"]
    if known in _FORCE_UNIT_BY_MASS_UNIT:
        if text in ("G", "mG") and words & _QUANTITY_WORDS["T"]:
            return "gauss" if text == "G" else "mgauss"
        if acceleration and known in ("g", "mg"):
            return _BORROWED_UNIT_REPLACEMENTS["m/s^2", known]
        if force and not words & (_QUANTITY_WORDS["kg"] - {"m"}):
            return _FORCE_UNIT_BY_MASS_UNIT[known]
        return None if known in ("g", "mg") and not words & _QUANTITY_WORDS["kg"] else known
    if text == "mG" and words & _QUANTITY_WORDS["T"]:
        return "mgauss"
    if known in ("1/s", "Hz"):
        turns = words & _QUANTITY_WORDS["turns"] and not words & (_NON_ROTATION_WORDS | _DIMENSIONLESS_NAME_WORDS)
        return "rps" if turns else known
    if text in ("rads", "degs"):
        return text[:3] + ("" if words & _QUANTITY_WORDS["rad"] else "/s")
    if not known and text in ("S", "M") and words & _QUANTITY_WORDS[text.lower()]:
        return text.lower()
    if text in _SINGLE_LETTER_UNITS and text != "V" and known:
        certain = {_UNAMBIGUOUS_WORDS[w] for w in words if w in _UNAMBIGUOUS_WORDS}
        if certain and _SI_BY_UNIT[known][0] not in certain:
            return None
    return known or text


def split_unit_suffix(name: str) -> tuple[str, str]:
    """Split a name of this package with a unit as suffix: ``"arm_m"`` is an arm in m.

    :func:`split_header` splits headers of other programs.
    """
    for end, unit in (_UNIT_BY_NAME_ENDING | {letter: letter for letter in "smVAWNK"}).items():
        if name.endswith(f"_{end}") and len(name) > len(end) + 1:
            return name[: -len(end) - 1], normalise_unit(unit)
    return name, ""


def split_header(header: str) -> tuple[str, str]:
    """Split a column's header into name and unit.

    ``"roll (deg)"``, ``"T [N]"``, ``"speed_rpm"`` and ``"gyro_x_deg_s"`` carry a unit. A single letter is a unit if the
    name identifies the quantity: ``"U_V"``, ``"thrust_N"``, ``"ax_g"``; ``"position_N"`` (north), ``"RPM_A"``,
    ``"gain_K"`` and ``"q[0]"`` (an index) have none. An unknown unit in brackets is returned as written.
    """
    (split,), _ = split_headers([header])
    return split


def split_headers(headers: Sequence[str]) -> tuple[list[tuple[str, str]], list[str]]:
    """Split the headers of a table into names and units; see :func:`split_header`.

    Returns
    -------
    split : list of (name, unit)
    doubtful : list of str
        Headers with a suffix that is no unit of their quantity; they are returned as names.
    """
    texts = [h.strip().strip('"') for h in headers]
    ends: dict[str, set[str]] = {}
    for text in texts:
        stem, _, end = text.rpartition("_")
        if len(end) == 1:
            ends.setdefault(stem, set()).add(end)
    split: list[tuple[str, str]] = []
    doubtful: list[str] = []
    for text in texts:
        name, unit = _split_column_header(text, ends)
        if unit is None:
            doubtful.append(text)
        split.append((name, unit or ""))
    return split, doubtful


def _split_column_header(text: str, ends: Mapping[str, set[str]]) -> tuple[str, str | None]:
    match = _BRACKETED_UNIT_PATTERN.match(text)
    if match is not None and not _INDEX_PATTERN.fullmatch(match["unit"].strip()):
        unit = parse_column_unit(match["name"], match["unit"])
        return (text, None) if unit is None else (match["name"].strip(), unit)
    for end, unit in _UNIT_BY_NAME_ENDING.items():
        name, found, rest = text.rpartition(f"_{end}")
        if found and name and not rest:
            if end == "ms" and _split_words(name) & _QUANTITY_WORDS["m/s"]:
                return name, "m/s"
            settled = parse_column_unit(name, unit)
            return (text, None) if settled is None else (name, settled)
    name, found, letter = text.rpartition("_")
    words = _split_words(name)
    if not found or not name or (letter not in _SINGLE_LETTER_UNITS and letter != "g"):
        return text, ""
    if letter == "g":
        settled = parse_column_unit(name, "g") if not words & _DIMENSIONLESS_NAME_WORDS else None
        return (text, None) if settled is None else (name, settled)
    unit, kind = _SINGLE_LETTER_UNITS[letter]
    if letter == "N" and words & (_QUANTITY_WORDS["m"] | _QUANTITY_WORDS["m/s"] | _QUANTITY_WORDS["m/s^2"]) - {
        "h",
        "d",
    }:
        return text, ""  # north
    if letter == "G" and words & _QUANTITY_WORDS["m/s^2"]:
        return name, "gee"
    beside = ends.get(name, set())
    row = any(letter in row and beside & set(row[letter]) for row in _SIBLING_COLUMN_LETTERS)
    fits = words & _QUANTITY_WORDS[kind] and not words & _DIMENSIONLESS_NAME_WORDS and not row
    if fits and _words_allow_unit(words, unit):
        return name, unit
    return text, "" if letter == "in" else None


def _words_allow_unit(words: frozenset[str], unit: str) -> bool:
    certain = {_UNAMBIGUOUS_WORDS[w] for w in words if w in _UNAMBIGUOUS_WORDS}
    return (unit == "V" and "rad/s" not in certain) or not certain or _SI_BY_UNIT[unit][0] in certain
