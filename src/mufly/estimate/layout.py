"""What the filter remembers and what it knows of its vehicle, as two flat records: what becomes two structs in C.

Nominal state ``x`` (:data:`STATES`), in SI units:

===== =========================================================================================================
0:3   position N, E, D of the centre of gravity
3:6   velocity N, E, D
6:10  attitude, quaternion w x y z
10:13 bias of the gyroscopes, body axes
13:16 bias of the accelerometers, body axes
16    height of the surface under the sonar above D = 0, up
17:21 what the position fix is off by: N, E, D, heading
21:23 wind N, E
23    scale of the thrust
24    bias of the pressure (Pa)
25    bias of the magnetic heading (rad)
===== =========================================================================================================

Error state: the same less one, as the attitude errs by a small turn about N, E and D (true = exp(turn) believed); order
of :data:`ERROR_STATES`.
"""

from __future__ import annotations

import math
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from mufly.dynamics import GRAVITY, model_parameters, standing_height
from mufly.dynamics.state import hover_speeds
from mufly.sensors import beam_directions, earth_field
from mufly.sensors.ring_camera import MARGIN
from mufly.vehicle import Vehicle
from mufly.vehicle.sensing import LEVEL_RAD, Sensing
from mufly.world import World

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

ERRORS = len(ERROR_STATES)
STATES = ERRORS + 1
# Of the error state
P, V, TURN, GYRO, ACCEL, FLOOR, FIX, HEADING, WIND, THRUST_, PRESSURE_, MAGNET_ = (
    0,
    3,
    6,
    9,
    12,
    15,
    16,
    19,
    20,
    22,
    23,
    24,
)

TURNS = ERRORS - GYRO - 4
"""Periods in which each bias steps once, but for those of the fix, which step with it."""

CHECKED = (
    "acceleration", "rates", "ground_distance", "ranges", "pressure", "magnetic_field", "rotor_speed",
    "position_fix", "battery_voltage",
)  # fmt: skip
"""Readings of the filter, in the order of all its tables."""
WIDTHS = (3, 3, 1, 8, 1, 3, 2, 4, 1)
STARTS = tuple(int(k) for k in np.cumsum([0, *WIDTHS]))
"""Where each reading starts in the row of values of one instant."""
SENSORS = len(CHECKED)
(
    R_ACCELERATION, R_RATES, R_SONAR, R_RING, R_PRESSURE, R_MAGNET, R_ROTOR, R_FIX, R_BATTERY,
) = range(SENSORS)  # fmt: skip
BEAMS = 8
STANDING, RUNNING, LIGHT, FLYING = range(4)
"""On the floor with motors off, with motors on, perhaps just off it, in the air."""
BLOCK_S = 0.02
"""Inputs are averaged over this time (s), and the filter moves on by it: attitude and force of a turn of 2 rad/s are
right to 1e-4 in it."""
KEPT = 40  # blocks of input that are remembered
LAG = 4  # blocks by which the filter may be behind when much has come at once
REACH = KEPT - 2 * LAG  # blocks by which the horizon may be behind now
INPUTS = 22
"""Numbers of a block, means of its periods: rates, felt force, force of the rotors, rest of the model's, its slope over
the velocity through the air, share of the accelerometer, density of the noise (three each); and the mode of its last
period, by which the difference of the two forces can be used or not."""
WAITING = 64  # measurements that wait for the horizon
WORK = 4  # scalar measurements, or what costs as much, for which there is time in a period of 5 ms
TRANSITION = 33  # numbers of :func:`mufly.estimate.motion.transition`
TERMS = 8  # states of which a measurement tells at most
MODELLED = 8  # periods for which forces of the model wait for the slower inertial unit


