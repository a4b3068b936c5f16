"""Integrate the flight model by Runge-Kutta with a fixed step, and generate wind with Dryden turbulence.

Batches of vehicles: :mod:`mufly.dynamics.lane_equations`. After every step the attitude quaternion and the bar's normal
are normalised; at the default step the fourth-order method changes their length by about 1e-12 only.

The default step of 1 ms keeps the fastest mode (swash plate, -1000 rad/s) stable with a margin of 2.8, and everything
slower accurate. With Numba's ``error_model="numpy"`` a division by zero gives infinity, which saves a sixth of the
computing time.

Wind has a steady part and Dryden turbulence. Dryden's spectra (MIL-F-8785C) come from white noise through

    longitudinal  H = sigma sqrt(2 T / pi) / (1 + T s)                        T = L / V
    lateral, vertical  H = sigma sqrt(T / pi) (1 + sqrt(3) T s) / (1 + T s)^2

for turbulence of length scale ``L`` convected at speed ``V`` (Taylor's hypothesis). The standard's low-altitude scales
apply to aeroplanes above 10 ft. Eddies in a room have the size of furniture, so ``L`` is a parameter (1 m by default),
and ``V`` is the steady wind speed, at least 0.5 m/s.

The filters are sampled exactly, so the variance is ``sigma^2`` at any time step (own derivation). In the time unit
``T`` the lateral filter for unit variance is

    d/dt (s1, s2) = (s2, -s1 - 2 s2 + 2 n)      gust = (s1 + sqrt(3) s2) / 2      covariance of (s1, s2): identity

and over a step ``h`` the transition matrix is ``F = exp(-h) [[1 + h, h], [-h, 1 - h]]`` with noise of covariance ``Q =
I - F F^T``, computed below without cancellation for small ``h``.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import lru_cache

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike, NDArray
from scipy.signal import lfilter
from scipy.special import gammainc

from mufly.compiled.numba_cache import cached_njit
from mufly.compiled.numba_intrinsics import borrow_arrays
from mufly.drive.drive_train import FULL_FRICTION_SPEED_rad_s
from mufly.dynamics.edgewise_loads import flight_map_rate_bound
from mufly.dynamics.equations_of_motion import bound_map_coefficient, compute_battery_supply, state_derivative
from mufly.dynamics.model_state import (
    ATTITUDE_SLICE,
    BODY_RATE_SLICE,
    INPUT_SIZE,
    MODEL_ATTITUDE,
    MODEL_BAR_NORMAL,
    MODEL_CHARGE,
    MODEL_RATES,
    MODEL_SPEED_UPPER,
    MOTOR_INPUT_SLICE,
    NED_POSITION_SLICE,
    NED_VELOCITY_SLICE,
    ROTOR_SPEED_SLICE,
    SERVO_INPUT_SLICE,
    STATE_SIZE,
    ModelParameters,
    model_parameters,
)
from mufly.errors import InputError
from mufly.quantities.quantity_table import make_labelled_dataset
from mufly.quantities.units import GRAVITY
from mufly.rotations import euler_from_quaternion
from mufly.rotor.validity_checks import VORTEX_RING_DESCENT_RATIOS
from mufly.vehicle import FlightMap, Vehicle, list_builtin_flight_maps, load_flight_map
from mufly.vehicle.vehicle_schema import describe_rotor_differences

_Array = NDArray[np.float64]

DEFAULT_STEP_S = 1e-3


@cached_njit(error_model="numpy")
def normalise_state(x: _Array) -> None:
    """Normalise attitude quaternion and bar's normal in place; raise a negative charge to zero."""
    w, a, b, c = x[MODEL_ATTITUDE], x[MODEL_ATTITUDE + 1], x[MODEL_ATTITUDE + 2], x[MODEL_ATTITUDE + 3]
    q = 1.0 / math.sqrt(w * w + a * a + b * b + c * c)
    for i in range(MODEL_ATTITUDE, MODEL_RATES):
        x[i] *= q
    n, e, d = x[MODEL_BAR_NORMAL], x[MODEL_BAR_NORMAL + 1], x[MODEL_BAR_NORMAL + 2]
    s = 1.0 / math.sqrt(n * n + e * e + d * d)
    for i in range(MODEL_BAR_NORMAL, MODEL_SPEED_UPPER):
        x[i] *= s
    x[MODEL_CHARGE] = max(x[MODEL_CHARGE], 0.0)


