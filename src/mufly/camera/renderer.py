"""Rendering of the floor and its boxes as seen by a camera that moves during the exposure.

Row r of the picture is exposed around t_r = t + (r / (h - 1) - 1/2) T_roll for T_exp; its pixels are means over
instants in that time. The camera moves uniformly about its state at the middle of the picture (velocity v, rates w:
R(t + s) = R(t) exp([w s])), and vibrates with the rotors. A pixel's ray d = R (x, y, 1) meets the floor D = 0 at
c + d (-c_D / d_D), boxes by the slab method, and takes the grey level of that point. Then

    I = jpeg(quantised(gain light vignette (blur * (shade grey)) + n))

The vibration of rotor i tilts the camera slightly, so that the picture's middle moves by a_i cos(phi_i(t) + beta_ij)
pixels along its axis j. The amplitude a_i grows with the square of the speed; the phases phi_i are those of the rotors.
Both rotors have equal shares, so that the rms of their sum is the amplitude of the file. The seed draws the directions
beta, for which there is no measurement.

**Low light.** The values of the file are valid at the light level 1. At lower levels the exposure control lengthens the
exposure up to :data:`_MAX_EXPOSURE_FRACTION` of the period and then raises the gain, together by at most the factor 4;
below that level pictures become dark. A longer exposure smears moving pictures. Noise at the gain g and the mean grey
level y follows the data sheets of image sensors (EMVA 1288): read noise grows with g, and the variance of shot noise
with g y,

    n(g, y)^2 = n^2 (s g^2 + (1 - s) g y / y_target),        s = :data:`_READ_NOISE_VARIANCE_FRACTION`.

Own derivation; rolling shutter as in Meingast, Geyer and Sastry 2005.
"""

from __future__ import annotations

import io
import math
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mufly.camera.camera_model import Camera, body_from_camera_rotation, unproject_pixels
from mufly.camera.floor_texture import (
    DETAIL_MAP_PIXEL_M,
    DETAIL_MAP_SIDE_PIXELS,
    SHADOW_MAP_PIXEL_M,
    SHADOW_MAP_SIDE_PIXELS,
    Floor,
)
from mufly.compiled.numba_cache import cached_njit
from mufly.world import Box, World
from mufly.world.obstacles import BOX_CENTRE_INDEX, BOX_HALF_EDGES_INDEX, BOX_HEADING_COS_INDEX, BOX_HEADING_SIN_INDEX

_Array = NDArray[np.float64]
_MOTION_VELOCITY_INDEX, _MOTION_RATES_INDEX, _MOTION_ROTOR_SPEED_INDEX, _MOTION_ROTOR_PHASE_INDEX = 3, 6, 9, 11
"""Indices in the motion array of a picture, after the position."""
_VIBRATION_Y_COLUMN, _BOX_LAST_PIXEL_COLUMN_INDEX = 2, 3
"""Columns of amplitude and phase along y in a rotor's vibration; column of the last pixel column of a box."""
VIDEO_STRIP_ROWS = 16
"""Rows of a picture that are lost together, as with JPEG's blocks."""
_EXPOSURE_SAMPLE_COUNT = 3  # instants per exposure
_NOISE_TABLE_SIZE = 1 << 16
_MAX_DETAILED_FLOOR_HEIGHT_M = 0.6
_TARGET_GREY = 112.0  # mean grey level that the exposure control aims at
_EXPOSURE_TIME_CONSTANT_S = 0.4
_MAX_AMPLIFICATION, _MAX_EXPOSURE_FRACTION, _READ_NOISE_VARIANCE_FRACTION = 4.0, 0.15, 0.5
"""Largest product of the factors of exposure and gain, largest exposure over the period, and fraction of the
variance of the file's noise that is read noise."""


@dataclass(frozen=True)
class VehicleMotion:
    """State of the vehicle at the middle of a picture's exposure.

    Attributes
    ----------
    time_s : float
    position, velocity : (3,) arrays
        N, E, D (m, m/s), of the centre of gravity.
    attitude : (3, 3) array
        Rotation matrix from body axes to N-E-D.
    rates : (3,) array
        p, q, r (rad/s).
    rotor_speed, rotor_phase : (2,) arrays
        Upper, lower (rad/s, rad).
    vibration_scale : float
        Factor on the file's vibration amplitude, 1 at hover speed.
    """

    time_s: float
    position: _Array
    velocity: _Array
    attitude: _Array
    rates: _Array
    rotor_speed: _Array = field(default_factory=lambda: np.zeros(2))
    rotor_phase: _Array = field(default_factory=lambda: np.zeros(2))
    vibration_scale: float = 1.0