def memory_type(kind: Any = np.float64, kept: int = KEPT, waiting: int = WAITING) -> np.dtype:
    """Return the type of what the filter remembers, in numbers of this kind, with room for so many blocks of input and
    measurements that wait."""
    n, i4 = ERRORS, np.int32
    return np.dtype([
        # The filter at the horizon
        ("x", kind, (STATES,)), ("ut", kind, (n, n)), ("d", kind, (n,)),
        ("horizon", i4), ("wandered", i4), ("stage", i4), ("beam", i4), ("seen", i4), ("fitting", i4), ("spin", kind),
        ("told_most", kind, (2,)), ("told_share", kind, (2,)),
        # Inputs, by their block modulo KEPT, and those of the last period
        ("inputs", kind, (kept, INPUTS)), ("now", kind, (INPUTS,)), ("tick", i4), ("rates", kind, (3,)),
        # The rotor model: state of the flight model in body axes, forces of the last periods
        ("rotor", kind, (21,)),
        ("acting", kind, (4,)), ("motor_off", kind, (2,)), ("turn_off", kind, (3,)), ("rough", kind),
        ("force", kind, (MODELLED, 12)),
        # Measurements that wait
        ("due", i4, (waiting,)), ("what", i4, (waiting,)), ("value", kind, (waiting, BEAMS)), ("ahead", kind,
        (waiting,)),
        # Scatter of the accelerometers
        ("mean", kind, (3,)), ("before", kind, (3,)), ("blocks", i4), ("scatter", kind, (3,)),
        ("slow", kind, (3,)), ("slow_mean", kind, (3,)), ("slow_last", kind, (3,)), ("slow_blocks", i4),
        ("slow_count", i4), ("clipped", kind, (3,)),
        ("felt", kind, (3,)), ("modelled", kind, (3,)), ("lever", kind, (3, 4)), ("felt_count", i4),
        # Standing
        ("turning", kind, (3,)), ("edge", kind), ("adrift", i4), ("mode", i4), ("low", i4), ("spikes", i4),
        ("shift", kind, (3,)), ("lean", kind), ("wild", i4), ("spike", kind, (3,)), ("steps", i4),
        ("strain", kind), ("disowned", i4), ("drift", kind, (3,)),
        ("drift_sigma", kind, (3,)), ("told", kind, (3,)), ("standing", i4), ("aligned", i4), ("sum", kind,
        (3,)), ("lifted", i4),
        # What is told; angles: roll, pitch, and yaw that does not jump at half a turn
        ("out", kind, (STATES,)), ("out_rates", kind, (3,)), ("angles", kind, (3,)),
        ("out_cov", kind, (9, 9)), ("sigma", kind, (n,)), ("slip", kind, (3,)),
        # On its way from the horizon to now, and what came last
        ("way", kind, (STATES,)), ("way_tick", i4), ("way_sum", kind, (6,)), ("way_span", kind),
        ("come", kind, (STATES,)), ("come_sum", kind, (6,)), ("span", kind),
        # What is thought of each sensor
        ("last", kind, (STARTS[-1],)), ("came", i4, (SENSORS,)),
        ("used", i4, (SENSORS,)),
        ("same", i4, (SENSORS,)), ("rejected", i4, (SENSORS,)), ("since", i4, (SENSORS,)), ("code", i4, (SENSORS,)),
        ("why", i4, (SENSORS,)), ("until", i4, (SENSORS,)),
        ("number", kind, (SENSORS,)), ("innovation", kind, (SENSORS,)), ("spread", kind, (SENSORS,)),
        ("late", i4, (SENSORS,)),
        ("suspect", kind, (SENSORS, 4)), ("agree", i4, (SENSORS,)), ("skip", i4, (SENSORS,)),
        ("doubt", kind, (SENSORS,)), ("silent", i4, (SENSORS,)), ("twice", i4, (SENSORS,)), ("turns", i4, (SENSORS,)),
        # Work
        ("row", kind, (3,)), ("terms", i4), ("at", i4, (TERMS,)), ("h", kind, (TERMS,)), ("f", kind, (n,)),
        ("gain", kind, (n,)),
        # Work of Python alone (in C they are on the stack)
        ("attitude", kind, (9,)), ("push", kind, (6,)), ("transition", kind, (TRANSITION,)), ("q", kind, (9,)),
        ("w", kind, (3, 6)), ("slope", kind, (21,)), ("still", kind, (3,)),
    ], align=True)  # fmt: skip


