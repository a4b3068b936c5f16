"""Pictures of blades as structures: Campbell diagram, deformed blade."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from mufly.quantities.units import RPM
from mufly.results import draws
from mufly.results.result_figure import blank_figure, label_axes
from mufly.rotor.structure.elastic_rotor import ElasticRotorResult
from mufly.rotor.structure.flap_modes import CampbellDiagram

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_SHOWN_HARMONIC_COUNT = 8
_PICTURE_HEIGHT_MODES = ("flap 1", "flap 2", "torsion 1")
"""Modes that set the height of the picture."""


@draws(CampbellDiagram)
def draw_campbell(found: CampbellDiagram) -> Figure:
    """Draw the frequencies over rotor speed with their bands, and the harmonics of the rotor speed."""
    figure = blank_figure(8.0, 5.0)
    axes = figure.subplots()
    rpm = found.speed_rad_s / RPM
    shown = [found.modes.index(name) for name in _PICTURE_HEIGHT_MODES]
    top = 1.15 * float(np.nanmax(found.frequency_rad_s[:, shown])) / (2.0 * math.pi)
    for k in range(1, _SHOWN_HARMONIC_COUNT + 1):
        axes.plot(rpm, k * rpm / 60.0, color="0.8", linewidth=0.8, zorder=0)
        x = min(float(rpm[-1]), 60.0 * top / k)
        axes.annotate(f"{k}/rev", (x, k * x / 60.0), fontsize="x-small", color="0.5", ha="right", va="bottom")
    for j, name in enumerate(found.modes):
        values = (found.frequency_rad_s[:, j], found.low_rad_s[:, j], found.high_rad_s[:, j])
        middle, low, high = (v / (2.0 * math.pi) for v in values)
        if np.all(np.isnan(middle)) or middle.min() > top:
            continue
        axes.plot(rpm, middle, color=f"C{j}", label=name)
        axes.fill_between(rpm, low, high, color=f"C{j}", alpha=0.15, linewidth=0.0)
    axes.set_xlim(rpm[0], rpm[-1])
    axes.set_ylim(0.0, top)
    axes.set_xlabel("Rotor speed (rpm)")
    axes.set_ylabel("Frequency (Hz)")
    axes.set_title(f"{found.rotor}: {found.assumptions}", fontsize="small", pad=14)
    axes.legend(fontsize="small", loc="upper left")
    return figure


@draws(ElasticRotorResult)
def draw_elastic_blade(found: ElasticRotorResult) -> Figure:
    """Draw elastic twist with its band, deflection, and thrust per radius of the rigid and of the elastic blade."""
    figure = blank_figure(10.0, 3.6)
    twist, bend, load = figure.subplots(1, 3)
    r = 1e3 * found.r_m
    twist.plot(r, np.degrees(found.twist_rad), color="C3")
    if np.all(np.isfinite(found.twist_high_rad)):
        twist.fill_between(r, np.degrees(found.twist_low_rad), np.degrees(found.twist_high_rad), color="C3", alpha=0.15)
    twist.set_ylabel("Elastic twist (deg)")
    bend.plot(r, 1e3 * found.deflection_m, color="C3")
    bend.set_ylabel("Deflection (mm)")
    for one, colour, name in ((found.rigid, "0.4", "rigid"), (found.elastic, "C3", "elastic")):
        load.plot(1e3 * one.r_m, one.dT_N / one.dr_m, color=colour, label=name)
    load.set_ylabel("Thrust per radius (N/m)")
    load.legend(fontsize="small")
    for axes in (twist, bend, load):
        label_axes(axes, "Radius (mm)")
    figure.suptitle(
        f"{found.rigid.speed_rad_s / RPM:.0f} rpm, pitch {math.degrees(found.rigid.pitch_rad):.2f} deg: thrust "
        f"{found.rigid.thrust_N:.4g} N rigid, {found.elastic.thrust_N:.4g} N elastic",
        fontsize="medium",
    )
    return figure
