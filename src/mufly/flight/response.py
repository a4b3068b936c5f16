"""Step responses: the controllers alone on the nonlinear model, without a mission (Figs 6.10 and 6.12)."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import xarray as xr

from mufly.control import FlightController, design
from mufly.dynamics import DrydenWind, trim
from mufly.errors import InputError
from mufly.flight.controllers import Actuators, Controllers
from mufly.flight.plant import Plant
from mufly.flight.recorder import Recorder
from mufly.flight.rows import row_writer
from mufly.vehicle import Vehicle
from mufly.world import World

__all__ = ["Demand", "respond"]

START_HEIGHT_M = 5.0  # out of the floor's reach for any sensible step


@dataclass(frozen=True, slots=True)
class Demand:
    """What the low-level controllers have to follow: z (m, down, from the start), angles (rad)."""

    z: float = 0.0
    heading: float = 0.0
    roll: float = 0.0
    pitch: float = 0.0


def respond(
    vehicle: Vehicle,
    demand: Callable[[float], Demand],
    *,
    duration_s: float,
    controller: FlightController | None = None,
    charge: float = 0.8,
    wind: DrydenWind | None = None,
) -> xr.Dataset:
    """Let the low-level controllers follow a reference on the full nonlinear model, from hover.

    Inputs saturate, the battery sags, and the actuators act one period after the measurement, as in flight.

    Parameters
    ----------
    vehicle : Vehicle
    demand : callable
        From time (s) to :class:`Demand`.
    duration_s : float
        (s).
    controller : FlightController, optional
        By default ``mufly.control.design(vehicle)``.
    charge : float
        Battery charge at the start (fraction).
    wind : DrydenWind, optional
        Sampled at the controller's rate; still air by default.

    Returns
    -------
    xarray.Dataset
        A recording in memory, a row every period; positions count from the start.

    Raises
    ------
    InputError
        If the duration is not positive.
    """
    if not (math.isfinite(duration_s) and duration_s > 0):
        raise InputError("respond", "duration_s", f"{duration_s} s", "give a positive time")
    controller = design(vehicle) if controller is None else controller
    hover = trim(vehicle, charge=charge)
    start = hover.state.copy()
    start[2] = -START_HEIGHT_M
    air = DrydenWind(step_s=controller.period_s) if wind is None else wind
    plant = Plant(vehicle, World(), air, controller.rate_Hz, start)
    plant.voltage, plant.current = hover.voltage_V, hover.current_A
    controllers = Controllers(controller)
    recorder = Recorder(None, {"vehicle": vehicle.name, "rate_Hz": controller.rate_Hz})
    write = row_writer(recorder, plant)
    controllers.engage(plant.measure(), hover.motor_input)
    controllers.lift_off(plant.measure())
    pending = Actuators(hover.motor_input, hover.servo_input)
    zero = np.zeros(3)
    for _ in range(round(duration_s * controller.rate_Hz) + 1):
        measured = plant.measure()
        s = demand(measured.time_s)
        z = s.z - START_HEIGHT_M
        actuators = controllers.step(
            measured, np.array([z, s.heading, 0.0, 0.0]), np.array([s.roll, s.pitch])
        )
        wanted = np.array([0.0, 0.0, z]), zero, np.array([s.roll, s.pitch, s.heading])
        write(measured, pending, wanted, "follow")
        plant.advance(pending)
        pending = actuators
    recorder.finish("succeeded")
    recorder.close()
    dataset = recorder.dataset()
    for name in ("truth_position", "measured_position", "reference_position"):
        dataset[name][:, 2] += START_HEIGHT_M
    return dataset
