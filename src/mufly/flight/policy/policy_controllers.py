"""Controllers that fly a learned policy in place of the control law.

Flight software, mission logic and filter are unchanged. The policy acts from lift-off to touchdown whenever the mission
logic gives a reference position. H-infinity control acts on the floor until lift-off, and while a pilot commands the
tilt.

Every 20 ms the policy observes, as in the task ``hover`` (:mod:`mufly.flight.policy.observation`):

- error: reference position minus estimated position;
- velocity: estimated velocity minus reference velocity. A frame that moves with the reference is inertial while its
  velocity is constant: following it in still air is hovering in a wind of the opposite velocity;
- direction of gravity, rates and heading of the estimate; heading of the reference;
- measured battery voltage, its own last action, and height above the floor at N = E = D = 0.

Its inputs are held until the next action. The flight software limits their rate of change, as for every control law.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mufly.compiled.numba_cache import cached_njit
from mufly.compiled.portable_math import sine_cosine
from mufly.control import FlightController
from mufly.dynamics.model_state import SERVO_INPUT_SLICE
from mufly.errors import InputError
from mufly.estimate import Estimate
from mufly.files.answer_store import hash_inputs
from mufly.flight.controllers import Actuators, Controllers
from mufly.flight.policy.observation import (
    ACTION_SIZE,
    MAX_COLLECTIVE_DUTY_OFFSET,
    MAX_YAW_DUTY_OFFSET,
    OBS_TASK_INPUTS,
    fill_common_observation,
    map_action_to_inputs,
)
from mufly.flight.policy.policy_network import LearnedPolicy, PackedPolicy, evaluate_policy

_Array = NDArray[np.floating[Any]]

REF_VELOCITY_INDEX, REF_HEADING_INDEX = 3, 6
"""Indices of velocity and heading in a reference, which begins with the position."""


@cached_njit(error_model="numpy")
def step_policy(
    p: PackedPolicy, trim: _Array, nominal_V: float, position: _Array, velocity: _Array, attitude: _Array,
    rates: _Array, voltage: float, reference: _Array, action: _Array, inputs: _Array,
) -> None:  # fmt: skip
    """Run one step of a policy: compute its observation and action, and write the inputs of the flight model.

    Parameters
    ----------
    p : PackedPolicy
    trim : (4,) array
        Inputs for an action of zero.
    nominal_V : float
        Nominal voltage of the battery (V).
    position, velocity : (3,) array
        Estimate, N-E-D (m, m/s).
    attitude, rates : (3,) array
        Estimated roll, pitch, yaw (rad), and body rates (rad/s).
    voltage : float
        Battery voltage (V).
    reference : (7,) array
        Position and velocity, N-E-D (m, m/s), and heading (rad).
    action : (4,) array
        Last action, overwritten by the new one.
    inputs : (4,) array
        Output: motors upper, lower (0..1), servos 1, 2 (-1..1).
    """
    error, relative, seen = np.zeros(3), np.zeros(3), np.zeros(OBS_TASK_INPUTS)
    for i in range(3):
        error[i] = reference[i] - position[i]
        relative[i] = velocity[i] - reference[REF_VELOCITY_INDEX + i]
    sine_roll, cosine_roll = sine_cosine(attitude[0])
    sine_pitch, cosine_pitch = sine_cosine(attitude[1])
    sine_yaw, cosine_yaw = sine_cosine(attitude[2])
    sine_wanted, cosine_wanted = sine_cosine(reference[REF_HEADING_INDEX])
    down = (-sine_pitch, sine_roll * cosine_pitch, cosine_roll * cosine_pitch)
    fill_common_observation(
        seen, error, relative, down, rates, (cosine_yaw, sine_yaw), (cosine_wanted, sine_wanted),
        voltage / nominal_V, action, -position[2],
    )  # fmt: skip
    evaluate_policy(p, seen, action)
    map_action_to_inputs(action, trim, inputs)


def check_policy_fits_vehicle(policy: LearnedPolicy, vehicle_name: str, where: str) -> None:
    """Check that a policy can fly a vehicle; ``where`` names its source in errors.

    Raises
    ------
    InputError
        If it has another task than ``hover``, or was trained for another vehicle.
    """
    if policy.task != "hover":
        raise InputError(where, "task", f"{policy.task!r} cannot follow a mission", "give a policy of the task hover")
    if policy.vehicle_name != vehicle_name:
        raise InputError(
            where, "vehicle", f"trained for {policy.vehicle_name}, not for {vehicle_name}",
            f"fly {policy.vehicle_name}, or train a policy for {vehicle_name}",
        )  # fmt: skip


class PolicyControllers(Controllers):
    """Controllers of one vehicle in which a learned policy replaces the control law.

    Parameters
    ----------
    design : FlightController
        Design from :func:`mufly.control.design_flight_controller`.
    policy : LearnedPolicy

    Raises
    ------
    InputError
        If the policy does not suit the vehicle or the period of the mission logic.
    """

    def __init__(self, design: FlightController, policy: LearnedPolicy) -> None:
        super().__init__(design)
        check_policy_fits_vehicle(policy, design.vehicle_name, "policy")
        period_s = design.position_divider * design.period_s
        if abs(policy.period_s - period_s) > 1e-6:
            raise InputError(
                "policy", "period_s", f"is {policy.period_s:g} s, but the mission logic has {period_s:g} s",
                f"train with period_s={period_s:g}",
            )  # fmt: skip
        self._policy, self._packed = policy, policy.packed_arrays
        self._action, self._inputs = np.zeros(ACTION_SIZE), policy.trim_inputs.copy()
        self._reference = np.zeros(7)
        self._no_tilt = np.zeros(2)  # the very array that step gets back from the flight software
        self._acted = self._is_due = False

    def engage_roll_pitch(self, estimate: Estimate) -> None:
        super().engage_roll_pitch(estimate)
        self._acted = self._is_due = False

    def compute_tilt_command(
        self, estimate: Estimate, position: _Array, velocity: _Array, acceleration: _Array
    ) -> _Array:
        """Store the references for the policy's next action; return zeros (2,), since a policy commands no tilt."""
        self._reference[:REF_VELOCITY_INDEX], self._reference[REF_VELOCITY_INDEX:REF_HEADING_INDEX] = position, velocity
        self._is_due = True
        return self._no_tilt

    def step(self, estimate: Estimate, heave_yaw: _Array, tilt: _Array | None) -> Actuators:
        if tilt is not self._no_tilt:
            if self._acted:  # a pilot takes over
                self.engage_heave_yaw(estimate, self._inputs[:2])
                self.engage_roll_pitch(estimate)
            self._acted = False
            given = super().step(estimate, heave_yaw, tilt)
            self._inputs = given.input_array.astype(np.float64)
            return given
        if not self._acted:
            self._action = find_action_for_inputs(self._inputs, self._policy.trim_inputs)
        self._acted = True
        if self._is_due:
            self._reference[REF_HEADING_INDEX] = heave_yaw[1]
            step_policy(
                self._packed,
                self._policy.trim_inputs,
                self._policy.nominal_voltage_V,
                estimate.position,
                estimate.velocity,
                estimate.attitude,
                estimate.rates,
                estimate.battery_voltage,
                self._reference,
                self._action,
                self._inputs,
            )
            self._is_due = False
        return Actuators(self._inputs[:2].copy(), self._inputs[2:].copy())


