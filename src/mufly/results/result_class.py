"""Results: dataclasses with units and meanings of their fields, and their text, tables, JSON and figures.

A class marked with :func:`result` is a frozen dataclass with described fields. The unit is part of a field's name
(``thrust_N``, ``speed_rad_s``) or of the docstring. The meaning comes from the docstring's Attributes section, which is
parsed on first use. This module writes results as text (``print(result)``), in notebooks, as JSON
(:func:`to_plain_data`) or as a report's table (:func:`result_rows`).

``plot_result()`` draws a result by the function marked ``@draws(ResultClass)``, else its numbers by
:mod:`mufly.results.result_figure`. The ``__init__`` of the class's package imports the module of that function, so
that it is known wherever the class is. A picture module imports matplotlib only inside its functions.

A class with a method ``make_printed_blocks()`` returns its own text as blocks, lines and tables (:class:`ShownLines`,
:class:`ShownTable`). ``print(result)`` shows them as plain text, the command line in colour at the terminal's width.
Fields become columns by their names (:class:`ResultColumn`).
"""

from __future__ import annotations

import html
import inspect
import math
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, fields, is_dataclass
from enum import Enum
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, TypeVar, dataclass_transform, overload

import numpy as np

from mufly.quantities.units import normalise_unit, split_unit_suffix, unit_conversion
from mufly.results.result_figure import PlotVariable, draw_series, enable_notebook_display, make_plot_variable

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_ResultT = TypeVar("_ResultT")
_DrawingFunctionT = TypeVar("_DrawingFunctionT", bound="Callable[..., Figure]")

# Suffixes of field names that never occur in headers of logs.
_RESULT_UNIT_BY_SUFFIX = {
    "N_W": "N/W", "kg_m3": "kg/m3", "kg_m2": "kg m2", "Pa_s": "Pa s", "m2": "m2", "Ah": "A h", "As": "A s", "J": "J",
    "dB": "dB", "percent": "%",
}  # fmt: skip
_ACCEPTED_UNITS = {"J", "dB", "N/W", "1", "rad/s/sqrt(Hz)", "m/s2/sqrt(Hz)"} | set(_RESULT_UNIT_BY_SUFFIX.values())
_ATTRIBUTE_PATTERN = re.compile(r"^(?P<names>\w+(?:, \w+)*) *:(?P<type>.*)$")
_MAX_LISTED_VALUES = 6  # longer arrays are shown by size and range


_MEANINGS_CACHE: dict[type[Any], dict[str, FieldMeaning]] = {}  # parsed docstrings by class
_DRAWING_FUNCTIONS: dict[type[Any], Callable[..., Figure]] = {}  # by class of the drawn result


class FieldMeaning(NamedTuple):
    """Description of a field of a result.

    Attributes
    ----------
    name : str
        Name in the code, ``"thrust_N"``.
    label : str
        Name without the unit, ``"thrust"``.
    unit : str
        Unit; ``""`` without one.
    meaning : str
        One or two sentences; ``""`` if not documented.
    """

    name: str
    label: str
    unit: str
    meaning: str


class ResultRow(NamedTuple):
    """Field of a result for printing: label, value as text, unit and meaning."""

    label: str
    value: str
    unit: str
    meaning: str


@overload
def result(cls: type[_ResultT], /) -> type[_ResultT]: ...
@overload
def result(*, eq: bool = True, json: str = "") -> Callable[[type[_ResultT]], type[_ResultT]]: ...
@dataclass_transform(frozen_default=True)
def result(cls: type[Any] | None = None, /, *, eq: bool = True, json: str = "") -> Any:
    """Make a class a frozen dataclass; its instances print and draw themselves by units and meanings of the fields.

    Parameters
    ----------
    cls : type
        Class whose docstring describes the fields in an Attributes section (NumPy style).
    eq : bool
        As for :func:`dataclasses.dataclass`; False for classes with arrays.
    json : str
        Keys of the JSON, as for :func:`select_fields`; by default all fields.

    Raises
    ------
    TypeError
        If a key of the JSON is not a field, property or method of the class.
    """

    def make_result_class(one: type[Any]) -> type[Any]:
        new = dataclass(frozen=True, eq=eq, repr=False)(one)
        if "__str__" not in one.__dict__:
            new.__str__ = format_result  # type: ignore[assignment]
        if "__repr__" not in one.__dict__:  # the default repr would print all arrays
            new.__repr__ = new.__str__
        if "_repr_html_" not in one.__dict__:
            new._repr_html_ = format_html_table
        if "plot" not in one.__dict__:
            new.plot = plot_result
        new._json = json
        have = {*new.__dataclass_fields__, *dir(new)}
        wanted = [entry.rpartition("=")[2].partition(".")[0] for entry in json.split()]
        if unknown := [name for name in wanted if name not in have]:
            raise TypeError(f"{new.__name__}: json: no field {', '.join(unknown)}")
        return new

    return make_result_class if cls is None else make_result_class(cls)


