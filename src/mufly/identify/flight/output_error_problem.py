"""Output-error problem of a flight fit: records, free parameters, residuals and cost.

The unknowns are the free parameters ``theta`` and the initial state ``s`` of every window of every record. They
minimise the weighted difference of measured and simulated outputs::

    J = 1/2 sum ((y_measured - y_simulated(theta, s)) / noise)^2 + 1/2 |theta / prior|^2 + 1/2 |s / spread|^2

(Maine and Iliff, NASA RP 1168; Jategaonkar, ch. 4). ``s`` is the deviation from the smoothed measurement. Its
standard deviation ``spread`` (``initial_state_std``) is wide and only bounds unmeasured states. Short windows (multiple
shooting) keep the sum of squares smooth far from the solution; the final problem has one window per record. With one
window, the initial rotor speeds and bar tilt are unknowns, too, relative to steady motors and a bar normal to the mast.

Hover (thesis eq. 5.1): on average over a flight the thrust equals weight and drag, and the rotor torques are equal.
With short windows these two equations at the mean motor inputs are added as measurements of about 1 %.

Parts (thesis Sec. 5.3.3): ``heave-yaw`` keeps the vehicle upright and the servos at rest. ``roll-pitch`` keeps the
rotors at the hover speed of the present parameters. ``both`` simulates the whole model.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from dataclasses import replace as dataclasses_replace
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from mufly.dynamics.edgewise_loads import tip_path_tilt_target
from mufly.dynamics.model_state import (
    BAR_NORMAL_SLICE,
    MODEL_ATTITUDE,
    MODEL_CHARGE,
    MODEL_SWASH_PITCH,
    MODEL_SWASH_ROLL,
    MOTOR_INPUT_SLICE,
    ROTOR_SPEED_SLICE,
    STATE_SIZE,
    U_SERVO_1,
    U_SERVO_2,
)
from mufly.errors import ArgumentError, InputError
from mufly.identify.flight.batch_simulation import (
    simulate_batch,
    solve_hover,
    stabiliser_bar_normal,
    steady_rotor_speeds,
)
from mufly.identify.flight.free_parameters import (
    FieldChanges,
    FreeParameter,
    find_field_changes,
    list_held_parameters,
    parameters_at_theta,
    theta_to_values,
)
from mufly.identify.flight_record import (
    FLIGHT_OUTPUTS,
    MOTION_EULER,
    MOTION_POSITION,
    MOTION_RATES,
    MOTION_VELOCITY,
    FlightRecord,
    estimate_noise_from_differences,
    smooth_motion,
    smooth_signal,
)
from mufly.quantities.units import GRAVITY
from mufly.vehicle import Vehicle

_Array = NDArray[np.float64]

DynamicsPart = Literal["both", "heave-yaw", "roll-pitch"]

PART_OUTPUTS: dict[str, tuple[str, ...]] = {
    "both": FLIGHT_OUTPUTS,
    "heave-yaw": ("height", "climb", "yaw", "r", "speed_up", "speed_dw", "voltage"),
    "roll-pitch": ("roll", "pitch", "p", "q"),
}
MOTION_STATES = (
    "north",
    "east",
    "down",
    "v_north",
    "v_east",
    "v_down",
    "roll",
    "pitch",
    "yaw",
    "p",
    "q",
    "r",
)
ACTUATOR_STATES = ("speed_up", "speed_dw", "bar_roll", "bar_pitch", "charge")
ACTUATOR_BAR_INDEX, ACTUATOR_CHARGE_INDEX = 2, 4  # indices into ACTUATOR
# Prior standard deviation of a window's initial state (SI); rotor speeds relative to the steady speed.
_INITIAL_STATE_STD = np.array([1, 1, 1, 2, 2, 2, 0.5, 0.5, 0.5, 3, 3, 3, 0.2, 0.2, 0.2, 0.2, 0.3])
# Initial states that each output determines.
_STATES_SEEN_BY_OUTPUT = {
    "north": (MOTION_POSITION, MOTION_VELOCITY), "east": (MOTION_POSITION + 1, MOTION_VELOCITY + 1),
    "height": (MOTION_POSITION + 2, MOTION_VELOCITY + 2),
    "v_north": (MOTION_VELOCITY,), "v_east": (MOTION_VELOCITY + 1,), "climb": (MOTION_VELOCITY + 2,),
    "roll": (MOTION_EULER, MOTION_RATES), "pitch": (MOTION_EULER + 1, MOTION_RATES + 1),
    "yaw": (MOTION_EULER + 2, MOTION_RATES + 2),
    "p": (MOTION_RATES,), "q": (MOTION_RATES + 1,), "r": (MOTION_RATES + 2,),
}  # fmt: skip
# Difference steps: small against the curvature of the cost over a whole record, and far above round-off.
_THETA_DIFFERENCE_STEP, _STATE_DIFFERENCE_STEP = 1e-7, 1e-6
_HOVER_EQUATION_TOLERANCE = 0.02
_MIN_START_SAMPLES = 20  # least number of samples for the fit of an initial state
_ROLL_PITCH_MOTOR_VOLTAGE_V = 100.0  # V, for roll-pitch, where the motors only hold their speed


@dataclass(frozen=True, eq=False)
class LinearisedRecord:
    """Record linearised about a point: whitened residual, and its derivatives by theta and the initial states.

    Attributes
    ----------
    whitened_residual : (n, m) array
        (simulated - measured) / noise, zero without a measurement.
    theta_jacobian : (n, m, t) array
        Derivative with respect to ``theta``.
    initial_state_jacobian : (n, m, k) array
        Derivative with respect to the ``k`` initial states of the sample's window.
    """

    whitened_residual: _Array
    theta_jacobian: _Array
    initial_state_jacobian: _Array


@dataclass(frozen=True, eq=False)
class PreparedRecord:
    """Record prepared for the simulation: outputs, inputs, and the motion from which initial states are counted.

    Attributes
    ----------
    record : FlightRecord
    noise_std : (m,) array
        Standard deviation of the output noise (SI).
    smoothed_motion, mast_direction : (n, 12), (n, 3) array
        Smoothed measurement (SI), and the mast direction from it.
    inputs : (n, 4) array
        Upper motor, lower motor (0..1), servo 1, servo 2 (-1..1).
    base_parameters, parameter_changes
        Results of :func:`find_field_changes`.
    initial_charge : float
        State of charge at the start, unless it is an unknown.
    constant_voltage : float or None
        Constant battery voltage (V); None for the vehicle's battery model.
    initial_state_offset : (17,) array
        Offset of the first initial state from the smoothed measurement, ordered as ``MOTION + ACTUATOR``: unmeasured
        horizontal velocity, rotor speeds relative to the steady speeds, tilts.
    first_and_mean_voltage : (float, float)
        Initial and mean voltage (V).
    window_starts : (windows,) array
        First sample of every window.
    sought_state_indices : (k,) array
        Unknown initial states, as positions in ``MOTION + ACTUATOR``.
    """

    record: FlightRecord
    noise_std: _Array
    smoothed_motion: _Array
    mast_direction: _Array
    inputs: _Array
    base_parameters: NDArray[np.void]
    parameter_changes: FieldChanges
    initial_charge: float
    constant_voltage: float | None
    initial_state_offset: _Array
    first_and_mean_voltage: tuple[float, float]
    window_starts: NDArray[np.int64]
    sought_state_indices: NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class OutputErrorProblem:
    """Output-error problem: prepared records, free parameters and options; see :func:`make_problem`."""

    vehicle: Vehicle
    free_parameters: tuple[FreeParameter, ...]
    prepared_records: tuple[PreparedRecord, ...]
    dynamics_part: DynamicsPart
    with_hover_residual: bool
    with_prior: bool
    delay_s: float
    ignored_start_s: float = 0.0  # time at the beginning of every record without residuals

    @property
    def records(self) -> tuple[FlightRecord, ...]:
        """Records with the outputs that enter the cost."""
        return tuple(f.record for f in self.prepared_records)

    @property
    def window_starts(self) -> tuple[NDArray[np.int64], ...]:
        """First sample of every window, by record."""
        return tuple(f.window_starts for f in self.prepared_records)

    @property
    def theta_bounds(self) -> tuple[_Array, _Array]:
        """Lower and upper bounds of ``theta``."""
        return np.array([f.theta_low for f in self.free_parameters]), np.array(
            [f.theta_high for f in self.free_parameters]
        )

    @property
    def prior_std(self) -> _Array:
        """Standard deviation of the prior of ``theta``; infinite without priors."""
        std = np.array([f.prior_std for f in self.free_parameters])
        return std if self.with_prior else np.full(len(std), np.inf)

    def make_zero_initial_states(self) -> list[_Array]:
        """Return initial states equal to the smoothed measurement: zeros, (windows, k) per record."""
        return [np.zeros((len(f.window_starts), len(f.sought_state_indices))) for f in self.prepared_records]

    def initial_state_std(self, i: int) -> _Array:
        """Return the prior standard deviation of the unknown initial states of record ``i``, (k,)."""
        return _INITIAL_STATE_STD[self.prepared_records[i].sought_state_indices]

    def _replace_record_values(self, **changed: Sequence[Any]) -> OutputErrorProblem:
        """Return the problem with new values in some fields of its prepared records, one value for each record."""
        rows = [dict(zip(changed, values, strict=True)) for values in zip(*changed.values(), strict=True)]
        flights = tuple(dataclasses_replace(f, **row) for f, row in zip(self.prepared_records, rows, strict=True))
        return dataclasses_replace(self, prepared_records=flights)

    def with_windows(self, length_s: float | None, *, hover: bool = False) -> OutputErrorProblem:
        """Return the problem with windows of this length (None: one per record), with or without hover equations."""
        starts, sought = [], []
        for r in self.records:
            n = len(r.time_s)
            count = 1 if length_s is None else max(1, round((n - 1) * r.sample_s / length_s))
            starts.append(np.round(np.linspace(0, n, count + 1)[:-1]).astype(np.int64))
            drags = any(float(f.base_parameters["inplane"]) > 0.0 for f in self.prepared_records)
            sought.append(_choose_sought_states(r.output_names, self.dynamics_part, whole=count == 1, drags=drags))
        return dataclasses_replace(
            self._replace_record_values(window_starts=starts, sought_state_indices=sought), with_hover_residual=hover
        )

    def with_held_parameters(self) -> tuple[OutputErrorProblem, int]:
        """Return the problem with the held parameters appended to the free ones, and the original number of free
        parameters.
        """
        held = list_held_parameters(
            self.vehicle, self.free_parameters, self.delay_s, self.prepared_records[0].constant_voltage
        )
        wider = (*self.free_parameters, *held)
        changes = [find_field_changes(self.vehicle, wider, f.constant_voltage)[1] for f in self.prepared_records]
        return dataclasses_replace(self._replace_record_values(parameter_changes=changes), free_parameters=wider), len(
            self.free_parameters
        )

    def truncate_records(self, seconds: float) -> OutputErrorProblem:
        """Return the problem with the first ``seconds`` of every record, each as one window."""
        flights = []
        for f in self.prepared_records:
            n = max(_MIN_START_SAMPLES, round(seconds / f.record.sample_s) + 1)
            flights.append(
                dataclasses_replace(
                    f,
                    record=f.record.slice_samples(0, n),
                    smoothed_motion=f.smoothed_motion[:n],
                    mast_direction=f.mast_direction[:n],
                    inputs=f.inputs[:n],
                    window_starts=f.window_starts[:1],
                )
            )
        return dataclasses_replace(self, prepared_records=tuple(flights))

    def with_noise(self, noise: Sequence[_Array]) -> OutputErrorProblem:
        """Return the problem with these noise standard deviations, (m,) per record."""
        return self._replace_record_values(noise_std=noise)

    def with_initial_offset(self, begin: Sequence[_Array]) -> OutputErrorProblem:
        """Return the problem with ``begin`` as the records' ``initial_state_offset``, (17,) per record."""
        return self._replace_record_values(initial_state_offset=begin)

    def with_charges(self, charge: Sequence[float]) -> OutputErrorProblem:
        """Return the problem with these initial states of charge, one per record."""
        return self._replace_record_values(initial_charge=charge)

    def with_matched_charge(self, theta: _Array) -> OutputErrorProblem:
        """Return the problem with initial charges at which simulated (``theta``) and measured mean voltage agree."""
        curve = self.vehicle.battery.open_circuit_voltage
        charges = [f.initial_charge for f in self.prepared_records]
        for i, f in enumerate(self.prepared_records):
            if "voltage" not in f.record.output_names:
                continue
            k = f.record.output_names.index("voltage")
            for _ in range(5):
                e = self.with_charges(charges).record_residual(
                    i, theta[None], self.make_zero_initial_states()[i][None]
                )[0, :, k]
                error = e.mean() * f.noise_std[k]
                rest = float(np.interp(charges[i], curve.fraction, curve.value)) - error
                charges[i] = float(np.clip(np.interp(rest, curve.value, curve.fraction), 0.02, 0.99))
        return self.with_charges(charges)

    def simulate_record(self, i: int, theta: _Array, states: _Array) -> _Array:
        """Return the outputs of record ``i`` (b, n, m) for ``theta`` (b, t) and initial states (b, windows, k)."""
        f, r, b = self.prepared_records[i], self.records[i], len(theta)
        p = parameters_at_theta(f.base_parameters, f.parameter_changes, theta)
        values = theta_to_values(self.free_parameters, theta)
        symbols = [one.symbol for one in self.free_parameters]
        delay = values[:, symbols.index("delay")] if "delay" in symbols else np.full(b, self.delay_s)
        offset = np.zeros((b, len(MOTION_STATES) + len(ACTUATOR_STATES)))
        motion = np.repeat(f.smoothed_motion[f.window_starts][None], b, axis=0)
        inner = f.sought_state_indices < len(MOTION_STATES)
        motion[:, :, f.sought_state_indices[inner]] += states[:, :, inner]
        motion[:, 0] += f.initial_state_offset[: len(MOTION_STATES)]
        offset[:, f.sought_state_indices] = states[:, 0, :]
        actuator = (offset + f.initial_state_offset)[:, len(MOTION_STATES) :]

        hold = np.full((b, 2), -1.0)
        if self.dynamics_part == "roll-pitch":
            speeds, hold = solve_hover(p)
        else:
            first = f.inputs[: max(1, round(0.3 / r.sample_s)), MOTOR_INPUT_SLICE].mean(axis=0)
            speeds = steady_rotor_speeds(p, np.clip(first, 0.0, 1.0), f.first_and_mean_voltage[0])
        x = np.zeros((b, STATE_SIZE))
        x[:, MODEL_ATTITUDE] = 1.0
        x[:, MODEL_SWASH_ROLL], x[:, MODEL_SWASH_PITCH] = tip_path_tilt_target.py_func(
            *np.clip(f.inputs[0, [U_SERVO_1, U_SERVO_2]], -1.0, 1.0), p["swash_gain"], p["swash_phase"]
        )
        x[:, BAR_NORMAL_SLICE] = stabiliser_bar_normal(
            motion[:, 0, MOTION_EULER:MOTION_RATES], actuator[:, ACTUATOR_BAR_INDEX:ACTUATOR_CHARGE_INDEX]
        )
        x[:, ROTOR_SPEED_SLICE] = speeds * np.maximum(1.0 + actuator[:, :ACTUATOR_BAR_INDEX], 0.01)
        x[:, MODEL_CHARGE] = np.clip(f.initial_charge + actuator[:, ACTUATOR_CHARGE_INDEX], 0.0, 1.0)
        codes = np.array([FLIGHT_OUTPUTS.index(o) for o in r.output_names], dtype=np.int64)
        y = simulate_batch(
            x,
            p,
            f.inputs,
            sample_s=r.sample_s,
            codes=codes,
            starts=f.window_starts,
            motion=motion,
            mast=f.mast_direction,
            delay_s=delay,
            motor_hold=hold,
            path=f.smoothed_motion if self._velocity_follows_attitude(i) else None,
        )
        for j, symbol in enumerate(symbols):
            if symbol.startswith("bias_") and (output := symbol.removeprefix("bias_")) in r.output_names:
                y[:, :, r.output_names.index(output)] += values[:, j, None]
        return y

    def _velocity_follows_attitude(self, i: int) -> bool:
        """Return whether the horizontal velocity in the windows of record ``i`` is computed from the attitude, as it is
        not fitted.
        """
        f = self.prepared_records[i]
        tilt = {"roll", "pitch"} <= set(f.record.output_names)
        return tilt and len(f.window_starts) > 1 and not {3, 4} & set(f.sought_state_indices.tolist())

    def record_residual(self, i: int, theta: _Array, states: _Array) -> _Array:
        """Return (simulated - measured) / noise of record ``i``, (b, n, m); zero without a measurement."""
        y = self.simulate_record(i, theta, states)
        y -= self.records[i].measured
        y /= self.prepared_records[i].noise_std
        y[:, : round(self.ignored_start_s / self.records[i].sample_s)] = 0.0
        return np.nan_to_num(y, copy=False, nan=0.0)

    def all_residuals(self, theta: _Array, states: Sequence[_Array]) -> list[_Array]:
        """Return the residuals (b, n, m) of all records."""
        return [self.record_residual(i, theta, s) for i, s in enumerate(states)]

    def compute_cost(self, theta: _Array, states: Sequence[_Array]) -> _Array:
        """Return the cost ``J`` (b,) for ``theta`` (b, t) and initial states (b, windows, k) per record."""
        return self.cost_of_residuals(theta, states, self.all_residuals(theta, states))

    def cost_of_residuals(self, theta: _Array, states: Sequence[_Array], residuals: Sequence[_Array]) -> _Array:
        """Return the cost ``J`` (b,) from the residuals (b, n, m) of all records."""
        total = 0.5 * np.sum((theta / self.prior_std) ** 2, axis=1)
        for i, (s, e) in enumerate(zip(states, residuals, strict=True)):
            total = total + 0.5 * np.einsum("bnm,bnm->b", e, e)
            total = total + 0.5 * np.sum((s / self.initial_state_std(i)) ** 2, axis=(1, 2))
        return total + 0.5 * np.sum(self.hover_residual(theta) ** 2, axis=1)

    def linearise_record(self, i: int, theta: _Array, states: _Array) -> LinearisedRecord:
        """Linearise record ``i`` about ``theta`` (t,) and initial states (windows, k) by finite differences.

        One simulation perturbs all windows together, because an initial state affects only its own window.
        """
        t, k = len(theta), states.shape[1]
        thetas = np.repeat(theta[None], 1 + t + k, axis=0)
        starts = np.repeat(states[None], 1 + t + k, axis=0)
        thetas[1 + np.arange(t), np.arange(t)] += _THETA_DIFFERENCE_STEP
        starts[1 + t + np.arange(k), :, np.arange(k)] += _STATE_DIFFERENCE_STEP
        e = self.record_residual(i, thetas, starts)
        slope = np.moveaxis(e[1:] - e[0], 0, -1)
        return LinearisedRecord(e[0], slope[..., :t] / _THETA_DIFFERENCE_STEP, slope[..., t:] / _STATE_DIFFERENCE_STEP)

    def initial_state_jacobian(self, i: int, theta: _Array, states: _Array) -> tuple[_Array, _Array]:
        """Return the residual (n, m) of record ``i`` and its derivative (n, m, k) by the initial states."""
        k = states.shape[1]
        starts = np.repeat(states[None], 1 + k, axis=0)
        starts[1 + np.arange(k), :, np.arange(k)] += _STATE_DIFFERENCE_STEP
        e = self.record_residual(i, np.repeat(theta[None], 1 + k, axis=0), starts)
        return e[0], np.moveaxis(e[1:] - e[0], 0, -1) / _STATE_DIFFERENCE_STEP

    def hover_residual(self, theta: _Array) -> _Array:
        """Return the residual of the hover equations (eq. 5.1) at the mean motor inputs, divided by its tolerance.

        The shape is (b, two per record); it is (b, 0) for a problem without hover equations.
        """
        if not self.with_hover_residual or self.dynamics_part == "roll-pitch":
            return np.zeros((len(theta), 0))
        out = []
        for f in self.prepared_records:
            p = parameters_at_theta(f.base_parameters, f.parameter_changes, theta)
            duty = np.clip(f.inputs[:, MOTOR_INPUT_SLICE], 0.0, 1.0).mean(axis=0)
            speed = steady_rotor_speeds(p, duty, f.first_and_mean_voltage[1])
            weight = p["mass"] * GRAVITY + p["downwash_drag"]
            up, dw = p["torque_up"] * speed[:, 0] ** 2, p["torque_dw"] * speed[:, 1] ** 2
            lift = p["thrust_up"] * speed[:, 0] ** 2 + p["thrust_dw"] * speed[:, 1] ** 2
            out += [np.log(lift / weight) / _HOVER_EQUATION_TOLERANCE, np.log(up / dw) / _HOVER_EQUATION_TOLERANCE]
        return np.column_stack(out)


