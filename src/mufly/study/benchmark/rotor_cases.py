"""Measured rotors of the benchmark: geometry, assumed sections, and measured points.

Measurements are read from a folder with the following layout; each set may lie in a folder below it. Missing data sets
are skipped and reported with their source, because some may not be redistributed.

* ``uiuc_micro/``: ``index.csv`` (name, diameter_m, blades, geometry), ``*_geom.csv``, ``*_static.csv``.
* ``*_geom.txt``, ``*_static*``: UIUC's own files, anywhere below the folder: the propellers of all its volumes.
* ``NAME_RUN_RPM.txt``: UIUC's runs in the tunnel (J, CT, CP), anywhere below the folder.
* ``thesis_table_3_2.csv``: pitch (deg), rpm, thrust (N), torque (N m).
* ``caradonna_tung_ct.csv``: pitch (deg), c_T.
* ``dji9443_chord.csv, _twist``: chord and twist along the blade, over R and in degrees.
* ``tmotor28_single.csv``: rpm, -, -, thrust (N), torque (N m).
* ``rotors/NAME.toml``, ``.csv``: a user's rotor file and its points, as for `mufly rotor compare`.

The sections of the propellers are unknown. The assumptions (:data:`SECTION_BY_PREFIX`) were made without knowledge of
the results, except for the GWS propellers: their flat-bottomed section was chosen after a comparison. Trailing edges of
moulded, printed and formed blades have the thickness :data:`TRAILING_EDGE_THICKNESS_M`.
"""

from __future__ import annotations

import math
import re
import tempfile
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mufly.bench import read_measurements
from mufly.errors import InputError, MuflyError
from mufly.files.text_table import read_text_table
from mufly.quantities.units import RPM
from mufly.rotor import Air, Rotor, RotorMeasurements, import_rotor, load_rotor, replace_rotor, rotor_from_tables
from mufly.rotor.blades.blade_files import find_stated_pitch
from mufly.rotor.blades.body_import import rotor_from_body

Array = NDArray[np.float64]

BENCHMARK_AIR = Air(1.2, 1.81e-5)
T_MOTOR_AIR = Air(1.225, 1.81e-5)
"""Air of the T-Motor measurements, from their case file."""

# Prefix of a propeller's name: family, section, and whether the section is known.
SECTION_BY_PREFIX: dict[str, tuple[str, str, bool]] = {
    "da40": ("DA40x2, printed", "sda1075", True),  # published with its coordinates
    "nr640": (
        "NR640, printed",
        "clarky+scaled9",
        True,
    ),  # NACA Report 640: Clark Y, 9 % thick over the outer half
    "apcff": ("APC", "naca4412", False),  # APC's own pages: close to NACA 4412 and Clark Y
    # The same pages: thin electric, slow-fly and multi-rotor blades blend E63 (inboard) with Clark Y (outboard)
    "apce": ("APC thin", "e63>clarky", False),
    "apcsf": ("APC thin", "e63>clarky", False),
    "apcmr": ("APC thin", "e63>clarky", False),
    # and the zero-lift angle of the others is one degree beyond that of NACA 4412 and Clark Y
    "apc": ("APC", "naca5412", False),
    "gwssf": ("GWS slow-flyer", "naca5503", False),  # cambered plates
    "gwsdd": ("GWS", "clarky+scaled8", False),  # moulded, flat-bottomed; 1 mm on 12 mm of chord
    "gws": ("GWS", "clarky+scaled8", False),
    "mi_": ("Micro Invent", "naca5503", False),  # thin sheet or shell, cambered: 5 % camber, 3 % thick
    "mit": ("Micro Invent", "naca5503", False),
    "pl_": ("Plantraco", "naca5503", False),
    "kpf": ("KP", "naca5503", False),
    "vp_": ("Vapor", "naca5503", False),
    "dji9443": ("DJI", "naca5503", False),
    "tmotor28": (
        "T-motor",
        "goe450",
        False,
    ),  # substitutes named by the source: GOE 450, and GOE 408 at the two outermost stations
}
_DEFAULT_SECTION = ("other", "naca4412", False)
TRAILING_EDGE_THICKNESS_M = 3e-4
"""Trailing edge thickness of propellers (m), limited by moulding and printing; an estimate, not measured."""

