"""Conversion of a vehicle's messages to signals: rows of a history and present values.

Every message sets the signals that it contains. A row is finished when a message has a later time stamp, so that one
row holds the vehicle's measurements of one instant. The present values are a
:class:`mufly.station.signal_history.PresentSignals`. Fields that equal a quantity up to its unit are mapped by the
table of quantities (:func:`mufly.quantities.quantity_table.list_mavlink_field_columns`). Messages with variable meaning
(masks,
quaternions, rings of beams) have readers here. Source of fields and units: https://mavlink.io/en/messages/common.html.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from mufly.dynamics import body_to_ned_matrix
from mufly.link.codec import GlobalOrigin, MavMessage
from mufly.link.estimate_messages import CHECKS_ARRAY_NAME, TEST_RATIOS
from mufly.link.telemetry_streams import MISSION_STATES, OVERRUN_COUNT_NAME, REAL_TIME_FACTOR_NAME
from mufly.quantities.quantity_table import (
    READINGS_WITH_FUSION_STATUS,
    list_mavlink_field_columns,
    quantities_recorded_in,
)
from mufly.rotations import euler_from_quaternion
from mufly.station.signal_history import SLOW_SIGNAL_TIMEOUT_S, PresentSignals, SignalHistory, make_unknown_values
from mufly.vehicle_types import flight_mode_name

ROW_MERGE_S = 0.009
"""Messages with stamps closer than this share a row, with the first stamp as its time (s).

