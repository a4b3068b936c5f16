"""All sensors of a vehicle, as its file specifies, and their faults."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from mufly.dynamics import body_to_ned_matrix
from mufly.errors import InputError
from mufly.quantities.sensor_table import SENSORS
from mufly.rotations import quaternion_from_euler
from mufly.sensors.electrical import BackEmfSensor, BatterySensor
from mufly.sensors.faults import Fault, FaultySensor
from mufly.sensors.imu import Imu
from mufly.sensors.magnetometer import MagnetometerSensor
from mufly.sensors.position_fix import PositionFixSensor
from mufly.sensors.pressure import PressureSensor
from mufly.sensors.readings import Sensor, SensorSet
from mufly.sensors.ring_camera import RingCamera
from mufly.sensors.sonar import UltrasonicSensor
from mufly.vehicle import Vehicle
from mufly.world import World

SENSOR_CLASSES: dict[str, type[Any]] = {
    "imu": Imu, "sonar": UltrasonicSensor, "ring_camera": RingCamera, "pressure": PressureSensor,
    "magnetometer": MagnetometerSensor, "rotor_speed": BackEmfSensor, "battery": BatterySensor,
    "position_fix": PositionFixSensor,
}  # fmt: skip
"""Class of each sensor of :data:`mufly.quantities.sensor_table.SENSORS`."""
_LEG_LENGTH_STREAM_NUMBER = 16  # of the random numbers, used by no sensor


class FittedSensors(SensorSet):
    """Sensors that a vehicle's file lists, with errors; faults may start and end in flight.

    Parameters
    ----------
    vehicle : str
        Name of the vehicle, for messages.
    fitted : mapping
        Key of :data:`SENSOR_CLASSES` to sensor.
    """

    def __init__(self, vehicle: str, fitted: Mapping[str, FaultySensor]) -> None:
        super().__init__(*fitted.values())
        self._vehicle, self._fitted = vehicle, dict(fitted)

    @property
    def all_faults(self) -> tuple[Fault, ...]:
        """All past, present and future faults."""
        return tuple(f for sensor in self._fitted.values() for f in sensor.faults)

    def inject_fault(self, fault: Fault, now_s: float = 0.0) -> Fault:
        """Schedule a fault and return it with its start time; a start in the past becomes ``now_s`` (s).

        Raises
        ------
        InputError
            If the vehicle lacks the fault's sensor.
        """
        sensor = self._fitted.get(fault.sensor_name)
        if sensor is None:
            raise _missing_sensor_error(fault, self._vehicle)
        if fault.start_s < now_s:
            stop = fault.stop_s if math.isinf(fault.stop_s) else now_s + fault.stop_s - fault.start_s
            fault = replace(fault, start_s=now_s, stop_s=stop)
        sensor.faults = (*sensor.faults, fault)
        return fault

    def clear_faults(self) -> None:
        """Remove all faults, including future ones."""
        for sensor in self._fitted.values():
            sensor.faults = ()


def _missing_sensor_error(fault: Fault, vehicle: str) -> InputError:
    return InputError("fault", str(fault), f"{vehicle} has no sensors.{fault.sensor_name}", "name another")


def require_fault_sensors(vehicle: Vehicle, faults: Iterable[Fault]) -> None:
    """Raise InputError if the vehicle lacks a fault's sensor."""
    for fault in faults:
        if getattr(vehicle.sensors, fault.sensor_name, None) is None:
            raise _missing_sensor_error(fault, vehicle.name)


def make_fitted_sensors(
    vehicle: Vehicle,
    world: World,
    *,
    seed: int = 0,
    faults: Iterable[Fault] = (),
    only: Iterable[str] = SENSORS,
    instead: Mapping[str, Sensor] | None = None,
) -> FittedSensors:
    """Return the sensors that a vehicle's file lists, with errors.

    Each sensor has its own random numbers: adding a sensor or a fault does not change the errors of the others.

    Parameters
    ----------
    vehicle : Vehicle
    world : World
        Surfaces that sonar and lasers measure.
    seed : int
        Same seed, same errors.
    faults : iterable of Fault
        Faults to inject.
    only : iterable of str
        Keys of :data:`SENSOR_CLASSES`.
    instead : mapping, optional
        Key of :data:`SENSOR_CLASSES` to a sensor that replaces the vehicle's.

    Raises
    ------
    InputError
        If the vehicle has no sensors, or lacks a fault's sensor.
    """
    if vehicle.sensors is None:
        raise InputError(
            vehicle.name,
            "sensors",
            "there is no such table",
            "add one (docs/reference/sensors.md), or fly on ideal sensors",
        )
    wanted = set(only)
    keys = (k for k in range(2 * len(SENSORS) + 1) if k != _LEG_LENGTH_STREAM_NUMBER)
    streams = [np.random.SeedSequence(seed, spawn_key=(k,)) for k in keys]
    made: dict[str, FaultySensor] = {}
    for k, name in enumerate(SENSORS):
        table = getattr(vehicle.sensors, name)
        if table is None or name not in wanted:
            continue
        other = (instead or {}).get(name)
        own = np.random.default_rng(streams[2 * k])
        sensor = SENSOR_CLASSES[name](table, vehicle, world, own) if other is None else other
        made[name] = FaultySensor(sensor, (), np.random.default_rng(streams[2 * k + 1]))
    fitted = FittedSensors(vehicle.name, made)
    for fault in faults:
        fitted.inject_fault(fault)
    return fitted


def randomise_leg_lengths(vehicle: Vehicle, *, seed: int = 0) -> Vehicle:
    """Return the vehicle with legs of random lengths, so that it stands at a small random tilt.

    The calibration takes the standing attitude for level, but legs differ in length and floors slope. Roll and pitch
    are drawn with the deviation ``sensors.imu.standing_tilt_error``. The plane of the tips of the legs is turned about
    the centre of gravity, so that :func:`mufly.dynamics.standing_attitude` gives the drawn angles, before and after a
    flight.

    Parameters
    ----------
    vehicle : Vehicle
    seed : int
        Same seed, same legs; the other sensors' errors do not depend on this draw.
    """
    if vehicle.sensors is None or vehicle.sensors.imu is None or float(vehicle.sensors.imu.standing_tilt_error) == 0.0:
        return vehicle
    own = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(_LEG_LENGTH_STREAM_NUMBER,)))
    roll, pitch = float(vehicle.sensors.imu.standing_tilt_error) * own.standard_normal(2)
    legs = vehicle.contact.legs.to_array() @ body_to_ned_matrix(quaternion_from_euler(roll, pitch, 0.0))
    tips = vehicle.contact.legs.model_copy(update={"value": tuple((float(x), float(y), float(z)) for x, y, z in legs)})
    return vehicle.model_copy(update={"contact": vehicle.contact.model_copy(update={"legs": tips})})
