"""Telemetry messages of the vehicle, built from the state of the flight at one instant, and their rates.

Every function takes the :class:`TelemetryState` and returns one message, or several. Units are the messages' own
(https://mavlink.io/en/messages/common.html); axes N-E-D and body x-y-z. :data:`MESSAGE_STREAMS` is the table of all
messages that can be streamed or requested: a new message needs a function and a row.

``estimated_`` quantities are sent as ATTITUDE and LOCAL_POSITION_NED, their accuracy as ODOMETRY and ESTIMATOR_STATUS
(:mod:`mufly.link.estimate_messages`), ``reference_`` as POSITION_TARGET_LOCAL_NED and ATTITUDE_TARGET, ``measured_`` as
VISION_POSITION_ESTIMATE, ``truth_`` and the wind as DEBUG_FLOAT_ARRAY "truth".
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import reduce
from operator import or_
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mufly.flight import FlightState
from mufly.link.codec import (
    MODE_MISSION,
    MODE_TAKE_OFF,
    GlobalOrigin,
    MavMessage,
    Px4Mode,
    clip_to_integer,
    mavlink,
    pack_custom_mode,
    px4_mode_from_state,
    to_float32,
)
from mufly.link.estimate_messages import (
    UNKNOWN_COVARIANCE,
    estimator_status_message,
    odometry_message,
    sensor_checks_message,
)
from mufly.link.vision_input import pack_pose_covariance
from mufly.mission import State
from mufly.quantities.sensor_table import READINGS
from mufly.rotations import quaternion_from_euler
from mufly.vehicle import Vehicle
from mufly.version import __version__


@dataclass(frozen=True, slots=True)
class MissionProgress:
    """Mission progress: current item, number of items, MISSION_STATE, and MISSION_MODE."""

    current_item: int
    item_count: int
    mission_state: int
    mission_mode: int


@dataclass(frozen=True, slots=True)
class TelemetryState:
    """State of the flight and of the link at one instant, from which the telemetry messages are built.

    Attributes
    ----------
    vehicle : Vehicle
    flight_state : FlightState
    is_ready : bool
        Whether the vehicle can be armed.
    mission_progress : MissionProgress
        Progress of the mission.
    origin : GlobalOrigin or None
        Global position of N = E = D = 0.
    mode_on_arming : str
        Mode chosen on the floor, effective on arming; "" if none.
    commander_id : int
        system * 256 + component of the commander; 0: none.
    loss_ratio : float
        Share of lost packets from the stations, 0..1.
    real_time_factor : float
        Recent simulated seconds per second of wall-clock time; NaN if not measured.
    slip_count : int
        Number of skipped stretches of time.
    """

    vehicle: Vehicle
    flight_state: FlightState
    is_ready: bool
    mission_progress: MissionProgress
    origin: GlobalOrigin | None
    mode_on_arming: str
    commander_id: int
    loss_ratio: float
    real_time_factor: float = math.nan
    slip_count: int = 0

    @property
    def has_fence(self) -> bool:
        """Return whether the mission has a geofence."""
        return self.flight_state.mission is not None and self.flight_state.mission.fence is not None

    @property
    def boot_time_ms(self) -> int:
        """Time of the vehicle's clock (ms), unsigned with 32 bits; never 0, which readers take for "unknown"."""
        return max(1, round(self.flight_state.time_s * 1e3) % 2**32)

    @property
    def boot_time_us(self) -> int:
        """Time of the vehicle's clock (us), never 0."""
        return max(1, round(self.flight_state.time_s * 1e6))

    @property
    def is_battery_low(self) -> bool:
        """Return whether the battery voltage is below the landing threshold."""
        return bool(self.flight_state.estimate.battery_voltage < float(self.vehicle.battery.low_voltage))


TRUTH_ARRAY_NAME = b"truth"
"""Name of the DEBUG_FLOAT_ARRAY with position, velocity (N-E-D), attitude (roll, pitch, yaw), rates (p, q, r), rotor
speeds (upper, lower) and wind (N-E-D); m, m/s, rad, rad/s."""

_MAX_OBSTACLE_SECTORS = 72
_UNKNOWN_DISTANCE_CM = 65535
_IGNORE_ALL = 0x0FFF
_IGNORE_XY, _IGNORE_ACCELERATION, _IGNORE_YAW_RATE = 0x003, 0x1C0, 0x800
_IGNORE_RATES_AND_THRUST, _IGNORE_ATTITUDE = 0x47, 0x80
_YAW_ROTATION_STEP_DEG = 45.0  # MAV_SENSOR_ROTATION_NONE, _YAW_45 ... _YAW_315 count from 0 to 7
_CUSTOM_ROTATION = 100


