"""``mufly fly``: from a vehicle file to an autonomous mission, in the terminal or in real time.

In real time the vehicle flies in its own process, with the ground station's page or other stations connected.
"""

from __future__ import annotations

import contextlib
import json
import socket
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from mufly.cli.control import parse_design_settings
from mufly.cli.onboard.camera_options import FlightCameraOption, FloorOption, FloorWidthOption, make_position_camera
from mufly.cli.onboard.view_options import FoxgloveOption, RosOption, make_live_views
from mufly.cli.options import (
    JsonOption,
    MethodOption,
    MissionArgument,
    OrderOption,
    SeedOption,
    TunedOption,
    VehicleOption,
    define_option,
)
from mufly.cli.output import LiveDisplay, check_output_place, make_console, print_blocks, print_lines
from mufly.cli.station import (
    BrowserOption,
    FaultOption,
    FirmwareOption,
    FixedPointOption,
    GustOption,
    HostOption,
    PolicyOption,
    PortOption,
    SensorsOption,
    ShutdownHandler,
    TokenOption,
    WindOption,
    choose_dated_folder,
    describe_flight_code,
    describe_sensor_source,
    open_browser_in_background,
    parse_endpoints,
    parse_sensor_faults,
    print_page_address,
    resolve_wind,
    select_control_implementation,
)
from mufly.errors import InputError, MuflyError

if TYPE_CHECKING:
    import xarray as xr
    from rich.console import Console

    from mufly.control import FlightController
    from mufly.flight import FlightProgress, FlightSummary
    from mufly.flight.fixes.camera_sensor import CameraConfig
    from mufly.flight.flight_software import ControlImplementation
    from mufly.flight.record.live_view import LiveViewConfig
    from mufly.link import Endpoint, VehicleProcess
    from mufly.mission import Mission
    from mufly.sensors import Fault
    from mufly.station.page.page_address import PageAddress
    from mufly.station.page.start_page import StartPage, Startup
    from mufly.vehicle import Vehicle

LOADING_STAGE = "loading the libraries"


@dataclass(frozen=True)
class FlightSettings:
    """Checked settings of a flight; ``extra_links`` are additional MAVLink endpoints for ground stations."""

    vehicle: Vehicle
    mission: Mission
    recording_path: Path
    wind: list[float] | None
    gust: float | None
    seed: int
    extra_links: tuple[Endpoint, ...]
    starts_at_once: bool
    is_realtime: bool
    sensors: Literal["ideal", "fitted"]
    faults: tuple[Fault, ...]
    flight_software: ControlImplementation | None
    design_vehicle: Vehicle | None
    camera: CameraConfig | None
    has_external_position: bool = False
    controller: FlightController | None = None
    views: tuple[LiveViewConfig, ...] = ()


@dataclass(frozen=True)
class FlightDisplay:
    """Terminal and, optionally, page that show a flight; ``start_page`` shows the progress of the start-up."""

    terminal: Console
    display: LiveDisplay
    startup: Startup
    shutdown: ShutdownHandler
    page_address: PageAddress | None = None
    start_page: StartPage | None = None


def _find_free_port() -> int:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


def _start_vehicle_process(
    order: FlightSettings, endpoints: Sequence[Endpoint], autostart: bool, startup: Startup
) -> VehicleProcess:
    from mufly.link import start_vehicle_process

    return start_vehicle_process(
        order.vehicle,
        order.mission,
        endpoints=endpoints,
        path=order.recording_path,
        tlog=order.recording_path.with_name("link.tlog") if order.extra_links else None,
        wind=order.wind,
        gust=order.gust,
        seed=order.seed,
        sensors=order.sensors,
        faults=order.faults,
        controllers=order.flight_software,
        designed_for=order.design_vehicle,
        eye=order.camera,
        outside=order.has_external_position,
        autostart=autostart,
        where="--link",
        views=order.views,
        on_stage=startup.begin_stage,
    )


# ----------------------------------------------------------------------------
# ``mufly fly``: from a vehicle file to an autonomous mission.


