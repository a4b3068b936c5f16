"""What does it believe? Readings in, an estimate with its covariance out."""

from mufly.estimate.beliefs import ERROR_STATES, Beliefs, Check, Status
from mufly.estimate.estimate import EXACT, Estimate, Estimator, IdealEstimator, Watch, watch
from mufly.estimate.fitted import fitted_estimator

__all__ = [
    "ERROR_STATES",
    "EXACT",
    "Beliefs",
    "Check",
    "Estimate",
    "Estimator",
    "IdealEstimator",
    "Status",
    "Watch",
    "fitted_estimator",
    "watch",
]
