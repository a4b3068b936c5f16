"""Tables of text: the logs of other programs, and those that were converted once.

Recognised are comma, semicolon, tab or blanks between the cells; a header line, also behind comments (``#``, ``%``,
``//``) or lines of another width (Blackbox Explorer's keys and values); units in the header (``roll (deg)``, ``T [N]``,
``speed_rpm``) or in a line of their own below it; decimal commas and thousands in groups
(:func:`mufly.input_files.detect_layout`). Cells that are no number are missing values, and counted. A row with fewer
cells than the header is left out and said, since nobody knows which cell is missing; one with more is refused. A text
may be packed by gzip.
"""

from __future__ import annotations

import codecs
import io
import re
import struct
import warnings
import zlib
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from mufly.errors import ArgumentError, InputError
from mufly.input_files import (
    count_cells,
    decode_text,
    detect_layout,
    drop_surplus_cells,
    parse_number,
    points_group_thousands,
    row_width_error,
    split_cells,
    split_lines,
)
from mufly.logs.column_map import TimeEntry
from mufly.logs.raw_log import RawLog, RawTable
from mufly.logs.tables.clock_columns import extract_clock
from mufly.units import normalise_unit, parse_column_unit, split_headers

TABLE_TOPIC = "table"
GZIP_MAGIC = b"\x1f\x8b"
_DAMAGE_KEY = "damage"  # what read_fields says among the facts of a file that is cut
_MIN_TRAILING_ZEROS = 16  # so many zeros behind a text are no text
_COMMENT_MARKS = ("#", "%", "//")
# Up to this share of rows that are short, they are faults; beyond, the header is.
_MAX_SHORT_ROW_SHARE = 0.5
_MAX_PREAMBLE_LINES = 2000
_SAMPLED_ROWS = 50
_MISSING_VALUES = {"", "nan", "na", "n/a", "null", "none", "-", "inf", "-inf", "+inf", "infinity"}


def looks_like_table(head: bytes) -> bool:
    """Whether a file that begins so is text with more than one column or number."""
    wide = head.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE))
    text = decode_text(head) if wide else head.decode("utf-8", errors="ignore").lstrip("\ufeff")
    if "\0" in text or len(text) < (0.4 if wide else 0.9) * len(head) or not text.strip():
        return False
    lines = [s for s in text.splitlines() if s.strip() and not s.lstrip().startswith(_COMMENT_MARKS)]
    return bool(lines) and any(re.search(r"\d", s) for s in lines)


def read_unpacked(path: str | Path, size: int = -1) -> bytes:
    """Return a file's first ``size`` bytes (all by default), unpacked if it was packed by gzip; errors as below."""
    return unpack_table(path, size)[0]


