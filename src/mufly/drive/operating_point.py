"""Steady operating point of rotor and drive (thesis eq. 3.18, with variable c_Q).

In steady state eq. 4.29 gives, with motor speed w = i Omega and the torque Q(Omega) of the rotor,

    kM I = dR w + Mf + Q / (i eta)         current I
    U_m  = R I + kE w                      mean voltage at the motor (eq. 4.24 without inductance)
    P_in = U_m I / eta_c                   power from the supply; P_mech = Q Omega reaches the rotor

so the point follows in closed form from speed and torque. The only unknown is the speed, which is bracketed:

* given thrust: T(Omega) = T;
* given motor voltage or duty: dOmega/dt of eq. 4.29 (:func:`rotor_acceleration`) is zero. It decreases with the speed
  from standstill to the no-load speed of the motor.

The supply is a fixed voltage, or the battery at a charge with the voltage drop of all motors (:func:`battery_voltage`).
The motor needs duty = U_m / U, at most 1. The losses are R I^2 in copper, (kE - kM) w I in iron, dR w^2 + Mf w in
friction, the fraction 1 - eta of the gear's input, and (1 - eta_c) P_in in the controller.

The load of a rotor is a function ``load(speed_rad_s, case)``. It returns thrust (N) and torque (N m), each (m,), at
speeds (m,) of the cases with the indices ``case`` (m,). A load may hold arrays with an entry for each case; the load of
a single rotor ignores the indices.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mufly.drive.drive_train import (
    DriveTrain,
    MotorConstants,
    armature_current,
    battery_voltage,
    internal_resistance,
    open_circuit_voltage,
    rotor_acceleration,
    terminal_voltage,
)
from mufly.errors import ArgumentError, InputError, MuflyError
from mufly.quantities.units import RPM
from mufly.results import result
from mufly.root_finding import find_rising_root
from mufly.rotor import Air, Blading, solve_rotor_batch
from mufly.rotor.validity_checks import check_pitch
from mufly.vehicle import find_battery_voltage_range

Array = NDArray[np.float64]
Integers = NDArray[np.int64]

SUPPLY_VOLTAGE_FACTOR_RANGE = (0.01, 3.0)
"""Range of bench supply voltages: factors on the battery's lowest and highest voltage in use."""
MIN_SPEED_rad_s, MAX_SPEED_rad_s = 1e-2, 2e4  # rad/s; limits of the speeds of rotors
_rotor_acceleration: Callable[..., Array] = rotor_acceleration.py_func  # the uncompiled function works on arrays
_armature_current: Callable[..., Array] = armature_current.py_func
_terminal_voltage = np.vectorize(terminal_voltage, otypes=[float])


@result
class OperatingPoint:
    """Steady state of one rotor with its drive; arrays over cases (without axes for a single case).

    Attributes
    ----------
    speed_rad_s : array
        Rotor speed.
    thrust_N, torque_Nm : array
        Thrust and torque of the rotor.
    gear_ratio : array
        Motor speed over rotor speed.
    motor_speed_rad_s, motor_voltage_V, motor_current_A : array
        Speed, mean voltage and current of one motor.
    voltage_V : array
        Voltage of the supply.
    duty : array
        Motor voltage over supply voltage.
    supply_current_A, input_power_W : array
        Current and power of one motor's controller from the supply, without electronics.
    mechanical_power_W : array
        Power that reaches the rotor.
    efficiency : array
        Mechanical over electrical power.
    thrust_per_power_N_W : array
        Thrust over electrical power.
    copper_loss_W, conversion_loss_W, friction_loss_W, gear_loss_W, controller_loss_W : array
        Losses, see the module docstring.
    """

    speed_rad_s: Array
    thrust_N: Array
    torque_Nm: Array
    gear_ratio: Array
    motor_speed_rad_s: Array
    motor_voltage_V: Array
    motor_current_A: Array
    voltage_V: Array
    duty: Array
    supply_current_A: Array
    input_power_W: Array
    mechanical_power_W: Array
    efficiency: Array
    thrust_per_power_N_W: Array
    copper_loss_W: Array
    conversion_loss_W: Array
    friction_loss_W: Array
    gear_loss_W: Array
    controller_loss_W: Array


