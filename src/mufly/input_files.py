"""From a TOML file to a checked model, with one clear line when it is wrong; and a text with columns, to its cells.

Vehicles, missions and rotors are all read the same way: by the name of a built-in file or by path, parsed, and
validated by a pydantic model. This module holds the parts that they share: finding and reading the file, and turning
pydantic's list of faults into the one line that a user can act on. A model's own checks raise
:func:`model_error`, whose words are kept.
"""

from __future__ import annotations

import codecs
import csv
import json
import math
import re
import tomllib
from collections.abc import Mapping, Sequence
from importlib.resources.abc import Traversable
from operator import methodcaller
from pathlib import Path
from typing import Any, TypeVar

from pydantic import BaseModel, ValidationError
from pydantic_core import PydanticCustomError

from mufly.errors import InputError, suggest_name

ModelT = TypeVar("ModelT", bound=BaseModel)

_LIMIT_WORDS = {
    "greater_than": ("gt", "above"),
    "greater_than_equal": ("ge", "at least"),
    "less_than": ("lt", "below"),
    "less_than_equal": ("le", "at most"),
}


def builtin_file_names(folder: Traversable) -> list[str]:
    """Return the names of the TOML files in a folder of the package."""
    return sorted(f.name.removesuffix(".toml") for f in folder.iterdir() if f.name.endswith(".toml"))


def read_toml(name_or_path: str | Path, folder: Traversable, kind: str) -> tuple[dict[str, Any], str]:
    """Read a TOML file by built-in name or by path.

    Parameters
    ----------
    name_or_path : str or Path
        A name in ``folder``, or the path of a file.
    folder : Traversable
        Where the built-in files lie.
    kind : str
        What an error calls such a file: ``"vehicle"``.

    Returns
    -------
    tables : dict
        As TOML gives them.
    where : str
        What an error calls the file.

    Raises
    ------
    InputError
        If there is no such file, or it is not text or not TOML.
    """
    name = str(name_or_path)
    known = builtin_file_names(folder)
    if name in known:
        text, where = (folder / f"{name}.toml").read_text(encoding="utf-8"), f"{name}.toml"
    else:
        path, where = Path(name_or_path), name
        if not path.is_file():
            beside = path.parent.glob("*.toml") if path.parent.is_dir() else ()
            here = [str(f) for f in beside if suggest_name(path.stem, [f.stem], "-") != "-"]
            remedy = suggest_name(
                name, [*known, *here], f"give a {kind} file, or one of the built-in: {', '.join(known)}"
            )
            raise InputError(name, "", f"no such {kind} or file", remedy)
        try:
            text = path.read_text(encoding="utf-8-sig")
        except (OSError, UnicodeDecodeError) as error:
            raise InputError(where, "", f"cannot be read ({error})", "give a text file in UTF-8") from error
    try:
        return tomllib.loads(text), where
    except tomllib.TOMLDecodeError as error:
        raise InputError(where, "", f"is not valid TOML ({error})", "correct that line") from error


_COMMENT_MARKS = ("#",)
# A cell in quotes that goes on in the next line; a lone quote inside a cell (3" propeller) opens none.
_OPEN_QUOTE_PATTERN = re.compile(r'(?:^|[,;\t])\s*"(?:[^"]|"")*$')
_MAX_CELL_LINES = 100  # lines
# Thousands in groups, as spreadsheets write them: 1.234,5 beside decimal commas, 1,234.5 beside points; 1'234, 1 234.
_GROUP_SEPARATORS = " \u00a0\u2009\u202f'\u2019"
_OTHER_DECIMAL_MARK = {",": ".", ".": ","}
_GROUPED_NUMBER_PATTERNS = {
    d: re.compile(rf"[+-]?[1-9]\d{{0,2}}([{o}{_GROUP_SEPARATORS}]\d{{3}})+([{d}]\d*)?")
    for d, o in _OTHER_DECIMAL_MARK.items()
}
_PLAIN_NUMBER_PATTERNS = {
    d: re.compile(rf"[+-]?(\d+[{d}]?\d*|[{d}]\d+)(e[+-]?\d+)?", re.IGNORECASE) for d in _OTHER_DECIMAL_MARK
}
_FORTRAN_NUMBER_PATTERN = re.compile(r"([+-]?(?:\d+\.\d*|\.\d+))[dD]([+-]?\d+)")  # double precision: 1.0D-03
_MAX_SAMPLED_CELLS = 20_000


