"""What the vehicle tells: each message from the state of the flight at one instant, and how often it goes out.

Every function takes the :class:`Instant` and returns one message, or several. Units are the messages' own
(https://mavlink.io/en/messages/common.html); axes N-E-D and body x-y-z, as here. :data:`STREAMS` is the table of all
messages that can be streamed or asked for: a new message is a function and a row.

``estimated_`` travels as ATTITUDE and LOCAL_POSITION_NED, how far to believe that as ODOMETRY and ESTIMATOR_STATUS
(:mod:`mufly.link.estimates`), ``reference_`` as POSITION_TARGET_LOCAL_NED and ATTITUDE_TARGET, ``measured_`` as
VISION_POSITION_ESTIMATE, ``truth_`` and the wind as DEBUG_FLOAT_ARRAY "truth".
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mufly.dynamics import quaternion_from_euler
from mufly.flight import FlightState
from mufly.link.codec import (
    MISSION,
    TAKE_OFF,
    MavMessage,
    Mode,
    Origin,
    custom_mode,
    mavlink,
    mode_of,
    single,
    within,
)
from mufly.link.estimates import UNKNOWN_TRIANGLE, estimator_status, odometry, sensor_checks
from mufly.link.vision import triangle_of
from mufly.mission import State
from mufly.vehicle import Vehicle
from mufly.version import __version__


@dataclass(frozen=True, slots=True)
class Progress:
    """Where the mission stands: the item that is current, how many there are, MISSION_STATE, and MISSION_MODE."""

    item: int
    total: int
    state: int
    mode: int


@dataclass(frozen=True, slots=True)
class Instant:
    """What the messages of one instant are made from: the state of the flight, and what the link itself knows.

    Attributes
    ----------
    vehicle : Vehicle
    state : FlightState
    ready : bool
        Whether it could be armed.
    progress : Progress
        Of its mission.
    origin : Origin or None
        Where on the globe it is.
    chosen : str
        The mode that was chosen on the floor, for when it is armed; "" if none.
    commander : int
        system * 256 + component of who commands; 0: nobody.
    loss : float
        Share of the packets from its stations that were lost, 0..1.
    real_time_factor : float
        Of late, seconds of the flight in one second of the clock on the wall; NaN where nobody measures it.
    slips : int
        How often time was given up.
    """

    vehicle: Vehicle
    state: FlightState
    ready: bool
    progress: Progress
    origin: Origin | None
    chosen: str
    commander: int
    loss: float
    real_time_factor: float = math.nan
    slips: int = 0

    @property
    def has_fence(self) -> bool:
        """Whether its mission has a geofence."""
        return self.state.mission is not None and self.state.mission.fence is not None

    @property
    def boot_ms(self) -> int:
        """The vehicle's clock (ms), as an unsigned number of 32 bits; never 0, which readers take for "not known"."""
        return max(1, round(self.state.time_s * 1e3) % 2**32)

    @property
    def usec(self) -> int:
        """The vehicle's clock (us), never 0."""
        return max(1, round(self.state.time_s * 1e6))

    @property
    def battery_low(self) -> bool:
        """Whether the battery's voltage is below the one to land at."""
        return bool(self.state.estimate.battery_voltage < float(self.vehicle.battery.low_voltage))


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


def _floats(values: Sequence[float] | NDArray[np.floating[Any]]) -> list[float]:
    return [single(v) for v in np.asarray(values, dtype=np.float64).tolist()]


def _wrapped(angle: float) -> float:
    return math.remainder(angle, math.tau) if math.isfinite(angle) else math.nan


def _quaternion(angles: NDArray[np.floating[Any]]) -> list[float]:
    roll, pitch, yaw = (a if math.isfinite(a) else math.nan for a in angles.tolist())
    return _floats(quaternion_from_euler(roll, pitch, yaw))


def attitude(p: Instant) -> MavMessage:
    """ATTITUDE: roll, pitch, yaw (rad, yaw in +-pi) and body rates (rad/s)."""
    roll, pitch, yaw = _floats(p.state.estimate.attitude)
    return mavlink.MAVLink_attitude_message(
        p.boot_ms, roll, pitch, _wrapped(yaw), *_floats(p.state.estimate.rates)
    )


