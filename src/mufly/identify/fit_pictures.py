"""Pictures of a fit: prediction and measurement, residuals, and correlation of the estimates.

Every function takes the frozen results of :mod:`mufly.identify.fit_result` and returns a matplotlib figure.
The colours are those of Okabe and Ito (2008), which colour-blind readers can distinguish.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from mufly.errors import InputError
from mufly.identify.fit_result import FitResult, RecordPrediction
from mufly.identify.flight.excitation_plan import ExcitationCandidate, ExcitationPlan
from mufly.identify.flight.excitation_signals import compute_amplitude_spectrum
from mufly.identify.flight.identification_demo import IdentificationDemo
from mufly.identify.flight_record import OUTPUT_UNITS
from mufly.identify.linear.frequency_response import FrequencyResponse, estimate_frequency_response
from mufly.identify.linear.linear_identification import LinearResult
from mufly.identify.motor_fit import MotorFit
from mufly.identify.residual_analysis import (
    assess_record_predictions,
    compute_input_cross_correlation,
    compute_residual_autocorrelation,
)
from mufly.identify.rotor_coefficients import LoadCoefficientFit, RotorCoefficientFit
from mufly.quantities.units import RPM
from mufly.results import draws
from mufly.results.result_figure import blank_figure

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

BLUE, ORANGE, GREEN, VERMILION, PURPLE, SKY_BLUE = "#0072B2", "#E69F00", "#009E73", "#D55E00", "#CC79A7", "#56B4E9"
_MAX_DRAWN_SAMPLES = 4000
_MAX_DRAWN_LAG_S = 2.0  # s, largest lag of drawn correlations

Array = NDArray[np.float64]


@contextmanager
def apply_report_colours() -> Iterator[None]:
    """Apply the colours of the report page to all figures drawn inside this context."""
    from matplotlib import rc_context

    ink, ground, grid = "#1d2329", "#ffffff", "#d5dae0"
    rc: Any = {
        "figure.facecolor": ground, "axes.facecolor": ground, "savefig.facecolor": ground, "text.color": ink,
        "axes.labelcolor": ink, "xtick.color": ink, "ytick.color": ink, "axes.edgecolor": grid, "grid.color": grid,
        "font.size": 9.0, "axes.titlesize": 9.5, "axes.titlelocation": "left", "axes.grid": True, "grid.linewidth": 0.5,
        "axes.axisbelow": True, "axes.spines.top": False, "axes.spines.right": False, "legend.frameon": False,
        "legend.fontsize": 8.0, "lines.linewidth": 1.2, "svg.hashsalt": "mufly",
    }  # fmt: skip
    with rc_context(rc):
        yield


def text_colour() -> str:
    """Return the colour of text in the figures of a report."""
    from matplotlib import rcParams

    return str(rcParams["text.color"])


def set_decade_ticks(axes: Axes) -> None:
    """Place the ticks of a logarithmic frequency axis at 1, 2 and 5 of every decade."""
    from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

    axes.xaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    axes.xaxis.set_major_formatter(FuncFormatter(lambda v, _: f"{v:g}"))
    axes.xaxis.set_minor_formatter(NullFormatter())


def _thinning_slice(record: RecordPrediction) -> slice:
    return slice(None, None, max(1, len(record.time_s) // _MAX_DRAWN_SAMPLES))


def _axis_label(name: str, unit: str) -> str:
    return name if unit in ("", "1") else f"{name} ({unit})"


def _median_sample_s(record: RecordPrediction) -> float:
    return float(np.median(np.diff(record.time_s)))


@draws(RecordPrediction)
def draw_prediction(record: RecordPrediction) -> Figure:
    """Draw every output as measured and as predicted from the inputs alone, with the inputs below."""
    m, k = len(record.output_names), len(record.input_names)
    ratios = [2.0] * m + ([1.6] if k else [])
    figure = blank_figure(9.0, 0.9 + 1.55 * m + (1.35 if k else 0.0))
    panels = figure.subplots(len(ratios), 1, sharex=True, squeeze=False, gridspec_kw={"height_ratios": ratios})[:, 0]
    part = _thinning_slice(record)
    t = record.time_s[part]
    for j, axes in enumerate(panels[:m]):
        q = assess_record_predictions(record)[j]
        measured = record.measured[part, j]
        axes.plot(t, measured, color=text_colour(), alpha=0.45, linewidth=0.7, label="measured")
        axes.plot(t, record.predicted[part, j], color=VERMILION, label="predicted from inputs")
        axes.set_ylabel(_axis_label(record.output_names[j], record.units[j]))
        axes.set_title(f"{record.output_names[j]}: fit {q.fit_percent:.1f} %, rms error {q.rms:.3g} {record.units[j]}")
    if k:
        for j, colour in zip(range(k), (BLUE, ORANGE, GREEN, PURPLE, SKY_BLUE, VERMILION) * k, strict=False):
            u = record.inputs[part, j]
            panels[-1].plot(t, u - np.nanmean(u), color=colour, label=record.input_names[j])
        panels[-1].set_ylabel("inputs less mean")
        low, high = panels[-1].get_ylim()
        panels[-1].set_ylim(low, high + 0.45 * (high - low))  # for the legend
        panels[-1].legend(ncols=min(k, 6), loc="upper left")
    panels[0].legend(ncols=2, loc="upper right")
    panels[-1].set_xlabel("time (s)")
    return figure


@draws(FitResult, IdentificationDemo, LinearResult)
def draw_fit_result(found: FitResult | IdentificationDemo | LinearResult) -> Figure:
    """Draw the prediction of a held-out record; without one, that of a fitted record, else the correlation of the
    estimates.
    """
    fit = found if isinstance(found, FitResult) else found.fit
    shown = (*fit.records_with_role("held out"), *fit.records)
    return draw_prediction(shown[0]) if shown else draw_estimate_correlation(fit)


def draw_residuals(record: RecordPrediction) -> Figure:
    """Draw the residual of every output over time, its autocorrelation with 95 % bounds, and its spectrum."""
    from scipy.signal import welch

    m, dt = len(record.output_names), _median_sample_s(record)
    figure = blank_figure(9.0, 0.5 + 1.75 * m)
    panels = figure.subplots(m, 3, squeeze=False, sharex="col", gridspec_kw={"width_ratios": [2.0, 1.2, 1.2]})
    part = _thinning_slice(record)
    for j in range(m):
        e, noise = record.residual[:, j], float(record.noise_std[j])
        left, middle, right = panels[j]
        left.plot(record.time_s[part], e[part], color=BLUE, linewidth=0.7)
        if np.isfinite(noise) and noise > 0.0:
            left.axhspan(-1.96 * noise, 1.96 * noise, color=GREEN, alpha=0.18, linewidth=0)
        left.set_ylabel(_axis_label(record.output_names[j], record.units[j]))
        c = compute_residual_autocorrelation(e, dt, max_lag_s=_MAX_DRAWN_LAG_S)
        middle.axhspan(-c.confidence_bound, c.confidence_bound, color=GREEN, alpha=0.25, linewidth=0)
        middle.plot(c.lag_s, c.value, color=BLUE)
        middle.set_ylim(min(-0.3, float(c.value.min()) - 0.05), 1.05)
        good = np.where(np.isfinite(e), e, 0.0)
        f, power = welch(good, 1.0 / dt, nperseg=min(good.size, max(64, good.size // 4)))
        right.loglog(f[1:], np.sqrt(power[1:]), color=BLUE)
        right.set_ylabel(f"{record.units[j]}/√Hz")
    panels[0][0].set_title("residual; green: 95 % of the noise floor")
    panels[0][1].set_title("autocorrelation; green: white")
    panels[0][2].set_title("amplitude density")
    for axes, label in zip(panels[-1], ("time (s)", "lag (s)", "frequency (Hz)"), strict=True):
        axes.set_xlabel(label)
    return figure


def draw_cross_correlation(record: RecordPrediction) -> Figure:
    """Draw the cross-correlation of every residual with every input, with 95 % bounds; at positive lags the input
    leads.
    """
    m, k, dt = len(record.output_names), len(record.input_names), _median_sample_s(record)
    figure = blank_figure(min(10.0, 2.0 + 2.4 * k), 0.6 + 1.5 * m)
    panels = figure.subplots(m, k, squeeze=False, sharex=True, sharey=True)
    for j in range(m):
        for i in range(k):
            axes: Axes = panels[j][i]
            c = compute_input_cross_correlation(
                record.inputs[:, i], record.residual[:, j], dt, max_lag_s=_MAX_DRAWN_LAG_S
            )
            if c.confidence_bound < 1.0:
                axes.axhspan(-c.confidence_bound, c.confidence_bound, color=GREEN, alpha=0.22, linewidth=0)
                axes.plot(c.lag_s, c.value, color=BLUE)
            else:
                axes.text(0.5, 0.5, "never moved", transform=axes.transAxes, ha="center", va="center")
            axes.axvline(0.0, color=text_colour(), linewidth=0.5)
            axes.set_title(f"{record.output_names[j]} after {record.input_names[i]}")
            if j == m - 1:
                axes.set_xlabel("lag (s)")
        panels[j][0].set_ylabel("correlation (1)")
    return figure


def estimate_coherence(record: RecordPrediction) -> tuple[FrequencyResponse, FrequencyResponse] | None:
    """Estimate the coherence of measurements and of residuals with the inputs; None for short or incomplete records."""
    dt, n = _median_sample_s(record), len(record.time_s)
    gaps = ~np.isfinite(record.measured).all()
    if not record.input_names or n < 128 or gaps or not np.isfinite(record.predicted).all():
        return None
    segment = n * dt / 6.0
    high = min(0.45 / dt, 40.0 / segment)
    try:
        two = [
            estimate_frequency_response(
                record.inputs, signal, dt, segment_s=segment, low_hz=1.5 / segment, high_hz=high,
                input_names=record.input_names, output_names=record.output_names,
            )
            for signal in (record.measured, record.residual)
        ]  # fmt: skip
    except InputError:
        return None
    return two[0], two[1]


def draw_coherence(record: RecordPrediction) -> Figure | None:
    """Draw the coherence of every output, and of its residual, with the inputs over frequency."""
    both = estimate_coherence(record)
    if both is None:
        return None
    measured, left = both
    m = len(record.output_names)
    figure = blank_figure(9.0, 0.7 + 1.5 * m)
    panels = figure.subplots(m, 1, squeeze=False, sharex=True)[:, 0]
    # With n averages and k inputs, coherence of independent signals is about k / n.
    moving = int((record.inputs.std(axis=0) > 0.0).sum())
    chance = min(1.0, moving / max(measured.averages, 1.0))
    for j, axes in enumerate(panels):
        axes.axhspan(0.0, chance, color=text_colour(), alpha=0.10, linewidth=0)
        axes.semilogx(
            measured.frequency_hz, measured.coherence[:, j], color=text_colour(), label="measured, all inputs"
        )
        axes.semilogx(left.frequency_hz, left.coherence[:, j], color=VERMILION, label="residual, all inputs")
        for i, colour in zip(range(len(record.input_names)), (BLUE, ORANGE, GREEN, PURPLE, SKY_BLUE) * 9, strict=False):
            if np.std(record.inputs[:, i]) > 0.0:
                axes.semilogx(
                    measured.frequency_hz, measured.partial[:, j, i], color=colour, linewidth=0.8, linestyle="--",
                    label=f"{record.input_names[i]} alone",
                )  # fmt: skip
        axes.set(ylim=(0.0, 1.02), ylabel=f"{record.output_names[j]} (1)")
        set_decade_ticks(axes)
    panels[0].set_title(f"coherence; grey: about what {measured.averages:.1f} segments show by chance")
    figure.legend(*panels[0].get_legend_handles_labels(), ncols=3, loc="outside lower center")
    panels[-1].set_xlabel("frequency (Hz)")
    return figure


def draw_theil_coefficient(records: tuple[RecordPrediction, ...]) -> Figure:
    """Draw Theil's coefficient of every output and record, split into bias, variance and covariance."""
    rows = [(f"{r.output_names[j]}, {r.role}", q) for r in records for j, q in enumerate(assess_record_predictions(r))]
    figure = blank_figure(8.0, 0.9 + 0.28 * len(rows))
    axes: Axes = figure.subplots()
    place = np.arange(len(rows))
    start = np.zeros(len(rows))
    parts = (("bias", VERMILION), ("variance", ORANGE), ("covariance", BLUE))
    for name, colour in parts:
        width = np.array([getattr(q, name) * q.theil for _, q in rows])
        axes.barh(place, width, left=start, color=colour, label=f"{name} part", height=0.65)
        start += np.nan_to_num(width)
    axes.axvline(0.3, color=text_colour(), linewidth=0.8, linestyle="--")
    axes.set_yticks(place, [name for name, _ in rows])
    axes.invert_yaxis()
    axes.grid(axis="y", visible=False)
    axes.set(xlim=(0.0, 1.0), xlabel="Theil's inequality coefficient (1); dashed: 0.3, acceptable below")
    figure.legend(ncols=3, loc="outside upper right")
    return figure


