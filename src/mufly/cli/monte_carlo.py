"""``mufly monte-carlo``: many flights of a mission with different vehicles, air and random seeds.

Flights are judged by the truth; see :mod:`mufly.flight.monte_carlo`.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from mufly.cli.control import parse_design_settings
from mufly.cli.onboard.camera_options import FlightCameraOption, FloorOption, FloorWidthOption, make_position_camera
from mufly.cli.options import (
    ClusterOption,
    JsonOption,
    MethodOption,
    MissionArgument,
    OrderOption,
    TunedOption,
    VehicleOption,
    define_option,
)
from mufly.cli.output import (
    check_output_place,
    make_console,
    print_answer,
    print_blocks,
    print_lines,
    progress_bar,
    write_text_file,
)
from mufly.cli.station import (
    FaultOption,
    FirmwareOption,
    FixedPointOption,
    GustOption,
    PolicyOption,
    SensorsOption,
    ShutdownHandler,
    WindOption,
    describe_sensor_source,
    parse_sensor_faults,
    parse_wind_option,
    resolve_wind,
    select_control_implementation,
)
from mufly.errors import InputError

if TYPE_CHECKING:
    from mufly.flight.monte_carlo import Campaign, FlightResult, RecordedFlights

_MAX_PRINTED_COMMANDS = 10  # commands printed; all are in commands.txt

# One line for each paragraph: the terminal wraps them.
MONTE_CARLO_HELP = """Fly a mission many times with varied vehicle, wind and noise; report the success rate.

A flight succeeds if its true path has no collision, passes every waypoint within --tolerance, and ends upright on \
the landing mark. Flight K of a seed is the same on every machine. A stopped campaign (Ctrl-C, a crash) \
resumes with the same command; a larger --flights extends it.

--vary draws parameters of the true vehicle for each flight, all together. With --untold, the default, controllers, \
filter and fault detection stay designed for --vehicle. With --redesign they are designed for each drawn vehicle, \
except for the mounting angles sensors.imu.mount_...

NAME is `parameters` (the whole flight model), a table (rotors, sensors.imu), a key (body.mass) or a symbol (m). The \
variation with fewer parameters takes precedence:

  --vary parameters=10%         uniformly within 10 % either way

  --vary m=+-2g                 uniformly within 2 g either way; m=90:100g: between both

  --vary sensors.position_fix.drift=50:300%    uniformly, between shares of the file's value

  --vary standard               sensor errors, delays, mounting, mass and thrust at once (docs/reference/monte-carlo.md)

  --vary rotors=normal:3%       normally, with this standard deviation; m=normal:2g

  --vary body=std               normally, as the vehicle file states

  --vary fit.json               with the covariance that `mufly identify flight --json` printed

The folder holds flights.nc, flights.csv (with pyarrow flights.parquet), summary.json, pictures, and for each failed \
flight a folder with its full recording and the command that repeats it.

Examples:

  mufly monte-carlo demonstration --flights 1000 --vary parameters=10% --wind 0.5 --gust 0.3

  mufly monte-carlo demonstration --flights 500 --vary standard --untold --wind 0.5 --gust 0.3

  mufly monte-carlo box-on-leg --flights 200 --fault position.dropout@12s+5s --sensors fitted

  mufly monte-carlo --flights 20 --position camera --floor parquet.jpg --floor-width 1.2

  mufly monte-carlo --flights 100 --vary m=90:100g --search 500 --sensors ideal --out heavy
