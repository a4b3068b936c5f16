"""What does it believe? Readings in, an estimate with its covariance out."""

from mufly.estimate.beliefs import Beliefs, Check, Status
from mufly.estimate.estimate import EXACT, Estimate, Estimator, IdealEstimator, Watch, watch
from mufly.estimate.fitted import KalmanEstimator, fitted_estimator
from mufly.estimate.layout import ERROR_STATES
from mufly.estimate.log import (
    Aids,
    Foretold,
    InertialLog,
    Noise,
    check_inertial,
    foretold,
    noise_at_rest,
    noise_in_flight,
    run_log,
    standing,
)
from mufly.estimate.nees import Consistency, consistency, consistency_of

__all__ = [
    "ERROR_STATES",
    "EXACT",
    "Aids",
    "Beliefs",
    "Check",
    "Consistency",
    "Estimate",
    "Estimator",
    "Foretold",
    "IdealEstimator",
    "InertialLog",
    "KalmanEstimator",
    "Noise",
    "Status",
    "Watch",
    "check_inertial",
    "consistency",
    "consistency_of",
    "fitted_estimator",
    "foretold",
    "noise_at_rest",
    "noise_in_flight",
    "run_log",
    "standing",
    "watch",
]