# One line for each paragraph: the terminal wraps them.
FLY_HELP = """Fly a mission on the full nonlinear model.

Opens the ground station in the browser, from which you fly. The helicopter stands on the floor with its mission \
loaded, by default the demonstration of the muFly dissertation (take off, a square of four waypoints, land). If no \
page connects within 20 s, the mission starts by itself. The command ends with Ctrl-C, or when the flight is over \
and the page is closed. With --headless it flies in the terminal, as fast as the machine can.

The filter uses the sensors of the table \\[sensors] of the vehicle file (`mufly sensors show`), and aligns \
on the floor within two seconds. --sensors ideal flies on the true state, without sensors and filter.

Writes a folder with the recording (flight.mcap; opens in Foxglove and PlotJuggler), summary.json and pictures; \
with --position camera also the camera's pictures (camera.mcap; `mufly slam run` processes them again). \
The exit status is 0 only if the mission succeeded.

Examples:

  mufly fly

  mufly fly box-on-leg --headless --wind 0.5,0,0 --gust 0.3 --seed 7

  mufly fly --headless --fault position.dropout@20s+2s --fault accelerometer.clip@30s

  mufly fly --headless --position camera --camera-fault covered@20s

  mufly fly --headless --position camera --floor parquet.jpg --floor-width 1.2

  mufly fly --position camera --stream 8090      (serves the pictures at http://127.0.0.1:8090/stream)

  mufly fly my-mission.toml --vehicle my-helicopter.toml --out results

  mufly fly --headless --policy hover-policy.json --wind 0.5,0,0 --gust 0.3

  mufly fly --foxglove 8765      (Foxglove connects to ws://127.0.0.1:8765)

  mufly fly --link udp:127.0.0.1:14550      (QGroundControl or a script may fly it too)

  mufly fly --position link --link udpin:127.0.0.1:14560      (position from another program's SLAM)
"""


