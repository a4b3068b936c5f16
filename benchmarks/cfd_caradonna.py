"""Caradonna and Tung's rotor by CFD, beside the lift of its five stations and the suction at one.

F. X. Caradonna, C. Tung, *Experimental and Analytical Studies of a Model Helicopter Rotor in Hover*, NASA TM-81232
(1981): two untwisted blades, NACA 0012, radius 1.143 m, chord 190.5 mm; 8 degrees, 1 250 rpm, tip at Mach 0.439.
Appendix A, Table 17, as transcribed by github.com/mcroomp/dynbem from the report's scans. Its lift agrees to 2 % with
what others read off the report's Fig. 14, but at 0.96 R (0.274). Of its pressures the upper side at 0.68 R is taken,
which goes with that lift. At 0.80 R the upper side alone would give 0.48 where the table has 0.289, and the
lower sides change sign and power of ten from tap to tap: damaged in transcription, not used.

CFD is incompressible: its coefficients are given as they are and after Prandtl and Glauert, over sqrt(1 - M^2) with the
station's Mach number.

The rotor stood on a shaft with a hub, whose size is not in the tables: a cylinder of 0.1 R is put there. Without it
(``--hub 0``) swirl that gathers on the axis is drawn down through the gap between the roots every 1 200 iterations,
and thrust jumps by 5 % each time: that never settles.

    python benchmarks/cfd_caradonna.py DIR [--model k-epsilon] [--mesh coarse] [--hub 0.1] [--pitch 8] [--most 2800]

DIR holds the case; what was begun there goes on.
"""

from __future__ import annotations

import argparse
import math
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from mufly.cfd import CfdSolution, PolyMesh, read_poly_mesh, read_solution, run_case, save_case
from mufly.rotor import load_rotor
from mufly.units import RPM

ROTOR = """name = "caradonna-tung"
description = "Two untwisted blades, NACA 0012, R 1.143 m, chord 0.1905 m (NASA TM-81232, 1981)"
blades = 2
radius = { value = 1143, unit = "mm", source = "measured" }
hub_cutout = { value = 0.2, unit = "1", source = "estimated" }

[blade]
r_over_R = { value = [0, 1], unit = "1", source = "specified" }
chord = { value = [190.5, 190.5], unit = "mm", source = "measured" }
twist = { value = [0, 0], unit = "deg", source = "measured" }
airfoils = ["naca0012"]
"""
RADIUS_M, CHORD_M, PITCH_DEG, SPEED_RPM, MACH = 1.143, 0.1905, 8.0, 1250.0, 0.439
C_T = {5.0: 0.00213, 8.0: 0.00459}
LIFT = {
    5.0: {0.50: 0.1070, 0.68: 0.1241, 0.80: 0.1517, 0.89: 0.1181, 0.96: 0.1519},  # Table 10
    8.0: {0.50: 0.2343, 0.68: 0.2815, 0.80: 0.2886, 0.89: 0.3143, 0.96: 0.2883},
}
"""Measured lift coefficients, by pitch (degrees) and r/R, over the pressure of Omega r."""
STATION = 0.68
UPPER = (
    (0.02, -0.9426), (0.04, -0.9820), (0.10, -0.7745), (0.15, -0.7345), (0.20, -0.6845), (0.23, -0.6445),
    (0.28, -0.5845), (0.33, -0.4801), (0.39, -0.4051), (0.44, -0.3401), (0.49, -0.3051), (0.54, -0.2651),
    (0.59, -0.2151), (0.63, -0.1681), (0.68, -0.1401), (0.73, -0.1121), (0.77, -0.0891), (0.82, -0.0781),
    (0.86, -0.0571), (0.91, -0.0461),
)  # fmt: skip
"""Measured pressure coefficients of the upper side at 0.68 R, by x/c."""


