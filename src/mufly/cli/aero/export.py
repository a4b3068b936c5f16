"""``mufly rotor export``: blades as bodies to print or to draw with, and stations as a table."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Annotated

from mufly.cli.options import PITCH_RANGE, JsonOption, RotorArgument, define_argument, define_option
from mufly.cli.output import make_console, print_files, print_json, write_csv
from mufly.errors import report_write_errors

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
    import numpy as np

    from mufly.errors import InputError, MuflyError
    from mufly.rotor import load_rotor
    from mufly.rotor.blades import blade_solid as bodies

    r, kind = load_rotor(rotor), out.suffix.lower()
    if kind not in _ALLOWED_FILE_ENDINGS:
        raise InputError("FILE", str(out), "has an unknown ending", f"use one of: {', '.join(_ALLOWED_FILE_ENDINGS)}")
    if not hub < 1e3 * r.radius_m:
        raise InputError("--hub", f"{hub:g} mm", f"is not inside a rotor of {1e3 * r.radius_m:g} mm", "give less")
    if hub > 0.0 and not bore < hub:
        raise InputError("--bore", f"{bore:g} mm", f"does not fit in a hub of {hub:g} mm", "give less")
    if hub > 0.0 and not whole:
        raise InputError("--hub", "", "belongs to a whole rotor", "add --whole")
    if kind == ".csv":
        x = np.linspace(float(r.hub_cutout), 1.0, stations)
        cut = r.sections_at(x)
        rows = [
            [1e3 * x[k] * r.radius_m, 1e3 * cut.chord_m[k], math.degrees(cut.twist_rad[k]) + pitch,
             cut.airfoil_names[cut.first_airfoil[k] if cut.second_weight[k] < 0.5 else cut.second_airfoil[k]]]
            for k in range(x.size)
        ]  # fmt: skip
        write_csv(out, ("r_mm", "chord_mm", "beta_deg", "airfoil"), rows)
        told = {"file": str(out), "stations": stations}
    else:
        sections = bodies.blade_contours(r, along=stations, tail_m=1e-3 * tail, pitch_rad=math.radians(pitch))
        blade = bodies.loft_solid(sections)
        parts = [blade]
        if whole:
            parts = [bodies.rotate_about_shaft(blade, 2.0 * math.pi * k / r.blades) for k in range(r.blades)]
        if hub > 0.0:
            low, high = (float(f(sections[0, :, 2])) for f in (np.min, np.max))
            parts.append(bodies.make_hub_solid(1e-3 * hub, 1e-3 * bore, low, high))
        parts = [bodies.mirror_solid(p) for p in parts] if clockwise else parts
        body = bodies.join_solids(parts)
        if kind == ".stl":
            if body.count_open_edges():
                raise MuflyError(
                    f"{r.name}: {body.count_open_edges()} edges of the surface are open; give fewer stations"
                )
            with report_write_errors("--out", key=str(out)):
                bodies.write_stl(out, body, r.name)
        else:
            if whole:
                raise InputError(
                    "--whole",
                    "",
                    "is for STL only: a STEP file contains one blade",
                    "leave out --whole; copy the blade in a CAD program",
                )
            with report_write_errors("--out", key=str(out)):
                bodies.write_step(out, sections * ([1.0, -1.0, 1.0] if clockwise else [1.0, 1.0, 1.0]))
        told = {
            "file": str(out), "triangles": len(body.triangles), "volume_mm3": 1e9 * body.volume_m3,
            "area_mm2": 1e6 * body.area_m2, "open_edges": body.count_open_edges(),
        }  # fmt: skip
    if as_json:
        return print_json(told)
    c = make_console()
    if kind != ".csv":
        c.print(
            f"{r.name}: {told['volume_mm3']:.0f} mm3, {told['area_mm2']:.0f} mm2, closed"
            + ("; bodies overlap where they meet, as slicers allow" if hub > 0.0 else ""),
            highlight=False,
        )
    print_files([out])
