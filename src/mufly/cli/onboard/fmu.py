"""``mufly vehicle export``: a vehicle as a co-simulation unit (FMU) for other simulators."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from mufly.cli.options import JsonOption, VehicleArgument, define_option
from mufly.cli.output import check_output_place, print_answer, print_lines
from mufly.cli.vehicle import app
from mufly.errors import InputError
from mufly.results import to_plain_data


@app.command("export")
def export_vehicle(
    vehicle: VehicleArgument,
    out: Annotated[Path, define_option("--out FILE", "File to write: name.fmu.")],
    seeds: Annotated[
        int,
        define_option(
            "--sensor-seeds N",
            "Include sensors and filter, with the sensors' errors for seeds 0 to N - 1.",
            min=0,
            max=256,
        ),
    ] = 0,
    sources_only: Annotated[
        bool, define_option("--sources-only", "Omit the library for this machine; importers compile the sources.")
    ] = False,
    check: Annotated[
        bool,
        define_option("--check", "Compare the compiled library with the Python model on a flight, bit for bit."),
    ] = False,
    as_json: JsonOption = False,
) -> None:
    """Write the flight model as an FMI 3.0 co-simulation unit in C, for Dymola, SimulationX, Simulink and others.

    Inputs are the four actuators and the wind; outputs are motion, rotor speeds, thrusts and battery. With
    --sensor-seeds the outputs include all readings of the vehicle's sensors and the estimate of the filter. Parameters
    have the names of the vehicle file. Use: docs/how-to/use-in-other-simulators.md. With --check the command ends with
    status 1 if a bit differs.

    Example: mufly vehicle export mine.toml --out mine.fmu --check
    """
    if out.suffix != ".fmu":
        raise InputError("--out", str(out), "does not end in .fmu", "give a name that ends in .fmu")
    if check and sources_only:
        raise InputError("--check", "", "needs the compiled library", "leave out --sources-only")
    check_output_place("--out", out, "file")
    from mufly.fmi import check_fmu_file, export_fmu
    from mufly.vehicle import load_vehicle

    loaded = load_vehicle(vehicle)
    try:
        made = export_fmu(loaded, out, binary=not sources_only, seeds=seeds)
    except InputError as error:
        raise error.with_location(vehicle) if error.where == loaded.name else error from None
    compared = check_fmu_file(out, loaded) if check else None
    content = made if compared is None else {**to_plain_data(made), "check": compared}
    print_answer(
        as_json, content, [*made.make_printed_blocks(), *(compared.make_printed_blocks() if compared else ())], [out]
    )
    if not (made.platform or sources_only or as_json):
        print_lines(
            "there is no C compiler, so the unit contains no library for this platform; install gcc or clang",
            mark="Warning", style="yellow",
        )  # fmt: skip
    if compared is not None and compared.different:
        raise typer.Exit(1)
