"""Reader of blade tables: radius, chord and angle as text, UIUC's geometry files and APC's files.

A table is any text that :func:`mufly.files.text_table.read_text_table` reads. Columns are recognised by name; the unit
stands in the header. A length without unit is an error. Angles without unit are in degrees; if all of them could be
radians, a missing unit is an error. Stations run from hub to tip or from tip to hub.

=========  ===================================================================================================
radius     ``r/R``, ``r_over_R``, ``x``; or a length: ``r_mm``, ``radius (in)``, ``station``
chord      ``c/R``, ``c_over_R``; or a length: ``chord_mm``, ``c [in]``
angle      ``beta``, ``twist``, ``angle``, ``pitch``
thickness  ``t/c``, ``thickness (%)``; or a length: ``thickness_mm``; optional
airfoil    ``airfoil``, ``section``: a name for each station; optional
=========  ===================================================================================================

APC's ``...-PERF.PE0`` files name radius, number of blades, and for each station chord (inches), thickness ratio and
twist (degrees). Below the table stand the airfoil inside a first radius and the airfoil outside a second. In between,
the contours are blended in proportion to the radius, in steps of :data:`APC_BLEND_STEP`. Thickness ratios become
``blade.thickness`` of the rotor file, also where the file names no airfoils.
APC's radius is rounded to a hundredth of an inch; a last station within that distance is the tip. Airfoils without
published coordinates (such as ``APC12``) are replaced by NACA 4412, which APC calls similar; a note reports it.
Stations with a chord below a thousandth of the radius at either end, as at pointed tips, are left out, and the last
remaining station holds to the tip. Between others such a chord, and a negative chord anywhere, is an error.
"""

from __future__ import annotations

import math
import re
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mufly.errors import ArgumentError, InputError
from mufly.files.text_table import read_text_table
from mufly.quantities.units import (
    list_compatible_units,
    normalise_unit,
    split_header,
    split_unit_suffix,
    unit_conversion,
)
from mufly.rotor.geometry import GeometrySource, Rotor, rotor_from_tables
from mufly.rotor.sections.airfoil import MAX_THICKNESS_RATIO, load_airfoil, name_blended_airfoil

Array = NDArray[np.float64]

_RATIO_COLUMN_HEADERS = {"radius": ("r/r", "r_over_r", "x", "r_r"), "chord": ("c/r", "c_over_r", "c_r")}
_LENGTH_COLUMN_HEADERS = {"radius": ("r", "radius", "station"), "chord": ("c", "chord")}
_ANGLE_COLUMN_HEADERS, _AIRFOIL_HEADERS = ("beta", "twist", "angle", "pitch", "theta"), ("airfoil", "section")
_THICKNESS_HEADERS, _THICKNESS_RATIO_HEADERS = ("t", "thickness"), ("t/c", "t_c", "t_over_c")
_INCH_M = 0.0254
_DEFAULT_AIRFOIL = "naca4412"
_DEFAULT_AIRFOIL_NOTE = f"airfoil {_DEFAULT_AIRFOIL}"
_MIN_PLAUSIBLE_MAX_ANGLE_DEG = 1.6  # angles all below this value may be radians
_MAX_STATION_RADIUS_RATIO = 1.5  # of the radius
_MIN_PLAUSIBLE_RADIUS_M, _MAX_PLAUSIBLE_RADIUS_M = 5e-3, 20.0  # m; the greatest helicopter's is 16 m
_MIN_CHORD_RATIO = 1e-3  # of the radius
APC_BLEND_STEP = 0.05
"""Step of the share of the outer airfoil in blended sections. It bounds the number of blends by 21; thrust and torque
of a blade from E63 to Clark Y differ by up to 0.03 % from those without steps, and by 0.13 % with a step of 0.25."""


class ImportedRotor(NamedTuple):
    """Imported rotor, with notes on the values that were guessed."""

    rotor: Rotor
    notes: tuple[str, ...]


