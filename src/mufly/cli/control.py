"""``mufly control``: design, assess and draw the controllers of a vehicle."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from mufly.cli.options import (
    CommandGroup,
    JsonOption,
    MethodOption,
    OrderOption,
    TunedOption,
    VehicleArgument,
    define_option,
)
from mufly.cli.output import make_console, print_answer, print_json, progress_bar
from mufly.cli.station import GustOption, ShutdownHandler, WindOption, parse_wind_option
from mufly.errors import InputError, convert_write_errors
from mufly.results import to_plain_data

if TYPE_CHECKING:
    from mufly.control import DesignSettings, FlightController
    from mufly.control.synthesis.synthesis_methods import SynthesisMethod


def parse_design_settings(method: SynthesisMethod, order: int | None, tuned: list[str] | None) -> DesignSettings:
    """Return the settings of a method and of tuned loops; only the methods fixed and scheduled accept an order."""
    from dataclasses import replace

    from mufly.control import DesignSettings
    from mufly.control.tuning.tuned_loop import load_tuned_settings

    settings = load_tuned_settings(tuned or [], DesignSettings(method=method))
    if order is None:
        return settings
    if method not in ("fixed", "scheduled"):
        raise InputError("--order", "", f"--method {method} chooses its order", "add --method fixed or scheduled")
    return replace(settings, roll_pitch_goals=replace(settings.roll_pitch_goals, order=order))


app = CommandGroup(help="Design and analyse the controllers of a vehicle.", no_args_is_help=True)


@app.command()
def design(
    vehicle: VehicleArgument = "mufly-1.1",
    method: MethodOption = "hinf",
    order: OrderOption = None,
    tuned: TunedOption = None,
    rate: Annotated[
        float | None,
        define_option(
            "--rate", "Rate of the control law; the position loop runs at a quarter of it. Default: 200.", unit="Hz"
        ),
    ] = None,
    voltage: Annotated[
        float | None,
        define_option(
            "--voltage",
            "Battery voltage of the linear model. Default: the vehicle's nominal voltage.",
            unit="V",
        ),
    ] = None,
    out: Annotated[
        Path | None,
        define_option(
            "DIR", "Folder for design.json and plots of singular values (PNG, as the dissertation's Figs 6.3 to 6.8)."
        ),
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """Design heave-yaw, roll-pitch and position control, and compare them with the dissertation's.

    --method applies to heave-yaw and roll-pitch; the velocity loop is H-infinity.

    Printed for each design: the level gamma claimed (H-infinity), and the norm of the closed loop computed from it; \
0 dB crossings of the loop gain; peaks of the sensitivities S_u and T_u at the plant's input; margins. \
Peaks are given for the controller of full order, of reduced order, and sampled with one sample of delay.

    Examples:

      mufly control design

      mufly control design mufly-2.0 --rate 250 --out designs

      mufly control design --method ltr

      mufly control design --method fixed --order 2

      mufly control design --tuned tuned/roll-pitch.json
    """
    from mufly.control import design_flight_controller as design_controllers
    from mufly.vehicle import load_vehicle

    loaded = load_vehicle(vehicle)
    try:
        controller = design_controllers(
            loaded, rate_Hz=rate, voltage=voltage, settings=parse_design_settings(method, order, tuned)
        )
    except InputError as error:
        if error.where != loaded.name:
            raise
        raise error.with_location(vehicle) from None
    written = _write_designs(controller, out) if out is not None else []
    if as_json:
        return print_json(controller)
    print_answer(as_json, controller, files=written)


@app.command()
def mu(
    vehicle: VehicleArgument = "mufly-1.1",
    method: MethodOption = "hinf",
    order: OrderOption = None,
    tuned: TunedOption = None,
    vary: Annotated[
        list[str] | None,
        define_option(
            "--vary WHAT",
            "Parameters and their spread, as for `mufly monte-carlo`. Default: two standard deviations of the vehicle "
            "file, and 10 to 50 % for seven parameters of roll-pitch where it states none.",
        ),
    ] = None,
    points: Annotated[int, define_option("--frequencies N", "Number of frequencies.", min=5)] = 60,
    out: Annotated[
        Path | None, define_option("DIR", "Folder for mu.json, mu.png and worst.toml, the worst vehicle.")
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """Bound the structured singular value of both loops over the vehicle's uncertain parameters.

    An upper bound below 1 proves the loop stable for all parameters within their spreads. The lower bound is an \