def decode_text(raw: bytes) -> str:
    """Return the text in a file's bytes: UTF-16 or UTF-8 where it says so, else UTF-8, else Windows' western code page.

    A spreadsheet's note of its separator (``sep=;``) is taken out of the first line.
    """
    if raw.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        text = raw.decode("utf-16", errors="ignore")  # "Unicode text" of a spreadsheet
    else:
        try:
            text = raw.decode("utf-8-sig")
        except UnicodeDecodeError:
            text = raw.decode("cp1252", errors="replace")
    return re.sub(r"\Asep=.(?=\r?\n)", "", text)


def split_cells(line: str, separator: str) -> list[str]:
    """Return the cells of a line; between blanks a unit in brackets stays with its name."""
    if separator == " ":
        return [c.strip() for c in re.findall(r"[^\s(\[]+(?:\s*[(\[][^)\]]*[)\]])?|[(\[][^)\]]*[)\]]?", line)]
    return [c.strip() for c in _split_csv_cells(line, separator)]


def _split_csv_cells(line: str, separator: str) -> list[str]:
    try:
        return next(csv.reader([line], delimiter=separator, skipinitialspace=True), [])
    except csv.Error:  # a line break of another system outside quotes, a cell of more than 128 kB
        return line.split(separator)


def split_lines(text: str) -> tuple[list[str], Sequence[int]]:
    """Return the rows of a text and the line at which each begins; a cell in quotes may hold line breaks."""
    lines = text.splitlines()
    numbers: Sequence[int] = range(1, len(lines) + 1)
    if '"' not in text:
        return lines, numbers
    ends: dict[int, int] = {}
    beyond = -1
    for k, line in enumerate(lines):
        if k <= beyond or line.count('"') % 2 == 0 or not _OPEN_QUOTE_PATTERN.search(line):
            continue
        closing = (j for j in range(k + 1, min(k + _MAX_CELL_LINES, len(lines))) if lines[j].count('"') % 2)
        beyond = next(closing, -1)
        if beyond > k:
            ends[k] = beyond
    if not ends:
        return lines, numbers
    rows, numbers, k = [], [], 0
    while k < len(lines):
        last = ends.get(k, k)
        rows.append("\n".join(lines[k : last + 1]))
        numbers.append(k + 1)
        k = last + 1
    return rows, numbers


def count_cells(rows: Sequence[str], separator: str) -> list[int]:
    """Return how many cells each row of a text has."""
    if separator != " " and not any('"' in row for row in rows):
        return [n + 1 for n in map(methodcaller("count", separator), rows)]
    plain = '"' if separator != " " else "(["
    return [
        len(split_cells(row, separator))
        if any(c in row for c in plain)
        else (row.count(separator) + 1 if separator != " " else len(row.split()))
        for row in rows
    ]


def drop_surplus_cells(row: str, separator: str, width: int, wanted: int) -> str:
    """Return a row without the empty cells that some loggers write behind its last one."""
    while width > wanted and row.rstrip(" ").endswith(separator):
        row, width = row.rstrip(" ")[: -len(separator)], width - 1
    return row


def row_width_error(where: str, line: int, width: int, wanted: int, others: int = 0) -> InputError:
    """Return the error about a row that has more or fewer cells than the header: nobody knows which is missing."""
    more = f" (and {others} more rows)" if others else ""
    problem = f"has {width} cell{'' if width == 1 else 's'}, the header {wanted}{more}"
    return InputError(where, f"line {line}", problem, "give every row as many cells as the header")


