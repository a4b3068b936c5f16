"""The measured rotors in ../shared/data/aero as rotors of mufly, and what is assumed of their sections.

Sections of the propellers are not recorded. What is assumed of each (``SECTIONS``) was written down before any
result was seen, with one exception: the GWS propellers were at first taken as thin plates like the others (all
17: c_T 15.6 %, c_P 17.4 %), and then, seeing that the shallowest was far off, as what moulded thermoplastic
blades are, flat-bottomed.
"""

from __future__ import annotations

import csv
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from mufly.rotor import Air, Blading, Corrections, Measurements, Rotor, compare, load_airfoil, polars, prepare
from mufly.rotor.sections.airfoil import sides

DATA = Path(__file__).resolve().parents[2] / "shared" / "data" / "aero"
RPM = np.pi / 30
AIR = Air(1.2, 1.81e-5)

# Deters, Ananda, Selig: Reynolds Number Effects on the Performance of Small-Scale Propellers, AIAA 2014-2151, Table 4.
SDA1075 = """
1.000137 .005557 .996593 .005916 .986424 .007201 .970307 .009369 .948605 .012241 .921585 .015743 .889621 .019963
.853243 .024878 .813012 .030409 .769531 .036448 .723430 .042837 .675369 .049377 .625945 .055764 .575694 .061768
.525145 .067169 .474806 .071778 .425168 .075411 .376692 .077929 .329814 .079200 .284932 .079143 .242417 .077694
.202594 .074839 .165758 .070588 .132147 .065010 .101982 .058221 .075425 .050381 .052643 .041731 .033775 .032527
.018960 .023081 .008287 .013758 .001894 .005047 .000280 -.001921 .004701 -.007905 .015056 -.014217 .030301 -.020208
.050355 -.025609 .075069 -.030290 .104265 -.034146 .137711 -.037140 .175126 -.039253 .216177 -.040503 .260479
-.040926 .307602 -.040585 .357073 -.039554 .408381 -.037928 .460985 -.035812 .514304 -.033341 .567727 -.030638
.620617 -.027832 .672308 -.025029 .722150 -.022300 .769510 -.019711 .813783 -.017302 .854396 -.015105 .890816
-.013128 .922559 -.011366 .949178 -.009777 .970411 -.008207 .986204 -.006742 .996295 -.005793 .999851 -.005553
"""

# Begin of a propeller's name: section, and whether it is known.
SECTIONS = {
    "da40": ("sda1075", True),  # published with its coordinates
    "nr640": ("clarky@0.09", True),  # NACA Report 640: Clark Y, about 9 % thick over the outer half
    "apcff": ("naca4412", False),  # APC's own pages: close to NACA 4412 and Clark Y
    "gwsdd": ("clarky@0.08", False),  # moulded thermoplastic, flat-bottomed; 1 mm on 12 mm of chord
    "mi_": ("naca5503", False),  # thin sheet or shell, cambered: 5 % camber, 3 % thick
    "mit": ("naca5503", False),
    "pl_": ("naca5503", False),
    "kpf": ("naca5503", False),
    "vp_": ("naca5503", False),
    "dji9443": ("naca5503", False),
    "tmotor28": (
        "goe450",
        False,
    ),  # stand-ins that came with the data: GOE 450, GOE 408 at the two outermost stations
}


@dataclass(frozen=True)
class Case:
    """A rotor and its measurements; pitch settings are in ``measured``, twist in the rotor."""

    name: str
    group: str
    rotor: Rotor
    known: bool
    measured: Measurements
    air: Air


def rows_of(path: Path) -> np.ndarray:
    lines = [
        line for line in path.read_text().splitlines() if line and (line[0].isdigit() or line[0] in "-.")
    ]
    return np.array([[float(v) for v in line.split(",")] for line in lines])


def _rotor(
    name: str, blades: int, radius: float, x0: float, x: object, c: object, deg: object, *foils: str
) -> Rotor:
    def q(value: object, unit: str) -> dict[str, object]:
        values = tuple(np.asarray(value, dtype=float)) if np.ndim(value) else float(value)
        return {"value": values, "unit": unit, "source": "measured"}

    blade = {
        "r_over_R": q(x, "1"),
        "chord": q(c, "m"),
        "twist": q(np.radians(deg), "rad"),
        "airfoils": foils,
    }
    return Rotor(name=name, blades=blades, radius=q(radius, "m"), hub_cutout=q(x0, "1"), blade=blade)


def section_file(section: str, folder: Path) -> str:
    """Name or file of a section; ``clarky@0.09`` is Clark Y scaled to 9 % of thickness."""
    name, _, thickness = section.partition("@")
    path = folder / f"{section.replace('@', '-')}.dat"
    if name == "sda1075":
        xy = np.array(SDA1075.split(), dtype=float).reshape(-1, 2)
    elif thickness:
        xy = load_airfoil(name).coordinates.copy()
        upper, lower = sides(xy)
        x = np.linspace(0.01, 0.99, 197)
        xy[:, 1] *= float(thickness) / np.max(np.interp(x, *upper.T) - np.interp(x, *lower.T))
    else:
        return name
    path.write_text(section + "\n" + "\n".join(f"{a:.6f} {b:.6f}" for a, b in xy) + "\n")
    return str(path)


def _section_of(name: str) -> tuple[str, bool]:
    return next(v for k, v in SECTIONS.items() if name.startswith(k))


