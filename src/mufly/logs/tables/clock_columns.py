"""Clock of a table: its column, unit and epoch, and wraps of its counter.

A unit in a header or in a container's metadata is used as stated. Without one, the magnitude of the numbers shows an
epoch (1.7e12 are milliseconds since 1970, at any rate of the rows); otherwise the unit follows from the step. A counter
that drops by its whole range (2^16, 2^24 or 2^32 ticks, a day, a GPS week) has wrapped and is unwrapped. A counter that
drops by another amount was restarted, which cannot be repaired (:func:`mufly.logs.raw_log.select_usable_samples`).
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from mufly.errors import InputError
from mufly.logs.column_map import TimeEntry
from mufly.logs.raw_log import MIN_GAP_STEPS, find_foreign_epoch_stamps
from mufly.quantities.units import normalise_unit, split_header, unit_conversion

_Array = NDArray[np.float64]
_UNIT_BY_NAME = {
    "timeus": "us", "timems": "ms", "millis": "ms", "micros": "us", "msec": "ms", "usec": "us", "seconds": "s",
}  # fmt: skip
_TIME_COLUMN_PATTERN = re.compile(
    r"^(?:_*time|t|zeit|zeitstempel|timestamp|time_?stamp|stamp|timeus|timems|time_?boot|time_since_boot|seconds|secs|utc"
    r"|date_?time|elapsed(?:[ _]?time)?|(?:unix|epoch|utc|gps|local|system|sys|log|logger|flight|board|sample|host|ros"
    r"|recording)[ _]?time(?:[ _]?stamp)?|epoch|uptime|clock|millis|micros|msec|usec|header\.stamp)$",
    re.IGNORECASE,
)
_DATE_COLUMN_PATTERN = re.compile(r"^(?:date|datum|day|(?:utc|gps|local|log)[ _]?date)$", re.IGNORECASE)
_SECONDS_COLUMN_PATTERN = re.compile(r"^(?P<stem>.*?)(?:secs?)$", re.IGNORECASE)
_UNIT_SINCE_PATTERN = re.compile(r"^\s*(?P<unit>[^\d]*?\w)\s+since\s+(?P<epoch>.+?)\s*$", re.IGNORECASE)
_TIME_ZONE_PATTERN = re.compile(r"(?:Z|UTC|GMT|[+-]\d\d(?::?\d\d)?)$")
_TIME_OF_DAY_PATTERN = re.compile(r"^\d{1,2}:\d\d")
_DATE_FORMATS = ("%Y-%m-%d", "%Y/%m/%d", "%Y.%m.%d", "%Y%m%d", "%d.%m.%Y", "%d-%m-%Y", "%d %b %Y", "%d-%b-%Y")
# Stamps between these years count as an epoch: 2000 and 2060 (s since 1970).
_EARLIEST_EPOCH_S, _LATEST_EPOCH_S = 946_684_800.0, 2_840_140_800.0
_MAX_EPOCH_STEP_S = 300.0
_MAX_CALENDAR_S = 6e10  # about the years 70 to 3870, the range of the calendar functions
_DAY_S, _WEEK_S = 86_400.0, 604_800.0
_MIN_FORWARD_FRACTION = 0.9  # least fraction of increasing steps of a clock


def extract_row_times(
    where: str, fields: dict[str, NDArray[Any]], units: dict[str, str], entry: TimeEntry | None = None
) -> tuple[_Array, str, list[str]]:
    """Return the time of a table's rows (s) from its columns, the wall time of the instant 0, and notes.

    Parameters
    ----------
    where : str
        Name of the file in errors.
    fields : dict of str to (n,) array
        Columns, from which those of the time are removed: numbers, text, or NumPy's datetime64 and timedelta64.
    units : dict of str to str
        Units of the columns, from which that of the time is removed; also ``"milliseconds since 2024-08-09 10:00"`` (CF
        conventions, section 4.4).
    entry : TimeEntry, optional
        Column and unit of the clock, or the rate of the rows.

    Returns
    -------
    time : (n,) array
        Time (s).
    start : str
        Wall time of the instant 0 (ISO 8601); "" if the column has none.
    words : list of str
        Guesses and repairs, as sentences.

    Raises
    ------
    InputError
        If the column does not exist, or no column is a plausible clock.
    """
    entry = entry or TimeEntry(column=None, unit=None, rate_hz=None)
    n = len(next(iter(fields.values()))) if fields else 0
    if entry.rate_hz is not None:
        return np.arange(n) / entry.rate_hz, "", []
    if entry.column is not None:
        name = entry.column if entry.column in fields else split_header(entry.column)[0]
        if name not in fields:
            raise InputError(where, entry.column, "is not a column", f"columns are: {', '.join(fields)}")
    else:
        joined = _join_nanoseconds(fields, units)
        name = joined or _find_clock_column(where, fields, units)
    values = fields.pop(name)
    unit = entry.unit or units.pop(name, "") or _UNIT_BY_NAME.get(name.lower(), "")
    if values.dtype.kind == "M":
        valid = ~np.isnat(values)
        ns = values.astype("datetime64[ns]").astype(np.int64)
        return _clock_from_stamps(name, ns, valid, [])
    if values.dtype.kind == "U":
        day = next((c for c in fields if _DATE_COLUMN_PATTERN.match(c)), None)
        found = _parse_text_stamps(where, name, values, None if day is None else fields[day])
        if found.has_date and day is not None and _TIME_OF_DAY_PATTERN.match(_first_nonempty_text(values)):
            fields.pop(day)
            units.pop(day, None)
        if found.has_date:
            return _clock_from_stamps(name, found.ns, found.valid, found.notes)
        values, unit = np.where(found.valid, found.ns / 1e9, np.nan), "s"
        time, start, said = _clock_from_numbers(where, name, values, unit, 0.0)
        return time, start, [*found.notes, *said]
    if values.dtype.kind == "m":
        ns = values.astype("timedelta64[ns]").astype(np.int64)
        values, unit = np.where(np.isnat(values), np.nan, ns / 1e9), "s"
    since = _UNIT_SINCE_PATTERN.match(unit)
    epoch_s = 0.0
    if since is not None:
        unit, epoch_s = since["unit"], _parse_epoch(where, name, unit, since["epoch"])
    return _clock_from_numbers(where, name, values, unit, epoch_s)


def is_time_unit(unit: str) -> bool:
    """Return whether a text is a unit of time, with or without an epoch, or empty."""
    since = _UNIT_SINCE_PATTERN.match(unit)
    unit = since["unit"] if since is not None else unit
    return unit == "" or (bool(normalise_unit(unit)) and unit_conversion(unit)[0] == "s")


def _find_clock_column(where: str, fields: Mapping[str, NDArray[Any]], units: Mapping[str, str]) -> str:
    """Return the time column: the first running column with a name and unit of time, else a column of time type."""
    named = [c for c in fields if _TIME_COLUMN_PATTERN.match(c) and is_time_unit(units.get(c, ""))]
    typed = [c for c, v in fields.items() if v.dtype.kind in "Mm" and c not in named]
    dated = [c for c, v in fields.items() if _DATE_COLUMN_PATTERN.match(c) and v.dtype.kind == "U" and c not in named]
    found = named + typed + [c for c in dated if re.search(r"\d\D+\d\d?:\d\d", _first_nonempty_text(fields[c]))]
    found += [
        c for c in fields if _UNIT_SINCE_PATTERN.match(units.get(c, "")) and is_time_unit(units[c]) and c not in found
    ]
    if not found:
        strange = next(
            (c for c in fields if _TIME_COLUMN_PATTERN.match(c) and not normalise_unit(units.get(c, ""))), ""
        )
        if strange:
            problem = f"{units[strange]!r} is not a unit of time"
            raise InputError(where, strange, problem, "use s, ms, us, ns, min or h, or name it in a column map")
        remedy = "name it (time=COLUMN, or [time] column in a map), or give [time] rate_hz"
        raise InputError(where, "", f"has no column for the time among: {_format_names(fields)}", remedy)
    return next((c for c in found if _runs_forward(fields[c])), found[0])


def _runs_forward(values: NDArray[Any]) -> bool:
    if values.dtype.kind in "UMm":
        return True
    steps = np.diff(values[np.isfinite(values)])
    return bool(len(steps)) and bool((steps > 0).any()) and float((steps >= 0).mean()) >= _MIN_FORWARD_FRACTION


def _format_names(names: Any) -> str:
    shown = list(names)
    return ", ".join(shown[:12]) + (f" and {len(shown) - 12} more" if len(shown) > 12 else "")


def _join_nanoseconds(fields: dict[str, NDArray[Any]], units: dict[str, str]) -> str:
    """Join columns of seconds and nanoseconds, as in ROS stamps, to one column; return "" if there is no such pair."""
    for name, seconds in fields.items():
        match = _SECONDS_COLUMN_PATTERN.match(name)
        if match is None or seconds.dtype.kind not in "iuf":
            continue
        for other in (f"{match['stem']}{end}" for end in ("nsecs", "nsec", "nanosec", "nanosecs")):
            if other in fields and fields[other].dtype.kind in "iuf" and np.isfinite(seconds).all():
                whole = np.nan_to_num(fields.pop(other)).astype(np.int64)
                fields[name] = np.rint(seconds).astype(np.int64) * 1_000_000_000 + whole
                units.pop(other, None)
                units[name] = "ns"
                return name
    return ""


def _parse_epoch(where: str, name: str, unit: str, text: str) -> float:
    """Return the epoch of a unit (s since 1970)."""
    try:
        stamp = pd.Timestamp(text)
        stamp = stamp.tz_localize("UTC") if stamp.tzinfo is None else stamp.tz_convert("UTC")
    except (ValueError, TypeError) as error:
        problem = f"counts in {unit!r}, but {text!r} is not a date"
        raise InputError(where, name, problem, "write a date of the usual calendar, as 2024-08-09 10:00") from error
    return float(stamp.timestamp())


class _TextStamps(NamedTuple):
    """Times read from text: nanoseconds since 1970 if ``has_date``, else since midnight; mask of valid stamps;
    notes."""

    ns: NDArray[np.int64]
    valid: NDArray[np.bool_]
    has_date: bool
    notes: list[str]


def _first_nonempty_text(values: NDArray[Any]) -> str:
    return next((str(v).strip() for v in values if str(v).strip()), "")


def _parse_text_stamps(where: str, name: str, values: NDArray[Any], day: NDArray[Any] | None) -> _TextStamps:
    """Return the times in text columns: ISO 8601, date and time of day in one cell or two, or time of day alone."""
    first = _first_nonempty_text(values)
    texts = pd.Series(values.astype(object))
    if re.search(r":\d\d,\d", first):
        texts = texts.str.replace(",", ".", regex=False)
    if first.endswith(("UTC", "GMT")):
        texts = texts.str.replace(r"\s*(?:UTC|GMT)$", "+00:00", regex=True)
    words: list[str] = []
    if not _TIME_OF_DAY_PATTERN.match(first):
        stamps = pd.to_datetime(texts, errors="coerce", utc=True, format="ISO8601")
        if stamps.isna().mean() > 0.5:
            parts = texts.str.strip().str.split(r"[ T]+", n=1, regex=True, expand=True)
            if parts.shape[1] != 2 or not _TIME_OF_DAY_PATTERN.match(
                _first_nonempty_text(parts[1].fillna("").to_numpy())
            ):
                raise InputError(where, name, f"{first!r} is not a time", "give seconds, or ISO 8601")
            day, texts = parts[0].fillna("").to_numpy(), parts[1]
        else:
            if not _TIME_ZONE_PATTERN.search(first) and not re.search("utc|gmt", name, re.IGNORECASE):
                words.append(f"column {name} names no time zone: taken as UTC")
            ns = stamps.to_numpy(dtype="datetime64[ns]").astype(np.int64)
            return _TextStamps(ns, ~stamps.isna().to_numpy(), True, words)
    if re.search("[ap]m$", first, re.IGNORECASE):
        clock = pd.to_datetime(texts.str.strip(), format="mixed", errors="coerce")
        since = clock - clock.dt.normalize()
    else:
        since = pd.to_timedelta(texts.str.strip().str.replace(r"^(\d+:\d\d)$", r"\1:00", regex=True), errors="coerce")
    valid = since.notna().to_numpy()
    if valid.mean() < 0.5:
        raise InputError(where, name, f"{first!r} is not a time", "give seconds, or ISO 8601")
    ns = since.to_numpy(dtype="timedelta64[ns]").astype(np.int64)
    if day is None:
        return _TextStamps(ns, valid, False, [f"column {name} holds the time of the day without a date"])
    days, said = _parse_dates(where, day)
    words.append(f"column {name} names no time zone: taken as UTC")
    both = valid & ~np.isnat(days)
    ns = np.where(both, ns, 0) + np.where(both, days.astype("datetime64[ns]").astype(np.int64), 0)
    return _TextStamps(_add_midnight_days(ns, both), both, True, [*words, *said])


def _parse_dates(where: str, values: NDArray[Any]) -> tuple[NDArray[np.datetime64], list[str]]:
    """Return the dates of a column, with one format for all of them, and notes."""
    texts = values if values.dtype.kind in "UO" else np.array([f"{v:.0f}" for v in values])
    known, place = np.unique(np.char.strip(texts.astype(str)), return_inverse=True)
    filled = known[known != ""]
    words: list[str] = []
    readings = [pd.to_datetime(filled, format=f, errors="coerce") for f in _DATE_FORMATS]
    slashed = [pd.to_datetime(filled, format=f, errors="coerce") for f in ("%m/%d/%Y", "%d/%m/%Y")]
    whole = [r for r in readings + slashed if len(r) and not r.isna().any()]
    if not whole:
        first = filled[0] if len(filled) else ""
        raise InputError(where, "", f"{first!r} is not a date", "write dates as 2024-08-09")
    # Of two possible formats the one with closer days is used: the 4th and 5th of May, not April and May.
    best = min(whole, key=lambda r: r.max() - r.min())
    if len(whole) > 1 and all(r is not b for r in whole for b in readings):
        shown = best[0].strftime("%d %B %Y")
        words.append(f"{filled[0]} may be month-day or day-month: read as {shown}")
    days = np.full(len(known), np.datetime64("NaT"), dtype="datetime64[ns]")
    days[known != ""] = best.to_numpy(dtype="datetime64[ns]")
    return days[place.reshape(-1)], words


def _add_midnight_days(ns: NDArray[np.int64], valid: NDArray[np.bool_]) -> NDArray[np.int64]:
    """Return stamps with a constant date, plus one day at each midnight."""
    out = ns.copy()
    steps = np.diff(ns[valid])
    day = int(_DAY_S * 1e9)
    wrapped = np.append(0, np.cumsum((steps < -day // 2) & (steps >= -day)))
    out[valid] += day * wrapped
    return out


def _clock_from_stamps(
    name: str, ns: NDArray[np.int64], valid: NDArray[np.bool_], words: list[str]
) -> tuple[_Array, str, list[str]]:
    foreign, strange = find_foreign_epoch_stamps({f"column {name}": np.where(valid, ns / 1e9, np.nan)})
    valid = valid & ~foreign[f"column {name}"]
    if not valid.any():
        return np.full(len(ns), np.nan), "", [*words, *strange]
    zero = int(ns[valid].min())
    time = np.where(valid, (ns - zero) / 1e9, np.nan)
    start = pd.Timestamp(zero, tz="UTC").isoformat(timespec="milliseconds")
    return time, start, [*words, *strange]


def _clock_from_numbers(
    where: str, name: str, values: NDArray[Any], unit: str, epoch_s: float
) -> tuple[_Array, str, list[str]]:
    base = 0
    if values.dtype.kind in "iu" and len(values) and abs(int(values[0])) > 2**53:
        base = int(values[0])  # more digits than a float has
        values = values - values.dtype.type(base)
    values = values.astype(np.float64)
    said: list[str] = []
    if not unit:
        unit, why = _guess_time_unit(values + base)
        if why:
            said.append(f"column {name} names no unit: {why}")
    if not is_time_unit(unit):
        raise InputError(where, name, f"{unit!r} is not a unit of time", "use s, ms, us, ns, min or h")
    _, factor, _ = unit_conversion(unit, "s")
    values, wrapped = unwrap_counter(values, factor)
    said += [f"column {name}: {w}" for w in wrapped]
    # A thousandth of a second in decimals is not always 1 times 0.001; dividing is exact more often.
    whole = round(1 / factor)
    exact = whole > 1 and abs(whole * factor - 1) < 1e-12

    def counts_to_seconds(counts: _Array) -> _Array:
        return counts / whole if exact else counts * factor

    time = counts_to_seconds(values)
    shift = base * factor + epoch_s
    foreign, strange = find_foreign_epoch_stamps({f"column {name}": time + shift})
    said += strange
    time, values = (np.where(foreign[f"column {name}"], np.nan, v) for v in (time, values))
    if not np.isfinite(time).any():
        return time, "", said
    first = float(np.nanmin(values))
    earliest = float(np.nanmin(time)) + shift
    if _EARLIEST_EPOCH_S / 2 < earliest < _LATEST_EPOCH_S or (epoch_s and abs(earliest) < _MAX_CALENDAR_S):
        start = pd.Timestamp(earliest, unit="s", tz="UTC").round("us").isoformat(timespec="milliseconds")
        return counts_to_seconds(values - first), start, said
    if earliest >= _LATEST_EPOCH_S:
        better = next(
            (
                u
                for u in ("ms", "us", "ns")
                if _EARLIEST_EPOCH_S < earliest * unit_conversion(u)[1] / factor < _LATEST_EPOCH_S
            ),
            "",
        )
        hint = (
            f"; in {better} they would be of {_year_of(earliest * unit_conversion(better)[1] / factor)}"
            if better
            else ""
        )
        said.append(
            f"column {name}: {earliest:.6g} s since 1970 are not in the years of possible logs{hint}; time "
            "counts from the first"
        )
        return counts_to_seconds(values - first), "", said
    return time + base * factor, "", said


def _year_of(since_s: float) -> int:
    return int(pd.Timestamp(since_s, unit="s").year)


def _guess_time_unit(values: _Array) -> tuple[str, str]:
    """Return the unit of a clock without stated unit, and the reason: an epoch by its size, else the size of the
    step."""
    known = values[np.isfinite(values)]
    steps = np.diff(np.unique(known))
    if not len(steps):
        return "s", ""
    step = float(np.median(steps))
    size = float(np.median(known))
    for unit, word in (
        ("s", "seconds"),
        ("ms", "milliseconds"),
        ("us", "microseconds"),
        ("ns", "nanoseconds"),
    ):
        factor = unit_conversion(unit)[1]
        slow = step * factor > _MAX_EPOCH_STEP_S and not (known % round(60 / factor) == 0).all()
        if _EARLIEST_EPOCH_S < size * factor < _LATEST_EPOCH_S and not slow:
            day = pd.Timestamp(size * factor, unit="s").date()
            return unit, f"its {size:.5g} are taken as {word} since 1970, {day}"
    whole = bool((known % 1 == 0).all())
    if not whole or step < 1:
        return "s", ""
    if step >= 5e5:
        return "ns", f"its steps of {step:g} are taken as nanoseconds"
    if step >= 500:
        return "us", f"its steps of {step:g} are taken as microseconds"
    if step > 1 or len(values) > 1000:
        return "ms", f"its steps of {step:g} are taken as milliseconds"
    return "s", f"its steps of {step:g} are taken as seconds"


def unwrap_counter(values: _Array, unit_s: float) -> tuple[_Array, list[str]]:
    """Unwrap the counter of a clock, which restarts at zero when its range is exceeded.

    A step back by the whole range of a counter, within five of its median steps, is a wrap; other steps are kept.

    Parameters
    ----------
    values : (n,) array
        Counts as written; NaN is no stamp.
    unit_s : float
        Duration of one count (s).

    Returns
    -------
    values : (n,) array
        Unwrapped counts.
    words : list of str
        One sentence if it wrapped.
    """
    known = np.flatnonzero(np.isfinite(values))
    counts = values[known]
    steps = np.diff(counts)
    if not (steps < 0).any() or not (steps > 0).any():
        return values, []
    step = float(np.median(steps[steps > 0]))
    best: tuple[int, float, str, NDArray[np.float64]] | None = None
    for size, what in _counter_ranges(counts, unit_s):
        slack = max(MIN_GAP_STEPS * step, 2.0)
        low, high = float(counts.min()), float(counts.max())
        fits = (low >= 0 and high < size + 1) or (low >= -size / 2 and high <= size / 2)
        if slack > size / 8 or not fits:
            continue
        turns = np.rint(steps / size)
        turns[np.abs(steps - turns * size) > slack] = 0
        wraps = int((turns < 0).sum())
        if wraps and (best is None or wraps > best[0]):
            best = wraps, size, what, turns
    if best is None:
        return values, []
    wraps, size, what, turns = best
    out = values.copy()
    out[known[1:]] -= size * np.cumsum(turns)
    times = "once" if wraps == 1 else f"{wraps} times"
    at = counts[int((turns < 0).argmax())]
    return out, [f"{what} {times}, first at {at:.10g}, and is counted on"]


def _counter_ranges(counts: _Array, unit_s: float) -> list[tuple[float, str]]:
    """Return the ranges (counts) after which a clock's counter may restart, each with a description."""
    out = []
    if bool((counts % 1 == 0).all()):
        out = [(2.0**bits, f"its counter of {bits} bits wraps") for bits in (16, 24, 32)]
    for bits, tick, name in ((32, 1e-3, "ms"), (32, 1e-6, "us"), (16, 1e-3, "ms")):
        if abs(tick / unit_s - 1) > 1e-9:
            out.append((2.0**bits * tick / unit_s, f"a counter of {bits} bits of {name} wraps"))
    return [*out, (_DAY_S / unit_s, "it passes midnight"), (_WEEK_S / unit_s, "its week begins anew")]