DATA_SOURCES = {
    "uiuc_micro": "UIUC Propeller Data Site, volume 2: https://m-selig.ae.illinois.edu/props/volume-2/propDB-volume-2.html",
    "thesis_table_3_2.csv": "Schafroth, ETH No. 18901, 2010, Table 3.2: https://doi.org/10.3929/ethz-a-006084909",
    "caradonna_tung_ct.csv": "Caradonna, Tung, NASA TM-81232, 1981: https://ntrs.nasa.gov/citations/19820004169",
    "dji9443_chord.csv": "FLOWUnsteady, data/rotors/DJI9443*: https://github.com/byuflowlab/FLOWUnsteady",
    "tmotor28_single.csv": "pyBEMT, examples: https://github.com/kegiljarhus/pyBEMT",
}
"""Sources of the data sets in the folder."""

_MAX_LISTED_REASONS = 8  # in an error about a folder
_FETCH_REMEDY = f"fetch measurements, as {DATA_SOURCES['uiuc_micro']}, and name theirs"


@dataclass(frozen=True)
class RotorCase:
    """Measured rotor of the benchmark; its pitch settings are in ``measured``, its twist is in ``rotor``.

    Attributes
    ----------
    name, group, family : str
        ``group``: rotors that are scored together. ``family``: maker or series. Rotors of a family are similar, so fits
        are scored on held-out families.
    rotor : Rotor
    section_known : bool
        True if the section is known, false if it is a guess.
    measured : RotorMeasurements
    air : Air
    tunnel_runs : tuple of RotorMeasurements
        Tunnel runs, each at one rotor speed, in order of increasing airspeed.
    turbulence_intensity : float
        Turbulence of the tunnel, rms over mean speed. UIUC's is below 0.1 % (Brandt and Selig, AIAA 2011-1255).
    """

    name: str
    group: str
    family: str
    rotor: Rotor
    section_known: bool
    measured: RotorMeasurements
    air: Air = BENCHMARK_AIR
    tunnel_runs: tuple[RotorMeasurements, ...] = ()
    turbulence_intensity: float = 0.001


def load_cases(folder: Path, only: str = "") -> tuple[list[RotorCase], list[str]]:
    """Read all measured rotors of the benchmark from a folder.

    Parameters
    ----------
    folder : Path
        Folder with the layout of the module docstring.
    only : str
        Comma-separated parts of names or groups; empty for all.

    Returns
    -------
    cases : list of RotorCase
    missing : list of str
        Missing data sets with their sources, and skipped files with the reason.

    Raises
    ------
    InputError
        If the folder does not exist or contains no selected rotor.
    """
    if not folder.is_dir():
        raise InputError(
            "--data",
            str(folder),
            "is not a folder",
            _FETCH_REMEDY,
        )
    left_out: list[str] = []
    readers: dict[str, Callable[[Path], list[RotorCase]]] = {
        "thesis_table_3_2.csv": lambda f: [load_table_3_2(f)],
        "uiuc_micro": lambda f: load_uiuc_propellers(f, left_out),
        "dji9443_chord.csv": lambda f: [load_dji_9443(f)],
        "caradonna_tung_ct.csv": lambda f: [load_caradonna_tung(f)],
        "tmotor28_single.csv": lambda f: [load_t_motor_28(f)],
    }
    cases, missing = [], []
    for name, read in readers.items():
        found = min(folder.rglob(name), key=lambda path: (len(path.parts), path), default=None)
        if found is None:
            missing.append(f"{name}: {DATA_SOURCES[name]}")
            continue
        try:
            cases += read(found.parent)
        except MuflyError as error:
            left_out.append(str(error))
    known = {case.name for case in cases}
    cases += [
        c for c in (*load_uiuc_files(folder, left_out), *load_own_rotors(folder, left_out)) if c.name not in known
    ]
    missing += left_out
    words = [w.strip().lower() for w in only.split(",") if w.strip()]
    chosen = [c for c in cases if not words or any(w in f"{c.name} {c.group}".lower() for w in words)]
    chosen = [replace(c, tunnel_runs=tuple(load_tunnel_runs(folder, c, missing))) for c in chosen]
    if not chosen:
        if not cases:
            raise InputError(
                "--data", str(folder), f"contains no measurements in a known format{_list_reasons(left_out)}",
                "correct these files" if left_out else _FETCH_REMEDY,
            )  # fmt: skip
        names = ", ".join(sorted({c.group for c in cases}))
        reasons = _list_reasons([text for text in left_out if any(w in text.lower() for w in words)])
        raise InputError("--only", only, f"matches no name of a rotor or group{reasons}", f"choose from {names}")
    return chosen, missing


