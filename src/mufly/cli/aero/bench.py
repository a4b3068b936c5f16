"""``mufly bench``: a series on a rotor test bench, from its plan to files that the fits read."""

from __future__ import annotations

import math
import sys
import threading
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from mufly.cli.options import (
    PITCH_RANGE,
    SPACING_RANGE,
    SPEED_RANGE,
    CommandGroup,
    JsonOption,
    SpacingOption,
    define_argument,
    define_option,
)
from mufly.cli.output import ensure_folder, make_console, print_answer, print_lines, print_table, write_text_file
from mufly.errors import InputError
from mufly.quantity_grammar import read_values

if TYPE_CHECKING:
    from mufly.bench.rig.bench_devices import BenchRig
    from mufly.bench.series.series_analysis import LoadInterval, SeriesResult, SettingResult
    from mufly.bench.series.series_files import LoadDifference
    from mufly.bench.series.series_plan import BladeMounting, PlanStep, SeriesPlan
    from mufly.bench.series.series_record import SeriesRecord
    from mufly.bench.series.series_runner import SeriesProgress

app = CommandGroup(
    help=(
        "A rotor test bench: plan a series, run it (simulated, or on devices), analyse and compare; "
        "docs/reference/bench.md."
    ),
    no_args_is_help=True,
)

SimulatedFault = Literal["reference", "saturated", "silent", "spikes", "speed"]
SeriesArgument = Annotated[Path, define_argument("DIR", "The folder of `mufly bench run`.")]
AcceptOption = Annotated[
    list[str] | None,
    define_option(
        "--accept KIND",
        "A doubt that is not to refuse the series: 'reference', 'saturated', ... (again for more).",
    ),
]
KnownOption = Annotated[
    Path | None,
    define_option(
        "--known FILE",
        "Torque of the reference rotor over speed, for a bench without a torque cell; at the density in the file, "
        "else 1.2 kg/m3.",
    ),
]


_MAX_SETTINGS = 1000  # settings of one kind in a plan


@app.command()
def plan(
    rotor: Annotated[list[str], define_option("--rotor NAME|FILE", "A rotor to measure (again for more).")],
    pitch: Annotated[
        str,
        define_option("--pitch", "Pitch settings: 10,12,14 or 10:20:2.", unit="deg", form="values", within=PITCH_RANGE),
    ] = "12",
    rpm: Annotated[
        str,
        define_option("--rpm", "Speeds: 3000,5000 or 3000:7000:500.", unit="rpm", form="values", within=SPEED_RANGE),
    ] = "3000:7000:1000",
    axis: Annotated[
        Literal["upper", "lower", "pair"], define_option("--axis NAME", "'upper', 'lower' or 'pair'.")
    ] = "upper",
    ratio: Annotated[
        str,
        define_option("--ratio", "Of a pair: speed of the lower rotor over the upper's.", unit="1", form="values"),
    ] = "1",
    repeat: Annotated[
        int, define_option("--repeat N", "Mountings of each setting; 2 or more show how well they repeat.")
    ] = 2,
    reference: Annotated[
        str | None, define_option("--reference NAME|FILE", "Reference rotor; default the first --rotor.")
    ] = None,
    reference_pitch: Annotated[
        float, define_option("--reference-pitch", "Its pitch.", unit="deg", within=PITCH_RANGE)
    ] = 12.0,
    reference_every: Annotated[
        int, define_option("--reference-every N", "Mountings between two of the reference.")
    ] = 4,
    warm_up: Annotated[float, define_option("--warm-up", "Time before the first zero.", unit="s")] = 600.0,
    spacing: SpacingOption = 0.04,
    seed: Annotated[int, define_option("--seed N", "Draws the order.")] = 0,
    name: Annotated[str, define_option("--name TEXT", "Of the series.")] = "series",
    out: Annotated[Path, define_option("--out FILE", "The plan; a file that is there is not replaced.")] = Path(
        "plan.toml"
    ),
    as_json: JsonOption = False,
) -> None:
    """Draw up a series: mountings and speeds in random order, a reference rotor every so often.

    Limits, times and order stand in the file, which may be edited.
    Example: mufly bench plan --rotor naca0012-r60-c20 --pitch 10,14 --reference naca4412-r60-c20
    """
    from mufly.bench.series.series_plan import StepTimes, make_plan
    from mufly.cli.output import check_writable_file
    from mufly.rotor import load_rotor

    for r in [*rotor, *([reference] if reference else [])]:
        load_rotor(r)
    ratios = list(read_values("--ratio", ratio, "1", most=_MAX_SETTINGS))
    made = make_plan(
        name, rotor, read_values("--pitch", pitch, "deg", most=_MAX_SETTINGS),
        read_values("--rpm", rpm, "rpm", most=_MAX_SETTINGS), reference=reference or rotor[0],
        reference_pitch_deg=reference_pitch, repetitions=repeat, axis=axis,
        speed_ratios=ratios, reference_every=reference_every, seed=seed,
        times=StepTimes(warm_up_s=warm_up), spacing_m=spacing,
    )  # fmt: skip
    if out.exists():
        raise InputError("--out", str(out), "is there already", "give another name, or take it away")
    check_writable_file("--out", out)
    write_text_file(out, made.to_toml())

    def print_plan() -> None:
        print_table(
            ("", "use", "blades", "speeds (rpm)"),
            [(f"{k}", m.use, m.describe_mounting(), ", ".join(f"{s:g}" for s in m.speeds_rpm))
             for k, m in enumerate(made.mounting, 1)], text=(1, 2, 3),
        )  # fmt: skip
        print_lines(
            f"{made.point_count} points, {len(made.steps)} steps; about {made.estimate_duration_s() / 60:.0f} min and "
            f"{len(made.mounting)} changes of blades"
        )
        if axis == "pair" and len(set(ratios)) < 2:
            print_lines(
                "One ratio of speeds shows the thrust of both rotors together only, --ratio 0.9,1,1.1 that of each."
            )

    print_answer(
        as_json,
        {
            "plan": made.model_dump(),
            "points": made.point_count,
            "seconds": made.estimate_duration_s(),
        },
        print_plan,
        [out],
    )


