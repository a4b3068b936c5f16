"""What a rotor is: number of blades, radius, and chord, twist and airfoil along the blade.

A rotor file (TOML) tabulates the blade from hub to tip over ``r/R``; between stations chord and twist are
interpolated linearly and the polars of the two neighbouring airfoils are mixed in the same proportion. Between the
hub cut-out and the first station everything is held constant. Per blade, with x = r/R and x0 the cut-out:

    area          A_b = R int_x0^1 c dx                                     m2
    solidity      sigma = N A_b / (pi R^2)
    aspect ratio  AR = (R - r0)^2 / A_b          (span over mean chord; 2.55 for c/R = 1/3, x0 = 0.15)
    thrust-weighted solidity  sigma_T = 3 int_x0^1 (N c / (pi R)) x^2 dx    (Leishman, sec. 3.4.3; = sigma
                              for constant chord without cut-out)

All integrals are exact for the piecewise linear tables. ``twist`` is the angle of the chord line against the rotor
plane at zero pitch setting, nose up positive; the pitch setting of an operating point is added to it.
"""

from __future__ import annotations

import math
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic import Field, model_validator
from pydantic_core import PydanticCustomError

from mufly.rotor.airfoil import load_airfoil
from mufly.vehicle.quantity import Group, Quantity, Source, parameter

__all__ = ["Blade", "BladeSections", "Column", "Rotor", "blade_thickness_m"]

Array = NDArray[np.float64]


def _fault(key: str, problem: str, remedy: str) -> PydanticCustomError:
    context = {"key": key, "problem": problem, "remedy": remedy}
    return PydanticCustomError("mufly", "{problem}; {remedy}", context)


class Column(Group):
    """One quantity at every station of a blade, with unit and provenance."""

    value: tuple[float, ...]
    unit: str
    source: Source
    note: str = ""

    def array(self) -> Array:
        """Return the values, SI, shape (stations,)."""
        return np.array(self.value, dtype=np.float64)


class BladeSections(NamedTuple):
    """A blade at chosen radii. The section at ``i`` has the airfoil ``names[first[i]]`` mixed with
    ``names[second[i]]``: coefficient = (1 - weight) first + weight second."""

    r_over_R: Array
    chord_m: Array
    twist_rad: Array
    names: tuple[str, ...]
    first: NDArray[np.int64]
    second: NDArray[np.int64]
    weight: Array


class Blade(Group):
    """Chord, twist and airfoil from hub to tip."""

    r_over_R: Column = parameter(
        "1", "x", "radius of each station over R, rising to 1", at_least=0, at_most=1
    )
    chord: Column = parameter("m", "c", "chord at each station", above=0)
    twist: Column = parameter(
        "rad", "theta_tw", "twist at each station, nose up", at_least=-math.pi, at_most=math.pi
    )
    airfoils: tuple[str, ...] = Field(
        min_length=1, description="airfoil at each station, or one name for the whole blade"
    )

    @model_validator(mode="after")
    def _table_is_sound(self) -> Blade:
        x, n = self.r_over_R.value, len(self.r_over_R.value)
        if n < 2:
            raise _fault("blade.r_over_R", f"{n} station(s)", "give two stations at least, hub and tip")
        for i, (a, b) in enumerate(pairwise(x)):
            if not b > a:
                raise _fault(
                    "blade.r_over_R", f"station {i + 2} ({b:g}) is not beyond station {i + 1} ({a:g})",
                    "list stations from hub to tip",
                )  # fmt: skip
        if abs(x[-1] - 1.0) > 1e-9:
            raise _fault(
                "blade.r_over_R", f"the last station is {x[-1]:g}", "let the last station be the tip, 1"
            )
        for key in ("chord", "twist"):
            m = len(getattr(self, key).value)
            if m != n:
                raise _fault(f"blade.{key}", f"{m} values for {n} stations", f"give {n} values")
        if len(self.airfoils) not in (1, n):
            raise _fault(
                "blade.airfoils", f"{len(self.airfoils)} airfoils for {n} stations", f"give 1 or {n} names"
            )
        return self


