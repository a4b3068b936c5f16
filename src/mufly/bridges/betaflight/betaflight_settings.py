"""CLI file of Betaflight for a coaxial micro helicopter: mixer, gains, filters, switches and limits of a vehicle file.

Betaflight has the mixer DUALCOPTER: two motors of fixed pitch, which yaw by their difference, and two servos, pitch and
roll. With the error of a rate in deg/s, and u the input of an actuator::

    sum = 0.032029 P error + 0.244381 I int error dt - 0.000529 D d(rate)/dt      (integral of yaw: times 2.5)
    servo: u = 0.7 sum / 500        motors: u = (1 - idle) sum / 1000, upper plus, lower minus

So its integers are the gains of :mod:`mufly.bridges.autopilot_gains`, divided by these scales. Its angle mode is the
cascade of that module, and a low pass of :data:`ATTITUDE_CUTOFF_HZ` besides, which the design contains as a delay.
Betaflight holds no position here: :mod:`mufly.bridges.betaflight.betaflight_pilot` does.

Meaning and units: https://betaflight.com/docs/wiki and the source of Betaflight 4.6, of which no code is copied.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import NamedTuple

from mufly.bridges.autopilot_gains import (
    GYRO_CUTOFF_HZ,
    GYRO_DERIVATIVE_CUTOFF_HZ,
    AutopilotGains,
    CascadeGains,
    design_autopilot_gains,
)
from mufly.errors import MuflyError
from mufly.vehicle import Vehicle

MOTOR_IDLE = 0.05
"""Input of the motors at no throttle while armed."""
ANGLE_LIMIT_DEG, YAW_RATE_LIMIT_DEG_S = 20.0, 90.0
"""Commands of full sticks: roll and pitch (deg), yaw (deg/s)."""
LOW_THROTTLE_US = 1050.0
"""Pulse below which the throttle counts as low, and at which it begins to act (us)."""
ATTITUDE_CUTOFF_HZ = 50.0
"""Cut-off of Betaflight's low pass of third order in the angle mode."""
PILOT_RATE_HZ = 100.0
"""Rate of the commands of :mod:`mufly.bridges.betaflight.betaflight_pilot`."""
RATE_INTEGRAL_LIMIT = 0.15
"""Largest integral of a rate, as an input of an actuator: trim; it limits the wind-up on the floor."""
_THIRD_ORDER_FACTOR = 1.0 / math.sqrt(2.0 ** (1.0 / 3.0) - 1.0)  # cut-off of one of three equal stages
ANGLE_DELAY_S = max(3.0 / (2.0 * math.pi * ATTITUDE_CUTOFF_HZ * _THIRD_ORDER_FACTOR), 1.0 / PILOT_RATE_HZ)
"""Delay of the loops of the angles: of the low pass in roll and pitch, of the pilot in yaw; the longer one (s)."""
_PID_SUM_PER_P, _PID_SUM_PER_I, _PID_SUM_PER_D, _YAW_I_FACTOR = 0.032029, 0.244381, 0.000529, 2.5
_SERVO_INPUT_PER_PID_SUM, _MOTOR_INPUT_PER_PID_SUM = 0.7 / 500.0, (1.0 - MOTOR_IDLE) / 1000.0
_MAX_RATE_GAIN, _MAX_ANGLE_GAIN = 250, 200
_PID_SUM_LIMIT, _YAW_PID_SUM_LIMIT = 500, 750
_PITCH_SERVO_INDEX, _ROLL_SERVO_INDEX = 4, 5


class BetaflightLine(NamedTuple):
    """Line of a CLI file: command, reason."""

    command: str
    reason: str = ""


class IntegerRateGains(NamedTuple):
    """Betaflight's integer gains of the controller of one body rate."""

    P: int
    I: int
    D: int


def design_betaflight_gains(vehicle: Vehicle) -> AutopilotGains:
    """Design the gains of Betaflight's angle mode and of mufly's simulated pilot, by :func:`design_autopilot_gains`.

    Raises
    ------
    MuflyError
        If the vehicle cannot hover, or no gains stabilise an axis.
    """
    return design_autopilot_gains(vehicle, angle_delay_s=ANGLE_DELAY_S)