def _measured(source: str, pitch_deg: object, rpm: object, thrust: object, torque: object) -> Measurements:
    parts = np.broadcast_arrays(
        *(np.atleast_1d(np.asarray(v, dtype=float)) for v in (pitch_deg, rpm, thrust, torque))
    )
    pitch, speed, t, q = (np.array(p) for p in parts)
    return Measurements(np.radians(pitch), speed * RPM, t, q, source)


def table_3_2(data: Path = DATA) -> Case:
    """The dissertation's rotor with its four measured points."""
    m = rows_of(data / "thesis_table_3_2.csv")
    rotor = _rotor("naca0012-r60-c20", 2, 0.06, 0.15, (0.15, 1), (0.02, 0.02), (0, 0), "naca0012")
    return Case(
        rotor.name, "Table 3.2", rotor, True, _measured("Table 3.2", m[:, 0], m[:, 1], m[:, 2], m[:, 3]), AIR
    )


def propellers(folder: Path, data: Path = DATA) -> list[Case]:
    """The 17 propellers of the UIUC data set, volume 2."""
    home = data / "uiuc_micro"
    index = [line for line in (home / "index.csv").read_text().splitlines() if not line.startswith("#")]
    out = []
    for row in csv.DictReader(index):
        name, radius = row["name"], float(row["diameter_m"]) / 2
        g = rows_of(home / row["geometry"])
        m = rows_of(home / f"{name}_static.csv")
        section, known = _section_of(name)
        rotor = _rotor(
            name,
            int(row["blades"]),
            radius,
            0.15,
            g[:, 0],
            g[:, 1] * radius,
            g[:, 2],
            section_file(section, folder),
        )
        n, d = m[:, 0] / 60, 2 * radius
        thrust, torque = m[:, 1] * 1.2 * n**2 * d**4, m[:, 2] / (2 * np.pi) * 1.2 * n**2 * d**5
        out.append(Case(name, "UIUC", rotor, known, _measured(name, 0.0, m[:, 0], thrust, torque), AIR))
    return out


def others(folder: Path, data: Path = DATA) -> list[Case]:
    """DJI 9443, Caradonna and Tung, T-motor 28 inch."""
    c, t = rows_of(data / "dji9443_chord.csv"), rows_of(data / "dji9443_twist.csv")
    dji = _rotor(
        "dji9443", 2, 0.12, 0.1, c[:, 0], c[:, 1] * 0.12, np.interp(c[:, 0], *t.T), SECTIONS["dji9443"][0]
    )
    air = Air(1.071778, 1.85508e-5)
    cases = [
        Case(
            "dji9443",
            "DJI 9443",
            dji,
            False,
            _measured("dji9443", 0, 5400, 0.072 * air.density_kg_m3 * 90**2 * 0.24**4, np.nan),
            air,
        )
    ]
    m = rows_of(data / "caradonna_tung_ct.csv")
    radius = 1.143
    ct = _rotor("caradonna-tung", 2, radius, 0.2, (0.2, 1), (0.1905, 0.1905), (0, 0), "naca0012")
    thrust = m[:, 1] * 1.2 * np.pi * radius**4 * (1250 * RPM) ** 2
    cases.append(
        Case(
            "caradonna-tung",
            "Caradonna-Tung",
            ct,
            True,
            _measured("Caradonna-Tung", m[:, 0], 1250, thrust, np.nan),
            AIR,
        )
    )
    m = rows_of(data / "tmotor28_single.csv")
    cases.append(
        Case(
            "tmotor28",
            "T-motor 28",
            t_motor(),
            False,
            _measured("T-motor 28", 0, m[:, 0], m[:, 3], m[:, 4]),
            T_MOTOR_AIR,
        )
    )
    return cases


T_MOTOR_AIR = Air(1.225, 1.81e-5)  # of its source's own case file


def t_motor() -> Rotor:
    """The 28 inch rotor, sections as its source's case file has them, the tip as its last measured station."""
    r = np.array([3.556, 7.112, 10.668, 14.224, 17.78, 21.336, 24.892, 28.448, 32.004, 35.56]) / 100
    chord = np.array([31, 56, 70, 70, 65, 58, 50, 43, 34, 34]) / 1000
    deg = np.array([0, 19.6, 17.9, 14.4, 11.6, 9.7, 8.4, 7.2, 6.7, 6.7])
    foils = [SECTIONS["tmotor28"][0]] * 7 + ["goe408"] * 3
    return _rotor("tmotor28", 2, 0.3556, 0.07 / 0.3556, r / 0.3556, chord, deg, *foils)


REYNOLDS = np.geomspace(1e3, 3e6, 36)  # the 1.1 m rotor reaches 2e6


def blading_of(
    case: Case, corrections: Corrections | None = None, n_crit: float = 0.1, section: str = ""
) -> Blading:
    """Lay a case out, with polars up to its Reynolds numbers."""
    names = case.rotor.airfoil_names()
    tables = polars(list(names), n_crit=n_crit, reynolds=REYNOLDS)
    if section:
        tables = dict.fromkeys(names, polars([section], n_crit=n_crit, reynolds=REYNOLDS)[section])
    return prepare(case.rotor, tables, corrections=corrections)


def errors(
    case: Case, corrections: Corrections | None = None, n_crit: float = 0.1, section: str = ""
) -> tuple[np.ndarray, np.ndarray]:
    """Relative errors of thrust and torque at every point."""
    out = compare(blading_of(case, corrections, n_crit, section), case.measured, air=case.air)
    return out.thrust_error, out.torque_error