def _to_float32_list(values: Sequence[float] | NDArray[np.floating[Any]]) -> list[float]:
    return [to_float32(v) for v in np.asarray(values, dtype=np.float64).tolist()]


def _wrap_angle(angle: float) -> float:
    return math.remainder(angle, math.tau) if math.isfinite(angle) else math.nan


def _quaternion_from_angles(angles: NDArray[np.floating[Any]]) -> list[float]:
    roll, pitch, yaw = (a if math.isfinite(a) else math.nan for a in angles.tolist())
    return _to_float32_list(quaternion_from_euler(roll, pitch, yaw))


def attitude_message(p: TelemetryState) -> MavMessage:
    """Return ATTITUDE: roll, pitch, yaw (rad, yaw in +-pi) and body rates (rad/s)."""
    roll, pitch, yaw = _to_float32_list(p.flight_state.estimate.attitude)
    return mavlink.MAVLink_attitude_message(
        p.boot_time_ms, roll, pitch, _wrap_angle(yaw), *_to_float32_list(p.flight_state.estimate.rates)
    )


def attitude_quaternion_message(p: TelemetryState) -> MavMessage:
    """Return ATTITUDE_QUATERNION: attitude as a quaternion, and body rates (rad/s)."""
    q = _quaternion_from_angles(p.flight_state.estimate.attitude)
    return mavlink.MAVLink_attitude_quaternion_message(
        p.boot_time_ms, *q, *_to_float32_list(p.flight_state.estimate.rates)
    )


def local_position_message(p: TelemetryState) -> MavMessage:
    """Return LOCAL_POSITION_NED: position (m) and velocity (m/s)."""
    m = p.flight_state.estimate
    return mavlink.MAVLink_local_position_ned_message(
        p.boot_time_ms, *_to_float32_list(m.position), *_to_float32_list(m.velocity)
    )


def position_target_message(p: TelemetryState) -> MavMessage:
    """Return POSITION_TARGET_LOCAL_NED: the reference; quantities that are not followed at present are masked."""
    v = p.flight_state
    mask = _IGNORE_ACCELERATION | _IGNORE_YAW_RATE
    if not p.flight_state.armed or p.flight_state.state == "init":
        mask = _IGNORE_ALL
    elif p.flight_state.state == "rc":
        mask |= _IGNORE_XY | _IGNORE_XY << 3
    return mavlink.MAVLink_position_target_local_ned_message(
        p.boot_time_ms,
        mavlink.MAV_FRAME_LOCAL_NED,
        mask,
        *_to_float32_list(v.reference_position),
        *_to_float32_list(v.reference_velocity),
        0.0,
        0.0,
        0.0,
        _wrap_angle(to_float32(v.reference_attitude[2])),
        0.0,
    )


def attitude_target_message(p: TelemetryState) -> MavMessage:
    """Return ATTITUDE_TARGET: the reference attitude of the inner loop."""
    angles = p.flight_state.reference_attitude
    mask = _IGNORE_RATES_AND_THRUST
    if not p.flight_state.armed or p.flight_state.state == "init":
        mask |= _IGNORE_ATTITUDE
    q = _quaternion_from_angles(angles)
    return mavlink.MAVLink_attitude_target_message(p.boot_time_ms, mask, q, 0.0, 0.0, 0.0, 0.0)


_VISION_READING = next(row.name for row in READINGS.values() if row.status_bit == "SENSOR_VISION_POSITION")


def vision_position_message(p: TelemetryState) -> MavMessage | None:
    """Return VISION_POSITION_ESTIMATE; None without a measurement.

    It contains measured position and attitude or, with roll and pitch NaN, a position fix.
    """
    r = p.flight_state.readings
    if r is None:
        return None
    usec, triangle = p.boot_time_us, list(UNKNOWN_COVARIANCE)
    if "position" in r and "attitude" in r:
        place, angles = r["position"].value, r["attitude"].value
    elif _VISION_READING in r and (said := r[_VISION_READING]).valid:
        place, angles = said.value[:-1], [math.nan, math.nan, said.value[-1]]
        usec = round(said.time_s * 1e6)
        if said.covariance is not None:
            triangle = pack_pose_covariance(said.covariance)
    else:
        return None
    roll, pitch, yaw = _to_float32_list(angles)
    return mavlink.MAVLink_vision_position_estimate_message(
        usec, *_to_float32_list(place), roll, pitch, _wrap_angle(yaw), triangle
    )


