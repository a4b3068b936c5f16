"""``mufly link``: the simulated helicopter as a MAVLink vehicle in real time."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from mufly.cli.onboard.external_autopilots import PositionOption, run_simulator
from mufly.cli.onboard.view_options import FoxgloveOption, RosOption, make_live_views
from mufly.cli.options import OptionalMissionArgument, SeedOption, VehicleOption, define_option
from mufly.cli.output import LiveDisplay, check_output_place, make_console, print_lines
from mufly.cli.station import (
    FaultOption,
    FirmwareOption,
    GustOption,
    SensorsOption,
    ShutdownHandler,
    WindOption,
    describe_flight_code,
    describe_sensor_source,
    parse_endpoints,
    parse_sensor_faults,
    resolve_wind,
    select_control_implementation,
)
from mufly.errors import InputError, MuflyError

if TYPE_CHECKING:
    from mufly.link import LoopReport

# One line for each paragraph: the terminal wraps them.
LINK_HELP = """Run the simulated helicopter as a MAVLink vehicle, in real time.

QGroundControl, MAVSDK, MAVProxy and pymavlink scripts can arm it, take off, upload missions in metres, stream \
offboard set-points and change parameters. By default the vehicle sends to the UDP ports 14550 and 14540 of this \
machine, where these programs listen.

Without a mission the vehicle stands in an empty hall and waits for commands. With a mission, the mission is loaded \
and its walls and obstacles are present; a ground station starts the flight. Ctrl-C ends the command.

Examples:

  mufly link

  mufly link box-on-leg --out flights/today

  mufly link --link udpin:0.0.0.0:14550 --link serial:/dev/ttyUSB0:57600 --origin 47.3769,8.5417,408

  mufly link --ros --foxglove 8765

  mufly link --simulator px4 --wind 0.5 --out flights/px4