example: parameters that move a pole of the loop onto the imaginary axis. worst.toml is the vehicle with these \
parameters, limited to the spreads; fly it with `mufly fly --vehicle worst.toml --designed-for VEHICLE`.

    Examples:

      mufly control mu

      mufly control mu --method ltr --vary body=10% --vary swash_plate.linkage=30% --out robust
    """
    import numpy as np

    from mufly.control import design_flight_controller
    from mufly.control.analysis.plots import draw_mu_bounds
    from mufly.control.robust import analyse_parameter_robustness
    from mufly.flight.monte_carlo import parse_variations
    from mufly.vehicle import format_vehicle_toml, load_vehicle, replace_parameters

    loaded = load_vehicle(vehicle)
    controller = design_flight_controller(loaded, settings=parse_design_settings(method, order, tuned))
    given = parse_variations(vary or [], loaded)
    if given:
        wide = [(1.0 if v.distribution == "uniform" else 2.0) * v.spread_matrix for v in given]
        matrix = np.zeros((sum(len(w) for w in wide), sum(w.shape[1] for w in wide)))
        row = column = 0
        for w in wide:
            matrix[row : row + len(w), column : column + w.shape[1]] = w
            row, column = row + len(w), column + w.shape[1]
        keys = [key for v in given for key in v.keys]
        found = analyse_parameter_robustness(loaded, controller, keys=keys, spread_matrix=matrix, points=points)
    else:
        found = analyse_parameter_robustness(loaded, controller, points=points)
    written: list[Path] = []
    if out is not None:
        with convert_write_errors("--out", "give a folder that can be written", str(out)):
            out.mkdir(parents=True, exist_ok=True)
            written = [out / name for name in ("mu.json", "mu.png", "worst.toml")]
            written[0].write_text(json.dumps(found.as_record(), indent=2) + "\n", encoding="utf-8")
            draw_mu_bounds(found).savefig(written[1], dpi=150)
            worst = replace_parameters(loaded, dict(found.worst_values))
            written[2].write_text(format_vehicle_toml(worst), encoding="utf-8")
    print_answer(as_json, found, files=written)


@app.command("servo-map")
def servo_map(
    vehicle: VehicleArgument = "mufly-1.1",
    no_bar: Annotated[bool, define_option("--no-bar", "Remove the stabiliser bar.")] = False,
    lag: Annotated[list[float] | None, define_option("--lag", "Servo lag. Repeat it for more.", unit="ms")] = None,
    rate: Annotated[list[float] | None, define_option("--rate", "Control rate. Repeat it for more.", unit="Hz")] = None,
    frame: Annotated[
        list[float] | None,
        define_option("--frame", "Servo frame: 20 for analogue servos, 0 for none. Repeat it for more.", unit="ms"),
    ] = None,
    out: Annotated[Path | None, define_option("DIR", "Folder for servo-map.json, .nc and .png.")] = None,
    as_json: JsonOption = False,
) -> None:
    """Map the servo lag, servo frame and control rate that roll-pitch needs, with or without the stabiliser bar.

    Each cell is the best of several bandwidths of the H-infinity design. It gives the disk margin, and for gusts of \