def actuator_output_message(p: TelemetryState) -> MavMessage:
    """Return ACTUATOR_OUTPUT_STATUS: motor upper, lower (0..1), servo 1, 2 (-1..1)."""
    outputs = _to_float32_list(p.flight_state.actuators.input_array)
    return mavlink.MAVLink_actuator_output_status_message(p.boot_time_us, len(outputs), outputs + [0.0] * 28)


def rotor_rpm_messages(p: TelemetryState) -> list[MavMessage]:
    """Return RAW_RPM of the upper (0) and the lower (1) rotor."""
    speeds = [] if p.flight_state.truth is None else p.flight_state.truth.rotor_speed.tolist()
    return [mavlink.MAVLink_raw_rpm_message(k, to_float32(w * 30.0 / math.pi)) for k, w in enumerate(speeds)]


def obstacle_distance_message(p: TelemetryState) -> MavMessage:
    """Return OBSTACLE_DISTANCE: the horizontal ring of beams, clockwise (cm); greatest range + 1: no obstacle."""
    ring, ranges = (
        p.vehicle.range_ring,
        np.asarray(p.flight_state.estimate.ranges)[:_MAX_OBSTACLE_SECTORS].tolist(),
    )
    most_m = float(ring.max_range)
    most = clip_to_integer(most_m * 100.0, 0, _UNKNOWN_DISTANCE_CM - 2)
    seen = [most + 1 if r >= most_m else clip_to_integer(r * 100.0, 0, most, _UNKNOWN_DISTANCE_CM) for r in ranges]
    spacing = 360.0 / max(1, ring.count)
    return mavlink.MAVLink_obstacle_distance_message(
        p.boot_time_us,
        mavlink.MAV_DISTANCE_SENSOR_LASER,
        seen + [_UNKNOWN_DISTANCE_CM] * (_MAX_OBSTACLE_SECTORS - len(seen)),
        clip_to_integer(spacing, 0, 255),
        clip_to_integer(float(ring.min_range) * 100.0, 0, most),
        most,
        spacing,
        math.degrees(float(ring.first_angle)),
        mavlink.MAV_FRAME_BODY_FRD,
    )


def distance_sensor_messages(p: TelemetryState) -> list[MavMessage]:
    """Return DISTANCE_SENSOR of every beam, with its direction."""
    ring, out = p.vehicle.range_ring, []
    least, most = (
        clip_to_integer(float(m) * 100.0, 0, _UNKNOWN_DISTANCE_CM - 1) for m in (ring.min_range, ring.max_range)
    )
    for k, r in enumerate(np.asarray(p.flight_state.estimate.ranges).tolist()[:255]):
        angle = float(ring.first_angle) + math.tau * k / ring.count
        turns = math.degrees(angle) / _YAW_ROTATION_STEP_DEG
        fits = abs(turns - round(turns)) < 1e-3
        out.append(
            mavlink.MAVLink_distance_sensor_message(
                p.boot_time_ms,
                min(least, most),
                most,
                clip_to_integer(r * 100.0, 0, most),
                mavlink.MAV_DISTANCE_SENSOR_LASER,
                k,
                round(turns) % 8 if fits else _CUSTOM_ROTATION,
                255,
                quaternion=(0.0,) * 4 if fits else _to_float32_list(quaternion_from_euler(0.0, 0.0, angle)),
            )
        )
    return out


def vfr_hud_message(p: TelemetryState) -> MavMessage:
    """Return VFR_HUD; "airspeed" is the speed over ground, since there is no airspeed sensor."""
    m, motors = p.flight_state.estimate, np.asarray(p.flight_state.actuators.motor_input)
    speed = to_float32(math.hypot(m.velocity[0], m.velocity[1]))
    height = -m.position[2] + (p.origin.alt_m if p.origin is not None else 0.0)
    yaw = float(m.attitude[2])
    heading = clip_to_integer(math.degrees(yaw) % 360.0, 0, 360) % 360 if math.isfinite(yaw) else 0
    throttle = clip_to_integer(float(motors.mean()) * 100.0, 0, 100)
    return mavlink.MAVLink_vfr_hud_message(
        speed, speed, heading, throttle, to_float32(height), to_float32(-m.velocity[2])
    )