_NUMBERS: dict[str, Any] = {
    "dt": (), "block": "i", "work": "i", "lag": (), "lag_ticks": "i", "lag_share": (), "delay": "i", "model": "i",
    "swash_settled": (), "swash_mean": (),
    "start": (STATES,), "sigma": (ERRORS,), "keep": (ERRORS,), "noise": (ERRORS,),
    "gyro_density": (), "gyro_off": (2,), "felt_density": (), "model_density": (3,), "felt_range": (), "gyro_range": (),
    "rest_felt": (), "rest_gyro": (), "level": (), "stands": (), "weight": (), "thrust": (2,), "hover": (2,),
    "fitted": "i9", "period": (SENSORS,), "latency": (SENSORS,), "patience": (SENSORS,), "slack": (SENSORS,),
    "noisy": "i9", "bound": (SENSORS,),
    "every": "i9",
    "sonar_place": (3,), "sonar_variance": (), "sonar_step": (), "sonar_cone": (), "sonar_min": (), "sonar_max": (),
    "sonar_arc": (), "sonar_reach": (),
    "fix_variance": (), "heading_variance": (),
    "beams": "i", "beam": (BEAMS, 3), "ring_max": (), "ring_lasts": (), "ring_scatters": (), "ring_baseline": (),
    "walls": (6,),
    "pressure_variance": (), "pressure_slope": (), "pressure_thrust": (2,),
    "magnet_variance": (), "earth": (3,), "rotor_gain": (), "rotor_drift": (), "place": (3,),
}  # fmt: skip


def settings_type(kind: Any = np.float64) -> np.dtype:
    """Return the type of what the filter knows of its vehicle, in numbers of this kind."""
    return np.dtype([
        (name, np.int32 if isinstance(s, str) else kind, ((SENSORS,) if s == "i9" else ()) if isinstance(s, str) else s)
        for name, s in _NUMBERS.items()
    ], align=True)  # fmt: skip


# What is assumed beyond the vehicle's file (docs/estimation.md)
MODEL_FORCE = (0.035, 0.035, 0.035)
"""What the rotor model is off by in flight, one sigma an axis (m/s^2), and for how long together (s)."""
MODEL_TIME_S = 0.1
THRUST_ERROR, THRUST_WALK = 0.3, 0.0055
"""What the model's thrust is off by, one sigma; what it goes on changing by (1/sqrt(s)). Vehicles whose parameters are
10 % off their model have 0.65 to 1.7 of its thrust: the radius counts to the fourth power."""
WIND_SPEED = (0.5, 10.0)
"""Of an axis (m/s), and for how long (s): a mean of 0.5 m/s from anywhere and gusts of 0.3 m/s make 0.46."""
MOTOR_STEP = 1e-3  # what the motors' equations miss between two readings of the speed, of the hover speed
MOTOR_CURRENT = 2.0  # of both motors in a hover (A)
EDGE_S, LOW, SETTLED = 3.0, 0.05, 0.01
"""An edge in the sonar's cone counts for this long (s) where it is not flown over sooner; what is lower is the floor
(m), and known to be once its height is uncertain by more than the last (m)."""
FLOOR_WANDER = 5e-4  # of the way over it (m/sqrt(m)): floors are not quite flat
FLOOR_START = 1e-4  # m: where it stands is D = 0, by definition
PLACE_M = 5.0  # where it stands before anything is heard
TURN_RAD = 2 * math.pi
_LEAST_BEAM = 1e-4  # 1/m: what a wall is off by, 0.1 mm at 1 m, where beams have no error
_TURN_S = 1.5  # turns go the same way for about as long


