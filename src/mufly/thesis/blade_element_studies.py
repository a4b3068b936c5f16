"""Polars and blade elements: Figs 3.2, 3.9, 3.15, 3.38, 3.42 and 4.2, Table 3.1.

Each function states the assumptions that replace missing data of the source. Blade elements are those of
:mod:`mufly.rotor.bemt` with all corrections, untuned, unless a function states otherwise.
"""

from __future__ import annotations

import math

import numpy as np
import xarray as xr

from mufly.drive import DriveTrain, load_drive
from mufly.quantities.units import RPM
from mufly.results.result_figure import blank_figure
from mufly.rotor import (
    OperatingCondition,
    RotorMeasurements,
    RotorSystem,
    calibrate_blading,
    compare_measurements,
    compute_polar,
    load_airfoil,
    load_rotor,
    lookup_lift_drag,
    prepare_blading,
    replace_rotor,
    solve_rotor_batch,
    solve_system,
)
from mufly.rotor.coax_maps import interpolate_map as map_at
from mufly.study import sweep_parameters
from mufly.thesis.claims import TABLE_3_2_VALUES, ProgressCallback, Study, StudyFindings, judge, make_item_judge
from mufly.thesis.single_rotor_studies import (
    RANKED_OUTPUT_NAME,
    compute_blade_form_gain_percent,
    judge_blade_forms,
    make_standard_setup,
)
from mufly.vehicle import load_coefficient_map, load_vehicle

REYNOLDS_NUMBERS = np.geomspace(1e4, 3e5, 16)
N_CRIT_VALUES = (0.1, 1.0, 4.0, 9.0, 12.0)


def load_bench_points() -> RotorMeasurements:
    """Return the four measured points of Table 3.2."""
    at = np.array(list(TABLE_3_2_VALUES), dtype=np.float64)
    loads = np.array([row["measured"] for row in TABLE_3_2_VALUES.values()])
    return RotorMeasurements(np.radians(at[:, 0]), at[:, 1] * RPM, loads[:, 0], loads[:, 1], "Table 3.2")


def study_reynolds_effect(progress: ProgressCallback | None = None) -> StudyFindings:
    """Fig. 3.2: greatest lift over drag of smooth and rough sections over the Reynolds number.

    The source's figure is McMasters and Henderson's, of many aerofoils. Here: NACA 0012 and 4412, smooth as in a quiet
    tunnel (n_crit 9), and rough with transition fixed at 5 % of the chord.

    Thesis: Fig. 3.2.
    """
    alpha = np.radians(np.linspace(0.0, 12.0, 49))
    best: dict[tuple[str, str], np.ndarray] = {}
    for name in ("naca0012", "naca4412"):
        for surface, options in (
            ("smooth", {"n_crit": 9.0}),
            ("rough", {"n_crit": 9.0, "xtr": (0.05, 0.05)}),
        ):
            cl, cd = lookup_lift_drag(compute_polar(name, **options), alpha[:, None], REYNOLDS_NUMBERS)
            best[name, surface] = (cl / cd).max(axis=0)
    data = xr.Dataset(
        {
            "lift_over_drag": (
                ("airfoil", "surface", "reynolds"),
                [[best[n, s] for s in ("smooth", "rough")] for n in ("naca0012", "naca4412")],
            )
        },
        coords={
            "airfoil": ["naca0012", "naca4412"],
            "surface": ["smooth", "rough"],
            "reynolds": REYNOLDS_NUMBERS,
        },
    )
    low, high = (int(np.argmin(np.abs(REYNOLDS_NUMBERS - re))) for re in (2e4, 2e5))
    gain = {key: v[high] / v[low] for key, v in best.items()}

    def format_gains(surface: str) -> str:
        return ", ".join(f"{gain[n, surface]:.1f} ({n})" for n in ("naca0012", "naca4412"))

    smooth = min(gain[n, "smooth"] for n in ("naca0012", "naca4412"))
    less = all(gain[n, "rough"] < gain[n, "smooth"] for n in ("naca0012", "naca4412"))
    verdicts = [
        judge(
            "fig-3.2/about-re-70-000-smooth-aerofoils",
            "NeuralFoil, n_crit 9",
            f"best lift over drag at Re 200 000 over that at 20 000: {format_gains('smooth')}",
            smooth=smooth,
        ),
        judge(
            "fig-3.2/on-rough-aerofoils-the-effect-cannot",
            "NeuralFoil, tripped at 5 %",
            f"the same ratio: {format_gains('rough')}",
            holds=less,
        ),
    ]
    drawn = blank_figure(6.5, 4.4)
    axes = drawn.subplots()
    for (name, surface), v in best.items():
        axes.loglog(
            REYNOLDS_NUMBERS,
            v,
            "-" if surface == "smooth" else "--",
            marker=".",
            label=f"{name}, {surface}",
            color="C0" if name == "naca0012" else "C1",
        )
    axes.axvline(7e4, color="0.4", linestyle=":", label="source: critical, 70 000")
    axes.set(xlabel="Reynolds number", ylabel="Greatest lift over drag", title="Fig. 3.2: Reynolds number")
    axes.grid(alpha=0.3, which="both")
    axes.legend(fontsize="small")
    return StudyFindings(verdicts, drawn, {"neuralfoil": data})


