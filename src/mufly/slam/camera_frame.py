"""A picture with its time and the vehicle's estimate at that time."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mufly.dynamics import GRAVITY

_Array = NDArray[np.float64]


@dataclass(frozen=True)
class FrameEstimate:
    """Estimate by the vehicle's filter at the time of a picture, when its middle row is exposed.

    Attributes
    ----------
    roll, pitch : float
        Roll and pitch angle (rad).
    height_m : float
        Height of the centre of gravity above the floor (m).
    rates : (3,) array
        p, q, r (rad/s).
    rotor_speed : (2,) array
        Upper, lower (rad/s); zero if unknown: vibration is then averaged, not modelled.
    rotor_phase : (2,) array or None
        Phases of the rotors from commutation, up to a constant (rad). With them the amplitudes of the vibration are
        averaged.
    tilt_sigma, height_sigma : float
        Standard deviations of tilt and height (rad, m).
    tilt_time_s, height_time_s : float
        Correlation times of these errors.
    velocity : (3,) array or None
        N, E, D (m/s), if known.
    place : (3,) array or None
        Estimated N, E (m), heading (rad), if known: a new map begins there.
    place_sigma : (2,) tuple
        Standard deviations of position (m) and heading (rad).
    standing : bool
        Whether the vehicle stands on the floor with idle motors.
    velocity_sigma : float
        Standard deviation of the velocity along N and E (m/s).
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
        """Return the rate of the heading (rad/s; thesis: eq. 4.3)."""
        _, q, r = self.rates
        return float(q * math.sin(self.roll) + r * math.cos(self.roll)) / math.cos(self.pitch)

    @classmethod
    def from_mapping(cls, told: Mapping[str, Any]) -> FrameEstimate:
        """Return the object whose ``dataclasses.asdict`` is ``told``, read from a file.

        Raises TypeError if a field is missing or unknown.
        """
        values: dict[str, Any] = {
            k: np.array(v, dtype=np.float64) if isinstance(v, list) else v for k, v in told.items()
        }
        place, turn = (float(s) for s in values.get("place_sigma", (0.0, 0.0)))
        return cls(**{**values, "place_sigma": (place, turn)})


@dataclass(frozen=True)
class CameraFrame:
    """A picture with its time and the vehicle's estimate.

    Attributes
    ----------
    time_s : float
        Time at which its middle row was exposed.
    picture : (rows, columns) uint8 array
        Grey levels.
    vehicle_estimate : FrameEstimate
    """

    time_s: float
    picture: NDArray[np.uint8]
    vehicle_estimate: FrameEstimate


_MAX_UNKNOWN_ACCEL_M_S2 = 1.0
"""Largest unpredicted acceleration between pictures (m/s^2)."""
_UNKNOWN_VELOCITY_SIGMA_M_S = 0.02
"""Standard deviation of a velocity derived from SLAM results, for a vehicle that sends none (m/s)."""
_UNOBSERVED_SIGMA_CAP_M = 5.0
"""Largest standard deviation of a place along a direction without texture (m)."""
HEADING_DRIFT_RAD_S = 0.01
"""Drift of the heading by integrated rates (rad/s)."""
TRACKING_LOST_AFTER_S = 0.7
"""Time without a result after which the vehicle's own estimate may predict the pose (s)."""
_MAX_TILT_INTEGRATION_S = 0.2  # time without a picture for which the tilt gives the change of velocity
_STRIPE_CAUTION_AFTER_S = 0.1  # of results without texture along one direction


