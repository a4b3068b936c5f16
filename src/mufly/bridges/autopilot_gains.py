"""Gains of PX4's cascaded controllers, designed on the linear model of the vehicle file, with predicted margins.

PX4 controls each axis by a cascade; ``k``: position, velocity, angle, rate. In the order of its computation::

    v_sp = P_x (x_sp - x)        a_sp = P_v (v_sp - v) + I_v int (v_sp - v) dt - D_v dv/dt
    angle_sp = a_sp / g          rate_sp = P_angle (angle_sp - angle)
    torque = P (rate_sp - rate) + I int (rate_sp - rate) dt - D d(rate)/dt

Roll and pitch move the servos, yaw the difference of the motors, and the vertical axis, without angle and rate, their
sum. The plant is :func:`mufly.dynamics.linearise_vehicle` at hover on a half-full battery, with one and a half periods
of delay, the filter of the vehicle's inertial unit and PX4's own filters.

Design: the inner loops first, then position. Gains of a stage minimise the integral of the squared error after a step
of a disturbance: a torque for angles, wind for positions, an acceleration for the height. Constraints:

- sensitivity at most :data:`MAX_SENSITIVITY`, at the actuator and at the acceleration that the outer loop commands,
- response of a position to its reference at most :data:`MAX_REFERENCE_PEAK`,
- an angle error of :data:`HALF_SERVO_ANGLE_ERROR_DEG` moves a servo by half its range at most,
- gains within the limits of PX4's parameter list.

Load disturbance with limited sensitivity: Åström and Hägglund, Advanced PID Control (2006), Ch. 6. Assumptions: signals
are small, rates and angles have no errors, estimates of position and velocity lag by :data:`POSITION_ESTIMATE_LAG_S`.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import expm
from scipy.optimize import minimize

from mufly.dynamics import Linearisation, find_trim, linearise_vehicle
from mufly.errors import MuflyError
from mufly.quantities.units import GRAVITY
from mufly.results import ResultColumn, ShownBlock, make_lines_block, result, tabulate_results
from mufly.vehicle import Vehicle

_Array = NDArray[np.float64]
_Complex = NDArray[np.complex128]

AXIS_NAMES = ("roll", "pitch", "yaw", "vertical")
MAX_SENSITIVITY = 1.7
"""Largest sensitivity at the actuators: a phase margin of 34 degrees and a gain margin of 7.7 dB at least."""
MAX_REFERENCE_PEAK = 1.1
"""Largest response of a position to its reference."""
POSITION_ESTIMATE_LAG_S = 0.1
"""Lag of PX4's estimates of position and velocity (s)."""
HALF_SERVO_ANGLE_ERROR_DEG = 10.0
GYRO_CUTOFF_HZ, GYRO_DERIVATIVE_CUTOFF_HZ, VELOCITY_DERIVATIVE_CUTOFF_HZ = 60.0, 40.0, 5.0
"""Cut-offs of PX4's low passes: IMU_GYRO_CUTOFF, IMU_DGYRO_CUTOFF, MPC_VELD_LP."""
CONTROL_RATE_HZ = 250.0
_INPUT_DELAY_PERIODS = 1.5
_FREQUENCY_GRID = np.geomspace(1e-2, 600.0, 120)
_MAX_STABLE_REAL_PART = -1e-3
_CONSTRAINT_PENALTY = 40.0
_MAX_COST_EVALUATIONS = 200
_STEP_RESPONSE_S = 20.0
_AXIS_STATES = {
    "roll": ("v", "phi", "p", "b_dw", "bar_roll"),
    "pitch": ("u", "theta", "q", "a_dw", "bar_pitch"),
    "yaw": ("r", "Omega_dw", "Omega_up"),
    "vertical": ("w", "Omega_dw", "Omega_up"),
}


