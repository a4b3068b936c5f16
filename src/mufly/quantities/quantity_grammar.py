"""Grammar of numbers with units on the command line and in configuration files.

A quantity is a number and a unit of its dimension: ``6000rpm``, ``100 Hz``, ``1.2kg/m3``. If an option has a unit for
bare numbers, ``6000`` has that unit. A list has commas (``5000,6000rpm``), a range is ``FIRST:LAST:STEP``
(``10:30:5mm``), and a unit at the end also applies to the bare numbers before it. A standard deviation follows ``+-``
(``0.06+-0.0002``). Units are those of :mod:`mufly.quantities.units`.

A list of names is ``p,q``, one of names with texts ``lat=inr0,lon`` (:func:`parse_named_texts`). A line of a column map
is ``NAME=COLUMN(unit)``: a signal name, and the column of a file with its values (:func:`parse_column_map_lines`).
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from typing import NamedTuple

from mufly.errors import ArgumentError, InputError
from mufly.quantities.units import list_compatible_units, normalise_unit, unit_conversion

NUMBER_PATTERN = r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?"
MAX_OPTION_VALUES = 100_000
"""Greatest number of values in a list or range of an option."""

# Units of autopilots' messages, not offered to users.
_UNLISTED_UNITS = (
    "1", "d%", "c%", "cdeg", "ddeg", "degE7", "cdeg/s", "ddeg/s", "mrad", "mrad/s", "cV", "cA", "us", "ns", "um",
)  # fmt: skip
_MAX_SHOWN_UNITS = 8  # greatest number of units in a message
_QUANTITY_PATTERN = re.compile(
    rf"({NUMBER_PATTERN}|[-+]?(?:nan|inf|infinity)(?![a-z]))\s*(.*)", re.IGNORECASE | re.DOTALL
)
_DECIMAL_COMMA_PATTERN = re.compile(r"[-+]?\d*,\d+\s*[^\d\s,:]*")

_COLUMN_PATTERN = re.compile(
    r"(?P<sign>-?)(?:(?P<topic>[^/\[(]+)/)?(?P<columns>.+?)\s*"
    r"(?:[\[(](?P<unit>[^\[\]()]*[^\d\[\]()][^\[\]()]*)[\])])?"
)


class WrittenNumber(NamedTuple):
    """Number as written: value and unit, ``""`` without unit."""

    value: float
    unit: str


class ValueWithStd(NamedTuple):
    """Value with standard deviation in the same unit."""

    value: float
    std: float


class ColumnMapEntry(NamedTuple):
    """Entry of a column map: signal, its columns in a file, their signs and their unit.

    Attributes
    ----------
    name : str
        Signal name, known or user-defined.
    columns : tuple of str
        Columns of the file, one for each component of the signal.
    signs : tuple of float
        Sign of each column, 1 or -1.
    topic : str
        Topic of a log, or name of a file, with the columns; ``""`` if not stated.
    unit : str
        Unit of the columns; ``""`` if not stated.
    """

    name: str
    columns: tuple[str, ...]
    signs: tuple[float, ...]
    topic: str
    unit: str


def parse_column_map_lines(lines: Sequence[str] | Mapping[str, str]) -> list[ColumnMapEntry]:
    """Return the lines of a column map, written ``NAME=COLUMN(unit)``, or ``{"NAME": "COLUMN(unit)"}``.

    The unit is optional and may be in square brackets. ``-`` before a column changes its sign. A topic or a file and a
    slash may precede the first column. Columns of several components are separated by commas.

    Raises
    ------
    ArgumentError
        If a line names no column.

    Examples
    --------
    >>> parse_column_map_lines(["measured_acceleration=imu/ax,ay,-az(gee)"])[0][1:]
    (('ax', 'ay', 'az'), (1.0, 1.0, -1.0), 'imu', 'gee')
    """
    pairs = lines.items() if isinstance(lines, Mapping) else [line.partition("=")[::2] for line in lines]
    found = []
    for name, text in pairs:
        match = _COLUMN_PATTERN.fullmatch(str(text).strip())
        if match is None or not name.strip():
            remedy = "write NAME=COLUMN(unit), measured_rates.p=gyro_x(deg/s)"
            raise ArgumentError("columns", name, "does not say which column", remedy)
        columns = [c.strip() for c in (match["sign"] + match["columns"]).split(",")]
        signs = tuple(-1.0 if c.startswith("-") else 1.0 for c in columns)
        names = tuple(c.removeprefix("-") for c in columns)
        found.append(ColumnMapEntry(name.strip(), names, signs, match["topic"] or "", match["unit"] or ""))
    return found


def parse_names(text: str) -> tuple[str, ...]:
    """Return the names of a list such as ``"p,q"``, without blanks and empty entries."""
    return tuple(name for part in text.split(",") if (name := part.strip()))


def parse_named_texts(text: str) -> dict[str, str]:
    """Return the entries of a list such as ``"lat=inr0,lon"``; a name without ``=`` or text stands for itself.

    Examples
    --------
    >>> parse_named_texts("lat=-inr0, p")
    {'lat': '-inr0', 'p': 'p'}
    """
    pairs = (part.partition("=")[::2] for part in parse_names(text))
    return {name.strip(): of.strip() or name.strip() for name, of in pairs if name.strip()}


def parse_quantity(where: str, text: str, unit: str, *, bare: bool = True) -> float:
    """Return one number in a unit from a text such as ``"6000rpm"``.

    Parameters
    ----------
    where : str
        Subject of errors, such as the option.
    text : str
    unit : str
        Unit of the result and, with ``bare``, of a number without unit; ``""`` for a dimensionless number.
    bare : bool
        True if the unit is optional.

    Raises
    ------
    InputError
        If the text is no finite number, or its unit is unknown or of another dimension.

    Examples
    --------
    >>> parse_quantity("--mass", "0.12kg", "g")
    120.0
    """
    if _DECIMAL_COMMA_PATTERN.fullmatch(text.strip()):
        raise InputError(where, "", f"{text!r} has a decimal comma", f"write {text.strip().replace(',', '.')}")
    return _convert_to_unit(where, _split_number_and_unit(where, text, unit), unit, text, bare)


def parse_integer(where: str, text: str) -> int:
    """Return an integer; raise InputError if the text is none."""
    try:
        return int(text)
    except ValueError:
        pass
    value = _split_number_and_unit(where, text, "")
    if value.unit or not value.value.is_integer():
        raise InputError(where, "", f"{text!r} is not a whole number", "give a whole number, without a unit")
    return int(value.value)


def parse_values(
    where: str, text: str, unit: str, *, bare: bool = True, most: int = MAX_OPTION_VALUES
) -> tuple[float, ...]:
    """Return the numbers of a list or range, ``"5000,6000"`` or ``"3000:7000:500rpm"``, in a unit.

    The last value of a range is included if the steps reach it; the default step is one unit.

    Raises
    ------
    InputError
        As for :func:`parse_quantity`, or if a range has no value or the text more than ``most``.
    """
    parts = [part.split(":") for part in text.split(",")]
    numbers = iter(
        _inherit_following_unit([_split_number_and_unit(where, n, unit, text) for part in parts for n in part])
    )
    out: list[float] = []
    for part in parts:
        written = [next(numbers) for _ in part]
        if len(written) > 3:
            raise InputError(where, "", f"{':'.join(part)!r} is not a range", "write FIRST:LAST:STEP")
        out += _expand_range(where, written, unit, text, bare, most)
        if len(out) > most:
            raise InputError(where, "", f"{len(out)} values in {text!r}", f"give {most} values at most")
    return tuple(out)


def parse_rotor_pair_values(where: str, text: str, unit: str) -> tuple[float, ...]:
    """Return the numbers of upper and lower rotor from ``"14,12"``, or one number for both from ``"14"``."""
    values = parse_number_list(where, text, unit)
    if len(values) > 2:
        raise InputError(where, "", f"{text!r} is neither one value nor two", "write one, or UPPER,LOWER as 14,12")
    return values


def parse_number_list(where: str, text: str, unit: str) -> tuple[float, ...]:
    """Return the numbers of a comma-separated list without ranges."""
    return tuple(
        _convert_to_unit(where, one, unit, text, bare=True)
        for one in _inherit_following_unit(
            [_split_number_and_unit(where, part, unit, text) for part in text.split(",")]
        )
    )


def parse_vector(where: str, text: str, unit: str) -> tuple[float, ...]:
    """Return the three components of a vector such as ``"0.5,0,0"``, or the vector's magnitude given as one number."""
    values = parse_number_list(where, text, unit)
    if len(values) not in (1, 3):
        raise InputError(
            where, "", f"{text!r} holds {len(values)} numbers",
            f"give one ({unit}), or N,E,D as 0.5,0,0; a decimal mark is a point",
        )  # fmt: skip
    return values


