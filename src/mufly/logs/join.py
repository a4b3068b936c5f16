"""Signals chosen by name, put on one clock, brought to a rate, cut to a part."""

from __future__ import annotations

import fnmatch
from collections.abc import Sequence
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from mufly.errors import InputError
from mufly.logs.clock import check_clock
from mufly.logs.flat import FlatColumn, columns_of, dataset_of
from mufly.logs.raw import RawLog
from mufly.logs.resample import common_clock, resample
from mufly.logs.series import Series
from mufly.logs.signals import is_held

__all__ = ["at_rate", "choose_series", "choose_variables", "joined", "matches", "part_of", "put_together"]

# Steps that vary by more than this share are said.
JITTER = 0.02


def matches(name: str, pattern: str) -> bool:
    """Whether a component ``variable.label`` is meant by a name or pattern: its own, its variable's, or ``*``."""
    variable = name.partition(".")[0]
    if pattern in (name, variable) or pattern == name.replace(".", "_"):
        return True
    return any(c in pattern for c in "*?") and (
        fnmatch.fnmatchcase(name, pattern) or fnmatch.fnmatchcase(variable, pattern)
    )


def choose_series(series: list[Series], signals: Sequence[str], raw: RawLog) -> list[Series]:
    if not signals:
        return series
    out: dict[str, Series] = {}
    for pattern in signals:
        found = [s for s in series if s.source == pattern] if "/" in pattern else []
        found = found or [s for s in series if matches(s.key, pattern)]
        if not found:
            names = ", ".join(dict.fromkeys(s.variable for s in series)) or "none"
            raise InputError(
                raw.path, pattern, "there is no such signal", f"signals are: {names}; or write topic/field"
            )
        out |= {s.key: s for s in found}
    return list(out.values())


def choose_variables(data: xr.Dataset, signals: Sequence[str], where: str) -> xr.Dataset:
    """Part of a dataset; a component becomes the variable with NaN beside it."""
    if not signals:
        return data
    keep: dict[str, set[str]] = {}
    columns = columns_of(data)
    for pattern in signals:
        found = [
            c
            for c in columns
            if matches(c.variable if c.label is None else f"{c.variable}.{c.label}", pattern)
        ]
        if not found:
            names = ", ".join(dict.fromkeys(c.variable for c in columns))
            raise InputError(where, pattern, "there is no such signal", f"signals are: {names}")
        for c in found:
            keep.setdefault(c.variable, set()).add(str(c.label))
    out = data[list(keep)]
    for name, labels in keep.items():
        if out[name].ndim == 2:
            dim = str(out[name].dims[1])
            out[name] = out[name].where(out[name][dim].astype(str).isin(sorted(labels)))
    return out


def joined(channels: Sequence[tuple[str, str, NDArray[np.float64], NDArray[np.float64]]]) -> xr.Dataset:
    """Put channels (name with label, unit, time, values) on one even clock, at the highest rate among them."""
    series = []
    for name, unit, time, values in channels:
        variable, _, label = name.partition(".")
        hold = is_held(variable)
        series.append(Series(variable, label or None, time, values, unit, "", hold))
    highest = max((r for r in (_rate(s.time) for s in series) if np.isfinite(r)), default=1.0)
    return put_together(series, highest, [])


