"""Finite chord: the blade as a lifting surface with one row of horseshoe vortices (own derivation, docs/bemt.md).

Blade element theory puts the whole blade on one line. A blade of aspect ratio 2.5 to 6 is not a line: the
downwash of its own trailing vortices grows along the chord, and the flow has to be tangent to the chord, not to
a line. Weissinger's rule (NACA TM 1120, 1947) satisfies tangency at three quarters of the chord with the vortex
at one quarter, exact for a flat plate in two dimensions. With G the circulation of the panels of one blade,

    w_34 = A34 G     downwash at three quarters of the chord from the blade's own bound and near trailing vortices
    w_14 = A14 G     the same on the quarter chord line, which is what a lifting line feels
    G / (pi c)       what the bound vortex alone induces at three quarters of the chord in two dimensions

and a section in two dimensional flow that feels w_14 sees too large an angle, by

    d_alpha = [A34 - A14 - diag(1 / (pi c))] G / W = e c_l,      e = c [(A34 - A14) G - G / (pi c)] / (2 G).

e vanishes for large aspect ratio; what other blades and the far wake add to w_34 and w_14 is nearly the same
and cancels, so only the near wake counts: straight legs to the trailing edge, then circular arcs. The shape of
G is that of the blade alone in solid body rotation, A34 G = Omega r. Elliptic wing: e = (sqrt(1 + (2 / AR)^2) -
1) / (2 pi), Helmbold's formula in the same terms; the straight-wing limit of this file meets Weissinger's lift
slopes.
"""

from __future__ import annotations

import math
from functools import lru_cache

import numpy as np
from numba import njit
from numpy.typing import NDArray

__all__ = ["chord_factor", "near_wake_downwash"]

Array = NDArray[np.float64]

NEAR_WAKE_RAD = (
    0.5 * math.pi
)  # a quarter turn: longer wakes change e by less than 0.003 outside the inner fifth
_ARC_POINTS = 14  # thrust within 0.03 % of 96


@njit(cache=True)
def _segment_w(px: float, py: float, ax: float, ay: float, bx: float, by: float) -> float:
    """Velocity along +z at (px, py, 0) from a unit vortex from a to b in the same plane (Biot and Savart)."""
    ux, uy, vx, vy = px - ax, py - ay, px - bx, py - by
    lu, lv = math.sqrt(ux * ux + uy * uy), math.sqrt(vx * vx + vy * vy)
    depth = lu * lv * (lu * lv + ux * vx + uy * vy)
    if depth < 1e-18:
        return 0.0
    return (ux * vy - uy * vx) * (lu + lv) / depth / (4.0 * math.pi)


@njit(cache=True)
def near_wake_downwash(
    points: Array, edge_x: Array, edge_c: Array, turn: float, straight: float, arc_points: int
) -> Array:
    """Downwash per unit circulation of each panel of one blade.

    Parameters
    ----------
    points : (m, 2) array
        Where: along the blade, and behind the quarter chord line.
    edge_x, edge_c : (n + 1,) arrays
        Radius and chord at the panel edges (any one unit of length).
    turn : float
        Azimuth (rad) that the trailing arcs cover.
    straight : float
        Length of straight wake instead of arcs, for a wing in translation; 0 for a rotor.
    arc_points : int
        Points on each arc, closer together near the blade.

    Returns
    -------
    (m, n) array
        Velocity against the lift, per circulation (1 / length).
    """
    m, n = points.shape[0], edge_x.shape[0] - 1
    trail = np.zeros((m, n + 1))
    path = np.empty((arc_points + 1, 2))  # of one trailing vortex: quarter chord, tail, wake
    for j in range(n + 1):
        r, tail = edge_x[j], 0.75 * edge_c[j]
        path[0, 0], path[0, 1] = r, 0.0
        for k in range(arc_points):
            s = (k / (arc_points - 1.0)) ** 2
            if straight > 0.0:
                path[k + 1, 0], path[k + 1, 1] = r, tail + straight * s
            else:
                cosine, sine = math.cos(turn * s), math.sin(turn * s)
                path[k + 1, 0], path[k + 1, 1] = r * cosine - tail * sine, r * sine + tail * cosine
        for i in range(m):
            w = 0.0
            for k in range(arc_points):
                w += _segment_w(
                    points[i, 0], points[i, 1], path[k, 0], path[k, 1], path[k + 1, 0], path[k + 1, 1]
                )
            trail[i, j] = w
    out = np.empty((m, n))
    for i in range(m):
        for j in range(n):
            bound = _segment_w(points[i, 0], points[i, 1], edge_x[j], 0.0, edge_x[j + 1], 0.0)
            out[i, j] = bound + trail[i, j + 1] - trail[i, j]
    return out


def chord_factor(
    mid_x: Array, edge_x: Array, mid_c: Array, edge_c: Array, *, straight_wake: float = 0.0
) -> Array:
    """e of the module docstring, at every panel: angle lost (rad) per unit of lift coefficient.

    Parameters
    ----------
    mid_x, mid_c : (n,) arrays
        Radius and chord in the middle of the panels (unit: R).
    edge_x, edge_c : (n + 1,) arrays
        The same at their edges.
    straight_wake : float
        For checks against wings: straight wake of this length and uniform wind. 0 for a rotor.
    """
    key = tuple(np.ascontiguousarray(v, dtype=np.float64).tobytes() for v in (mid_x, edge_x, mid_c, edge_c))
    return _chord_factor(*key, straight_wake).copy()


@lru_cache(maxsize=4096)  # sweeps over airfoils, pitch and speed keep the planform
def _chord_factor(
    mid: bytes, edge: bytes, mid_chord: bytes, edge_chord: bytes, straight_wake: float
) -> Array:
    mid_x, edge_x, mid_c, edge_c = (np.frombuffer(v) for v in (mid, edge, mid_chord, edge_chord))
    n = mid_x.size
    quarter = np.column_stack((mid_x, np.zeros(n)))
    behind = np.column_stack((mid_x, 0.5 * mid_c))
    args = (edge_x, edge_c, NEAR_WAKE_RAD, straight_wake, _ARC_POINTS)
    a34 = near_wake_downwash(behind, *args)
    a14 = near_wake_downwash(quarter, *args)
    wind = np.ones(n) if straight_wake > 0 else mid_x
    circulation = np.linalg.solve(a34, wind)
    lost = (a34 - a14) @ circulation - circulation / (math.pi * mid_c)
    e = 0.5 * mid_c * lost / circulation
    # The ratio is meaningless where the reference loading has no sign; a blade never gains angle from its own wake.
    return np.clip(np.where(circulation > 0.0, e, 0.0), 0.0, 5.0)
