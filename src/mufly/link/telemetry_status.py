"""Messages about what the vehicle is up to: heartbeat, health, battery, mission, and its place on the globe."""

from __future__ import annotations

import math

from mufly.link.dialect import MavMessage, mavlink, single, within
from mufly.link.modes import MISSION, TAKE_OFF, Mode, custom_mode, mode_of
from mufly.link.picture import Picture
from mufly.mission import State
from mufly.version import __version__

__all__ = [
    "MUFLY",
    "STATES",
    "altitude",
    "autopilot_version",
    "battery_status",
    "command",
    "extended_sys_state",
    "global_position_int",
    "gps_global_origin",
    "gps_raw_int",
    "heartbeat",
    "home_position",
    "mission_current",
    "mission_state",
    "shown_mode",
    "sys_status",
    "system_time",
]

MUFLY = b"mufly"
"""Begins ``flight_custom_version``: whoever reads it knows that this is no real PX4."""
STATES: tuple[str, ...] = tuple(str(s) for s in State)
"""NAMED_VALUE_INT "mstate" is an index into these."""

_UNKNOWN_16, _UNKNOWN_16S = 65535, 32767


def shown_mode(p: Picture) -> Mode:
    """Return the flight mode that shows what it is doing, or has been told to do once it is armed."""
    if p.chosen:
        return TAKE_OFF if p.chosen == "take-off" else MISSION
    return mode_of(p.status.state, not p.status.mission_running, p.returning)


def heartbeat(p: Picture) -> MavMessage:
    """HEARTBEAT: a coaxial helicopter with the modes of PX4; armed, mode, and how well it is."""
    mode = shown_mode(p)
    base = mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED | mavlink.MAV_MODE_FLAG_STABILIZE_ENABLED
    base |= (
        mavlink.MAV_MODE_FLAG_AUTO_ENABLED | mavlink.MAV_MODE_FLAG_GUIDED_ENABLED
        if mode.main in (4, 6)
        else mavlink.MAV_MODE_FLAG_MANUAL_INPUT_ENABLED
    )
    if p.status.armed:
        base |= mavlink.MAV_MODE_FLAG_SAFETY_ARMED
    if p.view.crashed:
        state = mavlink.MAV_STATE_EMERGENCY
    elif p.status.flying and p.view.battery_voltage < p.airframe.low_V:
        state = mavlink.MAV_STATE_CRITICAL
    else:
        state = mavlink.MAV_STATE_ACTIVE if p.status.armed else mavlink.MAV_STATE_STANDBY
    return mavlink.MAVLink_heartbeat_message(
        mavlink.MAV_TYPE_COAXIAL, mavlink.MAV_AUTOPILOT_PX4, base, custom_mode(mode), state, 3
    )


def sys_status(p: Picture) -> MavMessage:
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
    # There is no fence, so none is broken: MAVProxy reports a breach where this bit is not set.
    well = here | mavlink.MAV_SYS_STATUS_GEOFENCE
    if not (p.ready or p.status.armed):
        well &= ~mavlink.MAV_SYS_STATUS_PREARM_CHECK
    if p.view.battery_voltage < p.airframe.low_V:
        well &= ~mavlink.MAV_SYS_STATUS_SENSOR_BATTERY
    v = p.view
    return mavlink.MAVLink_sys_status_message(
        here,
        here,
        well,
        0,
        within(v.battery_voltage * 1e3, 0, _UNKNOWN_16 - 1, _UNKNOWN_16),
        within(v.battery_current * 1e2, -32768, _UNKNOWN_16S, -1),
        within(v.battery_charge * 100.0, 0, 100, -1),
        within(p.loss * 1e4, 0, 10_000),
        0,
        0,
        0,
        0,
        0,
    )


def battery_status(p: Picture) -> MavMessage:
    """BATTERY_STATUS: voltage, current, charge, and how long it will last."""
    v = p.view
    if v.battery_charge < 0.05:
        charge = mavlink.MAV_BATTERY_CHARGE_STATE_CRITICAL
    elif v.battery_voltage < p.airframe.low_V:
        charge = mavlink.MAV_BATTERY_CHARGE_STATE_LOW
    else:
        charge = mavlink.MAV_BATTERY_CHARGE_STATE_OK
    voltages = [within(v.battery_voltage * 1e3, 0, _UNKNOWN_16 - 1, _UNKNOWN_16)] + [_UNKNOWN_16] * 9
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


def landed_state(p: Picture) -> int:
    """MAV_LANDED_STATE."""
    if not p.status.flying:
        return int(mavlink.MAV_LANDED_STATE_ON_GROUND)
    if p.status.state == State.TAKE_OFF:
        return int(mavlink.MAV_LANDED_STATE_TAKEOFF)
    if p.status.state == State.LANDING:
        return int(mavlink.MAV_LANDED_STATE_LANDING)
    return int(mavlink.MAV_LANDED_STATE_IN_AIR)


def extended_sys_state(p: Picture) -> MavMessage:
    """EXTENDED_SYS_STATE: on the floor, taking off, in the air, landing."""
    return mavlink.MAVLink_extended_sys_state_message(mavlink.MAV_VTOL_STATE_UNDEFINED, landed_state(p))


