"""``mufly autopilot``: gains and parameter files of other autopilots; and ``mufly link --simulator``."""

from __future__ import annotations

import shlex
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Literal

import typer

from mufly.cli.onboard.view_options import make_foxglove_view
from mufly.cli.options import CommandGroup, JsonOption, VehicleOption, define_argument, define_option
from mufly.cli.output import LiveDisplay, check_output_place, make_console, print_answer, print_lines
from mufly.cli.station import ShutdownHandler, describe_sensor_source, parse_sensor_faults, resolve_wind
from mufly.errors import InputError, convert_write_errors

Autopilot = Literal["px4", "ardupilot", "betaflight"]
_AUTOPILOT_NAMES: dict[Autopilot, str] = {"px4": "PX4", "ardupilot": "ArduPilot", "betaflight": "Betaflight"}
PositionOption = Annotated[
    Literal["vision", "gps"],
    define_option(
        "--position WHICH",
        "Message of the position fixes to another autopilot: vision (VISION_POSITION_ESTIMATE, in a room) or gps.",
    ),
]

app = CommandGroup(
    help="Prepare other autopilots for a vehicle: gains from its linear model, and their parameter file.",
    no_args_is_help=True,
)


@app.command()
def gains(
    autopilot: Annotated[Autopilot, define_argument("px4|ardupilot|betaflight", "Autopilot that flies the vehicle.")],
    vehicle: VehicleOption = "mufly-1.1",
    position: PositionOption = "vision",
    out: Annotated[
        Path | None,
        define_option("--out -o DIR", "Folder for the airframe, parameter or CLI file (PX4, ArduPilot, Betaflight)."),
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """Design the gains of another autopilot for a vehicle, with predicted margins, and write its parameter file.

    The gains of PX4's cascades minimise the error after a step of a disturbance on the linear model of the vehicle \
file, with a limited sensitivity at the actuators and at the commanded acceleration.

    Examples:

      mufly autopilot gains px4 --vehicle mine.toml --out etc/init.d-posix/airframes

      mufly autopilot gains ardupilot --out parameters

      mufly autopilot gains betaflight --out parameters
    """
    if out is not None:
        check_output_place("--out", out, make=False)
    from mufly.bridges.autopilot_gains import design_autopilot_gains
    from mufly.vehicle import load_vehicle

    loaded = load_vehicle(vehicle)
    command = f"mufly autopilot gains {autopilot} --vehicle {shlex.quote(vehicle)}"
    command += f" --position {position}" if autopilot == "px4" else ""
    files: list[Path] = []
    if autopilot == "betaflight":
        from mufly.bridges.betaflight.betaflight_settings import (
            design_betaflight_gains,
            format_cli_file,
            list_betaflight_settings,
        )

        designed = design_betaflight_gains(loaded)
        name, text = f"{loaded.name}-betaflight.txt", format_cli_file(loaded, designed, command)
        parameters = [line._asdict() for line in list_betaflight_settings(designed)]
    elif autopilot == "px4":
        from mufly.bridges.px4.px4_airframe import airframe_file_name, format_airframe_file, list_px4_parameters

        designed = design_autopilot_gains(loaded)
        name, text = airframe_file_name(loaded), format_airframe_file(loaded, designed, position, command)
        parameters = [p._asdict() for p in list_px4_parameters(loaded, designed, position)]
    else:
        from mufly.bridges.ardupilot.ardupilot_parameters import format_parameter_file, list_ardupilot_parameters

        designed = design_autopilot_gains(loaded)
        name, text = f"{loaded.name}.parm", format_parameter_file(loaded, designed, command)
        parameters = [p._asdict() for p in list_ardupilot_parameters(loaded, designed)]
    if out is not None:
        with convert_write_errors(out):
            out.mkdir(parents=True, exist_ok=True)
            files.append(out / name)
            files[0].write_text(text, encoding="utf-8")

    print_answer(
        as_json,
        {"autopilot": autopilot, "gains": designed, "parameters": parameters},
        designed.make_printed_blocks(),
        files,
    )


@app.command()
def load(
    file: Annotated[Path, define_argument("FILE", "CLI file of `mufly autopilot gains betaflight`.")],
    connect: Annotated[
        str, define_option("--connect LINK", "First serial port of Betaflight's SITL.")
    ] = "tcp:127.0.0.1:5761",
) -> None:
    """Send a CLI file to Betaflight's software in the loop; Betaflight saves it and ends, and must be started again.

    Examples:

      mufly autopilot load parameters/mufly-1.1-betaflight.txt
    """
    from mufly.bridges.betaflight.betaflight_cli import send_cli_file
    from mufly.link.ports import parse_endpoint

    endpoint = parse_endpoint(connect, "vehicle", "--connect")
    if endpoint.kind != "tcp":
        raise InputError("--connect", connect, "is no TCP address", "write tcp:127.0.0.1:5761")
    try:
        text = file.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        reason = getattr(error, "strerror", None) or "it is no text"
        raise InputError(str(file), "", reason, "name a file of `mufly autopilot gains betaflight`") from None
    send_cli_file(text, endpoint=endpoint)
    print_lines(f"Betaflight has saved {file} and ended; start it again in the same folder.")


def run_simulator(
    autopilot: Autopilot,
    *,
    mission: str | None,
    vehicle: str,
    ends: Sequence[str] | None,
    origin: str | None,
    out: Path | None,
    wind: tuple[float, ...] | None,
    gust: float | None,
    seed: int,
    sensors: str,
    fault: list[str] | None,
    position: Literal["vision", "gps"],
    speed: float,
    foxglove: str,
) -> None:
    """Simulate the vehicle for another autopilot until Ctrl-C (``mufly link --simulator``)."""
    if sensors != "fitted":
        raise InputError("--sensors", sensors, f"{autopilot} needs simulated sensors", "leave out --sensors")
    if ends is not None and len(ends) > 1:
        raise InputError("--link", "", "a simulator has one endpoint", "give it once")
    from mufly.bridges.ardupilot.ardupilot_link import ARDUPILOT_ENDPOINT
    from mufly.bridges.betaflight.betaflight_link import BETAFLIGHT_ENDPOINT
    from mufly.bridges.px4.px4_link import PX4_ENDPOINT
    from mufly.bridges.simulator_pace import AutopilotSimulator, SimulatorReport, check_real_time_factor
    from mufly.link.codec import parse_global_origin
    from mufly.link.ports import parse_endpoint

    check_real_time_factor(speed, "--speed")
    steady = resolve_wind(wind, gust, seed)
    view_config = make_foxglove_view(foxglove) if foxglove else None
    default = {"px4": PX4_ENDPOINT, "ardupilot": ARDUPILOT_ENDPOINT, "betaflight": BETAFLIGHT_ENDPOINT}[autopilot]
    endpoint = parse_endpoint(ends[0], "vehicle", "--link") if ends else default
    if endpoint.kind != default.kind:
        raise InputError("--link", str(endpoint), f"{autopilot} uses {default.kind}", f"for example {default}")
    place = None if origin is None else parse_global_origin(origin)
    if autopilot != "px4" and (place is not None or position != "vision"):
        given = "--origin" if place is not None else "--position"
        if autopilot == "betaflight":
            raise InputError(given, "", "Betaflight receives no position", "leave it out")
        raise InputError(given, "", "ArduPilot makes its global position itself", "leave it out; see its option --home")
    if out is not None:
        check_output_place("--out", out, make=False)
    from mufly.mission import Mission, load_mission
    from mufly.vehicle import load_vehicle

    helicopter = load_vehicle(vehicle)
    plan = Mission(name="no mission") if mission is None else load_mission(mission)
    faults = parse_sensor_faults(helicopter, "fitted", fault)
    terminal, over = make_console(), ShutdownHandler()
    name = _AUTOPILOT_NAMES[autopilot]
    terminal.print(f"[bold]{helicopter.name}[/bold] is simulated for {name}", highlight=False)
    print_lines(describe_sensor_source(helicopter, "fitted"))
    with LiveDisplay(terminal) as display:
        display.set_live_line("compiling the model")
        from mufly.bridges.ardupilot.ardupilot_link import ARDUPILOT_RATE_HZ, ArduPilotSimulator
        from mufly.bridges.autopilot_plant import AutopilotPlant, warm_up_plant
        from mufly.bridges.betaflight.betaflight_link import BETAFLIGHT_RATE_HZ, BetaflightSimulator
        from mufly.bridges.px4.px4_link import DEFAULT_ORIGIN, PX4_RATE_HZ, Px4Simulator

        rate_Hz = {"px4": PX4_RATE_HZ, "ardupilot": ARDUPILOT_RATE_HZ, "betaflight": BETAFLIGHT_RATE_HZ}[autopilot]
        warm_up_plant(helicopter, rate_Hz)
        if autopilot == "betaflight":
            from mufly.bridges.betaflight.betaflight_pilot import BetaflightPilot
            from mufly.bridges.betaflight.betaflight_settings import design_betaflight_gains

            display.set_live_line("designing the pilot's gains")
            pilot = BetaflightPilot(design_betaflight_gains(helicopter))
    path = None if out is None else out / "flight.mcap"
    plant = AutopilotPlant(
        helicopter, plan, rate_Hz=rate_Hz, autopilot=name, wind=steady, gust=gust, seed=seed, faults=faults, path=path,
    )  # fmt: skip
    with plant, over, LiveDisplay(terminal) as display:
        plant.listeners.append(display.show_event)
        simulator: AutopilotSimulator
        if autopilot == "px4":
            simulator = Px4Simulator(
                plant, endpoint=endpoint, position=position, origin=place or DEFAULT_ORIGIN, speed=speed, where="--link"
            )
        elif autopilot == "betaflight":
            simulator = BetaflightSimulator(plant, pilot, endpoint=endpoint, speed=speed, where="--link")
        else:
            simulator = ArduPilotSimulator(plant, endpoint=endpoint, speed=speed, where="--link")
        view = None if view_config is None else view_config.open_view(plant)
        terminal.print("Ctrl-C ends it.", style="dim")

        def show_report(report: SimulatorReport) -> None:
            display.set_live_line(str(report))
            if view is not None:
                view.serve_requests()

        try:
            simulator.run(over.stop_requested.is_set, show_report)
        finally:
            if view is not None:
                view.close()
    if path is not None:
        print_lines(f"Ended; the recording is in {path}")
    raise typer.Exit(over.exit_status)