@app.command()
def run(
    plan: Annotated[Path, define_argument("PLAN", "From `mufly bench plan`.")],
    rig: Annotated[
        str, define_option("--rig sim|FILE", "'sim', or the file of a bench (docs/reference/bench.md).")
    ] = "sim",
    out: Annotated[Path, define_option("--out DIR", "The series; one that was stopped goes on there.")] = Path(
        "series"
    ),
    seed: Annotated[int, define_option("--seed N", "Of a simulated bench.")] = 0,
    fault: Annotated[
        SimulatedFault | None,
        define_option("--fault KIND", "Of a simulated bench: reference, saturated, silent, spikes, speed."),
    ] = None,
    samples: Annotated[bool, define_option("--samples", "Keep every sample, not only means.")] = False,
    yes: Annotated[bool, define_option("--yes", "Do not wait for somebody to change the blades.")] = False,
) -> None:
    """Run a series, or go on with it. Ctrl-C stops the motors, then the program.

    Everything measured is on the disk before the next point begins. live.html in the folder shows the series.
    """
    from mufly.bench.series.live_page import PAGE_FILE_NAME, write_live_page
    from mufly.bench.series.series_plan import read_plan
    from mufly.bench.series.series_record import SeriesRecord
    from mufly.bench.series.series_runner import LimitError, Stopped, run_series
    from mufly.cli.station import ShutdownHandler

    made = read_plan(plan)
    ensure_folder("--out", out)
    real = _load_real_rig(rig, fault) if rig != "sim" else None
    record = SeriesRecord(out)
    bench, truth = (real, None) if real is not None else _make_simulated_rig(made, record, seed, fault)
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
                err.print(_format_progress_line(line, made, p), highlight=False, markup=False)
            # A page a second at most: a simulated bench makes a hundred readings in one.
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
        except (Stopped, LimitError) as error:
            write_live_page(
                out, made, record.lines, str(error), len(record.completed_steps) / len(made.steps), over=True
            )
            if isinstance(error, Stopped):
                print_lines(str(error))
                raise typer.Exit(ending.exit_status or 130) from error
            raise
        finally:
            bench.close()
            record.close()
    print_lines(f"Done: {len(record.readings)} readings in {out}; next: mufly bench analyse {out}")