class Renderer:
    """Renderer of pictures of a floor.

    Parameters
    ----------
    camera : Camera
    floor : Floor
    world : World
        Source of the boxes on the floor.
    seed : int
        Seed of noise, losses and vibration directions.
    own_shadow : float
        Share of the light that the vehicle's shadow removes, 0 to 1.
    perfect : bool
        Geometry only: no noise, blur, vignette, JPEG, vibration or losses; a global shutter with zero exposure.
    """

    def __init__(
        self,
        camera: Camera,
        floor: Floor,
        world: World | None = None,
        *,
        seed: int = 0,
        own_shadow: float = 0.25,
        perfect: bool = False,
    ) -> None:
        self.camera, self.floor = camera, floor
        self._rng = np.random.default_rng(seed)
        s, q = camera.sensor, camera.quality
        row, column = np.mgrid[: s.height, : s.width].astype(np.float64)
        pixels = np.stack([column, row], axis=-1)
        self._rays = np.ascontiguousarray(unproject_pixels(camera, pixels)).astype(np.float32)
        self._mount, self._turn = camera.mount.place.to_array()[0], body_from_camera_rotation(camera)
        self._texture, self._table = floor.packed_mip_levels
        self._boxes = _pack_boxes(world.boxes if world else ())
        middle = np.array([(s.width - 1) / 2, (s.height - 1) / 2])
        off = ((pixels - middle) ** 2).sum(axis=-1) / (middle**2).sum()
        self._perfect = perfect
        self._vignette = (1.0 - (0.0 if perfect else float(q.vignette)) * off).astype(np.float32)
        self._kernel = _gaussian_kernel(0.0 if perfect else float(q.blur))
        self._noise = 0.0 if perfect else float(q.noise)
        self._normals = self._rng.standard_normal(_NOISE_TABLE_SIZE, dtype=np.float32)
        # Amplitude along each picture axis and its phase, one row per rotor: a random ellipse.
        amplitude = 0.0 if perfect else float(q.shaking) / math.sqrt(2.0)
        share = self._rng.uniform(0.15 * math.pi, 0.35 * math.pi, 2)
        self._shake = np.stack(
            [amplitude * math.sqrt(2.0) * np.cos(share), self._rng.uniform(0, 2 * math.pi, 2),
             amplitude * math.sqrt(2.0) * np.sin(share), self._rng.uniform(0, 2 * math.pi, 2)], axis=1
        )  # fmt: skip
        self._own_shadow = 0.0 if perfect else own_shadow
        self._gain, self._last_s = 1.0, math.nan
        self._exposure_factor = self._sensor_gain = 1.0
        self._before: NDArray[np.uint8] | None = None
        self._out = np.empty((s.height, s.width), np.float32)
        self._work = np.empty_like(self._out)

    def render_picture(self, motion: VehicleMotion, light: float = 1.0) -> NDArray[np.uint8]:
        """Return the picture (rows, columns), uint8.

        Parameters
        ----------
        motion : VehicleMotion
        light : float
            Light of the room over the light for which the camera's file is valid; the exposure follows a change within
            half a second.
        """
        s, shutter, q = self.camera.sensor, self.camera.shutter, self.camera.quality
        if self._perfect:
            readout, exposure = 0.0, 0.0
        else:
            readout, exposure = float(shutter.readout), float(shutter.exposure) * self._exposure_factor
        place = np.concatenate([motion.position, motion.velocity, motion.rates, motion.rotor_speed, motion.rotor_phase])
        height = max(1e-3, -float(motion.position[2]))
        footprint = height / float(self.camera.lens.focal_x) / self.floor.pixel_size_m[0]
        level = min(max(0, round(math.log2(max(footprint, 1e-9)))), len(self._table) - 1)
        shake = self._shake * np.array([motion.vibration_scale, 1.0, motion.vibration_scale, 1.0])
        shake[:, 0] /= float(self.camera.lens.focal_x)
        shake[:, 2] /= float(self.camera.lens.focal_y)
        seen = self._box_pixel_bounds(motion)
        _render_irradiance(
            self._out,
            self._rays,
            self._turn,
            self._mount,
            motion.attitude,
            place,
            shake,
            readout,
            exposure,
            1 if exposure <= 0.0 else _EXPOSURE_SAMPLE_COUNT,
            self._texture,
            self._table,
            level,
            np.array(self.floor.pixel_size_m),
            self.floor.detail_map,
            min(1.0, max(0.0, _MAX_DETAILED_FLOOR_HEIGHT_M / height - 1.0)),
            self.floor.shadow_map,
            self._own_shadow,
            self._boxes,
            seen,
        )
        if len(self._kernel) > 1:
            _blur_in_place(self._out, self._work, self._kernel)
        is_first = math.isnan(self._last_s)
        self._adapt_exposure(motion.time_s, light)
        if is_first and self._exposure_factor > 1.0:  # the control has settled before the first picture
            return self.render_picture(motion, light)
        noise = self._noise * self._noise_factor(light)
        starts = self._rng.integers(0, _NOISE_TABLE_SIZE, s.height)
        picture = np.empty((s.height, s.width), np.uint8)
        _convert_to_grey_levels(picture, self._out, self._vignette, self._gain * light, noise, self._normals, starts)
        if self._perfect:
            return picture
        if q.jpeg:
            picture = decode_grey_picture(encode_jpeg(picture, q.jpeg))
        return self._replace_lost_strips(picture)

    def _adapt_exposure(self, time_s: float, light: float) -> None:
        """Set the exposure: directly for the first picture, then with a first-order lag."""
        mean = float(self._out[::8, ::8].mean()) * light
        wanted = min(_MAX_AMPLIFICATION, max(1.0 / _MAX_AMPLIFICATION, _TARGET_GREY / max(mean, 1e-3)))
        if self._perfect:
            return
        if math.isnan(self._last_s):
            self._gain = wanted
        else:
            share = 1.0 - math.exp(-max(0.0, time_s - self._last_s) / _EXPOSURE_TIME_CONSTANT_S)
            self._gain *= (wanted / self._gain) ** share
        self._last_s = time_s
        self._split_amplification(mean / light if light > 0.0 else 0.0, light)

    def _split_amplification(self, bright_mean: float, light: float) -> None:
        """Set factors of exposure and gain for the required brightness; ``bright_mean`` is the mean grey at light 1."""
        usual = min(_MAX_AMPLIFICATION, max(1.0 / _MAX_AMPLIFICATION, _TARGET_GREY / max(bright_mean, 1e-3)))
        more = max(1.0, self._gain / usual) if light < 1.0 else 1.0
        exposure = float(self.camera.shutter.exposure)
        longest = _MAX_EXPOSURE_FRACTION * float(self.camera.sensor.period) / exposure if exposure > 0.0 else 1.0
        self._exposure_factor = min(more, max(1.0, longest))
        self._sensor_gain = more / self._exposure_factor

    def _noise_factor(self, light: float) -> float:
        """Return the standard deviation of the picture's noise at this light, divided by that in the camera file."""
        if light >= 1.0:
            return 1.0
        level = float(self._out[::8, ::8].mean()) * light * self._gain / _TARGET_GREY
        gain = self._sensor_gain
        return math.sqrt(
            _READ_NOISE_VARIANCE_FRACTION * gain * gain + (1.0 - _READ_NOISE_VARIANCE_FRACTION) * gain * level
        )

    def _replace_lost_strips(self, picture: NDArray[np.uint8]) -> NDArray[np.uint8]:
        """Replace lost strips by the same strips of the previous picture, as a video decoder does."""
        lost = float(self.camera.quality.strips_lost)
        if lost > 0.0:
            for first in range(0, len(picture), VIDEO_STRIP_ROWS):
                if self._rng.uniform() < lost:
                    strip = slice(first, first + VIDEO_STRIP_ROWS)
                    picture[strip] = 128 if self._before is None else self._before[strip]
            self._before = picture.copy()
        return picture

    def _box_pixel_bounds(self, motion: VehicleMotion) -> NDArray[np.int64]:
        """Return the pixel bounds (n, 4) of each box: first, last row; first, last column."""
        s = self.camera.sensor
        out = np.zeros((len(self._boxes), 4), np.int64)
        turn = motion.attitude @ self._turn
        here = motion.position + motion.attitude @ self._mount
        reach = float(np.abs(self._rays).max()) + 0.2
        for k, b in enumerate(self._boxes):
            corners = (
                np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])
                * b[BOX_HALF_EDGES_INDEX:BOX_HEADING_COS_INDEX]
            )
            c, si = b[BOX_HEADING_COS_INDEX], b[BOX_HEADING_SIN_INDEX]
            at = np.stack(
                [
                    c * corners[:, 0] - si * corners[:, 1],
                    si * corners[:, 0] + c * corners[:, 1],
                    corners[:, 2],
                ],
                1,
            )
            p = (at + b[BOX_CENTRE_INDEX:BOX_HALF_EDGES_INDEX] - here) @ turn
            if (p[:, 2] < 0.02).any():
                out[k] = 0, s.height - 1, 0, s.width - 1
                continue
            xy = np.clip(p[:, :2] / p[:, 2:], -2 * reach, 2 * reach)
            # The table of rays gives the rows and columns of distorted rays.
            columns = np.nonzero(
                (self._rays[..., 0].max(0) >= xy[:, 0].min()) & (self._rays[..., 0].min(0) <= xy[:, 0].max())
            )[0]
            rows = np.nonzero(
                (self._rays[..., 1].max(1) >= xy[:, 1].min()) & (self._rays[..., 1].min(1) <= xy[:, 1].max())
            )[0]
            if len(rows) and len(columns):
                out[k] = max(0, rows[0] - 24), rows[-1] + 24, max(0, columns[0] - 24), columns[-1] + 24
            else:
                out[k] = 1, 0, 1, 0
        return out


