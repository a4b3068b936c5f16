"""The law in whole numbers: the readable reference of ``fixed/fixed_law.c``, equal to it bit by bit, and both flown.

Python's whole numbers have no end, so here nothing can overflow: a number that would not fit C's 32 or 64 bits raises.
What a coefficient, a row and a bound is: :mod:`mufly.firmware.fixed`. What the law does: :mod:`mufly.control.law`.
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

from mufly.control import FlightController
from mufly.errors import InputError
from mufly.estimate import Estimate
from mufly.firmware.fixed import ERRORS, FRACTION, FixedLaw, Rows, fixed_law
from mufly.firmware.host import build, declarations
from mufly.firmware.tables import comment, copy_fixed
from mufly.flight.controllers import Actuators, Controllers
from mufly.toolchain import compiler
from mufly.version import __version__

_Array = NDArray[np.floating[Any]]
_Table = dict[str, Any]

ONE, UNIT = 1 << FRACTION, 1 << 30
_GREAT, _MOST_FEEDFORWARD = 1 << 30, 64 << 20
_TWO_OVER_PI, _PI_HALF = 683565276, 1727108826179
_INT32 = (-(1 << 31), (1 << 31) - 1)


# ----------------------------------------------------------------------------
# The tables: what C's structs of fixed_law.h hold, under the same names.


def tables(controller: FlightController, law: FixedLaw) -> _Table:
    """Whole numbers of a vehicle's controllers, named as the fields of ``fixed_gains_t``.

    Raises
    ------
    InputError
        If a number does not fit: the rate is below 33 Hz.
    """
    h, r, p = controller.heave_yaw_gains, controller.roll_pitch_gains, controller.position_gains
    if float(h["period"]) >= 2.0**-5:
        raise InputError(
            "rate_Hz", f"{controller.rate_Hz:g}", "is too slow for whole numbers", "give 33 Hz or more"
        )
    found = {
        "heave_yaw": {
            **_rows(law.heave_yaw.update, law.heave_yaw.output, law.heave_yaw.start),
            "kept": int(law.heave_yaw.delta), "limit": _limits("heave_yaw"), "trim": [_bits(v) for v in h["trim"]],
            "height": _shape(h, "heave", "speed"), "heading": _shape(h, "yaw", "rate"),
            "slack": _bits(h["heave_slack"]), "period": _bits(h["period"], 36),
            "design_voltage": _bits(h["design_voltage"]), "per_volt": _bits(1.0 / h["design_voltage"], 30),
            "voltage_blend": _bits(h["voltage_blend"], 30),
        },
        "roll_pitch": {
            **_rows(law.roll_pitch.update, law.roll_pitch.output, law.roll_pitch.start),
            "kept": int(law.roll_pitch.delta), "limit": _limits("roll_pitch"),
            "trim": [_bits(v) for v in r["trim"]], "tilt_limit": _bits(r["tilt_limit"]),
        },
        "position": {
            **_rows(law.position.update, law.position.output, None),
            "kept": int(law.position.delta), "limit": _limits("position"),
            "position_gain": _bits(p["position_gain"]), "speed_limit": _bits(p["speed_limit"]),
            "tilt_limit": _bits(p["tilt_limit"]), "per_gravity": _bits(1.0 / p["gravity"], 30),
        },
    }  # fmt: skip
    return found


def _bits(value: float, fraction: int = FRACTION) -> int:
    whole = round(float(value) * (1 << fraction))
    if not _INT32[0] <= whole <= _INT32[1]:
        raise InputError("fixed point", f"{float(value):g}", "does not fit 32 bits", "use a floating unit")
    return whole


def _limits(name: str) -> list[int]:
    return [_bits(v) for v in ERRORS[name]]


def _shape(h: np.void, axis: str, speed: str) -> _Table:
    bandwidth, acceleration = float(h[f"{axis}_bandwidth"]), float(h[f"{axis}_acceleration"])
    return {
        "slope": _bits(0.5 * bandwidth), "bandwidth": _bits(2.0 * bandwidth), "braking": _bits(acceleration),
        "linear": _bits(2.0 * acceleration / bandwidth**2), "acceleration": _bits(acceleration, 24),
        "speed": _bits(h[f"{axis}_{speed}"]), "lead": _bits(h[f"{axis}_lead"]),
    }  # fmt: skip


def _rows(update: Rows, output: Rows, start: Rows | None) -> _Table:
    found: _Table = {}
    for name, rows in (("update", update), ("output", output), ("start", start)):
        if rows is not None:
            found[name] = [
                [{"c": int(c), "up": int(up)} for c, up in zip(*pair, strict=True)]
                for pair in zip(rows.c, rows.up, strict=True)
            ]
            found[f"{name}_down"] = [int(d) for d in rows.down]
    return found


def tables_fixed_c(controller: FlightController, law: FixedLaw) -> str:
    """Return ``tables_fixed.c``: every whole number of a vehicle's controllers, and their bounds in a comment."""
    lines = [
        f"/* Whole numbers of {comment(controller.vehicle_name)}, made by mufly {__version__}; do not edit.",
        " *",
    ]
    for made in law.controllers:
        proof = made.proof
        lines.append(
            f" * {made.name}: {made.form}; bits behind the point of the states {', '.join(map(str, made.fractions))}."
        )
        lines.append(
            f" *   Whatever comes, states stay below {proof.states.max():.2f} of 32 bits, sums below "
            f"{proof.sums.max():.2f} of 64."
        )
    lines += [
        " */", '#include "fixed_law.h"', "", f"const int32_t mufly_fixed_rate_Hz = {round(controller.rate_Hz)};",
        f"const int32_t mufly_fixed_position_divider = {controller.position_divider};", "",
        f"const fixed_gains_t mufly_fixed_gains = {_c(tables(controller, law), 0)};", "",
    ]  # fmt: skip
    return "\n".join(lines)


