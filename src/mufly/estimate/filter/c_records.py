"""Generate the filter's records and constants in C (``records.h``) from those in Python.

A C struct has the fields of the Python record in equal order and size, so both languages work on the same bytes in
double precision. Fields and constants added in Python appear in C with the next build.
"""

from __future__ import annotations

import functools
import types
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from mufly.compiled.record_fields import Field, record_fields
from mufly.dynamics import equations_of_motion, model_state
from mufly.dynamics.model_state import MAP_TABLE_FIELDS, PARAMETER_DTYPE, STATE_SIZE, ModelParameters
from mufly.estimate.filter import (
    ekf_step,
    filter_horizon,
    filter_inputs,
    filter_records,
    output_predictor,
    strapdown,
    ud_filter,
)
from mufly.estimate.filter.measurements import (
    fix_fusion,
    fusion,
    scalar_fusion,
    sensor_checks,
)
from mufly.quantities.units import GRAVITY

RECORDS_HEADER_PATH = "estimate/filter/records.h"
"""Path of the generated header in a tree of C sources."""
PYTHON_ONLY_FIELDS = (
    "rotation_work", "accel_work", "transition_work", "q_work", "w_work", "derivative_work", "zero_wind",
)  # fmt: skip
"""Work arrays at the end of the memory; C keeps them on the stack."""
FIELD_UNITS: dict[str, str] = {
    name: field.unit
    for record in (ModelParameters, filter_records.FilterSettings)
    for name, field in record_fields(record).items()
}
"""Units of the settings and of the flight model's parameters by field name; "" for dimensionless ones."""
_UNUSED_PARAMETER_PREFIXES = (
    "leg_",
    "slip_",
    "contact_",
    "ground_",
    "flight_",
    "swash_phase",
)  # unused parameters of the flight model: ground, which is far below, and loads outside the filter's function
_FILTER_MODULES: tuple[types.ModuleType, ...] = (
    filter_records,
    sensor_checks,
    ud_filter,
    strapdown,
    scalar_fusion,
    fix_fusion,
    fusion,
    output_predictor,
    filter_horizon,
    filter_inputs,
    ekf_step,
)


def flight_model_dtype(p: np.void | Mapping[str, int], kind: Any = np.float64) -> np.dtype:
    """Return the record type of the flight model's parameters used by the filter."""
    nodes = max(int(p["map_node_count"]), 1)
    fields = []
    for name in PARAMETER_DTYPE.names or ():
        if not name.startswith(_UNUSED_PARAMETER_PREFIXES):
            field = PARAMETER_DTYPE[name]
            shape = (nodes,) if name in MAP_TABLE_FIELDS else field.shape
            fields.append((name, np.int32 if field.base.kind == "i" else kind, shape))
    return np.dtype(fields, align=True)


def flight_model_record(p: np.void, kind: Any = np.float64) -> np.ndarray:
    """Return the flight model's parameters in the form used by the filter in C."""
    out = np.zeros(1, flight_model_dtype(p, kind))
    for name in out.dtype.names or ():
        value = p[name]
        out[name][0] = value[: out[name].shape[1]] if name in MAP_TABLE_FIELDS else value
    return out


def collect_constants() -> dict[str, int | float | tuple[int, ...]]:
    """Return the constants of the filter's modules by their names in C.

    C names have no leading underscore; names of a single letter get a trailing one.
    """
    found: dict[str, int | float | tuple[int, ...]] = {
        "GRAVITY": GRAVITY,
        **{name: value for name, value in vars(model_state).items() if name.startswith(("MODEL_", "U_"))},
        "MIN_ROTOR_SPEED_RAD_S": equations_of_motion._MIN_ROTOR_SPEED_RAD_S,
        "MODEL_STATES": STATE_SIZE,
        "CURVE_POINTS": PARAMETER_DTYPE["battery_curve"].shape[0],
    }
    for module in _FILTER_MODULES:
        for name, value in vars(module).items():
            whole = isinstance(value, tuple) and bool(value) and all(isinstance(v, int) for v in value)
            if name.isupper() and (isinstance(value, (int, float)) or whole):
                known = found.setdefault(_macro_name(name), value)
                if known != value:
                    raise ValueError(f"{module.__name__}.{name} is {value!r}, but {known!r} in another module")
    return found


def _macro_name(name: str) -> str:
    plain = name.lstrip("_")
    return plain + "_" if len(plain) == 1 else plain


def render_records_header(
    p: np.void | Mapping[str, int],
    kept: int = filter_records.INPUT_HISTORY_BLOCKS,
    waiting: int = filter_records.QUEUE_SIZE,
) -> str:
    """Return the text of ``records.h``: the filter's records and constants for a vehicle, in C.

    Parameters
    ----------
    p : record
        Parameters of the flight model, of which the size of the map is used.
    kept, waiting : int
        Numbers of stored input blocks and of queued measurements.
    """
    return _render_records(max(int(p["map_node_count"]), 1), kept, waiting)


@functools.lru_cache(maxsize=8)
def _render_records(nodes: int, kept: int, waiting: int) -> str:
    numbers = {**collect_constants(), "INPUT_HISTORY_BLOCKS": kept, "QUEUE_SIZE": waiting, "MAP_NODES": nodes}
    lines = [
        "/* Constants and records of the estimator, made from those of Python (mufly.estimate); do not edit. */",
        "#ifndef MUFLY_RECORDS_H",
        "#define MUFLY_RECORDS_H",
        "",
        '#include "real.h"',
        "",
        *(_constant_definition(name, value) for name, value in numbers.items()),
        "",
    ]
    sizes = {nodes: "MAP_NODES"}
    memory = filter_records.make_memory_dtype(kept=kept, waiting=waiting)
    for name, record, fields in (
        (
            "estimator_settings_t",
            filter_records.make_settings_dtype(),
            record_fields(filter_records.FilterSettings),
        ),
        ("flight_model_t", flight_model_dtype({"map_node_count": nodes}), record_fields(ModelParameters)),
        ("estimator_t", memory, record_fields(filter_records.FilterMemory)),
    ):
        lines += ["typedef struct {", *_struct_members(record, sizes, fields), f"}} {name};", ""]
    return "\n".join([*lines, "#endif", ""])


def _struct_members(record: np.dtype, sizes: Mapping[int, str], fields: Mapping[str, Field]) -> Iterator[str]:
    for name in record.names or ():
        if name not in PYTHON_ONLY_FIELDS:
            field = record[name]
            kind = "int32_t" if field.base.kind == "i" else "real_t"
            extent = "".join(f"[{sizes.get(n, n)}]" for n in field.shape)
            unit = f" ({fields[name].unit})" if fields[name].unit else ""
            yield f"    {kind} {name}{extent}; /* {fields[name].meaning}{unit} */"


def _constant_definition(name: str, value: int | float | tuple[int, ...]) -> str:
    if isinstance(value, tuple):
        return f"static const int32_t {name}[{len(value)}] = {{{', '.join(map(str, value))}}};"
    if isinstance(value, int):
        return f"#define {name} {value if value >= 0 else f'({value})'}"
    number = f"REAL({abs(value).hex()})"
    return f"#define {name} {number if value >= 0 else f'(-{number})'} /* {value:.9g} */"
