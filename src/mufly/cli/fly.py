"""``mufly fly``: from a vehicle file to an autonomous mission."""

from __future__ import annotations

import json
import os
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from mufly.errors import InputError, MuflyError

if TYPE_CHECKING:
    from rich.console import Console

    from mufly.flight import Event, Progress, Summary

__all__ = ["HELP", "fly"]

# One line a paragraph: the terminal wraps them.
HELP = """Fly a mission on the full nonlinear model.

Loads the vehicle, designs its controllers, and flies; by default the demonstration of the muFly dissertation: \
take off, a square of four waypoints, land.

Writes a folder with the recording (flight.mcap; opens in Foxglove and PlotJuggler), summary.json and pictures. \
The exit status is 0 only if the mission succeeded.

Examples:

  mufly fly

  mufly fly box-on-leg --wind 0.5,0,0 --gust 0.3 --seed 7

  mufly fly my-mission.toml --vehicle my-helicopter.toml --out results
"""


def fly(
    mission: Annotated[
        str, typer.Argument(help="Mission file, or a built-in mission (see: mufly mission list).")
    ] = "demonstration",
    vehicle: Annotated[
        str, typer.Option("--vehicle", "-v", help="Vehicle file, or a built-in vehicle.")
    ] = "mufly-1.1",
    out: Annotated[
        Path | None,
        typer.Option(
            "--out",
            "-o",
            metavar="DIR",
            help="Folder for the results; those of an earlier flight there are replaced. "
            r"\[default: flights/<date-time>]",
        ),
    ] = None,
    wind: Annotated[
        str | None,
        typer.Option(metavar="N,E,D", help="Steady wind in m/s, as in 0.5,0,0; instead of the mission's."),
    ] = None,
    gust: Annotated[
        float | None,
        typer.Option(metavar="M/S", help="Gusts, standard deviation, 0 to 5 m/s; instead of the mission's."),
    ] = None,
    seed: Annotated[int, typer.Option(help="Seed of everything random.")] = 0,
    realtime: Annotated[bool, typer.Option("--realtime", help="Keep pace with the clock.")] = False,
    as_json: Annotated[
        bool, typer.Option("--json", help="Print the summary as JSON on standard output, and nothing else.")
    ] = False,
    headless: Annotated[
        bool,
        typer.Option(
            "--headless", help="Stay in the terminal (today it always does: there is no browser view yet)."
        ),
    ] = False,
) -> None:
    """Fly a mission on the full nonlinear model."""
    from rich.console import Console

    console = Console(stderr=as_json)
    steady = _wind(wind)
    _check_numbers(gust, seed)
    folder = out if out is not None else _dated_folder()
    _check_folder(folder)

    # Whatever can be wrong with the input is found before the heavy libraries are loaded.
    from mufly.mission import load_mission, preflight
    from mufly.vehicle import load_vehicle

    loaded_vehicle, loaded_mission = load_vehicle(vehicle), load_mission(mission)
    preflight(loaded_vehicle, loaded_mission, vehicle_file=vehicle, mission_file=mission)
    console.print(
        f"[bold]{loaded_vehicle.name}[/bold] flies [bold]{loaded_mission.name}[/bold]; results go to {folder}"
    )

    import mufly.flight as flight

    recording = folder / "flight.mcap"
    try:
        with _Display(console) as display:
            dataset = flight.fly(
                loaded_vehicle,
                loaded_mission,
                wind=steady,
                gust=gust,
                seed=seed,
                realtime=realtime,
                path=recording,
                on_progress=display.progress,
                on_event=display.event,
            )
    except KeyboardInterrupt:
        if recording.exists():
            console.print(f"Stopped; the recording up to here is in {recording}")
        raise typer.Exit(130) from None

    summary = flight.summarise(
        dataset,
        [w.position_m for w in loaded_mission.waypoint],
        flight.events_of(dataset),
        take_off=(*loaded_mission.start_m, -loaded_mission.take_off.height_m),
        reach_m=loaded_mission.limits.reach_m,
        world=loaded_mission.world,
        realtime_factor=dataset.attrs["realtime_factor"],
    )
    text = json.dumps(summary.to_dict(), indent=2)
    (folder / "summary.json").write_text(text + "\n", encoding="utf-8")
    pictures = flight.draw_flight(
        dataset, folder, waypoints=[w.position_m for w in loaded_mission.waypoint], world=loaded_mission.world
    )
    if as_json:
        print(text)
    else:
        _print_result(console, summary)
        names = ", ".join(p.name for p in (recording, folder / "summary.json", *pictures))
        console.print(f"Written to [bold]{folder}[/bold]: {names}")
    if summary.outcome != "succeeded":
        raise MuflyError(f"the mission failed: {summary.reason}")


