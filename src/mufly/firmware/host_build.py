"""Build the exported code with this machine's C compiler and call it through cffi."""

from __future__ import annotations

import functools
import subprocess
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import cffi
import numpy as np
from numpy.typing import NDArray

from mufly.compiled.toolchain import COMPILER_FLAGS, build_cached_library, compile_library, find_compiler
from mufly.control import FlightController
from mufly.estimate import Estimate
from mufly.files.answer_store import replace_file_atomically
from mufly.firmware.export.plan_tables import HOST_MAX_WAYPOINTS, MAX_WAYPOINTS
from mufly.firmware.export.source_export import (
    SCHEDULE_HEADER_PATH,
    SOFTWARE_SOURCES,
    copy_sources,
    find_sources,
    render_enabled_schedule_header,
    render_gains_files,
    write_source_tree,
)
from mufly.flight.controllers import Actuators, Controllers

_Array = NDArray[np.floating[Any]]


def build_library(
    folder: Path,
    *,
    single: bool = False,
    flags: tuple[str, ...] = COMPILER_FLAGS,
    cc: str | None = None,
    patterns: Sequence[str] = SOFTWARE_SOURCES,
) -> Path:
    """Build the sources of an exported tree that match the patterns as a shared library and return it.

    Raises
    ------
    MuflyError
        If there is no compiler, or compilation fails; the message contains the first error.
    """
    library = folder / ("mufly_single.so" if single else "mufly.so")
    extra = ("-DMUFLY_FLOAT",) if single else ()
    compile_library(find_sources(folder, patterns), library, flags=(*flags, *extra, f"-I{folder}"), cc=cc)
    return library


def read_sources(tree: Path, patterns: Sequence[str] = SOFTWARE_SOURCES) -> dict[str, str]:
    """Return the text of the sources that match the patterns and of the headers beside them, by path in the tree."""
    both = [pattern.removesuffix("c") + suffix for pattern in patterns for suffix in "ch"]
    return {str(path.relative_to(tree)): path.read_text(encoding="utf-8") for path in find_sources(tree, both)}


def cffi_declarations(folder: Path, single: bool = False, patterns: Sequence[str] = SOFTWARE_SOURCES) -> str:
    """Return the declarations, for cffi, of the headers beside the sources that match the patterns."""
    command = [find_compiler(), "-E", "-P", "-DMUFLY_DECLARATIONS", *(("-DMUFLY_FLOAT",) if single else ())]
    found = find_sources(folder, [pattern.removesuffix("c") + "h" for pattern in patterns])
    headers = "".join(f'#include "{header.relative_to(folder)}"\n' for header in found)
    done = subprocess.run(
        [*command, f"-I{folder}", "-x", "c", "-"], input=headers, capture_output=True, text=True, check=True
    )
    return done.stdout.replace("extern const ", "extern ")  # cffi gives no address of a constant


def _raise_waypoint_capacity(folder: Path) -> None:
    """Give the sources in a folder room for :data:`HOST_MAX_WAYPOINTS` waypoints: memory is scarce on boards only."""
    header = folder / "mission/machine/mission_state.h"
    board = f"#define MISSION_WAYPOINTS {MAX_WAYPOINTS} "
    text = header.read_text(encoding="utf-8")
    assert board in text
    header.write_text(text.replace(board, f"#define MISSION_WAYPOINTS {HOST_MAX_WAYPOINTS} "), encoding="utf-8")


@functools.lru_cache(maxsize=8)
def _load_firmware(gains: tuple[tuple[str, str], ...], single: bool, cc: str) -> tuple[cffi.FFI, Any]:
    ffi = cffi.FFI()
    with tempfile.TemporaryDirectory(prefix="mufly-firmware-") as folder:
        tree = Path(folder) / "fw"
        write_source_tree(dict(gains), tree)
        _raise_waypoint_capacity(tree)
        library = build_library(tree, single=single, cc=cc)
        ffi.cdef(cffi_declarations(tree, single))
        return ffi, ffi.dlopen(str(library))


@functools.lru_cache(maxsize=1)
def _load_generic_firmware() -> tuple[cffi.FFI, Any]:
    """Return the code without a vehicle's gains, in double precision, cached on disk; callers pass the gains."""
    with tempfile.TemporaryDirectory(prefix="mufly-firmware-") as folder:
        tree = Path(folder) / "fw"
        copy_sources(tree)
        (tree / SCHEDULE_HEADER_PATH).write_text(render_enabled_schedule_header(), encoding="utf-8")
        _raise_waypoint_capacity(tree)
        files = read_sources(tree)
        library = build_cached_library("firmware", {**files, "tables.c": _GENERIC_GAINS_SOURCE})
        words = library.with_suffix(".h")
        if not words.exists():
            with replace_file_atomically(words) as made:
                made.write_text(cffi_declarations(tree), encoding="utf-8")
    ffi = cffi.FFI()
    ffi.cdef(words.read_text(encoding="utf-8"))
    return ffi, ffi.dlopen(str(library))