def truth_message(p: TelemetryState) -> MavMessage | None:
    """Return DEBUG_FLOAT_ARRAY "truth" (see :data:`TRUTH_ARRAY_NAME`); None where the truth is unknown."""
    t = p.flight_state.truth
    if t is None:
        return None
    roll, pitch, yaw = t.attitude.tolist()
    values = [*t.position, *t.velocity, roll, pitch, _wrap_angle(yaw), *t.rates, *t.rotor_speed, *t.wind]
    return mavlink.MAVLink_debug_float_array_message(
        p.boot_time_us, TRUTH_ARRAY_NAME, 0, _to_float32_list(values) + [0.0] * (58 - len(values))
    )


# State of the vehicle: heartbeat, health, battery, mission, and global position.

MUFLY_VERSION_PREFIX = b"mufly"
"""First bytes of ``flight_custom_version``, which distinguish the vehicle from a real PX4."""
MISSION_STATES: tuple[str, ...] = tuple(str(s) for s in State)
"""States of the mission; NAMED_VALUE_INT "mstate" is an index into them."""
SLOW_REAL_TIME_FACTOR = 0.95
"""Real-time factor below which a warning is shown and sent."""
REAL_TIME_FACTOR_NAME, OVERRUN_COUNT_NAME = "rtfactor", "slips"
"""Names of the real-time performance values, for which MAVLink has no message."""

_UNKNOWN_UINT16, _UNKNOWN_INT16 = 65535, 32767


def displayed_mode(p: TelemetryState) -> Px4Mode:
    """Return the present flight mode, or on the floor the mode effective on arming."""
    if p.mode_on_arming:
        return MODE_TAKE_OFF if p.mode_on_arming == "take-off" else MODE_MISSION
    return px4_mode_from_state(p.flight_state.state, not p.flight_state.mission_running, p.flight_state.returning_home)


def heartbeat_message(p: TelemetryState) -> MavMessage:
    """Return HEARTBEAT: a coaxial helicopter with the modes of PX4; armed, mode and system status."""
    mode = displayed_mode(p)
    base = mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED | mavlink.MAV_MODE_FLAG_STABILIZE_ENABLED
    base |= (
        mavlink.MAV_MODE_FLAG_AUTO_ENABLED | mavlink.MAV_MODE_FLAG_GUIDED_ENABLED
        if mode.main_mode in (4, 6)
        else mavlink.MAV_MODE_FLAG_MANUAL_INPUT_ENABLED
    )
    if p.flight_state.armed:
        base |= mavlink.MAV_MODE_FLAG_SAFETY_ARMED
    if p.flight_state.crash_cause:
        state = mavlink.MAV_STATE_EMERGENCY
    elif p.flight_state.flying and p.is_battery_low:
        state = mavlink.MAV_STATE_CRITICAL
    else:
        state = mavlink.MAV_STATE_ACTIVE if p.flight_state.armed else mavlink.MAV_STATE_STANDBY
    return mavlink.MAVLink_heartbeat_message(
        mavlink.MAV_TYPE_COAXIAL, mavlink.MAV_AUTOPILOT_PX4, base, pack_custom_mode(mode), state, 3
    )


_SENSOR_BITS = reduce(
    or_, (getattr(mavlink, f"MAV_SYS_STATUS_{r.status_bit}") for r in READINGS.values() if r.status_bit)
)
"""Bits of all sensors in SYS_STATUS."""


