"""``mufly identify linear``: linear models of flights, by output error, equation error or frequency response."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import numpy as np

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
    write_csv,
    write_records,
)
from mufly.errors import InputError
from mufly.results import to_plain_data, to_records

if TYPE_CHECKING:
    from mufly.identify import LinearResult, UniformLogTable
    from mufly.identify.linear.bandwidth import Bandwidth
    from mufly.identify.linear.frequency_response import FrequencyResponse
    from mufly.identify.linear.sweep_response import TransferFunctionFit

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
        names = _parse_column_map(inputs), _parse_column_map(outputs)
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
            records[0], _parse_column_map(inputs), _parse_column_map(outputs), model=model, split=split,
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
            without=[w.strip() for w in without.split(",") if w.strip()], cut_hz=lowpass or 10.0, progress=progress,
        )  # fmt: skip
    report = []
    if out is not None:
        from mufly.identify import ReportSection, write_report

        sections = [
            ReportSection("Equations", (), *e.equation_table(model)),
            ReportSection("How the terms were chosen", (), *e.stepwise_table(model)),
            ReportSection("Fit of the records", (e.SCORES_EXPLANATION,), *e.score_table(model)),
        ]
        with progress_bar("pictures", not as_json) as progress:
            report.append(write_report(e.equation_fit_result(model), out, sections=sections, progress=progress))
    if as_json:
        return print_json(model)
    print_lines(*model.notes, mark="Note")
    print_table(*e.equation_table(model), title="Equations", text=(0, 1, 2, 3, 7))
    print_table(*e.score_table(model), title="Fit of the records (%)", text=(0, 1))
    print_lines(*(f"{k + 1}: {f.name}" for k, f in enumerate(model.records)), style="dim")
    print_lines(e.SCORES_EXPLANATION, style="dim")
    print_files(report, "Report")


def _parse_column_map(text: str) -> dict[str, str]:
    found = {}
    for part in text.split(","):
        name, _, column = part.strip().partition("=")
        if name:
            found[name.strip()] = column.strip() or name.strip()
    return found


def _print_linear_model(r: LinearResult) -> None:
    from mufly.identify.fit_report import (
        candidate_table,
        estimate_table,
        format_pole,
        prediction_table,
        simulation_quality_table,
    )

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


def _compute_responses(
    logs: Sequence[Path], inputs: Mapping[str, str], outputs: Mapping[str, str], columns: Sequence[str] | None,
    start_s: float | None, end_s: float | None, band: tuple[float, float] | None, windows: tuple[float, ...] | None,
    points: int,
) -> FrequencyResponse:  # fmt: skip
    """Return the composite responses of several logs."""
    from mufly.identify.linear.sweep_response import choose_window_lengths, estimate_composite_response

    records = [_read_record(log, columns, start_s, end_s) for log in logs]
    dt = records[0].dt
    for r in records:
        if abs(r.dt / dt - 1.0) > 0.01:
            raise InputError(
                r.name,
                "time",
                f"has a rate of {1 / r.dt:.4g} Hz, but {records[0].name} has {1 / dt:.4g} Hz",
                "resample one of them",
            )
    us = [r.stack_columns(inputs, "inputs") for r in records]
    ys = [r.stack_columns(outputs, "outputs") for r in records]
    shortest = min(len(u) for u in us) * dt
    low, high = band or (4.0 / shortest, min(10.0, 0.4 / dt))
    lengths = windows or choose_window_lengths(shortest, low, high)
    return estimate_composite_response(
        us, ys, dt, windows_s=lengths, low_hz=low, high_hz=high, points=points, input_names=tuple(inputs),
        output_names=tuple(outputs),
    )  # fmt: skip


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
    from mufly.errors import ArgumentError
    from mufly.identify.linear.sweep_response import MIN_PARTIAL_COHERENCE, fit_transfer_function

    check_output_place("--out", out)
    orders = None
    if fit is not None:
        try:
            zeros, poles = (int(n) for n in fit.split("/"))
            orders = (zeros, poles)
        except ValueError:
            raise InputError("--fit", "", f"{fit!r} is not ZEROS/POLES", "write 0/1 or 1/2") from None
    names = _parse_column_map(inputs), _parse_column_map(outputs)
    data = _compute_responses(logs, *names, columns, start_s, end_s, band, windows, points)
    pairs = [(o, i) for o in range(len(data.outputs)) for i in range(len(data.inputs))]
    fits, unfitted, why = [], [], ""
    for o, i, (zeros, poles) in ((o, i, orders) for o, i in pairs if orders is not None):
        try:
            fits.append(fit_transfer_function(data, o, i, zeros=zeros, poles=poles))
        except ArgumentError:
            raise
        except InputError as error:
            unfitted.append(f"{data.inputs[i]} to {data.outputs[o]}")
            why = str(error.problem)
    files = [] if out is None else _write_responses(data, out, fits)
    if as_json:
        content = {**to_plain_data(data), "transfer_functions": fits, "not_fitted": unfitted}
        return print_answer(as_json, content, None, files)
    rows = []
    f = data.frequency_hz
    for o, i in pairs:
        good = data.partial[:, o, i] >= MIN_PARTIAL_COHERENCE
        text = f"{f[good][0]:.2g} to {f[good][-1]:.2g}" if good.any() else "none"
        size = f"{100 * np.median(data.error[good, o, i]):.1f} %" if good.any() else "-"
        numbers = (f"{int(good.sum())} of {len(f)}", f"{data.partial[:, o, i].max():.2f}", size)
        rows.append((f"{data.inputs[i]} to {data.outputs[o]}", text, *numbers))
    heads = ("pair", f"coherence >= {MIN_PARTIAL_COHERENCE:g} (Hz)", "points", "most", "random error")
    print_table(heads, rows, title="Frequency responses, each input conditioned on the others", text=(0, 1))
    for one in fits:
        _print_transfer_function(one)
    if unfitted:
        print_lines(f"{', '.join(unfitted)}: {why}", mark="Not fitted")
    print_files(files)


def _print_transfer_function(t: TransferFunctionFit) -> None:
    rows = [
        (f"{letter}{power}", f"{value:.4g}", f"{std:.2g}")
        for letter, values, stds in (
            ("b", t.numerator, t.numerator_std),
            ("a", t.denominator, t.denominator_std),
        )
        for power, value, std in zip(range(len(values) - 1, -1, -1), values, stds, strict=True)
        if std > 0.0
    ]
    rows.append(("delay (s)", f"{t.delay_s:.3g}", f"{t.delay_std_s:.2g}"))
    low, high = t.band_hz
    print_table(
        ("", "value", "std"),
        rows,
        title=f"{t.input} to {t.output}, {low:.2g} to {high:.2g} Hz, J = {t.cost:.0f}",
    )
    from mufly.identify.fit_report import format_pole

    print_lines(f"Poles: {', '.join(format_pole(p) for p in t.poles)} rad/s")


def _write_responses(data: FrequencyResponse, out: Path, fits: Sequence[TransferFunctionFit]) -> list[Path]:
    from mufly.identify import fit_pictures
    from mufly.identify.linear.response_pictures import draw_frequency_response

    heads, columns = ["frequency_Hz"], [data.frequency_hz]
    for name, pair in data.tabulate_pair_responses().items():
        heads += [f"{name.replace(' ', '_')}_{key}" for key in pair]
        columns += list(pair.values())
    heads += [f"{o}_multiple_coherence" for o in data.outputs]
    columns += list(data.coherence.T)
    files = [write_csv(out / "responses.csv", heads, np.column_stack(columns).tolist())]
    for k, name in enumerate(data.outputs):
        with fit_pictures.report_style():
            files.append(save_figure(draw_frequency_response(data, k, fits=fits), out, f"response-{name}"))
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
    from dataclasses import replace

    from mufly.identify.linear.bandwidth import measure_bandwidth as read_off
    from mufly.identify.linear.sweep_response import MIN_PARTIAL_COHERENCE

    check_output_place("--out", out)
    inputs, outputs = _parse_column_map(f"{input_},{others}"), _parse_column_map(output)
    if len(outputs) != 1:
        raise InputError("--output", "", f"{output!r} is not a single output", "give one output")
    data = _compute_responses(logs, inputs, outputs, columns, start_s, end_s, band, windows, points)
    name = data.outputs[0]
    if name in ("p", "q", "r"):
        turned = data.response / (2j * np.pi * data.frequency_hz[:, None, None])
        data = replace(data, response=turned, outputs=(f"{name}/s",))
    good = data.partial[:, 0, 0] >= MIN_PARTIAL_COHERENCE
    found = read_off(data.frequency_hz, np.where(good, data.response[:, 0, 0], np.nan), data.error[:, 0, 0])
    files = [] if out is None else _write_bandwidth(data, found, out)
    if as_json:
        return print_answer(as_json, {**to_plain_data(found), **to_plain_data(data)}, None, files)
    rows = []
    for label, field in (
        ("bandwidth, the lesser", "bandwidth"), ("by phase margin of 45 deg", "phase"),
        ("by gain margin of 6 dB", "gain"), ("phase -180 deg at", "phase_crossover"),
    ):  # fmt: skip
        value, std = getattr(found, f"{field}_rad_s"), getattr(found, f"{field}_std_rad_s")
        rows.append((label, *(("-", "-") if np.isnan(value) else (f"{value:.3g}", f"{std:.2g}")), "rad/s"))
    delay, std = found.phase_delay_s, found.phase_delay_std_s
    rows.append(("phase delay", *(("-", "-") if np.isnan(delay) else (f"{delay:.3g}", f"{std:.2g}")), "s"))
    line = found.phase_delay_line_s
    rows.append(("phase delay, by a straight line", "-" if np.isnan(line) else f"{line:.3g}", "", "s"))
    print_table(("", "value", "std", "unit"), rows, title=f"{data.inputs[0]} to {data.outputs[0]}", text=(0, 3))
    print_lines(*found.notes, mark="Note")
    print_files(files)


def _write_bandwidth(data: FrequencyResponse, found: Bandwidth, out: Path) -> list[Path]:
    from dataclasses import replace

    from mufly.identify import fit_pictures
    from mufly.identify.linear.response_pictures import draw_frequency_response

    first = slice(0, 1)
    one = replace(
        data, inputs=data.inputs[:1], response=data.response[:, :, first], partial=data.partial[:, :, first],
        error=data.error[:, :, first],
        degrees_of_freedom=data.degrees_of_freedom[:, :, first],
        outputs=(data.outputs[0].replace("/", "-over-"),),
    )  # fmt: skip
    with fit_pictures.report_style():
        picture = save_figure(draw_frequency_response(one, 0, read=found), out, "bandwidth")
    (pair,) = one.tabulate_pair_responses().values()
    return [write_records(out / "response.csv", to_records({"frequency_Hz": one.frequency_hz, **pair})), picture]


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
    from mufly.identify.linear.flight_path_reconstruction import FLIGHT_PATH_STATES
    from mufly.identify.linear.flight_path_reconstruction import reconstruct_flight_path as reconstruct

    check_output_place("--out", out)
    found = reconstruct(_read_record(log, columns, start_s, end_s), _parse_column_map(imu), _parse_column_map(measured))
    files = []
    if out is not None:
        from mufly.identify import fit_pictures
        from mufly.identify.linear.response_pictures import draw_reconstructed_outputs

        stds, corrected = (f"{s}_std" for s in FLIGHT_PATH_STATES), (f"{n}_corrected" for n in _parse_column_map(imu))
        heads = ["time_s", *FLIGHT_PATH_STATES, *stds, *corrected]
        rows = np.column_stack([found.time_s, found.states, found.states_std, found.corrected])
        with fit_pictures.report_style():
            files = [
                write_csv(out / "path.csv", heads, rows.tolist()),
                save_figure(draw_reconstructed_outputs(found), out, "path"),
            ]
    if as_json:
        return print_answer(as_json, found, None, files)
    print_lines(*found.notes, mark="Note")
    white = {e.symbol: f"{w:.2g}" for e, w in zip(found.estimates, found.std_white, strict=True)}
    rows_ = [
        (e.symbol, f"{e.value:+.4g}", f"{e.std:.2g}", white[e.symbol], f"{e.low:+.3g} to {e.high:+.3g}", e.unit)
        for e in found.estimates
    ]
    heads_ = ("", "value", "std", "std if white", "95 % interval", "unit")
    print_table(heads_, rows_, title="Bias b and scale factor lambda: measured = (1 + lambda) true + b", text=(0, 5))
    figures = (found.residual_rms, found.output_noise, found.innovation_rms)
    lines = zip(found.outputs, *figures, strict=True)
    below = ("", "rms residual", "its noise", "innovation over expected")
    print_table(below, [(o, f"{r:.2g}", f"{s:.2g}", f"{i:.2f}") for o, r, s, i in lines], title="The path, SI")
    if found.undetermined:
        print_lines("Parameters that the flight does not determine:", *(f"- {w}" for w in found.undetermined))
    print_lines("Converged" if found.converged else "NOT converged", style="green" if found.converged else "red")
    print_files(files)


def register_linear_commands(app: CommandGroup) -> None:
    """Register the commands of linear models."""
    for command in (linear, frequency, bandwidth, compatibility):
        app.command()(command)
