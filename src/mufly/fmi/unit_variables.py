"""Variables of a co-simulation unit: inputs, start values, parameters and outputs, with units and start values.

The order of the list is that of the value references, from 1 on; 0 is the time. Inputs, start values, the integration
step and parameters can be set, outputs cannot. Start values are those of hover, well above the floor.
"""

from __future__ import annotations

import math
import sys
from dataclasses import dataclass, replace
from typing import Literal

from mufly.dynamics import DEFAULT_STEP_S, find_longest_stable_step, find_trim, model_parameters
from mufly.dynamics.model_state import (
    ATTITUDE_SLICE,
    BODY_RATE_SLICE,
    INPUT_SIZE,
    MODEL_SWASH_PITCH,
    MODEL_SWASH_ROLL,
    NED_VELOCITY_SLICE,
    ROTOR_SPEED_SLICE,
)
from mufly.fmi.unit_equations import OUTPUT_COUNT, START_COUNT
from mufly.fmi.unit_parameters import UnitParameter, list_fmu_parameters
from mufly.fmi.unit_sensors import UnitSensors
from mufly.rotations import euler_from_quaternion
from mufly.vehicle import Vehicle

Role = Literal["input", "start", "step", "seed", "parameter", "output"]

_START_HEIGHT_RADII = 10.0
"""Start height over the rotor radius, 1 m at least; there the ground effect is below a thousandth."""
_LARGEST_FLOAT = sys.float_info.max
_ROUNDING_TOLERANCE = 1e-12  # of the trim
_INPUT_VARIABLES = (
    ("motor_input_upper", "", "duty of the upper motor, limited to 0..1"),
    ("motor_input_lower", "", "duty of the lower motor, limited to 0..1"),
    ("servo_input_1", "", "swash plate servo 1, limited to -1..1; positive pitches the nose down"),
    ("servo_input_2", "", "swash plate servo 2, limited to -1..1; positive rolls to the right"),
    ("wind_north", "m/s", "velocity of the air, north"),
    ("wind_east", "m/s", "velocity of the air, east"),
    ("wind_down", "m/s", "velocity of the air, down"),
)
_START_VARIABLES = (
    ("position_north", "m", "position at the start, north"),
    ("position_east", "m", "position at the start, east"),
    ("position_down", "m", "position at the start, down; the floor is at 0"),
    ("velocity_north", "m/s", "velocity at the start, north"),
    ("velocity_east", "m/s", "velocity at the start, east"),
    ("velocity_down", "m/s", "velocity at the start, down"),
    ("roll", "rad", "roll angle at the start"),
    ("pitch", "rad", "pitch angle at the start"),
    ("yaw", "rad", "yaw angle at the start"),
    ("roll_rate", "rad/s", "body rate about x at the start"),
    ("pitch_rate", "rad/s", "body rate about y at the start"),
    ("yaw_rate", "rad/s", "body rate about z at the start"),
    ("swash_roll", "rad", "tilt of the lower tip-path plane about x at the start"),
    ("swash_pitch", "rad", "tilt of the lower tip-path plane about y at the start"),
    ("bar_roll", "rad", "roll angle of the stabiliser bar's disc at the start"),
    ("bar_pitch", "rad", "pitch angle of the stabiliser bar's disc at the start"),
    ("rotor_speed_upper", "rad/s", "speed of the upper rotor at the start"),
    ("rotor_speed_lower", "rad/s", "speed of the lower rotor at the start"),
    ("battery_charge", "", "fraction of the battery's charge at the start"),
)
_WIND_NAMES = ("wind_north", "wind_east", "wind_down")
_MOTOR_INPUT_NAMES = ("motor_input_upper", "motor_input_lower")
_OUTPUT_VARIABLES: tuple[tuple[str, str, str, tuple[str, ...]], ...] = (
    ("position_north", "m", "position of the centre of gravity, north", ()),
    ("position_east", "m", "position of the centre of gravity, east", ()),
    ("position_down", "m", "position of the centre of gravity, down; the floor is at 0", ()),
    ("velocity_north", "m/s", "velocity over the ground, north", ()),
    ("velocity_east", "m/s", "velocity over the ground, east", ()),
    ("velocity_down", "m/s", "velocity over the ground, down", ()),
    ("quaternion_w", "", "attitude quaternion, rotates body vectors to N-E-D: w", ()),
    ("quaternion_x", "", "attitude quaternion: x", ()),
    ("quaternion_y", "", "attitude quaternion: y", ()),
    ("quaternion_z", "", "attitude quaternion: z", ()),
    ("roll_rate", "rad/s", "body rate about x, p", ()),
    ("pitch_rate", "rad/s", "body rate about y, q", ()),
    ("yaw_rate", "rad/s", "body rate about z, r", ()),
    ("swash_roll", "rad", "tilt of the lower tip-path plane about x", ()),
    ("swash_pitch", "rad", "tilt of the lower tip-path plane about y", ()),
    ("bar_normal_north", "", "upward normal of the stabiliser bar's disc, north", ()),
    ("bar_normal_east", "", "upward normal of the stabiliser bar's disc, east", ()),
    ("bar_normal_down", "", "upward normal of the stabiliser bar's disc, down", ()),
    ("rotor_speed_upper", "rad/s", "speed of the upper rotor", ()),
    ("rotor_speed_lower", "rad/s", "speed of the lower rotor", ()),
    ("battery_charge", "", "remaining fraction of the battery's charge", ()),
    ("roll", "rad", "roll angle (yaw, then pitch, then roll)", ()),
    ("pitch", "rad", "pitch angle", ()),
    ("yaw", "rad", "yaw angle, -pi to pi", ()),
    ("thrust_upper", "N", "thrust of the upper rotor along its disc's normal", _WIND_NAMES),
    ("thrust_lower", "N", "thrust of the lower rotor along its disc's normal", _WIND_NAMES),
    ("battery_voltage", "V", "terminal voltage of the battery", _MOTOR_INPUT_NAMES),
    ("battery_current", "A", "current from the battery", _MOTOR_INPUT_NAMES),
    ("specific_force_x", "m/s^2", "what an ideal accelerometer at the centre of gravity measures, body x", _WIND_NAMES),
    ("specific_force_y", "m/s^2", "what an ideal accelerometer at the centre of gravity measures, body y", _WIND_NAMES),
    ("specific_force_z", "m/s^2", "what an ideal accelerometer at the centre of gravity measures, body z", _WIND_NAMES),
)
_DISPLAY_UNITS = {"rad": "deg", "kg": "g", "A s": "mA h", "m/s^2": "", "rad/s": "deg/s"}