0.5 m/s the tilt and the speed of the swash plate (three standard deviations), which the servos must reach.

    Examples:

      mufly control servo-map

      mufly control servo-map --no-bar --out servos

      mufly control servo-map my-helicopter/vehicle.toml --lag 30 --rate 100 --rate 200 --frame 20
    """
    from mufly.control.analysis.plots import draw_servo_map
    from mufly.control.analysis.servo_map import FRAMES_s, LAGS_s, RATES_Hz, compute_servo_map
    from mufly.logs.tables.columnar_files import write_netcdf
    from mufly.vehicle import load_vehicle, replace_parameters

    loaded = load_vehicle(vehicle)
    if no_bar:
        loaded = replace_parameters(loaded, {"stabiliser_bar.fitted": False})
    grids = [
        check_and_sort_values(name, given, low, high, unit)
        for name, given, low, high, unit in (
            ("--lag", lag, 0.1, 1e3, "ms"), ("--rate", rate, 20.0, 5e3, "Hz"), ("--frame", frame, 0.0, 100.0, "ms")
        )
    ]  # fmt: skip
    with progress_bar("Designing", not as_json) as progress:
        found = compute_servo_map(
            loaded,
            lags_s=[v / 1e3 for v in grids[0]] or LAGS_s,
            rates_Hz=grids[1] or RATES_Hz,
            frames_s=[v / 1e3 for v in grids[2]] or FRAMES_s,
            progress=progress,
        )
    written: list[Path] = []
    if out is not None:
        with convert_write_errors("--out", "give a folder that can be written", str(out)):
            out.mkdir(parents=True, exist_ok=True)
            written = [out / f"servo-map.{suffix}" for suffix in ("json", "nc", "png")]
            written[0].write_text(json.dumps(found.as_record(), indent=2) + "\n", encoding="utf-8")
            write_netcdf(found.table, written[1])
            draw_servo_map(found).savefig(written[2], dpi=150)
    print_answer(as_json, found, files=written)


@app.command("rotor-speeds")
def rotor_speeds(
    vehicle: VehicleArgument = "mufly-1.1",
    rate: Annotated[float, define_option("--rate", "Control rate.", unit="Hz", min=20.0, max=5e3)] = 200.0,
    as_json: JsonOption = False,
) -> None:
    """Compare heave-yaw with and without measured rotor speeds (back-EMF).

    Both loops are LQG/LTR with the same weights, swept over the weight of the inputs.

    Example: mufly control rotor-speeds
    """
    from mufly.control.analysis.rotor_speed_feedback import compare_rotor_speed_feedback
    from mufly.vehicle import load_vehicle

    print_answer(as_json, compare_rotor_speed_feedback(load_vehicle(vehicle), rate_Hz=rate))


@app.command()
def schedule(
    vehicle: VehicleArgument = "mufly-1.1",
    flight_map: Annotated[
        str | None, define_option("--flight-map FILE", "Flight map of the rotors; `mufly coax flight-map` makes it.")
    ] = None,
    speed: Annotated[
        list[float] | None,
        define_option(
            "--speed", "Forward speed of designs and flight. Repeat it for more. Default: 0, 1, 2.", unit="m/s"
        ),
    ] = None,
    methods: Annotated[
        list[str] | None,
        define_option("--methods WHICH", "Method: hinf, h2, lqg, ltr or indi. Repeat it for more. Default: all."),
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """Assess gain scheduling of roll-pitch over forward speed.

    Every design is assessed with the model at every speed. A schedule has at best the margins on the diagonal of the \
