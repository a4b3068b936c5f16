"""The control law on board: the exported code is the simulation's, on this machine and on an emulated processor."""

from __future__ import annotations

import math
import re
import shutil
import subprocess
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from mufly.cli import app
from mufly.compiled.portable_math import sine_cosine
from mufly.control import DesignSettings, design_flight_controller
from mufly.control.law import SCHEDULE_FIELDS
from mufly.control.synthesis.synthesis_methods import DkIterationSettings, GivenController
from mufly.control.tuning.output_schedule import OutputSchedule, pack_schedule
from mufly.errors import InputError, MuflyError
from mufly.estimate import Estimate
from mufly.firmware import (
    Firmware,
    FirmwareControllers,
    build_library,
    describe_missing_tools,
    export_firmware,
    find_compiler,
    find_deepest_stack,
    run_pil,
    run_sil,
)
from mufly.firmware.export.source_export import find_sources, render_gains_files
from mufly.firmware.fixed_point.fixed_point_design import quantise_law
from mufly.flight.controllers import Controllers, copy_record
from mufly.vehicle import load_vehicle

COMPILERS = [path for name in ("cc", "clang") if (path := shutil.which(name))]  # what is built by cc is built once
needs_cc = pytest.mark.skipif(not COMPILERS, reason="there is no C compiler on this machine")


@pytest.fixture(scope="module", params=["mufly-1.1", "mufly-2.0"])
def controller(request):
    return design_flight_controller(load_vehicle(request.param))


@pytest.fixture(scope="module")
def tree(tmp_path_factory):
    folder = tmp_path_factory.mktemp("fw") / "fw"
    export_firmware(design_flight_controller(load_vehicle("mufly-1.1")), folder)
    return folder


def _estimate(rng, size=1.0) -> Estimate:
    position, velocity, attitude, rates = rng.normal(0.0, size, (4, 3))
    return Estimate(0.0, position, velocity, attitude, rates, np.zeros(8), float(rng.uniform(5.0, 9.0)))


def _fly_both(one: Controllers, other: Controllers, seed: int, periods: int, size: float):
    """Feed both the same, and give their outputs, period by period."""
    rng = np.random.default_rng(seed)
    start, motors = _estimate(rng, size), rng.uniform(0.0, 1.0, 2)
    for c in (one, other):
        c.engage_heave_yaw(start, motors)
    for k in range(periods):
        now, wanted = _estimate(rng, size), rng.normal(0.0, size, 4)
        flying = k >= 20
        if k == 20 or k == periods // 2:
            for c in (one, other):
                c.engage_roll_pitch(now)
        if flying and k % 4 == 0:
            path = rng.normal(0.0, size, (3, 3))
            tilts = [c.compute_tilt_command(now, *path) for c in (one, other)]
            yield tilts
            tilt = tilts[0]
        yield [c.step(now, wanted, tilt if flying else None).input_array for c in (one, other)]


@needs_cc
@pytest.mark.parametrize("cc", COMPILERS, ids=lambda path: Path(path).name)
def test_exported_code_is_the_law_to_the_last_bit_whatever_is_asked(controller, cc) -> None:
    """Small errors, and such that everything saturates and the reference waits."""
    firmware = Firmware(controller, cc=cc)
    for seed, size in enumerate((1e-3, 0.1, 3.0, 1e3)):
        pairs = list(_fly_both(Controllers(controller), FirmwareControllers(controller, firmware), seed, 300, size))
        assert len(pairs) == 370
        assert all(a.tobytes() == b.tobytes() for a, b in pairs)


def _settings_of(method: str) -> DesignSettings:
    """Return settings of a method; the tuned law of order 2 stands for all of fixed order."""
    if method == "mu":
        return DesignSettings(method="mu", robust_goals=DkIterationSettings(rounds=1, frequencies=(3.0, 30.0, 4)))
    if method == "tuned":
        K = GivenController(
            A=((-0.0523, -0.0013), (0.0017, -0.0499)),
            B=((-5.94, 0.02, -0.0476, 0.002), (0.006, 6.88, -0.0024, 0.0717)),
            C=((0.001, -8.57), (-8.13, -0.011)),
            D=((0.07, -12.67, 0.0085, -0.937), (9.72, -0.112, 0.724, -0.0085)),
        )
        return DesignSettings(roll_pitch_given=K)
    return DesignSettings(method=method)