@dataclass(frozen=True, slots=True)
class CascadeGains:
    """Gains of the cascaded position, velocity, angle and rate controllers of one axis.

    Attributes
    ----------
    position, velocity, angle : float
        Proportional gains of position, velocity and angle (1/s).
    velocity_integral : float
        Integral gain of the velocity (1/s^2).
    velocity_derivative : float
        Derivative gain of the velocity (1).
    rate_proportional, rate_integral, rate_derivative : float
        P, I, D of the rate: actuator input per rad/s, rad and rad/s^2.
    """

    position: float = 0.0
    velocity: float = 0.0
    velocity_integral: float = 0.0
    velocity_derivative: float = 0.0
    angle: float = 0.0
    rate_proportional: float = 0.0
    rate_integral: float = 0.0
    rate_derivative: float = 0.0


@result
class AxisMargins:
    """Predicted margins and responses of one axis, with the loop opened at the actuator.

    Attributes
    ----------
    axis : str
    crossover_rad_s : float
        Highest frequency of a loop gain of 1.
    sensitivity, outer_sensitivity : float
        Largest sensitivity at the actuator and at the commanded acceleration; the second is NaN of yaw.
    gain_margin_dB, phase_margin_deg : float
        Least margins; of the gain in both directions.
    reference_peak : float
        Largest response of the position (of yaw: the angle) to its reference.
    wind_step_displacement_m : float
        Largest displacement after a step of the wind of 0.5 m/s; NaN of yaw and height.
    """

    axis: str
    crossover_rad_s: float
    sensitivity: float
    outer_sensitivity: float
    gain_margin_dB: float
    phase_margin_deg: float
    reference_peak: float
    wind_step_displacement_m: float


@result
class AutopilotGains:
    """Gains of all axes with their margins.

    Attributes
    ----------
    vehicle : str
    hover_thrust : float
        Mean of the motor inputs in hover on a half-full battery.
    hover_voltage_V : float
        Voltage of the battery in that hover.
    yaw_trim : float
        Half the difference of the motor inputs, upper minus lower.
    roll, pitch, yaw, vertical : CascadeGains
        Positions of roll and pitch share their gains.
    margins : tuple of AxisMargins
    """

    vehicle: str
    hover_thrust: float
    hover_voltage_V: float
    yaw_trim: float
    roll: CascadeGains
    pitch: CascadeGains
    yaw: CascadeGains
    vertical: CascadeGains
    margins: tuple[AxisMargins, ...]

    def make_printed_blocks(self) -> list[ShownBlock]:
        """Return gains and margins of all axes as printed text."""
        gains = (
            "position", "velocity", "velocity_integral", "velocity_derivative", "angle", "rate_proportional",
            "rate_integral",
        )  # fmt: skip
        margins = ("crossover_rad_s", "sensitivity", "outer_sensitivity", "gain_margin_dB", "phase_margin_deg")
        wind = ResultColumn("wind_step_displacement_m", form=".3g", head="displacement by 0.5 m/s of wind")
        return [
            tabulate_results(
                [getattr(self, axis) for axis in AXIS_NAMES],
                [ResultColumn(name, form=".3g") for name in gains],
                title=f"Gains of the cascades for {self.vehicle}", names=AXIS_NAMES,
            ),
            tabulate_results(
                self.margins, ["axis", *(ResultColumn(name, form=".3g") for name in margins), wind],
                title="Predicted margins",
            ),
            make_lines_block(f"Hover: mean motor input {self.hover_thrust:.3f}."),
        ]  # fmt: skip


@dataclass(frozen=True, slots=True)
class _AxisPlant:
    """Plant of one axis: state matrix, input column, output rows (position, velocity, angle, rate), and the
    disturbance column: wind or, for the vertical axis, an acceleration.

    ``delay_s`` and ``filters`` (natural frequencies of second-order low passes, rad/s) act on the frequency response
    alone; the test of stability approximates them. ``angle_delay_s`` is a further delay of the loop of the angle.
    """

    name: str
    A: _Array
    B: _Array
    C: _Array
    wind: _Array
    thrust_per_acceleration: float
    delay_s: float
    rate_filters: tuple[float, ...]
    angle_delay_s: float = 0.0


