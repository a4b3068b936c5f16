"""What a linear identification returns: the fitted model, and how it did on what it had not seen."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from mufly.identify.linear_structure import Structure
from mufly.identify.residuals import Quality
from mufly.identify.result import Fit

if TYPE_CHECKING:
    from mufly.identify.linear_check import CrossValidation, Disturbance, NoiseFloor
    from mufly.identify.linear_spectral import SpectralFit
    from mufly.identify.linear_subspace import Subspace

__all__ = ["Ahead", "LinearFit", "LinearResult"]

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class LinearFit:
    """A fitted linear model.

    Attributes
    ----------
    structure : Structure
    values, start : (p,) array
        Parameters, fitted and where the best search began.
    covariance, bound : (p, p) array
        Corrected for coloured residuals; Cramer-Rao bound for white ones.
    at_bound : (p,) array of bool
    x0 : (states,) array
    input_trim : (inputs,) array
    output_bias : (outputs,) array
    weight : (outputs,) array
        Inverse variance of the residuals.
    log_likelihood : float
        Of Gaussian residuals, white.
    effective_samples : float
        Independent residuals, from their autocorrelation.
    history : tuple of dict
    costs : tuple of float
        Of every start, ascending.
    simulations : int
    seconds : float
    converged : bool
    message : str
    hold : bool
        Inputs held between samples.
    """

    structure: Structure
    values: Array
    start: Array
    covariance: Array
    bound: Array
    at_bound: NDArray[np.bool_]
    x0: Array
    input_trim: Array
    output_bias: Array
    weight: Array
    log_likelihood: float
    effective_samples: float
    history: tuple[dict[str, Any], ...]
    costs: tuple[float, ...]
    simulations: int
    seconds: float
    converged: bool
    message: str
    hold: bool

    @property
    def poles(self) -> NDArray[np.complex128]:
        """Eigenvalues of A (rad/s), slowest first."""
        a = self.structure.matrices(self.values)[0]
        e = np.linalg.eigvals(a)
        return np.asarray(e[np.argsort(np.abs(e))], dtype=np.complex128)

    def criterion(self, kind: str = "bic") -> float:
        """Return Akaike's ("aic") or Schwarz's ("bic") criterion, in effective samples; smaller is better."""
        free = self.values.size + self.x0.size + self.input_trim.size + self.output_bias.size
        n = self.effective_samples
        per_sample = -2.0 * self.log_likelihood  # per sample, summed over outputs
        return n * per_sample + free * (2.0 if kind == "aic" else float(np.log(max(n, 2.0))))


@dataclass(frozen=True)
class Ahead:
    """Prediction a time ahead on the held-out part, of every output.

    ``horizon_s`` is infinite for the pure simulation. ``fit_percent`` is against the measurement as recorded,
    ``fit_percent_slow`` against both low-passed at ``LinearResult.slow_hz``, ``persistence_percent`` what the last
    measured value would reach, causally low-passed (NaN for the simulation).
    """

    horizon_s: float
    fit_percent: tuple[float, ...]
    fit_percent_slow: tuple[float, ...]
    rms_over_noise: tuple[float, ...]
    persistence_percent: tuple[float, ...]


@dataclass(frozen=True, eq=False)
class LinearResult:
    """A linear identification.

    Attributes
    ----------
    fit : Fit
        As a report wants it, with the fitted and the held-out part.
    linear : LinearFit
        The model itself.
    candidates : tuple of CrossValidation
        Structures tried, best first; empty if one was asked for.
    floors : dict of role to tuple of NoiseFloor
        Of every output, from that part.
    disturbance : Disturbance
    ahead : tuple of Ahead
        Empty without held-out part.
    quality, quality_slow : dict of role to tuple of Quality
        Of the simulation, against the record and against both low-passed at ``slow_hz``.
    ceiling, ceiling_slow : dict of role to tuple of float
        Fit (per cent) of a model whose error is the noise floor alone, as recorded and below ``slow_hz``; the latter is
        NaN where no angle was measured beside a rate.
    against_angle : dict of role to tuple of float
        Fit (per cent) below ``slow_hz`` against the derivative of the measured angle instead of the gyro; NaN without.
    slow_hz : float
    missing : tuple of str
        What the residuals of the fitted part show.
    equation_error : dict of symbol to (value, std)
        Cross-check; empty where no rate was measured.
    subspace : Subspace or None
        Cross-check of the same number of states, fitted to the same samples.
    subspace_percent : tuple of float
        Its pure simulation on the held-out part, low-passed.
    spectral : SpectralFit or None
        Cross-check: fitted to frequency responses; None where too little is coherent.
    notes : tuple of str
        About the record.
    """

    fit: Fit
    linear: LinearFit
    candidates: tuple[CrossValidation, ...]
    floors: Mapping[str, tuple[NoiseFloor, ...]]
    disturbance: Disturbance
    ahead: tuple[Ahead, ...]
    quality: Mapping[str, tuple[Quality, ...]]
    quality_slow: Mapping[str, tuple[Quality, ...]]
    ceiling: Mapping[str, tuple[float, ...]]
    ceiling_slow: Mapping[str, tuple[float, ...]]
    against_angle: Mapping[str, tuple[float, ...]]
    slow_hz: float
    missing: tuple[str, ...]
    equation_error: Mapping[str, tuple[float, float]]
    subspace: Subspace | None
    subspace_percent: tuple[float, ...]
    spectral: SpectralFit | None
    notes: tuple[str, ...]