"""


def run_link(
    mission: OptionalMissionArgument = None,
    vehicle: VehicleOption = "mufly-1.1",
    ends: Annotated[
        list[str] | None,
        define_option(
            "--link --connect ENDPOINT",
            "MAVLink endpoint of stations: udp:HOST:PORT (send there), udpin:HOST:PORT (listen), "
            "tcpin:HOST:PORT, tcp:HOST:PORT, serial:DEVICE:BAUD. Repeat it for more. Default: "
            "udp:127.0.0.1:14550 and udp:127.0.0.1:14540.",
        ),
    ] = None,
    system: Annotated[int, define_option("", "MAVLink system number of the vehicle, 1 to 255.")] = 1,
    origin: Annotated[
        str | None,
        define_option(
            "LAT,LON,ALT",
            "Global position of N = E = D = 0 (degrees, metres), for programs that require one.",
        ),
    ] = None,
    out: Annotated[
        Path | None,
        define_option(
            "--out -o DIR",
            "Folder for a recording: flight.mcap and link.tlog; those of an earlier flight are replaced.",
        ),
    ] = None,
    wind: WindOption = None,
    gust: GustOption = None,
    seed: SeedOption = 0,
    sensors: SensorsOption = "fitted",
    fault: FaultOption = None,
    firmware: FirmwareOption = False,
    qemu: Annotated[
        bool,
        define_option(
            "--qemu",
            "Fly the image of a board on a Cortex-M4 emulated by QEMU, commanded by MAVLink on the board's "
            "UART "
            "(docs/reference/firmware.md).",
        ),
    ] = False,
    uart: Annotated[
        int, define_option("--uart PORT", "TCP port of the UART of --qemu, on this machine.", min=1, max=65535)
    ] = 5760,
    receiver: Annotated[
        Literal["crsf", "sbus"] | None,
        define_option(
            "--receiver",
            "Connect a pilot's receiver of this protocol, with --qemu; its UART is the TCP port after --uart.",
        ),
    ] = None,
    simulator: Annotated[
        Literal["px4", "ardupilot", "betaflight"] | None,
        define_option(
            "--simulator AUTOPILOT",
            "Simulate the vehicle for px4 (MAVLink in lockstep, TCP 4560), ardupilot (JSON, UDP 9002) or betaflight "
            "(UDP 9003, with a pilot), which flies it in place of mufly's own flight software; --link gives another "
            "address, --foxglove shows the flight (docs/how-to/fly-with-px4.md).",
        ),
    ] = None,
    position: PositionOption = "vision",
    speed: Annotated[
        float,
        define_option(
            "--speed", "Speed of --simulator relative to real time, 0 (as fast as possible) to 100.", unit=""
        ),
    ] = 1.0,
    foxglove: FoxgloveOption = "",
    ros: RosOption = False,
) -> None:
    """Run the simulated helicopter as a MAVLink vehicle, in real time."""
    if (simulator is not None and ros) or (qemu and (foxglove or ros)):
        which = "--foxglove" if foxglove and qemu else "--ros"
        raise InputError(which, "", "shows flights of mufly's own flight software", "leave it out")
    if simulator is not None:
        for name, chosen in {"--qemu": qemu, "--firmware": firmware}.items():
            if chosen:
                raise InputError(name, "", f"with --simulator {simulator} flies", "leave it out")
        run_simulator(
            simulator, mission=mission, vehicle=vehicle, ends=ends, origin=origin, out=out, wind=wind, gust=gust,
            seed=seed, sensors=sensors, fault=fault, position=position, speed=speed, foxglove=foxglove,
        )  # fmt: skip
        return
    if qemu:
        given = {"--link": ends, "--origin": origin, "--firmware": firmware}
        for name, one in given.items():
            if one:
                raise InputError(name, "", "the emulated board has a link of its own", "leave it out, use --uart")
        steady = resolve_wind(wind, gust, seed)
        _run_emulated_board(mission or "demonstration", vehicle, steady, gust, seed, fault, out, uart, receiver or "")
        return
    if receiver is not None:
        raise InputError("--receiver", receiver, "connects to the board of --qemu", "add --qemu")
    endpoints = parse_endpoints(ends or _DEFAULT_LINK_ENDPOINTS, "vehicle", each="endpoint")
    if not 1 <= system <= 255:
        raise InputError("--system", "", f"{system} is not a MAVLink system", "give 1 to 255")
    steady = resolve_wind(wind, gust, seed)
    views = make_live_views(foxglove, ros)
    if out is not None:
        check_output_place("--out", out, make=False)

    # Errors of the input are found before the heavy libraries are loaded.
    from mufly.link.codec import parse_global_origin
    from mufly.mission import Mission, check_mission_for_vehicle, load_mission
    from mufly.vehicle import load_vehicle

    place = None if origin is None else parse_global_origin(origin)
    helicopter = load_vehicle(vehicle)
    plan = Mission(name="no mission") if mission is None else load_mission(mission)
    if mission is not None:
        check_mission_for_vehicle(helicopter, plan, vehicle_file=vehicle, mission_file=mission)
    faults = parse_sensor_faults(helicopter, sensors, fault)
    controllers = select_control_implementation(firmware)

    from mufly.station.page.start_page import Startup

    terminal = make_console()
    terminal.print(f"[bold]{helicopter.name}[/bold] is MAVLink system {system}, with {plan.name}", highlight=False)
    print_lines(describe_sensor_source(helicopter, sensors))
    for end in endpoints:
        print_lines(f"  the vehicle {end.explanation}")
        if end.is_beyond_loopback:
            print_lines(
                f"  every program that can reach {end.host} port {end.port} can command it: MAVLink has no password",
                style="yellow",
            )
    startup = Startup()
    with LiveDisplay(terminal) as display:
        display.follow_startup(startup)
        startup.begin_stage("building the estimator")
        print_lines(*filter(None, [describe_flight_code(helicopter, sensors, firmware)]))
        startup.begin_stage("loading the libraries")
        from mufly.control import design_flight_controller
        from mufly.flight import Flight
        from mufly.link import TlogWriter, VehicleLink, fly_in_real_time
        from mufly.link.real_time.real_time_loop import precompile_flight_code
        from mufly.link.real_time.vehicle_process import STAGE_COMPILING, STAGE_DESIGNING

        startup.begin_stage(STAGE_DESIGNING)
        controller = design_flight_controller(helicopter)
        startup.begin_stage(STAGE_COMPILING)
        precompile_flight_code(helicopter, controller, sensors)
        startup.mark_succeeded()
    recording = None if out is None else out / "flight.mcap"
    flight = Flight(
        helicopter, plan, controller=controller, wind=steady, gust=gust, seed=seed, path=recording, keep=False,
        sensors=sensors, faults=faults, controllers=controllers,
    )  # fmt: skip
    print_lines(*filter(None, [flight.outside_model_note]), mark="Warning", style="yellow")
    log = None if out is None else TlogWriter(out / "link.tlog")
    over = ShutdownHandler()
    try:
        with flight, over, LiveDisplay(terminal) as display:
            pace = fly_in_real_time(
                flight,
                endpoints,
                link=VehicleLink(flight, system=system, origin=place),
                stop=over.stop_requested.is_set,
                tlog=log,
                on_event=display.show_event,
                on_notice=display.show_notice,
                on_open=lambda: terminal.print("Ctrl-C ends it.", style="dim"),
                on_report=lambda report: display.set_live_line(_format_loop_report(report)),
                where="--link",
                views=views,
            )
            flight.close(*flight.judge_outcome(), **pace.recording_attributes)
    finally:
        if log is not None:
            log.close()
    if recording is not None:
        print_lines(f"Ended; the recording is in {recording}, the telemetry log beside it")
    raise typer.Exit(over.exit_status)


def _run_emulated_board(
    mission: str, vehicle: str, wind: list[float] | None, gust: float | None, seed: int, fault: list[str] | None,
    out: Path | None, uart: int, receiver: str,
) -> None:  # fmt: skip
    """Fly the image of a board in QEMU until Ctrl-C; stations connect to its UART."""
    if out is not None:
        check_output_place("--out", out, make=False)
    from mufly.firmware.emulated.board_link import run_linked_board
    from mufly.mission import check_mission_for_vehicle, load_mission
    from mufly.vehicle import load_vehicle

    helicopter, plan = load_vehicle(vehicle), load_mission(mission)
    check_mission_for_vehicle(helicopter, plan, vehicle_file=vehicle, mission_file=mission)
    faults = parse_sensor_faults(helicopter, "fitted", fault)
    terminal, over = make_console(), ShutdownHandler()
    with over, LiveDisplay(terminal) as display:
        display.set_live_line("building the board's image")
        flown = run_linked_board(
            helicopter, plan, port=uart, receiver=receiver, receiver_port=uart + 1, wind=wind, gust=gust, seed=seed,
            faults=faults, path=None if out is None else out / "flight.mcap", on_event=display.show_event,
            stop=lambda flight: over.stop_requested.is_set(),
            on_open=lambda: terminal.print(
                f"The UART of the emulated board is tcp:127.0.0.1:{uart}"
                f"{f', that of its receiver tcp:127.0.0.1:{uart + 1}' if receiver else ''}. Ctrl-C ends it.",
                highlight=False,
            ),
        )  # fmt: skip
    slower = " (slower than real time)" if flown.realtime_factor < MIN_REAL_TIME_FACTOR else ""
    terminal.print(f"{flown.realtime_factor:.2f} times real time{slower}.", highlight=False)
    if flown.mismatch_count:
        raise MuflyError(f"the emulated board differs from this machine: {flown.first_mismatch}")
    terminal.print(f"No byte of its memory differs from this machine's in {flown.periods} periods.", highlight=False)
    raise typer.Exit(over.exit_status)


MIN_REAL_TIME_FACTOR = 0.95
"""Real-time factor below which a warning is printed."""
_DEFAULT_LINK_ENDPOINTS = ("udp:127.0.0.1:14550", "udp:127.0.0.1:14540")


def _format_loop_report(r: LoopReport) -> str:
    """Return the state of the real-time loop and of its vehicle as a line of text."""
    from mufly.link.telemetry_streams import SLOW_REAL_TIME_FACTOR

    s = r.state
    who = f"commanded by {r.commander}" if r.commander else "no commands"
    slipped = f", {r.slip_count} timing overruns, {r.lost_time_s:.1f} s dropped" if r.slip_count else ""
    slow = f"  REAL-TIME FACTOR {r.real_time_factor:.2f}" if r.real_time_factor < SLOW_REAL_TIME_FACTOR else ""
    return (
        f"{s.time_s:7.1f} s  {s.state:<9}  {'armed' if s.armed else 'disarmed'}  {-s.estimate.position[2]:5.2f} m  "
        f"{s.estimate.battery_voltage:.2f} V  {who}  in {r.received_rate_Hz:.0f}/s, out {r.sent_rate_Hz:.0f}/s  "
        f"late {r.mean_lateness_ms:.1f} ms{slipped}{slow}"
    )
