"""Table of ROS 2 topics: message types, frames, and conversion between signals of a recording and messages.

Bags (:mod:`mufly.logs.ros.rosbag2`) and the live node (:mod:`mufly.bridges.ros_node`) read this table.

Frames follow REP 103 and REP 105: ``map`` has x east, y north, z up; ``base_link`` has x forward, y left, z up. The
estimate includes position fixes, which remove drift, so its frame is ``map`` and not ``odom``. With
``T = [[0, 1, 0], [1, 0, 0], [0, 0, -1]]`` from N-E-D to ``map`` and ``F = diag(1, -1, -1)`` from forward-right-down to
``base_link``, the attitude is ``T R F`` with mufly's ``R``. In angles: roll is kept, pitch changes sign, and the yaw is
``pi / 2 - yaw``.

Covariances of a pose are row-major over (x, y, z, rotation about X, Y, Z), where the three rotations are the fixed-axis
angles roll, pitch and yaw (geometry_msgs/PoseWithCovariance). A twist is in ``base_link`` (nav_msgs/Odometry). A
recording has standard deviations and no correlations: the position's block is diagonal, that of the body's velocity is
the rotated diagonal. Zeros mean unknown. A specific force of +g along z belongs to a vehicle at rest (REP 145).

Messages are columns: nested dictionaries whose arrays have one row for each message; other values are constant.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mufly.rotations import body_to_ned_matrices, euler_from_unnormalised_quaternion, quaternions_from_euler

_Array = NDArray[np.float64]
Blocks = Mapping[str, _Array]
"""Signals by name, each (n, components)."""
Columns = dict[str, Any]
"""Messages of a topic as columns."""

MAP_FRAME, BODY_FRAME = "map", "base_link"
_FRD_TO_FLU_SIGNS = np.array([1.0, -1.0, -1.0])
_RANGE_TYPE_ULTRASOUND, _BATTERY_STATUS_DISCHARGING, _BATTERY_TYPE_LITHIUM_POLYMER = (
    0,
    2,
    3,
)  # sensor_msgs/Range, sensor_msgs/BatteryState
_MAX_RING_BEAMS = 64
_FIX_HEADING_ROW = 3  # of a fix and its variances: north, east, down, heading
_ENU_VARIANCE_ORDER = (1, 0, 2, _FIX_HEADING_ROW)
NANOSECONDS_PER_SECOND = 1_000_000_000


class RangeSensorGeometry(NamedTuple):
    """Geometry of a vehicle's range sensors, which a recording does not contain but ROS messages require.

    Attributes
    ----------
    sonar_cone_rad, sonar_min_m, sonar_max_m : float
        Full angle of the cone and limits of the ultrasonic sensor.
    first_beam_rad : float
        Direction of beam 0 of the ring, from forward to the right.
    ring_min_m, ring_max_m : float
        Limits of the ring.
    """

    sonar_cone_rad: float = math.nan
    sonar_min_m: float = 0.0
    sonar_max_m: float = math.inf
    first_beam_rad: float = 0.0
    ring_min_m: float = 0.0
    ring_max_m: float = math.inf


class RosTopic(NamedTuple):
    """A ROS topic of recordings: its message type, the signals that it carries, and their conversion.

    Attributes
    ----------
    name, message_type : str
    signal : str
        Signal without which there is no message; rows where it is NaN give none.
    encode : callable
        Function from signals and the sensors' geometry to columns.
    time_signal, valid_signal : str
        Signals with the time of measurement and its validity; invalid readings give no message.
    live_rate_Hz : float
        Highest rate of the live node.
    prefix : str
        Source of the signals that :func:`decode_fields` gives (``estimated``), or the signal itself.
    """

    name: str
    message_type: str
    signal: str
    encode: Callable[[Blocks, RangeSensorGeometry], Columns]
    time_signal: str = ""
    valid_signal: str = ""
    live_rate_Hz: float = 50.0
    prefix: str = ""


def ned_to_enu(values: _Array) -> _Array:
    """Convert vectors (n, 3) from north-east-down to east-north-up; the function is its own inverse."""
    return np.column_stack((values[:, 1], values[:, 0], -values[:, 2]))


def body_frd_to_flu(values: _Array) -> _Array:
    """Convert vectors (n, 3) from body axes forward-right-down to forward-left-up; the function is its own inverse."""
    return values * _FRD_TO_FLU_SIGNS


def attitude_to_ros(attitude: _Array) -> _Array:
    """Convert attitudes (n, 3) from forward-right-down axes in N-E-D to forward-left-up axes in E-N-U.

    The function is its own inverse.
    """
    return np.column_stack((attitude[:, 0], -attitude[:, 1], 0.5 * math.pi - attitude[:, 2]))


def _vector_message(values: _Array) -> Columns:
    return dict(zip("xyz", values.T, strict=True))


def _orientation_message(attitude: _Array) -> Columns:
    """Return the ROS quaternions of roll, pitch and yaw (n, 3) of mufly; unknown angles count as zero."""
    quaternion = quaternions_from_euler(attitude_to_ros(np.nan_to_num(attitude, nan=0.0)))
    return dict(zip("wxyz", quaternion.T, strict=True))


def _header_message(frame: str) -> Columns:
    return {"frame_id": frame}


def _signal_or_nan(blocks: Blocks, name: str, like: _Array) -> _Array:
    """Return a signal; NaN in the shape of ``like`` if the recording does not contain the signal."""
    return blocks[name] if name in blocks else np.full(like.shape, math.nan)


def _diagonal_covariances(variances: _Array) -> _Array:
    """Return variances (n, k) as flat row-major matrices (n, k * k); unknown ones are zero."""
    n, k = variances.shape
    out = np.zeros((n, k, k))
    out[:, range(k), range(k)] = np.nan_to_num(variances, nan=0.0)
    return out.reshape(n, k * k)


def _make_odometry_encoder(prefix: str) -> Callable[[Blocks, RangeSensorGeometry], Columns]:
    def encode_odometry(blocks: Blocks, _: RangeSensorGeometry) -> Columns:
        position = blocks[f"{prefix}_position"]
        velocity, attitude, rates = (
            _signal_or_nan(blocks, f"{prefix}_{n}", position) for n in ("velocity", "attitude", "rates")
        )
        sigma = {
            n: np.nan_to_num(_signal_or_nan(blocks, f"{prefix}_{n}_sigma", position), nan=0.0)
            for n in ("position", "velocity", "attitude", "rates")
        }
        turn = body_to_ned_matrices(np.nan_to_num(attitude, nan=0.0))
        to_base = _FRD_TO_FLU_SIGNS[:, None] * turn.transpose(0, 2, 1)  # N-E-D to base_link
        twist = np.zeros((len(position), 6, 6))
        twist[:, :3, :3] = (to_base * (sigma["velocity"] ** 2)[:, None, :]) @ to_base.transpose(0, 2, 1)
        twist[:, range(3, 6), range(3, 6)] = sigma["rates"] ** 2
        pose_variance = np.hstack((sigma["position"][:, [1, 0, 2]] ** 2, sigma["attitude"] ** 2))
        return {
            "header": _header_message(MAP_FRAME),
            "child_frame_id": BODY_FRAME,
            "pose": {
                "pose": {
                    "position": _vector_message(ned_to_enu(position)),
                    "orientation": _orientation_message(attitude),
                },
                "covariance": _diagonal_covariances(pose_variance),
            },
            "twist": {
                "twist": {
                    "linear": _vector_message(np.einsum("nij,nj->ni", to_base, velocity)),
                    "angular": _vector_message(body_frd_to_flu(rates)),
                },
                "covariance": twist.reshape(-1, 36),
            },
        }

    return encode_odometry


def _make_transform_encoder(prefix: str) -> Callable[[Blocks, RangeSensorGeometry], Columns]:
    def encode_transform(blocks: Blocks, _: RangeSensorGeometry) -> Columns:
        position = blocks[f"{prefix}_position"]
        transform = {
            "header": _header_message(MAP_FRAME),
            "child_frame_id": BODY_FRAME,
            "transform": {
                "translation": _vector_message(ned_to_enu(position)),
                "rotation": _orientation_message(_signal_or_nan(blocks, f"{prefix}_attitude", position)),
            },
        }
        return {"transforms": [transform]}

    return encode_transform


def _encode_imu(blocks: Blocks, _: RangeSensorGeometry) -> Columns:
    unknown = np.zeros(9)
    unknown[0] = -1.0  # no orientation (sensor_msgs/Imu)
    force = blocks["measured_acceleration"]
    return {
        "header": _header_message(BODY_FRAME),
        "orientation": {"w": 1.0},
        "orientation_covariance": np.tile(unknown, (len(force), 1)),
        "angular_velocity": _vector_message(body_frd_to_flu(_signal_or_nan(blocks, "measured_rates", force))),
        "linear_acceleration": _vector_message(body_frd_to_flu(force)),
    }


def _encode_sonar(blocks: Blocks, limits: RangeSensorGeometry) -> Columns:
    return {
        "header": _header_message("sonar_link"),
        "radiation_type": _RANGE_TYPE_ULTRASOUND,
        "field_of_view": limits.sonar_cone_rad,
        "min_range": limits.sonar_min_m,
        "max_range": limits.sonar_max_m,
        "range": blocks["measured_ground_distance"][:, 0],
    }


def _make_scan_encoder(signal: str) -> Callable[[Blocks, RangeSensorGeometry], Columns]:
    def encode_scan(blocks: Blocks, limits: RangeSensorGeometry) -> Columns:
        distances = blocks[signal]
        count = distances.shape[1]
        step = 2.0 * math.pi / count
        return {
            "header": _header_message(BODY_FRAME),
            "angle_min": -limits.first_beam_rad,
            "angle_max": -limits.first_beam_rad + (count - 1) * step,
            "angle_increment": step,
            "range_min": limits.ring_min_m,
            "range_max": limits.ring_max_m,
            "ranges": distances[:, _reverse_beams(count)],
        }

    return encode_scan


def _reverse_beams(count: int) -> NDArray[np.int64]:
    """Return the indices that convert beams counted to the right to the order of a LaserScan (to the left).

    The permutation is its own inverse.
    """
    return -np.arange(count) % count


def _encode_battery(blocks: Blocks, _: RangeSensorGeometry) -> Columns:
    voltage = blocks["battery_voltage"]
    unknown = dict.fromkeys(("temperature", "charge", "capacity", "design_capacity"), math.nan)
    return {
        "header": _header_message(BODY_FRAME),
        "voltage": voltage[:, 0],
        "current": -_signal_or_nan(blocks, "battery_current", voltage)[:, 0],  # negative when discharging
        "percentage": _signal_or_nan(blocks, "battery_charge", voltage)[:, 0],
        "power_supply_status": _BATTERY_STATUS_DISCHARGING,
        "power_supply_technology": _BATTERY_TYPE_LITHIUM_POLYMER,
        "present": True,
        **unknown,
    }


def _encode_pose_setpoint(blocks: Blocks, _: RangeSensorGeometry) -> Columns:
    position = blocks["reference_position"]
    attitude = _signal_or_nan(blocks, "reference_attitude", position)
    return {
        "header": _header_message(MAP_FRAME),
        "pose": {"position": _vector_message(ned_to_enu(position)), "orientation": _orientation_message(attitude)},
    }


def _encode_velocity_setpoint(blocks: Blocks, _: RangeSensorGeometry) -> Columns:
    return {
        "header": _header_message(MAP_FRAME),
        "twist": {"linear": _vector_message(ned_to_enu(blocks["reference_velocity"]))},
    }


def _encode_fix(blocks: Blocks, _: RangeSensorGeometry) -> Columns:
    fix = blocks["measured_position_fix"]
    level = np.zeros((len(fix), 2))
    variance = _signal_or_nan(blocks, "measured_position_fix_variance", fix)[:, _ENU_VARIANCE_ORDER]
    return {
        "header": _header_message(MAP_FRAME),
        "pose": {
            "pose": {
                "position": _vector_message(ned_to_enu(fix[:, :3])),
                "orientation": _orientation_message(np.column_stack((level, fix[:, _FIX_HEADING_ROW]))),
            },
            "covariance": _diagonal_covariances(
                np.column_stack((variance[:, :3], level, variance[:, _FIX_HEADING_ROW]))
            ),
        },
    }


def _encode_magnetic_field(blocks: Blocks, _: RangeSensorGeometry) -> Columns:
    field = body_frd_to_flu(blocks["measured_magnetic_field"])
    return {"header": _header_message(BODY_FRAME), "magnetic_field": _vector_message(field)}


def _encode_pressure(blocks: Blocks, _: RangeSensorGeometry) -> Columns:
    return {"header": _header_message(BODY_FRAME), "fluid_pressure": blocks["measured_pressure"][:, 0]}


def _encode_rotors(blocks: Blocks, _: RangeSensorGeometry) -> Columns:
    return {
        "header": _header_message(BODY_FRAME),
        "name": ["rotor_upper", "rotor_lower"],
        "velocity": blocks["measured_rotor_speed"],
    }


def _encode_actuators(blocks: Blocks, _: RangeSensorGeometry) -> Columns:
    return {"data": np.hstack((blocks["motor_input"], blocks["servo_input"]))}


_ODOMETRY_TYPE, _SCAN_TYPE = "nav_msgs/msg/Odometry", "sensor_msgs/msg/LaserScan"
_TRANSFORMS_TYPE = "tf2_msgs/msg/TFMessage"
ROS_TOPICS: tuple[RosTopic, ...] = (
    *(
        RosTopic(name, _ODOMETRY_TYPE, f"{prefix}_position", _make_odometry_encoder(prefix), prefix=prefix)
        for name, prefix in (("/odom", "estimated"), ("/measured/odom", "measured"), ("/ground_truth/odom", "truth"))
    ),
    RosTopic("/tf", _TRANSFORMS_TYPE, "estimated_position", _make_transform_encoder("estimated")),
    RosTopic("/tf", _TRANSFORMS_TYPE, "measured_position", _make_transform_encoder("measured")),
    RosTopic(
        "/imu/data_raw", "sensor_msgs/msg/Imu", "measured_acceleration", _encode_imu,
        "measured_acceleration_time", "measured_acceleration_valid", 200.0, "measured",
    ),
    RosTopic(
        "/range/ground", "sensor_msgs/msg/Range", "measured_ground_distance", _encode_sonar,
        "measured_ground_distance_time", "measured_ground_distance_valid", prefix="measured_ground_distance",
    ),
    RosTopic(
        "/scan", _SCAN_TYPE, "measured_ranges", _make_scan_encoder("measured_ranges"),
        "measured_ranges_time", "measured_ranges_valid", prefix="measured_ranges",
    ),
    RosTopic("/obstacles/scan", _SCAN_TYPE, "range", _make_scan_encoder("range"), live_rate_Hz=25.0, prefix="range"),
    RosTopic(
        "/pose_fix", "geometry_msgs/msg/PoseWithCovarianceStamped", "measured_position_fix", _encode_fix,
        "measured_position_fix_time", "measured_position_fix_valid", prefix="measured",
    ),
    RosTopic(
        "/imu/mag", "sensor_msgs/msg/MagneticField", "measured_magnetic_field", _encode_magnetic_field,
        "measured_magnetic_field_time", "measured_magnetic_field_valid", prefix="measured_magnetic_field",
    ),
    RosTopic(
        "/pressure", "sensor_msgs/msg/FluidPressure", "measured_pressure", _encode_pressure,
        "measured_pressure_time", "measured_pressure_valid", prefix="measured_pressure",
    ),
    RosTopic(
        "/joint_states", "sensor_msgs/msg/JointState", "measured_rotor_speed", _encode_rotors,
        "measured_rotor_speed_time", "measured_rotor_speed_valid", prefix="measured_rotor_speed",
    ),
    RosTopic("/battery_state", "sensor_msgs/msg/BatteryState", "battery_voltage", _encode_battery, live_rate_Hz=2.0),
    RosTopic("/setpoint_pose", "geometry_msgs/msg/PoseStamped", "reference_position", _encode_pose_setpoint,
             live_rate_Hz=10.0, prefix="reference"),
    RosTopic("/setpoint_velocity", "geometry_msgs/msg/TwistStamped", "reference_velocity", _encode_velocity_setpoint,
             live_rate_Hz=10.0, prefix="reference"),
    RosTopic("/actuators", "std_msgs/msg/Float64MultiArray", "motor_input", _encode_actuators, live_rate_Hz=10.0),
)  # fmt: skip
"""Topics of a flight; a topic's second row is used if the signal of the first is missing. Rotor speeds and actuators
are in the order upper, lower, servo 1, servo 2."""
STATE_TOPIC, STATE_TYPE = "/mission_state", "std_msgs/msg/String"
EVENT_TOPIC, EVENT_TYPE = "/rosout", "rcl_interfaces/msg/Log"
IMAGE_TOPIC, IMAGE_TYPE = "/camera/image/compressed", "sensor_msgs/msg/CompressedImage"
EVENT_LEVELS = {"info": 20, "warning": 30, "error": 40}
"""Levels of rcl_interfaces/Log."""


def select_ros_topics(names: Mapping[str, Any]) -> list[RosTopic]:
    """Return the entries of :data:`ROS_TOPICS` that a recording with these signals fills, one for each topic."""
    found: dict[str, RosTopic] = {}
    for topic in ROS_TOPICS:
        if topic.signal in names:
            found.setdefault(topic.name, topic)
    return list(found.values())


def find_rows_for_topic(topic: RosTopic, blocks: Blocks) -> NDArray[np.int64]:
    """Return the indices of the recording's rows that contain data for a message of a topic."""
    there = np.isfinite(blocks[topic.signal]).all(axis=1)
    if topic.valid_signal in blocks:
        there &= blocks[topic.valid_signal][:, 0] > 0.5
    return np.flatnonzero(there)


