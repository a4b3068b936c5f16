"""Drive train of brushless motor, gear, rotor and battery (thesis Secs 3.1.4 and 4.4.2), and drive files.

The controller applies the mean voltage ``duty * voltage``; the inductance is neglected (eq. 4.26)::

    I_A          = (duty * U - kE * i * Omega) / R                          armature current
    J dOmega/dt  = kM * I_A / i - dR * Omega - Mf / i - Q / (i^2 * eta)     eq. 4.29, and Mf

with gear ratio ``i = motor speed / rotor speed`` and the drag torque ``Q`` of the rotor. ``J`` is the inertia referred
to the motor. The supply current is ``duty * I_A`` (mean of the chopped current). The dissertation has no constant
friction ``Mf``, which stands for bearings, brushes and hysteresis of the iron. It makes the no-load current nearly
independent of speed. Below ``FULL_FRICTION_SPEED_rad_s`` it decreases linearly to zero, because the sign function would
make a motor at rest oscillate.

A file gives the motor by the constants of eqs. 4.24 and 4.25, ``[motor]``, or by its data sheet, ``[datasheet]``: speed
constant Kv, resistance R, and no-load current I0 at the voltage U0. Then

    kE = 1 / Kv,    kM = kE,    dR = kM I0 / w0,    w0 = (U0 - R I0) / kE,

because the power of an ideal converter is conserved (kE w I = kM I w) and the torque of a motor without load only
overcomes its friction. Motors identified from measurements may have kM < kE (muFly's has 0.0035 N m/A against 0.0045 V
s): kM then includes iron losses that grow with the current.
"""

from __future__ import annotations

import math
from importlib import resources
from pathlib import Path
from typing import Any, Literal

import numpy as np
import tomli_w
from numpy.typing import ArrayLike, NDArray
from pydantic import Field, ValidationInfo, field_validator, model_validator

from mufly.compiled.numba_cache import cached_njit
from mufly.errors import InputError, MuflyError
from mufly.files.input_files import builtin_file_names, make_validation_error, read_toml, validate_model
from mufly.quantities.units import RPM
from mufly.results import result
from mufly.vehicle import Vehicle, load_vehicle
from mufly.vehicle.quantity import ParameterGroup, Quantity, declare_parameter
from mufly.vehicle.vehicle_schema import MAX_TORQUE_TO_EMF_RATIO, Battery, Gear, Motor

FULL_FRICTION_SPEED_rad_s = 1.0
"""Rotor speed (rad/s) above which constant friction acts in full."""


@cached_njit(error_model="numpy")
def armature_current(
    duty: float, voltage: float, speed: float, back_emf_constant: float, resistance: float, gear_ratio: float
) -> float:
    """Return the armature current (A) of a motor whose rotor turns at ``speed`` (rad/s); eq. 4.24 without L.

    Thesis: eq. 4.24.
    """
    return (duty * voltage - back_emf_constant * gear_ratio * speed) / resistance


@cached_njit(error_model="numpy")
def rotor_acceleration(
    current: float,
    speed: float,
    drag_torque: float,
    torque_constant: float,
    friction: float,
    friction_torque: float,
    gear_ratio: float,
    gear_efficiency: float,
    inertia: float,
) -> float:
    """Return dOmega/dt (rad/s2) of a rotor at ``speed`` (rad/s) under ``drag_torque`` (N m); eq. 4.29.

    Thesis: eqs 4.25 to 4.29.
    """
    turning = (abs(speed + FULL_FRICTION_SPEED_rad_s) - abs(speed - FULL_FRICTION_SPEED_rad_s)) / (
        2.0 * FULL_FRICTION_SPEED_rad_s
    )  # from -1 to 1
    drive = torque_constant * current / gear_ratio - friction * speed
    drive = drive - friction_torque / gear_ratio * turning
    return (drive - drag_torque / (gear_ratio * gear_ratio * gear_efficiency)) / inertia


FloatOrArray = float | NDArray[np.float64]


