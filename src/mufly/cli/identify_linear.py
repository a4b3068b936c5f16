"""``mufly identify linear``: a linear model from a flight record, and how it predicts what it has not seen."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from mufly.cli.identify_shared import check_folder
from mufly.cli.options import JsonOption, console, print_json, print_table, progress_bar

if TYPE_CHECKING:
    from mufly.identify.linear_result import LinearResult

__all__ = ["add_to"]


def add_to(app: typer.Typer) -> None:
    """Register the command with the group ``mufly identify``."""
    app.command("linear")(linear)


def linear(
    log: Annotated[
        Path, typer.Argument(metavar="LOG", help="CSV, MATLAB file, or any flight log that `mufly log` reads.")
    ],
    inputs: Annotated[
        str,
        typer.Option(metavar="NAMES", help="lat, lon, ped, col, each with =COLUMN if the log calls it otherwise; "
                     "=-COLUMN turns the sign."),
    ] = "lat,lon,ped,col",
    outputs: Annotated[
        str, typer.Option(metavar="NAMES", help="Some of p, q, r, phi, theta, u, v, w, with =COLUMN where needed.")
    ] = "p,q,r",
    columns: Annotated[
        list[str] | None,
        typer.Option(metavar="[ARRAY=]NAMES", help="Names of a file's columns where it has none: a,b,c for CSV, "
                     "inr=lat,lon,ped,col for an array of a MATLAB file ('-' skips one). May be repeated."),
    ] = None,
    model: Annotated[
        str,
        typer.Option(metavar="NAME", help="auto (cross-validated inside the fitted part), helicopter (hybrid flapping, "
                     "coupled, yaw gyro), or first-order, second-order, hybrid with any of -coupled, -collective, "
                     "-gyro, -speed, -skew."),
    ] = "auto",
    split: Annotated[
        float, typer.Option(metavar="SHARE", help="First share of the record that the fit may see; 1: all.")
    ] = 0.5,
    split_at: Annotated[
        float | None, typer.Option(metavar="S", help="The same as a time in the record (s), before --split.")
    ] = None,
    start_s: Annotated[float | None, typer.Option("--from", metavar="S", help="Begin at this time (s).")] = None,
    end_s: Annotated[float | None, typer.Option("--to", metavar="S", help="End at this time (s).")] = None,
    lowpass: Annotated[
        float, typer.Option(metavar="HZ", help="Inputs and outputs are filtered alike for the fit; 0: not at all.")
    ] = 5.0,
    rate: Annotated[
        float, typer.Option(metavar="HZ", help="Rate of the samples that the fit uses; 0: all of them.")
    ] = 25.0,
    starts: Annotated[int, typer.Option(metavar="N", help="Searches from different starts.", min=1)] = 6,
    seed: Annotated[int, typer.Option(metavar="K", help="Of the random starts.")] = 0,
    hold: Annotated[bool, typer.Option("--hold", help="Inputs are held between samples, not joined.")] = False,
    out: Annotated[
        Path | None, typer.Option(metavar="DIR", help="Write report.html and its pictures (PNG) there.")
    ] = None,
    as_json: JsonOption = False,
) -> None:  # fmt: skip
    """Fit a linear model to the first part of a flight record and predict the rest from its inputs alone.

    Example: mufly identify linear flight.csv --inputs lat,lon,ped,col --outputs p,q,r --split 0.5 --out report
    """
    from mufly.errors import InputError
    from mufly.identify.linear import identify_linear
    from mufly.identify.linear_columns import read_columns

    check_folder("--out", out)
    record = read_columns(log, columns=_columns(columns or ()))
    if start_s is not None or end_s is not None:
        t = record.time_s
        a = 0 if start_s is None else int((t < start_s).sum())
        b = len(t) if end_s is None else int((t <= end_s).sum())
        if b - a < 100:
            raise InputError(
                "--from, --to", "", f"leave {max(b - a, 0)} samples of {log.name}, which lasts from {t[0]:.2f} to "
                f"{t[-1]:.2f} s", "leave at least 100",
            )  # fmt: skip
        record = record.part(a, b)
    if starts < 1:
        raise InputError("--starts", "", f"{starts} is no number of searches", "give 1 or more")
    with progress_bar("structures and searches", not as_json) as progress:
        result = identify_linear(
            record, _names(inputs), _names(outputs), model=model, split=split, split_at_s=split_at,
            lowpass_hz=lowpass or None, rate_hz=rate or None, starts=starts, seed=seed, hold=hold, progress=progress,
        )  # fmt: skip
    report = None
    if out is not None:
        from mufly.identify.linear_report import write_linear_report

        with progress_bar("pictures", not as_json) as progress:
            report = write_linear_report(result, out, progress=progress)
    if as_json:
        print_json(_json(result))
    else:
        _print(result)
        if report is not None:
            console().print(f"Report: {report}", highlight=False)


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


def _print(r: LinearResult) -> None:
    from mufly.identify.linear_report import (
        ahead_rows,
        candidate_rows,
        estimate_rows,
        pole_text,
        quality_rows,
    )

    say = console().print
    for note in r.notes:
        say(f"Note: {note}", highlight=False)
    if r.candidates:
        print_table(*candidate_rows(r), title="Structures, cross-validated inside the fitted part")
    print_table(*estimate_rows(r), title=f"Model {r.fit.vehicle}")
    poles = ", ".join(pole_text(p) for p in r.linear.poles)
    say(f"Poles: {poles} rad/s\n{r.linear.message}", highlight=False)
    print_table(*quality_rows(r), title="Pure simulation from inputs", text=(0, 1))
    say(
        "at most: with no error but the noise floor; to angle: against the derivative of the measured angle; error and "
        f"noise: rms below {r.slow_hz:g} Hz (noise >: above it), in the output's unit; Theil: 0 exact, 1 no relation",
        style="dim", highlight=False,
    )  # fmt: skip
    if r.ahead:
        print_table(
            *ahead_rows(r), title=f"Held-out part, predicted a time ahead (low-passed at {r.slow_hz:g} Hz)"
        )
    if r.missing:
        say(
            "What the residuals of the fitted part show:",
            *(f"- {w}" for w in r.missing),
            sep="\n",
            highlight=False,
        )
    if r.fit.unseen:
        say("What the data cannot tell:", *(f"- {w}" for w in r.fit.unseen), sep="\n", highlight=False)


def _json(r: LinearResult) -> dict[str, Any]:
    from dataclasses import asdict

    return {
        "model": r.fit.vehicle,
        "estimates": [asdict(e) for e in r.fit.estimates],
        "poles_rad_s": [{"real": p.real, "imag": p.imag} for p in r.linear.poles.tolist()],
        "candidates": [asdict(c) for c in r.candidates],
        "outputs": list(r.linear.structure.outputs),
        "quality": {role: [asdict(q) for q in qs] for role, qs in r.quality.items()},
        "quality_slow": {role: [asdict(q) for q in qs] for role, qs in r.quality_slow.items()},
        "slow_hz": r.slow_hz,
        "noise_floor": {role: [{**asdict(f), "total": f.total} for f in fs] for role, fs in r.floors.items()},
        "ceiling_percent": dict(r.ceiling), "ceiling_slow_percent": dict(r.ceiling_slow),
        "against_angle_percent": dict(r.against_angle),
        "ahead": [
            {**asdict(a), "horizon_s": None if math.isinf(a.horizon_s) else a.horizon_s} for a in r.ahead
        ],
        "missing": list(r.missing), "unseen": list(r.fit.unseen), "notes": list(r.notes),
        "subspace_fit_percent": list(r.subspace_percent), "message": r.linear.message,
    }  # fmt: skip
