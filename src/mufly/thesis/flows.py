"""CFD: Figs 3.21 to 3.24 and 3.40.

A Navier-Stokes solution takes hours, so none is run here. A folder of a solved case (``mufly cfd run``) can be given;
without one, what docs/cfd.md states of the cases that were run is judged, or the study says that it needs CFD.
"""

from __future__ import annotations

import functools
import math
from pathlib import Path

import numpy as np
import xarray as xr

from mufly.cfd import (
    Domain,
    blade_mesh,
    mesh_picture,
    poly_mesh,
    pressure_picture,
    read_point,
    read_poly_mesh,
    read_solution,
)
from mufly.cfd.polymesh import quality
from mufly.cfd.results import read_field
from mufly.cfd.run import times
from mufly.errors import InputError
from mufly.rotor import field_picture, load_rotor
from mufly.study import sweep
from mufly.thesis.claims import Claim, Found, Progress, Study, Verdict, figure
from mufly.thesis.single import VALUE, form_gain, form_verdict, standard_setup
from mufly.thesis.wakes import alone, tip_path
from mufly.units import RPM

LEVEL = "coarse"

# docs/cfd.md: 12 degrees, 5 000 rpm, coarse mesh: thrust (mN) of the radii from, to (mm) by CFD and by blade elements.
LOADS: dict[tuple[int, int], tuple[float, float]] = {
    (9, 30): (14.9, 18.2),
    (30, 50): (66.9, 81.8),
    (50, 55): (28.0, 30.1),
    (55, 60): (36.4, 22.3),
}


OUR_MESHES: tuple[tuple[float, ...], tuple[float, ...]] = ((61.4, 136.3, 375.7), (0.1462, 0.1475, 0.1501))
"""docs/cfd.md: 12 degrees, 5 000 rpm, laminar: thousand cells, thrust (N)."""


def setup_mesh(progress: Progress | None = None) -> Found:
    """Fig. 3.21: our mesh beside the source's three domains.

    Thesis: Fig. 3.21.
    """
    domain, rotor = Domain(), load_rotor("naca0012-r60-c20")
    mesh = poly_mesh(blade_mesh(rotor, math.radians(12), level=LEVEL, domain=domain))
    q = quality(mesh)
    above = 1e3 * domain.above * rotor.radius_m
    periodic = {"sector_left", "sector_right"} <= set(mesh.patches)
    verdicts = [
        Verdict(
            Claim(
                "Fig. 3.21",
                "half of the rotor is meshed, with periodic planes, a wall and openings",
                basis="axis",
            ),
            f"{LEVEL} mesh",
            f"one blade of {mesh.blades}; patches {', '.join(mesh.patches)}",
            periodic and mesh.blades == 2,
            "the same",
        ),
        Verdict(
            Claim("Sec. 3.3.3", "200 mm above the blade are enough", 200.0, "mm"),
            f"{LEVEL} mesh",
            f"{above:.0f} mm",
            above >= 199.9,
            "as much; that it is enough is for Fig. 3.22",
        ),
    ]
    note = (
        f"one block-structured sector of {mesh.cells} hexahedra, its inner cylinder turning and the rest "
        f"standing, where the source has a structured blade domain, an unstructured rotating and a standing one, "
        f"joined by interfaces; greatest non-orthogonality {q.non_orthogonality_deg:.0f} degrees"
    )
    drawn = mesh_picture(mesh)
    drawn.suptitle("Fig. 3.21: the sector that is meshed here")
    return Found(verdicts, drawn, note=note)


def _cases(folder: Path) -> list[Path]:
    """The folder itself, if it is a case with a state, else its subfolders that are."""
    found = []
    for one in (folder, *sorted(p for p in folder.iterdir() if p.is_dir())):
        try:
            read_point(one)
        except InputError:
            continue
        if any(t > 0 for t in times(one)):
            found.append(one)
    if not found:
        raise InputError(
            str(folder), "", "holds no solved case", "give a folder that `mufly cfd run --out` wrote"
        )
    return found


