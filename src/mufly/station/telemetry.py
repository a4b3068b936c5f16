"""From messages to signals: what a vehicle told, as rows of a history and as the present.

Every message sets the signals that it tells; a row is finished when a message brings a later stamp, so that what the
vehicle measured in one instant stands in one row. What is known at the moment is a
:class:`mufly.station.history.Present`. Fields that plainly are a quantity, but for its unit, are named by the table of
quantities (:func:`mufly.quantities.told_by`); messages whose fields mean different things at different times (masks,
quaternions, rings of beams) have readers here. Source of fields and units: https://mavlink.io/en/messages/common.html.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from mufly.dynamics import rotation
from mufly.link.codec import MavMessage, Origin
from mufly.link.estimates import CHECKS
from mufly.link.telemetry import REAL_TIME_FACTOR, SLIPS, STATES
from mufly.quantities import CHECKED, kept_by, told_by
from mufly.station.history import SLOW_HOLD_S, History, Present, unknown
from mufly.vehicle_types import mode_words

ROW_S = 0.009
"""Stamps closer than this stand in one row, whose time is the first of them (s): what a vehicle sends at one rate may
come a tick or two apart. The tlog has every packet."""
_STALL_S = 0.05
_SWEEP_S = 0.25
_HEARTBEAT_S = 3.0
_NEAR_POLE_DEG = 89.0  # beyond, east is no direction any more
_COAXIAL, _ARMED = 3, 128  # MAV_TYPE, MAV_MODE_FLAG
_BODY_FRAME = 12  # MAV_FRAME_BODY_FRD
_OLD_BODY_FRAME = 8  # MAV_FRAME_BODY_NED, as older PX4s say
_LEVEL_FRAMES = (1, 20)  # MAV_FRAME_LOCAL_NED; MAV_FRAME_LOCAL_FRD, level too
_DIAGONAL = (0, 6, 11, 15, 18, 20)  # of a 6 x 6 upper triangle, row by row
_RATIOS = ("velocity", "position", "height", "magnetometer", "height above ground", "airspeed")
_LOST = ((1, "attitude"), (2, "velocity"), (32, "height"), (8 | 16, "position"))
_WRONG = ((1024, "GPS glitch"), (2048, "accelerometer wrong"), (128, "position is held constant"))
"""ESTIMATOR_STATUS_FLAGS: what is not known without them, and what is wrong with them."""
_UNKNOWN = 65535
_TRUTH = tuple(q.name for q in kept_by("flight") if q.topic == "/truth")

_STAMPED: dict[str, tuple[str, int]] = {
    **dict.fromkeys(("ATTITUDE", "ATTITUDE_QUATERNION", "ATTITUDE_TARGET"), ("time_boot_ms", 1)),
    **dict.fromkeys(("LOCAL_POSITION_NED", "GLOBAL_POSITION_INT"), ("time_boot_ms", 1)),
    "POSITION_TARGET_LOCAL_NED": ("time_boot_ms", 1),
    "VISION_POSITION_ESTIMATE": ("usec", 1000),
    **dict.fromkeys(
        ("ACTUATOR_OUTPUT_STATUS", "OBSTACLE_DISTANCE", "DEBUG_FLOAT_ARRAY", "ODOMETRY"), ("time_usec", 1000)
    ),
}
"""Messages that begin rows: where their stamp is, and its ticks in a millisecond."""

PLAIN: dict[str, tuple[str, int]] = {
    "ATTITUDE": ("attitude", 0),
    "LOCAL_POSITION_NED": ("position", 0),
    "VISION_POSITION_ESTIMATE": ("measured", 0),
    "RC_CHANNELS": ("pilot", 0),
    "RC_CHANNELS_RAW": ("pilot", 1),
}
"""Messages that the table of quantities reads: what they tell, and their rank. Of several messages that tell the same,
the one with the lowest rank is believed while it comes."""

_Array = NDArray[np.float64]
_Told = Mapping[str, Sequence[float]] | None
"""Values of variables; None: the message tells nothing."""


class Telemetry:
    """What one vehicle told.

    Attributes
    ----------
    history : History
    clock : VehicleClock
    armed : bool
    landed_state : int
        MAV_LANDED_STATE; 0 is unknown.
    autopilot, vehicle_type : int
        MAV_AUTOPILOT, MAV_TYPE.
    ranges : Ranges
    battery_left_s : float
    mission_current : int or None
    mission_state : int
        MISSION_STATE; 0 is unknown.
    commander : int or None
        system * 256 + component; 0 nobody, None unknown.
    health : tuple of int or None
        Sensors present, enabled, healthy, as SYS_STATUS says.
    simulated : bool
        Whether it tells the truth, as only a simulation can.
    origin : Origin or None
        Where on the globe its N, E, D are 0.
    slips : int or None
        How often it gave up time, as a simulation in real time tells.
    estimator : EstimatorStatus or None
        What its estimator says of itself, by ESTIMATOR_STATUS.
    """

    def __init__(self, history: History | None = None) -> None:
        self.history = History() if history is None else history
        self.clock = VehicleClock()
        self.armed = False
        self.landed_state = self.autopilot = self.vehicle_type = 0
        self.mode = ""
        self.ranges = Ranges()
        self.battery_left_s = math.nan
        self.mission_current: int | None = None
        self.mission_state = 0
        self.commander: int | None = None
        self.health: tuple[int, int, int] | None = None
        self.simulated = False
        self.origin: Origin | None = None
        self.slips: int | None = None
        self.estimator: EstimatorStatus | None = None
        self._factor: tuple[float, float] = (math.nan, -math.inf)  # the real-time factor it told, and when
        self.on_row: Callable[[float, _Array, str], None] | None = None
        self._present = Present(self.history)
        self._own_state: tuple[str, float] = ("", -math.inf)
        self._stamps: dict[str, float] = {}
        self._row_s = math.nan
        self._row_now_s = self._swept_s = self._heard_s = -math.inf
        index = self._present.index
        self._plain = {name: [(f, index[signal], x) for f, signal, x in told_by(name)] for name in PLAIN}
        # What they tell, their rank, and their readers.
        self._read: dict[str, tuple[str, int, Callable[[MavMessage], _Told]]] = {
            "ATTITUDE_QUATERNION": ("attitude", 1, self._quaternion),
            "GLOBAL_POSITION_INT": ("position", 1, self._global_position),
            "SYS_STATUS": ("battery", 1, self._sys_status),
            "BATTERY_STATUS": ("battery", 0, self._battery),
            "POSITION_TARGET_LOCAL_NED": ("reference", 0, self._position_target),
            "ATTITUDE_TARGET": ("reference_attitude", 0, self._attitude_target),
            "ACTUATOR_OUTPUT_STATUS": ("actuators", 0, self._actuators),
            "SERVO_OUTPUT_RAW": ("actuators", 1, self._servo_outputs),
            "DEBUG_FLOAT_ARRAY": ("truth", 0, self._debug_array),
            "ODOMETRY": ("odometry", 0, self._odometry),
        }
        self._note: dict[str, Callable[[float, MavMessage], None]] = {
            "HEARTBEAT": self._heartbeat,
            "EXTENDED_SYS_STATE": self._extended_state,
            "GPS_GLOBAL_ORIGIN": self._global_origin,
            "HOME_POSITION": self._home,
            "RAW_RPM": self._rpm,
            "OBSTACLE_DISTANCE": self._ring,
            "DISTANCE_SENSOR": self._distance,
            "NAMED_VALUE_INT": self._named_int,
            "NAMED_VALUE_FLOAT": self._named_float,
            "MISSION_CURRENT": self._mission_current,
            "ESTIMATOR_STATUS": self._estimator_status,
        }

    def handle(self, now_s: float, message: MavMessage) -> None:
        """Take a message of the vehicle's autopilot; those that tell no signal are passed over.

        Parameters
        ----------
        now_s : float
            Our clock (s).
        message : pymavlink message
        """
        name, present, self._heard_s = message.get_type(), self._present, now_s
        if name in _STAMPED and not self._in_time(now_s, name, message):
            return
        if name in PLAIN:
            group, rank = PLAIN[name]
            if present.believed(now_s, group, rank):
                for field_, k, factor in self._plain[name]:
                    value = getattr(message, field_)
                    known = group != "pilot" or value != _UNKNOWN
                    present.set(group, k, value * factor if known else math.nan)
        elif name in self._read:
            group, rank, read = self._read[name]
            told = read(message)
            if told is not None and present.believed(now_s, group, rank):
                for variable, values in told.items():
                    present.put(group, variable, values)
        elif name in self._note:
            self._note[name](now_s, message)

    def step(self, now_s: float) -> None:
        """Finish a row that waits for a next one, and forget what was not told for long."""
        if not math.isnan(self._row_s) and now_s - self._row_now_s > _STALL_S:
            self._finish_row()
        if now_s - self._swept_s >= _SWEEP_S:
            self._swept_s = now_s
            if "ranges" in self._present.forget(now_s):
                self.ranges = Ranges()

    def change_speaker(self) -> None:
        """Note that another component, with a clock of its own, speaks from now on; the history goes on."""
        self.clock.change_clock()
        self._stamps.clear()
        self.mission_current, self.mission_state, self.commander = None, 0, None

    def note_link(self, now_s: float, loss: float, rate_Hz: float) -> None:
        """Put the quality of the link among the signals."""
        self._present.believed(now_s, "link")
        self._present.put("link", "link_loss", (loss,))
        self._present.put("link", "link_rate", (rate_Hz,))

    def believes(self, name: str) -> _Array:
        """Return the present value of a variable (``"estimated_position"``), NaN where it is not known."""
        return self._present[name]

    @property
    def time_s(self) -> float:
        """The vehicle's clock (s)."""
        return self.clock.time_s

    def real_time_factor(self, now_s: float) -> float:
        """Seconds of the vehicle's clock in one of ours, of late: as it told, or else as its stamps go."""
        told, told_s = self._factor
        return told if now_s - told_s <= SLOW_HOLD_S else self.clock.factor(now_s)

    @property
    def flying(self) -> bool:
        """Whether it is off the floor, as it says itself, or as its height tells."""
        if self.landed_state:
            return self.landed_state != 1
        return bool(self.armed and self.believes("estimated_position")[2] < -0.1)

    @property
    def state(self) -> str:
        """State of its mission machine where it has one of ours, else its flight mode."""
        return self._own_state[0] or self.mode

    # Rows

    def _in_time(self, now_s: float, name: str, message: MavMessage) -> bool:
        """Whether a message is no older than the last of its kind; begins the row of its stamp."""
        stamp, tick = _STAMPED[name]
        boot_ms = getattr(message, stamp) // tick
        if tick > 1 and not self.clock.fits(boot_ms):
            return True  # some vehicles stamp with the time of day
        time_s = self.clock.stamp(boot_ms, now_s)
        if math.isnan(time_s) or time_s < self._stamps.get(name, -math.inf):
            return False
        self._stamps[name] = time_s
        if time_s - self._row_s > ROW_S:
            self._finish_row()
        if math.isnan(self._row_s):
            self._row_s, self._row_now_s = time_s, now_s
        return True

    def _finish_row(self) -> None:
        with np.errstate(over="ignore"):  # an absurd number becomes infinite, and is drawn nowhere
            row = self._present.values.astype(np.float32)
        if self._row_s > self.history.newest_s or not len(self.history):
            self.history.append(self._row_s, row)
            if self.on_row is not None:
                self.on_row(self._row_s, self._present.values, self.state)
        self._row_s = math.nan

    # Readers: what a message tells, as values of variables

    def _quaternion(self, m: MavMessage) -> _Told:
        rates = (m.rollspeed, m.pitchspeed, m.yawspeed)
        return {"estimated_attitude": _euler(m.q1, m.q2, m.q3, m.q4), "estimated_rates": rates}

    def _global_position(self, m: MavMessage) -> _Told:
        """Metres from the origin, or from the first fix."""
        if (m.lat, m.lon) == (0, 0) or not _on_earth(m.lat, m.lon):
            return None  # no fix yet
        latitude, longitude = m.lat / 1e7, m.lon / 1e7
        if self.origin is None:
            self.origin = Origin(latitude, longitude, (m.alt - m.relative_alt) / 1e3)
        return {
            "estimated_position": self.origin.to_local(latitude, longitude, m.alt / 1e3),
            "estimated_velocity": (m.vx / 100.0, m.vy / 100.0, m.vz / 100.0),
        }

    def _sys_status(self, m: MavMessage) -> _Told:
        present, enabled = m.onboard_control_sensors_present, m.onboard_control_sensors_enabled
        self.health = present, enabled, m.onboard_control_sensors_health
        voltage = math.nan if m.voltage_battery == _UNKNOWN else m.voltage_battery / 1e3
        return _battery(voltage, m)

    def _battery(self, m: MavMessage) -> _Told:
        if m.id != 0:
            return None
        cells = [v for v in (*m.voltages, *(v for v in m.voltages_ext if v)) if v != _UNKNOWN]
        self.battery_left_s = float(m.time_remaining) if m.time_remaining > 0 else math.nan
        return _battery(sum(cells) / 1e3 if cells else math.nan, m)

    def _position_target(self, m: MavMessage) -> _Told:
        if m.coordinate_frame != 1:
            return None
        told = enumerate((m.x, m.y, m.z, m.vx, m.vy, m.vz))
        given = [math.nan if m.type_mask >> k & 1 else v for k, v in told]
        return {"reference_position": given[:3], "reference_velocity": given[3:]}

    def _attitude_target(self, m: MavMessage) -> _Told:
        return {"reference_attitude": (math.nan,) * 3 if m.type_mask & 128 else _euler(*m.q)}

    def _actuators(self, m: MavMessage) -> _Told:
        # The order of the outputs is ours; another vehicle's may mean anything.
        if self.vehicle_type != _COAXIAL or m.active < 4:
            return None
        return {"motor_input": m.actuator[:2], "servo_input": m.actuator[2:4]}

    def _servo_outputs(self, m: MavMessage) -> _Told:
        pulses = (m.servo1_raw, m.servo2_raw)
        return None if m.port else {"motor_input": [(p - 1000) / 1000 if p else math.nan for p in pulses]}

    def _odometry(self, m: MavMessage) -> _Told:
        """How far the pose is to be believed; covariances of velocities only in axes of the body or of the room."""
        told: dict[str, Sequence[float]] = {}
        position, attitude = _deviations(m.pose_covariance)
        if m.frame_id in _LEVEL_FRAMES:
            told = {"estimated_position_sigma": position, "estimated_attitude_sigma": attitude}
        if m.child_frame_id in _LEVEL_FRAMES:
            told["estimated_velocity_sigma"] = _deviations(m.velocity_covariance)[0]
        elif m.child_frame_id in (_BODY_FRAME, _OLD_BODY_FRAME):
            told["estimated_velocity_sigma"] = _turned_deviations(m.velocity_covariance, m.q)
        return told or None

    def _checks(self, m: MavMessage) -> None:
        values = list(m.data)
        for k, name in enumerate(CHECKED):
            self._present.put("checks", f"status_{name}", values[3 * k : 3 * k + 1])
            self._present.put("checks", f"innovation_{name}", values[3 * k + 1 : 3 * k + 2])
        self._present.put("checks", "estimated_wind", values[3 * len(CHECKED) : 3 * len(CHECKED) + 2])

    def _estimator_status(self, now_s: float, m: MavMessage) -> None:
        ratios = (m.vel_ratio, m.pos_horiz_ratio, m.pos_vert_ratio, m.mag_ratio, m.hagl_ratio, m.tas_ratio)
        self.estimator = EstimatorStatus(
            now_s,
            m.flags,
            tuple(zip(_RATIOS, ratios, strict=True)),
            m.pos_horiz_accuracy,
            m.pos_vert_accuracy,
        )

    def _debug_array(self, m: MavMessage) -> _Told:
        if m.name == CHECKS.decode():
            self._present.believed(self._heard_s, "checks")
            self._checks(m)
            return None
        if m.name != "truth":
            return None
        self.simulated = True
        told, at = {}, 0
        for name in _TRUTH:
            columns = self._present.columns[name]
            told[name] = m.data[at : (at := at + columns.stop - columns.start)]
        return told

    # Messages that tell other things, or of which only a part is believed

    def _heartbeat(self, now_s: float, m: MavMessage) -> None:
        self.autopilot, self.vehicle_type = m.autopilot, m.type
        self.armed = bool(m.base_mode & _ARMED)
        self.mode = mode_words(m.autopilot, m.type, m.base_mode, m.custom_mode)
        if now_s - self._own_state[1] > _HEARTBEAT_S:
            self._own_state = ("", -math.inf)

    def _extended_state(self, now_s: float, m: MavMessage) -> None:
        self.landed_state = m.landed_state

    def _global_origin(self, now_s: float, m: MavMessage) -> None:
        if _on_earth(m.latitude, m.longitude):
            self.origin = Origin(m.latitude / 1e7, m.longitude / 1e7, m.altitude / 1e3)

    def _home(self, now_s: float, m: MavMessage) -> None:
        if self.origin is None:
            self._global_origin(now_s, m)

    def _rpm(self, now_s: float, m: MavMessage) -> None:
        if m.index in (0, 1):
            group, (field_, signal, factor) = f"rpm {m.index}", told_by("RAW_RPM")[m.index]
            self._present.believed(now_s, group)
            self._present.set(group, self._present.index[signal], getattr(m, field_) * factor)

    def _ring(self, now_s: float, m: MavMessage) -> None:
        if self._present.believed(now_s, "ranges"):
            self._ranges_are(read_ring(m, float(self.believes("estimated_attitude")[2])))

    def _distance(self, now_s: float, m: MavMessage) -> None:
        if m.orientation < 8 and self._present.believed(now_s, "ranges", 1):
            self._ranges_are(read_distance(m, self.ranges))

    def _ranges_are(self, ranges: Ranges) -> None:
        self.ranges = ranges
        beams = len(self.believes("range"))
        kept = ranges.ranges if len(ranges.ranges) <= beams else unknown(0)
        self._present.put("ranges", "range", [*kept, *unknown(beams - len(kept))])

    def _named_int(self, now_s: float, m: MavMessage) -> None:
        if m.name == "mstate":
            known = 0 <= m.value < len(STATES)
            self._own_state = (STATES[m.value] if known else f"state {m.value}", now_s)
        elif m.name == "command":
            self.commander = m.value
        elif m.name == SLIPS:
            self.slips = m.value

    def _named_float(self, now_s: float, m: MavMessage) -> None:
        if m.name == REAL_TIME_FACTOR and math.isfinite(m.value):
            self._factor = (m.value, now_s)

    def _mission_current(self, now_s: float, m: MavMessage) -> None:
        self.mission_current, self.mission_state = m.seq, m.mission_state


