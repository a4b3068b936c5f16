"""Reader of text tables: logs, bench files, blades, polars, trajectories and data sets.

The reader recognises:

- comma, semicolon, tab or blanks as separators, decimal commas and grouped thousands
  (:func:`detect_separator_and_decimal_mark`);
- a header line, also after comments (``#``, ``%``, ``//``) or lines of another width (Blackbox Explorer's keys);
- a line of units below the header;
- UTF-8, UTF-16, Windows-1252 and gzip.

A repeated header among the rows is skipped. A row with more cells than the header is an error, because the surplus
cell is unknown. A row with fewer cells is an error or skipped, as selected by the caller.

:meth:`TextTable.read_numbers` reads strict tables; its error names line, column and cell of the first fault.
:meth:`TextTable.parse_columns` reads logs; cells that are no number count as missing values.
"""

from __future__ import annotations

import codecs
import csv
import io
import math
import re
import warnings
import zlib
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from operator import methodcaller
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from mufly.errors import InputError
from mufly.quantities.units import normalise_unit

GZIP_MAGIC = b"\x1f\x8b"
_COMMENT_MARKS = ("#", "%", "//")
# A quoted cell that continues in the next line; a single quote inside a cell (3" propeller) is no opening quote.
_OPEN_QUOTE_PATTERN = re.compile(r'(?:^|[,;\t])\s*"(?:[^"]|"")*$')
_MAX_CELL_LINES = 100  # lines
_CELL_WITH_UNIT_PATTERN = re.compile(r"[^\s(\[]+(?:\s*[(\[][^)\]]*[)\]])?|[(\[][^)\]]*[)\]]?")
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
_MIN_TRAILING_ZERO_BYTES = 16  # at least this number of trailing zero bytes is no text
# Up to this fraction of short rows the rows are faulty; above it the header is.
_MAX_SHORT_ROW_FRACTION = 0.5
_MAX_PREAMBLE_LINES = 2000
_SAMPLED_ROW_COUNT = 50
_MIN_EQUAL_WIDTH_ROW_FRACTION = 0.65  # of the rows below a table's first line
_MISSING_VALUES = {"", "nan", "na", "n/a", "null", "none", "-", "inf", "-inf", "+inf", "infinity"}


