"""``mufly identify motor``: constants of a motor from a bench file; and the commands on benches registered."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from mufly.cli.identify_shared import (
    ColumnsOption,
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
from mufly.cli.options import JsonOption, print_json, save_picture

__all__ = ["add_to"]


def add_to(app: typer.Typer) -> None:
    """Register the commands of this module."""
    from mufly.cli.identify_plan import plan
    from mufly.cli.identify_rotor import rotor

    app.command()(motor)
    app.command()(rotor)
    app.command()(plan)


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
    out: PictureOption = None,
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

    start = start_vehicle(vehicle, write)
    check_folder("--out", out)
    ratio, ratio_std = with_doubt("--gear", gear_ratio)
    eta, eta_std = with_doubt("--gear-efficiency", gear_efficiency)
    if eta is not None and eta > 1.0:
        raise InputError("--gear-efficiency", "", f"{eta:g} is not possible", "give a number up to 1")
    table = read_bench(bench, columns=columns)
    fit = fit_motor(
        table, gear=GearKnowledge(ratio, eta, ratio_std, eta_std), vehicle=start,
        noise=parse_noise(noise, CHANNELS) if noise else None,
    )  # fmt: skip
    files = write_vehicle(start, fit.estimates, write, f"mufly identify motor {table.source}, {today()}")
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