def draw_estimate_correlation(fit: FitResult) -> Figure:
    """Draw the correlation of the estimates as a map."""
    n = len(fit.estimates)
    size = float(np.clip(2.2 + 0.38 * n, 3.6, 10.0))
    figure = blank_figure(size + 0.9, size)
    axes: Axes = figure.subplots()
    symbols = [e.symbol for e in fit.estimates]
    image = axes.imshow(fit.correlation, cmap="RdBu_r", vmin=-1.0, vmax=1.0)
    axes.set_xticks(range(n), symbols, rotation=60, ha="right", rotation_mode="anchor")
    axes.set_yticks(range(n), symbols)
    axes.grid(visible=False)
    if n <= 16:
        for i in range(n):
            for j in range(n):
                c = float(fit.correlation[i, j])
                if i != j and np.isfinite(c) and abs(c) >= 0.5:
                    axes.text(
                        j, i, f"{c:.2f}".replace("0.", "."), ha="center", va="center", fontsize=6.5,
                        color="white" if abs(c) > 0.7 else "#1d2329",
                    )  # fmt: skip
    figure.colorbar(image, ax=axes, label="correlation (1)", shrink=0.85)
    return figure


def draw_iteration_history(fit: FitResult) -> Figure | None:
    """Draw the cost and the parameters relative to their final values over the iterations; None without history."""
    rows = [r for r in fit.history if "cost" in r]
    if len(rows) < 2:
        return None
    figure = blank_figure(9.0, 3.2)
    left, right = figure.subplots(1, 2)
    at = np.array([float(r.get("iteration", k)) for k, r in enumerate(rows)])
    cost = np.array([float(r["cost"]) for r in rows])
    left.plot(at, cost, marker="o", markersize=3, color=BLUE)
    if (cost > 0.0).all() and cost.max() > 5.0 * cost.min():
        left.set_yscale("log")
    left.set_ylabel("cost (1)")
    for e in fit.estimates:
        path = np.array([float(r.get(e.symbol, np.nan)) for r in rows])
        if e.value != 0.0 and np.isfinite(path).any():
            right.plot(at, np.clip(path / e.value, -1.0, 3.0), linewidth=0.9, label=e.symbol)
    right.set_ylabel("parameter over its estimate (1), cut to -1..3")
    if len(fit.estimates) <= 14:
        right.legend(ncols=2, fontsize=7.0)
    for axes in (left, right):
        axes.set_xlabel("start, then iteration" if "starts" in fit.method else "iteration or generation")
    return figure