@dataclass(frozen=True, slots=True)
class EstimatorStatus:
    """What an estimator says of itself (ESTIMATOR_STATUS).

    Attributes
    ----------
    heard_s : float
        When, by our clock (s).
    flags : int
        ESTIMATOR_STATUS_FLAGS.
    ratios : tuple of (str, float)
        Of what, and its test ratio: above 1 it is rejected; 0 is not measured.
    level_m, height_m : float
        Accuracy of the position (1 sigma).
    """

    heard_s: float
    flags: int
    ratios: tuple[tuple[str, float], ...]
    level_m: float
    height_m: float

    @property
    def unknown(self) -> tuple[str, ...]:
        """What it does not know."""
        return tuple(words for flags, words in _LOST if not self.flags & flags)

    @property
    def wrong(self) -> tuple[str, ...]:
        """What is wrong, and what does not fit."""
        return (
            *(words for flag, words in _WRONG if self.flags & flag),
            *(f"{name} rejected" for name, ratio in self.ratios if ratio > 1.0),
        )


def _deviations(upper: Sequence[float]) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """Standard deviations of the first and the last three of six states; NaN where they are not told."""
    if len(upper) != 21 or math.isnan(upper[0]):
        return (math.nan,) * 3, (math.nan,) * 3
    told = [math.sqrt(upper[k]) if upper[k] >= 0.0 else math.nan for k in _DIAGONAL]
    return tuple(told[:3]), tuple(told[3:])


