"""Parameters of a blade's structure: the table ``[blade.structure]`` of a rotor file.

A material and the contour of the airfoils give mass, stiffness and inertia along the span. Measured values of the
whole blade replace them in part: each scales the distribution of the contour. Values that the file leaves out widen the
bands of the results, the flap root and the elastic axis above all.
"""

from __future__ import annotations

from typing import Any, Literal

from pydantic import Field, model_validator

from mufly.errors import InputError
from mufly.files.input_files import make_validation_error
from mufly.rotor.structure.materials import find_material
from mufly.vehicle.quantity import ParameterGroup, Quantity

_RELATIVE_STD_BY_SOURCE = {
    "measured": 0.03, "CAD": 0.05, "datasheet": 0.05, "specified": 0.0, "identified": 0.05, "estimated": 0.2,
}  # fmt: skip
_CONTOUR_THICKNESS_STD = 0.10  # relative, of a moulded blade against its contour
_ELASTIC_AXIS_STD = 0.05  # of the chord, if the axis is computed from the contour


def _declare_optional_quantity(unit: str, symbol: str, description: str, **limits: float) -> Any:
    names = ("above", "at_least", "below", "at_most")
    extra: dict[str, Any] = {"unit": unit, "symbol": symbol, **{k: limits.get(k) for k in names}}
    return Field(default=None, description=description, json_schema_extra=extra)


class BladeStructure(ParameterGroup):
    """Material, thickness and root of a blade. Values that are left out are not known."""

    material: str = Field(description="material of the whole blade, as `abs`; `mufly rotor beam --materials` lists")
    contour: str = Field(default="", description="airfoil of the structure's contour; default: the blade's airfoils")
    thickness: Quantity | None = _declare_optional_quantity(
        "m", "t", "thickness of a plate on the camber line; default: the contour's", above=0, at_most=0.05
    )
    mass: Quantity | None = _declare_optional_quantity("kg", "m", "mass of one blade outside the hub, weighed", above=0)
    flap_stiffness: Quantity | None = _declare_optional_quantity(
        "N m2", "EI", "flap stiffness at 0.75 R, measured", above=0
    )
    torsion_stiffness: Quantity | None = _declare_optional_quantity(
        "N m2", "GJ", "torsion stiffness at 0.75 R, measured", above=0
    )
    elastic_axis: Quantity | None = _declare_optional_quantity(
        "1", "x_ea", "elastic axis over chord, from the nose; default: shear centre of the contour",
        at_least=0, at_most=1,
    )  # fmt: skip
    root: Literal["unknown", "clamped", "hinged"] = Field(
        default="unknown", description="flap root: `clamped` at the cut-out, `hinged`, or `unknown`"
    )
    hinge_radius: Quantity | None = _declare_optional_quantity(
        "m", "e", "radius of the flap hinge of a hinged root; default: the shaft", at_least=0
    )
    flap_spring: Quantity | None = _declare_optional_quantity(
        "N m/rad", "k_beta", "spring at the flap hinge of a hinged root; default: none", at_least=0
    )
    lag_spring: Quantity | None = _declare_optional_quantity(
        "N m/rad", "k_zeta", "spring at a lag hinge at the cut-out; default: clamped", at_least=0
    )
    pitch_spring: Quantity | None = _declare_optional_quantity(
        "N m/rad", "k_theta", "torsional spring of grip and control rods; default: rigid", above=0
    )

    @model_validator(mode="after")
    def _check_structure(self) -> BladeStructure:
        try:
            find_material(self.material)
        except InputError as error:
            raise make_validation_error(error.problem, error.remedy, "blade.structure.material") from None
        for key in ("hinge_radius", "flap_spring"):
            if getattr(self, key) is not None and self.root != "hinged":
                raise make_validation_error(
                    f"is given, but the root is {self.root}", 'set root = "hinged" or omit it',
                    f"blade.structure.{key}",
                )  # fmt: skip
        return self


def relative_std(quantity: Quantity | None, unknown: float = 0.0) -> float:
    """Return the relative standard deviation of a quantity: the stated one, or the default of the value's source.

    It is ``unknown`` if the quantity is None.
    """
    if quantity is None:
        return unknown
    if quantity.std is not None:
        return quantity.std / quantity.value if quantity.value else 0.0
    return _RELATIVE_STD_BY_SOURCE[quantity.source]


def collect_property_stds(structure: BladeStructure) -> dict[str, float]:
    """Return the standard deviations of the uncertain properties of a blade's structure, by name of the property.

    Returns
    -------
    dict of str to float
        Relative deviations of ``young``, ``shear``, ``density``, ``thickness``, ``mass``, ``flap_stiffness``,
        ``torsion_stiffness`` and of the springs; that of ``elastic_axis`` is a fraction of the chord. A measured value
        removes the causes that it replaces.
    """
    m = find_material(structure.material)
    axis = structure.elastic_axis
    own = axis is not None and axis.std is not None
    out = {
        "young": m.young_relative_std,
        "shear": m.shear_relative_std,
        "density": m.density_relative_std,
        "thickness": relative_std(structure.thickness, _CONTOUR_THICKNESS_STD),
        "elastic_axis": float(axis.std or 0.0) if axis is not None and own else _ELASTIC_AXIS_STD if axis is None else
        0.02,
        **{
            key: relative_std(getattr(structure, key))
            for key in ("mass", "flap_stiffness", "torsion_stiffness", "flap_spring", "lag_spring", "pitch_spring")
        },
    }  # fmt: skip
    return {key: value for key, value in out.items() if value > 0.0}
