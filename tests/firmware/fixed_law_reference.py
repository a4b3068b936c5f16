"""Reference in Python of the fixed-point control law, ``fixed_point/fixed_point_law.c``.

Python integers are unbounded; numbers beyond C's 32 or 64 bits are detected.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mufly.control import FlightController
from mufly.estimate import Estimate
from mufly.firmware.fixed_point.fixed_point_design import FRACTION_BITS, FixedPointLaw, quantise_law
from mufly.firmware.fixed_point.fixed_point_law import (
    FIXED_POINT_ONE,
    fixed_point_gains,
    to_fixed_point_signal,
    to_fixed_point_signals,
)
from mufly.flight.controllers import Actuators, Controllers

_Array = NDArray[np.floating[Any]]

TRIG_UNIT = 1 << 30
_SIGNAL_LIMIT, _FEEDFORWARD_LIMIT = 1 << 30, 64 << 20
_TWO_OVER_PI, _HALF_PI = 683565276, 1727108826179
_INT32_RANGE = (-(1 << 31), (1 << 31) - 1)


def _round_shift(value: int, bits: int) -> int:
    assert -(1 << 63) < value < 1 << 63, "a sum that 64 bits do not hold"
    if bits == 0:
        return value
    half = 1 << (bits - 1)
    return (value + half) >> bits if value >= 0 else -((-value + half) >> bits)


def _multiply_shift(a: int, b: int, bits: int) -> int:
    return _round_shift(a * b, bits)


def _clip_value(value: int, low: int, high: int) -> int:
    return low if value < low else high if value > high else value


def _clip_symmetric(value: int, limit: int) -> int:
    return _clip_value(value, -limit, limit)


def _divide_truncating(a: int, b: int) -> int:
    """Return the quotient truncated towards zero, as in C."""
    return a // b if (a >= 0) == (b > 0) else -(-a // b)


def sine_cosine_fixed(angle: int) -> tuple[int, int]:
    """Return sine and cosine (2^-30) of an angle (2^-20 rad)."""
    n = _multiply_shift(angle, _TWO_OVER_PI, 50)
    r = _round_shift(angle * FIXED_POINT_ONE - n * _HALF_PI, 10)
    q = _multiply_shift(r, r, 30)
    s, c = 2959, -296
    for k in (-213044, 8947849, -178956971):
        s = k + _multiply_shift(q, s, 30)
    s = r + _multiply_shift(r, _multiply_shift(q, s, 30), 30)
    for k in (26631, -1491308, 44739243, -536870912, TRIG_UNIT):
        c = k + _multiply_shift(q, c, 30)
    return ((s, c), (c, -s), (-s, -c), (-c, s))[n % 4]


class FixedPointControllers(Controllers):
    """A :class:`mufly.flight.controllers.Controllers` in fixed point, computed by Python.

    Parameters
    ----------
    design : FlightController
    law : FixedPointLaw, optional
        Law of the design; computed by default.

    Attributes
    ----------
    overflow_count : int
        Number of 32-bit overflows so far; zero by the proof.
    """

    def __init__(self, design: FlightController, law: FixedPointLaw | None = None) -> None:
        super().__init__(design)
        self.law = law or quantise_law(design)
        self._gains_table = fixed_point_gains(design, self.law)
        self._controller_states: dict[str, list[int]] = {
            name: [0] * len(c.state_fraction_bits)
            for name, c in zip(self._gains_table, self.law.controllers, strict=True)
        }
        self._filtered_references = {"height": [0, 0], "heading": [0, 0]}
        self._origin = [0, 0]
        self._voltage = 0
        self._overflow_count = 0

    @property
    def overflow_count(self) -> int:
        """Return the number of 32-bit overflows so far; zero by the proof."""
        return self._overflow_count

    def _blend_gains(self) -> None:
        super()._blend_gains()
        self._gains_table = fixed_point_gains(self._design, self.law)

    def _saturate_int32(self, value: int) -> int:
        held = _clip_value(value, *_INT32_RANGE)
        self._overflow_count += held != value
        return held

    def _fixed_dot(self, row: list[dict[str, int]], by: list[int], down: int) -> int:
        total = 0
        for a, w in zip(row, by, strict=True):
            if a["c"]:
                total += (a["c"] * w) << a["up"]
        return _round_shift(total, down)

    def _update_state(self, name: str, w: list[int]) -> None:
        g = self._gains_table[name]
        self._controller_states[name] = [
            self._saturate_int32(g["kept"] * w[i] + self._fixed_dot(row, w, down))
            for i, (row, down) in enumerate(zip(g["update"], g["update_down"], strict=True))
        ]

    def _initialise_state(self, name: str, w: list[int]) -> None:
        g = self._gains_table[name]
        self._controller_states[name] = [
            self._saturate_int32(self._fixed_dot(row, w, down))
            for row, down in zip(g["start"], g["start_down"], strict=True)
        ]

    def _compute_output(self, name: str, w: list[int]) -> list[int]:
        g = self._gains_table[name]
        return [self._fixed_dot(row, w, down) for row, down in zip(g["output"], g["output_down"], strict=True)]

    def _limit_voltage(self, voltage: int) -> int:
        design = self._gains_table["heave_yaw"]["design_voltage"]
        return 16 * _clip_value(voltage, design // 2, design + design // 2)

    def engage_heave_yaw(self, estimate: Estimate, motor_input: _Array) -> None:
        h, (_, z), (_, psi), r, volts = self._gains_table["heave_yaw"], *_measure_heave_yaw(estimate)
        self._voltage = self._limit_voltage(volts)
        w = [0, 0, 0, 0, _clip_symmetric(-r[2], h["limit"][-1])]
        motors = [to_fixed_point_signal(v) for v in motor_input]
        for i in range(2):
            share = _multiply_shift(_clip_value(motors[1 - i], 0, FIXED_POINT_ONE), self._voltage, FRACTION_BITS)
            w.append(_multiply_shift(share, h["per_volt"], 34) - h["trim"][i])
        self._initialise_state("heave_yaw", w)
        self._origin = [z, psi]
        self._filtered_references = {"height": [z * FIXED_POINT_ONE, 0], "heading": [psi * FIXED_POINT_ONE, 0]}

    def engage_roll_pitch(self, estimate: Estimate) -> None:
        limits = self._gains_table["roll_pitch"]["limit"]
        measured = _measure_roll_pitch(estimate)
        self._initialise_state(
            "roll_pitch", [*(_clip_symmetric(-v, n) for v, n in zip(measured, limits, strict=True)), 0, 0]
        )
        self._controller_states["position"] = [0] * len(self._controller_states["position"])

    def _filter_reference(self, name: str, target: int, target_rate: int) -> int:
        """Advance a reference filter; return its output with lead."""
        g, period = self._gains_table["heave_yaw"][name], self._gains_table["heave_yaw"]["period"]
        value, rate = self._filtered_references[name]
        gap = target - _round_shift(value, 20)
        wanted = _multiply_shift(g["slope"], gap, FRACTION_BITS)
        if abs(gap) > g["linear"]:
            root = math.isqrt(max(0, g["braking"] * (abs(gap) - g["linear"] // 2)))
            wanted = -root if gap < 0 else root
        wanted = 16 * _clip_symmetric(wanted + target_rate, g["speed"])
        gained = _clip_symmetric(_multiply_shift(g["bandwidth"], wanted - rate, FRACTION_BITS), g["acceleration"])
        rate = self._saturate_int32(rate + _multiply_shift(period, gained, 36))
        value += _multiply_shift(period, rate, 20)
        self._filtered_references[name] = [value, rate]
        felt = _round_shift(rate, 4)
        felt = _clip_value(felt, 0, target_rate) if target_rate > 0 else _clip_value(felt, target_rate, 0)
        return _round_shift(value, 20) + _multiply_shift(g["lead"], felt, FRACTION_BITS)

    def _heave_yaw_step(self, estimate: Estimate, reference: list[int]) -> list[int]:
        h, (_, z), (_, psi), rates, volts = self._gains_table["heave_yaw"], *_measure_heave_yaw(estimate)
        height, heading, climb, turn = reference
        led = (
            self._filter_reference("height", height, climb),
            self._filter_reference("heading", heading, turn),
        )
        self._voltage += _multiply_shift(h["voltage_blend"], self._limit_voltage(volts) - self._voltage, 30)
        top = _multiply_shift(self._voltage, h["per_volt"], 34)
        origin_z, origin_psi = self._origin
        errors = (led[0] - origin_z, led[1] - origin_psi, origin_z - z, origin_psi - psi, -rates[2])
        w = [
            *self._controller_states["heave_yaw"],
            *(_clip_symmetric(v, n) for v, n in zip(errors, h["limit"], strict=True)),
        ]
        u = [v + t for v, t in zip(self._compute_output("heave_yaw", w), h["trim"], strict=True)]
        most = _clip_symmetric(u[1] - u[0], top)
        total = _clip_value(u[1] + u[0], abs(most), 2 * top - abs(most))
        lower, upper = (total - most) // 2, (total + most) // 2
        w += [
            self._saturate_int32(_round_shift(lower - u[0], 4)),
            self._saturate_int32(_round_shift(upper - u[1], 4)),
        ]
        self._update_state("heave_yaw", w)
        return [_clip_value(_divide_truncating(v * FIXED_POINT_ONE, top), 0, FIXED_POINT_ONE) for v in (upper, lower)]

    def _roll_pitch_step(self, estimate: Estimate, tilt: list[int]) -> list[int]:
        g, measured = self._gains_table["roll_pitch"], _measure_roll_pitch(estimate)
        errors = [_clip_symmetric(tilt[i], g["tilt_limit"]) - measured[i] for i in range(2)] + [
            -v for v in measured[2:]
        ]
        w = [
            *self._controller_states["roll_pitch"],
            *(_clip_symmetric(v, n) for v, n in zip(errors, g["limit"], strict=True)),
        ]
        wanted = [v + t for v, t in zip(self._compute_output("roll_pitch", w), g["trim"], strict=True)]
        servos = [_clip_symmetric(v, FIXED_POINT_ONE) for v in wanted]
        w += [self._saturate_int32(_round_shift(s - v, 4)) for s, v in zip(servos, wanted, strict=True)]
        self._update_state("roll_pitch", w)
        return servos

    def compute_tilt_command(
        self, estimate: Estimate, position: _Array, velocity: _Array, acceleration: _Array
    ) -> _Array:
        g = self._gains_table["position"]
        here, speed = to_fixed_point_signals(estimate.position), to_fixed_point_signals(estimate.velocity)
        to, going, pushed = (
            to_fixed_point_signals(position),
            to_fixed_point_signals(velocity),
            to_fixed_point_signals(acceleration),
        )
        wanted = [
            _clip_symmetric(
                going[i] + _multiply_shift(g["position_gain"], to[i] - here[i], FRACTION_BITS), _SIGNAL_LIMIT
            )
            for i in range(2)
        ]
        wanted = _limit_length(wanted, g["speed_limit"])
        w = [
            *self._controller_states["position"],
            *(_clip_symmetric(wanted[i] - speed[i], g["limit"][i]) for i in range(2)),
        ]
        a = [_clip_symmetric(pushed[1 - i], _FEEDFORWARD_LIMIT) for i in range(2)]
        lean = [_multiply_shift(a[0], g["per_gravity"], 30), _multiply_shift(-a[1], g["per_gravity"], 30)]
        asked = [v + more for v, more in zip(self._compute_output("position", w), lean, strict=True)]
        given = _limit_length([_clip_symmetric(v, _SIGNAL_LIMIT) for v in asked], g["tilt_limit"])
        w += [self._saturate_int32(_round_shift(v - u, 4)) for v, u in zip(given, asked, strict=True)]
        sine, cosine = sine_cosine_fixed(to_fixed_point_signal(estimate.attitude[2]))
        tilt = (
            _round_shift(cosine * given[0] + sine * given[1], 30),
            _round_shift(cosine * given[1] - sine * given[0], 30),
        )
        self._update_state("position", w)
        return np.array(tilt) / FIXED_POINT_ONE

    def step(self, estimate: Estimate, heave_yaw: _Array, tilt: _Array | None) -> Actuators:
        if not self._settled:
            self._blend_gains()
        servos = [0, 0]
        if tilt is not None:
            self._limit_heave_reference(to_fixed_point_signal(estimate.position[2]))
            servos = self._roll_pitch_step(estimate, to_fixed_point_signals(tilt))
        motors = self._heave_yaw_step(estimate, to_fixed_point_signals(heave_yaw))
        return Actuators(np.array(motors) / FIXED_POINT_ONE, np.array(servos) / FIXED_POINT_ONE)

    def _limit_heave_reference(self, z: int) -> None:
        g, (value, rate) = self._gains_table["heave_yaw"], self._filtered_references["height"]
        slack, brake = g["slack"], 2 * _multiply_shift(g["period"], g["height"]["acceleration"], 36)
        trails = z - _round_shift(value, 20)
        left = slack - abs(trails)
        fastest = 16 * (g["height"]["speed"] * max(left, 0) // slack)
        less = _clip_value((rate if trails < 0 else -rate) - fastest, 0, brake)
        if left < 0:
            value = FIXED_POINT_ONE * (z + slack if trails < 0 else z - slack)
        self._filtered_references["height"] = [value, rate + (-less if trails < 0 else less)]


def _limit_length(v: list[int], limit: int) -> list[int]:
    length = math.isqrt(v[0] * v[0] + v[1] * v[1])
    return [_divide_truncating(a * limit, length) for a in v] if length > limit else v


def _measure_heave_yaw(m: Estimate) -> tuple[tuple[int, int], tuple[int, int], list[int], int]:
    return (
        (0, to_fixed_point_signal(m.position[2])),
        (0, to_fixed_point_signal(m.attitude[2])),
        to_fixed_point_signals(m.rates),
        to_fixed_point_signal(m.battery_voltage),
    )


def _measure_roll_pitch(m: Estimate) -> list[int]:
    return [
        to_fixed_point_signal(m.attitude[0]),
        to_fixed_point_signal(m.attitude[1]),
        to_fixed_point_signal(m.rates[0]),
        to_fixed_point_signal(m.rates[1]),
    ]
