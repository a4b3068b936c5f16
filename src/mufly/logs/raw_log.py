"""Raw log: topics on their own clocks, checks of the clocks, and resampling to one clock.

Faults of clocks: a logger repeats a stamp, swaps two messages, or loses some; these are repaired and reported. After a
restart a board counts from zero again: such a file holds two logs, which sorting cannot separate, and is refused. A
stamp of another epoch is treated as missing: a stamp that was never set (0), is damaged, or counts by GPS or since 1970
in a log whose clock counts since the start of the board.

Resampling to a common clock: a signal is interpolated linearly; a held signal (an input, a reference) keeps its last
value. A signal with a higher rate than the new clock is first low-pass filtered without phase shift, so that noise
above half the new rate is not aliased. The filter is the Kaiser-window FIR filter of SciPy's ``resample_poly``, with
its delay removed; a held signal is not filtered. The result is NaN in gaps of the signal.
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
        Seconds since the start of the log, as written; not necessarily increasing.
    fields : dict of str to (n,) array
        Numbers, or text (dtype str).
    units : dict of str to str
        Units of the fields for which the file states one.
    """

    name: str
    time: NDArray[np.float64]
    fields: dict[str, NDArray[Any]]
    units: dict[str, str] = field(default_factory=dict)

    @property
    def rate_hz(self) -> float:
        """Sample rate (Hz), the reciprocal of the median time step; NaN for fewer than two different instants."""
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
        Wall time of the instant 0 (ISO 8601, UTC); ``""`` if unknown.
    info : dict
        Information in the file: vehicle, software, ...
    messages : tuple of (time_s, level, text)
        Text messages of the vehicle.
    dropouts : tuple of (time_s, duration_s)
        Losses of data that the logger recorded.
    is_complete : bool
        Whether the file ends regularly and has no damage.
    damage_text : str
        Description of the missing parts of an incomplete file.
    notes : tuple of str
        Repairs and guesses of the reader, as sentences.
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
        """Return a sentence on the damage of the file, in a list that is empty for a complete file."""
        what = f": {self.damage_text}" if self.damage_text else ""
        return [] if self.is_complete else [f"the file is damaged or truncated{what}; all complete data are read"]

    @property
    def time_span(self) -> tuple[float, float]:
        """Return the first and last instant of all topics with a running clock (s); zeros for an empty log."""
        ends = [
            (np.nanmin(t.time), np.nanmax(t.time)) for t in self.tables_by_topic.values() if np.isfinite(t.time).any()
        ]
        ends = [(a, b) for a, b in ends if b > a] or ends
        return (float(min(a for a, _ in ends)), float(max(b for _, b in ends))) if ends else (0.0, 0.0)


def describe_skipped_bytes(data: bytes, skipped: Sequence[tuple[int, int]], what: str) -> str:
    """Return a description of the byte ranges [begin, end) that are no complete ``what``; ``""`` without any."""
    said = []
    inside = [(a, b) for a, b in skipped if b < len(data)]
    if inside:
        size = sum(b - a for a, b in inside)
        where = (
            f"at byte {inside[0][0]}"
            if len(inside) == 1
            else f"in {len(inside)} places, the first at byte {inside[0][0]}"
        )
        said.append(f"{size} bytes {where} are not a complete {what}")
    for a, b in skipped[len(inside) :]:
        zero = not any(data[a:b])
        said.append(
            f"the last {b - a} bytes are "
            f"{'zero' if zero else f'not a complete {what}: the file is truncated or damaged there'}"
        )
    return "; ".join(said)


def format_wall_time(unix_s: float) -> str:
    """Return seconds since 1970 as ISO 8601, UTC, to the millisecond."""
    return datetime.fromtimestamp(unix_s, UTC).isoformat(timespec="milliseconds")


_GPS_EPOCH_S = 315_964_800.0  # 1980-01-06, since 1970
# Dates from which GPS time is ahead of UTC by 1, 2, ... leap seconds (IERS, Bulletin C).
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
        ``measured_attitude.roll``, only the variable for a scalar, or ``topic/field`` for an unconverted field.
    units : str
        Unit; ``""`` while unknown.
    time, values : (n,) array
        Time (s); numbers, or text (dtype str).
    source : str
        Topic and field of the source.
    hold : bool
        Whether the signal keeps its last value between samples.
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
        """Return whether the values are text."""
        return self.values.dtype.kind in "US"


