"""Messages of the estimate: ODOMETRY with covariance, ESTIMATOR_STATUS, and the status of each sensor.

ODOMETRY holds the pose in MAV_FRAME_LOCAL_NED and the motion in MAV_FRAME_BODY_FRD, as PX4 does. Its covariances are
the upper triangles, row by row (21 numbers each), of x, y, z, roll, pitch, yaw and of vx, vy, vz, rollspeed,
pitchspeed, yawspeed; a NaN in front marks an unknown covariance. With the attitude's rotation R the covariance of the
velocity in body axes is ``P_b = R^T P R``; the effect of the attitude's own error (v times it) is neglected.

A test ratio of ESTIMATOR_STATUS is the squared innovation over the squared gate: above 1 a measurement is rejected.
MAVLink has no message for each sensor's health. The array "checks" holds three numbers for each of
:data:`mufly.quantities.quantity_table.READINGS_WITH_FUSION_STATUS`: the index of its status in
:data:`mufly.quantities.quantity_table.FUSION_STATUSES`, its innovation in standard deviations, and the age of the last
fused measurement (s). Wind N, E (m/s) and its standard deviations follow. Reasons are sent as STATUSTEXT.

Source: https://mavlink.io/en/messages/common.html#ODOMETRY, #ESTIMATOR_STATUS.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from mufly.dynamics import body_to_ned_matrix
from mufly.estimate import ERROR_STATES, AuxiliaryStates, SensorStatus
from mufly.estimate.filter.filter_records import ERROR_ATTITUDE, ERROR_POSITION, ERROR_VELOCITY
from mufly.estimate.filter.measurements.scalar_fusion import INNOVATION_GATE
from mufly.flight import FlightState
from mufly.link.codec import MavMessage, mavlink, to_float32
from mufly.quantities.quantity_table import FUSION_STATUSES, READINGS_WITH_FUSION_STATUS
from mufly.quantities.sensor_table import READINGS
from mufly.rotations import quaternion_from_euler

_Array = NDArray[np.float64]
CHECKS_ARRAY_NAME = b"checks"
"""Name of the DEBUG_FLOAT_ARRAY of sensor statuses."""
UNKNOWN_COVARIANCE = (math.nan,) + (0.0,) * 20
_UPPER_TRIANGLE = np.triu_indices(6)
_POSE_INDICES, _MOTION_INDICES = [0, 1, 2, 6, 7, 8], [3, 4, 5, 9, 10, 11]  # of Estimate.covariance
GOOD_POSITION_SIGMA_M, GOOD_TILT_SIGMA_RAD, GOOD_VELOCITY_SIGMA_M_S = 0.5, math.radians(10.0), 0.5
"""Largest standard deviations of a position, tilt or velocity that is flagged as good (m, rad, m/s)."""
_READING_BY_RATIO_FIELD = {field: (row.name, words) for row in READINGS.values() for field, words in row.test_ratios}
TEST_RATIOS: dict[str, tuple[str, str]] = {
    field: _READING_BY_RATIO_FIELD.get(field, ("", "airspeed"))
    for field in mavlink.MAVLink_estimator_status_message.fieldnames
    if field.endswith("_ratio")
}
"""Fields of ESTIMATOR_STATUS with a test ratio: the reading, "" without one, and its name on the ground station."""
_MIN_UNKNOWN_POSITION_SIGMA_M = 10.0  # above this a position is flagged as unknown


def odometry_message(state: FlightState, usec: int) -> MavMessage:
    """Return ODOMETRY: estimated pose and motion, with their covariance."""
    m = state.estimate
    known = bool(np.all(np.isfinite(m.attitude)))
    turn = body_to_ned_matrix(quaternion_from_euler(*m.attitude.tolist())) if known else np.full((3, 3), math.nan)
    axes = np.eye(6)
    axes[:3, :3] = turn
    pose = m.covariance[np.ix_(_POSE_INDICES, _POSE_INDICES)]
    motion = axes.T @ m.covariance[np.ix_(_MOTION_INDICES, _MOTION_INDICES)] @ axes
    q = quaternion_from_euler(*m.attitude.tolist()) if known else np.full(4, math.nan)
    return mavlink.MAVLink_odometry_message(
        usec,
        mavlink.MAV_FRAME_LOCAL_NED,
        mavlink.MAV_FRAME_BODY_FRD,
        *(to_float32(v) for v in m.position.tolist()),
        [to_float32(v) for v in q.tolist()],
        *(to_float32(v) for v in (turn.T @ m.velocity).tolist()),
        *(to_float32(v) for v in m.rates.tolist()),
        pack_upper_triangle(pose),
        pack_upper_triangle(motion),
        0,
        mavlink.MAV_ESTIMATOR_TYPE_AUTOPILOT,
        100 if m.valid else -1,
    )


def pack_upper_triangle(covariance: _Array) -> list[float]:
    """Return the upper triangle of a (6, 6) covariance, row by row (21 numbers)."""
    values = covariance[_UPPER_TRIANGLE]
    return [to_float32(v) for v in (values if np.all(np.isfinite(values)) else UNKNOWN_COVARIANCE)]


def estimator_status_message(state: FlightState, usec: int) -> MavMessage:
    """Return ESTIMATOR_STATUS: flags of the estimate's quality, and test ratios of the measurements."""
    m, beliefs = state.estimate, state.estimate.auxiliary_states
    sigma = np.sqrt(np.maximum(np.diag(m.covariance), 0.0))
    level, height = math.hypot(sigma[ERROR_POSITION], sigma[ERROR_POSITION + 1]), float(sigma[ERROR_POSITION + 2])
    checks = {} if beliefs is None else {c.name: c for c in beliefs.checks}
    good = m.valid and bool(np.all(np.isfinite(m.position)))
    flags = 0
    for holds, flag in (
        (max(sigma[ERROR_ATTITUDE], sigma[ERROR_ATTITUDE + 1]) < GOOD_TILT_SIGMA_RAD, mavlink.ESTIMATOR_ATTITUDE),
        (
            math.hypot(sigma[ERROR_VELOCITY], sigma[ERROR_VELOCITY + 1]) < GOOD_VELOCITY_SIGMA_M_S,
            mavlink.ESTIMATOR_VELOCITY_HORIZ,
        ),
        (sigma[ERROR_VELOCITY + 2] < GOOD_VELOCITY_SIGMA_M_S, mavlink.ESTIMATOR_VELOCITY_VERT),
        (
            level < GOOD_POSITION_SIGMA_M,
            mavlink.ESTIMATOR_POS_HORIZ_REL | mavlink.ESTIMATOR_PRED_POS_HORIZ_REL,
        ),
        (
            level < GOOD_POSITION_SIGMA_M,
            mavlink.ESTIMATOR_POS_HORIZ_ABS | mavlink.ESTIMATOR_PRED_POS_HORIZ_ABS,
        ),
        (height < GOOD_POSITION_SIGMA_M, mavlink.ESTIMATOR_POS_VERT_ABS),
        (beliefs is None or _has_status(checks, TEST_RATIOS["hagl_ratio"][0], "fused"), mavlink.ESTIMATOR_POS_VERT_AGL),
        (level > _MIN_UNKNOWN_POSITION_SIGMA_M, mavlink.ESTIMATOR_CONST_POS_MODE),
    ):
        flags |= int(flag) if good and holds else 0
    if _has_status(checks, "acceleration", "faulty", "rejected"):
        flags |= mavlink.ESTIMATOR_ACCEL_ERROR

    def reading_test_ratio(name: str) -> float:
        return to_float32((checks[name].ratio / INNOVATION_GATE) ** 2) if name in checks else 0.0

    return mavlink.MAVLink_estimator_status_message(
        usec,
        flags,
        *(reading_test_ratio(name) for name, _ in TEST_RATIOS.values()),
        to_float32(level),
        to_float32(height),
    )


