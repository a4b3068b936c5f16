"""Geometry of a rotor, and reading and writing of rotor files.

A rotor file (TOML) tabulates the blade from hub to tip over ``r/R``; between stations chord and twist are interpolated
linearly and the polars of the two neighbouring airfoils are mixed in the same proportion. Between the hub cut-out and
the first station all are constant. ``thickness`` (over the chord, by station) gives each section another thickness
about its mean line (:func:`mufly.rotor.sections.airfoil.set_airfoil_thickness`); polars, loads, solids, meshes and the
beam then have the sections of :meth:`Rotor.airfoil_stations`. Per blade, with x = r/R and x0 the cut-out::

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
from collections.abc import Mapping, Sequence
from importlib import resources
from itertools import pairwise
from pathlib import Path
from typing import Any, Literal, NamedTuple

import numpy as np
import tomli_w
from numpy.typing import ArrayLike, NDArray
from pydantic import Field, model_validator
from pydantic_core import PydanticCustomError

from mufly.errors import InputError
from mufly.files.input_files import builtin_file_names, read_toml, validate_model
from mufly.rotor.sections.airfoil import MAX_THICKNESS_RATIO, load_airfoil, name_thickened_airfoil
from mufly.rotor.sections.polar_file import is_polar_file
from mufly.rotor.structure.blade_structure import BladeStructure
from mufly.vehicle.quantity import ParameterGroup, Quantity, ValueSource, declare_parameter

Array = NDArray[np.float64]


def _make_validation_error(key: str, problem: str, remedy: str) -> PydanticCustomError:
    context = {"key": key, "problem": problem, "remedy": remedy}
    return PydanticCustomError("mufly", "{problem}; {remedy}", context)


GeometrySource = Literal["photograph", "maker", "caliper", "scan", "CAD"]
"""Sources of a blade's geometry; :mod:`mufly.rotor.effective_pitch` has the uncertainty of each."""
BladeFamily = Literal["apc", "slow-flyer", "gws", "hobby", "printed", "machined"]
"""Families of blades; :mod:`mufly.rotor.blades.blade_families` has the priors of each."""
_MAX_MIXED_THICKNESS_STEP = 0.03  # over chord, between sections whose polars are mixed
_MIN_WIDEST_CHORD_OVER_RADIUS = 0.005  # widest chord over radius; long blades of sailplane-like rotors have 0.02
_MIN_CHORD_OVER_NEIGHBOURS = 0.01  # chord over the widest chords on each side, except at a pointed tip


class StationColumn(ParameterGroup):
    """Values of a quantity at every station of a blade, with unit and provenance."""

    value: tuple[float, ...]
    unit: str
    source: ValueSource
    note: str = ""

    def to_si_array(self) -> Array:
        """Return the values in SI units, shape (stations,)."""
        return np.array(self.value, dtype=np.float64)


class BladeSections(NamedTuple):
    """Sections of a blade at chosen radii, each a mix of two airfoils.

    A coefficient at station ``i`` is (1 - w) times that of airfoil ``first_airfoil[i]`` plus w times that of
    ``second_airfoil[i]``, with w = ``second_weight[i]``; both are indices in ``airfoil_names``.
    """

    r_over_R: Array
    chord_m: Array
    twist_rad: Array
    airfoil_names: tuple[str, ...]
    first_airfoil: NDArray[np.int64]
    second_airfoil: NDArray[np.int64]
    second_weight: Array


ROUGH_TRIP, ROUGH_N_CRIT = 0.05, 0.1
"""Transition of a rough surface: latest place x/c, and greatest amplification exponent."""


class Transition(NamedTuple):
    """Transition of the boundary layer: amplification exponent, and forced transition x/c on upper and lower side."""

    n_crit: float
    xtr: tuple[float, float]


def _declare_trip(side: str) -> Any:
    extra: dict[str, Any] = {
        "unit": "1",
        "symbol": f"x_tr,{side[0]}",
        "above": None,
        "at_least": 0.0,
        "below": None,
        "at_most": 1.0,
    }
    return Field(
        default=None, json_schema_extra=extra, description=f"turbulator on the {side} side, x/c; default: none"
    )


