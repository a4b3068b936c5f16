"""``mufly station``, and options of real-time flights: wind, links, folder, live line.

The module loads no heavy library, so that errors in the input are reported first.
"""

from __future__ import annotations

import asyncio
import contextlib
import math
import os
import random
import signal
import threading
from collections.abc import Sequence
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from mufly.cli.options import define_option
from mufly.cli.output import LiveDisplay, check_output_place, make_console, progress_bar
from mufly.errors import InputError

if TYPE_CHECKING:
    from types import FrameType

    from mufly.flight.flight_software import ControlImplementation
    from mufly.link import Endpoint
    from mufly.sensors import Fault
    from mufly.station.page.page_address import PageAddress
    from mufly.vehicle import Vehicle


WindOption = Annotated[
    tuple[float, ...] | None,
    define_option(
        "--wind",
        "Steady wind, instead of the mission's: a speed, as 0.5, whose direction is drawn from the "
        "seed, or N,E,D, as 0.5,0,0.",
        unit="m/s",
        form="vector",
    ),
]
GustOption = Annotated[
    float | None,
    define_option("--gust", "Standard deviation of gusts, 0 to 5 m/s. Default: the mission's.", unit="m/s"),
]
SensorsOption = Annotated[
    Literal["fitted", "ideal"],
    define_option(
        "--sensors WHICH",
        "Source of the vehicle's state: fitted (the sensors in \\[sensors] of the vehicle file, and "
        "the filter) or ideal (the true state, without filter).",
    ),
]
FaultOption = Annotated[
    list[str] | None,
    define_option(
        "--fault NAME.KIND=AMOUNT@STARTs+DURATIONs",
        "Sensor fault, as sonar.jump=0.3@15s+2s or accelerometer.clip@20s; `mufly sensors faults` "
        "lists them. Repeat it for more.",
    ),
]


def parse_wind_option(numbers: tuple[float, ...] | None) -> float | tuple[float, float, float] | None:
    """Return the wind speed, or the wind N, E, D (m/s), of ``--wind``; None without it; InputError if out of range."""
    from mufly.mission import MAX_WIND_M_S

    if numbers is None:
        return None
    least = 0.0 if len(numbers) == 1 else -MAX_WIND_M_S
    if not all(least <= n <= MAX_WIND_M_S for n in numbers):
        raise InputError(
            "--wind", "", f"{','.join(f'{n:g}' for n in numbers)!r} is not a wind speed",
            f"give a speed of 0 to {MAX_WIND_M_S:g} m/s, or N,E,D as in 0.5,0,0, each of size {MAX_WIND_M_S:g} at most",
        )  # fmt: skip
    return numbers[0] if len(numbers) == 1 else (numbers[0], numbers[1], numbers[2])


def _choose_steady_wind(wind: float | tuple[float, float, float] | None, seed: int) -> list[float] | None:
    """Return the wind N, E, D (m/s); for a mere speed, a horizontal direction is drawn by ``seed`` and printed."""
    if wind is None or isinstance(wind, tuple):
        return None if wind is None else list(wind)
    towards = random.Random(seed).uniform(-math.pi, math.pi)
    drawn = [wind * math.cos(towards), wind * math.sin(towards), 0.0]
    given = ",".join(f"{x:.3f}" for x in drawn)
    typer.echo(f"Wind: {wind:g} m/s, its direction drawn by --seed {seed}; the same as --wind={given}", err=True)
    return drawn


def resolve_wind(wind: tuple[float, ...] | None, gust: float | None, seed: int) -> list[float] | None:
    """Return the wind N, E, D (m/s) of ``--wind``; InputError for invalid gusts and seeds."""
    from mufly.mission import MAX_GUST_RMS_M_S

    given = parse_wind_option(wind)
    if gust is not None and not 0.0 <= gust <= MAX_GUST_RMS_M_S:
        raise InputError("--gust", "", f"{gust:g} m/s is out of range", f"give 0 to {MAX_GUST_RMS_M_S:g} m/s")
    if not 0 <= seed < 2**63:
        raise InputError("--seed", "", f"{seed} is not a seed", "give a whole number from 0 to 2^63 - 1")
    return _choose_steady_wind(given, seed)


