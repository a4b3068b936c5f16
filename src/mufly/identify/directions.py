"""Combinations of parameters that data do not tell apart, in words; pairs are :mod:`mufly.identify.uncertainty`'s.

With the covariance C of parameters in relative terms, C_ij = cov_ij / (theta_i theta_j), the eigenvectors of C with
large eigenvalues are the directions that the data hardly see: moving all parameters along one of them, each by its
share, changes nothing that was measured by more than its error. A direction is named if its standard deviation
exceeds ``WIDE`` and it is not one parameter alone, or if a single parameter is known no better than that.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

__all__ = ["WIDE", "direction_in_words", "relative_covariance", "unseen_combinations"]

Array = NDArray[np.float64]

WIDE = 0.5  # relative standard deviation from which a direction counts as unseen
_NO_BOUND = 100.0  # relative standard deviation that says nothing
_SHARE = 0.15  # of the largest part of a direction, below which a parameter is left out of the sentence


def relative_covariance(information: Array, values: Array) -> Array:
    """Return the covariance of relative parameters from a Fisher information in SI units.

    Directions without information get a relative standard deviation of 1e6 instead of infinity.

    Parameters
    ----------
    information : (p, p) array
    values : (p,) array
        Parameters, not zero.
    """
    relative = information * np.outer(values, values)
    size, vectors = np.linalg.eigh(0.5 * (relative + relative.T))
    return (vectors / np.maximum(size, 1e-12)) @ vectors.T


def direction_in_words(symbols: Sequence[str], direction: Array, std: float) -> str:
    """Describe one direction of relative changes."""
    largest = int(np.argmax(np.abs(direction)))
    share = direction / direction[largest]
    parts = [k for k in np.argsort(-np.abs(share)) if abs(share[k]) >= _SHARE]
    if len(parts) == 1:
        if std > _NO_BOUND:
            return f"{symbols[largest]} is not seen at all"
        return f"{symbols[largest]} is hardly seen: {_percent(std)} of its value"
    if len(parts) == 2:
        other = parts[1]
        if abs(abs(share[other]) - 1.0) < 0.2:
            kind = "ratio" if share[other] > 0 else "product"
            return f"only the {kind} of {symbols[largest]} and {symbols[other]} is seen ({_percent(std)} along it)"
    moves = " with ".join(f"{symbols[k]} {10 * share[k]:+.0f} %" for k in parts)
    return f"{moves} changes nothing that the data show ({_percent(std)} along it)"


def _percent(std: float) -> str:
    return "no bound" if std > _NO_BOUND else f"standard deviation {100 * std:.0f} %"


def unseen_combinations(symbols: Sequence[str], covariance: Array, *, wide: float = WIDE) -> tuple[str, ...]:
    """Name the directions that data do not determine.

    Parameters
    ----------
    symbols : sequence of str
    covariance : (p, p) array
        Of the relative parameters.
    wide : float
        Relative standard deviation from which a direction is named.
    """
    size, vectors = np.linalg.eigh(0.5 * (covariance + covariance.T))
    return tuple(
        direction_in_words(symbols, vectors[:, k], float(np.sqrt(size[k])))
        for k in np.argsort(-size)
        if size[k] > wide**2
    )