def sys_status_message(p: TelemetryState) -> MavMessage:
    """Return SYS_STATUS: sensors and controllers present and healthy, and whether the vehicle can be armed.

    Every sensor of the table has a bit. The GPS bit is present only with a global origin.
    """
    here = _SENSOR_BITS | (
        mavlink.MAV_SYS_STATUS_SENSOR_ANGULAR_RATE_CONTROL
        | mavlink.MAV_SYS_STATUS_SENSOR_ATTITUDE_STABILIZATION
        | mavlink.MAV_SYS_STATUS_SENSOR_YAW_POSITION
        | mavlink.MAV_SYS_STATUS_SENSOR_Z_ALTITUDE_CONTROL
        | mavlink.MAV_SYS_STATUS_SENSOR_XY_POSITION_CONTROL
        | mavlink.MAV_SYS_STATUS_SENSOR_MOTOR_OUTPUTS
        | mavlink.MAV_SYS_STATUS_AHRS
        | mavlink.MAV_SYS_STATUS_PREARM_CHECK
    )
    if p.origin is not None:
        here |= mavlink.MAV_SYS_STATUS_SENSOR_GPS
    if p.has_fence:
        here |= mavlink.MAV_SYS_STATUS_GEOFENCE
    # Without a fence the bit is set: MAVProxy reports a breach where it is not.
    well = here | mavlink.MAV_SYS_STATUS_GEOFENCE
    if p.flight_state.fence_breach_text:
        well &= ~mavlink.MAV_SYS_STATUS_GEOFENCE
    if not (p.is_ready or p.flight_state.armed):
        well &= ~mavlink.MAV_SYS_STATUS_PREARM_CHECK
    if p.is_battery_low:
        well &= ~mavlink.MAV_SYS_STATUS_SENSOR_BATTERY
    v = p.flight_state
    return mavlink.MAVLink_sys_status_message(
        here,
        here,
        well,
        0,
        clip_to_integer(v.estimate.battery_voltage * 1e3, 0, _UNKNOWN_UINT16 - 1, _UNKNOWN_UINT16),
        clip_to_integer(v.battery_current * 1e2, -32768, _UNKNOWN_INT16, -1),
        clip_to_integer(v.battery_charge * 100.0, 0, 100, -1),
        clip_to_integer(p.loss_ratio * 1e4, 0, 10_000),
        0,
        0,
        0,
        0,
        0,
    )


def fence_status_message(p: TelemetryState) -> MavMessage:
    """Return FENCE_STATUS: whether the vehicle is outside its fence, number and time of breaches; none without
    fence."""
    v = p.flight_state
    kind = mavlink.FENCE_BREACH_NONE
    if v.fence_breach_text:
        above = v.fence_breach_text.endswith("ceiling")
        kind = mavlink.FENCE_BREACH_MAXALT if above else mavlink.FENCE_BREACH_BOUNDARY
    count = min(v.fence_breach_count, 65535)
    when = clip_to_integer(v.fence_breach_time_s * 1e3, 0, 2**32 - 1)
    return mavlink.MAVLink_fence_status_message(int(bool(v.fence_breach_text)), count, kind, when)


def battery_status_message(p: TelemetryState) -> MavMessage:
    """Return BATTERY_STATUS: voltage, current, charge, and remaining time."""
    v = p.flight_state
    if v.battery_charge < 0.05:
        charge = mavlink.MAV_BATTERY_CHARGE_STATE_CRITICAL
    elif p.is_battery_low:
        charge = mavlink.MAV_BATTERY_CHARGE_STATE_LOW
    else:
        charge = mavlink.MAV_BATTERY_CHARGE_STATE_OK
    voltages = [clip_to_integer(v.estimate.battery_voltage * 1e3, 0, _UNKNOWN_UINT16 - 1, _UNKNOWN_UINT16)] + [
        _UNKNOWN_UINT16
    ] * 9
    return mavlink.MAVLink_battery_status_message(
        0,
        mavlink.MAV_BATTERY_FUNCTION_ALL,
        mavlink.MAV_BATTERY_TYPE_LIPO,
        _UNKNOWN_INT16,
        voltages,
        clip_to_integer(v.battery_current * 1e2, -32768, _UNKNOWN_INT16, -1),
        -1,
        -1,
        clip_to_integer(v.battery_charge * 100.0, 0, 100, -1),
        clip_to_integer(v.battery_left_s, 1, 2**31 - 1, 0),
        charge,
    )


def landed_state(p: TelemetryState) -> int:
    """Return MAV_LANDED_STATE: on ground, taking off, in air or landing."""
    if not p.flight_state.flying:
        return int(mavlink.MAV_LANDED_STATE_ON_GROUND)
    if p.flight_state.state == State.TAKE_OFF:
        return int(mavlink.MAV_LANDED_STATE_TAKEOFF)
    if p.flight_state.state == State.LANDING:
        return int(mavlink.MAV_LANDED_STATE_LANDING)
    return int(mavlink.MAV_LANDED_STATE_IN_AIR)


def extended_state_message(p: TelemetryState) -> MavMessage:
    """Return EXTENDED_SYS_STATE: on the floor, taking off, in the air, landing."""
    return mavlink.MAVLink_extended_sys_state_message(mavlink.MAV_VTOL_STATE_UNDEFINED, landed_state(p))


