"""A record as linear fits want it: named columns on an even clock, without gaps.

Read from CSV (names from its header, or ``--columns``), from MATLAB files (each array's columns named by ``--columns
inr=lat,lon,ped,col``, or numbered ``inr0, inr1``...) and from every log that ``mufly.logs`` reads (a signal with axes
becomes ``measured_rates.p``, for which ``p`` is enough where only one signal ends so).
"""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mufly.errors import InputError

__all__ = ["Columns", "lowpassed", "read_columns"]

Array = NDArray[np.float64]

_TIME = ("time", "t", "time_s", "timestamp", "timestamp_s")


@dataclass(frozen=True, eq=False)
class Columns:
    """Columns on an even clock.

    Attributes
    ----------
    name : str
    time_s : (n,) array
        From the log, even to within 1 % of a sample or resampled.
    columns : dict of str to (n,) array
    notes : tuple of str
        What was done to make it so, in words.
    empty : tuple of str
        Columns of the log that hold no numbers.
    """

    name: str
    time_s: Array
    columns: Mapping[str, Array]
    notes: tuple[str, ...] = ()
    empty: tuple[str, ...] = ()

    @property
    def dt(self) -> float:
        """Sample time (s)."""
        return float((self.time_s[-1] - self.time_s[0]) / (len(self.time_s) - 1))

    def find(self, name: str, option: str) -> Array:
        """Return a column by its name, or by the end of its name where that is unique.

        Raises
        ------
        InputError
            If there is none, or several.
        """
        if name in self.columns:
            return self.columns[name]
        ends = [c for c in self.columns if c.endswith(f".{name}")]
        best = [c for c in ends if c.startswith("measured_")] or ends
        if len(best) == 1:
            return self.columns[best[0]]
        shown = ", ".join(list(self.columns)[:24]) + (" ..." if len(self.columns) > 24 else "")
        missing = "holds no numbers" if name in self.empty else "is no column of this log"
        problem = "is in several columns" if best else missing
        raise InputError(
            option, name, problem, f"write {name}=COLUMN with one of: {', '.join(best) or shown}"
        )

    def part(self, start: int, stop: int) -> Columns:
        """Return samples ``start`` to ``stop`` (not included)."""
        return replace(
            self, time_s=self.time_s[start:stop], columns={k: v[start:stop] for k, v in self.columns.items()}
        )


def read_columns(
    path: str | Path,
    *,
    columns: Mapping[str, Sequence[str]] | Sequence[str] = (),
    rate_hz: float | None = None,
) -> Columns:
    """Read a log.

    Parameters
    ----------
    path : str or Path
    columns : sequence, or dict of sequences, of str
        Names of the columns of a CSV file without header, or of the arrays of a MATLAB file.
    rate_hz : float, optional
        Resample to this rate; default the log's own.

    Raises
    ------
    InputError
        If it cannot be read, its time does not rise, or has too few samples.
    """
    path = Path(path)
    if not path.is_file():
        raise InputError(str(path), "", "no such file", "give a CSV, MATLAB or flight log")
    suffix = path.suffix.lower()
    notes: list[str] = []
    if suffix == ".mat":
        found = _matlab(path, columns)
    elif suffix in (".csv", ".txt", ".tsv"):
        found = _csv(path, columns)
    else:
        found = _log(path, notes)
    return _even(path.name, found, rate_hz, notes)


def _matlab(path: Path, columns: Mapping[str, Sequence[str]] | Sequence[str]) -> dict[str, Array]:
    from scipy.io import loadmat
    from scipy.io.matlab import MatReadError

    try:
        content = loadmat(path)
    except (MatReadError, NotImplementedError, ValueError, OSError) as error:
        raise InputError(str(path), "", f"cannot be read ({error})", "save it as MATLAB 7 or CSV") from error
    arrays = {
        k: np.atleast_2d(np.asarray(v, dtype=np.float64))
        for k, v in content.items()
        if not k.startswith("__") and isinstance(v, np.ndarray) and v.dtype.kind in "fiu"
    }
    names = dict(columns) if isinstance(columns, Mapping) else {}
    for key in names:
        if key not in arrays:
            raise InputError("--columns", key, "is no array of this file", f"it has: {', '.join(arrays)}")
    found: dict[str, Array] = {}
    for key, a in arrays.items():
        a = a.T if a.shape[0] == 1 else a
        given = list(names.get(key, ()))
        if given and len(given) != a.shape[1]:
            raise InputError(
                "--columns", key, f"has {a.shape[1]} columns, {len(given)} names given", "name each"
            )
        own = [key] if a.shape[1] == 1 else [f"{key}{j}" for j in range(a.shape[1])]
        for j, name in enumerate(given or own):
            if name not in ("", "-"):
                found[name] = a[:, j]
    return found


