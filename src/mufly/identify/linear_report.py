"""Tables of a linear identification, for the terminal and for the report, and the report itself."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from mufly.identify.frequency import FrequencyResponse
from mufly.identify.linear_result import LinearResult
from mufly.identify.linear_spectral import SpectralFit, response_of
from mufly.identify.report import Section, write_report
from mufly.identify.report_page import number

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = [
    "ahead_rows",
    "bode_picture",
    "candidate_rows",
    "cross_check_rows",
    "estimate_rows",
    "pole_text",
    "quality_rows",
    "slow_picture",
    "write_linear_report",
]

Rows = tuple[tuple[str, ...], tuple[tuple[str, ...], ...]]


def candidate_rows(r: LinearResult) -> Rows:
    """Return heads and rows of the structures that were tried, best first."""
    outputs = r.linear.structure.outputs
    heads = ("structure", "free", "left out", *(f"of {o}" for o in outputs), "AIC", "BIC")
    rows = tuple(
        (
            c.name, f"{c.parameters}", f"{c.left_out:.3f}", *(f"{v:.3f}" for v in c.by_output), f"+{c.aic:.0f}",
            f"+{c.bic:.0f}",
        )
        for c in r.candidates
    )  # fmt: skip
    return heads, rows


def estimate_rows(r: LinearResult) -> Rows:
    """Return heads and rows of the estimates."""
    bound = np.sqrt(np.maximum(np.diag(r.linear.bound), 0.0))
    rows = []
    for e, b, p in zip(r.fit.estimates, bound, r.linear.structure.parameters, strict=True):
        std = "at bound" if e.at_bound else number(e.std)
        rows.append(
            (e.symbol, p.meaning, number(e.value), std, "–" if e.at_bound else number(float(b)), e.unit)
        )
    heads = ("", "", "estimate", "std", "std if white", "unit")
    return heads, tuple(rows)


def quality_rows(r: LinearResult) -> Rows:
    """Return heads and rows of how well every output is simulated, as recorded and low-passed."""
    rows = []
    for role, qs in r.quality.items():
        for k, name in enumerate(r.linear.structure.outputs):
            q, s, f = qs[k], r.quality_slow[role][k], r.floors[role][k]
            rows.append(
                (
                    role, name, _percent(q.fit_percent), _percent(r.ceiling[role][k]), _percent(s.fit_percent),
                    _percent(r.ceiling_slow[role][k]), _percent(r.against_angle[role][k]), f"{s.theil:.2f}",
                    f"{s.rms:.3f}", f"{f.below:.3f}" if f.below > 0.0 else "–", f"{f.above:.3f}",
                )
            )  # fmt: skip
    heads = (
        "part", "output", "fit", "at most", f"fit < {r.slow_hz:g} Hz", "at most", "to angle", "Theil", "error",
        "noise <", "noise >",
    )  # fmt: skip
    return heads, tuple(rows)


def _percent(value: float) -> str:
    return "–" if math.isnan(value) else f"{value:.1f} %"


def ahead_rows(r: LinearResult) -> Rows:
    """Return heads and rows of the prediction a time ahead on the held-out part."""
    outputs = r.linear.structure.outputs
    rows = []
    for a in r.ahead:
        name = "simulation" if math.isinf(a.horizon_s) else f"{a.horizon_s:g} s"
        kept = ["–" if math.isnan(v) else f"{v:.1f}" for v in a.persistence_percent]
        rows.append((name, *(f"{v:.1f}" for v in a.fit_percent_slow), *kept))
    heads = ("ahead", *(f"{o} (%)" for o in outputs), *(f"last {o} (%)" for o in outputs))
    return heads, tuple(rows)


def cross_check_rows(r: LinearResult) -> Rows:
    """Return heads and rows of the parameters by other methods."""
    s = r.spectral
    spectral = {}
    if s is not None:
        spectral = dict(zip(r.linear.structure.symbols, zip(s.values, s.std, strict=True), strict=True))
    rows = []
    for e in r.fit.estimates:
        other = r.equation_error.get(e.symbol)
        rows.append(
            (
                e.symbol, f"{number(e.value)} ± {number(e.std)}",
                _with_std(other),
                _with_std(spectral.get(e.symbol)), e.unit,
            )
        )  # fmt: skip
    return ("parameter", "output error", "equation error", "frequency response", "unit"), tuple(rows)


def _with_std(pair: tuple[float, float] | None) -> str:
    return "–" if pair is None else f"{number(float(pair[0]))} ± {number(float(pair[1]))}"


def bode_picture(r: LinearResult, s: SpectralFit) -> Figure:
    """Draw the measured frequency responses with error bounds beside the model's two."""
    from matplotlib.figure import Figure
    from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

    from mufly.identify.report_pictures import BLUE, ORANGE, VERMILION

    data: FrequencyResponse = s.data
    fitted = response_of(r.linear.structure, r.linear.values, data.frequency_hz)
    m, k = len(data.outputs), len(data.inputs)
    figure = Figure(figsize=(min(11.0, 1.5 + 3.0 * k), 2.9 * m), layout="constrained")
    panels = figure.subplots(2 * m, k, squeeze=False, sharex=True)
    for j in range(m):
        for i in range(k):
            top, bottom = panels[2 * j][i], panels[2 * j + 1][i]
            h, good = data.response[:, j, i], data.partial[:, j, i] >= 0.5
            size = 20.0 * np.log10(np.maximum(np.abs(h), 1e-12))
            spread = 1.96 * np.minimum(data.error[:, j, i], 1.5)
            f = data.frequency_hz
            for curve, colour, label in (
                (fitted, VERMILION, "output error"),
                (s.model, ORANGE, "frequency fit"),
            ):
                if np.abs(curve[:, j, i]).max() > 1e-6:
                    top.semilogx(
                        f,
                        20.0 * np.log10(np.maximum(np.abs(curve[:, j, i]), 1e-12)),
                        color=colour,
                        label=label,
                    )
                    bottom.semilogx(f, np.degrees(np.angle(curve[:, j, i])), color=colour)
            bar = {"fmt": "o", "markersize": 2.5, "linewidth": 0.6, "color": BLUE}
            top.errorbar(f[good], size[good], yerr=8.686 * spread[good], label="measured, 95 %", **bar)
            phase = np.degrees(np.angle(h))
            bottom.errorbar(f[good], phase[good], yerr=np.minimum(np.degrees(spread[good]), 180.0), **bar)
            bottom.set_ylim(-200.0, 200.0)
            bottom.set_yticks((-180, -90, 0, 90, 180))
            bottom.xaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
            bottom.xaxis.set_major_formatter(FuncFormatter(lambda v, _: f"{v:g}"))
            bottom.xaxis.set_minor_formatter(NullFormatter())
            cost = s.cost_before[j, i]
            top.set_title(
                f"{data.inputs[i]} to {data.outputs[j]}" + (f", J = {cost:.0f}" if np.isfinite(cost) else "")
            )
            if i == 0:
                top.set_ylabel("size (dB)")
                bottom.set_ylabel("phase (deg)")
            if j == m - 1:
                bottom.set_xlabel("frequency (Hz)")
    panels[0][0].legend()
    return figure


