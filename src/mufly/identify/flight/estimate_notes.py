"""Notes on the reliability of estimates: weakly excited channels, held parameters, and invalid intervals.

The fit detects four reasons for wrong estimates with a small standard deviation: residuals above the
sensor noise, a channel without excitation, a cost that is not parabolic within the interval, and an error of a held
parameter.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from mufly.identify.flight.free_parameters import HEAVE_YAW_SYMBOLS, ROLL_PITCH_SYMBOLS, FreeParameter
from mufly.identify.flight.minimisers import LinearisedProblem
from mufly.identify.flight.output_error_problem import OutputErrorProblem
from mufly.identify.flight_record import CHANNEL_OUTPUTS, estimate_noise_from_differences, signal_over_noise

_Array = NDArray[np.float64]

_MIN_MOTION_OVER_NOISE = 3.0  # ratio of motion to sensor noise below which a channel counts as unexcited
_PARABOLIC_RISE_RANGE = (0.5, 2.0)  # rise of the cost at two deviations, relative to a parabola
MAX_RESIDUAL_NOISE_RATIO = 1.5  # ratio of residuals to sensor noise above which a note is written


def describe_held_parameter_influence(
    free: Sequence[FreeParameter], held: Sequence[FreeParameter], moved: _Array, from_data: _Array
) -> tuple[str, ...]:
    """Describe the estimates whose variance comes mainly from held (not fitted) parameters, and name these
    parameters.
    """
    said = []
    for f, row, own in zip(free, moved, from_data, strict=True):
        total = float(row @ row)
        if total <= own:
            continue
        worst = np.argsort(-np.abs(row))[:3]
        named = [f"{held[k].symbol} ({held[k].provenance})" for k in worst if row[k] ** 2 > 0.1 * total]
        size = f"{100 * math.sqrt(own):.2g} % from the data, {100 * math.sqrt(total):.2g} % from"
        said.append(f"{f.symbol}: {'mostly from' if f.scale else size} {', '.join(named)}")
    return tuple(said)


def _nonparabolic_parameters(linear: LinearisedProblem, rise: _Array) -> list[str]:
    """Return the free parameters with over a quarter of their variance along axes of non-quadratic cost."""
    _, size, vt = np.linalg.svd(linear.jacobian, full_matrices=False)
    shares = (vt / size[:, None]) ** 2
    shares /= shares.sum(axis=0)
    low, high = _PARABOLIC_RISE_RANGE
    with np.errstate(invalid="ignore"):
        bent = np.any((rise < low) | (rise > high), axis=1)
    return [f.symbol for f, s in zip(linear.problem.free_parameters, shares[bent].sum(axis=0), strict=True) if s > 0.25]


_CHANNEL_PARAMETERS = ((("heave", "yaw"), HEAVE_YAW_SYMBOLS), (("roll", "pitch"), ROLL_PITCH_SYMBOLS))
_SINGLE_CHANNEL_PARAMETERS = {"roll": ("Ixx",), "pitch": ("Iyy",)}  # not determined by the other channel


def _describe_quiet_channels(problem: OutputErrorProblem) -> list[str]:
    """Name channels without motion above sensor noise in any record, the affected parameters, and the remedy."""
    most, said = signal_over_noise(problem.records), []
    for channels, own in _CHANNEL_PARAMETERS:
        moves = {c: max((most[o] for o in CHANNEL_OUTPUTS[c] if o in most), default=0.0) for c in channels}
        quiet = [c for c, size in moves.items() if size < _MIN_MOTION_OVER_NOISE]
        shown = (
            own
            if len(quiet) == len(channels)
            else tuple(s for c in quiet for s in _SINGLE_CHANNEL_PARAMETERS.get(c, ()))
        )
        hidden = [f.symbol for f in problem.free_parameters if f.symbol in shown]
        if hidden:
            said.append(
                f"{' and '.join(quiet)} hardly move ({max(moves[c] for c in quiet):.1f} times the sensors' noise): "
                f"what is found of {', '.join(hidden)} rests on little; fly `mufly identify plan --channel "
                f"{','.join(quiet)}`"
            )
    return said


def describe_estimate_reliability(
    problem: OutputErrorProblem,
    at_bound: NDArray[np.bool_],
    coloured: bool,
    linear: LinearisedProblem,
    rise: _Array,
) -> list[str]:
    """Return notes on the reliability of the estimates; ``rise`` is the result of :func:`cost_rise_along_axes`."""
    held = [f.symbol for f, b in zip(problem.free_parameters, at_bound, strict=True) if b]
    notes = [f"{symbol} stopped at its bound: its interval does not hold" for symbol in held]
    large = [f"{o} ({v:.1f} times)" for o, v in residual_over_noise(problem).items() if v > MAX_RESIDUAL_NOISE_RATIO]
    if large:
        notes.append(f"residuals above the sensor noise: {', '.join(large)}; wind or the model; try windows of 3 s")
    notes += _describe_quiet_channels(problem)
    if bent := _nonparabolic_parameters(linear, rise):
        notes.append(
            f"the intervals of {', '.join(bent)} do not hold: the cost is not parabolic up to their ends; "
            f"fly a manoeuvre that excites them, `mufly identify plan --free {','.join(bent)}`"
        )
    if coloured:
        notes.append("residuals are coloured; the intervals account for it")
    return notes


def residual_over_noise(problem: OutputErrorProblem) -> dict[str, float]:
    """Return the ratio of estimated residual noise to sensor noise by output, the largest over all records."""
    ratios: dict[str, float] = {}
    for f in problem.prepared_records:
        for o, ratio in zip(
            f.record.output_names, f.noise_std / estimate_noise_from_differences(f.record), strict=True
        ):
            ratios[o] = max(ratios.get(o, 0.0), float(ratio))
    return ratios
