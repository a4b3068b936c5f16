"""One row of a recording: what is true, measured, wanted and done at one instant."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from mufly.flight.controllers import Actuators
from mufly.flight.plant import Plant
from mufly.flight.recorder import Recorder
from mufly.sensors import Measurement

__all__ = ["row_writer"]

_Array = NDArray[np.float64]
_Reference = tuple[_Array, _Array, _Array]  # position, velocity, attitude


def row_writer(recorder: Recorder, plant: Plant) -> Callable[[Measurement, Actuators, _Reference, str], None]:
    """Return the function that appends a row: ``write(measured, actuators, reference, state)``.

    ``reference`` is position and velocity (N-E-D) and attitude; ``state`` the state of the mission. What the table
    of quantities holds beyond that stays NaN.
    """
    columns = recorder.layout.columns
    row = np.full(recorder.layout.width, np.nan)

    def part(name: str) -> _Array:
        return row[columns[name]]

    truth = [part(f"truth_{name}") for name in ("position", "velocity", "attitude", "rates", "rotor_speed")]
    seen = [part(f"measured_{name}") for name in ("position", "velocity", "attitude", "rates")]
    wanted = [part(f"reference_{name}") for name in ("position", "velocity", "attitude")]
    wind, motor, servo, beams = part("wind"), part("motor_input"), part("servo_input"), part("range")
    voltage, current, charge = part("battery_voltage"), part("battery_current"), part("battery_charge")

    def write(m: Measurement, actuators: Actuators, reference: _Reference, state: str) -> None:
        x = plant.state
        row[0] = m.time_s
        true = (x[0:3], x[3:6], m.attitude, x[10:13], x[18:20])
        measured = (m.position, m.velocity, m.attitude, m.rates)
        for target, value in zip(truth, true, strict=True):
            target[:] = value
        for target, value in zip(seen, measured, strict=True):
            target[:] = value
        for target, value in zip(wanted, reference, strict=True):
            target[:] = value
        wind[:], motor[:], servo[:] = plant.wind, actuators.motor_input, actuators.servo_input
        voltage[:], current[:], charge[:] = plant.voltage, plant.current, x[20]
        beams[:] = m.ranges
        recorder.append(row, state)

    return write
