"""Table of quantities: name, axes, unit, meaning and MAVLink fields.

The prefix of a name states the source of a signal: ``truth_``, ``measured_``, ``estimated_`` or ``reference_`` before
``position``, ``velocity``, ... Recorder, logs, station, link and identification read this table; a new signal is a new
row. A name alone is a whole variable, ``measured_attitude.roll`` one component of it, and ``measured_attitude_roll``
the same component as a column of a table.

Labels of axes: N-E-D for positions and velocities, roll-pitch-yaw for angles, p-q-r for body rates. Beams count from 0,
channels from 1; their numbers depend on the vehicle.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from dataclasses import field as own_field
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mufly.errors import InputError
from mufly.quantities.sensor_table import CHECKED, READINGS, ReadingRow
from mufly.quantities.units import unit_conversion

if TYPE_CHECKING:
    import xarray as xr

DIMENSION_LABELS: Mapping[str, tuple[str, ...] | tuple[int, ...]] = {
    "axis": ("N", "E", "D"),
    "angle": ("roll", "pitch", "yaw"),
    "rate": ("p", "q", "r"),
    "rotor": ("upper", "lower"),
    "servo": (1, 2),
    "body": ("x", "y", "z"),
    "control": ("roll", "pitch", "yaw", "thrust"),
    "level": ("N", "E"),
    "fix": ("N", "E", "D", "heading"),
}
"""Labels of every dimension except ``beam``, which counts from 0, and ``channel`` and ``actuator``, from 1."""

SIGNAL_SOURCES: Mapping[str, str] = {
    "truth": "true",
    "measured": "measured",
    "estimated": "estimated",
    "reference": "reference",
}
"""Sources of signals: prefix of the name, and description. Each has the topic ``/prefix`` in a recording."""


class MavlinkSource(NamedTuple):
    """MAVLink fields that transmit a quantity: message, fields (one per component, separated by blanks), unit."""

    message: str
    fields: str
    unit: str


@dataclass(frozen=True)
class Quantity:
    """Row of the table of quantities.

    Attributes
    ----------
    name : str
        Variable of a dataset (``truth_position``).
    topic, field : str
        Topic and field in a recording (``/truth``, ``position``).
    dim : str or None
        Labelled dimension besides time (see :data:`DIMENSION_LABELS`), None for a scalar.
    units, long_name : str
        Unit and description in the variable's attributes, the schema and the CSV header; ``"1"`` is dimensionless.
    recording_kinds : str
        Kinds of recordings that contain it. ``flight``: every recording; ``sensors``: flights on sensors; ``station``:
        recordings of a station. Empty: only external logs.
    mavlink_sources : tuple of MavlinkSource
        Fields equal to the quantity except for the unit (https://mavlink.io/en/messages/common.html).
    """

    name: str
    topic: str
    field: str
    dim: str | None
    units: str
    long_name: str
    recording_kinds: str = own_field(default="flight", compare=False)
    mavlink_sources: tuple[MavlinkSource, ...] = own_field(default=(), compare=False)

    @property
    def component_labels(self) -> tuple[str, ...] | tuple[int, ...]:
        """Labels of the components; empty for a scalar, and for beams and channels, whose number varies."""
        return DIMENSION_LABELS.get(self.dim or "", ())


def _channel_fields(pattern: str) -> str:
    return " ".join(pattern.format(k) for k in range(1, 9))


def _make_quantity(
    name: str, dim: str | None, units: str, long_name: str, *mavlink_sources: MavlinkSource,
    topic: str = "", kinds: str = "flight",
) -> Quantity:  # fmt: skip
    """Return a row of the table of quantities.

    Without a ``topic``, the first word of the name is the topic, and the rest the field.
    """
    first, _, rest = name.partition("_")
    where = (topic, name) if topic else (f"/{first}", rest)
    return Quantity(name, *where, dim, units, long_name, kinds, mavlink_sources)


def _make_measured_quantities(row: ReadingRow) -> Iterator[Quantity]:
    """Yield the rows of the table for a sensor reading: its value and, if it has them, time, validity, variance."""
    name, words = row.name, row.name.replace("_", " ")
    yield Quantity(f"measured_{name}", "/measured", name, row.dim, row.unit, row.meaning, "sensors")
    if row.is_timed:
        when = f"when the {words} was measured"
        stands = f"1 where the sensor stands by its {words}, 0 where it does not"
        yield Quantity(f"measured_{name}_time", "/measured", f"{name}_time", None, "s", when, "sensors")
        yield Quantity(f"measured_{name}_valid", "/measured", f"{name}_valid", None, "1", stands, "sensors")
    if row.variance is not None:
        yield Quantity(f"measured_{name}_variance", "/measured", f"{name}_variance", row.dim, *row.variance, "sensors")


def _make_innovation_quantities(reading: str) -> tuple[Quantity, ...]:
    name = reading.replace("_", " ")
    return (
        Quantity(f"innovation_{reading}", "/checks", f"innovation_{reading}", None, "1",
                 f"{name}: measured less expected, in standard deviations of that", "sensors station"),
        Quantity(f"status_{reading}", "/checks", f"status_{reading}", None, "1",
                 f"{name}: 0 waiting, 1 fused, 2 rejected, 3 missing, 4 faulty", "sensors station"),
    )  # fmt: skip


READINGS_WITH_FUSION_STATUS = tuple(row.name for row in CHECKED)
"""Readings with a fusion status of the estimator."""

FUSION_STATUSES = ("waiting", "fused", "rejected", "missing", "faulty")
"""Fusion statuses of a reading; a recording contains the index in this list."""

_CENTRE_OF_GRAVITY_TEXT = "of the centre of gravity"
_RAW_CHANNEL_FIELDS = _channel_fields("chan{}_raw")
QUANTITIES: tuple[Quantity, ...] = (
    _make_quantity("truth_position", "axis", "m", f"true position {_CENTRE_OF_GRAVITY_TEXT}"),
    _make_quantity("truth_velocity", "axis", "m/s", f"true velocity {_CENTRE_OF_GRAVITY_TEXT}"),
    _make_quantity("truth_attitude", "angle", "rad", "true attitude"),
    _make_quantity("truth_rates", "rate", "rad/s", "true body rates"),
    _make_quantity("truth_rotor_speed", "rotor", "rad/s", "true rotor speed"),
    _make_quantity("wind", "axis", "m/s", "velocity of the air", topic="/truth"),
    _make_quantity(
        "measured_position",
        "axis",
        "m",
        f"measured position {_CENTRE_OF_GRAVITY_TEXT}",
        MavlinkSource("VISION_POSITION_ESTIMATE", "x y z", "m"),
    ),
    _make_quantity("measured_velocity", "axis", "m/s", f"measured velocity {_CENTRE_OF_GRAVITY_TEXT}"),
    _make_quantity(
        "measured_attitude",
        "angle",
        "rad",
        "measured attitude",
        MavlinkSource("VISION_POSITION_ESTIMATE", "roll pitch yaw", "rad"),
    ),
    _make_quantity("measured_rates", "rate", "rad/s", "measured body rates"),
    _make_quantity(
        "measured_rotor_speed",
        "rotor",
        "rad/s",
        "measured rotor speed",
        MavlinkSource("RAW_RPM", "frequency frequency", "rpm"),
        kinds="sensors station",
    ),
    *(
        signal
        for row in READINGS.values()
        for signal in _make_measured_quantities(row)
        if signal.name not in ("measured_rates", "measured_rotor_speed")  # above
    ),
    _make_quantity(
        "estimated_position",
        "axis",
        "m",
        "position as estimated on board",
        MavlinkSource("LOCAL_POSITION_NED", "x y z", "m"),
        kinds="sensors station",
    ),
    _make_quantity(
        "estimated_velocity",
        "axis",
        "m/s",
        "velocity as estimated on board",
        MavlinkSource("LOCAL_POSITION_NED", "vx vy vz", "m/s"),
        kinds="sensors station",
    ),
    _make_quantity(
        "estimated_attitude",
        "angle",
        "rad",
        "attitude as estimated on board",
        MavlinkSource("ATTITUDE", "roll pitch yaw", "rad"),
        kinds="sensors station",
    ),
    _make_quantity(
        "estimated_rates",
        "rate",
        "rad/s",
        "body rates as estimated on board",
        MavlinkSource("ATTITUDE", "rollspeed pitchspeed yawspeed", "rad/s"),
        kinds="sensors station",
    ),
    _make_quantity(
        "estimated_position_sigma",
        "axis",
        "m",
        "standard deviation of the position as estimated on board",
        kinds="sensors station",
    ),
    _make_quantity(
        "estimated_velocity_sigma",
        "axis",
        "m/s",
        "standard deviation of the velocity as estimated on board",
        kinds="sensors station",
    ),
    _make_quantity(
        "estimated_attitude_sigma",
        "angle",
        "rad",
        "standard deviation of the attitude as estimated on board",
        kinds="sensors station",
    ),
    _make_quantity(
        "estimated_rates_sigma",
        "rate",
        "rad/s",
        "standard deviation of the body rates as estimated on board",
        kinds="sensors",
    ),
    _make_quantity("estimated_gyro_bias", "rate", "rad/s", "bias of the gyroscopes", kinds="sensors"),
    _make_quantity("estimated_accelerometer_bias", "body", "m/s^2", "bias of the accelerometers", kinds="sensors"),
    _make_quantity("estimated_floor_height", None, "m", "height of what is below the helicopter", kinds="sensors"),
    _make_quantity(
        "estimated_fix_bias", "fix", "m", "what fixes are off by for the time being (heading: rad)", kinds="sensors"
    ),
    _make_quantity("estimated_wind", "level", "m/s", "velocity of the air", kinds="sensors station"),
    _make_quantity("estimated_thrust_scale", None, "1", "thrust in that of the rotor model", kinds="sensors"),
    _make_quantity("estimated_valid", None, "1", "1 where the estimator stands by it", kinds="sensors"),
    _make_quantity(
        "reference_position",
        "axis",
        "m",
        "reference position",
        MavlinkSource("POSITION_TARGET_LOCAL_NED", "x y z", "m"),
    ),
    _make_quantity(
        "reference_velocity",
        "axis",
        "m/s",
        "reference velocity",
        MavlinkSource("POSITION_TARGET_LOCAL_NED", "vx vy vz", "m/s"),
    ),
    _make_quantity("reference_attitude", "angle", "rad", "commanded attitude"),
    _make_quantity(
        "motor_input",
        "rotor",
        "1",
        "motor input, 0 to 1",
        MavlinkSource("ACTUATOR_OUTPUT_STATUS", "actuator[0] actuator[1]", "1"),
        topic="/actuators",
    ),
    _make_quantity(
        "servo_input",
        "servo",
        "1",
        "servo input, -1 to 1",
        MavlinkSource("ACTUATOR_OUTPUT_STATUS", "actuator[2] actuator[3]", "1"),
        topic="/actuators",
    ),
    _make_quantity(
        "battery_voltage", None, "V", "battery terminal voltage", MavlinkSource("SYS_STATUS", "voltage_battery", "mV")
    ),
    _make_quantity(
        "battery_current", None, "A", "battery current", MavlinkSource("SYS_STATUS", "current_battery", "cA")
    ),
    _make_quantity(
        "battery_charge",
        None,
        "1",
        "battery charge left, 0 to 1",
        MavlinkSource("SYS_STATUS", "battery_remaining", "%"),
    ),
    _make_quantity("range", "beam", "m", "distance to the nearest obstacle along a beam", topic="/ranges"),
    *(q for reading in READINGS_WITH_FUSION_STATUS for q in _make_innovation_quantities(reading)),
    _make_quantity(
        "pilot_input",
        "channel",
        "us",
        "channel of the pilot's remote control, pulse length",
        MavlinkSource("RC_CHANNELS", _RAW_CHANNEL_FIELDS, "us"),
        MavlinkSource("RC_CHANNELS_RAW", _RAW_CHANNEL_FIELDS, "us"),
        kinds="station",
    ),
    _make_quantity("link_loss", None, "1", "share of packets lost of late, 0 to 1", kinds="station"),
    _make_quantity("link_rate", None, "Hz", "messages a second", kinds="station"),
    _make_quantity("actuator_control", "control", "1", "control to the mixer, -1 to 1", topic="/signals", kinds=""),
    _make_quantity(
        "actuator_output",
        "channel",
        "us",
        "output to the actuators, pulse length",
        MavlinkSource("SERVO_OUTPUT_RAW", _channel_fields("servo{}_raw"), "us"),
        topic="/signals",
        kinds="",
    ),
    _make_quantity(
        "actuator_command",
        "actuator",
        "1",
        "command to each actuator, a share of its full range: 0 to 1, or -1 to 1",
        topic="/signals",
        kinds="",
    ),
)
"""Quantities by name; recorded quantities are in the order of columns (column 0 is the time)."""

_QUANTITIES_BY_NAME = {quantity.name: quantity for quantity in QUANTITIES}


def find_quantity(name: str) -> Quantity | None:
    """Return the quantity of a variable name, None for a user-defined name.

    A quantity of one source is known for every source: ``reference_rates`` follows from ``measured_rates``.
    """
    if name in _QUANTITIES_BY_NAME:
        return _QUANTITIES_BY_NAME[name]
    source, _, rest = name.partition("_")
    like = _QUANTITIES_BY_NAME.get(f"measured_{rest}")
    if source not in SIGNAL_SOURCES or like is None:
        return None
    meaning = like.long_name.replace("measured", SIGNAL_SOURCES[source])
    return replace(like, name=name, topic=f"/{source}", long_name=meaning, recording_kinds="", mavlink_sources=())


def quantities_recorded_in(*keepers: str) -> tuple[Quantity, ...]:
    """Return the quantities stored in recordings of the given kinds: ``quantities_recorded_in("flight")``,
    ``quantities_recorded_in("flight", "station")``."""
    return tuple(q for q in QUANTITIES if not set(keepers).isdisjoint(q.recording_kinds.split()))


class PhysicalLimits(NamedTuple):
    """Physical limits of a quantity for any vehicle: range in its unit, and physical reason."""

    low: float
    high: float
    reason: str


_FRACTION_LIMIT_REASON = "a fraction of the full range ends at 1"
PHYSICAL_LIMITS: Mapping[str, PhysicalLimits] = {
    "rates": PhysicalLimits(-70.0, 70.0, "gyroscopes end at 4000 deg/s, 70 rad/s"),
    "acceleration": PhysicalLimits(-2000.0, 2000.0, "accelerometers end at 200 g, 2000 m/s^2"),
    "velocity": PhysicalLimits(-340.0, 340.0, "rotorcraft stay below the speed of sound, 340 m/s"),
    "position": PhysicalLimits(-1e6, 1e6, "north-east-down axes are of a flat earth, no further than 1000 km"),
    "rotor_speed": PhysicalLimits(-34_000.0, 34_000.0, "at 34000 rad/s a tip 10 mm out has the speed of sound"),
    "range": PhysicalLimits(0.0, 1000.0, "range finders of small aircraft measure less than 1 km"),
    "battery_voltage": PhysicalLimits(
        0.0, 120.0, "28 lithium cells in series, more than any such aircraft has, give 120 V"
    ),
    "battery_current": PhysicalLimits(-1000.0, 1000.0, "at 1000 A the leads of such a battery melt"),
    "battery_charge": PhysicalLimits(0.0, 1.01, "a battery is at most full"),
    "motor_input": PhysicalLimits(-1.01, 1.01, _FRACTION_LIMIT_REASON),
    "servo_input": PhysicalLimits(-1.01, 1.01, _FRACTION_LIMIT_REASON),
    "actuator_command": PhysicalLimits(-1.01, 1.01, _FRACTION_LIMIT_REASON),
    "actuator_output": PhysicalLimits(0.0, 3000.0, "pulses to servos and motor controllers last 0.1 to 2.6 ms"),
    "pilot_input": PhysicalLimits(0.0, 3000.0, "pulses of a remote control last 0.8 to 2.2 ms"),
}
"""Limits by the name of the quantity without its source. Angles have none, because they may count full turns."""


def find_physical_limits(name: str) -> PhysicalLimits | None:
    """Return the physical limits of a variable, None if there are none."""
    source, _, rest = name.partition("_")
    return PHYSICAL_LIMITS.get(rest if source in SIGNAL_SOURCES else name)


def list_mavlink_field_columns(message: str) -> tuple[tuple[str, str, float], ...]:
    """Return (field, column, factor) of the fields of a MAVLink message that equal quantities of the table.

    ``column`` is the name with its label (``estimated_attitude_roll``); field times factor is its value.
    """
    out: list[tuple[str, str, float]] = []
    for quantity in QUANTITIES:
        for wire in quantity.mavlink_sources:
            if wire.message == message:
                fields = wire.fields.split()
                labels = quantity.component_labels or range(1, len(fields) + 1)
                names = [f"{quantity.name}_{k}" for k in labels] if quantity.dim else [quantity.name]
                factor = 1.0 if wire.unit == quantity.units else unit_conversion(wire.unit, quantity.units)[1]
                out += [(f, name, factor) for f, name in zip(fields, names, strict=True)]
    return tuple(out)


def split_signal_name(text: str, where: str) -> tuple[Quantity | None, str, str | None]:
    """Split ``"measured_attitude.roll"`` into quantity, variable and label.

    Returns
    -------
    quantity : Quantity or None
        Quantity of the variable, None if unknown.
    variable : str
        Name of the variable.
    label : str or None
        Label of the component, None for the whole variable.

    Raises
    ------
    InputError
        If a known variable has no such label.
    """
    variable, _, label = text.partition(".")
    known = find_quantity(variable)
    if known is not None and label and known.component_labels and label not in map(str, known.component_labels):
        wanted = ", ".join(f"{variable}.{k}" for k in known.component_labels)
        raise InputError(where, text, "is not a component of this signal", f"use one of: {wanted}")
    if known is not None and label and known.dim is None:
        raise InputError(where, text, "is a scalar", f"write {variable}")
    if known is None and not variable.isidentifier():
        raise InputError(where, text, "is not a name for a signal", "use letters, digits and underscores")
    if label and known is None:
        raise InputError(where, text, "is not a signal with components", f"write {variable}_{label}")
    return known, variable, label or None


def parse_column_name(column: str) -> tuple[str, str | None] | None:
    """Split a column such as ``measured_attitude_roll`` into variable and label; None for other columns."""
    whole = find_quantity(column)
    if whole is not None:
        return (column, None) if whole.dim is None else None
    name, _, label = column.rpartition("_")
    known = find_quantity(name) if name else None
    if known is None or known.dim is None:
        return None
    ours = label in map(str, known.component_labels) if known.component_labels else label.isdigit()
    return (name, label) if ours else None


def make_labelled_dataset(time_s: NDArray[np.float64], values: Mapping[str, NDArray[np.float64]]) -> xr.Dataset:
    """Return a dataset over ``time`` of values (n,) or (n, components) by their names in the table, with units and
    labels."""
    import xarray as xr

    coords: dict[str, Any] = {"time": ("time", time_s, {"units": "s", "long_name": "time"})}
    variables: dict[str, Any] = {}
    for name, block in values.items():
        known = find_quantity(name)
        assert known is not None, name
        attrs = {"units": known.units, "long_name": known.long_name}
        variables[name] = (("time", known.dim) if known.dim else "time", block, attrs)
        coords |= {known.dim: list(known.component_labels)} if known.dim else {}
    return xr.Dataset(variables, coords)


def is_command_signal(name: str) -> bool:
    """Return whether a signal is a command; its jumps and constant periods are no faults."""
    return name.startswith(("reference_", "motor_input", "servo_input", "actuator_", "pilot_input"))