_SLOPE_1_ROW, _SLOPE_2_ROW, _SLOPE_3_ROW, _SLOPE_4_ROW, _STAGE_STATE_ROW = range(
    5
)  # rows of the work of a Runge-Kutta step


@cached_njit(error_model="numpy")
def integrate_state(x: _Array, u: _Array, wind: _Array, p: ModelParameters, dt: float, steps: int) -> None:
    """Integrate the state ``x`` in place over ``steps`` steps of ``dt`` with constant input and wind.

    Parameters
    ----------
    x : (21,) array
        State; overwritten.
    u : (4,) array
        Motor upper, motor lower, servo 1, servo 2.
    wind : (3,) array
        N-E-D (m/s).
    p : record of :class:`~mufly.dynamics.ModelParameters`
    dt : float
        Step (s).
    steps : int
    """
    work = np.empty((5, x.shape[0]))
    x, u, wind = borrow_arrays(x), borrow_arrays(u), borrow_arrays(wind)
    k1, k2 = borrow_arrays(work[_SLOPE_1_ROW]), borrow_arrays(work[_SLOPE_2_ROW])
    k3, k4 = borrow_arrays(work[_SLOPE_3_ROW]), borrow_arrays(work[_SLOPE_4_ROW])
    y = borrow_arrays(work[_STAGE_STATE_ROW])
    for _ in range(steps):
        state_derivative(x, u, wind, p, k1)
        for i in range(x.shape[0]):
            y[i] = x[i] + 0.5 * dt * k1[i]
        state_derivative(y, u, wind, p, k2)
        for i in range(x.shape[0]):
            y[i] = x[i] + 0.5 * dt * k2[i]
        state_derivative(y, u, wind, p, k3)
        for i in range(x.shape[0]):
            y[i] = x[i] + dt * k3[i]
        state_derivative(y, u, wind, p, k4)
        for i in range(x.shape[0]):  # from the stage table, which stays allocated until here
            middle = 2.0 * work[_SLOPE_2_ROW, i]
            x[i] += dt / 6.0 * (work[_SLOPE_1_ROW, i] + middle + 2.0 * work[_SLOPE_3_ROW, i] + work[_SLOPE_4_ROW, i])
        normalise_state(x)


def find_longest_stable_step(p: np.void) -> float:
    """Return the longest integration step (s) at which Runge-Kutta is stable for a vehicle.

    The method requires ``step * |lambda| < 2.78`` for every mode. The estimate considers swash plate, bar, motors at
    their greatest speed on the battery, swing under the bar, heave damped by the slope of a coefficient map over climb,
    loads of a flight map, and legs as springs and dampers.

    Parameters
    ----------
    p : record of :class:`~mufly.dynamics.ModelParameters`
    """
    return 2.7 / max(_mode_rates(p).values())


def find_step_limiting_parameter(p: np.void) -> str:
    """Return the key in the vehicle file (``"swash_plate.time_constant"``) of the parameter that limits the step most.

    The limit is that of :func:`find_longest_stable_step`.
    """
    rates = _mode_rates(p)
    return max(rates, key=lambda key: rates[key])