"""


def run_monte_carlo(
    mission: MissionArgument = "demonstration",
    flights: Annotated[int, define_option("--flights -n N", "Number of flights; 0: only the search.", min=0)] = 100,
    vary: Annotated[
        list[str] | None,
        define_option("--vary WHAT", "Parameters to vary and by how much (see above). Repeat it for more."),
    ] = None,
    vehicle: VehicleOption = "mufly-1.1",
    wind: WindOption = None,
    gust: GustOption = None,
    sensors: SensorsOption = "fitted",
    fault: FaultOption = None,
    position: Annotated[
        Literal["fix", "camera"],
        define_option(
            "--position WHICH",
            "Source of position fixes: fix (simulated V-SLAM with the errors of the vehicle file) or camera (SLAM on "
            "rendered pictures).",
        ),
    ] = "fix",
    camera: FlightCameraOption = "",
    floor: FloorOption = "",
    floor_width: FloorWidthOption = None,
    untold: Annotated[
        bool,
        define_option(
            "--untold/--redesign",
            "Design controllers, filter and fault detection for the nominal vehicle, or for the varied "
            "vehicle of each flight.",
        ),
    ] = True,
    method: MethodOption = "hinf",
    order: OrderOption = None,
    tuned: TunedOption = None,
    tolerance: Annotated[
        float,
        define_option(
            "--tolerance",
            "Largest distance from a waypoint, and from the landing mark, that counts as reached.",
            unit="m",
        ),
    ] = 0.3,
    search: Annotated[
        int,
        define_option(
            "--search N", "Number of flights of a search for the worst case (CMA-ES), after the others; 0: none.", min=0
        ),
    ] = 0,
    firmware: FirmwareOption = False,
    fixed_point: FixedPointOption = False,
    policy: PolicyOption = "",
    seed: Annotated[int, define_option("--seed", "Seed of the campaign, from which each flight's seed is drawn.")] = 0,
    jobs: Annotated[
        int | None, define_option("--jobs -j N", "Parallel flights. Default: one for each core.", min=1)
    ] = None,
    cluster: ClusterOption = None,
    record: Annotated[
        int | None,
        define_option("--record N", "Number of failed flights to repeat with a full recording. Default: all.", min=0),
    ] = None,
    out: Annotated[
        Path, define_option("--out -o DIR", "Folder for the results; a stopped campaign resumes there.")
    ] = Path("monte-carlo"),
    as_json: JsonOption = False,
) -> None:
    """Fly a mission many times with drawn vehicle parameters, wind and sensor errors."""
    if flights + search < 1:
        raise InputError("--flights", "", "no flights", "give 1 or more, or --search")
    if not 0.0 < tolerance <= 10.0:
        raise InputError("--tolerance", "", f"{tolerance:g} m", "give more than 0, and 10 m at most")
    towards = parse_wind_option(wind)
    resolve_wind(None, gust, seed)
    check_output_place("--out", out)

    from mufly.mission import load_mission
    from mufly.vehicle import load_vehicle

    helicopter = load_vehicle(vehicle)
    parse_sensor_faults(helicopter, sensors, fault)
    controllers = select_control_implementation(firmware, fixed_point, policy, helicopter.name)
    by = tuple(word for word, wanted in (("--firmware", firmware), ("--fixed-point", fixed_point)) if wanted)
    by += ("--policy", policy) if policy else ()
    by += () if method == "hinf" else ("--method", method)
    by += () if order is None else ("--order", str(order))
    by += tuple(word for file in tuned or () for word in ("--tuned", file))

    from mufly.firmware import GenericFirmwareSoftware
    from mufly.flight.monte_carlo import (
        Campaign,
        RecordedFlights,
        WorkerPool,
        parse_variations,
        record_notable_flights,
    )
    from mufly.flight.monte_carlo import run_campaign as fly_all
    from mufly.flight.monte_carlo import search_worst_case as find_worst

    flown_mission = load_mission(mission)
    controller = None
    if tuned or method != "hinf" or order is not None:
        from mufly.control import design_flight_controller

        if not untold:
            raise InputError(
                "--tuned" if tuned else "--method",
                "",
                "gives one controller design for all flights",
                "leave out --redesign",
            )
        controller = design_flight_controller(helicopter, settings=parse_design_settings(method, order, tuned))
    campaign = Campaign.create_checked(
        helicopter, flown_mission, variations=parse_variations(vary or [], helicopter), wind=towards,
        gust=gust, sensors=sensors, faults=tuple(fault or ()), seed=seed,
        tolerance_m=tolerance, redesign=not untold, controllers=controllers, fast_controllers=GenericFirmwareSoftware,
        controller_options=by, vehicle_name=vehicle, mission_name=mission, camera_name=camera or "mufly-2.0",
        camera=make_position_camera(position, sensors, camera, floor, floor_width, flown_mission, mission),
        controller=controller,
    )  # fmt: skip
    if search and not campaign.search_dimension:
        raise InputError(
            "--search",
            "",
            "only the noise varies",
            "vary something with --vary or --wind, or omit the option",
        )
    if not as_json:
        _print_campaign(campaign)
    ending = ShutdownHandler()
    sought: list[FlightResult] = []
    flown: list[FlightResult] = []
    with ending, WorkerPool(jobs, cluster=cluster) as crew:
        stop = ending.stop_requested.is_set
        if flights:
            with progress_bar("Flying", not as_json) as progress:
                flown = fly_all(campaign, flights, crew=crew, folder=out, progress=progress, stop=stop)
        if search and not stop():
            with progress_bar("Searching", not as_json) as progress:
                sought = find_worst(campaign, search, crew=crew, folder=out, progress=progress, stop=stop)
        recorded = RecordedFlights([], [])
        if not stop():
            with progress_bar("Recording", not as_json) as progress:
                recorded = record_notable_flights(
                    campaign, flown, sought, out, crew, most=record, stop=stop, progress=progress,
                    on_notice=lambda text: print_lines(text, mark="Warning", style="red"),
                )  # fmt: skip
    if stop():
        done = f"{len(flown)} of {flights} flights" + (f" and {len(sought)} of the search" if search else "")
        make_console(stderr=True).print(f"Stopped: {done} are in {out}; the same command resumes", highlight=False)
        raise typer.Exit(ending.exit_status)
    _write_and_print_results(campaign, flown, sought, out, recorded, as_json)


def _print_campaign(campaign: Campaign) -> None:
    software = "designed for each vehicle" if campaign.redesign else f"those of {campaign.vehicle.name}"
    what = f"{campaign.vehicle.name} flies {campaign.mission_name}, {campaign.describe_onboard_knowledge()}"
    print_lines(f"{what}; controllers and filter are {software}")
    print_lines(describe_sensor_source(campaign.vehicle, campaign.sensors))
    print_lines(*(f"{v.request_text}: {v.note}" for v in campaign.variations if v.note), mark="Note", style="yellow")


def _write_and_print_results(
    campaign: Campaign, flown: Sequence[FlightResult], sought: Sequence[FlightResult], out: Path,
    recorded: RecordedFlights, as_json: bool,
) -> None:  # fmt: skip
    """Write tables, pictures and summary, and print the results."""
    from mufly.flight.monte_carlo import (
        campaign_to_dict,
        flight_severity,
        sort_by_severity,
        summarise_outcome,
        write_campaign_results,
    )
    from mufly.results import to_plain_data

    files = [
        *write_campaign_results(campaign, flown, out, "flights"),
        *write_campaign_results(campaign, sought, out, "search"),
    ]
    outcome = summarise_outcome(flown, campaign.tolerance_m) if flown else None
    worst = sort_by_severity(sought, campaign.tolerance_m)[:1]
    commands = [command for _, command in recorded.commands]
    content = {
        "campaign": to_plain_data(campaign_to_dict(campaign)),
        "outcome": to_plain_data(outcome),
        "worst_found": to_plain_data(worst[0]) if worst else None,
        "commands": {f"{f.index}": command for f, command in recorded.commands},
    }
    files += [
        write_text_file(out / "summary.json", json.dumps(content, indent=2) + "\n"),
        write_text_file(out / "commands.txt", "".join(f"{c}\n" for c in commands)),
    ]

    def print_outcome() -> None:
        if outcome is not None:
            print_blocks(*outcome.make_printed_blocks())
        for f in worst:
            share = flight_severity(f, campaign.tolerance_m)
            said = f"failed: {f.reason}" if not f.success else f"{100 * share:.0f} % of the limits"
            print_lines(f"Worst of {len(sought)} flights of the search is {f.index}: {said}")
        if commands:
            print_lines("", "Commands that repeat these flights:", *commands[:_MAX_PRINTED_COMMANDS])
        if len(commands) > _MAX_PRINTED_COMMANDS:
            print_lines(f"and {len(commands) - _MAX_PRINTED_COMMANDS} more, in {out / 'commands.txt'}")
        if recorded.recordings:
            print_lines(f"Recordings: {len(recorded.recordings)} (flight.mcap in their folders).")

    print_answer(as_json, content, print_outcome, files)