def _format_progress_line(line: dict[str, Any], plan: SeriesPlan, p: SeriesProgress) -> str:
    m = plan.mounting[line["mounting"]]
    quick = line.get("quick", {})
    loads = ", ".join(
        f"{n} {quick[n] * (1e3 if n == 'torque' else 1):.4g} {'mN m' if n == 'torque' else 'N'}"
        for n in ("thrust", "torque") if n in quick
    )  # fmt: skip
    bad = (
        ""
        if line["settled"] and line["at_speed"] and not line["saturated"]
        else "  NOT USABLE: "
        + ("saturated" if line["saturated"] else "not at its speed" if not line["at_speed"] else "did not settle")
    )
    blades = f"{m.rotor} {m.pitch_deg:g} deg {m.axis:5s}"
    return f"{p.done_steps:4d}/{p.total_steps}  {blades} {line['speed_rpm']:6.0f} rpm  {loads}{bad}"


def _wait_for_mounting(m: BladeMounting, asked: threading.Event) -> None:
    """Wait for Enter, or for the request to stop."""
    from mufly.bench.series.series_runner import Stopped

    entered = threading.Event()

    def read_enter() -> None:
        sys.stdin.readline()
        entered.set()

    print_lines(f"Mount {m.describe_mounting()}, step back, press Enter.")
    threading.Thread(target=read_enter, daemon=True).start()
    while not entered.wait(0.1):
        if asked.is_set():
            raise Stopped("stopped as asked; the series goes on from here when it is run again")


def _load_real_rig(name: str, fault: str | None) -> BenchRig:
    from mufly.bench.rig.rig_file import load_rig

    if fault is not None:
        raise InputError("--fault", fault, "is for a simulated bench", "use it with --rig sim")
    return load_rig(name)


def _make_simulated_rig(
    plan: SeriesPlan, record: SeriesRecord, seed: int, fault: str | None
) -> tuple[BenchRig, Callable[[PlanStep], Mapping[str, float]]]:
    from mufly.bench.rig.simulated_rig import SimulatedFaults, SimulatedRig

    faults = {
        None: SimulatedFaults(),
        "reference": SimulatedFaults(reference_moved_deg=0.5, reference_moved_after=1),
        "saturated": SimulatedFaults(force_cell_saturates=True),
        "silent": SimulatedFaults(silent_from_s=1500.0),
        "spikes": SimulatedFaults(spike_share=0.05),
        "speed": SimulatedFaults(speed_shortfall_share=0.04),
    }[fault]
    last = float(record.lines[-1]["time"]) + 60.0 if record.lines else 0.0
    rig = SimulatedRig(seed, faults=faults, spacing_m=plan.spacing_m, time_s=last)

    def true_loads(step: PlanStep) -> dict[str, float]:
        speeds: dict[str, float] = {a: rig.speed[a] for a in plan.mounting[step.mounting_index].turning_sides}
        nominal = rig.true_loads(speeds, as_mounted=False)
        return rig.true_loads(speeds) | {f"nominal_{k}": v for k, v in nominal.items()}

    return rig, true_loads


@app.command()
def analyse(
    series: SeriesArgument,
    accept: AcceptOption = None,
    known: KnownOption = None,
    out: Annotated[Path | None, define_option("--out DIR", "Results; default DIR/results.")] = None,
    as_json: JsonOption = False,
) -> None:
    """Say what a series found, with 95 % intervals, and whether to believe it; write it as files for the fits.

    A series that cannot be trusted is refused: status 1, the reasons, no results.
    """
    from mufly.bench import read_measurements
    from mufly.bench.series.series_analysis import analyse_series as analysed
    from mufly.bench.series.series_files import write_series_results

    found = analysed(series, known=None if known is None else read_measurements(known), accept=accept or [])
    folder = out or series / "results"
    files = [] if found.fatal_issues else write_series_results(found, folder)
    # Standard output is the answer; refusals are errors as any other, after it.
    print_answer(
        as_json,
        {"series": found, "refused": bool(found.fatal_issues)},
        lambda: _print_series(found),
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
            f"is not to be trusted ({kinds})",
            "measure again, or --accept what you can explain",
        )


def _format_load(load: LoadInterval | None, scale: float = 1.0) -> str:
    if load is None:
        return "-"
    return f"{scale * load.value:.4g} ± {scale * load.expanded:.2g}"


