"""Which field of which MAVLink message is which signal: one table.

Messages whose fields mean different things at different times (masks, quaternions, rings of beams) have functions of
their own in :mod:`mufly.station.telemetry`; everything that is a plain number times a factor is here. Source of fields
and units: https://mavlink.io/en/messages/common.html.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from mufly.link.codec import MavMessage
from mufly.link.conventions import Origin
from mufly.link.telemetry import STATES
from mufly.quantities import told_by
from mufly.station.autopilots import mode_words
from mufly.station.history import Board, History
from mufly.station.view import unknown

_UNKNOWN = 65535


@dataclass(frozen=True, slots=True)
class Fields:
    """The plain fields of a message.

    Attributes
    ----------
    group : str
        What they tell; several messages may tell the same.
    rank : int
        Of several messages that tell the same, the one with the lowest rank is believed while it comes.
    fields : tuple of (field, signal, factor)
        Number times factor is the signal in its unit.
    unknown : float or None
        Number that says "not known".
    """

    group: str
    rank: int
    fields: tuple[tuple[str, str, float], ...]
    unknown: float | None = None


FIELDS: dict[str, Fields] = {
    "ATTITUDE": Fields("attitude", 0, told_by("ATTITUDE")),
    "LOCAL_POSITION_NED": Fields("position", 0, told_by("LOCAL_POSITION_NED")),
    "VISION_POSITION_ESTIMATE": Fields("measured", 0, told_by("VISION_POSITION_ESTIMATE")),
    "RC_CHANNELS": Fields("pilot", 0, told_by("RC_CHANNELS"), _UNKNOWN),
    "RC_CHANNELS_RAW": Fields("pilot", 1, told_by("RC_CHANNELS_RAW"), _UNKNOWN),
}
"""Message -> its plain fields."""

RPM = {index: (field,) for index, field in enumerate(told_by("RAW_RPM"))}
"""RAW_RPM: index -> its field."""


# ----------------------------------------------------------------------------
# Distances around a vehicle, from the two messages that tell them.


_NOTHING_KNOWN = 65535
_BODY_FRAME = 12  # MAV_FRAME_BODY_FRD


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
    known = np.flatnonzero(told != _NOTHING_KNOWN)
    n = int(known[-1]) + 1 if len(known) else 0
    step = m.increment_f if m.increment_f > 0.0 else float(m.increment)
    if not math.isfinite(step):
        return Ranges()
    if step > 0.0:
        # The ring is whole even if its last beams are not known just now.
        n = max(n, min(len(told), round(360.0 / step)))
    most = m.max_distance / 100.0
    ranges = np.where(told[:n] == _NOTHING_KNOWN, math.nan, np.minimum(told[:n] / 100.0, most))
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


# ----------------------------------------------------------------------------
# A vehicle's clock, made to run on.
#
# MAVLink's ``time_boot_ms`` counts milliseconds since the vehicle was started, in 32 bits: it wraps after 49.7 days
# and
# begins again when the vehicle is started anew. A station's history wants one clock that only goes forward. After a
# wrap
# it goes on as if nothing had been; after a restart it goes on from where it was, by as much as passed here
# meanwhile.


_WRAP_S = 2**32 / 1e3
_NEAR_S = 60.0
"""It wrapped if it was so near the end and is so near the beginning (s)."""
_BACK_S = 2.0
"""A stamp so far behind the newest is no packet that came late (s)."""
_SURE = 3
"""So many such stamps in a row, and the vehicle was started anew: one alone may be damaged or very late."""


class VehicleClock:
    """Turns stamps into one clock that goes forward.

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
        self._backward: list[float] = []

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
        newest_s = self.time_s - self._offset_s
        if newest_s > _WRAP_S - _NEAR_S and own_s < _NEAR_S:
            self._offset_s += _WRAP_S
        elif own_s > _WRAP_S - _NEAR_S and newest_s < _NEAR_S:
            own_s -= _WRAP_S  # from before the wrap, late
        time_s = own_s + self._offset_s
        return self._behind(own_s, now_s) if time_s < self.time_s - _BACK_S else self._forward(time_s, now_s)

    def fits(self, boot_ms: int) -> bool:
        """Whether a stamp of unknown origin is plainly of this clock: within two seconds of the newest."""
        return abs(boot_ms / 1e3 + self._offset_s - self.time_s) < _BACK_S

    def _forward(self, time_s: float, now_s: float) -> float:
        self._backward.clear()
        if not time_s <= self.time_s:
            self.time_s, self._heard_s = time_s, now_s
        return time_s

    def _behind(self, own_s: float, now_s: float) -> float:
        """Judge a stamp far behind the newest: late, or the first ones after a restart, which go forward."""
        if self._backward and own_s < self._backward[-1]:
            self._backward.clear()
        self._backward.append(own_s)
        if len(self._backward) < _SURE or self._backward[-1] == self._backward[0]:
            return math.nan
        self.restarts += 1
        self._offset_s = self.time_s + max(now_s - self._heard_s, 1e-3) - own_s
        return self._forward(own_s + self._offset_s, now_s)


