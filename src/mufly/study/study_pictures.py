"""Pictures of studies: curves over one parameter, bars of a ranking, gear ratio curves."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import xarray as xr

from mufly.errors import InputError
from mufly.results.result_figure import blank_figure, label_axes
from mufly.study.study_parameters import ROTOR_PARAMETERS, to_display_unit

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


_MAX_SWEEP_LINES = 12


def axis_label(attributes: dict[str, str], unit: str | None = None) -> str:
    """Return "Meaning (unit)" from a variable's attributes."""
    text = attributes.get("long_name", "")
    name = unit if unit is not None else attributes.get("units", "")
    text = text[:1].upper() + text[1:]
    return text if name in ("", "1", "text") else f"{text} ({name})"


def draw_parameter_sweep(data: xr.Dataset, y: str, *, x: str | None = None, title: str = "") -> Figure:
    """Draw one variable of a sweep over one parameter, with a line for every combination of the others.

    Parameters
    ----------
    data : Dataset
        From :func:`mufly.study.sweep_parameters`.
    y : str
        Name of the variable.
    x : str, optional
        Dimension on the horizontal axis. Default: pitch, or the first numerical dimension.
    title : str

    Raises
    ------
    InputError
        If there is no such variable or dimension, or more than twelve lines would be drawn.
    """
    names = [str(d) for d in data.dims]
    numbers = [n for n in names if data[n].dtype.kind in "fiu"]
    along = x or ("pitch" if "pitch" in names else numbers[0] if numbers else None)
    if y not in data or along not in names:
        raise InputError("picture", y, f"cannot be drawn over {along}", f"vary one of {', '.join(ROTOR_PARAMETERS)}")
    others = [n for n in names if n != along]
    count = int(np.prod([data.sizes[n] for n in others], dtype=int))
    if count > _MAX_SWEEP_LINES:
        raise InputError("picture", y, f"{count} lines", f"draw a part of the data ({_MAX_SWEEP_LINES} lines at most)")
    figure = blank_figure(7.0, 4.6)
    axes = figure.subplots()
    horizontal, unit = to_display_unit(along, data[along].values.tolist())
    for index in np.ndindex(*(data.sizes[n] for n in others)):
        one = data[y].isel(dict(zip(others, index, strict=True)))
        label = ", ".join(_format_value(n, data[n].values[i]) for n, i in zip(others, index, strict=True))
        axes.plot(horizontal, one.values, marker="o", markersize=3, label=label)
    label_axes(axes, axis_label(data[along].attrs, unit), axis_label(data[y].attrs))
    if others:
        axes.legend(title=", ".join(others), fontsize="small")
    if title:
        axes.set_title(title, fontsize="medium")
    return figure


def _format_value(name: str, value: object) -> str:
    shown, unit = to_display_unit(name, [value.item() if isinstance(value, np.generic) else value])  # type: ignore[list-item]
    return f"{shown[0]:g} {unit}".strip() if shown.dtype.kind == "f" else str(shown[0])


def draw_ranking_extremes(ranking: xr.Dataset) -> Figure:
    """Draw the best 20 and the worst 20 of a ranking as bars.

    Parameters
    ----------
    ranking : Dataset
        From :func:`mufly.study.rank_airfoils`.
    """
    key, ends = ranking.attrs["by"], 20
    good = ranking.isel(airfoil=np.flatnonzero(np.isfinite(ranking[key].values)))
    n = good.sizes["airfoil"]
    shown = np.arange(n) if n <= 2 * ends else np.r_[0:ends, n - ends : n]
    figure = blank_figure(7.0, 1.2 + 0.2 * len(shown))
    axes: Axes = figure.subplots()
    place = np.arange(len(shown)) + (np.arange(len(shown)) >= ends if n > 2 * ends else 0)
    axes.barh(place, good[key].values[shown], color=["C0" if k < n / 2 else "C3" for k in shown])
    names = [f"{good['rank'].values[k]}  {good['airfoil'].values[k]}" for k in shown]
    axes.set_yticks(place, names, fontsize="x-small")
    axes.invert_yaxis()
    axes.set_xlabel(axis_label(good[key].attrs))
    axes.grid(axis="x", alpha=0.3)
    return figure


def draw_gear_curve(
    curve: xr.Dataset, *, marks: dict[str, float] | None = None, thrust_N: float | None = None, title: str = ""
) -> Figure:  # fmt: skip
    """Draw gear ratio curves in two panels as in Fig. 3.7: powers; and thrust, efficiency and thrust per power.

    Parameters
    ----------
    curve : Dataset
        From :func:`mufly.drive.sweep_gear_ratio`.
    marks : dict, optional
        Gear ratios to mark, by label.
    thrust_N : float, optional
        Required thrust, drawn as a line.
    """
    figure = blank_figure(10.0, 4.6)
    left, right = figure.subplots(1, 2)
    ratio = curve.gear_ratio.values
    for name in ("input_power_W", "mechanical_power_W"):
        left.plot(ratio, curve[name].values, label=curve[name].attrs["long_name"])
    left.set_ylabel("Power (W)")
    right.plot(ratio, curve.thrust_N.values, label="thrust (N)")
    right.plot(ratio, curve.efficiency.values, label="efficiency")
    right.plot(ratio, 10 * curve.thrust_per_power_N_W.values, label="thrust per power (N per 10 W)")
    if thrust_N is not None:
        right.axhline(thrust_N, color="0.5", linestyle=":", label=f"wanted thrust, {thrust_N:g} N")
    for k, (label, place) in enumerate((marks or {}).items()):
        for axes in (left, right):
            axes.axvline(
                place,
                color=f"C{4 + k}",
                linestyle="--",
                linewidth=0.8,
                label=label if axes is right else None,
            )
    right.set_ylabel("Thrust (N), efficiency, thrust per power (N per 10 W)")
    for axes in (left, right):
        axes.set_xlabel("Gear ratio")
        axes.set_ylim(bottom=0)
        axes.grid(alpha=0.3)
        axes.legend(fontsize="small")
    if title:
        figure.suptitle(title, fontsize="medium")
    return figure