class Blade(ParameterGroup):
    """Chord, twist and airfoil from hub to tip."""

    r_over_R: StationColumn = declare_parameter(
        "1", "x", "radius of each station over R, increasing to 1", at_least=0, at_most=1
    )
    chord: StationColumn = declare_parameter("m", "c", "chord at each station", above=0)
    twist: StationColumn = declare_parameter(
        "rad", "theta_tw", "twist at each station, nose up", at_least=-math.pi, at_most=math.pi
    )
    airfoils: tuple[str, ...] = Field(
        min_length=1, description="airfoil at each station, or one name for the whole blade"
    )
    thickness: StationColumn | None = Field(
        default=None,
        json_schema_extra={
            "unit": "1",
            "symbol": "t/c",
            "above": 0.0,
            "at_least": None,
            "below": None,
            "at_most": MAX_THICKNESS_RATIO,
        },
        description="thickness over chord at each station, about the mean line; default: that of the airfoils",
    )
    trip_upper: Quantity | None = _declare_trip("upper")
    trip_lower: Quantity | None = _declare_trip("lower")
    surface: Literal["smooth", "rough"] | None = Field(
        default=None, description="`smooth` (default), or `rough`: transition at 0.05 c at n_crit 0.1"
    )
    geometry: GeometrySource | None = Field(
        default=None,
        description="source of the geometry, which sets the uncertainty of the angles; default: own design",
    )
    family: BladeFamily | None = Field(
        default=None,
        description="family of the blade, which sets likely sections and a part of the angles' uncertainty",
    )
    pitch_std: Quantity | None = Field(
        default=None,
        json_schema_extra={
            "unit": "rad", "symbol": "s_p", "above": 0.0, "at_least": None, "below": 0.5, "at_most": None
        },
        description="standard deviation of a common error of all angles; default: set by `geometry` and `family`",
    )  # fmt: skip
    structure: BladeStructure | None = Field(default=None, description="material, thickness and root of the blade")

    @model_validator(mode="after")
    def _check_stations(self) -> Blade:
        x, n = self.r_over_R.value, len(self.r_over_R.value)
        if n < 2:
            raise _make_validation_error("blade.r_over_R", f"{n} station(s)", "give at least two stations, hub and tip")
        for i, (a, b) in enumerate(pairwise(x)):
            if not b > a:
                raise _make_validation_error(
                    "blade.r_over_R", f"station {i + 2} ({b:g}) is not beyond station {i + 1} ({a:g})",
                    "list stations from hub to tip",
                )  # fmt: skip
        if abs(x[-1] - 1.0) > 1e-9:
            raise _make_validation_error("blade.r_over_R", f"the last station is {x[-1]:g}", "end at the tip, 1")
        for key in ("chord", "twist", "thickness"):
            m = n if getattr(self, key) is None else len(getattr(self, key).value)
            if m != n:
                raise _make_validation_error(f"blade.{key}", f"{m} values for {n} stations", f"give {n} values")
        if len(self.airfoils) not in (1, n):
            raise _make_validation_error(
                "blade.airfoils", f"{len(self.airfoils)} airfoils for {n} stations", f"give 1 or {n} names"
            )
        chord = self.chord.value
        for i in range(n - 1):  # the last station may be a pointed tip
            outer = max(chord[i + 1 :])
            least = _MIN_CHORD_OVER_NEIGHBOURS * min(max(chord[:i], default=outer), outer)
            if 0.0 < chord[i] < least:
                raise _make_validation_error(
                    "blade.chord", f"{1e3 * chord[i]:.4g} mm at station {i + 1} ({x[i]:.4g} R) does not fit the chords "
                    f"beside it, up to {1e3 * outer:.4g} mm", "correct the value or its unit",
                )  # fmt: skip
        polar = "" if self.thickness is None else next((name for name in self.airfoils if is_polar_file(name)), "")
        if polar:
            raise _make_validation_error(
                "blade.thickness", f"does not change {polar}, a table of coefficients",
                "delete it, or give airfoils with a contour",
            )  # fmt: skip
        return self


