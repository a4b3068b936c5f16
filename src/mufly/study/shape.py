"""A rotor with one thing about its blades changed, the way the dissertation's studies change it.

With x = r/R, the cut-out x0 and the mean chord c_m between x0 and the tip:

* ``chord``: all chords times chord / c_m.
* ``taper`` t: c = c_h + (c_t - c_h) (x - x0) / (1 - x0), c_h = 2 c_m / (1 + t), c_t = t c_h, so that the area
  stays; the dissertation's TAPER3505 (35 mm at the hub, 5 mm at the tip, 20 mm before) is t = 1/7.
* ``twist`` T: theta = T (1 - x) / (1 - x0), zero at the tip. Where the dissertation measures its pitch angle it
  does not say; that its optimum moves to smaller pitch with stronger twist (Fig. 3.36) fits the tip, not the hub.
"""

from __future__ import annotations

import re
from collections.abc import Mapping

import numpy as np

from mufly.errors import InputError
from mufly.rotor import Rotor, replace_rotor, rotor_from
from mufly.study.parameters import GEOMETRY, Value

__all__ = ["naca_name", "reshape"]

_NACA = ("camber", "camber_position", "thickness")


def naca_name(base: str, changes: Mapping[str, Value]) -> str:
    """Return the four-digit NACA name with camber, its place or thickness (all over chord) changed.

    Raises
    ------
    InputError
        If the airfoil is none of that series or a number is not one that the four digits can say.
    """
    match = re.fullmatch(r"naca(\d)(\d)(\d\d)", re.sub(r"[\s_-]", "", base.lower()))
    if match is None:
        key = next(k for k in _NACA if k in changes)
        raise InputError(
            key, "", f"{base} is no four-digit NACA section", "start from one, as in airfoil=naca4412"
        )
    digits = [int(match[1]), int(match[2]), int(match[3])]
    for place, (key, step, most) in enumerate(
        (("camber", 0.01, 9), ("camber_position", 0.1, 9), ("thickness", 0.01, 40))
    ):
        if key in changes:
            number = float(changes[key]) / step
            if abs(number - round(number)) > 1e-6 or not 0 <= round(number) <= most:
                raise InputError(
                    key, "", f"{100 * float(changes[key]):g} % is not in the series",
                    f"give multiples of {100 * step:g} % up to {100 * step * most:g} %",
                )  # fmt: skip
            digits[place] = round(number)
    if digits[0] == 0:
        digits[1] = 0
    elif digits[1] == 0:
        digits[1] = 4
    return f"naca{digits[0]}{digits[1]}{digits[2]:02d}"


def reshape(rotor: Rotor, changes: Mapping[str, Value]) -> Rotor:
    """Return the rotor with parameters of :data:`mufly.study.parameters.GEOMETRY` changed, values in SI units.

    Raises
    ------
    InputError
        If a value is impossible.
    """
    unknown = [key for key in changes if key not in GEOMETRY]
    if unknown:
        raise InputError(
            "rotor", unknown[0], "is no parameter of a blade", f"use one of: {', '.join(GEOMETRY)}"
        )
    simple: dict[str, Value | int] = {k: changes[k] for k in ("radius", "hub_cutout") if k in changes}
    if "blades" in changes:
        simple["blades"] = round(float(changes["blades"]))
    if simple:
        rotor = replace_rotor(rotor, simple)
    if "airfoil" in changes:
        rotor = replace_rotor(rotor, {"blade.airfoils": str(changes["airfoil"])})
    if any(k in changes for k in _NACA):
        names = [naca_name(name, changes) for name in rotor.blade.airfoils]
        rotor = replace_rotor(rotor, {"blade.airfoils": names})
    if "taper" in changes:
        rotor = _tapered(rotor, float(changes["taper"]))
    if "chord" in changes:
        span = rotor.radius_m - rotor.hub_radius_m
        factor = float(changes["chord"]) * span / rotor.blade_area_m2
        rotor = replace_rotor(rotor, {"blade.chord": (factor * rotor.blade.chord.array()).tolist()})
    if "twist" in changes:
        rotor = _from_cutout(rotor)
        x0 = float(rotor.hub_cutout)
        x = np.maximum(rotor.blade.r_over_R.array(), x0)
        rotor = replace_rotor(rotor, {"blade.twist": (float(changes["twist"]) * (1 - x) / (1 - x0)).tolist()})
    return rotor


def _from_cutout(rotor: Rotor) -> Rotor:
    """The same blade with its first station at the cut-out, so that a straight line can begin there."""
    x0, x = float(rotor.hub_cutout), rotor.blade.r_over_R.array()
    below = x < x0
    if not below.any() or len(rotor.blade.airfoils) > 1:
        return rotor
    inner = np.concatenate(([x0], x[x > x0]))
    tables = rotor.toml_tables()
    for key, values in (
        ("r_over_R", inner),
        ("chord", rotor.chord_m(inner)),
        ("twist", rotor.twist_rad(inner)),
    ):
        tables["blade"][key]["value"] = values.tolist()
    return rotor_from(tables, rotor.name)


def _tapered(rotor: Rotor, taper: float) -> Rotor:
    rotor = _from_cutout(rotor)
    x0, area = float(rotor.hub_cutout), rotor.blade_area_m2
    x = np.maximum(rotor.blade.r_over_R.array(), x0)
    shape = 1.0 + (taper - 1.0) * (x - x0) / (1.0 - x0)
    rotor = replace_rotor(rotor, {"blade.chord": shape.tolist()})
    return replace_rotor(rotor, {"blade.chord": (shape * area / rotor.blade_area_m2).tolist()})