def system_time_message(p: TelemetryState) -> MavMessage:
    """Return SYSTEM_TIME: the vehicle's clock, without Unix time."""
    return mavlink.MAVLink_system_time_message(0, p.boot_time_ms)


def mission_current_message(p: TelemetryState) -> MavMessage:
    """Return MISSION_CURRENT: the current or next item, and the state of the mission."""
    q = p.mission_progress
    return mavlink.MAVLink_mission_current_message(
        q.current_item, q.item_count if q.item_count else 65535, q.mission_state, q.mission_mode
    )


def mission_state_message(p: TelemetryState) -> MavMessage:
    """Return NAMED_VALUE_INT "mstate": index of the mission's state in :data:`MISSION_STATES`."""
    return mavlink.MAVLink_named_value_int_message(
        p.boot_time_ms, b"mstate", MISSION_STATES.index(p.flight_state.state)
    )


def commander_id_message(p: TelemetryState) -> MavMessage:
    """Return NAMED_VALUE_INT "command": system * 256 + component of the commander; 0: none."""
    return mavlink.MAVLink_named_value_int_message(p.boot_time_ms, b"command", p.commander_id)


def real_time_factor_message(p: TelemetryState) -> MavMessage | None:
    """Return NAMED_VALUE_FLOAT "rtfactor": recent simulated seconds per second of wall-clock time; None if unknown."""
    if math.isnan(p.real_time_factor):
        return None
    name = REAL_TIME_FACTOR_NAME.encode()
    return mavlink.MAVLink_named_value_float_message(p.boot_time_ms, name, to_float32(p.real_time_factor))


def overrun_count_message(p: TelemetryState) -> MavMessage | None:
    """Return NAMED_VALUE_INT "slips": how often the real-time loop fell behind and dropped time; None if unknown."""
    if math.isnan(p.real_time_factor):
        return None
    return mavlink.MAVLink_named_value_int_message(p.boot_time_ms, OVERRUN_COUNT_NAME.encode(), p.slip_count)


def _global_position_integers(p: TelemetryState, place: tuple[float, float, float]) -> tuple[int, int, int]:
    assert p.origin is not None
    lat, lon, alt = p.origin.to_global(*place)
    most = 2**31 - 1
    return (
        clip_to_integer(lat * 1e7, -most, most),
        clip_to_integer(lon * 1e7, -most, most),
        clip_to_integer(alt * 1e3, -most, most),
    )


def _estimated_position(p: TelemetryState) -> tuple[float, float, float]:
    n, e, d = p.flight_state.estimate.position.tolist()
    return n, e, d


def global_position_message(p: TelemetryState) -> MavMessage:
    """Return GLOBAL_POSITION_INT: latitude, longitude, altitude, velocity and heading."""
    m = p.flight_state.estimate
    speeds = [clip_to_integer(v * 100.0, -32768, 32767) for v in m.velocity.tolist()]
    yaw = math.degrees(float(m.attitude[2])) % 360.0 if math.isfinite(m.attitude[2]) else math.nan
    home = p.flight_state.home_position
    above = to_float32(-m.position[2] + (home[2] if home is not None else 0.0))
    return mavlink.MAVLink_global_position_int_message(
        p.boot_time_ms,
        *_global_position_integers(p, _estimated_position(p)),
        clip_to_integer(above * 1e3, -(2**31), 2**31 - 1),
        *speeds,
        clip_to_integer(yaw * 100.0, 0, 35_999, _UNKNOWN_UINT16),
    )


def gps_raw_message(p: TelemetryState) -> MavMessage:
    """Return GPS_RAW_INT: the estimated position in the form of a GPS fix; requires a global origin."""
    v = p.flight_state.estimate.velocity
    speed = math.hypot(v[0], v[1])
    course = math.degrees(math.atan2(v[1], v[0])) % 360.0
    return mavlink.MAVLink_gps_raw_int_message(
        p.boot_time_us,
        mavlink.GPS_FIX_TYPE_3D_FIX,
        *_global_position_integers(p, _estimated_position(p)),
        100,
        100,
        clip_to_integer(speed * 100.0, 0, _UNKNOWN_UINT16 - 1, _UNKNOWN_UINT16),
        clip_to_integer(course * 100.0, 0, 35_999, _UNKNOWN_UINT16),
        10,
    )