FirmwareOption = Annotated[
    bool,
    define_option(
        "--firmware",
        "Fly with the exported C code, built by this machine's compiler (`mufly firmware`).",
    ),
]


FixedPointOption = Annotated[
    bool,
    define_option(
        "--fixed-point", "Use fixed-point numbers, with --firmware, as for a processor without a floating-point unit."
    ),
]


PolicyOption = Annotated[
    str,
    define_option(
        "--policy FILE", "Fly by a learned policy in place of the control law (docs/how-to/learn-to-fly.md)."
    ),
]


def select_control_implementation(
    wanted: bool, fixed_point: bool = False, policy: str = "", vehicle_name: str = ""
) -> ControlImplementation | None:
    """Return the control law's implementation: exported C code, a learned policy, or None for the standard one.

    ``vehicle_name`` is that of the vehicle for which the controllers are designed.
    """
    if policy:
        if wanted:
            raise InputError("--policy", "", "cannot be combined with --firmware", "give one of the two")
        from mufly.flight.policy import PolicyControlLaw, check_policy_fits_vehicle, load_policy

        learned = load_policy(policy)
        check_policy_fits_vehicle(learned, vehicle_name, policy)
        return PolicyControlLaw(learned)
    if fixed_point and not wanted:
        raise InputError("--fixed-point", "", "applies to the exported code only", "also give --firmware")
    if not wanted:
        return None
    from mufly.firmware import FirmwareSoftware, FixedPointFirmwareControllers, find_compiler

    find_compiler()
    return FixedPointFirmwareControllers if fixed_point else FirmwareSoftware


def parse_sensor_faults(vehicle: Vehicle, sensors: str, faults: Sequence[str] | None) -> tuple[Fault, ...]:
    """Return the faults of ``--fault``; InputError for impossible faults."""
    from mufly.sensors.faults import parse_fault
    from mufly.sensors.sensor_suite import require_fault_sensors

    found = tuple(parse_fault(text) for text in faults or ())
    if found and sensors == "ideal":
        raise InputError("--fault", str(found[0]), "the true state has no sensor faults", "leave out --sensors ideal")
    require_fault_sensors(vehicle, found)
    return found


def describe_sensor_source(vehicle: Vehicle, sensors: str) -> str:
    """Return a description of the source of the vehicle's state."""
    from mufly.quantities.sensor_table import SENSORS

    if sensors == "ideal":
        return "Flies on the true state, without sensors and filter (--sensors ideal)"
    if vehicle.sensors is None:
        return f"{vehicle.name} has no table [sensors]: the vehicle flies on the true state, without filter"
    names = [name.replace("_", " ") for name in SENSORS if getattr(vehicle.sensors, name) is not None]
    return f"Flies on its sensors: {', '.join(names)}"


def describe_flight_code(vehicle: Vehicle, sensors: str, firmware: bool) -> str:
    """Return a description of the code that computes control law and estimator; build the C estimator if it is
    missing.
    """
    by = "Mission and control law: exported C code" if firmware else ""
    if sensors == "ideal" or vehicle.sensors is None:
        return by
    from mufly.estimate.filter_backend import explain_numba_choice

    why = explain_numba_choice(vehicle)
    estimator = "estimator: C code" if not why else f"estimator: compiled by Numba ({why})"
    return f"{by}; {estimator}" if firmware else estimator.capitalize()


def parse_endpoints(
    texts: Sequence[str] | None,
    role: Literal["vehicle", "station"],
    option: str = "--link",
    each: str = "link",
) -> list[Endpoint]:
    """Return the MAVLink endpoints that an option gives; raise InputError for a repeated one."""
    from mufly.link.ports import parse_endpoint

    found = [parse_endpoint(text, role, option) for text in texts or ()]
    for end in found:
        if found.count(end) > 1:
            raise InputError(option, "", f"{end} is given twice", f"give each {each} once")
    return found


