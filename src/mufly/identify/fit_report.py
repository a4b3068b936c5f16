"""Report of a fit: one self-contained HTML file, and the pictures beside it as PNG.

The report holds the interval of every parameter and the parameter combinations that the data do not determine. It
shows how well the model predicts fitted and held-out records, and residual statistics. It ends with the command that
repeats the fit. The terminal output uses the same tables of a linear identification.
"""

from __future__ import annotations

import io
import math
import shlex
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from mufly.errors import convert_write_errors
from mufly.identify import fit_pictures
from mufly.identify.fit_result import FitResult
from mufly.identify.flight_record import low_pass
from mufly.identify.linear.frequency_response import (
    FrequencyResponse,
    FrequencyResponseFit,
    compute_structure_frequency_response,
)
from mufly.identify.linear.linear_identification import LinearResult
from mufly.identify.linear.sweep_response import format_pole
from mufly.identify.residual_analysis import (
    assess_record_predictions,
    describe_model_deficiencies,
    ljung_box_test,
    residual_determinant,
)
from mufly.results.report_page import render_report_template
from mufly.results.result_figure import blank_figure

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def format_number(value: float) -> str:
    """Return a number as text with at most four significant digits; ``–`` if it is not finite."""
    if not np.isfinite(value):
        return "–"
    if abs(value) < 1e-9:
        return "0"
    text = f"{value:.4g}"
    if "e" in text:
        digits, power = text.split("e")
        return f"{digits}·10^{int(power)}"
    return text


_MIN_RESIDUAL_SAMPLES = 20  # least number of samples for residual statistics


@dataclass(frozen=True)
class ReportSection:
    """Section that a command adds to the report.

    Attributes
    ----------
    title : str
    text_paragraphs : tuple of str
    column_heads : tuple of str
        Column heads of the table; empty without a table.
    table_rows : tuple of tuple of str
    draw_picture : callable, optional
        Draws a figure, or returns None if there is nothing to draw.
    picture_name : str
        Name of the picture file, without suffix.
    """

    title: str
    text_paragraphs: tuple[str, ...] = ()
    column_heads: tuple[str, ...] = ()
    table_rows: tuple[tuple[str, ...], ...] = ()
    draw_picture: Callable[[], Figure | None] | None = None
    picture_name: str = ""


def write_fit_report(
    fit: FitResult, directory: str | Path, *, command: str | None = None, sections: Sequence[ReportSection] = (),
    progress: Callable[[int, int], None] | None = None,
) -> Path:  # fmt: skip
    """Write ``report.html`` and its pictures into a folder, which is created if it does not exist.

    Parameters
    ----------
    fit : FitResult
    directory : str or Path
    command : str, optional
        Command that repeats the fit; by default the running ``mufly`` command.
    sections : sequence of ReportSection
        Further sections, placed after the predictions.
    progress : callable, optional
        Called with the number of pictures drawn and the number of all pictures.

    Returns
    -------
    Path
        Path of the HTML file.

    Raises
    ------
    InputError
        If the folder cannot be written.
    """
    folder = Path(directory)
    with convert_write_errors("report", key=str(folder)):
        folder.mkdir(parents=True, exist_ok=True)
        count = 3 + 4 * len(fit.records) + sum(s.draw_picture is not None for s in sections)
        album = _ReportPictures(folder, count, progress)
        page = render_report_template(
            f"{fit.vehicle}: identification",
            _PAGE_BODY_TEMPLATE,
            heading=fit.vehicle,
            fit=fit,
            sections=sections,
            command=_command_line() if command is None else command,
            summary=_summary_rows(fit),
            parameters=_parameter_rows(fit),
            sizes=_residual_rows(fit),
            album=album.save_picture,
            pictures=fit_pictures,
            correlated=len(fit.estimates) > 1 and np.isfinite(fit.correlation).any(),
            enough=_MIN_RESIDUAL_SAMPLES,
            what_is_missing=describe_model_deficiencies,
            determinants=_format_determinant_ratio(fit),
        )
        path = folder / "report.html"
        path.write_text(page, encoding="utf-8")
    return path


class _ReportPictures:
    """Writer of the report's pictures, as PNG files and for embedding in the page."""

    def __init__(self, folder: Path, count: int, progress: Callable[[int, int], None] | None) -> None:
        self._folder, self._count, self._progress, self._done = folder, count, progress, 0

    def save_picture(self, name: str, draw: Callable[..., Figure | None], *about: object) -> bytes:
        """Draw a picture, write it to the folder and return it as PNG, empty if there is nothing to draw."""
        self._done += 1
        if self._progress is not None:
            self._progress(self._done, max(self._done, self._count))
        with fit_pictures.apply_report_colours():
            figure = draw(*about)
            if figure is None:
                return b""
            buffer = io.BytesIO()
            figure.savefig(buffer, format="png", dpi=130)
        (self._folder / f"{name}.png").write_bytes(buffer.getvalue())
        return buffer.getvalue()


