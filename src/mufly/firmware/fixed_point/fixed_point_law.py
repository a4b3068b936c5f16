"""Compute the fixed-point control law in Python, the reference of ``fixed/fixed_law.c``, and in C; equal bit for bit.

Python integers are unbounded; numbers beyond C's 32 or 64 bits are detected.
:mod:`mufly.firmware.fixed_point.fixed_point_design` defines coefficients, rows and bounds; :mod:`mufly.control.law`
defines the law.
"""

from __future__ import annotations

import functools
import math
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import cffi
import numpy as np
from numpy.typing import NDArray

from mufly.compiled.toolchain import find_compiler
from mufly.control import FlightController
from mufly.errors import InputError
from mufly.estimate import Estimate
from mufly.firmware.export.source_export import copy_fixed_point, escape_comment
from mufly.firmware.fixed_point.fixed_point_design import (
    ERROR_LIMITS,
    FRACTION_BITS,
    CoefficientRows,
    FixedPointLaw,
    quantise_law,
)
from mufly.firmware.host_build import build_library, cffi_declarations
from mufly.flight.controllers import Actuators, Controllers
from mufly.version import __version__

_Array = NDArray[np.floating[Any]]
_GainsTable = dict[str, Any]

SIGNAL_ONE, TRIG_UNIT = 1 << FRACTION_BITS, 1 << 30
_SIGNAL_LIMIT, _FEEDFORWARD_LIMIT = 1 << 30, 64 << 20
_TWO_OVER_PI, _HALF_PI = 683565276, 1727108826179
_INT32_RANGE = (-(1 << 31), (1 << 31) - 1)


# ----------------------------------------------------------------------------
# Tables with the fields of the C structs in fixed_law.h.


def fixed_point_gains(controller: FlightController, law: FixedPointLaw) -> _GainsTable:
    """Return the integers of a vehicle's controllers by the fields of ``fixed_gains_t``.

    Raises
    ------
    InputError
        If the rate is below 33 Hz, or a number exceeds 32 bits.
    """
    h, r, p = controller.heave_yaw_gains, controller.roll_pitch_gains, controller.position_gains
    if float(h["period"]) >= 2.0**-5:
        raise InputError("rate_Hz", f"{controller.rate_Hz:g}", "is too slow for whole numbers", "give 33 Hz or more")
    found = {
        "heave_yaw": {
            **_coefficient_table(law.heave_yaw.update_rows, law.heave_yaw.output_rows, law.heave_yaw.start_rows),
            "kept": int(law.heave_yaw.is_delta_form),
            "limit": _error_limits("heave_yaw"),
            "trim": [_to_fixed_point(v) for v in h["trim"]],
            "height": _reference_filter_gains(h, "heave", "speed"),
            "heading": _reference_filter_gains(h, "yaw", "rate"),
            "slack": _to_fixed_point(h["heave_slack"]),
            "period": _to_fixed_point(h["period"], 36),
            "design_voltage": _to_fixed_point(h["design_voltage"]),
            "per_volt": _to_fixed_point(1.0 / h["design_voltage"], 30),
            "voltage_blend": _to_fixed_point(h["voltage_blend"], 30),
        },
        "roll_pitch": {
            **_coefficient_table(law.roll_pitch.update_rows, law.roll_pitch.output_rows, law.roll_pitch.start_rows),
            "kept": int(law.roll_pitch.is_delta_form),
            "limit": _error_limits("roll_pitch"),
            "trim": [_to_fixed_point(v) for v in r["trim"]],
            "tilt_limit": _to_fixed_point(r["tilt_limit"]),
        },
        "position": {
            **_coefficient_table(law.position.update_rows, law.position.output_rows, None),
            "kept": int(law.position.is_delta_form),
            "limit": _error_limits("position"),
            "position_gain": _to_fixed_point(p["position_gain"]),
            "speed_limit": _to_fixed_point(p["speed_limit"]),
            "tilt_limit": _to_fixed_point(p["tilt_limit"]),
            "per_gravity": _to_fixed_point(1.0 / p["gravity"], 30),
        },
    }
    return found


