"""Parts of ``validate_rotors.py`` without bench data of thrust: polars, drag in the disc plane, CFD of a blade."""

from __future__ import annotations

import argparse
import math

import numpy as np
from numpy.typing import NDArray
from rotor_tables import LIFT, percent, show_table
from scipy.optimize import brentq, root

from mufly.dynamics import find_trim
from mufly.errors import MuflyError
from mufly.quantities.units import RPM
from mufly.rotor import (
    Air,
    Blading,
    OperatingCondition,
    RotorMeasurements,
    RotorSystem,
    SystemSolution,
    fit_rotor,
    load_airfoil,
    load_rotor,
    prepare_blading,
    replace_rotor,
    solve_rotor_batch,
    solve_system,
)
from mufly.rotor.sections.neuralfoil_network import compute_neuralfoil_polars
from mufly.rotor.sections.polar_engines import compute_xfoil_polars
from mufly.study.benchmark.rotor_cases import (
    BENCHMARK_AIR,
    load_caradonna_tung,
    load_uiuc_propellers,
    make_t_motor_rotor,
)
from mufly.vehicle import load_vehicle


def report_polars(asked: argparse.Namespace) -> None:
    """NeuralFoil minus XFOIL over whole degrees from -2 to 12 at which XFOIL converges: mean |c_l|, mean |ln c_d|."""
    names = asked.names or ("naca0012", "naca4412", "goe394", "goe342", "gm15sm", "e387", "clarky", "s1223")
    reynolds, alpha_deg, rows = (1e4, 3e4, 1e5), np.arange(-2.0, 12.5), []
    mean: dict[float, list[tuple[float, float]]] = {0.1: [], 9.0: []}
    for name in names:
        airfoil = load_airfoil(name)
        for n_crit, found in mean.items():
            ours = compute_neuralfoil_polars([airfoil], reynolds, n_crit=n_crit, model="xlarge")[0]
            same = np.isin(np.round(np.rad2deg(ours.alpha_rad), 6), alpha_deg)
            theirs = compute_xfoil_polars(airfoil, reynolds, n_crit=n_crit, alpha_deg=alpha_deg)
            cells = []
            for j in range(len(reynolds)):
                known = theirs.known[j]
                cl = float(np.abs(ours.cl[j, same] - theirs.cl[j])[known].mean())
                cd = float(np.abs(np.log(ours.cd[j, same][known] / theirs.cd[j, known])).mean())
                found.append((cl, cd))
                cells.append(f"{cl:.3f}, {100 * cd:.1f} % ({known.sum()} of {alpha_deg.size})")
            rows.append([name, f"{n_crit:g}", *cells])
    show_table("NeuralFoil against XFOIL: c_l, c_d", ["section", "n_crit", *(f"Re {re:.0f}" for re in reynolds)], rows)
    for n_crit, found in mean.items():
        (cl, cd), (cl_m, cd_m) = np.mean(found, axis=0), np.median(found, axis=0)
        print(f"n_crit {n_crit:g}, mean (median): c_l {cl:.4f} ({cl_m:.4f}), c_d {100 * cd:.1f} ({100 * cd_m:.1f}) %")


