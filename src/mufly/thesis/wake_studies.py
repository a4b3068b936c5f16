"""Studies of vortex wakes: Figs 3.6 and 3.17 to 3.20, and the methods of Table 3.2.

The source's vortex method has a prescribed wake after Landgrebe or a free one; this package's (:mod:`mufly.rotor.wake`)
has both. The rotor of the wake figures is not stated. Here: NACA 0012 of Table 3.2, isolated at 12 degrees and 7 000
rpm, and as a pair at 14 degrees and 6 000 rpm with 20 mm between the discs.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from mufly.quantities.units import RPM
from mufly.results.result_figure import blank_figure
from mufly.rotor import (
    Blading,
    OperatingCondition,
    RotorSystem,
    SolverMethod,
    SystemSolution,
    compare_measurements,
    compute_shaft_plane_velocity,
    draw_flow_field,
    draw_wake,
    load_rotor,
    prepare_blading,
    solve_system,
)
from mufly.rotor.blading import ensure_blading
from mufly.rotor.rotor_system import WakeSettings
from mufly.rotor.wake.biot_savart import evaluate_biot_savart_kernel
from mufly.rotor.wake.induced_flow import compute_momentum_flux_thrust
from mufly.study import BEMT_MODELS
from mufly.thesis.blade_element_studies import load_bench_points
from mufly.thesis.claims import TABLE_3_2_VALUES, ProgressCallback, Study, StudyFindings, judge, make_item_judge
from mufly.thesis.coaxial_studies import solve_equal_speed_pair

Array = NDArray[np.float64]
SPACING_M = 0.02


def _load_blade() -> Blading:
    return ensure_blading(load_rotor("naca0012-r60-c20"))


@functools.lru_cache(maxsize=2)
def solve_single_rotor(model: str = "free") -> SystemSolution:
    settings = None if model == "free" else WakeSettings(model="prescribed")
    return solve_system(
        RotorSystem.from_single_rotor(_load_blade()),
        OperatingCondition(math.radians(12), 7000 * RPM),
        "wake",
        settings=settings,
    )


def find_tip_vortex_path(solution: SystemSolution) -> tuple[Array, Array]:
    """Return the path of the first rotor's tip vortex: radius over R, and height above the disc (m).

    All vorticity shed outboard of the blade's greatest circulation rolls up into the tip vortex, around which the
    outermost filament spirals.
    """
    wake = solution.wakes[0]
    begin = int(np.argmax(np.abs(wake.bound_circulation_m2_s))) + 1
    share = np.abs(wake.filament_circulation_m2_s[begin:])
    paths = wake.filament_paths_m[begin:]
    radius = np.hypot(paths[..., 0], paths[..., 1]) / wake.surface.radius_m
    middle = np.average(radius, axis=0, weights=share), np.average(paths[..., 2], axis=0, weights=share)
    return middle[0], middle[1] - wake.placed.height_m


def study_wake_pair(progress: ProgressCallback | None = None) -> StudyFindings:
    """Fig. 3.6: the wakes of a pair, one inside the other.

    Thesis: Fig. 3.6.
    """
    found = solve_equal_speed_pair()
    r, z = find_tip_vortex_path(found)
    k = int(np.argmax(z <= -SPACING_M))
    inside = float(r[k])
    share = found.lower.thrust_N / found.upper.thrust_N
    verdicts = [
        judge(
            "fig-3.6/the-lower-rotor-works-in-the",
            "wake",
            f"the upper rotor's tip vortex passes the lower disc at {inside:.2f} R; the lower rotor then has "
            f"{100 * share:.0f} % of the upper one's thrust",
            inside=inside,
            share=share,
        )
    ]
    drawn = draw_flow_field(found, mean=False, points=60)
    drawn.suptitle("Fig. 3.6: vorticity of a pair, 14 deg, 6 000 rpm", fontsize="medium")
    data = xr.Dataset({"tip_r_over_R": ("point", r), "tip_z_m": ("point", z)})
    return StudyFindings(verdicts, drawn, {"wake": data}, found.message)


def _straight_vortex_velocity(point: Array, a: Array, b: Array) -> Array:
    """Return the velocity at a point due to a straight vortex of unit circulation from a to b, without a core."""
    compute: Callable[..., tuple[float, float, float]] = evaluate_biot_savart_kernel
    return np.array(compute(*point, *a, *b, 0.0)) / (4 * math.pi)


def _format_error(off: float) -> str:
    """Return a difference as text; a rounding error, whose digits differ between processors, as an upper bound."""
    return f"{off:.1e}" if off > 1e-12 else "less than 1e-12"


def study_straight_vortex(progress: ProgressCallback | None = None) -> StudyFindings:
    """Fig. 3.17: velocity of a straight vortex by eq. 3.16 and by this package, beside the integral of eq. 3.15.

    Thesis: Fig. 3.17.
    """
    a, b = np.array([0.0, -0.5, 0.0]), np.array([0.0, 0.5, 0.0])
    points = np.array([[x, y, 0.02] for x in (0.05, 0.2, 0.7) for y in (-0.9, -0.3, 0.0, 0.4)])
    s, weight = np.polynomial.legendre.leggauss(400)
    along = 0.5 * (a + b) + 0.5 * s[:, None] * (b - a)
    ours, closed, integral = [], [], []
    for p in points:
        ours.append(_straight_vortex_velocity(p, a, b))
        r1, r2, line = p - a, p - b, b - a
        cross = np.cross(line, r1)
        height = np.linalg.norm(cross) / np.linalg.norm(line)
        cosines = (line @ r1) / np.linalg.norm(r1) - (line @ r2) / np.linalg.norm(r2)
        closed.append(cosines / np.linalg.norm(line) / (4 * math.pi * height) * cross / np.linalg.norm(cross))
        r = p - along
        integral.append(
            np.sum(weight[:, None] * np.cross(0.5 * (b - a), r) / np.linalg.norm(r, axis=1)[:, None] ** 3, axis=0)
            / (4 * math.pi)
        )
    size = np.linalg.norm(integral, axis=1)
    off_ours = float((np.linalg.norm(np.array(ours) - integral, axis=1) / size).max())
    off_closed = float((np.linalg.norm(np.array(closed) - integral, axis=1) / size).max())
    verdicts = [
        judge(
            "fig-3.17/the-velocity-of-a-straight-vortex",
            "wake",
            f"ours is off the integral of eq. 3.15 by {_format_error(off_ours)}, eq. 3.16 as printed by "
            f"{_format_error(off_closed)}, "
            f"at {len(points)} points",
            off_ours=max(off_ours, off_closed),
        ),
    ]
    drawn = blank_figure(6.0, 4.0)
    axes = drawn.subplots()
    h = np.geomspace(0.01, 2.0, 80)
    speed = [np.linalg.norm(_straight_vortex_velocity(np.array([x, 0.0, 0.0]), a, b)) for x in h]
    axes.loglog(h, speed, label="straight vortex of length 1 m, ours")
    axes.loglog(h, 1 / (2 * math.pi * h), "k:", label="endless vortex, 1 / (2 pi h)")
    axes.set(
        xlabel="Distance h from its middle (m)",
        ylabel="Velocity for a circulation of 1 m$^2$/s (m/s)",
        title="Fig. 3.17: velocity of a straight vortex",
    )
    axes.grid(alpha=0.3, which="both")
    axes.legend()
    return StudyFindings(verdicts, drawn)


def study_wake_shapes(progress: ProgressCallback | None = None) -> StudyFindings:
    """Fig. 3.18: the wakes of one rotor and of a pair; Landgrebe's shape beside the free one.

    Thesis: Fig. 3.18.
    """
    free, fixed, pair = solve_single_rotor("free"), solve_single_rotor("prescribed"), solve_equal_speed_pair()
    radii = {name: find_tip_vortex_path(one) for name, one in (("free", free), ("prescribed", fixed))}
    depth = 0.06  # one radius below
    at = {name: float(np.interp(depth, -z[np.argsort(-z)], r[np.argsort(-z)])) for name, (r, z) in radii.items()}
    thrust = 100 * (fixed.thrust_N / free.thrust_N - 1)
    torque = 100 * (fixed.rotors[0].torque_Nm / free.rotors[0].torque_Nm - 1)
    assess = make_item_judge("fig-3.18", "wake")
    verdicts = [
        assess(
            "the-wake-is-a-contracting-helix",
            f"one radius below the disc the tip vortex is at {at['prescribed']:.2f} R (prescribed) and "
            f"{at['free']:.2f} R (free)",
            holds=all(0.7 < v < 0.95 for v in at.values()),
        ),
        assess(
            "both-ways-of-giving-the-wake",
            f"prescribed over free: thrust {thrust:+.1f} %, torque {torque:+.1f} %",
            thrust=abs(thrust),
            torque=abs(torque),
        ),
    ]
    drawn = draw_wake(pair)
    drawn.suptitle("Fig. 3.18: wakes of a pair, 14 deg, 6 000 rpm", fontsize="medium")
    data = {name: xr.Dataset({"tip_r_over_R": ("point", r), "tip_z_m": ("point", z)}) for name, (r, z) in radii.items()}
    return StudyFindings(verdicts, drawn, data)


def study_wake_velocities(progress: ProgressCallback | None = None) -> StudyFindings:
    """Fig. 3.19: velocities in a plane through the shaft.

    Thesis: Fig. 3.19.
    """
    found = solve_single_rotor("free")
    R = 0.06
    x, z = np.linspace(-2.2 * R, 2.2 * R, 45), np.array([-0.5 * R, -1.0 * R])
    _, _, w = compute_shaft_plane_velocity(found, x, z)
    core, around = np.abs(x) < 0.7 * R, np.abs(x) > 1.2 * R
    down, up = float(w[1, core].mean()), float(w[:, around].max())
    ideal = math.sqrt(found.thrust_N / (2 * 1.2 * math.pi * R**2))
    momentum = compute_momentum_flux_thrust(found, -1.0 * R)
    assess = make_item_judge("fig-3.19", "wake")
    verdicts = [
        assess(
            "there-is-downwash-in-the-core",
            f"mean {down:.1f} m/s within 0.7 R one radius below the disc; momentum theory has {-ideal:.1f} m/s in the "
            f"disc and {-2 * ideal:.1f} far below",
            holds=down < -ideal,
        ),
        assess("the-air-around-moves-up-more", f"up to {up:+.2f} m/s beyond 1.2 R", up=up),
    ]
    drawn = draw_flow_field(found, mean=False, points=60)
    drawn.suptitle("Fig. 3.19: one rotor, 12 deg, 7 000 rpm", fontsize="medium")
    data = xr.Dataset({"w_m_s": (("z_m", "x_m"), w)}, coords={"x_m": x, "z_m": z})
    note = (
        f"own check: the momentum through a plane one radius below is {momentum:.4f} N, the blades' thrust "
        f"{found.thrust_N:.4f} N ({100 * (momentum / found.thrust_N - 1):+.1f} %)"
    )
    return StudyFindings(verdicts, drawn, {"wake": data}, note)


def study_bench_pair(progress: ProgressCallback | None = None) -> StudyFindings:
    """Fig. 3.20: thrust of a pair and torque of its lower rotor at equal speeds, by blade elements and by two wakes.

    The text gives neither the measured points nor blades and spacing of the figure; NACA 0012 of Table 3.2 is used.

    Thesis: Fig. 3.20.
    """
    blade = _load_blade()
    pair = RotorSystem.from_coaxial_pair(blade, blade, spacing_m=SPACING_M)
    pitches, rpm = (12, 14, 16, 18), np.array([4000.0, 5000.0, 6000.0, 7000.0, 8000.0])
    thrust, torque = np.full((4, 5), np.nan), np.full((4, 5), np.nan)

    def solve_point(pitch: float, speed: float, method: SolverMethod) -> SystemSolution:
        return solve_system(pair, OperatingCondition((math.radians(pitch),) * 2, (speed * RPM,) * 2), method)

    for i, pitch in enumerate(pitches):
        for j, speed in enumerate(rpm):
            one = solve_point(pitch, float(speed), "bemt")
            if one.converged:
                thrust[i, j], torque[i, j] = one.thrust_N, one.lower.torque_Nm
    greatest_thrust, greatest_torque = thrust[-1, -1], 1e3 * torque[-1, -1]
    wakes: dict[tuple[int, float], SystemSolution] = {}
    for k, pitch in enumerate((12, 18)):
        wakes[pitch, 6000.0] = solve_point(pitch, 6000.0, "wake")
        if progress is not None:
            progress(k + 1, 2)
    ratio = {
        key: (
            one.thrust_N / thrust[pitches.index(key[0]), 2] - 1,
            one.lower.torque_Nm / torque[pitches.index(key[0]), 2] - 1,
        )
        for key, one in wakes.items()
        if one.converged
    }
    numbers = "; ".join(
        f"{k[0]} deg: thrust {100 * t:+.1f} %, lower torque {100 * q:+.1f} %" for k, (t, q) in ratio.items()
    )
    assess = make_item_judge("fig-3.20", "full")
    verdicts = [
        judge(
            "fig-3.20/the-vortex-method-gives-the-pair-s",
            "wake",
            f"beside coaxial blade elements at 6 000 rpm: {numbers}",
            holds=(bool(ratio)) and (all(abs(t) < 0.10 for t, _ in ratio.values())),
        ),
        assess("the-greatest-thrust-of-the-pair", f"{greatest_thrust:.2f} N at 18 degrees", thrust=greatest_thrust),
        assess("the-greatest-torque-of-the-lower", f"{greatest_torque:.1f} mN m", torque=greatest_torque),
    ]
    drawn = blank_figure(10.0, 4.2)
    for axes, values, scale, label, k in zip(
        drawn.subplots(1, 2),
        (thrust, torque),
        (1.0, 1e3),
        ("Thrust of the pair (N)", "Torque of the lower rotor (mN m)"),
        (0, 1),
        strict=True,
    ):
        for i, pitch in enumerate(pitches):
            axes.plot(rpm, scale * values[i], color=f"C{i}", label=f"{pitch} deg, blade elements")
        for (pitch, speed), one in wakes.items():
            if one.converged:
                axes.plot(
                    speed,
                    scale * (one.thrust_N, one.lower.torque_Nm)[k],
                    "o",
                    color=f"C{pitches.index(pitch)}",
                    label=f"{pitch} deg, wake",
                )
        axes.set(xlabel="Rotational speed (rev/min)", ylabel=label)
        axes.set_ylim(bottom=0)
        axes.grid(alpha=0.3)
    drawn.axes[0].legend(fontsize="x-small")
    drawn.suptitle("Fig. 3.20: a pair at equal speeds (NACA 0012, R 60 mm, 20 mm apart)")
    data = xr.Dataset(
        {"thrust_N": (("pitch_deg", "rpm"), thrust), "lower_torque_Nm": (("pitch_deg", "rpm"), torque)},
        coords={"pitch_deg": list(pitches), "rpm": rpm},
    )
    return StudyFindings(verdicts, drawn, {"full": data})


# docs/log/2026-11-28-cfd-table-3-2.md: laminar, coarse mesh, by pitch and rpm, all settled; thrust (N), torque (N m).
OUR_CFD_LOADS: dict[tuple[int, int], tuple[float, float]] = {
    (12, 5000): (0.1462, 1.628e-3),
    (12, 7000): (0.2879, 3.051e-3),
    (16, 5000): (0.2190, 2.663e-3),
    (16, 7000): (0.4306, 5.110e-3),
}


def study_solver_methods(progress: ProgressCallback | None = None) -> StudyFindings:
    """Table 3.2: blade elements, wake and CFD beside the bench and the dissertation's CFD, at four points.

    CFD is not run here: its results are those of docs/log/2026-11-28-cfd-table-3-2.md (OpenFOAM, laminar, coarse mesh).
    """
    measured, rotor = load_bench_points(), load_rotor("naca0012-r60-c20")
    points = list(TABLE_3_2_VALUES)
    ours: dict[str, Array] = {}
    for model in ("full", "thesis"):
        c = compare_measurements(prepare_blading(rotor, corrections=BEMT_MODELS[model]), measured)
        ours[f"blade elements, {model}"] = np.column_stack([c.thrust_N, c.torque_Nm])
    c = compare_measurements(prepare_blading(rotor), measured, method="wake", progress=progress)
    ours["wake"] = np.column_stack([c.thrust_N, c.torque_Nm])
    ours["CFD, laminar"] = np.array([OUR_CFD_LOADS.get(p, (math.nan, math.nan)) for p in points])
    truth = np.column_stack([measured.thrust_N, measured.torque_Nm])
    theirs = {m: np.array([TABLE_3_2_VALUES[p][m] for p in points]) for m in ("laminar", "k-epsilon", "k-omega", "BSL")}

    def format_errors(e: Array) -> str:
        return ", ".join("not run" if not math.isfinite(x) else f"{100 * x:+.1f}" for x in e)

    verdicts = []
    for name, values in ours.items():
        error = values / truth - 1
        known = error[np.isfinite(error[:, 0])]
        thrust, torque = np.abs(known).max(axis=0)
        text = f"thrust {format_errors(error[:, 0])} %, torque {format_errors(error[:, 1])} % of the bench"
        verdicts.append(judge(f"table-3.2/{name}", name, text, thrust=thrust, torque=torque))
    laminar = ours["CFD, laminar"] / theirs["laminar"] - 1
    known = laminar[np.isfinite(laminar[:, 0])]
    assess = make_item_judge("table-3.2", "CFD, laminar")
    verdicts.append(
        assess(
            "laminar-cfd",
            f"thrust {format_errors(laminar[:, 0])} %, torque {format_errors(laminar[:, 1])} % of the source's "
            f"laminar CFD",
            known_max=np.abs(known[:, 0]).max(),
        )
    )
    below = all((v[:, 0] < truth[:, 0]).all() for m, v in theirs.items())
    verdicts.append(
        assess(
            "cfd-takes-thrust-too-small-and",
            f"{format_errors(ours['CFD, laminar'][:, 0] / truth[:, 0] - 1)} % and "
            f"{format_errors(ours['CFD, laminar'][:, 1] / truth[:, 1] - 1)} %; of the source's own, thrust "
            f"{'always' if below else 'not always'} below",
            holds=(np.all(ours["CFD, laminar"][:, 0] < truth[:, 0]))
            and (np.all(ours["CFD, laminar"][:, 1] > truth[:, 1])),
        )
    )
    drawn = blank_figure(11.0, 4.6)
    names = ["measured", *(f"source: {m}" for m in theirs), *(f"ours: {m}" for m in ours)]
    rows = [truth, *theirs.values(), *ours.values()]
    for k, (axes, label, scale) in enumerate(
        zip(drawn.subplots(1, 2), ("Thrust (N)", "Torque (mN m)"), (1, 1e3), strict=True)
    ):
        width = 0.8 / len(rows)
        for i, (name, row) in enumerate(zip(names, rows, strict=True)):
            colour = "k" if i == 0 else f"{0.9 - 0.12 * i:.2f}" if i <= len(theirs) else f"C{i - len(theirs) - 1}"
            axes.bar(
                np.arange(4) + (i - len(rows) / 2 + 0.5) * width,
                scale * row[:, k],
                width,
                color=colour,
                label=name,
            )
        axes.set_xticks(range(4), [f"{p} deg\n{n} rpm" for p, n in points])
        axes.set_ylabel(label)
    drawn.axes[0].legend(fontsize="x-small")
    drawn.suptitle("Table 3.2: methods beside the bench")
    data = xr.Dataset(
        {"loads": (("method", "point", "of"), np.array(rows))},
        coords={
            "method": names,
            "point": [f"{p} deg, {n} rpm" for p, n in points],
            "of": ["thrust_N", "torque_Nm"],
        },
    )
    return StudyFindings(verdicts, drawn, {"all": data})


STUDIES: dict[str, Study] = {
    "fig-3.17": Study(study_straight_vortex, 0.5),
    "fig-3.19": Study(study_wake_velocities, 8),
    "fig-3.6": Study(study_wake_pair, 12),
    "fig-3.18": Study(study_wake_shapes, 14),
    "fig-3.20": Study(study_bench_pair, 25),
    "table-3.2": Study(study_solver_methods, 25),
}