def compute_operating_point(
    c: MotorConstants, speed: ArrayLike, thrust: ArrayLike, torque: ArrayLike, voltage: ArrayLike
) -> OperatingPoint:
    """Return the steady operating point for speed, thrust and torque of a rotor.

    Parameters
    ----------
    c : MotorConstants
        Constants of motor, controller and gear.
    speed, thrust, torque : array_like
        Speed (rad/s), thrust (N) and torque (N m) of the rotor.
    voltage : array_like
        Supply voltage (V); not checked against the motor voltage (``duty`` may exceed 1).
    """
    w_rotor, t, q, u = (np.asarray(v, dtype=np.float64) for v in (speed, thrust, torque, voltage))
    i = np.asarray(c.gear_ratio, dtype=np.float64)
    w = i * w_rotor
    entering = q / (i * c.gear_efficiency)
    current = (entering + c.friction_Nm_s * w + c.friction_Nm) / c.torque_Nm_A
    motor_voltage = c.resistance_ohm * current + c.back_emf_V_s * w
    to_motor = motor_voltage * current
    power, mechanical = to_motor / c.controller_efficiency, q * w_rotor
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        point = OperatingPoint(
            speed_rad_s=w_rotor, thrust_N=t, torque_Nm=q, gear_ratio=i, motor_speed_rad_s=w,
            motor_voltage_V=motor_voltage, motor_current_A=current, voltage_V=u, duty=motor_voltage / u,
            supply_current_A=power / u, input_power_W=power, mechanical_power_W=mechanical,
            efficiency=mechanical / power, thrust_per_power_N_W=t / power,
            copper_loss_W=c.resistance_ohm * current**2,
            conversion_loss_W=(c.back_emf_V_s - np.asarray(c.torque_Nm_A)) * w * current,
            friction_loss_W=c.friction_Nm_s * w**2 + c.friction_Nm * w, gear_loss_W=entering * w - mechanical,
            controller_loss_W=power - to_motor,
        )  # fmt: skip
    shape = np.broadcast_shapes(*(np.shape(v) for v in vars(point).values()))
    return replace(point, **{k: np.broadcast_to(v, shape).astype(np.float64) for k, v in vars(point).items()})


def find_speed_for_thrust(
    load: RotorLoad, thrust_N: ArrayLike, *, highest: ArrayLike = MAX_SPEED_rad_s
) -> tuple[Array, NDArray[np.bool_]]:
    """Find the rotor speed (rad/s) at which the load gives each thrust; return the speeds, and which were found.

    Parameters
    ----------
    load : RotorLoad
    thrust_N : (n,) array_like
        Thrust of each case, above 0.
    highest : float or (n,) array_like
        Upper limit of the speed (rad/s).

    Returns
    -------
    speed : (n,) array
        nan where the thrust is out of reach.
    found : (n,) array of bool
    """
    wanted = np.atleast_1d(np.asarray(thrust_N, dtype=np.float64))
    start = np.full(wanted.shape, 500.0)
    top = np.broadcast_to(np.asarray(highest, dtype=np.float64), wanted.shape)
    thrust = load(np.minimum(start, top), np.arange(wanted.size))[0]
    # Thrust is nearly proportional to the square of the speed, which gives a good second guess.
    ratio = np.where(thrust > 0, wanted / np.where(thrust > 0, thrust, 1.0), 1.0)
    better = np.clip(start * np.sqrt(ratio), MIN_SPEED_rad_s, top)
    return find_rising_root(
        lambda speed, case: load(speed, case)[0] - wanted[case], better, lowest=MIN_SPEED_rad_s, highest=top
    )


def compute_no_load_speed(c: MotorConstants, voltage: ArrayLike) -> Array:
    """Return the speed (rad/s) of the rotor shaft without rotor torque."""
    per_current = c.torque_Nm_A / np.asarray(c.resistance_ohm)
    driving = np.maximum(per_current * np.asarray(voltage) - c.friction_Nm, 0.0)
    return driving / (c.gear_ratio * (per_current * c.back_emf_V_s + c.friction_Nm_s))


