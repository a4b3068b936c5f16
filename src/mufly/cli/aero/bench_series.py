"""``mufly bench``: a series on a rotor test bench, from its plan to files that the fits read."""

from __future__ import annotations

import sys
import threading
import time
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from mufly.cli.options import (
    PITCH_RANGE,
    SPACING_RANGE,
    SPEED_RANGE,
    CommandGroup,
    JsonOption,
    SeedOption,
    SpacingOption,
    default_text,
    define_argument,
    define_option,
)
from mufly.cli.output import check_output_place, make_console, print_answer, print_lines, write_text_file
from mufly.errors import InputError

if TYPE_CHECKING:
    from mufly.bench.rig.bench_devices import BenchRig
    from mufly.bench.series.series_analysis import SeriesResult
    from mufly.bench.series.series_files import LoadDifference
    from mufly.bench.series.series_plan import BladeMounting
    from mufly.bench.series.series_runner import SeriesProgress

app = CommandGroup(
    help=("Plan, run, analyse and compare series on a rotor test bench, simulated or real; docs/reference/bench.md."),
    no_args_is_help=True,
)

SimulatedFault = Literal["reference", "saturated", "silent", "spikes", "speed"]
SeriesArgument = Annotated[Path, define_argument("DIR", "Folder that `mufly bench run` wrote.")]
AcceptOption = Annotated[
    list[str] | None,
    define_option(
        "--accept KIND",
        "Kind of issue to accept, as 'reference' or 'saturated'; other issues refuse the series. Repeat it for more.",
    ),
]
KnownOption = Annotated[
    Path | None,
    define_option(
        "--known FILE",
        "Bench file with the torque of the reference rotor over speed, for a bench without a torque "
        "cell. Default air density: the file's, else 1.2 kg/m3.",
    ),
]


@app.command()
def plan(
    rotor: Annotated[list[str], define_option("--rotor NAME|FILE", "Rotor to measure. Repeat it for more.")],
    pitch: Annotated[
        tuple[float, ...],
        define_option(
            "--pitch", "Pitch settings, as 10,12,14 or 10:20:2.", unit="deg", form="settings", within=PITCH_RANGE
        ),
    ] = default_text("12"),
    rpm: Annotated[
        tuple[float, ...],
        define_option(
            "--rpm", "Rotor speeds, as 3000,5000 or 3000:7000:500.", unit="rpm", form="settings", within=SPEED_RANGE
        ),
    ] = default_text("3000:7000:1000"),
    axis: Annotated[
        Literal["upper", "lower", "pair"],
        define_option("--axis NAME", "Axis to mount the rotor on: 'upper', 'lower' or 'pair'."),
    ] = "upper",
    ratio: Annotated[
        tuple[float, ...],
        define_option(
            "--ratio",
            "Speed of a pair's lower rotor over that of the upper one, one value or several.",
            unit="1",
            form="settings",
        ),
    ] = default_text("1"),
    repeat: Annotated[
        int, define_option("--repeat N", "Mountings of each setting; two or more show the repeatability.")
    ] = 2,
    reference: Annotated[
        str | None, define_option("--reference NAME|FILE", "Reference rotor. Default: the first --rotor.")
    ] = None,
    reference_pitch: Annotated[
        float,
        define_option("--reference-pitch", "Pitch setting of the reference rotor.", unit="deg", within=PITCH_RANGE),
    ] = 12.0,
    reference_every: Annotated[
        int, define_option("--reference-every N", "Mountings between two visits of the reference rotor.")
    ] = 4,
    warm_up: Annotated[
        float, define_option("--warm-up", "Warm-up time before the first zero reading.", unit="s")
    ] = 600.0,
    spacing: SpacingOption = 0.04,
    seed: SeedOption = 0,
    name: Annotated[str, define_option("--name TEXT", "Name of the series.")] = "series",
    out: Annotated[Path, define_option("--out FILE", "Plan file to write; an existing file is not replaced.")] = Path(
        "plan.toml"
    ),
    as_json: JsonOption = False,
) -> None:
    """Plan a series: mountings and speeds in random order, with regular runs of a reference rotor.

    The file holds limits, times and order, and may be edited.
    Example: mufly bench plan --rotor naca0012-r60-c20 --pitch 10,14 --reference naca4412-r60-c20
    """
    from mufly.bench.series.series_plan import StepDurations, make_series_plan
    from mufly.bench.series.series_tables import tabulate_series_plan
    from mufly.rotor import load_rotor

    for r in [*rotor, *([reference] if reference else [])]:
        load_rotor(r)
    made = make_series_plan(
        name, rotor, pitch, rpm, reference=reference or rotor[0],
        reference_pitch_deg=reference_pitch, repetitions=repeat, axis=axis,
        speed_ratios=list(ratio), reference_every=reference_every, seed=seed,
        times=StepDurations(warm_up_s=warm_up), spacing_m=spacing,
    )  # fmt: skip
    if out.exists():
        raise InputError("--out", str(out), "already exists", "give another name, or remove the file")
    check_output_place("--out", out, "file")
    write_text_file(out, made.to_toml())

    print_answer(
        as_json,
        {
            "plan": made.model_dump(),
            "points": made.point_count,
            "seconds": made.estimate_duration_s(),
        },
        tabulate_series_plan(made),
        [out],
    )


