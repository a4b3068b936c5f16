"""Docstrings and help texts: their examples run, and the pages that they name exist."""

import doctest
import importlib
import re
from pathlib import Path

import pytest

import mufly

_PACKAGE = Path(mufly.__file__).parent
_PAGES = _PACKAGE.parents[1] / "docs"
_PAGE = re.compile(r"\bdocs/[\w/-]+(?:\.\w+)*\.(?:md|py|json)\b")
_MODULES = [p for p in sorted(_PACKAGE.rglob("*.py")) if ">>> " in p.read_text(encoding="utf-8")]


def _module_name(path: Path) -> str:
    return ".".join(("mufly", *path.relative_to(_PACKAGE).with_suffix("").parts))


@pytest.mark.parametrize("path", _MODULES, ids=_module_name)
def test_examples_give_what_they_show(path):
    assert doctest.testmod(importlib.import_module(_module_name(path))).failed == 0


def test_a_page_is_found_up_to_its_end():
    text = "Keys: docs/reference/bench.md. See `docs/log/2026-11-28-polars.md`, point 3, and docs/make_thesis_page.py."
    assert _PAGE.findall(text) == [
        "docs/reference/bench.md", "docs/log/2026-11-28-polars.md", "docs/make_thesis_page.py",
    ]  # fmt: skip


@pytest.mark.skipif(not _PAGES.is_dir(), reason="no documents beside the package")
def test_pages_named_in_the_package_exist():
    files = [p for p in _PACKAGE.rglob("*") if p.suffix in (".py", ".toml", ".c", ".h", ".js", ".html")]
    named = {(p, page) for p in files for page in _PAGE.findall(p.read_text(encoding="utf-8"))}
    assert len(named) > 50, "pages are found"
    missing = [f"{p.relative_to(_PACKAGE)}: {page}" for p, page in named if not (_PAGES.parent / page).is_file()]
    assert missing == []