def choose_dated_folder() -> Path:
    """Return ``flights/<date-time>``, a folder that does not exist yet."""
    base = Path("flights") / datetime.now().strftime("%Y-%m-%d_%H-%M-%S")
    folder, n = base, 1
    while folder.exists():
        n += 1
        folder = base.with_name(f"{base.name}_{n}")
    return folder


class ShutdownHandler:
    """Handler of Ctrl-C (SIGINT), SIGTERM and SIGHUP for commands that fly or watch, which then end in order.

    The first signal requests the end; loops check for it between two steps, so that no write is interrupted. A second
    Ctrl-C interrupts at once; other repetitions have no effect. Signals ignored at the start (nohup) stay ignored.

    Attributes
    ----------
    stop_requested : threading.Event
    exit_status : int
        128 plus the number of the signal; 0: no signal.
    waits_for_loop : bool
        Whether loops check for a request. Before that (nothing is open) the first signal interrupts at once.
    """

    was_signalled = False
    """Whether this process ends by a signal, so that closed objects need no finalising."""

    def __init__(self, *, patient: bool = True) -> None:
        self.stop_requested = threading.Event()
        self.exit_status = 0
        self.waits_for_loop = patient

    @property
    def is_hurried(self) -> bool:
        """Whether to end as soon as the files are closed, without further computations or pictures."""
        return self.exit_status not in (0, 128 + signal.SIGINT)

    def __enter__(self) -> ShutdownHandler:
        known = [getattr(signal, name, None) for name in ("SIGINT", "SIGTERM", "SIGHUP")]
        heard = [s for s in known if s is not None and signal.getsignal(s) is not signal.SIG_IGN]
        self._before = {s: signal.signal(s, self._handle_signal) for s in heard}
        return self

    def __exit__(self, *exc: object) -> None:
        for number, handler in self._before.items():
            signal.signal(number, handler)

    def _handle_signal(self, number: int, frame: FrameType | None) -> None:
        again, self.exit_status = self.stop_requested.is_set(), self.exit_status or 128 + number
        ShutdownHandler.was_signalled = True
        self.stop_requested.set()
        if number == getattr(signal, "SIGHUP", None):
            _silence_terminal()
        if not self.waits_for_loop or (again and number == signal.SIGINT):
            raise KeyboardInterrupt


def _silence_terminal() -> None:
    """Discard all output after the terminal has closed."""
    with contextlib.suppress(OSError):
        nowhere = os.open(os.devnull, os.O_WRONLY)
        for number in (1, 2):
            if os.isatty(number):
                os.dup2(nowhere, number)


# ----------------------------------------------------------------------------
# ``mufly station``: the ground station's page, for MAVLink vehicles or for a recording.


DEFAULT_ENDPOINT = "udp:127.0.0.1:14550"

STATION_HELP = """Open the ground station in the browser, for any MAVLink vehicles.

Shows the vehicle in 3-D, instruments, plots of any signal, ranges, spectrum, messages, mission, checks and \
parameters. Sends commands, and records all received data (station.mcap and station.tlog, a folder for each session). \
Supports several vehicles and links at once. A vehicle continues its flight when page or station are closed.

Links: udp:HOST:PORT and udpin: listen, udpout: sends, tcp: connects, tcpin: listens, serial:DEVICE:BAUD.

Examples:

  mufly station

  mufly station --connect serial:/dev/ttyUSB0:57600 --connect udp:0.0.0.0:14550

  mufly station --open flights/2031-05-06_14-07-01/flight.mcap

  mufly station --host 0.0.0.0      (for a tablet in the network; prints the token)
"""

PortOption = Annotated[
    int | None,
    define_option("--port", "Port of the page. Default: 8080, or the next free one.", min=1, max=65535),
]
HostOption = Annotated[
    str, define_option("--host ADDRESS", "Address on which the page is served; any but loopback requires a token.")
]
TokenOption = Annotated[
    str | None,
    define_option(
        "--token",
        "Token that a browser must present. Default: none on loopback, else a new one, which is printed.",
    ),
]
BrowserOption = Annotated[bool, define_option("--browser/--no-browser", "Open the page in the default browser.")]


