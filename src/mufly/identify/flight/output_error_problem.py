"""One description of an output-error problem, for every method that solves it.

Free parameters ``theta`` and, for every window of every record, the motion ``s`` at its start are sought such that the
simulated outputs come nearest to the measured ones::

    J = 1/2 sum ((y_measured - y_simulated(theta, s)) / noise)^2 + 1/2 |theta / prior|^2 + 1/2 |s / spread|^2

(Maine and Iliff, NASA RP 1168; Jategaonkar, ch. 4). ``s`` is counted from the smoothed measurement, and its
``initial_state_std`` is so wide that it only keeps unmeasured states from running away. Short windows (multiple
shooting) keep the sum of squares smooth far from the solution; a record with one window is the problem that is meant.
In that one the rotors' speeds and the bar at the start are sought too, counted from steady motors and a bar square to
the mast.

Hover (thesis eq. 5.1): on average over a flight thrust carries weight and drag, and the rotors' torques are equal.
At the mean motor inputs these two equations are added as measurements of one per cent or so, while windows are short.

Parts (thesis Sec. 5.3.3): ``heave-yaw`` keeps the vehicle upright and servos at rest; ``roll-pitch`` lets the rotors
turn at the hover speed of the parameters at hand; ``both`` flies the whole model.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from dataclasses import replace as dataclasses_replace
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from mufly.dynamics.model_state import (
    BAR_NORMAL,
    MOTORS,
    ROTOR_SPEEDS,
    RS_ATT,
    RS_CHARGE,
    RS_SWASH_PITCH,
    RS_SWASH_ROLL,
    STATE_SIZE,
    U_SERVO_1,
    U_SERVO_2,
)
from mufly.errors import ArgumentError, InputError
from mufly.identify.flight.batch_simulation import (
    bar_normal,
    simulate_batch,
    solve_hover,
    steady_rotor_speeds,
)
from mufly.identify.flight.free_parameters import (
    FreeParameter,
    list_held_parameters,
    log_scaled_parameters,
    parameters_at_theta,
    theta_to_values,
)
from mufly.identify.flight_record import (
    FLIGHT_OUTPUTS,
    MO_EULER,
    MO_POS,
    MO_RATES,
    MO_VEL,
    FlightRecord,
    estimate_difference_noise,
    smooth_motion,
    smooth_signal,
)
from mufly.units import GRAVITY
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
AC_BAR, AC_CHARGE = 2, 4  # indices into ACTUATOR
# Spread of the start of a window about the smoothed measurement; speeds as a share of the steady speed.
_INITIAL_STATE_STD = np.array([1, 1, 1, 2, 2, 2, 0.5, 0.5, 0.5, 3, 3, 3, 0.2, 0.2, 0.2, 0.2, 0.3])
# Motion that can be sought from an output; speeds and bar likewise.
_STATES_SEEN_BY_OUTPUT = {
    "north": (MO_POS, MO_VEL), "east": (MO_POS + 1, MO_VEL + 1), "height": (MO_POS + 2, MO_VEL + 2),
    "v_north": (MO_VEL,), "v_east": (MO_VEL + 1,), "climb": (MO_VEL + 2,),
    "roll": (MO_EULER, MO_RATES), "pitch": (MO_EULER + 1, MO_RATES + 1), "yaw": (MO_EULER + 2, MO_RATES + 2),
    "p": (MO_RATES,), "q": (MO_RATES + 1,), "r": (MO_RATES + 2,),
}  # fmt: skip
# Small enough that the bend of a whole record's valley does not show, and far above round-off.
_THETA_DIFFERENCE, _STATE_DIFFERENCE = 1e-7, 1e-6
_HOVER_TOLERANCE = 0.02
_MIN_START_SAMPLES = 20  # samples from which a start is sought
_ROLL_PITCH_VOLTAGE = 100.0  # of roll-pitch, where motors only have to hold their speed


@dataclass(frozen=True, eq=False)
class LinearisedRecord:
    """One record linearised about a point: whitened residual and its derivatives.

    Attributes
    ----------
    whitened_residual : (n, m) array
        (simulated - measured) / noise, zero where nothing was measured.
    theta_jacobian : (n, m, t) array
    state_jacobian : (n, m, k) array
        Derivative by the ``k`` start values of the window that holds the sample.
    """

    whitened_residual: _Array
    theta_jacobian: _Array
    state_jacobian: _Array


@dataclass(frozen=True, eq=False)
class PreparedRecord:
    """A record made ready for the simulation: what is compared, and what its windows start from.

    Attributes
    ----------
    record : Record
    noise_std : (m,) array
        Standard deviation of its outputs.
    smoothed_motion, mast_direction : (n, 12), (n, 3) array
        Smoothed measurement, and the direction of the mast in it.
    inputs : (n, 4) array
    base, powers
        Of :func:`log_scaled_parameters`.
    initial_charge : float
        Of the battery at the start, as far as it is not sought.
    constant_voltage : float or None
        Battery voltage (V) that is held; None for the vehicle's battery model.
    initial_offset : (17,) array
        What the first start is counted from beyond the smoothed measurement, as ``MOTION + ACTUATOR``: horizontal
        velocity where it is not measured, speeds as a share of the steady ones, tilts.
    first_and_mean_voltage : (float, float)
        Voltage in the first moments and on average.
    window_starts : (windows,) array
        First samples of the windows.
    sought_states : (k,) array
        Start values that are sought, as positions in ``MOTION + ACTUATOR``.
    """

    record: FlightRecord
    noise_std: _Array
    smoothed_motion: _Array
    mast_direction: _Array
    inputs: _Array
    base_parameters: NDArray[np.void]
    parameter_powers: dict[str, _Array]
    initial_charge: float
    constant_voltage: float | None
    initial_offset: _Array
    first_and_mean_voltage: tuple[float, float]
    window_starts: NDArray[np.int64]
    sought_states: NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class OutputErrorProblem:
    """What :func:`make_problem` returns: records, parameters and how they are compared."""

    vehicle: Vehicle
    free_parameters: tuple[FreeParameter, ...]
    prepared_records: tuple[PreparedRecord, ...]
    dynamics_part: DynamicsPart
    with_hover_residual: bool
    with_prior: bool
    delay_s: float
    ignored_start_s: float = 0.0  # at the beginning of every record, where nothing is compared

    @property
    def records(self) -> tuple[FlightRecord, ...]:
        """The records, with the outputs that are compared."""
        return tuple(f.record for f in self.prepared_records)

    @property
    def window_starts(self) -> tuple[NDArray[np.int64], ...]:
        """First samples of the windows of every record."""
        return tuple(f.window_starts for f in self.prepared_records)

    @property
    def bounds(self) -> tuple[_Array, _Array]:
        """Lower and upper bounds of ``theta``."""
        return np.array([f.theta_low for f in self.free_parameters]), np.array(
            [f.theta_high for f in self.free_parameters]
        )

    @property
    def prior_std(self) -> _Array:
        """Standard deviation of the prior of ``theta``; infinite without priors."""
        std = np.array([f.prior_std for f in self.free_parameters])
        return std if self.with_prior else np.full(len(std), np.inf)

    def zero_initial_states(self) -> list[_Array]:
        """Return start values that are those of the smoothed measurement: zeros, (windows, k) a record."""
        return [np.zeros((len(f.window_starts), len(f.sought_states))) for f in self.prepared_records]

    def initial_state_std(self, i: int) -> _Array:
        """Return the spread of the start values sought in record ``i``, (k,)."""
        return _INITIAL_STATE_STD[self.prepared_records[i].sought_states]

    def _replace_in_records(self, **changed: Sequence[Any]) -> OutputErrorProblem:
        """Return the problem with fields of its records changed, a value a record."""
        rows = [dict(zip(changed, values, strict=True)) for values in zip(*changed.values(), strict=True)]
        flights = tuple(dataclasses_replace(f, **row) for f, row in zip(self.prepared_records, rows, strict=True))
        return dataclasses_replace(self, prepared_records=flights)

    def with_windows(self, length_s: float | None, *, hover: bool = False) -> OutputErrorProblem:
        """Return the same problem with windows of this length (None: each record is one), hover added or not."""
        starts, sought = [], []
        for r in self.records:
            n = len(r.time_s)
            count = 1 if length_s is None else max(1, round((n - 1) * r.sample_s / length_s))
            starts.append(np.round(np.linspace(0, n, count + 1)[:-1]).astype(np.int64))
            drags = any(float(f.base_parameters["inplane"]) > 0.0 for f in self.prepared_records)
            sought.append(_choose_sought_states(r.outputs, self.dynamics_part, whole=count == 1, drags=drags))
        return dataclasses_replace(
            self._replace_in_records(window_starts=starts, sought_states=sought), with_hover_residual=hover
        )

    def with_held_parameters(self) -> tuple[OutputErrorProblem, int]:
        """Return the problem with the parameters that are held appended to the free ones, and how many are free."""
        held = list_held_parameters(
            self.vehicle, self.free_parameters, self.delay_s, self.prepared_records[0].constant_voltage
        )
        wider = (*self.free_parameters, *held)
        powers = [log_scaled_parameters(self.vehicle, wider, f.constant_voltage)[1] for f in self.prepared_records]
        return dataclasses_replace(self._replace_in_records(parameter_powers=powers), free_parameters=wider), len(
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
        """Return the problem with other noise."""
        return self._replace_in_records(noise_std=noise)

    def with_initial_offset(self, begin: Sequence[_Array]) -> OutputErrorProblem:
        """Return the problem with rotors, bars and batteries that begin so."""
        return self._replace_in_records(initial_offset=begin)

    def with_charges(self, charge: Sequence[float]) -> OutputErrorProblem:
        """Return the problem with these charges of the batteries."""
        return self._replace_in_records(initial_charge=charge)

    def with_matched_charge(self, theta: _Array) -> OutputErrorProblem:
        """Return the problem with batteries charged such that the mean voltage is the measured one at ``theta``."""
        curve = self.vehicle.battery.open_circuit_voltage
        charges = [f.initial_charge for f in self.prepared_records]
        for i, f in enumerate(self.prepared_records):
            if "voltage" not in f.record.outputs:
                continue
            k = f.record.outputs.index("voltage")
            for _ in range(5):
                e = self.with_charges(charges).record_residual(i, theta[None], self.zero_initial_states()[i][None])[
                    0, :, k
                ]
                error = e.mean() * f.noise_std[k]
                rest = float(np.interp(charges[i], curve.fraction, curve.value)) - error
                charges[i] = float(np.clip(np.interp(rest, curve.value, curve.fraction), 0.02, 0.99))
        return self.with_charges(charges)

    def simulate_record(self, i: int, theta: _Array, states: _Array) -> _Array:
        """Return the outputs of record ``i`` (b, n, m) for ``theta`` (b, t) and start values (b, windows, k)."""
        f, r, b = self.prepared_records[i], self.records[i], len(theta)
        p = parameters_at_theta(f.base_parameters, f.parameter_powers, theta)
        values = theta_to_values(self.free_parameters, theta)
        symbols = [one.symbol for one in self.free_parameters]
        delay = values[:, symbols.index("delay")] if "delay" in symbols else np.full(b, self.delay_s)
        offset = np.zeros((b, len(MOTION_STATES) + len(ACTUATOR_STATES)))
        motion = np.repeat(f.smoothed_motion[f.window_starts][None], b, axis=0)
        inner = f.sought_states < len(MOTION_STATES)
        motion[:, :, f.sought_states[inner]] += states[:, :, inner]
        motion[:, 0] += f.initial_offset[: len(MOTION_STATES)]
        offset[:, f.sought_states] = states[:, 0, :]
        actuator = (offset + f.initial_offset)[:, len(MOTION_STATES) :]

        hold = np.full((b, 2), -1.0)
        if self.dynamics_part == "roll-pitch":
            speeds, hold = solve_hover(p)
        else:
            first = f.inputs[: max(1, round(0.3 / r.sample_s)), MOTORS].mean(axis=0)
            speeds = steady_rotor_speeds(p, np.clip(first, 0.0, 1.0), f.first_and_mean_voltage[0])
        x = np.zeros((b, STATE_SIZE))
        x[:, RS_ATT] = 1.0
        x[:, RS_SWASH_ROLL] = p["swash_gain"] * np.clip(f.inputs[0, U_SERVO_2], -1, 1)
        x[:, RS_SWASH_PITCH] = -p["swash_gain"] * np.clip(f.inputs[0, U_SERVO_1], -1, 1)
        x[:, BAR_NORMAL] = bar_normal(motion[:, 0, MO_EULER:MO_RATES], actuator[:, AC_BAR:AC_CHARGE])
        x[:, ROTOR_SPEEDS] = speeds * np.maximum(1.0 + actuator[:, :AC_BAR], 0.01)
        x[:, RS_CHARGE] = np.clip(f.initial_charge + actuator[:, AC_CHARGE], 0.0, 1.0)
        codes = np.array([FLIGHT_OUTPUTS.index(o) for o in r.outputs], dtype=np.int64)
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
            if symbol.startswith("bias_") and (output := symbol.removeprefix("bias_")) in r.outputs:
                y[:, :, r.outputs.index(output)] += values[:, j, None]
        return y

    def _velocity_follows_attitude(self, i: int) -> bool:
        """Whether horizontal velocity, which windows need and nobody measured, is to follow from the attitude."""
        f = self.prepared_records[i]
        tilt = {"roll", "pitch"} <= set(f.record.outputs)
        return tilt and len(f.window_starts) > 1 and not {3, 4} & set(f.sought_states.tolist())

    def record_residual(self, i: int, theta: _Array, states: _Array) -> _Array:
        """Return (simulated - measured) / noise of record ``i``, (b, n, m); zero where nothing was measured."""
        y = self.simulate_record(i, theta, states)
        y -= self.records[i].measured
        y /= self.prepared_records[i].noise_std
        y[:, : round(self.ignored_start_s / self.records[i].sample_s)] = 0.0
        return np.nan_to_num(y, copy=False, nan=0.0)

    def all_residuals(self, theta: _Array, states: Sequence[_Array]) -> list[_Array]:
        """Return the residuals (b, n, m) of all records."""
        return [self.record_residual(i, theta, s) for i, s in enumerate(states)]

    def compute_cost(self, theta: _Array, states: Sequence[_Array]) -> _Array:
        """Return ``J`` (b,) for ``theta`` (b, t) and, a record, start values (b, windows, k)."""
        return self.cost_of_residuals(theta, states, self.all_residuals(theta, states))

    def cost_of_residuals(self, theta: _Array, states: Sequence[_Array], residuals: Sequence[_Array]) -> _Array:
        """Return ``J`` (b,) when the residuals (b, n, m) of the records are known."""
        total = 0.5 * np.sum((theta / self.prior_std) ** 2, axis=1)
        for i, (s, e) in enumerate(zip(states, residuals, strict=True)):
            total = total + 0.5 * np.einsum("bnm,bnm->b", e, e)
            total = total + 0.5 * np.sum((s / self.initial_state_std(i)) ** 2, axis=(1, 2))
        return total + 0.5 * np.sum(self.hover_residual(theta) ** 2, axis=1)

    def linearise_record(self, i: int, theta: _Array, states: _Array) -> LinearisedRecord:
        """Return record ``i`` linearised about ``theta`` (t,) and start values (windows, k), by differences.

        All windows move in one flight: a start value acts on its own window alone.
        """
        t, k = len(theta), states.shape[1]
        thetas = np.repeat(theta[None], 1 + t + k, axis=0)
        starts = np.repeat(states[None], 1 + t + k, axis=0)
        thetas[1 + np.arange(t), np.arange(t)] += _THETA_DIFFERENCE
        starts[1 + t + np.arange(k), :, np.arange(k)] += _STATE_DIFFERENCE
        e = self.record_residual(i, thetas, starts)
        slope = np.moveaxis(e[1:] - e[0], 0, -1)
        return LinearisedRecord(e[0], slope[..., :t] / _THETA_DIFFERENCE, slope[..., t:] / _STATE_DIFFERENCE)

    def initial_state_jacobian(self, i: int, theta: _Array, states: _Array) -> tuple[_Array, _Array]:
        """Return the residual (n, m) of record ``i`` and its derivative (n, m, k) by the start values alone."""
        k = states.shape[1]
        starts = np.repeat(states[None], 1 + k, axis=0)
        starts[1 + np.arange(k), :, np.arange(k)] += _STATE_DIFFERENCE
        e = self.record_residual(i, np.repeat(theta[None], 1 + k, axis=0), starts)
        return e[0], np.moveaxis(e[1:] - e[0], 0, -1) / _STATE_DIFFERENCE

    def hover_residual(self, theta: _Array) -> _Array:
        """Return what eq. 5.1 lacks at the mean motor inputs, over its tolerance, (b, 2 records) or (b, 0)."""
        if not self.with_hover_residual or self.dynamics_part == "roll-pitch":
            return np.zeros((len(theta), 0))
        out = []
        for f in self.prepared_records:
            p = parameters_at_theta(f.base_parameters, f.parameter_powers, theta)
            duty = np.clip(f.inputs[:, MOTORS], 0.0, 1.0).mean(axis=0)
            speed = steady_rotor_speeds(p, duty, f.first_and_mean_voltage[1])
            weight = p["mass"] * GRAVITY + p["downwash"]
            up, dw = p["torque_up"] * speed[:, 0] ** 2, p["torque_dw"] * speed[:, 1] ** 2
            lift = p["thrust_up"] * speed[:, 0] ** 2 + p["thrust_dw"] * speed[:, 1] ** 2
            out += [np.log(lift / weight) / _HOVER_TOLERANCE, np.log(up / dw) / _HOVER_TOLERANCE]
        return np.column_stack(out)


def make_problem(
    vehicle: Vehicle, free: Sequence[FreeParameter], records: Sequence[FlightRecord], *, part: DynamicsPart = "both",
    outputs: Sequence[str] | None = None, voltage: str | float = "measured", delay_s: float = 0.0, prior: bool = True,
) -> OutputErrorProblem:  # fmt: skip
    """Set up the fit of a vehicle to records.

    Parameters
    ----------
    vehicle : Vehicle
        Start values, and everything that is not free.
    free : sequence of Free
        See :func:`mufly.identify.choose_free_parameters`.
    records : sequence of Record
        Checked by :func:`mufly.identify.check_record`.
    part : {"both", "heave-yaw", "roll-pitch"}
    outputs : sequence of str, optional
        Use these of the measured outputs only.
    voltage : {"measured", "model", "nominal"} or float
        Battery voltage that the motors get: as recorded (nominal where it was not), from the vehicle's battery
        model, nominal, or this one (V).
    delay_s : float
        Time from the recorded input to the vehicle (s), unless it is free.
    prior : bool
        Let the provenance of the start values weigh in.

    Raises
    ------
    InputError
        If a record holds none of the outputs.
    """
    # A measured voltage that is an input cannot be an output as well.
    wanted = [o for o in PART_OUTPUTS[part] if (outputs is None or o in outputs)]
    wanted = [o for o in wanted if o != "voltage" or voltage == "model"]
    flights = []
    for r in records:
        used = r.select_outputs(wanted)
        if not used.outputs or used.outputs == ("voltage",):
            have = ", ".join(r.outputs)
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
    """Make a record ready; ``first_and_mean_voltage`` None for the vehicle's battery model."""
    u, motion, charge = r.inputs.copy(), smooth_motion(r), 1.0
    if part == "heave-yaw":
        u[:, 2:] = 0.0
        motion[:, [MO_EULER, MO_EULER + 1, MO_RATES, MO_RATES + 1]] = 0.0
    if volts is None:
        charge = _initial_charge(vehicle, r)
    elif np.ndim(volts) > 0:
        # Only duty times voltage counts, so a voltage that varies is put into the duty, exactly.
        top = float(np.max(volts))
        u[:, :2] = np.clip(u[:, :2], 0.0, 1.0) * (np.asarray(volts) / top)[:, None]
        volts = top
    if part == "roll-pitch":
        volts, charge = _ROLL_PITCH_VOLTAGE, 1.0
        motion[:, [*range(MO_EULER), MO_EULER + 2, MO_RATES + 2]] = 0.0
    if volts is None:
        known = np.full(2, float(vehicle.battery.nominal_voltage)) if r.voltage is None else r.voltage
        first = known[: max(1, round(0.3 / r.sample_s))]
        held, constant = (float(first.mean()), float(known.mean())), None
    else:
        constant = float(np.max(volts))
        held = (constant, constant)
    base, powers = log_scaled_parameters(vehicle, free, constant)
    mast = bar_normal(motion[:, MO_EULER:MO_RATES], np.zeros((len(motion), 2)))
    none, begin = np.zeros(0, dtype=np.int64), np.zeros(len(MOTION_STATES) + len(ACTUATOR_STATES))
    return PreparedRecord(
        r,
        estimate_difference_noise(r),
        motion,
        mast,
        u,
        base,
        powers,
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
    """Return the charge at which the open-circuit voltage is what was measured first, plus a usual sag."""
    if r.voltage is None:
        return 0.5
    curve, sag = vehicle.battery.open_circuit_voltage, 3.0 * float(vehicle.battery.internal_resistance)
    rest = float(np.mean(r.voltage[: max(1, len(r.voltage) // 20)])) + sag
    return float(np.clip(np.interp(rest, curve.value, curve.fraction), 0.05, 0.98))


def _choose_sought_states(outputs: Sequence[str], part: DynamicsPart, *, whole: bool, drags: bool) -> NDArray[np.int64]:
    """Return which start values of ``MOTION + ACTUATOR`` are sought, given what is measured.

    Where rotors drag in their planes the tilt tells of the velocity, as it does of the bar: over a whole record.
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
