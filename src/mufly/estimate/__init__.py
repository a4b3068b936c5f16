"""What does it believe? Readings in, an estimate with its covariance out."""

from mufly.estimate.estimate import EXACT, Estimate, Estimator, IdealEstimator, Watch, watch

__all__ = ["EXACT", "Estimate", "Estimator", "IdealEstimator", "Watch", "watch"]
