"""Geometry of a vehicle's range sensors for ROS 2 messages."""

from __future__ import annotations

import tempfile
from pathlib import Path

from mufly.errors import InputError
from mufly.logs import RangeSensorGeometry
from mufly.vehicle import Vehicle, load_vehicle


def range_sensor_geometry(vehicle: Vehicle) -> RangeSensorGeometry:
    """Return the geometry of a vehicle's range sensors: the sonar and the ring of horizontal beams.

    It consists of the sonar's cone angle, the direction of the ring's first beam, and the range limits of both.
    """
    ring, sensors = vehicle.range_ring, vehicle.sensors
    limits = RangeSensorGeometry(
        first_beam_rad=float(ring.first_angle), ring_min_m=float(ring.min_range), ring_max_m=float(ring.max_range)
    )
    if sensors is None or sensors.sonar is None:
        return limits
    sonar = sensors.sonar
    return limits._replace(
        sonar_cone_rad=float(sonar.cone_angle), sonar_min_m=float(sonar.min_range), sonar_max_m=float(sonar.max_range)
    )


def recorded_range_sensor_geometry(vehicle_file: bytes) -> RangeSensorGeometry:
    """Return the limits of the range sensors from the vehicle file of a recording; empty limits if the file is
    unreadable.
    """
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "vehicle.toml"
        path.write_bytes(vehicle_file)
        try:
            return range_sensor_geometry(load_vehicle(path))
        except InputError:
            return RangeSensorGeometry()
