"""Figs 3.43 to 3.45 and Table 3.4 from our numbers; what the source states is drawn in grey."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np
import xarray as xr

from mufly.thesis.claims import TABLE_3_4_VALUES

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = ["balance_figure", "distances_figure", "equal_speeds_figure", "kept_speed_figure"]

LABEL = {"wake": "wake method", "full": "blade elements"}
STYLE = {"wake": "-", "full": "--"}
COLOUR = {"upper": "C0", "lower": "C1", "single": "C2"}


def _figure(rows: int, columns: int, title: str) -> tuple[Figure, list[list[Axes]]]:
    from matplotlib.figure import Figure

    figure = Figure(figsize=(5.2 * columns, 3.7 * rows + 0.4), layout="constrained")
    figure.suptitle(title)
    return figure, [list(row) for row in figure.subplots(rows, columns, squeeze=False)]


def _finish(axes: Axes, x: str, y: str) -> None:
    axes.set_xlabel(x)
    axes.set_ylabel(y)
    axes.grid(alpha=0.3)


def equal_speeds_figure(data: Mapping[str, xr.Dataset], title: str) -> Figure:
    """Thrust and torque of both rotors and of one alone, and the lower rotor's coefficients, over the speed."""
    figure, rows = _figure(2, 2, title)
    quantities = (("thrust_N", "Thrust (N)", 1.0, 0.55), ("torque_Nm", "Torque (mN m)", 1e3, 0.80))
    for axes, (field, label, scale, share) in zip(rows[0], quantities, strict=True):
        for model, one in data.items():
            for who, colour in COLOUR.items():
                axes.plot(one.rpm, scale * one[f"{who}_{field}"], STYLE[model], color=colour, marker=".",
                          label=f"{who}, {LABEL[model]}")  # fmt: skip
        first = next(iter(data.values()))
        axes.plot(first.rpm, share * scale * first[f"upper_{field}"], ":", color="0.4", linewidth=2,
                  label=f"source: lower = {share:g} upper")  # fmt: skip
        axes.set_ylim(bottom=0)
        axes.legend(fontsize="x-small")
        _finish(axes, "Speed of both rotors (rev/min)", label)
    for axes, field, label, top in zip(
        rows[1], ("c_T", "c_Q"), ("Lower rotor's c_T", "Lower rotor's c_Q"), (0.012, 0.003), strict=True
    ):
        for model, one in data.items():
            axes.plot(
                one.rpm, one[f"lower_{field}"], STYLE[model], color="C1", marker=".", label=LABEL[model]
            )
        axes.set_ylim(0, top)
        axes.legend(fontsize="small")
        _finish(axes, "Speed of both rotors (rev/min)", label)
    return figure


def kept_speed_figure(data: Mapping[str, xr.Dataset], title: str) -> Figure:
    """The lower rotor's coefficients over the speed of the one rotor, the other's kept."""
    figure, rows = _figure(2, 2, title)
    for row, varied in zip(rows, ("upper", "lower"), strict=True):
        for axes, field, (low, top) in zip(row, ("c_T", "c_Q"), ((-0.002, 0.012), (0.0, 0.003)), strict=True):
            for model, one in data.items():
                axes.plot(one.rpm, one[f"lower_{field}"].sel(varied=varied), STYLE[model], color="C1", marker=".",
                          label=LABEL[model])  # fmt: skip
            axes.axhline(0, color="0.5", linewidth=0.8)
            axes.set_ylim(low, top)
            kept = "lower" if varied == "upper" else "upper"
            axes.set_title(f"{kept} rotor at 6000 rev/min", fontsize="medium")
            _finish(axes, f"Speed of the {varied} rotor (rev/min)", f"Lower rotor's {field}")
    rows[0][0].legend(fontsize="small")
    return figure


def balance_figure(data: Mapping[str, xr.Dataset], title: str) -> Figure:
    """Speed, thrust and power of the lower rotor at equal torques over its pitch, beside Table 3.4."""
    figure, (row,) = _figure(1, 3, title)
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
            axes.plot(one.lower_pitch_deg, one[f"lower_{field}"], STYLE[model], color="C1", marker=".",
                      label=LABEL[model])  # fmt: skip
        axes.set_ylim(bottom=0)
        _finish(axes, "Pitch of the lower rotor (deg)", label)
    row[0].legend(fontsize="small")
    return figure


def distances_figure(data: Mapping[str, xr.Dataset], title: str) -> Figure:
    """Thrust and torque of the lower rotor over the speed, a line for every spacing, a row for every model."""
    figure, rows = _figure(len(data), 2, title)
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
            axes.set_title(LABEL[model], fontsize="medium")
            _finish(axes, "Speed of both rotors (rev/min)", label)
        row[0].legend(fontsize="small")
    return figure