def unpack_table(path: str | Path, size: int = -1) -> tuple[bytes, str]:
    """Return a file's first ``size`` bytes (all by default), unpacked, and in words what is missing of it.

    Of a packed file that was cut the whole lines before the cut are kept; zeros behind text were never written.

    Raises
    ------
    OSError
        If it cannot be read.
    InputError
        If what is packed is damaged.
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
                part = zlib.decompressobj(wbits=31)  # checks the checksum
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
        and data.endswith(bytes(_MIN_TRAILING_ZEROS))
        and (text := data.rstrip(b"\0"))
        and looks_like_table(text)
    ):
        damage = f"the last {len(data) - len(text)} bytes are zero"
        data = text[: text.rfind(b"\n") + 1] or text
    return data, damage


def read_csv(path: str | Path, time: TimeEntry | None = None) -> RawLog:
    """Read a table of text as a log with the one topic ``table``.

    Parameters
    ----------
    path : str or Path
    time : TimeEntry, optional
        Which column is the clock and in which unit, or the rate of the rows. Default: a column called time, t or the
        like, whose unit, if the header names none, is guessed from its step and said.

    Raises
    ------
    InputError
        If it is no table, or its clock cannot be found.
    """
    where = str(path)
    fields, units_of, notes, info = read_table_columns(path)
    clock, start, said = extract_clock(where, fields, units_of, time)
    table = RawTable(TABLE_TOPIC, clock, fields, units_of)
    damage = info.pop(_DAMAGE_KEY, "")
    return RawLog(
        path=where, format_name="CSV", tables_by_topic={TABLE_TOPIC: table}, start_time=start, info=info,
        notes=tuple(n for n in [*notes, *said] if n != damage), is_complete=not damage, damage_text=damage,
    )  # fmt: skip


def read_table_columns(
    path: str | Path, given: Sequence[str] = ()
) -> tuple[dict[str, NDArray[Any]], dict[str, str], list[str], dict[str, Any]]:
    """Read the columns of a table of text, the clock among them.

    Parameters
    ----------
    path : str or Path
    given : sequence of str, optional
        What its columns are called, in place of its header.

    Returns
    -------
    fields : dict of str to (n,) array
        Numbers; text where most cells are none.
    units : dict of str to str
        Of those columns that name one.
    notes : list of str
        What counts as missing.
    info : dict
        Number of columns, separator.

    Raises
    ------
    InputError
        If it is no table, or has not as many columns as names.
    """
    where = str(path)
    data, damage = unpack_table(path)
    text = decode_text(data)
    lines, numbers = split_lines(text)
    first = next((k for k, s in enumerate(lines) if _is_content_line(s)), None)
    if first is None:
        raise InputError(where, "", "holds no rows", "give a table with a header and numbers")
    notes: list[str] = [damage] if damage else []
    info: dict[str, Any] = {_DAMAGE_KEY: damage} if damage else {}
    start = _find_header_line(lines, first)
    if start != first:
        info["preamble"] = _parse_preamble(lines[first:start])
        named = ", ".join(list(info["preamble"])[:3])
        notes.append(f"{start - first} lines before the header are no rows of the table ({named}, ...)")
        first = start
    separator, decimal = detect_layout(lines[first:])
    head = split_cells(lines[first], separator)
    headed = not all(_is_number(c, decimal) for c in head)
    if not headed and first and len(split_cells(lines[first - 1].lstrip("#%/ "), separator)) == len(head):
        head, headed = (
            split_cells(lines[first - 1].lstrip("#%/ "), separator),
            True,
        )  # the header is a comment
        body = first
    else:
        body = first + headed
    names = [" ".join(c.split()) for c in head] if headed else [str(k + 1) for k in range(len(head))]
    row_units: list[str] = []
    if headed and body < len(lines):
        second = split_cells(lines[body], separator)
        if len(second) == len(head) and not any(_is_number(c, decimal) for c in second):
            units = [c.strip("[]() ") if normalise_unit(c.strip("[]() ")) else "" for c in second]
            if sum(bool(u) for u in units) >= max(1, len([c for c in second if c.strip()]) // 2):
                row_units, body = units, body + 1
    if given and len(given) != len(names):
        remedy = "name each"
        if separator == "," and len(names) == 2 * len(given):
            remedy += "; or, if commas are decimal ones, write semicolons between the columns"
        raise ArgumentError("columns", ",".join(given), f"the file has {len(names)} columns", remedy)
    kept = [s for s in lines[body:] if (bare := s.lstrip()) and not bare.startswith(_COMMENT_MARKS)]
    header = lines[first] if body > first else ""
    again = kept.count(header) if header else 0
    if again:
        kept = [s for s in kept if s != header]
        notes.append(f"the header stands again {'once' if again == 1 else f'{again} times'} among the rows")
    widths = count_cells(kept, separator)
    if any(w != len(names) for w in widths):

        def file_line_number(k: int) -> int:
            content = (j for j in range(body, len(lines)) if _is_content_line(lines[j]) and lines[j] != header)
            return int(numbers[next(j for i, j in enumerate(content) if i == k)])

        names, kept, said = _select_fitting_rows(where, names, kept, widths, separator, file_line_number)
        notes += said
    frame = _parse_rows(where, kept, separator, len(names), decimal)
    split, doubtful = split_headers(names)
    if doubtful and not given:
        notes.append(
            f"{', '.join(doubtful)}: read without a unit, since the end of the name does not fit its quantity; "
            "if one is meant, name it in a column map"
        )
    fields: dict[str, NDArray[Any]] = {}
    units_of: dict[str, str] = {}
    for k, (name, unit) in enumerate(split):
        name = (given[k] if given else name) or f"column {k + 1}"
        if name in fields:
            name = f"{name} ({k + 1})"
        values, bad = _to_numbers(frame.iloc[:, k], decimal)
        if bad:
            cells = "1 cell is no number and counts" if bad == 1 else f"{bad} cells are no numbers and count"
            notes.append(f"column {name}: {cells} as missing")
        fields[name] = values
        unit = unit or (parse_column_unit(name, row_units[k]) or "" if row_units and row_units[k] else "")
        if unit:
            units_of[name] = unit
    _set_blackbox_units(info.get("preamble", {}), fields, units_of)
    return fields, units_of, notes, {"columns": len(names), "separator": separator, **info}


def _is_content_line(line: str) -> bool:
    bare = line.lstrip()
    return bool(bare) and not bare.startswith(_COMMENT_MARKS)


def _find_header_line(lines: Sequence[str], first: int) -> int:
    """The line of the header: the first one, or a later one of names that is as wide as the rows at the end."""
    tail = [s for s in lines[-2 * _SAMPLED_ROWS :] if _is_content_line(s)][-_SAMPLED_ROWS:]
    for separator in (";", "\t", ","):
        widths = count_cells(tail, separator)
        usual = max(set(widths), key=widths.count)
        if usual < 3 or widths.count(usual) < 0.7 * len(widths):
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
    """Keys and values before a table; a line of one cell is a key alone."""
    rows = [split_cells(s, "," if "," in s else ";") for s in lines if _is_content_line(s)]
    return {row[0]: ",".join(row[1:]) for row in rows if row}


def _set_blackbox_units(preamble: dict[str, str], fields: dict[str, NDArray[Any]], units: dict[str, str]) -> None:
    """Units of Blackbox Explorer's raw numbers, by the scales that its header names.

    Time is in microseconds; the gyroscope's numbers times ``gyro_scale`` (a float's bits in hexadecimal) are degrees
    per second; those of the accelerometer over ``acc_1G`` are multiples of the earth's acceleration (Betaflight,
    blackbox-log-viewer, src/flightlog.js).
    """
    if "gyro_scale" not in preamble and "acc_1G" not in preamble:
        return
    if "time" in fields:
        units.setdefault("time", "us")
    try:
        bits = int(preamble.get("gyro_scale", "0x3f800000"), 16)
        scales = {
            "gyroADC": (struct.unpack(">f", struct.pack(">I", bits))[0], "deg/s"),
            "accSmooth": (1.0 / float(preamble.get("acc_1G", "nan")), "gee"),
        }
    except (ValueError, struct.error, ZeroDivisionError):
        return
    for name, values in fields.items():
        scale, unit = scales.get(name.partition("[")[0], (np.nan, ""))
        if unit and name not in units and np.isfinite(scale) and values.dtype.kind == "f":
            fields[name], units[name] = values * scale, unit


def _select_fitting_rows(
    where: str, names: list[str], rows: list[str], widths: list[int], separator: str, line_of: Any
) -> tuple[list[str], list[str], list[str]]:
    """Names and rows that fit each other, and what was left out."""
    wanted = len(names)
    rows = [drop_surplus_cells(s, separator, w, wanted) if w > wanted else s for s, w in zip(rows, widths, strict=True)]
    widths = [w if w <= wanted else n for w, n in zip(widths, count_cells(rows, separator), strict=True)]
    filled = max((k + 1 for k, name in enumerate(names) if name), default=wanted)
    if filled < wanted and all(w == filled for w in widths):
        return names[:filled], rows, []  # the header alone ends with a separator
    long = [k for k, w in enumerate(widths) if w > wanted]
    short = [k for k, w in enumerate(widths) if w < wanted]
    if long or len(short) > _MAX_SHORT_ROW_SHARE * len(rows):
        bad = long or short
        raise row_width_error(where, line_of(bad[0]), widths[bad[0]], wanted, len(bad) - 1)
    if not short:
        return names, rows, []
    gone = set(short)
    if len(short) == 1:
        what = f"line {line_of(short[0])} has {widths[short[0]]} cells, the header {wanted}, and is left out"
        what += ": the last, cut short" if short[0] == len(rows) - 1 else ""
    else:
        what = (
            f"{len(short)} rows have fewer cells than the header's {wanted} and are left out, the first in line "
            f"{line_of(short[0])}, the last in line {line_of(short[-1])}"
        )
    return names, [s for k, s in enumerate(rows) if k not in gone], [what]


def _is_number(cell: str, decimal: str) -> bool:
    return cell.lower() in _MISSING_VALUES or not np.isnan(parse_number(cell, decimal))


def _parse_rows(where: str, rows: list[str], separator: str, width: int, decimal: str) -> Any:
    """Cells of the rows: numbers at once where a column's samples are plain ones, else text.

    Both conversions bring back the float64 that was written.
    """
    if not rows:
        raise InputError(where, "", "has a header but no rows", "give a table with numbers")
    stream = "\n".join(rows)
    sampled = [split_cells(s, separator) for s in rows[:: 1 + len(rows) // _SAMPLED_ROWS]]
    plain = [decimal == "." and all(_is_plain_number(row[k]) for row in sampled if k < len(row)) for k in range(width)]
    try:
        return _parse_csv_cells(stream, separator, {k: np.float64 if p else str for k, p in enumerate(plain)})
    except (pd.errors.ParserError, pd.errors.ParserWarning, ValueError, OverflowError):
        pass  # a cell is no plain number
    try:
        return _parse_csv_cells(stream, separator, dict.fromkeys(range(width), str))
    except (pd.errors.ParserError, pd.errors.ParserWarning, ValueError) as error:
        reason = " ".join(str(error).split()).removeprefix("Error tokenizing data. C error: ").partition(". ")[0]
        problem = f"is no table ({reason})"
        raise InputError(where, "", problem, "give every row as many cells as the header") from error


def _is_plain_number(cell: str) -> bool:
    try:
        float(cell or "nan")
    except ValueError:
        return False
    return True


# From version 3.1 on pandas converts exactly by default.
_EXACT_FLOAT_OPTIONS: Any = (
    {} if tuple(map(int, pd.__version__.split(".")[:2])) >= (3, 1) else {"float_precision": "round_trip"}
)


def _parse_csv_cells(stream: str, separator: str, types: dict[int, type]) -> Any:
    with warnings.catch_warnings():
        warnings.simplefilter("error", pd.errors.ParserWarning)  # of cells beyond the header's
        return pd.read_csv(
            io.StringIO(stream),
            sep=r"\s+" if separator == " " else separator,
            header=None,
            names=list(types),
            dtype=types,
            **_EXACT_FLOAT_OPTIONS,
            index_col=False,
            skipinitialspace=True,
            on_bad_lines="error",
        )


def _to_numbers(series: Any, decimal: str) -> tuple[NDArray[Any], int]:
    """Numbers of a column and how many cells are none; text where most cells are."""
    if series.dtype == np.float64:
        return series.to_numpy(), 0
    cells = series.fillna("").astype(object).to_numpy()
    points = [str(c).strip() for c in cells if decimal == "," and "." in str(c)]
    if not points or not points_group_thousands(points, decimal):
        try:
            return cells.astype(np.float64), 0
        except ValueError:
            pass
    texts = [str(c).strip() for c in cells]
    numbers = np.array([parse_number(t, decimal) for t in texts])
    filled = np.array([t.lower() not in _MISSING_VALUES for t in texts])
    bad = int((filled & np.isnan(numbers)).sum())
    if bad > 0.5 * filled.sum():
        return np.array(texts, dtype=str), 0
    return numbers, bad