def find_operating_point(
    drive: DriveTrain,
    load: RotorLoad,
    *,
    thrust_N: ArrayLike | None = None,
    duty: ArrayLike | None = None,
    motor_voltage_V: ArrayLike | None = None,
    supply_V: float | None = None,
    charge: float | None = None,
    gear_ratio: ArrayLike | None = None,
) -> OperatingPoint:
    """Find the steady state of each rotor of a drive with equal loads on all rotors.

    Parameters
    ----------
    drive : DriveTrain
    load : RotorLoad
        From :func:`mufly.drive.make_blade_load` or :func:`mufly.drive.make_coefficient_load`.
    thrust_N, duty, motor_voltage_V : array_like
        Exactly one: thrust of one rotor, duty (motor over supply voltage, 0 to 1), or voltage at the motor.
    supply_V : float, optional
        Fixed supply voltage. Default: the battery's nominal voltage.
    charge : float, optional
        Charge (0 to 1) of the battery as supply, with the voltage drop of all motors and the electronics.
    gear_ratio : array_like, optional
        Gear ratio in place of the drive's, broadcast against the given quantity.

    Returns
    -------
    OperatingPoint
        Arrays of the broadcast shape.

    Raises
    ------
    InputError
        If not exactly one quantity is given, or its value is invalid.
    MuflyError
        If motor or battery cannot give the thrust; the message states the greatest thrust.
    """
    place = "operating point"
    given = [("thrust_N", thrust_N), ("duty", duty), ("motor_voltage_V", motor_voltage_V)]
    asked = [(k, v) for k, v in given if v is not None]
    if len(asked) != 1:
        raise InputError(place, "", f"{len(asked)} of thrust, duty and voltage are given", "give exactly one")
    if supply_V is not None and charge is not None:
        raise InputError(place, "supply", "both a voltage and a charge are given", "give one of the two")
    key, raw = asked[0]
    own = drive.motor_constants()
    values, ratio = np.broadcast_arrays(
        np.asarray(raw, dtype=np.float64),
        np.asarray(own.gear_ratio if gear_ratio is None else gear_ratio, dtype=np.float64),
    )
    shape, value = values.shape, values.ravel()
    if not (np.all(np.isfinite(value)) and np.all(value > 0)) or (key == "duty" and np.any(value > 1)):
        remedy = "give a number above 0 and up to 1" if key == "duty" else "give a number above 0"
        raise InputError(place, key, f"{np.array2string(value[:3])} is out of range", remedy)
    if not (np.all(np.isfinite(ratio)) and np.all(ratio > 0)):
        raise InputError(place, "gear_ratio", "is not above 0", "give motor speed over rotor speed")
    low, full = find_battery_voltage_range(drive.battery)
    if (
        supply_V is not None
        and not SUPPLY_VOLTAGE_FACTOR_RANGE[0] * low <= supply_V <= SUPPLY_VOLTAGE_FACTOR_RANGE[1] * full
    ):
        raise ArgumentError(
            "supply_V", "", f"{supply_V:g} V is out of range for {drive.name}, whose battery has {low:g} to "
            f"{full:g} V",
            f"give {SUPPLY_VOLTAGE_FACTOR_RANGE[0] * low:g} to {SUPPLY_VOLTAGE_FACTOR_RANGE[1] * full:g} V",
        )  # fmt: skip
    c = replace(own, gear_ratio=ratio.ravel().copy())
    if charge is None:
        supply = _PowerSupply(drive, float(supply_V or float(drive.battery.nominal_voltage)), sags_under_load=False)
    else:
        supply = _PowerSupply(drive, open_circuit_voltage(drive.battery, charge), sags_under_load=True)
    find = {
        "thrust_N": _operating_point_at_thrust,
        "duty": _operating_point_at_duty,
        "motor_voltage_V": _operating_point_at_voltage,
    }[key]
    point = find(supply, c, load, value)
    return replace(point, **{k: v.reshape(shape) for k, v in vars(point).items()})


@dataclass(frozen=True)
class _PowerSupply:
    """Supply of the drive: the fixed voltage ``voltage_V``, or a battery with this open-circuit voltage and its
    internal resistance.
    """

    drive: DriveTrain
    voltage_V: float
    sags_under_load: bool

    def voltage_at_power(self, power: Array) -> Array:
        """Return the supply voltage (V) at a power (W) of each motor."""
        if not self.sags_under_load:
            return np.full(power.shape, self.voltage_V)
        return battery_voltage(self.drive.battery, self.voltage_V, self.drive.rotors * power)

    def voltage_at_duty(self, c: MotorConstants, duty: Array, speed: Array) -> Array:
        """Return the supply voltage (V) at a rotor speed (rad/s) and a duty of the motors."""
        if not self.sags_under_load:
            return np.full(speed.shape, self.voltage_V)
        battery = self.drive.battery
        share = self.drive.rotors * duty / (c.resistance_ohm * c.controller_efficiency)
        source = share * c.back_emf_V_s * c.gear_ratio * speed
        electronics = float(battery.electronics_current)
        return np.asarray(
            _terminal_voltage(self.voltage_V, internal_resistance(battery), share * duty, source, electronics)
        )