def compute_stamp_times_ns(topic: RosTopic, blocks: Blocks, time_s: _Array, start_ns: int) -> NDArray[np.int64]:
    """Return the stamps of rows (ns since 1970): the time of measurement where it is known, else that of the row."""
    when = blocks[topic.time_signal][:, 0] if topic.time_signal in blocks else time_s
    return np.rint(np.where(np.isfinite(when), when, time_s) * NANOSECONDS_PER_SECOND).astype(np.int64) + start_ns


def extract_row_message(columns: Any, k: int) -> Any:
    """Return the message at row ``k`` from columns over time, as nested dictionaries of numbers, texts and lists."""
    if isinstance(columns, dict):
        return {name: extract_row_message(value, k) for name, value in columns.items()}
    if isinstance(columns, np.ndarray):
        return columns[k] if columns.ndim > 1 else float(columns[k])
    if isinstance(columns, list):
        return [extract_row_message(value, k) if isinstance(value, dict) else value for value in columns]
    return columns


def stamp_message(message: dict[str, Any], time_ns: int) -> None:
    """Set the time stamps of a message and of the messages inside it."""
    if "header" in message:
        message["header"]["stamp"] = {
            "sec": time_ns // NANOSECONDS_PER_SECOND,
            "nanosec": time_ns % NANOSECONDS_PER_SECOND,
        }
    for inner in message.get("transforms", ()):
        stamp_message(inner, time_ns)


