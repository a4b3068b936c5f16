"""Write the verification report of the exported code: equality with Python, resources, checks, coverage, fuzzing.

Each section states its measurement and method. If a tool is missing, the section names the package to install, and the
report continues.
"""

from __future__ import annotations

import json
import re
import shutil
import subprocess
import sys
import tempfile
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from fnmatch import fnmatch
from importlib import resources
from itertools import zip_longest
from pathlib import Path
from typing import Any

from mufly.compiled.toolchain import COMPILER_FLAGS
from mufly.control import design_flight_controller
from mufly.errors import MuflyError
from mufly.firmware.export.estimate_tables import render_estimator_files
from mufly.firmware.export.source_export import (
    FIXED_POINT_SOURCES,
    ONBOARD_SOURCES,
    SOFTWARE_SOURCES,
    SOURCE_FOLDER,
    export_firmware,
    find_sources,
)
from mufly.firmware.fixed_point.fixed_point_design import measure_cascade_margin_loss, quantise_law
from mufly.firmware.fixed_point.fixed_point_flights import compare_fixed_point_flights
from mufly.firmware.fixed_point.fixed_point_law import export_fixed_point
from mufly.firmware.proof.fuzzing import describe_missing_fuzzer_tools, fuzz_firmware, run_fuzzer
from mufly.firmware.proof.sil_pil import (
    CORTEX_M4_FLAGS,
    SINGLE_PRECISION_BUILD,
    compile_objects,
    describe_missing_tools,
    find_deepest_stack,
    measure_code_size,
    run_pil,
    run_sil,
)
from mufly.mission import load_mission
from mufly.results import ShownBlock, ShownLines, to_plain_data
from mufly.vehicle import Vehicle
from mufly.version import __version__

MISRA_ADVISORY_RULES = frozenset([
    "2.3", "2.4", "2.5", "2.6", "2.7", "4.2", "5.9", "8.7", "8.9", "8.11", "8.13", "10.5", "11.4",
    "11.5", "12.1", "12.3", "12.4", "13.3", "13.4", "15.1", "15.4", "15.5", "17.5", "17.8", "18.4",
    "18.5", "19.2", "20.1", "20.5", "20.10", "21.12",
])  # fmt: skip
"""Advisory rules of MISRA C:2012; all others are required or mandatory."""

MISRA_CHECKED_SOURCES = (
    *SOFTWARE_SOURCES, *FIXED_POINT_SOURCES, *ONBOARD_SOURCES, "boards/*.c", "boards/stm32/*.c",
)  # fmt: skip
"""Sources of the MISRA check: flight software, drivers, link, log, receiver, storage, supervisor and the STM32F405."""

BOARD_SOURCES = ("onboard/*.c", "boards/board.c", "boards/stm32/*.c", "policy/policy.c")
"""Sources of a board whose branches are counted, as far as they run on this machine; ``*`` matches any path."""

RESOURCE_TARGETS = {
    "flash_bytes": 64_000,
    "ram_bytes": 16_000,
    "instructions": 50_000,
    "margin_dB": 0.5,
    "single": 1e-4,
}

BOARD_MEMORY_TARGET_BYTES = {"flash": 128_000, "ram": 28_000, "stack": 4_000}
"""Most bytes of a whole board; RAM and stack together are 32 kB."""


@dataclass(frozen=True)
class EvidenceSection:
    """Section of the verification report: its text and its figures.

    Attributes
    ----------
    title : str
    text : str
        Markdown.
    data : dict
        Figures of the section; ``missing`` names the tool to install.
    """

    title: str
    text: str
    data: dict[str, Any]


@dataclass(frozen=True)
class MisraFinding:
    """Finding of the MISRA checker: rule, place, and the documented reason of the deviation ("" if none)."""

    rule: str
    place: str
    reason: str


def _markdown_table(head: Sequence[str], rows: Sequence[Sequence[Any]]) -> str:
    lines = ["| " + " | ".join(head) + " |", "|" + "---|" * len(head)]
    return "\n".join([*lines, *("| " + " | ".join(str(v) for v in row) + " |" for row in rows)])


def _markdown_blocks(blocks: Iterable[ShownBlock]) -> str:
    """Return the printed text of a result as Markdown."""
    return "\n\n".join(
        "\n".join(b.lines) if isinstance(b, ShownLines) else f"{b.title}\n\n{_markdown_table(b.heads, b.rows)}".strip()
        for b in blocks
    )


