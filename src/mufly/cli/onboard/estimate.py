"""``mufly estimate``: state estimates from the readings of a flight, and tests of their consistency."""

from __future__ import annotations

import math
import tomllib
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from mufly.cli.log import MapOption, column_map_from_options
from mufly.cli.options import (
    ColumnOption,
    CommandGroup,
    JsonOption,
    OutOption,
    SeedOption,
    define_argument,
    define_option,
)
from mufly.cli.output import (
    check_output_place,
    print_answer,
    print_lines,
    progress_bar,
)
from mufly.errors import InputError, convert_write_errors

if TYPE_CHECKING:
    import xarray as xr

    from mufly.estimate import Estimate
    from mufly.estimate.nees import Consistency
    from mufly.flight.record.foreign_log import ForeignLog
    from mufly.vehicle import Vehicle
    from mufly.world import World

app = CommandGroup(
    help="Estimate position, velocity and attitude, with their covariance, from sensor readings.",
    no_args_is_help=True,
)
_SETTLING_TIME_S = 2.0  # time after lift-off from which errors count


@app.command()
def run(
    log: Annotated[Path, define_argument("LOG", "Recorded flight: of `mufly fly`, or any log that `mufly log` reads.")],
    vehicle: Annotated[
        str | None,
        define_option("--vehicle NAME|FILE", "Vehicle that the filter models. Default: the vehicle that flew."),
    ] = None,
    map_file: MapOption = None,
    column: ColumnOption = None,
    aid: Annotated[
        list[str] | None,
        define_option(
            "--aid KIND=SIGNAL",
            "Source of position or heading fixes: position=truth_position, position=x,-y,-z (columns as "
            "N, E, D), heading=yaw(deg). Default: the log's own position and attitude. Repeat it for "
            "both.",
        ),
    ] = None,
    aid_std: Annotated[
        float | None,
        define_option(
            "--aid-std",
            "Standard deviation of the noise of position fixes; it is added to fixes that are made from the truth. "
            "Default: the scatter of the fixes.",
            unit="m",
        ),
    ] = None,
    aid_heading_std: Annotated[
        float | None,
        define_option("--aid-heading-std", "Noise of a heading fix (standard deviation). Default: 2.", unit="deg"),
    ] = None,
    aid_rate: Annotated[
        float | None, define_option("--aid-rate", "Highest rate of fixes. Default: the log's.", unit="Hz")
    ] = None,
    aid_delay: Annotated[
        float, define_option("--aid-delay", "Delay of fixes after their measurement.", unit="s")
    ] = 0.0,
    gyro_noise: Annotated[
        float | None,
        define_option(
            "--gyro-noise", "Noise density of the gyroscopes. Default: estimated from the log.", unit="rad/s/sqrt(Hz)"
        ),
    ] = None,
    accelerometer_noise: Annotated[
        float | None,
        define_option(
            "--accelerometer-noise",
            "Noise density of the accelerometers. Default: estimated from the log.",
            unit="m/s^2/sqrt(Hz)",
        ),
    ] = None,
    rate: Annotated[
        float | None,
        define_option(
            "--rate", "Rate of the filter, for a log of another vehicle. Default: the log's, at most 250.", unit="Hz"
        ),
    ] = None,
    seed: SeedOption = 0,
    out: OutOption = None,
    as_json: JsonOption = False,
) -> None:
    """Estimate the states of a recorded flight from its sensor readings, and test the consistency of the filter.

    A flight of `mufly fly` is estimated by the filter that flew it, with its rotor model. Another --vehicle file (a
    different mass or noise, a sensor less) shows the effect on the estimate.

    Any other log is estimated by a strapdown filter: gyroscopes and accelerometers, aided by position and heading
    fixes. Units, gravity and signs are checked first; noise is found by rules from the log itself, never from the truth
    (docs/explanation/estimation.md).

    If the log holds the truth (truth_position, truth_attitude), NEES tests the covariance of the estimate: the squared
    error over its variance, 1 on average. NIS tests the innovations of the fixes in the same way.
    With --out: pictures (path, motion, biases, innovations, with bounds of three
    standard deviations), and the recording with the estimate as MCAP and CSV.

    Examples:

    mufly fly --headless --out flown; mufly estimate run flown/flight.mcap --out estimated

    mufly estimate run flight.ulg --aid-delay 0.1 --out estimated

    mufly estimate run circle.csv.gz --map nanobench --aid position=truth_position --aid-std 0.02 --aid-rate 15
    """
    from mufly.estimate.inertial_log import MAX_ACCEL_NOISE_DENSITY, MAX_GYRO_NOISE_DENSITY
    from mufly.flight import has_sensor_readings, read_recording
    from mufly.flight.record.foreign_log import AidRequest, parse_aid, read_foreign_log
    from mufly.logs import detect_log_format

    check_output_place("--out", out)
    of_aids = {
        "--map": map_file, "--column": column, "--aid": aid, "--aid-std": aid_std, "--aid-heading-std": aid_heading_std,
        "--aid-rate": aid_rate, "--aid-delay": aid_delay or None, "--gyro-noise": gyro_noise,
        "--accelerometer-noise": accelerometer_noise, "--rate": rate,
    }  # fmt: skip
    for name, value in of_aids.items():
        if isinstance(value, float) and not (0.0 < value < math.inf):
            raise InputError(name, f"{value:g}", "is not above zero", "give a positive number")
    for name, limit in (("--gyro-noise", MAX_GYRO_NOISE_DENSITY), ("--accelerometer-noise", MAX_ACCEL_NOISE_DENSITY)):
        value = of_aids[name]
        if isinstance(value, float) and value > limit:
            raise InputError(name, f"{value:g}", f"is above {limit:g}", "give the density of the unit's data sheet")
    said = [name for name, value in of_aids.items() if value is not None]
    data = read_recording(log) if not said and detect_log_format(log) == "MCAP" else None
    if data is not None and has_sensor_readings(data):
        _estimate_own_flight(log, data, vehicle, out, as_json)
        return
    if vehicle is not None:
        raise InputError(
            "--vehicle", vehicle, "needs a flight of `mufly fly` on sensors, without options of fixes" if said else
            "needs a flight of `mufly fly` on sensors: other logs are estimated without a rotor model",
            "leave out --vehicle",
        )  # fmt: skip
    kinds = dict(parse_aid(text) for text in aid or ())
    asked = AidRequest(
        kinds.get("position"), kinds.get("heading"), aid_std,
        None if aid_heading_std is None else math.radians(aid_heading_std), aid_rate, aid_delay, seed,
    )  # fmt: skip
    notes: list[str] = []
    found = read_foreign_log(log, column_map_from_options(map_file, column), asked, rate, notes)
    for note in notes:
        typer.secho(f"{log.name}: {note}", fg=typer.colors.YELLOW, err=True)
    _estimate_foreign_log(log, found, (gyro_noise, accelerometer_noise), out, as_json)


