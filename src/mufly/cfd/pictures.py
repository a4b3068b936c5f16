"""Pictures of meshes and solutions."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from mufly.cfd.point import Beside, MeanPair
from mufly.cfd.polymesh import PolyMesh
from mufly.cfd.results import Solution
from mufly.units import RPM

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Array = NDArray[np.float64]


def _figure(width: float, height: float) -> Figure:
    from matplotlib.figure import Figure

    return Figure(figsize=(width, height), layout="constrained")


def mesh_picture(mesh: PolyMesh) -> Figure:
    """The mesh: the blade's surface from above, the periodic plane, the section in the middle of the blade."""
    figure = _figure(11.0, 7.5)
    grid = figure.add_gridspec(2, 2, width_ratios=(1.0, 1.2))
    blade, section = figure.add_subplot(grid[0, :]), figure.add_subplot(grid[1, 1])
    plane = figure.add_subplot(grid[1, 0])
    faces = mesh.patch("blade")
    up = mesh.face_areas[faces][:, 2] < 0.0  # area vectors leave the air
    _draw(blade, 1e3 * mesh.points[mesh.faces[faces]][up][..., [1, 0]])
    blade.set(title="Blade from above", xlabel="radius (mm)", ylabel="aft (mm)")
    quads = np.concatenate([mesh.faces[mesh.patch(p)] for p in ("sector_left", "sector_right")])
    _draw(plane, 1e3 * mesh.points[quads][..., [0, 2]])
    plane.set(title="Periodic plane", xlabel="x (mm)", ylabel="z (mm)")
    middle = mesh.edges_m[len(mesh.edges_m) // 2]
    at = np.abs(mesh.points[mesh.faces][..., 1] - middle).max(axis=1) < 1e-9
    span = 1e3 * float(np.ptp(mesh.points[mesh.faces[faces]][..., 0]))
    _draw(section, 1e3 * mesh.points[mesh.faces[at]][..., [0, 2]])
    section.set(
        title=f"Section at {1e3 * middle:.1f} mm", xlabel="x (mm)", ylabel="z (mm)", xlim=(-0.7 * span, 1.3 * span),
        ylim=(-0.7 * span, 0.7 * span),
    )  # fmt: skip
    return figure


def _draw(axes: Axes, quads: Array) -> None:
    from matplotlib.collections import PolyCollection

    axes.add_collection(PolyCollection(list(quads), facecolors="white", edgecolors="0.25", linewidths=0.25))
    axes.autoscale_view()
    axes.set_aspect("equal")


def pressure_picture(mesh: PolyMesh, solution: Solution) -> Figure:
    """Pressure on the blade's upper and lower side.

    Thesis: Fig. 3.23.
    """
    from matplotlib.collections import PolyCollection

    figure = _figure(9.0, 5.5)
    faces = mesh.patch("blade")
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


_METHODS = {"bemt": "blade elements", "wake": "vortex wake"}


def loads_picture(solution: Solution, others: Sequence[Beside] = ()) -> Figure:
    """Thrust and torque along the blade, beside other methods'."""
    figure = _figure(9.0, 4.0)
    axes = figure.subplots(1, 2)
    rows = [(solution.r_m, solution.thrust_N_m, solution.torque_Nm_m, f"CFD, {solution.point.model}")]
    rows += [(o.r_m, o.thrust_N_m, o.torque_Nm_m, _METHODS.get(o.method, o.method)) for o in others]
    for k, (r, thrust, torque, name) in enumerate(rows):
        axes[0].plot(1e3 * r, thrust, "o-" if k == 0 else "-", ms=3, label=name)
        axes[1].plot(1e3 * r, 1e3 * torque, "o-" if k == 0 else "-", ms=3, label=name)
    for ax, ours, label in zip(
        axes,
        (solution.thrust_N_m, 1e3 * solution.torque_Nm_m),
        ("thrust per span (N/m)", "torque per span (mN m/m)"),
        strict=True,
    ):
        # The vortex wake's end panels have spikes that would squeeze all else.
        low, high = min(0.0, float(ours.min())), max(0.0, float(ours.max()))
        room = max(high - low, 1e-12)
        ax.set(xlabel="radius (mm)", ylabel=label, ylim=(low - 0.1 * room, high + 0.25 * room))
    axes[0].legend()
    p = solution.point
    title = f"{p.rotor}, {np.degrees(p.pitch_rad):.3g}°, {p.speed_rad_s / RPM:.0f} rpm"
    if p.form:
        title += f", with {p.form}" + (" (the others: plain blade)" if others else "")
    if not solution.verdict.settled:
        title += f"\nnot settled ({solution.verdict.what})"
    figure.suptitle(title)
    return figure


def pair_picture(pair: MeanPair) -> Figure:
    """Thrust and torque along the blades of both rotors of a pair."""
    figure = _figure(9.0, 4.0)
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


def history_picture(history: Array) -> Figure:
    """Thrust and torque over the iterations, near what they end at: false plateaus lie 3 to 4 % below."""
    figure = _figure(7.0, 4.0)
    axes = figure.subplots(2, 1, sharex=True)
    for ax, column, label, factor in zip(
        axes, (1, 2), ("thrust (N)", "torque (mN m)"), (1.0, 1e3), strict=True
    ):
        ax.plot(history[:, 0], factor * history[:, column])
        last = factor * float(history[-1, column])
        ax.set_ylim(*sorted((0.85 * last, 1.15 * last)))
        ax.set_ylabel(label)
        ax.grid(alpha=0.3)
    axes[1].set_xlabel("iteration")
    return figure
