"""Cubic splines through waypoints (Sec. 6.2.2, eqs 6.11 to 6.13).

    P = A t^3 + B t^2 + C t + D,   t in [0, 1]                          (6.11)
    D = x0,  C = x0',  B = 3 (xg - x0) - 2 x0' - xg',  A = 2 (x0 - xg) + x0' + xg'   (6.12)
    T = 3 A t^2 + 2 B t + C,  Q = 6 A t + 2 B,  K = T x Q x T / |T|^4    (6.13, T with the 3 that the print lost)

The boundary derivatives are unit directions times the distance between the two points, which is how "normalised"
velocities are read here. (T x Q) x T / |T|^4 is the curvature vector: it points to the centre of curvature and its
length is one over the radius.

Flying it: the way s(t) along the curve follows a `Profile`, x = P(u(s)), so that

    v = s' T/|T|,   a = s'' T/|T| + s'^2 K.

u(s) comes from a table of arc lengths (Gauss-Legendre), refined by one Newton step. The peak speed V is the lowest
that any point of the curve asks for: the limit on horizontal speed, the climb and descent limits where the curve
rises or falls, and V^2 |K| <= a / sqrt(2), which with s'' <= a / sqrt(2) keeps |a| below its limit.
"""

from __future__ import annotations

import bisect
import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mufly.mission.profile import Profile, profile

__all__ = ["Spline", "SplinePath", "spline", "spline_path"]

_Array = NDArray[np.float64]
_PIECES = 64
_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(5)


@dataclass(frozen=True)
class Spline:
    """One cubic piece; ``coefficients`` is the (4, 3) array A, B, C, D of eq. 6.12."""

    coefficients: _Array

    def at(self, t: ArrayLike) -> tuple[_Array, _Array, _Array]:
        """Point P, tangent T and second derivative Q, each (..., 3), at parameters ``t`` (...)."""
        a, b, c, d = self.coefficients
        u = np.asarray(t, dtype=np.float64)[..., None]
        return ((a * u + b) * u + c) * u + d, (3.0 * a * u + 2.0 * b) * u + c, 6.0 * a * u + 2.0 * b

    def curvature(self, t: ArrayLike) -> _Array:
        """Curvature vectors K (..., 3) in 1/m (eq. 6.13); zero where the tangent vanishes."""
        _, tangent, second = self.at(t)
        square = np.sum(tangent**2, axis=-1, keepdims=True)
        bend = np.cross(np.cross(tangent, second), tangent)
        return np.divide(bend, square**2, out=np.zeros_like(bend), where=square > 1e-12)


def spline(x0: ArrayLike, xg: ArrayLike, dx0: ArrayLike, dxg: ArrayLike) -> Spline:
    """Cubic from x0 to xg (3,) with boundary derivatives dx0 and dxg (3,) (eq. 6.12)."""
    p, g, dp, dg = (np.asarray(v, dtype=np.float64) for v in (x0, xg, dx0, dxg))
    return Spline(np.stack([2.0 * (p - g) + dp + dg, 3.0 * (g - p) - 2.0 * dp - dg, dp, p]))