def _estimate_own_flight(log: Path, data: xr.Dataset, vehicle: str | None, out: Path | None, as_json: bool) -> None:
    """Estimate the states of a flight of ``mufly fly``; print and write the results."""
    from mufly.estimate import KalmanEstimator
    from mufly.estimate.nees import measure_consistency
    from mufly.flight import list_truths, replace_estimates, replay_estimator

    flown, world = _load_vehicle_and_world(log, vehicle)
    with progress_bar("estimating", not as_json):
        estimates = replay_estimator(data, KalmanEstimator(flown, world, float(data.attrs["rate_Hz"])))
    again = replace_estimates(data, estimates)
    figures = measure_consistency(list_truths(data), estimates, after_s=_lift_off_time_s(data))
    print_answer(as_json, figures, files=_write_results(again, estimates, out))


def _estimate_foreign_log(
    path: Path, f: ForeignLog, given: tuple[float | None, float | None], out: Path | None, as_json: bool
) -> None:
    """Estimate the states of any vehicle from its log; print and write the results."""
    from mufly.estimate import (
        InertialLogEstimate,
        InertialNoise,
        compute_aid_innovations,
        estimate_flight_noise,
        estimate_rest_noise,
        measure_row_consistency,
        run_filter_on_log,
    )
    from mufly.flight.record.foreign_log import make_recording, truth_rows

    if not as_json:
        print_lines(*f.notes)
    rest = estimate_rest_noise(f.log)
    if None in given:
        with progress_bar("noise", not as_json) as progress:
            noise = estimate_flight_noise(f.log, f.aids, rest, progress)
        noise = InertialNoise(gyro=given[0] or noise.gyro, accelerometer=given[1] or noise.accelerometer)
    else:
        noise = InertialNoise(gyro=given[0] or rest.gyro, accelerometer=given[1] or rest.accelerometer)
    with progress_bar("estimating", not as_json) as progress:
        told = run_filter_on_log(f.log, f.aids, noise, on_progress=progress)
    time = f.log.time_s
    began = float(time[f.log.is_flying.argmax()]) if f.log.is_flying.any() else float(time[0])
    after = began + _SETTLING_TIME_S
    if not any(e.valid and e.time_s + time[0] >= after for e in told):
        raise InputError(
            str(path), "", f"has no valid estimate after {after:.1f} s: too few fixes, or all rejected",
            "check units, axes and time of the fixes (--aid, --aid-delay)",
        )  # fmt: skip
    fore = compute_aid_innovations(f.log, f.aids, told, from_s=after, to_s=float(time[-1]))
    figures: Consistency | None = None
    mounted: Consistency | None = None
    if f.truth:
        figures = measure_row_consistency(truth_rows(f), told, after_s=after - float(time[0]))
        if f.mounting_rad is not None:
            mounted = measure_row_consistency(truth_rows(f, mounted=True), told, after_s=after - float(time[0]))
    evaluated = InertialLogEstimate(
        said=f.notes, noise_at_rest=rest, noise=noise, from_s=after, mounting_rad=f.mounting_rad, aids=fore,
        searched=tuple(n for n, value in zip(("gyro", "accelerometer"), given, strict=True) if value is None),
        errors=figures, errors_without_mounting=mounted,
    )  # fmt: skip
    data = make_recording(f, told, path.name)
    print_answer(as_json, evaluated, files=_write_results(data, told, out, csv=True))