# ----------------------------------------------------------------------------
# From messages to signals: fields of a topic by name (``pose.pose.position.x``) to columns in N-E-D and body axes.


Fields = Mapping[str, NDArray[Any]]


def _stack_field_columns(fields: Fields, stem: str, parts: Sequence[str] = "xyz") -> _Array | None:
    names = [f"{stem}{p}" for p in parts]
    if not all(n in fields for n in names):
        return None
    return np.column_stack([fields[n].astype(np.float64) for n in names])


def _decode_attitude(fields: Fields, stem: str) -> _Array | None:
    quaternion = _stack_field_columns(fields, stem, "wxyz")
    if quaternion is None:
        return None
    attitude = attitude_to_ros(euler_from_unnormalised_quaternion(quaternion))
    attitude[:, 2] = np.remainder(attitude[:, 2] + math.pi, 2.0 * math.pi) - math.pi
    return attitude


def _decode_covariance(fields: Fields, stem: str, first: int) -> _Array | None:
    """Return the blocks (n, 3, 3) from row and column ``first`` of n (6, 6) covariances; None if all are unknown."""
    names = [f"{stem}[{6 * (first + i) + first + j}]" for i in range(3) for j in range(3)]
    if not all(n in fields for n in names):
        return None
    block = np.column_stack([fields[n].astype(np.float64) for n in names]).reshape(-1, 3, 3)
    return block if (block[:, range(3), range(3)] > 0.0).any() else None


