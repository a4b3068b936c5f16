"""A picture with its time and what the vehicle told of itself at that time."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

_Array = NDArray[np.float64]


@dataclass(frozen=True)
class Telling:
    """What the vehicle's filter says of the middle of a picture.

    Attributes
    ----------
    roll, pitch : float
        rad.
    height_m : float
        Of the centre of gravity above the floor.
    rates : (3,) array
        p, q, r (rad/s).
    rotor_speed : (2,) array
        Upper, lower (rad/s); zero where it is not known: shaking is averaged, not modelled.
    rotor_phase : (2,) array or None
        Of these, as far as commutations tell it: but for a constant (rad). With it the shaking is learnt.
    tilt_sigma, height_sigma : float
        What these are off by, one sigma (rad, m).
    tilt_time_s, height_time_s : float
        Over which these errors hang together.
    velocity : (3,) array or None
        N, E, D (m/s), where it is known.
    place : (3,) array or None
        N, E (m), heading (rad) as believed, where it is known: a new map begins there.
    place_sigma : (2,) tuple
        What it is off by: place (m), heading (rad).
    standing : bool
        On the floor, motors idle: it does not move.
    """

    roll: float
    pitch: float
    height_m: float
    rates: _Array = field(default_factory=lambda: np.zeros(3))
    rotor_speed: _Array = field(default_factory=lambda: np.zeros(2))
    rotor_phase: _Array | None = None
    tilt_sigma: float = math.radians(0.5)
    height_sigma: float = 0.01
    tilt_time_s: float = 2.0
    height_time_s: float = 1.0
    velocity: _Array | None = None
    place: _Array | None = None
    place_sigma: tuple[float, float] = (0.0, 0.0)
    standing: bool = False

    @classmethod
    def of(cls, told: Mapping[str, Any]) -> Telling:
        """Read what ``dataclasses.asdict`` made of one, once it has been through a file; TypeError if it is none."""
        values: dict[str, Any] = {
            k: np.array(v, dtype=np.float64) if isinstance(v, list) else v for k, v in told.items()
        }
        place, turn = (float(s) for s in values.get("place_sigma", (0.0, 0.0)))
        return cls(**{**values, "place_sigma": (place, turn)})


@dataclass(frozen=True)
class Frame:
    """A picture.

    Attributes
    ----------
    time_s : float
        When its middle row was exposed.
    picture : (rows, columns) uint8 array
        Grey.
    told : Telling
    """

    time_s: float
    picture: NDArray[np.uint8]
    told: Telling
