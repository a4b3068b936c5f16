"""``mufly coax flight-map``: loads of a vehicle's rotors in edgewise flow, for its flight model."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from mufly.cli.coax import app
from mufly.cli.options import JsonOption, OptionRange, VehicleArgument, define_option
from mufly.cli.output import make_console, print_answer, print_table, progress_bar, save_figure
from mufly.errors import InputError

if TYPE_CHECKING:
    from mufly.rotor.forward.edgewise_map import AirspeedMapLoads
    from mufly.vehicle import FlightMap


@app.command("flight-map")
def compute_flight_map(
    vehicle: VehicleArgument = "mufly-1.1",
    rotor: Annotated[
        str,
        define_option("--rotor NAME|FILE", "Blades of both rotors: built-in rotor or rotor file of the same radius."),
    ] = "walkera-5g6",
    flap_frequency_ratio: Annotated[
        float | None,
        define_option(
            "--flap-frequency-ratio",
            "Flap frequency over rotor speed (1/rev). Default: the upper end of the band of `mufly rotor beam`.",
            unit="1",
            within=OptionRange(1.0, 20.0, "", "1 is a free hinge at the shaft, and no blade is so stiff"),
        ),
    ] = None,
    out: Annotated[
        Path | None,
        define_option("FILE", "Map file (TOML) to write; a picture (PNG) of the same name is drawn beside it."),
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """Compute a vehicle's rotors over airspeed, climb and rates, as a map file for its flight model.

    A line `flight_map = "pair.toml"` in the table `rotors` of a vehicle file adds translational lift, blow-back, drag
    and rate damping to the flight model. The map holds for one flap frequency, which is seldom known: compute one for
    each end of the band. Method: docs/explanation/forward-flight.md.
    Example: mufly coax flight-map mufly-1.1 --flap-frequency-ratio 1 --out pair.toml
    """
    from mufly.dynamics.vehicle_flight_map import make_flight_map
    from mufly.files.answer_store import replace_file
    from mufly.rotor import load_rotor
    from mufly.rotor.forward.edgewise_map import evaluate_flight_map
    from mufly.rotor.forward.forward_pictures import draw_flight_map
    from mufly.vehicle import format_flight_map_toml, load_vehicle

    if out is not None and out.suffix != ".toml":
        raise InputError("--out", str(out), "does not end in .toml", "give a name that ends in .toml")
    v = load_vehicle(vehicle)
    with progress_bar("points", not as_json) as progress:
        made = make_flight_map(
            v, load_rotor(rotor), flap_frequency_ratio=flap_frequency_ratio, name="" if out is None else out.stem,
            progress=progress,
        )  # fmt: skip
    loads = evaluate_flight_map(made)
    files = []
    if out is not None:
        with replace_file(out) as part:
            part.write_text(format_flight_map_toml(made), encoding="utf-8")
        files = [out, save_figure(draw_flight_map(made, loads), out.parent, out.stem)]
    content: dict[str, Any] = {
        **made.model_dump(exclude={"table"}),
        **made.decode_map_tables()._asdict(),
        "at_mean_ratio_without_climb": loads._asdict(),
    }
    print_answer(as_json, content, lambda: _print_rotor_map(made, loads), files)


def _print_rotor_map(made: FlightMap, loads: AirspeedMapLoads) -> None:
    c = make_console()
    tables = made.decode_map_tables()
    shape = tables.loads.shape
    edge, sink, climb = made.velocity_range_m_s
    c.print(f"[bold]{made.name}[/bold]  {made.description}", highlight=False)
    c.print(
        f"{shape[0]} speed ratios, {shape[1]} climbs, {shape[2]} advance ratios: to {edge:.1f} m/s across, "
        f"{sink:.1f} m/s sink, {climb:.1f} m/s climb; below: no climb, rotor speeds of hover",
        highlight=False,
    )
    rows = zip(
        loads.airspeed_m_s, *(100.0 * f for f in loads.thrust_excess.T), *(100.0 * f for f in loads.torque_excess.T),
        1e3 * loads.drag_N.sum(axis=1), 1e3 * loads.side_N.sum(axis=1), 1e3 * loads.roll_moment_Nm.sum(axis=1),
        1e3 * loads.pitch_moment_Nm.sum(axis=1), strict=True,
    )  # fmt: skip
    print_table(
        ("V (m/s)", "T upper (%)", "T lower (%)", "Q upper (%)", "Q lower (%)", "H (mN)", "Y (mN)", "roll (mN m)",
         "pitch (mN m)"),
        [tuple(f"{v:z.2f}" if k in (0, 7, 8) else f"{v:z.1f}" for k, v in enumerate(row)) for row in rows],
        text=(),
    )  # fmt: skip
    c.print(
        f"rate damping of the hubs: {1e3 * loads.rate_damping_Nms:z.3f} mN m per rad/s; greatest level airspeed over "
        f"the band of flap frequencies: {_describe_max_level_speed_range(made)}",
        highlight=False,
    )


def _describe_max_level_speed_range(made: FlightMap) -> str:
    low, high = made.level_speed_m_s
    beyond = math.isclose(high, made.velocity_range_m_s[0], abs_tol=0.02)
    return f"{low:.1f} to {'more than ' if beyond else ''}{high:.1f} m/s"
