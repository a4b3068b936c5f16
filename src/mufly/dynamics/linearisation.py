"""Trim (inputs, rotor speeds and attitude of steady flight), hover performance and linear models.

Unknowns: both rotor speeds, both motor inputs, both tilts of the lower rotor (through the servos), roll and pitch.
Equations: the six accelerations and the two rotor accelerations of
:func:`mufly.dynamics.equations_of_motion.state_derivative` vanish. In steady flight the stabiliser bar is normal to the
mast. The search starts from hover in closed form::

    cT_up k_T Wu^2 + cT_dw k_T Wd^2 = m g + W_hub        cQ_up Wu^2 = cQ_dw Wd^2        (eq. 5.1)

With a coefficient map this is iterated with the coefficients at the last speeds.

Endurance is the hover time of a battery: ``C d(charge)/dt = -I(charge)``, with the trim current at each charge. It ends
when the terminal voltage falls to ``battery.low_voltage`` or the motors reach full input. Thrust to weight is that of
both motors at full input in steady state, with the voltage drop of the battery. Own derivation.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

import control
import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.optimize import root

from mufly.dynamics.edgewise_loads import edgewise_load_factors, is_inside_flight_map, tip_path_tilt_target
from mufly.dynamics.equations_of_motion import (
    compute_axial_climb_velocity,
    compute_battery_supply,
    is_inside_coefficient_map,
    rotor_loads,
    state_derivative,
)
from mufly.dynamics.model_state import (
    ATTITUDE_SLICE,
    BAR_NORMAL_SLICE,
    BODY_RATE_SLICE,
    MODEL_BAR_NORMAL,
    MODEL_CHARGE,
    MODEL_POSITION,
    MODEL_SPEED_LOWER,
    MODEL_SPEED_UPPER,
    MODEL_SWASH_PITCH,
    MODEL_SWASH_ROLL,
    MOTOR_INPUT_SLICE,
    NED_POSITION_SLICE,
    NED_VELOCITY_SLICE,
    ROTOR_SPEED_SLICE,
    SERVO_INPUT_SLICE,
    STATE_SIZE,
    SWAPPED_MOTOR_INPUT_INDICES,
    body_to_ned_matrix,
    compute_hover_rotor_speeds,
    initial_state,
    model_parameters,
)
from mufly.dynamics.simulation import find_step_limiting_parameter
from mufly.errors import InputError, MuflyError
from mufly.quantities.units import GRAVITY, RPM
from mufly.results import ResultColumn, ShownBlock, result, tabulate_fields
from mufly.results.result_figure import blank_figure, enable_notebook_display
from mufly.rotations import euler_from_quaternion, quaternion_from_euler
from mufly.vehicle import Vehicle

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_HOVER_ITERATIONS = 30


@result
class Trim:
    """Steady flight condition.

    Attributes
    ----------
    state : (21,) array
        State, see :mod:`mufly.dynamics.model_state`; at the origin of N-E-D.
    input : (4,) array
        Motor upper, motor lower, servo 1, servo 2.
    wind : (3,) array
        Wind velocity, N-E-D (m/s).
    thrust_N, torque_Nm : (2,) array
        Thrust and torque of upper and lower rotor.
    battery_voltage_V, battery_current_A, battery_power_W : float
        Voltage, current and power at the battery's terminals.
    constant_voltage_V : float or None
        Constant voltage of the model; None with the vehicle's battery model.
    inside_map : bool
        False if the point lies beyond an edge of the vehicle's coefficient map or flight map.
    """

    state: NDArray[np.float64]
    input: NDArray[np.float64]
    wind: NDArray[np.float64]
    thrust_N: NDArray[np.float64]
    torque_Nm: NDArray[np.float64]
    battery_voltage_V: float
    battery_current_A: float
    battery_power_W: float
    constant_voltage_V: float | None
    inside_map: bool = True

    def __str__(self) -> str:
        n, e, d = self.state[NED_VELOCITY_SLICE]
        roll, pitch, _ = np.degrees(euler_from_quaternion(self.state[ATTITUDE_SLICE]))
        rpm = self.rotor_speed / RPM
        motor_up, motor_dw, servo_1, servo_2 = self.input
        return (
            f"steady at N {n:g}, E {e:g}, D {d:g} m/s: roll {roll:.2f}, pitch {pitch:.2f} deg\n"
            f"  motor input {motor_up:.3f} upper, {motor_dw:.3f} lower; servo input {servo_1:.3f}, {servo_2:.3f}\n"
            f"  rotor speed {rpm[0]:.0f} upper, {rpm[1]:.0f} lower rpm; "
            f"thrust {self.thrust_N[0]:.3f}, {self.thrust_N[1]:.3f} N\n"
            f"  battery {self.battery_voltage_V:.2f} V, {self.battery_current_A:.2f} A, {self.battery_power_W:.1f} W"
            + ("" if self.inside_map else "\n  beyond the vehicle's flight map: values at its edge are used")
        )

    @property
    def motor_input(self) -> NDArray[np.float64]:
        """Motor inputs of upper and lower rotor (0..1)."""
        return self.input[MOTOR_INPUT_SLICE]

    @property
    def servo_input(self) -> NDArray[np.float64]:
        """Inputs of servo 1 and servo 2 (-1..1)."""
        return self.input[SERVO_INPUT_SLICE]

    @property
    def rotor_speed(self) -> NDArray[np.float64]:
        """Speeds of upper and lower rotor (rad/s)."""
        return self.state[ROTOR_SPEED_SLICE]


def find_trim(
    vehicle: Vehicle,
    *,
    velocity: ArrayLike = (0.0, 0.0, 0.0),
    wind: ArrayLike = (0.0, 0.0, 0.0),
    heading: float = 0.0,
    voltage: float | None = None,
    charge: float | None = None,
) -> Trim:
    """Find the steady flight condition for a velocity: hover by default, or steady climb or translation.

    Parameters
    ----------
    vehicle : Vehicle
    velocity, wind : (3,) array_like
        Velocities of vehicle and air, N-E-D (m/s).
    heading : float
        Yaw angle (rad).
    voltage : float, optional
        Battery voltage held constant (V); the nominal voltage by default.
    charge : float, optional
        Use the vehicle's own battery model at this fraction of its charge instead.

    Returns
    -------
    Trim

    Raises
    ------
    InputError
        If the vehicle is too heavy to hover, or an argument is impossible.
    MuflyError
        If no trim exists at this velocity.
    """
    velocity_, wind_ = _check_vector(velocity, "velocity"), _check_vector(wind, "wind")
    if charge is not None and voltage is not None:
        raise InputError("trim", "voltage", "given together with charge", "give one of them")
    if charge is not None and not 0.0 <= charge <= 1.0:
        raise InputError("trim", "charge", f"{charge} is out of range", "give a fraction from 0 to 1")
    constant = None
    if charge is None:
        constant = float(vehicle.battery.nominal_voltage) if voltage is None else voltage
    p = model_parameters(vehicle, constant)
    charge_ = 1.0 if charge is None else charge

    speed, duty, volts = _estimate_hover_inputs(p, charge_)
    if np.any(duty > 1.0):
        raise InputError(
            vehicle.name,
            "body.mass",
            f"too heavy to hover: {p['mass'] * 1e3:.0f} g need motor inputs of {duty[0]:.2f} (upper) and "
            f"{duty[1]:.2f} (lower) at {volts:.2f} V, at most 1 is possible",
            "lower it, raise the battery voltage, or change rotors, gear or motors",
        )

    def assemble_state(unknown: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        upper, lower, motor_up, motor_dw, servo_1, servo_2, roll, pitch = unknown
        x = initial_state(
            position=(0.0, 0.0, -1e3),  # far from the floor
            velocity=velocity_,
            attitude=(roll, pitch, heading),
            rotor_speed=np.array([upper, lower]) * speed,
            charge=charge_,
        )
        x[MODEL_SWASH_ROLL], x[MODEL_SWASH_PITCH] = tip_path_tilt_target(
            servo_1, servo_2, p["swash_gain"], p["swash_phase"]
        )
        return x, np.array([motor_up, motor_dw, servo_1, servo_2])

    rates = np.empty(STATE_SIZE)

    def trim_residual(unknown: NDArray[np.float64]) -> NDArray[np.float64]:
        x, u = assemble_state(unknown)
        state_derivative(x, u, wind_, p, rates)
        return np.concatenate(
            [rates[NED_VELOCITY_SLICE] / GRAVITY, rates[BODY_RATE_SLICE] / 100.0, rates[ROTOR_SPEED_SLICE] / 1000.0]
        )

    start = np.array([1.0, 1.0, duty[0], duty[1], 0.0, 0.0, 0.0, 0.0])
    found = root(trim_residual, start, method="hybr", options={"xtol": 1e-13})
    x, u = assemble_state(found.x)
    motor_up, motor_dw, servo_1, servo_2 = u
    worst = float(np.max(np.abs(trim_residual(found.x))))
    if not worst < 1e-9 or np.any(u[MOTOR_INPUT_SLICE] >= 1.0) or np.any(np.abs(u[SERVO_INPUT_SLICE]) > 1.0):
        if not (velocity_.any() or wind_.any()):  # without velocity or wind the vehicle itself is the cause
            raise MuflyError(
                f"{vehicle.name}: no hover was found within the inputs' range (motors {motor_up:.2f}, "
                f"{motor_dw:.2f}, "
                f"servos {servo_1:.2f}, {servo_2:.2f}; residual {worst:.1g} of an acceleration); check "
                f"{find_step_limiting_parameter(p)}, which has the fastest mode, and the rotors' coefficients and "
                f"inertias"
            )
        raise MuflyError(
            f"{vehicle.name}: no steady flight at velocity {velocity_.tolist()} m/s in wind "
            f"{wind_.tolist()} m/s "
            f"within the inputs' range (motors {motor_up:.2f}, {motor_dw:.2f}); ask for a lower speed or less wind"
        )
    x[MODEL_POSITION + 2] = 0.0
    volts, current = compute_battery_supply(x, motor_up, motor_dw, p)
    climb = float(compute_axial_climb_velocity(x, wind_))
    speed_up, speed_dw = x[ROTOR_SPEED_SLICE]
    t_up, t_dw, q_up, q_dw = rotor_loads(p, speed_up, speed_dw, climb)
    inside = is_inside_coefficient_map(vehicle, speed_up, speed_dw, climb)
    if p["flight_map_node_count"] > 0:
        f_up, f_dw = edgewise_load_factors(x, wind_, p)
        t_up, q_up, t_dw, q_dw = t_up * f_up[0], q_up * f_up[1], t_dw * f_dw[0], q_dw * f_dw[1]
        inside = inside and is_inside_flight_map(x, wind_, p)
    return Trim(
        state=x,
        input=u,
        wind=wind_,
        thrust_N=np.array([t_up, t_dw]),
        torque_Nm=np.array([q_up, q_dw]),
        battery_voltage_V=float(volts),
        battery_current_A=float(current),
        battery_power_W=float(volts * current),
        constant_voltage_V=constant,
        inside_map=inside,
    )


def _check_vector(vector: ArrayLike, name: str) -> NDArray[np.float64]:
    v = np.asarray(vector, dtype=np.float64)
    if v.shape != (3,) or not np.all(np.isfinite(v)):
        raise InputError("trim", name, f"{vector!r}", "give three finite numbers N, E, D in m/s")
    return v


def _estimate_hover_inputs(
    p: np.void, charge: float
) -> tuple[NDArray[np.float64], NDArray[np.float64], float]:  # fmt: skip
    """Return rotor speeds (rad/s), motor inputs (not limited to 1) and battery voltage (V) in hover at a charge."""
    thrust = np.array([p["thrust_up"], p["thrust_dw"]])  # divided by the squares of the speeds
    drag = np.array([p["torque_up"], p["torque_dw"]])
    for _ in range(_HOVER_ITERATIONS if p["map_node_count"] else 1):
        speed = compute_hover_rotor_speeds(p, thrust, drag)
        if p["map_node_count"]:
            loads = np.array(rotor_loads(p, speed[0], speed[1])).reshape(2, 2) / speed**2
            if not np.all(loads > 0.0):
                raise MuflyError("thrust or torque is not positive at hover in the coefficient map; use another map")
            # Half steps: a faster lower rotor has less inflow from the upper rotor and needs less speed.
            thrust, drag = 0.5 * (thrust + loads[0]), 0.5 * (drag + loads[1])
    torque = drag * speed**2
    i = p["gear_ratio"]
    current = (p["dR"] * speed + p["Mf"] / i + torque / (i * i * p["gear_efficiency"])) * i / p["kM"]
    armature_voltage = current * p["R_ohm"] + p["kE"] * i * speed
    # The power of the motors is armature_voltage * current; solve U (U_oc - U) / R_bat = power + U I_el for U.
    open_circuit = float(np.interp(charge, np.linspace(0, 1, len(p["battery_curve"])), p["battery_curve"]))
    r = p["battery_resistance"]
    drive_power = float(np.sum(armature_voltage * current))
    source = open_circuit - r * p["electronics_current"]
    voltage = source / 2 + math.sqrt(max(source * source / 4 - r * drive_power, 0.0))
    return speed, armature_voltage / voltage, voltage


_ENDURANCE_CHARGE_POINT_COUNT = 21


@result
class HoverPerformance:
    """Hover performance on a half-full battery, with its reserves.

    Attributes
    ----------
    rotor_speed_rad_s, motor_input, thrust_N : (float, float)
        Speed, motor input and thrust of upper and lower rotor.
    battery_voltage_V, battery_current_A, battery_power_W : float
        Voltage, current and power at the battery's terminals, including electronics.
    endurance_s : float
        Hovering time from a full battery.
    thrust_to_weight_full, thrust_to_weight_half : float
        Thrust over weight with both motors at full input, on a full and on a half-full battery.
    """

    rotor_speed_rad_s: tuple[float, float]
    motor_input: tuple[float, float]
    thrust_N: tuple[float, float]
    battery_voltage_V: float
    battery_current_A: float
    battery_power_W: float
    endurance_s: float
    thrust_to_weight_full: float
    thrust_to_weight_half: float

    def make_printed_blocks(self) -> list[ShownBlock]:
        """Return the hover point with its reserves as printed text."""
        pairs = {"rotor_speed_rad_s": ("rpm", ".0f"), "motor_input": ("", ".3f"), "thrust_N": ("", ".3f")}
        columns = [ResultColumn(name, *how, entry_names=("upper", "lower")) for name, how in pairs.items()]
        columns += [
            ResultColumn("battery_voltage_V", form=".2f"),
            ResultColumn("battery_current_A", form=".2f"),
            ResultColumn("battery_power_W", form=".1f", head="battery power with electronics"),
            ResultColumn("endurance_s", "min", ".1f", "endurance from a full battery"),
            ResultColumn("thrust_to_weight_full", form=".2f", head="thrust to weight, full battery"),
            ResultColumn("thrust_to_weight_half", form=".2f", head="thrust to weight, half-full battery"),
        ]
        return [tabulate_fields(self, columns)]


@functools.lru_cache(maxsize=16)
def hover_current_A(vehicle: Vehicle) -> float:
    """Return the current (A) in hover on a half-full battery, equal to that of :func:`hover_performance` but faster.

    The last results are cached: a campaign of flights asks for the same vehicle in each flight.

    Raises
    ------
    MuflyError
        If the vehicle is too heavy to hover.
    """
    return find_trim(vehicle, charge=0.5).battery_current_A


def hover_performance(vehicle: Vehicle) -> HoverPerformance:
    """Return hover point, endurance and greatest thrust of a vehicle with its own battery model.

    Raises
    ------
    MuflyError
        If the vehicle is too heavy to hover on a half-full battery.
    """
    t = find_trim(vehicle, charge=0.5)
    return HoverPerformance(
        rotor_speed_rad_s=(float(t.rotor_speed[0]), float(t.rotor_speed[1])),
        motor_input=(float(t.motor_input[0]), float(t.motor_input[1])),
        thrust_N=(float(t.thrust_N[0]), float(t.thrust_N[1])),
        battery_voltage_V=t.battery_voltage_V,
        battery_current_A=t.battery_current_A,
        battery_power_W=t.battery_power_W,
        endurance_s=_hover_endurance(vehicle),
        thrust_to_weight_full=_thrust_to_weight(vehicle, 1.0),
        thrust_to_weight_half=_thrust_to_weight(vehicle, 0.5),
    )


def _hover_endurance(vehicle: Vehicle) -> float:
    charges = np.linspace(1.0, 0.0, _ENDURANCE_CHARGE_POINT_COUNT)
    seconds_per_charge: list[float] = []
    for charge in charges:
        try:
            t = find_trim(vehicle, charge=float(charge))
        except MuflyError:
            break
        if t.battery_voltage_V < float(vehicle.battery.low_voltage):
            break
        seconds_per_charge.append(float(vehicle.battery.capacity) / t.battery_current_A)
    y = np.array(seconds_per_charge)
    return float(np.sum((y[1:] + y[:-1]) / 2) / (_ENDURANCE_CHARGE_POINT_COUNT - 1))


def _thrust_to_weight(vehicle: Vehicle, charge: float) -> float:
    p, rates = model_parameters(vehicle), np.empty(STATE_SIZE)
    full, calm = np.array([1.0, 1.0, 0.0, 0.0]), np.zeros(3)

    def downward_acceleration(speed: NDArray[np.float64]) -> NDArray[np.float64]:
        x = initial_state(position=(0, 0, -1e3), rotor_speed=speed, charge=charge)
        state_derivative(x, full, calm, p, rates)
        return rates[ROTOR_SPEED_SLICE].copy()

    start = find_trim(vehicle, charge=0.5).rotor_speed
    up, dw = root(downward_acceleration, start, tol=1e-10).x
    thrust_up, thrust_dw, _, _ = rotor_loads(p, up, dw)
    return float((thrust_up + thrust_dw) / (p["mass"] * GRAVITY))


# ----------------------------------------------------------------------------
# Linear models about a trim, in the thesis's state (eq. 4.30), with the two parts of appendix B.
#
# The Jacobian is that of :func:`mufly.dynamics.equations_of_motion.state_derivative` by central differences, taken in
# coordinates without
# redundancy: body velocity, Euler angles, and roll and pitch of the bar's disc seen at the trim's heading::
#
#     d(phi, theta, psi)/dt from (p, q, r)  by eq. 4.3, correctly written     (docs/thesis/thesis-errata.md, point 4)
#     dv_B/dt = A^T dv/dt - W x v_B
#     bar normal s = Rz(psi_0) (-sin zeta cos eta, sin eta, -cos zeta cos eta)     eta: bar_roll, zeta: bar_pitch
#
# At hover the parts equal appendix B. ``a_dw`` is the lower rotor's tilt that pitches (-tilt_pitch), ``b_dw`` the one
# that rolls (tilt_roll).


LINEAR_STATES = ["x", "y", "z", "u", "v", "w", "phi", "theta", "psi", "p", "q", "r", "a_dw", "b_dw"]
LINEAR_STATES += ["bar_roll", "bar_pitch", "Omega_dw", "Omega_up", "charge"]
LINEAR_POSITION, LINEAR_VELOCITY, LINEAR_ATTITUDE, LINEAR_RATES, LINEAR_TILT_PITCH, LINEAR_TILT_ROLL = (
    0,
    3,
    6,
    9,
    12,
    13,
)
LINEAR_BAR_ROLL, LINEAR_BAR_PITCH, LINEAR_SPEED_LOWER, LINEAR_SPEED_UPPER, LINEAR_CHARGE = 14, 15, 16, 17, 18
"""Indices into :data:`LINEAR_STATES`; the first of three for position, velocity, angles and rates."""
LINEAR_INPUTS = ["motor_lower", "motor_upper", "servo_1", "servo_2"]
_DIFFERENCE_STATE_SCALE = np.array([1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 400, 400, 1], dtype=np.float64)
_FINITE_DIFFERENCE_STEP = 1e-5


@result
class Linearisation:
    """Linear models of a vehicle about a trim.

    Attributes
    ----------
    trim : Trim
        Point of linearisation.
    full : control.StateSpace
        Model with all 19 states, inputs ``motor_lower, motor_upper, servo_1, servo_2``; outputs are the states.
    heave_yaw : control.StateSpace
        States ``z, w, psi, r, Omega_dw, Omega_up``; outputs ``z, psi, r`` (B.1 to B.8).
    roll_pitch : control.StateSpace
        States ``phi, theta, p, q, a_dw, b_dw, bar_roll, bar_pitch``; outputs ``phi, theta, p, q`` (B.9 to B.18).
        Without a bar the last two states are absent.
    """

    trim: Trim
    full: control.StateSpace
    heave_yaw: control.StateSpace
    roll_pitch: control.StateSpace

    def plot(self) -> Figure:
        """Draw the poles of the heave-yaw and the roll-pitch model in the complex plane; return a matplotlib figure."""
        figure = blank_figure(8.0, 3.6)
        parts = (("heave and yaw", self.heave_yaw), ("roll and pitch", self.roll_pitch))
        for axes, (name, part) in zip(figure.subplots(1, 2), parts, strict=True):
            poles = part.poles()
            axes.plot(poles.real, poles.imag, "x")
            axes.set_xscale("symlog", linthresh=1.0)  # the poles of the swash plate lie at -1000
            axes.axvline(0.0, color="0.4", lw=0.8)
            axes.set(xlabel="real part (1/s)", ylabel="imaginary part (rad/s)", title=f"{name}, {poles.size} poles")
            axes.grid(alpha=0.3)
        return enable_notebook_display(figure)


def linearise_vehicle(vehicle: Vehicle, at: Trim | None = None, *, voltage: float | None = None) -> Linearisation:
    """Linearise the flight model.

    Parameters
    ----------
    vehicle : Vehicle
    at : Trim, optional
        Point of linearisation; hover by default.
    voltage : float, optional
        Battery voltage (V) for the default hover trim; the nominal voltage by default. The battery model of the trim
        also applies to the linear model: constant, or dependent on current and charge.

    Returns
    -------
    Linearisation

    Raises
    ------
    MuflyError
        If the vehicle cannot hover.

    Thesis: eqs 4.30, 6.1, 6.2; Sec. 6.1.3.
    """
    point = find_trim(vehicle, voltage=voltage) if at is None else at
    p = model_parameters(vehicle, point.constant_voltage_V)
    full_state = point.state.copy()
    full_state[MODEL_POSITION + 2] = -1e3  # far from the floor; nothing else depends on the position
    heading = float(euler_from_quaternion(full_state[ATTITUDE_SLICE])[2])
    x0 = _to_minimal_state(full_state, heading)
    u0 = point.input[SWAPPED_MOTOR_INPUT_INDICES]

    def state_rates(x: NDArray[np.float64], u: NDArray[np.float64]) -> NDArray[np.float64]:
        return _minimal_state_rates(x, u, point.wind, p, heading)

    h = _FINITE_DIFFERENCE_STEP
    n = len(LINEAR_STATES)
    A, B = np.empty((n, n)), np.empty((n, 4))
    for j in range(n):
        d = np.zeros(n)
        d[j] = h * _DIFFERENCE_STATE_SCALE[j]
        A[:, j] = (state_rates(x0 + d, u0) - state_rates(x0 - d, u0)) / (2 * d[j])
    for j in range(4):
        d = np.zeros(4)
        d[j] = h
        B[:, j] = (state_rates(x0, u0 + d) - state_rates(x0, u0 - d)) / (2 * h)
    # Entries below the error of the differences (round-off, and h drag / m from |v| v near rest) are set to zero.
    A[np.abs(A) < 1e-6 * _DIFFERENCE_STATE_SCALE[:, None] / _DIFFERENCE_STATE_SCALE[None, :]] = 0.0
    B[np.abs(B) < 1e-6 * _DIFFERENCE_STATE_SCALE[:, None]] = 0.0

    full = control.ss(
        A,
        B,
        np.eye(n),
        np.zeros((n, 4)),
        states=LINEAR_STATES,
        inputs=LINEAR_INPUTS,
        outputs=LINEAR_STATES,
        name="full",
    )
    vertical = ["z", "w", "psi", "r", "Omega_dw", "Omega_up"]
    tilting = ["phi", "theta", "p", "q", "a_dw", "b_dw"]
    if vehicle.stabiliser_bar.fitted:
        tilting += ["bar_roll", "bar_pitch"]
    return Linearisation(
        trim=point,
        full=full,
        heave_yaw=extract_submodel(full, vertical, LINEAR_INPUTS[:2], ["z", "psi", "r"], name="heave_yaw"),
        roll_pitch=extract_submodel(full, tilting, LINEAR_INPUTS[2:], ["phi", "theta", "p", "q"], name="roll_pitch"),
    )


def extract_submodel(
    full: control.StateSpace,
    states: Sequence[str],
    inputs: Sequence[str],
    outputs: Sequence[str],
    *,
    name: str | None = None,
) -> control.StateSpace:
    """Return the linear model of selected states and inputs of another model; all other states stay constant.

    The outputs are selected states.
    """
    i, j = (
        [known.index(s) for s in some] for known, some in ((full.state_labels, states), (full.input_labels, inputs))
    )
    C = np.array([[float(s == o) for s in states] for o in outputs])
    D = np.zeros((len(outputs), len(inputs)))
    labels = {"states": list(states), "inputs": list(inputs), "outputs": list(outputs), "name": name}
    return control.ss(full.A[np.ix_(i, i)], full.B[np.ix_(i, j)], C, D, **labels)


def _to_minimal_state(x: NDArray[np.float64], heading: float) -> NDArray[np.float64]:
    a = body_to_ned_matrix(x[ATTITUDE_SLICE])
    c, s = np.cos(heading), np.sin(heading)
    bar_n, bar_e, bar_d = x[BAR_NORMAL_SLICE]
    ahead, aside = c * bar_n + s * bar_e, -s * bar_n + c * bar_e
    return np.concatenate(
        [
            x[NED_POSITION_SLICE],
            a.T @ x[NED_VELOCITY_SLICE],
            euler_from_quaternion(x[ATTITUDE_SLICE]),
            x[BODY_RATE_SLICE],
            [-x[MODEL_SWASH_PITCH], x[MODEL_SWASH_ROLL], np.arcsin(aside), np.arctan2(-ahead, -bar_d)],
            [x[MODEL_SPEED_LOWER], x[MODEL_SPEED_UPPER], x[MODEL_CHARGE]],
        ]
    )


def _to_full_state(m: NDArray[np.float64], heading: float) -> NDArray[np.float64]:
    x = np.empty(STATE_SIZE)
    x[NED_POSITION_SLICE] = m[LINEAR_POSITION:LINEAR_VELOCITY]
    x[ATTITUDE_SLICE] = quaternion_from_euler(*m[LINEAR_ATTITUDE:LINEAR_RATES])
    x[NED_VELOCITY_SLICE] = body_to_ned_matrix(x[ATTITUDE_SLICE]) @ m[LINEAR_VELOCITY:LINEAR_ATTITUDE]
    x[BODY_RATE_SLICE] = m[LINEAR_RATES:LINEAR_TILT_PITCH]
    x[MODEL_SWASH_ROLL], x[MODEL_SWASH_PITCH] = m[LINEAR_TILT_ROLL], -m[LINEAR_TILT_PITCH]
    x[BAR_NORMAL_SLICE] = -body_to_ned_matrix(quaternion_from_euler(m[LINEAR_BAR_ROLL], m[LINEAR_BAR_PITCH], heading))[
        :, 2
    ]
    x[MODEL_SPEED_UPPER], x[MODEL_SPEED_LOWER], x[MODEL_CHARGE] = (
        m[LINEAR_SPEED_UPPER],
        m[LINEAR_SPEED_LOWER],
        m[LINEAR_CHARGE],
    )
    return x


def _minimal_state_rates(
    m: NDArray[np.float64], u: NDArray[np.float64], wind: NDArray[np.float64], p: np.void, heading: float
) -> NDArray[np.float64]:
    """Return the rates of the states of the linear model, attitude as Euler angles.

    Thesis: eqs 4.3, 4.4.
    """
    x, dx = _to_full_state(m, heading), np.empty(STATE_SIZE)
    state_derivative(x, u[SWAPPED_MOTOR_INPUT_INDICES], wind, p, dx)
    a = body_to_ned_matrix(x[ATTITUDE_SLICE])
    phi, theta = m[LINEAR_ATTITUDE], m[LINEAR_ATTITUDE + 1]
    p_, q_, r_ = m[LINEAR_RATES:LINEAR_TILT_PITCH]
    turn = q_ * np.sin(phi) + r_ * np.cos(phi)
    euler_rates = [p_ + turn * np.tan(theta), q_ * np.cos(phi) - r_ * np.sin(phi), turn / np.cos(theta)]
    c, s = np.cos(heading), np.sin(heading)
    bar_n, bar_e = (
        c * dx[MODEL_BAR_NORMAL] + s * dx[MODEL_BAR_NORMAL + 1],
        -s * dx[MODEL_BAR_NORMAL] + c * dx[MODEL_BAR_NORMAL + 1],
    )
    eta, zeta = m[LINEAR_BAR_ROLL], m[LINEAR_BAR_PITCH]
    # From s = (-sin zeta cos eta, sin eta, -cos zeta cos eta).
    eta_rate = bar_e / np.cos(eta)
    zeta_rate = (-bar_n * np.cos(zeta) + dx[MODEL_BAR_NORMAL + 2] * np.sin(zeta)) / np.cos(eta)
    return np.concatenate(
        [
            dx[NED_POSITION_SLICE],
            a.T @ dx[NED_VELOCITY_SLICE]
            - np.cross(m[LINEAR_RATES:LINEAR_TILT_PITCH], m[LINEAR_VELOCITY:LINEAR_ATTITUDE]),
            euler_rates,
            dx[BODY_RATE_SLICE],
            [-dx[MODEL_SWASH_PITCH], dx[MODEL_SWASH_ROLL], eta_rate, zeta_rate],
            [dx[MODEL_SPEED_LOWER], dx[MODEL_SPEED_UPPER], dx[MODEL_CHARGE]],
        ]
    )
