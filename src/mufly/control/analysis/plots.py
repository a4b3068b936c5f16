"""Plots of the designs: singular values over frequency, as in the thesis's Figs 6.3 to 6.8.

All plots are ``Figure`` objects, independent of window systems and of pyplot's state. The colours are those of Okabe
and Ito, which are distinct for colour-blind readers.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import control
import numpy as np

from mufly.control.analysis.comparison import ControllerComparison, LoopMetrics
from mufly.control.analysis.servo_map import SAFE_DISK_MARGIN, ServoTimingMap
from mufly.control.controller_design import ControllerDesign
from mufly.control.designs import FlightController
from mufly.control.linear_systems import Array, LoopCurves, compute_loop_singular_values, sample_plant, singular_values
from mufly.control.robust.parameter_robustness import ParameterRobustness
from mufly.control.tuning.output_schedule import OutputSchedule
from mufly.control.tuning.tuned_loop import TunedLoop
from mufly.results import draws
from mufly.results.result_figure import blank_figure

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

BLUE, ORANGE, GREEN, VERMILION, GREY = "#0072B2", "#E69F00", "#009E73", "#D55E00", "#7f7f7f"
_FREQUENCY_GRID = np.geomspace(1e-4, 1e4, 700)
_THESIS_FIGURE_NUMBERS = {"heave-yaw": ("6.3", "6.5"), "roll-pitch": ("6.7", "6.8")}


def _to_decibel(values: Array) -> Array:
    return 20 * np.log10(np.maximum(values, 1e-30))


def _set_up_axes(axes: Axes, title: str, low: float, high: float) -> None:
    axes.set_xscale("log")
    axes.set_xlim(_FREQUENCY_GRID[0], _FREQUENCY_GRID[-1])
    axes.set_ylim(low, high)
    axes.axhline(0.0, color="black", linewidth=0.7)
    axes.grid(True, which="major", color="0.88", linewidth=0.6)
    axes.set_axisbelow(True)
    axes.set_ylabel("singular values (dB)")
    axes.set_title(title, loc="left", fontsize=10, fontweight="bold")
    axes.tick_params(labelsize=8)
    for side in ("top", "right"):
        axes.spines[side].set_visible(False)


def _mark_frequency(axes: Axes, frequency: float, text: str, colour: str, level: float) -> None:
    axes.axvline(frequency, color=colour, linewidth=0.9, linestyle=(0, (4, 3)))
    axes.annotate(
        text,
        (frequency, level),
        xycoords=("data", "axes fraction"),
        xytext=(4, 0),
        textcoords="offset points",
        color=colour,
        fontsize=8,
        va="center",
    )


def _plot_columns(axes: Axes, frequency: Array, values: Array, colour: str, label: str | None, **style: Any) -> None:
    for i, column in enumerate(_to_decibel(values).T):
        axes.plot(frequency, column, color=colour, label=label if i == 0 else None, **style)


def _mark_crossovers(axes: Axes, crossovers: tuple[float, ...]) -> None:
    if crossovers:
        label = "0 dB at " + ", ".join(f"{w:.3g}" for w in crossovers) + " rad/s"
        axes.plot(crossovers, np.zeros(len(crossovers)), "o", color=BLUE, markersize=5, label=label)


def _cite_thesis_figure(design: ControllerDesign, which: int) -> str:
    return (
        f"(thesis Fig. {_THESIS_FIGURE_NUMBERS[design.name][which]})" if design.name in _THESIS_FIGURE_NUMBERS else ""
    )


def draw_plant_singular_values(design: ControllerDesign) -> Figure:
    """Draw singular values of the unscaled plant (Figs 6.3 and 6.7); mark its 0 dB crossings and those of the
    thesis.
    """
    figure = blank_figure(7.0, 3.6, dpi=150)
    axes = figure.add_subplot()
    values = singular_values(design.plant, _FREQUENCY_GRID)
    shown = _to_decibel(values)
    _set_up_axes(
        axes,
        f"{design.name}: plant {_cite_thesis_figure(design, 0)}",
        max(20 * np.floor(shown.min() / 20), -160.0),
        20 * np.ceil(shown.max() / 20),
    )
    _plot_columns(axes, _FREQUENCY_GRID, values, BLUE, "G", linewidth=1.6)
    _mark_crossovers(axes, design.plant_crossovers)
    thesis = design.published
    for k, w in enumerate(thesis.plant_crossovers or ()):
        _mark_frequency(axes, w, f"thesis: {w:g} rad/s", VERMILION, 0.92 - 0.07 * k)
    if thesis.resonance:
        _mark_frequency(axes, thesis.resonance, f"thesis: resonance {thesis.resonance:g} rad/s", VERMILION, 0.92)
    axes.set_xlabel("frequency (rad/s)")
    axes.legend(fontsize=8, frameon=False, loc="lower left")
    return figure


def _compute_design_curves(design: ControllerDesign, controller: control.StateSpace) -> LoopCurves:
    dt = controller.dt or 0.0
    if dt:
        frequency = _FREQUENCY_GRID[: int(np.searchsorted(_FREQUENCY_GRID, np.pi / dt))]
        return compute_loop_singular_values(
            sample_plant(design.plant, dt, 1), design.feedback_controller(controller), frequency
        )
    return compute_loop_singular_values(design.plant, design.feedback_controller(controller), _FREQUENCY_GRID)


@draws(ControllerDesign)
def draw_loop(design: ControllerDesign) -> Figure:
    """Draw loop gain and sensitivities (Figs 6.5 and 6.8): full order, reduced, and sampled with delay."""
    figure = blank_figure(7.0, 6.6, dpi=150)
    upper, lower = figure.subplots(2, 1, sharex=True)
    rate = design.discrete.rate_Hz
    cases = (
        (design.controller, "continuous", "-", 1.6),
        (design.reduced, "continuous", "--", 1.2),
        (design.discrete.to_state_space(), f"{rate:g} Hz, one sample of delay", ":", 1.4),
    )
    _set_up_axes(
        upper, f"{design.name}: loop gain $L_u$ at the plant's input {_cite_thesis_figure(design, 1)}", -80, 120
    )
    _set_up_axes(lower, f"{design.name}: sensitivity $S_u$ and complementary sensitivity $T_u$", -60, 12)
    for controller, label, line, width in cases:
        curves, label = _compute_design_curves(design, controller), f"order {controller.nstates}, {label}"
        _plot_columns(upper, curves.frequency, curves.loop, BLUE, label, linestyle=line, linewidth=width)
        for name, values, colour in (
            ("$S_u$", curves.sensitivity, GREEN),
            ("$T_u$", curves.complementary, ORANGE),
        ):
            shown = name if line == "-" else None
            _plot_columns(lower, curves.frequency, values, colour, shown, linestyle=line, linewidth=width)
        nyquist = curves.frequency[-1]
        if line == ":":
            for axes in (upper, lower):
                axes.axvspan(nyquist, _FREQUENCY_GRID[-1], color="0.95", zorder=0)
            upper.annotate("above half the\nsampling rate", (nyquist * 1.15, 100), fontsize=7, color=GREY, va="center")
    loop, thesis = design.full_loop, design.published
    _mark_crossovers(upper, loop.crossovers)
    if thesis.crossover:
        _mark_frequency(upper, thesis.crossover, f"thesis: {thesis.crossover:g} rad/s", VERMILION, 0.92)
    peaks = f"peaks: $S_u$ {loop.sensitivity_peak_dB:.2f} dB, $T_u$ {loop.complementary_peak_dB:.2f} dB"
    printed = [
        f"${name}$ {value:.2f} dB"
        for name, value in (("S_u", thesis.sensitivity_peak_dB), ("T_u", thesis.complementary_peak_dB))
        if value
    ]
    lower.annotate(
        peaks + (f"\nthesis: {', '.join(printed)}" if printed else ""),
        (0.015, 0.97),
        xycoords="axes fraction",
        fontsize=8,
        va="top",
    )
    lower.set_xlabel("frequency (rad/s)")
    upper.legend(fontsize=8, frameon=False, loc="lower left")
    lower.legend(fontsize=8, frameon=False, loc="lower left", title="lines as above", title_fontsize=8)
    return figure


@draws(TunedLoop)
def draw_tuned_loop(tuned: TunedLoop) -> Figure:
    """Return the picture of a tuned loop's design."""
    return draw_loop(tuned.controller_design)