class SplinePath(NamedTuple):
    """A spline with its timing, laid out for quick evaluation."""

    coefficients: tuple[tuple[float, float, float, float], ...]
    """A, B, C, D for each axis."""
    arc: tuple[float, ...]
    """Arc length at equal steps of the parameter (m)."""
    timing: Profile

    def at(self, t: float) -> tuple[tuple[float, ...], tuple[float, ...], tuple[float, ...]]:
        """Position, velocity and acceleration (3 each; m, m/s, m/s2) at time ``t`` (s)."""
        s, ds, dds = self.timing.at(t)
        arc = self.arc
        k = min(max(bisect.bisect_right(arc, s) - 1, 0), _PIECES - 1)
        u = (k + (s - arc[k]) / (arc[k + 1] - arc[k])) / _PIECES
        p, q, r = self.coefficients
        tn, te, td = (_slope(c, u) for c in (p, q, r))
        length = math.sqrt(tn * tn + te * te + td * td)
        # The table inverts s(u) linearly; a Newton step with the arc up to u makes it smooth.
        u -= (self._arc_at(k, u) - s) / length
        tn, te, td = (_slope(c, u) for c in (p, q, r))
        square = tn * tn + te * te + td * td
        length = math.sqrt(square)
        bn, be, bd = (6.0 * c[0] * u + 2.0 * c[1] for c in (p, q, r))
        along = (tn * bn + te * be + td * bd) / square
        position = tuple(((c[0] * u + c[1]) * u + c[2]) * u + c[3] for c in (p, q, r))
        velocity = (ds * tn / length, ds * te / length, ds * td / length)
        f, g = dds / length, ds * ds / square
        acceleration = (
            f * tn + g * (bn - along * tn),
            f * te + g * (be - along * te),
            f * td + g * (bd - along * td),
        )
        return position, velocity, acceleration

    def _arc_at(self, k: int, u: float) -> float:
        start, half, total = k / _PIECES, 0.5 * (u - k / _PIECES), 0.0
        p, q, r = self.coefficients
        for node, weight in zip(_NODES_T, _WEIGHTS_T, strict=True):
            v = start + half * (1.0 + node)
            a, b, c = _slope(p, v), _slope(q, v), _slope(r, v)
            total += weight * math.sqrt(a * a + b * b + c * c)
        return self.arc[k] + half * total


_NODES_T: tuple[float, ...] = tuple(_NODES.tolist())
_WEIGHTS_T: tuple[float, ...] = tuple(_WEIGHTS.tolist())


def _slope(c: tuple[float, float, float, float], u: float) -> float:
    return (3.0 * c[0] * u + 2.0 * c[1]) * u + c[2]


def spline_path(
    curve: Spline, *, speed: float, climb: float, descent: float, acceleration: float
) -> SplinePath | None:
    """Time-parametrise a spline, from rest to rest, within limits.

    Parameters
    ----------
    curve : Spline
        The way to fly.
    speed, climb, descent : float
        Limits on horizontal speed, on rising and on sinking (m/s).
    acceleration : float
        Limit on the whole acceleration vector (m/s2).

    Returns
    -------
    SplinePath or None
        None where the curve has a point without tangent (a cusp or no length) or so tight a bend that it would
        have to be flown below 5 cm/s; a straight line is the better way then.
    """
    edges = np.linspace(0.0, 1.0, _PIECES + 1)
    inner = edges[:-1, None] + (0.5 * (1.0 + _NODES)) / _PIECES
    pieces = np.linalg.norm(curve.at(inner)[1], axis=-1) @ _WEIGHTS / (2.0 * _PIECES)
    arc = np.concatenate([[0.0], np.cumsum(pieces)])
    dense = np.linspace(0.0, 1.0, 8 * _PIECES + 1)
    tangent = curve.at(dense)[1]
    length = np.linalg.norm(tangent, axis=-1)
    if length.min() < 0.05 * max(arc[-1], 1e-9):
        return None
    level = np.linalg.norm(tangent[:, :2], axis=-1) / length
    fall = tangent[:, 2] / length
    bend = np.linalg.norm(curve.curvature(dense), axis=-1)
    share = acceleration / math.sqrt(2.0)
    tiny = 1e-9
    peak = min(
        speed / max(level.max(), tiny),
        climb / max(-fall.min(), tiny),
        descent / max(fall.max(), tiny),
        math.sqrt(share / max(bend.max(), tiny)),
    )
    if peak < 0.05:
        return None
    table = tuple(tuple(float(v) for v in curve.coefficients[:, axis]) for axis in range(3))
    return SplinePath(
        table,  # type: ignore[arg-type]
        tuple(arc.tolist()),
        profile(float(arc[-1]), peak, share),
    )