FIT_CHANGE_LIMITS = (0.3, 1.5, 1.5, 1.0, 2.0, 1.0, 2.0)
"""Greatest changes that a fit may make to a rotor: :attr:`SectionCandidate.change`."""


class SectionCandidate(ParameterGroup):
    """Candidate section of a fit to a bench run, with its probability and fitted changes."""

    airfoils: tuple[str, ...] = Field(min_length=1, description="as in [blade]")
    probability: float = Field(ge=0.0, le=1.0)
    change: tuple[float, ...] = Field(
        description="added to the twist (rad); logarithms of the factors on lift and drag at Re_m; their exponents of "
        "Re; their curvatures over Re (missing in older files: 0)",
        min_length=5,
        max_length=7,
    )
    covariance: tuple[tuple[float, ...], ...] = Field(description="of the change", min_length=5, max_length=7)

    @model_validator(mode="after")
    def _check_change_limits(self) -> SectionCandidate:
        if any(abs(v) > most for v, most in zip(self.change, FIT_CHANGE_LIMITS, strict=False)):
            raise _make_validation_error(
                "fit.candidates.change", f"{self.change} exceeds the limits of a fit", "fit the rotor again"
            )
        n = len(self.change)
        if n == 6 or any(len(row) != n for row in (*self.covariance, self.covariance)):
            raise _make_validation_error(
                "fit.candidates.covariance", "is not a matrix of the size of change, 5 or 7", "fit the rotor again"
            )
        return self


class SectionFit(ParameterGroup):
    """Sections of a rotor fitted to a bench run (:func:`mufly.rotor.fit_rotor`), the likeliest first.

    Twist and polar coefficients change by the equations of :mod:`mufly.rotor.measured.rotor_fit`; Re over ``reynolds``
    is limited to 0.2 to 5. A section may occur several times, with different widths of its priors.
    """

    bench: str = Field(description="source of the measurements")
    points: int = Field(ge=1)
    n_crit: float = Field(description="n_crit of the fitted polars", ge=0.0)
    reynolds: float = Field(description="Reynolds number for which the factors are valid", gt=0.0)
    pitch_rad: tuple[float, float] = Field(description="measured range of pitch (rad)")
    speed_rad_s: tuple[float, float] = Field(description="measured range of speed (rad/s)")
    climb_ratio: tuple[float, float] = Field(
        default=(0.0, 0.0), description="range of the airspeed along the shaft over that of the tips"
    )
    scatter: tuple[float, float] = Field(description="relative residual of thrust and torque after the fit")
    candidates: tuple[SectionCandidate, ...] = Field(min_length=1)

    def list_sections(self) -> list[tuple[str, float]]:
        """Return the names of the candidate sections with their probabilities, the likeliest first."""
        shares: dict[str, float] = {}
        for c in self.candidates:
            name = "/".join(dict.fromkeys(c.airfoils))
            shares[name] = shares.get(name, 0.0) + c.probability
        return sorted(shares.items(), key=lambda item: -item[1])


