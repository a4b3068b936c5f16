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
class FrameInfo:
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
    velocity_sigma : float
        What the velocity is off by along N and E, one sigma (m/s).
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
    velocity_sigma: float = 0.05

    @property
    def heading_rate_rad_s(self) -> float:
        """How fast the heading turns (rad/s; thesis: eq. 4.3)."""
        _, q, r = self.rates
        return float(q * math.sin(self.roll) + r * math.cos(self.roll)) / math.cos(self.pitch)

    @classmethod
    def from_mapping(cls, told: Mapping[str, Any]) -> FrameInfo:
        """Read what ``dataclasses.asdict`` made of one, once it has been through a file; TypeError if it is none."""
        values: dict[str, Any] = {
            k: np.array(v, dtype=np.float64) if isinstance(v, list) else v for k, v in told.items()
        }
        place, turn = (float(s) for s in values.get("place_sigma", (0.0, 0.0)))
        return cls(**{**values, "place_sigma": (place, turn)})


@dataclass(frozen=True)
class CameraFrame:
    """A picture.

    Attributes
    ----------
    time_s : float
        When its middle row was exposed.
    picture : (rows, columns) uint8 array
        Grey.
    vehicle_estimate : Telling
    """

    time_s: float
    picture: NDArray[np.uint8]
    vehicle_estimate: FrameInfo


_MAX_UNKNOWN_ACCEL_M_S2 = 1.0
"""How fast a velocity may change that nobody foresees (m/s^2)."""
_UNKNOWN_VELOCITY_SIGMA_M_S = 0.02
"""Of a velocity that nobody tells but that follows from answers (m/s)."""


@dataclass(frozen=True)
class Odometry:
    """The way since an answer, added up from what the vehicle tells with each picture, answered or not.

    From one picture to the next a velocity is taken to change evenly,

        x_k = x_(k-1) + (v_(k-1) + v_k) / 2 dt,        psi_k likewise.

    What it is told wrong by hangs together for longer than a gap lasts: it adds up as it is, not as noise would. And
    where the velocity goes otherwise than evenly, by a at most, the triangle between is missed:

        s_k = s_(k-1) + (s_v,(k-1) + s_v,k) / 2 dt + a dt^2 / 4.

    So a gap of t s in pictures that came is known to s_v t (and half a millimetre a picture), not to a t^2 / 2. Where
    a velocity is not told, only that is known, with the velocity that the last answers had.

    Attributes
    ----------
    time_s : float
        Of the picture that it leads to.
    last_info : Telling
        With that picture.
    elapsed_s : float
        Time from the answer.
    displacement_m : (2,) array
        N, E (m).
    heading_change_rad : float
        rad.
    position_sigma_m : float
        What the place is off by along an axis.
    has_all_velocities : bool
        Whether a velocity was told with each picture.
    """

    time_s: float
    last_info: FrameInfo
    elapsed_s: float = 0.0
    displacement_m: _Array = field(default_factory=lambda: np.zeros(2))
    heading_change_rad: float = 0.0
    position_sigma_m: float = 0.0
    has_all_velocities: bool = True

    def advance_to(self, time_s: float, told: FrameInfo) -> Odometry:
        """Return it, gone on to the next picture."""
        dt, before = time_s - self.time_s, self.last_info
        moved, sigma_m, complete = self.displacement_m, self.position_sigma_m, False
        if self.has_all_velocities and before.velocity is not None and told.velocity is not None:
            moved = moved + 0.5 * (before.velocity[:2] + told.velocity[:2]) * dt
            sigma_m += 0.5 * (before.velocity_sigma + told.velocity_sigma) * dt + 0.25 * _MAX_UNKNOWN_ACCEL_M_S2 * dt**2
            complete = True
        turned = self.heading_change_rad + 0.5 * (before.heading_rate_rad_s + told.heading_rate_rad_s) * dt
        return Odometry(time_s, told, self.elapsed_s + dt, moved, turned, sigma_m, complete)

    def predict_displacement(self, velocity: _Array) -> tuple[_Array, float]:
        """Return how far N, E and heading (3,) have come, and what the place is off by (m).

        ``velocity`` (2,) is what the last answers had, for where none was told.
        """
        if self.has_all_velocities:
            return np.append(self.displacement_m, self.heading_change_rad), self.position_sigma_m
        t = self.elapsed_s
        speed = velocity if self.last_info.velocity is None else self.last_info.velocity[:2]
        return np.append(
            speed * t, self.heading_change_rad
        ), _UNKNOWN_VELOCITY_SIGMA_M_S * t + 0.5 * _MAX_UNKNOWN_ACCEL_M_S2 * t**2
