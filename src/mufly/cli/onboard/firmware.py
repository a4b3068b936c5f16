"""``mufly firmware``: control law and estimator as C99, exported and compared with the simulation."""

from __future__ import annotations

import itertools
import json
import shlex
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from mufly.cli.control import parse_design_settings
from mufly.cli.options import (
    CommandGroup,
    JsonOption,
    MethodOption,
    MissionArgument,
    OrderOption,
    SeedOption,
    TunedOption,
    VehicleOption,
    define_argument,
    define_option,
)
from mufly.cli.output import (
    LiveDisplay,
    check_output_place,
    make_console,
    print_answer,
    print_blocks,
    print_files,
    print_json,
    print_lines,
    progress_bar,
)
from mufly.cli.station import (
    FaultOption,
    GustOption,
    SensorsOption,
    WindOption,
    choose_dated_folder,
    parse_sensor_faults,
    resolve_wind,
)
from mufly.errors import InputError, MuflyError, convert_write_errors
from mufly.results import make_lines_block, tabulate_results

if TYPE_CHECKING:
    from mufly.vehicle import Vehicle

app = CommandGroup(
    help="Export control law and estimator as C99 for a board, fly them, and compare them with Python bit by bit "
    "(docs/reference/firmware.md).",
    no_args_is_help=True,
)

_FixedOption = Annotated[
    bool,
    define_option(
        "--fixed-point", "Use the control law in fixed point, for a processor without a floating-point unit."
    ),
]


@app.command()
def export(
    out: Annotated[
        Path, define_option("--out DIR", "Folder to write: a new or empty one, or one of an earlier export.")
    ],
    vehicle: VehicleOption = "mufly-1.1",
    mission: Annotated[
        str, define_option("--mission NAME|FILE", "Built-in mission (`mufly mission list`), or mission file.")
    ] = "demonstration",
    fixed_point: _FixedOption = False,
    method: MethodOption = "hinf",
    order: OrderOption = None,
    tuned: TunedOption = None,
    as_json: JsonOption = False,
) -> None:
    """Write the flight software of a vehicle as C99, with Makefile, CMake file, self-tests and a README.

    The algorithms are the same for every vehicle; tables.c, estimate_tables.c and plan.c hold the numbers of vehicle
    and mission. With --fixed-point the folder fixed_point/ holds the control law in fixed point; the command prints its
    cost in margins, and the bounds that exclude overflow.

    Example: mufly firmware export --vehicle mine.toml --mission m.toml --out fw, then make -C fw check
    """
    from mufly import firmware
    from mufly.control import design_flight_controller
    from mufly.mission import load_mission
    from mufly.vehicle import load_vehicle

    helicopter = load_vehicle(vehicle)
    flown = load_mission(mission)
    controller = design_flight_controller(helicopter, settings=parse_design_settings(method, order, tuned))
    law = None
    with convert_write_errors("--out", key=str(out)):
        files = firmware.export_firmware(controller, out, helicopter, flown.world, flown)
        if fixed_point:
            law = firmware.export_fixed_point(controller, out)
            files = sorted(p for p in out.rglob("*") if p.is_file())
    if as_json:
        more = {} if law is None else {"losses": law.candidate_losses, "proofs": [c.proof for c in law.controllers]}
        print_json({"files": [str(f) for f in files], **more})
        return
    if law is not None:
        print_blocks(*law.make_printed_blocks(firmware.measure_cascade_margin_loss(helicopter, controller, law)))
    print_files([out])
    if helicopter.sensors is None:
        print_lines(
            f"{helicopter.name} has no table [sensors]: the exported estimator uses no sensor; give it the "
            "position and attitude to fly on, or add the table (docs/reference/sensors.md).",
            mark="Warning", style="yellow",
        )  # fmt: skip
    print_lines(
        f"{len(files)} files for {controller.vehicle_name}: try `make -C {shlex.quote(str(out))} check`, "
        f"read {out / 'README.md'}."
    )


