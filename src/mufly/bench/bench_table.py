"""Reader of bench files: columns in SI units under standard names, with notes on guesses.

A file is a text with a header and columns separated by comma, semicolon, tab or blanks. Decimal commas are accepted
if the comma is not the separator. Lines that begin with ``#`` are skipped. A header is a name and a unit, in brackets
or after the last underscore: ``current_A``, ``Current [mA]``, ``Q(Nm)``. The name may include the rotor (``upper`` or
``lower``), and ``raw`` for an uncalibrated sensor: ``thrust_upper_N``, ``torque_raw_V``. Case does not matter. Other
headers are ignored (docs/reference/bench.md).

A quantity in several columns is read from the column with most readings, so an optical speed replaces an electrical
speed with drop-outs. Of two speeds at a fixed integer ratio the slower is the shaft speed, and the ratio is the number
of pole pairs. A throttle in microseconds is a pulse from 1000 us (zero) to 2000 us (full); a current beside it is the
supply current. :mod:`mufly.bench.apc_performance_files` reads tables of propeller manufacturers.
"""

from __future__ import annotations

import math
import re
import warnings
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mufly.bench.apc_performance_files import read_apc_performance
from mufly.errors import ArgumentError, InputError
from mufly.files.text_table import TextTable, read_text_table
from mufly.quantities.quantity_grammar import ColumnMapEntry, parse_column_map_lines
from mufly.quantities.units import find_conversion_factor, list_compatible_units, normalise_unit, unit_conversion
from mufly.results import result

Array = NDArray[np.float64]
_ASSUMED_UNIT_MESSAGE = "no unit is written, taken as"


class TruncatedFileWarning(UserWarning):
    """Warning that the last line of a file is incomplete."""


@result(eq=False)
class BenchTable:
    """Readings from a bench file, one array of SI values per quantity.

    Attributes
    ----------
    source : str
        Name of the file.
    columns : dict of str to (n,) array
        SI values by name (:class:`mufly.bench.bench_table.ColumnMeaning`); NaN where a cell is empty. ``run`` is a
        number from 0.
    headers : dict of str to str
        Header of each column, as written.
    line_numbers : (n,) array of int
        Line numbers in the file.
    columns_without_unit : tuple of str
        Columns without a stated unit, interpreted as SI until :meth:`rescale_column` changes them.
    notes : tuple of str
        Notes on skipped columns and guesses.
    mismatched_units : dict of str to (str, str)
        Header and unit of quantities whose columns have a wrong unit.
    diameter_m : float
        Rotor diameter if the file states it, else NaN.
    """

    source: str
    columns: dict[str, Array]
    headers: dict[str, str]
    line_numbers: NDArray[np.int64]
    columns_without_unit: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()
    mismatched_units: dict[str, tuple[str, str]] = field(default_factory=dict)
    diameter_m: float = math.nan

    def __len__(self) -> int:
        return int(self.line_numbers.size)

    def __contains__(self, name: str) -> bool:
        return name in self.columns

    def __getitem__(self, name: str) -> Array:
        return self.columns[name]

    def make_column_error(self, key: str, problem: str, remedy: str) -> InputError:
        """Return an error about the column ``key``, named by its header in the file; an empty ``key`` is an error about
        the whole file.
        """
        return InputError(self.source, self.headers.get(key, key), problem, remedy)

    def require_columns(self, names: Iterable[str]) -> None:
        """Check that columns exist and are filled in every line.

        Raises
        ------
        InputError
            For the first missing or incomplete column.
        """
        for name in names:
            if name not in self.columns:
                self.reject_wrong_units([name])
                known = f"known here: {', '.join(self.headers.values())}; map others with columns=NAME=COLUMN(unit)"
                if name == "speed" and "electrical_speed" in self.columns:
                    known = f"divide {self.headers['electrical_speed']} by the number of pole pairs"
                raise InputError(self.source, name, "is not among the columns", known)
            empty = np.flatnonzero(~np.isfinite(self.columns[name]))
            if empty.size:
                cell = f"line {self.line_numbers[empty[0]]}, {self.headers[name]}"
                raise self.make_column_error(cell, "is empty", "fill it in, or leave the line out")

    def reject_wrong_units(self, names: Iterable[str]) -> None:
        """Raise an error if one of these quantities exists only with a wrong unit.

        Raises
        ------
        InputError
            For the first such quantity; the error names column and unit.
        """
        for name in names:
            if name not in self.columns and name in self.mismatched_units:
                header, unit = self.mismatched_units[name]
                si = SI_UNITS[strip_rotor_and_raw_suffix(name)]
                raise InputError(
                    self.source, header, f"{unit!r} is not a known unit of {strip_rotor_and_raw_suffix(name)}",
                    f"use one of: {', '.join(list_compatible_units(si))}",
                )  # fmt: skip

    def with_columns(self, *notes: str, **columns: Array) -> BenchTable:
        """Return the table with added or replaced columns and added notes; a new column's header is its name."""
        headers = {name: name for name in columns} | self.headers
        left = tuple(u for u in self.columns_without_unit if u not in columns)
        return replace(
            self,
            columns={**self.columns, **columns},
            headers=headers,
            columns_without_unit=left,
            notes=(*self.notes, *notes),
        )

    def rescale_column(self, name: str, factor: float, note: str) -> BenchTable:
        """Return the table with one column multiplied by ``factor``, and a note with the reason.

        The note replaces that of the first reading, which took a column without a unit as SI.
        """
        first = f"{self.headers[name]}: {_ASSUMED_UNIT_MESSAGE}"
        known = replace(self, notes=tuple(n for n in self.notes if not n.startswith(first)))
        return known.with_columns(note, **{name: self.columns[name] * factor})

    def select_lines(self, keep: NDArray[np.bool_]) -> BenchTable:
        """Return a table of the lines that ``keep`` (n,) selects."""
        return self.reorder_lines(np.flatnonzero(keep))

    def reorder_lines(self, index: NDArray[np.intp]) -> BenchTable:
        """Return a table of the lines ``index`` of this table, in the order of ``index``."""
        return replace(
            self, columns={k: v[index] for k, v in self.columns.items()}, line_numbers=self.line_numbers[index]
        )


