"""Compare the exported code with Python (software in the loop) and on emulated processors (processor in the loop).

Software in the loop (:func:`run_sil`): Python's estimator and controllers fly a mission. The exported code gets the
same inputs in every period. Its outputs, and the whole memory of the estimator, are compared bit for bit.

Processor in the loop (:func:`run_pil`): a self-test with synthetic inputs runs on this machine and on Cortex-M
processors emulated by QEMU; both print digests of all outputs so far. Instructions are counted by the processor's
clock, which QEMU advances by a nanosecond an instruction.
"""

from __future__ import annotations

import functools
import re
import shutil
import subprocess
import tempfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from mufly.compiled.toolchain import COMPILER_FLAGS, find_compiler
from mufly.control import FlightController, design_flight_controller
from mufly.errors import MuflyError
from mufly.estimate import Estimate, Estimator, KalmanEstimator
from mufly.estimate.filter.c_records import PYTHON_ONLY_FIELDS
from mufly.firmware.compiled_software import ComparedSoftware, make_compared_software
from mufly.firmware.export.source_export import (
    FIXED_POINT_SOURCES,
    SOFTWARE_SOURCES,
    export_firmware,
    find_sources,
)
from mufly.firmware.fixed_point.fixed_point_law import export_fixed_point
from mufly.firmware.host_build import Firmware, FirmwareControllers
from mufly.firmware.proof.proof_flights import add_random_obstacle, draw_wind_and_fault, resume_flights
from mufly.flight import fly_mission
from mufly.flight.controllers import Actuators, Controllers
from mufly.mission import load_mission, parse_mission
from mufly.results import ResultColumn, ShownBlock, make_lines_block, result, tabulate_results
from mufly.sensors import Readings
from mufly.sensors.faults import Fault, parse_fault
from mufly.vehicle import Vehicle
from mufly.world import Room, World

_Array = NDArray[np.floating[Any]]


@dataclass(frozen=True)
class ArithmeticBuild:
    """Build options for one kind of arithmetic, and the emulated processors on which its self-tests run.

    Attributes
    ----------
    source_patterns : tuple of str
        Patterns of its C files in the tree.
    compiler_flags : tuple of str
        Flags for every compiler.
    ram_size : str
        RAM of the smallest board, as the linker limit of all boards.
    self_tests : dict
        Programs of ``check/programs/``, and name prefixes of the measured functions.
    emulated_boards : dict
        Processor flags and instructions per tick of the board's clock, by board.
    """

    source_patterns: tuple[str, ...]
    compiler_flags: tuple[str, ...]
    ram_size: str
    self_tests: Mapping[str, tuple[str, str]]
    emulated_boards: Mapping[str, tuple[tuple[str, ...], float]]


CORTEX_M4_FLAGS = (
    "-mcpu=cortex-m4", "-mfloat-abi=hard", "-mfpu=fpv4-sp-d16",
    "-Os", "-fno-move-loop-invariants", "-fno-schedule-insns2", "-fno-expensive-optimizations", "-fno-reorder-blocks",
)  # fmt: skip
"""Target and optimisation: without these four passes, GCC's code takes 1.8 % less flash and no more instructions."""
SPEED_OPTIMISED_SOURCES = ("control/linear.c",)
"""Sources built with ``-O2``, which saves instructions there. Elsewhere ``-Os`` needs no more, in 80 % of the flash."""
SINGLE_PRECISION_BUILD = ArithmeticBuild(
    source_patterns=SOFTWARE_SOURCES,
    compiler_flags=("-DMUFLY_FLOAT",),
    ram_size="64K",
    self_tests={
        "law": ("selftest", "controllers_"),
        "flight": ("selftest_flight", "software_"),
        "estimator": ("selftest_estimate", "estimator_"),
    },
    emulated_boards={
        "mps2-an386": (CORTEX_M4_FLAGS, 40.0),
        "netduinoplus2": (CORTEX_M4_FLAGS, 1000.0 / 168.0),
    },  # 25 and 168 MHz
)
"""Build in single precision, for processors with a floating-point unit."""

FIXED_POINT_BUILD = ArithmeticBuild(
    source_patterns=FIXED_POINT_SOURCES,
    compiler_flags=(),
    ram_size="16K",
    self_tests={"law": ("selftest_fixed", "fixed_")},
    emulated_boards={
        "mps2-an385 (cortex-m3)": (("-mcpu=cortex-m3",), 40.0),
        "mps2-an386 (cortex-m4)": (("-mcpu=cortex-m4",), 40.0),
        "microbit (cortex-m0)": (("-mcpu=cortex-m0",), 62.5),  # 16 MHz
    },
)
"""Build of the fixed-point law, for processors without a floating-point unit."""