def field_meanings(cls: type[Any]) -> dict[str, FieldMeaning]:
    """Return the descriptions of the fields and documented properties of a dataclass; the docstring is parsed once."""
    if cls in _MEANINGS_CACHE:
        return _MEANINGS_CACHE[cls]
    told: dict[str, tuple[str, str]] = {}
    for base in reversed(cls.__mro__):
        told |= _parse_attributes(base.__dict__.get("__doc__") or "")
    names = [f.name for f in fields(cls)] if is_dataclass(cls) else []
    for name in dir(cls):
        if isinstance(member := inspect.getattr_static(cls, name), property) and not name.startswith("_"):
            first = inspect.getdoc(member) or ""
            told.setdefault(name, ("", " ".join(first.partition("\n\n")[0].split())))
            names.append(name)
    _MEANINGS_CACHE[cls] = {name: _make_meaning(name, *told.get(name, ("", ""))) for name in dict.fromkeys(names)}
    return _MEANINGS_CACHE[cls]


def field_meaning(item: Any, name: str) -> FieldMeaning:
    """Return the description of a field; dots select fields of parts, ``"upper.thrust_N"``."""
    *parts, last = name.split(".")
    for part in parts:
        item = item[part] if isinstance(item, dict) else getattr(item, part)
    return field_meanings(type(item)).get(last) or _make_meaning(last, "", "")


def _parse_attributes(docstring: str) -> dict[str, tuple[str, str]]:
    """Parse type and meaning of each name in an Attributes (or Parameters) section."""
    lines = inspect.cleandoc(docstring).splitlines()
    found: dict[str, tuple[str, str]] = {}
    names: list[str] = []
    inside = False
    for k, line in enumerate(lines):
        if k + 1 < len(lines) and re.fullmatch("-{3,}", lines[k + 1]):
            inside = line.strip() in ("Attributes", "Parameters")
            names = []
        elif inside and (match := _ATTRIBUTE_PATTERN.match(line)):
            names = match["names"].split(", ")
            found |= {name: (match["type"].strip(), "") for name in names}
        elif inside and line.startswith(" "):
            for name in names:
                kind, said = found[name]
                found[name] = (kind, f"{said} {line.strip()}".strip())
    return found


def _make_meaning(name: str, kind: str, said: str) -> FieldMeaning:
    label, unit = split_unit_suffix(name)
    for suffix, its in _RESULT_UNIT_BY_SUFFIX.items():
        if name.endswith(f"_{suffix}"):
            label, unit = name.removesuffix(f"_{suffix}"), its
    if not unit:
        for text_ in (kind, said):
            for inner in re.findall(r"\(((?:[^()]|\([^()]*\))*)\)", text_):
                unit = unit or normalise_unit(inner) or (inner if inner in _ACCEPTED_UNITS else "")
    return FieldMeaning(name, label.replace("_", " "), "" if unit == "1" else unit, said)


def select_fields(value: Any, names: str) -> dict[str, Any]:
    """Return named fields of a result as a table.

    Parameters
    ----------
    value : result
    names : str
        Keys separated by blanks. ``"thrust_N force=upper.thrust_N"`` takes ``force`` from a field of the field
        ``upper``. Properties, methods without arguments and items of dictionaries count as fields.

    Examples
    --------
    >>> select_fields(1 + 2j, "real height=imag")
    {'real': 1.0, 'height': 2.0}
    """
    found = {}
    for entry in names.split():
        key, _, path = entry.partition("=")
        found[key] = get_field_value(value, path or key)
    return found


def get_field_value(value: Any, path: str) -> Any:
    """Return the value of a field; dots select fields of parts, ``"upper.thrust_N"``, ``"errors.0"``."""
    for part in path.split("."):
        if part.isdigit():
            value = value[int(part)]
        else:
            value = value[part] if isinstance(value, Mapping) else getattr(value, part)
        value = value() if inspect.isroutine(value) else value
    return value


def columns_to_rows(columns: Mapping[str, Iterable[Any]]) -> list[dict[str, Any]]:
    """Convert a table of columns to a list of rows, each a dictionary.

    Examples
    --------
    >>> columns_to_rows({"r_m": [0.1, 0.2], "cl": [0.5, 0.6]})
    [{'r_m': 0.1, 'cl': 0.5}, {'r_m': 0.2, 'cl': 0.6}]
    """
    return [dict(zip(columns, row, strict=True)) for row in zip(*columns.values(), strict=True)]