def read_bench_file(path: str | Path, *, columns: Sequence[str] | Mapping[str, str] = ()) -> BenchTable:
    """Read a bench file; parameters and errors are those of :func:`read_bench_files`."""
    return read_bench_files([path], columns=columns)[0]


def read_bench_files(
    paths: Sequence[str | Path], *, columns: Sequence[str] | Mapping[str, str] = ()
) -> list[BenchTable]:
    """Read bench files that share a column map.

    Parameters
    ----------
    paths : sequence of str or Path
    columns : sequence of str, or dict
        Lines of a column map, ``"thrust_lower=T_A(N)"``, ``"speed_lower=pair.csv/RPM(rpm)"``. A line applies to each
        file with its column, or to the file that it names.

    Raises
    ------
    InputError
        If a file cannot be read or has no known column, a line of the map matches no file, or a cell of a used column
        is not a number.
    """
    tables = [_read_apc_table(path) or read_text_table(path, short_rows="cut") for path in paths]
    meant: list[dict[int, list[tuple[str, float]]]] = [{} for _ in paths]
    for line in parse_column_map_lines(columns):
        places = [None if isinstance(t, BenchTable) else _find_mapped_column(t, line) for t in tables]
        if all(place is None for place in places):
            headers = "; ".join(", ".join(t.header) for t in tables if isinstance(t, TextTable))
            where = line.topic or ", ".join(Path(path).name for path in paths)
            raise InputError(where, line.columns[0], "is not among the columns", f"the header is {headers}")
        for table, place, own in zip(tables, places, meant, strict=True):
            if isinstance(table, TextTable) and place is not None:
                own.setdefault(place, []).append(
                    (_make_standard_header(table.column_titles[place], line), line.signs[0])
                )
    return [t if isinstance(t, BenchTable) else _read_columns(t, own) for t, own in zip(tables, meant, strict=True)]


def _read_apc_table(path: str | Path) -> BenchTable | None:
    made = read_apc_performance(path)
    if made is None:
        return None
    headers = {name: name for name in made.columns}
    name = Path(path).name
    return BenchTable(name, made.columns, headers, made.line_numbers, (), made.notes, diameter_m=made.diameter_m)


def _find_mapped_column(table: TextTable, line: ColumnMapEntry) -> int | None:
    """Return the index of the table column that a column-map entry names, with or without its unit; None if absent."""
    if line.topic and line.topic != Path(table.where).name:
        return None
    bare = [match[1] if (match := _BRACKETED_UNIT_PATTERN.match(h)) else h for h in table.header]
    return next((names.index(line.columns[0]) for names in (table.header, bare) if line.columns[0] in names), None)


