"""Fusion of each measurement: its model, its gate and its reset.

A scalar measurement z = h(x) + n has an innovation of variance S = H P H^T + r. It is fused if the innovation lies
within :data:`~mufly.estimate.filter.measurements.scalar_fusion.INNOVATION_GATE` standard deviations; a measurement of
several components is fused if all their innovations do.

| measurement | h(x) | reset after rejections that agree with each other |
|---|---|---|
| position_fix | p + v dt + b, heading + b_h | after a second: variance of position and heading inflated |
| ground_distance | -(p + R r)_D - terrain | three in a row: a step of the terrain, its variance inflated |
| ranges | distance to the nearest wall of the room along the beam | none: the beams see no wall |
| pressure | rho g p_D + b + the rotors' part | after a second: variance of its bias inflated |
| magnetic_field | heading + b, and tilt by the field's dip | after a second: variance of its bias inflated |

A reset adds variance before the measurement is fused, so the correlations between the errors stay.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from mufly.compiled.numba_cache import cached_njit
from mufly.compiled.portable_math import portable_atan2, wrap_angle
from mufly.estimate.filter.filter_records import (
    AID_MAGNETIC,
    AID_PRESSURE,
    AID_SONAR,
    ERROR_ACCEL_BIAS,
    ERROR_ATTITUDE,
    ERROR_GYRO_BIAS,
    ERROR_MAG_BIAS,
    ERROR_POSITION,
    ERROR_PRESSURE_BIAS,
    ERROR_TERRAIN,
    ERROR_THRUST_SCALE,
    ERROR_VELOCITY,
    ERROR_WIND,
    MAX_FLOOR_HEIGHT_M,
    NOMINAL_ACCEL_BIAS,
    NOMINAL_ATTITUDE,
    NOMINAL_GYRO_BIAS,
    NOMINAL_MAG_BIAS,
    NOMINAL_POSITION,
    NOMINAL_PRESSURE_BIAS,
    NOMINAL_TERRAIN,
    NOMINAL_THRUST_SCALE,
    NOMINAL_VELOCITY,
    PHASE_MOTORS_RUNNING,
    PHASE_ROTORS_COASTING,
    PHASE_STANDING,
    READING_ACCELERATION,
    READING_MAGNETIC_FIELD,
    READING_POSITION_FIX,
    READING_PRESSURE,
    READING_RANGE_RING,
    READING_SONAR,
    FilterMemory,
    FilterSettings,
)
from mufly.estimate.filter.measurements.fix_fusion import fuse_position_fix, predict_fix_bias
from mufly.estimate.filter.measurements.scalar_fusion import (
    INNOVATION_GATE,
    RESET_TIMEOUT_S,
    apply_correction,
    estimate_noise,
    fuse_error_state,
    fuse_scalar,
    h_row_add,
    h_row_begin,
    innovation_ratio,
    log_innovation,
    reject_measurement,
    reset_timeout_expired,
)
from mufly.estimate.filter.measurements.sensor_checks import (
    REASON_FIELD_STRENGTH,
    REASON_INNOVATION,
    REASON_NO_WALL,
    REASON_RESET,
    REASON_STUCK,
    REASON_TERRAIN_SLOPE,
    REASON_TERRAIN_STEP,
    REASON_WALLS_TOO_FAR,
    STATUS_FAULTY,
    STATUS_FUSED,
    STATUS_REJECTED,
    STATUS_WAITING,
    check_accel_model,
    mark_fused,
    set_fault,
)
from mufly.estimate.filter.strapdown import rotation_matrix
from mufly.estimate.filter.ud_filter import inflate_variance, innovation_variance, state_variance
from mufly.quantities.units import GRAVITY

_Array = NDArray[np.float64]

SONAR_MEAN_GATE = PRESSURE_MEAN_GATE = 2.2
"""Mean of five ratios or so of the sonar, and of the pressure: six and a half deviations."""
MAGNETIC_FIELD_GATE = 5.0
"""Deviations of the magnetic field from the earth's, across and along the vertical, above which a field is no heading.
A healthy sensor exceeds them at one place in 270 000 (chi-square of two). Its variance is that of steel and hard iron,
and that of the motors' field at the modelled current."""
SONAR_STUCK_PROBABILITY = 1e-14
"""Probability that a healthy sonar repeats a reading for so long."""
LEG_CLEARANCE_HEIGHT_M = 0.15
"""Height (m) above which no leg touches the floor; angular accelerations are then in the flight model."""
SECOND_HEIGHT_RESET_SPEED_SIGMA, SECOND_HEIGHT_RESET_ACCEL_BIAS_SIGMA, SECOND_HEIGHT_RESET_THRUST_SCALE_SIGMA = (
    0.3,
    0.3,
    0.1,
)
"""Standard deviations of speed (m/s), accelerometer bias (m/s^2) and thrust scale (1) set by a second height reset."""
SECOND_HEIGHT_RESET_WINDOW_S = 1.0
"""Time after a height reset within which the next one counts as the second (s)."""
TERRAIN_STEP_GATE, MAX_TERRAIN_STEPS = 3.0, 8
"""Innovation ratio of the sonar above which the surface below steps at an edge (1); largest number of such steps."""
LIFTOFF_THRUST_RATIO, LIFTOFF_THRUST_SIGMA = 1.08, 0.08
"""Lift over weight as the sonar shows lift-off (1), and its standard deviation (1)."""
_BEAM_INNOVATION_GATE = 4.0
FIX_BIAS_STEP_COST, FIX_FUSION_COST = 1, 4
"""Cost of a bias step of the fix and of a fix, in scalar measurements."""
MIN_TERRAIN_HEIGHT_M = -0.1
"""Lowest floor height (m): no surface lies below the floor."""


