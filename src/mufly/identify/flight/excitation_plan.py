"""Design of excitation signals: expected accuracy of every parameter before the flight.

A signal is added to the inputs of the whole model in closed loop (:class:`HoverFeedback`). The largest safe amplitude
keeps attitude, height, position, heading, rates, motors and servos within limits. It is found by simulating a coarse
and then a finer series of amplitudes; the binding limit is named. The flight at that amplitude becomes a record for
the fit of :mod:`mufly.identify.flight.output_error_problem`, whose sensitivities give the Fisher information

    M = S' N^-1 S,      S = d(outputs)/d(parameters, start values),      N: sensor noise (white, as given)

of the free parameters, with the initial state eliminated (Schur complement). Its inverse is the Cramer-Rao bound, the
least variance of an unbiased fit (Klein and Morelli, Aircraft System Identification, 2nd ed., ch. 6 and 9;
Jategaonkar, ch. 2). Over a long undisturbed flight this bound is unrealistic: a torque imbalance of a millionth would
be visible in the heading after 10 s. Position, velocity, attitude and rates therefore count as unknown again every
2 s, which represents gusts and drift. A fit on windows of that length (multiple shooting) has the same bound. Model
errors and coloured noise increase the variance further, by factors that only data show. The information of several
flights is summed.

Signal kinds are compared by the geometric mean of the relative standard deviations of all identifiable parameters.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mufly.dynamics import (
    linearise_vehicle,
)
from mufly.dynamics.model_state import (
    ATTITUDE_SLICE,
    BODY_RATE_SLICE,
    MODEL_RATES,
    MODEL_SPEED_LOWER,
    MODEL_SPEED_UPPER,
    MOTOR_INPUT_SLICE,
    NED_POSITION_SLICE,
    NED_VELOCITY_SLICE,
    SERVO_INPUT_SLICE,
)
from mufly.errors import ArgumentError, InputError
from mufly.identify.fit_result import covariance_from_information, describe_undetermined_combinations
from mufly.identify.flight.excitation_signals import (
    SIGNAL_KINDS,
    ExcitationSignal,
    SignalKind,
    make_excitation,
)
from mufly.identify.flight.free_parameters import FreeParameter, choose_free_parameters
from mufly.identify.flight.hover_feedback import HoverFeedback, design_hover_feedback, simulate_closed_loop_flights
from mufly.identify.flight.output_error_problem import PART_OUTPUTS, DynamicsPart, make_problem
from mufly.identify.flight_record import FlightRecord
from mufly.results import ShownBlock, make_lines_block, make_table_block, result, select_fields
from mufly.rotations import euler_from_quaternion
from mufly.vehicle import Vehicle

Array = NDArray[np.floating[Any]]
_Floats = NDArray[np.float64]


@dataclass(frozen=True)
class FlightLimits:
    """Limits of the deviation from hover and of the inputs.

    Attributes
    ----------
    attitude_rad, heading_rad, rates_rad_s : float
        Largest deviation of roll and pitch, of yaw, and of any body rate.
    height_m, place_m : float
        Largest vertical and horizontal deviation.
    motor_margin, servo_margin : float
        Margins of the inputs: motors stay within the margin to one less the margin, servos within one less the margin.
    """

    attitude_rad: float = math.radians(20)
    heading_rad: float = math.radians(90)
    rates_rad_s: float = 4.0
    height_m: float = 0.5
    place_m: float = 1.0
    motor_margin: float = 0.05
    servo_margin: float = 0.1

    def limit_usage(self, states: Array, inputs: Array) -> tuple[Array, list[str]]:
        """Return each flight's largest deviation relative to every limit, (b, limits), and the names of the limits.

        ``states`` and ``inputs`` are those of b flights, (b, n, ...).
        """
        angle = euler_from_quaternion(states[..., ATTITUDE_SLICE])
        heading = np.unwrap(angle[..., 2], axis=1)
        at = states[..., NED_POSITION_SLICE] - states[:, :1, NED_POSITION_SLICE]
        shares = {
            "attitude": np.abs(angle[..., :2]).max(axis=(1, 2)) / self.attitude_rad,
            "heading": np.abs(heading - heading[:, :1]).max(axis=1) / self.heading_rad,
            "body rates": np.abs(states[..., BODY_RATE_SLICE]).max(axis=(1, 2)) / self.rates_rad_s,
            "height": np.abs(at[..., 2]).max(axis=1) / self.height_m,
            "place": np.linalg.norm(at[..., :2], axis=2).max(axis=1) / self.place_m,
            "motor input": np.abs(inputs[..., MOTOR_INPUT_SLICE] - 0.5).max(axis=(1, 2)) / (0.5 - self.motor_margin),
            "servo input": np.abs(inputs[..., SERVO_INPUT_SLICE]).max(axis=(1, 2)) / (1.0 - self.servo_margin),
        }
        table = np.column_stack(list(shares.values()))
        return np.where(np.isfinite(table), table, np.inf), list(shares)


CONTROL_CHANNELS = ("yaw", "heave", "roll", "pitch")
# Standard deviations of typical small sensors: ultrasonic height (m), attitude (rad), gyros (rad/s).
SENSOR_NOISE_STD = {"height": 0.01, "roll": 0.01, "pitch": 0.01, "yaw": 0.02, "p": 0.03, "q": 0.03, "r": 0.03}
_PART_BY_CHANNEL: dict[str, DynamicsPart] = dict(
    zip(CONTROL_CHANNELS, 2 * ("heave-yaw",) + 2 * ("roll-pitch",), strict=True)
)
_MAX_AMPLITUDE_TRIALS = 14
_UNIDENTIFIABLE_RELATIVE_STD = 100.0  # relative standard deviation above which a parameter counts as unidentifiable
_MAX_AMPLITUDE_FRACTION, _MIN_AMPLITUDE_FRACTION = 1.0, 1e-3  # fractions of the input range


@dataclass(frozen=True, eq=False)
class ExcitationCandidate:
    """One kind of signal at its largest safe amplitude.

    Attributes
    ----------
    channel : str
    signal : ExcitationSignal
    amplitude : float
        Largest addition to an input (motors 0..1, servos -1..1).
    binding_limit : str
        Name of the limit that binds, or ``"as asked"`` for the wanted amplitude.
    limit_fraction : float
        Used share of the nearest limit.
    added_inputs : (n, 4) array
        Signals added to upper motor, lower motor, servo 1 and servo 2.
    record : FlightRecord
        Record of the simulated flight, without noise.
    fisher_information : (p, p) array
        Fisher information of ``ln value`` of the free parameters.
    relative_std : (p,) array
        Standard deviation over value; infinite for unidentifiable parameters.
    geometric_mean_std : float
        Geometric mean of the finite entries of ``relative_std``.
    """

    channel: str
    signal: ExcitationSignal
    amplitude: float
    binding_limit: str
    limit_fraction: float
    added_inputs: Array
    record: FlightRecord
    fisher_information: Array
    relative_std: Array
    geometric_mean_std: float


_CANDIDATE_RECORD_FIELDS = (
    "kind=signal.kind amplitude bound_by=binding_limit limit_used=limit_fraction crest_factor=signal.crest "
    "signal=signal.description mean=geometric_mean_std"
)


@result(
    eq=False,
    json="channel band_Hz modes_Hz noise limits candidates=tabulate_candidates",
)
class ExcitationPlan:
    """Candidate signals for one channel, best first.

    Attributes
    ----------
    vehicle : str
    channel : str
    free_parameters : tuple of FreeParameter
    band_rad_s : (float, float)
    modes_rad_s : (k,) array
        Natural frequencies of the channel's dynamics.
    limits : FlightLimits
    noise : dict of str to float
        Standard deviations of the measured outputs.
    candidates : tuple of ExcitationCandidate
    support : HoverFeedback
    """

    vehicle: str
    channel: str
    free_parameters: tuple[FreeParameter, ...]
    band_rad_s: tuple[float, float]
    modes_rad_s: Array
    limits: FlightLimits
    noise: dict[str, float]
    candidates: tuple[ExcitationCandidate, ...]
    support: HoverFeedback

    @property
    def band_Hz(self) -> tuple[float, float]:
        """Frequency band of the signals (Hz)."""
        return self.band_rad_s[0] / (2 * math.pi), self.band_rad_s[1] / (2 * math.pi)

    @property
    def modes_Hz(self) -> list[float]:
        """Natural frequencies of the channel's dynamics (Hz)."""
        return [w / (2 * math.pi) for w in self.modes_rad_s]

    def tabulate_candidates(self) -> list[dict[str, Any]]:
        """Return amplitudes and expected standard deviations of all candidate signals as dictionaries."""
        symbols = [f.symbol for f in self.free_parameters]
        return [
            {
                **select_fields(c, _CANDIDATE_RECORD_FIELDS),
                "relative_std": dict(zip(symbols, c.relative_std, strict=True)),
            }
            for c in self.candidates
        ]

    @property
    def best_candidate(self) -> ExcitationCandidate:
        """Candidate with the smallest geometric mean of relative standard deviations."""
        return self.candidates[0]

    def make_printed_blocks(self) -> tuple[ShownBlock, ...]:
        """Return amplitude and expected standard deviations of every candidate as printed text."""
        rows = [
            (c.signal.kind, f"{100 * c.amplitude:.1f} %", c.binding_limit, f"{c.signal.crest:.2f}",
             *(_format_relative_std(s) for s in (*c.relative_std, c.geometric_mean_std)))
            for c in self.candidates
        ]  # fmt: skip
        (low, high), modes = self.band_Hz, ", ".join(f"{m:.2g}" for m in self.modes_Hz)
        title = (
            f"{self.vehicle}, {self.channel}: expected standard deviations; {low:.2g} to {high:.2g} Hz, modes at "
            f"{modes} Hz"
        )
        symbols = [f.symbol for f in self.free_parameters]
        best = self.best_candidate.signal
        return (
            make_table_block(("kind", "amplitude", "bound by", "crest", *symbols, "mean"), rows, title=title),
            make_lines_block(f"{best.kind}: {best.description}"),
        )