class Rotor(ParameterGroup):
    """Rotor as read from a rotor file; all values in SI units."""

    name: str = Field(min_length=1, description="short name")
    description: str = Field(default="", description="one line about the rotor")
    blades: int = Field(ge=1, le=20, strict=True, description="number of blades")
    radius: Quantity = declare_parameter("m", "R", "radius of the rotor", above=0)
    hub_cutout: Quantity = declare_parameter(
        "1", "x0", "radius over R at which the blade begins", at_least=0, below=1
    )  # fmt: skip
    trailing_edge: Quantity = declare_parameter(
        "m", "h", "thickness of the trailing edge; 0: that of the airfoils", at_least=0, absent=0.0
    )
    nominal_pitch: Quantity | None = Field(
        default=None,
        json_schema_extra={
            "unit": "m", "symbol": "H", "above": 0.0, "at_least": None, "below": None, "at_most": None
        },
        description="nominal pitch of the propeller (advance per turn); a second estimate of the blade angles",
    )  # fmt: skip
    blade: Blade
    fit: SectionFit | None = Field(default=None, description="corrections of the sections from a bench fit")

    @model_validator(mode="after")
    def _check_cutout(self) -> Rotor:
        x = self.blade.r_over_R.value
        if float(self.hub_cutout) > 0.9:
            raise _make_validation_error(
                "hub_cutout",
                f"{float(self.hub_cutout):g} leaves no blade outside the hub",
                "give at most 0.9 of the radius",
            )
        widest = max(self.blade.chord.value)
        if widest > float(self.radius):
            raise _make_validation_error(
                "blade.chord", f"{1e3 * widest:g} mm is more than the radius, {1e3 * float(self.radius):g} mm",
                "check both, and their units",
            )  # fmt: skip
        edge = float(self.trailing_edge)
        if edge > 0.1 * widest:
            raise _make_validation_error(
                "trailing_edge", f"{1e3 * edge:g} mm does not fit a chord of {1e3 * widest:g} mm",
                "check both, and their units",
            )  # fmt: skip
        if sum(v > float(self.hub_cutout) for v in x) < 1:
            raise _make_validation_error("hub_cutout", "no station lies beyond it", "give stations out to the tip")
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
        """Area of the disc, pi R^2 (m^2)."""
        return math.pi * self.radius_m**2

    @property
    def blade_area_m2(self) -> float:
        """Area of one blade from cut-out to tip (m^2)."""
        return self.radius_m * self._chord_radius_moment(0)

    @property
    def solidity(self) -> float:
        """Blade area over disc area."""
        return self.blades * self.blade_area_m2 / self.disc_area_m2

    @property
    def thrust_solidity(self) -> float:
        """Thrust-weighted solidity, 3 int sigma(x) x^2 dx."""
        return 3.0 * self.blades * self._chord_radius_moment(2) / (math.pi * self.radius_m)

    @property
    def aspect_ratio(self) -> float:
        """Span from cut-out to tip over mean chord."""
        return (self.radius_m - self.hub_radius_m) ** 2 / self.blade_area_m2

    def _chord_radius_moment(self, power: int) -> float:
        """Return the integral of c x^power over x from the cut-out to 1, exact for the piecewise linear chord."""
        x0 = float(self.hub_cutout)
        inner = self.blade.r_over_R.to_si_array()
        x = np.concatenate(([x0], inner[inner > x0]))
        nodes, weights = np.polynomial.legendre.leggauss(2)  # exact to third order, c x^2 is cubic
        half, mid = np.diff(x) / 2.0, (x[1:] + x[:-1]) / 2.0
        at = mid[:, None] + half[:, None] * nodes
        return float(np.sum(half[:, None] * weights * self.chord_m(at) * at**power))

    def chord_m(self, r_over_R: ArrayLike) -> Array:
        """Return the chord (m) at ``r/R``, linear between stations."""
        return np.interp(np.asarray(r_over_R, dtype=np.float64), self.blade.r_over_R.value, self.blade.chord.value)

    def twist_rad(self, r_over_R: ArrayLike) -> Array:
        """Return the twist (rad) at ``r/R``, linear between stations."""
        return np.interp(np.asarray(r_over_R, dtype=np.float64), self.blade.r_over_R.value, self.blade.twist.value)

    def stated_thickness(self, r_over_R: ArrayLike) -> Array:
        """Return ``blade.thickness`` (over chord) at ``r/R``, linear between stations; nan where the file has none."""
        x, thick = np.asarray(r_over_R, dtype=np.float64), self.blade.thickness
        return np.full(x.shape, math.nan) if thick is None else np.interp(x, self.blade.r_over_R.value, thick.value)

    def airfoil_stations(self) -> tuple[Array, tuple[str, ...]]:
        """Return the radii (r/R) between which polars are mixed, and the airfoil at each.

        With ``blade.thickness`` these are the stations and, between stations of one airfoil, places whose thicknesses
        differ by at most 3 % of the chord: thrust and torque are then within 0.3 % of those of a fine division.
        """
        x, listed = self.blade.r_over_R.to_si_array(), self.blade.airfoils
        names = listed * x.size if len(listed) == 1 else listed
        if self.blade.thickness is None:
            return x, names
        thick = self.blade.thickness.to_si_array()
        places, sections = [x[:1]], [name_thickened_airfoil(names[0], thick[0])]
        for k, (a, b) in enumerate(pairwise(thick.tolist())):
            pieces = math.ceil(abs(b - a) / _MAX_MIXED_THICKNESS_STEP - 1e-9) if names[k] == names[k + 1] else 1
            places.append(np.linspace(x[k], x[k + 1], max(pieces, 1) + 1)[1:])
            sections += [name_thickened_airfoil(names[k + 1], t) for t in np.linspace(a, b, max(pieces, 1) + 1)[1:]]
        return np.concatenate(places), tuple(sections)

    def describe_sections(self) -> str:
        """Return the airfoils of the file, hub first, and the range of a stated thickness, in words."""
        words = ", ".join(dict.fromkeys(self.blade.airfoils))
        if self.blade.thickness is None:
            return words
        inner, outer = (100.0 * self.stated_thickness([float(self.hub_cutout), 1.0])).tolist()
        return f"{words}, {inner:.3g} % thick at the hub, {outer:.3g} % at the tip"

    def airfoil_names(self) -> tuple[str, ...]:
        """Return the names of the distinct airfoils, hub first."""
        return tuple(dict.fromkeys(self.airfoil_stations()[1]))

    def sections_at(self, r_over_R: ArrayLike) -> BladeSections:
        """Return chord, twist and airfoil mix at the given radii.

        Parameters
        ----------
        r_over_R : (n,) array_like
            Radii over R, each between 0 and 1.
        """
        x = np.atleast_1d(np.asarray(r_over_R, dtype=np.float64))
        names = self.airfoil_names()
        stations, listed = self.airfoil_stations()
        index = np.array([names.index(name) for name in listed], dtype=np.int64)
        j = np.clip(np.searchsorted(stations, x, side="right") - 1, 0, stations.size - 2)
        weight = np.clip((x - stations[j]) / (stations[j + 1] - stations[j]), 0.0, 1.0)
        same = index[j] == index[j + 1]
        return BladeSections(
            x, self.chord_m(x), self.twist_rad(x), names, index[j], index[j + 1], np.where(same, 0.0, weight)
        )

    def transition_at_n_crit(self, n_crit: float) -> Transition:
        """Return the transition of the blade's sections in air with an amplification exponent."""
        upper, lower = (1.0 if t is None else float(t) for t in (self.blade.trip_upper, self.blade.trip_lower))
        if self.blade.surface != "rough":
            return Transition(n_crit, (upper, lower))
        return Transition(min(n_crit, ROUGH_N_CRIT), (min(upper, ROUGH_TRIP), min(lower, ROUGH_TRIP)))

    def toml_tables(self) -> dict[str, Any]:
        """Return the rotor as nested dictionaries with the keys of a rotor file."""
        tables = self.model_dump(exclude_none=True)
        if float(self.trailing_edge) == 0.0:
            del tables["trailing_edge"]
        return tables


