"""Drawings of the dissertation's figures from computed results: same axes, one panel for each model."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np
import xarray as xr

from mufly.quantities.units import RPM
from mufly.results.result_figure import blank_figure, label_axes
from mufly.rotor import load_airfoil
from mufly.thesis.claims import TABLE_3_4_VALUES

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

PANEL_TITLES = {"full": "all corrections", "thesis": "theory as in the dissertation"}


def draw_pitch_sweep(data: Mapping[str, xr.Dataset], title: str) -> Figure:
    """Draw thrust per electrical power over the pitch: a line for each value of the parameter, a panel for each
    model."""
    figure = blank_figure(10.0, 4.4)
    panels = figure.subplots(1, len(data), sharey=True, squeeze=False)[0]
    for axes, (model, one) in zip(panels, data.items(), strict=True):
        pitch = np.degrees(one.pitch.values)
        for label, line in zip(one.label.values, one.thrust_per_power_N_W.values, strict=True):
            axes.plot(pitch, line, marker="o", markersize=3, label=str(label))
        axes.set_xlim(6, 20)
        axes.set_xlabel("Pitch angle (deg)")
        axes.set_title(PANEL_TITLES[model], fontsize="medium")
        axes.grid(alpha=0.3)
    panels[0].set_ylabel("Thrust / electrical power (N/W)")
    panels[0].legend(fontsize="small")
    figure.suptitle(title)
    return figure


def draw_gear_ratio(data: xr.Dataset, title: str) -> Figure:
    """Draw powers, thrust, efficiency and thrust per power over gear ratio: a row per voltage, lower rotor dashed."""
    figure = blank_figure(11.0, 4.2 * data.sizes["voltage"])
    rows = figure.subplots(data.sizes["voltage"], 2, squeeze=False)
    for (left, right), volt in zip(rows, data.voltage.values, strict=True):
        for which, style in (("upper", "-"), ("lower", "--")):
            one = data.sel(rotor=which, voltage=volt)
            x = one.gear_ratio.values
            left.plot(x, one.input_power_W, "C0", linestyle=style, label=f"electrical, {which}")
            left.plot(x, one.mechanical_power_W, "C1", linestyle=style, label=f"mechanical, {which}")
            right.plot(x, one.thrust_N, "C2", linestyle=style, label=f"thrust (N), {which}")
            right.plot(x, one.efficiency, "C3", linestyle=style, label=f"efficiency, {which}")
            right.plot(x, 10 * one.thrust_per_power_N_W, "C4", linestyle=style, label=f"thrust per 10 W (N), {which}")
        right.axhline(0.6, color="0.5", linewidth=0.8, linestyle=":", label="0.6 N")
        left.set_ylabel("Power (W)")
        right.set_ylabel("Thrust (N), efficiency, thrust per 10 W (N)")
        for axes in (left, right):
            axes.set_xlabel("Gear ratio")
            axes.set_title(f"{volt:g} V", fontsize="medium")
            axes.set_xlim(0.5, 8)
            axes.set_ylim(bottom=0)
            axes.grid(alpha=0.3)
        left.legend(fontsize="small")
        right.legend(fontsize="small", ncols=2, loc="upper right")
        right.set_ylim(0, 1.3)
    figure.suptitle(title)
    return figure


def draw_coefficients_over_speed(data: Mapping[str, xr.Dataset], title: str) -> Figure:
    """Draw torque and thrust coefficient over the speed, a row for each model."""
    figure = blank_figure(10.0, 3.6 * len(data))
    rows = figure.subplots(len(data), 2, squeeze=False)
    for panels, (model, one) in zip(rows, data.items(), strict=True):
        rpm = one.speed.values / RPM
        for axes, name, label in zip(panels, ("c_Q", "c_T"), ("Torque coefficient", "Thrust coefficient"), strict=True):
            for k, pitch in enumerate(np.degrees(one.pitch.values)):
                axes.plot(rpm, one[name].values[k], label=f"{pitch:.0f} deg")
            axes.set_xlabel("Speed (rpm)")
            axes.set_ylabel(label)
            axes.set_ylim(bottom=0)
            axes.set_title(PANEL_TITLES[model], fontsize="medium")
            axes.grid(alpha=0.3)
        panels[0].legend(fontsize="small", title="pitch")
    figure.suptitle(title)
    return figure


def draw_airfoil_ranking(data: Mapping[str, xr.Dataset], named: Mapping[str, str], title: str) -> Figure:
    """Draw thrust per electrical power of all airfoils in order, the named ones marked."""
    figure = blank_figure(11.0, 4.8)
    panels = figure.subplots(1, len(data), sharey=True, squeeze=False)[0]
    for axes, (model, one) in zip(panels, data.items(), strict=True):
        axes.plot(one["rank"].values, one.thrust_per_power_N_W.values, ".", color="0.6", markersize=3)
        for k, (name, ours) in enumerate(named.items()):
            row = one.sel(airfoil=ours)
            axes.plot(int(row["rank"]), float(row.thrust_per_power_N_W), "o", color=f"C{k}", label=name)
        axes.set_xlabel("Rank of 247")
        axes.set_title(PANEL_TITLES[model], fontsize="medium")
        axes.grid(alpha=0.3)
    panels[0].set_ylabel("Thrust / electrical power at the best pitch (N/W)")
    panels[0].legend(fontsize="small", loc="lower left")
    figure.suptitle(title)
    return figure


def draw_airfoil_contours(names: Sequence[str], title: str) -> Figure:
    """Draw the contours of four airfoils.

    Thesis: Figs 3.29, 3.33, 3.34.
    """
    figure = blank_figure(9.0, 4.0)
    for axes, name in zip(figure.subplots(2, 2).flat, names, strict=True):
        section = load_airfoil(name)
        axes.plot(*section.coordinates.T)
        axes.set_aspect("equal")
        axes.set_title(f"{name}: {section.thickness_ratio:.1%} thick, {section.camber:.1%} camber", fontsize="small")
        axes.set_xlabel("x / c")
        axes.set_ylabel("y / c")
    figure.suptitle(title)
    return figure


# ----------------------------------------------------------------------------
# Figs 3.43 to 3.45 and Table 3.4 from computed results; statements of the source are drawn in grey.


METHOD_LABELS = {"wake": "wake method", "full": "blade elements"}
METHOD_LINE_STYLES = {"wake": "-", "full": "--"}
ROTOR_COLOURS = {"upper": "C0", "lower": "C1", "single": "C2"}


def _new_coaxial_figure(rows: int, columns: int, title: str) -> tuple[Figure, list[list[Axes]]]:
    figure = blank_figure(5.2 * columns, 3.7 * rows + 0.4)
    figure.suptitle(title)
    return figure, [list(row) for row in figure.subplots(rows, columns, squeeze=False)]


def draw_equal_speeds(data: Mapping[str, xr.Dataset], title: str) -> Figure:
    """Draw thrust and torque of both rotors and of an isolated one, and the lower rotor's coefficients, over the
    speed."""
    figure, rows = _new_coaxial_figure(2, 2, title)
    quantities = (("thrust_N", "Thrust (N)", 1.0, 0.55), ("torque_Nm", "Torque (mN m)", 1e3, 0.80))
    for axes, (field, label, scale, share) in zip(rows[0], quantities, strict=True):
        for model, one in data.items():
            for who, colour in ROTOR_COLOURS.items():
                axes.plot(one.rpm, scale * one[f"{who}_{field}"], METHOD_LINE_STYLES[model], color=colour, marker=".",
                          label=f"{who}, {METHOD_LABELS[model]}")  # fmt: skip
        first = next(iter(data.values()))
        axes.plot(first.rpm, share * scale * first[f"upper_{field}"], ":", color="0.4", linewidth=2,
                  label=f"source: lower = {share:g} upper")  # fmt: skip
        axes.set_ylim(bottom=0)
        axes.legend(fontsize="x-small")
        label_axes(axes, "Speed of both rotors (rev/min)", label)
    for axes, field, label, top in zip(
        rows[1], ("c_T", "c_Q"), ("Lower rotor's c_T", "Lower rotor's c_Q"), (0.012, 0.003), strict=True
    ):
        for model, one in data.items():
            axes.plot(
                one.rpm,
                one[f"lower_{field}"],
                METHOD_LINE_STYLES[model],
                color="C1",
                marker=".",
                label=METHOD_LABELS[model],
            )
        axes.set_ylim(0, top)
        axes.legend(fontsize="small")
        label_axes(axes, "Speed of both rotors (rev/min)", label)
    return figure


def draw_one_speed_fixed(data: Mapping[str, xr.Dataset], title: str) -> Figure:
    """Draw the lower rotor's coefficients over the speed of one rotor, with the other's speed fixed."""
    figure, rows = _new_coaxial_figure(2, 2, title)
    for row, varied in zip(rows, ("upper", "lower"), strict=True):
        for axes, field, (low, top) in zip(row, ("c_T", "c_Q"), ((-0.002, 0.012), (0.0, 0.003)), strict=True):
            for model, one in data.items():
                axes.plot(
                    one.rpm,
                    one[f"lower_{field}"].sel(varied=varied),
                    METHOD_LINE_STYLES[model],
                    color="C1",
                    marker=".",
                    label=METHOD_LABELS[model],
                )
            axes.axhline(0, color="0.5", linewidth=0.8)
            axes.set_ylim(low, top)
            kept = "lower" if varied == "upper" else "upper"
            axes.set_title(f"{kept} rotor at 6000 rev/min", fontsize="medium")
            label_axes(axes, f"Speed of the {varied} rotor (rev/min)", f"Lower rotor's {field}")
    rows[0][0].legend(fontsize="small")
    return figure


def draw_equal_torques(data: Mapping[str, xr.Dataset], title: str) -> Figure:
    """Draw speed, thrust and power of the lower rotor at equal torques over its pitch, beside Table 3.4."""
    figure, (row,) = _new_coaxial_figure(1, 3, title)
    pitch = np.array(list(TABLE_3_4_VALUES))
    theirs = np.array(list(TABLE_3_4_VALUES.values()))
    quantities = (
        ("rpm", "Lower speed (rev/min)"),
        ("thrust_N", "Lower thrust (N)"),
        ("power_W", "Lower power (W)"),
    )
    for k, (axes, (field, label)) in enumerate(zip(row, quantities, strict=True)):
        axes.plot(pitch, theirs[:, k], "s", color="0.4", label="Table 3.4")
        for model, one in data.items():
            axes.plot(one.lower_pitch_deg, one[f"lower_{field}"], METHOD_LINE_STYLES[model], color="C1", marker=".",
                      label=METHOD_LABELS[model])  # fmt: skip
        axes.set_ylim(0, 1.08 * max(theirs[:, k].max(), axes.dataLim.y1))
        label_axes(axes, "Pitch of the lower rotor (deg)", label)
    row[0].legend(fontsize="small")
    return figure


def draw_rotor_spacing(data: Mapping[str, xr.Dataset], title: str) -> Figure:
    """Draw thrust and torque of the lower rotor over the speed: a line for each spacing, a row for each model."""
    figure, rows = _new_coaxial_figure(len(data), 2, title)
    for row, (model, one) in zip(rows, data.items(), strict=True):
        for axes, field, label, scale in zip(
            row,
            ("thrust_N", "torque_Nm"),
            ("Lower thrust (N)", "Lower torque (mN m)"),
            (1.0, 1e3),
            strict=True,
        ):
            for spacing in one.spacing_mm.values:
                axes.plot(one.rpm, scale * one[f"lower_{field}"].sel(spacing_mm=spacing), marker=".",
                          label=f"{spacing:.0f} mm")  # fmt: skip
            axes.set_title(METHOD_LABELS[model], fontsize="medium")
            label_axes(axes, "Speed of both rotors (rev/min)", label)
        row[0].legend(fontsize="small")
    return figure
