"""A panel that the browser draws by itself from the stream of frames."""

from __future__ import annotations

import hashlib
from pathlib import Path
from typing import Any

import nicegui
from nicegui.element import Element

__all__ = ["STATIC", "Panel", "static_url"]

STATIC = Path(__file__).parent / "static"
_THREE = Path(nicegui.__file__).parent / "elements" / "scene" / "dist"


def static_url() -> str:
    """Where the static files are served: the name changes with their content, so that no browser keeps old ones."""
    digest = hashlib.sha256()
    for path in sorted(STATIC.iterdir()):
        digest.update(path.name.encode() + path.read_bytes())
    return f"/mufly/{digest.hexdigest()[:12]}"


_URL = static_url()


class Panel(Element, component=STATIC / "mufly_panel.js", esm={"nicegui-scene": str(_THREE)}):
    """One of the modules in ``static/`` on the page.

    Parameters
    ----------
    module : str
        ``scene``, ``plots``, ``flight``, ...
    options : dict, optional
        What its ``mount`` gets.
    """

    def __init__(self, module: str, options: dict[str, Any] | None = None) -> None:
        super().__init__()
        self._props["module"] = module
        self._props["base"] = _URL
        self._props["options"] = options or {}
        self.classes(f"mf-{module}")

    def call(self, name: str, *arguments: Any) -> None:
        """Call a method of the module in the browser."""
        self.run_method("call", name, *arguments)