def altitude_message(p: TelemetryState) -> MavMessage:
    """Return ALTITUDE: heights above floor and take-off position and, with a global origin, above sea level."""
    _, _, d = _estimated_position(p)
    height = to_float32(-d)
    above_sea = math.nan if p.origin is None else to_float32(p.origin.alt_m - d)
    home = d if p.flight_state.home_position is None else float(p.flight_state.home_position[2])
    floor = -1e4 if p.origin is None else to_float32(p.origin.alt_m)  # below -1000: unknown
    return mavlink.MAVLink_altitude_message(
        p.boot_time_us, height, above_sea, height, to_float32(home - d), floor, max(height, 0.0)
    )


def home_position_message(p: TelemetryState) -> MavMessage:
    """Return HOME_POSITION: the take-off position, or the present one on the floor."""
    n, e, d = (
        to_float32(x)
        for x in (_estimated_position(p) if p.flight_state.home_position is None else p.flight_state.home_position)
    )
    return mavlink.MAVLink_home_position_message(
        *_global_position_integers(p, (n, e, d)), n, e, d, (1.0, 0.0, 0.0, 0.0), 0.0, 0.0, 0.0, p.boot_time_us
    )


def global_origin_message(p: TelemetryState) -> MavMessage:
    """Return GPS_GLOBAL_ORIGIN: global position of N = E = D = 0."""
    return mavlink.MAVLink_gps_global_origin_message(*_global_position_integers(p, (0, 0, 0)), p.boot_time_us)


def autopilot_version_message(p: TelemetryState) -> MavMessage:
    """Return AUTOPILOT_VERSION: capabilities and identity of the vehicle."""
    can = (
        mavlink.MAV_PROTOCOL_CAPABILITY_MISSION_FLOAT
        | mavlink.MAV_PROTOCOL_CAPABILITY_MISSION_INT
        | mavlink.MAV_PROTOCOL_CAPABILITY_COMMAND_INT
        | mavlink.MAV_PROTOCOL_CAPABILITY_PARAM_ENCODE_BYTEWISE
        | mavlink.MAV_PROTOCOL_CAPABILITY_SET_POSITION_TARGET_LOCAL_NED
        | mavlink.MAV_PROTOCOL_CAPABILITY_FLIGHT_TERMINATION
        | mavlink.MAV_PROTOCOL_CAPABILITY_MISSION_FENCE
        | mavlink.MAV_PROTOCOL_CAPABILITY_MAVLINK2
    )
    if p.origin is not None:
        can |= mavlink.MAV_PROTOCOL_CAPABILITY_SET_POSITION_TARGET_GLOBAL_INT
    numbers = [int(part) for part in __version__.split(".")[:3] if part.isdigit()]
    major, minor, patch = [*numbers, 0, 0, 0][:3]
    name = list(MUFLY_VERSION_PREFIX.ljust(8, b"\0"))
    version = (major & 0xFF) << 24 | (minor & 0xFF) << 16 | (patch & 0xFF) << 8
    return mavlink.MAVLink_autopilot_version_message(can, version, 0, 0, 0, name, [0] * 8, [0] * 8, 0, 0, 0)


@dataclass(frozen=True, slots=True)
class MessageStream:
    """Row of the table of telemetry messages: message, default rate, and the function that builds it.

    Attributes
    ----------
    message_name : str
        Name of the message, with a distinction in brackets where several rows share it.
    default_rate_Hz : float
        Rate for a peer that requests none; 0: only on request.
    stream_group : int
        MAV_DATA_STREAM group; 0: none.
    make_messages : callable
        Function of the :class:`TelemetryState`, which returns its messages; None if there is none.
    needs_origin : bool
        Whether the message needs an origin.
    """

    message_name: str
    default_rate_Hz: float
    stream_group: int
    make_messages: Callable[[TelemetryState], MavMessage | list[MavMessage] | None]
    needs_origin: bool = False

    @property
    def message_id(self) -> int:
        """MAVLink id of the message."""
        return int(getattr(mavlink, f"MAVLINK_MSG_ID_{self.message_name.split(' ')[0]}"))

    def build_messages(self, now: TelemetryState) -> list[MavMessage]:
        """Return the messages for the present state of the flight."""
        made = None if self.needs_origin and now.origin is None else self.make_messages(now)
        return made if isinstance(made, list) else [] if made is None else [made]