def _make_standard_header(header: str, line: ColumnMapEntry) -> str:
    """Return the standard header for an entry of a column map: its quantity, with the unit of the entry or of the file.

    Raises
    ------
    ArgumentError
        If the line names no quantity of a bench, or several columns.
    """
    if len(line.columns) > 1:
        raise ArgumentError("columns", line.name, "is in several columns", "write NAME=COLUMN(unit)")
    own = _UNIT_BY_NAME.get(_split_column_name(header.lower())[0], "")
    units = [line.unit] if line.unit else [own, *(unit for _, unit in _list_header_interpretations(header))]
    for unit in units:
        text = f"{line.name} ({unit})" if unit else line.name
        if parse_column_header(text) is not None:
            return text
    known = parse_column_header(line.name)
    if known is None:
        remedy = f"use one of {', '.join(_QUANTITY_UNITS_AND_NAMES)}, with _upper, _lower or _raw"
        raise ArgumentError("columns", line.name, "is not a quantity of a bench", remedy)
    si = SI_UNITS[known.base_quantity]
    problem = f"{line.unit!r} is not a known unit of {known.base_quantity}"
    raise ArgumentError("columns", line.name, problem, f"use one of: {', '.join(list_compatible_units(si))}")


def _read_columns(written: TextTable, mapped: Mapping[int, list[tuple[str, float]]]) -> BenchTable:
    """Read the quantities of a table by its headers.

    ``mapped`` gives, by column index, the standard headers of a column, each with the sign (1 or -1) of the values.
    """
    where = Path(written.where).name
    if not written.rows:
        raise InputError(where, "", "contains no measurements", "give a header and at least one line")
    notes = list(written.notes)
    if written.cut_line:  # its last number may lack digits
        cut = f"line {written.cut_line}, the last, is incomplete and skipped"
        warnings.warn(f"{where}: {cut}", TruncatedFileWarning, stacklevel=4)
    line = np.array(written.lines, dtype=np.int64)
    found: dict[str, list[_InterpretedColumn]] = {}
    mismatched_units: dict[str, tuple[str, str]] = {}
    unused: list[str] = []
    for index, header in enumerate(written.header):
        for text, sign in mapped.get(index, [(written.column_titles[index], 1.0)]):
            column = parse_column_header(text)
            if column is None:
                unused.append(header)
                doubt = _find_wrong_unit_in_header(text)
                if doubt is not None:
                    mismatched_units.setdefault(doubt[0], (header, doubt[1]))
                continue
            if column.base_quantity == "run":
                known: dict[str, float] = {}
                values = np.array([known.setdefault(c, float(len(known))) for c in written.read_texts(index)])
            else:
                values = sign * _read_column_values(written, index, column) * column.factor + column.offset
            found.setdefault(column.name, []).append(_InterpretedColumn(header, column, values))
    if not found and mismatched_units:
        BenchTable(where, {}, {}, line, mismatched_units=mismatched_units).reject_wrong_units(mismatched_units)
    if not found:
        raise InputError(
            where, "", f"no column is understood ({', '.join(written.header)})",
            "name quantity and unit, as torque_mNm, or map them with columns=NAME=COLUMN(unit)",
        )  # fmt: skip
    chosen: dict[str, _InterpretedColumn] = {}
    told: list[str] = []
    for name, readings in found.items():
        chosen[name], words = _choose_column(name, readings)
        told += words
    if unused:
        told.append(f"columns that are not used: {', '.join(unused)}")
    notes = [*told, *notes]
    unitless = tuple(n for n, r in chosen.items() if r.column.unit == "" and not n.endswith("_raw"))
    notes += [
        f"{r.header}: {_ASSUMED_UNIT_MESSAGE} {SI_UNITS[r.column.base_quantity]}"
        for n, r in chosen.items()
        if n in unitless and r.column.base_quantity not in ("speed", "pitch")
    ]
    table = BenchTable(
        where, {n: r.values for n, r in chosen.items()}, {n: r.header for n, r in chosen.items()}, line, unitless,
        tuple(notes), mismatched_units,
    )  # fmt: skip
    return _resolve_pitch_unit(_convert_duty(table, chosen.get("duty")))


@dataclass(frozen=True, eq=False)
class _InterpretedColumn:
    """Column read from a file: header, meaning, SI values."""

    header: str
    column: ColumnMeaning
    values: Array

    @property
    def is_nonzero(self) -> NDArray[np.bool_]:
        """Whether this column has a finite, nonzero value in each line of the file, (n,)."""
        return np.isfinite(self.values) & (self.values != 0.0)