@dataclass(frozen=True, eq=False)
class TextTable:
    """Text table as written: header, rows, and notes on omitted parts.

    Attributes
    ----------
    where : str
        Name of the file in errors.
    header : list of str
        Names of the columns; ``"1"``, ``"2"``, ... for a file without header.
    units : list of str
        Units from a line below the header, ``""`` for columns without; empty without such a line.
    rows : list of str
        Rows as written, each with as many cells as the header.
    lines : sequence of int
        Line of the file at which each row begins.
    separator, decimal : str
        Separator of cells, and decimal mark of numbers.
    notes : list of str
        Notes on omitted parts.
    preamble : dict of str to str
        Keys and values above the header.
    damage : str
        Description of missing parts of the file; ``""`` if complete.
    cut_line : int
        Number of the last line, if it is incomplete and skipped; else 0.
    """

    where: str
    header: list[str]
    units: list[str]
    rows: list[str]
    lines: Sequence[int]
    separator: str
    decimal: str
    notes: list[str]
    preamble: dict[str, str]
    damage: str
    cut_line: int

    @cached_property
    def cells(self) -> list[list[str]]:
        """Cells of each row without surrounding blanks."""
        return [split_cells(row, self.separator) for row in self.rows]

    @property
    def column_titles(self) -> list[str]:
        """Column names, each with its unit if the file has a line of units: ``"thrust (N)"``."""
        units = self.units or [""] * len(self.header)
        return [f"{name} ({unit})" if unit else name for name, unit in zip(self.header, units, strict=True)]

    def find_column_index(self, name: str, remedy: str = "") -> int:
        """Return the index of a column; without ``remedy`` an error lists the existing columns.

        Raises
        ------
        InputError
            If there is no such column.
        """
        if name not in self.header:
            known = remedy or f"the header is {', '.join(self.header)}"
            raise InputError(self.where, name, "is not among the columns", known)
        return self.header.index(name)

    def read_texts(self, column: int) -> list[str]:
        """Return the cells of a column, with numbers in Python's notation."""
        cells = [row[column] for row in self.cells]
        decimal = self.decimal if is_point_thousands_separator(cells, self.decimal) else "."
        return [normalise_number(cell, decimal) for cell in cells]

    def read_numbers(self, column: int, *, optional: bool = False) -> NDArray[np.float64]:
        """Return the finite numbers of a column, (rows,); where ``optional``, NaN for cells that are empty or ``nan``.

        Raises
        ------
        InputError
            Naming line, column and cell of the first that is no finite number.
        """
        values = np.full(len(self.rows), math.nan)
        for k, cell in enumerate(self.read_texts(column)):
            if not optional or cell.lower() not in ("", "nan"):
                values[k] = self.parse_finite_cell(k, column, cell)
        return values

    def read_matrix(self, width: int | None = None) -> NDArray[np.float64]:
        """Return the finite numbers of all columns, or of the first ``width``, (rows, columns).

        Raises
        ------
        InputError
            Naming line, column and cell of the first that is no finite number, or if there are fewer columns.
        """
        if width is not None and len(self.header) < width:
            problem = f"has {len(self.header)} column{'' if len(self.header) == 1 else 's'}"
            raise InputError(self.where, "", problem, f"give {width}")
        return np.column_stack([self.read_numbers(k) for k in range(width or len(self.header))])

    def parse_finite_cell(self, row: int, column: int, cell: str) -> float:
        """Return the text ``cell`` as a finite number; ``row`` and ``column`` name its place in errors.

        Raises
        ------
        InputError
            Naming line, column and cell, if it is no finite number.
        """
        name = self.header[column]
        place = f"line {self.lines[row]}, {f'column {name}' if name.isdigit() else name}"
        try:
            value = float(cell)
        except ValueError:
            raise InputError(self.where, place, f"{cell!r} is not a number", "give one") from None
        if not math.isfinite(value):
            raise InputError(self.where, place, f"is {value:g}", "give a finite number or leave it empty")
        return value

    def parse_columns(self) -> list[tuple[NDArray[Any], int]]:
        """Return the values of each column, (rows,), and the number of missing values, which are cells without a
        number.

        A column with mostly non-numeric cells is text. Numbers are exact float64 conversions.

        Raises
        ------
        InputError
            If there are no rows.
        """
        import pandas as pd  # import takes 0.5 s and is not needed for small tables

        if not self.rows:
            raise InputError(self.where, "", "has a header but no rows", "give a table with numbers")
        stream, width = "\n".join(self.rows), len(self.header)
        sampled = [split_cells(s, self.separator) for s in self.rows[:: 1 + len(self.rows) // _SAMPLED_ROW_COUNT]]
        plain = [self.decimal == "." and all(_is_plain_number(row[k]) for row in sampled) for k in range(width)]
        faults = (pd.errors.ParserError, pd.errors.ParserWarning, ValueError, OverflowError)
        try:
            frame = _parse_csv_cells(stream, self.separator, [np.float64 if p else str for p in plain])
        except faults:  # a cell is no plain number
            try:
                frame = _parse_csv_cells(stream, self.separator, [str] * width)
            except faults as error:
                reason = " ".join(str(error).split()).removeprefix("Error tokenizing data. C error: ")
                problem = f"is not a table ({reason.partition('. ')[0]})"
                raise InputError(self.where, "", problem, "give every row as many cells as the header") from error
        return [_to_numbers(frame.iloc[:, k], self.decimal) for k in range(width)]


def read_text_table(path: str | Path, *, short_rows: Literal["refuse", "cut", "drop"] = "refuse") -> TextTable:
    """Read a table of text.

    Parameters
    ----------
    path : str or Path
    short_rows : {"refuse", "cut", "drop"}
        Treatment of rows with fewer cells than the header: raise an error; skip the last row only, as in a file
        that is being written; or skip all of them, up to half of the rows.

    Returns
    -------
    TextTable
        Table, without rows if the file has only a header.

    Raises
    ------
    InputError
        If the file cannot be read, is no text, has no line, or a row does not fit the header.
    """
    where = str(path)
    try:
        data, damage = read_decompressed(path)
    except OSError as error:
        raise InputError(where, "", f"cannot be read ({error.strerror})", "give a text file") from error
    text = decode_text(data)
    if "\0" in text:
        raise InputError(where, "", "is not text", "save it as CSV, in UTF-8")
    lines, numbers = split_lines(text)
    first = next((k for k, s in enumerate(lines) if _is_content_line(s)), None)
    if first is None:
        raise InputError(where, "", "is empty", "give a header and at least one line")
    notes, preamble = [damage] if damage else [], {}
    start = _find_header_line(lines, first)
    if start != first:
        preamble = _parse_preamble(lines[first:start])
        named = ", ".join(list(preamble)[:3])
        notes.append(f"{start - first} lines before the header are no rows of the table ({named}, ...)")
    above, lines, numbers = lines[max(start - 1, 0) : start], lines[start:], numbers[start:]
    rows = [s for s in lines if (bare := s.lstrip()) and not bare.startswith(_COMMENT_MARKS)]
    if len(rows) < len(lines):
        numbers = [n for s, n in zip(lines, numbers, strict=True) if _is_content_line(s)]
    separator, decimal = detect_separator_and_decimal_mark(rows)
    if separator == " " and _has_title_line(rows, decimal):
        notes.append(f"line {numbers[0]} is a title ({' '.join(rows[0].split())})")
        rows, numbers = rows[1:], numbers[1:]
    header, units = split_cells(rows[0], separator), list[str]()
    if not _is_plain_number(header[0] or "-") and not all(_is_number(c, decimal) for c in header):
        units = _find_units_below_header(rows[1:2], len(header), separator, decimal)
        head, rows, numbers = rows[0], rows[1 + bool(units) :], numbers[1 + bool(units) :]
        again = rows.count(head)
        if again:
            numbers = [n for s, n in zip(rows, numbers, strict=True) if s != head]
            rows = [s for s in rows if s != head]
            notes.append(f"the header stands again {'once' if again == 1 else f'{again} times'} among the rows")
    else:  # the header may be a comment, or missing
        comment = split_cells(above[0].lstrip("#%/ "), separator) if above else []
        header = comment if len(comment) == len(header) else [str(k + 1) for k in range(len(header))]
    header = [" ".join(c.split()) for c in header]
    table = TextTable(where, header, units, rows, numbers, separator, decimal, notes, preamble, damage, 0)
    widths = count_cells(rows, separator)
    return table if all(w == len(header) for w in widths) else _drop_misfit_rows(table, widths, short_rows)


def decode_text(raw: bytes) -> str:
    """Decode a file's bytes: UTF-16 or UTF-8 by byte order mark, else UTF-8, else Windows-1252.

    A spreadsheet's separator line (``sep=;``) is removed.
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
    """Return the cells of a line; with blanks as separator a unit in brackets stays with its name."""
    if separator == " ":
        plain = "(" not in line and "[" not in line
        return line.split() if plain else [c.strip() for c in _CELL_WITH_UNIT_PATTERN.findall(line)]
    if '"' not in line:
        return [c.strip() for c in line.split(separator)] if line else []
    try:
        return [c.strip() for c in next(csv.reader([line], delimiter=separator, skipinitialspace=True), [])]
    except csv.Error:  # a line break of another system outside quotes, a cell of more than 128 kB
        return [c.strip() for c in line.split(separator)]


def split_lines(text: str) -> tuple[list[str], Sequence[int]]:
    """Return the rows of a text and the line at which each begins; quoted cells may contain line breaks."""
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
    """Return the number of cells of each row of a text."""
    if separator != " " and not any('"' in row for row in rows):
        return [n + 1 for n in map(methodcaller("count", separator), rows)]
    return [len(split_cells(row, separator)) for row in rows]


def drop_empty_trailing_cells(row: str, separator: str, width: int, wanted: int) -> str:
    """Return a row without the empty cells that some loggers append to it."""
    while width > wanted and row.rstrip(" ").endswith(separator):
        row, width = row.rstrip(" ")[: -len(separator)], width - 1
    return row


def row_width_error(where: str, line: int, width: int, wanted: int, others: int = 0) -> InputError:
    """Return the error about a row with more or fewer cells than the header."""
    more = f" (and {others} more rows)" if others else ""
    problem = f"has {width} cell{'' if width == 1 else 's'}, the header {wanted}{more}"
    return InputError(where, f"line {line}", problem, "give every row as many cells as the header")


def normalise_number(cell: str, decimal: str) -> str:
    """Return a cell's number in Python's notation: no thousands separators, a decimal point, e for Fortran's D.

    Other cells are unchanged.
    """
    if decimal == "." and _is_plain_number(cell):
        return cell
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


def is_point_thousands_separator(cells: Sequence[str], decimal: str) -> bool:
    """Return True if points in a column group thousands (1.234 and 987), false if they are decimal (0.123)."""
    points = [c for c in cells if decimal == "," and "." in c]
    return not points or all(_GROUPED_NUMBER_PATTERNS[","].fullmatch(c) for c in points)


def detect_separator_and_decimal_mark(lines: Sequence[str]) -> tuple[str, str]:
    """Return the separator of cells in a text, and the decimal mark of its numbers.

    Semicolons and tabs have priority, and blanks precede commas if they separate numbers with decimal commas. A comma
    is the decimal mark if a number is valid only with it (0,5; 1.234,5). If all commas could group thousands (1,234),
    the comma is the decimal mark, too, unless a number with a point excludes it.
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
    """Return the separator that splits these lines into equally many columns."""
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


def is_text_with_digits(head: bytes) -> bool:
    """Return True if the beginning of a file is text with a digit in a line that is no comment."""
    wide = head.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE))
    text = decode_text(head) if wide else head.decode("utf-8", errors="ignore").lstrip("\ufeff")
    if "\0" in text or len(text) < (0.4 if wide else 0.9) * len(head) or not text.strip():
        return False
    lines = [s for s in text.splitlines() if s.strip() and not s.lstrip().startswith(_COMMENT_MARKS)]
    return bool(lines) and any(re.search(r"\d", s) for s in lines)


