"""All answers on one page: Markdown for the documents, and HTML with the pictures in it, for a browser alone."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Any

from markupsafe import Markup, escape

from mufly.report_page import render_page
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


_BADGES = {"agrees": "yes", "in part": "part", "DIFFERS": "no"}

_BODY = """
{% macro word(a) %}
<span class="badge {{ badges.get(a.word) or "" }}">{{ a.word }}{% if a.share %} ({{ a.share }}){% endif %}</span>
{%- endmacro %}
<p>D. Schafroth, <i>Aerodynamics, Modeling and Control of an Autonomous Micro Helicopter</i>, ETH No. 18901, 2010; ours
beside what is printed. A claim says whether it was read in the text, in a printed table or from the texts of a
figure's axis; no curve was digitised, and nothing is tuned to any of it.</p>
<p><b>{{ total }}</b></p>
<table><tr><th></th><th>what</th><th>verdict</th></tr>
{% for a in answers %}
<tr><td class="k"><a href='#{{ a.item.name }}'>{{ a.item.where }}</a></td><td>{{ a.item.title }}</td>
<td>{% if a.item.kind == "result" %}{{ word(a) }}{% else %}{{ code(a.item.stands) }}{% endif %}</td></tr>
{% endfor %}
</table>
{% for a in answers %}
{% set i = a.item %}
{% if loop.changed(chapter(i)) %}<h2>Chapter {{ chapter(i) }}</h2>{% endif %}
<section id='{{ i.name }}'><h3>{{ i.where }}: {{ i.title }} {{ word(a) }}</h3>
{% if i.kind != "result" %}
<p>A {{ i.kind }}. For it stands: {{ code(i.stands) }}.</p>
{% else %}
{% if a.picture %}{{ figure(a.picture.read_bytes(), i.title) }}{% endif %}
{% if a.verdicts %}
<ul>{% for v in a.verdicts %}<li{% if not v.agrees %} class="warn"{% endif %}>{{ v.line() }}</li>{% endfor %}</ul>
{% endif %}
{% if a.note %}<p>{{ code(a.note) }}</p>{% endif %}
<p><code>{{ i.command }}</code>{% if a.seconds == a.seconds %} ({{ "%.1f" | format(a.seconds) }} s){% endif %}</p>
{% endif %}
</section>
{% endfor %}
"""


def _code(text: str) -> Markup:
    return Markup(re.sub(r"`([^`]+)`", r"<code>\1</code>", str(escape(text))))


def report(answers: Sequence[Answer]) -> str:
    """Return a page of HTML with a table of all figures and tables, their verdicts and, embedded, our pictures."""
    known = {a.item.name: a for a in answers}
    every = [known[name] for name in ITEMS]
    return render_page(
        "The dissertation, figure by figure", _BODY, answers=every, total=_sum_of([a.to_dict() for a in every]),
        chapter=_chapter, code=_code, badges=_BADGES,
    )  # fmt: skip