def system_time(p: Picture) -> MavMessage:
    """SYSTEM_TIME: the vehicle's clock; it knows no calendar."""
    return mavlink.MAVLink_system_time_message(0, p.boot_ms)


def mission_current(p: Picture) -> MavMessage:
    """MISSION_CURRENT: the item that is flown to or comes next, and how far the mission is."""
    q = p.progress
    return mavlink.MAVLink_mission_current_message(q.item, q.total if q.total else 65535, q.state, q.mode)


def mission_state(p: Picture) -> MavMessage:
    """NAMED_VALUE_INT "mstate": index of the mission's state in :data:`STATES`."""
    return mavlink.MAVLink_named_value_int_message(p.boot_ms, b"mstate", STATES.index(p.status.state))


def command(p: Picture) -> MavMessage:
    """NAMED_VALUE_INT "command": system * 256 + component of who commands; 0: nobody."""
    return mavlink.MAVLink_named_value_int_message(p.boot_ms, b"command", p.commander)


def _globe(p: Picture, place: tuple[float, float, float]) -> tuple[int, int, int]:
    assert p.origin is not None
    lat, lon, alt = p.origin.to_global(*place)
    most = 2**31 - 1
    return within(lat * 1e7, -most, most), within(lon * 1e7, -most, most), within(alt * 1e3, -most, most)


def _place(p: Picture) -> tuple[float, float, float]:
    n, e, d = p.view.measured.position.tolist()
    return n, e, d


def global_position_int(p: Picture) -> MavMessage | None:
    """GLOBAL_POSITION_INT; None without an origin."""
    if p.origin is None:
        return None
    m = p.view.measured
    speeds = [within(v * 100.0, -32768, 32767) for v in m.velocity.tolist()]
    yaw = math.degrees(float(m.attitude[2])) % 360.0 if math.isfinite(m.attitude[2]) else math.nan
    home = p.status.home
    above = single(-m.position[2] + (home[2] if home is not None else 0.0))
    return mavlink.MAVLink_global_position_int_message(
        p.boot_ms,
        *_globe(p, _place(p)),
        within(above * 1e3, -(2**31), 2**31 - 1),
        *speeds,
        within(yaw * 100.0, 0, 35_999, _UNKNOWN_16),
    )


def gps_raw_int(p: Picture) -> MavMessage | None:
    """GPS_RAW_INT: the simulated receiver that an origin stands for; None without one."""
    if p.origin is None:
        return None
    v = p.view.measured.velocity
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


def altitude(p: Picture) -> MavMessage:
    """ALTITUDE: height above the floor, above where it took off, and with an origin above the sea."""
    _, _, d = _place(p)
    height = single(-d)
    above_sea = math.nan if p.origin is None else single(p.origin.alt_m - d)
    home = d if p.status.home is None else float(p.status.home[2])
    floor = -1e4 if p.origin is None else single(p.origin.alt_m)  # below -1000: not known
    return mavlink.MAVLink_altitude_message(
        p.usec, height, above_sea, height, single(home - d), floor, max(height, 0.0)
    )


def home_position(p: Picture) -> MavMessage | None:
    """HOME_POSITION: where it took off, or stands; None without an origin."""
    if p.origin is None:
        return None
    place = _place(p) if p.status.home is None else (*(float(x) for x in p.status.home),)
    n, e, d = (single(x) for x in place)
    return mavlink.MAVLink_home_position_message(
        *_globe(p, (n, e, d)), n, e, d, (1.0, 0.0, 0.0, 0.0), 0.0, 0.0, 0.0, p.usec
    )


def gps_global_origin(p: Picture) -> MavMessage | None:
    """GPS_GLOBAL_ORIGIN: where N = E = D = 0 is; None without an origin."""
    return (
        None if p.origin is None else mavlink.MAVLink_gps_global_origin_message(*_globe(p, (0, 0, 0)), p.usec)
    )


def autopilot_version(p: Picture) -> MavMessage:
    """AUTOPILOT_VERSION: what it can do, and who it really is."""
    can = (
        mavlink.MAV_PROTOCOL_CAPABILITY_MISSION_FLOAT
        | mavlink.MAV_PROTOCOL_CAPABILITY_MISSION_INT
        | mavlink.MAV_PROTOCOL_CAPABILITY_COMMAND_INT
        | mavlink.MAV_PROTOCOL_CAPABILITY_PARAM_ENCODE_BYTEWISE
        | mavlink.MAV_PROTOCOL_CAPABILITY_SET_POSITION_TARGET_LOCAL_NED
        | mavlink.MAV_PROTOCOL_CAPABILITY_FLIGHT_TERMINATION
        | mavlink.MAV_PROTOCOL_CAPABILITY_MAVLINK2
    )
    if p.origin is not None:
        can |= mavlink.MAV_PROTOCOL_CAPABILITY_SET_POSITION_TARGET_GLOBAL_INT
    numbers = [int(part) for part in __version__.split(".")[:3] if part.isdigit()]
    major, minor, patch = [*numbers, 0, 0, 0][:3]
    name = list(MUFLY.ljust(8, b"\0"))
    version = (major & 0xFF) << 24 | (minor & 0xFF) << 16 | (patch & 0xFF) << 8
    return mavlink.MAVLink_autopilot_version_message(can, version, 0, 0, 0, name, [0] * 8, [0] * 8, 0, 0, 0)
