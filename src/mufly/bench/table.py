"""A bench file read: columns in SI units under one set of names, with what was guessed on the way.

A text with a header, its columns set apart by comma, semicolon, tab or blanks (without commas, decimal commas will
do); lines that begin with ``#`` are skipped. A header is a name and a unit, in brackets or after the last
underscore: ``current_A``, ``Current [mA]``, ``Q(Nm)``. The name may carry the rotor (``upper`` or ``lower``), and
``raw`` for the reading of a sensor that is still to be calibrated: ``thrust_upper_N``, ``torque_raw_V``. Capitals do
not matter. Other headers are passed over
(docs/bench.md).
"""

from __future__ import annotations

import math
import re
import warnings
from collections.abc import Iterable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mufly.errors import ArgumentError, InputError
from mufly.results import result
from mufly.tables import text_columns
from mufly.units import conversion, known_unit

Array = NDArray[np.float64]


class CutShort(UserWarning):
    """A file's last line ends before its last cell."""


_CONSTANT = 1e-3  # spread over size below which a channel counts as constant


@result(eq=False)
class BenchTable:
    """Readings of a bench.

    Attributes
    ----------
    source : str
        Name of the file.
    columns : dict of str to (n,) array
        SI values by name (:class:`mufly.bench.table.Column`); NaN where a cell is empty. ``run`` is a number from 0.
    headers : dict of str to str
        The header of each, as written.
    line : (n,) array of int
        Lines of the file.
    unitless : tuple of str
        Columns whose unit the file does not say; taken as SI until :meth:`rescaled` says otherwise.
    notes : tuple of str
        What was passed over or guessed, in words.
    """

    source: str
    columns: dict[str, Array]
    headers: dict[str, str]
    line: NDArray[np.int64]
    unitless: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()

    def __len__(self) -> int:
        return int(self.line.size)

    def __contains__(self, name: str) -> bool:
        return name in self.columns

    def __getitem__(self, name: str) -> Array:
        return self.columns[name]

    def fault(self, key: str, problem: str, remedy: str) -> InputError:
        """Return the error about a column, called by its header, or about the file (key "")."""
        return InputError(self.source, self.headers.get(key, key), problem, remedy)

    def require(self, names: Iterable[str], *, remedy: str = "") -> None:
        """Check that columns are there and filled in every line.

        Raises
        ------
        InputError
            Naming the first that is not.
        """
        for name in names:
            if name not in self.columns:
                known = f"known here: {', '.join(self.headers.values())}; map others with columns=OLD=NEW"
                raise InputError(self.source, name, "is not among the columns", remedy or known)
            empty = np.flatnonzero(~np.isfinite(self.columns[name]))
            if empty.size:
                cell = f"line {self.line[empty[0]]}, {self.headers[name]}"
                raise self.fault(cell, "is empty", "fill it in, or leave the line out")

    def constant(self, name: str) -> bool:
        """Return whether a column hardly varies (by less than a thousandth of its size)."""
        v = self.columns[name]
        size = float(np.max(np.abs(v)))
        return size == 0.0 or float(np.ptp(v)) <= _CONSTANT * size

    def rescaled(self, name: str, factor: float, note: str) -> BenchTable:
        """Return the table with one column multiplied, and a note that says why."""
        columns = {**self.columns, name: self.columns[name] * factor}
        left = tuple(u for u in self.unitless if u != name)
        return replace(self, columns=columns, unitless=left, notes=(*self.notes, note))

    def where(self, keep: NDArray[np.bool_]) -> BenchTable:
        """Return the lines that ``keep`` (n,) selects."""
        return self.ordered(np.flatnonzero(keep))

    def ordered(self, index: NDArray[np.intp]) -> BenchTable:
        """Return the lines with these positions, in their order."""
        return replace(self, columns={k: v[index] for k, v in self.columns.items()}, line=self.line[index])