def study_boundary_layer_transition(progress: ProgressCallback | None = None) -> StudyFindings:
    """Table 3.1: thrust and torque at the four bench points by blade elements, with polars at several n_crit."""
    rotor, measured = load_rotor("naca0012-r60-c20"), load_bench_points()
    found = [compare_measurements(prepare_blading(rotor, n_crit=n), measured) for n in N_CRIT_VALUES]
    thrust = np.array([100 * c.mean_thrust_error for c in found])
    torque = np.array([100 * c.mean_torque_error for c in found])
    both = thrust + torque
    k = int(both.argmin())
    numbers = ", ".join(f"{n:g}: {t:.1f}, {q:.1f}" for n, t, q in zip(N_CRIT_VALUES, thrust, torque, strict=True))
    quiet = N_CRIT_VALUES.index(9.0)
    verdicts = [
        judge(
            "table-3.1/only-with-a-low-n-crit-0.1",
            "full",
            f"mean errors of thrust and torque (%) at n_crit {numbers}; least in sum at {N_CRIT_VALUES[k]:g}",
            n_crit_values=N_CRIT_VALUES[k],
            holds=both[0] < both[quiet],
        )
    ]
    drawn = blank_figure(6.0, 4.0)
    axes = drawn.subplots()
    axes.plot(N_CRIT_VALUES, thrust, "o-", label="thrust")
    axes.plot(N_CRIT_VALUES, torque, "s-", label="torque")
    for low, high, label in ((0, 1, "vibrations"), (4, 8, "dirty tunnel"), (10, 12, "clean tunnel")):
        axes.axvspan(low, high, color="0.9", zorder=0)
        axes.annotate(
            label,
            ((low + high) / 2, 0.97),
            xycoords=("data", "axes fraction"),
            ha="center",
            va="top",
            fontsize=8,
            rotation=90,
        )
    axes.set(
        xlabel="$n_{crit}$",
        ylabel="Mean error at Table 3.2's points (%)",
        title="Table 3.1: choice of n_crit",
    )
    axes.set_ylim(bottom=0)
    axes.legend(fontsize="small", loc="center right")
    data = xr.Dataset(
        {"thrust_error_pct": ("n_crit", thrust), "torque_error_pct": ("n_crit", torque)},
        coords={"n_crit": list(N_CRIT_VALUES)},
    )
    return StudyFindings(verdicts, drawn, {"full": data})


