"""Pictures of a rotor: what the blade looks like, and what happens along it."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from mufly.errors import MuflyError
from mufly.rotor import Rotor, RotorResult, load_airfoil

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["blade_picture", "stations_picture"]


def _figure(width: float, height: float) -> Figure:
    from matplotlib.figure import Figure

    return Figure(figsize=(width, height), layout="constrained")


def blade_picture(rotor: Rotor) -> Figure:
    """Draw planform (quarter chord line straight), twist and sections of a blade, lengths in millimetres."""
    x = np.linspace(float(rotor.hub_cutout), 1.0, 101)
    r, chord = 1e3 * rotor.radius_m * x, 1e3 * rotor.chord_m(x)
    figure = _figure(8.0, 6.0)
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
    twist.set_xlabel("Radius (mm)")
    twist.set_ylabel("Twist (deg)")
    twist.grid(alpha=0.3)
    for k, name in enumerate(rotor.airfoil_names()):
        try:
            contour = load_airfoil(name).coordinates
        except MuflyError:  # a table of coefficients has no contour
            continue
        section.plot(*contour.T, color=f"C{k}", label=name)
    section.set_aspect("equal")
    section.set_xlabel("x / c")
    section.set_ylabel("y / c")
    section.legend(fontsize="small")
    return figure


def stations_picture(result: RotorResult) -> Figure:
    """Draw angle of attack, inflow, lift coefficient and Reynolds number along the blade, and thrust per radius."""
    r = 1e3 * result.r_m
    panels = (
        ("Angle of attack (deg)", np.degrees(result.alpha_rad)),
        ("Inflow (m/s)", result.inflow_m_s),
        ("Lift coefficient", result.cl),
        ("Drag coefficient", result.cd),
        ("Reynolds number", result.reynolds),
        ("Thrust per radius (N/m)", result.dT_N / result.dr_m),
    )
    figure = _figure(9.0, 6.0)
    grid = figure.subplots(2, 3, sharex=True)
    beyond = result.outside > 0
    for axes, (label, values) in zip(grid.flat, panels, strict=True):
        axes.plot(r, values)
        if beyond.any():
            axes.plot(r[beyond], values[beyond], "x", color="C3", label="beyond the polar")
        axes.set_ylabel(label)
        axes.grid(alpha=0.3)
    for axes in grid[1]:
        axes.set_xlabel("Radius (mm)")
    if beyond.any():
        grid[0, 0].legend(fontsize="small")
    figure.suptitle(
        f"pitch {math.degrees(result.pitch_rad):.2f} deg, {result.speed_rad_s * 30 / math.pi:.0f} rpm: "
        f"thrust {result.thrust_N:.4g} N, torque {result.torque_Nm:.4g} N m",
        fontsize="medium",
    )
    return figure