def import_rotor(
    path: str | Path,
    *,
    radius_m: float | None = None,
    blades: int | None = None,
    airfoil: str | None = None,
    name: str | None = None,
    geometry: GeometrySource | None = None,
    nominal_pitch_m: float | None = None,
) -> ImportedRotor:
    """Read a rotor from a table of stations, UIUC's geometry or APC's ``PE0``.

    Parameters
    ----------
    path : str or Path
    radius_m : float, optional
        Radius of the rotor (m); required if the file gives ratios only. Default: the last station's radius.
    blades : int, optional
        Number of blades. Default: the file's, or 2.
    airfoil : str, optional
        Airfoil of the whole blade; overrides the file. Default: the file's, or NACA 4412.
    name : str, optional
        Name of the rotor. Default: the file's.
    geometry : str, optional
        Source of the geometry. Default: ``maker`` for APC's files, ``photograph`` for UIUC's tables.
    nominal_pitch_m : float, optional
        Pitch that the maker states (m). Default: that in the name of a UIUC table.

    Raises
    ------
    InputError
        If the format is not recognised, a column is missing, or a value is impossible.
    """
    where = Path(path).name
    if geometry is None and Path(path).suffix.lower() == ".pe0":
        geometry = "maker"
    if radius_m is not None and not 0.0 < radius_m < 100.0:
        raise ArgumentError("radius", f"{radius_m:g} m", "is out of range", "give more than 0 and less than 100 m")
    notes: list[str] = []
    if Path(path).suffix.lower() == ".pe0":
        table = _read_apc_file(Path(path), notes)
    else:
        table = _read_station_table(path, radius_m, notes)
        if _is_uiuc_table(path):
            stated = find_stated_pitch(Path(path).stem, table.radius_m)
            if geometry is None:
                geometry = "photograph"
                notes.append("a table of UIUC: its angles are taken from photographs")
            if nominal_pitch_m is None and stated is not None:
                nominal_pitch_m = stated
                notes.append(f"the file name states a pitch of {1e3 * stated:.1f} mm, which shifts the predicted pitch")
    r, chord, twist, foils, thick, radius, count = table
    _check_stations(where, r, chord, twist, thick)
    radius = radius_m or radius
    if not _MIN_PLAUSIBLE_RADIUS_M <= radius <= _MAX_PLAUSIBLE_RADIUS_M:
        raise InputError(
            where, "", f"the radius would be {1e3 * radius:.3g} mm", "correct the unit of the radii"
        )  # fmt: skip
    if r.size > 1 and np.all(np.diff(r) < 0.0):
        r, chord, twist, foils = r[::-1], chord[::-1], twist[::-1], foils[::-1]
        thick = None if thick is None else thick[::-1]
        notes.append("the stations run from tip to hub and were reversed")
    if airfoil is not None:
        foils = [airfoil]
        notes = [n for n in notes if not n.startswith(_DEFAULT_AIRFOIL_NOTE)]
    for foil in dict.fromkeys(foils):
        load_airfoil(foil)
    inside, wide = r <= radius * (1 + 1e-6), chord > _MIN_CHORD_RATIO * radius
    _check_inner_chords(where, r[inside], chord[inside], radius)
    keep = inside & wide
    if not keep.all():
        notes.append(f"{int((~keep).sum())} station(s) beyond the tip or without chord omitted")
    if keep.sum() < 2 <= inside.sum():
        problem = (
            f"is at most {1e3 * float(chord[inside].max()):.3g} mm: too narrow for a radius of {1e3 * radius:.3g} mm"
        )
        raise InputError(where, "chord", problem, "check both, and their units")
    if keep.sum() < 2:
        raise InputError(where, "", "has fewer than two stations within the radius", "check radius and units")
    r, chord, twist = r[keep], chord[keep], twist[keep]
    foils = [f for f, k in zip(foils, keep, strict=True) if k] if len(foils) > 1 else foils
    thick = None if thick is None else thick[keep]
    x = r / radius
    if x[-1] < 1.0 - 1e-6:
        notes.append(f"the last station ({x[-1]:.3f} R) is held to the tip")
        x, chord, twist = np.append(x, 1.0), np.append(chord, chord[-1]), np.append(twist, twist[-1])
        foils = [*foils, foils[-1]] if len(foils) > 1 else foils
        thick = None if thick is None else np.append(thick, thick[-1])
    x[-1] = 1.0
    blades = blades or count
    if blades is None:
        blades = 2
        notes.append("two blades assumed, since the file does not state the number")
    source = {"source": "datasheet", "note": f"from {where}"}
    rotor = rotor_from_tables(
        {
            "name": name or Path(path).stem.lower(),
            "description": f"from {where}",
            "blades": blades,
            "radius": {"value": radius, "unit": "m", **source},
            **({} if nominal_pitch_m is None else {"nominal_pitch": {"value": nominal_pitch_m, "unit": "m", **source}}),
            "hub_cutout": {"value": float(min(max(x[0], 0.0), 0.9)), "unit": "1", "source": "estimated",
                           "note": "the first station"},
            "blade": {
                "r_over_R": {"value": x.tolist(), "unit": "1", **source},
                "chord": {"value": chord.tolist(), "unit": "m", **source},
                "twist": {"value": twist.tolist(), "unit": "rad", **source},
                "airfoils": foils if len(set(foils)) > 1 else foils[:1],
                **({} if thick is None else {"thickness": {"value": thick.tolist(), "unit": "1", **source}}),
                **({} if geometry is None else {"geometry": geometry}),
            },
        },
        where,
    )  # fmt: skip
    return ImportedRotor(rotor, tuple(notes))