# ----------------------------------------------------------------------------
# From messages to signals: what a vehicle told, as rows of a history and as the present.
#
# Every message sets the signals that it tells; a row is finished when a message brings a later stamp, so that what
# the
# vehicle measured in one instant stands in one row. What is known at the moment stands on a
# :class:`mufly.station.history.Board`.


ROW_S = 0.009
"""Stamps closer than this stand in one row, whose time is the first of them (s): what a vehicle sends at one rate may
come a tick or two apart. The tlog has every packet."""
_STALL_S = 0.05
_HEARTBEAT_S = 3.0
_NEAR_POLE_DEG = 89.0  # beyond, east is no direction any more
_COAXIAL, _ARMED = 3, 128  # MAV_TYPE, MAV_MODE_FLAG

_STAMPED: dict[str, tuple[str, int]] = {
    **dict.fromkeys(("ATTITUDE", "ATTITUDE_QUATERNION", "LOCAL_POSITION_NED"), ("time_boot_ms", 1)),
    **dict.fromkeys(("GLOBAL_POSITION_INT", "POSITION_TARGET_LOCAL_NED"), ("time_boot_ms", 1)),
    "ATTITUDE_TARGET": ("time_boot_ms", 1),
    "VISION_POSITION_ESTIMATE": ("usec", 1000),
    **dict.fromkeys(
        ("ACTUATOR_OUTPUT_STATUS", "OBSTACLE_DISTANCE", "DEBUG_FLOAT_ARRAY"), ("time_usec", 1000)
    ),
}
"""Messages that begin rows: where their stamp is, and its ticks in a millisecond."""

