"""``mufly link``: the simulated helicopter as a MAVLink vehicle in real time."""

from __future__ import annotations

import signal
import threading
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from mufly.cli.live_display import LiveDisplay
from mufly.errors import InputError

if TYPE_CHECKING:
    from types import FrameType

    from mufly.link import Endpoint, Report

__all__ = ["HELP", "link"]

# One line a paragraph: the terminal wraps them.
HELP = """The simulated helicopter as a MAVLink vehicle, in real time.

QGroundControl, MAVSDK, MAVProxy and pymavlink scripts fly it as they fly any other: arm, take off, \
missions in metres, offboard, parameters. By default it sends to the two places where they wait: this machine's UDP \
ports 14550 and 14540.

Without a mission it stands in an empty hall and waits for what it is told. With one it has that mission loaded, and \
its walls and obstacles around it; a station starts it. Ctrl-C ends it.

Examples:

  mufly link

  mufly link box-on-leg --out flights/today

  mufly link --link udpin:0.0.0.0:14550 --link serial:/dev/ttyUSB0:57600 --origin 47.3769,8.5417,408
"""


def link(
    mission: Annotated[
        str | None, typer.Argument(help="Mission file, or a built-in mission (see: mufly mission list).")
    ] = None,
    vehicle: Annotated[
        str, typer.Option("--vehicle", "-v", help="Vehicle file, or a built-in vehicle.")
    ] = "mufly-1.1",
    ends: Annotated[
        list[str] | None,
        typer.Option(
            "--link", "--connect", metavar="ENDPOINT",
            help="Where stations are: udp:HOST:PORT (send there), udpin:HOST:PORT (listen), tcpin:HOST:PORT, "
            "tcp:HOST:PORT, serial:DEVICE:BAUD. Can be given several times. "
            r"\[default: udp:127.0.0.1:14550 and udp:127.0.0.1:14540]",
        ),
    ] = None,
    system: Annotated[int, typer.Option(help="Its MAVLink system number, 1 to 255.")] = 1,
    origin: Annotated[
        str | None,
        typer.Option(
            metavar="LAT,LON,ALT",
            help="Where on the globe N = E = D = 0 is (degrees, metres), for programs that insist on a global "
            "position.",
        ),
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option(
            "--out", "-o", metavar="DIR",
            help="Record to this folder: flight.mcap and link.tlog; those of an earlier flight there are replaced.",
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
) -> None:  # fmt: skip
    """The simulated helicopter as a MAVLink vehicle, in real time."""
    from rich.console import Console

    from mufly.cli.flight_options import check_air, check_folder, wind_of
    from mufly.link.endpoint import parse_endpoint

    console = Console()
    endpoints = [parse_endpoint(text, "vehicle") for text in ends or _DEFAULT]
    _check_endpoints(endpoints)
    if not 1 <= system <= 255:
        raise InputError("--system", "", f"{system} is no MAVLink system", "give 1 to 255")
    steady = wind_of(wind)
    check_air(gust, seed)
    if out is not None:
        check_folder(out)

    # Whatever can be wrong with the input is found before the heavy libraries are loaded.
    from mufly.link.geodesy import parse_origin
    from mufly.mission import Mission, load_mission, preflight
    from mufly.vehicle import load_vehicle

    place = None if origin is None else parse_origin(origin)
    helicopter = load_vehicle(vehicle)
    plan = Mission(name="no mission") if mission is None else load_mission(mission)
    if mission is not None:
        preflight(helicopter, plan, vehicle_file=vehicle, mission_file=mission)

    from mufly.control import design
    from mufly.flight import Flight
    from mufly.link import TlogWriter, VehicleLink, run
    from mufly.link.runner import warm_up

    console.print(
        f"[bold]{helicopter.name}[/bold] is MAVLink system {system}, with {plan.name}", highlight=False
    )
    for end in endpoints:
        console.print(f"  it {end.explanation}", highlight=False)
        if end.beyond_loopback:
            console.print(
                f"  [yellow]anyone who can reach {end.host} port {end.port} may command it: MAVLink has no password[/]",
                highlight=False,
            )
    controller = design(helicopter)
    warm_up(helicopter, controller)
    recording = None if out is None else out / "flight.mcap"
    flight = Flight(
        helicopter, plan, controller=controller, wind=steady, gust=gust, seed=seed, path=recording, keep=False
    )
    log = None if out is None else TlogWriter(out / "link.tlog")
    over = _Over()
    try:
        with flight, over, LiveDisplay(console) as display:
            run(
                flight,
                endpoints,
                link=VehicleLink(flight, system=system, origin=place),
                stop=over.asked.is_set,
                tlog=log,
                on_event=display.event,
                on_notice=display.notice,
                on_open=lambda: console.print("Ctrl-C ends it.", style="dim"),
                on_report=lambda report: display.now(_line_of(report)),
            )
    finally:
        if log is not None:
            log.close()
    if recording is not None:
        console.print(f"Ended; the recording is in {recording}, the telemetry log beside it", highlight=False)
    raise typer.Exit(over.status)


_DEFAULT = ("udp:127.0.0.1:14550", "udp:127.0.0.1:14540")


def _check_endpoints(endpoints: list[Endpoint]) -> None:
    names = [str(end) for end in endpoints]
    for name in names:
        if names.count(name) > 1:
            raise InputError("--link", "", f"{name} is given twice", "give each endpoint once")


class _Over:
    """Ctrl-C and termination ask the loop to end; a second Ctrl-C no longer waits for it."""

    def __init__(self) -> None:
        self.asked = threading.Event()
        self.status = 0

    def __enter__(self) -> _Over:
        self._before = {s: signal.signal(s, self._ask) for s in (signal.SIGINT, signal.SIGTERM)}
        return self

    def __exit__(self, *exc: object) -> None:
        for number, handler in self._before.items():
            signal.signal(number, handler)

    def _ask(self, number: int, frame: FrameType | None) -> None:
        if self.asked.is_set():
            raise KeyboardInterrupt
        self.status = 128 + number
        self.asked.set()


def _line_of(r: Report) -> str:
    """How the loop is doing."""
    who = f"commanded by {r.commander}" if r.commander else "nobody commands"
    slipped = f", {r.slipped_s:.1f} s lost" if r.slipped_s else ""
    return (
        f"{r.time_s:7.1f} s  {r.state:<9}  {'armed' if r.armed else 'disarmed'}  {r.height_m:5.2f} m  "
        f"{r.battery_V:.2f} V  {who}  in {r.received_Hz:.0f}/s, out {r.sent_Hz:.0f}/s  "
        f"late {r.late_ms:.1f} ms{slipped}"
    )