@result
class MotorConstants:
    """Constants of one motor with controller and gear in SI units; each a float or an array over cases.

    Attributes
    ----------
    back_emf_V_s, torque_Nm_A : kE and kM
        Volt per rad/s of motor speed; N m per ampere.
    resistance_ohm : R
        Armature and controller together.
    friction_Nm_s, friction_Nm : dR, Mf
        Viscous and constant friction of the motor.
    gear_ratio, gear_efficiency : i, eta
        Motor speed over rotor speed; power out of the gear over power in.
    controller_efficiency : eta_c
        Power to the motor over power from the supply, without the losses in ``resistance_ohm``.
    """

    back_emf_V_s: FloatOrArray
    torque_Nm_A: FloatOrArray
    resistance_ohm: FloatOrArray
    friction_Nm_s: FloatOrArray
    gear_ratio: FloatOrArray
    gear_efficiency: FloatOrArray
    controller_efficiency: FloatOrArray = 1.0
    friction_Nm: FloatOrArray = 0.0

    def select_cases(self, case: NDArray[np.int64]) -> MotorConstants:
        """Return the constants of selected cases: arrays are indexed, scalars are unchanged."""
        return MotorConstants(**{k: v[case] if np.ndim(v) else v for k, v in vars(self).items()})


SPEED_CONSTANT_RANGE_RAD_VS = (0.1, 1e6)
"""Range of speed constants (rad/s/V), from the permitted back-EMF constants of a vehicle file."""


class DatasheetMotor(ParameterGroup):
    """Motor described by its data sheet."""

    speed_constant: Quantity = Field(description="Kv, free speed per volt", json_schema_extra={"symbol": "Kv"})
    resistance: Quantity = declare_parameter("ohm", "R", "resistance between two leads", at_least=1e-4, at_most=1e4)
    no_load_current: Quantity = declare_parameter(
        "A", "I0", "current of the motor without load", at_least=0, at_most=1e3
    )
    no_load_voltage: Quantity = declare_parameter(
        "V", "U0", "voltage at which I0 was measured", at_least=1e-3, at_most=1e3
    )

    @field_validator("speed_constant", mode="before")
    @classmethod
    def _kv_to_si(cls, raw: Any, info: ValidationInfo) -> Any:
        units = {"rad/s/V": 1.0, "rpm/V": RPM}
        if isinstance(raw, Quantity):
            return raw
        value = raw.get("value") if isinstance(raw, dict) else None
        if not isinstance(raw, dict) or raw.get("unit") not in units:
            raise make_validation_error(
                f"{raw!r} has no unit that fits",
                f'write {info.field_name} = {{ value = ..., unit = "rpm/V", source = "datasheet" }}',
            )
        if (
            isinstance(value, bool)
            or not isinstance(value, int | float)
            or not SPEED_CONSTANT_RANGE_RAD_VS[0] <= value * units[raw["unit"]] <= SPEED_CONSTANT_RANGE_RAD_VS[1]
        ):
            raise make_validation_error(
                f"{value!r} is out of range", "give {:g} to {:g} rad/s/V".format(*SPEED_CONSTANT_RANGE_RAD_VS)
            )
        return {**raw, "value": value * units[raw["unit"]], "unit": "rad/s/V"}

    @model_validator(mode="after")
    def _check_no_load(self) -> DatasheetMotor:
        drop = float(self.resistance) * float(self.no_load_current)
        if drop >= float(self.no_load_voltage):
            raise make_validation_error(
                f"the resistance alone takes {drop:g} V",
                "correct no_load_current, resistance or no_load_voltage",
                "datasheet.no_load_current",
            )
        return self

    def motor_constants(self) -> tuple[float, float, float, float]:
        """Return kE (V s), kM (N m/A), R (ohm), dR (N m s) by the formulas of the module docstring."""
        k, r, i0 = 1.0 / float(self.speed_constant), float(self.resistance), float(self.no_load_current)
        free = (float(self.no_load_voltage) - r * i0) / k
        return k, k, r, k * i0 / free


class Controller(ParameterGroup):
    """Speed controller between battery and motor."""

    on_resistance: Quantity = declare_parameter(
        "ohm", "Ron", "resistance of the closed switches", at_least=0, at_most=1e3
    )
    efficiency: Quantity = declare_parameter(
        "1",
        "eta_c",
        "power to the motor over power from the battery, without the loss in Ron",
        at_least=0.01,
        at_most=1,
    )


