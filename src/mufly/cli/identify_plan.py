"""``mufly identify plan``: which signal to fly, how large, and how well it will show which parameter."""

from __future__ import annotations

import csv
import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, cast

import typer

from mufly.cli.identify_shared import check_folder
from mufly.cli.options import JsonOption, console, print_json, print_table, progress_bar, save_picture

if TYPE_CHECKING:
    from mufly.identify.excitation import Kind
    from mufly.identify.plan import Candidate, Limits, Plan

__all__ = ["plan"]


def plan(
    vehicle: Annotated[str, typer.Argument(metavar="NAME|FILE", help="The vehicle as far as it is known.")],
    free: Annotated[
        str,
        typer.Option(metavar="SYMBOL,...", help="Parameters to be identified, as `mufly vehicle show` prints them."),
    ],
    channel: Annotated[
        str,
        typer.Option(metavar="NAME,...", help="yaw, heave, roll or pitch; several make a plan for several flights."),
    ] = "yaw",
    kind: Annotated[
        str, typer.Option(metavar="NAME", help="chirp, multisine, 3211 or doublet; 'best' compares them all.")
    ] = "best",
    duration: Annotated[float, typer.Option(metavar="S", help="Length of each flight.")] = 10.0,
    amplitude: Annotated[
        float | None,
        typer.Option(
            metavar="SHARE", help="Largest addition to an input, 0 to 1; lowered if it is not safe. Default: the "
            "largest that is.",
        ),
    ] = None,
    band: Annotated[
        str | None,
        typer.Option(metavar="LOW:HIGH", help="Frequencies in Hz, as 0.1:3. Default: around the channel's modes."),
    ] = None,
    limit: Annotated[
        str | None,
        typer.Option(
            metavar="NAME=VALUE,...", help="attitude_deg, heading_deg, rates_deg_s, height_m, place_m from hover; "
            "motor, servo: distance of inputs from their ends. Default: attitude_deg=20,heading_deg=90,rates_deg_s=229,"
            "height_m=0.5,place_m=1,motor=0.05,servo=0.1.",
        ),
    ] = None,
    noise: Annotated[
        str | None,
        typer.Option(
            metavar="OUTPUT=STD,...", help="Sensors (SI), as 'height=0.005,speed_up=2,yaw=none'; added to the defaults "
            "height 0.01 m, roll and pitch 0.01, yaw 0.02 rad, p, q, r 0.03 rad/s.",
        ),
    ] = None,
    delay: Annotated[float, typer.Option(metavar="S", help="From command to input.")] = 0.02,
    window: Annotated[
        float,
        typer.Option(
            metavar="S", help="The motion counts as unknown anew every so often, which stands for gusts; 0: only at "
            "the start, the bound of a perfect world.",
        ),
    ] = 2.0,
    sample: Annotated[float, typer.Option(metavar="S", help="Time between samples of the log.")] = 0.01,
    out: Annotated[
        Path | None, typer.Option("--out", metavar="DIR", help="Write signals (CSV) and pictures (PNG) there.")
    ] = None,
    as_json: JsonOption = False,
) -> None:  # fmt: skip
    """Design flights for identification: signals within safe limits, and what they will tell before anyone flies.

    Example: mufly identify plan mufly-1.1 --free cT_dw,cQ_dw,Jdrive_dw --channel yaw,heave --out plan
    """
    from mufly.identify.excitation import KINDS
    from mufly.identify.plan import NOISE, design, together
    from mufly.identify.plan_picture import plan_picture
    from mufly.vehicle import load_vehicle

    v = load_vehicle(vehicle)
    symbols = [s.strip() for s in free.split(",") if s.strip()]
    channels = list(dict.fromkeys(c.strip() for c in channel.split(",") if c.strip()))
    kinds = KINDS if kind == "best" else (cast("Kind", kind),)
    check_folder("--out", out)
    _check_times(duration, delay, sample, window)
    limits, std, frequencies = _limits(limit), _noise(noise, NOISE), _band(band)
    plans: list[Plan] = []
    for name in channels:
        with progress_bar(f"{name} flights", shown=not as_json) as move:
            plans.append(
                design(
                    v, symbols, name, kinds=kinds, duration_s=duration, amplitude=amplitude, band_rad_s=frequencies,
                    limits=limits, noise=std, sample_s=sample, delay_s=delay, progress=move,
                    window_s=window if window > 0 else None,
                )
            )  # fmt: skip
    chosen = [p.best for p in plans]
    relative, unseen = together(plans, chosen)
    files = []
    if out is not None:
        for p, c in zip(plans, chosen, strict=True):
            files.append(save_picture(plan_picture(p, c), out, f"plan_{p.channel}"))
            files.append(_write_signal(out / f"signal_{p.channel}_{c.signal.kind}.csv", c))
    if as_json:
        print_json(
            {
                "vehicle": v.name, "free": symbols,
                "channels": [_plan_json(p) for p in plans],
                "together": dict(zip(symbols, relative.tolist(), strict=True)), "unseen": unseen,
                "files": [str(f) for f in files],
            }
        )  # fmt: skip
        return
    for p in plans:
        _print(p)
    say = console()
    if len(plans) > 1:
        print_table(
            ["", *symbols], [["all flights", *(_percent(s) for s in relative)]],
            title="Expected standard deviation, together",
        )  # fmt: skip
    for words in unseen:
        say.print(f"not seen: {words}", highlight=False, markup=False)
    say.print(
        "These are bounds for the model as it is and white sensor noise; what the model leaves out makes real fits "
        "worse, often several times.",
        style="dim",
    )
    for file in files:
        say.print(f"written: {file}", highlight=False, markup=False)