def design_autopilot_gains(vehicle: Vehicle, *, angle_delay_s: float = 0.0) -> AutopilotGains:
    """Design the gains of PX4's controllers for a vehicle.

    Parameters
    ----------
    vehicle : Vehicle
    angle_delay_s : float
        Delay of the loop of the angles besides those of PX4 (s).

    Returns
    -------
    AutopilotGains

    Raises
    ------
    MuflyError
        If the vehicle cannot hover, or no gains stabilise an axis.
    """
    trim = find_trim(vehicle, charge=0.5)
    model = linearise_vehicle(vehicle, trim)
    upper, lower = (float(u) for u in trim.motor_input)
    hover = 0.5 * (upper + lower)
    axes = {
        name: replace(_make_axis_plant(vehicle, model, name, hover), angle_delay_s=angle_delay_s)
        for name in _AXIS_STATES
    }
    gains = {name: _design_angle_gains(axes[name]) for name in ("roll", "pitch", "yaw")}
    shared = _design_position_gains([axes["roll"], axes["pitch"]], [gains["roll"], gains["pitch"]])
    vertical = _design_position_gains([axes["vertical"]], [CascadeGains()])
    for name in ("roll", "pitch"):
        gains[name] = _with_position_gains(gains[name], shared)
    gains["vertical"] = vertical
    return AutopilotGains(
        vehicle.name, hover, trim.battery_voltage_V, 0.5 * (upper - lower), gains["roll"], gains["pitch"], gains["yaw"],
        vertical, tuple(predict_margins(axes[name], gains[name]) for name in AXIS_NAMES),
    )  # fmt: skip


def _with_position_gains(inner: CascadeGains, outer: CascadeGains) -> CascadeGains:
    names = ("position", "velocity", "velocity_integral", "velocity_derivative")
    return replace(inner, **{name: getattr(outer, name) for name in names})


def _make_axis_plant(vehicle: Vehicle, model: Linearisation, name: str, hover: float) -> _AxisPlant:
    full, states = model.full, list(model.full.state_labels)
    inputs = list(full.input_labels)
    rows = [states.index(s) for s in _AXIS_STATES[name]]
    part = full.A[np.ix_(rows, rows)]
    column = {s: full.B[rows, inputs.index(s)] for s in inputs}
    speed = {"roll": "v", "pitch": "u"}.get(name, "w")
    sign = -1.0 if name in ("pitch", "vertical") else 1.0
    B = {
        "roll": column["servo_2"],
        "pitch": -column["servo_1"],
        "yaw": column["motor_upper"] - column["motor_lower"],
        "vertical": column["motor_upper"] + column["motor_lower"],
    }[name]
    n = len(rows) + 1  # the last state is the integral of the velocity, or of the rate
    local = _AXIS_STATES[name]
    A = np.zeros((n, n))
    A[:-1, :-1] = part
    C = np.zeros((4, n))
    place, moving, turned, turning = range(4)
    wind = np.zeros(n)
    if name == "yaw":
        A[-1, local.index("r")] = 1.0
        C[turned, -1] = C[turning, local.index("r")] = 1.0
    else:
        A[-1, local.index(speed)] = sign
        C[place, -1], C[moving, local.index(speed)] = 1.0, sign
        if name == "vertical":
            wind[local.index("w")] = -1.0  # an upward acceleration: in hover the wind has no vertical force
        else:
            wind[:-1] = -sign * full.A[rows, states.index(speed)]
            C[turned, local.index("phi" if name == "roll" else "theta")] = 1.0
            C[turning, local.index("p" if name == "roll" else "q")] = 1.0
    imu = None if vehicle.sensors is None else vehicle.sensors.imu
    filters = [2.0 * math.pi * GYRO_CUTOFF_HZ]
    if imu is not None:
        filters.append(2.0 * math.pi * float(imu.bandwidth))
    return _AxisPlant(
        name, A, np.append(B, 0.0), C, wind, hover / GRAVITY if name == "vertical" else 1.0 / GRAVITY,
        _INPUT_DELAY_PERIODS / CONTROL_RATE_HZ, tuple(filters),
    )  # fmt: skip