def _require_tool(tool: str, package: str) -> None:
    if shutil.which(tool) is None:
        raise MuflyError(f"not measured: install {package} (Debian, Ubuntu: apt-get install {package})")


# ----------------------------------------------------------------------------
# Equality with Python


def _report_python_c_equality(vehicle: Vehicle, out: Path) -> EvidenceSection:
    compared = run_sil(vehicle, ["demonstration", "box-on-leg"])
    return EvidenceSection(
        "The same as Python",
        f"{_markdown_blocks(compared.make_printed_blocks())}\n\nDouble precision: no bit may differ. Single: "
        f"{RESOURCE_TARGETS['single']:.0e} of full range is the aim.",
        to_plain_data(compared),
    )


def _report_emulated_processors(vehicle: Vehicle, out: Path) -> EvidenceSection:
    absent = describe_missing_tools()
    if absent:
        raise MuflyError(f"not measured: {absent}")
    boards = [("single precision", r) for r in run_pil(vehicle).processors] + [
        ("whole numbers", r) for r in run_pil(vehicle, fixed_point=True).processors
    ]
    from matplotlib.figure import Figure  # imported here to save half a second at start

    figure = Figure(figsize=(7, 3.2), layout="constrained")
    axes = figure.subplots()
    names = [f"{r.tested_part}: {r.machine}, {kind}" for kind, r in boards]
    axes.barh(names, [r.worst_instructions for _, r in boards], color="#9db8d2", label="worst")
    axes.barh(names, [r.mean_instructions for _, r in boards], color="#31587a", height=0.5, label="mean")
    axes.invert_yaxis()
    axes.set_xlabel("instructions of a period")
    axes.legend(frameon=False)
    figure.savefig(out / "instructions.png", dpi=130)
    rows = [
        (
            r.tested_part, r.machine, kind, "the same" if r.same else "**differ**", f"{r.mean_instructions:.0f}",
            f"{r.worst_instructions:.0f}",
        )
        for kind, r in boards
    ]  # fmt: skip
    return EvidenceSection(
        "On emulated processors",
        _markdown_table(("what", "board", "numbers", "outputs", "instructions, mean", "worst"), rows)
        + "\n\n![instructions of a period](instructions.png)\n\nLaw: the controllers; flight: they, the mission "
        "and what watches over it, without the estimator. Self-tests in "
        f"`check/`. Aim for the whole stack: {RESOURCE_TARGETS['instructions']}.",
        {"boards": [{"numbers": kind, **_result_to_dict(r)} for kind, r in boards]},
    )


def _result_to_dict(one: Any) -> dict[str, Any]:
    found: dict[str, Any] = to_plain_data(one)
    return found


def measure_board_memory(vehicle: Vehicle) -> dict[str, int]:
    """Return flash, RAM and stack (bytes) of a whole board: the loop, MAVLink, receiver and settings, without drivers.

    The stack is that of the deepest call path from ``main``, without interrupts. The mission is the demonstration.

    Raises
    ------
    MuflyError
        If the compiler fails, or the stack has no bound.
    """
    with tempfile.TemporaryDirectory(prefix="mufly-report-") as temporary:
        folder = Path(temporary) / "fw"
        mission = load_mission("demonstration")
        export_firmware(design_flight_controller(vehicle), folder, vehicle, mission.world, mission)
        board = (*SOFTWARE_SOURCES, *ONBOARD_SOURCES, "boards/*.c", "boards/stm32/*.c")
        objects = compile_objects(folder, replace(SINGLE_PRECISION_BUILD, source_patterns=board), CORTEX_M4_FLAGS)
        flash, ram = measure_code_size(objects)
        return {"flash": flash, "ram": ram, "stack": find_deepest_stack(objects, "main")}