def encode_jpeg(picture: NDArray[np.uint8], quality: int) -> bytes:
    """Return a picture encoded as JPEG."""
    from PIL import Image

    out = io.BytesIO()
    Image.fromarray(picture).save(out, "JPEG", quality=quality)
    return out.getvalue()


def decode_grey_picture(data: bytes) -> NDArray[np.uint8]:
    """Return the grey picture in the bytes of a file; raise ValueError if there is none."""
    from PIL import Image

    try:
        with Image.open(io.BytesIO(data)) as opened:
            return np.array(opened.convert("L"))
    except (OSError, SyntaxError) as error:
        raise ValueError(f"no picture ({error})") from error


def _gaussian_kernel(sigma: float) -> NDArray[np.float32]:
    if sigma <= 0.0:
        return np.ones(1, np.float32)
    reach = max(1, math.ceil(3 * sigma))
    k = np.exp(-0.5 * (np.arange(-reach, reach + 1) / sigma) ** 2)
    return (k / k.sum()).astype(np.float32)


def _pack_boxes(boxes: tuple[Box, ...]) -> _Array:
    rows = [(*b.centre, *(0.5 * s for s in b.size), math.cos(b.yaw), math.sin(b.yaw)) for b in boxes]
    return np.array(rows, dtype=np.float64).reshape(-1, 8)