def _check_times(duration: float, delay: float, sample: float, window: float) -> None:
    from mufly.errors import InputError

    if (
        not (math.isfinite(sample) and 1e-3 <= sample <= 0.1)
        or abs(sample / 1e-3 - round(sample / 1e-3)) > 1e-6
    ):
        raise InputError(
            "--sample", "", f"{sample:g} s is not possible", "give whole milliseconds from 0.001 to 0.1"
        )
    if not (math.isfinite(delay) and 0 <= delay <= 0.2) or abs(delay / sample - round(delay / sample)) > 1e-6:
        raise InputError(
            "--delay", "", f"{delay:g} s is not possible", f"give a multiple of {sample:g} s up to 0.2"
        )
    if not (math.isfinite(window) and (window == 0 or window >= 10 * sample)):
        raise InputError(
            "--window", "", f"{window:g} s is not possible", f"give 0, or {10 * sample:g} s or more"
        )
    if not (math.isfinite(duration) and 2.0 <= duration <= 300.0):
        raise InputError("--duration", "", f"{duration:g} s is not possible", "give 2 to 300 s")


def _numbers(
    option: str, text: str | None, known: tuple[str, ...], *, none: bool = False
) -> dict[str, float | None]:
    from mufly.errors import InputError

    found: dict[str, float | None] = {}
    for part in (text or "").split(","):
        if not part.strip():
            continue
        name, _, value = (t.strip() for t in part.partition("="))
        if name not in known:
            raise InputError(option, name, "is unknown", f"use one of: {', '.join(known)}")
        try:
            number = None if none and value == "none" else float(value)
        except ValueError:
            raise InputError(
                option, name, f"{value!r} is no number", "give one in the unit of the name"
            ) from None
        if number is not None and not (math.isfinite(number) and number > 0):
            raise InputError(option, name, f"{value} is not possible", "give a number above 0")
        found[name] = number
    return found


