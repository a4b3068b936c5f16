"""Parameter file of ArduPilot for a coaxial micro helicopter: frame and gains of a vehicle file.

The gains are those of PX4's cascades (:mod:`mufly.bridges.autopilot_gains`) in ArduPilot's scaling of its CoaxCopter:

- The surfaces move by the roll and pitch outputs divided by the throttle: rate gains are multiplied by that of hover.
- A yaw output of 1 changes each motor by a half, so yaw rate gains are doubled.
- The height has an inner loop of the acceleration, which PX4 lacks. Its gains follow ArduPilot's tuning guide: the
  hover throttle, and twice that for the integral. The predicted margins of the height do not hold for it.

Meaning of the parameters: https://ardupilot.org/copter/docs/parameters.html
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

from mufly.bridges.ardupilot.ardupilot_link import ARDUPILOT_RATE_HZ
from mufly.bridges.autopilot_gains import GYRO_CUTOFF_HZ, GYRO_DERIVATIVE_CUTOFF_HZ, AutopilotGains
from mufly.vehicle import Vehicle

COAX_FRAME_CLASS = 8
_FIRST_MOTOR_FUNCTION = 33
_OUTPUT_COUNT = 6


class ArduPilotParameter(NamedTuple):
    """Line of ArduPilot's parameter file: name, value, and reason for the value."""

    name: str
    value: float
    reason: str


def list_ardupilot_parameters(vehicle: Vehicle, gains: AutopilotGains) -> list[ArduPilotParameter]:
    """Return the parameters of a vehicle, in the order of the file.

    Parameters
    ----------
    vehicle : Vehicle
    gains : AutopilotGains
        From :func:`mufly.bridges.autopilot_gains.design_autopilot_gains`.
    """
    return [*_frame_parameters(), *_motor_parameters(vehicle, gains), *_gain_parameters(gains)]


def _frame_parameters() -> Iterator[ArduPilotParameter]:
    yield ArduPilotParameter("FRAME_CLASS", COAX_FRAME_CLASS, "two motors of fixed pitch, surfaces for roll and pitch")
    for k in range(1, _OUTPUT_COUNT + 1):
        yield ArduPilotParameter(f"SERVO{k}_FUNCTION", _FIRST_MOTOR_FUNCTION + k - 1, "")
        yield ArduPilotParameter(f"SERVO{k}_MIN", 1000, "")
        yield ArduPilotParameter(f"SERVO{k}_MAX", 2000, "")
        yield ArduPilotParameter(f"SERVO{k}_TRIM", 1500, "")
    yield ArduPilotParameter("SCHED_LOOP_RATE", ARDUPILOT_RATE_HZ, "")
    yield ArduPilotParameter("SIM_RATE_HZ", ARDUPILOT_RATE_HZ, "rate of mufly's simulation")


def _motor_parameters(vehicle: Vehicle, gains: AutopilotGains) -> Iterator[ArduPilotParameter]:
    yield ArduPilotParameter("MOT_PWM_MIN", 1000, "")
    yield ArduPilotParameter("MOT_PWM_MAX", 2000, "")
    yield ArduPilotParameter("MOT_SPIN_ARM", 0.05, "")
    yield ArduPilotParameter("MOT_SPIN_MIN", 0.0, "the design takes the output as the motor's input")
    yield ArduPilotParameter("MOT_SPIN_MAX", 1.0, "")
    yield ArduPilotParameter("MOT_THST_EXPO", 0.0, "")
    yield ArduPilotParameter("MOT_THST_HOVER", gains.hover_thrust, "mean motor input in hover on a half-full battery")
    yield ArduPilotParameter("MOT_HOVER_LEARN", 0, "")
    yield ArduPilotParameter("MOT_SPOOL_TIME", 2.0, "")
    yield ArduPilotParameter("BATT_LOW_VOLT", float(vehicle.battery.low_voltage), "")


def _gain_parameters(gains: AutopilotGains) -> Iterator[ArduPilotParameter]:
    for axis, word, scale in (
        ("roll", "RLL", gains.hover_thrust),
        ("pitch", "PIT", gains.hover_thrust),
        ("yaw", "YAW", 2.0),
    ):
        k = getattr(gains, axis)
        yield ArduPilotParameter(f"ATC_ANG_{word}_P", k.angle, f"{axis} angle (1/s)")
        yield ArduPilotParameter(f"ATC_RAT_{word}_P", scale * k.rate_proportional, f"{axis} rate")
        yield ArduPilotParameter(f"ATC_RAT_{word}_I", scale * k.rate_integral, "")
        yield ArduPilotParameter(f"ATC_RAT_{word}_D", scale * k.rate_derivative, "")
        yield ArduPilotParameter(f"ATC_RAT_{word}_IMAX", 0.15, "")
        yield ArduPilotParameter(f"ATC_RAT_{word}_FLTT", 0, "")
        yield ArduPilotParameter(f"ATC_RAT_{word}_FLTE", 0, "")
        yield ArduPilotParameter(f"ATC_RAT_{word}_FLTD", GYRO_DERIVATIVE_CUTOFF_HZ, "")
    yield ArduPilotParameter("INS_GYRO_FILTER", GYRO_CUTOFF_HZ, "as in the design of the gains (Hz)")
    level, vertical = gains.roll, gains.vertical
    yield ArduPilotParameter("PSC_POSXY_P", level.position, "position (1/s)")
    yield ArduPilotParameter("PSC_VELXY_P", level.velocity, "velocity (1/s)")
    yield ArduPilotParameter("PSC_VELXY_I", level.velocity_integral, "")
    yield ArduPilotParameter("PSC_VELXY_D", level.velocity_derivative, "")
    yield ArduPilotParameter("PSC_POSZ_P", vertical.position, "height (1/s)")
    yield ArduPilotParameter("PSC_VELZ_P", vertical.velocity, "")
    yield ArduPilotParameter("PSC_ACCZ_P", gains.hover_thrust, "rule of ArduPilot's tuning guide")
    yield ArduPilotParameter("PSC_ACCZ_I", 2.0 * gains.hover_thrust, "")
    yield ArduPilotParameter("ANGLE_MAX", 2000, "(0.01 deg)")
    yield ArduPilotParameter("WPNAV_SPEED", 60, "indoor speed (cm/s)")
    yield ArduPilotParameter("WPNAV_ACCEL", 100, "(cm/s^2)")
    yield ArduPilotParameter("LAND_SPEED", 30, "(cm/s)")


def format_parameter_file(vehicle: Vehicle, gains: AutopilotGains, command: str = "") -> str:
    """Return the text of ArduPilot's parameter file, with one parameter per line."""
    lines = [f"# {vehicle.name}, coaxial micro helicopter, as ArduPilot's CoaxCopter"]
    lines += [f"# Made by: {command}"] if command else []
    for name, value, reason in list_ardupilot_parameters(vehicle, gains):
        lines += [f"# {reason}"] if reason else []
        lines.append(f"{name},{value:.6g}")
    return "\n".join(lines) + "\n"