_Array = NDArray[np.float64]


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
    commander : int or None
        system * 256 + component; 0 nobody, None unknown.
    health : tuple of int or None
        Sensors present, enabled, healthy, as SYS_STATUS says.
    simulated : bool
        Whether it tells the truth, as only a simulation can.
    origin : Origin or None
        Where on the globe its N, E, D are 0.
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
        self.commander: int | None = None
        self.health: tuple[int, int, int] | None = None
        self.simulated = False
        self.origin: Origin | None = None
        self.on_row: Callable[[float, _Array, str], None] | None = None
        self._board = Board(self.history)
        self._own_state: tuple[str, float] = ("", -math.inf)
        self._stamps: dict[str, float] = {}
        self._row_s = math.nan
        self._row_now_s = self._swept_s = -math.inf
        self._plain = {
            name: (f, tuple((field, self._board.index[signal], factor) for field, signal, factor in f.fields))
            for name, f in FIELDS.items()
        }
        self._special: dict[str, Callable[[float, MavMessage], None]] = {
            "HEARTBEAT": self._heartbeat,
            "SYS_STATUS": self._sys_status,
            "BATTERY_STATUS": self._battery,
            "EXTENDED_SYS_STATE": self._extended_state,
            "ATTITUDE_QUATERNION": self._quaternion,
            "GLOBAL_POSITION_INT": self._global_position,
            "GPS_GLOBAL_ORIGIN": self._global_origin,
            "HOME_POSITION": self._home,
            "POSITION_TARGET_LOCAL_NED": self._position_target,
            "ATTITUDE_TARGET": self._attitude_target,
            "ACTUATOR_OUTPUT_STATUS": self._actuators,
            "SERVO_OUTPUT_RAW": self._servo_outputs,
            "RAW_RPM": self._rpm,
            "OBSTACLE_DISTANCE": self._ring,
            "DISTANCE_SENSOR": self._distance,
            "DEBUG_FLOAT_ARRAY": self._debug_array,
            "NAMED_VALUE_INT": self._named_int,
            "MISSION_CURRENT": self._mission_current,
        }

    def handle(self, now_s: float, message: MavMessage) -> None:
        """Take a message of the vehicle's autopilot; those that tell no signal are passed over.

        Parameters
        ----------
        now_s : float
            Our clock (s).
        message : pymavlink message
        """
        name = message.get_type()
        plain, special = self._plain.get(name), self._special.get(name)
        if plain is None and special is None:
            return
        if name in _STAMPED and not self._in_time(now_s, name, message):
            return
        if plain is not None:
            fields, places = plain
            if self._board.believed(now_s, fields.group, fields.rank):
                for field, k, factor in places:
                    value = getattr(message, field)
                    self._board.set(fields.group, k, math.nan if value == fields.unknown else value * factor)
        if special is not None:
            special(now_s, message)

    def step(self, now_s: float) -> None:
        """Finish a row that waits for a next one, and forget what was not told for long."""
        if not math.isnan(self._row_s) and now_s - self._row_now_s > _STALL_S:
            self._finish_row()
        if now_s - self._swept_s < 0.25:
            return
        self._swept_s = now_s
        if "ranges" in self._board.forget(now_s):
            self.ranges = Ranges()

    def note_link(self, now_s: float, loss: float, rate_Hz: float) -> None:
        """Put the quality of the link among the signals."""
        self._board.believed(now_s, "link", 0)
        self._board.set("link", self._board.index["link_loss"], loss)
        self._board.set("link", self._board.index["link_rate"], rate_Hz)

    def believes(self, name: str) -> _Array:
        """Return the present value of a variable (``"estimated_position"``), NaN where it is not known."""
        return self._board.get(name)

    @property
    def time_s(self) -> float:
        """The vehicle's clock (s)."""
        return self.clock.time_s

    @property
    def flying(self) -> bool:
        """Whether it is off the floor, as it says itself, or as its height tells."""
        if self.landed_state:
            return self.landed_state != 1
        down = self._board.values[self._board.index["estimated_position_D"]]
        return bool(self.armed and down < -0.1)

    @property
    def state(self) -> str:
        """State of its mission machine where it has one of ours, else its flight mode."""
        return self._own_state[0] or self.mode

    # Rows

    def _in_time(self, now_s: float, name: str, message: MavMessage) -> bool:
        """Whether a message is no older than the last of its kind; begins the row of its stamp."""
        field, tick = _STAMPED[name]
        boot_ms = getattr(message, field) // tick
        if tick > 1 and not self.clock.fits(boot_ms):
            return True  # some vehicles stamp with the time of day
        time_s = self.clock.stamp(boot_ms, now_s)
        if math.isnan(time_s) or time_s < self._stamps.get(name, -math.inf):
            return False
        self._stamps[name] = time_s
        self._begin_row(time_s, now_s)
        return True

    def _begin_row(self, time_s: float, now_s: float) -> None:
        if math.isnan(self._row_s):
            self._row_s, self._row_now_s = time_s, now_s
        elif time_s - self._row_s > ROW_S:
            self._finish_row()
            self._row_s, self._row_now_s = time_s, now_s

    def _finish_row(self) -> None:
        with np.errstate(over="ignore"):  # an absurd number becomes infinite, and is drawn nowhere
            row = self._board.values.astype(np.float32)
        if self._row_s > self.history.newest_s or not len(self.history):
            self.history.append(self._row_s, row)
            if self.on_row is not None:
                self.on_row(self._row_s, self._board.values, self.state)
        self._row_s = math.nan

    # Messages with rules of their own

    def _heartbeat(self, now_s: float, m: MavMessage) -> None:
        self.autopilot, self.vehicle_type = m.autopilot, m.type
        self.armed = bool(m.base_mode & _ARMED)
        self.mode = mode_words(m.autopilot, m.type, m.base_mode, m.custom_mode)
        if now_s - self._own_state[1] > _HEARTBEAT_S:
            self._own_state = ("", -math.inf)

    def _sys_status(self, now_s: float, m: MavMessage) -> None:
        self.health = (
            m.onboard_control_sensors_present,
            m.onboard_control_sensors_enabled,
            m.onboard_control_sensors_health,
        )
        if self._board.believed(now_s, "battery", 1):
            voltage = math.nan if m.voltage_battery == 65535 else m.voltage_battery / 1e3
            self._battery_is(voltage, m.current_battery, m.battery_remaining)

    def _battery(self, now_s: float, m: MavMessage) -> None:
        if m.id != 0 or not self._board.believed(now_s, "battery", 0):
            return
        cells = [v for v in (*m.voltages, *(v for v in m.voltages_ext if v)) if v != 65535]
        self._battery_is(sum(cells) / 1e3 if cells else math.nan, m.current_battery, m.battery_remaining)
        self.battery_left_s = float(m.time_remaining) if m.time_remaining > 0 else math.nan

    def _battery_is(self, voltage: float, current_cA: int, percent: int) -> None:
        self._board.put("battery", "battery_voltage", [voltage])
        self._board.put("battery", "battery_current", [math.nan if current_cA < 0 else current_cA / 100.0])
        self._board.put("battery", "battery_charge", [math.nan if percent < 0 else percent / 100.0])

    def _extended_state(self, now_s: float, m: MavMessage) -> None:
        self.landed_state = m.landed_state

    def _quaternion(self, now_s: float, m: MavMessage) -> None:
        if self._board.believed(now_s, "attitude", 1):
            self._board.put("attitude", "estimated_attitude", _euler(m.q1, m.q2, m.q3, m.q4))
            self._board.put("attitude", "estimated_rates", (m.rollspeed, m.pitchspeed, m.yawspeed))

    def _global_origin(self, now_s: float, m: MavMessage) -> None:
        if _on_earth(m.latitude, m.longitude):
            self.origin = Origin(m.latitude / 1e7, m.longitude / 1e7, m.altitude / 1e3)

    def _home(self, now_s: float, m: MavMessage) -> None:
        if self.origin is None:
            self._global_origin(now_s, m)

    def _global_position(self, now_s: float, m: MavMessage) -> None:
        """Metres from the origin, or from the first fix."""
        if (m.lat, m.lon) == (0, 0) or not _on_earth(m.lat, m.lon):
            return  # no fix yet
        latitude, longitude = m.lat / 1e7, m.lon / 1e7
        if self.origin is None:
            self.origin = Origin(latitude, longitude, (m.alt - m.relative_alt) / 1e3)
        if not self._board.believed(now_s, "position", 1):
            return
        self._board.put(
            "position", "estimated_position", self.origin.to_local(latitude, longitude, m.alt / 1e3)
        )
        self._board.put("position", "estimated_velocity", (m.vx / 100.0, m.vy / 100.0, m.vz / 100.0))

    def _position_target(self, now_s: float, m: MavMessage) -> None:
        if m.coordinate_frame != 1:
            return
        self._board.believed(now_s, "reference", 0)
        given = [
            math.nan if m.type_mask >> k & 1 else v for k, v in enumerate((m.x, m.y, m.z, m.vx, m.vy, m.vz))
        ]
        self._board.put("reference", "reference_position", given[:3])
        self._board.put("reference", "reference_velocity", given[3:])

    def _attitude_target(self, now_s: float, m: MavMessage) -> None:
        self._board.believed(now_s, "reference_attitude", 0)
        angles = (math.nan,) * 3 if m.type_mask & 128 else _euler(*m.q)
        self._board.put("reference_attitude", "reference_attitude", angles)

    def _actuators(self, now_s: float, m: MavMessage) -> None:
        # The order of the outputs is ours; another vehicle's may mean anything.
        if self.vehicle_type == _COAXIAL and m.active >= 4 and self._board.believed(now_s, "actuators", 0):
            self._board.put("actuators", "motor_input", m.actuator[:2])
            self._board.put("actuators", "servo_input", m.actuator[2:4])

    def _servo_outputs(self, now_s: float, m: MavMessage) -> None:
        if m.port == 0 and self._board.believed(now_s, "actuators", 1):
            pulses = (m.servo1_raw, m.servo2_raw)
            self._board.put(
                "actuators", "motor_input", [(p - 1000) / 1000 if p else math.nan for p in pulses]
            )

    def _rpm(self, now_s: float, m: MavMessage) -> None:
        for key, signal, factor in RPM.get(m.index, ()):
            self._board.believed(now_s, f"rpm {m.index}", 0)
            self._board.set(f"rpm {m.index}", self._board.index[signal], getattr(m, key) * factor)

    def _ring(self, now_s: float, m: MavMessage) -> None:
        if self._board.believed(now_s, "ranges", 0):
            self._ranges_are(
                read_ring(m, float(self._board.values[self._board.index["estimated_attitude_yaw"]]))
            )

    def _distance(self, now_s: float, m: MavMessage) -> None:
        if m.orientation < 8 and self._board.believed(now_s, "ranges", 1):
            self._ranges_are(read_distance(m, self.ranges))

    def _ranges_are(self, ranges: Ranges) -> None:
        self.ranges = ranges
        beams = self._board.columns["range"].stop - self._board.columns["range"].start
        kept = ranges.ranges if len(ranges.ranges) <= beams else unknown(0)
        self._board.put("ranges", "range", [*kept, *unknown(beams - len(kept))])

    def _debug_array(self, now_s: float, m: MavMessage) -> None:
        if m.name != "truth":
            return
        self.simulated = True
        self._board.believed(now_s, "truth", 0)
        at = 0
        for name in ("position", "velocity", "attitude", "rates", "rotor_speed"):
            columns = self._board.columns[f"truth_{name}"]
            width = columns.stop - columns.start
            self._board.put("truth", f"truth_{name}", m.data[at : at + width])
            at += width
        self._board.put("truth", "wind", m.data[at : at + 3])

    def _named_int(self, now_s: float, m: MavMessage) -> None:
        if m.name == "mstate":
            known = 0 <= m.value < len(STATES)
            self._own_state = (STATES[m.value] if known else f"state {m.value}", now_s)
        elif m.name == "command":
            self.commander = m.value

    def _mission_current(self, now_s: float, m: MavMessage) -> None:
        self.mission_current = m.seq


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