@draws(FlightController)
def draw_sensitivities(controller: FlightController) -> Figure:
    """Draw sensitivity and complementary sensitivity of each of the three loops, sampled with one sample of delay."""
    figure = blank_figure(10.5, 3.4)
    for axes, design in zip(figure.subplots(1, 3, sharey=True), controller.all_designs, strict=True):
        curves, loop = _compute_design_curves(design, design.discrete.to_state_space()), design.sampled_loop
        _set_up_axes(axes, design.name, -60, 12)
        _plot_columns(
            axes,
            curves.frequency,
            curves.sensitivity,
            GREEN,
            f"$S_u$, peak {loop.sensitivity_peak_dB:.1f} dB",
        )
        _plot_columns(
            axes,
            curves.frequency,
            curves.complementary,
            ORANGE,
            f"$T_u$, peak {loop.complementary_peak_dB:.1f} dB",
        )
        axes.set_xlim(1e-2, 1e3)
        axes.set_xlabel("frequency (rad/s)")
        axes.legend(fontsize=8, frameon=False, loc="lower center")
        axes.label_outer()
    return figure


@draws(ParameterRobustness)
def draw_mu_bounds(robustness: ParameterRobustness) -> Figure:
    """Draw the bounds of mu of heave-yaw and roll-pitch over frequency."""
    figure = blank_figure(7.0, 3.6)
    axes = figure.add_subplot()
    for loop, colour in zip(robustness.loop_results, (BLUE, ORANGE), strict=True):
        axes.semilogx(loop.frequency, loop.upper_bound, color=colour, label=f"{loop.name}, upper bound")
        if loop.peak_lower_bound:
            axes.plot(
                loop.peak_lower_bound_frequency,
                loop.peak_lower_bound,
                "o",
                color=colour,
                label=f"{loop.name}, unstable example",
            )
    axes.axhline(1.0, color="black", linewidth=0.7)
    axes.set_ylim(0.0, 1.5 * max(1.0, *(float(loop.upper_bound.max(initial=0.0)) for loop in robustness.loop_results)))
    axes.set_xlabel("frequency (rad/s)")
    axes.set_ylabel("structured singular value")
    axes.set_title(f"{robustness.vehicle_name}: stability over its parameters", loc="left", fontsize=10)
    axes.legend(fontsize=8, frameon=False, ncols=2, loc="upper left")
    return figure