_LINE_COLOURS = (BLUE, VERMILION, GREEN, PURPLE, ORANGE, SKY_BLUE)
_MAX_VOLTAGE_GROUPS = 6


def _group_by_voltage(voltage: Array) -> list[NDArray[np.bool_]]:
    """Group points whose voltages lie within 4 % of each other; return one group if there are no distinct levels."""
    order = np.argsort(voltage)
    steps = np.diff(voltage[order]) > 0.04 * np.abs(voltage[order][1:])
    label = np.empty(voltage.size, dtype=np.int64)
    label[order] = np.cumsum(np.r_[0, steps])
    count = int(label.max()) + 1
    if count > _MAX_VOLTAGE_GROUPS or (count == 1 and np.ptp(voltage) > 0.08 * np.max(np.abs(voltage))):
        return [np.ones(voltage.size, dtype=bool)]
    return [label == k for k in range(count)]


@draws(MotorFit)
def draw_motor_fit(fit: MotorFit, *, title: str = "") -> Figure:
    """Draw current over torque and torque over speed with the fitted lines, and the residuals of both equations.

    Every voltage level gets a line at its mean voltage. Without distinct levels the adjusted readings are drawn.
    """
    r, a, b, d, c = fit.effective
    data = fit.data
    figure = blank_figure(9.0, 6.6)
    axes = figure.subplots(2, 2)
    groups = _group_by_voltage(data.voltage_V)
    lines = len(groups) > 1 or np.ptp(data.voltage_V) <= 0.08 * np.max(np.abs(data.voltage_V))
    for k, inside in enumerate(groups):
        colour = _LINE_COLOURS[k % len(_LINE_COLOURS)]
        u = float(data.voltage_V[inside].mean())
        torque = data.torque_Nm[inside]
        dot = {"color": colour, "marker": "o", "linestyle": "", "markersize": 4}
        name = f"{u:.2f} V" if lines else "all voltages"
        axes[0, 0].plot(1e3 * torque, data.current_A[inside], label=f"{name}, measured", **dot)
        axes[0, 1].plot(data.speed_rad_s[inside] / RPM, 1e3 * torque, label=f"{name}", **dot)
        if lines:
            q = np.linspace(min(0.0, float(torque.min())), float(torque.max()), 50)
            w = (b * u / r - c - q) / (b * a / r + d)
            axes[0, 0].plot(1e3 * q, (u - a * w) / r, color=colour, linewidth=1.2, label=f"{name}, fitted")
            axes[0, 1].plot(w / RPM, 1e3 * q, color=colour, linewidth=1.2)
        else:
            better = fit.adjusted
            axes[0, 0].plot(1e3 * better.torque_Nm, better.current_A, "x", color=colour, markersize=5, label="fitted")
            axes[0, 1].plot(better.speed_rad_s / RPM, 1e3 * better.torque_Nm, "x", color=colour, markersize=5)
        share = fit.residual[inside] / fit.expected_residual_std[inside]
        axes[1, 0].plot(1e3 * torque, share[:, 0], **dot)
        axes[1, 1].plot(1e3 * torque, share[:, 1], **dot)
    labels = (
        ("Torque (mN m)", "Current (A)"), ("Speed (rpm)", "Torque (mN m)"),
        ("Torque (mN m)", "Residual of the voltage (in std)"),
        ("Torque (mN m)", "Residual of the torque (in std)"),
    )  # fmt: skip
    for ax, (x, y) in zip(axes.ravel(), labels, strict=True):
        ax.set(xlabel=x, ylabel=y)
        ax.grid(alpha=0.3)
    for ax in axes[1]:
        _draw_residual_band(ax)
    axes[0, 0].legend(fontsize="x-small")
    figure.suptitle(title or "Motor constants by least squares", fontsize="medium")
    return figure