def _choose_column(name: str, readings: list[_InterpretedColumn]) -> tuple[_InterpretedColumn, list[str]]:
    """Return the column from which to read a quantity, and notes with the reason."""
    best, words = readings[0], []
    for other in readings[1:]:
        first, why = best, ""
        lost, gained = (
            int(np.sum(a & ~b)) for a, b in ((best.is_nonzero, other.is_nonzero), (other.is_nonzero, best.is_nonzero))
        )
        if lost != gained and name.startswith("speed"):
            best = other if gained > lost else best
            why = f", which is 0 or empty in {max(lost, gained)} lines that have the other"
        elif best.column.factor != 1.0 and other.column.factor == 1.0 and other.column.unit:
            best = other  # of RPM and omega, or gf and N, the SI column usually has the finer resolution
        if name.startswith("speed"):
            slower, more = _choose_speed_column(first, other)
            best, why = (slower, more) if slower is not None else (best, why)
        out = other if best is first else first
        words.append(f"{name} is read from {best.header!r}, not from {out.header!r}{why}")
    return best, words


def _choose_speed_column(a: _InterpretedColumn, b: _InterpretedColumn) -> tuple[_InterpretedColumn | None, str]:
    """Return which of two disagreeing speed columns to use (None if neither), with the reason.

    The slower one is used if their ratio is an integer: the other counts electrical revolutions. Otherwise a speed from
    an optical sensor is used.
    """
    both = a.is_nonzero & b.is_nonzero
    if both.sum() < 2:
        return None, ""
    ratios = np.abs(a.values[both] / b.values[both])
    ratio = float(np.median(ratios))
    slower, ratio = (b, ratio) if ratio > 1.0 else (a, 1.0 / ratio)
    steady = float(np.ptp(ratios)) <= 0.05 * float(np.median(ratios))
    if steady and ratio > 1.5 and abs(ratio - round(ratio)) < 0.02 * ratio:
        return (
            slower,
            f", which turns {round(ratio)} times as fast: electrical revolutions of {round(ratio)} pole pairs",
        )
    seen = [r for r in (a, b) if "optical" in r.header.lower()]
    if ratio > 1.03 and len(seen) == 1:
        return seen[0], f", from which it differs by {100 * (ratio - 1):.0f} %: check the number of poles"
    return None, ""


def _convert_duty(table: BenchTable, reading: _InterpretedColumn | None) -> BenchTable:
    """Convert a throttle (per cent, -1 to 1, or pulse width) to a share of the supply voltage, with a note."""
    if reading is None:
        return table
    v, header = reading.values, reading.header
    low, high = (float(f(v)) if np.isfinite(v).any() else math.nan for f in (np.nanmin, np.nanmax))
    bare = reading.column.unit in ("", "1")
    pulses = 700.0 <= high <= 2600.0 if bare else bool(normalise_unit(reading.column.unit, "s"))
    if pulses:
        v = 1e-3 * v - 1.0 if bare else v
        words = [f"{header}: a pulse, 1000 us taken as duty 0 and 2000 us as 1; give a column duty for another range"]
        if np.any(v < 0):
            words.append(f"{header}: {int(np.sum(v < 0))} pulses below 1000 us are taken as 0")
        table = table.with_columns(*words, duty=np.where(v < 0, 0.0, v))
    elif bare and 10.0 <= high <= 100.5 and low >= 0:
        table = table.with_columns(f"{header} goes up to {high:g}: taken as per cent", duty=v / 100.0)
    elif bare and low < -0.01 and low >= -1.005 and high <= 1.005:
        speed = np.abs(table["speed"]) if "speed" in table else np.zeros(0)
        reverse = speed.size > 0 and np.nanmax(speed[v < -0.05], initial=0.0) > np.nanmin(
            speed[v >= -0.05], initial=np.inf
        )
        if not speed.any() or reverse:
            raise table.make_column_error(
                "duty", f"goes from {low:g} to {high:g}: the speed does not show which end is rest",
                "give a column duty from 0 to 1",
            )  # fmt: skip
        table = table.with_columns(
            f"{header} goes from {low:g} to {high:g}, the speed rises over all of it: -1 taken as duty 0",
            duty=0.5 * (v + 1.0),
        )
    esc = pulses or any(w in header.lower() for w in ("esc", "throttle"))
    if esc and "current" in table and "supply_current" not in table and "motor" not in table.headers["current"].lower():
        columns = {("supply_current" if k == "current" else k): c for k, c in table.columns.items()}
        headers = {("supply_current" if k == "current" else k): h for k, h in table.headers.items()}
        note = (
            f"{table.headers['current']}: read as the supply current, because the file has {header}; "
            "name the motor current motor_current_A"
        )
        table = replace(table, columns=columns, headers=headers, notes=(*table.notes, note))
    return table


