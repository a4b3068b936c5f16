"""``mufly monte-carlo``: a thousand flights of a mission that differ in vehicle, air and chance.

Everything is judged by the truth; see :mod:`mufly.flight.monte_carlo`.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from mufly.cli.options import JsonOption, argument, option
from mufly.cli.present import (
    check_folder,
    console,
    print_json,
    print_table,
    progress_bar,
    save_picture,
    say,
    tell_files,
    writing,
)
from mufly.cli.station import (
    Ending,
    FaultOption,
    FirmwareOption,
    FixedPointOption,
    GustOption,
    SensorsOption,
    VehicleOption,
    WindOption,
    check_air,
    check_sensors,
    flies_on,
    on_board,
    wind_of,
)
from mufly.errors import InputError

if TYPE_CHECKING:
    from collections.abc import Callable

    from mufly.flight.monte_carlo import Campaign, Crew, Flown, Outcome

_SHOWN = 10  # commands printed; all are in commands.txt

# One line a paragraph: the terminal wraps them.
HELP = """Fly a mission many times with other vehicles, air and chance: how often does it succeed, how sure is it?

A flight succeeded if the truth says so: nothing hit, every waypoint passed within --tolerance, landed upright where \
it was to. Flight K of a seed is always the same, whoever flies it: a folder that was stopped (Ctrl-C, a crash) goes \
on with the same command, and more --flights can be added to it.

--vary draws parameters of the vehicle anew for each flight; controllers, autopilot and filter stay those of --vehicle \
(--redesign: made for each). NAME is `parameters` (the whole flight model), a table (rotors), a key (body.mass) or a \
symbol (m); what names fewer parameters takes precedence:

  --vary parameters=10%         uniformly within 10 % either way

  --vary m=+-2g                 uniformly, or m=90:100g, in between

  --vary rotors=normal:3%       normally, with this standard deviation; m=normal:2g

  --vary body=std               normally, as the vehicle file states

  --vary fit.json               as identified: what `mufly identify flight --json` printed

The folder holds flights.nc, flights.csv (with pyarrow flights.parquet), summary.json, pictures, and for each failed \
flight a folder with its full recording and the command that flies it again.

Examples:

  mufly monte-carlo demonstration --flights 1000 --vary parameters=10% --wind 0.5 --gust 0.3

  mufly monte-carlo box-on-leg --flights 200 --fault position.dropout@12s+5s --sensors fitted

  mufly monte-carlo --flights 100 --vary m=90:100g --search 500 --sensors ideal --out heavy