@draws(RotorCoefficientFit)
def draw_rotor_coefficients(
    fits: RotorCoefficientFit | Sequence[RotorCoefficientFit],
    *,
    predicted: dict[str, tuple[Array, Array]] | None = None,
    title: str = "",
) -> Figure:
    """Draw loads, coefficients and residuals of every fit over speed.

    Parameters
    ----------
    fits : RotorCoefficientFit or sequence of RotorCoefficientFit
    predicted : dict, optional
        ``"<source> <channel>"`` -> speeds (rad/s) and predicted loads.
    title : str
    """
    figure = blank_figure(10.0, 8.4)
    axes = figure.subplots(3, 2, sharex=True, height_ratios=(1.3, 1.0, 0.8))
    every = [
        (result, fit) for result in ([fits] if isinstance(fits, RotorCoefficientFit) else fits) for fit in result.fits
    ]
    for (result, fit), colour in zip(every, itertools.cycle(_LINE_COLOURS), strict=False):
        column = 0 if fit.channel.startswith("thrust") else 1
        extra = (predicted or {}).get(f"{result.source} {fit.channel}")
        _draw_coefficient_fit(axes[:, column], fit, colour, _coefficient_label(result, fit), extra)
    for column, (load, coefficient) in enumerate((("Thrust (N)", "c_T"), ("Torque (N m)", "c_Q"))):
        top, middle, bottom = axes[:, column]
        top.set_ylabel(load)
        middle.set_ylabel(coefficient)
        bottom.set(ylabel="Residual (in std)", xlabel="Rotor speed (rpm)")
        _draw_residual_band(bottom)
        for ax in (top, middle, bottom):
            ax.grid(alpha=0.3)
        if top.get_legend_handles_labels()[0]:
            top.legend(fontsize="x-small")
        low, high = middle.get_ylim()
        middle.set_ylim(min(low, 0.0), high * 1.05)
    figure.suptitle(title or "Rotor coefficients by least squares", fontsize="medium")
    return figure


