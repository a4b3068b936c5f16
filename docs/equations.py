"""Equations as MathML, written while the site is built: browsers set it themselves, without a script or the net.

In the pages they are LaTeX, ``$c_T$`` within a line and a fence ``math`` for what stands alone, which GitHub shows,
too. ``latex2mathml`` translates; what it does not know (it passes commands through) fails the build. Of ``align`` it
knows the starred form only.
"""

from __future__ import annotations

import re
from typing import Any
from xml.etree import ElementTree

from docutils import nodes
from latex2mathml.converter import convert
from sphinx.util import logging

ACCENTS = "˙¨^~¯→"
BEFORE_A_SIGN = "([{=<>≤≥,;"  # a minus after one of these, or after nothing, is a sign


def mathml(latex: str, *, block: bool) -> str:
    """A formula for the page.

    Raises
    ------
    ValueError : it holds a command or an alignment that was not understood.
    """
    ElementTree.register_namespace("", "http://www.w3.org/1998/Math/MathML")
    text = convert(latex, display="block" if block else "inline")
    if left := re.search(r"\\\w*|&(?![#\w]+;)", re.sub(r">\s+<", "><", text)):
        raise ValueError(f"equation: '{left[0]}' is not understood in: {latex}")
    root = ElementTree.fromstring(text)
    for parent in list(root.iter()):
        _space(parent)
    return ElementTree.tostring(root, encoding="unicode")


def _space(parent: ElementTree.Element) -> None:
    """Set the space between a formula's parts as TeX does; browsers go by MathML's own table, which is wider."""
    kind = parent.tag.rpartition("}")[2]
    if kind == "mover" and (parent[1].text or "") in ACCENTS:
        parent.set("accent", "true")  # else the dot stands high above its letter
    before = None
    for part in list(parent):
        text = part.text or ""
        if part.tag.endswith("}mo") and text.isalpha():
            part.tag = part.tag[:-1] + "i"  # "diag" and "sat" are names
        elif part.tag.endswith("}mo") and text in "|/":
            part.set("lspace", "0")
            part.set("rspace", "0")
        elif part.tag.endswith("}mo") and text in "−-+" and (before is None or (before.text or "#") in BEFORE_A_SIGN):
            part.set("form", "prefix")
        if kind in ("mrow", "math", "mtd", "mstyle") and before is not None:
            after_name = _is_name(before) and (not part.tag.endswith("}mo") or text == "|")
            if after_name or (_is_name(part) and not before.tag.endswith(("}mo", "}mspace"))):
                place = list(parent).index(part)
                parent.insert(place, ElementTree.Element(part.tag.partition("}")[0] + "}mspace", width="0.167em"))
        before = part


def _is_name(part: ElementTree.Element) -> bool:
    """Whether this is a function's name, also with an exponent: more letters than one, in one sign."""
    name = part[0] if part.tag.endswith("}msup") else part
    return name.tag.endswith("}mi") and len(name.text or "") > 1


def _write(page: Any, node: nodes.Element, *, block: bool) -> None:
    try:
        text = mathml(node.astext().strip(), block=block)
    except ValueError as problem:
        logging.getLogger(__name__).warning(str(problem), location=node)
        text = page.encode(node.astext())
    page.body.append(f'<div class="equation" tabindex="0">{text}</div>' if block else text)
    raise nodes.SkipNode


def setup(app: Any) -> None:
    """Make this the way in which equations are written, with their style in every page."""
    app.add_html_math_renderer(
        "mathml",
        inline_renderers=(lambda page, node: _write(page, node, block=False), None),
        block_renderers=(lambda page, node: _write(page, node, block=True), None),
    )
    app.add_css_file("equations.css")