@dataclass(frozen=True)
class UnitVariable:
    """Variable of a co-simulation unit (FMU): name, role, unit and start value.

    Attributes
    ----------
    name : str
        Parameters have their key in the vehicle file.
    role : str
        ``"input"``, ``"start"``, ``"step"``, ``"seed"``, ``"parameter"`` or ``"output"``.
    unit, display_unit, description : str
    start : float
        Start value; NaN of an output.
    lowest, highest : float
        Least and greatest value that can be set.
    inputs : tuple of str
        Inputs on which an output depends at the same time.
    """

    name: str
    role: Role
    unit: str
    display_unit: str
    description: str
    start: float = math.nan
    lowest: float = -_LARGEST_FLOAT
    highest: float = _LARGEST_FLOAT
    inputs: tuple[str, ...] = ()


@dataclass(frozen=True)
class UnitInterface:
    """Variables of a unit, its parameters with their effects, and the keys of the vehicle file that are fixed in it."""

    variables: list[UnitVariable]
    parameters: list[UnitParameter]
    fixed_keys: list[str]

    def count_variables(self, *roles: Role) -> int:
        """Return the number of variables of some roles."""
        return sum(v.role in roles for v in self.variables)


def list_fmu_variables(vehicle: Vehicle, sensors: UnitSensors | None = None) -> UnitInterface:
    """Return the variables of a vehicle's co-simulation unit (FMU).

    Parameters
    ----------
    vehicle : Vehicle
    sensors : UnitSensors, optional
        Sensors and filter of the unit. Such a unit starts on the floor with resting rotors, as its filter assumes.

    Raises
    ------
    InputError
        If the vehicle is too heavy to hover.
    MuflyError
        If it has no trim in hover.
    """
    hover = find_trim(vehicle, charge=1.0)
    x = hover.state
    roll, pitch, _ = euler_from_quaternion(x[ATTITUDE_SLICE])
    height = max(1.0, _START_HEIGHT_RADII * float(vehicle.rotors.radius))
    starts = [
        0.0, 0.0, -height, *x[NED_VELOCITY_SLICE], roll, pitch, 0.0, *x[BODY_RATE_SLICE], x[MODEL_SWASH_ROLL],
        x[MODEL_SWASH_PITCH],
        roll, pitch, *x[ROTOR_SPEED_SLICE], 1.0,
    ]  # fmt: skip
    inputs = [*hover.input, 0.0, 0.0, 0.0]
    if sensors is not None:
        down, *angles = sensors.seeded_start_values[0].tolist()
        starts = [0.0, 0.0, down, 0.0, 0.0, 0.0, *angles[:2], *[0.0] * 6, *angles[2:], 0.0, 0.0, 1.0]
        inputs = [0.0] * len(inputs)
    step = DEFAULT_STEP_S
    while step > find_longest_stable_step(model_parameters(vehicle)):
        step *= 0.5
    parameters, fixed = list_fmu_parameters(vehicle)

    def display_unit_of(name: str, unit: str) -> str:
        return "rpm" if "rotor_speed" in name and unit == "rad/s" else _DISPLAY_UNITS.get(unit, "")

    def round_start_value(value: float) -> float:
        return 0.0 if abs(value) < _ROUNDING_TOLERANCE else float(value)

    variables = [
        UnitVariable(name, "input", unit, "", description, round_start_value(start))
        for (name, unit, description), start in zip(_INPUT_VARIABLES, inputs, strict=True)
    ]
    variables += [
        UnitVariable(
            f"start.{name}",
            "start",
            unit,
            display_unit_of(name, unit),
            description,
            round_start_value(start) if sensors is None else start,
        )
        for (name, unit, description), start in zip(_START_VARIABLES, starts, strict=True)
    ]
    variables[-1] = replace(variables[-1], lowest=0.0, highest=1.0)
    variables.append(
        UnitVariable("solver.step", "step", "s", "", "longest integration step (Runge-Kutta 4)", step, 1e-7, 1.0)
    )
    if sensors is not None:
        variables.append(
            UnitVariable(
                "sensors.seed", "seed", "", "", "seed of the sensors' errors and of the lengths of the legs", 0.0, 0.0,
                float(sensors.seed_count - 1),
            )
        )  # fmt: skip
    variables += [
        UnitVariable(
            p.key, "parameter", "" if p.unit == "1" else p.unit, display_unit_of(p.key, p.unit), p.description, p.value,
            max(p.lowest, -_LARGEST_FLOAT), min(p.highest, _LARGEST_FLOAT),
        )
        for p in parameters
    ]  # fmt: skip
    variables += [
        UnitVariable(name, "output", unit, display_unit_of(name, unit), description, inputs=inputs)
        for name, unit, description, inputs in _OUTPUT_VARIABLES
    ]
    sensed = [] if sensors is None else sensors.list_outputs()
    variables += [
        UnitVariable(o.name, "output", o.unit, display_unit_of(o.name, o.unit), o.description) for o in sensed
    ]
    found = UnitInterface(variables, parameters, fixed)
    assert (found.count_variables("input"), found.count_variables("start"), found.count_variables("output")) == (
        INPUT_SIZE + 3, START_COUNT, OUTPUT_COUNT + len(sensed),
    )  # fmt: skip
    return found