def domain_and_mesh(progress: Progress | None = None, case: Path | None = None) -> Found:
    """Fig. 3.22: thrust over the number of cells; given a folder with solved cases of several meshes.

    Thesis: Fig. 3.22.
    """
    claim = Claim(
        "Fig. 3.22",
        "thrust converges with the mesh, near 0.134 N at 12 degrees and 5 000 rpm",
        0.134,
        "N",
        "axis",
        reason="the tip vortex is still being resolved: most of what the fine mesh adds is in the outer 5 mm",
    )
    drawn = figure(6.0, 4.0)
    axes = drawn.subplots()
    axes.axhspan(0.126, 0.140, color="0.93", label="printed axis, mesh study")
    axes.set(xlabel="Cells in 1000", ylabel="Thrust (N)", title="Fig. 3.22: thrust over the mesh")
    verdicts: list[Verdict] = []
    cells, thrust = OUR_MESHES
    label = "docs/cfd.md, 12 deg, 5 000 rpm"
    if case is not None:
        solved = [(read_poly_mesh(c).cells, read_solution(c).thrust_N) for c in _cases(case)]
        cells, thrust = tuple(n / 1e3 for n, _ in sorted(solved)), tuple(t for _, t in sorted(solved))
        label = f"cases of {case.name}"
    if len(cells) > 1:
        change = 100 * abs(thrust[-1] / thrust[-2] - 1)
        verdicts.append(
            Verdict(
                claim,
                "CFD, laminar" if case is not None else "CFD, laminar (docs/cfd.md)",
                f"{', '.join(f'{t:.4f}' for t in thrust)} N with "
                f"{', '.join(f'{n:.0f}' for n in cells)} thousand cells; the last two {change:.1f} % apart",
                change < 1.0,
                "the last two within 1 %",
            )
        )
    axes.plot(cells, thrust, "o-", label=label)
    axes.set_xlim(left=0)
    axes.legend(fontsize="small")
    axes.grid(alpha=0.3)
    note = (
        "the fine mesh still drifts by 0.5 % in 400 iterations; cases of one's own: `mufly cfd study mesh --out DIR`, "
        "then `mufly thesis run fig-3.22 --case DIR`; each limit of the domain 1.5 times as far, alone or all at once, "
        "moves thrust by 0.1 % at most"
    )
    return Found(verdicts, drawn, note=note, lacking="" if verdicts else "CFD")


def pressure(progress: Progress | None = None, case: Path | None = None) -> Found:
    """Fig. 3.23: suction at tip and leading edge; of a case, or by the loads that docs/cfd.md states."""
    claim = Claim(
        "Sec. 3.3.3", "there is strong suction at the tip and at the leading edge, which adds to the lift"
    )
    if case is not None:
        folder = _cases(case)[0]
        mesh = read_poly_mesh(folder)
        found = read_solution(folder, mesh)
        faces = mesh.patch("blade")
        centre, area = mesh.face_centres[faces], mesh.face_areas[faces]
        up, R = area[:, 2] < 0.0, found.point.radius_m
        r, size = np.abs(centre[:, 1]), np.linalg.norm(area, axis=1)

        def mean(where: np.ndarray) -> float:
            return float(np.sum(found.pressure_Pa[where] * size[where]) / np.sum(size[where]))

        tip, middle, lower = mean(up & (r > 0.9 * R)), mean(up & (r < 0.6 * R)), mean(~up & (r > 0.9 * R))
        p = found.point
        where = f"CFD, {p.model}, {math.degrees(p.pitch_rad):g} deg, {p.speed_rad_s / RPM:.0f} rpm"
        verdicts = [
            Verdict(
                claim,
                where,
                f"mean pressure of the upper side {tip:.0f} Pa beyond 0.9 R, {middle:.0f} Pa within 0.6 R; "
                f"of the lower side beyond 0.9 R {lower:.0f} Pa",
                tip < 1.5 * min(middle, 0.0) and tip < lower,
                "at the tip 1.5 times as low as inboard, and below the lower side",
            ),
        ]
        drawn = pressure_picture(mesh, found)
        drawn.suptitle(f"Fig. 3.23: pressure on the blade ({where})")
        return Found(verdicts, drawn, note=f"verdict of the run: {found.verdict}")
    outer, inner = LOADS[55, 60], [sum(v[k] for (a, b), v in LOADS.items() if b <= 55) for k in (0, 1)]
    verdicts = [
        Verdict(
            claim,
            "CFD, laminar, coarse (docs/cfd.md)",
            f"at 12 degrees and 5 000 rpm the outer 5 mm carry {outer[0]:.1f} mN where blade "
            f"elements, which know no suction "
            f"of the tip vortex, have {outer[1]:.1f}; inboard {inner[0]:.0f} and {inner[1]:.0f} mN",
            outer[0] > 1.2 * outer[1] and inner[0] < inner[1],
            "more than 1.2 times at the tip, less inboard",
        ),
    ]
    drawn = figure(6.5, 4.0)
    axes = drawn.subplots()
    at = np.arange(len(LOADS))
    for k, name in enumerate(("CFD, laminar, coarse mesh", "blade elements")):
        axes.bar(at + 0.4 * k - 0.2, [v[k] / (b - a) for (a, b), v in LOADS.items()], 0.38, label=name)
    axes.set_xticks(at, [f"{a} to {b} mm" for a, b in LOADS])
    axes.set(
        ylabel="Thrust per radius (mN/mm)", title="Fig. 3.23's suction at the tip, by what docs/cfd.md states"
    )
    axes.legend()
    return Found(
        verdicts, drawn, note="the pressure itself: `mufly thesis run fig-3.23 --case DIR` with a solved case"
    )


