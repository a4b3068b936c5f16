"""Pages that compare every figure and table with the dissertation: Markdown for the documents, HTML with the
pictures.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Any

from markupsafe import Markup, escape

from mufly.results.report_page import render_report_template
from mufly.thesis.figure_catalogue import OUTLOOK_SENTENCES, THESIS_ITEMS, ThesisItem
from mufly.thesis.study_runner import StudyAnswer

VERDICT_WORDS = ("agrees", "in part", "DIFFERS", "drawn", "needs CFD", "not run", "counterpart")
"""Verdict words in the order in which they are counted."""

_MEANING_BY_VERDICT_WORD = {
    "agrees": "every claim passes its test",
    "in part": "some claims pass",
    "DIFFERS": "no claim passes",
    "drawn": "contours without a claim to test",
    "needs CFD": "its verdict requires a Navier-Stokes solution",
    "not run": "its study has not run",
    "counterpart": "photograph, sketch or block diagram; the line names its counterpart in mufly",
}

_PLURAL_BY_VERDICT_WORD = {
    "agrees": "agree",
    "in part": "agree in part",
    "DIFFERS": "differ",
    "drawn": "are contours, drawn",
    "needs CFD": "need CFD",
    "not run": "have not run",
    "counterpart": "are photographs, sketches or diagrams",
}


def count_verdicts(answers: Sequence[StudyAnswer] | Sequence[Mapping[str, Any]]) -> dict[str, int]:
    """Count the figures and tables by their verdict word, in the order of :data:`VERDICT_WORDS`."""
    count = Counter(str(_answer_as_mapping(a)["word"]) for a in answers)
    return {word: count[word] for word in (*VERDICT_WORDS, *sorted(set(count) - set(VERDICT_WORDS))) if count[word]}


def _answer_as_mapping(answer: StudyAnswer | Mapping[str, Any]) -> Mapping[str, Any]:
    return answer.as_record() if isinstance(answer, StudyAnswer) else answer


def _summarise_verdicts(rows: Sequence[Mapping[str, Any]]) -> str:
    agree, every = sum(int(r["agree"]) for r in rows), sum(len(r["verdicts"]) for r in rows)
    words = "; ".join(f"{n} {_PLURAL_BY_VERDICT_WORD.get(w, w)}" for w, n in count_verdicts(rows).items())
    return f"{len(rows)} figures and tables: {words}. {agree} of {every} single verdicts agree."


def render_markdown_page(answers: Sequence[StudyAnswer] | Sequence[Mapping[str, Any]]) -> str:
    """Return the Markdown page of all figures and tables.

    Parameters
    ----------
    answers : sequence of StudyAnswer, or of the mappings of their ``to_dict``
        One for each item, in any order.
    """
    known = {str(r["name"]): r for r in map(_answer_as_mapping, answers)}
    rows = [known[name] for name in THESIS_ITEMS]
    lines = [
        "# The dissertation, figure by figure",
        "",
        "This page compares every figure and table of D. Schafroth's dissertation with mufly's result.",
        "`python docs/make_thesis_page.py` writes it from the results of `mufly thesis run all`.",
        "`mufly thesis report --out thesis.html` adds the pictures; `mufly thesis show fig-6.11` shows one entry.",
        "Only the text of the dissertation is available. Each claim names its source in parentheses: *text*, printed",
        "*table*, or labels of a figure's *axis*. No curve was digitised, and no parameter is tuned to the claims.",
        "Differences remain, with their reason where it is known ([thesis-errata.md](thesis-errata.md),",
        "[studies.md](../explanation/studies.md)).",
        "",
        _summarise_verdicts(rows),
        "",
        "| word | meaning |",
        "|---|---|",
        *(f"| {word} | {_MEANING_BY_VERDICT_WORD[word]} |" for word in VERDICT_WORDS if word in count_verdicts(rows)),
    ]
    for chapter in sorted({_chapter_number(THESIS_ITEMS[str(r["name"])]) for r in rows}):
        lines += ["", f"## Chapter {chapter}", "", "| | what | verdict | command |", "|---|---|---|---|"]
        for r in rows:
            i = THESIS_ITEMS[str(r["name"])]
            if _chapter_number(i) != chapter:
                continue
            share = f", {r['agree']} of {len(r['verdicts'])}" if r["verdicts"] else ""
            said = r["stands"] if i.kind != "result" else f"**{r['word']}**{share}"
            lines.append(f"| {i.citation} | {i.title} | {_format_cell(str(said))} | `{i.cli_command}` |")
    lines += ["", "## Verdicts", ""]
    for r in rows:
        if r["verdicts"] or r["note"]:
            lines += [f"**{THESIS_ITEMS[str(r['name'])].citation}, {r['title']}**", ""]
            lines += [f"- {_link_documents(str(v))}" for v in r["verdicts"]]
            lines += [f"- {_link_documents(str(r['note']))}"] if r["note"] else []
            lines.append("")
    return "\n".join(lines).rstrip() + "\n"


_OUTLOOK_SECTIONS = {"7.2.1": "Aerodynamics", "7.2.2": "Modelling and control"}


def count_outlook_states() -> dict[str, int]:
    """Count the sentences of the dissertation's outlook by their state: built, in part, open or context."""
    count = Counter(s.state for s in OUTLOOK_SENTENCES)
    return {state: count[state] for state in ("built", "in part", "open", "context")}