def study_current_torque_linearity(progress: ProgressCallback | None = None) -> StudyFindings:
    """Fig. 3.9: linearity of motor current over rotor torque.

    The parameters of the bench's motors (Maxon EC 45 flat) are not printed. muFly's drive replaces them, along the load
    curve of the bench's rotor (Table 3.2's at 16 degrees, 2 000 to 8 000 rpm). From eq. 4.25, I = (Q / (i eta) + dR i
    W) / kM with Q ~ W^2, so the friction bends the line.

    Thesis: Fig. 3.9.
    """
    drive: DriveTrain = load_drive("mufly")
    speed = np.linspace(2000, 8000, 25) * RPM
    out = solve_rotor_batch(
        prepare_blading(load_rotor("naca0012-r60-c20")),
        pitch_rad=np.full(speed.size, math.radians(16)),
        speed_rad_s=speed,
    )
    torque = np.asarray(out.torque_Nm).ravel()
    v = load_vehicle("mufly-1.1")
    ratio, efficiency = float(v.gear.ratio), float(v.gear.efficiency)
    friction, constant = float(v.motor.friction), float(v.motor.torque_constant)
    current = (torque / (ratio * efficiency) + friction * ratio * speed) / constant
    line = np.polynomial.Polynomial.fit(torque, current, 1)
    off = current - line(torque)
    worst = 100 * float(np.abs(off).max() / current.max())
    square = 1 - float(np.sum(off**2) / np.sum((current - current.mean()) ** 2))
    verdicts = [
        judge(
            "fig-3.9/motor-current-and-rotor-torque-have",
            f"drive {drive.name}",
            f"R2 {square:.5f}, off a straight line by {worst:.2f} % of full scale at most",
            square=square,
            worst=worst,
        )
    ]
    drawn = blank_figure(8.0, 3.8)
    left, right = drawn.subplots(1, 2)
    left.plot(1e3 * torque, current, "o", markersize=4, label="motor equations")
    left.plot(1e3 * torque, line(torque), "k-", linewidth=1, label="straight line")
    left.set(xlabel="Torque (mN m)", ylabel="Current (A)")
    left.legend(fontsize="small")
    right.plot(1e3 * torque, 100 * off / current.max(), "o-", markersize=3)
    right.set(xlabel="Torque (mN m)", ylabel="Off the line (% of full scale)")
    for axes in (left, right):
        axes.grid(alpha=0.3)
    drawn.suptitle("Fig. 3.9: motor current over rotor torque")
    data = xr.Dataset(
        {"current_A": ("point", current), "torque_Nm": ("point", torque), "speed_rad_s": ("point", speed)}
    )
    return StudyFindings(
        verdicts,
        drawn,
        {"drive": data},
        "the measured points are not in the text; the friction term alone is tested",
    )


def study_bench_blades(progress: ProgressCallback | None = None) -> StudyFindings:
    """Fig. 3.15: blades with three airfoils; all polars are calibrated on one measured point of the NACA 0012 blade.

    The dissertation calibrates in the same way.

    The text gives measurements of NACA 0012 at Table 3.2's points only; the pitch of the figure is not stated, so 12
    and 16 degrees are drawn.
    """
    base, measured = load_rotor("naca0012-r60-c20"), load_bench_points()
    tuned = calibrate_blading(prepare_blading(base), measured, 0)
    found = compare_measurements(tuned, measured)
    rest_t, rest_q = (100 * np.abs(e[1:]).max() for e in (found.thrust_error, found.torque_error))
    rpm = np.linspace(3000, 8000, 11)
    names, fixes = ("naca0012", "naca4412", "naca9412"), tuned.corrections
    data = xr.Dataset(coords={"airfoil": list(names), "pitch_deg": [12, 16], "rpm": rpm})
    thrust, torque = np.empty((3, 2, rpm.size)), np.empty((3, 2, rpm.size))
    for i, name in enumerate(names):
        blading = prepare_blading(replace_rotor(base, {"blade.airfoils": [name]}), corrections=fixes)
        for j, pitch in enumerate((12, 16)):
            out = solve_rotor_batch(blading, pitch_rad=np.full(rpm.size, math.radians(pitch)), speed_rad_s=rpm * RPM)
            thrust[i, j], torque[i, j] = np.ravel(out.thrust_N), np.ravel(out.torque_Nm)
    data["thrust_N"] = (("airfoil", "pitch_deg", "rpm"), thrust)
    data["torque_Nm"] = (("airfoil", "pitch_deg", "rpm"), torque)
    most = thrust[:, :, -1].max(axis=0)
    assess = make_item_judge("fig-3.15", "full, calibrated")
    verdicts = [
        assess(
            "tuned-on-one-rotor-blade-elements",
            f"tuned on Table 3.2's first point, the other three are off by {rest_t:.1f} % in "
            f"thrust and {rest_q:.1f} % in "
            "torque at most",
            rest_t=rest_t,
            rest_q=rest_q,
        ),
        assess(
            "the-greatest-thrust-at-8-000",
            f"NACA 9412 has {most[0]:.2f} N at 12 degrees and {most[1]:.2f} N at 16",
            most_min=most.min() * 0.97,
            most_max=most.max() * 1.03,
        ),
    ]
    drawn = blank_figure(10.0, 4.4)
    for axes, values, scale, label, printed in zip(
        drawn.subplots(1, 2),
        (thrust, torque),
        (1.0, 1e3),
        ("Thrust (N)", "Torque (mN m)"),
        (measured.thrust_N, 1e3 * measured.torque_Nm),
        strict=True,
    ):
        for i, name in enumerate(names):
            for j, style in enumerate(("--", "-")):
                axes.plot(rpm, scale * values[i, j], style, color=f"C{i}", label=f"{name}, {(12, 16)[j]} deg")
        axes.plot(measured.speed_rad_s / RPM, printed, "ks", label="naca0012 measured, Table 3.2")
        axes.set(xlabel="Rotational speed (rev/min)", ylabel=label, ylim=(0, 0.8 if scale == 1 else 10))
        axes.grid(alpha=0.3)
    drawn.axes[0].legend(fontsize="x-small")
    drawn.suptitle("Fig. 3.15: three aerofoils by blade elements, tuned on one point (axes as printed)")
    return StudyFindings(verdicts, drawn, {"full": data})