def _operating_point_at_thrust(
    supply: _PowerSupply, c: MotorConstants, load: RotorLoad, thrust: Array
) -> OperatingPoint:
    speed, _ = find_speed_for_thrust(load, thrust)
    _, torque = load(np.where(np.isfinite(speed), speed, 1.0), np.arange(thrust.size))
    voltage = supply.voltage_at_power(compute_operating_point(c, speed, thrust, torque, 1.0).input_power_W)
    point = compute_operating_point(c, speed, thrust, torque, voltage)
    short = ~(point.duty <= 1.0 + 1e-9)
    if np.any(short):
        k = int(np.argmax(short))
        one = c.select_cases(np.array([k]))
        most = _operating_point_at_duty(supply, one, lambda s, case: load(s, np.full(s.shape, k)), np.ones(1))
        raise MuflyError(
            f"a thrust of {thrust[k]:.4g} N is out of reach: at full duty and gear ratio "
            f"{float(most.gear_ratio[0]):.4g} the drive {supply.drive.name!r} turns this rotor at "
            f"{float(most.speed_rad_s[0]) / RPM:.0f} rpm, which gives {float(most.thrust_N[0]):.4g} N"
        )
    return point


def _operating_point_at_duty(supply: _PowerSupply, c: MotorConstants, load: RotorLoad, duty: Array) -> OperatingPoint:
    def terminal_voltage_of(speed: Array, case: Integers) -> Array:
        return supply.voltage_at_duty(c.select_cases(case), duty[case], speed)

    speed, found = _find_steady_speed(
        c, load, lambda s, case: duty[case] * terminal_voltage_of(s, case), duty * supply.voltage_V
    )
    thrust, torque = _evaluate_load(supply.drive, load, speed, found)
    return compute_operating_point(c, speed, thrust, torque, terminal_voltage_of(speed, np.arange(duty.size)))


def _operating_point_at_voltage(
    supply: _PowerSupply, c: MotorConstants, load: RotorLoad, voltage: Array
) -> OperatingPoint:
    speed, found = find_speed_at_voltage(c, load, voltage)
    thrust, torque = _evaluate_load(supply.drive, load, speed, found)
    fed = supply.voltage_at_power(compute_operating_point(c, speed, thrust, torque, 1.0).input_power_W)
    point = compute_operating_point(c, speed, thrust, torque, fed)
    if not np.all(point.duty <= 1.0 + 1e-9):
        least = float(np.nanmin(fed)) if np.any(np.isfinite(fed)) else 0.0
        raise MuflyError(f"{float(voltage.max()):.3g} V at the motor is out of reach: the supply gives {least:.3g} V")
    return point


def _evaluate_load(drive: DriveTrain, load: RotorLoad, speed: Array, found: NDArray[np.bool_]) -> tuple[Array, Array]:
    if not np.all(found):
        raise MuflyError(
            f"drive {drive.name!r} has no steady speed with this rotor; check the sign of the rotor's torque"
        )
    return load(speed, np.arange(speed.size))


def find_speed_at_voltage(c: MotorConstants, load: RotorLoad, voltage_V: Array) -> tuple[Array, NDArray[np.bool_]]:
    """Find the steady rotor speed (rad/s) at each motor voltage; return the speeds, and which were found.

    Parameters
    ----------
    c : MotorConstants
        Motor constants, scalars or arrays over the cases.
    load : RotorLoad
    voltage_V : (n,) array
        Mean voltage at the motor.

    Returns
    -------
    speed : (n,) array
        Speed (rad/s); nan where there is none.
    found : (n,) array of bool

    Thesis: eq. 3.18.
    """
    return _find_steady_speed(c, load, lambda speed, case: voltage_V[case], voltage_V)