@cached_njit(error_model="numpy")
def height_above_ground(x: _Array, s: FilterSettings) -> float:
    """Return the height of the legs above the surface below (m); the surface is at least as high as the floor."""
    return -x[NOMINAL_POSITION + 2] - max(x[NOMINAL_TERRAIN], 0.0) - s.ground_clearance


@cached_njit(error_model="numpy")
def _sonar_h_row(m: FilterMemory, s: FilterSettings, r: _Array) -> float:
    """Write the row H of the sonar; return the vertical distance of the sonar below the centre of gravity (m)."""
    rotation_matrix(m.x[NOMINAL_ATTITUDE : NOMINAL_ATTITUDE + 4], r)
    h_row_begin(m, ERROR_POSITION + 2, -1.0)
    h_row_add(m, ERROR_TERRAIN, -1.0)
    # (exp(t) R r)_D = (R r)_D + t_N (R r)_E - t_E (R r)_N
    n = r[0] * s.sonar_position[0] + r[1] * s.sonar_position[1] + r[2] * s.sonar_position[2]
    e = r[3] * s.sonar_position[0] + r[4] * s.sonar_position[1] + r[5] * s.sonar_position[2]
    d = r[6] * s.sonar_position[0] + r[7] * s.sonar_position[1] + r[8] * s.sonar_position[2]
    h_row_add(m, ERROR_ATTITUDE, -e)
    h_row_add(m, ERROR_ATTITUDE + 1, n)
    return d


