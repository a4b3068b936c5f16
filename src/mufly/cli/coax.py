"""``mufly coax``: two rotors above each other."""

from __future__ import annotations

import typer

from mufly.cli import coax_map

__all__ = ["app"]

app = typer.Typer(help="Coaxial pairs: two rotors that turn against each other.", no_args_is_help=True)
coax_map.add_to(app)


@app.callback()
def _pairs() -> None:
    pass
