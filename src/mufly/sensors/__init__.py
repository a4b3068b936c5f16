"""What does it feel? Readings made from the true state and the world."""

from mufly.sensors.faults import KINDS, TARGETS, Fault, parse_fault
from mufly.sensors.imu import Imu
from mufly.sensors.magnetometer import MagnetometerSensor, earth_field
from mufly.sensors.periodic import Periodic, Wander
from mufly.sensors.readings import (
    READINGS,
    IdealBattery,
    IdealMotion,
    IdealRing,
    Reading,
    Readings,
    Sensor,
    Sensors,
    Truth,
    beam_angles,
    beam_directions,
    ideal_ranges,
    ideal_sensors,
    nearest_turn,
)
from mufly.sensors.ring_camera import RingCamera
from mufly.sensors.sonar import UltrasonicSensor
from mufly.sensors.suite import FITTED, FittedSensors, check_faults, fitted_sensors, leaning

__all__ = [
    "FITTED",
    "KINDS",
    "READINGS",
    "TARGETS",
    "Fault",
    "FittedSensors",
    "IdealBattery",
    "IdealMotion",
    "IdealRing",
    "Imu",
    "MagnetometerSensor",
    "Periodic",
    "Reading",
    "Readings",
    "RingCamera",
    "Sensor",
    "Sensors",
    "Truth",
    "UltrasonicSensor",
    "Wander",
    "beam_angles",
    "beam_directions",
    "check_faults",
    "earth_field",
    "fitted_sensors",
    "ideal_ranges",
    "ideal_sensors",
    "leaning",
    "nearest_turn",
    "parse_fault",
]