def pole_text(p: complex) -> str:
    """Return a pole as text."""
    return f"{p.real:.2f}" if abs(p.imag) < 1e-9 else f"{p.real:.2f}{p.imag:+.2f}j"


def slow_picture(r: LinearResult) -> Figure:
    """Draw measured and simulated outputs, both low-passed, over the fitted and the held-out part."""
    from matplotlib import rcParams
    from matplotlib.figure import Figure

    from mufly.identify.linear_columns import lowpassed
    from mufly.identify.report_pictures import VERMILION

    m = len(r.linear.structure.outputs)
    figure = Figure(figsize=(9.5, 0.8 + 1.7 * m), layout="constrained")
    panels = figure.subplots(m, 1, squeeze=False, sharex=True)[:, 0]
    for record in r.fit.records:
        t, dt = record.time_s, float(np.median(np.diff(record.time_s)))
        measured, simulated = (lowpassed(x, dt, r.slow_hz) for x in (record.measured, record.predicted))
        for j, axes in enumerate(panels):
            first = record.role == "fit"
            axes.plot(
                t, measured[:, j], color=rcParams["text.color"], alpha=0.5, linewidth=0.9, label="measured"
            )
            axes.plot(t, simulated[:, j], color=VERMILION, linewidth=1.1, label="simulated from inputs")
            if not first:
                axes.axvspan(t[0], t[-1], color=rcParams["text.color"], alpha=0.05, linewidth=0)
            place, side = (t[0], "left") if first else (t[-1], "right")
            percent = r.quality_slow[record.role][j].fit_percent
            axes.text(
                place, 1.02, f"{record.role}: {percent:.1f} %", ha=side, va="bottom",
                transform=axes.get_xaxis_transform(), fontsize=8.5,
            )  # fmt: skip
    for j, axes in enumerate(panels):
        axes.set_ylabel(f"{r.linear.structure.outputs[j]} ({r.linear.structure.units[j]})")
    handles, labels = panels[0].get_legend_handles_labels()
    figure.legend(handles[:2], labels[:2], ncols=2, loc="outside upper center")
    panels[-1].set_xlabel(
        f"time (s); measured and simulated low-passed at {r.slow_hz:g} Hz; shaded: held out"
    )
    return figure


