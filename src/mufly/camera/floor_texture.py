"""Floor textures for the camera: periodic pictures, from rich to featureless.

A floor is a periodic grey picture with a pixel size. It is stored as a pyramid (each pixel the mean of four), so that
detail too fine for a high camera is not aliased. For a camera below half a metre, a finer picture is added. Lighting is
uneven: a fixed map of shadows multiplies the floor.

| kind | content |
|---|---|
| rich | a carpet: noise of all sizes, and shapes of other grey levels |
| poor | concrete: the same noise with a sixth of the contrast, no shapes |
| tiles | identical tiles of 256 mm with joints |
| plain | uniform grey |

The noise is pink: every octave of detail has the same contrast. Own derivation.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mufly.errors import ArgumentError, InputError

FLOOR_KINDS = ("rich", "poor", "tiles", "plain")
FLOOR_PIXEL_SIZE_M = 2e-3
"""Pixel size of the built-in floors (m)."""
DETAIL_MAP_PIXEL_M, DETAIL_MAP_SIDE_PIXELS = 5e-4, 512
SHADOW_MAP_PIXEL_M, SHADOW_MAP_SIDE_PIXELS = 0.04, 256
FLOOR_TILE_SIDE_PIXELS = 128
_FLOOR_MEAN_GREY = 118.0
_CONTRAST_BY_KIND = {"rich": 20.0, "poor": 6.0, "tiles": 20.0, "plain": 0.0}
_DETAIL_CONTRAST_BY_KIND = {"rich": 12.0, "poor": 3.0, "tiles": 8.0, "plain": 0.0}


@dataclass(frozen=True)
class Floor:
    """Texture of a floor.

    Attributes
    ----------
    name : str
    mip_levels : tuple of (n, m) uint8 arrays
        North along the first axis, east along the second; sides are powers of two, each level half of the previous one.
    pixel_size_m : (2,) tuple
        Length of a pixel of the first level along each axis (m).
    detail_map : (512, 512) float32 array
        Detail added at low height (grey levels), :data:`DETAIL_MAP_PIXEL_M` a pixel.
    shadow_map : (256, 256) float32 array
        Share of the light that arrives, :data:`SHADOW_MAP_PIXEL_M` a pixel.
    """

    name: str
    mip_levels: tuple[NDArray[np.uint8], ...]
    pixel_size_m: tuple[float, float]
    detail_map: NDArray[np.float32]
    shadow_map: NDArray[np.float32]

    @property
    def packed_mip_levels(self) -> tuple[NDArray[np.uint8], NDArray[np.int64]]:
        """All mip levels in one array, and each level's first index and the base-2 logarithms of its side lengths."""
        starts = np.cumsum([0, *(level.size for level in self.mip_levels)])
        table = np.array(
            [
                (start, level.shape[0].bit_length() - 1, level.shape[1].bit_length() - 1)
                for start, level in zip(starts, self.mip_levels, strict=False)
            ]
        )
        return np.concatenate([level.ravel() for level in self.mip_levels]), table