def downwash(progress: Progress | None = None, case: Path | None = None) -> Found:
    """Fig. 3.24: the vena contracta; of a case, or of our vortex wake.

    Thesis: Fig. 3.24.
    """
    found = alone()
    r, z = tip_path(found)
    chord = 0.02
    order = np.argsort(-z)
    near, far = (float(np.interp(d, -z[order], r[order])) for d in (chord, 0.12))
    claim = Claim(
        "Sec. 3.3.3",
        "one chord below the disc the vena contracta is reached, and stays",
        20.0,
        "mm",
        reason="a free wake goes on contracting for about a radius; the source's mesh and boundary may hold it",
    )
    verdicts = [
        Verdict(
            claim,
            "wake",
            f"the tip vortex is at {near:.2f} R one chord below, at {far:.2f} R two radii below; the last "
            f"{100 * (near - far) / (1 - far):.0f} % of the contraction come later",
            abs(near / far - 1) < 0.03,
            "within 3 %",
        ),
    ]
    if case is None:
        drawn = field_picture(found, mean=True, points=60, phases=6)
        drawn.suptitle(
            "Fig. 3.24: air around the rotor by the wake method, 12 deg, 7 000 rpm", fontsize="medium"
        )
        return Found(
            verdicts, drawn, lacking="CFD", note="`mufly thesis run fig-3.24 --case DIR` with a solved case"
        )
    folder = _cases(case)[0]
    mesh = read_poly_mesh(folder)
    last = [t for t in times(folder) if t > 0][-1]
    velocity = read_field(folder / str(last) / "U", mesh.cells)
    R = read_point(folder).radius_m
    radius, height = np.hypot(*mesh.centres[:, :2].T) / R, mesh.centres[:, 2] / R

    def middle(depth: float) -> float:
        """Radius inside which half of what goes down at a depth passes, over R."""
        there = (np.abs(height + depth) < 0.1) & (radius < 2) & (velocity[:, 2] < 0)
        order = np.argsort(radius[there])
        through = np.cumsum((-velocity[there, 2] * mesh.volumes[there])[order])
        return float(radius[there][order][np.searchsorted(through, 0.5 * through[-1])])

    near, far = middle(chord / R), middle(2.0)
    verdicts.append(
        Verdict(
            claim,
            "CFD",
            f"half of the downward flow passes within {near:.2f} R one chord below, {far:.2f} R two radii below",
            abs(near / far - 1) < 0.08,
            "within 8 %",
        )
    )
    drawn = figure(6.5, 5.5)
    axes = drawn.subplots()
    speed = np.linalg.norm(velocity, axis=1)
    shown = (radius < 2.5) & (height > -4) & (height < 2)
    dots = axes.scatter(radius[shown], height[shown], c=speed[shown], s=2, cmap="viridis")
    drawn.colorbar(dots, ax=axes, label="Speed (m/s)")
    axes.set(xlabel="r / R", ylabel="z / R", title=f"Fig. 3.24: speed in all cells of {folder.name}")
    return Found(verdicts, drawn)


