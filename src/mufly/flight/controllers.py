"""Controllers of a vehicle with their states: references and estimates in, motor and servo inputs out."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from mufly.compiled.numba_cache import cached_njit, view_record_as_array
from mufly.compiled.portable_math import sine_cosine
from mufly.control import (
    FlightController,
    heave_yaw_init,
    heave_yaw_step,
    limit_heave_reference,
    position_init,
    position_step,
    roll_pitch_init,
    roll_pitch_step,
)
from mufly.estimate import Estimate
from mufly.mission import TrajectoryLimits

_Array = NDArray[np.floating[Any]]


@dataclass(frozen=True, slots=True)
class Actuators:
    """Inputs of motors and servos.

    Attributes
    ----------
    motor_input : (2,) array
        Upper and lower motor (0..1).
    servo_input : (2,) array
        Servo 1 (positive: nose down), servo 2 (positive: to the right); -1..1.
    """

    motor_input: _Array
    servo_input: _Array
    _input_vector: list[_Array] = field(default_factory=list, init=False, repr=False, compare=False)

    @classmethod
    def make_zero_inputs(cls) -> Actuators:
        """Return zero inputs for all motors and servos."""
        return cls(np.zeros(2), np.zeros(2))

    @property
    def input_array(self) -> _Array:
        """Input (4,) of the flight model: motor upper, motor lower, servo 1, servo 2."""
        if not self._input_vector:  # cached for several calls a period
            self._input_vector.append(np.concatenate((self.motor_input, self.servo_input)))
        return self._input_vector[0]


HEAVE_YAW_TUNABLE = (
    "heave_bandwidth",
    "heave_acceleration",
    "heave_speed",
    "yaw_bandwidth",
    "yaw_acceleration",
    "yaw_rate",
)
POSITION_TUNABLE = ("position_gain", "speed_limit", "tilt_limit")
"""Parameters of the control law that may change in flight: limits, and gains outside the H-infinity controllers."""

GAIN_BLEND_TIME_CONSTANT_S = 0.5
"""Time constant of a change of parameters (s): a step of a gain would be a step of the output."""


def derive_trajectory_limits(controller: FlightController) -> TrajectoryLimits:
    """Return the limits of the controllers' reference filters and of the position cascade."""
    heave_yaw, position = controller.heave_yaw_gains, controller.position_gains
    speed = float(heave_yaw["heave_speed"])
    return TrajectoryLimits(
        speed=float(position["speed_limit"]),
        climb=speed,
        descent=speed,
        acceleration=float(position["tilt_limit"] * position["gravity"]),
        climb_acceleration=float(heave_yaw["heave_acceleration"]),
        yaw_rate=float(heave_yaw["yaw_rate"]),
        yaw_acceleration=float(heave_yaw["yaw_acceleration"]),
    )