@app.command()
def policy(
    file: Annotated[Path, define_argument("FILE", "Policy by docs/examples/learn_to_hover.py.")],
    out: Annotated[
        Path, define_option("--out DIR", "Folder to write: a new or empty one, or one of an earlier export.")
    ],
) -> None:
    """Write a learned policy as C99 code that needs no heap.

    In double precision the code equals the policy of mufly fly --policy bit for bit; -DMUFLY_FLOAT builds it in single
    precision.

    Example: mufly firmware policy hover-policy.json --out policy-c
    """
    from mufly.firmware import export_policy
    from mufly.flight.policy import load_policy

    learned = load_policy(file)
    with convert_write_errors("--out", key=str(out)):
        files = export_policy(learned, out)
    print_files([out])
    arrays = learned.packed_arrays
    shape = " x ".join(map(str, arrays.layer_sizes))
    print_lines(f"{len(files)} files: network {shape}, {arrays.weights.size + arrays.biases.size} numbers.")


@app.command()
def sil(
    missions: Annotated[
        list[str] | None,
        define_argument(
            "[MISSION]...", "Missions to fly, built-in names or files. Default: demonstration and box-on-leg."
        ),
    ] = None,
    vehicle: VehicleOption = "mufly-1.1",
    flights: Annotated[int, define_option("N", "Number of flights of each mission, with seeds from 0 on.", min=1)] = 1,
    wind: WindOption = None,
    gust: GustOption = None,
    sensors: SensorsOption = "fitted",
    fault: FaultOption = None,
    drawn: Annotated[
        bool,
        define_option("--drawn", "Draw wind, gusts and a sensor fault for every flight from its seed."),
    ] = False,
    keep: Annotated[
        Path | None,
        define_option(
            "--keep FILE", "File to which each flight is added as a line of JSON; flights in it are not repeated."
        ),
    ] = None,
    fixed_point: _FixedOption = False,
    as_json: JsonOption = False,
) -> None:
    """Compare the exported C code with flights in Python, bit by bit in every period (software in the loop).

    The comparison covers the control law, the flight software with mission and log, and on fitted sensors the
    estimator, each with its whole state. With --fixed-point the fixed-point code flies by itself, beside a flight in
    double precision.

    Needs a C compiler. Ends with status 1 if a bit differs, or a fixed-point number overflows.
    """
    from mufly.firmware import run_sil as compare
    from mufly.vehicle import load_vehicle

    names = missions or ["demonstration", "box-on-leg"]
    if fixed_point:
        if wind is not None or gust is not None:
            raise InputError("--fixed-point", "", "draws its own gusts", "leave out --wind and --gust")
        if fault or drawn:
            raise InputError(
                "--fixed-point",
                "",
                "flies on the true state, without sensors and filter",
                "leave out --fault and --drawn",
            )
        _compare_fixed_point(load_vehicle(vehicle), names, flights, keep, as_json)
        return
    if drawn and (fault or wind is not None or gust is not None):
        raise InputError("--drawn", "", "draws wind, gusts and faults itself", "leave out --wind, --gust and --fault")
    steady = resolve_wind(wind, gust, 0)
    helicopter = load_vehicle(vehicle)
    faults = parse_sensor_faults(helicopter, sensors, fault)
    with progress_bar("flights", not as_json) as progress:
        compared = compare(
            helicopter, names, flights=flights, wind=steady, gust=gust, faults=faults,
            on_flight=_make_flight_counter(progress, len(names) * flights),
            sensors=sensors, drawn=drawn, keep=keep,
        )  # fmt: skip
    print_answer(as_json, compared)
    if compared.mismatch_count:
        raise typer.Exit(1)


def _make_flight_counter(progress: Callable[[int, int], None] | None, total: int) -> Callable[[object], None]:
    """Return a function that advances the progress bar by one of ``total`` flights at each call."""
    numbers = itertools.count(1)
    return lambda _: None if progress is None else progress(next(numbers), total)


def _compare_fixed_point(vehicle: Vehicle, names: list[str], flights: int, keep: Path | None, as_json: bool) -> None:
    from mufly.firmware import compare_fixed_point_flights

    with progress_bar("flights", not as_json) as progress:
        on_flight = _make_flight_counter(progress, len(names) * flights)
        compared = compare_fixed_point_flights(vehicle, names, flights=flights, keep=keep, on_flight=on_flight)
    print_answer(as_json, compared)
    if any(flight.overflows for flight in compared.flights):
        raise typer.Exit(1)