@cached_njit(error_model="numpy")
def _reset_height(m: FilterMemory, s: FilterSettings, nu: float) -> None:
    """Inflate the height's variance by ``nu``^2, the square of a lasting innovation of the sonar.

    The foot of a wall in the sonar's cone can cause one reset. A second reset within
    :data:`SECOND_HEIGHT_RESET_WINDOW_S` shows that a force is wrong, so the variances of vertical speed, accelerometer
    bias and thrust scale are inflated, too.
    """
    inflate_variance(m.u_transposed, m.ud_diagonal, ERROR_POSITION + 2, nu * nu, m.u_transposed_h)
    before = m.height_reset_tick
    m.height_reset_tick = m.horizon_tick
    if not (before > 0 and (m.horizon_tick - before) * s.dt < SECOND_HEIGHT_RESET_WINDOW_S):
        return
    inflate_variance(
        m.u_transposed,
        m.ud_diagonal,
        ERROR_VELOCITY + 2,
        SECOND_HEIGHT_RESET_SPEED_SIGMA * SECOND_HEIGHT_RESET_SPEED_SIGMA,
        m.u_transposed_h,
    )
    inflate_variance(
        m.u_transposed,
        m.ud_diagonal,
        ERROR_ACCEL_BIAS + 2,
        SECOND_HEIGHT_RESET_ACCEL_BIAS_SIGMA * SECOND_HEIGHT_RESET_ACCEL_BIAS_SIGMA,
        m.u_transposed_h,
    )
    inflate_variance(
        m.u_transposed,
        m.ud_diagonal,
        ERROR_THRUST_SCALE,
        SECOND_HEIGHT_RESET_THRUST_SCALE_SIGMA * SECOND_HEIGHT_RESET_THRUST_SCALE_SIGMA,
        m.u_transposed_h,
    )


@cached_njit(error_model="numpy")
def _sonar_stuck(m: FilterMemory, s: FilterSettings, z: float, nu: float) -> bool:
    """Return whether the sonar repeats a reading more often than its noise and the vehicle's motion allow.

    With the resolution h, a reading equals the preceding one with a probability of about h / (sqrt(2 pi) sigma)
    exp(-nu^2 / (2 sigma^2)), where sigma is the standard deviation of the innovation nu; the code uses exp(-x) <= 1 /
    (1 + x). While fix and sonar disagree on the height, the vehicle may be lower by the gap between them. If it
    may then stand on the floor, equal readings prove nothing.
    """
    same = z == m.sonar_range_prev
    m.sonar_range_prev = z
    if not same or height_above_ground(m.x, s) - m.fix_sonar_height_difference < LEG_CLEARANCE_HEIGHT_M:
        m.sonar_repeat_chance = 1.0
        return False
    # The height's variance is not included: the height may be more accurate.
    sigma = 1.3 * math.sqrt(s.sonar_variance)
    likely = 0.399 * s.sonar_resolution / sigma / (1.0 + 0.5 * min(nu * nu / (sigma * sigma), 9.0))
    m.sonar_repeat_chance *= min(likely, 1.0)
    return m.sonar_repeat_chance < SONAR_STUCK_PROBABILITY