def blade_thickness_m(rotor: Rotor, r_over_R: ArrayLike) -> Array:
    """Return the greatest thickness of the blade at the given radii.

    Parameters
    ----------
    rotor : Rotor
        The rotor.
    r_over_R : (n,) array_like
        Radii over R.

    Returns
    -------
    (n,) array
        Chord times thickness ratio (m), mixed between stations as the polars are; nan where a section has only a polar
        and no contour.

    Raises
    ------
    InputError
        If an airfoil is unknown or its contour is invalid.
    """
    s = rotor.sections_at(r_over_R)
    ratio = np.array(
        [math.nan if is_polar_file(name) else load_airfoil(name).thickness_ratio for name in s.airfoil_names]
    )
    return s.chord_m * ((1.0 - s.second_weight) * ratio[s.first_airfoil] + s.second_weight * ratio[s.second_airfoil])


_BUILTIN_FOLDER = resources.files("mufly.rotor") / "builtin"


def list_builtin_rotors() -> list[str]:
    """Return the names of the rotors that come with mufly."""
    return builtin_file_names(_BUILTIN_FOLDER)


def load_rotor(name_or_path: str | Path) -> Rotor:
    """Read a rotor by built-in name or from a TOML file.

    Airfoil files named in a rotor file are searched beside it first.

    Parameters
    ----------
    name_or_path : str or Path
        A name that :func:`list_builtin_rotors` lists, or the path of a rotor file.

    Returns
    -------
    Rotor
        Frozen and checked; all values in SI units.

    Raises
    ------
    InputError
        If there is no such rotor, the file is not TOML, or a value is missing, unknown, without a unit or
        impossible. The message names file, key, value and remedy.
    """
    tables, where = read_toml(name_or_path, _BUILTIN_FOLDER, "rotor")
    blade = tables.get("blade")
    if where == str(name_or_path) and isinstance(blade, dict) and isinstance(blade.get("airfoils"), list):
        folder = Path(where).parent
        blade["airfoils"] = [_resolve_airfoil_path(folder, name) for name in blade["airfoils"]]
    return rotor_from_tables({"name": Path(where).stem, **tables}, where)


