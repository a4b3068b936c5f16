"""The filter's two records, memory and settings, and the names of their indices: each becomes a struct in C.

The nominal state ``x`` has the indices ``NOMINAL_...``, in SI units:

========================= ================================================================================
``NOMINAL_POSITION``      position N, E, D of the centre of gravity
``NOMINAL_VELOCITY``      velocity N, E, D
``NOMINAL_ATTITUDE``      attitude, quaternion w x y z
``NOMINAL_GYRO_BIAS``     bias of the gyroscopes, body axes
``NOMINAL_ACCEL_BIAS``    bias of the accelerometers, body axes
``NOMINAL_TERRAIN``       height of the surface under the sonar above D = 0, up
``NOMINAL_FIX_BIAS``      bias of the position fix, N, E, D
``NOMINAL_FIX_HEADING``   bias of the position fix's heading
``NOMINAL_WIND``          wind N, E
``NOMINAL_THRUST_SCALE``  true thrust over the model's
``NOMINAL_PRESSURE_BIAS`` bias of the pressure (Pa)
``NOMINAL_MAG_BIAS``      bias of the magnetic heading (rad)
========================= ================================================================================

The error state has one number less, with the indices ``ERROR_...``: the attitude error is a small turn about N, E and D
(true = exp(turn) estimated). :data:`ERROR_STATES` has its names.
"""

from __future__ import annotations

import math
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from mufly.compiled.record_fields import int_or_array_field as _int
from mufly.compiled.record_fields import make_record_dtype
from mufly.compiled.record_fields import real_or_array_field as _real
from mufly.dynamics import GRAVITY, hover_current_A, model_parameters, standing_height
from mufly.dynamics.model_state import compute_hover_rotor_speeds
from mufly.quantities.quantity_table import DIMENSION_LABELS, READINGS_WITH_FUSION_STATUS
from mufly.quantities.sensor_table import CHECKED
from mufly.sensors import beam_directions
from mufly.sensors.magnetometer import earth_field
from mufly.sensors.ring_camera import ELEVATION_MARGIN_FACTOR
from mufly.sensors.sonar import max_standing_sonar_range
from mufly.vehicle import Vehicle
from mufly.vehicle.sensor_schema import DEFAULT_LEVEL_ERROR_RAD, SensorSuite
from mufly.world import World

_Array = NDArray[np.float64]
_Ints = NDArray[np.int32]

ERROR_STATES: tuple[str, ...] = (
    "position_N", "position_E", "position_D",
    "velocity_N", "velocity_E", "velocity_D",
    "turn_N", "turn_E", "turn_D",
    "gyro_bias_p", "gyro_bias_q", "gyro_bias_r",
    "accelerometer_bias_x", "accelerometer_bias_y", "accelerometer_bias_z",
    "floor_height",
    "fix_bias_N", "fix_bias_E", "fix_bias_D", "fix_bias_heading",
    "wind_N", "wind_E",
    "thrust_scale",
    "pressure_bias",
    "magnetic_heading_bias",
)  # fmt: skip
"""The error state, in order: m, m/s, rad (turns about N, E, D), rad/s, m/s^2, m, m and rad, m/s, 1, Pa, rad."""

ERROR_STATE_COUNT = len(ERROR_STATES)
STATE_COUNT = ERROR_STATE_COUNT + 1
NOMINAL_POSITION, NOMINAL_VELOCITY, NOMINAL_ATTITUDE, NOMINAL_GYRO_BIAS, NOMINAL_ACCEL_BIAS, NOMINAL_TERRAIN = (
    0,
    3,
    6,
    10,
    13,
    16,
)
NOMINAL_FIX_BIAS, NOMINAL_FIX_HEADING, NOMINAL_WIND, NOMINAL_THRUST_SCALE, NOMINAL_PRESSURE_BIAS, NOMINAL_MAG_BIAS = (
    17,
    20,
    21,
    23,
    24,
    25,
)
ERROR_POSITION, ERROR_VELOCITY, ERROR_ATTITUDE, ERROR_GYRO_BIAS, ERROR_ACCEL_BIAS, ERROR_TERRAIN = 0, 3, 6, 9, 12, 15
ERROR_FIX_BIAS, ERROR_FIX_HEADING, ERROR_WIND, ERROR_THRUST_SCALE, ERROR_PRESSURE_BIAS, ERROR_MAG_BIAS = (
    16,
    19,
    20,
    22,
    23,
    24,
)
ACCEL_WORK_MODEL = 3
"""Index of the model's acceleration in ``accel_work``."""
ROTOR_THRUST_ACCEL, ROTOR_NON_THRUST_ACCEL, ROTOR_ACCEL_PER_VELOCITY, ROTOR_ANG_ACCEL = 0, 3, 6, 9
ROTOR_FORCE_SIZE = 12
"""A row of the rotor model, three numbers each: force per mass without motion through the air (m/s^2), the rest of the
force (m/s^2), its slope over the velocity through the air (1/s), angular acceleration (rad/s^2); body axes."""
(
    INPUT_RATES,
    INPUT_ACCEL,
    INPUT_THRUST_ACCEL,
    INPUT_NON_THRUST_ACCEL,
    INPUT_ACCEL_PER_VELOCITY,
    INPUT_ACCEL_WEIGHT,
    INPUT_NOISE_DENSITY,
    INPUT_FLIGHT_PHASE,
) = (0, 3, 6, 9, 12, 15, 18, 21)
INPUT_ROW_SIZE = 22
"""Size of a row of inputs, which are means over a block. Seven parts have three numbers each: rates (rad/s),
acceleration (m/s^2), three forces of the rotor model, accelerometer weight and noise density (m^2/s^3). The flight
phase is the last."""

BIAS_CYCLE_TICKS = ERROR_STATE_COUNT - ERROR_GYRO_BIAS - 4
"""Periods in which each bias steps once, but for those of the fix, which step with it."""