def _list_reasons(left_out: list[str]) -> str:
    """Return the reasons why files were skipped, as the continuation of an error."""
    more = len(left_out) - _MAX_LISTED_REASONS
    listed = [*left_out[:_MAX_LISTED_REASONS], *([f"and {more} more"] if more > 0 else [])]
    return f"; skipped: {' | '.join(listed)}" if listed else ""


def find_propeller_section(name: str) -> tuple[str, str, bool]:
    """Return family and section of a propeller by its name, and whether the section is known."""
    return next((v for k, v in SECTION_BY_PREFIX.items() if name.startswith(k)), _DEFAULT_SECTION)


def _airfoils_by_station(section: str, x: Array) -> tuple[str, ...]:
    """Return the airfoil of each station; ``a>b`` means a on the inner half of the radius and b on the outer half."""
    inner, both, outer = section.partition(">")
    return tuple(inner if at < 0.5 else outer for at in x) if both else (inner,)


def _build_rotor(
    name: str, blades: int, radius: float, x0: float, x: ArrayLike, c: ArrayLike, deg: ArrayLike, *foils: str,
    where: str = "",
) -> Rotor:  # fmt: skip
    def quantity_table(value: ArrayLike, unit: str) -> dict[str, object]:
        numbers = np.asarray(value, dtype=np.float64)
        return {
            "value": tuple(numbers) if numbers.ndim else float(numbers),
            "unit": unit,
            "source": "measured",
        }

    blade = {
        "r_over_R": quantity_table(x, "1"),
        "chord": quantity_table(c, "m"),
        "twist": quantity_table(np.radians(np.asarray(deg)), "rad"),
        "airfoils": foils,
    }
    return rotor_from_tables(
        {
            "name": name,
            "blades": blades,
            "radius": quantity_table(radius, "m"),
            "hub_cutout": quantity_table(x0, "1"),
            "blade": blade,
        },
        where or name,
    )


def _build_measurements(
    source: str, pitch_deg: ArrayLike, rpm: ArrayLike, thrust: ArrayLike, torque: ArrayLike
) -> RotorMeasurements:
    parts = np.broadcast_arrays(*(np.atleast_1d(np.asarray(v, dtype=float)) for v in (pitch_deg, rpm, thrust, torque)))
    pitch, speed, t, q = (np.array(p) for p in parts)
    return RotorMeasurements(np.radians(pitch), speed * RPM, t, q, source)


def load_table_3_2(folder: Path) -> RotorCase:
    """Load the dissertation's rotor with its four measured points."""
    m = read_text_table(folder / "thesis_table_3_2.csv").read_matrix(4)
    rotor = _build_rotor("naca0012-r60-c20", 2, 0.06, 0.15, (0.15, 1), (0.02, 0.02), (0, 0), "naca0012")
    points = _build_measurements("Table 3.2", *m.T)
    return RotorCase(rotor.name, "Table 3.2", "dissertation", rotor, True, points)


