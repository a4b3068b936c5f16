"""One description of an output-error problem, for every method that solves it; and what may be free in it.

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

**Free parameters.** Every number of the equations is a product of powers of vehicle parameters (``thrust_up = cT_up pi
rho R^4``), so a batch of parameter sets is made from one record of :data:`mufly.dynamics.PARAMETERS` by multiplying its
fields; the powers are found by changing each free parameter once and looking at what
:func:`mufly.dynamics.model_parameters` makes of it. Vehicle parameters are fitted as ``theta = ln(value / start)``,
which keeps their signs and makes a factor of two the same step for each; delays and biases, which may be zero, as
``theta = (value - start) / scale``.

Provenance says how far the data may pull a parameter: the standard deviation of its prior (of ``ln value``) and the
factor that bounds it. Priors are wide on purpose: they decide only where the data do not. What is held is in doubt
too (:func:`held_parameters`): who holds a number believes it, to the ``std`` that the vehicle file states, or else to
the third number of its provenance, which for "identified" and "estimated" is narrower than the prior.
"""

from __future__ import annotations

import difflib
import math
from collections.abc import Sequence
from dataclasses import dataclass
from dataclasses import replace as dataclasses_replace
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel

from mufly.dynamics import PARAMETERS, model_parameters
from mufly.errors import ArgumentError, InputError
from mufly.identify.flight.simulate import (
    bar_normal,
    fly_batch,
    hover,
    steady_speed,
)
from mufly.identify.record import OUTPUT_UNITS, OUTPUTS, Record, difference_noise, smoothed, smoothed_motion
from mufly.units import GRAVITY
from mufly.vehicle import Vehicle, parameters, replace

_Array = NDArray[np.float64]

# source -> (standard deviation of the prior of ln(value), factor to either bound) of what is free, and the standard
# deviation of ln(value) of what is held, where the vehicle file states none
PROVENANCE: dict[str, tuple[float, float, float]] = {
    "measured": (0.02, 1.2, 0.02),
    "specified": (0.02, 1.2, 0.02),
    "datasheet": (0.10, 1.5, 0.10),
    "CAD": (0.15, 2.0, 0.15),
    "identified": (0.50, 4.0, 0.05),
    "estimated": (1.00, 6.0, 0.20),
}
# Parameters that act on heave and yaw only, and on roll and pitch only (thesis Sec. 5.3.3).
HEAVE_YAW = ("cT_up", "cT_dw", "cQ_up", "cQ_dw", "Jdrive_up", "Jdrive_dw", "Jrot_up", "Jrot_dw", "Izz", "Whub",
             "cDAz", "m", "kE", "kM", "dR", "Rohm", "igear", "eta_gear", "Ubat", "Rbat", "C", "Iel")  # fmt: skip
ROLL_PITCH = ("Ixx", "Iyy", "z_up", "z_dw", "Tf_up", "Tf_dw", "l_up", "l_dw", "theta_SP_max", "cH", "cDAx",
              "cDAy")  # fmt: skip
# Groups of the vehicle file that the equations of a flight off the floor may depend on.
_FLIES = ("body", "air", "rotors", "swash_plate", "stabiliser_bar", "motor", "gear", "battery")
_GREATEST_DELAY = 0.2  # s
_BIAS = {"m": 1.0, "m/s": 1.0, "rad": 0.3, "rad/s": 0.5, "V": 1.0}  # bound; a tenth of it is the prior


@dataclass(frozen=True)
class Free:
    """A parameter that a fit may change.

    Attributes
    ----------
    symbol, key, unit : str
        As in :class:`mufly.identify.Estimate`.
    start : float
        SI value where the fit starts, and the prior's centre.
    scale : float
        0: fitted as ``ln(value / start)``; otherwise as ``(value - start) / scale``.
    low, high : float
        Bounds of ``theta``.
    prior_std : float
        Of ``theta``.
    source : str
        Provenance of the start.
    """

    symbol: str
    key: str
    unit: str
    start: float
    scale: float
    low: float
    high: float
    prior_std: float
    source: str

    def value(self, theta: float) -> float:
        """Return the SI value at ``theta``."""
        return self.start * math.exp(theta) if self.scale == 0.0 else self.start + self.scale * theta

    def theta(self, value: float) -> float:
        """Return ``theta`` at an SI value."""
        return math.log(value / self.start) if self.scale == 0.0 else (value - self.start) / self.scale