def read_bench(path: str | Path, *, columns: str | None = None) -> BenchTable:
    """Read a bench file.

    Parameters
    ----------
    path : str or Path
    columns : str, optional
        Map of headers, ``"T_A(N)=thrust_lower_N,RPM=speed_lower_rpm"``.

    Raises
    ------
    InputError
        If the file cannot be read, has no column that is understood, or a cell of a column in use is no number.
    """
    where = Path(path).name
    written, numbered = text_columns(path)
    if not numbered:
        raise InputError(where, "", "holds no measurements", "give a header and at least one line")
    chosen, notes = _choose(renamed(written, columns, where), written)
    if not chosen:
        raise InputError(
            where, "", f"no column is understood ({', '.join(written)})", "name quantity and unit, as torque_mNm, or "
            "map them with columns=OLD=NEW"
        )  # fmt: skip
    if len(numbered) > 1 and len(numbered[-1][1]) < min(len(written), *(len(c) for _, c in numbered[:-1])):
        # Its last number may have lost digits, which nobody can see.
        cut = f"line {numbered[-1][0]}, the last, is cut short and left out"
        warnings.warn(f"{where}: {cut}", CutShort, stacklevel=2)
        notes, numbered = [*notes, cut], numbered[:-1]
    rows = [cells for _, cells in numbered]
    line = np.array([i for i, _ in numbered], dtype=np.int64)
    data: dict[str, Array] = {}
    for index, column in chosen:
        cells = [row[index] if index < len(row) else "" for row in rows]
        if column.quantity == "run":
            data[column.name] = _labels(cells)
            continue
        values = [_number(where, int(n), written[index], c) for n, c in zip(line, cells, strict=True)]
        data[column.name] = np.array(values) * column.factor + column.offset
    unitless = tuple(c.name for _, c in chosen if c.unit == "" and not c.name.endswith("_raw"))
    notes += [
        f"{written[i]}: no unit is written, taken as {SI_UNITS[c.quantity]}"
        for i, c in chosen
        if c.name in unitless and c.quantity != "speed"
    ]
    return BenchTable(where, data, {c.name: written[i] for i, c in chosen}, line, unitless, tuple(notes))


def header_of(path: str | Path) -> list[str]:
    """Return the headers of a bench file as written.

    Raises
    ------
    InputError
        If the file cannot be read.
    """
    return text_columns(path)[0]


def _choose(headers: list[str], written: list[str]) -> tuple[list[tuple[int, Column]], list[str]]:
    """Return the columns in use (position, meaning), one for each name, and notes on the others."""
    found: dict[str, tuple[int, Column]] = {}
    notes: list[str] = []
    unused: list[str] = []
    for i, header in enumerate(headers):
        column = parse_header(header)
        if column is None:
            unused.append(written[i])
        elif column.name not in found:
            found[column.name] = (i, column)
        else:
            # The same quantity twice (RPM and omega, gf and N): the SI one is more finely written as a rule.
            first = found[column.name]
            better = (i, column) if first[1].factor != 1.0 and column.factor == 1.0 and column.unit else first
            other = first[0] if better[0] == i else i
            found[column.name] = better
            notes.append(f"{column.name} is read from {written[better[0]]!r}, not from {written[other]!r}")
    if unused:
        notes.append(f"columns that are not used: {', '.join(unused)}")
    return list(found.values()), notes


def _labels(cells: list[str]) -> Array:
    known: dict[str, float] = {}
    return np.array([known.setdefault(c, float(len(known))) for c in cells])


def _number(where: str, line: int, header: str, cell: str) -> float:
    if not cell:
        return math.nan
    try:
        value = float(cell)
    except ValueError:
        raise InputError(where, f"line {line}, {header}", f"{cell!r} is not a number", "give one") from None
    if not math.isfinite(value):
        raise InputError(
            where, f"line {line}, {header}", f"is {value:g}", "give a finite number or leave it empty"
        )
    return value


_NAMES = {
    # quantity: its unit here, and its names
    "voltage": ("V", "voltage u v volts supply_voltage motor_voltage"),
    "duty": ("1", "duty pwm throttle motor_input"),
    "current": ("A", "current i motor_current amps"),
    "supply_current": ("A", "supply_current battery_current"),
    "speed": (
        "rad/s",
        "speed rpm omega rotor_speed motor_speed w motor_electrical_speed motor_optical_speed",
    ),
    "torque": ("N m", "torque q moment load q_meas"),
    "thrust": ("N", "thrust t force lift t_meas"),
    "power": ("W", "power p"),
    "pitch": ("rad", "pitch blade_pitch"),
    "thrust_coefficient": ("1", "ct"),
    "power_coefficient": ("1", "cp"),
    "advance_ratio": ("1", "j advance_ratio"),
    "airspeed": ("m/s", "airspeed climb tunnel_speed"),
    "time": ("s", "time t_s seconds"),
    "run": ("1", "run series test repeat"),
    "density": ("kg/m3", "density rho air_density"),
    "temperature": ("degC", "temperature temp"),
    "pressure": ("Pa", "pressure"),
    "humidity": ("1", "humidity relative_humidity rh"),
}
SI_UNITS = {quantity: unit for quantity, (unit, _) in _NAMES.items()}