def make_problem(
    vehicle: Vehicle, free: Sequence[FreeParameter], records: Sequence[FlightRecord], *, part: DynamicsPart = "both",
    outputs: Sequence[str] | None = None, voltage: str | float = "measured", delay_s: float = 0.0, prior: bool = True,
) -> OutputErrorProblem:  # fmt: skip
    """Set up the fit of a vehicle to records.

    Parameters
    ----------
    vehicle : Vehicle
        Start values, and all parameters that are not free.
    free : sequence of FreeParameter
        See :func:`mufly.identify.choose_free_parameters`.
    records : sequence of FlightRecord
        Records, checked by :func:`mufly.identify.require_consistent_record`.
    part : {"both", "heave-yaw", "roll-pitch"}
    outputs : sequence of str, optional
        Measured outputs to use; by default all.
    voltage : {"measured", "model", "nominal"} or float
        Battery voltage of the motors: as recorded (nominal without a record), from the vehicle's battery model,
        nominal, or this value (V).
    delay_s : float
        Delay from the recorded input to the vehicle (s), unless it is free.
    prior : bool
        Whether priors from the provenance of the start values enter the cost.

    Raises
    ------
    InputError
        If a record holds none of the outputs.
    """
    # A measured voltage used as input cannot be an output, too.
    wanted = [o for o in PART_OUTPUTS[part] if (outputs is None or o in outputs)]
    wanted = [o for o in wanted if o != "voltage" or voltage == "model"]
    flights = []
    for r in records:
        used = r.select_outputs(wanted)
        if not used.output_names or used.output_names == ("voltage",):
            have = ", ".join(r.output_names)
            raise InputError(r.name, "", f"contains none of {', '.join(wanted)} (but {have})", "choose other outputs")
        flights.append(_prepare_record(vehicle, free, used, part, _motor_voltage(vehicle, used, voltage)))
    whole = OutputErrorProblem(vehicle, tuple(free), tuple(flights), part, False, prior, delay_s)
    return whole.with_windows(None)


