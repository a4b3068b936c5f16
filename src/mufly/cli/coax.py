"""``mufly coax``: two rotors above each other, turning against each other."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated

import typer

from mufly.cli import coax_study
from mufly.cli.coax_shared import (
    DENSITY,
    SPACING,
    THESIS,
    LowerArgument,
    UpperArgument,
    angles,
    length,
    pair_json,
    pair_of,
    print_pair,
    speeds,
    write_pair,
)
from mufly.cli.options import (
    Commands,
    EngineOption,
    JsonOption,
    MethodOption,
    ModelOption,
    NCritOption,
    OutOption,
    WakeOption,
    WakeSetOption,
    wake_progress,
)
from mufly.cli.present import console, print_json
from mufly.errors import InputError, MuflyError

if TYPE_CHECKING:
    from pathlib import Path

    from mufly.study import PairSetup

app = Commands(
    help="Coaxial pairs: two rotors that turn against each other, by a free vortex wake or by blade elements. See "
    "docs/coax.md.",
    no_args_is_help=True,
)

_Isolated = Annotated[
    bool,
    typer.Option("--isolated/--no-isolated", help="Whether each rotor is computed alone too, for the loss."),
]


@app.command()
def hover(
    upper: UpperArgument = THESIS,
    lower: LowerArgument = None,
    spacing: Annotated[str, SPACING] = "20mm",
    rpm: Annotated[
        str,
        typer.Option(metavar="RPM[,RPM]", help="Speeds of upper and lower rotor; one value holds for both."),
    ] = "6000,6650",
    pitch: Annotated[
        str,
        typer.Option(metavar="ANGLE[,ANGLE]", help="Pitch of upper and lower rotor: 14, 14,12 or 0.2rad."),
    ] = "14",
    climb: Annotated[float, typer.Option(metavar="M/S", help="Axial speed, positive in climb.")] = 0.0,
    density: Annotated[float, DENSITY] = 1.2,
    method: MethodOption = "wake",
    wake: WakeOption = "free",
    wake_set: WakeSetOption = None,
    n_crit: NCritOption = 0.1,
    engine: EngineOption = "neuralfoil",
    model: ModelOption = "full",
    isolated: _Isolated = True,
    out: OutOption = None,
    as_json: JsonOption = False,
) -> None:
    """Compute thrust, torque and power of both rotors, and what they lose to each other.

    Without options: the dissertation's pair (Sec. 3.4.7). With --out: pictures of the wake, the air, the loads along
    the blades and the convergence, and tables. A wake that does not converge ends the command with status 1, its
    history written.

    Examples: mufly coax hover; mufly coax hover naca0012-r60-c20 naca4412-r60-c20 --spacing 30mm --rpm 6000,6500
    --pitch 14,12 --out pair; mufly coax hover --method bemt --climb 1
    """
    above, below = angles(pitch)
    first, second = speeds(rpm)
    setup = pair_of(
        upper, lower,
        {"spacing": length(spacing), "upper_pitch": above, "lower_pitch": below, "upper_speed": first,
         "lower_speed": second, "climb": climb, "density": density, "n_crit": n_crit},
        method=method, wake=wake, wake_set=wake_set, model=model, engine=engine,
    )  # fmt: skip
    _answer(setup, isolated, out, as_json)


@app.command()
def trim(
    upper: UpperArgument = THESIS,
    lower: LowerArgument = None,
    spacing: Annotated[str, SPACING] = "20mm",
    thrust: Annotated[float | None, typer.Option(metavar="N", help="Thrust of the pair.")] = None,
    rpm: Annotated[
        str | None,
        typer.Option(
            metavar="RPM[,RPM]", help="Speed of the upper rotor, if no thrust is given; with --free lower-pitch the "
            "speeds of both, of which a thrust keeps the ratio. 6000 if neither is given.",
        ),
    ] = None,
    free: Annotated[
        str, typer.Option(metavar="NAME", help="What balances the torques: lower-speed or lower-pitch.")
    ] = "lower-speed",
    pitch: Annotated[
        str, typer.Option(metavar="ANGLE[,ANGLE]", help="Pitch of upper and lower rotor: 14, 14,12 or 0.2rad.")
    ] = "14",
    climb: Annotated[float, typer.Option(metavar="M/S", help="Axial speed, positive in climb.")] = 0.0,
    density: Annotated[float, DENSITY] = 1.2,
    method: MethodOption = "wake",
    wake: WakeOption = "free",
    wake_set: WakeSetOption = None,
    n_crit: NCritOption = 0.1,
    engine: EngineOption = "neuralfoil",
    model: ModelOption = "full",
    isolated: _Isolated = False,
    out: OutOption = None,
    as_json: JsonOption = False,
) -> None:  # fmt: skip
    """Find the speeds, or the lower pitch, at which the torques of the rotors cancel.

    Give a thrust, and both speeds are found; or the upper speed, and the lower one is. With --free lower-pitch the
    lower pitch is found instead. Torques cancel to 0.1 % by the wake method.

    Examples: mufly coax trim --rpm 6000; mufly coax trim --thrust 0.9 --method bemt; mufly coax trim --rpm 6000,6000
    --free lower-pitch
    """
    if thrust is not None and not thrust > 0.0:
        raise InputError("--thrust", "", f"{thrust:g} N is not possible", "give a number above 0")
    above, below = angles(pitch)
    fixed: dict[str, float | str] = {
        "spacing": length(spacing), "upper_pitch": above, "climb": climb, "density": density, "n_crit": n_crit
    }  # fmt: skip
    if free == "lower-pitch":
        if "," in pitch:
            raise InputError(
                "--pitch", "", "holds the lower pitch, which is sought", "give the upper pitch only"
            )
        first, second = speeds(rpm or "6000")
        fixed |= {"thrust": thrust} if thrust is not None else {"upper_speed": first}
        fixed["speed_ratio"] = second / first
    else:
        if thrust is not None and rpm is not None:
            raise InputError(
                "--rpm", "", "is given beside a thrust, which finds it", "leave one of the two out"
            )
        if rpm is not None and "," in rpm:
            raise InputError(
                "--rpm", "", "holds the lower speed, which is sought", "give the upper speed only"
            )
        fixed |= {"thrust": thrust} if thrust is not None else {"upper_speed": speeds(rpm or "6000")[0]}
        fixed["lower_pitch"] = below
    setup = pair_of(
        upper,
        lower,
        fixed,
        method=method,
        wake=wake,
        wake_set=wake_set,
        model=model,
        engine=engine,
        balance=free,
    )
    _answer(setup, isolated, out, as_json)


def _answer(setup: PairSetup, isolated: bool, out: Path | None, as_json: bool) -> None:
    from mufly.study import alone, bladings_of, solve_pair

    bladings = bladings_of(setup, {})
    wakes = setup.method == "wake"
    with wake_progress("coaxial pair", wakes and not as_json, out) as progress:
        point = solve_pair(setup, bladings=bladings, progress=progress if wakes else None)
    if not point.converged:
        if out is not None:
            write_pair(point, None, out)
        raise MuflyError(
            f"coaxial wake: {point.message}" + ("" if out is None else f"; its history lies in {out}")
        )
    single = None
    if isolated:
        with wake_progress("each rotor alone", wakes and not as_json, out) as progress:
            single = alone(setup, point, bladings, progress if wakes else None)
    files = write_pair(point, single, out) if out is not None else []
    if as_json:
        print_json(pair_json(setup, point, single, files))
        return
    print_pair(setup, point, single)
    for file in files:
        console().print(f"Written: {file}", highlight=False)


coax_study.add_sweep(app)
coax_study.add_optimise(app)
coax_study.add_map(app)