def _mode_rates(p: np.void) -> dict[str, float]:
    """Return the estimated rate (rad/s) of each mode that can limit the step (:func:`find_longest_stable_step`).

    The key of a mode is the vehicle file's parameter with the most influence on it.
    """
    damping = p["kE"] * p["kM"] / p["R_ohm"] + p["dR"] + p["Mf"] / (p["gear_ratio"] * FULL_FRICTION_SPEED_rad_s)
    gear = p["gear_efficiency"] * p["gear_ratio"] ** 2
    speed = float(np.max(p["battery_curve"])) / (p["kE"] * p["gear_ratio"])
    bounds = {name: bound_map_coefficient(p, name) for name in ("thrust_up", "thrust_dw", "torque_up", "torque_dw")}
    motors = [(damping + bounds[f"torque_{k}"][1] * speed / gear) / p[f"J_{k}"] for k in ("up", "dw")]
    up, dw = motors
    thrust = max(bounds["thrust_up"][0], bounds["thrust_dw"][0]) * speed**2
    thrust *= 1.0 + p["ground_effect"] / 3.0  # greatest ground effect
    heave = (bounds["thrust_up"][2] + bounds["thrust_dw"][2]) * speed / p["mass"]
    inplane = 2.0 * p["inplane"] * speed * (1.0 / p["mass"] + p["z_up"] ** 2 / min(p["Ixx"], p["Iyy"]))
    swing = math.sqrt(p["bar_gain"] * thrust * abs(p["z_up"]) / min(p["Ixx"], p["Iyy"]))
    # The legs' tips move with the velocity and with W x r; all of them act about each axis.
    n = p["contact_count"]
    x, y = p["contact_points"][:n, 0], p["contact_points"][:n, 1]
    mobility = max(n / p["mass"], np.sum(y**2) / p["Ixx"], np.sum(x**2) / p["Iyy"])
    return {
        "swash_plate.time_constant": float(p["swash_rate"]),
        "stabiliser_bar.time_constant": float(p["bar_rate"]),
        "rotors.upper.drive_inertia": float(up),
        "rotors.lower.drive_inertia": float(dw),
        "stabiliser_bar.linkage": swing,
        "rotors.inplane_drag": float(inplane),
        "rotors.coefficient_map": float(heave),
        "rotors.flight_map": flight_map_rate_bound(p, float(speed)),
        "contact.stiffness": math.sqrt(p["leg_stiffness"] * mobility),
        "contact.damping": float(p["leg_damping"] * mobility),
    }


def simulate_open_loop(
    vehicle: Vehicle,
    state: ArrayLike,
    inputs: ArrayLike,
    *,
    duration_s: float,
    sample_s: float = 0.01,
    step_s: float = DEFAULT_STEP_S,
    wind: ArrayLike = (0.0, 0.0, 0.0),
    voltage: float | None = None,
) -> xr.Dataset:
    """Simulate the flight model open loop.

    Parameters
    ----------
    vehicle : Vehicle
    state : (21,) array_like
        Initial state; see :func:`mufly.dynamics.initial_state`.
    inputs : (4,) or (n, 4) array_like
        Motor upper, motor lower (0..1), servo 1, servo 2 (-1..1): one constant row, or a row for each sample (the last
        row is held).
    duration_s, sample_s, step_s : float
        Length of the flight, time between samples, integration step (s).
    wind : (3,) or (n, 3) array_like
        Velocity of the air, N-E-D (m/s), constant or for each sample.
    voltage : float, optional
        Constant battery voltage (V).

    Returns
    -------
    xarray.Dataset
        Over ``time``: ``truth_position``, ``truth_velocity``, ``truth_attitude``, ``truth_rates``,
        ``truth_rotor_speed``, ``motor_input``, ``servo_input``, ``battery_voltage``, ``battery_charge``.

    Raises
    ------
    InputError
        If a time is not positive, the step is too long for the vehicle, or an array has the wrong shape.
    """
    for name, value in (("duration_s", duration_s), ("sample_s", sample_s), ("step_s", step_s)):
        if not (math.isfinite(value) and value > 0):
            raise InputError("simulate", name, f"{value} s is out of range", "give a positive time")
    p = model_parameters(vehicle, voltage)
    if min(step_s, sample_s) > find_longest_stable_step(p):
        raise InputError(
            "simulate",
            "step_s",
            f"{min(step_s, sample_s) * 1e3:g} ms is too long for the fastest mode of {vehicle.name}",
            f"give a step below {find_longest_stable_step(p) * 1e3:.3g} ms",
        )
    x = _check_shape(state, (STATE_SIZE,), "state").copy()
    samples = max(1, round(duration_s / sample_s))
    steps = max(1, math.ceil(sample_s / step_s - 1e-9))
    u = _repeat_per_sample(inputs, INPUT_SIZE, samples, "inputs")
    w = _repeat_per_sample(wind, 3, samples, "wind")
    states = np.empty((samples + 1, STATE_SIZE))
    states[0] = x
    for k in range(samples):
        integrate_state(x, u[k], w[k], p, sample_s / steps, steps)
        states[k + 1] = x
    return state_dataset(np.arange(samples + 1, dtype=np.float64) * sample_s, states, np.vstack([u, u[-1:]]), p)