def read_decompressed(path: str | Path, size: int = -1) -> tuple[bytes, str]:
    """Return a file's first ``size`` bytes (all by default), decompressed, and a text about missing parts.

    For a truncated compressed file the complete lines are kept; trailing zero bytes count as missing.

    Raises
    ------
    OSError
        If the file cannot be read.
    InputError
        If the compressed data is damaged.
    """
    with open(path, "rb") as stream:
        packed = stream.read(2) == GZIP_MAGIC
        stream.seek(0)
        data = stream.read() if packed else stream.read(size)
    damage = ""
    if packed:
        whole, out = len(data), b""
        try:
            while data and not damage:
                part = zlib.decompressobj(wbits=31)  # verifies the checksum
                out += part.decompress(data, max(0, size - len(out)) if size > 0 else 0)
                if 0 < size <= len(out):
                    return out[:size], ""
                if not part.eof:
                    out = out[: out.rfind(b"\n") + 1]
                    damage = f"it ends inside what gzip packed, and {len(out)} bytes could be unpacked"
                data = part.unused_data
                if data and not data.startswith(GZIP_MAGIC):
                    damage, data = f"{len(data)} of {whole} bytes behind what gzip packed are none of it", b""
        except zlib.error as error:
            raise InputError(str(path), "", f"is a damaged gzip file ({error})", "give another copy") from error
        data = out
    if (
        size < 0
        and data.endswith(bytes(_MIN_TRAILING_ZERO_BYTES))
        and (text := data.rstrip(b"\0"))
        and is_text_with_digits(text)
    ):
        damage = f"the last {len(data) - len(text)} bytes are zero"
        data = text[: text.rfind(b"\n") + 1] or text
    return data, damage


