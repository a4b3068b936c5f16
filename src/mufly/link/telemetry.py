"""Messages about motion: what the vehicle believes, follows, measures and does, and in a simulation the truth.

Every function takes the :class:`mufly.link.picture.Picture` of an instant and returns one message. Units are the
messages' own (https://mavlink.io/en/messages/common.html); axes N-E-D and body x-y-z, as here.

``estimated_`` travels as ATTITUDE and LOCAL_POSITION_NED, ``reference_`` as POSITION_TARGET_LOCAL_NED and
ATTITUDE_TARGET, ``measured_`` as VISION_POSITION_ESTIMATE, ``truth_`` and the wind as DEBUG_FLOAT_ARRAY "truth". The
flight software has no estimator of its own yet: what it believes is what it measures.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mufly.dynamics import quaternion_from_euler
from mufly.link.dialect import MavMessage, mavlink, single, within
from mufly.link.picture import Picture

__all__ = [
    "TRUTH",
    "actuator_output_status",
    "attitude",
    "attitude_quaternion",
    "attitude_target",
    "distance_sensors",
    "local_position_ned",
    "obstacle_distance",
    "position_target_local_ned",
    "raw_rpm",
    "truth",
    "vfr_hud",
    "vision_position_estimate",
]

TRUTH = b"truth"
"""Name of the array: position, velocity (N-E-D), attitude (roll, pitch, yaw), rates (p, q, r), rotor speeds (upper,
lower), wind (N-E-D); m, m/s, rad, rad/s. Three numbers each, two for the rotors."""

_OBSTACLES_MOST = 72
_NOTHING_CM = 65535
_IGNORE_ALL = 0x0FFF
_IGNORE_PLACE, _IGNORE_ACCELERATION, _IGNORE_YAW_RATE = 0x003, 0x1C0, 0x800
_IGNORE_RATES_AND_THRUST, _IGNORE_ATTITUDE = 0x47, 0x80
_YAW_ROTATIONS = 45.0  # MAV_SENSOR_ROTATION_NONE, _YAW_45 ... _YAW_315 count from 0 to 7
_CUSTOM_ROTATION = 100
_NO_COVARIANCE = (math.nan,) + (0.0,) * 20


def _floats(values: Sequence[float] | NDArray[np.floating[Any]]) -> list[float]:
    return [single(v) for v in np.asarray(values, dtype=np.float64).tolist()]


def _wrapped(angle: float) -> float:
    return math.remainder(angle, math.tau) if math.isfinite(angle) else math.nan


def _quaternion(angles: NDArray[np.floating[Any]]) -> list[float]:
    roll, pitch, yaw = (a if math.isfinite(a) else math.nan for a in angles.tolist())
    return _floats(quaternion_from_euler(roll, pitch, yaw))


def attitude(p: Picture) -> MavMessage:
    """ATTITUDE: roll, pitch, yaw (rad, yaw in +-pi) and body rates (rad/s)."""
    roll, pitch, yaw = _floats(p.view.measured.attitude)
    return mavlink.MAVLink_attitude_message(
        p.boot_ms, roll, pitch, _wrapped(yaw), *_floats(p.view.measured.rates)
    )


def attitude_quaternion(p: Picture) -> MavMessage:
    """ATTITUDE_QUATERNION."""
    q = _quaternion(p.view.measured.attitude)
    return mavlink.MAVLink_attitude_quaternion_message(p.boot_ms, *q, *_floats(p.view.measured.rates))


def local_position_ned(p: Picture) -> MavMessage:
    """LOCAL_POSITION_NED: position (m) and velocity (m/s)."""
    m = p.view.measured
    return mavlink.MAVLink_local_position_ned_message(p.boot_ms, *_floats(m.position), *_floats(m.velocity))


def position_target_local_ned(p: Picture) -> MavMessage:
    """POSITION_TARGET_LOCAL_NED: the reference, with what is not followed now masked out."""
    v = p.view
    mask = _IGNORE_ACCELERATION | _IGNORE_YAW_RATE
    if not p.status.armed or p.status.state == "init":
        mask = _IGNORE_ALL
    elif p.status.state == "rc":
        mask |= _IGNORE_PLACE | _IGNORE_PLACE << 3
    return mavlink.MAVLink_position_target_local_ned_message(
        p.boot_ms,
        mavlink.MAV_FRAME_LOCAL_NED,
        mask,
        *_floats(v.reference_position),
        *_floats(v.reference_velocity),
        0.0,
        0.0,
        0.0,
        _wrapped(single(v.reference_attitude[2])),
        0.0,
    )


def attitude_target(p: Picture) -> MavMessage:
    """ATTITUDE_TARGET: the attitude that is asked of the inner loop."""
    angles = p.view.reference_attitude
    mask = _IGNORE_RATES_AND_THRUST
    if not p.status.armed or p.status.state == "init":
        mask |= _IGNORE_ATTITUDE
    q = _quaternion(angles)
    return mavlink.MAVLink_attitude_target_message(p.boot_ms, mask, q, 0.0, 0.0, 0.0, 0.0)


def vision_position_estimate(p: Picture) -> MavMessage:
    """VISION_POSITION_ESTIMATE: position and attitude as they were measured."""
    m = p.view.measured
    roll, pitch, yaw = _floats(m.attitude)
    return mavlink.MAVLink_vision_position_estimate_message(
        p.usec, *_floats(m.position), roll, pitch, _wrapped(yaw), _NO_COVARIANCE
    )


def actuator_output_status(p: Picture) -> MavMessage:
    """ACTUATOR_OUTPUT_STATUS: motor upper, lower (0..1), servo 1, 2 (-1..1)."""
    outputs = _floats(p.view.actuators.array)
    return mavlink.MAVLink_actuator_output_status_message(p.usec, len(outputs), outputs + [0.0] * 28)


def raw_rpm(p: Picture) -> list[MavMessage]:
    """RAW_RPM of the upper (0) and the lower (1) rotor."""
    rpm = [single(w * 30.0 / math.pi) for w in np.asarray(p.view.rotor_speed).tolist()]
    return [mavlink.MAVLink_raw_rpm_message(k, speed) for k, speed in enumerate(rpm)]


def obstacle_distance(p: Picture) -> MavMessage:
    """OBSTACLE_DISTANCE: the ring of beams, clockwise from its first (cm); one more than the most: nothing in sight."""
    a, ranges = p.airframe, np.asarray(p.view.measured.ranges)[:_OBSTACLES_MOST].tolist()
    most = within(a.max_range_m * 100.0, 0, _NOTHING_CM - 2)
    seen = [most + 1 if r >= a.max_range_m else within(r * 100.0, 0, most, _NOTHING_CM) for r in ranges]
    spacing = 360.0 / max(1, a.beams)
    return mavlink.MAVLink_obstacle_distance_message(
        p.usec,
        mavlink.MAV_DISTANCE_SENSOR_LASER,
        seen + [_NOTHING_CM] * (_OBSTACLES_MOST - len(seen)),
        within(spacing, 0, 255),
        within(a.min_range_m * 100.0, 0, most),
        most,
        spacing,
        math.degrees(a.first_beam_rad),
        mavlink.MAV_FRAME_BODY_FRD,
    )


def distance_sensors(p: Picture) -> list[MavMessage]:
    """DISTANCE_SENSOR of every beam, with its direction."""
    a, out = p.airframe, []
    most = within(a.max_range_m * 100.0, 0, _NOTHING_CM - 1)
    for k, r in enumerate(np.asarray(p.view.measured.ranges).tolist()[:255]):
        angle = a.first_beam_rad + math.tau * k / a.beams
        turns = math.degrees(angle) / _YAW_ROTATIONS
        fits = abs(turns - round(turns)) < 1e-3
        out.append(
            mavlink.MAVLink_distance_sensor_message(
                p.boot_ms,
                within(a.min_range_m * 100.0, 0, most),
                most,
                within(r * 100.0, 0, most),
                mavlink.MAV_DISTANCE_SENSOR_LASER,
                k,
                round(turns) % 8 if fits else _CUSTOM_ROTATION,
                255,
                quaternion=(0.0,) * 4 if fits else _floats(quaternion_from_euler(0.0, 0.0, angle)),
            )
        )
    return out


def vfr_hud(p: Picture) -> MavMessage:
    """VFR_HUD: what a simple instrument shows; "airspeed" is the speed over ground, for there is no airspeed sensor."""
    m, motors = p.view.measured, np.asarray(p.view.actuators.motor_input)
    speed = single(math.hypot(m.velocity[0], m.velocity[1]))
    height = -m.position[2] + (p.origin.alt_m if p.origin is not None else 0.0)
    yaw = float(m.attitude[2])
    heading = within(math.degrees(yaw) % 360.0, 0, 360) % 360 if math.isfinite(yaw) else 0
    throttle = within(float(motors.mean()) * 100.0, 0, 100)
    return mavlink.MAVLink_vfr_hud_message(
        speed, speed, heading, throttle, single(height), single(-m.velocity[2])
    )


def truth(p: Picture) -> MavMessage:
    """DEBUG_FLOAT_ARRAY "truth" (see :data:`TRUTH`)."""
    v = p.view
    values = [*v.position, *v.velocity, *v.attitude, *v.rates, *v.rotor_speed, *v.wind]
    return mavlink.MAVLink_debug_float_array_message(
        p.usec, TRUTH, 0, _floats(values) + [0.0] * (58 - len(values))
    )
