"""The ``mufly`` command. Every sub-command lives in a module of its own and stays thin."""

from __future__ import annotations

import sys

import typer

import mufly
from mufly.cli import control, fly, mission, vehicle
from mufly.errors import MuflyError

__all__ = ["app", "main"]

app = typer.Typer(
    help="Coaxial micro helicopters, from a vehicle file to an autonomous mission.\n\n"
    "Start with [bold]mufly fly[/bold]; every command explains itself with --help.",
    no_args_is_help=True,
    rich_markup_mode="rich",
    context_settings={"help_option_names": ["-h", "--help"]},
    pretty_exceptions_enable=False,
)
app.command("fly", help=fly.HELP)(fly.fly)
app.add_typer(vehicle.app, name="vehicle")
app.add_typer(control.app, name="control")
app.add_typer(mission.app, name="mission")


def _version(asked: bool) -> None:
    if asked:
        typer.echo(f"mufly {mufly.__version__}")
        raise typer.Exit


@app.callback()
def _options(
    version: bool = typer.Option(
        False, "--version", callback=_version, is_eager=True, help="Print the version."
    ),
) -> None:
    pass


def main() -> None:
    """Run the command line: one clear line on standard error and status 1 when a user can mend the fault."""
    try:
        app()
    except MuflyError as error:
        typer.secho(f"mufly: {error}", fg=typer.colors.RED, err=True)
        sys.exit(1)