def _wind(text: str | None) -> list[float] | None:
    if text is None:
        return None
    try:
        numbers = [float(part) for part in text.split(",")]
    except ValueError:
        numbers = []
    if len(numbers) != 3 or not all(abs(n) < 50.0 for n in numbers):
        raise InputError("--wind", "", f"{text!r} is no wind", "give N,E,D in m/s, as in 0.5,0,0")
    return numbers


def _check_numbers(gust: float | None, seed: int) -> None:
    if gust is not None and not 0.0 <= gust <= 5.0:
        raise InputError("--gust", "", f"{gust:g} m/s is no gust", "give 0 to 5 m/s")
    if not 0 <= seed < 2**63:
        raise InputError("--seed", "", f"{seed} is no seed", "give a whole number from 0 to 2^63 - 1")


def _check_folder(folder: Path) -> None:
    """Refuse a folder that cannot be made or written, without making it yet."""
    try:
        nearest = next(p for p in (folder, *folder.absolute().parents) if p.exists())
    except OSError as error:
        shown = str(folder) if len(str(folder)) < 60 else f"{str(folder)[:57]}..."
        raise InputError("--out", "", f"{shown}: {error.strerror}", "name another folder") from None
    if not nearest.is_dir():
        raise InputError("--out", "", f"{nearest} is a file", "name a folder")
    if not os.access(nearest, os.W_OK | os.X_OK):
        raise InputError("--out", "", f"{nearest} cannot be written", "name a folder that can")


def _dated_folder() -> Path:
    base = Path("flights") / datetime.now().strftime("%Y-%m-%d_%H-%M-%S")
    folder, n = base, 1
    while folder.exists():
        n += 1
        folder = base.with_name(f"{base.name}_{n}")
    return folder


class _Display:
    """Show what is happening: changes of state as lines, and on a terminal a live line below them."""

    def __init__(self, console: Console) -> None:
        from rich.live import Live

        self._console = console
        self._live = Live(console=console, refresh_per_second=10) if console.is_terminal else None

    def __enter__(self) -> _Display:
        if self._live is not None:
            self._live.__enter__()
        return self

    def __exit__(self, *exc: object) -> None:
        if self._live is not None:
            self._live.update("")
            self._live.__exit__(None, None, None)

    def event(self, e: Event) -> None:
        colour = {"error": "red", "warning": "yellow"}.get(e.level, "default")
        self._console.print(
            f"{e.time_s:7.1f} s  [bold]{e.state:<9}[/]  [{colour}]{e.text}[/]", highlight=False
        )

    def progress(self, p: Progress) -> None:
        if self._live is not None:
            from rich.text import Text

            n, e, d = p.position
            line = (
                f"{p.time_s:7.1f} s  {p.state:<9}  N {n:5.2f} E {e:5.2f} height {-d:4.2f} m  "
                f"{p.battery_V:.2f} V {p.battery_charge:4.0%} {p.realtime_factor:3.0f}x real time"
            )
            self._live.update(Text(line, no_wrap=True, overflow="ellipsis"))


def _print_result(console: Console, summary: Summary) -> None:
    from rich import box
    from rich.table import Table

    from mufly.flight import summary_rows

    table = Table(box=box.SIMPLE, show_header=False)
    colour = "green" if summary.outcome == "succeeded" else "red"
    for k, (label, value) in enumerate(summary_rows(summary)):
        table.add_row(label, f"[bold {colour}]{value}[/]" if k == 0 else value)
    console.print(table)
    points = Table("waypoint", "N, E, D (m)", "reached (s)", "off by (cm)", "overshoot (cm)", box=box.SIMPLE)
    for w in summary.waypoints:
        place = ", ".join(f"{x:g}" for x in w.position_m)
        points.add_row(
            w.name,
            place,
            _number(w.reached_s),
            _number(w.distance_at_reach_m, 100),
            _number(w.overshoot_m, 100),
        )
    console.print(points)


def _number(value: float | None, factor: float = 1.0) -> str:
    return "never" if value is None else f"{factor * value:.1f}"