_STATED_PITCH_PATTERN = re.compile(r"_(\d+(?:\.\d+)?)x(\d+(?:\.\d+)?)|_(?P<deg>\d+(?:\.\d+)?)deg")


def find_stated_pitch(name: str, radius_m: float) -> float | None:
    """Return the pitch (m) that the name of a UIUC file states, or None.

    A name as 5x3 or 96x70 states diameter and pitch in the same unit, 15deg the blade angle at 0.75 R.
    """
    found = _STATED_PITCH_PATTERN.search(name)
    if found is None or (found[1] and float(found[1]) == 0.0):
        return None
    if found["deg"]:
        return 1.5 * math.pi * radius_m * math.tan(math.radians(float(found["deg"])))
    return 2.0 * radius_m * float(found[2]) / float(found[1])


def _is_uiuc_table(path: str | Path) -> bool:
    """Return whether a table is UIUC's: named so in its text or file name, or in UIUC's form."""
    table = read_text_table(path)
    if table.separator == " " and table.header == ["r/R", "c/R", "beta"]:
        return True
    text = Path(path).read_text(encoding="utf-8", errors="ignore")
    return "UIUC" in text or Path(path).stem.lower().endswith("_geom")


def _check_stations(where: str, r: Array, chord: Array, twist: Array, thickness: Array | None) -> None:
    """Raise an error that names the first station with a value that is not finite, or with a negative chord."""
    columns = {"radius": (r, 1e3, "mm"), "chord": (chord, 1e3, "mm"), "angle": (np.degrees(twist), 1.0, "degrees")}
    if thickness is not None:
        columns["thickness"] = (thickness, 100.0, "%")
    for k in range(r.size):
        for key, (values, scale, unit) in columns.items():
            value = scale * float(values[k])
            known = math.isfinite(value) or (key == "thickness" and chord[k] == 0.0)
            if not known or (key == "chord" and value < 0.0):
                place = f"station {k + 1} at r = {1e3 * r[k]:.4g} mm" if key != "radius" else f"station {k + 1}"
                must = "a chord above 0, or delete the station" if key == "chord" else "a finite number"
                raise InputError(where, f"{place}, {key}", f"is {value:.4g} {unit}", f"give {must}")


def _check_inner_chords(where: str, r: Array, chord: Array, radius_m: float) -> None:
    """Raise an error for a chord below a thousandth of the radius between stations with a wider one."""
    narrow = chord <= _MIN_CHORD_RATIO * radius_m
    wide = np.flatnonzero(~narrow)
    for k in np.flatnonzero(narrow):
        if wide.size and wide[0] < k < wide[-1]:
            raise InputError(
                where, f"station at r = {1e3 * r[k]:.4g} mm, chord", f"is {1e3 * chord[k]:.4g} mm between wider chords",
                "correct the value or its unit, or delete the station",
            )  # fmt: skip


def read_caliper_readings(path: str | Path) -> tuple[Array, Array, Array, Array]:
    """Return radius (m), chord (m), angle (rad) and thickness over chord of a table of readings, (n,) arrays.

    Rows without chord and angle are left out; a thickness that is not given is nan.

    Raises
    ------
    InputError
        As for :func:`import_rotor`, or if a chord is not above 0.
    """
    r, chord, twist, _, thick, *_ = _read_station_table(path, None, [], optional=True)
    filled = np.isfinite(chord) & np.isfinite(twist)
    for k in np.flatnonzero(filled & ~(chord > 0.0))[:1]:
        place = f"row {k + 1} at r = {1e3 * r[k]:.4g} mm, chord"
        raise InputError(Path(path).name, place, f"is {1e3 * chord[k]:.4g} mm", "correct or delete the row")
    return r[filled], chord[filled], twist[filled], (np.full(r.size, math.nan) if thick is None else thick)[filled]


class _StationTable(NamedTuple):
    """Blade stations as read from a file, with the rotor's radius (m) and number of blades.

    Each station has radius and chord (m), twist (rad) and thickness over chord; ``airfoils`` has one name, or one for
    each station.
    """

    r_m: Array
    chord_m: Array
    twist_rad: Array
    airfoils: list[str]
    thickness: Array | None
    radius_m: float
    blades: int | None