def parse_stepped_range(where: str, text: str, unit: str) -> tuple[float, float | None, float | None]:
    """Return first, last and step of ``"2500:6000"`` or ``"-1:3:0.5m/s"``; missing last and step are None."""
    parts = text.split(":")
    if len(parts) > 3:
        raise InputError(where, "", f"{text!r} is not a range", "write FIRST:LAST or FIRST:LAST:STEP")
    written = _inherit_following_unit([_split_number_and_unit(where, part, unit, text) for part in parts])
    first, *rest = (_convert_to_unit(where, one, unit, text, bare=True) for one in written)
    last, step = (*rest, None, None)[:2]
    if (last is not None and last <= first) or (
        step is not None and last is not None and not 0 < step <= (last - first) * (1 + 1e-9)
    ):
        raise InputError(where, "", f"{text!r} contains no two values", "let it rise, by a step no longer than that")
    return first, last, step


def parse_range(where: str, text: str, unit: str, count: int) -> list[float]:
    """Return the values of a range such as ``"2500:6000:500"``, or of one number.

    A range without a step has ``count`` equally spaced values; a ``count`` of 1 means its middle.
    """
    first, last, step = parse_stepped_range(where, text, unit)
    if last is None:
        return [first]
    if step is not None:
        return make_spaced_values(first, last, step)
    if count == 1:
        return [0.5 * (first + last)]
    return [round(first + k * (last - first) / (count - 1), 12) for k in range(count)]