def _c(value: Any, depth: int) -> str:
    """A whole number, list or table as an initialiser of C."""
    pad = "    " * (depth + 1)
    if isinstance(value, Mapping):
        if set(value) == {"c", "up"}:
            return f"{{{value['c']}, {value['up']}U}}"
        inside = ",\n".join(f"{pad}.{k} = {_c(v, depth + 1)}" for k, v in value.items())
        return f"{{\n{inside},\n{'    ' * depth}}}"
    if isinstance(value, Sequence):
        if value and isinstance(value[0], list):
            return "{\n" + ",\n".join(f"{pad}{_c(v, depth + 1)}" for v in value) + f",\n{'    ' * depth}}}"
        return "{" + ", ".join(_c(v, depth + 1) for v in value) + "}"
    return str(value)


def export_fixed(controller: FlightController, out: Path) -> FixedLaw:
    """Write ``fixed/`` into an exported tree: the law in whole numbers, with its tables, and return them."""
    law = fixed_law(controller)
    copy_fixed(out)
    (out / "fixed" / "tables_fixed.c").write_text(tables_fixed_c(controller, law), encoding="utf-8")
    return law


# ----------------------------------------------------------------------------
# The law.


def _rounded(value: int, bits: int) -> int:
    assert -(1 << 63) < value < 1 << 63, "a sum that 64 bits do not hold"
    if bits == 0:
        return value
    half = 1 << (bits - 1)
    return (value + half) >> bits if value >= 0 else -((-value + half) >> bits)


def _times(a: int, b: int, bits: int) -> int:
    return _rounded(a * b, bits)


def _clip(value: int, low: int, high: int) -> int:
    return low if value < low else high if value > high else value


def _held(value: int, limit: int) -> int:
    return _clip(value, -limit, limit)


def _over(a: int, b: int) -> int:
    """Quotient, what is left dropped: C's division."""
    return a // b if (a >= 0) == (b > 0) else -(-a // b)


def sine_cosine_fixed(angle: int) -> tuple[int, int]:
    """Sine and cosine (2^-30) of an angle (2^-20 rad)."""
    n = _times(angle, _TWO_OVER_PI, 50)
    r = _rounded(angle * ONE - n * _PI_HALF, 10)
    q = _times(r, r, 30)
    s, c = 2959, -296
    for k in (-213044, 8947849, -178956971):
        s = k + _times(q, s, 30)
    s = r + _times(r, _times(q, s, 30), 30)
    for k in (26631, -1491308, 44739243, -536870912, UNIT):
        c = k + _times(q, c, 30)
    return ((s, c), (c, -s), (-s, -c), (-c, s))[n % 4]