_FAST_MATH_OPTIONS: Any = {
    "fastmath": {"nsz", "arcp", "contract", "afn", "reassoc"},
    "error_model": "numpy",
    "nogil": True,
}


@cached_njit(**_FAST_MATH_OPTIONS)
def _sample_texture(texture: NDArray[np.uint8], start: int, rows: int, columns: int, u: float, v: float) -> float:
    """Return the grey level of a mip level at u, v (pixels from the centre of its first pixel), bilinear."""
    i, j = math.floor(u), math.floor(v)
    a, b = u - i, v - j
    i, j = int(i), int(j)
    top, bottom = start + ((i & rows) * (columns + 1)), start + (((i + 1) & rows) * (columns + 1))
    left, right = j & columns, (j + 1) & columns
    return (1.0 - a) * ((1.0 - b) * texture[top + left] + b * texture[top + right]) + a * (
        (1.0 - b) * texture[bottom + left] + b * texture[bottom + right]
    )


@cached_njit(**_FAST_MATH_OPTIONS)
def _sample_periodic_map(a: _Array, n: int, u: float, v: float) -> float:
    """Return the bilinearly interpolated value of a periodic square map (n, n); n a power of two."""
    i, j = math.floor(u), math.floor(v)
    x, y = u - i, v - j
    i, j, m = int(i), int(j), n - 1
    return (1.0 - x) * ((1.0 - y) * a[i & m, j & m] + y * a[i & m, (j + 1) & m]) + x * (
        (1.0 - y) * a[(i + 1) & m, j & m] + y * a[(i + 1) & m, (j + 1) & m]
    )


