"""Write the tables of ``docs/accuracy.md`` and ``README.md`` from ``docs/figures.json``.

``python docs/write_figures.py`` renews each table that stands between ``<!-- figures: A; B -->`` (in the README
``<!-- accuracy -->``) and the next comment that begins with ``end``. Both files are read on a repository's page, which
has no build. Other pages take single values by ``{{ key }}`` when the site is built (``conf.py``). A script of
``benchmarks`` that is called with ``--record`` renews the file of figures.
"""

from __future__ import annotations

import re
import sys
from pathlib import Path
from typing import Any

HERE = Path(__file__).resolve().parent
sys.path.insert(0, str(HERE.parent / "benchmarks"))

from figure_record import find_missed, print_numbers, read_figures  # noqa: E402  (from the folder named above)

PAGES = (HERE / "accuracy.md", HERE.parent / "README.md")

_MARKED = re.compile(r"(<!-- (figures: [^>]*|accuracy) -->\n).*?(<!-- end )", re.DOTALL)


def table_lines(head: list[str], rows: list[list[str]]) -> str:
    """Return a Markdown table."""
    lines = [head, ["---"] * len(head), *rows]
    return "".join("|" + "|".join(cells) + "|\n" for cells in lines)


def accuracy_table(rows: list[dict[str, Any]]) -> str:
    """Return the table of some rows for the page: one line a figure, below the name of its subsystem.

    A command that repeats the line above is printed as a ditto mark. The page states that ``python`` runs scripts.
    """
    cells: list[list[str]] = []
    subsystem = command = ""
    for row in rows:
        if row["subsystem"] != subsystem:
            subsystem, command = row["subsystem"], ""
            cells.append([f"**{subsystem}**", "", "", "", ""])
        told = "″" if row["command"] == command else f"`{row['command'].removeprefix('python ')}`"
        command = row["command"]
        cells.append([row["quantity"], row["data"], value_text(row), row["target"], told])
    return table_lines(["quantity", "data", "measured", "target", "command"], cells)


def value_text(row: dict[str, Any]) -> str:
    """Return the value of a figure, numbers that miss the target in bold."""
    numbers = zip(print_numbers(row), find_missed(row), strict=True)
    return str(row["form"]).format(*(f"**{n}**" if missed else n for n, missed in numbers))


def target_text(row: dict[str, Any]) -> str:
    """Return the target of a figure, and whether it is missed."""
    return f"{row['target']}: missed" if row["status"] == "missed" else str(row["target"])


def readme_table(rows: list[dict[str, Any]]) -> str:
    """Return the short table of the rows that have a text for the README."""
    chosen = [[row["readme"], value_text(row), target_text(row) or "none"] for row in rows if "readme" in row]
    return table_lines(["quantity", "measured", "target"], chosen)


def fill_page(text: str, rows: list[dict[str, Any]]) -> str:
    """Return a page with its marked tables renewed.

    Raises
    ------
    ValueError
        If a marker names a subsystem that no figure has.
    """

    def renewed(found: re.Match[str]) -> str:
        if found[2] == "accuracy":
            return found[1] + readme_table(rows) + found[3]
        names = found[2].removeprefix("figures: ").split("; ")
        unknown = set(names) - {row["subsystem"] for row in rows}
        if unknown:
            raise ValueError(f"figures.json: no figure of the subsystem {', '.join(sorted(unknown))}")
        return found[1] + accuracy_table([row for row in rows if row["subsystem"] in names]) + found[3]

    return _MARKED.sub(renewed, text)


def main() -> None:
    rows = read_figures()
    for page in PAGES:
        page.write_text(fill_page(page.read_text(encoding="utf-8"), rows), encoding="utf-8")


if __name__ == "__main__":
    main()