def load_uiuc_propellers(folder: Path, left_out: list[str] | None = None) -> list[RotorCase]:
    """Load the 17 propellers of the UIUC data set, volume 2; blades begin at 0.15 R.

    A propeller whose files cannot be used is named in ``left_out`` with the reason; without the list it is an error.
    """
    home = folder / "uiuc_micro"
    index = read_text_table(home / "index.csv")
    columns = {name: index.find_column_index(name) for name in ("name", "diameter_m", "blades", "geometry")}
    rows = {name: index.read_texts(k) for name, k in columns.items()}
    out = []
    for k, name in enumerate(rows["name"]):
        try:
            diameter, blades = (
                index.parse_finite_cell(k, columns[key], rows[key][k]) for key in ("diameter_m", "blades")
            )
            if diameter <= 0.0 or blades != int(blades):
                key, must = ("blades", "a whole number") if diameter > 0.0 else ("diameter_m", "above 0")
                place = f"line {index.lines[k]}, {key}"
                raise InputError(index.where, place, f"is {rows[key][k]}", f"it must be {must}")
            out.append(_load_indexed_propeller(home, name, diameter, int(blades), rows["geometry"][k]))
        except MuflyError as error:
            if left_out is None:
                raise
            left_out.append(f"{name}: {error}")
    return out


def _load_indexed_propeller(home: Path, name: str, diameter: float, blades: int, geometry: str) -> RotorCase:
    radius = diameter / 2
    g = read_text_table(home / geometry).read_matrix(3)
    table = read_text_table(home / f"{name}_static.csv")
    m = table.read_matrix(3)
    for row, column in np.argwhere(~(m > 0.0))[:1]:
        place = f"line {table.lines[row]}, {table.header[column]}"
        raise InputError(table.where, place, f"is {m[row, column]:g}", "it must be above 0")
    if not m.size:
        raise InputError(table.where, "", "contains no measurements", "give a header and at least one line")
    family, section, known = find_propeller_section(name)
    foils = _airfoils_by_station(section, g[:, 0])
    rotor = _build_rotor(
        name, blades, radius, 0.15, g[:, 0], g[:, 1] * radius, g[:, 2], *foils, where=str(home / geometry)
    )
    rotor = replace_rotor(
        rotor,
        {"trailing_edge": TRAILING_EDGE_THICKNESS_M, **_find_photographed_rotor_values(name, radius)},
        source="estimated",
    )
    n, d = m[:, 0] / 60, 2 * radius
    rho = BENCHMARK_AIR.density_kg_m3
    thrust, torque = m[:, 1] * rho * n**2 * d**4, m[:, 2] / (2 * np.pi) * rho * n**2 * d**5
    return RotorCase(name, "UIUC micro", family, rotor, known, _build_measurements(name, 0.0, m[:, 0], thrust, torque))


def _find_photographed_rotor_values(name: str, radius_m: float) -> dict[str, object]:
    """Return values for the rotor file of a UIUC propeller: source of the geometry, and pitch stated in the name."""
    pitch = find_stated_pitch(name, radius_m)
    return {"blade.geometry": "photograph", **({} if pitch is None else {"nominal_pitch": pitch})}


_INCH_M = 0.0254
_STATED_DIAMETER_PATTERN = re.compile(r"_(\d+(?:\.\d+)?)(?:x\d|_\d+deg)")


