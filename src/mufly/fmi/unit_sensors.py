"""Sensors and filter of a co-simulation unit: their variables, C functions and numbers.

The sensors' C functions are translations of :mod:`mufly.sensors`; their random numbers are written in C
(``random_numbers.h``), and the filter's C sources are those that fly on board. Constants and memory of all sensors are
one block of 64-bit words. The words that depend on the seed are listed for each seed, as
:func:`mufly.sensors.make_fitted_sensors` draws them, and so are the legs of
:func:`mufly.sensors.randomise_leg_lengths`.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mufly.dynamics import STATE_SIZE, model_parameters, standing_attitude, standing_height
from mufly.dynamics.equations_of_motion import compute_battery_supply
from mufly.errors import InputError
from mufly.estimate.filter.filter_records import (
    ERROR_ACCEL_BIAS,
    ERROR_ATTITUDE,
    ERROR_GYRO_BIAS,
    ERROR_POSITION,
    ERROR_STATE_COUNT,
    ERROR_THRUST_SCALE,
    ERROR_VELOCITY,
    ERROR_WIND,
    NOMINAL_ACCEL_BIAS,
    NOMINAL_GYRO_BIAS,
    NOMINAL_POSITION,
    NOMINAL_THRUST_SCALE,
    NOMINAL_VELOCITY,
    NOMINAL_WIND,
    READING_STARTS,
    READING_WIDTHS,
    SENSOR_COUNT,
    STATE_COUNT,
    SUBTRACTED_READING_OFFSETS,
    fused_beam_indices,
    make_filter_settings,
    make_memory_dtype,
)
from mufly.estimate.filter.measurements.sensor_checks import ACTUATOR_START, CLIPPING_START, INPUT_VALUE_COUNT
from mufly.estimate.filter.output_predictor import COVARIANCE_INTERVAL_TICKS
from mufly.estimate.kalman_estimator import median_filter_ring_scan
from mufly.firmware.export.estimate_tables import compute_filter_buffer_sizes
from mufly.flight.simulated_plant import write_true_attitude
from mufly.fmi.c_translation import CTranslation
from mufly.fmi.c_types import C_DOUBLE, TableTupleType, TableType
from mufly.quantities.quantity_table import DIMENSION_LABELS
from mufly.quantities.sensor_table import READINGS, SENSORS
from mufly.sensors import FittedSensors, Imu, PeriodicSensor, make_fitted_sensors, randomise_leg_lengths
from mufly.sensors.column_medians import write_column_medians
from mufly.sensors.faults import FaultySensor
from mufly.sensors.imu import make_first_imu_reading, sample_imu
from mufly.sensors.periodic import (
    CLOCK_NEXT_SAMPLE_INDEX,
    PENDING_COUNT_INDEX,
    ROW_FIRST_VALUE_INDEX,
    ROW_IS_VALID_INDEX,
    ROW_MEASURED_TIME_INDEX,
    publish_if_due,
    schedule_next_if_due,
)
from mufly.sensors.rng import draw_normals, draw_uniforms
from mufly.sensors.sensor_suite import SENSOR_CLASSES
from mufly.vehicle import Vehicle
from mufly.world import World

SENSOR_RATE_HZ = 200.0
"""Rate of sensors and filter (Hz): that of the flight software."""
FUNCTIONS_WRITTEN_IN_C = {f: f.__name__ for f in (draw_normals, draw_uniforms, write_column_medians)}
SEEDED_STARTS = ("position_down", "roll", "pitch", "bar_roll", "bar_pitch")
"""Start values that depend on the seed: the vehicle stands on legs of random lengths."""
_C_TYPE_BY_KIND = {"f": "double", "i": "int64_t", "u": "uint64_t"}
_COMPONENT_NAMES = {"N": "north", "E": "east", "D": "down", "p": "roll", "q": "pitch", "r": "yaw"}
_STATE_TABLE, _VECTOR_3_TABLE, _VECTOR_2_TABLE = (TableType(C_DOUBLE, (n,)) for n in (STATE_SIZE, 3, 2))


@dataclass(frozen=True)
class SensedOutput:
    """Output of sensors or filter: name, unit, meaning, and its value in C."""

    name: str
    unit: str
    description: str
    value_in_c: str


class UnitSensors:
    """Sensors and filter of a co-simulation unit, with the sensors' random errors for several seeds.

    Parameters
    ----------
    vehicle : Vehicle
    seed_count : int
        Seeds 0 to ``seed_count - 1`` are in the unit.

    Raises
    ------
    InputError
        If the vehicle has no sensors, or no inertial unit.
    """

    def __init__(self, vehicle: Vehicle, seed_count: int) -> None:
        self.vehicle, self.seed_count = vehicle, seed_count
        self.world = World()
        if vehicle.sensors is not None and vehicle.sensors.imu is None:
            raise InputError(
                vehicle.name, "sensors.imu", "there is no such table", "add one, or export without sensors"
            )
        self._sensors = self._make_seeded_sensors(0)
        self._arrays = dict(_sensor_arrays(self._sensors))
        self._settings = make_filter_settings(vehicle, self.world, SENSOR_RATE_HZ)

    def _make_seeded_sensors(self, seed: int) -> FittedSensors:
        made = make_fitted_sensors(self.vehicle, self.world, seed=seed)
        made.reset()  # as at the start of a flight
        return made

    @cached_property
    def seeded_words(self) -> tuple[NDArray[np.uint64], NDArray[np.intp], NDArray[np.uint64]]:
        """Sensor data as 64-bit words (n,) for seed 0, indices of the words that depend on the seed (m,), and their
        values.

        The values have the shape (seeds, m).
        """
        rows = np.array([_pack_words(_sensor_arrays(self._make_seeded_sensors(k))) for k in range(self.seed_count)])
        changing = np.flatnonzero((rows != rows[0]).any(axis=0))
        return rows[0], changing, rows[:, changing]

    @cached_property
    def seeded_start_values(self) -> NDArray[np.float64]:
        """Start values that depend on the seed (:data:`SEEDED_STARTS`): height, attitude and bar angles, (seeds, 5)."""
        rows = []
        for seed in range(self.seed_count):
            unit = randomise_leg_lengths(self.vehicle, seed=seed)
            rows.append([-standing_height(unit), *standing_attitude(unit), *standing_attitude(unit)])
        return np.array(rows)

    @cached_property
    def seeded_parameters(self) -> tuple[NDArray[np.intp], NDArray[np.uint64]]:
        """Indices of 64-bit words in the model's parameters that depend on the seed (m,), and their values (seeds,
        m).
        """

        def words(vehicle: Vehicle) -> NDArray[np.uint64]:
            return np.frombuffer(model_parameters(vehicle).tobytes(), np.uint64)

        rows = np.array([words(randomise_leg_lengths(self.vehicle, seed=k)) for k in range(self.seed_count)])
        changing = np.flatnonzero((rows != words(self.vehicle)).any(axis=0))
        return changing, rows[:, changing]

    # Variables

    def list_outputs(self) -> list[SensedOutput]:
        """Return the outputs: readings of each sensor with time and validity, and then the estimate."""
        return [*self._reading_outputs(), *_estimate_outputs()]

    def _reading_outputs(self) -> Iterator[SensedOutput]:
        for name, sensor in _named_sensors(self._sensors):
            if isinstance(sensor, Imu):
                places = {"acceleration": ("output[0]", 0), "rates": ("output[0]", 3), "clipping": ("output[1]", 0)}
                parts: dict[str, Any] = dict.fromkeys(places, slice(0, 3))
            else:
                assert isinstance(sensor, PeriodicSensor)
                parts = dict(sensor.published_readings)
                places = dict.fromkeys(parts, ("rows[0]", ROW_FIRST_VALUE_INDEX))
                times = (
                    ("time", "s", ROW_MEASURED_TIME_INDEX, "time of the last reading"),
                    ("valid", "", ROW_IS_VALID_INDEX, "1 if the sensor marks the last reading valid, 0 if not"),
                )
                for word, unit, column, meaning in times:
                    value = f"sensors->{name}.rows[0][{column}]"
                    yield SensedOutput(f"sensor.{name}.{word}", unit, f"{name.replace('_', ' ')}: {meaning}", value)
            for reading, part in parts.items():
                row, (member, first) = READINGS[reading], places[reading]
                if isinstance(sensor, PeriodicSensor):
                    first += part if isinstance(part, int) else part.start
                count = 1 if isinstance(part, int) else part.stop - part.start
                labels = DIMENSION_LABELS.get(row.dim or "", range(count))
                for k in range(count):
                    end = "" if row.dim is None else f"_{_COMPONENT_NAMES.get(str(labels[k]), labels[k])}"
                    unit = "rad" if row.unit_component_count is not None and k >= row.unit_component_count else row.unit
                    value = f"sensors->{name}.{member}[{first + k}]"
                    yield SensedOutput(f"sensor.{reading}{end}", "" if unit == "1" else unit, row.meaning, value)

    # C texts

    def translate_functions(self, translation: CTranslation) -> str:
        """Translate the functions of the sensors; return the C text that samples all of them."""
        structs, steps, calls = [], [], []
        translation.add_function(write_true_attitude, [_STATE_TABLE, _VECTOR_3_TABLE])
        translation.add_function(compute_battery_supply, [_STATE_TABLE, C_DOUBLE, C_DOUBLE, translation.record])
        for name, sensor in _named_sensors(self._sensors):
            arrays = self._arrays[name]
            members = "".join(f"    {_declare_member(member, array)};\n" for member, array in arrays)
            structs.append(f"typedef struct {{\n{members}}} {name}_sensor;\n")
            if isinstance(sensor, Imu):
                steps.append(_render_imu(translation, sensor))
                calls.append("    sample_imu_sensor(t, x, &sensors->imu, filter);")
            else:
                assert isinstance(sensor, PeriodicSensor)
                steps.append(_render_periodic(translation, name, sensor))
                calls.append(f"    if (sample_{name}_sensor(t, x, attitude, supply, &sensors->{name})) {{")
                calls += self._render_readings_to_filter(translation, name, sensor)
                calls.append("    }")
        fields = "".join(f"    {name}_sensor {name};\n" for name in self._arrays)
        head = (
            "/* Sample all sensors at a time (s) and pass new readings to the filter. */\n"
            "static void sample_sensors(double t, const double *x, const double *attitude, const double *supply,\n"
            "    sensor_set *sensors, filter_unit *filter)\n{\n"
        )
        outputs = "".join(f"    out[{k}] = {o.value_in_c};\n" for k, o in enumerate(self.list_outputs()))
        return "\n".join([
            *structs,
            f"typedef struct {{\n{fields}}} sensor_set;\n",
            "typedef char sensors_are_words[sizeof(sensor_set) == 8 * SENSOR_WORD_COUNT ? 1 : -1];\n",
            *steps,
            head + "\n".join([*calls, "}", ""]),
            "/* Write the readings and the estimate. */",
            "static void write_sensed_outputs(const sensor_set *sensors, const filter_unit *filter, double *out)\n{\n"
            + outputs + "}\n",
        ])  # fmt: skip

    def _render_readings_to_filter(self, translation: CTranslation, name: str, sensor: PeriodicSensor) -> Iterator[str]:
        row = f"sensors->{name}.rows[0]"
        measured, valid = f"{row}[{ROW_MEASURED_TIME_INDEX}]", f"{row}[{ROW_IS_VALID_INDEX}]"
        for reading, part in sensor.published_readings.items():
            index = READINGS[reading].filter_index
            if index is None or not self._settings["is_fitted"][index]:
                continue
            at = ROW_FIRST_VALUE_INDEX + (part if isinstance(part, int) else part.start)
            if reading == "ranges":
                count = sensor.pending_rows.shape[1] - ROW_FIRST_VALUE_INDEX
                scan, ranges = TableType(C_DOUBLE, (count,)), TableType(C_DOUBLE, (3, count))
                made = translation.add_function(median_filter_ring_scan, [scan, C_DOUBLE, ranges, scan])
                longest = float(self.vehicle.range_ring.max_range).hex()
                yield f"        if (begin_reading(filter, {index}, t, {measured}, {valid})) {{"
                for k, beam in enumerate(fused_beam_indices(count)):
                    yield f"            filter->values[{READING_STARTS[index] + k}] = {row}[{at + beam}];"
                yield f"            {made.name}({row} + {at}, {longest}, filter->scans, filter->ranges);"
                yield "        }"
                continue
            yield f"        if (begin_reading(filter, {index}, t, {measured}, {valid})) {{"
            for k in range(READING_WIDTHS[index]):
                offset = f" - {float(SUBTRACTED_READING_OFFSETS[index])!r}" if SUBTRACTED_READING_OFFSETS[index] else ""
                yield f"            filter->values[{READING_STARTS[index] + k}] = {row}[{at + k}]{offset};"
            yield "        }"

    def render_filter_sizes(self) -> str:
        """Return the text of ``filter_sizes.h``."""
        kept, waiting = compute_filter_buffer_sizes(self._settings)
        words = math.ceil(make_memory_dtype(kept=kept, waiting=waiting).itemsize / 8)
        beams = max(1, int(self.vehicle.range_ring.count))
        numbers = {
            "FILTER_MEMORY_WORDS": words, "FILTER_VALUE_COUNT": INPUT_VALUE_COUNT, "FILTER_SENSOR_COUNT": SENSOR_COUNT,
            "FILTER_STATE_COUNT": STATE_COUNT, "FILTER_DEVIATION_COUNT": ERROR_STATE_COUNT,
            "FILTER_ATTITUDE": ERROR_ATTITUDE, "FILTER_BEAM_COUNT": beams,
            "FILTER_ACTUATORS": ACTUATOR_START, "FILTER_PUBLISH_INTERVAL": COVARIANCE_INTERVAL_TICKS,
            "SENSOR_WORD_COUNT": len(self.seeded_words[0]),
        }  # fmt: skip
        lines = [f"#define {name} {value}" for name, value in numbers.items()]
        longest = f"#define FILTER_MAX_RANGE {float(self.vehicle.range_ring.max_range).hex()}"
        return "\n".join(
            ["/* Sizes of one vehicle's sensors and filter, generated by mufly; do not edit. */", *lines, longest, ""]
        )

    def data_lines(self) -> Iterator[str]:
        """Return the lines of ``vehicle_data.h`` with the numbers of the sensors, for all seeds."""
        words, changing, values = self.seeded_words
        places, own = self.seeded_parameters
        yield f"enum {{ SEED_COUNT = {self.seed_count}, SEEDED_WORD_COUNT = {len(changing)}, "
        yield f"    SEEDED_PARAMETER_COUNT = {len(places)}, SEEDED_START_COUNT = {len(SEEDED_STARTS)} }};"
        yield f"#define SENSOR_RATE_HZ {SENSOR_RATE_HZ!r}"
        yield ""
        yield "/* Constants and memory of the sensors as bits: place and value of all words that are not zero. */"
        filled = np.flatnonzero(words)
        yield f"static const struct {{ uint32_t place; uint64_t bits; }} SENSOR_WORDS[{len(filled)}] = {{"
        yield from _wrap_entries(f"{{{k}, {_format_word(words[k])}}}" for k in filled)
        yield "};"
        yield "/* Places and values of those that depend on the seed; the same for the model's parameters. */"
        for name, where, rows in (("SEEDED_WORD", changing, values), ("SEEDED_PARAMETER", places, own)):
            count = max(1, len(where))
            yield f"static const uint32_t {name}_PLACES[{count}] = {{"
            yield from _wrap_entries(map(str, where if len(where) else [0]))
            yield "};"
            yield f"static const uint64_t {name}S[SEED_COUNT][{count}] = {{"
            for row in rows:
                yield "    {"
                yield from _wrap_entries(map(_format_word, row if len(where) else [np.uint64(0)]))
                yield "    },"
            yield "};"
        yield "/* Start values of each seed: the vehicle stands on legs of random lengths. */"
        yield "static const double SEEDED_STARTS[SEED_COUNT][SEEDED_START_COUNT] = {"
        for start in self.seeded_start_values:
            yield f"    {{{', '.join(float(v).hex() for v in start)}}},"
        yield "};"


def _named_sensors(sensors: FittedSensors) -> Iterator[tuple[str, Any]]:
    faulty = [one for one in sensors.sensors if isinstance(one, FaultySensor)]  # each sensor, with its faults
    present = {type(one.sensor).__name__: one.sensor for one in faulty}
    for name in SENSORS:
        sensor = present.get(SENSOR_CLASSES[name].__name__)
        if sensor is not None:
            yield name, sensor


def _sensor_arrays(sensors: FittedSensors) -> Iterator[tuple[str, list[tuple[str, NDArray[Any]]]]]:
    """Yield the arrays of each sensor, named as the members of the sensor's C struct."""
    for name, sensor in _named_sensors(sensors):
        if isinstance(sensor, Imu):
            source, normals, clock, last_state, output, unit = sensor.sampling_arguments(1.0 / SENSOR_RATE_HZ)
            arrays = {"source": source, "normals": normals, "clock": clock, "last_state": last_state, "output": output,
                      "mounting": sensor.mounting}  # fmt: skip
            yield name, [*arrays.items(), *((f"part_{k}", part) for k, part in enumerate(unit))]
        else:
            arguments = sensor.sampling_arguments
            parts = [(f"part_{k}", part) for k, part in enumerate(arguments[-1])]
            yield name, [*zip(("clock", "counts", "rows", "source"), arguments[:-1], strict=True), *parts]


