"""The ``mufly`` command. Every sub-command has its own module and contains little logic."""

from __future__ import annotations

import gc
import os
import sys
import warnings
from typing import Any

import typer

from mufly.cli import coax, control, drive, fly, log, mission, monte_carlo, rotor, station, study, vehicle
from mufly.cli import optimise as _optimise  # noqa: F401  adds to the commands of rotor and coax, as study does
from mufly.cli.aero import bench_series, cfd, export
from mufly.cli.aero import benchmark as _benchmark  # noqa: F401  adds to the commands of rotor
from mufly.cli.aero import coax_flight_map as _coax_flight_map  # noqa: F401  adds to the commands of coax
from mufly.cli.aero import forward as _forward  # noqa: F401  adds to the commands of rotor
from mufly.cli.aero import measure as _measure  # noqa: F401  adds to the commands of rotor
from mufly.cli.aero import measured_rotors as _measured_rotors  # noqa: F401  adds to the commands of rotor
from mufly.cli.aero import structure as _structure  # noqa: F401  adds to the commands of rotor
from mufly.cli.identify import flight as identify
from mufly.cli.onboard import estimate, external_autopilots, firmware, link, sensors, slam
from mufly.cli.onboard import fmu as _fmu  # noqa: F401  adds to the commands of vehicle
from mufly.cli.options import CommandGroup
from mufly.errors import MuflyError
from mufly.version import __version__

__all__ = ["app", "main"]

app = CommandGroup(
    help="Coaxial micro helicopters, from blade geometry to autonomous flight.\n\n"
    "Start with [bold]mufly fly[/bold]; --help explains every command.",
    no_args_is_help=True,
    rich_markup_mode="rich",
    context_settings={"help_option_names": ["-h", "--help"]},
    pretty_exceptions_enable=False,
)
app.command("fly", help=fly.FLY_HELP)(fly.fly_mission)
app.command("new", help=vehicle.NEW_HELP)(vehicle.create_vehicle_project)
app.command("monte-carlo", help=monte_carlo.MONTE_CARLO_HELP)(monte_carlo.run_monte_carlo)
app.command("link", help=link.LINK_HELP)(link.run_link)
app.command("station", help=station.STATION_HELP)(station.open_station)
rotor.app.command()(export.export)
app.add_typer(rotor.app, name="rotor")
app.add_typer(coax.app, name="coax")
app.add_typer(cfd.app, name="cfd")
app.add_typer(bench_series.app, name="bench")
app.add_typer(drive.app, name="drive")
app.add_typer(vehicle.app, name="vehicle")
app.add_typer(control.app, name="control")
app.add_typer(external_autopilots.app, name="autopilot")
app.add_typer(mission.app, name="mission")
app.add_typer(identify.app, name="identify")
app.add_typer(log.app, name="log")
app.add_typer(sensors.app, name="sensors")
app.add_typer(estimate.app, name="estimate")
app.add_typer(slam.app, name="slam")
app.add_typer(firmware.app, name="firmware")
app.add_typer(study.thesis_commands, name="thesis")


def _print_version(asked: bool) -> None:
    if asked:
        typer.echo(f"mufly {__version__}")
        raise typer.Exit


@app.callback()
def _accept_root_options(
    version: bool = typer.Option(False, "--version", callback=_print_version, is_eager=True, help="Print the version."),
) -> None:
    pass


# Typer has no public name for the base class of command-line errors.
_CommandLineError: type[Any] = next(c for c in typer.BadParameter.__mro__ if c.__name__ == "ClickException")


_shown_warnings: set[str] = set()


def _show_warning(message: Warning | str, category: type[Warning], *where: Any, **more: Any) -> None:
    """Show a warning of this package once, as one line; those of libraries are shown only with ``python -W`` or
    PYTHONWARNINGS.
    """
    if category.__module__.startswith("mufly"):
        if str(message) in _shown_warnings:
            return
        _shown_warnings.add(str(message))
        typer.secho(f"mufly: {message}", fg=typer.colors.YELLOW, err=True)
    elif sys.warnoptions:
        sys.stderr.write(warnings.formatwarning(message, category, *where[:2]))


def main() -> None:
    """Run the command line.

    An error is printed as one line on standard error, with exit status 1 (2 for an unknown option).
    """
    warnings.showwarning = _show_warning
    # Libraries and compilers create a million permanent objects. With Python's default thresholds the garbage collector
    # takes an eighth of the first start for them.
    gc.set_threshold(100_000, 20, 20)
    try:
        status = app(standalone_mode=False, prog_name="mufly")
        if station.ShutdownHandler.was_signalled:
            # The sender of a signal waits for the end; finalising the interpreter takes long on a busy machine.
            sys.stdout.flush()
            sys.stderr.flush()
            os._exit(status or 0)
        sys.exit(status)
    except MuflyError as error:
        _exit_with_message(str(error), 1)
    except typer.Abort:
        _exit_with_message("stopped", 130)
    except BrokenPipeError:
        # The reader has closed the pipe; nothing more can be written, not even at exit.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        sys.exit(1)
    except OSError as error:
        _exit_with_message(
            f"{error.filename or 'file'}: {error.strerror or error}; choose another place or make room", 1
        )
    except Exception as error:
        if not isinstance(error, _CommandLineError):
            raise
        if type(error).__name__ == "NoArgsIsHelpError":
            error.show()
            sys.exit(2)
        context = getattr(error, "ctx", None)
        path = _typed_command() if context is None else context.command_path
        message = " ".join(error.format_message().split()).rstrip(".")
        _exit_with_message(f"{message}; see `{path} --help`", 2)


def _typed_command() -> str:
    """Return the command as typed, without options and arguments."""
    words = ["mufly"]
    group: Any = typer.main.get_command(app)
    for word in sys.argv[1:]:
        group = getattr(group, "commands", {}).get(word)
        if group is None:
            break
        words.append(word)
    return " ".join(words)


def _exit_with_message(message: str, status: int) -> None:
    typer.secho(f"mufly: {message}", fg=typer.colors.RED, err=True)
    sys.exit(status)