table, where model and design have the same speed.

    Example: mufly control schedule --flight-map pair.toml --speed 0 --speed 1 --speed 2
    """
    from mufly.control.analysis.speed_schedule import FAST_SYNTHESIS_METHODS, SPEEDS_m_s, compare_designs_over_speed
    from mufly.vehicle import load_vehicle, replace_parameters

    loaded = load_vehicle(vehicle)
    if flight_map is not None:
        loaded = replace_parameters(loaded, {"rotors.flight_map": flight_map})
    chosen = [method for method in FAST_SYNTHESIS_METHODS if methods is None or method in methods]
    for name in methods or ():
        if name not in FAST_SYNTHESIS_METHODS:
            raise InputError("--methods", name, "is not a method", f"give one of {', '.join(FAST_SYNTHESIS_METHODS)}")
    speeds = check_and_sort_values("--speed", speed, 0.0, 50.0, "m/s") or list(SPEEDS_m_s)
    with progress_bar("Designing", not as_json) as progress:
        found = compare_designs_over_speed(loaded, chosen, speeds_m_s=speeds, progress=progress)
    print_answer(as_json, found)


def check_and_sort_values(option: str, given: list[float] | None, low: float, high: float, unit: str) -> list[float]:
    """Return the values of an option in rising order, each once; empty if none are given.

    Raises
    ------
    InputError
        If a value is out of range.
    """
    for value in given or ():
        if not low <= value <= high:
            raise InputError(option, "", f"{value:g} {unit} is out of range", f"give {low:g} to {high:g} {unit}")
    return sorted(set(given or ()))


@app.command()
def tune(
    vehicle: VehicleArgument = "mufly-1.1",
    loop: Annotated[Literal["roll-pitch", "heave-yaw"], define_option("--loop WHICH", "Loop to tune.")] = "roll-pitch",
    order: Annotated[
        int | None,
        define_option(
            "--order N", "Order of the controller. Default: 4 for roll-pitch, 6 for heave-yaw.", min=2, max=10
        ),
    ] = None,
    gamma: Annotated[
        float | None,
        define_option(
            "--gamma LEVEL", "Goal for the norm of the weighted loop. Default: 0.66; heave-yaw 1.05.", min=0.01
        ),
    ] = None,
    sensitivity: Annotated[
        float | None,
        define_option(
            "--sensitivity DB", "Goal for the peak of the sensitivity S_u in dB. Default: 2.5; heave-yaw 3.2.", min=0.01
        ),
    ] = None,
    complementary: Annotated[
        float | None,
        define_option(
            "--complementary DB",
            "Goal for the peak of the complementary sensitivity T_u in dB. Default: 2.4; heave-yaw 3.1.",
            min=0.01,
        ),
    ] = None,
    disk: Annotated[
        float | None,
        define_option(
            "--disk RADIUS",
            "Goal for the disk margin, with one input disturbed at a time. Default: 0.97; heave-yaw none.",
            min=0.01,
            max=1.99,
        ),
    ] = None,
    activity: Annotated[
        float | None,
        define_option(
            "--activity RATIO",
            "Goal for the input's noise by the sensors, relative to H-infinity. Default: 1; heave-yaw 1.2.",
            min=0.01,
        ),
    ] = None,
    mu: Annotated[
        float | None,
        define_option(
            "--mu LEVEL", "Goal for mu over the vehicle's parameters. Default: 0.6; heave-yaw none.", min=0.01
        ),
    ] = None,
    only: Annotated[
        bool, define_option("--only", "Use only the given goals; without this option the default goals are added.")
    ] = False,
    starts: Annotated[
        list[str] | None,
        define_option(
            "--start WHICH",
            "Start: a method (hinf, h2, lqg, ltr), delay (hinf with the delay in its plant), or the file of "
            "a tuned loop. Repeat it for more. Default: hinf, delay and ltr.",
        ),
    ] = None,
    rounds: Annotated[int, define_option("--rounds N", "Rounds for each of the two best starts.", min=1)] = 4,
    steps: Annotated[int, define_option("--steps N", "Steps of each descent; a round has three descents.", min=1)] = 60,
    rate: Annotated[float | None, define_option("--rate", "Rate of the control law. Default: 200.", unit="Hz")] = None,
    out: Annotated[
        Path, define_option("DIR", "Folder for LOOP.json and LOOP.png; a tuning is continued there.")
    ] = Path("tuned"),
    as_json: JsonOption = False,
) -> None:
    """Tune the controller of one loop, of a given order, for several goals at once.

    Tuning lowers the largest ratio of a goal to its level; below 1 all goals are reached. Goals are computed with \
1.5 periods of delay; the figures below the table are those of the sampled loop. A larger --rounds continues an \
earlier tuning.

    LOOP.json is the controller: give it as --tuned to `mufly control design`, `mufly control mu`, `mufly fly`, \
