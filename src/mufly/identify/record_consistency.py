"""Consistency of a flight record: units, signs, axes, scales and lags, checked before a fit.

Kinematics relate the readings of different sensors. Body rates follow from the attitude (large Euler angles; inverse
of Stevens, Lewis and Johnson, *Aircraft Control and Simulation*, 3rd ed., eq. 1.4-4),

    p = roll' - yaw' sin(pitch)
    q = pitch' cos(roll) + yaw' sin(roll) cos(pitch)
    r = -pitch' sin(roll) + yaw' cos(roll) cos(pitch)

and a velocity is the derivative of a position. Both sides are averaged over the same 0.2 s, in which a change of angle
is exactly the mean rate. :func:`compare_signal_with_prediction` then estimates

* the **lag**: the time of the largest correlation, with its jackknife
  (:func:`mufly.logs.delay_estimation.estimate_delay`);
* the **sign** of this correlation;
* the **factor**: it lies between the two regression slopes of either side on the other, because noise lowers one slope
  and raises the other. A factor is reported only if both slopes deviate.

A factor near a unit conversion names the unit. A factor wrong by a fifth, or a lag above 50 ms, would cause wrong
parameters and raises an error; smaller significant deviations are reported. Constant signals are not judged.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mufly.errors import InputError
from mufly.identify.flight_record import FLIGHT_INPUTS, FlightRecord, fill_gaps, smooth_signal
from mufly.logs.delay_estimation import estimate_delay

Array = NDArray[np.float64]

_SIGNAL_AVERAGING_SPAN_S = 0.2  # averaging time of both sides
_MAX_SEARCHED_LAG_S = 0.5  # largest lag of the search
_MIN_JUDGED_CORRELATION = 0.6  # least correlation of a judged pair
_MAX_UNRELATED_CORRELATION = 0.3  # largest correlation of an unrelated pair
_MIN_EXCHANGED_AXIS_CORRELATION = 0.8  # least correlation with an exchanged axis
_REPORTED_LAG_S, _REFUSED_LAG_S = 0.015, 0.05  # lags above which a warning, or an error, is issued
_REPORTED_SCALE_ERROR, _REFUSED_SCALE_ERROR = 0.1, 0.2  # scale errors above which a warning, or an error, is issued
_MAX_ACCELERATION_m_s2 = 20.0  # m/s2, RMS: two g, more than a rotorcraft with thrust to weight of 3 reaches
_MAX_TILT_WITHOUT_YAW_rad = np.radians(15.0)  # tilt below which an unknown yaw has little influence
# Ratio of the value in a unit to the SI value.
_UNIT_FACTORS = {
    "angle": (("degrees", "deg", 57.2958),),
    "length": (("centimetres", "cm", 100.0), ("millimetres", "mm", 1000.0), ("feet", "ft", 3.28084)),
    "angle a second": (("degrees a second", "deg/s", 57.2958),),
    "speed": (
        ("centimetres a second", "cm/s", 100.0), ("millimetres a second", "mm/s", 1000.0),
        ("kilometres an hour", "km/h", 3.6), ("feet a second", "ft/s", 3.28084),
    ),
}  # fmt: skip
_UNIT_FACTOR_TOLERANCE = 0.08  # relative tolerance of a unit factor; degrees are detected from 30 to 110


@dataclass(frozen=True)
class SignalFault:
    """Fault found in one signal of a flight record, with its remedy.

    Attributes
    ----------
    signal : str
    problem, remedy : str
    is_fatal : bool
        Whether the fault would cause wrong parameters in a fit.
    """

    signal: str
    problem: str
    remedy: str
    is_fatal: bool = True


@dataclass(frozen=True)
class SignalAgreement:
    """Agreement of a sensor signal with its prediction by kinematics from other sensors: scale factor, lag and
    correlation.

    Attributes
    ----------
    correlation : float
        Correlation after correction of the lag.
    lag_s, lag_std_s : float
        Lag and standard deviation (s); positive if the sensor is late; NaN if undetermined.
    scale_low, scale_high : float
        Bounds of the factor's absolute value, including noise on either side.
    """

    correlation: float
    lag_s: float
    lag_std_s: float
    scale_low: float
    scale_high: float


def moving_average(y: Array, samples: int) -> Array:
    """Return the moving average of ``y`` (n,) or (n, k) over ``samples`` samples, without incomplete windows."""
    total = np.concatenate([np.zeros_like(y[:1]), np.cumsum(y, axis=0)])
    return np.asarray((total[samples:] - total[:-samples]) / samples)


def compare_signal_with_prediction(read: Array, made: Array, sample_s: float) -> SignalAgreement:
    """Compare a sensor signal ``read`` with its prediction ``made``, (n,) each, uniformly sampled."""
    n = len(read)
    if n < 60 or read.std() == 0.0 or made.std() == 0.0:
        return SignalAgreement(0.0, np.nan, np.nan, 0.0, np.inf)
    longest = min(_MAX_SEARCHED_LAG_S, 0.2 * n * sample_s)
    found = estimate_delay(np.asarray(np.arange(n) * sample_s, dtype=np.float64), made, read, longest_s=longest)
    told = found.is_determined
    shift = round(found.delay_s / sample_s) if told else 0
    a = read[max(shift, 0) : n + min(shift, 0)]
    b = made[max(-shift, 0) : n - max(shift, 0)]
    a, b = a - a.mean(), b - b.mean()
    c = float(a @ b) / max(float(np.sqrt((a @ a) * (b @ b))), 1e-300)
    ratio = float(a.std() / max(b.std(), 1e-300))
    # Blocks of the record give the statistical error of the slope.
    blocks = [(x, y) for x, y in zip(np.array_split(a, 8), np.array_split(b, 8), strict=True)]
    left = np.array([[a @ b - x @ y, b @ b - y @ y, a @ a - x @ x] for x, y in blocks])
    slopes = np.abs(left[:, 0]) / np.maximum(left[:, 1], 1e-300)
    doubt = 2.4 * float(np.sqrt(7.0 * np.var(slopes))) / max(abs(c) * ratio, 1e-300)
    low, high = ratio * abs(c), ratio / max(abs(c), 1e-6)
    return SignalAgreement(
        c, found.delay_s if told else np.nan, found.std_s if told else np.nan,
        low * max(0.0, 1.0 - doubt), high * (1.0 + doubt),
    )  # fmt: skip


def rates_from_attitude(attitude: Array, sample_s: float) -> Array:
    """Return p, q, r (n - 1, 3), in rad/s, halfway between samples of roll, pitch and yaw (n, 3), in rad."""
    turn, middle = np.diff(attitude, axis=0) / sample_s, 0.5 * (attitude[1:] + attitude[:-1])
    s1, c1 = np.sin(middle[:, 0]), np.cos(middle[:, 0])
    s2, c2 = np.sin(middle[:, 1]), np.cos(middle[:, 1])
    return np.column_stack(
        [
            turn[:, 0] - turn[:, 2] * s2,
            turn[:, 1] * c1 + turn[:, 2] * s1 * c2,
            -turn[:, 1] * s1 + turn[:, 2] * c1 * c2,
        ]
    )


def find_faults_against_predictions(
    names: Sequence[str], read: Array, made: Array, sample_s: float, *, kind: str, source: Sequence[str]
) -> Iterator[SignalFault]:
    """Yield faults of unit, sign, axis, scale and lag in sensor signals that should equal their predictions.

    Parameters
    ----------
    names : sequence of str
        Names of the ``k`` signals.
    read, made : (n, k) array
        Sensor signals and their predictions from other sensors (SI), with equal averaging.
    sample_s : float
    kind : str
        Kind of quantity, a key of ``_UNIT_FACTORS``.
    source : sequence of str
        Name of the sensor behind each column of ``made``.
    """
    own = [compare_signal_with_prediction(read[:, k], made[:, k], sample_s) for k in range(len(names))]
    for k, (name, a) in enumerate(zip(names, own, strict=True)):
        if abs(a.correlation) < _MIN_JUDGED_CORRELATION:
            cross = [_zero_lag_correlation(read[:, k], made[:, j]) if j != k else 0.0 for j in range(len(names))]
            j = int(np.argmax(np.abs(cross)))
            if (
                abs(cross[j]) > _MIN_EXCHANGED_AXIS_CORRELATION
                and abs(_zero_lag_correlation(read[:, k], made[:, k])) < _MAX_UNRELATED_CORRELATION
            ):
                sign = "the opposite of " if cross[j] < 0.0 else ""
                yield SignalFault(
                    name,
                    f"does not follow {source[k]}, it follows {sign}{source[j]}: axes are exchanged "
                    f"(correlation {cross[j]:+.2f})",
                    "exchange them in the map",
                )
            continue
        if a.correlation < 0.0:
            yield SignalFault(
                    name, f"has the opposite sign of the change of {source[k]}",
                    "invert the sign of one in the column map",
                )  # fmt: skip
            continue
        yield from _check_scale(name, source[k], a, kind)
        yield from _check_lag(name, source[k], a, sample_s)


def _zero_lag_correlation(x: Array, y: Array) -> float:
    x, y = x - x.mean(), y - y.mean()
    return float(x @ y) / max(float(np.sqrt((x @ x) * (y @ y))), 1e-300)


def _check_scale(name: str, source: str, a: SignalAgreement, kind: str) -> list[SignalFault]:
    middle = float(np.sqrt(a.scale_low * a.scale_high)) if a.scale_low > 0.0 else 0.0
    other = {"angle a second": "angle", "speed": "length"}[kind]
    for signal, units, factor in (
        (name, _UNIT_FACTORS[kind], middle),
        (source, _UNIT_FACTORS[other], 1.0 / max(middle, 1e-9)),
    ):
        for words, short, size in units:
            near = 30.0 < factor < 110.0 if size == 57.2958 else abs(factor / size - 1.0) < _UNIT_FACTOR_TOLERANCE
            if near and (a.scale_low > 1.25 or a.scale_high < 0.8):
                digits = 0 if factor > 10.0 else 2
                says = (
                    f"is {factor:.{digits}f} times the rate at which {source} changes"
                    if signal == name
                    else f"changes {factor:.{digits}f} times as fast as {name} says"
                )
                return [
                    SignalFault(
                        signal,
                        f"{says}: it seems to be in {words}",
                        f"state the unit in the column map ('{short}')",
                    )
                ]
    if a.scale_low > 1.0 + _REPORTED_SCALE_ERROR or a.scale_high < 1.0 - _REPORTED_SCALE_ERROR:
        low, high = f"{a.scale_low:.2f}", f"{a.scale_high:.2f}"
        return [
            SignalFault(
                name,
                f"is {middle:.2f} times the change of {source} (95 %: {low} to {high}): one of them is scaled wrong",
                "correct the gain of one in the column map",
                is_fatal=a.scale_low > 1.0 + _REFUSED_SCALE_ERROR or a.scale_high < 1.0 - _REFUSED_SCALE_ERROR,
            )
        ]
    return []


def _check_lag(name: str, source: str, a: SignalAgreement, sample_s: float) -> list[SignalFault]:
    if not abs(a.lag_s) > max(_REPORTED_LAG_S, 0.75 * sample_s, 4.0 * a.lag_std_s):
        return []
    late, first = (name, source) if a.lag_s > 0.0 else (source, name)
    return [
        SignalFault(
            late,
            f"comes {1e3 * abs(a.lag_s):.0f} +- {1e3 * a.lag_std_s:.0f} ms later than {first}",
            "shift one of them in time before the fit, or leave one out",
            is_fatal=abs(a.lag_s) - 2.2 * a.lag_std_s > _REFUSED_LAG_S,
        )
    ]


def find_signal_faults(r: FlightRecord) -> list[SignalFault]:
    """Return the signal faults of a record, fatal faults first; the checks need no vehicle model."""
    found = [
        *_check_rates_against_attitude(r),
        *_check_velocities_against_positions(r),
        *_check_height_unit(r),
        *_check_input_range(r),
    ]
    return sorted(found, key=lambda f: not f.is_fatal)


def refuse_fatal_faults(r: FlightRecord, found: Sequence[SignalFault], *, as_is: bool = False) -> tuple[str, ...]:
    """Raise an error for the first fatal fault; return all other faults as warnings.

    With ``as_is``, fatal faults are warnings, too.

    Raises
    ------
    InputError
        For a fatal fault; the error names record, signal, problem and remedy.
    """
    for f in found:
        if f.is_fatal and not as_is:
            raise InputError(r.name, f.signal, f.problem, f.remedy)
    return tuple(f"{r.name}: {f.signal} {f.problem}" for f in found)


def require_consistent_record(r: FlightRecord, *, as_is: bool = False) -> tuple[str, ...]:
    """Raise an error for faults of a record that would cause wrong parameters in a fit; return warnings.

    Parameters
    ----------
    r : FlightRecord
    as_is : bool
        Report faults as warnings, and reject only a record in which no input moves.

    Returns
    -------
    tuple of str
        Warnings on faults that do not prevent a fit.

    Raises
    ------
    InputError
        For impossible units, signs, axes, scales and clocks, or a record in which no input moves.
    """
    warnings = list(refuse_fatal_faults(r, find_signal_faults(r), as_is=as_is))
    still = [n for k, n in enumerate(FLIGHT_INPUTS) if np.ptp(r.inputs[:, k]) < 1e-6]
    if len(still) == 4:
        raise InputError(r.name, "inputs", "no input varies", "fly an excitation: `mufly identify plan`")
    warnings += [f"{r.name}: {n} is constant, so the record holds no information about its effects" for n in still]
    for k, name in enumerate(r.output_names):
        y = r.measured[np.isfinite(r.measured[:, k]), k]
        if name != "voltage" and np.ptp(y) < 1e-9:
            warnings.append(f"{r.name}: {name} never changes; check that the sensor is connected")
    return tuple(warnings)


def _check_rates_against_attitude(r: FlightRecord) -> list[SignalFault]:
    """Return the faults found by comparison of body rates with the derivative of the attitude."""
    angles_and_rates = [o for o in ("roll", "pitch", "yaw", "p", "q", "r") if o in r.output_names]
    known = {o: fill_gaps(r.measured[:, r.output_names.index(o)]) for o in angles_and_rates}
    pairs = [(a, w) for a, w in (("roll", "p"), ("pitch", "q"), ("yaw", "r")) if a in known and w in known]
    samples, dt, n = max(1, round(_SIGNAL_AVERAGING_SPAN_S / r.sample_s)), r.sample_s, len(r.time_s)
    found: list[SignalFault] = []
    # Degrees are detected first with small angles, because the Euler equations need radians.
    for angle, rate in pairs:
        w = 0.5 * (known[rate][1:] + known[rate][:-1])
        a = compare_signal_with_prediction(
            moving_average(w, samples), moving_average(np.diff(known[angle]) / dt, samples), dt
        )
        ratio = float(np.sqrt(a.scale_low * a.scale_high)) if a.scale_low > 0.0 else 1.0
        if abs(a.correlation) > _MIN_JUDGED_CORRELATION and (30.0 < ratio < 110.0 or 1 / 110.0 < ratio < 1 / 30.0):
            found += _check_scale(rate, angle, a, "angle a second")
    for angle in ("roll", "pitch"):
        if angle not in known or any(f.signal == angle for f in found):
            continue
        turned, limit = known[angle], (np.pi / 2 if angle == "pitch" else np.pi) + 0.01
        if float(np.max(np.abs(turned))) > limit:
            reaches = f"reaches {turned[np.argmax(np.abs(turned))]:.3g} rad: it seems to be in degrees"
            found.append(SignalFault(angle, reaches, "state the unit in the column map ('deg')"))
    if found or not pairs:
        return found
    level, tilt = np.zeros(n), 0.0
    attitude = np.column_stack([known.get(o, level) for o in ("roll", "pitch", "yaw")])
    if "yaw" not in known and {"q", "r"} <= set(known):
        s1, c1 = np.sin(attitude[:, 0]), np.cos(attitude[:, 0])
        turn = (known["q"] * s1 + known["r"] * c1) / np.maximum(np.cos(attitude[:, 1]), 0.1)
        attitude[:, 2] = np.concatenate([[0.0], np.cumsum(0.5 * (turn[1:] + turn[:-1])) * dt])
    elif not {"roll", "pitch", "yaw"} <= set(known):
        tilt = float(np.max(np.abs(attitude[:, :2])))
    if tilt > _MAX_TILT_WITHOUT_YAW_rad:
        what = "is not checked: without all three angles and rates the tilt is too large for the check"
        return [SignalFault(pairs[0][0], what, "", is_fatal=False)]
    order = {"roll": 0, "pitch": 1, "yaw": 2}
    made = moving_average(rates_from_attitude(attitude, dt), samples)[:, [order[a] for a, _ in pairs]]
    rates = np.column_stack([known[w] for _, w in pairs])
    read = moving_average(0.5 * (rates[1:] + rates[:-1]), samples)
    names, angles = [w for _, w in pairs], [a for a, _ in pairs]
    return list(find_faults_against_predictions(names, read, made, dt, kind="angle a second", source=angles))


def _check_velocities_against_positions(r: FlightRecord) -> list[SignalFault]:
    """Return the faults found by comparison of velocities with derivatives of positions.

    North and east are compared together, because they may be exchanged.
    """
    found: list[SignalFault] = []
    samples, dt = max(1, round(_SIGNAL_AVERAGING_SPAN_S / r.sample_s)), r.sample_s
    for some in ((("north", "v_north"), ("east", "v_east")), (("height", "climb"),)):
        pairs = [(a, v) for a, v in some if a in r.output_names and v in r.output_names]
        if pairs:
            at = [[fill_gaps(r.measured[:, r.output_names.index(o)]) for o in pair] for pair in pairs]
            made = moving_average(np.column_stack([np.diff(a) / dt for a, _ in at]), samples)
            read = moving_average(np.column_stack([0.5 * (v[1:] + v[:-1]) for _, v in at]), samples)
            found += find_faults_against_predictions(
                [v for _, v in pairs], read, made, dt, kind="speed", source=[a for a, _ in pairs]
            )
    return found


def _check_height_unit(r: FlightRecord) -> list[SignalFault]:
    """Report a height whose acceleration is impossible in metres: it is in centimetres or millimetres."""
    if "height" not in r.output_names:
        return []
    slope = smooth_signal(fill_gaps(r.measured[:, r.output_names.index("height")]), r.sample_s, 0.5, slope=True)
    size = float(np.std(np.gradient(smooth_signal(slope, r.sample_s, 0.5), r.sample_s)))
    if size <= _MAX_ACCELERATION_m_s2:
        return []
    what = f"accelerates by {size:.0f} m/s2 (RMS): it seems to be in centimetres or millimetres"
    return [SignalFault("height", what, "state the unit in the column map ('cm' or 'mm')")]


def _check_input_range(r: FlightRecord) -> list[SignalFault]:
    """Report inputs beyond their range."""
    found = []
    for k, name in enumerate(FLIGHT_INPUTS):
        u, low = r.inputs[:, k], 0.0 if k < 2 else -1.0
        top = float(np.max(np.abs(u)))
        if top > 1.5 or float(np.min(u)) < low - 0.5:
            unit = "per cent" if 1.5 < top <= 100 else "microseconds of a servo pulse" if top > 500 else "another unit"
            what = f"reaches {u[np.argmax(np.abs(u))]:g}: it seems to be in {unit}"
            found.append(SignalFault(name, what, f"scale it to {low:g}..1"))
    return found