def attitude_quaternion(p: Instant) -> MavMessage:
    """ATTITUDE_QUATERNION."""
    q = _quaternion(p.state.estimate.attitude)
    return mavlink.MAVLink_attitude_quaternion_message(p.boot_ms, *q, *_floats(p.state.estimate.rates))


def local_position_ned(p: Instant) -> MavMessage:
    """LOCAL_POSITION_NED: position (m) and velocity (m/s)."""
    m = p.state.estimate
    return mavlink.MAVLink_local_position_ned_message(p.boot_ms, *_floats(m.position), *_floats(m.velocity))


def position_target_local_ned(p: Instant) -> MavMessage:
    """POSITION_TARGET_LOCAL_NED: the reference, with what is not followed now masked out."""
    v = p.state
    mask = _IGNORE_ACCELERATION | _IGNORE_YAW_RATE
    if not p.state.armed or p.state.state == "init":
        mask = _IGNORE_ALL
    elif p.state.state == "rc":
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


def attitude_target(p: Instant) -> MavMessage:
    """ATTITUDE_TARGET: the attitude that is asked of the inner loop."""
    angles = p.state.reference_attitude
    mask = _IGNORE_RATES_AND_THRUST
    if not p.state.armed or p.state.state == "init":
        mask |= _IGNORE_ATTITUDE
    q = _quaternion(angles)
    return mavlink.MAVLink_attitude_target_message(p.boot_ms, mask, q, 0.0, 0.0, 0.0, 0.0)


def vision_position_estimate(p: Instant) -> MavMessage | None:
    """VISION_POSITION_ESTIMATE: position and attitude as measured, or a fix (roll, pitch NaN); None without."""
    r = p.state.readings
    if r is None:
        return None
    usec, triangle = p.usec, list(UNKNOWN_TRIANGLE)
    if "position" in r and "attitude" in r:
        place, angles = r["position"].value, r["attitude"].value
    elif "position_fix" in r and r["position_fix"].valid:
        said = r["position_fix"]
        place, angles = said.value[:3], [math.nan, math.nan, said.value[3]]
        usec = round(said.time_s * 1e6)
        if said.covariance is not None:
            triangle = triangle_of(said.covariance)
    else:
        return None
    roll, pitch, yaw = _floats(angles)
    return mavlink.MAVLink_vision_position_estimate_message(
        usec, *_floats(place), roll, pitch, _wrapped(yaw), triangle
    )


def actuator_output_status(p: Instant) -> MavMessage:
    """ACTUATOR_OUTPUT_STATUS: motor upper, lower (0..1), servo 1, 2 (-1..1)."""
    outputs = _floats(p.state.actuators.array)
    return mavlink.MAVLink_actuator_output_status_message(p.usec, len(outputs), outputs + [0.0] * 28)


def raw_rpm(p: Instant) -> list[MavMessage]:
    """RAW_RPM of the upper (0) and the lower (1) rotor."""
    speeds = [] if p.state.truth is None else p.state.truth.rotor_speed.tolist()
    return [mavlink.MAVLink_raw_rpm_message(k, single(w * 30.0 / math.pi)) for k, w in enumerate(speeds)]


def obstacle_distance(p: Instant) -> MavMessage:
    """OBSTACLE_DISTANCE: the ring of beams, clockwise from its first (cm); one more than the most: nothing in sight."""
    ring, ranges = p.vehicle.range_ring, np.asarray(p.state.estimate.ranges)[:_OBSTACLES_MOST].tolist()
    most_m = float(ring.max_range)
    most = within(most_m * 100.0, 0, _NOTHING_CM - 2)
    seen = [most + 1 if r >= most_m else within(r * 100.0, 0, most, _NOTHING_CM) for r in ranges]
    spacing = 360.0 / max(1, ring.count)
    return mavlink.MAVLink_obstacle_distance_message(
        p.usec,
        mavlink.MAV_DISTANCE_SENSOR_LASER,
        seen + [_NOTHING_CM] * (_OBSTACLES_MOST - len(seen)),
        within(spacing, 0, 255),
        within(float(ring.min_range) * 100.0, 0, most),
        most,
        spacing,
        math.degrees(float(ring.first_angle)),
        mavlink.MAV_FRAME_BODY_FRD,
    )