@cached_njit(error_model="numpy")
def fuse_sonar_range(m: FilterMemory, s: FilterSettings, z: _Array, ahead: float, r: _Array) -> None:
    """Fuse the range to the surface below; assign to the terrain a step that no other sensor measures."""
    k = READING_SONAR
    down = _sonar_h_row(m, s, r)
    if r[8] < s.sonar_cone_cosine or z[0] >= s.sonar_max_range:
        return
    expect = -(m.x[NOMINAL_POSITION + 2] + ahead * m.x[NOMINAL_VELOCITY + 2]) - down - m.x[NOMINAL_TERRAIN]
    said, r_ = z[0], s.sonar_variance * m.noise_scale[AID_SONAR]
    nearest, standing = m.sonar_effective_min_range + 0.005, s.ground_clearance - s.sonar_position[2]
    if z[0] <= nearest and standing < nearest:
        # Below the minimum range: uniform between that range and the range on the floor.
        said = 0.5 * (nearest + standing)
        r_ = (nearest - standing) * (nearest - standing) / 12.0
        if expect < nearest:
            # weight of a hundredth: the errors of such readings are correlated
            fuse_scalar(m, said - expect, 100.0 * r_)
            mark_fused(m, k)
            return
    nu = said - expect
    ratio = innovation_ratio(m, nu, r_)
    log_innovation(m, k, nu, ratio)
    if _sonar_stuck(m, s, z[0], nu):
        set_fault(m, s, k, STATUS_FAULTY, REASON_STUCK, z[0])
        return
    floor = m.x[NOMINAL_TERRAIN] - nu
    over = m.terrain_edge_weight > 0.0 or abs(m.x[NOMINAL_TERRAIN]) > MAX_FLOOR_HEIGHT_M
    # Innovations of one sign: over an edge, or for a shorter range, the surface has changed. Otherwise the height
    # drifts, because no surface lies below the floor: the accelerometers or the model have an error.
    if abs(ratio) < INNOVATION_GATE:
        m.sonar_ratio_lp += 0.2 * (ratio - m.sonar_ratio_lp)
        if not over:
            estimate_noise(m, AID_SONAR, ratio)
    if abs(m.sonar_ratio_lp) > SONAR_MEAN_GATE:
        m.sonar_ratio_lp = 0.0
        set_fault(m, s, k, STATUS_FUSED, REASON_TERRAIN_SLOPE, nu)
        if over or nu < 0.0:
            m.terrain_edge_weight = 1.0
        else:
            _reset_height(m, s, nu)
            _sonar_h_row(m, s, r)
    if over and abs(ratio) > TERRAIN_STEP_GATE and m.terrain_steps < MAX_TERRAIN_STEPS and floor > MIN_TERRAIN_HEIGHT_M:
        # Over an object the surface steps.
        m.terrain_steps += 1
        m.terrain_edge_weight = 1.0
        inflate_variance(m.u_transposed, m.ud_diagonal, ERROR_TERRAIN, nu * nu, m.u_transposed_h)
        _sonar_h_row(m, s, r)
    elif abs(ratio) > INNOVATION_GATE:
        reject_measurement(m, s, k, nu, z, 1, 0.02 + 1.5 * s.sensor_period[k], REASON_INNOVATION)
        if m.flight_phase <= PHASE_MOTORS_RUNNING and nu > 0.0 and z[0] > nearest:
            # On its legs the vehicle is at a known height: the sonar cannot measure ranges below this one.
            m.sonar_effective_min_range = z[0] if m.agreeing_reject_count[k] >= 2 else m.sonar_effective_min_range
            return
        step = m.agreeing_reject_count[k] >= 2 and floor > MIN_TERRAIN_HEIGHT_M
        if step and m.terrain_steps >= MAX_TERRAIN_STEPS:
            # Repeated steps: the height is wrong, not the terrain.
            inflate_variance(m.u_transposed, m.ud_diagonal, ERROR_POSITION + 2, nu * nu, m.u_transposed_h)
            inflate_variance(m.u_transposed, m.ud_diagonal, ERROR_VELOCITY + 2, 0.1, m.u_transposed_h)
            inflate_variance(m.u_transposed, m.ud_diagonal, ERROR_THRUST_SCALE, 0.01, m.u_transposed_h)
            set_fault(m, s, k, STATUS_REJECTED, REASON_RESET, nu)
        elif step and nu > 0.0:
            # No surface lies below the floor.
            _reset_height(m, s, nu)
            set_fault(m, s, k, STATUS_FUSED, REASON_TERRAIN_SLOPE, nu)
        elif step:
            inflate_variance(m.u_transposed, m.ud_diagonal, ERROR_TERRAIN, nu * nu, m.u_transposed_h)
            m.reject_score[k] = 0.0
            set_fault(m, s, k, STATUS_FUSED, REASON_TERRAIN_STEP, floor)
            m.terrain_edge_weight = 1.0
        elif reset_timeout_expired(m, s, k):
            if (m.tick - m.last_fused_tick[READING_POSITION_FIX]) * s.dt < RESET_TIMEOUT_S and m.last_fused_tick[
                READING_POSITION_FIX
            ] > 0:
                inflate_variance(
                    m.u_transposed, m.ud_diagonal, ERROR_TERRAIN, nu * nu, m.u_transposed_h
                )  # the fix holds the height
            else:
                inflate_variance(m.u_transposed, m.ud_diagonal, ERROR_POSITION + 2, nu * nu, m.u_transposed_h)
                inflate_variance(m.u_transposed, m.ud_diagonal, ERROR_VELOCITY + 2, 0.1 + nu * nu, m.u_transposed_h)
            set_fault(m, s, k, STATUS_REJECTED, REASON_RESET, nu)
        else:
            if m.agreeing_reject_count[k] >= 2:
                set_fault(m, s, k, STATUS_REJECTED, REASON_INNOVATION, nu)  # a consistent range below the room's floor
            return
        _sonar_h_row(m, s, r)
    fuse_scalar(m, nu, r_)
    mark_fused(m, k)


