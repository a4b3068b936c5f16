"""``mufly identify rotor``: coefficients of rotors from bench files."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, cast

import typer

from mufly.cli.options import (
    PITCH_RANGE,
    SPACING_RANGE,
    SPEED_RANGE,
    ColumnOption,
    JsonOption,
    PictureOption,
    StartVehicleOption,
    WriteOption,
    default_text,
    define_argument,
    define_option,
    format_today,
    load_start_vehicle,
    parse_value_and_std,
    write_estimated_vehicle,
)
from mufly.cli.output import (
    check_output_place,
    print_answer,
    progress_bar,
    save_figure,
    write_csv,
)
from mufly.errors import InputError, suggest_name
from mufly.quantities.quantity_grammar import ValueWithStd, parse_named_texts, parse_names, parse_quantity
from mufly.quantities.units import RPM, split_unit_suffix

if TYPE_CHECKING:
    from mufly.identify.flight.excitation_plan import ExcitationCandidate, ExcitationPlan, FlightLimits
    from mufly.identify.flight.excitation_signals import SignalKind


def rotor(
    bench: Annotated[
        list[Path],
        define_argument(
            "CSV...",
            "Bench files with columns speed_rpm, thrust_N, torque_Nm of a single rotor, or "
            "speed_upper_rpm, thrust_upper_N, torque_lower_Nm, ... of a pair; thrust_raw_V with "
            "--calibration. Rows with speed 0 give the zero of the load cells.",
        ),
    ],
    radius: Annotated[
        ValueWithStd | None,
        define_option(
            "--radius",
            "Rotor radius, as 60mm or 0.06+-0.0002. Default: that of --rotor or --vehicle.",
            unit="m",
            form="doubt",
        ),
    ] = None,
    density: Annotated[
        ValueWithStd | None,
        define_option(
            "--density",
            "Density of the air, as 1.19 or 1.19+-0.01. Default: the file's, else 1.2.",
            unit="kg/m3",
            form="doubt",
        ),
    ] = None,
    calibration: Annotated[
        Path | None,
        define_option(
            "CSV",
            "Calibration file with known loads and readings of the cells: thrust_N, thrust_raw_V, "
            "torque_Nm, torque_raw_V.",
        ),
    ] = None,
    columns: ColumnOption = None,
    at_rpm: Annotated[
        float | None,
        define_option(
            "--at-rpm",
            "Speed at which to evaluate coefficients that change with speed. Default: the mean.",
            unit="rpm",
            within=SPEED_RANGE,
        ),
    ] = None,
    predict_with: Annotated[
        str | None,
        define_option("--rotor NAME|FILE", "Rotor whose blade element theory is compared with the measurement."),
    ] = None,
    pitch: Annotated[
        float | None,
        define_option(
            "--pitch",
            "Pitch setting for the prediction, where the file has none, as 12.",
            unit="deg",
            within=PITCH_RANGE,
        ),
    ] = None,
    spacing: Annotated[
        float | None,
        define_option(
            "--spacing",
            "Distance between the discs of a pair, for the prediction.",
            unit="m",
            within=SPACING_RANGE,
        ),
    ] = None,
    place: Annotated[
        str | None,
        define_option("--as upper|lower", "Rotor of --vehicle that was measured as a single rotor: upper or lower."),
    ] = None,
    vehicle: StartVehicleOption = None,
    write: WriteOption = None,
    out: PictureOption = None,
    as_json: JsonOption = False,
) -> None:
    """Find thrust and torque coefficients of rotors from bench files, single and coaxial.

    Example: mufly identify rotor bench.csv --radius 0.0875 --calibration cells.csv --out rotor
    """
    from mufly.bench import compute_loads, fit_cell_calibration, predict_loads, read_bench_files
    from mufly.identify.fit_pictures import draw_rotor_coefficients
    from mufly.identify.rotor_coefficients import (
        RotorCoefficientFit,
        RotorIdentification,
        assign_rotor_side,
        fit_rotor_coefficients,
    )
    from mufly.rotor import load_rotor, prepare_blading

    start = load_start_vehicle(vehicle, write)
    check_output_place("--out", out)
    if place not in (None, "upper", "lower"):
        raise InputError("--as", "", f"{place!r} is not a rotor of a vehicle", "use upper or lower")
    blades = load_rotor(predict_with) if predict_with is not None else None
    tables = read_bench_files([*bench, *([calibration] if calibration else [])], columns=columns or ())
    cells = fit_cell_calibration(tables.pop()) if calibration else None
    value, std = parse_value_and_std("--radius", radius)
    if value is None:
        known = [*([blades.radius_m] if blades else []), *([float(start.rotors.radius)] if start else [])]
        known += [0.5 * t.diameter_m for t in tables if math.isfinite(t.diameter_m)]
        if not known:
            raise InputError("--radius", "", "is missing", "give the rotor's radius in metres, or --rotor or --vehicle")
        value = known[0]
    rho, rho_std = parse_value_and_std("--density", density)
    loads = [compute_loads(t, cells, radius_m=value, density_kg_m3=rho) for t in tables]
    by_file = [
        fit_rotor_coefficients(
            one, radius_m=value, radius_std_m=std, density_kg_m3=rho, density_std_kg_m3=rho_std,
            at_speed_rad_s=None if at_rpm is None else at_rpm * RPM, vehicle=start,
        )
        for one in loads
    ]  # fmt: skip
    fits: list[RotorCoefficientFit] = [
        f if place is None else assign_rotor_side(f, place, start) for one in by_file for f in one
    ]
    predictions, drawn = {}, {}
    if blades is not None:
        blading = prepare_blading(blades)
        for one in by_file:
            first, source = one[0], one[0].source
            with progress_bar("points", shown=first.coaxial and not as_json) as move:
                p = predict_loads(
                    first.loads, blading, density_kg_m3=float(first.density_kg_m3.mean()), spacing_m=spacing,
                    pitch_rad=None if pitch is None else math.radians(pitch), progress=move,
                )  # fmt: skip
            predictions[source] = p
            if len(one) == 1:
                drawn.update({f"{source} {c}": (p.speed_rad_s[c], p.load[c]) for c in p.load})
    sources = ", ".join(t.source for t in tables)
    if write is not None and len({round(f.stated_pitch_rad, 4) for f in fits if math.isfinite(f.stated_pitch_rad)}) > 1:
        raise InputError("--write", sources, "has several pitch settings", "leave one in the file")
    found = (e for f in fits for e in f.estimates)
    files = write_estimated_vehicle(start, found, write, f"mufly identify rotor {sources}, {format_today()}")
    if out is not None:
        files.append(save_figure(draw_rotor_coefficients(fits, predicted=drawn, title=sources), out, "rotor"))
    print_answer(as_json, RotorIdentification(tuple(fits), cells, predictions), files=files)


# ----------------------------------------------------------------------------
# ``mufly identify plan``: excitation signals, their amplitudes, and the standard deviations to expect.


def plan(
    vehicle: Annotated[str, define_argument("NAME|FILE", "Vehicle to identify, as far as it is known.")],
    free: Annotated[
        str,
        define_option("SYMBOL,...", "Parameters to identify, symbols of `mufly vehicle show`, separated by commas."),
    ],
    channel: Annotated[
        str,
        define_option(
            "NAME,...", "Channels to excite: yaw, heave, roll or pitch. Several make a plan of several flights."
        ),
    ] = "yaw",
    kind: Annotated[
        str, define_option("NAME", "Signal: chirp, multisine, 3211 or doublet; 'best' compares all.")
    ] = "best",
    duration: Annotated[float, define_option("--duration", "Length of each flight.", unit="s")] = 10.0,
    amplitude: Annotated[
        float | None,
        define_option(
            "--amplitude",
            "Largest addition to an input, 0 to 1, lowered to the safe amplitude. Default: the largest safe one.",
            unit="1",
        ),
    ] = None,
    band: Annotated[
        tuple[float, float] | None,
        define_option(
            "--band",
            "Frequency band, as 0.1:3. Default: around the channel's modes.",
            unit="Hz",
            form="band",
        ),
    ] = None,
    limit: Annotated[
        str | None,
        define_option(
            "NAME=VALUE,...",
            "Limits of the motion from hover: attitude_deg, heading_deg, rates_deg_s, height_m, place_m; "
            "and least distance of inputs from their ends: motor, servo. Default: "
            "attitude_deg=20,heading_deg=90,rates_deg_s=229,height_m=0.5,place_m=1,motor=0.05,servo=0.1.",
        ),
    ] = None,
    noise: Annotated[
        str | None,
        define_option(
            "OUTPUT=STD,...",
            "Standard deviations of the sensors (SI), as 'height=0.005,speed_up=2,yaw=none'. Defaults: "
            "height 0.01 m; roll, pitch 0.01, yaw 0.02 rad; p, q, r 0.03 rad/s.",
        ),
    ] = None,
    delay: Annotated[float, define_option("--delay", "Delay from command to input.", unit="s")] = 0.02,
    window: Annotated[
        float,
        define_option(
            "--window",
            "Time after which the motion counts as unknown again, which represents gusts; 0: unknown at "
            "the start only, a lower bound.",
            unit="s",
        ),
    ] = 2.0,
    sample: Annotated[float, define_option("--sample", "Sample time of the log.", unit="s")] = 0.01,
    out: Annotated[Path | None, define_option("--out DIR", "Folder for signals (CSV) and pictures (PNG).")] = None,
    as_json: JsonOption = False,
) -> None:
    """Design flights for identification: safe input signals, and the parameters' expected standard deviations.

    Example: mufly identify plan mufly-1.1 --free cT_dw,cQ_dw,Jdrive_dw --channel yaw,heave --out plan
    """
    from mufly.identify.fit_pictures import draw_excitation_plan
    from mufly.identify.flight.excitation_plan import (
        SENSOR_NOISE_STD,
        combine_plans,
        design_excitation,
    )
    from mufly.identify.flight.excitation_signals import SIGNAL_KINDS
    from mufly.vehicle import load_vehicle

    v = load_vehicle(vehicle)
    symbols = parse_names(free)
    channels = list(dict.fromkeys(parse_names(channel)))
    kinds = SIGNAL_KINDS if kind == "best" else (cast("SignalKind", kind),)
    check_output_place("--out", out)
    _check_timing_options(duration, delay, sample, window)
    limits, std = _parse_limits(limit), _parse_noise(noise, SENSOR_NOISE_STD)
    frequencies = None if band is None else (2 * math.pi * band[0], 2 * math.pi * band[1])
    plans: list[ExcitationPlan] = []
    for name in channels:
        with progress_bar(f"{name} flights", shown=not as_json) as move:
            plans.append(
                design_excitation(
                    v, symbols, name, kinds=kinds, duration_s=duration, amplitude=amplitude, band_rad_s=frequencies,
                    limits=limits, noise=std, sample_s=sample, delay_s=delay, progress=move,
                    window_s=window if window > 0 else None,
                )
            )  # fmt: skip
    files = []
    if out is not None:
        for p in plans:
            c = p.best_candidate
            files.append(save_figure(draw_excitation_plan(p, c), out, f"plan_{p.channel}"))
            files.append(_write_signal(out / f"signal_{p.channel}_{c.signal.kind}.csv", c))
    print_answer(as_json, combine_plans(plans), files=files)


def _check_timing_options(duration: float, delay: float, sample: float, window: float) -> None:
    def is_multiple(time: float, of: float) -> bool:
        return abs(time / of - round(time / of)) <= 1e-6

    sampled = 1e-3 <= sample <= 0.1 and is_multiple(sample, 1e-3)
    for its, value, fine, remedy in (
        ("--sample", sample, sampled, "give whole milliseconds from 0.001 to 0.1"),
        ("--delay", delay, sampled and 0 <= delay <= 0.2 and is_multiple(delay, sample),
         f"give a multiple of {sample:g} s up to 0.2"),
        ("--window", window, window == 0 or 10 * sample <= window < math.inf, f"give 0, or {10 * sample:g} s or more"),
        ("--duration", duration, 2.0 <= duration <= 300.0, "give 2 to 300 s"),
    ):  # fmt: skip
        if not fine:
            raise InputError(its, "", f"{value:g} s is out of range", remedy)


def _parse_named_numbers(
    option: str, text: str | None, known: Mapping[str, str], *, none: bool = False
) -> dict[str, float | None]:
    """Return the numbers of ``NAME=VALUE,...``; ``known`` maps allowed names to the unit of a bare number."""
    found: dict[str, float | None] = {}
    for name, value in parse_named_texts(text or "").items():
        if name not in known:
            raise InputError(option, name, "is unknown", suggest_name(name, known))
        unit = known[name]
        number = None if none and value == "none" else parse_quantity(f"{option}: {name}", value, unit)
        if number is not None and not number > 0:
            raise InputError(option, name, f"{value} is out of range", "give a number above 0")
        found[name] = number
    return found


def _parse_limits(text: str | None) -> FlightLimits:
    from mufly.identify.flight.excitation_plan import FlightLimits

    names = {
        "attitude_deg": ("attitude_rad", math.radians(1)), "heading_deg": ("heading_rad", math.radians(1)),
        "rates_deg_s": ("rates_rad_s", math.radians(1)), "height_m": ("height_m", 1.0), "place_m": ("place_m", 1.0),
        "motor": ("motor_margin", 1.0), "servo": ("servo_margin", 1.0),
    }  # fmt: skip
    units = {name: split_unit_suffix(name)[1] or "1" for name in names}
    given = _parse_named_numbers("--limit", text, units)
    for name, top in (("motor", 0.5), ("servo", 1.0)):
        if (given.get(name) or 0.0) >= top:
            raise InputError(
                "--limit",
                name,
                f"a margin of {given[name]:g} leaves no range for the input",
                f"give a number below {top:g}",
            )
    return FlightLimits(**{names[k][0]: v * names[k][1] for k, v in given.items() if v is not None})


def _parse_noise(text: str | None, default: dict[str, float]) -> dict[str, float]:
    from mufly.identify.flight_record import OUTPUT_UNITS

    merged: dict[str, float | None] = {
        **default,
        **_parse_named_numbers("--noise", text, OUTPUT_UNITS, none=True),
    }
    return {k: v for k, v in merged.items() if v is not None}


def _write_signal(path: Path, c: ExcitationCandidate) -> Path:
    heads = ("time_s", "signal", "motor_upper", "motor_lower", "servo_1", "servo_2")
    values = zip(c.signal.time_s, c.amplitude * c.signal.value, c.added_inputs, strict=True)
    rows = ([f"{x + 0.0:.6g}" for x in (t, s, *row)] for t, s, row in values)
    return write_csv(
        path, heads, rows, f"{c.channel}, {c.signal.kind}: {c.signal.description}; add the columns to the inputs"
    )


# ----------------------------------------------------------------------------
# ``mufly identify motor``: constants of a motor from a bench file; and registration of the bench commands.


def register_bench_commands(app: typer.Typer) -> None:
    """Register the commands of this module."""
    app.command()(motor)
    app.command()(rotor)
    app.command()(plan)


def motor(
    bench: Annotated[
        Path,
        define_argument(
            "CSV",
            "Bench file with columns voltage_V (and duty), current_A, speed_rpm, torque_mNm; "
            "docs/reference/bench.md lists the accepted names and units.",
        ),
    ],
    gear_ratio: Annotated[
        ValueWithStd | str,
        define_option(
            "--gear --gear-ratio",
            "Gear ratio, motor speed over measured speed: 1.5, 1.5+-0.01 or 'free'.",
            unit="1",
            form="doubt",
            words=("free",),
        ),
    ] = default_text("1"),
    gear_efficiency: Annotated[
        ValueWithStd | str,
        define_option(
            "--gear-efficiency",
            "Efficiency of the gear between motor and torque sensor: 0.84, 0.84+-0.02 or 'free'.",
            unit="1",
            form="doubt",
            words=("free",),
        ),
    ] = default_text("1"),
    noise: Annotated[
        str | None,
        define_option(
            "CHANNEL=AMOUNT,...",
            "Expected errors of channels, as 'current=1%+0.01,speed=0.5%fs' (of the reading, of full "
            "scale, or SI); only their ratios count. Default: the most likely of five error models.",
        ),
    ] = None,
    columns: ColumnOption = None,
    vehicle: StartVehicleOption = None,
    write: WriteOption = None,
    out: PictureOption = None,
    as_json: JsonOption = False,
) -> None:
    """Find a motor's constants from stationary points on a bench: voltage, current, speed and torque.

    Example: mufly identify motor motor.csv --vehicle mufly-1.1 --write mine.toml --out motor
    """
    from mufly.bench import read_bench_file
    from mufly.identify.fit_pictures import draw_motor_fit
    from mufly.identify.motor_data import MOTOR_CHANNELS, parse_channel_noise
    from mufly.identify.motor_fit import GearKnowledge, fit_motor

    start = load_start_vehicle(vehicle, write)
    check_output_place("--out", out)
    ratio, ratio_std = parse_value_and_std("--gear", gear_ratio)
    eta, eta_std = parse_value_and_std("--gear-efficiency", gear_efficiency)
    if eta is not None and eta > 1.0:
        raise InputError("--gear-efficiency", "", f"{eta:g} is out of range", "give a number up to 1")
    table = read_bench_file(bench, columns=columns or ())
    fit = fit_motor(
        table, gear=GearKnowledge(ratio, eta, ratio_std, eta_std), vehicle=start,
        noise=parse_channel_noise(noise, MOTOR_CHANNELS) if noise else None,
    )  # fmt: skip
    files = write_estimated_vehicle(
        start, fit.estimates, write, f"mufly identify motor {table.source}, {format_today()}"
    )
    if out is not None:
        picture = draw_motor_fit(fit, title=f"{table.source}: motor constants by least squares")
        files.append(save_figure(picture, out, "motor"))
    print_answer(as_json, fit, files=files)