_Array = NDArray[np.float64]
_DAY_S = 86_400.0
# A larger fraction of steps back, or a longer step back, is no swap of messages.
_MAX_BACKWARD_FRACTION, _MAX_BACKWARD_S = 0.02, 2.0
MIN_GAP_STEPS = 5.0
# Occasional messages have no rate, and so no gaps.
_MIN_GAP_TEST_STEPS = 15


@result
class ClockReport:
    """Rate, gaps and faults of time stamps, from :func:`examine_time_stamps`.

    Attributes
    ----------
    samples : int
    rate_hz : float
        Rate of the median step (Hz); NaN for fewer than two different instants.
    jitter_ratio : float
        Standard deviation of the steps without gaps, over the median step.
    nonfinite_stamps, repeated, backward : int
        Numbers of stamps that are not finite, equal to the previous one, and earlier than the previous one.
    longest_step_back_s : float
        Longest step back (s).
    first_back : int
        First sample at which time runs backward; -1 if there is none.
    gaps : (k, 2) array
        Begin and end of each gap (s).
    """

    samples: int
    rate_hz: float
    jitter_ratio: float
    nonfinite_stamps: int
    repeated: int
    backward: int
    longest_step_back_s: float
    first_back: int
    gaps: _Array

    @property
    def is_reset(self) -> bool:
        """Return whether time runs backward beyond repair."""
        few = max(3.0, _MAX_BACKWARD_FRACTION * self.samples)
        return self.backward > 0 and (self.longest_step_back_s > _MAX_BACKWARD_S or self.backward > few)

    def describe_faults(self) -> list[str]:
        """Return one sentence per fault; empty for a faultless clock."""
        out = []
        if self.samples > 1 and self.repeated == self.samples - self.nonfinite_stamps - 1 > 0:
            return ["the clock stands still"]
        if self.nonfinite_stamps == self.samples > 0:
            return ["no message has a time stamp"]
        if self.nonfinite_stamps:
            out.append(f"{self.nonfinite_stamps} of {self.samples} time stamps are missing")
        if self.backward:
            times = "once" if self.backward == 1 else f"{self.backward} times"
            out.append(
                f"time runs backward {times}, by {self.longest_step_back_s:.3g} s at most, "
                f"first at sample {self.first_back}"
            )
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
        Increasing time (s).
    factor : float
        Number of median steps above which a step is a gap.

    Returns
    -------
    (k, 2) array
    """
    steps = np.diff(time)
    if len(steps) < _MIN_GAP_TEST_STEPS:
        return np.empty((0, 2))
    wide = np.flatnonzero(steps > factor * np.median(steps))
    return np.column_stack((time[wide], time[wide + 1]))


def examine_time_stamps(time: _Array) -> ClockReport:
    """Return the rate of time stamps, and their gaps, repetitions and backward steps.

    Parameters
    ----------
    time : (n,) array
        Stamps as written (s).
    """
    finite = time[np.isfinite(time)]
    steps = np.diff(finite)
    back = steps < 0
    forward = np.unique(finite)
    ticks = np.diff(forward)
    median = float(np.median(ticks)) if len(ticks) else float("nan")
    even = ticks[ticks <= MIN_GAP_STEPS * median]
    return ClockReport(
        samples=len(time),
        rate_hz=1 / median if len(ticks) else float("nan"),
        jitter_ratio=float(even.std() / median) if len(even) else 0.0,
        nonfinite_stamps=len(time) - len(finite),
        repeated=int((steps == 0).sum()),
        backward=int(back.sum()),
        longest_step_back_s=float(-steps.min()) if back.any() else 0.0,
        first_back=int(back.argmax()) + 1 if back.any() else -1,
        gaps=find_gaps(forward, MIN_GAP_STEPS),
    )


def find_foreign_epoch_stamps(times: Mapping[str, NDArray[Any]]) -> tuple[dict[str, NDArray[np.bool_]], list[str]]:
    """Mark time stamps that count from another epoch than the rest of the log, and describe them.

    No flight lasts a day, but epochs differ by years. The board's clock counts since its start, the GPS clock since
    1980 or since Sunday, UTC since 1970. A stamp never set is 0, and a damaged stamp may have any value. Stamps of all
    topics that are separated by a day or more belong to different clocks. The clock of the log is the one of most
    topics, each counted by the share of its stamps there; of equal clocks it is the one with more stamps. If no clock
    has half of the topics, the epoch is undecidable, and no stamp is foreign.

    Parameters
    ----------
    times : dict of str to (n,) array
        Stamps of every topic since one instant (s); NaN is no stamp.

    Returns
    -------
    foreign : dict of str to (n,) bool array
        True for stamps in another epoch.
    words : list of str
        One sentence for each topic with foreign stamps.
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
            words.append(f"{name or 'the clock'}: {what} of {len(d)} ignored ({clock})")
    return foreign, words


