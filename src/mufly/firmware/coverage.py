"""Which branches of the C are reached? Built with counts, flown and fed in a process that writes them as it ends.

``python -m mufly.firmware.coverage TREE VEHICLE``, as :mod:`mufly.firmware.report` calls it.
"""

from __future__ import annotations

import os
import sys
from pathlib import Path
from typing import Any

import cffi
import numpy as np

from mufly.control import FlightController, design
from mufly.estimate import native
from mufly.firmware import integer_law
from mufly.firmware.campaign import obstructed, weather
from mufly.firmware.checks import built
from mufly.firmware.fixed import fixed_law
from mufly.firmware.host import Firmware, declarations
from mufly.firmware.onboard import FirmwareSoftware
from mufly.flight import fly
from mufly.mission import Mission, load_mission, mission_from
from mufly.sensors.faults import parse_fault
from mufly.toolchain import FLAGS
from mufly.vehicle import Vehicle, load_vehicle

PARTS, INPUTS = 5, 3000
"""Of the harness of the fuzzer, and how many inputs are drawn for it."""


FLIGHTS, EXAMPLES = 8, 150
FAULTS = (
    "sonar.jump=0.3@14s+2s gyro.jump=0.3@16s position.dropout@14s+3s ring.insane@13s pressure.doubled@11s",
    "sonar.stuck=1.0@14s accelerometer.clip=12@15s ring.doubled@13s battery.jump@14s magnetometer.insane@15s",
    "position.late@14s pressure.drift@14s gyro.insane@16s+0.5s ring.outliers@13s gyro.outliers@17s sonar.outliers@15s",
    "position.drift=0.3@14s magnetometer.jump@14s pressure.jump@15s rotor_speed.jump@15s sonar.drift@14s",
)
"""Drawn flights, and sequences of commands; faults of sensors, all together, beside those drawn."""


HOP = {
    "waypoint": [
        {"position_m": [0.6, 0.3, -1.0], "wait_s": 1.0},
        {"position_m": [-0.4, -0.3, -1.0], "wait_s": 9.0},
    ],
    "room": {"north_m": [-1.5, 1.5], "east_m": [-1.5, 1.5], "height_m": 3.0},
}
"""In a room whose walls the ring sees."""


def counted(folder: Path) -> Path:
    """Build an exported tree, whole numbers and the fuzzer's harness included, with counts of branches."""
    flags = [
        "gcc",
        *FLAGS,
        "-O0",
        "--coverage",
        "-fPIC",
        "-I.",
        "-Ifixed",
        "-Icheck",
        "-DFUZZ_FIXED",
        "-DFUZZ_MISSION",
    ]
    objects = []
    for source in (*folder.glob("*.c"), *folder.glob("fixed/*.c"), folder / "check" / "fuzz.c"):
        name = source.relative_to(folder).with_suffix("")
        built([*flags, "-DFUZZ_ESTIMATE", "-c", f"{name}.c", "-o", f"{name}.o"], folder)
        objects.append(f"{name}.o")
    built(["gcc", "--coverage", "-shared", *objects, "-o", "counted.so", "-lm"], folder)
    return folder / "counted.so"


def exercise(folder: Path, vehicle: Vehicle) -> None:
    """Fly both missions by the counted code, on sensors and by whole numbers; feed it bytes, of ``corpus/`` and any."""
    library = str(counted(folder))
    controller = design(vehicle)
    firmware = Firmware.__new__(Firmware)
    firmware.real, firmware.of_any = np.dtype(np.float64), False
    firmware.ffi = cffi.FFI()
    firmware.ffi.cdef(declarations(folder))
    firmware.ffi.cdef("int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size);")
    firmware.lib = firmware.ffi.dlopen(library)
    fixed_ffi = cffi.FFI()
    fixed_ffi.cdef(declarations(folder / "fixed"))
    whole = fixed_law(controller)

    class Flown(FirmwareSoftware):
        def __init__(self, vehicle: Vehicle, controller: FlightController, mission: Mission) -> None:
            super().__init__(vehicle, controller, mission, firmware)

    def by_whole_numbers(c: FlightController) -> integer_law.FixedFirmwareControllers:
        return integer_law.FixedFirmwareControllers(c, whole)

    # Its own libraries give way to the one that counts; the records are laid out alike.
    changed: Any = integer_law
    changed._loaded = lambda text, cc: (fixed_ffi, fixed_ffi.dlopen(library))
    kept: Any = native._library
    records = (folder / "records.h").read_text(encoding="utf-8")

    def filter_of(asked: str, flags: Any = FLAGS) -> Any:
        ffi, lib = kept(asked, flags)
        return ffi, ffi.dlopen(library) if asked == records and flags == FLAGS else lib

    changed = native
    counts: Any = filter_of
    counts.cache_clear = kept.cache_clear
    changed._library = counts
    for name in ("demonstration", "box-on-leg"):
        fly(vehicle, load_mission(name), controller=controller, controllers=Flown, sensors="fitted", gust=0.3)
    fly(vehicle, load_mission("box-on-leg"), controller=controller, controllers=by_whole_numbers)
    for seed in range(FLIGHTS):
        met = weather(seed)
        faults = [parse_fault(f) for f in (*met.faults, *FAULTS[seed % len(FAULTS)].split())]
        mission = mission_from(HOP) if seed % 2 else obstructed(load_mission("demonstration"), seed)
        fly(
            vehicle, mission, controller=controller, controllers=Flown, sensors="fitted", faults=faults, seed=seed,
            gust=met.gust, wind=[met.wind, 0.0, 0.0],
        )  # fmt: skip
    _tests(firmware)
    for kept_input in sorted((folder / "corpus").glob("*")):
        found = kept_input.read_bytes()
        firmware.lib.LLVMFuzzerTestOneInput(firmware.ffi.from_buffer("uint8_t[]", found), len(found))
    rng = np.random.default_rng(0)
    for k in range(INPUTS):
        data = rng.integers(0, 256, int(rng.integers(64, 4096)), dtype=np.uint8)
        if k % 3:  # calm: small numbers of everything, no special ones
            data = (data.astype(float) ** 2 / 300.0).astype(np.uint8)
        data[0] = k % PARTS + (
            130 if k % 4 == 0 else 0
        )  # 130 is a multiple of the parts: no wild number comes
        firmware.lib.LLVMFuzzerTestOneInput(firmware.ffi.from_buffer("uint8_t[]", data.tobytes()), len(data))


def _tests(counted: Firmware) -> None:
    """Run the tests that compare the languages, with the code that counts, where they are at hand."""
    tests = Path(__file__).resolve().parents[3] / "tests" / "firmware"
    try:
        import pytest
    except ImportError:
        return
    if not tests.is_dir():
        return
    plainly: Any = Firmware.__init__

    def started(
        self: Firmware, controller: FlightController | None, *, single: bool = False, cc: Any = None
    ) -> None:
        plainly(self, controller, single=single, cc=cc)
        if controller is not None and not single and cc is None:
            self.ffi, self.lib = counted.ffi, counted.lib

    changed: Any = Firmware
    changed.__init__ = started
    os.environ["MUFLY_EXAMPLES"] = str(EXAMPLES)
    files = [str(tests / f"test_{name}.py") for name in ("mission_c", "avoid", "estimate_c")]
    failed = pytest.main(["-q", "-n", "0", "-p", "no:cacheprovider", *files])
    if failed:
        print(f"pytest ended with {int(failed)}")


if __name__ == "__main__":
    exercise(Path(sys.argv[1]), load_vehicle(sys.argv[2]))