def _standard_deviation(covariance: _Array | None, order: tuple[int, int, int] = (0, 1, 2)) -> _Array | None:
    return None if covariance is None else np.sqrt(covariance[:, order, order])


def _decode_odometry(fields: Fields, prefix: str) -> dict[str, _Array | None]:
    position = _stack_field_columns(fields, "pose.pose.position.")
    attitude = _decode_attitude(fields, "pose.pose.orientation.")
    speed, rates = (
        _stack_field_columns(fields, "twist.twist.linear."),
        _stack_field_columns(fields, "twist.twist.angular."),
    )
    out: dict[str, _Array | None] = {
        f"{prefix}_position": None if position is None else ned_to_enu(position),
        f"{prefix}_attitude": attitude,
        f"{prefix}_rates": None if rates is None else body_frd_to_flu(rates),
        f"{prefix}_position_sigma": _standard_deviation(_decode_covariance(fields, "pose.covariance", 0), (1, 0, 2)),
        f"{prefix}_attitude_sigma": _standard_deviation(_decode_covariance(fields, "pose.covariance", 3)),
        f"{prefix}_rates_sigma": _standard_deviation(_decode_covariance(fields, "twist.covariance", 3)),
    }
    if attitude is not None and speed is not None:
        to_ned = body_to_ned_matrices(attitude) * _FRD_TO_FLU_SIGNS
        out[f"{prefix}_velocity"] = np.einsum("nij,nj->ni", to_ned, speed)
        covariance = _decode_covariance(fields, "twist.covariance", 0)
        if covariance is not None:
            out[f"{prefix}_velocity_sigma"] = _standard_deviation(to_ned @ covariance @ to_ned.transpose(0, 2, 1))
    return out


