"""Default picture of a result: arrays as lines, scalars as bars, a panel for each unit.

The horizontal axis is the first monotonic array of each length, or an array with the name of an axis (time, frequency,
radius).
"""

from __future__ import annotations

import io
import math
import sys
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Array = NDArray[np.float64]

_PREFERRED_AXIS_LABELS = (
    "time",
    "frequency",
    "r",
    "x",
    "duty",
    "iteration",
    "distance",
    "lag",
)  # labels, in order of preference
_MAX_FIGURE_PANELS = 9
_MAX_LINES_PER_PANEL = 8
_MAX_BAR_VALUES = 6  # arrays up to this length are drawn as bars, one per value


class PlotVariable(NamedTuple):
    """Series to draw: label, unit, values, and whether it is a scalar."""

    label: str
    unit: str
    values: Array
    is_scalar: bool = False

    @property
    def axis_title(self) -> str:
        """Return label and unit as the title of an axis."""
        return f"{self.label} ({self.unit})" if self.unit else self.label


def blank_figure(width: float, height: float, *, dpi: float | None = None) -> Figure:
    """Return an empty matplotlib figure of a width and height in inches."""
    from matplotlib.figure import Figure

    return Figure(figsize=(width, height), dpi=dpi, layout="constrained")


def label_axes(axes: Axes, x: str | None = None, y: str | None = None) -> None:
    """Label axes, and draw a light grid."""
    if x is not None:
        axes.set_xlabel(x)
    if y is not None:
        axes.set_ylabel(y)
    axes.grid(alpha=0.3)


_LinePanel = tuple[PlotVariable | None, list[PlotVariable]]  # horizontal axis, and series drawn over it


def make_plot_variable(label: str, unit: str, value: Any) -> PlotVariable | None:
    """Return a number or one-dimensional array as a series; None for other values, and if no number is finite."""
    if isinstance(value, bool | np.bool_ | str | bytes | complex) or value is None:
        return None
    try:
        numbers = np.asarray(value)
    except ValueError:  # lists of lists of unequal lengths
        return None
    if numbers.dtype.kind not in "fiu" or numbers.ndim > 1 or not np.isfinite(numbers).any():
        return None
    return PlotVariable(label, unit, np.atleast_1d(numbers).astype(np.float64), is_scalar=numbers.ndim == 0)


def draw_series(title: str, found: Sequence[PlotVariable], table: Sequence[tuple[str, str]] = ()) -> Figure:
    """Draw arrays as lines and short series as bars, in one panel for each unit.

    Parameters
    ----------
    title : str
    found : sequence of Quantity
    table : sequence of (str, str)
        Names and values as text, drawn if there are no numbers.
    """

    curves: list[_LinePanel | list[PlotVariable]] = list(
        _line_panels([q for q in found if q.values.size > _MAX_BAR_VALUES])
    )
    bars: dict[str, list[PlotVariable]] = {}
    for q in found:
        if q.values.size <= _MAX_BAR_VALUES:
            bars.setdefault(q.unit, []).append(q)
    panels = (curves + list(bars.values()))[:_MAX_FIGURE_PANELS]
    if not panels:
        return _draw_text_table(title, table)
    wide = min(len(panels), 3)
    high = math.ceil(len(panels) / wide)
    figure = blank_figure(4.2 * max(wide, 1.6), 3.0 * high + 0.4)
    grid = figure.subplots(high, wide, squeeze=False)
    for axes, panel in zip(grid.flat, panels, strict=False):
        if isinstance(panel, tuple):
            _draw_lines(axes, *panel)
        else:
            _draw_bars(axes, panel)
    for axes in grid.flat[len(panels) :]:
        axes.set_axis_off()
    figure.suptitle(title, fontsize="medium")
    return figure