def fly_mission(
    mission: MissionArgument = "demonstration",
    vehicle: VehicleOption = "mufly-1.1",
    out: Annotated[
        Path | None,
        define_option(
            "--out -o DIR",
            "Folder for the results; results of an earlier flight in it are replaced. Default: flights/<date-time>.",
        ),
    ] = None,
    wind: WindOption = None,
    gust: GustOption = None,
    seed: SeedOption = 0,
    sensors: SensorsOption = "fitted",
    fault: FaultOption = None,
    firmware: FirmwareOption = False,
    fixed_point: FixedPointOption = False,
    policy: PolicyOption = "",
    designed_for: Annotated[
        str | None,
        define_option(
            "--designed-for NAME|FILE",
            "Vehicle for which the controllers and the filter are designed, while --vehicle flies. Default: --vehicle.",
        ),
    ] = None,
    method: MethodOption = "hinf",
    controller_order: OrderOption = None,
    tuned: TunedOption = None,
    position: Annotated[
        Literal["fix", "camera", "link"],
        define_option(
            "--position WHICH",
            "Source of position fixes: fix (simulated V-SLAM with the errors of the vehicle file), camera "
            "(SLAM on rendered pictures, in a process of its own) or link (VISION_POSITION_ESTIMATE from "
            "another program at a --link).",
        ),
    ] = "fix",
    camera: FlightCameraOption = "",
    floor: FloorOption = "",
    floor_width: FloorWidthOption = None,
    camera_fault: Annotated[
        list[str] | None,
        define_option(
            "--camera-fault FAULT",
            "Fault of the camera: covered, dark, unplugged, frozen, mirrored, inverted or dirty, as covered@20s+5s. "
            "Repeat it for more.",
        ),
    ] = None,
    stream: Annotated[
        str,
        define_option(
            "--stream [HOST:]PORT",
            "Address at which to stream the camera's pictures as MJPEG, http://HOST:PORT/stream; with "
            "--position camera or link.",
        ),
    ] = "",
    realtime: Annotated[bool, define_option("--realtime", "Fly in real time.")] = False,
    as_json: JsonOption = False,
    headless: Annotated[
        bool, define_option("--headless", "Fly in the terminal, without a page and as fast as the machine can.")
    ] = False,
    start: Annotated[bool, define_option("--start", "Start the mission at once, without a press on the page.")] = False,
    links: Annotated[
        list[str] | None,
        define_option(
            "--link LINK",
            "MAVLink endpoint for other programs, in real time: udp:HOST:PORT, tcpin:HOST:PORT, "
            "serial:DEVICE:BAUD. Repeat it for more.",
        ),
    ] = None,
    foxglove: FoxgloveOption = "",
    ros: RosOption = False,
    port: PortOption = None,
    host: HostOption = "127.0.0.1",
    token: TokenOption = None,
    browser: BrowserOption = True,
) -> None:
    """Fly a mission on the full nonlinear model."""
    from mufly.station.page.start_page import StartPage, Startup

    terminal, startup, ending = make_console(stderr=as_json), Startup("a flight"), ShutdownHandler()
    with LiveDisplay(terminal) as display, contextlib.ExitStack() as stack:
        if terminal.is_terminal:
            display.follow_startup(startup)
        startup.begin_stage(LOADING_STAGE)
        show = FlightDisplay(terminal, display, startup, ending)
        if not (headless or as_json):
            from mufly.station.page.page_address import bind_page_address

            address = bind_page_address(host, port, token)
            startup.url = address.url
            page = stack.enter_context(StartPage(address, startup))
            show = replace(show, page_address=address, start_page=page)
        steady = resolve_wind(wind, gust, seed)
        folder = out if out is not None else choose_dated_folder()
        check_output_place("--out", folder, make=False)
        ends = parse_endpoints(links, "vehicle")
        from mufly.mission import check_mission_for_vehicle, load_mission
        from mufly.vehicle import load_vehicle

        recording = folder / "flight.mcap"
        helicopter = load_vehicle(vehicle)
        faults = parse_sensor_faults(helicopter, sensors, fault)
        flown = load_mission(mission)
        design_vehicle = None if designed_for is None else load_vehicle(designed_for)
        order = FlightSettings(
            helicopter, flown, recording, steady, gust, seed, tuple(ends), start, realtime, sensors,
            faults, select_control_implementation(firmware, fixed_point, policy, (design_vehicle or helicopter).name),
            design_vehicle,
            make_position_camera(position, sensors, camera, floor, floor_width, flown, mission, camera_fault, stream),
            position == "link", views=make_live_views(foxglove, ros),
        )  # fmt: skip
        if ros and not order.extra_links and show.page_address is None:
            raise InputError("--ros", "", "needs a flight in real time", "leave --headless out, or add --link")
        if tuned or method != "hinf" or controller_order is not None:
            if order.extra_links or show.page_address is not None:
                named = "--tuned" if tuned else "--method"
                raise InputError(named, "", "is for flights in the terminal", "add --headless, without --link")
            from mufly.control import design_flight_controller

            settings = parse_design_settings(method, controller_order, tuned)
            order = replace(
                order, controller=design_flight_controller(order.design_vehicle or order.vehicle, settings=settings)
            )
        if order.has_external_position and not ends:
            remedy = "add --link, as --link udpin:127.0.0.1:14560"
            raise InputError("--position", "", "has no source of positions", remedy)
        if order.camera is not None and not order.has_external_position:
            from mufly.flight.fixes.camera_sensor import replace_fix_by_camera

            replace_fix_by_camera(order.vehicle, order.camera.camera)
        # A vehicle flown by the controllers of another is checked as that other vehicle.
        check_mission_for_vehicle(
            order.design_vehicle or order.vehicle,
            order.mission,
            vehicle_file=designed_for or vehicle,
            mission_file=mission,
        )
        startup.title = f"{order.vehicle.name} flies {order.mission.name}"
        terminal.print(
            f"[bold]{order.vehicle.name}[/bold] flies [bold]{order.mission.name}[/bold]; results go to {folder}"
        )
        if show.page_address is not None:
            print_page_address(show.page_address, [e.explanation for e in ends])
            if browser:
                open_browser_in_background(show.page_address)
        display.follow_startup(startup)
        if policy:
            terminal.print(f"Control law: learned policy {policy}", highlight=False, markup=False)
        _prepare_flight(order, show, firmware)
        heard: list[Path] = []
        if order.extra_links or show.page_address is not None:
            outcome = _fly_in_real_time(order, show)
            if ending.is_hurried or (ending.stop_requested.is_set() and outcome != "succeeded"):
                # When an end is requested, no summary of an unfinished flight is computed.
                what = "the recording up to here is in" if outcome else "no flight took place; the recording is in"
                terminal.print(f"Stopped; {what} {recording}")
                raise typer.Exit(ending.exit_status)
            found = _read_partial_recording(recording)
            if found is None or _stayed_on_ground(found):
                terminal.print(f"No flight took place; the recording is in {folder}")
                raise typer.Exit(1)
            dataset, heard = found, [] if show.page_address is None else sorted(folder.glob("station*.*"))
        else:
            dataset = _fly_in_terminal(order, show)
    ended_s = float(dataset["time"][-1])
    acted = [f for f in faults if f.start_s <= ended_s]
    print_lines(*(f"{f} was active; the events show its detection" for f in acted), mark="Fault")
    print_lines(
        *(f"{f} did not occur: the flight ended at {ended_s:.1f} s" for f in faults if f.start_s > ended_s),
        mark="Warning", style="yellow",
    )  # fmt: skip
    seen = order.camera is not None and not order.has_external_position
    kept = [p for p in (recording, folder / "camera.mcap") if p is recording or seen]
    summary = write_flight_results(terminal, dataset, order.mission, [*kept, *heard], as_json)
    if summary.outcome == "unfinished":
        raise MuflyError(f"the mission was not flown to its end: {summary.reason}")
    if summary.outcome != "succeeded":
        raise MuflyError(f"the mission failed: {summary.reason}")


