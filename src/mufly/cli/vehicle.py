"""``mufly vehicle``: list, show, check and create vehicles."""

from __future__ import annotations

import sys
from itertools import groupby
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from mufly.cli.options import (
    GEAR_RATIO_RANGE,
    AirspeedsOption,
    CommandGroup,
    JsonOption,
    OptionRange,
    OutOption,
    VehicleArgument,
    default_text,
    define_argument,
    define_option,
)
from mufly.cli.output import (
    check_output_place,
    make_console,
    print_answer,
    print_blocks,
    print_json,
    print_lines,
    print_result_table,
    print_table,
    save_figure,
    write_text_file,
)
from mufly.errors import InputError
from mufly.quantities.quantity_grammar import parse_quantity
from mufly.quantities.units import RPM, unit_conversion
from mufly.results import ResultColumn, select_fields

if TYPE_CHECKING:
    from mufly.dynamics import HoverPerformance
    from mufly.vehicle import Parameter, Vehicle

app = CommandGroup(
    help="List, show, check and export vehicles. Keys of a vehicle file: docs/reference/vehicles.md.",
    no_args_is_help=True,
)

# SI unit -> unit for reading.
_READABLE_UNITS = {
    "kg": "g", "m": "mm", "m2": "cm2", "kg m2": "g cm2", "rad": "deg", "A s": "mA h", "V s": "mV s",
    "N m/A": "mN m/A",
}  # fmt: skip
_MASS_BUDGET_TABLE_NAME = "mass_budget"

_TomlOption = Annotated[
    bool, define_option("--toml", "Print the whole file, in SI units, as a start for a vehicle of your own.")
]


@app.command("list")
def list_vehicles(as_json: JsonOption = False) -> None:
    """List the built-in vehicles."""
    from mufly.dynamics import hover_performance
    from mufly.vehicle import list_builtin_vehicles, load_vehicle

    vehicles = [load_vehicle(name) for name in list_builtin_vehicles()]
    hovers = [hover_performance(v) for v in vehicles]
    rows = [
        {
            "name": v.name,
            "description": v.description,
            "mass_kg": float(v.body.mass),
            "rotor_diameter_m": 2 * float(v.rotors.radius),
            "hover_motor_input": h.motor_input,
        }
        for v, h in zip(vehicles, hovers, strict=True)
    ]
    if as_json:
        return print_json(rows)
    columns = (
        "name", "description", ResultColumn("mass_kg", "g", ".0f"), ResultColumn("rotor_diameter_m", "mm", ".0f"),
        ResultColumn("hover_motor_input", form=".2f", head="hover inputs\nupper, lower"),
    )  # fmt: skip
    print_result_table(rows, columns)
    print_lines("Hover inputs with the battery half full.", style="dim")


@app.command()
def show(vehicle: VehicleArgument = "mufly-1.1", as_json: JsonOption = False, toml: _TomlOption = False) -> None:
    """Show every parameter: symbol, value, unit, source and meaning."""
    from mufly.vehicle import format_vehicle_toml, list_parameters, load_vehicle

    v = load_vehicle(vehicle)
    if toml:
        print(format_vehicle_toml(v), end="")
        return
    rows = list_parameters(v)
    if as_json:
        return print_json(
            {
                **select_fields(v, "name description battery_model=battery.model range_ring_count=range_ring.count"),
                "coefficient_map": v.rotors.coefficient_map and v.rotors.coefficient_map.model_dump(exclude={"table"}),
                "map_level": v.rotors.map_level,
                "parameters": [row._asdict() for row in rows],
            }
        )
    make_console().print(f"[bold]{v.name}[/bold]  {v.description}", highlight=False)
    for group, members in groupby(rows, lambda row: row.key.rpartition(".")[0]):
        if group == _MASS_BUDGET_TABLE_NAME:
            _print_mass_budget(list(members), float(v.body.mass))
        elif not group.startswith("sensors."):
            print_parameter_group(group, list(members))
    if v.sensors is not None:
        print_lines(f"\nSensors: mufly sensors show {vehicle}")
    print_lines(
        f"\nbattery.model = {v.battery.model!r}, range_ring.count = {v.range_ring.count}, "
        f"stabiliser_bar.fitted = {str(v.stabiliser_bar.fitted).lower()}",
        _describe_coefficients(v),
    )


