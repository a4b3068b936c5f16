"""``mufly vehicle``: what vehicles there are, what one is made of, and whether it can fly."""

from __future__ import annotations

import json
import math
from dataclasses import asdict
from itertools import groupby
from typing import TYPE_CHECKING, Annotated, Any

import typer

from mufly.cli.options import Commands
from mufly.errors import InputError

if TYPE_CHECKING:
    from rich.console import Console

    from mufly.dynamics import HoverPerformance
    from mufly.vehicle import Parameter, Vehicle

app = Commands(
    help="List vehicles, show what one is made of, check a vehicle file. docs/vehicles.md says how to write one.",
    no_args_is_help=True,
)

# SI unit -> the unit that people read, and how many of those one SI unit is.
_READABLE = {
    "kg": ("g", 1e3),
    "m": ("mm", 1e3),
    "m2": ("cm2", 1e4),
    "kg m2": ("g cm2", 1e7),
    "rad": ("deg", 180 / math.pi),
    "A s": ("mA h", 1 / 3.6),
    "V s": ("mV s", 1e3),
    "N m/A": ("mN m/A", 1e3),
    "1": ("", 1.0),
}
_BUDGET = "mass_budget"
_RPM = 30 / math.pi

_Vehicle = Annotated[
    str, typer.Argument(metavar="NAME|FILE", help="A built-in vehicle, or a vehicle file (TOML).")
]
_Json = Annotated[bool, typer.Option("--json", help="Print JSON, in SI units, and nothing else.")]
_Toml = Annotated[
    bool,
    typer.Option("--toml", help="Print the whole file, in SI units: a vehicle of your own starts from it."),
]


@app.command("list")
def list_vehicles(as_json: _Json = False) -> None:
    """List the built-in vehicles."""
    from mufly.dynamics import hover_performance
    from mufly.vehicle import builtin_vehicles, load_vehicle

    vehicles = [load_vehicle(name) for name in builtin_vehicles()]
    hovers = [hover_performance(v) for v in vehicles]
    if as_json:
        _print_json(
            [
                {
                    "name": v.name,
                    "description": v.description,
                    "mass_kg": float(v.body.mass),
                    "rotor_diameter_m": 2 * float(v.rotors.radius),
                    "hover_motor_input": h.motor_input,
                }
                for v, h in zip(vehicles, hovers, strict=True)
            ]
        )
        return
    from rich.table import Table

    table = Table("name", "description", box=None, header_style="bold")
    for heading in ("mass", "rotor diameter", "hover inputs\nupper, lower"):
        table.add_column(heading, justify="right")
    for v, h in zip(vehicles, hovers, strict=True):
        table.add_row(
            v.name,
            v.description,
            f"{float(v.body.mass) * 1e3:.0f} g",
            f"{2e3 * float(v.rotors.radius):.0f} mm",
            f"{h.motor_input[0]:.2f}, {h.motor_input[1]:.2f}",
        )
    _console().print(table)
    _console().print("Hover inputs with the battery half full.", style="dim")


@app.command()
def show(vehicle: _Vehicle = "mufly-1.1", as_json: _Json = False, toml: _Toml = False) -> None:
    """Show every parameter: symbol, value, unit, where it comes from, and what it means."""
    from mufly.vehicle import load_vehicle, parameters, vehicle_toml

    v = load_vehicle(vehicle)
    if toml:
        print(vehicle_toml(v), end="")
        return
    rows = parameters(v)
    if as_json:
        _print_json(
            {
                "name": v.name,
                "description": v.description,
                "battery_model": v.battery.model,
                "range_ring_count": v.range_ring.count,
                "coefficient_map": None
                if v.rotors.coefficient_map is None
                else v.rotors.coefficient_map.model_dump(exclude={"table"}),
                "map_level": v.rotors.map_level,
                "parameters": [row._asdict() for row in rows],
            }
        )
        return
    console = _console()
    console.print(f"[bold]{v.name}[/bold]  {v.description}", highlight=False)
    for group, members in groupby(rows, lambda row: row.key.rpartition(".")[0]):
        if group == _BUDGET:
            _print_budget(console, list(members), float(v.body.mass))
        else:
            _print_group(console, group, list(members))
    console.print(
        f"\nbattery.model = {v.battery.model!r}, range_ring.count = {v.range_ring.count}", highlight=False
    )
    console.print(_coefficients(v), highlight=False, soft_wrap=True)