@needs_cc
@pytest.mark.parametrize("method", ["h2", "lqg", "ltr", "mu", "tuned", "indi"])
def test_designs_of_other_methods_are_the_same_law(method) -> None:
    other = design_flight_controller(load_vehicle("mufly-1.1"), settings=_settings_of(method))
    firmware = Firmware(other)
    for seed, size in ((0, 0.1), (1, 3.0)):
        pairs = list(_fly_both(Controllers(other), FirmwareControllers(other, firmware), seed, 200, size))
        assert all(a.tobytes() == b.tobytes() for a, b in pairs)


@needs_cc
def test_a_schedule_over_speed_is_the_same_law_and_costs_other_designs_nothing(tmp_path) -> None:
    """Speeds of the flights reach beyond the scheduled one; any difference of the outputs serves as a schedule."""
    plain = design_flight_controller(load_vehicle("mufly-1.1"), settings=_settings_of("tuned"))
    K = plain.roll_pitch.discrete
    schedule = OutputSchedule(2.0, 0.3 * K.C, -0.2 * K.D, True, (), 0.9, 1.0, 30.0)
    gains = copy_record(plain.roll_pitch_gains)
    for name, value in pack_schedule(schedule).items():
        gains[name] = value
    other = replace(plain, roll_pitch_gains=gains, schedule=schedule)
    firmware = Firmware(other)
    for seed, size in ((0, 0.1), (1, 3.0)):
        pairs = list(_fly_both(Controllers(other), FirmwareControllers(other, firmware), seed, 200, size))
        assert all(a.tobytes() == b.tobytes() for a, b in pairs)
        unscheduled = list(_fly_both(Controllers(other), Controllers(plain), seed, 200, size))
        assert any(a.tobytes() != b.tobytes() for a, b in unscheduled)
    exports = [render_gains_files(c) for c in (plain, other)]
    assert [set(files) for files in exports] == [{"tables.c"}, {"tables.c", "control/schedule.h"}]
    assert ["C_forward_change" in files["tables.c"] for files in exports] == [False, True]
    assert "#define ROLL_PITCH_SCHEDULED 1" in exports[1]["control/schedule.h"]
    export_firmware(plain, tmp_path / "fw")
    assert "#define ROLL_PITCH_SCHEDULED 0" in (tmp_path / "fw/control/schedule.h").read_text()
    with pytest.raises(MuflyError, match="no schedule over speed"):
        quantise_law(other)


@needs_cc
def test_numbers_that_change_in_flight_change_in_the_exported_code_too(controller) -> None:
    gains = copy_record(controller.position_gains)
    gains["position_gain"] *= 1.3
    other = replace(controller, position_gains=gains)
    one, two = Controllers(controller), FirmwareControllers(controller)
    for c in (one, two):
        c.retune_gains(other)
    pairs = list(_fly_both(one, two, 3, 200, 0.1))
    assert all(a.tobytes() == b.tobytes() for a, b in pairs)
    fixed = list(_fly_both(Controllers(controller), Controllers(other), 3, 200, 0.1))
    assert any(a.tobytes() != b.tobytes() for a, b in fixed)


@needs_cc
def test_code_with_another_vehicles_numbers_differs(controller) -> None:
    """The comparison can fail."""
    other = design_flight_controller(
        load_vehicle("mufly-2.0" if controller.vehicle_name != "mufly-2.0" else "mufly-1.1")
    )
    wrong = FirmwareControllers(other)
    pairs = list(_fly_both(Controllers(controller), wrong, 1, 60, 0.1))
    assert any(a.tobytes() != b.tobytes() for a, b in pairs)


@needs_cc
def test_a_mission_flown_beside_it_shows_no_difference() -> None:
    (one,) = run_sil(load_vehicle("mufly-1.1"), ["box-on-leg"], wind=[0.5, 0.0, 0.0], gust=0.3).flights
    assert one.outcome == "succeeded"
    assert 5000 < one.periods < one.estimator_periods
    assert one.different == one.estimator_different == one.steps_different == 0
    assert one.steps > one.periods
    assert one.log_entry_count > 5
    # Single precision: the integrators' rounding adds up over the flight, in a comparison that nothing corrects.
    assert 0.0 < one.worst_single < 1e-4