@app.command()
def check(vehicle: VehicleArgument, as_json: JsonOption = False) -> None:
    """Check every value of a vehicle file, and whether the vehicle can hover and for how long."""
    from mufly.dynamics import (
        DEFAULT_STEP_S,
        find_longest_stable_step,
        find_step_limiting_parameter,
        hover_performance,
        judge_hover,
        model_parameters,
    )
    from mufly.sensors.sonar import standing_sonar_range
    from mufly.vehicle import find_unusual_parameters, load_vehicle

    v = load_vehicle(vehicle)
    try:
        h = hover_performance(v)
    except InputError as error:
        raise error.with_location(vehicle) from None
    limits = list(judge_hover(v, h))
    unusual = [*find_unusual_parameters(v), *limits]
    p = model_parameters(v)
    step = find_longest_stable_step(p)
    if as_json:
        return print_json(
            {"name": v.name, "valid": True, "hover": h, "longest_step_s": step, "warnings": list(map(str, unusual))}
        )
    _print_hover(v, h, is_credible=not limits)
    if v.sensors is not None and v.sensors.sonar is not None:
        least, stands = float(v.sensors.sonar.min_range), standing_sonar_range(v)
        if stands > least:
            print_lines(
                f"The sonar is {stands:.3g} m above the floor on the ground, more than its least range, "
                f"{least:g} m: "
                "it measures the height from lift-off on.",
                style="dim",
            )
    for one in unusual:
        print_lines(f"{vehicle}: {one}", style="yellow")
    if h.thrust_to_weight_half < 1.15:
        print_lines("The thrust reserve for climb and gusts is small.", style="yellow")
    if step < DEFAULT_STEP_S:
        print_lines(
            f"The fastest mode ({find_step_limiting_parameter(p)}) needs steps below {step * 1e3:.2g} ms: too fast for "
            f"a simulation at the usual {DEFAULT_STEP_S * 1e3:g} ms.",
            style="yellow",
        )


@app.command("speed")
def show_speed(
    vehicle: VehicleArgument = "mufly-1.1",
    speed: AirspeedsOption = default_text("0:6:0.5"),
    rotor: Annotated[
        str,
        define_option("--rotor NAME|FILE", "Blades of both rotors: built-in rotor or rotor file of the same radius."),
    ] = "walkera-5g6",
    out: OutOption = None,
    as_json: JsonOption = False,
) -> None:
    """Compute level flight over airspeed: power, tilt, servo inputs, thrust margin, greatest and best speed.

    The flap frequency of the blades is uncertain (`mufly rotor beam`): both ends of its band are computed, and the
    speeds are given as ranges. With --out, a picture is drawn (speed.png). Method: docs/explanation/forward-flight.md.
    Example: mufly vehicle speed mufly-1.1 --speed 0:4:0.5 --out speed
    """
    from mufly.dynamics.level_flight import compute_level_flight, draw_level_flight
    from mufly.rotor import load_rotor
    from mufly.vehicle import load_vehicle

    flight = compute_level_flight(load_vehicle(vehicle), load_rotor(rotor), speed)
    files = [save_figure(draw_level_flight(flight), out, "speed")] if out is not None else []
    print_answer(as_json, flight, None, files)


def _describe_coefficients(v: Vehicle) -> str:
    """Return a sentence on the thrust and torque coefficients used in flight."""
    m = v.rotors.coefficient_map
    if m is None:
        return "In flight cT and cQ are constant (rotors.coefficient_map can name a map; docs/explanation/coax.md)."
    level = {
        "computed": "as computed: the constants cT and cQ above are not used",
        "constants": "scaled to the constants cT and cQ above at hover",
    }[v.rotors.map_level]
    shape = m.decode_map_tables().grid_shape
    return (
        f"In flight cT and cQ come from coefficient map {m.name!r} ({m.description}; {shape[0]} mean "
        f"speeds, {shape[1]} ratios, {shape[2]} climbs), {level}."
    )


def _print_hover(v: Vehicle, h: HoverPerformance, is_credible: bool) -> None:
    words = "is valid and hovers" if is_credible else "is valid but hovers beyond usual limits (below)"
    print_lines(f" {words}. In hover with the battery half full:", head=v.name)
    print_blocks(*h.make_printed_blocks())


def print_parameter_group(group: str, rows: list[Parameter]) -> None:
    lines = [
        (row.key.rpartition(".")[2], row.symbol, *_to_readable(row.value, row.unit), row.source,
         row.description + (f" ({row.note})" if row.note else ""))
        for row in rows
    ]  # fmt: skip
    heads = ("key", "symbol", "value", "unit", "source", "meaning")
    print_table(heads, lines, title=f"\n\\[{group}]", text=(0, 1, 3, 4, 5))


def _print_mass_budget(rows: list[Parameter], mass: float) -> None:
    from rich.bar import Bar
    from rich.table import Table

    table = Table(
        title=f"\n\\[{_MASS_BUDGET_TABLE_NAME}]", title_justify="left", title_style="bold", box=None, show_header=False
    )
    for row in rows:
        share = row.value / mass
        table.add_row(
            row.key.rpartition(".")[2],
            f"{row.value * 1e3:.1f} g",
            f"{share:.0%}",
            Bar(size=0.4, begin=0, end=share, width=30),
            row.source,
        )
    table.add_row("total", f"{sum(r.value for r in rows) * 1e3:.1f} g", style="bold")
    make_console().print(table)


