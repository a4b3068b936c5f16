"""Sensors of a vehicle: the table ``[sensors]`` of a vehicle file, with an optional group for each sensor.

The sensor models (:mod:`mufly.sensors`) and docs/reference/sensors.md explain the parameters. The limits cover the
sensors of vehicles from a gram to 100 kg; error parameters may be zero.
"""

from __future__ import annotations

import math
from typing import Any

from pydantic import Field, model_validator

from mufly.files.input_files import make_validation_error
from mufly.quantities.units import GRAVITY
from mufly.vehicle.quantity import BodyPoints, ParameterGroup, Quantity, declare_parameter


class VibrationParameters(ParameterGroup):
    """Vibration of the board due to the rotors: amplitude in the direction of vibration at the hover speed."""

    once_per_rev: Quantity = declare_parameter(
        "m/s^2", "a1", "amplitude once per revolution of each rotor, from imbalance", at_least=0, at_most=2000
    )
    twice_per_rev: Quantity = declare_parameter(
        "m/s^2", "a2", "amplitude twice per revolution of each rotor, from its two blades", at_least=0, at_most=2000
    )
    blade_passing: Quantity = declare_parameter(
        "m/s^2", "ap", "amplitude at the passing frequency of the blades of both rotors", at_least=0, at_most=2000
    )
    resonance_frequency: Quantity = declare_parameter(
        "rad/s", "w_r", "resonance of the board on its mounting", at_least=1, at_most=1e6
    )
    damping_ratio: Quantity = declare_parameter(
        "1", "zeta_r", "damping ratio of that resonance", at_least=0.001, at_most=2
    )


DEFAULT_LEVEL_ERROR_RAD = math.radians(0.12)
"""Default tilt error of the standing helicopter (rad), 0.2 mm under a leg of 0.1 m."""

MAX_MOUNT_ANGLE_RAD = math.radians(30.0)
"""Largest angle of a mounting error (rad)."""


def _declare_mount_angle(symbol: str, axis: str) -> Any:
    return declare_parameter(
        "rad",
        symbol,
        f"mounting angle of the element about the body's {axis} axis; the filter assumes 0",
        at_least=-MAX_MOUNT_ANGLE_RAD,
        at_most=MAX_MOUNT_ANGLE_RAD,
        absent=0.0,
    )


class ImuParameters(ParameterGroup):
    sample_period: Quantity = declare_parameter(
        "s", "T_imu", "time between samples of the element", at_least=1e-5, at_most=0.01
    )
    bandwidth: Quantity = declare_parameter(
        "rad/s", "w_aa", "bandwidth of the low-pass filter before decimation", at_least=1, at_most=100000
    )
    accelerometer_range: Quantity = declare_parameter(
        "m/s^2", "a_max", "largest measured acceleration of an axis", above=GRAVITY, at_most=100000
    )
    accelerometer_noise_density: Quantity = declare_parameter(
        "m/s^2/sqrt(Hz)", "n_a", "density of white noise", at_least=0, at_most=10
    )
    accelerometer_bias: Quantity = declare_parameter(
        "m/s^2", "b_a", "bias at switching on, one sigma", at_least=0, at_most=50
    )
    accelerometer_drift: Quantity = declare_parameter(
        "m/s^2", "d_a", "drift of the bias, one sigma", at_least=0, at_most=50
    )
    gyro_range: Quantity = declare_parameter(
        "rad/s", "w_max", "largest measured rate of an axis", at_least=0.1, at_most=10000
    )
    gyro_noise_density: Quantity = declare_parameter(
        "rad/s/sqrt(Hz)", "n_g", "density of white noise", at_least=0, at_most=1
    )
    gyro_bias: Quantity = declare_parameter("rad/s", "b_g", "bias at switching on, one sigma", at_least=0, at_most=10)
    gyro_drift: Quantity = declare_parameter("rad/s", "d_g", "drift of the bias, one sigma", at_least=0, at_most=10)
    gyro_g_sensitivity: Quantity = declare_parameter(
        "rad/s/(m/s^2)",
        "s_g",
        "rate error per acceleration along the axis, one sigma",
        at_least=0,
        at_most=1,
    )
    drift_correlation_time: Quantity = declare_parameter(
        "s", "tau_b", "correlation time of both bias drifts", at_least=0.01, at_most=1e7
    )
    scale_error: Quantity = declare_parameter(
        "1", "e_s", "scale error of each axis, one sigma", at_least=0, at_most=0.2
    )
    misalignment: Quantity = declare_parameter("rad", "e_m", "of each axis, one sigma", at_least=0, at_most=0.2)
    accelerometer_temperature_coefficient: Quantity = declare_parameter(
        "m/s^2/K", "k_a", "bias per warming, one sigma", at_least=0, at_most=1
    )
    gyro_temperature_coefficient: Quantity = declare_parameter(
        "rad/s/K", "k_g", "bias per warming, one sigma", at_least=0, at_most=1
    )
    temperature_rise: Quantity = declare_parameter(
        "K", "dT", "final temperature rise of the board after switching on", at_least=0, at_most=200
    )
    temperature_time_constant: Quantity = declare_parameter(
        "s", "tau_T", "time constant of the warming", at_least=0.01, at_most=1e6
    )
    position: BodyPoints = declare_parameter(
        "m", "r_imu", "one point: position of the element, body axes", at_least=-10, at_most=10
    )
    standing_tilt_error: Quantity = declare_parameter(
        "rad",
        "s_level",
        "roll and pitch of the vehicle standing on its legs, one sigma each",
        at_least=0,
        at_most=0.2,
        absent=DEFAULT_LEVEL_ERROR_RAD,
    )
    mount_roll: Quantity = _declare_mount_angle("phi_m", "x")
    mount_pitch: Quantity = _declare_mount_angle("theta_m", "y")
    mount_yaw: Quantity = _declare_mount_angle("psi_m", "z")
    vibration: VibrationParameters

    @model_validator(mode="after")
    def _check_single_position(self) -> ImuParameters:
        if len(self.position.value) != 1:
            raise make_validation_error(
                f"has {len(self.position.value)} points", "give one point, [[x, y, z]]", "sensors.imu.position"
            )
        return self


