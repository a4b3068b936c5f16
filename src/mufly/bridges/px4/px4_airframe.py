"""Airframe file of PX4 for a coaxial micro helicopter: frame, gains, estimator and limits of a vehicle file.

PX4's control allocation has a coaxial helicopter with two motors of fixed pitch and a swash plate (CA_AIRFRAME 12)::

    output 1 = throttle - yaw     output 2 = throttle + yaw     servo_i = cos(angle_i) pitch - sin(angle_i) roll

mufly's servo 1 pitches the nose down and servo 2 rolls to the right, so their angles are 180 and 270 degrees with arms
of 1. More torque of the upper rotor yaws to the right, so the lower motor is output 1. PX4's meaning of the parameters:
https://docs.px4.io/main/en/advanced_config/parameter_reference.html
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import NamedTuple

from mufly.bridges.autopilot_gains import (
    GYRO_CUTOFF_HZ,
    GYRO_DERIVATIVE_CUTOFF_HZ,
    VELOCITY_DERIVATIVE_CUTOFF_HZ,
    AutopilotGains,
)
from mufly.bridges.px4.px4_messages import PositionSource
from mufly.dynamics import find_trim, hover_performance
from mufly.vehicle import Vehicle

AIRFRAME_NUMBER = 22001
"""Number of the airframe file, in the range that PX4 leaves to custom airframes."""
MOTOR_SPOOL_UP_TIME_S, RATE_INTEGRAL_LIMIT = 2.0, 0.15
_MEAN_OF_HALF_NORMAL = math.sqrt(2.0 / math.pi)


class Px4Parameter(NamedTuple):
    """Line of PX4's airframe file: name, value, and reason for the value."""

    name: str
    value: float
    reason: str


def airframe_file_name(vehicle: Vehicle) -> str:
    """Return the name of the airframe file, from which PX4 reads the number and the model of the airframe."""
    word = "".join(c if c.isalnum() else "_" for c in vehicle.name)
    return f"{AIRFRAME_NUMBER}_{word}"


def list_px4_parameters(
    vehicle: Vehicle, gains: AutopilotGains, position: PositionSource = "vision"
) -> list[Px4Parameter]:
    """Return the parameters of a vehicle, in the order of the airframe file.

    Parameters
    ----------
    vehicle : Vehicle
    gains : AutopilotGains
        From :func:`mufly.bridges.autopilot_gains.design_autopilot_gains`.
    position : "vision" or "gps"
        Source of the position in flight.
    """
    return [
        *_frame_parameters(),
        *_gain_parameters(gains),
        *_limit_parameters(gains),
        *_estimator_parameters(vehicle, position),
        *_simulation_parameters(vehicle),
    ]


def _frame_parameters() -> Iterator[Px4Parameter]:
    yield Px4Parameter("MAV_TYPE", 3, "coaxial helicopter")
    yield Px4Parameter("CA_AIRFRAME", 12, "coaxial helicopter of fixed pitch")
    yield Px4Parameter("CA_SP0_COUNT", 2, "servos of the swash plate")
    for k, (angle, what) in enumerate(((180, "servo 1 pitches the nose down"), (270, "servo 2 rolls to the right"))):
        yield Px4Parameter(f"CA_SP0_ANG{k}", angle, what)
        yield Px4Parameter(f"CA_SP0_ARM_L{k}", 1, "full torque is full servo")
    outputs = ((101, "lower motor"), (102, "upper motor"), (201, "servo 1"), (202, "servo 2"))
    for k, (function, what) in enumerate(outputs, 1):
        yield Px4Parameter(f"PWM_MAIN_FUNC{k}", function, what)
    yield Px4Parameter("COM_SPOOLUP_TIME", MOTOR_SPOOL_UP_TIME_S, "time of the rotors to hover speed (s)")