"""


def monte_carlo(
    mission: Annotated[
        str, argument("", "Mission file, or a built-in mission (see: mufly mission list).")
    ] = "demonstration",
    flights: Annotated[int, option("--flights -n N", "How many; 0 for a search alone.", min=0)] = 100,
    vary: Annotated[
        list[str] | None,
        option("--vary WHAT", "What the vehicles differ in (see above); can be given several times."),
    ] = None,
    vehicle: VehicleOption = "mufly-1.1",
    wind: WindOption = None,
    gust: GustOption = None,
    sensors: SensorsOption = "fitted",
    fault: FaultOption = None,
    redesign: Annotated[
        bool, option("--redesign", "Controllers and filter are made anew for each vehicle, and know it.")
    ] = False,
    tolerance: Annotated[
        float,
        option(
            "--tolerance", "How far from a waypoint, and from its mark at the end, is still there.", unit="m"
        ),
    ] = 0.3,
    search: Annotated[
        int,
        option("--search N", "Then look for the worst case by CMA-ES in about so many flights.", min=0),
    ] = 0,
    firmware: FirmwareOption = False,
    fixed_point: FixedPointOption = False,
    seed: Annotated[int, option("--seed", "Seed of the campaign; each flight has its own of it.")] = 0,
    jobs: Annotated[
        int | None, option("--jobs -j N", r"Flights at a time. \[default: one a core]", min=1)
    ] = None,
    cluster: Annotated[
        str | None, option("--cluster ADDRESS", "Scheduler of a dask cluster, as tcp://host:8786.")
    ] = None,
    record: Annotated[
        int | None,
        option("--record N", r"Failed flights flown again with a full recording. \[default: all]", min=0),
    ] = None,
    out: Annotated[
        Path, option("--out -o DIR", "Folder for the results; one that holds a part goes on.")
    ] = Path("monte-carlo"),
    as_json: JsonOption = False,
) -> None:
    """Fly a mission many times with other vehicles, air and chance."""
    if flights + search < 1:
        raise InputError("--flights", "", "no flights", "give 1 or more, or --search")
    if not 0.0 < tolerance <= 10.0:
        raise InputError("--tolerance", "", f"{tolerance:g} m", "give more than 0, and 10 m at most")
    towards = wind_of(wind)
    check_air(None, gust, seed)
    check_folder("--out", out)

    from mufly.mission import load_mission
    from mufly.vehicle import load_vehicle

    helicopter = load_vehicle(vehicle)
    check_sensors(helicopter, sensors, fault)
    controllers = on_board(firmware, fixed_point)
    by = tuple(word for word, wanted in (("--firmware", firmware), ("--fixed-point", fixed_point)) if wanted)

    from mufly.firmware import QuickSoftware
    from mufly.flight.monte_carlo import Campaign, Crew, parse_variations
    from mufly.flight.monte_carlo import run as fly_all
    from mufly.flight.monte_carlo import search as find_worst

    campaign = Campaign.of(
        helicopter, load_mission(mission), variations=parse_variations(vary or [], helicopter), wind=towards,
        gust=gust, sensors="ideal" if sensors == "ideal" else "fitted", faults=tuple(fault or ()), seed=seed,
        tolerance_m=tolerance, redesign=redesign, controllers=controllers, quickly=QuickSoftware,
        computed_by=by, vehicle_name=vehicle, mission_name=mission,
    )  # fmt: skip
    if search and not campaign.searched:
        raise InputError(
            "--search",
            "",
            "nothing varies but chance",
            "vary something with --vary or --wind, or leave it out",
        )
    if not as_json:
        _announce(campaign)
    ending = Ending()
    sought: list[Flown] = []
    flown: list[Flown] = []
    with ending, Crew(jobs, cluster=cluster) as crew:
        stop = ending.asked.is_set
        if flights:
            with progress_bar("Flying", not as_json) as progress:
                flown = fly_all(campaign, flights, crew=crew, folder=out, progress=progress, stop=stop)
        if search and not stop():
            with progress_bar("Searching", not as_json) as progress:
                sought = find_worst(campaign, search, crew=crew, folder=out, progress=progress, stop=stop)
        commands: list[tuple[Flown, str]] = []
        files: list[Path] = []
        if not stop():
            with progress_bar("Recording", not as_json) as progress:
                commands, files = _again(campaign, flown, sought, out, record, crew, stop, progress)
    if stop():
        done = f"{len(flown)} of {flights} flights" + (f" and {len(sought)} of the search" if search else "")
        console(stderr=True).print(f"Stopped: {done} are in {out}; the same command goes on", highlight=False)
        raise typer.Exit(ending.status)
    _finish(campaign, flown, sought, out, commands, files, as_json)


def _announce(campaign: Campaign) -> None:
    keys = {key for v in campaign.variations for key in v.keys}
    varied = f", {len(keys)} parameters vary" if keys else ", all alike but for chance"
    software = "made for each" if campaign.redesign else f"those of {campaign.vehicle.name}"
    say(
        f"{campaign.vehicle.name} flies {campaign.mission_name}{varied}; controllers and filter are {software}"
    )
    say(flies_on(campaign.vehicle, campaign.sensors))
    say(*(f"{v.text}: {v.note}" for v in campaign.variations if v.note), mark="Note", style="yellow")


def _again(
    campaign: Campaign, flown: Sequence[Flown], sought: Sequence[Flown], out: Path, record: int | None, crew: Crew,
    stop: Callable[[], bool], progress: Callable[[int, int], None] | None,
) -> tuple[list[tuple[Flown, str]], list[Path]]:  # fmt: skip
    """Fly failed flights and the worst ones again with a recording; return them with their commands, and files."""
    from mufly.flight.monte_carlo import case_of, worst_first
    from mufly.flight.monte_carlo.campaign import differences
    from mufly.vehicle import vehicle_toml

    failed = [f for f in flown if not f.success]
    chosen = {
        out / "failed" / f"{f.index:05d}": f for f in failed[: len(failed) if record is None else record]
    }
    left = [f for f in worst_first(flown, campaign.tolerance_m) if f.success][:1]
    chosen |= {out / "worst" / f"{f.index:05d}": f for f in left}
    chosen |= {out / "search" / f"{f.index:05d}": f for f in worst_first(sought, campaign.tolerance_m)[:1]}
    commands: list[tuple[Flown, str]] = []
    orders = []
    for folder, f in chosen.items():
        case = case_of(f)
        vehicle_file = folder / "vehicle.toml" if case.values else None
        command = campaign.command(case, folder, vehicle_file)
        with writing(folder):
            folder.mkdir(parents=True, exist_ok=True)
            if vehicle_file is not None:
                vehicle_file.write_text(vehicle_toml(campaign.drawn(case)), encoding="utf-8")
            (folder / "command.txt").write_text(command + "\n", encoding="utf-8")
        commands.append((f, command))
        recording = folder / "flight.mcap"
        if not recording.exists():
            orders.append((case, recording.with_suffix(".part.mcap")))
    before = {(f.index, f.seed): f for f in chosen.values()}
    paths = {case.index: path for case, path in orders}
    for done, f in enumerate(crew.fly(campaign, orders, stop), 1):
        path = paths[f.index]
        changed = differences(f, before[f.index, f.seed])
        if changed:
            say(
                f"flight {f.index} was not the same when flown again ({', '.join(changed)})",
                mark="Warning",
                style="red",
            )
        if path.exists():  # one that was refused before it began has none
            with writing(path):
                path.rename(path.with_name("flight.mcap"))
        if progress is not None:
            progress(done, len(orders))
    return commands, [folder / "flight.mcap" for folder in chosen if (folder / "flight.mcap").exists()]


def _finish(
    campaign: Campaign, flown: Sequence[Flown], sought: Sequence[Flown], out: Path,
    commands: Sequence[tuple[Flown, str]], recordings: Sequence[Path], as_json: bool,
) -> None:  # fmt: skip
    """Write tables, pictures and summary, and say what they say."""
    from mufly.flight.monte_carlo import outcome_of, severity, worst_first
    from mufly.results import plain

    files = [*_write(campaign, flown, out, "flights"), *_write(campaign, sought, out, "search")]
    outcome = outcome_of(flown, campaign.tolerance_m) if flown else None
    worst = worst_first(sought, campaign.tolerance_m)[:1]
    content = {
        "outcome": plain(outcome),
        "worst_found": plain(worst[0]) if worst else None,
        "commands": {f"{f.index}": command for f, command in commands},
    }
    with writing(out):
        (out / "summary.json").write_text(json.dumps(content, indent=2) + "\n", encoding="utf-8")
        (out / "commands.txt").write_text("".join(f"{c}\n" for _, c in commands), encoding="utf-8")
    files += [out / "summary.json", out / "commands.txt"]
    if as_json:
        print_json({**content, "files": [str(f) for f in files]})
        return
    if outcome is not None:
        _print(outcome)
    if worst:
        f = worst[0]
        share = severity(f, campaign.tolerance_m)
        said = f"it failed: {f.reason}" if not f.success else f"{100 * share:.0f} % of what is allowed"
        say(f"Worst of {len(sought)} flights of the search is {f.index}: {said}")
    if commands:
        say("", "To fly these again:")
        say(*(command for _, command in commands[:_SHOWN]))
        if len(commands) > _SHOWN:
            say(f"and {len(commands) - _SHOWN} more, in {out / 'commands.txt'}")
    if recordings:
        say(f"Recorded already: {len(recordings)} (flight.mcap in their folders).")
    tell_files(files)


def _write(campaign: Campaign, flown: Sequence[Flown], out: Path, name: str) -> list[Path]:
    """Tables and pictures of some flights."""
    if not flown:
        return []
    from mufly.flight.monte_carlo import draw_distributions, draw_influences, table_of
    from mufly.study import write_results

    table = table_of(flown, campaign)
    files = write_results(table, out, name)
    try:
        import pyarrow  # noqa: F401  an extra
    except ImportError:
        pass
    else:
        files.append(out / f"{name}.parquet")
        with writing(out):
            table.to_dataframe().to_parquet(files[-1])
    title = f"{campaign.vehicle.name}, {campaign.mission_name}"
    files.append(
        save_picture(draw_distributions(flown, campaign.tolerance_m, title), out, f"{name}-distributions")
    )
    influences = draw_influences(flown, campaign)
    if influences is not None:
        files.append(save_picture(influences, out, f"{name}-influences"))
    return files


def _print(outcome: Outcome) -> None:
    good = outcome.successes == outcome.flights
    say(f"{outcome.in_words()}.", style="green" if good else "yellow")
    if outcome.claimed != outcome.successes:
        say(f"By what the state machine says it would be {outcome.claimed}.", style="yellow")
    if outcome.refused:
        say(f"{outcome.refused} draws were vehicles that cannot be; others were drawn in their place.")
    say(*(f"{count} x {reason}" for reason, count in outcome.reasons), mark="Failed")
    rows = [
        (w.label, f"{w.median:.3g}", f"{w.percentile_95:.3g}", f"{w.worst:.3g}", "" if w.unit == "1" else w.unit,
         str(w.flight), "" if w.beyond is None else str(w.beyond))
        for w in outcome.worst
    ]  # fmt: skip
    print_table(("", "median", "95 %", "worst", "unit", "flight", "beyond allowed"), rows)