def _turned_deviations(upper: Sequence[float], q: Sequence[float]) -> tuple[float, ...]:
    """Standard deviations in N, E, D of a velocity whose covariance is in body axes; NaN where they are not told."""
    size = math.sqrt(sum(v * v for v in q))
    if len(upper) != 21 or math.isnan(upper[0]) or not 0.5 < size < 2.0:
        return (math.nan,) * 3
    own = np.array(
        [[upper[0], upper[1], upper[2]], [upper[1], upper[6], upper[7]], [upper[2], upper[7], upper[11]]]
    )
    turn = rotation(np.array(q, dtype=np.float64) / size)
    with np.errstate(all="ignore"):
        told: _Array = np.sqrt(np.diag(turn @ own @ turn.T))
    return tuple(told.tolist())


def _battery(voltage: float, m: MavMessage) -> _Told:
    current, percent = m.current_battery, m.battery_remaining
    return {
        "battery_voltage": (voltage,),
        "battery_current": (math.nan if current < 0 else current / 100.0,),
        "battery_charge": (math.nan if percent < 0 else percent / 100.0,),
    }


def _on_earth(latitude_e7: int, longitude_e7: int) -> bool:
    """Whether there is such a place (1e-7 deg): a vehicle may say anything."""
    return abs(latitude_e7) <= _NEAR_POLE_DEG * 1e7 and abs(longitude_e7) <= 180.0 * 1e7


