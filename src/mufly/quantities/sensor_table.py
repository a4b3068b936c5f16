"""Table of sensors, the source of all other lists of sensors and readings.

Recordings (:mod:`mufly.quantities.quantity_table`), faults (:mod:`mufly.sensors.faults`), the records of the filter
(:mod:`mufly.estimate.filter.filter_records`), messages, MAVLink and the ground station's page read it. A sensor also
has its model in a file of :mod:`mufly.sensors`, its class in :data:`mufly.sensors.sensor_suite.SENSOR_CLASSES`, its
parameters in :mod:`mufly.vehicle.sensor_schema`, and, if it is fused, its noise in ``filter_records`` and its
measurement model in :mod:`mufly.estimate.filter.measurements.fusion` (docs/how-to/add-a-sensor.md).
"""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True)
class ReadingRow:
    """Row of the sensor table: a quantity that a sensor reads.

    Attributes
    ----------
    name, unit, dim, meaning : str
        As in :class:`mufly.quantities.quantity_table.Quantity`; its name in a recording is ``measured_NAME``.
    is_timed : bool
        True if it is recorded with its time and validity; else it shares those of the first reading of its sensor.
    variance : (str, str) or None
        Unit and meaning of an optional variance of the reading.
    column_words : str
        Words that identify columns of such readings in external logs.
    fault : str
        Name in faults (``sonar.jump=0.3@15s``); empty without faults.
    default_fault_amounts : tuple of 4 floats
        Default amounts: jump, drift (1/s), clipping limit, stuck value.
    filter_index : int or None
        Index in all tables of the filter; None if the filter does not use it.
    filter_datum : float
        Offset subtracted by the filter to preserve single precision.
    is_queued : bool
        True if a measurement is queued and fused at the delayed horizon of the filter.
    source : str
        Name of the sensor in messages to users.
    unit_component_count : int or None
        Number of leading components in the unit, the rest are angles (rad); None for all.
    supports : tuple of str
        Estimates supported by the reading: ``position``, ``height``, ``tilt``, ``heading``.
    is_attitude_aid : bool
        Whether the reading is an independent attitude aid; rejection of two aids indicates a wrong attitude.
    innovation_unit : str
        Unit of the innovation, if different from that of the reading.
    mavlink_failure_unit, status_bit : str
        Names in MAVLink, after ``FAILURE_UNIT_`` and ``MAV_SYS_STATUS_``.
    test_ratios : tuple of (str, str)
        Fields of ESTIMATOR_STATUS with the test ratio, and their names on the page.
    """

    name: str
    unit: str
    dim: str | None = None
    meaning: str
    is_timed: bool = True
    variance: tuple[str, str] | None = None
    column_words: str = ""
    fault: str = ""
    default_fault_amounts: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 0.0)
    filter_index: int | None = None
    filter_datum: float = 0.0
    is_queued: bool = False
    source: str = ""
    unit_component_count: int | None = None
    supports: tuple[str, ...] = ()
    is_attitude_aid: bool = False
    innovation_unit: str = ""
    mavlink_failure_unit: str = ""
    status_bit: str = ""
    test_ratios: tuple[tuple[str, str], ...] = ()


