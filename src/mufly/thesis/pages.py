"""All answers on one page: Markdown for the documents, and HTML with the pictures in it, for a browser alone."""

from __future__ import annotations

import base64
import html
import math
import re
from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Any

from mufly.thesis.catalogue import ITEMS, Item
from mufly.thesis.outcomes import Answer

WORDS = ("agrees", "in part", "DIFFERS", "drawn", "needs CFD", "not run", "stands for it")
"""Verdict words in the order in which they are counted."""

_MEANING = {
    "agrees": "every claim holds by its rule",
    "in part": "some do",
    "DIFFERS": "none does",
    "drawn": "contours only, nothing to judge",
    "needs CFD": "a Navier-Stokes solution is needed for its verdict",
    "not run": "its study has not run yet",
    "stands for it": "photograph, sketch or block diagram: the line says where mufly has the same",
}

_COUNTED = {
    "agrees": "agree",
    "in part": "agree in part",
    "DIFFERS": "differ",
    "drawn": "are contours, drawn",
    "needs CFD": "need CFD",
    "not run": "have not run",
    "stands for it": "are photographs, sketches or diagrams",
}


def totals(answers: Sequence[Answer] | Sequence[Mapping[str, Any]]) -> dict[str, int]:
    """Count the figures and tables by their verdict word, in the order of :data:`WORDS`."""
    count = Counter(str(_plain(a)["word"]) for a in answers)
    return {word: count[word] for word in (*WORDS, *sorted(set(count) - set(WORDS))) if count[word]}


def _plain(answer: Answer | Mapping[str, Any]) -> Mapping[str, Any]:
    return answer.to_dict() if isinstance(answer, Answer) else answer


def _sum_of(rows: Sequence[Mapping[str, Any]]) -> str:
    agree, every = sum(int(r["agree"]) for r in rows), sum(len(r["verdicts"]) for r in rows)
    words = "; ".join(f"{n} {_COUNTED.get(w, w)}" for w, n in totals(rows).items())
    return f"{len(rows)} figures and tables: {words}. {agree} of {every} single verdicts agree."


def table_page(answers: Sequence[Answer] | Sequence[Mapping[str, Any]]) -> str:
    """Return the Markdown page of all figures and tables.

    Parameters
    ----------
    answers : sequence of Answer, or of what their ``to_dict`` returns
        One for each item, in any order.
    """
    known = {str(r["name"]): r for r in map(_plain, answers)}
    rows = [known[name] for name in ITEMS]
    lines = [
        "# The dissertation, figure by figure",
        "",
        "Every figure and table of D. Schafroth's dissertation, and what mufly says to it. Made by",
        "`python docs/make_thesis_page.py` from what `mufly thesis run all` computed. `mufly thesis report --out",
        "thesis.html` puts the pictures with it, `mufly thesis show fig-6.11` one of them. Only the text of the",
        "dissertation is at hand: a claim says after its place whether it was read in the *text*, in a printed",
        "*table*, or from the texts of a figure's *axis*; no curve was digitised, and nothing is tuned to any of it.",
        "Where ours differs it stays so, with the reason as far as it is known ([thesis-errata.md](thesis-errata.md),",
        "[studies.md](studies.md)).",
        "",
        _sum_of(rows),
        "",
        "| word | meaning |",
        "|---|---|",
        *(f"| {word} | {_MEANING[word]} |" for word in WORDS if word in totals(rows)),
    ]
    for chapter in sorted({_chapter(ITEMS[str(r["name"])]) for r in rows}):
        lines += ["", f"## Chapter {chapter}", "", "| | what | verdict | command |", "|---|---|---|---|"]
        for r in rows:
            i = ITEMS[str(r["name"])]
            if _chapter(i) != chapter:
                continue
            share = f", {r['agree']} of {len(r['verdicts'])}" if r["verdicts"] else ""
            said = r["stands"] if i.kind != "result" else f"**{r['word']}**{share}"
            lines.append(f"| {i.where} | {i.title} | {_cell(str(said))} | `{i.command}` |")
    lines += ["", "## Verdicts", ""]
    for r in rows:
        if r["verdicts"] or r["note"]:
            lines += [f"**{ITEMS[str(r['name'])].where}, {r['title']}**", ""]
            lines += [f"- {_linked(str(v))}" for v in r["verdicts"]]
            lines += [f"- {_linked(str(r['note']))}"] if r["note"] else []
            lines.append("")
    return "\n".join(lines).rstrip() + "\n"


def _chapter(i: Item) -> int:
    return int(i.section.partition(".")[0])


def _cell(text: str) -> str:
    return _linked(text.replace("|", "/"))