class Controllers:
    """Heave-yaw, roll-pitch and position controllers of one vehicle, with their states.

    Parameters
    ----------
    design : FlightController
        Design from :func:`mufly.control.design_flight_controller`.
    """

    def __init__(self, design: FlightController) -> None:
        self._design = self._target = design
        self._settled = True
        self._heave_yaw: _Array = np.zeros(0)
        self._roll_pitch = roll_pitch_init(design.roll_pitch_gains, np.zeros(4))
        self._position = position_init(design.position_gains)
        self._boxed_of: FlightController | None = None
        self._boxes: tuple[NDArray[np.void], ...] = ()

    def retune_gains(self, design: FlightController) -> None:
        """Begin a smooth change to the gains of ``design``, which may differ from the present ones in tunable
        parameters only.
        """
        if self._settled:
            now = self._design
            self._design = replace(
                now,
                heave_yaw_gains=copy_record(now.heave_yaw_gains),
                position_gains=copy_record(now.position_gains),
            )
        self._target, self._settled = design, False

    @property
    def are_gains_settled(self) -> bool:
        """Whether all parameters have reached their targets."""
        return self._settled

    def _blend_gains(self) -> None:
        """Move the gains by one period towards those set by :meth:`retune_gains`, with a first-order lag."""
        blend = 1.0 - math.exp(-self._design.period_s / GAIN_BLEND_TIME_CONSTANT_S)
        far = False
        for mine, wanted, names in (
            (self._design.heave_yaw_gains, self._target.heave_yaw_gains, HEAVE_YAW_TUNABLE),
            (self._design.position_gains, self._target.position_gains, POSITION_TUNABLE),
        ):
            for name in names:
                gap = float(wanted[name]) - float(mine[name])
                mine[name] += blend * gap
                far = far or abs(gap) > 1e-4 * abs(float(wanted[name]))
        if not far:
            self._design, self._settled = self._target, True

    def engage_heave_yaw(self, estimate: Estimate, motor_input: _Array) -> None:
        """Start heave-yaw control with a bumpless transfer from ``motor_input`` (upper, lower; 0..1)."""
        self._heave_yaw = heave_yaw_init(
            self._design.heave_yaw_gains, _measure_heave_yaw(estimate), motor_input, estimate.battery_voltage
        )

    def engage_roll_pitch(self, estimate: Estimate) -> None:
        """Start roll-pitch and position control at lift-off, from neutral servos."""
        self._roll_pitch = roll_pitch_init(self._design.roll_pitch_gains, _measure_roll_pitch(estimate))
        self._position = position_init(self._design.position_gains)

    def compute_tilt_command(
        self, estimate: Estimate, position: _Array, velocity: _Array, acceleration: _Array
    ) -> _Array:
        """Advance the position cascade by one period of the cascade; return commands of roll and pitch.

        Parameters
        ----------
        estimate : Estimate
        position, velocity, acceleration : (3,) array
            References, N-E-D (m, m/s, m/s2).

        Returns
        -------
        (2,) array
            Roll and pitch commands (rad).
        """
        tilt, self._position = position_step(
            self._design.position_gains,
            self._position,
            position,
            velocity,
            acceleration,
            estimate.position,
            estimate.velocity,
            estimate.attitude[2],
        )
        return tilt

    def step(self, estimate: Estimate, heave_yaw: _Array, tilt: _Array | None) -> Actuators:
        """Advance heave-yaw control by one period, and roll-pitch control unless ``tilt`` is None.

        Parameters
        ----------
        estimate : Estimate
        heave_yaw : (4,) array
            References: z (m, down), psi (rad, continuous) and their rates.
        tilt : (2,) array or None
            References: roll, pitch (rad). None keeps the servos neutral: on its legs the helicopter cannot tilt,
            and the controller would wind up.

        Returns
        -------
        Actuators
        """
        if not self._settled:
            self._blend_gains()
        if self._boxed_of is not self._design:
            self._boxed_of = self._design
            self._boxes = (
                view_record_as_array(self._design.heave_yaw_gains),
                view_record_as_array(self._design.roll_pitch_gains),
            )
        motor, servo, self._heave_yaw, self._roll_pitch = _step_control_law(
            *self._boxes,
            self._heave_yaw,
            self._roll_pitch,
            heave_yaw,
            _ZERO_TILT_COMMAND if tilt is None else tilt,
            tilt is not None,
            estimate.position,
            estimate.velocity,
            estimate.attitude,
            estimate.rates,
            estimate.battery_voltage,
        )
        return Actuators(motor, servo)


_ZERO_TILT_COMMAND = np.zeros(2)


@cached_njit
def _step_control_law(
    heave_yaw_gains: Any,
    roll_pitch_gains: Any,
    heave_yaw: _Array,
    roll_pitch: _Array,
    reference: _Array,
    tilt: _Array,
    tilts: bool,
    position: _Array,
    velocity: _Array,
    attitude: _Array,
    rates: _Array,
    voltage: float,
) -> tuple[_Array, _Array, _Array, _Array]:
    """Advance heave-yaw and roll-pitch control by one period; return motor and servo inputs and the two states."""
    servo = np.zeros(2)
    if tilts:
        heave_yaw = limit_heave_reference(heave_yaw_gains[0], heave_yaw, position[2])
        forward = 0.0
        if roll_pitch_gains[0].schedule > 0.0:
            sine, cosine = sine_cosine(attitude[2])
            forward = cosine * velocity[0] + sine * velocity[1]
        measured = np.array([attitude[0], attitude[1], rates[0], rates[1], forward])
        servo, roll_pitch = roll_pitch_step(roll_pitch_gains[0], roll_pitch, tilt, measured)
    seen = np.array([position[2], attitude[2], rates[2]])
    motor, heave_yaw = heave_yaw_step(heave_yaw_gains[0], heave_yaw, reference, seen, voltage)
    return motor, servo, heave_yaw, roll_pitch


def copy_record(record: np.void) -> np.void:
    """Return a writable copy of a structured NumPy record."""
    own = np.zeros((), dtype=record.dtype)  # np.array(record) would share its memory
    own[...] = record
    return cast(np.void, own[()])


def _measure_heave_yaw(m: Estimate) -> _Array:
    return np.array([m.position[2], m.attitude[2], m.rates[2]])


def _measure_roll_pitch(m: Estimate) -> _Array:
    return np.array([m.attitude[0], m.attitude[1], m.rates[0], m.rates[1]])