_SELFTEST_WORLD = World(room=Room((-1.2, 1.2), (-1.2, 1.2), 3.0))
"""World of the estimator's self-test: all beams hit a wall, the case of the most computation."""
_SELFTEST_MISSION: dict[str, Any] = {
    "name": "curves",
    "avoidance": {"scan": True},
    "path": {"kind": "spline"},
    "waypoint": [
        {"position_m": [1.0, 0.0, -1.0]},
        {"position_m": [2.0, 1.0, -1.5], "speed_m_s": 0.3},
        {"position_m": [1.0, 2.0, -1.0]},
    ],
}
"""Mission of the flight self-test: curves, nose scans and a full obstacle map, the case of the most computation."""
_SELFTEST_TIMEOUT_S = 120.0  # of a self-test
_REQUIRED_TOOLS = {"arm-none-eabi-gcc": "gcc-arm-none-eabi", "qemu-system-arm": "qemu-system-arm"}


@result
class SilResult:
    """Comparison of the exported code with the Python code that flies a mission, on the same inputs.

    Attributes
    ----------
    mission : str
    seed : int
    outcome : str
        Outcome of the flight.
    faults : str
        Sensor faults of the flight.
    periods : int
        Number of compared control periods.
    different : int
        Number of controller outputs (position cascade, or all actuators) that differ in any bit in double precision.
    estimator_periods : int
        Number of compared estimator periods; zero on ideal sensors.
    estimator_different : int
        Number of these after which any bit of the estimator's memory differs.
    steps : int
        Number of compared periods of the whole flight software: actuators, reference, mission state and log.
    steps_different : int
        Number of these with a difference in any bit or text.
    log_entry_count : int
        Number of log entries, compared as texts.
    worst_single : float
        Largest actuator difference in single precision, over the full range (1).
    """

    mission: str
    seed: int
    outcome: str
    faults: str
    periods: int
    different: int
    estimator_periods: int
    estimator_different: int
    steps: int
    steps_different: int
    log_entry_count: int
    worst_single: float


_COMPARED_PARTS = (
    ("law", "periods", "different"),
    ("estimator", "estimator_periods", "estimator_different"),
    ("flight software", "steps", "steps_different"),
)
"""Compared parts, and the fields of their periods in a :class:`SilResult`: all, and those that differ."""


@result
class SilComparison:
    """Flights in which the exported code is compared with the Python code.

    Attributes
    ----------
    flights : list of SilResult
    """

    flights: list[SilResult]

    @property
    def mismatch_count(self) -> int:
        """Number of periods of any part that differ."""
        return sum(getattr(flight, name) for flight in self.flights for _, _, name in _COMPARED_PARTS)

    def make_printed_blocks(self) -> list[ShownBlock]:
        """Return as printed text the flights, and the number of periods that differ."""

        def total(name: str) -> int:
            return sum(getattr(flight, name) for flight in self.flights)

        counts = [
            ResultColumn(name, head=head)
            for part, *names in _COMPARED_PARTS
            for name, head in zip(names, (part, "differ"), strict=True)
        ]
        error = ResultColumn("worst_single", form=".1e", head="error in single precision")
        log = ResultColumn("log_entry_count", head="log")
        told = ", ".join(f"{total(differ)} of {total(every)} of the {part}" for part, every, differ in _COMPARED_PARTS)
        return [
            tabulate_results(self.flights, ["mission", "seed", "outcome", *counts, log, error]),
            make_lines_block(f"Periods with different bits: {told}.", style="red" if self.mismatch_count else ""),
        ]


@result
class PilResult:
    """Result of a self-test on an emulated processor.

    Attributes
    ----------
    machine : str
    tested_part : str
        ``"law"``: controllers; ``"flight"``: controllers, mission and monitors; ``"estimator"``.
    same : bool
        Whether all output digests equal those of this machine in single precision.
    mean_instructions, worst_instructions : float
        Instructions per period.
    flash_bytes, ram_bytes : int
        Size of all code and constants of the tree (bytes); the caller allocates the variables.
    stack_bytes : int
        Stack of the deepest call path, from the compiler's stack report of each function (bytes).
    """

    machine: str
    tested_part: str
    same: bool
    mean_instructions: float
    worst_instructions: float
    flash_bytes: int
    ram_bytes: int
    stack_bytes: int