def write_linear_report(
    r: LinearResult, directory: str | Path, *, command: str | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> Path:  # fmt: skip
    """Write the report of a linear identification; see :func:`mufly.identify.write_report`."""
    sections = []
    if r.candidates:
        heads, rows = candidate_rows(r)
        text = (
            "Each structure was fitted with one block of the fitted part left out in turn, and simulated through it. "
            "Left out: mean square error there over the variance of the output (1: as good as the mean). AIC and BIC "
            "count independent residuals, from their autocorrelation. The held-out part had no say.",
        )
        sections.append(Section("Structures tried", text, heads, rows))
    heads, rows = quality_rows(r)
    sections.append(
        Section(
            "Simulation and noise floor",
            (f"Fits in per cent: as recorded, with both low-passed at {r.slow_hz:g} Hz, and of the latter against the "
             "derivative of the measured angle instead of the gyro. At most: what a model would reach whose only error "
             f"is the noise floor, which is what the output holds above {r.slow_hz:g} Hz (noise >; the inputs have "
             f"{100 * min(f.input_share for f in r.floors['fit']):.1f} % of their power below) and what disagrees with "
             "the angle's derivative below (noise <). Error and noise in the output's unit.",),
            heads, rows, partial(slow_picture, r), "slow",
        )
    )  # fmt: skip
    if r.ahead:
        heads, rows = ahead_rows(r)
        text = (
            f"Fit on the held-out part below {r.slow_hz:g} Hz, when a steady Kalman filter (its noise fitted to the "
            "fitted part) uses measurements up to the given time before; and what the last value would reach.",
        )
        sections.append(Section("Prediction a time ahead", text, heads, rows))
    sections.append(_cross_check(r))
    return write_report(r.fit, directory, command=command, sections=sections, progress=progress)


def _cross_check(r: LinearResult) -> Section:
    heads, rows = cross_check_rows(r)
    text = ["The same parameters without a search (equation error) and from frequency responses."]
    if r.subspace is not None:
        poles = ", ".join(map(pole_text, r.subspace.poles))
        text.append(f"Subspace model with as many states: poles {poles} rad/s.")
        if r.subspace_percent:
            percents = zip(r.linear.structure.outputs, r.subspace_percent, strict=True)
            shown = ", ".join(f"{o} {p:.1f} %" for o, p in percents)
            text.append(f"Its pure simulation on the held-out part, below {r.slow_hz:g} Hz: {shown}.")
    if r.spectral is None:
        text.append("Too little is coherent with the inputs for a fit to frequency responses.")
        return Section("Cross-check by other methods", tuple(text), heads, rows)
    text.append("J is Tischler and Remple's misfit of the output-error model; below 100 is good.")
    return Section(
        "Cross-check by other methods", tuple(text), heads, rows, partial(bode_picture, r, r.spectral), "bode"
    )