def report_inplane_drag(asked: argparse.Namespace) -> None:
    """C_H / mu of both rotors at the hover of a vehicle, by blade elements; derivation: docs/explanation/dynamics.md.

    Pitches are those at which each rotor carries its share. Slopes of lift and drag: half a degree to either side.
    """
    vehicle, rotor = load_vehicle(asked.vehicle), load_rotor(asked.rotor)
    hover, rho = find_trim(vehicle), float(vehicle.air.density)
    spacing = float(vehicle.rotors.lower.hub_z) - float(vehicle.rotors.upper.hub_z)
    pair, air = RotorSystem.from_coaxial_pair(rotor, rotor, spacing_m=spacing), Air(density_kg_m3=rho)

    def solve(pitch: np.ndarray) -> SystemSolution:
        return solve_system(pair, OperatingCondition(tuple(pitch), tuple(hover.rotor_speed), air=air))

    found = root(lambda x: np.array([r.thrust_N for r in solve(x).rotors]) / hover.thrust_N - 1.0, [0.2, 0.2]).x
    half_deg, total, rows = np.radians(0.5), [], []
    solved = zip(*(solve(found + d).rotors for d in (0.0, -half_deg, half_deg)), strict=True)
    for side, pitch, (p, less, more) in zip(("upper", "lower"), found, solved, strict=True):
        c, dr, cl, cd, phi, r = p.chord_m, p.dr_m, p.cl, p.cd, p.phi_rad, p.r_m
        wind = p.reynolds * air.viscosity_Pa_s / rho / c
        along, axial = wind * np.cos(phi), wind * np.sin(phi)
        turn = (more.theta_rad - more.phi_rad) - (less.theta_rad - less.phi_rad)
        cl_slope, cd_slope = (more.cl - less.cl) / turn, (more.cd - less.cd) / turn
        share = rotor.blades * 0.25 * c * dr / (np.pi * rotor.radius_m**3 * p.speed_rad_s)
        lift = np.sum(share * (along / wind * cl * axial + cl_slope * axial**2 / wind))
        across = np.sum(share * (along / wind * cd * along + wind * cd + cd_slope * axial * along / wind))
        spanwise = np.sum(share * wind * cd)
        # A freely flapping disc tilts until its cyclic change of angle balances the advancing side's moment.
        moment, by_tilt = r * c * dr * (2 * along * cl + cl_slope * axial), r * c * dr * cl_slope * along * wind
        flapping = np.sum(moment) / np.sum(by_tilt) * p.speed_rad_s * rotor.radius_m
        total.append(float(lift + across + spanwise))
        rows.append([
            side, f"{np.degrees(pitch):.1f}", *(f"{v:.4f}" for v in (lift, across, spanwise, total[-1])),
            f"{flapping:.3f}, {p.c_T * flapping:.4f}",
        ])  # fmt: skip
    head = ["rotor", "pitch deg", "lift", "drag across the blades", "drag along them", "C_H / mu",
            "free flapping: rad per mu, C_H / mu"]  # fmt: skip
    show_table(f"{vehicle.name}: drag of the rotors in their planes", head, rows)
    mean, speeds = float(np.average(total, weights=hover.rotor_speed)), float(np.sum(hover.rotor_speed))
    force = mean * rho * np.pi * float(vehicle.rotors.radius) ** 3 * speeds
    print(f"inplane_drag {mean:.5f}: {1e3 * force:.2f} mN per m/s at hover")


RIG_SPACINGS, RIG_SHARES = (0.10, 0.25, 0.55, 1.0), np.array((0.60, 0.56, 0.56, 0.53))
"""Spacing over diameter and measured lower over upper thrust of an 11 inch pair; its blades are not recorded."""


def report_pair_blades(asked: argparse.Namespace) -> None:
    """Lower over upper thrust of 11 inch pairs by tubes, for seven planforms scaled to that size, and four pitches.

    Equal speeds of 4000 rpm, and the lower speed that balances the torques; -: the tubes do not settle.
    """
    radius, speed, rows = 0.5 * 11 * 0.0254, 4000 * RPM, []
    chosen = ("apcff_4.2x4", "da4002_5x2.65", "gwsdd_5x3", "nr640_5_15deg")
    rotors = [c.rotor for c in load_uiuc_propellers(asked.data) if c.name in chosen]
    for rotor in (*rotors, make_t_motor_rotor(), load_rotor("walkera-5g6"), load_rotor("naca4412-r60-c20")):
        chord = rotor.blade.chord.to_si_array() * radius / rotor.radius_m
        blading = prepare_blading(replace_rotor(rotor, {"radius": radius, "blade.chord": chord}))
        twist = float(np.interp(0.75 * radius, blading.r_m[0], blading.twist_rad[0]))
        for degrees in (4, 6, 8, 12):
            pitch, cells = math.radians(degrees) - twist, []
            for lower_speed in (speed, None):
                shares = []
                for spacing in RIG_SPACINGS:
                    pair = RotorSystem.from_coaxial_pair(blading, blading, spacing_m=2.0 * radius * spacing)
                    try:
                        found = solve_system(pair, OperatingCondition((pitch, pitch), (speed, lower_speed)), "tubes")
                        shares.append(found.rotors[1].thrust_N / found.rotors[0].thrust_N)
                    except MuflyError:
                        shares.append(math.nan)
                off = float(np.max(np.abs(np.array(shares) - RIG_SHARES)))
                cells += [", ".join("-" if math.isnan(v) else f"{v:.2f}" for v in shares), f"{off:.2f}"]
            rows.append([rotor.name, f"{degrees}", *cells])
    measured = ", ".join(f"{v:.2f}" for v in RIG_SHARES)
    head = ["planform", "deg at 0.75 R", "equal speeds", "farthest", "equal torques", "farthest"]
    show_table(f"Lower over upper thrust at z/D 0.10, 0.25, 0.55, 1.0; measured: {measured}", head, rows)