class SonarParameters(ParameterGroup):
    period: Quantity = declare_parameter("s", "T_us", "between pulses", at_least=0.0001, at_most=10)
    cone_angle: Quantity = declare_parameter("rad", "beta_us", "full angle of the cone", at_least=0.001, below=3.0)
    min_range: Quantity = declare_parameter("m", "l_us_min", "shortest distance", at_least=0, at_most=100)
    max_range: Quantity = declare_parameter("m", "l_us_max", "greatest distance", at_least=0.01, at_most=100)
    resolution: Quantity = declare_parameter("m", "dl_us", "step of the reading", at_least=0, at_most=10)
    noise: Quantity = declare_parameter("m", "n_us", "one sigma before that", at_least=0, at_most=10)
    dropout_probability: Quantity = declare_parameter(
        "1", "p_us", "share of pulses without an echo", at_least=0, at_most=1
    )
    multipath_probability: Quantity = declare_parameter(
        "1", "p_mp", "share of echoes reflected by a second surface", at_least=0, at_most=1
    )
    position: BodyPoints = declare_parameter(
        "m", "r_us", "one point: position of the sonar, body axes; it points along z", at_least=-10, at_most=10
    )


class RingCameraParameters(ParameterGroup):
    """Omnidirectional camera that detects the spots of the laser ring; the beams are those of ``range_ring``."""

    period: Quantity = declare_parameter("s", "T_cam", "between pictures", at_least=0.0001, at_most=10)
    radial_pixels: int = Field(ge=8, le=4096, strict=True, description="pixels along a radius of the picture")
    angular_pixels: int = Field(ge=8, le=4096, strict=True, description="pixels around the picture")
    baseline: Quantity = declare_parameter(
        "m", "b_cam", "distance of the camera below the plane of the beams", at_least=0.001, at_most=10
    )
    min_range: Quantity = declare_parameter(
        "m", "l_cam_min", "shortest distance that is decoded", at_least=0.001, at_most=1000
    )
    max_range: Quantity = declare_parameter(
        "m", "l_cam_max", "greatest distance that is decoded", at_least=0.01, at_most=1000
    )
    spot_radius: Quantity = declare_parameter(
        "1", "s_cam", "radius of a spot, in pixels, one sigma", at_least=0.1, at_most=100
    )
    calibration_error: Quantity = declare_parameter(
        "1",
        "e_cam",
        "calibration error of each beam's spot, in pixels along the radius, one sigma",
        at_least=0,
        at_most=100,
    )
    spot_brightness: Quantity = declare_parameter(
        "1", "I_1", "brightness of a spot at 1 m, over the noise of a pixel", at_least=0.001, at_most=1e6
    )
    ambient_light: Quantity = declare_parameter(
        "1", "I_a", "mean of the ambient light, over the noise of a pixel", at_least=0, at_most=1e6
    )
    missed_spot_probability: Quantity = declare_parameter(
        "1", "p_cam", "share of spots lost on absorbing surfaces", at_least=0, at_most=1
    )


class PressureSensorParameters(ParameterGroup):
    period: Quantity = declare_parameter("s", "T_p", "between readings", at_least=0.0001, at_most=100)
    noise: Quantity = declare_parameter("Pa", "n_p", "one sigma", at_least=0, at_most=10000)
    drift: Quantity = declare_parameter("Pa", "d_p", "drift by weather and doors, one sigma", at_least=0, at_most=10000)
    drift_correlation_time: Quantity = declare_parameter(
        "s", "tau_p", "its correlation time", at_least=0.01, at_most=1e7
    )
    downwash_coefficient: Quantity = declare_parameter(
        "1", "k_p", "share of the disc loading that adds to the pressure at the port", at_least=-10, at_most=10
    )
    filter_delay: Quantity = declare_parameter("s", "T_dp", "of its filter", at_least=0, at_most=10)


