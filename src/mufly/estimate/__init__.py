"""State estimation: from sensor readings to an estimate with covariance."""

from mufly.estimate.estimator import (
    ZERO_COVARIANCE,
    Estimate,
    EstimateCheckState,
    Estimator,
    IdealEstimator,
    check_estimate,
    compute_standing_tilt,
)
from mufly.estimate.filter.filter_records import ERROR_STATES
from mufly.estimate.inertial_log import (
    AidInnovations,
    InertialLog,
    InertialLogEstimate,
    InertialNoise,
    PositionAids,
    check_inertial_log,
    compute_aid_innovations,
    detect_flight,
    estimate_flight_noise,
    estimate_rest_noise,
    run_filter_on_log,
)
from mufly.estimate.kalman_estimator import KalmanEstimator
from mufly.estimate.nees import Consistency, measure_consistency, measure_row_consistency
from mufly.estimate.sensor_status import AuxiliaryStates, FusionStatus, SensorStatus

__all__ = [
    "ERROR_STATES",
    "ZERO_COVARIANCE",
    "AidInnovations",
    "AuxiliaryStates",
    "Consistency",
    "Estimate",
    "EstimateCheckState",
    "Estimator",
    "FusionStatus",
    "IdealEstimator",
    "InertialLog",
    "InertialLogEstimate",
    "InertialNoise",
    "KalmanEstimator",
    "PositionAids",
    "SensorStatus",
    "check_estimate",
    "check_inertial_log",
    "compute_aid_innovations",
    "compute_standing_tilt",
    "detect_flight",
    "estimate_flight_noise",
    "estimate_rest_noise",
    "measure_consistency",
    "measure_row_consistency",
    "run_filter_on_log",
]