def find_action_for_inputs(inputs: _Array, trim: _Array) -> NDArray[np.float64]:
    """Return the action (4,), clipped to -1..1, that gives the ``inputs`` (4,) of the flight model."""
    upper, lower = inputs[0] - trim[0], inputs[1] - trim[1]
    wanted = (
        0.5 * (upper + lower) / MAX_COLLECTIVE_DUTY_OFFSET,
        0.5 * (upper - lower) / MAX_YAW_DUTY_OFFSET,
        *inputs[SERVO_INPUT_SLICE],
    )
    return np.clip(np.array(wanted, dtype=np.float64), -1.0, 1.0)


@dataclass(frozen=True, eq=False)
class PolicyControlLaw:
    """Control law by a policy, for ``controllers`` of :func:`mufly.flight.fly_mission`.

    Attributes
    ----------
    policy : LearnedPolicy
    """

    policy: LearnedPolicy

    def __call__(self, design: FlightController) -> PolicyControllers:
        """Return controllers that fly the policy on the vehicle for which ``design`` was made."""
        return PolicyControllers(design, self.policy)

    @property
    def __name__(self) -> str:
        """Name that identifies the policy by its numbers; a campaign stores its flights under this name."""
        numbers = (*self.policy.packed_arrays, self.policy.trim_inputs, self.policy.nominal_voltage_V)
        return f"policy-{hash_inputs(*(np.asarray(x).tobytes() for x in numbers))[:16]}"