def choose_free(
    vehicle: Vehicle, symbols: Sequence[str], outputs: Sequence[str], *, delay_s: float = 0.0
) -> tuple[Free, ...]:
    """Make free parameters of symbols.

    Parameters
    ----------
    vehicle : Vehicle
        Start values, and provenance for priors and bounds.
    symbols : sequence of str
        As ``mufly vehicle show`` prints them; besides these ``"delay"`` (time from the recorded input to the
        vehicle), and ``"bias_p"`` and so on for any measured output.
    outputs : sequence of str
        What is measured.
    delay_s : float
        Start of the delay (s).

    Raises
    ------
    InputError
        For an unknown symbol (with suggestions), one named twice, or one that starts at zero; for a vehicle whose
        rotor coefficients come from a map, which no parameter moves.
    """
    if vehicle.rotors.coefficient_map is not None:
        raise InputError(
            vehicle.name, "rotors.coefficient_map", "stands in for the coefficients that a fit moves",
            "take it out of the vehicle file, fit, and put it back",
        )  # fmt: skip
    if not symbols:
        raise ArgumentError("symbols", "", "no parameter is free", "name some, as in symbols=cT_dw,Izz")
    rows = {r.symbol: r for r in parameters(vehicle)}
    limits = _limits(vehicle)
    chosen: list[Free] = []
    for symbol in symbols:
        if any(f.symbol == symbol for f in chosen):
            raise ArgumentError("symbols", symbol, "is named twice", "name it once")
        if symbol == "delay":
            top = (_GREATEST_DELAY - delay_s) / 0.01
            chosen.append(Free("delay", "", "s", delay_s, 0.01, -delay_s / 0.01, top, 10.0, "estimated"))
            continue
        if symbol.startswith("bias_"):
            name = symbol.removeprefix("bias_")
            if name not in outputs:
                remedy = f"use a measured output: {', '.join(f'bias_{o}' for o in outputs)}"
                raise ArgumentError("symbols", symbol, "is the bias of nothing that is measured", remedy)
            scale = 0.1 * _BIAS[OUTPUT_UNITS[name]]
            chosen.append(Free(symbol, "", OUTPUT_UNITS[name], 0.0, scale, -10.0, 10.0, 1.0, "estimated"))
            continue
        row = rows.get(symbol)
        if row is None or not isinstance(row.value, float):
            known = [s for s, r in rows.items() if isinstance(r.value, float)]
            near = _near(symbol, [*known, "delay"])
            remedy = f"did you mean {' or '.join(near)}?" if near else "use symbols of `mufly vehicle show`"
            raise ArgumentError("symbols", symbol, "is no parameter of a vehicle that can be fitted", remedy)
        if row.value == 0.0:
            raise InputError(vehicle.name, row.key, "starts at 0", "give a start of the right size")
        std, factor, _ = PROVENANCE[row.source]
        low, high = -math.log(factor), math.log(factor)
        for limit in limits.get(row.key, ()):
            t = math.log(limit / row.value) if limit / row.value > 0 else math.inf
            low, high = (max(low, t), high) if t <= 0 else (low, min(high, t))
        chosen.append(Free(symbol, row.key, row.unit, row.value, 0.0, low, high, std, row.source))
    return tuple(chosen)


