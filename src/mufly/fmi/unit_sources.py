"""C sources of a co-simulation unit: the equations of motion, and the numbers of a vehicle.

``flight_model.h`` is the translation of :func:`mufly.dynamics.integrate_state` and of the functions of
:mod:`mufly.fmi.unit_equations`, with all that they call; it is the same for every vehicle. ``vehicle_data.h`` holds the
numbers: each is a hexadecimal float, which no compiler rounds.
"""

from __future__ import annotations

import math
import uuid
from collections.abc import Iterable, Iterator
from functools import cache
from importlib import resources

import numpy as np

from mufly.compiled.record_fields import record_fields
from mufly.dynamics import INPUT_SIZE, PARAMETER_DTYPE, STATE_SIZE, ModelParameters, model_parameters
from mufly.dynamics.simulation import integrate_state
from mufly.estimate.filter.c_records import RECORDS_HEADER_PATH
from mufly.estimate.filter_backend import FILTER_SOURCES as TRANSLATED_FILTER
from mufly.estimate.filter_backend import collect_filter_sources
from mufly.files.answer_store import hash_inputs
from mufly.firmware.export.estimate_tables import render_estimator_files
from mufly.fmi.c_translation import CTranslation
from mufly.fmi.c_types import C_DOUBLE, C_INT64, TableType
from mufly.fmi.unit_equations import OUTPUT_COUNT, START_COUNT, write_outputs, write_start_state
from mufly.fmi.unit_sensors import FUNCTIONS_WRITTEN_IN_C, SEEDED_STARTS, SENSOR_RATE_HZ, UnitSensors
from mufly.fmi.unit_variables import UnitInterface
from mufly.vehicle import Vehicle

SOURCE_FOLDER = resources.files("mufly.fmi") / "sources"
UNIT_SOURCE = "cosimulation_unit.c"
"""The only file that is compiled; it includes the others."""
FILTER_SOURCES = ("filter_unit.c", "estimate_tables.c", *(f"{name}.c" for name in TRANSLATED_FILTER))
"""Further files that are compiled for a unit with sensors."""
_SENSOR_SOURCES = ("filter_unit.c", "filter_unit.h", "random_numbers.h", "column_medians.h")
_PARAMETER_RECORD_NAME = "model_parameters"


@cache
def render_flight_model(sensors: UnitSensors | None = None) -> str:
    """Return the text of ``flight_model.h``: record of parameters, functions of the flight model and of sensors.

    Raises
    ------
    NotImplementedError
        If the equations have a form without a translation.
    """
    state, inputs, wind = (TableType(C_DOUBLE, (n,)) for n in (STATE_SIZE, INPUT_SIZE, 3))
    translation = CTranslation(PARAMETER_DTYPE, _PARAMETER_RECORD_NAME, FUNCTIONS_WRITTEN_IN_C)
    p = translation.record
    translation.add_function(integrate_state, [state, inputs, wind, p, C_DOUBLE, C_INT64])
    translation.add_function(write_start_state, [TableType(C_DOUBLE, (START_COUNT,)), state])
    translation.add_function(write_outputs, [state, inputs, wind, p, TableType(C_DOUBLE, (OUTPUT_COUNT,))])
    sampling = "" if sensors is None else sensors.translate_functions(translation)
    head = "/* Equations of motion, translated by mufly from Python (docs/explanation/dynamics.md); do not edit. */"
    return "\n".join([head, "", *_record_lines(), "", translation.render_c_source(), sampling])


def _record_lines() -> Iterator[str]:
    yield "typedef struct {"
    for name, field in record_fields(ModelParameters).items():
        size = "".join(f"[{n}]" for n in field.shape)
        unit = f" ({field.unit})" if field.unit else ""
        yield f"    {'int64_t' if field.is_int else 'double'} {name}{size}; /* {field.meaning}{unit} */"
    yield f"}} {_PARAMETER_RECORD_NAME};"


def render_sensor_sources(sensors: UnitSensors) -> dict[str, str]:
    """Return the texts of the filter's source files of a unit with sensors, by path."""
    generated = render_estimator_files(sensors.vehicle, sensors.world, SENSOR_RATE_HZ)
    files = {name: (SOURCE_FOLDER / name).read_text(encoding="utf-8") for name in _SENSOR_SOURCES}
    return {
        **files,
        "filter_sizes.h": sensors.render_filter_sizes(),
        **collect_filter_sources(generated[RECORDS_HEADER_PATH]),
        **generated,
    }