@cached_njit(error_model="numpy")
def reset_terrain(m: FilterMemory) -> None:
    """Reset the terrain to the floor's height."""
    fuse_error_state(m, ERROR_TERRAIN, -m.x[NOMINAL_TERRAIN], 2.5e-5)


@cached_njit(error_model="numpy")
def fuse_liftoff_thrust(m: FilterMemory, lift: float) -> None:
    """Fuse a measurement of the thrust scale at lift-off, where thrust equals weight.

    ``lift`` is the thrust of the model divided by the weight.
    """
    scale = LIFTOFF_THRUST_RATIO / lift
    spread = LIFTOFF_THRUST_SIGMA * scale
    fuse_error_state(m, ERROR_THRUST_SCALE, scale - m.x[NOMINAL_THRUST_SCALE], spread * spread)


@cached_njit(error_model="numpy")
def fuse_ground_contact(m: FilterMemory, s: FilterSettings) -> bool:
    """Correct height and sink rate if the estimated legs are below the surface; return whether they are.

    Below the sonar's minimum range, with less thrust than weight, no other sensor shows that the vehicle stands.
    """
    height = height_above_ground(m.x, s)
    if height >= 0.0:
        return False
    h_row_begin(m, ERROR_POSITION + 2, -1.0)
    if m.x[NOMINAL_TERRAIN] > 0.0:
        h_row_add(m, ERROR_TERRAIN, -1.0)
    fuse_scalar(m, -height, 2.5e-5)
    if m.x[NOMINAL_VELOCITY + 2] > 0.0:
        fuse_error_state(m, ERROR_VELOCITY + 2, -m.x[NOMINAL_VELOCITY + 2], 1e-3)
    return True


@cached_njit(error_model="numpy")
def fuse_wall_ranges(m: FilterMemory, s: FilterSettings, z: _Array, ahead: float, r: _Array, most: int) -> bool:
    """Fuse distances to the walls of the room, at most ``most`` beams at a time; return whether all are fused.

    The error of a beam is mostly constant (docs/explanation/estimation.md). With the sensitivity h and the variance C
    of the constant error of each beam, the information on a position of variance P is at most J, the sum of h^2 / C
    over the beams. A picture adds only the information lost since the preceding picture, J - 1 / P. Each beam therefore
    has the variance C J / (J - 1 / P) in addition to that of its noise.
    """
    k = READING_RANGE_RING
    rotation_matrix(m.x[NOMINAL_ATTITUDE : NOMINAL_ATTITUDE + 4], r)
    if m.next_beam == 0:
        m.beams_seen = m.beams_fused = 0
        for i in range(2):
            told = m.wall_info_limit[i] * state_variance(m.u_transposed, m.ud_diagonal, ERROR_POSITION + i)
            m.wall_info_fraction[i] = 1.0 - 1.0 / told if told > 1.0 else 0.0
            m.wall_info_limit[i] = 0.0
    last = min(m.next_beam + most, s.beam_count)
    for b in range(m.next_beam, last):
        if not (0.0 < z[b] < 0.995 * s.ring_max_range):
            continue
        m.beams_seen += 1
        n = r[0] * s.beam_directions[b, 0] + r[1] * s.beam_directions[b, 1] + r[2] * s.beam_directions[b, 2]
        e = r[3] * s.beam_directions[b, 0] + r[4] * s.beam_directions[b, 1] + r[5] * s.beam_directions[b, 2]
        d = r[6] * s.beam_directions[b, 0] + r[7] * s.beam_directions[b, 1] + r[8] * s.beam_directions[b, 2]
        best, axis, along = 1e9, -1, 1.0
        for i in range(3):
            u = n if i == 0 else (e if i == 1 else d)
            if abs(u) > 0.3:
                plane = s.wall_planes[2 * i + 1] if u > 0.0 else s.wall_planes[2 * i]
                far = (plane - (m.x[i] + ahead * m.x[NOMINAL_VELOCITY + i])) / u
                if 0.0 < far < best:
                    best, axis, along = far, i, u
        if axis < 0 or axis == 2 or best > 1.1 * s.ring_max_range:
            continue
        # l = (c - p_i) / u_i; they contain no heading, whose error is one more constant: du = t x u
        h = -1.0 / along
        across = h * best * (e if axis == 0 else n) * m.sigma_output[ERROR_ATTITUDE + 2]
        slope = best * best + s.ring_baseline * s.ring_baseline
        lasts = slope * slope * s.ring_constant_variance + across * across
        scatters = slope * best * best
        scatters *= scatters * s.ring_noise_variance
        h_row_begin(m, ERROR_POSITION + axis, h)
        nu = z[b] - best
        ratio = innovation_ratio(m, nu, scatters + lasts)
        if abs(ratio) < _BEAM_INNOVATION_GATE:
            log_innovation(m, k, nu, ratio)
            m.beams_fused += 1
            m.wall_info_limit[axis] += h * h / lasts
            if m.wall_info_fraction[axis] > 0.0:
                apply_correction(m, nu, scatters + lasts / m.wall_info_fraction[axis])
                rotation_matrix(m.x[NOMINAL_ATTITUDE : NOMINAL_ATTITUDE + 4], r)
    m.next_beam = last
    if last < s.beam_count:
        return False
    m.next_beam = 0
    if m.beams_fused > 0:
        mark_fused(m, k)
    elif m.tick >= m.fault_until_tick[k]:
        m.status[k] = STATUS_WAITING
        m.reason[k] = REASON_WALLS_TOO_FAR if m.beams_seen == 0 else REASON_NO_WALL
    return True