@app.command()
def fly(
    mission: MissionArgument = "demonstration",
    vehicle: VehicleOption = "mufly-1.1",
    qemu: Annotated[
        bool,
        define_option(
            "--qemu", "Run the image of a Cortex-M4 in QEMU, and compare it with this machine in every period."
        ),
    ] = False,
    out: Annotated[
        Path | None, define_option("--out -o DIR", "Folder for the results. Default: flights/<date-time>.")
    ] = None,
    log: Annotated[
        Path | None, define_option("--log FILE", "File for the log that the board writes to its block device (ULog).")
    ] = None,
    wind: WindOption = None,
    gust: GustOption = None,
    seed: SeedOption = 0,
    fault: FaultOption = None,
    as_json: JsonOption = False,
) -> None:
    """Fly a mission with the board's code in single precision, in place of estimator and flight software.

    Plant, sensors and faults are simulated. With --qemu the image for a board flies on an emulated Cortex-M4, and every
    byte of its memory is compared with the same code on this machine, twice a period.

    Needs a C compiler; --qemu also arm-none-eabi-gcc and qemu-system-arm. Ends with status 1 if the mission fails, or a
    byte differs.

    Example: mufly firmware fly --qemu box-on-leg --wind 0.5,0,0 --gust 0.3 --seed 7
    """
    from mufly.cli.fly import format_progress_line, write_flight_results
    from mufly.firmware.emulated import fly_board
    from mufly.mission import check_mission_for_vehicle, load_mission
    from mufly.vehicle import load_vehicle

    terminal = make_console(stderr=as_json)
    steady = resolve_wind(wind, gust, seed)
    folder = out if out is not None else choose_dated_folder()
    check_output_place("--out", folder, make=False)
    if log is not None:
        check_output_place("--log", log.parent, make=False)
    helicopter, flown = load_vehicle(vehicle), load_mission(mission)
    faults = parse_sensor_faults(helicopter, "fitted", fault)
    check_mission_for_vehicle(helicopter, flown, vehicle_file=vehicle, mission_file=mission)
    with LiveDisplay(terminal) as display:
        try:
            record, compared = fly_board(
                helicopter, flown, emulated=qemu, wind=steady, gust=gust, seed=seed, faults=faults,
                path=folder / "flight.mcap", log_path=log, on_event=display.show_event,
                on_progress=lambda p: display.set_live_line(format_progress_line(p)),
                on_stage=lambda stage: display.set_live_line(stage),
            )  # fmt: skip
        except KeyboardInterrupt:
            raise typer.Exit(130) from None
    summary = write_flight_results(terminal, record, flown, [folder / "flight.mcap"], as_json)
    (folder / "board.json").write_text(json.dumps(vars(compared), indent=2) + "\n", encoding="utf-8")
    pace = f"{compared.periods_per_s:.0f} periods/s, {compared.realtime_factor:.2g} times real time"
    slower = " (slower than real time)" if compared.realtime_factor < 1.0 else ""
    terminal.print(f"The board flew {pace}{slower}.", highlight=False)
    if qemu and not compared.mismatch_count:
        terminal.print(f"No byte of its memory differs from this machine's in {compared.periods} periods.")
    elif compared.mismatch_count:
        raise MuflyError(f"the emulated board differs from this machine: {compared.first_mismatch}")
    if summary.outcome != "succeeded":
        raise MuflyError(f"the mission failed: {summary.reason}")


