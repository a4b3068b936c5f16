"""Write docs/thesis/thesis-map.md: each equation, table and figure of the dissertation, and its place in mufly.

A docstring that is the home of something says so in a line of its own::

    Thesis: eqs 4.24, 4.26; Fig. 3.7; Table 5.3; Sec. 6.1.6.

Everywhere else an equation is only cited. Run ``python docs/make_thesis_map.py`` after a change; a test compares.
"""

from __future__ import annotations

import ast
import itertools
import re
import sys
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).resolve().parents[1]
PAGE = ROOT / "docs" / "thesis" / "thesis-map.md"
SOURCE = ROOT / "src"

KINDS = {"eq": "Equations", "table": "Tables", "fig": "Figures", "sec": "Sections and appendices"}
_LINE = re.compile(r"^\s*Thesis: (.+?)\.?\s*$", re.M)
_PART = re.compile(r"(eq|fig|table|sec)s?\.? (.+)", re.I)
_CITED = re.compile(r"\beqs?\.? ((?:\d\.\d+(?:, | and | to )?)+)")


class Home(NamedTuple):
    """Something of the dissertation, and the one place that implements it."""

    kind: str
    number: str
    place: str
    what: str


def _numbers(text: str) -> list[str]:
    """Return the numbers of "4.24, 4.26 and 6.11 to 6.13"."""
    found: list[str] = []
    for part in re.split(r", | and ", text):
        first, _, last = part.strip().partition(" to ")
        found.append(first)
        if last:
            chapter, start = first.split(".")
            found += [f"{chapter}.{k}" for k in range(int(start) + 1, int(last.split(".")[1]) + 1)]
    return [n.strip() for n in found if n.strip()]


def _docstrings() -> list[tuple[str, str]]:
    """Return (dotted name, docstring) of every module, class and function."""
    found = []
    for path in sorted(SOURCE.rglob("*.py")):
        module = ".".join(path.relative_to(SOURCE).with_suffix("").parts).removesuffix(".__init__")
        tree = ast.parse(path.read_text(encoding="utf-8"))
        stack: list[tuple[str, ast.AST]] = [(module, tree)]
        while stack:
            name, node = stack.pop()
            text = ast.get_docstring(node)  # type: ignore[arg-type]
            if text:
                found.append((name, text))
            for child in ast.iter_child_nodes(node):
                if isinstance(child, ast.ClassDef | ast.FunctionDef):
                    stack.append((f"{name}.{child.name}", child))
    return sorted(found)


def homes() -> list[Home]:
    """Return what the docstrings call their own, in the dissertation's order."""
    found = []
    for place, text in _docstrings():
        what = " ".join(text.split("\n\n")[0].split()).rstrip(".")
        for line in _LINE.findall(text):
            for part in line.split("; "):
                match = _PART.fullmatch(part.strip())
                if match is None:
                    raise ValueError(f"{place}: {part!r} names nothing; write eq., Fig., Table or Sec. and numbers")
                found += [Home(match[1].lower(), n, place, what) for n in _numbers(match[2])]
    return sorted(found, key=lambda h: (list(KINDS).index(h.kind), [(len(p), p) for p in h.number.split(".")]))


def cited() -> dict[str, set[str]]:
    """Return the equations that docstrings and comments cite by number, and the files that do."""
    found: dict[str, set[str]] = {}
    for path in sorted(SOURCE.rglob("*.py")):
        for match in _CITED.findall(path.read_text(encoding="utf-8")):
            for number in _numbers(match):
                found.setdefault(number, set()).add(path.relative_to(SOURCE / "mufly").as_posix())
    return found


def page() -> str:
    """Return the text of the page."""
    lines = [
        "# The dissertation, and where it stands in the code",
        "",
        "Each equation, table, figure and method of D. Schafroth's dissertation that mufly implements, with its one",
        "home. Made from the docstrings by `python docs/make_thesis_map.py`; where the source contradicts itself,",
        "[thesis-errata.md](thesis-errata.md) says how it is read.",
    ]
    every = homes()
    for kind, title in KINDS.items():
        rows = [h for h in every if h.kind == kind]
        if rows:
            lines += ["", f"## {title}", "", "| no. | home | what |", "|---|---|---|"]
            run = (
                [(h.place, h.number.split(".")[0], int(h.number.split(".")[1]) - k) for k, h in enumerate(rows)]
                if kind != "sec"
                else rows
            )
            for _, group in itertools.groupby(zip(rows, run, strict=True), key=lambda pair: pair[1]):
                same = [h for h, _ in group]
                place = same[0].place
                numbers = same[0].number if len(same) == 1 else f"{same[0].number} to {same[-1].number}"
                lines.append(f"| {numbers} | `{place}` | {same[0].what.replace('|', '/')} |")
    return "\n".join(lines) + "\n"


if __name__ == "__main__":
    PAGE.write_text(page(), encoding="utf-8")
    sys.stdout.write(f"{PAGE.relative_to(ROOT)}: {len(homes())} entries\n")
