"""Messages of PX4's simulator interface: sensors to PX4, inputs from PX4.

PX4 calls the simulator by TCP and both exchange MAVLink messages
(https://docs.px4.io/main/en/simulation/#simulator-mavlink-api):

======================== ========= ==================================================================================
message                  direction content
======================== ========= ==================================================================================
HIL_SENSOR               to PX4    accelerometers, gyroscopes, magnetometer, pressure, with the time of the simulation
VISION_POSITION_ESTIMATE to PX4    position fixes, published late as the vehicle file specifies
HIL_GPS                  to PX4    the same fixes as global positions
DISTANCE_SENSOR          to PX4    sonar
HIL_STATE_QUATERNION     to PX4    truth, which PX4 writes into its log and does not use
HIL_ACTUATOR_CONTROLS    from PX4  motor inputs 0..1, servo inputs -1..1, whether PX4 is armed
======================== ========= ==================================================================================

Assumptions: the fix sensor has no attitude except the heading, so roll and pitch of VISION_POSITION_ESTIMATE are zero.
The velocity of HIL_GPS is the difference of two successive fixes. PX4 simulates the battery itself.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from mufly.dynamics import body_to_ned_matrix
from mufly.dynamics.model_state import ATTITUDE_SLICE
from mufly.link.codec import GlobalOrigin, MavMessage, clip_to_integer, mavlink
from mufly.quantities.units import GRAVITY
from mufly.sensors import Reading, Readings, Truth
from mufly.vehicle import Vehicle

PositionSource = Literal["vision", "gps"]
"""Message of the position fixes."""

LOWER_OUTPUT, UPPER_OUTPUT, SERVO_1_OUTPUT, SERVO_2_OUTPUT = range(4)
"""Outputs of PX4's coaxial helicopter: motor that yaws left, motor that yaws right, servo 1, servo 2
(:mod:`mufly.bridges.px4.px4_airframe`)."""
OUTPUT_COUNT = 4
LOCKSTEP_FLAG = 1
"""Flag of HIL_ACTUATOR_CONTROLS: PX4's clock follows HIL_SENSOR."""

_INERTIAL_FIELD_BITS, _MAGNETIC_FIELD_BITS = 0b111_111, 0b111 << 6
_PRESSURE_FIELD_BITS = (1 << 9) | (1 << 11) | (1 << 12)  # pressure, its altitude, temperature
_PA_PER_HPA, _GAUSS_PER_T, _ZERO_CELSIUS_K = 100.0, 1e4, 273.15
_STANDARD_PRESSURE_PA, _BAROMETRIC_EXPONENT, _TEMPERATURE_LAPSE_HEIGHT_M = 101_325.0, 0.190263, 44_330.8
_DOWNWARD_SENSOR_ORIENTATION = 25  # MAV_SENSOR_ROTATION_PITCH_270
_GPS_ERROR_CM, _GPS_SATELLITES = 30, 10
_COVARIANCE_DIAGONAL_INDICES = (0, 6, 11, 15, 18, 20)  # of the upper right triangle of a 6 x 6 matrix


@dataclass(frozen=True, slots=True)
class ActuatorCommand:
    """Actuator outputs of PX4 (HIL_ACTUATOR_CONTROLS), which are inputs of the simulated vehicle.

    Attributes
    ----------
    time_us : int
        PX4's clock (microseconds), equal to that of the HIL_SENSOR it answers.
    outputs : (16,) array
        All outputs; motors 0..1, servos -1..1.
    is_armed, has_lockstep : bool
    """

    time_us: int
    outputs: NDArray[np.float64]
    is_armed: bool
    has_lockstep: bool

    @property
    def vehicle_inputs(self) -> NDArray[np.float64]:
        """Inputs of the vehicle: upper and lower motor (0..1), servo 1 and servo 2 (-1..1)."""
        return self.outputs[[UPPER_OUTPUT, LOWER_OUTPUT, SERVO_1_OUTPUT, SERVO_2_OUTPUT]]


def decode_actuator_command(message: MavMessage) -> ActuatorCommand:
    """Return the content of a HIL_ACTUATOR_CONTROLS."""
    return ActuatorCommand(
        int(message.time_usec),
        np.asarray(message.controls, dtype=np.float64),
        bool(message.mode & mavlink.MAV_MODE_FLAG_SAFETY_ARMED),
        bool(message.flags & LOCKSTEP_FLAG),
    )


