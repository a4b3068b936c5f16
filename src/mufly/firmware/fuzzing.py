"""Any bytes for the code on board: libFuzzer looks for those that crash it, or that C leaves undefined.

The harness (``check/fuzz.c``) turns bytes into readings, beliefs, commands and missions. It is built with clang's
sanitizers of addresses and of undefined behaviour, so that what would go unnoticed on a board ends the run here.
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
from mufly.firmware.fixed_point_law import export_fixed_point
from mufly.firmware.sil_pil import run_compiler
from mufly.firmware.source_export import export_firmware
from mufly.results import result
from mufly.vehicle import Vehicle

_FUZZER_FLAGS = (
    "-std=gnu99", "-g", "-O1", "-ffp-contract=off", "-fno-math-errno",
    "-fsanitize=fuzzer,address,undefined,float-cast-overflow", "-fno-sanitize-recover=all", "-I.", "-Icheck", "-Ifixed",
)  # fmt: skip


@result
class FuzzResult:
    """A run of the fuzzer.

    Attributes
    ----------
    seconds : float
        Asked for (s).
    runs : int
        Inputs tried.
    covered : int
        Places in the code that were reached, as the fuzzer counts them.
    parts : tuple of str
        What was fed.
    found : str
        What ended it early, in the sanitizer's words; "" if nothing did.
    input_hex : str
        The bytes that did.
    """

    seconds: float
    runs: int
    covered: int
    parts: tuple[str, ...]
    found: str
    input_hex: str


@functools.cache
def missing_fuzzer_tools() -> str:
    """Return what has to be installed for :func:`fuzz_firmware`, as one line; "" if all is there.

    Debian packs clang's fuzzer and sanitizers apart from clang, so a program is linked with them to see.
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


def fuzz_firmware(vehicle: Vehicle, *, seconds: float, seed: int = 1) -> FuzzResult:
    """Feed the exported code any bytes.

    Parameters
    ----------
    vehicle : Vehicle
    seconds : float
        How long (s).
    seed : int
        Of the fuzzer's random numbers.

    Raises
    ------
    MuflyError
        If there is no clang, or it has no libFuzzer.
    """
    absent = missing_fuzzer_tools()
    if absent:
        raise MuflyError(f"fuzzing: {absent}")
    with tempfile.TemporaryDirectory(prefix="mufly-fuzz-") as temporary:
        folder = Path(temporary) / "fw"
        controller = design_flight_controller(vehicle)
        export_firmware(controller, folder, vehicle)
        export_fixed_point(controller, folder)
        return run_fuzzer(folder, seconds=seconds, seed=seed)


def run_fuzzer(folder: Path, *, seconds: float, seed: int = 1) -> FuzzResult:
    """Build and run the harness in an exported tree, with what is there; inputs worth keeping go to its ``corpus/``."""
    (folder / "corpus").mkdir(exist_ok=True)
    there = {
        "controllers": True, "avoidance": True, "whole numbers": (folder / "fixed" / "tables_fixed.c").exists(),
        "flight software": (folder / "software.c").exists(),
        "estimator": (folder / "estimate_tables.c").exists(),
    }  # fmt: skip
    define = {
        "whole numbers": "-DFUZZ_FIXED",
        "flight software": "-DFUZZ_MISSION",
        "estimator": "-DFUZZ_ESTIMATE",
    }
    flags = ["clang", *_FUZZER_FLAGS, *(flag for part, flag in define.items() if there[part])]
    objects = []
    for source in sorted((*folder.glob("*.c"), *folder.glob("fixed/*.c"), folder / "check" / "fuzz.c")):
        made = source.with_suffix(".fuzz.o")
        if not made.exists() or made.stat().st_mtime_ns < source.stat().st_mtime_ns:
            run_compiler([*flags, "-c", str(source), "-o", str(made)], folder)
        objects.append(str(made))
    run_compiler([*flags, *objects, "-o", "fuzz", "-lm"], folder)
    done = subprocess.run(
        [str(folder / "fuzz"), f"-max_total_time={max(1, round(seconds))}", f"-seed={seed}", "-max_len=4096",
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
        seconds=seconds, runs=int(executed[1]) if executed else 0, covered=int(covered[-1]) if covered else 0,
        parts=tuple(part for part, is_there in there.items() if is_there), found=found,
        input_hex=broken.read_bytes().hex() if broken else "",
    )  # fmt: skip