def filter_settings(
    vehicle: Vehicle, world: World, rate_Hz: float, kind: Any = np.float64, block_s: float = BLOCK_S
) -> np.void:
    """Return what the filter knows of a vehicle: its table ``sensors``, its dimensions, the walls of the room.

    Parameters
    ----------
    vehicle : Vehicle
    world : World
        Of it the room alone.
    rate_Hz : float
        Of the flight software (Hz).
    kind : type
        Of the numbers.
    block_s : float
        Time over which inputs are averaged (s).
    """
    sensing = vehicle.sensors or Sensing()
    s = np.zeros((), settings_type(kind))
    dt = 1.0 / rate_Hz
    p = model_parameters(vehicle)
    sigma, tau = np.zeros(ERRORS), np.full(ERRORS, np.inf)
    walk = np.zeros(ERRORS)  # random walk on top (unit per sqrt(s))
    start = np.zeros(STATES)
    start[6] = start[23] = 1.0
    stands = standing_height(vehicle)
    start[2] = -stands
    sigma[P : P + 2], sigma[P + 2], sigma[V : V + 3] = PLACE_M, 3e-3, 0.01
    level = LEVEL_RAD if sensing.imu is None else float(sensing.imu.level)
    sigma[TURN : TURN + 2], sigma[TURN + 2] = level, math.pi
    sigma[FLOOR], walk[FLOOR] = FLOOR_START, FLOOR_WANDER  # the last times the root of the speed
    sigma[WIND : WIND + 2], tau[WIND : WIND + 2] = WIND_SPEED
    sigma[THRUST_], walk[THRUST_] = THRUST_ERROR, THRUST_WALK
    walk[P : P + 3] = 1e-4
    s["dt"] = dt
    s["stands"], s["weight"], s["level"] = stands, p["mass"] * GRAVITY, level
    s["thrust"] = p["thrust_up"], p["thrust_dw"]
    s["hover"] = hover_speeds(p)
    swash = float(p["swash_rate"]) * dt
    s["swash_settled"], s["swash_mean"] = math.exp(-swash), (1.0 - math.exp(-swash)) / swash
    s["model"], s["model_density"] = 1, 2 * MODEL_TIME_S * np.square(MODEL_FORCE)
    fitted, period, latency, bound = (
        np.zeros(SENSORS),
        np.full(SENSORS, dt),
        np.zeros(SENSORS),
        np.full(SENSORS, 1e9),
    )
    every, noisy, slack = np.ones(SENSORS), np.zeros(SENSORS), np.full(SENSORS, 0.05)
    delay_s = 0.0
    if (imu := sensing.imu) is not None:
        fitted[[R_ACCELERATION, R_RATES]] = 1
        lag = math.sqrt(2.0) / float(imu.bandwidth)  # of a second-order Butterworth filter at low frequencies
        noisy[R_ACCELERATION], noisy[R_RATES] = float(imu.accelerometer_noise) > 0, float(imu.gyro_noise) > 0
        slack[[R_ACCELERATION, R_RATES]] = 1.5 * dt
        s["lag"], s["lag_ticks"], s["lag_share"] = lag, int(lag / dt), lag / dt - int(lag / dt)
        s["place"] = imu.place.array()[0]
        s["gyro_density"], s["felt_density"] = float(imu.gyro_noise) ** 2, float(imu.accelerometer_noise) ** 2
        # Misalignment and scale make a rate of another: noise that grows with the turning
        s["gyro_off"] = 2 * _TURN_S * np.square([float(imu.misalignment), float(imu.scale_error)])
        s["felt_range"], s["gyro_range"] = float(imu.accelerometer_range), float(imu.gyro_range)
        bound[R_ACCELERATION], bound[R_RATES] = 1.2 * s["felt_range"], 1.2 * s["gyro_range"]
        heat = float(imu.warming)
        band = float(imu.bandwidth) / (2 * math.pi)
        # Scale and misalignment of axes that stand level are a bias; so is what gyroscopes feel of gravity.
        off = math.hypot(float(imu.scale_error), float(imu.misalignment)) * GRAVITY
        sigma[ACCEL : ACCEL + 3] = math.hypot(float(imu.accelerometer_bias), off)
        sigma[GYRO : GYRO + 3] = math.hypot(float(imu.gyro_bias), float(imu.gyro_g_sensitivity) * GRAVITY)
        time = float(imu.drift_time)
        for at, drift, warm in (
            (ACCEL, imu.accelerometer_drift, imu.accelerometer_temperature),
            (GYRO, imu.gyro_drift, imu.gyro_temperature),
        ):
            # Wandering, and warming taken as a random walk that reaches as far in the warming's time
            walk[at : at + 3] = math.hypot(
                float(drift) * math.sqrt(2.0 / time),
                0.6 * float(warm) * heat / math.sqrt(float(imu.warming_time)),
            )
        s["rest_felt"] = max(float(imu.accelerometer_noise) * math.sqrt(1.1 * band), 0.02)
        s["rest_gyro"] = max(float(imu.gyro_noise) * math.sqrt(1.1 * band), 1e-4)
    else:
        s["lag_share"] = 0.0
    if (sonar := sensing.sonar) is not None:
        fitted[R_SONAR], period[R_SONAR] = 1, float(sonar.period)
        s["sonar_place"] = sonar.place.array()[0]
        s["sonar_variance"] = float(sonar.noise) ** 2 + float(sonar.resolution) ** 2 / 12 + 1e-6
        s["sonar_step"] = float(sonar.resolution)
        s["sonar_cone"] = math.cos(0.5 * float(sonar.cone))
        # Of an edge that comes into the cone: how much farther than its top it is, and how far ahead
        s["sonar_arc"], s["sonar_reach"] = 1.0 / s["sonar_cone"] - 1.0, math.tan(0.5 * float(sonar.cone))
        s["sonar_min"], s["sonar_max"] = float(sonar.min_range), float(sonar.max_range)
        bound[R_SONAR] = 1.01 * s["sonar_max"]
        latency[R_SONAR] = 2 * float(sonar.max_range) / 340.0
        delay_s = max(delay_s, latency[R_SONAR])
    ring = sensing.ring_camera
    if ring is not None:
        fitted[R_RING], period[R_RING] = 1, float(ring.period)
        directions = beam_directions(vehicle)
        count = min(len(directions), BEAMS)
        pick = beams_used(len(directions))
        s["beams"], s["beam"][:count] = count, directions[pick]
        s["ring_max"], s["ring_baseline"] = float(ring.max_range), float(ring.baseline)
        # An error of so many rows is one of (l^2 + b^2) / b of their angle. What calibration left of a beam lasts.
        # Noise of one in each pixel moves the centroid of a spot by so many rows at 1 m (docs/estimation.md).
        row = MARGIN * math.atan(float(ring.baseline) / float(ring.min_range)) / ring.radial_pixels
        row /= float(ring.baseline)
        blur = float(ring.blur)
        reach = max(1, math.ceil(1.5 * blur))
        columns = math.sqrt(math.sqrt(math.pi) * blur)
        rows = math.sqrt(reach * (reach + 1) * (2 * reach + 1) / 3)
        rows /= float(ring.brightness) * columns * math.sqrt(2 * math.pi) * blur
        s["ring_lasts"] = max(row * float(ring.calibration), _LEAST_BEAM) ** 2
        s["ring_scatters"] = (row * rows) ** 2
        bound[R_RING] = 1.01 * max(float(vehicle.range_ring.max_range), float(ring.max_range))
        noisy[R_RING] = 1
    north, east, up = ((-1e6, 1e6), (-1e6, 1e6), -1e6)
    if world.room is not None:
        north, east = world.room.north, world.room.east
        up = -min(world.room.height, 1e6)
    s["walls"] = (*north, *east, up, 0.0)
    if (air := sensing.pressure) is not None:
        fitted[R_PRESSURE], period[R_PRESSURE], latency[R_PRESSURE] = 1, float(air.period), 0.0
        every[R_PRESSURE] = max(1, round(0.1 / float(air.period)))
        noisy[R_PRESSURE] = float(air.noise) > 0
        s["pressure_variance"] = float(air.noise) ** 2
        density = float(vehicle.air.density)
        s["pressure_slope"] = density * GRAVITY
        area = math.pi * float(vehicle.rotors.radius) ** 2
        s["pressure_thrust"] = float(air.downwash) * np.array([p["thrust_up"], p["thrust_dw"]]) / area
        sigma[PRESSURE_], tau[PRESSURE_] = float(air.drift), float(air.drift_time)
        bound[R_PRESSURE] = 2e5
    if (compass := sensing.magnetometer) is not None:
        fitted[R_MAGNET], period[R_MAGNET] = 1, float(compass.period)
        every[R_MAGNET] = max(1, round(0.1 / float(compass.period)))
        noisy[R_MAGNET] = float(compass.noise) > 0
        s["earth"] = earth_field(float(compass.field), float(compass.inclination))
        field = max(float(s["earth"][0]), 1e-9)
        # Heave control swings the current by half of a hover's, and its field with it
        swing = 0.5 * MOTOR_CURRENT * float(compass.motor_field)
        s["magnet_variance"] = (math.hypot(float(compass.noise), swing) / field) ** 2
        current = float(vehicle.battery.electronics_current) + MOTOR_CURRENT
        wrong = math.hypot(
            float(compass.distortion), float(compass.hard_iron), float(compass.motor_field) * current
        )
        sigma[MAGNET_], tau[MAGNET_] = min(wrong / field, 2.0), float(compass.distortion_length) / 0.3
        bound[R_MAGNET] = 1e-3
    if (rotor := sensing.rotor_speed) is not None:
        fitted[R_ROTOR], period[R_ROTOR] = 1, float(rotor.period)
        noise = float(rotor.noise) / (float(vehicle.motor.back_emf_constant) * float(vehicle.gear.ratio))
        noisy[R_ROTOR] = noise > 0
        # Steady Kalman filter of a random walk of these steps, read with this noise
        s["rotor_gain"] = 2.0 / (1.0 + math.sqrt(1.0 + 4.0 * (noise / (MOTOR_STEP * s["hover"][0])) ** 2))
        # What the equations are off by for long: learnt in some 0.7 s
        s["rotor_drift"] = 0.06 * s["rotor_gain"] ** 2 / float(rotor.period)
        bound[R_ROTOR] = 5 * float(s["hover"].max())
    if sensing.battery is not None:
        fitted[R_BATTERY], period[R_BATTERY] = 1, float(sensing.battery.period)
        bound[R_BATTERY] = 5 * float(vehicle.battery.nominal_voltage)
    if (fix := sensing.position_fix) is not None:
        fitted[R_FIX], period[R_FIX], latency[R_FIX] = 1, float(fix.period), float(fix.latency)
        delay_s = max(delay_s, float(fix.latency))
        s["fix_variance"], s["heading_variance"] = float(fix.noise) ** 2, float(fix.heading_noise) ** 2
        sigma[FIX : FIX + 3], sigma[HEADING] = float(fix.wander), float(fix.heading_wander)
        tau[FIX : FIX + 4] = float(fix.wander_time)
        bound[R_FIX] = 1e4
        noisy[R_FIX] = float(fix.noise) > 0
        slack[R_FIX] = 6 * float(fix.jitter) + dt
    # What moves steps by blocks, what the fix is off by so many of them; of other biases one a period, in turn.
    block = max(1, round(block_s / dt))
    state = np.arange(ERRORS)
    span = np.where((state < GYRO) | ((state >= FIX) & (state <= HEADING)), block * dt, TURNS * dt)
    keep = np.exp(-span / tau)
    s["block"], s["work"] = block, max(WORK, math.ceil(4 * WORK / block))
    s["start"], s["sigma"], s["keep"] = start, sigma, keep
    s["noise"] = sigma**2 * (1 - keep**2) + walk**2 * span
    s["fitted"], s["period"], s["latency"], s["bound"], s["every"] = fitted, period, latency, bound, every
    s["slack"], s["noisy"] = slack, noisy
    s["patience"] = np.maximum(6 * period, 3.5 * dt)
    # What comes later than usual is carried to the horizon; all that is fresher would wait for it.
    s["delay"] = min(round(delay_s / dt), REACH * block)
    return cast(np.void, s[()])


def beams_used(count: int) -> NDArray[np.intp]:
    """Return which beams of a ring the filter looks at: all, or :data:`BEAMS` spread evenly."""
    return np.unique(np.linspace(0, count, min(count, BEAMS), endpoint=False).astype(np.intp))
