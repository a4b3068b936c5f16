"""The clock of a table: whether it runs forward, where it has gaps, and how evenly it ticks.

A logger repeats a stamp, swaps two messages, or loses some; a board that restarts begins to count again. The first two
are repaired and said; a restart is two logs in one, which no sorting can mend, and is refused.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mufly.errors import InputError

__all__ = ["ClockReport", "check_clock", "find_gaps", "usable_samples"]

_Array = NDArray[np.float64]
# More steps back than this share, or a step back longer than this, is no matter of swapped messages.
_BACK_SHARE, _BACK_S = 0.02, 2.0
GAP_FACTOR = 5.0
# What is said now and then has no rate, so no gaps.
_FEWEST_STEPS = 15


@dataclass(frozen=True)
class ClockReport:
    """What :func:`check_clock` found.

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
    def reset(self) -> bool:
        """Whether time runs backward so that it cannot be repaired."""
        few = max(3.0, _BACK_SHARE * self.samples)
        return self.backward > 0 and (self.back_s > _BACK_S or self.backward > few)

    def words(self) -> list[str]:
        """The faults, a sentence each; empty for a sound clock."""
        out = []
        if self.samples > 1 and self.repeated == self.samples - self.missing - 1 > 0:
            return ["the clock stands still"]
        if self.missing:
            out.append(f"{self.missing} of {self.samples} time stamps are missing")
        if self.backward:
            times = "once" if self.backward == 1 else f"{self.backward} times"
            out.append(
                f"time runs backward {times}, by {self.back_s:.3g} s at most, first at sample {self.first_back}"
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


def find_gaps(time: _Array, factor: float = GAP_FACTOR) -> _Array:
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
    if len(steps) < _FEWEST_STEPS:
        return np.empty((0, 2))
    wide = np.flatnonzero(steps > factor * np.median(steps))
    return np.column_stack((time[wide], time[wide + 1]))


def check_clock(time: _Array, gap_factor: float = GAP_FACTOR) -> ClockReport:
    """Examine time stamps.

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


def usable_samples(time: _Array, where: str, key: str) -> tuple[NDArray[np.int64], list[str]]:
    """Return which samples, in which order, make a clock that increases, and what was repaired.

    Samples without a stamp go; swapped ones are put in order; of several with one stamp the last is kept.

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
    report = check_clock(time)
    if report.reset:
        raise InputError(
            where, key, report.words()[-1 if not report.repeated else 0 if not report.missing else 1],
            "the clock was reset or the rows are mixed up: cut the log at that place, or give the right time column",
        )  # fmt: skip
    index = np.flatnonzero(np.isfinite(time))
    order = index[np.argsort(time[index], kind="stable")]
    last = np.append(np.diff(time[order]) > 0, True) if len(order) else np.empty(0, dtype=bool)
    words = []
    name = f"{key}: " if key else ""
    if report.missing:
        words.append(f"{name}{report.missing} samples without a time stamp are left out")
    if report.backward:
        words.append(f"{name}{report.backward} samples came in the wrong order and were sorted by time")
    if not last.all():
        words.append(f"{name}{int((~last).sum())} samples repeat a time stamp; the last of each is kept")
    return order[last], words
