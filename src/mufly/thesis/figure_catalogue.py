"""Catalogue of the dissertation's 91 figures and 7 tables, each with its kind and, if it is no result, its counterpart.

:data:`OUTLOOK_SENTENCES` are the sentences of its outlook (Sec. 7.2), each with what came of it.

A photograph, sketch or block diagram cannot agree or differ: its entry names the place of the same thing in this
package. A result has a study (:mod:`mufly.thesis.study_runner`). Titles are paraphrased.
"""

from __future__ import annotations

import tomllib
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from mufly.errors import InputError

ItemKind = Literal["result", "photograph", "sketch", "diagram"]

FIGURE_COUNTS = {1: 3, 2: 12, 3: 45, 4: 5, 5: 6, 6: 20}
"""Chapter -> number of figures."""
TABLE_COUNTS = {3: 4, 5: 3}
"""Chapter -> number of tables."""


@dataclass(frozen=True)
class ThesisItem:
    """Figure or table of the dissertation.

    Attributes
    ----------
    name : str
        ``fig-3.26`` or ``table-3.3``.
    section : str
        Section of the dissertation.
    title : str
    kind : str
    counterpart : str
        Part of mufly that takes the place of a photograph, sketch or diagram; "" for a result.
    """

    name: str
    section: str
    title: str
    kind: ItemKind = "result"
    counterpart: str = ""

    @property
    def citation(self) -> str:
        """Citation: ``Fig. 3.26``, ``Table 3.3``."""
        kind, _, number = self.name.partition("-")
        return f"{'Fig.' if kind == 'fig' else 'Table'} {number}"

    @property
    def cli_command(self) -> str:
        """Command that repeats or shows the figure or table."""
        return f"mufly thesis {'run' if self.kind == 'result' else 'show'} {self.name}"


ITEMS_FILE = Path(__file__).with_name("figures.toml")
THESIS_ITEMS: dict[str, ThesisItem] = {
    name: ThesisItem(name, **row) for name, row in tomllib.loads(ITEMS_FILE.read_text(encoding="utf-8")).items()
}
"""Name -> figure or table, in the order of :data:`ITEMS_FILE`."""


OutlookState = Literal["built", "in part", "open", "context"]


@dataclass(frozen=True)
class OutlookSentence:
    """Sentence of the dissertation's outlook, with mufly's state of the task that it names.

    Attributes
    ----------
    number : int
        Number of the sentence, from 1.
    section : str
        ``7.2.1`` (aerodynamics) or ``7.2.2`` (modelling and control).
    text : str
        The sentence in our words.
    state : str
        ``built``, ``in part``, ``open``, or ``context`` for a sentence that asks for nothing.
    answer : str
        Result of mufly.
    page : str
        Document that holds it.
    commands : tuple of str
        Commands that show it.
    """

    number: int
    section: str
    text: str
    state: OutlookState
    answer: str
    page: str
    commands: tuple[str, ...] = ()


def _read_outlook() -> tuple[OutlookSentence, ...]:
    rows = tomllib.loads(Path(__file__).with_name("outlook.toml").read_text(encoding="utf-8"))["sentence"]
    return tuple(
        OutlookSentence(k, **{**row, "commands": tuple(row.get("commands", ()))}) for k, row in enumerate(rows, 1)
    )


OUTLOOK_SENTENCES: tuple[OutlookSentence, ...] = _read_outlook()
"""Sentences of the outlook in their order."""


def find_item(name: str) -> ThesisItem:
    """Return a figure or table by name; ``3.26`` and ``Fig. 3.26`` are accepted, too.

    Raises
    ------
    InputError
        If there is no such figure or table.
    """
    text = name.strip().lower().replace(" ", "").replace("figure", "fig").replace("fig.", "fig-")
    for known in (text, f"fig-{text}", text.replace("fig", "fig-"), text.replace("table", "table-")):
        if known in THESIS_ITEMS:
            return THESIS_ITEMS[known]
    raise InputError(
        "thesis",
        name,
        "is not a figure or table of the dissertation",
        "use a name of `mufly thesis list`, as fig-3.26",
    )
