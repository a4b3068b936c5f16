"""DataFlash, the log of ArduPilot: the binary ``.bin`` and its text form ``.log``.

Messages of the kind FMT say what those of every other kind hold (ardupilot.org, "Understanding and Reading Logs"); the
text form has the same, a message a line. Times (TimeUS, microseconds since the board started, or TimeMS) count in
seconds from the earliest message.
"""

from __future__ import annotations

from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mufly.errors import InputError
from mufly.logs.dataflash_binary import DEFINITIONS, MAGIC, read_binary, split_tables
from mufly.logs.raw import RawLog, RawTable

__all__ = ["MAGIC", "is_text_log", "read_dataflash"]

# GPS time runs ahead of UTC by the leap seconds since 1980; 18 since 2017.
_GPS_EPOCH, _LEAP_S = 315964800.0, 18.0


def is_text_log(head: bytes) -> bool:
    """Whether a file that begins so is the text form."""
    return any(line.startswith((b"FMT,", b"FMT ,")) for line in head.splitlines()[:50])


def read_dataflash(path: str | Path) -> RawLog:
    """Read a DataFlash log, binary or text; one that was cut off is read up to the cut.

    Raises
    ------
    InputError
        If it holds no messages with a time.
    """
    where = str(path)
    with open(path, "rb") as stream:
        text = not stream.read(2).startswith(MAGIC)
    try:
        tables, complete = _read_text(Path(path)) if text else read_binary(Path(path).read_bytes())
    except InputError:
        raise
    except Exception as error:  # whatever a damaged format definition provokes
        problem = f"is a damaged DataFlash log ({error})"
        raise InputError(where, "", problem, "give another copy of the file") from error
    stamps = [t.time for t in tables if len(t.time)]
    if not stamps:
        raise InputError(
            where, "", "is a DataFlash log without timed messages", "the log ended before its first"
        )
    zero = min(float(s.min()) for s in stamps)
    shifted = {t.name: RawTable(t.name, t.time - zero, t.fields, t.units) for t in tables}
    said = shifted.pop("MSG", None)
    texts = [] if said is None else said.fields.get("Message", np.empty(0)).tolist()
    times = [] if said is None else said.time.tolist()
    parameters = shifted.pop("PARM", None)
    info: dict[str, Any] = {"system": str(texts[0])} if len(texts) else {}
    if parameters is not None and {"Name", "Value"} <= set(parameters.fields):
        names, values = parameters.fields["Name"].tolist(), parameters.fields["Value"].tolist()
        info["parameters"] = dict(zip(names, values, strict=True))
    return RawLog(
        path=where,
        kind="DataFlash",
        tables=shifted,
        start_time=_start_time(shifted),
        info=info,
        messages=tuple((t, "info", str(m)) for t, m in zip(times, texts, strict=False)),
        complete=complete,
    )


def _read_text(path: Path) -> tuple[list[RawTable], bool]:
    formats: dict[str, tuple[str, list[str]]] = {}
    rows: dict[str, list[list[str]]] = {}
    complete = True
    for line in path.read_text(encoding="utf-8", errors="replace").splitlines():
        name, _, rest = line.partition(",")
        name = name.strip()
        if name == "FMT":
            parts = [p.strip() for p in rest.split(",", 4)]
            if len(parts) == 5:
                formats[parts[2]] = parts[3], [c.strip() for c in parts[4].split(",")]
            continue
        if name not in formats:
            complete = complete and not name
            continue
        columns = formats[name][1]
        cells = [c.strip() for c in rest.split(",", len(columns) - 1)]
        if len(cells) == len(columns):
            rows.setdefault(name, []).append(cells)
        else:
            complete = False
    tables: list[RawTable] = []
    for name, cells_of in rows.items():
        letters, columns = formats[name]
        if name in DEFINITIONS:
            continue
        values: dict[str, NDArray[Any]] = {}
        for k, (column, letter) in enumerate(zip(columns, letters, strict=False)):
            cells = [row[k] for row in cells_of]
            text = letter in "nNZa"
            values[column] = np.array(cells, dtype=str) if text else np.array([_number(c) for c in cells])
        instance = next((i for i in ("I", "Instance") if i in values), None)
        tables += split_tables(name, values, {}, instance)
    return tables, complete


def _number(cell: str) -> float:
    try:
        return float(cell)
    except ValueError:
        return float("nan")


def _start_time(tables: dict[str, RawTable]) -> str:
    gps = tables.get("GPS")
    if gps is None or not {"GWk", "GMS"} <= set(gps.fields):
        return ""
    week, ms = gps.fields["GWk"].astype(np.float64), gps.fields["GMS"].astype(np.float64)
    known = np.flatnonzero(week > 1000)
    if not len(known):
        return ""
    k = known[0]
    at = _GPS_EPOCH + week[k] * 604800 + ms[k] / 1e3 - _LEAP_S - gps.time[k]
    return datetime.fromtimestamp(float(at), UTC).isoformat(timespec="milliseconds")