SENSORS: dict[str, tuple[ReadingRow, ...]] = {
    "imu": (
        ReadingRow(
            name="acceleration", unit="m/s^2", dim="body", meaning="measured specific force along the body axes",
            fault="accelerometer", default_fault_amounts=(3.0, 0.3, 20.0, 0.0),
            column_words="accelerometer accelerometers", filter_index=0, source="accelerometer", supports=("tilt",),
            mavlink_failure_unit="SENSOR_ACCEL", status_bit="SENSOR_3D_ACCEL",
        ),
        ReadingRow(
            name="rates", unit="rad/s", dim="rate", meaning="measured body rates",
            fault="gyro", default_fault_amounts=(0.2, 0.02, 0.5, 0.0),
            filter_index=1, source="gyroscope", supports=("tilt", "heading"),
            mavlink_failure_unit="SENSOR_GYRO", status_bit="SENSOR_3D_GYRO",
        ),
        ReadingRow(
            name="clipping", unit="1", dim="body", meaning="share of the accelerometer's samples that it clipped",
            is_timed=False,
        ),
        ReadingRow(name="temperature", unit="K", meaning="temperature of the inertial unit", is_timed=False),
    ),
    "sonar": (
        ReadingRow(
            name="ground_distance", unit="m", meaning="distance to what is below, by ultrasound",
            fault="sonar", default_fault_amounts=(0.3, 0.05, 0.5, 1.0), column_words="sonar",
            filter_index=2, is_queued=True, source="sonar", supports=("height",), is_attitude_aid=True,
            mavlink_failure_unit="SENSOR_DISTANCE_SENSOR", test_ratios=(("hagl_ratio", "height above ground"),),
        ),
    ),
    "ring_camera": (
        ReadingRow(
            name="ranges", unit="m", dim="beam", meaning="distance along the beams of the laser ring",
            fault="ring", default_fault_amounts=(0.5, 0.1, 0.7, 0.3),
            filter_index=3, is_queued=True, source="laser ring", supports=("position",),
            status_bit="SENSOR_PROXIMITY",
        ),
    ),
    "pressure": (
        ReadingRow(
            name="pressure", unit="Pa", meaning="air pressure",
            fault="pressure", default_fault_amounts=(20.0, 2.0, 1e5, 1e5),
            filter_index=4, filter_datum=101_325.0, is_queued=True, source="pressure sensor", supports=("height",),
            mavlink_failure_unit="SENSOR_BARO", test_ratios=(("pos_vert_ratio", "height"),),
        ),
    ),
    "magnetometer": (
        ReadingRow(
            name="magnetic_field", unit="T", dim="body", meaning="magnetic field along the body axes",
            fault="magnetometer", default_fault_amounts=(2e-5, 1e-6, 2e-5, 0.0),
            column_words="mag magnetometer magnetic compass",
            filter_index=5, is_queued=True, source="magnetometer", supports=("heading",), is_attitude_aid=True,
            innovation_unit="rad",
            mavlink_failure_unit="SENSOR_MAG", status_bit="SENSOR_3D_MAG", test_ratios=(("mag_ratio", "magnetometer"),),
        ),
    ),
    "rotor_speed": (
        ReadingRow(
            name="rotor_speed", unit="rad/s", dim="rotor", meaning="measured rotor speed",
            fault="rotor_speed", default_fault_amounts=(50.0, 5.0, 200.0, 0.0),
            filter_index=6, source="rotor speed",
        ),
    ),
    "battery": (
        ReadingRow(
            name="battery_voltage", unit="V", meaning="battery voltage measured by the battery monitor",
            fault="battery", default_fault_amounts=(1.0, 0.1, 6.0, 6.0),
            filter_index=8, source="battery monitor",
            mavlink_failure_unit="SYSTEM_BATTERY", status_bit="SENSOR_BATTERY",
        ),
        ReadingRow(name="battery_current", unit="A", meaning="battery current measured by the battery monitor"),
    ),
    "position_fix": (
        ReadingRow(
            name="position_fix", unit="m", dim="fix", meaning="position and heading (rad) of the external fix",
            variance=("m^2", "variance in the message of the position fix, if given (heading: rad^2)"),
            fault="position", default_fault_amounts=(0.5, 0.1, 0.5, 0.0),
            filter_index=7, is_queued=True, source="position fix", supports=("position", "height", "heading"),
            unit_component_count=3, is_attitude_aid=True,
            mavlink_failure_unit="SENSOR_VIO", status_bit="SENSOR_VISION_POSITION",
            test_ratios=(("vel_ratio", "velocity"), ("pos_horiz_ratio", "position")),
        ),
    ),
}  # fmt: skip
"""Readings of each sensor by its table ``[sensors.NAME]`` of a vehicle file. Random numbers are drawn in this order;
append new sensors at the end."""
READINGS: dict[str, ReadingRow] = {row.name: row for rows in SENSORS.values() for row in rows}
"""All readings by name, in the order of the columns of a recording."""
CHECKED: tuple[ReadingRow, ...] = tuple(
    sorted((row for row in READINGS.values() if row.filter_index is not None), key=lambda row: row.filter_index or 0)
)
"""Readings used by the filter, in the order of its tables."""