def winglets(progress: Progress | None = None) -> Found:
    """Fig. 3.40: the standard blade by blade elements, winglets by CFD as docs/cfd.md states it.

    Thesis: Fig. 3.40.
    """
    pitch = np.arange(12.0, 20.1, 0.5)
    base = standard_setup("full", "naca0012-r60-c20")
    values = sweep(base, {"pitch": [float(p) for p in np.radians(pitch)]})[VALUE].values
    best = float(pitch[int(np.nanargmax(values))])
    verdicts = [
        Verdict(
            Claim("Sec. 3.4.6", "the standard blade is best at about 18 degrees", 18.0, "deg"),
            "full",
            f"{best:g} degrees",
            abs(best - 18) <= 2,
            "within 2 degrees",
        ),
        form_verdict(("winglet-1",), "winglet 1 does not outperform the standard blade", "Sec. 3.4.6"),
        *(
            Verdict(
                Claim(
                    "Sec. 3.4.6",
                    f"winglet {which} outperforms the standard blade",
                    reason="its size and how it stands are guessed; a straight one meets the air askew",
                ),
                "CFD, laminar, coarse (docs/cfd.md)",
                f"winglet-{which} {form_gain(f'winglet-{which}'):+.1f} % of T^1.5/P at 16 degrees and 5 000 rpm",
                form_gain(f"winglet-{which}") > 0.0,
                "above zero",
            )
            for which in (2, 3)
        ),
    ]
    drawn = figure(6.5, 4.0)
    axes = drawn.subplots()
    axes.plot(pitch, values, ".-", label="standard blade, blade elements")
    axes.axvline(18, color="0.5", linestyle=":", label="source: best pitch of the standard blade")
    axes.axvline(20, color="C3", linestyle=":", label="source: winglets 2 and 3 are best beyond")
    axes.set(
        xlabel="Pitch angle (deg)",
        ylabel="Thrust / electrical power (N/W)",
        title="Fig. 3.40: winglets need CFD",
    )
    axes.legend(fontsize="small")
    axes.grid(alpha=0.3)
    data = xr.Dataset({VALUE: ("pitch_deg", values)}, coords={"pitch_deg": pitch})
    return Found(
        verdicts,
        drawn,
        {"full": data},
        "no sizes of the winglets are printed; what our guesses give by CFD: docs/cfd.md; where a blade "
        "with winglets is best was not run",
        "CFD",
    )


CASES = {
    "fig-3.22": domain_and_mesh,
    "fig-3.23": pressure,
    "fig-3.24": downwash,
}
"""Studies that take a folder of solved cases."""


def with_case(name: str, case: Path) -> Found:
    """Compute a study from a folder of solved cases.

    Raises
    ------
    InputError
        If the study takes none, or the folder holds none.
    """
    if name not in CASES:
        raise InputError("thesis", name, "takes no case", f"use --case with one of: {', '.join(CASES)}")
    if not case.is_dir():
        raise InputError(str(case), "", "is no folder", "give a folder that `mufly cfd run --out` wrote")
    return CASES[name](None, case)


STUDIES: dict[str, Study] = {
    "fig-3.22": Study(functools.partial(domain_and_mesh), 0.1),
    "fig-3.23": Study(functools.partial(pressure), 0.1),
    "fig-3.40": Study(winglets, 2),
    "fig-3.21": Study(setup_mesh, 6),
    "fig-3.24": Study(functools.partial(downwash), 12),
}
