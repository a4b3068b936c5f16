"""Flight maps: additional loads of a coaxial pair in edgewise flow and at angular rates, and their files.

The axes are the ratio of lower to upper speed, the climb velocity over the mean tip speed, and the advance ratio
``mu = V / (s R)``, with s the mean of both speeds and V the airspeed in the disc plane. Advance ratios have even steps
of

    e = mu^2 / (mu^2 + k^2)

with the knee k, about the inflow ratio of hover. Loads are even functions of ``mu`` and therefore smooth in e.
The columns of a rotor, in axes along the edgewise velocity of the hub (x) and to its right (y), z down:

==================  ================================================================================================
column              meaning
==================  ================================================================================================
``thrust_excess``   thrust over that of axial flight at the same speeds and climb, less 1
``torque_excess``   torque likewise
``drag``            H / (rho pi R^3 Omega V), against the velocity
``side_force``      Y / (rho pi R^3 Omega V), to the right
``roll_moment``     hub moment about x, right side down, over rho pi R^4 Omega V
``pitch_moment``    hub moment about y, nose up, over rho pi R^4 Omega V
``rate_force``      force along x per roll rate, over rho pi R^4 Omega
``rate_side``       force along y per roll rate, over rho pi R^4 Omega
``rate_damping``    hub moment about x per roll rate, over rho pi R^5 Omega
``rate_coupling``   hub moment about y per roll rate, over rho pi R^5 Omega
==================  ================================================================================================

A pitch rate gives the same force and moment turned by 90 degrees: the four last columns are means of both rates. Omega
is the rotor's own speed. A vehicle file names the map (``rotors.flight_map``); a loaded vehicle contains the whole map.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache, partial
from importlib import resources
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import tomli_w
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field, model_validator

from mufly.errors import InputError
from mufly.files.input_files import builtin_file_names, make_validation_error, read_toml, validate_model
from mufly.vehicle.coefficient_map import load_coefficient_map, parse_table_rows

Array = NDArray[np.float64]

MAX_MAP_CLIMBS, MAX_MAP_ADVANCE_RATIOS = (
    8,
    12,
)  # greatest numbers of climbs and advance ratios, by the flight model's record
ROTOR_LOAD_COLUMNS = (
    "thrust_excess", "torque_excess", "drag", "side_force", "roll_moment", "pitch_moment", "rate_force", "rate_side",
    "rate_damping", "rate_coupling",
)  # fmt: skip
FLIGHT_MAP_AXIS_COLUMNS = ("ratio", "climb_ratio", "advance_ratio")
FLIGHT_TABLE_COLUMNS = (
    *FLIGHT_MAP_AXIS_COLUMNS,
    *(f"{name}_{side}" for side in ("up", "dw") for name in ROTOR_LOAD_COLUMNS),
)

_BUILTIN_FLIGHT_MAPS_FOLDER = resources.files("mufly.vehicle") / "flight_maps"
_GRID_STEP_TOLERANCE = 1e-3  # of a step
_table_error = partial(make_validation_error, key="table")


class FlightMapTables(NamedTuple):
    """Flight map as arrays.

    Attributes
    ----------
    ratio, climb_ratio : 1-D arrays
        Axes in equal steps: ``Omega_dw / Omega_up``, and the climb velocity over the mean tip speed.
    edgewise : 1-D array
        Axis e in equal steps from 0.
    loads : (ratios, climbs, advance ratios, 20) array
        :data:`ROTOR_LOAD_COLUMNS` of the upper rotor, then of the lower one.
    """

    ratio: Array
    climb_ratio: Array
    edgewise: Array
    loads: Array


class FlightMap(BaseModel):
    """Validated flight map; :meth:`decode_map_tables` returns its arrays."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    name: str = Field(min_length=1, description="short name")
    description: str = Field(default="", description="one line: origin and method of the loads")
    vehicle: str = Field(min_length=1, description="vehicle whose hover gives speeds and pitch")
    mass_kg: float = Field(gt=0, description="mass of that vehicle")
    upper: str = Field(min_length=1, description="blades of the upper rotor")
    lower: str = Field(min_length=1, description="blades of the lower rotor")
    blades: str = Field(min_length=1, description="hash of blades and polars")
    radius_m: float = Field(gt=0, description="radius of both rotors (m)")
    spacing_m: float = Field(gt=0, description="distance between the discs (m)")
    thrust_coefficients: tuple[float, float] = Field(
        description="thrust over rho pi R^4 Omega^2 in hover, upper, lower"
    )
    pitch_deg: tuple[float, float] = Field(description="pitch settings of upper and lower rotor")
    flap_frequency_ratios: tuple[float, float] = Field(description="flap frequency over speed, upper and lower rotor")
    flap_basis: str = Field(default="", description="origin of the flap frequencies")
    mean_speed_rad_s: float = Field(gt=0, description="mean rotor speed of the computation")
    density_kg_m3: float = Field(gt=0, description="density of the air of the computation")
    knee: float = Field(gt=0, description="k of the edgewise axis")
    level_speed_m_s: tuple[float, float] = Field(
        description="greatest level airspeed of the vehicle at the ends of the band of flap frequencies"
    )
    table: str = Field(description="one line a point: axes, then the loads of upper and lower rotor")

    def decode_map_tables(self) -> FlightMapTables:
        """Return axes and loads as read-only arrays."""
        return _parse_flight_table(self.table, self.knee)

    @property
    def velocity_range_m_s(self) -> tuple[float, float, float]:
        """Greatest edgewise velocity, greatest sink and greatest climb (m/s) at the mean speed of the map."""
        tables, tip = self.decode_map_tables(), self.mean_speed_rad_s * self.radius_m
        last = float(tables.edgewise[-1])
        climb = tables.climb_ratio
        return tip * self.knee * (last / (1.0 - last)) ** 0.5, -tip * float(climb[0]), tip * float(climb[-1])

    @model_validator(mode="after")
    def _check_table(self) -> FlightMap:
        self.decode_map_tables()
        return self