_GROUP_STATUS, _GROUP_RC, _GROUP_RAW, _GROUP_POSITION, _GROUP_EXTRA1, _GROUP_EXTRA2, _GROUP_EXTRA3 = (
    2,
    3,
    4,
    6,
    10,
    11,
    12,
)

MESSAGE_STREAMS: tuple[MessageStream, ...] = (
    MessageStream("HEARTBEAT", 1.0, 0, heartbeat_message),
    MessageStream("SYS_STATUS", 2.0, _GROUP_STATUS, sys_status_message),
    MessageStream("SYSTEM_TIME", 1.0, _GROUP_STATUS, system_time_message),
    MessageStream("BATTERY_STATUS", 1.0, _GROUP_STATUS, battery_status_message),
    MessageStream("EXTENDED_SYS_STATE", 2.0, _GROUP_STATUS, extended_state_message),
    MessageStream("FENCE_STATUS", 0.5, _GROUP_STATUS, fence_status_message),
    MessageStream("MISSION_CURRENT", 2.0, _GROUP_STATUS, mission_current_message),
    MessageStream("NAMED_VALUE_INT (mstate)", 5.0, _GROUP_STATUS, mission_state_message),
    MessageStream("NAMED_VALUE_INT (command)", 1.0, _GROUP_STATUS, commander_id_message),
    MessageStream("NAMED_VALUE_FLOAT (rtfactor)", 1.0, _GROUP_STATUS, real_time_factor_message),
    MessageStream("NAMED_VALUE_INT (slips)", 0.5, _GROUP_STATUS, overrun_count_message),
    MessageStream("ATTITUDE", 20.0, _GROUP_EXTRA1, attitude_message),
    MessageStream("ATTITUDE_QUATERNION", 5.0, _GROUP_EXTRA1, attitude_quaternion_message),
    MessageStream("LOCAL_POSITION_NED", 20.0, _GROUP_POSITION, local_position_message),
    MessageStream("POSITION_TARGET_LOCAL_NED", 10.0, _GROUP_POSITION, position_target_message),
    MessageStream("ATTITUDE_TARGET", 10.0, _GROUP_EXTRA1, attitude_target_message),
    MessageStream("VISION_POSITION_ESTIMATE", 5.0, _GROUP_RAW, vision_position_message),
    MessageStream("ACTUATOR_OUTPUT_STATUS", 10.0, _GROUP_RC, actuator_output_message),
    MessageStream("RAW_RPM", 5.0, _GROUP_RC, rotor_rpm_messages),
    MessageStream("OBSTACLE_DISTANCE", 5.0, _GROUP_EXTRA3, obstacle_distance_message),
    MessageStream("DISTANCE_SENSOR", 1.0, _GROUP_EXTRA3, distance_sensor_messages),
    MessageStream("ODOMETRY", 0.5, _GROUP_POSITION, lambda p: odometry_message(p.flight_state, p.boot_time_us)),
    MessageStream(
        "ESTIMATOR_STATUS",
        1.0,
        _GROUP_EXTRA3,
        lambda p: estimator_status_message(p.flight_state, p.boot_time_us),
    ),
    MessageStream(
        "DEBUG_FLOAT_ARRAY (checks)",
        1.0,
        _GROUP_EXTRA3,
        lambda p: sensor_checks_message(p.flight_state, p.boot_time_us),
    ),
    MessageStream("VFR_HUD", 5.0, _GROUP_EXTRA2, vfr_hud_message),
    MessageStream("ALTITUDE", 5.0, _GROUP_POSITION, altitude_message),
    MessageStream("DEBUG_FLOAT_ARRAY", 0.0, 0, truth_message),
    MessageStream("GLOBAL_POSITION_INT", 5.0, _GROUP_POSITION, global_position_message, True),
    MessageStream("GPS_RAW_INT", 2.0, _GROUP_POSITION, gps_raw_message, True),
    MessageStream("HOME_POSITION", 0.5, _GROUP_POSITION, home_position_message, True),
    MessageStream("GPS_GLOBAL_ORIGIN", 0.2, _GROUP_POSITION, global_origin_message, True),
    MessageStream("AUTOPILOT_VERSION", 0.0, 0, autopilot_version_message),
)
"""Messages that can be streamed or requested, with their default rates."""

ORIGIN_DEPENDENT_MESSAGE_IDS = frozenset(s.message_id for s in MESSAGE_STREAMS if s.needs_origin)
"""Ids of messages that need an origin."""
