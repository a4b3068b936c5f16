"""``mufly identify``: the parameters of a vehicle, from bench and flight data. Commands live in their own modules."""

from __future__ import annotations

import typer

from mufly.cli import identify_bench, identify_demo, identify_flight, identify_linear

__all__ = ["app"]

app = typer.Typer(
    help="Find a vehicle's parameters: from bench data, from flights, and plan the flights that show them.",
    no_args_is_help=True,
)
identify_flight.add_to(app)
identify_demo.add_to(app)
identify_bench.add_to(app)
identify_linear.add_to(app)