def _prepare_flight(order: FlightSettings, show: FlightDisplay, firmware: bool) -> None:
    """Build vehicle and controllers before a flight, and print notes on it."""
    terminal = show.terminal
    terminal.print(describe_sensor_source(order.vehicle, order.sensors), highlight=False, markup=False)
    if order.camera is not None and order.camera.stream_address is not None:
        from mufly.camera import is_local_host

        host, number = order.camera.stream_address
        terminal.print(f"The camera's pictures are at http://{host}:{number}/stream", highlight=False, markup=False)
        if not is_local_host(host):
            print_lines(
                f"the pictures are open to every program that can reach {host}:{number}", mark="Warning", style="yellow"
            )
    show.startup.begin_stage("building the estimator")
    if by := describe_flight_code(order.vehicle, order.sensors, firmware):
        terminal.print(by, highlight=False, markup=False)
    if order.extra_links or show.page_address is not None:  # in the terminal the note is among the events
        from mufly.dynamics import describe_excess_wind

        air = order.mission.wind
        beyond = describe_excess_wind(
            order.vehicle,
            air.steady_m_s if order.wind is None else order.wind,
            air.gust_m_s if order.gust is None else order.gust,
        )
        print_lines(*filter(None, [beyond]), mark="Warning", style="yellow")


def _fly_in_terminal(order: FlightSettings, show: FlightDisplay) -> xr.Dataset:
    """Fly the mission to its end, as fast as the machine allows."""
    import mufly.flight as flight

    ending, display = show.shutdown, show.display

    def show_progress(p: FlightProgress) -> None:
        show.startup.mark_succeeded()
        # Between two ticks, where no output is half written.
        ending.waits_for_loop = True
        if ending.stop_requested.is_set():
            raise KeyboardInterrupt
        display.set_live_line(format_progress_line(p))

    ending.waits_for_loop = False
    show.startup.begin_stage("designing the controllers, compiling the model")
    try:
        with ending:
            return flight.fly_mission(
                order.vehicle,
                order.mission,
                wind=order.wind,
                gust=order.gust,
                seed=order.seed,
                sensors=order.sensors,
                faults=order.faults,
                controllers=order.flight_software,
                controller=order.controller,
                realtime=order.is_realtime,
                path=order.recording_path,
                designed_for=order.design_vehicle,
                eye=order.camera,
                views=order.views,
                on_progress=show_progress,
                on_event=display.show_event,
            )
    except KeyboardInterrupt:
        if order.recording_path.exists():
            show.terminal.print(f"Stopped; the recording up to here is in {order.recording_path}")
        raise typer.Exit(ending.exit_status or 130) from None


