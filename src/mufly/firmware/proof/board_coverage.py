"""Measure the branch coverage of a board's own code: drivers, link, log, receiver, storage, supervisor and policy.

The tests of this code build it as libraries of this machine. Here the libraries count their branches with gcov, which
writes the counts when the process ends. :mod:`mufly.firmware.proof.evidence_report` therefore runs ``python -m
mufly.firmware.proof.board_coverage FOLDER VEHICLE``. The loop of a board and the start of its processor do not run on
this machine and are not counted.
"""

from __future__ import annotations

import sys
from collections.abc import Mapping, Sequence
from fnmatch import fnmatch
from pathlib import Path
from typing import Any

import cffi
import numpy as np

from mufly.compiled import toolchain
from mufly.compiled.toolchain import COMPILER_FLAGS, compile_library
from mufly.control import design_flight_controller
from mufly.files.answer_store import hash_inputs
from mufly.firmware.emulated import image_build
from mufly.firmware.export.source_export import SOURCE_FOLDER
from mufly.firmware.proof.branch_coverage import run_installed_tests
from mufly.firmware.proof.evidence_report import BOARD_SOURCES
from mufly.firmware.proof.sil_pil import run_compiler
from mufly.mission import load_mission
from mufly.vehicle import Vehicle, load_vehicle

BOARD_TESTS = (
    "board_link", "board_safety", "drivers", "flight_log", "i2c", "policy_c", "rc", "sd_card", "settings", "stm32",
    "storage",
)  # fmt: skip
"""Test files that run the counted sources on this machine."""

FUZZ_INPUT_COUNT = 300
"""Number of random inputs to the fuzzing harness of link, receiver and flash."""

_LEFT_OUT_TESTS = "not emulat and not image and not whole_board and not harness"  # they build for other processors
_COVERAGE_FLAGS = ("-O0", "--coverage")
_FUZZER_SOURCE = "check/programs/fuzz.c"


class CountedBuilds:
    """Builds of boards, drivers and policies that count their branches.

    Parameters
    ----------
    folder : Path
        Folder of all counted builds.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.boards: list[Path] = []

    def replace_builders(self) -> None:
        """Let boards, and libraries that tests build in their own folders, count from now on."""
        replaced: tuple[tuple[Any, str, Any], ...] = (
            (image_build, "build_cached_library", self.build_board),
            (toolchain, "compile_library", self.compile_library),
        )
        for module, name, builder in replaced:
            getattr(module, name)  # raises AttributeError if it has another name
            setattr(module, name, builder)

    def compile_library(
        self, sources: Sequence[Path], out: Path, *, flags: Sequence[str] = COMPILER_FLAGS, cc: str | None = None
    ) -> None:
        """Build a shared library, counted where it lies in the folder of counted builds."""
        if out.is_relative_to(self.folder):
            kept = [flag for flag in flags if not flag.startswith("-fsanitize")]  # sanitizers add branches
            flags, cc = (*kept, *_COVERAGE_FLAGS), "gcc"
        compile_library(sources, out, flags=flags, cc=cc)

    def build_board(self, name: str, files: Mapping[str, str], *, flags: Sequence[str] = COMPILER_FLAGS) -> Path:
        """Return the library of a board, whose own code is counted and whose flight software is not."""
        tree = self.folder / f"{name}-{hash_inputs(tuple(flags), sorted(files.items()))[:12]}"
        library = tree / "board.so"
        if not library.exists():
            texts = {**files, _FUZZER_SOURCE: (SOURCE_FOLDER / _FUZZER_SOURCE).read_text(encoding="utf-8")}
            for file, text in texts.items():
                (tree / file).parent.mkdir(parents=True, exist_ok=True)
                (tree / file).write_text(text, encoding="utf-8")
            sources = sorted(file for file in texts if file.endswith(".c"))
            counted = [file for file in sources if any(fnmatch(file, p) for p in BOARD_SOURCES)]
            others = [file for file in sources if file not in counted]
            fuzzed = ("-DFUZZ_LINK", "-DFUZZ_ONLY=fuzz_link")
            run_compiler(["gcc", *flags, *fuzzed, "-fPIC", "-I.", "-c", *others], tree)
            objects = [str(tree / Path(file).with_suffix(".o").name) for file in others]
            self.compile_library(
                [tree / file for file in counted], library, flags=(*flags, f"-I{tree}", *objects), cc="gcc"
            )
            self.boards.append(library)
        return library


def run_board_workload(folder: Path, vehicle: Vehicle) -> None:
    """Run the counted code: random inputs, and the tests of boards where they are installed."""
    builds = CountedBuilds(folder)
    builds.replace_builders()
    controller, mission = design_flight_controller(vehicle), load_mission("demonstration")
    image_build.build_host_board(vehicle, controller, mission, single=False)
    _run_random_inputs(builds.boards[0])
    run_installed_tests(BOARD_TESTS, "-k", _LEFT_OUT_TESTS, f"--basetemp={folder / 'tests'}")


def _run_random_inputs(library: Path) -> None:
    """Feed random inputs to the board's link, receiver and flash."""
    ffi = cffi.FFI()
    ffi.cdef("int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size);")
    lib: Any = ffi.dlopen(str(library))
    rng = np.random.default_rng(0)
    for _ in range(FUZZ_INPUT_COUNT):
        data = rng.bytes(int(rng.integers(64, 4096)))
        lib.LLVMFuzzerTestOneInput(ffi.from_buffer("uint8_t[]", data), len(data))


if __name__ == "__main__":
    run_board_workload(Path(sys.argv[1]), load_vehicle(sys.argv[2]))
