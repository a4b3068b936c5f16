"""Build the board's loop with the numbers of a vehicle and a mission: as a library of this machine, or as an image.

Both are built from the tree of :func:`mufly.firmware.export_firmware` and cached on disk under a hash of sources, flags
and compiler.
"""

from __future__ import annotations

import shutil
import subprocess
import tempfile
from pathlib import Path
from typing import Any

import cffi

from mufly.compiled.numba_cache import cache_folder
from mufly.compiled.toolchain import COMPILER_FLAGS, build_cached_library
from mufly.control import FlightController
from mufly.errors import MuflyError
from mufly.files.answer_store import hash_inputs, replace_file_atomically
from mufly.firmware.export.source_export import ONBOARD_SOURCES, SOFTWARE_SOURCES, export_firmware, find_sources
from mufly.firmware.host_build import cffi_declarations, read_sources
from mufly.firmware.proof.sil_pil import (
    CORTEX_M4_FLAGS,
    SINGLE_PRECISION_BUILD,
    SPEED_OPTIMISED_SOURCES,
    describe_missing_tools,
)
from mufly.mission import Mission
from mufly.vehicle import Vehicle

_HOST_BOARD_SOURCES = (
    *SOFTWARE_SOURCES, *ONBOARD_SOURCES, "boards/board.c", "boards/qemu/exchange.c", "check/models/*_model.c",
)  # fmt: skip
_IMAGE_SOURCES = (
    *SOFTWARE_SOURCES, *ONBOARD_SOURCES, "boards/*.c", "boards/qemu/*.c", "check/platforms/platform_cortex_m4.c",
)  # fmt: skip
_IMAGE_FLAGS = (*COMPILER_FLAGS, *CORTEX_M4_FLAGS, "-mthumb", "-ffreestanding", "-nostdlib", "-DMUFLY_FLOAT")


def build_host_board(
    vehicle: Vehicle, controller: FlightController, mission: Mission, *, single: bool = True
) -> tuple[cffi.FFI, Any]:
    """Build the board's code as a library for this machine, and return its cffi interface and the loaded library.

    Raises
    ------
    MuflyError
        If there is no C compiler, or the mission is too long for a board.
    """
    with tempfile.TemporaryDirectory(prefix="mufly-board-") as temporary:
        tree = Path(temporary) / "fw"
        export_firmware(controller, tree, vehicle, mission.world, mission)
        library = build_cached_library(
            "board",
            read_sources(tree, _HOST_BOARD_SOURCES),
            flags=(*COMPILER_FLAGS, *(SINGLE_PRECISION_BUILD.compiler_flags if single else ())),
        )
        declarations = library.with_suffix(".h")
        if not declarations.exists():
            with replace_file_atomically(declarations) as made:
                made.write_text(cffi_declarations(tree, single, _HOST_BOARD_SOURCES), encoding="utf-8")
    ffi = cffi.FFI()
    ffi.cdef(declarations.read_text(encoding="utf-8"))
    return ffi, ffi.dlopen(str(library))


def build_board_image(vehicle: Vehicle, controller: FlightController, mission: Mission) -> Path:
    """Build the image (ELF) of a board with a Cortex-M4F, in single precision, and return its path.

    Raises
    ------
    MuflyError
        If a tool is missing, the mission is too long for a board, or the compiler fails.
    """
    absent = describe_missing_tools()
    if absent:
        raise MuflyError(f"emulated board: {absent}")
    with tempfile.TemporaryDirectory(prefix="mufly-image-") as temporary:
        tree = Path(temporary) / "fw"
        export_firmware(controller, tree, vehicle, mission.world, mission)
        parts = sorted(p for p in tree.rglob("*") if p.suffix in (".c", ".h", ".ld"))
        version = subprocess.run(["arm-none-eabi-gcc", "--version"], capture_output=True, text=True).stdout
        texts = [(str(p.relative_to(tree)), p.read_text(encoding="utf-8")) for p in parts]
        image = cache_folder() / f"board-{hash_inputs(version, _IMAGE_FLAGS, texts)[:24]}.elf"
        if not image.exists():
            made = _link_image(tree)
            with replace_file_atomically(image) as ready:
                shutil.copy(made, ready)
    return image


def _link_image(tree: Path) -> Path:
    """Compile and link the sources in the folder ``tree`` for the Cortex-M4F; return the path of the image."""
    command = ["arm-none-eabi-gcc", *_IMAGE_FLAGS, "-I."]
    _run_compiler([*command, "-O2", "-c", *SPEED_OPTIMISED_SOURCES], tree)
    objects = [Path(name).with_suffix(".o").name for name in SPEED_OPTIMISED_SOURCES]
    # The simulation takes the place of the sensors and their drivers.
    sources = [str(p.relative_to(tree)) for p in find_sources(tree, _IMAGE_SOURCES)]
    left_out = ("onboard/drivers/", *SPEED_OPTIMISED_SOURCES)
    others = [*(name for name in sources if not name.startswith(left_out)), *objects]
    _run_compiler([*command, *others, "-T", "check/platforms/cortex_m4.ld", "-o", "board.elf", "-lgcc"], tree)
    return tree / "board.elf"


def _run_compiler(command: list[str], folder: Path) -> None:
    done = subprocess.run(command, capture_output=True, text=True, cwd=folder)
    if done.returncode:
        first = next((line for line in done.stderr.splitlines() if "error" in line), done.stderr[:200])
        raise MuflyError(f"{command[0]} could not build the board's image: {first}")
