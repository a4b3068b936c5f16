"""Fuzz the exported code: libFuzzer searches for inputs that crash the code or cause undefined behaviour.

The harness (``check/programs/fuzz.c``) converts bytes to readings, estimates, commands, missions, flash contents and
bytes of link and receiver. Clang's address and undefined-behaviour sanitizers end the run at faults that would go
unnoticed on a board.
"""

from __future__ import annotations

import functools
import re
import shutil
import subprocess
import tempfile
from pathlib import Path

from mufly.control import design_flight_controller
from mufly.errors import MuflyError
from mufly.firmware.export.source_export import (
    FIXED_POINT_SOURCES,
    FIXED_POINT_TABLES_PATH,
    ONBOARD_SOURCES,
    SOFTWARE_SOURCES,
    export_firmware,
    find_sources,
)
from mufly.firmware.fixed_point.fixed_point_law import export_fixed_point
from mufly.firmware.proof.sil_pil import run_compiler
from mufly.mission import load_mission
from mufly.results import ShownBlock, make_lines_block, result
from mufly.vehicle import Vehicle

_FUZZER_FLAGS = (
    "-std=gnu99", "-g", "-O1", "-ffp-contract=off", "-fno-math-errno",
    "-fsanitize=fuzzer,address,undefined,float-cast-overflow", "-fno-sanitize-recover=all",
    "-I.",
)  # fmt: skip


@result(json="seconds=duration_s runs covered parts sanitizer_message input_hex")
class FuzzResult:
    """Result of a fuzzing run.

    Attributes
    ----------
    duration_s : float
        Requested duration (s).
    runs : int
        Number of inputs.
    covered : int
        Number of code edges reached, as counted by the fuzzer.
    parts : tuple of str
        Names of the fuzzed parts.
    sanitizer_message : str
        Sanitizer message that ended the run early; "" without a fault.
    input_hex : str
        Input that caused the fault, in hexadecimal.
    """

    duration_s: float
    runs: int
    covered: int
    parts: tuple[str, ...]
    sanitizer_message: str
    input_hex: str

    def make_printed_blocks(self) -> list[ShownBlock]:
        """Return as printed text the inputs, and the fault with its input."""
        fault = (self.sanitizer_message, f"Bytes: {self.input_hex}") if self.sanitizer_message else ()
        return [
            make_lines_block(f"Parts: {', '.join(self.parts)}. {self.runs} inputs, {self.covered} code edges reached."),
            make_lines_block(
                *fault or ("No crash, undefined behaviour or output out of range.",), style="red" * bool(fault)
            ),
        ]


@functools.cache
def describe_missing_fuzzer_tools() -> str:
    """Return the tool missing for :func:`fuzz_firmware` as one line; "" if all tools are installed.

    Debian packages the fuzzer and the sanitizers apart from clang, so the function links a program with both.
    """
    if shutil.which("clang") is None:
        return "install clang (Debian, Ubuntu: apt-get install clang)"
    empty = "int LLVMFuzzerTestOneInput(const unsigned char *d, unsigned long n) { return d && n ? 0 : 0; }"
    with tempfile.TemporaryDirectory() as folder:
        flags = [f for f in _FUZZER_FLAGS if f.startswith("-f")]
        build = ["clang", *flags, "-x", "c", "-", "-o", f"{folder}/empty"]
        made = subprocess.run(build, input=empty, text=True, capture_output=True, timeout=120, check=False)
    if made.returncode:
        return "install clang's sanitizers (Debian, Ubuntu: apt-get install libclang-rt-14-dev, or that of your clang)"
    return ""