class MagnetometerParameters(ParameterGroup):
    period: Quantity = declare_parameter("s", "T_m", "between readings", at_least=0.0001, at_most=100)
    noise: Quantity = declare_parameter("T", "n_m", "one sigma an axis", at_least=0, at_most=0.01)
    field_strength: Quantity = declare_parameter(
        "T", "B", "strength of the field in the room", at_least=1e-7, at_most=0.01
    )
    inclination: Quantity = declare_parameter(
        "rad", "I_B", "inclination of the field below the horizon", at_least=-1.58, at_most=1.58
    )
    distortion: Quantity = declare_parameter(
        "T", "d_m", "distortion of the field by steel in walls and floor, one sigma", at_least=0, at_most=0.01
    )
    distortion_correlation_length: Quantity = declare_parameter(
        "m", "L_m", "over which it changes", at_least=0.01, at_most=10000
    )
    hard_iron: Quantity = declare_parameter(
        "T", "h_m", "hard iron that remains after calibration, one sigma per axis", at_least=0, at_most=0.01
    )
    field_per_current: Quantity = declare_parameter(
        "T/A", "k_m", "field per supply current, one sigma per axis", at_least=0, at_most=0.001
    )


class RotorSpeedSensorParameters(ParameterGroup):
    """Rotor speed from the back-EMF of the motors."""

    period: Quantity = declare_parameter("s", "T_n", "between readings", at_least=0.0001, at_most=10)
    voltage_noise: Quantity = declare_parameter("V", "n_n", "noise of the voltage, one sigma", at_least=0, at_most=100)
    back_emf_constant_error: Quantity = declare_parameter(
        "1", "e_kE", "relative error of the back-EMF constant, one sigma", at_least=0, at_most=0.5
    )


class BatteryMonitorParameters(ParameterGroup):
    period: Quantity = declare_parameter("s", "T_bat", "between readings", at_least=0.0001, at_most=100)
    voltage_resolution: Quantity = declare_parameter("V", "dU", "step of the voltage", at_least=0, at_most=10)
    voltage_noise: Quantity = declare_parameter("V", "n_U", "one sigma", at_least=0, at_most=10)
    current_noise: Quantity = declare_parameter("A", "n_I", "one sigma", at_least=0, at_most=100)
    current_scale_error: Quantity = declare_parameter(
        "1", "e_I", "scale error of the current, one sigma", at_least=0, at_most=1
    )


class PositionFixParameters(ParameterGroup):
    """Position and heading fixes from visual SLAM or another low-rate source."""

    period: Quantity = declare_parameter("s", "T_x", "between fixes", at_least=0.001, at_most=100)
    latency: Quantity = declare_parameter("s", "L_x", "time from the picture to the fix", at_least=0, at_most=10)
    latency_jitter: Quantity = declare_parameter("s", "j_x", "jitter of the latency, one sigma", at_least=0, at_most=10)
    noise: Quantity = declare_parameter("m", "n_x", "white, one sigma an axis", at_least=0, at_most=100)
    drift: Quantity = declare_parameter("m", "d_x", "correlated error, one sigma per axis", at_least=0, at_most=100)
    drift_correlation_time: Quantity = declare_parameter(
        "s", "tau_x", "its correlation time", at_least=0.01, at_most=1e6
    )
    heading_noise: Quantity = declare_parameter("rad", "n_psi", "white, one sigma", at_least=0, at_most=3.2)
    heading_drift: Quantity = declare_parameter("rad", "d_psi", "correlated, one sigma", at_least=0, at_most=3.2)
    dropout_probability: Quantity = declare_parameter(
        "1", "p_x", "share of fixes that are missing", at_least=0, at_most=1
    )


class SensorSuite(ParameterGroup):
    """Sensors of a vehicle; absent groups are sensors that are not on board."""

    imu: ImuParameters | None = None
    sonar: SonarParameters | None = None
    ring_camera: RingCameraParameters | None = None
    pressure: PressureSensorParameters | None = None
    magnetometer: MagnetometerParameters | None = None
    rotor_speed: RotorSpeedSensorParameters | None = None
    battery: BatteryMonitorParameters | None = None
    position_fix: PositionFixParameters | None = None

    @model_validator(mode="after")
    def _check_range_limits(self) -> SensorSuite:
        for name in ("sonar", "ring_camera"):
            one = getattr(self, name)
            if one is not None and float(one.min_range) >= float(one.max_range):
                low, high = float(one.min_range), float(one.max_range)
                raise make_validation_error(
                    f"{low:g} m is not below max_range, {high:g} m",
                    "exchange them",
                    f"sensors.{name}.min_range",
                )
        if self.sonar is None:
            return self
        step, span = float(self.sonar.resolution), float(self.sonar.max_range) - float(self.sonar.min_range)
        if step > 0.5 * span:
            raise make_validation_error(
                f"{step:g} m leaves less than two steps between min_range and max_range",
                "give a smaller step",
                "sensors.sonar.resolution",
            )
        if len(self.sonar.position.value) != 1:
            raise make_validation_error(
                f"has {len(self.sonar.position.value)} points", "give one point, [[x, y, z]]", "sensors.sonar.position"
            )
        return self
