"""One description of an output-error problem, for every method that solves it.

Free parameters ``theta`` and, for every window of every record, the motion ``s`` at its start are sought such that the
simulated outputs come nearest to the measured ones::

    J = 1/2 sum ((y_measured - y_simulated(theta, s)) / noise)^2 + 1/2 |theta / prior|^2 + 1/2 |s / spread|^2

(Maine and Iliff, NASA RP 1168; Jategaonkar, ch. 4). ``s`` is counted from the smoothed measurement, and its
``spread`` is so wide that it only keeps unmeasured states from running away. Short windows (multiple shooting) keep
the sum of squares smooth far from the solution; a record with one window is the problem that is meant. In that one
the rotors' speeds and the bar at the start are sought too, counted from steady motors and a bar square to the mast.

Hover (thesis eq. 5.1): on average over a flight thrust carries weight and drag, and the rotors' torques are equal.
At the mean motor inputs these two equations are added as measurements of one per cent or so, while windows are short.

Parts (thesis Sec. 5.3.3): ``heave-yaw`` keeps the vehicle upright and servos at rest; ``roll-pitch`` lets the rotors
turn at the hover speed of the parameters at hand; ``both`` flies the whole model.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from mufly.dynamics.parameters import GRAVITY
from mufly.errors import InputError
from mufly.identify.free import Free, batch_parameters, numbers_at, physical
from mufly.identify.record import Record, difference_noise, smoothed, smoothed_motion
from mufly.identify.simulate import LONGEST_STEP_S, OUTPUTS, fly_batch
from mufly.identify.steady import bar_normal, hover, steady_speed
from mufly.vehicle import Vehicle

__all__ = ["ACTUATOR", "MOTION", "PART_OUTPUTS", "Linear", "Part", "Problem", "make_problem"]

_Array = NDArray[np.float64]
Part = Literal["both", "heave-yaw", "roll-pitch"]

PART_OUTPUTS: dict[str, tuple[str, ...]] = {
    "both": OUTPUTS,
    "heave-yaw": ("height", "climb", "yaw", "r", "speed_up", "speed_dw", "voltage"),
    "roll-pitch": ("roll", "pitch", "p", "q"),
}
MOTION = ("north", "east", "down", "v_north", "v_east", "v_down", "roll", "pitch", "yaw", "p", "q", "r")
ACTUATOR = ("speed_up", "speed_dw", "bar_roll", "bar_pitch", "charge")
# Spread of the start of a window about the smoothed measurement; speeds as a share of the steady speed.
_SPREAD = np.array([1, 1, 1, 2, 2, 2, 0.5, 0.5, 0.5, 3, 3, 3, 0.2, 0.2, 0.2, 0.2, 0.3])
# Motion that can be sought from an output; speeds and bar likewise.
_SEEN_BY = {
    "north": (0, 3), "east": (1, 4), "height": (2, 5), "v_north": (3,), "v_east": (4,), "climb": (5,),
    "roll": (6, 9), "pitch": (7, 10), "yaw": (8, 11), "p": (9,), "q": (10,), "r": (11,),
}  # fmt: skip
# Small enough that the bend of a whole record's valley does not show, and far above round-off.
_DELTA_THETA, _DELTA_STATE = 1e-7, 1e-6
_HOVER_TOLERANCE = 0.02
_HELD_VOLTAGE = 100.0  # of roll-pitch, where motors only have to hold their speed


@dataclass(frozen=True, eq=False)
class Linear:
    """One record linearised about a point: whitened residual and its derivatives.

    Attributes
    ----------
    residual : (n, m) array
        (simulated - measured) / noise, zero where nothing was measured.
    by_theta : (n, m, t) array
    by_state : (n, m, k) array
        Derivative by the ``k`` start values of the window that holds the sample.
    """

    residual: _Array
    by_theta: _Array
    by_state: _Array


@dataclass(frozen=True, eq=False)
class Problem:
    """What :func:`make_problem` returns: records, parameters and how they are compared.

    ``starts[i]`` are the first samples of record ``i``'s windows; ``sought[i]`` the start values that are sought, as
    positions in ``MOTION + ACTUATOR``; ``noise[i]`` the standard deviation of its outputs.
    """

    vehicle: Vehicle
    free: tuple[Free, ...]
    records: tuple[Record, ...]
    noise: tuple[_Array, ...]
    starts: tuple[NDArray[np.int64], ...]
    sought: tuple[NDArray[np.int64], ...]
    part: Part
    hover: bool
    prior: bool
    delay_s: float
    longest_step_s: float
    _motion: tuple[_Array, ...] = field(repr=False)
    _mast: tuple[_Array, ...] = field(repr=False)
    _inputs: tuple[_Array, ...] = field(repr=False)
    _base: tuple[NDArray[np.void], ...] = field(repr=False)
    _powers: tuple[dict[str, _Array], ...] = field(repr=False)
    _charge: tuple[float, ...] = field(repr=False)
    _volts: tuple[tuple[float, float], ...] = field(repr=False)

    @property
    def seconds(self) -> float:
        """Length of all records together (s)."""
        return sum(float(r.time_s[-1] - r.time_s[0]) for r in self.records)

    @property
    def bounds(self) -> tuple[_Array, _Array]:
        """Lower and upper bounds of ``theta``."""
        return np.array([f.low for f in self.free]), np.array([f.high for f in self.free])

    @property
    def prior_std(self) -> _Array:
        """Standard deviation of the prior of ``theta``; infinite without priors."""
        std = np.array([f.prior_std for f in self.free])
        return std if self.prior else np.full(len(std), np.inf)

    def rest(self) -> list[_Array]:
        """Return start values that are those of the smoothed measurement: zeros, (windows, k) a record."""
        return [np.zeros((len(w), len(k))) for w, k in zip(self.starts, self.sought, strict=True)]

    def spread(self, i: int) -> _Array:
        """Return the spread of the start values sought in record ``i``, (k,)."""
        return _SPREAD[self.sought[i]]

    def in_windows(self, length_s: float | None, *, hover: bool = False) -> Problem:
        """Return the same problem with windows of this length (None: each record is one), hover added or not."""
        starts, sought = [], []
        for r in self.records:
            n = len(r.time_s)
            count = 1 if length_s is None else max(1, round((n - 1) * r.sample_s / length_s))
            starts.append(np.round(np.linspace(0, n, count + 1)[:-1]).astype(np.int64))
            sought.append(_sought(r.outputs, self.part, whole=count == 1, charge="voltage" in r.outputs))
        return replace(self, starts=tuple(starts), sought=tuple(sought), hover=hover)

    def of_records(self, chosen: Sequence[int]) -> Problem:
        """Return the problem with some of its records only."""
        names = (
            "records",
            "noise",
            "starts",
            "sought",
            "_motion",
            "_inputs",
            "_base",
            "_powers",
            "_charge",
            "_volts",
        )
        parts: dict[str, Any] = {n: tuple(getattr(self, n)[i] for i in chosen) for n in names}
        return replace(self, **parts)

    def with_noise(self, noise: Sequence[_Array]) -> Problem:
        """Return the problem with other noise."""
        return replace(self, noise=tuple(noise))

    @property
    def charge(self) -> tuple[float, ...]:
        """Charge of the battery at the start of every record, as far as it is not sought."""
        return self._charge

    def charged(self, charge: Sequence[float]) -> Problem:
        """Return the problem with these charges."""
        return replace(self, _charge=tuple(charge))

    def with_charge(self, theta: _Array) -> Problem:
        """Return the problem with batteries charged such that the mean voltage is the measured one at ``theta``."""
        charges = []
        for i, r in enumerate(self.records):
            charge = self._charge[i]
            if "voltage" in r.outputs:
                k = r.outputs.index("voltage")
                curve = self.vehicle.battery.open_circuit_voltage
                for _ in range(5):
                    one = replace(self, _charge=(*self._charge[:i], charge, *self._charge[i + 1 :]))
                    error = (
                        one.residual(i, theta[None], self.rest()[i][None])[0, :, k].mean() * self.noise[i][k]
                    )
                    rest = float(np.interp(charge, curve.fraction, curve.value)) - error
                    charge = float(np.clip(np.interp(rest, curve.value, curve.fraction), 0.02, 0.99))
            charges.append(charge)
        return replace(self, _charge=tuple(charges))

    def simulate(self, i: int, theta: _Array, states: _Array) -> _Array:
        """Return the outputs of record ``i`` (b, n, m) for ``theta`` (b, t) and start values (b, windows, k)."""
        r, b = self.records[i], len(theta)
        p = numbers_at(self._base[i], self._powers[i], theta)
        values = physical(self.free, theta)
        symbols = [f.symbol for f in self.free]
        delay = values[:, symbols.index("delay")] if "delay" in symbols else np.full(b, self.delay_s)
        offset = np.zeros((b, len(MOTION) + len(ACTUATOR)))
        motion = np.repeat(self._motion[i][self.starts[i]][None], b, axis=0)
        inner = self.sought[i] < len(MOTION)
        motion[:, :, self.sought[i][inner]] += states[:, :, inner]
        offset[:, self.sought[i]] = states[:, 0, :]
        actuator = offset[:, len(MOTION) :]

        hold = np.full((b, 2), -1.0)
        if self.part == "roll-pitch":
            speeds, hold = hover(p)
        else:
            first = self._inputs[i][: max(1, round(0.3 / r.sample_s)), :2].mean(axis=0)
            speeds = steady_speed(p, np.clip(first, 0.0, 1.0), self._volts[i][0])
        x = np.zeros((b, 21))
        x[:, 6] = 1.0
        x[:, 13] = p["swash_gain"] * np.clip(self._inputs[i][0, 3], -1, 1)
        x[:, 14] = -p["swash_gain"] * np.clip(self._inputs[i][0, 2], -1, 1)
        x[:, 15:18] = bar_normal(motion[:, 0, 6:9], actuator[:, 2:4])
        x[:, 18:20] = speeds * np.maximum(1.0 + actuator[:, 0:2], 0.01)
        x[:, 20] = np.clip(self._charge[i] + actuator[:, 4], 0.0, 1.0)
        codes = np.array([OUTPUTS.index(o) for o in r.outputs], dtype=np.int64)
        y = fly_batch(
            x, p, self._inputs[i], sample_s=r.sample_s, codes=codes, starts=self.starts[i], motion=motion,
            mast=self._mast[i],            delay_s=delay, motor_hold=hold, longest_step_s=self.longest_step_s,
        )  # fmt: skip
        for j, symbol in enumerate(symbols):
            if symbol.startswith("bias_") and symbol[5:] in r.outputs:
                y[:, :, r.outputs.index(symbol[5:])] += values[:, j, None]
        return y

    def residual(self, i: int, theta: _Array, states: _Array) -> _Array:
        """Return (simulated - measured) / noise of record ``i``, (b, n, m); zero where nothing was measured."""
        y = self.simulate(i, theta, states)
        y -= self.records[i].measured
        y /= self.noise[i]
        return np.nan_to_num(y, copy=False, nan=0.0)

    def cost(self, theta: _Array, states: Sequence[_Array]) -> _Array:
        """Return ``J`` (b,) for ``theta`` (b, t) and, a record, start values (b, windows, k)."""
        return self.cost_of(theta, states, [self.residual(i, theta, s) for i, s in enumerate(states)])

    def cost_of(self, theta: _Array, states: Sequence[_Array], residuals: Sequence[_Array]) -> _Array:
        """Return ``J`` (b,) when the residuals (b, n, m) of the records are known."""
        total = 0.5 * np.sum((theta / self.prior_std) ** 2, axis=1)
        for i, (s, e) in enumerate(zip(states, residuals, strict=True)):
            total = total + 0.5 * np.einsum("bnm,bnm->b", e, e)
            total = total + 0.5 * np.sum((s / self.spread(i)) ** 2, axis=(1, 2))
        return total + 0.5 * np.sum(self.hover_residual(theta) ** 2, axis=1)

    def linearise(self, i: int, theta: _Array, states: _Array) -> Linear:
        """Return record ``i`` linearised about ``theta`` (t,) and start values (windows, k), by differences.

        All windows move in one flight: a start value acts on its own window alone.
        """
        t, k = len(theta), states.shape[1]
        thetas = np.repeat(theta[None], 1 + t + k, axis=0)
        starts = np.repeat(states[None], 1 + t + k, axis=0)
        thetas[1 + np.arange(t), np.arange(t)] += _DELTA_THETA
        starts[1 + t + np.arange(k), :, np.arange(k)] += _DELTA_STATE
        e = self.residual(i, thetas, starts)
        slope = np.moveaxis(e[1:] - e[0], 0, -1)
        return Linear(e[0], slope[..., :t] / _DELTA_THETA, slope[..., t:] / _DELTA_STATE)

    def hover_residual(self, theta: _Array) -> _Array:
        """Return what eq. 5.1 lacks at the mean motor inputs, over its tolerance, (b, 2 records) or (b, 0)."""
        if not self.hover or self.part == "roll-pitch":
            return np.zeros((len(theta), 0))
        out = []
        for i in range(len(self.records)):
            p = numbers_at(self._base[i], self._powers[i], theta)
            duty = np.clip(self._inputs[i][:, :2], 0.0, 1.0).mean(axis=0)
            speed = steady_speed(p, duty, self._volts[i][1])
            weight = p["mass"] * GRAVITY + p["downwash"]
            up, dw = p["torque_up"] * speed[:, 0] ** 2, p["torque_dw"] * speed[:, 1] ** 2
            lift = p["thrust_up"] * speed[:, 0] ** 2 + p["thrust_dw"] * speed[:, 1] ** 2
            out += [np.log(lift / weight) / _HOVER_TOLERANCE, np.log(up / dw) / _HOVER_TOLERANCE]
        return np.column_stack(out)


def make_problem(
    vehicle: Vehicle,
    free: Sequence[Free],
    records: Sequence[Record],
    *,
    part: Part = "both",
    outputs: Sequence[str] | None = None,
    voltage: str | float = "measured",
    delay_s: float = 0.0,
    prior: bool = True,
    longest_step_s: float = LONGEST_STEP_S,
) -> Problem:
    """Set up the fit of a vehicle to records.

    Parameters
    ----------
    vehicle : Vehicle
        Start values, and everything that is not free.
    free : sequence of Free
        See :func:`mufly.identify.free.choose_free`.
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
    longest_step_s : float
        Bound on the integration step.

    Raises
    ------
    InputError
        If a record holds none of the outputs.
    """
    kept: list[Record] = []
    for r in records:
        wanted = [o for o in PART_OUTPUTS[part] if outputs is None or o in outputs]
        # A measured voltage that is an input cannot be an output as well.
        if voltage != "model":
            wanted = [o for o in wanted if o != "voltage"]
        used = r.of(wanted)
        if not used.outputs or used.outputs == ("voltage",):
            have = ", ".join(r.outputs)
            raise InputError(
                r.name, "", f"holds none of {', '.join(wanted)} (but {have})", "choose other outputs"
            )
        kept.append(used)
    inputs, base, powers, motion, charge, steady = [], [], [], [], [], []
    for r in kept:
        u, volts = r.inputs.copy(), _volts(vehicle, r, voltage)
        if part == "heave-yaw":
            u[:, 2:] = 0.0
        if volts is not None and np.ndim(volts) > 0:
            # Only duty times voltage counts, so a voltage that varies is put into the duty, exactly.
            top = float(np.max(volts))
            u[:, :2] = np.clip(u[:, :2], 0.0, 1.0) * (np.asarray(volts) / top)[:, None]
            volts = top
        if part == "roll-pitch":
            volts = _HELD_VOLTAGE
        b, w = batch_parameters(vehicle, free, None if volts is None else float(np.max(volts)))
        m = smoothed_motion(r)
        if part == "heave-yaw":
            m[:, [6, 7, 9, 10]] = 0.0
        if part == "roll-pitch":
            m[:, [0, 1, 2, 3, 4, 5, 8, 11]] = 0.0
        inputs.append(u)
        base.append(b)
        powers.append(w)
        motion.append(m)
        charge.append(_start_charge(vehicle, r) if volts is None else 1.0)
        # Voltage in the first moments, and on average.
        known = np.full(2, float(vehicle.battery.nominal_voltage)) if r.voltage is None else r.voltage
        first = known[: max(1, round(0.3 / r.sample_s))]
        held = (float(first.mean()), float(known.mean())) if volts is None else (float(np.max(volts)),) * 2
        steady.append(held)
    problem = Problem(
        vehicle=vehicle, free=tuple(free), records=tuple(kept), noise=tuple(difference_noise(r) for r in kept),
        starts=(), sought=(), part=part, hover=False, prior=prior, delay_s=delay_s, longest_step_s=longest_step_s,
        _motion=tuple(motion), _mast=tuple(bar_normal(m[:, 6:9], np.zeros((len(m), 2))) for m in motion),
        _inputs=tuple(inputs), _base=tuple(base), _powers=tuple(powers),
        _charge=tuple(charge), _volts=tuple(steady),
    )  # fmt: skip
    return problem.in_windows(None)


def _volts(vehicle: Vehicle, r: Record, voltage: str | float) -> _Array | float | None:
    if voltage == "model":
        return None
    if voltage == "measured":
        return (
            float(vehicle.battery.nominal_voltage) if r.voltage is None else smoothed(r.voltage, r.sample_s)
        )
    if voltage == "nominal":
        return float(vehicle.battery.nominal_voltage)
    if isinstance(voltage, str) or not 0.0 < voltage < 1e3:
        raise InputError(
            "--voltage", "", f"{voltage!r} is no voltage", "give measured, model, nominal or a number (V)"
        )
    return voltage


def _start_charge(vehicle: Vehicle, r: Record) -> float:
    """Return the charge at which the open-circuit voltage is what was measured first, plus a usual sag."""
    if r.voltage is None:
        return 0.5
    curve = vehicle.battery.open_circuit_voltage
    rest = float(np.mean(r.voltage[: max(1, len(r.voltage) // 20)])) + 3.0 * float(
        vehicle.battery.internal_resistance
    )
    return float(np.clip(np.interp(rest, curve.value, curve.fraction), 0.05, 0.98))


def _sought(outputs: Sequence[str], part: Part, *, whole: bool, charge: bool) -> NDArray[np.int64]:
    """Return which start values of ``MOTION + ACTUATOR`` are sought, given what is measured."""
    chosen = {k for o in outputs for k in _SEEN_BY.get(o, ())}
    if whole:
        n = len(MOTION)
        if set(outputs) & {"height", "climb", "yaw", "r", "speed_up", "speed_dw"}:
            chosen |= {n, n + 1}
        chosen |= {n + 2} if 9 in chosen else set()
        chosen |= {n + 3} if 10 in chosen else set()
        chosen |= {n + 4} if charge else set()
    if part == "heave-yaw":
        chosen -= {6, 7, 9, 10, len(MOTION) + 2, len(MOTION) + 3}
    if part == "roll-pitch":
        chosen -= {0, 1, 2, 3, 4, 5, 8, 11, len(MOTION), len(MOTION) + 1, len(MOTION) + 4}
    return np.array(sorted(chosen), dtype=np.int64)