def _find_steady_speed(
    c: MotorConstants, load: RotorLoad, voltage: Callable[[Array, Integers], Array], at_most: Array
) -> tuple[Array, NDArray[np.bool_]]:
    """Find each case's rotor speed (rad/s) without acceleration by eq. 4.29, and whether there is one; ``voltage``
    returns the motor voltage for speeds and cases.
    """

    def net_deceleration(speed: Array, case: Integers) -> Array:
        m = c.select_cases(case)
        current = _armature_current(1.0, voltage(speed, case), speed, m.back_emf_V_s, m.resistance_ohm, m.gear_ratio)
        return -_rotor_acceleration(
            current, speed, load(speed, case)[1], m.torque_Nm_A, m.friction_Nm_s, m.friction_Nm, m.gear_ratio,
            m.gear_efficiency, 1.0,
        )  # fmt: skip

    top = np.broadcast_to(compute_no_load_speed(c, at_most), at_most.shape)
    # A rotor driven by the air (in descent) may exceed the no-load speed.
    return find_rising_root(net_deceleration, 0.6 * top, lowest=MIN_SPEED_rad_s, highest=np.maximum(20.0 * top, 1.0))


RotorLoad = Callable[[Array, Integers], tuple[Array, Array]]


def make_coefficient_load(c_T: float, c_Q: float, *, radius_m: float, density_kg_m3: float = 1.2) -> RotorLoad:
    """Return the load of a rotor with constant coefficients, as in eq. 3.18.

    Parameters
    ----------
    c_T, c_Q : float
        T / (rho pi R^4 Omega^2), Q / (rho pi R^5 Omega^2).
    radius_m, density_kg_m3 : float
        R and rho.
    """
    thrust = c_T * density_kg_m3 * math.pi * radius_m**4
    torque = c_Q * density_kg_m3 * math.pi * radius_m**5
    return lambda speed, case: (thrust * speed**2, torque * speed**2)


def make_blade_load(
    blading: Blading,
    *,
    pitch_rad: ArrayLike,
    which: ArrayLike = 0,
    climb_m_s: ArrayLike = 0.0,
    air: Air | None = None,
) -> RotorLoad:
    """Return the load of a rotor by blade element momentum theory, with coefficients that vary with speed.

    Parameters
    ----------
    blading : Blading
        One or several rotors.
    pitch_rad, climb_m_s, which : array_like
        Pitch setting (rad), axial speed (m/s) and rotor index of each case; scalars apply to all.
    air : Air, optional
        Density and viscosity.
    """
    check_pitch("rotor", "pitch_rad", pitch_rad)
    pitch, climb = np.asarray(pitch_rad, dtype=np.float64), np.asarray(climb_m_s, dtype=np.float64)
    index = np.asarray(which, dtype=np.int64)

    def select_cases(values: NDArray, case: Integers) -> NDArray:
        return values if values.ndim == 0 else values[case]

    def evaluate_blades(speed: Array, case: Integers) -> tuple[Array, Array]:
        r = solve_rotor_batch(
            blading,
            pitch_rad=select_cases(pitch, case),
            speed_rad_s=speed,
            climb_m_s=select_cases(climb, case),
            which=select_cases(index, case),
            air=air,
        )
        return r.thrust_N, r.torque_Nm

    return evaluate_blades


def scale_load_to_reference(load: RotorLoad, speed_rad_s: float, thrust_N: float, torque_Nm: float) -> RotorLoad:
    """Return a load with thrust and torque scaled to match a reference point of one rotor.

    Parameters
    ----------
    load : RotorLoad
        Load of one rotor.
    speed_rad_s, thrust_N, torque_Nm : float
        Reference point, from the wake method or a bench.

    Raises
    ------
    InputError
        If thrust or torque of the load is zero at that speed, or has the opposite sign.
    """
    thrust, torque = load(np.array([float(speed_rad_s)]), np.array([0]))
    factors = []
    for name, known, ours in (("thrust_N", thrust_N, thrust[0]), ("torque_Nm", torque_Nm, torque[0])):
        if not known * ours > 0.0:
            raise InputError(
                "load",
                name,
                f"is {ours:.3g} in the load model, but {known:.3g} in the given operating point",
                "check the operating point",
            )
        factors.append(known / ours)

    def evaluate_scaled(speed: Array, case: Integers) -> tuple[Array, Array]:
        thrust, torque = load(speed, case)
        return factors[0] * thrust, factors[1] * torque

    return evaluate_scaled
