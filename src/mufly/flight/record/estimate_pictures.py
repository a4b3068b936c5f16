"""Pictures of a flight's estimates: comparison with the truth, uncertainty bounds, and use of the sensors.

``estimate``: true, measured and estimated values on the left, and the estimate's error with its band of three standard
deviations on the right. ``sensors``: normalised innovations of every reading, coloured by fusion status. ``way``: the
ground track with ellipses of three standard deviations, and the biases of the inertial unit."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
import xarray as xr
from matplotlib.figure import Figure
from matplotlib.patches import Ellipse, Patch
from numpy.typing import NDArray

from mufly.flight.estimator_health import find_sensor_name
from mufly.flight.record.flight_pictures import (
    BLACK,
    BLUE,
    FAST_PNG_OPTIONS,
    GREEN,
    GREY,
    ORANGE,
    PLOT_STYLE,
    SKY_BLUE,
    VERMILION,
    draw_time_spans,
    find_overlapping_state_runs,
    flight_title,
    state_legend_handles,
    state_tint,
)
from mufly.flight.record.flight_summary import find_state_runs
from mufly.quantities.quantity_table import FUSION_STATUSES, READINGS_WITH_FUSION_STATUS

_Array = NDArray[np.float64]
_ERROR_BAND_SIGMAS = 3.0
_DRAWN_INNOVATION_SIGMAS = 6.0  # larger innovations are drawn at the edge
CHECK_STATUS_COLOURS = dict(zip(FUSION_STATUSES, ("#d9d9d9", GREEN, ORANGE, GREY, VERMILION), strict=True))
"""Colour of each fusion status."""

# quantity, component, heading, factor, what measures it: (quantity, component)
_ESTIMATE_PANELS: tuple[tuple[str, int, str, float, tuple[str, int] | None], ...] = (
    ("position", 0, "North (m)", 1.0, ("position_fix", 0)),
    ("position", 1, "East (m)", 1.0, ("position_fix", 1)),
    ("position", 2, "Height (m)", -1.0, ("position_fix", 2)),
    ("velocity", 0, "Velocity north (m/s)", 1.0, None),
    ("velocity", 1, "Velocity east (m/s)", 1.0, None),
    ("velocity", 2, "Climb (m/s)", -1.0, None),
    ("attitude", 0, "Roll (deg)", 180.0 / np.pi, None),
    ("attitude", 1, "Pitch (deg)", 180.0 / np.pi, None),
    ("attitude", 2, "Heading (deg)", 180.0 / np.pi, ("position_fix", 3)),
)


def draw_estimate_pictures(dataset: xr.Dataset, folder: str | Path) -> list[Path]:
    """Draw the estimates of a flight with a filter into a folder; draw nothing for a flight without estimates.

    Returns
    -------
    list of Path
        ``estimate.png``, ``sensors.png``, ``way.png``.
    """
    if "estimated_valid" not in dataset:
        return []
    paths = [Path(folder) / f"{name}.png" for name in ("estimate", "sensors", "way")]
    with mpl.rc_context(PLOT_STYLE):
        figures = draw_estimate(dataset), draw_sensor_innovations(dataset), draw_ground_track(dataset)
        for path, figure in zip(paths, figures, strict=True):
            figure.savefig(path, dpi=110, **FAST_PNG_OPTIONS)
    return paths


def draw_estimate(dataset: xr.Dataset) -> Figure:
    """Draw truth, measurement and estimate over time, and the estimate's error in its three-sigma band.

    Parameters
    ----------
    dataset : xarray.Dataset
        Recording of a flight with sensors, or one with other estimates
        (:func:`mufly.flight.record.sensor_recording.replace_estimates`). Without truth the errors are omitted, and
        the band is drawn around the estimate.
    """
    figure = Figure(figsize=(12.0, 14.5))
    panels: Any = figure.subplots(len(_ESTIMATE_PANELS), 2, sharex=True)
    figure.subplots_adjust(left=0.065, right=0.985, top=0.945, bottom=0.035, hspace=0.34, wspace=0.13)
    time, good = dataset["time"].values, _find_valid_rows(dataset)
    states = [(time[a], time[b], state_tint(state)) for state, a, b in find_overlapping_state_runs(dataset)]
    for (name, k, heading, factor, measured), (left, right) in zip(_ESTIMATE_PANELS, panels, strict=True):
        estimate = factor * dataset[f"estimated_{name}"].values[:, k]
        sigma = abs(factor) * dataset[f"estimated_{name}_sigma"].values[:, k]
        truth = factor * dataset[f"truth_{name}"].values[:, k]
        for ax in (left, right):
            draw_time_spans(ax, states, low=0.93)  # at the top, above the bands of the estimate
        if measured is not None:
            which, part = measured
            when = dataset[f"measured_{which}_time"].values
            came = np.isfinite(when)
            said = factor * dataset[f"measured_{which}"].values[came, part]
            if name == "attitude":
                near = np.interp(when[came], time, estimate)
                said = near + (said - near + 180.0) % 360.0 - 180.0
            left.plot(when[came], said, ".", ms=2.5, color=GREY, label="measured", zorder=2)
        left.fill_between(
            time,
            estimate - _ERROR_BAND_SIGMAS * sigma,
            estimate + _ERROR_BAND_SIGMAS * sigma,
            color=SKY_BLUE,
            alpha=0.45,
            lw=0,
            zorder=1,
        )
        left.plot(time, estimate, color=BLUE, lw=1.1, label="estimated", zorder=4)
        left.plot(time, truth, color=BLACK, lw=0.9, ls=(0, (4, 2)), label="true", zorder=5)
        left.set_title(heading, pad=4)
        right.fill_between(
            time, -_ERROR_BAND_SIGMAS * sigma, _ERROR_BAND_SIGMAS * sigma, color=SKY_BLUE, alpha=0.45, lw=0, zorder=1
        )
        error = estimate - truth
        right.plot(time, error, color=VERMILION, lw=1.0, zorder=3)
        what, _, unit = heading.partition(" (")
        right.set_title(f"{what}: estimated minus true ({unit}", pad=4)
        wide = _ERROR_BAND_SIGMAS * sigma[good]
        _set_axis_limits(left, np.concatenate([truth, estimate]))
        _set_axis_limits(right, np.concatenate([error[good], -error[good], wide, -wide]))
        left.set_xlim(time[0], max(time[-1], time[0] + 1e-3))
    for ax in panels[-1]:
        ax.set_xlabel("Time (s)")
    panels[0][0].legend(loc="lower right", bbox_to_anchor=(1.01, 0.95), ncols=3, borderpad=0.1)
    _draw_header(figure, dataset)
    return figure


def draw_ground_track(dataset: xr.Dataset) -> Figure:
    """Draw the ground track, with three-sigma ellipses at regular times, and the biases over time.

    Parameters
    ----------
    dataset : xarray.Dataset
        See :func:`draw_estimate`. Bounds of the biases are drawn if the recording has ``estimated_gyro_bias_sigma``
        and ``estimated_accelerometer_bias_sigma``.
    """
    figure = Figure(figsize=(13.0, 7.0))
    grid = figure.add_gridspec(3, 3, width_ratios=(1.6, 1.0, 1.0))
    figure.subplots_adjust(left=0.06, right=0.985, top=0.91, bottom=0.075, hspace=0.35, wspace=0.25)
    time, good = dataset["time"].values, _find_valid_rows(dataset)
    plan: Any = figure.add_subplot(grid[:, 0])
    fix = dataset["measured_position_fix"].values
    plan.plot(fix[:, 1], fix[:, 0], ".", ms=2.5, color=GREY, label="measured", zorder=2)
    x = np.where(good[:, None], dataset["estimated_position"].values, np.nan)
    sigma = dataset["estimated_position_sigma"].values
    true = dataset["truth_position"].values
    plan.plot(x[:, 1], x[:, 0], color=BLUE, lw=1.1, label="estimated", zorder=4)
    plan.plot(true[:, 1], true[:, 0], color=BLACK, lw=0.9, ls=(0, (4, 2)), label="true", zorder=5)
    every = max(1, int(max(1.0, (time[-1] - time[0]) / 60.0) / max(float(np.median(np.diff(time))), 1e-6)))
    for k in range(0, len(time), every):
        if good[k] and np.isfinite(x[k]).all():
            wide, high = 2 * _ERROR_BAND_SIGMAS * sigma[k, 1], 2 * _ERROR_BAND_SIGMAS * sigma[k, 0]
            plan.add_patch(Ellipse((x[k, 1], x[k, 0]), wide, high, color=SKY_BLUE, alpha=0.3, lw=0, zorder=1))
    plan.set_aspect("equal", adjustable="datalim")
    plan.set_xlabel("East (m)")
    plan.set_ylabel("North (m)")
    plan.legend(loc="upper right", ncols=3)
    for j, (name, heading, factor) in enumerate(
        (
            ("gyro_bias", "Gyroscopes' bias (deg/s)", 180.0 / np.pi),
            ("accelerometer_bias", "Accelerometers' bias (m/s²)", 1.0),
        )
    ):  # fmt: skip
        block = factor * dataset[f"estimated_{name}"].values
        bounds = f"estimated_{name}_sigma"
        spread = factor * dataset[bounds].values if bounds in dataset else None
        for k, axis in enumerate("xyz"):
            ax: Any = figure.add_subplot(grid[k, 1 + j])
            if spread is not None:
                low, high = (
                    block[:, k] - _ERROR_BAND_SIGMAS * spread[:, k],
                    block[:, k] + _ERROR_BAND_SIGMAS * spread[:, k],
                )
                ax.fill_between(time, low, high, color=SKY_BLUE, alpha=0.45, lw=0)
                _set_axis_limits(ax, np.concatenate([low[good], high[good]]))
            ax.plot(time, block[:, k], color=BLUE, lw=1.1)
            ax.set_xlim(time[0], max(time[-1], time[0] + 1e-3))
            ax.set_title(f"{heading}, {axis}" if k == 0 else axis, pad=3)
            if k == 2:
                ax.set_xlabel("Time (s)")
    figure.text(0.02, 0.985, flight_title(dataset), fontsize=10, va="top")
    figure.text(0.02, 0.955, "ellipses and bands: three standard deviations", fontsize=8.5, va="top", color=GREY)
    return figure


def _find_valid_rows(dataset: xr.Dataset) -> NDArray[np.bool_]:
    """Return the rows with a valid estimate, or all rows if there are none.

    Errors before the convergence of the estimate would set the scale of a picture.
    """
    flown = dataset["estimated_valid"].values > 0.5
    return flown if flown.any() else np.ones(len(flown), dtype=bool)


def _set_axis_limits(ax: Any, values: _Array) -> None:
    good = values[np.isfinite(values)]
    if not len(good):
        return
    low, high = float(np.min(good)), float(np.max(good))
    room = 0.08 * max(high - low, 1e-6)
    ax.set_ylim(low - room, high + 1.5 * room)


def _draw_header(figure: Figure, dataset: xr.Dataset) -> None:
    handles = state_legend_handles([name for name, _, _ in find_state_runs(dataset)])
    figure.legend(handles=handles, loc="upper right", bbox_to_anchor=(0.99, 0.995), ncols=len(handles))
    figure.text(0.02, 0.99, flight_title(dataset), fontsize=10, va="top")
    figure.text(0.02, 0.974, "bands: three standard deviations", fontsize=8.5, va="top", color=GREY)


def draw_sensor_innovations(dataset: xr.Dataset) -> Figure:
    """Draw the innovations of every sensor in standard deviations, coloured by status (fused, rejected, ...)."""
    names = [name for name in READINGS_WITH_FUSION_STATUS if np.isfinite(dataset[f"status_{name}"].values).any()]
    height = 1.2 + 1.15 * max(1, len(names))
    figure = Figure(figsize=(12.0, height))
    panels: Any = np.atleast_1d(figure.subplots(max(1, len(names)), 1, sharex=True))
    figure.subplots_adjust(left=0.115, right=0.985, top=1 - 0.75 / height, bottom=0.55 / height, hspace=0.3)
    time = dataset["time"].values
    step = float(np.median(np.diff(time))) if len(time) > 1 else 0.0
    for name, ax in zip(names, panels, strict=False):
        code, ratio = dataset[f"status_{name}"].values, dataset[f"innovation_{name}"].values
        edges = [0, *(np.flatnonzero(code[1:] != code[:-1]) + 1), len(code)]
        shades = [CHECK_STATUS_COLOURS[status] for status in FUSION_STATUSES]
        draw_time_spans(
            ax,
            [(time[a], time[b - 1] + step, shades[int(code[a])]) for a, b in pairwise(edges) if np.isfinite(code[a])],
            high=0.09,
        )
        new = np.concatenate(([True], ratio[1:] != ratio[:-1])) & np.isfinite(ratio)
        for k, status in enumerate(FUSION_STATUSES):
            mine = new & (code == k)
            if mine.any() and status != "waiting":
                ax.plot(
                    time[mine],
                    np.clip(ratio[mine], -_DRAWN_INNOVATION_SIGMAS, _DRAWN_INNOVATION_SIGMAS),
                    ".",
                    ms=2.5,
                    color=CHECK_STATUS_COLOURS[status],
                )
        for line in (-_ERROR_BAND_SIGMAS, _ERROR_BAND_SIGMAS):
            ax.axhline(line, color=BLACK, lw=0.7, ls=":")
        ax.set_ylim(-1.25 * _DRAWN_INNOVATION_SIGMAS, 1.05 * _DRAWN_INNOVATION_SIGMAS)
        ax.set_yticks((-3, 0, 3))
        ax.set_ylabel(find_sensor_name(name).replace(" ", "\n", 1), rotation=0, ha="right", va="center")
        ax.set_xlim(time[0], max(time[-1], time[0] + 1e-3))
    panels[-1].set_xlabel("Time (s)")
    handles = [Patch(color=colour, label=status) for status, colour in CHECK_STATUS_COLOURS.items()]
    figure.legend(handles=handles, loc="upper right", bbox_to_anchor=(0.99, 0.995), ncols=len(handles))
    figure.text(0.02, 1 - 0.12 / height, flight_title(dataset), fontsize=10, va="top")
    figure.text(
        0.02, 1 - 0.36 / height,
        "dots: innovation in standard deviations, largest axis (6 and more at the edge); bar: fusion status",
        fontsize=8.5, va="top", color=GREY,
    )  # fmt: skip
    return figure
