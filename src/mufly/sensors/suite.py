"""All sensors of a vehicle, as its file says, and what may be wrong with them."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any

import numpy as np

from mufly.errors import InputError
from mufly.sensors.electrical import BackEmfSensor, BatterySensor
from mufly.sensors.faults import Fault, Faulty
from mufly.sensors.imu import Imu
from mufly.sensors.magnetometer import MagnetometerSensor
from mufly.sensors.position_fix import PositionFixSensor
from mufly.sensors.pressure import PressureSensor
from mufly.sensors.readings import Sensor, Sensors
from mufly.sensors.ring_camera import RingCamera
from mufly.sensors.sonar import UltrasonicSensor
from mufly.vehicle import Vehicle
from mufly.world import World

FITTED = ("imu", "sonar", "ring_camera", "pressure", "magnetometer", "rotor_speed", "battery", "position_fix")
"""Tables of ``[sensors]``, in the order in which their random numbers are drawn."""


def fitted_sensors(
    vehicle: Vehicle,
    world: World,
    *,
    seed: int = 0,
    faults: Iterable[Fault] = (),
    only: Iterable[str] = FITTED,
) -> Sensors:
    """Return the sensors that a vehicle's file names, with errors.

    Each has random numbers of its own: one sensor more or less, or a fault, leaves the others' errors as they were.

    Parameters
    ----------
    vehicle : Vehicle
    world : World
        What sonar and lasers see.
    seed : int
        Same seed, same errors.
    faults : iterable of Fault
        What goes wrong, and when.
    only : iterable of str
        Names of :data:`FITTED`.

    Raises
    ------
    InputError
        If the vehicle has no sensors, or a fault is of one that it has not.
    """
    if vehicle.sensors is None:
        raise InputError(
            vehicle.name,
            "sensors",
            "there is no such table",
            "add one (docs/sensors.md), or fly on ideal sensors",
        )
    wanted = set(only)
    streams = np.random.SeedSequence(seed).spawn(2 * len(FITTED))
    made: list[Sensor] = []
    wrong = list(faults)
    for k, name in enumerate(FITTED):
        table = getattr(vehicle.sensors, name)
        if table is None or name not in wanted:
            continue
        rng = np.random.default_rng(streams[2 * k])
        sensor = _make(name, table, vehicle, world, rng)
        its = [f for f in wrong if f.sensor == name]
        made.append(Faulty(sensor, its, np.random.default_rng(streams[2 * k + 1])) if its else sensor)
        wrong = [f for f in wrong if f.sensor != name]
    if wrong:
        raise InputError(
            "fault", str(wrong[0]), f"{vehicle.name} has no sensors.{wrong[0].sensor}", "name another"
        )
    return Sensors(*made)


def _make(name: str, table: Any, vehicle: Vehicle, world: World, rng: np.random.Generator) -> Sensor:
    match name:
        case "sonar":
            return UltrasonicSensor(table, vehicle, world, rng)
        case "ring_camera":
            return RingCamera(table, vehicle, world, rng)
        case _:
            return _BLIND[name](table, vehicle, rng)


_BLIND: dict[str, Callable[[Any, Vehicle, np.random.Generator], Sensor]] = {
    "imu": Imu, "pressure": PressureSensor, "magnetometer": MagnetometerSensor, "rotor_speed": BackEmfSensor,
    "battery": BatterySensor, "position_fix": PositionFixSensor,
}  # fmt: skip
