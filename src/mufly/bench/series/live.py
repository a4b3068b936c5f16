"""A page that shows a series while it is measured: one HTML file, drawn anew after every reading, no server needed.

It reloads itself every two seconds; when the series has ended it stops doing so. Loads are the quick look of the last
zero, without any correction.
"""

from __future__ import annotations

import html
import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from mufly.bench.series.plan import Plan

NAME = "live.html"
_COLOURS = ("#1b6ca8", "#c4532d", "#3a7d44", "#7b4f9d", "#a8871b", "#2d9ca0", "#b03a6b", "#5b6770")
_WIDTH, _HEIGHT, _LEFT, _LOW = 460, 260, 58, 34


def write_page(
    folder: Path, plan: Plan, lines: Sequence[dict[str, Any]], status: str, share: float, *, over: bool
) -> None:
    """Write the page, whole or not at all."""
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
        plots.append(_plot(f"{load} ({unit}) over speed (rpm)", series))
    start = lines[0]["time"] if lines else 0.0
    for channel in ("thrust_raw", "torque_raw", "thrust", "torque"):
        track = [
            ((x["time"] - start) / 60, x["channels"][channel][0]) for x in zeros if channel in x["channels"]
        ]
        if track:
            plots.append(_plot(f"zero of {channel} over time (min)", [("", track, True)]))
    legend = " ".join(
        f'<span style="color:{_COLOURS[k % len(_COLOURS)]}">&#9679; {html.escape(n)}</span>'
        for k, n in enumerate(names)
    )
    events = [x for x in lines if x["kind"] == "event" and x["what"] != "mounted"][-5:]
    told = "".join(f"<li>{html.escape(x['what'])}: {html.escape(str(x.get('why', '')))}</li>" for x in events)
    text = f"""<!doctype html><html lang="en"><head><meta charset="utf-8">
{"" if over else '<meta http-equiv="refresh" content="2">'}<title>{html.escape(plan.name)}</title>
<style>body{{font:15px system-ui,sans-serif;margin:1.5em;color:#222}}svg{{margin:0 1em 1em 0}}
progress{{width:30em}}span{{margin-right:1em}}</style></head><body>
<h1>{html.escape(plan.name)}</h1>
<p><progress value="{share:.3f}"></progress> {100 * share:.0f} % &ndash; {html.escape(status)}</p>
<div>{"".join(plots)}</div><p>{legend}</p><ul>{told}</ul></body></html>"""
    path = folder / NAME
    new = path.with_suffix(".new")
    try:
        new.write_text(text, encoding="utf-8")
        os.replace(new, path)
    except OSError:
        # A page that cannot be drawn is no reason to stop a bench.
        return


def _plot(title: str, series: Sequence[tuple[str, list[tuple[float, float]], bool]]) -> str:
    """Draw points, or a line, in a frame with the ends of its axes."""
    every = [p for _, some, _ in series for p in some]
    if not every:
        return ""
    x0, x1 = min(p[0] for p in every), max(p[0] for p in every)
    y0, y1 = min(p[1] for p in every), max(p[1] for p in every)
    if all(not line for _, _, line in series):
        x0, y0 = 0.0, min(0.0, y0)
    wide, high = (x1 - x0) or 1.0, (y1 - y0) or 1.0

    def at(p: tuple[float, float]) -> tuple[float, float]:
        return (
            _LEFT + (_WIDTH - _LEFT - 12) * (p[0] - x0) / wide,
            _HEIGHT - _LOW - (_HEIGHT - _LOW - 30) * (p[1] - y0) / high,
        )

    drawn = []
    for k, (_, some, line) in enumerate(series):
        colour = _COLOURS[k % len(_COLOURS)]
        if line and len(some) > 1:
            path = " ".join(f"{x:.1f},{y:.1f}" for x, y in map(at, some))
            drawn.append(f'<polyline points="{path}" fill="none" stroke="{colour}"/>')
        drawn += [f'<circle cx="{x:.1f}" cy="{y:.1f}" r="3.5" fill="{colour}"/>' for x, y in map(at, some)]
    low, right, foot = _HEIGHT - _LOW, _WIDTH - 12, _HEIGHT - _LOW + 16
    return f"""<svg width="{_WIDTH}" height="{_HEIGHT}" font-size="12" role="img" aria-label="{html.escape(title)}">
<text x="{_LEFT}" y="16" font-weight="600">{html.escape(title)}</text>
<path d="M{_LEFT} 24V{low}H{right}" fill="none" stroke="#888"/>
<text x="{_LEFT - 4}" y="{low}" text-anchor="end">{y0:.4g}</text>
<text x="{_LEFT - 4}" y="34" text-anchor="end">{y1:.4g}</text>
<text x="{_LEFT}" y="{foot}">{x0:.4g}</text><text x="{right}" y="{foot}"
text-anchor="end">{x1:.4g}</text>{"".join(drawn)}</svg>"""