def convert_rate_gains(axis: str, gains: CascadeGains) -> IntegerRateGains:
    """Convert the gains of one body-rate controller to Betaflight's integers.

    Parameters
    ----------
    axis : "roll", "pitch" or "yaw"
    gains : CascadeGains

    Raises
    ------
    MuflyError
        If a gain is beyond Betaflight's range.
    """
    per_sum = _MOTOR_INPUT_PER_PID_SUM if axis == "yaw" else _SERVO_INPUT_PER_PID_SUM
    per_error = per_sum * 180.0 / math.pi
    integral = _PID_SUM_PER_I * (_YAW_I_FACTOR if axis == "yaw" else 1.0)
    values = (
        gains.rate_proportional / (per_error * _PID_SUM_PER_P), gains.rate_integral / (per_error * integral),
        gains.rate_derivative / (per_error * _PID_SUM_PER_D),
    )  # fmt: skip
    for name, value in zip(IntegerRateGains._fields, values, strict=True):
        if value > _MAX_RATE_GAIN + 0.5:
            raise MuflyError(
                f"the {axis} gain {name} is {value:.0f} in Betaflight's units, beyond its limit of {_MAX_RATE_GAIN}; "
                "the vehicle's actuator is too weak for it"
            )
    return IntegerRateGains(*(round(value) for value in values))


def list_betaflight_settings(gains: AutopilotGains) -> list[BetaflightLine]:
    """Return the settings of the CLI file, without the commands that begin and save the batch.

    Parameters
    ----------
    gains : AutopilotGains
        From :func:`design_betaflight_gains`.
    """
    return [*_list_frame_settings(), *_list_gain_settings(gains), *_list_filter_settings(), *_list_limit_settings()]


def _list_frame_settings() -> Iterator[BetaflightLine]:
    yield BetaflightLine("mixer DUALCOPTER", "motors lower and upper, servos of pitch and roll")
    for servo, what in (
        (_PITCH_SERVO_INDEX, "servo 1 pitches the nose down"),
        (_ROLL_SERVO_INDEX, "servo 2 rolls to the right"),
    ):
        yield BetaflightLine(f"servo {servo} 1000 2000 1500 100 -1", f"{what}; not reversed")
    yield BetaflightLine("set yaw_motors_reversed = OFF", "the upper motor yaws to the right")
    yield BetaflightLine("feature -AIRMODE", "no control at zero throttle, so that the vehicle can stand")
    yield BetaflightLine("aux 0 0 0 1700 2100 0 0", "ARM on channel 5")
    yield BetaflightLine("aux 1 1 1 1700 2100 0 0", "ANGLE on channel 6")
    yield BetaflightLine("set acc_calibration = 0,0,0,1", "the simulated unit has no offset to calibrate")
    yield BetaflightLine("set motor_pwm_protocol = PWM")
    yield BetaflightLine("set min_command = 1000", "the outputs 1000 to 2000 are the motors' inputs 0 to 1")
    yield BetaflightLine("set max_throttle = 2000")
    yield BetaflightLine(f"set motor_idle = {round(1e4 * MOTOR_IDLE)}", "(0.01 %)")


def _list_gain_settings(gains: AutopilotGains) -> Iterator[BetaflightLine]:
    yield BetaflightLine("set simplified_pids_mode = OFF")
    for axis in ("roll", "pitch", "yaw"):
        for name, value in convert_rate_gains(axis, getattr(gains, axis))._asdict().items():
            yield BetaflightLine(f"set {name.lower()}_{axis} = {value}", f"{axis} rate" if name == "P" else "")
        yield BetaflightLine(f"set f_{axis} = 0")
        yield BetaflightLine(f"set d_max_{axis} = 0")
    angle = 0.5 * (gains.roll.angle + gains.pitch.angle)
    yield BetaflightLine(
        f"set angle_p_gain = {min(round(10.0 * angle), _MAX_ANGLE_GAIN)}", "angles (0.1/s), mean of roll and pitch"
    )
    yield BetaflightLine("set angle_feedforward = 0")


