"""Which signal shows which parameter, and how well, before anyone flies.

A signal is added to the inputs of the whole model in closed loop (:mod:`mufly.identify.support`). The greatest
amplitude at which attitude, height, place, heading, rates, motors and servos stay within limits is found by flying a
ladder of amplitudes, then a finer one; the limit that binds is named. The flight at that amplitude is then a record as
the fit of :mod:`mufly.identify.problem` would get it, and its sensitivities give the Fisher information

    M = S' N^-1 S,      S = d(outputs)/d(parameters, start values),      N: sensor noise (white, as given)

of the free parameters, the start values taken out (Schur complement). Its inverse is the Cramer-Rao bound: no unbiased
fit does better (Klein and Morelli, Aircraft System Identification, 2nd ed., ch. 6 and 9; Jategaonkar, ch. 2). Over a
long flight the bound is absurd: a torque out of balance by a millionth would show in the heading after 10 s, if nothing
else ever pushed. So place, velocity, attitude and rates count as unknown anew every 2 s, which stands for gusts and
drifts; a fit on windows of that length (multiple shooting) has just this bound. A wrong model and coloured noise still
make it worse, by factors that only data can tell. Several flights add their information.

Kinds are compared by the geometric mean of the parameters' relative standard deviations, over those that the record
sees at all.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mufly.dynamics import euler_from_quaternion, linearise
from mufly.errors import InputError
from mufly.identify.directions import relative_covariance, unseen_combinations
from mufly.identify.excitation import KINDS, Excitation, Kind, excitation
from mufly.identify.free import Free, choose_free
from mufly.identify.plan_limits import Limits
from mufly.identify.problem import PART_OUTPUTS, Part, make_problem
from mufly.identify.record import Record
from mufly.identify.support import Support, fly_supported, pilot_support
from mufly.vehicle import Vehicle

__all__ = ["CHANNELS", "NOISE", "Candidate", "Limits", "Plan", "design", "together"]

Array = NDArray[np.floating[Any]]
_Floats = NDArray[np.float64]

CHANNELS = ("yaw", "heave", "roll", "pitch")
# Standard deviations of ordinary small sensors: ultrasonic height (m), attitude (rad), gyros (rad/s).
NOISE = {"height": 0.01, "roll": 0.01, "pitch": 0.01, "yaw": 0.02, "p": 0.03, "q": 0.03, "r": 0.03}
_PARTS: dict[str, Part] = {
    "yaw": "heave-yaw",
    "heave": "heave-yaw",
    "roll": "roll-pitch",
    "pitch": "roll-pitch",
}
_LADDER = 14
_BLIND = 100.0  # relative standard deviation from which a parameter is not seen at all
_GREATEST, _LEAST = 1.0, 1e-3  # of the inputs' range


@dataclass(frozen=True, eq=False)
class Candidate:
    """One kind of signal at its greatest safe amplitude.

    Attributes
    ----------
    channel : str
    signal : Excitation
    amplitude : float
        Largest addition to an input (motors 0..1, servos -1..1).
    bound_by : str
        Which limit, or ``"as asked"``.
    share : float
        Of the limit that is nearest.
    added : (n, 4) array
        Added to motor upper, motor lower, servo 1, servo 2.
    record : Record
        As the flight would be logged, without noise.
    information : (p, p) array
        Of the free parameters, relative (of ``ln value``).
    relative_std : (p,) array
        Standard deviation over value; infinite where nothing is seen.
    figure : float
        Geometric mean of the standard deviations of what is seen.
    """

    channel: str
    signal: Excitation
    amplitude: float
    bound_by: str
    share: float
    added: Array
    record: Record
    information: Array
    relative_std: Array
    figure: float


@dataclass(frozen=True, eq=False)
class Plan:
    """Candidates for one channel, best first.

    Attributes
    ----------
    vehicle : str
    channel : str
    free : tuple of Free
    band_rad_s : (float, float)
    modes_rad_s : (k,) array
        Natural frequencies of the channel's dynamics.
    limits : Limits
    noise : dict of str to float
        Outputs that are measured and their standard deviations.
    candidates : tuple of Candidate
    support : Support
    """

    vehicle: str
    channel: str
    free: tuple[Free, ...]
    band_rad_s: tuple[float, float]
    modes_rad_s: Array
    limits: Limits
    noise: dict[str, float]
    candidates: tuple[Candidate, ...]
    support: Support

    @property
    def best(self) -> Candidate:
        """The candidate with the least geometric mean."""
        return self.candidates[0]


def design(
    vehicle: Vehicle, symbols: Sequence[str], channel: str, *, kinds: Sequence[Kind] = KINDS, duration_s: float = 10.0,
    amplitude: float | None = None, band_rad_s: tuple[float, float] | None = None, limits: Limits | None = None,
    noise: dict[str, float] | None = None, sample_s: float = 0.01, delay_s: float = 0.02,
    window_s: float | None = 2.0, progress: Callable[[int, int], None] | None = None,
) -> Plan:  # fmt: skip
    """Design an excitation of one channel.

    Parameters
    ----------
    vehicle : Vehicle
        As far as it is known.
    symbols : sequence of str
        Parameters that are to be identified, as ``mufly vehicle show`` prints them.
    channel : {"yaw", "heave", "roll", "pitch"}
        Motors against each other, motors together, servo 2, servo 1.
    kinds : sequence of str
        Signals to compare.
    duration_s, sample_s, delay_s : float
        Of the flight, of the log, from command to input.
    amplitude : float, optional
        Wanted addition to the inputs; lowered if it is not safe.
    band_rad_s : (float, float), optional
        Frequencies; by default from a third of the channel's slowest to three times its fastest mode.
    limits : Limits, optional
    noise : dict, optional
        Standard deviations of the outputs that are measured (names of :data:`mufly.identify.simulate.OUTPUTS`).
    window_s : float, optional
        The motion is taken as unknown anew every so often (s); None: only at the start of the flight.
    progress : callable, optional
        Called with steps done and all steps.

    Raises
    ------
    InputError
        For an unknown channel or symbol, or when not even the least signal is safe.
    """
    if channel not in CHANNELS:
        raise InputError("--channel", "", f"{channel!r} is unknown", f"use one of: {', '.join(CHANNELS)}")
    limits, noise = limits or Limits(), dict(noise or NOISE)
    part = _PARTS[channel]
    outputs = [o for o in PART_OUTPUTS[part] if o in noise]
    if not outputs:
        have = ", ".join(PART_OUTPUTS[part])
        raise InputError(
            "--noise", ",".join(noise), f"nothing of {channel} is measured", f"add one of {have}"
        )
    free = choose_free(vehicle, symbols, outputs)
    support = pilot_support(vehicle, sample_s=sample_s, delay_s=delay_s)
    modes = _modes(vehicle, support, part, sample_s)
    band = band_rad_s or _band(modes, duration_s, sample_s)
    direction = {
        "yaw": np.r_[support.differential, 0.0, 0.0], "heave": np.r_[support.collective, 0.0, 0.0],
        "roll": np.array([0.0, 0.0, 0.0, 1.0]), "pitch": np.array([0.0, 0.0, 1.0, 0.0]),
    }[channel]  # fmt: skip
    signals = [excitation(k, duration_s=duration_s, sample_s=sample_s, band_rad_s=band) for k in kinds]
    found = []
    total = 3 * len(signals)
    for i, signal in enumerate(signals):
        shape = signal.value[:, None] * direction

        def tick(step: int, i: int = i) -> None:
            if progress is not None:
                progress(3 * i + step, total)

        size, bound_by, share = _greatest(vehicle, support, shape, amplitude, limits, tick)
        states, inputs, voltage = fly_supported(vehicle, support, size * shape[None])
        record = _record(states[0], inputs[0], voltage[0], signal.time_s, outputs, f"{channel} {signal.kind}")
        information = _information(vehicle, free, record, part, noise, delay_s, window_s)
        std, figure = _accuracy(information)
        found.append(
            Candidate(channel, signal, size, bound_by, share, size * shape, record, information, std, figure)
        )
        tick(3)
    found.sort(key=lambda c: (int(np.sum(~np.isfinite(c.relative_std))), c.figure))
    return Plan(vehicle.name, channel, free, band, modes, limits, noise, tuple(found), support)


def together(plans: Sequence[Plan], candidates: Sequence[Candidate]) -> tuple[Array, tuple[str, ...]]:
    """Return what flights tell together: relative standard deviations (p,), and what they do not, in words."""
    information = np.sum([c.information for c in candidates], axis=0)
    symbols = [f.symbol for f in plans[0].free]
    covariance = relative_covariance(information, np.ones(len(symbols)))
    return _accuracy(information)[0], unseen_combinations(symbols, covariance)


def _modes(vehicle: Vehicle, support: Support, part: Part, sample_s: float) -> Array:
    """Return the natural frequencies (rad/s) that a log at this rate can show."""
    linear = linearise(vehicle, support.hover)
    system = linear.heave_yaw if part == "heave-yaw" else linear.roll_pitch
    size = np.abs(np.linalg.eigvals(system.A))
    return np.unique(np.round(size[(size > 1e-2) & (size < 0.3 * math.pi / sample_s)], 6))


def _band(modes: Array, duration_s: float, sample_s: float) -> tuple[float, float]:
    slow, fast = (modes.min(), modes.max()) if modes.size else (2.0, 10.0)
    low = max(slow / 3.0, 2.2 * math.pi / duration_s)
    return low, float(min(max(3.0 * fast, 3.0 * low), 0.2 * math.pi / sample_s))


def _greatest(
    vehicle: Vehicle, support: Support, shape: Array, wanted: float | None, limits: Limits, tick: Callable[[int], None]
) -> tuple[float, str, float]:  # fmt: skip
    """Return the greatest safe amplitude, the limit that binds and the share of the nearest limit that is used."""
    top = _GREATEST if wanted is None else wanted
    if not (math.isfinite(top) and 0 < top <= _GREATEST):
        raise InputError(
            "--amplitude", "", f"{top:g} is not possible", "give a share of the inputs' range, up to 1"
        )
    low, high, low_share, binding = 0.0, top, math.inf, "as asked"
    ladder = np.geomspace(min(_LEAST, top), top, _LADDER)
    for step in (1, 2):
        states, inputs, _ = fly_supported(vehicle, support, ladder[:, None, None] * shape[None])
        shares, names = limits.used(states, inputs)
        safe = np.all(shares <= 1.0, axis=1)
        tick(step)
        if safe.all():
            return float(ladder[-1]), "as asked" if step == 1 else binding, float(shares[-1].max())
        first = int(np.argmin(safe))
        binding = names[int(np.argmax(shares[first]))]
        if first == 0:
            if step == 1:
                least = f"is passed by the least signal ({100 * ladder[0]:.2g} % of range)"
                raise InputError(
                    vehicle.name, f"limit on {binding}", least, "widen it, or lighten the vehicle"
                )
            break
        low, low_share, high = float(ladder[first - 1]), float(shares[first - 1].max()), float(ladder[first])
        ladder = np.linspace(low, high, _LADDER)[1:-1]
    return low, binding, low_share


def _record(
    states: _Floats, inputs: _Floats, voltage: _Floats, time: _Floats, outputs: Sequence[str], name: str
) -> Record:
    angle = euler_from_quaternion(states[:, 6:10])
    table = {
        "north": states[:, 0], "east": states[:, 1], "height": -states[:, 2], "v_north": states[:, 3],
        "v_east": states[:, 4], "climb": -states[:, 5], "roll": angle[:, 0], "pitch": angle[:, 1],
        "yaw": np.unwrap(angle[:, 2]), "p": states[:, 10], "q": states[:, 11], "r": states[:, 12],
        "speed_up": states[:, 18], "speed_dw": states[:, 19], "voltage": voltage,
    }  # fmt: skip
    return Record(name, time, inputs, tuple(outputs), np.column_stack([table[o] for o in outputs]), voltage)


def _information(
    vehicle: Vehicle, free: Sequence[Free], record: Record, part: Part, noise: dict[str, float], delay_s: float,
    window_s: float | None,
) -> Array:  # fmt: skip
    """Return the Fisher information of ``theta`` (p, p) with the start values of every window taken out."""
    problem = make_problem(vehicle, free, [record], part=part, delay_s=delay_s, prior=False)
    problem = problem.with_noise([np.array([noise[o] for o in problem.records[0].outputs])]).in_windows(
        window_s
    )
    linear = problem.linearise(0, np.zeros(len(free)), problem.rest()[0])
    # The spread of the start values is wide; it only keeps unseen ones from making the matrix singular.
    wide = np.diag(1.0 / problem.spread(0) ** 2)
    information = np.zeros((len(free), len(free)))
    for one in np.split(np.arange(len(record.time_s)), problem.starts[0][1:]):
        theta = linear.by_theta[one].reshape(-1, len(free))
        start = linear.by_state[one].reshape(theta.shape[0], -1)
        across = theta.T @ start
        information += theta.T @ theta - across @ np.linalg.solve(start.T @ start + wide, across.T)
    return information


def _accuracy(information: Array) -> tuple[Array, float]:
    """Return relative standard deviations (p,), infinite where nothing is seen, and their geometric mean."""
    std = np.full(len(information), np.inf)
    some = np.diag(information) > 0
    size = np.sqrt(np.diag(information)[some])
    if not size.size:
        return std, math.inf
    values, vectors = np.linalg.eigh(information[np.ix_(some, some)] / np.outer(size, size))
    std[some] = np.sqrt(np.diag((vectors / np.maximum(values, 1e-13)) @ vectors.T)) / size
    std[std > _BLIND] = np.inf
    seen = np.isfinite(std)
    return std, float(np.exp(np.mean(np.log(std[seen])))) if seen.any() else math.inf