def held_parameters(
    vehicle: Vehicle, free: Sequence[Free], delay_s: float, voltage: float | None
) -> tuple[Free, ...]:
    """Return what acts on the flight and is not free; ``prior_std`` says in how much doubt it is.

    Scalars of the vehicle file that the equations depend on (not the contact with the floor, nor curves), and the
    delay, which counts as estimated.
    """
    chosen, found = {f.symbol for f in free}, []
    for row in parameters(vehicle):
        if row.symbol in chosen or not isinstance(row.value, float) or row.value == 0.0:
            continue
        if row.key.partition(".")[0] not in _FLIES:
            continue
        doubt = PROVENANCE[row.source][2] if row.std is None else row.std / abs(row.value)
        one = Free(row.symbol, row.key, row.unit, row.value, 0.0, -np.inf, np.inf, doubt, row.source)
        if doubt > 0.0 and batch_parameters(vehicle, [one], voltage)[1]:
            found.append(one)
    if "delay" not in chosen and delay_s > 0.0:
        doubt = PROVENANCE["estimated"][2] * delay_s / 0.01
        found.append(Free("delay", "", "s", delay_s, 0.01, -np.inf, np.inf, doubt, "estimated"))
    return tuple(found)


def physical(free: Sequence[Free], theta: _Array) -> _Array:
    """Return SI values (..., n) at ``theta`` (..., n)."""
    log = np.array([f.scale == 0.0 for f in free])
    start, scale = np.array([f.start for f in free]), np.array([f.scale for f in free])
    t = np.asarray(theta, dtype=np.float64)
    return np.where(log, start * np.exp(np.where(log, t, 0.0)), start + scale * t)


def batch_parameters(
    vehicle: Vehicle, free: Sequence[Free], voltage: float | None
) -> tuple[NDArray[np.void], dict[str, _Array]]:
    """Return what :func:`numbers_at` multiplies: the start's record, and the power of each free parameter.

    Parameters
    ----------
    vehicle : Vehicle
    free : sequence of Free
    voltage : float or None
        Constant battery voltage (V), or None for the vehicle's own battery model.

    Returns
    -------
    base : () structured array of type ``PARAMETERS``
        Without a floor: flights that are identified do not touch it.
    powers : dict of str to (n,) array
        Field of the record -> exponent of every free parameter, 0 for those that do not touch it.
    """
    base = np.array(model_parameters(vehicle, voltage), dtype=PARAMETERS)
    powers: dict[str, _Array] = {}
    for j, f in enumerate(free):
        if not f.key:
            continue
        changed, factor = _nudged(vehicle, f, voltage)
        for name in PARAMETERS.names or ():
            if name in ("contact_points", "contact_count", "contact_reach", "friction_bound"):
                continue
            old, new = float(np.ravel(base[name])[-1]), float(np.ravel(changed[name])[-1])
            if old != new:
                powers.setdefault(name, np.zeros(len(free)))[j] = round(
                    math.log(new / old) / math.log(factor), 9
                )
    base["contact_reach"] = -1e9
    return base, powers


def _nudged(vehicle: Vehicle, f: Free, voltage: float | None) -> tuple[Any, float]:
    """Return the equations' numbers with one parameter changed a little, to a side that is possible; the factor."""
    try:
        return model_parameters(replace(vehicle, {f.key: 0.999 * f.start}), voltage), 0.999
    except InputError:  # two parameters may bound each other
        return model_parameters(replace(vehicle, {f.key: 1.001 * f.start}), voltage), 1.001


def numbers_at(base: NDArray[np.void], powers: dict[str, _Array], theta: _Array) -> NDArray[np.void]:
    """Return the records (b,) of type ``PARAMETERS`` for ``theta`` (b, n) of log-scaled parameters."""
    p = np.full(len(theta), base, dtype=PARAMETERS)
    for name, exponent in powers.items():
        factor = np.exp(theta @ exponent)
        p[name] = p[name] * (factor if p[name].ndim == 1 else factor[:, None])
    return p


def _near(symbol: str, known: Sequence[str]) -> list[str]:
    """Return known symbols that look like this one, whatever the case of letters and underscores."""
    plain = {s.lower().replace("_", ""): s for s in known}
    found = difflib.get_close_matches(symbol.lower().replace("_", ""), list(plain), n=3, cutoff=0.6)
    return [plain[k] for k in found]