class FixedControllers(Controllers):
    """:class:`mufly.flight.controllers.Controllers` in whole numbers, computed by Python.

    Parameters
    ----------
    design : FlightController
    law : FixedLaw, optional
        Its numbers, where they are there already.

    Attributes
    ----------
    overflows : int
        Numbers that did not fit 32 bits so far; none, by the proof.
    """

    def __init__(self, design: FlightController, law: FixedLaw | None = None) -> None:
        super().__init__(design)
        self.law = law or fixed_law(design)
        self._g = tables(design, self.law)
        self._x: dict[str, list[int]] = {
            name: [0] * len(c.fractions) for name, c in zip(self._g, self.law.controllers, strict=True)
        }
        self._shaped = {"height": [0, 0], "heading": [0, 0]}
        self._origin = [0, 0]
        self._voltage = 0
        self._overflows = 0

    @property
    def overflows(self) -> int:
        """Numbers that did not fit 32 bits so far; none, by the proof."""
        return self._overflows

    def _go_over(self) -> None:
        super()._go_over()
        self._g = tables(self._design, self.law)

    def _narrow(self, value: int) -> int:
        held = _clip(value, *_INT32)
        self._overflows += held != value
        return held

    def _row(self, row: list[dict[str, int]], by: list[int], down: int) -> int:
        total = 0
        for a, w in zip(row, by, strict=True):
            if a["c"]:
                total += (a["c"] * w) << a["up"]
        return _rounded(total, down)

    def _advance(self, name: str, w: list[int]) -> None:
        g = self._g[name]
        self._x[name] = [
            self._narrow(g["kept"] * w[i] + self._row(row, w, down))
            for i, (row, down) in enumerate(zip(g["update"], g["update_down"], strict=True))
        ]

    def _begin(self, name: str, w: list[int]) -> None:
        g = self._g[name]
        self._x[name] = [
            self._narrow(self._row(row, w, down))
            for row, down in zip(g["start"], g["start_down"], strict=True)
        ]

    def _output(self, name: str, w: list[int]) -> list[int]:
        g = self._g[name]
        return [self._row(row, w, down) for row, down in zip(g["output"], g["output_down"], strict=True)]

    def _believed(self, voltage: int) -> int:
        design = self._g["heave_yaw"]["design_voltage"]
        return 16 * _clip(voltage, design // 2, design + design // 2)

    def engage(self, estimate: Estimate, motor_input: _Array) -> None:
        h, (_, z), (_, psi), r, volts = self._g["heave_yaw"], *_seen(estimate)
        self._voltage = self._believed(volts)
        w = [0, 0, 0, 0, _held(-r[2], h["limit"][4])]
        motors = [signal(v) for v in motor_input]
        for i in range(2):
            share = _times(_clip(motors[1 - i], 0, ONE), self._voltage, FRACTION)
            w.append(_times(share, h["per_volt"], 34) - h["trim"][i])
        self._begin("heave_yaw", w)
        self._origin = [z, psi]
        self._shaped = {"height": [z * ONE, 0], "heading": [psi * ONE, 0]}

    def lift_off(self, estimate: Estimate) -> None:
        limits = self._g["roll_pitch"]["limit"]
        measured = _roll_pitch(estimate)
        self._begin("roll_pitch", [*(_held(-v, n) for v, n in zip(measured, limits, strict=True)), 0, 0])
        self._x["position"] = [0] * len(self._x["position"])

    def _shape(self, name: str, target: int, target_rate: int) -> int:
        """Advance a reference filter; what it leads to."""
        g, period = self._g["heave_yaw"][name], self._g["heave_yaw"]["period"]
        value, rate = self._shaped[name]
        gap = target - _rounded(value, 20)
        wanted = _times(g["slope"], gap, FRACTION)
        if abs(gap) > g["linear"]:
            root = math.isqrt(max(0, g["braking"] * (abs(gap) - g["linear"] // 2)))
            wanted = -root if gap < 0 else root
        wanted = 16 * _held(wanted + target_rate, g["speed"])
        gained = _held(_times(g["bandwidth"], wanted - rate, FRACTION), g["acceleration"])
        rate = self._narrow(rate + _times(period, gained, 36))
        value += _times(period, rate, 20)
        self._shaped[name] = [value, rate]
        felt = _rounded(rate, 4)
        felt = _clip(felt, 0, target_rate) if target_rate > 0 else _clip(felt, target_rate, 0)
        return _rounded(value, 20) + _times(g["lead"], felt, FRACTION)

    def _heave_yaw_step(self, estimate: Estimate, reference: list[int]) -> list[int]:
        h, (_, z), (_, psi), rates, volts = self._g["heave_yaw"], *_seen(estimate)
        led = (
            self._shape("height", reference[0], reference[2]),
            self._shape("heading", reference[1], reference[3]),
        )
        self._voltage += _times(h["voltage_blend"], self._believed(volts) - self._voltage, 30)
        top = _times(self._voltage, h["per_volt"], 34)
        origin_z, origin_psi = self._origin
        errors = (led[0] - origin_z, led[1] - origin_psi, origin_z - z, origin_psi - psi, -rates[2])
        w = [*self._x["heave_yaw"], *(_held(v, n) for v, n in zip(errors, h["limit"], strict=True))]
        u = [v + t for v, t in zip(self._output("heave_yaw", w), h["trim"], strict=True)]
        most = _held(u[1] - u[0], top)
        total = _clip(u[1] + u[0], abs(most), 2 * top - abs(most))
        lower, upper = (total - most) // 2, (total + most) // 2
        w += [self._narrow(_rounded(lower - u[0], 4)), self._narrow(_rounded(upper - u[1], 4))]
        self._advance("heave_yaw", w)
        return [_clip(_over(v * ONE, top), 0, ONE) for v in (upper, lower)]

    def _roll_pitch_step(self, estimate: Estimate, tilt: list[int]) -> list[int]:
        g, measured = self._g["roll_pitch"], _roll_pitch(estimate)
        errors = [_held(tilt[i], g["tilt_limit"]) - measured[i] for i in range(2)] + [
            -v for v in measured[2:]
        ]
        w = [*self._x["roll_pitch"], *(_held(v, n) for v, n in zip(errors, g["limit"], strict=True))]
        wanted = [v + t for v, t in zip(self._output("roll_pitch", w), g["trim"], strict=True)]
        servos = [_held(v, ONE) for v in wanted]
        w += [self._narrow(_rounded(s - v, 4)) for s, v in zip(servos, wanted, strict=True)]
        self._advance("roll_pitch", w)
        return servos

    def tilt_for(
        self, estimate: Estimate, position: _Array, velocity: _Array, acceleration: _Array
    ) -> _Array:
        g = self._g["position"]
        here, speed = signals(estimate.position), signals(estimate.velocity)
        to, going, pushed = signals(position), signals(velocity), signals(acceleration)
        wanted = [
            _held(going[i] + _times(g["position_gain"], to[i] - here[i], FRACTION), _GREAT) for i in range(2)
        ]
        wanted = _shortened(wanted, g["speed_limit"])
        w = [*self._x["position"], *(_held(wanted[i] - speed[i], g["limit"][i]) for i in range(2))]
        a = [_held(pushed[1 - i], _MOST_FEEDFORWARD) for i in range(2)]
        lean = [_times(a[0], g["per_gravity"], 30), _times(-a[1], g["per_gravity"], 30)]
        asked = [v + more for v, more in zip(self._output("position", w), lean, strict=True)]
        given = _shortened([_held(v, _GREAT) for v in asked], g["tilt_limit"])
        w += [self._narrow(_rounded(v - u, 4)) for v, u in zip(given, asked, strict=True)]
        sine, cosine = sine_cosine_fixed(signal(estimate.attitude[2]))
        tilt = (
            _rounded(cosine * given[0] + sine * given[1], 30), _rounded(cosine * given[1] - sine * given[0], 30)
        )  # fmt: skip
        self._advance("position", w)
        return np.array(tilt) / ONE

    def step(self, estimate: Estimate, heave_yaw: _Array, tilt: _Array | None) -> Actuators:
        if not self._settled:
            self._go_over()
        servos = [0, 0]
        if tilt is not None:
            self._heave_wait(signal(estimate.position[2]))
            servos = self._roll_pitch_step(estimate, signals(tilt))
        motors = self._heave_yaw_step(estimate, signals(heave_yaw))
        return Actuators(np.array(motors) / ONE, np.array(servos) / ONE)

    def _heave_wait(self, z: int) -> None:
        g, (value, rate) = self._g["heave_yaw"], self._shaped["height"]
        slack, brake = g["slack"], 2 * _times(g["period"], g["height"]["acceleration"], 36)
        trails = z - _rounded(value, 20)
        left = slack - abs(trails)
        fastest = 16 * (g["height"]["speed"] * max(left, 0) // slack)
        less = _clip((rate if trails < 0 else -rate) - fastest, 0, brake)
        if left < 0:
            value = ONE * (z + slack if trails < 0 else z - slack)
        self._shaped["height"] = [value, rate + (-less if trails < 0 else less)]


def _shortened(v: list[int], limit: int) -> list[int]:
    length = math.isqrt(v[0] * v[0] + v[1] * v[1])
    return [_over(a * limit, length) for a in v] if length > limit else v


def signal(value: float) -> int:
    """A number as a signal: 2^-20, within 32 bits, to the nearest."""
    return _clip(round(float(value) * ONE), *_INT32)


def signals(values: _Array) -> list[int]:
    """Numbers as signals."""
    return [signal(v) for v in values]


def _seen(m: Estimate) -> tuple[tuple[int, int], tuple[int, int], list[int], int]:
    return (0, signal(m.position[2])), (0, signal(m.attitude[2])), signals(m.rates), signal(m.battery_voltage)


def _roll_pitch(m: Estimate) -> list[int]:
    return [signal(m.attitude[0]), signal(m.attitude[1]), signal(m.rates[0]), signal(m.rates[1])]


# ----------------------------------------------------------------------------
# The C code.


@functools.lru_cache(maxsize=8)
def _loaded(text: str, cc: str) -> tuple[cffi.FFI, Any]:
    ffi = cffi.FFI()
    with tempfile.TemporaryDirectory(prefix="mufly-fixed-") as folder:
        tree = Path(folder) / "fw"
        copy_fixed(tree)
        (tree / "fixed" / "tables_fixed.c").write_text(text, encoding="utf-8")
        library = build(tree / "fixed", cc=cc)
        ffi.cdef(declarations(tree / "fixed"))
        return ffi, ffi.dlopen(str(library))


class FixedFirmwareControllers(Controllers):
    """:class:`FixedControllers`, computed by the exported C code with its own tables.

    What :class:`mufly.flight.Flight` takes as ``controllers``.

    Raises
    ------
    MuflyError
        If there is no C compiler, or the law has no bounds.
    """

    def __init__(
        self, design: FlightController, law: FixedLaw | None = None, *, cc: str | None = None
    ) -> None:
        super().__init__(design)
        self.law = law or fixed_law(design)
        self._ffi, self._lib = _loaded(tables_fixed_c(design, self.law), cc or compiler())
        new = self._ffi.new
        self._g = self._ffi.addressof(self._lib.mufly_fixed_gains)  # its tables, until something is tuned
        self._c, self._now = new("fixed_controllers_t *"), new("fixed_motion_t *")
        self._path, self._out = new("fixed_path_t *"), new("fixed_actuators_t *")
        self._two = new("int32_t[2]")

    @property
    def overflows(self) -> int:
        """Numbers that did not fit 32 bits so far; none, by the proof."""
        return int(self._c.overflows)

    def _go_over(self) -> None:
        super()._go_over()
        self._g = self._ffi.new("fixed_gains_t *", tables(self._design, self.law))

    def _look(self, m: Estimate) -> None:
        now = self._now
        now.position, now.velocity, now.attitude = (signals(v) for v in (m.position, m.velocity, m.attitude))
        now.rates, now.voltage = signals(m.rates), signal(m.battery_voltage)

    def engage(self, estimate: Estimate, motor_input: _Array) -> None:
        self._look(estimate)
        self._lib.fixed_engage(self._g, self._c, self._now, signals(motor_input))

    def lift_off(self, estimate: Estimate) -> None:
        self._look(estimate)
        self._lib.fixed_lift_off(self._g, self._c, self._now)

    def tilt_for(
        self, estimate: Estimate, position: _Array, velocity: _Array, acceleration: _Array
    ) -> _Array:
        self._look(estimate)
        path = self._path
        path.position, path.velocity = signals(position), signals(velocity)
        path.acceleration = signals(acceleration)
        self._lib.fixed_tilt(self._g, self._c, self._now, path, self._two)
        return np.array(list(self._two)) / ONE

    def step(self, estimate: Estimate, heave_yaw: _Array, tilt: _Array | None) -> Actuators:
        if not self._settled:
            self._go_over()
        self._look(estimate)
        self._lib.fixed_step(
            self._g, self._c, self._now, signals(heave_yaw), tilt is not None,
            [0, 0] if tilt is None else signals(tilt), self._out,
        )  # fmt: skip
        return Actuators(
            np.array(list(self._out.motor_input)) / ONE, np.array(list(self._out.servo_input)) / ONE
        )
