"""Pictures of wakes: vortices in space, the air in a plane through the shaft, loads along blades, convergence."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from mufly.errors import InputError
from mufly.rotor import RotorResult
from mufly.rotor.wake import WakeSolution, induced_velocity

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["field_picture", "history_picture", "plane_velocity", "rotor_loads_picture", "wake_picture"]

Array = NDArray[np.float64]

_SIDES = ("upper", "lower")
_COLOURS = ("C0", "C3")


def _figure(width: float, height: float) -> Figure:
    from matplotlib.figure import Figure

    return Figure(figsize=(width, height), layout="constrained")


def _names(count: int) -> Sequence[str]:
    return _SIDES if count == 2 else ("rotor",)


def wake_picture(solution: WakeSolution, *, turns: float = 2.0) -> Figure:
    """Draw the vortices that leave the blades in 3-D, coloured by the size of their circulation, one panel a rotor.

    Parameters
    ----------
    solution : WakeSolution
    turns : float
        How much of the wake is drawn, in turns of its rotor.
    """
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import Normalize
    from matplotlib.ticker import MaxNLocator
    from mpl_toolkits.mplot3d.art3d import Line3DCollection, Poly3DCollection

    n = len(solution.wakes)
    figure = _figure(5.5 * n, 6.5)
    strengths = [1e3 * np.abs(w.strength_m2_s) for w in solution.wakes]
    most = max(float(s.max()) for s in strengths)
    norm = Normalize(0.0, most)
    radius = max(w.surface.radius_m for w in solution.wakes) * 1e3
    shown = [w.paths_m[:, w.age_rad <= 2.0 * math.pi * turns] * 1e3 for w in solution.wakes]
    low, high = min(float(p[..., 2].min()) for p in shown), max(float(p[..., 2].max()) for p in shown)
    colours = ScalarMappable(norm, "viridis_r")
    for k, (wake, paths, strength) in enumerate(zip(solution.wakes, shown, strengths, strict=True)):
        axes = figure.add_subplot(1, n, k + 1, projection="3d")
        order = np.argsort(strength)
        for b in range(wake.surface.blades):
            angle = 2.0 * math.pi * b / wake.surface.blades
            c, s = math.cos(angle), math.sin(angle)
            turned = paths @ np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])
            share = strength[order] / most
            axes.add_collection(
                Line3DCollection(
                    list(turned[order]), colors=colours.to_rgba(strength[order]), linewidths=0.3 + 1.2 * share,
                )
            )  # fmt: skip
            edge = turned[:, 0]
            nose = edge + (edge - turned[:, 1]) / 3.0  # the quarter chord line is a quarter from the nose
            blade = np.concatenate([nose, turned[::-1, 1]])
            axes.add_collection(
                Poly3DCollection([blade.tolist()], facecolors="0.3", edgecolors="k", alpha=0.9)
            )
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
            f"{_names(n)[k]}: {r.speed_rad_s * 30 / math.pi:.0f} rpm, {math.degrees(r.pitch_rad):.2f} deg, "
            f"{r.thrust_N:.4g} N", fontsize="medium", y=0.98,
        )  # fmt: skip
    bar = figure.colorbar(colours, ax=figure.axes, shrink=0.5, location="bottom", pad=0.04)
    bar.set_label(f"Circulation of the trailing vortices ($10^{{-3}}$ m$^2$/s), first {turns:g} turns")
    return figure


def plane_velocity(
    solution: WakeSolution, x_m: Array, z_m: Array, *, phases: int = 12
) -> tuple[Array, Array, Array]:
    """Velocity of the air in the plane y = 0.

    Parameters
    ----------
    solution : WakeSolution
    x_m, z_m : (nx,), (nz,) arrays
    phases : int
        Azimuths of the blades that are averaged over, evenly from one blade to the next; 1 is the instant at which the
        plane lies a quarter of the way from one blade to the next.

    Returns
    -------
    u, v, w : (nz, nx) arrays
        Along x, through the plane, and along z (m/s); climb included.
    """
    grid = np.stack(np.meshgrid(x_m, [0.0], z_m, indexing="ij"), axis=-1)[:, 0].transpose(1, 0, 2)
    blades = np.array([w.surface.blades for w in solution.wakes], dtype=np.float64)
    total = np.zeros_like(grid)
    for k in range(phases):
        part = 0.25 if phases == 1 else (k + 0.5) / phases
        total += induced_velocity(solution, grid, 2.0 * math.pi * part / blades)
    total /= phases
    total[..., 2] -= solution.climb_m_s
    return total[..., 0], total[..., 1], total[..., 2]


def field_picture(solution: WakeSolution, *, mean: bool = True, points: int = 80, phases: int = 12) -> Figure:
    """Draw the air in a vertical plane through the shaft.

    With ``mean``, speed and streamlines averaged over the azimuth; without, an instant: vorticity through the plane,
    which shows the vortices where they pass it, and velocity arrows (as Figs. 3.6 and 3.19 of the dissertation).

    Raises
    ------
    InputError
        If fewer than ten points across are asked for.
    """
    from matplotlib.ticker import MaxNLocator

    if points < 10:
        raise InputError("picture", "points", f"{points} is too few", "give 10 or more")
    radius = max(w.surface.radius_m for w in solution.wakes)
    heights = [w.placed.height_m for w in solution.wakes]
    top, bottom = max(heights) + 1.0 * radius, min(heights) - 2.5 * radius
    x = np.linspace(-1.6 * radius, 1.6 * radius, points)
    z = np.linspace(bottom, top, max(10, round(points * (top - bottom) / (3.2 * radius))))
    u, _, w = plane_velocity(solution, x, z, phases=phases if mean else 1)
    figure = _figure(7.0, 6.6)
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
        label, title = (
            "Vorticity through the plane (1/s)",
            "an instant, blades a quarter period from the plane",
        )
    for wake in solution.wakes:
        s, h = wake.surface, 1e3 * wake.placed.height_m
        for sign in (-1.0, 1.0):
            axes.plot(sign * 1e3 * s.edge_quarter_m[[0, -1], 0], [h, h], color="k", linewidth=2.5)
    axes.set(xlabel="x (mm)", ylabel="z along the shaft (mm)", xlim=mx[[0, -1]], ylim=mz[[0, -1]])
    axes.set_aspect("equal")
    axes.set_title(
        f"Air around the {'pair' if len(solution.wakes) == 2 else 'rotor'}, {title}", fontsize="medium"
    )
    figure.colorbar(drawn, ax=axes, shrink=0.7).set_label(label)
    return figure


def rotor_loads_picture(
    upper: RotorResult, lower: RotorResult, alone: tuple[RotorResult, RotorResult] | None = None
) -> Figure:
    """Draw inflow, angle of attack, lift, thrust and torque along the blades of both rotors, isolated rotors dashed."""
    figure = _figure(10.0, 6.0)
    panels: tuple[tuple[str, Callable[[RotorResult], Array]], ...] = (
        ("Induced velocity down the shaft (m/s)", lambda r: r.inflow_m_s),
        ("Swirl (m/s)", lambda r: r.swirl_m_s),
        ("Angle of attack (deg)", lambda r: np.degrees(r.alpha_rad)),
        ("Lift coefficient", lambda r: r.cl),
        ("Thrust per radius (N/m)", lambda r: r.dT_N / r.dr_m),
        ("Torque per radius (N m/m)", lambda r: r.dQ_Nm / r.dr_m),
    )
    grid = figure.subplots(2, 3, sharex=True)
    for axes, (label, of) in zip(grid.flat, panels, strict=True):
        for k, r in enumerate((upper, lower)):
            axes.plot(1e3 * r.r_m, of(r), color=_COLOURS[k], label=_SIDES[k])
            if alone is not None and not (k == 1 and alone[1] is alone[0]):
                note = "alone" if alone[1] is alone[0] else f"{_SIDES[k]} alone"
                colour = "0.4" if alone[1] is alone[0] else _COLOURS[k]
                axes.plot(1e3 * alone[k].r_m, of(alone[k]), "--", color=colour, linewidth=1.0, label=note)
        axes.set_ylabel(label)
        axes.grid(alpha=0.3)
    for axes in grid[1]:
        axes.set_xlabel("Radius (mm)")
    grid[0, 0].legend(fontsize="small")
    figure.suptitle(
        "; ".join(
            f"{side} {r.speed_rad_s * 30 / math.pi:.0f} rpm, {math.degrees(r.pitch_rad):.2f} deg: {r.thrust_N:.4g} N, "
            f"{r.torque_Nm:.4g} N m"
            for side, r in zip(_SIDES, (upper, lower), strict=True)
        ),
        fontsize="medium",
    )
    return figure


def history_picture(history: Array, *, residual: float | None = None, note: str = "") -> Figure:
    """Draw how a wake converged.

    Parameters
    ----------
    history : (iterations, 1 + 2 rotors) array
        As in ``WakeSolution.history``.
    residual : float, optional
        Where it counts as settled, drawn as a line.
    note : str
        Title.
    """
    figure = _figure(7.0, 6.0)
    first, second, third = figure.subplots(3, 1, sharex=True)
    turn = np.arange(1, len(history) + 1)
    miss = history[:, 0]
    # While a free wake is still held in the prescribed shape its residual stands above any that the air can give.
    first.semilogy(turn, 100.0 * np.where(miss < 9.0, np.maximum(miss, 1e-12), np.nan))
    if residual is not None:
        first.axhline(100.0 * residual, color="0.5", linestyle=":", label="wanted")
        first.legend(fontsize="small")
    first.set_ylabel("Wake misses the air by\n(% of its velocity)")
    n = (history.shape[1] - 1) // 2
    for k in range(n):
        second.plot(turn, history[:, 1 + 2 * k], color=_COLOURS[k], label=_names(n)[k])
        third.plot(turn, 1e3 * history[:, 2 + 2 * k], color=_COLOURS[k], label=_names(n)[k])
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
