"""``mufly rotor fit`` and ``mufly rotor compare``: predictions of a rotor beside measured points."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from mufly.cli.aero.interval_options import DEFAULT_INTERVAL_OPTIONS, FamilyOption, IntervalOptions
from mufly.cli.aero.rotor_theory_options import DEFAULT_BEMT_OPTIONS, DEFAULT_POLAR_OPTIONS, PolarOptions, TheoryOptions
from mufly.cli.options import (
    DENSITY_RANGE,
    PITCH_RANGE,
    SPEED_RANGE,
    ColumnOption,
    JsonOption,
    RotorArgument,
    define_argument,
    define_option,
)
from mufly.cli.output import (
    print_answer,
    print_json,
    print_lines,
    progress_bar,
    save_figure,
    write_text_file,
)
from mufly.cli.rotor import app as rotor_commands
from mufly.quantities.units import RPM
from mufly.results import columns_to_rows, select_fields

if TYPE_CHECKING:
    from mufly.rotor import MeasurementComparison, Rotor, RotorMeasurements


BenchPitchOption = Annotated[
    float | None,
    define_option(
        "--pitch",
        "Pitch setting on the bench, if the file has no column for it: 12, 12deg or 0.2rad.",
        unit="deg",
        within=PITCH_RANGE,
    ),
]
BenchSpeedOption = Annotated[
    float | None,
    define_option(
        "--rpm",
        "Rotor speed on the bench, if the file has no column for it, as in UIUC's tunnel runs.",
        unit="rpm",
        within=SPEED_RANGE,
    ),
]
BenchDensityOption = Annotated[
    float | None,
    define_option(
        "--density",
        "Density of the air at the bench. Default: the file's, else 1.2.",
        unit="kg/m3",
        within=DENSITY_RANGE,
    ),
]


def _point_index(name: str, line: int, bench: RotorMeasurements) -> int:
    """Return the zero-based index of the measured point with number ``line``, counted from 1."""
    from mufly.errors import InputError

    n = bench.thrust_N.size
    if not 1 <= line <= n:
        raise InputError(name, str(line), f"is not a point: there are {n}", f"give a number from 1 to {n}")
    return line - 1


def _read_measurements(
    path: Path,
    rotor: Rotor,
    columns: list[str] | None,
    density: float | None,
    pitch: float | None,
    rpm: float | None,
    *,
    quiet: bool,
) -> RotorMeasurements:
    """Read the points of a bench file, and print the assumptions made about it."""
    from mufly.bench import read_measurements
    from mufly.rotor import Air

    bench = read_measurements(
        path, columns=columns or (), diameter_m=2.0 * float(rotor.radius), density_kg_m3=density,
        pitch_rad=None if pitch is None else math.radians(pitch), speed_rad_s=None if rpm is None else rpm * RPM,
    )  # fmt: skip
    for note in bench.notes if not quiet else ():
        typer.echo(f"note: {note}")
    if density is None and bench.air != Air() and not quiet:
        typer.echo(f"air of {bench.air.density_kg_m3:.4g} kg/m3, from the file")
    if pitch is None and not bench.pitch_rad.any() and not quiet:
        stands = math.degrees(float(rotor.twist_rad(0.75)))
        typer.echo(f"pitch 0: blade angle of the rotor file, {stands:.1f}° at 0.75 R (--pitch gives another)")
    return bench


@rotor_commands.command()
def fit(
    rotor: RotorArgument,
    measurements: Annotated[
        Path,
        define_argument(
            "FILE", "Bench file, as for 'rotor compare'; one point suffices, a sweep of speeds determines more."
        ),
    ],
    section: Annotated[
        Literal["known", "guessed"],
        define_option(
            "--section NAME",
            "Knowledge of the sections: 'guessed' (the file's airfoils are one candidate among others) or 'known'.",
        ),
    ] = "guessed",
    family: FamilyOption = "",
    point: Annotated[
        int | None, define_option("--point LINE", "Measured point to fit alone, counted from 1. Default: all points.")
    ] = None,
    zero_thrust: Annotated[
        float | None,
        define_option(
            "--zero-thrust J", "Advance ratio V/(n D) at which a tunnel measured no thrust.", unit="1", min=0.0
        ),
    ] = None,
    zero_torque: Annotated[
        float | None,
        define_option(
            "--zero-torque J", "Advance ratio V/(n D) at which the rotor windmills without torque.", unit="1", min=0.0
        ),
    ] = None,
    density: BenchDensityOption = None,
    columns: ColumnOption = None,
    pitch: BenchPitchOption = None,
    rpm: BenchSpeedOption = None,
    polars: PolarOptions = DEFAULT_POLAR_OPTIONS,
    out: Annotated[
        Path | None,
        define_option("--out FILE.toml", "Rotor file to write, with its fit; a picture is drawn beside it."),
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """Fit a rotor's sections to measurements: the likely airfoils, and corrections of their coefficients.

    The file written is a rotor file; --band of 'rotor hover' then shows the uncertainty that the bench leaves. Points
    that are not fitted measure the error. Method: docs/explanation/bemt.md.
    Example: mufly rotor fit my-rotor.toml bench.csv --out fitted.toml
    """
    import numpy as np

    from mufly.errors import InputError
    from mufly.rotor import add_zero_load_points, draw_rotor_fit, fit_rotor, format_rotor_toml, load_rotor

    if out is not None and out.suffix != ".toml":
        raise InputError("--out", str(out), "does not end in .toml", "give a name that ends in .toml")
    r = load_rotor(rotor)
    bench = _read_measurements(measurements, r, columns, density, pitch, rpm, quiet=as_json)
    air = bench.air
    if point is not None:
        bench = bench.select_points(np.array([_point_index("--point", point, bench)]))
    bench = add_zero_load_points(bench, r.radius_m, zero_thrust=zero_thrust, zero_torque=zero_torque)
    with progress_bar("sections", not as_json) as progress:
        found = fit_rotor(
            r, bench, section=section, family=family, air=air, n_crit=polars.n_crit, engine=polars.engine,
            corrections=polars.select_corrections(), progress=progress,
        )  # fmt: skip
    files = []
    if out is not None:
        write_text_file(out, format_rotor_toml(found.rotor))
        files = [out, save_figure(draw_rotor_fit(found), out.parent, out.stem)]
    print_answer(as_json, found, files=files)


@rotor_commands.command()
def compare(
    rotor: RotorArgument,
    measurements: Annotated[
        Path,
        define_argument(
            "FILE",
            "Bench file with a header: pitch_deg, speed_rpm, thrust_N and, if measured, torque_Nm, in "
            "these or other units; or RPM, CT, CP as in UIUC's propeller data. docs/reference/bench.md "
            "lists the accepted names.",
        ),
    ],
    calibrate: Annotated[
        int | None,
        define_option(
            "LINE",
            "Measured point to which lift and drag are scaled, counted from 1, as in the dissertation. "
            "`mufly rotor fit --point LINE --out FILE.toml` keeps the result.",
        ),
    ] = None,
    density: BenchDensityOption = None,
    columns: ColumnOption = None,
    pitch: BenchPitchOption = None,
    rpm: BenchSpeedOption = None,
    theory: TheoryOptions = DEFAULT_BEMT_OPTIONS,
    interval_options: IntervalOptions = DEFAULT_INTERVAL_OPTIONS,
    as_json: JsonOption = False,
) -> None:
    """Compare the prediction with a measurement, untuned unless --calibrate is given.

    With --method wake every point takes seconds; points that do not converge are reported and left out of the mean.
    With --band the measured values inside the interval of blade elements are counted.
    Examples: mufly rotor compare naca0012-r60-c20 bench.csv; mufly rotor compare walkera-5g6 b.csv --method wake
    """
    from dataclasses import replace

    from mufly.errors import InputError
    from mufly.rotor import calibrate_blading as scale
    from mufly.rotor import compare_measurements as beside
    from mufly.rotor import load_rotor, predict_interval

    r = load_rotor(rotor)
    bench = _read_measurements(measurements, r, columns, density, pitch, rpm, quiet=as_json)
    air = bench.air
    settings, stations = theory.wake_settings_and_stations()
    if calibrate is not None and theory.method == "wake":
        raise InputError(
            "--calibrate",
            "",
            "does not apply to --method wake; it scales blade element theory",
            "leave out --calibrate or --method wake",
        )
    if interval_options.band is not None and (calibrate is not None or theory.method != "bemt"):
        raise InputError("--band", "", "is for untuned blade elements here", "leave out --calibrate and --method")
    blading = theory.prepare_blading(r, stations)
    if calibrate is not None:
        blading = scale(blading, bench, _point_index("--calibrate", calibrate, bench), air=air)
    with progress_bar("points", theory.method == "wake" and not as_json) as progress:
        c = beside(blading, bench, air=air, method=theory.method, settings=settings, progress=progress)
    if interval_options.band is not None:
        interval = predict_interval(
            r, **select_fields(bench, "pitch_rad speed_rad_s climb_m_s"), air=air, level=interval_options.band,
            corrections=theory.select_corrections(), n_crit=theory.n_crit, engine=theory.engine,
            section=interval_options.section, family=interval_options.family,
        )  # fmt: skip
        c = replace(c, interval=interval)
    if as_json:
        keys = (
            "pitch_rad=measured.pitch_rad speed_rad_s=measured.speed_rad_s thrust_N "
            "measured_thrust_N=measured.thrust_N thrust_error torque_Nm measured_torque_Nm=measured.torque_Nm "
            "torque_error fault=prediction_faults"
        )
        content = {
            "rotor": r.name, "measurements": bench.source, "calibrated": c.calibrated, "model": theory.model,
            **select_fields(blading.corrections, "lift_factor drag_factor"), "method": theory.method,
            **select_fields(c, "mean_thrust_error mean_torque_error"), "notes": bench.notes,
            "points": columns_to_rows(select_fields(c, keys)),
            **_make_interval_record(c),
        }  # fmt: skip
        return print_json(content)
    print_answer(False, c, files=None)
    if calibrate is not None:
        lift, drag = blading.corrections.lift_factor, blading.corrections.drag_factor
        print_lines(
            f"lift is scaled by {lift:.4f}, drag by {drag:.4f}; 'rotor fit --point {calibrate}' keeps the point"
        )


def _make_interval_record(compared: MeasurementComparison) -> dict[str, object]:
    """Return the interval of each point, and how many measured values lie inside; nothing without ``--band``."""
    interval = compared.interval
    if interval is None:
        return {}
    return {
        "band": [interval.as_record(k) for k in range(interval.thrust_N.size)],
        "inside_band": compared.count_inside_interval(),
    }