@result(json="processors")
class PilComparison:
    """Self-tests on emulated processors, compared with this machine.

    Attributes
    ----------
    processors : list of PilResult
    arithmetic : str
        Arithmetic and optimisation of the code.
    """

    processors: list[PilResult]
    arithmetic: str

    def make_printed_blocks(self) -> list[ShownBlock]:
        """Return the self-tests as printed text."""
        instructions = ResultColumn("mean_instructions", form=".0f"), ResultColumn("worst_instructions", form=".0f")
        columns = ("machine", "tested_part", "same", *instructions, "flash_bytes", "stack_bytes")
        return [
            tabulate_results(self.processors, columns, title=self.arithmetic),
            make_lines_block(
                "Instructions of a period, on synthetic estimates (estimator: a synthetic hop in a room); flash of all "
                "code and constants; stack of the deepest call."
            ),
        ]


class _ComparedControllers(Controllers):
    """Python controllers that compare their outputs with those of the exported code, in double and in single
    precision.
    """

    def __init__(self, design: FlightController, double: Firmware, single: Firmware) -> None:
        super().__init__(design)
        self._implementations: tuple[Controllers, ...] = (
            Controllers(design),
            FirmwareControllers(design, double),
            FirmwareControllers(design, single),
        )
        self.period_count = self.mismatch_count = 0
        self.worst_single = 0.0

    def retune_gains(self, design: FlightController) -> None:
        for one in self._implementations:
            one.retune_gains(design)

    def engage_heave_yaw(self, estimate: Estimate, motor_input: _Array) -> None:
        for one in self._implementations:
            one.engage_heave_yaw(estimate, motor_input)

    def engage_roll_pitch(self, estimate: Estimate) -> None:
        for one in self._implementations:
            one.engage_roll_pitch(estimate)

    def compute_tilt_command(
        self, estimate: Estimate, position: _Array, velocity: _Array, acceleration: _Array
    ) -> _Array:
        right, double, _ = (
            one.compute_tilt_command(estimate, position, velocity, acceleration) for one in self._implementations
        )
        self.mismatch_count += right.tobytes() != double.tobytes()
        return right

    def step(self, estimate: Estimate, heave_yaw: _Array, tilt: _Array | None) -> Actuators:
        right, double, single = (one.step(estimate, heave_yaw, tilt).input_array for one in self._implementations)
        self.period_count += 1
        self.mismatch_count += right.tobytes() != double.tobytes()
        # Motor inputs range from 0 to 1, servo inputs from -1 to 1.
        off = np.abs(single - right) / [1.0, 1.0, 2.0, 2.0]
        self.worst_single = max(self.worst_single, float(off.max()))
        return Actuators(right[:2], right[2:])


class _ComparedEstimators(Estimator):
    """Python estimator that compares its memory with that of the exported code on the same readings."""

    def __init__(self, vehicle: Vehicle, world: World, rate_Hz: float) -> None:
        self._python_estimator = KalmanEstimator(vehicle, world, rate_Hz, code="numba")
        self._c_estimator = KalmanEstimator(vehicle, world, rate_Hz, code="c")
        self.period_count = self.mismatch_count = 0

    def update(self, readings: Readings, acting: NDArray[np.float64] | None = None) -> Estimate:
        told = self._python_estimator.update(readings, acting)
        also = self._c_estimator.update(readings, acting)
        self.period_count += 1
        self.mismatch_count += told.valid != also.valid or comparable_memory_bytes(
            self._python_estimator
        ) != comparable_memory_bytes(self._c_estimator)
        return told

    def reset(self) -> None:
        self._python_estimator.reset()
        self._c_estimator.reset()


def comparable_memory_bytes(estimator: KalmanEstimator) -> bytes:
    """Return the memory of an estimator as bytes, without the fields that only the Python version has."""
    memory = estimator.memory
    return memory.tobytes()[: memory.dtype.fields[PYTHON_ONLY_FIELDS[0]][1]]


