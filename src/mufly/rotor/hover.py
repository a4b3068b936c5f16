"""Thrust, torque and power of a rotor in hover and axial flight: one point, or many at once.

Coefficients are Leishman's: c_T = T / (rho pi R^4 Omega^2), c_Q = Q / (rho pi R^5 Omega^2); the figure of merit is
T sqrt(T / (2 rho A)) / P.
"""

from __future__ import annotations

import math
import os
from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mufly.errors import InputError
from mufly.rotor.bemt import FIELDS, solve_cases
from mufly.rotor.blading import Blading, as_blading
from mufly.rotor.geometry import Rotor
from mufly.rotor.polar import OUTSIDE_ALPHA, OUTSIDE_REYNOLDS

__all__ = ["Air", "BatchResult", "RotorResult", "hover", "hover_batch", "induced_velocities", "result_of"]

Array = NDArray[np.float64]

_MODES = {"none": 0, "prandtl": 1, "effective_radius": 2}
_CHUNK = 128  # cases below which a second thread costs more than it brings


@dataclass(frozen=True)
class Air:
    """The air: density (kg/m3) and dynamic viscosity (Pa s). Default: 1.2 kg/m3, as in the dissertation, at 20 C."""

    density_kg_m3: float = 1.2
    viscosity_Pa_s: float = 1.81e-5

    def __post_init__(self) -> None:
        for key in ("density_kg_m3", "viscosity_Pa_s"):
            if not 0.0 < getattr(self, key) < math.inf:
                raise InputError("air", key, f"is {getattr(self, key):g}", "give a number above 0")


@dataclass(frozen=True, eq=False)
class RotorResult:
    """One operating point.

    Attributes
    ----------
    pitch_rad, speed_rad_s, climb_m_s : float
        The point.
    thrust_N, torque_Nm, power_W, figure_of_merit, c_T, c_Q : float
        Of the whole rotor; the figure of merit is nan unless thrust and power are positive.
    r_m, dr_m, chord_m, theta_rad : (stations,) arrays
        Blade.
    alpha_rad, phi_rad, inflow_m_s, swirl_m_s, cl, cd, reynolds, loss, dT_N, dQ_Nm : (stations,) arrays
        Angle of attack of the section, inflow angle, axial and tangential induced velocity, section
        coefficients, Reynolds number, loss factor F, and thrust and torque of the annulus (all blades).
    outside : (stations,) array of uint8
        0 where the polar answers from what its engine computed; bits ``OUTSIDE_ALPHA``, ``OUTSIDE_REYNOLDS``
        elsewhere.
    outside_share : float
        Part of the thrust, by size, that such stations carry.
    calibrated : bool
        True if the section coefficients were scaled to a measurement.
    """

    pitch_rad: float
    speed_rad_s: float
    climb_m_s: float
    thrust_N: float
    torque_Nm: float
    power_W: float
    figure_of_merit: float
    c_T: float
    c_Q: float
    r_m: Array
    dr_m: Array
    chord_m: Array
    theta_rad: Array
    alpha_rad: Array
    phi_rad: Array
    inflow_m_s: Array
    swirl_m_s: Array
    cl: Array
    cd: Array
    reynolds: Array
    loss: Array
    dT_N: Array
    dQ_Nm: Array
    outside: NDArray[np.uint8]
    outside_share: float
    calibrated: bool


@dataclass(frozen=True, eq=False)
class BatchResult:
    """Many operating points; every array has the shape of the broadcast inputs."""

    thrust_N: Array
    torque_Nm: Array
    power_W: Array
    figure_of_merit: Array
    c_T: Array
    c_Q: Array


def _merit(thrust: Array, power: Array, density: Array, area: Array) -> Array:
    useful = (thrust > 0.0) & (power > 0.0)
    ideal = np.where(useful, thrust, 0.0) * np.sqrt(np.where(useful, thrust, 0.0) / (2.0 * density * area))
    return np.where(useful, ideal / np.where(useful, power, 1.0), np.nan)


def _checked(name: str, values: Array, *, positive: bool) -> None:
    bad = ~np.isfinite(values) | (values <= 0.0 if positive else np.zeros(values.shape, dtype=bool))
    if np.any(bad):
        value = values[bad].flat[0]
        remedy = "give a number above 0" if positive else "give a finite number"
        raise InputError("rotor", name, f"is {value:g}", remedy)


