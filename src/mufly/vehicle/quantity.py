"""Numbers with unit and provenance in files of vehicles, rotors and drives, and groups of such parameters.

    mass = { value = 95, unit = "g", source = "measured", note = "on a scale" }

Values are converted to SI when the file is read; the unit is mandatory. The content of a file is declared once:
groups of parameters (:func:`declare_parameter`), each with unit, symbol, meaning and permitted values.
"""

from __future__ import annotations

import html
from collections.abc import Iterator
from operator import ge, gt, le, lt
from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field, ValidationInfo, field_validator

from mufly.files.input_files import TOO_MANY_DIGITS_ERROR, make_validation_error
from mufly.quantities.units import list_compatible_units

ValueSource = Literal["measured", "CAD", "datasheet", "estimated", "identified", "specified"]

_LIMIT_OPERATORS = {"above": gt, "at_least": ge, "below": lt, "at_most": le}
_MAX_REPR_VALUE_WIDTH = 64  # greatest width of the values in a line of a short representation
_MAX_PLAUSIBLE_SI_VALUE = 1e9  # greater than any parameter of a vehicle in SI units; powers of larger values overflow


class _FrozenModel(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


class Quantity(_FrozenModel):
    """Number with unit and provenance; ``float(quantity)`` is the SI value.

    ``std`` is an optional standard deviation in the same unit; identification derives a default from the source.
    """

    value: float
    unit: str
    source: ValueSource
    note: str = ""
    std: float | None = Field(default=None, ge=0.0)

    def __float__(self) -> float:
        return self.value


class BodyPoints(_FrozenModel):
    """Points in body axes (x forward, y right, z down from the centre of gravity)."""

    value: tuple[tuple[float, float, float], ...]
    unit: str
    source: ValueSource
    note: str = ""

    def to_array(self) -> NDArray[np.float64]:
        """Return the points as an (n, 3) array in SI units."""
        return np.array(self.value, dtype=np.float64).reshape(-1, 3)


class TabulatedCurve(_FrozenModel):
    """Curve of a quantity over a fraction from 0 to 1, such as the charge of a battery."""

    fraction: tuple[float, ...]
    value: tuple[float, ...]
    unit: str
    source: ValueSource
    note: str = ""

    def sample_evenly(self, n: int) -> NDArray[np.float64]:
        """Return ``n`` values at equal steps of the fraction, interpolated linearly."""
        return np.interp(np.linspace(0.0, 1.0, n), self.fraction, self.value)


def declare_parameter(
    unit: str,
    symbol: str,
    description: str,
    *,
    above: float | None = None,
    at_least: float | None = None,
    below: float | None = None,
    at_most: float | None = None,
    absent: float | None = None,
) -> Any:
    """Declare a parameter of a vehicle: SI unit, symbol, meaning and permitted values.

    ``absent`` is the default for files without this parameter; without a default the parameter is mandatory.
    """
    limits = {"above": above, "at_least": at_least, "below": below, "at_most": at_most}
    extra: dict[str, Any] = {"unit": unit, "symbol": symbol, **limits}
    if absent is None:
        return Field(description=description, json_schema_extra=extra)
    left_out = Quantity(value=absent, unit=unit, source="estimated", note="not in the vehicle file")
    return Field(default=left_out, description=description, json_schema_extra=extra)


def _check_limits(value: float, unit: str, limits: dict[str, Any]) -> None:
    set_ = {k: limits[k] for k in _LIMIT_OPERATORS if limits.get(k) is not None}
    if not abs(value) < _MAX_PLAUSIBLE_SI_VALUE or not all(
        _LIMIT_OPERATORS[k](value, limit) for k, limit in set_.items()
    ):
        words = " and ".join(f"{k.replace('_', ' ')} {limit:g}" for k, limit in set_.items())
        wanted = words or "of ordinary size"
        raise make_validation_error(f"{value:g} {unit} is out of range", f"give a value {wanted} ({unit})")


def _scale_value(value: Any, factor: float) -> Any:
    if isinstance(value, list | tuple):
        return [_scale_value(v, factor) for v in value]
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise make_validation_error(f"{value!r} is not a number", "give a number")
    try:
        return float(value) * factor
    except OverflowError:
        raise make_validation_error(*TOO_MANY_DIGITS_ERROR) from None


def _flatten_values(value: Any) -> list[float]:
    return [x for v in value for x in _flatten_values(v)] if isinstance(value, list) else [value]


class ParameterLine(NamedTuple):
    """Line of a parameter listing: table, key, and value as text."""

    table: str
    key: str
    symbol: str
    value: str
    unit: str
    source: str
    meaning: str


def iterate_parameter_lines(group: _FrozenModel, table: str = "") -> Iterator[ParameterLine]:
    """Yield every parameter of a group and its subgroups, ordered by table."""
    inner: list[tuple[str, _FrozenModel]] = []
    for name, declared in type(group).model_fields.items():
        value = getattr(group, name)
        extra = declared.json_schema_extra if isinstance(declared.json_schema_extra, dict) else {}
        said, symbol = declared.description or "", str(extra.get("symbol", ""))
        if isinstance(value, Quantity | BodyPoints | TabulatedCurve):
            meaning = f"{said} ({value.note})" if value.note else said
            unit = "" if value.unit == "1" else value.unit
            yield ParameterLine(table, name, symbol, _format_value(value.value), unit, value.source, meaning)
        elif isinstance(value, _FrozenModel):
            inner.append((name, value))
        elif isinstance(value, tuple) and value and isinstance(value[0], _FrozenModel):
            inner += [(f"{name}[{k}]", v) for k, v in enumerate(value, 1)]
        elif value not in (None, "", ()):
            yield ParameterLine(table, name, symbol, _format_value(value), str(extra.get("unit", "")), "", said)
    for name, part in inner:
        yield from iterate_parameter_lines(part, f"{table}.{name}".lstrip("."))


def _format_value(value: Any) -> str:
    if isinstance(value, float):
        return f"{value:.5g}"
    if isinstance(value, tuple | list):
        shown = ", ".join(_format_value(v) for v in value[:6])
        return f"({shown}, ... {len(value)} in all)" if len(value) > 6 else f"({shown})"
    return str(value)


def _format_first_values(rows: list[ParameterLine]) -> str:
    """Format the first values of a table in one line, with the number of further values."""
    shown: list[str] = []
    for row in rows:
        text = f"{row.key} {row.value} {row.unit}".strip()
        if sum(map(len, shown)) + len(text) > _MAX_REPR_VALUE_WIDTH:
            break
        shown.append(text)
    more = len(rows) - len(shown)
    return ", ".join([*shown, *([f"{more} {'more' if shown else 'values'}"] if more else [])])


_MAX_SHOWN_TABLES = 7  # of a repr


class ParameterGroup(_FrozenModel):
    """Named group of parameters, converted to SI and validated against the declaration."""

    def __str__(self) -> str:
        """Return every parameter with unit, source and meaning, one per line."""
        rows = list(iterate_parameter_lines(self))
        widths = (max((len(r[k]) for r in rows), default=0) for k in range(6))
        _, key_width, symbol_width, value_width, unit_width, source_width = widths
        out, table = [f"{type(self).__name__} {getattr(self, 'name', '')}".strip()], ""
        for r in rows:
            if r.table != table:
                out.append(f"[{r.table}]")
                table = r.table
            value = r.value if len(r.value) <= 40 else f"{r.value[:37]}..."
            out.append(
                f"  {r.key:<{key_width}}  {r.symbol:<{symbol_width}}  {value:>{min(value_width, 40)}} "
                f"{r.unit:<{unit_width}}  {r.source:<{source_width}}  {r.meaning}".rstrip()
            )
        return "\n".join(out)

    def __repr__(self) -> str:
        """Return name, description and some values of the first tables of the file, in at most ten lines.

        :meth:`__str__` has all of them.
        """
        title = f"{type(self).__name__} {getattr(self, 'name', '')}".strip()
        if said := getattr(self, "description", ""):
            title += f": {said}"
        rows = list(iterate_parameter_lines(self))
        tables: dict[str, list[ParameterLine]] = {}
        for row in rows:
            if row.key not in ("name", "description"):
                tables.setdefault(row.table.partition(".")[0], []).append(row)
        width = max((len(name) for name in tables), default=0)
        shown = dict(list(tables.items())[:_MAX_SHOWN_TABLES]) if len(tables) > _MAX_SHOWN_TABLES + 1 else tables
        out = [title, *(f"  {name:<{width}}  {_format_first_values(held)}" for name, held in shown.items())]
        if left := [name for name in tables if name not in shown]:
            out.append(f"  and the tables {', '.join(left)}")
        return "\n".join([*out, f"  {len(rows)} values in all: print(...) shows each with its source"])

    def _repr_html_(self) -> str:
        """Return the parameters as an HTML table for notebooks."""
        heads = "".join(f"<th>{h}</th>" for h in ("key", "symbol", "value", "unit", "source", "meaning"))
        out, table = [f"<tr>{heads}</tr>"], ""
        for r in iterate_parameter_lines(self):
            if r.table != table:
                out.append(f'<tr><th colspan="6" style="text-align:left">[{html.escape(r.table)}]</th></tr>')
                table = r.table
            cells = "".join(f'<td style="text-align:left">{html.escape(c)}</td>' for c in r[1:])
            out.append(f"<tr>{cells}</tr>")
        title = f"{type(self).__name__} {getattr(self, 'name', '')}".strip()
        return f"<table><caption>{html.escape(title)}</caption>{''.join(out)}</table>"

    @field_validator("*", mode="before")
    @classmethod
    def _to_si(cls, raw: Any, info: ValidationInfo) -> Any:
        declared = cls.model_fields[str(info.field_name)].json_schema_extra
        if not isinstance(declared, dict) or "unit" not in declared or isinstance(raw, _FrozenModel):
            return raw
        si = str(declared["unit"])
        example = f'{{ value = ..., unit = "{si}", source = "measured" }}'
        if not isinstance(raw, dict):
            raise make_validation_error(
                f"{raw!r} states neither unit nor source", f"write {info.field_name} = {example}"
            )
        if "unit" not in raw:
            raise make_validation_error("the unit is missing", f"write {info.field_name} = {example}")
        if not isinstance(raw["unit"], str) or raw["unit"] not in list_compatible_units(si):
            accepted = ", ".join(list_compatible_units(si))
            raise make_validation_error(
                f"unit {raw['unit']!r} is not a unit of this parameter", f"use one of: {accepted}"
            )
        if "value" not in raw:
            raise make_validation_error("the value is missing", f"write {info.field_name} = {example}")
        value = _scale_value(raw["value"], list_compatible_units(si)[raw["unit"]])
        for v in _flatten_values(value):
            _check_limits(v, si, declared)
        std = raw.get("std")
        scaled = {} if std is None else {"std": _scale_value(std, list_compatible_units(si)[raw["unit"]])}
        return {**raw, "value": value, "unit": si, **scaled}