def run_sil(
    vehicle: Vehicle,
    missions: Sequence[str],
    *,
    flights: int = 1,
    wind: Sequence[float] | None = None,
    gust: float | None = None,
    sensors: Literal["fitted", "ideal"] = "fitted",
    faults: Sequence[Fault] = (),
    drawn: bool = False,
    keep: Path | None = None,
    on_flight: Callable[[SilResult], None] | None = None,
) -> SilComparison:
    """Fly missions and compare the exported code with Python in every period.

    Parameters
    ----------
    vehicle : Vehicle
    missions : sequence of str
        Names or files.
    flights : int
        Number of flights of each mission, with seeds from 0.
    wind : (3,) sequence, optional
        Velocity of the steady wind, N, E, D (m/s); by default that of the missions.
    gust : float, optional
        Gusts (m/s); by default those of the missions.
    sensors : "fitted" or "ideal"
        Sensors of the flight; the estimator is compared on fitted sensors only.
    faults : sequence of Fault
        Sensor faults.
    drawn : bool
        Whether to draw wind, gusts, faults and an obstacle by the seed (:mod:`mufly.firmware.proof.proof_flights`).
    keep : path, optional
        File of results; stored flights are not repeated.
    on_flight : callable, optional
        Called with every result.

    Raises
    ------
    MuflyError
        If there is no C compiler, or the mission cannot be flown by the vehicle.
    """
    controller = design_flight_controller(vehicle)
    double, single = Firmware(controller), Firmware(controller, single=True)

    def fly_compared(name: str, seed: int) -> SilResult:
        mission = load_mission(name)
        w, g, wrong = wind, gust, tuple(faults)
        if drawn:
            met, mission = draw_wind_and_fault(seed), add_random_obstacle(mission, seed)
            w, g, wrong = [met.wind, 0.0, 0.0], met.gust, tuple(parse_fault(f) for f in met.faults)
        twins: list[_ComparedControllers] = []
        flown: list[ComparedSoftware] = []

        def make_compared_controllers(c: FlightController) -> _ComparedControllers:
            twins.append(_ComparedControllers(c, double, single))
            return twins[-1]

        felt = sensors == "fitted" and vehicle.sensors is not None
        believing = _ComparedEstimators(vehicle, mission.world, controller.rate_Hz) if felt else None
        record = fly_mission(
            vehicle, mission, controller=controller, seed=seed, gust=g,
            controllers=make_compared_software(make_compared_controllers, double, flown),
            wind=w, estimator=believing,
            sensors="fitted" if felt else "ideal", faults=wrong,
        )  # fmt: skip
        return SilResult(
            mission=mission.name or name, seed=seed, outcome=record.attrs["outcome"],
            faults=" ".join(map(str, wrong)),
            periods=sum(t.period_count for t in twins), different=sum(t.mismatch_count for t in twins),
            estimator_periods=0 if believing is None else believing.period_count,
            estimator_different=0 if believing is None else believing.mismatch_count,
            steps=sum(f.period_count for f in flown), steps_different=sum(f.mismatch_count for f in flown),
            log_entry_count=sum(f.log_entry_count for f in flown), worst_single=max(t.worst_single for t in twins),
        )  # fmt: skip

    asked = [(name, seed) for seed in range(flights) for name in missions]
    return SilComparison(resume_flights(SilResult, keep, asked, fly_compared, on_flight))


def describe_missing_tools() -> str:
    """Return the tools missing for :func:`run_pil` as one line; "" if all are installed."""
    absent = [package for tool, package in _REQUIRED_TOOLS.items() if shutil.which(tool) is None]
    return f"install {' and '.join(absent)} (Debian, Ubuntu: apt-get install {' '.join(absent)})" if absent else ""


def run_pil(vehicle: Vehicle, *, fixed_point: bool = False) -> PilComparison:
    """Run self-tests on emulated Cortex-M processors: of the flight software, or of the fixed-point law.

    Raises
    ------
    MuflyError
        If a tool is missing, or an emulated program does not end.
    """
    absent = describe_missing_tools()
    if absent:
        raise MuflyError(f"processor in the loop: {absent}")
    how = FIXED_POINT_BUILD if fixed_point else SINGLE_PRECISION_BUILD
    with tempfile.TemporaryDirectory(prefix="mufly-pil-") as temporary:
        folder = Path(temporary) / "fw"
        controller = design_flight_controller(vehicle)
        export_firmware(controller, folder, vehicle, _SELFTEST_WORLD, parse_mission(_SELFTEST_MISSION))
        if fixed_point:
            export_fixed_point(controller, folder)
        objects = {cpu: compile_objects(folder, how, cpu) for cpu in {cpu for cpu, _ in how.emulated_boards.values()}}
        found = []
        for what, (test, entry) in how.self_tests.items():
            right = parse_digests(run_program([str(_build_host_selftest(folder, how, test))]))
            programs = {cpu: _link_selftest(folder, how, cpu, test) for cpu in objects}
            for board, (cpu, per_tick) in how.emulated_boards.items():
                flash, ram = measure_code_size(objects[cpu])
                found.append(
                    PilResult(
                        machine=board,
                        tested_part=what,
                        **run_emulated_selftest(board.split()[0], per_tick, programs[cpu], right),
                        flash_bytes=flash,
                        ram_bytes=ram,
                        stack_bytes=find_deepest_stack(objects[cpu], entry),
                    )
                )
        return PilComparison(found, "Integers, gcc -O2" if fixed_point else "Single precision, gcc -Os")