`mufly monte-carlo` and `mufly firmware export`.

    Examples:

      mufly control tune --order 2

      mufly control tune --loop heave-yaw --order 6 --steps 200

      mufly control tune --order 8 --start ltr --start tuned/roll-pitch.json --out further
    """
    from mufly.control.analysis.plots import draw_tuned_loop
    from mufly.control.synthesis.synthesis_methods import SYNTHESIS_METHODS
    from mufly.control.tuning.loop_tuning import DEFAULT_GOALS, DEFAULT_ORDERS, GoalLevels
    from mufly.control.tuning.tuned_loop import DEFAULT_START_METHODS, tune_loop
    from mufly.vehicle import load_vehicle

    loaded = load_vehicle(vehicle)
    known = [m for m in SYNTHESIS_METHODS if m not in ("mu", "fixed", "scheduled", "indi")] + ["delay"]
    for start in starts or ():
        if start not in known and not start.endswith(".json"):
            raise InputError(
                "--start",
                start,
                "is neither a synthesis method nor a file",
                f"give one of {', '.join(known)}, or a .json file",
            )
    goals = (GoalLevels() if only else DEFAULT_GOALS[loop]).replace_levels(
        {
            "gamma": gamma, "sensitivity_dB": sensitivity, "complementary_dB": complementary, "disk_margin": disk,
            "activity": activity, "mu": mu,
        }
    )  # fmt: skip
    target = out / f"{loop}.json"
    with convert_write_errors("--out", "give a folder that can be written", str(out)):
        out.mkdir(parents=True, exist_ok=True)
    with progress_bar("Tuning", not as_json) as progress:
        found = tune_loop(
            loaded, loop, DEFAULT_ORDERS[loop] if order is None else order, goals,
            starts=starts or DEFAULT_START_METHODS,
            rounds=rounds, steps=steps, rate_Hz=rate, path=target, progress=progress,
        )  # fmt: skip
    with convert_write_errors("--out", "give a folder that can be written", str(out)):
        draw_tuned_loop(found).savefig(target.with_suffix(".png"), dpi=150)
    print_answer(as_json, found, files=[target, target.with_suffix(".png")])


@app.command()
def compare(
    vehicle: VehicleArgument = "mufly-1.1",
    methods: Annotated[
        list[str] | None,
        define_option(
            "--methods WHICH",
            "Method to compare. Repeat it for more. Default: all, as for --method of `mufly control design`.",
        ),
    ] = None,
    order: Annotated[int, define_option("--order N", "Order of roll-pitch by the method fixed.", min=2, max=8)] = 4,
    tuned: Annotated[
        list[str] | None,
        define_option("--tuned LOOP", "A further row: file of a loop by `mufly control tune`; repeat it."),
    ] = None,
    points: Annotated[int, define_option("--frequencies N", "Number of frequencies of mu.", min=5)] = 30,
    speed: Annotated[
        list[float] | None,
        define_option(
            "--speed",
            "Forward speed at which roll-pitch is assessed. Repeat it for more. Default: 0, 1, 2.",
            unit="m/s",
        ),
    ] = None,
    flights: Annotated[
        int, define_option("--flights -n N", "Flights of each method on simulated sensors; 0: none.", min=0)
    ] = 0,
    mission: Annotated[str, define_option("--mission NAME", "Mission to fly.")] = "demonstration",
    vary: Annotated[
        list[str] | None, define_option("--vary WHAT", "Variation of the flights, as for `mufly monte-carlo`.")
    ] = None,
    wind: WindOption = None,
    gust: GustOption = None,
    seed: Annotated[int, define_option("--seed", "Seed of the flights, the same for every method.")] = 0,
    jobs: Annotated[
        int | None, define_option("--jobs -j N", "Parallel flights. Default: one for each core.", min=1)
    ] = None,
    out: Annotated[
        Path,
        define_option("DIR", "Folder for compare.json, compare.nc, compare.png and the flights; flights resume there."),
    ] = Path("compare"),
    as_json: JsonOption = False,
) -> None:
    """Compare controllers of several methods on one vehicle: margins, robustness, noise, cost and flights.

    Figures are those of the controllers as they fly: reduced, sampled, with one sample of delay. gamma is the norm of \
