"""Flight path reconstruction: consistency of the sensors, their biases and scale factors, and the flight path.

Gyros and accelerometers drive the kinematics of a rigid body, which contain no force, mass or coefficient. Measured
attitude, velocity and position must agree with the result; differences are instrument errors (Klein and Morelli,
*Aircraft System Identification*, 2nd ed., ch. 10: data compatibility; Mulder, Chu, Sridhar, Breeman and Laban 1999,
Prog. Aerospace Sci. 35). Axes: north, east, down; body x forward, y right, z down:

    phi'   = p + (q sin phi + r cos phi) tan theta        v' = R(phi, theta, psi) (a_x, a_y, a_z) + (0, 0, g)
    theta' = q cos phi - r sin phi                        x' = v
    psi'   = (q sin phi + r cos phi) / cos theta

    measured = (1 + lambda) true + b + noise               of each of p, q, r, a_x, a_y, a_z   (eq. 10.9 f.)

with the specific force ``a``, which at rest is (0, 0, -g). Instrument noise drives the states, so the path comes from
a Kalman filter and a smoother (Rauch, Tung and Striebel 1965) on the equations linearised about the previous path, in
three to six iterations. The parameters minimise the filter's innovations (filter-error method, Jategaonkar, ch. 5).
The filter also propagates the sensitivities,

    S-(k+1) = F S+(k) + G dm/dtheta,      d nu/dtheta = -H S-,      S+ = (1 - K H) S-,

for Gauss-Newton steps. Intervals come from :func:`mufly.identify.fit_result.coloured_covariance`, because resampled or
vibrating instruments cause coloured innovations. Prior standard deviations, which matter only for undetermined
parameters, are 0.1 for a scale factor, 0.2 rad/s and 1 m/s^2 for a bias. Noise is first estimated from third
differences. It is then scaled until the innovations match their predicted variance: attitude with gyros, and velocity
and position with accelerometers.

Assumptions: attitude and IMU share axes and clock, the instruments are at the point whose path was measured, gravity
is 9.80665 m/s^2, and the pitch stays within 80 deg. A constant misalignment appears as a bias, a delay as a spurious
scale factor. Inverted signs, wrong units and exchanged axes are detected first and raise an error.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_triangular
from threadpoolctl import threadpool_limits

from mufly.errors import ArgumentError, InputError
from mufly.identify.fit_result import (
    ParameterEstimate,
    coloured_covariance,
    compute_relative_covariance,
    describe_undetermined_combinations,
    tabulate_estimates,
)
from mufly.identify.flight_record import UniformLogTable, low_pass, smooth_signal
from mufly.identify.record_consistency import SignalFault
from mufly.quantities.units import GRAVITY
from mufly.results import ResultColumn, ShownBlock, make_lines_block, result, tabulate_results
from mufly.rotations import body_to_ned_matrices

Array = NDArray[np.float64]

IMU_CHANNELS = ("p", "q", "r", "ax", "ay", "az")
FLIGHT_PATH_STATES = ("phi", "theta", "psi", "v_north", "v_east", "v_down", "north", "east", "down")
_PATH_VELOCITY_INDEX, _PATH_POSITION_INDEX = 3, 6
"""First indices of velocity and position in ``FLIGHT_PATH_STATES``, after the attitude."""
_VELOCITY_STATES = FLIGHT_PATH_STATES[_PATH_VELOCITY_INDEX:_PATH_POSITION_INDEX]
_POSITION_STATES = FLIGHT_PATH_STATES[_PATH_POSITION_INDEX:]
STATE_UNITS = (
    dict.fromkeys(FLIGHT_PATH_STATES[:_PATH_VELOCITY_INDEX], "rad")
    | dict.fromkeys(_VELOCITY_STATES, "m/s")
    | dict.fromkeys(_POSITION_STATES, "m")
)
_IMU_FORCE_INDEX = 3
"""First index of the specific force in ``IMU_CHANNELS``, after the rates."""
IMU_ERROR_SYMBOLS = tuple(f"b_{n}" for n in IMU_CHANNELS) + tuple(f"lambda_{n}" for n in IMU_CHANNELS)
_IMU_ERROR_PRIOR_STD = np.array([0.2] * 3 + [1.0] * 3 + [0.1] * 6)
_MIN_OUTPUT_NOISE = {
    "phi": 2e-4,
    "theta": 2e-4,
    "psi": 2e-4,
    "v_north": 2e-3,
    "v_east": 2e-3,
    "v_down": 2e-3,
} | dict.fromkeys(("north", "east", "down"), 2e-4)  # least accepted noise, SI
_MIN_IMU_NOISE = np.array([1e-3] * 3 + [1e-2] * 3)
_MAX_FIT_ITERATIONS, _CONVERGENCE_TOLERANCE = (
    8,
    0.02,
)  # largest number of iterations; last step over the standard deviation
_MAX_PITCH_rad = np.radians(80.0)
_MOTION_BANDWIDTH_HZ = 5.0  # separates vehicle motion (below) from rotor vibration (above)


@result(
    eq=False,
    json="estimates std_white converged undetermined notes outputs residual_rms "
    "innovation_over_expected=innovation_rms noise_std=output_noise imu_noise_std=imu_noise",
)
class ReconstructedPath:
    """Flight path and instrument errors reconstructed from a record.

    Attributes
    ----------
    estimates : tuple of ParameterEstimate
        Biases (in the instrument's unit) and scale factors (1).
    std_white : (12,) array
        Standard deviations for white innovations.
    covariance : (12, 12) array
        Covariance of the estimates, corrected for coloured innovations.
    time_s : (n,) array
    states, states_std : (n, 9) array
        Reconstructed states ``FLIGHT_PATH_STATES`` (SI), and their standard deviations.
    outputs : tuple of str
        Names of the measured states.
    measured : (n, m) array
        Measured states (SI).
    normalised_innovations : (n, m) array
        Measurement less one-sample prediction, over the filter's standard deviation; 1 is consistent.
    imu_noise, output_noise : array
        Standard deviations of the noise (SI).
    corrected : (n, 6) array
        Rates and specific force, corrected for bias and scale factor (SI).
    converged : bool
    undetermined, notes : tuple of str
        Undetermined directions, and notes on the record.
    """

    estimates: tuple[ParameterEstimate, ...]
    std_white: Array
    covariance: Array
    time_s: Array
    states: Array
    states_std: Array
    outputs: tuple[str, ...]
    measured: Array
    normalised_innovations: Array
    imu_noise: Array
    output_noise: Array
    corrected: Array
    converged: bool
    undetermined: tuple[str, ...]
    notes: tuple[str, ...]

    @property
    def residual_rms(self) -> Array:
        """Return the RMS residual of each output, in its SI unit."""
        return np.asarray(np.sqrt(np.mean(self.residual**2, axis=0)))

    @property
    def innovation_rms(self) -> Array:
        """Return the RMS innovation of each output over its predicted standard deviation; 1 if noise is as assumed."""
        return np.asarray(np.sqrt(np.mean(self.normalised_innovations**2, axis=0)))

    @property
    def residual(self) -> Array:
        """Measured outputs less reconstructed outputs (n, m), in SI units."""
        return self.measured - self.states[:, [FLIGHT_PATH_STATES.index(o) for o in self.outputs]]

    def tabulate_path(self) -> dict[str, Array]:
        """Return time, states, their standard deviations and the corrected instruments over time, by name (SI)."""
        table = {"time_s": self.time_s, **dict(zip(FLIGHT_PATH_STATES, self.states.T, strict=True))}
        table |= {f"{n}_std": v for n, v in zip(FLIGHT_PATH_STATES, self.states_std.T, strict=True)}
        return table | {f"{n}_corrected": v for n, v in zip(IMU_CHANNELS, self.corrected.T, strict=True)}

    def make_printed_blocks(self) -> tuple[ShownBlock, ...]:
        """Return instrument errors, residuals of the path and undetermined parameters as printed text."""
        both = zip(self.estimates, self.std_white, strict=True)
        white = {e.symbol: f"{100 * w / abs(e.value):.2g} %" for e, w in both}
        title = "Bias b and scale factor lambda: measured = (1 + lambda) true + b"
        rows = [
            {"residual": r, "noise": s, "innovation": i}
            for r, s, i in zip(self.residual_rms, self.output_noise, self.innovation_rms, strict=True)
        ]
        columns = (
            ResultColumn("residual", form=".2g", head="rms residual"),
            ResultColumn("noise", form=".2g", head="its noise"),
            ResultColumn("innovation", form=".2f", head="innovation over expected"),
        )
        heading = "Parameters that the flight does not determine:"
        return (
            make_lines_block(*self.notes, mark="Note"),
            tabulate_estimates(self.estimates, title, {"std if white": white}),
            tabulate_results(rows, columns, title="The path, SI", names=self.outputs),
            make_lines_block(*([heading] if self.undetermined else ()), *(f"- {w}" for w in self.undetermined)),
            make_lines_block("Converged", style="green")
            if self.converged
            else make_lines_block("NOT converged", style="red"),
        )


def flight_path_derivative(x: Array, m: Array) -> Array:
    """Return the time derivatives (n, 9) of the states ``x`` (n, 9) from body rates and specific force ``m`` (n, 6)."""
    s1, c1 = np.sin(x[:, 0]), np.cos(x[:, 0])
    turn = m[:, 1] * s1 + m[:, 2] * c1
    attitude = np.stack([m[:, 0] + turn * np.tan(x[:, 1]), m[:, 1] * c1 - m[:, 2] * s1, turn / np.cos(x[:, 1])], axis=1)
    force = np.einsum("nij,nj->ni", body_to_ned_matrices(x[:, :_PATH_VELOCITY_INDEX]), m[:, _IMU_FORCE_INDEX:])
    return np.concatenate(
        [attitude, force + np.array([0.0, 0.0, GRAVITY]), x[:, _PATH_VELOCITY_INDEX:_PATH_POSITION_INDEX]], axis=1
    )


def _runge_kutta_step(x: Array, m: Array, dt: float) -> Array:
    """Return the states (n, 9) one time step ``dt`` (s) after the states ``x``, by fourth-order Runge-Kutta.

    The body rates and specific forces ``m`` (n, 6) are constant during the step: means of its two end readings.
    """
    k1 = flight_path_derivative(x, m)
    k2 = flight_path_derivative(x + 0.5 * dt * k1, m)
    k3 = flight_path_derivative(x + 0.5 * dt * k2, m)
    k4 = flight_path_derivative(x + dt * k3, m)
    return x + dt / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4)


def _step_jacobians(x: Array, m: Array, dt: float) -> tuple[Array, Array]:
    """Return the derivatives of an integration step by its states (n, 9, 9) and by the IMU readings (n, 9, 6)."""
    by_x, by_m = np.zeros((len(x), 9, 9)), np.zeros((len(x), 9, 6))
    for k in range(9):
        if k >= _PATH_VELOCITY_INDEX:  # linear: velocity and position
            by_x[:, k, k] = 1.0
            if k < _PATH_POSITION_INDEX:
                by_x[:, k + _PATH_POSITION_INDEX - _PATH_VELOCITY_INDEX, k] = dt
            continue
        step = np.zeros(9)
        step[k] = 1e-5
        by_x[:, :, k] = (_runge_kutta_step(x + step, m, dt) - _runge_kutta_step(x - step, m, dt)) / 2e-5
    for k in range(6):
        step = np.zeros(6)
        step[k] = 1e-4
        by_m[:, :, k] = (_runge_kutta_step(x, m + step, dt) - _runge_kutta_step(x, m - step, dt)) / 2e-4
    return by_x, by_m


def reconstruct_flight_path(
    record: UniformLogTable, imu: Mapping[str, str], outputs: Mapping[str, str]
) -> ReconstructedPath:
    """Reconstruct a flight path, and estimate biases and scale factors of the instruments.

    Parameters
    ----------
    record : UniformLogTable
    imu : dict
        Columns, or sums of columns, of p, q, r (rad/s) and ax, ay, az (m/s^2, specific force); all are required.
    outputs : dict
        Columns of phi, theta, psi (rad), and any of v_north, v_east, v_down (m/s), north, east, down (m).

    Raises
    ------
    InputError
        If an instrument is missing, has evidently another unit, sign or axis, or the pitch exceeds 80 deg.
    """
    for name in IMU_CHANNELS:
        if name not in imu:
            raise ArgumentError("imu", name, "is missing", f"give all of {', '.join(IMU_CHANNELS)}; {name}=COLUMN")
    for name in outputs:
        if name not in FLIGHT_PATH_STATES:
            raise ArgumentError(
                "measured", name, "is not a state of the kinematics", f"use {', '.join(FLIGHT_PATH_STATES)}"
            )
    for name in FLIGHT_PATH_STATES[:3]:
        if name not in outputs:
            raise ArgumentError("measured", name, "is missing", "give phi, theta and psi")
    with threadpool_limits(1, "blas"):  # small matrices: threads cost more than they gain
        return _reconstruct_path(record, imu, outputs)


def _reconstruct_path(record: UniformLogTable, imu: Mapping[str, str], outputs: Mapping[str, str]) -> ReconstructedPath:
    raw = record.stack_columns({n: imu[n] for n in IMU_CHANNELS}, "imu")
    z = record.stack_columns(outputs, "measured")
    outs, dt = tuple(outputs), record.dt
    z[:, outs.index("psi")] = np.unwrap(z[:, outs.index("psi")])
    if np.abs(z[:, outs.index("theta")]).max() > _MAX_PITCH_rad:
        peak = float(np.abs(z[:, outs.index("theta")]).max())
        raise InputError(
            record.name, "theta", f"reaches {peak:.3g} rad; a pitch angle is at most 1.57",
            "convert it to radians, or cut the record",
        )  # fmt: skip
    faults = list(find_sensor_axis_faults(raw, z, outs, dt))
    notes = record.column_notes(imu, outputs) + [f"{f.signal} {f.problem}" for f in faults if not f.is_fatal]
    standing = {o: record.full_column_name(o, "measured") for o, text in outputs.items() if text == o}
    for source, word in (
        ("truth", "the simulation's truth"),
        ("estimated", "the onboard estimate, computed from this IMU"),
    ):
        used = [o for o, column in standing.items() if column.startswith(f"{source}_")]
        if used:
            notes.append(f"{', '.join(used)}: not measured; replaced by {word}")
    for fault in faults:
        if fault.is_fatal:
            raise InputError(record.name, fault.signal, fault.problem, fault.remedy)
    at = [FLIGHT_PATH_STATES.index(o) for o in outs]
    x = _initial_path(z, outs, dt)
    noise = np.array([max(_third_difference_noise(z[:, k]), _MIN_OUTPUT_NOISE[o]) for k, o in enumerate(outs)])
    imu_noise = np.maximum(np.array([_third_difference_noise(raw[:, k]) for k in range(6)]), _MIN_IMU_NOISE)
    theta, converged = np.zeros(12), False
    smooth_x, smooth_p = x, np.zeros((len(x), 9))
    whitened = np.zeros_like(z)
    covariance = bound = np.eye(12)
    size = np.ones(12)
    for turn in range(_MAX_FIT_ITERATIONS):
        true, by_theta = _correct_imu(raw, theta, dt)
        f = _run_kalman_filter(x, true, by_theta, z, at, noise, imu_noise, dt)
        whitened = f.innovations
        covariance, bound, _ = coloured_covariance([f.sensitivities], [whitened], _IMU_ERROR_PRIOR_STD)
        # A variance that the coloured estimate makes too small is raised to the white bound.
        size = np.sqrt(np.maximum(np.diag(covariance), np.diag(bound)))
        information = np.einsum("nmt,nmu->tu", f.sensitivities, f.sensitivities) + np.diag(_IMU_ERROR_PRIOR_STD**-2)
        right = np.einsum("nmt,nm->t", f.sensitivities, whitened) - theta / _IMU_ERROR_PRIOR_STD**2
        change = np.linalg.solve(information, right)
        smooth_x, smooth_p = _run_rts_smoother(x, f)
        x = smooth_x
        theta = theta + change
        # Scaled to the predicted variance; each group keeps its ratio of process to measurement noise.
        ratio = np.sqrt(np.mean(whitened[len(z) // 10 :] ** 2, axis=0))
        for members, driven in (((0, 1, 2), slice(0, 3)), (range(3, 9), slice(3, 6))):
            chosen = [k for k, s in enumerate(at) if s in members]
            if chosen and turn < _MAX_FIT_ITERATIONS - 3:
                scale = float(np.clip(np.sqrt(np.mean(ratio[chosen] ** 2)), 0.3, 3.0))
                noise[chosen] *= scale
                imu_noise[driven] *= scale
        converged = bool((np.abs(change) < _CONVERGENCE_TOLERANCE * size).all())
        if converged and turn >= 3:
            break
    std = size
    if np.any(std > 0.8 * _IMU_ERROR_PRIOR_STD):
        names = ", ".join(
            n for n, s, p in zip(IMU_ERROR_SYMBOLS, std, _IMU_ERROR_PRIOR_STD, strict=True) if s > 0.8 * p
        )
        notes.append(
            f"{names}: the flight hardly determines these parameters, the values are those of the prior; "
            "turn more about these axes"
        )
    estimates = tuple(
        ParameterEstimate.from_std(n, "", unit, 0.0, float(v), float(s), quantile=1.96)
        for n, unit, v, s in zip(IMU_ERROR_SYMBOLS, ["rad/s"] * 3 + ["m/s^2"] * 3 + ["1"] * 6, theta, std, strict=True)
    )
    # Relative to the prior deviations, because the values are near zero.
    undetermined = describe_undetermined_combinations(
        IMU_ERROR_SYMBOLS, compute_relative_covariance(covariance, _IMU_ERROR_PRIOR_STD)
    )
    return ReconstructedPath(
        estimates, np.sqrt(np.diag(bound)), covariance, record.time_s, smooth_x, np.sqrt(smooth_p), outs, z, whitened,
        imu_noise, noise, _correct_imu(raw, theta, dt)[0], converged, undetermined, tuple(notes),
    )  # fmt: skip


def _third_difference_noise(y: Array) -> float:
    """Estimate the standard deviation of white noise from third differences, whose variance is 20 times larger."""
    return 1.4826 * float(np.median(np.abs(np.diff(y, 3)))) / np.sqrt(20.0)


def _correct_imu(raw: Array, theta: Array, dt: float) -> tuple[Array, Array]:
    """Return the IMU readings corrected by biases and scale errors ``theta`` (12,), and their derivatives by ``theta``.

    Shapes are (n, 6) and (n, 6, 12).

    The derivative by a scale factor uses the low-passed reading (method of instrumental variables), because noise on
    both sides of the normal equations would make every scale factor too large.
    """
    offset, scale_error = theta.reshape(2, -1)
    true = (raw - offset) / (1.0 + scale_error)
    slope = np.zeros((len(raw), 6, 12))
    for k in range(6):
        slope[:, k, k] = -1.0 / (1.0 + scale_error[k])
        smooth = low_pass(true[:, k], dt, min(_MOTION_BANDWIDTH_HZ, 0.25 / dt))
        slope[:, k, len(offset) + k] = -smooth / (1.0 + scale_error[k])
    return true, slope


def _initial_path(z: Array, outs: tuple[str, ...], dt: float) -> Array:
    """Return smoothed states from the measurements alone; unmeasured states come from derivatives or are zero."""
    x = np.zeros((len(z), 9))
    for k, name in enumerate(FLIGHT_PATH_STATES):
        if name in outs:
            x[:, k] = smooth_signal(z[:, outs.index(name)], dt)
    for k, (speed, place) in enumerate(zip(_VELOCITY_STATES, _POSITION_STATES, strict=True), _PATH_VELOCITY_INDEX):
        if speed not in outs and place in outs:
            x[:, k] = smooth_signal(z[:, outs.index(place)], dt, 0.3, slope=True)
    return x


@dataclass(frozen=True, eq=False)
class _FilterPass:
    innovations: Array  # (n, m), whitened
    sensitivities: Array  # (n, m, 12), of the predicted outputs, whitened
    predicted_deviation: Array  # (n, 9), deviation from the path of linearisation
    updated_deviation: Array
    predicted_covariance: Array  # (n, 9, 9)
    updated_covariance: Array
    transition_matrix: Array  # (n - 1, 9, 9)


def _run_kalman_filter(
    x: Array, true: Array, by_theta: Array, z: Array, at: list[int], noise: Array, imu_noise: Array, dt: float
) -> _FilterPass:
    n, m = z.shape
    middle = 0.5 * (true[:-1] + true[1:])
    step, drive = _step_jacobians(x[:-1], middle, dt)
    defect = _runge_kutta_step(x[:-1], middle, dt) - x[1:]
    by = np.einsum("nij,njt->nit", drive, 0.5 * (by_theta[:-1] + by_theta[1:]))
    # A step uses the mean of two samples, whose noise has half the variance.
    q = np.einsum("nij,j,nkj->nik", drive, imu_noise**2, drive)
    r, h = np.diag(noise**2), np.zeros((m, 9))
    h[np.arange(m), at] = 1.0
    p = np.diag([0.3**2] * 3 + [3.0**2] * 3 + [3.0**2] * 3)
    dx, s = np.zeros(9), np.zeros((9, 12))
    out = _FilterPass(
        np.zeros((n, m)), np.zeros((n, m, 12)), np.zeros((n, 9)), np.zeros((n, 9)), np.zeros((n, 9, 9)),
        np.zeros((n, 9, 9)), step,
    )  # fmt: skip
    off = z - x[:, at]
    one = np.eye(9)
    for k in range(n):
        if k:
            f = step[k - 1]
            dx, s, p = defect[k - 1] + f @ dx, f @ s + by[k - 1], f @ p @ f.T + q[k - 1]
        out.predicted_deviation[k], out.predicted_covariance[k] = dx, p
        innovation, spread = off[k] - dx[at], p[np.ix_(at, at)] + r
        root = np.linalg.cholesky(spread)
        out.innovations[k] = solve_triangular(root, innovation, lower=True, check_finite=False)
        out.sensitivities[k] = solve_triangular(root, s[at], lower=True, check_finite=False)
        gain = np.linalg.solve(spread, p[at]).T
        dx, s = dx + gain @ innovation, s - gain @ s[at]
        keep = one - gain @ h
        p = keep @ p @ keep.T + gain @ r @ gain.T
        out.updated_deviation[k], out.updated_covariance[k] = dx, p
    return out


def _run_rts_smoother(x: Array, f: _FilterPass) -> tuple[Array, Array]:
    """Return the smoothed path (n, 9) and its variances (n, 9)."""
    n = len(x)
    dx, p = f.updated_deviation[-1], f.updated_covariance[-1]
    path, variance = x.copy(), np.zeros((n, 9))
    path[-1], variance[-1] = x[-1] + dx, np.diag(p)
    for k in range(n - 2, -1, -1):
        back = np.linalg.solve(f.predicted_covariance[k + 1], f.transition_matrix[k] @ f.updated_covariance[k]).T
        dx = f.updated_deviation[k] + back @ (dx - f.predicted_deviation[k + 1])
        p = f.updated_covariance[k] + back @ (p - f.predicted_covariance[k + 1]) @ back.T
        path[k], variance[k] = x[k] + dx, np.maximum(np.diag(p), 0.0)
    return path, variance


def find_sensor_axis_faults(raw: Array, z: Array, outs: tuple[str, ...], dt: float) -> Iterator[SignalFault]:
    """Yield faults of unit, sign and axis of channels that contradict their kinematic prediction from other channels.

    Yields
    ------
    SignalFault
        Fatal if neither a bias nor a scale factor explains it.
    """
    known = {o: z[:, k] for k, o in enumerate(outs)}
    angle = np.column_stack([smooth_signal(known[n], dt) for n in FLIGHT_PATH_STATES[:3]])
    turn = np.column_stack([smooth_signal(known[n], dt, 0.25, slope=True) for n in FLIGHT_PATH_STATES[:3]])
    s1, c1, s2, c2 = np.sin(angle[:, 0]), np.cos(angle[:, 0]), np.sin(angle[:, 1]), np.cos(angle[:, 1])
    p = turn[:, 0] - turn[:, 2] * s2
    q = turn[:, 1] * c1 + turn[:, 2] * c2 * s1
    rates = np.column_stack([p, q, -turn[:, 1] * s1 + turn[:, 2] * c2 * c1])
    seen = np.column_stack([smooth_signal(raw[:, k], dt, 0.25) for k in range(6)])
    yield from _compare_axes(IMU_CHANNELS[:3], seen[:, :3], rates, "the derivative of the attitude", "deg/s")
    for speed, place in zip(_VELOCITY_STATES, _POSITION_STATES, strict=True):
        if speed in known and place in known:
            slope = smooth_signal(known[place], dt, 0.3, slope=True)
            yield from _compare_axes((speed,), known[speed][:, None], slope[:, None], place, "")
    mean = float(np.linalg.norm(raw[:, _IMU_FORCE_INDEX:], axis=1).mean())
    if 0.5 < mean < 2.0:
        what = f"have a mean size of {mean:.3g}: they seem to be in g, not m/s^2"
        yield SignalFault("ax, ay, az", what, "write ax=9.80665*COLUMN")
    elif float(seen[:, -1].mean()) > 0.5 * mean:
        what = f"reads {seen[:, -1].mean():+.3g} m/s^2 on average, where z down reads -9.8"
        yield SignalFault("az", what, "invert its sign: az=-COLUMN")
    elif not 0.7 * GRAVITY < mean < 1.5 * GRAVITY:
        yield SignalFault("ax, ay, az", f"have a mean size of {mean:.3g} m/s^2, not 9.8", "give m/s^2")
    elif all(name in known for name in _VELOCITY_STATES):
        changes = [smooth_signal(known[name], dt, 0.3, slope=True) for name in _VELOCITY_STATES]
        pull = np.column_stack(changes) - [0.0, 0.0, GRAVITY]
        force = np.einsum("nji,nj->ni", body_to_ned_matrices(angle), pull)
        wide = np.column_stack([smooth_signal(column, dt, 0.3) for column in raw[:, _IMU_FORCE_INDEX:].T])
        yield from _compare_axes(IMU_CHANNELS[_IMU_FORCE_INDEX:], wide, force, "the change of velocity", "")


def _compare_axes(names: tuple[str, ...], seen: Array, made: Array, source: str, degrees: str) -> Iterator[SignalFault]:
    a, b = seen - seen.mean(0), made - made.mean(0)
    size_a, size_b = np.maximum(a.std(0), 1e-12), np.maximum(b.std(0), 1e-12)
    correlation = a.T @ b / len(a) / np.outer(size_a, size_b)
    for k, name in enumerate(names):
        own = float(correlation[k, k])
        other = int(np.argmax(np.abs(correlation[k])))
        ratio = float(size_a[k] / size_b[k])
        if abs(own) < 0.6:
            if other != k and abs(correlation[k, other]) > 0.8:
                sign = "-" if correlation[k, other] < 0.0 else ""
                what = f"follows {sign}{names[other]} of {source} (correlation {correlation[k, other]:+.2f})"
                yield SignalFault(name, f"{what}, not its own ({own:+.2f})", "give the column of the right axis")
            else:
                what = f"and {source} hardly agree (correlation {own:+.2f}): too little motion, or a delay"
                yield SignalFault(name, what, "", is_fatal=False)
        elif degrees and 30.0 < ratio < 110.0:
            what = f"is {ratio:.0f} times {source}: it seems to be in {degrees}"
            yield SignalFault(name, what, "write 0.0174533*COLUMN")
        elif own < 0.0:
            what = f"has the opposite sign of {source} (correlation {own:+.2f})"
            yield SignalFault(name, what, f"turn it: {name}=-COLUMN")
        elif not 0.5 < ratio < 2.0:
            yield SignalFault(name, f"is {ratio:.2f} times {source}: another unit?", "", is_fatal=False)