def _coefficient_label(result: RotorCoefficientFit, fit: LoadCoefficientFit) -> str:
    pitch = "" if math.isnan(result.stated_pitch_rad) else f" at {math.degrees(result.stated_pitch_rad):.3g} deg"
    return f"{', '.join(fit.symbols)} {result.source}{pitch}"


def _draw_coefficient_fit(
    axes: Sequence[Axes], fit: LoadCoefficientFit, colour: str, name: str, predicted: tuple[Array, Array] | None
) -> None:
    top, middle, bottom = axes
    rpm = np.abs(fit.speed_rad_s[:, 0]) / RPM
    order = np.argsort(rpm)
    top.plot(rpm, fit.load, "o", color=colour, markersize=4, label=name)
    top.plot(rpm[order], (fit.load_per_coefficient @ fit.value)[order], color=colour, linewidth=1.2)
    bottom.plot(rpm, fit.residual / fit.expected_std, "o", color=colour, markersize=4)
    if predicted is not None:
        p = np.argsort(predicted[0])
        top.plot(predicted[0][p] / RPM, predicted[1][p], ":", color=colour, label=f"{name}, predicted")
    if len(fit.symbols) > 1:
        return
    middle.plot(rpm, fit.load / fit.load_per_coefficient[:, 0], "o", color=colour, markersize=4)
    std = math.sqrt(fit.covariance[0, 0]) * fit.covariance_estimate.t_quantile_95
    middle.plot(rpm[order], np.full(rpm.size, fit.value[0]), color=colour, linewidth=1.2)
    middle.fill_between(rpm[order], fit.value[0] - std, fit.value[0] + std, color=colour, alpha=0.15, linewidth=0)
    for trend in fit.trends:
        if trend.is_significant:
            w = np.geomspace(*trend.range_rad_s, 60)
            middle.plot(w / RPM, trend.coefficient_at(w), "--", color=colour, linewidth=1.2)
    if predicted is not None:
        unit = np.interp(predicted[0], np.abs(fit.speed_rad_s[:, 0])[order], fit.load_per_coefficient[order, 0])
        middle.plot(predicted[0][p] / RPM, (predicted[1] / unit)[p], ":", color=colour)