MAX_FUSED_BEAMS = 8
READING_WIDTHS = tuple(
    MAX_FUSED_BEAMS if row.dim == "beam" else len(DIMENSION_LABELS.get(row.dim or "", (0,))) for row in CHECKED
)
READING_STARTS = tuple(int(k) for k in np.cumsum([0, *READING_WIDTHS]))
"""Index of each reading in the row of values of one instant."""
SENSOR_COUNT = len(READINGS_WITH_FUSION_STATUS)
SUBTRACTED_READING_OFFSETS = tuple(row.filter_datum for row in CHECKED)
"""Offset subtracted from each reading."""
QUEUED_READING_INDICES = tuple(k for k, row in enumerate(CHECKED) if row.is_queued)
QUEUED_READING_COUNT = len(QUEUED_READING_INDICES)
"""Readings that wait for the horizon, where they are fused."""
FIX_NORTH, FIX_EAST, FIX_DOWN, FIX_HEADING = range(4)
FIX_COMPONENT_COUNT = 4
"""Components of a position fix (m, rad)."""
(
    READING_ACCELERATION,
    READING_RATES,
    READING_SONAR,
    READING_RANGE_RING,
    READING_PRESSURE,
    READING_MAGNETIC_FIELD,
    READING_ROTOR_SPEED,
    READING_POSITION_FIX,
    READING_BATTERY,
) = range(9)
"""Places of the readings in these tables, as :data:`mufly.quantities.sensor_table.SENSORS` gives them."""
PHASE_STANDING, PHASE_ROTORS_COASTING, PHASE_MOTORS_RUNNING, PHASE_LIFTING_OFF, PHASE_FLYING = range(5)
"""On the floor with stopped rotors, with coasting rotors, with motors on; perhaps just off the floor; in the air."""
INPUT_BLOCK_S = 0.02
"""Inputs are averaged over this time (s), and the filter moves on by it: attitude and force of a turn of 2 rad/s are
right to 1e-4 in it."""
INPUT_HISTORY_BLOCKS = 40  # blocks of input that are remembered
MAX_LAG_BLOCKS = 4  # blocks by which the filter may be behind when much has come at once
MAX_DELAY_BLOCKS = INPUT_HISTORY_BLOCKS - 2 * MAX_LAG_BLOCKS  # blocks by which the horizon may be behind now
QUEUE_SIZE = 64  # measurements that wait for the horizon
MAX_FUSION_BUDGET = 4  # scalar measurements, or what costs as much, for which there is time in a period of 5 ms
TRANSITION_GYRO, TRANSITION_ACCEL, TRANSITION_WIND, TRANSITION_THRUST, TRANSITION_ATTITUDE = 0, 9, 18, 27, 30
TRANSITION_SIZE = 33
"""Numbers of :func:`mufly.estimate.filter.strapdown.error_transition`, and where its parts start."""
AID_POSITION, AID_HEADING, AID_SONAR, AID_PRESSURE, AID_MAGNETIC = range(5)
AID_COUNT = 5
"""Aids whose noise is estimated in flight; of the first two, parts of the position fix, the random walk too."""
AID_NOISE_FIELDS = (
    (AID_POSITION, "position", READING_POSITION_FIX, "fix_variance", 100.0, "cm"),
    (AID_HEADING, "heading", READING_POSITION_FIX, "fix_heading_variance", math.degrees(1.0), "deg"),
    (AID_SONAR, "sonar", READING_SONAR, "sonar_variance", 100.0, "cm"),
    (AID_PRESSURE, "pressure", READING_PRESSURE, "pressure_noise_density", 1.0, "Pa s^0.5"),
    (AID_MAGNETIC, "magnetic heading", READING_MAGNETIC_FIELD, "mag_heading_variance", math.degrees(1.0), "deg"),
)
"""Of each aid: index, name, reading, setting of the variance, factor to the shown unit, unit."""
MAX_H_TERMS = 8  # largest number of states in a measurement equation
ROTOR_FORCE_HISTORY = 8  # periods for which forces of the model wait for the slower inertial unit