def parse_interval(where: str, text: str, unit: str) -> tuple[float, float]:
    """Return the ends of an interval such as ``"0.1:3"``, the lower first."""
    first, last, step = parse_stepped_range(where, text, unit)
    if last is None or step is not None:
        raise InputError(where, "", f"{text!r} is not a frequency band", f"write LOW:HIGH ({unit}), as 0.1:3")
    return first, last


def parse_value_with_std(where: str, text: str, unit: str) -> ValueWithStd:
    """Return value and standard deviation of ``"0.84"``, ``"0.84+-0.02"`` or ``"0.84+-2%"``."""
    first, sign, second = text.replace("±", "+-").partition("+-")
    value = _split_number_and_unit(where, first, unit, text)
    if not sign:
        return ValueWithStd(_convert_to_unit(where, value, unit, text, bare=True), 0.0)
    std = _split_number_and_unit(where, second, unit, text)
    relative = std.unit == "%" and _find_si_unit(unit) != "1"
    value = value if relative else _inherit_following_unit([value, std])[0]
    mean = _convert_to_unit(where, value, unit, text, bare=True)
    width = abs(mean) * std.value / 100.0 if relative else _convert_to_unit(where, std, unit, text, bare=True)
    if width < 0.0:
        raise InputError(where, "", f"{text!r} has a negative standard deviation", "give 0 or more behind +-")
    return ValueWithStd(mean, width)


def parse_time_span(where: str, text: str) -> tuple[float, float]:
    """Return begin and end (s) of a time span such as ``"15s+2s"``, start and duration; either may be omitted."""
    start, sign, duration = text.partition("+")
    begin = parse_quantity(where, start, "s") if start.strip() else 0.0
    end = begin + parse_quantity(where, duration, "s") if sign else math.inf
    if not 0.0 <= begin < end:
        raise InputError(
            where, "", f"{text!r} is not a time span", "give a start of 0 or more and a duration above 0, as 15s+2s"
        )
    return begin, end


def list_help_text_units(unit: str) -> tuple[str, ...]:
    """Return the units that help texts list for a quantity; the first applies to numbers without a unit."""
    known = [u for u in list_compatible_units(_find_si_unit(unit)) if u not in _UNLISTED_UNITS and u != unit]
    return (*([] if unit == "1" else [unit]), *known)


def make_spaced_values(first: float, last: float, step: float) -> list[float]:
    """Return first, first + step, ... up to last, which is included if the steps reach it."""
    count = math.floor((last - first) / step + 1e-9) + 1
    return [round(first + k * step, 12) for k in range(count)]


# ----------------------------------------------------------------------------