def _prepare_record(
    vehicle: Vehicle,
    free: Sequence[FreeParameter],
    r: FlightRecord,
    part: DynamicsPart,
    volts: _Array | float | None,
) -> PreparedRecord:
    """Prepare a record for the simulation; ``volts`` is None for the vehicle's battery model."""
    u, motion, charge = r.inputs.copy(), smooth_motion(r), 1.0
    if part == "heave-yaw":
        u[:, 2:] = 0.0
        motion[:, [MOTION_EULER, MOTION_EULER + 1, MOTION_RATES, MOTION_RATES + 1]] = 0.0
    if volts is None:
        charge = _initial_charge(vehicle, r)
    elif np.ndim(volts) > 0:
        # Only the product of duty and voltage matters, so the duty includes a varying voltage exactly.
        top = float(np.max(volts))
        u[:, :2] = np.clip(u[:, :2], 0.0, 1.0) * (np.asarray(volts) / top)[:, None]
        volts = top
    if part == "roll-pitch":
        volts, charge = _ROLL_PITCH_MOTOR_VOLTAGE_V, 1.0
        motion[:, [*range(MOTION_EULER), MOTION_EULER + 2, MOTION_RATES + 2]] = 0.0
    if volts is None:
        known = np.full(2, float(vehicle.battery.nominal_voltage)) if r.voltage is None else r.voltage
        first = known[: max(1, round(0.3 / r.sample_s))]
        held, constant = (float(first.mean()), float(known.mean())), None
    else:
        constant = float(np.max(volts))
        held = (constant, constant)
    base, changes = find_field_changes(vehicle, free, constant)
    mast = stabiliser_bar_normal(motion[:, MOTION_EULER:MOTION_RATES], np.zeros((len(motion), 2)))
    none, begin = np.zeros(0, dtype=np.int64), np.zeros(len(MOTION_STATES) + len(ACTUATOR_STATES))
    return PreparedRecord(
        r,
        estimate_noise_from_differences(r),
        motion,
        mast,
        u,
        base,
        changes,
        charge,
        constant,
        begin,
        held,
        none,
        none,
    )