def render_outlook_page() -> str:
    """Return the Markdown page of the dissertation's outlook, sentence by sentence."""
    lines = [
        "# The dissertation's outlook, sentence by sentence",
        "",
        "Section 7.2 of D. Schafroth's dissertation lists future work. The table paraphrases each sentence and gives "
        "mufly's answer, as does `mufly thesis outlook`. Sentences marked *context* ask for nothing.",
        "",
        "; ".join(f"{n} {state}" for state, n in count_outlook_states().items()) + ".",
    ]
    for section, title in _OUTLOOK_SECTIONS.items():
        lines += ["", f"## {section} {title}", "", "| | sentence | state | answer | command |", "|---|---|---|---|---|"]
        for s in OUTLOOK_SENTENCES:
            if s.section == section:
                answer = _link_documents(f"{s.answer} ({s.page})")
                commands = "; ".join(f"`{c}`" for c in s.commands)
                lines.append(f"| {s.number} | {s.text} | {s.state} | {answer} | {commands} |")
    return "\n".join(lines) + "\n"


def _chapter_number(i: ThesisItem) -> int:
    return int(i.section.partition(".")[0])


def _format_cell(text: str) -> str:
    return _link_documents(text.replace("|", "/"))


def _link_documents(text: str) -> str:
    """Replace names of documents by links."""
    return re.sub(r"docs/([\w/-]+\.md)", r"[\1](../\1)", text)


_BADGE_CLASSES = {"agrees": "yes", "in part": "part", "DIFFERS": "no"}

_PAGE_BODY_TEMPLATE = """
{% macro word(a) %}
<span class="badge {{ badges.get(a.verdict_word) or "" }}">{{ a.verdict_word }}
{%- if a.agreement_count_text %} ({{ a.agreement_count_text }}){% endif %}</span>
{%- endmacro %}
<p>D. Schafroth, <i>Aerodynamics, Modeling and Control of an Autonomous Micro Helicopter</i>, ETH No. 18901, 2010;
mufly's results beside the printed ones. Each claim names its source: text, printed table, or labels of a figure's axis.
No curve was digitised, and no parameter is tuned to the claims.</p>
<p><b>{{ total }}</b></p>
<table><tr><th></th><th>what</th><th>verdict</th></tr>
{% for a in answers %}
<tr><td class="k"><a href='#{{ a.item.name }}'>{{ a.item.citation }}</a></td><td>{{ a.item.title }}</td>
<td>{% if a.item.kind == "result" %}{{ word(a) }}{% else %}{{ code(a.item.counterpart) }}{% endif %}</td></tr>
{% endfor %}
</table>
{% for a in answers %}
{% set i = a.item %}
{% if loop.changed(chapter(i)) %}<h2>Chapter {{ chapter(i) }}</h2>{% endif %}
<section id='{{ i.name }}'><h3>{{ i.citation }}: {{ i.title }} {{ word(a) }}</h3>
{% if i.kind != "result" %}
<p>A {{ i.kind }}. Counterpart in mufly: {{ code(i.counterpart) }}.</p>
{% else %}
{% if a.picture %}{{ figure(a.picture.read_bytes(), i.title) }}{% endif %}
{% if a.verdicts %}
<ul>
{% for v in a.verdicts %}<li{% if not v.agrees %} class="warn"{% endif %}>{{ v.format_line() }}</li>{% endfor %}
</ul>
{% endif %}
{% if a.note %}<p>{{ code(a.note) }}</p>{% endif %}
<p><code>{{ i.cli_command }}</code>
{%- if a.computing_time_s == a.computing_time_s %} ({{ "%.1f" | format(a.computing_time_s) }} s){% endif %}</p>
{% endif %}
</section>
{% endfor %}
"""


def _render_code_marks(text: str) -> Markup:
    return Markup(re.sub(r"`([^`]+)`", r"<code>\1</code>", str(escape(text))))


def render_html_page(answers: Sequence[StudyAnswer]) -> str:
    """Return an HTML page with all figures and tables, their verdicts, and embedded pictures."""
    known = {a.item.name: a for a in answers}
    every = [known[name] for name in THESIS_ITEMS]
    return render_report_template(
        "The dissertation, figure by figure",
        _PAGE_BODY_TEMPLATE,
        answers=every,
        total=_summarise_verdicts([a.as_record() for a in every]),
        chapter=_chapter_number,
        code=_render_code_marks,
        badges=_BADGE_CLASSES,
    )