def to_plain_data(value: Any) -> Any:
    """Convert a value to dictionaries, lists, texts and numbers for JSON.

    A dataclass becomes the result of its ``as_record()``, else a dictionary of the JSON keys of its class, else of its
    fields. Arrays become lists, complex numbers dictionaries of ``real`` and ``imag``, paths texts, and numbers that
    are not finite None.
    """
    if hasattr(type(value), "as_record"):
        return to_plain_data(value.as_record())
    if is_dataclass(value) and not isinstance(value, type):
        if names := getattr(value, "_json", ""):
            return to_plain_data(select_fields(value, names))
        return {f.name: to_plain_data(getattr(value, f.name)) for f in fields(value)}
    if isinstance(value, dict):
        return {str(k): to_plain_data(v) for k, v in value.items()}
    if isinstance(value, np.ndarray | np.generic):
        return to_plain_data(value.tolist())
    if isinstance(value, list | tuple | set | frozenset):
        return [to_plain_data(v) for v in value]
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, complex):
        return {"real": to_plain_data(value.real), "imag": to_plain_data(value.imag)}
    if isinstance(value, Enum):
        return to_plain_data(value.value)
    return str(value) if isinstance(value, Path) else value


def format_value(value: Any, form: str = ".6g") -> str:
    """Return a value as text: integers with all digits unless ``form`` has fixed decimals, other numbers by ``form``,
    ``"-"`` for unknown values, long arrays by size and range.
    """
    if value is None or (isinstance(value, float | np.floating) and math.isnan(value)):
        return "-"
    if isinstance(value, bool | np.bool_):
        return "yes" if value else "no"
    if isinstance(value, int | np.integer) and form.endswith("g"):
        return str(value)
    if isinstance(value, int | float | np.number) and not isinstance(value, complex):
        return f"{value:{form}}"
    if isinstance(value, np.ndarray) and value.dtype.kind in "fiu":
        if value.size <= _MAX_LISTED_VALUES:
            return ", ".join(f"{x:{form}}" for x in value.ravel())
        shape = " x ".join(map(str, value.shape))
        good = value[np.isfinite(value)]
        return f"{shape} values" + (f", {good.min():.4g} to {good.max():.4g}" if good.size else "")
    if isinstance(value, tuple | list):
        if len(value) > _MAX_LISTED_VALUES or any(is_dataclass(v) for v in value):
            return f"{len(value)} entries" if value else "none"
        return ", ".join(format_value(v, form) for v in value)
    if isinstance(value, dict):
        return ", ".join(map(str, value)) if len(value) <= _MAX_LISTED_VALUES else f"{len(value)} entries"
    if is_dataclass(value):
        named = getattr(value, "name", None)
        return named if isinstance(named, str) else type(value).__name__
    words = str(value)
    return words if len(words) <= 60 and "\n" not in words else type(value).__name__


def result_rows(value: Any, names: Iterable[str] | None = None) -> list[ResultRow]:
    """Return the fields of a result as rows for printing; by default all its own fields in order."""
    known = field_meanings(type(value))
    wanted = [f.name for f in fields(value)] if names is None else list(names)
    told = [known.get(name) or _make_meaning(name, "", "") for name in wanted]
    return [ResultRow(m.label, format_value(getattr(value, m.name)), m.unit, m.meaning) for m in told]


def format_result(value: Any) -> str:
    """Return a result as plain text: the blocks that its class defines, otherwise a line for each field."""
    if hasattr(value, "make_printed_blocks"):
        return format_blocks(value.make_printed_blocks())
    lines = result_rows(value)
    widths = [max((len(r[k]) for r in lines), default=0) for k in range(3)]
    first = (inspect.getdoc(type(value)) or "").partition("\n")[0]
    title = f"{type(value).__name__}: {first}".removesuffix(": ")
    told = (
        f"  {r.label:<{widths[0]}}  {r.value:>{min(widths[1], 36)}} {r.unit:<{widths[2]}}  {_first_sentence(r.meaning)}"
        for r in lines
    )
    return "\n".join([title, *(line.rstrip() for line in told)])


def format_html_table(value: Any) -> str:
    """Return a result as a table for notebooks and reports."""
    cells = ("".join(f"<td>{html.escape(c)}</td>" for c in row) for row in result_rows(value))
    return f"<table>{''.join(f'<tr>{line}</tr>' for line in cells)}</table>"


