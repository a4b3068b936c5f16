"""Coefficient maps: thrust and torque coefficients of a coaxial pair over both speeds and climb, and their files.

The axes are the mean speed, the ratio of lower to upper speed, and the climb velocity over the mean tip speed.
Incompressible inviscid flow depends on the last two only; the mean speed adds the effect of the Reynolds number and
needs two or three values. Coefficients are defined as in vehicle files, ``c_T = T / (rho pi R^4 Omega^2)`` and ``c_Q =
Q / (rho pi R^5 Omega^2)``, each with its own rotor's speed.

A map file is TOML: the origin of the map, and a ``table`` with one line for each point, which can be pasted into a
spreadsheet. A vehicle file names the map (``rotors.coefficient_map``). A loaded vehicle contains the whole map, so
recordings and copied vehicle files need no other file.
"""

from __future__ import annotations

import math
from functools import lru_cache, partial
from importlib import resources
from pathlib import Path
from typing import Any, Literal, NamedTuple

import numpy as np
import tomli_w
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field, model_validator

from mufly.errors import InputError
from mufly.files.input_files import builtin_file_names, make_validation_error, read_toml, validate_model
from mufly.quantities.units import RPM
from mufly.results import ResultColumn, ShownBlock, columns_to_rows, make_lines_block, tabulate_results

MAX_MAP_NODES = 512  # size of the tables in the flight model's record, e.g. 3 mean speeds x 13 ratios x 13 climbs
_MAP_AXIS_COUNT = 3  # first arrays of the tables
MAP_TABLE_COLUMNS = (
    "mean_speed_rad_s",
    "ratio",
    "climb_ratio",
    "cT_upper",
    "cQ_upper",
    "cT_lower",
    "cQ_lower",
    "solved",
)

_BUILTIN_MAPS_FOLDER = resources.files("mufly.vehicle") / "maps"
_MAX_GRID_STEP_DEVIATION = 1e-3  # greatest deviation of a step, relative


class MapTables(NamedTuple):
    """Coefficient map as arrays; the coefficients have shape (mean speeds, ratios, climbs).

    Attributes
    ----------
    mean_speed_rad_s, ratio, climb_ratio : 1-D arrays
        Axes, increasing in equal steps: ``(Omega_up + Omega_dw) / 2``, ``Omega_dw / Omega_up``, and the climb velocity
        over the mean tip speed (positive in climb).
    cT_upper, cQ_upper, cT_lower, cQ_lower : 3-D arrays
    solved : 3-D array of bool
        False where the method did not converge and the mean of neighbours is used.
    """

    mean_speed_rad_s: NDArray[np.float64]
    ratio: NDArray[np.float64]
    climb_ratio: NDArray[np.float64]
    cT_upper: NDArray[np.float64]
    cQ_upper: NDArray[np.float64]
    cT_lower: NDArray[np.float64]
    cQ_lower: NDArray[np.float64]
    solved: NDArray[np.bool_]

    @property
    def grid_shape(self) -> tuple[int, int, int]:
        """Number of mean speeds, ratios and climbs."""
        return self.mean_speed_rad_s.size, self.ratio.size, self.climb_ratio.size


_table_error = partial(make_validation_error, key="table")


