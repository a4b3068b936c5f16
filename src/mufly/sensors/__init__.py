"""Sensor models: readings computed from the true state and the world."""

from mufly.sensors.faults import FAULT_KINDS, FAULT_TARGETS, Fault, parse_fault
from mufly.sensors.imu import Imu
from mufly.sensors.periodic import PeriodicSensor
from mufly.sensors.readings import (
    IdealBatterySensor,
    IdealMotionSensor,
    IdealRangeRing,
    Reading,
    Readings,
    Sensor,
    SensorSet,
    Truth,
    beam_angles,
    beam_directions,
    make_ideal_sensors,
)
from mufly.sensors.sensor_suite import (
    FittedSensors,
    make_fitted_sensors,
    randomise_leg_lengths,
    require_fault_sensors,
)

__all__ = [
    "FAULT_KINDS",
    "FAULT_TARGETS",
    "Fault",
    "FittedSensors",
    "IdealBatterySensor",
    "IdealMotionSensor",
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
    "make_fitted_sensors",
    "make_ideal_sensors",
    "parse_fault",
    "randomise_leg_lengths",
    "require_fault_sensors",
]