def _format_relative_std(share: float) -> str:
    if not math.isfinite(share) or share > 10:
        return "not observable"
    return f"{100 * share:.0f} %" if share >= 0.1 else f"{100 * share:.2g} %"


@result(eq=False)
class CombinedPlan:
    """Plans of several channels, with one flight by the best signal of each.

    Attributes
    ----------
    plans : tuple of ExcitationPlan
    relative_std : (p,) array
        Expected standard deviation over value of the parameters after all flights.
    undetermined : tuple of str
        Combinations of parameters that stay undetermined.
    """

    plans: tuple[ExcitationPlan, ...]
    relative_std: Array
    undetermined: tuple[str, ...]

    @property
    def symbols(self) -> list[str]:
        """Symbols of the parameters."""
        return [f.symbol for f in self.plans[0].free_parameters]

    def as_record(self) -> dict[str, Any]:
        """Return vehicle, parameters, channels and what all flights together determine."""
        return {
            "vehicle": self.plans[0].vehicle, "free": self.symbols, "channels": self.plans,
            "together": dict(zip(self.symbols, self.relative_std, strict=True)), "undetermined": self.undetermined,
        }  # fmt: skip

    def make_printed_blocks(self) -> tuple[ShownBlock, ...]:
        """Return each plan, and what all flights together determine, as printed text."""
        row = ("all flights", *(_format_relative_std(s) for s in self.relative_std))
        title = "Expected standard deviation, together"
        return (
            *(block for p in self.plans for block in p.make_printed_blocks()),
            *((make_table_block(("", *self.symbols), [row], title=title),) if len(self.plans) > 1 else ()),
            make_lines_block(*self.undetermined, mark="not observable"),
            make_lines_block(
                "These are lower bounds for this model with white sensor noise; unmodelled effects make real fits "
                "worse, often several times.",
                style="dim",
            ),
        )