@app.command("log")
def split_log(
    image: Annotated[
        Path, define_argument("IMAGE", "Image of the block device of a board's log: a copy of the SD card.")
    ],
    out: Annotated[Path, define_option("--out DIR", "Folder for the files, one for each start of the board.")],
    as_json: JsonOption = False,
) -> None:
    """Extract the logs of a board from its SD card or flash, as ULog.

    `mufly log` also reads the latest log directly from the image.

    Example: mufly firmware log card.img --out logs, then mufly log info logs/session-0003.ulg
    """
    from mufly.logs.block_log import split_image_into_sessions

    try:
        sessions = split_image_into_sessions(image.read_bytes())
    except OSError as error:
        problem = f"cannot be read ({error.strerror})"
        raise InputError(str(image), "", problem, "give a copy of the whole device") from error
    if not sessions:
        raise InputError(str(image), "", "holds no log of a board", "give a copy of the whole device")
    check_output_place("--out", out, make=False)
    files = []
    with convert_write_errors("--out", key=str(out)):
        out.mkdir(parents=True, exist_ok=True)
        for s in sessions:
            if s.has_begin:
                files.append(out / f"session-{s.number:04d}.ulg")
                files[-1].write_bytes(s.ulog)
    lost = ["A session without its beginning is not extracted."] if len(files) < len(sessions) else []
    blocks = (
        tabulate_results(sessions, ("number", "ulog_byte_count", "missing_blocks", "has_begin")),
        make_lines_block(*lost),
    )
    print_answer(as_json, {"sessions": sessions}, blocks, files)


@app.command()
def pil(vehicle: VehicleOption = "mufly-1.1", fixed_point: _FixedOption = False, as_json: JsonOption = False) -> None:
    """Run the self-test on emulated processors and compare its results with this machine's (processor in the loop).

    With --fixed-point: the self-test of the fixed-point law, on a Cortex-M3, an M4 and an M0.

    Needs a C compiler, arm-none-eabi-gcc and qemu-system-arm. Ends with status 1 if a bit differs.
    """
    from mufly import firmware
    from mufly.vehicle import load_vehicle

    compared = firmware.run_pil(load_vehicle(vehicle), fixed_point=fixed_point)
    print_answer(as_json, compared)
    if not all(one.same for one in compared.processors):
        raise typer.Exit(1)


@app.command()
def report(
    vehicle: VehicleOption = "mufly-1.1",
    out: Annotated[Path, define_option("--out DIR", "Folder for report.md, report.json and pictures.")] = Path(
        "firmware-report"
    ),
    as_json: JsonOption = False,
) -> None:
    """Write a report of the exported code: equality, cost, static checks, coverage, fuzzing.

    Sections: equality with Python; emulated processors; instructions, flash, RAM, stack; fixed point; findings of gcc
    and of the MISRA checker, with reasons; branch coverage; fuzzing. The section of a missing tool names the tool.

    Takes five to ten minutes.
    """
    from mufly.firmware import measure_and_write_report
    from mufly.vehicle import load_vehicle

    helicopter = load_vehicle(vehicle)
    with convert_write_errors("--out", key=str(out)), progress_bar("sections", not as_json) as progress:

        def show_progress(_: object, count: int, of: int) -> None:
            if progress is not None:
                progress(count, of)

        sections = measure_and_write_report(helicopter, out, on_section=show_progress)
    if as_json:
        return print_json({s.title: s.data for s in sections})
    for s in sections:
        if "missing" in s.data:
            print_lines(f"{s.title}: {s.data['missing']}", style="yellow")
    print_files([out / "report.md", out / "report.json"])


@app.command()
def fuzz(
    vehicle: VehicleOption = "mufly-1.1",
    minutes: Annotated[
        float, define_option("--minutes", "Duration of the run.", unit="min", min=0.01, max=6000.0)
    ] = 10.0,
    seed: SeedOption = 1,
    link_only: Annotated[bool, define_option("--link-only", "Fuzz only link, receiver and flash of a board.")] = False,
    as_json: JsonOption = False,
) -> None:
    """Fuzz the exported code: random bytes as readings, estimates and commands, with clang's sanitizers on.

    Needs clang with libFuzzer. Ends with status 1 at a crash, undefined behaviour, or an output out of
    range, and prints the bytes that caused it.
    """
    from mufly.firmware import fuzz_firmware as feed
    from mufly.vehicle import load_vehicle

    result = feed(load_vehicle(vehicle), duration_s=60.0 * minutes, seed=seed, link_only=link_only)
    print_answer(as_json, {"fuzz": result}, result.make_printed_blocks())
    if result.sanitizer_message:
        raise typer.Exit(1)
