"""``mufly sensors``: sensors of a vehicle, and simulated readings of a flight."""

from __future__ import annotations

from itertools import groupby
from typing import TYPE_CHECKING

from mufly.cli.options import (
    CommandGroup,
    JsonOption,
    MissionArgument,
    OutOption,
    SeedOption,
    VehicleArgument,
    VehicleOption,
)
from mufly.cli.output import (
    check_output_place,
    print_answer,
    print_json,
    print_lines,
    print_table,
    progress_bar,
    save_figure,
)
from mufly.cli.station import FaultOption, GustOption, WindOption, resolve_wind
from mufly.cli.vehicle import print_parameter_group
from mufly.errors import convert_write_errors
from mufly.results import ResultColumn, select_fields, tabulate_results

if TYPE_CHECKING:
    pass

app = CommandGroup(
    help="Show and simulate a vehicle's sensors, and list their faults. Equations and sources: "
    "docs/reference/sensors.md.",
    no_args_is_help=True,
)


@app.command()
def show(vehicle: VehicleArgument = "mufly-1.1", as_json: JsonOption = False) -> None:
    r"""Show a vehicle's sensors: every value of the table \[sensors] of its file, with its source."""
    from mufly.vehicle import list_parameters, load_vehicle

    v = load_vehicle(vehicle)
    rows = [p for p in list_parameters(v) if p.key.startswith("sensors.")]
    if as_json:
        return print_json([p._asdict() for p in rows])
    if not rows:
        print_lines(f"{v.name} has no table [sensors]: the vehicle flies on the true state, without filter.")
        return
    for group, members in groupby(rows, lambda row: row.key.rpartition(".")[0]):
        print_parameter_group(group.removeprefix("sensors."), list(members))


@app.command()
def faults(as_json: JsonOption = False) -> None:
    """List the faults of each sensor, with their default amounts."""
    from mufly.sensors import FAULT_KINDS, FAULT_TARGETS

    if as_json:
        keys = "sensor reading amount=default_amounts unit=reading_unit"
        targets = {name: select_fields(target, keys) for name, target in FAULT_TARGETS.items()}
        return print_json({"kinds": FAULT_KINDS, "targets": targets})
    print_table(("kind", "meaning"), list(FAULT_KINDS.items()), text=(0, 1))
    kinds = [kind for kind in FAULT_KINDS if any(kind in t.default_amounts for t in FAULT_TARGETS.values())]
    print_table(
        ("sensor", "unit", *kinds),
        [(name, t.reading_unit, *(f"{t.default_amounts[k]:g}" for k in kinds)) for name, t in FAULT_TARGETS.items()],
        title="Default amounts",
        text=(0, 1),
    )


@app.command()
def simulate(
    mission: MissionArgument = "demonstration",
    vehicle: VehicleOption = "mufly-1.1",
    seed: SeedOption = 0,
    fault: FaultOption = None,
    wind: WindOption = None,
    gust: GustOption = None,
    out: OutOption = None,
    as_json: JsonOption = False,
) -> None:
    """Simulate the readings of a vehicle's sensors on a mission flown on the true state, and report their errors.

    The readings do not affect the flight. With --out: a CSV file for each reading with the true value beside it,
    and a picture of them all.

    Examples: mufly sensors simulate --out readings; mufly sensors simulate box-on-leg --vehicle mufly-2.0
    --fault sonar.jump=0.3@10s+2s
    """
    import numpy as np

    from mufly.flight import compute_reading_errors, draw_sensor_readings, fly_and_log_sensors, write_sensor_logs
    from mufly.mission import load_mission
    from mufly.sensors import parse_fault
    from mufly.vehicle import load_vehicle

    wrong = [parse_fault(text) for text in fault or []]
    steady = resolve_wind(wind, gust, seed)
    check_output_place("--out", out)
    with progress_bar("flight", not as_json) as progress:
        logs = fly_and_log_sensors(
            load_vehicle(vehicle), load_mission(mission), seed=seed, faults=wrong,
            wind=None if steady is None else np.array(steady), gust=gust,
            on_progress=None if progress is None else lambda p: progress(round(p.time_s), round(p.expected_s)),
        )  # fmt: skip
    errors = [compute_reading_errors(log) for log in logs.values()]
    files = []
    if out is not None:
        with convert_write_errors("--out", key=str(out)):
            files = write_sensor_logs(logs, out)
        files.append(save_figure(draw_sensor_readings(logs), out, "sensors"))
    columns: tuple[ResultColumn | str, ...] = (
        "name", ResultColumn("rate_Hz", form=".0f"), ResultColumn("delay_s", "ms", ".0f"),
        ResultColumn("invalid_share", form=".1%"),
        *(ResultColumn(name, form=".2g") for name in ("mean", "deviation", "worst")), "unit",
    )  # fmt: skip
    print_answer(as_json, {"readings": errors}, [tabulate_results(errors, columns)], files)