@app.command()
def run(
    plan: Annotated[Path, define_argument("PLAN", "Plan file that `mufly bench plan` wrote.")],
    rig: Annotated[
        str,
        define_option(
            "--rig sim|FILE",
            "Bench: 'sim' for the simulated one, or the file of a real one (docs/reference/bench.md).",
        ),
    ] = "sim",
    out: Annotated[Path, define_option("--out DIR", "Folder of the series; a stopped series resumes there.")] = Path(
        "series"
    ),
    seed: SeedOption = 0,
    fault: Annotated[
        SimulatedFault | None,
        define_option(
            "--fault KIND",
            "Fault of the simulated bench: reference, saturated, silent, spikes or speed. Default: none.",
        ),
    ] = None,
    samples: Annotated[bool, define_option("--samples", "Keep every sample, in addition to the means.")] = False,
    yes: Annotated[bool, define_option("--yes", "Skip the prompts to change the blades.")] = False,
) -> None:
    """Run a series, or resume it. Ctrl-C stops the motors, then the program.

    Each reading is on the disk before the next point begins. live.html in the folder shows the progress.
    """
    from mufly.bench.rig.simulated_rig import make_simulated_rig
    from mufly.bench.series.live_page import PAGE_FILE_NAME, write_live_page
    from mufly.bench.series.series_plan import read_series_plan
    from mufly.bench.series.series_record import SeriesRecord
    from mufly.bench.series.series_runner import LimitError, StopRequested, run_series
    from mufly.bench.series.series_tables import format_measured_point
    from mufly.cli.station import ShutdownHandler

    made = read_series_plan(plan)
    check_output_place("--out", out)
    real = _load_real_rig(rig, fault) if rig != "sim" else None
    record = SeriesRecord(out)
    last_s = float(record.lines[-1]["time"]) + 60.0 if record.lines else 0.0
    bench, truth = (real, None) if real is not None else make_simulated_rig(made, seed, fault, last_s)
    page = out / PAGE_FILE_NAME
    err, drawn = make_console(stderr=True), [0.0]
    print_lines(
        f"{made.name}: {made.point_count} points on {bench.facts.name}; "
        f"{len(record.completed_steps)} of {len(made.steps)} steps are done"
    )
    print_lines(f"Live: {page}")

    with ShutdownHandler() as ending, err.status("") as status:

        def show_progress(p: SeriesProgress) -> None:
            status.update(f"{100 * p.done_steps / p.total_steps:.0f} %  {p.activity}")
            if (line := p.record_line) is not None and line["what"] == "point":
                err.print(format_measured_point(line, made, p), highlight=False, markup=False)
            # At most one page a second: a simulated bench makes a hundred readings in a second.
            if (p.record_line is not None and time.monotonic() - drawn[0] > 1.0) or p.done_steps == p.total_steps:
                drawn[0] = time.monotonic()
                write_live_page(
                    out,
                    made,
                    record.lines,
                    p.activity,
                    p.done_steps / p.total_steps,
                    over=p.done_steps == p.total_steps,
                )

        def confirm_mounting(m: BladeMounting) -> None:
            if bench.facts.manual and not yes:
                status.stop()
                _wait_for_mounting(m, ending.stop_requested)
                status.start()

        try:
            run_series(
                made,
                bench,
                record,
                asked=ending.stop_requested.is_set,
                told=show_progress,
                mounted=confirm_mounting,
                keep_samples=samples,
                truth=truth,
            )
        except (StopRequested, LimitError) as error:
            write_live_page(
                out, made, record.lines, str(error), len(record.completed_steps) / len(made.steps), over=True
            )
            if isinstance(error, StopRequested):
                print_lines(str(error))
                raise typer.Exit(ending.exit_status or 130) from error
            raise
        finally:
            bench.close()
            record.close()
    print_lines(f"Done: {len(record.readings)} readings in {out}; next: mufly bench analyse {out}")