def _limits(text: str | None) -> Limits:
    from mufly.errors import InputError
    from mufly.identify.plan import Limits

    names = {
        "attitude_deg": ("attitude_rad", math.radians(1)), "heading_deg": ("heading_rad", math.radians(1)),
        "rates_deg_s": ("rates_rad_s", math.radians(1)), "height_m": ("height_m", 1.0), "place_m": ("place_m", 1.0),
        "motor": ("motor", 1.0), "servo": ("servo", 1.0),
    }  # fmt: skip
    given = _numbers("--limit", text, tuple(names))
    for name, top in (("motor", 0.5), ("servo", 1.0)):
        if (given.get(name) or 0.0) >= top:
            raise InputError("--limit", name, f"{given[name]} leaves no room", f"give a number below {top:g}")
    return Limits(**{names[k][0]: v * names[k][1] for k, v in given.items() if v is not None})


def _noise(text: str | None, default: dict[str, float]) -> dict[str, float]:
    from mufly.identify.simulate import OUTPUTS

    merged: dict[str, float | None] = {**default, **_numbers("--noise", text, OUTPUTS, none=True)}
    return {k: v for k, v in merged.items() if v is not None}


def _band(text: str | None) -> tuple[float, float] | None:
    from mufly.errors import InputError

    if text is None:
        return None
    try:
        low, high = (2 * math.pi * float(part) for part in text.split(":"))
    except ValueError:
        raise InputError(
            "--band", "", f"{text!r} is no band", "write two frequencies in Hz, as 0.1:3"
        ) from None
    return low, high


def _percent(share: float) -> str:
    if not math.isfinite(share) or share > 10:
        return "not seen"
    return f"{100 * share:.0f} %" if share >= 0.1 else f"{100 * share:.2g} %"


def _print(p: Plan) -> None:
    symbols = [f.symbol for f in p.free]
    low, high = (w / (2 * math.pi) for w in p.band_rad_s)
    rows = [
        [
            c.signal.kind, f"{100 * c.amplitude:.1f} %", c.bound_by, f"{c.signal.crest:.2f}",
            *(_percent(s) for s in c.relative_std), _percent(c.figure),
        ]
        for c in p.candidates
    ]  # fmt: skip
    frequencies = f"{low:.2g} to {high:.2g} Hz"
    modes = ", ".join(f"{m / (2 * math.pi):.2g}" for m in p.modes_rad_s)
    print_table(
        ["kind", "amplitude", "bound by", "crest", *symbols, "mean"], rows,
        title=f"{p.vehicle}, {p.channel}: expected standard deviations; {frequencies}, modes at {modes} Hz",
    )  # fmt: skip
    best = p.best
    console().print(f"{best.signal.kind}: {best.signal.words}", highlight=False, markup=False)


def _plan_json(p: Plan) -> dict[str, Any]:
    return {
        "channel": p.channel, "band_Hz": [w / (2 * math.pi) for w in p.band_rad_s],
        "modes_Hz": [w / (2 * math.pi) for w in p.modes_rad_s], "noise": p.noise, "limits": vars(p.limits),
        "candidates": [
            {
                "kind": c.signal.kind, "amplitude": c.amplitude, "bound_by": c.bound_by, "limit_used": c.share,
                "crest_factor": c.signal.crest, "signal": c.signal.words, "mean": c.figure,
                "relative_std": dict(zip((f.symbol for f in p.free), c.relative_std.tolist(), strict=True)),
            }
            for c in p.candidates
        ],
    }  # fmt: skip


def _write_signal(path: Path, c: Candidate) -> Path:
    from mufly.errors import InputError

    try:
        with path.open("w", newline="", encoding="utf-8") as file:
            file.write(f"# {c.channel}, {c.signal.kind}: {c.signal.words}; add the columns to the inputs\n")
            writer = csv.writer(file)
            writer.writerow(["time_s", "signal", "motor_upper", "motor_lower", "servo_1", "servo_2"])
            for t, s, row in zip(c.signal.time_s, c.amplitude * c.signal.value, c.added, strict=True):
                writer.writerow([f"{t:.6g}", f"{s:.6g}", *(f"{u + 0.0:.6g}" for u in row)])
    except OSError as error:
        raise InputError("--out", str(path), f"cannot be written ({error})", "give another folder") from error
    return path
