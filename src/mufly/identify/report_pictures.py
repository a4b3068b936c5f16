"""Pictures of a fit: prediction beside measurement, what is left over, and what the estimates share.

Every function takes the frozen results of :mod:`mufly.identify.result` and returns a matplotlib figure.
Colours are those of Okabe and Ito (2008), which the colour-blind can tell apart.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from mufly.errors import InputError
from mufly.identify.frequency import FrequencyResponse, frequency_response
from mufly.identify.residuals import autocorrelation, cross_correlation, qualities
from mufly.identify.result import Fit, RecordFit

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = [
    "coherence_of",
    "coherence_picture",
    "correlation_picture",
    "cross_picture",
    "history_picture",
    "prediction_picture",
    "residual_picture",
    "style",
    "theil_picture",
]

BLUE, ORANGE, GREEN, VERMILION, PURPLE, SKY = "#0072B2", "#E69F00", "#009E73", "#D55E00", "#CC79A7", "#56B4E9"
_MOST_POINTS = 4000

Array = NDArray[np.float64]


@contextmanager
def style() -> Iterator[None]:
    """Draw in the colours of the report's page inside this context."""
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


def _figure(width: float, height: float) -> Figure:
    from matplotlib.figure import Figure

    return Figure(figsize=(width, height), layout="constrained")


def _ink() -> str:
    from matplotlib import rcParams

    return str(rcParams["text.color"])


