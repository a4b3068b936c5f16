"""``mufly station``: the ground station's page, for any MAVLink vehicles or for a recording."""

from __future__ import annotations

import asyncio
import contextlib
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from mufly.errors import InputError

if TYPE_CHECKING:
    from mufly.station.page.address import Address

__all__ = [
    "HELP", "BrowserOption", "HostOption", "PortOption", "TokenOption", "announce", "station",
]  # fmt: skip

DEFAULT_ENDPOINT = "udp:127.0.0.1:14550"

HELP = """Open the ground station in the browser, for any MAVLink vehicles.

Shows the vehicle in its world, instruments, plots of any signal, ranges, spectrum, messages, mission, checks and \
parameters; commands it; records what it hears (station.mcap and station.tlog, in a folder for each session). Several \
vehicles and several links at once. Closing the page or the station stops nothing in the air.

Links: udp:HOST:PORT and udpin: listen, udpout: sends, tcp: calls, tcpin: waits for calls, serial:DEVICE:BAUD.

Examples:

  mufly station

  mufly station --connect serial:/dev/ttyUSB0:57600 --connect udp:0.0.0.0:14550

  mufly station --open flights/2031-05-06_14-07-01/flight.mcap

  mufly station --host 0.0.0.0      (a tablet may join: the token is printed)
"""

PortOption = Annotated[
    int | None,
    typer.Option(
        "--port", min=1, max=65535, help=r"Port of the page. \[default: 8080, or the next that is free]"
    ),
]
HostOption = Annotated[
    str,
    typer.Option(
        "--host", metavar="ADDRESS", help="Address to serve the page on; any but loopback needs a token."
    ),
]
TokenOption = Annotated[
    str | None,
    typer.Option(
        "--token",
        help="What a browser has to show to be let in. "
        r"\[default: none on loopback, else made and printed]",
    ),
]
BrowserOption = Annotated[
    bool, typer.Option("--browser/--no-browser", help="Open the page in the default browser.")
]


def station(
    connect: Annotated[
        list[str] | None,
        typer.Option(
            "--connect", "-c", metavar="LINK",
            help=rf"Where vehicles are; can be given several times. \[default: {DEFAULT_ENDPOINT}]",
        ),
    ] = None,
    open_file: Annotated[
        Path | None, typer.Option("--open", metavar="RECORDING", help="Show a recording, of any format of mufly log.")
    ] = None,
    mission: Annotated[
        str | None,
        typer.Option(
            "--mission", "-m", metavar="NAME|FILE", help="Mission whose world (boxes, walls, room) is drawn."
        ),
    ] = None,
    out: Annotated[
        Path, typer.Option("--out", "-o", metavar="DIR", help="Where recordings are written and looked for.")
    ] = Path("flights"),
    record: Annotated[
        bool, typer.Option("--record/--no-record", help="Record from the beginning; the page can do it later too.")
    ] = True,
    port: PortOption = None,
    host: HostOption = "127.0.0.1",
    token: TokenOption = None,
    browser: BrowserOption = True,
) -> None:  # fmt: skip
    """Open the ground station in the browser."""
    from mufly.link.endpoint import parse_endpoint
    from mufly.mission import load_mission

    words = connect or ([] if open_file is not None else [DEFAULT_ENDPOINT])
    endpoints = [parse_endpoint(word, "station", "--connect") for word in words]
    world = load_mission(mission) if mission is not None else None
    if out.exists() and not out.is_dir():
        raise InputError("--out", "", f"{out} is a file", "name a folder")

    from mufly.cli.options import progress_bar
    from mufly.station import Station
    from mufly.station.replay import open_recording

    recording = None
    if open_file is not None:
        with progress_bar("Reading", True) as progress:
            recording = open_recording(open_file, progress)

    from mufly.station.page.address import choose_address
    from mufly.station.page.server import serve
    from mufly.station.page.session import Session

    address = choose_address(host, port, token)
    ground = Station(endpoints, folder=out, record=record and bool(endpoints))
    session = Session(
        lambda: ground.vehicles,
        out if open_file is None else open_file.absolute().parent,
        mission=world,
        recorder=ground.recorder if endpoints else None,
        to_open=recording,
    )

    async def work() -> None:
        try:
            await ground.start()
            announce(address, [e.explanation for e in endpoints])
            await serve(session, address, open_browser=browser, beside=None)
        finally:
            await ground.stop()

    with contextlib.suppress(KeyboardInterrupt):
        asyncio.run(work())
    if ground.recorder.path is not None:
        typer.echo(f"Recorded to {ground.recorder.path}")


def announce(address: Address, links: list[str]) -> None:
    """Say where the page is, what it listens to, and how to end it."""
    from rich.console import Console

    console = Console(stderr=True, highlight=False)
    for link in links:
        console.print(f"The station {link}")
    console.print(f"Page: [bold]{address.url}[/bold]   (Ctrl-C ends the station)", soft_wrap=True)
    if address.token:
        console.print(
            "Whoever has this address can command the vehicle; it travels unencrypted.", style="yellow"
        )