the weighted loop. GM, PM and DM are gain, phase and delay margin. mu is an upper bound over the parameters, \
noise the largest input by sensor noise, gust the tilt in gusts of 0.5 m/s, n the order, \
MAC the multiply-adds in a period. A third table has roll-pitch at forward speeds. Instructions are those on a \
Cortex-M4, where its compiler and emulator are installed. The verdict names the criterion that decides it. Designs, \
bounds of mu and flights resume.

    Examples:

      mufly control compare

      mufly control compare --methods hinf --methods ltr --flights 200 --wind 0.5 --gust 0.3

      mufly control compare --methods ltr --tuned tuned/roll-pitch.json
    """
    from dataclasses import replace

    from mufly.control import DesignSettings
    from mufly.control.analysis.comparison import FlightMetrics, compare_methods, comparison_dataset, recommend_method
    from mufly.control.analysis.plots import draw_comparison
    from mufly.control.analysis.speed_schedule import SPEEDS_m_s
    from mufly.control.synthesis.synthesis_methods import SYNTHESIS_METHODS
    from mufly.control.tuning.tuned_loop import load_tuned_settings
    from mufly.firmware.proof.sil_pil import describe_missing_tools, measure_law_instructions
    from mufly.logs.tables.columnar_files import write_netcdf
    from mufly.vehicle import load_vehicle

    wanted = tuple(dict.fromkeys(methods or SYNTHESIS_METHODS))
    for name in wanted:
        if name not in SYNTHESIS_METHODS:
            raise InputError("--methods", name, "is not a method", f"give one of {', '.join(SYNTHESIS_METHODS)}")
    loaded = load_vehicle(vehicle)
    speeds = check_and_sort_values("--speed", speed, 0.0, 50.0, "m/s") or SPEEDS_m_s
    settings = DesignSettings()
    settings = replace(settings, roll_pitch_goals=replace(settings.roll_pitch_goals, order=order))
    chosen = [method for method in SYNTHESIS_METHODS if method in wanted]
    given = [load_tuned_settings([one], DesignSettings()) for one in tuned or ()]
    with progress_bar("Designing", not as_json) as progress:
        found, controllers = compare_methods(
            loaded,
            chosen,
            settings=settings,
            tuned=given,
            points=points,
            speeds_m_s=speeds,
            folder=out,
            progress=progress,
        )
    counts: list[float | None] = [None] * len(controllers)
    if not describe_missing_tools():
        counts = [*measure_law_instructions(loaded, list(controllers.values()))]
    found = replace(
        found, methods=tuple(replace(m, instructions=n) for m, n in zip(found.methods, counts, strict=True))
    )
    if flights:
        from mufly.firmware import GenericFirmwareSoftware
        from mufly.flight.monte_carlo import (
            Campaign,
            WorkerPool,
            compute_wilson_interval,
            parse_variations,
            run_campaign,
        )
        from mufly.mission import load_mission

        rows = []
        ending = ShutdownHandler()
        with ending, WorkerPool(jobs) as crew:
            for row in found.methods:
                campaign = Campaign.create_checked(
                    loaded, load_mission(mission), variations=parse_variations(vary or [], loaded),
                    wind=parse_wind_option(wind), gust=gust, seed=seed, fast_controllers=GenericFirmwareSoftware,
                    vehicle_name=vehicle, mission_name=mission, controller=controllers[row.method],
                )  # fmt: skip
                with progress_bar(f"Flying {row.method_label}", not as_json) as progress:
                    flown = run_campaign(
                        campaign, flights, crew=crew, folder=out / row.method, progress=progress,
                        stop=ending.stop_requested.is_set,
                    )  # fmt: skip
                if len(flown) < flights:
                    make_console(stderr=True).print(f"Stopped; the same command resumes in {out}", highlight=False)
                    raise typer.Exit(ending.exit_status)
                good = sum(f.success for f in flown)
                over = sorted(f.overshoot_m for f in flown if f.overshoot_m is not None)
                worst = over[min(len(over) - 1, int(0.95 * len(over)))] if over else None
                rows.append(
                    replace(row, flights=FlightMetrics(flights, good, *compute_wilson_interval(good, flights), worst))
                )
        found = recommend_method(found.vehicle_name, found.rate_Hz, rows)
    with convert_write_errors("--out", "give a folder that can be written", str(out)):
        out.mkdir(parents=True, exist_ok=True)
        written = [out / "compare.json", out / "compare.png", out / "compare.nc"]
        written[0].write_text(json.dumps(to_plain_data(found), indent=2) + "\n", encoding="utf-8")
        draw_comparison(found).savefig(written[1], dpi=150)
        write_netcdf(comparison_dataset(found), written[2])
    print_answer(as_json, found, files=written)


def _write_designs(controller: FlightController, folder: Path) -> list[Path]:
    from mufly.control.analysis.plots import write_design_pictures

    with convert_write_errors("--out", "give a folder that can be written", str(folder)):
        target = folder / "design.json"
        written = [*write_design_pictures(controller, folder), target]
        target.write_text(json.dumps(to_plain_data(controller), indent=2) + "\n", encoding="utf-8")
    return written