def _limits(vehicle: BaseModel, prefix: str = "") -> dict[str, list[float]]:
    """Return the limits that the schema sets, other than zero, by dotted key."""
    found: dict[str, list[float]] = {}
    for name, spec in type(vehicle).model_fields.items():
        value, extra = getattr(vehicle, name), spec.json_schema_extra
        if isinstance(extra, dict) and "unit" in extra:
            bounds = [extra.get(k) for k in ("above", "at_least", "below", "at_most")]
            found[prefix + name] = [float(b) for b in bounds if isinstance(b, int | float) and b != 0]
        elif isinstance(value, BaseModel):
            found.update(_limits(value, f"{prefix}{name}."))
    return found


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
_FEWEST = 20  # samples from which a start is sought
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
class Prepared:
    """A record made ready for the simulation: what is compared, and what its windows start from.

    Attributes
    ----------
    record : Record
    noise : (m,) array
        Standard deviation of its outputs.
    motion, mast : (n, 12), (n, 3) array
        Smoothed measurement, and the direction of the mast in it.
    inputs : (n, 4) array
    base, powers
        Of :func:`batch_parameters`.
    charge : float
        Of the battery at the start, as far as it is not sought.
    constant : float or None
        Battery voltage (V) that is held; None for the vehicle's battery model.
    begin : (17,) array
        What the first start is counted from beyond the smoothed measurement, as ``MOTION + ACTUATOR``: horizontal
        velocity where it is not measured, speeds as a share of the steady ones, tilts.
    volts : (float, float)
        Voltage in the first moments and on average.
    starts : (windows,) array
        First samples of the windows.
    sought : (k,) array
        Start values that are sought, as positions in ``MOTION + ACTUATOR``.
    """

    record: Record
    noise: _Array
    motion: _Array
    mast: _Array
    inputs: _Array
    base: NDArray[np.void]
    powers: dict[str, _Array]
    charge: float
    constant: float | None
    begin: _Array
    volts: tuple[float, float]
    starts: NDArray[np.int64]
    sought: NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class Problem:
    """What :func:`make_problem` returns: records, parameters and how they are compared."""

    vehicle: Vehicle
    free: tuple[Free, ...]
    flights: tuple[Prepared, ...]
    part: Part
    hover: bool
    prior: bool
    delay_s: float
    blind_s: float = 0.0  # at the beginning of every record, where nothing is compared

    @property
    def records(self) -> tuple[Record, ...]:
        """The records, with the outputs that are compared."""
        return tuple(f.record for f in self.flights)

    @property
    def starts(self) -> tuple[NDArray[np.int64], ...]:
        """First samples of the windows of every record."""
        return tuple(f.starts for f in self.flights)

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
        return [np.zeros((len(f.starts), len(f.sought))) for f in self.flights]

    def spread(self, i: int) -> _Array:
        """Return the spread of the start values sought in record ``i``, (k,)."""
        return _SPREAD[self.flights[i].sought]

    def _each(self, **changed: Sequence[Any]) -> Problem:
        """Return the problem with fields of its records changed, a value a record."""
        rows = [dict(zip(changed, values, strict=True)) for values in zip(*changed.values(), strict=True)]
        flights = tuple(dataclasses_replace(f, **row) for f, row in zip(self.flights, rows, strict=True))
        return dataclasses_replace(self, flights=flights)

    def in_windows(self, length_s: float | None, *, hover: bool = False) -> Problem:
        """Return the same problem with windows of this length (None: each record is one), hover added or not."""
        starts, sought = [], []
        for r in self.records:
            n = len(r.time_s)
            count = 1 if length_s is None else max(1, round((n - 1) * r.sample_s / length_s))
            starts.append(np.round(np.linspace(0, n, count + 1)[:-1]).astype(np.int64))
            drags = any(float(f.base["inplane"]) > 0.0 for f in self.flights)
            sought.append(_sought(r.outputs, self.part, whole=count == 1, drags=drags))
        return dataclasses_replace(self._each(starts=starts, sought=sought), hover=hover)

    def with_held(self) -> tuple[Problem, int]:
        """Return the problem with the parameters that are held appended to the free ones, and how many are free."""
        held = held_parameters(self.vehicle, self.free, self.delay_s, self.flights[0].constant)
        wider = (*self.free, *held)
        powers = [batch_parameters(self.vehicle, wider, f.constant)[1] for f in self.flights]
        return dataclasses_replace(self._each(powers=powers), free=wider), len(self.free)

    def first(self, seconds: float) -> Problem:
        """Return the problem with the first ``seconds`` of every record, each as one window."""
        flights = []
        for f in self.flights:
            n = max(_FEWEST, round(seconds / f.record.sample_s) + 1)
            flights.append(
                dataclasses_replace(
                    f,
                    record=f.record.part(0, n),
                    motion=f.motion[:n],
                    mast=f.mast[:n],
                    inputs=f.inputs[:n],
                    starts=f.starts[:1],
                )
            )
        return dataclasses_replace(self, flights=tuple(flights))

    def with_noise(self, noise: Sequence[_Array]) -> Problem:
        """Return the problem with other noise."""
        return self._each(noise=noise)

    def begun(self, begin: Sequence[_Array]) -> Problem:
        """Return the problem with rotors, bars and batteries that begin so."""
        return self._each(begin=begin)

    def charged(self, charge: Sequence[float]) -> Problem:
        """Return the problem with these charges of the batteries."""
        return self._each(charge=charge)

    def with_charge(self, theta: _Array) -> Problem:
        """Return the problem with batteries charged such that the mean voltage is the measured one at ``theta``."""
        curve = self.vehicle.battery.open_circuit_voltage
        charges = [f.charge for f in self.flights]
        for i, f in enumerate(self.flights):
            if "voltage" not in f.record.outputs:
                continue
            k = f.record.outputs.index("voltage")
            for _ in range(5):
                e = self.charged(charges).residual(i, theta[None], self.rest()[i][None])[0, :, k]
                error = e.mean() * f.noise[k]
                rest = float(np.interp(charges[i], curve.fraction, curve.value)) - error
                charges[i] = float(np.clip(np.interp(rest, curve.value, curve.fraction), 0.02, 0.99))
        return self.charged(charges)

    def simulate(self, i: int, theta: _Array, states: _Array) -> _Array:
        """Return the outputs of record ``i`` (b, n, m) for ``theta`` (b, t) and start values (b, windows, k)."""
        f, r, b = self.flights[i], self.records[i], len(theta)
        p = numbers_at(f.base, f.powers, theta)
        values = physical(self.free, theta)
        symbols = [one.symbol for one in self.free]
        delay = values[:, symbols.index("delay")] if "delay" in symbols else np.full(b, self.delay_s)
        offset = np.zeros((b, len(MOTION) + len(ACTUATOR)))
        motion = np.repeat(f.motion[f.starts][None], b, axis=0)
        inner = f.sought < len(MOTION)
        motion[:, :, f.sought[inner]] += states[:, :, inner]
        motion[:, 0] += f.begin[: len(MOTION)]
        offset[:, f.sought] = states[:, 0, :]
        actuator = (offset + f.begin)[:, len(MOTION) :]

        hold = np.full((b, 2), -1.0)
        if self.part == "roll-pitch":
            speeds, hold = hover(p)
        else:
            first = f.inputs[: max(1, round(0.3 / r.sample_s)), :2].mean(axis=0)
            speeds = steady_speed(p, np.clip(first, 0.0, 1.0), f.volts[0])
        x = np.zeros((b, 21))
        x[:, 6] = 1.0
        x[:, 13] = p["swash_gain"] * np.clip(f.inputs[0, 3], -1, 1)
        x[:, 14] = -p["swash_gain"] * np.clip(f.inputs[0, 2], -1, 1)
        x[:, 15:18] = bar_normal(motion[:, 0, 6:9], actuator[:, 2:4])
        x[:, 18:20] = speeds * np.maximum(1.0 + actuator[:, 0:2], 0.01)
        x[:, 20] = np.clip(f.charge + actuator[:, 4], 0.0, 1.0)
        codes = np.array([OUTPUTS.index(o) for o in r.outputs], dtype=np.int64)
        y = fly_batch(
            x, p, f.inputs, sample_s=r.sample_s, codes=codes, starts=f.starts, motion=motion, mast=f.mast,
            delay_s=delay, motor_hold=hold, path=f.motion if self._follows(i) else None,
        )  # fmt: skip
        for j, symbol in enumerate(symbols):
            if symbol.startswith("bias_") and symbol[5:] in r.outputs:
                y[:, :, r.outputs.index(symbol[5:])] += values[:, j, None]
        return y

    def _follows(self, i: int) -> bool:
        """Whether horizontal velocity, which windows need and nobody measured, is to follow from the attitude."""
        f = self.flights[i]
        tilt = {"roll", "pitch"} <= set(f.record.outputs)
        return tilt and len(f.starts) > 1 and not {3, 4} & set(f.sought.tolist())

    def residual(self, i: int, theta: _Array, states: _Array) -> _Array:
        """Return (simulated - measured) / noise of record ``i``, (b, n, m); zero where nothing was measured."""
        y = self.simulate(i, theta, states)
        y -= self.records[i].measured
        y /= self.flights[i].noise
        y[:, : round(self.blind_s / self.records[i].sample_s)] = 0.0
        return np.nan_to_num(y, copy=False, nan=0.0)

    def residuals(self, theta: _Array, states: Sequence[_Array]) -> list[_Array]:
        """Return the residuals (b, n, m) of all records."""
        return [self.residual(i, theta, s) for i, s in enumerate(states)]

    def cost(self, theta: _Array, states: Sequence[_Array]) -> _Array:
        """Return ``J`` (b,) for ``theta`` (b, t) and, a record, start values (b, windows, k)."""
        return self.cost_of(theta, states, self.residuals(theta, states))

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

    def by_start(self, i: int, theta: _Array, states: _Array) -> tuple[_Array, _Array]:
        """Return the residual (n, m) of record ``i`` and its derivative (n, m, k) by the start values alone."""
        k = states.shape[1]
        starts = np.repeat(states[None], 1 + k, axis=0)
        starts[1 + np.arange(k), :, np.arange(k)] += _DELTA_STATE
        e = self.residual(i, np.repeat(theta[None], 1 + k, axis=0), starts)
        return e[0], np.moveaxis(e[1:] - e[0], 0, -1) / _DELTA_STATE

    def hover_residual(self, theta: _Array) -> _Array:
        """Return what eq. 5.1 lacks at the mean motor inputs, over its tolerance, (b, 2 records) or (b, 0)."""
        if not self.hover or self.part == "roll-pitch":
            return np.zeros((len(theta), 0))
        out = []
        for f in self.flights:
            p = numbers_at(f.base, f.powers, theta)
            duty = np.clip(f.inputs[:, :2], 0.0, 1.0).mean(axis=0)
            speed = steady_speed(p, duty, f.volts[1])
            weight = p["mass"] * GRAVITY + p["downwash"]
            up, dw = p["torque_up"] * speed[:, 0] ** 2, p["torque_dw"] * speed[:, 1] ** 2
            lift = p["thrust_up"] * speed[:, 0] ** 2 + p["thrust_dw"] * speed[:, 1] ** 2
            out += [np.log(lift / weight) / _HOVER_TOLERANCE, np.log(up / dw) / _HOVER_TOLERANCE]
        return np.column_stack(out)