def _has_status(checks: dict[str, SensorStatus], name: str, *statuses: str) -> bool:
    return name in checks and checks[name].status in statuses


def sensor_checks_message(state: FlightState, usec: int) -> MavMessage | None:
    """Return DEBUG_FLOAT_ARRAY "checks": status, innovation and age of every sensor reading, and the estimated wind.

    None if the vehicle has no Kalman filter.
    """
    beliefs = state.estimate.auxiliary_states
    if beliefs is None:
        return None
    values = pack_sensor_checks(beliefs)
    return mavlink.MAVLink_debug_float_array_message(usec, CHECKS_ARRAY_NAME, 1, values + [0.0] * (58 - len(values)))


def pack_sensor_checks(beliefs: AuxiliaryStates) -> list[float]:
    """Return the numbers of the DEBUG_FLOAT_ARRAY "checks": status, innovation ratio and age (s) of each reading.

    They are NaN for absent sensors. Wind N, E and its standard deviations (m/s) follow.
    """
    checks = {c.name: c for c in beliefs.checks}
    values: list[float] = []
    for name in READINGS_WITH_FUSION_STATUS:
        c = checks.get(name)
        told = [math.nan] * 3 if c is None else [float(FUSION_STATUSES.index(c.status)), c.ratio, c.time_since_fusion_s]
        values += told
    k = ERROR_STATES.index("wind_N")
    return [to_float32(v) for v in [*values, *beliefs.wind.tolist(), *beliefs.error_state_sigma[k : k + 2].tolist()]]