class DriveTrain(ParameterGroup):
    """Motor, controller and gear of each rotor, and their common battery; SI values."""

    name: str = Field(min_length=1, description="short name")
    description: str = Field(default="", description="one line about the drive train")
    rotors: int = Field(default=1, ge=1, le=64, strict=True, description="rotors that the battery feeds")
    motor: Motor | None = Field(default=None, description="constants of the motor")
    datasheet: DatasheetMotor | None = Field(default=None, description="data sheet of the motor")
    controller: Controller | None = Field(default=None, description="speed controller; default: ideal")
    gear: Gear
    battery: Battery

    @model_validator(mode="after")
    def _check_single_motor(self) -> DriveTrain:
        if (self.motor is None) == (self.datasheet is None):
            given = (
                "neither [motor] nor [datasheet] is given"
                if self.motor is None
                else "both [motor] and [datasheet] are given"
            )
            raise make_validation_error(given, "give one of the two", "motor")
        return self

    def motor_constants(self, **overrides: FloatOrArray | None) -> MotorConstants:
        """Return the constants of one motor with controller and gear.

        Parameters
        ----------
        **overrides : float or array
            New values of fields of :class:`MotorConstants`; None keeps the value of the drive.
        """
        rubbing = 0.0
        if self.motor is not None:
            m = self.motor
            rubbing = float(m.friction_torque)
            k_e, k_m, r, d = (float(q) for q in (m.back_emf_constant, m.torque_constant, m.resistance, m.friction))
        else:
            assert self.datasheet is not None
            k_e, k_m, r, d = self.datasheet.motor_constants()
        if self.controller is not None:
            r += float(self.controller.on_resistance)
        values: dict[str, FloatOrArray] = {
            "back_emf_V_s": k_e,
            "torque_Nm_A": k_m,
            "resistance_ohm": r,
            "friction_Nm_s": d,
            "gear_ratio": float(self.gear.ratio),
            "gear_efficiency": float(self.gear.efficiency),
            "controller_efficiency": 1.0 if self.controller is None else float(self.controller.efficiency),
            "friction_Nm": rubbing,
        }
        values.update({key: value for key, value in overrides.items() if value is not None})
        found = MotorConstants(**values)
        if np.any(np.asarray(found.torque_Nm_A) > MAX_TORQUE_TO_EMF_RATIO * np.asarray(found.back_emf_V_s)):
            raise InputError(
                self.name,
                "torque_Nm_A",
                f"{np.max(found.torque_Nm_A):g} N m/A is above the back-EMF constant: such a motor generates energy",
                f"give at most {np.min(found.back_emf_V_s):g}, or raise the back-EMF constant",
            )
        return found


_VEHICLE_FILES = resources.files("mufly.vehicle") / "builtin"
_MUFLY_VEHICLE = "mufly-1.1"  # muFly's drive train is the one identified on this prototype


def list_builtin_drives() -> list[str]:
    """Return the names of the built-in drives: ``mufly``, and those of the built-in vehicles."""
    return ["mufly", *builtin_file_names(_VEHICLE_FILES)]


def drive_of_vehicle(vehicle: Vehicle) -> DriveTrain:
    """Return the drive train of a vehicle: two rotors, each with motor and gear, on one battery."""
    return DriveTrain(
        name=vehicle.name,
        description=f"drive train of {vehicle.description or vehicle.name}",
        rotors=2,
        motor=vehicle.motor,
        gear=vehicle.gear,
        battery=vehicle.battery,
    )


def load_drive(name_or_path: str | Path) -> DriveTrain:
    """Read a drive train by built-in name, from a drive file or from a vehicle file (TOML).

    Parameters
    ----------
    name_or_path : str or Path
        A name that :func:`list_builtin_drives` lists (``"mufly"`` is the drive of prototype 1.1), or a file's path. A
        vehicle file gives the drive of that vehicle.

    Raises
    ------
    InputError
        If there is no such drive, the file is not TOML, or a value is missing, unknown, without a unit or impossible.
    """
    name = _MUFLY_VEHICLE if str(name_or_path) == "mufly" else name_or_path
    tables, where = read_toml(name, _VEHICLE_FILES, "drive or vehicle")
    if "body" in tables or ("rotors" in tables and isinstance(tables["rotors"], dict)):
        return drive_of_vehicle(load_vehicle(name))
    return validate_model(DriveTrain, {"name": Path(where).stem, **tables}, where)


def drive_to_toml(drive: DriveTrain) -> str:
    """Return the text of a drive file in SI units that :func:`load_drive` can read."""
    return tomli_w.dumps(drive.model_dump(exclude_none=True))