def design_excitation(
    vehicle: Vehicle,
    symbols: Sequence[str],
    channel: str,
    *,
    kinds: Sequence[SignalKind] = SIGNAL_KINDS,
    duration_s: float = 10.0,
    amplitude: float | None = None,
    band_rad_s: tuple[float, float] | None = None,
    limits: FlightLimits | None = None,
    noise: dict[str, float] | None = None,
    sample_s: float = 0.01,
    delay_s: float = 0.02,
    window_s: float | None = 2.0,
    progress: Callable[[int, int], None] | None = None,
) -> ExcitationPlan:
    """Design an excitation of one channel.

    Parameters
    ----------
    vehicle : Vehicle
        Vehicle with the present values of its parameters.
    symbols : sequence of str
        Parameters to identify, as printed by ``mufly vehicle show``.
    channel : {"yaw", "heave", "roll", "pitch"}
        Channel, excited by differential motors, collective motors, servo 2 or servo 1.
    kinds : sequence of str
        Kinds of signal to compare.
    duration_s, sample_s, delay_s : float
        Duration of the flight, sample time of the log, delay from command to input (s).
    amplitude : float, optional
        Wanted amplitude as share of the input range; reduced if it is not safe.
    band_rad_s : (float, float), optional
        Frequency band; by default from a third of the channel's slowest to three times its fastest mode.
    limits : FlightLimits, optional
    noise : dict, optional
        Standard deviations of the measured outputs (names of
        :data:`mufly.identify.flight_record.FLIGHT_OUTPUTS`).
    window_s : float, optional
        Interval after which the motion counts as unknown again (s); None: only at the start of the flight.
    progress : callable, optional
        Called with the number of steps done and of all steps.

    Raises
    ------
    InputError
        For an unknown channel or symbol, or when not even the smallest signal is safe.
    """
    if channel not in CONTROL_CHANNELS:
        raise ArgumentError("channel", "", f"{channel!r} is unknown", f"use one of: {', '.join(CONTROL_CHANNELS)}")
    limits, noise = limits or FlightLimits(), dict(noise or SENSOR_NOISE_STD)
    part = _PART_BY_CHANNEL[channel]
    outputs = [o for o in PART_OUTPUTS[part] if o in noise]
    if not outputs:
        have = ", ".join(PART_OUTPUTS[part])
        raise ArgumentError("noise", ",".join(noise), f"no output of {channel} is measured", f"add one of {have}")
    free = choose_free_parameters(vehicle, symbols, outputs)
    support = design_hover_feedback(vehicle, sample_s=sample_s, delay_s=delay_s)
    modes = _natural_frequencies(vehicle, support, part, sample_s)
    band = band_rad_s or _excitation_band(modes, duration_s, sample_s)
    direction = {
        "yaw": np.r_[support.differential_direction, 0.0, 0.0], "heave": np.r_[support.collective_direction, 0.0, 0.0],
        "roll": np.array([0.0, 0.0, 0.0, 1.0]), "pitch": np.array([0.0, 0.0, 1.0, 0.0]),
    }[channel]  # fmt: skip
    signals = [make_excitation(k, duration_s=duration_s, sample_s=sample_s, band_rad_s=band) for k in kinds]
    found = []
    total = 3 * len(signals)
    for i, signal in enumerate(signals):
        shape = signal.value[:, None] * direction

        def report_progress(step: int, i: int = i) -> None:
            if progress is not None:
                progress(3 * i + step, total)

        size, bound_by, share = _max_safe_amplitude(vehicle, support, shape, amplitude, limits, report_progress)
        states, inputs, voltage = simulate_closed_loop_flights(vehicle, support, size * shape[None])
        record = _record_from_states(
            states[0], inputs[0], voltage[0], signal.time_s, outputs, f"{channel} {signal.kind}"
        )
        information = _fisher_information(vehicle, free, record, part, noise, delay_s, window_s)
        std, figure = _relative_std_and_mean(information)
        found.append(
            ExcitationCandidate(channel, signal, size, bound_by, share, size * shape, record, information, std, figure)
        )
        report_progress(3)
    found.sort(key=lambda c: (int(np.sum(~np.isfinite(c.relative_std))), c.geometric_mean_std))
    return ExcitationPlan(vehicle.name, channel, free, band, modes, limits, noise, tuple(found), support)