def _solve(
    blading: Blading,
    which: ArrayLike,
    pitch: Array,
    speed: Array,
    climb: Array,
    air: Air,
    keep: bool,
    stream: Array | None = None,
) -> tuple[Array, Array]:
    b, n = blading, pitch.size
    fixes = b.corrections
    totals = np.empty((n, 2))
    stations = np.empty((n if keep else 0, b.r_m.shape[1], len(FIELDS)))
    index = np.ascontiguousarray(np.broadcast_to(np.asarray(which, dtype=np.int64), pitch.shape).ravel())
    nu = air.viscosity_Pa_s / air.density_kg_m3
    wind = np.empty((0, 0, 2)) if stream is None else np.ascontiguousarray(stream)
    cos4 = int(fixes.rotation == "chaviaropoulos-hansen")
    args = (
        index, pitch, speed, climb, np.full(n, air.density_kg_m3), np.full(n, nu), wind,
        b.r_m, b.dr_m, b.chord_m, b.twist_rad, b.first, b.second, b.weight, b.chord_factor, b.rotation,
        b.blades, b.radius_m, b.hub_radius_m,
        b.polars.grid, b.polars.log_reynolds_min, b.polars.per_log_reynolds, b.zero_lift_rad,
        _MODES[fixes.tip_loss], int(fixes.hub_loss), int(fixes.swirl), cos4,
        np.array([fixes.lift_factor, fixes.drag_factor]), totals, stations,
    )  # fmt: skip
    workers = min(os.cpu_count() or 1, n // _CHUNK)
    if workers < 2:
        solve_cases(0, n, *args)
    else:
        # The kernel lets go of the interpreter; plain threads also work inside other people's threads.
        bounds = np.linspace(0, n, 4 * workers + 1).astype(int)
        with ThreadPoolExecutor(workers) as pool:
            list(
                pool.map(lambda k: solve_cases(int(bounds[k]), int(bounds[k + 1]), *args), range(4 * workers))
            )
    return totals, stations


def _outside(blading: Blading, which: int, alpha: Array, reynolds: Array) -> NDArray[np.uint8]:
    """Flags of one rotor's stations; a mixed section is outside where either polar is."""
    stack = blading.polars
    flags = np.zeros(alpha.size, dtype=np.uint8)
    log_re = np.log(reynolds)
    v = np.clip((log_re - stack.log_reynolds_min) * stack.per_log_reynolds, 0.0, stack.grid.shape[1] - 1.0)
    j = np.minimum(v.astype(np.int64), max(stack.grid.shape[1] - 2, 0))
    k = np.minimum(j + 1, stack.grid.shape[1] - 1)
    s = (v - j)[:, None]
    a = (alpha + math.pi) % (2.0 * math.pi) - math.pi
    for index, used in (
        (blading.first[which], blading.weight[which] < 1.0),
        (blading.second[which], blading.weight[which] > 0.0),
    ):
        limits = (1.0 - s) * stack.alpha_valid_rad[index, j] + s * stack.alpha_valid_rad[index, k]
        span = stack.log_reynolds_range[index]
        beyond_alpha = used & ((a < limits[:, 0] - 1e-9) | (a > limits[:, 1] + 1e-9))
        beyond_re = used & ((log_re < span[:, 0] - 1e-9) | (log_re > span[:, 1] + 1e-9))
        flags |= (beyond_alpha * OUTSIDE_ALPHA + beyond_re * OUTSIDE_REYNOLDS).astype(np.uint8)
    return flags


def hover(
    blading: Blading | Rotor,
    *,
    pitch_rad: float,
    speed_rad_s: float,
    climb_m_s: float = 0.0,
    air: Air | None = None,
    which: int = 0,
    stream: tuple[Array, Array] | None = None,
) -> RotorResult:
    """Solve one rotor at one point.

    Parameters
    ----------
    blading : Blading or Rotor
        From :func:`mufly.rotor.blading.prepare`; a rotor is prepared with all defaults at every call.
    pitch_rad : float
        Pitch setting, added to the twist (rad).
    speed_rad_s : float
        Rotor speed (rad/s), above 0.
    climb_m_s : float
        Axial speed of the rotor through the air (m/s), positive in climb; 0 is hover.
    air : Air, optional
        Density and viscosity.
    which : int
        Which of the blading's rotors.
    stream : (axial, tangential), optional
        Velocity that the air brings to each station, (stations,) arrays in m/s: down through the disc, and
        against the blade's motion. What another rotor sends.

    Raises
    ------
    InputError
        If the speed is not above zero or a number is not finite.
    """
    gas, blading = air or Air(), as_blading(blading)
    point = {name: np.array([float(value)]) for name, value in (
        ("pitch_rad", pitch_rad), ("speed_rad_s", speed_rad_s), ("climb_m_s", climb_m_s))}  # fmt: skip
    for name, value in point.items():
        _checked(name, value, positive=name == "speed_rad_s")
    wind = None if stream is None else np.stack(stream, axis=-1)[None]
    totals, stations = _solve(
        blading, which, point["pitch_rad"], point["speed_rad_s"], point["climb_m_s"], gas, True, wind
    )
    columns = {name: stations[0, :, i].copy() for i, name in enumerate(FIELDS)}
    return result_of(
        blading, which, float(pitch_rad), float(speed_rad_s), float(climb_m_s), gas,
        float(totals[0, 0]), float(totals[0, 1]), columns,
    )  # fmt: skip


def result_of(
    blading: Blading,
    which: int,
    pitch_rad: float,
    speed_rad_s: float,
    climb_m_s: float,
    air: Air,
    thrust_N: float,
    torque_Nm: float,
    columns: Mapping[str, Array],
) -> RotorResult:
    """Put an operating point together from its thrust, torque and station table (``FIELDS``), whatever the method."""
    rotor = blading.rotors[which]
    area = rotor.disc_area_m2
    power = torque_Nm * speed_rad_s
    scale = air.density_kg_m3 * area * rotor.radius_m**2 * speed_rad_s**2
    flags = _outside(blading, which, columns["alpha_rad"], columns["reynolds"])
    size = np.abs(columns["dT_N"])
    return RotorResult(
        pitch_rad=pitch_rad,
        speed_rad_s=speed_rad_s,
        climb_m_s=climb_m_s,
        thrust_N=thrust_N,
        torque_Nm=torque_Nm,
        power_W=power,
        figure_of_merit=float(
            _merit(np.array(thrust_N), np.array(power), np.array(air.density_kg_m3), np.array(area))
        ),
        c_T=thrust_N / scale,
        c_Q=torque_Nm / (scale * rotor.radius_m),
        r_m=blading.r_m[which],
        dr_m=blading.dr_m[which],
        chord_m=blading.chord_m[which],
        theta_rad=blading.twist_rad[which] + pitch_rad,
        **columns,
        outside=flags,
        outside_share=float(size[flags > 0].sum() / size.sum()) if size.sum() > 0 else 0.0,
        calibrated=blading.corrections.calibrated,
    )


def induced_velocities(
    blading: Blading,
    pitch_rad: float,
    speed_rad_s: float,
    climb_m_s: float,
    air: Air,
    stream: tuple[Array, Array],
) -> tuple[Array, Array]:
    """Axial and tangential velocity (m/s) that the first rotor induces at its stations; quick, for iterations."""
    pitch, speed, climb = (np.array([float(v)]) for v in (pitch_rad, speed_rad_s, climb_m_s))
    _, stations = _solve(blading, 0, pitch, speed, climb, air, True, np.stack(stream, axis=-1)[None])
    return stations[0, :, FIELDS.index("inflow_m_s")], stations[0, :, FIELDS.index("swirl_m_s")]


def hover_batch(
    blading: Blading | Rotor,
    *,
    pitch_rad: ArrayLike,
    speed_rad_s: ArrayLike,
    climb_m_s: ArrayLike = 0.0,
    air: Air | None = None,
    which: ArrayLike = 0,
) -> BatchResult:
    """Solve many points, on all cores; the numbers are bit by bit those of :func:`hover`.

    Parameters
    ----------
    blading : Blading or Rotor
        One or several rotors.
    pitch_rad, speed_rad_s, climb_m_s : array_like
        As for :func:`hover`, broadcast against each other and ``which``.
    air : Air, optional
        Density and viscosity of all points.
    which : array_like of int
        Rotor of each point.

    Raises
    ------
    InputError
        If a speed is not above zero, a number is not finite or a rotor does not exist.
    """
    gas, blading = air or Air(), as_blading(blading)
    given = np.broadcast_arrays(
        *(np.asarray(v, dtype=np.float64) for v in (pitch_rad, speed_rad_s, climb_m_s)), np.asarray(which)
    )
    shape = given[0].shape
    for name, values in zip(("pitch_rad", "speed_rad_s", "climb_m_s"), given, strict=False):
        _checked(name, values, positive=name == "speed_rad_s")
    index = given[3].astype(np.int64).ravel()
    if index.size and (index.min() < 0 or index.max() >= len(blading.rotors)):
        raise InputError("rotor", "which", f"there are {len(blading.rotors)} rotors", "count from 0")
    pitch, speed, climb = (np.ascontiguousarray(v, dtype=np.float64).ravel() for v in given[:3])
    totals, _ = _solve(blading, index, pitch, speed, climb, gas, False)
    thrust, torque = totals[:, 0], totals[:, 1]
    radius = blading.radius_m[index]
    area = math.pi * radius**2
    power = torque * speed
    scale = gas.density_kg_m3 * area * radius**2 * speed**2
    return BatchResult(
        thrust_N=thrust.reshape(shape),
        torque_Nm=torque.reshape(shape),
        power_W=power.reshape(shape),
        figure_of_merit=_merit(thrust, power, np.array(gas.density_kg_m3), area).reshape(shape),
        c_T=(thrust / scale).reshape(shape),
        c_Q=(torque / (scale * radius)).reshape(shape),
    )