def make_problem(
    vehicle: Vehicle, free: Sequence[Free], records: Sequence[Record], *, part: Part = "both",
    outputs: Sequence[str] | None = None, voltage: str | float = "measured", delay_s: float = 0.0, prior: bool = True,
) -> Problem:  # fmt: skip
    """Set up the fit of a vehicle to records.

    Parameters
    ----------
    vehicle : Vehicle
        Start values, and everything that is not free.
    free : sequence of Free
        See :func:`choose_free`.
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
        used = r.of(wanted)
        if not used.outputs or used.outputs == ("voltage",):
            have = ", ".join(r.outputs)
            raise InputError(
                r.name, "", f"holds none of {', '.join(wanted)} (but {have})", "choose other outputs"
            )
        flights.append(_prepared(vehicle, free, used, part, _volts(vehicle, used, voltage)))
    whole = Problem(vehicle, tuple(free), tuple(flights), part, False, prior, delay_s)
    return whole.in_windows(None)


def _prepared(
    vehicle: Vehicle, free: Sequence[Free], r: Record, part: Part, volts: _Array | float | None
) -> Prepared:
    """Make a record ready; ``volts`` None for the vehicle's battery model."""
    u, motion, charge = r.inputs.copy(), smoothed_motion(r), 1.0
    if part == "heave-yaw":
        u[:, 2:] = 0.0
        motion[:, [6, 7, 9, 10]] = 0.0
    if volts is None:
        charge = _start_charge(vehicle, r)
    elif np.ndim(volts) > 0:
        # Only duty times voltage counts, so a voltage that varies is put into the duty, exactly.
        top = float(np.max(volts))
        u[:, :2] = np.clip(u[:, :2], 0.0, 1.0) * (np.asarray(volts) / top)[:, None]
        volts = top
    if part == "roll-pitch":
        volts, charge = _HELD_VOLTAGE, 1.0
        motion[:, [0, 1, 2, 3, 4, 5, 8, 11]] = 0.0
    if volts is None:
        known = np.full(2, float(vehicle.battery.nominal_voltage)) if r.voltage is None else r.voltage
        first = known[: max(1, round(0.3 / r.sample_s))]
        held, constant = (float(first.mean()), float(known.mean())), None
    else:
        constant = float(np.max(volts))
        held = (constant, constant)
    base, powers = batch_parameters(vehicle, free, constant)
    mast = bar_normal(motion[:, 6:9], np.zeros((len(motion), 2)))
    none, begin = np.zeros(0, dtype=np.int64), np.zeros(len(MOTION) + len(ACTUATOR))
    return Prepared(
        r, difference_noise(r), motion, mast, u, base, powers, charge, constant, begin, held, none, none
    )


