"""Export the on-board software: a C99 source tree with the numbers of one vehicle.

The algorithms are hand-written and equal for all vehicles (``sources/``). Only ``tables.c`` is generated; it contains
every number as a hexadecimal float, which no compiler rounds, with its decimal value and unit.
"""

from __future__ import annotations

import shutil
from collections.abc import Iterable, Iterator, Mapping
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np

from mufly.control import FlightController
from mufly.control.law import GAIN_UNITS, SCHEDULE_FIELDS
from mufly.errors import InputError
from mufly.firmware.export.estimate_tables import render_estimator_files
from mufly.firmware.export.plan_tables import (
    make_mission_plan,
    render_log_head_source,
    render_plan_source,
    render_supervisor_source,
    render_texts_source,
)
from mufly.mission import Mission
from mufly.vehicle import Vehicle
from mufly.version import __version__
from mufly.world import World

SOURCE_FOLDER = resources.files("mufly.firmware") / "sources"
SOFTWARE_SOURCES = ("*.c", "control/*.c", "dynamics/*.c", "estimate/**/*.c", "flight/*.c", "mission/**/*.c")
"""Patterns of the flight software in an exported tree, which the Makefile and the CMake file repeat. Files include each
other by their path in the tree, so that its root is the only include folder."""
ONBOARD_SOURCES = ("onboard/**/*.c",)
"""Patterns of a board's drivers, link, log, receiver, storage and supervisor."""
FIXED_POINT_SOURCES = ("fixed_point/*.c",)
"""Pattern of the fixed-point law."""
FIXED_POINT_TABLES_PATH = "fixed_point/tables_fixed.c"
"""Path of the fixed-point law's numbers, which an export without that law lacks."""
SCHEDULE_HEADER_PATH = "control/schedule.h"
"""Path of the header that an export of a scheduled design replaces."""
_GAIN_GROUPS = ("heave_yaw", "roll_pitch", "position")


def export_firmware(
    controller: FlightController,
    out: Path,
    vehicle: Vehicle | None = None,
    world: World | None = None,
    mission: Mission | None = None,
) -> list[Path]:
    """Write the source tree of a vehicle's flight software: C99, Makefile, CMake file and a README.

    Parameters
    ----------
    controller : FlightController
        From :func:`mufly.control.design_flight_controller`.
    out : Path
        Folder; an earlier export in it is replaced.
    vehicle : Vehicle, optional
        Vehicle of the estimator; without it, the tree has no estimator parameters.
    world : World, optional
        World whose room the estimator knows in advance; by default that of the mission.
    mission : Mission, optional
        Mission to export; without it, the tree has no ``plan.c``.

    Returns
    -------
    list of Path
        Written files.

    Raises
    ------
    InputError
        If the folder contains other files, the rate is no integer, or the mission is too long.
    """
    out = Path(out)
    if out.exists() and (not out.is_dir() or (any(out.iterdir()) and not (out / "tables.c").exists())):
        raise InputError("out", str(out), "contains files of another origin", "name a new or empty folder")
    known = mission.world if world is None and mission is not None else world
    others = dict(render_estimator_files(vehicle, known, controller.rate_Hz))
    if vehicle is not None and mission is not None:
        others["plan.c"] = render_plan_source(make_mission_plan(vehicle, controller, mission), controller)
        others["onboard/supervisor/supervisor_settings.c"] = render_supervisor_source(vehicle)
        others["onboard/link/texts.c"] = render_texts_source()
        others["onboard/log/flight_log_head.c"] = render_log_head_source()
    write_source_tree(render_gains_files(controller), out, others)
    return sorted(p for p in out.rglob("*") if p.is_file())


def write_source_tree(gains: Mapping[str, str], out: Path, others: Mapping[str, str] | None = None) -> None:
    """Write the sources, the gains' files and other generated files (text by name) into a folder."""
    copy_sources(out)
    for name, text in {**gains, **(others or {})}.items():
        (out / name).write_text(text, encoding="utf-8")


