"""Write docs/thesis/thesis.md, all figures and tables of the dissertation, from the answers in thesis.json, and
outlook.md, the sentences of its outlook.

    python docs/make_thesis_page.py               # what has not run, or has changed, is computed first: minutes
    python docs/make_thesis_page.py --as-kept     # only the page, from docs/thesis/thesis.json as it is

docs/thesis/thesis.json holds what the studies found, so that a test can see whether the page is that of these answers,
and whether there is an answer to every study, without computing the long ones.
"""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path
from typing import Any

from mufly.thesis import (
    THESIS_ITEMS,
    count_verdicts,
    list_studies_by_cost,
    load_cached_answer,
    load_or_run_study,
    render_markdown_page,
    render_outlook_page,
)

PAGE = Path(__file__).parent / "thesis" / "thesis.md"
OUTLOOK = Path(__file__).parent / "thesis" / "outlook.md"
KEPT = Path(__file__).parent / "thesis" / "thesis.json"
_LEFT_OUT = ("picture", "seconds")  # of this machine, not of the studies


def kept() -> list[dict[str, Any]]:
    """Return the answers that the page is made of."""
    return json.loads(KEPT.read_text(encoding="utf-8"))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--as-kept", action="store_true")
    if not parser.parse_args().as_kept:
        for name in list_studies_by_cost():
            sys.stderr.write(f"{load_or_run_study(name).item.name}\n")
        rows = [load_cached_answer(name).as_record() for name in THESIS_ITEMS]
        plain = [{k: v for k, v in row.items() if k not in _LEFT_OUT} for row in rows]
        KEPT.write_text(json.dumps(plain, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")
    PAGE.write_text(render_markdown_page(kept()), encoding="utf-8")
    OUTLOOK.write_text(render_outlook_page(), encoding="utf-8")
    sys.stdout.write(f"{PAGE.name}: {count_verdicts(kept())}\n")


if __name__ == "__main__":
    main()
