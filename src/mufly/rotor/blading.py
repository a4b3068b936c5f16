"""Blades laid out as arrays for the solver: stations, polars, and the corrections that depend on geometry only.

Stations sit in the middle of panels whose edges follow x = x0 + (1 - x0) (1 - cos t) / 2 with t uniform, so
that they crowd where the loading bends, at hub and tip.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mufly.errors import InputError
from mufly.rotor import build
from mufly.rotor.build import Engine
from mufly.rotor.corrections import Corrections, rotation_strength, zero_lift_angle
from mufly.rotor.geometry import Rotor
from mufly.rotor.lifting_surface import chord_factor
from mufly.rotor.polar import PolarStack, PolarTable, stack_polars

__all__ = ["Blading", "as_blading", "panel_edges", "prepare"]

Array = NDArray[np.float64]
Integers = NDArray[np.int64]

STATIONS = 24


@dataclass(frozen=True, eq=False)
class Blading:
    """One or several rotors, ready to be solved. Make it with :func:`prepare`.

    Attributes
    ----------
    rotors : tuple of Rotor
        The rotors, ``n`` of them.
    corrections : Corrections
        What is switched on.
    r_m, dr_m, chord_m, twist_rad, chord_factor, rotation : (n, stations) arrays
        Stations; loss of angle per lift coefficient (rad), strength of the rotation model.
    first, second, weight : (n, stations) arrays
        Polars of the stack and their mix.
    polars : PolarStack
        Polars of all rotors.
    zero_lift_rad : (tables,) array
        Zero-lift angle of each polar.
    """

    rotors: tuple[Rotor, ...]
    corrections: Corrections
    r_m: Array
    dr_m: Array
    chord_m: Array
    twist_rad: Array
    chord_factor: Array
    rotation: Array
    first: Integers
    second: Integers
    weight: Array
    polars: PolarStack
    zero_lift_rad: Array

    @property
    def radius_m(self) -> Array:
        """Radius of each rotor."""
        return np.array([rotor.radius_m for rotor in self.rotors])

    @property
    def hub_radius_m(self) -> Array:
        """Hub radius of each rotor."""
        return np.array([rotor.hub_radius_m for rotor in self.rotors])

    @property
    def blades(self) -> Array:
        """Blades of each rotor."""
        return np.array([float(rotor.blades) for rotor in self.rotors])


def panel_edges(cutout: float, stations: int) -> tuple[Array, Array]:
    """Middle and edges of the panels, over R.

    Returns
    -------
    mid : (stations,) array
    edges : (stations + 1,) array
    """
    t = np.linspace(0.0, np.pi, stations + 1)
    span = 1.0 - cutout
    edges = cutout + span * 0.5 * (1.0 - np.cos(t))
    middle = cutout + span * 0.5 * (1.0 - np.cos(0.5 * (t[1:] + t[:-1])))
    return middle, edges


def prepare(
    rotors: Rotor | Sequence[Rotor],
    polars: Mapping[str, PolarTable] | None = None,
    *,
    n_crit: float = 0.1,
    engine: Engine = "neuralfoil",
    corrections: Corrections | None = None,
    stations: int = STATIONS,
) -> Blading:
    """Lay blades out for :func:`mufly.rotor.hover.hover` and its companions.

    Parameters
    ----------
    rotors : Rotor or sequence of Rotor
        One or many; many share one batch.
    polars : mapping, optional
        Airfoil name to polar, for every airfoil that the rotors name. By default they are computed (or recalled) by
        ``engine`` at ``n_crit``, over Reynolds numbers from 2e3 to 3e5.
    corrections : Corrections, optional
        Default: all that docs/bemt.md recommends.
    stations : int
        Stations along a blade; 24 give thrust and torque within 0.1 % of 200.

    Raises
    ------
    InputError
        If an airfoil has no polar, or fewer than four stations are asked for.
    """
    many = (rotors,) if isinstance(rotors, Rotor) else tuple(rotors)
    fixes = corrections or Corrections()
    if not many:
        raise InputError("rotor", "", "no rotor given", "give at least one")
    if stations < 4:
        raise InputError("rotor", "stations", f"{stations} is too few for a blade", "give 4 or more")
    names = list(dict.fromkeys(name for rotor in many for name in rotor.airfoil_names()))
    known = build.polars(names, n_crit=n_crit, engine=engine) if polars is None else polars
    for name in names:
        if name not in known:
            raise InputError(
                "rotor", f"airfoil {name}", "has no polar", f"give one of {', '.join(sorted(known))}"
            )
    tables = [known[name] for name in names]
    shape = (len(many), stations)
    r, dr, chord, twist, e, g, weight = (np.zeros(shape) for _ in range(7))
    first, second = np.zeros(shape, dtype=np.int64), np.zeros(shape, dtype=np.int64)
    for k, rotor in enumerate(many):
        big = rotor.radius_m
        mid, edges = panel_edges(float(rotor.hub_cutout), stations)
        cut = rotor.sections(mid)
        index = np.array([names.index(name) for name in cut.names], dtype=np.int64)
        r[k], dr[k], chord[k], twist[k] = mid * big, np.diff(edges) * big, cut.chord_m, cut.twist_rad
        first[k], second[k], weight[k] = index[cut.first], index[cut.second], cut.weight
        if fixes.lifting_surface:
            e[k] = chord_factor(mid, edges, cut.chord_m / big, rotor.chord_m(edges) / big)
        g[k] = rotation_strength(fixes.rotation, chord[k] / r[k])
    stack = stack_polars(tables)
    return Blading(
        rotors=many,
        corrections=fixes,
        r_m=r,
        dr_m=dr,
        chord_m=chord,
        twist_rad=twist,
        chord_factor=e,
        rotation=g,
        first=first,
        second=second,
        weight=weight,
        polars=stack,
        zero_lift_rad=np.array([zero_lift_angle(table) for table in tables]),
    )


def as_blading(rotor: Rotor | Blading) -> Blading:
    """Return a blading as it is, and a rotor laid out with all defaults (a millisecond; keep it for loops)."""
    return rotor if isinstance(rotor, Blading) else prepare(rotor)