# Frequency responses


def _plant_response(axis: _AxisPlant, w: _Array, column: _Array) -> _Complex:
    """Return the response (n, 4) of position, velocity, angle and rate to an input column."""
    s = 1j * w[:, None, None]
    size = len(axis.A)
    x = np.linalg.solve(s * np.eye(size) - axis.A, np.broadcast_to(column[:, None], (len(w), size, 1)))
    return np.asarray((axis.C @ x)[..., 0])


def _controller_response(axis: _AxisPlant, k: CascadeGains, w: _Array) -> tuple[_Complex, _Complex]:
    """Return frequency responses K (n, 4) and F (n,) of the controller: actuator input = F reference - K outputs."""
    s = 1j * w
    delay = np.exp(-s * axis.delay_s)
    gyro = np.ones_like(s)
    for cutoff in axis.rate_filters:
        gyro /= 1.0 + math.sqrt(2.0) * s / cutoff + (s / cutoff) ** 2
    rate = k.rate_proportional + k.rate_integral / s
    rate_rate = k.rate_derivative * s / (1.0 + s / (2.0 * math.pi * GYRO_DERIVATIVE_CUTOFF_HZ))
    speed = k.velocity + k.velocity_integral / s
    speed_rate = k.velocity_derivative * s / (1.0 + s / (2.0 * math.pi * VELOCITY_DERIVATIVE_CUTOFF_HZ))
    inner = axis.thrust_per_acceleration * (1.0 if axis.name == "vertical" else k.angle * rate)
    late = np.exp(-s * POSITION_ESTIMATE_LAG_S)
    reference = k.angle * rate if axis.name == "yaw" else inner * speed * k.position
    from_position, from_velocity = inner * speed * k.position * late, inner * (speed + speed_rate) * late
    from_angle, from_rate = k.angle * rate * np.exp(-s * axis.angle_delay_s), (rate + rate_rate) * gyro
    out = np.stack((from_position, from_velocity, from_angle, from_rate), axis=1)
    return out * delay[:, None], reference * delay


# State-space form, for stability and step responses