Stamps of messages of the same instant may differ by a tick or two. The tlog has every packet.
"""
_ROW_TIMEOUT_S = 0.05
_STALE_CHECK_PERIOD_S = 0.25
_STATE_TIMEOUT_S = 3.0
_NEAR_POLE_LATITUDE_DEG = 89.0  # beyond this latitude, east is undefined
_TYPE_COAXIAL, _FLAG_ARMED = 3, 128  # MAV_TYPE, MAV_MODE_FLAG
_BODY_FRAME = 12  # MAV_FRAME_BODY_FRD
_OLD_BODY_FRAME = 8  # MAV_FRAME_BODY_NED, in messages of older PX4 versions
_LEVEL_MAV_FRAMES = (1, 20)  # MAV_FRAME_LOCAL_NED; MAV_FRAME_LOCAL_FRD, also level
_COVARIANCE_DIAGONAL_INDICES = (0, 6, 11, 15, 18, 20)  # diagonal in a 6 x 6 upper triangle, row by row
_COVARIANCE_XX_TO_XZ, _COVARIANCE_YY_TO_YZ, _COVARIANCE_ZZ = slice(0, 3), slice(6, 8), 11  # its first 3 x 3 block
_MISSING_ESTIMATE_FLAGS = ((1, "attitude"), (2, "velocity"), (32, "height"), (8 | 16, "position"))
_FAULT_FLAGS = ((1024, "GPS glitch"), (2048, "accelerometer error"), (128, "constant position mode"))
"""ESTIMATOR_STATUS_FLAGS: estimates missing if unset, faults if set."""
_UNKNOWN_UINT16 = 65535
_TRUTH_VARIABLES = tuple(q.name for q in quantities_recorded_in("flight") if q.topic == "/truth")

_STAMP_FIELDS: dict[str, tuple[str, int]] = {
    **dict.fromkeys(("ATTITUDE", "ATTITUDE_QUATERNION", "ATTITUDE_TARGET"), ("time_boot_ms", 1)),
    **dict.fromkeys(("LOCAL_POSITION_NED", "GLOBAL_POSITION_INT"), ("time_boot_ms", 1)),
    "POSITION_TARGET_LOCAL_NED": ("time_boot_ms", 1),
    "VISION_POSITION_ESTIMATE": ("usec", 1000),
    **dict.fromkeys(
        ("ACTUATOR_OUTPUT_STATUS", "OBSTACLE_DISTANCE", "DEBUG_FLOAT_ARRAY", "ODOMETRY"), ("time_usec", 1000)
    ),
}
"""Messages that begin rows: their stamp field, and its ticks per millisecond."""

TABLE_MESSAGES: dict[str, tuple[str, int]] = {
    "ATTITUDE": ("attitude", 0),
    "LOCAL_POSITION_NED": ("position", 0),
    "VISION_POSITION_ESTIMATE": ("measured", 0),
    "RC_CHANNELS": ("pilot", 0),
    "RC_CHANNELS_RAW": ("pilot", 1),
}
"""Messages decoded by the table of quantities: their signal group and rank. Of several messages with the same group,
the one with the lowest rank is used as long as it arrives."""

_Array = NDArray[np.float64]
_VariableValues = Mapping[str, Sequence[float]] | None
"""Values of variables; None: the message has none."""


class VehicleTelemetry:
    """Signals of one vehicle from its telemetry: history and present values.

    Attributes
    ----------
    history : SignalHistory
    clock : MonotonicVehicleClock
    armed : bool
    landed_state : int
        MAV_LANDED_STATE; 0 is unknown.
    autopilot, vehicle_type : int
        MAV_AUTOPILOT, MAV_TYPE.
    ranges : BeamRanges
    battery_left_s : float
        Remaining battery time (s).
    mission_current : int or None
        Sequence number of the current mission item.
    mission_state : int
        MISSION_STATE; 0 is unknown.
    commander_id : int or None
        system * 256 + component; 0 none, None unknown.
    health : tuple of int or None
        Sensors present, enabled, healthy, from SYS_STATUS.
    is_simulated : bool
        Whether the vehicle publishes true values, which only a simulation has.
    origin : GlobalOrigin or None
        Global position of N, E, D = 0.
    slip_count : int or None
        Number of time skips of a real-time simulation.
    estimator_status : EstimatorStatus or None
        Status of the estimator from ESTIMATOR_STATUS.
    """

    def __init__(self, history: SignalHistory | None = None) -> None:
        self.history = SignalHistory() if history is None else history
        self.clock = MonotonicVehicleClock()
        self.armed = False
        self.landed_state = self.autopilot = self.vehicle_type = 0
        self.mode = ""
        self.ranges = BeamRanges()
        self.battery_left_s = math.nan
        self.mission_current: int | None = None
        self.mission_state = 0
        self.commander_id: int | None = None
        self.health: tuple[int, int, int] | None = None
        self.is_simulated = False
        self.origin: GlobalOrigin | None = None
        self.slip_count: int | None = None
        self.estimator_status: EstimatorStatus | None = None
        self._factor: tuple[float, float] = (math.nan, -math.inf)  # real-time factor received, and its time
        self.on_row: Callable[[float, _Array, str], None] | None = None
        self._present = PresentSignals(self.history)
        self._own_state: tuple[str, float] = ("", -math.inf)
        self._stamps: dict[str, float] = {}
        self._row_s = math.nan
        self._row_now_s = self._swept_s = self._heard_s = -math.inf
        index = self._present.index_by_signal
        self._plain = {
            name: [(f, index[signal], x) for f, signal, x in list_mavlink_field_columns(name)]
            for name in TABLE_MESSAGES
        }
        # Signal group, rank and reader of each message.
        self._read: dict[str, tuple[str, int, Callable[[MavMessage], _VariableValues]]] = {
            "ATTITUDE_QUATERNION": ("attitude", 1, self._read_quaternion),
            "GLOBAL_POSITION_INT": ("position", 1, self._read_global_position),
            "SYS_STATUS": ("battery", 1, self._read_sys_status),
            "BATTERY_STATUS": ("battery", 0, self._read_battery),
            "POSITION_TARGET_LOCAL_NED": ("reference", 0, self._read_position_target),
            "ATTITUDE_TARGET": ("reference_attitude", 0, self._read_attitude_target),
            "ACTUATOR_OUTPUT_STATUS": ("actuators", 0, self._read_actuators),
            "SERVO_OUTPUT_RAW": ("actuators", 1, self._read_servo_outputs),
            "DEBUG_FLOAT_ARRAY": ("truth", 0, self._read_debug_array),
            "ODOMETRY": ("odometry", 0, self._read_odometry),
        }
        self._note: dict[str, Callable[[float, MavMessage], None]] = {
            "HEARTBEAT": self._read_heartbeat,
            "EXTENDED_SYS_STATE": self._read_extended_state,
            "GPS_GLOBAL_ORIGIN": self._read_global_origin,
            "HOME_POSITION": self._read_home,
            "RAW_RPM": self._read_rpm,
            "OBSTACLE_DISTANCE": self._read_obstacle_distance,
            "DISTANCE_SENSOR": self._read_distance_sensor,
            "NAMED_VALUE_INT": self._read_named_int,
            "NAMED_VALUE_FLOAT": self._read_named_float,
            "MISSION_CURRENT": self._read_mission_current,
            "ESTIMATOR_STATUS": self._read_estimator_status,
        }

    def handle_message(self, now_s: float, message: MavMessage) -> None:
        """Process a message of the vehicle's autopilot; messages without signals are ignored.

        Parameters
        ----------
        now_s : float
            Station's clock (s).
        message : pymavlink message
        """
        name, present, self._heard_s = message.get_type(), self._present, now_s
        if name in _STAMP_FIELDS and not self._is_in_order(now_s, name, message):
            return
        if name in TABLE_MESSAGES:
            group, rank = TABLE_MESSAGES[name]
            if present.accept_message(now_s, group, rank):
                for field_, k, factor in self._plain[name]:
                    value = getattr(message, field_)
                    known = group != "pilot" or value != _UNKNOWN_UINT16
                    present.set_value(group, k, value * factor if known else math.nan)
        elif name in self._read:
            group, rank, read = self._read[name]
            told = read(message)
            if told is not None and present.accept_message(now_s, group, rank):
                for variable, values in told.items():
                    present.set_variable(group, variable, values)
        elif name in self._note:
            self._note[name](now_s, message)

    def clear_expired_signals(self, now_s: float) -> None:
        """Complete the history's pending row if it is overdue, and clear expired signals."""
        if not math.isnan(self._row_s) and now_s - self._row_now_s > _ROW_TIMEOUT_S:
            self._finish_row()
        if now_s - self._swept_s >= _STALE_CHECK_PERIOD_S:
            self._swept_s = now_s
            if "ranges" in self._present.forget_stale(now_s):
                self.ranges = BeamRanges()

    def switch_component(self) -> None:
        """Switch to another MAVLink component of the vehicle, which has its own clock; the history continues."""
        self.clock.realign_at_next_stamp()
        self._stamps.clear()
        self.mission_current, self.mission_state, self.commander_id = None, 0, None

    def store_link_quality(self, now_s: float, loss: float, rate_Hz: float) -> None:
        """Set the signals of the link quality."""
        self._present.accept_message(now_s, "link")
        self._present.set_variable("link", "link_loss", (loss,))
        self._present.set_variable("link", "link_rate", (rate_Hz,))

    def present_value(self, name: str) -> _Array:
        """Return the present value of a variable (``"estimated_position"``), NaN if unknown."""
        return self._present[name]

    @property
    def time_s(self) -> float:
        """Return the vehicle's clock (s)."""
        return self.clock.time_s

    def real_time_factor(self, now_s: float) -> float:
        """Return recent seconds of the vehicle's clock per station second, as published or from its stamps."""
        told, told_s = self._factor
        return told if now_s - told_s <= SLOW_SIGNAL_TIMEOUT_S else self.clock.clock_rate_ratio(now_s)

    @property
    def is_flying(self) -> bool:
        """Return whether the vehicle is airborne, from its landed state or its height."""
        if self.landed_state:
            return self.landed_state != 1
        return bool(self.armed and self.present_value("estimated_position")[2] < -0.1)

    @property
    def mission_state_or_mode(self) -> str:
        """Return the state of a mufly mission machine, else the flight mode."""
        return self._own_state[0] or self.mode

    # Rows

    def _is_in_order(self, now_s: float, name: str, message: MavMessage) -> bool:
        """Return whether a message is not older than the last of its kind; begin a row of the history at its stamp."""
        stamp, tick = _STAMP_FIELDS[name]
        boot_ms = getattr(message, stamp) // tick
        if tick > 1 and not self.clock.matches_stamp(boot_ms):
            return True  # some vehicles use the time of day as stamp
        time_s = self.clock.to_monotonic_time(boot_ms, now_s)
        if math.isnan(time_s) or time_s < self._stamps.get(name, -math.inf):
            return False
        self._stamps[name] = time_s
        if time_s - self._row_s > ROW_MERGE_S:
            self._finish_row()
        if math.isnan(self._row_s):
            self._row_s, self._row_now_s = time_s, now_s
        return True

    def _finish_row(self) -> None:
        with np.errstate(over="ignore"):  # an absurd number becomes infinite and is not drawn
            row = self._present.values.astype(np.float32)
        if self._row_s > self.history.newest_s or not len(self.history):
            self.history.append_row(self._row_s, row)
            if self.on_row is not None:
                self.on_row(self._row_s, self._present.values, self.mission_state_or_mode)
        self._row_s = math.nan

    # Readers: message to values of variables

    def _read_quaternion(self, m: MavMessage) -> _VariableValues:
        rates = (m.rollspeed, m.pitchspeed, m.yawspeed)
        return {
            "estimated_attitude": _read_euler_angles(m.q1, m.q2, m.q3, m.q4),
            "estimated_rates": rates,
        }

    def _read_global_position(self, m: MavMessage) -> _VariableValues:
        """Return position (m from the origin) and velocity; the first fix becomes the origin if there is none."""
        if (m.lat, m.lon) == (0, 0) or not _is_valid_latitude_longitude(m.lat, m.lon):
            return None  # no fix yet
        latitude, longitude = m.lat / 1e7, m.lon / 1e7
        if self.origin is None:
            self.origin = GlobalOrigin(latitude, longitude, (m.alt - m.relative_alt) / 1e3)
        return {
            "estimated_position": self.origin.to_local(latitude, longitude, m.alt / 1e3),
            "estimated_velocity": (m.vx / 100.0, m.vy / 100.0, m.vz / 100.0),
        }

    def _read_sys_status(self, m: MavMessage) -> _VariableValues:
        present, enabled = m.onboard_control_sensors_present, m.onboard_control_sensors_enabled
        self.health = present, enabled, m.onboard_control_sensors_health
        voltage = math.nan if m.voltage_battery == _UNKNOWN_UINT16 else m.voltage_battery / 1e3
        return _select_battery_values(voltage, m)

    def _read_battery(self, m: MavMessage) -> _VariableValues:
        if m.id != 0:
            return None
        cells = [v for v in (*m.voltages, *(v for v in m.voltages_ext if v)) if v != _UNKNOWN_UINT16]
        self.battery_left_s = float(m.time_remaining) if m.time_remaining > 0 else math.nan
        return _select_battery_values(sum(cells) / 1e3 if cells else math.nan, m)

    def _read_position_target(self, m: MavMessage) -> _VariableValues:
        if m.coordinate_frame != 1:
            return None
        told = enumerate((m.x, m.y, m.z, m.vx, m.vy, m.vz))
        given = [math.nan if m.type_mask >> k & 1 else v for k, v in told]
        return {"reference_position": given[:3], "reference_velocity": given[-3:]}

    def _read_attitude_target(self, m: MavMessage) -> _VariableValues:
        return {"reference_attitude": (math.nan,) * 3 if m.type_mask & 128 else _read_euler_angles(*m.q)}

    def _read_actuators(self, m: MavMessage) -> _VariableValues:
        # The output order is mufly's; outputs of other vehicles have no fixed meaning.
        if self.vehicle_type != _TYPE_COAXIAL or m.active < 4:
            return None
        upper, lower, *servos = m.actuator[:4]
        return {"motor_input": (upper, lower), "servo_input": servos}

    def _read_servo_outputs(self, m: MavMessage) -> _VariableValues:
        pulses = (m.servo1_raw, m.servo2_raw)
        return None if m.port else {"motor_input": [(p - 1000) / 1000 if p else math.nan for p in pulses]}

    def _read_odometry(self, m: MavMessage) -> _VariableValues:
        """Return the standard deviations of position, attitude and velocity, as far as their frames are supported."""
        told: dict[str, Sequence[float]] = {}
        position, attitude = _covariance_to_deviations(m.pose_covariance)
        if m.frame_id in _LEVEL_MAV_FRAMES:
            told = {"estimated_position_sigma": position, "estimated_attitude_sigma": attitude}
        if m.child_frame_id in _LEVEL_MAV_FRAMES:
            told["estimated_velocity_sigma"] = _covariance_to_deviations(m.velocity_covariance)[0]
        elif m.child_frame_id in (_BODY_FRAME, _OLD_BODY_FRAME):
            told["estimated_velocity_sigma"] = _ned_velocity_deviations(m.velocity_covariance, m.q)
        return told or None

    def _read_sensor_checks(self, m: MavMessage) -> None:
        values = list(m.data)
        for k, name in enumerate(READINGS_WITH_FUSION_STATUS):
            self._present.set_variable("checks", f"status_{name}", values[3 * k : 3 * k + 1])
            self._present.set_variable("checks", f"innovation_{name}", values[3 * k + 1 : 3 * k + 2])
        self._present.set_variable(
            "checks",
            "estimated_wind",
            values[3 * len(READINGS_WITH_FUSION_STATUS) : 3 * len(READINGS_WITH_FUSION_STATUS) + 2],
        )

    def _read_estimator_status(self, now_s: float, m: MavMessage) -> None:
        self.estimator_status = EstimatorStatus(
            now_s,
            m.flags,
            tuple((words, getattr(m, field)) for field, (_, words) in TEST_RATIOS.items()),
            m.pos_horiz_accuracy,
            m.pos_vert_accuracy,
        )

    def _read_debug_array(self, m: MavMessage) -> _VariableValues:
        if m.name == CHECKS_ARRAY_NAME.decode():
            self._present.accept_message(self._heard_s, "checks")
            self._read_sensor_checks(m)
            return None
        if m.name != "truth":
            return None
        self.is_simulated = True
        told, at = {}, 0
        for name in _TRUTH_VARIABLES:
            columns = self._present.slice_by_variable[name]
            told[name] = m.data[at : (at := at + columns.stop - columns.start)]
        return told

    # Messages with other content, or used only in part

    def _read_heartbeat(self, now_s: float, m: MavMessage) -> None:
        self.autopilot, self.vehicle_type = m.autopilot, m.type
        self.armed = bool(m.base_mode & _FLAG_ARMED)
        self.mode = flight_mode_name(m.autopilot, m.type, m.base_mode, m.custom_mode)
        if now_s - self._own_state[1] > _STATE_TIMEOUT_S:
            self._own_state = ("", -math.inf)

    def _read_extended_state(self, now_s: float, m: MavMessage) -> None:
        self.landed_state = m.landed_state

    def _read_global_origin(self, now_s: float, m: MavMessage) -> None:
        if _is_valid_latitude_longitude(m.latitude, m.longitude):
            self.origin = GlobalOrigin(m.latitude / 1e7, m.longitude / 1e7, m.altitude / 1e3)

    def _read_home(self, now_s: float, m: MavMessage) -> None:
        if self.origin is None:
            self._read_global_origin(now_s, m)

    def _read_rpm(self, now_s: float, m: MavMessage) -> None:
        if m.index in (0, 1):
            group, (field_, signal, factor) = f"rpm {m.index}", list_mavlink_field_columns("RAW_RPM")[m.index]
            self._present.accept_message(now_s, group)
            self._present.set_value(group, self._present.index_by_signal[signal], getattr(m, field_) * factor)

    def _read_obstacle_distance(self, now_s: float, m: MavMessage) -> None:
        if self._present.accept_message(now_s, "ranges"):
            self._set_ranges(decode_obstacle_distance(m, float(self.present_value("estimated_attitude")[2])))

    def _read_distance_sensor(self, now_s: float, m: MavMessage) -> None:
        if m.orientation < 8 and self._present.accept_message(now_s, "ranges", 1):
            self._set_ranges(add_distance_sensor_range(m, self.ranges))

    def _set_ranges(self, ranges: BeamRanges) -> None:
        self.ranges = ranges
        beams = len(self.present_value("range"))
        kept = ranges.distances_m if len(ranges.distances_m) <= beams else make_unknown_values(0)
        self._present.set_variable("ranges", "range", [*kept, *make_unknown_values(beams - len(kept))])

    def _read_named_int(self, now_s: float, m: MavMessage) -> None:
        if m.name == "mstate":
            known = 0 <= m.value < len(MISSION_STATES)
            self._own_state = (MISSION_STATES[m.value] if known else f"state {m.value}", now_s)
        elif m.name == "command":
            self.commander_id = m.value
        elif m.name == OVERRUN_COUNT_NAME:
            self.slip_count = m.value

    def _read_named_float(self, now_s: float, m: MavMessage) -> None:
        if m.name == REAL_TIME_FACTOR_NAME and math.isfinite(m.value):
            self._factor = (m.value, now_s)

    def _read_mission_current(self, now_s: float, m: MavMessage) -> None:
        self.mission_current, self.mission_state = m.seq, m.mission_state