def render_vehicle_data(
    vehicle: Vehicle, interface: UnitInterface, sensors: UnitSensors | None = None
) -> tuple[str, str]:
    """Return the text of ``vehicle_data.h`` and the instantiation token, a hash of all sources.

    Parameters
    ----------
    vehicle : Vehicle
    interface : UnitInterface
    sensors : UnitSensors, optional
    """
    settable = [v for v in interface.variables if v.role != "output"]
    index = {v.name: k for k, v in enumerate(settable)}
    inputs, starts, others = (
        interface.count_variables("input"),
        interface.count_variables("start"),
        interface.count_variables("step", "seed"),
    )
    # Ratios apply to fields that other parameters have set.
    effects = [(p.key, e) for p in interface.parameters for e in p.effects]
    effects.sort(key=lambda pair: pair[1].kind == "RATIO")
    rows = []
    for key, effect in effects:
        count = math.prod(np.atleast_1d(np.zeros(PARAMETER_DTYPE[effect.field].shape)).shape)
        place = f"offsetof({_PARAMETER_RECORD_NAME}, {effect.field}), {count}"
        rows.append(f"{{{index[key]}, EFFECT_{effect.kind}, {place}, {format_real(effect.factor)}}}, /* {key} */")
    body = [
        "enum {",
        f"    SETTABLE_COUNT = {len(settable)},",
        f"    WIND_FIRST = {INPUT_SIZE}, /* after the inputs of the actuators */",
        f"    START_FIRST = {inputs},",
        f"    STEP_VARIABLE = {inputs + starts},",
        f"    PARAMETER_FIRST = {inputs + starts + others},",
        f"    MODEL_OUTPUT_COUNT = {OUTPUT_COUNT},",
        f"    OUTPUT_COUNT = {interface.count_variables('output')},",
        "};",
        "",
        "typedef enum { EFFECT_EQUAL, EFFECT_INVERSE, EFFECT_SCALED, EFFECT_RATIO } effect_kind;",
        "typedef struct { size_t variable; effect_kind kind; size_t offset, count; double factor; } parameter_effect;",
        "",
        *_array_lines("const char *const VARIABLE_NAMES[SETTABLE_COUNT]", (f'"{v.name}",' for v in settable)),
        *_array_lines("const double START_VALUES[SETTABLE_COUNT]", (f"{format_real(v.start)}," for v in settable)),
        *_array_lines("const double LOWEST_VALUES[SETTABLE_COUNT]", (f"{format_real(v.lowest)}," for v in settable)),
        *_array_lines("const double HIGHEST_VALUES[SETTABLE_COUNT]", (f"{format_real(v.highest)}," for v in settable)),
        *_array_lines("const parameter_effect PARAMETER_EFFECTS[]", rows),
        *_array_lines(
            f"const {_PARAMETER_RECORD_NAME} NOMINAL_PARAMETERS", _parameter_lines(model_parameters(vehicle))
        ),
    ]
    if sensors is not None:
        seeded = ", ".join(str(index[f"start.{name}"] - inputs) for name in SEEDED_STARTS)
        body += [
            f"enum {{ SEED_VARIABLE = {inputs + starts + 1} }};",
            f"static const size_t SEEDED_START_PLACES[] = {{{seeded}}}; /* among the start values */",
            *sensors.data_lines(), "",
        ]  # fmt: skip
    unit = (SOURCE_FOLDER / UNIT_SOURCE).read_text(encoding="utf-8")
    further = {} if sensors is None else render_sensor_sources(sensors)
    question = (vehicle.name, body, render_flight_model(sensors), unit, *sorted(further.items()))
    token = f"{{{uuid.UUID(hex=hash_inputs(*question)[:32])}}}"
    head = [
        "/* Numbers of one vehicle, generated by mufly; do not edit. */",
        "#include <stddef.h>",
        "",
        f'#define INSTANTIATION_TOKEN "{token}"',
        f"#define HAS_SENSORS {int(sensors is not None)}",
        "",
        *(f'#include "{name}"' for name in _SENSOR_SOURCES[::-1] if sensors is not None and name.endswith(".h")),
        '#include "flight_model.h"',
        "",
    ]
    return "\n".join([*head, *body, ""]), token


def _array_lines(head: str, rows: Iterable[str]) -> list[str]:
    return [f"static {head} = {{", *(f"    {row}" for row in rows), "};", ""]


def _parameter_lines(record: np.void) -> Iterator[str]:
    for name, field in record_fields(ModelParameters).items():
        values = np.asarray(record[name])
        if not np.any(values):  # C sets what is left out to zero
            continue
        if values.ndim == 0:
            unit = f" {field.unit}" if field.unit else ""
            yield f".{name} = {_format_c_number(values.item())}, /* {float(values):.9g}{unit} */"
        else:
            yield f".{name} = {{"
            for row in values.reshape(len(values), -1):
                text = ", ".join(map(_format_c_number, row.tolist()))
                yield f"    {{{text}}}," if values.ndim > 1 else f"    {text},"
            yield "},"


def _format_c_number(value: float | int) -> str:
    return str(value) if isinstance(value, int) else format_real(value)


def format_real(value: float) -> str:
    """Return a C constant that equals a number, to the last bit."""
    if math.isinf(value):
        return "INFINITY" if value > 0 else "-INFINITY"
    return value.hex()