def _is_content_line(line: str) -> bool:
    bare = line.lstrip()
    return bool(bare) and not bare.startswith(_COMMENT_MARKS)


def _find_header_line(lines: Sequence[str], first: int) -> int:
    """Return the index of the header line: the first line, or a later line of names with as many cells as the last
    rows.
    """
    tail = [s for s in lines[first + 1 :][-2 * _SAMPLED_ROW_COUNT :] if _is_content_line(s)][-_SAMPLED_ROW_COUNT:]
    if not tail:
        return first
    for separator in (";", "\t", ","):
        widths = count_cells(tail, separator)
        usual = max(set(widths), key=widths.count)
        if usual < 2 or widths.count(usual) < _MIN_EQUAL_WIDTH_ROW_FRACTION * len(widths):
            continue
        if count_cells([lines[first]], separator)[0] >= usual:
            return first
        content = [k for k in range(first, min(first + _MAX_PREAMBLE_LINES, len(lines))) if _is_content_line(lines[k])]
        wide = count_cells([lines[k] for k in content], separator)
        at = next((i for i, w in enumerate(wide) if w >= usual), None)
        if at is None or wide[at] != usual or at + 1 >= len(wide) or wide[at + 1] != usual:
            return first
        numeric = [_is_number(c, ".") or _is_number(c, ",") for c in split_cells(lines[content[at]], separator)]
        return first if any(numeric) else content[at]
    return first