def _euler(w: float, x: float, y: float, z: float) -> tuple[float, float, float]:
    """Roll, pitch, yaw of a quaternion (rad); NaN if it is none."""
    size = math.sqrt(w * w + x * x + y * y + z * z)
    if not 0.5 < size < 2.0:
        return (math.nan,) * 3
    w, x, y, z = w / size, x / size, y / size, z / size
    roll = math.atan2(2.0 * (w * x + y * z), 1.0 - 2.0 * (x * x + y * y))
    pitch = math.asin(max(-1.0, min(1.0, 2.0 * (w * y - z * x))))
    return roll, pitch, math.atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))


@dataclass(frozen=True, slots=True)
class Ranges:
    """Distances along beams.

    Attributes
    ----------
    ranges, angles : (n,) array
        m, NaN where it is not known; rad from the nose to the right.
    most_m : float
        What a beam that sees nothing returns (m).
    """

    ranges: NDArray[np.float64] = field(default_factory=lambda: unknown(0))
    angles: NDArray[np.float64] = field(default_factory=lambda: unknown(0))
    most_m: float = math.nan


def read_ring(m: MavMessage, heading_rad: float) -> Ranges:
    """Read OBSTACLE_DISTANCE: a ring of beams, from the nose or (turned back here) from north.

    Parameters
    ----------
    m : pymavlink message
    heading_rad : float
        For a ring that is told from north.
    """
    told = np.array(m.distances, dtype=np.float64)
    known = np.flatnonzero(told != _UNKNOWN)
    n = int(known[-1]) + 1 if len(known) else 0
    step = m.increment_f if m.increment_f > 0.0 else float(m.increment)
    if not math.isfinite(step):
        return Ranges()
    if step > 0.0:
        # The ring is whole even if its last beams are not known just now.
        n = max(n, min(len(told), round(360.0 / step)))
    most = m.max_distance / 100.0
    ranges = np.where(told[:n] == _UNKNOWN, math.nan, np.minimum(told[:n] / 100.0, most))
    first = m.angle_offset if math.isfinite(m.angle_offset) else 0.0
    angles = np.radians(first + step * np.arange(n))
    if m.frame != _BODY_FRAME and math.isfinite(heading_rad):
        angles = angles - heading_rad
    return Ranges(ranges, angles, most)