def normalise_number(cell: str, decimal: str) -> str:
    """Return a cell's number as Python writes one: thousands not grouped, with a point, an e for Fortran's D.

    Other cells stay as they are.
    """
    text = (
        re.sub(f"[{_OTHER_DECIMAL_MARK[decimal]}{_GROUP_SEPARATORS}]", "", cell)
        if _GROUPED_NUMBER_PATTERNS[decimal].fullmatch(cell)
        else cell
    )
    text = text.replace(",", ".") if decimal == "," else text
    try:
        float(text)
    except ValueError:
        fortran = _FORTRAN_NUMBER_PATTERN.fullmatch(text)
        return cell if fortran is None else f"{fortran[1]}e{fortran[2]}"
    return text


def parse_number(cell: str, decimal: str = ".") -> float:
    """Return the number in a cell, thousands grouped or not, NaN if there is none."""
    try:
        return float(normalise_number(cell, decimal))
    except ValueError:
        return math.nan


def points_group_thousands(cells: Sequence[str], decimal: str) -> bool:
    """Whether points in a column beside decimal commas group thousands (1.234 and 987) or are decimal (0.123)."""
    points = [c for c in cells if decimal == "," and "." in c]
    return not points or all(_GROUPED_NUMBER_PATTERNS[","].fullmatch(c) for c in points)