_GENERIC_GAINS_SOURCE = """#include "flight/controllers.h"
const int32_t mufly_rate_Hz = 0;
const int32_t mufly_position_divider = 0;
const gains_t mufly_gains;
"""


class Firmware:
    """The exported code of one vehicle, built and loaded; equal code is built once per process.

    Parameters
    ----------
    controller : FlightController or None
        From :func:`mufly.control.design_flight_controller`. None: code without gains, built once for all vehicles.
    single : bool
        Whether to build in single precision.
    cc : str, optional
        Compiler; by default that of :func:`find_compiler`.

    Raises
    ------
    MuflyError
        If there is no C compiler.
    """

    def __init__(self, controller: FlightController | None, *, single: bool = False, cc: str | None = None) -> None:
        self.real_dtype = np.dtype(np.float32 if single else np.float64)
        self.is_generic = controller is None
        if controller is None:
            self.ffi, self.lib = _load_generic_firmware()
        else:
            self.ffi, self.lib = _load_firmware(
                tuple(render_gains_files(controller).items()), single, cc or find_compiler()
            )

    def make_gains(self, controller: FlightController) -> Any:
        """Return a ``gains_t`` with the gains of a controller, which may differ from the exported one."""
        g = self.ffi.new("gains_t *")
        for group in ("heave_yaw", "roll_pitch", "position"):
            record = getattr(controller, f"{group}_gains")
            numbers = np.frombuffer(record.tobytes(), dtype=np.float64).astype(self.real_dtype)
            # Code without a schedule has no room for the last fields of roll-pitch.
            size = min(numbers.nbytes, self.ffi.sizeof(getattr(g, group)))
            self.ffi.memmove(self.ffi.addressof(g, group), numbers.tobytes(), size)
        return g


class FirmwareControllers(Controllers):
    """A :class:`mufly.flight.controllers.Controllers` computed by the exported code with its own tables.

    The class can be passed to :class:`mufly.flight.Flight` as ``controllers``.
    """

    def __init__(self, design: FlightController, firmware: Firmware | None = None) -> None:
        super().__init__(design)
        f = self.firmware = firmware or Firmware(design)
        # The exported tables, until a gain is changed
        self._gains_record = f.make_gains(design) if f.is_generic else f.ffi.addressof(f.lib.mufly_gains)
        self._state_record, self._motion_record = f.ffi.new("controllers_t *"), f.ffi.new("motion_estimate_t *")
        self._path_record, self._actuators_record = f.ffi.new("path_t *"), f.ffi.new("actuators_t *")
        self._tilt_buffer, self._motor_buffer = f.ffi.new("real_t[2]"), f.ffi.new("real_t[4]")
        f.lib.position_init(f.ffi.addressof(self._state_record, "position"))

    def _blend_gains(self) -> None:
        super()._blend_gains()
        self._gains_record = self.firmware.make_gains(self._design)

    def advance_gains(self) -> Any:
        """Return the ``gains_t`` for the next period; after a change of gains, one step nearer to the new ones."""
        if not self._settled:
            self._blend_gains()
        return self._gains_record

    def _write_motion(self, m: Estimate) -> None:
        now = self._motion_record
        now.position, now.velocity = m.position.tolist(), m.velocity.tolist()
        now.attitude, now.rates, now.voltage = m.attitude.tolist(), m.rates.tolist(), m.battery_voltage

    def engage_heave_yaw(self, estimate: Estimate, motor_input: _Array) -> None:
        self._write_motion(estimate)
        self.firmware.lib.controllers_engage_heave_yaw(
            self._gains_record, self._state_record, self._motion_record, motor_input.tolist()
        )

    def engage_roll_pitch(self, estimate: Estimate) -> None:
        self._write_motion(estimate)
        self.firmware.lib.controllers_engage_roll_pitch(self._gains_record, self._state_record, self._motion_record)

    def compute_tilt_command(
        self, estimate: Estimate, position: _Array, velocity: _Array, acceleration: _Array
    ) -> _Array:
        self._write_motion(estimate)
        path = self._path_record
        path.position, path.velocity = position.tolist(), velocity.tolist()
        path.acceleration = acceleration.tolist()
        self.firmware.lib.controllers_compute_tilt_command(
            self._gains_record, self._state_record, self._motion_record, path, self._tilt_buffer
        )
        return np.array(list(self._tilt_buffer))

    def step(self, estimate: Estimate, heave_yaw: _Array, tilt: _Array | None) -> Actuators:
        if not self._settled:
            self._blend_gains()
        self._write_motion(estimate)
        self.firmware.lib.controllers_step(
            self._gains_record,
            self._state_record,
            self._motion_record,
            heave_yaw.tolist(),
            tilt is not None,
            [0.0, 0.0] if tilt is None else tilt.tolist(),
            self._actuators_record,
        )
        return Actuators(
            np.array(list(self._actuators_record.motor_input)),
            np.array(list(self._actuators_record.servo_input)),
        )