@app.command()
def check(vehicle: _Vehicle, as_json: _Json = False) -> None:
    """Read a vehicle file, check every value, and find out whether it can hover and for how long."""
    from mufly.dynamics import DEFAULT_STEP_S, hover_performance, longest_step, model_parameters
    from mufly.vehicle import load_vehicle

    v = load_vehicle(vehicle)
    try:
        h = hover_performance(v)
    except InputError as error:
        raise error.at(vehicle) from None
    step = longest_step(model_parameters(v))
    if as_json:
        _print_json({"name": v.name, "valid": True, "hover": asdict(h), "longest_step_s": step})
        return
    console = _console()
    _print_hover(console, v, h)
    if h.thrust_to_weight_half < 1.15:
        console.print("Little thrust is left to climb or to fight gusts with.", style="yellow")
    if step < DEFAULT_STEP_S:
        console.print(
            f"Its fastest part needs steps below {step * 1e3:.2g} ms: too fast to be simulated at the usual "
            f"{DEFAULT_STEP_S * 1e3:g} ms.",
            style="yellow",
        )


def _coefficients(v: Vehicle) -> str:
    """Say which thrust and torque coefficients hold in flight."""
    m = v.rotors.coefficient_map
    if m is None:
        return "In flight cT and cQ are constant (rotors.coefficient_map can name a map; docs/coax-map.md)."
    level = {
        "computed": "as computed: the constants cT and cQ above are not used",
        "constants": "scaled to the constants cT and cQ above at hover",
    }[v.rotors.map_level]
    shape = m.tables().shape
    return (
        f"In flight cT and cQ come from coefficient map {m.name!r} ({m.description}; {shape[0]} mean "
        f"speeds, {shape[1]} ratios, {shape[2]} climbs), {level}."
    )


def _print_hover(console: Console, v: Vehicle, h: HoverPerformance) -> None:
    from rich.table import Table

    def pair(values: tuple[float, float], form: str, unit: str = "") -> str:
        return f"{values[0]:{form}} upper, {values[1]:{form}} lower{unit}"

    rpm = (h.rotor_speed_rad_s[0] * _RPM, h.rotor_speed_rad_s[1] * _RPM)
    table = Table(box=None, show_header=False)
    for name, value in (
        ("rotor speed", pair(rpm, ".0f", " rpm")),
        ("motor input", pair(h.motor_input, ".3f")),
        ("thrust", pair(h.thrust_N, ".3f", " N")),
        ("battery", f"{h.voltage_V:.2f} V, {h.current_A:.2f} A, {h.power_W:.1f} W with electronics"),
        ("endurance", f"{h.endurance_s / 60:.1f} min of hover from a full battery"),
        (
            "thrust to weight",
            f"{h.thrust_to_weight_full:.2f} at full input, {h.thrust_to_weight_half:.2f} on a half-full battery",
        ),
    ):
        table.add_row(name, value)
    console.print(
        f"[bold]{v.name}[/bold] is valid and hovers, here with the battery half full:", highlight=False
    )
    console.print(table)


def _print_group(console: Console, group: str, rows: list[Parameter]) -> None:
    from rich.table import Table

    table = Table(
        title=f"\n[{group}]".replace("[", r"\["), title_justify="left", title_style="bold", box=None
    )
    for heading in ("key", "symbol"):
        table.add_column(heading, style="cyan" if heading == "key" else "", no_wrap=True)
    table.add_column("value", justify="right")
    for heading in ("unit", "source"):
        table.add_column(heading, no_wrap=True)
    table.add_column("meaning", overflow="fold")
    for row in rows:
        value, unit = _readable(row.value, row.unit)
        meaning = row.description + (f" ({row.note})" if row.note else "")
        table.add_row(row.key.rpartition(".")[2], row.symbol, value, unit, row.source, meaning)
    console.print(table)


def _print_budget(console: Console, rows: list[Parameter], mass: float) -> None:
    from rich.bar import Bar
    from rich.table import Table

    table = Table(
        title=f"\n\\[{_BUDGET}]", title_justify="left", title_style="bold", box=None, show_header=False
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
    console.print(table)


def _readable(value: Any, unit: str) -> tuple[str, str]:
    name, factor = _READABLE.get(unit, (unit, 1.0))

    def text(v: Any) -> str:
        if isinstance(v, tuple):
            brackets = "()" if v and not isinstance(v[0], tuple) else "  "
            return (brackets[0] + ", ".join(text(x) for x in v) + brackets[1]).strip()
        return f"{v * factor:.5g}"

    return text(value), name


def _print_json(content: Any) -> None:
    typer.echo(json.dumps(content, indent=2, allow_nan=False))


def _console() -> Console:
    from rich.console import Console

    return Console()