@cached_njit(**_FAST_MATH_OPTIONS)
def _apply_rotation_vector(turn: _Array, w: _Array, s: float, out: _Array) -> None:
    """Compute out = turn exp([w s]) (Rodrigues)."""
    x, y, z = w[0] * s, w[1] * s, w[2] * s
    angle = math.sqrt(x * x + y * y + z * z)
    a = 1.0 if angle < 1e-9 else math.sin(angle) / angle
    b = 0.5 if angle < 1e-9 else (1.0 - math.cos(angle)) / (angle * angle)
    e00, e01, e02 = 1 - b * (y * y + z * z), b * x * y - a * z, b * x * z + a * y
    e10, e11, e12 = b * x * y + a * z, 1 - b * (x * x + z * z), b * y * z - a * x
    e20, e21, e22 = b * x * z - a * y, b * y * z + a * x, 1 - b * (x * x + y * y)
    for i in range(3):
        p, q, r = turn[i, 0], turn[i, 1], turn[i, 2]
        out[i, 0] = p * e00 + q * e10 + r * e20
        out[i, 1] = p * e01 + q * e11 + r * e21
        out[i, 2] = p * e02 + q * e12 + r * e22


@cached_njit(**_FAST_MATH_OPTIONS)
def _render_irradiance(
    out: _Array,
    rays: _Array,
    axes: _Array,
    mount: _Array,
    attitude: _Array,
    place: _Array,
    shake: _Array,
    readout: float,
    exposure: float,
    samples: int,
    texture: NDArray[np.uint8],
    table: NDArray[np.int64],
    level: int,
    step: _Array,
    detail: _Array,
    near: float,
    shade: _Array,
    own_shadow: float,
    boxes: _Array,
    seen: NDArray[np.int64],
) -> None:
    """Compute the grey levels before lens and sensor effects."""
    high, wide = out.shape
    start, rows, columns = table[level, 0], (1 << table[level, 1]) - 1, (1 << table[level, 2]) - 1
    scale_n, scale_e = 1.0 / (step[0] * (1 << level)), 1.0 / (step[1] * (1 << level))
    body, m, at = np.empty((3, 3)), np.empty((3, 3)), np.empty(3)
    shade_of = np.ones(wide)
    share = 1.0 / samples
    for r in range(high):
        middle = (r / (high - 1.0) - 0.5) * readout
        some = False
        for k in range(len(boxes)):
            some = some or (seen[k, 0] <= r <= seen[k, 1])
        for c in range(wide):
            out[r, c] = 0.0
        for q in range(samples):
            s = middle + ((q + 0.5) * share - 0.5) * exposure
            _apply_rotation_vector(attitude, place[_MOTION_RATES_INDEX:_MOTION_ROTOR_SPEED_INDEX], s, body)
            for i in range(3):
                for j in range(3):
                    m[i, j] = body[i, 0] * axes[0, j] + body[i, 1] * axes[1, j] + body[i, 2] * axes[2, j]
            for i in range(3):
                at[i] = place[i] + place[_MOTION_VELOCITY_INDEX + i] * s
                for j in range(3):
                    at[i] += body[i, j] * mount[j]
            at_n, at_e, at_d = at[0], at[1], at[2]
            shift_x = shift_y = 0.0
            for k in range(2):
                phase = place[_MOTION_ROTOR_PHASE_INDEX + k] + place[_MOTION_ROTOR_SPEED_INDEX + k] * s
                shift_x += shake[k, 0] * math.cos(phase + shake[k, 1])
                shift_y += shake[k, _VIBRATION_Y_COLUMN] * math.cos(phase + shake[k, _VIBRATION_Y_COLUMN + 1])
            for i in range(3):  # small rotation: (x, y, 1) becomes (x - s_x, y - s_y, 1 + s_x x + s_y y)
                a, b, g = m[i, 0], m[i, 1], m[i, 2]
                m[i, 0], m[i, 1], m[i, 2] = a + g * shift_x, b + g * shift_y, g - a * shift_x - b * shift_y
            height = max(-at_d, 1e-4)
            for c in range(wide):
                x, y = rays[r, c, 0], rays[r, c, 1]
                n = m[0, 0] * x + m[0, 1] * y + m[0, 2]
                e = m[1, 0] * x + m[1, 1] * y + m[1, 2]
                d = m[2, 0] * x + m[2, 1] * y + m[2, 2]
                if d < 0.02:
                    out[r, c] += 118.0 * share  # walls are not drawn
                    continue
                far = height / d
                dark, off = 1.0, 0.0
                if some:
                    for k in range(len(boxes)):
                        if seen[k, 0] <= r <= seen[k, 1] and seen[k, 2] <= c <= seen[k, _BOX_LAST_PIXEL_COLUMN_INDEX]:
                            hit, top = _intersect_box(boxes, k, at_n, at_e, at_d, n, e, d)
                            if 0.0 < hit < far:
                                far, dark, off = hit, (1.0 if top else 0.6), 1.7 * (k + 1)
                to_n, to_e = at_n + n * far, at_e + e * far
                grey = _sample_texture(
                    texture, start, rows, columns, (to_n + off) * scale_n - 0.5, (to_e - off) * scale_e - 0.5
                )
                if near > 0.0:
                    grey += near * _sample_periodic_map(
                        detail, DETAIL_MAP_SIDE_PIXELS, to_n / DETAIL_MAP_PIXEL_M, to_e / DETAIL_MAP_PIXEL_M
                    )
                if q == 0:
                    # Light varies slowly over the floor: one sample per pixel suffices.
                    light = _sample_periodic_map(
                        shade, SHADOW_MAP_SIDE_PIXELS, to_n / SHADOW_MAP_PIXEL_M, to_e / SHADOW_MAP_PIXEL_M
                    )
                    if own_shadow > 0.0:
                        a, b = to_n - place[0] + 0.25 * place[2], to_e - place[1] - 0.15 * place[2]
                        soft = 0.03 + 0.15 * height
                        light *= 1.0 - own_shadow / (
                            1.0 + math.exp(min(30.0, (math.sqrt(a * a + b * b) - 0.12) / soft * 3.0))
                        )
                    shade_of[c] = light
                out[r, c] += grey * dark * shade_of[c] * share


