"""``mufly identify linear``: linear models of flight records, by simulation, by equation error, by frequency."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from mufly.cli.options import Commands, JsonOption, argument, one_of, option
from mufly.cli.present import check_folder, print_json, print_table, progress_bar, say, tell_files
from mufly.errors import InputError
from mufly.results import plain

if TYPE_CHECKING:
    from mufly.identify import Columns, LinearResult
    from mufly.identify.linear.equations import EquationModel

LogsArgument = Annotated[
    list[Path], argument("LOG...", "CSV, MATLAB file, or any flight log that `mufly log` reads.")
]
InputsOption = Annotated[
    str,
    option(
        "NAMES",
        "lat, lon, ped, col, each with =COLUMN if the log calls it otherwise; =-COLUMN turns the sign, "
        "=m3+m4-m1-m2 adds columns, =0.5*COLUMN scales.",
    ),
]
OutputsOption = Annotated[
    str, option("NAMES", "Some of p, q, r, phi, theta, u, v, w, with =COLUMN where needed.")
]
ColumnsOption = Annotated[
    list[str] | None,
    option(
        "[ARRAY=]NAMES",
        "Names of a file's columns where it has none: a,b,c for CSV, inr=lat,lon,ped,col for an "
        "array of a MATLAB file ('-' skips one). May be repeated.",
    ),
]
FromOption = Annotated[float | None, option("--from S", "Begin at this time (s) of the log's own clock.")]
ToOption = Annotated[float | None, option("--to S", "End at this time (s).")]


def linear(
    logs: LogsArgument,
    inputs: InputsOption = "lat,lon,ped,col",
    outputs: OutputsOption = "p,q,r",
    columns: ColumnsOption = None,
    method: Annotated[
        str,
        option(
            "NAME",
            "output-error (one log, simulated as a whole) or equation-error (any number of logs, terms chosen "
            "step by step: for vehicles flown under feedback).",
        ),
    ] = "output-error",
    model: Annotated[
        str,
        option(
            "NAME",
            "auto (cross-validated inside the fitted part), helicopter (hybrid flapping, coupled, "
            "yaw gyro), or first-order, second-order, hybrid with any of -coupled, -collective, "
            "-gyro, -speed, -skew.",
        ),
    ] = "auto",
    split: Annotated[float, option("SHARE", "First share of the record that the fit may see; 1: all.")] = 0.5,
    split_at: Annotated[
        float | None, option("S", "The same as a time in the record (s), before --split.")
    ] = None,
    hold_out: Annotated[
        list[Path] | None,
        option("LOG", "With equation-error: predict this log, do not fit it. May be repeated."),
    ] = None,
    start_s: FromOption = None,
    end_s: ToOption = None,
    lowpass: Annotated[
        float | None,
        option(
            "HZ",
            "Inputs and outputs are filtered alike for the fit; 0: not at all. Default: 5, of equation error 10.",
        ),
    ] = None,
    highpass: Annotated[
        float | None,
        option(
            "HZ",
            "With equation-error: lowest frequency that counts. Default: where the inputs explain the output.",
        ),
    ] = None,
    domain: Annotated[str, option("NAME", "With equation-error: frequency or time.")] = "frequency",
    products: Annotated[
        bool, option("--products", "With equation-error: products of two rates are candidates, too.")
    ] = False,
    without: Annotated[
        str, option("SYMBOLS", "With equation-error: terms that are no candidates, as L_p,M_q.")
    ] = "",
    rate: Annotated[float, option("HZ", "Rate of the samples that the fit uses; 0: all of them.")] = 25.0,
    starts: Annotated[int, option("N", "Searches from different starts.", min=1)] = 6,
    seed: Annotated[int, option("K", "Of the random starts.")] = 0,
    hold: Annotated[bool, option("--hold", "Inputs are held between samples, not joined.")] = False,
    out: Annotated[Path | None, option("DIR", "Write report.html and its pictures (PNG) there.")] = None,
    as_json: JsonOption = False,
) -> None:
    """Fit a linear model to the first part of a flight record, or to several, and predict the rest from its inputs.

    Example: mufly identify linear flight.csv --inputs lat,lon,ped,col --outputs p,q,r --split 0.5 --out report

    Example: mufly identify linear a.csv b.csv --hold-out c.csv --method equation-error --inputs lat,lon --outputs p,q
    """
    one_of("--method", method, ("output-error", "equation-error"))
    one_of("--domain", domain, ("time", "frequency"))
    check_folder("--out", out)
    if starts < 1:
        raise InputError("--starts", "", f"{starts} is no number of searches", "give 1 or more")
    records = [_record(log, columns, start_s, end_s) for log in logs]
    if method == "equation-error":
        held = [_record(log, columns, None, None) for log in hold_out or ()]
        if len(records) == 1 and not held and split < 1.0:
            n = len(records[0].time_s)
            cut = round(split * n) if split_at is None else int((records[0].time_s < split_at).sum())
            records, held = [records[0].part(0, cut)], [records[0].part(cut, n)]
        _by_equations(
            records,
            held,
            _names(inputs),
            _names(outputs),
            products,
            without,
            domain,
            lowpass,
            highpass,
            out,
            as_json,
        )
        return
    if len(records) > 1 or hold_out:
        raise InputError(
            "--method", method, "fits one record and holds out its second part",
            "give one LOG, or --method equation-error",
        )  # fmt: skip
    from mufly.identify.linear.identification import identify_linear

    with progress_bar("structures and searches", not as_json) as progress:
        result = identify_linear(
            records[0], _names(inputs), _names(outputs), model=model, split=split, split_at_s=split_at,
            lowpass_hz=(5.0 if lowpass is None else lowpass) or None, rate_hz=rate or None, starts=starts, seed=seed,
            hold=hold, progress=progress,
        )  # fmt: skip
    report = []
    if out is not None:
        from mufly.identify.report import write_linear_report

        with progress_bar("pictures", not as_json) as progress:
            report.append(write_linear_report(result, out, progress=progress))
    if as_json:
        print_json(_linear_json(result))
        return
    _print_linear(result)
    tell_files(report, "Report")


def _record(log: Path, columns: Sequence[str] | None, start_s: float | None, end_s: float | None) -> Columns:
    """Read a log, or a part of it."""
    from mufly.identify.record import read_columns

    record = read_columns(log, columns=_columns(columns or ()))
    if start_s is None and end_s is None:
        return record
    t = record.time_s
    a = 0 if start_s is None else int((t < start_s).sum())
    b = len(t) if end_s is None else int((t <= end_s).sum())
    if b - a < 100:
        raise InputError(
            "--from, --to", "", f"leave {max(b - a, 0)} samples of {log.name}, which lasts from {t[0]:.2f} to "
            f"{t[-1]:.2f} s", "leave at least 100",
        )  # fmt: skip
    return record.part(a, b)


def _by_equations(
    records: Sequence[Columns], held: Sequence[Columns], inputs: Mapping[str, str], outputs: Mapping[str, str],
    products: bool, without: str, domain: str, lowpass: float | None, highpass: float | None, out: Path | None,
    as_json: bool,
) -> None:  # fmt: skip
    from mufly.identify.linear import equations as e

    with progress_bar("equations", not as_json) as progress:
        model = e.identify_equations(
            records, inputs, outputs, held_out=held, products=products, domain=domain, low_hz=highpass,
            without=[w.strip() for w in without.split(",") if w.strip()], cut_hz=lowpass or 10.0, progress=progress,
        )  # fmt: skip
    report = []
    if out is not None:
        from mufly.identify import Section, write_report

        sections = [
            Section("Equations", (), *e.equation_rows(model)),
            Section("How the terms were chosen", (), *e.step_rows(model)),
            Section("How well the equations tell the records", (e.SCORES,), *e.score_rows(model)),
        ]
        with progress_bar("pictures", not as_json) as progress:
            report.append(write_report(e.equation_fit(model), out, sections=sections, progress=progress))
    if as_json:
        print_json(_equation_json(model))
        return
    say(*model.notes, mark="Note")
    print_table(*e.equation_rows(model), title="Equations", text=(0, 1, 2, 3, 7))
    print_table(*e.score_rows(model), title="How well they tell the records (%)", text=(0, 1))
    say(*(f"{k + 1}: {f.name}" for k, f in enumerate(model.records)), style="dim")
    say(e.SCORES, style="dim")
    tell_files(report, "Report")


def _equation_json(model: EquationModel) -> dict[str, Any]:
    equations = [
        {**plain(e), "symbols": e.symbols, "units": e.units, "terms": ["*".join(t) for t in e.terms]}
        for e in model.equations
    ]
    return {
        "equations": equations, "poles_rad_s": model.poles, "scores": model.scores, "notes": model.notes,
        "domain": model.domain,
    }  # fmt: skip


def _names(text: str) -> dict[str, str]:
    found = {}
    for part in text.split(","):
        name, _, column = part.strip().partition("=")
        if name:
            found[name.strip()] = column.strip() or name.strip()
    return found


def _columns(given: Sequence[str]) -> Mapping[str, Sequence[str]] | Sequence[str]:
    arrays = {a: names.split(",") for a, equals, names in (g.partition("=") for g in given) if equals}
    return arrays if arrays else [n for g in given for n in g.split(",")]


def _print_linear(r: LinearResult) -> None:
    from mufly.identify.report import ahead_rows, candidate_rows, estimate_rows, pole_text, quality_rows

    say(*r.notes, mark="Note")
    if r.candidates:
        print_table(*candidate_rows(r), title="Structures, cross-validated inside the fitted part")
    print_table(*estimate_rows(r), title=f"Model {r.fit.vehicle}")
    say(f"Poles: {', '.join(pole_text(p) for p in r.linear.poles)} rad/s", r.linear.message)
    print_table(*quality_rows(r), title="Pure simulation from inputs", text=(0, 1))
    say(
        "at most: with no error but the noise floor; to angle: against the derivative of the measured angle; error and "
        f"noise: rms below {r.slow_hz:g} Hz (noise >: above it), in the output's unit; Theil: 0 exact, 1 no relation",
        style="dim",
    )
    if r.ahead:
        print_table(
            *ahead_rows(r), title=f"Held-out part, predicted a time ahead (low-passed at {r.slow_hz:g} Hz)"
        )
    for title, words in (
        ("What the residuals of the fitted part show:", r.missing),
        ("What the data cannot tell:", r.fit.unseen),
    ):
        if words:
            say(title, *(f"- {w}" for w in words))


def _linear_json(r: LinearResult) -> dict[str, Any]:
    def each(name: str) -> dict[str, list[Any]]:
        return {role: [getattr(c, name) for c in checks] for role, checks in r.checks.items()}

    floors = {role: [{**plain(f), "total": f.total} for f in found] for role, found in each("floor").items()}
    return {
        "model": r.fit.vehicle, "estimates": r.fit.estimates, "poles_rad_s": r.linear.poles,
        "candidates": r.candidates, "outputs": r.linear.structure.outputs, "quality": each("quality"),
        "quality_slow": each("slow"), "slow_hz": r.slow_hz, "noise_floor": floors,
        "ceiling_percent": each("ceiling"), "ceiling_slow_percent": each("ceiling_slow"),
        "against_angle_percent": each("against_angle"), "ahead": r.ahead, "missing": r.missing,
        "unseen": r.fit.unseen, "notes": r.notes, "subspace_fit_percent": r.subspace_percent,
        "message": r.linear.message,
    }  # fmt: skip


def add_to(app: Commands) -> None:
    """Add the commands of linear models."""
    for command in (linear,):
        app.command()(command)