def _split_number_and_unit(where: str, part: str, unit: str, whole: str = "") -> WrittenNumber:
    """Split a text into number and unit; ``whole`` is the list that contains it."""
    text = part.strip().replace("\u2212", "-")
    shown = repr(whole or part)
    if not text:
        problem = "is empty" if not (whole or part).strip() else f"{shown} lacks a number"
        raise InputError(where, "", problem, f"give {_describe_wanted(unit)}")
    match = _QUANTITY_PATTERN.fullmatch(text)
    if match is None or match[2][:1] in tuple(".,+-") or re.match(r"\d(?!/)", match[2]):
        raise InputError(where, "", f"{part.strip()!r} is not a number", f"give {_describe_wanted(unit)}")
    value = float(match[1])
    if not math.isfinite(value):
        raise InputError(where, "", f"{part.strip()!r} is not finite", f"give {_describe_wanted(unit)}")
    return WrittenNumber(value, match[2].strip())


def _inherit_following_unit(numbers: Sequence[WrittenNumber]) -> list[WrittenNumber]:
    """Give bare numbers the unit of the next one that has a unit."""
    out: list[WrittenNumber] = []
    unit = ""
    for one in reversed(numbers):
        unit = one.unit or unit
        out.append(WrittenNumber(one.value, unit))
    return out[::-1]


def _expand_range(
    where: str, written: Sequence[WrittenNumber], unit: str, text: str, bare: bool, most: int
) -> list[float]:
    """Return the values, in ``unit``, of one part of a list: a number, or a range with equal steps in its own unit."""
    if len(written) == 1:
        return [_convert_to_unit(where, written[0], unit, text, bare)]
    here = written[-1].unit
    if any(one.unit != here for one in written):
        here = unit
        written = [WrittenNumber(_convert_to_unit(where, one, unit, text, bare), unit) for one in written]
    first, last, step = (*(one.value for one in written), 1.0)[:3]
    if step <= 0 or last < first:
        raise InputError(where, "", f"{first:g}:{last:g}:{step:g} contains no value", "let it rise by a step above 0")
    count = (last - first) / step + 1
    if count > most:
        problem, remedy = f"{text!r} holds {count:.0f} values", f"take larger steps ({most} values at most)"
        raise InputError(where, "", problem, remedy)
    return [
        _convert_to_unit(where, WrittenNumber(v, here), unit, text, bare) for v in make_spaced_values(first, last, step)
    ]


def _convert_to_unit(where: str, one: WrittenNumber, unit: str, text: str, bare: bool) -> float:
    if not one.unit:
        if not bare and _find_si_unit(unit) != "1":
            raise InputError(where, "", f"{text!r} has no unit", f"use one of: {_format_offered_units(unit)}")
        return one.value
    if not unit:
        raise InputError(where, "", f"{text!r} has a unit, {one.unit!r}", "give the number alone, it takes none")
    found = _match_unit(one.unit, unit)
    if not found:
        other = normalise_unit(one.unit)
        problem = f"unit {one.unit!r} in {text!r} is unknown"
        if other and not _is_convertible(other, unit):
            problem = f"{text!r} is in {other}, which cannot become {unit if unit != '1' else 'a plain number'}"
        raise InputError(where, "", problem, f"use one of: {_format_offered_units(unit)}")
    _, factor, offset = unit_conversion(found, unit)
    return factor * one.value + offset


def _match_unit(text: str, wanted: str) -> str:
    """Return the unit that a text means, of the dimension of ``wanted``; case matters only for mega and milli."""
    here = normalise_unit(text)
    found = here if here and _is_convertible(here, wanted) else normalise_unit(text, wanted)
    mega = text[:1] == "M" and found[:1] == "m" and text[1:].lower() == found[1:].lower() != ""
    return "" if mega else found


def _is_convertible(unit: str, wanted: str) -> bool:
    try:
        unit_conversion(unit, wanted)
    except InputError:
        return False
    return True


def _find_si_unit(unit: str) -> str:
    return unit_conversion(unit)[0] if unit else "1"


def _format_offered_units(unit: str) -> str:
    shown = list_help_text_units(unit)
    return ", ".join(shown[:_MAX_SHOWN_UNITS]) + (" and others" if len(shown) > _MAX_SHOWN_UNITS else "")


def _describe_wanted(unit: str) -> str:
    """Return a text that names the expected input, for error messages."""
    if not unit:
        return "a number"
    if unit == "1":
        return "a number, or a percentage as 50%"
    return f"a number, bare in {unit} or with a unit: {_format_offered_units(unit)}"
