r"""Camera pose from points of the floor: a two-point RANSAC with known tilt, then least squares over all points.

**Two points and the tilt** (structure of Steder et al. 2008). A ray d through a pixel, rotated by roll and pitch
alone, has the slope m = (d_x + i d_y) / d_z as a complex number. A camera at C (complex, N + i E), at the height h
above the floor and with the heading psi, sees the floor point X along this ray if

    X = C + h e^(i psi) m,      so two points give    h e^(i psi) = (X_1 - X_2) / (m_1 - m_2)

and C = X_1 - h e^(i psi) m_1. Pairs are drawn at random; the pair with the most inliers wins. Pairs whose h disagrees
with the sonar are rejected.

**All points.** The unknowns are C (N, E), h, psi, two small errors u of the tilt, and those of the keyframe. Tilt
errors are rotations about the axes of the heading (x along the nose, y to the right). For each rotor four amplitudes a,
b of its vibration, in its phase W_k, are added. For a row exposed s after the picture's middle, with R(s) = exp([u]) R
exp([w s]) and velocity v,

    c = A^T exp([w s])^T R^T (X - C - v s),    (x, y) = (c_x, c_y) / c_z
    pixel = f (x, y) + (z_x (1 + x^2) + z_y x y, z_x x y + z_y (1 + y^2)),    z = sum_k a_k cos(W_k s) + b_k sin(W_k s)

where A rotates the camera's axes into the body's. Gauss-Newton with Cauchy weights 1 / (1 + (r / 2 sigma)^2) solves
them. Priors are both tilts by filter and map, h by the sonar, and amplitudes by the camera file.

**Effect of the tilt.** A rotation u of a ray of slope m = n + i e moves it, to first order, by

    dn = u_y - n e u_x + n^2 u_y,    de = -u_x - e^2 u_x + n e u_y

The shift u_y, -u_x looks like a motion by h times it; the other terms bend the floor. A keyframe and a picture with the
same tilt error u distort the floor in the same way. If the camera has moved by d (over h, in slopes) between them, the
difference is dm(n + d) - dm(n): for d along n by n' = -d (e u_x - 2 n u_y), e' = d e u_y. A roll error rotates the
picture by u_x d / 2, which looks like a heading change, and shears it by the same amount, which only a tilt error does.
If noise or vibration hides the shear, a constant tilt error makes the heading drift with distance over height. Only the
prior of the tilt bounds this drift. :class:`PoseEstimate` therefore holds the information (8, 8) of the pixels alone on
position, heading, height and both tilts; the map combines it with the tilt prior (:mod:`mufly.slam.pose_graph`). Own
derivation.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mufly.compiled.numba_cache import cached_njit

_Array = NDArray[np.float64]
POSE_HEIGHT, POSE_HEADING, POSE_TILT, POSE_KEYFRAME_TILT, POSE_SIZE = 2, 3, 4, 6, 8
"""Indices of a pose: N, E, h, heading; tilt errors about x and y of the heading, then those of the keyframe."""
SHAKE_COEFFICIENT_COUNT = 8  # for each rotor cosine and sine along x, then along y
_MAX_ITERATIONS = 6
_MIN_HEIGHT_RATIO = 0.1  # of the sonar's height; smaller ones fit any points
_CAUCHY_LOSS_SCALE = 2.0  # residual, in standard deviations, with weight 1/2


class ViewPrior(NamedTuple):
    """Camera parameters and prior knowledge of a picture.

    Attributes
    ----------
    focal_px : float
        Focal length (pixels).
    body_from_camera : (3, 3) array
        Rotation from camera to body axes.
    roll_rad, pitch_rad : float
        Roll and pitch by the vehicle's filter (rad).
    body_rates_rad_s : (3,) array
        p, q, r (rad/s).
    velocity_m_s : (3,) array
        Velocity of the camera, N-E-D (m/s).
    height_m, height_sigma_m : float
        Height of the camera above the floor and its standard deviation (m).
    shake_sigma_px : float
        Standard deviation of a vibration amplitude (pixels); 0: vibration is not estimated.
    rotor_speeds_rad_s : (2,) array
        Speeds of the rotors (rad/s).
    rotor_phases_rad : (2,) array
        Phases at the picture's middle (rad); zero if unknown.
    shake_amplitudes_px : (8,) array
        Expected vibration amplitudes (pixels).
    expected_tilt_error_rad : (2,) array
        Expected errors of roll and pitch (rad).
    """

    focal_px: float
    body_from_camera: _Array
    roll_rad: float
    pitch_rad: float
    body_rates_rad_s: _Array
    velocity_m_s: _Array
    height_m: float
    height_sigma_m: float
    shake_sigma_px: float
    rotor_speeds_rad_s: _Array
    rotor_phases_rad: _Array = np.zeros(2)
    shake_amplitudes_px: _Array = np.zeros(SHAKE_COEFFICIENT_COUNT)
    expected_tilt_error_rad: _Array = np.zeros(2)


@dataclass(frozen=True)
class PoseEstimate:
    """Estimated pose of the camera.

    Attributes
    ----------
    state : (8,) array
        N, E, height, heading, tilt errors about x and y of the heading, deviations of the keyframe's tilt errors from
        their prediction (m, rad).
    shake_amplitudes_px : (8,) array
        Vibration amplitudes (pixels).
    covariance : (8, 8) array
        Covariance of ``state`` with priors.
    pixel_information : (8, 8) array
        Information of the pixels alone on ``state``, with the amplitudes marginalised.
    pixel_gradient : (8,) array
        Gradient of the pixels' cost at ``state``.
    residual_ratio : float
        Ratio of the weighted rms residual to its expected value.
    normalised_residuals : (n,) array
        Residuals over their standard deviations.
    pixel_residuals : (n, 2) array
        Residuals, measured minus predicted (pixels).
    prior_information, prior_gradient : (8, 8), (8,) arrays
        Information of the prediction along directions that the pixels do not show, and its gradient at ``state``.
    """

    state: _Array
    shake_amplitudes_px: _Array
    covariance: _Array
    pixel_information: _Array
    pixel_gradient: _Array
    residual_ratio: float
    normalised_residuals: _Array
    pixel_residuals: _Array
    prior_information: _Array = field(default_factory=lambda: np.zeros((POSE_SIZE, POSE_SIZE)))
    prior_gradient: _Array = field(default_factory=lambda: np.zeros(POSE_SIZE))

    @property
    def inlier_mask(self) -> NDArray[np.bool_]:
        """Mask (n,) of the points whose normalised residual is below three times ``residual_ratio`` (0.7 at least)."""
        return self.normalised_residuals < 3.0 * max(self.residual_ratio, 0.7)

    @property
    def height_m(self) -> float:
        """Height above the floor (m)."""
        return float(self.state[POSE_HEIGHT])

    @property
    def heading_rad(self) -> float:
        """Heading from north to east (rad)."""
        return float(self.state[POSE_HEADING])

    @property
    def tilt_error_rad(self) -> _Array:
        """Tilt error (2,) about the x and y axes of the heading frame (rad)."""
        return self.state[POSE_TILT:POSE_KEYFRAME_TILT]

    @property
    def keyframe_tilt_error_rad(self) -> _Array:
        """Tilt error (2,) of the keyframe about the x and y axes of its own heading frame (rad)."""
        return self.state[POSE_KEYFRAME_TILT:POSE_SIZE]


def attitude_matrix(view: ViewPrior, tilt: _Array | None = None, heading: float = 0.0) -> _Array:
    """Return the rotation matrix from body axes to N-E-D for a heading and tilt error (default: prior mean)."""
    return _compute_tilted_attitude(
        view.roll_rad, view.pitch_rad, heading, *(view.expected_tilt_error_rad if tilt is None else tilt)
    )


def compute_ray_slopes(
    view: ViewPrior, pixels: _Array, seconds: _Array, turn: _Array, shakes: _Array | None = None
) -> NDArray[np.complex128]:
    """Return the slopes (n,) of the rays through pixels (n, 2): horizontal over vertical, as complex numbers.

    Pixels count from the principal point.

    ``seconds`` are the exposure times relative to the picture's middle. ``turn`` is :func:`attitude_matrix` with the
    heading to which slopes refer.
    """
    p = pixels if shakes is None else pixels - vibration_offset(view, pixels, seconds, shakes)
    d = np.column_stack([p / view.focal_px, np.ones(len(p))]) @ view.body_from_camera.T
    d = d + np.cross(seconds[:, None] * view.body_rates_rad_s, d)  # exp([w s]) d, to first order
    w = d @ turn.T
    return np.asarray((w[:, 0] + 1j * w[:, 1]) / w[:, 2], dtype=np.complex128)


def vibration_offset(view: ViewPrior, pixels: _Array, seconds: _Array, shakes: _Array) -> _Array:
    """Return the shift (n, 2) in pixels by the vibration of the camera at these pixels and times."""
    out = np.zeros((len(seconds), 2))
    for k in range(2):
        turned = view.rotor_phases_rad[k] + view.rotor_speeds_rad_s[k] * seconds
        c, s = np.cos(turned), np.sin(turned)
        for axis in (0, 1):
            out[:, axis] += shakes[4 * k + 2 * axis] * c + shakes[4 * k + 2 * axis + 1] * s
    p = pixels / view.focal_px
    return out + p * (p * out).sum(axis=1)[:, None]


def d_rays_d_tilt(slopes: NDArray[np.complex128]) -> _Array:
    """Return the derivatives (n, 2, 2) of ray slopes (N, E) with respect to tilt errors (about N, about E)."""
    n, e = slopes.real, slopes.imag
    return np.stack([np.stack([-n * e, 1.0 + n * n], axis=-1), np.stack([-1.0 - e * e, n * e], axis=-1)], axis=-2)


def solve_pose_by_ransac(
    places: NDArray[np.complex128],
    slopes: NDArray[np.complex128],
    sigma: _Array,
    height: float,
    height_sigma: float,
    rng: np.random.Generator,
    tries: int = 120,
) -> tuple[complex, float, float, NDArray[np.bool_]]:
    """Return camera position C, height h, heading and the inliers, from floor points and the slopes of their rays.

    Parameters
    ----------
    places, slopes : (n,) complex arrays
        Points N + i E (m), and slopes with heading 0.
    sigma : (n,) array
        Standard deviations of the slopes.
    height, height_sigma : float
        Height by the sonar and its standard deviation (m).
    """
    n = len(places)
    first, second = rng.integers(0, n, (2, tries))
    apart = slopes[first] - slopes[second]
    with np.errstate(all="ignore"):
        scale = np.where(np.abs(apart) > 0.05, (places[first] - places[second]) / apart, np.nan)
    h = np.abs(scale)
    # Near the floor, with a relative height error of a quarter or more, zero height would pass.
    may = (np.abs(h - height) < 4.0 * math.hypot(height_sigma, 0.03 * height)) & (h > _MIN_HEIGHT_RATIO * height)
    scale, i = scale[may], first[may]
    if not len(scale):
        return 0j, height, 0.0, np.zeros(n, bool)
    c = places[i] - scale * slopes[i]
    away = np.abs(places[None, :] - c[:, None] - scale[:, None] * slopes[None, :]) / np.abs(scale)[:, None]
    fits = away < 3.0 * np.maximum(sigma, 1e-4)[None, :]
    best = int(np.argmax(fits.sum(axis=1) - 1e-3 * np.minimum(away, 0.05).mean(axis=1)))
    return complex(c[best]), float(abs(scale[best])), float(np.angle(scale[best])), fits[best]


def solve_pose(
    view: ViewPrior, start: _Array, points: _Array, bend: _Array, tilts: _Array, pixels: _Array, seconds: _Array,
    information: _Array, predicted: _Array | None = None,
) -> PoseEstimate:  # fmt: skip
    """Estimate the pose of the camera by robust least squares.

    Parameters
    ----------
    view : ViewPrior
    start : (4,) array
        Initial N, E, height, heading.
    points : (n, 3) array
        N, E, D of the points (m).
    bend : (n, 2, 2) array
        Derivatives of the points along N and E by the keyframe's tilt error (m/rad), :func:`d_rays_d_tilt`.
    tilts : (4, 4) array
        Covariance of the tilt errors of this picture (about their expectation) and of the keyframe.
    pixels : (n, 2) array
        Undistorted pixels from the principal point.
    seconds : (n,) array
        Exposure times relative to the middle of the picture.
    information : (n, 2, 2) array
        Information of the pixels (1/pixel^2); singular where a point has texture along one direction only.
    predicted : (4, 4) array, optional
        Prior information on N, E, height and heading about ``start``, for a floor with texture along one direction.
    """
    shakes = SHAKE_COEFFICIENT_COUNT if view.shake_sigma_px > 0.0 else 0
    size = POSE_SIZE + shakes
    x = np.zeros(size)
    x[:POSE_TILT] = start
    known = np.zeros(size)
    known[:POSE_TILT] = start
    known[POSE_HEIGHT], known[POSE_TILT:POSE_KEYFRAME_TILT] = view.height_m, view.expected_tilt_error_rad
    prior = np.zeros((size, size))
    odometry = np.zeros((POSE_SIZE, POSE_SIZE))
    if predicted is not None:
        odometry[:POSE_TILT, :POSE_TILT] = predicted
    prior[:POSE_SIZE, :POSE_SIZE] += odometry
    prior[POSE_HEIGHT, POSE_HEIGHT] += view.height_sigma_m**-2
    prior[POSE_TILT:POSE_SIZE, POSE_TILT:POSE_SIZE] = np.linalg.inv(tilts)
    if shakes:
        known[POSE_SIZE:] = view.shake_amplitudes_px
        prior[POSE_SIZE:, POSE_SIZE:] = view.shake_sigma_px**-2 * np.eye(shakes)
    x[POSE_TILT:] = known[POSE_TILT:]
    normal, off, weight = np.empty((size, size)), np.empty((len(points), 2)), np.empty(len(points))
    _minimise_residuals(
        x,
        view.focal_px,
        view.body_from_camera,
        view.roll_rad,
        view.pitch_rad,
        view.body_rates_rad_s,
        view.velocity_m_s,
        view.rotor_speeds_rad_s,
        view.rotor_phases_rad,
        known,
        prior,
        points,
        bend,
        pixels,
        seconds,
        information,
        normal,
        off,
        weight,
        _MAX_ITERATIONS,
    )
    square = np.einsum("ni,nij,nj->n", off, information, off)
    trace = information[:, 0, 0] + information[:, 1, 1]
    det = information[:, 0, 0] * information[:, 1, 1] - information[:, 0, 1] ** 2
    numbers = (trace > 0.0).astype(float) + (det > 1e-8 * trace**2)  # that a point measures
    ratio = np.sqrt(square / np.maximum(numbers, 1.0))
    free = max(1.0, float((numbers * weight).sum()) - size)
    # For errors as modelled, the weights reduce the mean square to 0.846 (r^2 / 2 is exponential).
    scale = math.sqrt(float((weight * square).sum()) / free / 0.846)
    loose = max(1.0, scale) ** 2
    # At the minimum the gradient of the pixels balances that of the prior.
    pull = -prior[:POSE_SIZE, :POSE_SIZE] @ (known - x)[:POSE_SIZE]
    seen = normal[:POSE_SIZE, :POSE_SIZE]
    if shakes:
        cross = normal[:POSE_SIZE, POSE_SIZE:]
        seen = seen - cross @ np.linalg.solve(normal[POSE_SIZE:, POSE_SIZE:] + prior[POSE_SIZE:, POSE_SIZE:], cross.T)
    amplitudes = x[POSE_SIZE:] if shakes else np.zeros(SHAKE_COEFFICIENT_COUNT)
    covariance = np.asarray(np.linalg.inv(seen / loose + prior[:POSE_SIZE, :POSE_SIZE]), np.float64)
    return PoseEstimate(
        x[:POSE_SIZE], amplitudes, covariance, seen / loose, pull / loose, scale, ratio, off,
        odometry, odometry @ (known - x)[:POSE_SIZE],
    )  # fmt: skip


def predict_pixels(
    view: ViewPrior, state: _Array, shakes: _Array, points: _Array, bend: _Array, seconds: _Array
) -> _Array:
    """Return the pixels (n, 2), from the principal point, in which a pose (8,) sees points of the floor.

    Arguments are those of :func:`solve_pose`; ``shakes`` (8,) are the vibration amplitudes (pixels).
    """
    size, n = POSE_SIZE + SHAKE_COEFFICIENT_COUNT, len(points)
    off = np.empty((n, 2))
    _minimise_residuals(
        np.concatenate([state, shakes]), view.focal_px, view.body_from_camera, view.roll_rad, view.pitch_rad,
        view.body_rates_rad_s, view.velocity_m_s, view.rotor_speeds_rad_s, view.rotor_phases_rad, np.zeros(size),
        np.zeros((size, size)), points, bend, np.zeros((n, 2)), seconds, np.zeros((n, 2, 2)), np.empty((size, size)),
        off, np.empty(n), 0,
    )  # fmt: skip
    return -off


@cached_njit(error_model="numpy")
def _compute_tilted_attitude(roll: float, pitch: float, heading: float, tilt_x: float, tilt_y: float) -> _Array:
    cr, sr, cp, sp = math.cos(roll), math.sin(roll), math.cos(pitch), math.sin(pitch)
    c, s = math.cos(heading), math.sin(heading)
    tilt_n, tilt_e = c * tilt_x - s * tilt_y, s * tilt_x + c * tilt_y
    r = np.array(
        [
            [cp * c, sr * sp * c - cr * s, cr * sp * c + sr * s],
            [cp * s, sr * sp * s + cr * c, cr * sp * s - sr * c],
            [-sp, sr * cp, cr * cp],
        ]
    )
    # A small rotation (t_n, t_e, 0) on the left, to second order
    out = np.empty((3, 3))
    for j in range(3):
        a, b, d = r[0, j], r[1, j], r[2, j]
        x1, y1, z1 = tilt_e * d, -tilt_n * d, tilt_n * b - tilt_e * a
        x2, y2, z2 = tilt_e * z1, -tilt_n * z1, tilt_n * y1 - tilt_e * x1
        out[0, j], out[1, j], out[2, j] = a + x1 + 0.5 * x2, b + y1 + 0.5 * y2, d + z1 + 0.5 * z2
    return out


@cached_njit(error_model="numpy")
def _minimise_residuals(
    x: _Array,
    focal: float,
    axes: _Array,
    roll: float,
    pitch: float,
    rates: _Array,
    velocity: _Array,
    rotor: _Array,
    phase: _Array,
    known: _Array,
    prior: _Array,
    points: _Array,
    bend: _Array,
    pixels: _Array,
    seconds: _Array,
    information: _Array,
    normal: _Array,
    off: _Array,
    weight: _Array,
    rounds: int,
) -> None:
    size, n = len(x), len(points)
    shakes = size > 8
    row = np.zeros((2, size))
    right = np.empty(size)
    for turn in range(rounds + 1):
        r = _compute_tilted_attitude(roll, pitch, x[POSE_HEADING], x[POSE_TILT], x[POSE_TILT + 1])
        ch, sh = math.cos(x[POSE_HEADING]), math.sin(x[POSE_HEADING])
        tilt_x, tilt_y = x[POSE_KEYFRAME_TILT], x[POSE_KEYFRAME_TILT + 1]
        normal[:] = 0.0
        right[:] = 0.0
        for i in range(n):
            s = seconds[i]
            wn = points[i, 0] + bend[i, 0, 0] * tilt_x + bend[i, 0, 1] * tilt_y - x[0] - velocity[0] * s
            we = points[i, 1] + bend[i, 1, 0] * tilt_x + bend[i, 1, 1] * tilt_y - x[1] - velocity[1] * s
            wd = points[i, 2] + x[POSE_HEIGHT] - velocity[2] * s
            # g = A^T exp([w s])^T R^T, row by row
            q = np.empty(3)
            g = np.empty((3, 3))
            for j in range(3):
                # columns of R^T rotated back by the rates
                b0, b1, b2 = r[j, 0], r[j, 1], r[j, 2]
                e0 = b0 - s * (rates[1] * b2 - rates[2] * b1)
                e1 = b1 - s * (rates[2] * b0 - rates[0] * b2)
                e2 = b2 - s * (rates[0] * b1 - rates[1] * b0)
                for k in range(3):
                    g[k, j] = axes[0, k] * e0 + axes[1, k] * e1 + axes[2, k] * e2
            for k in range(3):
                q[k] = g[k, 0] * wn + g[k, 1] * we + g[k, 2] * wd
            z = max(q[2], 1e-3)
            u, v = q[0] / z, q[1] / z
            for k in range(2):
                ratio = u if k == 0 else v
                fz = focal / z
                # d pixel / d w, with w the vector from camera to point
                a = fz * (g[k, 0] - ratio * g[2, 0])
                b = fz * (g[k, 1] - ratio * g[2, 1])
                c = fz * (g[k, 2] - ratio * g[2, 2])
                row[k, 0], row[k, 1], row[k, POSE_HEIGHT] = -a, -b, c
                # a rotation t of the body: dw = w x t
                row[k, POSE_HEADING] = a * we - b * wn
                about_n, about_e = b * wd - c * we, c * wn - a * wd
                row[k, POSE_TILT] = ch * about_n + sh * about_e
                row[k, POSE_TILT + 1] = ch * about_e - sh * about_n
                row[k, POSE_KEYFRAME_TILT] = a * bend[i, 0, 0] + b * bend[i, 1, 0]
                row[k, POSE_KEYFRAME_TILT + 1] = a * bend[i, 0, 1] + b * bend[i, 1, 1]
            px, py = focal * u, focal * v
            if shakes:
                for k in range(2):
                    co, si = math.cos(phase[k] + rotor[k] * s), math.sin(phase[k] + rotor[k] * s)
                    j, y = POSE_SIZE + 4 * k, POSE_SIZE + 4 * k + 2
                    uu, vv, uv = 1.0 + u * u, 1.0 + v * v, u * v
                    zx, zy = x[j] * co + x[j + 1] * si, x[y] * co + x[y + 1] * si
                    px += zx * uu + zy * uv
                    py += zx * uv + zy * vv
                    row[0, j], row[0, j + 1], row[0, y], row[0, y + 1] = co * uu, si * uu, co * uv, si * uv
                    row[1, j], row[1, j + 1], row[1, y], row[1, y + 1] = co * uv, si * uv, co * vv, si * vv
            off[i, 0], off[i, 1] = pixels[i, 0] - px, pixels[i, 1] - py
            xx, xy, yy = information[i, 0, 0], information[i, 0, 1], information[i, 1, 1]
            force_x, force_y = xx * off[i, 0] + xy * off[i, 1], xy * off[i, 0] + yy * off[i, 1]
            loose = 0.5 * (off[i, 0] * force_x + off[i, 1] * force_y)
            weight[i] = 1.0 / (1.0 + loose / (_CAUCHY_LOSS_SCALE * _CAUCHY_LOSS_SCALE))
            w = weight[i]
            for a_ in range(size):
                hx = w * (xx * row[0, a_] + xy * row[1, a_])
                hy = w * (xy * row[0, a_] + yy * row[1, a_])
                right[a_] += hx * off[i, 0] + hy * off[i, 1]
                for b_ in range(size):
                    normal[a_, b_] += hx * row[0, b_] + hy * row[1, b_]
        if turn == rounds:
            break
        m = normal + prior
        for a_ in range(size):
            m[a_, a_] += 1e-9
            for b_ in range(size):
                right[a_] += prior[a_, b_] * (known[b_] - x[b_])
        step = np.linalg.solve(m, right)
        for a_ in range(size):
            x[a_] += step[a_]
        if abs(step[0]) + abs(step[1]) + abs(step[2]) < 1e-7:
            rounds = turn + 1
