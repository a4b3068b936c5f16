"""Inertial measurement unit: three accelerometers and three gyroscopes on a vibrating board.

An accelerometer measures specific force, all forces but gravity (body axes, at the position r of the element):

    f = R^T (dv/dt - g e_D) + dw/dt x r + w x (w x r)

The mean of f over a period of the flight software needs no force model: dv/dt is the change of velocity over the
period, which includes ground contact, gusts and collisions. Vibration of the board is added. Rotor k adds, along a
direction e_k,

    A_1 cos(th + p_1) + A_2 cos(2 th + p_2),      th its azimuth (imbalance; two blades),

and blades that pass each other add A_p cos(2 (th_up + th_dw) + p_p). Forces grow with the square of the speed and pass
the board's resonance, |H(w)| with H = 1 / (1 - (w / w_r)^2 + 2 j zeta w / w_r). The file gives A at the hover speed.

The element is mounted at angles to the body axes (roll, pitch, yaw; 0 unless the vehicle file gives them) and senses
R_m^T f and R_m^T w. It is sampled every ``sample_period`` (8 kHz). Its errors are scale and misalignment, bias, and
white noise of density N (standard deviation N sqrt(f_s / 2)). The bias is the sum of a turn-on bias, a first-order
Gauss- Markov drift (d b = -b dt / tau + sigma sqrt(2 dt / tau) n) and a share from the warming of the board. Gyroscopes
also sense acceleration. The sample *clips* first; then a second-order Butterworth filter removes aliasing frequencies,
and its output is read. Clipping turns an asymmetric vibration (2/rev in phase with 1/rev) into a false mean
acceleration: the false tilt of Sec. 2.1.2.

Sources: IEEE Std 952 and 1293 for the error terms; Groves, Principles of GNSS, Inertial and Multisensor Integrated
Navigation Systems, 2nd ed., ch. 4; own derivation for the vibration. Thesis: Fig. 2.6.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mufly.compiled.numba_cache import cached_njit
from mufly.compiled.numba_intrinsics import borrow_arrays
from mufly.dynamics import body_to_ned_matrix, find_trim
from mufly.dynamics.model_state import (
    ATTITUDE_SLICE,
    MODEL_RATES,
    MODEL_SPEED_LOWER,
    MODEL_SPEED_UPPER,
    MODEL_VELOCITY,
    ROTOR_SPEED_SLICE,
    STATE_SIZE,
)
from mufly.quantities.units import GRAVITY
from mufly.rotations import quaternion_from_euler
from mufly.sensors.readings import Reading, Sensor, Truth
from mufly.sensors.rng import draw_normals, make_random_source
from mufly.vehicle import Vehicle
from mufly.vehicle.sensor_schema import ImuParameters as ImuTable
from mufly.world import World

_Array = NDArray[np.float64]
_VIBRATION_ELEVATION_RAD = math.asin(math.sqrt(1 / 3))  # of the vibration above the horizon: all axes have equal shares
ROOM_TEMPERATURE_K = 293.15
_VIBRATION_LINE_COUNT = 5  # 1/rev and 2/rev of both rotors, and the blade passage
FIRST_GYRO_AXIS, _IMU_AXIS_COUNT = 3, 6  # index of the first gyroscope among the axes, and their number
# Indices of the parameters: amplitudes, resonance, damping, hover speeds, drift time, warming and its time constant,
# and the resonance's gain of each vibration line in hover
(
    _ONCE_PER_REV_INDEX, _TWICE_PER_REV_INDEX, _BLADE_PASSAGE_INDEX, _RESONANCE_INDEX, _DAMPING_INDEX,
    _UPPER_HOVER_SPEED_INDEX, _LOWER_HOVER_SPEED_INDEX, _DRIFT_TIME_INDEX, _FINAL_TEMPERATURE_RISE_INDEX,
    _WARMING_TIME_INDEX, _HOVER_RESONANCE_GAIN_INDEX,
) = range(11)  # fmt: skip
# Places among the arrays of the unit
_POSITION_ARRAY_INDEX, _TURN_ON_BIAS_ARRAY_INDEX, _BIAS_DRIFT_ARRAY_INDEX = 1, 7, 13
_LOW_PASS_MEMORY_ARRAY_INDEX, _SPECIFIC_FORCE_ARRAY_INDEX = 14, 15
_UPPER_LINE, _UPPER_TWICE_LINE, _LOWER_LINE, _LOWER_TWICE_LINE, _PASSAGE_LINE = range(_VIBRATION_LINE_COUNT)
# Rows of the work of a period: cosine and sine of the vibration lines, middles of the samples, inputs of the axes
_SAMPLE_MIDDLE_FRACTION_ROW, _FIRST_AXIS_ROW = 2 * _VIBRATION_LINE_COUNT, 2 * _VIBRATION_LINE_COUNT + 1
# Columns of an axis' inputs: coefficients of the vibration lines, input at the start, and its increase
_AXIS_INPUT_START_COLUMN, _AXIS_INPUT_INCREASE_COLUMN = 10, 11


class Imu(Sensor):
    """Sensor of ``acceleration`` (m/s^2), ``rates`` (rad/s), ``clipping`` (share of samples) and ``temperature`` (K).

    Parameters
    ----------
    table : mufly.vehicle.sensor_schema.ImuParameters
    vehicle : Vehicle
    world : World
    rng : numpy.random.Generator
        Source of the unit's errors, the directions and phases of the vibration, and noise.

    Notes
    -----
    The unit keeps its state in arrays (:meth:`sampling_arguments`), so that a compiled loop samples the unit by
    :func:`sample_imu`, as :meth:`read` does.
    """

    def __init__(self, table: ImuTable, vehicle: Vehicle, world: World, rng: np.random.Generator) -> None:
        imu = table
        self._rng, self._imu = rng, imu
        hover = find_trim(vehicle).state[ROTOR_SPEED_SLICE]  # the file gives the vibration at this speed
        shake = imu.vibration
        self._vibration_numbers = np.array(
            [
                float(q)
                for q in (
                    shake.once_per_rev,
                    shake.twice_per_rev,
                    shake.blade_passing,
                    shake.resonance_frequency,
                    shake.damping_ratio,
                )
            ]
            + [
                *hover,
                *(float(q) for q in (imu.drift_correlation_time, imu.temperature_rise, imu.temperature_time_constant)),
            ]
            + [
                resonance_gain(speed, float(shake.resonance_frequency), float(shake.damping_ratio))
                for speed in _compute_vibration_frequencies(*hover)
            ]
        )
        self._place = imu.position.to_array()[0].copy()
        self._dt = float(imu.sample_period)
        density = np.repeat([float(imu.accelerometer_noise_density), float(imu.gyro_noise_density)], 3)
        self._white_noise = density * math.sqrt(0.5 / self._dt)
        self._limit = np.repeat([float(imu.accelerometer_range), float(imu.gyro_range)], 3)
        self._range = self._limit.copy()
        self._filter = butterworth_coefficients(float(imu.bandwidth), self._dt)
        # Constant errors of this unit
        self._axes = np.stack(
            [_draw_axis_error_matrix(rng, float(imu.scale_error), float(imu.misalignment)) for _ in range(2)]
        )
        on = np.repeat([float(imu.accelerometer_bias), float(imu.gyro_bias)], 3)
        heat = np.repeat([float(imu.accelerometer_temperature_coefficient), float(imu.gyro_temperature_coefficient)], 3)
        self.turn_on_bias = on * rng.standard_normal(6)
        self._temperature_bias = heat * rng.standard_normal(6)
        self._g_sensitivity = float(imu.gyro_g_sensitivity) * rng.standard_normal((3, 3))
        turned = mounting_matrix(imu)
        self.mounting = np.eye(3) if turned is None else turned
        if turned is not None:
            self._axes, self._g_sensitivity = self._axes @ turned, self._g_sensitivity @ turned
        azimuth = rng.uniform(0.0, 2 * math.pi, 3)
        level = math.cos(_VIBRATION_ELEVATION_RAD)
        e = np.column_stack(
            [level * np.cos(azimuth), level * np.sin(azimuth), np.full(3, math.sin(_VIBRATION_ELEVATION_RAD))]
        )
        directions = e[[0, 0, 1, 1, 2]]
        self._line_response = np.hstack(
            [_project_vibration_lines(m, directions) for m in (self._axes[0], self._g_sensitivity)]
        )
        self._phases = np.array(
            [(math.cos(p), math.sin(p)) for p in rng.uniform(0.0, 2 * math.pi, _VIBRATION_LINE_COUNT)]
        )
        self.source = make_random_source(rng)
        self.reset()

    def reset(self) -> None:
        drift = np.repeat([float(self._imu.accelerometer_drift), float(self._imu.gyro_drift)], 3)
        self._drift_sigma, self._bias_drift = drift, drift * self._rng.standard_normal(6)
        self._azimuth = self._rng.uniform(0.0, 2 * math.pi, 2)
        self._filter_memory = np.zeros((6, 2))
        self._clock, self._last_state = np.full(1, math.nan), np.zeros(STATE_SIZE)
        self._normals, self._output = np.empty(0), np.zeros((2, 6))
        self._current_force = np.zeros(3)
        self._readings: Mapping[str, Reading] = {}
        self._readings_s = math.nan

    def set_clipping_limit(self, limit_m_s2: float | None) -> None:
        """Set the clipping limit of the accelerometers (a fault); None restores their range."""
        self._limit[:FIRST_GYRO_AXIS] = self._range[:FIRST_GYRO_AXIS] if limit_m_s2 is None else limit_m_s2

    def read(self, truth: Truth) -> Mapping[str, Reading]:
        t, last = truth.time_s, self._clock.item()
        if t <= last:
            return self.latest_readings
        if math.isnan(last):
            _, _, *arrays, unit = self.sampling_arguments(1.0)
            make_first_imu_reading(truth.state, t, *arrays, self.mounting, unit)
        else:
            sample_imu(truth.state, t, *self.sampling_arguments(t - last))
        return self.latest_readings

    def sampling_arguments(self, elapsed_s: float) -> tuple[Any, ...]:
        """Return the arguments of :func:`sample_imu` after ``t``, for a reading every ``elapsed_s`` (s)."""
        size = 6 + 6 * max(1, round(elapsed_s / self._dt))
        if self._normals.size != size:
            self._normals = np.zeros(size)
        unit = (
            self._vibration_numbers,
            self._place,
            self._axes,
            self._g_sensitivity,
            self._line_response,
            self._phases,
            self._temperature_bias,
            self.turn_on_bias,
            self._drift_sigma,
            self._white_noise,
            self._limit,
            self._filter,
            self._azimuth,
            self._bias_drift,
            self._filter_memory,
            self._current_force,
        )
        return self.source, self._normals, self._clock, self._last_state, self._output, unit

    def error_free_readings(self, truth: Truth) -> Mapping[str, Any]:
        """Return angular rates, and mean specific force since the reading before, without sensor errors."""
        return {"acceleration": self._current_force.copy(), "rates": truth.rates}

    def temperature_rise_K(self, time_s: float) -> float:
        """Return the rise of temperature since switching on (K)."""
        return float(_compute_temperature_rise_K(time_s, self._vibration_numbers))

    @property
    def latest_readings(self) -> Mapping[str, Reading]:
        t = self._clock.item()
        if t != self._readings_s and not math.isnan(t):
            output = self._output.copy()
            self._readings_s = t
            self._readings = {
                "acceleration": Reading(output[0, :FIRST_GYRO_AXIS], t),
                "rates": Reading(output[0, FIRST_GYRO_AXIS:], t),
                "clipping": Reading(output[1, :FIRST_GYRO_AXIS], t),
                "temperature": Reading(ROOM_TEMPERATURE_K + self.temperature_rise_K(t), t),
            }
        return self._readings


def butterworth_coefficients(cutoff_rad_s: float, step_s: float) -> _Array:
    """Return b0, b1, b2, a1, a2 of the second-order low pass, by the bilinear transform with matched cut-off."""
    k = math.tan(min(0.5 * cutoff_rad_s * step_s, 0.49 * math.pi))
    norm = 1.0 / (1.0 + math.sqrt(2.0) * k + k * k)
    b0 = k * k * norm
    return np.array([b0, 2 * b0, b0, 2 * (k * k - 1) * norm, (1 - math.sqrt(2.0) * k + k * k) * norm])


def mounting_matrix(imu: ImuTable) -> _Array | None:
    """Return the rotation matrix (3, 3) from body axes to those of the sensor element; None if they coincide."""
    angles = [float(q) for q in (imu.mount_roll, imu.mount_pitch, imu.mount_yaw)]
    if not any(angles):
        return None
    return np.ascontiguousarray(body_to_ned_matrix(quaternion_from_euler(*angles)).T)


def _draw_axis_error_matrix(rng: np.random.Generator, scale: float, misalignment: float) -> _Array:
    """Return the matrix from true to sensed axes: the identity with errors."""
    off = misalignment * rng.standard_normal((3, 3))
    return np.eye(3) + np.diag(scale * rng.standard_normal(3)) + off - np.diag(np.diag(off))


def _compute_vibration_frequencies(upper: float, lower: float) -> tuple[float, ...]:
    """Return the frequencies (rad/s) of the five vibration lines: 1 and 2/rev of each rotor, and blade passing."""
    return 1.0 * upper, 2.0 * upper, 1.0 * lower, 2.0 * lower, 2.0 * (upper + lower)


def _project_vibration_lines(axes: _Array, directions: _Array) -> _Array:
    """Return the product (5, 3) of the matrix ``axes`` (3, 3) and the direction of each of the five vibration lines.

    The order of summation is fixed, so that results are equal on every machine.
    """
    x, y, z = directions.T[:, :, None]
    return x * axes[:, 0] + y * axes[:, 1] + z * axes[:, 2]


# A period of the flight software is one compiled function: forty samples of six axes cost less than ten calls of
# NumPy. The vibration lines are rotating phasors. A rotor's speed changes linearly within a period, so the angle per
# sample grows by a constant step, and sine and cosine are evaluated three times a rotor and period instead of ten
# times a sample. The phasor of 2/rev is the square of that of 1/rev. All samples of an axis are summed in vector
# registers.


@cached_njit(error_model="numpy")
def resonance_gain(speed: float, natural: float, damping: float) -> float:
    x = speed / natural
    return 1.0 / math.sqrt((1.0 - x * x) ** 2 + (2.0 * damping * x) ** 2)


@cached_njit(error_model="numpy")
def _compute_temperature_rise_K(t: float, numbers: _Array) -> float:
    return numbers[_FINAL_TEMPERATURE_RISE_INDEX] * (1.0 - math.exp(-t / numbers[_WARMING_TIME_INDEX]))


@cached_njit(error_model="numpy")
def _mean_specific_force(was: _Array, now: _Array, elapsed: float, place: _Array, force: _Array) -> None:
    """Write the mean specific force at the sensor element (m/s^2) between states ``was`` and ``now`` to ``force``.

    The states are ``elapsed`` (s) apart; ``place`` is the element's position in body axes (m).
    """
    turn = body_to_ned_matrix(now[ATTITUDE_SLICE])
    wx, wy, wz = now[MODEL_RATES], now[MODEL_RATES + 1], now[MODEL_RATES + 2]
    px, py = (wx - was[MODEL_RATES]) / elapsed, (wy - was[MODEL_RATES + 1]) / elapsed
    pz = (wz - was[MODEL_RATES + 2]) / elapsed
    a, b = (
        (now[MODEL_VELOCITY] - was[MODEL_VELOCITY]) / elapsed,
        (now[MODEL_VELOCITY + 1] - was[MODEL_VELOCITY + 1]) / elapsed,
    )
    c = (now[MODEL_VELOCITY + 2] - was[MODEL_VELOCITY + 2]) / elapsed - GRAVITY
    x, y, z = place[0], place[1], place[2]
    vx, vy, vz = wy * z - wz * y, wz * x - wx * z, wx * y - wy * x
    force[0] = turn[0, 0] * a + turn[1, 0] * b + turn[2, 0] * c + py * z - pz * y + wy * vz - wz * vy
    force[1] = turn[0, 1] * a + turn[1, 1] * b + turn[2, 1] * c + pz * x - px * z + wz * vx - wx * vz
    force[2] = turn[0, 2] * a + turn[1, 2] * b + turn[2, 2] * c + px * y - py * x + wx * vy - wy * vx


@cached_njit(error_model="numpy")
def _begin_phasor(
    azimuth: float, first: float, last: float, elapsed: float, n: int
) -> tuple[float, float, float, float, float, float]:
    """Return cosine and sine of three angles: a rotor's azimuth, its rotation to the next sample, and the increase of
    that rotation per sample.

    The rotor's speed changes from ``first`` to ``last`` (rad/s) over ``n`` samples.
    """
    dt, growth = elapsed / n, (last - first) / n
    turn, more = dt * (first + 0.5 * growth), dt * growth
    return math.cos(azimuth), math.sin(azimuth), math.cos(turn), math.sin(turn), math.cos(more), math.sin(more)


@cached_njit(error_model="numpy")
def simulate_imu_period(
    was: _Array,
    now: _Array,
    elapsed: float,
    t: float,
    normal: _Array,
    numbers: _Array,
    place: _Array,
    axes: _Array,
    feigned: _Array,
    response: _Array,
    phases: _Array,
    heat: _Array,
    switched_on: _Array,
    drift: _Array,
    white: _Array,
    limit: _Array,
    coefficients: _Array,
    azimuth: _Array,
    wander: _Array,
    memory: _Array,
    force: _Array,
    out: _Array,
    clipped: _Array,
) -> None:
    """Simulate the unit's vibration, sampling, clipping and filtering over a period that ends at ``t`` (s).

    ``azimuth``, ``wander``, and ``memory`` (6, 2) of the filter keep the state between calls. ``normal`` (6 + 6 n) are
    standard normal numbers: of the drift, then of each axis' samples. ``force`` is the mean specific force at the
    element. ``response`` (5, 6) is the share of each vibration line in each axis. ``out`` and ``clipped`` (6,) are the
    readings and the shares of samples that clipped.
    """
    n, warmth = normal.size // 6 - 1, _compute_temperature_rise_K(t, numbers)
    once, twice, passing = numbers[_ONCE_PER_REV_INDEX], numbers[_TWICE_PER_REV_INDEX], numbers[_BLADE_PASSAGE_INDEX]
    natural, damping = numbers[_RESONANCE_INDEX], numbers[_DAMPING_INDEX]
    hover_up, hover_dw, drift_time = (
        numbers[_UPPER_HOVER_SPEED_INDEX],
        numbers[_LOWER_HOVER_SPEED_INDEX],
        numbers[_DRIFT_TIME_INDEX],
    )
    _mean_specific_force(was, now, elapsed, place, force)
    step = math.sqrt(2.0 * elapsed / drift_time)
    for j in range(6):
        wander[j] += -wander[j] * elapsed / drift_time + drift[j] * step * normal[j]

    # Input of the six axes: at the start, its increase up to the end, and coefficients of each line's cosine and sine.
    wave, lines = np.empty((6, 12)), np.empty((17, n))  # the translation to C needs sizes as numbers
    for j in range(3):
        a = w = more = 0.0
        for m in range(3):
            a += axes[0, j, m] * force[m]
            w += axes[1, j, m] * was[MODEL_RATES + m] + feigned[j, m] * force[m]
            more += axes[1, j, m] * (now[MODEL_RATES + m] - was[MODEL_RATES + m])
        wave[j, _AXIS_INPUT_START_COLUMN], wave[j, _AXIS_INPUT_INCREASE_COLUMN] = a, 0.0
        wave[FIRST_GYRO_AXIS + j, _AXIS_INPUT_START_COLUMN], wave[FIRST_GYRO_AXIS + j, _AXIS_INPUT_INCREASE_COLUMN] = (
            w,
            more,
        )
    up = 0.5 * (was[MODEL_SPEED_UPPER] + now[MODEL_SPEED_UPPER])
    dw = 0.5 * (was[MODEL_SPEED_LOWER] + now[MODEL_SPEED_LOWER])
    for line in range(5):
        if line < 4:
            speed, hover = (up, hover_up) if line < 2 else (dw, hover_dw)
            times = 1.0 + line % 2
            amplitude = once if line % 2 == 0 else twice
        else:
            speed, hover, times, amplitude = up + dw, hover_up + hover_dw, 2.0, passing
        share = speed / hover
        amplitude *= share * share
        amplitude *= resonance_gain(times * speed, natural, damping) / numbers[_HOVER_RESONANCE_GAIN_INDEX + line]
        c, s = amplitude * phases[line, 0], amplitude * phases[line, 1]
        for j in range(6):
            wave[j, 2 * line], wave[j, 2 * line + 1] = c * response[line, j], -s * response[line, j]
    for j in range(6):
        wave[j, _AXIS_INPUT_START_COLUMN] += switched_on[j] + wander[j] + heat[j] * warmth

    # Phasors of the rotors: current value, next rotation, and growth of the rotation per sample.
    up_first, up_last = was[MODEL_SPEED_UPPER], now[MODEL_SPEED_UPPER]
    dw_first, dw_last = was[MODEL_SPEED_LOWER], now[MODEL_SPEED_LOWER]
    c, s, tc, ts, gc, gs = _begin_phasor(azimuth[0], up_first, up_last, elapsed, n)
    e, f, te, tf, ge, gf = _begin_phasor(azimuth[1], dw_first, dw_last, elapsed, n)
    azimuth[0] = (azimuth[0] + 0.5 * elapsed * (up_first + up_last)) % (2.0 * math.pi)
    azimuth[1] = (azimuth[1] + 0.5 * elapsed * (dw_first + dw_last)) % (2.0 * math.pi)
    l0, l1 = borrow_arrays(lines[2 * _UPPER_LINE]), borrow_arrays(lines[2 * _UPPER_LINE + 1])
    l2, l3 = borrow_arrays(lines[2 * _UPPER_TWICE_LINE]), borrow_arrays(lines[2 * _UPPER_TWICE_LINE + 1])
    l4, l5 = borrow_arrays(lines[2 * _LOWER_LINE]), borrow_arrays(lines[2 * _LOWER_LINE + 1])
    l6, l7 = borrow_arrays(lines[2 * _LOWER_TWICE_LINE]), borrow_arrays(lines[2 * _LOWER_TWICE_LINE + 1])
    l8, l9 = borrow_arrays(lines[2 * _PASSAGE_LINE]), borrow_arrays(lines[2 * _PASSAGE_LINE + 1])
    middle = borrow_arrays(lines[_SAMPLE_MIDDLE_FRACTION_ROW])
    for i in range(n):
        c, s = c * tc - s * ts, c * ts + s * tc
        e, f = e * te - f * tf, e * tf + f * te
        tc, ts = tc * gc - ts * gs, tc * gs + ts * gc
        te, tf = te * ge - tf * gf, te * gf + tf * ge
        l0[i], l1[i], l4[i], l5[i] = c, s, e, f
    for i in range(n):
        l2[i], l3[i] = l0[i] * l0[i] - l1[i] * l1[i], 2.0 * l0[i] * l1[i]
    for i in range(n):
        l6[i], l7[i] = l4[i] * l4[i] - l5[i] * l5[i], 2.0 * l4[i] * l5[i]
    for i in range(n):
        l8[i], l9[i] = l2[i] * l6[i] - l3[i] * l7[i], l2[i] * l7[i] + l3[i] * l6[i]
    for i in range(n):
        middle[i] = (i + 0.5) / n
    # One axis after the other, all its samples together, with a few lines in each pass over them.
    for j in range(6):
        x, noise = (
            borrow_arrays(lines[_FIRST_AXIS_ROW + j]),
            borrow_arrays(normal[_IMU_AXIS_COUNT + n * j : _IMU_AXIS_COUNT + n * (j + 1)]),
        )
        start, more, loud, most, beyond = (
            wave[j, _AXIS_INPUT_START_COLUMN],
            wave[j, _AXIS_INPUT_INCREASE_COLUMN],
            white[j],
            limit[j],
            0,
        )
        w0, w1 = wave[j, 2 * _UPPER_LINE], wave[j, 2 * _UPPER_LINE + 1]
        w2, w3 = wave[j, 2 * _UPPER_TWICE_LINE], wave[j, 2 * _UPPER_TWICE_LINE + 1]
        w4, w5 = wave[j, 2 * _LOWER_LINE], wave[j, 2 * _LOWER_LINE + 1]
        w6, w7 = wave[j, 2 * _LOWER_TWICE_LINE], wave[j, 2 * _LOWER_TWICE_LINE + 1]
        w8, w9 = wave[j, 2 * _PASSAGE_LINE], wave[j, 2 * _PASSAGE_LINE + 1]
        for i in range(n):
            x[i] = start + middle[i] * more + loud * noise[i] + w0 * l0[i] + w1 * l1[i] + w2 * l2[i] + w3 * l3[i]
        for i in range(n):
            x[i] = x[i] + w4 * l4[i] + w5 * l5[i] + w6 * l6[i] + w7 * l7[i] + w8 * l8[i] + w9 * l9[i]
        for i in range(n):
            beyond += 1 if abs(x[i]) > most else 0
            x[i] = max(min(x[i], most), -most)
        clipped[j] = beyond / n
    # Direct form II with its states in units of the signal: at rest both states equal the signal. Three axes at a time,
    # because each step of one axis waits for the step before.
    b0, b1, b2, a1, a2 = coefficients[0], coefficients[1], coefficients[2], coefficients[3], coefficients[4]
    gain = 1.0 + a1 + a2
    for half in range(2):
        j = FIRST_GYRO_AXIS * half
        x, y, z = (
            borrow_arrays(lines[_FIRST_AXIS_ROW + j]),
            borrow_arrays(lines[_FIRST_AXIS_ROW + j + 1]),
            borrow_arrays(lines[_FIRST_AXIS_ROW + j + 2]),
        )
        x1, x2, y1, y2, z1, z2 = (
            memory[j, 0], memory[j, 1], memory[j + 1, 0], memory[j + 1, 1], memory[j + 2, 0], memory[j + 2, 1],
        )  # fmt: skip
        for i in range(n - 1):
            x1, x2 = gain * x[i] - a1 * x1 - a2 * x2, x1
            y1, y2 = gain * y[i] - a1 * y1 - a2 * y2, y1
            z1, z2 = gain * z[i] - a1 * z1 - a2 * z2, z1
        x0 = gain * x[n - 1] - a1 * x1 - a2 * x2
        y0 = gain * y[n - 1] - a1 * y1 - a2 * y2
        z0 = gain * z[n - 1] - a1 * z1 - a2 * z2
        out[j] = (b0 * x0 + b1 * x1 + b2 * x2) / gain
        out[j + 1] = (b0 * y0 + b1 * y1 + b2 * y2) / gain
        out[j + 2] = (b0 * z0 + b1 * z1 + b2 * z2) / gain
        memory[j, 0], memory[j, 1], memory[j + 1, 0] = x0, x1, y0
        memory[j + 1, 1], memory[j + 2, 0], memory[j + 2, 1] = y1, z0, z1
    # This use keeps the borrowed arrays alive up to here.
    lines[0, 0], wave[0, 0] = 0.0, 0.0


@cached_njit(error_model="numpy")
def make_first_imu_reading(
    x: _Array, t: float, clock: _Array, last_state: _Array, output: _Array, mounting: _Array, unit: tuple[_Array, ...]
) -> None:
    """Make the first reading, of a vehicle at rest: without noise and vibration.

    ``mounting`` (3, 3) is the rotation matrix from body axes to the element's; the others as in :func:`sample_imu`.
    """
    place, switched_on, wander, memory, force = (
        unit[_POSITION_ARRAY_INDEX],
        unit[_TURN_ON_BIAS_ARRAY_INDEX],
        unit[_BIAS_DRIFT_ARRAY_INDEX],
        unit[_LOW_PASS_MEMORY_ARRAY_INDEX],
        unit[_SPECIFIC_FORCE_ARRAY_INDEX],
    )
    clock[0] = t
    for k in range(x.size):
        last_state[k] = x[k]
    _mean_specific_force(x, x, 1.0, place, force)
    for j in range(3):
        felt = turned = 0.0
        for k in range(3):
            felt += mounting[j, k] * force[k]
            turned += mounting[j, k] * x[MODEL_RATES + k]
        for k in range(2):
            memory[j, k], memory[FIRST_GYRO_AXIS + j, k] = felt, turned
    for j in range(6):
        output[0, j], output[1, j] = memory[j, 0] + (switched_on[j] + wander[j]), 0.0


@cached_njit(error_model="numpy")
def sample_imu(
    x: _Array,
    t: float,
    source: NDArray[np.uint64],
    normal: _Array,
    clock: _Array,
    last_state: _Array,
    output: _Array,
    unit: tuple[_Array, ...],
) -> None:
    """Read the unit at time ``t`` (s) in state ``x`` (21,).

    Parameters
    ----------
    x, t
    source : (1,) array of uint64
        State of the random numbers.
    normal : (6 + 6 n,) array
        Room for them.
    clock, last_state : (1,), (21,) arrays
        Time (s) and state of the reading before, overwritten.
    output : (2, 6) array
        Written: values of the six axes, and the share of their samples that clipped.
    unit : tuple of arrays
        Constants and memory of the unit, as :func:`simulate_imu_period` takes them after the normal numbers.
    """
    draw_normals(source, normal)
    simulate_imu_period(last_state, x, t - clock[0], t, normal, *unit, output[0], output[1])
    clock[0] = t
    for k in range(x.size):
        last_state[k] = x[k]