def _resolve_airfoil_path(folder: Path, name: Any) -> Any:
    if (
        isinstance(name, str)
        and name.lower().endswith((".dat", ".txt", ".csv", ".pol", ".plr", ".polar"))
        and (folder / name).is_file()
    ):
        return str(folder / name)
    return name


def rotor_from_tables(tables: Mapping[str, Any], where: str = "rotor") -> Rotor:
    """Make a validated rotor from nested dictionaries with the keys of a rotor file.

    Raises
    ------
    InputError
        As for :func:`load_rotor`.
    """
    rotor = validate_model(Rotor, tables, where)
    widest = max(rotor.blade.chord.value)
    if widest < _MIN_WIDEST_CHORD_OVER_RADIUS * rotor.radius_m:
        raise InputError(
            where, "blade.chord", f"{1e3 * widest:g} mm is too narrow for a radius of {1e3 * rotor.radius_m:g} mm",
            "check both, and their units",
        )  # fmt: skip
    return rotor


def make_rotor(
    *,
    name: str,
    radius_m: float,
    chord_m: ArrayLike,
    twist_rad: ArrayLike = 0.0,
    airfoils: str | Sequence[str] = "naca4412",
    thickness: ArrayLike | None = None,
    r_over_R: ArrayLike = (0.0, 1.0),
    blades: int = 2,
    hub_cutout: float = 0.15,
    source: str = "specified",
    description: str = "",
) -> Rotor:
    """Make a rotor from arrays.

    Parameters
    ----------
    name, description : str
        As in a rotor file.
    radius_m : float
        Radius (m).
    chord_m, twist_rad : float or (n,) array_like
        Chord (m) and twist (rad) at the stations; a scalar applies to the whole blade.
    airfoils : str or n names
        Airfoil of the blade, or of each station.
    thickness : float or (n,) array_like, optional
        Thickness over chord of the sections at the stations. Default: as the airfoils have it.
    r_over_R : (n,) array_like
        Stations, rising to 1.
    blades : int
        Number of blades.
    hub_cutout : float
        Radius over R at which the blade begins.
    source : str
        Provenance of all values: measured, CAD, datasheet, estimated, identified or specified.

    Raises
    ------
    InputError
        If a value is impossible.
    """
    x = np.asarray(r_over_R, dtype=np.float64)

    def make_column(values: ArrayLike, unit: str) -> dict[str, Any]:
        array = np.asarray(values, dtype=np.float64)
        return {
            "value": (np.full(x.size, array) if array.ndim == 0 else array).tolist(),
            "unit": unit,
            "source": source,
        }

    tables = {
        "name": name,
        "description": description,
        "blades": blades,
        "radius": {"value": radius_m, "unit": "m", "source": source},
        "hub_cutout": {"value": hub_cutout, "unit": "1", "source": source},
        "blade": {
            "r_over_R": make_column(x, "1"),
            "chord": make_column(chord_m, "m"),
            "twist": make_column(twist_rad, "rad"),
            "airfoils": [airfoils] if isinstance(airfoils, str) else list(airfoils),
            **({} if thickness is None else {"thickness": make_column(thickness, "1")}),
        },
    }
    return rotor_from_tables(tables, name)


