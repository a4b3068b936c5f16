"""``mufly rotor measure``: a rotor file from caliper and protractor readings."""

from __future__ import annotations

import math
import sys
from pathlib import Path
from typing import Annotated, Any

import typer

from mufly.cli.options import JsonOption, OptionRange, define_argument, define_option
from mufly.cli.output import print_answer, print_files, print_lines, write_text_file
from mufly.cli.rotor import app as rotor_commands
from mufly.errors import InputError

_DIAMETER_RANGE = OptionRange(1e-2, 10.0, "m", "no small rotor has such a diameter; write 127 mm as 127mm")
_PITCH_RANGE = OptionRange(1e-3, 10.0, "m", "no propeller has such a pitch; write 3 inches as 3in")
_HEIGHT_RANGE = OptionRange(-0.5, 0.5, "m", "no small blade has such a height; write 2.1 mm as 2.1mm")


@rotor_commands.command()
def measure(
    readings: Annotated[
        Path | None,
        define_argument(
            "[CSV]",
            "Readings: r_mm, chord_mm, angle_deg, optional thickness_mm; several rows of one radius are "
            "averaged. Default: prompt for readings.",
        ),
    ] = None,
    diameter: Annotated[
        float | None,
        define_option("--diameter", "Diameter of the rotor, as 5in or 127mm.", unit="m", within=_DIAMETER_RANGE),
    ] = None,
    blades: Annotated[int, define_option("N", "Number of blades.", min=1, max=20)] = 2,
    tip_height: Annotated[
        float | None,
        define_option(
            "--tip-height",
            "Height of the leading edge above the trailing edge at the last station, as 2.1mm, by caliper.",
            unit="m",
            within=_HEIGHT_RANGE,
        ),
    ] = None,
    stated_pitch: Annotated[
        float | None,
        define_option(
            "--stated-pitch",
            "Nominal pitch of the propeller, as 3in.",
            unit="m",
            within=_PITCH_RANGE,
        ),
    ] = None,
    airfoil: Annotated[str, define_option("NAME", "Airfoil of the blade.")] = "naca4412",
    chord_std: Annotated[
        float, define_option("--chord-std", "Standard deviation of a chord.", unit="mm", min=0.01, max=5.0)
    ] = 0.2,
    angle_std: Annotated[
        float, define_option("--angle-std", "Standard deviation of an angle.", unit="deg", min=0.05, max=10.0)
    ] = 1.0,
    template: Annotated[
        Path | None, define_option("--template CSV", "Write an empty table with the steps of the measurement.")
    ] = None,
    name: Annotated[str | None, define_option("NAME", "Name of the rotor. Default: the file's.")] = None,
    out: Annotated[Path | None, define_option("--out FILE.toml", "Rotor file to write.")] = None,
    as_json: JsonOption = False,
) -> None:
    """Make a rotor file from caliper and protractor readings, with their uncertainty.

    --template writes the table to fill in; without a table the stations are asked for at the terminal. The file holds
    the standard deviation of the angles, which 'rotor hover --band' and 'rotor fit' use.
    Examples: mufly rotor measure --diameter 5in --template readings.csv; mufly rotor measure readings.csv
    --diameter 5in --tip-height 2.1mm --stated-pitch 3in --out mine.toml
    """
    from mufly.rotor import format_rotor_toml
    from mufly.rotor.blades.blade_files import read_caliper_readings
    from mufly.rotor.blades.measured_geometry import GeometryReadings, make_blank_reading_table, rotor_from_readings

    if diameter is None:
        raise InputError("--diameter", "", "is missing", "give twice the radius of the tips, for example 5in")
    if out is not None and out.suffix != ".toml":
        raise InputError("--out", str(out), "does not end in .toml", "give a name that ends in .toml")
    radius = 0.5 * diameter
    if template is not None:
        write_text_file(template, make_blank_reading_table(radius, stated_pitch), option="--template")
        return print_files([template])
    if readings is not None:
        r, chord, angle, thickness = read_caliper_readings(readings)
    elif out is None and not as_json:
        raise InputError(
            "--out", "", "is missing: your answers would be lost", "give a file, for example --out mine.toml"
        )
    else:
        r, chord, angle, thickness, tip_height = _ask_readings(radius, tip_height)
    found = rotor_from_readings(
        GeometryReadings(r, chord, angle, tip_height, thickness), radius_m=radius, blades=blades, airfoil=airfoil,
        name=name or (out or readings or Path("measured")).stem, stated_pitch_m=stated_pitch,
        chord_std_m=1e-3 * chord_std, angle_std_rad=math.radians(angle_std),
    )  # fmt: skip
    files = [] if out is None else [write_text_file(out, format_rotor_toml(found.rotor))]
    print_answer(as_json, found, files=files)
    if out is None and not as_json:
        print_lines("Nothing written; add --out FILE.toml")


def _ask_readings(radius_m: float, tip_leading_edge_rise_m: float | None) -> tuple[Any, Any, Any, Any, float | None]:
    """Ask for chord, angle and thickness at the recommended stations, and for the tip height unless it is given."""
    import numpy as np

    from mufly.quantities.quantity_grammar import parse_quantity
    from mufly.rotor.blades.measured_geometry import MEASUREMENT_INSTRUCTIONS, STATION_RATIOS
    from mufly.rotor.sections.airfoil import MAX_THICKNESS_RATIO

    if not sys.stdin.isatty():
        raise InputError("CSV", "", "is missing", "give a table of readings; --template writes an empty one")

    def ask_for_value(question: str, what: str, unit: str, low: float, high: float, optional: bool = False) -> float:
        """Ask until the answer is a number within the limits; nan for Enter at an optional question."""

        def parse_answer(text: str) -> float:
            if optional and not text.strip():
                return math.nan
            try:
                value = parse_quantity(what, text, unit)
            except InputError as error:
                raise typer.BadParameter(str(error)) from None
            if not low < value < high:
                raise typer.BadParameter(f"{text} is out of range; give a value between {low:g} and {high:g} {unit}")
            return value

        hint = " (Enter: not measured)" if optional else ""
        default = "" if optional else None
        return float(
            typer.prompt(
                f"{question}: {what} ({unit}){hint}", default=default, show_default=False, value_proc=parse_answer
            )
        )

    for text in MEASUREMENT_INSTRUCTIONS:
        typer.echo(text)
    rows = []
    for ratio in STATION_RATIOS:
        at = 1e3 * ratio * radius_m
        question = f"r = {at:.1f} mm"
        chord = ask_for_value(question, "chord", "mm", 0.0, 1e3 * radius_m)
        angle = ask_for_value(question, "angle", "deg", -60.0, 80.0)
        thickness = ask_for_value(question, "thickness", "mm", 0.0, MAX_THICKNESS_RATIO * chord, optional=True)
        rows.append((1e-3 * at, 1e-3 * chord, math.radians(angle), thickness / chord))
    r, chords, angles, ratios = np.array(rows).T
    if tip_leading_edge_rise_m is None:
        most = 1e3 * chords[-1]
        tip_leading_edge_rise_m = 1e-3 * ask_for_value(
            "last station", "height of leading less trailing edge", "mm", -most, most, optional=True
        )
    return r, chords, angles, ratios, None if math.isnan(tip_leading_edge_rise_m) else tip_leading_edge_rise_m