def fuzz_firmware(vehicle: Vehicle, *, duration_s: float, seed: int = 1, link_only: bool = False) -> FuzzResult:
    """Fuzz the exported code of a vehicle.

    Parameters
    ----------
    vehicle : Vehicle
    duration_s : float
        Duration (s).
    seed : int
        Seed of the fuzzer.
    link_only : bool
        Fuzz only the board with its link: bytes of UART and receiver, contents of flash.

    Raises
    ------
    MuflyError
        If clang or its libFuzzer is missing.
    """
    absent = describe_missing_fuzzer_tools()
    if absent:
        raise MuflyError(f"fuzzing: {absent}")
    with tempfile.TemporaryDirectory(prefix="mufly-fuzz-") as temporary:
        folder = Path(temporary) / "fw"
        controller = design_flight_controller(vehicle)
        mission = load_mission("demonstration")
        export_firmware(controller, folder, vehicle, mission.world, mission)
        export_fixed_point(controller, folder)
        return run_fuzzer(folder, duration_s=duration_s, seed=seed, link_only=link_only)


def run_fuzzer(folder: Path, *, duration_s: float, seed: int = 1, link_only: bool = False) -> FuzzResult:
    """Build and run the fuzzing harness for the parts that an exported tree contains; store new inputs in its
    ``corpus/``.
    """
    (folder / "corpus").mkdir(exist_ok=True)
    there = {
        "controllers": True, "avoidance": True, "whole numbers": (folder / FIXED_POINT_TABLES_PATH).exists(),
        "flight software": (folder / "flight" / "flight_software.c").exists(),
        "estimator": (folder / "estimate_tables.c").exists(),
        "link": (folder / "plan.c").exists(),
    }  # fmt: skip
    define = {
        "whole numbers": "-DFUZZ_FIXED",
        "flight software": "-DFUZZ_MISSION",
        "estimator": "-DFUZZ_ESTIMATE",
        "link": "-DFUZZ_LINK",
    }
    if link_only:
        there = dict.fromkeys(there, False) | {"link": there["link"]}
    flags = ["clang", *_FUZZER_FLAGS, *(flag for part, flag in define.items() if there[part])]
    flags += ["-DFUZZ_ONLY=fuzz_link"] if link_only else []
    objects = []
    board = (*ONBOARD_SOURCES, "boards/board.c", "check/models/*_model.c") if there["link"] else ()
    for source in find_sources(folder, (*SOFTWARE_SOURCES, *FIXED_POINT_SOURCES, *board, "check/programs/fuzz.c")):
        made = source.with_suffix(".fuzz.o")
        if source.stem == "fuzz" or not made.exists() or made.stat().st_mtime_ns < source.stat().st_mtime_ns:
            run_compiler([*flags, "-c", str(source), "-o", str(made)], folder)
        objects.append(str(made))
    run_compiler([*flags, *objects, "-o", "fuzz", "-lm"], folder)
    done = subprocess.run(
        [str(folder / "fuzz"), f"-max_total_time={max(1, round(duration_s))}", f"-seed={seed}", "-max_len=4096",
         "-len_control=20", "-print_final_stats=1", "-timeout=20", f"-artifact_prefix={folder}/found-", "corpus"],
        capture_output=True, text=True, cwd=folder,
    )  # fmt: skip
    said = done.stderr
    found = ""
    if done.returncode:
        line = re.search(r"(\S+: runtime error: .*|ERROR: .*|.*SUMMARY: .*)", said)
        where = re.findall(r"#\d+ 0x\w+ in (\w+) .*?(\w+\.c:\d+)", said)
        told = [f"{name} ({place})" for name, place in where if not name.startswith(("__", "fuzzer"))]
        found = f"{line[1] if line else 'it ended with status ' + str(done.returncode)}: {' < '.join(told[:5])}"
    broken = next(iter(sorted(folder.glob("found-*"))), None)
    executed = re.search(r"stat::number_of_executed_units:\s*(\d+)", said)
    covered = re.findall(r"cov: (\d+)", said)
    return FuzzResult(
        duration_s=duration_s, runs=int(executed[1]) if executed else 0, covered=int(covered[-1]) if covered else 0,
        parts=tuple(part for part, is_there in there.items() if is_there), sanitizer_message=found,
        input_hex=broken.read_bytes().hex() if broken else "",
    )  # fmt: skip
