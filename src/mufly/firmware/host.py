"""The exported code on this machine: built by its C compiler, called through cffi, flown in the simulation."""

from __future__ import annotations

import functools
import subprocess
import tempfile
from pathlib import Path
from typing import Any

import cffi
import numpy as np
from numpy.typing import NDArray

from mufly.answer_store import replace_file
from mufly.control import FlightController
from mufly.estimate import Estimate
from mufly.firmware.tables import copy_sources, tables_c, write_tree
from mufly.flight.controllers import Actuators, Controllers
from mufly.toolchain import FLAGS, compile_library, compiler, kept_library

_Array = NDArray[np.floating[Any]]


def build(
    folder: Path, *, single: bool = False, flags: tuple[str, ...] = FLAGS, cc: str | None = None
) -> Path:
    """Build the exported sources in a folder as a shared library and return it.

    Raises
    ------
    MuflyError
        If there is no compiler, or it refuses; the message holds what it said first.
    """
    library = folder / ("mufly_single.so" if single else "mufly.so")
    sources = sorted(folder.glob("*.c"))
    extra = ("-DMUFLY_FLOAT",) if single else ()
    compile_library(sources, library, flags=(*flags, *extra), cc=cc)
    return library


def declarations(folder: Path, single: bool = False) -> str:
    """What the headers declare, for cffi."""
    command = [compiler(), "-E", "-P", "-DMUFLY_DECLARATIONS", *(("-DMUFLY_FLOAT",) if single else ())]
    headers = "".join(f'#include "{h.name}"\n' for h in sorted(folder.glob("*.h")))
    done = subprocess.run(
        [*command, f"-I{folder}", "-x", "c", "-"], input=headers, capture_output=True, text=True, check=True
    )
    return done.stdout.replace("extern const ", "extern ")  # to cffi a constant has no address


@functools.lru_cache(maxsize=8)
def _loaded(tables: str, single: bool, cc: str) -> tuple[cffi.FFI, Any]:
    ffi = cffi.FFI()
    with tempfile.TemporaryDirectory(prefix="mufly-firmware-") as folder:
        tree = Path(folder) / "fw"
        write_tree(tables, tree)
        library = build(tree, single=single, cc=cc)
        ffi.cdef(declarations(tree, single))
        return ffi, ffi.dlopen(str(library))


@functools.lru_cache(maxsize=1)
def _of_any() -> tuple[cffi.FFI, Any]:
    """The code without numbers of its own, in double precision, kept on disk: for whom a design's are handed over."""
    with tempfile.TemporaryDirectory(prefix="mufly-firmware-") as folder:
        tree = Path(folder) / "fw"
        copy_sources(tree)
        files = {p.name: p.read_text(encoding="utf-8") for p in sorted(tree.glob("*.[ch]"))}
        library = kept_library("firmware", {**files, "tables.c": _NO_TABLES})
        words = library.with_suffix(".h")
        if not words.exists():
            with replace_file(words) as made:
                made.write_text(declarations(tree), encoding="utf-8")
    ffi = cffi.FFI()
    ffi.cdef(words.read_text(encoding="utf-8"))
    return ffi, ffi.dlopen(str(library))


_NO_TABLES = """#include "controllers.h"
const int32_t mufly_rate_Hz = 0;
const int32_t mufly_position_divider = 0;
const gains_t mufly_gains;
"""


class Firmware:
    """The exported code of one vehicle, built and loaded; the same code is built once in a process.

    Parameters
    ----------
    controller : FlightController or None
        From :func:`mufly.control.design`. None: code without numbers of its own, built once for all vehicles.
    single : bool
        In single precision, as a processor without double computes.
    cc : str, optional
        The compiler, instead of :func:`compiler`.

    Raises
    ------
    MuflyError
        If there is no C compiler.
    """

    def __init__(
        self, controller: FlightController | None, *, single: bool = False, cc: str | None = None
    ) -> None:
        self.real = np.dtype(np.float32 if single else np.float64)
        self.of_any = controller is None
        if controller is None:
            self.ffi, self.lib = _of_any()
        else:
            self.ffi, self.lib = _loaded(tables_c(controller), single, cc or compiler())

    def gains(self, controller: FlightController) -> Any:
        """A ``gains_t`` of the numbers of a controller, which may be another than was exported."""
        g = self.ffi.new("gains_t *")
        for group in ("heave_yaw", "roll_pitch", "position"):
            record = getattr(controller, f"{group}_gains")
            numbers = np.frombuffer(record.tobytes(), dtype=np.float64).astype(self.real)
            self.ffi.memmove(self.ffi.addressof(g, group), numbers.tobytes(), numbers.nbytes)
        return g


class FirmwareControllers(Controllers):
    """:class:`mufly.flight.controllers.Controllers`, computed by the exported code with its own tables.

    What :class:`mufly.flight.Flight` takes as ``controllers``.
    """

    def __init__(self, design: FlightController, firmware: Firmware | None = None) -> None:
        super().__init__(design)
        f = self.firmware = firmware or Firmware(design)
        # Its tables, until something is tuned
        self._g = f.gains(design) if f.of_any else f.ffi.addressof(f.lib.mufly_gains)
        self._c, self._now = f.ffi.new("controllers_t *"), f.ffi.new("motion_t *")
        self._path, self._out = f.ffi.new("path_t *"), f.ffi.new("actuators_t *")
        self._two, self._four = f.ffi.new("real_t[2]"), f.ffi.new("real_t[4]")
        f.lib.position_start(f.ffi.addressof(self._c, "position"))

    def _go_over(self) -> None:
        super()._go_over()
        self._g = self.firmware.gains(self._design)

    def numbers(self) -> Any:
        """The ``gains_t`` of this period, one further on the way to those of a design that it goes over to."""
        if not self._settled:
            self._go_over()
        return self._g

    def _look(self, m: Estimate) -> None:
        now = self._now
        now.position, now.velocity = m.position.tolist(), m.velocity.tolist()
        now.attitude, now.rates, now.voltage = m.attitude.tolist(), m.rates.tolist(), m.battery_voltage

    def engage(self, estimate: Estimate, motor_input: _Array) -> None:
        self._look(estimate)
        self.firmware.lib.controllers_engage(self._g, self._c, self._now, motor_input.tolist())

    def lift_off(self, estimate: Estimate) -> None:
        self._look(estimate)
        self.firmware.lib.controllers_lift_off(self._g, self._c, self._now)

    def tilt_for(
        self, estimate: Estimate, position: _Array, velocity: _Array, acceleration: _Array
    ) -> _Array:
        self._look(estimate)
        path = self._path
        path.position, path.velocity = position.tolist(), velocity.tolist()
        path.acceleration = acceleration.tolist()
        self.firmware.lib.controllers_tilt(self._g, self._c, self._now, path, self._two)
        return np.array(list(self._two))

    def step(self, estimate: Estimate, heave_yaw: _Array, tilt: _Array | None) -> Actuators:
        if not self._settled:
            self._go_over()
        self._look(estimate)
        self.firmware.lib.controllers_step(
            self._g, self._c, self._now, heave_yaw.tolist(), tilt is not None,
            [0.0, 0.0] if tilt is None else tilt.tolist(), self._out,
        )  # fmt: skip
        return Actuators(np.array(list(self._out.motor_input)), np.array(list(self._out.servo_input)))