# ----------------------------------------------------------------------------
# Battery: open-circuit voltage over charge, internal resistance, the loads that hang on it, how long it lasts.
#
# Loads are the electronics (constant current ``I_el``) and motors that draw ``duty * I_A`` (see
# :mod:`mufly.drive.drive_train`). The supply current is linear in the terminal voltage, so voltage and current follow
# in
# closed form (own derivation)::
#
#     I = I_el + G U - S,   G = sum(duty^2) / R,   S = sum(duty * kE * i * Omega) / R
#     U = U_oc - R_bat I    =>   U = (U_oc + R_bat (S - I_el)) / (1 + R_bat G)
#
# Motors of constant power: n motors that draw P each and electronics I_el at the terminal voltage U make U = U_oc -
# R_b (n P / U + I_el), hence
#
#     U = (E + sqrt(E^2 - 4 R_b n P)) / 2,       E = U_oc - R_b I_el,
#
# and the battery breaks down where the root has no value. With given duty instead, the terminal voltage is the closed
# form of :func:`terminal_voltage`.
#
# How long a battery holds a hover. It needs the same speed and torque to the end, so the motors need the same power P
# and the same motor voltage U_m. With z the charge left (1 to 0) and C the capacity
#
#     -C dz/dt = I(z) = P / U(z) + I_el,       U(z) = U_oc(z) - R_b I(z)            (:func:`battery_voltage`)
#     t = C int_z_end^1 dz / I(z)
#
# U_oc is linear between the points of its table, and the integrand is smooth on each piece: eight Gauss points a
# piece are exact to rounding. The hover ends when the terminal voltage falls to the larger of the battery's low
# voltage and U_m (then duty is 1), or to sqrt(R_b P), where the battery breaks down; by the same balance that is
# at
#
#     U_oc,end = U_end + R_b (P / U_end + I_el).
#
# Own derivation. Limit without resistance and with flat U_oc: t = C / (P / U_oc + I_el).


@cached_njit(error_model="numpy")
def interpolate_table(table: Array, fraction: float) -> float:
    """Interpolate ``table`` (n values at equal steps from 0 to 1) linearly; outside, return the value at the end."""
    last = table.shape[0] - 1
    position = min(max(fraction, 0.0), 1.0) * last
    k = min(int(position), last - 1)
    return table[k] + (position - k) * (table[k + 1] - table[k])


@cached_njit(error_model="numpy")
def terminal_voltage(
    open_circuit: float,
    resistance: float,
    conductance: float,
    source_current: float,
    electronics_current: float,
) -> float:
    """Return the terminal voltage of the battery (V) under load; never below zero."""
    voltage = (open_circuit + resistance * (source_current - electronics_current)) / (1.0 + resistance * conductance)
    return max(voltage, 0.0)


Array = NDArray[np.float64]


def open_circuit_voltage(battery: Battery, charge: float) -> float:
    """Return the battery's open-circuit voltage (V) at a remaining ``charge`` (0 to 1), as in the flight model."""
    if not 0.0 <= charge <= 1.0:
        raise InputError("battery", "charge", f"{charge:g} is out of range", "give a fraction from 0 to 1")
    if battery.model == "constant":
        return float(battery.nominal_voltage)
    return float(interpolate_table(battery.open_circuit_voltage.sample_evenly(101), charge))


def find_charge_from_idle_voltage(battery: Battery, voltage: float) -> float:
    """Return the remaining charge (0 to 1) of a battery that feeds its electronics alone, from its terminal voltage.

    Parameters
    ----------
    battery : Battery
    voltage : float
        Terminal voltage (V); 1 is returned for the 'constant' model, whose voltage tells nothing.
    """
    if battery.model == "constant":
        return 1.0
    curve = np.maximum.accumulate(battery.open_circuit_voltage.sample_evenly(101))
    at_rest = voltage + float(battery.internal_resistance) * float(battery.electronics_current)
    return float(np.interp(at_rest, curve, np.linspace(0.0, 1.0, 101)))


def internal_resistance(battery: Battery) -> float:
    """Return the battery's internal resistance R_b (ohm); zero for the battery model 'constant'."""
    return 0.0 if battery.model == "constant" else float(battery.internal_resistance)


