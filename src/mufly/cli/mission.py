"""``mufly mission``: list, show and check missions."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Any

from mufly.cli.options import CommandGroup, JsonOption, VehicleOption, define_argument, define_option
from mufly.cli.output import (
    make_console,
    print_answer,
    print_json,
    print_lines,
    print_table,
)
from mufly.results import ResultColumn, select_fields, tabulate_results

if TYPE_CHECKING:
    from mufly.mission import Mission

app = CommandGroup(
    help="List, show and check missions. Keys of a mission file: docs/reference/missions.md.",
    no_args_is_help=True,
)

_MissionArgument = Annotated[
    str,
    define_argument(
        "NAME|FILE",
        "Built-in mission (`mufly mission list`), or mission file: TOML, or QGroundControl's.",
    ),
]
_TomlOption = Annotated[bool, define_option("--toml", "Print the whole file with every default.")]


@app.command("list")
def list_missions(as_json: JsonOption = False) -> None:
    """List the built-in missions."""
    from mufly.mission import list_builtin_missions, load_mission, plan_legs

    rows = []
    for m in map(load_mission, list_builtin_missions()):
        way = sum(leg.length_m for leg in plan_legs(m))
        rows.append({**select_fields(m, "name description"), "waypoints": len(m.waypoint), "way_m": way})
    columns = ("name", "description", "waypoints", ResultColumn("way_m", form=".1f"))
    print_answer(as_json, rows, [tabulate_results(rows, columns)], None)


@app.command()
def show(mission: _MissionArgument = "demonstration", as_json: JsonOption = False, toml: _TomlOption = False) -> None:
    """Show the waypoints of a mission, the length of the path, and the expected time at each.

    Times count from the start signal: rotors speeding up, reference trajectories, settling at each waypoint, waits, \
and the way around obstacles that the file names.
    """
    from mufly.mission import compute_mission_timing, fence_outlines, format_mission_toml, load_mission

    m = load_mission(mission)
    if toml:
        print(format_mission_toml(m), end="")
        return
    rows = _make_waypoint_rows(m)
    if as_json:
        return print_json({"name": m.name, "description": m.description, "waypoints": rows, "at_end": m.at_end})
    make_console().print(f"[bold]{m.name}[/bold]  {m.description}")
    speeds = any(w.speed_m_s is not None for w in m.waypoint)
    heads = ["", "N", "E", "D", "wait", "heading", "way", "reached after", *(["speed"] if speeds else [])]
    place = (*m.start_m, -m.take_off.height_m)
    where = (f"{x:.2f} m" for x in place)
    start = ["take-off", *where, f"{m.take_off.wait_s:.1f} s", f"{m.start_heading_deg:.0f}°"]
    lines = [start + [""] * (len(heads) - len(start))]
    for row in rows:
        heading, speed = row["heading_deg"], row["speed_m_s"]
        lines.append(
            [
                str(row["number"]), *(f"{x:.2f} m" for x in row["position_m"]), f"{row['wait_s']:.1f} s",
                "along the way" if heading is None else f"{heading:.0f}°", f"{row['way_m']:.2f} m",
                f"{row['reached_s']:.1f} s", *(["" if speed is None else f"{speed:g} m/s"] if speeds else []),
            ]
        )  # fmt: skip
    print_table(heads, lines, text=())
    obstacles = m.world.obstacle_names[: len(m.world.boxes) + len(m.world.cylinders)]
    if obstacles or m.room:
        print_lines(f"Obstacles: {', '.join([*obstacles, *(['a room'] if m.room else [])])}.")
    end = {"land": "lands there", "hover": "hovers there", "return": "returns and lands"}[m.at_end]
    how = (
        "scanning for obstacles"
        if m.scans_by_yawing
        else "avoiding obstacles"
        if m.avoidance.enabled
        else "without obstacle avoidance"
    )
    if m.fence is not None:
        ceiling = "no ceiling" if m.fence.ceiling_m is None else f"ceiling {m.fence.ceiling_m:g} m"
        print_lines(f"Geofence: {len(fence_outlines(m.fence))} zones, {ceiling}; outside it, {m.fence.action}.")
    timing = compute_mission_timing(m)
    print_lines(f"About {timing.landed_s:.0f} s and {timing.path_length_m:.1f} m, the landing included.")
    print_lines(
        f"Path: {m.path.kind}, at most {m.trajectory_limits.speed:g} m/s, {how}; at the end it {end}.",
        style="dim",
    )


def _make_waypoint_rows(m: Mission) -> list[dict[str, Any]]:
    from mufly.mission import plan_legs

    return [
        {
            "number": leg.waypoint_number, **select_fields(w, "position_m wait_s heading_deg speed_m_s"),
            "way_m": leg.length_m, "reached_s": leg.reached_s,
        }
        for leg, w in zip(plan_legs(m), m.waypoint, strict=True)
    ]  # fmt: skip


@app.command()
def check(mission: _MissionArgument, vehicle: VehicleOption = "mufly-1.1", as_json: JsonOption = False) -> None:
    """Check a mission file, and whether the vehicle's battery suffices. If not, exit with status 1 and a reason."""
    from mufly.control import design_flight_controller
    from mufly.firmware.export.plan_tables import MAX_WAYPOINTS
    from mufly.flight import derive_trajectory_limits
    from mufly.mission import GROUND_STATION_DESCRIPTION_PREFIX, check_mission_for_vehicle, load_mission
    from mufly.vehicle import load_vehicle

    m, v = load_mission(mission), load_vehicle(vehicle)
    check_mission_for_vehicle(v, m, vehicle_file=vehicle, mission_file=mission)  # before the design, which takes longer
    estimate = check_mission_for_vehicle(
        v, m, vehicle_file=vehicle, mission_file=mission, able=derive_trajectory_limits(design_flight_controller(v))
    )
    if as_json:
        told = select_fields(estimate, "duration_s path_m charge_As charge_fraction")
        return print_json({"name": m.name, "vehicle": v.name, **told})
    make_console().print(
        f"[bold]{m.name}[/bold] can be flown by [bold]{v.name}[/bold]: {len(m.waypoint)} waypoints, "
        f"{estimate.path_m:.1f} m, about {estimate.duration_s:.0f} s, {estimate.charge_fraction:.0%} of the battery."
    )
    if m.description.startswith(GROUND_STATION_DESCRIPTION_PREFIX):
        print_lines(f"Read {m.description}.", style="dim")
    if len(m.waypoint) > MAX_WAYPOINTS:
        print_lines(
            f"The exported firmware has room for {MAX_WAYPOINTS} waypoints: raise MISSION_WAYPOINTS in mission_state.h "
            "for this mission.",
            style="yellow",
        )
