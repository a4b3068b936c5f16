"""Pictures of rotors: blade, spanwise loads, fit, coefficient map, wake and flow field."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from mufly.errors import InputError, MuflyError
from mufly.quantities.units import RPM
from mufly.results import draws
from mufly.results.result_figure import blank_figure, label_axes
from mufly.rotor.coax_maps import interpolate_map
from mufly.rotor.measured.bench_comparison import MeasurementComparison
from mufly.rotor.measured.rotor_fit import RotorFit
from mufly.rotor.measured.uncertainty import predict_interval
from mufly.rotor.rotor_system import RotorResult, SystemSolution
from mufly.rotor.sections.airfoil import Airfoil, load_airfoil
from mufly.rotor.sections.polar_table import PolarTable

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from mufly.rotor.geometry import Rotor
    from mufly.vehicle import CoefficientMap

Array = NDArray[np.float64]

_COEFFICIENT_LABELS = ("$c_T$ (1)", "$c_Q$ (1)")
_ROTOR_STYLES = (("upper", "-", "o"), ("lower", "--", "s"))
_PAIR_SIDE_NAMES = ("upper", "lower")
_ROTOR_COLOURS = ("C0", "C3")


def draw_blade(rotor: Rotor) -> Figure:
    """Draw planform (quarter chord line straight), twist and sections of a blade, lengths in millimetres."""
    x = np.linspace(float(rotor.hub_cutout), 1.0, 101)
    r, chord = 1e3 * rotor.radius_m * x, 1e3 * rotor.chord_m(x)
    figure = blank_figure(8.0, 6.0)
    plan, twist, section = figure.subplots(3, 1, height_ratios=(1.2, 1.0, 1.2))
    plan.fill_between(r, -0.75 * chord, 0.25 * chord, alpha=0.5)
    plan.plot(r, 0 * r, color="0.3", linewidth=0.8, linestyle="-.", label="quarter chord")
    plan.plot(0, 0, "k+", markersize=10)
    plan.set_aspect("equal")
    plan.set_ylabel("Chord (mm)")
    plan.set_title(f"{rotor.name}: {rotor.blades} blades, R {1e3 * rotor.radius_m:g} mm", fontsize="medium")
    plan.legend(fontsize="small", loc="upper left")
    twist.plot(r, np.degrees(rotor.twist_rad(x)))
    twist.set_xlim(plan.get_xlim())
    label_axes(twist, "Radius (mm)", "Twist (deg)")
    names = rotor.airfoil_names()
    for k, name in enumerate(names):
        try:
            contour = load_airfoil(name).coordinates
        except MuflyError:  # a polar has no contour
            continue
        section.plot(*contour.T, color=f"C{k}", label=name)
    section.set_aspect("equal")
    section.set_xlabel("x / c")
    section.set_ylabel("y / c")
    section.legend(fontsize="small", ncols=1 + len(names) // 6)
    return figure


_END_LOAD_AVERAGING_RADII = 0.03  # of R: length at each end of a blade over which loads are averaged


def _load_per_radius(result: RotorResult, load: Array) -> Array:
    """Return the loads of the stations' panels (N or N m), divided by the panels' widths (N/m or N m/m).

    The outermost panel contains the whole side-edge force, which is averaged over the tip.
    """
    out: Array = load / result.dr_m
    length = _END_LOAD_AVERAGING_RADII * (result.r_m[-1] + 0.5 * result.dr_m[-1])
    for order in (slice(None), slice(None, None, -1)):
        across = np.cumsum(result.dr_m[order])
        n = int(np.searchsorted(across, length * (1.0 - 1e-9))) + 1
        out[order][:n] = load[order][:n].sum() / across[n - 1]
    return out


@draws(RotorResult)
def draw_spanwise_loads(result: RotorResult) -> Figure:
    """Draw angle of attack, inflow, lift coefficient and Reynolds number along the blade, and thrust per radius."""
    r = 1e3 * result.r_m
    panels = (
        ("Angle of attack (deg)", np.degrees(result.alpha_rad)),
        ("Inflow (m/s)", result.axial_induced_m_s),
        ("Lift coefficient", result.cl),
        ("Drag coefficient", result.cd),
        ("Reynolds number", result.reynolds),
        ("Thrust per radius (N/m)", _load_per_radius(result, result.dT_N)),
    )
    figure = blank_figure(9.0, 6.0)
    grid = figure.subplots(2, 3, sharex=True)
    beyond = result.outside > 0
    for axes, (label, values) in zip(grid.flat, panels, strict=True):
        axes.plot(r, values)
        if beyond.any():
            axes.plot(r[beyond], values[beyond], "x", color="C3", label="beyond the polar")
        label_axes(axes, y=label)
    for axes in grid[1]:
        axes.set_xlabel("Radius (mm)")
    if beyond.any():
        grid[0, 0].legend(fontsize="small")
    figure.suptitle(
        f"pitch {math.degrees(result.pitch_rad):.2f} deg, {result.speed_rad_s / RPM:.0f} rpm: "
        f"thrust {result.thrust_N:.4g} N, torque {result.torque_Nm:.4g} N m",
        fontsize="medium",
    )
    return figure


@draws(RotorFit)
def draw_rotor_fit(found: RotorFit) -> Figure:
    """Draw measured loads, the prediction before the fit, and the fit with its 90 % interval over rotor speed.

    Each pitch setting has a colour. Tunnel runs are drawn over the advance ratio, with a colour for each pitch and
    speed.
    """
    m = found.measured
    figure = blank_figure(9.0, 4.0)
    axes = figure.subplots(1, 2)
    over_J = 2.0 * math.pi * m.climb_m_s / (2.0 * found.rotor.radius_m * m.speed_rad_s)
    along = over_J if m.has_axial_flow else m.speed_rad_s / RPM
    kinds = np.round(m.pitch_rad, 6), np.round(np.log(m.speed_rad_s) / 0.05) * m.has_axial_flow
    groups, member = np.unique(np.stack(kinds), axis=1, return_inverse=True)
    for k in range(groups.shape[1]):
        here = np.flatnonzero(member.ravel() == k)
        pitch, mean_speed = m.pitch_rad[here[0]], float(m.speed_rad_s[here].mean())
        low, high = along[here].min(), along[here].max()
        x = np.linspace(low, high, 25) if m.has_axial_flow else np.linspace(0.9 * low, 1.1 * high, 25)
        speed = np.full(25, mean_speed) if m.has_axial_flow else x * RPM
        climb = x * found.rotor.radius_m * speed / math.pi if m.has_axial_flow else np.zeros(25)
        band = predict_interval(
            found.rotor, pitch_rad=pitch, speed_rad_s=speed, climb_m_s=climb, air=found.air,
            n_crit=found.section_fit.n_crit,
        )  # fmt: skip
        rows = (
            (m.thrust_N, band.thrust_N, band.thrust_low_N, band.thrust_high_N, 1.0),
            (m.torque_Nm, band.torque_Nm, band.torque_low_Nm, band.torque_high_Nm, 1e3),
        )
        given = np.stack((m.thrust_N, m.torque_Nm)) + found.scaled_errors_before * found.load_scales
        order = here[np.argsort(along[here])]
        for ax, (measured, mean, below, above, scale), before in zip(axes, rows, given, strict=True):
            colour, first = f"C{k % 10}", k == 0
            ax.fill_between(x, scale * below, scale * above, color=colour, alpha=0.2, lw=0)
            ax.plot(x, scale * mean, color=colour, label="fitted, 90 % interval" if first else None)
            ax.plot(
                along[order], scale * before[order], ":", color=colour, marker=".",
                label="as given" if first else None,
            )  # fmt: skip
            label = "measured" if first else None
            ax.plot(along[here], scale * measured[here], "o", color=colour, mfc="none", label=label)
            text = f"{mean_speed / RPM:.0f} rpm" if m.has_axial_flow else f"{math.degrees(pitch):.3g}°"
            ax.annotate(text, (x[-1], scale * mean[-1]), color=colour, fontsize="small")
    for ax, label in zip(axes, ("Thrust (N)", "Torque (mN m)"), strict=True):
        ax.set_xlabel("Advance ratio V / (n D)" if m.has_axial_flow else "Speed (rpm)")
        ax.set_ylabel(label)
        ax.margins(x=0.1)
        ax.grid(alpha=0.3)
    axes[0].legend(fontsize="small")
    sections = "/".join(dict.fromkeys(found.rotor.blade.airfoils))
    figure.suptitle(f"{found.rotor.name}: {sections}, {m.source}", fontsize="medium")
    return figure


def draw_coefficient_map(coefficients: CoefficientMap) -> Figure:
    """Draw thrust and torque coefficients of both rotors at the middle of the mean speeds.

    The left side is over the speed ratio for three climbs, the right side over the climb velocity for three ratios.
    Lines are the interpolation of the flight model, dots the solved points, crosses points filled from neighbours.
    """
    t = coefficients.decode_map_tables()
    k = t.grid_shape[0] // 2
    mean = float(t.mean_speed_rad_s[k])
    tip = mean * coefficients.radius_m
    hover = int(np.argmin(np.abs(t.climb_ratio)))
    even = int(np.argmin(np.abs(t.ratio - 1.0)))
    figure = blank_figure(10.0, 7.0)
    axes = figure.subplots(2, 2, sharey="row")
    tables = ((t.cT_upper, t.cT_lower), (t.cQ_upper, t.cQ_lower))
    for row in range(2):
        for side, chosen in (
            (0, sorted({0, hover, t.grid_shape[2] - 1})),
            (1, sorted({0, even, t.grid_shape[1] - 1})),
        ):
            panel = axes[row, side]
            axis = t.ratio if side == 0 else t.climb_ratio
            fine = np.linspace(float(axis[0]), float(axis[-1]), 201)
            for colour, n in enumerate(chosen):
                other = float(t.climb_ratio[n] if side == 0 else t.ratio[n])
                place = (fine, other) if side == 0 else (other, fine)
                values, _ = interpolate_map(coefficients, mean, *place)
                for which, (name, line, mark) in enumerate(_ROTOR_STYLES):
                    points = tables[row][which][k, :, n] if side == 0 else tables[row][which][k, n, :]
                    good = t.solved[k, :, n] if side == 0 else t.solved[k, n, :]
                    label = f"climb {other * tip:+.2f} m/s" if side == 0 else f"ratio {other:.2f}"
                    scale = 1.0 if side == 0 else tip
                    panel.plot(
                        fine * scale, values[:, 2 * which + row], line, color=f"C{colour}",
                        label=f"{name}, {label}",
                    )  # fmt: skip
                    panel.plot(axis[good] * scale, points[good], mark, color=f"C{colour}", markersize=3)
                    panel.plot(axis[~good] * scale, points[~good], "x", color=f"C{colour}", markersize=7)
            panel.grid(alpha=0.3)
            if side == 0:
                panel.set_ylabel(_COEFFICIENT_LABELS[row])
            if row == 1:
                panel.set_xlabel("lower over upper speed (1)" if side == 0 else "climb velocity (m/s)")
            else:
                panel.legend(fontsize=7)
    figure.suptitle(
        f"{coefficients.name}: {coefficients.description}\nat a mean speed of {mean / RPM:.0f} rpm; "
        "x: filled from neighbours",
        fontsize=8,
    )
    return figure


@draws(Airfoil)
def draw_airfoil_section(airfoil: Airfoil) -> Figure:
    """Draw the contour of a section."""
    figure = blank_figure(7.0, 2.4)
    axes = figure.subplots()
    axes.plot(*airfoil.coordinates.T)
    axes.set(xlabel="x / c", ylabel="y / c", aspect="equal")
    axes.grid(alpha=0.3)
    axes.set_title(
        f"{airfoil.name}: thickness {100 * airfoil.thickness_ratio:.1f} %, camber {100 * airfoil.camber:.1f} %",
        fontsize="medium",
    )
    return figure


@draws(PolarTable)
def draw_polar(polar: PolarTable, reynolds: Sequence[float] = (1e4, 2e4, 5e4, 1e5)) -> Figure:
    """Draw lift over angle of attack and over drag, at the tabulated Reynolds numbers next to those given.

    Lines are solid where the engine computed the polar and dotted where it is extended.
    """
    figure = blank_figure(9.0, 4.0)
    left, right = figure.subplots(1, 2)
    alpha = np.degrees(polar.alpha_rad)
    for colour, k in enumerate(dict.fromkeys(int(np.argmin(np.abs(np.log(polar.reynolds / re)))) for re in reynolds)):
        low, high = np.degrees(polar.alpha_valid_rad[k])
        shown, known = np.abs(alpha) <= 30.0, (alpha >= low) & (alpha <= high)
        label = f"Re {polar.reynolds[k]:.3g}"
        left.plot(alpha[shown], polar.cl[k, shown], ":", color=f"C{colour}", lw=0.9)
        left.plot(alpha[known], polar.cl[k, known], color=f"C{colour}", label=label)
        right.plot(polar.cd[k, known], polar.cl[k, known], color=f"C{colour}", label=label)
    left.set(xlabel="Angle of attack (deg)", ylabel="Lift coefficient")
    right.set(xlabel="Drag coefficient", ylabel="Lift coefficient")
    for axes in (left, right):
        axes.grid(alpha=0.3)
    left.legend(fontsize="small")
    figure.suptitle(f"{polar.name}: {polar.source}", fontsize="medium")
    return figure


@draws(MeasurementComparison)
def draw_bench_comparison(found: MeasurementComparison) -> Figure:
    """Draw measured and predicted loads over rotor speed, or over climb if there is any; a colour for each pitch."""
    figure = blank_figure(9.0, 4.0)
    m = found.measured
    panels = (
        ("Thrust (N)", m.thrust_N, found.thrust_N, 1.0),
        ("Torque (mN m)", m.torque_Nm, found.torque_Nm, 1e3),
    )
    over, label = (m.climb_m_s, "Axial speed (m/s)") if m.has_axial_flow else (m.speed_rad_s / RPM, "Speed (rpm)")
    for axes, (load, measured, predicted, scale) in zip(figure.subplots(1, 2), panels, strict=True):
        for k, pitch in enumerate(np.unique(np.round(m.pitch_rad, 5))):
            here = np.flatnonzero(np.abs(m.pitch_rad - pitch) < 1e-4)
            here = here[np.argsort(over[here])]
            line = "none" if m.has_axial_flow else "-"  # each climb has several rotor speeds
            name, colour = f"{math.degrees(pitch):.3g}°", f"C{k % 10}"
            axes.plot(over[here], scale * measured[here], "o", mfc="none", color=colour, label=f"{name}, measured")
            axes.plot(
                over[here],
                scale * predicted[here],
                ".",
                ls=line,
                lw=1.0,
                color=colour,
                label=f"{name}, predicted",
            )
        axes.set(xlabel=label, ylabel=load)
        axes.grid(alpha=0.3)
    figure.axes[0].legend(fontsize="small")
    figure.suptitle(m.source, fontsize="medium")
    return figure


# Wakes


def _rotor_names(count: int) -> Sequence[str]:
    return _PAIR_SIDE_NAMES if count == 2 else ("rotor",)


def draw_wake(solution: SystemSolution) -> Figure:
    """Draw two turns of the trailing vortices in 3-D, coloured by the magnitude of circulation, one panel per rotor."""
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import Normalize
    from matplotlib.ticker import MaxNLocator
    from mpl_toolkits.mplot3d.art3d import Line3DCollection, Poly3DCollection

    n, turns = len(solution.wakes), 2.0
    figure = blank_figure(5.5 * n, 6.5)
    strengths = [1e3 * np.abs(w.filament_circulation_m2_s) for w in solution.wakes]
    most = max(float(s.max()) for s in strengths)
    norm = Normalize(0.0, most)
    radius = max(w.surface.radius_m for w in solution.wakes) * 1e3
    shown = [w.filament_paths_m[:, w.filament_ages_rad <= 2.0 * math.pi * turns] * 1e3 for w in solution.wakes]
    low, high = min(float(p[..., 2].min()) for p in shown), max(float(p[..., 2].max()) for p in shown)
    colours = ScalarMappable(norm, "viridis_r")
    for k, (wake, paths, strength) in enumerate(zip(solution.wakes, shown, strengths, strict=True)):
        axes = figure.add_subplot(1, n, k + 1, projection="3d")
        order = np.argsort(strength)
        for b in range(wake.surface.blade_count):
            angle = 2.0 * math.pi * b / wake.surface.blade_count
            c, s = math.cos(angle), math.sin(angle)
            turned = paths @ np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])
            share = strength[order] / most
            axes.add_collection(
                Line3DCollection(
                    list(turned[order]), colors=colours.to_rgba(strength[order]), linewidths=0.3 + 1.2 * share,
                )
            )  # fmt: skip
            edge = turned[:, 0]
            nose = edge + (edge - turned[:, 1]) / 3.0  # a quarter of the chord ahead of that line
            blade = np.concatenate([nose, turned[::-1, 1]])
            axes.add_collection(Poly3DCollection([blade.tolist()], facecolors="0.3", edgecolors="k", alpha=0.9))
        axes.set(
            xlim=(-radius, radius), ylim=(-radius, radius), zlim=(low, high), xlabel="x (mm)", ylabel="y (mm)",
            zlabel="z (mm)",
        )  # fmt: skip
        axes.set_box_aspect((1.0, 1.0, max(0.6, (high - low) / (2.0 * radius))), zoom=0.9)
        axes.xaxis.set_major_locator(MaxNLocator(4))
        axes.yaxis.set_major_locator(MaxNLocator(4))
        axes.zaxis.labelpad = 10.0
        axes.view_init(elev=12.0, azim=-60.0)
        r = solution.rotors[k]
        axes.set_title(
            f"{_rotor_names(n)[k]}: {r.speed_rad_s / RPM:.0f} rpm, {math.degrees(r.pitch_rad):.2f} deg, "
            f"{r.thrust_N:.4g} N", fontsize="medium", y=0.98,
        )  # fmt: skip
    bar = figure.colorbar(colours, ax=figure.axes, shrink=0.5, location="bottom", pad=0.04)
    bar.set_label(f"Circulation of the trailing vortices ($10^{{-3}}$ m$^2$/s), first {turns:g} turns")
    return figure


def compute_shaft_plane_velocity(
    solution: SystemSolution, x_m: Array, z_m: Array, *, phases: int = 12
) -> tuple[Array, Array, Array]:
    """Return the velocity of the air in the plane y = 0.

    Parameters
    ----------
    solution : SystemSolution
    x_m, z_m : (nx,), (nz,) arrays
    phases : int
        Number of blade azimuths in the average, evenly spaced over one blade passage. With 1 the plane lies a quarter
        of the way from one blade to the next.

    Returns
    -------
    u, v, w : (nz, nx) arrays
        Along x, through the plane, and along z (m/s); climb included.
    """
    from mufly.rotor.wake import induced_velocity  # slow import (compilation), needed only here

    grid = np.stack(np.meshgrid(x_m, [0.0], z_m, indexing="ij"), axis=-1)[:, 0].transpose(1, 0, 2)
    blades = np.array([w.surface.blade_count for w in solution.wakes], dtype=np.float64)
    total = np.zeros_like(grid)
    for k in range(phases):
        part = 0.25 if phases == 1 else (k + 0.5) / phases
        total += induced_velocity(solution, grid, 2.0 * math.pi * part / blades)
    total /= phases
    total[..., 2] -= solution.climb_m_s
    return total[..., 0], total[..., 1], total[..., 2]


def draw_flow_field(solution: SystemSolution, *, mean: bool = True, points: int = 80, phases: int = 12) -> Figure:
    """Draw the air in a vertical plane through the shaft.

    With ``mean``, speed and streamlines are averaged over azimuth. Without it an instant is drawn: vorticity normal to
    the plane, which shows the vortices that cross it, and velocity arrows (as Figs. 3.6 and 3.19 of the dissertation).

    Raises
    ------
    InputError
        If fewer than ten points across are requested.
    """
    from matplotlib.ticker import MaxNLocator

    if points < 10:
        raise InputError("picture", "points", f"{points} is too few", "give 10 or more")
    radius = max(w.surface.radius_m for w in solution.wakes)
    heights = [w.placed.height_m for w in solution.wakes]
    top, bottom = max(heights) + 1.0 * radius, min(heights) - 2.5 * radius
    x = np.linspace(-1.6 * radius, 1.6 * radius, points)
    z = np.linspace(bottom, top, max(10, round(points * (top - bottom) / (3.2 * radius))))
    u, _, w = compute_shaft_plane_velocity(solution, x, z, phases=phases if mean else 1)
    figure = blank_figure(7.0, 6.6)
    axes = figure.subplots()
    mx, mz = 1e3 * x, 1e3 * z
    if mean:
        speed = np.hypot(u, w)
        levels = MaxNLocator(15).tick_values(0.0, max(float(np.quantile(speed, 0.998)), 1e-9))
        drawn = axes.contourf(mx, mz, speed, levels=levels, cmap="Blues", extend="max")
        axes.streamplot(mx, mz, u, w, color="0.25", linewidth=0.6, density=1.4, arrowsize=0.7)
        label, title = "Speed in the plane (m/s)", f"mean over {phases} azimuths"
    else:
        around = np.gradient(u, z, axis=0) - np.gradient(w, x, axis=1)
        most = max(float(np.quantile(np.abs(around), 0.995)), 1e-9)
        drawn = axes.contourf(
            mx, mz, around, levels=MaxNLocator(20).tick_values(-most, most), cmap="RdBu_r", extend="both"
        )
        step = max(1, points // 32)
        axes.quiver(
            mx[::step], mz[::step], u[::step, ::step], w[::step, ::step], width=0.0022, color="0.2",
            scale=22.0 * max(float(np.quantile(np.hypot(u, w), 0.98)), 1e-9),
        )  # fmt: skip
        label = "Vorticity through the plane (1/s)"
        title = "an instant, blades a quarter period from the plane"
    for wake in solution.wakes:
        s, h = wake.surface, 1e3 * wake.placed.height_m
        for sign in (-1.0, 1.0):
            axes.plot(sign * 1e3 * s.edge_quarter_chord_m[[0, -1], 0], [h, h], color="k", linewidth=2.5)
    axes.set(xlabel="x (mm)", ylabel="z along the shaft (mm)", xlim=mx[[0, -1]], ylim=mz[[0, -1]])
    axes.set_aspect("equal")
    axes.set_title(f"Air around the {'pair' if len(solution.wakes) == 2 else 'rotor'}, {title}", fontsize="medium")
    figure.colorbar(drawn, ax=axes, shrink=0.7).set_label(label)
    return figure


def draw_pair_spanwise_loads(
    upper: RotorResult, lower: RotorResult, alone: Sequence[RotorResult] | None = None
) -> Figure:
    """Draw inflow, angle of attack, lift, thrust and torque along the blades of both rotors, isolated rotors dashed."""
    figure = blank_figure(10.0, 6.0)
    panels: tuple[tuple[str, Callable[[RotorResult], Array]], ...] = (
        ("Induced velocity down the shaft (m/s)", lambda r: r.axial_induced_m_s),
        ("Swirl (m/s)", lambda r: r.swirl_m_s),
        ("Angle of attack (deg)", lambda r: np.degrees(r.alpha_rad)),
        ("Lift coefficient", lambda r: r.cl),
        ("Thrust per radius (N/m)", lambda r: _load_per_radius(r, r.dT_N)),
        ("Torque per radius (N m/m)", lambda r: _load_per_radius(r, r.dQ_Nm)),
    )
    grid = figure.subplots(2, 3, sharex=True)
    for axes, (label, of) in zip(grid.flat, panels, strict=True):
        for k, r in enumerate((upper, lower)):
            axes.plot(1e3 * r.r_m, of(r), color=_ROTOR_COLOURS[k], label=_PAIR_SIDE_NAMES[k])
            if alone is not None and not (k == 1 and alone[1] is alone[0]):
                note = "alone" if alone[1] is alone[0] else f"{_PAIR_SIDE_NAMES[k]} alone"
                colour = "0.4" if alone[1] is alone[0] else _ROTOR_COLOURS[k]
                axes.plot(1e3 * alone[k].r_m, of(alone[k]), "--", color=colour, linewidth=1.0, label=note)
        label_axes(axes, y=label)
    for axes in grid[1]:
        axes.set_xlabel("Radius (mm)")
    grid[0, 0].legend(fontsize="small")
    figure.suptitle(
        "; ".join(
            f"{side} {r.speed_rad_s / RPM:.0f} rpm, {math.degrees(r.pitch_rad):.2f} deg: {r.thrust_N:.4g} N, "
            f"{r.torque_Nm:.4g} N m"
            for side, r in zip(_PAIR_SIDE_NAMES, (upper, lower), strict=True)
        ),
        fontsize="medium",
    )
    return figure


@draws(SystemSolution)
def draw_system_spanwise_loads(found: SystemSolution) -> Figure:
    """Draw the spanwise loads of a system of one rotor or a pair."""
    return (
        draw_spanwise_loads(found.rotors[0])
        if len(found.rotors) == 1
        else draw_pair_spanwise_loads(found.upper, found.lower)
    )


def draw_wake_convergence(history: Array, *, residual: float | None = None, note: str = "") -> Figure:
    """Draw the convergence of a wake.

    Parameters
    ----------
    history : (iterations, 1 + 2 rotors) array
        As in ``SystemSolution.read_history``.
    residual : float, optional
        Convergence limit, drawn as a line.
    note : str
        Title.
    """
    figure = blank_figure(7.0, 6.0)
    first, second, third = figure.subplots(3, 1, sharex=True)
    turn = np.arange(1, len(history) + 1)
    miss = history[:, 0]
    # While a free wake is held in the prescribed shape, its residual is larger than any later residual.
    first.semilogy(turn, 100.0 * np.where(miss < 9.0, np.maximum(miss, 1e-12), np.nan))
    if residual is not None:
        first.axhline(100.0 * residual, color="0.5", linestyle=":", label="wanted")
        first.legend(fontsize="small")
    first.set_ylabel("Wake misses the air by\n(% of its velocity)")
    n = (history.shape[1] - 1) // 2
    for k in range(n):
        second.plot(turn, history[:, 1 + 2 * k], color=_ROTOR_COLOURS[k], label=_rotor_names(n)[k])
        third.plot(turn, 1e3 * history[:, 2 + 2 * k], color=_ROTOR_COLOURS[k], label=_rotor_names(n)[k])
    second.set_ylabel("Thrust (N)")
    third.set_ylabel("Torque (mN m)")
    third.set_xlabel("Iteration")
    for axes in (first, second, third):
        axes.grid(alpha=0.3)
    if n > 1:
        second.legend(fontsize="small")
    if note:
        figure.suptitle(note, fontsize="medium")
    return figure
