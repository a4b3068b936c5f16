"""Measure the branch coverage of the exported C code.

The code is built with gcov counters, which the process writes when it ends. :mod:`mufly.firmware.proof.evidence_report`
therefore runs ``python -m mufly.firmware.proof.branch_coverage TREE VEHICLE``.
"""

from __future__ import annotations

import os
import sys
import types
from collections.abc import Callable, Iterable
from importlib import resources
from pathlib import Path
from typing import Any

import cffi
import numpy as np

from mufly.compiled.toolchain import COMPILER_FLAGS
from mufly.control import FlightController, design_flight_controller
from mufly.estimate import filter_backend
from mufly.estimate.filter.c_records import RECORDS_HEADER_PATH
from mufly.firmware.compiled_software import FirmwareSoftware
from mufly.firmware.export.source_export import FIXED_POINT_SOURCES, SOFTWARE_SOURCES, find_sources
from mufly.firmware.fixed_point import fixed_point_law
from mufly.firmware.fixed_point.fixed_point_design import quantise_law
from mufly.firmware.host_build import Firmware, cffi_declarations
from mufly.firmware.proof.proof_flights import add_random_obstacle, draw_wind_and_fault
from mufly.firmware.proof.sil_pil import run_compiler
from mufly.flight import fly_mission
from mufly.mission import Mission, load_mission, parse_mission
from mufly.sensors.faults import parse_fault
from mufly.vehicle import Vehicle, load_vehicle

FUZZ_PART_COUNT, FUZZ_INPUT_COUNT = 5, 60_000
"""Number of parts of the fuzzing harness, and number of random inputs."""


FLIGHT_COUNT, COMMAND_EXAMPLE_COUNT = 8, 400
SENSOR_FAULTS = (
    "sonar.jump=0.3@14s+2s gyro.jump=0.3@16s position.dropout@14s+3s ring.insane@13s pressure.doubled@11s",
    "sonar.stuck=1.0@14s accelerometer.clip=12@15s ring.doubled@13s battery.jump@14s magnetometer.insane@15s",
    "position.late@14s pressure.drift@14s gyro.insane@16s+0.5s ring.outliers@13s gyro.outliers@17s sonar.outliers@15s",
    "position.drift=0.3@14s magnetometer.jump@14s pressure.jump@15s rotor_speed.jump@15s sonar.drift@14s",
)
"""Number of random flights and of command sequences; sensor faults added to the random ones, a line for each flight."""


HOP_MISSION = {
    "waypoint": [
        {"position_m": [0.6, 0.3, -1.0], "wait_s": 1.0},
        {"position_m": [-0.4, -0.3, -1.0], "wait_s": 9.0},
    ],
    "room": {"north_m": [-1.5, 1.5], "east_m": [-1.5, 1.5], "height_m": 3.0},
}
"""Mission in a room whose walls are within the range of the beams."""


def build_instrumented(folder: Path) -> Path:
    """Build an exported tree with branch counters, including the fixed-point law and the fuzzing harness."""
    flags = [
        "gcc",
        *COMPILER_FLAGS,
        "-O0",
        "--coverage",
        "-fPIC",
        "-I.",
        "-DFUZZ_FIXED",
        "-DFUZZ_MISSION",
    ]
    objects = []
    for source in find_sources(folder, (*SOFTWARE_SOURCES, *FIXED_POINT_SOURCES, "check/programs/fuzz.c")):
        name = source.relative_to(folder).with_suffix("")
        run_compiler([*flags, "-DFUZZ_ESTIMATE", "-c", f"{name}.c", "-o", f"{name}.o"], folder)
        objects.append(f"{name}.o")
    run_compiler(["gcc", "--coverage", "-shared", *objects, "-o", "counted.so", "-lm"], folder)
    return folder / "counted.so"