def _pack_words(arrays: Iterator[tuple[str, list[tuple[str, NDArray[Any]]]]]) -> NDArray[np.uint64]:
    """Return the bits of all arrays in sequence; an empty array counts as one row of zeros, as in C."""
    out = []
    for _, members in arrays:
        for _, array in members:
            whole = array if array.size else np.zeros((1, *array.shape[1:]))
            out.append(np.ascontiguousarray(whole).reshape(-1).view(np.uint64))
    return np.concatenate(out)


def _table_type(array: NDArray[Any]) -> TableType:
    return TableType(_C_TYPE_BY_KIND[array.dtype.kind], array.shape)


def _declare_member(name: str, array: NDArray[Any]) -> str:
    sizes = "".join(f"[{max(1, n) if k == 0 else n}]" for k, n in enumerate(array.shape))
    return f"{_C_TYPE_BY_KIND[array.dtype.kind]} {name}{sizes}"


def _render_imu(translation: CTranslation, imu: Imu) -> str:
    source, normals, clock, last_state, output, unit = imu.sampling_arguments(1.0 / SENSOR_RATE_HZ)
    parts = TableTupleType(tuple(map(_table_type, unit)))
    places = ", ".join(f"s->part_{k}" for k in range(len(unit)))
    common = [_table_type(a) for a in (clock, last_state, output)]
    begin = translation.add_function(
        make_first_imu_reading, [_STATE_TABLE, C_DOUBLE, *common, _table_type(imu.mounting), parts]
    )
    sample = translation.add_function(
        sample_imu, [_STATE_TABLE, C_DOUBLE, _table_type(source), _table_type(normals), *common, parts]
    )
    lines = "\n".join(
        f"        filter->values[{start} + k] = s->output{place};"
        for start, place in (
            (READING_STARTS[READINGS["acceleration"].filter_index or 0], "[0][k]"),
            (READING_STARTS[READINGS["rates"].filter_index or 0], "[0][3 + k]"),
            (CLIPPING_START, "[1][k]"),
        )
    )
    both = [READINGS[name].filter_index for name in ("acceleration", "rates")]
    fresh = " ".join(f"filter->is_new[{k}] = 1; filter->reading_times[{k}] = t; filter->ages[{k}] = 0.0;" for k in both)
    return f"""\
/* Sample the inertial unit and pass its readings to the filter. */
static void sample_imu_sensor(double t, const double *x, imu_sensor *s, filter_unit *filter)
{{
    if (isnan(s->clock[0])) {{
        {begin.name}(x, t, s->clock, s->last_state, s->output, s->mounting,
            {places});
    }} else {{
        {sample.name}(x, t, s->source, s->normals, s->clock, s->last_state, s->output,
            {places});
    }}
    for (int k = 0; k < 3; k++) {{
{lines}
    }}
    {fresh}
}}
"""