def read_distance(m: MavMessage, known: Ranges) -> Ranges:
    """Add a DISTANCE_SENSOR that looks to one of eight sides (orientation 0 to 7) to what is known."""
    n = 8
    ranges = known.ranges.copy() if len(known.ranges) == n else unknown(n)
    most = m.max_distance / 100.0
    ranges[m.orientation] = min(m.current_distance / 100.0, most)
    return Ranges(ranges, np.radians(45.0) * np.arange(n), most)


_WRAP_S = 2**32 / 1e3
_NEAR_S = 60.0
"""It wrapped if it was so near the end and is so near the beginning (s)."""
_BACK_S = 2.0
"""A stamp so far behind the newest is no packet that came late (s)."""
_SURE = 3
"""So many such stamps in a row, and the vehicle was started anew: one alone may be damaged or very late."""
_MARK_S, _MARKS, _LEAST_MARKS = 1.0, 11, 5
"""Of every second the stamp that came fastest is kept; between so many the pace is measured."""


class VehicleClock:
    """A vehicle's clock, made to run on.

    MAVLink's ``time_boot_ms`` counts milliseconds since the vehicle was started, in 32 bits: it wraps after 49.7 days
    and begins again when the vehicle is started anew. A station's history wants one clock that only goes forward. After
    a wrap it goes on as if nothing had been; after a restart it goes on from where it was, by as much as passed here
    meanwhile.

    Attributes
    ----------
    time_s : float
        The newest stamp on that clock; NaN before the first.
    restarts : int
        How often the vehicle was started anew.
    """

    def __init__(self) -> None:
        self.time_s = math.nan
        self.restarts = 0
        self._offset_s = 0.0
        self._heard_s = math.nan
        self._changed = False
        self._backward: list[float] = []
        self._marks: deque[tuple[float, float]] = deque(maxlen=_MARKS)  # when a stamp came, and its age then
        self._marked_s = -math.inf

    def stamp(self, boot_ms: int, now_s: float) -> float:
        """Place a stamp.

        Parameters
        ----------
        boot_ms : int
            ``time_boot_ms``.
        now_s : float
            Our clock (s).

        Returns
        -------
        float
            s; NaN for a stamp that cannot be placed (yet).
        """
        own_s = boot_ms / 1e3
        if math.isnan(self.time_s):
            return self._forward(own_s, now_s)
        if self._changed:
            return self._begin_again(own_s, now_s)
        newest_s = self.time_s - self._offset_s
        if newest_s > _WRAP_S - _NEAR_S and own_s < _NEAR_S:
            self._offset_s += _WRAP_S
        elif own_s > _WRAP_S - _NEAR_S and newest_s < _NEAR_S:
            own_s -= _WRAP_S  # from before the wrap, late
        time_s = own_s + self._offset_s
        return self._behind(own_s, now_s) if time_s < self.time_s - _BACK_S else self._forward(time_s, now_s)

    def factor(self, now_s: float) -> float:
        """How fast it goes against ours over the last ten seconds; NaN while that is not known.

        A link delays packets by more or less, never by less than its least delay. So the age at which a stamp comes
        is taken from the fastest packet of each second, and the clock is slow if that age grows.

        Parameters
        ----------
        now_s : float
            Our clock (s).
        """
        marks = list(self._marks)[:-1]  # of the present second a faster one may come yet
        if len(marks) < _LEAST_MARKS or now_s - self._marked_s > 2.0 * _MARK_S + _MARK_S:
            return math.nan
        (first_s, age_s), (last_s, later_age_s) = marks[0], marks[-1]
        return 1.0 - (later_age_s - age_s) / (last_s - first_s)

    def fits(self, boot_ms: int) -> bool:
        """Whether a stamp of unknown origin is plainly of this clock: within two seconds of the newest."""
        return abs(boot_ms / 1e3 + self._offset_s - self.time_s) < _BACK_S

    def _forward(self, time_s: float, now_s: float) -> float:
        self._backward.clear()
        if not time_s <= self.time_s:
            self.time_s, self._heard_s = time_s, now_s
        self._mark(now_s, now_s - time_s)
        return time_s

    def _mark(self, now_s: float, age_s: float) -> None:
        if now_s - self._marked_s >= _MARK_S:
            self._marked_s = now_s
            self._marks.append((now_s, age_s))
        elif age_s < self._marks[-1][1]:
            self._marks[-1] = (now_s, age_s)

    def _behind(self, own_s: float, now_s: float) -> float:
        """Judge a stamp far behind the newest: late, or the first ones after a restart, which go forward."""
        if self._backward and own_s < self._backward[-1]:
            self._backward.clear()
        self._backward.append(own_s)
        if len(self._backward) < _SURE or self._backward[-1] == self._backward[0]:
            return math.nan
        self.restarts += 1
        return self._begin_again(own_s, now_s)

    def change_clock(self) -> None:
        """Tie the next stamp anew, as it belongs to another clock."""
        self._changed = True

    def _begin_again(self, own_s: float, now_s: float) -> float:
        """Go on from where it was, by as much as passed here meanwhile."""
        self._changed = False
        self._marks.clear()
        self._marked_s = -math.inf
        self._offset_s = self.time_s + max(now_s - self._heard_s, 1e-3) - own_s
        return self._forward(own_s + self._offset_s, now_s)
