"""``mufly identify motor`` and ``mufly identify rotor``: constants and coefficients from bench files."""

from __future__ import annotations

import math
import time
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from mufly.cli.options import (
    JsonOption,
    OutOption,
    angle,
    console,
    print_json,
    print_table,
    progress_bar,
    save_picture,
)

if TYPE_CHECKING:
    from mufly.identify import Estimate
    from mufly.vehicle import Vehicle

__all__ = ["add_to"]

_RPM = math.pi / 30.0

ColumnsOption = Annotated[
    str | None,
    typer.Option(
        "--columns", metavar="OLD=NEW,...", help="What headers mean, as 'RPM=speed_upper_rpm,T_B(N)=thrust_upper_N'."
    ),
]  # fmt: skip
VehicleOption = Annotated[
    str | None,
    typer.Option("--vehicle", metavar="NAME|FILE", help="Vehicle to start from and to compare with."),
]
WriteOption = Annotated[
    Path | None,
    typer.Option(
        "--write", metavar="FILE", help="Write --vehicle with what was found, source 'identified', as a new file."
    ),
]  # fmt: skip


def add_to(app: typer.Typer) -> None:
    """Register the commands of this module."""
    from mufly.cli.identify_plan import plan

    app.command()(motor)
    app.command()(rotor)
    app.command()(plan)


def with_doubt(option: str, text: str | None, *, above: float = 0.0) -> tuple[float | None, float]:
    """Return value and standard deviation of ``"0.84"`` or ``"0.84+-0.02"``; None for None or ``"free"``.

    Raises
    ------
    InputError
        If the text is no number above the limit.
    """
    from mufly.errors import InputError

    if text is None or text == "free":
        return None, 0.0
    first, _, second = text.replace("±", "+-").partition("+-")
    try:
        value, std = float(first), float(second or 0.0)
    except ValueError:
        raise InputError(option, "", f"{text!r} is no number", "write 0.84 or 0.84+-0.02") from None
    if not (math.isfinite(value) and value > above and math.isfinite(std) and std >= 0):
        raise InputError(option, "", f"{text} is not possible", f"give a number above {above:g}")
    return value, std


def motor(
    bench: Annotated[
        Path,
        typer.Argument(
            metavar="CSV", help="Columns voltage_V (and duty), current_A, speed_rpm, torque_mNm; docs/bench.md lists "
            "the names and units that are understood.",
        ),
    ],
    gear_ratio: Annotated[
        str,
        typer.Option(
            "--gear", "--gear-ratio", metavar="I", help="Motor speed over measured speed: 1.5, 1.5+-0.01 or 'free'."
        ),
    ] = "1",
    gear_efficiency: Annotated[
        str,
        typer.Option(metavar="ETA", help="Of the gear between motor and torque sensor: 0.84, 0.84+-0.02 or 'free'."),
    ] = "1",
    noise: Annotated[
        str | None,
        typer.Option(
            metavar="CHANNEL=AMOUNT,...", help="Errors to expect, as 'current=1%+0.01,speed=0.5%fs' (of the "
            "reading, of full scale, or SI); only their proportions matter. Default: the likeliest shape.",
        ),
    ] = None,
    columns: ColumnsOption = None,
    vehicle: VehicleOption = None,
    write: WriteOption = None,
    out: OutOption = None,
    as_json: JsonOption = False,
) -> None:  # fmt: skip
    """Find a motor's constants from stationary points on a bench: voltage, current, speed and torque.

    Example: mufly identify motor motor.csv --vehicle mufly-1.1 --write mine.toml --out motor
    """
    from mufly.bench import read_bench
    from mufly.errors import InputError
    from mufly.identify.bench_pictures import motor_picture
    from mufly.identify.channel_noise import parse_noise
    from mufly.identify.motor import GearKnowledge, fit_motor
    from mufly.identify.motor_data import CHANNELS

    start = _vehicle(vehicle, write)
    ratio, ratio_std = with_doubt("--gear", gear_ratio)
    eta, eta_std = with_doubt("--gear-efficiency", gear_efficiency)
    if eta is not None and eta > 1.0:
        raise InputError("--gear-efficiency", "", f"{eta:g} is not possible", "give a number up to 1")
    table = read_bench(bench, columns=columns)
    fit = fit_motor(
        table, gear=GearKnowledge(ratio, eta, ratio_std, eta_std), vehicle=start,
        noise=parse_noise(noise, CHANNELS) if noise else None,
    )  # fmt: skip
    files = _write_vehicle(start, fit.estimates, write, f"mufly identify motor {table.source}, {_today()}")
    if out is not None:
        files.append(
            save_picture(
                motor_picture(fit, title=f"{table.source}: motor constants by least squares"), out, "motor"
            )
        )
    if as_json:
        print_json(
            {
                "source": table.source, "points": fit.data.voltage_V.size,
                "estimates": [vars(e) for e in fit.estimates], "covariance": fit.covariance,
                "scales": fit.scales, "pattern": fit.spread.pattern, "unseen": fit.unseen, "notes": fit.notes,
                "files": [str(f) for f in files],
            }
        )  # fmt: skip
        return
    print_estimates(fit.estimates, f"{table.source}: {fit.data.voltage_V.size} points")
    rms = [float((fit.residual[:, k] ** 2).mean() ** 0.5) for k in (0, 1)]
    say(
        [
            f"residuals: {1e3 * rms[0]:.3g} mV in the voltage's balance, {1e3 * rms[1]:.3g} mN m in the torque's"
        ]
    )
    say(fit.notes, mark="note")
    say(fit.unseen, mark="not seen")
    say(f"written: {f}" for f in files)