def load_uiuc_files(folder: Path, left_out: list[str]) -> Iterator[RotorCase]:
    """Load UIUC's files, pairs of ``NAME_geom.txt`` and ``NAME_static_RUN.txt``, anywhere below a folder.

    The first number in a name is the diameter, in inches below 30 and in millimetres above. ``_3b`` before ``_static``
    marks a propeller with three of the blades. A file that cannot be used is named in ``left_out`` with the reason.
    """
    used: set[Path] = set()
    for geometry, more in product(sorted(folder.rglob("*_geom.txt")), ("", "_3b", "_4b")):
        name = geometry.name.removesuffix("_geom.txt") + more
        runs = sorted(geometry.parent.glob(f"{name}_static*.txt"))
        size, several = _STATED_DIAMETER_PATTERN.search(name), re.search(r"_(\d)b(_|$)", name)
        blades = int(several[1]) if several else 2
        used |= {geometry, *runs} if runs else set()
        if size is not None and float(size[1]) == 0.0:
            size = None
        if runs and size is None:
            left_out.append(
                f"{geometry.name}: the file name states no size; name the file as MAKER_9x5_geom.txt, in inches or mm"
            )
        if not runs or size is None:
            continue
        diameter = float(size[1]) * (_INCH_M if float(size[1]) < 30.0 else 1e-3)
        family, section, known = find_propeller_section(name)
        try:
            rotor = _read_best_geometry(geometry, name, diameter, blades, section, left_out)
            points = [
                read_measurements(run, diameter_m=diameter, density_kg_m3=BENCHMARK_AIR.density_kg_m3) for run in runs
            ]
            pitch, speed, thrust, torque = (
                np.concatenate([getattr(p, k) for p in points]) for k in _MEASUREMENT_FIELDS
            )
        except MuflyError as error:
            left_out.append(f"{name}: {error}")
            continue
        group = "UIUC micro" if diameter < 0.18 else "UIUC"
        yield RotorCase(name, group, family, rotor, known, RotorMeasurements(pitch, speed, thrust, torque, name))
    for file in sorted((*folder.rglob("*_geom.txt"), *folder.rglob("*_static*.txt"))):
        if file not in used:
            other = "NAME_static_RUN.txt" if file.name.endswith("_geom.txt") else "NAME_geom.txt"
            left_out.append(f"{file.name}: there is no {other} beside it")


def _read_best_geometry(
    photographed: Path, name: str, diameter_m: float, blades: int, section: str, left_out: list[str]
) -> Rotor:
    """Return the rotor of a propeller from the best geometry file in the folder of ``photographed``.

    A scan ``NAME.stl`` comes first, then the maker's ``NAME.PE0`` or APC's own file of that size, which have their own
    sections, then ``photographed``.
    """
    beside = {p.suffix.lower(): p for p in photographed.parent.glob(f"{name}.*")}
    values: dict[str, object] = {"hub_cutout": 0.15, "trailing_edge": TRAILING_EDGE_THICKNESS_M}
    values |= _find_photographed_rotor_values(name, 0.5 * diameter_m)
    if ".stl" in beside:
        with tempfile.TemporaryDirectory() as contours:  # chord and twist alone are used
            rotor = rotor_from_body(beside[".stl"], folder=contours, blades=blades, name=name)[0]
        values["blade.geometry"] = "scan"
    elif (makers := beside.get(".pe0") or _find_apc_file(photographed.parent, name, diameter_m, left_out)) is not None:
        rotor = import_rotor(makers, blades=blades, name=name).rotor
        values["blade.geometry"] = "maker"
    else:
        rotor = import_rotor(photographed, radius_m=0.5 * diameter_m, blades=blades, name=name).rotor
    if values["blade.geometry"] != "maker":
        values["blade.airfoils"] = _airfoils_by_station(section, rotor.blade.r_over_R.to_si_array())
    return replace_rotor(rotor, values, source="estimated")


_APC_FILE_PATTERN = re.compile(r"(\d+)x(\d+)([a-z]*)-perf", re.IGNORECASE)
_APC_SERIES_SUFFIX = {"apce": "e", "apcsf": "sf", "apcmr": "mr"}  # prefix of UIUC's name: letters behind APC's size
_MAX_APC_RADIUS_DIFFERENCE_RATIO = 0.02


