"""Pictures of weak floors: noise with a spectrum, directional grain, planks with repeated prints."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from mufly.camera import Floor, load_floor_picture

PICTURE_PIXELS, WIDTH_M = 1024, 2.0
WEAK_FLOORS = ("concrete", "felt", "asphalt", "planks", "laminate", "marble", "stripes")


def make_spectrum(
    rng: np.random.Generator, n: int, slope: float, stretch: tuple[float, float] = (1.0, 1.0)
) -> np.ndarray:
    """Return periodic noise (n, n), standard deviation 1, with the amplitude f^-slope; ``stretch`` makes a grain."""
    f = np.fft.fftfreq(n)
    size = np.hypot(f[:, None] * stretch[0], f[None, :] * stretch[1])
    size[0, 0] = 1.0
    amplitude = size**-slope
    amplitude[0, 0] = 0.0
    out = np.fft.ifft2(np.fft.fft2(rng.standard_normal((n, n))) * amplitude).real
    return out / out.std()


def draw_floor(kind: str, seed: int) -> np.ndarray:
    """Return a picture (1024, 1024) of a floor of :data:`WEAK_FLOORS`, 2 m wide; grain runs north."""
    rng, n = np.random.default_rng([seed, 99]), PICTURE_PIXELS
    match kind:
        case "concrete":
            grey = 128 + 6 * make_spectrum(rng, n, 1.0) + 3 * make_spectrum(rng, n, 0.3)
        case "felt":
            grey = 110 + 10 * make_spectrum(rng, n, 0.2)
        case "asphalt":
            grey = 90 + 20 * make_spectrum(rng, n, 0.1)
        case "planks":
            grey = 130 + 14 * make_spectrum(rng, n, 0.7, (40.0, 1.0))
            for c in range(0, n, 64):
                first = rng.integers(0, 512)
                grey[:, c : c + 64] += 6 * rng.standard_normal()
                grey[:, c] -= 35
                for r in range(first, n, 512):
                    grey[r : r + 2, c : c + 64] -= 35
        case "laminate":
            prints = [6 * make_spectrum(rng, n, 0.8, (15.0, 1.0))[:640, :96] for _ in range(4)]
            grey = np.full((n, n), 150.0)
            for c in range(0, n, 96):
                wide = min(96, n - c)
                for r in range(-int(rng.integers(0, 640)), n, 640):
                    a, b = max(r, 0), min(r + 640, n)
                    if b > a:
                        grey[a:b, c : c + wide] += prints[rng.integers(4)][a - r : b - r, :wide]
                        grey[a, c : c + wide] -= 12
                grey[:, c] -= 12
        case "marble":
            prints = [12 * make_spectrum(rng, 256, 1.2) for _ in range(2)]
            grey = np.full((n, n), 180.0)
            for r in range(0, n, 256):
                for c in range(0, n, 256):
                    grey[r : r + 256, c : c + 256] += prints[rng.integers(2)]
                    grey[r : r + 2, c : c + 256] -= 40
                    grey[r : r + 256, c : c + 2] -= 40
        case "stripes":
            grey = 130 + 20 * np.tile(make_spectrum(rng, n, 0.5)[0], (n, 1))
        case _:
            raise ValueError(kind)
    return np.clip(np.rint(grey), 0, 255).astype(np.uint8)


@pytest.fixture
def make_weak_floor(tmp_path: Path) -> Callable[[str, int], Floor]:
    """Return a function of kind and seed that makes one of :data:`WEAK_FLOORS`."""
    from PIL import Image

    def make(kind: str, seed: int) -> Floor:
        file = tmp_path / f"{kind}-{seed}.png"
        Image.fromarray(draw_floor(kind, seed)).save(file)
        return load_floor_picture(file, WIDTH_M, seed=seed, shadows=0.3)

    return make