@cached_njit(error_model="numpy")
def _reset_aid_bias(m: FilterMemory, s: FilterSettings, k: int, bias: int, nu: float) -> None:
    """Add ``nu``^2, the square of a lasting innovation of reading ``k``, to the variance of its bias state ``bias``.

    The sensor's status becomes rejected, with a reset as the reason.
    """
    inflate_variance(m.u_transposed, m.ud_diagonal, bias, nu * nu, m.u_transposed_h)
    set_fault(m, s, k, STATUS_REJECTED, REASON_RESET, nu)


@cached_njit(error_model="numpy")
def _fuse_drifting_aid(
    m: FilterMemory,
    s: FilterSettings,
    k: int,
    bias: int,
    nu: float,
    variance: float,
    z: _Array,
    count: int,
    near: float,
) -> None:
    """Fuse pressure or magnetic heading (reading ``k``), whose drift is the bias state ``bias``.

    ``nu`` is the innovation. After a second of rejected readings that agree, the bias variance is inflated and the
    reading fused.
    """
    ratio = innovation_ratio(m, nu, variance)
    log_innovation(m, k, nu, ratio)
    estimate_noise(m, AID_PRESSURE if k == READING_PRESSURE else AID_MAGNETIC, ratio)
    if abs(ratio) > INNOVATION_GATE:
        reject_measurement(m, s, k, nu, z, count, near, REASON_INNOVATION)
        if not reset_timeout_expired(m, s, k):
            return
        _reset_aid_bias(m, s, k, bias, nu)
    elif k == READING_PRESSURE:
        # A bias that drifts faster than modelled causes innovations of one sign.
        m.pressure_ratio_lp += 0.2 * (ratio - m.pressure_ratio_lp)
        if abs(m.pressure_ratio_lp) > PRESSURE_MEAN_GATE:
            m.pressure_ratio_lp = 0.0
            _reset_aid_bias(m, s, k, bias, nu)
    fuse_scalar(m, nu, variance)
    mark_fused(m, k)