@needs_cc
def test_it_flies_the_mission_as_python_does(tmp_path) -> None:
    from mufly.flight import fly_mission, read_recording

    python = fly_mission("mufly-1.1", "box-on-leg")
    result = CliRunner().invoke(
        app, ["fly", "box-on-leg", "--firmware", "--headless", "--sensors", "ideal", "--out", str(tmp_path)]
    )
    assert result.exit_code == 0, result.output
    assert "exported C code" in result.output
    flown = read_recording(tmp_path / "flight.mcap")
    for name in ("truth_position", "motor_input", "servo_input"):
        assert np.array_equal(python[name].values, flown[name].values), name


@pytest.mark.skipif(bool(describe_missing_tools()) or not COMPILERS, reason=describe_missing_tools() or "no C compiler")
def test_an_emulated_processor_computes_the_same() -> None:
    results = run_pil(load_vehicle("mufly-1.1")).processors
    assert {r.machine for r in results} == {"mps2-an386", "netduinoplus2"}
    for r in results:
        assert r.same
        least, most = {"law": (1500, 10_000), "flight": (3500, 100_000), "estimator": (10_000, 100_000)}[r.tested_part]
        assert least < r.mean_instructions < r.worst_instructions < most
        assert r.flash_bytes < 66_000
        assert r.ram_bytes == 0
        assert 100 < r.stack_bytes < (1000 if r.tested_part == "law" else 4000)
    # Two clocks of different speed count the same instructions.
    assert results[0].mean_instructions == pytest.approx(results[1].mean_instructions, rel=1e-3)


@needs_cc
def test_any_optimisation_gives_the_same_and_no_warning(tree) -> None:
    right = None
    for level in ("-O0", "-O3"):
        flags = [
            "-std=c99",
            level,
            "-ffp-contract=off",
            "-Wall",
            "-Wextra",
            "-Wconversion",
            "-Wshadow",
            "-pedantic",
        ]
        software = [str(p.relative_to(tree)) for p in find_sources(tree)]
        sources = [*software, "check/programs/selftest.c", "check/platforms/platform_host.c"]
        command = [find_compiler(), *flags, "-Werror", "-I.", *sources, "-o", "try", "-lm"]
        done = subprocess.run(command, cwd=tree, capture_output=True, text=True)
        assert done.returncode == 0, done.stderr
        said = subprocess.run([str(tree / "try")], capture_output=True, text=True).stdout
        assert len(re.findall("^outputs ", said, re.M)) == 41
        right = right or said
        assert said == right


def test_every_number_in_the_tables_is_the_controllers(tree) -> None:
    """Read back from the text: all numbers, in order, to the last bit."""
    text = (tree / "tables.c").read_text()
    told = [float.fromhex(x) for x in re.findall(r"REAL\(([^)]+)\)", text)]
    c = design_flight_controller(load_vehicle("mufly-1.1"))
    right = np.concatenate(
        [
            np.ravel(r[name])
            for r in (c.heave_yaw_gains, c.roll_pitch_gains, c.position_gains)
            for name in r.dtype.names
            if name not in SCHEDULE_FIELDS
        ]
    )
    assert np.array_equal(told, right)
    assert "mufly_rate_Hz = 200;" in text
    assert "mufly_position_divider = 4;" in text
    assert "/* 7.2 V */" in text


def test_a_folder_that_holds_something_else_is_left_alone(tmp_path, tree) -> None:
    (tmp_path / "mine.txt").write_text("keep")
    with pytest.raises(InputError, match="contains files of another origin"):
        export_firmware(design_flight_controller(load_vehicle("mufly-1.1")), tmp_path)
    assert [p.name for p in tmp_path.iterdir()] == ["mine.txt"]
    export_firmware(design_flight_controller(load_vehicle("mufly-2.0")), tree)  # over an earlier one
    assert "mufly-2.0" in (tree / "tables.c").read_text()
    export_firmware(design_flight_controller(load_vehicle("mufly-1.1")), tree)


