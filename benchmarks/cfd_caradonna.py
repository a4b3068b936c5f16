"""Caradonna and Tung's rotor by CFD, beside the lift of its five stations and the pressures at one.

F. X. Caradonna, C. Tung, *Experimental and Analytical Studies of a Model Helicopter Rotor in Hover*, NASA TM-81232
(1981): two untwisted blades, NACA 0012, radius 1.143 m, chord 190.5 mm; 8 degrees, 1 250 rpm, tip at Mach 0.439. Appendix A,
Table 17, as transcribed by github.com/mcroomp/dynbem from the report's scans; its lift agrees to 2 % with what others
read off the report's Fig. 14, but at 0.96 R, where that gives 0.274. CFD is incompressible: its coefficients are
given as they are and after Prandtl and Glauert, over sqrt(1 - M^2) with the station's Mach number.

    python benchmarks/cfd_caradonna.py DIR [--model k-epsilon] [--mesh coarse] [--most 2800]

DIR holds the case; what was begun there goes on.
"""

from __future__ import annotations

import argparse
import math
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from mufly.cfd import read_poly_mesh, read_solution, run_case, save_case
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
C_T = 0.00459
LIFT = {0.50: 0.2343, 0.68: 0.2815, 0.80: 0.2886, 0.89: 0.3143, 0.96: 0.2883}
"""Measured lift coefficients, by r/R, over the pressure of Omega r."""
STATION = 0.80
UPPER = (
    (0.04, -1.1101), (0.17, -0.8487), (0.21, -0.7487), (0.25, -0.7081), (0.34, -0.6539), (0.40, -0.5539),
    (0.44, -0.4739), (0.50, -0.4239), (0.55, -0.3839), (0.60, -0.3389), (0.65, -0.2689), (0.70, -0.2389),
    (0.75, -0.1779), (0.80, -0.1499), (0.85, -0.1299), (0.90, -0.0979), (0.95, -0.0765),
)  # fmt: skip
LOWER = ((0.03, -0.0584), (0.14, 0.0137), (0.49, 0.0155), (0.74, 0.0135), (0.90, -0.0704))
"""Measured pressure coefficients at 0.80 R, by x/c; the three taps within 0.02 chords of the nose are left out."""


def main() -> None:
    """Run the case as far as asked, print the comparison, draw it."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    parser.add_argument("folder", type=Path)
    parser.add_argument("--model", default="k-epsilon")
    parser.add_argument("--mesh", default="coarse")
    parser.add_argument("--most", type=int, default=2800)
    given = parser.parse_args()
    file = given.folder / "caradonna-tung.toml"
    given.folder.mkdir(parents=True, exist_ok=True)
    file.write_text(ROTOR, encoding="utf-8")
    case = given.folder / f"{given.model}-{given.mesh}"
    save_case(
        case, load_rotor(str(file)), pitch_rad=math.radians(PITCH_DEG), speed_rad_s=SPEED_RPM * RPM, model=given.model,
        level=given.mesh,
    )  # fmt: skip
    verdict = run_case(case, most=given.most)
    mesh = read_poly_mesh(case)
    found = read_solution(case, mesh)
    p = found.point
    whole = p.density_kg_m3 * math.pi * RADIUS_M**2 * (p.speed_rad_s * RADIUS_M) ** 2
    c_T = verdict.thrust_N / whole
    print(f"{verdict.what} after {verdict.iterations} iterations (drift {100 * verdict.drift:.2f} %, swing "
          f"{100 * verdict.swing:.2f} %): c_T {c_T:.5f}, {100 * (c_T / C_T - 1):+.1f} % of {C_T}; the wake carries "
          f"{100 * found.wake_torque:.0f} % of the torque")  # fmt: skip
    print("r/R   c_l measured   CFD            with Prandtl and Glauert")
    for x, measured in LIFT.items():
        of = 0.5 * p.density_kg_m3 * (p.speed_rad_s * x * RADIUS_M) ** 2 * CHORD_M * p.blades
        ours = float(np.interp(x * RADIUS_M, found.r_m, found.thrust_N_m)) / of
        told = ours / math.sqrt(1.0 - (MACH * x) ** 2)
        print(f"{x:.2f}  {measured:.4f}         {ours:.4f} {100 * (ours / measured - 1):+5.1f} %  {told:.4f} "
              f"{100 * (told / measured - 1):+5.1f} %")  # fmt: skip
    faces = mesh.patch("blade")
    strip = int(np.argmin(np.abs(found.r_m - STATION * RADIUS_M)))
    of = mesh.strip[mesh.owner[faces]] == strip
    centre, up = mesh.face_centres[faces][of], mesh.face_areas[faces][of, 2] < 0.0
    along = 0.25 + (centre[:, 0] * math.cos(p.pitch_rad) - centre[:, 2] * math.sin(p.pitch_rad)) / CHORD_M
    c_p = found.pressure_Pa[of] / (0.5 * p.density_kg_m3 * (p.speed_rad_s * found.r_m[strip]) ** 2)
    told = c_p / math.sqrt(1.0 - (MACH * STATION) ** 2)
    figure = Figure(figsize=(7.0, 5.0), layout="constrained")
    axes = figure.subplots()
    for side, measured, colour, name in ((up, UPPER, "C0", "upper side"), (~up, LOWER, "C3", "lower side")):
        order = np.argsort(along[side])
        x, y = along[side][order], told[side][order]
        tap = np.array(measured)
        off = np.interp(tap[:, 0], x, y) - tap[:, 1]
        print(f"pressure at {found.r_m[strip] / RADIUS_M:.3f} R, {name}: off by {off.mean():+.3f} in the mean, "
              f"rms {np.sqrt((off**2).mean()):.3f}, at most {off[np.abs(off).argmax()]:+.3f} at x/c "
              f"{tap[np.abs(off).argmax(), 0]:.2f}")  # fmt: skip
        axes.plot(x, y, "-", color=colour, label=f"CFD, {name}")
        axes.plot(*tap.T, "o", color=colour, mfc="none", label=f"measured, {name}")
    axes.set(xlabel="x / chord", ylabel="pressure coefficient", xlim=(-0.02, 1.02), ylim=(1.0, -1.6),
             title=f"Caradonna and Tung, 8°, 0.8 R ({p.model}, {p.level} mesh: {verdict.what})")  # fmt: skip
    axes.legend()
    axes.grid(alpha=0.3)
    figure.savefig(given.folder / "pressure-0.80R.png", dpi=120)


if __name__ == "__main__":
    main()