@dataclass(frozen=True, slots=True)
class EstimatorStatus:
    """Status of an estimator (ESTIMATOR_STATUS).

    Attributes
    ----------
    last_heard_s : float
        Time of the message by the station's clock (s).
    flags : int
        ESTIMATOR_STATUS_FLAGS.
    innovation_ratios : tuple of (str, float)
        Measurement and its test ratio: above 1 it is rejected; 0 means not measured.
    horizontal_accuracy_m, vertical_accuracy_m : float
        Accuracy of the position (m, 1 sigma).
    """

    last_heard_s: float
    flags: int
    innovation_ratios: tuple[tuple[str, float], ...]
    horizontal_accuracy_m: float
    vertical_accuracy_m: float

    @property
    def missing_estimates(self) -> tuple[str, ...]:
        """Return the names of the missing estimates."""
        return tuple(words for flags, words in _MISSING_ESTIMATE_FLAGS if not self.flags & flags)

    @property
    def fault_texts(self) -> tuple[str, ...]:
        """Return descriptions of faults and rejected measurements."""
        return (
            *(words for flag, words in _FAULT_FLAGS if self.flags & flag),
            *(f"{name} rejected" for name, ratio in self.innovation_ratios if ratio > 1.0),
        )


def _covariance_to_deviations(upper: Sequence[float]) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """Return standard deviations of states 1 to 3 and 4 to 6 from a covariance's upper triangle; NaN if missing."""
    if len(upper) != 21 or math.isnan(upper[0]):
        return (math.nan,) * 3, (math.nan,) * 3
    told = [math.sqrt(upper[k]) if upper[k] >= 0.0 else math.nan for k in _COVARIANCE_DIAGONAL_INDICES]
    return tuple(told[:3]), tuple(told[-3:])


