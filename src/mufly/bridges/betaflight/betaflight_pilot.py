"""Simulated pilot who holds position and height by the sticks of a transmitter, because Betaflight does not.

The outer loops of :mod:`mufly.bridges.autopilot_gains`, with x, v the true position and velocity (an ideal motion
capture; faults of the vehicle's position fix have no effect here)::

    v_sp = v_ref + P_x (x_ref - x)        a_sp = P_v (v_sp - v) + I_v int (v_sp - v) dt - D_v dv/dt
    roll = a_right / g    nose down = a_forward / g    yaw rate = P_angle (yaw_0 - yaw)
    motors = hover (1 + a_up / g) V_hover / V

V is the measured voltage of the battery, low-passed, so that a full battery lifts no more than a half-full one.
The design assumes a lag of x and v of :data:`~mufly.bridges.autopilot_gains.POSITION_ESTIMATE_LAG_S`; here it is one
period. Channels: roll, pitch, throttle, yaw, switch of ARM, switch of ANGLE, as the CLI file of
:mod:`mufly.bridges.betaflight.betaflight_settings` reads them.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from mufly.bridges.autopilot_gains import VELOCITY_DERIVATIVE_CUTOFF_HZ, AutopilotGains, CascadeGains
from mufly.bridges.betaflight.betaflight_messages import (
    MAX_PULSE_US,
    MIN_PULSE_US,
    PULSE_CENTRE_US,
    PULSE_HALF_RANGE_US,
)
from mufly.bridges.betaflight.betaflight_settings import (
    ANGLE_LIMIT_DEG,
    LOW_THROTTLE_US,
    MOTOR_IDLE,
    PILOT_RATE_HZ,
    YAW_RATE_LIMIT_DEG_S,
)
from mufly.quantities.units import GRAVITY
from mufly.sensors import Readings, Truth

_Array = NDArray[np.float64]

PilotPhase = Literal["ready", "arming", "spool-up", "take-off", "hover", "square", "landing", "landed"]
DISARMED_TIME_S, ARMING_RETRY_TIME_S = 0.5, 2.0
"""Time of the switch ARM off before arming, and on before it is switched off and on again (s)."""
MOTOR_SPOOL_UP_TIME_S = 2.0
"""Time in which the throttle rises to that of hover (s)."""
MAX_TILT_DEG = 12.0
MAX_LANDED_HEIGHT_M = 0.015
"""Height above the start below which the vehicle has landed (m)."""
_MAX_VELOCITY_M_S, _MAX_TRIM_ACCELERATION_M_S2, _MAX_CLIMB_ACCELERATION_M_S2 = 0.6, 1.5, 3.0
_ARM_CHANNEL = 4
_VOLTAGE_FILTER_S = 1.0
_LANDING_REFERENCE_DEPTH_M = 0.15  # of the reference at the end of a landing


REST_PULSES_US = np.array([PULSE_CENTRE_US, PULSE_CENTRE_US, MIN_PULSE_US, PULSE_CENTRE_US, MIN_PULSE_US, MAX_PULSE_US])
"""Channels of a disarmed vehicle: sticks in the middle, no throttle, ARM off, ANGLE on."""


@dataclass(frozen=True, slots=True)
class PilotPlan:
    """Flight of the pilot: take-off, hover, a square, landing.

    Attributes
    ----------
    height_m : float
        Height above the start.
    hover_s : float
    square_side_m : float
        Side of the square, flown north first and clockwise; 0: no square.
    leg_duration_s : float
        Time of one side (s).
    climb_m_s, sink_m_s : float
        Largest speed of the take-off, and speed of the landing.
    """

    height_m: float = 0.6
    hover_s: float = 10.0
    square_side_m: float = 1.0
    leg_duration_s: float = 6.0
    climb_m_s: float = 0.3
    sink_m_s: float = 0.25

    @property
    def take_off_duration_s(self) -> float:
        """Duration of the take-off (s); the climb velocity peaks at ``climb_m_s``, twice its mean."""
        return 2.0 * self.height_m / self.climb_m_s


class _CascadeAxis:
    """Position and velocity loop of one axis."""

    def __init__(self, gains: CascadeGains) -> None:
        self.gains = gains
        self._integral = 0.0
        self._smooth = math.nan

    def compute_acceleration_command(
        self, error_m: float, reference_m_s: float, velocity_m_s: float, *, hold: bool
    ) -> float:
        """Return the commanded acceleration of this axis (m/s^2); with ``hold`` the integral of the velocity error
        stays constant.
        """
        k, dt = self.gains, 1.0 / PILOT_RATE_HZ
        wanted = reference_m_s + k.position * error_m
        wanted = min(max(wanted, -_MAX_VELOCITY_M_S), _MAX_VELOCITY_M_S)
        if math.isnan(self._smooth):
            self._smooth = velocity_m_s
        cutoff = 2.0 * math.pi * VELOCITY_DERIVATIVE_CUTOFF_HZ
        slope = cutoff * (velocity_m_s - self._smooth)
        self._smooth += (1.0 - math.exp(-cutoff * dt)) * (velocity_m_s - self._smooth)
        if not hold:
            trim = self._integral + k.velocity_integral * (wanted - velocity_m_s) * dt
            self._integral = min(max(trim, -_MAX_TRIM_ACCELERATION_M_S2), _MAX_TRIM_ACCELERATION_M_S2)
        return k.velocity * (wanted - velocity_m_s) + self._integral - k.velocity_derivative * slope


class BetaflightPilot:
    """Simulated pilot who flies one flight by the sticks of a transmitter.

    Parameters
    ----------
    gains : AutopilotGains
        From :func:`mufly.bridges.betaflight.betaflight_settings.design_betaflight_gains`.
    plan : PilotPlan

    Attributes
    ----------
    phase : str
    phase_s : float
        Time since the phase began (s).
    reference : (3,) array
        Position N, E, D that the pilot holds (m).
    """

    def __init__(self, gains: AutopilotGains, plan: PilotPlan | None = None) -> None:
        self._gains, self.plan = gains, plan or PilotPlan()
        self.reset()

    def reset(self) -> None:
        """Return to the beginning of the flight: vehicle on the floor, not armed."""
        self.phase: PilotPhase = "ready"
        self.phase_s = 0.0
        self.reference = np.full(3, math.nan)
        self._reference_velocity = np.zeros(3)
        self._start, self._yaw = np.full(3, math.nan), math.nan
        self._horizontal = (_CascadeAxis(self._gains.roll), _CascadeAxis(self._gains.roll))
        self._vertical = _CascadeAxis(self._gains.vertical)
        self._voltage_V = math.nan

    @property
    def wants_arming(self) -> bool:
        """Whether the pilot has set the switch ARM or is about to set it."""
        return self.phase not in ("ready", "landed")

    def compute_channel_pulses(self, truth: Truth, readings: Readings, is_armed: bool) -> _Array:
        """Return the pulses of the first six channels (us); called at :data:`PILOT_RATE_HZ`.

        Parameters
        ----------
        truth : Truth
        readings : Readings
            Their battery voltage is used, where the vehicle has the sensor.
        is_armed : bool
            Whether Betaflight turns the motors.
        """
        self.phase_s += 1.0 / PILOT_RATE_HZ
        if np.isnan(self._start[0]):
            self._start, self._yaw = truth.position.copy(), float(truth.attitude[2])
        self._filter_voltage(readings)
        self._advance_phase(truth, is_armed)
        if self.phase in ("ready", "arming", "landed"):
            pulses = REST_PULSES_US.copy()
            if self.phase == "arming" and self.phase_s < ARMING_RETRY_TIME_S - DISARMED_TIME_S:
                pulses[_ARM_CHANNEL] = MAX_PULSE_US
            return pulses
        self._set_phase_reference()
        return self._compute_flight_pulses(truth)

    # The flight

    def _enter_phase(self, phase: PilotPhase) -> None:
        self.phase, self.phase_s = phase, 0.0

    def _advance_phase(self, truth: Truth, is_armed: bool) -> None:
        plan, height_m = self.plan, float(self._start[2] - truth.position[2])
        if self.phase == "ready" and self.phase_s >= DISARMED_TIME_S:
            self._enter_phase("arming")
        elif self.phase == "arming":
            if is_armed:
                self._enter_phase("spool-up")
            elif self.phase_s >= ARMING_RETRY_TIME_S:
                self.phase_s = 0.0
        elif not is_armed and self.phase not in ("ready", "landed"):
            self._enter_phase("landed")
        elif self.phase == "spool-up" and self.phase_s >= MOTOR_SPOOL_UP_TIME_S:
            self._enter_phase("take-off")
        elif self.phase == "take-off" and self.phase_s >= plan.take_off_duration_s:
            self._enter_phase("hover")
        elif self.phase == "hover" and self.phase_s >= plan.hover_s:
            self._enter_phase("square" if plan.square_side_m > 0.0 else "landing")
        elif self.phase == "square" and self.phase_s >= 4.0 * plan.leg_duration_s:
            self._enter_phase("landing")
        elif self.phase == "landing" and (
            height_m < MAX_LANDED_HEIGHT_M
            or self.phase_s >= (plan.height_m + _LANDING_REFERENCE_DEPTH_M) / plan.sink_m_s
        ):
            self._enter_phase("landed")

    def _set_phase_reference(self) -> None:
        """Set the reference position and velocity for the present phase of the flight."""
        plan, place, speed = self.plan, self._start.copy(), np.zeros(3)
        if self.phase == "take-off":
            share, rate = _smooth_path_fraction(self.phase_s, plan.take_off_duration_s)
            place[2] -= plan.height_m * share
            speed[2] = -plan.height_m * rate
        elif self.phase in ("hover", "square"):
            place[2] -= plan.height_m
        elif self.phase == "landing":
            place[2] -= plan.height_m - plan.sink_m_s * self.phase_s
            speed[2] = plan.sink_m_s
        if self.phase == "square":
            offset, drift = sample_square_path(plan, self.phase_s)
            place[:2] += offset
            speed[:2] = drift
        self.reference, self._reference_velocity = place, speed

    def _filter_voltage(self, readings: Readings) -> None:
        reading = readings.latest.get("battery_voltage")
        voltage_V = self._gains.hover_voltage_V if reading is None or not reading.valid else float(reading.value)
        if math.isnan(self._voltage_V):
            self._voltage_V = voltage_V
        self._voltage_V += (voltage_V - self._voltage_V) / (_VOLTAGE_FILTER_S * PILOT_RATE_HZ)

    def _compute_flight_pulses(self, truth: Truth) -> _Array:
        on_floor = self.phase == "spool-up"
        error = self.reference - truth.position
        north, east = (
            axis.compute_acceleration_command(
                float(error[k]), float(self._reference_velocity[k]), float(truth.velocity[k]), hold=on_floor
            )
            for k, axis in enumerate(self._horizontal)
        )
        up = self._vertical.compute_acceleration_command(
            -float(error[2]), -float(self._reference_velocity[2]), -float(truth.velocity[2]), hold=on_floor
        )
        up = min(max(up, -_MAX_CLIMB_ACCELERATION_M_S2), _MAX_CLIMB_ACCELERATION_M_S2)
        yaw = float(truth.attitude[2])
        forward = math.cos(yaw) * north + math.sin(yaw) * east
        right = math.cos(yaw) * east - math.sin(yaw) * north
        tilt = math.radians(MAX_TILT_DEG)
        roll, down = (0.0 if on_floor else min(max(a / GRAVITY, -tilt), tilt) for a in (right, forward))
        hover = self._gains.hover_thrust * self._gains.hover_voltage_V / self._voltage_V
        motors = hover * (min(0.9, self.phase_s / MOTOR_SPOOL_UP_TIME_S) if on_floor else 1.0 + up / GRAVITY)
        turn_deg_s = math.degrees(self._gains.yaw.angle * (self._yaw - yaw))
        throttle = min(max((motors - MOTOR_IDLE) / (1.0 - MOTOR_IDLE), 0.0), 1.0)
        limit = math.radians(ANGLE_LIMIT_DEG)
        sticks = np.clip([roll / limit, down / limit, turn_deg_s / YAW_RATE_LIMIT_DEG_S], -1.0, 1.0)
        pulses = PULSE_CENTRE_US + PULSE_HALF_RANGE_US * sticks
        throttle_us = LOW_THROTTLE_US + (MAX_PULSE_US - LOW_THROTTLE_US) * throttle
        return np.array([pulses[0], pulses[1], throttle_us, pulses[2], MAX_PULSE_US, MAX_PULSE_US])


def sample_square_path(plan: PilotPlan, time_s: float) -> tuple[_Array, _Array]:
    """Return the commanded position N, E (m) relative to the square's first corner, and the commanded velocity (m/s).

    The velocity is zero in the corners.
    """
    corners = plan.square_side_m * np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0], [0.0, 0.0]])
    leg = min(int(time_s / plan.leg_duration_s), 3)
    share, rate = _smooth_path_fraction(time_s - leg * plan.leg_duration_s, plan.leg_duration_s)
    way = corners[leg + 1] - corners[leg]
    return corners[leg] + way * share, way * rate


def _smooth_path_fraction(time_s: float, length_s: float) -> tuple[float, float]:
    """Return the fraction (0..1) of a path flown smoothly from rest to rest, and the fraction's rate (1/s)."""
    turn = 2.0 * math.pi * min(time_s / length_s, 1.0)
    return (turn - math.sin(turn)) / (2.0 * math.pi), (1.0 - math.cos(turn)) / length_s