def find_sources(tree: Path, patterns: Iterable[str] = SOFTWARE_SOURCES) -> list[Path]:
    """Return the files of a tree that match any of the patterns, sorted."""
    return sorted(path for pattern in patterns for path in tree.glob(pattern))


def copy_sources(out: Path) -> None:
    """Copy the C sources into a folder, except the tables, the fixed-point code and the learned policy."""
    with resources.as_file(SOURCE_FOLDER) as sources:
        shutil.copytree(sources, out, dirs_exist_ok=True, ignore=shutil.ignore_patterns("*fixed*", "policy"))
    for name, text in render_estimator_files(None, None, 0.0).items():
        (out / name).write_text(text, encoding="utf-8")


def copy_fixed_point_sources(out: Path) -> None:
    """Copy the fixed-point sources into a tree."""
    with resources.as_file(SOURCE_FOLDER) as sources:
        for name in ("fixed_point", "check/programs"):
            shutil.copytree(sources / name, out / name, dirs_exist_ok=True)


def render_gains_files(controller: FlightController) -> dict[str, str]:
    """Return the texts of the files that hold a vehicle's controllers, by name."""
    files = {"tables.c": render_gains_source(controller)}
    if controller.schedule is not None:
        files[SCHEDULE_HEADER_PATH] = render_enabled_schedule_header()
    return files


def render_enabled_schedule_header() -> str:
    """Return the C header that enables the gain schedule of the roll-pitch controller over forward speed."""
    text = (SOURCE_FOLDER / SCHEDULE_HEADER_PATH).read_text(encoding="utf-8")
    assert "ROLL_PITCH_SCHEDULED 0" in text
    return text.replace("ROLL_PITCH_SCHEDULED 0", "ROLL_PITCH_SCHEDULED 1")


def render_gains_source(controller: FlightController) -> str:
    """Return the text of ``tables.c``: all gains of a vehicle's controllers."""
    rate = controller.rate_Hz
    if rate != round(rate):
        raise InputError("rate_Hz", f"{rate:g}", "is not a whole number", "design for a whole rate")
    lines = [
        f"/* The numbers of {escape_comment(controller.vehicle_name)}, made by mufly {__version__}; do not edit. */",
        '#include "flight/controllers.h"',
        "",
        f"const int32_t mufly_rate_Hz = {round(rate)};",
        f"const int32_t mufly_position_divider = {controller.position_divider};",
        "",
        "const gains_t mufly_gains = {",
    ]
    for group in _GAIN_GROUPS:
        record = getattr(controller, f"{group}_gains")
        lines += [f"    .{group} =", "        {"]
        for name in record.dtype.names:
            if name in SCHEDULE_FIELDS and controller.schedule is None:
                continue
            lines += _gains_field_lines(name, record[name])
        lines += ["        },"]
    return "\n".join([*lines, "};", ""])


def _gains_field_lines(name: str, value: Any) -> Iterator[str]:
    array = np.asarray(value, dtype=np.float64)
    pad = " " * 12
    unit = GAIN_UNITS.get(name, "")
    if array.ndim == 0:
        yield f"{pad}.{name} = {to_hexadecimal(float(array))}, /* {_format_decimal(float(array), unit)} */"
        return
    yield f"{pad}.{name} ="
    yield f"{pad}    {{"
    for row in array:
        if array.ndim == 1:
            yield f"{pad}        {to_hexadecimal(float(row))}, /* {_format_decimal(float(row), unit)} */"
        else:
            numbers = ", ".join(to_hexadecimal(float(v)) for v in row)
            yield f"{pad}        {{{numbers}}}, /* {', '.join(f'{v:.9g}' for v in row)} */"
    yield f"{pad}    }},"


def to_hexadecimal(value: float) -> str:
    """Return a C99 constant equal to the number bit for bit."""
    return f"REAL({value.hex()})"


def _format_decimal(value: float, unit: str) -> str:
    return f"{value:.9g} {unit}".rstrip()


def escape_comment(text: str) -> str:
    """Return a text without line breaks and end markers, for use inside a C comment."""
    return text.replace("*/", "* /").replace("\n", " ")