def _to_fixed_point(value: float, fraction: int = FRACTION_BITS) -> int:
    whole = round(float(value) * (1 << fraction))
    if not _INT32_RANGE[0] <= whole <= _INT32_RANGE[1]:
        raise InputError("fixed point", f"{float(value):g}", "does not fit 32 bits", "use a floating unit")
    return whole


def _error_limits(name: str) -> list[int]:
    return [_to_fixed_point(v) for v in ERROR_LIMITS[name]]


def _reference_filter_gains(h: np.void, axis: str, speed: str) -> _GainsTable:
    bandwidth, acceleration = float(h[f"{axis}_bandwidth"]), float(h[f"{axis}_acceleration"])
    return {
        "slope": _to_fixed_point(0.5 * bandwidth),
        "bandwidth": _to_fixed_point(2.0 * bandwidth),
        "braking": _to_fixed_point(acceleration),
        "linear": _to_fixed_point(2.0 * acceleration / bandwidth**2),
        "acceleration": _to_fixed_point(acceleration, 24),
        "speed": _to_fixed_point(h[f"{axis}_{speed}"]),
        "lead": _to_fixed_point(h[f"{axis}_lead"]),
    }


def _coefficient_table(update: CoefficientRows, output: CoefficientRows, start: CoefficientRows | None) -> _GainsTable:
    found: _GainsTable = {}
    for name, rows in (("update", update), ("output", output), ("start", start)):
        if rows is not None:
            found[name] = [
                [{"c": int(c), "up": int(up)} for c, up in zip(*pair, strict=True)]
                for pair in zip(rows.coefficients, rows.left_shift, strict=True)
            ]
            found[f"{name}_down"] = [int(d) for d in rows.right_shift]
    return found


def render_fixed_point_tables(controller: FlightController, law: FixedPointLaw) -> str:
    """Return the text of ``tables_fixed.c``: the integers of a vehicle's controllers, with bounds in a comment."""
    lines = [
        f"/* Whole numbers of {escape_comment(controller.vehicle_name)}, made by mufly {__version__}; do not edit.",
        " *",
    ]
    for made in law.controllers:
        proof = made.proof
        lines.append(
            f" * {made.name}: {made.form}; bits behind the point of the states "
            f"{', '.join(map(str, made.state_fraction_bits))}."
        )
        lines.append(
            f" *   Whatever comes, states stay below {proof.states.max():.2f} of 32 bits, sums below "
            f"{proof.sums.max():.2f} of 64."
        )
    lines += [
        " */", '#include "fixed_law.h"', "", f"const int32_t mufly_fixed_rate_Hz = {round(controller.rate_Hz)};",
        f"const int32_t mufly_fixed_position_divider = {controller.position_divider};", "",
        f"const fixed_gains_t mufly_fixed_gains = {_c_initialiser(fixed_point_gains(controller, law), 0)};", "",
    ]  # fmt: skip
    return "\n".join(lines)


def _c_initialiser(value: Any, depth: int) -> str:
    """Return the C initialiser of an integer, list or table."""
    pad = "    " * (depth + 1)
    if isinstance(value, Mapping):
        if set(value) == {"c", "up"}:
            return f"{{{value['c']}, {value['up']}U}}"
        inside = ",\n".join(f"{pad}.{k} = {_c_initialiser(v, depth + 1)}" for k, v in value.items())
        return f"{{\n{inside},\n{'    ' * depth}}}"
    if isinstance(value, Sequence):
        if value and isinstance(value[0], list):
            return "{\n" + ",\n".join(f"{pad}{_c_initialiser(v, depth + 1)}" for v in value) + f",\n{'    ' * depth}}}"
        return "{" + ", ".join(_c_initialiser(v, depth + 1) for v in value) + "}"
    return str(value)


def export_fixed_point(controller: FlightController, out: Path) -> FixedPointLaw:
    """Write the fixed-point law with its tables into ``fixed/`` of an exported tree, and return the law."""
    law = quantise_law(controller)
    copy_fixed_point(out)
    (out / "fixed" / "tables_fixed.c").write_text(render_fixed_point_tables(controller, law), encoding="utf-8")
    return law