def _decode_imu(fields: Fields, prefix: str) -> dict[str, _Array | None]:
    force, rates = (
        _stack_field_columns(fields, "linear_acceleration."),
        _stack_field_columns(fields, "angular_velocity."),
    )
    out = {
        f"{prefix}_acceleration": None if force is None else body_frd_to_flu(force),
        f"{prefix}_rates": None if rates is None else body_frd_to_flu(rates),
    }
    if "orientation_covariance[0]" in fields and not (fields["orientation_covariance[0]"] == -1.0).any():
        out[f"{prefix}_attitude"] = _decode_attitude(fields, "orientation.")
    return out


def _decode_pose(fields: Fields, prefix: str) -> dict[str, _Array | None]:
    position = _stack_field_columns(fields, "pose.position.")
    return {
        f"{prefix}_position": None if position is None else ned_to_enu(position),
        f"{prefix}_attitude": _decode_attitude(fields, "pose.orientation."),
    }


def _decode_fix(fields: Fields, prefix: str) -> dict[str, _Array | None]:
    position = _stack_field_columns(fields, "pose.pose.position.")
    attitude = _decode_attitude(fields, "pose.pose.orientation.")
    if position is None or attitude is None:
        return {}
    return {f"{prefix}_position_fix": np.column_stack((ned_to_enu(position), attitude[:, 2]))}