def combine_expected_std(
    plans: Sequence[ExcitationPlan], candidates: Sequence[ExcitationCandidate]
) -> tuple[Array, tuple[str, ...]]:
    """Return the relative standard deviations (p,) of the parameters if one flight is made with each candidate signal.

    Return also descriptions of the combinations of parameters that stay undetermined.
    """
    information = np.sum([c.fisher_information for c in candidates], axis=0)
    undetermined = describe_undetermined_combinations(
        [f.symbol for f in plans[0].free_parameters], covariance_from_information(information)
    )
    return _relative_std_and_mean(information)[0], undetermined


def combine_plans(plans: Sequence[ExcitationPlan]) -> CombinedPlan:
    """Return the plans of several channels, with one flight by the best signal of each."""
    return CombinedPlan(tuple(plans), *combine_expected_std(plans, [p.best_candidate for p in plans]))


def _natural_frequencies(vehicle: Vehicle, support: HoverFeedback, part: DynamicsPart, sample_s: float) -> Array:
    """Return the natural frequencies (rad/s) of the vehicle that a log with sample time ``sample_s`` resolves."""
    linear = linearise_vehicle(vehicle, support.hover)
    system = linear.heave_yaw if part == "heave-yaw" else linear.roll_pitch
    size = np.abs(np.linalg.eigvals(system.A))
    return np.unique(np.round(size[(size > 1e-2) & (size < 0.3 * math.pi / sample_s)], 6))