# ----------------------------------------------------------------------------
# The law.


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
    r = _round_shift(angle * SIGNAL_ONE - n * _HALF_PI, 10)
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

    def engage(self, estimate: Estimate, motor_input: _Array) -> None:
        h, (_, z), (_, psi), r, volts = self._gains_table["heave_yaw"], *_measure_heave_yaw(estimate)
        self._voltage = self._limit_voltage(volts)
        w = [0, 0, 0, 0, _clip_symmetric(-r[2], h["limit"][-1])]
        motors = [to_signal(v) for v in motor_input]
        for i in range(2):
            share = _multiply_shift(_clip_value(motors[1 - i], 0, SIGNAL_ONE), self._voltage, FRACTION_BITS)
            w.append(_multiply_shift(share, h["per_volt"], 34) - h["trim"][i])
        self._initialise_state("heave_yaw", w)
        self._origin = [z, psi]
        self._filtered_references = {"height": [z * SIGNAL_ONE, 0], "heading": [psi * SIGNAL_ONE, 0]}

    def lift_off(self, estimate: Estimate) -> None:
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
        return [_clip_value(_divide_truncating(v * SIGNAL_ONE, top), 0, SIGNAL_ONE) for v in (upper, lower)]

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
        servos = [_clip_symmetric(v, SIGNAL_ONE) for v in wanted]
        w += [self._saturate_int32(_round_shift(s - v, 4)) for s, v in zip(servos, wanted, strict=True)]
        self._update_state("roll_pitch", w)
        return servos

    def tilt_for(self, estimate: Estimate, position: _Array, velocity: _Array, acceleration: _Array) -> _Array:
        g = self._gains_table["position"]
        here, speed = to_signals(estimate.position), to_signals(estimate.velocity)
        to, going, pushed = to_signals(position), to_signals(velocity), to_signals(acceleration)
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
        sine, cosine = sine_cosine_fixed(to_signal(estimate.attitude[2]))
        tilt = (
            _round_shift(cosine * given[0] + sine * given[1], 30), _round_shift(cosine * given[1] - sine * given[0], 30)
        )  # fmt: skip
        self._update_state("position", w)
        return np.array(tilt) / SIGNAL_ONE

    def step(self, estimate: Estimate, heave_yaw: _Array, tilt: _Array | None) -> Actuators:
        if not self._settled:
            self._blend_gains()
        servos = [0, 0]
        if tilt is not None:
            self._limit_heave_reference(to_signal(estimate.position[2]))
            servos = self._roll_pitch_step(estimate, to_signals(tilt))
        motors = self._heave_yaw_step(estimate, to_signals(heave_yaw))
        return Actuators(np.array(motors) / SIGNAL_ONE, np.array(servos) / SIGNAL_ONE)

    def _limit_heave_reference(self, z: int) -> None:
        g, (value, rate) = self._gains_table["heave_yaw"], self._filtered_references["height"]
        slack, brake = g["slack"], 2 * _multiply_shift(g["period"], g["height"]["acceleration"], 36)
        trails = z - _round_shift(value, 20)
        left = slack - abs(trails)
        fastest = 16 * (g["height"]["speed"] * max(left, 0) // slack)
        less = _clip_value((rate if trails < 0 else -rate) - fastest, 0, brake)
        if left < 0:
            value = SIGNAL_ONE * (z + slack if trails < 0 else z - slack)
        self._filtered_references["height"] = [value, rate + (-less if trails < 0 else less)]


def _limit_length(v: list[int], limit: int) -> list[int]:
    length = math.isqrt(v[0] * v[0] + v[1] * v[1])
    return [_divide_truncating(a * limit, length) for a in v] if length > limit else v


def to_signal(value: float) -> int:
    """Return a number as a signal: the nearest multiple of 2^-20, saturated at 32 bits."""
    return _clip_value(round(float(value) * SIGNAL_ONE), *_INT32_RANGE)


def to_signals(values: _Array) -> list[int]:
    """Return an array as a list of signals."""
    return [to_signal(v) for v in values]


def _measure_heave_yaw(m: Estimate) -> tuple[tuple[int, int], tuple[int, int], list[int], int]:
    return (
        (0, to_signal(m.position[2])),
        (0, to_signal(m.attitude[2])),
        to_signals(m.rates),
        to_signal(m.battery_voltage),
    )


def _measure_roll_pitch(m: Estimate) -> list[int]:
    return [to_signal(m.attitude[0]), to_signal(m.attitude[1]), to_signal(m.rates[0]), to_signal(m.rates[1])]


# ----------------------------------------------------------------------------
# The C code.


@functools.lru_cache(maxsize=8)
def _load_fixed_library(text: str, cc: str) -> tuple[cffi.FFI, Any]:
    ffi = cffi.FFI()
    with tempfile.TemporaryDirectory(prefix="mufly-fixed-") as folder:
        tree = Path(folder) / "fw"
        copy_fixed_point(tree)
        (tree / "fixed" / "tables_fixed.c").write_text(text, encoding="utf-8")
        library = build_library(tree / "fixed", cc=cc)
        ffi.cdef(cffi_declarations(tree / "fixed"))
        return ffi, ffi.dlopen(str(library))


class FixedPointFirmwareControllers(Controllers):
    """A :class:`mufly.flight.controllers.Controllers` in fixed point, computed by the exported C code with its tables.

    The class can be passed to :class:`mufly.flight.Flight` as ``controllers``.

    Raises
    ------
    MuflyError
        If there is no C compiler, or the law has no bounds.
    """

    def __init__(self, design: FlightController, law: FixedPointLaw | None = None, *, cc: str | None = None) -> None:
        super().__init__(design)
        self.law = law or quantise_law(design)
        self._ffi, self._lib = _load_fixed_library(render_fixed_point_tables(design, self.law), cc or find_compiler())
        new = self._ffi.new
        self._gains_record = self._ffi.addressof(
            self._lib.mufly_fixed_gains
        )  # the exported tables, until a gain is changed
        self._state_record, self._motion_record = new("fixed_controllers_t *"), new("fixed_motion_t *")
        self._path_record, self._actuators_record = new("fixed_path_t *"), new("fixed_actuators_t *")
        self._tilt_buffer = new("int32_t[2]")

    @property
    def overflow_count(self) -> int:
        """Return the number of 32-bit overflows so far; zero by the proof."""
        return int(self._state_record.overflows)

    def _blend_gains(self) -> None:
        super()._blend_gains()
        self._gains_record = self._ffi.new("fixed_gains_t *", fixed_point_gains(self._design, self.law))

    def _write_motion(self, m: Estimate) -> None:
        now = self._motion_record
        now.position, now.velocity, now.attitude = (to_signals(v) for v in (m.position, m.velocity, m.attitude))
        now.rates, now.voltage = to_signals(m.rates), to_signal(m.battery_voltage)

    def engage(self, estimate: Estimate, motor_input: _Array) -> None:
        self._write_motion(estimate)
        self._lib.fixed_engage(self._gains_record, self._state_record, self._motion_record, to_signals(motor_input))

    def lift_off(self, estimate: Estimate) -> None:
        self._write_motion(estimate)
        self._lib.fixed_lift_off(self._gains_record, self._state_record, self._motion_record)

    def tilt_for(self, estimate: Estimate, position: _Array, velocity: _Array, acceleration: _Array) -> _Array:
        self._write_motion(estimate)
        path = self._path_record
        path.position, path.velocity = to_signals(position), to_signals(velocity)
        path.acceleration = to_signals(acceleration)
        self._lib.fixed_tilt_for(self._gains_record, self._state_record, self._motion_record, path, self._tilt_buffer)
        return np.array(list(self._tilt_buffer)) / SIGNAL_ONE

    def step(self, estimate: Estimate, heave_yaw: _Array, tilt: _Array | None) -> Actuators:
        if not self._settled:
            self._blend_gains()
        self._write_motion(estimate)
        self._lib.fixed_step(
            self._gains_record, self._state_record, self._motion_record, to_signals(heave_yaw), tilt is not None,
            [0, 0] if tilt is None else to_signals(tilt), self._actuators_record,
        )  # fmt: skip
        return Actuators(
            np.array(list(self._actuators_record.motor_input)) / SIGNAL_ONE,
            np.array(list(self._actuators_record.servo_input)) / SIGNAL_ONE,
        )