def _csv(path: Path, columns: Mapping[str, Sequence[str]] | Sequence[str]) -> dict[str, Array]:
    from mufly.logs import read_raw

    if isinstance(columns, Mapping):
        raise InputError("--columns", "", "names arrays, but a CSV file has none", "give names alone: a,b,c")
    if not columns:
        table = read_raw(path)["table"]
        numbers = {
            k: _in_si(v.astype(np.float64), table.units.get(k, ""))
            for k, v in table.fields.items()
            if v.dtype.kind in "fiu"
        }
        return {"time": table.time, **{k: v for k, v in numbers.items() if k.lower() not in _TIME}}
    text = path.read_text(encoding="utf-8-sig", errors="replace")
    comma = max((",", ";", "\t", " "), key=text[:2000].count)
    values = np.genfromtxt(text.splitlines(), delimiter=None if comma == " " else comma, invalid_raise=False)
    if values.ndim != 2 or values.shape[1] != len(columns):
        wide = values.shape[1] if values.ndim == 2 else 1
        raise InputError("--columns", ",".join(columns), f"the file has {wide} columns", "name each")
    if not np.isfinite(values[0]).any():
        values = values[1:]  # a header that --columns replaces
    return {name: values[:, j] for j, name in enumerate(columns)}


def _in_si(values: Array, unit: str) -> Array:
    """Return values of a column whose header names a unit in SI."""
    from mufly.logs.units import conversion

    if not unit:
        return values
    _, factor, offset = conversion(unit)
    return factor * values + offset


def _log(path: Path, notes: list[str]) -> dict[str, Array]:
    from mufly.logs import LogWarning, read_log

    with warnings.catch_warnings():
        warnings.simplefilter("ignore", LogWarning)  # they go into the notes
        data = read_log(path)
    notes += [str(n) for n in data.attrs.get("notes", [])]
    found: dict[str, Array] = {"time": np.asarray(data["time"].values, dtype=np.float64)}
    for name, v in data.data_vars.items():
        if v.dtype.kind not in "fiu" or v.dims[:1] != ("time",):
            continue
        if v.ndim == 1:
            found[str(name)] = v.values.astype(np.float64)
        elif v.ndim == 2:
            labels = data[v.dims[1]].values if v.dims[1] in data.coords else range(v.shape[1])
            for j, label in enumerate(labels):
                found[f"{name}.{label}"] = v.values[:, j].astype(np.float64)
    return found


def _even(name: str, found: dict[str, Array], rate_hz: float | None, notes: list[str]) -> Columns:
    key = next((c for c in found if c.lower() in _TIME), None)
    if key is None:
        raise InputError(name, "", "has no column of time", f"call it one of {', '.join(_TIME)}, in seconds")
    time = found.pop(key)
    if time.size < 20:
        raise InputError(name, key, f"has {time.size} samples", "give a record of at least 20")
    steps = np.diff(time)
    if not (steps > 0.0).all():
        at = int(np.flatnonzero(~(steps > 0.0))[0]) + 1
        raise InputError(name, key, f"does not rise at row {at + 1}", "sort the record, or cut it there")
    found = {k: v for k, v in found.items() if len(v) == len(time)}
    step = float(np.median(steps)) if rate_hz is None else 1.0 / rate_hz
    gaps = int((steps > 3.0 * np.median(steps)).sum())
    if gaps:
        notes.append(f"{gaps} gaps in time, the longest {steps.max():.3g} s, were bridged by straight lines")
    missing = {k: int((~np.isfinite(v)).sum()) for k, v in found.items()}
    even = rate_hz is None and bool((np.abs(steps - step) < 0.01 * step).all())
    t = time if even else np.arange(time[0], time[-1] + 0.5 * step, step)
    t = t[t <= time[-1] + 1e-9 * step]
    if not even:
        notes.append(f"resampled to {1.0 / step:.6g} Hz")
    columns, empty = {}, []
    for k, v in found.items():
        good = np.isfinite(v)
        if good.sum() < 2:
            empty.append(k)
            continue
        if missing[k]:
            notes.append(f"{missing[k]} samples of {k} are missing and were bridged")
        columns[k] = v if even and good.all() else np.interp(t, time[good], v[good])
    return Columns(name, t, columns, tuple(notes), tuple(empty))


def lowpassed(signal: Array, dt: float, cut_hz: float) -> Array:
    """Filter columns (n, k) without phase; inputs and outputs filtered alike keep the same linear relation.

    Fourth-order Butterworth, forwards and backwards.

    Raises
    ------
    InputError
        If the cut-off is not below the Nyquist frequency.
    """
    from scipy.signal import butter, sosfiltfilt

    if not 0.0 < cut_hz < 0.5 / dt:
        raise InputError(
            "--lowpass", "", f"{cut_hz:g} Hz is not below the Nyquist frequency", f"under {0.5 / dt:g}"
        )
    return np.asarray(sosfiltfilt(butter(4, cut_hz, fs=1.0 / dt, output="sos"), signal, axis=0))