@cached_njit(**_FAST_MATH_OPTIONS)
def _intersect_box(
    boxes: _Array, k: int, at_n: float, at_e: float, at_d: float, n: float, e: float, d: float
) -> tuple[float, bool]:
    """Return the distance along the ray to box k (negative: missed), and whether it hits the top face."""
    c, s = boxes[k, BOX_HEADING_COS_INDEX], boxes[k, BOX_HEADING_SIN_INDEX]
    on, oe, od = at_n - boxes[k, 0], at_e - boxes[k, 1], at_d - boxes[k, 2]
    px, py = c * on + s * oe, -s * on + c * oe
    ux, uy = c * n + s * e, -s * n + c * e
    enter, leave, top = -1e9, 1e9, False
    for i in range(3):
        p = px if i == 0 else (py if i == 1 else od)
        u = ux if i == 0 else (uy if i == 1 else d)
        half = boxes[k, BOX_HALF_EDGES_INDEX + i]
        if abs(u) < 1e-12:
            if abs(p) > half:
                return -1.0, False
            continue
        a, b = (-half - p) / u, (half - p) / u
        if a > b:
            a, b = b, a
        if a > enter:
            enter, top = a, i == 2
        leave = min(leave, b)
    return (enter, top) if enter < leave else (-1.0, False)


@cached_njit(**_FAST_MATH_OPTIONS)
def _blur_in_place(a: _Array, work: _Array, kernel: _Array) -> None:
    """Blur in place, rows then columns; edge values are repeated."""
    high, wide = a.shape
    reach = len(kernel) // 2
    for r in range(high):
        for c in range(reach, wide - reach):
            total = np.float32(0.0)
            for k in range(len(kernel)):
                total += kernel[k] * a[r, c + k - reach]
            work[r, c] = total
        for side in range(2):
            for i in range(reach):
                c = i if side == 0 else wide - 1 - i
                total = np.float32(0.0)
                for k in range(len(kernel)):
                    total += kernel[k] * a[r, min(max(c + k - reach, 0), wide - 1)]
                work[r, c] = total
    for r in range(high):
        for c in range(wide):
            a[r, c] = np.float32(0.0)
        for k in range(len(kernel)):
            from_ = min(max(r + k - reach, 0), high - 1)
            w = kernel[k]
            for c in range(wide):
                a[r, c] += w * work[from_, c]


@cached_njit(**_FAST_MATH_OPTIONS)
def _convert_to_grey_levels(
    picture: NDArray[np.uint8],
    a: _Array,
    vignette: _Array,
    gain: float,
    noise: float,
    normals: _Array,
    starts: NDArray[np.int64],
) -> None:
    """Convert light to grey levels, with noise."""
    high, wide = a.shape
    for r in range(high):
        first = starts[r]
        for c in range(wide):
            value = a[r, c] * vignette[r, c] * gain + noise * normals[(first + c) & (_NOISE_TABLE_SIZE - 1)] + 0.5
            picture[r, c] = np.uint8(min(max(value, 0.0), 255.0))
