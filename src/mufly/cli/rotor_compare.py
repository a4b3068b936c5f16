"""``mufly rotor compare``: prediction beside measurement."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from mufly.cli.options import (
    EngineOption,
    JsonOption,
    ModelOption,
    NCritOption,
    RotorArgument,
    corrections_of,
    engine_of,
    print_json,
)

__all__ = ["compare"]


def compare(
    rotor: RotorArgument,
    measurements: Annotated[
        Path,
        typer.Argument(
            metavar="CSV",
            help="Columns pitch_deg, speed_rpm, thrust_N and, if measured, torque_Nm; or rpm, CT, CP as in UIUC's "
            "propeller data. docs/bemt.md lists the names that are understood.",
        ),
    ],
    calibrate: Annotated[
        int | None,
        typer.Option(metavar="LINE", help="Scale lift and drag to this measured point, counted from 1, as the "
                     "dissertation did. Printed as calibrated."),
    ] = None,
    density: Annotated[float, typer.Option(metavar="KG/M3", help="Density of the air at the bench.")] = 1.2,
    n_crit: NCritOption = 0.1,
    engine: EngineOption = "neuralfoil",
    model: ModelOption = "full",
    as_json: JsonOption = False,
) -> None:  # fmt: skip
    """Set the prediction beside a measurement, untuned unless --calibrate asks for it.

    Example: mufly rotor compare naca0012-r60-c20 bench.csv
    """
    from mufly.errors import InputError
    from mufly.rotor import Air, load_rotor, prepare, read_measurements
    from mufly.rotor import calibrate as scale
    from mufly.rotor import compare as beside

    r, air = load_rotor(rotor), Air(density_kg_m3=density)
    bench = read_measurements(measurements, diameter_m=2.0 * float(r.radius), density_kg_m3=density)
    blading = prepare(r, n_crit=n_crit, engine=engine_of(engine), corrections=corrections_of(model))
    if calibrate is not None:
        if not 1 <= calibrate <= bench.thrust_N.size:
            raise InputError("--calibrate", "", f"there are {bench.thrust_N.size} points", "count from 1")
        blading = scale(blading, bench, calibrate - 1, air=air)
    c = beside(blading, bench, air=air)
    if as_json:
        points = [
            {
                "pitch_rad": bench.pitch_rad[k], "speed_rad_s": bench.speed_rad_s[k],
                "thrust_N": c.thrust_N[k], "measured_thrust_N": bench.thrust_N[k], "thrust_error": c.thrust_error[k],
                "torque_Nm": c.torque_Nm[k], "measured_torque_Nm": bench.torque_Nm[k],
                "torque_error": c.torque_error[k],
            }
            for k in range(bench.thrust_N.size)
        ]  # fmt: skip
        print_json(
            {
                "rotor": r.name, "measurements": bench.source, "calibrated": c.calibrated, "model": model,
                "mean_thrust_error": c.mean_thrust_error, "mean_torque_error": c.mean_torque_error, "points": points,
            }
        )  # fmt: skip
        return
    typer.echo(str(c))