class FilterMemory:
    """State of the filter between two periods, all zero before its reset. ``lp`` in a name means low-pass filtered."""

    # The filter at the horizon
    x: _Array = _real("nominal state at the horizon, indices SX", STATE_COUNT)
    u_transposed: _Array = _real("U of P = U D U^T by columns, ut[j, i] = U_ij", ERROR_STATE_COUNT, ERROR_STATE_COUNT)
    ud_diagonal: _Array = _real("diagonal of D", ERROR_STATE_COUNT)
    horizon_tick: int = _int("period to which x belongs")
    fix_bias_tick: int = _int("period up to which the bias of the fix is predicted")
    task_stage: int = _int("next stage of the computation at the horizon")
    next_beam: int = _int("next beam of the ring to fuse")
    beams_seen: int = _int("beams of this scan with a range")
    beams_fused: int = _int("beams of this scan within their gate")
    yaw_rate: float = _real("yaw rate about the vertical axis at the horizon", unit="rad/s")
    wall_info_limit: _Array = _real("largest information on N and E in a scan", 2, unit="1/m2")
    wall_info_fraction: _Array = _real("share of wall_info_limit that this scan adds", 2)
    # Inputs
    input_blocks: _Array = _real(
        "rows of inputs, at their block modulo INPUT_HISTORY_BLOCKS", "INPUT_HISTORY_BLOCKS", INPUT_ROW_SIZE
    )
    inputs_now: _Array = _real("inputs of the last period", INPUT_ROW_SIZE)
    tick: int = _int("periods since the reset")
    gyro_rates: _Array = _real("gyroscope rates without spikes and offset, body axes", 3, unit="rad/s")
    # Rotor model
    flight_model_state: _Array = _real("state of the flight model in body axes, indices RS", 21)
    actuator_inputs: _Array = _real("actuator inputs of the last period: motors, servos", 4)
    rotor_spin_accel_bias: _Array = _real("error of the modelled rotor acceleration: upper, lower", 2, unit="rad/s2")
    supply_current: float = _real("modelled supply current", unit="A")
    model_rate_step_bias: _Array = _real(
        "error of the modelled angular acceleration times the period, body axes", 3, unit="rad/s"
    )
    rate_residual_lp: float = _real("measured minus modelled rates, lp", unit="rad/s")
    rotor_model_rows: _Array = _real(
        "rows of the rotor model, at their period modulo ROTOR_FORCE_HISTORY", ROTOR_FORCE_HISTORY, ROTOR_FORCE_SIZE
    )
    # Measurements that wait for the horizon
    queue_due: _Ints = _int("period of the horizon at which each is fused; -1: free", "QUEUE_SIZE")
    queue_sensor: _Ints = _int("sensor of each measurement", "QUEUE_SIZE")
    queue_value: _Array = _real("value of each measurement", "QUEUE_SIZE", MAX_FUSED_BEAMS)
    queue_time_in_period: _Array = _real(
        "time of each measurement after the start of its period", "QUEUE_SIZE", unit="s"
    )
    # Noise of the accelerometers about the model
    gyro_rates_prev: _Array = _real("rates of the previous period, body axes", 3, unit="rad/s")
    accel_low_frequency_noise_density: _Array = _real("density of the noise at low frequencies", 3, unit="m2/s3")
    vibration_velocity: _Array = _real("integral of the residuals, high-passed", 3, unit="m/s")
    vibration_velocity_variance: _Array = _real("variance of the output's velocity due to vibration", 3, unit="m2/s2")
    slow_residual_sum: _Array = _real("weighted sum of residuals since the last slow mean", 3, unit="m/s2")
    slow_residual_mean_prev: _Array = _real("last slow mean", 3, unit="m/s2")
    slow_residual_count: int = _int("residuals in slow_residual_sum")
    slow_residual_mean_count: int = _int("slow means so far")
    clipped_fraction: _Array = _real("share of clipped samples, lp", 3)
    # Means since accelerometers and model were compared last
    accel_mean: _Array = _real("measured acceleration", 3, unit="m/s2")
    model_accel_mean: _Array = _real("acceleration of the model", 3, unit="m/s2")
    accel_per_thrust_scale: _Array = _real(
        "derivative of the modelled acceleration with respect to the thrust scale", 3, unit="m/s2"
    )
    accel_per_air_velocity: _Array = _real(
        "derivative of the modelled acceleration with respect to the velocity through the air", 3, unit="1/s"
    )
    accel_residual_density: _Array = _real("noise density of measured minus modelled acceleration", 3, unit="m2/s3")
    max_accel_model_ratio: float = _real("largest innovation ratio of the axes so far")
    block_mean_ticks: int = _int("periods in these means")
    # Flight phase, terrain, faults
    terrain_edge_weight: float = _real("weight of terrain noise: 1 at an edge in the sonar's cone, then decaying to 0")
    divergence_recovery_ticks_left: int = _int(
        "periods for which the gyroscopes' bias stays free; 1: has been freed once"
    )
    flight_phase: int = _int("STANDING, ROTORS_COASTING, MOTORS_RUNNING, LIFTING_OFF or FLYING")
    worst_fix_component: int = _int(
        "component of the last position fix with the largest innovation ratio: N, E, D, heading"
    )
    fix_fault_component: int = _int("component to which the fix's reason_number belongs")
    is_sonar_at_minimum: int = _int("1: the sonar reads its minimum range")
    equal_spike_count: int = _int("gyroscope readings in a row with the same deviation")
    gyro_offset_jump: _Array = _real("offset jumps of the gyroscopes, subtracted from the readings", 3, unit="rad/s")
    sonar_ratio_lp: float = _real("innovation ratio of the sonar, lp")
    pressure_ratio_lp: float = _real("innovation ratio of the pressure, lp")
    spike_count: int = _int("gyroscope readings in a row with a spike")
    rates_with_spikes: _Array = _real("rates of the period before, spikes included", 3, unit="rad/s")
    terrain_steps: int = _int("terrain steps at this edge")
    fix_max_ratio_squared_lp: float = _real("square of the largest innovation ratio of the fix, lp")
    noise_scale: _Array = _real("ratio of an aid's estimated noise variance to the vehicle file's", AID_COUNT)
    bias_walk_scale: _Array = _real(
        "ratio of the fix bias's estimated random-walk variance to the file's: position, heading; 1: other aids",
        AID_COUNT,
    )
    fix_ratio: _Array = _real("innovation ratio of the fix: N, E, D, heading", 4)
    fix_ratio_prev: _Array = _real("innovation ratio of the last fused fix: N, E, D, heading", 4)
    fix_ratio_mean: _Array = _real("mean of these ratios, lp", 4)
    is_accel_distrusted: int = _int("1: accelerometers and model differ by six deviations")
    accel_model_difference_tick: int = _int(
        "last period in which the 160 ms means of accelerometers and model differed"
    )
    accel_model_diagnosis: int = _int("verdict on accelerometers or model, a VERDICT constant of sensor_checks.py")
    accel_model_conflict_start_tick: int = _int("period in which their conflict began")
    accel_residual_lp: _Array = _real("measured minus modelled acceleration, lp", 3, unit="m/s2")
    accel_residual_sigma: _Array = _real("expected standard deviation of accel_residual_lp", 3, unit="m/s2")
    position_prev: _Array = _real("output position of the previous period", 3, unit="m")
    standing_ticks: int = _int("periods on the floor with the motors off")
    levelling_ticks: int = _int("periods at rest in which the tilt of the inertial unit has been measured")
    levelling_accel_sum: _Array = _real("sum of the accelerometer readings over levelling_ticks", 3, unit="m/s2")
    has_levelling_rotation: int = _int("1: the inertial unit is tilted, and its readings are rotated level")
    levelling_rotation: _Array = _real("rotation matrix applied to the readings, by rows", 9)
    mount_variance: _Array = _real("variance of the axis misalignment that remains after levelling", 3, unit="rad2")
    yaw_rate_in_gyro_bias: _Array = _real(
        "yaw rate whose cross-axis error is included in each gyroscope bias", 3, unit="rad/s"
    )
    gyro_bias_at_zero_yaw_rate: _Array = _real("gyroscope biases without this cross-axis error", 3, unit="rad/s")
    gyro_bias_at_zero_yaw_rate_variance: _Array = _real(
        "variance of the gyroscope biases before the yaw motion", 3, unit="rad2/s2"
    )
    is_heading_aligned: int = _int("1: a fix has been fused")
    gyro_mean: _Array = _real("measured rates, mean since the last comparison", 3, unit="rad/s")
    gyro_mean_prev: _Array = _real("last such mean of each axis on the floor", 3, unit="rad/s")
    is_initialised: int = _int("1: the estimate is initialised and may be used")
    # Output: the state of now
    x_output: _Array = _real("current nominal state, indices SX", STATE_COUNT)
    rates_output: _Array = _real("current rates, body axes", 3, unit="rad/s")
    angles_output: _Array = _real("roll, pitch, and continuous yaw", 3, unit="rad")
    covariance_output: _Array = _real("covariance of position, velocity and roll, pitch, yaw", 9, 9)
    sigma_output: _Array = _real("standard deviations of the error state", ERROR_STATE_COUNT)
    position_jump_remainder: _Array = _real(
        "decaying remainder of position jumps, subtracted from the output", 3, unit="m"
    )
    # From the horizon to now
    x_repropagating: _Array = _real("state during repropagation from the horizon to the present", STATE_COUNT)
    repropagating_tick: int = _int("period to which x_repropagating belongs")
    repropagating_added_velocity_variance: _Array = _real(
        "velocity variance added by the repropagation", 3, unit="m2/s2"
    )
    repropagating_velocity_change: _Array = _real(
        "velocity change over the repropagation without gravity", 3, unit="m/s"
    )
    repropagating_span: float = _real("time since the horizon", unit="s")
    x_now: _Array = _real("last completed repropagation, predicted to the present", STATE_COUNT)
    now_added_velocity_variance: _Array = _real("velocity variance added since the horizon of x_now", 3, unit="m2/s2")
    now_velocity_change: _Array = _real("velocity change since that horizon without gravity", 3, unit="m/s")
    x_now_span: float = _real("time since that horizon", unit="s")
    # Health of each sensor
    last_value: _Array = _real("last value of each sensor, from READING_STARTS on", READING_STARTS[-1])
    last_new_tick: _Ints = _int("period of the last new reading", SENSOR_COUNT)
    last_fused_tick: _Ints = _int("period of the last fused reading", SENSOR_COUNT)
    repeat_count: _Ints = _int("bit-identical readings in a row", SENSOR_COUNT)
    reject_count: _Ints = _int("readings rejected in a row", SENSOR_COUNT)
    agreeing_reject_since_tick: _Ints = _int("period since which rejected readings agree with each other", SENSOR_COUNT)
    last_grounded_tick: int = _int("last period outside the phase FLYING")
    status: _Ints = _int("NOTHING, FUSED, REJECTED, MISSING or FAULTY", SENSOR_COUNT)
    reason: _Ints = _int("reason of the status, of sensor_checks.py", SENSOR_COUNT)
    fault_until_tick: _Ints = _int("period until which a fault is reported", SENSOR_COUNT)
    reason_number: _Array = _real("number in the reason's text", SENSOR_COUNT)
    innovation: _Array = _real("innovation of the worst component", SENSOR_COUNT)
    innovation_sigma: _Array = _real("standard deviation of this innovation", SENSOR_COUNT)
    late_count: _Ints = _int("readings that came too late to be fused", SENSOR_COUNT)
    rejected_value: _Array = _real("last rejected value", SENSOR_COUNT, 3)
    agreeing_reject_count: _Ints = _int("rejected readings in a row that agree with each other", SENSOR_COUNT)
    is_skipped_by_decimation: _Ints = _int("1: this reading is not fused because of decimation", SENSOR_COUNT)
    reject_score: _Array = _real("number of rejections, decaying with every fused reading", SENSOR_COUNT)
    invalid_count: _Ints = _int("readings in a row that are marked invalid by the sensor", SENSOR_COUNT)
    duplicate_count: _Ints = _int("readings in a row that arrived twice", SENSOR_COUNT)
    decimation_count: _Ints = _int("number of readings, for decimation", SENSOR_COUNT)
    fix_sonar_height_difference: float = _real(
        "absolute difference of the heights by fix and sonar during a conflict, else 0", unit="m"
    )
    sonar_range_prev: float = _real("last range of the sonar", unit="m")
    sonar_effective_min_range: float = _real(
        "least range of the sonar: that of the vehicle file, or a longer one shown at rest", unit="m"
    )
    sonar_repeat_chance: float = _real("probability of so many equal readings of a working sonar")
    height_reset_tick: int = _int("period of the last reset of the height by the sonar")
    spike_residual_carry: _Array = _real("gyroscope residuals carried to the next period", 3, unit="rad/s")
    rotor_spin_accel_bias_mean: _Array = _real("rotor_spin_accel_bias, mean over seconds", 2, unit="rad/s2")
    # Work
    axis_work: _Array = _real("work", 3)
    h_term_count: int = _int("terms of the row of H")
    h_state_index: _Ints = _int("error state of each term", MAX_H_TERMS)
    h_value: _Array = _real("value of each term", MAX_H_TERMS)
    u_transposed_h: _Array = _real("U^T h", ERROR_STATE_COUNT)
    gain: _Array = _real("Kalman gain", ERROR_STATE_COUNT)
    # Work of Python alone: in C it is on the stack
    rotation_work: _Array = _real("rotation matrix", 9)
    accel_work: _Array = _real("acceleration without gravity, N, E, D; modelled acceleration, body axes", 6)
    transition_work: _Array = _real("error transition matrix", TRANSITION_SIZE)
    q_work: _Array = _real("process noise", 9)
    w_work: _Array = _real("velocity columns", 3, 6)
    derivative_work: _Array = _real("derivative of the flight model", 21)
    zero_wind: _Array = _real("zeros", 3)