def report_inner_inflow(asked: argparse.Namespace) -> None:
    """Wide blades by blade elements and by the wake at the middle speed: errors, and the flow along the blade."""
    rows, at = [], np.array((0.3, 0.5, 0.7, 0.9))
    for case in load_uiuc_propellers(asked.data):
        if max(case.rotor.blade.chord.value) < 0.2 * case.rotor.radius_m:
            continue
        m, middle = case.measured, case.measured.thrust_N.size // 2
        rotor = RotorSystem.from_single_rotor(prepare_blading(case.rotor))
        point = OperatingCondition(float(m.pitch_rad[middle]), float(m.speed_rad_s[middle]), air=case.air)
        found = [solve_system(rotor, point, method).rotors[0] for method in ("bemt", "wake")]
        cells = [
            f"{percent(r.thrust_N, m.thrust_N[middle])}, {percent(r.torque_Nm, m.torque_Nm[middle])}" for r in found
        ]
        x = [r.r_m / case.rotor.radius_m for r in found]
        inside = [r.dT_N[k < 0.5].sum() / r.thrust_N for r, k in zip(found, x, strict=True)]
        cells.append(" / ".join(f"{share:.2f}" for share in inside))
        for of, form in (("alpha_rad", ".1f"), ("axial_induced_m_s", ".2f")):
            each = [np.interp(at, k, getattr(r, of)) for r, k in zip(found, x, strict=True)]
            scale = np.degrees(1.0) if of == "alpha_rad" else 1.0
            cells += [f"{scale * a:{form}} / {scale * b:{form}}" for a, b in zip(*each, strict=True)]
        rows.append([case.name, *cells])
    places = [f"{of} {x:g} R" for of in ("alpha", "inflow") for x in at]
    head = ["propeller", "bemt: thrust, torque, %", "wake", "thrust inside 0.5 R: bemt / wake", *places]
    show_table("Wide blades: blade elements / wake, degrees and m/s", head, rows)


