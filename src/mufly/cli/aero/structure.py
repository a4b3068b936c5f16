"""``mufly rotor beam``: the blade as a rotating beam."""

from __future__ import annotations

import math
from typing import Annotated

from mufly.cli.aero.elastic_hover import resolve_blade_structure
from mufly.cli.options import (
    DensityOption,
    JsonOption,
    OptionRange,
    OutOption,
    PitchOption,
    RotorArgument,
    define_option,
)
from mufly.cli.output import print_answer, print_table, save_figure, write_csv
from mufly.cli.rotor import MaterialOption, PlateOption, app
from mufly.quantities.units import RPM

_BEAM_SPEED_RANGE = OptionRange(0.0, 1e6, "rpm", "no rotor has such a speed")


@app.command("beam")
def show_beam(
    rotor: RotorArgument = "walkera-5g6",
    rpm: Annotated[
        str,
        define_option("--rpm", "Rotor speeds.", unit="rpm", form="steps", within=_BEAM_SPEED_RANGE),
    ] = "0:9000:500",
    pitch: PitchOption = 0.0,
    material: MaterialOption = None,
    thickness: PlateOption = None,
    density: DensityOption = 1.2,
    materials: Annotated[bool, define_option("--materials", "List the materials with sources, and stop.")] = False,
    out: OutOption = None,
    as_json: JsonOption = False,
) -> None:
    """Compute the natural frequencies of a blade over rotor speed: flap, lag and torsion of a rotating beam.

    The table blade.structure of a rotor file names material, thickness and root; docs/explanation/blade-structure.md
    has the equations. Values that the file leaves out widen the 90 % band of the frequencies. With --out, the Campbell
    diagram is drawn (campbell.png) and written as CSV.
    Examples: mufly rotor beam walkera-5g6 --rpm 0:9000:500; mufly rotor beam naca0012-r60-c20 --material spruce
    """
    from mufly.quantities.quantity_grammar import parse_range
    from mufly.results import to_plain_data
    from mufly.rotor import Air, load_rotor
    from mufly.rotor.structure.flap_modes import compute_campbell
    from mufly.rotor.structure.materials import MATERIALS
    from mufly.rotor.structure.structure_pictures import draw_campbell

    if materials:
        if as_json:
            return print_answer(True, [m._asdict() for m in MATERIALS.values()], None, None)
        return print_table(
            ("material", "E (GPa)", "G (GPa)", "density (kg/m3)", "source"),
            [
                (
                    m.name, f"{1e-9 * m.young_modulus_Pa:.3g} ± {100 * m.young_relative_std:.0f} %",
                    f"{1e-9 * m.shear_modulus_Pa:.3g} ± {100 * m.shear_relative_std:.0f} %",
                    f"{m.density_kg_m3:.0f} ± {100 * m.density_relative_std:.0f} %", m.source,
                )
                for m in MATERIALS.values()
            ],
            text=(0, 4),
        )  # fmt: skip
    r = load_rotor(rotor)
    speeds = [RPM * v for v in parse_range("--rpm", rpm, "rpm", 10)]
    found = compute_campbell(
        r, speeds, pitch_rad=math.radians(pitch), air=Air(density_kg_m3=density),
        structure=resolve_blade_structure(r, material, thickness),
    )  # fmt: skip
    files = []
    if out is not None:
        heads = ["speed_rpm", *(f"{name.replace(' ', '_')}_{side}_Hz" for name in found.modes
                                for side in ("value", "low", "high"))]  # fmt: skip
        hertz = 2.0 * math.pi
        rows = [
            [
                w / RPM,
                *(x[k, j] / hertz for j in range(len(found.modes))
                  for x in (found.frequency_rad_s, found.low_rad_s, found.high_rad_s)),
            ]
            for k, w in enumerate(found.speed_rad_s)
        ]  # fmt: skip
        files = [save_figure(draw_campbell(found), out, "campbell"), write_csv(out / "campbell.csv", heads, rows)]
    print_answer(as_json, to_plain_data(found) if as_json else found, None, files)