def _closed_loop(axis: _AxisPlant, k: CascadeGains) -> tuple[_Array, _Array, _Array]:
    """Return the closed loop's state matrix A (n, n), and its input columns (n,) for the reference and the disturbance.

    Its states begin with those of the plant. The delay and the gyroscope's filters are one low pass of second order
    with the same delay at low frequency.
    """
    n = len(axis.A)
    lag = axis.delay_s + sum(math.sqrt(2.0) / cutoff for cutoff in axis.rate_filters)
    # states: plant, velocity integral, low-passed velocity, rate integral, low-passed rate, two of the delay
    vi, vl, ri, rl, d1, d2 = range(n, n + 6)
    A = np.zeros((n + 6, n + 6))
    A[:n, :n] = axis.A
    A[:n, d2] = axis.B
    place, moving, turned, turning = (np.append(row, np.zeros(6)) for row in axis.C)
    unit = np.eye(n + 6)
    cut_v, cut_r = 2.0 * math.pi * VELOCITY_DERIVATIVE_CUTOFF_HZ, 2.0 * math.pi * GYRO_DERIVATIVE_CUTOFF_HZ
    A[vl], A[rl] = cut_v * (moving - unit[vl]), cut_r * (turning - unit[rl])
    speed_error = -k.position * place - moving
    acceleration = (
        k.velocity * speed_error + k.velocity_integral * unit[vi] - k.velocity_derivative * cut_v * (moving - unit[vl])
    )
    A[vi] = speed_error
    if axis.name == "vertical":
        command, reference_gain = axis.thrust_per_acceleration * acceleration, axis.thrust_per_acceleration
        rate_reference = 0.0
    else:
        rate_error = k.angle * (axis.thrust_per_acceleration * acceleration - turned) - turning
        A[ri] = rate_error
        command = (
            k.rate_proportional * rate_error
            + k.rate_integral * unit[ri]
            - k.rate_derivative * cut_r * (turning - unit[rl])
        )
        rate_reference = k.angle * (
            1.0 if axis.name == "yaw" else axis.thrust_per_acceleration * k.velocity * k.position
        )
        reference_gain = k.rate_proportional
    A[d1] = (command - unit[d1]) * 2.0 / lag
    A[d2] = (unit[d1] - unit[d2]) * 2.0 / lag
    reference = np.zeros(n + 6)
    reference[vi] = k.position
    if axis.name == "vertical":
        reference[d1] = reference_gain * k.velocity * k.position * 2.0 / lag
    else:
        reference[ri] = rate_reference
        reference[d1] = reference_gain * rate_reference * 2.0 / lag
    wind = np.append(axis.wind, np.zeros(6))
    if axis.name == "yaw":  # no position: these states are none of the loop
        keep = [i for i in range(n + 6) if i not in (vi, vl)]
        return A[np.ix_(keep, keep)], reference[keep], wind[keep]
    if axis.name == "vertical":
        keep = [i for i in range(n + 6) if i not in (ri, rl)]
        return A[np.ix_(keep, keep)], reference[keep], wind[keep]
    if k.position == k.velocity == k.velocity_integral == 0.0:  # the angle alone: no velocity, no position
        keep = [i for i in range(n + 6) if i not in (n - 1, vi, vl)]
        return A[np.ix_(keep, keep)], reference[keep], wind[keep]
    return A, reference, wind


def _find_instability_rate_1_s(axis: _AxisPlant, k: CascadeGains) -> float:
    """Return by how much the largest real part of the closed-loop poles exceeds its limit (1/s); 0 below the limit."""
    A, _, _ = _closed_loop(axis, k)
    return max(0.0, float(np.max(np.linalg.eigvals(A).real)) - _MAX_STABLE_REAL_PART)


# Design


def _search_gains(cost: Callable[[_Array], float], starts: Sequence[Sequence[float]]) -> _Array:
    """Return the gains of least cost, found by a Nelder-Mead search of their logarithms from each start."""
    best: tuple[float, _Array] | None = None
    options: Any = {"maxfev": _MAX_COST_EVALUATIONS, "xatol": 1e-3, "fatol": 1e-4}
    for start in starts:
        found = minimize(  # type: ignore[call-overload]
            lambda x: cost(_exponentiate_clipped(x)), np.log(start), method="Nelder-Mead",
            options=options,
        )  # fmt: skip
        if best is None or found.fun < best[0]:
            best = float(found.fun), _exponentiate_clipped(found.x)
    assert best is not None
    return best[1]


def _exponentiate_clipped(x: _Array) -> _Array:
    return np.exp(np.clip(x, -25.0, 5.0))


def _outer_sensitivity(plant: _Complex, feedback: _Complex) -> _Complex:
    """Return the sensitivity of the loop opened at the acceleration command, with the inner loops of angle and rate
    closed.
    """
    inner, outer = (np.sum(feedback[:, part] * plant[:, part], axis=1) for part in (slice(2, 4), slice(0, 2)))
    return np.asarray((1.0 + inner) / (1.0 + inner + outer))


