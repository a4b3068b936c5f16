"""Live page of a running series: one HTML file, rewritten after every reading, without a server.

The page reloads every two seconds until the series ends. Its loads use only the last zero, without further correction.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

from mufly.bench.series.series_plan import SeriesPlan
from mufly.errors import InputError
from mufly.files.answer_store import replace_file_atomically
from mufly.results.report_page import render_report_template

PAGE_FILE_NAME = "live.html"
_LINE_COLOURS = ("#1b6ca8", "#c4532d", "#3a7d44", "#7b4f9d", "#a8871b", "#2d9ca0", "#b03a6b", "#5b6770")
_PLOT_WIDTH, _PLOT_HEIGHT, _LEFT_MARGIN, _BOTTOM_MARGIN = 460, 260, 58, 34
_PAGE_BODY_TEMPLATE = """
<p><progress value="{{ "%.3f" | format(share) }}"></progress> {{ "%.0f" | format(100 * share) }} % – {{ status }}</p>
<div>
{% for plot in plots %}
<svg width="{{ width }}" height="{{ height }}" font-size="12" role="img" aria-label="{{ plot.title }}">
<text x="{{ left }}" y="16" font-weight="600">{{ plot.title }}</text>
<path d="M{{ left }} 24V{{ low }}H{{ width - 12 }}" fill="none" stroke="#888"/>
<text x="{{ left - 4 }}" y="{{ low }}" text-anchor="end">{{ "%.4g" | format(plot.y[0]) }}</text>
<text x="{{ left - 4 }}" y="34" text-anchor="end">{{ "%.4g" | format(plot.y[1]) }}</text>
<text x="{{ left }}" y="{{ low + 16 }}">{{ "%.4g" | format(plot.x[0]) }}</text>
<text x="{{ width - 12 }}" y="{{ low + 16 }}" text-anchor="end">{{ "%.4g" | format(plot.x[1]) }}</text>
{% for points, line in plot.series %}
{% set colour = colours[loop.index0 % colours | length] %}
{% if line %}
<polyline fill="none" stroke="{{ colour }}"
points="{% for x, y in points %}{{ "%.1f,%.1f " | format(x, y) }}{% endfor %}"/>
{% endif %}
{% for x, y in points %}
<circle cx="{{ "%.1f" | format(x) }}" cy="{{ "%.1f" | format(y) }}" r="3.5" fill="{{ colour }}"/>
{% endfor %}
{% endfor %}
</svg>
{% endfor %}
</div>
<p>
{% for name in names %}
<span class="key" style="color:{{ colours[loop.index0 % colours | length] }}">● {{ name }}</span>&ensp;
{% endfor %}
</p>
<ul>{% for x in events %}<li>{{ x.what }}: {{ x.why | default("") }}</li>{% endfor %}</ul>
"""


def write_live_page(
    folder: Path, plan: SeriesPlan, lines: Sequence[dict[str, Any]], status: str, share: float, *, over: bool
) -> None:
    """Write the page that shows the progress of a series; a browser never reads a half-written page."""
    points = [x for x in lines if x["kind"] == "reading" and x["what"] == "point"]
    zeros = [x for x in lines if x["kind"] == "reading" and x["what"] == "tare"]
    names: dict[str, list[dict[str, Any]]] = {}
    for x in points:
        m = plan.mounting[x["mounting"]]
        names.setdefault(
            f"{m.rotor} {m.pitch_deg:g}° {m.axis}{' (reference)' if m.use == 'reference' else ''}", []
        ).append(x)
    plots = []
    for load, unit, scale in (("thrust", "N", 1.0), ("torque", "mN m", 1e3)):
        series = [
            (
                n,
                [(x["speed_rpm"], scale * x["quick"][load]) for x in some if load in x.get("quick", {})],
                False,
            )
            for n, some in names.items()
        ]
        plots.append(_compute_plot_pixels(f"{load} ({unit}) over speed (rpm)", series))
    start = lines[0]["time"] if lines else 0.0
    for channel in ("thrust_raw", "torque_raw", "thrust", "torque"):
        track = [((x["time"] - start) / 60, x["channels"][channel][0]) for x in zeros if channel in x["channels"]]
        if track:
            plots.append(_compute_plot_pixels(f"zero of {channel} over time (min)", [("", track, True)]))
    events = [x for x in lines if x["kind"] == "event" and x["what"] != "mounted"][-5:]
    text = render_report_template(
        plan.name,
        _PAGE_BODY_TEMPLATE,
        share=share,
        status=status,
        plots=list(filter(None, plots)),
        names=list(names),
        colours=_LINE_COLOURS,
        events=events,
        width=_PLOT_WIDTH,
        height=_PLOT_HEIGHT,
        left=_LEFT_MARGIN,
        low=_PLOT_HEIGHT - _BOTTOM_MARGIN,
        refresh_s=0 if over else 2,
    )
    # A failure to write the page must not stop the bench.
    with suppress(InputError), replace_file_atomically(folder / PAGE_FILE_NAME) as new:
        new.write_text(text, encoding="utf-8")


def _compute_plot_pixels(title: str, series: Sequence[tuple[str, list[tuple[float, float]], bool]]) -> dict[str, Any]:
    """Return a plot's points and lines in pixels, with the limits of its axes; an empty dictionary without points."""
    every = [p for _, some, _ in series for p in some]
    if not every:
        return {}
    x0, x1 = min(p[0] for p in every), max(p[0] for p in every)
    y0, y1 = min(p[1] for p in every), max(p[1] for p in every)
    if all(not line for _, _, line in series):
        x0, y0 = 0.0, min(0.0, y0)
    wide, high = (x1 - x0) or 1.0, (y1 - y0) or 1.0

    def to_pixels(p: tuple[float, float]) -> tuple[float, float]:
        return (
            _LEFT_MARGIN + (_PLOT_WIDTH - _LEFT_MARGIN - 12) * (p[0] - x0) / wide,
            _PLOT_HEIGHT - _BOTTOM_MARGIN - (_PLOT_HEIGHT - _BOTTOM_MARGIN - 30) * (p[1] - y0) / high,
        )

    drawn = [([to_pixels(p) for p in some], line and len(some) > 1) for _, some, line in series]
    return {"title": title, "x": (x0, x1), "y": (y0, y1), "series": drawn}
