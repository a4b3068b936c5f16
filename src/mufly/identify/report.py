"""The report of a fit: one HTML file that needs nothing else, and the pictures beside it as PNG.

It holds what an engineer asks before believing a parameter: its interval, what it cannot be told apart from, how
well the model predicts records it was fitted to and records it was not, what the residuals say is missing, and the
command that repeats it. Pictures are drawn on light ground; where the reader's system is dark, the page turns them.
"""

from __future__ import annotations

import base64
import html
import io
import shlex
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from mufly.errors import InputError
from mufly.identify import report_pictures as pictures
from mufly.identify.missing import what_is_missing
from mufly.identify.report_page import CSS, number, paragraphs, table
from mufly.identify.residuals import determinant_of_fit, ljung_box, qualities
from mufly.identify.result import Fit, RecordFit

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["Section", "write_report"]

_ENOUGH = 20  # samples, for statistics of residuals


@dataclass(frozen=True)
class Section:
    """Something a command adds to the report.

    Attributes
    ----------
    title : str
    text : tuple of str
        Paragraphs.
    heads : tuple of str
        Of a table; empty for none.
    rows : tuple of tuple of str
    picture : callable, optional
        Draws a figure, or returns None if there is nothing to draw.
    name : str
        Of the picture's file.
    """

    title: str
    text: tuple[str, ...] = ()
    heads: tuple[str, ...] = ()
    rows: tuple[tuple[str, ...], ...] = ()
    picture: Callable[[], Figure | None] | None = None
    name: str = ""


def write_report(
    fit: Fit, directory: str | Path, *, command: str | None = None, sections: Sequence[Section] = (),
    progress: Callable[[int, int], None] | None = None,
) -> Path:  # fmt: skip
    """Write ``report.html`` and its pictures into a folder, which is made if need be.

    Parameters
    ----------
    fit : Fit
    directory : str or Path
    command : str, optional
        What repeats the fit; by default the ``mufly`` command that is running.
    sections : sequence of Section
        Further sections, after the predictions.
    progress : callable, optional
        Called with (pictures drawn, pictures).

    Returns
    -------
    Path
        Of the HTML file.

    Raises
    ------
    InputError
        If the folder cannot be written.
    """
    folder = Path(directory)
    try:
        folder.mkdir(parents=True, exist_ok=True)
        album = _Album(folder, _pictures_of(fit, sections), progress)
        body = _body(fit, album, _command() if command is None else command, sections)
        path = folder / "report.html"
        path.write_text(_page(f"{fit.vehicle}: identification", body), encoding="utf-8")
    except OSError as error:
        raise InputError(
            "report", str(folder), f"cannot be written ({error})", "give another folder"
        ) from error
    return path


class _Album:
    """The pictures of a report: beside the page as PNG, and inside it."""

    def __init__(self, folder: Path, count: int, progress: Callable[[int, int], None] | None) -> None:
        self._folder, self._count, self._progress, self._done = folder, count, progress, 0

    def picture(self, name: str, draw: Callable[[], Figure | None], alt: str) -> str:
        """Draw a picture, write it to the folder and return it as HTML, empty if there is nothing to draw."""
        self._done += 1
        if self._progress is not None:
            self._progress(self._done, max(self._done, self._count))
        with pictures.style():
            figure = draw()
            if figure is None:
                return ""
            buffer = io.BytesIO()
            figure.savefig(buffer, format="png", dpi=130)
        (self._folder / f"{name}.png").write_bytes(buffer.getvalue())
        data = base64.b64encode(buffer.getvalue()).decode("ascii")
        return f'<figure><img src="data:image/png;base64,{data}" alt="{html.escape(alt)}"></figure>'


def _pictures_of(fit: Fit, sections: Sequence[Section]) -> int:
    """Return about how many pictures the report of a fit has, for a progress bar."""
    return 3 + 4 * len(fit.records) + sum(s.picture is not None for s in sections)


def _command() -> str:
    called = Path(sys.argv[0]).name if sys.argv else ""
    return shlex.join(["mufly", *sys.argv[1:]]) if called.startswith("mufly") else ""


def _body(fit: Fit, album: _Album, command: str, sections: Sequence[Section]) -> str:
    parts = [_summary(fit, command), _parameters(fit)]
    if len(fit.estimates) > 1 and np.isfinite(fit.correlation).any():
        parts.append(
            album.picture(
                "correlation", lambda: pictures.correlation_picture(fit), "Correlation of estimates"
            )
        )
    parts.append("<h2>What the data cannot tell apart</h2>")
    parts.append(
        "<ul>" + "".join(f"<li>{html.escape(s)}</li>" for s in fit.unseen) + "</ul>"
        if fit.unseen
        else paragraphs("Nothing stands out: every parameter is determined by these records.")
    )
    if fit.records:
        parts += [
            _sizes(fit),
            album.picture("theil", lambda: pictures.theil_picture(fit.records), "Theil's coefficient"),
        ]
    for k, record in enumerate(fit.records):
        parts.append(_record(record, album, f"{k + 1}-{record.role.replace(' ', '-')}"))
    parts += [_section(s, album) for s in sections]
    if len(fit.history) > 1:
        parts.append("<h2>Convergence</h2>")
        parts.append(album.picture("history", lambda: pictures.history_picture(fit), "Cost and parameters"))
    return "\n".join(parts)


