"""A pilot's support: a simple feedback that holds a hover while a signal is added to the inputs.

Linear-quadratic state feedback on the sampled linear model of the whole vehicle, with the inputs that are still on
their way (the loop's delay) as states::

    minimise  sum (x' W_x x + u' W_u u),      W = diag(1 / tolerable deviation^2)        (Bryson's rule)

with the tolerable deviations of ``_TOLERATED``: a lazy hold, so that it does not undo the excitation. It is fed with
the true state; a real one takes rotor speeds and the bar's tilt from an observer. What a plan needs of it are the
inputs that would be recorded, which depend little on how the hover is held. Own choice; the dissertation (Sec. 5.3.2)
has a PID whose gains it does not state.

Directions of the motors: with the rotors' speeds W settled, ``W = -A_WW^-1 B_W u``, the motors give the accelerations
``(dw/dt, dr/dt) = G u``; the columns of ``G^-1`` are the inputs that change the climb alone and the turn alone.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numba import njit, prange
from numpy.typing import NDArray
from scipy.linalg import LinAlgError, expm, solve_discrete_are

from mufly.dynamics import (
    PARAMETERS,
    Trim,
    advance,
    battery_state,
    linearise,
    model_parameters,
    rotation,
    trim,
)
from mufly.errors import MuflyError
from mufly.vehicle import Vehicle

__all__ = ["Support", "fly_supported", "pilot_support"]

Array = NDArray[np.floating[Any]]
_Floats = NDArray[np.float64]

# Deviations that cost as much as a tenth of full motor input or a third of full servo input.
_TOLERATED = {
    "x": 1.0, "y": 1.0, "z": 1.0, "u": 1.0, "v": 1.0, "w": 1.5, "phi": 0.25, "theta": 0.25, "psi": 2.0,
    "p": 2.0, "q": 2.0, "r": 8.0, "a_dw": 10.0, "b_dw": 10.0, "bar_roll": 10.0, "bar_pitch": 10.0,
    "Omega_dw": 1e4, "Omega_up": 1e4,
}  # fmt: skip
_INPUTS = np.array([0.1, 0.1, 0.3, 0.3])
_STEP_S = 1e-3


@dataclass(frozen=True, eq=False)
class Support:
    """A hover and the feedback that holds it.

    Attributes
    ----------
    hover : Trim
    gain : (4, 18 + 4 d) array
        Inputs (motor upper, motor lower, servo 1, servo 2) to be subtracted, per deviation of the linear model's states
        but the charge, at the heading of the vehicle, and of the inputs on their way, oldest last.
    collective, differential : (2,) array
        Directions of the motor inputs (upper, lower) that change the climb alone and the turn alone, largest part 1.
    sample_s, delay_s : float
        Of the loop.
    """

    hover: Trim
    gain: Array
    collective: Array
    differential: Array
    sample_s: float
    delay_s: float


def pilot_support(
    vehicle: Vehicle, *, sample_s: float = 0.01, delay_s: float = 0.02, charge: float = 0.7
) -> Support:
    """Design the feedback for a vehicle.

    Parameters
    ----------
    vehicle : Vehicle
    sample_s, delay_s : float
        Period of the loop; from measurement to input, whole periods.
    charge : float
        Of the battery.

    Raises
    ------
    MuflyError
        If the vehicle cannot hover, or cannot be held there.
    """
    hover = trim(vehicle, charge=charge)
    full = linearise(vehicle, hover).full
    names = list(full.state_labels)
    A, B = full.A, full.B[:, [1, 0, 2, 3]]

    def at(*states: str) -> list[int]:
        return [names.index(s) for s in states]

    turning = at("Omega_up", "Omega_dw")
    settled = -np.linalg.solve(A[np.ix_(turning, turning)], B[turning, :2])
    inverse = np.linalg.inv(A[np.ix_(at("w", "r"), turning)] @ settled + B[np.ix_(at("w", "r"), [0, 1])])
    keep = [k for k, name in enumerate(names) if name != "charge"]
    late = round(delay_s / sample_s)
    a, b = _sampled(A[np.ix_(keep, keep)], B[keep], sample_s, late)
    weight = np.r_[[1.0 / _TOLERATED[names[k]] ** 2 for k in keep], np.full(4 * late, 1e-9)]
    try:
        P = solve_discrete_are(a, b, np.diag(weight), np.diag(1.0 / _INPUTS**2))
    except (LinAlgError, ValueError) as error:
        raise MuflyError(
            f"{vehicle.name}: no feedback holds its hover; excitation cannot be planned for it"
        ) from error
    gain = np.linalg.solve(np.diag(1.0 / _INPUTS**2) + b.T @ P @ b, b.T @ P @ a)
    collective, differential = -inverse[:, 0], inverse[:, 1]
    return Support(
        hover, gain, collective / np.max(np.abs(collective)), differential / np.max(np.abs(differential)), sample_s,
        delay_s,
    )  # fmt: skip


def _sampled(A: Array, B: Array, sample_s: float, late: int) -> tuple[Array, Array]:
    """Return the sampled model with ``late`` inputs on their way as further states, newest first."""
    n = A.shape[0]
    step = expm(sample_s * np.block([[A, B], [np.zeros((4, n + 4))]]))
    if late == 0:
        return step[:n, :n], step[:n, n:]
    size = n + 4 * late
    a, b = np.zeros((size, size)), np.zeros((size, 4))
    a[:n, :n] = step[:n, :n]
    a[:n, size - 4 :] = step[:n, n:]
    a[n + 4 :, n : size - 4] = np.eye(4 * (late - 1))
    b[n : n + 4] = np.eye(4)
    return a, b


@njit(cache=True, error_model="numpy")
def _deviation(x, hover, height, yaw, off):  # type: ignore[no-untyped-def]
    """Write the linear model's states but the charge, as deviations from the hover at the present heading."""
    a = rotation(x[6:10])
    roll, pitch = math.atan2(a[2, 1], a[2, 2]), math.asin(min(max(-a[2, 0], -1.0), 1.0))
    c, s = math.cos(yaw), math.sin(yaw)
    off[0], off[1], off[2] = c * x[0] + s * x[1], c * x[1] - s * x[0], x[2] + height
    for k in range(3):
        off[3 + k] = a[0, k] * x[3] + a[1, k] * x[4] + a[2, k] * x[5]
        off[9 + k] = x[10 + k]
    off[6], off[7], off[8] = roll, pitch, yaw
    off[12], off[13] = -x[14] + hover[14], x[13] - hover[13]
    off[14] = math.asin(min(max(c * x[16] - s * x[15], -1.0), 1.0))
    off[15] = math.atan2(-(c * x[15] + s * x[16]), -x[17])
    off[16], off[17] = x[19] - hover[19], x[18] - hover[18]


