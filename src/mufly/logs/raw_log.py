"""Raw log: topics on their own clocks, checks of the clocks, and resampling to one clock.

A logger repeats a stamp, swaps two messages, or loses some; a board that restarts begins to count again. The first two
are repaired and said; a restart is two logs in one, which no sorting can mend, and is refused. A stamp of another epoch
(never set and 0, damaged, or counted by the GPS or since 1970 where the log counts since the board started) is missing.

Onto a common clock a signal is interpolated linearly or, if it is held (an input, a reference), keeps its last value. A
signal that is sampled faster than the new clock is first low-pass filtered without phase shift (the Kaiser-window FIR
filter of SciPy's ``resample_poly``, whose delay is taken out), so that noise above half the new rate does not fold
down; a held signal is not filtered. Where a signal has no sample within its own gap length the result is NaN: a gap
stays a gap.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import median_filter
from scipy.signal import resample_poly

from mufly.errors import InputError
from mufly.results import result


class LogWarning(UserWarning):
    """Warning about a guess or repair by the reader of a log."""


@dataclass(frozen=True)
class RawTable:
    """One topic of a log.

    Attributes
    ----------
    name : str
        Topic: ``"vehicle_attitude"``; a second instance is ``"battery_status:1"``.
    time : (n,) float64 array
        Seconds since the start of the log, as they were written: not necessarily increasing.
    fields : dict of str to (n,) array
        Numbers, or text (dtype str).
    units : dict of str to str
        Units of those fields for which the file says one.
    """

    name: str
    time: NDArray[np.float64]
    fields: dict[str, NDArray[Any]]
    units: dict[str, str] = field(default_factory=dict)

    @property
    def rate_hz(self) -> float:
        """Rate of the median step of the clock; NaN for fewer than two different instants."""
        steps = np.diff(self.time)
        steps = steps[steps > 0]
        return float(1 / np.median(steps)) if len(steps) else float("nan")


@dataclass(frozen=True)
class RawLog(Mapping[str, RawTable]):
    """A whole log: a mapping from topic to :class:`RawTable`.

    Attributes
    ----------
    path : str
    format_name : str
        ``"MCAP"``, ``"CSV"``, ``"ULog"``, ``"DataFlash"``, ``"MAVLink tlog"``, ``"Crazyflie"``, ``"Parquet"``,
        ``"Feather"`` or ``"NetCDF"``.
    tables_by_topic : dict of str to RawTable
    start_time : str
        Wall time of the instant 0 (ISO 8601, UTC), ``""`` where the file does not tell.
    info : dict
        What the file says of itself: vehicle, software, ...
    messages : tuple of (time_s, level, text)
        What the vehicle said.
    dropouts : tuple of (time_s, duration_s)
        Where the logger itself says that it lost data.
    is_complete : bool
        Whether the file ends as it should, without damage.
    damage_text : str
        Of a file that does not: what is missing, in words, as far as it can be told.
    notes : tuple of str
        What the reader repaired or guessed, in words.
    """

    path: str
    format_name: str
    tables_by_topic: dict[str, RawTable]
    start_time: str = ""
    info: dict[str, Any] = field(default_factory=dict)
    messages: tuple[tuple[float, str, str], ...] = ()
    dropouts: tuple[tuple[float, float], ...] = ()
    is_complete: bool = True
    notes: tuple[str, ...] = ()
    damage_text: str = ""

    def __getitem__(self, topic: str) -> RawTable:
        return self.tables_by_topic[topic]

    def __iter__(self) -> Iterator[str]:
        return iter(self.tables_by_topic)

    def __len__(self) -> int:
        return len(self.tables_by_topic)

    def describe_damage(self) -> list[str]:
        """Return a sentence that says that the file is damaged and what is missing; none for a whole file."""
        what = f": {self.damage_text}" if self.damage_text else ""
        return [] if self.is_complete else [f"the file is damaged or cut off{what}; what is whole is here"]

    @property
    def time_span(self) -> tuple[float, float]:
        """First and last instant of any topic whose clock runs (s); zeros for an empty log."""
        ends = [
            (np.nanmin(t.time), np.nanmax(t.time)) for t in self.tables_by_topic.values() if np.isfinite(t.time).any()
        ]
        ends = [(a, b) for a, b in ends if b > a] or ends
        return (float(min(a for a, _ in ends)), float(max(b for _, b in ends))) if ends else (0.0, 0.0)


def describe_skipped(data: bytes, skipped: Sequence[tuple[int, int]], what: str) -> str:
    """Return in words which parts (first byte, byte behind) of a file are no whole ``what``; ``""`` if none is."""
    said = []
    inside = [(a, b) for a, b in skipped if b < len(data)]
    if inside:
        size = sum(b - a for a, b in inside)
        where = (
            f"at byte {inside[0][0]}"
            if len(inside) == 1
            else f"in {len(inside)} places, the first at byte {inside[0][0]}"
        )
        said.append(f"{size} bytes {where} are no whole {what}")
    for a, b in skipped[len(inside) :]:
        zero = not any(data[a:b])
        said.append(f"the last {b - a} bytes are {'zero' if zero else f'no whole {what}: it is cut or damaged there'}")
    return "; ".join(said)


def format_wall_time(unix_s: float) -> str:
    """Return seconds since 1970 as ISO 8601, UTC, to the millisecond."""
    return datetime.fromtimestamp(unix_s, UTC).isoformat(timespec="milliseconds")


_GPS_EPOCH_S = 315_964_800.0  # 1980-01-06, since 1970
# Days from which on GPS time runs ahead of UTC by 1, 2, ... leap seconds (IERS, Bulletin C).
_LEAP_SECOND_DATES = np.array(
    ["1981-07-01", "1982-07-01", "1983-07-01", "1985-07-01", "1988-01-01", "1990-01-01", "1991-01-01", "1992-07-01",
     "1993-07-01", "1994-07-01", "1996-01-01", "1997-07-01", "1999-01-01", "2006-01-01", "2009-01-01", "2012-07-01",
     "2015-07-01", "2017-01-01"], dtype="datetime64[s]",
).astype(np.float64)  # fmt: skip


def gps_to_unix(week: float, time_of_week_s: float) -> float:
    """Return GPS time as seconds since 1970 (UTC), by the leap seconds of its date.

    Parameters
    ----------
    week : float
        Weeks since 1980-01-06, not counted modulo 1024.
    time_of_week_s : float

    Examples
    --------
    >>> format_wall_time(gps_to_unix(1800, 0.0))
    '2014-07-05T23:59:44.000+00:00'
    """
    gps_s = _GPS_EPOCH_S + week * 604_800.0 + time_of_week_s
    ahead = np.arange(1.0, len(_LEAP_SECOND_DATES) + 1.0)
    return gps_s - float(np.searchsorted(_LEAP_SECOND_DATES + ahead, gps_s, side="right"))


class Channel(NamedTuple):
    """One component of a signal on its own clock.

    Attributes
    ----------
    name : str
        ``measured_attitude.roll``, the variable alone for a scalar, or ``topic/field`` for a field as it is.
    units : str
        ``""`` as long as nobody has said.
    time, values : (n,) array
        s; numbers, or text (dtype str).
    source : str
        Topic and field that it comes from.
    hold : bool
        Whether it keeps its last value between samples.
    long_name : str
    """

    name: str
    units: str
    time: NDArray[np.float64]
    values: NDArray[Any]
    source: str = ""
    hold: bool = False
    long_name: str = ""

    @property
    def signal_name(self) -> str:
        """Name of the signal without the component."""
        return self.name.partition(".")[0]

    @property
    def component_label(self) -> str | None:
        """Label of the component; None for a scalar."""
        return self.name.partition(".")[2] or None

    @property
    def column_name(self) -> str:
        """Name as a column of a table, ``measured_attitude_roll``."""
        return self.name.replace(".", "_")

    @property
    def is_text(self) -> bool:
        """Whether the values are text."""
        return self.values.dtype.kind in "US"


_Array = NDArray[np.float64]
_DAY_S = 86_400.0
# More steps back than this share, or a step back longer than this, is no matter of swapped messages.
_MAX_BACKWARD_SHARE, _MAX_BACKWARD_S = 0.02, 2.0
MIN_GAP_STEPS = 5.0
# What is said now and then has no rate, so no gaps.
_MIN_GAP_TEST_STEPS = 15


@result
class ClockReport:
    """Result of :func:`check_clock`.

    Attributes
    ----------
    samples : int
    rate_hz : float
        Of the median step; NaN for fewer than two different instants.
    jitter : float
        Standard deviation of the steps that are no gaps, over the median step.
    missing, repeated, backward : int
        Stamps that are not finite; equal to the one before; earlier than the one before.
    back_s : float
        The longest step back (s).
    first_back : int
        Sample at which time first runs backward, -1 if it never does.
    gaps : (k, 2) array
        Beginning and end of each gap (s).
    """

    samples: int
    rate_hz: float
    jitter: float
    missing: int
    repeated: int
    backward: int
    back_s: float
    first_back: int
    gaps: _Array

    @property
    def is_reset(self) -> bool:
        """Whether time runs backward beyond repair."""
        few = max(3.0, _MAX_BACKWARD_SHARE * self.samples)
        return self.backward > 0 and (self.back_s > _MAX_BACKWARD_S or self.backward > few)

    def describe_faults(self) -> list[str]:
        """Return one sentence per fault; empty for a faultless clock."""
        out = []
        if self.samples > 1 and self.repeated == self.samples - self.missing - 1 > 0:
            return ["the clock stands still"]
        if self.missing == self.samples > 0:
            return ["no message has a time stamp"]
        if self.missing:
            out.append(f"{self.missing} of {self.samples} time stamps are missing")
        if self.backward:
            times = "once" if self.backward == 1 else f"{self.backward} times"
            out.append(f"time runs backward {times}, by {self.back_s:.3g} s at most, first at sample {self.first_back}")
        if self.repeated:
            out.append(f"{self.repeated} of {self.samples} time stamps repeat the one before")
        if len(self.gaps):
            length = self.gaps[:, 1] - self.gaps[:, 0]
            k = int(length.argmax())
            many = "1 gap" if len(length) == 1 else f"{len(length)} gaps"
            out.append(
                f"{many}, {length.sum():.3g} s in all, the longest {length[k]:.3g} s at {self.gaps[k, 0]:.2f} s "
                f"(median step {1e3 / self.rate_hz:.3g} ms)"
            )
        return out


def find_gaps(time: _Array, factor: float = MIN_GAP_STEPS) -> _Array:
    """Return beginning and end of every step longer than ``factor`` median steps; none for fewer than 16 samples.

    Parameters
    ----------
    time : (n,) array
        Increasing (s).
    factor : float

    Returns
    -------
    (k, 2) array
    """
    steps = np.diff(time)
    if len(steps) < _MIN_GAP_TEST_STEPS:
        return np.empty((0, 2))
    wide = np.flatnonzero(steps > factor * np.median(steps))
    return np.column_stack((time[wide], time[wide + 1]))


def check_clock(time: _Array, gap_factor: float = MIN_GAP_STEPS) -> ClockReport:
    """Check time stamps.

    Parameters
    ----------
    time : (n,) array
        As written (s).
    gap_factor : float
        A step longer than this many median steps is a gap.
    """
    finite = time[np.isfinite(time)]
    steps = np.diff(finite)
    back = steps < 0
    forward = np.unique(finite)
    ticks = np.diff(forward)
    median = float(np.median(ticks)) if len(ticks) else float("nan")
    even = ticks[ticks <= gap_factor * median]
    return ClockReport(
        samples=len(time),
        rate_hz=1 / median if len(ticks) else float("nan"),
        jitter=float(even.std() / median) if len(even) else 0.0,
        missing=len(time) - len(finite),
        repeated=int((steps == 0).sum()),
        backward=int(back.sum()),
        back_s=float(-steps.min()) if back.any() else 0.0,
        first_back=int(back.argmax()) + 1 if back.any() else -1,
        gaps=find_gaps(forward, gap_factor),
    )


def find_foreign_stamps(times: Mapping[str, NDArray[Any]]) -> tuple[dict[str, NDArray[np.bool_]], list[str]]:
    """Find stamps in another epoch than the log.

    No flight lasts a day, but epochs lie years apart: the board's clock counts since it started, the clock of the GPS
    since 1980 or since Sunday, UTC since 1970; a stamp never set is 0, a damaged one anything. Where the stamps of all
    topics together leave out a whole day or more they belong to different clocks, and the log's is the one on which
    most topics run (each topic counts by the share of its stamps there; of equals the one with more stamps). Where no
    clock has the half of them, nobody can say, and none is foreign.

    Parameters
    ----------
    times : dict of str to (n,) array
        Stamps of every topic, all counted from the same instant (s); NaN is no stamp.

    Returns
    -------
    foreign : dict of str to (n,) bool array
    words : list of str
        One sentence a topic that has some.
    """
    foreign = {name: np.zeros(len(t), dtype=bool) for name, t in times.items()}
    days = {k: np.floor(np.asarray(t, dtype=np.float64) / _DAY_S) for k, t in times.items()}
    counts = {k: np.unique(d[np.isfinite(d)], return_counts=True) for k, d in days.items()}
    known = np.unique(np.concatenate([d for d, _ in counts.values()])) if counts else np.empty(0)
    parts = np.split(known, np.flatnonzero(np.diff(known) > 1) + 1)
    if len(parts) < 2:
        return foreign, []

    def stamp_weight(part: _Array) -> tuple[float, int]:
        there = [(int(n[np.isin(d, part)].sum()), int(n.sum())) for d, n in counts.values() if len(n)]
        return sum(a / b for a, b in there), sum(a for a, _ in there)

    bulk = max(parts, key=stamp_weight)
    if stamp_weight(bulk)[0] < 0.5 * sum(stamp_weight(p)[0] for p in parts):
        return foreign, []
    words = []
    for name, d in days.items():
        foreign[name] = np.isfinite(d) & ~((d >= bulk[0]) & (d <= bulk[-1]))
        strange = np.asarray(times[name], dtype=np.float64)[foreign[name]]
        if len(strange):
            what = "1 time stamp" if len(strange) == 1 else f"{len(strange)} time stamps"
            clock = "never set" if (strange == 0).all() else f"from another clock, {strange[0]:.6g} s"
            words.append(f"{name or 'the clock'}: {what} of {len(d)} left out ({clock})")
    return foreign, words


def select_usable_samples(time: _Array, where: str, key: str) -> tuple[NDArray[np.int64], list[str]]:
    """Return the indices of samples that form an increasing clock, and descriptions of repairs.

    Samples without a stamp go, and single ones whose stamp is far from those on either side; swapped ones are put in
    order; of several with one stamp the last is kept.

    Returns
    -------
    index : (m,) int array
    words : list of str
        One sentence a repair; empty for a sound clock.

    Raises
    ------
    InputError
        If time was set back: by more than 2 s, or more often than at one sample in fifty.
    """
    words = []
    name = f"{key}: " if key else ""
    wild = _find_wild_stamps(time)
    if wild.any():
        one = f"a time stamp is far from its neighbours and its sample ({int(wild.argmax())})"
        many = f"{int(wild.sum())} time stamps are far from their neighbours and their samples"
        words.append(f"{name}{one if wild.sum() == 1 else many} left out")
        time = np.where(wild, np.nan, time)
    report = check_clock(time)
    if report.is_reset:
        raise InputError(
            where, key, next(w for w in report.describe_faults() if w.startswith("time runs backward")),
            "the clock was reset or the rows are mixed up: cut the log at that place, or give the right time column",
        )  # fmt: skip
    index = np.flatnonzero(np.isfinite(time))
    order = index[np.argsort(time[index], kind="stable")]
    last = np.append(np.diff(time[order]) > 0, True) if len(order) else np.empty(0, dtype=bool)
    unset = report.missing - int(wild.sum())
    if unset:
        words.append(f"{name}{unset} samples without a time stamp are left out")
    if report.backward:
        words.append(f"{name}{report.backward} samples came in the wrong order and were sorted by time")
    if not last.all():
        words.append(f"{name}{int((~last).sum())} samples repeat a time stamp; the last of each is kept")
    return order[last], words


def _find_wild_stamps(time: _Array) -> NDArray[np.bool_]:
    """Single stamps (or two in a row) far from those on either side, which go on as if they were not there.

    The median of five stamps that increase is the middle one, whatever their steps: a sound clock has none.
    """
    out = np.zeros(len(time), dtype=bool)
    known = np.flatnonzero(np.isfinite(time))
    if len(known) >= 5:
        t = time[known]
        out[known[np.abs(t - median_filter(t, size=5, mode="nearest")) > _MAX_BACKWARD_S]] = True
    # Where they are no exception, the rows are mixed up.
    return out if out.sum() <= max(3.0, _MAX_BACKWARD_SHARE * len(known)) else np.zeros_like(out)


_MAX_SAMPLES = 50_000_000


def common_clock(spans: list[tuple[float, float]], rate_hz: float) -> _Array:
    """Return instants at a rate from the first beginning to the last end, counted from the instant 0.

    Parameters
    ----------
    spans : list of (begin_s, end_s)
    rate_hz : float

    Raises
    ------
    InputError
        If that makes more than 50 million instants: then a time stamp is wrong.
    """
    first, last = min(a for a, _ in spans), max(b for _, b in spans)
    if not (last - first) * rate_hz < _MAX_SAMPLES:
        problem = f"lasts from {first:.6g} to {last:.6g} s, at {rate_hz:.6g} Hz too many instants"
        raise InputError("the log", "time", problem, "a time stamp is wrong, or give a lower rate")
    tolerance = 1e-6
    low, high = np.ceil(first * rate_hz - tolerance), np.floor(last * rate_hz + tolerance)
    out: _Array = np.arange(low, high + 1) / rate_hz + 0.0  # no -0.0
    return out


def resample_signal(
    time: _Array, values: _Array, onto: _Array, *, hold: bool = False, gap_s: float | None = None
) -> _Array:
    """Resample a signal to another clock.

    Parameters
    ----------
    time : (n,) array
        Increasing (s).
    values : (n,) array
        NaN counts as missing.
    onto : (m,) array
        Increasing and evenly spaced (s).
    hold : bool
        Keep the last value instead of interpolating.
    gap_s : float, optional
        Longest step that is bridged (s). Default: five median steps of the signal.

    Returns
    -------
    (m,) array
        NaN before the first and after the last sample, and in gaps.
    """
    known = np.isfinite(values)
    t, x = time[known], values[known]
    if len(t) < 2:
        return np.full(len(onto), np.nan)
    step = float(np.median(np.diff(t)))
    longest = MIN_GAP_STEPS * step if gap_s is None else gap_s
    new_step = float(onto[1] - onto[0]) if len(onto) > 1 else step
    slack = 1e-6 * min(step, new_step)
    before = np.searchsorted(t, onto + slack, side="right") - 1
    if hold:
        out = x[np.clip(before, 0, None)].copy()
    else:
        if new_step > 1.5 * step:
            t_even, x = _low_pass(t, x, new_step, step)
            out = np.interp(onto, t_even, x)
        else:
            out = np.interp(onto, t, x)
    # The instant is known if it lies on a sample or between two that are near each other.
    left = t[np.clip(before, 0, None)]
    right = t[np.clip(before + 1, None, len(t) - 1)]
    on_sample = np.abs(onto - left) <= slack
    bridged = right - left <= longest
    if hold:
        out[before < 0] = np.nan
    inside = (onto >= t[0] - slack) & (onto <= t[-1] + (step if hold else slack))
    out[~(inside & (on_sample | bridged))] = np.nan
    return out


def _low_pass(t: _Array, x: _Array, new_step: float, step: float) -> tuple[_Array, _Array]:
    """Low-pass the signal below half the new rate, on a uniform clock of the new step."""
    factor = max(int(np.ceil(new_step / step)), 2)
    start = np.floor(t[0] / new_step) * new_step
    n = int(np.ceil((t[-1] - start) / new_step)) * factor + 1
    fine = start + np.arange(n) * (new_step / factor)
    even = np.interp(fine, t, x)
    low: _Array = np.asarray(resample_poly(even, 1, factor, padtype="line"), dtype=np.float64)
    return fine[::factor], low


def unwrap_angle(angle: _Array, period: float = 2 * np.pi) -> _Array:
    """Unwrap an angle (rad) along the first axis, across missing values."""
    out = angle.copy()
    for column in out.reshape(len(out), -1).T:
        known = np.isfinite(column)
        column[known] = np.unwrap(column[known], period=period)
    return out