def report_scatter(asked: argparse.Namespace) -> None:
    """Bounds by the measurements' scatter on what a fit to a part of a sweep can reach, UIUC propellers in hover.

    Cells: c_T, c_P in %. *scatter*: rms distance of a point from the line through its neighbours in log c over log
    speed, over its expected size for unit scatter. *half, interpolated*: mean error at every other point, between its
    measured neighbours. *one point, own law*: a cubic fitted to all points, moved to the middle point. *slope,
    bend*: quadratic in log speed of the error of blade elements scaled to the middle point, through zero there.
    Below: mean errors of the scaled prediction, and after taking off each propeller's own quadratic, the mean one
    of the other families, and the mean one of all families.
    """
    rows, bounds = [], []
    laws: dict[str, list[tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64], int]]] = {}
    for case in load_uiuc_propellers(asked.data):
        m = case.measured
        found = solve_rotor_batch(
            prepare_blading(case.rotor), pitch_rad=m.pitch_rad, speed_rad_s=m.speed_rad_s, air=case.air
        )
        x, n = np.log(m.speed_rad_s), m.speed_rad_s.size
        middle, seen = n // 2, np.arange(0, n, 2)
        unseen = np.setdiff1d(np.arange(n), seen)
        rest = np.setdiff1d(np.arange(n), [middle])
        log_c = np.log(np.stack((m.thrust_N, m.torque_Nm))) - 2.0 * x
        part = (x[1:-1] - x[:-2]) / (x[2:] - x[:-2])
        apart = log_c[:, 1:-1] - (1.0 - part) * log_c[:, :-2] - part * log_c[:, 2:]
        scatter = np.sqrt(np.mean(apart**2 / (1.0 + part**2 + (1.0 - part) ** 2), axis=1))
        half = [np.mean(np.abs(np.expm1(np.interp(x[unseen], x[seen], y[seen]) - y[unseen]))) for y in log_c]
        left = np.stack([y - np.polyval(np.polyfit(x, y, 3), x) for y in log_c])
        one = np.mean(np.abs(np.expm1((left - left[:, [middle]])[:, rest])), axis=1)
        error = np.log(np.stack((found.thrust_N, found.torque_Nm))) - 2.0 * x - log_c
        error, u = error - error[:, [middle]], x - x[middle]
        terms = np.stack((u, u**2), axis=1)
        law = np.linalg.lstsq(terms, error.T, rcond=None)[0]
        laws.setdefault(case.family, []).append((error, terms, law, middle))
        bounds.append((*scatter, *half, *one))
        both = ["; ".join(f"{v:+.2f}" for v in law[:, k]) for k in (0, 1)]
        rows.append([case.name, *(f"{100 * a:.1f}, {100 * b:.1f}" for a, b in (scatter, half, one)), *both])
    mean = 100.0 * np.mean(bounds, axis=0)
    rows.append(["mean", *(f"{mean[k]:.2f}, {mean[k + 1]:.2f}" for k in (0, 2, 4)), "", ""])
    head = ["propeller", "scatter", "half, interpolated", "one point, own law", "c_T: slope; bend", "c_P: slope; bend"]
    show_table("Scatter of the measurements: c_T, c_P, %", head, rows)

    by_family = {family: np.mean([law for _, _, law, _ in several], axis=0) for family, several in laws.items()}
    everyone = np.mean(list(by_family.values()), axis=0)
    sizes: dict[str, list[NDArray[np.float64]]] = {}
    for family, several in laws.items():
        others = np.mean([law for name, law in by_family.items() if name != family], axis=0)
        for error, terms, own, middle in several:
            for name, law in (
                ("none", 0.0 * own),
                ("own", own),
                ("other families", others),
                ("all families", everyone),
            ):
                after = np.delete(error - (terms @ law).T, middle, axis=1)
                sizes.setdefault(name, []).append(np.mean(np.abs(np.expm1(after)), axis=1))
    table = [[name, *(f"{100 * v:.2f}" for v in np.mean(each, axis=0))] for name, each in sizes.items()]
    show_table("Blade elements scaled to the middle point, law over speed taken off", ["law", "c_T", "c_P"], table)


def report_turned(asked: argparse.Namespace) -> None:
    """Blades of the UIUC propellers turned until the mean thrust error in hover is zero: what torque error is left.

    Mean errors over a sweep in %; the turn (degrees) is the smallest within 8 degrees, or none.
    """
    turns, rows, left = np.radians(np.linspace(-8.0, 8.0, 33)), [], []
    for case in load_uiuc_propellers(asked.data):
        m, blading = case.measured, prepare_blading(case.rotor)

        def find_mean_errors(turn: float, m: RotorMeasurements = m, blading: Blading = blading) -> tuple[float, float]:
            out = solve_rotor_batch(blading, pitch_rad=m.pitch_rad + turn, speed_rad_s=m.speed_rad_s, air=BENCHMARK_AIR)
            return float(np.nanmean(out.thrust_N / m.thrust_N - 1)), float(np.nanmean(out.torque_Nm / m.torque_Nm - 1))

        given = find_mean_errors(0.0)
        errors = np.array([find_mean_errors(t)[0] for t in turns])
        crossed = np.flatnonzero(errors[:-1] * errors[1:] <= 0.0)
        cells = ["none", "-"]
        if crossed.size:
            k = crossed[np.argmin(np.abs(turns[crossed]))]
            turn = brentq(lambda t, find=find_mean_errors: find(t)[0], turns[k], turns[k + 1], xtol=1e-5)
            left.append(find_mean_errors(turn)[1])
            cells = [f"{math.degrees(turn):+.1f}", f"{100 * left[-1]:+.1f}"]
        rows.append([case.name, *(f"{100 * e:+.1f}" for e in given), *cells])
    rows.append(["mean size", "", "", f"of {len(left)}", f"{100 * np.mean(np.abs(left)):.1f} %"])
    head = ["propeller", "thrust as given", "torque as given", "turn", "torque turned"]
    show_table("Blades turned until thrust fits", head, rows)