def _check_shape(array: ArrayLike, shape: Sequence[int], name: str) -> NDArray[np.float64]:
    a = np.ascontiguousarray(array, dtype=np.float64)
    if a.shape != tuple(shape):
        raise InputError("simulate", name, f"has shape {a.shape}", f"give shape {tuple(shape)}")
    if not np.all(np.isfinite(a)):
        raise InputError("simulate", name, "contains NaN or infinity", "give finite numbers")
    return a


def _repeat_per_sample(array: ArrayLike, width: int, samples: int, name: str) -> NDArray[np.float64]:
    a = np.atleast_2d(np.asarray(array, dtype=np.float64))
    rows = a[np.minimum(np.arange(samples), len(a) - 1)]
    return _check_shape(rows, (samples, width), name)


def state_dataset(
    time_s: NDArray[np.float64], states: NDArray[np.float64], inputs: NDArray[np.float64], p: np.void
) -> xr.Dataset:
    """Return simulated states as a dataset with the variable names and units of flight recordings.

    Parameters
    ----------
    time_s : (n,) array
    states : (n, 21) array
        States (:mod:`mufly.dynamics.model_state`).
    inputs : (n, 4) array
        Motor upper, motor lower (0..1), servo 1, servo 2 (-1..1).
    p : record of :class:`~mufly.dynamics.ModelParameters`

    Returns
    -------
    xarray.Dataset
        Yaw is continuous over time.
    """
    attitude = euler_from_quaternion(states[:, ATTITUDE_SLICE])
    attitude[:, 2] = np.unwrap(attitude[:, 2])
    duty = np.clip(inputs[:, MOTOR_INPUT_SLICE], 0.0, 1.0)
    voltage = np.array([compute_battery_supply(s, d[0], d[1], p)[0] for s, d in zip(states, duty, strict=True)])

    values = {
        "truth_position": states[:, NED_POSITION_SLICE],
        "truth_velocity": states[:, NED_VELOCITY_SLICE],
        "truth_attitude": attitude,
        "truth_rates": states[:, BODY_RATE_SLICE],
        "truth_rotor_speed": states[:, ROTOR_SPEED_SLICE],
        "motor_input": inputs[:, MOTOR_INPUT_SLICE],
        "servo_input": inputs[:, SERVO_INPUT_SLICE],
        "battery_voltage": voltage,
        "battery_charge": states[:, MODEL_CHARGE],
    }
    return make_labelled_dataset(time_s, values)


_MIN_DRYDEN_WIND_SPEED_M_S = 0.5  # m/s


def dryden_filter(time_constant_s: float, step_s: float) -> tuple[NDArray[np.float64], ...]:
    """Return the matrices of the exactly sampled lateral Dryden filter for unit variance.

    Returns
    -------
    transition : (2, 2) array
        Transition of the filter's state over one step.
    noise : (2, 2) array
        Lower triangular: ``x[k+1] = transition x[k] + noise n[k]`` with unit white ``n``.
    output : (2,) array
        The gust is ``output x``.
    start : (2, 2) array
        ``x[0] = start n`` makes the process stationary from the first sample.
    """
    h = step_s / time_constant_s
    decay = math.exp(-h)
    transition = decay * np.array([[1.0 + h, h], [-h, 1.0 - h]])
    q11 = float(gammainc(3, 2 * h))  # 1 - exp(-2h) (1 + 2h + 2h^2)
    q12 = 2 * h * h * decay**2
    q22 = -math.expm1(-2 * h) + 2 * h * (1 - h) * decay**2
    l11 = math.sqrt(q11)
    l21 = q12 / l11
    noise = np.array([[l11, 0.0], [l21, math.sqrt(q22 - l21 * l21)]])
    return transition, noise, np.array([0.5, math.sqrt(0.75)]), np.eye(2)


_BUILTIN_MAP_MASS_TOLERANCE = 0.02  # of a vehicle that takes the level speed of a built-in flight map
MAX_CONSTANT_COEFFICIENT_INFLOW_CHANGE = 0.1
"""Relative change of the hover inflow up to which constant coefficients are valid."""