_CONTROL_LAW_SOURCES = ("controllers.c", "law.c", "linear.c", "cascade.c", "mixer.c", "real.c", "tables.c")


def measure_law_instructions(vehicle: Vehicle, controllers: Sequence[FlightController]) -> list[float]:
    """Return the mean number of instructions of the control law per period on a Cortex-M4, for every controller.

    All controllers use arrays of the largest order, so the numbers differ only where the self-test saturates.

    Raises
    ------
    MuflyError
        If a tool is missing, or a program does not end.
    """
    absent = describe_missing_tools()
    if absent:
        raise MuflyError(f"instructions of the law: {absent}")
    how, machine = SINGLE_PRECISION_BUILD, "mps2-an386"
    cpu, per_tick = how.emulated_boards[machine]
    counts: list[float] = []
    with tempfile.TemporaryDirectory(prefix="mufly-law-") as temporary:
        for k, controller in enumerate(controllers):
            folder = Path(temporary) / str(k)
            export_firmware(controller, folder, vehicle)
            for source in find_sources(folder):
                if source.name not in _CONTROL_LAW_SOURCES:
                    source.unlink()
            compile_objects(folder, how, cpu)
            elf = _link_selftest(folder, how, cpu, "selftest")
            counts.append(run_emulated_selftest(machine, per_tick, elf, [])["mean_instructions"])
    return counts


def run_emulated_selftest(machine: str, per_tick: float, elf: Path, right: list[str]) -> dict[str, Any]:
    """Run a self-test on an emulated board; return whether its digests equal ``right``, and the instructions per
    period.

    Raises
    ------
    MuflyError
        If the program does not end.
    """
    said = run_program(
        [
            "qemu-system-arm", "-M", machine, "-nographic", "-monitor", "none", "-serial", "none",
            "-semihosting-config", "enable=on,target=native", "-icount", "shift=0", "-kernel", str(elf),
        ]
    )  # fmt: skip
    numbers = {k: int(v, 16) for k, v in re.findall(r"^(periods|ticks|worst) ([0-9a-f]{16})$", said, re.M)}
    if len(numbers) < 3:
        raise MuflyError(f"{machine}: the self-test did not end; it said {said[-200:]!r}")
    return {
        "same": parse_digests(said) == right and bool(right),
        "mean_instructions": numbers["ticks"] * per_tick / numbers["periods"],
        "worst_instructions": numbers["worst"] * per_tick,
    }


def parse_digests(said: str) -> list[str]:
    """Return the digests that a self-test printed."""
    return re.findall(r"^outputs ([0-9a-f]{16})$", said, re.M)


def run_program(command: list[str]) -> str:
    """Run a program and return its output, including standard error."""
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=_SELFTEST_TIMEOUT_S)
    except subprocess.TimeoutExpired:
        raise MuflyError(f"{command[0]} did not end within {_SELFTEST_TIMEOUT_S:g} s") from None
    return done.stdout + done.stderr  # semihosting output appears on standard error


def run_compiler(command: list[str], folder: Path) -> None:
    """Run a compiler in a folder; raise its first error as a :class:`MuflyError`."""
    done = subprocess.run(command, capture_output=True, text=True, cwd=folder)
    if done.returncode:
        first = next((line for line in done.stderr.splitlines() if "error" in line), done.stderr[:200])
        raise MuflyError(f"{command[0]} could not build the self-test: {first}")


def _compiler_command(folder: Path, how: ArithmeticBuild, cpu: tuple[str, ...], *more: object) -> list[str]:
    """Return the compiler command for the processor ``cpu``, or for this machine if ``cpu`` is empty."""
    there = ("arm-none-eabi-gcc", *COMPILER_FLAGS, *cpu, "-mthumb", "-ffreestanding", "-nostdlib")
    cc = there if cpu else (find_compiler(), *COMPILER_FLAGS)
    return [*cc, *how.compiler_flags, f"-I{folder}", *map(str, more)]