def _read_station_table(
    path: str | Path, radius_m: float | None, notes: list[str], *, optional: bool = False
) -> _StationTable:
    where = Path(path).name
    written = read_text_table(path)
    headers = written.column_titles
    known: dict[str, tuple[int, float]] = {}  # quantity: column and SI factor (negative: ratio to R)
    for k, header in enumerate(headers):
        stem, unit = split_header(header)
        stem, unit = (stem, unit) if unit else split_unit_suffix(stem)  # here c_m is a chord in m, not a coefficient
        if not unit and stem.lower().endswith(("_in", "_inch")):
            stem, unit = stem.rpartition("_")[0], "in"  # "in" at the end of a name means inches here only
        low, whole = stem.lower(), header.lower()
        for quantity in ("radius", "chord"):
            if whole in _RATIO_COLUMN_HEADERS[quantity]:
                known.setdefault(quantity, (k, -1.0))
            elif low in _LENGTH_COLUMN_HEADERS[quantity]:
                if unit not in list_compatible_units("m"):
                    said = f"has the unit {unit!r}" if unit else "has no unit"
                    raise InputError(
                        where, header, said, f"give a unit of length, for example {stem}_mm or {stem} (in)"
                    )
                known.setdefault(quantity, (k, unit_conversion(unit, "m")[1]))
        if low in _ANGLE_COLUMN_HEADERS or whole in _ANGLE_COLUMN_HEADERS:
            if unit and not normalise_unit(unit, "rad"):
                raise InputError(where, header, f"has the unit {unit!r}", f"give an angle, as {stem}_deg or {stem}_rad")
            known.setdefault("twist", (k, unit_conversion(unit or "deg", "rad")[1]))
        if low in _THICKNESS_HEADERS or low in _THICKNESS_RATIO_HEADERS:
            ratio = low in _THICKNESS_RATIO_HEADERS
            if ratio or unit in list_compatible_units("1"):
                known.setdefault("thickness", (k, -unit_conversion(unit or "1", "1")[1]))
            elif unit in list_compatible_units("m"):
                known.setdefault("thickness", (k, unit_conversion(unit, "m")[1]))
            elif low == "thickness":
                raise InputError(where, header, "has no unit", "name it t/c, thickness (%) or thickness_mm")
        if whole in _AIRFOIL_HEADERS:
            known.setdefault("airfoil", (k, 1.0))
    for quantity, example in (("radius", "r/R or r_mm"), ("chord", "c/R or chord_mm"), ("twist", "beta_deg")):
        if quantity not in known:
            raise InputError(where, quantity, f"is not among the columns ({', '.join(headers)})", f"name it {example}")
    if radius_m is None and min(known["radius"][1], known["chord"][1]) < 0.0:
        raise ArgumentError("radius", "", "is not known: the file gives ratios", "give the rotor's radius")

    def scaled_column(quantity: str) -> Array:
        index, factor = known[quantity]
        scale = factor if factor > 0.0 else radius_m or math.nan
        return scale * written.read_numbers(index, optional=optional)

    r, chord, twist = scaled_column("radius"), scaled_column("chord"), scaled_column("twist")
    _check_column_units(where, {q: headers[k] for q, (k, _) in known.items()}, known, r, chord, twist, radius_m)
    thick = None
    if "thickness" in known:
        index, factor = known["thickness"]
        with np.errstate(divide="ignore", invalid="ignore"):  # a pointed tip
            scale = -factor if factor < 0.0 else factor / chord
            thick = written.read_numbers(index, optional=optional) * scale
        for k in np.flatnonzero((chord > 0.0) & ((thick <= 0.0) | (thick > MAX_THICKNESS_RATIO)))[:1]:
            raise InputError(
                where, f"line {written.lines[k]}, {headers[index]}",
                f"is {100 * thick[k]:.5g} %: not above 0 and up to {100 * MAX_THICKNESS_RATIO:g} % of the chord, "
                f"{1e3 * chord[k]:.4g} mm", "correct one of the two, or its unit",
            )  # fmt: skip
    if "airfoil" in known:
        foils = written.read_texts(known["airfoil"][0])
    else:
        foils = [_DEFAULT_AIRFOIL]
        notes.append(f"{_DEFAULT_AIRFOIL_NOTE}, since the file names none; `mufly rotor fit` asks a bench for it")
    return _StationTable(r, chord, twist, foils, thick, radius_m or float(r.max(initial=0.0)), None)