SECTION_CHOICES = ("naca2408", "naca4412", "clarky+scaled8", "e63", "naca5503", "naca8503")


def report_sections(asked: argparse.Namespace) -> None:
    """Sections of propellers whose section is not known: each fitted to half a sweep, scored on the other half.

    Cells: error of thrust, torque (%) on the unseen points; turn of the blade (degrees) that the fit chose.
    """
    rows = []
    for case in load_uiuc_propellers(asked.data):
        if case.section_known:
            continue
        n, cells = case.measured.thrust_N.size, []
        seen = np.arange(0, n, 2)
        rest = case.measured.select_points(np.setdiff1d(np.arange(n), seen))
        for name in SECTION_CHOICES:
            rotor = replace_rotor(case.rotor, {"blade.airfoils": name})
            fit = fit_rotor(rotor, case.measured.select_points(seen), section="known", air=case.air)
            how = {"pitch_rad": rest.pitch_rad, "speed_rad_s": rest.speed_rad_s, "air": case.air}
            found = solve_rotor_batch(prepare_blading(fit.rotor), **how)
            off = [np.nanmean(np.abs(a / b - 1.0)) for a, b in ((found.thrust_N, rest.thrust_N),
                   (found.torque_Nm, rest.torque_Nm))]  # fmt: skip
            cells.append(f"{100 * off[0]:.1f}, {100 * off[1]:.1f}; {math.degrees(fit.change[0]):+.1f}")
        rows.append([case.name, *cells])
    show_table("Half a sweep fitted with each section: thrust, torque %; turn", ["propeller", *SECTION_CHOICES], rows)


C_T, TIP_MACH, STATION = {5.0: 0.00213, 8.0: 0.00459}, 0.439, 0.68
UPPER_SIDE = (
    (0.02, -0.9426), (0.04, -0.9820), (0.10, -0.7745), (0.15, -0.7345), (0.20, -0.6845), (0.23, -0.6445),
    (0.28, -0.5845), (0.33, -0.4801), (0.39, -0.4051), (0.44, -0.3401), (0.49, -0.3051), (0.54, -0.2651),
    (0.59, -0.2151), (0.63, -0.1681), (0.68, -0.1401), (0.73, -0.1121), (0.77, -0.0891), (0.82, -0.0781),
    (0.86, -0.0571), (0.91, -0.0461),
)  # fmt: skip
"""Measured pressure coefficients of the upper side at 0.68 R and 8 degrees, by x/c."""