def find_model_airspeed_limits(vehicle: Vehicle) -> tuple[float, float, float]:
    """Return the induced velocity in hover, and the air speeds along and across the mast up to which the model holds
    (m/s).

    With both rotors as one disc, ``v_h = sqrt((m g + W_hub) / (2 rho pi R^2))``. In momentum theory at constant thrust
    (Leishman 2006, Secs 2.13 and 2.14) the flow through the disc over ``v_h`` is, at a climb of ``x v_h`` and in an
    edgewise flow of ``y v_h``,

        x/2 + sqrt(x^2/4 + 1)                  sqrt(sqrt(y^4/4 + 1) - y^2/2)

    which differs from one by ``MAX_CONSTANT_COEFFICIENT_INFLOW_CHANGE`` at ``x = 0.19`` and ``y = 0.65``. (For muFly
    that is 0.8 and 2.6 m/s; the thesis relies on its constant coefficients up to 0.5 m/s, Sec. 4.3.1.) A coefficient
    map covers climb and descent up to half of v_h, where the vortex ring state begins. A flight map covers edgewise
    flow up to its last advance ratio. Blow-back limits the level speed, too (:func:`max_level_speed_band`): across the
    mast, the limit is at most the upper end of that band.

    Parameters
    ----------
    vehicle : Vehicle
    """
    area = math.pi * float(vehicle.rotors.radius) ** 2
    weight = float(vehicle.body.mass) * GRAVITY + float(vehicle.body.downwash_drag)
    induced = math.sqrt(weight / (2.0 * float(vehicle.air.density) * area))
    more, less = 1.0 + MAX_CONSTANT_COEFFICIENT_INFLOW_CHANGE, (1.0 - MAX_CONSTANT_COEFFICIENT_INFLOW_CHANGE) ** 2
    along = more - 1.0 / more if vehicle.rotors.coefficient_map is None else VORTEX_RING_DESCENT_RATIOS[0]
    flight_map, band = vehicle.rotors.flight_map, max_level_speed_band(vehicle)
    across = math.sqrt((1.0 - less**2) / less) * induced if flight_map is None else flight_map.velocity_range_m_s[0]
    return induced, along * induced, min(across, math.inf if band is None else band[1])


@lru_cache(maxsize=1)
def _load_builtin_flight_maps() -> tuple[FlightMap, ...]:
    return tuple(load_flight_map(name) for name in list_builtin_flight_maps())


def max_level_speed_band(vehicle: Vehicle) -> tuple[float, float] | None:
    """Return the lower and upper bound (m/s) of the greatest level airspeed; None if they are not known.

    The two bounds differ because the flap frequency of the blades is uncertain.

    The band is part of the vehicle's flight map. Without a flight map, the band is that of the built-in map for the
    vehicle's rotors and mass.

    Parameters
    ----------
    vehicle : Vehicle
    """
    own = vehicle.rotors.flight_map
    if own is not None:
        return own.level_speed_m_s
    for built_in in _load_builtin_flight_maps():
        is_same_mass = abs(built_in.mass_kg / float(vehicle.body.mass) - 1.0) < _BUILTIN_MAP_MASS_TOLERANCE
        if is_same_mass and not describe_rotor_differences(vehicle.rotors, built_in):
            return built_in.level_speed_m_s
    return None


def describe_max_level_speed(vehicle: Vehicle) -> str:
    """Return the bounds of the greatest level airspeed (m/s) as a text; "" if they are not known."""
    band = max_level_speed_band(vehicle)
    if band is None:
        return ""
    return f"level flight ends at {band[0]:.1f} to {band[1]:.1f} m/s (blow-back at full servo, by flap frequency)"


def describe_excess_wind(vehicle: Vehicle, wind: ArrayLike, gust: float) -> str:
    """Return one line about a wind outside the model's range; "" for a wind inside.

    Parameters
    ----------
    vehicle : Vehicle
    wind : (3,) array_like
        Steady wind, N-E-D (m/s).
    gust : float
        Standard deviation of each gust component (m/s); twice this value is added.
    """
    induced, along, across = find_model_airspeed_limits(vehicle)
    north, east, down = (float(v) for v in np.asarray(wind, dtype=np.float64))
    level, rising = math.hypot(north, east) + 2.0 * gust, abs(down) + 2.0 * gust
    if level <= across and rising <= along:
        return ""
    ring = ""
    if -down + 2.0 * gust >= VORTEX_RING_DESCENT_RATIOS[0] * induced:
        state = "vortex ring" if -down <= VORTEX_RING_DESCENT_RATIOS[1] * induced else "windmill"
        rises = f"in air that rises at {-down + 2.0 * gust:.1f} m/s"
        ring = f"; {rises} rotors are in {state} state, which the model does not contain"
    limit = describe_max_level_speed(vehicle)
    return (
        f"the flight model is not valid in this wind, {level:.1f} m/s across and {rising:.1f} m/s along the "
        "mast "
        "with gusts: "
        f"its rotors hold up to {across:.1f} and {along:.1f} m/s{ring}{limit and '; ' + limit}"
    )