def _decode_twist(fields: Fields, prefix: str) -> dict[str, _Array | None]:
    velocity = _stack_field_columns(fields, "twist.linear.")
    return {f"{prefix}_velocity": None if velocity is None else ned_to_enu(velocity)}


def _decode_scan(fields: Fields, prefix: str) -> dict[str, _Array | None]:
    names = [n for n in fields if n.startswith("ranges[")]
    step = fields["angle_increment"].astype(np.float64) if "angle_increment" in fields else np.zeros(1)
    if not 0 < len(names) <= _MAX_RING_BEAMS or abs(float(step[0]) * len(names) - 2.0 * math.pi) > 1e-3:
        return {}  # no ring
    ranges = np.column_stack([fields[n].astype(np.float64) for n in names])
    return {prefix: ranges[:, _reverse_beams(len(names))]}


def _decode_battery(fields: Fields, prefix: str) -> dict[str, _Array | None]:
    signs = {"voltage": ("battery_voltage", 1.0), "current": ("battery_current", -1.0),
             "percentage": ("battery_charge", 1.0)}  # fmt: skip
    return {
        ours: sign * fields[name].astype(np.float64)[:, None] for name, (ours, sign) in signs.items() if name in fields
    }


def _decode_actuators(fields: Fields, prefix: str) -> dict[str, _Array | None]:
    inputs = _stack_field_columns(fields, "data[", ("0]", "1]", "2]", "3]"))
    return {} if inputs is None else {"motor_input": inputs[:, :2], "servo_input": inputs[:, 2:]}