class FilterSettings:
    """The filter's settings for a vehicle (:func:`make_filter_settings`)."""

    dt: float = _real("period", unit="s")
    block_ticks: int = _int("periods of a block")
    fusion_budget: int = _int("scalar measurements fused per period at most")
    imu_lag: float = _real("delay of the inertial unit's filter", unit="s")
    imu_lag_ticks: int = _int("whole periods of imu_lag")
    imu_lag_remainder: float = _real("rest of imu_lag as a fraction of the period")
    horizon_delay_ticks: int = _int("periods by which the horizon is behind")
    has_rotor_model: int = _int("1: the rotor model is used")
    swash_lag_decay: float = _real("decay factor of the swash plate lag per period")
    swash_lag_decay_mean: float = _real("mean of the decay over the period")
    initial_state: _Array = _real("state at the reset", STATE_COUNT)
    initial_sigma: _Array = _real("standard deviations at the reset", ERROR_STATE_COUNT)
    decay: _Array = _real("decay factor of each bias per step", ERROR_STATE_COUNT)
    process_variance: _Array = _real("process noise variance of each error per step", ERROR_STATE_COUNT)
    gyro_noise_density: float = _real("density of the gyroscopes' noise", unit="rad2/s")
    gyro_axis_variance: _Array = _real("variance of each gyroscope's error as a share of the yaw rate", 3)
    accel_noise_density: float = _real("density of the accelerometers' noise", unit="m2/s3")
    model_accel_noise_density: _Array = _real("density of the rotor model's error", 3, unit="m2/s3")
    accel_range: float = _real("range of the accelerometers", unit="m/s2")
    gyro_range: float = _real("range of the gyroscopes", unit="rad/s")
    rest_accel_sigma: float = _real("standard deviation of the accelerometers at rest", unit="m/s2")
    rest_gyro_sigma: float = _real("standard deviation of the gyroscopes at rest", unit="rad/s")
    rest_tilt_sigma: float = _real("standard deviation of the tilt on the floor", unit="rad")
    ground_clearance: float = _real("height of the centre of gravity on the floor", unit="m")
    weight: float = _real("weight", unit="N")
    thrust_coefficients: _Array = _real("thrust over squared rotor speed: upper, lower", 2, unit="N s2")
    hover_speed: _Array = _real("rotor speed in hover: upper, lower", 2, unit="rad/s")
    is_fitted: _Ints = _int("1: the sensor is on board", SENSOR_COUNT)
    sensor_period: _Array = _real("time between two readings", SENSOR_COUNT, unit="s")
    latency: _Array = _real("usual age of a new reading", SENSOR_COUNT, unit="s")
    timeout: _Array = _real("time without a reading after which it is missing", SENSOR_COUNT, unit="s")
    latency_slack: _Array = _real("allowed age beyond the latency", SENSOR_COUNT, unit="s")
    has_noise: _Ints = _int("1: equal readings in a row are a fault", SENSOR_COUNT)
    value_limit: _Array = _real("largest plausible value", SENSOR_COUNT)
    reading_decimation: _Ints = _int("decimation factor: one of so many readings is fused", SENSOR_COUNT)
    sonar_position: _Array = _real("position of the sonar, body axes", 3, unit="m")
    sonar_variance: float = _real("variance of a range", unit="m2")
    sonar_resolution: float = _real("resolution of a range", unit="m")
    sonar_cone_cosine: float = _real("cosine of half the cone")
    sonar_min_range: float = _real("minimum range, or the largest reading on the floor if that is larger", unit="m")
    sonar_max_range: float = _real("largest range", unit="m")
    sonar_cone_edge_excess: float = _real("ratio of the range at the cone's edge to that on its axis, minus 1")
    sonar_cone_radius_ratio: float = _real("ratio of the cone's radius to the range")
    fix_variance: float = _real("variance of the fix's position", unit="m2")
    fix_heading_variance: float = _real("variance of the fix's heading", unit="rad2")
    beam_count: int = _int("beams of the ring")
    beam_directions: _Array = _real("directions of the beams, body axes", MAX_FUSED_BEAMS, 3)
    ring_max_range: float = _real("largest range of a beam", unit="m")
    ring_constant_variance: float = _real("variance of a beam's constant error", unit="1/m2")
    ring_noise_variance: float = _real("variance of a beam's noise", unit="1/m6")
    ring_baseline: float = _real("baseline of the ring camera", unit="m")
    wall_planes: _Array = _real("walls of the room: N lower, upper; E lower, upper; D of ceiling, floor", 6, unit="m")
    pressure_noise_density: float = _real("noise density of the pressure sensor", unit="Pa2 s")
    pressure_gradient_down: float = _real("derivative of pressure with respect to D", unit="Pa/m")
    mag_heading_variance: float = _real("variance of the magnetic heading", unit="rad2")
    mag_field_variance: float = _real("variance of the field per axis without current", unit="T2")
    mag_current_variance: float = _real("variance of the motors' field per axis and squared current", unit="T2/A2")
    earth_field: _Array = _real("magnetic field of the earth, N, E, D", 3, unit="T")
    rotor_speed_filter_gain: float = _real("gain of the rotor speed filter")
    rotor_spin_accel_bias_gain: float = _real("gain of the estimate of rotor_spin_accel_bias", unit="1/s")
    imu_position: _Array = _real("position of the inertial unit, body axes", 3, unit="m")