def _report_memory(vehicle: Vehicle, out: Path) -> EvidenceSection:
    _require_tool("arm-none-eabi-gcc", "gcc-arm-none-eabi")
    with tempfile.TemporaryDirectory(prefix="mufly-report-") as temporary:
        folder = Path(temporary) / "fw"
        export_firmware(design_flight_controller(vehicle), folder, vehicle)
        objects = compile_objects(folder, SINGLE_PRECISION_BUILD, CORTEX_M4_FLAGS)
        flash, _ = measure_code_size(objects)
        (folder / "sizes.c").write_text(
            '#include "flight/flight_software.h"\n#include "estimate/filter/ekf_step.h"\n'
            "software_t software; estimator_t estimator; estimate_t belief;\n",
            encoding="utf-8",
        )
        command = [
            "arm-none-eabi-gcc", "-std=c99", "-mcpu=cortex-m4", "-mthumb", "-DMUFLY_FLOAT", "-I.", "-fno-common", "-c",
            "sizes.c", "-o", "sizes.o",
        ]  # fmt: skip
        subprocess.run(command, cwd=folder, check=True, capture_output=True)
        said = subprocess.run(["arm-none-eabi-nm", "-S", "sizes.o"], cwd=folder, capture_output=True, text=True).stdout
        ram = {name: int(size, 16) for size, name in re.findall(r"^\w+ (\w+) [BbDdCc] (\w+)$", said, re.M)}
        stack = {
            name: find_deepest_stack(objects, name) for name in ("software_step", "estimator_step", "controllers_")
        }
    board = measure_board_memory(vehicle)
    rows = [
        ("flash, all of it (bytes)", flash, RESOURCE_TARGETS["flash_bytes"]),
        *((f"RAM, one {name} (bytes)", size, "") for name, size in sorted(ram.items())),
        ("RAM, sum (bytes)", sum(ram.values()), RESOURCE_TARGETS["ram_bytes"]),
        *((f"stack below {name.rstrip('_')} (bytes)", size, "bounded") for name, size in stack.items()),
        *((f"whole board, {name} (bytes)", size, BOARD_MEMORY_TARGET_BYTES[name]) for name, size in board.items()),
    ]
    return EvidenceSection(
        "What it needs",
        _markdown_table(("", "measured", "aim"), rows)
        + "\n\nSingle precision, Cortex-M4, gcc -Os. State is the caller's; stack: deepest path of calls with each "
        "function's own use, from -fstack-usage; no recursion. Whole board: with MAVLink, receiver and settings, "
        "without drivers; RAM without the stack.",
        {"flash_bytes": flash, "ram_bytes": ram, "stack_bytes": stack, "board_bytes": board},
    )


# ----------------------------------------------------------------------------
# Fixed-point law


def _report_fixed_point(vehicle: Vehicle, out: Path) -> EvidenceSection:
    controller = design_flight_controller(vehicle)
    law = quantise_law(controller)
    cascade = measure_cascade_margin_loss(vehicle, controller, law)
    compared = compare_fixed_point_flights(vehicle, ["demonstration", "box-on-leg"], law=law)
    text = [
        _markdown_blocks([*law.make_printed_blocks(cascade), *compared.make_printed_blocks()]),
        f"Margins may fall by {RESOURCE_TARGETS['margin_dB']} dB. With bounds below 1 nothing overflows.",
    ]
    data = {
        "losses": to_plain_data([*law.chosen_losses, cascade]),
        "proofs": to_plain_data([c.proof for c in law.controllers]),
        "flights": to_plain_data(compared.flights),
    }
    return EvidenceSection("In whole numbers", "\n\n".join(text), data)


# ----------------------------------------------------------------------------
# Static checks


def parse_deviations(text: str) -> list[tuple[str, tuple[str, ...], str]]:
    """Return rule, file patterns and reason of every line of ``deviations.txt``."""
    found = []
    for line in text.splitlines():
        if line.strip() and not line.startswith("#"):
            rule, files, reason = (part.strip() for part in line.split("|"))
            found.append((rule, tuple(files.split()), reason))
    return found


def judge_misra_findings(
    said: str, reasons: list[tuple[str, tuple[str, ...], str]]
) -> tuple[list[MisraFinding], Counter[str]]:
    """Return the findings against required rules, and the number of findings against each advisory rule.

    ``said`` is the output of cppcheck's MISRA checker. Each finding gets its documented reason from ``reasons``.
    """
    required, advice = [], Counter[str]()
    for file, line, rule in sorted(set(re.findall(r"^(\S+?):(\d+): misra-c2012-(\d+\.\d+):", said, re.M))):
        if rule in MISRA_ADVISORY_RULES:
            advice[rule] += 1
            continue
        reason = next((r for ours, files, r in reasons if ours == rule and any(fnmatch(file, f) for f in files)), "")
        required.append(MisraFinding(rule, f"{file}:{line}", reason))
    return required, advice


def _export_and_list_sources(vehicle: Vehicle, folder: Path) -> list[str]:
    controller = design_flight_controller(vehicle)
    export_firmware(controller, folder, vehicle)
    export_fixed_point(controller, folder)
    return [str(p.relative_to(folder)) for p in find_sources(folder, (*SOFTWARE_SOURCES, *FIXED_POINT_SOURCES))]


