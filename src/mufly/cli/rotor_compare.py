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
    progress_bar,
)
from mufly.cli.wake_options import MethodOption, WakeOption, WakeSetOption, wake_of

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
    method: MethodOption = "bemt",
    wake: WakeOption = "free",
    wake_set: WakeSetOption = None,
    as_json: JsonOption = False,
) -> None:  # fmt: skip
    """Set the prediction beside a measurement, untuned unless --calibrate asks for it.

    With --method wake every point is a wake, seconds each; one that does not converge is left out of the mean and said.
    Examples: mufly rotor compare naca0012-r60-c20 bench.csv; mufly rotor compare walkera-5g6 b.csv --method wake
    """
    from mufly.errors import InputError
    from mufly.rotor import Air, load_rotor, prepare, read_measurements
    from mufly.rotor import calibrate as scale
    from mufly.rotor import compare as beside
    from mufly.rotor.wake import compare_wake

    r, air = load_rotor(rotor), Air(density_kg_m3=density)
    bench = read_measurements(measurements, diameter_m=2.0 * float(r.radius), density_kg_m3=density)
    settings, stations = wake_of(method, wake, wake_set)
    if calibrate is not None and method == "wake":
        raise InputError("--calibrate", "", "scales blade element theory", "leave it or --method wake out")
    blading = prepare(
        r, n_crit=n_crit, engine=engine_of(engine), corrections=corrections_of(model), stations=stations
    )
    if calibrate is not None:
        if not 1 <= calibrate <= bench.thrust_N.size:
            raise InputError("--calibrate", "", f"there are {bench.thrust_N.size} points", "count from 1")
        blading = scale(blading, bench, calibrate - 1, air=air)
    faults = [""] * bench.thrust_N.size
    if method == "wake":
        with progress_bar("points", not as_json) as progress:
            c, faults = compare_wake(blading, bench, air=air, settings=settings, progress=progress)
    else:
        c = beside(blading, bench, air=air)
    if as_json:
        points = [
            {
                "pitch_rad": bench.pitch_rad[k], "speed_rad_s": bench.speed_rad_s[k],
                "thrust_N": c.thrust_N[k], "measured_thrust_N": bench.thrust_N[k], "thrust_error": c.thrust_error[k],
                "torque_Nm": c.torque_Nm[k], "measured_torque_Nm": bench.torque_Nm[k],
                "torque_error": c.torque_error[k], "fault": faults[k],
            }
            for k in range(bench.thrust_N.size)
        ]  # fmt: skip
        print_json(
            {
                "rotor": r.name, "measurements": bench.source, "calibrated": c.calibrated, "model": model,
                "method": method,
                "mean_thrust_error": c.mean_thrust_error, "mean_torque_error": c.mean_torque_error, "points": points,
            }
        )  # fmt: skip
        return
    typer.echo(str(c))
    for k, fault in enumerate(faults):
        if fault:
            typer.secho(f"point {k + 1}: wake {fault}", fg=typer.colors.YELLOW)
