"""``mufly fly``: from a vehicle file to an autonomous mission."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from mufly.cli.flight_options import check_air, check_folder, dated_folder, wind_of
from mufly.cli.live_display import LiveDisplay
from mufly.cli.station import BrowserOption, HostOption, PortOption, TokenOption
from mufly.errors import InputError, MuflyError

if TYPE_CHECKING:
    import xarray as xr
    from rich.console import Console

    from mufly.cli.fly_page import Order
    from mufly.flight import Progress, Summary
    from mufly.link import Endpoint
    from mufly.mission import Mission
    from mufly.station.page.address import Address
    from mufly.vehicle import Vehicle

__all__ = ["HELP", "fly"]

# One line a paragraph: the terminal wraps them.
HELP = """Fly a mission on the full nonlinear model.

Opens the ground station in the browser: the helicopter stands on the floor with its mission loaded, by default the \
demonstration of the muFly dissertation (take off, a square of four waypoints, land), and is flown from there. With \
no page opened within 20 s it flies the mission by itself. It ends with Ctrl-C, or when the flight is over and the \
page was closed. With --headless it flies in the terminal, as fast as the machine can.

Writes a folder with the recording (flight.mcap; opens in Foxglove and PlotJuggler), summary.json and pictures. \
The exit status is 0 only if the mission succeeded.

Examples:

  mufly fly

  mufly fly box-on-leg --headless --wind 0.5,0,0 --gust 0.3 --seed 7

  mufly fly my-mission.toml --vehicle my-helicopter.toml --out results

  mufly fly --link udp:127.0.0.1:14550      (QGroundControl or a script may fly it too)
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
            "--headless", help="Stay in the terminal; no page, as fast as the machine can."
        ),
    ] = False,
    start: Annotated[
        bool, typer.Option("--start", help="Begin the mission at once, without a press on the page.")
    ] = False,
    links: Annotated[
        list[str] | None,
        typer.Option(
            "--link", metavar="LINK",
            help="Fly it as a MAVLink vehicle in real time, for other programs too: udp:HOST:PORT, tcpin:..., "
            "serial:...; can be given several times.",
        ),
    ] = None,
    port: PortOption = None,
    host: HostOption = "127.0.0.1",
    token: TokenOption = None,
    browser: BrowserOption = True,
) -> None:  # fmt: skip
    """Fly a mission on the full nonlinear model."""
    from rich.console import Console

    console = Console(stderr=as_json)
    steady = wind_of(wind)
    check_air(gust, seed)
    folder = out if out is not None else dated_folder()
    check_folder(folder)
    ends = _endpoints(links)

    # Whatever can be wrong with the input is found before the heavy libraries are loaded.
    from mufly.mission import load_mission, preflight
    from mufly.vehicle import load_vehicle

    loaded_vehicle, loaded_mission = load_vehicle(vehicle), load_mission(mission)
    preflight(loaded_vehicle, loaded_mission, vehicle_file=vehicle, mission_file=mission)
    address = None
    if not (headless or as_json):
        from mufly.station.page.address import choose_address

        address = choose_address(host, port, token)
    console.print(
        f"[bold]{loaded_vehicle.name}[/bold] flies [bold]{loaded_mission.name}[/bold]; results go to {folder}"
    )

    recording = folder / "flight.mcap"
    if ends or not (headless or as_json):
        from mufly.cli.fly_page import Order

        order = Order(loaded_vehicle, loaded_mission, recording, steady, gust, seed, tuple(ends), start)
        stopped = _fly_in_real_time(console, order, address, browser)
        found = _read(recording)
        if found is None or _never_flew(found):
            console.print(f"It did not fly; what was recorded is in {folder}")
            raise typer.Exit(130 if stopped else 1)
        dataset, heard = found, [] if address is None else sorted(folder.glob("station*.*"))
    else:
        stopped, heard = False, []
        dataset = _fly_in_terminal(
            console, loaded_vehicle, loaded_mission, recording, steady, gust, seed, realtime
        )
    summary = _write_results(console, dataset, loaded_mission, [recording, *heard], as_json)
    if stopped and summary.outcome != "succeeded":
        console.print(f"Stopped; the recording up to here is in {recording}")
        raise typer.Exit(130)
    if summary.outcome == "unfinished":
        raise MuflyError(f"the mission was not flown to its end: {summary.reason}")
    if summary.outcome != "succeeded":
        raise MuflyError(f"the mission failed: {summary.reason}")


