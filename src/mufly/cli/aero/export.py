"""``mufly rotor export``: blades as bodies to print or to draw with, and stations as a table."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Annotated

from mufly.cli.options import PITCH_RANGE, JsonOption, RotorArgument, define_argument, define_option
from mufly.cli.output import print_answer, print_files, write_records

_ALLOWED_FILE_ENDINGS = (".stl", ".step", ".stp", ".csv")


def export(
    rotor: RotorArgument,
    out: Annotated[Path, define_argument("FILE", "File to write: name.stl, name.step or name.csv.")],
    pitch: Annotated[
        float, define_option("--pitch", "Pitch setting, added to the twist.", unit="deg", within=PITCH_RANGE)
    ] = 0.0,
    whole: Annotated[
        bool, define_option("--whole", "Write all blades around the shaft, instead of one along x.")
    ] = False,
    clockwise: Annotated[
        bool, define_option("--clockwise", "Mirror the blades for a rotor that turns clockwise, seen from above.")
    ] = False,
    tail: Annotated[
        float,
        define_option("--tail", "Least thickness of the trailing edge, for a printer.", unit="mm", min=0.0),
    ] = 0.0,
    hub: Annotated[
        float, define_option("--hub", "Radius of a hub, with --whole; 0: no hub.", unit="mm", min=0.0)
    ] = 0.0,
    bore: Annotated[float, define_option("--bore", "Radius of the hub's bore.", unit="mm", min=0.0)] = 0.0,
    stations: Annotated[int, define_option("N", "Number of stations along the blade.", min=4, max=1000)] = 60,
    as_json: JsonOption = False,
) -> None:
    """Write a blade as a closed body (STL in mm, STEP), or its stations as a table.

    The blade lies along x, its nose towards y, the shaft along z. STL is checked: every edge belongs to two triangles.
    STEP needs `pip install 'mufly\\[cad]'`. Examples: mufly rotor export naca0012-r60-c20 blade.stl --tail 0.4; mufly
    rotor export naca0012-r60-c20 rotor.stl --whole --hub 6 --bore 1
    """
    from mufly.errors import InputError
    from mufly.rotor import load_rotor
    from mufly.rotor.blades.blade_export import export_blade, tabulate_export_stations

    r, kind = load_rotor(rotor), out.suffix.lower()
    for conflict, key, value, problem, remedy in (
        (kind not in _ALLOWED_FILE_ENDINGS, "FILE", str(out), "has an unknown ending",
         f"use one of: {', '.join(_ALLOWED_FILE_ENDINGS)}"),
        (hub >= 1e3 * r.radius_m, "--hub", f"{hub:g} mm", f"is not inside a rotor of {1e3 * r.radius_m:g} mm",
         "give less"),
        (0.0 < hub <= bore, "--bore", f"{bore:g} mm", f"does not fit in a hub of {hub:g} mm", "give less"),
        (hub > 0.0 and not whole, "--hub", "", "belongs to a whole rotor", "add --whole"),
        (whole and kind in (".step", ".stp"), "--whole", "", "is for STL only: a STEP file contains one blade",
         "leave out --whole; copy the blade in a CAD program"),
    ):  # fmt: skip
        if conflict:
            raise InputError(key, value, problem, remedy)
    angle = math.radians(pitch)
    if kind == ".csv":
        write_records(out, tabulate_export_stations(r, stations, angle))
        answer: object = {"file": str(out), "stations": stations}
    else:
        answer = export_blade(
            r, out, pitch_rad=angle, whole=whole, clockwise=clockwise, tail_m=1e-3 * tail, hub_m=1e-3 * hub,
            bore_m=1e-3 * bore, stations=stations,
        )  # fmt: skip
    print_answer(as_json, answer, () if kind == ".csv" else None, files=None)
    if not as_json:
        print_files([out])