def _decode_rotors(fields: Fields, prefix: str) -> dict[str, _Array | None]:
    return {prefix: _stack_field_columns(fields, "velocity[", ("0]", "1]"))}


def _make_scalar_decoder(field: str) -> Callable[[Fields, str], dict[str, _Array | None]]:
    return lambda fields, prefix: {prefix: fields[field].astype(np.float64)[:, None]} if field in fields else {}


def _decode_magnetic_field(fields: Fields, prefix: str) -> dict[str, _Array | None]:
    field = _stack_field_columns(fields, "magnetic_field.")
    return {prefix: None if field is None else body_frd_to_flu(field)}


class RosDecoder(NamedTuple):
    """Decoder of a ROS message type: conversion of its fields to signals.

    In topics of other programs the signals' names begin with ``foreign_prefix``.
    """

    decode: Callable[[Fields, str], dict[str, _Array | None]]
    foreign_prefix: str


ROS_DECODERS: dict[str, RosDecoder] = {
    _ODOMETRY_TYPE: RosDecoder(_decode_odometry, "measured"),
    "sensor_msgs/msg/Imu": RosDecoder(_decode_imu, "measured"),
    "sensor_msgs/msg/Range": RosDecoder(_make_scalar_decoder("range"), "measured_ground_distance"),
    _SCAN_TYPE: RosDecoder(_decode_scan, "measured_ranges"),
    "geometry_msgs/msg/PoseWithCovarianceStamped": RosDecoder(_decode_fix, "measured"),
    "geometry_msgs/msg/PoseStamped": RosDecoder(_decode_pose, "measured"),
    "geometry_msgs/msg/TwistStamped": RosDecoder(_decode_twist, "measured"),
    "sensor_msgs/msg/MagneticField": RosDecoder(_decode_magnetic_field, "measured_magnetic_field"),
    "sensor_msgs/msg/FluidPressure": RosDecoder(_make_scalar_decoder("fluid_pressure"), "measured_pressure"),
    "sensor_msgs/msg/BatteryState": RosDecoder(_decode_battery, ""),
    "sensor_msgs/msg/JointState": RosDecoder(_decode_rotors, ""),
    "std_msgs/msg/Float64MultiArray": RosDecoder(_decode_actuators, ""),
}
"""Decoders by message type. Joints and arrays have a meaning only in topics of the table."""


def decode_fields(topic: str, message_type: str, fields: Fields, *, ours: bool) -> dict[str, _Array]:
    """Return the signals in the messages of a topic.

    Parameters
    ----------
    topic, message_type : str
    fields : mapping of str to (n,) array
        Fields by name, ``pose.pose.position.x``, ``ranges[0]``.
    ours : bool
        Whether mufly wrote the messages; those of another program count as measured.

    Returns
    -------
    dict of str to (n, components) array
        Signals by name, in N-E-D and body axes.
    """
    decoder = ROS_DECODERS.get(message_type)
    row = next((t for t in ROS_TOPICS if t.name == topic), None) if ours else None
    if decoder is None or (ours and row is None):
        return {}
    if not ours and message_type in ("sensor_msgs/msg/JointState", "std_msgs/msg/Float64MultiArray"):
        return {}
    found = decoder.decode(fields, row.prefix if row is not None else decoder.foreign_prefix)
    return {name: values for name, values in found.items() if values is not None}