def _fly_in_real_time(order: FlightSettings, show: FlightDisplay) -> str:
    """Fly in real time with the page, or with MAVLink links only if ``show`` has no page; return the outcome.

    The outcome is empty if no flight took place.
    """
    from mufly.station.page.page_flight import PageFlight, fly_with_page, fly_without_page, list_vehicle_endpoints

    on_event, stop = show.display.show_event, show.shutdown.stop_requested.is_set
    with show.shutdown:
        if show.page_address is None or show.start_page is None:
            for end in order.extra_links:
                show.terminal.print(f"The vehicle {end.explanation}", highlight=False)
            process = _start_vehicle_process(order, order.extra_links, True, show.startup)
            try:
                return fly_without_page(process, show.startup, on_event=on_event, stop=stop)
            except KeyboardInterrupt:
                return ""
        port = _find_free_port()
        process = _start_vehicle_process(
            order, list_vehicle_endpoints(port, order.extra_links), order.starts_at_once, show.startup
        )
        flight = PageFlight(
            process, order.vehicle, order.mission, port, order.recording_path.parent, show.startup,
            starts_at_once=order.starts_at_once, has_camera=order.camera is not None, on_event=on_event,
            on_notice=show.terminal.print, should_stop=stop,
        )  # fmt: skip
        return fly_with_page(flight, show.page_address, show.start_page)


def _read_partial_recording(recording: Path) -> xr.Dataset | None:
    """Return the recording written by the vehicle's process; None if it has no rows."""
    from mufly.flight import read_recording

    try:
        return read_recording(recording)
    except InputError:
        return None


def _stayed_on_ground(dataset: xr.Dataset) -> bool:
    down = dataset["truth_position"].sel(axis="D").values
    return bool((down > down[0] - 0.02).all())


def write_flight_results(
    terminal: Console, dataset: xr.Dataset, mission: Mission, recordings: list[Path], as_json: bool
) -> FlightSummary:
    """Write summary and pictures beside the recordings; print the summary and the names of the files."""
    from rich.markup import escape

    import mufly.flight as flight

    folder, waypoints = recordings[0].parent, [w.position_m for w in mission.waypoint]
    summary = flight.summarise_flight(
        dataset,
        waypoints,
        flight.read_events(dataset),
        take_off=(*mission.start_m, -mission.take_off.height_m),
        reach_m=mission.limits.reach_m,
        world=mission.world,
        realtime_factor=dataset.attrs.get("realtime_factor"),
    )
    text = json.dumps(summary.as_record(), indent=2)
    (folder / "summary.json").write_text(text + "\n", encoding="utf-8")
    pictures = flight.draw_flight_pictures(dataset, folder, waypoints=waypoints, world=mission.world)
    pictures += flight.draw_estimate_pictures(dataset, folder)
    if as_json:
        print(text)
    else:
        print_blocks(*summary.make_printed_blocks())
        names = ", ".join(p.name for p in (*recordings, folder / "summary.json", *pictures))
        terminal.print(f"Written to [bold]{escape(str(folder))}[/bold]: {names}", highlight=False)
    return summary


def format_progress_line(p: FlightProgress) -> str:
    n, e, d = p.position
    return (
        f"{p.time_s:7.1f} s  {p.state:<9}  N {n:5.2f} E {e:5.2f} height {-d:4.2f} m  "
        f"{p.battery_V:.2f} V {p.battery_charge:4.0%} {p.realtime_factor:3.0f}x real time"
    )
