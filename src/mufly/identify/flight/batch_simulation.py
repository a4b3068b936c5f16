"""Output-error simulation of many parameter sets with the recorded inputs of one record, on all cores.

The equations are those of :func:`mufly.dynamics.state_derivative`; this file only samples and integrates them. Inputs
are constant between samples of the record and reach the vehicle ``delay`` later. Every integration step ends
where an input changes, so constant inputs are exact at any delay. Classical Runge-Kutta steps of up to 10 ms resolve
all modes of a vehicle of this size except one: the swash plate follows within ``T = 1 ms``. Its tilt obeys
``T da/dt = a_in - a`` with constant ``a_in`` and depends on nothing else, so its exact solution is used::

    a(t) = a_in + (a_0 - a_in) e^(-t/T)

Inside a step of length ``h`` the Runge-Kutta stages use, instead of the exponential, the straight line with the same
integral and the same first moment over the step (own derivation, ``z = h/T``)::

    e^(-t/T) ~ A + B t/h,   B = 6 m_0 - 12 m_1,  A = m_0 - B/2,  m_0 = (1 - e^-z)/z,  m_1 = 1/z - (1 - e^-z)/z^2

so that the rate and angle caused by the tilt are correct at the end of the step for any ``h/T``. The error
against steps of 0.1 ms is measured in ``tests/identify/test_simulate.py`` and stated in
docs/explanation/identification.md.

The simulation can be restarted at chosen samples (multiple shooting), where the body motion is set to given values.
Rotors and battery follow from the inputs and continue through all windows. The stabiliser bar follows the measured
mast, so the start of one window does not affect the next. An unmeasured horizontal velocity is propagated in the same
way (``path``): it integrates the model's acceleration at the measured attitude and rates, with rotors, swash plate and
bar as above. In-plane rotor drag depends on this velocity and causes pitch and roll moments, so windows may not begin
at zero velocity in mid-flight.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from concurrent.futures import Executor
from contextlib import contextmanager
from contextvars import ContextVar
from functools import partial

import numpy as np
from numba import prange
from numpy.typing import NDArray

from mufly.compiled.numba_cache import cached_njit
from mufly.dynamics.edgewise_loads import tip_path_tilt_target
from mufly.dynamics.equations_of_motion import compute_battery_supply, state_derivative
from mufly.dynamics.model_state import (
    BAR_NORMAL_SLICE,
    MODEL_ATTITUDE,
    MODEL_BAR_NORMAL,
    MODEL_POSITION,
    MODEL_RATES,
    MODEL_SPEED_LOWER,
    MODEL_SPEED_UPPER,
    MODEL_SWASH_PITCH,
    MODEL_SWASH_ROLL,
    MODEL_VELOCITY,
    STATE_SIZE,
    U_MOTOR_LOWER,
    U_MOTOR_UPPER,
    U_SERVO_1,
    U_SERVO_2,
    ModelParameters,
    compute_hover_rotor_speeds,
)
from mufly.dynamics.simulation import normalise_state
from mufly.identify.flight_record import (
    MOTION_EULER,
    MOTION_RATES,
    MOTION_VELOCITY,
    OUTPUT_CLIMB,
    OUTPUT_EAST,
    OUTPUT_HEIGHT,
    OUTPUT_P,
    OUTPUT_PITCH,
    OUTPUT_R,
    OUTPUT_ROLL,
    OUTPUT_SPEED_LOWER,
    OUTPUT_SPEED_UPPER,
    OUTPUT_V_EAST,
    OUTPUT_V_NORTH,
    OUTPUT_YAW,
)
from mufly.study.sweeps import open_executor

_CLUSTER_EXECUTOR: ContextVar[Executor | None] = ContextVar("cluster", default=None)
_PARAMETER_SETS_PER_TASK = 8  # parameter sets that a worker simulates per task

_Array = NDArray[np.float64]

MAX_INTEGRATION_STEP_S = 0.01
_DIVERGED_OUTPUT = 1e6  # output of a diverged simulation


@cached_njit(error_model="numpy")
def _lag_line_coefficients(z: float) -> tuple[float, float]:
    """Return ``A`` and ``B`` of the line that replaces the exponential of a lag (module docstring), for ``z = h/T``."""
    if z < 0.05:
        m0 = 1.0 - z / 2.0 + z * z / 6.0 - z**3 / 24.0 + z**4 / 120.0
        slope = -z + z * z / 2.0 - 0.15 * z**3 + z**4 / 30.0
    else:
        rest = -math.expm1(-z)
        m0 = rest / z
        slope = 6.0 * m0 - 12.0 * (1.0 / z - rest / (z * z))
    return m0 - 0.5 * slope, slope


@cached_njit(error_model="numpy")
def _integrate_state(
    x: _Array, u: _Array, p: ModelParameters, length: float, longest: float, calm: _Array, work: _Array
) -> None:
    """Integrate the state ``x`` in place over ``length`` (s) with constant input ``u`` and wind ``calm``.

    The steps are equal and at most ``longest`` (s); ``work`` is work space.
    """
    k1, k2, k3, k4, y = work[0], work[1], work[2], work[3], work[4]
    steps = max(1, math.ceil(length / longest - 1e-9))
    h = length / steps
    decay = math.exp(-h * p.swash_rate)
    line, slope = _lag_line_coefficients(h * p.swash_rate)
    roll_in, pitch_in = tip_path_tilt_target(
        min(max(u[U_SERVO_1], -1.0), 1.0), min(max(u[U_SERVO_2], -1.0), 1.0), p.swash_gain, p.swash_phase
    )
    for _ in range(steps):
        roll_off, pitch_off = x[MODEL_SWASH_ROLL] - roll_in, x[MODEL_SWASH_PITCH] - pitch_in
        x[MODEL_SWASH_ROLL], x[MODEL_SWASH_PITCH] = roll_in + line * roll_off, pitch_in + line * pitch_off
        state_derivative(x, u, calm, p, k1)
        for i in range(STATE_SIZE):
            y[i] = x[i] + 0.5 * h * k1[i]
        y[MODEL_SWASH_ROLL] = roll_in + (line + 0.5 * slope) * roll_off
        y[MODEL_SWASH_PITCH] = pitch_in + (line + 0.5 * slope) * pitch_off
        state_derivative(y, u, calm, p, k2)
        for i in range(STATE_SIZE):
            y[i] = x[i] + 0.5 * h * k2[i]
        y[MODEL_SWASH_ROLL] = roll_in + (line + 0.5 * slope) * roll_off
        y[MODEL_SWASH_PITCH] = pitch_in + (line + 0.5 * slope) * pitch_off
        state_derivative(y, u, calm, p, k3)
        for i in range(STATE_SIZE):
            y[i] = x[i] + h * k3[i]
        y[MODEL_SWASH_ROLL] = roll_in + (line + slope) * roll_off
        y[MODEL_SWASH_PITCH] = pitch_in + (line + slope) * pitch_off
        state_derivative(y, u, calm, p, k4)
        for i in range(STATE_SIZE):
            x[i] += h / 6.0 * (k1[i] + 2.0 * k2[i] + 2.0 * k3[i] + k4[i])
        x[MODEL_SWASH_ROLL], x[MODEL_SWASH_PITCH] = roll_in + decay * roll_off, pitch_in + decay * pitch_off
        normalise_state(x)


@cached_njit(error_model="numpy")
def _set_attitude(x: _Array, roll: float, pitch: float, yaw: float) -> None:
    cr, sr = math.cos(0.5 * roll), math.sin(0.5 * roll)
    cp, sp = math.cos(0.5 * pitch), math.sin(0.5 * pitch)
    cy, sy = math.cos(0.5 * yaw), math.sin(0.5 * yaw)
    x[MODEL_ATTITUDE] = cr * cp * cy + sr * sp * sy
    x[MODEL_ATTITUDE + 1] = sr * cp * cy - cr * sp * sy
    x[MODEL_ATTITUDE + 2] = cr * sp * cy + sr * cp * sy
    x[MODEL_ATTITUDE + 3] = cr * cp * sy - sr * sp * cy


@cached_njit(error_model="numpy")
def _write_outputs(
    x: _Array, u: _Array, p: ModelParameters, codes: NDArray[np.int64], last_yaw: float, y: _Array
) -> float:
    """Write the outputs with these codes (positions in ``OUTPUTS``) into ``y``; return the continuous yaw."""
    w, i, j, k = x[MODEL_ATTITUDE], x[MODEL_ATTITUDE + 1], x[MODEL_ATTITUDE + 2], x[MODEL_ATTITUDE + 3]
    yaw = math.atan2(2 * (w * k + i * j), 1 - 2 * (j * j + k * k))
    yaw += 2 * math.pi * round((last_yaw - yaw) / (2 * math.pi))
    for c in range(codes.shape[0]):
        code = codes[c]
        if code <= OUTPUT_EAST:
            y[c] = x[MODEL_POSITION + code]
        elif code == OUTPUT_HEIGHT:
            y[c] = -x[MODEL_POSITION + 2]
        elif code <= OUTPUT_V_EAST:
            y[c] = x[MODEL_VELOCITY + code - OUTPUT_V_NORTH]
        elif code == OUTPUT_CLIMB:
            y[c] = -x[MODEL_VELOCITY + 2]
        elif code == OUTPUT_ROLL:
            y[c] = math.atan2(2 * (w * i + j * k), 1 - 2 * (i * i + j * j))
        elif code == OUTPUT_PITCH:
            y[c] = math.asin(min(max(2 * (w * j - k * i), -1.0), 1.0))
        elif code == OUTPUT_YAW:
            y[c] = yaw
        elif code <= OUTPUT_R:
            y[c] = x[MODEL_RATES + code - OUTPUT_P]
        elif code <= OUTPUT_SPEED_LOWER:
            y[c] = x[MODEL_SPEED_UPPER + code - OUTPUT_SPEED_UPPER]
        else:
            upper, lower = min(max(u[U_MOTOR_UPPER], 0.0), 1.0), min(max(u[U_MOTOR_LOWER], 0.0), 1.0)
            y[c] = compute_battery_supply(x, upper, lower, p)[0]
    return yaw


@cached_njit(error_model="numpy")
def _simulate_parameter_set(
    x: _Array,
    p: ModelParameters,
    u: _Array,
    motor_hold: _Array,
    delay: float,
    dt: float,
    longest: float,
    starts: NDArray[np.int64],
    motion: _Array,
    mast: _Array,
    path: _Array,
    codes: NDArray[np.int64],
    y: _Array,
) -> None:
    n = u.shape[0]
    work = np.empty((5, STATE_SIZE))
    calm = np.zeros(3)
    now, before = np.empty(4), np.empty(4)
    # Rounding must not create an interval of zero length, but keeps 1 ns: finite differences vary the delay by it.
    whole = math.floor(delay / dt + 1e-11)
    part = max(delay - whole * dt, 0.0)
    part = 0.0 if part < 1e-13 else part
    last_yaw, window = 0.0, 0
    bar = x[BAR_NORMAL_SLICE].copy()
    there, slope = np.empty(STATE_SIZE), np.empty(STATE_SIZE)
    v_n = v_e = 0.0
    follow = -math.expm1(-dt * p.bar_rate)
    for k in range(n):
        if k > 0:
            for i in range(3):
                bar[i] += follow * (0.5 * (mast[k - 1, i] + mast[k, i]) - bar[i])
        if window < starts.shape[0] and starts[window] == k:
            s = motion[window]
            for i in range(MOTION_EULER):
                x[i] = s[i]
            _set_attitude(x, s[MOTION_EULER], s[MOTION_EULER + 1], s[MOTION_EULER + 2])
            x[MODEL_RATES], x[MODEL_RATES + 1], x[MODEL_RATES + 2] = (
                s[MOTION_RATES],
                s[MOTION_RATES + 1],
                s[MOTION_RATES + 2],
            )
            last_yaw = s[MOTION_EULER + 2]
            if k == 0:
                v_n, v_e = x[MODEL_VELOCITY], x[MODEL_VELOCITY + 1]
            elif path.shape[0] > 0:
                x[MODEL_VELOCITY], x[MODEL_VELOCITY + 1] = v_n, v_e
            if k > 0:
                length = 1.0 / math.sqrt(bar[0] ** 2 + bar[1] ** 2 + bar[2] ** 2)
                for i in range(3):
                    x[MODEL_BAR_NORMAL + i] = length * bar[i]
            window += 1
        for i in range(4):
            now[i], before[i] = u[max(k - whole, 0), i], u[max(k - whole - 1, 0), i]
        if motor_hold[0] >= 0.0:
            now[0] = before[0] = motor_hold[0]
            now[1] = before[1] = motor_hold[1]
        last_yaw = _write_outputs(x, before if part > 0.0 else now, p, codes, last_yaw, y[k])
        if k + 1 == n:
            return
        if path.shape[0] > 0:
            for i in range(STATE_SIZE):
                there[i] = x[i]
            there[MODEL_VELOCITY], there[MODEL_VELOCITY + 1], there[MODEL_VELOCITY + 2] = (
                v_n,
                v_e,
                path[k, MOTION_VELOCITY + 2],
            )
            _set_attitude(there, path[k, MOTION_EULER], path[k, MOTION_EULER + 1], path[k, MOTION_EULER + 2])
            for i in range(3):
                there[MODEL_RATES + i], there[MODEL_BAR_NORMAL + i] = path[k, MOTION_RATES + i], bar[i]
            state_derivative(there, now, calm, p, slope)
            v_n += dt * slope[MODEL_VELOCITY]
            v_e += dt * slope[MODEL_VELOCITY + 1]
        if part > 0.0:
            _integrate_state(x, before, p, part, longest, calm, work)
        _integrate_state(x, now, p, dt - part, longest, calm, work)
        # Comparisons with NaN are false, so this test also detects NaN.
        turning = abs(x[MODEL_RATES]) + abs(x[MODEL_RATES + 1]) + abs(x[MODEL_RATES + 2])
        if not (
            turning < 1e3 and abs(x[MODEL_VELOCITY + 2]) < 1e4 and x[MODEL_SPEED_UPPER] + x[MODEL_SPEED_LOWER] < 1e5
        ):
            y[k + 1 :, :] = _DIVERGED_OUTPUT
            return


@cached_njit(parallel=True, error_model="numpy")
def _simulate_parameter_sets(
    x: _Array,
    p: NDArray[np.void],
    u: _Array,
    motor_hold: _Array,
    delay: _Array,
    dt: float,
    longest: float,
    starts: NDArray[np.int64],
    motion: _Array,
    mast: _Array,
    path: _Array,
    codes: NDArray[np.int64],
    y: _Array,
) -> None:
    for b in prange(x.shape[0]):
        _simulate_parameter_set(
            x[b], p[b], u, motor_hold[b], delay[b], dt, longest, starts, motion[b], mast, path, codes, y[b]
        )


@contextmanager
def run_on_cluster(address: str | None) -> Iterator[None]:
    """Simulate batches on the workers of a dask cluster inside this context; without an address, on the local cores.

    The results equal those of a local batch. A cluster pays off for CMA-ES populations and long records.

    Raises
    ------
    MuflyError
        If the cluster cannot be reached or dask.distributed is not installed.
    """
    if address is None:
        yield
        return
    with open_executor(address) as pool:
        token = _CLUSTER_EXECUTOR.set(pool)
        try:
            yield
        finally:
            _CLUSTER_EXECUTOR.reset(token)


def simulate_batch(
    state: _Array, p: NDArray[np.void], inputs: _Array, *, sample_s: float, codes: NDArray[np.int64],
    starts: NDArray[np.int64], motion: _Array, mast: _Array, delay_s: _Array | None = None,
    motor_hold: _Array | None = None, path: _Array | None = None, longest_step_s: float = MAX_INTEGRATION_STEP_S,
) -> _Array:  # fmt: skip
    """Simulate ``b`` parameter sets with the inputs of one record.

    Parameters
    ----------
    state : (b, 21) array
        States at the first sample, see :mod:`mufly.dynamics.model_state`; overwritten.
    p : (b,) structured array of type ``PARAMETER_DTYPE``
    inputs : (n, 4) array
        Inputs of upper motor, lower motor, servo 1 and servo 2 at every sample (1).
    sample_s : float
        Time between samples (s).
    codes : (m,) integer array
        Outputs, as positions in :data:`mufly.identify.flight_record.FLIGHT_OUTPUTS`.
    starts : (w,) integer array
        First sample of every window, increasing.
    motion : (b, w, 12) array
        Position (m) and velocity (m/s) N, E, D, roll, pitch, yaw (rad), p, q, r (rad/s) at these samples.
    mast : (n, 3) array
        Measured unit vector of the mast (upwards) in N-E-D; the bar follows it from one window to the next.
    delay_s : (b,) array, optional
        Delay from input to vehicle (s); zero by default.
    motor_hold : (b, 2) array, optional
        Motor inputs that replace the recorded ones until the delayed record begins; negative values replace nothing.
    path : (n, 12) array, optional
        Measured motion, as in ``motion``, at every sample. The unmeasured horizontal velocity is then propagated
        through all windows, and ``motion`` sets it for the first window only.
    longest_step_s : float
        Longest integration step (s).

    Returns
    -------
    (b, n, m) array
        Predicted outputs (SI); 1e6 from the sample at which a simulation diverges.
    """
    pool = _CLUSTER_EXECUTOR.get()
    if pool is not None and len(state) > 1:
        one = partial(
            simulate_batch, inputs=inputs, sample_s=sample_s, codes=codes, starts=starts, mast=mast, path=path,
            longest_step_s=longest_step_s,
        )  # fmt: skip
        jobs = [
            pool.submit(
                one, state[k], p[k], motion=motion[k],
                delay_s=None if delay_s is None else delay_s[k],
                motor_hold=None if motor_hold is None else motor_hold[k],
            )
            for k in (slice(first, first + _PARAMETER_SETS_PER_TASK) for first in range(0, len(state),
            _PARAMETER_SETS_PER_TASK))
        ]  # fmt: skip
        return np.concatenate([job.result() for job in jobs])
    b = len(state)
    out = np.empty((b, len(inputs), len(codes)))
    delay = np.zeros(b) if delay_s is None else np.ascontiguousarray(delay_s, dtype=np.float64)
    hold = np.full((b, 2), -1.0) if motor_hold is None else motor_hold
    way = np.empty((0, 12)) if path is None else path
    _simulate_parameter_sets(
        state, p, inputs, hold, delay, sample_s, longest_step_s, starts, motion, mast, way, codes, out
    )
    return out


def steady_rotor_speeds(p: NDArray[np.void], duty: _Array, volts: float) -> _Array:
    """Return the steady rotor speeds (b, 2), in rad/s, under constant motor inputs (2,): steady state of eq. 4.29."""
    gear, out = p["gear_ratio"], np.empty((len(p), 2))
    for k, side in enumerate(("up", "dw")):
        square = p[f"torque_{side}"] / (gear**2 * p["gear_efficiency"])
        linear = p["kM"] * p["kE"] / p["R_ohm"] + p["dR"]
        drive = np.maximum(p["kM"] * duty[k] * volts / (p["R_ohm"] * gear) - p["Mf"] / gear, 0.0)
        out[:, k] = 2 * drive / (linear + np.sqrt(linear**2 + 4 * square * drive))
    return out


def solve_hover(p: NDArray[np.void]) -> tuple[_Array, _Array]:
    """Return the hover rotor speeds (b, 2), in rad/s, by eq. 5.1, and the motor inputs (b, 2) for them."""
    speed = compute_hover_rotor_speeds(p)
    gear = p["gear_ratio"][:, None]
    torque = np.column_stack([p["torque_up"], p["torque_dw"]]) * speed**2
    current = p["dR"][:, None] * speed + p["Mf"][:, None] / gear
    current += torque / (gear**2 * p["gear_efficiency"][:, None])
    current *= gear / p["kM"][:, None]
    volts = current * p["R_ohm"][:, None] + p["kE"][:, None] * gear * speed
    return speed, volts / p["battery_curve"][:, -1:]


def stabiliser_bar_normal(attitude: _Array, tilt: _Array) -> _Array:
    """Return the upward normals (b, 3) in N-E-D of bars tilted by roll and pitch ``tilt`` (rad) against the mast."""
    roll, pitch, yaw = attitude[:, 0] + tilt[:, 0], attitude[:, 1] + tilt[:, 1], attitude[:, 2]
    cr, sr, cp, sp = np.cos(roll), np.sin(roll), np.cos(pitch), np.sin(pitch)
    cy, sy = np.cos(yaw), np.sin(yaw)
    return -np.column_stack([cy * sp * cr + sy * sr, sy * sp * cr - cy * sr, cp * cr])