def _line_panels(arrays: Sequence[PlotVariable]) -> list[_LinePanel]:
    """Return the panels of a figure: for each, the series of the horizontal axis (None: index) and those of the lines.

    Series of equal length share an axis, those of equal unit a panel.
    """
    out: list[_LinePanel] = []
    for length in dict.fromkeys(q.values.size for q in arrays):
        group = [q for q in arrays if q.values.size == length]
        axis = _choose_horizontal_axis(group)
        by_unit: dict[str, list[PlotVariable]] = {}
        for q in group:
            if q is not axis:
                by_unit.setdefault(q.unit or q.label, []).append(q)
        out += [(axis, some[:_MAX_LINES_PER_PANEL]) for some in by_unit.values()]
    return out


def _choose_horizontal_axis(group: Sequence[PlotVariable]) -> PlotVariable | None:
    """Return the series that serves as horizontal axis of a group; None if none is monotonic."""
    rising = [
        q
        for q in group
        if np.isfinite(q.values).all() and (np.all(np.diff(q.values) > 0) or np.all(np.diff(q.values) < 0))
    ]
    for name in _PREFERRED_AXIS_LABELS:
        for q in rising:
            if name in (q.label, q.label.split()[0]):
                return q
    return rising[0] if rising and len(group) > 1 else None


def _draw_lines(axes: Axes, over: PlotVariable | None, drawn: Sequence[PlotVariable]) -> None:
    x = np.arange(drawn[0].values.size) if over is None else over.values
    for q in drawn:
        axes.plot(x, q.values, label=q.label, lw=1.2)
    if over is not None and np.all(x > 0) and x.max() > 50.0 * x.min() and over.label.startswith("frequency"):
        axes.set_xscale("log")
    y = np.concatenate([q.values for q in drawn])
    y = y[np.isfinite(y)]
    if y.size and y.min() > 0 and y.max() > 1e3 * y.min():
        axes.set_yscale("log")
    axes.set_xlabel("number" if over is None else over.axis_title)
    if len(drawn) == 1:
        axes.set_ylabel(drawn[0].axis_title)
    else:
        axes.set_ylabel(drawn[0].unit)
        axes.legend(fontsize="small")
    axes.grid(alpha=0.3)


def _draw_bars(axes: Axes, drawn: Sequence[PlotVariable]) -> None:
    """Draw numbers of one unit as bars with their values beside them, the first on top."""
    names, values = [], []
    for q in drawn:
        for k, value in enumerate(q.values):
            names.append(q.label if q.is_scalar else f"{q.label} {k + 1}")
            values.append(value)
    place = np.arange(len(values))[::-1]
    shown = np.nan_to_num(np.array(values), nan=0.0, posinf=0.0, neginf=0.0)
    axes.barh(place, shown, height=0.6)
    for y, value, length in zip(place, values, shown, strict=True):
        axes.annotate(f" {value:.4g}", (max(float(length), 0.0), float(y)), va="center", fontsize="small")
    axes.set_yticks(place, names, fontsize="small")
    axes.set_xlabel(drawn[0].unit or "1")
    axes.margins(x=0.25)
    axes.set_ylim(len(values) - 0.4 - max(len(values), 3), len(values) - 0.4)  # limits the width of a single bar
    axes.axvline(0.0, color="0.4", lw=0.8)


def _draw_text_table(title: str, table: Sequence[tuple[str, str]]) -> Figure:
    """Draw a table, for a result that contains texts only."""
    figure = blank_figure(7.0, 0.6 + 0.3 * max(len(table), 1))
    axes = figure.subplots()
    axes.set_axis_off()
    axes.set_title(title, fontsize="medium")
    if table:
        axes.table([list(row) for row in table], loc="center", cellLoc="left")
    return figure


def enable_notebook_display(figure: Figure) -> Figure:
    """Return a figure that notebooks display with any backend and without pyplot."""
    if "IPython" in sys.modules:
        figure.__dict__["_repr_png_"] = lambda: _render_png(figure)
    return figure


def _render_png(figure: Figure) -> bytes:
    out = io.BytesIO()
    figure.savefig(out, format="png", dpi=100)
    return out.getvalue()
