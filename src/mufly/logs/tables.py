"""Tables in files of other programs, and logs that were converted once: CSV, Parquet, NetCDF.

Of a table of text is recognised: comma, semicolon, tab or blanks between the cells; a header line, also behind
comments (``#``, ``%``, ``//``); units in the header (``roll (deg)``, ``T [N]``, ``speed_rpm``) or in a line of their
own below it; decimal commas and thousands in groups (:func:`mufly.tables.layout_of`); times as numbers or as ISO 8601.
Cells that are no number are missing values, and counted. A Parquet file is such a table too; NetCDF (version 3) needs a
dimension ``time``. What ``mufly log convert`` wrote comes back as it was. A table of text may be packed by gzip.
"""

from __future__ import annotations

import codecs
import gzip
import io
import json
import re
import warnings
import zlib
from collections.abc import Sequence
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pandas as pd
import xarray as xr
from numpy.typing import NDArray

from mufly.errors import ArgumentError, InputError
from mufly.logs.mapping import TimeEntry
from mufly.logs.mcap import columns_of, describe, plain, restore
from mufly.logs.topics import RawLog, RawTable, foreign_stamps
from mufly.tables import cells_of, counts_thousands, decoded, layout_of, number_of
from mufly.units import conversion, known_unit, split_header

TOPIC = "table"
GZIP_MAGIC = b"\x1f\x8b"
_COMMENTS = ("#", "%", "//")
_TIME = re.compile(
    r"^(time|t|timestamp|zeit|time_?stamp|timeus|timems|time_?boot|seconds|utc|date_?time)$", re.IGNORECASE
)
_MISSING = {"", "nan", "na", "n/a", "null", "none", "-", "inf", "-inf", "+inf", "infinity"}


def looks_like_table(head: bytes) -> bool:
    """Whether a file that begins so is text with more than one column or number."""
    wide = head.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE))
    text = decoded(head) if wide else head.decode("utf-8", errors="ignore").lstrip("\ufeff")
    if "\0" in text or len(text) < (0.4 if wide else 0.9) * len(head) or not text.strip():
        return False
    lines = [s for s in text.splitlines() if s.strip() and not s.lstrip().startswith(_COMMENTS)]
    return bool(lines) and any(re.search(r"\d", s) for s in lines)


def unpacked(path: str | Path, size: int = -1) -> bytes:
    """Return a file's first ``size`` bytes (all by default), unpacked if it was packed by gzip.

    Raises
    ------
    OSError
        If it cannot be read.
    InputError
        If what is packed is damaged.
    """
    with open(path, "rb") as stream:
        if stream.read(2) != GZIP_MAGIC:
            stream.seek(0)
            return stream.read(size)
    try:
        with gzip.open(path, "rb") as packed:
            return packed.read(size)
    except (EOFError, gzip.BadGzipFile, zlib.error) as error:
        raise InputError(str(path), "", f"is a damaged gzip file ({error})", "give another copy") from error


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
    fields, units_of, notes, info = read_fields(path)
    clock, start, said = table_clock(where, fields, units_of, time)
    table = RawTable(TOPIC, clock, fields, units_of)
    return RawLog(
        path=where, kind="CSV", tables={TOPIC: table}, start_time=start, notes=tuple(notes + said), info=info
    )