class CoefficientMap(BaseModel):
    """Validated coefficient map; :meth:`decode_map_tables` returns its arrays."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    name: str = Field(min_length=1, description="short name")
    description: str = Field(default="", description="one line: origin and method of the coefficients")
    method: Literal["bemt", "wake", "other"] = Field(description="method of the computation")
    upper: str = Field(min_length=1, description="upper rotor")
    lower: str = Field(min_length=1, description="lower rotor")
    radius_m: float = Field(gt=0, description="radius of both rotors (m)")
    spacing_m: float = Field(gt=0, description="distance between the discs (m)")
    upper_pitch_deg: float = Field(description="pitch setting of the upper rotor")
    lower_pitch_deg: float = Field(description="pitch setting of the lower rotor")
    density_kg_m3: float = Field(gt=0, description="density of the air, for the Reynolds number")
    viscosity_Pa_s: float = Field(gt=0, description="viscosity of the air, for the Reynolds number")
    settings: str = Field(default="", description="how the method was set")
    table: str = Field(description=f"one line for each point: {' '.join(MAP_TABLE_COLUMNS)}")

    def decode_map_tables(self) -> MapTables:
        """Return axes and coefficients as read-only arrays."""
        return _parse_table(self.table)

    def as_record(self) -> dict[str, Any]:
        """Return the settings, axes and coefficients."""
        return {**self.model_dump(exclude={"table"}), **self.decode_map_tables()._asdict()}

    def make_printed_blocks(self) -> tuple[ShownBlock, ...]:
        """Return the coefficients at the middle speed without climb, and the limits of the map, as printed text."""
        t = self.decode_map_tables()
        k, i = t.grid_shape[0] // 2, int(np.argmin(np.abs(t.climb_ratio)))
        mean, (means, ratios, climbs) = float(t.mean_speed_rad_s[k]), t.grid_shape
        columns = (
            ResultColumn("ratio", form=".3g", head="lower/upper speed"),
            ResultColumn("cT_upper", form=".5f"), ResultColumn("cQ_upper", form=".6f"),
            ResultColumn("cT_lower", form=".5f"), ResultColumn("cQ_lower", form=".6f"),
            ResultColumn("solved"),
        )  # fmt: skip
        table = {"ratio": t.ratio, **{c.name: getattr(t, c.name)[k, :, i] for c in columns[1:]}}
        edge = t.climb_ratio[0] == 0.0 or t.climb_ratio[-1] == 0.0
        missing = int(np.count_nonzero(~t.solved))
        warnings = (
            "Hover is at the edge of the map, beyond which coefficients are constant: heave damping acts on one side "
            "only. Let the climb reach beyond 0 on both sides." if edge else "",
            f"{missing} of {t.solved.size} points have no solution and take the mean of their neighbours."
            if missing else "",
        )  # fmt: skip
        return (
            make_lines_block(
                f"  {self.description}",
                f"{means} mean speeds, {ratios} ratios, {climbs} climbs; below: {mean / RPM:.0f} rpm, climb "
                f"{float(t.climb_ratio[i]) * mean * self.radius_m:.2f} m/s",
                head=self.name,
            ),
            tabulate_results(columns_to_rows(table), columns),
            make_lines_block(*filter(None, warnings), style="yellow"),
        )

    @model_validator(mode="after")
    def _check_table(self) -> CoefficientMap:
        self.decode_map_tables()
        return self


def parse_table_rows(text: str, columns: tuple[str, ...]) -> NDArray[np.float64]:
    """Return the rows of a ``table`` whose first line names the columns, (rows, columns).

    Raises
    ------
    PydanticCustomError
        If a line is wrong.
    """
    lines = [(k, line.split()) for k, line in enumerate(text.strip().splitlines(), 1) if line.strip()]
    if not lines or tuple(lines[0][1]) != columns:
        raise _table_error("the first line does not name the columns", f"begin with: {' '.join(columns)}")
    if len(lines) == 1:
        raise _table_error("has no line of numbers", "give a line for each point")
    rows = []
    for k, cells in lines[1:]:
        try:
            row = [float(cell) for cell in cells]
        except ValueError:
            row = []
        if len(row) != len(columns) or not all(map(math.isfinite, row)):
            raise _table_error(f"line {k} is not {len(columns)} finite numbers: {' '.join(cells)}", "correct that line")
        rows.append(row)
    return np.array(rows, dtype=np.float64)


@lru_cache(maxsize=32)
def _parse_table(text: str) -> MapTables:
    rows = parse_table_rows(text, MAP_TABLE_COLUMNS)
    axes = [np.unique(rows[:, k]) for k in range(3)]
    shape = tuple(a.size for a in axes)
    if len(rows) != np.prod(shape) or len(np.unique(rows[:, :3], axis=0)) != len(rows):
        raise _table_error(
            f"{len(rows)} points do not fill a grid of {shape[0]} mean speeds, {shape[1]} ratios and {shape[2]} climbs",
            "give every combination once",
        )
    if len(rows) > MAX_MAP_NODES:
        raise _table_error(f"{len(rows)} points", f"give {MAX_MAP_NODES} at most")
    for name, axis, least, positive in zip(
        MAP_TABLE_COLUMNS, axes, (1, 2, 2), (True, True, False), strict=False
    ):  # fmt: skip
        step = np.diff(axis)
        if axis.size < least:
            raise _table_error(f"{name} has {axis.size} value", f"give {least} or more")
        if positive and not axis[0] > 0:
            raise _table_error(f"{name} {axis[0]:g} is out of range", "give numbers above 0")
        if step.size and float(np.ptp(step)) > _MAX_GRID_STEP_DEVIATION * float(step.mean()) + 1e-5 * float(
            np.abs(axis).max()
        ):
            raise _table_error(f"{name} is not evenly spaced", "give equal steps")
    if not axes[2][0] <= 0.0 <= axes[2][-1]:
        raise _table_error("climb_ratio does not include 0 (hover)", "give a range that holds it")
    ordered = rows[np.lexsort(rows[:, 2::-1].T)]
    grids = [np.ascontiguousarray(ordered[:, k].reshape(shape)) for k in range(3, 8)]
    if float(np.max(np.abs(grids[0]))) > 1.0 or float(np.max(np.abs(grids[2]))) > 1.0:
        raise _table_error("a thrust coefficient is above 1", "use c_T = T / (rho pi R^4 Omega^2)")
    thrust_up, torque_up, thrust_dw, torque_dw, solved = grids
    result = MapTables(axes[0], axes[1], axes[2], thrust_up, torque_up, thrust_dw, torque_dw, solved=solved > 0.5)
    for array in result:
        array.setflags(write=False)
    return result


def format_map_table(tables: MapTables) -> str:
    """Return the tables of a map as the text of the key ``table`` in a map file: a header, then a line per point."""
    grid = np.meshgrid(*tables[:_MAP_AXIS_COUNT], indexing="ij")
    columns = [np.ravel(a) for a in (*grid, *tables[_MAP_AXIS_COUNT:])]
    lines = [" ".join(f"{v:.7g}" for v in row[:-1]) + f" {int(row[-1])}" for row in zip(*columns, strict=True)]
    return "\n".join([" ".join(MAP_TABLE_COLUMNS), *lines]) + "\n"


def format_coefficient_map_toml(coefficients: CoefficientMap) -> str:
    """Return the text of a map file that :func:`load_coefficient_map` can read."""
    return tomli_w.dumps(coefficients.model_dump(), multiline_strings=True)


def list_builtin_coefficient_maps() -> list[str]:
    """Return the names of the built-in coefficient maps."""
    return builtin_file_names(_BUILTIN_MAPS_FOLDER)


def load_coefficient_map(name_or_path: str | Path, folder: Path | None = None) -> CoefficientMap:
    """Read a coefficient map by built-in name or from its file.

    Parameters
    ----------
    name_or_path : str or Path
        A name that :func:`list_builtin_coefficient_maps` lists, or a path.
    folder : Path, optional
        Base folder of relative paths; by default the working directory.

    Raises
    ------
    InputError
        If the file does not exist, is not TOML, or is no map.
    """
    tables, where = read_toml(name_or_path, _BUILTIN_MAPS_FOLDER, "coefficient map", folder)
    if "table" not in tables:
        raise InputError(where, "table", "is missing, so this is not a coefficient map", "make one: mufly coax map")
    return validate_model(CoefficientMap, tables, where)