def put_together(series: list[Series], rate_hz: float | None, notes: list[str]) -> xr.Dataset:
    """Put series on one clock."""
    first = series[0].time
    shared = all(s.time is first or np.array_equal(s.time, first) for s in series)
    if shared and rate_hz is None:
        time = first
        report = check_clock(time)
        if report.jitter > JITTER or len(report.gaps):
            holes = f"{len(report.gaps)} gap{'s' if len(report.gaps) > 1 else ''}" if len(report.gaps) else ""
            steps = f"steps vary by {100 * report.jitter:.2g} %" if report.jitter > JITTER else ""
            said = ", ".join(t for t in (steps, holes) if t)
            notes.append(f"the clock is uneven ({said}); give a rate to resample")
        columns = [FlatColumn(s.variable, s.label, s.values, s.unit) for s in series]
    else:
        rates = [_rate(s.time) for s in series]
        highest = max((r for r in rates if np.isfinite(r)), default=1.0)
        rate = rate_hz or (float(round(highest)) if highest >= 10 else float(f"{highest:.3g}"))
        time = common_clock([(float(s.time[0]), float(s.time[-1])) for s in series if len(s.time)], rate)
        columns = [FlatColumn(s.variable, s.label, _onto(s, time), s.unit) for s in series]
    about: dict[str, dict[str, Any]] = {}
    for s in series:
        entry = about.setdefault(
            s.variable, {"source": s.source, "source_rate_hz": float(f"{_rate(s.time):.4g}")}
        )
        if s.long_name:
            entry["long_name"] = s.long_name
    data = dataset_of(time, columns, notes=about)
    _align_turns(data)
    data.attrs["rate_hz"] = float(f"{_rate(time):.6g}")
    return data


def _rate(time: NDArray[np.float64]) -> float:
    return float(1 / np.median(np.diff(time))) if len(time) > 1 else float("nan")


def _onto(series: Series, time: NDArray[np.float64]) -> NDArray[Any]:
    if series.values.dtype.kind not in "US":
        return resample(series.time, series.values, time, hold=series.hold)
    before = np.searchsorted(series.time, time, side="right") - 1
    out: NDArray[Any] = np.where(before >= 0, series.values[np.clip(before, 0, None)], "")
    return out


def _align_turns(data: xr.Dataset) -> None:
    """Shift references and estimates by whole turns to where the measurement is."""
    if "measured_attitude" not in data:
        return
    for name in ("reference_attitude", "estimated_attitude"):
        if name in data:
            apart = data[name].values - data["measured_attitude"].values
            for k in range(apart.shape[1]):
                known = apart[np.isfinite(apart[:, k]), k]
                if len(known):
                    data[name].values[:, k] -= 2 * np.pi * np.rint(np.median(known) / (2 * np.pi))


def at_rate(data: xr.Dataset, rate_hz: float | None) -> xr.Dataset:
    """A dataset that is on one clock already, at another rate."""
    if rate_hz is None or data.sizes["time"] < 2:
        return data
    old = data["time"].values
    time = common_clock([(float(old[0]), float(old[-1]))], rate_hz)
    out: dict[str, Any] = {}
    for key, variable in data.data_vars.items():
        name = str(key)
        if "time" not in variable.dims:
            out[name] = variable
        elif variable.dtype.kind not in "fiu":
            before = np.clip(np.searchsorted(old, time + 1e-9, side="right") - 1, 0, None)
            out[name] = (variable.dims, variable.values[before], variable.attrs)
        else:
            hold = is_held(name)
            block = variable.values.astype(np.float64).reshape(len(old), -1)
            new = np.column_stack([resample(old, column, time, hold=hold) for column in block.T])
            out[name] = (variable.dims, new.reshape(len(time), *variable.shape[1:]), variable.attrs)
    coords: dict[str, Any] = {str(k): v for k, v in data.coords.items() if k != "time"}
    coords["time"] = ("time", time, data["time"].attrs)
    return xr.Dataset(out, coords, {**data.attrs, "rate_hz": rate_hz})


def part_of(data: xr.Dataset, from_s: float | None, to_s: float | None, where: str) -> xr.Dataset:
    if from_s is None and to_s is None:
        return data
    time = data["time"].values
    kept = (time >= (-np.inf if from_s is None else from_s)) & (time <= (np.inf if to_s is None else to_s))
    if not kept.any():
        span = f"the log lasts from {time[0]:.3f} to {time[-1]:.3f} s"
        raise InputError(where, "--from", "nothing lies in that part", span)
    return data.isel(time=kept)