def run_coverage_workload(folder: Path, vehicle: Vehicle) -> None:
    """Run the instrumented code: missions with sensors, the fixed-point law, comparison tests, and fuzzing inputs."""
    library = str(build_instrumented(folder))
    controller = design_flight_controller(vehicle)
    firmware = Firmware.__new__(Firmware)
    firmware.real_dtype, firmware.is_generic = np.dtype(np.float64), False
    firmware.ffi = cffi.FFI()
    firmware.ffi.cdef(cffi_declarations(folder))
    firmware.ffi.cdef("int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size);")
    firmware.lib = firmware.ffi.dlopen(library)
    fixed_ffi = cffi.FFI()
    fixed_ffi.cdef(cffi_declarations(folder, patterns=FIXED_POINT_SOURCES))
    whole = quantise_law(controller)

    class InstrumentedSoftware(FirmwareSoftware):
        def __init__(self, vehicle: Vehicle, controller: FlightController, mission: Mission) -> None:
            super().__init__(vehicle, controller, mission, firmware)

    def make_fixed_point_controllers(c: FlightController) -> fixed_point_law.FixedPointFirmwareControllers:
        return fixed_point_law.FixedPointFirmwareControllers(c, whole)

    # The instrumented library replaces the regular ones; the record layouts are equal.
    _replace_loader(
        fixed_point_law, "_load_fixed_point_library", lambda text, cc: (fixed_ffi, fixed_ffi.dlopen(library))
    )
    kept: Any = filter_backend._load_filter_library
    records = (folder / RECORDS_HEADER_PATH).read_text(encoding="utf-8")

    def load_instrumented_filter(asked: str, flags: Any = COMPILER_FLAGS) -> Any:
        ffi, lib = kept(asked, flags)
        return ffi, ffi.dlopen(library) if asked == records and flags == COMPILER_FLAGS else lib

    counts: Any = load_instrumented_filter
    counts.cache_clear = kept.cache_clear
    _replace_loader(filter_backend, "_load_filter_library", counts)
    for name in ("demonstration", "box-on-leg"):
        fly_mission(
            vehicle,
            load_mission(name),
            controller=controller,
            controllers=InstrumentedSoftware,
            sensors="fitted",
            gust=0.3,
        )
    fly_mission(vehicle, load_mission("box-on-leg"), controller=controller, controllers=make_fixed_point_controllers)
    for seed in range(FLIGHT_COUNT):
        met = draw_wind_and_fault(seed)
        faults = [parse_fault(f) for f in (*met.faults, *SENSOR_FAULTS[seed % len(SENSOR_FAULTS)].split())]
        mission = parse_mission(HOP_MISSION) if seed % 2 else add_random_obstacle(load_mission("demonstration"), seed)
        fly_mission(
            vehicle,
            mission,
            controller=controller,
            controllers=InstrumentedSoftware,
            sensors="fitted",
            faults=faults,
            seed=seed,
            gust=met.gust,
            wind=[met.wind, 0.0, 0.0],
        )
    _run_comparison_tests(firmware)
    for kept_input in sorted((folder / "corpus").glob("*")):
        found = kept_input.read_bytes()
        firmware.lib.LLVMFuzzerTestOneInput(firmware.ffi.from_buffer("uint8_t[]", found), len(found))
    rng = np.random.default_rng(0)
    for k in range(FUZZ_INPUT_COUNT):
        data = rng.integers(0, 256, int(rng.integers(64, 4096)), dtype=np.uint8)
        if k % 3:  # small numbers without special values
            data = (data.astype(float) ** 2 / 300.0).astype(np.uint8)
        data[0] = k % FUZZ_PART_COUNT + (
            130 if k % 4 == 0 else 0
        )  # 130 is a multiple of FUZZ_PART_COUNT and selects plain numbers
        firmware.lib.LLVMFuzzerTestOneInput(firmware.ffi.from_buffer("uint8_t[]", data.tobytes()), len(data))


def _replace_loader(module: types.ModuleType, name: str, loader: Callable[..., Any]) -> None:
    """Replace a module's function that loads a library; raise AttributeError if the module has no function of this
    name.
    """
    getattr(module, name)
    setattr(module, name, loader)


def _run_comparison_tests(counted: Firmware) -> None:
    """Run the tests that compare C with Python on the instrumented C code, if the test files are installed."""
    plainly: Any = Firmware.__init__

    def init_with_instrumented_code(
        self: Firmware, controller: FlightController | None, *, single: bool = False, cc: Any = None
    ) -> None:
        plainly(self, controller, single=single, cc=cc)
        if controller is not None and not single:  # whatever compiler a test asks for
            self.ffi, self.lib = counted.ffi, counted.lib

    changed: Any = Firmware
    changed.__init__ = init_with_instrumented_code
    os.environ["MUFLY_EXAMPLES"] = str(COMMAND_EXAMPLE_COUNT)
    run_installed_tests(("mission_c", "avoid", "estimate_c"))


def run_installed_tests(names: Iterable[str], *options: str) -> None:
    """Run test files of the firmware in this process, if they and pytest are installed; print a failure's status."""
    tests = Path(str(resources.files("mufly"))).parents[1] / "tests" / "firmware"
    try:
        import pytest
    except ImportError:
        return
    if not tests.is_dir():
        return
    files = [str(tests / f"test_{name}.py") for name in names]
    failed = pytest.main(["-q", "-n", "0", "-p", "no:cacheprovider", *options, *files])
    if failed:
        print(f"pytest ended with {int(failed)}")


if __name__ == "__main__":
    run_coverage_workload(Path(sys.argv[1]), load_vehicle(sys.argv[2]))
