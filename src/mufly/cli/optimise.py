"""``mufly rotor optimise`` and ``mufly coax optimise``: optimisation of a rotor or pair."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from mufly.cli import coax
from mufly.cli.aero.rotor_theory_options import (
    DEFAULT_POLAR_OPTIONS,
    DEFAULT_WAKE_OPTIONS,
    PolarOptions,
    WakeOptions,
    show_wake_progress,
)
from mufly.cli.coax import THESIS_ROTOR_NAME, LowerArgument, UpperArgument, convert_pitch_angles, make_pair_setup
from mufly.cli.options import (
    ClimbOption,
    DensityOption,
    DriveOption,
    JsonOption,
    OutOption,
    PairPitchOption,
    RotorArgument,
    SeedOption,
    SpacingOption,
    default_text,
    define_option,
    load_drive_option,
)
from mufly.cli.output import (
    check_output_place,
    print_answer,
    progress_bar,
    save_figure,
    write_text_file,
)
from mufly.cli.rotor import app as rotor_commands
from mufly.cli.study import parse_set_options
from mufly.errors import InputError, suggest_name
from mufly.quantities.quantity_grammar import parse_names

if TYPE_CHECKING:
    from mufly.rotor import Rotor


def _write_rotor_file(rotor: Rotor, path: Path) -> Path:
    from mufly.rotor import format_rotor_toml

    check_output_place("--out", path.parent)
    return write_text_file(path, format_rotor_toml(rotor), "give another place")


@rotor_commands.command()
def optimise(
    rotor: RotorArgument = "naca4412-r60-c20",
    goal: Annotated[
        str, define_option("--for GOAL", "Quantity to maximise: 'endurance' or 'thrust-per-power'.")
    ] = "thrust-per-power",
    free: Annotated[
        str,
        define_option(
            "NAMES",
            "Parameters to search, separated by commas: chord, twist, taper, radius, hub_cutout, blades, "
            "airfoil, gear.",
        ),
    ] = "chord,twist,taper,airfoil,gear",
    limit: Annotated[
        list[str] | None,
        define_option(
            "LIMIT",
            "Limit of the search, as thickness_mm>=0.8, radius<=60mm, speed_rpm<=7000; quote it. Repeat it for more.",
        ),
    ] = None,
    airfoils: Annotated[
        list[str] | None,
        define_option(
            "--airfoils SET|DIR|NAMES",
            "Candidate airfoils: 'thesis', 'database', a folder of .dat files, or names separated by commas.",
        ),
    ] = None,
    set_: Annotated[
        list[str] | None,
        define_option("--set NAME=VALUE", "Parameter to fix, as thrust=0.4N (the default). Repeat it for more."),
    ] = None,
    drive: DriveOption = "mufly",
    seed: SeedOption = 0,
    generations: Annotated[int, define_option("N", "Number of generations of the search.")] = 60,
    out: Annotated[Path | None, define_option("--out FILE", "Rotor file (TOML) to write.")] = None,
    polars: PolarOptions = DEFAULT_POLAR_OPTIONS,
    as_json: JsonOption = False,
) -> None:
    """Search for a better rotor at a given thrust, within limits, and report the gain of each change.

    The gains of the changes are listed in sequence, the greatest first, each with the pitch optimised again; a negative
    gain is the cost of a limit. Limits apply to the searched parameters and to thickness_mm (minimum along the blade),
    tip_chord_mm, solidity, speed_rpm, motor_current_A and gear.

    Example: mufly rotor optimise --for endurance --free chord,twist,taper,radius,airfoil,gear --limit
    'thickness_mm>=0.8' --limit 'radius<=60mm' --out better.toml
    """
    from mufly.study import ROTOR_PARAMETERS, expand_airfoil_names, parse_design_limit
    from mufly.study import optimise_rotor as search

    given = set_ or []
    if not any(text.strip().startswith("thrust") for text in given):
        given = [*given, "thrust=0.4N"]
    fixed = parse_set_options(given, ROTOR_PARAMETERS, "give one")
    setup = polars.make_study_setup(rotor, fixed, drive=load_drive_option(drive), with_outside_share=False)
    names = parse_names(free)
    candidates = expand_airfoil_names(airfoils or ["thesis"]) if "airfoil" in names else []
    limits = [parse_design_limit(text) for text in limit or []]
    with progress_bar("generations", not as_json) as progress:
        best = search(
            setup, goal, names,  # type: ignore[arg-type]
            limits=limits, airfoils=candidates, seed=seed, generations=generations, progress=progress,
        )  # fmt: skip
    files = [_write_rotor_file(best.rotor, out)] if out is not None else []
    print_answer(as_json, best, files=None if as_json else files)


_DEFAULT_PAIR_PARAMETERS = "upper_twist,lower_twist,upper_chord,lower_chord,upper_pitch,lower_pitch"


@coax.app.command("optimise")
def optimise_pairs(
    upper: UpperArgument = THESIS_ROTOR_NAME,
    lower: LowerArgument = None,
    spacing: SpacingOption = 0.02,
    thrust: Annotated[float, define_option("--thrust", "Thrust of the pair.", unit="N")] = 0.9,
    pitch: PairPitchOption = default_text("14"),
    vary: Annotated[
        str,
        define_option(
            "NAMES", "Parameters to search, separated by commas: upper_ or lower_ before twist, chord, pitch, taper."
        ),
    ] = _DEFAULT_PAIR_PARAMETERS,
    limit: Annotated[
        list[str] | None,
        define_option(
            "LIMIT", "Limit of the search, as upper_chord<=25mm or lower_pitch>=8deg; quote it. Repeat it for more."
        ),
    ] = None,
    climb: ClimbOption = 0.0,
    density: DensityOption = 1.2,
    seed: SeedOption = 0,
    generations: Annotated[int, define_option("N", "Number of generations of the search.")] = 30,
    check: Annotated[
        bool,
        define_option("--check/--no-check", "Compute start and optimum by the wake method as well."),
    ] = True,
    theory: WakeOptions = DEFAULT_WAKE_OPTIONS,
    out: OutOption = None,
    as_json: JsonOption = False,
) -> None:
    """Find blades and pitches of both rotors with the least power at a given thrust and balanced torques.

    The search uses blade elements. As an independent check the wake method then computes start and optimum, and
    the gains by both methods are printed. With --out both rotors are written as rotor files, upper.toml and lower.toml.

    Examples: mufly coax optimise --thrust 0.9 --out better; mufly coax optimise --vary upper_pitch,lower_pitch
    --limit 'upper_pitch<=20deg'
    """
    from mufly.study import PAIR_FREE_PARAMETERS, optimise_pair, parse_pair_limit, verify_optimum_by_wake

    if not 0.0 < thrust < math.inf:
        raise InputError("--thrust", "", f"{thrust:g} N is out of range", "give a number above 0")
    if generations < 1:
        raise InputError("--generations", "", f"{generations} is out of range", "give 1 or more")
    names = parse_names(vary)
    for name in names:
        if name not in PAIR_FREE_PARAMETERS:
            raise InputError("--vary", "", f"{name!r} cannot be free", suggest_name(name, PAIR_FREE_PARAMETERS))
    limits = [parse_pair_limit(text) for text in limit or []]
    above, below = convert_pitch_angles(pitch)
    setup = make_pair_setup(
        upper, lower,
        {"spacing": spacing, "upper_pitch": above, "lower_pitch": below, "thrust": thrust, "climb": climb,
         "density": density},
        theory,
    )  # fmt: skip
    with progress_bar("generations", not as_json) as progress:
        best = optimise_pair(setup, names, limits=limits, seed=seed, generations=generations, progress=progress)
    files = []
    if out is not None:
        files = [_write_rotor_file(getattr(best, side), out / f"{side}.toml") for side in ("upper", "lower")]
    if check:
        with show_wake_progress("start and optimum", not as_json, out) as told:
            best = verify_optimum_by_wake(setup, best, told)
    if out is not None:
        files.append(save_figure(best.plot(), out, "loads"))
    print_answer(as_json, best, files=files)
