"""The stationary motor equations with errors in every reading: the likeliest constants, and the adjusted readings.

Derivation: :mod:`mufly.identify.motor`. Constants are ``x = (R, a, b, d)`` as defined there; ``std`` (n, 4) are
expected errors of voltage, current, speed and torque; ``scales`` (2,) are the factors by which the residuals of the
two equations exceed what those errors lead to.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from mufly.identify.channel_noise import ChannelNoise
from mufly.identify.motor_data import CHANNELS, MotorData

__all__ = [
    "adjusted_readings",
    "equations",
    "expected_errors",
    "expected_residuals",
    "sensitivities",
    "solve_constants",
]

Array = NDArray[np.float64]

# % of reading, % of full scale; the first holds unless another is clearly likelier (2 log L, as by AIC).
_SHAPES = ((1.0, 0.2), (1.0, 0.05), (1.0, 0.5), (1.0, 2.0), (0.0, 1.0))
_CLEARLY = 4.0


def expected_errors(data: MotorData, noise: dict[str, ChannelNoise] | None) -> tuple[Array, str]:
    """Return expected errors (n, 4) of the readings and what was assumed.

    Without knowledge of the sensors, the likeliest of some shapes between errors that grow with the reading and errors
    that do not; their size is found afterwards.
    """
    if noise is not None:
        std = np.column_stack([noise[c].std(v) for c, v in zip(CHANNELS, data.channels(), strict=True)])
        return std, "shape of the errors as given; their size from the residuals"
    best, shape, least = np.empty(0), (0.0, 0.0), np.inf
    for reading, full_scale in _SHAPES:
        channel = ChannelNoise(0.01 * reading, 0.01 * full_scale)
        std = np.column_stack([channel.std(v) for v in data.channels()])
        x, scales = solve_constants(data, std, friction=True)
        w = whitening_of(x, std, scales)
        white = np.einsum("nij,nj->ni", w, equations(data, x))
        minus_log = float(np.sum(white**2) - 2 * np.sum(np.log(w[:, 0, 0] * w[:, 1, 1])))
        minus_log -= _CLEARLY if (reading, full_scale) == _SHAPES[0] else 0.0
        if minus_log < least:
            best, shape, least = std, (reading, full_scale), minus_log
    words = " and ".join(
        f"{v:g} % of {what}" for v, what in zip(shape, ("the reading", "full scale"), strict=True) if v
    )
    return (
        best,
        f"errors in all four channels taken in proportion to {words} (the likeliest shape); size from the residuals",
    )


def equations(data: MotorData, x: Array) -> Array:
    r, a, b, d = x
    u, i, w, q = data.channels()
    return np.column_stack([u - r * i - a * w, b * i - d * w - q])


def whitening_of(x: Array, std: Array, scales: Array) -> Array:
    """Return for every point the inverse Cholesky factor of S, (n, 2, 2)."""
    r, a, b, d = x
    vu, vi, vw, vq = (std**2).T
    s11 = (vu + r**2 * vi + a**2 * vw) * scales[0] ** 2
    s22 = (vq + b**2 * vi + d**2 * vw) * scales[1] ** 2
    s12 = (-r * b * vi + a * d * vw) * scales[0] * scales[1]
    l11 = np.sqrt(s11)
    l21 = s12 / l11
    l22 = np.sqrt(s22 - l21**2)
    out = np.zeros((len(std), 2, 2))
    out[:, 0, 0], out[:, 1, 1], out[:, 1, 0] = 1 / l11, 1 / l22, -l21 / (l11 * l22)
    return out


def expected_residuals(x: Array, std: Array, scales: Array) -> Array:
    """Return the standard deviations of e1 and e2, (n, 2)."""
    return np.linalg.norm(np.linalg.inv(whitening_of(x, std, scales)), axis=2)


def solve_constants(data: MotorData, std: Array, *, friction: bool) -> tuple[Array, Array]:
    """Return (R, a, b, d) and how much larger the errors of the two equations are than expected."""
    u, i, w, q = data.channels()
    electrical = np.linalg.lstsq(np.column_stack([i, w]), u, rcond=None)[0]
    side = np.column_stack([i, -w]) if friction else i[:, None]
    mechanical = np.linalg.lstsq(side, q, rcond=None)[0]
    start = np.r_[electrical, mechanical, [] if friction else 0.0]
    size = np.abs(start) + 1e-12 * np.max(np.abs(start))
    size[3] = max(size[3], 1e-3 * float(np.max(np.abs(q)) / np.max(np.abs(w))))
    free = np.array([True, True, True, friction])
    scales = np.ones(2)
    x = start
    for _ in range(3):

        def white(z: Array, scales: Array = scales) -> Array:
            full = np.where(free, 0.0, start)
            full[free] = z * size[free]
            e = np.einsum("nij,nj->ni", whitening_of(full, std, scales), equations(data, full))
            return e.ravel()

        found = least_squares(white, x[free] / size[free], method="lm", xtol=1e-14, ftol=1e-14, gtol=1e-14)
        x = np.where(free, 0.0, start)
        x[free] = found.x * size[free]
        # Each equation's own scale, from its residuals over its own expected error; two constants went into each.
        e = equations(data, x) / expected_residuals(x, std, np.ones(2))
        scales = np.maximum(np.sqrt(np.sum(e**2, axis=0) / (len(e) - np.array([2, 1 + friction]))), 1e-9)
    return x, scales


def adjusted_readings(data: MotorData, std: Array, x: Array, scales: Array) -> tuple[Array, Array, MotorData]:
    """Return residuals (n, 2), whitening (n, 2, 2) and the most likely true readings."""
    r, a, b, d = x
    e = equations(data, x)
    plain = whitening_of(x, std, np.ones(2))
    weighted = np.einsum("nji,njk,nk->ni", plain, plain, e)  # S^-1 e
    # With this shift both equations hold exactly at the adjusted readings.
    y = np.column_stack(data.channels()) - std**2 * (
        weighted @ np.array([[1.0, -r, -a, 0.0], [0.0, b, -d, -1.0]])
    )
    return (
        e,
        whitening_of(x, std, scales),
        replace(data, voltage_V=y[:, 0], current_A=y[:, 1], speed_rad_s=y[:, 2], torque_Nm=y[:, 3]),
    )


def sensitivities(adjusted: MotorData, whitening: Array) -> Array:
    """Return the whitened derivatives of e1 and e2 by (R, a, b, d), (2 n, 4)."""
    _, i, w, _ = adjusted.channels()
    raw = np.zeros((i.size, 2, 4))
    raw[:, 0, 0], raw[:, 0, 1], raw[:, 1, 2], raw[:, 1, 3] = -i, -w, i, -w
    return np.einsum("nij,njk->nik", whitening, raw).reshape(-1, 4)
