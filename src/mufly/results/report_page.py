"""HTML pages of reports, self-contained, from a common template.

Pictures have a light background; in dark mode the page inverts them.
"""

from __future__ import annotations

import base64
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from jinja2 import Environment, Template


@cache
def _template_environment() -> Environment:
    import jinja2

    loader = jinja2.FileSystemLoader(Path(__file__).parent)
    found = jinja2.Environment(
        autoescape=True, loader=loader, trim_blocks=True, lstrip_blocks=True, undefined=jinja2.StrictUndefined
    )
    found.filters["base64"] = lambda png: base64.b64encode(png).decode("ascii")
    return found


@cache
def _compile_html_template(source: str) -> Template:
    return _template_environment().from_string(source)


def render_report_template(title: str, body: str, **values: Any) -> str:
    """Return an HTML page rendered from the template source of its body.

    Parameters
    ----------
    title : str
        Title of the page; ``heading=`` gives another first heading.
    body : str
        Jinja2 source of the content below the heading; text is escaped. It may call ``table(heads, rows, numbers,
        warn)`` (``numbers``: columns aligned to the right, ``warn``: the column of warnings), ``listed(texts,
        otherwise)`` and ``figure(png, alt)``.
    **values
        Variables of the body; with ``refresh_s`` the page reloads periodically.
    """
    return (
        _template_environment()
        .get_template("report_page.html")
        .render(title=title, body=_compile_html_template(body), **values)
    )