def select_usable_samples(time: _Array, where: str, key: str) -> tuple[NDArray[np.int64], list[str]]:
    """Return the indices of samples that form an increasing clock, and descriptions of repairs.

    Samples without a stamp, and single samples with a stamp far from both neighbours, are omitted. Swapped samples are
    sorted; of several with one stamp the last is kept.

    Returns
    -------
    index : (m,) int array
        Indices of the samples to keep, in order of time.
    words : list of str
        One sentence for each repair; empty for a sound clock.

    Raises
    ------
    InputError
        If time was set back by more than 2 s, or at more than one sample in fifty.
    """
    words = []
    name = f"{key}: " if key else ""
    wild = _find_wild_stamps(time)
    if wild.any():
        one = f"sample {int(wild.argmax())} has a time stamp far from its neighbours"
        many = f"{int(wild.sum())} samples have time stamps far from their neighbours"
        words.append(f"{name}{one if wild.sum() == 1 else many}, skipped")
        time = np.where(wild, np.nan, time)
    report = examine_time_stamps(time)
    if report.is_reset:
        raise InputError(
            where, key, next(w for w in report.describe_faults() if w.startswith("time runs backward")),
            "the clock was reset or the rows are mixed up: cut the log at that place, or give the right time column",
        )  # fmt: skip
    index = np.flatnonzero(np.isfinite(time))
    order = index[np.argsort(time[index], kind="stable")]
    last = np.append(np.diff(time[order]) > 0, True) if len(order) else np.empty(0, dtype=bool)
    unset = report.nonfinite_stamps - int(wild.sum())
    if unset:
        words.append(f"{name}{unset} samples without a time stamp are skipped")
    if report.backward:
        words.append(f"{name}{report.backward} samples are in the wrong order and were sorted by time")
    if not last.all():
        words.append(f"{name}{int((~last).sum())} samples repeat a time stamp; the last of each is kept")
    return order[last], words


def _find_wild_stamps(time: _Array) -> NDArray[np.bool_]:
    """Return a mask of wrong time stamps: one or two in a row, far from the stamps before and after.

    The median of five increasing stamps is the middle one for any steps, so a sound clock has no such stamps.
    """
    out = np.zeros(len(time), dtype=bool)
    known = np.flatnonzero(np.isfinite(time))
    if len(known) >= 5:
        t = time[known]
        out[known[np.abs(t - median_filter(t, size=5, mode="nearest")) > _MAX_BACKWARD_S]] = True
    # If they are frequent, the rows are out of order.
    return out if out.sum() <= max(3.0, _MAX_BACKWARD_FRACTION * len(known)) else np.zeros_like(out)


_MAX_RESAMPLED_SAMPLES = 50_000_000


def common_clock(spans: list[tuple[float, float]], rate_hz: float) -> _Array:
    """Return uniform sample times from the earliest begin to the latest end, at multiples of 1 / ``rate_hz``.

    Parameters
    ----------
    spans : list of (begin_s, end_s)
    rate_hz : float

    Raises
    ------
    InputError
        If there are more than 50 million instants, which indicates a wrong time stamp.
    """
    first, last = min(a for a, _ in spans), max(b for _, b in spans)
    if not (last - first) * rate_hz < _MAX_RESAMPLED_SAMPLES:
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
        Increasing time (s).
    values : (n,) array
        Values; NaN counts as missing.
    onto : (m,) array
        Increasing, uniform time (s).
    hold : bool
        Keep the last value instead of interpolating.
    gap_s : float, optional
        Longest step to bridge (s). Default: five median steps of the signal.

    Returns
    -------
    (m,) array
        Resampled values; NaN before the first and after the last sample, and in gaps.
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
            t_even, x = _low_pass_onto_new_clock(t, x, new_step, step)
            out = np.interp(onto, t_even, x)
        else:
            out = np.interp(onto, t, x)
    # The value is known on a sample and between two samples that are close together.
    left = t[np.clip(before, 0, None)]
    right = t[np.clip(before + 1, None, len(t) - 1)]
    on_sample = np.abs(onto - left) <= slack
    bridged = right - left <= longest
    if hold:
        out[before < 0] = np.nan
    inside = (onto >= t[0] - slack) & (onto <= t[-1] + (step if hold else slack))
    out[~(inside & (on_sample | bridged))] = np.nan
    return out


def _low_pass_onto_new_clock(t: _Array, x: _Array, new_step: float, step: float) -> tuple[_Array, _Array]:
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