def _render_periodic(translation: CTranslation, name: str, sensor: PeriodicSensor) -> str:
    clock, counts, rows, source, parts = sensor.sampling_arguments
    row = TableType(C_DOUBLE, rows.shape[1:])
    measure = translation.add_function(
        type(sensor).sample_function,
        [
            C_DOUBLE,
            _STATE_TABLE,
            _VECTOR_3_TABLE,
            _VECTOR_2_TABLE,
            _table_type(source),
            TableTupleType(tuple(map(_table_type, parts))),
            row,
        ],
    )
    due = translation.add_function(schedule_next_if_due, [C_DOUBLE, _table_type(clock)])
    publish = translation.add_function(
        publish_if_due, [C_DOUBLE, C_DOUBLE, _table_type(clock), _table_type(counts), _table_type(rows)]
    )
    places = ", ".join(f"s->part_{k}" for k in range(len(parts)))
    return f"""\
/* Sample {name.replace("_", " ")}; return whether a reading is published. */
static bool sample_{name}_sensor(
    double t, const double *x, const double *attitude, const double *supply, {name}_sensor *s)
{{
    double wait = -1.0; /* no measurement */
    if (t < s->clock[{CLOCK_NEXT_SAMPLE_INDEX}]) {{
        return false;
    }}
    if ({due.name}(t, s->clock)) {{
        wait = {measure.name}(t, x, attitude, supply, s->source,
            {places}, s->rows[1 + s->counts[{PENDING_COUNT_INDEX}]]);
    }}
    return {publish.name}(t, wait, s->clock, s->counts, s->rows);
}}
"""