def _ned_velocity_deviations(upper: Sequence[float], q: Sequence[float]) -> tuple[float, ...]:
    """Return N, E, D standard deviations of a velocity with covariance in body axes; NaN if missing."""
    size = math.sqrt(sum(v * v for v in q))
    if len(upper) != 21 or math.isnan(upper[0]) or not 0.5 < size < 2.0:
        return (math.nan,) * 3
    (xx, xy, xz), (yy, yz), zz = upper[_COVARIANCE_XX_TO_XZ], upper[_COVARIANCE_YY_TO_YZ], upper[_COVARIANCE_ZZ]
    own = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    turn = body_to_ned_matrix(np.array(q, dtype=np.float64) / size)
    with np.errstate(all="ignore"):
        told: _Array = np.sqrt(np.diag(turn @ own @ turn.T))
    return tuple(told.tolist())


def _select_battery_values(voltage: float, m: MavMessage) -> _VariableValues:
    current, percent = m.current_battery, m.battery_remaining
    return {
        "battery_voltage": (voltage,),
        "battery_current": (math.nan if current < 0 else current / 100.0,),
        "battery_charge": (math.nan if percent < 0 else percent / 100.0,),
    }


def _is_valid_latitude_longitude(latitude_e7: int, longitude_e7: int) -> bool:
    """Return whether latitude and longitude (1e-7 deg) are in range: messages may hold any value."""
    return abs(latitude_e7) <= _NEAR_POLE_LATITUDE_DEG * 1e7 and abs(longitude_e7) <= 180.0 * 1e7