def _resolve_pitch_unit(table: BenchTable) -> BenchTable:
    """Interpret a pitch without unit as degrees if its largest value exceeds pi/2.

    Raises
    ------
    InputError
        If all angles could be radians as well as degrees.
    """
    if "pitch" not in table.columns_without_unit:
        return table
    widest = float(np.nanmax(np.abs(table["pitch"]), initial=0.0))
    if 0.0 < widest <= 0.5 * math.pi:
        raise table.make_column_error(
            "pitch",
            f"goes up to {widest:g} without a unit: degrees or radians?",
            "name it pitch_deg or pitch_rad",
        )
    factor = math.pi / 180.0
    return table.rescale_column("pitch", factor, f"{table.headers['pitch']}: no unit is written, taken as degrees")


def _read_column_values(table: TextTable, index: int, column: ColumnMeaning) -> Array:
    """Return the numbers of a column in its own unit; NaN for empty cells. ``12%`` gives 0.12."""
    share = SI_UNITS[column.base_quantity] == "1"
    values = np.full(len(table.rows), math.nan)
    for k, cell in enumerate(table.read_texts(index)):
        if share and cell.endswith("%"):
            values[k] = table.parse_finite_cell(k, index, cell[:-1]) / 100.0 / column.factor
        elif cell:
            values[k] = table.parse_finite_cell(k, index, cell)
    return values


_QUANTITY_UNITS_AND_NAMES = {
    # quantity: its unit here, and its names
    "voltage": (
        "V",
        "voltage u v volts supply_voltage motor_voltage input_voltage esc_voltage battery_voltage",
    ),
    "duty": (
        "1",
        "duty duty_cycle pwm throttle motor_input esc esc_signal esc_throttle esc_pwm esc_pulse throttle_signal",
    ),
    "current": ("A", "current i motor_current amps"),
    "supply_current": ("A", "supply_current battery_current input_current esc_current"),
    "speed": (
        "rad/s",
        "speed rpm omega rotor_speed motor_speed w motor_electrical_speed motor_optical_speed rotation_speed "
        "rotational_speed optical_speed electrical_speed mechanical_speed motor_rpm rotor_rpm optical_rpm n",
    ),
    "electrical_speed": ("rad/s", "erpm electrical_rpm"),
    "torque": ("N m", "torque q moment load q_meas"),
    "thrust": ("N", "thrust t force lift t_meas"),
    "power": ("W", "power p mechanical_power shaft_power"),
    "electrical_power": ("W", "electrical_power electric_power input_power"),
    "pitch": ("rad", "pitch blade_pitch"),
    "thrust_coefficient": ("1", "ct"),
    "propeller_thrust_coefficient": ("1", "propeller_ct"),
    "power_coefficient": ("1", "cp propeller_cp"),
    "torque_coefficient": ("1", "cq propeller_cq"),
    "rotor_thrust_coefficient": ("1", "c_t rotor_ct"),
    "rotor_torque_coefficient": ("1", "c_q rotor_cq c_p rotor_cp"),
    "advance_ratio": ("1", "j advance_ratio"),
    "airspeed": ("m/s", "airspeed air_speed climb tunnel_speed v"),
    "time": ("s", "time t_s seconds"),
    "run": ("1", "run series test repeat"),
    "density": ("kg/m3", "density rho air_density"),
    "temperature": ("degC", "temperature temp"),
    "pressure": ("Pa", "pressure"),
    "humidity": ("1", "humidity relative_humidity rh"),
}
SI_UNITS = {quantity: unit for quantity, (unit, _) in _QUANTITY_UNITS_AND_NAMES.items()}

_SIDE_WORDS = {"upper": "upper up top", "lower": "lower dw low down bottom"}
_BRACKETED_UNIT_PATTERN = re.compile(r"^(.*?)\s*[\(\[]\s*([^\)\]]*?)\s*[\)\]]$")
_DIMENSIONLESS_QUANTITIES = (
    "duty", "run", "thrust_coefficient", "propeller_thrust_coefficient", "power_coefficient", "torque_coefficient",
    "rotor_thrust_coefficient", "rotor_torque_coefficient", "advance_ratio", "humidity",
)  # fmt: skip
_UNIT_BY_NAME = dict.fromkeys(["rpm", "erpm", "electrical_rpm", "motor_rpm", "rotor_rpm", "optical_rpm"], "rpm") | {
    "omega": "rad/s"
}