def _report_misra(vehicle: Vehicle, out: Path) -> EvidenceSection:
    _require_tool("cppcheck", "cppcheck")
    with tempfile.TemporaryDirectory(prefix="mufly-report-") as temporary:
        folder = Path(temporary) / "fw"
        _export_and_list_sources(vehicle, folder)
        sources = [str(p.relative_to(folder)) for p in find_sources(folder, MISRA_CHECKED_SOURCES)]
        command = [
            "cppcheck", "--addon=misra", "--std=c99", "--platform=unix32", "-DMUFLY_FLOAT",
            "-UMUFLY_DECLARATIONS", "-I.",
            "--suppress=missingIncludeSystem", "--template={file}:{line}: {id}: {message}", "-q", *sources,
        ]  # fmt: skip
        said = subprocess.run(command, cwd=folder, capture_output=True, text=True).stderr
        reasons = parse_deviations((folder / "check" / "deviations.txt").read_text(encoding="utf-8"))
    required, advice = judge_misra_findings(said, reasons)
    others = [line for line in said.splitlines() if "misra-c2012" not in line and re.match(r"\S+:\d+: \w+:", line)]
    unexplained = [f for f in required if not f.reason]
    groups = Counter((f.rule, f.reason or "**none written**") for f in required)
    places = {
        key: ", ".join(f.place for f in required if (f.rule, f.reason or "**none written**") == key) for key in groups
    }
    text = [
        f"{len(required)} findings against required rules, {len(unexplained)} without a written reason; none against "
        "mandatory ones is allowed a reason.",
        _markdown_table(
            ("rule", "findings", "where", "why it stays"),
            [(r, n, places[r, w], w) for (r, w), n in sorted(groups.items())],
        ),
        "Advice not followed: " + (", ".join(f"{r} ({n})" for r, n in sorted(advice.items())) or "none") + ".",
        "Other findings of cppcheck: " + ("; ".join(others) or "none") + ".",
    ]
    data = {
        "required": [f.__dict__ for f in required],
        "unexplained": len(unexplained),
        "advisory": advice,
        "other": others,
    }
    return EvidenceSection("MISRA C:2012", "\n\n".join(text), data)


def _report_compilers(vehicle: Vehicle, out: Path) -> EvidenceSection:
    _require_tool("gcc", "gcc")
    with tempfile.TemporaryDirectory(prefix="mufly-report-") as temporary:
        folder = Path(temporary) / "fw"
        sources = _export_and_list_sources(vehicle, folder)
        flags = [
            *COMPILER_FLAGS,
            "-Wall",
            "-Wextra",
            "-Wconversion",
            "-Wshadow",
            "-Wdouble-promotion",
            "-fanalyzer",
            "-I.",
        ]
        warnings: dict[str, list[str]] = {}
        for kind, more in (("double", []), ("single", ["-DMUFLY_FLOAT"])):
            said = subprocess.run(
                ["gcc", *flags, *more, "-c", *sources], cwd=folder, capture_output=True, text=True
            ).stderr
            warnings[kind] = re.findall(r"^(\S+:\d+:\d+: (?:warning|error): .*)$", said, re.M)
    rows = [(kind, len(found), "; ".join(found[:5]) or "none") for kind, found in warnings.items()]
    return EvidenceSection(
        "What gcc says",
        "`gcc -Wall -Wextra -Wconversion -Wshadow -Wdouble-promotion -fanalyzer`\n\n"
        + _markdown_table(("numbers", "warnings", "which"), rows),
        {"warnings": warnings},
    )


# ----------------------------------------------------------------------------
# Coverage