def _estimate_outputs() -> Iterator[SensedOutput]:
    """Return the outputs of the filter: estimate, standard deviations, validity."""
    ned, body, angles = ("north", "east", "down"), ("x", "y", "z"), ("roll", "pitch", "yaw")
    groups: Sequence[tuple[str, Sequence[str], str, str, str, int | None]] = (
        ("position_", ned, "m", "position", f"state[{NOMINAL_POSITION} + k]", ERROR_POSITION),
        ("velocity_", ned, "m/s", "velocity", f"state[{NOMINAL_VELOCITY} + k]", ERROR_VELOCITY),
        ("", angles, "rad", "angle", "angles[k]", ERROR_ATTITUDE),
        ("", [f"{a}_rate" for a in angles], "rad/s", "body rate", "rates[k]", None),
        ("gyro_bias_", body, "rad/s", "bias of the gyroscope", f"state[{NOMINAL_GYRO_BIAS} + k]", ERROR_GYRO_BIAS),
        ("accelerometer_bias_", body, "m/s^2", "bias of the accelerometer", f"state[{NOMINAL_ACCEL_BIAS} + k]",
         ERROR_ACCEL_BIAS),
        ("wind_", ned[:2], "m/s", "wind", f"state[{NOMINAL_WIND} + k]", ERROR_WIND),
        ("thrust_scale", [""], "", "thrust over that of the model", f"state[{NOMINAL_THRUST_SCALE} + k]",
         ERROR_THRUST_SCALE),
    )  # fmt: skip
    for prefix, ends, unit, meaning, place, error in groups:
        for k, end in enumerate(ends):
            value, name = "filter->" + place.replace("k]", f"{k}]"), f"{prefix}{end}"
            which = f", {end.removesuffix('_rate')}" if end else ""
            yield SensedOutput(f"estimate.{name}", unit, f"estimate: {meaning}{which}", value)
            if error is not None:
                about = f"standard deviation of the estimate: {meaning}{which}"
                yield SensedOutput(f"estimate.sigma.{name}", unit, about, f"filter->deviations[{error + k}]")
    yield SensedOutput("estimate.valid", "", "1 if the estimate may be used for flight, 0 if not", "filter->is_valid")


def _format_word(word: np.uint64) -> str:
    return f"UINT64_C(0x{int(word):016x})"


def _wrap_entries(entries: Any, per_line: int = 4) -> Iterator[str]:
    listed = list(entries)
    for k in range(0, len(listed), per_line):
        yield f"    {', '.join(listed[k : k + per_line])},"