def battery_voltage(battery: Battery, open_circuit_V: ArrayLike, power_W: ArrayLike) -> Array:
    """Return the terminal voltage (V) under motors of constant power and the electronics; nan if there is no solution.

    Parameters
    ----------
    battery : Battery
    open_circuit_V : array_like
        Open-circuit voltage (V).
    power_W : array_like
        Power of all motors together (W).
    """
    r = internal_resistance(battery)
    e = np.asarray(open_circuit_V, dtype=np.float64) - r * float(battery.electronics_current)
    inside = e**2 - 4.0 * r * np.asarray(power_W, dtype=np.float64)
    return np.where((inside >= 0) & (e > 0), 0.5 * (e + np.sqrt(np.maximum(inside, 0.0))), np.nan)


_GAUSS_NODE_COUNT = 8


@result
class HoverEndurance:
    """Hover endurance from a full battery.

    Attributes
    ----------
    time_s : float
    charge_left : float
        Fraction of the charge at the end.
    ends_by : str
        ``"low voltage"``, ``"full duty"``, ``"breakdown"`` or ``"empty"``.
    voltage_full_V, voltage_end_V : float
        Terminal voltage of the battery at begin and end.
    mean_current_A : float
        Mean current of the battery.
    """

    time_s: float
    charge_left: float
    ends_by: Literal["low voltage", "full duty", "breakdown", "empty"]
    voltage_full_V: float
    voltage_end_V: float
    mean_current_A: float


def hover_endurance(battery: Battery, *, power_W: float, motor_voltage_V: float) -> HoverEndurance:
    """Return the endurance of a battery with motors of constant power.

    Parameters
    ----------
    battery : Battery
        Battery of a drive or a vehicle.
    power_W : float
        Power of all motors together, at the battery.
    motor_voltage_V : float
        Highest mean voltage required by a motor.

    Raises
    ------
    MuflyError
        If the full battery cannot supply the power or voltage.
    """
    r, electronics = internal_resistance(battery), float(battery.electronics_current)
    ends: dict[Literal["low voltage", "full duty", "breakdown"], float] = {
        "low voltage": 0.0 if battery.model == "constant" else float(battery.low_voltage),
        "full duty": motor_voltage_V,
        "breakdown": math.sqrt(r * power_W),
    }
    by = max(ends, key=lambda key: ends[key])
    end = ends[by]
    rest_end = end + r * (power_W / end + electronics) if end > 0 else 0.0
    if battery.model == "constant":
        charge, rest = np.array([0.0, 1.0]), np.full(2, open_circuit_voltage(battery, 1.0))
    else:
        charge = np.array(battery.open_circuit_voltage.fraction)
        rest = np.array(battery.open_circuit_voltage.value)
    if rest[-1] < rest_end - 1e-12:
        raise MuflyError(
            f"the full battery cannot hold this hover: with {power_W:.3g} W for the motors and {electronics:.2g} A "
            f"for the electronics it must keep {end:.3g} V ({by}), so {rest_end:.3g} V without load, "
            f"but has {rest[-1]:.3g} V; take more cells or less resistance, or lower the power"
        )
    below = np.flatnonzero(rest < rest_end)
    if below.size:
        k = int(below[-1])
        left = float(charge[k] + (rest_end - rest[k]) / (rest[k + 1] - rest[k]) * (charge[k + 1] - charge[k]))
        charge, rest = np.r_[left, charge[k + 1 :]], np.r_[rest_end, rest[k + 1 :]]
    node, weight = np.polynomial.legendre.leggauss(_GAUSS_NODE_COUNT)
    half, middle = 0.5 * np.diff(charge)[:, None], 0.5 * (charge[1:] + charge[:-1])[:, None]
    at = middle + half * node
    current = power_W / battery_voltage(battery, np.interp(at, charge, rest), power_W) + electronics
    time = float(battery.capacity) * float(np.sum(half * weight / current))
    return HoverEndurance(
        time_s=time,
        charge_left=float(charge[0]),
        ends_by=by if below.size else "empty",
        voltage_full_V=float(battery_voltage(battery, rest[-1], power_W)),
        voltage_end_V=float(battery_voltage(battery, max(rest[0], rest_end), power_W)),
        mean_current_A=float(battery.capacity) * (1.0 - float(charge[0])) / time if time > 0 else math.nan,
    )