def rotor(
    bench: Annotated[
        list[Path],
        typer.Argument(
            metavar="CSV...", help="Columns speed_rpm, thrust_N, torque_Nm of a single rotor, or speed_upper_rpm, "
            "thrust_upper_N, torque_lower_Nm ... of a pair; thrust_raw_V with --calibration. Lines with speed 0 give "
            "the zero of the load cells.",
        ),
    ],
    radius: Annotated[
        str | None, typer.Option(metavar="M", help="Radius, as 0.06 or 0.06+-0.0002. Default: of --rotor or --vehicle.")
    ] = None,
    density: Annotated[
        str | None,
        typer.Option(metavar="KG/M3", help="Density of the air, as 1.19 or 1.19+-0.01. Default: the file's, else 1.2."),
    ] = None,
    calibration: Annotated[
        Path | None,
        typer.Option(
            metavar="CSV", help="Known loads and readings of the load cells: thrust_N, thrust_raw_V, torque_Nm, "
            "torque_raw_V.",
        ),
    ] = None,
    calibration_columns: Annotated[
        str | None, typer.Option(metavar="OLD=NEW,...", help="As --columns, for the calibration file.")
    ] = None,
    columns: Annotated[
        list[str] | None,
        typer.Option(
            metavar="OLD=NEW,...", help="What headers mean; for files of several kinds repeat it. A map holds for the "
            "files that have all its columns.",
        ),
    ] = None,
    at_rpm: Annotated[
        float | None, typer.Option(metavar="RPM", help="Give coefficients that change with speed at this one.")
    ] = None,
    predict_with: Annotated[
        str | None,
        typer.Option("--rotor", metavar="NAME|FILE", help="Compare with blade element theory of this rotor."),
    ] = None,
    pitch: Annotated[
        str | None,
        typer.Option(metavar="ANGLE", help="Pitch setting for the prediction where the file has no pitch, as 12."),
    ] = None,
    spacing: Annotated[
        float | None, typer.Option(metavar="M", help="Distance between the discs of a pair, for the prediction.")
    ] = None,
    place: Annotated[
        str | None, typer.Option("--as", metavar="upper|lower", help="Which rotor of --vehicle a single rotor is.")
    ] = None,
    vehicle: VehicleOption = None,
    write: WriteOption = None,
    out: OutOption = None,
    as_json: JsonOption = False,
) -> None:  # fmt: skip
    """Find thrust and torque coefficients of rotors from bench files, single and coaxial.

    Example: mufly identify rotor bench.csv --radius 0.0875 --calibration cells.csv --out rotor
    """
    from mufly.bench import Calibration, calibrate_cells, corrected_loads, predict, read_bench
    from mufly.errors import InputError
    from mufly.identify.bench_pictures import rotor_picture
    from mufly.identify.rotor_fit import RotorFit, interference, placed
    from mufly.identify.static_rotor import fit_rotor
    from mufly.rotor import load_rotor, prepare

    start = _vehicle(vehicle, write)
    if place not in (None, "upper", "lower"):
        raise InputError("--as", "", f"{place!r} is no rotor of a vehicle", "use upper or lower")
    blades = load_rotor(predict_with) if predict_with is not None else None
    value, std = with_doubt("--radius", radius)
    if value is None:
        if blades is None and start is None:
            raise InputError(
                "--radius", "", "is missing", "give the rotor's radius in metres, or --rotor or --vehicle"
            )
        value = (
            blades.radius_m
            if blades is not None
            else float(start.rotors.radius)
            if start is not None
            else math.nan
        )
    rho, rho_std = with_doubt("--density", density)
    cells: Calibration | None = None
    if calibration is not None:
        cells = calibrate_cells(read_bench(calibration, columns=calibration_columns))
    maps = _maps(columns or [], bench)
    tables = [read_bench(file, columns=m) for file, m in zip(bench, maps, strict=True)]
    loads = [corrected_loads(t, cells) for t in tables]
    by_file = [
        fit_rotor(
            one, radius_m=value, radius_std_m=std, density_kg_m3=rho, density_std_kg_m3=rho_std,
            at_speed_rad_s=None if at_rpm is None else at_rpm * _RPM, vehicle=start,
        )
        for one in loads
    ]  # fmt: skip
    fits: list[RotorFit] = [f if place is None else placed(f, place, start) for one in by_file for f in one]
    predictions, drawn = {}, {}
    if blades is not None:
        blading = prepare(blades)
        for one in by_file:
            first, source = one[0], one[0].source
            with progress_bar("points", shown=first.coaxial and not as_json) as move:
                p = predict(
                    first.loads, blading, density_kg_m3=float(first.density_kg_m3.mean()), spacing_m=spacing,
                    pitch_rad=None if pitch is None else angle("--pitch", pitch), progress=move,
                )  # fmt: skip
            predictions[source] = p
            if len(one) == 1:
                drawn.update({f"{source} {c}": (p.speed_rad_s[c], p.load[c]) for c in p.load})
    sources = ", ".join(t.source for t in tables)
    if write is not None and len({round(f.pitch_rad, 4) for f in fits if math.isfinite(f.pitch_rad)}) > 1:
        raise InputError("--write", sources, "has several pitch settings", "leave one in the file")
    files = _write_vehicle(
        start, (e for f in fits for e in f.estimates), write, f"mufly identify rotor {sources}, {_today()}"
    )
    if out is not None:
        files.append(save_picture(rotor_picture(fits, predicted=drawn, title=sources), out, "rotor"))
    effects = interference(fits)
    if as_json:
        print_json(
            {
                "calibration": None if cells is None else cells.in_words(),
                "results": [_rotor_json(f) for f in fits], "interference": effects,
                "prediction": {k: {"load": p.load, "error": p.error} for k, p in predictions.items()},
                "files": [str(f) for f in files],
            }
        )  # fmt: skip
        return
    if cells is not None:
        say([f"load cells, from {cells.source}:", *(f"  {line}" for line in cells.in_words())])
    for fit in fits:
        kind = "coaxial pair" if fit.coaxial else "single rotor"
        at = "" if math.isnan(fit.pitch_rad) else f" at {math.degrees(fit.pitch_rad):.3g} deg"
        print_estimates(
            fit.estimates, f"{fit.source}: {kind}{at}, R {1e3 * fit.radius_m:g} mm", fit.systematic_shares()
        )
        say(t.in_words() for f in fit.fits for t in f.trends)
        say(fit.unseen, mark="not seen")
    say(dict.fromkeys(n for f in fits for n in f.notes), mark="note")
    say(effects)
    say(f"{source}: {line}" for source, p in predictions.items() for line in p.in_words())
    say(f"written: {f}" for f in files)