def _motor_voltage(vehicle: Vehicle, r: FlightRecord, voltage: str | float) -> _Array | float | None:
    if voltage == "model":
        return None
    if voltage == "nominal" or (voltage == "measured" and r.voltage is None):
        return float(vehicle.battery.nominal_voltage)
    if voltage == "measured" and r.voltage is not None:
        return smooth_signal(r.voltage, r.sample_s)
    if isinstance(voltage, str) or not 0.0 < voltage < 1e3:
        raise ArgumentError(
            "voltage", "", f"{voltage!r} is not a voltage", "give measured, model, nominal or a number (V)"
        )
    return voltage


def _initial_charge(vehicle: Vehicle, r: FlightRecord) -> float:
    """Return the charge whose open-circuit voltage equals the first measured voltage plus a typical sag."""
    if r.voltage is None:
        return 0.5
    curve, sag = vehicle.battery.open_circuit_voltage, 3.0 * float(vehicle.battery.internal_resistance)
    rest = float(np.mean(r.voltage[: max(1, len(r.voltage) // 20)])) + sag
    return float(np.clip(np.interp(rest, curve.value, curve.fraction), 0.05, 0.98))


def _choose_sought_states(outputs: Sequence[str], part: DynamicsPart, *, whole: bool, drags: bool) -> NDArray[np.int64]:
    """Return the initial states that the measured outputs can determine, as positions in ``MOTION + ACTUATOR``.

    With ``whole`` the window is the whole record, which also determines rotor speeds, bar tilt and charge. With
    in-plane rotor drag (``drags``) its tilt determines the horizontal velocity, too.
    """
    chosen = {k for o in outputs for k in _STATES_SEEN_BY_OUTPUT.get(o, ())}
    n = len(MOTION_STATES)
    if whole:
        if set(outputs) & {"height", "climb", "yaw", "r", "speed_up", "speed_dw"}:
            chosen |= {n, n + 1}
        chosen |= {n + 2} if 9 in chosen else set()
        chosen |= {n + 3} if 10 in chosen else set()
        chosen |= {n + 4} if "voltage" in outputs else set()
    if part == "heave-yaw":
        chosen -= {6, 7, 9, 10, n + 2, n + 3}
    if part == "roll-pitch":
        chosen -= {0, 1, 2, 3, 4, 5, 8, 11, n, n + 1, n + 4}
    if whole and drags and part != "heave-yaw":
        chosen |= ({4} if "roll" in outputs else set()) | ({3} if "pitch" in outputs else set())
    return np.array(sorted(chosen), dtype=np.int64)