def _find_apc_file(folder: Path, name: str, diameter_m: float, left_out: list[str]) -> Path | None:
    """Return APC's ``SIZE[SERIES]-PERF.PE0`` of a propeller of APC in a folder, or None.

    APC leaves out the points of a size: 42x4 is 4.2x4, 10x47SF is apcsf_10x4.7. A file of the propeller's series is
    preferred; a file without series is used if no other propeller of APC in the folder has its size. The radius in the
    file has to agree. ``left_out`` names files that were used or that are ambiguous.
    """
    size = re.match(r"(apc[a-z0-9]*)_(\d+(?:\.\d+)?x\d+(?:\.\d+)?)", name)
    if size is None:
        return None
    series, digits = size[1], size[2].replace(".", "")
    found: dict[str, Path] = {}
    for file in sorted(p for p in folder.iterdir() if p.suffix.lower() == ".pe0"):
        parts = _APC_FILE_PATTERN.fullmatch(file.stem)
        if parts is not None and f"{parts[1]}x{parts[2]}" == digits:
            found[parts[3].lower()] = file
    own = _APC_SERIES_SUFFIX.get(series, "")
    chosen = found.get(own) or found.get("")
    if chosen is None:
        left_out += [f"{f.name}: is of another series than {name} and was not used" for f in found.values()]
        return None
    rivals = set()
    for other in folder.glob("apc*_geom.txt"):
        parts = re.match(r"([a-z0-9]+)_([\d.]+x[\d.]+)", other.name)
        suffixed = parts is not None and parts[1] in _APC_SERIES_SUFFIX
        if parts is not None and parts[2].replace(".", "") == digits and (own or not suffixed):
            rivals.add(other.name.removesuffix("_geom.txt"))
    rivals.discard(re.sub(r"_\db$", "", name))
    if rivals and (chosen is not found.get(own) or not own):
        left_out.append(f"{chosen.name}: fits {name} and {', '.join(sorted(rivals))}; rename it {name}.PE0 to use it")
        return None
    radius = import_rotor(chosen, name=name).rotor.radius_m
    if abs(2.0 * radius / diameter_m - 1.0) > _MAX_APC_RADIUS_DIFFERENCE_RATIO:
        left_out.append(f"{chosen.name}: has a radius of {1e3 * radius:.1f} mm, {name} of {500 * diameter_m:.1f} mm")
        return None
    left_out.append(f"{name}: geometry from {chosen.name}, by its size")
    return chosen


_MEASUREMENT_FIELDS = ("pitch_rad", "speed_rad_s", "thrust_N", "torque_Nm")


def load_tunnel_runs(folder: Path, case: RotorCase, left_out: list[str]) -> Iterator[RotorMeasurements]:
    """Load UIUC's tunnel runs of a propeller, ``NAME_RUN_RPM.txt`` with the columns J, CT, CP.

    A file that cannot be read is named in ``left_out`` with the reason.
    """
    named = re.compile(re.escape(case.name) + r"_(?!static)[^_]+_(\d+)")
    for file in sorted(folder.rglob(f"{case.name}_*.txt")):
        found = named.fullmatch(file.stem)
        if found is not None:
            try:
                run = read_measurements(
                    file, diameter_m=2.0 * case.rotor.radius_m, density_kg_m3=case.air.density_kg_m3,
                    speed_rad_s=float(found[1]) * RPM,
                )  # fmt: skip
            except MuflyError as error:
                left_out.append(f"{file.name}: {error}")
                continue
            yield run.select_points(np.argsort(run.climb_m_s, kind="stable"))


