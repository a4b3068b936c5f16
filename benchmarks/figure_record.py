"""Write measured figures to ``docs/figures.json``, from which the documents take every accuracy that they state.

    python benchmarks/validate_rotors.py PART --record   # a script of this folder writes its figures
    python benchmarks/figure_record.py scores FOLDER     # those of `mufly rotor benchmark --held-out --out FOLDER`

A row of the file has a ``key``. Written by hand are

- ``subsystem``, ``quantity``, ``data`` and ``command``;
- ``form``, the text around the numbers, and ``digits``, their decimals (one count, or one each; ``null`` prints all);
- ``target``, as a text, and ``limits``, least and greatest (``null`` where there is none; one pair, or one each).

A record replaces ``numbers`` and what follows from them: ``value`` (the text to print), ``status`` (``met`` or
``missed`` by the limits; ``measured`` where there are none), ``date`` and ``commit``. ``python docs/write_figures.py``
then brings the tables of the documents up to date.
"""

from __future__ import annotations

import argparse
import csv
import datetime
import json
import subprocess
from collections.abc import Callable
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
FIGURES = ROOT / "docs" / "figures.json"
RECORD_HELP = "write the figures to docs/figures.json"


def read_figures(path: Path = FIGURES) -> list[dict[str, Any]]:
    """Rows of the file, in its order."""
    rows: list[dict[str, Any]] = json.loads(path.read_text(encoding="utf-8"))
    return rows


def write_figures(rows: list[dict[str, Any]], path: Path = FIGURES) -> None:
    """Write rows, a line each, so that a change of one is a change of one line."""
    lines = ",\n".join(json.dumps(row, ensure_ascii=False) for row in rows)
    path.write_text(f"[\n{lines}\n]\n", encoding="utf-8")


def make_recorder(asked: bool) -> Callable[..., None]:
    """Return :func:`record_figure`, or a function that does nothing if no record is asked for."""
    return record_figure if asked else lambda key, *numbers: None


def take_record_option(words: list[str]) -> Callable[..., None]:
    """Take ``--record`` out of a script's arguments, and return its recorder."""
    asked = "--record" in words
    if asked:
        words.remove("--record")
    return make_recorder(asked)


def decimals_of(row: dict[str, Any]) -> list[int | None]:
    """Decimals of each number of a row; None prints all that it has."""
    digits = row["digits"]
    return digits if isinstance(digits, list) else [digits] * len(row["numbers"])


def print_numbers(row: dict[str, Any]) -> list[str]:
    """Return each number of a row with its decimals."""
    pairs = zip(row["numbers"], decimals_of(row), strict=True)
    return [f"{x:g}".replace("e-0", "e-") if n is None else f"{x:.{n}f}" for x, n in pairs]


def format_value(row: dict[str, Any]) -> str:
    """Return the numbers of a row with their unit, ready to print."""
    return str(row["form"]).format(*print_numbers(row))


def find_missed(row: dict[str, Any]) -> list[bool]:
    """Return which numbers of a row miss its limits.

    A number counts as it is printed: 6.04 % meets "at most 6 %" in a row of one digit.
    """
    limits = row.get("limits") or [None, None]
    pairs = limits if isinstance(limits[0], list) else [limits] * len(row["numbers"])
    return [
        (low is not None and x < low) or (high is not None and x > high)
        for x, (low, high) in zip(row["numbers"], pairs, strict=True)
    ]


def judge_status(row: dict[str, Any]) -> str:
    """Return ``met`` or ``missed``; ``measured`` for a row without limits."""
    return ("missed" if any(find_missed(row)) else "met") if row.get("limits") else "measured"


def record_figure(key: str, *numbers: float, path: Path = FIGURES) -> None:
    """Replace the numbers of a figure, rounded as they are printed.

    Parameters
    ----------
    key : str
        Of its row in the file.
    *numbers : float
        As many as the row has, in the unit of its ``form``.

    Raises
    ------
    KeyError
        If the file has no row of this key.
    ValueError
        If the row has another count of numbers.
    """
    rows = read_figures(path)
    row = next((r for r in rows if r["key"] == key), None)
    if row is None:
        raise KeyError(f"{path.name}: no row of key {key!r}; add one with its form, data and command")
    if len(numbers) != len(row["numbers"]):
        raise ValueError(f"{path.name}: {key}: {len(numbers)} numbers for a row of {len(row['numbers'])}")
    row["numbers"] = [
        float(x) if n is None else round(float(x), n) for x, n in zip(numbers, decimals_of(row), strict=True)
    ]
    row["value"], row["status"] = format_value(row), judge_status(row)
    row["date"], row["commit"] = datetime.date.today().isoformat(), _commit()
    write_figures(rows, path)
    print(f"recorded {key}: {row['value']} ({row['status']})")


def _commit() -> str:
    """Short hash of the checked-out commit; empty outside a repository."""
    words = ["git", "-C", str(ROOT), "rev-parse", "--short", "HEAD"]
    try:
        ran = subprocess.run(words, capture_output=True, text=True, check=False)
    except OSError:
        return ""
    return ran.stdout.strip() if ran.returncode == 0 else ""


def record_scores(folder: Path) -> None:
    """Record the 17 propellers' scores that `mufly rotor benchmark --held-out --out FOLDER` wrote to ``scores.csv``."""
    with (folder / "scores.csv").open(encoding="utf-8", newline="") as file:
        scores = {row["code"]: row for row in csv.DictReader(file) if row["group"] == "UIUC micro"}
    for code, key in (
        ("bemt", "bemt_uiuc"),
        ("bemt, 1 point seen", "bemt_one_point"),
        ("bemt, half seen", "bemt_half"),
    ):
        record_figure(key, 100 * float(scores[code]["thrust_error"]), 100 * float(scores[code]["torque_error"]))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", choices=("scores",))
    parser.add_argument("folder", type=Path)
    record_scores(parser.parse_args().folder)


if __name__ == "__main__":
    main()
