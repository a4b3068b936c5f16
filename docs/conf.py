"""The documents as a site: ``pip install '.[docs]' && sphinx-build -W docs site``. Built offline; nothing is fetched.

Sphinx with MyST and Furo: pages stay the Markdown that they are in the repository, the reference comes from docstrings,
help texts and schemas (``make_reference.py``), and the lessons are Python files (``learn/``), run as they are built.
"""

from __future__ import annotations

import json
import os
import re
import sys
from pathlib import Path
from typing import Any

import mufly

HERE = Path(__file__).resolve().parent
sys.path.insert(0, str(HERE))

project = "mufly"
author = "The mufly developers"
copyright = "the mufly developers, BSD-3-Clause"
version = release = mufly.__version__

extensions = ["myst_nb", "sphinx.ext.autodoc", "sphinx.ext.napoleon", "sphinx_copybutton", "equations"]
exclude_patterns = ["*.py", "examples"]
root_doc = "index"

myst_enable_extensions = ["colon_fence", "deflist", "dollarmath", "substitution"]
# {{ key }} prints the value of a figure. A key that docs/figures.json does not have is a warning, which fails -W.
myst_substitutions = {
    row["key"]: row["value"] for row in json.loads((HERE / "figures.json").read_text(encoding="utf-8"))
}
myst_fence_as_directive = {"math"}  # as GitHub writes equations
html_math_renderer = "mathml"
myst_heading_anchors = 4
myst_number_code_blocks: list[str] = []

# Pictures of the lessons belong into their pages, whatever the one who builds has set for himself.
os.environ["MPLBACKEND"] = "module://matplotlib_inline.backend_inline"
nb_custom_formats = {".py": ["jupytext.reads", {"fmt": "py:percent"}]}
nb_execution_mode = "cache"
nb_execution_in_temp = True  # lessons write files beside themselves
nb_execution_timeout = 300
nb_execution_raise_on_error = True
nb_merge_streams = True

autodoc_typehints = "none"
autodoc_member_order = "groupwise"
napoleon_google_docstring = False
napoleon_use_rtype = False
napoleon_use_ivar = True

# Words such as "name" in a type are no references, and rooms pass their classes on.
suppress_warnings = ["ref.python"]

html_search_scorer = str(HERE.resolve() / "_static" / "search_scorer.js")  # pages for people come first
html_theme = "furo"
html_title = f"mufly {release}"
html_static_path = ["_static"]
html_theme_options = {"sidebar_hide_name": False}


def links_out_of_the_site(app: object, page: str, source: list[str]) -> None:
    """Sources and examples are not pages of the site: they are named, or handed out."""
    folder = (HERE / page).parent

    def instead(found: re.Match[str]) -> str:
        text, target = found[1], found[2]
        place = (folder / target).resolve()
        if not place.exists():
            return found[0]  # the build says so
        inside = place.relative_to(HERE.parent)
        if inside.parts[:2] == ("docs", "examples") and place.is_file():
            return f"{{download}}`{text.strip('`')} <{target}>`"
        if inside.parts[0] == "docs":
            return found[0]
        if inside.as_posix() in INCLUDED:
            return f"[{text}]({os.path.relpath(HERE / INCLUDED[inside.as_posix()], folder)})"
        name = f"`{inside.as_posix()}`"
        return name if text.strip("`") == inside.as_posix() else f"{text} ({name})"

    source[0] = re.sub(
        r"(?<!!)\[([^\]]+)\]\((?!https?:|#)([^)#\s]+)(?:#[^)]*)?\)",
        lambda m: instead(m) if not is_page(m[2], folder) else m[0],
        source[0],
    )


def is_page(target: str, folder: Path) -> bool:
    """Whether a link leads to another page of the site."""
    return target.endswith(".md") and HERE in (folder / target).resolve().parents


INCLUDED = {
    "benchmarks/README.md": "benchmarks.md",
    "CHANGELOG.md": "changelog.md",
    "CONTRIBUTING.md": "contributing.md",
}


def setup(app: Any) -> None:
    """Write the reference before the pages are read."""
    import make_reference  # from beside this file

    make_reference.write(HERE / "api")
    app.connect("source-read", links_out_of_the_site)