# Chord over the standard blade's, at r / R: the source prints no sizes of the tips.
TIP_SHAPES: dict[str, tuple[tuple[float, ...], tuple[float, ...]]] = {
    "standard": ((0.0, 1.0), (20.0, 20.0)),
    "tip 1, cut back": ((0.0, 0.90, 1.0), (20.0, 20.0, 10.0)),
    "tip 2, tapered": ((0.0, 0.75, 1.0), (20.0, 20.0, 8.0)),
}


def study_blade_tips(progress: ProgressCallback | None = None) -> StudyFindings:
    """Fig. 3.38: blade tips, as far as a chord distribution describes them. The dissertation used CFD and gives no
    sizes.

    Tip 1 loses half its chord in the outer tenth (like the Walkera blade), tip 2 tapers to 8 mm from three quarters on.

    Thesis: Fig. 3.38.
    """
    pitch = np.arange(12.0, 20.1, 1.0)
    lines = []
    for x, chord in TIP_SHAPES.values():
        changed = {
            "blade.r_over_R": list(x),
            "blade.chord": [1e-3 * c for c in chord],
            "blade.twist": [0.0] * len(x),
            "blade.airfoils": ["naca0012"] * len(x),
        }
        rotor = replace_rotor(load_rotor("naca0012-r60-c20"), changed)
        lines.append(
            sweep_parameters(make_standard_setup("full", rotor), {"pitch": [float(p) for p in np.radians(pitch)]})[
                RANKED_OUTPUT_NAME
            ].values
        )
    values = np.array(lines)
    gain = 100 * (values[1:] / values[0] - 1)
    verdicts = [
        judge(
            "fig-3.38/neither-tip-is-better-than-the",
            "full",
            f"tip 1 {gain[0].min():+.1f} to {gain[0].max():+.1f} %, tip 2 {gain[1].min():+.1f} to "
            f"{gain[1].max():+.1f} % of thrust per power from 12 to 20 degrees",
            gain=np.nanmax(gain),
        ),
        judge_blade_forms(("thesis-1", "thesis-2"), "fig-3.38/tips-by-cfd"),
    ]
    drawn = blank_figure(9.5, 4.0)
    left, right = drawn.subplots(1, 2, width_ratios=(1, 1.3))
    for k, (name, (x, chord)) in enumerate(TIP_SHAPES.items()):
        left.plot(60 * np.array(x), np.array(chord), color=f"C{k}", label=name)
        right.plot(pitch, values[k], ".-", color=f"C{k}", label=name)
    left.set(xlabel="radius (mm)", ylabel="chord (mm)", ylim=(0, 24), xlim=(9, 61))
    right.set(xlabel="Pitch angle (deg)", ylabel="Thrust / electrical power (N/W)")
    right.axhspan(0.044, 0.046, color="0.9", label="source: best ends between these ticks")
    for axes in (left, right):
        axes.grid(alpha=0.3)
        axes.legend(fontsize="x-small")
    drawn.suptitle("Fig. 3.38: tip shapes by blade elements (NACA 0012, sizes ours)")
    data = xr.Dataset(
        {RANKED_OUTPUT_NAME: (("tip", "pitch_deg"), values)},
        coords={"tip": list(TIP_SHAPES), "pitch_deg": pitch},
    )
    return StudyFindings(
        verdicts,
        drawn,
        {"full": data},
        "judged by blade elements, and by CFD at one point (docs/explanation/cfd.md, our guesses of the tips)",
    )


