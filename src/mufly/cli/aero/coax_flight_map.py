"""``mufly coax flight-map``: loads of a vehicle's rotors in edgewise flow, for its flight model."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from mufly.cli.coax import app
from mufly.cli.options import JsonOption, OptionRange, VehicleArgument, define_option
from mufly.cli.output import print_answer, progress_bar, save_figure
from mufly.errors import InputError

if TYPE_CHECKING:
    pass


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
    from mufly.files.answer_store import replace_file_atomically
    from mufly.rotor import load_rotor
    from mufly.rotor.forward.edgewise_map import FlightMapSummary, evaluate_flight_map
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
        with replace_file_atomically(out) as part:
            part.write_text(format_flight_map_toml(made), encoding="utf-8")
        files = [out, save_figure(draw_flight_map(made, loads), out.parent, out.stem)]
    print_answer(as_json, FlightMapSummary(made, loads), files=files)