def _parse_preamble(lines: Sequence[str]) -> dict[str, str]:
    """Return the keys and values in the lines above a table; a line with one cell is a key without value."""
    rows = [split_cells(s, "," if "," in s else ";") for s in lines if _is_content_line(s)]
    return {row[0]: ",".join(row[1:]) for row in rows if row}


def _has_title_line(rows: Sequence[str], decimal: str) -> bool:
    """Return True if the first line is a title above the header: the second line holds names, not units, and the rows
    below are numbers, as many as those names."""
    names, below = split_cells(rows[1], " ") if len(rows) > 2 else [], rows[2 : 2 + _SAMPLED_ROW_COUNT]
    if len(names) < 2 or any(_is_number(c, decimal) for c in names):
        return False
    title = split_cells(rows[0], " ")
    if all(_is_number(c, decimal) for c in title):
        return False
    units = sum(bool(normalise_unit(c.strip("[]()-. "))) for c in names)
    words = len(title) == len(names) and not any(c.isdigit() for c in rows[0])
    if units * (2 if words else 1) >= len(names):
        return False
    cells = [split_cells(row, " ") for row in below]
    return all(len(row) == len(names) and all(_is_number(c, decimal) for c in row) for row in cells)


def _find_units_below_header(rows: Sequence[str], width: int, separator: str, decimal: str) -> list[str]:
    """Return the units in the line below a header; empty if this line holds no units."""
    cells = split_cells(rows[0], separator) if rows else []
    if len(cells) != width or any(_is_number(c, decimal) for c in cells):
        return []
    units = [c.strip("[]() ") if normalise_unit(c.strip("[]() ")) else "" for c in cells]
    return units if sum(map(bool, units)) >= max(1, sum(map(bool, cells)) // 2) else []


def _drop_misfit_rows(table: TextTable, widths: list[int], short_rows: str) -> TextTable:
    """Return the table with rows as wide as the header, and notes on omitted rows."""
    wanted, separator, lines = len(table.header), table.separator, table.lines
    rows = [
        drop_empty_trailing_cells(s, separator, w, wanted) if w > wanted else s
        for s, w in zip(table.rows, widths, strict=True)
    ]
    widths = [w if w <= wanted else n for w, n in zip(widths, count_cells(rows, separator), strict=True)]
    filled = max((k + 1 for k, name in enumerate(table.header) if name), default=wanted)
    if filled < wanted and all(w == filled for w in widths):  # only the header ends with a separator
        return replace(table, header=table.header[:filled], units=table.units[:filled], rows=rows)
    long = [k for k, w in enumerate(widths) if w > wanted]
    short = [k for k, w in enumerate(widths) if w < wanted]
    cut = len(rows) > 1 and short == [len(rows) - 1]
    allowed = {"refuse": 0.0, "cut": float(cut), "drop": _MAX_SHORT_ROW_FRACTION * len(rows)}[short_rows]
    if long or len(short) > allowed:
        bad = long or short
        raise row_width_error(table.where, lines[bad[0]], widths[bad[0]], wanted, len(bad) - 1)
    if not short:
        return replace(table, rows=rows)
    first, last = lines[short[0]], lines[short[-1]]
    what = (
        f"line {first} has {widths[short[0]]} cells, the header {wanted}; the line is skipped"
        + (", because the file ends in it" if cut else "")
        if len(short) == 1
        else f"{len(short)} rows have fewer cells than the header's {wanted} and are skipped, the first in line "
        f"{first}, the last in line {last}"
    )
    keep = [k for k, w in enumerate(widths) if w == wanted]
    return replace(
        table, rows=[rows[k] for k in keep], lines=[lines[k] for k in keep], notes=[*table.notes, what],
        cut_line=first if cut else 0,
    )  # fmt: skip


def _is_number(cell: str, decimal: str) -> bool:
    return cell.lower() in _MISSING_VALUES or not np.isnan(parse_number(cell, decimal))


def _is_plain_number(cell: str) -> bool:
    try:
        float(cell or "nan")
    except ValueError:
        return False
    return True


def _parse_csv_cells(stream: str, separator: str, types: Sequence[type]) -> Any:
    import pandas as pd

    # pandas converts exactly by default since version 3.1.
    exact: Any = {} if tuple(map(int, pd.__version__.split(".")[:2])) >= (3, 1) else {"float_precision": "round_trip"}
    with warnings.catch_warnings():
        warnings.simplefilter("error", pd.errors.ParserWarning)  # about cells beyond the header
        return pd.read_csv(
            io.StringIO(stream),
            sep=r"\s+" if separator == " " else separator,
            header=None,
            names=list(range(len(types))),
            dtype=dict(enumerate(types)),
            **exact,
            index_col=False,
            skipinitialspace=True,
            on_bad_lines="error",
        )


def _to_numbers(series: Any, decimal: str) -> tuple[NDArray[Any], int]:
    """Return a column as numbers, and the count of cells without a number; as text if most cells are no number."""
    if series.dtype == np.float64:
        return series.to_numpy(), 0
    cells = series.fillna("").astype(object).to_numpy()
    points = [str(c).strip() for c in cells if decimal == "," and "." in str(c)]
    if not points or not is_point_thousands_separator(points, decimal):
        plain = cells if points or decimal == "." else np.array([str(c).replace(",", ".") for c in cells], dtype=object)
        try:
            return plain.astype(np.float64), 0
        except ValueError:
            pass
    texts = [str(c).strip() for c in cells]
    numbers = np.array([parse_number(t, decimal) for t in texts])
    filled = np.array([t.lower() not in _MISSING_VALUES for t in texts])
    bad = int((filled & np.isnan(numbers)).sum())
    if bad > 0.5 * filled.sum():
        return np.array(texts, dtype=str), 0
    return numbers, bad
