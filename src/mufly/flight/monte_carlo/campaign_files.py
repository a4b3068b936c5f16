"""Files of a campaign: tables and pictures of its flights, and recordings of failed and worst flights."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import NamedTuple

from mufly.errors import convert_write_errors
from mufly.flight.monte_carlo.campaign import Campaign, FlightResult, list_differing_result_fields
from mufly.flight.monte_carlo.campaign_pictures import draw_distributions, draw_influences
from mufly.flight.monte_carlo.campaign_results import results_dataset
from mufly.flight.monte_carlo.worker_pool import WorkerPool, case_from_result, sort_by_severity
from mufly.study import write_study_results
from mufly.vehicle import format_vehicle_toml


class RecordedFlights(NamedTuple):
    """Repeated flights, each with the command that repeats it, and the available recordings."""

    commands: list[tuple[FlightResult, str]]
    recordings: list[Path]


def record_notable_flights(
    campaign: Campaign, flown: Sequence[FlightResult], sought: Sequence[FlightResult], folder: Path, crew: WorkerPool,
    *, most: int | None = None, stop: Callable[[], bool] | None = None,
    progress: Callable[[int, int], None] | None = None, on_notice: Callable[[str], None] = lambda text: None,
) -> RecordedFlights:  # fmt: skip
    """Repeat failed flights, the worst success and the worst flight of a search, with full recordings.

    Parameters
    ----------
    campaign : Campaign
    flown, sought : sequence of FlightResult
        Flights of the campaign and of a search.
    folder : Path
        Folder that receives one folder a flight: ``failed/00012``, ``worst/00003``, ``search/00001``.
    crew : WorkerPool
    most : int, optional
        Number of failed flights to record; default all.
    stop : callable, optional
        Called between flights; True stops.
    progress : callable, optional
        Called with (flights done, total flights).
    on_notice : callable
        Called with a sentence about each flight that differs when repeated.

    Raises
    ------
    InputError
        If a file cannot be written.
    """
    failed = [f for f in flown if not f.success]
    chosen = {folder / "failed" / f"{f.index:05d}": f for f in failed[:most]}
    left = [f for f in sort_by_severity(flown, campaign.tolerance_m) if f.success][:1]
    chosen |= {folder / "worst" / f"{f.index:05d}": f for f in left}
    chosen |= {folder / "search" / f"{f.index:05d}": f for f in sort_by_severity(sought, campaign.tolerance_m)[:1]}
    commands: list[tuple[FlightResult, str]] = []
    orders = []
    for place, f in chosen.items():
        case = case_from_result(f)
        vehicle_file = place / "vehicle.toml" if case.parameter_values else None
        command = campaign.format_replay_command(case, place, vehicle_file)
        with convert_write_errors(place):
            place.mkdir(parents=True, exist_ok=True)
            if vehicle_file is not None:
                vehicle_file.write_text(format_vehicle_toml(campaign.make_vehicle(case)), encoding="utf-8")
            (place / "command.txt").write_text(command + "\n", encoding="utf-8")
        commands.append((f, command))
        recording = place / "flight.mcap"
        if not recording.exists():
            orders.append((case, recording.with_suffix(".part.mcap")))
    before = {(f.index, f.seed): f for f in chosen.values()}
    paths = {case.index: path for case, path in orders}
    for done, f in enumerate(crew.fly_cases(campaign, orders, stop or (lambda: False)), 1):
        path = paths[f.index]
        changed = list_differing_result_fields(f, before[f.index, f.seed])
        if changed:
            on_notice(f"flight {f.index} gave another result when it was repeated ({', '.join(changed)})")
        if path.exists():  # a flight refused before its start has no recording
            with convert_write_errors(path):
                path.rename(path.with_name("flight.mcap"))
        if progress is not None:
            progress(done, len(orders))
    return RecordedFlights(commands, [p / "flight.mcap" for p in chosen if (p / "flight.mcap").exists()])


def write_campaign_results(campaign: Campaign, flown: Sequence[FlightResult], folder: Path, name: str) -> list[Path]:
    """Write tables (NetCDF, CSV, and Parquet if pyarrow is installed) and pictures of flights; return the files.

    Raises
    ------
    InputError
        If a file cannot be written.
    """
    if not flown:
        return []
    table = results_dataset(flown, campaign)
    files = write_study_results(table, folder, name)
    title = f"{campaign.vehicle.name}, {campaign.mission_name}, {campaign.describe_onboard_knowledge()}"
    pictures = {
        f"{name}-distributions": draw_distributions(flown, campaign.tolerance_m, title),
        f"{name}-influences": draw_influences(flown, campaign),
    }
    with convert_write_errors(folder):
        try:
            import pyarrow  # noqa: F401  an extra
        except ImportError:
            pass
        else:
            files.append(folder / f"{name}.parquet")
            table.to_dataframe().to_parquet(files[-1])
        for stem, picture in pictures.items():
            if picture is not None:
                files.append(folder / f"{stem}.png")
                picture.savefig(files[-1], dpi=150)
    return files