def read_fields(
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
    lines = decoded(unpacked(path)).splitlines()
    first = next((k for k, s in enumerate(lines) if s.strip() and not s.lstrip().startswith(_COMMENTS)), None)
    if first is None:
        raise InputError(where, "", "holds no rows", "give a table with a header and numbers")
    separator, decimal = layout_of(lines[first:])
    head = cells_of(lines[first], separator)
    headed = not all(_is_number(c, decimal) for c in head)
    if not headed and first and len(cells_of(lines[first - 1].lstrip("#%/ "), separator)) == len(head):
        head, headed = cells_of(lines[first - 1].lstrip("#%/ "), separator), True  # the header is a comment
        body = first
    else:
        body = first + headed
    names = head if headed else [str(k + 1) for k in range(len(head))]
    row_units: list[str] = []
    if headed and body < len(lines):
        second = cells_of(lines[body], separator)
        if len(second) == len(head) and not any(_is_number(c, decimal) for c in second):
            units = [known_unit(c.strip("[]() ")) for c in second]
            if sum(bool(u) for u in units) >= max(1, len([c for c in second if c.strip()]) // 2):
                row_units, body = units, body + 1
    kept = [s for s in lines[body:] if s.strip() and not s.lstrip().startswith(_COMMENTS)]
    if separator != " " and all(
        len(cells_of(s, separator)) > len(names) and s.endswith(separator) for s in kept
    ):
        kept = [s.removesuffix(separator) for s in kept]  # some loggers end every row with one
    if given and len(given) != len(names):
        remedy = "name each"
        if separator == "," and len(names) == 2 * len(given):
            remedy += "; or, if commas are decimal ones, write semicolons between the columns"
        raise ArgumentError("columns", ",".join(given), f"the file has {len(names)} columns", remedy)
    frame = _parse(where, "\n".join(kept), separator, len(names))
    names = names[: frame.shape[1]] if len(names) > frame.shape[1] else names
    fields: dict[str, NDArray[Any]] = {}
    units_of: dict[str, str] = {}
    notes: list[str] = []
    for k, header in enumerate(names):
        name, unit = split_header(header)
        name = (given[k] if given else name) or f"column {k + 1}"
        if name in fields:
            name = f"{name} ({k + 1})"
        values, bad = _column(frame.iloc[:, k], decimal)
        if bad:
            cells = "1 cell is no number and counts" if bad == 1 else f"{bad} cells are no numbers and count"
            notes.append(f"column {name}: {cells} as missing")
        fields[name] = values
        if unit or (row_units and row_units[k]):
            units_of[name] = unit or row_units[k]
    return fields, units_of, notes, {"columns": len(names), "separator": separator}


def _is_number(cell: str, decimal: str) -> bool:
    return cell.lower() in _MISSING or not np.isnan(number_of(cell, decimal))


def _parse(where: str, body: str, separator: str, width: int) -> Any:
    if not body.strip():
        raise InputError(where, "", "has a header but no rows", "give a table with numbers")
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error", pd.errors.ParserWarning)  # of cells beyond the header's
            return pd.read_csv(
                io.StringIO(body),
                sep=r"\s+" if separator == " " else separator,
                header=None,
                names=range(width),
                dtype=str,
                index_col=False,
                skipinitialspace=True,
                on_bad_lines="error",
            )
    except (pd.errors.ParserError, pd.errors.ParserWarning, ValueError) as error:
        reason = (
            " ".join(str(error).split()).removeprefix("Error tokenizing data. C error: ").partition(". ")[0]
        )
        problem = f"is no table ({reason})"
        raise InputError(where, "", problem, "give every row as many cells as the header") from error


def _column(series: Any, decimal: str) -> tuple[NDArray[Any], int]:
    """Numbers of a column and how many cells are none; text where most cells are.

    Python's own conversion is exact; that of pandas is not in every version.
    """
    cells = series.fillna("").astype(object).to_numpy()
    points = [str(c).strip() for c in cells if decimal == "," and "." in str(c)]
    if not points or not counts_thousands(points, decimal):
        try:
            return cells.astype(np.float64), 0
        except ValueError:
            pass
    texts = [str(c).strip() for c in cells]
    numbers = np.array([number_of(t, decimal) for t in texts])
    filled = np.array([t.lower() not in _MISSING for t in texts])
    bad = int((filled & np.isnan(numbers)).sum())
    if bad > 0.5 * filled.sum():
        return np.array(texts, dtype=str), 0
    return numbers, bad


def table_clock(
    where: str, fields: dict[str, NDArray[Any]], units: dict[str, str], entry: TimeEntry | None = None
) -> tuple[NDArray[np.float64], str, list[str]]:
    """Take the clock out of a table's columns.

    Parameters
    ----------
    where : str
        What an error calls the file.
    fields : dict of str to (n,) array
        Columns; that of the time is removed.
    units : dict of str to str
        Units of the columns; that of the time is removed.
    entry : TimeEntry, optional
        As for :func:`read_csv`.

    Returns
    -------
    time : (n,) array
        s.
    start : str
        Wall time of the instant 0 (ISO 8601), "" if the column does not tell.
    words : list of str
        What was guessed.

    Raises
    ------
    InputError
        If there is no such column, or none that looks like a clock.
    """
    entry = entry or TimeEntry(column=None, unit=None, rate_hz=None)
    n = len(next(iter(fields.values())))
    if entry.rate_hz is not None:
        return np.arange(n) / entry.rate_hz, "", []
    if entry.column is not None:
        wanted = entry.column if entry.column in fields else split_header(entry.column)[0]
        if wanted not in fields:
            raise InputError(where, entry.column, "is no column", f"columns are: {', '.join(fields)}")
        name = wanted
    else:
        found = [c for c in fields if _TIME.match(c) and _is_time_unit(units.get(c, ""))]
        if not found:
            remedy = "name it (time=COLUMN, or [time] column in a map), or give [time] rate_hz"
            raise InputError(where, "", f"has no column for the time among: {_few(fields)}", remedy)
        name = found[0]
    values = fields.pop(name)
    unit = entry.unit or units.pop(name, "") or {"timeus": "us", "timems": "ms"}.get(name.lower(), "")
    if values.dtype.kind == "U":
        stamps = pd.to_datetime(pd.Series(values), errors="coerce", utc=True, format="ISO8601")
        if stamps.isna().mean() > 0.5:
            raise InputError(where, name, f"{str(values[0])!r} is no time", "give seconds, or ISO 8601")
        ns = stamps.to_numpy(dtype="datetime64[ns]").astype(np.int64)
        valid = ~stamps.isna().to_numpy()
        foreign, strange = foreign_stamps({f"column {name}": np.where(valid, ns / 1e9, np.nan)})
        valid &= ~foreign[f"column {name}"]
        zero = ns[valid].min()
        time = np.where(valid, (ns - zero) / 1e9, np.nan)
        return time, f"{pd.Timestamp(zero, tz='UTC').isoformat(timespec='milliseconds')}", strange
    said: list[str] = []
    if not unit:
        unit, why = _guess_time_unit(values)
        if why:
            said.append(f"column {name} names no unit: {why}")
    if not _is_time_unit(unit):
        raise InputError(where, name, f"{unit!r} is no unit of time", "use s, ms, us, ns, min or h")
    _, factor, _ = conversion(unit, "s")
    # A thousandth of a second written as 0.001 is not 1 times 0.001 in every case; dividing is exact more often.
    whole = round(1 / factor)
    time = values / whole if whole > 1 and abs(whole * factor - 1) < 1e-12 else values * factor
    foreign, strange = foreign_stamps({f"column {name}": time})
    said += strange
    time, values = (np.where(foreign[f"column {name}"], np.nan, v) for v in (time, values))
    start = ""
    if np.isfinite(time).any():
        earliest = float(np.nanmin(time))
        if earliest > 5e8:  # seconds since 1970
            start = pd.Timestamp(earliest, unit="s", tz="UTC").isoformat(timespec="milliseconds")
            time = (values - np.nanmin(values)) / whole if whole > 1 else time - earliest
    return time, start, said


def _is_time_unit(unit: str) -> bool:
    return unit == "" or (bool(known_unit(unit)) and conversion(unit)[0] == "s")


def _guess_time_unit(values: NDArray[np.float64]) -> tuple[str, str]:
    steps = np.diff(np.unique(values[np.isfinite(values)]))
    if not len(steps):
        return "s", ""
    step = float(np.median(steps))
    whole = bool((values[np.isfinite(values)] % 1 == 0).all())
    if not whole or step < 1:
        return "s", ""
    if step >= 5e5:
        return "ns", f"its steps of {step:g} are taken as nanoseconds"
    if step >= 500:
        return "us", f"its steps of {step:g} are taken as microseconds"
    if step > 1 or len(values) > 1000:
        return "ms", f"its steps of {step:g} are taken as milliseconds"
    return "s", f"its steps of {step:g} are taken as seconds"


def _few(names: Any) -> str:
    shown = list(names)
    return ", ".join(shown[:12]) + (f" and {len(shown) - 12} more" if len(shown) > 12 else "")


NETCDF_MAGIC = (b"CDF\x01", b"CDF\x02")
PARQUET_MAGIC = b"PAR1"
_KEY = b"mufly"
_ATTRIBUTES = "mufly_attributes"


def _pyarrow() -> ModuleType:
    try:
        import pyarrow.parquet as module
    except ImportError as error:
        remedy = "install it: pip install 'mufly[parquet]' (or use .nc or .csv)"
        raise InputError("Parquet", "", "needs pyarrow, which is not installed", remedy) from error
    return module


def write_parquet(dataset: xr.Dataset, path: Path) -> None:
    """Write a dataset as one table, a column a component; units stand in the fields' metadata."""
    module = _pyarrow()
    import pyarrow

    columns = columns_of(dataset)
    fields = [pyarrow.field("time", pyarrow.float64(), metadata={"units": "s"})]
    arrays = [pyarrow.array(dataset["time"].values)]
    for column in columns:
        array = pyarrow.array(column.values.tolist() if column.values.dtype.kind in "US" else column.values)
        fields.append(pyarrow.field(column.column, array.type, metadata={"units": column.units}))
        arrays.append(array)
    schema = pyarrow.schema(fields, metadata={_KEY: describe(dataset).encode()})
    module.write_table(pyarrow.Table.from_arrays(arrays, schema=schema), path)


def read_parquet(path: str | Path, time: TimeEntry | None = None) -> tuple[RawLog, xr.Dataset | None]:
    """Read a Parquet file: its table, and the dataset if this package wrote it.

    Raises
    ------
    InputError
        If it is damaged, or pyarrow is missing.
    """
    module = _pyarrow()
    where = str(path)
    try:
        table = module.read_table(where)
        fields, units = _columns(table)
    except Exception as error:  # whatever damage provokes in pyarrow, names that are no text included
        reason = " ".join(str(error).split())[:120]
        raise InputError(where, "", f"is no sound Parquet file ({reason})", "give another copy") from error
    metadata = table.schema.metadata or {}
    if _KEY in metadata:
        try:
            clock = fields.pop("time")
            units.pop("time", None)
            dataset = restore(clock, fields, metadata[_KEY].decode())
        except (KeyError, ValueError, TypeError) as error:
            raise InputError(
                where, "", f"has a damaged description ({error})", "give another copy"
            ) from error
        start = str(dataset.attrs.get("start_time", ""))
        return RawLog(where, "Parquet", {TOPIC: RawTable(TOPIC, clock, fields, units)}, start), dataset
    clock, start, notes = table_clock(where, fields, units, time)
    raw = RawLog(where, "Parquet", {TOPIC: RawTable(TOPIC, clock, fields, units)}, start, notes=tuple(notes))
    return raw, None


def _columns(table: Any) -> tuple[dict[str, NDArray[Any]], dict[str, str]]:
    """Columns and units of a Parquet table."""
    fields: dict[str, NDArray[Any]] = {}
    units: dict[str, str] = {}
    for entry, column in zip(table.schema, table.columns, strict=True):
        name, unit = split_header(entry.name)
        given = (entry.metadata or {}).get(b"units", b"").decode(errors="replace")
        name, unit = (entry.name, given) if given else (name, unit)
        values = np.asarray(column.to_pylist() if str(entry.type) in ("string", "large_string") else column)
        if values.dtype.kind not in "biufU":
            values = np.array([str(v) for v in column.to_pylist()], dtype=str)
        fields[name] = values if values.dtype.kind == "U" else values.astype(np.float64)
        units |= {name: unit} if unit else {}
    return fields, units


def write_netcdf(dataset: xr.Dataset, path: Path) -> None:
    """Write a dataset as NetCDF 3, for any program that reads that; attributes that NetCDF cannot hold as JSON."""
    out = dataset.copy()
    out.attrs = {_ATTRIBUTES: json.dumps(plain(dataset.attrs))}
    out.attrs |= {k: v for k, v in dataset.attrs.items() if isinstance(v, str) and v}
    for name in [*out.data_vars, *out.coords]:
        variable = out[name]
        variable.attrs = {
            k: v for k, v in plain(variable.attrs).items() if isinstance(v, str | int | float) and v != ""
        }
        variable.attrs = {k: int(v) if isinstance(v, bool) else v for k, v in variable.attrs.items()}
        if variable.size == 0 and variable.dtype.kind == "U":
            out[name] = variable.astype("U1")
    out.to_netcdf(path, engine="scipy")


def read_netcdf(path: str | Path) -> xr.Dataset:
    """Read a NetCDF file with a dimension ``time``.

    Raises
    ------
    InputError
        If it is damaged or holds nothing over time.
    """
    where = str(path)
    try:
        with xr.open_dataset(where, engine="scipy", decode_times=False) as stream:
            data = stream.load()
    except Exception as error:
        raise InputError(where, "", f"is no sound NetCDF file ({error})", "give another copy") from error
    if "time" not in data.dims or "time" not in data.coords:
        raise InputError(
            where, "", "has no coordinate 'time'", "give a log (.nc) with its variables over time"
        )
    if _ATTRIBUTES in data.attrs:
        try:
            data.attrs = dict(json.loads(data.attrs[_ATTRIBUTES]))
        except (ValueError, TypeError) as error:
            problem = f"has damaged attributes ({error})"
            raise InputError(where, "", problem, "give another copy") from error
    for name in data.variables:
        if data[name].dtype.kind in "SO":
            data[name] = data[name].astype(str)
    return data