def _linked(text: str) -> str:
    """Name documents as links of the page."""
    return re.sub(r"docs/([\w-]+\.md)", r"[\1](\1)", text)


_STYLE = """
body { font: 15px/1.45 system-ui, sans-serif; margin: 0 auto; max-width: 62rem; padding: 1rem; color: #1c2430; }
table { border-collapse: collapse; width: 100%; } td, th { border-bottom: 1px solid #d8dde5; padding: .25rem .5rem;
text-align: left; vertical-align: top; }
td:first-child { white-space: nowrap; } h2 { margin-top: 2.5rem; border-bottom: 2px solid #1c2430; }
section { margin: 1.5rem 0; padding-top: .5rem; border-top: 1px solid #d8dde5; } img { max-width: 100%; height: auto; }
.w { font-weight: 600; padding: .05rem .4rem; border-radius: .3rem; background: #e7eaef; white-space: nowrap; }
.agrees { background: #cfeed8; } .inpart { background: #fdf0c4; } .differs { background: #f9d3cc; }
.no { color: #9c2b16; } code { background: #f1f3f6; padding: 0 .2rem; } li { margin: .3rem 0; }
@media (prefers-color-scheme: dark) { body { background: #14181f; color: #dfe4ec; } img { background: #fff; }
td, th, section { border-color: #394250; } h2 { border-color: #dfe4ec; } .w { background: #39424f; color: #fff; }
.agrees { background: #1f5c36; } .inpart { background: #6b5513; } .differs { background: #7c2a1c; }
.no { color: #ff9d8a; } code { background: #232a34; } a { color: #8ab8ff; } }
"""
_CLASS = {"agrees": "agrees", "in part": "inpart", "DIFFERS": "differs"}


def _code(text: str) -> str:
    return re.sub(r"`([^`]+)`", r"<code>\1</code>", html.escape(text))


def report(answers: Sequence[Answer]) -> str:
    """Return a page of HTML with a table of all figures and tables, their verdicts and, embedded, our pictures."""
    known = {a.item.name: a for a in answers}
    every = [known[name] for name in ITEMS]
    total = _sum_of([a.to_dict() for a in every])
    parts = [
        "<!doctype html><html lang='en'><head><meta charset='utf-8'><title>The dissertation, figure by figure</title>",
        "<meta name='viewport' content='width=device-width, initial-scale=1'>",
        f"<style>{_STYLE}</style></head><body><h1>The dissertation, figure by figure</h1>",
        "<p>D. Schafroth, <i>Aerodynamics, Modeling and Control of an Autonomous Micro Helicopter</i>, ETH No. 18901, "
        "2010; ours beside what is printed. A claim says whether it was read in the text, in a printed table or from "
        "the texts of a figure's axis; no curve was digitised, and nothing is tuned to any of it.</p>",
        f"<p><b>{html.escape(total)}</b></p><table><tr><th></th><th>what</th><th>verdict</th></tr>",
    ]
    for a in every:
        i = a.item
        said = _word(a) if i.kind == "result" else _code(i.stands)
        parts.append(
            f"<tr><td><a href='#{i.name}'>{i.where}</a></td><td>{html.escape(i.title)}</td><td>{said}</td></tr>"
        )
    parts.append("</table>")
    chapter = 0
    for a in every:
        i = a.item
        if _chapter(i) != chapter:
            chapter = _chapter(i)
            parts.append(f"<h2>Chapter {chapter}</h2>")
        parts.append(f"<section id='{i.name}'><h3>{i.where}: {html.escape(i.title)} {_word(a)}</h3>")
        if i.kind != "result":
            parts.append(f"<p>A {i.kind}. For it stands: {_code(i.stands)}.</p></section>")
            continue
        if a.picture is not None:
            data = base64.b64encode(a.picture.read_bytes()).decode("ascii")
            parts.append(f"<img alt='{html.escape(i.title)}' src='data:image/png;base64,{data}'>")
        lines = "".join(
            f"<li{'' if v.agrees else ' class=no'}>{html.escape(v.line())}</li>" for v in a.verdicts
        )
        parts.append(f"<ul>{lines}</ul>" if lines else "")
        parts.append(f"<p>{_code(a.note)}</p>" if a.note else "")
        took = "" if math.isnan(a.seconds) else f" ({a.seconds:.1f} s)"
        parts.append(f"<p><code>{i.command}</code>{took}</p></section>")
    return "\n".join(p for p in parts if p) + "\n</body></html>\n"


def _word(a: Answer) -> str:
    share = f" ({a.share})" if a.share else ""
    return f"<span class='w {_CLASS.get(a.word, '')}'>{html.escape(a.word + share)}</span>"
