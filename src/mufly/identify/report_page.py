"""The parts of an HTML page that reports share: style sheet, tables, numbers."""

from __future__ import annotations

import html
from collections.abc import Sequence

import numpy as np

__all__ = ["CSS", "number", "paragraphs", "table"]

CSS = """
:root { color-scheme: light dark; --ink: #1d2329; --soft: #5b6570; --ground: #ffffff; --line: #d5dae0;
  --card: #f4f6f8; --accent: #0072b2; --warn: #b04a00; }
@media (prefers-color-scheme: dark) { :root { --ink: #d8dee6; --soft: #97a3af; --ground: #14181d; --line: #333b44;
  --card: #1b2127; --accent: #56b4e9; --warn: #e69f00; }
  img { filter: invert(.92) hue-rotate(180deg); } }
* { box-sizing: border-box; }
body { margin: 0; background: var(--ground); color: var(--ink);
  font: 15px/1.55 system-ui, -apple-system, "Segoe UI", Roboto, "Helvetica Neue", Arial, sans-serif; }
main { max-width: 68rem; margin: 0 auto; padding: 2rem 1.2rem 4rem; }
h1 { font-size: 1.6rem; margin: 0 0 1rem; }
h2 { font-size: 1.15rem; margin: 2.4rem 0 .6rem; padding-top: .8rem; border-top: 1px solid var(--line); }
h2 small { color: var(--soft); font-weight: normal; }
h3 { font-size: 1rem; margin: 1.4rem 0 .3rem; }
p, ul { margin: .5rem 0; max-width: 46rem; }
li { margin: .25rem 0; }
.scroll { overflow-x: auto; }
table { border-collapse: collapse; font-size: .86rem; font-variant-numeric: tabular-nums; margin: .4rem 0; }
th { text-align: left; color: var(--soft); font-weight: 600; border-bottom: 1px solid var(--line); }
th, td { padding: .22rem .8rem .22rem 0; vertical-align: top; }
td.n, th.n { text-align: right; white-space: nowrap; }
td { border-bottom: 1px solid color-mix(in srgb, var(--line) 55%, transparent); }
td.k { color: var(--soft); white-space: nowrap; }
.warn { color: var(--warn); font-weight: 600; }
pre { background: var(--card); border: 1px solid var(--line); border-radius: 6px; padding: .7rem .9rem;
  overflow-x: auto; font-size: .85rem; white-space: pre-wrap; }
figure { margin: .8rem 0; }
img { max-width: 100%; height: auto; display: block; }
@media print { body { font-size: 10pt; } h2 { break-after: avoid; } figure, tr { break-inside: avoid; } }
"""


def number(value: float) -> str:
    """Return a number with four digits, as short as it can be written; ``–`` if it is not finite."""
    if not np.isfinite(value):
        return "–"
    if abs(value) < 1e-9:
        return "0"
    text = f"{value:.4g}"
    if "e" in text:
        digits, power = text.split("e")
        return f"{digits}·10^{int(power)}"
    return text


def paragraphs(*texts: str) -> str:
    """Return texts as paragraphs."""
    return "".join(f"<p>{html.escape(t)}</p>" for t in texts)


def table(
    heads: Sequence[str], rows: Sequence[Sequence[str]], *, numbers: Sequence[int] = (), head: bool = True,
    warn: int | None = None,
) -> str:  # fmt: skip
    """Return a table; ``numbers`` are the columns aligned to the right, ``warn`` the column of warnings."""

    def cell(k: int, text: str, tag: str) -> str:
        kind = ' class="n"' if k in numbers else ' class="k"' if not head and k == 0 else ""
        kind = ' class="warn"' if tag == "td" and k == warn else kind
        return f"<{tag}{kind}>{html.escape(str(text))}</{tag}>"

    top = f"<tr>{''.join(cell(k, t, 'th') for k, t in enumerate(heads))}</tr>" if head else ""
    body = "".join(f"<tr>{''.join(cell(k, t, 'td') for k, t in enumerate(row))}</tr>" for row in rows)
    return f'<div class="scroll"><table>{top}{body}</table></div>'