def _list_filter_settings() -> Iterator[BetaflightLine]:
    yield BetaflightLine("set gyro_lpf1_type = BIQUAD")
    yield BetaflightLine(f"set gyro_lpf1_static_hz = {GYRO_CUTOFF_HZ:.0f}", "as in the design of the gains")
    for name in ("simplified_gyro_filter", "simplified_dterm_filter"):
        yield BetaflightLine(f"set {name} = OFF")
    yield BetaflightLine("set dterm_lpf1_type = PT1")
    yield BetaflightLine(f"set dterm_lpf1_static_hz = {GYRO_DERIVATIVE_CUTOFF_HZ:.0f}")
    for name in (
        "gyro_lpf1_dyn_min_hz", "gyro_lpf2_static_hz", "dterm_lpf1_dyn_min_hz", "dterm_lpf2_static_hz",
        "yaw_lowpass_hz", "tpa_rate", "tpa_low_rate", "anti_gravity_gain", "throttle_boost",
        "feedforward_yaw_hold_gain", "angle_earth_ref",
    ):  # fmt: skip
        yield BetaflightLine(f"set {name} = 0", "not in the design" if name == "gyro_lpf1_dyn_min_hz" else "")
    yield BetaflightLine("set iterm_relax = OFF")
    yield BetaflightLine("set rc_smoothing = OFF")


def _list_limit_settings() -> Iterator[BetaflightLine]:
    yield BetaflightLine(f"set angle_limit = {ANGLE_LIMIT_DEG:.0f}", "angle of full sticks (deg)")
    yield BetaflightLine("set rates_type = ACTUAL", "linear sticks")
    for axis in ("roll", "pitch", "yaw"):
        for name in ("rc_rate", "srate"):
            yield BetaflightLine(f"set {axis}_{name} = {YAW_RATE_LIMIT_DEG_S / 10.0:.0f}", "(10 deg/s)")
        yield BetaflightLine(f"set {axis}_expo = 0")
    yield BetaflightLine("set thr_expo = 0")
    yield BetaflightLine("set thr_mid = 50")
    yield BetaflightLine("set thr_hover = 50", "linear throttle")
    yield BetaflightLine(f"set min_check = {LOW_THROTTLE_US:.0f}")
    yield BetaflightLine(f"set pidsum_limit = {_PID_SUM_LIMIT}")
    yield BetaflightLine(f"set pidsum_limit_yaw = {_YAW_PID_SUM_LIMIT}")
    windup = round(100.0 * RATE_INTEGRAL_LIMIT / (_SERVO_INPUT_PER_PID_SUM * _PID_SUM_LIMIT))
    yield BetaflightLine(f"set iterm_windup = {windup}", "trim; limits the wind-up on the floor (%)")
    yield BetaflightLine("set runaway_takeoff_prevention = OFF", "a vehicle of 100 g on its legs triggers it")
    yield BetaflightLine("set pwr_on_arm_grace = 0", "(s)")


def format_cli_file(vehicle: Vehicle, gains: AutopilotGains, command: str = "") -> str:
    """Return the text of the CLI file, with one setting per line; the file first resets all settings to their defaults.

    Parameters
    ----------
    vehicle : Vehicle
    gains : AutopilotGains
        From :func:`design_betaflight_gains`.
    command : str
        Command that makes the file, for its head.

    Raises
    ------
    MuflyError
        If a gain is beyond Betaflight's range.
    """
    lines = [f"# {vehicle.name}, coaxial micro helicopter, as Betaflight's DUALCOPTER"]
    lines += [f"# Made by: {command}"] if command else []
    lines.append("# Predicted margins:")
    for m in gains.margins:
        lines.append(
            f"#   {m.axis}: gain {m.gain_margin_dB:.1f} dB, phase {m.phase_margin_deg:.0f} deg, "
            f"sensitivity {m.sensitivity:.2f}, crossover {m.crossover_rad_s:.1f} rad/s"
        )
    lines += ["batch start", "defaults nosave"]
    for text, reason in list_betaflight_settings(gains):
        lines += [f"# {reason}"] if reason else []
        lines.append(text)
    return "\n".join([*lines, "batch end", "save"]) + "\n"