def _command_line() -> str:
    called = Path(sys.argv[0]).name if sys.argv else ""
    return shlex.join(["mufly", *sys.argv[1:]]) if called.startswith("mufly") else ""


_PAGE_BODY_TEMPLATE = """
{% if not fit.converged %}<p class="warn">The search did not converge: intervals do not hold.</p>{% endif %}
{{ table((), summary) }}
{% if command %}<p>Repeat with</p><pre>{{ command }}</pre>{% endif %}
<h2>Parameters</h2>
{{ table(*parameters, numbers=range(1, 6), warn=parameters[0] | length - 1) }}
{% if correlated %}
{{ figure(album("correlation", pictures.draw_estimate_correlation, fit), "Correlation of estimates") }}
{% endif %}
{% if fit.uncertain_from_held_parameters %}
<h2>Uncertain because of held parameters</h2>
{{ listed(fit.uncertain_from_held_parameters) }}
{% endif %}
<h2>Parameters that the data cannot separate</h2>
{{ listed(fit.undetermined, "Nothing stands out: every parameter is determined by these records.") }}
{% if fit.records %}
<h2>Prediction from inputs alone</h2>
{{ table(*sizes, numbers=range(3, 10)) }}
{% if determinants %}
<p>Determinant of the residuals' covariance, held out over fitted: {{ determinants }} (1: as good).</p>
{% endif %}
<p>Fit: 100 % is exact, 0 % is the mean of the record. Over noise: 1 is the measurement's own noise floor. p below 0.05:
the residual is not white, so that plain Cramér-Rao bounds would be too small.</p>
{{ figure(album("theil", pictures.draw_theil_coefficient, fit.records), "Theil's coefficient") }}
{% endif %}
{% for record in fit.records %}
{% set name = loop.index ~ "-" ~ record.role.replace(" ", "-") %}
<h2>{{ record.name }} <small>({{ record.role }})</small></h2>
{% if record.doubt %}<p class="warn">{{ record.doubt }}.</p>{% endif %}
{{ figure(album(name ~ "-prediction", pictures.draw_prediction, record), "Prediction") }}
{% if record.time_s | length >= enough %}
<h3>Findings from the residuals</h3>
{{ listed(what_is_missing(record), "Nothing stands out of the noise.") }}
{{ figure(album(name ~ "-residuals", pictures.draw_residuals, record), "Residuals") }}
{% if record.input_names %}
{{ figure(album(name ~ "-cross", pictures.draw_cross_correlation, record), "Residuals and inputs") }}
{{ figure(album(name ~ "-coherence", pictures.draw_coherence, record), "Coherence") }}
{% endif %}
{% endif %}
{% endfor %}
{% for section in sections %}
<h2>{{ section.title }}</h2>
{% for text in section.text_paragraphs %}<p>{{ text }}</p>{% endfor %}
{% if section.column_heads %}
{{ table(section.column_heads, section.table_rows, numbers=range(1, section.column_heads | length)) }}
{% endif %}
{% if section.draw_picture %}
{{ figure(album(section.picture_name or "section", section.draw_picture), section.title) }}
{% endif %}
{% endfor %}
{% if fit.history | length > 1 %}
<h2>Convergence</h2>
{{ figure(album("history", pictures.draw_iteration_history, fit), "Cost and parameters") }}
{% endif %}
"""


ReportTable = tuple[tuple[str, ...], tuple[tuple[str, ...], ...]]


def _summary_rows(fit: FitResult) -> tuple[tuple[str, str], ...]:
    return (
        ("method", fit.method), ("outcome", ("converged; " if fit.converged else "NOT converged; ") + fit.message),
        ("cost", format_number(fit.cost)), ("simulations", f"{fit.simulations}"),
        ("time", f"{fit.computing_time_s:.1f} s"),
    )  # fmt: skip