def draws(*classes: type[Any]) -> Callable[[_DrawingFunctionT], _DrawingFunctionT]:
    """Make the decorated function the one that draws results of some classes.

    Parameters
    ----------
    classes : type
        Classes marked with :func:`result`. The function takes such a result as its first argument and needs no other.
    """

    def register(function: _DrawingFunctionT) -> _DrawingFunctionT:
        _DRAWING_FUNCTIONS.update(dict.fromkeys(classes, function))
        return function

    return register


def plot_result(self: Any) -> Figure:
    """Draw a result; return a matplotlib figure, stored by ``.savefig("name.png")``."""
    draw = next((_DRAWING_FUNCTIONS[c] for c in type(self).__mro__ if c in _DRAWING_FUNCTIONS), draw_result_numbers)
    return enable_notebook_display(draw(self))


def draw_result_numbers(value: Any) -> Figure:
    """Draw the numbers of a result, or those of its parts if it has no numbers of its own."""
    known = field_meanings(type(value))
    numbers = [q for f in fields(value) for q in _list_plot_variables(known[f.name], getattr(value, f.name))]
    named = getattr(value, "name", "")
    title = f"{type(value).__name__} {named}".strip() if isinstance(named, str) else type(value).__name__
    return draw_series(
        title,
        numbers or _list_plot_variables_of_parts(value),
        [(r.label, f"{r.value} {r.unit}".strip()) for r in result_rows(value)],
    )


def _list_plot_variables(m: FieldMeaning, value: Any) -> list[PlotVariable]:
    """Return what can be drawn of a field: the field, the columns of its table, or the entries of its dictionary."""
    if isinstance(value, Mapping):
        parts = [_make_meaning(str(k), "", "") for k in value]
        named = [(p.label, p.unit or m.unit, v) for p, v in zip(parts, value.values(), strict=True)]
    elif isinstance(value, np.ndarray) and value.ndim == 2 and value.shape[1] <= _MAX_LISTED_VALUES < value.shape[0]:
        named = [(f"{m.label} {k + 1}", m.unit, column) for k, column in enumerate(value.T)]
    else:
        named = [(m.label, m.unit, value)]
    return [q for label, unit, some in named if (q := make_plot_variable(label, unit, some)) is not None]


def _list_plot_variables_of_parts(value: Any) -> list[PlotVariable]:
    """Return the series of a result that holds a list of sub-results: one series for each field of the sub-results."""
    for f in fields(value):
        parts = getattr(value, f.name)
        if isinstance(parts, tuple | list) and parts and is_dataclass(parts[0]):
            known = field_meanings(type(parts[0]))
            columns = (
                (m, [getattr(p, m.name, None) for p in parts]) for m in (known[g.name] for g in fields(parts[0]))
            )
            return [q for m, some in columns if (q := make_plot_variable(m.label, m.unit, some)) is not None]
    return []


def _first_sentence(words: str) -> str:
    """Return the first sentence without Sphinx markup."""
    clear = re.sub(r":\w+:`~?([^`]*)`", r"\1", words).replace("``", "")
    return re.split(r"(?<=[.;])\s", clear, maxsplit=1)[0].rstrip(";")


# --- blocks of text that show a result ------------------------------------------------------------------------------


@dataclass(frozen=True)
class ShownLines:
    """Block of a printed result: lines of text.

    Attributes
    ----------
    lines : tuple of str
    head : str
        Bold text before the first line.
    mark : str
        Word before each line, with a colon: ``"Warning"``.
    style : str
        Colour or weight: ``"yellow"``, ``"dim"``.
    """

    lines: tuple[str, ...]
    head: str = ""
    mark: str = ""
    style: str = ""


@dataclass(frozen=True)
class ShownTable:
    """Block of a printed result: a table of texts.

    Attributes
    ----------
    heads : tuple of str
    rows : tuple of sequences of str
        Cells, which may contain markup such as ``[bold]word[/]``.
    title : str
    text : tuple of int
        Indices of text columns; the others are numbers.
    """

    heads: tuple[str, ...]
    rows: tuple[Sequence[str], ...]
    title: str = ""
    text: tuple[int, ...] = (0,)


ShownBlock = ShownLines | ShownTable


def make_lines_block(*lines: str, head: str = "", mark: str = "", style: str = "") -> ShownLines:
    """Return lines of text as a block of a printed result."""
    return ShownLines(lines, head, mark, style)


def make_table_block(
    heads: Iterable[str], rows: Iterable[Sequence[str]], *, title: str = "", text: Iterable[int] = (0,)
) -> ShownTable:
    """Return a table of texts as a block of a printed result."""
    return ShownTable(tuple(heads), tuple(rows), title, tuple(text))


