"""``mufly rotor forward``: a rotor in forward flight."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Annotated

from mufly.cli.aero.rotor_theory_options import DEFAULT_POLAR_OPTIONS, PolarOptions
from mufly.cli.options import (
    AirspeedsOption,
    DensityOption,
    DiscTiltOption,
    FlapRatiosOption,
    JsonOption,
    OptionalPitchOption,
    OptionalRpmOption,
    OptionRange,
    OutOption,
    RotorArgument,
    default_text,
    define_option,
)
from mufly.cli.output import print_answer, save_figure
from mufly.cli.rotor import app
from mufly.errors import InputError
from mufly.quantities.units import RPM

if TYPE_CHECKING:
    from mufly.rotor import Rotor

_DEFAULT_PITCH_RAD, _DEFAULT_TIP_SPEED_M_S = math.radians(12.0), 35.0
_CYCLIC_RANGE = OptionRange(0.01, 20.0, "deg", "the response is linear for small amplitudes only")


@app.command("forward")
def show_forward(
    rotor: RotorArgument = "walkera-5g6",
    speed: AirspeedsOption = default_text("0:10:1"),
    pitch: OptionalPitchOption = None,
    rpm: OptionalRpmOption = None,
    thrust: Annotated[
        float | None,
        define_option("--thrust", "Thrust in hover; with --pitch the speed is found, with --rpm the pitch.", unit="N"),
    ] = None,
    tilt: DiscTiltOption = 0.0,
    cyclic: Annotated[
        float,
        define_option(
            "--cyclic", "Amplitude of cyclic pitch whose response is computed.", unit="deg", within=_CYCLIC_RANGE
        ),
    ] = 1.0,
    flap_frequency_ratio: FlapRatiosOption = None,
    blade_mass: Annotated[
        float | None,
        define_option(
            "--blade-mass", "Mass of one blade. Default: that of its structure, else of solid ABS.", unit="g"
        ),
    ] = None,
    density: DensityOption = 1.2,
    polars: PolarOptions = DEFAULT_POLAR_OPTIONS,
    out: OutOption = None,
    as_json: JsonOption = False,
) -> None:
    """Compute a rotor in forward flight: loads, flapping, hub moments and the response to cyclic pitch.

    Give two of --pitch, --rpm and --thrust; pitch and speed then stay those of hover. Missing values are
    those of the upper rotor of mufly-1.1 in hover if it has the same radius, else 12 degrees and a tip speed of 35 m/s;
    the output states which. The flap frequency of a small
    blade is usually uncertain, so the results are ranges over its band. With --out: pictures over airspeed
    (forward.png) and over the disc at the last airspeed (disc.png). Method: docs/explanation/forward-flight.md.
    Examples: mufly rotor forward walkera-5g6 --pitch 13 --rpm 3600 --speed 0:8:2; mufly rotor forward --thrust 0.46
    --rpm 3600 --flap-frequency-ratio 1,1.1,1.6 --out forward
    """
    from mufly.rotor import Air, load_rotor, solve_for_thrust
    from mufly.rotor.forward import ForwardCondition, estimate_flap_mode_range, make_flap_mode, sweep_forward
    from mufly.rotor.forward.forward_pictures import draw_disc_fields, draw_forward_sweep

    if None not in (pitch, rpm, thrust):
        raise InputError("rotor forward", "", "has all of --pitch, --rpm and --thrust", "give two; the third is found")
    r, air = load_rotor(rotor), Air(density_kg_m3=density)
    blading = polars.prepare_blading(r)
    theta = math.radians(pitch) if pitch is not None else None
    omega = rpm * RPM if rpm is not None else None
    note = ""
    if sum(v is not None for v in (pitch, rpm, thrust)) < 2:
        theta, omega, thrust, note = _complete_hover_condition(r, theta, omega, thrust)
    if thrust is not None:
        found = solve_for_thrust(blading, thrust_N=thrust, pitch_rad=theta, speed_rad_s=omega, air=air)
        theta, omega = found.pitch_rad, found.speed_rad_s
    assert theta is not None
    assert omega is not None
    lean = math.radians(tilt)
    conditions = [ForwardCondition(theta, omega, v * math.cos(lean), v * math.sin(lean), air=air) for v in speed]
    mass = None if blade_mass is None else 1e-3 * blade_mass
    if flap_frequency_ratio is None:
        band, basis = estimate_flap_mode_range(r, omega, pitch_rad=theta, mass_kg=mass)
        flaps = list(band)
    else:
        flaps = [make_flap_mode(r, ratio, mass_kg=mass) for ratio in flap_frequency_ratio]
        basis = "flap frequency as given"
    basis = "; ".join(filter(None, [basis, note]))
    sweep = sweep_forward(blading, conditions, flaps, flap_basis=basis, cyclic_rad=math.radians(cyclic))
    files = []
    if out is not None:
        files = [
            save_figure(draw_forward_sweep(sweep), out, "forward"),
            save_figure(draw_disc_fields(sweep.points[-1][-1]), out, "disc"),
        ]
    print_answer(as_json, sweep, None, files)


def _complete_hover_condition(
    rotor: Rotor, pitch_rad: float | None, speed_rad_s: float | None, thrust_N: float | None
) -> tuple[float | None, float | None, float | None, str]:
    """Return pitch, speed and thrust with defaults (pitch or thrust may stay None), and a note on the defaults."""
    from mufly.dynamics import find_trim
    from mufly.vehicle import load_vehicle

    vehicle = load_vehicle("mufly-1.1")
    if abs(rotor.radius_m / float(vehicle.rotors.radius) - 1.0) < 0.01:
        hover = find_trim(vehicle)
        origin = "of the upper rotor of mufly-1.1 in hover"
        speed, thrust = float(hover.rotor_speed[0]), float(hover.thrust_N[0])
    else:
        origin, speed, thrust = "by default", _DEFAULT_TIP_SPEED_M_S / rotor.radius_m, None
    used = []
    if speed_rad_s is None:
        speed_rad_s = speed
        used.append(f"speed {origin}")
    if pitch_rad is None and thrust_N is None:
        if thrust is None:
            pitch_rad = _DEFAULT_PITCH_RAD
            used.append("pitch by default")
        else:
            thrust_N = thrust
            used.append(f"thrust {origin}")
    return pitch_rad, speed_rad_s, thrust_N, ", ".join(used)
