"""``mufly coax``: two coaxial, counter-rotating rotors."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import numpy as np
import typer

from mufly.cli.aero.interval_options import DEFAULT_INTERVAL_OPTIONS, IntervalOptions
from mufly.cli.aero.rotor_theory_options import (
    DEFAULT_FREE_WAKE_OPTIONS,
    DEFAULT_POLAR_OPTIONS,
    PolarOptions,
    TheoryOptions,
    WakeOptions,
    show_wake_progress,
    write_wakes,
)
from mufly.cli.options import (
    SPEED_RANGE,
    AirspeedsOption,
    ClimbOption,
    CommandGroup,
    DensityOption,
    DiscTiltOption,
    FlapRatiosOption,
    JsonOption,
    OutOption,
    PairPitchOption,
    PairRpmOption,
    SpacingOption,
    default_text,
    define_argument,
    define_option,
)
from mufly.cli.output import (
    print_answer,
    progress_bar,
    save_figure,
)
from mufly.errors import InputError, MuflyError
from mufly.quantities.quantity_grammar import parse_range
from mufly.quantities.units import RPM

if TYPE_CHECKING:
    from mufly.rotor import RotorResult, SystemSolution
    from mufly.study import StudySetup
    from mufly.study.study_parameters import ParameterValue

THESIS_ROTOR_NAME = "naca0012-r60-c20"  # the dissertation's pair: this rotor twice at 14 degrees, 20 mm apart

UpperArgument = Annotated[str, define_argument("UPPER", "Upper rotor: built-in name or rotor file (TOML).")]
LowerArgument = Annotated[
    str | None, define_argument("LOWER", "Lower rotor: built-in name or rotor file (TOML). Default: the upper rotor.")
]


def convert_rotor_speeds(rpm: tuple[float, ...]) -> tuple[float, float]:
    """Return upper and lower speed (rad/s) from one speed for both rotors, or two (rpm)."""
    return rpm[0] * RPM, rpm[-1] * RPM


def convert_pitch_angles(pitch_deg: tuple[float, ...]) -> tuple[float, float]:
    """Return upper and lower pitch (rad) from one pitch setting for both rotors, or two (deg)."""
    return math.radians(pitch_deg[0]), math.radians(pitch_deg[-1])


def make_pair_setup(
    upper: str,
    lower: str | None,
    fixed: dict[str, ParameterValue],
    theory: WakeOptions,
    *,
    balance: str = "lower-speed",
) -> StudySetup:
    """Return the pair that the options describe; InputError if an option is wrong."""
    from mufly.rotor import load_rotor

    return theory.make_study_setup(
        upper, fixed, lower_rotor=load_rotor(upper if lower is None else lower), balance_by=balance
    )


def write_pair_results(point: SystemSolution, alone: tuple[RotorResult, ...] | None, folder: Path) -> list[Path]:
    """Write the loads along both blades and pictures of a pair's operating point; for vortex wakes also their geometry,
    velocity field and history.
    """
    from mufly.rotor import draw_pair_spanwise_loads
    from mufly.study import write_spanwise_loads

    return [
        write_spanwise_loads(point.upper, folder, "stations-upper"),
        write_spanwise_loads(point.lower, folder, "stations-lower"),
        save_figure(draw_pair_spanwise_loads(point.upper, point.lower, alone), folder, "loads"),
        *(write_wakes(point, folder) if point.settings is not None else ()),
    ]


app = CommandGroup(
    help="Compute coaxial pairs, two counter-rotating rotors, by a free vortex wake or by blade elements; see "
    "docs/explanation/coax.md.",
    no_args_is_help=True,
)

_IsolatedOption = Annotated[
    bool,
    define_option("--isolated/--no-isolated", "Compute each rotor alone as well, for the interference losses."),
]


@app.command()
def hover(
    upper: UpperArgument = THESIS_ROTOR_NAME,
    lower: LowerArgument = None,
    spacing: SpacingOption = 0.02,
    rpm: PairRpmOption = default_text("6000,6650"),
    pitch: PairPitchOption = default_text("14"),
    climb: ClimbOption = 0.0,
    density: DensityOption = 1.2,
    theory: TheoryOptions = DEFAULT_FREE_WAKE_OPTIONS,
    isolated: _IsolatedOption = True,
    interval_options: IntervalOptions = DEFAULT_INTERVAL_OPTIONS,
    out: OutOption = None,
    as_json: JsonOption = False,
) -> None:
    """Compute thrust, torque and power of both rotors, and their interference losses.

    Without options, the dissertation's pair (Sec. 3.4.7) is computed. With --out: pictures of wake, air velocity, loads
    along the blades and the convergence, and tables. A wake that does not converge ends the command with status 1, its
    history written.

    Examples: mufly coax hover; mufly coax hover naca0012-r60-c20 naca4412-r60-c20 --spacing 30mm --rpm 6000,6500
    --pitch 14,12 --out pair; mufly coax hover --method bemt --climb 1
    """
    above, below = convert_pitch_angles(pitch)
    first, second = convert_rotor_speeds(rpm)
    setup = make_pair_setup(
        upper, lower,
        {"spacing": spacing, "upper_pitch": above, "lower_pitch": below, "upper_speed": first,
         "lower_speed": second, "climb": climb, "density": density},
        theory,
    )  # fmt: skip
    _solve_and_print(setup, theory, isolated, interval_options, out, as_json)


@app.command()
def forward(
    upper: UpperArgument = "walkera-5g6",
    lower: LowerArgument = None,
    speed: AirspeedsOption = default_text("0:10:1"),
    spacing: SpacingOption = 0.04,
    rpm: PairRpmOption = default_text("3600,4240"),
    pitch: PairPitchOption = default_text("13,14"),
    tilt: DiscTiltOption = 0.0,
    flap_frequency_ratio: FlapRatiosOption = None,
    density: DensityOption = 1.2,
    polars: PolarOptions = DEFAULT_POLAR_OPTIONS,
    out: OutOption = None,
    as_json: JsonOption = False,
) -> None:
    """Compute a pair in forward flight, the lower rotor in the skewed stream of the upper one.

    Pitch and speed of both rotors stay constant. At airspeed 0 the results equal those of `mufly coax hover --method
    bemt`. With --out: pictures over airspeed (forward.png) and over both discs at the last airspeed. Method:
    docs/explanation/forward-flight.md.
    Example: mufly coax forward walkera-5g6 --speed 0:6:1 --rpm 3600,4240 --pitch 13,14 --out pair
    """
    from mufly.rotor import Air, load_rotor
    from mufly.rotor.forward import ForwardCondition, estimate_flap_mode_range, make_flap_mode, sweep_forward_pair
    from mufly.rotor.forward.forward_pictures import draw_disc_fields, draw_pair_sweep

    angles, speeds, air = convert_pitch_angles(pitch), convert_rotor_speeds(rpm), Air(density_kg_m3=density)
    rotors = (load_rotor(upper), load_rotor(upper if lower is None else lower))
    if flap_frequency_ratio is None:
        bands = [estimate_flap_mode_range(r, w, pitch_rad=a) for r, w, a in zip(rotors, speeds, angles, strict=True)]
        flaps = tuple((bands[0][0][k], bands[1][0][k]) for k in range(2))
        basis = bands[0][1]
    else:
        flaps = tuple((make_flap_mode(rotors[0], n), make_flap_mode(rotors[1], n)) for n in flap_frequency_ratio)
        basis = "flap frequency as given"
    lean = math.radians(tilt)
    sweep = sweep_forward_pair(
        polars.prepare_blading(rotors[0]), polars.prepare_blading(rotors[1]),
        (
            ForwardCondition(angles[0], speeds[0], air=air),
            ForwardCondition(angles[1], speeds[1], rotation_sign=-1, air=air),
        ),
        tuple((v * math.cos(lean), v * math.sin(lean)) for v in speed),
        flaps, spacing_m=spacing, flap_basis=basis,
    )  # fmt: skip
    files = []
    if out is not None:
        last = sweep.points[-1][-1]
        files = [
            save_figure(draw_pair_sweep(sweep), out, "forward"),
            save_figure(draw_disc_fields(last.upper), out, "disc-upper"),
            save_figure(draw_disc_fields(last.lower), out, "disc-lower"),
        ]
    print_answer(as_json, sweep, None, files)


@app.command()
def trim(
    upper: UpperArgument = THESIS_ROTOR_NAME,
    lower: LowerArgument = None,
    spacing: SpacingOption = 0.02,
    thrust: Annotated[
        float | None, define_option("--thrust", "Thrust of the pair. Default: from --rpm.", unit="N")
    ] = None,
    rpm: Annotated[
        tuple[float, ...] | None,
        define_option(
            "--rpm",
            "Speed of the upper rotor, where no thrust is given. With --free lower-pitch the speeds of "
            "both rotors; a thrust then keeps their ratio. Default: 6000.",
            unit="rpm",
            form="pair",
            within=SPEED_RANGE,
        ),
    ] = None,
    free: Annotated[
        str, define_option("NAME", "Quantity that balances the torques: lower-speed or lower-pitch.")
    ] = "lower-speed",
    pitch: PairPitchOption = default_text("14"),
    climb: ClimbOption = 0.0,
    density: DensityOption = 1.2,
    theory: TheoryOptions = DEFAULT_FREE_WAKE_OPTIONS,
    isolated: _IsolatedOption = False,
    interval_options: IntervalOptions = DEFAULT_INTERVAL_OPTIONS,
    out: OutOption = None,
    as_json: JsonOption = False,
) -> None:
    """Find the speeds, or the lower pitch, at which the torques of the two rotors cancel.

    With --thrust both speeds are found, with --rpm (the upper speed) the lower speed. With --free lower-pitch the
    lower pitch is found instead. Torques cancel to 0.1 % by the wake method.

    Examples: mufly coax trim --rpm 6000; mufly coax trim --thrust 0.9 --method bemt; mufly coax trim --rpm 6000,6000
    --free lower-pitch
    """
    if thrust is not None and not thrust > 0.0:
        raise InputError("--thrust", "", f"{thrust:g} N is out of range", "give a number above 0")
    above, below = convert_pitch_angles(pitch)
    fixed: dict[str, float | str] = {
        "spacing": spacing, "upper_pitch": above, "climb": climb, "density": density
    }  # fmt: skip
    first, second = convert_rotor_speeds(rpm or (6000.0,))
    if free == "lower-pitch":
        if len(pitch) > 1:
            raise InputError("--pitch", "", "contains the lower pitch, which is computed", "give the upper pitch only")
        fixed |= {"thrust": thrust} if thrust is not None else {"upper_speed": first}
        fixed["speed_ratio"] = second / first
    else:
        if thrust is not None and rpm is not None:
            raise InputError("--rpm", "", "excludes --thrust", "leave one of the two out")
        if rpm is not None and len(rpm) > 1:
            raise InputError("--rpm", "", "contains the lower speed, which is computed", "give the upper speed only")
        fixed |= {"thrust": thrust} if thrust is not None else {"upper_speed": first}
        fixed["lower_pitch"] = below
    setup = make_pair_setup(upper, lower, fixed, theory, balance=free)
    _solve_and_print(setup, theory, isolated, interval_options, out, as_json)


def _solve_and_print(
    setup: StudySetup,
    theory: TheoryOptions,
    isolated: bool,
    interval_options: IntervalOptions,
    out: Path | None,
    as_json: bool,
) -> None:
    from dataclasses import replace

    from mufly.study.solved_points import solve_pair_point

    wakes = setup.method == "wake"
    with show_wake_progress("coaxial pair", wakes and not as_json, out) as progress:
        found = solve_pair_point(setup, isolated=isolated, progress=progress if wakes else None)
    files = write_pair_results(found.solution, found.alone, out) if out is not None else []
    if not found.solution.converged:
        kept = "" if out is None else f"; its history is in {out}"
        raise MuflyError(f"coaxial wake: {found.solution.message}{kept}")
    found = replace(found, interval=interval_options.predict_interval(found.solution, theory))
    print_answer(as_json, found, files=files)


# ----------------------------------------------------------------------------
# ``mufly coax map``: coefficients over both speeds and the climb velocity, for a vehicle's flight model.


@dataclass(frozen=True)
class MapOptions(WakeOptions):
    """Options of the method that computes a coefficient map."""

    method: Annotated[
        Literal["bemt", "wake"],
        define_option("bemt|wake", "Method: 'bemt' (blade elements, seconds) or 'wake' (vortex wakes, minutes)."),
    ] = "bemt"


DEFAULT_MAP_OPTIONS = MapOptions()


@app.command("map")
def compute_coax_map(
    upper: UpperArgument,
    lower: LowerArgument = None,
    spacing: SpacingOption = 0.04,
    pitch: PairPitchOption = default_text("14"),
    rpm: Annotated[
        str,
        define_option(
            "--rpm",
            "Mean of both rotor speeds, which sets the Reynolds number; one value suffices. Default "
            "number of values: 3, with wakes 1 (the middle).",
            unit="rpm",
            form="steps",
            within=SPEED_RANGE,
        ),
    ] = "2500:6000",
    ratio: Annotated[
        str,
        define_option(
            "--ratio",
            "Lower over upper rotor speed. Default number of values: 11, with wakes 5.",
            unit="1",
            form="steps",
        ),
    ] = "0.6:1.6",
    climb: Annotated[
        str,
        define_option(
            "--climb",
            "Climb velocity at the lowest mean speed, scaled with speed above it; the range includes 0. "
            "Default number of values: 9, with wakes 5.",
            unit="m/s",
            form="steps",
        ),
    ] = "-1:3",
    density: DensityOption = 1.2,
    theory: MapOptions = DEFAULT_MAP_OPTIONS,
    name: Annotated[str, define_option("NAME", "Name of the map. Default: the file's name.")] = "",
    out: Annotated[
        Path | None,
        define_option("FILE", "Map file (TOML) to write; a picture (PNG) of the same name is drawn beside it."),
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """Compute c_T and c_Q of both rotors over their speeds and the climb velocity, as a map file for a vehicle.

    A line `coefficient_map = "pair.toml"` in the table `rotors` of a vehicle file makes the flight model use it in
    place of the constant coefficients (docs/explanation/coax.md). The same command resumes a stopped run. Blade
    elements take seconds, wakes minutes; these have turns=3 and tolerance=3e-3 unless --wake-set differs. Example:
    mufly coax map walkera-5g6 --spacing 40mm --pitch 14 --rpm 2500:6000 --climb -1:3 --out pair.toml
    """
    from mufly.files.answer_store import replace_file_atomically
    from mufly.rotor import Air, draw_coefficient_map, load_rotor, make_climb_axis_over_tip_speed
    from mufly.rotor.coax_maps import compute_coax_map as compute
    from mufly.vehicle import format_coefficient_map_toml

    wakes = theory.method == "wake"
    speeds = np.array(parse_range("--rpm", rpm, "rpm", 1 if wakes else 3)) * RPM
    ratios = parse_range("--ratio", ratio, "1", 5 if wakes else 11)
    climbs = parse_range("--climb", climb, "m/s", 5 if wakes else 9)
    if out is not None and out.suffix != ".toml":
        raise InputError("--out", str(out), "does not end in .toml", "give a name that ends in .toml")
    pitches = convert_pitch_angles(pitch)
    settings, stations = theory.wake_settings_and_stations(turns=3.0, tolerance=3e-3)
    blades = [theory.prepare_blading(load_rotor(r), stations) for r in (upper, upper if lower is None else lower)]
    kept = out.with_suffix(".points") if out is not None else None
    try:
        with progress_bar("points", not as_json) as progress:
            made = compute(
                blades[0], blades[1], spacing_m=spacing, upper_pitch_rad=pitches[0],
                lower_pitch_rad=pitches[-1], mean_speed_rad_s=speeds.tolist(), ratio=ratios,
                climb_ratio=make_climb_axis_over_tip_speed(
                    climbs, speeds.tolist(), blades[0].rotors[0].radius_m
                ).tolist(),
                method=theory.method, air=Air(density_kg_m3=density), settings=settings if wakes else None,
                name=name or (out.stem if out is not None else ""),
                note=f"polars {theory.engine}, n_crit {theory.n_crit:g}, corrections {theory.model}",
                kept=kept, progress=progress,
            )  # fmt: skip
    except KeyboardInterrupt:
        if kept is not None:
            typer.echo(f"stopped; the points so far are in {kept}; the same command resumes", err=True)
        raise
    files = []
    if out is not None:
        with replace_file_atomically(out) as part:
            part.write_text(format_coefficient_map_toml(made), encoding="utf-8")
        files = [out, save_figure(draw_coefficient_map(made), out.parent, out.stem)]
    print_answer(as_json, made, files=files)
