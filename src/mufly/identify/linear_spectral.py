"""A structured linear model fitted to frequency responses instead of time histories: a cross-check of the other.

The parameters minimise Tischler and Remple's cost (:mod:`mufly.identify.frequency`) summed over the input-output pairs,
each weighted by its partial coherence. Trims, biases and initial states do not enter, nor does what is not coherent
with an input; feedback biases it where an input is made from the output.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from mufly.errors import InputError
from mufly.identify.frequency import FrequencyResponse, frequency_response, misfit, state_space_response
from mufly.identify.linear_structure import Structure

__all__ = ["SpectralFit", "fit_spectral", "response_of"]

Array = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]


@dataclass(frozen=True, eq=False)
class SpectralFit:
    """A structure fitted to frequency responses.

    Attributes
    ----------
    values : (p,) array
    std : (p,) array
        From the curvature of the cost and its size, as if neighbouring frequencies were independent: a lower bound.
    data : FrequencyResponse
    model : (f, outputs, inputs) complex array
        Response at ``values``.
    cost : (outputs, inputs) array
        Tischler and Remple's J at ``values``; NaN for pairs without coherence.
    cost_before : (outputs, inputs) array
        The same at the values given to start from.
    """

    values: Array
    std: Array
    data: FrequencyResponse
    model: ComplexArray
    cost: Array
    cost_before: Array


def response_of(structure: Structure, values: Array, frequency_hz: Array) -> ComplexArray:
    """Return the frequency response (f, outputs, inputs) of a structure at given values."""
    a, b, c, d, delay = structure.matrices(values)
    return state_space_response(a, b, c, d, frequency_hz, delay)


def _by_chance(averages: float, inputs: int, frequencies: float) -> float:
    """Partial coherence that independent signals exceed at any of so many frequencies in 5 % of all cases."""
    freedom = max(1.8 * averages - inputs, 1.0)
    return float(1.0 - (0.05 / max(frequencies, 1.0)) ** (1.0 / freedom))


def fit_spectral(
    structure: Structure, u: Array, y: Array, dt: float, *, first: Array, segment_s: float, high_hz: float,
    least: float = 0.5, points: int = 60,
) -> SpectralFit:  # fmt: skip
    """Fit a structure to the frequency responses of a record.

    Parameters
    ----------
    structure : Structure
    u, y : (n, inputs), (n, outputs) array
        Without gaps.
    dt : float
        Sample time (s).
    first : (p,) array
        Where the search begins.
    segment_s : float
        Length of the segments (s); the lowest frequency is 1.5 / ``segment_s``.
    high_hz : float
        Highest frequency.
    least : float
        Smallest partial coherence that counts; more where independent signals would show more.
    points : int
        Frequencies.

    Raises
    ------
    InputError
        If no frequency is coherent, or the record is too short.
    """
    data = frequency_response(
        u, y, dt, segment_s=segment_s, low_hz=1.5 / segment_s, high_hz=high_hz, points=points,
        input_names=structure.inputs, output_names=structure.outputs,
    )  # fmt: skip
    least = max(
        least, _by_chance(data.averages, len(structure.inputs), (high_hz - 1.5 / segment_s) * segment_s / 1.5)
    )
    good = (data.partial >= least) & np.isfinite(data.response)
    good &= good.sum(0) >= 4
    if 2 * good.sum() < len(structure.parameters):
        raise InputError(
            "frequency response", "", f"{int(good.sum())} coherent points for {len(structure.parameters)} parameters",
            "give a longer record or more excitation",
        )  # fmt: skip
    weight = 1.58 * (1.0 - np.exp(-data.partial))
    share = 20.0 / np.maximum(good.sum(0), 1)

    low, high = (np.array([getattr(p, side) for p in structure.parameters]) for side in ("low", "high"))
    log = low > 0.0
    size = np.maximum(np.abs(first), 0.02 * (high - low))

    def values(z: Array) -> Array:
        return np.clip(np.where(log, np.exp(np.where(log, z, 0.0)), z * size), low, high)

    def coordinates(v: Array) -> Array:
        return np.where(log, np.log(np.where(log, np.maximum(v, 1e-300), 1.0)), v / size)

    def residual(z: Array) -> Array:
        with np.errstate(divide="ignore", invalid="ignore"):
            ratio = response_of(structure, values(z), data.frequency_hz) / data.response
            level, phase = 20.0 * np.log10(np.maximum(np.abs(ratio), 1e-12)), np.degrees(np.angle(ratio))
        scaled = np.sqrt(share) * weight
        rows = np.stack([scaled * level, np.sqrt(0.01745) * scaled * phase])
        return np.asarray(rows[:, good].ravel())

    lower, upper = coordinates(low), coordinates(high)
    start = np.clip(coordinates(np.clip(first, low, high)), lower + 1e-9, upper - 1e-9)
    solution = least_squares(residual, start, bounds=(lower, upper), x_scale="jac", max_nfev=200)
    found = values(solution.x)
    model = response_of(structure, found, data.frequency_hz)
    used = np.where(good.any(axis=0), 1.0, np.nan)
    before = used * misfit(data, response_of(structure, first, data.frequency_hz), least=least)
    jacobian = np.asarray(solution.jac, dtype=np.float64)
    curvature = np.linalg.pinv(jacobian.T @ jacobian, rcond=1e-12)
    spread = np.sqrt(
        np.maximum(np.diag(curvature), 0.0) * 2.0 * solution.cost / max(solution.fun.size - found.size, 1)
    )
    return SpectralFit(
        found,
        spread * np.where(log, found, size),
        data,
        model,
        used * misfit(data, model, least=least),
        before,
    )
