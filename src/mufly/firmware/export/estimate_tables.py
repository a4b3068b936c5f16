"""Write the estimator's files of one vehicle: ``records.h`` (record types) and ``estimate_tables.c`` (parameters)."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from mufly.dynamics import model_parameters
from mufly.estimate.filter.c_records import FIELD_UNITS, RECORDS_HEADER_PATH, flight_model_record, render_records_header
from mufly.estimate.filter.filter_records import (
    INPUT_HISTORY_BLOCKS,
    MAX_LAG_BLOCKS,
    QUEUE_SIZE,
    QUEUED_READING_INDICES,
    make_filter_settings,
)
from mufly.vehicle import Vehicle
from mufly.version import __version__
from mufly.world import World

NO_VEHICLE_PARAMETERS = {"map_node_count": 0}
"""Parameters with which ``records.h`` equals that of the simulation."""


def render_estimator_files(vehicle: Vehicle | None, world: World | None, rate_Hz: float) -> dict[str, str]:
    """Return the generated files of a vehicle's estimator: text by file name.

    Parameters
    ----------
    vehicle : Vehicle or None
        None: record types only.
    world : World, optional
        World whose room the estimator knows in advance.
    rate_Hz : float
        Rate of the flight software.
    """
    if vehicle is None:
        return {RECORDS_HEADER_PATH: render_records_header(NO_VEHICLE_PARAMETERS)}
    settings = np.array([make_filter_settings(vehicle, world or World(), rate_Hz)])
    p = model_parameters(vehicle)
    lines = [
        f"/* What the estimator of {vehicle.name.replace('*/', '* /')} knows, made by mufly {__version__}. */",
        '#include "estimate/filter/ekf_step.h"',
        "",
        "const estimator_settings_t mufly_settings = {",
        *_initialiser_lines(settings),
        "};",
        "",
        "const flight_model_t mufly_flight_model = {",
        *_initialiser_lines(flight_model_record(p)),
        "};",
        "",
    ]
    return {
        RECORDS_HEADER_PATH: render_records_header(p, *compute_filter_buffer_sizes(settings[0])),
        "estimate_tables.c": "\n".join(lines),
    }


def compute_filter_buffer_sizes(s: np.void) -> tuple[int, int]:
    """Return the numbers of input blocks and of queued measurements that the filter's buffers must hold at its longest
    lag.
    """
    blocks = int(s["horizon_delay_ticks"]) // int(s["block_ticks"]) + MAX_LAG_BLOCKS + 4
    span = (int(s["horizon_delay_ticks"]) + (MAX_LAG_BLOCKS + 1) * int(s["block_ticks"])) * float(s["dt"])
    waiting = sum(
        math.ceil((span - s["latency"][k]) / (s["sensor_period"][k] * s["reading_decimation"][k])) + 1
        for k in QUEUED_READING_INDICES
        if s["is_fitted"][k]
    )
    return min(blocks, INPUT_HISTORY_BLOCKS), max(1, min(waiting, QUEUE_SIZE))


def _initialiser_lines(record: np.ndarray) -> Iterator[str]:
    for name in record.dtype.names or ():
        value = record[name][0]
        unit = FIELD_UNITS.get(name, "")
        if value.ndim == 0:
            yield f"    .{name} = {_c_literal(value)}, /* {_value_comment(value, unit)} */"
            continue
        yield f"    .{name} ="
        yield "        {"
        for row in value:
            numbers = [_c_literal(v) for v in np.atleast_1d(row)]
            text = numbers[0] if row.ndim == 0 else f"{{{', '.join(numbers)}}}"
            yield f"            {text}, /* {_value_comment(row, unit)} */"
        yield "        },"


def _value_comment(value: np.ndarray | np.generic, unit: str) -> str:
    return f"{', '.join(f'{v:.9g}' for v in np.atleast_1d(value))} {unit}".rstrip()


def _c_literal(value: np.generic) -> str:
    if np.issubdtype(value.dtype, np.integer):
        return str(int(value))
    number = float(value)
    return f"-REAL({(-number).hex()})" if number < 0.0 else f"REAL({number.hex()})"