def _loop_cost(
    axis: _AxisPlant, k: CascadeGains, plant: _Complex, disturbance: _Complex, output: int, peak: float
) -> float:
    """Return the logarithm of the integrated squared error of an output after a step disturbance, plus penalties for
    exceeded limits of sensitivity, response and damping.
    """
    excess = _find_instability_rate_1_s(axis, k)
    feedback, reference = _controller_response(axis, k, _FREQUENCY_GRID)
    loop = np.sum(feedback * plant, axis=1)
    sensitivity = 1.0 / (1.0 + loop)
    error = disturbance[:, output] - plant[:, output] * sensitivity * np.sum(feedback * disturbance, axis=1)
    ise = float(np.trapezoid(np.abs(error / _FREQUENCY_GRID) ** 2, _FREQUENCY_GRID)) / math.pi
    answer = float(np.max(np.abs(plant[:, output] * reference * sensitivity)))
    over = max(0.0, float(np.max(np.abs(sensitivity))) / MAX_SENSITIVITY - 1.0) + max(0.0, answer / peak - 1.0)
    if output == 0:
        over += max(0.0, float(np.max(np.abs(_outer_sensitivity(plant, feedback)))) / MAX_SENSITIVITY - 1.0)
    elif axis.name != "yaw":
        over += max(0.0, k.angle * k.rate_proportional * math.radians(HALF_SERVO_ANGLE_ERROR_DEG) / 0.5 - 1.0)
    return math.log(ise) + _CONSTRAINT_PENALTY * over + _CONSTRAINT_PENALTY * (10.0 + excess) * (excess > 0.0)


_MAX_ANGLE_GAINS = {"roll": (12.0, 0.5, 4.0, 0.01), "pitch": (12.0, 0.6, 4.0, 0.01), "yaw": (5.0, 0.6, 4.0, 0.0)}
_MAX_XY_GAINS, _MAX_Z_GAINS = (2.0, 5.0, 60.0, 2.0), (1.5, 15.0, 3.0, 2.0)
_MIN_XY_GAINS, _MIN_Z_GAINS = (0.0, 1.2, 0.0, 0.1), (0.1, 2.0, 0.2, 0.0)
_MAX_ANGLE_RESPONSE_PEAK = 1.3


def _without_velocity(axis: _AxisPlant) -> _AxisPlant:
    """Return the axis without its velocity state, for the inner loops; the position loop stabilises the velocity."""
    if axis.name == "yaw":
        return axis
    return replace(
        axis, A=axis.A[1:, 1:], B=axis.B[1:], C=np.vstack([0.0 * axis.C[:2, 1:], axis.C[2:, 1:]]), wind=axis.wind[1:]
    )  # fmt: skip


def _drop_small_gain(gain: float) -> float:
    return float(gain) if gain > 1e-5 else 0.0


def _design_angle_gains(axis: _AxisPlant) -> CascadeGains:
    axis = _without_velocity(axis)
    limits = _MAX_ANGLE_GAINS[axis.name]
    plant = _plant_response(axis, _FREQUENCY_GRID, axis.B)

    def gains_from_search_point(x: _Array) -> CascadeGains:
        angle, rate, integral, slope = np.minimum(x, limits)
        return CascadeGains(
            angle=float(angle),
            rate_proportional=float(rate),
            rate_integral=float(integral),
            rate_derivative=_drop_small_gain(slope),
        )

    def search_cost(x: _Array) -> float:
        return _loop_cost(axis, gains_from_search_point(x), plant, plant, 2, _MAX_ANGLE_RESPONSE_PEAK)

    scale = 0.02 if axis.name == "yaw" else 0.2
    slope = 1e-9 if axis.name == "yaw" else 3e-3
    k = gains_from_search_point(
        _search_gains(search_cost, [(a, scale * r, scale, slope) for a, r in ((4.0, 1.0), (8.0, 1.5))])
    )
    if _find_instability_rate_1_s(axis, k) > 0.0:
        raise MuflyError(f"no gains of PX4 stabilise {axis.name}; check the vehicle with `mufly vehicle check`")
    return k