def _draw_residual_band(ax: Axes) -> None:
    ax.axhspan(-2, 2, color="0.5", alpha=0.12, linewidth=0)
    ax.axhline(0, color="0.4", linewidth=0.8)


_EXCITATION_COLOURS = {"chirp": BLUE, "multisine": GREEN, "3211": VERMILION, "doublet": PURPLE}
_INPUT_LABELS = ("motor upper", "motor lower", "servo 1", "servo 2")
_SHOWN_OUTPUTS_BY_CHANNEL = {
    "yaw": ("yaw", "r", "height"), "heave": ("height", "yaw"), "roll": ("roll", "pitch", "p"),
    "pitch": ("pitch", "roll", "q"),
}  # fmt: skip
_MAX_SHOWN_STD_PERCENT = 1e3  # per cent; end of the bars of unidentifiable parameters


@draws(ExcitationPlan)
def draw_excitation_plan(plan: ExcitationPlan, chosen: ExcitationCandidate | None = None) -> Figure:
    """Draw an excitation plan: signal, spectra, predicted flight and expected accuracy.

    Parameters
    ----------
    plan : ExcitationPlan
    chosen : ExcitationCandidate, optional
        Candidate whose signal will be flown; by default the best candidate.
    """
    c = plan.best_candidate if chosen is None else chosen
    figure = blank_figure(10.5, 7.6)
    axes = figure.subplots(2, 2)
    _draw_excitation_inputs(axes[0, 0], c)
    _draw_spectra(axes[0, 1], plan)
    _draw_predicted_flight(axes[1, 0], plan, c)
    _draw_expected_accuracy(axes[1, 1], plan)
    figure.suptitle(
        f"{plan.vehicle}, {plan.channel}: {c.signal.kind}, {c.signal.description}; amplitude {100 * c.amplitude:.1f} % "
        f"of the input's range ({c.binding_limit})",
        fontsize="medium",
    )
    return figure


def _draw_excitation_inputs(ax: Axes, c: ExcitationCandidate) -> None:
    moved = np.flatnonzero(np.any(c.added_inputs != 0, axis=0))
    for line, k in zip(_LINE_COLOURS, moved, strict=False):
        label = f"added to {_INPUT_LABELS[k]}"
        ax.step(c.signal.time_s, c.added_inputs[:, k], where="post", color=line, linewidth=1.2, label=label)
    for line, k in zip(_LINE_COLOURS, moved, strict=False):
        about = c.record.inputs[:, k] - c.record.inputs[0, k]
        ax.step(
            c.signal.time_s, about, where="post", color=line, linewidth=0.8, alpha=0.5, linestyle="--",
            label=f"{_INPUT_LABELS[k]} as flown, less hover",
        )  # fmt: skip
    ax.set(xlabel="Time (s)", ylabel="Input (share of range)")
    ax.legend(fontsize="x-small", loc="upper left", ncols=2)
    ax.margins(y=0.25)
    ax.grid(alpha=0.3)