def _gain_parameters(gains: AutopilotGains) -> Iterator[Px4Parameter]:
    for axis, limit in (("roll", "RR"), ("pitch", "PR"), ("yaw", "YR")):
        k, name = getattr(gains, axis), axis.upper()
        yield Px4Parameter(f"MC_{name}_P", k.angle, f"{axis} angle (1/s)")
        yield Px4Parameter(f"MC_{name}RATE_P", k.rate_proportional, f"{axis} rate")
        yield Px4Parameter(f"MC_{name}RATE_I", k.rate_integral, "")
        yield Px4Parameter(f"MC_{name}RATE_D", k.rate_derivative, "")
        yield Px4Parameter(f"MC_{limit}_INT_LIM", RATE_INTEGRAL_LIMIT, "trim; limits the wind-up on the floor")
    for name, k in (("XY", gains.roll), ("Z", gains.vertical)):
        yield Px4Parameter(f"MPC_{name}_P", k.position, "position (1/s)")
        yield Px4Parameter(f"MPC_{name}_VEL_P_ACC", k.velocity, "velocity (1/s)")
        yield Px4Parameter(f"MPC_{name}_VEL_I_ACC", k.velocity_integral, "")
        yield Px4Parameter(f"MPC_{name}_VEL_D_ACC", k.velocity_derivative, "")
    yield Px4Parameter("IMU_GYRO_CUTOFF", GYRO_CUTOFF_HZ, "as in the design of the gains (Hz)")
    yield Px4Parameter("IMU_DGYRO_CUTOFF", GYRO_DERIVATIVE_CUTOFF_HZ, "")
    yield Px4Parameter("MPC_VELD_LP", VELOCITY_DERIVATIVE_CUTOFF_HZ, "")
    yield Px4Parameter("MC_YAW_TQ_CUTOFF", 0, "the design has no filter here")


def _limit_parameters(gains: AutopilotGains) -> Iterator[Px4Parameter]:
    yield Px4Parameter("MPC_THR_HOVER", gains.hover_thrust, "mean motor input in hover on a half-full battery")
    yield Px4Parameter("MPC_USE_HTE", 0, "the hover thrust is that of the vehicle file")
    yield Px4Parameter("MPC_THR_MIN", 0.2, "")
    yield Px4Parameter("MPC_THR_MAX", 1, "")
    yield Px4Parameter("MPC_TILTMAX_AIR", 20, "(deg)")
    yield Px4Parameter("MPC_TILTMAX_LND", 12, "(deg)")
    for name, value in (
        ("MPC_XY_VEL_MAX", 1.0), ("MPC_XY_CRUISE", 0.6), ("MPC_VEL_MANUAL", 0.6), ("MPC_Z_VEL_MAX_UP", 0.6),
        ("MPC_Z_VEL_MAX_DN", 0.5), ("MPC_Z_V_AUTO_UP", 0.5), ("MPC_Z_V_AUTO_DN", 0.4), ("MPC_TKO_SPEED", 0.5),
        ("MPC_LAND_SPEED", 0.25),
    ):  # fmt: skip
        yield Px4Parameter(name, value, "indoor speed (m/s)")
    yield Px4Parameter("MPC_ACC_HOR", 1.0, "(m/s^2)")
    yield Px4Parameter("MPC_ACC_HOR_MAX", 1.5, "(m/s^2)")
    yield Px4Parameter("MPC_JERK_AUTO", 2.0, "(m/s^3)")
    yield Px4Parameter("MPC_TKO_RAMP_T", 1.0, "(s)")