def detect_layout(lines: Sequence[str]) -> tuple[str, str]:
    """Return what sets cells apart in a text, and the decimal mark of its numbers.

    Semicolons and tabs come first, and blanks before commas where what is between them are numbers with decimal commas.
    A comma is the decimal mark if some number can be read with it alone (0,5; 1.234,5). Where all could count thousands
    (1,234) it is, too, unless a number with a point speaks against it.
    """
    lines = [s for s in lines if s.strip()]
    separator = _detect_separator(lines[:20])
    width = lines[0].count(separator) + 1 if lines else 1
    sample = lines[:: 1 + len(lines) * width // _MAX_SAMPLED_CELLS]
    if not any("," in s.replace(separator, "") or '"' in s for s in sample):
        return separator, "."
    certain, open_ = {",": 0, ".": 0}, 0
    for cell in (c for s in sample for c in split_cells(s, separator) if "," in c or "." in c):
        comma, point = (
            bool(_PLAIN_NUMBER_PATTERNS[d].fullmatch(cell) or _GROUPED_NUMBER_PATTERNS[d].fullmatch(cell)) for d in ",."
        )
        certain[","] += comma and not point
        certain["."] += point and not comma
        open_ += comma and point and "," in cell
    if separator == ",":
        return separator, "," if certain[","] > certain["."] else "."
    return separator, "," if certain[","] or (open_ and not certain["."]) else "."


def _detect_separator(lines: Sequence[str]) -> str:
    """Return the separator that splits these lines into columns, as many in each line."""
    body = [[c for c in s.split(" ") if c] for s in lines[1:]]
    if any("," in c for row in body for c in row) and all(
        len(row) == len(body[0]) > 1 and not any(c.endswith(",") or math.isnan(parse_number(c, ",")) for c in row)
        for row in body
    ):
        return " "
    found = {}
    for candidate in (";", "\t", ",", " "):
        counts = [len(split_cells(s, candidate)) for s in lines]
        usual = max(set(counts), key=counts.count, default=1)
        if usual > 1 and counts.count(usual) >= 0.7 * len(counts):
            found[candidate] = usual
    for candidate in (";", "\t"):
        if candidate in found:
            return candidate
    return max(found, key=lambda c: found[c], default=max(",;\t", key=(lines or [""])[0].count))


def read_text_columns(path: str | Path) -> tuple[list[str], list[tuple[int, list[str]]]]:
    """Read a text whose first line names its columns.

    Columns are set apart by comma, semicolon, tab or blanks; empty lines and lines that begin with ``#`` are skipped.
    The last row may be short, as that of a file that is still being written.

    Returns
    -------
    headers : list of str
    rows : list of (line number, cells)
        Cells with a number hold it as Python writes one, whatever marks the file has for decimals and thousands.

    Raises
    ------
    InputError
        If the file cannot be read, has no line, or a row has not as many cells as the header.
    """
    try:
        text = decode_text(Path(path).read_bytes())
    except OSError as error:
        raise InputError(str(path), "", f"cannot be read ({error.strerror})", "give a text file") from error
    if "\0" in text:
        raise InputError(str(path), "", "is no text", "save it as CSV, in UTF-8")
    lines = [
        (i, s)
        for s, i in zip(*split_lines(text), strict=True)
        if s.strip() and not s.lstrip().startswith(_COMMENT_MARKS)
    ]
    if not lines:
        raise InputError(str(path), "", "is empty", "give a header and at least one line")
    separator, decimal = detect_layout([s for _, s in lines])
    head = split_cells(lines[0][1], separator)
    rows = [(i, split_cells(s, separator)) for i, s in lines[1:]]
    for i, cells in rows:
        while len(cells) > len(head) and not cells[-1]:
            cells.pop()
        if len(cells) > len(head) or (len(cells) < len(head) and i != rows[-1][0]):
            raise row_width_error(str(path), i, len(cells), len(head))
    columns = [[row[k] for _, row in rows if k < len(row)] for k in range(max((len(r) for _, r in rows), default=0))]
    marks = [decimal if points_group_thousands(column, decimal) else "." for column in columns]
    return head, [(i, [normalise_number(c, d) for c, d in zip(row, marks, strict=False)]) for i, row in rows]


def validate_model(model: type[ModelT], tables: Mapping[str, Any], where: str) -> ModelT:
    """Make a checked model of nested dictionaries.

    Raises
    ------
    InputError
        Naming the first fault, and how many more there are. Members of lists are counted from 1.
    """
    try:
        return model.model_validate(tables)
    except ValidationError as error:
        raise _first_model_error(error, model, where) from None


TOO_MANY_DIGITS = ("a whole number of more than 300 digits", "give a value of ordinary size")
_MAX_ORDINARY_INTEGER = 10**300


def model_error(problem: str, remedy: str, key: str = "") -> PydanticCustomError:
    """Return what a model's own check raises; ``key`` where that of the field checked would not do."""
    context = {"problem": problem, "remedy": remedy} | ({"key": key} if key else {})
    return PydanticCustomError("mufly", "{problem}; {remedy}", context)


def _first_model_error(error: ValidationError, model: type[BaseModel], where: str) -> InputError:
    faults = error.errors()
    # An unknown key is usually the reason for a missing one, so it is named first.
    fault = min(faults, key=lambda f: f["type"] != "extra_forbidden")
    kind, loc, given = fault["type"], fault["loc"], fault["input"]
    context: dict[str, Any] = fault.get("ctx", {})
    if kind == "missing" and loc and isinstance(loc[-1], int):
        # A tuple that is too short is reported at its first missing place.
        kind, loc = "length", loc[:-1]
    key = _dotted_key(loc)
    beside = _model_at(model, loc[:-1])
    field = beside.model_fields.get(str(loc[-1])) if loc else None
    meaning = (field.description or "") if field is not None else ""
    if kind == "mufly":
        problem, remedy, key = context["problem"], context["remedy"], context.get("key", key)
    elif kind == "extra_forbidden":
        problem, keys = "unknown key", list(beside.model_fields)
        remedy = suggest_name(str(loc[-1]), keys, f"known keys here: {', '.join(keys)}")
    elif kind == "missing":
        problem, remedy = "is missing", _describe_missing_key(str(loc[-1]), field)
    elif kind in ("length", "too_long"):
        wanted = len(getattr(field.annotation, "__args__", ())) if field is not None else 0
        problem, remedy = f"{_shorten_value(given)} has the wrong length", f"give {wanted} numbers: {meaning}"
    elif kind in _LIMIT_WORDS:
        name, words = _LIMIT_WORDS[kind]
        problem, remedy = (
            f"{_shorten_value(given)} is not sensible",
            f"give a number {words} {context[name]:g}",
        )
    elif kind == "finite_number":
        problem, remedy = f"{given} is not a number", "give a finite number"
    elif isinstance(given, int) and abs(given) > _MAX_ORDINARY_INTEGER:
        problem, remedy = TOO_MANY_DIGITS
    elif kind in ("float_type", "float_parsing"):
        problem, remedy = f"{_shorten_value(given)} is not a number", "give a number without quotes"
    elif kind in ("int_type", "int_parsing", "int_from_float"):
        problem, remedy = f"{given!r} is not a whole number", "give a whole number without quotes"
    elif kind == "literal_error":
        problem, remedy = f"{_shorten_value(given)} is unknown", f"give {context['expected']}"
    elif kind == "tuple_type":
        tables = field is not None and nested_model(field.annotation) is not None
        what = "texts" if field is not None and str in getattr(field.annotation, "__args__", ()) else "numbers"
        remedy = f"write one table [[{loc[-1]}]] for each" if tables else f"give {what} in brackets: {meaning}"
        problem, remedy = f"{_shorten_value(given)} is not a list", remedy.rstrip(": ")
    elif kind in ("model_type", "model_attributes_type"):
        problem, remedy = f"{_shorten_value(given)} is not a table", "write its keys under it"
    else:
        problem, remedy = f"{_shorten_value(given)} is wrong ({fault['msg']})", "correct the value"
    # A key missing beside an unknown one is the same fault, not another.
    same = sum(f["type"] == "missing" and f["loc"][:-1] == fault["loc"][:-1] for f in faults)
    more = len(faults) - 1 - (same if fault["type"] == "extra_forbidden" else 0)
    if more > 0:
        remedy += f" ({more} more fault{'s' if more > 1 else ''} in this file)"
    return InputError(where, key, problem, remedy)


def _describe_missing_key(name: str, field: Any) -> str:
    declared = field.json_schema_extra if field is not None else None
    if isinstance(declared, dict) and "unit" in declared:
        return f'add {name} = {{ value = ..., unit = "{declared["unit"]}", source = "measured" }}'
    if field is not None and not field.description:
        return f"add the table [{name}]"
    return f"add {name} ({field.description})" if field is not None else f"add {name}"


def format_toml_value(value: Any) -> str:
    """Return a string, number, truth value or list of them as TOML writes it."""
    if isinstance(value, str):
        return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007F")
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, list | tuple):
        return f"[{', '.join(format_toml_value(v) for v in value)}]"
    return repr(value)


def _shorten_value(given: Any) -> str:
    text = format_toml_value(given) if isinstance(given, str | bool | int | float | list | tuple) else repr(given)
    return text if len(text) <= 60 else text[:57] + "..."


def _dotted_key(loc: tuple[int | str, ...]) -> str:
    """Dotted key with counts from 1: ("waypoint", 0, "position_m") is waypoint[1].position_m."""
    key = ""
    for part in loc:
        key += f"[{part + 1}]" if isinstance(part, int) else f".{part}" if key else part
    return key


def nested_model(annotation: Any) -> type[BaseModel] | None:
    """Return the model in a field's annotation (``M | None``, ``tuple[M, ...]``), or None."""
    for kind in (annotation, *getattr(annotation, "__args__", ())):
        if isinstance(kind, type) and issubclass(kind, BaseModel):
            return kind
    return None


def _model_at(model: type[BaseModel], loc: tuple[int | str, ...]) -> type[BaseModel]:
    for part in loc:
        field = model.model_fields.get(str(part))
        inner = nested_model(field.annotation) if field is not None else None
        model = inner or model
    return model
