"""Materials of blades: moduli and density along the span, each with its standard deviation and source.

Young's modulus E acts along the span. The shear modulus G is that of torsion about the span; for moulded plastics it
is E / (2 (1 + nu)) with Poisson's ratio nu. The deviations are relative and describe the spread between grades,
batches and moisture, not the error of one test.
"""

from __future__ import annotations

from typing import NamedTuple

from mufly.errors import InputError, suggest_name


class Material(NamedTuple):
    """Elastic constants of a material.

    Attributes
    ----------
    name : str
    young_modulus_Pa, shear_modulus_Pa, density_kg_m3 : float
    young_relative_std, shear_relative_std, density_relative_std : float
        Relative standard deviations.
    source : str
        Origin of the values.
    """

    name: str
    young_modulus_Pa: float
    shear_modulus_Pa: float
    density_kg_m3: float
    young_relative_std: float
    shear_relative_std: float
    density_relative_std: float
    source: str


def _make_plastic(name: str, young: float, poisson: float, density: float, std: float, source: str) -> Material:
    return Material(name, young, young / (2.0 * (1.0 + poisson)), density, std, std, 0.02, source)


_WOOD_SOURCE = "Wood Handbook, USDA FPL-GTR-190 (2010), ch. 5: 12 % moisture, E of bending + 10 %; scatter of Table 5-6"
_CARBON_SOURCE = "NIAR, AGATE-WP3.3-033051-131 (2002), T700SC/2510; density by mixture of fibre and resin"

MATERIALS: dict[str, Material] = {
    m.name: m
    for m in (
        _make_plastic("abs", 2.3e9, 0.38, 1040.0, 0.08, "BASF Terluran GP: ISO 527, ISO 1183; nu assumed"),
        _make_plastic("pa66-dry", 3.0e9, 0.39, 1130.0, 0.10, "BASF Ultramid A3K, dry: ISO 527; nu assumed"),
        _make_plastic("pa66", 1.1e9, 0.42, 1130.0, 0.25, "BASF Ultramid A3K, conditioned: ISO 527; nu assumed"),
        _make_plastic("polycarbonate", 2.4e9, 0.37, 1200.0, 0.05, "Covestro Makrolon 2405: ISO 527; nu assumed"),
        _make_plastic("photopolymer", 2.5e9, 0.38, 1175.0, 0.12, "Stratasys VeroWhitePlus, 2 to 3 GPa; nu assumed"),
        Material("spruce", 11.9e9, 0.75e9, 440.0, 0.22, 0.25, 0.10, f"Sitka spruce: {_WOOD_SOURCE}; G_LR/E 0.064"),
        Material(
            "balsa", 3.7e9, 0.17e9, 170.0, 0.22, 0.25, 0.15, f"balsa: {_WOOD_SOURCE}; mean of G_LR/E and G_LT/E, 0.046"
        ),
        Material(
            "cfrp-woven", 56e9, 4.2e9, 1560.0, 0.07, 0.10, 0.03, f"plain weave, 0/90 along the span: {_CARBON_SOURCE}"
        ),
        Material("cfrp", 125e9, 4.2e9, 1560.0, 0.07, 0.10, 0.03, "unidirectional: NIAR, AGATE-WP3.3-033051-132 (2002)"),
        Material("aluminium", 72e9, 27e9, 2780.0, 0.02, 0.02, 0.01, "2024-T3: MIL-HDBK-5J (2003), ch. 3"),
    )
}
"""Materials by name."""


def find_material(name: str) -> Material:
    """Return a material by name, in capitals or not.

    Raises
    ------
    InputError
        If the table has no such material.
    """
    key = name.strip().lower()
    if key in MATERIALS:
        return MATERIALS[key]
    raise InputError(
        "blade.structure", "material", f"{name!r} is unknown",
        suggest_name(key, MATERIALS, f"use one of: {', '.join(MATERIALS)}"),
    )  # fmt: skip