GURNEY_HEIGHTS_PERCENT = (0.0, 1.0, 2.0)


def study_gurney_flaps(progress: ProgressCallback | None = None) -> StudyFindings:
    """Fig. 3.42: Gurney flaps of 1 and 2 % on NACA 0012, by blade elements with the polars of sections with a flap.

    The source's 3 and 5 % exceed the range of NeuralFoil's contours; 2 % is its limit.

    Thesis: Fig. 3.42.
    """
    pitch = np.arange(10.0, 20.1, 1.0)
    names = ["naca0012", *(f"naca0012+gurney{f:g}" for f in GURNEY_HEIGHTS_PERCENT[1:])]
    setup = make_standard_setup("full", "naca0012-r60-c20")
    found = sweep_parameters(setup, {"airfoil": names, "pitch": [float(p) for p in np.radians(pitch)]})
    values = found[RANKED_OUTPUT_NAME].values
    best = np.nanmax(values, axis=1)
    gain = 100 * (best / best[0] - 1)
    numbers = ", ".join(f"{g:+.1f} % ({f:g} %)" for f, g in zip(GURNEY_HEIGHTS_PERCENT[1:], gain[1:], strict=True))
    assess = make_item_judge("fig-3.42", "full")
    verdicts = [
        assess("all-flaps-of-1-3-and", f"bests {numbers}", gain=gain[1:]),
        assess("a-flap-of-1-is", f"bests {numbers}", gain_argmax=int(gain.argmax())),
        assess("it-brings-nearly-20", f"{gain[1]:+.1f} % at 1 %, {gain.max():+.1f} % at most", gain_max=gain.max()),
        judge(
            "fig-3.42/it-brings-nearly-20-2",
            "CFD, laminar, medium mesh (docs/explanation/cfd.md)",
            f"{compute_blade_form_gain_percent('gurney 1 %'):+.1f} % of T^1.5/P at 1 %, 16 degrees, 5 000 rpm",
            gain=compute_blade_form_gain_percent("gurney 1 %"),
        ),
    ]
    drawn = blank_figure(9.5, 4.0)
    left, right = drawn.subplots(1, 2, width_ratios=(1, 1.3))
    for k, name in enumerate(names):
        left.plot(*load_airfoil(name).coordinates.T, color=f"C{k}", linewidth=1, label=name)
        right.plot(
            pitch,
            values[k],
            ".-",
            color=f"C{k}",
            label="none" if k == 0 else f"{GURNEY_HEIGHTS_PERCENT[k]:g} %",
        )
    left.set(xlim=(0.8, 1.05), ylim=(-0.08, 0.06), xlabel="x / c", ylabel="y / c")
    left.set_aspect("equal")
    left.legend(fontsize="x-small", loc="lower left")
    right.set(xlabel="Pitch angle (deg)", ylabel="Thrust / electrical power (N/W)")
    right.axhspan(0.050, 0.052, color="0.9", label="source: best ends between these ticks")
    right.legend(fontsize="x-small")
    right.grid(alpha=0.3)
    drawn.suptitle("Fig. 3.42 (and 3.41): Gurney flaps on NACA 0012 by blade elements")
    return StudyFindings(
        verdicts,
        drawn,
        {"full": found},
        "judged by blade elements, and a flap of 1 % by CFD at one point (docs/explanation/cfd.md)",
    )


