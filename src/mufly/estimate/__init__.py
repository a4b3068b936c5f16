"""What does it believe? Readings in, an estimate with its covariance out."""

from mufly.estimate.beliefs import ERROR_STATES, Beliefs, Check, Status
from mufly.estimate.estimate import EXACT, Estimate, Estimator, IdealEstimator, Watch, watch
from mufly.estimate.fitted import KalmanEstimator, fitted_estimator
from mufly.estimate.log import run_log
from mufly.estimate.nees import Consistency, consistency

__all__ = [
    "ERROR_STATES",
    "EXACT",
    "Beliefs",
    "Check",
    "Consistency",
    "Estimate",
    "Estimator",
    "IdealEstimator",
    "KalmanEstimator",
    "Status",
    "Watch",
    "consistency",
    "fitted_estimator",
    "run_log",
    "watch",
]