@dataclass(frozen=True)
class ColumnMeaning:
    """Meaning of a header: quantity and unit.

    Attributes
    ----------
    name : str
        Quantity, with ``_upper`` or ``_lower`` and ``_raw`` if stated by the header: ``"torque_lower_raw"``.
    factor, offset : float
        SI value = factor * written value + offset.
    unit : str
        Unit as written, ``""`` if the header has none.
    """

    name: str
    factor: float
    unit: str
    offset: float = 0.0

    @property
    def base_quantity(self) -> str:
        """Name of the quantity without the rotor's ending (``_upper``, ``_lower``) and without ``_raw``."""
        return strip_rotor_and_raw_suffix(self.name)


def strip_rotor_and_raw_suffix(name: str) -> str:
    """Return a column name's quantity without rotor suffix and ``_raw``: ``"torque"`` of ``"torque_lower_raw"``."""
    return re.sub(r"(_upper|_lower)?(_raw)?$", "", name)


def parse_column_header(header: str) -> ColumnMeaning | None:
    """Return the meaning of one header, or None if it is not a bench quantity.

    Examples: ``"torque_mNm"``, ``"T(N)"``, ``"RPM"``, ``"speed_upper_rpm"``, ``"thrust_raw_mV"``.
    """
    for name, unit in _list_header_interpretations(header):
        found = _interpret_column_name(name, unit)
        if found is not None:
            return found
    return None


def _list_header_interpretations(header: str) -> list[tuple[str, str]]:
    """Return candidate pairs of name and unit for a header, most likely first."""
    text = " ".join(header.strip().lower().split())
    match = _BRACKETED_UNIT_PATTERN.match(text)
    if match:
        return [(match[1], match[2])]
    parts = text.split("_")
    # A unit may contain an underscore (rad_s), so the last two parts and the last part are tried.
    return [("_".join(parts[:-k]), "_".join(parts[-k:])) for k in (2, 1) if len(parts) > k] + [(text, "")]


def _find_wrong_unit_in_header(header: str) -> tuple[str, str] | None:
    """Return the quantity of a header with a wrong unit, and that unit as written; None otherwise."""
    for name, unit in _list_header_interpretations(header):
        stem, full = _split_column_name(name)
        if unit and (len(stem) > 1 or not normalise_unit(unit)):
            for quantity, (_, names) in _QUANTITY_UNITS_AND_NAMES.items():
                if stem in names.split():
                    written = re.search(re.escape(unit), header, re.IGNORECASE)
                    return full.format(quantity), written[0] if written else unit
    return None


def _split_column_name(name: str) -> tuple[str, str]:
    """Return the quantity in a column name, and a format string that restores the rotor suffix and ``_raw``."""
    words = [w for w in re.split(r"[_\s]+", name) if w]
    sides = {word: side for side, known in _SIDE_WORDS.items() for word in known.split()}
    side = next((sides[w] for w in words if w in sides), "")
    stem = "_".join(w for w in words if w != "raw" and w not in sides)
    return stem, "{}" + (f"_{side}" if side else "") + ("_raw" if "raw" in words else "")


def _interpret_column_name(name: str, unit: str) -> ColumnMeaning | None:
    stem, form = _split_column_name(name)
    raw = form.endswith("_raw")
    for quantity, (si, names) in _QUANTITY_UNITS_AND_NAMES.items():
        if stem not in names.split():
            continue
        full = form.format(quantity)
        if raw:
            return ColumnMeaning(full, 1.0, unit)
        if unit == "" and (stem in _UNIT_BY_NAME or quantity in _DIMENSIONLESS_QUANTITIES):
            unit = _UNIT_BY_NAME.get(stem, "1")
        if unit == "":
            return ColumnMeaning(full, 1.0, "")
        known = normalise_unit(unit, si)
        if known:
            _, factor, offset = unit_conversion(known, si)
            return ColumnMeaning(full, factor, unit, offset)
        if quantity == "duty" and normalise_unit(unit, "s"):  # servo pulse: 1 ms is zero, 2 ms is full
            return ColumnMeaning(full, find_conversion_factor(unit, "s") * 1e3, unit, -1.0)
    return None