class DrydenWind:
    """Steady wind with Dryden turbulence, sampled at constant steps.

    Parameters
    ----------
    steady : (3,) array_like
        Mean wind, N-E-D (m/s).
    gust : float
        Standard deviation of each gust component (m/s); 0 for none.
    step_s : float
        Time between samples (s).
    length_m : float
        Length scale of the turbulence (m).
    seed : int
        Seed of the random numbers.

    Raises
    ------
    InputError
        If a number is negative or not finite.
    """

    def __init__(
        self,
        steady: ArrayLike = (0.0, 0.0, 0.0),
        gust: float = 0.0,
        *,
        step_s: float,
        length_m: float = 1.0,
        seed: int = 0,
    ) -> None:
        self.steady = np.asarray(steady, dtype=np.float64)
        if self.steady.shape != (3,) or not np.all(np.isfinite(self.steady)):
            raise InputError("wind", "steady", f"{steady!r}", "give three finite numbers N, E, D in m/s")
        for name, value in (("gust", gust), ("length_m", length_m), ("step_s", step_s)):
            if not math.isfinite(value) or value < 0 or (value == 0 and name != "gust"):
                raise InputError("wind", name, f"{value}", "give a finite number that is not negative")
        if seed < 0:
            raise InputError("wind", "seed", f"{seed}", "give a whole number that is not negative")
        self._gust = gust
        self._rng = np.random.default_rng(seed)
        speed = max(float(np.linalg.norm(self.steady)), _MIN_DRYDEN_WIND_SPEED_M_S)
        T = length_m / speed
        self._decay = math.exp(-step_s / T)
        self._lateral = dryden_filter(T, step_s)
        # Axes of the turbulence: along the mean wind (horizontal), across it, down.
        along = self.steady * [1.0, 1.0, 0.0]
        along = along / np.linalg.norm(along) if np.linalg.norm(along) > 0 else np.array([1.0, 0.0, 0.0])
        self._axes = np.column_stack([along, [-along[1], along[0], 0.0], [0.0, 0.0, 1.0]])
        self._longitudinal_state = self._rng.standard_normal(1)
        self._lateral_state = self._rng.standard_normal(2)
        self._both = self._lateral_state + self._rng.standard_normal(2)

    def draw_wind_samples(self, n: int) -> NDArray[np.float64]:
        """Return the next ``n`` samples of the wind, N-E-D (m/s), shape (n, 3)."""
        if self._gust == 0.0:
            return np.tile(self.steady, (n, 1))
        noise = self._rng.standard_normal((n, 5))
        transition, scale, output, _ = self._lateral
        n0, n1, n2 = np.split(noise, (1, 3), axis=1)
        along = self._filter_samples(self._longitudinal_state, math.sqrt(1.0 - self._decay**2) * n0)
        # s1 + s2 decays with exp(-h) independently and drives s1, so two first-order recursions suffice.
        first, second = scale[0, 0] * n1, scale[1, 0] * n1 + scale[1, 1] * n2
        both = self._filter_samples(self._both, first + second)
        s1 = self._filter_samples(self._lateral_state, transition[0, 1] * both[:n] + first)
        self._longitudinal_state, self._both, self._lateral_state = along[n], both[n], s1[n]
        across = output[0] * s1 + output[1] * (both - s1)
        a, b, c = self._gust * along[:n], self._gust * across[:n, :1], self._gust * across[:n, 1:]
        return self.steady + a * self._axes[:, 0] + b * self._axes[:, 1] + c * self._axes[:, 2]

    def _filter_samples(self, start: NDArray[np.float64], driven: NDArray[np.float64]) -> NDArray[np.float64]:
        """Filter each column by ``y[k+1] = decay y[k] + driven[k]`` from ``y[0] = start``; return all n + 1 rows."""
        rest, _ = lfilter([1.0], [1.0, -self._decay], driven, axis=0, zi=self._decay * start[None])
        return np.vstack([start, rest])
