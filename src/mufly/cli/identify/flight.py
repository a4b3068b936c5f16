"""``mufly identify``: parameters of a vehicle from its flights, and a demonstration with a known vehicle."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from mufly.cli.identify import linear, rotor_bench
from mufly.cli.options import (
    ClusterOption,
    CommandGroup,
    JsonOption,
    SeedOption,
    check_choice,
    define_argument,
    define_option,
    format_today,
    write_estimated_vehicle,
)
from mufly.cli.output import (
    check_output_place,
    make_console,
    print_answer,
    print_files,
    print_lines,
    progress_bar,
)
from mufly.errors import InputError
from mufly.quantities.quantity_grammar import parse_names

if TYPE_CHECKING:
    from mufly.identify import FitProgress, FitResult, FlightRecord
    from mufly.vehicle import Vehicle


app = CommandGroup(
    help="Identify a vehicle's parameters from bench and flight data, and plan flights that determine them.",
    no_args_is_help=True,
)


@app.command()
def flight(
    logs: Annotated[
        list[Path], define_argument("LOG...", "Flight records that `mufly log` reads: MCAP, CSV, ULog, ...")
    ],
    free: Annotated[
        str,
        define_option(
            "SYMBOLS",
            "Parameters to find, separated by commas: symbols of `mufly vehicle show`, 'delay' (input to "
            "vehicle), 'bias_p' and the like.",
        ),
    ],
    vehicle: Annotated[
        str,
        define_option(
            "NAME|FILE", "Vehicle with the start values; the source of each value sets the width of its prior."
        ),
    ] = "mufly-1.1",
    out: Annotated[
        Path | None, define_option("--out --write NEW.toml", "Vehicle file to write, with the identified values.")
    ] = None,
    report: Annotated[Path | None, define_option("DIR", "Folder for report.html with its pictures.")] = None,
    hold_out: Annotated[
        list[Path] | None, define_option("LOG", "Record to predict without fitting it. Repeat it for more.")
    ] = None,
    hold_out_share: Annotated[
        float,
        define_option("--hold-out-share", "Last share of every log that is held out, without --hold-out.", unit="1"),
    ] = 0.25,
    part: Annotated[
        Literal["both", "heave-yaw", "roll-pitch", "split"],
        define_option(
            "NAME", "Part of the model to fit: both (at once), heave-yaw, roll-pitch, or split (one after the other)."
        ),
    ] = "both",
    outputs: Annotated[
        str | None,
        define_option(
            "NAMES",
            "Measurements to use, separated by commas: height, yaw, r, roll, p, ... Default: all in the records.",
        ),
    ] = None,
    prefix: Annotated[
        Literal["measured", "estimated", "truth"],
        define_option("NAME", "Signals to take from a recording: measured, estimated or truth."),
    ] = "measured",
    columns: Annotated[
        Path | None, define_option("--map MAP.toml", "Column map of foreign logs (docs/reference/logs.md).")
    ] = None,
    start_s: linear.FromOption = None,
    end_s: linear.ToOption = None,
    voltage: Annotated[
        float | str,
        define_option(
            "--voltage",
            "Battery voltage: 'model' (the charge is estimated), 'measured', 'nominal', or a number.",
            unit="V",
            words=("model", "measured", "nominal"),
        ),
    ] = "model",
    delay_ms: Annotated[
        float,
        define_option(
            "--delay", "Delay from recorded input to vehicle; the start value if 'delay' is free.", unit="ms"
        ),
    ] = 0.0,
    window: Annotated[
        float | None,
        define_option("--window", "Length of the windows of the last stage. Default: whole records.", unit="s"),
    ] = None,
    method: Annotated[
        Literal["lm", "cma"],
        define_option("NAME", "Optimiser: lm (Levenberg-Marquardt) or cma (CMA-ES, as in the dissertation)."),
    ] = "lm",
    seed: SeedOption = 0,
    restarts: Annotated[int, define_option("N", "Restarts of CMA-ES, each with twice the population.", min=0)] = 0,
    no_prior: Annotated[bool, define_option("--no-prior", "Ignore the priors of the start values.")] = False,
    held_exact: Annotated[
        bool,
        define_option(
            "--held-exact",
            "Treat parameters that are not free as exact; their uncertainty does not widen the intervals.",
        ),
    ] = False,
    as_is: Annotated[
        bool,
        define_option(
            "--as-is",
            "Fit records whose units, signs, axes or clocks look wrong, with a note instead of an error.",
        ),
    ] = False,
    checkpoint: Annotated[
        Path | None,
        define_option(
            "FILE",
            "Checkpoint file, written every iteration, from which a stopped fit resumes. Default: beside --out.",
        ),
    ] = None,
    cluster: ClusterOption = None,
    fresh: Annotated[bool, define_option("--fresh", "Ignore an existing checkpoint.")] = False,
    as_json: JsonOption = False,
) -> None:
    """Fit the flight model to flight records, and predict held-out records.

    Ctrl-C stops a fit; with --out or --checkpoint the same command resumes at the last iteration.

    Example: mufly identify flight yaw.mcap heave.mcap roll.mcap pitch.mcap --hold-out mixed.mcap
    --free cQ_up,cQ_dw,Izz,Iyy,l_up,l_dw,Tf_up,delay --delay 20 --out mine.toml --report report
    """
    from mufly.identify import choose_free_parameters, fit_dynamics_parts_separately, fit_flight_records
    from mufly.identify import split_record as cut
    from mufly.identify.flight.batch_simulation import run_on_cluster
    from mufly.identify.flight_record import FLIGHT_OUTPUTS
    from mufly.vehicle import load_vehicle

    if not 0.0 <= hold_out_share <= 0.8:
        raise InputError("--hold-out-share", "", f"{hold_out_share:g} is not a share of the record", "give 0 to 0.8")
    if not 0.0 <= delay_ms <= 1000.0:
        raise InputError("--delay", "", f"{delay_ms:g} ms is out of range", "give 0 to 1000 ms")
    if window is not None and not window > 0.0:
        raise InputError("--window", "", f"{window:g} s is not a length", "give a number above 0, or leave it out")
    chosen = None if outputs is None else parse_names(outputs)
    for name in chosen or ():
        check_choice("--outputs", name, FLIGHT_OUTPUTS)
    check_output_place("--out", out, "file")
    check_output_place("--report", report)
    check_output_place("--checkpoint", checkpoint, "file")
    start = load_vehicle(vehicle)
    uses_voltage = voltage in ("model", "measured")
    part_s = (start_s, end_s)
    records, said = _read_records(logs, columns, prefix, start, as_is, uses_voltage, part_s)
    held, more = _read_records(hold_out or [], columns, prefix, start, as_is, uses_voltage)
    if not hold_out and hold_out_share > 0:
        parts = [cut(r, hold_out_share) for r in records]
        records, held = [p[0] for p in parts], [p[1] for p in parts]
    if not as_json:
        print_lines(*said, *more, mark="Note", style="yellow")
    measured = sorted({o for r in records for o in r.output_names})
    symbols = parse_names(free)
    wanted = choose_free_parameters(start, symbols, measured, delay_s=delay_ms / 1e3)
    keep = checkpoint or (None if out is None else out.with_name(f"{out.name}.checkpoint.json"))
    kept = [] if keep is None else [keep, *(keep.with_name(f"{keep.name}.{p}") for p in ("heave-yaw", "roll-pitch"))]
    if fresh:
        for path in kept:
            path.unlink(missing_ok=True)
    elif any(p.exists() for p in kept) and not as_json:
        print_lines(f"Resuming from {keep}.")
    options: dict[str, Any] = {
        "held_out": held, "voltage": voltage, "delay_s": delay_ms / 1e3, "prior": not no_prior,
        "window_s": window, "method": method, "seed": seed, "restarts": restarts, "checkpoint": keep,
        "outputs": chosen, "held_exact": held_exact,
    }  # fmt: skip
    try:
        with run_on_cluster(cluster), _show_fit_progress(not as_json) as on_progress:
            if part == "split":
                fit = fit_dynamics_parts_separately(start, wanted, records, on_progress=on_progress, **options)
            else:
                fit = fit_flight_records(start, wanted, records, part=part, on_progress=on_progress, **options)
    except KeyboardInterrupt:
        where = "" if keep is None else f"; the same command resumes from {keep}"
        typer.secho(f"mufly: stopped{where}", fg=typer.colors.YELLOW, err=True)
        raise typer.Exit(130) from None
    note = f"identified {format_today()} from {', '.join(p.name for p in logs)}"
    written = write_estimated_vehicle(start, fit.estimates, out, note, "--out")
    page = _write_report(fit, report, not as_json)
    for path in kept:
        path.unlink(missing_ok=True)
    print_answer(as_json, fit, files=None)
    if as_json:
        return
    print_files(written, "Vehicle")
    print_files(page, "Report")


def _read_records(
    paths: list[Path], columns: Path | None, prefix: str, vehicle: Vehicle, as_is: bool, uses_voltage: bool,
    part_s: tuple[float | None, float | None] = (None, None),
) -> tuple[list[FlightRecord], list[str]]:  # fmt: skip
    from mufly.identify import check_flight_records, make_flight_record
    from mufly.logs import LogWarning, read_log

    records: list[FlightRecord] = []
    said: list[str] = []
    for path in paths:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", LogWarning)  # printed with the others
            data = read_log(path, columns=columns)
        said += [f"{path.name}: {note}" for note in data.attrs.get("notes", [])]
        records.append(make_flight_record(data, path.name, prefix=prefix).slice_time(*part_s))
    return records, [*said, *check_flight_records(records, vehicle, as_is=as_is, uses_voltage=uses_voltage)]


@contextmanager
def _show_fit_progress(shown: bool) -> Iterator[Callable[[FitProgress], None] | None]:
    """Show stage, iteration, cost, parameters and an upper bound of the time left, on standard error."""
    if not shown:
        yield None
        return
    from rich.progress import BarColumn, TextColumn, TimeElapsedColumn, TimeRemainingColumn
    from rich.progress import Progress as Bar

    columns = (
        TextColumn("{task.description}"), BarColumn(bar_width=20), TimeElapsedColumn(), TextColumn("at most"),
        TimeRemainingColumn(), TextColumn("left"),
    )  # fmt: skip
    with Bar(*columns, console=make_console(stderr=True), transient=True) as bar:
        task, values = bar.add_task("start", total=None), bar.add_task("", total=None, visible=False)

        def show_progress(p: FitProgress) -> None:
            done = p.stage - 1 + min(1.0, p.iteration / p.max_iterations)
            text = f"{p.stage_name} ({p.stage}/{p.stage_count}), iteration {p.iteration}, cost {p.cost:.6g}"
            bar.update(task, description=text, completed=done, total=p.stage_count)
            named = "  ".join(f"{s} {v:.4g}" for s, v in list(p.values.items())[:6])
            bar.update(values, description=named, visible=True)

        yield show_progress


def _write_report(fit: FitResult, folder: Path | None, shown: bool) -> list[Path]:
    """Write the report of a fit into a folder, if given, and return its page; ``shown`` displays a progress bar."""
    if folder is None:
        return []
    from mufly.identify import write_fit_report

    with progress_bar("pictures", shown) as progress:
        return [write_fit_report(fit, folder, progress=progress)]


@app.command()
def demo(
    seed: SeedOption = 0,
    method: Annotated[Literal["lm", "cma"], define_option("NAME", "Optimiser: lm or cma.")] = "lm",
    moving: Annotated[
        bool, define_option("--moving", "Start the records in mid-flight, instead of in a steady hover.")
    ] = False,
    report: Annotated[Path | None, define_option("DIR", "Folder for report.html with its pictures.")] = None,
    logs: Annotated[
        Path | None, define_option("DIR", "Folder for the five flights (MCAP), for `identify flight`.")
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """Identify a known vehicle from simulated flights with hover-holding feedback, chirps, noise and radio delay.

    Twelve parameters start 50 % off. Example: mufly identify demo --seed 3 --report report
    """
    from mufly.identify import run_identification_demo

    check_output_place("--report", report)
    check_output_place("--logs", logs)
    if logs is not None:
        _write_demo_flights(logs, seed, moving)
    with _show_fit_progress(not as_json) as on_progress:
        shown = run_identification_demo(seed=seed, method=method, moving=moving, on_progress=on_progress)
    page = _write_report(shown.fit, report, not as_json)
    print_answer(as_json, shown, files=None)
    if not as_json:
        print_files(page, "Report")


def _write_demo_flights(folder: Path, seed: int, moving: bool) -> None:
    from mufly.identify.flight.identification_demo import fly_demo_flights
    from mufly.identify.flight_record import record_to_dataset
    from mufly.logs import write_log
    from mufly.vehicle import load_vehicle

    fit, held = fly_demo_flights(load_vehicle("mufly-1.1"), seed=seed, moving=moving)
    for r in (*fit, *held):
        write_log(record_to_dataset(r), folder / f"{r.name}.mcap")


rotor_bench.register_bench_commands(app)
linear.register_linear_commands(app)