def _read_euler_angles(w: float, x: float, y: float, z: float) -> tuple[float, float, float]:
    """Return roll, pitch, yaw of a quaternion (rad); NaN if invalid."""
    size = math.sqrt(w * w + x * x + y * y + z * z)
    if not 0.5 < size < 2.0:
        return (math.nan,) * 3
    roll, pitch, yaw = euler_from_quaternion((w / size, x / size, y / size, z / size)).tolist()
    return roll, pitch, yaw


@dataclass(frozen=True, slots=True)
class BeamRanges:
    """Distances along beams.

    Attributes
    ----------
    distances_m, angles_rad : (n,) array
        m, NaN if unknown; rad from the nose to the right.
    max_range_m : float
        Range of a beam that detects nothing (m).
    """

    distances_m: NDArray[np.float64] = field(default_factory=lambda: make_unknown_values(0))
    angles_rad: NDArray[np.float64] = field(default_factory=lambda: make_unknown_values(0))
    max_range_m: float = math.nan


def decode_obstacle_distance(m: MavMessage, heading_rad: float) -> BeamRanges:
    """Return the beams of OBSTACLE_DISTANCE with angles from the nose; angles from north are converted.

    Parameters
    ----------
    m : pymavlink message
    heading_rad : float
        Heading of the vehicle, for a ring relative to north.
    """
    told = np.array(m.distances, dtype=np.float64)
    known = np.flatnonzero(told != _UNKNOWN_UINT16)
    n = int(known[-1]) + 1 if len(known) else 0
    step = m.increment_f if m.increment_f > 0.0 else float(m.increment)
    if not math.isfinite(step):
        return BeamRanges()
    if step > 0.0:
        # The ring is complete even if its last beams are unknown.
        n = max(n, min(len(told), round(360.0 / step)))
    most = m.max_distance / 100.0
    ranges = np.where(told[:n] == _UNKNOWN_UINT16, math.nan, np.minimum(told[:n] / 100.0, most))
    first = m.angle_offset if math.isfinite(m.angle_offset) else 0.0
    angles = np.radians(first + step * np.arange(n))
    if m.frame != _BODY_FRAME and math.isfinite(heading_rad):
        angles = angles - heading_rad
    return BeamRanges(ranges, angles, most)


