"""What does it feel? Readings made from the true state and the world."""

from mufly.sensors.faults import FAULT_KINDS, FAULT_TARGETS, Fault, parse_fault
from mufly.sensors.imu import Imu
from mufly.sensors.magnetometer import MagnetometerSensor, earth_field
from mufly.sensors.periodic import GaussMarkov, PeriodicSensor
from mufly.sensors.readings import (
    READING_KINDS,
    IdealBattery,
    IdealMotion,
    IdealRing,
    Reading,
    Readings,
    Sensor,
    SensorSet,
    Truth,
    beam_angles,
    beam_directions,
    ideal_ranges,
    ideal_sensors,
    unwrap_near,
)
from mufly.sensors.ring_camera import RingCamera
from mufly.sensors.sensor_suite import (
    SENSOR_TABLES,
    FittedSensors,
    check_faults,
    draw_leaning_vehicle,
    fitted_sensors,
)
from mufly.sensors.sonar import UltrasonicSensor

__all__ = [
    "FAULT_KINDS",
    "FAULT_TARGETS",
    "READING_KINDS",
    "SENSOR_TABLES",
    "Fault",
    "FittedSensors",
    "GaussMarkov",
    "IdealBattery",
    "IdealMotion",
    "IdealRing",
    "Imu",
    "MagnetometerSensor",
    "PeriodicSensor",
    "Reading",
    "Readings",
    "RingCamera",
    "Sensor",
    "SensorSet",
    "Truth",
    "UltrasonicSensor",
    "beam_angles",
    "beam_directions",
    "check_faults",
    "draw_leaning_vehicle",
    "earth_field",
    "fitted_sensors",
    "ideal_ranges",
    "ideal_sensors",
    "parse_fault",
    "unwrap_near",
]