def distance_sensors(p: Instant) -> list[MavMessage]:
    """DISTANCE_SENSOR of every beam, with its direction."""
    ring, out = p.vehicle.range_ring, []
    least, most = (within(float(m) * 100.0, 0, _NOTHING_CM - 1) for m in (ring.min_range, ring.max_range))
    for k, r in enumerate(np.asarray(p.state.estimate.ranges).tolist()[:255]):
        angle = float(ring.first_angle) + math.tau * k / ring.count
        turns = math.degrees(angle) / _YAW_ROTATIONS
        fits = abs(turns - round(turns)) < 1e-3
        out.append(
            mavlink.MAVLink_distance_sensor_message(
                p.boot_ms,
                min(least, most),
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


def vfr_hud(p: Instant) -> MavMessage:
    """VFR_HUD: what a simple instrument shows; "airspeed" is the speed over ground, for there is no airspeed sensor."""
    m, motors = p.state.estimate, np.asarray(p.state.actuators.motor_input)
    speed = single(math.hypot(m.velocity[0], m.velocity[1]))
    height = -m.position[2] + (p.origin.alt_m if p.origin is not None else 0.0)
    yaw = float(m.attitude[2])
    heading = within(math.degrees(yaw) % 360.0, 0, 360) % 360 if math.isfinite(yaw) else 0
    throttle = within(float(motors.mean()) * 100.0, 0, 100)
    return mavlink.MAVLink_vfr_hud_message(
        speed, speed, heading, throttle, single(height), single(-m.velocity[2])
    )


def truth(p: Instant) -> MavMessage | None:
    """DEBUG_FLOAT_ARRAY "truth" (see :data:`TRUTH`); None where nobody knows it."""
    t = p.state.truth
    if t is None:
        return None
    roll, pitch, yaw = t.attitude.tolist()
    values = [*t.position, *t.velocity, roll, pitch, _wrapped(yaw), *t.rates, *t.rotor_speed, *t.wind]
    return mavlink.MAVLink_debug_float_array_message(
        p.usec, TRUTH, 0, _floats(values) + [0.0] * (58 - len(values))
    )


# What the vehicle is up to: heartbeat, health, battery, mission, and its place on the globe.

MUFLY = b"mufly"
"""Begins ``flight_custom_version``: whoever reads it knows that this is no real PX4."""
STATES: tuple[str, ...] = tuple(str(s) for s in State)
"""NAMED_VALUE_INT "mstate" is an index into these."""
SLOW = 0.95
"""A real-time factor below this is shown and said: time is being lost."""
REAL_TIME_FACTOR, SLIPS = "rtfactor", "slips"
"""Names of the values that tell how well the clock on the wall is kept: MAVLink has no message for it."""

_UNKNOWN_16, _UNKNOWN_16S = 65535, 32767


def shown_mode(p: Instant) -> Mode:
    """Return the flight mode that shows what it is doing, or has been told to do once it is armed."""
    if p.chosen:
        return TAKE_OFF if p.chosen == "take-off" else MISSION
    return mode_of(p.state.state, not p.state.mission_running, p.state.homing)


def heartbeat(p: Instant) -> MavMessage:
    """HEARTBEAT: a coaxial helicopter with the modes of PX4; armed, mode, and how well it is."""
    mode = shown_mode(p)
    base = mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED | mavlink.MAV_MODE_FLAG_STABILIZE_ENABLED
    base |= (
        mavlink.MAV_MODE_FLAG_AUTO_ENABLED | mavlink.MAV_MODE_FLAG_GUIDED_ENABLED
        if mode.main in (4, 6)
        else mavlink.MAV_MODE_FLAG_MANUAL_INPUT_ENABLED
    )
    if p.state.armed:
        base |= mavlink.MAV_MODE_FLAG_SAFETY_ARMED
    if p.state.crashed:
        state = mavlink.MAV_STATE_EMERGENCY
    elif p.state.flying and p.battery_low:
        state = mavlink.MAV_STATE_CRITICAL
    else:
        state = mavlink.MAV_STATE_ACTIVE if p.state.armed else mavlink.MAV_STATE_STANDBY
    return mavlink.MAVLink_heartbeat_message(
        mavlink.MAV_TYPE_COAXIAL, mavlink.MAV_AUTOPILOT_PX4, base, custom_mode(mode), state, 3
    )


def sys_status(p: Instant) -> MavMessage:
    """SYS_STATUS: which sensors and controllers there are and work, and whether it could be armed.

    The heading that is measured counts as a magnetometer. There is a GPS bit only with a global origin.
    """
    here = (
        mavlink.MAV_SYS_STATUS_SENSOR_3D_GYRO
        | mavlink.MAV_SYS_STATUS_SENSOR_3D_ACCEL
        | mavlink.MAV_SYS_STATUS_SENSOR_3D_MAG
        | mavlink.MAV_SYS_STATUS_SENSOR_VISION_POSITION
        | mavlink.MAV_SYS_STATUS_SENSOR_ANGULAR_RATE_CONTROL
        | mavlink.MAV_SYS_STATUS_SENSOR_ATTITUDE_STABILIZATION
        | mavlink.MAV_SYS_STATUS_SENSOR_YAW_POSITION
        | mavlink.MAV_SYS_STATUS_SENSOR_Z_ALTITUDE_CONTROL
        | mavlink.MAV_SYS_STATUS_SENSOR_XY_POSITION_CONTROL
        | mavlink.MAV_SYS_STATUS_SENSOR_MOTOR_OUTPUTS
        | mavlink.MAV_SYS_STATUS_AHRS
        | mavlink.MAV_SYS_STATUS_SENSOR_BATTERY
        | mavlink.MAV_SYS_STATUS_SENSOR_PROXIMITY
        | mavlink.MAV_SYS_STATUS_PREARM_CHECK
    )
    if p.origin is not None:
        here |= mavlink.MAV_SYS_STATUS_SENSOR_GPS
    if p.has_fence:
        here |= mavlink.MAV_SYS_STATUS_GEOFENCE
    # Without a fence none is broken: MAVProxy reports a breach where this bit is not set.
    well = here | mavlink.MAV_SYS_STATUS_GEOFENCE
    if p.state.fence_breach:
        well &= ~mavlink.MAV_SYS_STATUS_GEOFENCE
    if not (p.ready or p.state.armed):
        well &= ~mavlink.MAV_SYS_STATUS_PREARM_CHECK
    if p.battery_low:
        well &= ~mavlink.MAV_SYS_STATUS_SENSOR_BATTERY
    v = p.state
    return mavlink.MAVLink_sys_status_message(
        here,
        here,
        well,
        0,
        within(v.estimate.battery_voltage * 1e3, 0, _UNKNOWN_16 - 1, _UNKNOWN_16),
        within(v.battery_current * 1e2, -32768, _UNKNOWN_16S, -1),
        within(v.battery_charge * 100.0, 0, 100, -1),
        within(p.loss * 1e4, 0, 10_000),
        0,
        0,
        0,
        0,
        0,
    )


def fence_status(p: Instant) -> MavMessage:
    """FENCE_STATUS: whether it is outside its geofence, how often and when it left it; without one it never is."""
    v = p.state
    kind = mavlink.FENCE_BREACH_NONE
    if v.fence_breach:
        above = v.fence_breach.endswith("ceiling")
        kind = mavlink.FENCE_BREACH_MAXALT if above else mavlink.FENCE_BREACH_BOUNDARY
    count = min(v.fence_breaches, 65535)
    when = within(v.fence_breach_s * 1e3, 0, 2**32 - 1)
    return mavlink.MAVLink_fence_status_message(int(bool(v.fence_breach)), count, kind, when)


def battery_status(p: Instant) -> MavMessage:
    """BATTERY_STATUS: voltage, current, charge, and how long it will last."""
    v = p.state
    if v.battery_charge < 0.05:
        charge = mavlink.MAV_BATTERY_CHARGE_STATE_CRITICAL
    elif p.battery_low:
        charge = mavlink.MAV_BATTERY_CHARGE_STATE_LOW
    else:
        charge = mavlink.MAV_BATTERY_CHARGE_STATE_OK
    voltages = [within(v.estimate.battery_voltage * 1e3, 0, _UNKNOWN_16 - 1, _UNKNOWN_16)] + [_UNKNOWN_16] * 9
    return mavlink.MAVLink_battery_status_message(
        0,
        mavlink.MAV_BATTERY_FUNCTION_ALL,
        mavlink.MAV_BATTERY_TYPE_LIPO,
        _UNKNOWN_16S,
        voltages,
        within(v.battery_current * 1e2, -32768, _UNKNOWN_16S, -1),
        -1,
        -1,
        within(v.battery_charge * 100.0, 0, 100, -1),
        within(v.battery_left_s, 1, 2**31 - 1, 0),
        charge,
    )


def landed_state(p: Instant) -> int:
    """MAV_LANDED_STATE."""
    if not p.state.flying:
        return int(mavlink.MAV_LANDED_STATE_ON_GROUND)
    if p.state.state == State.TAKE_OFF:
        return int(mavlink.MAV_LANDED_STATE_TAKEOFF)
    if p.state.state == State.LANDING:
        return int(mavlink.MAV_LANDED_STATE_LANDING)
    return int(mavlink.MAV_LANDED_STATE_IN_AIR)


def extended_sys_state(p: Instant) -> MavMessage:
    """EXTENDED_SYS_STATE: on the floor, taking off, in the air, landing."""
    return mavlink.MAVLink_extended_sys_state_message(mavlink.MAV_VTOL_STATE_UNDEFINED, landed_state(p))


def system_time(p: Instant) -> MavMessage:
    """SYSTEM_TIME: the vehicle's clock; it knows no calendar."""
    return mavlink.MAVLink_system_time_message(0, p.boot_ms)


def mission_current(p: Instant) -> MavMessage:
    """MISSION_CURRENT: the item that is flown to or comes next, and how far the mission is."""
    q = p.progress
    return mavlink.MAVLink_mission_current_message(q.item, q.total if q.total else 65535, q.state, q.mode)


def mission_state(p: Instant) -> MavMessage:
    """NAMED_VALUE_INT "mstate": index of the mission's state in :data:`STATES`."""
    return mavlink.MAVLink_named_value_int_message(p.boot_ms, b"mstate", STATES.index(p.state.state))


def command(p: Instant) -> MavMessage:
    """NAMED_VALUE_INT "command": system * 256 + component of who commands; 0: nobody."""
    return mavlink.MAVLink_named_value_int_message(p.boot_ms, b"command", p.commander)


def real_time_factor(p: Instant) -> MavMessage | None:
    """NAMED_VALUE_FLOAT "rtfactor": seconds of the flight in one of the wall, of late; None where not measured."""
    if math.isnan(p.real_time_factor):
        return None
    name = REAL_TIME_FACTOR.encode()
    return mavlink.MAVLink_named_value_float_message(p.boot_ms, name, single(p.real_time_factor))


def slips(p: Instant) -> MavMessage | None:
    """NAMED_VALUE_INT "slips": how often time was given up; None where it is not measured."""
    if math.isnan(p.real_time_factor):
        return None
    return mavlink.MAVLink_named_value_int_message(p.boot_ms, SLIPS.encode(), p.slips)


def _globe(p: Instant, place: tuple[float, float, float]) -> tuple[int, int, int]:
    assert p.origin is not None
    lat, lon, alt = p.origin.to_global(*place)
    most = 2**31 - 1
    return within(lat * 1e7, -most, most), within(lon * 1e7, -most, most), within(alt * 1e3, -most, most)


def _place(p: Instant) -> tuple[float, float, float]:
    n, e, d = p.state.estimate.position.tolist()
    return n, e, d


def global_position_int(p: Instant) -> MavMessage:
    """GLOBAL_POSITION_INT."""
    m = p.state.estimate
    speeds = [within(v * 100.0, -32768, 32767) for v in m.velocity.tolist()]
    yaw = math.degrees(float(m.attitude[2])) % 360.0 if math.isfinite(m.attitude[2]) else math.nan
    home = p.state.home
    above = single(-m.position[2] + (home[2] if home is not None else 0.0))
    return mavlink.MAVLink_global_position_int_message(
        p.boot_ms,
        *_globe(p, _place(p)),
        within(above * 1e3, -(2**31), 2**31 - 1),
        *speeds,
        within(yaw * 100.0, 0, 35_999, _UNKNOWN_16),
    )


def gps_raw_int(p: Instant) -> MavMessage:
    """GPS_RAW_INT: the simulated receiver that an origin stands for."""
    v = p.state.estimate.velocity
    speed = math.hypot(v[0], v[1])
    course = math.degrees(math.atan2(v[1], v[0])) % 360.0
    return mavlink.MAVLink_gps_raw_int_message(
        p.usec,
        mavlink.GPS_FIX_TYPE_3D_FIX,
        *_globe(p, _place(p)),
        100,
        100,
        within(speed * 100.0, 0, _UNKNOWN_16 - 1, _UNKNOWN_16),
        within(course * 100.0, 0, 35_999, _UNKNOWN_16),
        10,
    )


def altitude(p: Instant) -> MavMessage:
    """ALTITUDE: height above the floor, above where it took off, and with an origin above the sea."""
    _, _, d = _place(p)
    height = single(-d)
    above_sea = math.nan if p.origin is None else single(p.origin.alt_m - d)
    home = d if p.state.home is None else float(p.state.home[2])
    floor = -1e4 if p.origin is None else single(p.origin.alt_m)  # below -1000: not known
    return mavlink.MAVLink_altitude_message(
        p.usec, height, above_sea, height, single(home - d), floor, max(height, 0.0)
    )


def home_position(p: Instant) -> MavMessage:
    """HOME_POSITION: where it took off, or stands."""
    n, e, d = (single(x) for x in (_place(p) if p.state.home is None else p.state.home))
    return mavlink.MAVLink_home_position_message(
        *_globe(p, (n, e, d)), n, e, d, (1.0, 0.0, 0.0, 0.0), 0.0, 0.0, 0.0, p.usec
    )


def gps_global_origin(p: Instant) -> MavMessage:
    """GPS_GLOBAL_ORIGIN: where N = E = D = 0 is."""
    return mavlink.MAVLink_gps_global_origin_message(*_globe(p, (0, 0, 0)), p.usec)


def autopilot_version(p: Instant) -> MavMessage:
    """AUTOPILOT_VERSION: what it can do, and who it really is."""
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
    name = list(MUFLY.ljust(8, b"\0"))
    version = (major & 0xFF) << 24 | (minor & 0xFF) << 16 | (patch & 0xFF) << 8
    return mavlink.MAVLink_autopilot_version_message(can, version, 0, 0, 0, name, [0] * 8, [0] * 8, 0, 0, 0)


@dataclass(frozen=True, slots=True)
class Stream:
    """One message of the table.

    Attributes
    ----------
    name : str
        Of the message; where several share one, what tells them apart follows in brackets.
    default_Hz : float
        Rate for a peer that does not ask; 0: only on request.
    group : int
        MAV_DATA_STREAM group that it belongs to; 0: none.
    make : callable
        Instant -> message, several, or None where there is nothing to tell.
    needs_origin : bool
        Whether there is nothing to tell without an origin.
    """

    name: str
    default_Hz: float
    group: int
    make: Callable[[Instant], MavMessage | list[MavMessage] | None]
    needs_origin: bool = False

    @property
    def number(self) -> int:
        """Id of the message."""
        return int(getattr(mavlink, f"MAVLINK_MSG_ID_{self.name.split(' ')[0]}"))

    def messages(self, now: Instant) -> list[MavMessage]:
        """Return what there is to tell."""
        made = None if self.needs_origin and now.origin is None else self.make(now)
        return made if isinstance(made, list) else [] if made is None else [made]


_STATUS, _RC, _RAW, _POSITION, _EXTRA1, _EXTRA2, _EXTRA3 = 2, 3, 4, 6, 10, 11, 12

STREAMS: tuple[Stream, ...] = (
    Stream("HEARTBEAT", 1.0, 0, heartbeat),
    Stream("SYS_STATUS", 2.0, _STATUS, sys_status),
    Stream("SYSTEM_TIME", 1.0, _STATUS, system_time),
    Stream("BATTERY_STATUS", 1.0, _STATUS, battery_status),
    Stream("EXTENDED_SYS_STATE", 2.0, _STATUS, extended_sys_state),
    Stream("FENCE_STATUS", 0.5, _STATUS, fence_status),
    Stream("MISSION_CURRENT", 2.0, _STATUS, mission_current),
    Stream("NAMED_VALUE_INT (mstate)", 5.0, _STATUS, mission_state),
    Stream("NAMED_VALUE_INT (command)", 1.0, _STATUS, command),
    Stream("NAMED_VALUE_FLOAT (rtfactor)", 1.0, _STATUS, real_time_factor),
    Stream("NAMED_VALUE_INT (slips)", 0.5, _STATUS, slips),
    Stream("ATTITUDE", 20.0, _EXTRA1, attitude),
    Stream("ATTITUDE_QUATERNION", 5.0, _EXTRA1, attitude_quaternion),
    Stream("LOCAL_POSITION_NED", 20.0, _POSITION, local_position_ned),
    Stream("POSITION_TARGET_LOCAL_NED", 10.0, _POSITION, position_target_local_ned),
    Stream("ATTITUDE_TARGET", 10.0, _EXTRA1, attitude_target),
    Stream("VISION_POSITION_ESTIMATE", 5.0, _RAW, vision_position_estimate),
    Stream("ACTUATOR_OUTPUT_STATUS", 10.0, _RC, actuator_output_status),
    Stream("RAW_RPM", 5.0, _RC, raw_rpm),
    Stream("OBSTACLE_DISTANCE", 5.0, _EXTRA3, obstacle_distance),
    Stream("DISTANCE_SENSOR", 1.0, _EXTRA3, distance_sensors),
    Stream("ODOMETRY", 0.5, _POSITION, lambda p: odometry(p.state, p.usec)),
    Stream("ESTIMATOR_STATUS", 1.0, _EXTRA3, lambda p: estimator_status(p.state, p.usec)),
    Stream("DEBUG_FLOAT_ARRAY (checks)", 1.0, _EXTRA3, lambda p: sensor_checks(p.state, p.usec)),
    Stream("VFR_HUD", 5.0, _EXTRA2, vfr_hud),
    Stream("ALTITUDE", 5.0, _POSITION, altitude),
    Stream("DEBUG_FLOAT_ARRAY", 0.0, 0, truth),
    Stream("GLOBAL_POSITION_INT", 5.0, _POSITION, global_position_int, True),
    Stream("GPS_RAW_INT", 2.0, _POSITION, gps_raw_int, True),
    Stream("HOME_POSITION", 0.5, _POSITION, home_position, True),
    Stream("GPS_GLOBAL_ORIGIN", 0.2, _POSITION, gps_global_origin, True),
    Stream("AUTOPILOT_VERSION", 0.0, 0, autopilot_version),
)
"""Everything that can be streamed or asked for, with the rates that a peer gets who says nothing."""

ON_GLOBE = frozenset(s.number for s in STREAMS if s.needs_origin)
"""Ids of messages that tell nothing without an origin."""