@lru_cache(maxsize=32)
def _parse_flight_table(text: str, knee: float) -> FlightMapTables:
    rows = parse_table_rows(text, FLIGHT_TABLE_COLUMNS)
    square = rows[:, 2] ** 2
    rows[:, 2] = np.round(square / (square + knee * knee), 5)
    axes = [np.unique(rows[:, k]) for k in range(3)]
    shape = tuple(a.size for a in axes)
    if len(rows) != np.prod(shape) or len(np.unique(rows[:, :3], axis=0)) != len(rows):
        raise _table_error(
            f"{len(rows)} points do not fill a grid of {shape[0]} ratios, {shape[1]} climbs and {shape[2]} speeds",
            "give every combination once",
        )
    for name, axis, least in zip(FLIGHT_MAP_AXIS_COLUMNS, axes, (1, 3, 3), strict=True):
        step = np.diff(axis)
        if axis.size < least:
            raise _table_error(f"{name} has {axis.size} value", f"give {least} or more")
        if step.size and float(np.ptp(step)) > _GRID_STEP_TOLERANCE * float(step.mean()) + 2e-5:
            raise _table_error(f"{name} is not evenly spaced", "make the map again: mufly coax flight-map")
    if shape[1] > MAX_MAP_CLIMBS or shape[2] > MAX_MAP_ADVANCE_RATIOS:
        raise _table_error(
            f"{shape[1]} climbs and {shape[2]} advance ratios",
            f"give {MAX_MAP_CLIMBS} and {MAX_MAP_ADVANCE_RATIOS} at most",
        )
    if not axes[1][0] <= 0.0 <= axes[1][-1]:
        raise _table_error("climb_ratio does not include 0 (hover)", "give a range that holds it")
    if axes[0][0] <= 0.0 or axes[2][0] != 0.0:
        raise _table_error("ratio is not above 0, or advance_ratio does not begin at 0", "correct the table")
    ordered = rows[np.lexsort(rows[:, 2::-1].T)]
    ratio, climb_ratio, edgewise = axes
    loads = np.ascontiguousarray(ordered[:, len(FLIGHT_MAP_AXIS_COLUMNS) :]).reshape(
        *shape, 2 * len(ROTOR_LOAD_COLUMNS)
    )
    out = FlightMapTables(ratio, climb_ratio, edgewise, loads)
    for array in out:
        array.setflags(write=False)
    return out


def format_flight_table(tables: FlightMapTables, knee: float) -> str:
    """Return the text of a flight map's ``table``.

    ``knee`` is the advance ratio at 0.5 of the axis ``edgewise``.
    """
    advance = knee * np.sqrt(tables.edgewise / (1.0 - tables.edgewise))
    grid = np.meshgrid(tables.ratio, tables.climb_ratio, advance, indexing="ij")
    rows = np.column_stack([*(a.ravel() for a in grid), tables.loads.reshape(-1, tables.loads.shape[-1])])
    formats = ["{:.7g}"] * len(FLIGHT_MAP_AXIS_COLUMNS) + ["{:.5g}"] * tables.loads.shape[-1]
    lines = [" ".join(f.format(v) for f, v in zip(formats, row, strict=True)) for row in rows]
    return "\n".join([" ".join(FLIGHT_TABLE_COLUMNS), *lines]) + "\n"


def format_flight_map_toml(flight_map: FlightMap) -> str:
    """Return the text of a flight map file."""
    return tomli_w.dumps(flight_map.model_dump(), multiline_strings=True)


def list_builtin_flight_maps() -> list[str]:
    """Return the names of the built-in flight maps."""
    return builtin_file_names(_BUILTIN_FLIGHT_MAPS_FOLDER)


def load_flight_map(name_or_path: str | Path, folder: Path | None = None) -> FlightMap:
    """Read a flight map by built-in name or from its file.

    Parameters
    ----------
    name_or_path : str or Path
        A name that :func:`list_builtin_flight_maps` lists, or a path.
    folder : Path, optional
        Base folder of relative paths; by default the working directory.

    Raises
    ------
    InputError
        If the file does not exist, is not TOML, or is no flight map.
    """
    tables, where = read_toml(name_or_path, _BUILTIN_FLIGHT_MAPS_FOLDER, "flight map", folder)
    if "table" not in tables or "knee" not in tables:
        raise InputError(where, "table", "is missing: the file is not a flight map", "make one: mufly coax flight-map")
    return validate_model(FlightMap, tables, where)


def insert_named_maps(tables: dict[str, Any], folder: Path | None, where: str) -> dict[str, Any]:
    """Return a vehicle's tables with the maps of ``rotors`` replaced by the content of the named files."""
    rotors = tables.get("rotors")
    if not isinstance(rotors, dict):
        return tables
    loaders: dict[str, Callable[[str | Path, Path | None], BaseModel]] = {
        "coefficient_map": load_coefficient_map,
        "flight_map": load_flight_map,
    }
    found: dict[str, Any] = {}
    for key, load in loaders.items():
        name = rotors.get(key)
        if name is None or isinstance(name, dict):
            continue
        if not isinstance(name, str | Path):
            raise InputError(
                where, f"rotors.{key}", f"{name!r} is not a file name", f'write {key} = "pair.toml"'
            )  # fmt: skip
        found[key] = load(name, folder).model_dump()
    return {**tables, "rotors": {**rotors, **found}} if found else tables