def _rotor_json(fit: Any) -> dict[str, Any]:
    return {
        "source": fit.source, "coaxial": fit.coaxial, "pitch_rad": fit.pitch_rad, "radius_m": fit.radius_m,
        "density_kg_m3": float(fit.density_kg_m3.mean()), "estimates": [vars(e) for e in fit.estimates],
        "trends": [t.in_words() for f in fit.fits for t in f.trends], "unseen": fit.unseen, "notes": fit.notes,
    }  # fmt: skip


def _maps(columns: list[str], files: list[Path]) -> list[str | None]:
    """Return the map of headers for each file: the first of which it has all columns.

    Raises
    ------
    InputError
        If a map fits no file.
    """
    from mufly.bench import header_of
    from mufly.errors import InputError

    chosen: list[str | None] = [None] * len(files)
    headers = [set(header_of(file)) for file in files]
    for one in columns:
        wanted = {part.partition("=")[0].strip() for part in one.split(",") if part.strip()}
        fitting = [k for k, header in enumerate(headers) if wanted <= header]
        if not fitting and len(files) == 1:
            fitting = [0]  # reading it will name the column that is not there
        if not fitting:
            raise InputError(
                "--columns", one, "names columns that no file has together", "give one map a kind of file"
            )
        for k in fitting:
            chosen[k] = chosen[k] or one
    return chosen


