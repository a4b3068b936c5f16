"""The air around a solved wake: velocities anywhere, and the momentum that passes through a plane."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mufly.errors import InputError
from mufly.rotor.wake.blade import turned
from mufly.rotor.wake.kernel import induce, segments_of
from mufly.rotor.wake.result import Wake, WakeSolution

__all__ = ["induced_velocity"]

Array = NDArray[np.float64]


def _own_frame(wake: Wake) -> tuple[Array, Array, Array, Array]:
    """Segments of one blade, its bound vortex included, in the rotor's own counter-clockwise frame."""
    s, hand = wake.surface, wake.placed.hand
    paths = wake.paths_m.copy()
    paths[..., 1] *= hand
    paths[..., 2] -= wake.placed.height_m
    trailing = segments_of(paths, wake.core_m, wake.strength_m2_s)
    edge = s.edge_quarter_m
    bound = np.stack([edge[:-1], edge[1:]], axis=1)
    blade = segments_of(bound, 0.1 * s.chord_m[:, None], np.ones(s.chord_m.size))
    blade = (blade[0], blade[1], blade[2] * wake.circulation_m2_s, blade[3])
    joined = [np.concatenate(pair, axis=-1) for pair in zip(trailing, blade, strict=True)]
    return joined[0], joined[1], joined[2], joined[3]


def induced_velocity(solution: WakeSolution, points_m: ArrayLike, azimuth_rad: ArrayLike = 0.0) -> Array:
    """Velocity that all rotors induce (m/s); in climb the air's own, -V_climb along z, comes on top.

    Parameters
    ----------
    solution : WakeSolution
    points_m : (..., 3) array_like
        In space: z up along the shaft, blade 1 of every rotor on the x axis at azimuth 0.
    azimuth_rad : float or one a rotor
        How far each rotor has turned, in its own sense of rotation.
    """
    points = np.asarray(points_m, dtype=np.float64)
    flat = points.reshape(-1, 3)
    if flat.shape[0] and not np.all(np.isfinite(flat)):
        raise InputError("wake", "points_m", "hold NaN or infinity", "give finite points")
    azimuths = np.broadcast_to(np.asarray(azimuth_rad, dtype=np.float64), (len(solution.wakes),))
    total = np.zeros_like(flat)
    for wake, azimuth in zip(solution.wakes, azimuths, strict=True):
        segments, hand = _own_frame(wake), wake.placed.hand
        there = flat.copy()
        there[:, 1] *= hand
        there[:, 2] -= wake.placed.height_m
        sum_ = np.zeros_like(flat)
        for b in range(wake.surface.blades):
            angle = float(azimuth) + 2.0 * math.pi * b / wake.surface.blades
            sum_ += turned(induce(turned(there, -angle), segments), angle)
        sum_[:, 1] *= hand
        total += sum_
    return total.reshape(points.shape)