def _write_results(data: xr.Dataset, told: Sequence[Estimate], out: Path | None, csv: bool = False) -> list[Path]:
    """Write pictures and recording; return the files."""
    from mufly.flight import draw_estimate_pictures
    from mufly.logs import write_log

    if out is None:
        return []
    with convert_write_errors("--out", key=str(out)):
        out.mkdir(parents=True, exist_ok=True)
        files = [*draw_estimate_pictures(_add_bias_std(data, told), out), out / "estimate.mcap"]
        write_log(data, files[-1])
        if csv:
            files.append(out / "estimate.csv")
            write_log(data, files[-1])
    return files


def _add_bias_std(data: xr.Dataset, told: Sequence[Estimate]) -> xr.Dataset:
    """Return a flight's data with the estimated standard deviations of the sensor biases, which recordings lack."""
    import numpy as np

    from mufly.estimate.filter.filter_records import ERROR_ACCEL_BIAS, ERROR_GYRO_BIAS, ERROR_TERRAIN

    out = {}
    for name, axes in (
        ("gyro_bias", slice(ERROR_GYRO_BIAS, ERROR_ACCEL_BIAS)),
        ("accelerometer_bias", slice(ERROR_ACCEL_BIAS, ERROR_TERRAIN)),
    ):
        block = np.array(
            [
                np.full(3, math.nan) if e.auxiliary_states is None else e.auxiliary_states.error_state_sigma[axes]
                for e in told
            ]
        )
        out[f"estimated_{name}_sigma"] = data[f"estimated_{name}"].copy(data=block)
    return data.assign(out)


def _load_vehicle_and_world(log: Path, vehicle: str | None) -> tuple[Vehicle, World]:
    """Return the requested vehicle, or else the one stored in the recording, and the world of the recorded mission."""
    import tempfile

    from mufly.flight import read_attachments
    from mufly.mission import parse_mission
    from mufly.vehicle import load_vehicle
    from mufly.world import World

    carried = read_attachments(log)
    world = World()
    if "mission.toml" in carried:
        tables = tomllib.loads(carried["mission.toml"].decode())
        world = parse_mission(tables, f"{log}: mission.toml").world if tables.get("waypoint") else world
    if vehicle is not None:
        return load_vehicle(vehicle), world
    if "vehicle.toml" not in carried:
        raise InputError(str(log), "", "contains no vehicle file", "give --vehicle")
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "vehicle.toml"
        path.write_bytes(carried["vehicle.toml"])
        return load_vehicle(path), world


def _lift_off_time_s(data: xr.Dataset) -> float:
    """Return the time of lift-off (s); the beginning if the vehicle stayed on the floor."""
    import numpy as np

    down = data["truth_position"].values[:, 2]
    off = np.flatnonzero(down < down[0] - 0.1)
    return float(data["time"].values[off[0]]) if len(off) else 0.0
