"""``mufly estimate``: what a filter makes of the readings of a flight, and whether it is as good as it thinks."""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from mufly.cli.options import Commands, JsonOption, OutOption, argument, option
from mufly.cli.present import answer, check_folder, print_table, progress_bar, say, writing
from mufly.errors import InputError
from mufly.results import plain

if TYPE_CHECKING:
    import xarray as xr

    from mufly.estimate.nees import Consistency
    from mufly.vehicle import Vehicle
    from mufly.world import World

app = Commands(
    help="Estimation: readings of sensors in, position, velocity, attitude and their bounds out.",
    no_args_is_help=True,
)


@app.command()
def run(
    log: Annotated[Path, argument("LOG", "A recording of a flight on sensors (flight.mcap of `mufly fly`).")],
    vehicle: Annotated[
        str | None,
        option("--vehicle NAME|FILE", "What the filter takes it for. Default: the vehicle that flew."),
    ] = None,
    out: OutOption = None,
    as_json: JsonOption = False,
) -> None:
    """Let the filter estimate a recorded flight again, from what the sensors said and the actuators did.

    Where the recording knows the truth, it is told how far off the estimate was and whether it knew: NEES, the square
    of the error over its expected square, should be 1 on average, and 95 % of the errors inside the 95 % ellipsoid.
    With another vehicle file (a mass, a noise, a sensor less) it tells what that does to the estimate. With --out:
    pictures of the estimate with its bounds and of what was made of every sensor, and the recording with the new
    estimate.

    Examples: mufly fly --headless --out flown; mufly estimate run flown/flight.mcap --out estimated
    """
    from mufly.estimate import fitted_estimator
    from mufly.estimate.nees import consistency
    from mufly.flight import believed, draw_belief, is_sensed, read_recording, replay, truths_of
    from mufly.logs import write_log

    check_folder("--out", out)
    data = read_recording(log)
    if not is_sensed(data):
        raise InputError(
            str(log), "", "holds no readings of sensors, as flights on what is true do not",
            "record one with `mufly fly` without --sensors ideal",
        )  # fmt: skip
    flown, world = _carried(log, vehicle)
    with progress_bar("estimating", not as_json):
        estimates = replay(data, fitted_estimator(flown, world, float(data.attrs["rate_Hz"])))
    again = believed(data, estimates)
    figures = consistency(truths_of(data), estimates, after_s=_off_floor_s(data))
    files: list[Path] = []
    if out is not None:
        with writing(out):
            out.mkdir(parents=True, exist_ok=True)
            files = [*draw_belief(again, out), out / "estimate.mcap"]
            write_log(again, files[-1])
    answer(as_json, lambda: plain(figures), lambda: _print(figures), files)


def _print(c: Consistency) -> None:
    import math

    rows = [
        ("horizontal position", f"{100 * c.xy_rms:.1f} cm", f"{100 * c.xy_peak:.1f} cm"),
        ("height", f"{100 * c.z_rms:.1f} cm", f"{100 * c.z_peak:.1f} cm"),
        ("tilt", f"{math.degrees(c.tilt_rms):.2f} deg", f"{math.degrees(c.tilt_peak):.2f} deg"),
        ("heading", f"{math.degrees(c.yaw_rms):.2f} deg", ""),
    ]
    print_table(("off by", "rms", "worst"), rows, text=(0, 1, 2))
    parts = ", ".join(
        f"{name} {x:.2f}" for name, x in zip(("position", "velocity", "attitude"), c.parts, strict=True)
    )
    say(
        f"NEES / n {c.nees:.2f} (1 if it knows how good it is; {parts}); {c.inside:.1%} inside the 95 % ellipsoid"
    )


def _carried(log: Path, vehicle: str | None) -> tuple[Vehicle, World]:
    """The vehicle asked for, or the one that flew, and the world of the mission, which the recording carries."""
    import tempfile

    from mufly.flight import read_attachments
    from mufly.mission import mission_from
    from mufly.vehicle import load_vehicle
    from mufly.world import World

    carried = read_attachments(log)
    world = World()
    if "mission.toml" in carried:
        tables = tomllib.loads(carried["mission.toml"].decode())
        world = mission_from(tables, f"{log}: mission.toml").world if tables.get("waypoint") else world
    if vehicle is not None:
        return load_vehicle(vehicle), world
    if "vehicle.toml" not in carried:
        raise InputError(str(log), "", "carries no vehicle", "name it by --vehicle")
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "vehicle.toml"
        path.write_bytes(carried["vehicle.toml"])
        return load_vehicle(path), world


def _off_floor_s(data: xr.Dataset) -> float:
    """When it left the floor (s); the beginning, if it did not."""
    import numpy as np

    down = data["truth_position"].values[:, 2]
    off = np.flatnonzero(down < down[0] - 0.1)
    return float(data["time"].values[off[0]]) if len(off) else 0.0