def print_estimates(
    estimates: Iterable[Estimate], title: str, shares: dict[str, float] | None = None
) -> None:
    """Print a table of estimates with intervals."""
    rows = []
    for e in estimates:
        start = "-" if math.isnan(e.start) else f"{e.start:.4g}"
        if math.isinf(e.std):
            value, interval, doubt = "not seen", "-", "-"
        elif e.at_bound:
            value, interval, doubt = f"{e.value:.5g}", "at its bound", "-"
        else:
            value, interval = f"{e.value:.5g}", f"{e.low:.4g} to {e.high:.4g}"
            doubt = f"{100 * e.std / abs(e.value):.2g} %" if e.value else "-"
        row = [e.symbol, value, doubt, interval, e.unit if e.unit != "1" else "", start]
        rows.append(row if shares is None else [*row, f"{100 * shares.get(e.symbol, 0.0):.0f} %"])
    heads = ["symbol", "value", "std", "95 % interval", "unit", "start"]
    print_table(heads if shares is None else [*heads, "systematic"], rows, title=title)


def say(lines: Iterable[str], *, mark: str = "") -> None:
    """Print lines without markup."""
    out = console()
    for line in lines:
        out.print(f"{mark}: {line}" if mark else line, highlight=False, markup=False)


def _vehicle(name: str | None, write: Path | None) -> Vehicle | None:
    from mufly.errors import InputError
    from mufly.vehicle import load_vehicle

    if name is None and write is not None:
        raise InputError(
            "--write", str(write), "needs a vehicle to start from", "add --vehicle mufly-1.1 or a file"
        )
    return None if name is None else load_vehicle(name)


def _write_vehicle(
    start: Vehicle | None, estimates: Iterable[Estimate], write: Path | None, note: str
) -> list[Path]:
    from mufly.errors import InputError
    from mufly.identify.written import with_estimates
    from mufly.vehicle import vehicle_toml

    if write is None or start is None:
        return []
    text = vehicle_toml(with_estimates(start, estimates, note))
    try:
        write.write_text(text, encoding="utf-8")
    except OSError as error:
        raise InputError(
            "--write", str(write), f"cannot be written ({error})", "give another place"
        ) from error
    return [write]


def _today() -> str:
    return time.strftime("%Y-%m-%d")