def _estimator_parameters(vehicle: Vehicle, position: PositionSource) -> Iterator[Px4Parameter]:
    fix = None if vehicle.sensors is None else vehicle.sensors.position_fix
    delay_ms = 0.0 if fix is None else 1e3 * (float(fix.latency) + _MEAN_OF_HALF_NORMAL * float(fix.latency_jitter))
    yield Px4Parameter("EKF2_DELAY_MAX", max(200.0, math.ceil(1.3 * delay_ms)), "covers the latency of the fixes (ms)")
    if position == "gps":
        yield Px4Parameter("EKF2_GPS_DELAY", delay_ms, "mean latency of the fixes (ms)")
        return
    yield Px4Parameter("EKF2_EV_CTRL", 11, "position, height and heading of VISION_POSITION_ESTIMATE")
    yield Px4Parameter("EKF2_EV_DELAY", delay_ms, "mean latency of the fixes (ms)")
    if fix is not None:
        yield Px4Parameter("EKF2_EVP_NOISE", math.hypot(float(fix.noise), float(fix.drift)), "(m)")
        heading = math.hypot(float(fix.heading_noise), float(fix.heading_drift))
        yield Px4Parameter("EKF2_EVA_NOISE", max(heading, 0.05), "(rad)")
    yield Px4Parameter("EKF2_HGT_REF", 3, "height of the fixes")
    yield Px4Parameter("EKF2_GPS_CTRL", 0, "no GPS in a room")
    yield Px4Parameter("EKF2_BARO_CTRL", 0, "the downwash changes the pressure")
    yield Px4Parameter("EKF2_MAG_TYPE", 5, "steel and motors distort the field")
    yield Px4Parameter("SYS_HAS_GPS", 0, "")
    yield Px4Parameter("SYS_HAS_MAG", 0, "")
    yield Px4Parameter("COM_ARM_WO_GPS", 1, "")


def _simulation_parameters(vehicle: Vehicle) -> Iterator[Px4Parameter]:
    hover = hover_performance(vehicle)
    cells = max(1, round(float(vehicle.battery.nominal_voltage) / 3.6))
    # PX4 simulates a voltage that falls linearly over SIM_BAT_DRAIN: the line through those of hover at full and half.
    full_V = find_trim(vehicle, charge=1.0).battery_voltage_V
    drained = hover.endurance_s * hover.battery_current_A / float(vehicle.battery.capacity)
    empty_V = full_V - 2.0 * drained * (full_V - hover.battery_voltage_V)
    yield Px4Parameter("BAT1_N_CELLS", cells, "")
    yield Px4Parameter("BAT1_V_CHARGED", full_V / cells, "in hover, as the vehicle's battery (V)")
    yield Px4Parameter("BAT1_V_EMPTY", empty_V / cells, "")
    yield Px4Parameter("SIM_BAT_DRAIN", round(hover.endurance_s), "hovering time of a full battery (s)")
    yield Px4Parameter("SDLOG_PROFILE", 25, "logs the inputs of the actuators at their full rate")
    yield Px4Parameter("COM_RC_IN_MODE", 4, "no sticks")
    yield Px4Parameter("NAV_RCL_ACT", 0, "")
    yield Px4Parameter("NAV_DLL_ACT", 0, "")


def format_airframe_file(
    vehicle: Vehicle, gains: AutopilotGains, position: PositionSource = "vision", command: str = ""
) -> str:
    """Return the airframe file, a script that PX4 runs at its start, with one parameter per line.

    Parameters
    ----------
    vehicle, gains, position
        As for :func:`list_px4_parameters`.
    command : str
        Command that makes the file, for its head.
    """
    lines = [
        "#!/bin/sh",
        "#",
        f"# @name {vehicle.name}, coaxial micro helicopter",
        "# @type Coaxial Helicopter",
        "# @class Copter",
        "#",
        f"# Made by: {command}" if command else "# Made by mufly.",
        "# Predicted margins:",
    ]
    for m in gains.margins:
        lines.append(
            f"#   {m.axis}: gain {m.gain_margin_dB:.1f} dB, phase {m.phase_margin_deg:.0f} deg, "
            f"sensitivity {m.sensitivity:.2f}, crossover {m.crossover_rad_s:.1f} rad/s"
        )
    lines += ["", ". ${R}etc/init.d/rc.heli_defaults", ""]
    for name, value, reason in list_px4_parameters(vehicle, gains, position):
        text = f"param set-default {name} {_format_value(value)}"
        lines.append(f"{text}  # {reason}" if reason else text)
    return "\n".join(lines) + "\n"


def _format_value(value: float) -> str:
    """Return a number for PX4: integers without a point, others with four digits."""
    return str(int(value)) if float(value).is_integer() else f"{value:.4g}"