def make_memory_dtype(kind: Any = np.float64, kept: int = INPUT_HISTORY_BLOCKS, waiting: int = QUEUE_SIZE) -> np.dtype:
    """Return the record type of :class:`FilterMemory` for a number type and given numbers of input blocks and queued
    measurements.
    """
    return make_record_dtype(FilterMemory, kind, INPUT_HISTORY_BLOCKS=kept, QUEUE_SIZE=waiting)


def make_settings_dtype(kind: Any = np.float64) -> np.dtype:
    """Return the record type of :class:`FilterSettings` for a number type."""
    return make_record_dtype(FilterSettings, kind)


# What is assumed beyond the vehicle's file (docs/explanation/estimation.md)
MODEL_FORCE_SIGMA = (0.035, 0.035, 0.035)
"""Error of the rotor model in flight, one sigma per axis (m/s^2), and its correlation time (s)."""
MODEL_FORCE_CORRELATION_TIME_S = 0.1
THRUST_SCALE_SIGMA, THRUST_SCALE_WALK = 0.3, 0.0055
"""Standard deviation of the thrust scale (1) and its random walk (1/sqrt(s)). Vehicles whose parameters differ by 10 %
from the model have 0.65 to 1.7 times its thrust: the radius counts to the fourth power."""
WIND_SIGMA_AND_CORRELATION_TIME = (0.5, 10.0)
"""Of an axis (m/s), and for how long (s): a mean of 0.5 m/s from anywhere and gusts of 0.3 m/s make 0.46."""
MOTOR_MODEL_NOISE_FRACTION = (
    1e-3  # what the motors' equations miss between two readings of the speed, of the hover speed
)
EARTH_FIELD_RELATIVE_ERROR = 0.02  # of a place, over its strength: the file names a city
TERRAIN_EDGE_DURATION_S, MAX_FLOOR_HEIGHT_M, MIN_FLOOR_RESET_SIGMA_M = 3.0, 0.05, 0.01
"""An edge in the sonar's cone counts for this long (s) where it is not flown over sooner; what is lower is the floor
(m), and known to be once its height is uncertain by more than the last (m)."""
TERRAIN_RANDOM_WALK = 5e-4  # of the way over it (m/sqrt(m)): floors are not quite flat
INITIAL_TERRAIN_SIGMA_M = 1e-4  # m: where it stands is D = 0, by definition
INITIAL_POSITION_SIGMA_M = 5.0  # where it stands before anything is heard
FULL_TURN_RAD = 2 * math.pi
_MIN_BEAM_ERROR = 1e-4  # 1/m: what a wall is off by, 0.1 mm at 1 m, where beams have no error