def _to_readable(value: Any, unit: str) -> tuple[str, str]:
    name = _READABLE_UNITS.get(unit, unit)
    factor = unit_conversion(unit, name)[1] if name != unit else 1.0

    def format_number(v: Any) -> str:
        if isinstance(v, tuple):
            brackets = "()" if v and not isinstance(v[0], tuple) else "  "
            return (brackets[0] + ", ".join(format_number(x) for x in v) + brackets[1]).strip()
        return f"{v * factor:.5g}"

    return format_number(value), "" if name == "1" else name


NEW_HELP = """Create a helicopter of your own: write vehicle, rotor and mission files that fly.

Give mass and rotor radius, and known data of motor and battery. At a terminal the command asks for missing ones; an \
empty answer leaves a value to be estimated from mufly-1.1 by similarity. The files mark estimates, each with \
its rule; replace them by measured values.

Example: mufly new my-helicopter --mass 120 --radius 90 --kv 1800 --resistance 0.3 --cells 2"""

_MASS_RANGE = OptionRange(1.0, 1e4, "g", "outside the range of similarity with the known vehicle (95 g)")
_RADIUS_RANGE = OptionRange(10.0, 1000.0, "mm", "outside the range of similarity with the known vehicle (87.5 mm)")
_SPEED_CONSTANT_RANGE = OptionRange(10.0, 1e5, "rpm/V", "no small motor has such a value")
_RESISTANCE_RANGE = OptionRange(1e-3, 1e3, "ohm", "no small motor has such a value")
_CURRENT_RANGE = OptionRange(1e-3, 100.0, "A", "no motor of this size has such a current")
_CELL_COUNT_RANGE = OptionRange(1, 24, "", "packs have 1 to 24 cells in series")
_CAPACITY_RANGE = OptionRange(1.0, 1e5, "mA h", "no battery of such a vehicle has this capacity")