@dataclass(frozen=True)
class Odometry:
    """Displacement since the last SLAM result, integrated from the vehicle's velocity at each picture.

    Between pictures the velocity is assumed to change linearly,

        x_k = x_(k-1) + (v_(k-1) + v_k) / 2 dt,        psi_k likewise.

    Velocity errors are correlated over longer than a gap, so they add up linearly, not as noise would. If the velocity
    changes in another way, with an acceleration of at most a, the displacement errs by the area of a triangle:

        s_k = s_(k-1) + (s_v,(k-1) + s_v,k) / 2 dt + a dt^2 / 4.

    The displacement over a gap of t s therefore has an error of s_v t (and half a millimetre a picture) instead of a
    t^2 / 2. Without velocities from the vehicle, the velocity of the last results is used, with the error a t^2 / 2.

    Attributes
    ----------
    time_s : float
        Time of the latest picture.
    last_info : FrameEstimate
        Vehicle's estimate at that picture.
    elapsed_s : float
        Time since the result.
    displacement_m : (2,) array
        N, E (m).
    heading_change_rad : float
        Change of heading (rad).
    position_sigma_m : float
        Standard deviation of the displacement along an axis (m).
    has_all_velocities : bool
        Whether every picture came with a velocity.
    """

    time_s: float
    last_info: FrameEstimate
    elapsed_s: float = 0.0
    displacement_m: _Array = field(default_factory=lambda: np.zeros(2))
    heading_change_rad: float = 0.0
    position_sigma_m: float = 0.0
    has_all_velocities: bool = True

    def advance_to(self, time_s: float, told: FrameEstimate) -> Odometry:
        """Return the odometry integrated up to the time of the next picture."""
        dt, before = time_s - self.time_s, self.last_info
        moved, sigma_m, complete = self.displacement_m, self.position_sigma_m, False
        if self.has_all_velocities and before.velocity is not None and told.velocity is not None:
            moved = moved + 0.5 * (before.velocity[:2] + told.velocity[:2]) * dt
            sigma_m += 0.5 * (before.velocity_sigma + told.velocity_sigma) * dt + 0.25 * _MAX_UNKNOWN_ACCEL_M_S2 * dt**2
            complete = True
        turned = self.heading_change_rad + 0.5 * (before.heading_rate_rad_s + told.heading_rate_rad_s) * dt
        return Odometry(time_s, told, self.elapsed_s + dt, moved, turned, sigma_m, complete)

    def predict_displacement(self, velocity: _Array) -> tuple[_Array, float]:
        """Return displacement N, E (m) and heading change (rad), (3,), and the displacement's standard deviation (m).

        ``velocity`` (2,) is that of the last results, used without velocities from the vehicle.
        """
        if self.has_all_velocities:
            return np.append(self.displacement_m, self.heading_change_rad), self.position_sigma_m
        t = self.elapsed_s
        speed = velocity if self.last_info.velocity is None else self.last_info.velocity[:2]
        return np.append(
            speed * t, self.heading_change_rad
        ), _UNKNOWN_VELOCITY_SIGMA_M_S * t + 0.5 * _MAX_UNKNOWN_ACCEL_M_S2 * t**2


@dataclass(frozen=True)
class MotionPrior:
    """Motion since SLAM's last results, by which the next picture's pose is predicted.

    Attributes
    ----------
    since_last_result : Odometry or None
        Since the last result; None before the first.
    since_textured_result : Odometry or None
        Since the last result with texture in all directions.
    velocity_m_s : (2,) array
        N, E by the last results.
    """

    since_last_result: Odometry | None = None
    since_textured_result: Odometry | None = None
    velocity_m_s: _Array = field(default_factory=lambda: np.zeros(2))

    def advance_to(self, frame: CameraFrame, heading_rad: float) -> MotionPrior:
        """Return the motion propagated to the next picture.

        A helicopter whose rotors turn accelerates as it tilts, v' = g (-tan pitch, tan roll) in the axes of its heading
        ``heading_rad`` (rad). With still rotors the velocity of the last results is kept.
        """
        told, before, velocity = frame.vehicle_estimate, self.since_last_result, self.velocity_m_s
        if before is not None and told.rotor_speed.any():
            pitch, roll = 0.5 * (before.last_info.pitch + told.pitch), 0.5 * (before.last_info.roll + told.roll)
            c, s = math.cos(heading_rad), math.sin(heading_rad)
            push = np.array([[c, -s], [s, c]]) @ np.array([-math.tan(pitch), math.tan(roll)])
            velocity = velocity + GRAVITY * min(frame.time_s - before.time_s, _MAX_TILT_INTEGRATION_S) * push
        latest, since_textured_result = (
            None if q is None else q.advance_to(frame.time_s, told)
            for q in (self.since_last_result, self.since_textured_result)
        )
        return MotionPrior(latest, since_textured_result, velocity)

    def restart_at(self, frame: CameraFrame) -> MotionPrior:
        """Return the motion restarted at this picture, as after a picture with texture in all directions."""
        here = Odometry(frame.time_s, frame.vehicle_estimate)
        return MotionPrior(here, here, self.velocity_m_s)

    @property
    def has_texture_in_one_direction(self) -> bool:
        """Whether the last results show texture along one direction only."""
        known, latest = self.since_textured_result, self.since_last_result
        return known is None or latest is None or known.elapsed_s > latest.elapsed_s + _STRIPE_CAUTION_AFTER_S

    @property
    def unobserved_sigma(self) -> tuple[float, float]:
        """Standard deviations of the predicted position (m) and heading (rad) along directions without texture.

        They grow from the last picture that showed texture in both directions.
        """
        if self.since_textured_result is None:
            return _UNOBSERVED_SIGMA_CAP_M, 0.1
        sigma_m = 0.005 + self.since_textured_result.predict_displacement(self.velocity_m_s)[1]
        return min(_UNOBSERVED_SIGMA_CAP_M, sigma_m), 0.003 + HEADING_DRIFT_RAD_S * self.since_textured_result.elapsed_s