@njit(cache=True, error_model="numpy")
def _fly(x, hover, trimmed, gain, added, p, late, dt, steps, height, states, inputs, voltage):  # type: ignore[no-untyped-def]
    n, calm, off, yaw = added.shape[0], np.zeros(3), np.zeros(gain.shape[1]), 0.0
    for k in range(n):
        states[k] = x
        heading = math.atan2(2 * (x[6] * x[9] + x[7] * x[8]), 1 - 2 * (x[8] * x[8] + x[9] * x[9]))
        yaw = heading + 2 * math.pi * round((yaw - heading) / (2 * math.pi))
        _deviation(x, hover, height, yaw, off)
        for j in range(late):
            for i in range(4):
                off[18 + 4 * j + i] = inputs[k - 1 - j, i] - trimmed[i] if k > j else 0.0
        for i in range(4):
            u = trimmed[i] + added[k, i]
            for m in range(off.shape[0]):
                u -= gain[i, m] * off[m]
            inputs[k, i] = min(max(u, 0.0 if i < 2 else -1.0), 1.0)
        now = inputs[k - late] if k >= late else trimmed
        voltage[k] = battery_state(x, now[0], now[1], p)[0]
        advance(x, now, calm, p, dt, steps)


@njit(cache=True, parallel=True, error_model="numpy")
def _fly_all(x, hover, trimmed, gain, added, p, late, dt, steps, height, states, inputs, voltage):  # type: ignore[no-untyped-def]
    for b in prange(x.shape[0]):
        _fly(
            x[b],
            hover,
            trimmed,
            gain,
            added[b],
            p[b],
            late,
            dt,
            steps,
            height,
            states[b],
            inputs[b],
            voltage[b],
        )


def fly_supported(
    vehicle: Vehicle, support: Support, added: Array, *, height_m: float = 2.0
) -> tuple[_Floats, _Floats, _Floats]:  # fmt: skip
    """Fly the whole model in closed loop, one flight for each signal.

    Parameters
    ----------
    vehicle : Vehicle
    support : Support
    added : (b, n, 4) array
        Added to motor upper, motor lower, servo 1, servo 2.
    height_m : float
        Where the flight begins and is held.

    Returns
    -------
    states : (b, n, 21) array
    inputs : (b, n, 4) array
        As commanded, limited to what the actuators take.
    voltage : (b, n) array
        Of the battery (V).
    """
    b, n, _ = added.shape
    x = np.repeat(support.hover.state[None], b, axis=0)
    x[:, 2] = -height_m
    states, inputs, voltage = np.empty((b, n, x.shape[1])), np.empty((b, n, 4)), np.empty((b, n))
    p = np.full(b, np.array(model_parameters(vehicle), dtype=PARAMETERS))
    late, steps = round(support.delay_s / support.sample_s), round(support.sample_s / _STEP_S)
    _fly_all(
        x, support.hover.state, support.hover.input, support.gain, np.ascontiguousarray(added), p, late, _STEP_S, steps,
        height_m, states, inputs, voltage,
    )  # fmt: skip
    return states, inputs, voltage