@draws(ServoTimingMap)
def draw_servo_map(found: ServoTimingMap) -> Figure:
    """Draw disk margin and angular rate of the swash plate over servo lag, with one line for each control rate."""
    t = found.table
    figure = blank_figure(4.5 * t.frame_s.size, 5.6)
    axes = figure.subplots(2, t.frame_s.size, sharex=True, sharey="row", squeeze=False)
    for column, frame in zip(axes.T, t.frame_s.values, strict=True):
        for rate in t.rate_Hz.values:
            cell = t.sel(frame_s=frame, rate_Hz=rate)
            column[0].semilogx(1e3 * t.lag_s, cell.disk_margin, "o-", markersize=3, label=f"{rate:g} Hz")
            column[1].loglog(1e3 * t.lag_s, np.degrees(cell.swash_plate_rate_rad_s), "o-", markersize=3)
        column[0].axhline(SAFE_DISK_MARGIN, color="black", linewidth=0.7)
        column[0].set_title(f"servo frame {1e3 * frame:g} ms", loc="left", fontsize=9)
        column[1].set_xlabel("servo lag (ms)")
    axes[0, 0].set_ylim(bottom=0.0)
    axes[0, 0].set_ylabel("disk margin")
    axes[1, 0].set_ylabel("plate speed, 3 deviations (deg/s)")
    axes[0, 0].legend(fontsize=8, frameon=False)
    figure.suptitle(f"{found.vehicle_name} {'with' if found.bar else 'without'} stabiliser bar", fontsize=10)
    return figure