def _draw_spectra(ax: Axes, plan: ExcitationPlan) -> None:
    top = 0.0
    for c in plan.candidates:
        frequency, amplitude = compute_amplitude_spectrum(c.amplitude * c.signal.value, float(c.signal.time_s[1]))
        inside = (frequency > 0) & (frequency < 4 * plan.band_rad_s[1] / (2 * math.pi))
        ax.plot(
            frequency[inside], amplitude[inside], color=_EXCITATION_COLOURS[c.signal.kind], linewidth=1.2,
            label=c.signal.kind,
            marker="." if c.signal.kind == "multisine" else None, markersize=3,
        )  # fmt: skip
        top = max(top, float(amplitude[inside].max()))
    low, high = (w / (2 * math.pi) for w in plan.band_rad_s)
    ax.axvspan(low, high, color="0.5", alpha=0.1, linewidth=0, label="band")
    for k, mode in enumerate(plan.modes_rad_s):
        label = None if k else "modes of the channel"
        ax.axvline(mode / (2 * math.pi), color="0.3", linestyle=":", linewidth=1, label=label)
    ax.set(xscale="log", ylim=(0, 1.1 * top), xlabel="Frequency (Hz)", ylabel="Amplitude (share of range)")
    ax.legend(fontsize="x-small")
    ax.grid(alpha=0.3, which="both")


def _draw_predicted_flight(ax: Axes, plan: ExcitationPlan, c: ExcitationCandidate) -> None:
    shown = [o for o in _SHOWN_OUTPUTS_BY_CHANNEL[plan.channel] if o in c.record.output_names]
    labels = []
    for line, name in zip(_LINE_COLOURS, shown, strict=False):
        unit, factor = OUTPUT_UNITS[name], 1.0
        if unit.startswith("rad"):
            unit, factor = unit.replace("rad", "deg"), math.degrees(1.0)
        if unit == "m":
            unit, factor = "cm", 100.0
        y = c.record.measured[:, c.record.output_names.index(name)]
        y = factor * (y - y[0])
        noise = factor * plan.noise[name]
        ax.plot(c.signal.time_s, y, color=line, linewidth=1.2, label=f"{name} ({unit})")
        ax.fill_between(c.signal.time_s, y - noise, y + noise, color=line, alpha=0.2, linewidth=0)
        labels.append(unit)
    ax.set(xlabel="Time (s)", ylabel=f"Expected change ({', '.join(dict.fromkeys(labels))})")
    ax.legend(fontsize="x-small", loc="upper left", title="band: noise", title_fontsize="x-small")
    ax.grid(alpha=0.3)


def _draw_expected_accuracy(ax: Axes, plan: ExcitationPlan) -> None:
    symbols = [f.symbol for f in plan.free_parameters]
    at, width = np.arange(len(symbols)), 0.8 / len(plan.candidates)
    for k, c in enumerate(plan.candidates):
        value = np.minimum(100 * c.relative_std, _MAX_SHOWN_STD_PERCENT)
        ax.bar(
            at + (k - 0.5 * (len(plan.candidates) - 1)) * width, value, width=0.9 * width,
            color=_EXCITATION_COLOURS[c.signal.kind], label=f"{c.signal.kind}, {100 * c.amplitude:.1f} %",
        )  # fmt: skip
    ax.axhline(50, color="0.3", linestyle=":", linewidth=1)
    ax.set_yscale("log")
    ax.yaxis.set_major_formatter("{x:g}")
    ax.yaxis.set_minor_formatter(lambda x, _: f"{x:g}" if f"{x:e}"[0] in "25" else "")
    ax.set_xticks(at, symbols, rotation=30 if len(symbols) > 6 else 0)
    ax.set(
        xlabel="Parameter (above the dotted line: hardly determined)",
        ylabel="Expected standard deviation (% of value)",
    )
    ax.legend(fontsize="x-small", title="kind, amplitude", title_fontsize="x-small")
    ax.grid(alpha=0.3, axis="y")