@dataclass(frozen=True)
class ResultColumn:
    """Description of a column in a table of results, or of a line in a table of one result: field, unit and format.

    Parameters
    ----------
    name : str
        Name of the field, ``"speed_rad_s"``; dots select fields of parts, ``"upper.thrust_N"``.
    unit : str
        Printed unit, ``"rpm"``; default: the field's unit.
    form : str
        As for :func:`format`.
    head : str
        Heading; default: the field's name without its unit.
    entry_names : tuple of str
        Names of the entries of a pair, ``("upper", "lower")``.
    own_unit : str
        Unit of the field, if neither its name nor its docstring states it.
    """

    name: str
    unit: str = ""
    form: str = ".4g"
    head: str = ""
    entry_names: tuple[str, ...] = ()
    own_unit: str = ""

    def header_text(self, item: Any) -> str:
        """Return the column's heading with the unit."""
        label, unit = self._label_and_unit(item)
        unit = self.unit or unit
        return f"{self.head or label} ({unit})" if unit else self.head or label

    def value_text(self, item: Any, *, unit: bool = False) -> str:
        """Return the value of one result as text, optionally with its unit."""
        value = get_field_value(item, self.name)
        own = self._label_and_unit(item)[1]
        if self.unit and value is not None:
            _, factor, offset = unit_conversion(own or "1", self.unit)
            value = [factor * v + offset for v in value] if isinstance(value, tuple | list) else factor * value + offset
        if isinstance(value, str):
            return value
        shown = format_value(value, self.form)
        if self.entry_names:
            shown = ", ".join(f"{format_value(v, self.form)} {n}" for v, n in zip(value, self.entry_names, strict=True))
        return shown if not unit or shown == "-" else f"{shown} {self.unit or own}".rstrip()

    def _label_and_unit(self, item: Any) -> tuple[str, str]:
        found = field_meaning(item, self.name)
        return found.label, self.own_unit or found.unit


def tabulate_results(
    items: Sequence[Any], columns: Iterable[ResultColumn | str], *, title: str = "", names: Sequence[str] = ()
) -> ShownTable:
    """Return results as a table, one per row; ``names`` is the first column."""
    if not items:
        return ShownTable((), ())
    wanted = [ResultColumn(c) if isinstance(c, str) else c for c in columns]
    heads = [c.header_text(items[0]) for c in wanted]
    rows = [[c.value_text(item) for c in wanted] for item in items]
    if names:
        heads, rows = ["", *heads], [[name, *row] for name, row in zip(names, rows, strict=True)]
    texts = [k for k, _ in enumerate(heads) if (k == 0 and names) or not any(_looks_like_number(x[k]) for x in rows)]
    return make_table_block(heads, rows, title=title, text=texts)


def tabulate_fields(
    item: Any, columns: Iterable[ResultColumn | str | tuple[str, str]], *, title: str = ""
) -> ShownTable:
    """Return one result as a table with a row for each field; a pair of texts is a label with its value."""
    rows: list[tuple[str, str]] = []
    for one in columns:
        if isinstance(one, tuple):
            rows.append(one)
        else:
            c = ResultColumn(one) if isinstance(one, str) else one
            rows.append((c.head or field_meaning(item, c.name).label, c.value_text(item, unit=True)))
    return make_table_block(("", ""), rows, title=title, text=(0, 1))


def _looks_like_number(text: str) -> bool:
    return text == "-" or (text.lstrip("+-")[:1].isdigit() and text.rstrip(" %")[-1:].isdigit())


def format_blocks(blocks: Iterable[ShownBlock]) -> str:
    """Return blocks of lines and tables as plain text."""
    lines: list[str] = []
    for block in blocks:
        if isinstance(block, ShownLines):
            told = [f"{block.mark}: {line}" if block.mark else line for line in block.lines]
            lines += [block.head + told[0], *told[1:]] if told else []
        elif block.heads:
            cells = [[re.sub(r"\[/?[a-z ]*\]", "", cell) for cell in row] for row in (block.heads, *block.rows)]
            widths = [max(map(len, column)) for column in zip(*cells, strict=True)]
            lines += [block.title] if block.title else []
            for row in cells if any(block.heads) else cells[1:]:
                padded = [
                    cell.ljust(width) if k in block.text else cell.rjust(width)
                    for k, (cell, width) in enumerate(zip(row, widths, strict=True))
                ]
                lines.append("  ".join(padded).rstrip())
    return "\n".join(lines)
