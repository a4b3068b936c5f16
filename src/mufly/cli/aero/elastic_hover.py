"""``mufly rotor hover --elastic``: hover with elastic blades."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING

from mufly.cli.aero.rotor_theory_options import PolarOptions
from mufly.cli.output import print_answer, save_figure
from mufly.errors import InputError
from mufly.quantities.units import RPM

if TYPE_CHECKING:
    from mufly.rotor import Rotor
    from mufly.rotor.structure.blade_structure import BladeStructure


def resolve_blade_structure(rotor: Rotor, material: str | None, thickness: float | None) -> BladeStructure:
    """Return the blade structure of a rotor file, with the material and thickness that the options give.

    Raises
    ------
    InputError
        If neither the file nor an option names a material, or the material is unknown.
    """
    from mufly.rotor.structure.blade_structure import BladeStructure
    from mufly.rotor.structure.flap_modes import blade_structure
    from mufly.rotor.structure.materials import find_material
    from mufly.vehicle.quantity import Quantity

    if material is not None:
        find_material(material)
    if rotor.blade.structure is None and material is not None:
        base = BladeStructure(material=material)
    else:
        try:
            base = blade_structure(rotor)
        except InputError as error:
            raise InputError(error.where, error.key, error.problem, f"{error.remedy}, or give --material abs") from None
    changes: dict[str, object] = {} if material is None else {"material": material}
    if thickness is not None:
        changes["thickness"] = Quantity(value=thickness, unit="m", source="specified")
    return base.model_copy(update=changes)


def show_elastic_hover(
    name: str,
    theory: PolarOptions,
    pitch_deg: float,
    speed_rpm: float,
    *,
    climb: float,
    density: float,
    material: str | None,
    thickness: float | None,
    out: Path | None,
    as_json: bool,
) -> None:
    """Compute a rotor with elastic blades and print it beside the rigid rotor: ``mufly rotor hover --elastic``."""
    from mufly.results import to_plain_data
    from mufly.rotor import Air, load_rotor
    from mufly.rotor.structure.elastic_rotor import solve_elastic_rotor
    from mufly.rotor.structure.structure_pictures import draw_elastic_blade

    r = load_rotor(name)
    found = solve_elastic_rotor(
        r, pitch_rad=math.radians(pitch_deg), speed_rad_s=speed_rpm * RPM, climb_m_s=climb,
        air=Air(density_kg_m3=density), structure=resolve_blade_structure(r, material, thickness), n_crit=theory.n_crit,
        engine=theory.engine, corrections=theory.select_corrections(),
    )  # fmt: skip
    files = [] if out is None else [save_figure(draw_elastic_blade(found), out, "elastic")]
    content = {"rotor": r.name, "method": "bemt", "elastic_blades": to_plain_data(found)} if as_json else found
    print_answer(as_json, content, None, files)