def _excitation_band(modes: Array, duration_s: float, sample_s: float) -> tuple[float, float]:
    slow, fast = (modes.min(), modes.max()) if modes.size else (2.0, 10.0)
    low = max(slow / 3.0, 2.2 * math.pi / duration_s)
    return low, float(min(max(3.0 * fast, 3.0 * low), 0.2 * math.pi / sample_s))


def _max_safe_amplitude(
    vehicle: Vehicle,
    support: HoverFeedback,
    shape: Array,
    wanted: float | None,
    limits: FlightLimits,
    tick: Callable[[int], None],
) -> tuple[float, str, float]:
    """Return the largest safe amplitude, the limit that determines it, and the largest deviation over its limit."""
    top = _MAX_AMPLITUDE_FRACTION if wanted is None else wanted
    if not (math.isfinite(top) and 0 < top <= _MAX_AMPLITUDE_FRACTION):
        raise ArgumentError("amplitude", "", f"{top:g} is out of range", "give a share of the inputs' range, up to 1")
    low, high, low_share, binding = 0.0, top, math.inf, "as asked"
    ladder = np.geomspace(min(_MIN_AMPLITUDE_FRACTION, top), top, _MAX_AMPLITUDE_TRIALS)
    for step in (1, 2):
        states, inputs, _ = simulate_closed_loop_flights(vehicle, support, ladder[:, None, None] * shape[None])
        shares, names = limits.limit_usage(states, inputs)
        safe = np.all(shares <= 1.0, axis=1)
        tick(step)
        if safe.all():
            return float(ladder[-1]), "as asked" if step == 1 else binding, float(shares[-1].max())
        first = int(np.argmin(safe))
        binding = names[int(np.argmax(shares[first]))]
        if first == 0:
            if step == 1:
                least = f"is exceeded by the smallest signal ({100 * ladder[0]:.2g} % of range)"
                raise InputError(
                    vehicle.name, f"limit on {binding}", least, "raise the limit, or reduce the vehicle's mass"
                )
            break
        low, low_share, high = float(ladder[first - 1]), float(shares[first - 1].max()), float(ladder[first])
        ladder = np.linspace(low, high, _MAX_AMPLITUDE_TRIALS)[1:-1]
    return low, binding, low_share