class Rotor(Group):
    """A rotor, as read from a rotor file. All values in SI units."""

    name: str = Field(min_length=1, description="short name")
    description: str = Field(default="", description="one line about the rotor")
    blades: int = Field(ge=1, le=20, strict=True, description="number of blades")
    radius: Quantity = parameter("m", "R", "radius of the rotor", above=0)
    hub_cutout: Quantity = parameter(
        "1", "x0", "radius over R at which the blade begins", at_least=0, below=1
    )  # fmt: skip
    blade: Blade

    @model_validator(mode="after")
    def _cutout_on_blade(self) -> Rotor:
        x = self.blade.r_over_R.value
        if float(self.hub_cutout) > 0.9:
            raise _fault("hub_cutout", f"{float(self.hub_cutout):g} leaves no blade", "give at most 0.9")
        if sum(v > float(self.hub_cutout) for v in x) < 1:
            raise _fault("hub_cutout", "no station lies beyond it", "give stations out to the tip")
        return self

    @property
    def radius_m(self) -> float:
        """Radius (m)."""
        return float(self.radius)

    @property
    def hub_radius_m(self) -> float:
        """Radius at which the blades begin (m)."""
        return float(self.hub_cutout) * self.radius_m

    @property
    def disc_area_m2(self) -> float:
        """Area of the disc, pi R^2."""
        return math.pi * self.radius_m**2

    @property
    def blade_area_m2(self) -> float:
        """Area of one blade from cut-out to tip."""
        return self.radius_m * self._moment(0)

    @property
    def solidity(self) -> float:
        """Blade area over disc area."""
        return self.blades * self.blade_area_m2 / self.disc_area_m2

    @property
    def thrust_solidity(self) -> float:
        """Thrust-weighted solidity, 3 int sigma(x) x^2 dx."""
        return 3.0 * self.blades * self._moment(2) / (math.pi * self.radius_m)

    @property
    def aspect_ratio(self) -> float:
        """Span from cut-out to tip over mean chord."""
        return (self.radius_m - self.hub_radius_m) ** 2 / self.blade_area_m2

    def _moment(self, power: int) -> float:
        """Integral of c x^power over x from the cut-out to 1, exact for the piecewise linear chord."""
        x0 = float(self.hub_cutout)
        inner = self.blade.r_over_R.array()
        x = np.concatenate(([x0], inner[inner > x0]))
        nodes, weights = np.polynomial.legendre.leggauss(2)  # exact to third order, c x^2 is cubic
        half, mid = np.diff(x) / 2.0, (x[1:] + x[:-1]) / 2.0
        at = mid[:, None] + half[:, None] * nodes
        return float(np.sum(half[:, None] * weights * self.chord_m(at) * at**power))

    def chord_m(self, r_over_R: ArrayLike) -> Array:
        """Chord (m) at ``r/R``, linear between stations."""
        return np.interp(
            np.asarray(r_over_R, dtype=np.float64), self.blade.r_over_R.value, self.blade.chord.value
        )

    def twist_rad(self, r_over_R: ArrayLike) -> Array:
        """Twist (rad) at ``r/R``, linear between stations."""
        return np.interp(
            np.asarray(r_over_R, dtype=np.float64), self.blade.r_over_R.value, self.blade.twist.value
        )

    def airfoil_names(self) -> tuple[str, ...]:
        """Return the different airfoils, hub first."""
        return tuple(dict.fromkeys(self.blade.airfoils))

    def sections(self, r_over_R: ArrayLike) -> BladeSections:
        """Return chord, twist and airfoil mix at the given radii.

        Parameters
        ----------
        r_over_R : (n,) array_like
            Radii over R, each between 0 and 1.
        """
        x = np.atleast_1d(np.asarray(r_over_R, dtype=np.float64))
        names = self.airfoil_names()
        stations = self.blade.r_over_R.array()
        listed = self.blade.airfoils
        if len(listed) == 1:
            listed = listed * stations.size
        index = np.array([names.index(name) for name in listed], dtype=np.int64)
        j = np.clip(np.searchsorted(stations, x, side="right") - 1, 0, stations.size - 2)
        weight = np.clip((x - stations[j]) / (stations[j + 1] - stations[j]), 0.0, 1.0)
        same = index[j] == index[j + 1]
        return BladeSections(
            x, self.chord_m(x), self.twist_rad(x), names, index[j], index[j + 1], np.where(same, 0.0, weight)
        )

    def toml_tables(self) -> dict[str, Any]:
        """Return the rotor as nested dictionaries with the keys of a rotor file."""
        return self.model_dump(exclude_none=True)


def blade_thickness_m(rotor: Rotor, r_over_R: ArrayLike) -> Array:
    """Greatest thickness of the blade at the given radii.

    Parameters
    ----------
    rotor : Rotor
        The rotor.
    r_over_R : (n,) array_like
        Radii over R.

    Returns
    -------
    (n,) array
        Chord times thickness ratio (m), mixed between stations as the polars are; nan where a station's section is a
        table of coefficients without geometry.

    Raises
    ------
    InputError
        If an airfoil is unknown or unsound.
    """
    s = rotor.sections(r_over_R)
    ratio = np.array(
        [
            math.nan if name.lower().endswith(".csv") else load_airfoil(name).thickness_ratio
            for name in s.names
        ]
    )
    return s.chord_m * ((1.0 - s.weight) * ratio[s.first] + s.weight * ratio[s.second])
