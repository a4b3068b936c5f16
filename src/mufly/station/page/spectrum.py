"""The spectrum of a signal, with marks where the rotors would show.

Power spectral density by Welch's method (Hann window, halves overlapping), one-sided, so that its integral over
frequency is the variance. A rotor of speed Omega shakes the fuselage at its rate of turn f = Omega / 2 pi and, with b
blades, at b f. The link samples at f_s; what lies above f_s / 2 shows, folded, at |f - round(f / f_s) f_s|, and is
marked there.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.signal import detrend, welch

__all__ = ["BLADES", "folded", "marks", "spectrum"]

BLADES = 2
LEAST_SAMPLES = 64

_Array = NDArray[np.float64]


def folded(frequency_hz: float, rate_hz: float) -> float:
    """Where a frequency (Hz) shows in a signal sampled at ``rate_hz``."""
    return abs(frequency_hz - round(frequency_hz / rate_hz) * rate_hz)


def spectrum(times: _Array, values: _Array) -> tuple[float, _Array, _Array] | None:
    """Return sampling rate (Hz), frequencies (m,) and densities (m,; unit^2/Hz) of samples (n,) at times (n,; s).

    Gaps are bridged by straight lines, onto an even clock at the median step. None if there is too little to say.
    """
    good = np.isfinite(values)
    times, values = times[good], values[good]
    if len(times) < LEAST_SAMPLES:
        return None
    step = float(np.median(np.diff(times)))
    if not step > 0.0:
        return None
    clock = np.arange(times[0], times[-1], step)
    if len(clock) < LEAST_SAMPLES:
        return None
    even = np.interp(clock, times, values)
    length = min(len(even), 1024)
    frequency, density = welch(even, 1.0 / step, "hann", length, length // 2, detrend=detrend)
    return 1.0 / step, frequency[1:], density[1:]


def marks(rotor_speed: _Array, rate_hz: float) -> list[dict[str, Any]]:
    """Return where rotors (upper, lower; rad/s) show: ``name``, ``hz`` (true), ``at`` (in the picture), ``folded``."""
    out = []
    for name, speed in zip(("upper", "lower"), rotor_speed.tolist(), strict=True):
        if not (math.isfinite(speed) and speed > 1.0):
            continue
        for label, times in ((name, 1), (f"{name} ×{BLADES}", BLADES)):
            true = times * speed / (2.0 * math.pi)
            at = folded(true, rate_hz)
            out.append({"name": label, "hz": true, "at": at, "folded": true > 0.5 * rate_hz})
    return out