_SIDES = {"upper": "upper up top", "lower": "lower dw low down bottom"}
_BRACKETS = re.compile(r"^(.*?)\s*[\(\[]\s*([^\)\]]*?)\s*[\)\]]$")
_NEEDS_NO_UNIT = ("duty", "run", "thrust_coefficient", "power_coefficient", "advance_ratio", "humidity")
_OWN_UNIT = {"rpm": "rpm", "omega": "rad/s"}


@dataclass(frozen=True)
class Column:
    """What a header means.

    Attributes
    ----------
    name : str
        Quantity, with ``_upper`` or ``_lower`` and ``_raw`` where the header says so: ``"torque_lower_raw"``.
    factor, offset : float
        SI value = factor * written value + offset.
    unit : str
        As written, ``""`` if the header has none.
    """

    name: str
    factor: float
    unit: str
    offset: float = 0.0

    @property
    def quantity(self) -> str:
        """The quantity without rotor and ``_raw``."""
        return re.sub(r"(_upper|_lower)?(_raw)?$", "", self.name)


def parse_header(header: str) -> Column | None:
    """Return what one header means, None if it is no quantity of a bench.

    Examples: ``"torque_mNm"``, ``"T(N)"``, ``"RPM"``, ``"speed_upper_rpm"``, ``"thrust_raw_mV"``.
    """
    text = " ".join(header.strip().lower().split())
    match = _BRACKETS.match(text)
    whole = match[1] if match else text
    candidates = [(whole, match[2])] if match else [(whole, "")]
    if not match:
        parts = whole.split("_")
        # The unit may hold an underscore itself (rad_s), so one and two last parts are tried, longest first.
        candidates = [
            ("_".join(parts[:-k]), "_".join(parts[-k:])) for k in (2, 1) if len(parts) > k
        ] + candidates
    for name, unit in candidates:
        found = _named(name, unit)
        if found is not None:
            return found
    return None


def _named(name: str, unit: str) -> Column | None:
    words = [w for w in re.split(r"[_\s]+", name) if w]
    raw = "raw" in words
    sides = {word: side for side, known in _SIDES.items() for word in known.split()}
    side = next((sides[w] for w in words if w in sides), "")
    stem = "_".join(w for w in words if w != "raw" and w not in sides)
    for quantity, (si, names) in _NAMES.items():
        if stem not in names.split():
            continue
        full = quantity + (f"_{side}" if side else "") + ("_raw" if raw else "")
        if raw:
            return Column(full, 1.0, unit)
        if unit == "" and (stem in _OWN_UNIT or quantity in _NEEDS_NO_UNIT):
            unit = _OWN_UNIT.get(stem, "1")
        if unit == "":
            return Column(full, 1.0, "")
        known = known_unit(unit, si)
        if known:
            _, factor, offset = conversion(known, si)
            return Column(full, factor, unit, offset)
    return None


def renamed(headers: list[str], columns: str | None, where: str) -> list[str]:
    """Apply a user's map ``"T_A(N)=thrust_lower_N,RPM=speed_lower_rpm"`` to headers.

    Raises
    ------
    InputError
        If the map names a column that is not there, is no map, or its right side is no known quantity.
    """
    result = list(headers)
    for part in (columns or "").split(","):
        if not part.strip():
            continue
        old, equals, new = (t.strip() for t in part.partition("="))
        if not equals or not old or not new:
            raise ArgumentError(
                "columns", part.strip(), "is no OLD=NEW", "write columns='RPM=speed_upper_rpm'"
            )
        if old not in headers:
            raise InputError(where, old, "is not among the columns", f"the header is {', '.join(headers)}")
        if parse_header(new) is None:
            raise ArgumentError(
                "columns",
                new,
                "is no quantity with a unit",
                f"use one of {', '.join(_NAMES)} with its unit",
            )
        result[headers.index(old)] = new
    return result
