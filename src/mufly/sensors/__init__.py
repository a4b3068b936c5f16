"""Sensor models: readings computed from the true state and the world."""

from mufly.sensors.faults import FAULT_KINDS, FAULT_TARGETS, Fault, parse_fault
from mufly.sensors.imu import Imu
from mufly.sensors.periodic import PeriodicSensor
from mufly.sensors.readings import (
    IdealBattery,
    IdealMotion,
    IdealRangeRing,
    Reading,
    Readings,
    Sensor,
    SensorSet,
    Truth,
    beam_angles,
    beam_directions,
    ideal_sensors,
)
from mufly.sensors.sensor_suite import (
    FittedSensors,
    check_faults,
    fitted_sensors,
    randomise_leg_lengths,
)

__all__ = [
    "FAULT_KINDS",
    "FAULT_TARGETS",
    "Fault",
    "FittedSensors",
    "IdealBattery",
    "IdealMotion",
    "IdealRangeRing",
    "Imu",
    "PeriodicSensor",
    "Reading",
    "Readings",
    "Sensor",
    "SensorSet",
    "Truth",
    "beam_angles",
    "beam_directions",
    "check_faults",
    "fitted_sensors",
    "ideal_sensors",
    "parse_fault",
    "randomise_leg_lengths",
]
