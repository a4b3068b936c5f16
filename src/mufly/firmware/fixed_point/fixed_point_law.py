"""Tables of the fixed-point control law, and Python controllers that call its exported C code (``fixed_point_law.c``).

:mod:`mufly.firmware.fixed_point.fixed_point_design` defines coefficients, rows and bounds; :mod:`mufly.control.law`
defines the law. Its reference in Python, equal bit for bit, is ``tests/firmware/fixed_law_reference.py``.
"""

from __future__ import annotations

import functools
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
from mufly.firmware.export.source_export import (
    FIXED_POINT_SOURCES,
    FIXED_POINT_TABLES_PATH,
    copy_fixed_point_sources,
    escape_comment,
)
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

FIXED_POINT_ONE = 1 << FRACTION_BITS
_INT32_RANGE = (-(1 << 31), (1 << 31) - 1)


# ----------------------------------------------------------------------------
# Tables with the fields of the C structs in fixed_point_law.h.


def fixed_point_gains(controller: FlightController, law: FixedPointLaw) -> _GainsTable:
    """Return the integers of a vehicle's controllers by the fields of ``fixed_gains_t``.

    Raises
    ------
    InputError
        If the rate is below 33 Hz, or a number exceeds 32 bits.
    """
    h, r, p = controller.heave_yaw_gains, controller.roll_pitch_gains, controller.position_gains
    if float(h["period"]) >= 2.0**-5:
        raise InputError(
            "rate_Hz", f"{controller.rate_Hz:g}", "is too low for the fixed-point law", "give 33 Hz or more"
        )
    found = {
        "heave_yaw": {
            **_coefficient_table(law.heave_yaw.update_rows, law.heave_yaw.output_rows, law.heave_yaw.start_rows),
            "kept": int(law.heave_yaw.is_delta_form),
            "limit": _error_limits("heave_yaw"),
            "trim": [_to_fixed_point(v) for v in h["trim"]],
            "height": _reference_filter_gains(h, "heave", "speed"),
            "heading": _reference_filter_gains(h, "yaw", "rate"),
            "slack": _to_fixed_point(h["heave_tracking_error_limit"]),
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
            f" *   Whatever comes, states stay below {proof.state_bound_shares.max():.2f} of 32 bits, sums below "
            f"{proof.sum_bound_shares.max():.2f} of 64."
        )
    lines += [
        " */", '#include "fixed_point/fixed_point_law.h"', "",
        f"const int32_t mufly_fixed_rate_Hz = {round(controller.rate_Hz)};",
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
    """Write the fixed-point law with its tables into ``fixed_point/`` of an exported tree, and return the law."""
    law = quantise_law(controller)
    copy_fixed_point_sources(out)
    (out / FIXED_POINT_TABLES_PATH).write_text(render_fixed_point_tables(controller, law), encoding="utf-8")
    return law


# ----------------------------------------------------------------------------
# The C code.


@functools.lru_cache(maxsize=8)
def _load_fixed_point_library(text: str, cc: str) -> tuple[cffi.FFI, Any]:
    ffi = cffi.FFI()
    with tempfile.TemporaryDirectory(prefix="mufly-fixed-") as folder:
        tree = Path(folder) / "fw"
        copy_fixed_point_sources(tree)
        (tree / FIXED_POINT_TABLES_PATH).write_text(text, encoding="utf-8")
        library = build_library(tree, cc=cc, patterns=FIXED_POINT_SOURCES)
        ffi.cdef(cffi_declarations(tree, patterns=FIXED_POINT_SOURCES))
        return ffi, ffi.dlopen(str(library))


def to_fixed_point_signal(value: float) -> int:
    """Return a number in the fixed-point format of signals: in units of 2^-20, rounded and saturated at 32 bits."""
    return min(max(round(float(value) * FIXED_POINT_ONE), _INT32_RANGE[0]), _INT32_RANGE[1])


def to_fixed_point_signals(values: _Array) -> list[int]:
    """Return the numbers of an array in the fixed-point format of signals (:func:`to_fixed_point_signal`)."""
    return [to_fixed_point_signal(v) for v in values]


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
        self._ffi, self._lib = _load_fixed_point_library(
            render_fixed_point_tables(design, self.law), cc or find_compiler()
        )
        new = self._ffi.new
        self._gains_record = self._ffi.addressof(
            self._lib.mufly_fixed_gains
        )  # the exported tables, until a gain is changed
        self._state_record, self._motion_record = new("fixed_controllers_t *"), new("fixed_motion_t *")
        self._path_record, self._actuators_record = new("fixed_path_t *"), new("fixed_actuators_t *")
        self._tilt_buffer = new("int32_t[2]")

    @property
    def overflow_count(self) -> int:
        """Return the number of 32-bit overflows so far; :class:`OverflowProof` guarantees zero."""
        return int(self._state_record.overflows)

    def _blend_gains(self) -> None:
        super()._blend_gains()
        self._gains_record = self._ffi.new("fixed_gains_t *", fixed_point_gains(self._design, self.law))

    def _write_motion(self, m: Estimate) -> None:
        now = self._motion_record
        now.position, now.velocity, now.attitude = (
            to_fixed_point_signals(v) for v in (m.position, m.velocity, m.attitude)
        )
        now.rates, now.voltage = to_fixed_point_signals(m.rates), to_fixed_point_signal(m.battery_voltage)

    def engage_heave_yaw(self, estimate: Estimate, motor_input: _Array) -> None:
        self._write_motion(estimate)
        self._lib.fixed_engage_heave_yaw(
            self._gains_record, self._state_record, self._motion_record, to_fixed_point_signals(motor_input)
        )

    def engage_roll_pitch(self, estimate: Estimate) -> None:
        self._write_motion(estimate)
        self._lib.fixed_engage_roll_pitch(self._gains_record, self._state_record, self._motion_record)

    def compute_tilt_command(
        self, estimate: Estimate, position: _Array, velocity: _Array, acceleration: _Array
    ) -> _Array:
        self._write_motion(estimate)
        path = self._path_record
        path.position, path.velocity = to_fixed_point_signals(position), to_fixed_point_signals(velocity)
        path.acceleration = to_fixed_point_signals(acceleration)
        self._lib.fixed_compute_tilt_command(
            self._gains_record, self._state_record, self._motion_record, path, self._tilt_buffer
        )
        return np.array(list(self._tilt_buffer)) / FIXED_POINT_ONE

    def step(self, estimate: Estimate, heave_yaw: _Array, tilt: _Array | None) -> Actuators:
        if not self._settled:
            self._blend_gains()
        self._write_motion(estimate)
        self._lib.fixed_step(
            self._gains_record,
            self._state_record,
            self._motion_record,
            to_fixed_point_signals(heave_yaw),
            tilt is not None,
            [0, 0] if tilt is None else to_fixed_point_signals(tilt),
            self._actuators_record,
        )
        return Actuators(
            np.array(list(self._actuators_record.motor_input)) / FIXED_POINT_ONE,
            np.array(list(self._actuators_record.servo_input)) / FIXED_POINT_ONE,
        )
