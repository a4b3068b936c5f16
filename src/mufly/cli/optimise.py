"""``mufly rotor optimise`` and ``mufly coax optimise``: optimisation of a rotor or pair."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from mufly.cli import coax
from mufly.cli.coax import THESIS_ROTOR_NAME, LowerArgument, UpperArgument, convert_pitch_angles, make_pair_setup
from mufly.cli.options import (
    DEFAULT_POLAR_OPTIONS,
    DEFAULT_WAKE_OPTIONS,
    ClimbOption,
    DensityOption,
    DriveOption,
    JsonOption,
    OutOption,
    PairPitchOption,
    PolarOptions,
    RotorArgument,
    SeedOption,
    SpacingOption,
    WakeOptions,
    default_text,
    define_option,
    load_drive_option,
    show_wake_progress,
)
from mufly.cli.output import (
    check_output_place,
    make_console,
    print_answer,
    print_files,
    print_json,
    print_table,
    progress_bar,
    save_figure,
    write_text_file,
)
from mufly.cli.rotor import app as rotor_commands
from mufly.cli.study import format_parameter, parse_set_options
from mufly.errors import InputError, suggest_name
from mufly.quantities.quantity_grammar import read_names
from mufly.quantities.units import RPM
from mufly.results import select_fields

if TYPE_CHECKING:
    from mufly.rotor import Rotor, SystemSolution
    from mufly.study import PairOptimum, RotorOptimum


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
    from mufly.study import ROTOR_PARAMETERS, expand_airfoil_names, parse_limit
    from mufly.study import optimise_rotor as search

    given = set_ or []
    if not any(text.strip().startswith("thrust") for text in given):
        given = [*given, "thrust=0.4N"]
    fixed = parse_set_options(given, ROTOR_PARAMETERS, "give one")
    setup = polars.make_study_setup(rotor, fixed, drive=load_drive_option(drive), with_outside_share=False)
    names = read_names(free)
    candidates = expand_airfoil_names(airfoils or ["thesis"]) if "airfoil" in names else []
    limits = [parse_limit(text) for text in limit or []]
    with progress_bar("generations", not as_json) as progress:
        best = search(
            setup, goal, names,  # type: ignore[arg-type]
            limits=limits, airfoils=candidates, seed=seed, generations=generations, progress=progress,
        )  # fmt: skip
    files = [_write_rotor_file(best.rotor, out)] if out is not None else []
    if as_json:
        return print_json(best)
    _print_optimum(best)
    print_files(files)


def _print_optimum(best: RotorOptimum) -> None:
    rows = [("start", "", f"{best.goal_before:.5g}", "", "")]
    for step in best.steps:
        figures = (f"{step.goal:.5g}", f"{step.gain:+.1%}", f"{math.degrees(step.pitch_rad):.2f}°")
        rows.append((step.parameter, format_parameter(step.parameter, step.value, ".4g"), *figures))
    print_table(("change", "to", f"{best.goal} ({best.unit})", "gain", "pitch"), rows, text=(0, 1))
    r = best.results
    c = make_console()
    c.print(
        f"[bold]{best.goal_after / best.goal_before - 1:+.1%}[/bold]: {r['electrical_power_W']:.3f} W for "
        f"{r['thrust_N']:.3g} N, {r['thrust_per_power_N_W']:.4f} N/W, {r['endurance_s'] / 60:.1f} min; "
        f"{r['speed_rad_s'] / RPM:.0f} rpm at {math.degrees(best.pitch_rad):.2f}°, gear "
        f"{r['gear_ratio']:.3g}, duty {r['duty']:.2f}, least thickness {1e3 * r['least_thickness_m']:.2f} mm",
        highlight=False,
    )


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
    from mufly.rotor import draw_rotor_loads
    from mufly.study import PAIR_FREE_PARAMETERS, optimise_pair, parse_pair_limit, verify_by_wake

    if not 0.0 < thrust < math.inf:
        raise InputError("--thrust", "", f"{thrust:g} N is out of range", "give a number above 0")
    if generations < 1:
        raise InputError("--generations", "", f"{generations} is out of range", "give 1 or more")
    names = read_names(vary)
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
    checked: tuple[SystemSolution | str, SystemSolution | str] | None = None
    if check:
        with show_wake_progress("start and optimum", not as_json, out) as told:
            checked = verify_by_wake(setup, best, told)
    if out is not None:
        after = checked[1] if checked is not None and not isinstance(checked[1], str) else best.after
        files.append(save_figure(draw_rotor_loads(after.upper, after.lower), out, "loads"))
    bemt = {"start": best.before, "pitch_only": best.before_at_best_pitch, "optimum": best.after}
    content = {
        **select_fields(best, "upper=upper.toml_tables lower=lower.toml_tables changes at_limit evaluations"),
        "bemt": {name: _summarise_point(point) for name, point in bemt.items()},
        "wake": checked and dict(zip(("start", "optimum"), map(_summarise_point, checked), strict=True)),
    }
    print_answer(as_json, content, lambda: _print_pair_optimum(best, checked), files)


def _summarise_point(point: SystemSolution | str | None) -> dict[str, Any] | None:
    if point is None or isinstance(point, str):
        return None if point is None else {"fault": point}
    each = "pitch_rad speed_rad_s thrust_N torque_Nm power_W outside_share"
    both = {"upper": select_fields(point.upper, each), "lower": select_fields(point.lower, each)}
    return {**select_fields(point, "power_W thrust_N figure_of_merit"), **both}


def _print_pair_optimum(best: PairOptimum, checked: tuple[SystemSolution | str, SystemSolution | str] | None) -> None:
    c = make_console()
    shown = [
        (name, format_parameter(name, value, ".4g"), "at the end of its range" if name in best.at_limit else "")
        for name, value in best.changes.items()
    ]
    print_table(("free", "found", ""), shown, text=(0, 2))
    heads = ("", "method", "power (W)", "change", "upper rpm", "lower rpm", "upper (N)", "lower (N)", "merit")
    rows: list[tuple[str, ...]] = []

    def add_row(
        label: str, method: str, point: SystemSolution | str | None, first: SystemSolution | str | None
    ) -> None:
        if point is None:
            return
        if isinstance(point, str):
            rows.append((label, method, "-", "", "", "", "", "", ""))
            return
        change = "" if first is None or isinstance(first, str) else f"{point.power_W / first.power_W - 1:+.1%}"
        rows.append(
            (label, method, f"{point.power_W:.4g}", change, f"{point.upper.speed_rad_s / RPM:.0f}",
             f"{point.lower.speed_rad_s / RPM:.0f}", f"{point.upper.thrust_N:.4g}", f"{point.lower.thrust_N:.4g}",
             f"{point.figure_of_merit:.3f}")
        )  # fmt: skip

    add_row("start", "bemt", best.before, None)
    add_row("start's blades, best pitch", "bemt", best.before_at_best_pitch, best.before)
    add_row("optimum", "bemt", best.after, best.before)
    if checked is not None:
        add_row("start", "wake", checked[0], None)
        add_row("optimum", "wake", checked[1], checked[0])
    print_table(heads, rows, text=(0, 1))
    for point in checked or ():
        if isinstance(point, str):
            c.print(f"The wake method finds no solution: {point}", style="yellow", highlight=False)
    share = max(best.after.upper.outside_share, best.after.lower.outside_share)
    if share > 0.0:
        c.print(
            f"At the optimum sections outside the range of the polars carry up to {share:.0%} of a thrust",
            style="yellow", highlight=False,
        )  # fmt: skip
    c.print(f"{best.evaluations} pairs computed.", style="dim", highlight=False)
