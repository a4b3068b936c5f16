"""CFD studies: Figs 3.21 to 3.24 and 3.40.

A Navier-Stokes solution takes hours, so none is computed here. A folder of a solved case (``mufly cfd run``) can be
given. Without one, the study judges the results stated in docs/explanation/cfd.md, or reports that it needs CFD.
"""

from __future__ import annotations

import functools
import math
from pathlib import Path

import numpy as np
import xarray as xr

from mufly.cfd import (
    MeshDomain,
    draw_mesh,
    draw_surface_pressure,
    make_poly_mesh,
    make_sector_mesh,
    read_operating_point,
    read_poly_mesh,
    read_solution,
)
from mufly.cfd.cfd_solution import read_field
from mufly.cfd.meshes.polymesh import measure_mesh_quality
from mufly.cfd.solver_process import list_complete_states
from mufly.errors import InputError
from mufly.quantities.units import RPM
from mufly.results.result_figure import blank_figure
from mufly.rotor import draw_flow_field, load_rotor
from mufly.study import sweep_parameters
from mufly.thesis.claims import ProgressCallback, Study, StudyFindings, Verdict, judge
from mufly.thesis.single_rotor_studies import (
    RANKED_OUTPUT_NAME,
    compute_blade_form_gain_percent,
    judge_blade_forms,
    make_standard_setup,
)
from mufly.thesis.wake_studies import find_tip_vortex_path, solve_single_rotor

STUDY_MESH_LEVEL = "coarse"

# docs/log/2026-11-28-cfd-table-3-2.md: 12 degrees, 5 000 rpm, coarse mesh: thrust (mN) of the radii from,
# to (mm) by CFD and by blade elements.
_TIP_STRIP_RADII_MM = (55, 60)
STRIP_LOADS_MN: dict[tuple[int, int], tuple[float, float]] = {
    (9, 30): (14.9, 18.2),
    (30, 50): (66.9, 81.8),
    (50, 55): (28.0, 30.1),
    _TIP_STRIP_RADII_MM: (36.4, 22.3),
}


OUR_MESH_CONVERGENCE: tuple[tuple[float, ...], tuple[float, ...]] = (
    (61.4, 136.3, 375.7),
    (0.1462, 0.1475, 0.1501),
)
"""docs/log/2026-11-28-cfd-table-3-2.md: 12 degrees, 5 000 rpm, laminar: thousand cells, thrust (N)."""


def study_mesh_setup(progress: ProgressCallback | None = None) -> StudyFindings:
    """Fig. 3.21: this package's mesh beside the dissertation's three domains.

    Thesis: Fig. 3.21.
    """
    domain, rotor = MeshDomain(), load_rotor("naca0012-r60-c20")
    mesh = make_poly_mesh(make_sector_mesh(rotor, math.radians(12), level=STUDY_MESH_LEVEL, domain=domain))
    q = measure_mesh_quality(mesh)
    above = 1e3 * domain.above * rotor.radius_m
    periodic = {"sector_left", "sector_right"} <= set(mesh.patches)
    verdicts = [
        judge(
            "fig-3.21/half-of-the-rotor-is-meshed",
            f"{STUDY_MESH_LEVEL} mesh",
            f"one blade of {mesh.blade_count}; patches {', '.join(mesh.patches)}",
            blade_count=mesh.blade_count,
            holds=periodic,
        ),
        judge("fig-3.21/200-mm-above-the-blade-are", f"{STUDY_MESH_LEVEL} mesh", f"{above:.0f} mm", above=above),
    ]
    note = (
        f"one block-structured sector of {mesh.cell_count} hexahedra, its inner cylinder turning and the rest "
        f"standing, where the source has a structured blade domain, an unstructured rotating and a standing one, "
        f"joined by interfaces; greatest non-orthogonality {q.non_orthogonality_deg:.0f} degrees"
    )
    drawn = draw_mesh(mesh)
    drawn.suptitle("Fig. 3.21: the sector that is meshed here")
    return StudyFindings(verdicts, drawn, note=note)