def make_random_floor(kind: str = "rich", seed: int = 0, *, size: int = 4096, shadows: float = 0.0) -> Floor:
    """Return a random floor.

    Parameters
    ----------
    kind : str
        One of :data:`FLOOR_KINDS`.
    seed : int
        Same seed, same floor.
    size : int
        Period of the floor in pixels of 2 mm; a power of two.
    shadows : float
        Share of the light that the darkest shadows remove, 0 to 1.
    """
    if kind not in FLOOR_KINDS:
        raise ArgumentError(
            "floor", kind, "is not a kind of floor", f"use one of: {', '.join(FLOOR_KINDS)}, or a picture"
        )
    if size < 128 or size & (size - 1):
        raise ArgumentError("size", str(size), "is not a power of two from 128", "give 1024, 2048 or 4096")
    rng = np.random.default_rng([seed, FLOOR_KINDS.index(kind)])
    n = FLOOR_TILE_SIDE_PIXELS if kind == "tiles" else size
    picture = _FLOOR_MEAN_GREY + _CONTRAST_BY_KIND[kind] * _make_pink_noise(rng, n)
    if kind in ("rich", "tiles"):
        _draw_random_shapes(picture, rng, round(90 * (n * FLOOR_PIXEL_SIZE_M) ** 2))
    if kind == "tiles":
        picture[:2] = picture[:, :2] = 60.0
        picture = np.tile(picture, (size // n, size // n))
    detail = _DETAIL_CONTRAST_BY_KIND[kind] * _make_pink_noise(rng, DETAIL_MAP_SIDE_PIXELS)
    return Floor(
        kind,
        _build_mip_levels(_to_uint8(picture)),
        (FLOOR_PIXEL_SIZE_M, FLOOR_PIXEL_SIZE_M),
        detail.astype(np.float32),
        _make_shadow_map(rng, shadows),
    )


def load_floor_picture(path: str | Path, width_m: float, *, seed: int = 0, shadows: float = 0.0) -> Floor:
    """Return a floor that repeats a user's picture; its top is north.

    Parameters
    ----------
    path : str or Path
        Picture in a format that Pillow reads.
    width_m : float
        Width of the picture, from west to east (m).
    """
    from PIL import Image, UnidentifiedImageError

    if not 0.01 <= width_m <= 1e4:
        raise ArgumentError("floor_width", f"{width_m:g} m", "is out of range", "give 0.01 to 10 000 m")
    try:
        with Image.open(path) as opened:
            picture = opened.convert("L")
    except (OSError, UnidentifiedImageError, ValueError) as error:
        raise InputError(str(path), "", f"is not a picture that can be read ({error})", "give a PNG or JPEG") from error
    height_m = width_m * picture.height / picture.width
    wide, high = (min(8192, max(64, 1 << (n - 1).bit_length())) for n in picture.size)
    grey = np.asarray(picture.resize((wide, high), Image.Resampling.LANCZOS))[::-1]  # rows increase northwards
    nothing = np.zeros((DETAIL_MAP_SIDE_PIXELS, DETAIL_MAP_SIDE_PIXELS), np.float32)
    shade = _make_shadow_map(np.random.default_rng(seed), shadows)
    return Floor(
        str(path),
        _build_mip_levels(np.ascontiguousarray(grey)),
        (height_m / high, width_m / wide),
        nothing,
        shade,
    )


def _to_uint8(a: NDArray[np.floating]) -> NDArray[np.uint8]:
    return np.clip(np.rint(a), 0, 255).astype(np.uint8)


def _double_resolution(a: NDArray[np.float32]) -> NDArray[np.float32]:
    """Double the resolution of a periodic picture by linear interpolation."""
    for axis in (0, 1):
        before, after = np.roll(a, 1, axis), np.roll(a, -1, axis)
        out = np.empty([n * (2 if k == axis else 1) for k, n in enumerate(a.shape)], np.float32)
        even, odd = [slice(None)] * 2, [slice(None)] * 2
        even[axis], odd[axis] = slice(0, None, 2), slice(1, None, 2)
        out[tuple(even)] = 0.25 * before + 0.75 * a
        out[tuple(odd)] = 0.75 * a + 0.25 * after
        a = out
    return a


def _make_pink_noise(rng: np.random.Generator, n: int) -> NDArray[np.float32]:
    """Return periodic pink noise (n, n), mean 0 and standard deviation 1."""
    a = rng.standard_normal((4, 4), dtype=np.float32)
    while len(a) < n:
        a = _double_resolution(a)
        a += 0.8 * rng.standard_normal(a.shape, dtype=np.float32)
    return (a - a.mean()) / a.std()


def _draw_random_shapes(picture: NDArray[np.float32], rng: np.random.Generator, count: int) -> None:
    """Draw rectangles and discs of 1 to 8 cm on a picture, half transparent."""
    n = len(picture)
    for _ in range(count):
        r, c = rng.integers(0, n, 2)
        h, w = (int(x) for x in rng.integers(5, 40, 2))
        if rng.uniform() < 0.5:
            w = h
            y, x = np.ogrid[:h, :w]
            inside = (y - h / 2 + 0.5) ** 2 + (x - w / 2 + 0.5) ** 2 < h * h / 4
        else:
            inside = np.ones((h, w), bool)
        at = np.ix_((r + np.arange(h)) % n, (c + np.arange(w)) % n)
        part = picture[at]
        part[inside] = 0.4 * part[inside] + 0.6 * rng.uniform(20, 235)
        picture[at] = part


def _build_mip_levels(a: NDArray[np.uint8]) -> tuple[NDArray[np.uint8], ...]:
    levels = [a]
    while min(a.shape) > 32 and len(levels) < 9:
        b = a.astype(np.uint16)
        a = ((b[::2, ::2] + b[1::2, ::2] + b[::2, 1::2] + b[1::2, 1::2] + 2) // 4).astype(np.uint8)
        levels.append(a)
    return tuple(levels)


def _make_shadow_map(rng: np.random.Generator, depth: float) -> NDArray[np.float32]:
    """Return a shadow map: soft bands and blotches."""
    n = SHADOW_MAP_SIDE_PIXELS
    a = rng.standard_normal((8, 8), dtype=np.float32)
    while len(a) < n:
        a = _double_resolution(a)
    soft = 1.0 / (1.0 + np.exp(-8.0 * (a - 0.6 * a.std())))
    return (1.0 - depth * soft).astype(np.float32)
