"""Estimation from a log of any vehicle: read inertial unit, aids (position, heading) and truth; write the estimate."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from mufly.errors import InputError

if TYPE_CHECKING:
    import xarray as xr

    from mufly.estimate import Estimate
    from mufly.estimate.inertial_log import InertialLog, PositionAids
    from mufly.logs import Channel, ColumnMap

_Array = NDArray[np.float64]
_MAX_FILTER_RATE_HZ = 250.0
_MIN_POSITION_STD_M = 0.01
_DEFAULT_HEADING_STD_RAD = math.radians(2.0)
_MAX_BRIDGED_GAP_S = 0.1
_RUNNING_MOTOR_FRACTION = 0.03  # fraction of full power at which motors turn
_AXIS_LABELS = {
    "position": ("N", "E", "D"),
    "velocity": ("N", "E", "D"),
    "attitude": ("roll", "pitch", "yaw"),
}
_ROLL_PITCH_COLUMNS = slice(-3, -1)
"""Columns of a row of position, velocity and attitude."""


@dataclass(frozen=True)
class AidRequest:
    """The user's choice of aids, the fixes of position and heading that the filter fuses; None: automatic.

    Attributes
    ----------
    position_signal, heading_signal : str or None
        Signal names.
    std_m, heading_std_rad, rate_hz, delay_s : float or None
        Standard deviations, rate and delay of the aids.
    seed : int
        Seed of the noise added to an aid made from the truth.
    """

    position_signal: str | None = None
    heading_signal: str | None = None
    std_m: float | None = None
    heading_std_rad: float | None = None
    rate_hz: float | None = None
    delay_s: float = 0.0
    seed: int = 0


@dataclass(frozen=True)
class ForeignLog:
    """A log of any vehicle, prepared for the filter.

    Attributes
    ----------
    log : InertialLog
    aids : PositionAids
    truth : dict of str to (n, 3) array
        True ``position`` (m), ``velocity`` (m/s) and ``attitude`` (rad), if logged, at the times of ``log``.
    mounting_rad : (2,) array or None
        Roll and pitch (rad) of the true attitude minus those of the accelerometers at rest.
    notes : list of str
        Findings, as text.
    """

    log: InertialLog
    aids: PositionAids
    truth: dict[str, _Array]
    mounting_rad: _Array | None
    notes: list[str]


def parse_aid(text: str, where: str = "--aid") -> tuple[str, str]:
    """Return kind and signal of ``position=...`` or ``heading=...``."""
    kind, _, signal = text.partition("=")
    if kind not in ("position", "heading") or not signal:
        raise InputError(
            where,
            text,
            "is not a reference for the estimate",
            "write position=SIGNAL or heading=SIGNAL, for example position=truth_position",
        )
    return kind, signal


def read_foreign_log(
    path: Path, columns: ColumnMap | None, asked: AidRequest, rate_hz: float | None, notes: list[str]
) -> ForeignLog:
    """Read a log's inertial unit, aids and truth; append the reader's notes to ``notes``.

    Raises
    ------
    InputError
        If the inertial unit or all aids are missing, or units or axes are wrong.
    """
    from mufly.estimate.inertial_log import InertialLog, check_inertial_log, detect_flight
    from mufly.logs import common_clock, load_column_map, read_channels, resample_signal
    from mufly.logs.channel_checks import fit_angle_rate_slope

    where = str(path)
    extra = []
    if asked.position_signal is not None and "," in asked.position_signal:
        extra.append(f"measured_position={asked.position_signal}")
    if asked.heading_signal is not None and not asked.heading_signal.startswith(("truth_", "measured_", "estimated_")):
        extra.append(f"measured_attitude.yaw={asked.heading_signal}")
    if extra:
        first = load_column_map(extra)
        columns = first if columns is None else columns.model_copy(update={"signal": (*first.signal, *columns.signal)})
    _, found, _, said = read_channels(path, columns)
    notes += said
    by = {c.name: c for c in found}
    rates = _find_vector(by, "measured_rates", ("p", "q", "r"))
    felt = _find_vector(by, "measured_acceleration", ("x", "y", "z"))
    for name, have in (("measured_rates", rates), ("measured_acceleration", felt)):
        if have is None:
            raise InputError(
                where,
                name,
                "is not in the log",
                f"name its columns by --column {name}=...,...,... or a --map",
            )
    assert rates is not None
    assert felt is not None
    native = min(_median_rate_hz(rates[0]), _median_rate_hz(felt[0]))
    rate = float(round(rate_hz or min(native, _MAX_FILTER_RATE_HZ)))
    if not 10.0 <= rate <= 1000.0:
        raise InputError("--rate", f"{rate:g} Hz", "is outside 10 to 1000 Hz", "give one in between")
    span = max(c.time[0] for c in (*rates, *felt)), min(c.time[-1] for c in (*rates, *felt))
    time = common_clock([span], rate)

    def resample_group(group: Sequence[Channel]) -> _Array:
        return np.column_stack(
            [resample_signal(c.time, c.values, time, gap_s=max(_MAX_BRIDGED_GAP_S, 5 / rate)) for c in group]
        )

    w, f = resample_group(rates), resample_group(felt)
    holes = int((~np.isfinite(w).all(axis=1) | ~np.isfinite(f).all(axis=1)).sum())
    motors = [
        c
        for c in found
        if c.signal_name in ("actuator_command", "motor_input") and np.ptp(c.values) > _RUNNING_MOTOR_FRACTION
    ]
    tells = "its motors"
    if motors:
        power = np.nanmean([resample_signal(c.time, c.values, time, hold=True) for c in motors], axis=0)
        on = power > _RUNNING_MOTOR_FRACTION
        flying = np.arange(len(time)) >= (np.argmax(on) if on.any() else len(time))
    else:
        flying, tells = detect_flight(time, w, f), "its inertial unit"
    log = InertialLog(time, w, f, flying)
    check_inertial_log(log, where)
    for source in ("truth", "estimated", "measured"):
        attitude = _find_vector(by, f"{source}_attitude", _AXIS_LABELS["attitude"])
        if attitude is not None:
            angles = resample_group(attitude)
            for k, (angle, turn) in enumerate((("roll", "p"), ("pitch", "q"))):
                _, correlation = fit_angle_rate_slope(time, angles[:, k], w[:, k])
                if correlation < -0.5:
                    raise InputError(
                        where, f"measured_rates.{turn}", f"runs against {source}_attitude.{angle} (correlation "
                        f"{correlation:.2f})", "change the sign of one of them: axes are forward, right, down",
                    )  # fmt: skip
            break
    truth = {}
    for name, axes in _AXIS_LABELS.items():
        group = _find_vector(by, f"truth_{name}", axes)
        if group is not None:
            truth[name] = resample_group(group)
    aids, words = _find_aids(by, asked, where, log)
    out = [
        f"inertial unit at {rate:g} Hz" + (f" of {native:.0f}" if native > 1.02 * rate else "")
        + (f", {holes} rows missing" if holes else ""),
        f"{words}",
        f"at rest for the first {log.rest_rows.stop * log.step_s:.1f} s, by {tells}" if log.rest_rows.stop else
        f"flies from the beginning, by {tells}: attitude and biases are estimated in flight",
    ]  # fmt: skip
    return ForeignLog(log, aids, truth, _estimate_mounting(log, truth), out)


def _find_vector(by: dict[str, Channel], name: str, labels: Sequence[str]) -> list[Channel] | None:
    found = [by.get(f"{name}.{label}") for label in labels]
    whole = [c for c in found if c is not None and len(c.time) > 2]
    return whole if len(whole) == len(labels) else None


def _median_rate_hz(c: Channel) -> float:
    step = float(np.median(np.diff(c.time)))
    return 1.0 / step if step > 0 else math.inf


def _find_aids(by: dict[str, Channel], asked: AidRequest, where: str, log: InertialLog) -> tuple[PositionAids, str]:
    """Return the position and heading aids, as requested or by default the first in the log, and a description."""
    from mufly.estimate.inertial_log import PositionAids

    known = [n for n in ("measured_position", "estimated_position", "truth_position") if f"{n}.N" in by]
    position_signal, heading_signal = asked.position_signal, asked.heading_signal
    name = position_signal if position_signal in known or "," not in (position_signal or ",") else "measured_position"
    if position_signal is None:
        name = known[0] if known and known[0] != "truth_position" else None
    group = None if name is None else _find_vector(by, name, _AXIS_LABELS["position"])
    if group is None:
        have = ", ".join(known) or "none"
        raise InputError(
            where, "--aid" if position_signal else "",
            f"has no {'signal ' + position_signal if position_signal else 'measured position'} for the filter "
            "to fuse",
            f"name one by --aid position=SIGNAL or position=x,y,z (positions in the log: {have}); with "
            "truth_position "
            "noise of --aid-std is added",
        )  # fmt: skip
    made = str(name).startswith("truth_")
    if made and asked.std_m is None:
        raise InputError("--aid-std", "", "is needed when the fixes are made from the truth", "give metres, as 0.02")
    time = group[0].time
    x = np.column_stack([np.interp(time, c.time, c.values) for c in group])
    yaw_name = heading_signal if heading_signal in by or f"{heading_signal}.yaw" in by else None
    yaw_name = yaw_name or ("measured_attitude" if heading_signal else None)
    for one in ("truth_attitude",) if made else ("measured_attitude", "estimated_attitude"):
        yaw_name = yaw_name or (one if f"{one}.yaw" in by else None)
    yaw = None
    if yaw_name is not None:
        c = by[yaw_name if yaw_name in by else f"{yaw_name}.yaw"]
        yaw = np.interp(time, c.time, np.unwrap(c.values))
    native = _median_rate_hz(group[0])
    wanted = min(asked.rate_hz or native, native)
    every = max(1, round(native / wanted))
    pick = np.arange(0, len(time), every)
    pick = pick[(time[pick] >= log.time_s[0]) & np.isfinite(x[pick]).all(axis=1)]
    if len(pick) < 5:
        raise InputError(
            where, str(name), f"has {len(pick)} positions during the readings of the inertial unit", "give at least 5"
        )
    taken, place = time[pick].astype(float), x[pick].astype(float)
    std = asked.std_m
    if std is None:
        scatter = float(np.std(np.diff(place, 2, axis=0), axis=0).max()) / math.sqrt(6.0)
        std = max(scatter, _MIN_POSITION_STD_M)
    turn = asked.heading_std_rad or _DEFAULT_HEADING_STD_RAD
    heading = None if yaw is None else yaw[pick].astype(float)
    if made:
        rng = np.random.default_rng(asked.seed)
        place = place + std * rng.standard_normal(place.shape)
        if heading is not None:
            heading = heading + turn * rng.standard_normal(len(heading))
    aids = PositionAids(taken, taken + asked.delay_s, place, heading, std, turn)
    words = (
        f"position fixes from {name}: {1 / np.median(np.diff(taken)):.3g} Hz, {1e3 * asked.delay_s:.0f} ms "
        "late, one sigma "
        f"{100 * std:.2g} cm" + (", that much noise added" if made else ("" if asked.std_m else " by their "
        "scatter"))
        + (f"; heading from {yaw_name}, {math.degrees(turn):.2g} degrees" if yaw is not None else "; no "
        "heading fixes: the heading is estimated from accelerations, if there are any")
    )  # fmt: skip
    return aids, words


def _estimate_mounting(log: InertialLog, truth: dict[str, _Array]) -> _Array | None:
    """Return true roll and pitch minus those of the accelerometers at rest (2,; rad), due to mounting or bias."""
    if "attitude" not in truth or not log.rest_rows.stop:
        return None
    felt = np.nanmean(log.acceleration[log.rest_rows], axis=0)
    roll, pitch = math.atan2(-felt[1], -felt[2]), math.atan2(felt[0], math.hypot(felt[1], felt[2]))
    said = np.nanmean(truth["attitude"][log.rest_rows, :2], axis=0)
    apart: _Array = said - (roll, pitch)
    return apart


def truth_rows(f: ForeignLog, *, mounted: bool = False) -> _Array:
    """Return true position, velocity and attitude (n, 9); NaN if unknown.

    With ``mounted``, roll and pitch are reduced by the mounting angles.
    """
    n = len(f.log.time_s)
    parts = {name: f.truth.get(name, np.full((n, 3), math.nan)) for name in _AXIS_LABELS}
    if "position" in f.truth and "velocity" not in f.truth:
        parts["velocity"] = np.gradient(parts["position"], f.log.step_s, axis=0)
    rows = np.hstack(list(parts.values()))
    if mounted and f.mounting_rad is not None:
        rows[:, _ROLL_PITCH_COLUMNS] -= f.mounting_rad
    return rows


def make_recording(f: ForeignLog, told: Sequence[Estimate], title: str) -> xr.Dataset:
    """Return measured, estimated and true values in the form of a recording of a flight with sensors."""
    from mufly.flight import replace_estimates
    from mufly.logs import make_flight_row_layout
    from mufly.logs.mcap import rows_to_dataset

    layout = make_flight_row_layout(sensors=True)
    n = len(f.log.time_s)
    rows = np.full((n, layout.column_count), math.nan)
    rows[:, 0] = f.log.time_s
    part: dict[str, Any] = {name: rows[:, columns] for name, columns in layout.column_slices.items()}
    for name, values in (("acceleration", f.log.acceleration), ("rates", f.log.rates)):
        part[f"measured_{name}"][:] = values
        part[f"measured_{name}_time"][:, 0] = np.where(np.isfinite(values).all(axis=1), f.log.time_s, math.nan)
        part[f"measured_{name}_valid"][:, 0] = np.isfinite(values).all(axis=1)
    at = np.searchsorted(f.log.time_s, f.aids.received_s - 1e-9)
    inside = at < n
    at = at[inside]
    part["measured_position_fix"][at, :3] = f.aids.position[inside]
    if f.aids.heading is not None:
        part["measured_position_fix"][at, -1] = f.aids.heading[inside]
    part["measured_position_fix_time"][at, 0] = f.aids.measured_s[inside]
    part["measured_position_fix_valid"][at, 0] = 1.0
    for name, true in zip(_AXIS_LABELS, np.split(truth_rows(f), len(_AXIS_LABELS), axis=1), strict=True):
        part[f"truth_{name}"][:] = true
    states = np.where(f.log.is_flying, "flying", "standing").tolist()
    return replace_estimates(rows_to_dataset(rows, states, layout, attributes={"vehicle": title}), told)
