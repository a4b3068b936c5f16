"""Reader of text tables as logs: units from header, unit line and preamble, and the clock.

Cells that are no number become missing values, and are counted. A row with fewer cells than the header is omitted and
reported, because the missing cell is unknown (:mod:`mufly.files.text_table`).
"""

from __future__ import annotations

import struct
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mufly.files.text_table import read_text_table
from mufly.logs.column_map import TimeEntry
from mufly.logs.raw_log import RawLog, RawTable
from mufly.logs.tables.clock_columns import extract_row_times, is_time_unit
from mufly.quantities.units import normalise_unit, parse_column_unit, split_headers, unit_conversion

TABLE_TOPIC = "table"


def read_csv(path: str | Path, time: TimeEntry | None = None) -> RawLog:
    """Read a text table as a log with the single topic ``table``.

    Parameters
    ----------
    path : str or Path
    time : TimeEntry, optional
        Column and unit of the clock, or the rate of the rows. Default: a column called time, t or the like; without a
        unit in the header the unit is guessed from the step, and reported.

    Raises
    ------
    InputError
        If the file is no table, or its clock cannot be found.
    """
    table = read_text_table(path, short_rows="drop")
    columns = table.parse_columns()
    units_below = table.units or [""] * len(columns)
    fields, units_of, notes = name_columns_and_units(table.header, units_below, [values for values, _ in columns])
    notes = [n for n in table.notes if n != table.damage] + notes
    for name, (_, bad) in zip(fields, columns, strict=True):
        if bad:
            cells = "1 cell is not a number and counts" if bad == 1 else f"{bad} cells are not numbers and count"
            notes.append(f"column {name}: {cells} as missing")
    _set_blackbox_units(table.preamble, fields, units_of)
    clock, start, said = extract_row_times(table.where, fields, units_of, time)
    info: dict[str, Any] = {"columns": len(table.header), "separator": table.separator}
    return RawLog(
        path=table.where, format_name="CSV",
        tables_by_topic={TABLE_TOPIC: RawTable(TABLE_TOPIC, clock, fields, units_of)}, start_time=start,
        info=info | ({"preamble": table.preamble} if table.preamble else {}), notes=(*notes, *said),
        is_complete=not table.damage, damage_text=table.damage,
    )  # fmt: skip


def name_columns_and_units(
    names: list[str], given: list[str], columns: list[NDArray[Any]]
) -> tuple[dict[str, NDArray[Any]], dict[str, str], list[str]]:
    """Return columns by name, their units, and notes on the units.

    Parameters
    ----------
    names : list of str
        Headers, which may end with a unit.
    given : list of str
        Units stated elsewhere in the file, ``""`` for none; they take precedence over those in headers.
    columns : list of (n,) arrays
    """
    fields: dict[str, NDArray[Any]] = {}
    units: dict[str, str] = {}
    notes: list[str] = []
    split, doubtful = split_headers(names)
    for k, ((name, ending), unit, values) in enumerate(zip(split, given, columns, strict=True)):
        whole, name = (text or f"column {k + 1}" for text in (names[k], name))
        whole, name = (f"{text} ({k + 1})" if text in fields else text for text in (whole, name))
        if not unit:
            fields[name] = values
            units |= {name: ending} if ending else {}
            continue
        settled = "" if is_time_unit(unit) and not normalise_unit(unit) else parse_column_unit(whole, unit)
        if settled is None:
            notes.append(f"{whole}: its unit {unit!r} fits two quantities or none; name one in a column map")
        elif (
            ending
            and normalise_unit(ending)
            and normalise_unit(settled)
            and unit_conversion(ending) != unit_conversion(settled)
        ):
            notes.append(f"{whole}: the metadata state {unit}, the name {ending}: the metadata are used")
        fields[whole] = values
        units |= {whole: settled or unit} if settled is not None else {}
    doubtful = [d for d, unit in zip(names, given, strict=True) if d in doubtful and not unit]
    if doubtful:
        notes.append(
            f"{', '.join(doubtful)}: read without a unit, because the unit at the end of the name does not "
            "suit the quantity; give the unit in a column map"
        )
    return fields, units, notes


def _set_blackbox_units(preamble: dict[str, str], fields: dict[str, NDArray[Any]], units: dict[str, str]) -> None:
    """Set the units of Blackbox Explorer's raw numbers, by the scales in its header.

    Time is in microseconds. The gyroscope's numbers times ``gyro_scale`` (a float's bits in hexadecimal) are degrees
    per second. The accelerometer's numbers over ``acc_1G`` are multiples of standard gravity (Betaflight,
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