def open_station(
    connect: Annotated[
        list[str] | None,
        define_option(
            "--connect -c LINK",
            rf"Endpoint of vehicles; can be given several times. \[default: {DEFAULT_ENDPOINT}]",
        ),
    ] = None,
    open_file: Annotated[
        Path | None, define_option("--open RECORDING", "Recording to show, of any format that `mufly log` reads.")
    ] = None,
    mission: Annotated[
        str | None,
        define_option("--mission -m NAME|FILE", "Mission whose world (boxes, walls, room) is drawn."),
    ] = None,
    out: Annotated[Path, define_option("--out -o DIR", "Folder for recordings, read and written.")] = Path("flights"),
    record: Annotated[
        bool,
        define_option("--record/--no-record", "Record from the start; the page can start a recording later."),
    ] = True,
    port: PortOption = None,
    host: HostOption = "127.0.0.1",
    token: TokenOption = None,
    browser: BrowserOption = True,
) -> None:
    """Open the ground station in the browser."""
    from mufly.mission import load_mission

    words = connect or ([] if open_file is not None else [DEFAULT_ENDPOINT])
    endpoints = parse_endpoints(words, "station", "--connect")
    world = load_mission(mission) if mission is not None else None
    check_output_place("--out", out, make=False)

    from mufly.station.page.page_address import bind_page_address
    from mufly.station.page.start_page import StartPage, Startup

    address = bind_page_address(host, port, token)
    startup = Startup("the ground station")
    print_page_address(address, [e.explanation for e in endpoints])
    ending = ShutdownHandler()
    with StartPage(address, startup) as page:
        if browser:
            open_browser_in_background(address)
        with LiveDisplay(make_console(stderr=True)) as display:
            display.follow_startup(startup)
            startup.begin_stage("loading the libraries")
            from mufly.station import GroundStation
            from mufly.station.page.page_server import serve_page
            from mufly.station.page.page_session import StationSession
            from mufly.station.replay import open_recording

        recording = None
        if open_file is not None:
            startup.begin_stage(f"reading {open_file.name}")
            with progress_bar("Reading", True) as progress:
                recording = open_recording(open_file, progress)
        startup.mark_succeeded()

        ground = GroundStation(endpoints, folder=out, record=record and bool(endpoints))
        session = StationSession(
            lambda: ground.vehicles,
            out if open_file is None else open_file.absolute().parent,
            mission=world,
            recorder=ground.recorder if endpoints else None,
            initial_recording=recording,
            describe_link_problems=ground.describe_link_problems,
        )

        async def run_station() -> None:
            try:
                await ground.start()
                for line in ground.describe_link_problems():
                    make_console(stderr=True).print(line, highlight=False, style="yellow", markup=False)
                page.stop_serving()
                await serve_page(session, address, open_browser=False, stop=ending.stop_requested.is_set)
            finally:
                await ground.stop()

        with contextlib.suppress(KeyboardInterrupt), ending:
            asyncio.run(run_station())
    if ground.recorder.path is not None:
        typer.echo(f"Recorded to {ground.recorder.path}")
    if ending.is_hurried:
        raise typer.Exit(ending.exit_status)


def open_browser_in_background(address: PageAddress) -> None:
    """Open the page in the default browser without waiting for it."""
    from mufly.station.page.page_address import open_in_browser

    threading.Thread(target=open_in_browser, args=(address,), daemon=True).start()


def print_page_address(address: PageAddress, links: list[str]) -> None:
    """Print the address of the page, its links, and how to end the station."""
    terminal = make_console(stderr=True)
    for link in links:
        terminal.print(f"The station {link}", highlight=False)
    terminal.print(f"Page: [bold]{address.url}[/bold]   (Ctrl-C ends the station)", soft_wrap=True, highlight=False)
    if address.token:
        terminal.print("This address gives control of the vehicle; the connection is not encrypted.", style="yellow")