def _fly_in_terminal(
    console: Console,
    vehicle: Vehicle,
    mission: Mission,
    recording: Path,
    wind: list[float] | None,
    gust: float | None,
    seed: int,
    realtime: bool,
) -> xr.Dataset:
    """Fly the mission from beginning to end, as fast as the machine can."""
    import mufly.flight as flight

    try:
        with LiveDisplay(console) as display:
            return flight.fly(
                vehicle, mission, wind=wind, gust=gust, seed=seed, realtime=realtime, path=recording,
                on_progress=lambda p: display.now(_line_of(p)), on_event=display.event,
            )  # fmt: skip
    except KeyboardInterrupt:
        if recording.exists():
            console.print(f"Stopped; the recording up to here is in {recording}")
        raise typer.Exit(130) from None


def _fly_in_real_time(console: Console, order: Order, address: Address | None, browser: bool) -> bool:
    """Fly with the page, or without one (no address) behind a link; return whether it was stopped."""
    from mufly.cli.fly_page import fly_behind_link, fly_with_page

    with LiveDisplay(console) as display:
        if address is not None:
            return not fly_with_page(order, address, display.event, console, browser)
        try:
            fly_behind_link(order, display.event, console)
        except KeyboardInterrupt:
            return True
        return False


def _read(recording: Path) -> xr.Dataset | None:
    """The recording that the vehicle's process wrote; None if there is not a row in it."""
    from mufly.flight import read_recording

    try:
        return read_recording(recording)
    except InputError:
        return None


def _never_flew(dataset: xr.Dataset) -> bool:
    down = dataset["truth_position"].sel(axis="D").values
    return bool((down > down[0] - 0.02).all())


def _write_results(
    console: Console, dataset: xr.Dataset, mission: Mission, recordings: list[Path], as_json: bool
) -> Summary:
    """Write summary and pictures beside the recordings, and print what they say."""
    import mufly.flight as flight

    folder, waypoints = recordings[0].parent, [w.position_m for w in mission.waypoint]
    summary = flight.summarise(
        dataset,
        waypoints,
        flight.events_of(dataset),
        take_off=(*mission.start_m, -mission.take_off.height_m),
        reach_m=mission.limits.reach_m,
        world=mission.world,
        realtime_factor=dataset.attrs.get("realtime_factor"),
    )
    text = json.dumps(summary.to_dict(), indent=2)
    (folder / "summary.json").write_text(text + "\n", encoding="utf-8")
    pictures = flight.draw_flight(dataset, folder, waypoints=waypoints, world=mission.world)
    if as_json:
        print(text)
    else:
        _print_result(console, summary)
        names = ", ".join(p.name for p in (*recordings, folder / "summary.json", *pictures))
        console.print(f"Written to [bold]{folder}[/bold]: {names}")
    return summary


def _endpoints(links: list[str] | None) -> list[Endpoint]:
    from mufly.link.endpoint import parse_endpoint

    found = [parse_endpoint(text, "vehicle") for text in links or ()]
    for end in found:
        if found.count(end) > 1:
            raise InputError("--link", "", f"{end} is given twice", "give each link once")
    return found


def _line_of(p: Progress) -> str:
    n, e, d = p.position
    return (
        f"{p.time_s:7.1f} s  {p.state:<9}  N {n:5.2f} E {e:5.2f} height {-d:4.2f} m  "
        f"{p.battery_V:.2f} V {p.battery_charge:4.0%} {p.realtime_factor:3.0f}x real time"
    )


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