def make_filter_settings(
    vehicle: Vehicle, world: World, rate_Hz: float, kind: Any = np.float64, block_s: float = INPUT_BLOCK_S
) -> np.void:
    """Return the filter's settings of a vehicle: sensor errors, dimensions, walls of the room.

    Parameters
    ----------
    vehicle : Vehicle
    world : World
        Only its room is used.
    rate_Hz : float
        Rate of the flight software (Hz).
    kind : type
        Type of the numbers.
    block_s : float
        Time over which inputs are averaged (s).
    """
    sensing = vehicle.sensors or SensorSuite()
    s = np.zeros((), make_settings_dtype(kind))
    dt = 1.0 / rate_Hz
    p = model_parameters(vehicle)
    sigma, tau = np.zeros(ERROR_STATE_COUNT), np.full(ERROR_STATE_COUNT, np.inf)
    walk = np.zeros(ERROR_STATE_COUNT)  # random walk on top (unit per sqrt(s))
    start = np.zeros(STATE_COUNT)
    start[NOMINAL_ATTITUDE] = start[NOMINAL_THRUST_SCALE] = 1.0
    stands = standing_height(vehicle)
    start[NOMINAL_POSITION + 2] = -stands
    sigma[ERROR_POSITION : ERROR_POSITION + 2], sigma[ERROR_POSITION + 2], sigma[ERROR_VELOCITY:ERROR_ATTITUDE] = (
        INITIAL_POSITION_SIGMA_M,
        3e-3,
        0.01,
    )
    level = DEFAULT_LEVEL_ERROR_RAD if sensing.imu is None else float(sensing.imu.standing_tilt_error)
    sigma[ERROR_ATTITUDE : ERROR_ATTITUDE + 2], sigma[ERROR_ATTITUDE + 2] = level, math.pi
    sigma[ERROR_TERRAIN], walk[ERROR_TERRAIN] = (
        INITIAL_TERRAIN_SIGMA_M,
        TERRAIN_RANDOM_WALK,
    )  # the last times the root of the speed
    sigma[ERROR_WIND : ERROR_WIND + 2], tau[ERROR_WIND : ERROR_WIND + 2] = WIND_SIGMA_AND_CORRELATION_TIME
    sigma[ERROR_THRUST_SCALE], walk[ERROR_THRUST_SCALE] = THRUST_SCALE_SIGMA, THRUST_SCALE_WALK
    walk[ERROR_POSITION:ERROR_VELOCITY] = 1e-4
    s["dt"] = dt
    s["ground_clearance"], s["weight"], s["rest_tilt_sigma"] = stands, p["mass"] * GRAVITY, level
    s["thrust_coefficients"] = p["thrust_up"], p["thrust_dw"]
    s["hover_speed"] = compute_hover_rotor_speeds(p)
    swash = float(p["swash_rate"]) * dt
    s["swash_lag_decay"], s["swash_lag_decay_mean"] = math.exp(-swash), (1.0 - math.exp(-swash)) / swash
    s["has_rotor_model"], s["model_accel_noise_density"] = (
        1,
        2 * MODEL_FORCE_CORRELATION_TIME_S * np.square(MODEL_FORCE_SIGMA),
    )
    fitted, period, latency, bound = (
        np.zeros(SENSOR_COUNT),
        np.full(SENSOR_COUNT, dt),
        np.zeros(SENSOR_COUNT),
        np.full(SENSOR_COUNT, 1e9),
    )
    every, noisy, slack = np.ones(SENSOR_COUNT), np.zeros(SENSOR_COUNT), np.full(SENSOR_COUNT, 0.05)
    delay_s = 0.0
    if (imu := sensing.imu) is not None:
        fitted[[READING_ACCELERATION, READING_RATES]] = 1
        lag = math.sqrt(2.0) / float(imu.bandwidth)  # of a second-order Butterworth filter at low frequencies
        noisy[READING_ACCELERATION], noisy[READING_RATES] = (
            float(imu.accelerometer_noise_density) > 0,
            float(imu.gyro_noise_density) > 0,
        )
        slack[[READING_ACCELERATION, READING_RATES]] = 1.5 * dt
        s["imu_lag"], s["imu_lag_ticks"], s["imu_lag_remainder"] = lag, int(lag / dt), lag / dt - int(lag / dt)
        s["imu_position"] = imu.position.to_array()[0]
        s["gyro_noise_density"], s["accel_noise_density"] = (
            float(imu.gyro_noise_density) ** 2,
            float(imu.accelerometer_noise_density) ** 2,
        )
        s["gyro_axis_variance"] = np.square([float(imu.misalignment)] * 2 + [float(imu.scale_error)])
        s["accel_range"], s["gyro_range"] = float(imu.accelerometer_range), float(imu.gyro_range)
        bound[READING_ACCELERATION], bound[READING_RATES] = 1.2 * s["accel_range"], 1.2 * s["gyro_range"]
        heat = float(imu.temperature_rise)
        band = float(imu.bandwidth) / (2 * math.pi)
        # Scale and misalignment of axes that stand level are a bias; so is what gyroscopes feel of gravity.
        off = math.hypot(float(imu.scale_error), float(imu.misalignment)) * GRAVITY
        sigma[ERROR_ACCEL_BIAS:ERROR_TERRAIN] = math.hypot(float(imu.accelerometer_bias), off)
        sigma[ERROR_GYRO_BIAS:ERROR_ACCEL_BIAS] = math.hypot(
            float(imu.gyro_bias), float(imu.gyro_g_sensitivity) * GRAVITY
        )
        time = float(imu.drift_correlation_time)
        for axes, drift, warm in (
            (
                slice(ERROR_ACCEL_BIAS, ERROR_TERRAIN),
                imu.accelerometer_drift,
                imu.accelerometer_temperature_coefficient,
            ),
            (slice(ERROR_GYRO_BIAS, ERROR_ACCEL_BIAS), imu.gyro_drift, imu.gyro_temperature_coefficient),
        ):
            # Wandering, and warming taken as a random walk that reaches as far in the warming's time
            walk[axes] = math.hypot(
                float(drift) * math.sqrt(2.0 / time),
                0.6 * float(warm) * heat / math.sqrt(float(imu.temperature_time_constant)),
            )
        s["rest_accel_sigma"] = max(float(imu.accelerometer_noise_density) * math.sqrt(1.1 * band), 0.02)
        s["rest_gyro_sigma"] = max(float(imu.gyro_noise_density) * math.sqrt(1.1 * band), 1e-4)
    else:
        s["imu_lag_remainder"] = 0.0
    if (sonar := sensing.sonar) is not None:
        fitted[READING_SONAR], period[READING_SONAR] = 1, float(sonar.period)
        s["sonar_position"] = sonar.position.to_array()[0]
        s["sonar_variance"] = float(sonar.noise) ** 2 + float(sonar.resolution) ** 2 / 12 + 1e-6
        s["sonar_resolution"] = float(sonar.resolution)
        s["sonar_cone_cosine"] = math.cos(0.5 * float(sonar.cone_angle))
        # Of an edge that comes into the cone: how much farther than its top it is, and how far ahead
        s["sonar_cone_edge_excess"], s["sonar_cone_radius_ratio"] = (
            1.0 / s["sonar_cone_cosine"] - 1.0,
            math.tan(0.5 * float(sonar.cone_angle)),
        )
        s["sonar_min_range"], s["sonar_max_range"] = max_standing_sonar_range(vehicle), float(sonar.max_range)
        bound[READING_SONAR] = 1.01 * s["sonar_max_range"]
        latency[READING_SONAR] = 2 * float(sonar.max_range) / 340.0
        delay_s = max(delay_s, latency[READING_SONAR])
    ring = sensing.ring_camera
    if ring is not None:
        fitted[READING_RANGE_RING], period[READING_RANGE_RING] = 1, float(ring.period)
        directions = beam_directions(vehicle)
        count = min(len(directions), MAX_FUSED_BEAMS)
        pick = fused_beam_indices(len(directions))
        s["beam_count"], s["beam_directions"][:count] = count, directions[pick]
        s["ring_max_range"], s["ring_baseline"] = float(ring.max_range), float(ring.baseline)
        # An error of so many rows is one of (l^2 + b^2) / b of their angle. What calibration left of a beam lasts.
        # Noise of one in each pixel moves the centroid of a spot by so many rows at 1 m
        # (docs/explanation/estimation.md).
        row = ELEVATION_MARGIN_FACTOR * math.atan(float(ring.baseline) / float(ring.min_range)) / ring.radial_pixels
        row /= float(ring.baseline)
        blur = float(ring.spot_radius)
        reach = max(1, math.ceil(1.5 * blur))
        columns = math.sqrt(math.sqrt(math.pi) * blur)
        rows = math.sqrt(reach * (reach + 1) * (2 * reach + 1) / 3)
        rows /= float(ring.spot_brightness) * columns * math.sqrt(2 * math.pi) * blur
        s["ring_constant_variance"] = max(row * float(ring.calibration_error), _MIN_BEAM_ERROR) ** 2
        s["ring_noise_variance"] = (row * rows) ** 2
        bound[READING_RANGE_RING] = 1.01 * max(float(vehicle.range_ring.max_range), float(ring.max_range))
        noisy[READING_RANGE_RING] = 1
    north, east, up = ((-1e6, 1e6), (-1e6, 1e6), -1e6)
    if world.room is not None:
        north, east = world.room.north, world.room.east
        up = -min(world.room.height, 1e6)
    s["wall_planes"] = (*north, *east, up, 0.0)
    if (air := sensing.pressure) is not None:
        fitted[READING_PRESSURE], period[READING_PRESSURE], latency[READING_PRESSURE] = 1, float(air.period), 0.0
        every[READING_PRESSURE] = max(1, round(0.1 / float(air.period)))
        noisy[READING_PRESSURE] = float(air.noise) > 0
        s["pressure_noise_density"] = float(air.noise) ** 2
        density = float(vehicle.air.density)
        s["pressure_gradient_down"] = density * GRAVITY
        sigma[ERROR_PRESSURE_BIAS], tau[ERROR_PRESSURE_BIAS] = float(air.drift), float(air.drift_correlation_time)
        bound[READING_PRESSURE] = 2e5
    if (compass := sensing.magnetometer) is not None:
        fitted[READING_MAGNETIC_FIELD], period[READING_MAGNETIC_FIELD] = 1, float(compass.period)
        every[READING_MAGNETIC_FIELD] = max(1, round(0.1 / float(compass.period)))
        noisy[READING_MAGNETIC_FIELD] = float(compass.noise) > 0
        s["earth_field"] = earth_field(float(compass.field_strength), float(compass.inclination))
        field = max(float(s["earth_field"][0]), 1e-9)
        # Heave control swings the motors' current by half of a hover's, and its field with it
        current = hover_current_A(vehicle)
        swing = 0.5 * (current - float(vehicle.battery.electronics_current)) * float(compass.field_per_current)
        s["mag_heading_variance"] = (math.hypot(float(compass.noise), swing) / field) ** 2
        steady = math.hypot(float(compass.distortion), float(compass.hard_iron))
        wrong = math.hypot(steady, float(compass.field_per_current) * current)
        off = math.hypot(steady, float(compass.noise), EARTH_FIELD_RELATIVE_ERROR * float(compass.field_strength))
        s["mag_field_variance"], s["mag_current_variance"] = off**2, float(compass.field_per_current) ** 2
        sigma[ERROR_MAG_BIAS], tau[ERROR_MAG_BIAS] = (
            min(wrong / field, 2.0),
            float(compass.distortion_correlation_length) / 0.3,
        )
        bound[READING_MAGNETIC_FIELD] = 1e-3
    if (rotor := sensing.rotor_speed) is not None:
        fitted[READING_ROTOR_SPEED], period[READING_ROTOR_SPEED] = 1, float(rotor.period)
        noise = float(rotor.voltage_noise) / (float(vehicle.motor.back_emf_constant) * float(vehicle.gear.ratio))
        noisy[READING_ROTOR_SPEED] = noise > 0
        # Steady Kalman filter of a random walk of these steps, read with this noise
        s["rotor_speed_filter_gain"] = 2.0 / (
            1.0 + math.sqrt(1.0 + 4.0 * (noise / (MOTOR_MODEL_NOISE_FRACTION * s["hover_speed"][0])) ** 2)
        )
        # What the equations are off by for long: learnt in some 0.7 s
        s["rotor_spin_accel_bias_gain"] = 0.06 * s["rotor_speed_filter_gain"] ** 2 / float(rotor.period)
        bound[READING_ROTOR_SPEED] = 5 * float(s["hover_speed"].max())
    if sensing.battery is not None:
        fitted[READING_BATTERY], period[READING_BATTERY] = 1, float(sensing.battery.period)
        bound[READING_BATTERY] = 5 * float(vehicle.battery.nominal_voltage)
    if (fix := sensing.position_fix) is not None:
        fitted[READING_POSITION_FIX], period[READING_POSITION_FIX], latency[READING_POSITION_FIX] = (
            1,
            float(fix.period),
            float(fix.latency),
        )
        delay_s = max(delay_s, float(fix.latency))
        s["fix_variance"], s["fix_heading_variance"] = float(fix.noise) ** 2, float(fix.heading_noise) ** 2
        sigma[ERROR_FIX_BIAS : ERROR_FIX_BIAS + 3], sigma[ERROR_FIX_HEADING] = (
            float(fix.drift),
            float(fix.heading_drift),
        )
        tau[ERROR_FIX_BIAS : ERROR_FIX_BIAS + 4] = float(fix.drift_correlation_time)
        bound[READING_POSITION_FIX] = 1e4
        noisy[READING_POSITION_FIX] = float(fix.noise) > 0
        slack[READING_POSITION_FIX] = 6 * float(fix.latency_jitter) + dt
    # What moves steps by blocks, what the fix is off by so many of them; of other biases one a period, in turn.
    block = max(1, round(block_s / dt))
    state = np.arange(ERROR_STATE_COUNT)
    span = np.where(
        (state < ERROR_GYRO_BIAS) | ((state >= ERROR_FIX_BIAS) & (state <= ERROR_FIX_HEADING)),
        block * dt,
        BIAS_CYCLE_TICKS * dt,
    )
    keep = np.exp(-span / tau)
    s["block_ticks"], s["fusion_budget"] = block, max(MAX_FUSION_BUDGET, math.ceil(4 * MAX_FUSION_BUDGET / block))
    s["initial_state"], s["initial_sigma"], s["decay"] = start, sigma, keep
    s["process_variance"] = sigma**2 * (1 - keep**2) + walk**2 * span
    s["is_fitted"], s["sensor_period"], s["latency"], s["value_limit"], s["reading_decimation"] = (
        fitted,
        period,
        latency,
        bound,
        every,
    )
    s["latency_slack"], s["has_noise"] = slack, noisy
    s["timeout"] = np.maximum(6 * period, 3.5 * dt)
    # What comes later than usual is carried to the horizon; all that is fresher would wait for it.
    s["horizon_delay_ticks"] = min(round(delay_s / dt), MAX_DELAY_BLOCKS * block)
    return cast(np.void, s[()])


def fused_beam_indices(count: int) -> NDArray[np.intp]:
    """Return the beams of a ring that the filter fuses: all, or :data:`MAX_FUSED_BEAMS` spread evenly."""
    return np.unique(np.linspace(0, count, min(count, MAX_FUSED_BEAMS), endpoint=False).astype(np.intp))