def _summary(fit: Fit, command: str) -> str:
    rows = [
        ("method", fit.method), ("outcome", ("converged; " if fit.converged else "NOT converged; ") + fit.message),
        ("cost", number(fit.cost)), ("simulations", f"{fit.simulations}"), ("time", f"{fit.seconds:.1f} s"),
    ]  # fmt: skip
    out = [f"<h1>{html.escape(fit.vehicle)}</h1>", table(("", ""), rows, head=False)]
    if not fit.converged:
        out.insert(1, '<p class="warn">The search did not converge: intervals do not hold.</p>')
    if command:
        out.append(f"<p>Repeat with</p><pre>{html.escape(command)}</pre>")
    return "\n".join(out)


def _parameters(fit: Fit) -> str:
    rows = []
    for e in fit.estimates:
        relative = abs(e.std / e.value) if e.value != 0.0 else float("inf")
        flag = "at a bound" if e.at_bound else ""
        interval = "–" if e.at_bound else f"{number(e.low)} … {number(e.high)}"
        percent = "–" if e.at_bound or not np.isfinite(relative) else f"{100 * relative:.3g} %"
        if relative > 10.0 and percent != "–":
            percent = "> 1000 %"
        rows.append(
            (
                e.symbol, number(e.start), number(e.value), "–" if e.at_bound else number(e.std), percent,
                interval, e.unit.replace(" ", "\u00a0"), e.key, flag,
            )
        )  # fmt: skip
    heads = ("parameter", "start", "estimate", "std", "rel.", "95 % interval", "unit", "key", "")
    keep = [k for k in range(len(heads)) if k != 7 or any(e.key for e in fit.estimates)]
    kept = [tuple(row[k] for k in keep) for row in rows]
    return "<h2>Parameters</h2>" + table(
        [heads[k] for k in keep], kept, numbers=(1, 2, 3, 4, 5), warn=len(keep) - 1
    )


def _sizes(fit: Fit) -> str:
    rows = []
    for record in fit.records:
        for j, q in enumerate(qualities(record)):
            e = record.residual[:, j]
            enough = int(np.isfinite(e).sum()) >= _ENOUGH
            white = ljung_box(e, lags=min(50, len(e) // 5)).p_value if enough else float("nan")
            rows.append(
                (
                    record.role, record.name, record.outputs[j], f"{q.fit_percent:.1f} %", f"{q.r2:.3f}",
                    f"{q.theil:.3f}", f"{q.bias:.2f} / {q.variance:.2f} / {q.covariance:.2f}",
                    f"{q.rms:.3g} {record.units[j]}", f"{q.rms_over_noise:.2f}",
                    "< 0.001" if white < 1e-3 else f"{white:.2g}",
                )
            )  # fmt: skip
    heads = (
        "role", "record", "output", "fit", "R²", "Theil", "bias / var. / cov.", "rms error", "over noise", "white? p",
    )  # fmt: skip
    text = ["<h2>Prediction from inputs alone</h2>", table(heads, rows, numbers=(3, 4, 5, 6, 7, 8, 9))]
    used, unused = fit.records_of("fit"), fit.records_of("held out")
    same = used and unused and len({r.outputs for r in fit.records}) == 1
    if same:
        ratio = determinant_of_fit(unused) / max(determinant_of_fit(used), 1e-300)
        text.append(
            paragraphs(
                f"Determinant of the residuals' covariance, held out over fitted: {number(ratio)} (1: as good)."
            )
        )
    text.append(
        paragraphs(
            "Fit: 100 % is exact, 0 % is the mean of the record. Over noise: 1 is the measurement's own noise floor. "
            "p below 0.05: the residual is not white, so that plain Cramér-Rao bounds would be too small."
        )
    )
    return "\n".join(text)


def _record(record: RecordFit, album: _Album, name: str) -> str:
    out = [f"<h2>{html.escape(record.name)} <small>({record.role})</small></h2>"]
    out.append(album.picture(f"{name}-prediction", lambda: pictures.prediction_picture(record), "Prediction"))
    if len(record.time_s) < _ENOUGH:
        return "\n".join(out)
    words = what_is_missing(record)
    out.append("<h3>What the residuals say</h3>")
    if words:
        out.append("<ul>" + "".join(f"<li>{html.escape(w)}</li>" for w in words) + "</ul>")
    else:
        out.append(paragraphs("Nothing stands out of the noise."))
    out.append(album.picture(f"{name}-residuals", lambda: pictures.residual_picture(record), "Residuals"))
    if record.input_names:
        out.append(
            album.picture(f"{name}-cross", lambda: pictures.cross_picture(record), "Residuals and inputs")
        )
        out.append(
            album.picture(f"{name}-coherence", lambda: pictures.coherence_picture(record), "Coherence")
        )
    return "\n".join(out)


def _section(section: Section, album: _Album) -> str:
    out = [f"<h2>{html.escape(section.title)}</h2>", *(paragraphs(t) for t in section.text)]
    if section.heads:
        out.append(table(section.heads, section.rows, numbers=tuple(range(1, len(section.heads)))))
    if section.picture is not None:
        out.append(album.picture(section.name or "section", section.picture, section.title))
    return "\n".join(out)


def _page(title: str, body: str) -> str:
    return (
        '<!doctype html>\n<html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        f"<title>{html.escape(title)}</title><style>{CSS}</style></head>\n<body><main>\n{body}\n</main></body></html>\n"
    )