def _record_from_states(
    states: _Floats, inputs: _Floats, voltage: _Floats, time: _Floats, outputs: Sequence[str], name: str
) -> FlightRecord:
    angle = euler_from_quaternion(states[:, ATTITUDE_SLICE])
    (north, east, down), (v_north, v_east, v_down) = states[:, NED_POSITION_SLICE].T, states[:, NED_VELOCITY_SLICE].T
    table = {
        "north": north, "east": east, "height": -down, "v_north": v_north, "v_east": v_east, "climb": -v_down,
        "roll": angle[:, 0], "pitch": angle[:, 1], "yaw": np.unwrap(angle[:, 2]),
        "p": states[:, MODEL_RATES], "q": states[:, MODEL_RATES + 1], "r": states[:, MODEL_RATES + 2],
        "speed_up": states[:, MODEL_SPEED_UPPER], "speed_dw": states[:, MODEL_SPEED_LOWER], "voltage": voltage,
    }  # fmt: skip
    return FlightRecord(name, time, inputs, tuple(outputs), np.column_stack([table[o] for o in outputs]), voltage)


def _fisher_information(
    vehicle: Vehicle,
    free: Sequence[FreeParameter],
    record: FlightRecord,
    part: DynamicsPart,
    noise: dict[str, float],
    delay_s: float,
    window_s: float | None,
) -> Array:
    """Return the Fisher information (p, p) of ``theta`` with the initial state of every window eliminated."""
    problem = make_problem(vehicle, free, [record], part=part, delay_s=delay_s, prior=False)
    problem = problem.with_noise([np.array([noise[o] for o in problem.records[0].output_names])]).with_windows(window_s)
    linear = problem.linearise_record(0, np.zeros(len(free)), problem.make_zero_initial_states()[0])
    # The wide prior of the initial states only prevents a singular matrix for undetermined states.
    wide = np.diag(1.0 / problem.initial_state_std(0) ** 2)
    information = np.zeros((len(free), len(free)))
    for one in np.split(np.arange(len(record.time_s)), problem.window_starts[0][1:]):
        theta = linear.theta_jacobian[one].reshape(-1, len(free))
        start = linear.initial_state_jacobian[one].reshape(theta.shape[0], -1)
        across = theta.T @ start
        information += theta.T @ theta - across @ np.linalg.solve(start.T @ start + wide, across.T)
    return information


def _relative_std_and_mean(information: Array) -> tuple[Array, float]:
    """Return the relative standard deviations (p,), infinite if unidentifiable, and the geometric mean of the finite
    ones.
    """
    std = np.full(len(information), np.inf)
    some = np.diag(information) > 0
    size = np.sqrt(np.diag(information)[some])
    if not size.size:
        return std, math.inf
    values, vectors = np.linalg.eigh(information[np.ix_(some, some)] / np.outer(size, size))
    std[some] = np.sqrt(np.diag((vectors / np.maximum(values, 1e-13)) @ vectors.T)) / size
    std[std > _UNIDENTIFIABLE_RELATIVE_STD] = np.inf
    seen = np.isfinite(std)
    return std, float(np.exp(np.mean(np.log(std[seen])))) if seen.any() else math.inf