def test_without_a_compiler_one_line_says_what_to_install(monkeypatch, tmp_path) -> None:
    monkeypatch.setenv("PATH", str(tmp_path))
    monkeypatch.delenv("CC", raising=False)
    result = CliRunner().invoke(app, ["firmware", "sil"])
    assert isinstance(result.exception, MuflyError)
    assert "apt-get install gcc" in str(result.exception)
    with pytest.raises(MuflyError, match="apt-get install gcc-arm-none-eabi qemu-system-arm"):
        run_pil(load_vehicle("mufly-1.1"))


@needs_cc
def test_what_the_compiler_says_first_is_told(tmp_path, tree) -> None:
    shutil.copytree(tree, tmp_path / "fw", ignore=shutil.ignore_patterns("*.c"))
    (tmp_path / "fw" / "control" / "law.c").write_text("nonsense\n")
    with pytest.raises(MuflyError, match=r"could not build .*law\.c:1"):
        build_library(tmp_path / "fw")


def test_recursion_and_unknown_stack_have_no_bound(tmp_path) -> None:
    (tmp_path / "a.su").write_text("a.c:1:2:begin\t16\tstatic\na.c:9:2:loop\t8\tstatic\na.c:12:2:leaf\t40\tstatic\n")
    call = '(call_insn 5 4 6 2 (call (mem:SI (symbol_ref:SI ("{}") [flags 0x3])'
    dump = tmp_path / "a.c.expand"
    dump.write_text(
        f";; Function begin (begin)\n{call.format('loop')}\n;; Function loop (loop)\n{call.format('leaf')}\n"
    )
    assert find_deepest_stack(tmp_path, "begin") == 16 + 8 + 40
    dump.write_text(dump.read_text() + f";; Function leaf (leaf)\n{call.format('loop')}\n")
    with pytest.raises(MuflyError, match="calls itself"):
        find_deepest_stack(tmp_path, "begin")
    (tmp_path / "a.su").write_text("a.c:1:2:begin\t16\tdynamic\n")
    with pytest.raises(MuflyError, match="dynamic"):
        find_deepest_stack(tmp_path, "begin")


def test_sine_and_cosine_are_right_to_the_last_place() -> None:
    angles = np.concatenate([np.linspace(-8.0, 8.0, 4001), np.random.default_rng(0).uniform(-9e4, 9e4, 1000)])
    for x in angles.tolist():
        for ours, right in zip(sine_cosine(x), (math.sin(x), math.cos(x)), strict=True):
            assert abs(ours - right) <= 2 * math.ulp(right)
    assert sine_cosine(math.nan) == sine_cosine(math.inf) == (0.0, 1.0)


@needs_cc
def test_both_languages_take_the_same_sine(tree) -> None:
    import cffi

    ffi = cffi.FFI()
    ffi.cdef("void sine_cosine(double angle, double *sine, double *cosine);")
    lib = ffi.dlopen(str(build_library(tree)))
    s, c = ffi.new("double *"), ffi.new("double *")
    for x in [*np.random.default_rng(1).uniform(-1e5, 1e5, 2000).tolist(), 0.0, -0.0, 1e300, math.nan, 1e5]:
        lib.sine_cosine(x, s, c)
        assert (s[0], c[0]) == sine_cosine(x)


def test_the_command_writes_a_tree_that_says_what_it_is(tmp_path) -> None:
    result = CliRunner().invoke(app, ["firmware", "export", "--vehicle", "mufly-2.0", "--out", str(tmp_path / "fw")])
    assert result.exit_code == 0, result.output
    assert "mufly-2.0" in result.output
    for name in (
        "control/law.c",
        "control/cascade.c",
        "control/mixer.c",
        "tables.c",
        "Makefile",
        "CMakeLists.txt",
        "README.md",
    ):
        assert (tmp_path / "fw" / name).exists()
    licence = Path(__file__).parents[2] / "LICENSE"
    assert (tmp_path / "fw" / "LICENSE").read_text() == licence.read_text()  # its terms require a copy with the sources
    if COMPILERS and shutil.which("make"):
        done = subprocess.run(["make", "-C", str(tmp_path / "fw"), "check"], capture_output=True, text=True)
        assert done.returncode == 0, done.stderr
        assert "warning" not in done.stderr