def _report_coverage(vehicle: Vehicle, out: Path) -> EvidenceSection:
    _require_tool("gcc", "gcc")
    _require_tool("gcov", "gcc")
    with tempfile.TemporaryDirectory(prefix="mufly-report-") as temporary:
        folder, board_folder = Path(temporary) / "fw", Path(temporary) / "board"
        _export_and_list_sources(vehicle, folder)
        if not describe_missing_fuzzer_tools():
            run_fuzzer(folder, duration_s=40.0)
        # Records of the length that Python shares with the code.
        for name, contents in render_estimator_files(None, None, 0.0).items():
            (folder / name).write_text(contents, encoding="utf-8")
        failed = _run_workload("branch_coverage", folder, vehicle)
        software = _count_branches(folder, folder)
        board_folder.mkdir()
        failed += _run_workload("board_coverage", board_folder, vehicle)
        with resources.as_file(SOURCE_FOLDER) as sources:
            board = _count_branches(board_folder, sources, BOARD_SOURCES)
    text = [
        f"Flight software and fixed point: {software.summary}. Workload: both missions flown by the C code on sensors, "
        "eight drawn flights with faults, the law in whole numbers, what the fuzzer finds in 40 s and random inputs, "
        "and the tests that compare the languages, where they are at hand.",
        software.text,
        f"Code of the board: {board.summary}. Workload: the tests of drivers, link, log, receiver, settings, storage "
        "and supervisor, where they are at hand, with a flight commanded by a station, and random inputs to the "
        "fuzzing harness. The loop of a board and the start of its processor run on no host and are not counted.",
        board.text,
        *(f"Of the workload, {line}." for line in failed),
    ]
    return EvidenceSection("Branches reached", "\n\n".join(text), {"software": software.data, "board": board.data})


def _run_workload(module: str, folder: Path, vehicle: Vehicle) -> list[str]:
    """Run a workload in a separate process, since gcov writes its counts when the process ends.

    Return the lines that report failed tests.
    """
    command = [sys.executable, "-m", f"mufly.firmware.proof.{module}", str(folder), vehicle.name]
    done = subprocess.run(command, capture_output=True, text=True)
    if done.returncode:
        raise MuflyError(f"not measured: {done.stderr.strip().splitlines()[-1:] or done.returncode}")
    return [line for line in done.stdout.splitlines() if line.startswith("pytest ended with")]


@dataclass(frozen=True)
class BranchCount:
    """Branch coverage of a part of the code.

    Attributes
    ----------
    summary : str
        Numbers of branches, taken branches and reasons, in words.
    text : str
        Tables of the files and of the reasons, in Markdown.
    data : dict
        Figures.
    """

    summary: str
    text: str
    data: dict[str, Any]


def _count_branches(folder: Path, sources: Path, patterns: tuple[str, ...] = ("*",)) -> BranchCount:
    """Return the coverage of files that match a pattern, by the counted builds in ``folder``.

    The folder ``sources`` holds the code and the reasons.
    """
    files = {
        name: lines for name, lines in read_branch_counts(folder).items() if any(fnmatch(name, p) for p in patterns)
    }
    gaps = explain_coverage_gaps(sources, files)
    rows = []
    for name, lines in sorted(files.items()):
        total, taken = sum(n for _, n, _ in lines), sum(k for _, _, k in lines)
        open_ones = [str(g.line) for g in gaps if g.file == name and not g.reason]
        if total:
            share = f"{100 * taken / total:.0f} %"
            rows.append((name, f"{taken} of {total}", share, total - taken, ", ".join(open_ones) or "none"))
    reasons = dict.fromkeys(g.reason for g in gaps if g.reason)
    why = [
        (
            sum(g.untaken_branches for g in gaps if g.reason == r),
            ", ".join(f"{g.file}:{g.line}" for g in gaps if g.reason == r),
            r,
        )
        for r in reasons
    ]
    total = sum(n for lines in files.values() for _, n, _ in lines)
    taken = sum(k for lines in files.values() for _, _, k in lines)
    unexplained = sum(g.untaken_branches for g in gaps if not g.reason)
    return BranchCount(
        f"{taken} of {total} branches ({100 * taken / max(total, 1):.1f} %); of the {total - taken} others "
        f"{total - taken - unexplained} have a written reason",
        _markdown_table(("file", "taken", "share", "not taken", "of these lines without a reason"), rows)
        + "\n\n"
        + _markdown_table(("branches", "where", "why they are not taken"), why),
        {
            "total": total,
            "taken": taken,
            "unexplained": unexplained,
            "files": {f: [x for x in lines if x[2] < x[1]] for f, lines in files.items()},
        },
    )


@dataclass(frozen=True)
class CoverageGap:
    """Line with branches not taken, and the documented reason ("" if none)."""

    file: str
    line: int
    untaken_branches: int
    reason: str