class SensorMessageEncoder:
    """Encoder of readings as messages to PX4: each new reading once.

    Parameters
    ----------
    vehicle : Vehicle
    position : "vision" or "gps"
        Message of the position fixes.
    origin : GlobalOrigin
        Global position of N = E = D = 0.
    """

    def __init__(self, vehicle: Vehicle, position: PositionSource, origin: GlobalOrigin) -> None:
        self._position, self._origin, self._sonar = position, origin, None
        if vehicle.sensors is not None and vehicle.sensors.sonar is not None:
            sonar = vehicle.sensors.sonar
            self._sonar = (float(sonar.min_range), float(sonar.max_range), float(sonar.noise))
        self._covariance = _position_fix_covariance(vehicle)
        self._sent: dict[str, Reading] = {}
        self._last_fix: Reading | None = None

    def encode_readings(self, time_us: int, readings: Readings) -> list[MavMessage]:
        """Return the messages of one instant; HIL_SENSOR, which advances PX4's clock, is the last one."""
        out: list[MavMessage] = []
        if (fix := self._take_new_reading("position_fix", readings)) is not None:
            out += self._encode_position_fix(time_us, fix)
        if self._sonar is not None and (echo := self._take_new_reading("ground_distance", readings)) is not None:
            out.append(self._encode_sonar_echo(time_us, float(echo.value)))
        out.append(self._encode_inertial(time_us, readings))
        return out

    def _take_new_reading(self, name: str, readings: Readings) -> Reading | None:
        """Return a sensor's latest reading, marked as sent; None if it is invalid or was sent before."""
        reading = readings.latest.get(name)
        if reading is None or self._sent.get(name) is reading:
            return None
        self._sent[name] = reading
        return reading if reading.valid else None

    def _encode_inertial(self, time_us: int, readings: Readings) -> MavMessage:
        fields = _INERTIAL_FIELD_BITS
        field, pressure = (
            self._take_new_reading("magnetic_field", readings),
            self._take_new_reading("pressure", readings),
        )
        magnetic, pressure_hPa, height_m = np.zeros(3), 0.0, 0.0
        if field is not None:
            fields |= _MAGNETIC_FIELD_BITS
            magnetic = np.asarray(field.value) * _GAUSS_PER_T
        if pressure is not None:
            fields |= _PRESSURE_FIELD_BITS
            pressure_hPa = float(pressure.value) / _PA_PER_HPA
            ratio = max(float(pressure.value), 0.0) / _STANDARD_PRESSURE_PA
            height_m = _TEMPERATURE_LAPSE_HEIGHT_M * (1.0 - ratio**_BAROMETRIC_EXPONENT)
        celsius = float(readings["temperature"].value) - _ZERO_CELSIUS_K
        return mavlink.MAVLink_hil_sensor_message(
            time_us, *readings["acceleration"].value, *readings["rates"].value, *magnetic, pressure_hPa, 0.0,
            height_m, celsius, fields,
        )  # fmt: skip

    def _encode_position_fix(self, time_us: int, fix: Reading) -> list[MavMessage]:
        north, east, down, heading = (float(x) for x in fix.value)
        before, self._last_fix = self._last_fix, fix
        if self._position == "vision":
            heading = math.remainder(heading, 2.0 * math.pi)
            return [
                mavlink.MAVLink_vision_position_estimate_message(
                    time_us, north, east, down, 0.0, 0.0, heading, self._covariance
                )
            ]
        if before is None or fix.time_s <= before.time_s:
            return []
        velocity = (np.asarray(fix.value)[:3] - np.asarray(before.value)[:3]) / (fix.time_s - before.time_s)
        lat, lon, alt = self._origin.to_global(north, east, down)
        vn, ve, vd = (clip_to_integer(100.0 * v, -32767, 32767) for v in velocity)
        speed = clip_to_integer(100.0 * math.hypot(velocity[0], velocity[1]), 0, 65534)
        course = clip_to_integer(math.degrees(math.atan2(velocity[1], velocity[0])) % 360.0 * 100.0, 0, 35999)
        return [
            mavlink.MAVLink_hil_gps_message(
                time_us, 3, round(lat * 1e7), round(lon * 1e7), round(alt * 1e3), _GPS_ERROR_CM, _GPS_ERROR_CM,
                speed, vn, ve, vd, course, _GPS_SATELLITES,
            )
        ]  # fmt: skip

    def _encode_sonar_echo(self, time_us: int, distance_m: float) -> MavMessage:
        assert self._sonar is not None
        least, most, noise = (round(100.0 * x) for x in self._sonar)
        return mavlink.MAVLink_distance_sensor_message(
            time_us // 1000 % 2**32, least, most, clip_to_integer(100.0 * distance_m, 0, 65535),
            mavlink.MAV_DISTANCE_SENSOR_ULTRASOUND, 0, _DOWNWARD_SENSOR_ORIENTATION, min(max(noise * noise, 1), 255),
        )  # fmt: skip

    def encode_truth(self, time_us: int, truth: Truth, acceleration: NDArray[np.float64]) -> MavMessage:
        """Return HIL_STATE_QUATERNION; ``acceleration`` is the specific force in body axes (m/s^2)."""
        lat, lon, alt = self._origin.to_global(*(float(x) for x in truth.position))
        turn = body_to_ned_matrix(truth.state[ATTITUDE_SLICE])
        through_air = turn.T @ (truth.velocity - truth.wind)
        vx, vy, vz = (clip_to_integer(100.0 * v, -32767, 32767) for v in truth.velocity)
        ax, ay, az = (clip_to_integer(1000.0 * a / GRAVITY, -32767, 32767) for a in acceleration)
        speed = clip_to_integer(100.0 * float(np.linalg.norm(through_air)), 0, 65535)
        return mavlink.MAVLink_hil_state_quaternion_message(
            time_us, list(truth.state[ATTITUDE_SLICE]), *truth.rates, round(lat * 1e7), round(lon * 1e7),
            round(alt * 1e3), vx, vy, vz, speed, speed, ax, ay, az,
        )  # fmt: skip


def _position_fix_covariance(vehicle: Vehicle) -> list[float]:
    """Return the covariance of the position fix for its message: the sensor's noise and drift, without correlation."""
    out = [0.0] * 21
    fix = None if vehicle.sensors is None else vehicle.sensors.position_fix
    if fix is None:
        return [math.nan] * 21
    place = float(fix.noise) ** 2 + float(fix.drift) ** 2
    heading = float(fix.heading_noise) ** 2 + float(fix.heading_drift) ** 2
    for k, variance in zip(_COVARIANCE_DIAGONAL_INDICES, (place, place, place, heading, heading, heading), strict=True):
        out[k] = variance
    return out