def _find_solved_cases(folder: Path) -> list[Path]:
    """Return the solved cases among a folder and its subfolders."""
    found = []
    for one in (folder, *sorted(p for p in folder.iterdir() if p.is_dir())):
        try:
            read_operating_point(one)
        except InputError:
            continue
        if any(t > 0 for t in list_complete_states(one)):
            found.append(one)
    if not found:
        raise InputError(str(folder), "", "contains no solved case", "give a folder that `mufly cfd run --out` wrote")
    return found


def study_mesh_convergence(progress: ProgressCallback | None = None, case: Path | None = None) -> StudyFindings:
    """Fig. 3.22: thrust over the number of cells, from a folder with solved cases of several meshes.

    Thesis: Fig. 3.22.
    """
    drawn = blank_figure(6.0, 4.0)
    axes = drawn.subplots()
    axes.axhspan(0.126, 0.140, color="0.93", label="printed axis, mesh study")
    axes.set(xlabel="Cells in 1000", ylabel="Thrust (N)", title="Fig. 3.22: thrust over the mesh")
    verdicts: list[Verdict] = []
    cells, thrust = OUR_MESH_CONVERGENCE
    label = "docs/explanation/cfd.md, 12 deg, 5 000 rpm"
    if case is not None:
        solved = [(read_poly_mesh(c).cell_count, read_solution(c).thrust_N) for c in _find_solved_cases(case)]
        cells, thrust = tuple(n / 1e3 for n, _ in sorted(solved)), tuple(t for _, t in sorted(solved))
        label = f"cases of {case.name}"
    if len(cells) > 1:
        change = 100 * abs(thrust[-1] / thrust[-2] - 1)
        verdicts.append(
            judge(
                "fig-3.22/thrust-converges-with-the-mesh-near",
                "CFD, laminar" if case is not None else "CFD, laminar (docs/explanation/cfd.md)",
                f"{', '.join(f'{t:.4f}' for t in thrust)} N with "
                f"{', '.join(f'{n:.0f}' for n in cells)} thousand cells; the last two {change:.1f} % apart",
                change=change,
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
    return StudyFindings(verdicts, drawn, note=note, missing="" if verdicts else "CFD")


def study_surface_pressure(progress: ProgressCallback | None = None, case: Path | None = None) -> StudyFindings:
    """Fig. 3.23: suction at tip and leading edge, from a solved case or from the loads in docs/explanation/cfd.md."""
    if case is not None:
        folder = _find_solved_cases(case)[0]
        mesh = read_poly_mesh(folder)
        found = read_solution(folder, mesh)
        faces = mesh.patch_face_slice("blade")
        centre, area = mesh.face_centres[faces], mesh.face_areas[faces]
        up, R = area[:, 2] < 0.0, found.point.radius_m
        r, size = np.abs(centre[:, 1]), np.linalg.norm(area, axis=1)

        def mean_pressure(where: np.ndarray) -> float:
            return float(np.sum(found.pressure_Pa[where] * size[where]) / np.sum(size[where]))

        tip = mean_pressure(up & (r > 0.9 * R))
        middle = mean_pressure(up & (r < 0.6 * R))
        lower = mean_pressure(~up & (r > 0.9 * R))
        p = found.point
        where = f"CFD, {p.model}, {math.degrees(p.pitch_rad):g} deg, {p.speed_rad_s / RPM:.0f} rpm"
        verdicts = [
            judge(
                "fig-3.23/there-is-strong-suction-at-the-2",
                where,
                f"mean pressure of the upper side {tip:.0f} Pa beyond 0.9 R, {middle:.0f} Pa within 0.6 R; "
                f"of the lower side beyond 0.9 R {lower:.0f} Pa",
                holds=(tip < 1.5 * min(middle, 0.0)) and (tip < lower),
            ),
        ]
        drawn = draw_surface_pressure(mesh, found)
        drawn.suptitle(f"Fig. 3.23: pressure on the blade ({where})")
        return StudyFindings(verdicts, drawn, note=f"verdict of the run: {found.verdict}")
    outer = STRIP_LOADS_MN[_TIP_STRIP_RADII_MM]
    inner = [sum(v[k] for (a, b), v in STRIP_LOADS_MN.items() if b <= _TIP_STRIP_RADII_MM[0]) for k in (0, 1)]
    verdicts = [
        judge(
            "fig-3.23/there-is-strong-suction-at-the",
            "CFD, laminar, coarse (docs/explanation/cfd.md)",
            f"at 12 degrees and 5 000 rpm the outer 5 mm carry {outer[0]:.1f} mN where blade "
            f"elements, which know no suction "
            f"of the tip vortex, have {outer[1]:.1f}; inboard {inner[0]:.0f} and {inner[1]:.0f} mN",
            holds=(outer[0] > 1.2 * outer[1]) and (inner[0] < inner[1]),
        ),
    ]
    drawn = blank_figure(6.5, 4.0)
    axes = drawn.subplots()
    at = np.arange(len(STRIP_LOADS_MN))
    for k, name in enumerate(("CFD, laminar, coarse mesh", "blade elements")):
        axes.bar(at + 0.4 * k - 0.2, [v[k] / (b - a) for (a, b), v in STRIP_LOADS_MN.items()], 0.38, label=name)
    axes.set_xticks(at, [f"{a} to {b} mm" for a, b in STRIP_LOADS_MN])
    axes.set(
        ylabel="Thrust per radius (mN/mm)",
        title=("Fig. 3.23's suction at the tip, by what docs/explanation/cfd.md states"),
    )
    axes.legend()
    return StudyFindings(
        verdicts, drawn, note="the pressure itself: `mufly thesis run fig-3.23 --case DIR` with a solved case"
    )


def study_downwash(progress: ProgressCallback | None = None, case: Path | None = None) -> StudyFindings:
    """Fig. 3.24: contraction of the stream below the rotor, from a solved case or by the wake method.

    Thesis: Fig. 3.24.
    """
    found = solve_single_rotor()
    r, z = find_tip_vortex_path(found)
    chord = 0.02
    order = np.argsort(-z)
    near, far = (float(np.interp(d, -z[order], r[order])) for d in (chord, 0.12))
    verdicts = [
        judge(
            "fig-3.24/one-chord-below-the-disc-the",
            "wake",
            f"the tip vortex is at {near:.2f} R one chord below, at {far:.2f} R two radii below; the last "
            f"{100 * (near - far) / (1 - far):.0f} % of the contraction come later",
            near=abs(near / far - 1),
        ),
    ]
    if case is None:
        drawn = draw_flow_field(found, mean=True, points=60, phases=6)
        drawn.suptitle("Fig. 3.24: air around the rotor by the wake method, 12 deg, 7 000 rpm", fontsize="medium")
        return StudyFindings(
            verdicts, drawn, missing="CFD", note="`mufly thesis run fig-3.24 --case DIR` with a solved case"
        )
    folder = _find_solved_cases(case)[0]
    mesh = read_poly_mesh(folder)
    last = [t for t in list_complete_states(folder) if t > 0][-1]
    velocity = read_field(folder / str(last) / "U", mesh.cell_count)
    R = read_operating_point(folder).radius_m
    radius, height = np.hypot(*mesh.cell_centres[:, :2].T) / R, mesh.cell_centres[:, 2] / R

    def half_flow_radius(depth: float) -> float:
        """Return the radius (over R) that contains half of the downward flow through a plane at a depth (over R)."""
        there = (np.abs(height + depth) < 0.1) & (radius < 2) & (velocity[:, 2] < 0)
        order = np.argsort(radius[there])
        through = np.cumsum((-velocity[there, 2] * mesh.cell_volumes[there])[order])
        return float(radius[there][order][np.searchsorted(through, 0.5 * through[-1])])

    near, far = half_flow_radius(chord / R), half_flow_radius(2.0)
    verdicts.append(
        judge(
            "fig-3.24/one-chord-below-the-disc-the-2",
            "CFD",
            f"half of the downward flow passes within {near:.2f} R one chord below, {far:.2f} R two radii below",
            near=abs(near / far - 1),
        )
    )
    drawn = blank_figure(6.5, 5.5)
    axes = drawn.subplots()
    speed = np.linalg.norm(velocity, axis=1)
    shown = (radius < 2.5) & (height > -4) & (height < 2)
    dots = axes.scatter(radius[shown], height[shown], c=speed[shown], s=2, cmap="viridis")
    drawn.colorbar(dots, ax=axes, label="Speed (m/s)")
    axes.set(xlabel="r / R", ylabel="z / R", title=f"Fig. 3.24: speed in all cells of {folder.name}")
    return StudyFindings(verdicts, drawn)


def study_winglets(progress: ProgressCallback | None = None) -> StudyFindings:
    """Fig. 3.40: the standard blade by blade elements, and winglets by CFD with results in docs/explanation/cfd.md.

    Thesis: Fig. 3.40.
    """
    pitch = np.arange(12.0, 20.1, 0.5)
    base = make_standard_setup("full", "naca0012-r60-c20")
    values = sweep_parameters(base, {"pitch": [float(p) for p in np.radians(pitch)]})[RANKED_OUTPUT_NAME].values
    best = float(pitch[int(np.nanargmax(values))])
    verdicts = [
        judge("fig-3.40/the-standard-blade-is-best-at", "full", f"{best:g} degrees", best=best),
        judge_blade_forms(("winglet-1",), "fig-3.40/winglet-1"),
        *(
            judge(
                f"fig-3.40/winglet-{which}",
                "CFD, laminar, coarse (docs/explanation/cfd.md)",
                f"winglet-{which} {compute_blade_form_gain_percent(f'winglet-{which}'):+.1f} % of T^1.5/P at 16 "
                f"degrees and 5 000 rpm",
                gain=compute_blade_form_gain_percent(f"winglet-{which}"),
            )
            for which in (2, 3)
        ),
    ]
    drawn = blank_figure(6.5, 4.0)
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
    data = xr.Dataset({RANKED_OUTPUT_NAME: ("pitch_deg", values)}, coords={"pitch_deg": pitch})
    return StudyFindings(
        verdicts,
        drawn,
        {"full": data},
        "no sizes of the winglets are printed; what our guesses give by CFD: docs/explanation/cfd.md; where a blade "
        "with winglets is best was not run",
        "CFD",
    )


CFD_CASE_STUDIES = {
    "fig-3.22": study_mesh_convergence,
    "fig-3.23": study_surface_pressure,
    "fig-3.24": study_downwash,
}
"""Studies that take a folder of solved cases."""


def run_study_on_cfd_case(name: str, case: Path) -> StudyFindings:
    """Compute a study from a folder of solved cases.

    Raises
    ------
    InputError
        If the study takes no case, or the folder holds none.
    """
    if name not in CFD_CASE_STUDIES:
        raise InputError(
            "thesis", name, "does not use a CFD case", f"use --case with one of: {', '.join(CFD_CASE_STUDIES)}"
        )
    if not case.is_dir():
        raise InputError(str(case), "", "is not a folder", "give a folder that `mufly cfd run --out` wrote")
    return CFD_CASE_STUDIES[name](None, case)


STUDIES: dict[str, Study] = {
    "fig-3.22": Study(functools.partial(study_mesh_convergence), 0.1),
    "fig-3.23": Study(functools.partial(study_surface_pressure), 0.1),
    "fig-3.40": Study(study_winglets, 2),
    "fig-3.21": Study(study_mesh_setup, 6),
    "fig-3.24": Study(functools.partial(study_downwash), 12),
}