def _wait_for_mounting(m: BladeMounting, asked: threading.Event) -> None:
    """Wait for Enter, or for the request to stop."""
    from mufly.bench.series.series_runner import StopRequested

    entered = threading.Event()

    def read_enter() -> None:
        sys.stdin.readline()
        entered.set()

    print_lines(f"Mount {m.describe_mounting()}, step back, press Enter.")
    threading.Thread(target=read_enter, daemon=True).start()
    while not entered.wait(0.1):
        if asked.is_set():
            raise StopRequested("stopped on request; the same command resumes the series")


def _load_real_rig(name: str, fault: str | None) -> BenchRig:
    from mufly.bench.rig.rig_file import load_rig

    if fault is not None:
        raise InputError("--fault", fault, "is for a simulated bench", "use it with --rig sim")
    return load_rig(name)


@app.command()
def analyse(
    series: SeriesArgument,
    accept: AcceptOption = None,
    known: KnownOption = None,
    out: Annotated[Path | None, define_option("--out DIR", "Folder for the results. Default: DIR/results.")] = None,
    as_json: JsonOption = False,
) -> None:
    """Analyse a series: loads with 95 % intervals, checks of the record, and files for the fits.

    A series that fails a check is refused: the command prints the reasons, writes no results and ends with status 1.
    """
    from mufly.bench import read_measurements
    from mufly.bench.series.series_analysis import analyse_series as analysed
    from mufly.bench.series.series_files import write_series_results
    from mufly.bench.series.series_tables import tabulate_series_result

    found = analysed(series, known=None if known is None else read_measurements(known), accept=accept or [])
    folder = out or series / "results"
    files = [] if found.fatal_issues else write_series_results(found, folder)
    # Standard output holds the answer; refusals follow as ordinary errors.
    print_answer(
        as_json,
        {"series": found, "refused": bool(found.fatal_issues)},
        tabulate_series_result(found),
        files,
    )
    single = next((s for s in found.settings if s.axis != "pair"), None)
    if files and single is not None and not as_json:
        print_lines(f"Next: mufly rotor compare {single.rotor} {files[0]}")
    if found.fatal_issues:
        kinds = ", ".join(sorted({d.kind for d in found.fatal_issues}))
        raise InputError(
            str(series),
            "",
            f"fails its checks ({kinds})",
            "measure again, or accept explained kinds of issues by --accept",
        )


@app.command()
def compare(
    series: SeriesArgument,
    other: Annotated[
        Path | None,
        define_argument("DIR", "Second series of the same blades. Default: compare with blade element theory."),
    ] = None,
    spacing: Annotated[
        float | None,
        define_option(
            "--spacing", "Distance between the discs of a pair. Default: the plan's.", unit="m", within=SPACING_RANGE
        ),
    ] = None,
    accept: AcceptOption = None,
    known: KnownOption = None,
    as_json: JsonOption = False,
) -> None:
    """Compare a series with another one, or with blade element momentum theory.

    E_n is the difference over its 95 % uncertainty; above 1 the two disagree.
    """
    import tomllib

    from mufly.bench import read_measurements
    from mufly.bench.series.series_analysis import analyse_series as analysed
    from mufly.bench.series.series_files import compare_series, compare_with_theory
    from mufly.bench.series.series_record import read_record
    from mufly.bench.series.series_tables import tabulate_load_differences

    torque = None if known is None else read_measurements(known)
    first = _refuse_fatal_issues(analysed(series, known=torque, accept=accept or []), series)
    found: list[LoadDifference]
    if other is None:
        if spacing is None:
            spacing = float(tomllib.loads(read_record(series).header_line["plan"])["spacing_m"])
        found = compare_with_theory(first, spacing_m=spacing)
    else:
        found = compare_series(first, _refuse_fatal_issues(analysed(other, known=torque, accept=accept or []), other))

    names = ("bench", "theory") if other is None else ("first", "second")
    print_answer(as_json, {"differences": found}, tabulate_load_differences(found, *names))


def _refuse_fatal_issues(found: SeriesResult, where: Path) -> SeriesResult:
    if found.fatal_issues:
        raise InputError(str(where), "", found.fatal_issues[0].text, "see `mufly bench analyse`, or --accept the kind")
    return found