def _volts(vehicle: Vehicle, r: Record, voltage: str | float) -> _Array | float | None:
    if voltage == "model":
        return None
    if voltage == "nominal" or (voltage == "measured" and r.voltage is None):
        return float(vehicle.battery.nominal_voltage)
    if voltage == "measured" and r.voltage is not None:
        return smoothed(r.voltage, r.sample_s)
    if isinstance(voltage, str) or not 0.0 < voltage < 1e3:
        raise ArgumentError(
            "voltage", "", f"{voltage!r} is no voltage", "give measured, model, nominal or a number (V)"
        )
    return voltage


def _start_charge(vehicle: Vehicle, r: Record) -> float:
    """Return the charge at which the open-circuit voltage is what was measured first, plus a usual sag."""
    if r.voltage is None:
        return 0.5
    curve, sag = vehicle.battery.open_circuit_voltage, 3.0 * float(vehicle.battery.internal_resistance)
    rest = float(np.mean(r.voltage[: max(1, len(r.voltage) // 20)])) + sag
    return float(np.clip(np.interp(rest, curve.value, curve.fraction), 0.05, 0.98))


def _sought(outputs: Sequence[str], part: Part, *, whole: bool, drags: bool) -> NDArray[np.int64]:
    """Return which start values of ``MOTION + ACTUATOR`` are sought, given what is measured.

    Where rotors drag in their planes the tilt tells of the velocity, as it does of the bar: over a whole record.
    """
    chosen = {k for o in outputs for k in _SEEN_BY.get(o, ())}
    n = len(MOTION)
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
