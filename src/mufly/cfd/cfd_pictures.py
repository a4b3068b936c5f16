"""Pictures of CFD meshes and solutions."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from mufly.cfd.case_studies import PairSolution, SpanLoads
from mufly.cfd.cfd_comparison import ClimbComparison
from mufly.cfd.cfd_solution import CfdSolution, FlowField, FlowSampler, WakeProfile
from mufly.cfd.meshes.polymesh import PolyMesh
from mufly.cfd.openfoam_case import OperatingPoint
from mufly.quantities.units import RPM
from mufly.results import draws
from mufly.results.result_figure import blank_figure, label_axes

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Array = NDArray[np.float64]


def draw_mesh(mesh: PolyMesh) -> Figure:
    """Draw a mesh: blade surface from above, periodic plane, and section at mid-span."""
    figure = blank_figure(11.0, 7.5)
    grid = figure.add_gridspec(2, 2, width_ratios=(1.0, 1.2))
    blade, section = figure.add_subplot(grid[0, :]), figure.add_subplot(grid[1, 1])
    plane = figure.add_subplot(grid[1, 0])
    faces = mesh.patch_face_slice("blade")
    up = mesh.face_areas[faces][:, 2] < 0.0  # area vectors point out of the air
    _draw_quads(blade, 1e3 * mesh.points[mesh.faces[faces]][up][..., [1, 0]])
    blade.set(title="Blade from above", xlabel="radius (mm)", ylabel="aft (mm)")
    quads = np.concatenate([mesh.faces[mesh.patch_face_slice(p)] for p in ("sector_left", "sector_right")])
    _draw_quads(plane, 1e3 * mesh.points[quads][..., [0, 2]])
    plane.set(title="Periodic plane", xlabel="x (mm)", ylabel="z (mm)")
    middle = mesh.strip_edges_m[len(mesh.strip_edges_m) // 2]
    at = np.abs(mesh.points[mesh.faces][..., 1] - middle).max(axis=1) < 1e-9
    span = 1e3 * float(np.ptp(mesh.points[mesh.faces[faces]][..., 0]))
    _draw_quads(section, 1e3 * mesh.points[mesh.faces[at]][..., [0, 2]])
    section.set(
        title=f"Section at {1e3 * middle:.1f} mm", xlabel="x (mm)", ylabel="z (mm)", xlim=(-0.7 * span, 1.3 * span),
        ylim=(-0.7 * span, 0.7 * span),
    )  # fmt: skip
    return figure


def _draw_quads(axes: Axes, quads: Array) -> None:
    from matplotlib.collections import PolyCollection

    axes.add_collection(PolyCollection(list(quads), facecolors="white", edgecolors="0.25", linewidths=0.25))
    axes.autoscale_view()
    axes.set_aspect("equal")


def draw_surface_pressure(mesh: PolyMesh, solution: CfdSolution) -> Figure:
    """Draw the pressure on the upper and lower side of the blade.

    Thesis: Fig. 3.23.
    """
    from matplotlib.collections import PolyCollection

    figure = blank_figure(9.0, 5.5)
    faces = mesh.patch_face_slice("blade")
    quads, area = 1e3 * mesh.points[mesh.faces[faces]], mesh.face_areas[faces][:, 2]
    low, high = np.percentile(solution.pressure_Pa, (1, 99))
    axes = figure.subplots(2, 1, sharex=True)
    for ax, side, title in zip(axes, (area < 0, area > 0), ("Upper side", "Lower side"), strict=True):
        patches = PolyCollection(
            list(quads[side][..., [1, 0]]),
            array=solution.pressure_Pa[side],
            cmap="viridis",
            edgecolors="face",
        )
        patches.set_clim(low, high)
        ax.add_collection(patches)
        ax.autoscale_view()
        ax.set_aspect("equal")
        ax.set(title=title, ylabel="aft (mm)")
    axes[1].set_xlabel("radius (mm)")
    figure.colorbar(patches, ax=list(axes), label="pressure (Pa)")
    return figure


_METHOD_LABELS = {"bemt": "blade elements", "wake": "vortex wake"}


@draws(CfdSolution)
def draw_span_loads(solution: CfdSolution, others: Sequence[SpanLoads] = ()) -> Figure:
    """Draw thrust and torque along the blade, by CFD and by the methods in ``others``."""
    figure = blank_figure(9.0, 4.0)
    axes = figure.subplots(1, 2)
    rows = [(solution.r_m, solution.thrust_N_m, solution.torque_Nm_m, f"CFD, {solution.point.model}")]
    rows += [(o.r_m, o.thrust_N_m, o.torque_Nm_m, _METHOD_LABELS.get(o.method, o.method)) for o in others]
    for k, (r, thrust, torque, name) in enumerate(rows):
        axes[0].plot(1e3 * r, thrust, "o-" if k == 0 else "-", ms=3, label=name)
        axes[1].plot(1e3 * r, 1e3 * torque, "o-" if k == 0 else "-", ms=3, label=name)
    for ax, ours, label in zip(
        axes,
        (solution.thrust_N_m, 1e3 * solution.torque_Nm_m),
        ("thrust per span (N/m)", "torque per span (mN m/m)"),
        strict=True,
    ):
        # The end panels of the vortex wake have spikes that would compress the scale.
        low, high = min(0.0, float(ours.min())), max(0.0, float(ours.max()))
        room = max(high - low, 1e-12)
        ax.set(xlabel="radius (mm)", ylabel=label, ylim=(low - 0.1 * room, high + 0.25 * room))
    axes[0].legend()
    p = solution.point
    title = f"{p.rotor}, {np.degrees(p.pitch_rad):.3g}°, {p.speed_rad_s / RPM:.0f} rpm"
    if p.geometry_note:
        title += f", with {p.geometry_note}" + (" (the others: plain blade)" if others else "")
    if not solution.verdict.settled:
        title += f"\nnot settled ({solution.verdict.outcome})"
    figure.suptitle(title)
    return figure


@draws(PairSolution)
def draw_pair_span_loads(pair: PairSolution) -> Figure:
    """Draw thrust and torque along the blades of both rotors of a pair."""
    figure = blank_figure(9.0, 4.0)
    axes = figure.subplots(1, 2)
    for one, name in ((pair.upper, "upper rotor"), (pair.lower, "lower rotor")):
        axes[0].plot(1e3 * one.r_m, one.thrust_N_m, "o-", ms=3, label=name)
        axes[1].plot(1e3 * one.r_m, 1e3 * one.torque_Nm_m, "o-", ms=3, label=name)
    for ax, label in zip(axes, ("thrust per span (N/m)", "torque per span (mN m/m)"), strict=True):
        ax.set(xlabel="radius (mm)", ylabel=label)
        ax.grid(alpha=0.3)
    axes[0].legend()
    p = pair.upper.point
    figure.suptitle(
        f"{p.rotor}, {-1e3 * p.other_m:.3g} mm apart, lower over upper: thrust {pair.thrust_ratio:.3f}, torque "
        f"{pair.torque_ratio:.3f}" + ("" if pair.settled else " (not settled)")
    )
    return figure


@draws(ClimbComparison)
def draw_climb_comparison(found: ClimbComparison) -> Figure:
    """Draw the thrust coefficient over the climb velocity, and its change from hover, by CFD and the other methods; the
    change also by the flight model's map.

    The picture corresponds to Fig. 4.2 of the dissertation, which
    :func:`mufly.thesis.blade_element_studies.study_coefficients_in_climb` assesses.
    """
    figure = blank_figure(10.0, 4.4)
    axes = figure.subplots(1, 2)
    w, hover = found.climb_m_s, np.flatnonzero(found.climb_m_s == 0.0)
    settled = np.array([s.verdict.settled for s in found.solutions])
    rows = [(found.c_T, f"CFD, {found.solutions[0].point.model}", "o-")]
    rows += [(values, _METHOD_LABELS.get(name, name), ".-") for name, values in found.other_methods.items()]
    for values, name, style in rows:
        axes[0].plot(w, values, style, label=name)
        if hover.size:
            axes[1].plot(w, 100.0 * (values / values[hover[0]] - 1.0), style, label=name)
    if not settled.all():
        axes[0].plot(w[~settled], found.c_T[~settled], "x", ms=10, color="#c0392b", label="not settled")
    axes[0].set(ylabel="c_T", ylim=(0.0, None))
    axes[1].plot(
        w,
        100.0 * (found.map_thrust_ratio - 1.0),
        "--",
        color="0.3",
        label=f"flight model's map\n{found.map_name}, upper rotor",
    )
    axes[1].set(ylabel="thrust, change from hover (%)")
    for ax in axes:
        label_axes(ax, "climb (m/s); below 0 descent")
        ax.legend(fontsize="small")
    p = found.solutions[0].point
    figure.suptitle(f"{p.rotor}, {np.degrees(p.pitch_rad):.3g}°, {abs(p.speed_rad_s) / RPM:.0f} rpm")
    return figure


def draw_iteration_history(history: Array) -> Figure:
    """Draw thrust and torque over the iterations; the axes extend 15 % below and above the final values.

    False plateaus, 3 to 4 % below the final values, are visible at this scale.
    """
    figure = blank_figure(7.0, 4.0)
    axes = figure.subplots(2, 1, sharex=True)
    for ax, column, label, factor in zip(axes, (1, 2), ("thrust (N)", "torque (mN m)"), (1.0, 1e3), strict=True):
        ax.plot(history[:, 0], factor * history[:, column])
        last = factor * float(history[-1, column])
        ax.set_ylim(*sorted((0.85 * last, 1.15 * last)))
        label_axes(ax, y=label)
    axes[1].set_xlabel("iteration")
    return figure


def draw_skin_friction(mesh: PolyMesh, solution: CfdSolution) -> Figure:
    """Draw skin-friction lines on the upper and lower side of the blade, seen from above, with regions of reversed
    flow.

    The lines follow the wall shear stress. At a separation line they converge from both sides.
    """
    from scipy.interpolate import LinearNDInterpolator
    from scipy.spatial import cKDTree

    figure = blank_figure(9.0, 6.0)
    faces = mesh.patch_face_slice("blade")
    sense = np.sign(solution.point.speed_rad_s)
    centre, normal = 1e3 * mesh.face_centres[faces], mesh.face_areas[faces]
    flat = np.abs(normal[:, 2]) > 0.3 * np.linalg.norm(normal, axis=1)  # excludes caps and the blunt trailing edge
    of_blade = mesh.cell_strip[mesh.owner[faces]] >= 0  # excludes the hub
    axes = figure.subplots(2, 1, sharex=True)
    for ax, side, title in zip(axes, (normal[:, 2] < 0, normal[:, 2] > 0), ("Upper side", "Lower side"), strict=True):
        k = side & flat & of_blade
        place = np.column_stack((centre[k, 1], sense * centre[k, 0]))
        stress = np.column_stack((solution.friction_Pa[k, 1], sense * solution.friction_Pa[k, 0]))
        (r0, a0), (r1, a1) = place.min(axis=0), place.max(axis=0)
        rr, aa = np.meshgrid(np.linspace(r0, r1, 240), np.linspace(a0, a1, 120))
        at = np.stack((rr, aa), axis=-1)
        found = LinearNDInterpolator(place, stress)(at)
        # Between the arms of a concave outline there is no blade: nothing on one lies that far from a face's centre.
        far = 0.75e3 * np.diff(mesh.strip_edges_m).max()
        beyond = np.isnan(found[..., 0]) | (cKDTree(place).query(at)[0] > far)
        t_r, t_a = (np.ma.masked_array(found[..., i], beyond) for i in (0, 1))
        ax.contourf(rr, aa, t_a, levels=[-1e9, 0.0], colors=["#f4b6a6"])
        ax.contour(rr, aa, t_a, levels=[0.0], colors="#c0392b", linewidths=1.0)
        size = np.ma.hypot(t_r, t_a)
        # Cut high: the nose would take all of the scale.
        shown = np.ma.minimum(size, np.percentile(size.compressed(), 95))
        lines = ax.streamplot(
            rr, aa, t_r, t_a, color=shown, cmap="viridis", density=(2.2, 1.1), linewidth=0.8, arrowsize=0.7,
            broken_streamlines=True,
        )  # fmt: skip
        ax.set_aspect("equal")
        ax.set(title=title, ylabel="aft (mm)")
        figure.colorbar(lines.lines, ax=ax, label="stress (Pa)")
    axes[1].set_xlabel("radius (mm); red: wall shear stress towards the nose")
    return figure


def draw_vorticity(mesh: PolyMesh, flow: FlowField, point: OperatingPoint) -> Figure:
    """Draw the azimuthal vorticity in planes through the shaft, at the blade and behind it."""
    figure = blank_figure(10.0, 6.5)
    radius, probe = point.radius_m, FlowSampler(mesh, flow)
    sense = np.sign(point.speed_rad_s)
    r, z = np.linspace(0.0, 1.4, 211), np.linspace(-1.2, 0.35, 233)
    rr, zz = np.meshgrid(r, z)
    grid = figure.subplots(2, 3, sharex=True, sharey=True)
    axes = grid.ravel()
    for ax, behind in zip(axes, VORTICITY_PLANES_DEG, strict=True):
        psi = np.full(rr.size, 0.5 * np.pi - sense * np.radians(behind))
        at = (radius * rr.ravel(), psi, radius * zz.ravel())
        spin = np.ma.masked_array(
            probe.sample_cylindrical(*at)[1][:, 1], probe.is_inside_solid(*at, point.patch_speeds_rad_s)
        )
        ax.set_facecolor("0.35")  # blade and hub
        image = ax.pcolormesh(
            rr, zz, spin.reshape(rr.shape) / abs(point.speed_rad_s), cmap="RdBu_r", vmin=-6.0, vmax=6.0,
            shading="nearest", rasterized=True,
        )  # fmt: skip
        ax.axhline(0.0, color="0.4", lw=0.5, ls=":")
        ax.set_aspect("equal")
        ax.set_title(f"{behind}° behind a blade" if behind else "at the blade", fontsize="medium")
    for ax in grid[-1]:
        ax.set_xlabel("radius / R")
    for ax in grid[:, 0]:
        ax.set_ylabel("height / R")
    figure.colorbar(image, ax=list(axes), label="vorticity around the shaft / rotor speed", extend="both", shrink=0.8)
    return figure


VORTICITY_PLANES_DEG = (0, 15, 30, 60, 90, 150)
"""Planes of the vorticity picture, in degrees behind a blade."""


def draw_vortices(
    surface: tuple[Array, NDArray[np.int64], dict[str, NDArray]], mesh: PolyMesh, point: OperatingPoint
) -> Figure:
    """Draw the vortex surfaces in 3-D with the blades, coloured by the downward velocity."""
    from matplotlib import colormaps
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import LightSource, Normalize
    from mpl_toolkits.mplot3d.art3d import Poly3DCollection

    points, triangles, data = surface
    figure = blank_figure(8.0, 6.5)
    axes = figure.add_subplot(projection="3d")
    walls = mesh.points[mesh.faces[mesh.patch_face_slice("blade")]]
    for i in range(mesh.blade_count):
        c, s = np.cos(2 * np.pi * i / mesh.blade_count), np.sin(2 * np.pi * i / mesh.blade_count)
        turned = walls @ np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])
        axes.add_collection3d(Poly3DCollection(list(turned / point.radius_m), facecolors="0.35"))
    corner = points[triangles] / point.radius_m
    down = data["down_m_s"]
    scale = Normalize(*np.percentile(down, (2, 98))) if len(down) else Normalize(0.0, 1.0)
    if len(triangles):
        colours = colormaps["viridis"](scale(down))[:, :3]
        normal = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
        normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-300)
        light = 0.55 + 0.45 * np.clip(normal @ LightSource(300, 50).direction, 0.0, 1.0)
        axes.add_collection3d(Poly3DCollection(list(corner), facecolors=colours * light[:, None]))
    # Vertical extent of the surfaces.
    height = np.append(corner[..., 2], 0.0)
    low, high = min(-0.3, float(height.min()) - 0.05), max(0.3, float(height.max()) + 0.05)
    axes.set(
        xlim=(-1.2, 1.2), ylim=(-1.2, 1.2), zlim=(low, high), xlabel="x / R", ylabel="y / R", zlabel="height / R"
    )  # fmt: skip
    axes.set_box_aspect((2.4, 2.4, high - low), zoom=1.15)
    axes.view_init(elev=22.0, azim=-35.0)
    figure.colorbar(ScalarMappable(scale, "viridis"), ax=axes, label="velocity down (m/s)", shrink=0.6)
    return figure


@draws(WakeProfile)
def draw_wake_profile(wake: WakeProfile) -> Figure:
    """Draw the azimuthally averaged velocity under the disc over radius, with that of momentum theory."""
    figure = blank_figure(9.0, 4.4)
    axes = figure.subplots(1, 2)
    for i, h in enumerate(wake.below_m):
        (line,) = axes[0].plot(1e3 * wake.r_m, wake.down_m_s[i], label=f"{1e3 * h:.3g} mm below")
        edge = 1e3 * wake.momentum_theory_radius_m[i]
        axes[0].plot(
            [0.0, edge, edge], [wake.momentum_theory_velocity_m_s[i]] * 2 + [0.0], ":", color=line.get_color(), lw=1.2
        )
        axes[1].plot(1e3 * wake.r_m, wake.swirl_m_s[i], color=line.get_color())
    axes[0].plot([], [], ":", color="0.4", label="momentum theory")
    axes[0].set(ylabel="velocity down (m/s)")
    axes[1].set(ylabel="velocity around, with the rotor (m/s)")
    for ax in axes:
        ax.set(xlabel="radius (mm)")
        ax.grid(alpha=0.3)
    figure.legend(*axes[0].get_legend_handles_labels(), loc="outside lower center", ncols=len(wake.below_m) + 1)
    figure.suptitle("Under the disc, mean around the shaft")
    return figure