def create_vehicle_project(
    name: Annotated[str, define_argument("NAME", "Name of the vehicle and of the folder to create.")],
    mass: Annotated[float | None, define_option("--mass", "Take-off mass.", unit="g", within=_MASS_RANGE)] = None,
    radius: Annotated[
        float | None, define_option("--radius", "Radius of both rotors.", unit="mm", within=_RADIUS_RANGE)
    ] = None,
    kv: Annotated[
        float | None,
        define_option(
            "--kv", "Speed constant of a motor. Default: estimated.", unit="rpm/V", within=_SPEED_CONSTANT_RANGE
        ),
    ] = None,
    resistance: Annotated[
        float | None,
        define_option(
            "--resistance",
            "Resistance of a motor with its controller. Default: estimated.",
            unit="ohm",
            within=_RESISTANCE_RANGE,
        ),
    ] = None,
    no_load_current: Annotated[
        float | None,
        define_option(
            "--no-load-current",
            "No-load current of a motor at the nominal voltage. Default: estimated.",
            unit="A",
            within=_CURRENT_RANGE,
        ),
    ] = None,
    gear: Annotated[
        float | None,
        define_option(
            "--gear",
            "Gear ratio, motor speed over rotor speed; 1 is direct drive. Default: estimated.",
            unit="",
            within=GEAR_RATIO_RANGE,
        ),
    ] = None,
    cells: Annotated[
        int | None,
        define_option(
            "--cells",
            "Number of battery cells in series. Default: estimated.",
            unit="",
            form="count",
            within=_CELL_COUNT_RANGE,
        ),
    ] = None,
    capacity: Annotated[
        float | None,
        define_option(
            "--capacity", "Capacity of the battery. Default: estimated.", unit="mA h", within=_CAPACITY_RANGE
        ),
    ] = None,
    no_bar: Annotated[
        bool,
        define_option(
            "--no-bar",
            "Omit the stabiliser bar: the vehicle is unstable without control, and the servos alone steer it.",
        ),
    ] = False,
    out: Annotated[Path | None, define_option("--out DIR", "Folder for the files. Default: NAME.")] = None,
) -> None:
    """See :data:`NEW_HELP`."""
    from mufly.dynamics import hover_performance, judge_hover, scale_vehicle_by_similarity
    from mufly.mission import format_mission_toml, load_mission
    from mufly.rotor import format_rotor_toml, load_rotor, replace_rotor
    from mufly.vehicle import find_unusual_parameters, format_vehicle_toml, list_parameters, load_vehicle

    folder = Path(name) if out is None else out
    known, blade = load_vehicle("mufly-1.1"), load_rotor("walkera-5g6")
    files = {part: folder / f"{part}.toml" for part in ("vehicle", "rotor", "mission")}
    for file in files.values():
        if file.exists():
            raise InputError(str(file), "", "already exists", "give another NAME, or --out")
    mass = _ask_if_missing(mass, "--mass", "Take-off mass in g", _MASS_RANGE, needed=True)
    radius = _ask_if_missing(radius, "--radius", "Rotor radius in mm", _RADIUS_RANGE, needed=True)
    assert mass is not None  # needed
    assert radius is not None
    if kv is None and resistance is None:
        kv = _ask_if_missing(kv, "--kv", "Motor: KV in rpm/V", _SPEED_CONSTANT_RANGE)
        if kv is not None:
            resistance = _ask_if_missing(resistance, "--resistance", "Motor: resistance in ohm", _RESISTANCE_RANGE)
    given_cells = _ask_if_missing(cells, "--cells", "Battery: cells in series", _CELL_COUNT_RANGE)
    capacity = _ask_if_missing(capacity, "--capacity", "Battery: capacity in mA h", _CAPACITY_RANGE)
    vehicle = scale_vehicle_by_similarity(
        known, Path(name).name,
        mass_kg=mass / 1e3,
        radius_m=radius / 1e3,
        speed_constant_rad_Vs=None if kv is None else kv * RPM,
        resistance_ohm=resistance,
        no_load_current_A=no_load_current,
        gear_ratio=gear,
        cells=None if given_cells is None else int(given_cells),
        capacity_As=None if capacity is None else capacity * 3.6,
        bar=not no_bar,
    )  # fmt: skip
    scale = radius / 1e3 / float(blade.radius)
    chord = [c * scale for c in blade.blade.chord.value]
    shape = {
        "name": f"{vehicle.name}-rotor",
        "description": f"guess: blades of {blade.name}'s shape, R {radius:g} mm",
        "radius": radius / 1e3,
        "blade.chord": chord,
    }
    rotor = replace_rotor(blade, shape, source="estimated")
    check_output_place("--out", folder)
    texts = {
        "vehicle": format_vehicle_toml(vehicle),
        "rotor": format_rotor_toml(rotor),
        "mission": format_mission_toml(load_mission("demonstration")),
    }
    for part, file in files.items():
        write_text_file(file, texts[part])
    hover = hover_performance(vehicle)
    limits = list(judge_hover(vehicle, hover))
    _print_hover(vehicle, hover, is_credible=not limits)
    for one in (*find_unusual_parameters(vehicle), *limits):
        print_lines(f"{files['vehicle']}: {one}", style="yellow")
    guesses = sum(row.note.startswith("guess:") for row in list_parameters(vehicle))
    place = f"gear {float(vehicle.gear.ratio):.3g}, battery {float(vehicle.battery.capacity) / 3.6:.0f} mA h"
    print_lines(
        f"  {place}",
        f"\n{guesses} of its {len(list_parameters(vehicle))} values are guesses, each with its rule in the file:",
        f"  {files['vehicle']}    replace guesses by measured values",
        f"  {files['rotor']}      blades of mufly-1.1's shape",
        f"  {files['mission']}    a square; change it",
        "\nNext:",
        f"  mufly fly {files['mission']} --vehicle {files['vehicle']}",
        f"  mufly vehicle show {files['vehicle']}",
        f"  mufly rotor hover {files['rotor']} --pitch 12 --rpm {_mean_hover_rotor_speed_rpm(vehicle):.0f}",
    )


def _mean_hover_rotor_speed_rpm(vehicle: Vehicle) -> float:
    """Return the mean rotor speed in hover (rpm)."""
    from mufly.dynamics import compute_hover_rotor_speeds, model_parameters

    return float(compute_hover_rotor_speeds(model_parameters(vehicle)).mean()) / RPM


def _ask_if_missing(
    value: float | None, name: str, question: str, limits: OptionRange, needed: bool = False
) -> float | None:
    """Return an option's value, or ask for it at a terminal; None means that the value is to be estimated."""
    if value is not None:
        return value
    if not sys.stdin.isatty():
        if needed:
            raise InputError(name, "", "is missing", "`mufly new --help` has an example")
        return None
    while True:
        text = str(
            typer.prompt(question if needed else f"{question} (Enter: estimate)", default="", show_default=False)
        )
        if not text.strip() and not needed:
            return None
        try:
            number = parse_quantity(name, text, limits.unit)
            limits.check_value(name, number)
            return number
        except InputError as error:
            print_lines(f"{error.problem}; {error.remedy}", style="yellow")
