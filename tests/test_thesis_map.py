"""Each equation of the dissertation that the code cites has one home, and the page of them is up to date."""

import collections
import importlib.util
from pathlib import Path

SCRIPT = Path(__file__).parents[1] / "docs" / "make_thesis_map.py"
spec = importlib.util.spec_from_file_location("make_thesis_map", SCRIPT)
thesis_map = importlib.util.module_from_spec(spec)
spec.loader.exec_module(thesis_map)

# Numbers of equations in other books, cited beside their titles.
ELSEWHERE = {"1.4": "Ljung", "2.99": "Leishman", "7.46": "Tischler and Remple", "9.90": "Tischler and Remple"}


def test_the_page_is_what_the_docstrings_say():
    assert thesis_map.PAGE.read_text(encoding="utf-8") == thesis_map.page(), "run python docs/make_thesis_map.py"


def test_everything_has_one_home():
    count = collections.Counter((h.kind, h.number) for h in thesis_map.homes())
    assert {what: n for what, n in count.items() if n > 1} == {}


def test_every_cited_equation_has_a_home():
    at_home = {h.number for h in thesis_map.homes() if h.kind == "eq"}
    lost = {n: files for n, files in thesis_map.cited().items() if n not in at_home and n not in ELSEWHERE}
    assert lost == {}


def test_ranges_are_read():
    assert thesis_map._numbers("6.11 to 6.13, 4.2 and 5.1") == ["6.11", "6.12", "6.13", "4.2", "5.1"]
