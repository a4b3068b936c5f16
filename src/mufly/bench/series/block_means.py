"""Mean of correlated samples with its standard uncertainty, and a test whether a bench has settled.

A block of n samples is divided into B = 16 batches. The batch means ``m_b`` are nearly independent if a batch is longer
than the correlation time of the noise. Vibration at the rotor frequency cancels in them, but not in ``s / sqrt(n)``:

    u^2 = s_m^2 / B * max(1, (1 + r) / (1 - r)),      s_m^2 = sum (m_b - mean)^2 / (B - 1),   r = lag-1 correlation of
    m_b

The factor of a first-order autoregression accounts for the remaining correlation of batches. The estimate of r is
increased by 1/B, the bias from the fitted mean (Kendall, Biometrika 41, 1954), and limited to 0.8. Degrees of freedom:
B - 1. (Batch means: Schmeiser, Operations Research 30, 1982.) This is a type A evaluation by GUM 4.2 for correlated
samples (GUM 4.2.7).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]

MEAN_BATCH_COUNT = 16
_SPIKE_THRESHOLD_SIGMAS = 7.0  # robust standard deviations
_MAX_AUTOCORRELATION = 0.8


class BlockMean(NamedTuple):
    """Mean of a channel over a block of samples.

    Attributes
    ----------
    value, std : float
        Mean, and its standard uncertainty (type A), in the unit of the channel.
    dof : float
        Degrees of freedom of ``std``.
    sample_count, outlier_count : int
        Number of samples, and of omitted outliers.
    smallest_sample, largest_sample : float
        Smallest and largest sample, including outliers.
    trend_over_std : float
        Change from the first half to the second, in standard uncertainties of that change.
    """

    value: float
    std: float
    dof: float
    sample_count: int
    outlier_count: int
    smallest_sample: float
    largest_sample: float
    trend_over_std: float


def compute_block_mean(samples: ArrayLike) -> BlockMean:
    """Return the mean of equally spaced samples (n,) with its standard uncertainty; both are NaN without a finite
    sample.

    Samples further than 7 robust standard deviations (1.4826 times the median absolute deviation) from the median are
    omitted and counted as outliers.
    """
    x = np.asarray(samples, dtype=np.float64).ravel()
    x = x[np.isfinite(x)]
    n = x.size
    if n == 0:
        return BlockMean(np.nan, np.nan, 0.0, 0, 0, np.nan, np.nan, 0.0)
    smallest_sample, largest_sample = float(x.min()), float(x.max())
    middle = float(np.median(x))
    size = 1.4826 * float(np.median(np.abs(x - middle)))
    keep = np.abs(x - middle) <= _SPIKE_THRESHOLD_SIGMAS * size if size > 0.0 and n >= 8 else np.ones(n, dtype=bool)
    x = x[keep]
    spikes = n - x.size
    value = float(x.mean())
    batches = min(MEAN_BATCH_COUNT, x.size)
    if batches < 3:
        return BlockMean(value, float(np.ptp(x)), 1.0, n, spikes, smallest_sample, largest_sample, 0.0)
    edges = np.linspace(0, x.size, batches + 1).astype(np.intp)
    means = np.add.reduceat(x, edges[:-1]) / np.diff(edges)
    off = means - means.mean()
    square = float(off @ off)
    memory = float(off[1:] @ off[:-1]) / square + 1.0 / batches if square > 0.0 else 0.0
    memory = min(max(memory, 0.0), _MAX_AUTOCORRELATION)
    std = float(np.sqrt(square / (batches - 1) / batches * (1.0 + memory) / (1.0 - memory)))
    half = batches // 2
    change = float(means[-half:].mean() - means[:half].mean())
    trend_over_std = change / (2.0 * std) if std > 0.0 else 0.0
    return BlockMean(value, std, batches - 1.0, n, spikes, smallest_sample, largest_sample, trend_over_std)


def has_settled(before: BlockMean, now: BlockMean, tolerance: float) -> bool:
    """Return whether the means of two successive windows agree within a tolerance or within their noise."""
    doubt = 3.0 * float(np.hypot(before.std, now.std))
    return abs(now.value - before.value) <= max(tolerance, min(doubt, 5.0 * tolerance))