def load_dji_9443(folder: Path) -> RotorCase:
    """Load the 240 mm rotor with one hover point: c_T 0.072 (propellers' convention) at 5400 rpm (Zawodny et al., AHS
    2016)."""
    c = read_text_table(folder / "dji9443_chord.csv").read_matrix(2)
    t = read_text_table(folder / "dji9443_twist.csv").read_matrix(2)
    family, section, _ = find_propeller_section("dji9443")
    twist = np.interp(c[:, 0], *t.T)
    rotor = _build_rotor("dji9443", 2, 0.12, 0.1, c[:, 0], c[:, 1] * 0.12, twist, section)
    air = Air(1.071778, 1.85508e-5)
    thrust = 0.072 * air.density_kg_m3 * 90**2 * 0.24**4
    return RotorCase(
        "dji9443",
        "DJI 9443",
        family,
        rotor,
        False,
        _build_measurements("dji9443", 0, 5400, thrust, math.nan),
        air,
    )


def load_caradonna_tung(folder: Path) -> RotorCase:
    """Load Caradonna and Tung's rotor: two blades, NACA 0012, 1.1 m radius, 1250 rpm: Reynolds number 2e6, Mach 0.44 at
    the tip."""
    m, radius = read_text_table(folder / "caradonna_tung_ct.csv").read_matrix(2), 1.143
    rotor = _build_rotor("caradonna-tung", 2, radius, 0.2, (0.2, 1), (0.1905, 0.1905), (0, 0), "naca0012")
    thrust = m[:, 1] * BENCHMARK_AIR.density_kg_m3 * np.pi * radius**4 * (1250 * RPM) ** 2
    points = _build_measurements("Caradonna-Tung", m[:, 0], 1250, thrust, math.nan)
    return RotorCase("caradonna-tung", "Caradonna-Tung", "Caradonna-Tung", rotor, True, points)


def make_t_motor_rotor() -> Rotor:
    """Return the 28 inch T-motor rotor with the sections of pyBEMT's case file; the tip repeats the last station."""
    r = np.array([3.556, 7.112, 10.668, 14.224, 17.78, 21.336, 24.892, 28.448, 32.004, 35.56]) / 100
    chord = np.array([31, 56, 70, 70, 65, 58, 50, 43, 34, 34]) / 1000
    deg = np.array([0, 19.6, 17.9, 14.4, 11.6, 9.7, 8.4, 7.2, 6.7, 6.7])
    foils = [find_propeller_section("tmotor28")[1]] * 7 + ["goe408"] * 3
    return _build_rotor("tmotor28", 2, 0.3556, 0.07 / 0.3556, r / 0.3556, chord, deg, *foils)


def load_t_motor_28(folder: Path) -> RotorCase:
    """Load the isolated 28 inch rotor with 30 speeds."""
    rpm, _, _, thrust, torque = read_text_table(folder / "tmotor28_single.csv").read_matrix(5).T
    points = _build_measurements("T-motor 28", 0, rpm, thrust, torque)
    return RotorCase("tmotor28", "T-motor 28", "T-motor", make_t_motor_rotor(), False, points, T_MOTOR_AIR)


def load_own_rotors(folder: Path, left_out: list[str]) -> Iterator[RotorCase]:
    """Load the pairs of rotor file ``NAME.toml`` and bench points ``NAME.csv`` in ``rotors/``.

    A file that cannot be used, or whose units were guessed, is named in ``left_out`` with the reason.
    """
    for file in sorted((folder / "rotors").glob("*.toml")):
        points = file.with_suffix(".csv")
        if not points.exists():
            left_out.append(f"rotors/{file.name}: there is no {points.name} beside it")
            continue
        try:
            rotor = load_rotor(str(file))
            bench = read_measurements(
                points, diameter_m=2.0 * rotor.radius_m, density_kg_m3=BENCHMARK_AIR.density_kg_m3
            )
        except MuflyError as error:
            left_out.append(f"rotors/{file.name}: {error}")
            continue
        left_out += [f"rotors/{points.name}: {note}" for note in bench.notes]
        yield RotorCase(rotor.name, "own", f"own {rotor.name}", rotor, True, bench)
