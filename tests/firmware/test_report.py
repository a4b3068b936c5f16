"""What is said of the exported code: fuzzed, read by checkers, covered by its tests, in one report."""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
from fnmatch import fnmatch

import pytest

from mufly.control import design_flight_controller
from mufly.errors import InputError
from mufly.firmware import (
    FixedPointFlightComparison,
    describe_missing_fuzzer_tools,
    export_firmware,
    export_fixed_point,
    measure_and_write_report,
    run_fuzzer,
)
from mufly.firmware.export.source_export import find_sources
from mufly.firmware.proof.evidence_report import (
    MISRA_ADVISORY_RULES,
    MISRA_CHECKED_SOURCES,
    judge_misra_findings,
    parse_deviations,
    read_branch_counts,
)
from mufly.firmware.proof.proof_flights import draw_wind_and_fault, resume_flights
from mufly.sensors.faults import parse_fault
from mufly.vehicle import load_vehicle


@pytest.fixture(scope="module")
def vehicle():
    return load_vehicle("mufly-1.1")


@pytest.fixture(scope="module")
def tree(vehicle, tmp_path_factory):
    folder = tmp_path_factory.mktemp("report") / "fw"
    controller = design_flight_controller(vehicle)
    export_firmware(controller, folder, vehicle)
    export_fixed_point(controller, folder)
    return folder


def test_any_bytes_are_borne_and_a_fault_is_found(tree) -> None:
    """A short run; then with the guard of the sine taken away, whose cast of NaN C leaves undefined."""
    if absent := describe_missing_fuzzer_tools():
        pytest.skip(absent)
    sound = run_fuzzer(tree, duration_s=2)
    assert sound.sanitizer_message == ""
    assert sound.runs > 100
    assert set(sound.parts) == {"controllers", "avoidance", "whole numbers", "flight software", "estimator"}
    source = tree / "real.c"
    text = source.read_text()
    try:
        source.write_text(text.replace("    if (real_abs(angle) < MAX_ANGLE) {", "    if (true) {"))
        assert source.read_text() != text
        broken = run_fuzzer(tree, duration_s=90)  # ends when it has found it
    finally:
        source.write_text(text)
    assert "outside the range of representable values" in broken.sanitizer_message
    assert "real.c" in broken.sanitizer_message
    assert broken.input_hex


def test_findings_have_a_written_reason_or_are_told() -> None:
    said = (
        "a.c:3: misra-c2012-10.8: x\na.c:9: misra-c2012-10.8: x\nfixed_point/b.c:1: misra-c2012-10.8: x\n"
        "a.c:4: misra-c2012-15.5: x\na.c:5: uninitvar: y\n"
    )
    reasons = parse_deviations("# words\n\n10.8 | fixed_point/*.c c.c | It fits.\n")
    required, advice = judge_misra_findings(said, reasons)
    assert [(f.rule, f.place, f.reason) for f in required] == [
        ("10.8", "a.c:3", ""), ("10.8", "a.c:9", ""), ("10.8", "fixed_point/b.c:1", "It fits.")
    ]  # fmt: skip
    assert advice == {"15.5": 1}


def test_every_deviation_names_files_that_are_there(tree) -> None:
    names = [str(p.relative_to(tree)) for p in tree.rglob("*.[ch]")]
    found = parse_deviations((tree / "check" / "deviations.txt").read_text())
    assert len(found) >= 5
    for rule, files, reason in found:
        assert rule not in MISRA_ADVISORY_RULES
        assert len(reason) > 20
        for one in files:
            assert any(fnmatch(name, one) for name in names), one


def test_sources_of_boards_are_checked_as_well(tree) -> None:
    """All but programs of tests, QEMU's board and the Crazyflie's controller."""
    checked = {str(p.relative_to(tree)) for p in find_sources(tree, MISRA_CHECKED_SOURCES)}
    left = {str(p.relative_to(tree)) for p in tree.rglob("*.c")} - checked
    assert {name.rsplit("/", 1)[0] for name in left} <= {
        "check/models", "check/platforms", "check/programs", "boards/qemu", "boards/crazyflie",
    }  # fmt: skip
    assert {"onboard/link/mavlink.c", "boards/board.c", "boards/stm32/startup.c"} <= checked