@cached_njit(error_model="numpy")
def fuse_pressure(m: FilterMemory, s: FilterSettings, z: _Array, ahead: float) -> None:
    """Fuse the measured pressure minus the standard pressure and minus the part that the rotors cause."""
    variance = s.pressure_noise_density * m.noise_scale[AID_PRESSURE]
    h_row_begin(m, ERROR_POSITION + 2, s.pressure_gradient_down)
    h_row_add(m, ERROR_PRESSURE_BIAS, 1.0)
    nu = (
        z[0]
        - s.pressure_gradient_down * (m.x[NOMINAL_POSITION + 2] + ahead * m.x[NOMINAL_VELOCITY + 2])
        - m.x[NOMINAL_PRESSURE_BIAS]
    )
    _fuse_drifting_aid(m, s, READING_PRESSURE, ERROR_PRESSURE_BIAS, nu, variance, z, 1, 10 * math.sqrt(variance))


@cached_njit(error_model="numpy")
def fuse_magnetic_heading(m: FilterMemory, s: FilterSettings, z: _Array, ahead: float, r: _Array) -> None:
    """Fuse the magnetic heading if the field has the earth's horizontal and vertical strength; else report a fault."""
    variance = s.mag_heading_variance * m.noise_scale[AID_MAGNETIC]
    rotation_matrix(m.x[NOMINAL_ATTITUDE : NOMINAL_ATTITUDE + 4], r)
    north = r[0] * z[0] + r[1] * z[1] + r[2] * z[2]
    east = r[3] * z[0] + r[4] * z[1] + r[5] * z[2]
    across = math.sqrt(north * north + east * east) - s.earth_field[0]
    along = r[6] * z[0] + r[7] * z[1] + r[8] * z[2] - s.earth_field[2]
    square = across * across + along * along
    variance_now = s.mag_field_variance + s.mag_current_variance * m.supply_current * m.supply_current
    if square > MAGNETIC_FIELD_GATE * MAGNETIC_FIELD_GATE * variance_now:
        set_fault(m, s, READING_MAGNETIC_FIELD, STATUS_FAULTY, REASON_FIELD_STRENGTH, math.sqrt(square))
        return
    h_row_begin(m, ERROR_ATTITUDE + 2, 1.0)
    h_row_add(m, ERROR_ATTITUDE, -s.earth_field[2] / s.earth_field[0])
    h_row_add(m, ERROR_MAG_BIAS, 1.0)
    nu = wrap_angle(-portable_atan2(east, north) - ahead * m.yaw_rate - m.x[NOMINAL_MAG_BIAS])
    _fuse_drifting_aid(m, s, READING_MAGNETIC_FIELD, ERROR_MAG_BIAS, nu, variance, z, 3, 1e-5)


@cached_njit(error_model="numpy")
def measurement_cost(m: FilterMemory, s: FilterSettings, kind: int, left: int) -> int:
    """Return the cost of a measurement in scalar measurements; for the ring, as many beams as ``left`` allows."""
    if kind == READING_POSITION_FIX:
        return FIX_BIAS_STEP_COST if m.fix_bias_tick < m.horizon_tick else FIX_FUSION_COST
    return max(min(s.beam_count - m.next_beam, left), 1) if kind == READING_RANGE_RING else 1


@cached_njit(error_model="numpy")
def fuse_measurement(m: FilterMemory, s: FilterSettings, i: int, r: _Array, cost: int) -> bool:
    """Fuse queued measurement ``i``, as far as the budget ``cost`` permits; return whether all of it is fused."""
    kind, z, ahead = m.queue_sensor[i], m.queue_value[i], m.queue_time_in_period[i]
    if kind == READING_POSITION_FIX and m.fix_bias_tick < m.horizon_tick:
        predict_fix_bias(m, s)
        return False
    if kind == READING_POSITION_FIX:
        fuse_position_fix(m, s, z, ahead)
    elif kind == READING_SONAR:
        fuse_sonar_range(m, s, z, ahead, r)
    elif kind == READING_RANGE_RING:
        return bool(fuse_wall_ranges(m, s, z, ahead, r, cost))
    elif kind == READING_PRESSURE:
        fuse_pressure(m, s, z, ahead)
    else:
        fuse_magnetic_heading(m, s, z, ahead, r)
    return True