def _parameter_rows(fit: FitResult) -> ReportTable:
    rows = []
    for e in fit.estimates:
        relative = abs(e.std / e.value) if e.value != 0.0 else float("inf")
        flag = "at a bound" if e.at_bound else ""
        interval = "–" if e.at_bound else f"{format_number(e.low)} … {format_number(e.high)}"
        percent = "–" if e.at_bound or not np.isfinite(relative) else f"{100 * relative:.3g} %"
        if relative > 10.0 and percent != "–":
            percent = "> 1000 %"
        rows.append(
            (
                e.symbol,
                format_number(e.start),
                format_number(e.value),
                "–" if e.at_bound else format_number(e.std),
                percent,
                interval,
                e.unit.replace(" ", "\u00a0"),
                e.key,
                flag,
            )
        )
    heads = ("parameter", "start", "estimate", "std", "rel.", "95 % interval", "unit", "key", "")
    keep = [k for k in range(len(heads)) if k != 7 or any(e.key for e in fit.estimates)]
    return tuple(heads[k] for k in keep), tuple(tuple(row[k] for k in keep) for row in rows)


def _residual_rows(fit: FitResult) -> ReportTable:
    rows = []
    for record in fit.records:
        for j, q in enumerate(assess_record_predictions(record)):
            e = record.residual[:, j]
            enough = int(np.isfinite(e).sum()) >= _MIN_RESIDUAL_SAMPLES
            white = ljung_box_test(e, lags=min(50, len(e) // 5)).p_value if enough else float("nan")
            rows.append(
                (
                    record.role, record.name, record.output_names[j], f"{q.fit_percent:.1f} %", f"{q.r2:.3f}",
                    f"{q.theil:.3f}", f"{q.bias:.2f} / {q.variance:.2f} / {q.covariance:.2f}",
                    f"{q.rms:.3g} {record.units[j]}", f"{q.rms_over_noise:.2f}",
                    "< 0.001" if white < 1e-3 else f"{white:.2g}",
                )
            )  # fmt: skip
    heads = (
        "role", "record", "output", "fit", "R²", "Theil", "bias / var. / cov.", "rms error", "over noise", "white? p",
    )  # fmt: skip
    return heads, tuple(rows)


def _format_determinant_ratio(fit: FitResult) -> str:
    """Return, as text, the determinant of the residual covariance in held-out records over that in fitted records.

    The text is empty if the records are not comparable.
    """
    used, unused = fit.records_with_role("fit"), fit.records_with_role("held out")
    if not used or not unused or len({r.output_names for r in fit.records}) > 1:
        return ""
    return format_number(residual_determinant(unused) / max(residual_determinant(used), 1e-300))


def candidate_table(r: LinearResult) -> ReportTable:
    """Return header and rows of the table of candidate structures, best first."""
    outputs = r.linear_fit.structure.outputs
    heads = ("structure", "free", "cross-validation", *(f"of {o}" for o in outputs), "AIC", "BIC")
    rows = []
    for c in r.candidates:
        scores = (f"{v:.3f}" for v in (c.left_out_error, *c.left_out_error_by_output))
        rows.append((c.name, f"{c.parameters}", *scores, f"+{c.aic:.0f}", f"+{c.bic:.0f}"))
    return heads, tuple(rows)


def estimate_table(r: LinearResult) -> ReportTable:
    """Return header and rows of the table of parameter estimates."""
    bound = np.sqrt(np.maximum(np.diag(r.linear_fit.cramer_rao_bound), 0.0))
    rows = []
    for e, b, p in zip(r.fit.estimates, bound, r.linear_fit.structure.parameters, strict=True):
        doubt = ("at bound", "–") if e.at_bound else (format_number(e.std), format_number(float(b)))
        rows.append((e.symbol, p.meaning, format_number(e.value), *doubt, e.unit))
    heads = ("", "", "estimate", "std", "std if white", "unit")
    return heads, tuple(rows)


def simulation_quality_table(r: LinearResult) -> ReportTable:
    """Return header and rows of the simulation quality of every output, as recorded and low-passed."""
    rows = []
    for role, checks in r.checks.items():
        for name, c in zip(r.linear_fit.structure.outputs, checks, strict=True):
            pure = (c.quality.fit_percent, c.ceiling_fit_percent, c.slow_quality.fit_percent, c.ceiling_slow)
            percents = (*pure, c.angle_derivative_fit_percent)
            below = f"{c.noise_floor.below:.3f}" if c.noise_floor.below > 0.0 else "–"
            sizes = (f"{c.slow_quality.theil:.2f}", f"{c.slow_quality.rms:.3f}", below, f"{c.noise_floor.above:.3f}")
            rows.append((role, name, *map(_format_percent, percents), *sizes))
    heads = (
        "part", "output", "fit", "at most", f"fit < {r.slow_hz:g} Hz", "at most", "to angle", "Theil", "error",
        "noise <", "noise >",
    )  # fmt: skip
    return heads, tuple(rows)


def _format_percent(value: float) -> str:
    return "–" if math.isnan(value) else f"{value:.1f} %"


def prediction_table(r: LinearResult) -> ReportTable:
    """Return header and rows of the multi-step prediction quality on the held-out part, for each prediction horizon."""
    outputs = r.linear_fit.structure.outputs
    rows = []
    for a in r.ahead:
        name = "simulation" if math.isinf(a.horizon_s) else f"{a.horizon_s:g} s"
        kept = ["–" if math.isnan(v) else f"{v:.1f}" for v in a.persistence_percent]
        rows.append((name, *(f"{v:.1f}" for v in a.fit_percent_slow), *kept))
    heads = ("ahead", *(f"{o} (%)" for o in outputs), *(f"last {o} (%)" for o in outputs))
    return heads, tuple(rows)


def cross_check_table(r: LinearResult) -> ReportTable:
    """Return header and rows that compare the parameters from output error, equation error and frequency response."""
    s, spectral = r.spectral_fit, {}
    if s is not None:
        spectral = dict(zip(r.linear_fit.structure.symbols, zip(s.values, s.value_std, strict=True), strict=True))
    rows = []
    for e in r.fit.estimates:
        ways = ((e.value, e.std), r.equation_error.get(e.symbol), spectral.get(e.symbol))
        found = ("–" if w is None else f"{format_number(float(w[0]))} ± {format_number(float(w[1]))}" for w in ways)
        rows.append((e.symbol, *found, e.unit))
    return ("parameter", "output error", "equation error", "frequency response", "unit"), tuple(rows)


def draw_bode_comparison(r: LinearResult, s: FrequencyResponseFit) -> Figure:
    """Draw measured frequency responses with error bounds, and those of the time-domain and spectral fits."""
    data: FrequencyResponse = s.measured_response
    fitted = compute_structure_frequency_response(r.linear_fit.structure, r.linear_fit.values, data.frequency_hz)
    m, k = len(data.outputs), len(data.inputs)
    figure = blank_figure(min(11.0, 1.5 + 3.0 * k), 2.9 * m)
    panels = figure.subplots(2 * m, k, squeeze=False, sharex=True)
    for j in range(m):
        for i in range(k):
            top, bottom = panels[2 * j][i], panels[2 * j + 1][i]
            h, good = data.response[:, j, i], data.partial[:, j, i] >= 0.5
            spread = np.minimum(data.relative_half_interval[:, j, i], 1.0)
            f = data.frequency_hz
            models = (
                (fitted[:, j, i], fit_pictures.VERMILION, "output error"),
                (s.model_response[:, j, i], fit_pictures.ORANGE, "frequency fit"),
            )
            for curve, colour, label in models:
                if np.abs(curve).max() > 1e-6:
                    top.semilogx(f, _to_decibels(curve), color=colour, label=label)
                    bottom.semilogx(f, np.degrees(np.angle(curve)), color=colour)
            bar = {"fmt": "o", "markersize": 2.5, "linewidth": 0.6, "color": fit_pictures.BLUE}
            top.errorbar(f[good], _to_decibels(h)[good], yerr=8.686 * spread[good], label="measured, 95 %", **bar)
            phase = np.degrees(np.angle(h))
            bottom.errorbar(f[good], phase[good], yerr=np.degrees(np.arcsin(spread[good])), **bar)
            bottom.set(ylim=(-200.0, 200.0), yticks=(-180, -90, 0, 90, 180))
            fit_pictures.set_decade_ticks(bottom)
            cost = s.cost_before[j, i]
            top.set_title(f"{data.inputs[i]} to {data.outputs[j]}" + (f", J = {cost:.0f}" if np.isfinite(cost) else ""))
            if i == 0:
                top.set_ylabel("size (dB)")
                bottom.set_ylabel("phase (deg)")
            if j == m - 1:
                bottom.set_xlabel("frequency (Hz)")
    panels[0][0].legend()
    return figure


def _to_decibels(response: NDArray[np.complex128]) -> NDArray[np.float64]:
    return 20.0 * np.log10(np.maximum(np.abs(response), 1e-12))


def draw_low_passed_outputs(r: LinearResult) -> Figure:
    """Draw measured and simulated outputs, both low-passed, over the fitted and the held-out part."""
    m, ink = len(r.linear_fit.structure.outputs), fit_pictures.text_colour()
    figure = blank_figure(9.5, 0.8 + 1.7 * m)
    panels = figure.subplots(m, 1, squeeze=False, sharex=True)[:, 0]
    for record in r.fit.records:
        t, dt = record.time_s, float(np.median(np.diff(record.time_s)))
        measured, simulated = (low_pass(x, dt, r.slow_hz) for x in (record.measured, record.predicted))
        for j, axes in enumerate(panels):
            first = record.role == "fit"
            axes.plot(t, measured[:, j], color=ink, alpha=0.5, linewidth=0.9, label="measured")
            label = "simulated from inputs"
            axes.plot(t, simulated[:, j], color=fit_pictures.VERMILION, linewidth=1.1, label=label)
            if not first:
                axes.axvspan(t[0], t[-1], color=ink, alpha=0.05, linewidth=0)
            place, side = (t[0], "left") if first else (t[-1], "right")
            percent = r.checks[record.role][j].slow_quality.fit_percent
            axes.text(
                place, 1.02, f"{record.role}: {percent:.1f} %", ha=side, va="bottom",
                transform=axes.get_xaxis_transform(), fontsize=8.5,
            )  # fmt: skip
    for j, axes in enumerate(panels):
        axes.set_ylabel(f"{r.linear_fit.structure.outputs[j]} ({r.linear_fit.structure.units[j]})")
    handles, labels = panels[0].get_legend_handles_labels()
    figure.legend(handles[:2], labels[:2], ncols=2, loc="outside upper center")
    panels[-1].set_xlabel(f"time (s); measured and simulated low-passed at {r.slow_hz:g} Hz; shaded: held out")
    return figure


def write_linear_report(
    r: LinearResult, directory: str | Path, *, command: str | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> Path:  # fmt: skip
    """Write the report of a linear identification; see :func:`mufly.identify.write_fit_report`."""
    sections = []
    if r.candidates:
        heads, rows = candidate_table(r)
        text = (
            "Each structure was fitted with one block of the fitted part left out in turn, and simulated through it. "
            "Left out: mean square error there over the variance of the output (1: as good as the mean). AIC and BIC "
            "count independent residuals, from their autocorrelation. The held-out part was not used.",
        )
        sections.append(ReportSection("Structures tried", text, heads, rows))
    heads, rows = simulation_quality_table(r)
    sections.append(
        ReportSection(
            "Simulation and noise floor",
            (f"Fits in per cent: as recorded, with both low-passed at {r.slow_hz:g} Hz, and of the latter against the "
             "derivative of the measured angle instead of the gyro. At most: what a model would reach whose only error "
             f"is the noise floor, which is what the output holds above {r.slow_hz:g} Hz (noise >; the inputs have "
             f"{100 * min(c.noise_floor.input_power_below_fraction for c in r.checks['fit']):.1f} % of their power "
             "below) and what disagrees with the angle's derivative below (noise <). Error and noise in the output's "
             "unit.",),
            heads, rows, partial(draw_low_passed_outputs, r), "slow",
        )
    )  # fmt: skip
    if r.ahead:
        heads, rows = prediction_table(r)
        text = (
            f"Fit on the held-out part below {r.slow_hz:g} Hz, when a steady Kalman filter (its noise fitted to the "
            "fitted part) uses measurements up to the given time before; and the fit of a prediction that "
            "keeps the last value.",
        )
        sections.append(ReportSection("Prediction a time ahead", text, heads, rows))
    sections.append(_cross_check_section(r))
    return write_fit_report(r.fit, directory, command=command, sections=sections, progress=progress)


def _cross_check_section(r: LinearResult) -> ReportSection:
    heads, rows = cross_check_table(r)
    text = ["The same parameters without a search (equation error) and from frequency responses."]
    if r.subspace is not None:
        poles = ", ".join(map(format_pole, r.subspace.poles))
        text.append(f"Subspace model with as many states: poles {poles} rad/s.")
        if r.subspace_percent:
            percents = zip(r.linear_fit.structure.outputs, r.subspace_percent, strict=True)
            shown = ", ".join(f"{o} {p:.1f} %" for o, p in percents)
            text.append(f"Its pure simulation on the held-out part, below {r.slow_hz:g} Hz: {shown}.")
    if r.spectral_fit is None:
        text.append("Too few frequencies are coherent with the inputs for a fit to frequency responses.")
        return ReportSection("Cross-check by other methods", tuple(text), heads, rows)
    text.append("J is Tischler and Remple's misfit of the output-error model; below 100 is good.")
    return ReportSection(
        "Cross-check by other methods",
        tuple(text),
        heads,
        rows,
        partial(draw_bode_comparison, r, r.spectral_fit),
        "bode",
    )