def report_caradonna_cfd(asked: argparse.Namespace) -> None:
    """Caradonna and Tung by CFD: c_T, lift of five stations, suction of one; resumes a case in DIR.

    CFD is incompressible; its coefficients stand beside those after Prandtl and Glauert, over sqrt(1 - M^2). A hub of
    0.1 R is assumed; without one (--hub 0), swirl on the axis keeps the flow from settling.
    """
    from matplotlib.figure import Figure

    from mufly.cfd import mesh_and_write_case, read_poly_mesh, read_solution, run_case

    rotor = load_caradonna_tung(asked.data).rotor
    radius, chord, pitch = rotor.radius_m, float(rotor.chord_m(0.5)), math.radians(asked.pitch)
    case = asked.folder / f"{asked.model}-{asked.mesh}-{asked.pitch:g}{'' if asked.hub else '-no-hub'}"
    mesh_and_write_case(case, rotor, pitch_rad=pitch, speed_rad_s=1250 * RPM, model=asked.model, level=asked.mesh,
              hub_m=asked.hub * radius)  # fmt: skip
    verdict, mesh = run_case(case, most=asked.most), read_poly_mesh(case)
    found = read_solution(case, mesh)
    p = found.point
    c_t = verdict.thrust_N / (p.density_kg_m3 * math.pi * radius**2 * (p.speed_rad_s * radius) ** 2)
    print(f"{verdict.outcome} after {verdict.iterations} iterations (drift {100 * verdict.drift:.2f} %, swing "
          f"{100 * verdict.swing:.2f} %): c_T {c_t:.5f}, {percent(c_t, C_T[asked.pitch])} % of {C_T[asked.pitch]}; the "
          f"wake carries {100 * found.wake_torque_ratio:.0f} % of the torque\n")  # fmt: skip
    rows = []
    for x, measured in LIFT[asked.pitch].items():
        pressure = 0.5 * p.density_kg_m3 * (p.speed_rad_s * x * radius) ** 2 * chord * p.blades
        ours = float(np.interp(x * radius, found.r_m, found.thrust_N_m)) / pressure
        rows.append([f"{x:.2f}", f"{measured:.4f}"])
        for cl in (ours, ours / math.sqrt(1.0 - (TIP_MACH * x) ** 2)):
            rows[-1].append(f"{cl:.4f} ({percent(cl, measured)} %)")
    show_table("Lift coefficients", ["r/R", "measured", "CFD", "after Prandtl and Glauert"], rows)
    if asked.pitch != 8.0:
        return

    def upper_side(strip: int, x: np.ndarray) -> np.ndarray:
        faces = mesh.patch_face_slice("blade")
        of = (mesh.cell_strip[mesh.owner[faces]] == strip) & (mesh.face_areas[faces][:, 2] < 0.0)
        centre = mesh.face_centres[faces][of]
        along = 0.25 + (centre[:, 0] * math.cos(pitch) - centre[:, 2] * math.sin(pitch)) / chord
        c_p = found.pressure_Pa[of] / (0.5 * p.density_kg_m3 * (p.speed_rad_s * found.r_m[strip]) ** 2)
        order = np.argsort(along)
        return np.interp(x, along[order], c_p[order])

    taps, x = np.array(UPPER_SIDE), np.linspace(0.005, 0.995, 100)
    after = int(np.searchsorted(found.r_m, STATION * radius))
    share = (STATION * radius - found.r_m[after - 1]) / (found.r_m[after] - found.r_m[after - 1])
    c_p = (1.0 - share) * upper_side(after - 1, x) + share * upper_side(after, x)
    figure = Figure(figsize=(7.0, 5.0), layout="constrained")
    axes = figure.subplots()
    for name, values in (("CFD", c_p), ("after Prandtl and Glauert", c_p / math.sqrt(1.0 - (TIP_MACH * STATION) ** 2))):
        off = np.interp(taps[:, 0], x, values) - taps[:, 1]
        print(f"upper side at {STATION} R, {name}: mean error {off.mean():+.3f}, rms {np.sqrt((off**2).mean()):.3f}, "
              f"at most {off[np.abs(off).argmax()]:+.3f} at x/c {taps[np.abs(off).argmax(), 0]:.2f}")  # fmt: skip
        axes.plot(x, values, label=name)
    axes.plot(*taps.T, "o", color="C3", mfc="none", label="measured (NASA TM-81232, Table 17)")
    axes.set(xlabel="x / chord", ylabel="pressure coefficient of the upper side", xlim=(0.0, 1.0), ylim=(0.2, -1.1))
    axes.set_title(f"Caradonna and Tung, 8 degrees, {STATION} R ({p.model}, {p.level} mesh)")
    axes.legend()
    figure.savefig(asked.folder / "pressure.png", dpi=120)