def _selftest_sources(test: str, *platform: str) -> tuple[str, ...]:
    return f"check/programs/{test}.c", *platform


def _build_host_selftest(folder: Path, how: ArithmeticBuild, test: str) -> Path:
    out = folder / test
    parts = (*find_sources(folder, how.source_patterns), *_selftest_sources(test, "check/platforms/platform_host.c"))
    run_compiler(_compiler_command(folder, how, (), *parts, "-o", out, "-lm"), folder)
    return out


def compile_objects(folder: Path, how: ArithmeticBuild, cpu: tuple[str, ...]) -> Path:
    """Compile a tree for a processor; return the folder with the objects and the compiler's stack reports."""
    objects = folder / cpu[0].removeprefix("-mcpu=")
    objects.mkdir()
    told = ("-fstack-usage", "-fdump-rtl-expand", "-c")
    sources = find_sources(folder, how.source_patterns)
    quick = [c for c in sources if str(c.relative_to(folder)) in SPEED_OPTIMISED_SOURCES]
    run_compiler(_compiler_command(folder, how, cpu, *told, *(c for c in sources if c not in quick)), objects)
    if quick:
        run_compiler(_compiler_command(folder, how, cpu, "-O2", *told, *quick), objects)
    return objects


def _link_selftest(folder: Path, how: ArithmeticBuild, cpu: tuple[str, ...], test: str) -> Path:
    objects = folder / cpu[0].removeprefix("-mcpu=")
    script = (
        (folder / "check" / "platforms" / "cortex_m4.ld")
        .read_text(encoding="utf-8")
        .replace("LENGTH = 64K", f"LENGTH = {how.ram_size}")
    )
    (objects / "board.ld").write_text(script, encoding="utf-8")
    out = objects / f"{test}.elf"
    parts = (
        *sorted(objects.glob("*.o")),
        *_selftest_sources(test, "check/platforms/platform_cortex_m4.c", "boards/memory.c"),
    )
    run_compiler(_compiler_command(folder, how, cpu, *parts, "-T", objects / "board.ld", "-o", out, "-lgcc"), folder)
    return out


def measure_code_size(folder: Path) -> tuple[int, int]:
    """Return flash and RAM (bytes) of the objects in a folder."""
    objects = sorted(p.name for p in folder.glob("*.o"))
    said = subprocess.run(["arm-none-eabi-size", *objects], capture_output=True, text=True, cwd=folder).stdout
    rows = [line.split() for line in said.splitlines()[1:]]
    text, data, bss = (sum(int(row[k]) for row in rows) for k in range(3))
    return text + data, data + bss


def find_deepest_stack(folder: Path, entry: str) -> int:
    """Return the stack (bytes) of the deepest call path from a function whose name starts with ``entry``.

    The calculation uses the compiler's stack usage of each function (``-fstack-usage``) and the call graph from its
    ``expand`` dumps.

    Raises
    ------
    MuflyError
        If a function is recursive or has a stack of variable size: the stack then has no bound.
    """
    own: dict[str, int] = {}
    for file in folder.glob("*.su"):
        for line in file.read_text(encoding="utf-8").splitlines():
            place, size, kind = line.split("\t")
            name = place.rsplit(":", 1)[1]
            if kind != "static":
                raise MuflyError(f"stack: the use of {name} is {kind} and has no bound")
            own[name] = int(size)
    calls: dict[str, set[str]] = {name: set() for name in own}
    for file in folder.glob("*.expand"):
        inside = ""
        for line in file.read_text(encoding="utf-8").splitlines():
            head = re.match(r";; Function (\S+)", line)
            if head:
                inside = head[1]
            elif "call_insn" in line or "(call (mem" in line:
                for name in re.findall(r'symbol_ref:SI \("([^"]+)"\)', line):
                    calls.setdefault(inside, set()).add(name)

    @functools.cache
    def stack_below(name: str, above: tuple[str, ...] = ()) -> int:
        if name in above:
            raise MuflyError(f"stack: {name} calls itself; there is no bound")
        return own.get(name, 0) + max((stack_below(c, (*above, name)) for c in calls.get(name, ())), default=0)

    return max((stack_below(name) for name in own if name.startswith(entry)), default=0)