def replace_rotor(rotor: Rotor, values: Mapping[str, Any], *, source: str = "specified") -> Rotor:
    """Return a rotor with some values changed.

    Parameters
    ----------
    rotor : Rotor
        The rotor to start from.
    values : mapping
        New SI values by dotted key, as in ``{"radius": 0.07, "blade.chord": 0.025, "blades": 3}``. A scalar for a
        column applies to every station.
    source : str
        Provenance of the changed values.

    Raises
    ------
    InputError
        If a key does not exist or a value is impossible.
    """
    tables = rotor.toml_tables()
    tables.setdefault("trailing_edge", rotor.trailing_edge.model_dump())
    for trip in ("trip_upper", "trip_lower"):
        if f"blade.{trip}" in values:
            tables["blade"].setdefault(trip, {"value": 1.0, "unit": "1"})
    if "blade.geometry" in values:
        tables["blade"].setdefault("geometry", None)
    if "blade.family" in values:
        tables["blade"].setdefault("family", None)
    if "nominal_pitch" in values:
        tables.setdefault("nominal_pitch", {"value": 1.0, "unit": "m"})
    if "blade.pitch_std" in values:
        tables["blade"].setdefault("pitch_std", {"value": 0.01, "unit": "rad"})
    if "blade.surface" in values:
        tables["blade"].setdefault("surface", "smooth")
    stations = len(rotor.blade.r_over_R.value)
    if "blade.thickness" in values:
        tables["blade"].setdefault("thickness", {"value": [0.1] * stations, "unit": "1"})
    for key, value in values.items():
        *path, last = key.split(".")
        table: Any = tables
        for part in path:
            table = table.get(part) if isinstance(table, dict) else None
        if not isinstance(table, dict) or last not in table:
            known = (
                "name, blades, radius, hub_cutout, trailing_edge, nominal_pitch, blade.r_over_R, blade.chord, "
                "blade.twist, blade.airfoils, blade.thickness, blade.trip_upper, blade.trip_lower, blade.surface, "
                "blade.geometry, blade.family, blade.pitch_std"
            )
            raise InputError("replace", key, "no such key", f"use one of: {known}")
        if last == "airfoils":
            table[last] = [value] if isinstance(value, str) else list(value)
            if table[last] != list(rotor.blade.airfoils):
                tables.pop("fit", None)  # a fit is valid only for its own sections
        elif isinstance(table[last], dict):
            column = isinstance(table[last]["value"], list | tuple)
            listed = np.asarray(value, dtype=np.float64).tolist() if column else value
            if column and not isinstance(listed, list):
                listed = [listed] * stations
            table[last] = {**table[last], "value": listed, "source": source, "note": "set by hand"}
        else:
            table[last] = value
    return rotor_from_tables(tables, rotor.name)


def format_rotor_toml(rotor: Rotor) -> str:
    """Return the rotor as the text of a rotor file, in SI units, that :func:`load_rotor` reads back."""
    return tomli_w.dumps(rotor.toml_tables())