def main() -> None:
    """Run the case as far as asked, print the comparison, draw it."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    parser.add_argument("folder", type=Path)
    parser.add_argument("--model", default="k-epsilon")
    parser.add_argument("--mesh", default="coarse")
    parser.add_argument("--hub", type=float, default=0.1, help="its radius over R; 0 for none")
    parser.add_argument("--most", type=int, default=2800)
    parser.add_argument("--pitch", type=float, default=PITCH_DEG, choices=tuple(C_T), help="degrees")
    given = parser.parse_args()
    file = given.folder / "caradonna-tung.toml"
    given.folder.mkdir(parents=True, exist_ok=True)
    file.write_text(ROTOR, encoding="utf-8")
    turned = "" if given.pitch == PITCH_DEG else f"-{given.pitch:g}"
    case = given.folder / f"{given.model}-{given.mesh}{'' if given.hub else '-no-hub'}{turned}"
    save_case(
        case, load_rotor(str(file)), pitch_rad=math.radians(given.pitch), speed_rad_s=SPEED_RPM * RPM,
        model=given.model, level=given.mesh, hub_m=given.hub * RADIUS_M,
    )  # fmt: skip
    verdict = run_case(case, most=given.most)
    mesh = read_poly_mesh(case)
    found = read_solution(case, mesh)
    p = found.point
    whole = p.density_kg_m3 * math.pi * RADIUS_M**2 * (p.speed_rad_s * RADIUS_M) ** 2
    c_T, known = verdict.thrust_N / whole, C_T[given.pitch]
    print(f"{verdict.what} after {verdict.iterations} iterations (drift {100 * verdict.drift:.2f} %, swing "
          f"{100 * verdict.swing:.2f} %): c_T {c_T:.5f}, {100 * (c_T / known - 1):+.1f} % of {known}; the wake carries "
          f"{100 * found.wake_torque:.0f} % of the torque")  # fmt: skip
    print("r/R   c_l measured   CFD            with Prandtl and Glauert")
    for x, measured in LIFT[given.pitch].items():
        of = 0.5 * p.density_kg_m3 * (p.speed_rad_s * x * RADIUS_M) ** 2 * CHORD_M * p.blades
        ours = float(np.interp(x * RADIUS_M, found.r_m, found.thrust_N_m)) / of
        told = ours / math.sqrt(1.0 - (MACH * x) ** 2)
        print(f"{x:.2f}  {measured:.4f}         {ours:.4f} {100 * (ours / measured - 1):+5.1f} %  {told:.4f} "
              f"{100 * (told / measured - 1):+5.1f} %")  # fmt: skip
    if given.pitch != PITCH_DEG:
        return
    taps = np.array(UPPER)
    at = STATION * RADIUS_M
    after = int(np.searchsorted(found.r_m, at))
    share = (at - found.r_m[after - 1]) / (found.r_m[after] - found.r_m[after - 1])
    x = np.linspace(0.005, 0.995, 100)
    c_p = (1.0 - share) * _upper(found, mesh, after - 1, x) + share * _upper(found, mesh, after, x)
    told = c_p / math.sqrt(1.0 - (MACH * STATION) ** 2)
    for name, values in (("CFD", c_p), ("with Prandtl and Glauert", told)):
        off = np.interp(taps[:, 0], x, values) - taps[:, 1]
        print(f"upper side at {STATION} R, {name}: off by {off.mean():+.3f} in the mean, rms "
              f"{np.sqrt((off**2).mean()):.3f}, at most {off[np.abs(off).argmax()]:+.3f} at x/c "
              f"{taps[np.abs(off).argmax(), 0]:.2f}")  # fmt: skip
    figure = Figure(figsize=(7.0, 5.0), layout="constrained")
    axes = figure.subplots()
    axes.plot(x, c_p, "--", color="C0", label="CFD, incompressible")
    axes.plot(x, told, "-", color="C0", label="CFD with Prandtl and Glauert")
    axes.plot(*taps.T, "o", color="C3", mfc="none", label="measured (NASA TM-81232, Table 17)")
    axes.set(xlabel="x / chord", ylabel="pressure coefficient of the upper side", xlim=(0.0, 1.0), ylim=(0.2, -1.1),
             title=f"Caradonna and Tung, 8°, {STATION} R ({p.model}, {p.level} mesh: {verdict.what})")  # fmt: skip
    axes.legend()
    axes.grid(alpha=0.3)
    figure.savefig(given.folder / "pressure.png", dpi=120)


def _upper(found: CfdSolution, mesh: PolyMesh, strip: int, x: np.ndarray) -> np.ndarray:
    """Pressure coefficient of the upper side of one strip, by x/c."""
    faces, p = mesh.patch_faces("blade"), found.point
    of = (mesh.cell_strip[mesh.owner[faces]] == strip) & (mesh.face_areas[faces][:, 2] < 0.0)
    centre = mesh.face_centres[faces][of]
    along = 0.25 + (centre[:, 0] * math.cos(p.pitch_rad) - centre[:, 2] * math.sin(p.pitch_rad)) / CHORD_M
    c_p = found.pressure_Pa[of] / (0.5 * p.density_kg_m3 * (p.speed_rad_s * found.r_m[strip]) ** 2)
    order = np.argsort(along)
    return np.interp(x, along[order], c_p[order])


if __name__ == "__main__":
    main()