def _print_series(found: SeriesResult) -> None:
    def setting_row(s: SettingResult) -> tuple[str, ...]:
        speeds = (
            f"{s.speed_upper_rpm:.0f}, {s.speed_lower_rpm:.0f}"
            if s.axis == "pair"
            else (f"{s.speed_lower_rpm if s.axis == 'lower' else s.speed_upper_rpm:.0f}")
        )
        torque = (
            (_format_load(s.torque_upper, 1e3), _format_load(s.torque_lower, 1e3))
            if s.axis == "pair"
            else (_format_load(s.torque, 1e3), "")
        )
        return (
            s.rotor,
            s.axis,
            f"{s.pitch_deg:g}",
            speeds,
            f"{s.mountings}",
            _format_load(s.thrust),
            *torque,
        )

    pair = any(s.axis == "pair" for s in found.settings)
    heads = ("rotor", "axis", "pitch (deg)", "speed (rpm)", "mounted", "thrust (N)",
             "torque upper (mN m)" if pair else "torque (mN m)", "torque lower (mN m)" if pair else "")  # fmt: skip
    rows = [setting_row(s) for s in found.settings]
    cut = len(heads) if pair else len(heads) - 1
    print_table(heads[:cut], [r[:cut] for r in rows], text=(0, 1, 3), title=f"{found.name}, 95 % intervals")
    print_lines(*found.notes)
    for load, tau in found.repeat.items():
        if math.isfinite(tau):
            print_lines(f"{load}: mountings of the same setting differ by {100 * tau:.2f} % (one standard deviation)")
    if all(s.mountings < 2 for s in found.settings):
        print_lines(
            "no setting was mounted twice: intervals are for the blades as they were mounted, not for their pitch"
        )
    inside = [
        abs(load.value - s.truth[f"nominal_{q}"]) <= load.expanded
        for s in found.settings for q in ("thrust", "torque_upper", "torque_lower")
        if (load := getattr(s, q)) is not None and f"nominal_{q}" in s.truth
    ]  # fmt: skip
    if inside:
        print_lines(f"simulated bench: {sum(inside)} of {len(inside)} intervals hold the truth")
    for d in found.doubts:
        print_lines(d.text, mark="REFUSED" if d.is_fatal else "note", style="red" if d.is_fatal else "yellow")


@app.command()
def compare(
    series: SeriesArgument,
    other: Annotated[
        Path | None,
        define_argument("DIR", "Another series of the same blades; without it blade element theory."),
    ] = None,
    spacing: Annotated[
        float | None,
        define_option("--spacing", "Between the discs of a pair; default the plan's.", unit="m", within=SPACING_RANGE),
    ] = None,
    accept: AcceptOption = None,
    known: KnownOption = None,
    as_json: JsonOption = False,
) -> None:
    """Set a series beside another one, or beside blade element momentum theory.

    E_n is the difference over its 95 % uncertainty: beyond 1 the two disagree.
    """
    import tomllib

    from mufly.bench import read_measurements
    from mufly.bench.series.series_analysis import analyse_series as analysed
    from mufly.bench.series.series_files import compare_series, compare_with_theory
    from mufly.bench.series.series_record import read_record

    torque = None if known is None else read_measurements(known)
    first = _require_accepted(analysed(series, known=torque, accept=accept or []), series)
    found: list[LoadDifference]
    if other is None:
        if spacing is None:
            spacing = float(tomllib.loads(read_record(series).header_line["plan"])["spacing_m"])
        found = compare_with_theory(first, spacing_m=spacing)
    else:
        found = compare_series(first, _require_accepted(analysed(other, known=torque, accept=accept or []), other))

    def print_differences() -> None:
        print_table(
            ("setting", "first" if other else "bench", "second" if other else "theory", "off", "E_n"),
            [(d.what, f"{d.first:.4g}", f"{d.second:.4g}", f"{100 * d.relative:+.1f} %", f"{d.normalised:+.2f}")
             for d in found], text=(0,),
        )  # fmt: skip
        beyond = sum(abs(d.normalised) > 1 for d in found)
        mean = sum(abs(d.relative) for d in found) / len(found)
        print_lines(
            f"{beyond} of {len(found)} differ by more than their uncertainty; "
            f"mean absolute difference {100 * mean:.1f} %"
        )

    print_answer(as_json, {"differences": found}, print_differences)


def _require_accepted(found: SeriesResult, where: Path) -> SeriesResult:
    if found.fatal_issues:
        raise InputError(
            str(where), "", found.fatal_issues[0].text, "look at `mufly bench analyse`, or --accept the kind"
        )
    return found