def add_distance_sensor_range(m: MavMessage, known: BeamRanges) -> BeamRanges:
    """Add a DISTANCE_SENSOR of one of eight directions (orientation 0 to 7) to the known ranges."""
    n = 8
    ranges = known.distances_m.copy() if len(known.distances_m) == n else make_unknown_values(n)
    most = m.max_distance / 100.0
    ranges[m.orientation] = min(m.current_distance / 100.0, most)
    return BeamRanges(ranges, np.radians(45.0) * np.arange(n), most)


_CLOCK_WRAP_S = 2**32 / 1e3
_WRAP_MARGIN_S = 60.0
"""Margin from both ends of the counter within which a backward jump is a wrap (s)."""
_RESTART_BACKSTEP_S = 2.0
"""Backward step too large for a late packet (s)."""
_RESTART_STAMP_COUNT = 3
"""Number of backward stamps in a row that mean a restart: a single one may be damaged or very late."""
_RATE_SAMPLE_PERIOD_S, _MAX_RATE_SAMPLES, _MIN_RATE_SAMPLES = 1.0, 11, 5
"""Period of the marks (the fastest stamp of each, s), and their largest and least number to measure the rate."""


class MonotonicVehicleClock:
    """A vehicle's clock, made monotonic.

    MAVLink's ``time_boot_ms`` counts milliseconds since the vehicle's start in 32 bits. It wraps after 49.7 days and
    restarts with the vehicle. A station's history needs one clock that only goes forward. After a wrap the clock
    continues without a step. After a restart it advances by the time that passed on the station's clock.

    Attributes
    ----------
    time_s : float
        Newest stamp on the monotonic clock (s); NaN before the first.
    restart_count : int
        Number of restarts of the vehicle.
    """

    def __init__(self) -> None:
        self.time_s = math.nan
        self.restart_count = 0
        self._offset_s = 0.0
        self._heard_s = math.nan
        self._changed = False
        self._backward: list[float] = []
        self._marks: deque[tuple[float, float]] = deque(
            maxlen=_MAX_RATE_SAMPLES
        )  # arrival time of a stamp, and its age
        self._marked_s = -math.inf

    def to_monotonic_time(self, boot_ms: int, now_s: float) -> float:
        """Convert a stamp to the monotonic clock.

        Parameters
        ----------
        boot_ms : int
            ``time_boot_ms``.
        now_s : float
            Station's clock (s).

        Returns
        -------
        float
            Time (s); NaN for a stamp that cannot be placed (yet).
        """
        own_s = boot_ms / 1e3
        if math.isnan(self.time_s):
            return self._accept_stamp(own_s, now_s)
        if self._changed:
            return self._restart_clock(own_s, now_s)
        newest_s = self.time_s - self._offset_s
        if newest_s > _CLOCK_WRAP_S - _WRAP_MARGIN_S and own_s < _WRAP_MARGIN_S:
            self._offset_s += _CLOCK_WRAP_S
        elif own_s > _CLOCK_WRAP_S - _WRAP_MARGIN_S and newest_s < _WRAP_MARGIN_S:
            own_s -= _CLOCK_WRAP_S  # a late stamp from before the wrap
        time_s = own_s + self._offset_s
        return (
            self._judge_late_stamp(own_s, now_s)
            if time_s < self.time_s - _RESTART_BACKSTEP_S
            else self._accept_stamp(time_s, now_s)
        )

    def clock_rate_ratio(self, now_s: float) -> float:
        """Return the rate of the vehicle's clock per station second over the last ten seconds; NaN if unknown.

        A link delays packets by varying times, but never by less than its least delay. The age of a stamp is therefore
        taken from the fastest packet of each second, and the clock is slow if that age grows.

        Parameters
        ----------
        now_s : float
            Station's clock (s).
        """
        marks = list(self._marks)[:-1]  # a faster packet of the present second may still arrive
        if (
            len(marks) < _MIN_RATE_SAMPLES
            or now_s - self._marked_s > 2.0 * _RATE_SAMPLE_PERIOD_S + _RATE_SAMPLE_PERIOD_S
        ):
            return math.nan
        (first_s, age_s), (last_s, later_age_s) = marks[0], marks[-1]
        return 1.0 - (later_age_s - age_s) / (last_s - first_s)

    def matches_stamp(self, boot_ms: int) -> bool:
        """Return whether a stamp of unknown origin is from this clock: within two seconds of the newest."""
        return abs(boot_ms / 1e3 + self._offset_s - self.time_s) < _RESTART_BACKSTEP_S

    def _accept_stamp(self, time_s: float, now_s: float) -> float:
        self._backward.clear()
        if not time_s <= self.time_s:
            self.time_s, self._heard_s = time_s, now_s
        self._record_clock_sample(now_s, now_s - time_s)
        return time_s

    def _record_clock_sample(self, now_s: float, age_s: float) -> None:
        if now_s - self._marked_s >= _RATE_SAMPLE_PERIOD_S:
            self._marked_s = now_s
            self._marks.append((now_s, age_s))
        elif age_s < self._marks[-1][1]:
            self._marks[-1] = (now_s, age_s)

    def _judge_late_stamp(self, own_s: float, now_s: float) -> float:
        """Classify a stamp far behind the newest: a late packet, or a restart, after which stamps increase."""
        if self._backward and own_s < self._backward[-1]:
            self._backward.clear()
        self._backward.append(own_s)
        if len(self._backward) < _RESTART_STAMP_COUNT or self._backward[-1] == self._backward[0]:
            return math.nan
        self.restart_count += 1
        return self._restart_clock(own_s, now_s)

    def realign_at_next_stamp(self) -> None:
        """Align the clock again at the next stamp, which belongs to another clock."""
        self._changed = True

    def _restart_clock(self, own_s: float, now_s: float) -> float:
        """Return the monotonic time of a restart's first stamp: the last time plus the station's time since then."""
        self._changed = False
        self._marks.clear()
        self._marked_s = -math.inf
        self._offset_s = self.time_s + max(now_s - self._heard_s, 1e-3) - own_s
        return self._accept_stamp(own_s + self._offset_s, now_s)