def explain_coverage_gaps(folder: Path, files: dict[str, list[tuple[int, int, int]]]) -> list[CoverageGap]:
    """Return every line with branches not taken, with the reason that ``check/branches.txt`` documents for it.

    ``files`` is the result of :func:`read_branch_counts`. A line of ``branches.txt`` is ``file | part of line |
    reason``.
    """
    known = parse_deviations((folder / "check" / "branches.txt").read_text(encoding="utf-8"))
    gaps = []
    for name, lines in sorted(files.items()):
        text = (folder / name).read_text(encoding="utf-8").splitlines()
        for line, n, k in lines:
            if k < n:
                said = text[line - 1] if line <= len(text) else ""
                reason = next((r for f, parts, r in known if f == name and " ".join(parts) in said), "")
                gaps.append(CoverageGap(name, line, n - k, reason))
    return gaps


def read_branch_counts(folder: Path) -> dict[str, list[tuple[int, int, int]]]:
    """Return line, number of branches and number of taken branches of every source with gcov counts.

    A branch of a source that several builds contain is taken if one of them takes it.
    """
    found: dict[str, dict[int, list[bool]]] = {}
    for notes in sorted(folder.rglob("*.gcno")):
        said = subprocess.run(
            ["gcov", "--json-format", "--branch-probabilities", "--stdout", str(notes)],
            cwd=folder,
            capture_output=True,
            text=True,
        ).stdout
        for text in said.splitlines():
            for file in json.loads(text)["files"]:
                path = Path(file["file"])
                name = str(path.relative_to(notes.parent) if path.is_relative_to(notes.parent) else path)
                if name.endswith(".h") or name.startswith(("/", "check")):
                    continue
                lines = found.setdefault(name, {})
                for line in file["lines"]:
                    number, now = line["line_number"], [b["count"] > 0 for b in line["branches"]]
                    if now:
                        before = lines.get(number, [])
                        lines[number] = [any(one) for one in zip_longest(before, now)]
    return {
        name: [(line, len(taken), sum(taken)) for line, taken in sorted(lines.items())] for name, lines in found.items()
    }


def _report_fuzzing(vehicle: Vehicle, out: Path) -> EvidenceSection:
    r = fuzz_firmware(vehicle, duration_s=30.0)
    ended = (
        f"**{r.sanitizer_message}** by {r.input_hex}"
        if r.sanitizer_message
        else "Nothing crashed, was undefined or out of range"
    )
    return EvidenceSection(
        "Any bytes",
        f"{ended} in {r.runs} inputs of {r.duration_s:g} s, fed to: {', '.join(r.parts)}. Longer: "
        "`mufly firmware fuzz --minutes 60`.",
        {"fuzz": to_plain_data(r)},
    )


REPORT_SECTIONS: tuple[tuple[str, Callable[[Vehicle, Path], EvidenceSection]], ...] = (
    ("The same as Python", _report_python_c_equality),
    ("On emulated processors", _report_emulated_processors),
    ("What it needs", _report_memory),
    ("In whole numbers", _report_fixed_point),
    ("What gcc says", _report_compilers),
    ("MISRA C:2012", _report_misra),
    ("Branches reached", _report_coverage),
    ("Any bytes", _report_fuzzing),
)


def measure_and_write_report(
    vehicle: Vehicle,
    out: Path,
    *,
    only: tuple[str, ...] = (),
    on_section: Callable[[EvidenceSection, int, int], None] | None = None,
) -> list[EvidenceSection]:
    """Measure all sections and write ``report.md``, its pictures and ``report.json``.

    Parameters
    ----------
    vehicle : Vehicle
    out : Path
        Folder, created if missing.
    only : tuple of str, optional
        Titles of the sections to write; all by default.
    on_section : callable, optional
        Called after each section with the section, the number of finished sections, and the total.

    Returns
    -------
    list of EvidenceSection
    """
    out.mkdir(parents=True, exist_ok=True)
    wanted = [(title, make) for title, make in REPORT_SECTIONS if not only or title in only]
    done = []
    for title, make in wanted:
        try:
            section = make(vehicle, out)
        except MuflyError as error:
            section = EvidenceSection(title, str(error), {"missing": str(error)})
        done.append(section)
        if on_section is not None:
            on_section(section, len(done), len(wanted))
    text = [
        f"# The exported code of {vehicle.name}",
        f"Written by mufly {__version__} (`mufly firmware report`).",
    ]
    text += [f"## {s.title}\n\n{s.text}" for s in done]
    (out / "report.md").write_text("\n\n".join(text) + "\n", encoding="utf-8")
    (out / "report.json").write_text(
        json.dumps({s.title: s.data for s in done}, indent=2, default=str) + "\n", encoding="utf-8"
    )
    return done
