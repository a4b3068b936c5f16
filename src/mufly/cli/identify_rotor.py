"""``mufly identify rotor``: coefficients of rotors from bench files."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Annotated, Any

import typer

from mufly.cli.identify_shared import (
    PictureOption,
    VehicleOption,
    WriteOption,
    check_folder,
    print_estimates,
    say,
    start_vehicle,
    today,
    with_doubt,
    write_vehicle,
)
from mufly.cli.options import JsonOption, angle, print_json, progress_bar, save_picture

__all__ = ["rotor"]

_RPM = math.pi / 30.0


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
    out: PictureOption = None,
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

    start = start_vehicle(vehicle, write)
    check_folder("--out", out)
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
    files = write_vehicle(
        start, (e for f in fits for e in f.estimates), write, f"mufly identify rotor {sources}, {today()}"
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