def test_a_missing_tool_is_named_and_the_report_is_written(vehicle, tmp_path, monkeypatch) -> None:
    monkeypatch.setenv("PATH", str(tmp_path))
    wanted = ("On emulated processors", "MISRA C:2012", "What gcc says")
    sections = measure_and_write_report(vehicle, tmp_path / "report", only=wanted)
    assert {s.title for s in sections} == set(wanted)
    text = (tmp_path / "report" / "report.md").read_text()
    for package in ("gcc-arm-none-eabi", "cppcheck", "install gcc"):
        assert package in text
    told = json.loads((tmp_path / "report" / "report.json").read_text())
    assert all("install" in told[title]["missing"] for title in wanted)


@pytest.mark.skipif(not (shutil.which("gcc") and shutil.which("gcov")), reason="needs gcc with gcov")
def test_branches_are_counted(tmp_path) -> None:
    (tmp_path / "a.c").write_text(
        "int f(int x);\nint f(int x)\n{\n    return (x > 0) ? 1 : 2;\n}\nint main(void)\n{\n    return f(1) - 1;\n}\n"
    )
    for command in (["gcc", "--coverage", "-O0", "a.c", "-o", "a"], ["./a"]):
        subprocess.run(command, cwd=tmp_path, check=True)
    assert read_branch_counts(tmp_path) == {"a.c": [(4, 2, 1)]}


@pytest.mark.skipif(not (shutil.which("gcc") and shutil.which("gcov")), reason="needs gcc with gcov")
def test_branches_of_all_counted_builds_are_put_together(tmp_path) -> None:
    """Builds in the folder count, others do not; a branch counts that one of the builds takes."""
    source = "int f(int x);\nint f(int x)\n{\n    return ((x > 0) && (x < 9)) ? 1 : 2;\n}\n"
    script = """
import ctypes, sys
from pathlib import Path
from mufly.firmware.proof.board_coverage import CountedBuilds
folder = Path(sys.argv[1])
builds = CountedBuilds(folder / "counted")
for name, x in (("counted/a", 5), ("counted/b", 0), ("plain", 20)):
    library = folder / name / "f.so"
    builds.compile_library([folder / name / "f.c"], library, flags=("-O1", "-fsanitize=undefined"))
    ctypes.CDLL(str(library)).f(x)
"""
    for name in ("counted/a", "counted/b", "plain"):
        (tmp_path / name).mkdir(parents=True)
        (tmp_path / name / "f.c").write_text(source)
    subprocess.run([sys.executable, "-c", script, str(tmp_path)], check=True)
    assert read_branch_counts(tmp_path / "counted") == {"f.c": [(4, 4, 3)]}  # nowhere is x 9 or more
    assert not list((tmp_path / "plain").glob("*.gcno"))


def test_flights_of_a_campaign_are_flown_once(tmp_path) -> None:
    flown = []

    def fly(name: str, seed: int) -> FixedPointFlightComparison:
        flown.append((name, seed))
        return FixedPointFlightComparison(name, seed, "success", 10, 0, 0.001 * seed)

    keep, asked = tmp_path / "kept.jsonl", [("a", 0), ("b.toml", 0), ("a", 1)]
    first = resume_flights(FixedPointFlightComparison, keep, asked[:2], fly)
    again = resume_flights(FixedPointFlightComparison, keep, asked, fly)
    assert flown == asked
    assert again[:2] == first
    keep.write_text("{}\n")
    with pytest.raises(InputError, match="line 1"):
        resume_flights(FixedPointFlightComparison, keep, asked, fly)
    met = [draw_wind_and_fault(seed) for seed in range(60)]
    assert {bool(m.faults) for m in met} == {False, True}
    assert all(parse_fault(f).stop_s < 44.0 for m in met for f in m.faults)