def study_coefficients_in_climb(progress: ProgressCallback | None = None) -> StudyFindings:
    """Fig. 4.2: thrust and torque coefficient over the climb, by blade elements and by the flight model's map.

    The rotor of the source's CFD is not stated. Here: NACA 0012 of Table 3.2 at 14 degrees and 6 000 rpm, and the upper
    rotor of the built-in map of muFly's pair. Climb is positive.

    Thesis: Fig. 4.2.
    """
    climb = np.linspace(-1.0, 1.0, 21)
    system = RotorSystem.from_single_rotor(load_rotor("naca0012-r60-c20"))
    pitch = math.radians(14)
    speed = 6000 * RPM
    rows = [solve_system(system, OperatingCondition(pitch, speed, climb_m_s=float(v))).rotors[0] for v in climb]
    c_T, c_Q = np.array([r.c_T for r in rows]), np.array([r.c_Q for r in rows])
    table = load_coefficient_map("walkera-5g6-bemt")
    mean = 410.0
    of_map, outside = map_at(table, mean, 1.15, climb / (mean * 0.0875))
    of_map[outside] = np.nan
    near = np.abs(climb) <= 0.5 + 1e-9
    middle = int(np.abs(climb).argmin())
    change = 100 * (c_T[near] / c_T[middle] - 1)
    upper = 100 * (of_map[near, 0] / of_map[middle, 0] - 1)
    verdicts = [
        judge(
            "fig-4.2/within-0.5-m-s-the-change-of",
            model,
            f"c_T {v[0]:+.1f} % at -0.5 m/s and {v[-1]:+.1f} % at +0.5 m/s",
            v=np.nanmax(np.abs(v)),
        )
        for model, v in (("full", change), ("flight model's map, upper rotor", upper))
    ] + [
        judge(
            "fig-4.2/c-t-stays-within-0-and-0.015",
            "full",
            f"c_T {c_T.min():.4f} to {c_T.max():.4f}, c_Q {c_Q.min():.5f} to {c_Q.max():.5f}",
            c_t_min=c_T.min(),
            c_t_max=c_T.max(),
            c_q_min=c_Q.min(),
            c_q_max=c_Q.max(),
        )
    ]
    drawn = blank_figure(9.5, 3.9)
    for axes, ours, k, label, top in zip(
        drawn.subplots(1, 2), (c_T, c_Q), (0, 1), ("c_T", "c_Q"), (0.015, 0.003), strict=True
    ):
        axes.plot(climb, ours, "o-", markersize=3, label="NACA 0012, 14 deg, 6 000 rpm, blade elements")
        axes.plot(climb, of_map[:, k], "C1-", label="muFly's pair, upper rotor, map of the flight model")
        axes.plot(climb, of_map[:, k + 2], "C1--", label="the same, lower rotor")
        axes.axvspan(-0.5, 0.5, color="0.93", zorder=0, label="normal operation in the source")
        axes.set(
            xlabel="Climb (m/s)",
            ylabel=label,
            ylim=(0, max(top, 1.05 * np.nanmax(of_map[:, k]))),
            xlim=(-1, 1),
        )
        axes.axhline(top, color="0.5", linestyle=":", linewidth=0.9)
        axes.grid(alpha=0.3)
    drawn.axes[0].legend(fontsize="x-small", loc="lower left")
    drawn.suptitle("Fig. 4.2: coefficients over the climb (dotted: end of the printed axis)")
    data = xr.Dataset(
        {"c_T": ("climb", c_T), "c_Q": ("climb", c_Q), "map": (("climb", "of"), of_map)},
        coords={"climb": climb, "of": ["c_T upper", "c_Q upper", "c_T lower", "c_Q lower"]},
    )
    return StudyFindings(verdicts, drawn, {"full": data})


STUDIES: dict[str, Study] = {
    "fig-3.2": Study(study_reynolds_effect, 3),
    "table-3.1": Study(study_boundary_layer_transition, 3),
    "fig-3.9": Study(study_current_torque_linearity, 1),
    "fig-3.15": Study(study_bench_blades, 2),
    "fig-3.38": Study(study_blade_tips, 2),
    "fig-3.42": Study(study_gurney_flaps, 3),
    "fig-4.2": Study(study_coefficients_in_climb, 2),
}