def _thin(record: RecordFit) -> slice:
    return slice(None, None, max(1, len(record.time_s) // _MOST_POINTS))


def _label(name: str, unit: str) -> str:
    return name if unit in ("", "1") else f"{name} ({unit})"


def _step(record: RecordFit) -> float:
    return float(np.median(np.diff(record.time_s)))


def prediction_picture(record: RecordFit) -> Figure:
    """Draw every output as measured and as predicted from the inputs alone, with the inputs below."""
    m, k = len(record.outputs), len(record.input_names)
    ratios = [2.0] * m + ([1.6] if k else [])
    figure = _figure(9.0, 0.9 + 1.55 * m + (1.35 if k else 0.0))
    panels = figure.subplots(
        len(ratios), 1, sharex=True, squeeze=False, gridspec_kw={"height_ratios": ratios}
    )[:, 0]
    part = _thin(record)
    for j, axes in enumerate(panels[:m]):
        q = qualities(record)[j]
        axes.plot(
            record.time_s[part],
            record.measured[part, j],
            color=_ink(),
            alpha=0.45,
            linewidth=0.7,
            label="measured",
        )
        axes.plot(
            record.time_s[part], record.predicted[part, j], color=VERMILION, label="predicted from inputs"
        )
        axes.set_ylabel(_label(record.outputs[j], record.units[j]))
        axes.set_title(
            f"{record.outputs[j]}: fit {q.fit_percent:.1f} %, rms error {q.rms:.3g} {record.units[j]}"
        )
    if k:
        for j, colour in zip(range(k), (BLUE, ORANGE, GREEN, PURPLE, SKY, VERMILION) * k, strict=False):
            u = record.inputs[part, j]
            panels[-1].plot(record.time_s[part], u - np.nanmean(u), color=colour, label=record.input_names[j])
        panels[-1].set_ylabel("inputs less mean")
        panels[-1].legend(ncols=min(k, 6), loc="upper left")
    panels[0].legend(ncols=2, loc="upper right")
    panels[-1].set_xlabel("time (s)")
    return figure


def residual_picture(record: RecordFit, *, max_lag_s: float = 2.0) -> Figure:
    """Draw the residual of every output over time, its autocorrelation with 95 % bounds, and its spectrum."""
    from scipy.signal import welch

    m, dt = len(record.outputs), _step(record)
    figure = _figure(9.0, 0.5 + 1.75 * m)
    panels = figure.subplots(m, 3, squeeze=False, sharex="col", gridspec_kw={"width_ratios": [2.0, 1.2, 1.2]})
    part = _thin(record)
    for j in range(m):
        e, noise = record.residual[:, j], float(record.noise_std[j])
        left, middle, right = panels[j]
        left.plot(record.time_s[part], e[part], color=BLUE, linewidth=0.7)
        if np.isfinite(noise) and noise > 0.0:
            left.axhspan(-1.96 * noise, 1.96 * noise, color=GREEN, alpha=0.18, linewidth=0)
        left.set_ylabel(_label(record.outputs[j], record.units[j]))
        c = autocorrelation(e, dt, max_lag_s=max_lag_s)
        middle.axhspan(-c.bound, c.bound, color=GREEN, alpha=0.25, linewidth=0)
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


def cross_picture(record: RecordFit, *, max_lag_s: float = 2.0) -> Figure:
    """Draw the correlation of every residual with every input, 95 % bounds; positive lags: the input came first."""
    m, k, dt = len(record.outputs), len(record.input_names), _step(record)
    figure = _figure(min(10.0, 2.0 + 2.4 * k), 0.6 + 1.5 * m)
    panels = figure.subplots(m, k, squeeze=False, sharex=True, sharey=True)
    for j in range(m):
        for i in range(k):
            axes: Axes = panels[j][i]
            c = cross_correlation(record.inputs[:, i], record.residual[:, j], dt, max_lag_s=max_lag_s)
            if c.bound < 1.0:
                axes.axhspan(-c.bound, c.bound, color=GREEN, alpha=0.22, linewidth=0)
                axes.plot(c.lag_s, c.value, color=BLUE)
            else:
                axes.text(0.5, 0.5, "never moved", transform=axes.transAxes, ha="center", va="center")
            axes.axvline(0.0, color=_ink(), linewidth=0.5)
            axes.set_title(f"{record.outputs[j]} after {record.input_names[i]}")
            if j == m - 1:
                axes.set_xlabel("lag (s)")
        panels[j][0].set_ylabel("correlation (1)")
    return figure


def coherence_of(record: RecordFit) -> tuple[FrequencyResponse, FrequencyResponse] | None:
    """Estimate the coherence of measurements, and of residuals, with the inputs; None where that cannot be done."""
    dt, n = _step(record), len(record.time_s)
    gaps = ~np.isfinite(record.measured).all()
    if not record.input_names or n < 128 or gaps or not np.isfinite(record.predicted).all():
        return None
    segment = n * dt / 6.0
    high = min(0.45 / dt, 40.0 / segment)
    try:
        two = [
            frequency_response(
                record.inputs, signal, dt, segment_s=segment, low_hz=1.5 / segment, high_hz=high,
                input_names=record.input_names, output_names=record.outputs,
            )
            for signal in (record.measured, record.residual)
        ]  # fmt: skip
    except InputError:
        return None
    return two[0], two[1]


def coherence_picture(record: RecordFit) -> Figure | None:
    """Draw what share of every output, and of its residual, the inputs explain linearly, over frequency."""
    from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

    both = coherence_of(record)
    if both is None:
        return None
    measured, left = both
    m = len(record.outputs)
    figure = _figure(9.0, 0.7 + 1.5 * m)
    panels = figure.subplots(m, 1, squeeze=False, sharex=True)[:, 0]
    # With n_d averages and k inputs, coherence of independent signals is about k / n_d.
    moving = int((record.inputs.std(axis=0) > 0.0).sum())
    chance = min(1.0, moving / max(measured.averages * 1.8, 1.0))
    for j, axes in enumerate(panels):
        axes.axhspan(0.0, chance, color=_ink(), alpha=0.10, linewidth=0)
        axes.semilogx(
            measured.frequency_hz, measured.coherence[:, j], color=_ink(), label="measured, all inputs"
        )
        axes.semilogx(left.frequency_hz, left.coherence[:, j], color=VERMILION, label="residual, all inputs")
        for i, colour in zip(
            range(len(record.input_names)), (BLUE, ORANGE, GREEN, PURPLE, SKY) * 9, strict=False
        ):
            if np.std(record.inputs[:, i]) > 0.0:
                axes.semilogx(
                    measured.frequency_hz, measured.partial[:, j, i], color=colour, linewidth=0.8, linestyle="--",
                    label=f"{record.input_names[i]} alone",
                )  # fmt: skip
        axes.set_ylim(0.0, 1.02)
        axes.set_ylabel(f"{record.outputs[j]} (1)")
        axes.xaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
        axes.xaxis.set_major_formatter(FuncFormatter(lambda v, _: f"{v:g}"))
        axes.xaxis.set_minor_formatter(NullFormatter())
    panels[0].set_title(f"coherence; grey: about what {measured.averages:.1f} segments show by chance")
    figure.legend(*panels[0].get_legend_handles_labels(), ncols=3, loc="outside lower center")
    panels[-1].set_xlabel("frequency (Hz)")
    return figure


def theil_picture(records: tuple[RecordFit, ...]) -> Figure:
    """Draw Theil's coefficient of every output and record, split into bias, variance and covariance."""
    rows = [(f"{r.outputs[j]}, {r.role}", q) for r in records for j, q in enumerate(qualities(r))]
    figure = _figure(8.0, 0.9 + 0.28 * len(rows))
    axes: Axes = figure.subplots()
    place = np.arange(len(rows))
    start = np.zeros(len(rows))
    parts = (("bias", VERMILION), ("variance", ORANGE), ("covariance", BLUE))
    for name, colour in parts:
        width = np.array([getattr(q, name) * q.theil for _, q in rows])
        axes.barh(place, width, left=start, color=colour, label=f"{name} part", height=0.65)
        start += np.nan_to_num(width)
    axes.axvline(0.3, color=_ink(), linewidth=0.8, linestyle="--")
    axes.set_yticks(place, [name for name, _ in rows])
    axes.invert_yaxis()
    axes.grid(axis="y", visible=False)
    axes.set_xlim(0.0, 1.0)
    axes.set_xlabel("Theil's inequality coefficient (1); dashed: 0.3, acceptable below")
    figure.legend(ncols=3, loc="outside upper right")
    return figure


def correlation_picture(fit: Fit) -> Figure:
    """Draw the correlation of the estimates as a map."""
    n = len(fit.estimates)
    size = float(np.clip(2.2 + 0.38 * n, 3.6, 10.0))
    figure = _figure(size + 0.9, size)
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


def history_picture(fit: Fit) -> Figure | None:
    """Draw the cost and the parameters, over their final values, iteration by iteration; None without history."""
    rows = [r for r in fit.history if "cost" in r]
    if len(rows) < 2:
        return None
    figure = _figure(9.0, 3.2)
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
