"""``mufly control``: design the controllers of a vehicle, tell what they are worth, draw them."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from mufly.cli.options import CommandGroup, define_argument, define_option
from mufly.cli.output import (
    make_console,
    print_files,
    print_json,
    print_lines,
    print_table,
    report_place_errors,
)
from mufly.errors import InputError

if TYPE_CHECKING:
    from mufly.control import ControllerDesign, FlightController

app = CommandGroup(help="Design and analyse the controllers of a vehicle.", no_args_is_help=True)


@app.callback()
def _accept_group_options() -> None:
    pass


@app.command()
def design(
    vehicle: Annotated[
        str, define_argument("NAME|FILE", "A built-in vehicle, or a vehicle file (TOML).")
    ] = "mufly-1.1",
    rate: Annotated[
        float | None,
        define_option("--rate", "Rate of the control law; 200 Hz if not given. Position runs at a quarter.", unit="Hz"),
    ] = None,
    voltage: Annotated[
        float | None,
        define_option(
            "--voltage",
            "Battery voltage of the linear model; the vehicle's nominal voltage if not given.",
            unit="V",
        ),
    ] = None,
    out: Annotated[
        Path | None,
        define_option("DIR", "Write singular value plots (PNG, as thesis Figs 6.3 to 6.8) and design.json there."),
    ] = None,
    as_json: Annotated[bool, define_option("--json", "Print JSON and nothing else.")] = False,
) -> None:
    """Design heave-yaw, roll-pitch and position control, and set them beside the thesis's.

    For each H-infinity design: the level gamma claimed and the norm of the closed loop as computed from it; \
0 dB crossings of the loop gain; peaks of the sensitivity S_u and the complementary sensitivity T_u at the plant's \
input, with the controller of full order, of reduced order, and sampled with one sample of delay; margins.

    Examples:

      mufly control design

      mufly control design mufly-2.0 --rate 250 --out designs
    """
    from mufly.control import design_flight_controller as design_controllers
    from mufly.vehicle import load_vehicle

    loaded = load_vehicle(vehicle)
    try:
        controller = design_controllers(loaded, rate_Hz=rate, voltage=voltage)
    except InputError as error:
        if error.where != loaded.name:
            raise
        raise error.with_location(vehicle) from None
    written = _write_designs(controller, out) if out is not None else []
    if as_json:
        return print_json(controller.to_dict())
    make_console().print(
        f"[bold]{controller.vehicle_name}[/bold] at {controller.voltage_V:g} V: hover motor inputs "
        f"{controller.motor_trim[0]:.2f} upper, {controller.motor_trim[1]:.2f} lower; "
        f"law at {controller.rate_Hz:g} Hz, position at {controller.rate_Hz / controller.position_divider:g} Hz",
        highlight=False,
    )
    for one in controller.all_designs:
        _print_design(one)
    print_lines("* with one sample of delay", style="dim")
    c = controller.cascade
    print_lines(
        f"Position cascade with the real attitude loop: S {c.sensitivity_peak_dB:.2f} dB, "
        f"T {c.complementary_peak_dB:.2f} dB, phase margin {c.phase_margin_deg:.0f} deg, "
        f"delay margin {1e3 * c.delay_margin_s:.0f} ms"
    )
    print_lines(*controller.design_warnings, mark="Warning", style="yellow")
    print_files(written)


def _write_designs(controller: FlightController, folder: Path) -> list[Path]:
    from mufly.control.plots import draw_designs

    with report_place_errors(folder, "give a folder that can be written"):
        target = folder / "design.json"
        written = [*draw_designs(controller, folder), target]
        target.write_text(json.dumps(controller.to_dict(), indent=2) + "\n", encoding="utf-8")
    return written


def _format_optional(value: float | None, form: str = ".2f") -> str:
    return "-" if value is None else format(value, form)


def _print_design(one: ControllerDesign) -> None:
    thesis = one.published
    loops = (one.full_loop, one.reduced_loop, one.sampled_loop)
    orders = (one.controller.nstates, one.reduced.nstates, one.discrete.order)
    plant = ", ".join(f"{w:.3g}" for w in one.plant_crossovers)
    printed = ", ".join(f"{w:g}" for w in thesis.plant_crossovers or ()) or "-"

    def loop_row(label: str, field: str, form: str, theirs: str = "-", factor: float = 1.0) -> tuple[str, ...]:
        return (label, *(f"{factor * getattr(loop, field):{form}}" for loop in loops), theirs)

    rows = [
        ("order", *map(str, orders), _format_optional(thesis.order, "d")),
        ("gamma claimed", f"{one.gamma:.3f}", "", "", _format_optional(thesis.gamma)),
        ("norm achieved", f"{one.norm:.3f}", f"{one.reduction.chosen.norm:.3f}", "", "-"),
        ("plant's crossovers (rad/s)", plant, "", "", printed),
        ("loop's crossovers (rad/s)", *(", ".join(f"{w:.1f}" for w in loop.crossovers) for loop in loops),
         _format_optional(thesis.crossover, "g")),
        loop_row("peak of S_u (dB)", "sensitivity_peak_dB", ".2f", _format_optional(thesis.sensitivity_peak_dB)),
        loop_row("peak of T_u (dB)", "complementary_peak_dB", ".2f", _format_optional(thesis.complementary_peak_dB)),
        loop_row("gain margin (dB)", "gain_margin_dB", ".1f"),
        loop_row("phase margin (deg)", "phase_margin_deg", ".1f"),
        loop_row("delay margin (ms)", "delay_margin_s", ".0f", factor=1e3),
    ]  # fmt: skip
    heads = ("", "full order", "reduced", f"{1 / one.discrete.period_s:g} Hz*", "thesis")
    print_table(heads, rows, title=one.name)
