"""How good is a trajectory? Against the truth: errors, drift, lost pictures, and whether its covariance is true.

ATE (Sturm et al. 2012) is the root mean square of position errors, here as they stand and after the best turn about the
vertical and shift (Umeyama 1991; scale left alone). RPE is the error of the way made in a time, without how it was
turned before. NEES is e^T P^-1 e over N, E, D and heading; over its four numbers it is one where P is true, and
inside the 95 % ellipsoid are those below the chi-squared quantile 9.49.
"""

from __future__ import annotations

import math
from dataclasses import field

import numpy as np
from numpy.typing import NDArray

from mufly.errors import InputError
from mufly.results import result

_Array = NDArray[np.float64]
CHI2_95 = 9.4877
_TOLD_M = 1e-4
"""A place that is known better was not found but told: where a map begins (m). It has no share in NEES."""


@result
class Evaluation:
    """Of one trajectory. Lengths in m, angles in rad."""

    pictures: int = field(metadata={"unit": "1", "meaning": "pictures, of which so many were answered"})
    lost: float = field(metadata={"unit": "1", "meaning": "share without an answer"})
    rms_m: float = field(metadata={"unit": "m", "meaning": "horizontal error as it stands, root mean square"})
    worst_m: float = field(metadata={"unit": "m", "meaning": "greatest horizontal error"})
    height_rms_m: float = field(metadata={"unit": "m", "meaning": "error of the height, root mean square"})
    heading_rms_rad: float = field(
        metadata={"unit": "rad", "meaning": "error of the heading, root mean square"}
    )
    ate_m: float = field(
        metadata={"unit": "m", "meaning": "position error after the best shift and turn, rms"}
    )
    rpe_m: float = field(metadata={"unit": "m", "meaning": "error of the way made in a second, rms"})
    way_m: float = field(metadata={"unit": "m", "meaning": "way flown"})
    end_m: float = field(metadata={"unit": "m", "meaning": "horizontal error at the end"})
    nees: float = field(metadata={"unit": "1", "meaning": "NEES over its four numbers"})
    inside: float = field(metadata={"unit": "1", "meaning": "share inside the 95 % ellipsoid"})


def evaluate(
    time: _Array, position: _Array, heading: _Array, covariance: _Array | None, true_time: _Array, true_position:
    _Array, true_heading: _Array, pictures: int | None = None,
) -> Evaluation:  # fmt: skip
    """Compare answers with the truth.

    Parameters
    ----------
    time, position, heading : (n,), (n, 3), (n,) arrays
        Answers (s, m N-E-D, rad).
    covariance : (n, 4, 4) array or None
        Of N, E, D, heading.
    true_time, true_position, true_heading : (m,), (m, 3), (m,) arrays
    pictures : int, optional
        How many there were; by default as many as answers.

    Raises
    ------
    InputError
        If answers and truth do not overlap in time.
    """
    inside = (time >= true_time[0] - 0.02) & (time <= true_time[-1] + 0.02)
    if inside.sum() < 3:
        raise InputError(
            "trajectory", "", "has fewer than three answers in the time of the truth", "give its own truth"
        )
    t, x, psi = time[inside], position[inside], heading[inside]
    true = np.stack([np.interp(t, true_time, c) for c in true_position.T], axis=1)
    turn = np.interp(t, true_time, np.unwrap(true_heading))
    off = x - true
    turned = np.angle(np.exp(1j * (psi - turn)))
    flat = np.hypot(off[:, 0], off[:, 1])
    way = float(np.hypot(*np.diff(true[:, :2], axis=0).T).sum())
    nees = within = math.nan
    found = inside if covariance is None else inside & (covariance[:, 0, 0] > _TOLD_M**2)
    if covariance is not None and found.any():
        e, p = np.column_stack([off, turned])[found[inside]], covariance[found]
        each = np.einsum("ni,ni->n", e, np.linalg.solve(p, e[..., None])[..., 0])
        nees, within = float(each.mean() / 4), float((each < CHI2_95).mean())
    count = len(time) if pictures is None else pictures
    return Evaluation(
        count, 1.0 - len(time) / max(count, 1), _rms(flat), float(flat.max()), _rms(off[:, 2]), _rms(turned),
        _rms(np.linalg.norm(_aligned(x, true) - true, axis=1)), _relative(t, x, psi, true, turn), way, float(flat[-1]),
        nees, within,
    )  # fmt: skip


def _rms(a: _Array) -> float:
    return float(np.sqrt(np.mean(np.square(a))))


def _aligned(x: _Array, true: _Array) -> _Array:
    a, b = x - x.mean(axis=0), true - true.mean(axis=0)
    z = np.angle(((a[:, 0] - 1j * a[:, 1]) * (b[:, 0] + 1j * b[:, 1])).sum())
    c, s = math.cos(z), math.sin(z)
    return a @ np.array([[c, s, 0], [-s, c, 0], [0, 0, 1.0]]) + true.mean(axis=0)


def _relative(t: _Array, x: _Array, psi: _Array, true: _Array, turn: _Array, span_s: float = 1.0) -> float:
    j = np.searchsorted(t, t + span_s)
    i = np.nonzero(j < len(t))[0]
    if not len(i):
        return math.nan
    j = j[i]
    i, j = i[t[j] - t[i] < 1.5 * span_s], j[t[j] - t[i] < 1.5 * span_s]

    def way(p: _Array, h: _Array) -> _Array:
        d = p[j] - p[i]
        z = (d[:, 0] + 1j * d[:, 1]) * np.exp(-1j * h[i])
        return np.column_stack([z.real, z.imag, d[:, 2]])

    return _rms(np.linalg.norm(way(x, psi) - way(true, turn), axis=1)) if len(i) else math.nan