@cached_njit(error_model="numpy")
def fuse_accel_residual(m: FilterMemory, s: FilterSettings, r: _Array, count: int, i: int) -> None:
    """Fuse the mean difference of accelerometers and model along axis ``i`` over ``count`` periods."""
    rotation_matrix(m.x[NOMINAL_ATTITUDE : NOMINAL_ATTITUDE + 4], r)
    slope = m.accel_per_air_velocity[i]
    h_row_begin(m, ERROR_ACCEL_BIAS + i, 1.0)
    h_row_add(m, ERROR_THRUST_SCALE, m.accel_per_thrust_scale[i])
    for j in range(3):
        h_row_add(m, ERROR_VELOCITY + j, slope * r[3 * j + i])
    h_row_add(m, ERROR_WIND, -slope * r[i])
    h_row_add(m, ERROR_WIND + 1, -slope * r[3 + i])
    nu = m.accel_mean[i] - m.model_accel_mean[i] - m.x[NOMINAL_ACCEL_BIAS + i]
    r_ = m.accel_residual_density[i] / (count * s.dt)
    known = innovation_variance(
        m.u_transposed, m.ud_diagonal, m.h_state_index, m.h_value, m.h_term_count, m.u_transposed_h
    )
    ratio = nu / math.sqrt(known + r_)
    check_accel_model(m, s, r, height_above_ground(m.x_output, s), nu, r_, known, i)
    if abs(ratio) < INNOVATION_GATE and m.is_accel_distrusted == 0:
        fuse_scalar(m, nu, r_)
    if i == 0 or abs(ratio) > m.max_accel_model_ratio:
        log_innovation(m, READING_ACCELERATION, nu, ratio)
        m.max_accel_model_ratio = abs(ratio)


@cached_njit(error_model="numpy")
def fuse_zero_motion(m: FilterMemory, s: FilterSettings, r: _Array, count: int, mode: int, i: int) -> None:
    """Fuse the motion of a standing vehicle: zero velocity along axis ``i``, zero angular rates, and gravity at rest.

    The rates are fused about axes that the legs hold.

    The torque of running or stopping rotors turns the vehicle on its legs about the mast for seconds. Fused as zero,
    this real rate would become a gyroscope bias, of equal sign at each take-off.
    """
    fuse_error_state(m, ERROR_VELOCITY + i, -m.x[NOMINAL_VELOCITY + i], 4e-4)
    still = mode == PHASE_STANDING
    if mode == PHASE_ROTORS_COASTING or (i == 2 and not still):
        return
    h_row_begin(m, ERROR_GYRO_BIAS + i, 1.0)
    calm = 2.0 * s.rest_gyro_sigma * s.rest_gyro_sigma / count if still else 5e-5
    # Wind may rock the vehicle on its legs: a rate that changes is motion, not bias.
    change = m.gyro_mean[i] - m.gyro_mean_prev[i]
    calm = max(calm, change * change)
    m.gyro_mean_prev[i] = m.gyro_mean[i]
    off = m.gyro_mean[i] - m.x[NOMINAL_GYRO_BIAS + i]
    # With running rotors the vehicle may slide on its legs.
    if still or abs(innovation_ratio(m, off, calm)) < INNOVATION_GATE:
        fuse_scalar(m, off, calm)
    if still and s.is_fitted[READING_ACCELERATION] > 0:
        rotation_matrix(m.x[NOMINAL_ATTITUDE : NOMINAL_ATTITUDE + 4], r)
        # R^T (-g e_D), and d(R^T u) = R^T (u x t)
        h_row_begin(m, ERROR_ACCEL_BIAS + i, 1.0)
        h_row_add(m, ERROR_ATTITUDE, -r[3 + i] * GRAVITY)
        h_row_add(m, ERROR_ATTITUDE + 1, r[i] * GRAVITY)
        nu = m.accel_mean[i] + GRAVITY * r[6 + i] - m.x[NOMINAL_ACCEL_BIAS + i]
        r_ = 2 * s.rest_accel_sigma * s.rest_accel_sigma / count
        if abs(innovation_ratio(m, nu, r_)) < 2 * INNOVATION_GATE:
            fuse_scalar(m, nu, r_)