def _design_position_gains(axes: Sequence[_AxisPlant], inner: Sequence[CascadeGains]) -> CascadeGains:
    vertical = axes[0].name == "vertical"
    most, least = (_MAX_Z_GAINS, _MIN_Z_GAINS) if vertical else (_MAX_XY_GAINS, _MIN_XY_GAINS)
    plants = [_plant_response(axis, _FREQUENCY_GRID, axis.B) for axis in axes]
    winds = [_plant_response(axis, _FREQUENCY_GRID, axis.wind) for axis in axes]

    def gains_from_search_point(x: _Array, k: CascadeGains) -> CascadeGains:
        place, speed, integral, slope = np.clip(x, least, most)
        return replace(
            k, position=float(place), velocity=float(speed), velocity_integral=float(integral),
            velocity_derivative=float(slope),
        )  # fmt: skip

    def search_cost(x: _Array) -> float:
        parts = zip(axes, inner, plants, winds, strict=True)
        return sum(_loop_cost(a, gains_from_search_point(x, k), p, d, 0, MAX_REFERENCE_PEAK) for a, k, p, d in parts)

    starts = [(0.5, 2.5, 1.0, 0.2), (1.0, 4.0, 1.0, 0.3)] if vertical else [(0.5, 1.4, 0.3, 0.2), (0.9, 2.0, 0.6, 0.3)]
    x = _search_gains(search_cost, starts)
    for axis, k in zip(axes, inner, strict=True):
        if _find_instability_rate_1_s(axis, gains_from_search_point(x, k)) > 0.0:
            raise MuflyError(f"no gains of PX4 hold a position ({axis.name}); check it with `mufly vehicle check`")
    return gains_from_search_point(x, CascadeGains())


# Prediction


def predict_margins(axis: _AxisPlant, k: CascadeGains) -> AxisMargins:
    """Return the margins and responses of an axis with its gains."""
    w = np.geomspace(1e-2, 600.0, 4000)
    plant = _plant_response(axis, w, axis.B)
    feedback, reference = _controller_response(axis, k, w)
    loop = np.sum(feedback * plant, axis=1)
    sensitivity = 1.0 / (1.0 + loop)
    size, output = np.abs(loop), 2 if axis.name == "yaw" else 0
    crossings = np.flatnonzero(np.diff(np.sign(size - 1.0)))
    phase = [abs(math.degrees(np.angle(-loop[i]))) for i in crossings]
    real = np.flatnonzero(np.diff(np.sign(loop.imag)) * (loop.real[:-1] < 0.0))
    gains_dB = [abs(20.0 * math.log10(size[i])) for i in real]
    push = math.nan if axis.name in ("yaw", "vertical") else 0.5 * _wind_step_displacement(axis, k)
    return AxisMargins(
        axis=axis.name,
        crossover_rad_s=float(w[crossings[-1]]) if crossings.size else math.nan,
        sensitivity=float(np.max(np.abs(sensitivity))),
        outer_sensitivity=math.nan
        if axis.name == "yaw"
        else float(np.max(np.abs(_outer_sensitivity(plant, feedback)))),
        gain_margin_dB=min(gains_dB, default=math.inf),
        phase_margin_deg=min(phase, default=math.inf),
        reference_peak=float(np.max(np.abs(plant[:, output] * reference * sensitivity))),
        wind_step_displacement_m=push,
    )


def _wind_step_displacement(axis: _AxisPlant, k: CascadeGains) -> float:
    """Return the largest displacement (m) after a step of the wind of 1 m/s."""
    A, _, wind = _closed_loop(axis, k)
    n, step_s = len(A), 0.01
    both = np.zeros((n + 1, n + 1))
    both[:n, :n], both[:n, n] = A, wind
    advance = expm(both * step_s)
    x, worst = np.append(np.zeros(n), 1.0), 0.0
    for _ in range(round(_STEP_RESPONSE_S / step_s)):
        x = advance @ x
        worst = max(worst, abs(float(axis.C[0] @ x[: len(axis.A)])))
    return worst
