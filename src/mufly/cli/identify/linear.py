"""``mufly identify linear``: linear models of flights, by output error, equation error or frequency response."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from mufly.cli.options import (
    ColumnOption,
    CommandGroup,
    JsonOption,
    OptionRange,
    SeedOption,
    define_argument,
    define_option,
)
from mufly.cli.output import (
    check_output_place,
    print_answer,
    print_files,
    print_json,
    print_lines,
    print_table,
    progress_bar,
    save_figure,
    write_records,
)
from mufly.errors import InputError
from mufly.quantities.quantity_grammar import parse_named_texts, parse_names
from mufly.results import columns_to_rows

if TYPE_CHECKING:
    from mufly.identify import LinearResult, UniformLogTable
    from mufly.identify.linear.bandwidth import AttitudeBandwidth
    from mufly.identify.linear.sweep_response import ResponseFits

LogsArgument = Annotated[
    list[Path], define_argument("LOG...", "Records: CSV, MATLAB files, or any flight log that `mufly log` reads.")
]
InputsOption = Annotated[
    str,
    define_option(
        "NAMES",
        "Inputs, separated by commas: lat, lon, ped, col. Add =COLUMN for another column name, "
        "=-COLUMN to change the sign, =m3+m4-m1-m2 to add columns, =0.5*COLUMN to scale.",
    ),
]
OutputsOption = Annotated[
    str,
    define_option(
        "NAMES",
        "Outputs, separated by commas: some of p, q, r, phi, theta, u, v, w, with =COLUMN for another column name.",
    ),
]
FromOption = Annotated[
    float | None, define_option("--from", "Start time in the log's own clock. Default: its start.", unit="s")
]
ToOption = Annotated[
    float | None, define_option("--to", "End time in the log's own clock. Default: its end.", unit="s")
]


def linear(
    logs: LogsArgument,
    inputs: InputsOption = "lat,lon,ped,col",
    outputs: OutputsOption = "p,q,r",
    columns: ColumnOption = None,
    method: Annotated[
        str,
        define_option(
            "NAME",
            "Method: output-error (one log, simulated as a whole) or equation-error (any number of logs, "
            "terms chosen step by step, for vehicles flown under feedback).",
        ),
    ] = "output-error",
    model: Annotated[
        str,
        define_option(
            "NAME",
            "Model structure: auto (chosen by cross-validation), helicopter (hybrid flapping, coupled, "
            "yaw gyro), or first-order, second-order, hybrid with any of -coupled, -collective, -gyro, "
            "-speed, -skew.",
        ),
    ] = "auto",
    split: Annotated[
        float, define_option("--split", "First share of the record, which is fitted; 1: all of it.", unit="1")
    ] = 0.5,
    split_at: Annotated[
        float | None,
        define_option("--split-at", "End time of the fitted part, instead of --split.", unit="s"),
    ] = None,
    hold_out: Annotated[
        list[Path] | None,
        define_option("LOG", "Log to predict without fitting it, with equation-error. Repeat it for more."),
    ] = None,
    start_s: FromOption = None,
    end_s: ToOption = None,
    lowpass: Annotated[
        float | None,
        define_option(
            "--lowpass",
            "Cut-off frequency of the low-pass filter for inputs and outputs; 0: no filter. Default: 5, "
            "with equation-error 10.",
            unit="Hz",
        ),
    ] = None,
    highpass: Annotated[
        float | None,
        define_option(
            "--highpass",
            "Lowest frequency of the fit, with equation-error. Default: where the inputs explain the output.",
            unit="Hz",
        ),
    ] = None,
    domain: Annotated[
        str, define_option("NAME", "Domain of the fit, with equation-error: frequency or time.")
    ] = "frequency",
    products: Annotated[
        bool,
        define_option("--products", "Include products of two rates among the candidate terms, with equation-error."),
    ] = False,
    without: Annotated[str, define_option("SYMBOLS", "Terms to exclude, as L_p,M_q, with equation-error.")] = "",
    rate: Annotated[float, define_option("--rate", "Sample rate of the fit; 0: the log's.", unit="Hz")] = 25.0,
    starts: Annotated[int, define_option("N", "Number of searches from different starts.", min=1)] = 6,
    seed: SeedOption = 0,
    hold: Annotated[
        bool, define_option("--hold", "Hold inputs between samples, instead of interpolating them.")
    ] = False,
    out: Annotated[Path | None, define_option("DIR", "Folder for report.html and its pictures (PNG).")] = None,
    as_json: JsonOption = False,
) -> None:
    """Fit a linear model to the first part of a flight record, or to several, and predict the rest from its inputs.

    Example: mufly identify linear flight.csv --inputs lat,lon,ped,col --outputs p,q,r --split 0.5 --out report

    Example: mufly identify linear a.csv b.csv --hold-out c.csv --method equation-error --inputs lat,lon --outputs p,q
    """
    check_output_place("--out", out)
    if starts < 1:
        raise InputError("--starts", "", f"{starts} is not a number of searches", "give 1 or more")
    records = [_read_record(log, columns, start_s, end_s) for log in logs]
    if method == "equation-error":
        held = [_read_record(log, columns, None, None) for log in hold_out or ()]
        if len(records) == 1 and not held and split < 1.0:
            n = len(records[0].time_s)
            cut = round(split * n) if split_at is None else int((records[0].time_s < split_at).sum())
            records, held = [records[0].slice_samples(0, cut)], [records[0].slice_samples(cut, n)]
        names = parse_named_texts(inputs), parse_named_texts(outputs)
        return _fit_by_equations(
            records, held, *names, products, without, domain, lowpass, highpass, out, as_json
        )  # fmt: skip
    if len(records) > 1 or hold_out:
        raise InputError(
            "--method", method, "fits one record and holds out its second part",
            "give one LOG, or --method equation-error",
        )  # fmt: skip
    from mufly.identify.linear.linear_identification import identify_linear_model

    with progress_bar("structures and searches", not as_json) as progress:
        result = identify_linear_model(
            records[0], parse_named_texts(inputs), parse_named_texts(outputs), model=model, split=split,
            split_at_s=split_at, lowpass_hz=(5.0 if lowpass is None else lowpass) or None, rate_hz=rate or None,
            starts=starts, seed=seed, hold=hold, progress=progress,
        )  # fmt: skip
    report = []
    if out is not None:
        from mufly.identify.fit_report import write_linear_report

        with progress_bar("pictures", not as_json) as progress:
            report.append(write_linear_report(result, out, progress=progress))
    if as_json:
        return print_json(result)
    _print_linear_model(result)
    print_files(report, "Report")


def _read_record(
    log: Path, columns: Sequence[str] | None, start_s: float | None, end_s: float | None
) -> UniformLogTable:
    """Read a log, or part of it."""
    from mufly.identify.flight_record import read_columns

    record = read_columns(log, columns=columns or ())
    first, last = record.time_s[[0, -1]]
    part = record.slice_time(start_s, end_s)
    if part is not record and len(part.time_s) < 100:
        told = f"leave {len(part.time_s)} samples of {log.name}, which lasts from {first:.2f} to {last:.2f} s"
        raise InputError("--from, --to", "", told, "leave at least 100")
    return part


def _fit_by_equations(
    records: Sequence[UniformLogTable], held: Sequence[UniformLogTable], inputs: Mapping[str, str],
    outputs: Mapping[str, str], products: bool, without: str, domain: str,
    lowpass: float | None, highpass: float | None, out: Path | None, as_json: bool,
) -> None:  # fmt: skip
    from mufly.identify.linear import equation_model as e

    with progress_bar("equations", not as_json) as progress:
        model = e.identify_equation_model(
            records, inputs, outputs, held_out=held, products=products, domain=domain, low_hz=highpass,
            without=parse_names(without), cut_hz=lowpass or 10.0, progress=progress,
        )  # fmt: skip
    report = []
    if out is not None:
        from mufly.identify import ReportSection, write_fit_report

        sections = [
            ReportSection("Equations", (), *e.equation_table(model)),
            ReportSection("How the terms were chosen", (), *e.tabulate_term_selection(model)),
            ReportSection("Fit of the records", (e.SCORES_EXPLANATION,), *e.score_table(model)),
        ]
        with progress_bar("pictures", not as_json) as progress:
            report.append(write_fit_report(e.equation_fit_result(model), out, sections=sections, progress=progress))
    if as_json:
        return print_json(model)
    print_lines(*model.notes, mark="Note")
    print_table(*e.equation_table(model), title="Equations", text=(0, 1, 2, 3, 7))
    print_table(*e.score_table(model), title="Fit of the records (%)", text=(0, 1))
    print_lines(*(f"{k + 1}: {f.name}" for k, f in enumerate(model.records)), style="dim")
    print_lines(e.SCORES_EXPLANATION, style="dim")
    print_files(report, "Report")


def _print_linear_model(r: LinearResult) -> None:
    from mufly.identify.fit_report import (
        candidate_table,
        estimate_table,
        prediction_table,
        simulation_quality_table,
    )
    from mufly.identify.linear.sweep_response import format_pole

    print_lines(*r.notes, mark="Note")
    if r.candidates:
        print_table(*candidate_table(r), title="Structures, cross-validated inside the fitted part")
    print_table(*estimate_table(r), title=f"Model {r.fit.vehicle}")
    print_lines(f"Poles: {', '.join(format_pole(p) for p in r.linear_fit.poles)} rad/s", r.linear_fit.message)
    print_table(*simulation_quality_table(r), title="Pure simulation from inputs", text=(0, 1))
    print_lines(
        "at most: with no error but the noise floor; to angle: against the derivative of the measured angle; error and "
        f"noise: rms below {r.slow_hz:g} Hz (noise >: above it), in the output's unit; Theil: 0 exact, 1 no relation",
        style="dim",
    )
    if r.ahead:
        print_table(
            *prediction_table(r),
            title=f"Held-out part, predicted a time ahead (low-passed at {r.slow_hz:g} Hz)",
        )
    for title, words in (
        ("Effects in the residuals of the fitted part:", r.model_deficiencies),
        ("Parameters that the data do not determine:", r.fit.undetermined),
    ):
        if words:
            print_lines(title, *(f"- {w}" for w in words))


_POSITIVE_RANGE = OptionRange(1e-9, None)
BandOption = Annotated[
    tuple[float, float] | None,
    define_option(
        "--band",
        "Frequency band. Default: from 2 periods in half the shortest log, to 10 Hz.",
        unit="Hz",
        form="band",
        within=_POSITIVE_RANGE,
    ),
]
WindowsOption = Annotated[
    tuple[float, ...] | None,
    define_option(
        "--windows",
        "Window lengths, as 20,10,5. Default: five, from half the shortest log down.",
        unit="s",
        form="values",
        within=_POSITIVE_RANGE,
    ),
]


def frequency(
    logs: LogsArgument,
    inputs: Annotated[
        str,
        define_option("NAMES", "Input columns, as lat,lon; NAME=COLUMN, =-COLUMN and sums as for `linear`."),
    ] = "lat,lon,ped,col",
    outputs: Annotated[str, define_option("NAMES", "Output columns, written likewise.")] = "p,q,r",
    columns: ColumnOption = None,
    start_s: FromOption = None,
    end_s: ToOption = None,
    band: BandOption = None,
    windows: WindowsOption = None,
    points: Annotated[int, define_option("N", "Number of frequencies.", min=8)] = 80,
    fit: Annotated[
        str | None,
        define_option(
            "ZEROS/POLES", "Orders of transfer functions with delay to fit to coherent pairs, as 0/1 or 1/2."
        ),
    ] = None,
    out: Annotated[Path | None, define_option("DIR", "Folder for pictures (PNG) and responses.csv.")] = None,
    as_json: JsonOption = False,
) -> None:
    """Estimate frequency responses and coherences from sweeps, with conditioned inputs and composite windows.

    Give the sweeps of all axes together; `mufly identify plan --kind chirp` designs them.

    Example: mufly identify frequency lat.csv lon.csv --inputs lat,lon --outputs p,q --band 0.2:8 --fit 0/1 --out sweep
    """
    from mufly.identify.linear.sweep_response import ResponseFits, estimate_response_of_records, fit_transfer_functions

    check_output_place("--out", out)
    orders = None if fit is None else _parse_orders(fit)
    data = estimate_response_of_records(
        [_read_record(log, columns, start_s, end_s) for log in logs], parse_named_texts(inputs),
        parse_named_texts(outputs), band_hz=band, windows_s=windows or (), points=points,
    )  # fmt: skip
    found = ResponseFits(data) if orders is None else fit_transfer_functions(data, zeros=orders[0], poles=orders[1])
    print_answer(as_json, found, files=[] if out is None else _write_responses(found, out))


def _parse_orders(text: str) -> tuple[int, int]:
    """Return the numbers of zeros and poles of ``"0/1"``."""
    try:
        zeros, poles = (int(n) for n in text.split("/"))
    except ValueError:
        raise InputError("--fit", "", f"{text!r} is not ZEROS/POLES", "write 0/1 or 1/2") from None
    return zeros, poles


def _write_responses(found: ResponseFits, out: Path) -> list[Path]:
    from mufly.identify import fit_pictures
    from mufly.identify.linear.response_pictures import draw_frequency_response

    data = found.response
    columns = {"frequency_Hz": data.frequency_hz}
    for name, pair in data.tabulate_pair_responses().items():
        columns |= {f"{name.replace(' ', '_')}_{key}": values for key, values in pair.items()}
    columns |= {f"{o}_multiple_coherence": data.coherence[:, k] for k, o in enumerate(data.outputs)}
    files = [write_records(out / "responses.csv", columns_to_rows(columns))]
    for k, name in enumerate(data.outputs):
        with fit_pictures.apply_report_colours():
            picture = draw_frequency_response(data, k, fits=found.transfer_functions)
            files.append(save_figure(picture, out, f"response-{name}"))
    return files


def bandwidth(
    logs: LogsArgument,
    input_: Annotated[
        str, define_option("--input NAME", "Input (stick): a column, or NAME=-COLUMN and sums as for `linear`.")
    ] = "lat",
    output: Annotated[
        str, define_option("NAME", "Output: phi, theta, psi, or a rate p, q, r, which is integrated.")
    ] = "phi",
    others: Annotated[
        str, define_option("NAMES", "Other inputs that moved, separated by commas, whose share is removed.")
    ] = "",
    columns: ColumnOption = None,
    start_s: FromOption = None,
    end_s: ToOption = None,
    band: BandOption = None,
    windows: WindowsOption = None,
    points: Annotated[int, define_option("N", "Number of frequencies.", min=8)] = 120,
    out: Annotated[Path | None, define_option("DIR", "Folder for a picture (PNG) and the response (CSV).")] = None,
    as_json: JsonOption = False,
) -> None:
    """Measure bandwidth and phase delay of an attitude response from a sweep, as ADS-33 defines them.

    Example: mufly identify bandwidth roll-sweep.csv --input lat --output phi --band 0.2:8 --out roll
    """
    from mufly.identify.linear.bandwidth import measure_attitude_bandwidth
    from mufly.identify.linear.sweep_response import estimate_response_of_records

    check_output_place("--out", out)
    angle = parse_named_texts(output)
    if len(angle) != 1:
        raise InputError("--output", "", f"{output!r} is not a single output", "give one output")
    response = estimate_response_of_records(
        [_read_record(log, columns, start_s, end_s) for log in logs], parse_named_texts(f"{input_},{others}"), angle,
        band_hz=band, windows_s=windows or (), points=points,
    )  # fmt: skip
    found = measure_attitude_bandwidth(response)
    print_answer(as_json, found, files=[] if out is None else _write_bandwidth(found, out))


def _write_bandwidth(found: AttitudeBandwidth, out: Path) -> list[Path]:
    from mufly.identify import fit_pictures
    from mufly.identify.linear.response_pictures import draw_frequency_response

    stick = found.response.select_inputs(found.response.inputs[:1])
    (pair,) = stick.tabulate_pair_responses().values()
    table = write_records(out / "response.csv", columns_to_rows({"frequency_Hz": stick.frequency_hz, **pair}))
    with fit_pictures.apply_report_colours():
        return [table, save_figure(draw_frequency_response(stick, read=found.bandwidth), out, "bandwidth")]


def compatibility(
    log: Annotated[Path, define_argument("LOG", "Record: CSV, MATLAB file, or any flight log that `mufly log` reads.")],
    imu: Annotated[
        str,
        define_option(
            "NAMES",
            "Inertial signals: p, q, r (rad/s), ax, ay, az (m/s^2, body axes, z down: -9.8 at rest), each "
            "with =COLUMN, =-COLUMN or =9.80665*COLUMN where needed.",
        ),
    ] = "p,q,r,ax,ay,az",
    measured: Annotated[
        str,
        define_option(
            "NAMES",
            "Measured signals: phi, theta, psi (rad), and any of v_north, v_east, v_down (m/s), north, "
            "east, down (m), written likewise.",
        ),
    ] = "phi,theta,psi,v_north,v_east,v_down,north,east,down",
    columns: ColumnOption = None,
    start_s: FromOption = None,
    end_s: ToOption = None,
    out: Annotated[
        Path | None, define_option("DIR", "Folder for a picture (PNG) and the reconstructed path (CSV).")
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """Reconstruct the flight path from measurements, with biases and scale factors of gyros and accelerometers.

    Example: mufly identify compatibility flight.csv --imu p,q,r,ax,ay,az --measured phi,theta,psi,north,east,down
    """
    from mufly.identify import fit_pictures
    from mufly.identify.linear.flight_path_reconstruction import reconstruct_flight_path
    from mufly.identify.linear.response_pictures import draw_reconstructed_outputs

    check_output_place("--out", out)
    record = _read_record(log, columns, start_s, end_s)
    found = reconstruct_flight_path(record, parse_named_texts(imu), parse_named_texts(measured))
    files = []
    if out is not None:
        files = [write_records(out / "path.csv", columns_to_rows(found.tabulate_path()))]
        with fit_pictures.apply_report_colours():
            files.append(save_figure(draw_reconstructed_outputs(found), out, "path"))
    print_answer(as_json, found, files=files)


def register_linear_commands(app: CommandGroup) -> None:
    """Register the commands of linear models."""
    for command in (linear, frequency, bandwidth, compatibility):
        app.command()(command)