def _check_column_units(
    where: str, header: dict[str, str], known: dict[str, tuple[int, float]], r: Array, chord: Array, twist: Array,
    radius_m: float | None,
) -> None:  # fmt: skip
    """Raise an error for angles that may be radians, and for r/R above one, as in per cent."""
    widest = float(np.max(np.abs(np.degrees(twist)), initial=0.0))
    if not split_header(header["twist"])[1] and 0.0 < widest <= _MIN_PLAUSIBLE_MAX_ANGLE_DEG:
        least = float(np.min(np.degrees(twist)))
        raise InputError(
            where, header["twist"], f"goes from {least:.4g} to {widest:.4g} without a unit: degrees or radians?",
            "name the column twist_rad or twist_deg",
        )  # fmt: skip
    for quantity, values in (("radius", r), ("chord", chord)):
        share = float(np.max(values, initial=0.0)) / (radius_m or math.nan)
        if known[quantity][1] < 0.0 and share > _MAX_STATION_RADIUS_RATIO:
            raise InputError(
                where, header[quantity], f"reaches {share:.4g}: not a share of the radius", "write 0.15 for 15 %"
            )


def _read_apc_file(path: Path, notes: list[str]) -> _StationTable:
    where = path.name
    try:
        lines = path.read_text(encoding="latin-1").splitlines()
    except OSError as error:
        raise InputError(where, "", f"cannot be read ({error.strerror})", "give a PE0 file") from error
    text = "\n".join(lines)
    head = next((k for k, line in enumerate(lines) if line.split()[:2] == ["STATION", "CHORD"]), None)
    radius, count = re.search(r"RADIUS:\s*([\d.]+)", text), re.search(r"BLADES:\s*(\d+)", text)
    if head is None or radius is None:
        raise InputError(where, "", "has no table of STATION and CHORD, or no RADIUS", "give APC's ...-PERF.PE0")
    names = lines[head].split()
    table: list[list[float]] = []
    for line in lines[head + 1 :]:
        cells = line.split()
        try:
            values = [float(c) for c in cells]
        except ValueError:
            if table:
                break
            continue
        if values and len(values) != len(names):
            raise InputError(where, line.strip()[:40], f"has {len(values)} numbers", f"there are {len(names)} columns")
        if values:
            table.append(values)
        elif table:
            break
    if "TWIST" not in names or len(table) < 2:
        raise InputError(where, "", "has no stations with a TWIST", "give APC's ...-PERF.PE0")
    data = np.array(table)
    r = _INCH_M * data[:, names.index("STATION")]
    ends = [re.search(rf"AIRFOIL{k}:\s*([\d.]+)\s*(?:,|\(IN\)),?\s*([^\s(,]+(?: \d+)?)", text) for k in (1, 2)]
    foils, thick = [_DEFAULT_AIRFOIL], None
    if "THICKNESS" in names:
        thick = np.clip(data[:, names.index("THICKNESS")], 0.01, MAX_THICKNESS_RATIO)
    if all(ends):
        (from_m, inner), (to_m, outer) = (
            (_INCH_M * float(e[1]), _resolve_airfoil(e[2], notes)) for e in ends if e is not None
        )
        share = np.clip((r - from_m) / max(to_m - from_m, 1e-9), 0.0, 1.0)
        share = APC_BLEND_STEP * np.floor(share / APC_BLEND_STEP + 0.5 + 1e-9)
        foils = [name_blended_airfoil(inner, outer, s) for s in share.tolist()]
        if inner != outer:
            notes.append(f"{inner} blends into {outer} from {1e3 * from_m:.1f} to {1e3 * to_m:.1f} mm")
    else:
        of = "" if thick is None else " with the file's thickness"
        notes.append(f"{_DEFAULT_AIRFOIL_NOTE}{of} assumed, since the file names none")
    chord, twist = _INCH_M * data[:, names.index("CHORD")], np.radians(data[:, names.index("TWIST")])
    whole = _INCH_M * float(radius[1])
    if whole < float(r.max()) <= whole + 0.005 * _INCH_M:
        whole = float(r.max())
    return _StationTable(r, chord, twist, foils, thick, whole, int(count[1]) if count else None)


def _resolve_airfoil(name: str, notes: list[str]) -> str:
    """Return the name of the airfoil that an APC file names, or of the default airfoil if it is not published."""
    low = re.sub(r"[\s-]", "", name.lower())
    if low == "clarky":
        return low
    try:
        load_airfoil(low)
    except InputError:
        notes.append(f"{name} is not published: replaced by {_DEFAULT_AIRFOIL}")
        return _DEFAULT_AIRFOIL
    return low