@draws(ControllerComparison)
def draw_comparison(comparison: ControllerComparison) -> Figure:
    """Draw peaks, disk margin, mu and input noise of every method, for both loops."""
    figure = blank_figure(9.0, 5.0)
    axes = figure.subplots(2, 2).ravel()
    methods = comparison.methods
    place = np.arange(len(methods), dtype=float)
    panels: tuple[tuple[str, Callable[[LoopMetrics], float]], ...] = (
        ("largest sampled peak (dB)", lambda f: max(f.sampled.sensitivity_peak_dB, f.sampled.complementary_peak_dB)),
        ("disk margin", lambda f: f.disk.margin),
        ("mu over parameters, upper bound", lambda f: f.mu_upper),
        ("input noise (%)", lambda f: 100 * f.input_noise),
    )
    for ax, (title, figure_of) in zip(axes, panels, strict=True):
        for shift, name, colour in ((-0.2, "roll_pitch", BLUE), (0.2, "heave_yaw", ORANGE)):
            heights = [figure_of(getattr(m, name)) for m in methods]
            ax.bar(place + shift, heights, 0.38, color=colour, label=name.replace("_", "-"))
        ax.set_xticks(place, [m.method_label for m in methods], fontsize=8)
        ax.set_title(title, loc="left", fontsize=9)
    figure.legend(*axes[0].get_legend_handles_labels(), fontsize=8, frameon=False, loc="outside lower center", ncols=2)
    figure.suptitle(f"{comparison.vehicle_name} at {comparison.rate_Hz:g} Hz", fontsize=10)
    return figure


@draws(OutputSchedule)
def draw_schedule_margins(schedule: OutputSchedule) -> Figure:
    """Draw disk margin and peaks of a scheduled roll-pitch loop over forward speed."""
    figure = blank_figure(7.0, 4.6)
    upper, lower = figure.subplots(2, 1, sharex=True)
    ahead = [f for f in schedule.frozen if not f.sideways]
    speed = [f.speed_m_s for f in ahead]
    upper.plot(speed, [f.disk_margin for f in ahead], "o-", color=BLUE, markersize=3, label="scheduled")
    upper.plot(speed, [f.hover_disk_margin for f in ahead], color=ORANGE, label="hover's outputs")
    upper.plot(speed, [f.least_disk_margin for f in ahead], "--", color=GREY, label="least over all shares")
    upper.set_ylim(0.0, None)
    upper.set_ylabel("disk margin")
    lower.plot(speed, [f.sensitivity_peak_dB for f in ahead], color=BLUE, label="peak of S_u")
    lower.plot(speed, [f.complementary_peak_dB for f in ahead], color=GREEN, label="peak of T_u")
    lower.set_ylim(0.0, None)
    lower.set_ylabel("peak (dB)")
    lower.set_xlabel("forward speed (m/s)")
    for axes in (upper, lower):
        axes.legend(fontsize=8, frameon=False, ncols=3, loc="lower left")
    return figure


def write_design_pictures(controller: FlightController, folder: Path | str) -> list[Path]:
    """Draw all designs into a folder, which is created if necessary.

    Parameters
    ----------
    controller : FlightController
    folder : Path or str

    Returns
    -------
    list of Path
        ``<design>-plant.png`` and ``<design>-loop.png`` for heave-yaw, roll-pitch and velocity; for a schedule over
        speed also ``roll-pitch-schedule.png``.

    Thesis: Figs 6.3, 6.5, 6.7, 6.8.
    """
    target = Path(folder)
    target.mkdir(parents=True, exist_ok=True)
    written = []
    for design in controller.all_designs:
        for what, draw in (("plant", draw_plant_singular_values), ("loop", draw_loop)):
            written.append(target / f"{design.name}-{what}.png")
            draw(design).savefig(written[-1])
    if controller.schedule is not None:
        written.append(target / "roll-pitch-schedule.png")
        draw_schedule_margins(controller.schedule).savefig(written[-1])
    return written
